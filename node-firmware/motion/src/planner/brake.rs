//! Brakes: how each axis slows down if the planner does not come back in time.
//!
//! ```text
//!   speed ▲  ______________________
//!         │╱  written              ┊╲  the brake: by the path's acceleration,
//!         └────────────────────────┊─╲───▶  no farther than the path goes this way
//! ```
//!
//! What is written of a path ends in full run, because there is no room for more of it. Behind it the
//! encoder finds the brake, and rests without the planner. The axes of a line slow down in the
//! proportion of their speeds, and so on the line, if their segments end together; if not, each stays
//! on its own way, and no axis goes beyond where the known path would have led it.

use super::{Planner, stretch::Stretch, way::room_of};
use crate::{
    axis::Axis, encoder::Brake, limits::TICK_HZ, lookahead::Line, real::Real, segment::Direction,
};

/// Returns the share of a line's acceleration that an axis has, steps/s², at least 1.
fn accel_of(line: &Line, index: usize) -> u32 {
    let hz = Real::of(TICK_HZ);
    let share = Real::of(line.steps[index].unsigned_abs()) / Real::of(line.major_steps);
    let accel = (line.law.accel() * share * hz * hz).rounded();
    u32::try_from(accel).unwrap_or(u32::MAX).max(1)
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

    /// Leaves a brake on every axis that moves behind the last that is written of the path.
    pub(crate) fn leave_brakes(&mut self, axes: &mut [Axis]) {
        self.braked = false;
        for (index, axis) in axes.iter_mut().enumerate() {
            let brake = self.brake_of(index);
            self.braked |= brake.is_some();
            axis.set_brake(brake);
        }
    }

    /// The same for axes that are driven each by itself.
    pub(crate) fn leave_way_brakes(&mut self, axes: &mut [Axis]) {
        self.braked = false;
        for (index, axis) in axes.iter_mut().enumerate() {
            let way = self.ways[index].left(&self.stretches[room_of(index)], index);
            self.braked |= way.is_some();
            axis.set_brake(way.map(|(stretch, left)| Brake {
                accel_hz_per_s: accel_of(&stretch.line, index),
                steps_max: left + u64::from(self.tails[index].edge_at.is_some()),
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
            accel_hz_per_s: accel_of(line, index),
            steps_max,
        })
    }
}
