//! C and D: axes beside the queue that go to named places.
//!
//! ```text
//!   movc 2 ─▶ PositionsC ─Run─▶ pulse hardware with a counter ─▶ arrived, stopped, limit ─▶ PositionsC
//!   movd 1 ─▶ SwitchD ────Run─▶ pulse hardware without one ────▶ limit, time is over ─────▶ SwitchD
//!   statcd ─▶ StatusCd: "C: POS2 (50.0mm) D: ON"
//! ```
//!
//! Owns what is known of their places. A name is known on arrival, not before: in motion it is
//! MOVING, after a stop between two places UNKNOWN. Limits tell the truth: whatever was counted,
//! at the low one C is at 0 and D is OFF, at the high one C is at its last position and D is ON.
//!
//! Absent: ramps, both move at the one speed of their table; and the pulse hardware, which is told a
//! rate and knows none of 0 Hz: what does not move is halted.

mod d;

pub use d::{BusyD, EndD, RunD, SwitchD};

use super::input::Switch;
use crate::{Direction, limits::TICK_HZ, scale::round_div};
use core::fmt;
use keys::command::POSITION_C_MAX;

/// Named positions of C.
pub const POSITIONS_C: usize = POSITION_C_MAX as usize + 1;

pub use crate::scale::STEPS_PER_M_MAX;

/// Fastest step rate of C, Hz.
pub const C_HZ_MAX: u32 = 200_000;

/// Fastest step rate of D, Hz. Rates are clamped to it, and to 1 Hz.
pub const D_HZ_MAX: u32 = 40_000;

/// What a limit of D may come later than its travel takes: an eighth of that.
pub const D_LATE_SHARE: u64 = 8;

/// One place of C.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct NamedPosition {
    /// What it is called.
    pub name: &'static str,
    /// Where it is, µm.
    pub position_um: i32,
    /// Speed on the way there, µm/s, from 1.
    pub speed_um_per_s: u32,
}

impl NamedPosition {
    const fn mm(name: &'static str, position_mm: i32, speed_mm_per_s: u32) -> Self {
        Self {
            name,
            position_um: position_mm * 1_000,
            speed_um_per_s: speed_mm_per_s * 1_000,
        }
    }
}

/// How C moves.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ConfigC {
    /// Its places from the low limit to the high one, each higher than the one before.
    pub positions: [NamedPosition; POSITIONS_C],
    /// Steps of one metre, 1 to [`STEPS_PER_M_MAX`]: a thousand times the steps of one mm.
    pub steps_per_m: u32,
}

impl Default for ConfigC {
    /// Five places on 100 mm, slow at the ends; 80 steps/mm.
    fn default() -> Self {
        Self {
            positions: [
                NamedPosition::mm("HOME", 0, 10),
                NamedPosition::mm("POS1", 25, 20),
                NamedPosition::mm("POS2", 50, 20),
                NamedPosition::mm("POS3", 75, 20),
                NamedPosition::mm("MAX", 100, 10),
            ],
            steps_per_m: 80_000,
        }
    }
}

/// How D moves.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ConfigD {
    /// Way between OFF and ON, µm, from 1.
    pub travel_um: u32,
    /// Speed, µm/s, from 1.
    pub speed_um_per_s: u32,
    /// Steps of one metre, 1 to [`STEPS_PER_M_MAX`].
    pub steps_per_m: u32,
    /// Whether there is a limit at OFF. Without one the way is measured by time.
    pub has_min: bool,
    /// Whether there is a limit at ON.
    pub has_max: bool,
}

impl Default for ConfigD {
    /// 50 mm at 25 mm/s between two limits; 80 steps/mm.
    fn default() -> Self {
        Self {
            travel_um: 50_000,
            speed_um_per_s: 25_000,
            steps_per_m: 80_000,
            has_min: true,
            has_max: true,
        }
    }
}

/// Why C or D cannot move like this.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum NamedConfigError {
    /// `steps_per_m` is 0 or more than [`STEPS_PER_M_MAX`].
    Scale,
    /// A position of C is not at least a step higher than the one before.
    Order {
        /// Its number.
        index: usize,
    },
    /// The speed to this position is less than 1 Hz or more than [`C_HZ_MAX`]; or that of D is 0.
    Speed {
        /// Its number; 0 for D.
        index: usize,
    },
    /// D has no way to go.
    Travel,
}

