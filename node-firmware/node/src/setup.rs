//! What the node tells of itself on the key `setup`: see [`keys::setup`].
//!
//! Made once at a boot, from what the node and whoever keeps it were told. Nothing secret comes in here
//! but public keys, of which a mark goes out.

use crate::{LinkLoss, NodeConfig};
use alloc::{format, vec::Vec};
use keys::{
    AxisId, StopMode,
    setup::{
        self, AxisSetup, EnableSetup, HomingSetup, InputSetup, LinkSetup, PlaceSetup, Reaction,
        Setup, SetupOfC, SetupOfD, SoftLimitsSetup, Word, cut, key_mark,
    },
};
use motion::{
    AxisProfile, Direction, Driver, MotionConfig, SoftLimits,
    io::{
        enable::{AxisSet, EnableConfig, OUTPUTS_MAX},
        home::HomeConfig,
        input::{INPUTS_MAX, InputConfig, Role, Switch},
        named::{ConfigC, ConfigD, POSITIONS_C},
    },
    limits::{CHANNELS, PART_TICKS_MAX, PART_TICKS_MIN, TICK_HZ},
};

const _: () = assert!(INPUTS_MAX <= setup::INPUTS_MAX && OUTPUTS_MAX <= setup::ENABLES_MAX);
const _: () = assert!(POSITIONS_C <= setup::PLACES_MAX && CHANNELS <= keys::AXES_MAX);
const _: () = assert!(crate::signed::KEYS_MAX <= setup::SIGNERS_MAX);

/// What whoever keeps the node knows, and the node itself does not.
#[derive(Clone, Copy, Debug, Default)]
pub struct Surroundings<'a> {
    /// What the node runs on.
    pub chip: &'a str,
    /// Commands that the ring holds.
    pub ring_commands: usize,
    /// Where the router is; empty: it is found by scouting.
    pub router: &'a str,
    /// Whether the link is by TLS.
    pub tls: bool,
    /// As whom the node logs in.
    pub user: Option<&'a str>,
    /// Names of its wireless networks.
    pub networks: &'a [&'a str],
    /// Public key that other firmware must be signed with.
    pub update_key: Option<&'a [u8; 32]>,
}

/// Returns the JSON that a node of this configuration answers, at most
/// [`SETUP_BYTES_MAX`](keys::setup::SETUP_BYTES_MAX) bytes. It is large on the stack while it is made:
/// 3 KB.
#[inline(never)]
pub fn json_of(config: &NodeConfig, around: &Surroundings<'_>) -> Vec<u8> {
    serde_json::to_vec(&setup_of(config, around))
        .expect("numbers and texts, nothing that JSON has no words for")
}

fn setup_of(config: &NodeConfig, around: &Surroundings<'_>) -> Setup {
    let motion = &config.motion;
    let [major, minor, patch] = config.firmware;
    let axes = 0..motion.axis_count.min(CHANNELS);
    let inputs = (0..INPUTS_MAX).map_while(|index| motion.inputs.get(index));
    Setup {
        name: Some(config.name),
        prefix: cut(config.keys.prefix()),
        firmware: cut(&format!("{major}.{minor}.{patch}")),
        chip: cut(around.chip),
        ring_commands: u32::try_from(around.ring_commands).unwrap_or(u32::MAX),
        axes: axes.map(|index| axis_of(motion, index)).collect(),
        inputs: inputs.map(input_of).collect(),
        limit_stop: reaction_of(motion.limit_stop),
        probe_stop: motion.probe_stop.map_or(Reaction::GoOn, reaction_of),
        enables: motion
            .enables
            .iter()
            .map(|output| enable_of(output, motion.axis_count))
            .collect(),
        c: motion.cd.as_ref().map(|cd| c_of(&cd.c)),
        d: motion.cd.as_ref().map(|cd| d_of(&cd.d)),
        lidar_wait_ms: motion.lidar_wait_ms,
        boot_script: config.boot_script,
        signers: config.signers.iter().map(key_mark).collect(),
        update_key: around.update_key.map(key_mark),
        link: LinkSetup {
            router: cut(around.router),
            tls: around.tls,
            user: around.user.map(cut),
            networks: around
                .networks
                .iter()
                .take(setup::NETWORKS_MAX)
                .map(|name| cut(name))
                .collect(),
            loss: match config.link_loss {
                LinkLoss::Finish => Reaction::GoOn,
                LinkLoss::Decelerate => Reaction::Decelerate,
                LinkLoss::Halt => Reaction::Halt,
            },
            loss_after_us: config.link_loss_after_us,
        },
    }
}

const fn reaction_of(mode: StopMode) -> Reaction {
    match mode {
        StopMode::Halt => Reaction::Halt,
        StopMode::Decelerate => Reaction::Decelerate,
    }
}

