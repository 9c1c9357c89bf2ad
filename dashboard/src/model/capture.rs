//! Recorded pins: the step and direction edges of each axis, read from a value change dump or a
//! table of a logic analyser, and what can be measured on them.
//!
//! Pins are told apart by their names: `step0` and `dir0`, also `x_step`, `STEP_1`, `direction 2`.
//! Other signals of a file are counted and left out.
//!
//! Value change dumps are read as IEEE 1364-2005, 18.2, describes them: scalar changes `0!`, `1!`,
//! vectors of one bit `b1 !`; `x` and `z` leave the level as it was.

mod csv;
pub mod rules;
mod vcd;
pub mod verdict;

use verdict::Verdict;

/// Largest file that is read, bytes.
pub const BYTES_MAX: u64 = 256 << 20;

/// Most edges that are kept, 16 bytes each and as much again for rising step edges.
pub const EDGES_MAX: usize = 4_000_000;

/// Most axes.
pub const AXES_MAX: usize = 32;

/// Picoseconds in a second.
pub const PS_PER_S: f64 = 1e12;

/// A change of one pin.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Edge {
    /// When, ps after the file's zero.
    pub at_ps: u64,
    /// The level from then on.
    pub high: bool,
}

/// A rising edge of a step pin: one step.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Step {
    /// When, ps after the file's zero.
    pub at_ps: u64,
    /// The position after it, steps from the file's beginning; a high direction pin counts up.
    pub position_steps: i64,
}

/// The pins of one axis.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Axis {
    /// What its pins' names have besides `step` and `dir`: `0`, `x`.
    pub name: String,
    /// Changes of the step pin, in order.
    pub step_edges: Vec<Edge>,
    /// Changes of the direction pin, in order; empty if there is none.
    pub direction_edges: Vec<Edge>,
    /// Rising edges of the step pin, in order.
    pub steps: Vec<Step>,
}

/// See the module.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Capture {
    /// By name.
    pub axes: Vec<Axis>,
    /// The last time in the file, ps.
    pub end_ps: u64,
    /// Signals that are neither steps nor directions.
    pub other_signals: usize,
    /// What the oracle of the emulator wrote into the file, if it judged.
    pub verdict: Option<Verdict>,
}

/// What is measured at one moment.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Reading {
    /// Position, steps from the file's beginning.
    pub position_steps: i64,
    /// Time between the steps around the moment, s.
    pub interval_s: Option<f64>,
    /// Speed with sign between them, steps/s.
    pub speed_hz: Option<f64>,
    /// Change of that speed to the next interval over the time between their middles, steps/s².
    pub acceleration_hz2: Option<f64>,
}

/// What a pin's name says.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
enum Pin {
    Step,
    Direction,
}

impl Capture {
    /// Reads a file: a table if its name ends in `.csv`, else a value change dump.
    ///
    /// # Errors
    /// Words that name the line.
    pub fn parse(file_name: &str, text: &str) -> Result<Self, String> {
        if text.len() as u64 > BYTES_MAX {
            return Err(format!("larger than {} MiB", BYTES_MAX >> 20));
        }
        if file_name.to_ascii_lowercase().ends_with(".csv") {
            csv::parse(text)
        } else {
            vcd::parse(text)
        }
    }

    /// Returns the axis of this name; makes it if there is none.
    fn axis(&mut self, name: &str) -> Result<usize, String> {
        if let Some(index) = self.axes.iter().position(|axis| axis.name == name) {
            return Ok(index);
        }
        if self.axes.len() == AXES_MAX {
            return Err(format!("more than {AXES_MAX} axes"));
        }
        self.axes.push(Axis {
            name: name.to_owned(),
            ..Axis::default()
        });
        Ok(self.axes.len() - 1)
    }

    /// Sorts the axes and counts the steps.
    fn finish(mut self) -> Result<Self, String> {
        if self.axes.iter().all(|axis| axis.step_edges.is_empty()) {
            return Err(
                "no edge of a step pin: their names must have `step` in them, and \
                        those of direction pins `dir`"
                    .to_owned(),
            );
        }
        let by_number = |axis: &Axis| (axis.name.parse::<u32>().ok(), axis.name.clone());
        self.axes.sort_by_key(by_number);
        for axis in &mut self.axes {
            let mut position_steps = 0;
            let rising = axis.step_edges.iter().filter(|edge| edge.high);
            let steps = rising.map(|edge| {
                position_steps += if level_at(&axis.direction_edges, edge.at_ps) {
                    1
                } else {
                    -1
                };
                let at_ps = edge.at_ps;
                Step {
                    at_ps,
                    position_steps,
                }
            });
            axis.steps = steps.collect();
        }
        Ok(self)
    }

