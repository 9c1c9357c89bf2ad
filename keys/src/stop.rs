//! The stop, why it came, and what was true afterwards.

use crate::{AXES_MAX, LocalMicros, batch::QueueId};
use serde::{Deserialize, Serialize};

/// How to come to rest.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "json", serde(rename_all = "snake_case"))]
pub enum StopMode {
    /// At once.
    #[default]
    Halt,
    /// By the ramp that each axis allows.
    Decelerate,
}

/// A client's stop, as it arrives on the key `stop`.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Stop {
    /// How to come to rest.
    pub mode: StopMode,
}

impl Stop {
    /// Reads the payload of the key `stop`: empty, or JSON `{"mode":"halt"}` or
    /// `{"mode":"decelerate"}`. Whatever else it is, it is a stop: then [`StopMode::Halt`].
    pub fn from_payload(payload: &[u8]) -> Self {
        let mut significant = payload.iter().filter(|byte| !byte.is_ascii_whitespace());
        let decelerate = br#"{"mode":"decelerate"}"#;
        let mode = if decelerate
            .iter()
            .all(|byte| significant.next() == Some(byte))
            && significant.next().is_none()
        {
            StopMode::Decelerate
        } else {
            StopMode::Halt
        };
        Self { mode }
    }

    /// Returns the payload that [`Stop::from_payload`] reads.
    pub const fn to_payload(self) -> &'static [u8] {
        match self.mode {
            StopMode::Halt => br#"{"mode":"halt"}"#,
            StopMode::Decelerate => br#"{"mode":"decelerate"}"#,
        }
    }
}

/// Why a node stopped. Numbers on the wire are the order here: append only.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "json", serde(rename_all = "snake_case"))]
pub enum StopReason {
    /// A message on the key `stop`.
    Client,
    /// The stop input.
    Pin,
    /// The link was lost while moving.
    Link,
    /// A fault.
    Fault,
    /// A limit switch or soft limit.
    Limit,
    /// The gateway dropped the queue; no latch.
    Cancel,
}

impl StopReason {
    /// Returns the word that clients see.
    pub const fn as_str(self) -> &'static str {
        match self {
            Self::Client => "client",
            Self::Pin => "pin",
            Self::Link => "link",
            Self::Fault => "fault",
            Self::Limit => "limit",
            Self::Cancel => "cancel",
        }
    }
}

/// What was true when the last pulse of a dropped queue had left the pin.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct StopReport {
    /// The queue that ended.
    pub queue: QueueId,
    /// Why.
    pub reason: StopReason,
    /// When the stop was taken.
    pub at: LocalMicros,
    /// How many commands of that queue it had accepted.
    pub accepted_commands: u64,
    /// How many of them had ended; the next one may have been cut short.
    pub executed_commands: u64,
    /// Exact position of each axis, steps.
    pub positions_steps: heapless::Vec<i64, AXES_MAX>,
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn whatever_arrives_on_the_stop_key_stops() {
        let mode = |payload: &[u8]| Stop::from_payload(payload).mode;
        assert_eq!(mode(b""), StopMode::Halt);
        assert_eq!(mode(br#"{"mode":"halt"}"#), StopMode::Halt);
        assert_eq!(mode(br#"{"mode":"decelerate"}"#), StopMode::Decelerate);
        assert_eq!(
            mode(b" {\n \"mode\" : \"decelerate\" } "),
            StopMode::Decelerate
        );
        assert_eq!(mode(br#"{"mode":"decelerate"}}"#), StopMode::Halt);
        assert_eq!(mode(br#"{"mode":"gently"}"#), StopMode::Halt);
        assert_eq!(mode(b"\xff\x00"), StopMode::Halt);
        for mode in [StopMode::Halt, StopMode::Decelerate] {
            assert_eq!(
                Stop::from_payload(Stop { mode }.to_payload()),
                Stop { mode }
            );
        }
    }
}
