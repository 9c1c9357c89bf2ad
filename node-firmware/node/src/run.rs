//! The node on its zenoh session: which keys it hears, how its messages leave.
//!
//! ```text
//!  pico::driver::run ──poll──▶ NodeLink::exchange ──Inbound──▶ Host (the node)
//!                                     ▲                          │
//!                                     └────────── Outbound ◀─────┘
//! ```
//!
//! The waiting is done by [`pico::driver::run`]; this file only moves messages, so it is the same
//! on the board and in the emulator. What the session cannot take now is held, one message, and
//! offered again: the outbox behind it has its own bounds.

use crate::{Inbound, Node, Outbound, Outputs, library::Library};
use alloc::{format, string::String, vec::Vec};
use core::fmt::Write;
use keys::{
    Keys, LocalMicros, NodeId, NodeTopic,
    jog::REQUEST_BYTES_MAX,
    key::KeyText,
    update::{UpdateMessage, UpdateRefusal, UpdateReply},
    vitals::{VITALS_BYTES_MAX, VITALS_US, Vitals},
};
use motion::StepBackend;
use pico::{
    event::{
        Congestion, DeclareError, Encoding, InboundQuery, KeyId, Priority, PutError, PutOptions,
        QueryableId, ReplyError, SampleKind, SubscriberId, TokenId,
    },
    session::{Event, Session},
};

/// Whoever keeps a [`Node`]: the node itself on the board, the emulated node around it on a PC.
pub trait Host {
    /// See [`Node::handle`].
    fn handle(&mut self, now: LocalMicros, inbound: Inbound<'_>);
    /// See [`Node::poll`].
    fn poll(&mut self, now: LocalMicros);
    /// See [`Node::poll_timeout`].
    fn poll_timeout(&self) -> Option<LocalMicros>;
    /// See [`Node::poll_outbox`].
    fn poll_outbox(&mut self, now: LocalMicros) -> Option<Outbound>;
    /// See [`Node::store_script`].
    fn store_script(&mut self, now: LocalMicros, name: &str, text: Option<&[u8]>);
    /// See [`Node::library`].
    fn library(&self) -> &Library;
    /// Takes a message about another firmware. Flash is the host's business, not the node's: a host
    /// without slots says so.
    fn update(&mut self, now: LocalMicros, message: &UpdateMessage<'_>) -> UpdateReply {
        let _ = (now, message);
        UpdateReply::Refused(UpdateRefusal::NoSlot)
    }
    /// Tells how its chip is, as far as it knows; nothing here waits for the core that plans.
    fn vitals(&mut self, now: LocalMicros) -> Vitals {
        Vitals {
            at: now,
            uptime_s: u32::try_from(now.0 / 1_000_000).ok(),
            ..Vitals::default()
        }
    }
    /// Tells what it was told and is made of, as [`crate::setup::json_of`] writes it; nothing: it does not
    /// answer.
    fn setup(&self) -> Vec<u8> {
        Vec::new()
    }
}

impl<B: StepBackend, O: Outputs> Host for Node<'_, B, O> {
    fn handle(&mut self, now: LocalMicros, inbound: Inbound<'_>) {
        Node::handle(self, now, inbound);
    }

    fn poll(&mut self, now: LocalMicros) {
        Node::poll(self, now);
    }

    fn poll_timeout(&self) -> Option<LocalMicros> {
        Node::poll_timeout(self)
    }

    fn poll_outbox(&mut self, now: LocalMicros) -> Option<Outbound> {
        Node::poll_outbox(self, now)
    }

    fn store_script(&mut self, now: LocalMicros, name: &str, text: Option<&[u8]>) {
        Node::store_script(self, now, name, text);
    }

    fn library(&self) -> &Library {
        Node::library(self)
    }
}

/// Topics that a node hears.
const HEARD: [NodeTopic; 5] = [
    NodeTopic::Stop,
    NodeTopic::Batch,
    NodeTopic::Start,
    NodeTopic::Clock,
    NodeTopic::Pace,
];

/// Topics that a node speaks on.
const SPOKEN: [NodeTopic; 9] = [
    NodeTopic::Clock,
    NodeTopic::Start,
    NodeTopic::Ack,
    NodeTopic::Status,
    NodeTopic::Log,
    NodeTopic::Report,
    NodeTopic::Pace,
    NodeTopic::Trace,
    NodeTopic::Vitals,
];

