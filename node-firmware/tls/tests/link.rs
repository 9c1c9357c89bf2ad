//! A node's link against the library that zenoh's router has: who is let in and who is not, in words.

mod peer;

use peer::{Ca, Router, YEARS, converse, pair, received, without_its_key};
use rustls::{
    AlertDescription,
    version::{TLS12, TLS13},
};
use tls::{Authority, AuthorityError, TlsConfig, TlsError, TlsLink, link::PLAIN_BYTES_MAX};

/// 2030-01-01 and 2050-01-01, seconds since 1970.
const DAYS: [u64; 2] = [1_893_456_000, 2_524_608_000];

fn refusal(config: &TlsConfig, router: &std::sync::Arc<rustls::ServerConfig>) -> TlsError {
    let mut link = TlsLink::new(config).expect("random numbers");
    let error = converse(&mut link, &mut Router::new(router)).expect_err("must be refused");
    // It stays so, and nothing is said in the open.
    assert!(!link.is_open());
    assert_eq!(link.handle_bytes(b"x"), Err(error));
    assert_eq!(link.send(b"secret", &mut Vec::new()), Err(error));
    assert!(!link.has_received());
    error
}

#[test]
fn a_session_goes_both_ways_in_pieces_of_any_size() {
    let ca = Ca::new();
    let router = ca.router(&["plant"], YEARS, &[&TLS13]);
    let config = TlsConfig::new(&ca.authority(), "plant", None).expect("a name");
    let (mut link, mut router) = pair(&config, &router);
    assert_eq!(
        router.0.protocol_version(),
        Some(rustls::ProtocolVersion::TLSv1_3)
    );
    let text: Vec<u8> = (0..40_000_u32).map(|at| (at * 7) as u8).collect();
    let (mut sent, mut out) = (0, Vec::new());
    while sent < text.len() {
        let count = link.send(&text[sent..], &mut out).expect("open");
        assert!((1..=PLAIN_BYTES_MAX).contains(&count));
        sent += count;
    }
    assert!(router.handle_bytes(&out));
    assert_eq!(router.heard(), text);
    let mut heard = Vec::new();
    for (index, chunk) in text.chunks(1_999).enumerate() {
        for piece in router.say(chunk).chunks(1 + index * 97) {
            link.handle_bytes(piece).expect("good");
            heard.append(&mut received(&mut link));
        }
    }
    assert_eq!(heard, text);
    // Both say when nothing more follows.
    out.clear();
    link.close(&mut out);
    assert!(router.handle_bytes(&out));
    assert_eq!(link.send(b"more", &mut out), Err(TlsError::Ended));
    let (mut link, mut router) = pair(&config, &ca.router(&["plant"], YEARS, &[&TLS13]));
    router.0.send_close_notify();
    link.handle_bytes(&router.transmit())
        .expect("an orderly end");
    assert!(link.is_ended());
    assert_eq!(link.send(b"more", &mut out), Err(TlsError::Ended));
}

#[test]
fn another_authority_of_the_same_name_is_not_trusted() {
    let (ours, other) = (Ca::new(), Ca::new());
    let config = TlsConfig::new(&ours.authority(), "plant", None).expect("a name");
    let error = refusal(&config, &other.router(&["plant"], YEARS, &[&TLS13]));
    assert_eq!(error, TlsError::UnknownAuthority);
    assert_eq!(
        error.to_string(),
        "the router's certificate is not signed by the authority that this node trusts"
    );
    // The router is told.
    let mut link = TlsLink::new(&config).expect("random numbers");
    let mut router = Router::new(&other.router(&["plant"], YEARS, &[&TLS13]));
    converse(&mut link, &mut router).expect_err("refused");
    let told = router.0.process_new_packets().expect_err("an alert");
    let rustls::Error::AlertReceived(alert) = told else {
        panic!("{told}");
    };
    assert!(matches!(
        alert,
        AlertDescription::UnknownCA
            | AlertDescription::DecryptError
            | AlertDescription::BadCertificate
    ));
}

#[test]
fn a_router_of_another_name_or_address_is_refused() {
    let ca = Ca::new();
    let router = ca.router(&["plant.local", "10.0.0.2", "::1"], YEARS, &[&TLS13]);
    let config = |name| TlsConfig::new(&ca.authority(), name, None).expect("a name");
    for name in ["plant.local", "10.0.0.2", "[::1]"] {
        pair(&config(name), &router);
    }
    for name in ["plant", "other.local", "10.0.0.3", "::2"] {
        assert_eq!(
            refusal(&config(name), &router),
            TlsError::WrongName,
            "{name}"
        );
    }
    for name in ["", "a b", "-"] {
        let wrong = TlsConfig::new(&ca.authority(), name, None);
        assert_eq!(wrong.map(|_| ()), Err(TlsError::Name), "{name:?}");
    }
}

