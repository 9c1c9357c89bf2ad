//! Puts the linker script of the pulse path where the linker looks.

use std::{env, fs, path::PathBuf};

fn main() {
    let out = PathBuf::from(env::var_os("OUT_DIR").expect("cargo sets it"));
    let mut script = include_str!("pulse.x").to_owned();
    if env::var_os("CARGO_FEATURE_ESP32S3").is_some() {
        script.push_str(include_str!("pulse-xtensa.x"));
    }
    fs::write(out.join("pulse.x"), script).expect("OUT_DIR is writable");
    println!("cargo:rustc-link-search={}", out.display());
    println!("cargo:rerun-if-changed=pulse.x");
    println!("cargo:rerun-if-changed=pulse-xtensa.x");
}
