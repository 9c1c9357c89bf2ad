//! The judge of pulses: takes what a node was told and what its pins did, and knows nothing of how
//! `motion` works.
//!
//! It reads only [`Life`]: commands, stop reports, changes of pins. Its knowledge is the meaning of
//! the commands (a `move` has its edges at 0, d, 2d, …), the driver's timing, and the textbook's
//! v² = v₀² − 2as. It imports neither `motion` nor `node`.
//!
//! | it demands | how exactly |
//! |---|---|
//! | high, low, direction setup and hold times | never less than [`Limits`] |
//! | number, direction and interval of the steps of every command | to the tick |
//! | axes that start together | within [`Limits::skew_ticks`] |
//! | no gap between commands that were there in time | to the tick; at a turn up to [`Limits::turn_ticks_max`] |
//! | nothing after a stop but a deceleration | v² falls by 2a a step |
//! | position = counter = counted edges | exactly |
//!
//! It cannot know what the record does not hold: with [`Life::cut`] it judges what is there.

use crate::{
    pins::{Pin, PinEvent},
    record::{Life, TakenCommand},
};
use keys::{Command, QueueId, StopReport};
use std::fmt;

/// Ticks of one second: the unit of [`PinEvent::at_ticks`].
const TICK_HZ: u64 = 16_000_000;

/// Ticks of one microsecond.
const TICKS_PER_US: u64 = 16;

/// Violations that are listed; what is beyond is only counted.
pub const VIOLATIONS_MAX: usize = 20;

/// What the judge demands.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Limits {
    /// Shortest high time, ticks.
    pub high_ticks_min: u64,
    /// Shortest low time, ticks.
    pub low_ticks_min: u64,
    /// From a change of direction to the next active edge, ticks.
    pub setup_ticks_min: u64,
    /// From the end of a step to a change of direction, ticks.
    pub hold_ticks_min: u64,
    /// Most that axes that start together may differ, ticks.
    pub skew_ticks: u64,
    /// Most that a turn may add between two commands, ticks.
    pub turn_ticks_max: u64,
    /// A command that was there this long before its turn must follow without a gap, ticks.
    pub ahead_ticks: u64,
    /// Deceleration of a controlled stop, steps/s².
    pub stop_accel_hz_per_s: u32,
}

impl Default for Limits {
    /// The default driver profile: 500 ns high and low, 10 µs setup and hold; a turn adds less than
    /// 100 µs; commands are wanted 25 ms ahead.
    fn default() -> Self {
        Self {
            high_ticks_min: 8,
            low_ticks_min: 8,
            setup_ticks_min: 160,
            hold_ticks_min: 160,
            skew_ticks: 3,
            turn_ticks_max: 100 * TICKS_PER_US,
            ahead_ticks: 25_000 * TICKS_PER_US,
            stop_accel_hz_per_s: 100_000,
        }
    }
}

/// What was seen, if all was good.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Summary {
    /// Commands whose every pulse was found.
    pub commands: u64,
    /// Active edges of each axis, both directions.
    pub steps: Vec<u64>,
    /// Largest difference between axes that start together, ticks.
    pub skew_ticks_max: u64,
}

impl fmt::Display for Summary {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{} commands, steps {:?}", self.commands, self.steps)?;
        write!(f, ", start skew at most {} ticks", self.skew_ticks_max)
    }
}

/// What was wrong, and where.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Violation {
    /// When, ticks since boot; `None` if it is about the whole.
    pub at_ticks: Option<u64>,
    /// What.
    pub message: String,
}

impl fmt::Display for Violation {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        if let Some(at) = self.at_ticks {
            let (us, rest) = (at / TICKS_PER_US, at % TICKS_PER_US);
            write!(f, "at {us} µs + {rest} ticks: ")?;
        }
        f.write_str(&self.message)
    }
}

/// Returns where the axes stand after these commands, from 0, by addition alone.
pub fn positions_after<'c>(
    commands: impl IntoIterator<Item = &'c Command>,
    axis_count: usize,
) -> Vec<i64> {
    let mut positions = vec![0i64; axis_count];
    for command in commands {
        if let Command::SetPosition {
            axis,
            position_steps,
        } = *command
        {
            positions[axis.index()] = position_steps;
        }
        for run in runs(command) {
            positions[run.axis] += i64::from(run.steps);
        }
    }
    positions
}

/// Judges one boot of a node by the default [`Limits`].
///
/// # Errors
/// Everything that was found wrong, at most [`VIOLATIONS_MAX`] entries and a count of the rest.
pub fn check_life(life: &Life) -> Result<Summary, Vec<Violation>> {
    check_life_by(life, &Limits::default())
}