    /// Returns how many edges there are.
    pub fn edge_count(&self) -> usize {
        let axes = self.axes.iter();
        axes.map(|axis| axis.step_edges.len() + axis.direction_edges.len())
            .sum()
    }
}

impl Axis {
    /// Measures at a moment.
    pub fn reading(&self, at_ps: u64) -> Reading {
        let next = self.steps.partition_point(|step| step.at_ps <= at_ps);
        let step = |index: usize| self.steps.get(index).copied();
        let before = next.checked_sub(1).and_then(step);
        let position_steps = before.map_or(0, |step| step.position_steps);
        let (Some(before), Some(after)) = (before, step(next)) else {
            return Reading {
                position_steps,
                ..Reading::default()
            };
        };
        let interval_s = seconds(before.at_ps, after.at_ps);
        let speed_hz = speed_hz(before, after);
        let acceleration_hz2 = step(next + 1).and_then(|then| {
            let between_s = seconds(before.at_ps, then.at_ps) / 2.0;
            let change_hz = self::speed_hz(after, then)? - speed_hz?;
            Some(change_hz / between_s)
        });
        Reading {
            position_steps,
            interval_s: Some(interval_s),
            speed_hz,
            acceleration_hz2,
        }
    }
}

fn speed_hz(from: Step, to: Step) -> Option<f64> {
    let interval_s = seconds(from.at_ps, to.at_ps);
    let steps = (to.position_steps - from.position_steps) as f64;
    (interval_s > 0.0).then(|| steps / interval_s)
}

fn seconds(from_ps: u64, to_ps: u64) -> f64 {
    to_ps.saturating_sub(from_ps) as f64 / PS_PER_S
}

/// Returns the level at a moment, an edge at that moment included; low before the first edge.
pub fn level_at(edges: &[Edge], at_ps: u64) -> bool {
    let next = edges.partition_point(|edge| edge.at_ps <= at_ps);
    next.checked_sub(1).is_some_and(|last| edges[last].high)
}

/// Returns the corners of a signal's line between two moments, ps and level, for a screen with so
/// many columns: at most four for each column.
pub fn corners(edges: &[Edge], from_ps: u64, to_ps: u64, columns: usize) -> Vec<(u64, bool)> {
    let mut corners = vec![(from_ps, level_at(edges, from_ps))];
    let mut next = edges.partition_point(|edge| edge.at_ps <= from_ps);
    let width_ps = (to_ps.saturating_sub(from_ps) / columns.max(1) as u64).max(1);
    while let Some(first) = edges.get(next).filter(|edge| edge.at_ps <= to_ps) {
        let column_end_ps = first.at_ps.saturating_add(width_ps);
        let in_column = edges[next..].partition_point(|edge| edge.at_ps < column_end_ps);
        let last = edges[next + in_column - 1];
        corners.push((first.at_ps, !first.high));
        corners.push((first.at_ps, first.high));
        if in_column > 1 {
            // So dense that it is drawn as a block.
            corners.push((last.at_ps, !last.high));
            corners.push((last.at_ps, last.high));
        }
        next += in_column;
    }
    let level = corners.last().is_some_and(|(_, high)| *high);
    corners.push((to_ps, level));
    corners
}

/// Returns which axis and pin a signal is by its name, `None` if neither.
fn pin(name: &str) -> Option<(String, Pin)> {
    let name = name.trim().to_ascii_lowercase();
    // The longest word first.
    let words = [
        ("step", Pin::Step),
        ("direction", Pin::Direction),
        ("dir", Pin::Direction),
    ];
    let (word, pin) = words.into_iter().find(|(word, _)| name.contains(word))?;
    let rest = name.replacen(word, "", 1);
    let axis: String = rest.chars().filter(|c| c.is_alphanumeric()).collect();
    Some((axis, pin))
}

/// Takes levels and makes edges of them.
struct Builder {
    capture: Capture,
    edges: usize,
}

impl Builder {
    fn new() -> Self {
        Self {
            capture: Capture::default(),
            edges: 0,
        }
    }

    /// Takes a level and returns an error when there are too many edges or time goes back.
    fn level(&mut self, (axis, pin): (usize, Pin), at_ps: u64, high: bool) -> Result<(), String> {
        let axis = &mut self.capture.axes[axis];
        let edges = match pin {
            Pin::Step => &mut axis.step_edges,
            Pin::Direction => &mut axis.direction_edges,
        };
        if edges.last().is_some_and(|last| last.at_ps > at_ps) {
            return Err("time goes back".to_owned());
        }
        if edges.last().map_or(!high, |last| last.high == high) {
            return Ok(());
        }
        self.edges += 1;
        if self.edges > EDGES_MAX {
            return Err(format!("more than {EDGES_MAX} edges"));
        }
        edges.push(Edge { at_ps, high });
        Ok(())
    }
}

#[cfg(test)]
mod tests;
