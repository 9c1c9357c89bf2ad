//! Inputs: levels in; limits, homing, stop and probe out.
//!
//! A limit that an axis runs into is told while it runs, for whoever has the stop path; a command
//! that would lead further into a pressed one is told before anything of it moves. An axis that
//! leaves its limit may: a switch bounces, and a motor has to get off it somehow.

use super::{Hold, LimitHit, Motion, MotionEvent, Phase};
use crate::{
    Direction, StepBackend,
    io::{
        home::HomeEvent,
        input::{InputEvent, PinLevel, Role, Switch},
    },
    limits::CHANNELS,
    planner::runs_of,
};
use keys::{AxisId, Command};

impl<B: StepBackend> Motion<'_, B> {
    /// Takes the level of an input pin. Call [`Motion::poll`] up to its time before, and again
    /// after it.
    pub fn input(&mut self, level: PinLevel) {
        for event in self.inputs.level(level) {
            self.take_input(event);
        }
    }

    /// Returns whether an input of this role is active.
    pub fn is_input_active(&self, role: Role) -> bool {
        self.inputs.is_active(role)
    }

    /// Takes the inputs that count by now.
    pub(super) fn pass_inputs(&mut self) {
        while let Some(event) = self.inputs.poll(self.now) {
            self.take_input(event);
        }
    }

    fn take_input(&mut self, event: InputEvent) {
        let InputEvent {
            role,
            active,
            counted_steps,
            ..
        } = event;
        match role {
            Role::Axis { axis, switch } => {
                let index = usize::from(axis.0);
                self.switches[index].set(switch, active);
                if self.homing_axis() == Some(axis) {
                    let at_position_steps = self.named(index, counted_steps[index]);
                    self.handle_homing(HomeEvent::Input {
                        switch,
                        active,
                        at_position_steps,
                    });
                } else {
                    self.watch_limits();
                }
            }
            Role::C(switch) => self.limit_c(switch, active),
            Role::D(switch) => self.limit_d(switch, active),
            Role::Stop => self.tell(MotionEvent::StopInput { active }),
            Role::Probe => {
                let positions_steps =
                    core::array::from_fn(|index| self.named(index, counted_steps[index]));
                self.tell(MotionEvent::Probe {
                    active,
                    positions_steps,
                });
            }
        }
    }

    /// Returns the position of a count of steps since boot, by the present name of the place.
    fn named(&self, axis: usize, counted_steps: i64) -> i64 {
        self.origins_steps[axis].wrapping_add(counted_steps)
    }

    /// Notes which way each axis goes, and tells of one that goes into a limit.
    pub(super) fn note_headings(&mut self) {
        let rests = self.phase == Phase::Rest;
        for index in 0..self.axis_count {
            let played = self.backend.played_steps(AxisId(index as u8));
            let made = played - self.seen_steps[index];
            self.seen_steps[index] = played;
            if rests {
                self.headings[index] = None;
            } else if made != 0 {
                self.headings[index] = Some(Direction::of(made));
            }
        }
        self.watch_limits();
    }

    fn watch_limits(&mut self) {
        for index in 0..self.axis_count {
            let axis = AxisId(index as u8);
            let pressed = self.headings[index].and_then(|way| self.pressed(index, way));
            if let Some(switch) = pressed.filter(|_| self.homing_axis() != Some(axis)) {
                self.tell_limit(axis, LimitHit::Switch(switch));
            }
        }
    }

    /// Returns the limit that is pressed at this end of an axis.
    pub(super) fn pressed(&self, axis: usize, way: Direction) -> Option<Switch> {
        let limit = match way {
            Direction::Positive => Switch::Max,
            Direction::Negative => Switch::Min,
        };
        self.switches[axis].get(limit).then_some(limit)
    }

    /// Tells of a limit, once until the stop that follows from it.
    pub(super) fn tell_limit(&mut self, axis: AxisId, hit: LimitHit) {
        if self.limit_told || self.phase == Phase::Stopped {
            return;
        }
        self.limit_told = true;
        let position_steps = self.position_steps(axis);
        self.tell(MotionEvent::Limit {
            axis,
            position_steps,
            hit,
        });
    }

    /// Tells of a command at the head of the queue that must not begin, as soon as nothing else
    /// moves or it would follow without a rest.
    pub(super) fn refuse_blocked(&mut self, command: &Command) -> bool {
        let Some((axis, hit)) = self.blocked(command) else {
            return false;
        };
        let rests = self.phase == Phase::Rest && self.marks.front().is_none();
        if rests || self.planner.is_at_speed() {
            self.tell_limit(axis, hit);
        }
        true
    }

    /// Returns the axis that a command would move further into a pressed limit, or out of its soft
    /// limits.
    fn blocked(&self, command: &Command) -> Option<(AxisId, LimitHit)> {
        if self.is_stopping() {
            return None;
        }
        let steps = self.steps_from(command, &self.planned_steps, &self.planned_origins_steps);
        if let Some(reached) = self.reach_of(&steps) {
            return Some(reached);
        }
        (0..self.axis_count).find_map(|index| {
            let way = steps[index];
            if way == 0 {
                return None;
            }
            let axis = AxisId(index as u8);
            let switch = self.pressed(index, Direction::of(way))?;
            // What is planned before may lead away from it.
            let ahead_steps = self.planned_steps[index] - self.backend.played_steps(axis);
            let leaves_first = ahead_steps.signum() == -way.signum();
            let command = self.next_command();
            (!leaves_first).then_some((axis, LimitHit::Blocked { command, switch }))
        })
    }

    /// Returns how far a command moves each axis from these steps since boot.
    pub(super) fn steps_from(
        &self,
        command: &Command,
        from_steps: &[i64; CHANNELS],
        origins_steps: &[i64; CHANNELS],
    ) -> [i64; CHANNELS] {
        if let Some((line, _)) = self.line_from(command, from_steps, origins_steps) {
            return line.steps;
        }
        let mut steps = [0; CHANNELS];
        for run in runs_of(command) {
            steps[usize::from(run.axis.0)] = i64::from(run.steps);
        }
        steps
    }

    /// Number of the command at the head of the queue.
    pub(super) fn next_command(&self) -> u64 {
        self.executed_commands + self.marks.iter().count() as u64
    }

    /// Keeps an event for the next [`Motion::poll`].
    pub(super) fn tell(&mut self, event: MotionEvent) {
        // Cannot fail: a call adds at most two, and each poll gives all of them.
        let _ = self.told.push_back(event);
    }

    /// Returns whether nothing moves or waits before the head of the queue.
    pub(super) fn is_at_head(&self) -> bool {
        self.phase == Phase::Rest
            && self.marks.front().is_none()
            && !self.is_driving()
            && !self.station
            && matches!(self.hold, Hold::None)
    }
}
