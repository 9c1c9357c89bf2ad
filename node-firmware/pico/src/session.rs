//! The zenoh conversation as a state machine.
//!
//! ```text
//!            handle_connected        InitAck          OpenAck
//!   Closed ─────────────────▶ Init ─────────▶ Open… ─────────▶ Open
//!     ▲  ▲                     │                │               │ close()
//!     │  └──── refused, timed out, lost ◀───────┴───────────────┤
//!     └──────────── Close sent ◀── queue empty or 1 s ── closing ◀
//! ```
//!
//! Owns everything about one connection to one router, and what must be said again on the next.
//! It has no socket and no clock: bytes and `now_us` come in, bytes, events and the next deadline
//! go out. Times are microseconds of any clock that does not run backwards.
//!
//! Promises: declarations are made again on every connection; a connection that is not understood
//! is ended with a typed reason; all memory is bounded by [`limits`] and
//! [`SessionConfig`]; nothing panics on any input.
//!
//! The application's verbs are in `session/application.rs`, what the peer says in
//! `session/inbound.rs`.

mod application;
mod inbound;

use alloc::{collections::VecDeque, vec::Vec};

use zenoh_buffers::ZSlice;
use zenoh_protocol::{
    core::{Reliability, ZenohIdProto},
    transport::{TransportSn, close},
};

use crate::{
    backoff::Backoff,
    declarations::Declarations,
    event::CloseReason,
    limits,
    peer::Peer,
    queries::Queries,
    random::Random,
    reader::{BatchMemory, BatchReader, ReadError},
    receive::{self, Receiver},
    transmit::{self, TransmitQueue},
    wire::handshake::{self, Grant, Offer},
};
pub use crate::{
    event::{Counters, Event, SessionError},
    wire::handshake::Credentials,
};

/// What a session is to be like. The defaults are zenoh-pico's where it has any.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct SessionConfig {
    /// Longest batch that we offer to exchange, length prefix included; the router may lower it.
    /// Bursts need more: a router keeps two batches for each priority before it drops or blocks.
    /// Values below [`limits::BATCH_BYTES_MIN`] count as that.
    pub batch_bytes: u16,
    /// How long the router waits for a sign of life before it drops the link. Whole milliseconds,
    /// at least one.
    pub lease_us: u64,
    /// Longest message that is put together from fragments, in bytes without the frame.
    pub fragment_bytes_max: usize,
    /// Bytes that may wait for transmission. At least twice [`limits::QUEUE_RESERVE_BYTES`].
    pub queue_bytes: usize,
    /// User and password, if the router asks for them.
    pub credentials: Option<Credentials>,
    /// Whether to ask for priorities with their own sequences. Without them a long message
    /// cannot be overtaken.
    pub qos: bool,
    /// Longest time for a connection to be made, and again for the handshake.
    pub connect_timeout_us: u64,
    /// First pause before a new attempt.
    pub backoff_us_min: u64,
    /// Longest pause before a new attempt.
    pub backoff_us_max: u64,
}

impl Default for SessionConfig {
    fn default() -> Self {
        Self {
            batch_bytes: limits::BATCH_BYTES_DEFAULT,
            lease_us: limits::LEASE_US_DEFAULT,
            fragment_bytes_max: limits::FRAGMENT_BYTES_MAX_DEFAULT,
            queue_bytes: limits::QUEUE_BYTES_DEFAULT,
            credentials: None,
            qos: true,
            connect_timeout_us: limits::CONNECT_TIMEOUT_US_DEFAULT,
            backoff_us_min: limits::BACKOFF_US_MIN_DEFAULT,
            backoff_us_max: limits::BACKOFF_US_MAX_DEFAULT,
        }
    }
}

/// Where the conversation stands.
#[derive(Debug)]
enum Link {
    Closed,
    Init {
        offer: Offer,
        deadline_us: u64,
    },
    Opening {
        grant: Grant,
        initial_sn: TransportSn,
        deadline_us: u64,
    },
    Open {
        opened_at_us: u64,
        peer_lease_us: u64,
        request_id_mask: u32,
        /// The application closed the session; what is queued may still leave until then.
        closing_at_us: Option<u64>,
    },
}

/// A batch of which some messages are not decoded yet.
#[derive(Debug)]
struct Decoding {
    rest: ZSlice,
    /// Inside a frame: its reliability, and whether its messages count.
    frame: Option<(Reliability, bool)>,
}

