//! Homing, by what it has to be: there, back, slowly there again, and off.
//!
//! ```text
//!   seek ──▶ (pressed) ──▶ back off ──▶ (released) ──▶ approach ──▶ (pressed) ──▶ pull off
//! ```
//!
//! The direction of the steps tells the phases apart, the input's record where the switch is: where
//! the edge of the approach was since which its contact has held. That place has the position that
//! was asked for, to the step, and all that follows is counted from there.

use super::{Judge, Step, TICK_HZ, TICKS_PER_US, queues::Scope};
use crate::{
    kinematics::Ideal,
    record::{HomeFacts, InputEdge, TakenCommand},
};
use keys::{AxisId, StopReport};

/// A contact counts as pressed when it has held for so long: the default filter.
const FILTER_TICKS: u64 = 20 * TICKS_PER_US;

/// A pressed switch ends a run this much later at most, seconds: filter, task, and what the pulse
/// hardware holds.
const REACTION_S: f64 = 0.005;

/// Two edges of a run may be off by a tick each.
const SLACK_TICKS: f64 = 2.01;

/// Steps in one direction.
struct Leg {
    steps: Vec<Step>,
    speed_hz: f64,
}

impl Leg {
    fn at(&self) -> Option<u64> {
        self.steps.first().map(|step| step.at)
    }

    fn end(&self) -> Option<u64> {
        self.steps.last().map(|step| step.at)
    }

    /// Steps later than this.
    fn count_after(&self, at: u64) -> usize {
        self.steps.iter().filter(|step| step.at > at).count()
    }
}

