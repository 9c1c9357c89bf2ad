//! C and D, beside the queue: they go to named places at the one speed of their table, with no ramp.
//!
//! A run makes exactly the steps from the place where it begins to that of its name, one interval
//! apart; or it ends at a limit, and then the axis is where the limit is. What a switch showed before
//! its first change is not recorded: until then both are possible.

use super::{Judge, Step, TICK_HZ, TICKS_PER_US};
use crate::{
    pins::Pin,
    record::{BesideFacts, Life, LimitFacts, TakenCommand},
};
use keys::Command;

/// A limit counts within this after its first contact, ticks: bouncing and the filter.
const LIMIT_TICKS: u64 = 40_000 * TICKS_PER_US;

/// The steps of one pin that are not explained.
struct Line {
    name: &'static str,
    steps: std::collections::VecDeque<Step>,
    /// It has stepped: a limit that was pressed at boot would have told by now.
    has_stepped: bool,
}

impl Line {
    fn read(name: &'static str, life: &Life, step: Pin, direction: Pin) -> Self {
        let mut sign = -1;
        let mut steps = std::collections::VecDeque::new();
        for edge in &life.edges {
            if edge.pin == direction {
                sign = if edge.level { 1 } else { -1 };
            } else if edge.pin == step && edge.level {
                let at = edge.at_ticks;
                steps.push_back(Step { at, sign });
            }
        }
        Self {
            name,
            steps,
            has_stepped: false,
        }
    }

    /// Takes at most so many steps of one direction that lie `interval` ticks apart, to a tick, and
    /// before `until`.
    fn take(&mut self, most: u64, interval: f64, until: u64) -> Vec<Step> {
        let mut taken: Vec<Step> = Vec::new();
        while let Some(step) = self.steps.front().copied()
            && (taken.len() as u64) < most
            && step.at < until
        {
            if let Some(last) = taken.last() {
                let even = ((step.at - last.at) as f64 - interval).abs() <= 1.0;
                if step.sign != last.sign || !even {
                    break;
                }
            }
            taken.push(step);
            self.steps.pop_front();
            self.has_stepped = true;
        }
        taken
    }
}

/// Returns whether a limit is pressed at a time, as far as that is known; and when it was pressed
/// last.
fn pressed(life: &Life, limit: Option<LimitFacts>, at: u64) -> (bool, Option<u64>) {
    let Some(limit) = limit else {
        return (false, None);
    };
    let edges = life.inputs.iter().filter(|edge| edge.index == limit.input);
    let before = edges.filter(|edge| edge.at_ticks <= at);
    let last = before.clone().next_back();
    let mut closed = before.filter(|edge| edge.level == limit.active_level);
    let contact = closed.next_back().map(|edge| edge.at_ticks);
    // Nobody recorded what it was at boot.
    (
        last.is_none_or(|edge| edge.level == limit.active_level),
        contact,
    )
}

