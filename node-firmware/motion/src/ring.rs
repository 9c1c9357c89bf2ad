//! The command ring over the caller's memory (PSRAM on the board): reserve → push → commit.
//!
//! A record is 8 words. The words are atomics only because that is how shared memory is lent
//! without `unsafe`: the ring has one owner, so every access is relaxed.

use core::sync::atomic::{AtomicU32, Ordering};
use keys::{Command, command::COMMAND_WORDS};

/// There is no room for this many commands now.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Full;

/// Commands that were accepted and not yet executed, oldest first. Those at the front are planned;
/// they keep their place, because a change in flight may take the plan back.
#[derive(Debug)]
pub struct CommandRing<'m> {
    words: &'m [AtomicU32],
    first: usize,
    count: usize,
    planned: usize,
}

impl<'m> CommandRing<'m> {
    /// Takes memory for `words.len() / 8` commands.
    ///
    /// # Panics
    /// The memory holds no command.
    pub const fn new(words: &'m [AtomicU32]) -> Self {
        assert!(
            words.len() >= COMMAND_WORDS,
            "the ring must hold at least one command"
        );
        Self {
            words,
            first: 0,
            count: 0,
            planned: 0,
        }
    }

    /// Returns how many commands it holds when full.
    pub const fn capacity(&self) -> usize {
        self.words.len() / COMMAND_WORDS
    }

    /// Returns how many commands still fit.
    pub const fn room(&self) -> usize {
        self.capacity() - self.count
    }

    /// Returns how many commands wait to be planned.
    pub const fn count(&self) -> usize {
        self.count - self.planned
    }

    /// Sets `count` places aside. Nothing is visible before [`Reservation::commit`].
    ///
    /// # Errors
    /// [`Full`]: not all of them fit now.
    pub fn reserve(&mut self, count: usize) -> Result<Reservation<'_, 'm>, Full> {
        if count > self.room() {
            return Err(Full);
        }
        Ok(Reservation {
            ring: self,
            count,
            pushed: 0,
            accepted: None,
        })
    }

    pub(crate) fn reserve_counted<'r>(
        &'r mut self,
        count: usize,
        accepted: &'r mut u64,
    ) -> Result<Reservation<'r, 'm>, Full> {
        let mut reservation = self.reserve(count)?;
        reservation.accepted = Some(accepted);
        Ok(reservation)
    }

    /// Returns the oldest command that is not planned.
    ///
    /// # Panics
    /// Somebody else wrote to the memory.
    pub fn peek(&self) -> Option<Command> {
        self.peek_at(0)
    }

    /// Returns the command that `index` others come before, which are not planned.
    ///
    /// # Panics
    /// As [`CommandRing::peek`].
    pub fn peek_at(&self, index: usize) -> Option<Command> {
        let index = self.planned + index;
        if index >= self.count {
            return None;
        }
        let record = self.record((self.first + index) % self.capacity());
        let words = core::array::from_fn(|index| record[index].load(Ordering::Relaxed));
        Some(Command::from_words(&words).expect("only commands are pushed"))
    }

    /// Marks the oldest command that is not planned as planned.
    pub fn advance(&mut self) {
        if self.planned < self.count {
            self.planned += 1;
        }
    }

    /// Takes back the last `count` times of [`CommandRing::advance`].
    pub fn retract(&mut self, count: usize) {
        self.planned = self.planned.saturating_sub(count);
    }

    /// Drops the oldest command: it is executed.
    pub fn pop(&mut self) {
        if self.count > 0 {
            self.first = (self.first + 1) % self.capacity();
            self.count -= 1;
            self.planned = self.planned.saturating_sub(1);
        }
    }

    /// Drops all.
    pub fn clear(&mut self) {
        self.count = 0;
        self.planned = 0;
    }

    fn record(&self, index: usize) -> &[AtomicU32] {
        &self.words[index * COMMAND_WORDS..][..COMMAND_WORDS]
    }
}

/// Places in the ring. Dropped without [`Reservation::commit`], nothing has happened.
#[derive(Debug)]
pub struct Reservation<'r, 'm> {
    ring: &'r mut CommandRing<'m>,
    count: usize,
    pushed: usize,
    accepted: Option<&'r mut u64>,
}

impl Reservation<'_, '_> {
    /// Writes the next command.
    ///
    /// # Panics
    /// More commands than were reserved.
    pub fn push(&mut self, command: &Command) {
        assert!(self.pushed < self.count, "more commands than reserved");
        let index = (self.ring.first + self.ring.count + self.pushed) % self.ring.capacity();
        for (to, from) in self.ring.record(index).iter().zip(command.to_words()) {
            to.store(from, Ordering::Relaxed);
        }
        self.pushed += 1;
    }

    /// Makes all pushed commands part of the ring.
    pub fn commit(self) {
        self.ring.count += self.pushed;
        if let Some(accepted) = self.accepted {
            *accepted += self.pushed as u64;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn pause(pause_ms: u32) -> Command {
        Command::Pause { pause_ms }
    }

    #[test]
    fn a_dropped_reservation_has_no_effect() {
        let memory: [AtomicU32; 4 * COMMAND_WORDS] = [const { AtomicU32::new(0) }; _];
        let mut ring = CommandRing::new(&memory);
        ring.reserve(3).expect("room").push(&pause(1));
        assert_eq!((ring.count(), ring.peek()), (0, None));
    }

    #[test]
    fn order_is_kept_around_the_end_and_full_is_an_answer() {
        let memory: [AtomicU32; 4 * COMMAND_WORDS] = [const { AtomicU32::new(0) }; _];
        let mut ring = CommandRing::new(&memory);
        let mut expected = 0;
        for first in (0..300).step_by(3) {
            let mut reservation = ring.reserve(3).expect("room");
            for number in first..first + 3 {
                reservation.push(&pause(number));
            }
            reservation.commit();
            assert_eq!(ring.reserve(2).err(), Some(Full));
            while let Some(command) = ring.peek() {
                assert_eq!(command, pause(expected));
                expected += 1;
                ring.pop();
            }
        }
        assert_eq!(expected, 300);
    }
}
