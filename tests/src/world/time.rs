//! The loop that goes from one event to the next.

use super::{Machine, NEVER_US, Replaced, S, World};
use gateway::fleet::event::{Effect, Event};
use keys::{NodeId, NodeTopic, Topic};

impl World {
    /// Lets this much time pass.
    pub fn run_for(&mut self, us: u64) {
        let until_us = self.now_us + us;
        while let Some(at_us) = self.next_at().filter(|at_us| *at_us <= until_us) {
            self.now_us = self.now_us.max(at_us);
            self.step();
        }
        self.now_us = until_us;
        self.step();
    }

    /// Lets time pass until this is true.
    ///
    /// # Panics
    /// It is not after `most_us`.
    pub fn run_until(&mut self, most_us: u64, mut is_so: impl FnMut(&Self) -> bool) {
        let until_us = self.now_us + most_us;
        while !is_so(self) {
            let at_us = self.next_at().expect("something is due");
            assert!(at_us <= until_us, "it did not come to that in {most_us} µs");
            self.now_us = self.now_us.max(at_us);
            self.step();
        }
    }

    pub(super) fn names(&self) -> Vec<NodeId> {
        self.machines.keys().copied().collect()
    }

    fn next_at(&self) -> Option<u64> {
        let gateway_up = self.gateway.is_up();
        let mut next_us = self.network.next_at().unwrap_or(NEVER_US);
        for at_us in [self.gateway.next_at(), self.returns_at_us] {
            next_us = next_us.min(at_us.unwrap_or(NEVER_US));
        }
        for machine in self.machines.values() {
            next_us = next_us.min(machine.due_at_us(gateway_up));
        }
        for old in &self.replaced {
            let at_us = old.gateway.next_at().unwrap_or(NEVER_US);
            next_us = next_us.min(at_us.max(old.sleeps_until_us));
        }
        (next_us < NEVER_US).then_some(next_us)
    }

    /// Does everything that is due now. A node at which nothing is due, and to which nothing was said,
    /// costs nothing.
    fn step(&mut self) {
        let now_us = self.now_us;
        let is_due = |at_us: Option<u64>| at_us.is_some_and(|at_us| at_us <= now_us);
        if is_due(self.returns_at_us) {
            self.returns_at_us = None;
            self.gateway.start(now_us, &mut self.random);
        }
        let gateway_up = self.gateway.is_up();
        for name in self.names_of(|machine| machine.link_due_at_us(gateway_up) <= now_us) {
            self.step_link(name);
        }
        while let Some(message) = self.network.arrived(now_us) {
            self.deliver(message);
        }
        for name in self.names_of(|machine| machine.touched || is_due(machine.due_us)) {
            let machine = self.machines.get_mut(&name).expect("a node");
            if is_due(machine.node_due_us()) {
                machine.node.poll(machine.clock.local_from_real(now_us));
            }
            self.drain(name);
            self.machines.get_mut(&name).expect("a node").rest();
        }
        let effects = self.gateway.poll(now_us, &mut self.random);
        self.carry_out(effects);
        self.step_replaced();
        if self.gateway.take_end() {
            let for_us = self.random.below(2 * S);
            self.lose_gateway(for_us);
        }
    }

    /// Returns the nodes of which this is so.
    fn names_of(&self, is_so: impl Fn(&Machine) -> bool) -> Vec<NodeId> {
        let found = self.machines.iter().filter(|(_, machine)| is_so(machine));
        found.map(|(name, _)| *name).collect()
    }

    fn step_replaced(&mut self) {
        let now_us = self.now_us;
        for mut old in std::mem::take(&mut self.replaced) {
            if old.sleeps_until_us <= now_us {
                let effects = old.gateway.poll(now_us, &mut self.random);
                self.carry_out_of_replaced(&old, effects);
            }
            if !old.gateway.take_end() {
                self.replaced.push(old);
            }
        }
    }

    /// What comes from nodes, and what clients want that needs no store, the replaced ones hear too.
    pub(super) fn tell_replaced(&mut self, event: &Event) {
        let now_us = self.now_us;
        for mut old in std::mem::take(&mut self.replaced) {
            let event = match event.clone() {
                event @ (Event::FromNode { .. } | Event::Stop { .. }) => Some(event),
                Event::Release { pattern, .. } => Some(Event::Release {
                    pattern,
                    reply: None,
                }),
                Event::Pace { pattern, wish, .. } => Some(Event::Pace {
                    pattern,
                    wish,
                    reply: None,
                }),
                _ => None,
            };
            let hears = old.sleeps_until_us <= now_us && old.cut_until_us <= now_us;
            if let Some(event) = event.filter(|_| hears) {
                let effects = old.gateway.handle(event, now_us, &mut self.random);
                self.carry_out_of_replaced(&old, effects);
            }
            self.replaced.push(old);
        }
    }

    pub(super) fn carry_out_of_replaced(&mut self, old: &Replaced, effects: Vec<Effect>) {
        if old.cut_until_us > self.now_us {
            return;
        }
        for effect in effects {
            let Effect::Publish { key, payload, .. } = effect else {
                continue;
            };
            let keys = self.keys.clone();
            match keys.parse(&key) {
                Some(Topic::Node { node, topic }) if topic != NodeTopic::State => {
                    let node = NodeId::new(node).expect("orders go to one node");
                    self.send_to(node, topic, payload);
                }
                _ => {}
            }
        }
    }
}
