//! A stop or a release, from the key press until every node has said so itself.

use crate::{
    message::{Answer, Moment},
    request::{Scope, Ticket},
};
use keys::{NodeId, NodeState, Status, StopMode, record::JobError};
use std::collections::BTreeMap;

/// What was asked for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
    /// Come to rest, and stay.
    Stop(StopMode),
    /// Lift the latch.
    Release,
}

/// Whether it left this computer.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Sending {
    /// On its way to the link.
    Waiting,
    /// Handed to zenoh.
    Sent,
    /// It was not sent, or the gateway did not answer.
    Failed(String),
}

/// How far a node is, by its own word.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Heard {
    /// It has said nothing of it yet.
    Nothing,
    /// Its latch is set, and it still moves.
    Latched,
    /// It did what was asked: of a stop, its latch is set and nothing moves.
    Done(Moment),
}

/// See the module.
#[derive(Clone, Debug)]
pub struct Effort {
    ticket: Ticket,
    kind: Kind,
    scope: Scope,
    asked: Moment,
    sending: Sending,
    nodes: BTreeMap<NodeId, Heard>,
    refused: Vec<JobError>,
}

impl Effort {
    pub(super) fn new(
        ticket: Ticket,
        kind: Kind,
        scope: Scope,
        asked: Moment,
        expected: Vec<NodeId>,
    ) -> Self {
        Self {
            ticket,
            kind,
            scope,
            asked,
            sending: Sending::Waiting,
            nodes: expected
                .into_iter()
                .map(|node| (node, Heard::Nothing))
                .collect(),
            refused: Vec::new(),
        }
    }

    pub(super) fn heard(&mut self, at: Moment, node: NodeId, status: &Status) {
        let Some(open @ (Heard::Nothing | Heard::Latched)) = self.nodes.get_mut(&node) else {
            return;
        };
        let latched = matches!(status.state, NodeState::Stopped | NodeState::Fault);
        // A node sets its latch at once, also when it decelerates first.
        let moves = status.axes.iter().any(|axis| axis.speed_mhz != 0);
        *open = match self.kind {
            Kind::Stop(_) if latched && moves => Heard::Latched,
            Kind::Stop(_) if latched => Heard::Done(at),
            Kind::Release if status.state != NodeState::Stopped => Heard::Done(at),
            _ => return,
        };
    }

    pub(super) fn answer(&mut self, _at: Moment, answer: &Answer) {
        self.sending = match answer {
            Answer::Failed(why) => Sending::Failed(why.clone()),
            Answer::Done { refused, .. } => {
                self.refused.clone_from(refused);
                Sending::Sent
            }
            Answer::Sent | Answer::Receipts(_) => Sending::Sent,
        };
    }

    /// Returns what identifies it.
    pub fn ticket(&self) -> Ticket {
        self.ticket
    }

    /// Returns what was asked for.
    pub fn kind(&self) -> Kind {
        self.kind
    }

    /// Returns `stop` or `release`.
    pub fn verb(&self) -> &'static str {
        match self.kind {
            Kind::Stop(_) => "stop",
            Kind::Release => "release",
        }
    }

    /// Returns who was meant.
    pub fn scope(&self) -> &Scope {
        &self.scope
    }

    /// Returns when the operator asked.
    pub fn asked(&self) -> Moment {
        self.asked
    }

    /// Returns whether it left this computer.
    pub fn sending(&self) -> &Sending {
        &self.sending
    }

    /// Returns what the gateway refused.
    pub fn refused(&self) -> &[JobError] {
        &self.refused
    }

    /// Returns how many nodes are expected to say that they did it.
    pub fn expected(&self) -> usize {
        self.nodes.len()
    }

    /// Returns how many have.
    pub fn confirmed(&self) -> usize {
        self.done().count()
    }

    /// Returns those that have said nothing of it.
    pub fn missing(&self) -> impl Iterator<Item = NodeId> {
        self.those(Heard::Nothing)
    }

    /// Returns those whose latch is set and that still come to rest.
    pub fn coming_to_rest(&self) -> impl Iterator<Item = NodeId> {
        self.those(Heard::Latched)
    }

    /// Returns the time from asking to the last confirmation so far, s.
    pub fn took_s(&self) -> Option<f64> {
        let latest = self.done().max()?;
        Some(latest.since_s(self.asked))
    }

    /// Returns whether everybody has.
    pub fn is_complete(&self) -> bool {
        self.confirmed() == self.expected()
    }

    fn done(&self) -> impl Iterator<Item = Moment> {
        self.nodes.values().filter_map(|heard| match heard {
            Heard::Done(at) => Some(*at),
            Heard::Nothing | Heard::Latched => None,
        })
    }

    fn those(&self, wanted: Heard) -> impl Iterator<Item = NodeId> {
        let nodes = self.nodes.iter();
        let nodes = nodes.filter(move |(_, heard)| **heard == wanted);
        nodes.map(|(node, _)| *node)
    }
}
