//! Raw moves: intervals to the tick, and what a stop may make of them.

use super::{Judge, TICK_HZ, TICKS_PER_US};
use keys::{Command, StopReport};

/// Steps of one axis in one command.
#[derive(Clone, Copy, Debug)]
pub(super) struct Run {
    pub(super) axis: usize,
    interval_ticks: u64,
    pub(super) steps: i32,
}

/// What a command makes of raw steps.
pub(super) fn runs(command: &Command) -> Vec<Run> {
    let run = |axis: usize, delay_us: u32, steps: i32| Run {
        axis,
        interval_ticks: u64::from(delay_us) * TICKS_PER_US,
        steps,
    };
    let runs = match *command {
        Command::Move {
            axis,
            delay_us,
            steps,
        } => vec![run(axis.index(), delay_us, steps)],
        Command::SyncMove { delay_us, steps } => {
            vec![run(0, delay_us[0], steps[0]), run(1, delay_us[1], steps[1])]
        }
        _ => Vec::new(),
    };
    runs.into_iter().filter(|run| run.steps != 0).collect()
}

/// How long a command lasts that is no path.
pub(super) fn ticks_of(command: &Command) -> u64 {
    if let Command::Pause { pause_ms } = *command {
        return u64::from(pause_ms) * 1_000 * TICKS_PER_US;
    }
    let ticks = |run: &Run| u64::from(run.steps.unsigned_abs()) * run.interval_ticks;
    runs(command).iter().map(ticks).max().unwrap_or(0)
}

impl Judge<'_> {
    /// Explains as many steps as belong to this run and returns how many.
    pub(super) fn take_steps(&mut self, run: &Run, until: u64) -> u32 {
        let sample_ticks = self.limits.sample_ticks;
        let seen = &mut self.axes[run.axis];
        let sign = i64::from(run.steps.signum());
        let mut found = 0;
        let mut before: Option<u64> = None;
        while found < run.steps.unsigned_abs() {
            let Some(step) = seen.next(until).filter(|step| step.sign == sign) else {
                break;
            };
            if let Some(before) = before
                // Both edges may lie off.
                && (step.at - before).abs_diff(run.interval_ticks) > 2 * sample_ticks
                && !self
                    .holds
                    .explain(before, step.at, run.interval_ticks, self.limits)
            {
                break;
            }
            before = Some(step.at);
            seen.take();
            found += 1;
        }
        found
    }

    /// Steps after the plan was left must slow down; then the report must be right.
    pub(super) fn check_stop(&mut self, stop: &StopReport, until: u64) {
        let stop_at = stop.at.0 * TICKS_PER_US;
        let lost_hz2 = 2.0 * f64::from(self.limits.stop_accel_hz_per_s);
        for axis in 0..self.axes.len() {
            let mut wrong = None;
            // The first interval that slows down holds half of the first step's loss.
            let mut share = 0.5;
            let seen = &mut self.axes[axis];
            while let Some(step) = seen.next(until) {
                // A step that deviates from the plan begins or continues a deceleration.
                let (before, first) = match seen.used.checked_sub(2) {
                    Some(index) => (seen.steps[index + 1].at, seen.steps[index].at),
                    None => break,
                };
                let interval = step.at - before;
                let interval_before = before - first;
                let speed = |ticks: u64| TICK_HZ as f64 / ticks as f64;
                // The mean speeds of two steps: their squares differ by 2a, to rounding.
                let (v0, v1) = (speed(interval_before), speed(interval));
                let slack_hz2 = 2.0 * v0 * (v0 / interval_before as f64 + v1 / interval as f64);
                let slows = v1 * v1 <= v0 * v0 - share * lost_hz2 * 0.99 + slack_hz2;
                share = 1.0;
                if seen.rests || step.at <= stop_at || step.sign != seen.sign || !slows {
                    wrong = Some((step.at, "a step that is neither plan nor deceleration"));
                    break;
                }
                seen.take();
            }
            if let Some((at, message)) = wrong {
                self.wrong(at, format!("axis {axis}: {message}"));
            }
            let seen = &mut self.axes[axis];
            seen.rests = false;
            let expected = seen.position();
            let reported = stop.positions_steps.get(axis).copied();
            if reported != Some(expected) {
                self.wrong(
                    stop_at,
                    format!("axis {axis}: stopped at {expected}, the report says {reported:?}"),
                );
            }
        }
    }
}