/// Numbers of zenoh's encodings.
const OCTET_STREAM: u16 = 3;
const TEXT_PLAIN: u16 = 4;
const JSON: u16 = 5;

/// The chunk before a stored script's name.
const SCRIPT: &str = "script";

/// The key of stored scripts.
type ScriptKey = heapless::String<DATA_KEY_BYTES_MAX>;

/// Most bytes of an answer about another firmware.
const UPDATE_REPLY_BYTES_MAX: usize = 8;

/// Requests for jogs that wait for the node's answer.
const JOGS_ASKED_MAX: usize = 8;

/// Longest key that a script publishes on.
const DATA_KEY_BYTES_MAX: usize = keys::key::KEY_BYTES_MAX + 33;

/// A node's declarations on its session. They outlive connections: the session declares them again
/// on each.
#[derive(Debug)]
pub struct NodeLink {
    heard: [(SubscriberId, NodeTopic); HEARD.len()],
    spoken: [(KeyId, NodeTopic); SPOKEN.len()],
    token: TokenId,
    held: Option<Outbound>,
    /// Below which a script publishes.
    data: KeyText,
    /// Stored scripts: put, delete and get.
    store: SubscriberId,
    shelf: QueryableId,
    /// The key below which they are.
    scripts: ScriptKey,
    /// Gets that wait for room: what is left to send for each.
    gets: Vec<(InboundQuery, Vec<String>)>,
    /// Messages about another firmware, and answers that wait for room.
    updates: QueryableId,
    update_key: KeyText,
    answers: Vec<(InboundQuery, Option<UpdateReply>)>,
    /// Who asks for the setup.
    setups: QueryableId,
    setup_key: KeyText,
    curious: Vec<InboundQuery>,
    /// Jogs: each with the number by which the node answers it, and since when it waits.
    jogs: QueryableId,
    jog_key: KeyText,
    asked: Vec<(u32, InboundQuery)>,
    last_asked: u32,
    /// When vitals are said next; `None` without a session.
    vitals_at: Option<LocalMicros>,
}

impl NodeLink {
    /// Declares what a node of this name hears and speaks, and that it is alive.
    ///
    /// # Errors
    /// The session has no room for so many declarations.
    pub fn declare(
        session: &mut Session,
        keys: &Keys,
        name: &NodeId,
    ) -> Result<Self, DeclareError> {
        // An array of results does not become a result of an array without an allocation or a
        // default: so the first one is declared by hand.
        let mut subscribe = |topic| session.declare_subscriber(&keys.node(name, topic));
        let heard = [
            (subscribe(HEARD[0])?, HEARD[0]),
            (subscribe(HEARD[1])?, HEARD[1]),
            (subscribe(HEARD[2])?, HEARD[2]),
            (subscribe(HEARD[3])?, HEARD[3]),
            (subscribe(HEARD[4])?, HEARD[4]),
        ];
        // Keys and not publishers: those ask who wants them, which costs a router a look at the
        // subscribers of all nodes, and a node speaks in any case.
        let mut publish = |topic| session.declare_key(&keys.node(name, topic));
        let spoken = [
            (publish(SPOKEN[0])?, SPOKEN[0]),
            (publish(SPOKEN[1])?, SPOKEN[1]),
            (publish(SPOKEN[2])?, SPOKEN[2]),
            (publish(SPOKEN[3])?, SPOKEN[3]),
            (publish(SPOKEN[4])?, SPOKEN[4]),
            (publish(SPOKEN[5])?, SPOKEN[5]),
            (publish(SPOKEN[6])?, SPOKEN[6]),
            (publish(SPOKEN[7])?, SPOKEN[7]),
            (publish(SPOKEN[8])?, SPOKEN[8]),
        ];
        let mut scripts = ScriptKey::new();
        // Cannot fail: it was counted.
        let _ = write!(scripts, "{}/node/{name}/{SCRIPT}", keys.prefix());
        let every = format!("{scripts}/*");
        let store = session.declare_subscriber(&every)?;
        let shelf = session.declare_queryable(&every, true)?;
        let update_key = keys.node(name, NodeTopic::Update);
        let updates = session.declare_queryable(&update_key, true)?;
        let setup_key = keys.node(name, NodeTopic::Setup);
        let setups = session.declare_queryable(&setup_key, true)?;
        let jog_key = keys.node(name, NodeTopic::Jog);
        let jogs = session.declare_queryable(&jog_key, true)?;
        // Last: who sees the token may count on the subscriptions.
        let token = session.declare_token(&keys.node(name, NodeTopic::Alive))?;
        Ok(Self {
            heard,
            spoken,
            token,
            held: None,
            data: keys.node(name, NodeTopic::Data),
            store,
            shelf,
            scripts,
            gets: Vec::new(),
            updates,
            update_key,
            answers: Vec::new(),
            setups,
            setup_key,
            curious: Vec::new(),
            jogs,
            jog_key,
            asked: Vec::new(),
            last_asked: 0,
            vitals_at: None,
        })
    }

