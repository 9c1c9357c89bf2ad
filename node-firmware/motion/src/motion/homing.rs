//! Homing as a command of the queue: it begins when all before it has ended, moves its axis by
//! drives, and what comes behind it begins when it has ended.
//!
//! Owns what happens between [`HomeMachine`] and the axis. Held, it waits where it is: what the
//! machine wants meanwhile is done afterwards, but for a halt, which is done at once.

use super::{Course, Hold, Motion, MotionEvent, Phase, Target};
use crate::{
    StepBackend,
    io::{
        enable::AxisSet,
        home::{HomeEffect, HomeError, HomeEvent, HomeMachine},
    },
};
use keys::{AxisId, Command, StopMode};

/// One axis that is being homed.
#[derive(Clone, Copy, Debug)]
pub(super) struct Homing {
    axis: AxisId,
    machine: HomeMachine,
    /// What is to be done when motion is no longer held.
    waiting: Option<HomeEffect>,
}

impl<B: StepBackend> Motion<'_, B> {
    /// Returns the axis that is being homed.
    pub(super) fn homing_axis(&self) -> Option<AxisId> {
        self.homing.map(|homing| homing.axis)
    }

    /// Returns whether this axis was homed since boot, and its counter agrees.
    pub fn is_homed(&self, axis: AxisId) -> bool {
        let frame = self.frames_steps.get(usize::from(axis.0));
        frame.copied().flatten().is_some()
    }

    /// Begins a command that only runs when all else rests, if one is at the head of the queue.
    pub(super) fn pass_station(&mut self) {
        if !self.is_at_head() {
            return;
        }
        let next = self.ring.peek();
        let beside = match next {
            Some(Command::MoveC { .. }) => AxisSet::C,
            Some(Command::MoveD { .. }) => AxisSet::D,
            _ => AxisSet::NONE,
        };
        if !beside.is_empty() && !self.are_enabled(beside, 0) {
            return;
        }
        self.station = true;
        match next {
            Some(Command::Home { axis }) => self.begin_homing(axis),
            Some(Command::MoveC { index }) => self.begin_c(index),
            Some(Command::MoveD { on }) => self.begin_d(on),
            Some(Command::LidarRead) if self.lidar_wait_ticks.is_some() => self.begin_lidar(),
            _ => self.station = false,
        }
        let first_edge_at = self.now;
        if let Some(start) = self.start.as_mut()
            && self.station
        {
            // What moves now is not what was to start together with others.
            start.first_edge_at.get_or_insert(first_edge_at);
        }
    }

    fn begin_homing(&mut self, axis: AxisId) {
        let index = usize::from(axis.0);
        let machine = self.homes[index].map(HomeMachine::new);
        let Some(Ok(machine)) = machine else {
            unreachable!("such a command is refused, and the configuration is checked")
        };
        self.homing = Some(Homing {
            axis,
            machine,
            waiting: None,
        });
        self.frames_steps[index] = None;
        self.handle_homing(HomeEvent::Begin {
            position_steps: self.position_steps(axis),
            switches: self.switches[index],
        });
    }

    /// Gives an event to the machine and does what it wants.
    pub(super) fn handle_homing(&mut self, event: HomeEvent) {
        let Some(homing) = self.homing.as_mut() else {
            return;
        };
        for effect in homing.machine.handle(event) {
            self.carry_out(effect);
        }
    }

    fn carry_out(&mut self, effect: HomeEffect) {
        let Some(homing) = self.homing.as_mut() else {
            return;
        };
        let axis = homing.axis;
        let index = usize::from(axis.0);
        let held = !matches!(self.hold, Hold::None);
        match effect {
            HomeEffect::Run { .. } if held => homing.waiting = Some(effect),
            HomeEffect::Run {
                to_steps,
                speed_hz,
                accel_hz_per_s,
            } => {
                homing.waiting = None;
                let how = Course::hz(speed_hz, accel_hz_per_s);
                let to_steps = self.target_of(axis, Target::To(to_steps));
                if self.drive_to(axis, to_steps, how).is_err() {
                    // Only a stop can be in the way, and that ends it.
                    self.fail_homing(axis, HomeError::Canceled);
                }
            }
            HomeEffect::Halt(mode) => {
                homing.waiting = held.then_some(effect);
                if !held || mode == StopMode::Halt {
                    self.leave_or_halt(mode);
                }
            }
            HomeEffect::SetPosition(position_steps) => self.name_place(index, position_steps),
            HomeEffect::Done => {
                self.homing = None;
                self.frames_steps[index] = Some(self.origins_steps[index]);
                self.end_station();
                let position_steps = self.position_steps(axis);
                self.tell(MotionEvent::Homed {
                    axis,
                    position_steps,
                });
            }
            HomeEffect::Failed(error) => self.fail_homing(axis, error),
        }
    }

    fn fail_homing(&mut self, axis: AxisId, error: HomeError) {
        self.homing = None;
        let position_steps = self.position_steps(axis);
        self.tell(MotionEvent::HomeFailed {
            axis,
            position_steps,
            error,
        });
    }

    /// The place where an axis rests has this position.
    fn name_place(&mut self, axis: usize, position_steps: i64) {
        let played_steps = self.backend.played_steps(AxisId(axis as u8));
        let origin_steps = position_steps.wrapping_sub(played_steps);
        self.origins_steps[axis] = origin_steps;
        self.planned_origins_steps[axis] = origin_steps;
    }

    /// Does what had to wait while motion was held.
    pub(super) fn pass_homing(&mut self) {
        let Some(effect) = self.homing.and_then(|homing| homing.waiting) else {
            return;
        };
        match (effect, self.hold) {
            (_, Hold::None) => self.carry_out(effect),
            // It rests: what was left of its way is over.
            (HomeEffect::Halt(_), hold) if self.phase == Phase::Rest => {
                if let Some(homing) = self.homing.as_mut() {
                    homing.waiting = None;
                }
                self.leave_or_halt(StopMode::Decelerate);
                self.hold = match hold {
                    Hold::Resuming(_) => Hold::None,
                    _ => Hold::Slowing,
                };
            }
            _ => {}
        }
    }

    /// The drive of an axis that is homed rests. Returns whether there was one.
    pub(super) fn pass_homing_drive(&mut self) -> bool {
        let Some(axis) = self.homing_axis() else {
            return false;
        };
        let position_steps = self.position_steps(axis);
        self.handle_homing(HomeEvent::Rest { position_steps });
        true
    }
}
