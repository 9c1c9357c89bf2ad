//! What a board has beside its step pulses, on a few registers.
//!
//! ```text
//!   switches ──▶ glitch filter ──edge──▶ inputs.rs ──PinLevel──▶ motion::io (debounces, decides)
//!   motion ──word──▶ shift.rs ──▶ 74HC595 ──▶ pins ──▶ 74HC165 ──▶ shift.rs ──word──▶ motion
//!   motion ──percent──▶ pwm.rs ──LEDC──▶ laser
//!   lidar ──bytes──▶ lidar.rs ──mm──▶ motion, which waits for it
//!   motion ──run, halt──▶ cd.rs ──MCPWM──▶ step C ──PCNT──▶ cd.rs;  ──LEDC──▶ step D
//!   chip ──raw──▶ thermometer.rs ──°C──▶ the node's vitals
//!   panic, events ──▶ blackbox.rs ──reset──▶ the log of the next boot
//!   network ──question──▶ mdns.rs ──▶ the node's name and address
//! ```
//!
//! Each file has the trait of the registers that it uses, one method an access, and the logic above
//! it. The board implements the traits on the chip, the tests on models of the peripherals, so the
//! same logic runs in both. No clock, no allocation, no `unsafe`.
//!
//! Absent: what an input or a place means ([`motion::io`]), and which pin is which (the board).
#![no_std]

pub mod blackbox;
pub mod cd;
pub mod inputs;
pub mod lidar;
pub mod mdns;
pub mod pwm;
pub mod shift;
pub mod thermometer;

pub use cd::{CdRegisters, Timers};
pub use inputs::{Capture, InputRegisters};
pub use lidar::TfLuna;
pub use pwm::{Laser, PwmRegisters, PwmTimer};
pub use shift::ShiftLines;
