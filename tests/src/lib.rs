//! The fleet in a bottle: the gateway's pure middle, emulated nodes with their virtual pulse units,
//! a network that fails on purpose, and time, all from one seed.
//!
//! ```text
//!   script ──▶ Gateway ─ effects ─▶ disk (a map) ─▶ Network ─▶ EmulatedNode ─▶ pins
//!                 ▲                                    │             │          │
//!                 └────────── status, ack, clock ──────┴─────────────┘          ▼
//!                                                          Verdict ◀──────── oracle
//! ```
//!
//! [`World`] advances from one event to the next; nothing waits and nothing runs in parallel, so a
//! seed always gives the same run. [`World::verdict`] compares what clients were told, what nodes
//! took and what the pins did: no command lost, doubled or half-taken.
//!
//! Start with `campaign.rs` for a run, `network.rs` for what can go wrong on the way. What needs real
//! processes and sockets is in `field.rs`.

pub mod cables;
pub mod campaign;
pub mod field;
pub mod gateway_process;
pub mod long;
pub mod memory;
pub mod network;
pub mod random;
pub mod soak;
pub mod verdict;
pub mod world;

pub use network::Faults;
pub use random::Random;
pub use world::World;
