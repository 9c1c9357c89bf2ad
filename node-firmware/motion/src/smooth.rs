//! [`Curve`]: a speed that rises with the place by 3x² - 2x³, the profile of ESP-IDF's example
//! `stepper_motor` (there a table with one frequency for each step).
//!
//! ```text
//!  speed ▲                 ___      speed(s) = start + gain · x²·(3 - 2x), x = s / steps
//!        │              ╱
//!        │           ╱              time = ∫ ds / speed(s): no closed form in integers, so it is
//!        │____  ╱                   summed up by Gauss's rule, to 10⁻¹² of it
//!        └──────────────────▶ place
//! ```
//!
//! The table's n frequencies lie in the middle of their steps: half a step at the first one, n - 1
//! steps of curve, half a step at the last one. The time of that is the sum of the table's periods
//! (Euler and Maclaurin: the ends are level).

use crate::real::Real;

/// A rise of speed over a way.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Curve {
    /// Speed at its begin, steps per tick, more than 0.
    start: Real,
    /// What speed rises, steps per tick, more than 0.
    gain: Real,
    /// Over which way, steps.
    steps: Real,
    /// 1 / steps.
    inverse: Real,
    /// √(start / 3·gain), the scale of its slow begin.
    scale: Real,
}

impl Curve {
    pub(crate) fn new(start: Real, gain: Real, steps: Real) -> Self {
        Self {
            start,
            gain,
            steps,
            inverse: Real::of(1) / steps,
            scale: (start / gain).third().root(),
        }
    }

    /// Returns the same curve in units that are `ratio` times as long.
    pub(crate) fn scaled(&self, ratio: Real) -> Self {
        Self {
            start: self.start * ratio,
            gain: self.gain * ratio,
            steps: self.steps * ratio,
            inverse: self.inverse / ratio,
            scale: self.scale,
        }
    }

    /// Returns the speed where it begins, steps per tick.
    pub(crate) fn start(&self) -> Real {
        self.start
    }

    /// Returns the speed where it ends, steps per tick.
    pub(crate) fn end(&self) -> Real {
        self.start + self.gain
    }

    /// Returns its way, steps.
    pub(crate) fn steps(&self) -> Real {
        self.steps
    }

    /// Returns its greatest acceleration if it were all in the middle, steps per tick².
    pub(crate) fn accel(&self) -> Real {
        (self.start + self.gain.half()) * self.gain * self.inverse * THREE_HALVES
    }

    fn share_at(&self, place: Real) -> Real {
        (place * self.inverse).max(Real::ZERO).min(Real::of(1))
    }

    /// Returns the speed at a place, steps per tick; before and behind it that of its ends.
    pub(crate) fn speed_at(&self, place: Real) -> Real {
        self.start + self.gain * rise(self.share_at(place))
    }

    /// Returns the acceleration at a place, steps per tick².
    pub(crate) fn accel_at(&self, place: Real) -> Real {
        let x = self.share_at(place);
        let slope = x * (Real::of(1) - x) * Real::of(6) * self.inverse;
        self.gain * slope * self.speed_at(place)
    }

    /// Returns the place at which it has a speed between those of its ends, steps.
    pub(crate) fn place_of(&self, speed: Real) -> Real {
        let one = Real::of(1);
        let share = (speed - self.start) / self.gain;
        // The upper half is the lower one, turned round.
        let (share, turned) = if share > one.half() {
            (one - share, true)
        } else {
            (share, false)
        };
        let x = if share.is_none() {
            Real::ZERO
        } else {
            // 3x² - 2x³ ≥ 2x² there: Newton's method from above.
            let mut x = share.half().root().min(one.half());
            for _ in 0..SEARCH_STEPS_MAX {
                let change = (rise(x) - share) / (x * (one - x) * Real::of(6));
                x = x - change;
                if change.is_none() || change < x.shifted(-SEARCH_BITS) {
                    break;
                }
            }
            x
        };
        self.steps * if turned { one - x } else { x }
    }

    /// Returns the time from one place to another, ticks; less than 0 backwards.
    pub(crate) fn ticks_between(&self, from: Real, to: Real) -> Real {
        if to < from {
            return -self.ticks_between(to, from);
        }
        let (mut x, end) = (self.share_at(from), self.share_at(to));
        let mut sum = Real::ZERO;
        while x < end {
            // Short enough for the poles of 1 / speed, which lie at ± i·scale and beyond 3/2.
            let step = (x + self.scale).third().min(Real::of(1).shifted(-3));
            let next = if x + step < end { x + step } else { end };
            sum = sum + self.ticks_of(x, next);
            x = next;
        }
        sum * self.steps
    }

