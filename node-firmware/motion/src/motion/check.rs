//! What can be executed here, asked before a command is taken.

use super::{Beyond, Motion};
use crate::{
    StepBackend,
    io::named::GotoError,
    limits::TICK_HZ,
    planner::{runs_of, ticks_of},
};
use keys::{
    AxisId, Command,
    command::{POSITION_C_MAX, RampShape},
};

/// Why a command cannot be executed here.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum CommandError {
    /// The node has no such axis.
    Axis(AxisId),
    /// This firmware cannot do it.
    NotSupported,
    /// The axis has no reference switch.
    NoHome(AxisId),
    /// The interval is shorter than the driver's pulse, ns.
    TooFast {
        /// The shortest interval of the axis.
        interval_ns_min: u32,
    },
    /// A step count of 0, or an interval of 0.
    Nothing,
    /// It would take longer than [`COMMAND_TICKS_MAX`](crate::limits::COMMAND_TICKS_MAX).
    TooLong,
    /// A value out of range.
    Range,
    /// C has no such position.
    PositionC,
    /// An axis would leave its soft limits.
    Beyond {
        /// The axis.
        axis: AxisId,
        /// Where to.
        beyond: Beyond,
    },
}

impl CommandError {
    /// The driver's pulse needs this much from step to step.
    pub(super) fn too_fast(interval_ticks_min: u64) -> Self {
        let ns = (interval_ticks_min * 1_000_000_000).div_ceil(TICK_HZ);
        Self::TooFast {
            interval_ns_min: u32::try_from(ns).unwrap_or(u32::MAX),
        }
    }
}

impl core::fmt::Display for CommandError {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        match self {
            Self::Axis(axis) => write!(f, "there is no axis {}", axis.0),
            Self::NotSupported => write!(f, "not supported by this node's firmware"),
            Self::NoHome(axis) => write!(f, "axis {} has no reference switch", axis.0),
            Self::TooFast { interval_ns_min } => write!(
                f,
                "the driver needs at least {interval_ns_min} ns from step to step"
            ),
            Self::Nothing => write!(f, "no steps, or no time between them"),
            Self::TooLong => write!(f, "it would take thousands of years"),
            Self::Range => write!(f, "a value is out of range"),
            Self::PositionC => GotoError::Position.fmt(f),
            Self::Beyond { axis, beyond } => write!(f, "axis {} would move {beyond}", axis.0),
        }
    }
}

impl core::error::Error for CommandError {}

impl<B: StepBackend> Motion<'_, B> {
    /// Returns whether the command can be executed here.
    ///
    /// # Errors
    /// Why not.
    pub fn check(&self, command: &Command) -> Result<(), CommandError> {
        if let Some(axis) = command.axis_max()
            && usize::from(axis.0) >= self.axis_count
        {
            return Err(CommandError::Axis(axis));
        }
        if !self.features().has(command.feature()) {
            return Err(match *command {
                Command::Home { axis } => CommandError::NoHome(axis),
                _ => CommandError::NotSupported,
            });
        }
        match *command {
            Command::Move {
                delay_us, steps, ..
            } if delay_us == 0 || steps == 0 => return Err(CommandError::Nothing),
            Command::SyncMove { delay_us, steps } if delay_us.contains(&0) || steps == [0, 0] => {
                return Err(CommandError::Nothing);
            }
            Command::Laser { power_percent } if power_percent > 100 => {
                return Err(CommandError::Range);
            }
            Command::MoveC { index } if index > POSITION_C_MAX => {
                return Err(CommandError::PositionC);
            }
            _ => {}
        }
        self.check_ramp(command)?;
        for run in runs_of(command) {
            let least = self.timing[usize::from(run.axis.0)].interval_ticks_min();
            if run.steps == i32::MIN {
                return Err(CommandError::Range);
            }
            if run.interval_ticks < least {
                return Err(CommandError::too_fast(least));
            }
        }
        ticks_of(command).map(|_| ()).ok_or(CommandError::TooLong)
    }

    pub(super) fn check_ramp(&self, command: &Command) -> Result<(), CommandError> {
        let too_fast = |axis: usize, speed_hz: u32, share: u64, of: u64| {
            let least = self.timing[axis].interval_ticks_min();
            let fast = u128::from(speed_hz) * u128::from(share) * u128::from(least)
                > u128::from(TICK_HZ) * u128::from(of);
            fast.then_some(CommandError::too_fast(least))
        };
        match *command {
            Command::Ramp { steps: 0, .. } => Err(CommandError::Nothing),
            Command::Ramp {
                steps: i32::MIN, ..
            } => Err(CommandError::Range),
            Command::Ramp { axis, ramp, .. } | Command::RampTo { axis, ramp, .. } => {
                let no_rise = match ramp.shape {
                    RampShape::Smooth {
                        start_hz,
                        ramp_steps,
                    } => start_hz == 0 || start_hz >= ramp.speed_hz || ramp_steps < 2,
                    RampShape::Jerk { jerk_hz_per_s2: 0 } => true,
                    RampShape::Trapezoid { .. } | RampShape::Jerk { .. } => {
                        ramp.accel_hz_per_s == 0
                    }
                };
                if ramp.speed_hz == 0 || no_rise {
                    return Err(CommandError::Nothing);
                }
                too_fast(usize::from(axis.0), ramp.speed_hz, 1, 1).map_or(Ok(()), Err)
            }
            Command::Line {
                steps,
                speed_hz,
                accel_hz_per_s,
                ..
            } => {
                let major = steps.map(i32::unsigned_abs).into_iter().max();
                let major = u64::from(major.unwrap_or(0));
                if major == 0 || speed_hz == 0 || accel_hz_per_s == 0 {
                    return Err(CommandError::Nothing);
                }
                if steps.contains(&i32::MIN) {
                    return Err(CommandError::Range);
                }
                let fast = steps[..self.axis_count].iter().enumerate();
                fast.map(|(axis, count)| (axis, u64::from(count.unsigned_abs())))
                    .find_map(|(axis, count)| too_fast(axis, speed_hz, count, major))
                    .map_or(Ok(()), Err)
            }
            _ => Ok(()),
        }
    }
}
