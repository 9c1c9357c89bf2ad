//! What a node was told and what its pins did: the evidence for the oracle and for `--check`.
//!
//! Both lists are bounded. Full: recording ends and [`Life::cut`] says so; nothing is overwritten,
//! so what is there is a whole beginning.

use crate::pins::PinEvent;
use keys::{Command, LocalMicros, QueueId, Status, StopReport};

/// A command that a node took into its ring.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct TakenCommand {
    /// When.
    pub at: LocalMicros,
    /// The queue it was for.
    pub queue: QueueId,
    /// Its number in that queue.
    pub number: u64,
    /// The command.
    pub command: Command,
}

/// One boot of a node.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Life {
    /// The random number of the boot.
    pub boot: u32,
    /// How many axes the node has.
    pub axis_count: usize,
    /// The commands that were taken, in order.
    pub commands: Vec<TakenCommand>,
    /// How each queue that was dropped ended, in order.
    pub stops: Vec<StopReport>,
    /// Every change of a pin, in order of time.
    pub edges: Vec<PinEvent>,
    /// A list was full: later commands and edges are missing.
    pub cut: bool,
    /// The emulated pulse counter of each axis: steps with sign since boot.
    pub counted_steps: Vec<i64>,
    /// What the node said about itself when the record was taken.
    pub status: Status,
}
