//! The pins of an emulated node: every change of level with its time in ticks.

use keys::AxisId;
use motion::limits::CHANNELS;

/// An output pin.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Pin {
    /// Step output of an axis.
    Step(AxisId),
    /// Direction output of an axis: high is positive.
    Direction(AxisId),
    /// High-active pin of an enable output; the low-active one is its opposite.
    Enable(u8),
    /// Step output of C.
    StepC,
    /// Direction output of C: high is positive.
    DirectionC,
    /// Step output of D.
    StepD,
    /// Direction output of D: high is toward ON.
    DirectionD,
}

impl Pin {
    /// Returns the carriage that a step of this output moves: those of the axes by number, then C,
    /// then D; `None` for another output.
    pub const fn stepped_carriage(self) -> Option<usize> {
        match self {
            Self::Step(axis) => Some(axis.0 as usize),
            Self::StepC => Some(CARRIAGE_C),
            Self::StepD => Some(CARRIAGE_D),
            _ => None,
        }
    }

    /// Returns the carriage that this output turns.
    pub const fn turned_carriage(self) -> Option<usize> {
        match self {
            Self::Direction(axis) => Some(axis.0 as usize),
            Self::DirectionC => Some(CARRIAGE_C),
            Self::DirectionD => Some(CARRIAGE_D),
            _ => None,
        }
    }
}

/// Number of the carriage of C.
pub const CARRIAGE_C: usize = CHANNELS;

/// Number of the carriage of D.
pub const CARRIAGE_D: usize = CHANNELS + 1;

/// Carriages of a machine.
pub const CARRIAGES: usize = CHANNELS + 2;

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