fn axis_of(motion: &MotionConfig, index: usize) -> AxisSetup {
    let profile = &motion.axes[index];
    AxisSetup {
        driver: driver_of(profile),
        direction_inverted: profile.direction_inverted,
        high_ns_min: profile.high_ns_min,
        low_ns_min: profile.low_ns_min,
        high_ns: profile.high_ns,
        dir_setup_ns: profile.dir_setup_ns,
        dir_hold_ns: profile.dir_hold_ns,
        speed_hz_max: speed_hz_max(profile),
        stop_accel_hz_per_s: profile.stop_accel_hz_per_s,
        junction_hz: profile.junction_hz,
        soft_limits: motion.soft_limits[index].as_ref().map(reach_of),
        homing: motion.homes[index].as_ref().map(homing_of),
    }
}

/// Returns the fastest that the parts of a step allow, in whole ticks as they are played.
fn speed_hz_max(profile: &AxisProfile) -> u32 {
    let part_ticks = |ns: u32| {
        let ticks = (u64::from(ns) * TICK_HZ).div_ceil(1_000_000_000);
        ticks.clamp(PART_TICKS_MIN, PART_TICKS_MAX)
    };
    let interval_ticks = part_ticks(profile.high_ns_min) + part_ticks(profile.low_ns_min);
    u32::try_from(TICK_HZ / interval_ticks).unwrap_or(u32::MAX)
}

/// Returns the driver that demands exactly these times.
fn driver_of(profile: &AxisProfile) -> Option<Word> {
    let times = |of: &AxisProfile| {
        let step = [of.high_ns_min, of.low_ns_min, of.high_ns];
        (step, of.dir_setup_ns, of.dir_hold_ns)
    };
    let is_it = |driver: &Driver| times(&AxisProfile::of_driver(*driver)) == times(profile);
    if times(&AxisProfile::default()) == times(profile) {
        return Some(cut("default"));
    }
    let driver = Driver::ALL.into_iter().find(is_it)?;
    Some(cut(driver.name()))
}

fn reach_of(limits: &SoftLimits) -> SoftLimitsSetup {
    SoftLimitsSetup {
        min_steps: limits.min_steps,
        max_steps: limits.max_steps,
        from_boot: limits.from_boot,
    }
}

fn homing_of(home: &HomeConfig) -> HomingSetup {
    HomingSetup {
        switch: cut(word_of(home.switch)),
        positive: home.direction == Direction::Positive,
        seek_hz: home.seek_hz,
        approach_hz: home.approach_hz,
        accel_hz_per_s: home.accel_hz_per_s,
        travel_steps_max: home.travel_steps_max,
        back_off_steps_max: home.back_off_steps_max,
        margin_steps: home.margin_steps,
        home_position_steps: home.home_position_steps,
        pull_off_steps: home.pull_off_steps,
    }
}

const fn word_of(switch: Switch) -> &'static str {
    match switch {
        Switch::Min => "min",
        Switch::Max => "max",
        Switch::Home => "home",
    }
}

fn input_of(input: &InputConfig) -> InputSetup {
    let of = match input.role {
        Role::Axis { axis, switch } => format!("{}:{}", axis.0, word_of(switch)),
        Role::C(switch) => format!("c:{}", word_of(switch)),
        Role::D(switch) => format!("d:{}", word_of(switch)),
        Role::Stop => "stop".into(),
        Role::Probe => "probe".into(),
    };
    InputSetup {
        of: cut(&of),
        normally_closed: !input.active_low,
        active_us: input.filter.active_us,
        inactive_us: input.filter.inactive_us,
    }
}

fn enable_of(output: &EnableConfig, axis_count: usize) -> EnableSetup {
    let axes = (0..CHANNELS as u8).map(|axis| AxisSet::axis(AxisId(axis)));
    let queue = ('0'..).zip(axes).take(axis_count);
    let all = queue.chain([('c', AxisSet::C), ('d', AxisSet::D)]);
    let enabled = all.filter(|(_, set)| output.axes.meets(*set));
    EnableSetup {
        axes: enabled.map(|(name, _)| name).collect(),
        auto: output.auto,
        delay_on_us: output.delay_on_us,
        delay_off_ms: output.delay_off_ms,
        shift_register: output.external,
    }
}

fn c_of(c: &ConfigC) -> SetupOfC {
    let places = c.positions.iter().map(|place| PlaceSetup {
        name: cut(place.name),
        position_um: place.position_um,
        speed_um_per_s: place.speed_um_per_s,
    });
    SetupOfC {
        steps_per_m: c.steps_per_m,
        places: places.collect(),
    }
}

const fn d_of(d: &ConfigD) -> SetupOfD {
    SetupOfD {
        steps_per_m: d.steps_per_m,
        travel_um: d.travel_um,
        speed_um_per_s: d.speed_um_per_s,
    }
}
