//! A controlled stop: v² falls by 2a with each step, the interval is 2 / (v₀ + v₁).
//! Its arithmetic is that of `trend.rs`.
//!
//! v² itself is kept, exact to a mHz²: the roots are rounded down, and thousands of steps that each
//! began with a rounded one would add up to a harder stop.

use super::{
    Brake, Encoder, Out, Turn,
    run::step_word,
    trend::{Trend, quick_mhz_min, quotient, slower_step},
};
use crate::{
    limits::{LOW_WORD_TICKS_MAX, PART_TICKS_MIN, TICK_HZ, WORD_TICKS_MIN},
    segment::{FRACTION_BITS, SegmentRing},
};

/// Longest step of a run, ticks, and as much again.
const RUN_STEP_TICKS_MAX: u32 = 2 * LOW_WORD_TICKS_MAX as u32;

impl Encoder {
    /// Leaves the plan and slows down, no farther than the plan would have gone: `steps_ahead` is
    /// what it had behind the present segment. The ring must be cleared by the caller.
    pub(crate) fn decelerate(&mut self, goes_on: bool, steps_ahead: u64) {
        if self.stopping_mhz.is_some() {
            return;
        }
        self.brake = None;
        let speed_mhz = self.moving_mhz(goes_on);
        if speed_mhz * speed_mhz < self.lost_speed() {
            // No step follows, so nobody need wait for its time: that may be an hour.
            self.low_ticks = 0;
        }
        self.stopping_steps_max = u64::from(self.steps_left) + steps_ahead;
        self.steps_left = 0;
        self.turn = Turn::None;
        self.begin_slower(speed_mhz);
    }

    fn begin_slower(&mut self, speed_mhz: u64) {
        self.stopping_mhz = Some(speed_mhz);
        self.stopping_square = speed_mhz * speed_mhz;
        self.trend = Trend::NONE;
        self.quick_mhz_min = quick_mhz_min(self.lost_speed());
    }

    /// Returns how many steps [`Encoder::decelerate`] would make from here, or still will. It
    /// computes with whole mHz, rounded down, and may make a few in ten thousand less.
    pub(crate) fn steps_to_rest(&self, goes_on: bool, steps_ahead: u64) -> u64 {
        let (square, most) = match self.stopping_mhz {
            Some(_) => (self.stopping_square, self.stopping_steps_max),
            None => {
                let speed_mhz = self.moving_mhz(goes_on);
                let most = u64::from(self.steps_left) + steps_ahead;
                (speed_mhz * speed_mhz, most)
            }
        };
        (square / self.lost_speed()).min(most)
    }

    /// Returns the speed that a controlled stop begins with, mHz.
    fn moving_mhz(&self, goes_on: bool) -> u64 {
        let moves = self.steps_left > 0 || (goes_on && !self.resting);
        if moves && self.interval_ticks > 0 {
            1_000 * TICK_HZ / self.interval_ticks
        } else {
            0
        }
    }

    /// Takes how to slow down if the planner does not come back in time; `None`: the plan ends where
    /// it shall.
    pub(crate) fn set_brake(&mut self, brake: Option<Brake>) {
        self.brake = brake;
    }

    /// Returns whether there is a brake.
    pub(crate) fn has_brake(&self) -> bool {
        self.brake.is_some()
    }

    /// Returns whether it brakes by itself at a time that is set.
    pub(crate) fn brakes_in_time(&self) -> bool {
        let from_ticks = self.brake.map(|brake| brake.from_ticks);
        from_ticks.is_some_and(|from_ticks| from_ticks < u64::MAX)
    }

    /// Returns whether the brake was taken: the planner did not come back in time.
    pub(crate) fn is_starved(&self) -> bool {
        self.starved
    }

    /// Returns when the brake has to be taken, ticks since what is encoded so far; the greatest number:
    /// not soon, or where what is written ends.
    pub(super) fn brake_at(&self) -> u32 {
        let from_ticks = self
            .brake
            .as_ref()
            .map_or(u64::MAX, |brake| brake.from_ticks);
        let ahead_ticks = from_ticks.saturating_sub(self.encoded_ticks);
        u32::try_from(ahead_ticks).unwrap_or(u32::MAX)
    }

    /// Returns whether the brake may have to be taken within the steps of the present segment that there
    /// is room for.
    #[inline]
    pub(super) fn brakes_within(&self, brake_at: u32, out: &Out<'_>) -> bool {
        let now = out.facts.ticks;
        // A step of a run takes one word: mostly that is all there is to ask.
        if brake_at - now > out.left() as u32 * RUN_STEP_TICKS_MAX {
            return false;
        }
        let count = out.left() as i64;
        let longest = self.interval.max(self.interval + self.change * count);
        let ticks = (longest >> FRACTION_BITS).max(0) as u64 * count as u64;
        u64::from(now) + ticks >= u64::from(brake_at)
    }

