//! [`Path`]: where a move is at every instant, and when it passes a place. The ideal, without
//! steps: place and time are [`Real`].
//!
//! ```text
//!  speed ▲      ┌───────────┐          phases forward: from their begin, where the speed is low
//!        │    ╱ │   coast   │ ╲        phases backward: from their end, likewise
//!        │  ╱   │           │   ╲
//!        └─┴────┴───────────┴─────┴──▶ time
//! ```
//!
//! Each phase counts from the end where it is slow, so that no time is the difference of two large
//! numbers: the last edge before rest is as exact as the first one after it.

mod change;
mod phase;

pub(crate) use phase::{Course, Pass, Span};

use change::Change;
use phase::Phase;

use crate::{
    law::{Law, Piece},
    real::Real,
};

/// Most phases: a change of acceleration, a slower speed (3), up (3), coast, down (3).
const PHASES_MAX: usize = 12;

/// Where a move is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct State {
    /// Place, steps along the move.
    pub place: Real,
    /// Speed, steps per tick, never negative.
    pub speed: Real,
    /// Acceleration, steps per tick².
    pub accel: Real,
}

impl State {
    /// At rest at the begin.
    pub const REST: Self = Self {
        place: Real::ZERO,
        speed: Real::ZERO,
        accel: Real::ZERO,
    };
}

/// The way is too short to slow down as asked.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct TooShort;

/// A motion along one coordinate.
#[derive(Clone, Copy, Debug)]
pub struct Path {
    begin: State,
    phases: [Phase; PHASES_MAX],
    count: usize,
}

impl Path {
    /// A path that has not begun.
    pub const fn at(begin: State) -> Self {
        Self {
            begin,
            phases: [Phase::rest(Real::ZERO, begin.place); PHASES_MAX],
            count: 0,
        }
    }

    /// Becomes one that has not begun, in place: a path has some 3 KB.
    pub(crate) const fn restart(&mut self, begin: State) {
        self.begin = begin;
        self.count = 0;
    }

    /// Plans the fastest motion to the place `to_place`, with `to_speed` there.
    ///
    /// # Errors
    /// [`TooShort`]: it would be passed faster than that.
    pub fn plan(
        begin: State,
        to_place: Real,
        to_speed: Real,
        speed_max: Real,
        law: &Law,
    ) -> Result<Self, TooShort> {
        let mut path = Self::at(begin);
        path.go_on(to_place, to_speed, speed_max, law)?;
        Ok(path)
    }

    /// Goes on to `to_place` from where the path ends so far.
    ///
    /// # Errors
    /// [`TooShort`], as [`Path::plan`]; nothing is changed.
    pub fn go_on(
        &mut self,
        to_place: Real,
        to_speed: Real,
        speed_max: Real,
        law: &Law,
    ) -> Result<(), TooShort> {
        if self.brakes_for(to_place, to_speed, law) {
            return Ok(());
        }
        self.go_on_below(to_place, to_speed, speed_max, law)
            .or_else(|TooShort| {
                // An S-curve needs more way to slow down in two parts, to the new speed and then to
                // the end, than in one.
                let speed = self.end_state().speed;
                self.go_on_below(to_place, to_speed, speed_max.max(speed), law)
            })
            .or_else(|TooShort| {
                let speed = self.level_speed(law);
                self.go_on_below(to_place, to_speed, speed, law)
            })
            .or_else(|TooShort| self.brake_on(to_place, to_speed, law))
    }

    fn go_on_below(
        &mut self,
        to_place: Real,
        to_speed: Real,
        speed_max: Real,
        law: &Law,
    ) -> Result<(), TooShort> {
        let before = self.count;
        let to_speed = to_speed.min(speed_max);
        if self.rise_on(to_place, to_speed, speed_max, law) {
            return Ok(());
        }
        let mut speed = speed_max;
        if !self.fall_on(speed_max, law) {
            speed = self.level_out(law);
            if speed > speed_max {
                self.fall(speed, speed_max, law);
                speed = speed_max;
            }
        }
        let way = to_place - self.end_steps();
        let least = if speed > to_speed {
            law.way(to_speed, speed)
        } else {
            law.way(speed, to_speed)
        };
        // Rounding in the last bits is no lack of way.
        if least > way + way.abs().shifted(-SLACK_BITS) + Real::of(1).shifted(-SLACK_BITS) {
            self.count = before;
            return Err(TooShort);
        }
        let peak = law.peak(way, speed, to_speed, Some(speed_max));
        for piece in law.rise(speed, peak).pieces() {
            self.forward(*piece);
        }
        self.end_from(peak, to_place, to_speed, law);
        Ok(())
    }

    /// Goes on at this speed, and slows down to `to_speed` where it has to.
    fn end_from(&mut self, peak: Real, to_place: Real, to_speed: Real, law: &Law) {
        let down = law.rise(to_speed, peak);
        let coast = to_place - self.end_steps() - down.way();
        if !coast.is_none() && !peak.is_none() {
            self.forward(Piece::steady(coast / peak, peak));
        }
        // From the end: the last piece first.
        let end_ticks = self.ticks() + down.ticks();
        self.backward(down.pieces(), end_ticks, to_place);
    }

    /// Returns the highest speed that is reached within `way` from this state, at most `speed_max`.
    pub(crate) fn speed_reached(from: State, way: Real, speed_max: Real, law: &Law) -> Real {
        let State { speed, .. } = from;
        let reached = match Change::of(&from, law) {
            None => None,
            Some(Change {
                jerk,
                since,
                gain,
                is_rise: true,
            }) => {
                // As if the rise had begun a while ago; its acceleration has to end within the way.
                let begun = (speed - gain).max(Real::ZERO);
                let made = (begun + (jerk * since.squared()).half().third()) * since;
                let reached = law.speed_before(way + made, begun, speed_max);
                (reached >= speed + gain).then_some(reached)
            }
            Some(_) => {
                let mut path = Self::at(from);
                let level = path.level_out(law);
                let left = way - (path.end_steps() - from.place);
                (!left.is_none()).then(|| law.speed_before(left, level, speed_max))
            }
        };
        reached.unwrap_or_else(|| law.speed_before(way, speed, speed_max))
    }

