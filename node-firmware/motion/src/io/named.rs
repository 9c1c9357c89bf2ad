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

use super::input::Switch;
use crate::{Direction, Ticks, limits::TICK_HZ, scale::round_div};
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

/// A run of D at one speed. It ends by [`SwitchD::limit`] or [`SwitchD::poll`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct RunD {
    /// Toward ON, else toward OFF.
    pub way: Direction,
    /// Its speed, Hz, 1 to [`D_HZ_MAX`].
    pub rate_hz: u32,
}

/// D moves already, or both of its limits are pressed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct BusyD;

/// How a run of D has ended. D shall halt.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum EndD {
    /// It is there.
    Arrived,
    /// Its limit was not reached in the time that the way takes.
    NotReached,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum PlaceD {
    Unknown,
    At { on: bool },
    Moving { on: bool, until: Ticks },
}

/// D: whether it is OFF or ON.
#[derive(Clone, Copy, Debug)]
pub struct SwitchD {
    config: ConfigD,
    place: PlaceD,
    min: bool,
    max: bool,
}

impl SwitchD {
    /// Takes D as it is at boot: nobody knows where unless a limit does.
    ///
    /// # Errors
    /// It cannot move like this.
    pub fn new(config: ConfigD) -> Result<Self, NamedConfigError> {
        check_scale(config.steps_per_m)?;
        if config.travel_um == 0 {
            return Err(NamedConfigError::Travel);
        }
        if config.speed_um_per_s == 0 {
            return Err(NamedConfigError::Speed { index: 0 });
        }
        Ok(Self {
            config,
            place: PlaceD::Unknown,
            min: false,
            max: false,
        })
    }

    /// Returns whether D is ON; `None` in motion, and where nobody knows.
    pub const fn is_on(&self) -> Option<bool> {
        match self.place {
            PlaceD::At { on } => Some(on),
            PlaceD::Unknown | PlaceD::Moving { .. } => None,
        }
    }

    /// Returns whether D moves.
    pub const fn is_moving(&self) -> bool {
        matches!(self.place, PlaceD::Moving { .. })
    }

    /// Sends D to ON or OFF from where it rests. `None`: it is there.
    ///
    /// # Errors
    /// It does not go.
    pub fn go(&mut self, on: bool, now: Ticks) -> Result<Option<RunD>, BusyD> {
        if self.is_moving() || (self.min && self.max) {
            return Err(BusyD);
        }
        if self.is_pressed(on) {
            self.place = PlaceD::At { on };
        }
        if self.is_on() == Some(on) {
            return Ok(None);
        }
        let rate_hz = self.rate_hz();
        let steps = u128::from(self.config.travel_um) * u128::from(self.config.steps_per_m);
        let way_ticks = (steps * u128::from(TICK_HZ)).div_ceil(1_000_000 * u128::from(rate_hz));
        let mut ticks = u64::try_from(way_ticks).unwrap_or(u64::MAX);
        if self.has_limit(on) {
            ticks = ticks.saturating_add(ticks / D_LATE_SHARE);
        }
        let until = now.plus(ticks);
        self.place = PlaceD::Moving { on, until };
        let way = if on {
            Direction::Positive
        } else {
            Direction::Negative
        };
        Ok(Some(RunD { way, rate_hz }))
    }

    /// A limit of D became active or inactive. `Some`: D is there now, and shall halt; a limit that
    /// D moves away from is only noted: it bounces.
    pub fn limit(&mut self, switch: Switch, active: bool) -> Option<EndD> {
        let on = match switch {
            Switch::Min => false,
            Switch::Max => true,
            Switch::Home => return None,
        };
        if on {
            self.max = active;
        } else {
            self.min = active;
        }
        let leaves = matches!(self.place, PlaceD::Moving { on: to_on, .. } if to_on != on);
        if !active || leaves || (self.min && self.max) {
            return None;
        }
        self.place = PlaceD::At { on };
        Some(EndD::Arrived)
    }

