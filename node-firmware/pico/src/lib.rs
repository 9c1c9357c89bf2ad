//! A zenoh client for constrained devices, as a state machine.
//!
//! ```text
//!            application                         App::poll in driver.rs
//!   declare put get reply │ ▲ poll_event
//!                         ▼ │
//!   ┌───────────────── Session ─────────────────┐
//!   │ declarations  queries  peer   ◀─ session/ │   no clock, no socket
//!   │ transmit ─▶ batches   batches ─▶ receive  │
//!   └──────┬────────────────────────────▲───────┘
//!  poll_transmit                  handle_bytes
//!          ▼                            │
//!            driver.rs: connect, read, write, wait
//! ```
//!
//! Read [`session`] first, then [`event`] for what is said and heard, then [`driver`] for the
//! shell around it. [`limits`] has every bound.
//!
//! The feature set and the behaviour on the wire are those of a zenoh-pico client over TCP,
//! with two additions: priorities with their own sequences, and user/password authentication.
//! Messages are encoded and decoded by the zenoh project's own `no_std` crates.
//!
//! ```
//! use pico::{PutOptions, Session, SessionConfig};
//!
//! let mut session = Session::new(SessionConfig::default(), 42 /* random on every start */);
//! let status = session.declare_publisher("fleet/node/left/status").unwrap();
//! session.handle_connected(0);
//! let mut bytes = Vec::new();
//! session.poll_transmit(0, &mut bytes); // to be sent: the first message of the handshake
//! assert!(!bytes.is_empty());
//! // Nothing is published before the router has answered.
//! assert!(session.put(status, b"all well", &PutOptions::default()).is_err());
//! ```
//!
//! [`scout`] finds the router in the network, before there is a session.
//!
//! Deliberately absent: peers, sessions over multicast, TLS (a [`driver::Connect`] may bring
//! its own stream), shared memory, compression, and anything about what the bytes mean.
#![no_std]

extern crate alloc;
#[cfg(test)]
extern crate std;

mod backoff;
mod declarations;
pub mod driver;
pub mod event;
pub mod limits;
mod peer;
mod queries;
mod random;
pub mod reader;
mod receive;
pub mod scout;
pub mod session;
mod transmit;
mod wire;

pub use event::{
    CloseReason, Congestion, Consolidation, Counters, DeclareError, Encoding, Event, GetError,
    GetOptions, InboundQuery, KeyId, KeyRef, LivelinessId, PeerReason, Priority, PublisherId,
    PutError, PutOptions, QueryId, QueryTarget, QueryableId, ReplyError, Sample, SampleKind,
    SessionError, SubscriberId, Timestamp, TokenId, UndeclareError,
};
pub use session::{Credentials, Session, SessionConfig};
