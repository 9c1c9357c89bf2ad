//! One axis' words in the RMT's RAM: what was written, what was fetched, what was played.
//!
//! Words and units ([`REFILL_WORDS`] words) are counted from the start of the stream and never
//! wrap; their place in the block is the rest of a division.
//!
//! ```text
//!        played      prefetch     fetched                     written
//!   ───────┼────────────┼────────────┼───────────────────────────┼──── words ─▶
//!     the word that plays      read pointer (MEM_RADDR_EX)    END, in a borrowed block
//! ```

use crate::{
    layout::{BLOCK_WORDS, BLOCKS_MAX, Place},
    registers::Registers,
};
use motion::{Direction, Fill, Symbol, limits::REFILL_WORDS};

/// Most units of a block.
const UNITS_MAX: usize = BLOCKS_MAX * BLOCK_WORDS / REFILL_WORDS;

const _: () = assert!(BLOCK_WORDS.is_multiple_of(REFILL_WORDS));
const _: () = assert!(REFILL_WORDS <= 32, "a unit's steps are bits");

/// Words that are left alone when a stream is cut: between reading the pointer and writing the end
/// marker lie three accesses of some 100 ns, and the shortest word lasts 250 ns.
const CUT_MARGIN_WORDS: u64 = 2;

/// Returns how many words the transmitter has consumed, when `written` words were put into a ring
/// of `block` words and the next one is read at `read` (0 to `block` − 1): the one number from
/// `written` − `block` on and below `written` that agrees with `read`.
pub const fn words_consumed(written: u64, block: u64, read: u64) -> u64 {
    // `written` may be less than `block`, so the difference is taken modulo the block.
    let behind = (written + 2 * block - 1 - read) % block;
    (written - 1).saturating_sub(behind)
}

/// One unit of words.
#[derive(Clone, Copy, Debug)]
struct Unit {
    /// Bit n: word n is a step.
    steps: u32,
    /// What each of them adds to the count.
    sign: i8,
    /// The direction pin changes before the first of them.
    turn: Option<Direction>,
    /// When it ends, ticks after the start.
    end_ticks: u64,
}

/// What a look at the read pointer found.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Course {
    /// All is well.
    Good,
    /// The direction pin is due with a word that was fetched and does not play yet.
    Soon,
    /// Words were, or may have been, played before they were written.
    Late,
}

/// One axis' transmitter.
#[derive(Clone, Debug)]
pub(crate) struct Lane {
    axis: usize,
    place: Place,
    prefetch_words: u64,
    units: [Unit; UNITS_MAX],
    written_units: u64,
    fetched_words: u64,
    /// The turns of all units below were made.
    turned_units: u64,
    /// The last turn that was not made when a stream was cut.
    owed_turn: Option<Direction>,
    started_at: u64,
    playing: bool,
    counter: Option<i16>,
    counted_steps: i64,
}

impl Lane {
    /// Stands for a lane until it is told its place.
    pub(crate) const UNPLACED: Self = Self::new(
        0,
        Place {
            channel: 0,
            blocks: 1,
        },
        0,
    );

    pub(crate) const fn new(axis: usize, place: Place, prefetch_words: u64) -> Self {
        Self {
            axis,
            place,
            prefetch_words,
            units: [Unit {
                steps: 0,
                sign: 1,
                turn: None,
                end_ticks: 0,
            }; UNITS_MAX],
            written_units: 0,
            fetched_words: 0,
            turned_units: 0,
            owed_turn: None,
            started_at: 0,
            playing: false,
            counter: None,
            counted_steps: 0,
        }
    }

    pub(crate) fn place(&self) -> Place {
        self.place
    }

    pub(crate) fn mask(&self) -> u8 {
        1 << self.place.channel
    }

    pub(crate) fn is_playing(&self, registers: &impl Registers) -> bool {
        self.playing && registers.ended() & self.mask() == 0
    }

    /// Returns whether a stream was begun and not settled since.
    pub(crate) fn has_begun(&self) -> bool {
        self.playing
    }

    /// Returns the half under which the axis books the next unit.
    pub(crate) fn next_half(&self) -> usize {
        (self.written_units % 2) as usize
    }

    fn words(&self) -> u64 {
        self.place.words() as u64
    }

    fn unit_count(&self) -> u64 {
        self.words() / REFILL_WORDS as u64
    }

    fn written_words(&self) -> u64 {
        self.written_units * REFILL_WORDS as u64
    }

    /// Returns whether the block has room for an end marker behind what is written.
    fn is_guarded(&self) -> bool {
        self.unit_count() > 2
    }

    fn ram_word(&self, word: u64) -> usize {
        self.place.first_word() + (word % self.words()) as usize
    }

    fn unit(&self, unit: u64) -> &Unit {
        &self.units[(unit % self.unit_count()) as usize]
    }

    /// Forgets the stream before; nothing plays.
    pub(crate) fn reset(&mut self) {
        self.written_units = 0;
        self.fetched_words = 0;
        self.turned_units = 0;
        self.playing = false;
    }