    /// ∫ dx / speed by Gauss's rule with six points.
    fn ticks_of(&self, from: Real, to: Real) -> Real {
        let (middle, half) = ((from + to).half(), (to - from).half());
        let one_over = |x: Real| Real::of(1) / (self.start + self.gain * rise(x));
        let mut sum = Real::ZERO;
        for [place, weight] in POINTS {
            let away = half * place;
            sum = sum + (one_over(middle - away) + one_over(middle + away)) * weight;
        }
        sum * half
    }

    /// Returns the way from `begin` that is made in this time, at most `way`; less than a step's
    /// 2⁻³⁰ off.
    pub(crate) fn way_in(&self, begin: Real, way: Real, ticks: Real) -> Real {
        let (mut low, mut high) = (Real::ZERO, way);
        let mut made = (self.speed_at(begin) * ticks).min(way);
        for _ in 0..SEARCH_STEPS_MAX {
            let error = self.ticks_between(begin, begin + made) - ticks;
            if error.is_negative() {
                low = made;
            } else {
                high = made;
            }
            let mut next = made - error * self.speed_at(begin + made);
            if next < low || next > high {
                next = (low + high).half();
            }
            let change = (next - made).abs();
            made = next;
            if change.fixed(SEARCH_BITS) == 0 {
                break;
            }
        }
        made
    }
}

/// 3x² - 2x³.
fn rise(x: Real) -> Real {
    x.squared() * (Real::of(3) - x.twice())
}

const THREE_HALVES: Real = Real::of(3).shifted(-1);

/// A search ends when it moves by less than 2⁻³⁰.
const SEARCH_BITS: i32 = 30;

/// Bisection alone would need this many.
const SEARCH_STEPS_MAX: usize = 80;

/// Places and weights of Gauss's rule (Abramowitz and Stegun, table 25.4), 2⁻⁶⁰.
const POINTS: [[Real; 2]; 3] = [
    [
        Real::of(1_075_064_155_315_113_702).shifted(-60),
        Real::of(197_523_691_529_797_362).shifted(-60),
    ],
    [
        Real::of(762_322_520_704_855_845).shifted(-60),
        Real::of(415_929_775_602_992_897).shifted(-60),
    ],
    [
        Real::of(275_109_191_047_100_580).shifted(-60),
        Real::of(539_468_037_474_056_715).shifted(-60),
    ],
];

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{law::speed_from_hz, limits::TICK_HZ};

    fn of_hz(start: u32, end: u32, steps: u64) -> Curve {
        let (start, end) = (speed_from_hz(start), speed_from_hz(end));
        Curve::new(start, end - start, Real::of(steps))
    }

    #[test]
    fn the_time_is_that_of_a_fine_sum_also_from_nearly_rest() {
        for (start, end, steps) in [(500, 1_500, 499), (1, 200_000, 20_000), (1_000, 1_001, 1)] {
            let curve = of_hz(start, end, steps);
            let ticks = curve.ticks_between(Real::ZERO, Real::of(steps));
            // Simpson's rule on x = y³, which makes the slow begin as wide as the rest.
            let parts = 200_000;
            let value = |part: u32| {
                let y = f64::from(part) / f64::from(parts);
                let x = y.powi(3);
                let speed = f64::from(start) + f64::from(end - start) * x * x * (3.0 - 2.0 * x);
                3.0 * y * y / speed
            };
            let mut sum = value(0) + value(parts);
            for part in 1..parts {
                sum += value(part) * if part % 2 == 1 { 4.0 } else { 2.0 };
            }
            let expected = sum / 3.0 / f64::from(parts) * steps as f64 * TICK_HZ as f64;
            let found = ticks.fixed(20) as f64 / f64::from(1 << 20);
            let error = (found / expected - 1.0).abs();
            assert!(error < 1e-10, "{start} to {end}: {found}, not {expected}");
        }
    }

    #[test]
    fn places_speeds_and_times_are_each_others_inverse() {
        let curve = of_hz(50, 40_000, 3_000);
        let end = Real::of(3_000);
        let all = curve.ticks_between(Real::ZERO, end);
        for part in 0..=100 {
            let place = Real::of(30 * part);
            let close = |found: Real, bits: i32, what: &str| {
                let error = (found - place).abs();
                assert!(
                    error.shifted(bits).fixed(0) == 0,
                    "{what} of {part}: {found:?}"
                );
            };
            // Where the curve is level, a speed says less of its place.
            close(curve.place_of(curve.speed_at(place)), 16, "speed");
            let ticks = curve.ticks_between(Real::ZERO, place);
            close(curve.way_in(Real::ZERO, end, ticks), 20, "time");
            let rest = curve.ticks_between(end, place);
            let error = (ticks - rest - all).abs();
            assert!(error.shifted(10).fixed(0) == 0, "the parts make the whole");
        }
    }
}
