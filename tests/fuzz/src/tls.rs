//! TLS of a node: whatever a router says, whatever happens to it on the way and whatever certificate
//! it shows, the link opens only for the right one, and the session gets the beginning of what was said.
//!
//! The router is rustls with ring. Both sides choose their keys at random, so what a run reaches is not
//! quite the same twice; what must hold does not depend on it.

use super::Input;
use ::tls::{Authority, TlsConfig, TlsLink};
use rustls::{
    ServerConfig, ServerConnection,
    crypto::ring,
    pki_types::{CertificateDer, PrivateKeyDer},
    sign::{CertifiedKey, SingleCertAndKey},
};
use std::{
    io::Write as _,
    sync::{Arc, LazyLock},
};

/// Made for this; the authority's own key is gone.
const CA: &[u8] = include_bytes!("../tls/ca.pem");
const CERTIFICATE: &[u8] = include_bytes!("../tls/router.der");
const KEY: &[u8] = include_bytes!("../tls/router.key.der");

/// What the router says when the link is open.
const WORDS: [&[u8]; 2] = [b"an order to the node", &[7; 700]];

static CONFIG: LazyLock<TlsConfig> = LazyLock::new(|| {
    let authority = Authority::from_pem(CA).expect("an authority");
    TlsConfig::new(&authority, "plant", None).expect("a name")
});

static ROUTER: LazyLock<Arc<ServerConfig>> = LazyLock::new(|| router(CERTIFICATE));

fn router(certificate: &[u8]) -> Arc<ServerConfig> {
    let provider = ring::default_provider();
    let key = PrivateKeyDer::try_from(KEY).expect("a key");
    let key = provider.key_provider.load_private_key(key).expect("a key");
    let chain = vec![CertificateDer::from(certificate).into_owned()];
    let resolver = SingleCertAndKey::from(CertifiedKey::new(chain, key));
    let config = ServerConfig::builder_with_provider(Arc::new(provider))
        .with_protocol_versions(&[&rustls::version::TLS13])
        .expect("a version")
        .with_no_client_auth()
        .with_cert_resolver(Arc::new(resolver));
    Arc::new(config)
}

/// The first byte: what the router says as it is, what happens to a good one, a certificate, or an
/// authority's file.
pub fn check(data: &[u8]) {
    let mut input = Input(data);
    match input.byte() % 4 {
        0 => raw(&mut input),
        1 => {
            talk(&ROUTER, |flight| damage(flight, &mut input));
        }
        2 => {
            let certificate = input.0;
            let opened = talk(&router(certificate), |_| {});
            assert_eq!(opened, certificate == CERTIFICATE);
        }
        _ => {
            for read in [Authority::from_pem(input.0), Authority::from_der(input.0)] {
                let Ok(authority) = read else { continue };
                let again = Authority::from_parts(authority.subject(), authority.key());
                assert_eq!(again, Ok(authority));
            }
        }
    }
}

/// Nobody who has not got the key is listened to.
fn raw(input: &mut Input<'_>) {
    let mut link = TlsLink::new(&CONFIG).expect("random numbers");
    let piece = usize::from(input.byte()) + 1;
    let mut over = None;
    for bytes in input.0.chunks(piece) {
        let result = link.handle_bytes(bytes);
        if let Some(error) = over {
            assert_eq!(result, Err(error), "it stays over");
        }
        over = result.err();
        link.poll_transmit(&mut Vec::new());
    }
    assert!(!link.is_open() && !link.has_received());
}

/// Does to a flight what three bytes of the input say: what, where, how much.
fn damage(flight: &mut Vec<u8>, input: &mut Input<'_>) {
    if input.is_empty() || flight.is_empty() {
        return;
    }
    let (what, at, count) = (input.byte(), usize::from(input.short()), input.byte());
    let at = at % flight.len();
    let end = (at + usize::from(count)).min(flight.len());
    match what % 8 {
        0 => flight.truncate(at),
        1 => flight[at] ^= count,
        2 => drop(flight.drain(at..end)),
        3 => {
            let twice = flight[at..end].to_vec();
            flight.splice(end..end, twice);
        }
        4 => {
            let made_up = input.bytes(usize::from(count)).to_vec();
            flight.splice(at..at, made_up);
        }
        5 => flight[at..end].reverse(),
        // As it was.
        _ => {}
    }
}

/// Lets a router and a node talk; returns whether the link opened.
fn talk(router: &Arc<ServerConfig>, mut damage: impl FnMut(&mut Vec<u8>)) -> bool {
    let mut link = TlsLink::new(&CONFIG).expect("random numbers");
    let mut router = ServerConnection::new(router.clone()).expect("a connection");
    let mut words = WORDS.iter();
    let (mut opened, mut heard) = (false, Vec::new());
    loop {
        let mut out = Vec::new();
        link.poll_transmit(&mut out);
        let mut left = &out[..];
        while !left.is_empty() {
            if router.read_tls(&mut left).is_err() || router.process_new_packets().is_err() {
                break;
            }
        }
        if !router.is_handshaking()
            && !router.wants_write()
            && let Some(words) = words.next()
        {
            router.writer().write_all(words).expect("memory");
        }
        let mut flight = Vec::new();
        while router.wants_write() {
            router.write_tls(&mut flight).expect("memory");
        }
        if out.is_empty() && flight.is_empty() {
            break;
        }
        damage(&mut flight);
        let result = link.handle_bytes(&flight);
        let mut buffer = [0; 300];
        while let count @ 1.. = link.receive(&mut buffer) {
            heard.extend_from_slice(&buffer[..count]);
        }
        opened |= link.is_open();
        if result.is_err() {
            break;
        }
    }
    assert!(WORDS.concat().starts_with(&heard));
    assert!(opened || heard.is_empty());
    opened
}

/// Each way of the input; a good certificate and a good file with them.
pub fn seeds() -> Vec<Vec<u8>> {
    let mut hello = vec![0, 255, 22, 3, 3, 0, 90, 2, 0, 0, 86, 3, 3];
    hello.extend([7; 32]);
    hello.extend([
        0, 0x13, 0x03, 0, 0, 46, 0, 43, 0, 2, 3, 4, 0, 51, 0, 36, 0, 29, 0, 32,
    ]);
    hello.extend([9; 32]);
    vec![
        hello,
        vec![0, 0, 21, 3, 3, 0, 2, 2, 40],
        vec![1],
        vec![1, 6, 0, 0, 0, 1, 9, 0, 1],
        vec![1, 7, 0, 0, 0, 7, 0, 0, 0, 3, 3, 0, 40, 4, 2, 0, 9, 9, 9],
        [&[2], CERTIFICATE].concat(),
        [&[3], CA].concat(),
        [&[3], CERTIFICATE].concat(),
    ]
}
