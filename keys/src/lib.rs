//! The fleet's vocabulary: what is said, on which key, in which bytes.
//!
//! ```text
//!   clients ── job text (JSON) ──▶ gateway ── Order: batch, cancel, release ──▶ node
//!                                     ▲ ◀──────── BatchAck, Status ───────────── │
//!   clients ◀─ JobRecord, NodeRecord ─┘                                          │
//!   clients ───────────────── stop (straight to the node) ──────────────────────▶┘
//! ```
//!
//! Read in this order: [`topics`] (the table of keys), [`command`] (what a node can be told),
//! [`batch`] (how commands travel), [`status`] and [`stop`] (what comes back), `job` (the JSON
//! side, behind the feature `json`), [`version`] (how messages may change).
//!
//! This crate imports nothing of ours and holds no behaviour beyond reading, writing and
//! checking. Postcard bytes of every message are frozen in `tests/bytes_v1.rs`.
#![no_std]

#[cfg(feature = "json")]
extern crate std;

pub mod batch;
pub mod clock;
pub mod command;
#[cfg(feature = "json")]
pub mod credentials;
pub mod epoch;
pub mod ids;
#[cfg(feature = "json")]
pub mod job;
pub mod jog;
pub mod key;
pub mod pace;
#[cfg(feature = "json")]
pub mod record;
pub mod script;
#[cfg(feature = "json")]
pub mod secret;
pub mod setup;
#[cfg(feature = "signed")]
pub mod signed;
#[cfg(feature = "signed")]
pub mod signed_script;
#[cfg(feature = "json")]
pub mod signers;
pub mod start;
pub mod status;
pub mod stop;
pub mod topics;
pub mod trace;
pub mod units;
pub mod update;
pub mod version;
pub mod vitals;

pub use batch::{BatchAck, BatchHeader, BatchReader, Order, QueueId, Refusal, Verdict};
pub use command::{Command, Features};
pub use ids::{AxisId, GroupId, JobId, NodeId};
pub use key::{Keys, Topic};
pub use script::{ScriptHeader, ScriptOutcome, ScriptReport};
pub use setup::Setup;
pub use status::{AxisStatus, Fault, NodeState, Status};
pub use stop::{Stop, StopMode, StopReason, StopReport};
pub use topics::NodeTopic;
pub use units::{FleetMicros, LocalMicros};
pub use vitals::Vitals;

/// Most axes that one node can have (X, Y, Z, A by RMT; C by MCPWM; D by LEDC).
pub const AXES_MAX: usize = 6;
