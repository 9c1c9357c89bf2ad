//! How much a fleet holds, for those who watch that nothing is left over.

use super::{Fleet, node::Node};
use keys::record::JobError;

/// Longest message of a refusal, bytes. It may quote what a client wrote, which may be as long as a job,
/// and it stays in a record for as long as history is kept.
pub const REFUSAL_BYTES_MAX: usize = 2_048;

/// Cuts the message of a refusal.
pub(super) fn cut(mut error: JobError) -> JobError {
    if error.message.len() > REFUSAL_BYTES_MAX {
        let end = error.message.floor_char_boundary(REFUSAL_BYTES_MAX);
        error.message.truncate(end);
        error.message.push('…');
    }
    error
}

/// What a fleet holds. When every job has its end, everything but the first four is zero.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Sizes {
    /// Jobs, final ones too: as many as [`FleetConfig::retention_jobs`](super::FleetConfig) of those.
    pub jobs: usize,
    /// Nodes: [`FleetConfig::nodes_max`](super::FleetConfig) at most.
    pub nodes: usize,
    /// Nodes that want to be called again.
    pub node_timers: usize,
    /// Clock probes without an answer, of all nodes:
    /// [`PROBES_MAX`](super::node::PROBES_MAX) of each at most.
    pub probes: usize,
    /// Commands of jobs that are not final.
    pub held_commands: usize,
    /// Jobs that wait for a node or are on one, and ways of their commands.
    pub node_jobs: usize,
    /// Wishes of clients that nodes have not fulfilled.
    pub wishes: usize,
    /// Gets on `release`, `hold`, `resume` and `speed` that wait for nodes.
    pub open_gets: usize,
    /// Synchronized jobs that are not final.
    pub groups: usize,
    /// Those of which a part was sent, and their nodes.
    pub meetings: usize,
    /// Those that want to be called again.
    pub group_timers: usize,
    /// Those of which something is new.
    pub touched: usize,
}

impl Fleet {
    /// Returns how much there is of everything.
    pub fn sizes(&self) -> Sizes {
        let of_nodes = |count: fn(&Node) -> usize| self.nodes.values().map(count).sum();
        Sizes {
            jobs: self.book.newest_first().count(),
            nodes: self.nodes.len(),
            node_timers: self.timers.len(),
            probes: of_nodes(Node::probe_count),
            held_commands: self.book.held_commands(),
            node_jobs: of_nodes(Node::job_count),
            wishes: of_nodes(Node::wish_count),
            open_gets: self.releases.len(),
            groups: self.groups.len(),
            meetings: self.started.len() + self.meeting_count,
            group_timers: self.group_timers.len(),
            touched: self.book.touched_count(),
        }
    }
}