    /// Makes what a cut stream still owed to the direction pin, and the turns before the second
    /// unit: nothing steps yet.
    pub(crate) fn turn_at_rest(&mut self, registers: &mut impl Registers) {
        let first = self.owed_turn.take();
        let units = (0..self.written_units.min(2)).map(|unit| self.unit(unit).turn);
        if let Some(direction) = units.fold(first, |last, turn| turn.or(last)) {
            registers.set_direction(self.axis, direction == Direction::Positive);
        }
        self.turned_units = self.written_units.min(2);
    }

    /// The transmitter has begun.
    pub(crate) fn begin(&mut self, at: u64) {
        self.started_at = at;
        self.playing = true;
    }

    /// Changes how long the first unit lasts: a rest, spread over its words.
    pub(crate) fn lead_in(&mut self, ticks: u64, registers: &mut impl Registers) {
        let before = self.units[0].end_ticks;
        let mut left = ticks;
        for index in 0..REFILL_WORDS {
            let word_ticks = left / (REFILL_WORDS - index) as u64;
            registers.write_word(self.ram_word(index as u64), Symbol::low(word_ticks).0);
            left -= word_ticks;
        }
        for unit in 0..self.written_units.min(self.unit_count()) {
            let end_ticks = &mut self.units[unit as usize].end_ticks;
            *end_ticks = *end_ticks - before + ticks;
        }
    }

    /// Reads the pointer and the counter.
    pub(crate) fn look(&mut self, registers: &impl Registers) {
        self.count(registers);
        self.fetched_words = self.fetched_now(registers);
    }

    /// Returns whether the unit that is read is about to be left, and that matters: some chips may
    /// raise the threshold with the unit's last word, not behind it.
    pub(crate) fn is_leaving(&self) -> bool {
        let unit = REFILL_WORDS as u64;
        let next = self.fetched_words / unit + 1;
        let turn_follows = next + 1 < self.written_units && self.unit(next + 1).turn.is_some();
        self.fetched_words % unit == unit - 1 && (turn_follows || !self.is_guarded())
    }

    fn fetched_now(&self, registers: &impl Registers) -> u64 {
        if !self.playing {
            return self.fetched_words;
        }
        let status = registers.status(self.place.channel);
        let read = status.read_word.saturating_sub(self.place.first_word()) as u64;
        words_consumed(
            self.fetched_words + self.words(),
            self.words(),
            read % self.words(),
        )
    }

    /// Extends the counter to 64 bits.
    fn count(&mut self, registers: &impl Registers) {
        if let Some(counter) = registers.counter(self.axis) {
            let since = counter.wrapping_sub(self.counter.unwrap_or(0));
            self.counted_steps += i64::from(since);
            self.counter = Some(counter);
        }
    }

    /// Returns what the counter has counted since boot.
    pub(crate) fn counted_steps(&self, registers: &impl Registers) -> Option<i64> {
        let counter = registers.counter(self.axis)?;
        let since = counter.wrapping_sub(self.counter.unwrap_or(0));
        Some(self.counted_steps + i64::from(since))
    }

    /// Returns the words whose first tick has come.
    fn begun_words(&self, fetched_words: u64) -> u64 {
        // The word that plays counts.
        (fetched_words + 1).saturating_sub(self.prefetch_words)
    }

    /// Returns the steps with sign of all words from this one on.
    fn steps_from(&self, word: u64) -> i64 {
        let first = word / REFILL_WORDS as u64;
        let oldest = self.written_units.saturating_sub(self.unit_count());
        (first.max(oldest)..self.written_units)
            .map(|number| {
                let unit = self.unit(number);
                let skipped = if number == first {
                    word % REFILL_WORDS as u64
                } else {
                    0
                };
                i64::from((unit.steps >> skipped).count_ones()) * i64::from(unit.sign)
            })
            .sum()
    }

    /// Returns the steps of what is written and whose edge has not come.
    pub(crate) fn unplayed_steps(&self, registers: &impl Registers) -> i64 {
        if !self.is_playing(registers) {
            return 0;
        }
        self.steps_from(self.begun_words(self.fetched_now(registers)))
    }

    /// Returns whether another unit can be written, given the last look. Rests are not written far
    /// ahead: what lies in the block cannot be changed any more.
    pub(crate) fn has_room(&self, now: u64, enough_ticks: u64) -> bool {
        let fetched_units = self.fetched_words / REFILL_WORDS as u64;
        let ahead = self.written_units.saturating_sub(fetched_units);
        if ahead < 2 {
            return true;
        }
        let most = self.unit_count() - u64::from(self.is_guarded());
        ahead < most && self.end_at() < now.saturating_add(enough_ticks)
    }

    /// Returns when the last word that is written ends.
    fn end_at(&self) -> u64 {
        match self.written_units {
            0 => self.started_at,
            count => self.started_at + self.unit(count - 1).end_ticks,
        }
    }

