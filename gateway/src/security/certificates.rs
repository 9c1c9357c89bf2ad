//! The fleet's own certificate authority, and the router's certificate.

use rcgen::{
    BasicConstraints, CertificateParams, CertifiedIssuer, DnType, ExtendedKeyUsagePurpose, IsCa,
    KeyPair, KeyUsagePurpose, date_time_ymd,
};

/// From the beginning of one year to that of the other. Long: a controller without a battery does not
/// know what day it is, and a fleet must not stop on one.
const YEARS: [i32; 2] = [2026, 2046];

/// Both, PEM.
pub(super) struct Certificates {
    pub(super) ca: String,
    pub(super) ca_key: String,
    pub(super) router: String,
    pub(super) router_key: String,
}

/// Makes an authority and a certificate for a router that is reached under these names and addresses.
pub(super) fn make(hosts: &[String]) -> Result<Certificates, rcgen::Error> {
    let mut params = CertificateParams::new(Vec::new())?;
    params.is_ca = IsCa::Ca(BasicConstraints::Constrained(0));
    params.key_usages = vec![KeyUsagePurpose::KeyCertSign, KeyUsagePurpose::CrlSign];
    let name = &mut params.distinguished_name;
    name.push(DnType::CommonName, "Stepfleet authority");
    params.not_before = date_time_ymd(YEARS[0], 1, 1);
    params.not_after = date_time_ymd(YEARS[1], 1, 1);
    let authority = CertifiedIssuer::self_signed(params, KeyPair::generate()?)?;

    let mut params = CertificateParams::new(hosts.to_vec())?;
    let name = &mut params.distinguished_name;
    name.push(DnType::CommonName, "Stepfleet router");
    params.key_usages = vec![KeyUsagePurpose::DigitalSignature];
    params.extended_key_usages = vec![ExtendedKeyUsagePurpose::ServerAuth];
    params.not_before = date_time_ymd(YEARS[0], 1, 1);
    params.not_after = date_time_ymd(YEARS[1], 1, 1);
    let key = KeyPair::generate()?;
    let router = params.signed_by(&key, &*authority)?;
    Ok(Certificates {
        ca: authority.pem(),
        ca_key: authority.key().serialize_pem(),
        router: router.pem(),
        router_key: key.serialize_pem(),
    })
}
