//! The service of a fleet: jobs in, batches to nodes, records out.
//!
//! ```text
//!            shell                │           pure middle                │         shell
//!                                 │                                      │
//!  zenoh ── bus ── parse ── Event ┼─▶ Fleet::handle(event, now) ─▶ Effect┼─▶ journal ─▶ bus ── zenoh
//!                                 │     jobs · nodes · routes · clocks   │   (durable first,
//!                                 │     no clock, no socket, no disk     │    published after)
//! ```
//!
//! Start with [`fleet::event`]: everything that can happen and everything that can be wanted is in
//! that one file. [`fleet::Fleet`] decides, [`job`] says what a job is and which changes of its
//! state are legal, [`journal`] keeps what must survive.

pub mod bus;
pub mod config;
pub mod fleet;
pub mod http;
pub mod job;
pub mod journal;
pub mod observe;
pub mod reading;
pub mod security;
pub mod service;
pub mod settings;
pub mod spans;
