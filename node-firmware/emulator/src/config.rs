//! Every setting of an emulated node, with unit and default.

use crate::{
    bed,
    flash::Flash,
    machine::{MachineConfig, MachineSwitch},
    pins::{CARRIAGE_C, CARRIAGE_D},
    pulse::RmtConfig,
    record::{BesideFacts, HomeFacts, LimitFacts},
    scout::ScoutConfig,
};
use keys::{AxisId, Keys, NodeId};
use motion::{
    ConfigCd, ConfigError, Direction, MotionConfig,
    io::{
        home::HomeConfig,
        input::{Filter, INPUTS_MAX, InputConfig, InputMap, MapError, Role, Switch},
    },
    limits::CHANNELS,
};
use node::{
    LinkLoss,
    limits::{LINK_LOSS_AFTER_US_DEFAULT, RING_COMMANDS_DEFAULT},
};
pub use pico::session::Credentials;
use provision::Found;
use std::{ops::RangeInclusive, path::PathBuf};

/// What is kept for the oracle.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Recording {
    /// Nothing.
    #[default]
    Off,
    /// Commands, stops and changes of pins of each boot, from its beginning.
    Edges {
        /// Most commands (64 bytes each) and most changes (24 bytes each).
        max: usize,
    },
}

/// Changes of pins that `--check` keeps for each node and boot: four million are 96 MB.
pub const RECORDED_EDGES_MAX: usize = 4_000_000;

/// See the module.
#[derive(Clone, Debug)]
pub struct EmulatorConfig {
    /// Name of the node.
    pub name: NodeId,
    /// Keys of its fleet; prefix `fleet` by default.
    pub keys: Keys,
    /// Axes, 1 to [`motion::limits::CHANNELS`]; 2 by default.
    pub axis_count: usize,
    /// Commands that the ring holds; 4096 by default.
    pub ring_commands: usize,
    /// What the axes can do. Its `axis_count` is replaced by the one above.
    pub motion: MotionConfig,
    /// What the node does when the link stays away while it moves; decelerate by default.
    pub link_loss: LinkLoss,
    /// How long the link must be gone for that, µs; two seconds by default.
    pub link_loss_after_us: u64,
    /// The machine around it; no switches by default.
    pub machine: MachineConfig,
    /// The virtual pulse unit.
    pub rmt: RmtConfig,
    /// From which every random number follows; 0 by default.
    pub seed: u64,
    /// What is kept for the oracle; nothing by default.
    pub record: Recording,
    /// What a script may take.
    pub script: script::Limits,
    /// Scripts are interpreted by whoever has the node, as on a board with two cores; by default by the
    /// node itself.
    pub scripts_elsewhere: bool,
    /// Whether the stored script `boot` runs when the node starts.
    pub boot_script: bool,
    /// Folder of its stored scripts; by default in its flash, or in memory if it has none. Wall clock
    /// only.
    pub scripts: Option<PathBuf>,
    /// Public keys of operators: the node executes only what one of them has signed. None by
    /// default: whatever its gateway sends.
    pub signers: node::signed::Keys,
    /// Router to connect to, `tcp/HOST:PORT` or `tls/HOST:PORT`; on this machine by default; empty: what
    /// scouting finds. Wall clock only.
    pub connect: String,
    /// Who must have signed the router's certificate; with one the node speaks TLS only. None by
    /// default. Wall clock only.
    pub authority: Option<tls::Authority>,
    /// How scouting is done. Wall clock only.
    pub scout: ScoutConfig,
    /// What the node's clock shows when it boots, µs; 0 by default. Wall clock only.
    pub clock_offset_us: u64,
    /// By how much it is too fast, billionths; 0 by default. Wall clock only.
    pub clock_drift_ppb: i64,
    /// For a router that asks; none by default. Wall clock only.
    pub credentials: Option<Credentials>,
    /// Flash with slots for images; none by default.
    pub flash: Option<Flash>,
    /// Public key (ed25519) that images must be signed with; none by default: none is taken.
    pub update_key: Option<[u8; 32]>,
    /// What the boot found of the record; whole by default.
    pub found: Found,
}

impl EmulatorConfig {
    /// Returns the defaults for a node of this name.
    pub fn new(name: NodeId) -> Self {
        Self {
            name,
            keys: Keys::default(),
            axis_count: 2,
            ring_commands: RING_COMMANDS_DEFAULT,
            motion: MotionConfig::default(),
            link_loss: LinkLoss::default(),
            link_loss_after_us: LINK_LOSS_AFTER_US_DEFAULT,
            machine: MachineConfig::default(),
            rmt: RmtConfig::default(),
            seed: 0,
            record: Recording::default(),
            script: script::Limits::default(),
            scripts_elsewhere: false,
            boot_script: false,
            scripts: None,
            signers: node::signed::Keys::new(),
            connect: "tcp/127.0.0.1:7447".to_owned(),
            authority: None,
            scout: ScoutConfig::default(),
            clock_offset_us: 0,
            clock_drift_ppb: 0,
            credentials: None,
            flash: None,
            update_key: None,
            found: Found::Whole,
        }
    }

    /// Returns what the node is told of its axes.
    pub fn motion_config(&self) -> MotionConfig {
        MotionConfig {
            axis_count: self.axis_count,
            ..self.motion.clone()
        }
    }

