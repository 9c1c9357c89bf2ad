//! One axis' words in the RMT's RAM: what was written, what was fetched, what was played.
//!
//! Words and units ([`REFILL_WORDS`] words) are counted from the start of the stream and never
//! wrap. Their places in the block are kept beside the counts and wrap by comparison: the refill
//! interrupt must not divide 64 bits, which the chip does by some hundred instructions.
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
const CUT_MARGIN_WORDS: usize = 2;

/// Returns how many words lie between two places of a ring of `block` words, going forward from
/// `from` to `to`, both below `block`: 0 to `block` − 1.
const fn words_between(from: usize, to: usize, block: usize) -> usize {
    if to >= from {
        to - from
    } else {
        to + block - from
    }
}

/// One unit of words.
#[derive(Clone, Copy, Debug)]
struct Unit {
    /// Bit n: word n is a step.
    steps: u32,
    /// What each of them adds to the count.
    sign: i8,
    /// The direction pin changes before the first of them steps: so many ticks after it begins at the
    /// latest.
    turn: Option<Direction>,
    turn_by_ticks: i32,
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
    /// Words were, or may have been, played before they were written; or the direction pin was
    /// switched later than its driver allows.
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
    /// Place of the next unit that is written: 0 to the block's units − 1.
    next_slot: usize,
    fetched_words: u64,
    /// Units that were fetched to their end, and the words of the one that is being fetched.
    fetched_units: u64,
    fetched_of_unit: usize,
    /// Place of the word that is fetched next: 0 to the block's words − 1.
    read_place: usize,
    /// The turns of all units below were made.
    turned_units: u64,
    /// The last turn that was not made when a stream was cut.
    owed_turn: Option<Direction>,
    started_at: u64,
    playing: bool,
    counter: Option<i16>,
    counted_steps: i64,
    /// What the first words of the block hold: who writes the same again need not.
    held: [u32; BLOCK_WORDS],
}

