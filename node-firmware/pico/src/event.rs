//! What the application says and hears: samples, events, options, ids, errors.
//!
//! Plain values without behaviour. Everything received is owned, so an
//! application may keep it as long as it likes without keeping the batch it came in.

use alloc::{string::String, vec::Vec};
use core::fmt;

pub use zenoh_protocol::core::Timestamp;

use crate::key::Key;

macro_rules! ids {
    ($($(#[$doc:meta])* $name:ident($inner:ty);)*) => {$(
        $(#[$doc])*
        #[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
        pub struct $name(pub(crate) $inner);
    )*};
}

ids! {
    /// A subscriber of this session.
    SubscriberId(u32);
    /// A queryable of this session.
    QueryableId(u32);
    /// A publisher of this session.
    PublisherId(u32);
    /// A liveliness token of this session.
    TokenId(u32);
    /// A liveliness subscriber of this session.
    LivelinessId(u32);
    /// A key expression that was declared by itself.
    KeyId(u32);
    /// A query of this session that waits for replies.
    QueryId(u32);
}

/// A query of somebody else that waits for our replies. Ends with the connection it came on.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub struct InboundQuery {
    /// Unique over all connections of a session, unlike the peer's number.
    pub(crate) serial: u32,
    pub(crate) queryable: QueryableId,
}

/// Where to publish.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum KeyRef<'a> {
    /// The key of a publisher; costs two bytes on the wire.
    Publisher(PublisherId),
    /// A declared key; costs two bytes on the wire.
    Declared(KeyId),
    /// Any key, sent in full.
    Key(&'a str),
}

impl<'a> From<&'a str> for KeyRef<'a> {
    fn from(key: &'a str) -> Self {
        Self::Key(key)
    }
}

impl From<KeyId> for KeyRef<'_> {
    fn from(key: KeyId) -> Self {
        Self::Declared(key)
    }
}

impl From<PublisherId> for KeyRef<'_> {
    fn from(publisher: PublisherId) -> Self {
        Self::Publisher(publisher)
    }
}

/// The order in which messages overtake each other, first to last.
#[derive(Debug, Default, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
#[repr(u8)]
pub enum Priority {
    /// For stop and clock: has a reserve of the transmit queue.
    RealTime = 1,
    /// Above [`Priority::InteractiveLow`].
    InteractiveHigh = 2,
    /// Above [`Priority::DataHigh`].
    InteractiveLow = 3,
    /// Above [`Priority::Data`].
    DataHigh = 4,
    /// What is not said otherwise.
    #[default]
    Data = 5,
    /// Below [`Priority::Data`].
    DataLow = 6,
    /// Last.
    Background = 7,
}

/// What routers do with a message when a queue of theirs is full. Our own queue answers
/// [`PutError::Full`] in both cases.
#[derive(Debug, Default, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Congestion {
    /// Drop it after a short wait; zenoh's default.
    #[default]
    Drop,
    /// Wait for room.
    Block,
}

/// What a payload is. Zenoh lists the ids; 0 is plain bytes.
#[derive(Debug, Default, Clone, PartialEq, Eq, Hash)]
pub struct Encoding {
    /// Number of the encoding.
    pub id: u16,
    /// Free text that narrows it, as `utf-8`.
    pub schema: Option<Vec<u8>>,
}

/// Whether a sample sets or deletes the value of its key.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum SampleKind {
    /// The payload is the new value.
    Put,
    /// The value is gone; the payload is empty.
    Delete,
}

/// A value that somebody published or replied.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Sample {
    /// The key as it was sent; it may be wild.
    pub key: Key,
    /// The value.
    pub payload: Vec<u8>,
    /// Set or deleted.
    pub kind: SampleKind,
    /// What the payload is.
    pub encoding: Encoding,
    /// What the sender pinned to it.
    pub attachment: Option<Vec<u8>>,
    /// When it was published; routers add it where senders do not.
    pub timestamp: Option<Timestamp>,
    /// Its place among the messages.
    pub priority: Priority,
    /// What routers were to do when full.
    pub congestion: Congestion,
    /// It was sent without waiting for others.
    pub express: bool,
}

/// How to publish or reply.
#[derive(Debug, Default, Clone, PartialEq, Eq)]
pub struct PutOptions {
    /// What the payload is.
    pub encoding: Encoding,
    /// Bytes pinned to the message.
    pub attachment: Option<Vec<u8>>,
    /// Its place among the messages.
    pub priority: Priority,
    /// What routers do when full.
    pub congestion: Congestion,
    /// Nothing is put behind it into the same batch, and routers pass it on at once.
    pub express: bool,
    /// Passed through.
    pub timestamp: Option<Timestamp>,
}

/// Which queryables a query goes to.
#[derive(Debug, Default, Clone, Copy, PartialEq, Eq, Hash)]
pub enum QueryTarget {
    /// The nearest complete one, else all.
    #[default]
    BestMatching,
    /// All that match.
    All,
    /// All that declared to be complete.
    AllComplete,
}