#[test]
fn dates_count_for_a_node_that_knows_the_day_and_only_then() {
    let ca = Ca::new();
    let config = |day| TlsConfig::new(&ca.authority(), "plant", day).expect("a name");
    let past = ca.router(&["plant"], [2000, 2001], &[&TLS13]);
    let now = ca.router(&["plant"], [2026, 2046], &[&TLS13]);
    let future = ca.router(&["plant"], [2049, 2060], &[&TLS13]);
    let never = ca.router(&["plant"], [2030, 2029], &[&TLS13]);
    for router in [&past, &now, &future] {
        pair(&config(None), router);
    }
    pair(&config(Some(DAYS[0])), &now);
    pair(&config(Some(DAYS[1])), &future);
    assert_eq!(refusal(&config(Some(DAYS[0])), &past), TlsError::Expired);
    assert_eq!(refusal(&config(Some(DAYS[1])), &now), TlsError::Expired);
    assert_eq!(refusal(&config(Some(DAYS[0])), &future), TlsError::NotYet);
    assert_eq!(refusal(&config(None), &never), TlsError::Expired);
}

#[test]
fn a_router_that_speaks_tls_1_2_only_is_refused() {
    let ca = Ca::new();
    let config = TlsConfig::new(&ca.authority(), "plant", None).expect("a name");
    let router = ca.router(&["plant"], YEARS, &[&TLS12]);
    assert_eq!(refusal(&config, &router), TlsError::Version);
    pair(&config, &ca.router(&["plant"], YEARS, &[&TLS12, &TLS13]));
    // One that answers with an older version all the same: a ServerHello of TLS 1.2.
    let mut hello = vec![22, 3, 3, 0, 44, 2, 0, 0, 40, 3, 3];
    hello.extend([7; 32]);
    hello.extend([0, 0xcc, 0xa9, 0, 0, 0]);
    let mut link = TlsLink::new(&config).expect("random numbers");
    assert_eq!(link.handle_bytes(&hello), Err(TlsError::Version));
}

#[test]
fn a_router_without_the_key_of_its_certificate_is_refused() {
    let ca = Ca::new();
    let config = TlsConfig::new(&ca.authority(), "plant", None).expect("a name");
    assert_eq!(refusal(&config, &without_its_key(&ca)), TlsError::Key);
}

#[test]
fn what_is_no_tls_is_said_to_be_none() {
    let ca = Ca::new();
    let config = TlsConfig::new(&ca.authority(), "plant", None).expect("a name");
    for words in [&b"HTTP/1.1 400 Bad Request\r\n"[..], &[0, 1, 2, 3, 4, 5]] {
        let mut link = TlsLink::new(&config).expect("random numbers");
        assert_eq!(link.handle_bytes(words), Err(TlsError::NotTls));
    }
}

#[test]
fn before_the_router_has_proved_anything_it_cannot_fill_the_memory() {
    let ca = Ca::new();
    let config = TlsConfig::new(&ca.authority(), "plant", None).expect("a name");
    // A message of the handshake of 64 KiB that never becomes whole, in records that are.
    let mut link = TlsLink::new(&config).expect("random numbers");
    let mut record = vec![22, 3, 3, 0x10, 0, 2, 0, 0xff, 0xff];
    record.resize(5 + 0x1000, 0);
    let results: Vec<_> = (0..20).map(|_| link.handle_bytes(&record)).collect();
    assert_eq!(results.last(), Some(&Err(results[19].expect_err("over"))));
    assert!(results.contains(&Err(TlsError::TooLong)), "{results:?}");
}

#[test]
fn an_authority_is_one_certificate_with_a_key_that_a_node_can_check() {
    let pem = include_bytes!("authority.pem");
    let authority = Authority::from_pem(pem).expect("made by openssl");
    let again = Authority::from_parts(authority.subject(), authority.key());
    assert_eq!(again.as_ref(), Ok(&authority));
    assert!(authority.subject().len() + authority.key().len() < 140);
    let told = |text: &[u8]| Authority::from_pem(text).map(|_| ());
    assert_eq!(told(b""), Err(AuthorityError::Pem));
    assert_eq!(
        told(b"-----BEGIN CERTIFICATE-----\n"),
        Err(AuthorityError::Pem)
    );
    assert_eq!(
        told(&[&pem[..], pem].concat()),
        Err(AuthorityError::Several)
    );
    let noise = b"-----BEGIN CERTIFICATE-----\nAAAA\n-----END CERTIFICATE-----\n";
    assert_eq!(told(noise), Err(AuthorityError::Certificate));
    let key = [0x30, 5, 6, 3, 0x2b, 0x65, 0x70, 3, 1, 0];
    let other = Authority::from_parts(authority.subject(), &key).map(|_| ());
    assert_eq!(other, Err(AuthorityError::Key));
    let nobody = Authority::from_parts(&[], authority.key()).map(|_| ());
    assert_eq!(nobody, Err(AuthorityError::Subject));
}