    /// D was stopped on its way.
    pub fn stop(&mut self) {
        if self.is_moving() {
            self.place = PlaceD::Unknown;
        }
    }

    /// Gives the end of a run whose time is over.
    pub fn poll(&mut self, now: Ticks) -> Option<EndD> {
        let PlaceD::Moving { on, until } = self.place else {
            return None;
        };
        if now < until {
            return None;
        }
        if self.has_limit(on) {
            self.place = PlaceD::Unknown;
            Some(EndD::NotReached)
        } else {
            self.place = PlaceD::At { on };
            Some(EndD::Arrived)
        }
    }

    /// Returns when [`SwitchD::poll`] has something.
    pub const fn poll_timeout(&self) -> Option<Ticks> {
        match self.place {
            PlaceD::Moving { until, .. } => Some(until),
            PlaceD::Unknown | PlaceD::At { .. } => None,
        }
    }

    fn rate_hz(&self) -> u32 {
        let rate_hz = rate_of(self.config.speed_um_per_s, self.config.steps_per_m);
        rate_hz.clamp(1, u64::from(D_HZ_MAX)) as u32
    }

    const fn has_limit(&self, on: bool) -> bool {
        if on {
            self.config.has_max
        } else {
            self.config.has_min
        }
    }

    const fn is_pressed(&self, on: bool) -> bool {
        if on { self.max } else { self.min }
    }

    const fn name(&self) -> &'static str {
        match self.place {
            PlaceD::At { on: true } => "ON",
            PlaceD::At { on: false } => "OFF",
            PlaceD::Moving { .. } => MOVING,
            PlaceD::Unknown => UNKNOWN,
        }
    }
}

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
mod tests {
    extern crate std;

    use super::*;
    use crate::limits::TICKS_PER_US;
    use std::string::{String, ToString};

    const fn ms(ms: u64) -> Ticks {
        Ticks(ms * 1_000 * TICKS_PER_US)
    }

    fn c() -> PositionsC {
        PositionsC::new(ConfigC::default()).expect("legal")
    }

    /// C at rest on a position.
    fn c_at(index: usize) -> PositionsC {
        let mut c = c();
        let steps = c.steps_at(index).expect("a position");
        assert_eq!(c.goto(index as i64, steps), Ok(GoC::default()));
        assert_eq!(c.index(), Some(index));
        c
    }

    fn d() -> SwitchD {
        SwitchD::new(ConfigD::default()).expect("legal")
    }

    fn text(c: &PositionsC, c_position_steps: i64, d: &SwitchD) -> String {
        StatusCd {
            c,
            c_position_steps,
            d,
        }
        .to_string()
    }

    fn run(to_steps: i64, steps: i64, rate_hz: u32) -> GoC {
        GoC {
            at: None,
            run: Some(RunC {
                to_steps,
                steps,
                rate_hz,
            }),
        }
    }

    #[test]
    fn each_position_has_its_place_and_its_speed() {
        // 80 steps/mm: 10 mm/s are 800 Hz.
        let table = [
            ("HOME", 0, 800),
            ("POS1", 2_000, 1_600),
            ("POS2", 4_000, 1_600),
            ("POS3", 6_000, 1_600),
            ("MAX", 8_000, 800),
        ];
        for (index, (name, steps, rate_hz)) in table.into_iter().enumerate() {
            for from in [-7, 3_210, 9_000] {
                let mut c = c();
                assert_eq!(c.steps_at(index), Some(steps));
                let went = c.goto(index as i64, from);
                assert_eq!(went, Ok(run(steps, steps - from, rate_hz)));
                assert_eq!(c.index(), None, "known on arrival only");
                assert!(c.is_moving());
                let moving = text(&c, from, &d());
                assert!(moving.starts_with("C: MOVING ("), "{moving}");
                c.rest(steps);
                assert_eq!((c.index(), c.is_moving()), (Some(index), false));
                let there = text(&c, steps, &d());
                assert!(there.starts_with(&std::format!("C: {name} (")), "{there}");
                let again = c.goto(index as i64, steps);
                assert_eq!(again, Ok(GoC::default()), "it is there");
            }
        }
        assert_eq!(c().steps_at(5), None);
    }

