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
//! Start with [`Keeper`], the whole of it for one node: [`Updater`] takes an image chunk by chunk,
//! [`Trial`] is what survives a reset, whether the slot that runs has proved itself; [`Note`] is what
//! the boot loader goes by. All are pure state machines on the flash traits of `embedded-storage`; a power
//! cut at any byte leaves a slot that boots. `layout.rs` says where things lie in a board's flash.
#![no_std]

pub mod keeper;
pub mod layout;
pub mod note;
pub mod region;
pub mod trial;
pub mod updater;

pub use keeper::{Keeper, Layout};
pub use note::Note;
pub use region::{Place, Region};
pub use trial::{Boot, TRIAL_US, Trial, TrialError};
pub use updater::Updater;
