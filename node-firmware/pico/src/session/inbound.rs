//! What the peer says, message by message.
//!
//! Decoding pauses between messages when enough events wait, so the event queue is bounded by
//! [`EVENTS_MAX`](limits::EVENTS_MAX) plus what one message can cause: one event for each of our
//! subscribers or publishers.

use alloc::{string::String, vec::Vec};

use zenoh_buffers::ZSlice;
use zenoh_codec::{RCodec, Zenoh080, Zenoh080Reliability};
use zenoh_keyexpr::keyexpr;
use zenoh_protocol::{
    common::imsg,
    core::Reliability,
    network::{
        Declare, DeclareBody, Interest, Mapping, NetworkBody, NetworkMessage, Request, Response,
        request::ext::QueryTarget as WireTarget,
    },
    transport::{
        Close, FragmentHeader, FrameHeader, InitAck, KeepAlive, Oam, OpenAck, id, init, open,
    },
    zenoh::{RequestBody, ResponseBody},
};

use super::{Decoding, Link, Session};
use crate::{
    declarations::{Kind, lane},
    event::{
        CloseReason, Encoding, Event, InboundQuery, LivelinessId, PeerReason, PublisherId, QueryId,
        QueryableId, SessionError, SubscriberId,
    },
    limits,
    queries::{QueryIn, QueryOut},
    transmit::LANE_CONTROL,
    wire::{handshake, network, push::PushMessage},
};

impl Session {
    /// Decodes input until it ends, the conversation ends, or enough events wait.
    pub(super) fn decode(&mut self) -> Result<(), SessionError> {
        while self.events.len() < limits::EVENTS_MAX && !matches!(self.link, Link::Closed) {
            let mut decoding = match self.decoding.take() {
                Some(decoding) => decoding,
                None => match self.reader.next_batch()? {
                    Some(batch) => Decoding {
                        rest: self.batch.hold(batch),
                        frame: None,
                    },
                    None => return Ok(()),
                },
            };
            self.decode_next(&mut decoding)?;
            if !decoding.rest.is_empty() && !matches!(self.link, Link::Closed) {
                self.decoding = Some(decoding);
            }
        }
        Ok(())
    }

    /// Decodes one message of a frame, or one transport message.
    fn decode_next(&mut self, decoding: &mut Decoding) -> Result<(), SessionError> {
        let rest = &mut decoding.rest;
        let Some(header) = rest.first().copied() else {
            return Ok(());
        };
        let message_id = imsg::mid(header);
        if let Some((reliability, counts)) = decoding.frame {
            if is_network(message_id) {
                return self.receive_next(rest, message_id, reliability, counts);
            }
            decoding.frame = None;
        }
        let codec = Zenoh080::new();
        match message_id {
            id::FRAME => {
                let frame: FrameHeader =
                    codec.read(&mut *rest).map_err(|_| SessionError::Decode)?;
                self.demand_open()?;
                let priority = frame.ext_qos.priority();
                let counts = self.receiver.frame(
                    frame.reliability,
                    priority,
                    frame.sn,
                    &mut self.counters,
                )?;
                decoding.frame = Some((frame.reliability, counts));
            }
            id::FRAGMENT => {
                let header: FragmentHeader =
                    codec.read(&mut *rest).map_err(|_| SessionError::Decode)?;
                self.demand_open()?;
                // A fragment lasts to the end of its batch.
                let payload = core::mem::replace(rest, ZSlice::empty());
                let whole = self
                    .receiver
                    .fragment(&header, &payload, &mut self.counters)?;
                if let Some(bytes) = whole {
                    let id = bytes.first().copied().map_or(0, imsg::mid);
                    self.receive_next(&mut bytes.into(), id, header.reliability, true)?;
                }
            }
            _ => {
                self.receive_transport(rest, header)?;
            }
        }
        Ok(())
    }

