//! [`Law`]: how a move gains speed. One rise from a lower to a higher speed is all it gives: a way
//! down is the same rise, read backwards.
//!
//! | shape | from rest (t = time, s = way) | source |
//! |---|---|---|
//! | constant | v = a·t | textbook |
//! | linear | s ≤ s_h: s = j·t³/6 with j = √(a³ / 6·s_h); then constant | FastAccelStepper |
//! | jerk | acceleration rises by j to a at most, holds, falls by j to 0 | textbook, 7 phases |
//! | smooth | from a start speed, v = start + gain · x²·(3 - 2x) over a way | ESP-IDF, `stepper_motor` |
//!
//! A jump start is a rise that does not begin at 0.

mod piece;

pub use piece::{Bend, Piece, RISE_PIECES, Rise};

use piece::SEARCH_STEPS_MAX;

use crate::{limits::TICK_HZ, real::Real, smooth::Curve};
use keys::command::RampShape;

/// Speed, steps per tick.
pub fn speed_from_hz(speed_hz: u32) -> Real {
    Real::of(u64::from(speed_hz)) / Real::of(TICK_HZ)
}

/// Speed, steps per tick.
pub fn speed_from_mhz(speed_mhz: u64) -> Real {
    Real::of(speed_mhz) / Real::of(1_000 * TICK_HZ)
}

/// Speed of one step in so many ticks, steps per tick.
///
/// # Panics
/// The interval is 0.
pub fn speed_from_interval(interval_ticks: u64) -> Real {
    Real::of(1) / Real::of(interval_ticks)
}

/// Acceleration, steps per tick².
pub fn accel_from_hz_per_s(accel_hz_per_s: u32) -> Real {
    speed_from_hz(accel_hz_per_s) / Real::of(TICK_HZ)
}

/// Returns an acceleration in steps/s², rounded; the greatest number if it is more.
pub fn hz_per_s_from_accel(accel: Real) -> i64 {
    (accel * Real::of(TICK_HZ) * Real::of(TICK_HZ)).rounded()
}

/// Jerk, steps per tick³.
pub fn jerk_from_hz_per_s2(jerk_hz_per_s2: u32) -> Real {
    accel_from_hz_per_s(jerk_hz_per_s2) / Real::of(TICK_HZ)
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Kind {
    Constant,
    /// Up to `speed` by `jerk` from rest, then constant.
    Linear {
        jerk: Real,
        speed: Real,
    },
    Jerk {
        jerk: Real,
        /// Jerk that may end an acceleration under way.
        level_jerk: Real,
        /// How long the acceleration rises to its greatest, ticks.
        swing: Real,
        /// What speed rises at least when it does, steps per tick.
        full: Real,
    },
    Smooth {
        /// At the curve's first speed, half a step.
        lead: Real,
        curve: Curve,
    },
}

/// How a move gains and loses speed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Law {
    accel: Real,
    kind: Kind,
}

impl Law {
    /// Makes the law of a ramp; its jump is not part of it, see [`Law::jump_speed`].
    ///
    /// # Panics
    /// Acceleration or jerk are 0; or it is a smoothstep, whose law depends on its speed: [`Law::of`].
    pub fn new(accel_hz_per_s: u32, shape: RampShape) -> Self {
        assert!(accel_hz_per_s > 0, "a ramp needs acceleration");
        let accel = accel_from_hz_per_s(accel_hz_per_s);
        let kind = match shape {
            RampShape::Trapezoid {
                linear_steps: 0, ..
            } => Kind::Constant,
            RampShape::Trapezoid { linear_steps, .. } => {
                let way = Real::of(u64::from(linear_steps));
                Kind::Linear {
                    jerk: (accel.squared() * accel / (Real::of(6) * way)).root(),
                    speed: (Real::of(3) * accel * way).half().root(),
                }
            }
            RampShape::Jerk { jerk_hz_per_s2 } => {
                assert!(jerk_hz_per_s2 > 0, "an S-curve needs jerk");
                let jerk = jerk_from_hz_per_s2(jerk_hz_per_s2);
                let swing = accel / jerk;
                Kind::Jerk {
                    jerk,
                    level_jerk: jerk,
                    swing,
                    full: accel * swing,
                }
            }
            RampShape::Smooth { .. } => panic!("a smoothstep has a speed at its end"),
        };
        Self { accel, kind }
    }

    /// Makes the law of a ramp up to this speed, steps per tick; its jump is not part of it.
    ///
    /// # Panics
    /// Acceleration or jerk are 0; or a smoothstep does not rise, see [`Law::smooth`].
    pub fn of(speed: Real, accel_hz_per_s: u32, shape: RampShape) -> Self {
        match shape {
            RampShape::Smooth {
                start_hz,
                ramp_steps,
            } => Self::smooth(speed_from_hz(start_hz), speed, ramp_steps),
            RampShape::Trapezoid { .. } | RampShape::Jerk { .. } => {
                Self::new(accel_hz_per_s, shape)
            }
        }
    }

