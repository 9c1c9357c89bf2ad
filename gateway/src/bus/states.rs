//! The keys of the nodes' records, and of their jobs, declared once each.
//!
//! Nobody subscribes to one of them by its full name, so the router knows no such key and looks for
//! those who want it among the subscriptions of all nodes, each time anew: with 1,000 nodes that was
//! three quarters of what the gateway cost. Of a declared key it remembers them, also when a client
//! spells it out.

use keys::{Keys, NodeId, NodeTopic};
use std::{
    collections::HashMap,
    sync::{Mutex, PoisonError},
};
use zenoh::{Session, Wait, key_expr::KeyExpr};

/// Nodes whose keys are declared; those of further nodes are spelled out in every message. A link has
/// room for 65,535 numbers of keys.
const DECLARED_MAX: usize = 16_384;

/// The declared keys of records and of jobs, by node. Whoever is dropped is declared no more.
#[derive(Debug, Default)]
pub(super) struct StateKeys(Mutex<HashMap<NodeId, [KeyExpr<'static>; 2]>>);

impl StateKeys {
    /// Returns the key of a node's record as `session`, which must be the same each time, names it.
    ///
    /// # Errors
    /// Of zenoh, while it closes.
    pub(super) fn of(
        &self,
        session: &Session,
        keys: &Keys,
        node: NodeId,
    ) -> zenoh::Result<KeyExpr<'static>> {
        let key = |topic| KeyExpr::try_from(keys.node(&node, topic).as_str().to_owned());
        let mut declared = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some([state, _]) = declared.get(&node) {
            return Ok(state.clone());
        }
        let state = key(NodeTopic::State)?;
        if declared.len() >= DECLARED_MAX {
            return Ok(state);
        }
        let [state, job] =
            [state, key(NodeTopic::Job)?].map(|key| session.declare_keyexpr(key).wait());
        let own = [state?, job?];
        let state = own[0].clone();
        declared.insert(node, own);
        Ok(state)
    }
}
