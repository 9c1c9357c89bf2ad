//! The way between gateway and nodes: delay, loss of link, duplicates, reordering.

use crate::Random;
use keys::{NodeId, NodeTopic};
use std::collections::BTreeMap;

/// What the network does to messages and links.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Faults {
    /// Shortest time on the way, µs.
    pub delay_us_min: u64,
    /// Longest, µs.
    pub delay_us_max: u64,
    /// Messages of a thousand that arrive twice, the second time late.
    pub duplicate_per_mille: u64,
    /// Messages of a thousand that others overtake.
    pub reorder_per_mille: u64,
}

impl Faults {
    /// 1 ms on the way, in order, once.
    pub const NONE: Self = Self {
        delay_us_min: 1_000,
        delay_us_max: 1_000,
        duplicate_per_mille: 0,
        reorder_per_mille: 0,
    };
}

/// A message on its way.
#[derive(Clone, Debug)]
pub struct Message {
    /// From or to this node.
    pub node: NodeId,
    /// Which way.
    pub to_node: bool,
    /// Which key.
    pub topic: NodeTopic,
    /// Its bytes.
    pub payload: Vec<u8>,
}

/// Messages on their way, in order of arrival.
#[derive(Debug, Default)]
pub struct Network {
    messages: BTreeMap<(u64, u64), Message>,
    numbers: u64,
    /// Nothing overtakes on one link in one direction, but for the faults.
    last_arrival: BTreeMap<(NodeId, bool), u64>,
}

impl Network {
    /// Sends a message.
    pub fn send(&mut self, message: Message, now_us: u64, faults: &Faults, random: &mut Random) {
        let delay_us = random.between(faults.delay_us_min, faults.delay_us_max);
        let last = self
            .last_arrival
            .entry((message.node, message.to_node))
            .or_default();
        let mut at_us = now_us + delay_us;
        if random.per_mille(faults.reorder_per_mille) {
            at_us += 4 * faults.delay_us_max;
        } else {
            at_us = at_us.max(*last);
            *last = at_us;
        }
        if random.per_mille(faults.duplicate_per_mille) {
            let late_us = random.between(0, 40 * faults.delay_us_max);
            self.insert(at_us + late_us, message.clone());
        }
        self.insert(at_us, message);
    }

    fn insert(&mut self, at_us: u64, message: Message) {
        self.messages.insert((at_us, self.numbers), message);
        self.numbers += 1;
    }

    /// Forgets what is on its way from or to this node: its link is broken.
    pub fn cut(&mut self, node: NodeId) {
        self.messages.retain(|_, message| message.node != node);
        self.last_arrival.retain(|(of, _), _| *of != node);
    }

    /// Returns when the next message arrives.
    pub fn next_at(&self) -> Option<u64> {
        self.messages.keys().next().map(|(at_us, _)| *at_us)
    }

    /// Gives the next message that has arrived by now.
    pub fn arrived(&mut self, now_us: u64) -> Option<Message> {
        let entry = self.messages.first_entry()?;
        (entry.key().0 <= now_us).then(|| entry.remove())
    }
}