/// Judges one boot of a node.
///
/// # Errors
/// As [`check_life`].
pub fn check_life_by(life: &Life, limits: &Limits) -> Result<Summary, Vec<Violation>> {
    let mut judge = Judge {
        limits,
        axes: (0..life.axis_count).map(|_| Seen::default()).collect(),
        summary: Summary::default(),
        violations: Vec::new(),
        more: 0,
    };
    judge.read_pins(&life.edges);
    judge.read_queues(life);
    judge.summary.steps = judge
        .axes
        .iter()
        .map(|axis| axis.steps.len() as u64)
        .collect();
    if judge.violations.is_empty() {
        return Ok(judge.summary);
    }
    if judge.more > 0 {
        judge.violations.push(Violation {
            at_ticks: None,
            message: format!("and {} more", judge.more),
        });
    }
    Err(judge.violations)
}

/// Steps of one axis in one command.
#[derive(Clone, Copy, Debug)]
struct Run {
    axis: usize,
    interval_ticks: u64,
    steps: i32,
}

fn runs(command: &Command) -> Vec<Run> {
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

/// How long a command lasts.
fn ticks_of(command: &Command) -> u64 {
    if let Command::Pause { pause_ms } = *command {
        return u64::from(pause_ms) * 1_000 * TICKS_PER_US;
    }
    let ticks = |run: &Run| u64::from(run.steps.unsigned_abs()) * run.interval_ticks;
    runs(command).iter().map(ticks).max().unwrap_or(0)
}

#[derive(Clone, Copy, Debug)]
struct Step {
    at: u64,
    sign: i64,
}

/// What the pins of one axis did.
#[derive(Clone, Debug, Default)]
struct Seen {
    steps: Vec<Step>,
    /// Steps that are explained.
    used: usize,
    /// Direction of the last explained step.
    sign: i64,
    /// Sum of the explained steps since boot.
    count: i64,
    /// Position = origin + count.
    origin: i64,
}

/// Where the timeline of a queue was last seen.
#[derive(Clone, Copy, Debug)]
struct Anchor {
    axis: usize,
    at: u64,
    /// Time of the commands since.
    elapsed: u64,
    /// Commands without duration since.
    timeless: u32,
    /// When the latest of these commands was taken.
    taken: u64,
}

struct Judge<'l> {
    limits: &'l Limits,
    axes: Vec<Seen>,
    summary: Summary,
    violations: Vec<Violation>,
    more: u64,
}

