//! Brakes: how each axis slows down if the planner does not come back in time.
//!
//! ```text
//!   speed ▲  ______________________
//!         │╱  written              ┊╲  the brake: by the path's acceleration,
//!         └────────────────────────┊─╲───▶  no farther than the path goes this way
//! ```
//!
//! What is written of a path ends in full run, because there is no room for more of it. Behind it the
//! encoder finds the brake, and rests without the planner.
//!
//! What holds then:
//! - *Acceleration*: that of the path, constant; of an S-curve, its greatest. An S-curve's jerk does
//!   not hold: its acceleration jumps where the brake begins and where it rests, by twice that at
//!   most.
//! - *Speed*: it only falls.
//! - *Way*: no axis goes beyond where the known path would have led it.
//! - *The line*: all axes begin to slow down at one time, that of the axis whose segments end first,
//!   each at its first edge behind it, in the proportion of their speeds as of the last whole interval.
//!   So they leave the line on which they were by a step and a half at most. They do not follow a
//!   corner behind it.

use super::{Planner, stretch::Stretch, way::room_of};
use crate::{
    axis::Axis,
    encoder::Brake,
    limits::{CHANNELS, TICK_HZ},
    lookahead::Line,
    real::Real,
    segment::Direction,
};

/// Returns what the square of an axis' speed loses in a step by its share of a line's acceleration:
/// 2a, mHz², at least 1.
fn lost_of(line: &Line, index: usize) -> u64 {
    let hz = Real::of(TICK_HZ);
    let share = Real::of(line.steps[index].unsigned_abs()) / Real::of(line.major_steps);
    let lost = line.law.accel() * share * hz * hz * Real::of(2_000_000);
    u64::try_from(lost.rounded()).unwrap_or(u64::MAX).max(1)
}

/// Returns the way that a line's greatest speed needs to rest, steps of the axis.
fn way_to_rest(line: &Line, index: usize) -> u64 {
    let share = Real::of(line.steps[index].unsigned_abs()) / Real::of(line.major_steps);
    let way = line.speed_max.squared() * share / line.law.accel().twice();
    u64::try_from(way.rounded())
        .unwrap_or(u64::MAX)
        .saturating_add(1)
}

impl Planner {
    /// Returns whether an axis has a brake: only then can it be that one was taken.
    pub(crate) fn has_brakes(&self) -> bool {
        self.braked
    }

    /// Returns whether brakes are to be left, or taken back. Raw moves need none, and a look at the
    /// axes holds their refills off.
    pub(crate) fn wants_brakes(&self) -> bool {
        self.braked || self.is_unfinished()
    }

    /// Leaves a brake on every axis that moves behind the last that is written of the path;
    /// `started_at` is when the channels were started.
    pub(crate) fn leave_brakes(&mut self, axes: &mut [Axis], started_at: u64) {
        let mut brakes = [None; CHANNELS];
        let mut from = u64::MAX;
        for (index, brake) in brakes.iter_mut().take(axes.len()).enumerate() {
            *brake = self.brake_of(index);
            if brake.is_some() {
                from = from.min(self.tails[index].at);
            }
        }
        let from_ticks = from.saturating_sub(started_at);
        self.braked = from < u64::MAX;
        for (axis, brake) in axes.iter_mut().zip(brakes) {
            axis.set_brake(brake.map(|brake| Brake {
                from_ticks,
                ..brake
            }));
        }
    }

    /// The same for axes that are driven each by itself.
    pub(crate) fn leave_way_brakes(&mut self, axes: &mut [Axis]) {
        self.braked = false;
        for (index, axis) in axes.iter_mut().enumerate() {
            let way = self.ways[index].left(&self.stretches[room_of(index)], index);
            self.braked |= way.is_some();
            axis.set_brake(way.map(|(stretch, left)| Brake {
                lost: lost_of(&stretch.line, index),
                steps_max: left + u64::from(self.tails[index].edge_at.is_some()),
                from_ticks: u64::MAX,
            }));
        }
    }

    fn brake_of(&self, index: usize) -> Option<Brake> {
        let direction = self.tails[index].direction?;
        let goes_on = |line: &Line| {
            let steps = line.steps[index];
            (steps != 0 && Direction::of(steps) == direction).then_some(steps.unsigned_abs())
        };
        let whole = |place: usize| {
            let stretch = self.stretches[place].as_ref();
            stretch.map_or(0, |stretch| stretch.whole_steps(index))
        };
        let (stretch, left) = match (self.written(), self.left) {
            (Some(steps), _) => {
                let place = self.writing.checked_sub(1)?;
                (place, steps.left(index, whole(place)))
            }
            // The last line is written, and left at speed.
            (None, Some(_)) => (self.count.checked_sub(1)?, 0),
            (None, None) => return None,
        };
        let Stretch { line, .. } = self.stretches[stretch].as_ref()?;
        goes_on(line)?;
        let mut steps_max = left + u64::from(self.tails[index].edge_at.is_some());
        let enough = way_to_rest(line, index);
        // Parts of one line are one line.
        let mut base = self.stretches[stretch].as_ref()?.base_steps[index];
        let written = self.stretches[..self.count].iter().skip(stretch + 1);
        let fresh = written.flatten().filter(|stretch| {
            let before = core::mem::replace(&mut base, stretch.base_steps[index]);
            before != base
        });
        let lines = fresh.map(|stretch| &stretch.line);
        for line in lines.chain(self.ahead.lines()) {
            if steps_max >= enough {
                break;
            }
            let Some(steps) = goes_on(line) else { break };
            steps_max = steps_max.saturating_add(steps);
        }
        Some(Brake {
            lost: lost_of(line, index),
            steps_max,
            from_ticks: u64::MAX,
        })
    }
}
