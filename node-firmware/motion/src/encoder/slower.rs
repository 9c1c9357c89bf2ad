//! A controlled stop: v² falls by 2a with each step, the interval is 2 / (v₀ + v₁).
//! Its arithmetic is that of `trend.rs`.

use super::{
    Brake, Encoder, Out, Turn,
    run::step_word,
    trend::{Trend, quick_mhz_min, quotient, slower_step},
};
use crate::limits::{LOW_WORD_TICKS_MAX, PART_TICKS_MIN, TICK_HZ, WORD_TICKS_MIN};

impl Encoder {
    /// Leaves the plan and slows down, no farther than the plan would have gone: `steps_ahead` is
    /// what it had behind the present segment. The ring must be cleared by the caller.
    pub(crate) fn decelerate(&mut self, goes_on: bool, steps_ahead: u64) {
        if self.stopping_mhz.is_some() {
            return;
        }
        let speed_mhz = self.moving_mhz(goes_on);
        if speed_mhz * speed_mhz < self.lost_speed() {
            // No step follows, so nobody need wait for its time: that may be an hour.
            self.low_ticks = 0;
        }
        self.stopping_steps_max = u64::from(self.steps_left) + steps_ahead;
        self.steps_left = 0;
        self.turn = Turn::None;
        self.stopping_mhz = Some(speed_mhz);
        self.trend = Trend::NONE;
        self.quick_mhz_min = quick_mhz_min(self.lost_speed());
    }

    /// Returns how many steps [`Encoder::decelerate`] would make from here, or still will. It
    /// computes with whole mHz, rounded down, and may make a few in ten thousand less.
    pub(crate) fn steps_to_rest(&self, goes_on: bool, steps_ahead: u64) -> u64 {
        let (speed_mhz, most) = match self.stopping_mhz {
            Some(speed_mhz) => (speed_mhz, self.stopping_steps_max),
            None => (
                self.moving_mhz(goes_on),
                u64::from(self.steps_left) + steps_ahead,
            ),
        };
        (speed_mhz * speed_mhz / self.lost_speed()).min(most)
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

    /// Takes how to slow down if the plan ends in full run; `None`: it ends where it shall.
    pub(crate) fn set_brake(&mut self, brake: Option<Brake>) {
        self.brake = brake;
    }

    /// Returns whether the plan has ended in full run.
    pub(crate) fn is_starved(&self) -> bool {
        self.starved
    }

    /// The plan has ended: slows down if it was in full run. Returns whether it was.
    pub(super) fn starve(&mut self) -> bool {
        let Some(brake) = self.brake.take() else {
            return false;
        };
        if self.resting || self.interval_ticks == 0 || brake.steps_max == 0 {
            return false;
        }
        // The last edge before a corner may be followed by a part of its interval only: what is
        // written ends with the line. The rest of it, by the interval before.
        let interval_ticks = self.interval_ticks.max(self.speed_ticks);
        let wait_ticks = interval_ticks - self.interval_ticks;
        if wait_ticks >= WORD_TICKS_MIN {
            self.low_ticks = wait_ticks;
        }
        self.starved = true;
        self.stop_accel_hz_per_s = Some(brake.accel_hz_per_s);
        self.stopping_steps_max = brake.steps_max;
        // In the refill interrupt: not by the chip's division of 64 bits.
        self.stopping_mhz = Some(quotient(1_000 * TICK_HZ, interval_ticks));
        self.trend = Trend::NONE;
        self.quick_mhz_min = quick_mhz_min(self.lost_speed());
        true
    }

    /// Returns what the square of the speed loses in a step of a controlled stop: 2a, mHz².
    pub(super) fn lost_speed(&self) -> u64 {
        let accel_hz_per_s = self.stop_accel_hz_per_s;
        2_000_000 * u64::from(accel_hz_per_s.unwrap_or(self.timing.stop_accel_hz_per_s))
    }

    /// Writes a step of a controlled stop, or the end.
    pub(super) fn slower_step(&mut self, speed_mhz: u64, out: &mut Out<'_>) {
        let lost = self.lost_speed();
        let left = (speed_mhz * speed_mhz).checked_sub(lost);
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
        let timing = &self.timing;
        let high_max = timing.high_ticks as u32;
        let (low_min, high_min) = (timing.low_ticks_min as u32, timing.high_ticks_min as u32);
        let words = &mut out.fill.words[out.count..][..most];
        let word = |interval| step_word(interval, high_max, low_min, high_min);
        let limits = (lost, self.quick_mhz_min, most_ticks);
        let (made, ticks) = trend.run(&mut speed, limits, words, word);
        if made == 0 {
            return false;
        }
        self.low_ticks_since_step = words[made - 1].second().0;
        self.resting = false;
        self.trend = trend;
        self.stopping_mhz = Some(u64::from(speed));
        self.stopping_steps_max -= made as u64;
        out.fill.step_words |= ((1 << made) - 1) << out.count;
        out.facts.has_steps = true;
        out.facts.ticks += ticks;
        out.count += made;
        true
    }
}
