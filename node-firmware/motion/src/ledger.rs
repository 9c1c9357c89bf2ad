//! The account of steps: booked when encoded, un-booked while unplayed. Exact at every instant.
//!
//! The hardware tells how many words of its block it has consumed; the ledger knows which words
//! hold a step and which way. A word is consumed from its first tick, which is its active edge, so
//! a step counts from its edge on.

use crate::limits::REFILL_WORDS;

/// Steps of one axis, with sign, since boot.
#[derive(Clone, Debug)]
pub struct Ledger {
    booked_steps: i64,
    halves: [Half; 2],
}

/// The steps of half a block.
#[derive(Clone, Copy, Debug)]
struct Half {
    /// Which words hold a step, bit 0 the first one.
    step_words: u32,
    /// What each of them counts.
    sign: i8,
}

impl Half {
    const NONE: Self = Self {
        step_words: 0,
        sign: 1,
    };

    /// Returns the steps of all words from this one on.
    fn steps_from(self, word: usize) -> i64 {
        let words = self.step_words.checked_shr(word as u32).unwrap_or(0);
        i64::from(words.count_ones() as i32 * i32::from(self.sign))
    }
}

const _: () = assert!(REFILL_WORDS <= u32::BITS as usize);

impl Ledger {
    /// Starts at 0.
    pub(crate) const fn new() -> Self {
        Self {
            booked_steps: 0,
            halves: [Half::NONE; 2],
        }
    }

    /// Books the words of one half block: `half` is 0 or 1, each bit of `step_words` a step of
    /// `sign`.
    pub(crate) fn book(&mut self, half: usize, step_words: u32, sign: i8) {
        self.halves[half] = Half { step_words, sign };
        self.booked_steps += self.halves[half].steps_from(0);
    }

    /// Returns the steps whose active edge has left, when the transmitter plays word `reading`
    /// and the refills are up to date but for `stale_half`, which has been played already.
    pub fn played_steps(&self, reading: usize, stale_half: Option<usize>) -> i64 {
        let mut played_steps = self.booked_steps;
        for (index, half) in self.halves.iter().enumerate() {
            if Some(index) == stale_half {
                continue;
            }
            // Words of the half that is read are played up to `reading`; all of the other half are
            // still to come.
            let unplayed = if index == reading / REFILL_WORDS {
                reading % REFILL_WORDS + 1
            } else {
                0
            };
            played_steps -= half.steps_from(unplayed);
        }
        played_steps
    }

    /// Un-books what was not played: from here on the count is `played_steps`.
    pub(crate) fn settle(&mut self, played_steps: i64) {
        self.booked_steps = played_steps;
        self.halves = [Half::NONE; 2];
    }

    /// Returns all that was booked.
    pub fn booked_steps(&self) -> i64 {
        self.booked_steps
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A ledger of which `words` words were booked, one step each, from half 0 on.
    fn booked(words: usize) -> Ledger {
        let mut ledger = Ledger::new();
        for half in 0..words / REFILL_WORDS {
            ledger.book(half % 2, (1 << REFILL_WORDS) - 1, 1);
        }
        ledger
    }

    #[test]
    fn the_read_pointer_and_the_words_that_were_written_give_the_count() {
        // Words written, read index, half that waits for its refill, words consumed before the
        // one that plays (whose edge has left, so one more step counts).
        for (written, reading, stale_half, consumed) in [
            (48, 17, None, 17),
            (48, 30, Some(0), 30),
            (72, 30, None, 30),
            (72, 10, Some(1), 58),
            (96, 10, None, 58),
            (120, 40, None, 88),
            (144, 10, None, 106),
            (4_824, 5, Some(1), 4_805),
        ] {
            let ledger = booked(written);
            assert_eq!(ledger.played_steps(reading, stale_half), consumed + 1);
        }
    }

    #[test]
    fn rests_and_slow_steps_count_by_their_words() {
        let mut ledger = Ledger::new();
        ledger.book(0, 1 << 3 | 1 << 20, -1);
        ledger.book(1, 0, -1);
        let played: [i64; 4] = [2, 3, 19, 20].map(|reading| ledger.played_steps(reading, None));
        assert_eq!(played, [0, -1, -1, -2]);
        ledger.settle(-1);
        assert_eq!(
            (ledger.booked_steps(), ledger.played_steps(0, None)),
            (-1, -1)
        );
    }
}
