//! A router's side: rustls with ring, as zenoh has it, in memory.

#![allow(dead_code, reason = "each test uses a part of it")]

use rcgen::{
    BasicConstraints, CertificateParams, CertifiedIssuer, DnType, ExtendedKeyUsagePurpose, IsCa,
    KeyPair, date_time_ymd,
};
use rustls::{
    ServerConfig, ServerConnection, SupportedProtocolVersion,
    pki_types::{CertificateDer, PrivateKeyDer, pem::PemObject},
};
use std::{
    io::{Read, Write},
    sync::Arc,
};
use tls::{Authority, TlsConfig, TlsError, TlsLink};

/// The days on which a router's certificate is good, as years: from the first day of one to that of
/// the other.
pub(crate) type Years = [i32; 2];

/// What `fleet init` makes.
pub(crate) const YEARS: Years = [2026, 2046];

/// An authority that can sign.
pub(crate) struct Ca(CertifiedIssuer<'static, KeyPair>);

impl Ca {
    /// Makes one with a key of its own; all have the same name, as those of fleets have.
    pub(crate) fn new() -> Self {
        let mut params = CertificateParams::new(Vec::new()).expect("no names");
        params.is_ca = IsCa::Ca(BasicConstraints::Constrained(0));
        let name = &mut params.distinguished_name;
        name.push(DnType::CommonName, "Stepfleet authority");
        let key = KeyPair::generate().expect("random numbers");
        Self(CertifiedIssuer::self_signed(params, key).expect("signed"))
    }

    /// Returns what a node is told of it.
    pub(crate) fn authority(&self) -> Authority {
        Authority::from_pem(self.0.pem().as_bytes()).expect("an authority")
    }

    /// Makes a router's settings: certificate for these names, good in these years.
    pub(crate) fn router(
        &self,
        names: &[&str],
        years: Years,
        versions: &[&'static SupportedProtocolVersion],
    ) -> Arc<ServerConfig> {
        let names: Vec<_> = names.iter().map(|name| (*name).to_owned()).collect();
        let mut params = CertificateParams::new(names).expect("names");
        params.extended_key_usages = vec![ExtendedKeyUsagePurpose::ServerAuth];
        params.not_before = date_time_ymd(years[0], 1, 1);
        params.not_after = date_time_ymd(years[1], 1, 1);
        let key = KeyPair::generate().expect("random numbers");
        let certificate = params.signed_by(&key, &*self.0).expect("signed");
        let chain = vec![CertificateDer::from(certificate.der().to_vec())];
        Arc::new(settings(chain, &key, versions))
    }
}

fn settings(
    chain: Vec<CertificateDer<'static>>,
    key: &KeyPair,
    versions: &[&'static SupportedProtocolVersion],
) -> ServerConfig {
    let key = PrivateKeyDer::from_pem_slice(key.serialize_pem().as_bytes()).expect("a key");
    let provider = Arc::new(rustls::crypto::ring::default_provider());
    ServerConfig::builder_with_provider(provider)
        .with_protocol_versions(versions)
        .expect("versions")
        .with_no_client_auth()
        .with_single_cert(chain, key)
        .expect("a certificate and its key")
}

/// A router `plant` that shows a certificate of one key and has another.
pub(crate) fn without_its_key(ca: &Ca) -> Arc<ServerConfig> {
    let params = CertificateParams::new(vec!["plant".to_owned()]).expect("a name");
    let own = KeyPair::generate().expect("random numbers");
    let other = KeyPair::generate().expect("random numbers");
    let certificate = params.signed_by(&own, &*ca.0).expect("signed");
    let chain = vec![CertificateDer::from(certificate.der().to_vec())];
    let key = PrivateKeyDer::from_pem_slice(other.serialize_pem().as_bytes()).expect("a key");
    let provider = rustls::crypto::ring::default_provider();
    let key = provider.key_provider.load_private_key(key).expect("a key");
    let resolver =
        rustls::sign::SingleCertAndKey::from(rustls::sign::CertifiedKey::new(chain, key));
    Arc::new(
        ServerConfig::builder_with_provider(Arc::new(provider))
            .with_protocol_versions(&[&rustls::version::TLS13])
            .expect("versions")
            .with_no_client_auth()
            .with_cert_resolver(Arc::new(resolver)),
    )
}

/// One connection of a router.
pub(crate) struct Router(pub(crate) ServerConnection, Vec<u8>);

impl Router {
    pub(crate) fn new(config: &Arc<ServerConfig>) -> Self {
        let connection = ServerConnection::new(config.clone());
        Self(connection.expect("a connection"), Vec::new())
    }

    /// Takes bytes of the stream; `false` when it is over.
    pub(crate) fn handle_bytes(&mut self, mut bytes: &[u8]) -> bool {
        while !bytes.is_empty() {
            if self.0.read_tls(&mut bytes).is_err() || self.0.process_new_packets().is_err() {
                return false;
            }
            let mut buffer = [0; 4096];
            while let Ok(count @ 1..) = self.0.reader().read(&mut buffer) {
                self.1.extend_from_slice(&buffer[..count]);
            }
        }
        true
    }

    /// Gives bytes for the stream.
    pub(crate) fn transmit(&mut self) -> Vec<u8> {
        let mut out = Vec::new();
        while self.0.wants_write() {
            self.0.write_tls(&mut out).expect("memory");
        }
        out
    }

    /// Says something in one record.
    pub(crate) fn say(&mut self, plain: &[u8]) -> Vec<u8> {
        self.0.writer().write_all(plain).expect("memory");
        self.transmit()
    }

    /// Returns what was said to it.
    pub(crate) fn heard(&mut self) -> Vec<u8> {
        std::mem::take(&mut self.1)
    }
}

/// Lets the two talk until both are silent, or the link is over.
pub(crate) fn converse(link: &mut TlsLink, router: &mut Router) -> Result<(), TlsError> {
    loop {
        let mut out = Vec::new();
        link.poll_transmit(&mut out);
        router.handle_bytes(&out);
        let back = router.transmit();
        if out.is_empty() && back.is_empty() {
            return Ok(());
        }
        let result = link.handle_bytes(&back);
        if result.is_err() {
            // The alert arrives.
            let mut out = Vec::new();
            link.poll_transmit(&mut out);
            router.handle_bytes(&out);
            return result;
        }
    }
}

/// Returns all that was received.
pub(crate) fn received(link: &mut TlsLink) -> Vec<u8> {
    let mut plain = Vec::new();
    let mut buffer = [0; 300];
    loop {
        match link.receive(&mut buffer) {
            0 => return plain,
            count => plain.extend_from_slice(&buffer[..count]),
        }
    }
}

/// An open link and its router.
pub(crate) fn pair(config: &TlsConfig, router: &Arc<ServerConfig>) -> (TlsLink, Router) {
    let mut link = TlsLink::new(config).expect("random numbers");
    let mut router = Router::new(router);
    converse(&mut link, &mut router).expect("a handshake");
    assert!(link.is_open() && !router.0.is_handshaking());
    (link, router)
}
