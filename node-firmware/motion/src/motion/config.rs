//! What a node's axes, inputs and outputs are; checked before anything is built on it.

use super::{ConfigCd, SoftLimits};
use crate::{
    AxisProfile,
    io::{
        enable::{ENABLED_AXES, EnableConfig, EnableError, Enables, OUTPUTS_MAX},
        home::{HomeConfig, HomeConfigError},
        input::{InputMap, MapError, Role, Switch},
        named::{NamedConfigError, PositionsC, SwitchD},
        shift::SHIFT_PINS_MAX,
    },
    limits::{CHANNELS, TICK_HZ},
    profile::Timing,
    scale::Scale,
};
use core::fmt;
use keys::{AxisId, StopMode};

/// The axes of a node and what surrounds them.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct MotionConfig {
    /// How many there are, 1 to [`CHANNELS`].
    pub axis_count: usize,
    /// What their drivers demand; those beyond `axis_count` do not matter.
    pub axes: [AxisProfile; CHANNELS],
    /// Steps of a length of each axis.
    pub scales: [Scale; CHANNELS],
    /// The input pins.
    pub inputs: InputMap,
    /// Their levels at boot, a bit for each.
    pub input_levels: u32,
    /// How the axes are homed that can be.
    pub homes: [Option<HomeConfig>; CHANNELS],
    /// How far the axes may go that have limits.
    pub soft_limits: [Option<SoftLimits>; CHANNELS],
    /// The enable outputs, by index. One that is not automatic is on from boot on.
    pub enables: heapless::Vec<EnableConfig, OUTPUTS_MAX>,
    /// The shift register of external enable outputs and direction pins.
    pub shift: Option<ShiftConfig>,
    /// How long `lidar_read` waits for its reading at rest, ms; `None`: it asks in passing.
    pub lidar_wait_ms: Option<u32>,
    /// C and D, of a node that has them.
    pub cd: Option<ConfigCd>,
    /// How an axis stops that comes to a limit switch.
    pub limit_stop: StopMode,
    /// How everything stops when the probe touches; `None`: it is only noted where.
    pub probe_stop: Option<StopMode>,
}

impl Default for MotionConfig {
    /// Two axes with the default profile, and nothing beside them.
    fn default() -> Self {
        Self {
            axis_count: 2,
            axes: [AxisProfile::default(); CHANNELS],
            scales: [Scale::default(); CHANNELS],
            inputs: InputMap::EMPTY,
            input_levels: 0,
            homes: [None; CHANNELS],
            soft_limits: [None; CHANNELS],
            enables: heapless::Vec::new(),
            shift: None,
            lidar_wait_ms: None,
            cd: None,
            limit_stop: StopMode::Halt,
            probe_stop: None,
        }
    }
}

/// A shift register whose pins enable drivers and turn axes.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct ShiftConfig {
    /// How many pins it has, at most [`SHIFT_PINS_MAX`].
    pub pin_count: u8,
    /// The pin of each enable output that is behind it, high for on.
    pub enable_pins: [Option<u8>; OUTPUTS_MAX],
    /// The pin that turns an axis: those of the queue by number, then C, then D. High for positive,
    /// unless the axis' profile says otherwise. Such an axis turns only at rest, and steps only when
    /// what was read back confirms its direction.
    pub direction_pins: [Option<u8>; ENABLED_AXES],
}

impl ShiftConfig {
    /// Returns the pin of an enable output.
    pub fn pin_of(&self, output: usize) -> Option<u8> {
        let pin = self.enable_pins.get(output).copied().flatten();
        pin.filter(|pin| usize::from(*pin) < self.count())
    }

    /// Returns the pin that turns an axis, if it is behind the register.
    pub fn direction_pin_of(&self, axis: usize) -> Option<u8> {
        let pin = self.direction_pins.get(axis).copied().flatten();
        pin.filter(|pin| usize::from(*pin) < self.count())
    }

    fn count(&self) -> usize {
        usize::from(self.pin_count).min(SHIFT_PINS_MAX)
    }

    /// Returns a pin that two things share, or that is none.
    fn wrong_pin(&self) -> Option<u8> {
        let pins = self
            .enable_pins
            .iter()
            .chain(&self.direction_pins)
            .flatten();
        let wrong = |pin: &&u8| {
            let same = pins.clone().filter(|other| other == pin).count();
            same > 1 || usize::from(**pin) >= self.count()
        };
        pins.clone().find(wrong).copied()
    }
}

