//! The synchronized start on the key `start`: ready → commit → confirm → started, or abort.
//!
//! A start is a barrier at the head of each node's queue. Times are in the node's own clock.
//!
//! The gateway knows the barriers of a list of commands before it runs, those of a script only when
//! the script comes to one: then the node says [`StartMessage::ReadyAt`] with the name, in place of
//! Ready.

use crate::{LocalMicros, batch::QueueId};
use core::fmt;
use serde::{Deserialize, Deserializer, Serialize, Serializer, de};

/// Longest name of a barrier, bytes.
pub const BARRIER_BYTES_MAX: usize = 64;

/// The name of a meeting point: 1 to [`BARRIER_BYTES_MAX`] bytes of any text.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub struct BarrierName {
    // Unused bytes are zero, so that derived order and equality are those of the text.
    bytes: [u8; BARRIER_BYTES_MAX],
    byte_count: u8,
}

impl BarrierName {
    /// Checks the text and keeps it; `None` if it is empty or too long.
    pub fn new(text: &str) -> Option<Self> {
        let mut bytes = [0; BARRIER_BYTES_MAX];
        bytes
            .get_mut(..text.len())?
            .copy_from_slice(text.as_bytes());
        (!text.is_empty()).then_some(Self {
            bytes,
            byte_count: text.len() as u8,
        })
    }

    /// Returns the text.
    pub fn as_str(&self) -> &str {
        core::str::from_utf8(&self.bytes[..usize::from(self.byte_count)])
            .expect("it was made from a text")
    }
}

impl fmt::Debug for BarrierName {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{:?}", self.as_str())
    }
}

impl Serialize for BarrierName {
    fn serialize<S: Serializer>(&self, to: S) -> Result<S::Ok, S::Error> {
        to.serialize_str(self.as_str())
    }
}

impl<'de> Deserialize<'de> for BarrierName {
    fn deserialize<D: Deserializer<'de>>(from: D) -> Result<Self, D::Error> {
        struct Visitor;
        impl de::Visitor<'_> for Visitor {
            type Value = BarrierName;
            fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                write!(f, "a text of 1 to {BARRIER_BYTES_MAX} bytes")
            }
            fn visit_str<E: de::Error>(self, text: &str) -> Result<BarrierName, E> {
                BarrierName::new(text).ok_or_else(|| E::invalid_length(text.len(), &self))
            }
        }
        from.deserialize_str(Visitor)
    }
}

/// Both directions share the key, so the message says which one it is.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum StartMessage {
    /// Node → gateway: everything before the barrier has ended, what follows is loaded.
    Ready {
        /// The node's queue.
        queue: QueueId,
        /// Number of the barrier command in it.
        command: u64,
    },
    /// Gateway → node: go on at this instant, if confirmed before `confirm_by`.
    Commit {
        /// The queue that waits.
        queue: QueueId,
        /// Number of the barrier command in it.
        command: u64,
        /// When the first edge is due.
        start_at: LocalMicros,
        /// Without a confirmation by then, the node disarms itself.
        confirm_by: LocalMicros,
    },
    /// Node → gateway: the commit is taken.
    Armed {
        /// The node's queue.
        queue: QueueId,
        /// Number of the barrier command in it.
        command: u64,
    },
    /// Gateway → node: every node is armed.
    Confirm {
        /// The queue that waits.
        queue: QueueId,
        /// Number of the barrier command in it.
        command: u64,
    },
    /// Gateway → node: do not start.
    Abort {
        /// The queue that waits.
        queue: QueueId,
        /// Number of the barrier command in it.
        command: u64,
    },
    /// Node → gateway: the first edge after the barrier has left the pin.
    Started {
        /// The node's queue.
        queue: QueueId,
        /// Number of the barrier command in it.
        command: u64,
        /// When it did.
        first_edge_at: LocalMicros,
    },
    /// Node → gateway: [`StartMessage::Ready`] at a barrier that a script has named.
    ReadyAt {
        /// The node's queue.
        queue: QueueId,
        /// Number of the barrier command in it.
        command: u64,
        /// Where.
        name: BarrierName,
    },
}
