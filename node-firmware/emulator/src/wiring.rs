//! Switches as an option in words: `2:min@-300` is the low limit of axis 2, 300 steps below where
//! the machine is switched on.

use crate::config::EmulatorConfig;
use keys::AxisId;
use motion::{
    Direction,
    io::{
        home::HomeConfig,
        input::{MapError, Switch},
    },
    limits::CHANNELS,
};
use std::{fmt, str::FromStr};

/// A switch of an emulated machine.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Wiring {
    /// The axis.
    pub axis: AxisId,
    /// Which of its switches.
    pub switch: Switch,
    /// Where it is, steps of the machine.
    pub at_steps: i64,
}

/// The words name no switch.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct WiringError(String);

impl fmt::Display for WiringError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let words = &self.0;
        write!(
            f,
            "{words:?} is no AXIS:SWITCH@STEPS like 2:min@-300, with an axis below {CHANNELS} and \
             min, max or home"
        )
    }
}

impl std::error::Error for WiringError {}

impl FromStr for Wiring {
    type Err = WiringError;

    fn from_str(words: &str) -> Result<Self, WiringError> {
        let parse = || {
            let (axis, place) = words.split_once(':')?;
            let (switch, at_steps) = place.split_once('@')?;
            let axis: u8 = axis.parse().ok()?;
            let switch = match switch {
                "min" => Switch::Min,
                "max" => Switch::Max,
                "home" => Switch::Home,
                _ => return None,
            };
            (usize::from(axis) < CHANNELS).then_some(Self {
                axis: AxisId(axis),
                switch,
                at_steps: at_steps.parse().ok()?,
            })
        };
        parse().ok_or_else(|| WiringError(words.to_owned()))
    }
}

/// Longest way of a seek: 40 s at its 5 kHz.
const TRAVEL_STEPS_MAX: u64 = 200_000;

impl Wiring {
    /// Puts the switch into the machine.
    ///
    /// # Errors
    /// There is no room for another input.
    pub fn wire(&self, config: &mut EmulatorConfig) -> Result<(), MapError> {
        config.add_switch(self.axis, self.switch, self.at_steps)
    }

    /// Puts the switch into the machine; `home` looks for it from then on, and its place becomes 0.
    ///
    /// # Errors
    /// There is no room for another input.
    pub fn wire_home(&self, config: &mut EmulatorConfig) -> Result<(), MapError> {
        self.wire(config)?;
        let home = HomeConfig {
            switch: self.switch,
            direction: match self.switch {
                Switch::Max => Direction::Positive,
                Switch::Min | Switch::Home => Direction::Negative,
            },
            ..HomeConfig::min_switch(TRAVEL_STEPS_MAX)
        };
        config.set_home(self.axis, home);
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use keys::NodeId;

    #[test]
    fn words_name_an_axis_a_switch_and_a_place() {
        let wiring: Wiring = "2:min@-300".parse().expect("legal");
        let expected = Wiring {
            axis: AxisId(2),
            switch: Switch::Min,
            at_steps: -300,
        };
        assert_eq!(wiring, expected);
        for words in ["", "2", "2:min", "min@3", "4:min@3", "2:low@3", "2:min@x"] {
            let error = words.parse::<Wiring>().expect_err(words);
            assert!(error.to_string().contains(&format!("{words:?}")));
        }
    }

    #[test]
    fn what_is_wired_passes_the_check_if_the_axis_is_there() {
        for (words, good) in [("1:max@900", true), ("0:home@5", true), ("3:min@0", false)] {
            let mut config = EmulatorConfig::new(NodeId::new("n").expect("legal"));
            let wiring: Wiring = words.parse().expect("legal");
            wiring.wire_home(&mut config).expect("room");
            assert_eq!(config.check().is_ok(), good, "{words}");
        }
    }
}
