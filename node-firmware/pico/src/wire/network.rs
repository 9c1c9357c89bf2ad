//! What is said in frames: publications, declarations, questions and answers.
//!
//! Writing appends the official bytes to a buffer without an intermediate copy of the payload: a
//! payload is the last field of its message, so the message is encoded with an empty one, whose
//! only byte is the length 0, and length and payload take that byte's place.

use alloc::{borrow::Cow, string::String, vec::Vec};
use core::time::Duration;

use zenoh_buffers::{ZBuf, buffer::SplitBuffer, writer::DidntWrite};
use zenoh_codec::{WCodec, Zenoh080};
use zenoh_protocol::{
    core::{
        CongestionControl, Encoding as WireEncoding, ExprId, Priority as WirePriority, Reliability,
        WireExpr,
    },
    network::{
        Declare, DeclareBody, Interest, Mapping, NetworkBodyRef, NetworkMessageRef, Push, Request,
        Response, ResponseFinal, declare, ext::QoSType, interest, push, request, response,
    },
    zenoh::{
        ConsolidationMode, Del, Err as WireErr, PushBody, Put, Query, Reply, RequestBody,
        ResponseBody, put, query,
    },
};

use crate::{
    event::{
        Congestion, Consolidation, Encoding, GetOptions, Priority, PutOptions, QueryTarget, Sample,
        SampleKind,
    },
    key::Key,
};

/// A key as it goes onto the wire.
#[derive(Debug, Clone, Copy)]
pub(crate) enum WireKey<'a> {
    /// The number that we declared for it.
    Id(ExprId),
    /// In full.
    Full(&'a str),
}

impl WireKey<'_> {
    fn to_expr(self) -> WireExpr<'static> {
        match self {
            Self::Id(scope) => WireExpr {
                scope,
                suffix: Cow::Borrowed(""),
                mapping: Mapping::Sender,
            },
            Self::Full(key) => WireExpr {
                scope: 0,
                suffix: Cow::Owned(String::from(key)),
                mapping: Mapping::Sender,
            },
        }
    }

    fn len(self) -> usize {
        match self {
            Self::Id(_) => 1,
            Self::Full(key) => key.len(),
        }
    }
}

/// A lower bound of what a message takes, to refuse it before it is encoded.
pub(crate) fn bytes_hint(key: WireKey<'_>, payload: &[u8], attachment: Option<&Vec<u8>>) -> usize {
    key.len() + payload.len() + attachment.map_or(0, Vec::len)
}

fn write(out: &mut Vec<u8>, body: NetworkBodyRef<'_>) -> Result<(), DidntWrite> {
    let message = NetworkMessageRef {
        body,
        reliability: Reliability::Reliable,
    };
    Zenoh080::new().write(out, message)
}

/// Replaces the empty payload that ends the message in `out`.
fn replace_payload(out: &mut Vec<u8>, payload: &[u8]) -> Result<(), DidntWrite> {
    if payload.is_empty() {
        return Ok(());
    }
    if u32::try_from(payload.len()).is_err() {
        return Err(DidntWrite);
    }
    let length = out.pop();
    debug_assert_eq!(length, Some(0), "a message ends with its payload");
    Zenoh080::new().write(out, payload)
}

pub(crate) fn write_push(
    out: &mut Vec<u8>,
    key: WireKey<'_>,
    kind: SampleKind,
    payload: &[u8],
    options: &PutOptions,
) -> Result<(), DidntWrite> {
    let push = Push {
        wire_expr: key.to_expr(),
        ext_qos: qos(options.priority, options.congestion, options.express),
        ext_tstamp: None,
        ext_nodeid: push::ext::NodeIdType::DEFAULT,
        ext_ts_stack: None,
        payload: push_body(kind, options),
    };
    write(out, NetworkBodyRef::Push(&push))?;
    match kind {
        SampleKind::Put => replace_payload(out, payload),
        SampleKind::Delete => Ok(()),
    }
}