impl Judge<'_> {
    /// Explains the steps of a homing and gives the axis its position. Returns whether it is whole.
    pub(super) fn read_homing(
        &mut self,
        taken: &TakenCommand,
        axis: AxisId,
        scope: &Scope,
        stop: Option<&StopReport>,
    ) -> bool {
        let Some(home) = self.homes.iter().find(|home| home.axis == axis).copied() else {
            self.wrong(None, format!("axis {}: it has no switch", axis.0));
            return false;
        };
        let sign = if home.positive { 1 } else { -1 };
        let legs = [
            (sign, home.seek_hz),
            (-sign, home.approach_hz),
            (sign, home.approach_hz),
        ];
        let index = axis.index();
        let [seek, back_off] =
            [legs[0], legs[1]].map(|(sign, hz)| self.leg(index, sign, hz, usize::MAX, scope.until));
        let (sign, hz) = legs[2];
        let press = back_off.end().and_then(|end| self.press_from(&home, end));
        // What comes behind it may go the same way, if nothing leads off the switch.
        let until = match press {
            Some(press) if home.pull_off_steps == 0 => press.at_ticks + 10 * FILTER_TICKS,
            _ => scope.until,
        };
        let approach = self.leg(index, sign, hz, usize::MAX, until.min(scope.until));
        let executed = taken.number < scope.executed;
        for leg in [&seek, &back_off, &approach] {
            self.check_leg(axis, &home, leg);
        }
        self.check_begin_of_homing(taken, [&seek, &back_off]);
        if seek.steps.len() as u64 > home.travel_steps_max {
            let message = format!("axis {}: it seeks farther than it may", axis.0);
            self.wrong(seek.end(), message);
        }
        let found = seek.at().and_then(|begin| self.press_from(&home, begin));
        if let Some(press) = found {
            self.check_overrun(axis, &home, &seek, press);
        }
        let Some(press) = press.filter(|_| !approach.steps.is_empty()) else {
            if executed {
                let message = format!("axis {}: homed without a switch", axis.0);
                self.wrong(approach.end(), message);
            }
            self.end_homing(&[seek, back_off, approach]);
            return false;
        };
        self.check_overrun(axis, &home, &approach, press);
        let origin = home.home_position_steps - press.counted_steps[index];
        let there = origin + self.axes[index].count;
        let target = home.home_position_steps - sign * home.pull_off_steps as i64;
        let off_steps = match home.pull_off_steps {
            0 => 0,
            _ => (target - there).unsigned_abs() as usize,
        };
        let pull_off = self.leg(index, -sign, home.approach_hz, off_steps, scope.until);
        self.check_leg(axis, &home, &pull_off);
        let made = pull_off.steps.len();
        let whole = made == off_steps;
        // A stop may have come before the place was named.
        let reported = stop.and_then(|stop| stop.positions_steps.get(index));
        let named = executed || made > 0 || reported == Some(&(origin + self.axes[index].count));
        if named {
            self.axes[index].origin = origin;
        }
        if executed && !whole {
            let message = format!("axis {}: {made} of {off_steps} steps off", axis.0);
            self.wrong(pull_off.end(), message);
        }
        self.end_homing(&[seek, back_off, approach, pull_off]);
        executed && whole
    }

    /// Takes steps as long as they go this way.
    fn leg(&mut self, axis: usize, sign: i64, hz: u32, most: usize, until: u64) -> Leg {
        let seen = &mut self.axes[axis];
        let mut steps = Vec::new();
        while steps.len() < most
            && let Some(step) = seen.next(until).filter(|step| step.sign == sign)
        {
            steps.push(step);
            seen.take();
        }
        Leg {
            steps,
            speed_hz: f64::from(hz),
        }
    }

    /// From rest, nothing is quicker than this acceleration and speed allow.
    fn check_leg(&mut self, axis: AxisId, home: &HomeFacts, leg: &Leg) {
        let accel = f64::from(home.accel_hz_per_s);
        let ideal = Ideal::trapezoid(1e15, leg.speed_hz, accel);
        let hz = TICK_HZ as f64;
        let Some(begin) = leg.at() else { return };
        let due = |number: usize| (ideal.time_at(number as f64 + 0.5) - ideal.time_at(0.5)) * hz;
        let interval = hz / leg.speed_hz - SLACK_TICKS;
        let early = leg.steps.iter().enumerate().find(|(number, step)| {
            let before = number.checked_sub(1).map(|before| leg.steps[before].at);
            let close = before.is_some_and(|before| ((step.at - before) as f64) < interval);
            close || ((step.at - begin) as f64) < due(*number) - SLACK_TICKS
        });
        if let Some((number, step)) = early {
            let message = format!("axis {}: step {number} of a run is too fast", axis.0);
            self.wrong(step.at, message);
        }
    }

    fn check_begin_of_homing(&mut self, taken: &TakenCommand, legs: [&Leg; 2]) {
        let first = legs.iter().filter_map(|leg| leg.at()).min();
        let earliest = self.not_before.max(taken.at.0 * TICKS_PER_US);
        if let Some(first) = first.filter(|first| *first < earliest) {
            self.wrong(first, "homing begins too early".to_owned());
        }
    }

    /// The axis does not go on for longer than it needs to come to rest.
    fn check_overrun(&mut self, axis: AxisId, home: &HomeFacts, leg: &Leg, press: InputEdge) {
        let way = leg.speed_hz * leg.speed_hz / (2.0 * f64::from(home.accel_hz_per_s));
        let most = way + leg.speed_hz * REACTION_S + 2.0;
        let count = leg.count_after(press.at_ticks);
        if count as f64 > most {
            let message = format!("axis {}: {count} steps behind its switch", axis.0);
            self.wrong(press.at_ticks, message);
        }
    }

    /// The first edge from `at` on since which the contact has held.
    fn press_from(&self, home: &HomeFacts, at: u64) -> Option<InputEdge> {
        let own = |edge: &&InputEdge| edge.index == home.input;
        let edges: Vec<_> = self.inputs.iter().filter(own).collect();
        let holds = |index: usize| {
            let next = edges.get(index + 1);
            next.is_none_or(|next| next.at_ticks - edges[index].at_ticks >= FILTER_TICKS)
        };
        let press = edges.iter().enumerate().find(|(index, edge)| {
            edge.at_ticks >= at && edge.level == home.active_level && holds(*index)
        });
        press.map(|(_, edge)| **edge)
    }

    /// Nothing behind it begins before its last step.
    fn end_homing(&mut self, legs: &[Leg]) {
        let last = legs.iter().filter_map(Leg::end).max();
        self.not_before = self.not_before.max(last.unwrap_or(0));
    }
}
