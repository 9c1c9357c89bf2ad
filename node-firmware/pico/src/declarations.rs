//! What this session has declared, and how much of it the peer knows.
//!
//! Owns the table of our key expressions (with the numbers that stand for them on the wire) and
//! everything declared on them. Declarations outlive connections: each new connection is told all
//! of them again. Promises that a key is told before what stands on it, and taken back after the
//! last message that may use it.

use alloc::{collections::VecDeque, string::String, vec::Vec};

use zenoh_keyexpr::{OwnedKeyExpr, keyexpr};
use zenoh_protocol::core::ExprId;

use crate::{
    event::{DeclareError, Priority, UndeclareError},
    limits,
    transmit::{LANE_CONTROL, LANE_LAST, PushError, TransmitQueue},
    wire::network::{self, WireKey},
};

/// What stands on a key.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Kind {
    Key,
    Subscriber,
    Queryable { complete: bool },
    Publisher { answered: bool, wanted: bool },
    Token,
    Liveliness,
}

impl Kind {
    fn same_table(self, other: Self) -> bool {
        core::mem::discriminant(&self) == core::mem::discriminant(&other)
    }

    fn count_max(self) -> usize {
        match self {
            Self::Key => limits::KEYS_MAX,
            Self::Subscriber => limits::SUBSCRIBERS_MAX,
            Self::Queryable { .. } => limits::QUERYABLES_MAX,
            Self::Publisher { .. } => limits::PUBLISHERS_MAX,
            Self::Token => limits::TOKENS_MAX,
            Self::Liveliness => limits::LIVELINESS_SUBSCRIBERS_MAX,
        }
    }
}

#[derive(Debug)]
pub(crate) struct Entity {
    pub(crate) id: u32,
    pub(crate) kind: Kind,
    pub(crate) key: OwnedKeyExpr,
    expr: ExprId,
    told: bool,
}

#[derive(Debug)]
struct Key {
    expr: ExprId,
    key: OwnedKeyExpr,
    use_count: usize,
    told: bool,
}

/// Something that was told and is to be taken back.
#[derive(Debug, Clone, Copy)]
enum Leaving {
    Key(ExprId),
    Entity(u32, Kind),
}

#[derive(Debug)]
pub(crate) struct Declarations {
    keys: Vec<Key>,
    entities: Vec<Entity>,
    leaving: VecDeque<Leaving>,
    last_id: u32,
    last_expr: ExprId,
    /// Something is not told yet.
    untold: bool,
}

impl Declarations {
    pub(crate) fn new() -> Self {
        Self {
            keys: Vec::new(),
            entities: Vec::new(),
            leaving: VecDeque::new(),
            last_id: 0,
            last_expr: 0,
            untold: false,
        }
    }

    /// A new peer knows nothing.
    pub(crate) fn forget_told(&mut self) {
        for key in &mut self.keys {
            key.told = false;
        }
        for entity in &mut self.entities {
            entity.told = false;
            if let Kind::Publisher { answered, wanted } = &mut entity.kind {
                *answered = false;
                *wanted = false;
            }
        }
        self.leaving.clear();
        self.untold = true;
    }

    pub(crate) fn declare(&mut self, kind: Kind, key: &str) -> Result<u32, DeclareError> {
        let key = check_key(key).ok_or(DeclareError::Key)?;
        let count = self
            .entities
            .iter()
            .filter(|e| e.kind.same_table(kind))
            .count();
        if count >= kind.count_max() {
            return Err(DeclareError::Full);
        }
        let index = match self.keys.iter().position(|k| &*k.key == key) {
            Some(index) => index,
            None => {
                if self.keys.len() >= limits::KEYS_MAX {
                    return Err(DeclareError::Full);
                }
                let expr = self.free_expr();
                self.keys.push(Key {
                    expr,
                    key: key.into(),
                    use_count: 0,
                    told: false,
                });
                self.keys.len() - 1
            }
        };
        let key = &mut self.keys[index];
        key.use_count += 1;
        let id = loop {
            self.last_id = self.last_id.wrapping_add(1);
            if self.last_id != 0 && self.entities.iter().all(|e| e.id != self.last_id) {
                break self.last_id;
            }
        };
        let entity = Entity {
            id,
            kind,
            key: key.key.clone(),
            expr: key.expr,
            told: false,
        };
        self.entities.push(entity);
        self.untold = true;
        Ok(id)
    }

    pub(crate) fn undeclare(&mut self, kind: Kind, id: u32) -> Result<(), UndeclareError> {
        let position = self
            .entities
            .iter()
            .position(|e| e.id == id && e.kind.same_table(kind));
        let index = position.ok_or(UndeclareError::Unknown)?;
        let expr = self.entities[index].expr;
        let key = self
            .keys
            .iter()
            .position(|k| k.expr == expr)
            .expect("a declaration holds its key");
        let told = self.entities[index].told || self.keys[key].told;
        if told && self.leaving.len() + 2 > limits::LEAVING_MAX {
            return Err(UndeclareError::Full);
        }
        let entity = self.entities.remove(index);
        if entity.told && entity.kind != Kind::Key {
            self.leaving
                .push_back(Leaving::Entity(entity.id, entity.kind));
            self.untold = true;
        }
        self.keys[key].use_count -= 1;
        if self.keys[key].use_count == 0 {
            let key = self.keys.remove(key);
            if key.told {
                self.leaving.push_back(Leaving::Key(key.expr));
                self.untold = true;
            }
        }
        Ok(())
    }