impl fmt::Display for NamedConfigError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Scale => write!(f, "a metre has 1 to {STEPS_PER_M_MAX} steps"),
            Self::Order { index } => {
                write!(f, "position {index} is not above the one before")
            }
            Self::Speed { index } => {
                write!(f, "the speed to position {index} is 1 Hz to {C_HZ_MAX} Hz")
            }
            Self::Travel => write!(f, "there is no way between OFF and ON"),
        }
    }
}

impl core::error::Error for NamedConfigError {}

/// Why C does not go there. Nothing moves by it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum GotoError {
    /// There is no such position.
    Position,
    /// It moves already.
    Busy,
    /// Both of its limits are pressed.
    Limits,
}

impl fmt::Display for GotoError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Position => write!(f, "Invalid C position (0-{POSITION_C_MAX})"),
            Self::Busy => write!(f, "C moves"),
            Self::Limits => write!(f, "both limits of C are pressed"),
        }
    }
}

impl core::error::Error for GotoError {}

/// A run of C at one speed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct RunC {
    /// Where it ends.
    pub to_steps: i64,
    /// Steps with sign until then, never 0.
    pub steps: i64,
    /// Its speed, Hz, 1 to [`C_HZ_MAX`].
    pub rate_hz: u32,
}

/// How C gets to a position.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct GoC {
    /// Where it is before: a limit knows better than the count.
    pub at: Option<AtLimit>,
    /// The run that leads there. `None`: it is there.
    pub run: Option<RunC>,
}

/// C is at a limit: it shall halt, and this is where it is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct AtLimit {
    /// Its position.
    pub position_steps: i64,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum PlaceC {
    Unknown,
    At(usize),
    Moving { index: usize, way: Direction },
}

/// C: where it is among its positions.
#[derive(Clone, Copy, Debug)]
pub struct PositionsC {
    config: ConfigC,
    place: PlaceC,
    min: bool,
    max: bool,
}

impl PositionsC {
    /// Takes C as it is at boot: counted from 0, at a place that nobody knows unless a limit does.
    ///
    /// # Errors
    /// It cannot move like this.
    pub fn new(config: ConfigC) -> Result<Self, NamedConfigError> {
        check_scale(config.steps_per_m)?;
        let mut before = None;
        for (index, position) in config.positions.iter().enumerate() {
            let rate_hz = rate_of(position.speed_um_per_s, config.steps_per_m);
            if !(1..=u64::from(C_HZ_MAX)).contains(&rate_hz) {
                return Err(NamedConfigError::Speed { index });
            }
            let steps = steps_of(position.position_um, config.steps_per_m);
            if before.is_some_and(|before| steps <= before) {
                return Err(NamedConfigError::Order { index });
            }
            before = Some(steps);
        }
        Ok(Self {
            config,
            place: PlaceC::Unknown,
            min: false,
            max: false,
        })
    }

    /// Returns where a position is, steps; `None` if there is no such position.
    pub fn steps_at(&self, index: usize) -> Option<i64> {
        let position = self.config.positions.get(index)?;
        Some(steps_of(position.position_um, self.config.steps_per_m))
    }

    /// Returns the number of the position where C rests.
    pub const fn index(&self) -> Option<usize> {
        match self.place {
            PlaceC::At(index) => Some(index),
            PlaceC::Unknown | PlaceC::Moving { .. } => None,
        }
    }

    /// Returns whether C moves.
    pub const fn is_moving(&self) -> bool {
        matches!(self.place, PlaceC::Moving { .. })
    }

    /// Sends C to a position from where it rests. Nothing moves against a pressed limit: there, C is
    /// where that limit is.
    ///
    /// # Errors
    /// It does not go.
    pub fn goto(&mut self, index: i64, position_steps: i64) -> Result<GoC, GotoError> {
        let index = usize::try_from(index).map_err(|_| GotoError::Position)?;
        let to_steps = self.steps_at(index).ok_or(GotoError::Position)?;
        if self.is_moving() {
            return Err(GotoError::Busy);
        }
        if self.min && self.max {
            return Err(GotoError::Limits);
        }
        let mut go = GoC::default();
        let mut here_steps = position_steps;
        if (self.min && to_steps < here_steps) || (self.max && to_steps > here_steps) {
            let limit = self.limit_index(self.min);
            here_steps = self.limit_steps(self.min);
            go.at = Some(AtLimit {
                position_steps: here_steps,
            });
            self.place = PlaceC::At(limit);
        }
        let steps = to_steps.saturating_sub(here_steps);
        if steps == 0 {
            self.place = PlaceC::At(index);
            return Ok(go);
        }
        let way = Direction::of(steps);
        self.place = PlaceC::Moving { index, way };
        let speed_um_per_s = self.config.positions[index].speed_um_per_s;
        go.run = Some(RunC {
            to_steps,
            steps,
            rate_hz: rate_of(speed_um_per_s, self.config.steps_per_m) as u32,
        });
        Ok(go)
    }

