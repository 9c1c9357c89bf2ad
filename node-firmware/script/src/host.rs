//! What a script finds around it: the node, as far as scripts may see and move it.

use keys::{AxisId, Command, LocalMicros, NodeState, start::BarrierName};
use motion::{CommandError, Course, DriveError, Target};

/// Why a script cannot meet others at a barrier.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum BarrierError {
    /// Its job is not a synchronized one.
    Alone,
    /// It has as many barriers as it may.
    Many,
}

impl core::fmt::Display for BarrierError {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        f.write_str(match self {
            Self::Alone => "only a part of a synchronized job can meet others",
            Self::Many => "the script has too many barriers",
        })
    }
}

impl core::error::Error for BarrierError {}

/// There is no room now; try again later.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Full;

/// The last lidar reading.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct LidarReading {
    /// How many readings there were since boot.
    pub count: u32,
    /// The last one, mm.
    pub mm: Option<u32>,
}

/// The node around a script, for the time of one [`Script::step`](crate::Script::step).
///
/// The queue is the node's own: its commands are counted from the node's first one, and everything
/// that is pushed here is executed as if the gateway had sent it.
pub trait Host {
    /// Returns the node's clock.
    fn now(&self) -> LocalMicros;
    /// Returns how many axes there are.
    fn axis_count(&self) -> usize;
    /// Returns whether a command can be executed here.
    ///
    /// # Errors
    /// Why not.
    fn check(&self, command: &Command) -> Result<(), CommandError>;
    /// Returns how many more commands fit.
    fn credit_commands(&self) -> usize;
    /// Returns the number of the meeting point of this name, from 0: the same for the same name.
    ///
    /// # Errors
    /// It can be none.
    fn barrier(&mut self, name: BarrierName) -> Result<u16, BarrierError>;
    /// Adds commands at the end; at most [`Host::credit_commands`] of them.
    fn push(&mut self, commands: &[Command]);
    /// Returns how many commands the queue has taken.
    fn accepted_commands(&self) -> u64;
    /// Returns how many of them have ended.
    fn executed_commands(&self) -> u64;
    /// Returns the exact position of an axis, steps.
    fn position_steps(&self, axis: AxisId) -> i64;
    /// Returns the speed of an axis, thousandths of a step per second.
    fn speed_mhz(&self, axis: AxisId) -> i32;
    /// Returns whether commands are being executed.
    fn is_active(&self) -> bool;
    /// Returns what the node does.
    fn state(&self) -> NodeState;
    /// Comes to rest on the path.
    fn hold(&mut self);
    /// Goes on after [`Host::hold`].
    fn resume(&mut self);
    /// Sets the speed of everything, percent of what was asked for.
    ///
    /// # Errors
    /// The percentage is out of range.
    fn set_speed_percent(&mut self, percent: u16) -> Result<(), CommandError>;
    /// Drives an axis outside the queue, or changes such a drive in flight; nothing is in the queue.
    ///
    /// # Errors
    /// [`DriveError`]; nothing has happened.
    fn drive(&mut self, axis: AxisId, target: Target, course: Course) -> Result<(), DriveError>;
    /// Brings a drive to rest by its ramp; `None`: all of them.
    fn end_drive(&mut self, axis: Option<AxisId>);
    /// Returns whether an axis is driven.
    fn is_driven(&self, axis: AxisId) -> bool;
    /// Stops at once and sets the latch; the script ends with this call.
    fn emergency_stop(&mut self);
    /// Returns the laser's power, percent.
    fn laser_percent(&self) -> u8;
    /// Returns the last lidar reading.
    fn lidar(&self) -> LidarReading;
    /// Returns whether an input is active, `None` if the node has none of this name.
    fn input(&self, name: &str) -> Option<bool>;
    /// Tells a line of text to whoever reads the node's log.
    fn print(&mut self, line: &str);
    /// Publishes JSON below the node's key.
    ///
    /// # Errors
    /// [`Full`]: as much as may wait does so already.
    fn publish(&mut self, suffix: &str, json: &str) -> Result<(), Full>;
    /// Returns the stored script of this name.
    fn stored(&self, name: &str) -> Option<&str>;
}