    /// Decodes one message of a frame; it does nothing unless it counts.
    fn receive_next(
        &mut self,
        rest: &mut ZSlice,
        message_id: u8,
        reliability: Reliability,
        counts: bool,
    ) -> Result<(), SessionError> {
        if message_id == zenoh_protocol::network::id::PUSH {
            let push = PushMessage::read(rest).map_err(|_| SessionError::Decode)?;
            if counts {
                self.receive_push(push);
            }
            return Ok(());
        }
        let message = read_message(rest, reliability)?;
        if counts {
            self.receive(message);
        }
        Ok(())
    }

    fn demand_open(&self) -> Result<(), SessionError> {
        match self.link {
            Link::Open { .. } => Ok(()),
            _ => Err(SessionError::Handshake),
        }
    }

    /// Decodes what is said outside of frames. Each message by its own codec: the one that takes
    /// them all is as large as all of them.
    fn receive_transport(&mut self, rest: &mut ZSlice, header: u8) -> Result<(), SessionError> {
        match imsg::mid(header) {
            id::INIT if imsg::has_flag(header, init::flag::A) => {
                self.receive_init_ack(&read_transport(rest)?)
            }
            id::OPEN if imsg::has_flag(header, open::flag::A) => {
                self.receive_open_ack(&read_transport(rest)?)
            }
            id::CLOSE => {
                let Close { reason, .. } = read_transport(rest)?;
                let reason = PeerReason::from(reason);
                self.end(match self.link {
                    Link::Open { .. } => CloseReason::Peer(reason),
                    _ => CloseReason::Refused(reason),
                });
                Ok(())
            }
            // Every byte is a sign of life; this one says nothing more.
            id::KEEP_ALIVE => read_transport::<KeepAlive>(rest).map(|_| ()),
            id::OAM => read_transport::<Oam>(rest).map(|_| ()),
            // What only the other side of a handshake, or a group, is told.
            id::INIT | id::OPEN | id::JOIN => Err(SessionError::Handshake),
            _ => Err(SessionError::Decode),
        }
    }

    fn receive_init_ack(&mut self, ack: &InitAck) -> Result<(), SessionError> {
        let Link::Init { offer, deadline_us } = &self.link else {
            return Err(SessionError::Handshake);
        };
        let deadline_us = *deadline_us;
        let grant = handshake::init_ack(offer, ack)?;
        let initial_sn = self.random.next_u64() as u32 & grant.sn_mask;
        let credentials = self.config.credentials.as_ref();
        let open_syn = handshake::open_syn(&grant, self.config.lease_us, initial_sn, credentials);
        let start = self.control.len();
        handshake::write_batch(&mut self.control, open_syn);
        if self.control.len() - start > usize::from(grant.batch_bytes) {
            // A user name beyond what the peer's batches carry.
            self.control.truncate(start);
            return Err(SessionError::Handshake);
        }
        self.reader.set_batch_bytes_max(grant.batch_bytes);
        self.link = Link::Opening {
            grant,
            initial_sn,
            deadline_us,
        };
        Ok(())
    }

    fn receive_open_ack(&mut self, ack: &OpenAck) -> Result<(), SessionError> {
        let Link::Opening {
            grant, initial_sn, ..
        } = &self.link
        else {
            return Err(SessionError::Handshake);
        };
        let (peer_lease_us, peer_sn) = handshake::open_ack(grant, ack)?;
        let (grant, initial_sn) = (grant.clone(), *initial_sn);
        self.open(&grant, initial_sn, peer_lease_us, peer_sn);
        Ok(())
    }

    fn receive(&mut self, message: NetworkMessage) {
        match message.body {
            // It is read apart from all others.
            NetworkBody::Push(_) => self.count_unknown(),
            NetworkBody::Request(request) => self.receive_request(request),
            NetworkBody::Response(response) => self.receive_response(response),
            NetworkBody::ResponseFinal(last) => match self.queries.take_outbound(last.rid) {
                Some(query) => self.finish_query(query, false),
                None => self.count_unknown(),
            },
            NetworkBody::Declare(declare) => self.receive_declare(declare),
            NetworkBody::Interest(interest) => self.receive_interest(&interest),
            NetworkBody::OAM(_) => {}
        }
    }

