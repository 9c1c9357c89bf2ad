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

/// A phase that is asked often: what does not depend on the place is computed once.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Span {
    phase: Phase,
    /// Constant acceleration: the square of the speed at the anchor.
    square: Real,
    /// 1 / acceleration; 6 / jerk from rest; 1 / speed without either.
    inverse: Real,
    /// A way from the anchor and its time: a curve is summed up from there.
    known: [Real; 2],
}

impl Span {
    pub(super) fn of(phase: &Phase) -> Self {
        let Piece {
            speed, accel, jerk, ..
        } = phase.piece;
        let one = Real::of(1);
        let inverse = if jerk != Real::ZERO {
            if speed == Real::ZERO && accel == Real::ZERO {
                Real::of(6) / jerk
            } else {
                Real::ZERO
            }
        } else if accel != Real::ZERO {
            one / accel
        } else if speed != Real::ZERO {
            one / speed
        } else {
            Real::ZERO
        };
        Self {
            phase: *phase,
            square: speed.squared(),
            inverse,
            known: [Real::ZERO; 2],
        }
    }

    /// Tells when a place was found to be passed, near which the next ones are.
    pub(crate) fn know(&mut self, place: Real, ticks: Real) {
        if self.phase.piece.bend.is_some() {
            let way = place - self.phase.anchor_steps;
            let since = ticks - self.phase.anchor_ticks;
            self.known = if self.phase.backward {
                [-way, -since]
            } else {
                [way, since]
            };
        }
    }

    /// Returns when this place of it is passed, ticks from the path's begin; a jerk's time is
    /// searched from near `guess_ticks`.
    pub(crate) fn ticks_near(&self, place: Real, guess_ticks: Real) -> Real {
        let Phase {
            anchor_ticks,
            anchor_steps,
            backward,
            piece,
            ..
        } = &self.phase;
        let (way, guess) = if *backward {
            (*anchor_steps - place, *anchor_ticks - guess_ticks)
        } else {
            (place - *anchor_steps, guess_ticks - *anchor_ticks)
        };
        let ticks = if way.is_none() {
            Real::ZERO
        } else if let Some(Bend { curve, begin, .. }) = &piece.bend {
            let [known_way, known_ticks] = self.known;
            known_ticks + curve.ticks_between(*begin + known_way, *begin + way)
        } else if piece.jerk != Real::ZERO {
            if piece.speed == Real::ZERO && piece.accel == Real::ZERO {
                (way * self.inverse).cube_root()
            } else {
                piece.search(way, guess.max(Real::ZERO).min(piece.ticks))
            }
        } else if piece.accel != Real::ZERO {
            let speed = (self.square + (piece.accel * way).twice()).root();
            (speed - piece.speed) * self.inverse
        } else {
            way * self.inverse
        };
        if *backward {
            *anchor_ticks - ticks
        } else {
            *anchor_ticks + ticks
        }
    }
}
