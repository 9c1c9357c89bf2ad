//! The account of steps: booked when encoded, un-booked while unplayed. Exact at every instant.
//!
//! The hardware tells how many words of its block it has consumed; the ledger knows which words
//! hold a step and which way. A word is consumed from its first tick, which is its active edge, so
//! a step counts from its edge on.

use crate::limits::{CHANNEL_WORDS, REFILL_WORDS};

/// Steps of one axis, with sign, since boot.
#[derive(Clone, Debug)]
pub struct Ledger {
    booked_steps: i64,
    steps_in_word: [i8; CHANNEL_WORDS],
}

impl Ledger {
    /// Starts at 0.
    pub(crate) const fn new() -> Self {
        Self {
            booked_steps: 0,
            steps_in_word: [0; CHANNEL_WORDS],
        }
    }

    /// Books the words of one half block; `half` is 0 or 1.
    pub(crate) fn book(&mut self, half: usize, steps_in_word: &[i8; REFILL_WORDS]) {
        let words = &mut self.steps_in_word[half * REFILL_WORDS..][..REFILL_WORDS];
        words.copy_from_slice(steps_in_word);
        self.booked_steps += words.iter().map(|steps| i64::from(*steps)).sum::<i64>();
    }

    /// Returns the steps whose active edge has left, when the transmitter plays word `reading`
    /// and the refills are up to date but for `stale_half`, which has been played already.
    pub fn played_steps(&self, reading: usize, stale_half: Option<usize>) -> i64 {
        let unplayed: i64 = self
            .steps_in_word
            .iter()
            .enumerate()
            .filter(|(word, _)| {
                let half = word / REFILL_WORDS;
                if Some(half) == stale_half {
                    return false;
                }
                // Words of the half that is read are played up to `reading`; all of the other
                // half are still to come.
                half != reading / REFILL_WORDS || *word > reading
            })
            .map(|(_, steps)| i64::from(*steps))
            .sum();
        self.booked_steps - unplayed
    }

    /// Un-books what was not played: from here on the count is `played_steps`.
    pub(crate) fn settle(&mut self, played_steps: i64) {
        self.booked_steps = played_steps;
        self.steps_in_word = [0; CHANNEL_WORDS];
    }

    /// Returns all that was booked.
    pub fn booked_steps(&self) -> i64 {
        self.booked_steps
    }
}
