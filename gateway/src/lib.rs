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
//!
//! | module | what it owns |
//! |---|---|
//! | [`fleet`] | the decisions: jobs, nodes, routes, clocks, starts, who owns a fleet ([`fleet::owner`]) |
//! | [`job`] | a job, its legal changes, its texts: JSON, Lua, postcard, G-code |
//! | [`journal`] | the store: one file, one transaction for a group of events, copies, the doctor |
//! | [`bus`] | the zenoh sessions: what is heard and answered, bounds of the queues and of each client |
//! | [`reading`] | jobs between bus and fleet: read and checked on other threads, in order |
//! | [`service`] | the running gateway: tasks, the order of commit and publication, shutdown |
//! | [`standby`] | a gateway that waits beside another one |
//! | [`security`] | a secured fleet: certificates, users, rules, signatures; the threat model |
//! | [`config`], [`settings`] | every number of a gateway; `fleet.toml` |
//! | [`observe`], [`http`] | metrics and their names; where they are served |
//! | [`spans`], [`collector`] | one span of the log for each job; where spans are sent (module `otel`, with the feature) |

pub mod bus;
pub mod clock_watch;
pub mod collector;
pub mod config;
pub mod fleet;
pub mod http;
pub mod job;
pub mod journal;
pub mod observe;
#[cfg(feature = "otel")]
pub mod otel;
pub mod reading;
pub mod security;
pub mod service;
pub mod settings;
pub mod spans;
pub mod standby;
