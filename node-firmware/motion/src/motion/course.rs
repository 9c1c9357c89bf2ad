//! What a drive is asked for: where to, and how.

use super::CommandError;
use crate::{
    Direction,
    io::input::Switch,
    law::{Law, speed_from_hz, speed_from_interval, speed_from_mhz},
    limits::{TICK_HZ, TICKS_PER_US},
    real::Real,
};
use keys::command::{Ramp, RampShape};

/// Where a drive goes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Target {
    /// So many steps from its present target, or from where it rests.
    By(i64),
    /// To this position.
    To(i64),
    /// On and on.
    Forever(Direction),
}

/// How a drive moves.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Course {
    pub(super) speed: Real,
    accel_hz_per_s: u32,
    pub(super) shape: RampShape,
    /// Speed at the target; 0: it rests there.
    passing: Real,
}

impl Course {
    /// Speeds up from `start_hz` to `speed_hz` over `ramp_steps` steps (from 2) by ESP-IDF's
    /// smoothstep, and slows down likewise: see [`smooth`](crate::smooth). A shorter move takes the
    /// first half of its way of the rise, and back.
    pub fn smooth(start_hz: u32, speed_hz: u32, ramp_steps: u32) -> Self {
        Self::hz(speed_hz, 0).shaped(RampShape::Smooth {
            start_hz,
            ramp_steps,
        })
    }

    /// A trapezoid up to `speed_hz` by `accel_hz_per_s` (steps/s²).
    pub fn hz(speed_hz: u32, accel_hz_per_s: u32) -> Self {
        Self::of(speed_from_hz(speed_hz), accel_hz_per_s)
    }

    /// The same with the speed in mHz.
    pub fn mhz(speed_mhz: u64, accel_hz_per_s: u32) -> Self {
        Self::of(speed_from_mhz(speed_mhz), accel_hz_per_s)
    }

    /// The same with the time from step to step, µs.
    pub fn interval_us(interval_us: u32, accel_hz_per_s: u32) -> Self {
        Self::interval_ticks(u64::from(interval_us) * TICKS_PER_US, accel_hz_per_s)
    }

    /// The same with the time from step to step, ticks; 0 is refused when it is used.
    pub fn interval_ticks(interval_ticks: u64, accel_hz_per_s: u32) -> Self {
        let speed = match interval_ticks {
            0 => Real::ZERO,
            ticks => speed_from_interval(ticks),
        };
        Self::of(speed, accel_hz_per_s)
    }

    fn of(speed: Real, accel_hz_per_s: u32) -> Self {
        Self {
            speed,
            accel_hz_per_s,
            shape: RampShape::Trapezoid {
                linear_steps: 0,
                jump_steps: 0,
            },
            passing: Real::ZERO,
        }
    }

    /// Passes the target at this speed, mHz, instead of resting on it: no faster than its own speed,
    /// and slower where the way is too short to reach that. Behind the target it comes to rest by its
    /// ramp at once, unless another order takes it on from there. A target that is too near to slow
    /// down to this speed is passed on the way back. Where it could not come to rest before a soft
    /// limit, it rests on the target; a smoothstep always does.
    #[must_use]
    pub fn passing_mhz(self, speed_mhz: u64) -> Self {
        Self {
            passing: speed_from_mhz(speed_mhz),
            ..self
        }
    }

    /// Returns the speed at the target, steps a tick; 0: it rests there.
    pub(super) fn passing(&self) -> Real {
        match self.shape {
            RampShape::Smooth { .. } => Real::ZERO,
            RampShape::Trapezoid { .. } | RampShape::Jerk { .. } => self.passing.min(self.speed),
        }
    }

    /// The same, but at rest on the target.
    pub(super) fn resting(self) -> Self {
        Self {
            passing: Real::ZERO,
            ..self
        }
    }

    /// Returns its speed, mHz, rounded.
    pub fn speed_mhz(&self) -> u64 {
        let speed_mhz = (self.speed * Real::of(1_000 * TICK_HZ)).rounded();
        u64::try_from(speed_mhz).unwrap_or(0)
    }

    /// Returns the time from step to step at its speed, ticks, rounded; 0 if it has no speed.
    pub fn step_ticks(&self) -> u64 {
        if self.speed.is_none() {
            return 0;
        }
        u64::try_from((Real::of(1) / self.speed).rounded()).unwrap_or(u64::MAX)
    }

    /// Returns its acceleration, steps/s².
    pub fn accel_hz_per_s(&self) -> u32 {
        self.accel_hz_per_s
    }

    /// Returns the ramp that a job would call it, with its speed rounded up to whole Hz.
    pub fn ramp(&self) -> Ramp {
        let speed_hz = self.speed_mhz().div_ceil(1_000);
        Ramp {
            speed_hz: u32::try_from(speed_hz).unwrap_or(u32::MAX),
            accel_hz_per_s: self.accel_hz_per_s,
            shape: self.shape,
        }
    }

    /// Speeds up and slows down in this shape.
    #[must_use]
    pub fn shaped(self, shape: RampShape) -> Self {
        Self { shape, ..self }
    }

    /// The same at the speed that an axis has, of which it makes this share (2⁻¹⁶).
    pub(super) fn at(self, speed_mhz: u32, share: u32) -> Self {
        let speed = speed_from_mhz(u64::from(speed_mhz));
        Self {
            speed: speed * Real::of(1 << 16) / Real::of(u64::from(share)),
            ..self
        }
    }

    pub(super) fn law(&self) -> Law {
        Law::of(self.speed, self.accel_hz_per_s, self.shape)
    }

    pub(super) fn check(&self, interval_ticks_min: u64) -> Result<(), CommandError> {
        let no_rise = match self.shape {
            RampShape::Smooth {
                start_hz,
                ramp_steps,
            } => start_hz == 0 || speed_from_hz(start_hz) >= self.speed || ramp_steps < 2,
            RampShape::Jerk { jerk_hz_per_s2: 0 } => true,
            RampShape::Trapezoid { .. } | RampShape::Jerk { .. } => self.accel_hz_per_s == 0,
        };
        if self.speed.is_none() || no_rise {
            return Err(CommandError::Nothing);
        }
        if self.speed * Real::of(interval_ticks_min) > Real::of(1) {
            return Err(CommandError::too_fast(interval_ticks_min));
        }
        Ok(())
    }
}

impl From<Ramp> for Course {
    fn from(ramp: Ramp) -> Self {
        Self::hz(ramp.speed_hz, ramp.accel_hz_per_s).shaped(ramp.shape)
    }
}

/// Why an axis cannot be driven.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum DriveError {
    /// The queue, or another axis, moves; or motion is held or stopping.
    Busy,
    /// The axis or the ramp is none.
    Command(CommandError),
    /// It would go further into a limit that is pressed.
    Limit(Switch),
    /// The axis does not move, so it has no speed to keep.
    Still,
}

impl core::fmt::Display for DriveError {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        match self {
            Self::Busy => write!(f, "something else moves"),
            Self::Command(error) => error.fmt(f),
            Self::Limit(switch) => write!(f, "it is at its {switch} already"),
            Self::Still => write!(f, "the axis does not move"),
        }
    }
}

impl core::error::Error for DriveError {}

impl From<CommandError> for DriveError {
    fn from(error: CommandError) -> Self {
        Self::Command(error)
    }
}
