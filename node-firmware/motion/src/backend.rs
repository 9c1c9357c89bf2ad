//! The border to hardware.

use crate::{Ticks, axis::Axis};
use keys::{AxisId, status::FaultCode};

/// The pulse hardware: the RMT of the board, or its model in the emulator.
///
/// It owns the [`Axis`] of each channel, because refills run in its interrupt.
///
/// | verb | promises | who calls |
/// |---|---|---|
/// | `axes` | exclusive: no refill runs meanwhile | planner |
/// | `start` | all channels begin on the same tick, ±3; lead-in first | planner |
/// | `service` | plays in order and only once, never stretches | planner |
/// | `halt` | returns when the pins are quiet; a step that had begun is whole | stop path |
/// | `played_steps` | counts active edges that have left, with sign, since boot | anyone |
/// | `counted_steps` | the same, counted at the pin by something else | planner, at rest |
///
/// A refill calls [`Axis::fill`], sets the direction pin that [`Fill::turn`](crate::Fill::turn)
/// names, and writes the words. How the back end knows what was played is its secret: on the board
/// the read pointer and a pulse counter, in the emulator the same, modelled.
pub trait StepBackend {
    /// Gives the axes, with every refill held off.
    fn axes(&mut self) -> &mut [Axis];

    /// Returns how long [`StepBackend::start`] may take from its `now` until the hardware runs, with
    /// the planning before it, ticks. The lead-in is longer by this.
    fn start_ticks(&self) -> u64 {
        0
    }

    /// Loads every channel with its lead-in of `lead_ticks` and the words behind it, and starts all
    /// of them at `now`.
    fn start(&mut self, now: Ticks, lead_ticks: u64);

    /// Lets the hardware play up to `until`. Returns how far it came: less than `until` when an
    /// axis wants planning first.
    fn service(&mut self, until: Ticks) -> Ticks;

    /// Returns whether a channel still plays.
    fn is_playing(&self) -> bool;

    /// Stops all channels at `now`, each as soon as its pin is low, and settles every axis.
    /// Returns when the last pin is quiet.
    fn halt(&mut self, now: Ticks) -> Ticks;

    /// Returns the active edges that have left, with sign, since boot.
    fn played_steps(&self, axis: AxisId) -> i64;

    /// Returns what a counter at the pin has counted since boot, with sign; `None` without one.
    /// While a channel plays it may run ahead of [`StepBackend::played_steps`] by what happens
    /// between the two calls.
    fn counted_steps(&self, _axis: AxisId) -> Option<i64> {
        None
    }

    /// Returns what went wrong since the last call.
    fn take_fault(&mut self) -> Option<FaultCode>;
}
