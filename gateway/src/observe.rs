//! What the service tells about itself, for Prometheus: names, meaning, and where they are taken.
//!
//! Gauges are taken from the fleet at each scrape ([`Snapshot`]); counters and histograms grow where
//! things happen, in `service.rs`. Nothing is counted until a recorder is installed
//! ([`crate::http`]).

use crate::fleet::Fleet;
use keys::{
    NodeId,
    record::{JobState, NodeWord},
};
use metrics::{Unit, counter, describe_counter, describe_gauge, describe_histogram, gauge};
use std::collections::BTreeMap;

/// Nodes by state; label `state`.
pub const NODES: &str = "stepfleet_nodes";
/// Whether a node is there, 1 or 0; label `node`.
pub const NODE_UP: &str = "stepfleet_node_up";
/// Commands in a node's queue; label `node`.
pub const NODE_QUEUE: &str = "stepfleet_node_queue_commands";
/// How far a node's clock may be from what the gateway thinks, s; label `node`.
pub const NODE_CLOCK_ERROR: &str = "stepfleet_node_clock_error_seconds";
/// Faults in a node's last status; label `node`.
pub const NODE_FAULTS: &str = "stepfleet_node_faults";
/// Jobs by state; label `state`. Those that ended are kept for a while and then forgotten.
pub const JOBS: &str = "stepfleet_jobs";
/// Messages that were none, or came from more nodes than can be known.
pub const IGNORED: &str = "stepfleet_ignored_messages_total";
/// Synchronized starts that some nodes may have passed and others not.
pub const SPLIT_STARTS: &str = "stepfleet_split_starts_total";
/// Events that the fleet has handled.
pub const EVENTS: &str = "stepfleet_events_total";
/// Writes to the store.
pub const STORE_WRITES: &str = "stepfleet_store_writes_total";
/// Duration of a commit of the store, s.
pub const STORE_COMMIT: &str = "stepfleet_store_commit_seconds";
/// Events whose effects wait for the store.
pub const STORE_WAITING: &str = "stepfleet_store_waiting_events";

/// Every name.
pub const NAMES: [&str; 12] = [
    NODES,
    NODE_UP,
    NODE_QUEUE,
    NODE_CLOCK_ERROR,
    NODE_FAULTS,
    JOBS,
    IGNORED,
    SPLIT_STARTS,
    EVENTS,
    STORE_WRITES,
    STORE_COMMIT,
    STORE_WAITING,
];

/// What a fleet is like at one moment.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Snapshot {
    /// Each node.
    pub nodes: BTreeMap<NodeId, NodeSnapshot>,
    /// Jobs in each state, in the order of [`JobState::ALL`].
    pub jobs: [u64; JobState::ALL.len()],
    /// See [`Fleet::ignored_count`].
    pub ignored: u64,
    /// See [`Fleet::split_start_count`].
    pub split_starts: u64,
}

/// What a node is like at one moment.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct NodeSnapshot {
    /// What it does.
    pub state: NodeWord,
    /// Commands in its queue.
    pub queue_commands: u64,
    /// How far its clock may be from what the gateway thinks, µs; `None` if it is not known.
    pub clock_error_us: Option<f64>,
    /// Faults in its last status.
    pub faults: u64,
}

impl Snapshot {
    /// Takes it.
    pub fn of(fleet: &Fleet) -> Self {
        let mut jobs = [0; JobState::ALL.len()];
        for job in fleet.jobs() {
            jobs[job.state() as usize] += 1;
        }
        let nodes = fleet.nodes().filter_map(|node| {
            let record = fleet.node_record(&node.id())?;
            let snapshot = NodeSnapshot {
                state: record.state,
                queue_commands: record.queue.depth,
                clock_error_us: record.clock.map(|clock| clock.error_us),
                faults: record.faults.len() as u64,
            };
            Some((record.node, snapshot))
        });
        Self {
            nodes: nodes.collect(),
            jobs,
            ignored: fleet.ignored_count(),
            split_starts: fleet.split_start_count(),
        }
    }

