//! What a fleet holds when everything has its end: nothing is left over, on any side.

use super::{S, World};
use gateway::fleet::{event::Table, sizes::Sizes};

/// Groups of effects that may wait for the disk at one moment of a fleet at rest, for each node, and
/// messages on their way from or to it: a status, a probe, an answer, a record, and room for chance.
const IN_PASSING_MAX: usize = 16;

impl World {
    /// Returns how often a gateway began anew because the wall clock was set while it ran.
    pub fn begun_anew(&self) -> u64 {
        self.gateway.begun_anew()
    }

    /// Judges what the gateway, its store and the nodes hold after every job has ended and latches are
    /// lifted: a scenario that leaves something behind would fill them, done often enough.
    ///
    /// # Panics
    /// Something is left; the message says what.
    pub fn check_bounds(&mut self) {
        for _ in 0..4 {
            if self.gateway.is_up() {
                break;
            }
            self.run_for(4 * S);
        }
        let fleet = self.gateway.fleet().expect("it starts again");
        let nodes = self.machines.len();
        let sizes = fleet.sizes();
        let expected = Sizes {
            jobs: self.gateway.row_count(Table::Jobs),
            nodes,
            node_timers: sizes.node_timers.min(nodes),
            probes: sizes.probes.min(nodes * gateway::fleet::node::PROBES_MAX),
            ..Sizes::default()
        };
        assert_eq!(sizes, expected, "left over in the gateway");
        assert_eq!(
            self.gateway.row_count(Table::Requests),
            0,
            "left over on the disk"
        );
        assert!(self.gateway.row_count(Table::Nodes) <= nodes);
        let open = self.gets.iter().filter(|(_, answers)| !answers.ended);
        let open: Vec<_> = open.collect();
        assert!(open.is_empty(), "gets without an end: {open:?}");
        let passing = [self.gateway.waiting_count(), self.network.message_count()];
        assert!(
            passing.iter().all(|count| *count <= nodes * IN_PASSING_MAX),
            "groups of effects and messages on their way: {passing:?}"
        );
        for (name, machine) in &self.machines {
            let status = machine.node.status();
            assert_eq!(
                (status.accepted_commands, status.credit_commands as usize),
                (
                    status.executed_commands,
                    machine.node.node().ring_commands()
                ),
                "left over in the queue of {name}"
            );
            assert_eq!(status.job, None, "{name}");
        }
    }
}
