//! What we build on: every `unsafe` has a place and a reason, every crate a licence that we may use,
//! and no crate that we chose comes twice without a reason.
//!
//! The same lists serve `.ci/advisories` (cargo-deny), which also knows the advisories; their database has
//! to be fetched, so people and CI run it.

use serde_json::Value;
use std::{
    collections::{BTreeMap, BTreeSet},
    fs,
    path::{Path, PathBuf},
    process::Command,
};

/// Every file of ours with `unsafe` in it, and why it cannot do without. The rest of the workspace is
/// built with `unsafe_code = "deny"`.
const UNSAFE: [(&str, &str); 17] = [
    (
        ".ci/client-size/src/main.rs",
        "a program that is only linked and weighed: its input, heap and entry",
    ),
    (
        ".ci/rv32/src/main.rs",
        "a bare machine for counting instructions: its counters and its console",
    ),
    (
        "node-firmware/esp32s3/src/bin/hil/load.rs",
        "the memory behind the second bus, word by word",
    ),
    (
        "node-firmware/esp32s3/src/bin/hil/loopback.rs",
        "a receiver beside the driver of the transmitters",
    ),
    (
        "node-firmware/esp32s3/src/bin/hil/stages.rs",
        "memory that outlives a reset",
    ),
    (
        "node-firmware/esp32s3/src/board.rs",
        "pins are taken out of the chip's parts once",
    ),
    (
        "node-firmware/esp32s3/src/cd.rs",
        "registers of the timers of C and D, and an interrupt",
    ),
    (
        "node-firmware/esp32s3/src/heap.rs",
        "the allocator: small blocks in internal RAM, large ones behind the second bus",
    ),
    (
        "node-firmware/esp32s3/src/inputs.rs",
        "registers of the input pins, and their interrupt",
    ),
    (
        "node-firmware/esp32s3/src/main.rs",
        "the second core waits for interrupts",
    ),
    (
        "node-firmware/esp32s3/src/panic.rs",
        "outputs off before anything else, from any state",
    ),
    (
        "node-firmware/esp32s3/src/psram.rs",
        "the memory behind the second bus as a slice",
    ),
    (
        "node-firmware/esp32s3/src/pwm.rs",
        "registers of the LEDC: the laser",
    ),
    (
        "node-firmware/esp32s3/src/rmt.rs",
        "registers of the pulse unit, and its interrupt",
    ),
    (
        "node-firmware/esp32s3/src/vitals.rs",
        "stacks that are painted and read, registers of the thermometer",
    ),
    (
        "node-firmware/esp32s3/src/watchdog.rs",
        "a watchdog that two cores feed",
    ),
    ("node-firmware/script/src/ffi.rs", "Lua is C"),
];

/// Crates that we name ourselves and that come in two versions all the same.
const TWICE: [(&str, &str); 4] = [
    ("base64", "0.23 is below rcgen; zenoh has 0.22"),
    (
        "getrandom",
        "zenoh-keyexpr has 0.2; newer crates have newer ones",
    ),
    (
        "hmac",
        "zenoh's password answer has the MAC for sha3 0.10; TLS of a node the one for sha2 0.11",
    ),
    ("thiserror", "the window's toolkit for Wayland has 1"),
];

fn root() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("..")
}

fn rust_files(below: &Path, files: &mut Vec<PathBuf>) {
    for entry in fs::read_dir(below).expect("a folder") {
        let path = entry.expect("an entry").path();
        let name = path.file_name().and_then(|name| name.to_str());
        let name = name.unwrap_or_default();
        if path.is_dir() && !["target", ".git"].contains(&name) {
            rust_files(&path, files);
        } else if name.ends_with(".rs") {
            files.push(path);
        }
    }
}

/// Returns whether a line of code, without its comment and its texts, has the word.
fn is_unsafe(line: &str) -> bool {
    let code = line.split("//").next().unwrap_or_default();
    let code: String = code.split('"').step_by(2).collect();
    let mut words = code.split(|letter: char| !letter.is_alphanumeric() && letter != '_');
    words.any(|word| word == "unsafe")
}

#[test]
fn every_unsafe_has_a_place_in_the_inventory_and_every_place_has_one() {
    let root = root();
    let mut files = Vec::new();
    rust_files(&root, &mut files);
    let mut found = BTreeSet::new();
    for path in files {
        let text = fs::read_to_string(&path).expect("text");
        if text.lines().any(is_unsafe) {
            let name = path.strip_prefix(&root).expect("below the root");
            found.insert(name.to_string_lossy().into_owned());
        }
    }
    let listed = UNSAFE.map(|(name, _)| name.to_owned());
    assert_eq!(found, BTreeSet::from(listed));
}

/// Folders with a lock file of their own, beside the workspace: what is built for other machines or by
/// another compiler.
const APART: [&str; 4] = [
    ".ci/client-size",
    ".ci/rv32",
    "node-firmware/esp32s3",
    "tests/fuzz",
];

/// Everything that can be built for this machine, with all features, as cargo knows it.
fn metadata() -> Value {
    let version = Command::new("rustc")
        .arg("-vV")
        .output()
        .expect("rustc runs");
    let version = String::from_utf8(version.stdout).expect("text");
    let host = version.lines().find_map(|line| line.strip_prefix("host: "));
    let host = host.expect("rustc names its host");
    metadata_of(&root(), &["--filter-platform", host])
}