pub(crate) fn write_query(
    out: &mut Vec<u8>,
    id: u32,
    key: WireKey<'_>,
    parameters: &str,
    payload: Option<&[u8]>,
    options: &GetOptions,
) -> Result<(), DidntWrite> {
    let ext_body = payload.map(|payload| query::ext::QueryBodyType {
        encoding: wire_encoding(&options.encoding),
        payload: payload.to_vec().into(),
    });
    let request = Request {
        id,
        wire_expr: key.to_expr(),
        ext_qos: qos(options.priority, options.congestion, options.express),
        ext_tstamp: None,
        ext_nodeid: request::ext::NodeIdType::DEFAULT,
        ext_target: match options.target {
            QueryTarget::BestMatching => request::ext::QueryTarget::BestMatching,
            QueryTarget::All => request::ext::QueryTarget::All,
            QueryTarget::AllComplete => request::ext::QueryTarget::AllComplete,
        },
        ext_budget: None,
        ext_timeout: Some(Duration::from_micros(options.timeout_us)),
        ext_ts_stack: None,
        payload: RequestBody::Query(Query {
            consolidation: match options.consolidation {
                Consolidation::Auto => ConsolidationMode::Auto,
                Consolidation::None => ConsolidationMode::None,
                Consolidation::Monotonic => ConsolidationMode::Monotonic,
                Consolidation::Latest => ConsolidationMode::Latest,
            },
            parameters: String::from(parameters),
            ext_sinfo: None,
            ext_body,
            ext_attachment: options
                .attachment
                .as_ref()
                .map(|a| query::ext::AttachmentType {
                    buffer: a.clone().into(),
                }),
            ext_unknown: Vec::new(),
        }),
    };
    write(out, NetworkBodyRef::Request(&request))
}

pub(crate) fn write_reply(
    out: &mut Vec<u8>,
    id: u32,
    key: WireKey<'_>,
    kind: SampleKind,
    payload: &[u8],
    options: &PutOptions,
) -> Result<(), DidntWrite> {
    let reply = ResponseBody::Reply(Reply {
        consolidation: ConsolidationMode::DEFAULT,
        ext_unknown: Vec::new(),
        payload: push_body(kind, options),
    });
    write_response(
        out,
        id,
        key,
        reply,
        qos(options.priority, options.congestion, options.express),
    )?;
    match kind {
        SampleKind::Put => replace_payload(out, payload),
        SampleKind::Delete => Ok(()),
    }
}

pub(crate) fn write_reply_error(
    out: &mut Vec<u8>,
    id: u32,
    key: WireKey<'_>,
    payload: &[u8],
    encoding: &Encoding,
) -> Result<(), DidntWrite> {
    let error = ResponseBody::Err(WireErr {
        encoding: wire_encoding(encoding),
        ext_sinfo: None,
        ext_unknown: Vec::new(),
        payload: ZBuf::empty(),
    });
    write_response(
        out,
        id,
        key,
        error,
        qos(Priority::Data, Congestion::Block, false),
    )?;
    replace_payload(out, payload)
}

fn write_response(
    out: &mut Vec<u8>,
    rid: u32,
    key: WireKey<'_>,
    payload: ResponseBody,
    ext_qos: response::ext::QoSType,
) -> Result<(), DidntWrite> {
    let response = Response {
        rid,
        wire_expr: key.to_expr(),
        payload,
        ext_qos,
        ext_tstamp: None,
        ext_respid: None,
        ext_ts_stack: None,
    };
    write(out, NetworkBodyRef::Response(&response))
}

pub(crate) fn write_reply_final(out: &mut Vec<u8>, rid: u32) -> Result<(), DidntWrite> {
    let ext_qos = qos(Priority::Data, Congestion::Block, false);
    let last = ResponseFinal {
        rid,
        ext_qos,
        ext_tstamp: None,
    };
    write(out, NetworkBodyRef::ResponseFinal(&last))
}

pub(crate) fn write_declare(
    out: &mut Vec<u8>,
    interest_id: Option<u32>,
    body: DeclareBody,
) -> Result<(), DidntWrite> {
    let declare = Declare {
        interest_id,
        ext_qos: declare::ext::QoSType::DECLARE,
        ext_tstamp: None,
        ext_nodeid: declare::ext::NodeIdType::DEFAULT,
        body,
    };
    write(out, NetworkBodyRef::Declare(&declare))
}

pub(crate) fn declare_key(id: ExprId, key: &str) -> DeclareBody {
    DeclareBody::DeclareKeyExpr(declare::DeclareKeyExpr {
        id,
        wire_expr: WireKey::Full(key).to_expr(),
    })
}

pub(crate) fn undeclare_key(id: ExprId) -> DeclareBody {
    DeclareBody::UndeclareKeyExpr(declare::UndeclareKeyExpr { id })
}

pub(crate) fn declare_subscriber(id: u32, key: ExprId) -> DeclareBody {
    DeclareBody::DeclareSubscriber(declare::DeclareSubscriber {
        id,
        wire_expr: WireKey::Id(key).to_expr(),
    })
}

pub(crate) fn undeclare_subscriber(id: u32) -> DeclareBody {
    DeclareBody::UndeclareSubscriber(declare::UndeclareSubscriber {
        id,
        ext_wire_expr: declare::common::ext::WireExprType::null(),
    })
}

pub(crate) fn declare_queryable(id: u32, key: ExprId, complete: bool) -> DeclareBody {
    DeclareBody::DeclareQueryable(declare::DeclareQueryable {
        id,
        wire_expr: WireKey::Id(key).to_expr(),
        ext_info: declare::queryable::ext::QueryableInfoType {
            complete,
            distance: 0,
        },
    })
}

