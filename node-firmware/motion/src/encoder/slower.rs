//! The arithmetic of a controlled stop: v² falls by 2a with each step, the interval is 2 / (v₀ + v₁).
//! All of it without a division of more than 32 bits, which the chip does not have.
//!
//! v² itself is kept, exact to a mHz²: the roots are rounded down, and thousands of steps that each
//! began with a rounded one would add up to a harder stop.

use super::{Brake, Encoder, Out, Turn, run::step_word};
use crate::{
    limits::{LOW_WORD_TICKS_MAX, PART_TICKS_MIN, TICK_HZ, WORD_TICKS_MIN},
    segment::{FRACTION_BITS, SegmentRing},
    symbol::Symbol,
};

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

    /// Returns whether the brake has to be taken before anything else is written.
    #[inline]
    pub(super) fn brakes_now(&self, out: &Out) -> bool {
        let now = self.encoded_ticks + u64::from(out.facts.ticks);
        let brake = self.brake.as_ref();
        brake.is_some_and(|brake| now >= brake.from_ticks)
    }

    /// Returns whether the brake may have to be taken within so many steps of the present segment.
    #[inline]
    pub(super) fn brakes_within(&self, out: &Out) -> bool {
        self.brake.as_ref().is_some_and(|brake| {
            let count = out.left() as i64;
            let longest = self.interval.max(self.interval + self.change * count);
            let ticks = (longest >> FRACTION_BITS).max(0) as u64 * count as u64;
            let now = self.encoded_ticks + u64::from(out.facts.ticks);
            now + ticks >= brake.from_ticks
        })
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
    pub(super) fn slower_step(&mut self, speed_mhz: u64, out: &mut Out) {
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
    pub(super) fn slower_run(&mut self, speed_mhz: u64, out: &mut Out) -> bool {
        let in_word = self.low_word_ticks.max(self.timing.low_ticks_min);
        let most_ticks = (in_word + self.timing.high_ticks_min).min(LOW_WORD_TICKS_MAX) as u32;
        let lost = self.lost_speed();
        let before = out.count;
        let Ok(mut speed) = u32::try_from(speed_mhz) else {
            return false;
        };
        let mut last = Symbol::END;
        let mut trend = self.trend;
        let mut square = self.stopping_square;
        let timing = &self.timing;
        let high_max = timing.high_ticks as u32;
        let (low_min, high_min) = (timing.low_ticks_min as u32, timing.high_ticks_min as u32);
        while out.left() > 0 && self.stopping_steps_max > 0 {
            if !is_quick(speed, lost) {
                break;
            }
            let left = square - lost;
            let (slower, interval) = trend.next(speed, left, lost);
            if interval > most_ticks {
                break;
            }
            square = left;
            last = step_word(interval, high_max, low_min, high_min);
            out.push_step(last);
            self.stopping_steps_max -= 1;
            speed = slower;
        }
        if out.count == before {
            return false;
        }
        self.trend = trend;
        self.stopping_mhz = Some(u64::from(speed));
        self.stopping_square = square;
        self.low_ticks_since_step = last.second().0;
        self.resting = false;
        true
    }
}

/// Twice the ticks of a second, in 1/1000: divided by the sum of two speeds in mHz it gives ticks.
const TWICE: u64 = 2_000 * TICK_HZ;

/// Returns the speed behind a step that leaves `square` (mHz²) of the speed's square, `lost` less
/// than before; and the step's interval, ticks.
fn slower_step(speed_mhz: u64, square: u64, lost: u64) -> (u64, u64) {
    match u32::try_from(speed_mhz) {
        Ok(speed) if is_quick(speed, lost) => {
            let (slower, interval) = slower(speed, square, lost);
            (u64::from(slower), u64::from(interval))
        }
        _ => {
            let slower = root(square);
            (slower, quotient(TWICE, speed_mhz + slower))
        }
    }
}

/// Returns whether [`slower`] can compute a step.
fn is_quick(speed: u32, lost: u64) -> bool {
    let square = u64::from(speed) * u64::from(speed);
    speed >= SLOWER_MHZ_MIN && lost <= square >> SLOWER_BITS
}

/// Returns ⌊√square⌋, digit by digit: for the last few slow steps.
fn root(mut square: u64) -> u64 {
    let mut root = 0;
    // The highest power of four that is not above it.
    let mut bit = 1_u64 << ((63 - (square | 1).leading_zeros()) & !1);
    while bit != 0 {
        if square >= root + bit {
            square -= root + bit;
            root = (root >> 1) + bit;
        } else {
            root >>= 1;
        }
        bit >>= 2;
    }
    root
}

/// Returns ⌊dividend / divisor⌋, digit by digit; the divisor is not 0.
fn quotient(mut dividend: u64, divisor: u64) -> u64 {
    let places = divisor
        .leading_zeros()
        .saturating_sub(dividend.leading_zeros());
    let mut quotient = 0;
    for place in (0..=places).rev() {
        quotient <<= 1;
        if dividend >= divisor << place {
            dividend -= divisor << place;
            quotient |= 1;
        }
    }
    quotient
}

/// A step is quick to compute while it loses less than 2⁻¹⁰ of the speed's square.
const SLOWER_BITS: u32 = 10;

/// Slower than 2 kHz its numbers need more than 64 bits, and a step more than a word.
const SLOWER_MHZ_MIN: u32 = 1 << 21;

/// Returns ⌊√square⌋ and ⌊2000 · ticks of a second / the sum of both speeds⌋, without a division of
/// more than 32 bits: both are near to what the speed's reciprocal gives. Speeds in mHz, from
/// [`SLOWER_MHZ_MIN`]; `square` is `lost` less than the speed's, whose root may be rounded down.
fn slower(speed: u32, square: u64, lost: u64) -> (u32, u32) {
    let shift = speed.leading_zeros();
    let divisor = u64::from(speed << shift);
    let short = u64::from(u32::MAX / (divisor >> 16) as u32);
    let error = (1 << 48) - (divisor * short) as i64;
    // ≤ 2⁶³ / divisor, by less than 2⁻²⁸ of it.
    let inverse = ((short << 15) as i64 + ((error * short as i64) >> 33)) as u64;
    let inverse = inverse.min(u64::from(u32::MAX));
    // √(v² - l) = v - l/2v - (l/2v)²/2v …
    let over_twice = |value: u64| (((value << shift) >> 32) * inverse) >> 32;
    let first = over_twice(lost);
    let mut slower = u64::from(speed) - first - over_twice(first * first);
    while slower * slower > square {
        slower -= 1;
    }
    while (slower + 1) * (slower + 1) <= square {
        slower += 1;
    }
    let sum = u64::from(speed) + slower;
    let mut interval = (((TWICE << shift) >> 16) * inverse) >> 48;
    while (interval + 1) * sum <= TWICE {
        interval += 1;
    }
    while interval * sum > TWICE {
        interval -= 1;
    }
    (slower as u32, interval as u32)
}

/// How speed and interval went on in the steps before: what they foretell is exact or next to it,
/// and a fifth of the work of [`slower`].
#[derive(Clone, Copy, Debug)]
pub(super) struct Trend {
    /// Steps that it has seen, up to 2: enough for a trend.
    seen: u8,
    /// What the last step lost of the speed, mHz, and by how much that was more than before.
    loss: u32,
    growth: u32,
    /// The last interval, ticks, and by how much it was longer than the one before.
    interval: u32,
    longer: u32,
}

/// A foretold value that is farther off is computed instead.
const TREND_MISS_MAX: u32 = 4;

impl Trend {
    pub(super) const NONE: Self = Self {
        seen: 0,
        loss: 0,
        growth: 0,
        interval: 0,
        longer: 0,
    };

    /// Returns the same as [`slower`]: what is foretold is put right.
    fn next(&mut self, speed: u32, square: u64, lost: u64) -> (u32, u32) {
        let foretold = match self.seen {
            2 => self.foretell(speed, square),
            _ => None,
        };
        let (slower, interval) = foretold.unwrap_or_else(|| slower(speed, square, lost));
        let loss = speed - slower;
        self.growth = loss.saturating_sub(self.loss);
        self.longer = interval.saturating_sub(self.interval);
        (self.loss, self.interval) = (loss, interval);
        self.seen = 2.min(self.seen + 1);
        (slower, interval)
    }

    #[inline(always)]
    fn foretell(&self, speed: u32, square: u64) -> Option<(u32, u32)> {
        let mut slower = speed.checked_sub(self.loss + self.growth)?;
        let mut misses = 0;
        while u64::from(slower) * u64::from(slower) > square {
            slower -= 1;
            misses += 1;
            if misses > TREND_MISS_MAX {
                return None;
            }
        }
        while u64::from(slower + 1) * u64::from(slower + 1) <= square {
            slower += 1;
            misses += 1;
            if misses > TREND_MISS_MAX {
                return None;
            }
        }
        // Both below 2³¹: faster than 2 MHz nothing is.
        let sum = speed.checked_add(slower)?;
        let mut interval = self.interval + self.longer;
        let product = |interval: u32| u64::from(interval) * u64::from(sum);
        while product(interval) > TWICE {
            interval -= 1;
            misses += 1;
            if misses > TREND_MISS_MAX {
                return None;
            }
        }
        while product(interval + 1) <= TWICE {
            interval += 1;
            misses += 1;
            if misses > TREND_MISS_MAX {
                return None;
            }
        }
        Some((slower, interval))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_trend_tells_what_each_step_alone_would_tell() {
        let mut state = 5_u64;
        for case in 0..3_000_u32 {
            state = state
                .wrapping_mul(6_364_136_223_846_793_005)
                .wrapping_add(1_442_695_040_888_963_407);
            let mut speed = ((state >> 20) as u32 >> (case % 11)) | SLOWER_MHZ_MIN;
            let mut square = u64::from(speed) * u64::from(speed);
            let lost = (square >> SLOWER_BITS >> (case % 23)).max(1);
            let mut trend = Trend::NONE;
            for _ in 0..200 {
                if !is_quick(speed, lost) {
                    break;
                }
                square -= lost;
                let step = trend.next(speed, square, lost);
                assert_eq!(step, slower(speed, square, lost), "{speed} {lost}");
                assert_eq!(u64::from(step.0), square.isqrt(), "{speed} {lost}");
                speed = step.0;
            }
        }
    }

    #[test]
    fn a_controlled_stop_has_its_speeds_and_intervals_to_the_last_unit() {
        let mut state = 4_u64;
        let mut next = |bits: u64| {
            state = state
                .wrapping_mul(6_364_136_223_846_793_005)
                .wrapping_add(1_442_695_040_888_963_407);
            (state >> 20) & ((1 << bits) - 1)
        };
        for case in 0..1_000_000 {
            let speed = (next(21 + case % 12) as u32) | SLOWER_MHZ_MIN;
            let square = u64::from(speed) * u64::from(speed);
            let lost = match case % 4 {
                0 => square >> SLOWER_BITS,
                1 => 2_000_000 * next(1 + case % 31),
                _ => next(1 + case % 52),
            };
            let lost = lost.min(square >> SLOWER_BITS);
            // The speed is the root of its square, rounded down.
            let square = square + next(32) % (2 * u64::from(speed) + 1);
            let root = (square - lost).isqrt();
            let interval = 2_000 * TICK_HZ / (u64::from(speed) + root);
            let found = slower(speed, square - lost, lost);
            assert_eq!(found, (root as u32, interval as u32), "{speed} {lost}");
            let found = slower_step(u64::from(speed), square - lost, lost);
            assert_eq!(found, (root, interval), "{speed} {lost}");
        }
    }

    #[test]
    fn slow_and_hard_stops_have_their_speeds_and_intervals_to_the_last_unit() {
        let mut state = 9_u64;
        for case in 0..200_000_u32 {
            state = state
                .wrapping_mul(6_364_136_223_846_793_005)
                .wrapping_add(1_442_695_040_888_963_407);
            let speed = 1 + ((state >> 20) & ((1 << (case % 31)) - 1));
            let square = speed * speed;
            let lost = match case % 3 {
                0 => square,
                1 => square - square / 3,
                _ => (state >> 7) % (square + 1),
            };
            let slower = (square - lost).isqrt();
            let interval = TWICE / (speed + slower);
            let found = slower_step(speed, square - lost, lost);
            assert_eq!(found, (slower, interval), "{speed} {lost}");
        }
    }
}
