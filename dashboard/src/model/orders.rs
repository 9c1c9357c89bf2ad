//! What this window asked of the motion of nodes, the latest of each: to hold, to resume, another
//! speed.

use crate::{
    message::{Answer, Moment},
    request::{Order, Ticket},
};
use keys::NodeId;
use std::collections::BTreeMap;

/// One order.
#[derive(Clone, Debug, PartialEq)]
pub struct Ordered {
    /// Identifies the request.
    pub ticket: Ticket,
    /// What.
    pub order: Order,
    /// When.
    pub at: Moment,
    /// What the gateway said; `None` until it does.
    pub answer: Option<Answer>,
}

/// See the module. One entry a node, of which there are at most
/// [`NODES_MAX`](super::limits::NODES_MAX).
#[derive(Debug, Default)]
pub struct Orders {
    latest: BTreeMap<NodeId, Ordered>,
}

impl Orders {
    pub(super) fn asked(&mut self, at: Moment, ticket: Ticket, node: NodeId, order: Order) {
        let answer = None;
        let ordered = Ordered {
            ticket,
            order,
            at,
            answer,
        };
        self.latest.insert(node, ordered);
    }

    /// Takes an answer and returns whether it belongs to an order.
    pub(super) fn answer(&mut self, ticket: Ticket, answer: &Answer) -> bool {
        let mut all = self.latest.values_mut();
        let Some(ordered) = all.find(|ordered| ordered.ticket == ticket) else {
            return false;
        };
        ordered.answer = Some(answer.clone());
        true
    }

    /// Returns the latest order to a node.
    pub fn of(&self, node: &NodeId) -> Option<&Ordered> {
        self.latest.get(node)
    }
}
