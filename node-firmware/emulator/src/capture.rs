//! Captures of a logic analyser, judged by the oracle against the job that was played.
//!
//! ```text
//!   capture.csv  ─┐
//!   capture.vcd  ─┴▶ edges with their lines ─▶ Life ─▶ oracle ─▶ verdict with lines
//!   job.json ─────────▶ commands ───────────────┘
//! ```
//!
//! Signals are told apart by their names: `step0`, `dir0`, `step1`, …; others are left out. A table
//! has the time in seconds in its first column and a head with the names (Saleae Logic: *Export raw
//! data*; PulseView: *Export CSV* with *Time column*). A dump is read as IEEE 1364-2005, 18.2,
//! describes it. The analyser must sample at 16 MHz or faster; an edge then lies up to one tick
//! off, which is allowed for.

use crate::{
    oracle::{self, Limits, Summary},
    pins::{Pin, PinEvent},
    record::{Life, TakenCommand},
};
use keys::{
    AXES_MAX, AxisId, Command, Features, LocalMicros, NodeState, QueueId, Status,
    status::AxisStatus,
};
use std::fmt;

/// Most edges that are read.
pub const EDGES_MAX: usize = 16_000_000;

/// Femtoseconds in a tick of 16 MHz.
const FS_PER_TICK: i128 = 62_500_000;

/// What is wrong with a capture.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct CaptureError {
    /// Number of the line, from 1.
    pub line: usize,
    /// What.
    pub message: String,
}

impl fmt::Display for CaptureError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "line {}: {}", self.line, self.message)
    }
}

impl std::error::Error for CaptureError {}

fn wrong(line: usize, message: impl Into<String>) -> CaptureError {
    CaptureError {
        line,
        message: message.into(),
    }
}

/// Edges of the step and direction pins, in order, each with its line.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Capture {
    edges: Vec<PinEvent>,
    lines: Vec<usize>,
    axis_count: usize,
}

/// Puts changes of signals together.
struct Reader {
    capture: Capture,
    /// Pin and level of each signal that counts.
    signals: Vec<Option<(Pin, Option<bool>)>>,
    /// Time of the first line: the capture's zero.
    begin_fs: Option<i128>,
}

impl Reader {
    fn new(names: &[&str], line: usize) -> Result<Self, CaptureError> {
        let signals: Vec<_> = names.iter().map(|name| pin_of(name)).collect();
        let axes = signals.iter().flatten().filter_map(|pin| match pin {
            Pin::Step(axis) => Some(axis.index() + 1),
            _ => None,
        });
        let axis_count = axes.max().ok_or_else(|| {
            wrong(
                line,
                format!("no signal is called step0: there are {}", names.join(", ")),
            )
        })?;
        Ok(Self {
            capture: Capture {
                axis_count,
                ..Capture::default()
            },
            signals: signals
                .into_iter()
                .map(|pin| pin.map(|pin| (pin, None)))
                .collect(),
            begin_fs: None,
        })
    }

    fn take(
        &mut self,
        line: usize,
        at_fs: i128,
        signal: usize,
        level: bool,
    ) -> Result<(), CaptureError> {
        let begin_fs = *self.begin_fs.get_or_insert(at_fs);
        let Some((pin, known)) = self.signals.get_mut(signal).and_then(Option::as_mut) else {
            return Ok(());
        };
        let before = known.replace(level);
        if before == Some(level) || before.is_none() && !level {
            return Ok(());
        }
        if before.is_none() && matches!(pin, Pin::Step(_)) {
            return Err(wrong(line, "the capture begins in the middle of a step"));
        }
        let ticks = (at_fs - begin_fs + FS_PER_TICK / 2).div_euclid(FS_PER_TICK);
        let at_ticks = u64::try_from(ticks).map_err(|_| wrong(line, "the time runs backwards"))?;
        if self
            .capture
            .edges
            .last()
            .is_some_and(|last| last.at_ticks > at_ticks)
        {
            return Err(wrong(line, "the time runs backwards"));
        }
        if self.capture.edges.len() == EDGES_MAX {
            return Err(wrong(line, format!("more than {EDGES_MAX} edges")));
        }
        self.capture.edges.push(PinEvent {
            at_ticks,
            pin: *pin,
            level,
        });
        self.capture.lines.push(line);
        Ok(())
    }
}