/// What the lock file in a folder leads to. It must be up to date.
fn metadata_of(folder: &Path, options: &[&str]) -> Value {
    let cargo = std::env::var("CARGO").unwrap_or_else(|_| "cargo".to_owned());
    let output = Command::new(cargo)
        .args([
            "metadata",
            "--format-version=1",
            "--locked",
            "--all-features",
        ])
        .args(options)
        // Of the folder and not of whoever runs this test.
        .env_remove("CARGO_ENCODED_RUSTFLAGS")
        .env_remove("RUSTUP_TOOLCHAIN")
        .current_dir(folder)
        .output()
        .expect("cargo runs");
    assert!(
        output.status.success(),
        "{}: {}",
        folder.display(),
        String::from_utf8_lossy(&output.stderr)
    );
    serde_json::from_slice(&output.stdout).expect("JSON")
}

fn packages(metadata: &Value) -> impl Iterator<Item = &Value> {
    metadata["packages"].as_array().expect("a list").iter()
}

/// Returns whether one of the ways that an SPDX expression offers is allowed in all its parts.
fn may_be_used(licence: &str, allowed: &BTreeSet<String>) -> bool {
    let licence = licence.replace('/', " OR ");
    let licence = licence.trim();
    // Parentheses: each is answered alone, and stands for its answer.
    if let Some(end) = licence.find(')') {
        let begin = licence[..end].rfind('(').expect("a pair");
        let answer = if may_be_used(&licence[begin + 1..end], allowed) {
            "yes"
        } else {
            "no"
        };
        let rest = format!("{}{answer}{}", &licence[..begin], &licence[end + 1..]);
        return may_be_used(&rest, allowed);
    }
    licence.split(" OR ").any(|way| {
        way.split(" AND ")
            .all(|part| part.trim() == "yes" || allowed.contains(part.trim()))
    })
}

#[test]
fn every_crate_has_a_licence_that_we_may_use_and_comes_from_the_registry() {
    let deny = fs::read_to_string(root().join(".deny.toml")).expect("it is there");
    let list = deny
        .split("allow = [")
        .nth(1)
        .and_then(|rest| rest.split(']').next());
    let quoted = list.expect("a list").split('"').skip(1).step_by(2);
    let allowed: BTreeSet<String> = quoted.map(str::to_owned).collect();
    assert!(may_be_used("(MIT OR GPL-3.0) AND Apache-2.0", &allowed));
    assert!(!may_be_used("MIT AND GPL-3.0", &allowed));
    assert!(!may_be_used("(GPL-2.0 OR GPL-3.0) AND MIT", &allowed));
    let mut wrong = Vec::new();
    let mut all = vec![metadata()];
    all.extend(APART.map(|folder| metadata_of(&root().join(folder), &[])));
    for package in all.iter().flat_map(packages) {
        let name = format!("{} {}", package["name"], package["version"]);
        let licence = package["license"].as_str().unwrap_or_default();
        let source = package["source"].as_str();
        let ours = source.is_none();
        if !ours && !may_be_used(licence, &allowed) {
            wrong.push(format!("{name}: licence {licence:?}"));
        }
        if !ours && source != Some("registry+https://github.com/rust-lang/crates.io-index") {
            wrong.push(format!("{name}: from {source:?}"));
        }
    }
    assert!(wrong.is_empty(), "{wrong:#?}");
}

#[test]
fn every_lock_file_is_one_that_is_looked_at() {
    let mut found = BTreeSet::new();
    let mut folders = vec![root()];
    while let Some(folder) = folders.pop() {
        for entry in fs::read_dir(&folder).expect("a folder") {
            let path = entry.expect("an entry").path();
            let name = path.file_name().unwrap_or_default();
            if path.is_dir() && name != "target" && name != ".git" {
                folders.push(path);
            } else if name == "Cargo.lock" {
                let of = folder.strip_prefix(root()).expect("below the root");
                found.insert(of.to_string_lossy().into_owned());
            }
        }
    }
    let listed = APART.into_iter().chain([""]).map(str::to_owned);
    assert_eq!(found, listed.collect());
}

#[test]
fn no_crate_that_we_chose_comes_twice_without_a_reason() {
    let metadata = metadata();
    let mut chosen = BTreeSet::new();
    let mut versions: BTreeMap<&str, BTreeSet<&str>> = BTreeMap::new();
    for package in packages(&metadata) {
        let text = |field: &str| package[field].as_str().expect("text");
        versions
            .entry(text("name"))
            .or_default()
            .insert(text("version"));
        if package["source"].is_null() {
            let of_ours = package["dependencies"].as_array().expect("a list");
            chosen.extend(of_ours.iter().filter_map(|of| of["name"].as_str()));
        }
    }
    let twice: BTreeSet<&str> = chosen
        .into_iter()
        .filter(|name| versions.get(name).is_some_and(|all| all.len() > 1))
        .collect();
    assert_eq!(twice, BTreeSet::from(TWICE.map(|(name, _)| name)));
}
