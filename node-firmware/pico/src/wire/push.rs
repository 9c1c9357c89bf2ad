//! A publication as it comes in, its key left in the batch.
//!
//! The codec reads a key into memory of its own; a node that hears a thousand values a second need
//! not ask the heap for each of them. So this message alone is read part by part, each by the codec.
//!
//! ```text
//!   | header: PUSH, flags N M Z | scope | N: suffix | Z: extensions | Put or Del |
//! ```

use zenoh_buffers::{ZSlice, reader::DidntRead};
use zenoh_codec::{RCodec, Zenoh080, Zenoh080Bounded, Zenoh080Header, common::extension};
use zenoh_protocol::{
    common::{iext, imsg},
    core::{ExprId, ExprLen},
    network::{
        Mapping,
        push::{ext, flag},
    },
    zenoh::PushBody,
};

/// What was published, and where.
#[derive(Debug)]
pub(crate) struct PushMessage {
    pub(crate) scope: ExprId,
    /// Whose number the scope is.
    pub(crate) mapping: Mapping,
    suffix: Option<ZSlice>,
    pub(crate) qos: ext::QoSType,
    pub(crate) body: PushBody,
}

impl PushMessage {
    /// Reads one; `rest` begins with its header.
    pub(crate) fn read(rest: &mut ZSlice) -> Result<Self, DidntRead> {
        let codec = Zenoh080::new();
        let header: u8 = codec.read(&mut *rest)?;
        let scope: ExprId = Zenoh080Bounded::<ExprId>::new().read(&mut *rest)?;
        let suffix: Option<ZSlice> = if imsg::has_flag(header, flag::N) {
            Some(Zenoh080Bounded::<ExprLen>::new().read(&mut *rest)?)
        } else {
            None
        };
        if suffix
            .as_deref()
            .is_some_and(|s| core::str::from_utf8(s).is_err())
        {
            return Err(DidntRead);
        }
        let mapping = if imsg::has_flag(header, flag::M) {
            Mapping::Sender
        } else {
            Mapping::Receiver
        };
        let mut qos = ext::QoSType::DEFAULT;
        let mut more = imsg::has_flag(header, flag::Z);
        while more {
            let header: u8 = codec.read(&mut *rest)?;
            more = match iext::eid(header) {
                ext::QoS::ID => {
                    let (read, more) = Zenoh080Header::new(header).read(&mut *rest)?;
                    qos = read;
                    more
                }
                // Those of the push itself: nobody here asks for them.
                ext::Timestamp::ID => {
                    let (_, more): (ext::TimestampType, bool) =
                        Zenoh080Header::new(header).read(&mut *rest)?;
                    more
                }
                ext::NodeId::ID => {
                    let (_, more): (ext::NodeIdType, bool) =
                        Zenoh080Header::new(header).read(&mut *rest)?;
                    more
                }
                ext::TsStack::ID => {
                    let (_, more): (ext::TsStackType, bool) =
                        Zenoh080Header::new(header).read(&mut *rest)?;
                    more
                }
                _ => extension::skip(&mut *rest, "Push", header)?,
            };
        }
        let body = codec.read(&mut *rest)?;
        Ok(Self {
            scope,
            mapping,
            suffix,
            qos,
            body,
        })
    }

    /// The part of the key behind the scope.
    pub(crate) fn suffix(&self) -> &str {
        let bytes = self.suffix.as_deref().unwrap_or_default();
        core::str::from_utf8(bytes).expect("it was read as text")
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use alloc::{vec, vec::Vec};
    use zenoh_codec::WCodec;
    use zenoh_protocol::{
        core::{Timestamp, TimestampId, WireExpr},
        network::Push,
        zenoh::{Del, Put},
    };

    fn pushes() -> Vec<Push> {
        let id = TimestampId::try_from([1u8].as_slice()).expect("not all 0");
        let put = Put {
            payload: vec![1, 2, 3].into(),
            ..Put::default()
        };
        let bodies = [PushBody::from(put), PushBody::from(Del::default())];
        let mut pushes = Vec::new();
        for (index, body) in bodies.into_iter().cycle().take(16).enumerate() {
            let mut push = Push::from(body);
            push.wire_expr = WireExpr {
                scope: [0, 300][index & 1],
                suffix: ["", "left/ä"][index >> 1 & 1].into(),
                mapping: [Mapping::Sender, Mapping::Receiver][index >> 2 & 1],
            };
            if index >> 3 & 1 == 1 {
                push.ext_qos = ext::QoSType::new(
                    zenoh_protocol::core::Priority::RealTime,
                    zenoh_protocol::core::CongestionControl::Block,
                    true,
                );
                push.ext_tstamp = Some(ext::TimestampType {
                    timestamp: Timestamp::new(zenoh_protocol::core::NTP64(7), id),
                });
                push.ext_nodeid = ext::NodeIdType { node_id: 9 };
            }
            pushes.push(push);
        }
        pushes
    }

    #[test]
    fn every_push_reads_as_the_official_codec_reads_it_and_no_part_of_one_panics() {
        for push in pushes() {
            let mut bytes = Vec::new();
            Zenoh080::new().write(&mut bytes, &push).expect("room");
            let length = bytes.len();
            bytes.push(0xff);
            let mut rest = ZSlice::from(bytes.clone());
            let read = PushMessage::read(&mut rest).expect("it is whole");
            assert_eq!(rest.as_ref(), [0xff]);
            assert_eq!(read.scope, push.wire_expr.scope);
            assert_eq!(read.mapping, push.wire_expr.mapping);
            assert_eq!(read.suffix(), push.wire_expr.suffix);
            assert_eq!(read.qos, push.ext_qos);
            assert_eq!(read.body, push.payload);
            for cut in 0..length {
                let mut part = ZSlice::from(bytes[..cut].to_vec());
                assert!(PushMessage::read(&mut part).is_err(), "{cut} of {length}");
            }
        }
    }

    #[test]
    fn a_key_that_is_no_text_is_refused() {
        let mut bytes = ZSlice::from(vec![0x3d, 0, 2, 0xff, 0xff, 1, 0]);
        assert!(PushMessage::read(&mut bytes).is_err());
    }
}
