//! Drives: axes moved outside the queue, each by itself, and changed in flight as one likes.
//!
//! A drive has a target and a ramp. Another call for the same axis changes either: the axis goes on
//! from its present speed. Where the new target lies behind it, or nearer than it can stop, it slows
//! down by the new ramp, turns, and comes back. Other axes are driven meanwhile as they are: each
//! begins, changes and ends alone, on the timeline that all of them share.

use super::{
    CommandError, Hold, Motion, Phase,
    course::{Course, DriveError, Target},
};
use crate::{
    Direction, StepBackend, Ticks,
    limits::{CHANNELS, TICK_HZ},
    lookahead::Line,
    planner::WAY_STEPS_MAX,
    real::Real,
};
use keys::{AxisId, StopMode};

/// One axis that is driven.
#[derive(Clone, Copy, Debug)]
pub(super) struct Drive {
    /// Where it goes; `None`: it comes to rest.
    pub(super) leg: Option<Leg>,
    /// Its way does not lead there yet.
    pub(super) due: bool,
    /// It rests at this time, and turns then by the shift register.
    pub(super) turns_at: Option<Ticks>,
}

impl Drive {
    pub(super) fn leg(&self) -> Option<&Leg> {
        self.leg.as_ref()
    }

    /// Returns whether it turns where it comes to rest.
    pub(super) fn turns_later(&self) -> bool {
        self.turns_at.is_some()
    }
}

/// A way to a place.
#[derive(Clone, Copy, Debug)]
pub(super) struct Leg {
    /// Target, steps since boot.
    pub(super) to_steps: i64,
    pub(super) how: Course,
    /// Which way it goes past its target, once that is planned; 0: not yet, or it rests there.
    toward: i64,
}

/// Returns whether a target is none: on and on.
pub(super) const fn is_endless_at(to_steps: i64) -> bool {
    matches!(to_steps, i64::MIN | i64::MAX)
}

impl Leg {
    /// Steps from a place, no more than a way may have.
    pub(super) fn from(&self, from_steps: i64) -> i64 {
        let way = i128::from(self.to_steps) - i128::from(from_steps);
        way.clamp(-WAY_STEPS_MAX, WAY_STEPS_MAX) as i64
    }

    /// It goes past its target this way.
    pub(super) fn goes_past(&mut self, sign: i64) {
        self.toward = sign;
    }

    /// Returns whether it is past its target at this place: what is changed then changes its rest only.
    pub(super) fn has_passed(&self, at_steps: i64) -> bool {
        let beyond = i128::from(at_steps) - i128::from(self.to_steps);
        self.toward != 0 && i128::from(self.toward) * beyond >= 0
    }

    /// Returns the speed at the target, steps a tick; 0: it rests there, or goes on and on.
    pub(super) fn passing(&self) -> Real {
        match is_endless_at(self.to_steps) {
            true => Real::ZERO,
            false => self.how.passing(),
        }
    }

    pub(super) fn line(&self, axis: usize, way: i64) -> Line {
        let mut steps = [0; CHANNELS];
        steps[axis] = way;
        Line {
            joins: false,
            ..Line::new(steps, self.how.speed, self.how.law())
        }
    }
}

