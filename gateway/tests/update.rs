//! `fleet update` and `fleet update-key` against an emulated board with its flash, over real zenoh.
#![cfg(feature = "demo")]

use assert_cmd::Command;
use emulator::{EmulatedHandle, EmulatorConfig, flash::Flash};
use keys::NodeId;
use std::{
    io::{BufRead, BufReader},
    path::Path,
    process::{Child, Stdio},
    time::Duration,
};

/// A gateway in a process of its own, ended with the test.
struct Gateway {
    process: Child,
    connect: String,
    _store: tempfile::TempDir,
}

impl Gateway {
    fn start() -> Self {
        let store = tempfile::tempdir().expect("a directory");
        let mut process = std::process::Command::new(env!("CARGO_BIN_EXE_fleet"))
            .args(["serve", "--listen", "tcp/127.0.0.1:0", "--json", "--store"])
            .arg(store.path().join("fleet.redb"))
            .env("RUST_LOG", "error")
            .stdout(Stdio::piped())
            .spawn()
            .expect("started");
        let mut line = String::new();
        BufReader::new(process.stdout.take().expect("piped"))
            .read_line(&mut line)
            .expect("a line");
        let ready: serde_json::Value = serde_json::from_str(&line).expect("JSON");
        let connect = ready["locators"][0].as_str().expect("text").to_owned();
        Self {
            process,
            connect,
            _store: store,
        }
    }
}

impl Drop for Gateway {
    fn drop(&mut self) {
        // It may have ended by itself, and then the test has failed already.
        let _ = self.process.kill();
        let _ = self.process.wait();
    }
}

fn fleet(line: &[&str]) -> (Option<i32>, String, String) {
    let output = Command::new(env!("CARGO_BIN_EXE_fleet"))
        .args(line)
        .timeout(Duration::from_secs(120))
        .output()
        .expect("started");
    let text = |bytes: Vec<u8>| String::from_utf8(bytes).expect("UTF-8");
    (
        output.status.code(),
        text(output.stdout),
        text(output.stderr),
    )
}

fn image(version: &str) -> Vec<u8> {
    let mut image = vec![0x5a; 40_000];
    image[0] = 0xe9;
    image[32..36].copy_from_slice(&0xabcd_5432_u32.to_le_bytes());
    image[48..80].fill(0);
    image[48..48 + version.len()].copy_from_slice(version.as_bytes());
    image
}

fn path(path: &Path) -> &str {
    path.to_str().expect("UTF-8")
}

fn spawn(gateway: &Gateway, flash: Flash, public: &Path) -> EmulatedHandle {
    let text = std::fs::read_to_string(public).expect("a public key");
    let digits = text.trim().as_bytes();
    let nibble = |byte: u8| (byte as char).to_digit(16).expect("hexadecimal") as u8;
    let key =
        std::array::from_fn(|index| nibble(digits[2 * index]) << 4 | nibble(digits[2 * index + 1]));
    let config = EmulatorConfig {
        connect: gateway.connect.clone(),
        flash: Some(flash),
        update_key: Some(key),
        ..EmulatorConfig::new(NodeId::new("left").expect("legal"))
    };
    emulator::spawn(config).expect("spawned")
}

#[test]
fn a_node_runs_the_signed_image_and_refuses_every_other_one() {
    let files = tempfile::tempdir().expect("a directory");
    let file = |name: &str| files.path().join(name);
    let (key, thief) = (file("update.key"), file("thief.key"));
    for key in [&key, &thief] {
        let (code, out, err) = fleet(&["update-key", path(key)]);
        assert_eq!(code, Some(0), "{err}");
        let secret = std::fs::read_to_string(key).expect("written");
        assert!(!out.contains(secret.trim()), "the secret is not shown");
    }
    let (code, _, err) = fleet(&["update-key", path(&key)]);
    assert_eq!(
        code,
        Some(2),
        "an existing key is never written over: {err}"
    );

    let gateway = Gateway::start();
    let runtime = tokio::runtime::Runtime::new().expect("a runtime");
    let _inside = runtime.enter();
    let flash = Flash::open(&file("flash.bin")).expect("a file");
    let node = spawn(&gateway, flash, &file("update.pub"));
    let update = |line: &[&str]| {
        fleet(&[&["update", "left"], line, &["--connect", &gateway.connect]].concat())
    };
    let (code, out, err) = update(&[]);
    assert_eq!(
        (code, out.trim()),
        (Some(0), "left runs 0.1.0 in slot 0"),
        "{err}"
    );

    let new = file("new.bin");
    std::fs::write(&new, image("2.3.4")).expect("written");
    let (code, _, err) = update(&[path(&new), "--key", path(&thief)]);
    assert_eq!(code, Some(1));
    assert!(err.contains("not signed with the key"), "{err}");
    let elf = file("elf");
    std::fs::write(&elf, b"\x7fELF").expect("written");
    let (code, _, err) = update(&[path(&elf), "--key", path(&key)]);
    assert_eq!(code, Some(2));
    assert!(err.contains("espflash save-image"), "{err}");

    let (code, out, err) = update(&[path(&new), "--key", path(&key), "--json"]);
    assert_eq!(code, Some(0), "{err}");
    let said: serde_json::Value = serde_json::from_str(&out).expect("JSON");
    assert_eq!(said["firmware"], "2.3.4", "{said}");
    assert_eq!(said["before"], "0.1.0", "{said}");
    assert_eq!(said["on_trial"], false, "{said}");
    let _lives = runtime.block_on(node.shutdown());

    // The file has it: another process goes on with what was kept.
    let flash = Flash::open(&file("flash.bin")).expect("a file");
    let node = spawn(&gateway, flash, &file("update.pub"));
    let (code, out, err) = update(&[]);
    assert_eq!(
        (code, out.trim()),
        (Some(0), "left runs 2.3.4 in slot 1"),
        "{err}"
    );
    let _lives = runtime.block_on(node.shutdown());
}