    /// Returns whether no node that is there has anything to do.
    pub fn is_at_rest(&self) -> bool {
        let at_work = [JobState::Sent, JobState::Running];
        let moves = |node: &NodeSnapshot| {
            node.queue_commands > 0 || matches!(node.state, NodeWord::Running | NodeWord::Paused)
        };
        let is_there = |node: &&NodeSnapshot| node.state != NodeWord::Offline;
        at_work.iter().all(|state| self.jobs[*state as usize] == 0)
            && !self.nodes.values().filter(is_there).any(moves)
    }

    /// Sets the gauges.
    pub fn record(&self) {
        for word in NodeWord::ALL {
            let nodes = self.nodes.values().filter(|node| node.state == word);
            gauge!(NODES, "state" => word.as_str()).set(nodes.count() as f64);
        }
        for (name, node) in &self.nodes {
            let up = node.state != NodeWord::Offline;
            gauge!(NODE_UP, "node" => name.to_string()).set(f64::from(u8::from(up)));
            gauge!(NODE_QUEUE, "node" => name.to_string()).set(node.queue_commands as f64);
            gauge!(NODE_FAULTS, "node" => name.to_string()).set(node.faults as f64);
            // Prometheus' word for what is not known.
            let error_s = node.clock_error_us.map_or(f64::NAN, |us| us / 1e6);
            gauge!(NODE_CLOCK_ERROR, "node" => name.to_string()).set(error_s);
        }
        for (state, count) in JobState::ALL.into_iter().zip(self.jobs) {
            gauge!(JOBS, "state" => state.as_str()).set(count as f64);
        }
        counter!(IGNORED).absolute(self.ignored);
        counter!(SPLIT_STARTS).absolute(self.split_starts);
    }
}

/// Gives every name its meaning and unit.
pub fn describe() {
    describe_gauge!(NODES, "Nodes by state");
    describe_gauge!(NODE_UP, "Whether a node is there");
    describe_gauge!(NODE_QUEUE, "Commands in a node's queue");
    describe_gauge!(
        NODE_CLOCK_ERROR,
        Unit::Seconds,
        "How far a node's clock may be from what the gateway thinks"
    );
    describe_gauge!(NODE_FAULTS, "Faults in a node's last status");
    describe_gauge!(JOBS, "Jobs by state; those that ended are kept for a while");
    describe_counter!(IGNORED, "Messages that were none, or of too many nodes");
    describe_counter!(SPLIT_STARTS, "Starts that only some nodes may have passed");
    describe_counter!(EVENTS, "Events that the fleet has handled");
    describe_counter!(STORE_WRITES, "Writes to the store");
    describe_histogram!(
        STORE_COMMIT,
        Unit::Seconds,
        "Duration of a commit of the store"
    );
    describe_gauge!(STORE_WAITING, "Events whose effects wait for the store");
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_panels_of_the_example_dashboard_ask_for_what_exists() {
        let text = include_str!("../grafana.json");
        let board: serde_json::Value = serde_json::from_str(text).expect("JSON");
        let panels = board["panels"].as_array().expect("panels");
        let mut asked = Vec::new();
        for panel in panels {
            for target in panel["targets"].as_array().expect("targets") {
                let expression = target["expr"].as_str().expect("an expression");
                let is_name = |c: char| c.is_ascii_alphanumeric() || c == '_';
                let words = expression.split(|c| !is_name(c));
                asked.extend(words.filter(|word| word.starts_with("stepfleet_")));
            }
        }
        // A histogram has three series.
        let base = |name: &str| {
            let ends = ["_bucket", "_sum", "_count"];
            let end = ends.into_iter().find(|end| name.ends_with(end));
            name[..name.len() - end.map_or(0, str::len)].to_owned()
        };
        for name in &asked {
            assert!(NAMES.contains(&base(name).as_str()), "{name}");
        }
        for name in NAMES {
            assert!(
                asked.iter().any(|word| base(word) == name),
                "{name} has no panel"
            );
        }
    }
}
