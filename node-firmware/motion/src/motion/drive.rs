//! Drives: one axis moved outside the queue, and changed in flight as one likes.
//!
//! A drive has a target and a ramp. Another call for the same axis changes either: the axis goes on
//! from its present speed. Where the new target lies behind it, or nearer than it can stop, it slows
//! down by the new ramp, turns, and comes back.

use super::{CommandError, Hold, Motion, MotionEvent, Phase};
use crate::{
    Axis, Direction, StepBackend, Ticks,
    law::{Law, speed_from_hz, speed_from_interval, speed_from_mhz},
    limits::{CHANNELS, TICKS_PER_US},
    lookahead::Line,
    path::Path,
    planner::{Begun, Split},
    real::Real,
};
use core::iter;
use keys::{
    AxisId, StopMode,
    command::{Ramp, RampShape},
};

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
    speed: Real,
    accel_hz_per_s: u32,
    shape: RampShape,
    smooth: Option<Smooth>,
}

/// A rise by the way instead of by an acceleration.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Smooth {
    /// First speed, steps per tick.
    start: Real,
    /// Over how many steps.
    steps: u32,
}

impl Course {
    /// Speeds up from `start_hz` to `speed_hz` over `ramp_steps` steps (from 2) by ESP-IDF's
    /// smoothstep, and slows down likewise: see [`smooth`](crate::smooth). A shorter move takes the
    /// first half of its way of the rise, and back.
    pub fn smooth(start_hz: u32, speed_hz: u32, ramp_steps: u32) -> Self {
        let smooth = Smooth {
            start: speed_from_hz(start_hz),
            steps: ramp_steps,
        };
        Self {
            smooth: Some(smooth),
            ..Self::hz(speed_hz, 0)
        }
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
            smooth: None,
        }
    }

    /// Speeds up and slows down in this shape.
    #[must_use]
    pub fn shaped(self, shape: RampShape) -> Self {
        Self { shape, ..self }
    }

    fn law(&self) -> Law {
        match self.smooth {
            Some(smooth) => Law::smooth(smooth.start, self.speed, smooth.steps),
            None => Law::new(self.accel_hz_per_s, self.shape),
        }
    }

    fn check(&self, interval_ticks_min: u64) -> Result<(), CommandError> {
        let no_jerk = matches!(self.shape, RampShape::Jerk { jerk_hz_per_s2: 0 });
        let no_rise = match self.smooth {
            Some(Smooth { start, steps }) => start.is_none() || start >= self.speed || steps < 2,
            None => self.accel_hz_per_s == 0 || no_jerk,
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
}

impl core::fmt::Display for DriveError {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        match self {
            Self::Busy => write!(f, "something else moves"),
            Self::Command(error) => error.fmt(f),
        }
    }
}

impl core::error::Error for DriveError {}

impl From<CommandError> for DriveError {
    fn from(error: CommandError) -> Self {
        Self::Command(error)
    }
}

/// One axis that is driven.
#[derive(Clone, Copy, Debug)]
pub(super) struct Drive {
    pub(super) axis: AxisId,
    /// Where it goes next, once it rests.
    pub(super) next: Option<Leg>,
    /// It is to leave its present leg for that, or for rest, as soon as possible.
    pub(super) due: bool,
    /// It slows down to rest, wherever that is: its present way leads nowhere.
    pub(super) ending: bool,
}

/// A way from rest.
#[derive(Clone, Copy, Debug)]
pub(super) struct Leg {
    /// Target, steps since boot.
    to_steps: i64,
    how: Course,
}

/// Longest way of one leg, steps: 360,000 years at 200 kHz.
const WAY_STEPS_MAX: i128 = 1 << 61;

