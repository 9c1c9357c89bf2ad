//! The keys of the nodes' records, declared once each.
//!
//! Nobody subscribes to one of them by its full name, so the router knows no such key and looks for
//! those who want it among the subscriptions of all nodes, each time anew: with 1,000 nodes that was
//! three quarters of what the gateway cost. Of a declared key it remembers them.

use std::{
    collections::HashMap,
    sync::{Mutex, PoisonError},
};
use zenoh::{
    Session, Wait,
    key_expr::{KeyExpr, OwnedKeyExpr},
};

/// Keys that are declared; those of further nodes are spelled out in every message. A link has room
/// for 65,535 numbers of keys.
const DECLARED_MAX: usize = 16_384;

/// The declared keys by what they say.
#[derive(Debug, Default)]
pub(super) struct StateKeys(Mutex<HashMap<OwnedKeyExpr, KeyExpr<'static>>>);

impl StateKeys {
    /// Returns the key as `session`, which must be the same each time, names it.
    ///
    /// # Errors
    /// What is no key expression.
    pub(super) fn of(&self, session: &Session, key: &str) -> zenoh::Result<KeyExpr<'static>> {
        let key = OwnedKeyExpr::try_from(key)?;
        let mut declared = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(known) = declared.get(&key) {
            return Ok(known.clone());
        }
        if declared.len() >= DECLARED_MAX {
            return Ok(key.into());
        }
        let known = session.declare_keyexpr(key.clone()).wait()?;
        declared.insert(key, known.clone());
        Ok(known)
    }
}
