//! Another firmware over the network: two slots, a signature, a way back.
//!
//! ```text
//!   fleet update ──UpdateMessage──▶ Updater ──▶ slot that does not run      trial.rs
//!   (keys::update) ◀───reply───── updater.rs    │ hash and signature good   ┌───────────┐
//!                                               └──────────▶ Trial ────────▶│ next boot │
//!                                                                           └───────────┘
//!     booted on trial ─ reaches the router in 60 s ─▶ confirmed
//!                     └ does not, or boots again ───▶ back to the slot before
//! ```
//!
//! Start with [`Updater`], which takes an image chunk by chunk; [`Trial`] is what survives a reset:
//! which slot boots, and whether it has proved itself. Both are pure state machines on the flash
//! traits of `embedded-storage`; a power cut at any byte leaves a slot that boots.
#![no_std]

pub mod trial;
pub mod updater;

pub use trial::{Boot, TRIAL_US, Trial, TrialError};
pub use updater::Updater;
