//! The four messages that open a session, and the answer to a password challenge.
//!
//! ```text
//!  we                                            router
//!  InitSyn  version, zid, batch, resolution  ──▶
//!           ◀── InitAck  what it grants, cookie, nonce
//!  OpenSyn  lease, first number, cookie, user + MAC ──▶
//!           ◀── OpenAck  its lease, its first number
//! ```
//!
//! Promises that nothing is accepted that was not offered. The MAC is
//! HMAC-SHA3-256(key = nonce, message = password); over plain TCP it keeps the password secret
//! from a listener who cannot guess it, and nothing more.

use alloc::{string::String, vec::Vec};
use core::time::Duration;

use hmac::{Hmac, Mac};
use sha3::Sha3_256;
use zenoh_buffers::{ZBuf, ZSlice, reader::HasReader, writer::DidntWrite};
use zenoh_codec::{RCodec, WCodec, Zenoh080};
use zenoh_protocol::{
    common::{ZExtBody, ZExtUnknown, iext},
    core::{Bits, Field, Resolution, WhatAmI, ZenohIdProto},
    transport::{Close, InitAck, InitSyn, KeepAlive, OpenAck, OpenSyn, TransportSn, init, open},
};

use crate::{event::SessionError, limits::BATCH_BYTES_MIN};

/// The protocol version that we speak.
const VERSION: u8 = 0x09;
/// Number of user/password among the authentication methods.
const AUTH_USER_PASSWORD: u8 = 2;

/// Who we are.
#[derive(Clone, PartialEq, Eq)]
pub struct Credentials {
    /// User name, at most [`USER_BYTES_MAX`](crate::limits::USER_BYTES_MAX) bytes.
    pub user: String,
    /// Password. It never leaves this side; only a MAC with it does.
    pub password: String,
}

/// Shows the user, never the password.
impl core::fmt::Debug for Credentials {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        f.debug_struct("Credentials")
            .field("user", &self.user)
            .finish_non_exhaustive()
    }
}

/// What we offer.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Offer {
    pub(crate) zid: ZenohIdProto,
    pub(crate) batch_bytes: u16,
    pub(crate) qos: bool,
    pub(crate) authenticate: bool,
}

/// What the peer granted.
#[derive(Debug, Clone)]
pub(crate) struct Grant {
    pub(crate) batch_bytes: u16,
    pub(crate) sn_mask: TransportSn,
    pub(crate) request_id_mask: u32,
    pub(crate) qos: bool,
    pub(crate) markers: bool,
    pub(crate) cookie: ZSlice,
    pub(crate) nonce: Option<u64>,
}

/// Appends a transport message as a batch of its own.
///
/// Each message by its own codec: the one that takes them all is as large as all of them.
pub(crate) fn write_batch<M>(out: &mut Vec<u8>, message: M)
where
    for<'m, 'o> Zenoh080: WCodec<&'m M, &'o mut Vec<u8>, Output = Result<(), DidntWrite>>,
{
    let prefix = out.len();
    out.extend_from_slice(&[0, 0]);
    Zenoh080::new()
        .write(&mut *out, &message)
        .expect("handshake lengths are far below their fields");
    let batch_bytes = out.len() - prefix - 2;
    let length = u16::try_from(batch_bytes).expect("handshake messages are short");
    out[prefix..prefix + 2].copy_from_slice(&length.to_le_bytes());
}

pub(crate) fn init_syn(offer: &Offer) -> InitSyn {
    let ext_auth = offer.authenticate.then(|| {
        let method = ZExtUnknown::new(AUTH_USER_PASSWORD, false, ZExtBody::Unit);
        init::ext::Auth::new(extensions(&[method]))
    });
    InitSyn {
        version: VERSION,
        whatami: WhatAmI::Client,
        zid: offer.zid,
        resolution: Resolution::default(),
        batch_size: offer.batch_bytes,
        ext_qos: offer.qos.then(init::ext::QoS::new),
        ext_qos_link: None,
        ext_auth,
        ext_mlink: None,
        ext_lowlatency: None,
        ext_compression: None,
        ext_patch: init::ext::PatchType::CURRENT,
        ext_region_name: None,
    }
}

