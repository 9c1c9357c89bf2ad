//! What an axis is doing just now: how fast it gains speed, and what for.

use super::{Course, Drive, Motion, Phase, drive::is_endless_at};
use crate::{StepBackend, law::hz_per_s_from_accel, real::Real};
use keys::AxisId;

/// What the speed of an axis does.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Gait {
    /// It rests.
    Rest,
    /// It goes at constant speed.
    Coast,
    /// It speeds up.
    Accelerate,
    /// It slows down.
    Decelerate,
    /// It slows down to turn.
    Reverse,
}

/// What is known of an axis where its plan can be changed now.
struct Pace {
    speed: Real,
    accel: Real,
    turns: bool,
}

impl<B: StepBackend> Motion<'_, B> {
    /// Returns what an axis does where its plan can still be changed, 2 ms ahead of its pin at most.
    /// An axis that does not exist rests.
    pub fn gait(&mut self, axis: AxisId) -> Gait {
        let Some(pace) = self.pace(axis) else {
            return match self.speed_mhz(axis) {
                0 => Gait::Rest,
                _ if self.phase == Phase::Decelerating => Gait::Decelerate,
                _ => Gait::Coast,
            };
        };
        let slows = pace.accel.is_negative() != pace.speed.is_negative();
        let is_zero = |value: Real| value.is_none() && !value.is_negative();
        match (is_zero(pace.accel), is_zero(pace.speed)) {
            (true, true) => Gait::Rest,
            (true, false) => Gait::Coast,
            (false, false) if slows && pace.turns => Gait::Reverse,
            (false, false) if slows => Gait::Decelerate,
            (false, _) => Gait::Accelerate,
        }
    }

    /// Returns the acceleration of an axis there, steps/s²: above 0 while its speed changes towards
    /// positive values, 0 at rest and at constant speed.
    pub fn accel_hz_per_s(&mut self, axis: AxisId) -> i64 {
        if let Some(pace) = self.pace(axis) {
            return hz_per_s_from_accel(pace.accel);
        }
        // A raw move that is stopped.
        match (self.gait(axis), self.timing.get(usize::from(axis.0))) {
            (Gait::Decelerate, Some(timing)) => {
                let accel = i64::from(timing.stop_accel_hz_per_s);
                -accel * i64::from(self.speed_mhz(axis).signum())
            }
            _ => 0,
        }
    }

    /// Returns whether an axis comes to rest because it was told to: by the end of its drive or by a
    /// stop.
    pub fn is_coming_to_rest(&self, axis: AxisId) -> bool {
        let drive = self.drives.get(usize::from(axis.0)).copied().flatten();
        self.phase == Phase::Decelerating || drive.is_some_and(|drive| drive.leg().is_none())
    }

    /// Returns how an axis is driven, as it was asked for; `None`: it is not, or comes to rest.
    pub fn course(&self, axis: AxisId) -> Option<Course> {
        let leg = self.drives.get(usize::from(axis.0))?.as_ref()?.leg()?;
        Some(leg.how)
    }

    /// Returns the position to which an axis is driven; `None`: it is not, or on and on.
    pub fn target_position(&self, axis: AxisId) -> Option<i64> {
        let index = usize::from(axis.0);
        let leg = self.drives.get(index)?.as_ref()?.leg()?;
        let to_steps = leg.to_steps;
        (!is_endless_at(to_steps)).then(|| self.planned_origins_steps[index].wrapping_add(to_steps))
    }

    /// Returns how long what is planned lasts from now on, ticks; what waits in the queue and is not
    /// planned yet is not counted.
    pub fn planned_ticks(&self) -> u64 {
        match self.phase {
            Phase::Playing { timeline } => timeline.0.saturating_sub(self.now.0),
            Phase::Rest | Phase::Decelerating | Phase::Stopped => 0,
        }
    }

    fn pace(&mut self, axis: AxisId) -> Option<Pace> {
        let index = usize::from(axis.0);
        if index >= self.axis_count
            || !matches!(self.phase, Phase::Playing { .. } | Phase::Decelerating)
        {
            return None;
        }
        let drives = self.is_driving();
        let (channel, started_at) = (&self.backend.axes()[index], self.started_at.0);
        let ([speed, accel], turns) = if drives {
            let turns_later = self.drives[index].as_ref().is_some_and(Drive::turns_later);
            let (pace, turns) = self.planner.way_pace(index, channel, started_at)?;
            (pace, turns || turns_later)
        } else {
            (self.planner.pace_of(index, channel, started_at)?, false)
        };
        Some(Pace {
            speed,
            accel,
            turns,
        })
    }
}