    /// Makes the law of ESP-IDF's smoothstep table of so many steps from one speed (steps per tick,
    /// more than 0) to a higher one: [`Curve`]. A move starts with the first speed and ends with
    /// it. Faster than the last one it gains speed by the curve's acceleration in its middle.
    ///
    /// # Panics
    /// The speeds or the steps (from 2) are none.
    pub fn smooth(start: Real, end: Real, steps: u32) -> Self {
        assert!(
            !start.is_none() && start < end,
            "a curve rises from a speed"
        );
        assert!(steps >= 2, "a curve has two speeds");
        let curve = Curve::new(start, end - start, Real::of(u64::from(steps - 1)));
        Self {
            accel: curve.accel(),
            kind: Kind::Smooth {
                lead: Real::of(1).half(),
                curve,
            },
        }
    }

    /// Returns the same law in units that are `ratio` times as long.
    #[must_use]
    pub fn scaled(&self, ratio: Real) -> Self {
        let kind = match self.kind {
            Kind::Constant => Kind::Constant,
            Kind::Linear { jerk, speed } => Kind::Linear {
                jerk: jerk * ratio,
                speed: speed * ratio,
            },
            Kind::Jerk {
                jerk,
                level_jerk,
                swing,
                full,
            } => Kind::Jerk {
                jerk: jerk * ratio,
                level_jerk: level_jerk * ratio,
                swing,
                full: full * ratio,
            },
            Kind::Smooth { lead, curve } => Kind::Smooth {
                lead: lead * ratio,
                curve: curve.scaled(ratio),
            },
        };
        Self {
            accel: self.accel * ratio,
            kind,
        }
    }

    /// Returns the greatest acceleration, steps per tick².
    pub fn accel(&self) -> Real {
        self.accel
    }

    /// Returns the jerk of an S-curve.
    pub fn jerk(&self) -> Option<Real> {
        match self.kind {
            Kind::Jerk { jerk, .. } => Some(jerk),
            _ => None,
        }
    }

    /// Returns the jerk of an S-curve that ends an acceleration under way.
    pub fn level_jerk(&self) -> Option<Real> {
        match self.kind {
            Kind::Jerk { level_jerk, .. } => Some(level_jerk),
            _ => None,
        }
    }

    /// Returns the same law for a motion that has followed `before` so far: an acceleration that
    /// began by more jerk may end by as much.
    #[must_use]
    pub fn after(mut self, before: &Self) -> Self {
        if let Kind::Jerk { level_jerk, .. } = &mut self.kind
            && let Some(jerk) = before.level_jerk()
        {
            *level_jerk = jerk.max(*level_jerk);
        }
        self
    }

    /// Returns the same law with no more than this acceleration and, of an S-curve, this jerk.
    #[must_use]
    pub(crate) fn eased(mut self, accel_max: Real, jerk_max: Real) -> Self {
        if let Kind::Jerk {
            jerk, swing, full, ..
        } = &mut self.kind
        {
            self.accel = self.accel.min(accel_max);
            *jerk = (*jerk).min(jerk_max);
            *swing = self.accel / *jerk;
            *full = self.accel * *swing;
        }
        self
    }

    /// Returns the speed with which a move starts that jumps over `jump_steps` of its ramp, steps
    /// per tick.
    pub fn jump_speed(&self, jump_steps: Real) -> Real {
        self.speed_after(jump_steps)
    }

