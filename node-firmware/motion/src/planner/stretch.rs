//! A stretch of path: a line, or a part of one where it was changed in flight.

use crate::{
    law::Law,
    limits::CHANNELS,
    lookahead::Line,
    path::{Path, State},
    profile::Timing,
    real::Real,
    steps::{Exit, Moment, Steps},
};
use keys::Command;

/// What a stretch of path does at its end.
#[derive(Clone, Copy, Debug)]
pub(super) enum Goal {
    /// It makes the line's way and leaves it at this speed.
    Leave(Real),
    /// It comes to rest as soon as the law allows, or leaves the line slowing down.
    Rest(Ease),
}

/// Limits of a braking that leads over corners, in the measure of its first line: those of all lines
/// that it may reach. An S-curve's braking that was begun harder could not end as softly as
/// the next line wants it.
#[derive(Clone, Copy, Debug)]
pub(super) struct Ease {
    accel_max: Real,
    jerk_max: Real,
}

impl Ease {
    /// None: a line's own limits.
    pub(super) fn none(line: &Line) -> Self {
        Self {
            accel_max: line.law.accel(),
            jerk_max: line.law.jerk().unwrap_or(Real::ZERO),
        }
    }

    /// Looks at the lines behind `line`, which is left in this state, as far as it is needed. It
    /// may be left at `exit_speed` at most: where a softer braking is faster than that at the
    /// corner, it brakes by its own limits.
    pub(super) fn of(
        line: &Line,
        from: State,
        exit_speed: Real,
        behind: impl Iterator<Item = Command>,
    ) -> Self {
        let own = Self::none(line);
        if line.law.jerk().is_none() {
            return own;
        }
        let mut ease = own;
        let whole = Real::of(line.major_steps);
        let mut way = whole;
        for next in behind.map_while(|command| Line::of(&command)) {
            let mut path = Path::at(from);
            path.come_to_rest(&ease.law(line));
            if path.end_steps() <= way {
                break;
            }
            let share = next.stretch / line.stretch;
            if let Some(jerk) = next.law.jerk() {
                ease.accel_max = ease.accel_max.min(next.law.accel() * share);
                ease.jerk_max = ease.jerk_max.min(jerk * share);
            }
            way = way + Real::of(next.major_steps) * share;
        }
        if way > whole {
            let mut path = Path::at(from);
            slow_down(&mut path, whole, &ease.law(line));
            let speed = path.end_state().speed;
            if speed > exit_speed + exit_speed.shifted(-SLACK_BITS) {
                return own;
            }
        }
        ease
    }

    fn law(&self, line: &Line) -> Law {
        line.law.eased(self.accel_max, self.jerk_max)
    }
}

/// A stretch of path: a line, or a part of one where it was changed in flight. Small, so that many
/// can be kept; its path and its edges are made when they are written.
#[derive(Clone, Copy, Debug)]
pub(super) struct Stretch {
    pub(super) line: Line,
    pub(super) from: State,
    pub(super) goal: Goal,
    /// It was left at this time for another one.
    pub(super) until: Option<Real>,
    pub(super) begin: Moment,
    pub(super) end_ticks: u64,
    pub(super) exit: Exit,
    /// Share of its line's speed that it was planned with, 2⁻¹⁶.
    pub(super) share: u32,
    /// Booked steps of each axis where the line began.
    pub(super) base_steps: [i64; CHANNELS],
}

impl Stretch {
    pub(super) fn path(&self) -> Path {
        let mut path = Path::at(self.from);
        self.plan(&mut path);
        path
    }

    /// Plans its path in this place.
    pub(super) fn plan(&self, path: &mut Path) {
        let way = Real::of(self.line.major_steps);
        let law = &self.line.law;
        path.restart(self.from);
        match self.goal {
            Goal::Leave(speed) => {
                let most = self.line.speed_max;
                path.go_on(way, speed, most, law)
                    .or_else(|_| path.go_on(way, self.from.speed, most, law))
                    .unwrap_or_else(|_| slow_down(path, way, law));
            }
            Goal::Rest(ease) => slow_down(path, way, &ease.law(&self.line)),
        }
        if let Some(ticks) = self.until {
            path.cut(ticks);
        }
    }

    /// Takes the edges of its path, which is planned there.
    pub(super) fn take_steps(&self, steps: &mut Steps<CHANNELS>, timing: &[Timing]) {
        let line = &self.line;
        steps.take(self.begin, self.exit, line.major_steps, line.steps, timing);
    }

    /// Returns the edges of an axis up to which its line goes on behind what it was left for; 0: not
    /// farther than here.
    pub(super) fn whole_steps(&self, index: usize) -> u64 {
        match (self.goal, self.until) {
            (Goal::Leave(_), Some(_)) => self.line.steps[index].unsigned_abs(),
            _ => 0,
        }
    }

    /// Plans its path and takes its edges on one axis alone.
    pub(super) fn take_steps_of(&self, index: usize, steps: &mut Steps<1>, timing: &[Timing]) {
        self.plan(steps.path_mut());
        let line = &self.line;
        let own = [line.steps[index]];
        let timing = &timing[index..=index];
        steps.take(self.begin, self.exit, line.major_steps, own, timing);
    }
}

/// Speeds that differ by less than 2⁻³⁰ of them are the same.
const SLACK_BITS: i32 = 30;

/// Comes to rest, at the latest where the line ends.
fn slow_down(path: &mut Path, way: Real, law: &Law) {
    path.come_to_rest(law);
    if path.end_steps() > way {
        path.cut(path.ticks_at(way));
    }
}
