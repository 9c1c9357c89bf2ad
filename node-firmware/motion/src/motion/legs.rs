//! Legs of drives: what is made of an order, from rest or in flight, on the way that an axis goes.

use super::{
    CHANGE_AGAIN_TICKS, Hold, Motion, MotionEvent, Phase,
    drive::{Drive, Leg},
    rest_from,
};
use crate::{
    StepBackend, Ticks,
    law::Law,
    planner::{Ends, Left, Onward, Planner, Split},
    real::Real,
};
use keys::{AxisId, command::RampShape};

impl<B: StepBackend> Motion<'_, B> {
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
        let rests = self.phase == Phase::Rest;
        for (drive, at_steps) in self.drives.iter_mut().zip(self.planned_steps) {
            let Some(drive) = drive else { continue };
            if rests && drive.leg.is_some_and(|leg| leg.has_passed(at_steps)) {
                drive.leg = None;
            }
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
        let at_steps = match left {
            Left::Resting { base_steps, .. } => base_steps.unwrap_or(self.planned_steps[index]),
            // Within the last step before it, it is as good as there.
            Left::Moving { split, .. } => {
                let made = (split.from.place + Real::of(1).half()).rounded();
                split.base_steps[index] + split.line.steps[index].signum() * made
            }
        };
        let passed = leg.is_some_and(|leg| leg.has_passed(at_steps));
        if passed && let Some(drive) = self.drives[index].as_mut() {
            drive.leg = None;
        }
        let leg = leg.filter(|_| !passed);
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
            self.note_past(index, sign);
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
        if made != way {
            self.note_past(index, way.signum());
        }
    }

    /// The target is to be passed this way.
    fn note_past(&mut self, index: usize, sign: i64) {
        let drive = self.drives[index].as_mut();
        if let Some(leg) = drive.and_then(|drive| drive.leg.as_mut()) {
            leg.goes_past(sign);
        }
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
}
