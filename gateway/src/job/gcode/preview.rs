//! What a program will take: time and bounds, before anything moves.
//!
//! The time is an estimate by the same rules as the node's look-ahead, in floating point: lines are
//! joined at the speed that lets no axis jump by more than [`JUNCTION_HZ`], and slowed down backwards
//! from the end. It leaves out the limit of jerk and the windows in which an axis turns, and the
//! approach from where the axes happen to be.

use super::{
    emit::Emitted,
    machine::{AXIS_LETTERS, Machine},
};
use keys::job::{JobCommand, LineFields};
use serde::Serialize;
use std::collections::BTreeMap;

/// How much the speed of an axis may jump at a corner, Hz: a node's default.
const JUNCTION_HZ: f64 = 200.0;

/// See the module.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Preview {
    /// Commands that the node is told.
    pub commands: usize,
    /// Estimated time without the approach, s.
    pub time_s: f64,
    /// Way of the tool without the approach, mm.
    pub way_mm: f64,
    /// Bounds by the axis' letter; an axis that does not move has none.
    pub bounds: BTreeMap<char, Bounds>,
}

/// Between which places an axis moves.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Bounds {
    /// Least and greatest place in the machine's coordinates, mm.
    pub machine_mm: Option<[f64; 2]>,
    /// The same, counted from where the axis is at the beginning, mm.
    pub from_begin_mm: Option<[f64; 2]>,
}

pub(super) fn of(emitted: &Emitted, machine: &Machine) -> Preview {
    let mut bounds = BTreeMap::new();
    for (index, extent) in emitted
        .extents
        .iter()
        .enumerate()
        .take(machine.axis_count())
    {
        let relative = extent.relative.filter(|[least, most]| least < most);
        if extent.machine.is_some() || relative.is_some() {
            let bound = Bounds {
                machine_mm: extent.machine,
                from_begin_mm: relative,
            };
            bounds.insert(AXIS_LETTERS[index], bound);
        }
    }
    Preview {
        commands: emitted.commands.len(),
        time_s: time_s(&emitted.commands),
        way_mm: emitted.way_mm,
        bounds,
    }
}

/// A line in tool's measure: steps along the straight line in step space.
struct Leg {
    slope: Vec<f64>,
    way: f64,
    speed: f64,
    accel: f64,
    entry: f64,
}

impl Leg {
    fn of(line: &LineFields) -> Self {
        let steps: Vec<f64> = line.steps.iter().map(|count| f64::from(*count)).collect();
        let way = steps.iter().map(|count| count * count).sum::<f64>().sqrt();
        let major = steps
            .iter()
            .fold(0.0, |most: f64, count| most.max(count.abs()));
        Self {
            slope: steps.iter().map(|count| count / way).collect(),
            way,
            speed: f64::from(line.speed_hz) * way / major,
            accel: f64::from(line.accel) * way / major,
            entry: 0.0,
        }
    }

    /// Time for the leg that is left with this speed, s, and nothing more is known.
    fn time_s(&self, exit: f64) -> f64 {
        let (entry, accel, way) = (self.entry, self.accel, self.way);
        // The greatest speed that the way allows; the leg may be too short for the one asked for.
        let peak = (accel * way + (entry * entry + exit * exit) / 2.0).sqrt();
        let peak = peak.min(self.speed).max(entry).max(exit);
        let ramps = (2.0 * peak * peak - entry * entry - exit * exit) / (2.0 * accel);
        (2.0 * peak - entry - exit) / accel + (way - ramps).max(0.0) / peak
    }
}

fn time_s(commands: &[JobCommand]) -> f64 {
    let mut total = 0.0;
    let mut legs: Vec<Leg> = Vec::new();
    for command in commands {
        match command {
            JobCommand::Line(line) => {
                let mut leg = Leg::of(line);
                if let Some(before) = legs.last() {
                    leg.entry = corner(before, &leg);
                }
                legs.push(leg);
            }
            JobCommand::Pause(pause) => {
                total += path_s(&mut legs) + f64::from(pause.ms) / 1_000.0;
            }
            _ => total += path_s(&mut legs),
        }
    }
    total + path_s(&mut legs)
}

fn corner(before: &Leg, behind: &Leg) -> f64 {
    let slopes = before.slope.iter().zip(&behind.slope);
    let limits = slopes.map(|(a, b)| JUNCTION_HZ / (a - b).abs());
    limits.fold(before.speed.min(behind.speed), f64::min)
}

/// Takes the time of a path that begins and ends at rest, and empties it.
fn path_s(legs: &mut Vec<Leg>) -> f64 {
    let mut exit = 0.0_f64;
    for leg in legs.iter_mut().rev() {
        let reach = (exit * exit + 2.0 * leg.accel * leg.way).sqrt();
        leg.entry = leg.entry.min(reach);
        exit = leg.entry;
    }
    let mut total = 0.0;
    let mut entry = 0.0_f64;
    for index in 0..legs.len() {
        legs[index].entry = entry;
        let next = legs.get(index + 1).map_or(0.0, |leg| leg.entry);
        let leg = &legs[index];
        let exit = next.min((entry * entry + 2.0 * leg.accel * leg.way).sqrt());
        total += leg.time_s(exit);
        entry = exit;
    }
    legs.clear();
    total
}
