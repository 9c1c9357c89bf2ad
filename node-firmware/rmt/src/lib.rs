//! The RMT as step pulse unit: endless streams of symbols on a few registers.
//!
//! ```text
//!   motion::Axis ──fill──▶ Streamer ──words──▶ RMT RAM ──▶ transmitter ──▶ step pin ──▶ PCNT
//!                          streamer.rs         blocks of        │                        │
//!                          lane.rs             layout.rs        │ read pointer           │ count
//!                              ▲───────────────────────────────-┴────────────────────────┘
//! ```
//!
//! Start with [`Streamer`]: it is [`motion::StepBackend`] on [`Registers`], a trait of some fifteen
//! accesses, one register each. The board implements it on the chip, the tests on a model of the
//! peripheral, so the same logic runs in both. [`layout`] says which channel has which words.
//!
//! # What it promises
//! - A stream has no gap and no end until the axis ends: the block is a ring, refilled in units of
//!   [`REFILL_WORDS`] as the read pointer leaves them.
//! - All channels start on one tick, ±3 (TX_SIM), and the first edge comes when it was ordered,
//!   whatever the preparation took; what cannot be met is a fault, not a late start.
//! - [`motion::StepBackend::halt`] cuts no step in half and knows the count: the words behind the
//!   read pointer are replaced by an end marker before the pointer reaches them.
//! - A borrowed block (more than 48 words) always has an end marker behind the last word that was
//!   written: a refill that comes too late finds the axis standing still, not words played twice.
//!   With 48 words there is no room for that; there the pulse counter has the truth.
//!
//! No clock, no allocation, no `unsafe`: time is a register too.
#![no_std]

pub mod layout;
pub mod registers;

mod lane;
mod streamer;

pub use layout::{Layout, Place};
pub use motion::limits::REFILL_WORDS;
pub use registers::{ChannelConfig, ChannelStatus, Events, Registers};
pub use streamer::{Attention, START_TICKS, Streamer, StreamerConfig};
