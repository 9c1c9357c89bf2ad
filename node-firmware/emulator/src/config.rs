//! Every setting of an emulated node, with unit and default.

use crate::pulse::RmtConfig;
use keys::{Keys, NodeId};
use motion::MotionConfig;
use node::{
    LinkLoss,
    limits::{LINK_LOSS_AFTER_US_DEFAULT, RING_COMMANDS_DEFAULT},
};
pub use pico::session::Credentials;

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
    /// The virtual pulse unit.
    pub rmt: RmtConfig,
    /// From which every random number follows; 0 by default.
    pub seed: u64,
    /// What is kept for the oracle; nothing by default.
    pub record: Recording,
    /// What a script may take.
    pub script: script::Limits,
    /// Whether the stored script `boot` runs when the node starts.
    pub boot_script: bool,
    /// Router to connect to, `tcp/HOST:PORT`; on this machine by default. Wall clock only.
    pub connect: String,
    /// What the node's clock shows when it boots, µs; 0 by default. Wall clock only.
    pub clock_offset_us: u64,
    /// By how much it is too fast, billionths; 0 by default. Wall clock only.
    pub clock_drift_ppb: i64,
    /// For a router that asks; none by default. Wall clock only.
    pub credentials: Option<Credentials>,
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
            rmt: RmtConfig::default(),
            seed: 0,
            record: Recording::default(),
            script: script::Limits::default(),
            boot_script: false,
            connect: "tcp/127.0.0.1:7447".to_owned(),
            clock_offset_us: 0,
            clock_drift_ppb: 0,
            credentials: None,
        }
    }
}