    #[test]
    fn a_position_that_is_none_is_refused_and_nothing_moves() {
        for index in [5, -1, 256, i64::MIN, i64::MAX] {
            let mut c = c_at(2);
            let refused = c.goto(index, 4_000).expect_err("there is none");
            assert_eq!(refused.to_string(), "Invalid C position (0-4)");
            assert_eq!((c.index(), c.is_moving()), (Some(2), false));
        }
    }

    #[test]
    fn one_run_at_a_time() {
        let mut c = c_at(0);
        assert_eq!(c.goto(3, 0), Ok(run(6_000, 6_000, 1_600)));
        assert_eq!(c.goto(1, 100), Err(GotoError::Busy));
        assert_eq!(c.goto(9, 100), Err(GotoError::Position));
        c.rest(6_000);
        assert_eq!(c.index(), Some(3));
        assert!(!GotoError::Busy.to_string().is_empty());
    }

    #[test]
    fn a_stop_between_two_places_leaves_none() {
        let mut c = c_at(1);
        assert_eq!(c.goto(2, 2_000), Ok(run(4_000, 2_000, 1_600)));
        c.rest(3_999);
        assert_eq!((c.index(), c.is_moving()), (None, false));
        assert_eq!(text(&c, 3_999, &d()), "C: UNKNOWN (50.0mm) D: UNKNOWN");
        c.rest(4_000);
        assert_eq!(c.index(), None, "it did not go there");
        assert_eq!(c.goto(2, 3_999), Ok(run(4_000, 1, 1_600)));
        c.rest(4_000);
        assert_eq!(c.index(), Some(2));
    }

    #[test]
    fn from_pos3_to_home_ends_at_0_with_and_without_the_limit() {
        let mut c = c_at(3);
        assert_eq!(c.goto(0, 6_000), Ok(run(0, -6_000, 800)));
        c.rest(0);
        assert_eq!(c.index(), Some(0));
        assert_eq!(text(&c, 0, &d()), "C: HOME (0.0mm) D: UNKNOWN");
        // The limit comes at any count: at -0.3 mm, before 0, or where it should be.
        for _count in [-24, 24, 0, 5_999] {
            let mut c = c_at(3);
            assert_eq!(c.goto(0, 6_000), Ok(run(0, -6_000, 800)));
            let at = c.limit(Switch::Min, true);
            assert_eq!(at, Some(AtLimit { position_steps: 0 }));
            assert_eq!(c.index(), Some(0));
            c.rest(0);
            assert_eq!((c.index(), c.is_moving()), (Some(0), false));
        }
    }

    #[test]
    fn the_high_limit_is_the_last_position() {
        let mut c = c_at(0);
        assert_eq!(c.goto(3, 0), Ok(run(6_000, 6_000, 1_600)));
        let at = c.limit(Switch::Max, true);
        let position_steps = 8_000;
        assert_eq!(at, Some(AtLimit { position_steps }));
        assert_eq!(c.index(), Some(4));
        assert_eq!(text(&c, 8_000, &d()), "C: MAX (100.0mm) D: UNKNOWN");
        // From there it may go down, and the switch that it leaves may bounce.
        assert_eq!(c.goto(3, 8_000), Ok(run(6_000, -2_000, 1_600)));
        for active in [false, true, false, true, false] {
            assert_eq!(c.limit(Switch::Max, active), None);
            assert!(c.is_moving());
        }
        c.rest(6_000);
        assert_eq!(c.index(), Some(3));
        assert_eq!(c.limit(Switch::Home, true), None, "C has none");
    }

