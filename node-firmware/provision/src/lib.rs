//! What a node is told once, before it is part of a fleet: name, network, router, axes.
//!
//! ```text
//!   fleet provision ──Request──▶ frame.rs ──▶ Dialogue ──▶ Record ──▶ Store ──▶ flash, two copies
//!   (a PC)          ◀──Reply───             dialogue.rs   record.rs  store.rs
//! ```
//!
//! Start with [`Record`], what is kept; [`Store`] keeps it through a power cut at any moment;
//! [`Dialogue`] is the node's side of the serial line, [`Host`] the other one. All are pure: bytes
//! in, bytes out, flash by the traits of `embedded-storage`. The board, the emulated node and the
//! command line use the same code.
//!
//! Secrets go in and never come out: a reply says which are set, not what they are.
#![no_std]

pub mod chip;
pub mod dialogue;
pub mod driver;
pub mod frame;
pub mod host;
pub mod kit;
pub mod machine;
pub mod record;
pub mod stations;
pub mod store;
pub mod tuning;
pub mod wiring;

pub use chip::Chip;
pub use dialogue::{Dialogue, Refused, Reply, Request};
pub use host::{Host, HostError};
pub use machine::Machine;
pub use record::{Record, Setting};
pub use store::{Found, Store, StoreError};
pub use tuning::Tuning;
pub use wiring::{PinFault, PinUse, Wiring};