    /// Returns the rise between two speeds, `low` ≤ `high`, without acceleration at either end of
    /// an S-curve.
    pub fn rise(&self, low: Real, high: Real) -> Rise {
        let mut rise = Rise::new();
        match self.kind {
            Kind::Constant => rise.push(self.steady(low, high)),
            Kind::Linear { jerk, speed } => {
                if low < speed {
                    let begin = (low.twice() / jerk).root();
                    let end = (high.min(speed).twice() / jerk).root();
                    rise.push(Piece {
                        ticks: end - begin,
                        speed: low,
                        accel: jerk * begin,
                        jerk,
                        bend: None,
                    });
                }
                if high > speed {
                    rise.push(self.steady(low.max(speed), high));
                }
            }
            Kind::Jerk {
                jerk, swing, full, ..
            } => {
                let gain = high - low;
                if gain.is_none() {
                    return rise;
                }
                let (swing, hold) = if gain >= full {
                    (swing, (gain - full) / self.accel)
                } else {
                    ((gain / jerk).root(), Real::ZERO)
                };
                let accel = (jerk * swing).min(self.accel);
                let first = Piece {
                    ticks: swing,
                    speed: low,
                    accel: Real::ZERO,
                    jerk,
                    bend: None,
                };
                let middle = Piece {
                    ticks: hold,
                    speed: first.speed_at(swing),
                    accel,
                    jerk: Real::ZERO,
                    bend: None,
                };
                rise.push(first);
                rise.push(middle);
                rise.push(Piece {
                    ticks: swing,
                    speed: middle.speed_at(hold),
                    accel,
                    jerk: -jerk,
                    bend: None,
                });
            }
            Kind::Smooth { lead, curve } => {
                let (start, end) = (curve.start(), curve.end());
                if low < start && high >= start {
                    rise.push(Piece::steady(lead / start, start));
                }
                let (from, to) = (low.max(start), high.min(end));
                if from < to {
                    let begin = curve.place_of(from);
                    let place = if to == end {
                        curve.steps()
                    } else {
                        curve.place_of(to)
                    };
                    rise.push(Piece {
                        bend: Some(Bend {
                            curve,
                            begin,
                            way: place - begin,
                        }),
                        ..Piece::steady(curve.ticks_between(begin, place), from)
                    });
                }
                if high > end {
                    rise.push(self.steady(low.max(end), high));
                }
            }
        }
        rise
    }

    fn steady(&self, low: Real, high: Real) -> Piece {
        Piece {
            ticks: (high - low) / self.accel,
            speed: low,
            accel: self.accel,
            jerk: Real::ZERO,
            bend: None,
        }
    }

    /// Returns the way of [`Law::rise`], steps.
    pub fn way(&self, low: Real, high: Real) -> Real {
        match self.kind {
            Kind::Constant => (high.squared() - low.squared()).half() / self.accel,
            Kind::Linear { .. } | Kind::Smooth { .. } => {
                self.way_from_rest(high) - self.way_from_rest(low)
            }
            // The acceleration is symmetric about its middle: the mean speed is that of both ends.
            Kind::Jerk {
                jerk, swing, full, ..
            } => {
                let gain = high - low;
                let ticks = if gain >= full {
                    gain / self.accel + swing
                } else {
                    (gain / jerk).root().twice()
                };
                (low + high).half() * ticks
            }
        }
    }

    /// Way from rest to this speed by the law, steps; not for an S-curve.
    fn way_from_rest(&self, speed: Real) -> Real {
        match self.kind {
            Kind::Linear { jerk, speed: end } if speed <= end => {
                let ticks = (speed.twice() / jerk).root();
                (jerk * ticks.squared() * ticks).half().third()
            }
            Kind::Linear { jerk, speed: end } => {
                let ticks = (end.twice() / jerk).root();
                (jerk * ticks.squared() * ticks).half().third()
                    + (speed.squared() - end.squared()).half() / self.accel
            }
            Kind::Smooth { curve, .. } if speed < curve.start() => Real::ZERO,
            Kind::Smooth { lead, curve } if speed < curve.end() => lead + curve.place_of(speed),
            Kind::Smooth { lead, curve } => {
                let above = speed.squared() - curve.end().squared();
                lead + curve.steps() + above.half() / self.accel
            }
            _ => speed.squared().half() / self.accel,
        }
    }

    /// Speed that the law has after this way from rest.
    fn speed_after(&self, way: Real) -> Real {
        match self.kind {
            Kind::Constant => (self.accel * way).twice().root(),
            Kind::Linear { jerk, speed } => {
                let end = self.way_from_rest(speed);
                if way <= end {
                    let ticks = (way * Real::of(6) / jerk).cube_root();
                    (jerk * ticks.squared()).half()
                } else {
                    (speed.squared() + (self.accel * (way - end)).twice()).root()
                }
            }
            Kind::Jerk { .. } => self.peak(way, Real::ZERO, Real::ZERO, None),
            Kind::Smooth { lead, curve } => {
                let above = way - lead - curve.steps();
                if above.is_none() {
                    curve.speed_at(way - lead)
                } else {
                    (curve.end().squared() + (self.accel * above).twice()).root()
                }
            }
        }
    }

    /// Returns the speed at which a rise from `from` and a fall to `to` meet if they make `way`
    /// together, at most `speed_max`. The way suffices for the change from `from` to `to`.
    pub fn peak(&self, way: Real, from: Real, to: Real, speed_max: Option<Real>) -> Real {
        let most = |speed: Real| speed_max.map_or(speed, |max| speed.min(max));
        match self.kind {
            Kind::Constant => {
                let square = self.accel * way + (from.squared() + to.squared()).half();
                most(square.root().max(from).max(to))
            }
            Kind::Linear { .. } | Kind::Smooth { .. } => {
                let sum = way + self.way_from_rest(from) + self.way_from_rest(to);
                most(self.speed_after(sum.half()).max(from).max(to))
            }
            Kind::Jerk { jerk, swing, .. } if from == Real::ZERO && to == Real::ZERO => {
                let least = (self.accel * swing.squared()).twice();
                most(if way >= least {
                    let root = (swing.squared() + (way / self.accel).shifted(2)).root();
                    way.twice() / (swing + root)
                } else {
                    (way.squared() * jerk).shifted(-2).cube_root()
                })
            }
            Kind::Jerk { .. } => {
                if let Some(max) = speed_max
                    && self.way(from, max) + self.way(to, max) <= way
                {
                    return max;
                }
                most(self.search_peak(way, from.max(to), from.min(to)))
            }
        }
    }

