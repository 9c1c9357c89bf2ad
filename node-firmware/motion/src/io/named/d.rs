//! D: two states and the way between them, by its limits or by time.

use super::{
    ConfigD, D_HZ_MAX, D_LATE_SHARE, MOVING, NamedConfigError, Switch, UNKNOWN, check_scale,
    rate_of,
};
use crate::{Direction, Ticks, limits::TICK_HZ};

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

    pub(super) const fn name(&self) -> &'static str {
        match self.place {
            PlaceD::At { on: true } => "ON",
            PlaceD::At { on: false } => "OFF",
            PlaceD::Moving { .. } => MOVING,
            PlaceD::Unknown => UNKNOWN,
        }
    }
}