/// What happens to several replies for one key.
#[derive(Debug, Default, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Consolidation {
    /// [`Consolidation::None`] if the parameters name a time range (`_time`), else
    /// [`Consolidation::Latest`].
    #[default]
    Auto,
    /// All are passed on.
    None,
    /// A reply older than one that was passed on is dropped.
    Monotonic,
    /// Only the newest is passed on, once all have come.
    Latest,
}

/// How to ask.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct GetOptions {
    /// Who is asked.
    pub target: QueryTarget,
    /// What happens to several replies for one key.
    pub consolidation: Consolidation,
    /// How long to wait for the last reply, in microseconds.
    pub timeout_us: u64,
    /// What the payload of the question is.
    pub encoding: Encoding,
    /// Bytes pinned to the question.
    pub attachment: Option<Vec<u8>>,
    /// Its place among the messages.
    pub priority: Priority,
    /// What routers do when full.
    pub congestion: Congestion,
    /// Nothing is put behind it into the same batch.
    pub express: bool,
}

impl Default for GetOptions {
    fn default() -> Self {
        Self {
            target: QueryTarget::default(),
            consolidation: Consolidation::default(),
            timeout_us: crate::limits::GET_TIMEOUT_US_DEFAULT,
            encoding: Encoding::default(),
            attachment: None,
            priority: Priority::default(),
            congestion: Congestion::Block,
            express: false,
        }
    }
}

/// Why a peer ended the conversation, by its number on the wire.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum PeerReason {
    /// 0: no particular reason, among them wrong credentials.
    Generic,
    /// 1: something was asked that the peer cannot do.
    Unsupported,
    /// 2: we said something that it does not understand.
    Invalid,
    /// 3: it has too many sessions.
    MaxSessions,
    /// 4: it has too many links with this session id.
    MaxLinks,
    /// 5: it heard nothing from us for a lease.
    Expired,
    /// 6: we did not take what it sent.
    Unresponsive,
    /// 7: it is we.
    ConnectionToSelf,
    /// A number from a newer version.
    Other(u8),
}

impl From<u8> for PeerReason {
    fn from(number: u8) -> Self {
        match number {
            0 => Self::Generic,
            1 => Self::Unsupported,
            2 => Self::Invalid,
            3 => Self::MaxSessions,
            4 => Self::MaxLinks,
            5 => Self::Expired,
            6 => Self::Unresponsive,
            7 => Self::ConnectionToSelf,
            other => Self::Other(other),
        }
    }
}

/// Why a connection ended.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum CloseReason {
    /// The byte stream ended.
    Lost,
    /// The peer said nothing for its lease.
    LeaseExpired,
    /// The handshake was not complete in time.
    HandshakeTimeout,
    /// The peer ended the handshake, as it does for wrong credentials.
    Refused(PeerReason),
    /// The peer ended the open session.
    Peer(PeerReason),
    /// The peer said something that cannot be understood.
    Protocol(SessionError),
    /// We were told to close.
    Local,
}

/// What a peer said that cannot be.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum SessionError {
    /// Bytes that are no message.
    Decode,
    /// A batch longer than agreed.
    Oversized,
    /// A sequence number beyond the agreed resolution.
    SequenceNumber,
    /// A priority although none were agreed.
    Priority,
    /// A message out of turn, or terms that were not offered, in the handshake.
    Handshake,
    /// The peer does not offer the authentication that we are configured for.
    NoAuthentication,
    /// Events were not taken and input piled up to its bound.
    InputFull,
    /// Bytes came while no connection was open.
    NotConnected,
}

impl fmt::Display for SessionError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Decode => "bytes that are no zenoh message",
            Self::Oversized => "a batch longer than agreed",
            Self::SequenceNumber => "a sequence number beyond the agreed resolution",
            Self::Priority => "a priority although none were agreed",
            Self::Handshake => "a handshake message out of turn or with terms not offered",
            Self::NoAuthentication => "the peer offers no user/password authentication",
            Self::InputFull => "input piled up because events were not taken",
            Self::NotConnected => "bytes without a connection",
        })
    }
}

impl core::error::Error for SessionError {}

/// Why a declaration was not made.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum DeclareError {
    /// Not a canonical key expression, or longer than
    /// [`KEY_BYTES_MAX`](crate::limits::KEY_BYTES_MAX).
    Key,
    /// The table of its kind is full; the bounds are in [`limits`](crate::limits).
    Full,
}

impl fmt::Display for DeclareError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Key => "not a canonical key expression of bounded length",
            Self::Full => "the table of declarations is full",
        })
    }
}

impl core::error::Error for DeclareError {}

/// Why a declaration was not taken back.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum UndeclareError {
    /// There is no such declaration.
    Unknown,
    /// Too many declarations that were taken back wait to be told; try again after transmission.
    Full,
}

impl fmt::Display for UndeclareError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Unknown => "no such declaration",
            Self::Full => "too many undeclarations wait to be told",
        })
    }
}

impl core::error::Error for UndeclareError {}