/// One conversation with a router, over any number of connections.
#[derive(Debug)]
pub struct Session {
    config: SessionConfig,
    random: Random,
    backoff: Backoff,
    link: Link,
    /// There is a byte stream, also when the conversation on it is over.
    connected: bool,
    /// Closed for good.
    finished: bool,
    now_us: u64,
    retry_at_us: u64,
    last_sent_us: u64,
    last_received_us: u64,
    reader: BatchReader,
    batch: BatchMemory,
    decoding: Option<Decoding>,
    /// Whole batches of the transport itself: handshake, keep-alive, close.
    control: Vec<u8>,
    transmit: TransmitQueue,
    receiver: Receiver,
    declarations: Declarations,
    peer: Peer,
    queries: Queries,
    events: VecDeque<Event>,
    counters: Counters,
}

impl Session {
    /// A session that wants a connection. `seed` must be random on every start: the session's id
    /// comes from it, and a router refuses an id that it still knows.
    pub fn new(config: SessionConfig, seed: u64) -> Self {
        let config = SessionConfig {
            batch_bytes: config.batch_bytes.max(limits::BATCH_BYTES_MIN),
            lease_us: config.lease_us.max(1000),
            ..config
        };
        Self {
            random: Random::new(seed),
            backoff: Backoff::new(config.backoff_us_min, config.backoff_us_max),
            link: Link::Closed,
            connected: false,
            finished: false,
            now_us: 0,
            retry_at_us: 0,
            last_sent_us: 0,
            last_received_us: 0,
            reader: BatchReader::new(config.batch_bytes),
            batch: BatchMemory::default(),
            decoding: None,
            control: Vec::new(),
            transmit: TransmitQueue::new(config.queue_bytes),
            receiver: Receiver::new(config.fragment_bytes_max),
            declarations: Declarations::new(),
            peer: Peer::default(),
            queries: Queries::default(),
            events: VecDeque::new(),
            counters: Counters::default(),
            config,
        }
    }

    /// What the session is like.
    pub fn config(&self) -> &SessionConfig {
        &self.config
    }

    // ---- transport ----

    /// A byte stream to the router is open. Starts the handshake with a fresh id.
    pub fn handle_connected(&mut self, now_us: u64) {
        self.tick(now_us);
        if self.connected || self.finished {
            return;
        }
        self.connected = true;
        self.last_sent_us = self.now_us;
        self.last_received_us = self.now_us;
        self.control.clear();
        self.decoding = None;
        self.reader.reset(self.config.batch_bytes);
        let offer = Offer {
            zid: self.fresh_zid(),
            batch_bytes: self.config.batch_bytes,
            qos: self.config.qos,
            authenticate: self.config.credentials.is_some(),
        };
        handshake::write_batch(&mut self.control, handshake::init_syn(&offer));
        let deadline_us = self.now_us.saturating_add(self.config.connect_timeout_us);
        self.link = Link::Init { offer, deadline_us };
    }

    /// No byte stream could be opened. The next attempt waits for the back-off.
    pub fn handle_connect_failed(&mut self, now_us: u64) {
        self.tick(now_us);
        if !self.connected {
            self.counters.failed_connects = self.counters.failed_connects.wrapping_add(1);
            self.schedule_retry();
        }
    }

    /// The byte stream has ended, whoever ended it. Calling it again does nothing.
    pub fn handle_disconnected(&mut self, now_us: u64) {
        self.tick(now_us);
        if !self.connected {
            return;
        }
        self.end(CloseReason::Lost);
        self.connected = false;
        self.control.clear();
    }

    /// Takes bytes from the stream, cut anywhere.
    ///
    /// # Errors
    /// What the peer said that cannot be. The conversation is over then, the back-off runs, and
    /// the stream must be dropped.
    pub fn handle_bytes(&mut self, now_us: u64, bytes: &[u8]) -> Result<(), SessionError> {
        self.tick(now_us);
        if !self.connected {
            return Err(SessionError::NotConnected);
        }
        if !bytes.is_empty() {
            self.last_received_us = self.now_us;
        }
        let taken = self.take_bytes(bytes);
        if let Err(error) = taken {
            self.fail(error);
            self.connected = false;
            self.control.clear();
        }
        taken
    }

