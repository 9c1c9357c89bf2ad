//! A small router in virtual time, and a session of ours tied to it without a socket.
//!
//! ```text
//!  Session ──poll_transmit──▶ Peer::hear ──▶ heard: messages of the client
//!  Session ◀──handle_bytes─── Peer::say… ◀── the test
//! ```
//!
//! The peer speaks through the zenoh codec and checks what it hears as a router does: batch
//! lengths, sequence numbers of every priority, contiguous fragments.
#![allow(dead_code, reason = "each test file uses its part")]

use std::{collections::VecDeque, time::Duration};

use hmac::{Hmac, Mac};
use pico::{Event, Session, SessionConfig};
use sha3::Sha3_256;
use zenoh_buffers::{ZBuf, ZSlice, buffer::SplitBuffer, reader::HasReader};
use zenoh_codec::{RCodec, WCodec, Zenoh080, Zenoh080Reliability};
use zenoh_protocol::{
    common::{ZExtBody, ZExtUnknown, imsg},
    core::{Priority, Reliability, Resolution, WhatAmI, WireExpr, ZenohIdProto},
    network::{
        Declare, DeclareBody, DeclareFinal, Interest, Mapping, NetworkBody, NetworkMessage, Push,
        Request, Response, ResponseFinal, declare,
        interest::{self, InterestMode, InterestOptions},
        request, response,
    },
    transport::{
        Close, Fragment, FragmentHeader, FrameHeader, InitAck, InitSyn, KeepAlive, OpenAck,
        OpenSyn, TransportBody, TransportMessage, fragment, frame, id, init, open,
    },
    zenoh::{Put, Query, Reply, RequestBody, ResponseBody},
};

/// One second.
pub(crate) const SECOND_US: u64 = 1_000_000;
/// Sequence numbers have 28 bits at the default resolution.
pub(crate) const SN_MASK: u32 = u32::MAX >> 4;

/// What a scripted router grants.
#[derive(Clone)]
pub(crate) struct Grants {
    pub(crate) batch_bytes: u16,
    pub(crate) qos: bool,
    pub(crate) patch: u8,
    pub(crate) lease: Duration,
    pub(crate) initial_sn: u32,
    /// Demand this user and password.
    pub(crate) user: Option<(&'static str, &'static str)>,
    /// Answer the OpenSyn with a Close for this reason.
    pub(crate) refuse: Option<u8>,
}

impl Default for Grants {
    fn default() -> Self {
        Self {
            batch_bytes: u16::MAX,
            qos: true,
            patch: 1,
            lease: Duration::from_secs(10),
            initial_sn: 100,
            user: None,
            refuse: None,
        }
    }
}

/// The scripted router.
pub(crate) struct Peer {
    pub(crate) grants: Grants,
    /// What the client said in frames, with the priority of the frame.
    pub(crate) heard: VecDeque<(Priority, NetworkMessage)>,
    pub(crate) heard_keep_alives: usize,
    pub(crate) heard_close: Option<u8>,
    /// Session ids of all connections.
    pub(crate) zids: Vec<ZenohIdProto>,
    /// Length of every batch, prefix included.
    pub(crate) batch_lengths: Vec<usize>,
    /// How many frames and fragments came.
    pub(crate) heard_frames: usize,
    pub(crate) heard_fragments: usize,
    input: Vec<u8>,
    batch_bytes: u16,
    qos: bool,
    client_sn: [u32; 8],
    chains: [Option<Vec<u8>>; 8],
    own_sn: [u32; 8],
    said: Vec<u8>,
}

const NONCE: u64 = 0x0123_4567_89ab_cdef;

impl Peer {
    pub(crate) fn new(grants: Grants) -> Self {
        Self {
            own_sn: [grants.initial_sn; 8],
            grants,
            heard: VecDeque::new(),
            heard_keep_alives: 0,
            heard_close: None,
            zids: Vec::new(),
            batch_lengths: Vec::new(),
            heard_frames: 0,
            heard_fragments: 0,
            input: Vec::new(),
            batch_bytes: u16::MAX,
            qos: false,
            client_sn: [0; 8],
            chains: Default::default(),
            said: Vec::new(),
        }
    }