    /// Returns the speed at which rises of an S-curve from `high` and from `low` make `way`
    /// together.
    ///
    /// Newton's method in u = √(gain / jerk) of the smaller gain: in it the way is convex, so that
    /// it comes from above and never leaves the bounds.
    fn search_peak(&self, way: Real, high: Real, low: Real) -> Real {
        let Kind::Jerk {
            jerk, swing, full, ..
        } = self.kind
        else {
            return high;
        };
        // Constant acceleration needs less way, and so does jerk alone from rest.
        let square = self.accel * way + (high.squared() + low.squared()).half();
        let steady = (square.root() - high) / jerk;
        let alone = (way.half() / jerk).cube_root();
        let mut u = steady.root().min(alone);
        // Duration of a rise by this gain, and what it is longer for each unit of gain more.
        let rise = |gain: Real| {
            if gain >= full {
                (gain / self.accel + swing, Real::of(1) / self.accel)
            } else {
                let ticks = (gain / jerk).root().twice();
                (ticks, ticks / gain.twice())
            }
        };
        for _ in 0..SEARCH_STEPS_MAX {
            if u.is_none() {
                break;
            }
            let gain = jerk * u.squared();
            let peak = high + gain;
            // Of the larger gain, by the peak; of the smaller one, by u: its change by u is finite.
            let (ticks, longer) = rise(peak - low);
            let mean = (low + peak).half();
            let (own_ticks, own_longer) = if gain >= full {
                rise(gain)
            } else {
                (u.twice(), Real::of(1) / (jerk * u))
            };
            let own_mean = (high + peak).half();
            let error = own_mean * own_ticks + mean * ticks - way;
            let slope = (ticks + own_ticks).half() + mean * longer + own_mean * own_longer;
            let change = error / (slope * jerk * u.twice());
            u = u - change;
            if change.is_none() || change < u.shifted(-SEARCH_BITS) {
                break;
            }
        }
        // No more way than there is, for all that was cut.
        let peak = high + jerk * u.max(Real::ZERO).squared();
        high.max(peak - peak.shifted(-PEAK_SLACK_BITS))
    }

    /// Returns the highest speed from which `to` is reached within `way`, at most `speed_max`.
    pub fn speed_before(&self, way: Real, to: Real, speed_max: Real) -> Real {
        match self.kind {
            Kind::Jerk {
                jerk, swing, full, ..
            } => {
                if speed_max <= to || self.way(to, speed_max) <= way {
                    return speed_max;
                }
                if way.is_none() {
                    return to;
                }
                if way >= (to.twice() + full) * swing {
                    // The acceleration reaches its greatest: a square equation.
                    let part = full.half();
                    let square = (part - to).squared() + (self.accel * way).twice();
                    return (square.root() - part).max(to).min(speed_max);
                }
                // way = (2·to + jerk·u²)·u with u = √(gain / jerk): Newton's method from above.
                let mut u = (way / jerk).cube_root();
                if !to.is_none() {
                    u = u.min(way / to.twice());
                }
                for _ in 0..SEARCH_STEPS_MAX {
                    let square = jerk * u.squared();
                    let next = ((square * u).twice() + way) / (square + (square + to).twice());
                    let change = u - next;
                    u = next;
                    if change.is_none() || change < u.shifted(-SEARCH_BITS) {
                        break;
                    }
                }
                let speed = to + jerk * u.squared();
                to.max(speed - speed.shifted(-PEAK_SLACK_BITS))
                    .min(speed_max)
            }
            Kind::Constant => (to.squared() + (self.accel * way).twice())
                .root()
                .min(speed_max),
            Kind::Linear { .. } | Kind::Smooth { .. } => self
                .speed_after(self.way_from_rest(to) + way)
                .min(speed_max),
        }
    }
}

/// A search by Newton's method from above ends when it moves by less than 2⁻³⁰: the next step would
/// be the square of that.
const SEARCH_BITS: i32 = 30;

/// A peak that was searched is lowered by 2⁻⁵⁴ of it.
const PEAK_SLACK_BITS: i32 = 54;

#[cfg(test)]
mod tests;
