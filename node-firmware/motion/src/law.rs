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

mod approach;
mod peak;
mod piece;
mod units;

pub(crate) use approach::{Approach, Pace};
pub use piece::{Bend, Piece, RISE_PIECES, Rise};
pub use units::{
    accel_from_hz_per_s, hz_per_s_from_accel, jerk_from_hz_per_s2, speed_from_hz,
    speed_from_interval, speed_from_mhz,
};

use crate::{real::Real, smooth::Curve};
use keys::command::RampShape;

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
}

#[cfg(test)]
mod tests;