    /// Does what is due. To be called at [`Session::poll_timeout`]; earlier or later is harmless.
    pub fn handle_timeout(&mut self, now_us: u64) {
        self.tick(now_us);
        match self.link {
            Link::Closed => {}
            Link::Init { deadline_us, .. } | Link::Opening { deadline_us, .. } => {
                if self.now_us >= deadline_us {
                    self.end(CloseReason::HandshakeTimeout);
                    handshake::write_close(&mut self.control, close::reason::EXPIRED);
                }
            }
            Link::Open {
                peer_lease_us,
                closing_at_us,
                ..
            } => {
                if closing_at_us.is_some_and(|at_us| self.now_us >= at_us) {
                    self.end(CloseReason::Local);
                    handshake::write_close(&mut self.control, close::reason::GENERIC);
                    return;
                }
                if !self.wants_bytes() {
                    // What the peer says waits unread, so its silence proves nothing.
                    self.last_received_us = self.now_us;
                }
                if self.now_us >= self.last_received_us.saturating_add(peer_lease_us) {
                    self.end(CloseReason::LeaseExpired);
                    handshake::write_close(&mut self.control, close::reason::EXPIRED);
                    return;
                }
                if self.now_us >= self.keep_alive_at_us() {
                    // One that still waits says the same.
                    if self.control.is_empty() {
                        handshake::write_keep_alive(&mut self.control);
                    }
                    self.last_sent_us = self.now_us;
                }
                self.expire_queries();
            }
        }
    }

    /// When [`Session::handle_timeout`] wants to be called, or [`Session::wants_connection`]
    /// becomes true.
    pub fn poll_timeout(&self) -> Option<u64> {
        match &self.link {
            Link::Closed => (!self.connected && !self.finished).then_some(self.retry_at_us),
            Link::Init { deadline_us, .. } | Link::Opening { deadline_us, .. } => {
                Some(*deadline_us)
            }
            Link::Open {
                peer_lease_us,
                closing_at_us,
                ..
            } => {
                let lease_at_us = self.last_received_us.saturating_add(*peer_lease_us);
                [
                    Some(self.keep_alive_at_us()),
                    Some(lease_at_us),
                    *closing_at_us,
                ]
                .into_iter()
                .chain([self.queries.deadline_us()])
                .flatten()
                .min()
            }
        }
    }

    /// There is no byte stream, and the back-off has passed.
    pub fn wants_connection(&self, now_us: u64) -> bool {
        !self.connected && !self.finished && now_us >= self.retry_at_us
    }

    /// The conversation on this byte stream is over. What [`Session::poll_transmit`] still has is
    /// the last word; a driver writes it for a bounded time and then drops the stream.
    pub fn is_over(&self) -> bool {
        self.connected && matches!(self.link, Link::Closed)
    }

    /// The conversation is over and its last word has been handed out: once that is written the
    /// stream is to be dropped.
    pub fn wants_disconnect(&self) -> bool {
        self.is_over() && self.control.is_empty()
    }

    /// Closed for good, without a byte stream: nothing will happen any more.
    pub fn is_finished(&self) -> bool {
        self.finished && !self.connected
    }

    /// There is room for what further bytes would bring. While this is false a driver does not
    /// read, and the stream's own flow control holds the peer back.
    pub fn wants_bytes(&self) -> bool {
        self.connected && self.events.len() < limits::EVENTS_MAX
    }

    /// Appends whole batches to `out`, as many as are there up to [`limits::TRANSMIT_BYTES`] and
    /// one more, and returns how many bytes that are.
    pub fn poll_transmit(&mut self, now_us: u64, out: &mut Vec<u8>) -> usize {
        self.tick(now_us);
        let start = out.len();
        out.append(&mut self.control);
        if let Link::Open { closing_at_us, .. } = self.link {
            // What does not fit is told when there is room again.
            let _ = self.declarations.tell(&mut self.transmit);
            self.transmit.poll(out);
            if closing_at_us.is_some() && self.transmit.is_empty() {
                handshake::write_close(out, close::reason::GENERIC);
                self.end(CloseReason::Local);
            }
        }
        let appended_bytes = out.len() - start;
        if appended_bytes > 0 {
            self.last_sent_us = self.now_us;
        }
        appended_bytes
    }

    /// What happened next, oldest first.
    pub fn poll_event(&mut self) -> Option<Event> {
        let event = self.events.pop_front();
        if event.is_some()
            && self.events.len() < limits::EVENTS_MAX
            && let Err(error) = self.decode()
        {
            self.fail(error);
        }
        event
    }

    /// The handshake is complete and nobody has closed.
    pub fn is_open(&self) -> bool {
        matches!(
            self.link,
            Link::Open {
                closing_at_us: None,
                ..
            }
        )
    }

    /// Ends the session for good: what is queued is still sent, then the peer is told.
    /// [`Session::wants_disconnect`] tells when that is done, after
    /// [`limits::CLOSE_TIMEOUT_US`] at the latest.
    pub fn close(&mut self, now_us: u64) {
        self.tick(now_us);
        self.finished = true;
        match &mut self.link {
            Link::Closed => {}
            Link::Init { .. } | Link::Opening { .. } => {
                self.end(CloseReason::Local);
                handshake::write_close(&mut self.control, close::reason::GENERIC);
            }
            Link::Open { closing_at_us, .. } => {
                let at_us = self.now_us.saturating_add(limits::CLOSE_TIMEOUT_US);
                closing_at_us.get_or_insert(at_us);
            }
        }
    }

