//! S-curves that begin with an acceleration under way: they go on with it, or end it first.

use super::{Path, SLACK_BITS, State, TooShort};
use crate::{
    law::{Law, Piece},
    real::Real,
};

/// A change of an S-curve's speed that is under way.
pub(super) struct Change {
    pub(super) jerk: Real,
    /// How long ago it would have begun, ticks.
    pub(super) since: Real,
    /// By how much speed has changed since, and will until the acceleration has ended.
    pub(super) gain: Real,
    pub(super) is_rise: bool,
}

impl Change {
    /// Returns the one that this state is in, if the law could have begun it.
    pub(super) fn of(state: &State, law: &Law) -> Option<Self> {
        let jerk = law.jerk()?;
        let accel = state.accel;
        let slack = law.accel().shifted(-SLACK_BITS);
        if accel.abs() <= slack || accel.abs() > law.accel() + slack {
            return None;
        }
        let since = accel.abs() / jerk;
        Some(Self {
            jerk,
            since,
            gain: (since * accel.abs()).half(),
            is_rise: !accel.is_negative(),
        })
    }
}

/// Steps of the bisection for a braking that goes on.
const BRAKE_STEPS_MAX: usize = 40;

/// Places are right to less than 2⁻⁵⁰ of them.
const PLACE_BITS: i32 = 50;

impl Path {
    /// An S-curve that speeds up goes on with that, as if the rise had begun a while ago: returns
    /// whether it reaches a higher speed so than the one at which its acceleration could end.
    pub(super) fn rise_on(
        &mut self,
        to_place: Real,
        to_speed: Real,
        speed_max: Real,
        law: &Law,
    ) -> bool {
        let Some(Change {
            jerk,
            since,
            gain,
            is_rise: true,
        }) = self.under_way(law)
        else {
            return false;
        };
        let State {
            place,
            speed,
            accel,
        } = self.end_state();
        let (begun, level) = ((speed - gain).max(Real::ZERO), speed + gain);
        if speed + gain.shifted(-SLACK_BITS) < gain || level >= speed_max {
            return false;
        }
        let made = (begun + (jerk * since.squared()).half().third()) * since;
        let way = to_place - place + made;
        let least = law.way(begun.min(to_speed), begun.max(to_speed));
        if least > way {
            return false;
        }
        let peak = law.peak(way, begun, to_speed, Some(speed_max));
        if peak <= level {
            return false;
        }
        for (index, piece) in law.rise(begun, peak).pieces().iter().enumerate() {
            if index == 0 {
                self.forward(Piece {
                    ticks: piece.ticks - since,
                    speed,
                    accel,
                    ..*piece
                });
            } else {
                self.forward(*piece);
            }
        }
        self.end_from(peak, to_place, to_speed, law);
        true
    }

    /// An S-curve that slows down goes on with that down to `low`, as if the fall had begun a while
    /// ago: returns whether it can.
    pub(super) fn fall_on(&mut self, low: Real, law: &Law) -> bool {
        let Some(Change {
            jerk,
            since,
            gain,
            is_rise: false,
        }) = self.under_way(law)
        else {
            return false;
        };
        let State { place, speed, .. } = self.end_state();
        if speed + gain.shifted(-SLACK_BITS) < gain + low {
            return false;
        }
        let begun = speed + gain;
        let made = (begun - (jerk * since.squared()).half().third()) * since;
        let down = law.rise(low, begun);
        let end_ticks = self.ticks() - since + down.ticks();
        self.backward(down.pieces(), end_ticks, place - made + down.way());
        true
    }

    /// An S-curve that brakes for just this place goes on with that; returns whether it does. What
    /// rounding leaves of the way would take long at no speed.
    pub(super) fn brakes_for(&mut self, to_place: Real, to_speed: Real, law: &Law) -> bool {
        let before = self.count;
        let slack = Real::of(1).shifted(-SLACK_BITS) + to_place.abs().shifted(-PLACE_BITS);
        if self.fall_on(to_speed, law) && (self.end_steps() - to_place).abs() <= slack {
            return true;
        }
        self.count = before;
        false
    }

    /// Slows down on, first to a speed with which the rest of the way can be made: there is too
    /// little of it to end the braking first.
    pub(super) fn brake_on(
        &mut self,
        to_place: Real,
        to_speed: Real,
        law: &Law,
    ) -> Result<(), TooShort> {
        let before = self.count;
        let speed = self.end_state().speed;
        let slack = Real::of(1).shifted(-SLACK_BITS);
        let mut reach = |low: Real| {
            self.count = before;
            let ends = self.fall_on(low, law);
            ends.then(|| self.end_steps() + law.way(to_speed, low))
        };
        let mut low = to_speed;
        if reach(low).is_none_or(|place| place > to_place + slack) {
            self.count = before;
            return Err(TooShort);
        }
        let mut high = speed;
        for _ in 0..BRAKE_STEPS_MAX {
            let middle = (low + high).half();
            if reach(middle).is_some_and(|place| place <= to_place) {
                low = middle;
            } else {
                high = middle;
            }
        }
        reach(low);
        self.end_from(low, to_place, to_speed, law);
        Ok(())
    }

    /// Returns the change of an S-curve's speed that is under way, if the law could have begun it.
    fn under_way(&self, law: &Law) -> Option<Change> {
        law.jerk()?;
        Change::of(&self.end_state(), law)
    }

    /// Ends an acceleration by the law's jerk; returns the speed then.
    pub(super) fn level_out(&mut self, law: &Law) -> Real {
        let State { speed, accel, .. } = self.end_state();
        let Some(jerk) = law.level_jerk() else {
            return speed;
        };
        // What rounding leaves of an acceleration that has ended.
        if accel.abs() <= law.accel().shifted(-SLACK_BITS) {
            return speed;
        }
        if speed.is_none() {
            return Real::ZERO;
        }
        // A braking that the law would not have begun may need more jerk to end before it turns
        // the motion round.
        let least = accel.squared().half() / speed;
        let jerk = if accel.is_negative() {
            jerk.max(least)
        } else {
            jerk
        };
        let piece = Piece {
            ticks: accel.abs() / jerk,
            speed,
            accel,
            jerk: if accel.is_negative() { jerk } else { -jerk },
            bend: None,
        };
        self.forward(piece);
        piece.speed_at(piece.ticks).max(Real::ZERO)
    }

    /// Returns the speed that [`Path::level_out`] ends with.
    pub(super) fn level_speed(&mut self, law: &Law) -> Real {
        let before = self.count;
        let speed = self.level_out(law);
        self.count = before;
        speed
    }
}
