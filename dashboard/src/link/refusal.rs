//! Why a router does not let this window in. Zenoh says only that it could not connect; so the same
//! door is tried once more, step by step: does anybody listen, is its certificate the fleet's?

use keys::credentials::Credentials;
use std::{sync::Arc, time::Duration};
use tokio::{net::TcpStream, time::timeout};
use tokio_rustls::{
    TlsConnector,
    rustls::{
        ClientConfig, RootCertStore,
        crypto::ring,
        pki_types::{CertificateDer, ServerName, pem::PemObject as _},
    },
};

/// Longest time for each step.
const STEP_MAX: Duration = Duration::from_secs(5);

/// Returns why a session to this locator did not come about, for a person.
pub(super) async fn why(locator: &str, credentials: Option<&Credentials>) -> String {
    let (protocol, address) = locator.split_once('/').unwrap_or(("tcp", locator));
    let stream = match timeout(STEP_MAX, TcpStream::connect(address)).await {
        Ok(Ok(stream)) => stream,
        Ok(Err(error)) => return format!("nothing answers at {locator}: {error}"),
        Err(_) => return format!("nothing answers at {locator} within {STEP_MAX:?}"),
    };
    let user = credentials.map(|credentials| credentials.user.as_str());
    if protocol != "tls" {
        return match user {
            Some(user) => format!(
                "{locator} does not let {user} in: wrong user or password, or it is no router of \
                 this fleet (a secured one lets people in by tls/ only)"
            ),
            None => format!(
                "something listens at {locator} and does not let this window in: it asks for a user \
                 (--credentials FILE), or it is no zenoh router"
            ),
        };
    }
    let Some(ca) = credentials.and_then(|credentials| credentials.ca.as_deref()) else {
        return format!(
            "the certificate of {locator} cannot be checked: nobody said whose to trust (`ca` in the \
             file of --credentials)"
        );
    };
    match handshake(stream, address, ca).await {
        Err(why) => format!("{locator} is not trusted: {why}"),
        Ok(()) => format!(
            "{locator} is this fleet's router, but it does not let {} in: wrong user or password, \
             or revoked",
            user.unwrap_or("this window")
        ),
    }
}

/// Looks at the certificate with the trust that a session has.
async fn handshake(stream: TcpStream, address: &str, ca: &str) -> Result<(), String> {
    let mut roots = RootCertStore::empty();
    for certificate in CertificateDer::pem_slice_iter(ca.as_bytes()) {
        let unreadable = |why: &dyn std::fmt::Display| format!("`ca` is no certificate: {why}");
        let certificate = certificate.map_err(|error| unreadable(&error))?;
        roots.add(certificate).map_err(|error| unreadable(&error))?;
    }
    if roots.is_empty() {
        return Err("there is no certificate in `ca`".to_owned());
    }
    let host = address.rsplit_once(':').map_or(address, |(host, _)| host);
    let host = host.trim_matches(['[', ']']).to_owned();
    let name = ServerName::try_from(host).map_err(|error| error.to_string())?;
    let config = ClientConfig::builder_with_provider(Arc::new(ring::default_provider()))
        .with_safe_default_protocol_versions()
        .map_err(|error| error.to_string())?
        .with_root_certificates(roots)
        .with_no_client_auth();
    let connector = TlsConnector::from(Arc::new(config));
    match timeout(STEP_MAX, connector.connect(name, stream)).await {
        Ok(Ok(_)) => Ok(()),
        Ok(Err(error)) => Err(format!(
            "its certificate is not one of this fleet ({error})"
        )),
        Err(_) => Err(format!("no TLS within {STEP_MAX:?}")),
    }
}
