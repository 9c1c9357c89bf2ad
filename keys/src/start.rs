//! The synchronized start on the key `start`: ready → commit → confirm → started, or abort.
//!
//! A start is a barrier at the head of each node's queue. Times are in the node's own clock.

use crate::{LocalMicros, batch::QueueId};
use serde::{Deserialize, Serialize};

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
}