    /// What went otherwise than it should.
    pub fn counters(&self) -> Counters {
        self.counters
    }

    // ---- inside ----

    fn tick(&mut self, now_us: u64) {
        self.now_us = self.now_us.max(now_us);
    }

    fn keep_alive_at_us(&self) -> u64 {
        self.last_sent_us
            .saturating_add(self.config.lease_us / limits::KEEP_ALIVES_PER_LEASE)
    }

    fn fresh_zid(&mut self) -> ZenohIdProto {
        let mut bytes = [0; 16];
        bytes[..8].copy_from_slice(&self.random.next_u64().to_le_bytes());
        bytes[8..].copy_from_slice(&self.random.next_u64().to_le_bytes());
        // An id ends at its last byte that is not 0, and is never all 0.
        bytes[15] |= 1;
        ZenohIdProto::try_from(bytes.as_slice()).expect("16 bytes that are not all 0")
    }

    fn take_bytes(&mut self, bytes: &[u8]) -> Result<(), SessionError> {
        for piece in bytes.chunks(limits::INPUT_PIECE_BYTES) {
            if matches!(self.link, Link::Closed) {
                // The conversation is over; the stream ends when our last word is out.
                return Ok(());
            }
            self.reader.push(piece)?;
            self.decode()?;
        }
        Ok(())
    }

    /// What cannot be understood ends the conversation.
    fn fail(&mut self, error: SessionError) {
        self.counters.decode_errors = self.counters.decode_errors.wrapping_add(1);
        self.end(CloseReason::Protocol(error));
    }

    /// The conversation is over; the stream may still be there.
    fn end(&mut self, reason: CloseReason) {
        let link = core::mem::replace(&mut self.link, Link::Closed);
        let reason = match link {
            Link::Closed => return,
            Link::Init { .. } | Link::Opening { .. } => {
                self.counters.failed_connects = self.counters.failed_connects.wrapping_add(1);
                reason
            }
            Link::Open {
                opened_at_us,
                closing_at_us,
                ..
            } => {
                // A session that outlived a lease was a good one; a router that accepts and
                // closes at once must not be hammered.
                if self.now_us.saturating_sub(opened_at_us) >= self.config.lease_us {
                    self.backoff.reset();
                }
                if closing_at_us.is_some() {
                    CloseReason::Local
                } else {
                    reason
                }
            }
        };
        let unsent_count = self.transmit.clear();
        self.counters.unsent = self.counters.unsent.wrapping_add(unsent_count as u32);
        self.receiver.clear();
        self.peer.clear();
        self.reader.reset(self.config.batch_bytes);
        self.decoding = None;
        for query in core::mem::take(&mut self.queries.outbound) {
            self.finish_query(query, true);
        }
        self.queries.inbound.clear();
        self.events.push_back(Event::Closed { reason });
        self.schedule_retry();
    }

    fn schedule_retry(&mut self) {
        let pause_us = self.backoff.pause_us(&mut self.random);
        self.retry_at_us = self.now_us.saturating_add(pause_us);
    }

    fn open(&mut self, grant: &Grant, own_sn: TransportSn, peer_lease_us: u64, peer_sn: u32) {
        self.transmit.open(transmit::Terms {
            batch_bytes: grant.batch_bytes,
            qos: grant.qos,
            sn_mask: grant.sn_mask,
            initial_sn: own_sn,
            markers: grant.markers,
        });
        self.receiver.open(receive::Terms {
            qos: grant.qos,
            sn_mask: grant.sn_mask,
            initial_sn: peer_sn,
            markers: grant.markers,
        });
        self.declarations.forget_told();
        self.peer.clear();
        self.link = Link::Open {
            opened_at_us: self.now_us,
            peer_lease_us,
            request_id_mask: grant.request_id_mask,
            closing_at_us: None,
        };
        if self.counters.opened > 0 {
            self.counters.reconnects = self.counters.reconnects.wrapping_add(1);
        }
        self.counters.opened = self.counters.opened.saturating_add(1);
        self.events.push_back(Event::Opened);
    }
}

impl From<ReadError> for SessionError {
    fn from(error: ReadError) -> Self {
        match error {
            ReadError::Oversized => Self::Oversized,
            ReadError::Full => Self::InputFull,
        }
    }
}
