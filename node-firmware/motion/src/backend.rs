//! The border to hardware.

use crate::{Direction, Ticks, axis::Axis};
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
/// names to [`Axis::direction_level`], and writes the words. How the back end knows what was played is its secret: on the board
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

    /// Gives the pulse hardware of C and D, of a node that has them.
    fn cd(&mut self) -> Option<&mut dyn CdBackend> {
        None
    }

    /// Returns what the counter of C shows: steps with sign since boot; 0 without one.
    fn counted_c(&self) -> i64 {
        0
    }

    /// Returns what went wrong since the last call.
    fn take_fault(&mut self) -> Option<FaultCode>;
}

/// The pulse hardware of the axes beside the queue: a timer with a pulse counter for C, one without
/// for D. Both step at one rate; the first edge comes an interval after the call, so that the
/// direction pin has settled.
pub trait CdBackend {
    /// Turns C and makes so many steps with sign, never 0, `interval_ticks` apart; it ends by
    /// itself.
    fn run_c(&mut self, now: Ticks, steps: i64, interval_ticks: u64);

    /// Stops C: no edge leaves after this call.
    fn halt_c(&mut self, now: Ticks);

    /// Returns whether C still steps.
    fn is_c_running(&self) -> bool;

    /// Returns what the pulse counter of C shows: steps with sign since boot.
    fn counted_c(&self) -> i64;

    /// Turns D and steps until [`CdBackend::halt_d`].
    fn run_d(&mut self, now: Ticks, way: Direction, interval_ticks: u64);

    /// Stops D: no edge leaves after this call.
    fn halt_d(&mut self, now: Ticks);

    /// Lets the hardware step up to `until`. Returns how far it came: less than `until` when C has
    /// made its last step.
    fn service(&mut self, until: Ticks) -> Ticks;
}
