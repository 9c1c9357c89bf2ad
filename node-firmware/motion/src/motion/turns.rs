//! Direction pins behind the shift register.
//!
//! They are switched by a task, not in the refill, and what was read back has to confirm them. So
//! an axis with such a pin turns only at rest: a path comes to a halt at the corner where it turns,
//! and nothing steps before the confirmation. Whose direction stays what it is need not wait.

use super::Motion;
use crate::{Direction, StepBackend, limits::CHANNELS, motion::Phase};
use keys::Command;

/// Which axes turn by the shift register, and which way their pins are known to point.
#[derive(Clone, Copy, Debug)]
pub(super) struct Turns {
    external: [bool; CHANNELS],
    pub(super) headings: [Option<Direction>; CHANNELS],
}

impl Turns {
    pub(super) fn new(external: impl Fn(usize) -> bool) -> Self {
        Self {
            external: core::array::from_fn(external),
            headings: [None; CHANNELS],
        }
    }

    /// Returns whether an axis with so many steps has to turn by the register first.
    pub(super) fn must_turn(&self, index: usize, steps: i64) -> bool {
        let turns = self.external[index] && steps != 0;
        turns && self.headings[index] != Some(Direction::of(steps))
    }

    /// Returns whether an axis turns by the register.
    pub(super) fn is_external(&self, index: usize) -> bool {
        self.external[index]
    }

    /// Returns whether a line can follow at speed.
    pub(super) fn joins(&self, command: &Command) -> bool {
        let Command::Line { steps, .. } = *command else {
            return true;
        };
        let mut steps = steps.into_iter().enumerate();
        !steps.any(|(index, steps)| self.must_turn(index, i64::from(steps)))
    }
}

impl<B: StepBackend> Motion<'_, B> {
    /// Returns whether all axes that a command moves point its way. If not, they are turned once
    /// all before it has ended.
    pub(super) fn are_turned(&mut self, command: &Command) -> bool {
        if !self.turns.external.contains(&true) {
            return true;
        }
        if self.phase != Phase::Rest && self.must_turn(command) {
            return false;
        }
        let steps = self.steps_from(command, &self.planned_steps, &self.planned_origins_steps);
        let mut all = true;
        for (index, steps) in steps.into_iter().enumerate().take(self.axis_count) {
            // Several pins are one word.
            all &= self.turn(index, steps);
        }
        all
    }

    /// Returns whether an axis has to turn by the register before this command.
    pub(super) fn must_turn(&self, command: &Command) -> bool {
        let steps = self.steps_from(command, &self.planned_steps, &self.planned_origins_steps);
        let mut axes = 0..self.axis_count;
        axes.any(|index| self.turns.must_turn(index, steps[index]))
    }

    /// Turns an axis that rests. Returns whether it points the way of these steps.
    pub(super) fn turn(&mut self, index: usize, steps: i64) -> bool {
        if !self.turns.external[index] || steps == 0 {
            return true;
        }
        let direction = Direction::of(steps);
        if self.turns.headings[index] != Some(direction) {
            let level = self.backend.axes()[index].direction_level(direction);
            if !self.turn_pin(index, level) {
                self.turns.headings[index] = None;
                return false;
            }
            self.turns.headings[index] = Some(direction);
        }
        self.planner
            .take_direction(index, &mut self.backend.axes()[index], direction);
        true
    }

    /// Turns C (by the number behind the axes of the queue) or D. Returns whether it points that
    /// way.
    pub(super) fn turn_beside(&mut self, index: usize, direction: Direction) -> bool {
        self.turn_pin(index, direction == Direction::Positive)
    }
}
