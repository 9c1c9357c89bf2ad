//! Axes that are driven outside the queue: jogs, and drives of scripts.
//!
//! Nobody can say where such an axis ought to be at which instant: it is changed in flight, and comes to
//! rest when nobody renews it. But while it is driven the queue rests, so all its steps of that time are
//! the drive's; and textbook bounds them: no faster and no harder than any of its orders allows, with no
//! more jerk if they are S-curves of one acceleration and jerk, from rest, or the jump of one of them,
//! to rest. The queue goes on from where it ends.

use super::{Judge, Step, TICK_HZ, track::scales};
use crate::{
    kinematics::Ideal,
    record::{Driven, Life},
};
use keys::command::{Ramp, RampShape};

/// How far an edge may be off its instant, ticks: rounding, and where a way is changed a rest that is
/// shorter than a word of the pulse hardware.
const EDGE_TICKS: f64 = 3.0;

/// What a drive has made of an axis' position.
#[derive(Clone, Copy, Debug)]
pub(super) struct Shift {
    axis: usize,
    from: u64,
    until: u64,
    steps: i64,
    sign: i64,
}

impl Judge<'_> {
    /// Takes the steps of drives out of what the queue has to explain, and judges them.
    pub(super) fn read_drives(&mut self, life: &Life) {
        for driven in &life.drives {
            let index = driven.axis.index();
            let (from, until) = (driven.from_ticks, driven.until_ticks.unwrap_or(u64::MAX));
            let seen = &mut self.axes[index];
            let begin = seen.steps.partition_point(|step| step.at < from);
            let end = seen.steps.partition_point(|step| step.at <= until);
            let made: Vec<Step> = seen.steps.drain(begin..end.max(begin)).collect();
            seen.driven_count += made.len() as u64;
            seen.driven_steps += made.iter().map(|step| step.sign).sum::<i64>();
            if !life.paced {
                self.judge_drive(life, driven, &made);
            }
            self.shifts.push(Shift {
                axis: index,
                from,
                until,
                steps: made.iter().map(|step| step.sign).sum(),
                sign: made.last().map_or(0, |step| step.sign),
            });
        }
        self.shifts.sort_by_key(|shift| shift.from);
    }

    /// The drives that have begun by then are over for what comes now. Returns whether there was one.
    pub(super) fn pass_drives(&mut self, until: u64, planned: &mut [i64]) -> bool {
        let count = self.shifts.partition_point(|shift| shift.from <= until);
        for shift in self.shifts.drain(..count).collect::<Vec<_>>() {
            let seen = &mut self.axes[shift.axis];
            seen.count += shift.steps;
            planned[shift.axis] += shift.steps;
            if shift.sign != 0 {
                seen.sign = shift.sign;
            }
            self.not_before = self.not_before.max(shift.until);
        }
        count > 0
    }

    fn judge_drive(&mut self, life: &Life, driven: &Driven, made: &[Step]) {
        let orders = &driven.orders;
        let speed = orders.iter().map(|order| order.speed_hz).max();
        let accel = orders.iter().map(Ideal::accel_of).reduce(f64::max);
        let (Some(speed), Some(accel)) = (speed.map(f64::from), accel) else {
            return self.wrong(driven.from_ticks, "an axis is driven by nobody".into());
        };
        // A long move begins with all of its jump, and a smoothstep ends with one.
        let jump = |at_end: bool| {
            let ideals = orders.iter().map(|order| Ideal::of_ramp(1 << 40, order));
            let speed = |ideal: Ideal| ideal.at(if at_end { ideal.total_s() } else { 0.0 }).speed;
            ideals.map(speed).fold(0.0, f64::max)
        };
        let jumps = [jump(false), jump(true)];
        // Two edges are a step apart, and the nearer one less than a step from the place of rest,
        // which need not be a whole one where the drive was left on its way.
        let least = |jump: f64| {
            let square = jump * jump;
            let root = (square + 4.0 * accel).sqrt() + (square + 2.0 * accel).sqrt();
            2.0 / root
        };
        let stopped = |stop: u64| (driven.from_ticks..).contains(&stop);
        let stops = life.stops.iter().map(|stop| stop.at);
        let stops = stops.chain(life.stopping.map(|(_, at)| at));
        let was_stopped = stops.into_iter().any(|at| stopped(at.0 * 16));
        let ends = driven.until_ticks.is_some() && !was_stopped && !life.cut;
        let axis = driven.axis.0;
        let runs: Vec<_> = made.chunk_by(|a, b| a.sign == b.sign).collect();
        for (number, run) in runs.iter().enumerate() {
            let intervals: Vec<f64> = run
                .windows(2)
                .map(|pair| seconds(pair[0], pair[1]))
                .collect();
            // Each edge may be a tick off, either way.
            let error = |interval: f64| 2.0 / TICK_HZ as f64 / (interval * interval);
            for (step, interval) in run.iter().zip(&intervals) {
                let is = 1.0 / interval;
                if is > speed + error(*interval) {
                    self.wrong(
                        step.at,
                        format!("axis {axis} is driven at {is:.1} Hz, {speed} were allowed"),
                    );
                    return;
                }
            }
            for (step, pair) in run.iter().zip(intervals.windows(2)) {
                let change = (1.0 / pair[1] - 1.0 / pair[0]).abs();
                // Between the two it may have rested, and jumped.
                let jump = match jumps {
                    [begin, _] if pair[0] > pair[1] && pair[0] >= least(0.0) => begin,
                    [_, end] if pair[1] > pair[0] && pair[1] >= least(0.0) => end,
                    _ => 0.0,
                };
                let mean = accel * (pair[0] + pair[1]) / 2.0;
                let most = mean + jump + error(pair[0]) + error(pair[1]);
                if change > most {
                    let is = change / (pair[0] + pair[1]) * 2.0;
                    self.wrong(
                        step.at,
                        format!("axis {axis} is driven by {is:.0} steps/s², {accel} were allowed"),
                    );
                    return;
                }
            }
            if let Some((at, message)) = jerk_of(orders).and_then(|jerk| {
                // Where it may have rested, its steps are not counted from a whole one.
                let moving = |pair: &(Step, Step)| seconds(pair.0, pair.1) < least(0.0);
                let pairs: Vec<_> = run.windows(2).map(|pair| (pair[0], pair[1])).collect();
                let mut parts = pairs.chunk_by(|a, b| moving(a) && moving(b));
                parts.find_map(|part| too_jerky(part, jerk))
            }) {
                self.wrong(at, format!("axis {axis} is driven by {message}"));
                return;
            }
            let slack = 3.0 / TICK_HZ as f64;
            let is_last = number + 1 == runs.len();
            let rests = [
                (intervals.first(), jumps[0]),
                (intervals.last().filter(|_| !is_last || ends), jumps[1]),
            ];
            for (interval, jump) in rests {
                if interval.is_some_and(|interval| interval + slack < least(jump)) {
                    self.wrong(
                        run[0].at,
                        format!("axis {axis} is driven, but not from rest to rest"),
                    );
                    return;
                }
            }
        }
    }
}

