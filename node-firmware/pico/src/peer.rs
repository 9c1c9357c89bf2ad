//! What the peer has told us: its key numbers, who subscribes, who is alive.
//!
//! Owns three bounded tables that begin empty with each connection. What does not fit is counted
//! as refused: messages under an unknown number are dropped, a token beyond the bound is not
//! reported, and when subscribers overflow every publisher counts as wanted.

use alloc::{string::String, vec::Vec};

use zenoh_keyexpr::{OwnedKeyExpr, keyexpr};
use zenoh_protocol::{
    core::{ExprId, WireExpr},
    network::Mapping,
};

use crate::{
    declarations::{Declarations, joined},
    key::Key,
    limits,
};

/// A token of somebody, and which of our liveliness subscribers know of it.
#[derive(Debug)]
pub(crate) struct PeerToken {
    pub(crate) id: u32,
    pub(crate) key: OwnedKeyExpr,
    pub(crate) told: Vec<u32>,
}

#[derive(Debug, Default)]
pub(crate) struct Peer {
    /// Few enough to be looked through; a tree takes more code than it saves time.
    keys: Vec<(ExprId, String)>,
    subscribers: Vec<(u32, OwnedKeyExpr)>,
    subscribers_overflowed: bool,
    tokens: Vec<PeerToken>,
}

/// A table has no room.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Refused;

impl Peer {
    pub(crate) fn clear(&mut self) {
        *self = Self::default();
    }

    pub(crate) fn declare_key(&mut self, expr: ExprId, key: String) -> Result<(), Refused> {
        if let Some((_, known)) = self.keys.iter_mut().find(|(known, _)| *known == expr) {
            *known = key;
            return Ok(());
        }
        if self.keys.len() >= limits::PEER_KEYS_MAX {
            return Err(Refused);
        }
        self.keys.push((expr, key));
        Ok(())
    }

    pub(crate) fn undeclare_key(&mut self, expr: ExprId) -> bool {
        let place = self.keys.iter().position(|(known, _)| *known == expr);
        place.map(|place| self.keys.swap_remove(place)).is_some()
    }

    fn key(&self, expr: ExprId) -> Option<&str> {
        let found = self.keys.iter().find(|(known, _)| *known == expr);
        found.map(|(_, key)| key.as_str())
    }

    /// The key that an expression of the peer means.
    pub(crate) fn resolve(&self, own: &Declarations, expr: WireExpr<'static>) -> Option<String> {
        if expr.scope == 0 {
            return Some(expr.suffix.into_owned());
        }
        let base = match expr.mapping {
            Mapping::Sender => self.key(expr.scope)?,
            Mapping::Receiver => own.key(expr.scope)?,
        };
        Some(joined(base, &expr.suffix))
    }

    /// The key that a scope, its mapping and a suffix mean.
    pub(crate) fn resolve_parts(
        &self,
        own: &Declarations,
        scope: ExprId,
        mapping: Mapping,
        suffix: &str,
    ) -> Option<Key> {
        let base = match mapping {
            _ if scope == 0 => "",
            Mapping::Sender => self.key(scope)?,
            Mapping::Receiver => own.key(scope)?,
        };
        Some(Key::joined(base, suffix))
    }

    pub(crate) fn declare_subscriber(&mut self, id: u32, key: &keyexpr) -> Result<(), Refused> {
        if let Some((_, known)) = self.subscribers.iter_mut().find(|(known, _)| *known == id) {
            *known = key.into();
            return Ok(());
        }
        if self.subscribers.len() >= limits::PEER_SUBSCRIBERS_MAX {
            self.subscribers_overflowed = true;
            return Err(Refused);
        }
        self.subscribers.push((id, key.into()));
        Ok(())
    }

    pub(crate) fn undeclare_subscriber(&mut self, id: u32) -> bool {
        let count = self.subscribers.len();
        self.subscribers.retain(|(known, _)| *known != id);
        // Beyond the bound we cannot tell whose end this is.
        self.subscribers.len() != count || self.subscribers_overflowed
    }

    /// Whether somebody wants what is published on `key`.
    pub(crate) fn wants(&self, key: &keyexpr) -> bool {
        self.subscribers_overflowed || self.subscribers.iter().any(|(_, k)| k.intersects(key))
    }

    /// The token of this number, new if there is none with this key.
    pub(crate) fn declare_token(
        &mut self,
        id: u32,
        key: &keyexpr,
    ) -> Result<&mut PeerToken, Refused> {
        let index = match self.tokens.iter().position(|token| token.id == id) {
            Some(index) => index,
            None if self.tokens.len() >= limits::PEER_TOKENS_MAX => return Err(Refused),
            None => {
                self.tokens.push(PeerToken {
                    id,
                    key: key.into(),
                    told: Vec::new(),
                });
                self.tokens.len() - 1
            }
        };
        Ok(&mut self.tokens[index])
    }

    pub(crate) fn undeclare_token(&mut self, id: u32) -> Option<PeerToken> {
        let index = self.tokens.iter().position(|token| token.id == id)?;
        Some(self.tokens.swap_remove(index))
    }

    /// A liveliness subscriber left: nobody remembers what it was told.
    pub(crate) fn forget_told(&mut self, subscriber: u32) {
        for token in &mut self.tokens {
            token.told.retain(|told| *told != subscriber);
        }
        self.tokens.retain(|token| !token.told.is_empty());
    }
}
