//! Raw moves and pauses: steps at one interval, from one instant to another.

use super::{Planner, Tail};
use crate::{
    axis::Axis,
    limits::{COMMAND_TICKS_MAX, TICKS_PER_US, WORD_TICKS_MIN},
    segment::{Direction, Segment},
};
use keys::{AxisId, Command};

/// The steps of one axis in one command.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Run {
    pub(crate) axis: AxisId,
    pub(crate) interval_ticks: u64,
    pub(crate) steps: i32,
}

impl Run {
    pub(crate) fn ticks(&self) -> Option<u64> {
        u64::from(self.steps.unsigned_abs()).checked_mul(self.interval_ticks)
    }
}

/// Returns the steps of a command, on at most two axes.
pub(crate) fn runs_of(command: &Command) -> impl Iterator<Item = Run> + use<> {
    let run = |axis: u8, delay_us: u32, steps: i32| {
        (steps != 0).then_some(Run {
            axis: AxisId(axis),
            interval_ticks: u64::from(delay_us) * TICKS_PER_US,
            steps,
        })
    };
    let runs = match *command {
        Command::Move {
            axis,
            delay_us,
            steps,
        } => [run(axis.0, delay_us, steps), None],
        Command::SyncMove { delay_us, steps } => {
            [run(0, delay_us[0], steps[0]), run(1, delay_us[1], steps[1])]
        }
        _ => [None, None],
    };
    runs.into_iter().flatten()
}

/// Returns how long a command takes without any turn, `None` if that is more than
/// [`COMMAND_TICKS_MAX`].
pub(crate) fn ticks_of(command: &Command) -> Option<u64> {
    let mut ticks = match *command {
        Command::Pause { pause_ms } => u64::from(pause_ms) * 1_000 * TICKS_PER_US,
        _ => 0,
    };
    for run in runs_of(command) {
        ticks = ticks.max(run.ticks()?);
    }
    (ticks <= COMMAND_TICKS_MAX).then_some(ticks)
}

/// A raw move or a pause on the timeline.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Played {
    /// Its steps; none in a pause.
    pub(crate) runs: [Option<Run>; 2],
    /// When its first edges are due, ticks since boot.
    pub(crate) begin: u64,
}

/// Returns how many of a run's edges are due before this time, which counts from the first one.
fn edges_before(run: &Run, ticks: u64) -> u64 {
    ticks
        .div_ceil(run.interval_ticks)
        .min(u64::from(run.steps.unsigned_abs()))
}

impl Tail {
    /// Writes the edges of a run that are due before `cut` and are not encoded; the run begins at
    /// `begin`.
    fn run_until(&mut self, axis: &mut Axis, run: &Run, begin: u64, cut: u64) {
        let first = edges_before(run, self.at.saturating_sub(begin));
        let end = edges_before(run, cut.saturating_sub(begin));
        let Some(count) = end.checked_sub(first).filter(|count| *count > 0) else {
            return;
        };
        let due = |edge: u64| begin + edge * run.interval_ticks;
        self.approach(axis, due(first), Direction::of(i64::from(run.steps)));
        let steady = |count: u64| Segment::steady(count as u32, run.interval_ticks);
        if due(end) <= cut {
            self.steps(axis, steady(count), due(end));
            self.low_ticks = run.interval_ticks - axis.timing().high_of(run.interval_ticks);
            return;
        }
        if count > 1 {
            self.steps(axis, steady(count - 1), due(end - 1));
        }
        self.at = due(end - 1);
        self.edge_at = Some(self.at);
    }
}

impl Planner {
    /// Returns whether all that is not encoded until `cut` is raw moves and pauses.
    pub(crate) fn is_raw_until(&self, cut: u64, axes: &[Axis], started_at: u64) -> bool {
        let committed = axes.iter().map(Axis::committed_ticks);
        let least = started_at + committed.min().unwrap_or(0);
        let mut stretches = self.stretches[..self.count].iter().flatten();
        !stretches.any(|stretch| stretch.end_ticks > least && stretch.begin.ticks < cut)
    }

    /// Leaves everything behind `cut`: edges that are due before it are made, then all axes rest.
    /// All until then must be raw; `moves` gives it in order. Returns when the last axis rests.
    pub(crate) fn leave_raw(
        &mut self,
        cut: u64,
        moves: impl Iterator<Item = Played> + Clone,
        axes: &mut [Axis],
        started_at: u64,
    ) -> u64 {
        self.rewind(axes, started_at);
        self.drop_path();
        let mut end = cut;
        for (index, (axis, tail)) in axes.iter_mut().zip(&mut self.tails).enumerate() {
            for Played { runs, begin } in moves.clone() {
                let own = |run: &&Run| usize::from(run.axis.0) == index;
                for run in runs.iter().flatten().filter(own) {
                    tail.run_until(axis, run, begin, cut);
                }
            }
            let least = axis.timing().interval_ticks_min();
            let whole = tail.edge_at.map_or(cut, |edge| edge + least);
            tail.rest(axis, cut.max(whole));
            end = end.max(tail.at);
        }
        end
    }