    /// Returns the liveliness token.
    pub fn token(&self) -> TokenId {
        self.token
    }

    /// Moves everything that can be moved now, both ways, and returns when to be called again.
    pub fn exchange<H: Host>(
        &mut self,
        host: &mut H,
        session: &mut Session,
        now: LocalMicros,
    ) -> Option<LocalMicros> {
        while let Some(event) = session.poll_event() {
            match event {
                Event::Opened => {
                    self.vitals_at = Some(now);
                    host.handle(now, Inbound::LinkUp);
                }
                Event::Closed { .. } => {
                    self.held = None;
                    self.gets.clear();
                    self.answers.clear();
                    self.curious.clear();
                    self.asked.clear();
                    self.vitals_at = None;
                    host.handle(now, Inbound::LinkDown);
                }
                Event::Message { subscriber, sample } if subscriber == self.store => {
                    if let Some(name) = script_named(&sample.key) {
                        let text = (sample.kind == SampleKind::Put).then_some(&sample.payload[..]);
                        host.store_script(now, name, text);
                    }
                }
                Event::Query {
                    query,
                    queryable,
                    key,
                    ..
                } if queryable == self.shelf => {
                    let asked = key.rsplit('/').next().unwrap_or_default();
                    let names = host.library().iter().map(|(name, _)| name);
                    let names = names.filter(|name| is_meant(asked, name));
                    self.gets.push((query, names.map(String::from).collect()));
                }
                Event::Query {
                    query,
                    queryable,
                    key,
                    payload,
                    ..
                } if queryable == self.updates => {
                    // A tool that looks at everything asks for no other firmware.
                    let is_meant = key == self.update_key.as_str();
                    let reply = is_meant.then(|| {
                        let bytes = payload.as_deref().unwrap_or_default();
                        match postcard::from_bytes(bytes) {
                            Ok(message) => host.update(now, &message),
                            Err(_) => UpdateReply::Refused(UpdateRefusal::Message),
                        }
                    });
                    self.answers.push((query, reply));
                }
                Event::Query {
                    query, queryable, ..
                } if queryable == self.setups => self.curious.push(query),
                Event::Query {
                    query,
                    queryable,
                    key,
                    payload,
                    ..
                } if queryable == self.jogs => {
                    // A tool that looks at everything moves nothing, and one button one machine.
                    if key == self.jog_key.as_str() {
                        self.ask_jog(host, session, query, payload.as_deref(), now);
                    } else {
                        // Cannot be helped: the session ends it in time.
                        let _ = session.reply_final(&query);
                    }
                }
                Event::Message { subscriber, sample } => {
                    let Some(topic) = self.topic_of(subscriber) else {
                        continue;
                    };
                    // A value that is deleted orders nothing, but whatever comes on the stop key
                    // stops.
                    if sample.kind == SampleKind::Put || topic == NodeTopic::Stop {
                        let payload = &sample.payload;
                        host.handle(now, Inbound::Message { topic, payload });
                    }
                }
                _ => {}
            }
        }
        self.answer(host, session);
        self.answer_updates(session);
        host.poll(now);
        while let Some(outbound) = self.held.take().or_else(|| host.poll_outbox(now)) {
            // Closed: the next status says everything. Any other error cannot be helped by another
            // attempt.
            let put = match outbound.topic {
                NodeTopic::Jog => self.answer_jog(session, &outbound),
                _ => self.put(session, &outbound),
            };
            if put == Err(PutError::Full) {
                self.held = Some(outbound);
                break;
            }
        }
        self.tell_vitals(host, session, now);
        self.answer_setups(host, session);
        host.poll_timeout().into_iter().chain(self.vitals_at).min()
    }

