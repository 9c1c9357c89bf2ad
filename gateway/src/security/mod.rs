//! A secured fleet: who may connect, and what each may say and hear.
//!
//! ```text
//!   fleet init DIR      ──▶ DIR/ca.pem, ca.key          the fleet's own authority
//!   fleet users DIR add ──▶ DIR/router.pem, router.key  the router's certificate
//!                           DIR/users                   NAME:ROLE:PASSWORD, a line each
//!                           DIR/NAME.json               credentials to hand to NAME
//!   fleet serve --secure DIR ─ reads all of it ─▶ TLS, passwords and access rules of the router
//! ```
//!
//! Everything is denied but what a [`Role`] allows: see [`access`]. The folder and every file with a
//! secret are readable by their owner only; [`Home::open`] refuses them otherwise.
//!
//! Users and rules are read when the gateway starts: a user who is added or revoked counts from its
//! next start.

pub mod access;
mod certificates;
pub mod home;
pub mod signing;
pub mod users;

pub use home::{Home, HomeError};
pub use users::{Role, User};