    #[test]
    fn a_limit_that_is_pressed_knows_better_than_the_count() {
        // At boot, and by hand.
        let mut boot = c();
        let position_steps = 0;
        let at = Some(AtLimit { position_steps });
        assert_eq!(boot.limit(Switch::Min, true), at);
        assert_eq!(boot.index(), Some(0));

        // Left, and stopped before the switch let go: not against the switch again.
        assert_eq!(boot.goto(1, 0), Ok(run(2_000, 2_000, 1_600)));
        boot.rest(5);
        let there = GoC { at, run: None };
        assert_eq!(boot.goto(0, 5), Ok(there));
        assert_eq!(boot.index(), Some(0));

        // The count is 3 mm wrong: from the limit's place, down.
        let mut high = c_at(2);
        let position_steps = 8_000;
        let at = Some(AtLimit { position_steps });
        assert_eq!(high.limit(Switch::Max, true), at);
        let down = GoC {
            at,
            ..run(6_000, -2_000, 1_600)
        };
        assert_eq!(high.goto(3, 5_760), Ok(down));

        let mut both = c_at(2);
        both.limit(Switch::Min, true);
        assert_eq!(both.limit(Switch::Max, true), None, "which one?");
        assert_eq!(both.goto(1, 4_000), Err(GotoError::Limits));
        assert!(!both.is_moving());
        assert!(!GotoError::Limits.to_string().is_empty());
    }

    #[test]
    fn d_runs_to_its_limit() {
        for (on, switch, way) in [
            (true, Switch::Max, Direction::Positive),
            (false, Switch::Min, Direction::Negative),
        ] {
            let mut d = d();
            assert_eq!(d.is_on(), None, "nobody knows at boot");
            let rate_hz = 2_000;
            assert_eq!(d.go(on, ms(5)), Ok(Some(RunD { way, rate_hz })));
            assert_eq!((d.is_on(), d.is_moving()), (None, true));
            assert_eq!(d.go(on, ms(6)), Err(BusyD));
            assert_eq!(d.limit(switch, true), Some(EndD::Arrived));
            assert_eq!((d.is_on(), d.is_moving()), (Some(on), false));
            assert_eq!(d.poll_timeout(), None);
            assert_eq!(d.poll(ms(999_999)), None);
            assert_eq!(d.go(on, ms(7)), Ok(None), "it is there");
            assert!(text(&c_at(0), 0, &d).ends_with(if on { "D: ON" } else { "D: OFF" }));
        }
    }

    #[test]
    fn a_limit_that_does_not_come_is_told() {
        let mut off = d();
        assert!(off.go(false, ms(0)).is_ok());
        assert_eq!(off.poll(ms(2_250)), Some(EndD::NotReached));
        let mut d = d();
        assert!(d.go(true, ms(100)).is_ok());
        // 50 mm at 25 mm/s and an eighth.
        assert_eq!(d.poll_timeout(), Some(ms(100 + 2_250)));
        assert_eq!(d.poll(ms(2_349)), None);
        assert_eq!(d.poll(ms(2_350)), Some(EndD::NotReached));
        assert_eq!((d.is_on(), d.is_moving()), (None, false));
        assert_eq!(text(&c_at(0), 0, &d), "C: HOME (0.0mm) D: UNKNOWN");
        assert!(d.go(true, ms(5_000)).is_ok_and(|run| run.is_some()));
    }

    #[test]
    fn without_a_limit_the_time_of_the_way_decides() {
        let mut d = SwitchD::new(ConfigD {
            has_max: false,
            ..ConfigD::default()
        })
        .expect("legal");
        assert!(d.go(true, ms(0)).is_ok());
        assert_eq!(d.poll_timeout(), Some(ms(2_000)));
        assert_eq!(d.poll(Ticks(ms(2_000).0 - 1)), None);
        assert_eq!(d.poll(ms(2_000)), Some(EndD::Arrived));
        assert_eq!(d.is_on(), Some(true));
    }