    fn receive_push(&mut self, push: PushMessage) {
        let resolved =
            self.peer
                .resolve_parts(&self.declarations, push.scope, push.mapping, push.suffix());
        let Some(key) = resolved else {
            return self.count_unknown();
        };
        let Ok(expr) = keyexpr::new(key.as_str()) else {
            return self.count_unknown();
        };
        let mut subscribers = [SubscriberId(0); limits::SUBSCRIBERS_MAX];
        let mut count = 0;
        let matching = self.declarations.matching(Kind::Subscriber, expr);
        for (place, entity) in subscribers.iter_mut().zip(matching) {
            *place = SubscriberId(entity.id);
            count += 1;
        }
        let Some((last, others)) = subscribers[..count].split_last() else {
            self.counters.unwanted = self.counters.unwanted.wrapping_add(1);
            return;
        };
        let sample = network::sample(key, push.qos, push.body);
        for &subscriber in others {
            self.events.push_back(Event::Message {
                subscriber,
                sample: sample.clone(),
            });
        }
        self.events.push_back(Event::Message {
            subscriber: *last,
            sample,
        });
    }

    fn receive_request(&mut self, request: Request) {
        let id = request.id;
        let RequestBody::Query(query) = request.payload;
        let key = self.peer.resolve(&self.declarations, request.wire_expr);
        let expr = key.as_deref().and_then(|key| keyexpr::new(key).ok());
        let (Some(key), Some(expr)) = (key.as_ref(), expr) else {
            self.count_unknown();
            return self.refuse_query(id, None);
        };
        let complete_only = request.ext_target == WireTarget::AllComplete;
        let waiting: Vec<QueryableId> = self
            .declarations
            .matching(Kind::Queryable { complete: true }, expr)
            .filter(|e| !complete_only || e.kind == Kind::Queryable { complete: true })
            .map(|e| QueryableId(e.id))
            .collect();
        if waiting.is_empty() {
            return self.refuse_query(id, None);
        }
        if self.queries.inbound.len() >= limits::QUERIES_IN_MAX {
            self.counters.refused = self.counters.refused.wrapping_add(1);
            return self.refuse_query(id, Some(key));
        }
        let timeout_us = request
            .ext_timeout
            .and_then(|timeout| u64::try_from(timeout.as_micros()).ok())
            .unwrap_or(limits::GET_TIMEOUT_US_DEFAULT);
        let qos = network::sample_qos(request.ext_qos);
        let serial = self.queries.next_serial();
        let (payload, encoding) = match query.ext_body {
            Some(body) => (
                Some(network::bytes(&body.payload)),
                network::encoding(body.encoding),
            ),
            None => (None, Encoding::default()),
        };
        let attachment = query.ext_attachment.map(|a| network::bytes(&a.buffer));
        for &queryable in &waiting {
            self.events.push_back(Event::Query {
                query: InboundQuery { serial, queryable },
                queryable,
                key: key.clone(),
                parameters: query.parameters.clone(),
                payload: payload.clone(),
                encoding: encoding.clone(),
                attachment: attachment.clone(),
            });
        }
        self.queries.inbound.push(QueryIn {
            serial,
            id,
            key: key.clone(),
            waiting,
            deadline_us: self.now_us.saturating_add(timeout_us),
            priority: qos.0,
            congestion: qos.1,
            express: qos.2,
        });
    }

