//! The last so many of something, oldest first.

use std::collections::VecDeque;

/// See the module. Full means that the oldest goes.
#[derive(Clone, Debug)]
pub struct Ring<T, const MAX: usize> {
    kept: VecDeque<T>,
}

impl<T, const MAX: usize> Default for Ring<T, MAX> {
    fn default() -> Self {
        Self {
            kept: VecDeque::new(),
        }
    }
}

impl<T, const MAX: usize> Ring<T, MAX> {
    /// Takes the newest.
    pub fn push(&mut self, newest: T) {
        if self.kept.len() == MAX {
            self.kept.pop_front();
        }
        self.kept.push_back(newest);
    }

    /// Returns what is kept, oldest first.
    pub fn iter(&self) -> impl DoubleEndedIterator<Item = &T> + ExactSizeIterator {
        self.kept.iter()
    }

    /// Returns the newest.
    pub fn last(&self) -> Option<&T> {
        self.kept.back()
    }

    /// Forgets everything.
    pub fn clear(&mut self) {
        self.kept.clear();
    }
}