impl Judge<'_> {
    pub(super) fn read_beside(&mut self, life: &Life) {
        let Some(facts) = life.beside.as_ref() else {
            return;
        };
        let mut c = Line::read("C", life, Pin::StepC, Pin::DirectionC);
        let mut d = Line::read("D", life, Pin::StepD, Pin::DirectionD);
        // Where C may be.
        let mut places = vec![0_i64];
        let mut quiet_from = 0;
        for (index, taken) in life.commands.iter().enumerate() {
            let later = life.commands[index + 1..].iter();
            let next_queue = later.clone().find(|later| later.queue != taken.queue);
            let until = next_queue.map_or(u64::MAX, |next| next.at.0 * TICKS_PER_US);
            let run = match taken.command {
                Command::MoveC { index } => {
                    self.read_c(life, facts, taken, index, &mut places, &mut c, until)
                }
                Command::MoveD { on } => self.read_d(life, facts, taken, on, &mut d, until),
                _ => continue,
            };
            let (Some(first), Some(last)) = (run.first(), run.last()) else {
                continue;
            };
            if first.at < quiet_from.max(taken.at.0 * TICKS_PER_US) {
                self.wrong(first.at, "C or D moves before its turn".to_owned());
            }
            quiet_from = last.at;
        }
        if life.cut {
            return;
        }
        for line in [c, d] {
            if let Some(step) = line.steps.front() {
                let count = line.steps.len();
                self.wrong(
                    step.at,
                    format!("{}: {count} steps that nobody ordered", line.name),
                );
            }
        }
    }

    /// Returns whether a command counts as executed, and when its queue was stopped.
    fn outcome(life: &Life, taken: &TakenCommand) -> (bool, u64) {
        let stop = life.stops.iter().find(|stop| stop.queue == taken.queue);
        match stop {
            Some(stop) => (
                taken.number < stop.executed_commands,
                stop.at.0 * TICKS_PER_US,
            ),
            None => (taken.number < life.status.executed_commands, u64::MAX),
        }
    }

    #[expect(clippy::too_many_arguments, reason = "one call")]
    fn read_c(
        &mut self,
        life: &Life,
        facts: &BesideFacts,
        taken: &TakenCommand,
        index: u8,
        places: &mut Vec<i64>,
        line: &mut Line,
        until: u64,
    ) -> Vec<Step> {
        let Some((target, hz)) = facts.positions.get(usize::from(index)).copied() else {
            return Vec::new();
        };
        let (executed, stopped_at) = Self::outcome(life, taken);
        let first = line.steps.front().filter(|step| step.at < until);
        let at = first.map_or(taken.at.0 * TICKS_PER_US, |step| step.at);
        let ends = [
            (facts.limits[0], 0),
            (
                facts.limits[1],
                facts.positions[facts.positions.len() - 1].0,
            ),
        ];
        for (limit, place) in ends {
            let (active, contact) = pressed(life, limit, at);
            let known = contact.is_some() || !line.has_stepped;
            if active && known {
                places.push(place);
            }
        }
        let ways: Vec<i64> = places.iter().map(|place| target - place).collect();
        let most = ways.iter().map(|way| way.unsigned_abs()).max().unwrap_or(0);
        // A limit that is left ends as it began: what was possible before may be what it is.
        let sign = first.map_or(0, |step| step.sign);
        let fits = |way: &&i64| way.signum() == sign || **way == 0;
        let most = if executed {
            ways.iter()
                .filter(fits)
                .map(|way| way.unsigned_abs())
                .max()
                .unwrap_or(0)
        } else {
            most
        };
        let run = line.take(
            most,
            TICK_HZ as f64 / f64::from(hz),
            until.min(stopped_at.saturating_add(1)),
        );
        let made: i64 = run.iter().map(|step| step.sign).sum();
        let last_at = run.last().map_or(at, |step| step.at);
        let end = if made > 0 { ends[1] } else { ends[0] };
        let contact = pressed(life, end.0, last_at + LIMIT_TICKS).1;
        let at_limit = contact.is_some_and(|contact| {
            made != 0 && contact + LIMIT_TICKS >= last_at && contact + LIMIT_TICKS > at
        });
        let arrived = ways.contains(&made);
        *places = match (arrived, at_limit) {
            (true, _) if executed => vec![target],
            (_, true) => vec![end.1],
            _ => places.iter().map(|place| place + made).collect(),
        };
        if executed && !arrived && !(at_limit && end.1 == target) {
            self.wrong(
                last_at,
                format!("C made {made} steps to position {index}, of {ways:?}"),
            );
        }
        run
    }

    fn read_d(
        &mut self,
        life: &Life,
        facts: &BesideFacts,
        taken: &TakenCommand,
        on: bool,
        line: &mut Line,
        until: u64,
    ) -> Vec<Step> {
        let (executed, stopped_at) = Self::outcome(life, taken);
        let limit = facts.limits[if on { 3 } else { 2 }];
        let sign = if on { 1 } else { -1 };
        if line.steps.front().is_none_or(|step| step.sign != sign) {
            // It was there.
            return Vec::new();
        }
        let interval = TICK_HZ as f64 / f64::from(facts.d_hz);
        // With a limit it may take an eighth longer than its way.
        let way = facts.d_steps;
        let most = if limit.is_some() {
            way + way / 8 + 1
        } else {
            way
        };
        let run = line.take(most, interval, until.min(stopped_at.saturating_add(1)));
        let made = run.len() as u64;
        let last_at = run.last().map_or(0, |step| step.at);
        let contact = pressed(life, limit, last_at + 1).1;
        let at_limit = contact.is_some_and(|contact| contact + LIMIT_TICKS >= last_at);
        if executed && !at_limit && made.abs_diff(way) > 1 {
            self.wrong(
                last_at,
                format!("D made {made} steps of {way}, and met no limit"),
            );
        }
        run
    }
}