    /// Queues what the peer does not know yet, as far as the queue has room.
    pub(crate) fn tell(&mut self, queue: &mut TransmitQueue) -> Result<(), PushError> {
        if !self.untold {
            return Ok(());
        }
        while let Some(leaving) = self.leaving.front().copied() {
            match leaving {
                // Puts that use the number are in the lanes above.
                Leaving::Key(expr) => queue.push(LANE_LAST, false, 0, |out| {
                    network::write_declare(out, None, network::undeclare_key(expr))
                })?,
                Leaving::Entity(id, kind) => {
                    queue.push(LANE_CONTROL, false, 0, |out| match kind {
                        Kind::Key => Ok(()),
                        Kind::Subscriber => {
                            network::write_declare(out, None, network::undeclare_subscriber(id))
                        }
                        Kind::Queryable { .. } => {
                            network::write_declare(out, None, network::undeclare_queryable(id))
                        }
                        Kind::Token => {
                            network::write_declare(out, None, network::undeclare_token(id))
                        }
                        Kind::Publisher { .. } | Kind::Liveliness => {
                            network::write_interest_final(out, id)
                        }
                    })?
                }
            }
            self.leaving.pop_front();
        }
        for entity in self.entities.iter_mut().filter(|e| !e.told) {
            let key = self.keys.iter_mut().find(|k| k.expr == entity.expr);
            let key = key.expect("a declaration holds its key");
            if !key.told {
                queue.push(LANE_CONTROL, false, key.key.len(), |out| {
                    network::write_declare(out, None, network::declare_key(key.expr, &key.key))
                })?;
                key.told = true;
            }
            let (id, expr) = (entity.id, entity.expr);
            if entity.kind != Kind::Key {
                queue.push(LANE_CONTROL, false, 0, |out| match entity.kind {
                    Kind::Key => Ok(()),
                    Kind::Subscriber => {
                        network::write_declare(out, None, network::declare_subscriber(id, expr))
                    }
                    Kind::Queryable { complete } => network::write_declare(
                        out,
                        None,
                        network::declare_queryable(id, expr, complete),
                    ),
                    Kind::Token => {
                        network::write_declare(out, None, network::declare_token(id, expr))
                    }
                    Kind::Publisher { .. } => {
                        network::write_interest_in_subscribers(out, id, WireKey::Id(expr))
                    }
                    Kind::Liveliness => {
                        network::write_interest_in_tokens(out, id, WireKey::Id(expr))
                    }
                })?;
            }
            entity.told = true;
        }
        self.untold = false;
        Ok(())
    }

    /// The key of a declaration, by its number if the peer knows that.
    pub(crate) fn wire_key(&self, kind: Kind, id: u32) -> Option<WireKey<'_>> {
        let entity = self
            .entities
            .iter()
            .find(|e| e.id == id && e.kind.same_table(kind))?;
        let told = self.keys.iter().any(|k| k.expr == entity.expr && k.told);
        Some(if told {
            WireKey::Id(entity.expr)
        } else {
            WireKey::Full(&entity.key)
        })
    }

    /// The key that one of our numbers stands for.
    pub(crate) fn key(&self, expr: ExprId) -> Option<&str> {
        self.keys
            .iter()
            .find(|k| k.expr == expr)
            .map(|k| k.key.as_str())
    }

    pub(crate) fn entities(&self) -> impl Iterator<Item = &Entity> {
        self.entities.iter()
    }

    /// All declarations of a kind whose key meets `key`.
    pub(crate) fn matching<'a>(
        &'a self,
        kind: Kind,
        key: &'a keyexpr,
    ) -> impl Iterator<Item = &'a Entity> {
        self.entities
            .iter()
            .filter(move |e| e.kind.same_table(kind) && e.key.intersects(key))
    }

    pub(crate) fn entities_mut(&mut self) -> impl Iterator<Item = &mut Entity> {
        self.entities.iter_mut()
    }

    fn free_expr(&mut self) -> ExprId {
        // Fewer than KEYS_MAX of 65535 are taken. A number comes back only after all others, so
        // what is still on its way to us under the old meaning has long arrived.
        loop {
            self.last_expr = self.last_expr.wrapping_add(1);
            if self.last_expr != 0 && self.keys.iter().all(|k| k.expr != self.last_expr) {
                return self.last_expr;
            }
        }
    }
}

/// A canonical key of bounded length.
pub(crate) fn check_key(key: &str) -> Option<&keyexpr> {
    if key.len() > limits::KEY_BYTES_MAX {
        return None;
    }
    keyexpr::new(key).ok()
}

/// The lane of a priority.
pub(crate) fn lane(priority: Priority) -> usize {
    priority as usize
}

/// `base` and `suffix` as one key.
pub(crate) fn joined(base: &str, suffix: &str) -> String {
    let mut key = String::with_capacity(base.len() + suffix.len());
    key.push_str(base);
    key.push_str(suffix);
    key
}
