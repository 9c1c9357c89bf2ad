//! The algorithms, from the crates of RustCrypto and dalek: one of each kind.

mod exchange;
mod records;
mod schedule;
mod signature;

use alloc::{sync::Arc, vec};
use rustls::{
    CipherSuite, Error, SupportedCipherSuite, Tls13CipherSuite,
    crypto::{
        CipherSuiteCommon, CryptoProvider, GetRandomFailed, KeyProvider, SecureRandom,
        tls13::HkdfUsingHmac,
    },
    pki_types::PrivateKeyDer,
    sign::SigningKey,
};

pub(crate) use signature::SIGNATURES;

static SUITE: Tls13CipherSuite = Tls13CipherSuite {
    common: CipherSuiteCommon {
        suite: CipherSuite::TLS13_CHACHA20_POLY1305_SHA256,
        hash_provider: &schedule::Sha256Hash,
        // More records than there will ever be: draft-irtf-cfrg-aead-limits-08, 5.2.1.
        confidentiality_limit: u64::MAX,
    },
    hkdf_provider: &HkdfUsingHmac(&schedule::HmacSha256),
    aead_alg: &records::ChaCha,
    quic: None,
};

/// Random numbers of the system; on bare metal what the board has registered with `getrandom`, its
/// hardware generator.
#[derive(Debug)]
struct System;

impl SecureRandom for System {
    fn fill(&self, buf: &mut [u8]) -> Result<(), GetRandomFailed> {
        getrandom::getrandom(buf).map_err(|_| GetRandomFailed)
    }
}

/// A node has no certificate of its own.
#[derive(Debug)]
struct NoKeys;

impl KeyProvider for NoKeys {
    fn load_private_key(&self, _: PrivateKeyDer<'static>) -> Result<Arc<dyn SigningKey>, Error> {
        Err(Error::General("a node has no private key".into()))
    }
}

/// Returns all of them.
pub(crate) fn provider() -> CryptoProvider {
    CryptoProvider {
        cipher_suites: vec![SupportedCipherSuite::Tls13(&SUITE)],
        kx_groups: vec![&exchange::X25519],
        signature_verification_algorithms: SIGNATURES,
        secure_random: &System,
        key_provider: &NoKeys,
    }
}