    /// Slows down to rest as fast as the law allows, wherever that is.
    pub fn come_to_rest(&mut self, law: &Law) {
        if self.fall_on(Real::ZERO, law) {
            return;
        }
        let speed = self.level_out(law);
        self.fall(speed, Real::ZERO, law);
    }

    /// Returns its duration, ticks.
    pub fn ticks(&self) -> Real {
        self.last().map_or(Real::ZERO, |phase| phase.end_ticks)
    }

    /// Returns the place where it begins, steps.
    pub fn begin_steps(&self) -> Real {
        self.begin.place
    }

    /// Returns the place where it ends, steps.
    pub fn end_steps(&self) -> Real {
        self.last()
            .map_or(self.begin.place, |phase| phase.end_steps)
    }

    /// Returns the state at its end.
    pub fn end_state(&self) -> State {
        self.last()
            .map_or(self.begin, |phase| phase.state_at(phase.end_ticks))
    }

    /// Returns when the place is passed, ticks from the begin. Before the begin is at the begin,
    /// behind the end at the end.
    pub fn ticks_at(&self, place: Real) -> Real {
        let phases = &self.phases[..self.count];
        match phases.iter().find(|phase| place <= phase.end_steps) {
            Some(phase) => phase.ticks_at(place),
            None => self.ticks(),
        }
    }

    /// Returns the phase at `place` and how the place is passed; behind the end, a phase without
    /// motion.
    pub(crate) fn enter(&self, place: Real) -> (Span, Pass) {
        let phases = &self.phases[..self.count];
        match phases.iter().position(|phase| place <= phase.end_steps) {
            Some(index) => Span::enter(index, &phases[index], place),
            None => Span::enter(self.count, &self.end_phase(), place),
        }
    }

    /// Returns the place up to which a phase lasts, steps.
    pub(crate) fn span_end_steps(&self, span: &Span) -> Real {
        let phases = &self.phases[..self.count];
        let phase = phases.get(span.index);
        phase.map_or_else(|| self.end_steps(), |phase| phase.end_steps)
    }

    /// Returns how a place of this phase is passed, near `guess_ticks`.
    pub(crate) fn pass(&self, span: &Span, place: Real, guess_ticks: Real) -> Pass {
        match self.phases[..self.count].get(span.index) {
            Some(phase) => span.pass(phase, place, guess_ticks),
            None => span.pass(&self.end_phase(), place, guess_ticks),
        }
    }

    /// Tells when a place of a phase was found to be passed, near which the next ones are.
    pub(crate) fn know(&self, span: &mut Span, place: Real, ticks: Real) {
        if let Some(phase) = self.phases[..self.count].get(span.index) {
            span.know(phase, place, ticks);
        }
    }

    fn end_phase(&self) -> Phase {
        Phase::rest(self.ticks(), self.end_steps())
    }

    /// Returns where it is, `ticks` after its begin.
    pub fn state_at(&self, ticks: Real) -> State {
        let phases = &self.phases[..self.count];
        match phases.iter().find(|phase| ticks <= phase.end_ticks) {
            Some(phase) => phase.state_at(ticks),
            None => State {
                accel: Real::ZERO,
                ..self.end_state()
            },
        }
    }

    /// Forgets what comes later than this.
    pub fn cut(&mut self, ticks: Real) {
        let phases = &self.phases[..self.count];
        let Some(index) = phases.iter().position(|phase| ticks <= phase.end_ticks) else {
            return;
        };
        let phase = &mut self.phases[index];
        phase.end_steps = phase.state_at(ticks).place;
        phase.end_ticks = ticks;
        self.count = index + 1;
    }

    fn last(&self) -> Option<&Phase> {
        self.phases[..self.count].last()
    }

    fn push(&mut self, phase: Phase) {
        assert!(self.count < PHASES_MAX, "a path has few phases");
        self.phases[self.count] = phase;
        self.count += 1;
    }

    fn forward(&mut self, piece: Piece) {
        let (ticks, place) = (self.ticks(), self.end_steps());
        self.push(Phase {
            end_ticks: ticks + piece.ticks,
            end_steps: place + piece.way(),
            anchor_ticks: ticks,
            anchor_steps: place,
            backward: false,
            piece,
        });
    }

    /// Appends what is still to come of a rise read backwards, which ends at this time and place.
    fn backward(&mut self, pieces: &[Piece], end_ticks: Real, end_steps: Real) {
        let first = self.count;
        let now = self.ticks();
        let (mut ticks, mut place) = (end_ticks, end_steps);
        for piece in pieces {
            if ticks <= now {
                break;
            }
            self.push(Phase {
                end_ticks: ticks,
                end_steps: place,
                anchor_ticks: ticks,
                anchor_steps: place,
                backward: true,
                piece: *piece,
            });
            ticks = ticks - piece.ticks;
            place = place - piece.way();
        }
        self.phases[first..self.count].reverse();
    }

    /// Slows down from `high` to `low`.
    fn fall(&mut self, high: Real, low: Real, law: &Law) {
        let down = law.rise(low, high);
        let end_ticks = self.ticks() + down.ticks();
        let end_steps = self.end_steps() + down.way();
        self.backward(down.pieces(), end_ticks, end_steps);
    }
}

/// Differences below 2⁻³⁰ of a way are rounding.
const SLACK_BITS: i32 = 30;
