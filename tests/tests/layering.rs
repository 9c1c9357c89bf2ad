//! Who may import whom. Cargo knows; this test says it in sentences.

use std::{collections::BTreeSet, process::Command};

/// Crate, and what of ours it may import outside of tests.
const ALLOWED: [(&str, &[&str]); 15] = [
    ("keys", &[]),
    ("motion", &["keys"]),
    ("pico", &[]),
    ("script", &["keys", "motion"]),
    ("node", &["keys", "motion", "pico", "script"]),
    ("rmt", &["keys", "motion"]),
    ("periphery", &["motion"]),
    ("provision", &["keys", "motion"]),
    ("tls", &[]),
    ("update", &["keys"]),
    (
        "emulator",
        &[
            "keys",
            "motion",
            "pico",
            "script",
            "node",
            "provision",
            "tls",
            "update",
        ],
    ),
    (
        "gateway",
        &["keys", "client", "provision", "tls", "emulator"],
    ),
    ("client", &["keys"]),
    ("dashboard", &["keys"]),
    ("tests", &["keys", "node", "emulator", "gateway"]),
];

#[test]
fn imports_lead_the_way_that_the_readme_draws() {
    let output = Command::new(env!("CARGO"))
        .args([
            "metadata",
            "--no-deps",
            "--offline",
            "--format-version",
            "1",
        ])
        .current_dir(env!("CARGO_MANIFEST_DIR"))
        .output()
        .expect("cargo runs");
    let metadata: serde_json::Value =
        serde_json::from_slice(&output.stdout).expect("cargo writes JSON");
    let packages = metadata["packages"].as_array().expect("a list");
    let ours: BTreeSet<_> = packages
        .iter()
        .filter_map(|package| package["name"].as_str())
        .collect();
    let known: BTreeSet<_> = ALLOWED.iter().map(|(name, _)| *name).collect();
    assert_eq!(
        ours, known,
        "a crate came or went: say here what it may import"
    );
    for package in packages {
        let name = package["name"].as_str().expect("a name");
        let allowed = ALLOWED.iter().find(|(of, _)| *of == name).expect("known").1;
        for dependency in package["dependencies"].as_array().expect("a list") {
            let to = dependency["name"].as_str().expect("a name");
            let of_tests = dependency["kind"].as_str() == Some("dev");
            assert!(
                of_tests || !ours.contains(to) || allowed.contains(&to),
                "{name} imports {to}: it may import {allowed:?} only"
            );
            let meet_in_keys = [("gateway", "dashboard"), ("dashboard", "gateway")];
            assert!(
                !meet_in_keys.contains(&(name, to)),
                "{name} imports {to}, if only for tests: they meet in keys"
            );
            let optional = dependency["optional"].as_bool() == Some(true);
            assert!(
                (name, to) != ("gateway", "emulator") || optional,
                "the gateway needs the emulator for its demo only"
            );
        }
    }
}

#[test]
fn the_oracle_knows_nothing_of_motion() {
    let source = concat!(env!("CARGO_MANIFEST_DIR"), "/../node-firmware/emulator/src");
    let mut files = vec![
        format!("{source}/oracle.rs"),
        format!("{source}/kinematics.rs"),
    ];
    for entry in std::fs::read_dir(format!("{source}/oracle")).expect("its parts are there") {
        let path = entry.expect("an entry").path();
        files.push(path.to_str().expect("a name").to_owned());
    }
    assert!(files.len() > 2);
    for file in files {
        let text = std::fs::read_to_string(&file).expect("the oracle is there");
        let imports = text
            .lines()
            .filter(|line| line.trim_start().starts_with("use "));
        for line in imports {
            let own = line.replace("node_", "");
            assert!(
                !own.contains("motion") && !own.contains("node"),
                "{file}: {line}"
            );
        }
        assert!(
            !text.contains("motion::") && !text.contains("node::"),
            "{file}"
        );
    }
}
