//! Raw moves and pauses: steps at one interval, from one instant to another.

use super::Planner;
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

impl Planner {
    /// Writes the segments of a command on all axes and returns how long it takes, ticks.
    /// Every axis must have room for `SEGMENTS_PER_COMMAND`.
    pub(crate) fn plan(&mut self, command: &Command, axes: &mut [Axis]) -> u64 {
        let ticks = ticks_of(command).expect("checked when it was accepted");
        let mut window_ticks = 0;
        for run in runs_of(command) {
            let axis = usize::from(run.axis.0);
            let tail = self.tails[axis];
            if tail.direction != Some(Direction::of(i64::from(run.steps))) {
                let missing = axes[axis]
                    .timing()
                    .window_ticks()
                    .saturating_sub(tail.low_ticks);
                window_ticks = window_ticks.max(missing);
            }
        }
        if window_ticks > 0 {
            window_ticks = window_ticks.max(WORD_TICKS_MIN);
        }
        let total_ticks = window_ticks + ticks;
        if total_ticks == 0 {
            return 0;
        }
        for (index, axis) in axes.iter_mut().enumerate() {
            let tail = &mut self.tails[index];
            let run = runs_of(command).find(|run| usize::from(run.axis.0) == index);
            let Some(run) = run else {
                axis.push(Segment::Low { ticks: total_ticks });
                tail.low_ticks = tail.low_ticks.saturating_add(total_ticks);
                continue;
            };
            if window_ticks > 0 {
                axis.push(Segment::Low {
                    ticks: window_ticks,
                });
            }
            let direction = Direction::of(i64::from(run.steps));
            if tail.direction != Some(direction) {
                axis.push(Segment::Turn { direction });
                tail.direction = Some(direction);
            }
            axis.push(Segment::steady(
                run.steps.unsigned_abs(),
                run.interval_ticks,
            ));
            let own_ticks = run.ticks().expect("within the command's ticks");
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