    /// Tells how the chip is, if it is time and nothing else is to be said. What finds no room is not
    /// said later: the next is complete.
    fn tell_vitals<H: Host>(&mut self, host: &mut H, session: &mut Session, now: LocalMicros) {
        if self.vitals_at.is_none_or(|at| now < at) {
            return;
        }
        self.vitals_at = Some(now.plus_us(VITALS_US));
        let spoken = |(_, topic): &&(KeyId, NodeTopic)| *topic == NodeTopic::Vitals;
        if self.held.is_none()
            && let Some((key, topic)) = self.spoken.iter().find(spoken)
        {
            let mut buffer = [0; VITALS_BYTES_MAX];
            let vitals = host.vitals(now);
            let _ = session.put(*key, vitals.encode(&mut buffer), &options_of(*topic));
        }
    }

    /// Replies to gets of stored scripts, as far as there is room.
    fn answer<H: Host>(&mut self, host: &H, session: &mut Session) {
        let options = PutOptions {
            encoding: Encoding {
                id: TEXT_PLAIN,
                schema: None,
            },
            ..PutOptions::default()
        };
        while let Some((query, names)) = self.gets.first_mut() {
            if let Some(name) = names.last() {
                let text = host.library().get(name).unwrap_or_default();
                let key = format!("{}/{name}", self.scripts);
                match session.reply(query, &key, text.as_bytes(), &options) {
                    Err(ReplyError::Full) => return,
                    // Told, or nobody listens any more.
                    _ => names.pop(),
                };
            } else {
                if session.reply_final(query) == Err(ReplyError::Full) {
                    return;
                }
                self.gets.remove(0);
            }
        }
    }

    /// Replies to messages about another firmware, as far as there is room.
    fn answer_updates(&mut self, session: &mut Session) {
        let options = options_of(NodeTopic::Update);
        while let Some((query, reply)) = self.answers.first() {
            let mut buffer = [0; UPDATE_REPLY_BYTES_MAX];
            let replied = reply.map_or(Ok(()), |reply| {
                let bytes = postcard::to_slice(&reply, &mut buffer)
                    .expect("a variant or two and a number of 32 bits");
                session.reply(query, &self.update_key, bytes, &options)
            });
            if replied == Err(ReplyError::Full)
                || session.reply_final(query) == Err(ReplyError::Full)
            {
                // Twice the same answer does no harm.
                return;
            }
            self.answers.remove(0);
        }
    }

    /// Replies to gets of the setup, behind everything else that is to be said, as far as there is room.
    fn answer_setups<H: Host>(&mut self, host: &H, session: &mut Session) {
        if self.held.is_some() {
            return;
        }
        let options = options_of(NodeTopic::Setup);
        while let Some(query) = self.curious.first() {
            let setup = host.setup();
            let replied = match setup.is_empty() {
                true => Ok(()),
                false => session.reply(query, &self.setup_key, &setup, &options),
            };
            if replied == Err(ReplyError::Full)
                || session.reply_final(query) == Err(ReplyError::Full)
            {
                // Twice the same answer does no harm.
                return;
            }
            self.curious.remove(0);
        }
    }

    /// Hands a request for a jog to the node, which may be on the other core.
    fn ask_jog<H: Host>(
        &mut self,
        host: &mut H,
        session: &mut Session,
        query: InboundQuery,
        payload: Option<&[u8]>,
        now: LocalMicros,
    ) {
        if self.asked.len() == JOGS_ASKED_MAX {
            // Its answer was lost: whoever asked knows that by now.
            let (_, lost) = self.asked.remove(0);
            let _ = session.reply_final(&lost);
        }
        self.last_asked = self.last_asked.wrapping_add(1);
        self.asked.push((self.last_asked, query));
        let mut numbered = Vec::from(self.last_asked.to_le_bytes());
        let payload = payload.unwrap_or_default();
        numbered.extend(payload.iter().take(REQUEST_BYTES_MAX + 1));
        let payload = &numbered;
        let topic = NodeTopic::Jog;
        host.handle(now, Inbound::Message { topic, payload });
    }