/// Why a node cannot be like this.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ConfigError {
    /// Not 1 to [`CHANNELS`] axes.
    AxisCount(usize),
    /// An input.
    Input(MapError),
    /// The way an axis is homed.
    Home {
        /// The axis.
        axis: AxisId,
        /// What is wrong.
        error: HomeConfigError,
    },
    /// An axis is homed by a switch that is no input.
    NoSwitch {
        /// The axis.
        axis: AxisId,
        /// Its switch.
        switch: Switch,
    },
    /// The enable outputs.
    Enables(EnableError),
    /// An external enable output has no pin of the shift register.
    NoShiftPin {
        /// Its index.
        output: usize,
    },
    /// A pin of the shift register is not there, or has two tasks.
    ShiftPin {
        /// Its number.
        pin: u8,
    },
    /// C cannot move like this.
    C(NamedConfigError),
    /// D cannot move like this.
    D(NamedConfigError),
    /// D counts on a limit that is no input, or has one that it does not count on.
    LimitOfD(Switch),
    /// An axis has soft limits between which there is nothing.
    SoftLimits {
        /// The axis.
        axis: AxisId,
    },
    /// An axis has soft limits that count once it is homed, and cannot be homed.
    NeverHomed {
        /// The axis.
        axis: AxisId,
    },
    /// An axis is homed faster than its driver can step.
    HomeTooFast {
        /// The axis.
        axis: AxisId,
        /// Most that its driver can, Hz.
        hz_max: u32,
    },
}

impl fmt::Display for ConfigError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::AxisCount(count) => write!(f, "a node has 1 to {CHANNELS} axes, not {count}"),
            Self::Input(error) => error.fmt(f),
            Self::Home { axis, error } => write!(f, "axis {}: {error}", axis.0),
            Self::NoSwitch { axis, switch } => {
                write!(
                    f,
                    "axis {}: homing needs its {switch}, which is no input",
                    axis.0
                )
            }
            Self::Enables(error) => error.fmt(f),
            Self::NoShiftPin { output } => {
                write!(
                    f,
                    "enable output {output}: it has no pin of the shift register"
                )
            }
            Self::ShiftPin { pin } => {
                write!(
                    f,
                    "pin {pin} of the shift register is not there or has two tasks"
                )
            }
            Self::C(error) => write!(f, "C: {error}"),
            Self::D(error) => write!(f, "D: {error}"),
            Self::LimitOfD(switch) => {
                write!(
                    f,
                    "D: its configuration and the inputs disagree about its {switch}"
                )
            }
            Self::SoftLimits { axis } => {
                let axis = axis.0;
                write!(f, "axis {axis}: there is nothing between its soft limits")
            }
            Self::NeverHomed { axis } => {
                let axis = axis.0;
                write!(
                    f,
                    "axis {axis}: its soft limits need a home, or count from boot on"
                )
            }
            Self::HomeTooFast { axis, hz_max } => {
                write!(
                    f,
                    "axis {}: homing is faster than {hz_max} Hz, which its driver can",
                    axis.0
                )
            }
        }
    }
}

impl core::error::Error for ConfigError {}

impl MotionConfig {
    /// Checks what the types do not.
    ///
    /// # Errors
    /// The first thing that is wrong, with its place.
    pub fn check(&self) -> Result<(), ConfigError> {
        if !(1..=CHANNELS).contains(&self.axis_count) {
            return Err(ConfigError::AxisCount(self.axis_count));
        }
        self.inputs
            .check(self.axis_count)
            .map_err(ConfigError::Input)?;
        for (axis, home) in self.homes() {
            home.check()
                .map_err(|error| ConfigError::Home { axis, error })?;
            let switch = home.switch;
            if !self.inputs.has(Role::Axis { axis, switch }) {
                return Err(ConfigError::NoSwitch { axis, switch });
            }
            let least = Timing::from(self.axes[usize::from(axis.0)]).interval_ticks_min();
            let hz_max = TICK_HZ / least;
            if u64::from(home.seek_hz) > hz_max {
                return Err(ConfigError::HomeTooFast {
                    axis,
                    hz_max: hz_max as u32,
                });
            }
        }
        for (index, limits) in self.soft_limits[..self.axis_count].iter().enumerate() {
            let Some(limits) = limits else { continue };
            let axis = AxisId(index as u8);
            if limits.min_steps >= limits.max_steps {
                return Err(ConfigError::SoftLimits { axis });
            }
            if !limits.from_boot && self.homes[index].is_none() {
                return Err(ConfigError::NeverHomed { axis });
            }
        }
        Enables::new(&self.enables).map_err(ConfigError::Enables)?;
        for (output, config) in self.enables.iter().enumerate() {
            let pin = self.shift.and_then(|shift| shift.pin_of(output));
            if config.external && pin.is_none() {
                return Err(ConfigError::NoShiftPin { output });
            }
        }
        if let Some(pin) = self.shift.and_then(|shift| shift.wrong_pin()) {
            return Err(ConfigError::ShiftPin { pin });
        }
        self.check_cd()
    }

