//! What a node tells of a job while it happens, on the key `trace`: one event in each message, in the
//! node's own time.
//!
//! A message is said once. Those that a broken link has taken are missed by their numbers, which grow
//! by one with each event since the node's boot.

use crate::{JobId, LocalMicros, StopReason, status::FaultCode};
use serde::{Deserialize, Serialize};

/// Most bytes of an event on the wire.
pub const TRACE_BYTES_MAX: usize = 64;

/// Something happened on a node.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct TraceEvent {
    /// The node's boot.
    pub boot: u32,
    /// How many events there were before it since the boot.
    pub number: u32,
    /// When, on the node's clock.
    pub at: LocalMicros,
    /// The job that it belongs to; `None`: to none.
    pub job: Option<JobId>,
    /// What.
    pub what: TraceWord,
}

/// What happened. Append only.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum TraceWord {
    /// The first commands of the job are in the queue, or its script begins.
    Taken,
    /// The first active edge of the job has left.
    FirstPulse,
    /// The last command of the job has ended: its last pulse has left, and its interval is over.
    Ended,
    /// A hold begins: it comes to rest on its path.
    Held,
    /// It goes on after a hold.
    Resumed,
    /// Another speed, percent of what the commands ask for.
    Speed {
        /// The percent.
        percent: u16,
    },
    /// A stop begins.
    StopTaken(StopReason),
    /// A stop is complete: the last pulse has left.
    Stopped(StopReason),
    /// The link stayed away while commands were executed.
    LinkLost,
    /// A fault was noted.
    Fault(FaultCode),
    /// The script has returned; what it queued may still be executed.
    ScriptEnded,
    /// The script has failed.
    ScriptFailed,
}

impl core::fmt::Display for TraceWord {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        match self {
            Self::Taken => write!(f, "taken: its first commands are in the queue"),
            Self::FirstPulse => write!(f, "first pulse"),
            Self::Ended => write!(f, "last pulse is out"),
            Self::Held => write!(f, "held on its path"),
            Self::Resumed => write!(f, "goes on"),
            Self::Speed { percent } => write!(f, "speed {percent} %"),
            Self::StopTaken(reason) => write!(f, "stop begins: {}", reason.as_str()),
            Self::Stopped(reason) => write!(f, "stopped: {}", reason.as_str()),
            Self::LinkLost => write!(f, "link lost while moving"),
            Self::Fault(code) => write!(f, "fault {}: {}", code.0, code.as_str()),
            Self::ScriptEnded => write!(f, "script has returned"),
            Self::ScriptFailed => write!(f, "script has failed"),
        }
    }
}