    /// Passes the node's answer to a request for a jog on.
    fn answer_jog(&mut self, session: &mut Session, outbound: &Outbound) -> Result<(), PutError> {
        let refused = outbound.suffix.starts_with(crate::jog::REFUSED);
        let number = outbound.suffix.trim_start_matches(crate::jog::REFUSED);
        let is_it = |(asked, _): &(u32, InboundQuery)| number.parse() == Ok(*asked);
        let Some(index) = self.asked.iter().position(is_it) else {
            return Ok(());
        };
        let options = options_of(NodeTopic::Jog);
        let query = &self.asked[index].1;
        let replied = if refused {
            session.reply_error(query, &outbound.payload, &options.encoding)
        } else {
            session.reply(query, &self.jog_key, &outbound.payload, &options)
        };
        if replied == Err(ReplyError::Full) || session.reply_final(query) == Err(ReplyError::Full) {
            // Twice the same answer does no harm.
            return Err(PutError::Full);
        }
        self.asked.remove(index);
        Ok(())
    }

    fn topic_of(&self, subscriber: SubscriberId) -> Option<NodeTopic> {
        let heard = self.heard.iter().find(|(id, _)| *id == subscriber);
        heard.map(|(_, topic)| *topic)
    }

    fn put(&self, session: &mut Session, outbound: &Outbound) -> Result<(), PutError> {
        let options = options_of(outbound.topic);
        if outbound.topic == NodeTopic::Data {
            let mut key = heapless::String::<DATA_KEY_BYTES_MAX>::new();
            // Cannot fail: it was counted.
            let _ = write!(key, "{}/{}", self.data, outbound.suffix);
            return session.put(key.as_str(), &outbound.payload, &options);
        }
        let spoken = self
            .spoken
            .iter()
            .find(|(_, topic)| *topic == outbound.topic);
        let Some((key, _)) = spoken else {
            return Ok(());
        };
        session.put(*key, &outbound.payload, &options)
    }
}

/// Returns whether the last chunk of a key means this name.
fn is_meant(asked: &str, name: &str) -> bool {
    match asked.split_once("$*") {
        _ if asked == "*" || asked == "**" => true,
        Some((before, after)) => {
            name.len() >= before.len() + after.len()
                && name.starts_with(before)
                && name.ends_with(after)
        }
        None => asked == name,
    }
}

/// Returns how a topic travels: see the table in [`keys::topics`].
fn options_of(topic: NodeTopic) -> PutOptions {
    let (priority, congestion, express, encoding) = match topic {
        NodeTopic::Clock => (Priority::RealTime, Congestion::Drop, true, OCTET_STREAM),
        NodeTopic::Start | NodeTopic::Pace => {
            (Priority::RealTime, Congestion::Block, true, OCTET_STREAM)
        }
        NodeTopic::Jog => (Priority::RealTime, Congestion::Block, true, JSON),
        NodeTopic::Ack => (Priority::DataHigh, Congestion::Block, true, OCTET_STREAM),
        NodeTopic::Report => (Priority::DataHigh, Congestion::Block, false, OCTET_STREAM),
        NodeTopic::Data => (Priority::Data, Congestion::Drop, false, JSON),
        NodeTopic::Log => (Priority::Background, Congestion::Drop, false, TEXT_PLAIN),
        NodeTopic::Vitals => (Priority::Background, Congestion::Drop, false, OCTET_STREAM),
        NodeTopic::Setup => (Priority::Background, Congestion::Drop, false, JSON),
        _ => (Priority::DataHigh, Congestion::Drop, false, OCTET_STREAM),
    };
    PutOptions {
        encoding: Encoding {
            id: encoding,
            schema: None,
        },
        priority,
        congestion,
        express,
        ..PutOptions::default()
    }
}

/// Returns which script a put or delete on this key means. A key that is about other things and merely
/// includes ours, as a stop on `fleet/**/stop` does, means none.
fn script_named(key: &str) -> Option<&str> {
    let (place, name) = key.rsplit_once('/')?;
    (place.rsplit('/').next() == Some(SCRIPT)).then_some(name)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_a_key_of_a_script_stores_one() {
        for (key, name) in [
            ("fleet/node/left/script/boot", Some("boot")),
            ("fleet/node/*/script/boot", Some("boot")),
            ("**/script/boot", Some("boot")),
            ("fleet/node/**/stop", None),
            ("**/stop", None),
            ("fleet/**", None),
            ("**", None),
        ] {
            assert_eq!(script_named(key), name, "{key}");
        }
    }
}