fn pin_of(name: &str) -> Option<Pin> {
    let name = name.trim().trim_matches('"').to_ascii_lowercase();
    let axis = |text: &str| {
        let axis = text.trim_start_matches(['_', ' ']).parse().ok();
        axis.filter(|axis| usize::from(*axis) < AXES_MAX)
            .map(AxisId)
    };
    if let Some(rest) = name.strip_prefix("step") {
        return axis(rest).map(Pin::Step);
    }
    let rest = name
        .strip_prefix("direction")
        .or(name.strip_prefix("dir"))?;
    axis(rest).map(Pin::Direction)
}

/// Reads a decimal number of seconds exactly, as femtoseconds.
fn fs_from_seconds(text: &str) -> Option<i128> {
    let text = text.trim();
    let (text, power) = match text.split_once(['e', 'E']) {
        Some((text, power)) => (text, power.parse::<i32>().ok()?),
        None => (text, 0),
    };
    let (sign, text) = match text.strip_prefix('-') {
        Some(text) => (-1, text),
        None => (1, text),
    };
    let (whole, part) = text.split_once('.').unwrap_or((text, ""));
    let digits: String = [whole, part].concat();
    if digits.is_empty() || digits.len() > 24 || !digits.bytes().all(|byte| byte.is_ascii_digit()) {
        return None;
    }
    let number: i128 = digits.parse().ok()?;
    let shift = 15 + power - i32::try_from(part.len()).ok()?;
    let scaled = if shift >= 0 {
        number.checked_mul(10_i128.checked_pow(shift.unsigned_abs())?)?
    } else {
        number / 10_i128.checked_pow(shift.unsigned_abs())?
    };
    Some(sign * scaled)
}

impl Capture {
    /// Reads a table or a dump, whichever it is.
    ///
    /// # Errors
    /// What is wrong, with its line.
    pub fn read(text: &str) -> Result<Self, CaptureError> {
        if text.trim_start().starts_with('$') {
            Self::from_vcd(text)
        } else {
            Self::from_csv(text)
        }
    }

    fn from_csv(text: &str) -> Result<Self, CaptureError> {
        let mut lines = text
            .lines()
            .enumerate()
            .map(|(index, line)| (index + 1, line.trim()))
            .filter(|(_, line)| !line.is_empty() && !line.starts_with([';', '#']));
        let (at, head) = lines.next().ok_or_else(|| wrong(1, "it is empty"))?;
        let (time, names) = head.split_once(',').unwrap_or((head, ""));
        if !time.to_ascii_lowercase().contains("time") {
            let message = "the first column must be the time in seconds, under a head with \
                           `Time` in it";
            return Err(wrong(at, message));
        }
        let names: Vec<&str> = names.split(',').map(str::trim).collect();
        let mut reader = Reader::new(&names, at)?;
        for (line, text) in lines {
            let mut fields = text.split(',');
            let time = fields.next().unwrap_or_default();
            let at_fs = fs_from_seconds(time)
                .ok_or_else(|| wrong(line, format!("{time:?} is no time in seconds")))?;
            for (signal, name) in names.iter().enumerate() {
                let level = match fields.next().map(str::trim) {
                    Some("0") => false,
                    Some("1") => true,
                    other => {
                        let message = format!("{name}: {other:?} is no level, 0 or 1");
                        return Err(wrong(line, message));
                    }
                };
                reader.take(line, at_fs, signal, level)?;
            }
        }
        Ok(reader.capture)
    }

    fn from_vcd(text: &str) -> Result<Self, CaptureError> {
        let mut unit_fs = None;
        let (mut codes, mut names) = (Vec::new(), Vec::new());
        let mut begun: Option<Reader> = None;
        let mut at_fs = 0;
        // A declaration may be spread over several lines.
        let mut declared: Vec<&str> = Vec::new();
        for (index, text) in text.lines().enumerate() {
            let line = index + 1;
            for word in text.split_whitespace() {
                let Some(reader) = begun.as_mut() else {
                    if word != "$end" {
                        declared.push(word);
                        continue;
                    }
                    match declared[..] {
                        ["$timescale", ref scale @ ..] => {
                            let scale = scale.concat();
                            unit_fs = Some(unit_of(&scale).ok_or_else(|| {
                                wrong(line, format!("{scale:?} is no time scale"))
                            })?);
                        }
                        ["$var", _, "1", code, name, ..] => {
                            codes.push(code);
                            names.push(name);
                        }
                        ["$enddefinitions", ..] => begun = Some(Reader::new(&names, line)?),
                        _ => {}
                    }
                    declared.clear();
                    continue;
                };
                if let Some(time) = word.strip_prefix('#') {
                    let unit = unit_fs.ok_or_else(|| wrong(line, "there is no $timescale"))?;
                    let time: i128 = time
                        .parse()
                        .map_err(|_| wrong(line, format!("{word:?} is no time")))?;
                    at_fs = time * unit;
                } else if let Some(level) =
                    word.chars().next().filter(|level| "01".contains(*level))
                {
                    let code = &word[1..];
                    if let Some(signal) = codes.iter().position(|known| *known == code) {
                        reader.take(line, at_fs, signal, level == '1')?;
                    }
                }
            }
        }
        begun
            .map(|reader| reader.capture)
            .ok_or_else(|| wrong(text.lines().count(), "it has no $enddefinitions"))
    }

