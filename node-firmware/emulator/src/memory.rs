//! Memory of command rings and of plans.
//!
//! A node borrows its memory for as long as it lives, and an emulated node owns both. Safe Rust has
//! no such owner, so the memory is never freed but handed on: a dropped node gives it to the next
//! one of the same size. A process keeps as much as it ever had at a time.

use crate::emulated::InnerNode;
use motion::{PlanMemory, Plans};
use std::{
    ops::{Deref, DerefMut},
    sync::{
        Mutex, PoisonError,
        atomic::{AtomicU32, Ordering},
    },
};

static FREE: Mutex<Vec<&'static [AtomicU32]>> = Mutex::new(Vec::new());

/// Words for one ring, handed on when dropped.
#[derive(Debug)]
pub(crate) struct RingMemory(&'static [AtomicU32]);

impl RingMemory {
    /// Returns this many words, all 0.
    pub(crate) fn take(word_count: usize) -> Self {
        let mut free = FREE.lock().unwrap_or_else(PoisonError::into_inner);
        let used = free.iter().position(|words| words.len() == word_count);
        let words = match used {
            Some(index) => free.swap_remove(index),
            None => Box::leak((0..word_count).map(|_| AtomicU32::new(0)).collect()),
        };
        for word in words {
            word.store(0, Ordering::Relaxed);
        }
        Self(words)
    }

    /// Returns the words. Whoever holds them must be gone before `self` is dropped; if not, two
    /// rings would hold nonsense, though never undefined behaviour.
    pub(crate) fn words(&self) -> &'static [AtomicU32] {
        self.0
    }
}

impl Drop for RingMemory {
    fn drop(&mut self) {
        FREE.lock()
            .unwrap_or_else(PoisonError::into_inner)
            .push(self.0);
    }
}

static FREE_PLANS: Mutex<Vec<Plans<'static>>> = Mutex::new(Vec::new());

/// Lends memory for plans; a [`Borrower`] gives it back.
pub(crate) fn take_plans() -> Plans<'static> {
    let free = FREE_PLANS
        .lock()
        .unwrap_or_else(PoisonError::into_inner)
        .pop();
    free.unwrap_or_else(|| Box::leak(Box::new(PlanMemory::new())).plans())
}

/// A node whose memory for plans is handed on when it is dropped.
pub(crate) struct Borrower(Option<InnerNode>);

impl From<InnerNode> for Borrower {
    fn from(node: InnerNode) -> Self {
        Self(Some(node))
    }
}

impl Deref for Borrower {
    type Target = InnerNode;

    fn deref(&self) -> &InnerNode {
        self.0.as_ref().expect("only a drop takes it")
    }
}

impl DerefMut for Borrower {
    fn deref_mut(&mut self) -> &mut InnerNode {
        self.0.as_mut().expect("only a drop takes it")
    }
}

impl Drop for Borrower {
    fn drop(&mut self) {
        if let Some(node) = self.0.take() {
            FREE_PLANS
                .lock()
                .unwrap_or_else(PoisonError::into_inner)
                .push(node.into_plans());
        }
    }
}
