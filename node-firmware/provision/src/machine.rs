//! What is connected to a node beside its drivers: switches, C and D, a lidar.
//!
//! Only what was told is there: an input without a switch floats, and a board that believed in it
//! would not move. Which pin a switch is on is the board's own table.
//!
//! Every default is a row of zero bytes, and fields are only appended.

use heapless::Vec;
use keys::{AXES_MAX, AxisId};
use motion::{
    ConfigCd, Direction, MotionConfig,
    io::{
        home::HomeConfig,
        input::{Filter, InputConfig, InputMap, Role, Switch},
    },
};
use serde::{Deserialize, Serialize};

/// Most switches of a node: three for each axis, two for C and D each, and the probe.
pub const SWITCHES_MAX: usize = 3 * AXES_MAX + 5;

/// Longest way on which an axis looks for its home, steps: 40 s at the 5 kHz of its seek.
pub const HOME_STEPS_MAX: u64 = 200_000;

/// Longest that C or D waits for a reading of the lidar, ms.
const LIDAR_WAIT_MS: u32 = 1_000;

/// What a switch belongs to.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum SwitchOf {
    /// An axis of the queue.
    Axis(u8),
    /// The axis C.
    C,
    /// The axis D.
    D,
    /// The probe, whose end does not matter.
    Probe,
}

/// Where it is.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum End {
    /// At the low end.
    Min,
    /// At the high end.
    Max,
    /// A reference switch in between.
    Home,
}

/// A switch to ground.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct SwitchSettings {
    /// Whose.
    pub of: SwitchOf,
    /// Which.
    pub end: End,
    /// Open when it is pressed, so that a cut wire counts as pressed.
    pub normally_closed: bool,
    /// Its axis is homed by it, and its place becomes 0.
    pub homes: bool,
}

impl SwitchSettings {
    /// Returns what it is to motion.
    pub const fn role(&self) -> Role {
        let switch = match self.end {
            End::Min => Switch::Min,
            End::Max => Switch::Max,
            End::Home => Switch::Home,
        };
        match self.of {
            SwitchOf::Axis(axis) => Role::Axis {
                axis: AxisId(axis),
                switch,
            },
            SwitchOf::C => Role::C(switch),
            SwitchOf::D => Role::D(switch),
            SwitchOf::Probe => Role::Probe,
        }
    }

    /// Returns whether there can be such a switch.
    pub fn is_legal(&self) -> bool {
        let axis = match self.of {
            SwitchOf::Axis(axis) => usize::from(axis) < AXES_MAX,
            SwitchOf::C | SwitchOf::D => self.end != End::Home && !self.homes,
            SwitchOf::Probe => !self.homes,
        };
        axis && (self.end != End::Home || self.of != SwitchOf::Probe)
    }
}

/// See the module.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Machine {
    /// Its switches, in the order of the inputs.
    pub switches: Vec<SwitchSettings, SWITCHES_MAX>,
    /// C and D are there, with the shift register that turns and enables them.
    pub has_cd: bool,
    /// The lidar is there.
    pub has_lidar: bool,
}

impl Machine {
    /// Adds a switch, or changes the one that is known. Returns whether there was room.
    pub fn add(&mut self, settings: SwitchSettings) -> bool {
        let role = settings.role();
        let known = self.switches.iter_mut().find(|of| of.role() == role);
        match known {
            Some(known) => *known = settings,
            None => return self.switches.push(settings).is_ok(),
        }
        true
    }

    /// Tells motion of it. The inputs are the switches in their order. Call [`MotionConfig::check`]
    /// behind it: it names what does not fit.
    pub fn tell(&self, config: &mut MotionConfig) {
        let inputs: Vec<InputConfig, SWITCHES_MAX> = self
            .switches
            .iter()
            .map(|switch| InputConfig {
                role: switch.role(),
                active_low: !switch.normally_closed,
                filter: Filter::default(),
            })
            .collect();
        // As many axes as there can be: `check` knows how many there are.
        config.inputs = InputMap::new(&inputs, AXES_MAX).unwrap_or(InputMap::EMPTY);
        for switch in self.switches.iter().filter(|switch| switch.homes) {
            if let Role::Axis { axis, switch } = switch.role()
                && let Some(home) = config.homes.get_mut(axis.index())
            {
                *home = Some(HomeConfig {
                    switch,
                    direction: match switch {
                        Switch::Max => Direction::Positive,
                        Switch::Min | Switch::Home => Direction::Negative,
                    },
                    ..HomeConfig::min_switch(HOME_STEPS_MAX)
                });
            }
        }
        if self.has_cd {
            let mut cd = ConfigCd::default();
            cd.d.has_min = config.inputs.has(Role::D(Switch::Min));
            cd.d.has_max = config.inputs.has(Role::D(Switch::Max));
            config.cd = Some(cd);
        }
        if self.has_lidar {
            config.lidar_wait_ms = Some(LIDAR_WAIT_MS);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn switch(of: SwitchOf, end: End, homes: bool) -> SwitchSettings {
        SwitchSettings {
            of,
            end,
            normally_closed: true,
            homes,
        }
    }

    #[test]
    fn a_machine_of_which_nothing_was_told_has_nothing() {
        let mut config = MotionConfig::default();
        Machine::default().tell(&mut config);
        assert_eq!(config, MotionConfig::default());
        let mut bytes = [0xff; 8];
        let bytes = postcard::to_slice(&Machine::default(), &mut bytes).expect("short");
        assert!(bytes.iter().all(|byte| *byte == 0));
    }

    #[test]
    fn what_was_told_is_what_motion_gets() {
        let mut machine = Machine {
            has_cd: true,
            has_lidar: true,
            ..Machine::default()
        };
        for settings in [
            switch(SwitchOf::Axis(0), End::Min, false),
            switch(SwitchOf::Axis(1), End::Max, true),
            switch(SwitchOf::D, End::Max, false),
            switch(SwitchOf::Probe, End::Min, false),
            switch(SwitchOf::Axis(0), End::Min, true),
        ] {
            assert!(settings.is_legal() && machine.add(settings));
        }
        assert_eq!(machine.switches.len(), 4, "the last one replaced the first");
        let mut config = MotionConfig::default();
        machine.tell(&mut config);
        assert_eq!(config.check(), Ok(()));
        let home = config.homes[1].expect("it is homed");
        assert_eq!(home.switch, Switch::Max);
        assert_eq!(home.direction, Direction::Positive);
        assert_eq!(config.homes[0].expect("homed").switch, Switch::Min);
        let input = config.inputs.get(2).expect("an input");
        assert_eq!(input.role, Role::D(Switch::Max));
        assert!(!input.active_low, "a cut wire is a pressed switch");
        let d = config.cd.expect("it is there").d;
        assert!(d.has_max && !d.has_min);
        assert!(config.lidar_wait_ms.is_some());
    }

    #[test]
    fn a_switch_that_cannot_be_is_none() {
        for (of, end, homes) in [
            (SwitchOf::Axis(AXES_MAX as u8), End::Min, false),
            (SwitchOf::C, End::Home, false),
            (SwitchOf::D, End::Min, true),
            (SwitchOf::Probe, End::Min, true),
            (SwitchOf::Probe, End::Home, false),
        ] {
            assert!(!switch(of, end, homes).is_legal(), "{of:?} {end:?}");
        }
        let mut config = MotionConfig::default();
        let mut machine = Machine::default();
        assert!(machine.add(switch(SwitchOf::Axis(3), End::Min, false)));
        machine.tell(&mut config);
        assert!(config.check().is_err(), "two axes have no third");
    }
}