    /// Writes the segments of a command on all axes and returns how long it takes, ticks.
    /// Every axis must have room for `SEGMENTS_PER_COMMAND`.
    pub(crate) fn plan(&mut self, command: &Command, axes: &mut [Axis]) -> u64 {
        let ticks = ticks_of(command).expect("checked when it was accepted");
        let mut runs = runs_of(command);
        let runs = [runs.next(), runs.next()];
        self.plan_runs(runs, 0, ticks, axes)
    }

    /// Writes what is left of a raw move or a pause: its last `left_ticks`. Returns how long that
    /// takes.
    pub(crate) fn plan_left(
        &mut self,
        runs: [Option<Run>; 2],
        left_ticks: u64,
        axes: &mut [Axis],
    ) -> u64 {
        let passed = command_ticks(&runs).saturating_sub(left_ticks);
        self.plan_runs(runs, passed, left_ticks, axes)
    }

    /// Writes the edges that are due from `passed` ticks of these runs on, `ticks` in all.
    fn plan_runs(
        &mut self,
        runs: [Option<Run>; 2],
        passed: u64,
        ticks: u64,
        axes: &mut [Axis],
    ) -> u64 {
        let begins = |run: &Run| {
            let first = edges_before(run, passed);
            let steps = run.steps.unsigned_abs() - first as u32;
            (
                steps,
                first * run.interval_ticks - passed.min(first * run.interval_ticks),
            )
        };
        let mut window_ticks = 0;
        for run in runs.iter().flatten() {
            let (steps, wait_ticks) = begins(run);
            let axis = usize::from(run.axis.0);
            let tail = self.tails[axis];
            if steps == 0 {
                continue;
            }
            if tail.direction != Some(Direction::of(i64::from(run.steps))) {
                let missing = axes[axis]
                    .timing()
                    .window_ticks()
                    .saturating_sub(tail.low_ticks);
                window_ticks = window_ticks.max(missing.saturating_sub(wait_ticks));
            }
            if (1..WORD_TICKS_MIN).contains(&wait_ticks) {
                // Less than a word cannot be played alone.
                window_ticks = window_ticks.max(WORD_TICKS_MIN);
            }
        }
        if window_ticks > 0 || (1..WORD_TICKS_MIN).contains(&ticks) {
            window_ticks = window_ticks.max(WORD_TICKS_MIN);
        }
        let total_ticks = window_ticks + ticks;
        if total_ticks == 0 {
            return 0;
        }
        for (index, axis) in axes.iter_mut().enumerate() {
            let tail = &mut self.tails[index];
            let mut own = runs.iter().flatten();
            let own = own.find(|run| usize::from(run.axis.0) == index);
            let left = own.map(|run| (run, begins(run)));
            let Some((run, (steps, wait_ticks))) = left.filter(|(_, (steps, _))| *steps > 0) else {
                axis.push(Segment::Low { ticks: total_ticks });
                tail.low_ticks = tail.low_ticks.saturating_add(total_ticks);
                continue;
            };
            if window_ticks + wait_ticks > 0 {
                axis.push(Segment::Low {
                    ticks: window_ticks + wait_ticks,
                });
            }
            let direction = Direction::of(i64::from(run.steps));
            if tail.direction != Some(direction) {
                axis.push(Segment::Turn { direction });
                tail.direction = Some(direction);
            }
            axis.push(Segment::steady(steps, run.interval_ticks));
            let own_ticks = wait_ticks + u64::from(steps) * run.interval_ticks;
            tail.low_ticks = run.interval_ticks - axis.timing().high_of(run.interval_ticks);
            // Less than a word cannot be played alone; a command's axes differ by whole µs.
            if own_ticks < ticks {
                axis.push(Segment::Low {
                    ticks: ticks - own_ticks,
                });
                tail.low_ticks += ticks - own_ticks;
            }
        }
        total_ticks
    }
}

/// Returns how long the longer of the runs takes, ticks.
pub(crate) fn command_ticks(runs: &[Option<Run>; 2]) -> u64 {
    let ticks = runs.iter().flatten().filter_map(Run::ticks);
    ticks.max().unwrap_or(0)
}