pub(crate) fn undeclare_queryable(id: u32) -> DeclareBody {
    DeclareBody::UndeclareQueryable(declare::UndeclareQueryable {
        id,
        ext_wire_expr: declare::common::ext::WireExprType::null(),
    })
}

pub(crate) fn declare_token(id: u32, key: ExprId) -> DeclareBody {
    DeclareBody::DeclareToken(declare::DeclareToken {
        id,
        wire_expr: WireKey::Id(key).to_expr(),
    })
}

pub(crate) fn undeclare_token(id: u32) -> DeclareBody {
    DeclareBody::UndeclareToken(declare::UndeclareToken {
        id,
        ext_wire_expr: declare::common::ext::WireExprType::null(),
    })
}

pub(crate) fn declare_final() -> DeclareBody {
    DeclareBody::DeclareFinal(declare::DeclareFinal)
}

/// Asks to be told, now and from now on, who subscribes to keys that meet `key`.
pub(crate) fn write_interest_in_subscribers(
    out: &mut Vec<u8>,
    id: u32,
    key: WireKey<'_>,
) -> Result<(), DidntWrite> {
    use interest::InterestOptions;
    let options =
        InterestOptions::KEYEXPRS + InterestOptions::SUBSCRIBERS + InterestOptions::AGGREGATE;
    write_interest(
        out,
        id,
        interest::InterestMode::CurrentFuture,
        options,
        Some(key),
    )
}

/// Asks to be told, now and from now on, of tokens whose keys meet `key`.
pub(crate) fn write_interest_in_tokens(
    out: &mut Vec<u8>,
    id: u32,
    key: WireKey<'_>,
) -> Result<(), DidntWrite> {
    use interest::InterestOptions;
    let options = InterestOptions::KEYEXPRS + InterestOptions::TOKENS;
    write_interest(
        out,
        id,
        interest::InterestMode::CurrentFuture,
        options,
        Some(key),
    )
}

/// Ends an interest.
pub(crate) fn write_interest_final(out: &mut Vec<u8>, id: u32) -> Result<(), DidntWrite> {
    let options = interest::InterestOptions::empty();
    write_interest(out, id, interest::InterestMode::Final, options, None)
}

fn write_interest(
    out: &mut Vec<u8>,
    id: u32,
    mode: interest::InterestMode,
    options: interest::InterestOptions,
    key: Option<WireKey<'_>>,
) -> Result<(), DidntWrite> {
    let interest = Interest {
        id,
        mode,
        options,
        wire_expr: key.map(WireKey::to_expr),
        ext_qos: interest::ext::QoSType::INTEREST,
        ext_tstamp: None,
        ext_nodeid: interest::ext::NodeIdType::DEFAULT,
    };
    write(out, NetworkBodyRef::Interest(&interest))
}

fn qos<const ID: u8>(priority: Priority, congestion: Congestion, express: bool) -> QoSType<ID> {
    let priority = match priority {
        Priority::RealTime => WirePriority::RealTime,
        Priority::InteractiveHigh => WirePriority::InteractiveHigh,
        Priority::InteractiveLow => WirePriority::InteractiveLow,
        Priority::DataHigh => WirePriority::DataHigh,
        Priority::Data => WirePriority::Data,
        Priority::DataLow => WirePriority::DataLow,
        Priority::Background => WirePriority::Background,
    };
    let congestion = match congestion {
        Congestion::Drop => CongestionControl::Drop,
        Congestion::Block => CongestionControl::Block,
    };
    QoSType::new(priority, congestion, express)
}

/// A body with everything but the payload.
fn push_body(kind: SampleKind, options: &PutOptions) -> PushBody {
    match kind {
        SampleKind::Put => PushBody::Put(Put {
            timestamp: options.timestamp,
            encoding: wire_encoding(&options.encoding),
            ext_sinfo: None,
            ext_attachment: options
                .attachment
                .as_ref()
                .map(|a| put::ext::AttachmentType {
                    buffer: a.clone().into(),
                }),
            ext_unknown: Vec::new(),
            payload: ZBuf::empty(),
        }),
        SampleKind::Delete => PushBody::Del(Del {
            timestamp: options.timestamp,
            ext_sinfo: None,
            ext_attachment: options.attachment.as_ref().map(|a| {
                zenoh_protocol::zenoh::del::ext::AttachmentType {
                    buffer: a.clone().into(),
                }
            }),
            ext_unknown: Vec::new(),
        }),
    }
}

fn wire_encoding(encoding: &Encoding) -> WireEncoding {
    WireEncoding {
        id: encoding.id,
        schema: encoding.schema.clone().map(Into::into),
    }
}

/// An encoding that was received.
pub(crate) fn encoding(encoding: WireEncoding) -> Encoding {
    Encoding {
        id: encoding.id,
        schema: encoding.schema.map(|schema| schema.to_vec()),
    }
}

