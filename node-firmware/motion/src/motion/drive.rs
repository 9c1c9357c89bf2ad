//! Drives: axes moved outside the queue, each by itself, and changed in flight as one likes.
//!
//! A drive has a target and a ramp. Another call for the same axis changes either: the axis goes on
//! from its present speed. Where the new target lies behind it, or nearer than it can stop, it slows
//! down by the new ramp, turns, and comes back. Other axes are driven meanwhile as they are: each
//! begins, changes and ends alone, on the timeline that all of them share.

use super::{
    CHANGE_AGAIN_TICKS, CommandError, Hold, Motion, MotionEvent, Phase,
    course::{Course, DriveError, Target},
    rest_from,
};
use crate::{
    Direction, StepBackend, Ticks,
    law::Law,
    limits::{CHANNELS, TICK_HZ},
    lookahead::Line,
    planner::{Ends, Left, Onward, Planner, Split, WAY_STEPS_MAX},
    real::Real,
};
use keys::{AxisId, StopMode, command::RampShape};

/// One axis that is driven.
#[derive(Clone, Copy, Debug)]
pub(super) struct Drive {
    /// Where it goes; `None`: it comes to rest.
    leg: Option<Leg>,
    /// Its way does not lead there yet.
    due: bool,
    /// It rests at this time, and turns then by the shift register.
    turns_at: Option<Ticks>,
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
    to_steps: i64,
    pub(super) how: Course,
}

/// Returns whether a target is none: on and on.
pub(super) const fn is_endless_at(to_steps: i64) -> bool {
    matches!(to_steps, i64::MIN | i64::MAX)
}

impl Leg {
    pub(super) fn to_steps(&self) -> i64 {
        self.to_steps
    }

    /// Steps from a place, no more than a way may have.
    fn from(&self, from_steps: i64) -> i64 {
        let way = i128::from(self.to_steps) - i128::from(from_steps);
        way.clamp(-WAY_STEPS_MAX, WAY_STEPS_MAX) as i64
    }

    /// Returns the speed at the target, steps a tick; 0: it rests there, or goes on and on.
    fn passing(&self) -> Real {
        match is_endless_at(self.to_steps) {
            true => Real::ZERO,
            false => self.how.passing(),
        }
    }

