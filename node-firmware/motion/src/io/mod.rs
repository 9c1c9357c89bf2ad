//! What surrounds the pulses: inputs, outputs, and the machines that wait for them.
//!
//! ```text
//!  pins ─level─▶ Inputs ─InputEvent─▶ Homing ─▶ run, halt, set position ─▶ drives
//!                input.rs      │      home.rs
//!                              └────▶ PositionsC, SwitchD ─▶ run, rest ─▶ their pulse hardware
//!                                     named.rs
//!  queue ─wants─▶ Enables ─▶ pins, or by ShiftPins ─word─▶ shift register ─read back─▶ ShiftPins
//!                 enable.rs            shift.rs
//! ```
//!
//! All are pure: events and times in, effects out. Nothing here knows the queue, the planner or a
//! pin's number; each file stands alone and can be read alone. What joins them to the queue is in
//! `motion/`. Direction pins are no part of it: one behind a shift register would need a rest and a
//! confirmation at every turn.

pub mod enable;
pub mod home;
pub mod input;
pub mod named;
pub mod shift;
