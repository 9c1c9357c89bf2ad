//! [`Law`]: how a move gains speed. One rise from a lower to a higher speed is all it gives: a way
//! down is the same rise, read backwards.
//!
//! | shape | from rest (t = time, s = way) | source |
//! |---|---|---|
//! | constant | v = a·t | textbook |
//! | linear | s ≤ s_h: s = j·t³/6 with j = √(a³ / 6·s_h); then constant | FastAccelStepper |
//! | jerk | acceleration rises by j to a at most, holds, falls by j to 0 | textbook, 7 phases |
//!
//! A jump start is a rise that does not begin at 0.

use crate::{limits::TICK_HZ, real::Real};
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

/// Jerk, steps per tick³.
pub fn jerk_from_hz_per_s2(jerk_hz_per_s2: u32) -> Real {
    accel_from_hz_per_s(jerk_hz_per_s2) / Real::of(TICK_HZ)
}

/// A stretch of time with constant jerk.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Piece {
    /// How long, ticks.
    pub ticks: Real,
    /// Speed at its begin, steps per tick.
    pub speed: Real,
    /// Acceleration at its begin, steps per tick².
    pub accel: Real,
    /// Jerk, steps per tick³.
    pub jerk: Real,
}

impl Piece {
    /// Returns the way after this time, steps: v·t + a·t²/2 + j·t³/6.
    pub fn way_at(&self, ticks: Real) -> Real {
        let mut sum = self.accel.half();
        if self.jerk != Real::ZERO {
            sum = sum + self.jerk * ticks / Real::of(6);
        }
        (self.speed + sum * ticks) * ticks
    }

    /// Returns the speed after this time, steps per tick.
    pub fn speed_at(&self, ticks: Real) -> Real {
        self.speed + (self.accel + (self.jerk * ticks).half()) * ticks
    }

    /// Returns the whole way, steps.
    pub fn way(&self) -> Real {
        self.way_at(self.ticks)
    }

    /// Returns when this way is made, ticks from its begin; `way` within the piece.
    pub fn ticks_at(&self, way: Real) -> Real {
        if way.is_none() {
            return Real::ZERO;
        }
        if self.jerk == Real::ZERO {
            // Without the difference of two nearly equal numbers that the textbook's form has.
            let speed = (self.speed.squared() + (self.accel * way).twice()).root();
            return way.twice() / (self.speed + speed);
        }
        if self.speed == Real::ZERO && self.accel == Real::ZERO {
            return (way * Real::of(6) / self.jerk).cube_root();
        }
        self.search(way)
    }

    /// Newton's method, kept between bounds.
    fn search(&self, way: Real) -> Real {
        let (mut low, mut high) = (Real::ZERO, self.ticks);
        // The share of the way, by the mean speed.
        let mut ticks = self.ticks * way / self.way();
        for _ in 0..SEARCH_STEPS_MAX {
            let error = self.way_at(ticks) - way;
            if error.is_negative() {
                low = ticks;
            } else {
                high = ticks;
            }
            let speed = self.speed_at(ticks);
            let mut next = if speed.is_none() {
                (low + high).half()
            } else {
                ticks - error / speed
            };
            if next < low || next > high {
                next = (low + high).half();
            }
            let change = (next - ticks).abs();
            ticks = next;
            if change.fixed(SEARCH_FRACTION_BITS) == 0 {
                break;
            }
        }
        ticks
    }
}

/// Bisection alone would need this many for 2⁶² ticks.
const SEARCH_STEPS_MAX: usize = 80;

/// A search ends when it moves by less than 2⁻¹² ticks.
const SEARCH_FRACTION_BITS: i32 = 12;

/// A rise from one speed to a higher one.
#[derive(Clone, Copy, Debug)]
pub struct Rise {
    pieces: [Piece; RISE_PIECES],
    count: usize,
}

/// Most pieces of a rise.
pub const RISE_PIECES: usize = 3;

impl Rise {
    const fn new() -> Self {
        let none = Piece {
            ticks: Real::ZERO,
            speed: Real::ZERO,
            accel: Real::ZERO,
            jerk: Real::ZERO,
        };
        Self {
            pieces: [none; RISE_PIECES],
            count: 0,
        }
    }

    fn push(&mut self, piece: Piece) {
        if !piece.ticks.is_none() {
            self.pieces[self.count] = piece;
            self.count += 1;
        }
    }

    /// Returns its pieces in order of speed.
    pub fn pieces(&self) -> &[Piece] {
        &self.pieces[..self.count]
    }

    /// Returns its way, steps.
    pub fn way(&self) -> Real {
        self.pieces()
            .iter()
            .fold(Real::ZERO, |sum, piece| sum + piece.way())
    }

