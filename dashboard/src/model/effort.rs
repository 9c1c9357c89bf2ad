//! A stop or a release, from the key press until every node has said so itself.

use crate::{
    message::{Answer, Moment},
    request::{Scope, Ticket},
};
use keys::{NodeId, NodeState, StopMode, record::JobError};
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

/// See the module.
#[derive(Clone, Debug)]
pub struct Effort {
    ticket: Ticket,
    kind: Kind,
    scope: Scope,
    asked: Moment,
    sending: Sending,
    // `None`: not yet.
    nodes: BTreeMap<NodeId, Option<Moment>>,
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
            nodes: expected.into_iter().map(|node| (node, None)).collect(),
            refused: Vec::new(),
        }
    }

    pub(super) fn heard(&mut self, at: Moment, node: NodeId, state: NodeState) {
        let wanted = match self.kind {
            Kind::Stop(_) => matches!(state, NodeState::Stopped | NodeState::Fault),
            Kind::Release => state != NodeState::Stopped,
        };
        if wanted && let Some(open @ None) = self.nodes.get_mut(&node) {
            *open = Some(at);
        }
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
        self.nodes.values().flatten().count()
    }

    /// Returns those that have not.
    pub fn missing(&self) -> impl Iterator<Item = NodeId> {
        let missing = self.nodes.iter().filter(|(_, at)| at.is_none());
        missing.map(|(node, _)| *node)
    }

    /// Returns the time from asking to the last confirmation so far, s.
    pub fn took_s(&self) -> Option<f64> {
        let latest = self.nodes.values().flatten().max()?;
        Some(latest.since_s(self.asked))
    }

    /// Returns whether nobody is missing.
    pub fn is_complete(&self) -> bool {
        self.nodes.values().all(Option::is_some)
    }
}