    /// Takes bytes of the client and checks them.
    pub(crate) fn hear(&mut self, bytes: &[u8]) {
        self.input.extend_from_slice(bytes);
        while self.input.len() >= 2 {
            let length = usize::from(u16::from_le_bytes([self.input[0], self.input[1]]));
            if self.input.len() < 2 + length {
                return;
            }
            assert!(length > 0, "an empty batch");
            assert!(
                length + 2 <= usize::from(self.batch_bytes),
                "a batch beyond the agreement"
            );
            self.batch_lengths.push(length + 2);
            let batch = self.input[2..2 + length].to_vec();
            self.input.drain(..2 + length);
            self.hear_batch(batch.into());
        }
    }

    /// Nothing of a batch is left over.
    pub(crate) fn heard_whole_batches(&self) -> bool {
        self.input.is_empty()
    }

    fn hear_batch(&mut self, mut rest: ZSlice) {
        let codec = Zenoh080::new();
        while let Some(header) = rest.first().copied() {
            match imsg::mid(header) {
                id::FRAME => {
                    let frame: FrameHeader = codec.read(&mut rest).expect("a frame header");
                    let lane = self.next_client_sn(frame.ext_qos.priority(), frame.sn);
                    assert!(
                        self.qos || self.chains[lane].is_none(),
                        "a frame inside a chain"
                    );
                    self.heard_frames += 1;
                    while rest.first().is_some_and(|h| imsg::mid(*h) >= 0x19) {
                        let reliability = Zenoh080Reliability::new(frame.reliability);
                        let message: NetworkMessage =
                            reliability.read(&mut rest).expect("a network message");
                        self.heard.push_back((frame.ext_qos.priority(), message));
                    }
                }
                id::FRAGMENT => {
                    let fragment: Fragment = codec.read(&mut rest).expect("a fragment");
                    self.hear_fragment(&fragment);
                }
                _ => {
                    let message: TransportMessage =
                        codec.read(&mut rest).expect("a transport message");
                    self.hear_transport(message);
                }
            }
        }
    }

    fn next_client_sn(&mut self, priority: Priority, sn: u32) -> usize {
        assert!(
            self.qos || priority == Priority::DEFAULT,
            "a priority that was not agreed"
        );
        let lane = if self.qos { priority as usize } else { 0 };
        assert_eq!(sn, self.client_sn[lane], "the client skips nothing");
        self.client_sn[lane] = (sn + 1) & SN_MASK;
        lane
    }

    fn hear_fragment(&mut self, fragment: &Fragment) {
        let priority = fragment.ext_qos.priority();
        let lane = self.next_client_sn(priority, fragment.sn);
        self.heard_fragments += 1;
        let markers = self.grants.patch >= 1;
        assert_eq!(
            fragment.ext_first.is_some(),
            markers && self.chains[lane].is_none()
        );
        let chain = self.chains[lane].get_or_insert_default();
        chain.extend_from_slice(&fragment.payload);
        if !fragment.more {
            let chain = self.chains[lane].take().expect("it was just filled");
            let reliability = Zenoh080Reliability::new(fragment.reliability);
            let message = reliability
                .read(&mut ZSlice::from(chain))
                .expect("a whole message");
            self.heard.push_back((priority, message));
        }
    }

    fn hear_transport(&mut self, message: TransportMessage) {
        match message.body {
            TransportBody::InitSyn(syn) => self.hear_init_syn(&syn),
            TransportBody::OpenSyn(syn) => self.hear_open_syn(&syn),
            TransportBody::KeepAlive(_) => self.heard_keep_alives += 1,
            TransportBody::Close(close) => self.heard_close = Some(close.reason),
            other => panic!("a client does not say {other:?}"),
        }
    }