impl<B: StepBackend> Motion<'_, B> {
    /// Moves one axis outside the queue, or changes such a move in flight: its speed, acceleration
    /// and target, without a stop where physics allows. Several axes can be driven at a time, each
    /// by itself. [`MotionEvent::DriveEnded`](crate::MotionEvent::DriveEnded) tells that it rests. The queue waits meanwhile. Soft
    /// limits hold it inside: it comes to rest on them. One that runs into a limit switch is told of
    /// ([`MotionEvent::Limit`](crate::MotionEvent::Limit)); one that rests on it may only leave it.
    ///
    /// # Errors
    /// [`DriveError`]; nothing has happened.
    pub fn drive(&mut self, axis: AxisId, target: Target, how: Course) -> Result<(), DriveError> {
        if self.station {
            return Err(DriveError::Busy);
        }
        if usize::from(axis.0) >= self.axis_count {
            return Err(DriveError::Command(CommandError::Axis(axis)));
        }
        let to_steps = self.target_of(axis, target);
        let index = usize::from(axis.0);
        let to_steps = self.held_inside(index, to_steps);
        let how = match self.rests_inside(index, to_steps, &how) {
            true => how,
            false => how.resting(),
        };
        // One that moves already is watched where it goes.
        let way = Direction::of(to_steps.saturating_sub(self.planned_steps[index]));
        let rests = to_steps == self.planned_steps[index];
        if let Some(switch) = self.pressed(index, way)
            && !rests
            && !self.is_driven(axis)
        {
            return Err(DriveError::Limit(switch));
        }
        self.drive_to(axis, to_steps, how)
    }

    /// Lets an axis that is driven go on and on at the speed that it has now, to a mHz; an
    /// acceleration under way ends as its ramp ends them.
    ///
    /// # Errors
    /// [`DriveError`]; nothing has happened.
    pub fn coast(&mut self, axis: AxisId) -> Result<(), DriveError> {
        let index = usize::from(axis.0);
        if index >= self.axis_count {
            return Err(DriveError::Command(CommandError::Axis(axis)));
        }
        let leg = self.drives[index].and_then(|drive| drive.leg);
        let started_at = self.started_at.0;
        let channel = &self.backend.axes()[index];
        // That of its ramp: the last interval before rest is none between steps.
        let speed = self.planner.way_speed(index, channel, started_at);
        // Rounded down: it may be the greatest that the driver allows.
        let speed_mhz = speed.abs() * Real::of(1_000 * TICK_HZ) - Real::of(1).half();
        let speed_mhz = u32::try_from(speed_mhz.rounded()).unwrap_or(0);
        let leg = leg.filter(|_| speed_mhz > 0).ok_or(DriveError::Still)?;
        let way = if speed.is_negative() {
            Direction::Negative
        } else {
            Direction::Positive
        };
        self.drive(
            axis,
            Target::Forever(way),
            leg.how.at(speed_mhz, self.share),
        )
    }

    /// Returns whether an axis is driven on and on.
    pub fn is_endless(&self, axis: AxisId) -> bool {
        let drive = self.drives.get(usize::from(axis.0)).copied().flatten();
        let leg = drive.and_then(|drive| drive.leg);
        leg.is_some_and(|leg| is_endless_at(leg.to_steps))
    }

    /// Where a target is, steps since boot.
    pub(super) fn target_of(&self, axis: AxisId, target: Target) -> i64 {
        let index = usize::from(axis.0);
        match target {
            Target::By(steps) => self.target_steps(index).saturating_add(steps),
            Target::To(position) => position.wrapping_sub(self.planned_origins_steps[index]),
            Target::Forever(Direction::Positive) => i64::MAX,
            Target::Forever(Direction::Negative) => i64::MIN,
        }
    }

    /// Returns whether an axis that passes a place comes to rest before its soft limits.
    fn rests_inside(&self, index: usize, to_steps: i64, how: &Course) -> bool {
        let speed = how.passing();
        if speed.is_none() || how.check(0).is_err() {
            return true;
        }
        let way = how.law().way(Real::ZERO, speed).rounded().saturating_add(1);
        [to_steps.saturating_add(way), to_steps.saturating_sub(way)]
            .into_iter()
            .all(|place| self.held_inside(index, place) == place)
    }

    /// The same without regard to soft limits; the axis exists.
    pub(super) fn drive_to(
        &mut self,
        axis: AxisId,
        to_steps: i64,
        how: Course,
    ) -> Result<(), DriveError> {
        let index = usize::from(axis.0);
        how.check(self.timing[index].interval_ticks_min())
            .map_err(DriveError::Command)?;
        let free = self.is_driving() || (self.phase == Phase::Rest && self.marks.front().is_none());
        if !free || !matches!(self.hold, Hold::None) || self.is_stopping() {
            return Err(DriveError::Busy);
        }
        self.drives[index] = Some(Drive {
            leg: Some(Leg {
                to_steps,
                how,
                toward: 0,
            }),
            due: true,
            turns_at: None,
        });
        self.pass_drives();
        Ok(())
    }

    /// Ends all drives: at once, or each by its own ramp. Nothing happens without one, or while an
    /// axis is homed: only a stop ends that.
    pub fn end_drive(&mut self, mode: StopMode) {
        if self.homing.is_none() {
            self.leave_or_halt(mode);
        }
    }

    /// Ends the drive of one axis by its own ramp; others go on.
    pub fn end_drive_of(&mut self, axis: AxisId) {
        if self.homing.is_none()
            && let Some(Some(drive)) = self.drives.get_mut(usize::from(axis.0))
        {
            drive.leg = None;
            drive.due = true;
            self.settle_drives();
            self.pass_drives();
        }
    }

    pub(super) fn leave_or_halt(&mut self, mode: StopMode) {
        if !self.is_driving() {
            return;
        }
        for drive in self.drives.iter_mut().flatten() {
            drive.leg = None;
            drive.due = mode == StopMode::Decelerate;
        }
        self.settle_drives();
        match (self.phase, mode) {
            (Phase::Playing { .. }, StopMode::Halt) => {
                self.halt_backend();
                self.planner.forget();
                self.phase = Phase::Playing { timeline: self.now };
                for axis in 0..self.axis_count {
                    self.planned_steps[axis] = self.backend.played_steps(AxisId(axis as u8));
                }
            }
            (Phase::Playing { .. }, StopMode::Decelerate) => self.pass_drives(),
            _ => {}
        }
    }

    /// What was left of a way that rests is over.
    pub(super) fn settle_drives(&mut self) {
        if self.phase == Phase::Rest {
            for index in 0..self.axis_count {
                if let Some(drive) = self.drives[index]
                    .as_mut()
                    .filter(|drive| drive.leg.is_none())
                {
                    drive.due = false;
                    self.planned_steps[index] = self.backend.played_steps(AxisId(index as u8));
                }
            }
        }
    }

    /// Returns whether an axis is driven.
    pub fn is_driving(&self) -> bool {
        self.drives.iter().any(Option::is_some)
    }

    /// Returns whether this axis is driven.
    pub fn is_driven(&self, axis: AxisId) -> bool {
        let drive = self.drives.get(usize::from(axis.0));
        drive.is_some_and(Option::is_some)
    }

    /// Returns the way from here to rest if what is under way slowed down now: steps of the longest
    /// axis of the ramp or line, of the drive that needs most, or of the raw move that does, by its
    /// profile's deceleration; 0 at rest.
    pub fn steps_to_stop(&mut self) -> u64 {
        if !self.is_driving() && !self.planner.has_path() {
            return self.raw_steps_to_stop();
        }
        let (started_at, now) = (self.started_at.0, self.now.0);
        let axes = &self.backend.axes()[..self.axis_count];
        let path = self.planner.way_to_stop(axes, started_at, now);
        let ways = axes.iter().enumerate().map(|(index, axis)| {
            let way = self.planner.way_to_stop_of(index, axis, started_at, now);
            way.rounded()
        });
        let most = ways.max().unwrap_or(0).max(path.rounded());
        u64::try_from(most).unwrap_or(0)
    }

    /// Raw moves are slowed down in the encoder, behind what the hardware holds.
    fn raw_steps_to_stop(&mut self) -> u64 {
        let count = self.axis_count;
        let played = (0..count).map(|axis| self.backend.played_steps(AxisId(axis as u8)));
        let mut played_steps = [0; CHANNELS];
        played_steps
            .iter_mut()
            .zip(played)
            .for_each(|(to, from)| *to = from);
        let axes = &self.backend.axes()[..count];
        let ways = axes.iter().zip(played_steps).map(|(axis, played)| {
            let held = axis.ledger().booked_steps().abs_diff(played);
            held.saturating_add(axis.steps_to_rest())
        });
        ways.max().unwrap_or(0)
    }

    /// Where an axis will be, steps since boot.
    fn target_steps(&self, axis: usize) -> i64 {
        let leg = self.drives[axis].and_then(|drive| drive.leg);
        leg.map_or(self.planned_steps[axis], |leg| leg.to_steps)
    }
}