    /// Writes a unit. `steps` is what it adds to the count.
    ///
    /// The first word is written last, behind which an end marker already lies: whatever the
    /// transmitter finds, it is whole or the end.
    pub(crate) fn write(&mut self, fill: &Fill, steps: i64, registers: &mut impl Registers) {
        let number = self.written_units;
        let end_ticks = match number {
            0 => 0,
            _ => self.unit(number - 1).end_ticks,
        };
        let first = self.written_words();
        if self.is_guarded() {
            let guard = self.ram_word(first + REFILL_WORDS as u64);
            registers.write_word(guard, Symbol::END.0);
        }
        let mut unit = Unit {
            steps: 0,
            sign: if steps < 0 { -1 } else { 1 },
            turn: fill.turn,
            end_ticks,
        };
        for (index, word) in fill.words.iter().enumerate().rev() {
            registers.write_word(self.ram_word(first + index as u64), word.0);
            unit.steps |= u32::from(word.is_step() && !word.is_end()) << index;
            unit.end_ticks += word.ticks();
        }
        self.units[(number % self.unit_count()) as usize] = unit;
        self.written_units += 1;
    }

    /// Judges a unit that was just written; `due_at` is when the words before it ended. To be
    /// called after a look.
    pub(crate) fn judge(&self, due_at: u64, now: u64) -> Course {
        let first = self.written_words() - REFILL_WORDS as u64;
        if self.fetched_words >= first || now >= due_at {
            return Course::Late;
        }
        Course::Good
    }

    /// Returns when the words that are written so far end; what comes next must be there by then.
    pub(crate) fn due_at(&self) -> u64 {
        self.end_at()
    }

    /// Makes the turns that are due: that of a unit when the one before it begins, in which nothing
    /// steps. To be called after a look.
    pub(crate) fn turn(&mut self, registers: &mut impl Registers) -> Course {
        while self.turned_units < self.written_units {
            let number = self.turned_units;
            let Some(direction) = self.unit(number).turn else {
                self.turned_units += 1;
                continue;
            };
            let window = (number - 1) * REFILL_WORDS as u64;
            if self.fetched_words < window {
                return Course::Good;
            }
            if self.begun_words(self.fetched_words) <= window {
                // Words that were fetched ahead belong to the steps before the turn.
                return Course::Soon;
            }
            registers.set_direction(self.axis, direction == Direction::Positive);
            self.turned_units += 1;
            self.look(registers);
            if self.fetched_words >= window + REFILL_WORDS as u64 {
                return Course::Late;
            }
        }
        Course::Good
    }

    /// Puts an end marker close behind the read pointer. Returns the first word that is not played,
    /// `None` if the transmitter was quicker.
    pub(crate) fn cut(&mut self, registers: &mut impl Registers) -> Option<u64> {
        self.look(registers);
        let end = self.fetched_words + 1 + CUT_MARGIN_WORDS;
        registers.write_word(self.ram_word(end), Symbol::END.0);
        self.look(registers);
        (self.fetched_words < end).then_some(end)
    }

    /// Returns whether the transmitter can be stopped in the middle of its word, after
    /// [`Lane::cut`]: its pin is low and no edge would have come before `end`.
    pub(crate) fn can_truncate(&mut self, end: Option<u64>, registers: &impl Registers) -> bool {
        let Some(end) = end else { return false };
        self.look(registers);
        let ahead = self.steps_from(self.begun_words(self.fetched_words)) - self.steps_from(end);
        ahead == 0 && !registers.step_pin(self.place.channel)
    }

    /// The transmitter is quiet. Returns the steps that were written and not played, given where
    /// the stream was cut.
    pub(crate) fn end(&mut self, cut: Option<u64>, registers: &impl Registers) -> i64 {
        self.count(registers);
        self.playing = false;
        self.owed_turn = (self.turned_units..self.written_units)
            .filter_map(|number| self.unit(number).turn)
            .next_back()
            .or(self.owed_turn);
        cut.map_or(0, |word| self.steps_from(word))
    }

    /// The transmitter has run into the end marker behind what was written. Returns the first word
    /// that was not played.
    pub(crate) fn starved_at(&mut self, registers: &impl Registers) -> u64 {
        self.look(registers);
        let unit = REFILL_WORDS as u64;
        (self.fetched_words / unit * unit).min(self.written_words())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_read_pointer_and_the_refills_give_the_words_consumed() {
        for (written, block, read, consumed) in [
            (48, 48, 17, 17),
            (72, 48, 30, 30),
            (72, 48, 10, 58),
            (120, 48, 10, 106),
            (120, 48, 40, 88),
            (4_824, 48, 5, 4_805),
            (48, 240, 17, 17),
            (264, 240, 30, 30),
            (264, 240, 10, 250),
        ] {
            assert_eq!(words_consumed(written, block, read), consumed);
        }
        for written in 48..500 {
            for consumed in written - 48..written {
                assert_eq!(words_consumed(written, 48, consumed % 48), consumed);
            }
        }
    }
}
