//! What a node was told and is made of, without its secrets, on the key `setup`: for whoever stands in
//! front of the machine and wants to know how it is set.
//!
//! The node itself answers a get on `PREFIX/node/NODE/setup` (also by a wild key) with one JSON object,
//! at most [`SETUP_BYTES_MAX`] bytes. It is what the node works by since its boot, so what is written to
//! its flash later shows after the next one. Nobody keeps it: a node that is not there does not answer,
//! and neither does one that is older than this key.
//!
//! ```text
//! {"name":"left","prefix":"fleet","firmware":"0.1.0","chip":"ESP32-S3","ring_commands":4096,
//!  "axes":[{"driver":"tmc2209","direction_inverted":false,"high_ns_min":100,"low_ns_min":100,
//!           "high_ns":2500,"dir_setup_ns":20,"dir_hold_ns":20,"speed_hz_max":4000000,
//!           "stop_accel_hz_per_s":100000,"junction_hz":200,
//!           "soft_limits":{"min_steps":-10,"max_steps":5000,"from_boot":false},
//!           "homing":{"switch":"min","positive":false,"seek_hz":5000,…}}],
//!  "inputs":[{"of":"0:min","normally_closed":true,"active_us":20,"inactive_us":5000}],
//!  "limit_stop":"halt","probe_stop":"go_on","enables":[…],"c":null,"d":null,"lidar_wait_ms":null,
//!  "boot_script":false,"signers":["5f1e22a0"],"update_key":"77aa01c9",
//!  "link":{"router":"tls/plant.local:7447","tls":true,"user":"left","networks":["shop"],
//!          "loss":"decelerate","loss_after_us":2000000}}
//! ```
//!
//! Units are in the names. Passwords are never part of it, and of a public key only the first four
//! bytes, to tell keys apart. Steps of a millimetre of the axes are not the node's business, which counts
//! steps: they are in the gateway's `fleet.toml`.
//!
//! Fields are only added: a reader passes over those that it does not know, and takes the default for
//! those that an older node does not say.

use crate::{AXES_MAX, NodeId, key::PREFIX_BYTES_MAX};
use heapless::{String, Vec};
use serde::{Deserialize, Serialize};

/// Most bytes of it as JSON, of a node that has as much of everything as there can be; one with two axes
/// takes a thousand.
pub const SETUP_BYTES_MAX: usize = 10 * 1024;

/// Most inputs.
pub const INPUTS_MAX: usize = 20;

/// Most enable outputs, and most axes of one.
pub const ENABLES_MAX: usize = 6;

/// Places of C.
pub const PLACES_MAX: usize = 5;

/// Longest locator of a router and longest name of a user; what is longer is cut.
pub const TEXT_BYTES_MAX: usize = 64;

/// Longest name of a network (IEEE 802.11).
pub const NETWORK_BYTES_MAX: usize = 32;

/// Most networks.
pub const NETWORKS_MAX: usize = 4;

/// Most keys of operators.
pub const SIGNERS_MAX: usize = 8;

/// Longest word: of a driver, a chip, a version, a switch.
pub const WORD_BYTES_MAX: usize = 16;

/// A short word.
pub type Word = String<WORD_BYTES_MAX>;

/// The first four bytes of a public key, hexadecimal.
pub type KeyMark = String<8>;

/// See the module.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(default)]
pub struct Setup {
    /// Its name; always there.
    pub name: Option<NodeId>,
    /// Prefix of its fleet's keys.
    pub prefix: String<PREFIX_BYTES_MAX>,
    /// Version of the firmware, `1.2.3`.
    pub firmware: Word,
    /// What it runs on: `ESP32-S3`, or `emulated`.
    pub chip: Word,
    /// Commands that its ring holds when empty.
    pub ring_commands: u32,
    /// The axes of the queue, by number.
    pub axes: Vec<AxisSetup, AXES_MAX>,
    /// The inputs that it looks at.
    pub inputs: Vec<InputSetup, INPUTS_MAX>,
    /// How an axis stops that comes to a limit switch.
    pub limit_stop: Reaction,
    /// What everything does when the probe touches.
    pub probe_stop: Reaction,
    /// The enable outputs.
    pub enables: Vec<EnableSetup, ENABLES_MAX>,
    /// The axis C, if it is there.
    pub c: Option<SetupOfC>,
    /// The axis D, if it is there.
    pub d: Option<SetupOfD>,
    /// How long a lidar reading is waited for at rest, ms; `None`: there is no lidar, or it is asked in
    /// passing.
    pub lidar_wait_ms: Option<u32>,
    /// Whether the stored script `boot` runs when it starts.
    pub boot_script: bool,
    /// Whose signatures count; none: it executes whatever its gateway sends.
    pub signers: Vec<KeyMark, SIGNERS_MAX>,
    /// The key that other firmware must be signed with; `None`: it takes none over the network.
    pub update_key: Option<KeyMark>,
    /// Its way to the router.
    pub link: LinkSetup,
}

/// An axis of the queue.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(default)]
pub struct AxisSetup {
    /// The driver whose times these are, as `fleet provision --driver` calls it; `None`: nobody's.
    pub driver: Option<Word>,
    /// Whether the direction pin is low for positive.
    pub direction_inverted: bool,
    /// Shortest high time of a step, ns.
    pub high_ns_min: u32,
    /// Shortest low time between steps, ns.
    pub low_ns_min: u32,
    /// High time of slow steps, ns.
    pub high_ns: u32,
    /// From a change of direction to the next step, ns.
    pub dir_setup_ns: u32,
    /// From a step to a change of direction, ns.
    pub dir_hold_ns: u32,
    /// Fastest that those times allow, steps/s.
    pub speed_hz_max: u32,
    /// Deceleration of a controlled stop of raw moves, steps/s².
    pub stop_accel_hz_per_s: u32,
    /// Most that the speed jumps at a corner of a path, steps/s.
    pub junction_hz: u32,
    /// How far it may go; `None`: as far as it is told.
    pub soft_limits: Option<SoftLimitsSetup>,
    /// How it is homed; `None`: it is not.
    pub homing: Option<HomingSetup>,
}