    #[test]
    fn limits_of_d_that_bounce_or_contradict_do_no_harm() {
        let mut d = d();
        assert_eq!(d.limit(Switch::Min, true), Some(EndD::Arrived));
        assert_eq!(d.is_on(), Some(false));
        assert!(d.go(true, ms(0)).is_ok_and(|run| run.is_some()));
        for active in [false, true, false, true, false] {
            assert_eq!(d.limit(Switch::Min, active), None);
            assert!(d.is_moving());
        }
        d.stop();
        assert_eq!((d.is_on(), d.is_moving()), (None, false));
        assert_eq!(d.poll_timeout(), None);
        // Back before the switch had let go: it is there.
        assert_eq!(d.limit(Switch::Min, true), Some(EndD::Arrived));
        d.stop();
        assert_eq!(d.is_on(), Some(false), "it rested");
        assert_eq!(d.go(false, ms(1)), Ok(None));
        assert_eq!(d.limit(Switch::Max, true), None, "which one?");
        assert_eq!(d.go(true, ms(2)), Err(BusyD));
        assert_eq!(d.limit(Switch::Home, true), None, "D has none");
    }

    #[test]
    fn the_rate_of_d_is_clamped_and_its_time_follows() {
        let d = |speed_um_per_s, steps_per_m| {
            let mut d = SwitchD::new(ConfigD {
                speed_um_per_s,
                steps_per_m,
                has_min: false,
                ..ConfigD::default()
            })
            .expect("legal");
            let run = d.go(false, ms(0)).expect("free").expect("not there");
            (run.rate_hz, d.poll_timeout().expect("it moves"))
        };
        assert_eq!(d(25_000, 80_000), (2_000, ms(2_000)));
        // 1 MHz wanted: 500,000 steps of way at 40 kHz are 12.5 s.
        assert_eq!(d(100_000, 10_000_000), (40_000, ms(12_500)));
        // 0.001 Hz wanted: 4,000 steps a metre are 200 steps of way at 1 Hz.
        assert_eq!(d(1, 4_000), (1, ms(200_000)));
        // 214 km of way at 40 kHz: no overflow.
        let mut far = SwitchD::new(ConfigD {
            travel_um: u32::MAX,
            steps_per_m: STEPS_PER_M_MAX,
            ..ConfigD::default()
        })
        .expect("legal");
        assert!(far.go(true, Ticks(u64::MAX)).is_ok());
        assert_eq!(far.poll_timeout(), Some(Ticks(u64::MAX)));
    }

    #[test]
    fn a_rate_of_0_is_rest_and_divides_nothing() {
        assert_eq!(interval_ticks(0), None);
        assert_eq!(interval_ticks(1), Some(TICK_HZ));
        assert_eq!(interval_ticks(D_HZ_MAX), Some(400));
        assert_eq!(interval_ticks(30_000), Some(534), "never faster than told");
        assert!(interval_ticks(u32::MAX).is_some_and(|ticks| ticks > 0));
        // After a stop nothing asks for a rate: no run is under way, and none begins by itself.
        let mut d = d();
        assert!(d.go(true, ms(0)).is_ok());
        d.stop();
        assert_eq!((d.poll(ms(99_999)), d.poll_timeout()), (None, None));
        assert!(!d.is_moving());
    }

    #[test]
    fn the_status_is_one_line_in_tenths_of_a_mm() {
        let d = {
            let mut d = d();
            d.limit(Switch::Max, true);
            d
        };
        let c = c_at(2);
        for (steps, words) in [
            (4_000, "C: POS2 (50.0mm) D: ON"),
            (4_003, "C: POS2 (50.0mm) D: ON"),
            (4_004, "C: POS2 (50.1mm) D: ON"),
            (3, "C: POS2 (0.0mm) D: ON"),
            (-3, "C: POS2 (0.0mm) D: ON"),
            (-4, "C: POS2 (-0.1mm) D: ON"),
            (-24, "C: POS2 (-0.3mm) D: ON"),
            (-8_024, "C: POS2 (-100.3mm) D: ON"),
            (i64::MIN, "C: POS2 (-115292150460684697.6mm) D: ON"),
        ] {
            assert_eq!(text(&c, steps, &d), words, "{steps}");
        }
    }

