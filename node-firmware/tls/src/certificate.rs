//! Checks the router's certificate, and that the router has its key.

use crate::{authority::Authority, provider};
use alloc::vec::Vec;
use core::time::Duration;
use rustls::{
    CertificateError, DigitallySignedStruct, Error, RootCertStore, SignatureScheme,
    client::{
        danger::{HandshakeSignatureValid, ServerCertVerified, ServerCertVerifier},
        verify_server_cert_signed_by_trust_anchor, verify_server_name,
    },
    crypto::verify_tls13_signature,
    pki_types::{CertificateDer, ServerName, UnixTime},
    server::ParsedCertificate,
};

/// Certificates in a chain, the router's own with them. Each may ask for a later day.
const CHAIN_MAX: usize = 4;

/// See the module.
#[derive(Debug)]
pub(crate) struct Verifier {
    roots: RootCertStore,
    /// The day, if it is known.
    today: Option<UnixTime>,
}

impl Verifier {
    pub(crate) fn new(authority: &Authority, today: Option<UnixTime>) -> Self {
        Self {
            roots: authority.store(),
            today,
        }
    }

    fn verify_at(
        &self,
        certificate: &ParsedCertificate<'_>,
        between: &[CertificateDer<'_>],
        day: UnixTime,
    ) -> Result<(), Error> {
        let algorithms = provider::SIGNATURES.all;
        verify_server_cert_signed_by_trust_anchor(
            certificate,
            &self.roots,
            between,
            day,
            algorithms,
        )
    }

    /// Checks everything but the day: on the first day on which all of the chain is good. A chain
    /// that is never good as a whole is refused.
    fn verify_some_day(
        &self,
        certificate: &ParsedCertificate<'_>,
        between: &[CertificateDer<'_>],
    ) -> Result<(), Error> {
        let mut day = UnixTime::since_unix_epoch(Duration::ZERO);
        for _ in 0..CHAIN_MAX {
            match self.verify_at(certificate, between, day) {
                Err(Error::InvalidCertificate(CertificateError::NotValidYetContext {
                    not_before,
                    ..
                })) if not_before > day => day = not_before,
                result => return result,
            }
        }
        Err(CertificateError::NotValidYet.into())
    }
}

impl ServerCertVerifier for Verifier {
    fn verify_server_cert(
        &self,
        end_entity: &CertificateDer<'_>,
        intermediates: &[CertificateDer<'_>],
        server_name: &ServerName<'_>,
        _ocsp_response: &[u8],
        _now: UnixTime,
    ) -> Result<ServerCertVerified, Error> {
        let certificate = ParsedCertificate::try_from(end_entity)?;
        match self.today {
            Some(today) => self.verify_at(&certificate, intermediates, today)?,
            None => self.verify_some_day(&certificate, intermediates)?,
        }
        verify_server_name(&certificate, server_name)?;
        Ok(ServerCertVerified::assertion())
    }

    fn verify_tls12_signature(
        &self,
        _message: &[u8],
        _cert: &CertificateDer<'_>,
        _dss: &DigitallySignedStruct,
    ) -> Result<HandshakeSignatureValid, Error> {
        // TLS 1.2 is not offered.
        Err(CertificateError::ApplicationVerificationFailure.into())
    }

    fn verify_tls13_signature(
        &self,
        message: &[u8],
        cert: &CertificateDer<'_>,
        dss: &DigitallySignedStruct,
    ) -> Result<HandshakeSignatureValid, Error> {
        verify_tls13_signature(message, cert, dss, &provider::SIGNATURES).map_err(|error| {
            match error {
                Error::InvalidCertificate(CertificateError::BadSignature) => {
                    CertificateError::ApplicationVerificationFailure.into()
                }
                error => error,
            }
        })
    }

    fn supported_verify_schemes(&self) -> Vec<SignatureScheme> {
        provider::SIGNATURES.supported_schemes()
    }
}
