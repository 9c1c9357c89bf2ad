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

use crate::{Inbound, Node, Outbound, Outputs};
use core::fmt::Write;
use keys::{Keys, LocalMicros, NodeId, NodeTopic, key::KeyText};
use motion::StepBackend;
use pico::{
    event::{
        Congestion, DeclareError, Encoding, Priority, PublisherId, PutError, PutOptions,
        SampleKind, SubscriberId, TokenId,
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
}

/// Topics that a node hears.
const HEARD: [NodeTopic; 4] = [
    NodeTopic::Stop,
    NodeTopic::Batch,
    NodeTopic::Start,
    NodeTopic::Clock,
];

/// Topics that a node speaks on.
const SPOKEN: [NodeTopic; 6] = [
    NodeTopic::Clock,
    NodeTopic::Start,
    NodeTopic::Ack,
    NodeTopic::Status,
    NodeTopic::Log,
    NodeTopic::Report,
];

/// Numbers of zenoh's encodings.
const OCTET_STREAM: u16 = 3;
const TEXT_PLAIN: u16 = 4;
const JSON: u16 = 5;

/// Longest key that a script publishes on.
const DATA_KEY_BYTES_MAX: usize = keys::key::KEY_BYTES_MAX + 33;

/// A node's declarations on its session. They outlive connections: the session declares them again
/// on each.
#[derive(Debug)]
pub struct NodeLink {
    heard: [(SubscriberId, NodeTopic); HEARD.len()],
    spoken: [(PublisherId, NodeTopic); SPOKEN.len()],
    token: TokenId,
    held: Option<Outbound>,
    /// Below which a script publishes.
    data: KeyText,
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
        ];
        let mut publish = |topic| session.declare_publisher(&keys.node(name, topic));
        let spoken = [
            (publish(SPOKEN[0])?, SPOKEN[0]),
            (publish(SPOKEN[1])?, SPOKEN[1]),
            (publish(SPOKEN[2])?, SPOKEN[2]),
            (publish(SPOKEN[3])?, SPOKEN[3]),
            (publish(SPOKEN[4])?, SPOKEN[4]),
            (publish(SPOKEN[5])?, SPOKEN[5]),
        ];
        // Last: who sees the token may count on the subscriptions.
        let token = session.declare_token(&keys.node(name, NodeTopic::Alive))?;
        Ok(Self {
            heard,
            spoken,
            token,
            held: None,
            data: keys.node(name, NodeTopic::Data),
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
                Event::Opened => host.handle(now, Inbound::LinkUp),
                Event::Closed { .. } => {
                    self.held = None;
                    host.handle(now, Inbound::LinkDown);
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
        host.poll(now);
        while let Some(outbound) = self.held.take().or_else(|| host.poll_outbox(now)) {
            // Closed: the next status says everything. Any other error cannot be helped by another
            // attempt.
            if self.put(session, &outbound) == Err(PutError::Full) {
                self.held = Some(outbound);
                break;
            }
        }
        host.poll_timeout()
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
        let Some((publisher, _)) = spoken else {
            return Ok(());
        };
        session.put(*publisher, &outbound.payload, &options)
    }
}

/// Returns how a topic travels: see the table in [`keys::topics`].
fn options_of(topic: NodeTopic) -> PutOptions {
    let (priority, congestion, express, encoding) = match topic {
        NodeTopic::Clock => (Priority::RealTime, Congestion::Drop, true, OCTET_STREAM),
        NodeTopic::Start => (Priority::RealTime, Congestion::Block, true, OCTET_STREAM),
        NodeTopic::Ack => (Priority::DataHigh, Congestion::Block, true, OCTET_STREAM),
        NodeTopic::Report => (Priority::DataHigh, Congestion::Block, false, OCTET_STREAM),
        NodeTopic::Data => (Priority::Data, Congestion::Drop, false, JSON),
        NodeTopic::Log => (Priority::Background, Congestion::Drop, false, TEXT_PLAIN),
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
