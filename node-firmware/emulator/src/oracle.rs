//! The judge of pulses: takes what a node was told and what its pins did, and knows nothing of how
//! `motion` works.
//!
//! It reads only [`Life`]: commands, stop reports, changes of pins. Its knowledge is the meaning of
//! the commands (a `move` has its edges at 0, d, 2d, …), the driver's timing, and the textbook: of
//! [`crate::kinematics`] and v² = v₀² − 2as. It imports neither `motion` nor `node`.
//!
//! | it demands | how exactly |
//! |---|---|
//! | high, low, direction setup and hold times | never less than [`Limits`] |
//! | number, direction and interval of the steps of every raw move | to the tick |
//! | every edge of a ramp and of a line that stands alone | within 1 tick of the ideal |
//! | lines in a row, which may be joined | limits of speed, acceleration, jerk and corners, one by one and in a row; all axes at one place; never longer than with a halt at each corner |
//! | axes that start together | within [`Limits::skew_ticks`] |
//! | no gap between commands that were there in time | to the tick; where an axis turns, until [`Limits::turn_ticks_max`] after its last edge |
//! | raw moves that are held | all intervals but one to the tick; that one as much longer on every axis |
//! | nothing after a stop but a deceleration | raw moves: v² falls by 2a a step; paths: on the path, by their own limits, at rest in time |
//! | homing: ways, speeds, and the position of the switch | to the step |
//! | an axis that is driven: no faster, no harder than its orders, from rest to rest; the queue rests | to a tick |
//! | C and D: way, rate, limits, each in its turn | steps exactly, intervals to a tick |
//! | position = counter = counted edges | exactly |
//! | ramps and lines that were held, or told another speed, in flight | as planned until then; then by their limits and on their line, at rest in time |
//! | with [`Life::paced`] and homing: only the pins, all steps of what has ended, and the positions | exactly |
//!
//! It cannot know what the record does not hold: with [`Life::cut`] it judges what is there. It
//! takes any joining of lines that keeps the limits, the best one or not. Behind a path whose steps
//! are wrong it judges nothing more but the pins: all that follows would seem wrong.
//!
//! | file | owns |
//! |---|---|
//! | `pins` | levels and their times |
//! | `queues` | commands against steps, one after the other |
//! | `moves`, `holds` | raw moves, and a hold in the midst of them |
//! | `paths` | ramps and lines, edge by edge |
//! | `paced` | those of them that were held or changed in flight |
//! | `track` | joined or stopped paths, by their limits |
//! | `turning` | an axis that many small corners turn |
//! | `beside` | C and D |
//! | `homing` | the way to a reference switch and off it |
//! | `drives` | axes that are driven outside the queue |
//! | `count` | steps by number alone |

mod beside;
mod count;
mod drives;
mod holds;
mod homing;
mod moves;
mod paced;
mod paths;
mod pins;
mod queues;
mod track;
mod turning;

use crate::record::{Held, HomeFacts, InputEdge, Life, Speed, TakenCommand};
use keys::Command;
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
    /// A turn may hold a command up until this long after the last active edge of the axis, ticks;
    /// no longer, and not at all where it is due later anyway.
    pub turn_ticks_max: u64,
    /// A command that was there this long before its turn must follow without a gap, ticks.
    pub ahead_ticks: u64,
    /// Deceleration of a controlled stop of raw moves, steps/s².
    pub stop_accel_hz_per_s: u32,
    /// Most that the speed of any axis may jump where lines are joined, Hz.
    pub junction_hz: u32,
    /// How far an edge of the record may lie off, ticks: 0 for what an emulated pin did.
    pub sample_ticks: u64,
    /// A path decelerates this long after a stop, ticks.
    pub stop_begin_ticks: u64,
}

