//! What a node was told and what its pins did: the evidence for the oracle and for `--check`.
//!
//! Both lists are bounded. Full: recording ends and [`Life::cut`] says so; nothing is overwritten,
//! so what is there is a whole beginning.

use crate::pins::PinEvent;
use keys::{
    AxisId, Command, LocalMicros, QueueId, Status, StopReport,
    command::{LINE_AXES, Ramp},
};

/// A command that a node took into its ring.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct TakenCommand {
    /// When.
    pub at: LocalMicros,
    /// The queue it was for.
    pub queue: QueueId,
    /// Its number in that queue.
    pub number: u64,
    /// The command.
    pub command: Command,
}

/// A change of an input pin.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct InputEdge {
    /// When, in ticks since the node's boot.
    pub at_ticks: u64,
    /// Index of the input.
    pub index: usize,
    /// Its level from then on.
    pub level: bool,
    /// Where the pulse counters of the axes were then, steps since boot.
    pub counted_steps: [i64; LINE_AXES],
}

/// A time in which motion was held.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Held {
    /// From when on, ticks since the node's boot.
    pub from_ticks: u64,
    /// Until when; `None` if it still is.
    pub until_ticks: Option<u64>,
}

/// Another share of its speed that a node was told.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Speed {
    /// From when on, ticks since the node's boot.
    pub at_ticks: u64,
    /// Of the speed that commands ask for, 2⁻¹⁶: a whole at boot.
    pub share: u32,
}

/// A time in which an axis was driven outside the queue.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Driven {
    /// The axis.
    pub axis: AxisId,
    /// From when on, ticks since the node's boot.
    pub from_ticks: u64,
    /// When it rested; `None` if it still is driven.
    pub until_ticks: Option<u64>,
    /// What it was told meanwhile. To keep the present speed adds none.
    pub orders: Vec<Ramp>,
}

/// What `home` means for one axis.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct HomeFacts {
    /// The axis.
    pub axis: AxisId,
    /// Index of its switch's input.
    pub input: usize,
    /// Level of that while the switch is pressed.
    pub active_level: bool,
    /// The switch is looked for in positive direction.
    pub positive: bool,
    /// Greatest speed of the seek, Hz.
    pub seek_hz: u32,
    /// Greatest speed of all that follows, Hz.
    pub approach_hz: u32,
    /// Greatest acceleration, steps/s².
    pub accel_hz_per_s: u32,
    /// Longest way of the seek, steps.
    pub travel_steps_max: u64,
    /// Position of the switch.
    pub home_position_steps: i64,
    /// Where the axis ends: so many steps off the switch; 0 where it has stopped.
    pub pull_off_steps: u64,
}

/// The limit switch of C or D.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct LimitFacts {
    /// Index of its input.
    pub input: usize,
    /// Level of that while it is pressed.
    pub active_level: bool,
}

/// What C and D are, in steps.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct BesideFacts {
    /// Places of C, and the speed on the way there, Hz.
    pub positions: Vec<(i64, u32)>,
    /// Steps of D from OFF to ON.
    pub d_steps: u64,
    /// Speed of D, Hz.
    pub d_hz: u32,
    /// Low and high limit of C, then of D.
    pub limits: [Option<LimitFacts>; 4],
}

/// One boot of a node.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Life {
    /// The random number of the boot.
    pub boot: u32,
    /// How many axes the node has.
    pub axis_count: usize,
    /// A stop that is under way, of this queue since then: it has no report yet.
    pub stopping: Option<(QueueId, LocalMicros)>,
    /// The commands that were taken, in order.
    pub commands: Vec<TakenCommand>,
    /// How each queue that was dropped ended, in order.
    pub stops: Vec<StopReport>,
    /// Cancels of a queue that the node was given while that was its own, and when.
    pub cancels: Vec<(QueueId, LocalMicros)>,
    /// Every change of a pin, in order of time.
    pub edges: Vec<PinEvent>,
    /// Every change of an input, in order of time.
    pub inputs: Vec<InputEdge>,
    /// When motion was held, in order of time.
    pub holds: Vec<Held>,
    /// Every change of its speed, in order of time.
    pub speeds: Vec<Speed>,
    /// When axes were driven, in order of time.
    pub drives: Vec<Driven>,
    /// How the axes are homed that can be.
    pub homes: Vec<HomeFacts>,
    /// C and D, of a node that has them.
    pub beside: Option<BesideFacts>,
    /// Axes whose direction pin is low for positive.
    pub inverted: Vec<bool>,
    /// Axes that turn by a shift register, at rest, as long as that may take.
    pub external: Vec<bool>,
    /// Whether the queue rests at `lidar_read` until the reading has come.
    pub lidar_waits: bool,
    /// It was held, or ran at another speed than its commands ask for: no path has its one ideal.
    pub paced: bool,
    /// A list was full: later commands and edges are missing.
    pub cut: bool,
    /// The emulated pulse counter of each axis: steps with sign since boot.
    pub counted_steps: Vec<i64>,
    /// What the node said about itself when the record was taken.
    pub status: Status,
}