/// No word is written like this: both halves high.
const UNKNOWN_WORD: u32 = u32::MAX;

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
                turn_by_ticks: 0,
                end_ticks: 0,
            }; UNITS_MAX],
            written_units: 0,
            next_slot: 0,
            fetched_words: 0,
            fetched_units: 0,
            fetched_of_unit: 0,
            read_place: 0,
            turned_units: 0,
            owed_turn: None,
            started_at: 0,
            playing: false,
            counter: None,
            counted_steps: 0,
            held: [UNKNOWN_WORD; BLOCK_WORDS],
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

    /// The same, given which channels have ended.
    pub(crate) fn plays(&self, ended: u8) -> bool {
        self.playing && ended & self.mask() == 0
    }

    /// Returns whether a stream was begun and not settled since.
    pub(crate) fn has_begun(&self) -> bool {
        self.playing
    }

    /// Returns the half under which the axis books the next unit.
    pub(crate) fn next_half(&self) -> usize {
        (self.written_units % 2) as usize
    }

    /// Words of the block.
    fn words(&self) -> usize {
        self.place.words()
    }

    fn unit_count(&self) -> usize {
        self.words() / REFILL_WORDS
    }

    fn written_words(&self) -> u64 {
        self.written_units * REFILL_WORDS as u64
    }

    /// Returns whether the block has room for an end marker behind what is written.
    fn is_guarded(&self) -> bool {
        self.unit_count() > 2
    }

    /// Writes a word at a place of the block, unless it is there; places up to twice the block wrap.
    fn put(&mut self, place: usize, word: u32, registers: &mut impl Registers) {
        let place = place.checked_sub(self.words()).unwrap_or(place);
        if let Some(held) = self.held.get_mut(place) {
            if *held == word {
                return;
            }
            *held = word;
        }
        registers.write_word(self.place.first_word() + place, word);
    }

    /// Returns the place of one of the units that the block holds.
    fn slot(&self, unit: u64) -> usize {
        let back = (self.written_units - unit) as usize;
        match self.next_slot.checked_sub(back) {
            Some(slot) => slot,
            None => self.next_slot + self.unit_count() - back,
        }
    }

    fn unit(&self, unit: u64) -> &Unit {
        &self.units[self.slot(unit)]
    }

    /// Forgets the stream before; nothing plays.
    pub(crate) fn reset(&mut self) {
        self.written_units = 0;
        self.next_slot = 0;
        self.fetched_words = 0;
        self.fetched_units = 0;
        self.fetched_of_unit = 0;
        self.read_place = 0;
        self.turned_units = 0;
        self.playing = false;
        self.held = [UNKNOWN_WORD; BLOCK_WORDS];
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
            self.put(index, Symbol::low(word_ticks).0, registers);
            left -= word_ticks;
        }
        let count = self.written_units.min(self.unit_count() as u64) as usize;
        for unit in &mut self.units[..count] {
            let end_ticks = &mut unit.end_ticks;
            *end_ticks = *end_ticks - before + ticks;
        }
    }

    /// Reads the pointer. The counter must be read before it has gone round, once in 32,767 steps.
    pub(crate) fn look(&mut self, registers: &impl Registers) {
        let since = self.fetched_since(registers);
        self.fetched_words += since as u64;
        self.read_place += since;
        if self.read_place >= self.words() {
            self.read_place -= self.words();
        }
        self.fetched_of_unit += since;
        while self.fetched_of_unit >= REFILL_WORDS {
            self.fetched_of_unit -= REFILL_WORDS;
            self.fetched_units += 1;
        }
    }

    /// Returns whether the unit that is read is about to be left, and that matters: some chips may
    /// raise the threshold with the unit's last word, not behind it.
    pub(crate) fn is_leaving(&self) -> bool {
        let next = self.fetched_units + 1;
        let turn_follows = next + 1 < self.written_units && self.unit(next + 1).turn.is_some();
        self.fetched_of_unit == REFILL_WORDS - 1 && (turn_follows || !self.is_guarded())
    }

    /// Returns the words that were fetched since the last look: looks follow each other faster than
    /// a block plays.
    fn fetched_since(&self, registers: &impl Registers) -> usize {
        if !self.playing {
            return 0;
        }
        let status = registers.status(self.place.channel);
        let read = status.read_word.saturating_sub(self.place.first_word());
        // The pointer may stand on the block's end before it wraps.
        let read = if read >= self.words() { 0 } else { read };
        words_between(self.read_place, read, self.words())
    }

    /// Reads the counter and extends it to 64 bits.
    pub(crate) fn count(&mut self, registers: &impl Registers) {
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
        let oldest = self.written_units.saturating_sub(self.unit_count() as u64);
        (oldest..self.written_units)
            .map(|number| {
                let unit = self.unit(number);
                let skipped = word.saturating_sub(number * REFILL_WORDS as u64);
                let steps = unit.steps.checked_shr(skipped as u32).unwrap_or(0);
                i64::from(steps.count_ones()) * i64::from(unit.sign)
            })
            .sum()
    }

    /// Returns the steps of what is written and whose edge has not come.
    pub(crate) fn unplayed_steps(&self, registers: &impl Registers) -> i64 {
        if !self.is_playing(registers) {
            return 0;
        }
        let fetched_words = self.fetched_words + self.fetched_since(registers) as u64;
        self.steps_from(self.begun_words(fetched_words))
    }

    /// Returns whether another unit can be written, given the last look. Rests are not written far
    /// ahead: what lies in the block cannot be changed any more.
    pub(crate) fn has_room(&self, registers: &impl Registers, enough_ticks: u64) -> bool {
        let ahead = self.written_units.saturating_sub(self.fetched_units);
        if ahead < 2 {
            return true;
        }
        let most = self.unit_count() as u64 - u64::from(self.is_guarded());
        ahead < most && self.end_at() < registers.now().saturating_add(enough_ticks)
    }

    /// Returns when the last word that is written ends.
    fn end_at(&self) -> u64 {
        match self.written_units {
            0 => self.started_at,
            count => self.started_at + self.unit(count - 1).end_ticks,
        }
    }

    /// Writes a unit.
    ///
    /// The first word is written last, behind which an end marker already lies: whatever the
    /// transmitter finds, it is whole or the end.
    pub(crate) fn write(&mut self, fill: &Fill, registers: &mut impl Registers) {
        let begin_ticks = match self.written_units {
            0 => 0,
            number => self.unit(number - 1).end_ticks,
        };
        let first = self.next_slot * REFILL_WORDS;
        if self.is_guarded() {
            self.put(first + REFILL_WORDS, Symbol::END.0, registers);
        }
        // A unit never wraps.
        let in_ram = self.place.first_word() + first;
        let held = self.held.get_mut(first..);
        match held.and_then(|held| held.first_chunk_mut::<REFILL_WORDS>()) {
            // At speed an interval is mostly that of a block before.
            Some(held) => {
                for index in (0..REFILL_WORDS).rev() {
                    let word = fill.words[index].0;
                    if held[index] != word {
                        held[index] = word;
                        registers.write_word(in_ram + index, word);
                    }
                }
            }
            None => {
                for (index, word) in fill.words.iter().enumerate().rev() {
                    registers.write_word(in_ram + index, word.0);
                }
            }
        }
        self.units[self.next_slot] = Unit {
            steps: fill.step_words(),
            sign: fill.sign(),
            turn: fill.turn,
            turn_by_ticks: fill.turn_by_ticks,
            end_ticks: begin_ticks + u64::from(fill.ticks()),
        };
        self.written_units += 1;
        self.next_slot += 1;
        if self.next_slot == self.unit_count() {
            self.next_slot = 0;
        }
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
            let begins_at = self.started_at + self.unit(number - 1).end_ticks;
            let by = begins_at.saturating_add_signed(self.unit(number).turn_by_ticks.into());
            if registers.now() > by {
                return Course::Late;
            }
        }
        Course::Good
    }

    /// Puts an end marker close behind the read pointer. Returns the first word that is not played,
    /// `None` if the transmitter was quicker.
    pub(crate) fn cut(&mut self, registers: &mut impl Registers) -> Option<u64> {
        self.look(registers);
        let ahead = 1 + CUT_MARGIN_WORDS;
        let end = self.fetched_words + ahead as u64;
        self.put(self.read_place + ahead, Symbol::END.0, registers);
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
        (self.fetched_units * REFILL_WORDS as u64).min(self.written_words())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_read_pointer_tells_the_words_since_the_last_look_on_both_sides_of_the_wrap() {
        for (from, to, block, words) in [
            (0, 17, 48, 17),
            (17, 17, 48, 0),
            (30, 10, 48, 28),
            (47, 0, 48, 1),
            (0, 47, 48, 47),
            (30, 10, 240, 220),
        ] {
            assert_eq!(words_between(from, to, block), words);
        }
    }
}