/// Checks the grant against the offer.
pub(crate) fn init_ack(offer: &Offer, ack: &InitAck) -> Result<Grant, SessionError> {
    let offered = Resolution::default();
    let sn_bits = ack.resolution.get(Field::FrameSN);
    let request_bits = ack.resolution.get(Field::RequestID);
    if ack.batch_size > offer.batch_bytes
        || ack.batch_size < BATCH_BYTES_MIN
        || sn_bits > offered.get(Field::FrameSN)
        || request_bits > offered.get(Field::RequestID)
        || ack.ext_patch > init::ext::PatchType::CURRENT
        || ack.ext_lowlatency.is_some()
        || ack.ext_compression.is_some()
    {
        return Err(SessionError::Handshake);
    }
    let granted_qos = ack.ext_qos.is_some() || ack.ext_qos_link.is_some_and(|q| q.value != 0);
    let nonce = if offer.authenticate {
        Some(nonce(ack.ext_auth.as_ref()).ok_or(SessionError::NoAuthentication)?)
    } else {
        None
    };
    Ok(Grant {
        batch_bytes: ack.batch_size,
        sn_mask: sn_mask(sn_bits),
        request_id_mask: request_bits.mask().min(u64::from(u32::MAX)) as u32,
        qos: offer.qos && granted_qos,
        markers: ack.ext_patch.has_fragmentation_markers(),
        cookie: ack.cookie.clone(),
        nonce,
    })
}

pub(crate) fn open_syn(
    grant: &Grant,
    lease_us: u64,
    initial_sn: TransportSn,
    credentials: Option<&Credentials>,
) -> OpenSyn {
    let ext_auth = credentials.zip(grant.nonce).map(|(credentials, nonce)| {
        let answer = answer(credentials, nonce);
        let method = ZExtUnknown::new(AUTH_USER_PASSWORD, false, ZExtBody::ZBuf(answer.into()));
        open::ext::Auth::new(extensions(&[method]))
    });
    OpenSyn {
        // The wire knows seconds and milliseconds.
        lease: Duration::from_millis(lease_us / 1000),
        initial_sn,
        cookie: grant.cookie.clone(),
        ext_qos: None,
        ext_auth,
        ext_mlink: None,
        ext_lowlatency: None,
        ext_compression: None,
        ext_remote_bound: None,
    }
}

/// The peer's lease in microseconds and its first number.
pub(crate) fn open_ack(grant: &Grant, ack: &OpenAck) -> Result<(u64, TransportSn), SessionError> {
    if ack.initial_sn & !grant.sn_mask != 0 || ack.lease.is_zero() {
        return Err(SessionError::Handshake);
    }
    if grant.nonce.is_some() && ack.ext_auth.is_none() {
        return Err(SessionError::NoAuthentication);
    }
    let lease_us = u64::try_from(ack.lease.as_micros()).unwrap_or(u64::MAX);
    Ok((lease_us, ack.initial_sn))
}

pub(crate) fn write_keep_alive(out: &mut Vec<u8>) {
    write_batch(out, KeepAlive);
}

pub(crate) fn write_close(out: &mut Vec<u8>, reason: u8) {
    write_batch(
        out,
        Close {
            reason,
            session: true,
        },
    );
}

/// Numbers fill whole bytes of seven bits on the wire.
fn sn_mask(bits: Bits) -> TransportSn {
    match bits {
        Bits::U8 => TransportSn::from(u8::MAX >> 1),
        Bits::U16 => TransportSn::from(u16::MAX >> 2),
        Bits::U32 | Bits::U64 => u32::MAX >> 4,
    }
}

fn extensions(methods: &[ZExtUnknown]) -> ZBuf {
    let mut bytes = Vec::new();
    Zenoh080::new()
        .write(&mut bytes, methods)
        .expect("authentication messages are short");
    bytes.into()
}

fn nonce(auth: Option<&init::ext::Auth>) -> Option<u64> {
    let methods: Vec<ZExtUnknown> = Zenoh080::new().read(&mut auth?.value.reader()).ok()?;
    methods.into_iter().find_map(|method| match method.body {
        ZExtBody::Z64(nonce) if method.id & iext::ID_MASK == AUTH_USER_PASSWORD => Some(nonce),
        _ => None,
    })
}

/// User and MAC, each with its length before it.
fn answer(credentials: &Credentials, nonce: u64) -> Vec<u8> {
    let mut mac = Hmac::<Sha3_256>::new_from_slice(&nonce.to_le_bytes())
        .expect("HMAC takes keys of any length");
    mac.update(credentials.password.as_bytes());
    let mac = mac.finalize().into_bytes();
    let codec = Zenoh080::new();
    let mut bytes = Vec::new();
    codec
        .write(&mut bytes, credentials.user.as_bytes())
        .expect("user names are short");
    codec
        .write(&mut bytes, mac.as_slice())
        .expect("a MAC has 32 bytes");
    bytes
}