    /// A limit of C became active or inactive. If C is there now, it shall halt and has that
    /// position; a limit that C moves away from is only noted: it bounces.
    pub fn limit(&mut self, switch: Switch, active: bool) -> Option<AtLimit> {
        let is_min = match switch {
            Switch::Min => true,
            Switch::Max => false,
            Switch::Home => return None,
        };
        if is_min {
            self.min = active;
        } else {
            self.max = active;
        }
        let toward = if is_min {
            Direction::Negative
        } else {
            Direction::Positive
        };
        let leaves = matches!(self.place, PlaceC::Moving { way, .. } if way != toward);
        if !active || leaves || (self.min && self.max) {
            return None;
        }
        self.place = PlaceC::At(self.limit_index(is_min));
        Some(AtLimit {
            position_steps: self.limit_steps(is_min),
        })
    }

    /// C rests, at the end of its run or because it was stopped.
    pub fn rest(&mut self, position_steps: i64) {
        if let PlaceC::Moving { index, .. } = self.place {
            self.place = if self.steps_at(index) == Some(position_steps) {
                PlaceC::At(index)
            } else {
                PlaceC::Unknown
            };
        }
    }

    /// Returns where C is in mm and steps of a tenth, for a count.
    fn tenths_mm(&self, position_steps: i64) -> i128 {
        let scale = i128::from(self.config.steps_per_m);
        let tenths_of_a_step = i128::from(position_steps) * 10_000;
        round_div(tenths_of_a_step, scale)
    }

    fn name(&self) -> &'static str {
        match self.place {
            PlaceC::At(index) => self.config.positions[index].name,
            PlaceC::Moving { .. } => MOVING,
            PlaceC::Unknown => UNKNOWN,
        }
    }

    const fn limit_index(&self, is_min: bool) -> usize {
        if is_min { 0 } else { POSITIONS_C - 1 }
    }

    fn limit_steps(&self, is_min: bool) -> i64 {
        let position = &self.config.positions[self.limit_index(is_min)];
        steps_of(position.position_um, self.config.steps_per_m)
    }
}

const MOVING: &str = "MOVING";
const UNKNOWN: &str = "UNKNOWN";

/// Where C and D are, as a line of text: `C: POS2 (50.0mm) D: ON`.
#[derive(Clone, Copy, Debug)]
pub struct StatusCd<'a> {
    /// C.
    pub c: &'a PositionsC,
    /// Its count now, steps.
    pub c_position_steps: i64,
    /// D.
    pub d: &'a SwitchD,
}

impl fmt::Display for StatusCd<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let tenths = self.c.tenths_mm(self.c_position_steps);
        let sign = if tenths < 0 { "-" } else { "" };
        let (whole, tenth) = (tenths.unsigned_abs() / 10, tenths.unsigned_abs() % 10);
        let (c, d) = (self.c.name(), self.d.name());
        write!(f, "C: {c} ({sign}{whole}.{tenth}mm) D: {d}")
    }
}

/// Returns the interval of a step rate, ticks; `None` for 0 Hz, at which nothing steps.
pub const fn interval_ticks(rate_hz: u32) -> Option<u64> {
    match rate_hz {
        0 => None,
        _ => Some(TICK_HZ.div_ceil(rate_hz as u64)),
    }
}

const fn check_scale(steps_per_m: u32) -> Result<(), NamedConfigError> {
    match steps_per_m {
        1..=STEPS_PER_M_MAX => Ok(()),
        _ => Err(NamedConfigError::Scale),
    }
}

fn steps_of(position_um: i32, steps_per_m: u32) -> i64 {
    let steps = i128::from(position_um) * i128::from(steps_per_m);
    // 2³¹ · 2³² / 10⁶ is less than 2⁶³.
    round_div(steps, 1_000_000) as i64
}

/// Returns a speed in steps, Hz, rounded down: no axis is faster than it was told.
fn rate_of(speed_um_per_s: u32, steps_per_m: u32) -> u64 {
    u64::from(speed_um_per_s) * u64::from(steps_per_m) / 1_000_000
}

#[cfg(test)]
mod tests;
