//! Phases of a path: a piece with its place and time; and spans within which edges are found.

use super::State;
use crate::{
    law::{Bend, Piece},
    real::Real,
};

/// A stretch of a path with constant jerk.
#[derive(Clone, Copy, Debug)]
pub(super) struct Phase {
    /// End of the phase, ticks from the path's begin.
    pub(super) end_ticks: Real,
    /// Place at its end, steps.
    pub(super) end_steps: Real,
    /// The time and place from which `piece` counts.
    pub(super) anchor_ticks: Real,
    pub(super) anchor_steps: Real,
    /// It counts from its end, against time.
    pub(super) backward: bool,
    pub(super) piece: Piece,
}

impl Phase {
    /// No motion, at this time and place.
    pub(super) const fn rest(ticks: Real, place: Real) -> Self {
        Self {
            end_ticks: ticks,
            end_steps: place,
            anchor_ticks: ticks,
            anchor_steps: place,
            backward: false,
            piece: Piece::steady(Real::ZERO, Real::ZERO),
        }
    }

    pub(super) fn ticks_at(&self, place: Real) -> Real {
        if self.backward {
            self.anchor_ticks - self.piece.ticks_at(self.anchor_steps - place)
        } else {
            self.anchor_ticks + self.piece.ticks_at(place - self.anchor_steps)
        }
    }

    pub(super) fn state_at(&self, ticks: Real) -> State {
        let since = if self.backward {
            self.anchor_ticks - ticks
        } else {
            ticks - self.anchor_ticks
        };
        let way = self.piece.way_at(since);
        let speed = self.piece.speed_at(since).max(Real::ZERO);
        let accel = self.piece.accel_at(since);
        if self.backward {
            State {
                place: self.anchor_steps - way,
                speed,
                accel: -accel,
            }
        } else {
            State {
                place: self.anchor_steps + way,
                speed,
                accel,
            }
        }
    }
}

/// How a phase goes on, for who finds edges in it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Course {
    /// At constant speed, or at rest.
    Steady,
    /// By constant acceleration or jerk: log₂ of the jerk in 2⁻¹⁶, if it is any.
    Changing { jerk_log: Option<i32> },
    /// By a curve.
    Bent,
}

/// How a place is passed.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Pass {
    /// When, ticks from the path's begin.
    pub(crate) ticks: Real,
    /// How fast, steps per tick; not told of a curve.
    pub(crate) speed: Real,
    /// Size of the acceleration there.
    pub(crate) accel: Real,
}

/// A phase that is asked often: what does not depend on the place is computed once.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Span {
    /// Number of the phase in its path.
    pub(super) index: usize,
    course: Course,
    /// Constant acceleration: the square of the speed at the anchor.
    square: Real,
    /// 1 / acceleration; 6 / jerk from rest; 1 / speed without either.
    inverse: Real,
    /// A way from the anchor and its time: a curve is summed up from there.
    known: [Real; 2],
}

impl Span {
    /// Looks at a phase, and how a place of it is passed.
    pub(super) fn enter(index: usize, phase: &Phase, place: Real) -> (Self, Pass) {
        let span = Self::of(index, phase);
        let piece = &phase.piece;
        let mut guess = phase.anchor_ticks;
        if piece.jerk != Real::ZERO {
            // The share of the way, by the mean speed.
            let way = (place - phase.anchor_steps).abs();
            let whole = piece.way();
            let ticks = if whole.is_none() {
                Real::ZERO
            } else {
                piece.ticks * way / whole
            };
            guess = if phase.backward {
                guess - ticks
            } else {
                guess + ticks
            };
        }
        let pass = span.pass(phase, place, guess);
        (span, pass)
    }

    fn of(index: usize, phase: &Phase) -> Self {
        let Piece {
            speed,
            accel,
            jerk,
            bend,
            ..
        } = &phase.piece;
        let one = Real::of(1);
        let mut square = Real::ZERO;
        let mut inverse = Real::ZERO;
        let course = if bend.is_some() {
            Course::Bent
        } else if *jerk != Real::ZERO {
            if *speed == Real::ZERO && *accel == Real::ZERO {
                inverse = Real::of(6) / *jerk;
            }
            Course::Changing {
                jerk_log: Some(jerk.abs().log()),
            }
        } else if *accel != Real::ZERO {
            square = speed.squared();
            inverse = one / *accel;
            Course::Changing { jerk_log: None }
        } else {
            if *speed != Real::ZERO {
                inverse = one / *speed;
            }
            Course::Steady
        };
        Self {
            index,
            course,
            square,
            inverse,
            known: [Real::ZERO; 2],
        }
    }

    pub(crate) fn course(&self) -> Course {
        self.course
    }

    /// Tells when a place was found to be passed, near which the next ones are.
    pub(super) fn know(&mut self, phase: &Phase, place: Real, ticks: Real) {
        if self.course == Course::Bent {
            let way = place - phase.anchor_steps;
            let since = ticks - phase.anchor_ticks;
            self.known = if phase.backward {
                [-way, -since]
            } else {
                [way, since]
            };
        }
    }

    /// Returns how this place of it is passed; a jerk's time is searched from near `guess_ticks`.
    pub(super) fn pass(&self, phase: &Phase, place: Real, guess_ticks: Real) -> Pass {
        let Phase {
            anchor_ticks,
            anchor_steps,
            backward,
            piece,
            ..
        } = phase;
        let way = if *backward {
            *anchor_steps - place
        } else {
            place - *anchor_steps
        };
        let (mut speed, mut accel) = (piece.speed, piece.accel);
        let ticks = if way.is_none() {
            Real::ZERO
        } else if let Some(Bend { curve, begin, .. }) = &piece.bend {
            let [known_way, known_ticks] = self.known;
            known_ticks + curve.ticks_between(*begin + known_way, *begin + way)
        } else if piece.jerk != Real::ZERO {
            let ticks = if piece.speed == Real::ZERO && piece.accel == Real::ZERO {
                (way * self.inverse).cube_root()
            } else {
                let guess = if *backward {
                    *anchor_ticks - guess_ticks
                } else {
                    guess_ticks - *anchor_ticks
                };
                piece.search(way, guess.max(Real::ZERO).min(piece.ticks))
            };
            speed = piece.speed_at(ticks);
            accel = piece.accel_at(ticks);
            ticks
        } else if piece.accel != Real::ZERO {
            speed = (self.square + (piece.accel * way).twice()).root();
            (speed - piece.speed) * self.inverse
        } else {
            way * self.inverse
        };
        Pass {
            ticks: if *backward {
                *anchor_ticks - ticks
            } else {
                *anchor_ticks + ticks
            },
            speed,
            accel: accel.abs(),
        }
    }
}