/// The jerk that all of these orders keep, steps/s³: with other limits an acceleration that was begun by
/// one may have to end by another's.
fn jerk_of(orders: &[Ramp]) -> Option<f64> {
    let limits = |order: &Ramp| match order.shape {
        RampShape::Jerk { jerk_hz_per_s2 } => Some((order.accel_hz_per_s, jerk_hz_per_s2)),
        RampShape::Trapezoid { .. } | RampShape::Smooth { .. } => None,
    };
    let first = limits(orders.first()?)?;
    let same = orders.iter().all(|order| limits(order) == Some(first));
    same.then_some(f64::from(first.1))
}

/// Where these steps, each with the next one, have more than this jerk: a divided difference of four
/// instants is a mean of it.
fn too_jerky(part: &[(Step, Step)], jerk: f64) -> Option<(u64, String)> {
    let (first, last) = (part.first()?, part.last()?);
    let steps: Vec<Step> = part.iter().map(|pair| pair.0).chain([last.1]).collect();
    let off_s = EDGE_TICKS / TICK_HZ as f64;
    let at_s = |index: usize| seconds(first.0, steps[index]);
    scales(steps.len(), 3).find_map(|(index, scale)| {
        let times = [0, 1, 2, 3].map(|number| at_s(index + number * scale));
        let count = scale as f64;
        let speed = |from: usize| {
            let span = times[from + 1] - times[from];
            (
                count / span,
                count / span * 2.0 * off_s / (span - 2.0 * off_s).max(1e-9),
            )
        };
        let accel = |from: usize| {
            let (before, behind) = (speed(from), speed(from + 1));
            let half = (times[from + 2] - times[from]) / 2.0;
            let accel = (behind.0 - before.0) / half;
            (
                accel,
                (before.1 + behind.1) / half + accel.abs() * off_s / half,
            )
        };
        let (before, behind) = (accel(0), accel(1));
        let third = (times[3] - times[0]) / 3.0;
        let found = (behind.0 - before.0) / third;
        let slack = (before.1 + behind.1) / third;
        (found.abs() > jerk * (1.0 + 1e-6) + slack).then(|| {
            let message = format!(
                "{found:.0} steps/s³ over {} steps, {jerk} were allowed",
                3 * scale
            );
            (steps[index + 3 * scale].at, message)
        })
    })
}

fn seconds(from: Step, to: Step) -> f64 {
    (to.at - from.at) as f64 / TICK_HZ as f64
}
