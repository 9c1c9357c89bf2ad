//! What goes wrong: links, power, clocks, disks, and gateways that others replace.

use super::{MS, Replaced, S, World};
use emulator::clock::LocalClock;
use keys::NodeId;

/// What a gateway does whose fleet another one has taken over.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum OldOwner {
    /// It goes on as if nothing had happened.
    Present,
    /// It hears no node and is heard by none, for this long, µs.
    CutOff(u64),
    /// Its machine sleeps for this long, µs, and knows nothing of it.
    Asleep(u64),
}

impl World {
    /// Breaks a node's link for this long. Node and gateway notice each in its own time.
    pub fn break_link(&mut self, node: &str, for_us: u64) {
        let name = NodeId::new(node).expect("legal");
        self.break_link_of(name, for_us);
    }

    pub(super) fn break_link_of(&mut self, name: NodeId, for_us: u64) {
        self.network.cut(name);
        let (notices_us, missed_us) = (self.random.below(3 * S), self.random.below(3 * S));
        let now_us = self.now_us;
        let machine = self.machines.get_mut(&name).expect("a node");
        machine.wired = false;
        machine.notices_at_us = machine.link_known.then_some(now_us + notices_us);
        machine.missed_at_us = machine.token_known.then_some(now_us + missed_us);
        machine.returns_at_us = Some(now_us + for_us);
    }

    /// Restarts a router between the gateway and all nodes: every link is broken at once, and each
    /// node comes back in its own time within `within_us` after `for_us`.
    pub fn restart_router(&mut self, for_us: u64, within_us: u64) {
        for name in self.names() {
            let later_us = self.random.below(within_us);
            self.break_link_of(name, for_us + later_us);
        }
    }

    /// Lets a node neither hear nor be heard for this long, while its link stands: a channel that
    /// is held, or a peer that reads nothing. What was sent arrives afterwards, in order.
    pub fn stall(&mut self, node: &str, for_us: u64) {
        let name = NodeId::new(node).expect("legal");
        for to_node in [true, false] {
            self.network.stall(name, to_node, self.now_us + for_us);
        }
    }

    /// Lets a node's crystal change its rate to `drift_ppb`.
    pub fn set_drift(&mut self, node: &str, drift_ppb: i64) {
        let machine = self.machines.get_mut(&NodeId::new(node).expect("legal"));
        let machine = machine.expect("a node");
        machine.drift_ppb = drift_ppb;
        machine.clock.set_drift(self.now_us, drift_ppb);
        machine.touched = true;
    }

    /// Lets a node's clock jump ahead: to the node this much time has passed at once.
    pub fn jump_clock(&mut self, node: &str, ahead_us: u64) {
        let machine = self.machines.get_mut(&NodeId::new(node).expect("legal"));
        let machine = machine.expect("a node");
        machine.clock.jump(self.now_us, ahead_us);
        machine.touched = true;
    }

    /// Lets the gateway's next write fail: the disk is full. It ends then, and starts again with
    /// room on the disk.
    pub fn fill_disk(&mut self) {
        self.gateway.fail_disk();
    }

    /// Sets the wall clock that the gateway reads, µs beyond the world's time: at its next start, and
    /// with the looks that it takes while it runs.
    pub fn set_wall_ahead(&mut self, us: i64) {
        self.gateway.set_wall_ahead(us);
    }

    /// Cuts a node's power and lets it boot again; it is back after this long.
    pub fn reboot(&mut self, node: &str, after_us: u64) {
        let name = NodeId::new(node).expect("legal");
        self.break_link_of(name, after_us);
        let boot = self.random.number() as u32;
        let offset_us = self.random.below(1 << 40);
        let machine = self.machines.get_mut(&name).expect("a node");
        machine.node.reset(boot);
        machine.touched = true;
        machine.clock = LocalClock::new(self.now_us, offset_us, machine.drift_ppb);
        machine.link_known = false;
        machine.notices_at_us = None;
    }

    /// Kills the gateway, and with it the router; it starts again after this long.
    pub fn kill_gateway(&mut self, for_us: u64) {
        self.gateway.kill(&mut self.random);
        self.lose_gateway(for_us);
    }

    /// Lets another gateway take the store and the fleet, while the present one does not know that it
    /// has lost them. `copied`: its store lets it write on, into a copy. Nothing if there is none.
    pub fn hand_over(&mut self, old: OldOwner, copied: bool) {
        if !self.gateway.is_up() {
            return;
        }
        let next = self.gateway.hand_over(copied, &mut self.random);
        let gateway = std::mem::replace(&mut self.gateway, next);
        let until_us = |us: u64| self.now_us + us;
        self.replaced.push(Replaced {
            gateway,
            cut_until_us: match old {
                OldOwner::CutOff(us) => until_us(us),
                _ => 0,
            },
            sleeps_until_us: match old {
                OldOwner::Asleep(us) => until_us(us),
                _ => 0,
            },
        });
        // Whoever waited for a reply of the old one gets none.
        let waiting = self.gets.values_mut();
        waiting.for_each(|answers| answers.ended = true);
        self.gateway.start(self.now_us, &mut self.random);
    }

    /// Returns how many gateways still believe that the fleet is theirs, beside the one that has it.
    pub fn replaced_count(&self) -> usize {
        self.replaced.len()
    }

    pub(super) fn lose_gateway(&mut self, for_us: u64) {
        self.returns_at_us = Some(self.now_us + for_us);
        self.gets
            .values_mut()
            .for_each(|answers| answers.ended = true);
        for name in self.names() {
            self.network.cut(name);
            let machine = self.machines.get_mut(&name).expect("a node");
            machine.wired = false;
            machine.token_known = false;
            machine.missed_at_us = None;
            machine.notices_at_us = machine.link_known.then_some(self.now_us);
            let later_us = self.random.below(500 * MS);
            machine.returns_at_us = Some(self.now_us + for_us + later_us);
        }
    }
}