    /// Completes a query that no queryable will, on the lane that has a reserve.
    fn refuse_query(&mut self, id: u32, busy: Option<&String>) {
        if let Some(key) = busy {
            // Without the reason the final still says enough.
            let _ = self.transmit.push(LANE_CONTROL, false, key.len(), |out| {
                let key = network::WireKey::Full(key);
                network::write_reply_error(out, id, key, b"busy", &Encoding::default())
            });
        }
        let pushed = self.transmit.push(LANE_CONTROL, false, 0, |out| {
            network::write_reply_final(out, id)
        });
        if pushed.is_err() {
            self.counters.unanswered = self.counters.unanswered.wrapping_add(1);
        }
    }

    fn receive_response(&mut self, response: Response) {
        let Some(query) = self.queries.outbound(response.rid) else {
            return self.count_unknown();
        };
        let id = QueryId(query.id);
        match response.payload {
            ResponseBody::Reply(reply) => {
                let Some(key) = self.peer.resolve(&self.declarations, response.wire_expr) else {
                    return self.count_unknown();
                };
                let sample = network::sample(key.into(), response.ext_qos, reply.payload);
                if let Some(sample) = query.consolidate(sample) {
                    self.events.push_back(Event::Reply { query: id, sample });
                }
            }
            ResponseBody::Err(error) => self.events.push_back(Event::ReplyError {
                query: id,
                payload: network::bytes(&error.payload),
                encoding: network::encoding(error.encoding),
            }),
        }
    }

    fn receive_declare(&mut self, declare: Declare) {
        let interest = declare.interest_id;
        match declare.body {
            DeclareBody::DeclareKeyExpr(body) => {
                // This message does not say whose numbers it uses; they are its sender's.
                let mut expr = body.wire_expr;
                expr.mapping = Mapping::Sender;
                let Some(key) = self.peer.resolve(&self.declarations, expr) else {
                    return self.count_unknown();
                };
                let declared = self.peer.declare_key(body.id, key);
                self.count_refused(declared.is_err());
            }
            DeclareBody::UndeclareKeyExpr(body) => {
                if !self.peer.undeclare_key(body.id) {
                    self.count_unknown();
                }
            }
            DeclareBody::DeclareSubscriber(body) => {
                let key = self.peer.resolve(&self.declarations, body.wire_expr);
                let Some(key) = key.as_deref().and_then(|key| keyexpr::new(key).ok()) else {
                    return self.count_unknown();
                };
                let declared = self.peer.declare_subscriber(body.id, key);
                self.count_refused(declared.is_err());
                self.update_wanted();
            }
            DeclareBody::UndeclareSubscriber(body) => {
                if !self.peer.undeclare_subscriber(body.id) {
                    self.count_unknown();
                }
                self.update_wanted();
            }
            DeclareBody::DeclareToken(body) => {
                let key = self.peer.resolve(&self.declarations, body.wire_expr);
                let Some(key) = key.as_deref().and_then(|key| keyexpr::new(key).ok()) else {
                    return self.count_unknown();
                };
                self.token_appeared(body.id, key, interest);
            }
            DeclareBody::UndeclareToken(body) => {
                let Some(token) = self.peer.undeclare_token(body.id) else {
                    return self.count_unknown();
                };
                for subscriber in token.told {
                    self.events.push_back(Event::Liveliness {
                        subscriber: LivelinessId(subscriber),
                        key: String::from(token.key.as_str()),
                        alive: false,
                    });
                }
            }
            DeclareBody::DeclareFinal(_) => self.interest_answered(interest),
            // We ask without looking who could answer.
            DeclareBody::DeclareQueryable(_) | DeclareBody::UndeclareQueryable(_) => {}
        }
    }

    fn token_appeared(&mut self, id: u32, key: &keyexpr, interest: Option<u32>) {
        let Ok(token) = self.peer.declare_token(id, key) else {
            return self.count_refused(true);
        };
        for entity in self.declarations.matching(Kind::Liveliness, key) {
            // An answer to one interest says nothing to the others, which get their own.
            let meant = interest.is_none_or(|interest| interest == entity.id);
            if meant && !token.told.contains(&entity.id) {
                token.told.push(entity.id);
                self.events.push_back(Event::Liveliness {
                    subscriber: LivelinessId(entity.id),
                    key: String::from(key.as_str()),
                    alive: true,
                });
            }
        }
    }