    fn check_cd(&self) -> Result<(), ConfigError> {
        let Some(cd) = self.cd else { return Ok(()) };
        PositionsC::new(cd.c).map_err(ConfigError::C)?;
        SwitchD::new(cd.d).map_err(ConfigError::D)?;
        for (switch, has) in [(Switch::Min, cd.d.has_min), (Switch::Max, cd.d.has_max)] {
            if self.inputs.has(Role::D(switch)) != has {
                return Err(ConfigError::LimitOfD(switch));
            }
        }
        Ok(())
    }

    /// The axes that can be homed.
    pub fn homes(&self) -> impl Iterator<Item = (AxisId, HomeConfig)> + '_ {
        let axes = (0..).map(AxisId).zip(&self.homes).take(self.axis_count);
        axes.filter_map(|(axis, home)| Some((axis, (*home)?)))
    }
}

#[cfg(test)]
mod tests {
    extern crate std;

    use super::*;
    use crate::io::input::{Filter, InputConfig};
    use std::string::ToString;

    const Y: AxisId = AxisId(1);

    fn config() -> MotionConfig {
        let min = InputConfig {
            role: Role::Axis {
                axis: Y,
                switch: Switch::Min,
            },
            active_low: false,
            filter: Filter::default(),
        };
        MotionConfig {
            inputs: InputMap::new(&[min], 2).expect("two axes"),
            homes: [None, Some(HomeConfig::min_switch(1_000)), None, None],
            ..MotionConfig::default()
        }
    }

    #[test]
    fn what_cannot_be_is_named_with_its_place() {
        assert_eq!(config().check(), Ok(()));
        assert_eq!(MotionConfig::default().check(), Ok(()));
        let wrong = |change: fn(&mut MotionConfig)| {
            let mut config = config();
            change(&mut config);
            config.check().expect_err("wrong").to_string()
        };
        assert_eq!(
            wrong(|config| config.axis_count = 5),
            "a node has 1 to 4 axes, not 5"
        );
        assert_eq!(
            wrong(|config| config.axis_count = 1),
            "input 0: there is no axis 1"
        );
        assert_eq!(
            wrong(|config| config.inputs = InputMap::EMPTY),
            "axis 1: homing needs its min limit, which is no input"
        );
        let limits = |min_steps, max_steps| SoftLimits {
            min_steps,
            max_steps,
            from_boot: false,
        };
        let mut narrow = config();
        narrow.soft_limits[1] = Some(limits(5, 5));
        let error = narrow.check().expect_err("wrong").to_string();
        assert_eq!(error, "axis 1: there is nothing between its soft limits");
        narrow.soft_limits = [Some(limits(0, 5)), None, None, None];
        let error = narrow.check().expect_err("wrong").to_string();
        assert_eq!(
            error,
            "axis 0: its soft limits need a home, or count from boot on"
        );
        let home = |change: fn(&mut HomeConfig)| {
            let mut config = config();
            config.homes[1].iter_mut().for_each(change);
            config.check().expect_err("wrong").to_string()
        };
        assert_eq!(
            home(|home| home.seek_hz = 2_000_000),
            "axis 1: homing is faster than 1000000 Hz, which its driver can"
        );
        assert_eq!(
            home(|home| home.accel_hz_per_s = 0),
            "axis 1: homing needs an acceleration"
        );
    }
}