    fn line(&self, axis: usize, way: i64) -> Line {
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
    /// by itself. [`MotionEvent::DriveEnded`] tells that it rests. The queue waits meanwhile. Soft
    /// limits hold it inside: it comes to rest on them. One that runs into a limit switch is told of
    /// ([`MotionEvent::Limit`]); one that rests on it may only leave it.
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
            leg: Some(Leg { to_steps, how }),
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

    /// All drives come to rest; nothing of them goes on.
    pub(super) fn rest_drives(&mut self) {
        for drive in self.drives.iter_mut().flatten() {
            drive.leg = None;
            drive.due = true;
        }
        self.pass_drives();
    }

    /// Hold, resumption or another speed: every way is made anew.
    pub(super) fn change_drives(&mut self) {
        for drive in self.drives.iter_mut().flatten() {
            drive.due |= drive.leg.is_some();
        }
        self.pass_drives();
    }

    /// Leads the ways of all axes where they are to go, as far as that can be done now.
    pub(super) fn pass_drives(&mut self) {
        if !matches!(self.phase, Phase::Playing { .. } | Phase::Decelerating) {
            return;
        }
        for index in 0..self.axis_count {
            let is_due =
                |drive: &Drive| drive.due && drive.turns_at.is_none_or(|at| at <= self.now);
            if let Some(drive) = self.drives[index].filter(is_due) {
                self.change_way(index, drive);
            }
        }
        self.note_ways();
    }

    /// The timeline ends with the last way.
    fn note_ways(&mut self) {
        if let Phase::Playing { .. } = self.phase
            && let Some(end) = self.planner.ways_end()
        {
            self.phase = Phase::Playing {
                timeline: Ticks(end),
            };
        }
    }

    fn change_way(&mut self, index: usize, drive: Drive) {
        let started_at = self.started_at.0;
        let axes = &mut self.backend.axes()[..self.axis_count];
        let axis = &mut axes[index];
        if !self.planner.can_change_way(index, axis, started_at) {
            return;
        }
        self.planner.set_share(self.share);
        let leg = drive.leg.filter(|_| !self.rests_on_path());
        let axes = &mut self.backend.axes()[..self.axis_count];
        let left = self.planner.leave_way(index, &mut axes[index], started_at);
        self.set_due(index, false, None);
        match (left, leg) {
            (Left::Resting { at, base_steps }, leg) => {
                if let Some(base_steps) = base_steps {
                    self.planned_steps[index] = base_steps;
                }
                let Some(leg) = leg else { return };
                if !self.turn(index, leg.from(self.planned_steps[index])) {
                    self.set_due(index, true, None);
                    return;
                }
                // Time for the direction pin, if it has just been confirmed.
                let settled = self.now.0 + self.timing[index].turn_ticks();
                let waits = self.turns.is_external(index);
                self.begin_leg(index, leg, if waits { at.max(settled) } else { at });
            }
            (Left::Moving { split, .. }, None) => {
                self.slow_down(index, split);
            }
            (Left::Moving { split, reach_steps }, Some(leg)) => {
                self.turn_to(index, split, reach_steps, leg);
            }
        }
    }

    /// What is held is due again when it goes on.
    fn set_due(&mut self, index: usize, due: bool, turns_at: Option<Ticks>) {
        if let Some(drive) = self.drives[index].as_mut() {
            drive.due = due;
            drive.turns_at = turns_at;
        }
    }

    /// Goes on with another leg; turns first if it has to. `reach_steps` is how far it would have
    /// gone so far.
    ///
    /// It slows down by the new ramp, unless that led farther than it has ever been sent: beyond
    /// a soft limit, for one. Then it slows down by whichever ramp needs less way.
    fn turn_to(&mut self, index: usize, mut split: Split, reach_steps: i64, leg: Leg) {
        let axes = &self.backend.axes()[..self.axis_count];
        let mut law = leg.how.law().after(&split.line.law);
        let sign = split.line.steps[index].signum();
        let way = i128::from(sign) * i128::from(leg.from(split.base_steps[index]));
        let way = way as i64;
        // Rounding in the last bits is no lack of way.
        let least_by = |law: &Law| Planner::least_way(&split, law) - Real::of(1).shifted(-20);
        let mut least = least_by(&law);
        let sent = way.max(reach_steps.saturating_mul(sign));
        if least > Real::of_signed(sent) {
            let before = least_by(&split.line.law);
            if before < least {
                (law, least) = (split.line.law, before);
            }
        }
        split.line.law = law;
        let mut on = split;
        on.line.major_steps = way.unsigned_abs();
        on.line.steps[index] = way * sign;
        on.line.speed_max = leg.how.speed;
        let passing = leg.passing();
        if way > 0
            && let Some(speed) = self.planner.passing_speed(&on, passing, axes)
        {
            let (_, made) = self.planner.go_on_way(index, on, Onward::Past(speed), axes);
            self.planned_steps[index] = on.base_steps[index] + made;
            return;
        }
        if !passing.is_none() || Real::of_signed(way) < least {
            let end = self.slow_down(index, split);
            let way = leg.from(self.planned_steps[index]);
            if self.turns.must_turn(index, way) {
                self.set_due(index, true, Some(Ticks(end)));
            } else {
                self.begin_leg(index, leg, end);
            }
            return;
        }
        let axes = &self.backend.axes()[..self.axis_count];
        self.planner.go_on_way(index, on, Onward::ToEnd, axes);
        self.planned_steps[index] = on.base_steps[index] + way * sign;
    }

    /// Comes to rest, wherever that is: on the step whose edge was passed last. Returns when.
    fn slow_down(&mut self, index: usize, split: Split) -> u64 {
        let axes = &self.backend.axes()[..self.axis_count];
        let (end, made) = self.planner.go_on_way(index, split, Onward::ToRest, axes);
        self.planned_steps[index] = split.base_steps[index] + made;
        end
    }

    /// Begins a leg from rest at `begin`.
    fn begin_leg(&mut self, index: usize, leg: Leg, begin: u64) {
        let base_steps = self.planned_steps[index];
        let way = leg.from(base_steps);
        if way == 0 {
            return;
        }
        let jump_steps = match leg.how.shape {
            RampShape::Trapezoid { jump_steps, .. } => jump_steps,
            RampShape::Jerk { .. } | RampShape::Smooth { .. } => 0,
        };
        let axes = &self.backend.axes()[..self.axis_count];
        let line = leg.line(index, way);
        let ends = Ends {
            jump_steps,
            passing: leg.passing(),
        };
        let made = self
            .planner
            .begin_way(index, line, ends, begin, base_steps, axes);
        self.planned_steps[index] = base_steps + made;
    }

    /// Writes as much of the ways as fits. From rest it begins with those that are due; returns when
    /// the channels are to be started for that.
    pub(super) fn plan_drives(&mut self, lead_ticks: u64) -> Option<Ticks> {
        let mut starts_at = None;
        self.pass_drives();
        if self.phase == Phase::Rest && self.begins_drive() {
            if !self.are_enabled(crate::io::enable::AxisSet::QUEUE, lead_ticks) {
                return None;
            }
            let mut turned = true;
            for index in 0..self.axis_count {
                let leg = self.drives[index].filter(|drive| drive.due);
                if let Some(leg) = leg.and_then(|drive| drive.leg) {
                    turned &= self.turn(index, leg.from(self.planned_steps[index]));
                }
            }
            if !turned {
                self.waits_enable = true;
                return None;
            }
            let at = self.now.max(self.quiet_at);
            let begin = at.plus(lead_ticks);
            self.planner.set_share(self.share);
            self.planner.begin_ways(begin.0);
            for index in 0..self.axis_count {
                if let Some(drive) = self.drives[index].as_mut() {
                    drive.due = false;
                    if let Some(leg) = drive.leg {
                        self.begin_leg(index, leg, begin.0);
                    }
                }
            }
            let timeline = Ticks(self.planner.ways_end()?);
            self.phase = Phase::Playing { timeline };
            starts_at = Some(at);
        }
        if self.phase != Phase::Rest
            && let Some(end) = self.planner.ways_end()
        {
            let started_at = self.started_at.0;
            let axes = &mut self.backend.axes()[..self.axis_count];
            if starts_at.is_none() {
                self.planner.retire_ways(axes, started_at);
            }
            self.planner.write_ways(axes, end, started_at);
        }
        starts_at
    }

    /// Tells that a drive rests.
    pub(super) fn pass_drive(&mut self) -> Option<MotionEvent> {
        let rests = self.phase == Phase::Rest;
        // The last one ends when the channels rest.
        let others = self.drives.iter().flatten().count() > 1;
        let over = |index: usize| {
            self.planner
                .way_end(index)
                .is_none_or(|end| rest_from(Ticks(end)) <= self.now)
        };
        let ended = (0..self.axis_count).find(|&index| {
            self.drives[index].is_some_and(|drive| !drive.due && (rests || (others && over(index))))
        });
        let index = ended?;
        self.drives[index] = None;
        let axis = AxisId(index as u8);
        (!self.pass_homing_drive()).then_some(MotionEvent::DriveEnded { axis })
    }

    /// Returns whether a drive is to begin from rest.
    pub(super) fn begins_drive(&self) -> bool {
        let goes = |drive: &Drive| drive.due && drive.leg.is_some();
        matches!(self.hold, Hold::None) && self.drives.iter().flatten().any(goes)
    }

    /// Returns when the next drive of several rests.
    pub(super) fn drives_timeout(&self) -> Option<Ticks> {
        let waits = self.drives.iter().flatten().any(|drive| drive.due);
        if waits && self.phase != Phase::Rest {
            return Some(self.now.plus(CHANGE_AGAIN_TICKS));
        }
        if self.drives.iter().flatten().count() < 2 {
            return None;
        }
        let ends = (0..self.axis_count).filter(|&index| self.drives[index].is_some());
        let ends = ends.filter_map(|index| self.planner.way_end(index));
        ends.map(|end| rest_from(Ticks(end)).max(self.now.plus(1)))
            .min()
    }

    /// Where an axis will be, steps since boot.
    fn target_steps(&self, axis: usize) -> i64 {
        let leg = self.drives[axis].and_then(|drive| drive.leg);
        leg.map_or(self.planned_steps[axis], |leg| leg.to_steps)
    }
}