    fn hear_init_syn(&mut self, syn: &InitSyn) {
        assert_eq!((syn.version, syn.whatami), (9, WhatAmI::Client));
        self.zids.push(syn.zid);
        self.qos = self.grants.qos && syn.ext_qos.is_some();
        let granted = self.grants.batch_bytes.min(syn.batch_size);
        let ack = InitAck {
            version: 9,
            whatami: WhatAmI::Router,
            zid: ZenohIdProto::try_from([1u8].as_slice()).unwrap(),
            resolution: Resolution::default(),
            batch_size: granted,
            cookie: vec![0xc0; 33].into(),
            ext_qos: self.qos.then(init::ext::QoS::new),
            ext_qos_link: None,
            ext_auth: self.grants.user.map(|_| {
                let nonce = ZExtUnknown::new(2, false, ZExtBody::Z64(NONCE));
                init::ext::Auth::new(methods(&[nonce]))
            }),
            ext_mlink: None,
            ext_lowlatency: None,
            ext_compression: None,
            ext_patch: init::ext::PatchType::new(self.grants.patch),
            ext_region_name: None,
        };
        self.say_transport(ack);
        self.batch_bytes = granted;
    }

    fn hear_open_syn(&mut self, syn: &OpenSyn) {
        assert_eq!(&*syn.cookie, &[0xc0; 33]);
        assert_eq!(syn.initial_sn & !SN_MASK, 0);
        self.client_sn = [syn.initial_sn; 8];
        let known = match self.grants.user {
            None => true,
            Some((user, password)) => syn.ext_auth.as_ref().is_some_and(|auth| {
                let exts: Vec<ZExtUnknown> =
                    Zenoh080::new().read(&mut auth.value.reader()).unwrap();
                let ZExtBody::ZBuf(answer) = &exts[0].body else {
                    return false;
                };
                let key = NONCE.to_le_bytes();
                let mut mac = Hmac::<Sha3_256>::new_from_slice(&key).unwrap();
                mac.update(password.as_bytes());
                let mut expected = vec![user.len() as u8];
                expected.extend_from_slice(user.as_bytes());
                expected.push(32);
                expected.extend_from_slice(&mac.finalize().into_bytes());
                *answer.contiguous() == *expected
            }),
        };
        if let Some(reason) = self.grants.refuse.or((!known).then_some(0)) {
            return self.say_transport(Close {
                reason,
                session: false,
            });
        }
        let ack = OpenAck {
            lease: self.grants.lease,
            initial_sn: self.grants.initial_sn,
            ext_qos: None,
            ext_auth: self.grants.user.map(|_| {
                let accepted = ZExtUnknown::new(2, false, ZExtBody::Unit);
                open::ext::Auth::new(methods(&[accepted]))
            }),
            ext_mlink: None,
            ext_lowlatency: None,
            ext_compression: None,
            ext_remote_bound: None,
        };
        self.say_transport(ack);
    }

    /// What was said since the last time.
    pub(crate) fn take_said(&mut self) -> Vec<u8> {
        std::mem::take(&mut self.said)
    }

    /// Says a batch of these bytes, whatever they are.
    pub(crate) fn say_batch(&mut self, batch: &[u8]) {
        self.said
            .extend_from_slice(&(batch.len() as u16).to_le_bytes());
        self.said.extend_from_slice(batch);
    }

    pub(crate) fn say_transport(&mut self, message: impl Into<TransportMessage>) {
        let mut batch = Vec::new();
        Zenoh080::new().write(&mut batch, &message.into()).unwrap();
        self.say_batch(&batch);
    }

    pub(crate) fn say_keep_alive(&mut self) {
        self.say_transport(KeepAlive);
    }

    /// Takes the next number of a priority; none is left out.
    pub(crate) fn next_sn(&mut self, priority: Priority) -> u32 {
        let lane = if self.qos { priority as usize } else { 0 };
        let sn = self.own_sn[lane];
        self.own_sn[lane] = (sn + 1) & SN_MASK;
        sn
    }

