//! The way between gateway and nodes: delay, loss of link, duplicates, reordering.

use crate::Random;
use keys::{NodeId, NodeTopic};
use std::collections::BTreeMap;

/// How long a message is on its way.
#[derive(Clone, Debug, PartialEq)]
pub enum Delay {
    /// Anything between two bounds, µs.
    Uniform {
        /// Shortest.
        us_min: u64,
        /// Longest.
        us_max: u64,
    },
    /// A radio: log-normal about a median with a heavy tail, over a floor of a fifth of the median;
    /// now and then the channel is held for a while, and everything on it waits until it is free.
    Radio {
        /// Half of the messages are quicker, µs.
        median_us: f64,
        /// One of a hundred is slower, µs.
        p99_us: f64,
        /// Share of the way to the node in an asymmetric link; 1 is symmetric.
        down_factor: f64,
        /// How often the channel is held, for each second.
        holds_per_s: f64,
        /// For how long, µs.
        hold_us: u64,
    },
}

impl Delay {
    /// A radio without holds, the same both ways.
    pub const fn radio(median_us: f64, p99_us: f64) -> Self {
        Self::Radio {
            median_us,
            p99_us,
            down_factor: 1.0,
            holds_per_s: 0.0,
            hold_us: 0,
        }
    }

    fn draw_us(&self, to_node: bool, random: &mut Random) -> u64 {
        match *self {
            Self::Uniform { us_min, us_max } => random.between(us_min, us_max),
            Self::Radio {
                median_us,
                p99_us,
                down_factor,
                ..
            } => {
                // The 99th percentile of a normal lies 2.326 deviations above its median.
                let floor_us = 0.2 * median_us;
                let (median_us, p99_us) = (median_us - floor_us, p99_us - floor_us);
                let sigma = (p99_us / median_us).ln() / 2.326;
                let us = floor_us + median_us * (sigma * random.normal()).exp();
                (us * if to_node { down_factor } else { 1.0 }) as u64
            }
        }
    }

    /// Returns until when the channel is held, for a message that comes now.
    fn held_until_us(&self, node: NodeId, seed: u64, now_us: u64) -> u64 {
        let Self::Radio {
            holds_per_s,
            hold_us,
            ..
        } = *self
        else {
            return 0;
        };
        if hold_us == 0 {
            return 0;
        }
        // Time is cut into slots as long as a hold; a slot is held or not, by chance.
        let slot = now_us / hold_us;
        let of_node = node.as_str().bytes().fold(seed, |mixed, byte| {
            mixed.wrapping_mul(31).wrapping_add(u64::from(byte))
        });
        let chance = Random(of_node ^ slot).unit();
        if chance < holds_per_s * hold_us as f64 / 1e6 {
            (slot + 1) * hold_us
        } else {
            0
        }
    }
}

/// What the network does to messages and links.
#[derive(Clone, Debug, PartialEq)]
pub struct Faults {
    /// Time on the way.
    pub delay: Delay,
    /// Messages of a thousand that never arrive.
    pub lose_per_mille: u64,
    /// Messages of a thousand that arrive twice, the second time late.
    pub duplicate_per_mille: u64,
    /// Messages of a thousand that others overtake.
    pub reorder_per_mille: u64,
}

impl Faults {
    /// 1 ms on the way, in order, once.
    pub const NONE: Self = Self {
        delay: Delay::Uniform {
            us_min: 1_000,
            us_max: 1_000,
        },
        lose_per_mille: 0,
        duplicate_per_mille: 0,
        reorder_per_mille: 0,
    };

    /// A bad link as a seed draws it: up to 30 ms on the way, some messages lost, doubled or
    /// overtaken.
    pub fn drawn(random: &mut Random) -> Self {
        Self {
            delay: Delay::Uniform {
                us_min: 200,
                us_max: random.between(300, 30_000),
            },
            lose_per_mille: random.below(20),
            duplicate_per_mille: random.below(50),
            reorder_per_mille: random.below(20),
        }
    }
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
    seed: u64,
    messages: BTreeMap<(u64, u64), Message>,
    numbers: u64,
    /// Nothing overtakes on one link in one direction, but for the faults.
    last_arrival: BTreeMap<(NodeId, bool), u64>,
    /// Until when nothing arrives on one link in one direction.
    stalled_until: BTreeMap<(NodeId, bool), u64>,
}

impl Network {
    /// Makes an empty one.
    pub fn new(seed: u64) -> Self {
        Self {
            seed,
            ..Self::default()
        }
    }

    /// Sends a message.
    pub fn send(&mut self, message: Message, now_us: u64, faults: &Faults, random: &mut Random) {
        let delay_us = faults.delay.draw_us(message.to_node, random);
        let late_us = 4 * delay_us + 1_000;
        if random.per_mille(faults.lose_per_mille) {
            return;
        }
        let stalled_until_us = self.stalled_until_us(message.node, message.to_node);
        let held_until_us = faults.delay.held_until_us(message.node, self.seed, now_us);
        let last = self
            .last_arrival
            .entry((message.node, message.to_node))
            .or_default();
        let mut at_us = now_us.max(held_until_us).max(stalled_until_us) + delay_us;
        if random.per_mille(faults.reorder_per_mille) {
            at_us += late_us;
        } else {
            at_us = at_us.max(*last);
            *last = at_us;
        }
        if random.per_mille(faults.duplicate_per_mille) {
            let again_us = random.between(0, 10 * late_us);
            self.insert(at_us + again_us, message.clone());
        }
        self.insert(at_us, message);
    }

    fn insert(&mut self, at_us: u64, message: Message) {
        self.messages.insert((at_us, self.numbers), message);
        self.numbers += 1;
    }

    /// Lets nothing arrive on this link in this direction until then: its reader reads nothing, as
    /// a peer does that is busy with something else. What is on its way waits, in order.
    pub fn stall(&mut self, node: NodeId, to_node: bool, until_us: u64) {
        self.stalled_until.insert((node, to_node), until_us);
        let waits = |at_us: u64, message: &Message| {
            at_us < until_us && message.node == node && message.to_node == to_node
        };
        let late: Vec<_> = self
            .messages
            .extract_if(.., |(at_us, _), message| waits(*at_us, message))
            .collect();
        for (_, message) in late {
            self.insert(until_us, message);
        }
        let last = self.last_arrival.entry((node, to_node)).or_default();
        *last = until_us.max(*last);
    }

    fn stalled_until_us(&self, node: NodeId, to_node: bool) -> u64 {
        let until_us = self.stalled_until.get(&(node, to_node));
        until_us.copied().unwrap_or(0)
    }

    /// Forgets what is on its way from or to this node: its link is broken.
    pub fn cut(&mut self, node: NodeId) {
        self.messages.retain(|_, message| message.node != node);
        self.last_arrival.retain(|(of, _), _| *of != node);
        self.stalled_until.retain(|(of, _), _| *of != node);
    }

    /// Returns when the next message arrives.
    pub fn next_at(&self) -> Option<u64> {
        self.messages.keys().next().map(|(at_us, _)| *at_us)
    }

    /// Returns how many messages are on their way.
    pub fn message_count(&self) -> usize {
        self.messages.len()
    }

    /// Gives the next message that has arrived by now.
    pub fn arrived(&mut self, now_us: u64) -> Option<Message> {
        let entry = self.messages.first_entry()?;
        (entry.key().0 <= now_us).then(|| entry.remove())
    }
}