macro_rules! send_errors {
    ($($(#[$doc:meta])* $name:ident { $($(#[$vdoc:meta])* $variant:ident = $text:literal,)* })*) => {$(
        $(#[$doc])*
        #[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
        pub enum $name {
            /// The session is not open.
            Closed,
            /// The transmit queue is full: try again after transmission.
            Full,
            /// The message would not fit an empty transmit queue.
            TooLarge,
            /// Not a canonical key expression of bounded length.
            Key,
            $($(#[$vdoc])* $variant,)*
        }

        impl fmt::Display for $name {
            fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                f.write_str(match self {
                    Self::Closed => "the session is not open",
                    Self::Full => "the transmit queue is full",
                    Self::TooLarge => "larger than the transmit queue",
                    Self::Key => "not a canonical key expression of bounded length",
                    $(Self::$variant => $text,)*
                })
            }
        }

        impl core::error::Error for $name {}

        impl From<crate::transmit::PushError> for $name {
            fn from(error: crate::transmit::PushError) -> Self {
                match error {
                    crate::transmit::PushError::Full => Self::Full,
                    crate::transmit::PushError::TooLarge => Self::TooLarge,
                }
            }
        }
    )*};
}

send_errors! {
    /// Why a value was not published. Nothing of it was queued.
    PutError {
        /// The publisher or declared key does not exist.
        Unknown = "no such publisher or declared key",
    }
    /// Why a query was not sent. Nothing of it was queued.
    GetError {
        /// Too many queries wait for replies.
        TooMany = "too many queries wait for replies",
    }
    /// Why a reply was not sent. Nothing of it was queued.
    ReplyError {
        /// The query is over: complete, timed out, or of an earlier connection.
        Unknown = "the query is over",
    }
}

/// What happened.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Event {
    /// The session is open. All declarations are on their way.
    Opened,
    /// A connection ended, whether or not it had come to be open. What was queued is lost, and
    /// what was known of others (liveliness, wanted) is unknown again.
    Closed {
        /// Why.
        reason: CloseReason,
    },
    /// Somebody published on a key of a subscriber.
    Message {
        /// Whose key matches; a message comes once for each.
        subscriber: SubscriberId,
        /// What was published.
        sample: Sample,
    },
    /// Somebody asks. To be answered by any number of replies and one final.
    Query {
        /// Names the query in the replies.
        query: InboundQuery,
        /// Whose key matches; a query comes once for each.
        queryable: QueryableId,
        /// What is asked for, as it was sent; it may be wild.
        key: String,
        /// The part after the `?` of a selector.
        parameters: String,
        /// A value that came with the question.
        payload: Option<Vec<u8>>,
        /// What that value is.
        encoding: Encoding,
        /// Bytes pinned to the question.
        attachment: Option<Vec<u8>>,
    },
    /// Somebody answered.
    Reply {
        /// Which question.
        query: QueryId,
        /// The answer.
        sample: Sample,
    },
    /// Somebody answered that he cannot.
    ReplyError {
        /// Which question.
        query: QueryId,
        /// What he says.
        payload: Vec<u8>,
        /// What that is.
        encoding: Encoding,
    },
    /// No further answers come.
    ReplyFinal {
        /// Which question.
        query: QueryId,
        /// Cut off by the timeout or the end of the connection: there may have been more.
        timed_out: bool,
    },
    /// A liveliness token appeared or vanished.
    Liveliness {
        /// Whose key matches.
        subscriber: LivelinessId,
        /// The token's key.
        key: String,
        /// It is there.
        alive: bool,
    },
    /// Somebody, or nobody any more, wants what a publisher sends. Comes first when the router
    /// has answered, then at every change.
    Wanted {
        /// Which publisher.
        publisher: PublisherId,
        /// Somebody wants it.
        wanted: bool,
    },
}

/// What went otherwise than it should, since the session was made. All wrap around.
#[derive(Debug, Default, Clone, Copy, PartialEq, Eq)]
pub struct Counters {
    /// Sessions that were opened.
    pub opened: u32,
    /// Sessions that were opened after the first.
    pub reconnects: u32,
    /// Attempts that did not come to a connection or were refused.
    pub failed_connects: u32,
    /// Sequence numbers that were skipped on the way to us: messages that are lost.
    pub gaps: u32,
    /// Frames and fragments that were dropped because their number was not after the last.
    pub stale: u32,
    /// Messages dropped because they named a key or query that we do not know.
    pub unknown_ids: u32,
    /// Fragmented messages that were not put together: too long, incomplete, or given up by the
    /// peer.
    pub reassembly_drops: u32,
    /// Batches with something that could not be decoded; each ended a connection.
    pub decode_errors: u32,
    /// What the peer declared or asked beyond a bound of ours and was turned away.
    pub refused: u32,
    /// Puts, replies and queries that were queued when a connection ended.
    pub unsent: u32,
    /// Queries of others that we did not complete in time.
    pub unanswered: u32,
    /// Messages that no subscriber wanted.
    pub unwanted: u32,
}