    fn interest_answered(&mut self, interest: Option<u32>) {
        let Some(interest) = interest else { return };
        for entity in self.declarations.entities_mut() {
            if let Kind::Publisher { answered, wanted } = &mut entity.kind
                && entity.id == interest
                && !*answered
            {
                *answered = true;
                *wanted = self.peer.wants(&entity.key);
                let (publisher, wanted) = (PublisherId(entity.id), *wanted);
                self.events.push_back(Event::Wanted { publisher, wanted });
            }
        }
    }

    fn update_wanted(&mut self) {
        for entity in self.declarations.entities_mut() {
            if let Kind::Publisher {
                answered: true,
                wanted,
            } = &mut entity.kind
            {
                let now_wanted = self.peer.wants(&entity.key);
                if *wanted != now_wanted {
                    *wanted = now_wanted;
                    let (publisher, wanted) = (PublisherId(entity.id), now_wanted);
                    self.events.push_back(Event::Wanted { publisher, wanted });
                }
            }
        }
    }

    fn receive_interest(&mut self, interest: &Interest) {
        // Everything we have is told unasked; only the end of the list is owed.
        if interest.mode.is_current() {
            let id = interest.id;
            let pushed = self.transmit.push(LANE_CONTROL, false, 0, |out| {
                network::write_declare(out, Some(id), network::declare_final())
            });
            self.count_refused(pushed.is_err());
        }
    }

    /// Gives what a query kept back, and its end.
    pub(super) fn finish_query(&mut self, query: QueryOut, timed_out: bool) {
        let id = QueryId(query.id);
        for sample in query.into_held() {
            self.events.push_back(Event::Reply { query: id, sample });
        }
        self.events.push_back(Event::ReplyFinal {
            query: id,
            timed_out,
        });
    }

    pub(super) fn expire_queries(&mut self) {
        let now_us = self.now_us;
        while let Some(index) = self
            .queries
            .outbound
            .iter()
            .position(|q| now_us >= q.deadline_us)
        {
            let query = self.queries.outbound.remove(index);
            self.finish_query(query, true);
        }
        while let Some(index) = self
            .queries
            .inbound
            .iter()
            .position(|q| now_us >= q.deadline_us)
        {
            let query = self.queries.inbound.remove(index);
            self.counters.unanswered = self.counters.unanswered.wrapping_add(1);
            // The asker has given up by now; without room it need not even be told.
            let _ = self
                .transmit
                .push(lane(query.priority), query.express, 0, |out| {
                    network::write_reply_final(out, query.id)
                });
        }
    }

    fn count_unknown(&mut self) {
        self.counters.unknown_ids = self.counters.unknown_ids.wrapping_add(1);
    }

    fn count_refused(&mut self, refused: bool) {
        self.counters.refused = self.counters.refused.wrapping_add(u32::from(refused));
    }
}

/// Messages of frames have the upper numbers, those of the transport the lower.
fn is_network(message_id: u8) -> bool {
    message_id >= zenoh_protocol::network::id::INTEREST
}

fn read_transport<M>(rest: &mut ZSlice) -> Result<M, SessionError>
where
    for<'r> Zenoh080: RCodec<M, &'r mut ZSlice>,
{
    Zenoh080::new().read(rest).map_err(|_| SessionError::Decode)
}

fn read_message(
    rest: &mut ZSlice,
    reliability: Reliability,
) -> Result<NetworkMessage, SessionError> {
    Zenoh080Reliability::new(reliability)
        .read(rest)
        .map_err(|_| SessionError::Decode)
}