#[cfg(test)]
mod tests {
    use super::*;
    use alloc::string::ToString;

    fn offer() -> Offer {
        Offer {
            zid: ZenohIdProto::try_from([7u8; 16].as_slice()).unwrap(),
            batch_bytes: 2048,
            qos: false,
            authenticate: false,
        }
    }

    #[test]
    fn init_syn_has_the_bytes_of_a_constrained_client() {
        let mut bytes = Vec::new();
        write_batch(&mut bytes, init_syn(&offer()));
        let mut expected = alloc::vec![26, 0, 0xc1, 0x09, 0xf2];
        expected.extend([7; 16]);
        expected.extend([0x0a, 0x00, 0x08, 0x27, 0x01]);
        expected[0] = (expected.len() - 2) as u8;
        assert_eq!(bytes, expected);
    }

    fn granted(resolution: u8, change: impl FnOnce(&mut InitAck)) -> Result<Grant, SessionError> {
        let mut ack = InitAck {
            version: VERSION,
            whatami: WhatAmI::Router,
            zid: offer().zid,
            resolution: Resolution::from(resolution),
            batch_size: 2048,
            cookie: alloc::vec![1].into(),
            ext_qos: None,
            ext_qos_link: None,
            ext_auth: None,
            ext_mlink: None,
            ext_lowlatency: None,
            ext_compression: None,
            ext_patch: init::ext::PatchType::CURRENT,
            ext_region_name: None,
        };
        change(&mut ack);
        init_ack(&offer(), &ack)
    }

    #[test]
    fn numbers_are_as_wide_as_granted_and_never_wider_than_offered() {
        for (resolution, sn_mask, request_id_mask) in [
            (0b0000, 0x7f, 0xff),
            (0b0101, 0x3fff, 0xffff),
            (0b1010, 0x0fff_ffff, u32::MAX),
        ] {
            let grant = granted(resolution, |_| {}).unwrap();
            assert_eq!(
                (grant.sn_mask, grant.request_id_mask),
                (sn_mask, request_id_mask)
            );
        }
        for resolution in [0b0011, 0b1100, 0b1011, 0b1110] {
            assert_eq!(
                granted(resolution, |_| {}).unwrap_err(),
                SessionError::Handshake
            );
        }
    }

    #[test]
    fn what_was_not_offered_is_not_taken() {
        let change: [fn(&mut InitAck); 5] = [
            |ack| ack.batch_size = 2049,
            |ack| ack.batch_size = BATCH_BYTES_MIN - 1,
            |ack| ack.ext_patch = init::ext::PatchType::new(2),
            |ack| ack.ext_lowlatency = Some(init::ext::LowLatency::new()),
            |ack| ack.ext_compression = Some(init::ext::Compression::new()),
        ];
        for change in change {
            assert_eq!(
                granted(0b1010, change).unwrap_err(),
                SessionError::Handshake
            );
        }
        let grant = granted(0b1010, |ack| ack.ext_qos = Some(init::ext::QoS::new())).unwrap();
        assert!(!grant.qos, "priorities were not offered");
    }

    #[test]
    fn open_syn_says_its_lease_in_whole_seconds_where_it_can() {
        let grant = Grant {
            batch_bytes: 2048,
            sn_mask: sn_mask(Bits::U32),
            request_id_mask: u32::MAX,
            qos: false,
            markers: true,
            cookie: alloc::vec![1, 2, 3].into(),
            nonce: None,
        };
        let mut bytes = Vec::new();
        write_batch(&mut bytes, open_syn(&grant, 10_000_000, 5, None));
        assert_eq!(bytes, [7, 0, 0x42, 10, 5, 3, 1, 2, 3]);
    }

    #[test]
    fn the_answer_to_a_challenge_is_user_and_mac() {
        let credentials = Credentials {
            user: "n1".to_string(),
            password: "pw".to_string(),
        };
        let bytes = answer(&credentials, 0x0102_0304_0506_0708);
        assert_eq!(&bytes[..4], &[2, b'n', b'1', 32]);
        assert_eq!(bytes.len(), 36);
        assert_ne!(bytes, answer(&credentials, 1));
    }

    #[test]
    fn credentials_do_not_print_the_password() {
        let credentials = Credentials {
            user: "n1".to_string(),
            password: "secret".to_string(),
        };
        assert!(!alloc::format!("{credentials:?}").contains("secret"));
    }
}