    /// Says messages in one frame of the default priority.
    pub(crate) fn say(&mut self, messages: impl IntoIterator<Item = NetworkBody>) {
        let sn = self.next_sn(Priority::DEFAULT);
        self.say_frame(Priority::DEFAULT, sn, messages);
    }

    pub(crate) fn say_frame(
        &mut self,
        priority: Priority,
        sn: u32,
        messages: impl IntoIterator<Item = NetworkBody>,
    ) {
        let header = FrameHeader {
            reliability: Reliability::Reliable,
            sn,
            ext_qos: frame::ext::QoSType::new(priority),
        };
        let mut batch = Vec::new();
        Zenoh080::new().write(&mut batch, &header).unwrap();
        for message in messages {
            batch.extend(bytes(message));
        }
        self.say_batch(&batch);
    }

    /// Says one fragment.
    pub(crate) fn say_fragment(&mut self, sn: u32, marks: Marks, payload: &[u8]) {
        let header = FragmentHeader {
            reliability: Reliability::Reliable,
            more: marks.more,
            sn,
            ext_qos: fragment::ext::QoSType::DEFAULT,
            ext_first: marks.first.then(fragment::ext::First::new),
            ext_drop: marks.drop.then(fragment::ext::Drop::new),
        };
        let mut batch = Vec::new();
        Zenoh080::new().write(&mut batch, &header).unwrap();
        batch.extend_from_slice(payload);
        self.say_batch(&batch);
    }

    /// Says a message in fragments of a length, as a router does: afterwards it skips a number.
    pub(crate) fn say_fragmented(&mut self, message: NetworkBody, fragment_bytes: usize) {
        let bytes = bytes(message);
        let count = bytes.len().div_ceil(fragment_bytes);
        for (index, chunk) in bytes.chunks(fragment_bytes).enumerate() {
            let sn = self.next_sn(Priority::DEFAULT);
            let marks = Marks {
                first: index == 0 && self.grants.patch >= 1,
                more: index + 1 < count,
                drop: false,
            };
            self.say_fragment(sn, marks, chunk);
        }
        self.next_sn(Priority::DEFAULT);
    }
}

/// Markers of a fragment.
#[derive(Clone, Copy, Default)]
pub(crate) struct Marks {
    pub(crate) first: bool,
    pub(crate) more: bool,
    pub(crate) drop: bool,
}

fn methods(methods: &[ZExtUnknown]) -> ZBuf {
    let mut bytes = Vec::new();
    Zenoh080::new().write(&mut bytes, methods).unwrap();
    bytes.into()
}

/// The bytes of a network message.
pub(crate) fn bytes(message: NetworkBody) -> Vec<u8> {
    let mut bytes = Vec::new();
    Zenoh080::new()
        .write(&mut bytes, &NetworkMessage::from(message))
        .unwrap();
    bytes
}

/// A key in full.
pub(crate) fn key(key: &str) -> WireExpr<'static> {
    WireExpr::from(key).to_owned()
}

/// A key by a number that the client declared, and the rest of it.
pub(crate) fn client_key(id: u16, suffix: &str) -> WireExpr<'static> {
    WireExpr {
        scope: id,
        suffix: suffix.to_string().into(),
        mapping: Mapping::Receiver,
    }
}

/// A key by a number that the peer declared, and the rest of it.
pub(crate) fn peer_key(id: u16, suffix: &str) -> WireExpr<'static> {
    WireExpr {
        scope: id,
        suffix: suffix.to_string().into(),
        mapping: Mapping::Sender,
    }
}

pub(crate) fn push(key: WireExpr<'static>, payload: &[u8]) -> NetworkBody {
    let put = Put {
        payload: payload.to_vec().into(),
        ..Put::default()
    };
    NetworkBody::Push(Push {
        wire_expr: key,
        ..Push::from(zenoh_protocol::zenoh::PushBody::from(put))
    })
}

