//! Pure motion: commands in, symbols out, the position always known.
//!
//! ```text
//!  Command ─▶ CommandRing ─▶ Planner ─▶ Segment ─▶ Encoder ─▶ Symbol ─▶ StepBackend ─▶ pins
//!  ring.rs    caller's        planner.rs  ring of     encoder.rs  RMT word   the board's RMT or
//!             memory          one timeline each axis  in the      symbol.rs  the emulator's model
//!                             for all axes            refill          │
//!                                  │                                  ▼
//!             Marks: what ends when└──▶ executed, laser, lidar     Ledger: booked − unplayed
//! ```
//!
//! Start with [`Motion`], the whole of it for one node; then `planner.rs`, `encoder.rs`,
//! [`backend`]. No clock, no hardware, no allocation, no floating point: time comes in as [`Ticks`]
//! and everything is decided by it.
//!
//! # What it promises
//! - Edges of a move lie exactly one interval apart; commands follow each other without a gap as
//!   long as the ring holds the next one 20 ms ahead; all axes keep one timeline.
//! - The position is exact at every instant: the ledger counts active edges that have left the pin,
//!   also when a stop cuts a block short.
//! - What waits at a barrier begins on the tick that it is told, whenever the task is woken.
//! - A stop ends in one place, [`Motion::stop`], from every state.
//!
//! Absent as yet: ramps, lines, homing; [`Motion::check`] refuses them.
#![no_std]
#![deny(clippy::float_arithmetic)]

pub mod axis;
pub mod backend;
pub mod encoder;
pub mod ledger;
pub mod limits;
pub mod profile;
pub mod ring;
pub mod segment;
pub mod symbol;

mod motion;
mod planner;

pub use axis::Axis;
pub use backend::StepBackend;
pub use encoder::Fill;
pub use limits::TICKS_PER_US;
pub use motion::{CommandError, Motion, MotionConfig, MotionEvent};
pub use profile::AxisProfile;
pub use ring::{CommandRing, Full, Reservation};
pub use segment::Direction;
pub use symbol::Symbol;

/// Time of the pulse hardware: ticks of 62.5 ns (16 MHz) since the node's boot.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Ticks(pub u64);

impl Ticks {
    /// Returns this much later, saturating.
    #[must_use]
    pub const fn plus(self, ticks: u64) -> Self {
        Self(self.0.saturating_add(ticks))
    }
}