/// How far an axis may go.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(default)]
pub struct SoftLimitsSetup {
    /// Lowest position, steps.
    pub min_steps: i64,
    /// Highest position, steps.
    pub max_steps: i64,
    /// Whether they count before the axis is homed, too.
    pub from_boot: bool,
}

/// How an axis is homed.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(default)]
pub struct HomingSetup {
    /// The switch that it looks for: `min`, `max` or `home`.
    pub switch: Word,
    /// Whether that is in the positive direction.
    pub positive: bool,
    /// Speed of the seek, steps/s.
    pub seek_hz: u32,
    /// Speed of backing off, of the approach and of pulling off, steps/s.
    pub approach_hz: u32,
    /// Acceleration of all of them, steps/s².
    pub accel_hz_per_s: u32,
    /// Longest way of the seek, steps.
    pub travel_steps_max: u64,
    /// Longest way until the switch is released, steps.
    pub back_off_steps_max: u64,
    /// Way behind the release from which the approach begins, steps.
    pub margin_steps: u64,
    /// Position of the switch, steps.
    pub home_position_steps: i64,
    /// Where it ends, steps off the switch.
    pub pull_off_steps: u64,
}

/// An input.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(default)]
pub struct InputSetup {
    /// What it is, as `fleet provision --switch` calls it: `0:min`, `1:home`, `c:max`, `probe`; `stop`.
    pub of: Word,
    /// Whether a cut wire counts as pressed.
    pub normally_closed: bool,
    /// How long it must be pressed to count, µs; 0: at once.
    pub active_us: u32,
    /// How long it must be released to count, µs.
    pub inactive_us: u32,
}

/// An enable output.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(default)]
pub struct EnableSetup {
    /// Whose drivers: `0`, `1`, …, `c`, `d`.
    pub axes: Vec<char, ENABLES_MAX>,
    /// Whether motion switches it on, and rest off; else it is on from boot on.
    pub auto: bool,
    /// From on to the first step, µs.
    pub delay_on_us: u32,
    /// From rest to off, ms; of one that is automatic.
    pub delay_off_ms: u32,
    /// Whether it is behind the shift register.
    pub shift_register: bool,
}

/// The axis C, which goes to places with names.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(default)]
pub struct SetupOfC {
    /// Steps of one metre.
    pub steps_per_m: u32,
    /// Its places, from the low limit to the high one.
    pub places: Vec<PlaceSetup, PLACES_MAX>,
}

/// A place of C.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(default)]
pub struct PlaceSetup {
    /// What it is called.
    pub name: Word,
    /// Where it is, µm.
    pub position_um: i32,
    /// Speed on the way there, µm/s.
    pub speed_um_per_s: u32,
}

/// The axis D, which is off or on.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(default)]
pub struct SetupOfD {
    /// Steps of one metre.
    pub steps_per_m: u32,
    /// Way between off and on, µm.
    pub travel_um: u32,
    /// Speed, µm/s.
    pub speed_um_per_s: u32,
}

/// The way to the router.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(default)]
pub struct LinkSetup {
    /// Where it is, `tcp/HOST:PORT` or `tls/HOST:PORT`; empty: it is found by scouting.
    pub router: String<TEXT_BYTES_MAX>,
    /// Whether it speaks TLS, and only to a router whose certificate its authority has signed.
    pub tls: bool,
    /// As whom it logs in; `None`: as nobody.
    pub user: Option<String<TEXT_BYTES_MAX>>,
    /// Names of the wireless networks that it knows, the preferred one first.
    pub networks: Vec<String<NETWORK_BYTES_MAX>, NETWORKS_MAX>,
    /// What it does when the link stays away while it moves.
    pub loss: Reaction,
    /// How long the link must be gone for that, µs.
    pub loss_after_us: u64,
}

/// What a node does when something happens.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Reaction {
    /// Stops at once.
    #[default]
    Halt,
    /// Comes to rest by the ramp that each axis allows.
    Decelerate,
    /// Goes on.
    GoOn,
}

/// Returns as much of a text as there is room for.
pub fn cut<const N: usize>(text: &str) -> String<N> {
    let mut kept = String::new();
    for character in text.chars() {
        if kept.push(character).is_err() {
            break;
        }
    }
    kept
}

/// Returns what is shown of a public key.
pub fn key_mark(key: &[u8; 32]) -> KeyMark {
    let mut mark = KeyMark::new();
    for byte in &key[..4] {
        for digit in [byte >> 4, byte & 0xf] {
            let digit = char::from_digit(u32::from(digit), 16).expect("four bits");
            mark.push(digit).expect("eight digits of four bytes");
        }
    }
    mark
}

#[cfg(feature = "json")]
impl Setup {
    /// Reads it.
    ///
    /// # Errors
    /// It is longer than [`SETUP_BYTES_MAX`], or no such object; the words say where.
    pub fn from_json(bytes: &[u8]) -> Result<Self, std::string::String> {
        use std::{format, string::ToString};
        if bytes.len() > SETUP_BYTES_MAX {
            return Err(format!("a setup of {} bytes", bytes.len()));
        }
        serde_json::from_slice(bytes).map_err(|error| error.to_string())
    }
}
