//! Why there is no session, in words for whoever stands at the machine.

use core::fmt;
use rustls::{AlertDescription, CertificateError, Error, PeerIncompatible};

/// What was wrong. The link is over.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum TlsError {
    /// The name of the router is neither a name nor an address.
    Name,
    /// Nobody whom this node trusts has signed the router's certificate.
    UnknownAuthority,
    /// The certificate is for other names than the one under which the router was reached.
    WrongName,
    /// The certificate is good no longer. Said only by a node that knows what day it is.
    Expired,
    /// The certificate is not good yet. Said only by a node that knows what day it is.
    NotYet,
    /// The certificate cannot be read, or is not one of a router.
    Certificate,
    /// The router has not got the key of its certificate.
    Key,
    /// The router does not speak TLS 1.3.
    Version,
    /// The router and this node have no suite, group or kind of signature in common.
    NothingInCommon,
    /// What came is no TLS.
    NotTls,
    /// A record was changed on the way, or left out, or comes twice.
    Garbled,
    /// A record, or a message of the handshake, is longer than a node takes.
    TooLong,
    /// The router broke a rule of the protocol.
    Misbehaved,
    /// The router ended it by this alert (RFC 8446, 6).
    Alert(u8),
    /// There are no random numbers.
    Random,
    /// It has ended.
    Ended,
}

impl TlsError {
    pub(crate) fn of(error: &Error) -> Self {
        match error {
            Error::InvalidCertificate(error) => Self::of_certificate(error),
            Error::NoCertificatesPresented => Self::Certificate,
            Error::AlertReceived(AlertDescription::ProtocolVersion)
            | Error::PeerIncompatible(
                PeerIncompatible::ServerDoesNotSupportTls12Or13
                | PeerIncompatible::ServerTlsVersionIsDisabledByOurConfig
                | PeerIncompatible::SupportedVersionsExtensionRequired,
            ) => Self::Version,
            Error::AlertReceived(AlertDescription::HandshakeFailure)
            | Error::PeerIncompatible(_) => Self::NothingInCommon,
            Error::AlertReceived(alert) => Self::Alert(u8::from(*alert)),
            Error::InvalidMessage(_)
            | Error::InappropriateMessage { .. }
            | Error::InappropriateHandshakeMessage { .. } => Self::NotTls,
            Error::DecryptError => Self::Garbled,
            Error::PeerSentOversizedRecord => Self::TooLong,
            Error::FailedToGetRandomBytes => Self::Random,
            Error::HandshakeNotComplete => Self::Ended,
            _ => Self::Misbehaved,
        }
    }

    fn of_certificate(error: &CertificateError) -> Self {
        match error {
            CertificateError::UnknownIssuer | CertificateError::BadSignature => {
                Self::UnknownAuthority
            }
            CertificateError::NotValidForName | CertificateError::NotValidForNameContext { .. } => {
                Self::WrongName
            }
            CertificateError::Expired | CertificateError::ExpiredContext { .. } => Self::Expired,
            CertificateError::NotValidYet | CertificateError::NotValidYetContext { .. } => {
                Self::NotYet
            }
            // What `certificate` says of a signature over the handshake.
            CertificateError::ApplicationVerificationFailure => Self::Key,
            _ => Self::Certificate,
        }
    }
}

impl fmt::Display for TlsError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Name => "the router's name is neither a name nor an address",
            Self::UnknownAuthority => {
                "the router's certificate is not signed by the authority that this node trusts"
            }
            Self::WrongName => {
                "the router's certificate is not for the name under which this node reaches it"
            }
            Self::Expired => "the router's certificate has expired",
            Self::NotYet => "the router's certificate is not valid yet",
            Self::Certificate => "the router's certificate cannot be used",
            Self::Key => "the router has not got the key of its certificate",
            Self::Version => "the router does not speak TLS 1.3",
            Self::NothingInCommon => {
                "the router and this node have no suite, group or kind of signature in common"
            }
            Self::NotTls => "what the router says is no TLS",
            Self::Garbled => "a record was changed on the way",
            Self::TooLong => "a record is longer than a node takes",
            Self::Misbehaved => "the router broke a rule of TLS",
            Self::Alert(alert) => return write!(f, "the router ended the link by alert {alert}"),
            Self::Random => "there are no random numbers",
            Self::Ended => "the link has ended",
        })
    }
}

impl core::error::Error for TlsError {}
