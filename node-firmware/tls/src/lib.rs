//! TLS 1.3 of a node: bytes of a stream in, bytes of a session out, and the other way round.
//!
//! ```text
//!            records                      zenoh's bytes
//!   stream ──handle_bytes──▶ ┌─────────┐ ──receive──▶ session
//!          ◀─poll_transmit── │ TlsLink │
//!          ◀──────────────── └─────────┘ ◀──send───── session
//! ```
//!
//! Begin with [`link`]; [`stream`] puts a link over the halves of any byte stream, [`authority`] is
//! who is trusted, `provider` the algorithms.
//!
//! The protocol is rustls', without `std`, by its interface that does no I/O. What is ours is the
//! choice: TLS 1.3 only, one suite (ChaCha20-Poly1305 with SHA-256: quick and even in time without a
//! cipher unit), one group (X25519), one kind of signature (ECDSA on P-256, which `fleet init`
//! makes), no resumption, no client certificate (a node proves itself by its password, inside), and
//! exactly one authority. Why rustls and not `embedded-tls`: a read that is dropped loses nothing, as
//! the state machine has every byte that it was given; addresses are checked and not only names; and
//! its memory is a quarter. It takes more flash: 270 KB of code and constants on riscv32imac, optimized
//! for size.
//!
//! Promises: no bytes from outside make it panic; what it takes of the heap has a bound
//! ([`link::RECORD_BYTES_MAX`]) before anybody has proved who he is; what [`TlsLink::receive`] gives
//! is what the router has sent, from its beginning, in its order; after an error nothing more is
//! given or sent but the alert that tells the router.
//!
//! Deliberately absent: a clock. See [`link::TlsConfig::new`].

#![no_std]

extern crate alloc;

pub mod authority;
mod certificate;
pub mod error;
pub mod link;
mod provider;
pub mod stream;

pub use authority::{Authority, AuthorityError};
pub use error::TlsError;
pub use link::{TlsConfig, TlsLink};
