//! Who is trusted: the fleet's own certificate authority, and nobody else.
//!
//! Of its certificate only name and key count; with a certificate of the usual form they take about
//! 130 bytes of a node's record.

use alloc::vec::Vec;
use core::fmt;
use rustls::{
    RootCertStore,
    pki_types::{CertificateDer, Der, TrustAnchor, alg_id, pem::PemObject},
};

/// Longest name, bytes of DER.
pub const SUBJECT_BYTES_MAX: usize = 128;

/// Longest key, bytes of DER; one of P-256 takes 89.
pub const KEY_BYTES_MAX: usize = 96;

/// An authority.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Authority(TrustAnchor<'static>);

/// Why bytes are no authority that a node can trust.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum AuthorityError {
    /// No certificate in PEM.
    Pem,
    /// More than one certificate.
    Several,
    /// Not the certificate of an authority.
    Certificate,
    /// Its key is not one of ECDSA on P-256.
    Key,
    /// It is limited to some names, which a node's record does not hold.
    Constrained,
    /// Its name is longer than [`SUBJECT_BYTES_MAX`].
    Subject,
}

impl fmt::Display for AuthorityError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Pem => "there is no certificate in it (PEM is wanted)",
            Self::Several => {
                "there is more than one certificate in it; a node trusts one authority"
            }
            Self::Certificate => "its certificate cannot be read",
            Self::Key => "its key is not one of ECDSA on P-256, the only kind that a node checks",
            Self::Constrained => "it is limited to some names, which a node does not check",
            Self::Subject => "its name is longer than 128 bytes",
        })
    }
}

impl core::error::Error for AuthorityError {}

impl Authority {
    /// Reads the one certificate of a PEM file.
    ///
    /// # Errors
    /// See [`AuthorityError`].
    pub fn from_pem(text: &[u8]) -> Result<Self, AuthorityError> {
        let mut certificates = CertificateDer::pem_slice_iter(text);
        let first = certificates.next().ok_or(AuthorityError::Pem)?;
        let first = first.map_err(|_| AuthorityError::Pem)?;
        if certificates.next().is_some() {
            return Err(AuthorityError::Several);
        }
        Self::from_der(&first)
    }

    /// Reads a certificate.
    ///
    /// # Errors
    /// See [`AuthorityError`].
    pub fn from_der(certificate: &[u8]) -> Result<Self, AuthorityError> {
        let mut store = RootCertStore::empty();
        let added = store.add(CertificateDer::from_slice(certificate));
        added.map_err(|_| AuthorityError::Certificate)?;
        let anchor = store.roots.pop().ok_or(AuthorityError::Certificate)?;
        if anchor.name_constraints.is_some() {
            return Err(AuthorityError::Constrained);
        }
        Self::from_parts(&anchor.subject, &anchor.subject_public_key_info)
    }

    /// Puts one together from what [`Authority::subject`] and [`Authority::key`] gave.
    ///
    /// # Errors
    /// The name is too long, or the key of another kind.
    pub fn from_parts(subject: &[u8], key: &[u8]) -> Result<Self, AuthorityError> {
        if subject.is_empty() || subject.len() > SUBJECT_BYTES_MAX {
            return Err(AuthorityError::Subject);
        }
        // SEQUENCE { identifier of the algorithm }, BIT STRING { point }.
        let algorithm = alg_id::ECDSA_P256;
        let begin = [0x30, algorithm.len() as u8];
        let is_p256 = key
            .strip_prefix(&begin)
            .is_some_and(|rest| rest.starts_with(&algorithm));
        if !is_p256 || key.len() > KEY_BYTES_MAX {
            return Err(AuthorityError::Key);
        }
        let der = |bytes: &[u8]| Der::from(Vec::from(bytes));
        Ok(Self(TrustAnchor {
            subject: der(subject),
            subject_public_key_info: der(key),
            name_constraints: None,
        }))
    }

    /// Returns its name, DER without the outer tag.
    pub fn subject(&self) -> &[u8] {
        &self.0.subject
    }

    /// Returns its public key, DER of SubjectPublicKeyInfo without the outer tag.
    pub fn key(&self) -> &[u8] {
        &self.0.subject_public_key_info
    }

    /// Returns it as the only one that is trusted.
    pub(crate) fn store(&self) -> RootCertStore {
        RootCertStore {
            roots: Vec::from([self.0.clone()]),
        }
    }
}