pub(crate) fn declare(interest_id: Option<u32>, body: DeclareBody) -> NetworkBody {
    NetworkBody::Declare(Declare {
        interest_id,
        ext_qos: declare::ext::QoSType::DECLARE,
        ext_tstamp: None,
        ext_nodeid: declare::ext::NodeIdType::DEFAULT,
        body,
    })
}

pub(crate) fn declare_key(id: u16, wire_expr: WireExpr<'static>) -> NetworkBody {
    declare(
        None,
        DeclareBody::DeclareKeyExpr(declare::DeclareKeyExpr { id, wire_expr }),
    )
}

pub(crate) fn declare_subscriber(
    interest_id: Option<u32>,
    id: u32,
    wire_expr: WireExpr<'static>,
) -> NetworkBody {
    let body = declare::DeclareSubscriber { id, wire_expr };
    declare(interest_id, DeclareBody::DeclareSubscriber(body))
}

pub(crate) fn undeclare_subscriber(id: u32) -> NetworkBody {
    let ext_wire_expr = declare::common::ext::WireExprType::null();
    let body = declare::UndeclareSubscriber { id, ext_wire_expr };
    declare(None, DeclareBody::UndeclareSubscriber(body))
}

pub(crate) fn declare_token(
    interest_id: Option<u32>,
    id: u32,
    wire_expr: WireExpr<'static>,
) -> NetworkBody {
    declare(
        interest_id,
        DeclareBody::DeclareToken(declare::DeclareToken { id, wire_expr }),
    )
}

pub(crate) fn undeclare_token(id: u32) -> NetworkBody {
    let ext_wire_expr = declare::common::ext::WireExprType::null();
    declare(
        None,
        DeclareBody::UndeclareToken(declare::UndeclareToken { id, ext_wire_expr }),
    )
}

pub(crate) fn declare_final(interest_id: u32) -> NetworkBody {
    declare(Some(interest_id), DeclareBody::DeclareFinal(DeclareFinal))
}

/// Asks for all that is declared now.
pub(crate) fn interest(id: u32) -> NetworkBody {
    NetworkBody::Interest(Interest {
        id,
        mode: InterestMode::Current,
        options: InterestOptions::ALL,
        wire_expr: None,
        ext_qos: interest::ext::QoSType::INTEREST,
        ext_tstamp: None,
        ext_nodeid: interest::ext::NodeIdType::DEFAULT,
    })
}

pub(crate) fn query(id: u32, wire_expr: WireExpr<'static>) -> NetworkBody {
    NetworkBody::Request(Request {
        id,
        wire_expr,
        ext_qos: request::ext::QoSType::DEFAULT,
        ext_tstamp: None,
        ext_nodeid: request::ext::NodeIdType::DEFAULT,
        ext_target: request::ext::QueryTarget::DEFAULT,
        ext_budget: None,
        ext_timeout: Some(Duration::from_secs(5)),
        ext_ts_stack: None,
        payload: RequestBody::Query(Query::default()),
    })
}

pub(crate) fn reply(rid: u32, wire_expr: WireExpr<'static>, payload: &[u8]) -> NetworkBody {
    let put = Put {
        payload: payload.to_vec().into(),
        ..Put::default()
    };
    NetworkBody::Response(Response {
        rid,
        wire_expr,
        payload: ResponseBody::Reply(Reply {
            consolidation: zenoh_protocol::zenoh::ConsolidationMode::DEFAULT,
            ext_unknown: Vec::new(),
            payload: put.into(),
        }),
        ext_qos: response::ext::QoSType::DEFAULT,
        ext_tstamp: None,
        ext_respid: None,
        ext_ts_stack: None,
    })
}

pub(crate) fn reply_final(rid: u32) -> NetworkBody {
    NetworkBody::ResponseFinal(ResponseFinal {
        rid,
        ext_qos: response::ext::QoSType::DEFAULT,
        ext_tstamp: None,
    })
}