    /// Returns its duration, ticks.
    pub fn ticks(&self) -> Real {
        self.pieces()
            .iter()
            .fold(Real::ZERO, |sum, piece| sum + piece.ticks)
    }
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
    /// Acceleration or jerk are 0.
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
                Kind::Jerk {
                    jerk,
                    level_jerk: jerk,
                }
            }
        };
        Self { accel, kind }
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
            Kind::Jerk { jerk, level_jerk } => Kind::Jerk {
                jerk: jerk * ratio,
                level_jerk: level_jerk * ratio,
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
                    });
                }
                if high > speed {
                    rise.push(self.steady(low.max(speed), high));
                }
            }
            Kind::Jerk { jerk, .. } => {
                let gain = high - low;
                if gain.is_none() {
                    return rise;
                }
                let full = self.accel.squared() / jerk;
                let (swing, hold) = if gain >= full {
                    (self.accel / jerk, (gain - full) / self.accel)
                } else {
                    ((gain / jerk).root(), Real::ZERO)
                };
                let accel = (jerk * swing).min(self.accel);
                let first = Piece {
                    ticks: swing,
                    speed: low,
                    accel: Real::ZERO,
                    jerk,
                };
                let middle = Piece {
                    ticks: hold,
                    speed: first.speed_at(swing),
                    accel,
                    jerk: Real::ZERO,
                };
                rise.push(first);
                rise.push(middle);
                rise.push(Piece {
                    ticks: swing,
                    speed: middle.speed_at(hold),
                    accel,
                    jerk: -jerk,
                });
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
        }
    }

    /// Returns the way of [`Law::rise`], steps.
    pub fn way(&self, low: Real, high: Real) -> Real {
        match self.kind {
            Kind::Constant => (high.squared() - low.squared()).half() / self.accel,
            Kind::Linear { .. } => self.way_from_rest(high) - self.way_from_rest(low),
            // The acceleration is symmetric about its middle: the mean speed is that of both ends.
            Kind::Jerk { .. } => (low + high).half() * self.rise(low, high).ticks(),
        }
    }

    /// Way from rest to this speed by the law, steps; not for an S-curve.
    fn way_from_rest(&self, speed: Real) -> Real {
        match self.kind {
            Kind::Linear { jerk, speed: end } if speed <= end => {
                let ticks = (speed.twice() / jerk).root();
                jerk * ticks.squared() * ticks / Real::of(6)
            }
            Kind::Linear { jerk, speed: end } => {
                let ticks = (end.twice() / jerk).root();
                jerk * ticks.squared() * ticks / Real::of(6)
                    + (speed.squared() - end.squared()).half() / self.accel
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
            Kind::Linear { .. } => {
                let sum = way + self.way_from_rest(from) + self.way_from_rest(to);
                most(self.speed_after(sum.half()).max(from).max(to))
            }
            Kind::Jerk { jerk, .. } if from == Real::ZERO && to == Real::ZERO => {
                let swing = self.accel / jerk;
                let least = (self.accel * swing.squared()).twice();
                most(if way >= least {
                    let root = (swing.squared() + (way / self.accel).shifted(2)).root();
                    way.twice() / (swing + root)
                } else {
                    (way.squared() * jerk).shifted(-2).cube_root()
                })
            }
            Kind::Jerk { .. } => self.search_peak(way, from, to, speed_max),
        }
    }

    fn search_peak(&self, way: Real, from: Real, to: Real, speed_max: Option<Real>) -> Real {
        let needs = |peak: Real| self.way(from, peak) + self.way(to, peak);
        let mut low = from.max(to);
        // Constant acceleration is faster.
        let square = self.accel * way + (from.squared() + to.squared()).half();
        let mut high = square.root().max(low);
        if let Some(max) = speed_max {
            if needs(max) <= way {
                return max;
            }
            high = high.min(max);
        }
        for _ in 0..PEAK_STEPS_MAX {
            let middle = (low + high).half();
            if middle == low || middle == high {
                break;
            }
            if needs(middle) <= way {
                low = middle;
            } else {
                high = middle;
            }
        }
        low
    }

    /// Returns the highest speed from which `to` is reached within `way`, at most `speed_max`.
    pub fn speed_before(&self, way: Real, to: Real, speed_max: Real) -> Real {
        match self.kind {
            Kind::Jerk { .. } => {
                if speed_max <= to || self.way(to, speed_max) <= way {
                    return speed_max;
                }
                let (mut low, mut high) = (to, speed_max);
                for _ in 0..PEAK_STEPS_MAX {
                    let middle = (low + high).half();
                    if middle == low || middle == high {
                        break;
                    }
                    if self.way(to, middle) <= way {
                        low = middle;
                    } else {
                        high = middle;
                    }
                }
                low
            }
            Kind::Constant => (to.squared() + (self.accel * way).twice())
                .root()
                .min(speed_max),
            Kind::Linear { .. } => self
                .speed_after(self.way_from_rest(to) + way)
                .min(speed_max),
        }
    }
}

/// Steps of a bisection: from the speed itself to 2⁻⁵⁰ of it.
const PEAK_STEPS_MAX: usize = 50;