impl Default for Limits {
    /// The default driver profile: 500 ns high and low, 10 µs setup and hold; a turn takes 2.5 µs of
    /// high time, 100 µs for its half block, and one of 100 µs and the setup; commands are wanted 25 ms
    /// ahead; a stop takes effect within 2 ms.
    fn default() -> Self {
        Self {
            high_ticks_min: 8,
            low_ticks_min: 8,
            setup_ticks_min: 160,
            hold_ticks_min: 160,
            skew_ticks: 3,
            turn_ticks_max: 213 * TICKS_PER_US,
            ahead_ticks: 25_000 * TICKS_PER_US,
            stop_accel_hz_per_s: 100_000,
            junction_hz: 200,
            sample_ticks: 0,
            stop_begin_ticks: 2_000 * TICKS_PER_US,
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
        go(&mut positions, command);
    }
    positions
}

/// Adds what a command does to the positions.
fn go(positions: &mut [i64], command: &Command) {
    match *command {
        Command::SetPosition {
            axis,
            position_steps,
        }
        | Command::RampTo {
            axis,
            position_steps,
            ..
        } => positions[axis.index()] = position_steps,
        Command::Ramp { axis, steps, .. } => positions[axis.index()] += i64::from(steps),
        Command::Line { steps, .. } => {
            for (position, steps) in positions.iter_mut().zip(steps) {
                *position += i64::from(steps);
            }
        }
        _ => {
            for run in moves::runs(command) {
                positions[run.axis] += i64::from(run.steps);
            }
        }
    }
}

/// Judges one boot of a node by the default [`Limits`].
///
/// # Errors
/// Everything that was found wrong, at most [`VIOLATIONS_MAX`] entries and a count of the rest.
pub fn check_life(life: &Life) -> Result<Summary, Vec<Violation>> {
    check_life_by(life, &Limits::default())
}

/// Judges the levels of the pins alone, by the default [`Limits`]: high, low, setup and hold times.
///
/// # Errors
/// As [`check_life`].
pub fn check_pins(life: &Life) -> Result<(), Vec<Violation>> {
    let limits = Limits::default();
    let mut judge = Judge::new(life, &limits);
    judge.read_pins(&life.edges);
    if judge.violations.is_empty() {
        Ok(())
    } else {
        Err(judge.violations)
    }
}

/// Judges one boot of a node.
///
/// # Errors
/// As [`check_life`].
pub fn check_life_by(life: &Life, limits: &Limits) -> Result<Summary, Vec<Violation>> {
    let mut judge = Judge::new(life, limits);
    judge.read_pins(&life.edges);
    judge.read_drives(life);
    let homes = |taken: &TakenCommand| matches!(taken.command, Command::Home { .. });
    if life.paced && life.commands.iter().any(homes) {
        judge.count(life);
    } else {
        judge.read_queues(life);
        judge.read_beside(life);
    }
    judge.summary.steps = judge
        .axes
        .iter()
        .map(|axis| axis.steps.len() as u64 + axis.driven_count)
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
    /// A stop ended its path: more steps of this queue are wrong.
    rests: bool,
    /// Steps of drives, which are not among the others.
    driven_count: u64,
    /// Their sum.
    driven_steps: i64,
}

impl Seen {
    fn position(&self) -> i64 {
        self.origin + self.count
    }

    /// The first step that is not explained, if it is before `until`.
    fn next(&self, until: u64) -> Option<Step> {
        let step = self.steps.get(self.used).copied();
        step.filter(|step| step.at < until)
    }

    /// The next step is explained.
    fn take(&mut self) {
        self.sign = self.steps[self.used].sign;
        self.count += self.sign;
        self.used += 1;
    }
}

struct Judge<'l> {
    limits: &'l Limits,
    axes: Vec<Seen>,
    summary: Summary,
    violations: Vec<Violation>,
    more: u64,
    /// A path had a fault: which step belongs to which later command cannot be told.
    lost: bool,
    inputs: &'l [InputEdge],
    homes: &'l [HomeFacts],
    inverted: &'l [bool],
    external: &'l [bool],
    lidar_waits: bool,
    holds: holds::Holds,
    held: &'l [Held],
    speeds: &'l [Speed],
    /// When the last path that was read ended, ticks.
    path_until: u64,
    /// What drives have made, in order of time, as far as the queue has not come there.
    shifts: Vec<drives::Shift>,
    /// Nothing of what is still to be read leaves before this, ticks.
    not_before: u64,
}

impl<'l> Judge<'l> {
    fn new(life: &'l Life, limits: &'l Limits) -> Self {
        Self {
            limits,
            axes: (0..life.axis_count).map(|_| Seen::default()).collect(),
            summary: Summary::default(),
            violations: Vec::new(),
            more: 0,
            lost: false,
            inputs: &life.inputs,
            homes: &life.homes,
            inverted: &life.inverted,
            external: &life.external,
            lidar_waits: life.lidar_waits,
            holds: holds::Holds::new(&life.holds),
            held: &life.holds,
            speeds: &life.speeds,
            path_until: 0,
            shifts: Vec::new(),
            not_before: 0,
        }
    }

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
}