/// The stream was cut.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Cut;

/// A session tied to a peer.
pub(crate) struct Rig {
    pub(crate) session: Session,
    pub(crate) peer: Peer,
    pub(crate) now_us: u64,
    pub(crate) events: Vec<Event>,
    /// Cut the stream after so many more bytes towards the session.
    pub(crate) cut_after_bytes: Option<usize>,
    /// Bytes that went to the session.
    pub(crate) delivered_bytes: usize,
}

impl Rig {
    pub(crate) fn new(config: SessionConfig, grants: Grants) -> Self {
        Self {
            session: Session::new(config, 42),
            peer: Peer::new(grants),
            now_us: 5 * SECOND_US,
            events: Vec::new(),
            cut_after_bytes: None,
            delivered_bytes: 0,
        }
    }

    /// A rig whose session is open and whose events are taken.
    pub(crate) fn opened(config: SessionConfig, grants: Grants) -> Self {
        let mut rig = Self::new(config, grants);
        rig.connect();
        rig.exchange().unwrap();
        assert_eq!(rig.take_events(), [Event::Opened]);
        rig
    }

    pub(crate) fn plain() -> Self {
        Self::opened(SessionConfig::default(), Grants::default())
    }

    /// Ties the session to a fresh peer with the same grants.
    pub(crate) fn connect(&mut self) {
        let zids = std::mem::take(&mut self.peer.zids);
        self.peer = Peer::new(self.peer.grants.clone());
        self.peer.zids = zids;
        self.session.handle_connected(self.now_us);
    }

    /// Carries bytes both ways until nobody has anything to say.
    pub(crate) fn exchange(&mut self) -> Result<(), Cut> {
        loop {
            let mut out = Vec::new();
            while self.session.poll_transmit(self.now_us, &mut out) > 0 {}
            self.peer.hear(&out);
            let said = self.peer.take_said();
            if out.is_empty() && said.is_empty() {
                return Ok(());
            }
            self.deliver(&said)?;
        }
    }

    fn deliver(&mut self, said: &[u8]) -> Result<(), Cut> {
        let whole_bytes = said.len();
        let carried_bytes = self.cut_after_bytes.unwrap_or(usize::MAX).min(whole_bytes);
        self.delivered_bytes += carried_bytes;
        let taken = self
            .session
            .handle_bytes(self.now_us, &said[..carried_bytes]);
        while let Some(event) = self.session.poll_event() {
            self.events.push(event);
        }
        if taken.is_err() {
            self.session.handle_disconnected(self.now_us);
            return Err(Cut);
        }
        if let Some(left_bytes) = &mut self.cut_after_bytes {
            *left_bytes -= carried_bytes;
            if *left_bytes == 0 {
                self.cut_after_bytes = None;
                self.session.handle_disconnected(self.now_us);
                return Err(Cut);
            }
        }
        Ok(())
    }

    /// Lets time pass, doing what is due when it is due.
    pub(crate) fn advance(&mut self, us: u64) {
        let end_us = self.now_us + us;
        while let Some(at_us) = self.session.poll_timeout().filter(|at_us| *at_us <= end_us) {
            self.now_us = self.now_us.max(at_us);
            if self.session.wants_connection(self.now_us) {
                break;
            }
            self.session.handle_timeout(self.now_us);
            let _ = self.exchange();
        }
        self.now_us = end_us;
    }

    /// All events since the last time.
    pub(crate) fn take_events(&mut self) -> Vec<Event> {
        while let Some(event) = self.session.poll_event() {
            self.events.push(event);
        }
        std::mem::take(&mut self.events)
    }

    /// The bodies that the peer heard since the last time.
    pub(crate) fn take_heard(&mut self) -> Vec<NetworkBody> {
        self.peer
            .heard
            .drain(..)
            .map(|(_, message)| message.body)
            .collect()
    }
}
