//! Every bound of the client, with its arithmetic.
//!
//! The sizes that an application may want to change are only defaults here and fields of
//! [`SessionConfig`](crate::session::SessionConfig); the others are fixed.

/// Batch size offered to the peer, length prefix included; zenoh-pico's default.
pub const BATCH_BYTES_DEFAULT: u16 = 2048;

/// Smallest batch that carries every handshake message: OpenSyn is the longest with a cookie of
/// about 50 bytes, a user name of up to [`USER_BYTES_MAX`] and a MAC of 32 bytes.
pub const BATCH_BYTES_MIN: u16 = 256;

/// Longest user name that fits an OpenSyn of [`BATCH_BYTES_MIN`].
pub const USER_BYTES_MAX: usize = 64;

/// Lease that we announce: the peer drops the link when it hears nothing for so long.
pub const LEASE_US_DEFAULT: u64 = 10_000_000;

/// Keep-alives per lease. Three may be lost to a busy sender before the fourth decides.
pub const KEEP_ALIVES_PER_LEASE: u64 = 4;

/// Largest message that is put together from fragments; zenoh-pico's default.
pub const FRAGMENT_BYTES_MAX_DEFAULT: usize = 4096;

/// Chains of the largest size that may be in assembly at the same time: one of bulk data and one
/// of a higher priority that overtakes it.
pub const FRAGMENT_CHAINS_MAX: usize = 2;

/// Bytes that wait for transmission, over all priorities.
pub const QUEUE_BYTES_DEFAULT: usize = 16 * 1024;

/// Part of the queue that only declarations and real-time messages may use, so that a stop
/// report finds room behind a flood of status.
pub const QUEUE_RESERVE_BYTES: usize = 2048;

/// What a queued message costs beside its bytes.
pub const QUEUE_ENTRY_BYTES: usize = 8;

/// Memory that an empty priority keeps; what a burst needed beyond it is given back. The queue
/// thus holds at most `queue_bytes`, the same again in front of it that has just left, and this
/// for each of eight priorities.
pub const QUEUE_KEEP_BYTES: usize = 2048;

/// A call of `poll_transmit` starts no further batch once it has appended so many bytes: a
/// real-time message waits behind at most this plus one batch.
pub const TRANSMIT_BYTES: usize = 4096;

/// Decoding pauses at the next batch border when so many events wait. The queue therefore holds
/// at most this many plus the messages of one batch (at least 4 bytes each).
pub const EVENTS_MAX: usize = 64;

/// Undecoded input that is kept while events wait to be taken. A driver that honours
/// `wants_bytes` never gets near it.
pub const INPUT_BYTES_MAX: usize = 128 * 1024;

/// Piece in which a chunk of input is taken, so that a long chunk is decoded as it is copied.
pub const INPUT_PIECE_BYTES: usize = 4096;

/// Bytes that the driver reads at once, or a whole batch if that is longer.
pub const READ_BYTES: usize = 2048;

/// Longest key expression that can be declared, published or asked for; zenoh-pico's default.
pub const KEY_BYTES_MAX: usize = 256;

/// Longest key of a received value that needs no memory of its own. The keys of a fleet with its
/// default prefix are at most 54 bytes long.
pub const KEY_INLINE_BYTES: usize = 62;

/// Key expressions that we declare, by themselves or under a publisher, subscriber or queryable.
pub const KEYS_MAX: usize = 128;
/// Key expressions that the peer declares.
pub const PEER_KEYS_MAX: usize = 64;
/// Subscribers of this session.
pub const SUBSCRIBERS_MAX: usize = 32;
/// Queryables of this session.
pub const QUERYABLES_MAX: usize = 16;
/// Publishers of this session.
pub const PUBLISHERS_MAX: usize = 32;
/// Liveliness tokens of this session.
pub const TOKENS_MAX: usize = 8;
/// Liveliness subscribers of this session.
pub const LIVELINESS_SUBSCRIBERS_MAX: usize = 8;
/// Declarations that are taken back but not yet told to the peer.
pub const LEAVING_MAX: usize = 32;
/// Subscribers of others that the peer tells of. Interests ask for aggregates, so one per
/// publisher is the rule; beyond the bound every publisher counts as wanted.
pub const PEER_SUBSCRIBERS_MAX: usize = 64;
/// Liveliness tokens of others that are remembered; one per node of a fleet.
pub const PEER_TOKENS_MAX: usize = 256;
/// Own queries that wait for their last reply.
pub const QUERIES_OUT_MAX: usize = 16;
/// Queries of others that wait for our last reply.
pub const QUERIES_IN_MAX: usize = 16;
/// Replies that a query with consolidation keeps back until it is complete. Further keys pass
/// unconsolidated.
pub const REPLIES_HELD_MAX: usize = 32;

/// How long a query waits for its last reply unless it says otherwise; zenoh's default.
pub const GET_TIMEOUT_US_DEFAULT: u64 = 10_000_000;

/// Time to connect, and again to complete the handshake.
pub const CONNECT_TIMEOUT_US_DEFAULT: u64 = 10_000_000;

/// First pause before a new connection attempt.
pub const BACKOFF_US_MIN_DEFAULT: u64 = 250_000;

/// Longest pause before a new connection attempt. A fleet that lost its router comes back within
/// this time, spread by the jitter.
pub const BACKOFF_US_MAX_DEFAULT: u64 = 8_000_000;

/// How long an orderly end may take to leave the queue before the link is dropped all the same.
pub const CLOSE_TIMEOUT_US: u64 = 1_000_000;

const _: () = assert!(QUEUE_RESERVE_BYTES < QUEUE_BYTES_DEFAULT);
const _: () = assert!(BATCH_BYTES_MIN as usize > 50 + USER_BYTES_MAX + 32 + 32);
const _: () = assert!(INPUT_BYTES_MAX > u16::MAX as usize + INPUT_PIECE_BYTES);
const _: () = assert!(READ_BYTES <= INPUT_PIECE_BYTES);