impl<B: StepBackend> Motion<'_, B> {
    /// Moves one axis outside the queue, or changes such a move in flight: its speed, acceleration
    /// and target, without a stop where physics allows. [`MotionEvent::DriveEnded`] tells that it
    /// rests. The queue waits meanwhile. Soft limits hold it inside: it comes to rest on them.
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
        let to_steps = self.held_inside(usize::from(axis.0), to_steps);
        self.drive_to(axis, to_steps, how)
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
        let free = match self.drive {
            Some(drive) => drive.axis == axis,
            None => self.phase == Phase::Rest && self.marks.front().is_none(),
        };
        if !free || !matches!(self.hold, Hold::None) || self.is_stopping() {
            return Err(DriveError::Busy);
        }
        let next = Some(Leg { to_steps, how });
        let due = self.drive.is_some();
        let ending = self.drive.is_some_and(|drive| drive.ending);
        self.drive = Some(Drive {
            axis,
            next,
            due,
            ending,
        });
        self.change_drive();
        Ok(())
    }

    /// Leaves the present leg, if that is due and possible.
    pub(super) fn change_drive(&mut self) {
        let Some(mut drive) = self.drive.filter(|drive| drive.due) else {
            return;
        };
        let index = usize::from(drive.axis.0);
        if let Phase::Playing { .. } = self.phase {
            let Some(split) = self.leave_drive() else {
                return;
            };
            match drive.next.take() {
                Some(leg) => drive.next = self.turn_drive(index, split, leg),
                None => {
                    let law = split.line.law;
                    self.rest_drive(index, split, law);
                }
            }
            // Both say whether it comes to rest.
            drive.ending = self.drive.is_some_and(|drive| drive.ending);
        }
        drive.due = false;
        self.drive = Some(drive);
    }

    /// Ends a drive: at once, or by its own ramp. Nothing happens without one, or while an axis is
    /// homed: only a stop ends that.
    pub fn end_drive(&mut self, mode: StopMode) {
        if self.homing.is_none() {
            self.leave_or_halt(mode);
        }
    }

    pub(super) fn leave_or_halt(&mut self, mode: StopMode) {
        let Some(drive) = self.drive.as_mut() else {
            return;
        };
        drive.next = None;
        drive.due = false;
        let axis = drive.axis;
        let index = usize::from(axis.0);
        let Phase::Playing { .. } = self.phase else {
            // What was left of a way that was held is over.
            self.planned_steps[index] = self.backend.played_steps(axis);
            return;
        };
        match mode {
            StopMode::Halt => {
                self.halt_backend();
                self.planner.forget();
                self.planned_steps[index] = self.backend.played_steps(axis);
                self.phase = Phase::Playing { timeline: self.now };
            }
            StopMode::Decelerate => {
                drive.due = true;
                self.change_drive();
            }
        }
    }

    /// Returns whether a drive is under way.
    pub fn is_driving(&self) -> bool {
        self.drive.is_some()
    }

    /// Returns the way from here to rest if the ramp or line under way slowed down now, steps of
    /// its longest axis; 0 if none is under way.
    pub fn steps_to_stop(&mut self) -> u64 {
        let axes = &self.backend.axes()[..self.axis_count];
        let way = self
            .planner
            .way_to_stop(axes, self.started_at.0, self.now.0);
        u64::try_from(way.rounded()).unwrap_or(0)
    }

    /// Tells that a drive rests.
    pub(super) fn pass_drive(&mut self) -> Option<MotionEvent> {
        let ended = self.drive.is_some_and(|drive| drive.next.is_none());
        if !ended || self.phase != Phase::Rest {
            return None;
        }
        self.drive = None;
        (!self.pass_homing_drive()).then_some(MotionEvent::DriveEnded)
    }

    /// Begins the next leg of a drive from rest, at `begin`.
    pub(super) fn begin_leg(&mut self, axis: AxisId, leg: Leg, begin: Ticks) {
        let index = usize::from(axis.0);
        let way = i128::from(leg.to_steps) - i128::from(self.planned_steps[index]);
        let way = way.clamp(-WAY_STEPS_MAX, WAY_STEPS_MAX) as i64;
        self.phase = Phase::Playing { timeline: begin };
        if way == 0 {
            return;
        }
        let mut steps = [0; CHANNELS];
        steps[index] = way;
        let how = leg.how;
        let line = Line {
            joins: false,
            ..Line::by_law(steps, how.speed, how.law())
        };
        let jump_steps = match how.shape {
            RampShape::Trapezoid { jump_steps, .. } => jump_steps,
            RampShape::Jerk { .. } => 0,
        };
        let axes = &self.backend.axes()[..self.axis_count];
        let base_steps = self.planned_steps;
        let begun = self
            .planner
            .begin(line, jump_steps, iter::empty(), begin.0, base_steps, axes);
        self.planned_steps[index] += way;
        self.note_path(&begun, None);
    }

    /// Where an axis will be, steps since boot.
    fn target_steps(&self, axis: usize) -> i64 {
        let next = self.drive.and_then(|drive| drive.next);
        next.map_or(self.planned_steps[axis], |leg| leg.to_steps)
    }

    /// Takes the leg under way out of the plan.
    fn leave_drive(&mut self) -> Option<Split> {
        self.drive?;
        let axes = &mut self.backend.axes()[..self.axis_count];
        let (cut, on_path) = self.planner.cut_ticks(axes, self.started_at.0);
        if !on_path || axes.iter().any(Axis::has_ended) {
            return None;
        }
        self.planner.rewind(axes, self.started_at.0);
        self.planner.split(cut)
    }

    /// Goes on with another leg. Returns it if it has to turn first.
    fn turn_drive(&mut self, axis: usize, mut split: Split, leg: Leg) -> Option<Leg> {
        let how = leg.how;
        let law = how.law().after(&split.line.law);
        let sign = split.line.steps[axis].signum();
        let way = i128::from(leg.to_steps) - i128::from(split.base_steps[axis]);
        let way = (i128::from(sign) * way).clamp(-WAY_STEPS_MAX, WAY_STEPS_MAX) as i64;
        let mut to_rest = Path::at(split.from);
        to_rest.come_to_rest(&law);
        // Rounding in the last bits is no lack of way.
        let least = to_rest.end_steps() - Real::of(1).shifted(-20);
        if Real::of_signed(way) < least {
            self.rest_drive(axis, split, law);
            return Some(leg);
        }
        split.line.major_steps = way.unsigned_abs();
        split.line.steps[axis] = way * sign;
        split.line.speed_max = how.speed;
        split.line.law = law;
        self.resume_drive(axis, split);
        None
    }

    /// Slows down to rest, wherever that is: on the step whose edge was passed last.
    fn rest_drive(&mut self, axis: usize, mut split: Split, law: Law) {
        let sign = split.line.steps[axis].signum();
        split.line.major_steps = WAY_STEPS_MAX as u64;
        split.line.steps[axis] = sign * WAY_STEPS_MAX as i64;
        split.line.law = law;
        let base_steps = split.base_steps[axis];
        let axes = &self.backend.axes()[..self.axis_count];
        self.planner.hold(true);
        let begun = self.planner.go_on(split, iter::empty(), axes);
        self.planner.hold(self.is_held());
        self.set_ending(true);
        let made = begun.held.map_or(0, |held| held.from.place.rounded());
        self.planned_steps[axis] = base_steps + sign * made;
        self.note_path(
            &Begun {
                held: None,
                ..begun
            },
            None,
        );
    }

    fn set_ending(&mut self, ending: bool) {
        if let Some(drive) = self.drive.as_mut() {
            drive.ending = ending;
        }
    }

    /// Returns whether a drive slows down to rest already.
    pub(super) fn is_drive_ending(&self) -> bool {
        self.drive.is_some_and(|drive| drive.ending)
    }

    fn resume_drive(&mut self, axis: usize, split: Split) {
        self.planned_steps[axis] = split.base_steps[axis] + split.line.steps[axis];
        self.set_ending(false);
        let axes = &self.backend.axes()[..self.axis_count];
        let begun = self.planner.go_on(split, iter::empty(), axes);
        self.note_path(&begun, None);
    }
}
