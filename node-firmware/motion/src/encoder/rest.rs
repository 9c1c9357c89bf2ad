//! Rests: what is owed behind a step, what is planned, and what surrounds a turn.

use super::{Encoder, Out, Turn};
use crate::{
    limits::{
        LOW_WORD_TICKS_MAX, PART_BEFORE_END_TICKS_MIN, REFILL_WORDS, REST_HALF_TICKS_MIN,
        WORD_TICKS_MIN,
    },
    segment::{Segment, SegmentRing},
    symbol::Symbol,
};

impl Encoder {
    /// Writes some of the rest that is owed.
    pub(super) fn rest(&mut self, segments: &mut SegmentRing, out: &mut Out<'_>) {
        let between_steps = self.steps_left > 0 || self.stopping_mhz.is_some();
        if !between_steps {
            while let Some(Segment::Low { ticks }) = segments.peek() {
                segments.pop();
                self.low_ticks += ticks;
                self.resting = true;
            }
            if matches!(segments.peek(), Some(Segment::Turn { .. })) && self.turn == Turn::None {
                self.begin_turn(segments, out);
                if out.left() == 0 || self.turn != Turn::None {
                    return;
                }
            }
        }
        // The last of a rest stays unwritten as long as possible: a turn may still be planned
        // behind it.
        let window_ticks = self.timing.window_ticks();
        let word_ticks = if self.low_ticks > window_ticks + WORD_TICKS_MIN {
            (self.low_ticks - window_ticks).min(self.low_word_ticks)
        } else {
            self.low_ticks.min(self.low_word_ticks)
        };
        self.write_low(word_ticks, out);
        // The same for all that is longer.
        let symbol = Symbol::low(self.low_word_ticks);
        while out.left() > 0 && self.low_ticks >= window_ticks + self.low_word_ticks {
            out.push(symbol);
            self.low_ticks -= self.low_word_ticks;
            self.low_ticks_since_step = self
                .low_ticks_since_step
                .saturating_add(self.low_word_ticks);
        }
    }

    /// Writes one word of rest of about this length.
    fn write_low(&mut self, word_ticks: u64, out: &mut Out<'_>) {
        let left = self.low_ticks.saturating_sub(word_ticks);
        let word_ticks = if left > 0 && left < WORD_TICKS_MIN {
            (word_ticks - WORD_TICKS_MIN).max(WORD_TICKS_MIN)
        } else {
            word_ticks
        };
        out.push(Symbol::low(word_ticks));
        self.low_ticks = self.low_ticks.saturating_sub(word_ticks);
        self.low_ticks_since_step = self.low_ticks_since_step.saturating_add(word_ticks);
    }

    /// The next segment is a turn: at once if nothing is left to step, by a window otherwise.
    pub(super) fn begin_turn(&mut self, segments: &mut SegmentRing, out: &mut Out<'_>) {
        let margin_ticks = self.timing.turn_ticks();
        let rests = !self.half_before.has_steps
            && !out.facts.has_steps
            && u64::from(self.half_before.ticks) >= margin_ticks
            && self.low_ticks_since_step >= self.timing.hold_ticks;
        if rests && out.fill.turn.is_none() {
            if let Some(Segment::Turn { direction }) = segments.pop() {
                self.direction = Some(direction);
                out.fill.turn = Some(direction);
            }
            return;
        }
        self.turn = Turn::Filling;
        let held = self.low_ticks_since_step >= self.timing.hold_ticks;
        if out.count == 0 && held {
            return;
        }
        let missing = |encoder: &Self| {
            let hold_ticks = encoder.timing.hold_ticks;
            hold_ticks.saturating_sub(encoder.low_ticks_since_step)
        };
        // While this half plays the window is written: it lasts long enough for that if there is more
        // rest than the turn needs.
        let needed = margin_ticks + missing(self);
        let spare = self.low_ticks.saturating_sub(needed);
        let spare = spare.min(REST_HALF_TICKS_MIN) as u32;
        let each = u64::from(spare / out.left().max(1) as u32).max(WORD_TICKS_MIN);
        while out.left() > 0 {
            let word_ticks = missing(self).max(each).min(LOW_WORD_TICKS_MAX);
            self.write_low(word_ticks, out);
        }
    }

    /// Writes the half block of rest in which the pin is switched.
    pub(super) fn window(&mut self, out: &mut Out<'_>) {
        let least = self.timing.turn_ticks();
        let most = REFILL_WORDS as u64 * LOW_WORD_TICKS_MAX / 2;
        debug_assert!(self.low_ticks >= least, "the planner leaves the window");
        self.low_ticks = self.low_ticks.max(least);
        let left = self.low_ticks.saturating_sub(most);
        let ticks = if left > 0 && left < WORD_TICKS_MIN {
            most - WORD_TICKS_MIN
        } else {
            self.low_ticks.min(most)
        };
        self.spread(out, ticks);
        self.turn = Turn::Due;
    }

    /// Writes a whole half block of rest that lasts this long.
    pub(super) fn spread(&mut self, out: &mut Out, ticks: u64) {
        let mut left = u32::try_from(ticks).expect("half a block of words");
        while out.left() > 0 {
            let word_ticks = left / out.left() as u32;
            out.push(Symbol::low(u64::from(word_ticks)));
            left -= word_ticks;
        }
        self.low_ticks -= ticks;
        self.low_ticks_since_step = self.low_ticks_since_step.saturating_add(ticks);
    }

    /// Writes the end marker, after the rest that a turn of the next start relies on.
    pub(super) fn end(&mut self, out: &mut Out<'_>) {
        let missing = self
            .timing
            .hold_ticks
            .saturating_sub(self.low_ticks_since_step);
        if missing > 0 {
            self.low_ticks = missing.max(WORD_TICKS_MIN);
            self.write_low(self.low_ticks.min(LOW_WORD_TICKS_MAX), out);
            return;
        }
        let last_part_ticks = match out.count {
            0 => u64::from(self.last_part_ticks),
            count => out.fill.words[count - 1].second().0,
        };
        if last_part_ticks < PART_BEFORE_END_TICKS_MIN {
            let word = Symbol::low(2 * PART_BEFORE_END_TICKS_MIN);
            out.push(word);
            self.low_ticks_since_step = self.low_ticks_since_step.saturating_add(word.ticks());
            return;
        }
        out.push(Symbol::END);
        self.ended = true;
    }
}
