//! The same node on a PC: virtual pulse hardware, clock, stream and memory; all else is the board's.
//!
//! ```text
//!  zenoh router ◀── tokio TcpStream ──▶ node::run ──▶ Node ──▶ motion ──▶ VirtualRmt ──▶ PinEvent
//!                    wall.rs             LocalClock                        pulse.rs       │   │
//!                                                                              vcd.rs ◀───┘   ▼
//!                      machine.rs ─levels─▶ Node      record.rs: Life ─────────────▶ oracle.rs
//!                          ▲──────────────────────────────────────────────────────── PinEvent
//! ```
//!
//! Two doors: [`EmulatedNode`] takes bytes and times and never waits (tests, virtual time);
//! [`spawn`] runs one on a real clock and a real socket (the program `emulator`, `fleet demo`).

pub mod bed;
#[cfg(unix)]
pub mod board;
pub mod capture;
pub mod cd;
pub mod clock;
pub mod config;
pub mod emulated;
pub mod firmware;
pub mod flash;
pub mod kinematics;
pub mod oracle;
pub mod pins;
pub mod pulse;
pub mod record;
pub mod scout;
pub mod store;
mod stream;
pub mod vcd;
pub mod verdict;
pub mod wall;
pub mod wiring;

pub mod machine;
mod memory;

pub use config::{Credentials, EmulatorConfig, Recording};
pub use emulated::EmulatedNode;
pub use wall::{EmulatedHandle, spawn};
