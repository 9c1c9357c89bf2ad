//! The pins of an emulated node: every change of level with its time in ticks.

use keys::AxisId;

/// An output pin.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Pin {
    /// Step output of an axis.
    Step(AxisId),
    /// Direction output of an axis: high is positive.
    Direction(AxisId),
}

/// One change of level.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct PinEvent {
    /// When, in ticks of the pulse hardware (16 MHz) since the node's boot.
    pub at_ticks: u64,
    /// Which pin.
    pub pin: Pin,
    /// Its level from then on.
    pub level: bool,
}
