//! See `fuzz::jog`.
#![no_main]

libfuzzer_sys::fuzz_target!(|data: &[u8]| fuzz::jog::check(data));
