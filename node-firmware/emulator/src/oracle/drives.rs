//! Axes that are driven outside the queue: jogs, and drives of scripts.
//!
//! Nobody can say where such an axis ought to be at which instant: it is changed in flight, and comes to
//! rest when nobody renews it. But while it is driven the queue rests, so all its steps of that time are
//! the drive's; and textbook bounds them: no faster and no harder than any of its orders allows, from
//! rest, or the jump of one of them, to rest. The queue goes on from where it ends.

use super::{Judge, Step, TICK_HZ};
use crate::{
    kinematics::Ideal,
    record::{Driven, Life},
};

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

fn seconds(from: Step, to: Step) -> f64 {
    (to.at - from.at) as f64 / TICK_HZ as f64
}
