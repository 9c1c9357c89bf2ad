//! Pieces of a motion in time: constant jerk, or a curve; and rises made of them.

use crate::{real::Real, smooth::Curve};

/// A stretch of time with constant jerk, or of a curve.
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
    /// Speed goes by the way instead: acceleration and jerk are 0.
    pub bend: Option<Bend>,
}

/// A part of a curve.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Bend {
    /// The whole of it.
    pub curve: Curve,
    /// Where in it the part begins, steps.
    pub begin: Real,
    /// How long the part is, steps.
    pub way: Real,
}

impl Piece {
    /// Constant speed, steps per tick, for this time.
    pub const fn steady(ticks: Real, speed: Real) -> Self {
        Self {
            ticks,
            speed,
            accel: Real::ZERO,
            jerk: Real::ZERO,
            bend: None,
        }
    }

    /// Returns the way after this time, steps: v·t + a·t²/2 + j·t³/6.
    pub fn way_at(&self, ticks: Real) -> Real {
        if let Some(Bend { curve, begin, way }) = &self.bend {
            return curve.way_in(*begin, *way, ticks);
        }
        let mut sum = self.accel.half();
        if self.jerk != Real::ZERO {
            sum = sum + (self.jerk * ticks).half().third();
        }
        (self.speed + sum * ticks) * ticks
    }

    /// Returns the speed after this time, steps per tick.
    pub fn speed_at(&self, ticks: Real) -> Real {
        if let Some(Bend { curve, begin, .. }) = &self.bend {
            return curve.speed_at(*begin + self.way_at(ticks));
        }
        self.speed + (self.accel + (self.jerk * ticks).half()) * ticks
    }

    /// Returns the acceleration after this time, steps per tick².
    pub fn accel_at(&self, ticks: Real) -> Real {
        if let Some(Bend { curve, begin, .. }) = &self.bend {
            return curve.accel_at(*begin + self.way_at(ticks));
        }
        self.accel + self.jerk * ticks
    }

    /// Returns the whole way, steps.
    pub fn way(&self) -> Real {
        match &self.bend {
            Some(bend) => bend.way,
            None => self.way_at(self.ticks),
        }
    }

    /// Returns when this way is made, ticks from its begin; `way` within the piece.
    pub fn ticks_at(&self, way: Real) -> Real {
        if way.is_none() {
            return Real::ZERO;
        }
        if let Some(Bend { curve, begin, .. }) = &self.bend {
            return curve.ticks_between(*begin, *begin + way);
        }
        if self.jerk == Real::ZERO {
            // Without the difference of two nearly equal numbers that the textbook's form has.
            let speed = (self.speed.squared() + (self.accel * way).twice()).root();
            return way.twice() / (self.speed + speed);
        }
        if self.speed == Real::ZERO && self.accel == Real::ZERO {
            return (way * Real::of(6) / self.jerk).cube_root();
        }
        // The share of the way, by the mean speed.
        self.search(way, self.ticks * way / self.way())
    }

    /// Newton's method from near `ticks`, kept between bounds.
    pub(crate) fn search(&self, way: Real, mut ticks: Real) -> Real {
        let (mut low, mut high) = (Real::ZERO, self.ticks);
        for _ in 0..SEARCH_STEPS_MAX {
            let error = self.way_at(ticks) - way;
            if error.is_negative() {
                low = ticks;
            } else {
                high = ticks;
            }
            let speed = self.speed_at(ticks);
            let mut next = if speed.is_none() {
                low
            } else {
                ticks - error / speed
            };
            let bisects = speed.is_none() || next < low || next > high;
            if bisects {
                next = (low + high).half();
            }
            let change = (next - ticks).abs();
            ticks = next;
            if change.fixed(SEARCH_FRACTION_BITS) == 0 {
                break;
            }
            // What Newton's step leaves: its square, times the acceleration by twice the speed.
            let accel = self.accel_at(ticks).abs() + self.jerk.abs() * change;
            let left = change.squared() * accel;
            if !bisects && left.shifted(SEARCH_FRACTION_BITS - 1) < speed {
                break;
            }
        }
        ticks
    }
}

/// Bisection alone would need this many for 2⁶² ticks.
pub(super) const SEARCH_STEPS_MAX: usize = 80;

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
    pub(super) const fn new() -> Self {
        Self {
            pieces: [Piece::steady(Real::ZERO, Real::ZERO); RISE_PIECES],
            count: 0,
        }
    }

    pub(super) fn push(&mut self, piece: Piece) {
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