    /// Returns the record of a node that played these commands, as far as a capture tells.
    fn into_life(self, commands: &[Command]) -> Life {
        let queue = QueueId { boot: 0, flush: 0 };
        let mut positive = vec![false; self.axis_count];
        let mut counted_steps = vec![0; self.axis_count];
        for edge in &self.edges {
            match edge.pin {
                Pin::Direction(axis) if axis.index() < self.axis_count => {
                    positive[axis.index()] = edge.level;
                }
                Pin::Step(axis) if edge.level => {
                    counted_steps[axis.index()] += if positive[axis.index()] { 1 } else { -1 };
                }
                _ => {}
            }
        }
        let positions = oracle::positions_after(commands, AXES_MAX);
        let at = LocalMicros(self.edges.last().map_or(0, |edge| edge.at_ticks / 16 + 1));
        let taken = commands.iter().zip(0..);
        Life {
            boot: 0,
            axis_count: self.axis_count,
            commands: taken
                .map(|(command, number)| TakenCommand {
                    at: LocalMicros(0),
                    queue,
                    number,
                    command: *command,
                })
                .collect(),
            stops: Vec::new(),
            stopping: None,
            cancels: Vec::new(),
            edges: self.edges,
            inputs: Vec::new(),
            holds: Vec::new(),
            drives: Vec::new(),
            homes: Vec::new(),
            beside: None,
            inverted: Vec::new(),
            external: Vec::new(),
            lidar_waits: false,
            paced: false,
            speeds: Vec::new(),
            cut: false,
            counted_steps,
            status: Status {
                at,
                queue,
                state: NodeState::Idle,
                stop: None,
                job: None,
                accepted_commands: commands.len() as u64,
                executed_commands: commands.len() as u64,
                credit_commands: 0,
                axes: positions[..self.axis_count]
                    .iter()
                    .map(|position| AxisStatus {
                        position_steps: *position,
                        speed_mhz: 0,
                    })
                    .collect(),
                faults: Default::default(),
                features: Features::default(),
                firmware: [0; 3],
                rssi_dbm: None,
                laser_percent: 0,
                lidar_mm: None,
            },
        }
    }

    /// Judges it: the commands, from rest at position 0, and nothing else.
    ///
    /// # Errors
    /// Everything that was found wrong, with the line of the edge.
    pub fn check(self, commands: &[Command]) -> Result<Summary, Vec<String>> {
        let limits = Limits {
            sample_ticks: 1,
            ..Limits::default()
        };
        let times: Vec<u64> = self.edges.iter().map(|edge| edge.at_ticks).collect();
        let lines = self.lines.clone();
        let life = self.into_life(commands);
        oracle::check_life_by(&life, &limits).map_err(|violations| {
            let told = violations.into_iter().map(|violation| {
                let edge = violation
                    .at_ticks
                    .and_then(|at| times.binary_search(&at).ok());
                match edge {
                    Some(edge) => format!("line {}: {violation}", lines[edge]),
                    None => violation.to_string(),
                }
            });
            told.collect()
        })
    }
}

fn unit_of(scale: &str) -> Option<i128> {
    let digits = scale.find(|letter: char| !letter.is_ascii_digit())?;
    let (number, unit) = scale.split_at(digits);
    let unit_fs = match unit {
        "fs" => 1,
        "ps" => 1_000,
        "ns" => 1_000_000,
        "us" => 1_000_000_000,
        "ms" => 1_000_000_000_000,
        "s" => 1_000_000_000_000_000,
        _ => return None,
    };
    Some(number.parse::<i128>().ok()? * unit_fs)
}
