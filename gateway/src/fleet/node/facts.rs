//! What is written down of a node.

use keys::{Features, FleetMicros, GroupId, QueueId, StopMode, StopReason, epoch};
use serde::{Deserialize, Serialize};
use std::collections::{BTreeSet, VecDeque};

/// What stays true of a node while it is away, or while the gateway is.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Facts {
    /// The life of its queue that it told last.
    pub queue: QueueId,
    /// Boots that came before, oldest first.
    pub replaced_boots: VecDeque<u32>,
    /// What its firmware can do.
    pub features: Features,
    /// Version of its firmware.
    pub firmware: [u8; 3],
    /// Position of each axis when it was last written down, steps.
    pub position_steps: Vec<i64>,
    /// Its latch.
    pub latch: Option<Latch>,
    /// A stop that it may not have heard: sent until it is seen latched.
    pub pending_stop: Option<StopMode>,
    /// The queue that must be dropped before any other job may go to it.
    pub drop_queue: Option<QueueId>,
    /// It must be dropped at once, without a ramp.
    #[serde(default)]
    pub drop_halts: bool,
    /// Names under which it can be meant together with others.
    #[serde(default)]
    pub labels: BTreeSet<GroupId>,
    /// Why it is given no jobs.
    #[serde(default)]
    pub maintenance: Option<String>,
    /// It takes jobs and begins none.
    #[serde(default)]
    pub queue_held: bool,
}

impl Facts {
    /// Returns a message as this node wants it: behind the epoch, if its firmware knows of such.
    pub(in crate::fleet) fn with_epoch(&self, epoch: u32, message: &[u8]) -> Vec<u8> {
        let knows = self.features.has(Features::EPOCH);
        let mut bytes = epoch::mark(if knows { epoch } else { 0 }).to_vec();
        bytes.extend_from_slice(message);
        bytes
    }
}

/// A stop latch as it was seen.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Latch {
    /// The queue that was current when it was seen.
    pub queue: QueueId,
    /// Why, once the node has reported.
    pub reason: Option<StopReason>,
    /// When.
    pub at: FleetMicros,
}