    /// Takes the brake, if there is one: leaves what is still written of the plan and slows down from
    /// the next edge on, or rests where it does not move. Returns whether it slows down.
    pub(crate) fn brake(&mut self, segments: &mut SegmentRing) -> bool {
        let Some(brake) = self.brake.take() else {
            return false;
        };
        // What is not written comes behind what is, unless that ends with a rest or turns.
        let mut steps_max = u64::from(self.steps_left) + segments.steps_ahead();
        if segments.are_steps() {
            steps_max = steps_max.saturating_add(brake.steps_max);
        }
        let left_out = self.steps_left > 0 || segments.front().is_some();
        segments.clear();
        self.steps_left = 0;
        self.turn = Turn::None;
        if self.resting || self.interval_ticks == 0 || steps_max == 0 {
            if left_out {
                self.starved = true;
                self.low_ticks = 0;
            }
            return false;
        }
        // The last edge before a corner may be followed by a part of its interval only: what is
        // written ends with the line. The rest of it, by the interval before.
        let interval_ticks = self.interval_ticks.max(self.speed_ticks);
        let wait_ticks = interval_ticks - self.interval_ticks;
        if wait_ticks >= WORD_TICKS_MIN {
            self.low_ticks += wait_ticks;
        }
        self.starved = true;
        self.stop_lost = Some(brake.lost);
        self.stopping_steps_max = steps_max;
        let speed_mhz = self.speed_by(interval_ticks);
        self.begin_slower(speed_mhz);
        if self.stopping_square < brake.lost {
            // No step follows, so nobody need wait for its time.
            self.low_ticks = 0;
        }
        true
    }

    /// Returns the speed of an interval, mHz: by the present segment's fractions of a tick, if it is
    /// one of that. In the refill interrupt: not by the chip's division of 64 bits.
    fn speed_by(&self, interval_ticks: u64) -> u64 {
        let whole = interval_ticks << FRACTION_BITS;
        let exact = u64::try_from(self.interval).unwrap_or(0);
        let is_own = exact.abs_diff(whole) <= 2 << FRACTION_BITS;
        let interval = if is_own { exact } else { whole };
        quotient((1_000 * TICK_HZ) << FRACTION_BITS, interval)
    }

    /// Returns what the square of the speed loses in a step of a controlled stop: 2a, mHz².
    pub(super) fn lost_speed(&self) -> u64 {
        let own = 2_000_000 * u64::from(self.timing.stop_accel_hz_per_s);
        self.stop_lost.unwrap_or(own)
    }

    /// Writes a step of a controlled stop, or the end.
    pub(super) fn slower_step(&mut self, speed_mhz: u64, out: &mut Out<'_>) {
        let lost = self.lost_speed();
        let left = self.stopping_square.checked_sub(lost);
        let Some(square) = left.filter(|_| self.stopping_steps_max > 0) else {
            self.stopping_mhz = Some(0);
            self.end(out);
            return;
        };
        self.stopping_steps_max -= 1;
        self.trend = Trend::NONE;
        let (slower_mhz, interval_ticks) = slower_step(speed_mhz, square, lost);
        let high_ticks = self.timing.high_of(interval_ticks);
        self.stopping_mhz = Some(slower_mhz);
        self.stopping_square = square;
        self.write_step(
            high_ticks,
            interval_ticks - high_ticks,
            LOW_WORD_TICKS_MAX
                .saturating_sub(high_ticks)
                .max(PART_TICKS_MIN),
            out,
        );
    }

    /// Writes steps of a controlled stop, as many as there is room for: those that need one word
    /// each and lose little speed. Returns whether there were any.
    pub(super) fn slower_run(&mut self, speed_mhz: u64, out: &mut Out<'_>) -> bool {
        let in_word = self.low_word_ticks.max(self.timing.low_ticks_min);
        let most_ticks = (in_word + self.timing.high_ticks_min).min(LOW_WORD_TICKS_MAX) as u32;
        let lost = self.lost_speed();
        let Ok(mut speed) = u32::try_from(speed_mhz) else {
            return false;
        };
        let most = out.left();
        let most = usize::try_from(self.stopping_steps_max).map_or(most, |steps| most.min(steps));
        let mut trend = self.trend;
        let mut square = self.stopping_square;
        let timing = &self.timing;
        let high_max = timing.high_ticks as u32;
        let (low_min, high_min) = (timing.low_ticks_min as u32, timing.high_ticks_min as u32);
        let words = &mut out.fill.words[out.count..][..most];
        let word = |interval| step_word(interval, high_max, low_min, high_min);
        let limits = (lost, self.quick_mhz_min, most_ticks);
        let (made, ticks) = trend.run((&mut speed, &mut square), limits, words, word);
        if made == 0 {
            return false;
        }
        self.low_ticks_since_step = words[made - 1].second().0;
        self.resting = false;
        self.trend = trend;
        self.stopping_mhz = Some(u64::from(speed));
        self.stopping_square = square;
        self.stopping_steps_max -= made as u64;
        out.fill.step_words |= ((1 << made) - 1) << out.count;
        out.facts.has_steps = true;
        out.facts.ticks += ticks;
        out.count += made;
        true
    }
}