/// A payload that was received.
pub(crate) fn bytes(buffer: &ZBuf) -> Vec<u8> {
    buffer.contiguous().into_owned()
}

/// How a message travelled that was received.
pub(crate) fn sample_qos<const ID: u8>(ext_qos: QoSType<ID>) -> (Priority, Congestion, bool) {
    let priority = match ext_qos.get_priority() {
        // Nobody publishes above real time.
        WirePriority::Control | WirePriority::RealTime => Priority::RealTime,
        WirePriority::InteractiveHigh => Priority::InteractiveHigh,
        WirePriority::InteractiveLow => Priority::InteractiveLow,
        WirePriority::DataHigh => Priority::DataHigh,
        WirePriority::Data => Priority::Data,
        WirePriority::DataLow => Priority::DataLow,
        WirePriority::Background => Priority::Background,
    };
    let congestion = match ext_qos.get_congestion_control() {
        CongestionControl::Block => Congestion::Block,
        _ => Congestion::Drop,
    };
    (priority, congestion, ext_qos.is_express())
}

/// A sample that was received.
pub(crate) fn sample<const ID: u8>(key: Key, ext_qos: QoSType<ID>, body: PushBody) -> Sample {
    let (priority, congestion, express) = sample_qos(ext_qos);
    match body {
        PushBody::Put(put) => Sample {
            key,
            payload: bytes(&put.payload),
            kind: SampleKind::Put,
            encoding: encoding(put.encoding),
            attachment: put.ext_attachment.map(|a| bytes(&a.buffer)),
            timestamp: put.timestamp,
            priority,
            congestion,
            express,
        },
        PushBody::Del(del) => Sample {
            key,
            payload: Vec::new(),
            kind: SampleKind::Delete,
            encoding: Encoding::default(),
            attachment: del.ext_attachment.map(|a| bytes(&a.buffer)),
            timestamp: del.timestamp,
            priority,
            congestion,
            express,
        },
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn official(body: NetworkBodyRef<'_>) -> Vec<u8> {
        let mut bytes = Vec::new();
        write(&mut bytes, body).unwrap();
        bytes
    }

    fn options() -> PutOptions {
        PutOptions {
            encoding: Encoding {
                id: 300,
                schema: Some(b"utf-8".to_vec()),
            },
            attachment: Some(alloc::vec![0, 0, 0]),
            priority: Priority::RealTime,
            congestion: Congestion::Block,
            express: true,
            timestamp: None,
        }
    }

    #[test]
    fn a_put_has_the_bytes_of_the_official_codec_for_every_length() {
        for payload_bytes in [0, 1, 2, 127, 128, 300, 20_000] {
            let payload: Vec<u8> = (0..payload_bytes).map(|i| i as u8).collect();
            for options in [PutOptions::default(), options()] {
                let mut bytes = Vec::new();
                let key = WireKey::Full("fleet/node/left/status");
                write_push(&mut bytes, key, SampleKind::Put, &payload, &options).unwrap();
                let mut body = push_body(SampleKind::Put, &options);
                let PushBody::Put(put) = &mut body else {
                    unreachable!()
                };
                put.payload = payload.clone().into();
                let push = Push {
                    wire_expr: key.to_expr(),
                    ext_qos: qos(options.priority, options.congestion, options.express),
                    ..Push::from(body)
                };
                assert_eq!(bytes, official(NetworkBodyRef::Push(&push)));
            }
        }
    }

    #[test]
    fn a_put_by_number_has_these_bytes() {
        let mut bytes = Vec::new();
        let options = PutOptions::default();
        write_push(&mut bytes, WireKey::Id(3), SampleKind::Put, b"hi", &options).unwrap();
        // Push with sender mapping, number 3; Put; 2 bytes.
        assert_eq!(bytes, [0x5d, 3, 0x01, 2, b'h', b'i']);
    }

    #[test]
    fn an_error_reply_has_the_bytes_of_the_official_codec() {
        let mut bytes = Vec::new();
        let key = WireKey::Full("a/b");
        let encoding = Encoding {
            id: 1,
            schema: None,
        };
        write_reply_error(&mut bytes, 9, key, b"no", &encoding).unwrap();
        let response = Response {
            rid: 9,
            wire_expr: key.to_expr(),
            payload: ResponseBody::Err(WireErr {
                encoding: wire_encoding(&encoding),
                ext_sinfo: None,
                ext_unknown: Vec::new(),
                payload: b"no".to_vec().into(),
            }),
            ext_qos: qos(Priority::Data, Congestion::Block, false),
            ext_tstamp: None,
            ext_respid: None,
            ext_ts_stack: None,
        };
        assert_eq!(bytes, official(NetworkBodyRef::Response(&response)));
    }
}