    #[test]
    fn d_off_then_c_to_2_then_d_on() {
        let (mut c, mut d) = (c_at(0), d());
        d.limit(Switch::Max, true);
        assert!(d.go(false, ms(0)).is_ok_and(|run| run.is_some()));
        d.limit(Switch::Max, false);
        assert_eq!(d.limit(Switch::Min, true), Some(EndD::Arrived));
        assert_eq!(text(&c, 0, &d), "C: HOME (0.0mm) D: OFF");
        assert_eq!(c.goto(2, 0), Ok(run(4_000, 4_000, 1_600)));
        assert_eq!(text(&c, 1_000, &d), "C: MOVING (12.5mm) D: OFF");
        c.rest(4_000);
        assert!(d.go(true, ms(9_000)).is_ok_and(|run| run.is_some()));
        assert_eq!(text(&c, 4_000, &d), "C: POS2 (50.0mm) D: MOVING");
        d.limit(Switch::Min, false);
        assert_eq!(d.limit(Switch::Max, true), Some(EndD::Arrived));
        assert_eq!(text(&c, 4_000, &d), "C: POS2 (50.0mm) D: ON");
    }

    #[test]
    fn steps_round_to_the_nearest_and_rates_down() {
        assert_eq!(steps_of(25_000, 80_000), 2_000);
        assert_eq!(steps_of(1, 499_999), 0);
        assert_eq!(steps_of(1, 500_000), 1);
        assert_eq!(steps_of(-1, 499_999), 0);
        assert_eq!(steps_of(-1, 500_000), -1);
        assert_eq!(steps_of(i32::MIN, u32::MAX), -9_223_372_034_707);
        assert_eq!(rate_of(1_999, 1_000), 1);
        assert_eq!(rate_of(999, 1_000), 0);
    }

    #[test]
    fn what_cannot_be_is_refused() {
        let c = |change: fn(&mut ConfigC)| {
            let mut config = ConfigC::default();
            change(&mut config);
            PositionsC::new(config).err()
        };
        let scale = Some(NamedConfigError::Scale);
        assert_eq!(c(|_| {}), None);
        assert_eq!(c(|config| config.steps_per_m = 0), scale);
        assert_eq!(c(|config| config.steps_per_m = u32::MAX), scale);
        let order = Some(NamedConfigError::Order { index: 3 });
        assert_eq!(c(|config| config.positions[3].position_um = 50_000), order);
        assert_eq!(c(|config| config.positions[3].position_um = 50_006), order);
        assert_eq!(c(|config| config.positions[3].position_um = 50_007), None);
        let slow = Some(NamedConfigError::Speed { index: 0 });
        assert_eq!(c(|config| config.positions[0].speed_um_per_s = 0), slow);
        assert_eq!(c(|config| config.positions[0].speed_um_per_s = 12), slow);
        assert_eq!(c(|config| config.positions[0].speed_um_per_s = 13), None);
        let fast = Some(NamedConfigError::Speed { index: 1 });
        assert_eq!(
            c(|config| config.positions[1].speed_um_per_s = 2_500_013),
            fast
        );
        let d = |change: fn(&mut ConfigD)| {
            let mut config = ConfigD::default();
            change(&mut config);
            SwitchD::new(config).err()
        };
        assert_eq!(d(|_| {}), None);
        assert_eq!(d(|config| config.steps_per_m = 0), scale);
        let travel = Some(NamedConfigError::Travel);
        assert_eq!(d(|config| config.travel_um = 0), travel);
        assert_eq!(d(|config| config.speed_um_per_s = 0), slow);
        for error in [scale, order, slow, travel].into_iter().flatten() {
            assert!(!error.to_string().is_empty());
        }
    }
}