    /// Puts a switch that is normally closed in the way of an axis: a limit is pressed from `at_steps`
    /// on outward, a home switch for as many steps as an axis backs off at most.
    ///
    /// # Errors
    /// There is no room for another input.
    pub fn add_switch(
        &mut self,
        axis: AxisId,
        switch: Switch,
        at_steps: i64,
    ) -> Result<(), MapError> {
        let pressed = match switch {
            Switch::Min => i64::MIN..=at_steps,
            Switch::Max => at_steps..=i64::MAX,
            Switch::Home => at_steps - HOME_SWITCH_STEPS..=at_steps,
        };
        self.add_input(Role::Axis { axis, switch }, axis.index(), pressed)
    }

    /// Gives the node C and D with the default tables, a limit at each end of both: those of D where
    /// its ends are, C's so far outside its positions.
    ///
    /// # Errors
    /// There is no room for so many inputs.
    pub fn add_cd(&mut self, c_margin_steps: i64) -> Result<(), MapError> {
        let cd = ConfigCd::default();
        let [c_end, d_end] = bed::ends(&cd);
        self.motion.cd = Some(cd);
        self.add_input(Role::C(Switch::Min), CARRIAGE_C, i64::MIN..=-c_margin_steps)?;
        self.add_input(
            Role::C(Switch::Max),
            CARRIAGE_C,
            c_end + c_margin_steps..=i64::MAX,
        )?;
        self.add_input(Role::D(Switch::Min), CARRIAGE_D, i64::MIN..=0)?;
        self.add_input(Role::D(Switch::Max), CARRIAGE_D, d_end..=i64::MAX)
    }

    fn add_input(
        &mut self,
        role: Role,
        carriage: usize,
        pressed: RangeInclusive<i64>,
    ) -> Result<(), MapError> {
        let mut inputs: Vec<_> = (0..INPUTS_MAX)
            .map_while(|index| self.motion.inputs.get(index).copied())
            .collect();
        inputs.push(InputConfig {
            role,
            active_low: false,
            filter: Filter::default(),
        });
        self.motion.inputs = InputMap::new(&inputs, CHANNELS)?;
        self.machine.switches.push(MachineSwitch {
            input: inputs.len() - 1,
            carriage,
            pressed,
            hysteresis_steps: 5,
        });
        Ok(())
    }

    /// Says how an axis is homed.
    pub fn set_home(&mut self, axis: AxisId, home: HomeConfig) {
        if let Some(place) = self.motion.homes.get_mut(axis.index()) {
            *place = Some(home);
        }
    }

    /// Checks what the types do not.
    ///
    /// # Errors
    /// The first thing that is wrong, with its place.
    pub fn check(&self) -> Result<(), ConfigError> {
        self.motion_config().check()
    }

    /// The axes whose direction pin is low for positive.
    pub(crate) fn inverted(&self) -> Vec<bool> {
        let axes = self.motion.axes[..self.axis_count].iter();
        axes.map(|axis| axis.direction_inverted).collect()
    }

    /// The axes that turn by the shift register.
    pub(crate) fn external(&self) -> Vec<bool> {
        let shift = self.motion.shift;
        let pin = |axis| shift.and_then(|shift| shift.direction_pin_of(axis));
        (0..self.axis_count)
            .map(|axis| pin(axis).is_some())
            .collect()
    }

    /// What the oracle knows of C and D.
    pub(crate) fn beside_facts(&self) -> Option<BesideFacts> {
        let cd = self.motion.cd?;
        let scaled = |um: i64, per_m: u32| (um * i64::from(per_m) + 500_000) / 1_000_000;
        let hz = |um_per_s: u32, per_m: u32| {
            let hz = u64::from(um_per_s) * u64::from(per_m) / 1_000_000;
            hz.max(1) as u32
        };
        let limit = |role: Role| {
            let mut inputs = (0..INPUTS_MAX).filter_map(|index| {
                let input = self.motion.inputs.get(index)?;
                (input.role == role).then_some(LimitFacts {
                    input: index,
                    active_level: !input.active_low,
                })
            });
            inputs.next()
        };
        let positions = cd.c.positions.iter().map(|position| {
            let steps = scaled(i64::from(position.position_um), cd.c.steps_per_m);
            (steps, hz(position.speed_um_per_s, cd.c.steps_per_m))
        });
        Some(BesideFacts {
            positions: positions.collect(),
            d_steps: scaled(i64::from(cd.d.travel_um), cd.d.steps_per_m) as u64,
            d_hz: hz(cd.d.speed_um_per_s, cd.d.steps_per_m).min(40_000),
            limits: [
                limit(Role::C(Switch::Min)),
                limit(Role::C(Switch::Max)),
                limit(Role::D(Switch::Min)),
                limit(Role::D(Switch::Max)),
            ],
        })
    }

    /// What the oracle knows of the homes.
    pub(crate) fn home_facts(&self) -> Vec<HomeFacts> {
        let motion = self.motion_config();
        let facts = motion.homes().filter_map(|(axis, home)| {
            let role = Role::Axis {
                axis,
                switch: home.switch,
            };
            let input_of = |index: &usize| {
                let input = motion.inputs.get(*index);
                input.is_some_and(|input| input.role == role)
            };
            let input = (0..INPUTS_MAX).find(input_of)?;
            let active_low = motion.inputs.get(input)?.active_low;
            Some(HomeFacts {
                axis,
                input,
                active_level: !active_low,
                positive: home.direction == Direction::Positive,
                seek_hz: home.seek_hz,
                approach_hz: home.approach_hz,
                accel_hz_per_s: home.accel_hz_per_s,
                travel_steps_max: home.travel_steps_max,
                home_position_steps: home.home_position_steps,
                pull_off_steps: home.pull_off_steps,
            })
        });
        facts.collect()
    }
}

/// Length of an emulated home switch, steps.
const HOME_SWITCH_STEPS: i64 = 1_000;
