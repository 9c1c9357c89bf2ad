//! Soft limits: how far an axis may go, in the frame of the machine.
//!
//! The frame is fixed by homing. Renaming a place (`set_position`) does not move the limits of an
//! axis that is homed; before that, limits that count from boot on go by the names. A command that
//! would end outside is refused with its batch if what comes before it tells where it begins, else
//! when its turn comes; either way nothing of it moves. Every command leads each axis straight from
//! where it begins to where it ends, so these two places are all that matters; a way back inside is
//! always open.

use super::{CommandError, LimitHit, Motion};
use crate::{StepBackend, limits::CHANNELS};
use keys::{AxisId, Command};

/// How far an axis may go, both ends included.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct SoftLimits {
    /// Lowest position, steps.
    pub min_steps: i64,
    /// Highest position, steps, above `min_steps`.
    pub max_steps: i64,
    /// Whether they count before the axis is homed, too.
    pub from_boot: bool,
}

impl SoftLimits {
    /// Returns the end that a way from `from` leads beyond.
    fn passed(&self, from_steps: i64, way_steps: i64) -> Option<Beyond> {
        let target_steps = from_steps.saturating_add(way_steps);
        let bound_steps = match way_steps.signum() {
            1 if target_steps > self.max_steps => self.max_steps,
            -1 if target_steps < self.min_steps => self.min_steps,
            _ => return None,
        };
        Some(Beyond {
            target_steps,
            bound_steps,
        })
    }
}

/// A place outside of soft limits.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Beyond {
    /// The place.
    pub target_steps: i64,
    /// The limit.
    pub bound_steps: i64,
}

impl core::fmt::Display for Beyond {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        let Self {
            target_steps,
            bound_steps,
        } = self;
        write!(f, "to {target_steps}, beyond its soft limit {bound_steps}")
    }
}

/// Where the axes will be when all that was accepted has ended, as far as that is known.
#[derive(Clone, Copy, Debug)]
pub struct Outlook {
    /// Steps since boot.
    steps: [i64; CHANNELS],
    /// Position = origin + steps.
    origins_steps: [i64; CHANNELS],
    /// Not behind a homing.
    known: [bool; CHANNELS],
}

impl<B: StepBackend> Motion<'_, B> {
    /// Returns where the axes will be; `None` without soft limits.
    pub fn outlook(&self) -> Option<Outlook> {
        let limits = &self.soft_limits[..self.axis_count];
        limits.iter().any(Option::is_some).then_some(())?;
        let mut outlook = Outlook {
            steps: self.planned_steps,
            origins_steps: self.planned_origins_steps,
            known: [true; CHANNELS],
        };
        for command in (0..).map_while(|index| self.ring.peek_at(index)) {
            self.pass(&mut outlook, &command);
        }
        Some(outlook)
    }

    /// Checks that a command, which comes next, stays within the soft limits.
    ///
    /// # Errors
    /// [`CommandError::Beyond`].
    pub fn check_reach(
        &self,
        outlook: &mut Outlook,
        command: &Command,
    ) -> Result<(), CommandError> {
        let steps = self.pass(outlook, command);
        for (index, way) in steps.into_iter().enumerate().take(self.axis_count) {
            let end = outlook.steps[index];
            if let Some(beyond) = self
                .beyond(
                    index,
                    end.wrapping_sub(way),
                    way,
                    outlook.origins_steps[index],
                )
                .filter(|_| outlook.known[index])
            {
                let axis = AxisId(index as u8);
                return Err(CommandError::Beyond { axis, beyond });
            }
        }
        Ok(())
    }

    /// Adds a command; gives the way of each axis.
    fn pass(&self, outlook: &mut Outlook, command: &Command) -> [i64; CHANNELS] {
        match *command {
            Command::Home { axis } => outlook.known[usize::from(axis.0)] = false,
            Command::SetPosition {
                axis,
                position_steps,
            } => {
                let index = usize::from(axis.0);
                outlook.origins_steps[index] = position_steps.wrapping_sub(outlook.steps[index]);
            }
            _ => {}
        }
        let steps = self.steps_from(command, &outlook.steps, &outlook.origins_steps);
        for (to, steps) in outlook.steps.iter_mut().zip(steps) {
            *to = to.wrapping_add(steps);
        }
        steps
    }

    /// Returns whether a way leads out of the soft limits that count now; `from` is steps since
    /// boot.
    fn beyond(&self, axis: usize, from: i64, way: i64, origin_steps: i64) -> Option<Beyond> {
        let limits = self.soft_limits[axis]?;
        let frame_steps = match self.frames_steps[axis] {
            Some(frame_steps) => frame_steps,
            None if limits.from_boot => origin_steps,
            None => return None,
        };
        limits.passed(frame_steps.wrapping_add(from), way)
    }

    /// The command at the head of the queue leads out of the soft limits.
    pub(super) fn reach_of(&self, steps: &[i64; CHANNELS]) -> Option<(AxisId, LimitHit)> {
        (0..self.axis_count).find_map(|index| {
            let origin_steps = self.planned_origins_steps[index];
            let from = self.planned_steps[index];
            let beyond = self.beyond(index, from, steps[index], origin_steps)?;
            let command = self.next_command();
            Some((AxisId(index as u8), LimitHit::Soft { command, beyond }))
        })
    }

    /// Holds the target of a drive inside, steps since boot.
    pub(super) fn held_inside(&self, axis: usize, to_steps: i64) -> i64 {
        let from = self.planned_steps[axis];
        let origin_steps = self.planned_origins_steps[axis];
        let way = to_steps.saturating_sub(from);
        match self.beyond(axis, from, way, origin_steps) {
            Some(beyond) => {
                let out = beyond.target_steps.saturating_sub(beyond.bound_steps);
                let inside = from.saturating_add(way).saturating_sub(out);
                // From outside it does not go farther.
                if way < 0 {
                    inside.min(from)
                } else {
                    inside.max(from)
                }
            }
            None => to_steps,
        }
    }
}