impl Judge<'_> {
    fn wrong(&mut self, at_ticks: impl Into<Option<u64>>, message: String) {
        if self.violations.len() == VIOLATIONS_MAX {
            self.more += 1;
            return;
        }
        self.violations.push(Violation {
            at_ticks: at_ticks.into(),
            message,
        });
    }

    /// Levels and their times.
    fn read_pins(&mut self, edges: &[PinEvent]) {
        #[derive(Clone, Copy, Default)]
        struct Line {
            level: bool,
            positive: bool,
            rose_at: Option<u64>,
            fell_at: Option<u64>,
            turned_at: Option<u64>,
        }
        let mut lines = vec![Line::default(); self.axes.len()];
        let mut before = 0;
        for event in edges {
            let at = event.at_ticks;
            let (Pin::Step(axis) | Pin::Direction(axis)) = event.pin;
            if at < before {
                self.wrong(at, "the record is not in order of time".to_owned());
            }
            before = at;
            let Some(line) = lines.get_mut(axis.index()) else {
                self.wrong(at, format!("axis {} does not exist", axis.0));
                continue;
            };
            let since = |then: Option<u64>| then.map_or(u64::MAX, |then| at - then);
            let demand = |what: &str, ticks: u64, least: u64| {
                let message = || format!("{what} of {ticks} ticks, at least {least} are needed");
                (ticks < least).then(message)
            };
            let mut bad = [None, None];
            match event.pin {
                Pin::Step(_) if event.level == line.level => {
                    bad[0] = Some("the step pin had that level already".to_owned());
                }
                Pin::Step(_) if event.level => {
                    let limits = self.limits;
                    bad = [
                        demand("low time", since(line.fell_at), limits.low_ticks_min),
                        demand(
                            "direction setup",
                            since(line.turned_at),
                            limits.setup_ticks_min,
                        ),
                    ];
                    line.rose_at = Some(at);
                    let sign = if line.positive { 1 } else { -1 };
                    self.axes[axis.index()].steps.push(Step { at, sign });
                }
                Pin::Step(_) => {
                    let least = self.limits.high_ticks_min;
                    bad[0] = demand("high time", since(line.rose_at), least);
                    line.fell_at = Some(at);
                }
                Pin::Direction(_) => {
                    if line.level {
                        bad[0] = Some("it turns while a step is high".to_owned());
                    }
                    let least = self.limits.hold_ticks_min;
                    bad[1] = demand("direction hold", since(line.fell_at), least);
                    line.positive = event.level;
                    line.turned_at = Some(at);
                }
            }
            if matches!(event.pin, Pin::Step(_)) {
                line.level = event.level;
            }
            for message in bad.into_iter().flatten() {
                self.wrong(at, format!("axis {}: {message}", axis.0));
            }
        }
    }

    /// Commands against steps, queue by queue.
    fn read_queues(&mut self, life: &Life) {
        let mut rest = life.commands.as_slice();
        while let Some(first) = rest.first() {
            let queue = first.queue;
            let end = rest
                .iter()
                .position(|taken| taken.queue != queue)
                .unwrap_or(rest.len());
            let (commands, later) = rest.split_at(end);
            // Nothing of a later queue can leave before its first command was taken.
            let until = later
                .first()
                .map_or(u64::MAX, |taken| taken.at.0 * TICKS_PER_US);
            self.read_queue(life, queue, commands, until);
            rest = later;
        }
        if life.cut {
            return;
        }
        for axis in 0..self.axes.len() {
            let seen = &self.axes[axis];
            if let Some(step) = seen.steps.get(seen.used) {
                let (at, count) = (step.at, seen.steps.len() - seen.used);
                self.wrong(
                    at,
                    format!("axis {axis}: {count} steps that nobody ordered"),
                );
            }
            let seen = &self.axes[axis];
            let count: i64 = seen.steps.iter().map(|step| step.sign).sum();
            let (counted, position) = (
                life.counted_steps.get(axis).copied(),
                life.status.axes.get(axis).map(|axis| axis.position_steps),
            );
            let expected = seen.origin + count;
            if counted != Some(count) {
                self.wrong(
                    None,
                    format!("axis {axis}: {count} edges, the pulse counter says {counted:?}"),
                );
            }
            if position != Some(expected) {
                self.wrong(
                    None,
                    format!("axis {axis}: it is at {expected}, the status says {position:?}"),
                );
            }
        }
    }

    fn read_queue(&mut self, life: &Life, queue: QueueId, commands: &[TakenCommand], until: u64) {
        let stop = life.stops.iter().find(|stop| stop.queue == queue);
        let executed = match stop {
            Some(stop) => stop.executed_commands,
            None if life.status.queue == queue => life.status.executed_commands,
            None => {
                self.wrong(None, format!("{queue:?} ended without a report"));
                0
            }
        };
        let executed = if life.cut { 0 } else { executed };
        if let Some(stop) = stop
            && !life.cut
            && stop.accepted_commands != commands.len() as u64
        {
            self.wrong(
                None,
                format!(
                    "{queue:?}: {} commands were taken, the report says {}",
                    commands.len(),
                    stop.accepted_commands
                ),
            );
        }
        let mut anchor: Option<Anchor> = None;
        let mut broken = vec![false; self.axes.len()];
        for (index, taken) in commands.iter().enumerate() {
            let number = index as u64;
            if taken.number != number {
                self.wrong(
                    None,
                    format!("command {number} has number {}", taken.number),
                );
            }
            let must_be_whole = number < executed;
            if must_be_whole {
                self.summary.commands += 1;
            }
            if let Command::SetPosition {
                axis,
                position_steps,
            } = taken.command
                && must_be_whole
            {
                let seen = &mut self.axes[axis.index()];
                seen.origin = position_steps - seen.count;
            }
            if matches!(taken.command, Command::Barrier { .. }) {
                // The queue rests there for as long as others need.
                anchor = None;
            }
            let runs = runs(&taken.command);
            let firsts: Vec<_> = runs
                .iter()
                .filter(|run| !broken[run.axis])
                .filter_map(|run| {
                    let seen = &self.axes[run.axis];
                    let step = seen.steps.get(seen.used)?;
                    (step.at < until).then_some((step.at, run.axis))
                })
                .collect();
            // Behind a stop, a step may belong to a deceleration instead.
            let stop_at = stop.map_or(u64::MAX, |stop| stop.at.0 * TICKS_PER_US);
            let planned = firsts.len() == runs.len() && firsts.iter().all(|(at, _)| *at <= stop_at);
            if !broken.contains(&true) && (must_be_whole || planned) {
                self.check_begin(&mut anchor, taken, &runs, &firsts);
            }
            if let Some(anchor) = anchor.as_mut() {
                let ticks = ticks_of(&taken.command);
                anchor.elapsed += ticks;
                anchor.timeless += u32::from(ticks == 0);
            }
            for run in runs {
                if broken[run.axis] {
                    continue;
                }
                let found = self.take_steps(&run, until);
                if found < run.steps.unsigned_abs() {
                    broken[run.axis] = true;
                    if must_be_whole {
                        self.wrong(
                            None,
                            format!(
                                "axis {}: command {number} counts as executed, {found} of its {} \
                                 steps were found",
                                run.axis,
                                run.steps.unsigned_abs()
                            ),
                        );
                    }
                }
            }
        }
        if let Some(stop) = stop.filter(|_| !life.cut) {
            self.check_stop(stop, until);
        }
    }

    /// The first edge of a command against the commands before it.
    fn check_begin(
        &mut self,
        anchor: &mut Option<Anchor>,
        taken: &TakenCommand,
        runs: &[Run],
        firsts: &[(u64, usize)],
    ) {
        let taken_at = taken.at.0 * TICKS_PER_US;
        if let Some(anchor) = anchor.as_mut() {
            anchor.taken = anchor.taken.max(taken_at);
        }
        let (Some((at, axis)), Some((last, _))) = (firsts.iter().min(), firsts.iter().max()) else {
            return;
        };
        let (at, axis) = (*at, *axis);
        let skew = last - at;
        self.summary.skew_ticks_max = self.summary.skew_ticks_max.max(skew);
        if skew > self.limits.skew_ticks {
            self.wrong(
                at,
                format!("axes that start together differ by {skew} ticks"),
            );
        }
        if at < taken_at {
            self.wrong(at, "a step before its command was taken".to_owned());
        }
        if let Some(anchor) = *anchor {
            let due = anchor.at + anchor.elapsed;
            let skew = if anchor.axis == axis {
                0
            } else {
                self.limits.skew_ticks
            };
            let turns = runs
                .iter()
                .any(|run| i64::from(run.steps.signum()) != self.axes[run.axis].sign);
            let added = if turns { self.limits.turn_ticks_max } else { 0 };
            let in_time = anchor.taken + self.limits.ahead_ticks <= due && anchor.timeless < 200;
            if at + skew < due {
                self.wrong(at, format!("a command begins {} ticks early", due - at));
            } else if in_time && at > due + skew + added {
                self.wrong(at, format!("a gap of {} ticks before a command", at - due));
            }
        }
        *anchor = Some(Anchor {
            axis,
            at,
            elapsed: 0,
            timeless: 0,
            taken: taken_at,
        });
    }

    /// Explains as many steps as belong to this run and returns how many.
    fn take_steps(&mut self, run: &Run, until: u64) -> u32 {
        let seen = &mut self.axes[run.axis];
        let sign = i64::from(run.steps.signum());
        let mut found = 0;
        let mut before: Option<u64> = None;
        while found < run.steps.unsigned_abs() {
            let Some(step) = seen.steps.get(seen.used) else {
                break;
            };
            let fits = before.is_none_or(|before| step.at - before == run.interval_ticks);
            if step.at >= until || step.sign != sign || !fits {
                break;
            }
            before = Some(step.at);
            seen.used += 1;
            seen.count += sign;
            seen.sign = sign;
            found += 1;
        }
        found
    }

    /// Steps after the plan was left must slow down; then the report must be right.
    fn check_stop(&mut self, stop: &StopReport, until: u64) {
        let stop_at = stop.at.0 * TICKS_PER_US;
        let lost_hz2 = 2.0 * f64::from(self.limits.stop_accel_hz_per_s);
        for axis in 0..self.axes.len() {
            let mut wrong = None;
            // The first interval that slows down holds half of the first step's loss.
            let mut share = 0.5;
            let seen = &mut self.axes[axis];
            while let Some(step) = seen.steps.get(seen.used).copied()
                && step.at < until
            {
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
                if step.at <= stop_at || step.sign != seen.sign || !slows {
                    wrong = Some((step.at, "a step that is neither plan nor deceleration"));
                    break;
                }
                seen.used += 1;
                seen.count += step.sign;
            }
            if let Some((at, message)) = wrong {
                self.wrong(at, format!("axis {axis}: {message}"));
            }
            let seen = &self.axes[axis];
            let expected = seen.origin + seen.count;
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
