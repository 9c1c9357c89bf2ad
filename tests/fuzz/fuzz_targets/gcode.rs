//! See `gcode.rs` beside the others.
#![no_main]

#[path = "../src/gcode.rs"]
mod gcode;

libfuzzer_sys::fuzz_target!(|data: &[u8]| gcode::check(data));
