//! Memory of command rings.
//!
//! A ring borrows its memory for as long as its node lives, and an emulated node owns both. Safe
//! Rust has no such owner, so the memory is never freed but handed on: a dropped node gives it
//! to the next one of the same size. A process keeps as many rings as it ever had at a time.

use std::sync::{
    Mutex, PoisonError,
    atomic::{AtomicU32, Ordering},
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
