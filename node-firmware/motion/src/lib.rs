//! Pure motion: commands in, symbols out, the position always known.
//!
//! ```text
//!  Command ─▶ CommandRing ─▶ Planner ─▶ Segment ─▶ Encoder ─▶ Symbol ─▶ StepBackend ─▶ pins
//!  ring.rs    caller's        planner.rs  ring of     encoder.rs  RMT word   the board's RMT or
//!             memory          one timeline each axis  in the      symbol.rs  the emulator's model
//!                             for all axes            refill          │
//!                              │       │                              ▼
//!              Law, Path, Steps┘       └▶ Marks: executed,    Ledger: booked − unplayed
//!              ramps and lines             laser, lidar
//! ```
//!
//! Start with [`Motion`], the whole of it for one node; then `planner.rs`, `encoder.rs`,
//! [`backend`]. How a ramp comes about is read in this order:
//!
//! | file | from → to |
//! |---|---|
//! | [`law`], [`smooth`] | how speed is gained: constant, linear, jerk-limited; by the way |
//! | [`path`] | the fastest motion within a law's limits: place and time, without steps |
//! | [`lookahead`] | how fast a line may be left, given the lines behind it |
//! | `steps.rs` | a path to the edges of all axes, put together to segments |
//! | `motion/change.rs`, `motion/stand.rs` | hold, resume, speed: changed in flight; raw moves stand still |
//! | `planner/brake.rs` | how each axis slows down if the planner does not come back |
//! | [`driver`] | what drivers demand, by name |
//! | `motion/drive.rs`, `motion/legs.rs`, `planner/ways.rs` | axes that are driven each by itself |
//! | `motion/gait.rs` | what an axis does just now |
//! | `motion/inputs.rs`, `motion/homing.rs` | switches: limits, and the way to a reference |
//! | `motion/reach.rs` | soft limits |
//! | `motion/named.rs`, `motion/outputs.rs` | C and D; laser, enable pins, shift register, lidar |
//! | `motion/turns.rs` | direction pins behind the shift register |
//! | [`scale`] | lengths to steps |
//! | [`real`] | the numbers of all this: 62 bits and an exponent, in integers |
//!
//! No clock, no hardware, no allocation, no floating point: time comes in as [`Ticks`] and
//! everything is decided by it.
//!
//! # What it promises
//! - Edges of a raw move lie exactly one interval apart; every edge of a ramp or a line within one
//!   tick (62.5 ns) of its ideal time: half a tick of rounding, a quarter of fitting. Commands
//!   follow each other without a gap; all axes keep one timeline.
//! - A ramp takes the time of the closed form, to the tick. Speed, acceleration and jerk never
//!   exceed what was asked for; at a corner of a path the speed of an axis jumps by
//!   [`AxisProfile::junction_hz`] at most, and a curve of short lines turns no axis harder than their
//!   acceleration.
//! - The position is exact at every instant: the ledger counts active edges that have left the pin,
//!   also when a stop cuts a block short.
//! - A change in flight takes effect behind what the hardware holds: 2 ms at most.
//! - A hold costs no step and no tick: a path slows down and goes on by its own limits, raw moves
//!   stand still on one tick of all axes and go on from it.
//! - A line is left at the speed with which the next one goes on, a drive may pass its target at a speed
//!   ([`Course::passing_mhz`]); what nobody takes over slows down to rest.
//! - What is planned ends at rest. A planner that comes too late in the middle of a path finds the
//!   axes at rest: all have slowed down together by the path's acceleration on the brake that was left
//!   with what is written, within a step and a half of their line (see `planner/brake.rs` for what holds, and
//!   that jerk does not). That is a fault; nothing goes on from there by itself.
//! - What waits at a barrier begins on the tick that it is told, whenever the task is woken.
//! - A stop ends in one place, [`Motion::stop`], from every state: at once, or on its path.
//!
//! - An axis that runs into a limit is told of at once, and one that would go further into a pressed
//!   limit does not begin to.
//!
//! Absent: the stop that follows from a limit; whoever owns the stop path makes it.
#![no_std]
#![deny(clippy::float_arithmetic)]

pub mod axis;
pub mod backend;
pub mod counterparts;
pub mod driver;
pub mod encoder;
pub mod io;
pub mod law;
pub mod ledger;
pub mod limits;
pub mod lookahead;
pub mod path;
pub mod profile;
pub mod real;
pub mod ring;
pub mod scale;
pub mod segment;
pub mod smooth;
pub mod symbol;

mod motion;
mod planner;
mod steps;

pub use axis::Axis;
pub use backend::{CdBackend, StepBackend};
pub use driver::Driver;
pub use encoder::Fill;
pub use limits::TICKS_PER_US;
pub use motion::{
    Beyond, CdError, CommandError, ConfigCd, ConfigError, Course, DriveError, Gait, LimitHit,
    Motion, MotionConfig, MotionEvent, Outlook, PlanMemory, Plans, ShiftConfig, SoftLimits, Target,
};
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
