//! An emulated board with its flash: told who it is by `fleet provision` over its serial line, given
//! other firmware by `fleet update` over real zenoh.
#![cfg(all(feature = "demo", unix))]

mod program;

use emulator::{EmulatedHandle, EmulatorConfig, board::EmulatedBoard, flash::Flash};
use keys::NodeId;
use program::{Gateway, Ran, fleet};
use std::{path::Path, time::Duration};

/// Far more than anything here takes; only a failure waits so long.
const PATIENCE: Duration = Duration::from_secs(60);

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

/// What `fleet nodes` says.
fn nodes(gateway: &Gateway) -> (Vec<serde_json::Value>, String) {
    let Ran { out, err, .. } = fleet(&["nodes", "--json", "--connect", &gateway.connect]);
    let lines = out.lines().map(serde_json::from_str);
    let nodes: Vec<serde_json::Value> = lines.collect::<Result<_, _>>().expect("JSON");
    (nodes, err)
}

fn wait_for(gateway: &Gateway, name: &str, alive: bool) {
    let began = std::time::Instant::now();
    loop {
        let (known, err) = nodes(gateway);
        let is_meant = |node: &&serde_json::Value| node["node"] == name;
        if known
            .iter()
            .find(is_meant)
            .is_some_and(|node| node["alive"] == alive)
        {
            return;
        }
        assert!(began.elapsed() < PATIENCE, "{known:?} {err}");
    }
}

/// Where the record lies in a board's flash: `update::layout`.
const RECORD_AT: u64 = 0x61_0000;

/// A bit of the newest record decays: that in this erase unit.
fn decay(flash: &Path, unit: u64) {
    use std::io::{Read, Seek, SeekFrom, Write};

    let open = std::fs::OpenOptions::new()
        .read(true)
        .write(true)
        .open(flash);
    let mut file = open.expect("the flash's file");
    let at = SeekFrom::Start(RECORD_AT + unit * 4_096 + 20);
    let mut byte = [0];
    file.seek(at).expect("inside");
    file.read_exact(&mut byte).expect("read");
    file.seek(at).expect("inside");
    file.write_all(&[byte[0] ^ 4]).expect("written");
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
        let Ran { code, out, err } = fleet(&["update-key", path(key)]);
        assert_eq!(code, Some(0), "{err}");
        let secret = std::fs::read_to_string(key).expect("written");
        assert!(!out.contains(secret.trim()), "the secret is not shown");
    }
    let Ran { code, err, .. } = fleet(&["update-key", path(&key)]);
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
    let Ran { code, out, err } = update(&[]);
    assert_eq!(
        (code, out.trim()),
        (Some(0), "left runs 0.1.0 in slot 0"),
        "{err}"
    );

    let new = file("new.bin");
    std::fs::write(&new, image("2.3.4")).expect("written");
    let Ran { code, err, .. } = update(&[path(&new), "--key", path(&thief)]);
    assert_eq!(code, Some(1));
    assert!(err.contains("not signed with the key"), "{err}");
    let elf = file("elf");
    std::fs::write(&elf, b"\x7fELF").expect("written");
    let Ran { code, err, .. } = update(&[path(&elf), "--key", path(&key)]);
    assert_eq!(code, Some(2));
    assert!(err.contains("espflash save-image"), "{err}");

    let Ran { code, out, err } = update(&[path(&new), "--key", path(&key), "--json"]);
    assert_eq!(code, Some(0), "{err}");
    let said: serde_json::Value = serde_json::from_str(&out).expect("JSON");
    assert_eq!(said["firmware"], "2.3.4", "{said}");
    assert_eq!(said["before"], "0.1.0", "{said}");
    assert_eq!(said["on_trial"], false, "{said}");
    let _lives = runtime.block_on(node.shutdown());

    // The file has it: another process goes on with what was kept.
    let flash = Flash::open(&file("flash.bin")).expect("a file");
    let node = spawn(&gateway, flash, &file("update.pub"));
    let Ran { code, out, err } = update(&[]);
    assert_eq!(
        (code, out.trim()),
        (Some(0), "left runs 2.3.4 in slot 1"),
        "{err}"
    );
    let _lives = runtime.block_on(node.shutdown());
}

#[test]
fn a_board_is_told_who_it_is_over_its_line_and_is_that_node_from_then_on() {
    const SECRET: &str = "correct horse";
    let gateway = Gateway::start();
    let runtime = tokio::runtime::Runtime::new().expect("a runtime");
    let _inside = runtime.enter();
    let files = tempfile::tempdir().expect("a directory");
    let file = |name: &str| files.path().join(name);
    let base = || EmulatorConfig::new(NodeId::new("nobody").expect("legal"));
    let nodes = || nodes(&gateway);
    let wait_for = |name: &str, alive: bool| wait_for(&gateway, name, alive);
    let flash = Flash::open(&file("flash.bin")).expect("a file");
    let board = EmulatedBoard::power_on(flash, base()).expect("a pseudo-terminal");
    // Nobody has told it anything: there is no node that could move.
    let Ran { code, out, err } = fleet(&["provision", board.port()]);
    assert_eq!(code, Some(0), "{err}");
    assert!(out.contains("name        none"), "{out}");
    assert_eq!(nodes().0, Vec::<serde_json::Value>::new());
    let Ran { code, .. } = fleet(&["provision", board.port(), "--name", "left"]);
    assert_eq!(code, Some(1), "without a network it is not complete");

    let secret = file("wifi.txt");
    gateway::security::home::write_secret(&secret, &format!("{SECRET}\n")).expect("written");
    let told = [
        "--name",
        "left",
        "--wifi",
        "shop",
        "--wifi-password-file",
        path(&secret),
        "--router",
        &gateway.connect,
        "--switch",
        "0:min=nc,home",
        "--homing",
        "0:pull-off=50",
        "--restart",
    ];
    let Ran { code, out, err } = fleet(&[&["provision", board.port()], &told[..]].concat());
    assert_eq!(code, Some(0), "{err}");
    assert!(!out.contains(SECRET) && !err.contains(SECRET));
    wait_for("left", true);
    let job = file("job.json");
    // Only the machine that it was told can do that.
    let home = r#"{"home":{"axis":0}}"#;
    let go = r#"{"move":{"axis":0,"delay_us":100,"steps":500}}"#;
    std::fs::write(&job, format!(r#"{{"commands":[{home},{go}]}}"#)).expect("written");
    let play = || {
        let line = ["submit", path(&job), "--node", "left", "--wait"];
        let Ran { code, err, .. } = fleet(&[&line[..], &["--connect", &gateway.connect]].concat());
        assert_eq!(code, Some(0), "{err}");
    };
    play();
    let _lives = runtime.block_on(board.power_off());
    wait_for("left", false);

    // Another day: the flash knows.
    let flash = Flash::open(&file("flash.bin")).expect("a file");
    let board = EmulatedBoard::power_on(flash, base()).expect("a pseudo-terminal");
    wait_for("left", true);
    play();
    let of_left = |node: &serde_json::Value| node["node"] == "left";
    let left = nodes().0.into_iter().find(of_left).expect("it is known");
    assert_eq!(left["position"][0], 550, "homed, and 50 off its switch");
    let Ran { code, out, err } = fleet(&["provision", board.port(), "--json"]);
    assert_eq!(code, Some(0), "{err}");
    let said: serde_json::Value = serde_json::from_str(&out).expect("JSON");
    assert_eq!(said["node"], "left");
    assert!(!out.contains(SECRET), "{out}");
    let _lives = runtime.block_on(board.power_off());
}

#[test]
fn a_board_is_wired_as_it_was_told_and_says_what_has_become_of_its_record() {
    let gateway = Gateway::start();
    let runtime = tokio::runtime::Runtime::new().expect("a runtime");
    let _inside = runtime.enter();
    let files = tempfile::tempdir().expect("a directory");
    let file = |name: &str| files.path().join(name);
    let power_on = || {
        let flash = Flash::open(&file("flash.bin")).expect("a file");
        let base = EmulatorConfig::new(NodeId::new("nobody").expect("legal"));
        EmulatedBoard::power_on(flash, base).expect("a pseudo-terminal")
    };
    let tell = |board: &EmulatedBoard, line: &[&str]| {
        let Ran { code, out, err } = fleet(&[&["provision", board.port()], line].concat());
        (code, out, err)
    };
    let board = power_on();
    let who = [
        "--name",
        "left",
        "--wifi",
        "any",
        "--router",
        &gateway.connect,
    ];
    let (code, _, err) = tell(
        &board,
        &[&who[..], &["--axes", "4", "--pin", "3:dir=36"]].concat(),
    );
    assert_eq!(code, Some(1));
    let why = "GPIO 36 cannot be 3:dir: the module's octal PSRAM is there";
    assert!(err.contains(why), "{err}");
    let wired = ["--axes", "4", "--pin", "3:dir=13,0:enable=14", "--restart"];
    let (code, out, err) = tell(&board, &[&who[..], &wired].concat());
    assert_eq!(code, Some(0), "{err}");
    assert!(
        out.contains("axes        4\n") && out.contains(" 3:dir=13"),
        "{out}"
    );
    wait_for(&gateway, "left", true);
    let job = file("job.json");
    let go = r#"{"commands":[{"move":{"axis":3,"delay_us":100,"steps":500}}]}"#;
    std::fs::write(&job, go).expect("written");
    let line = ["submit", path(&job), "--node", "left", "--wait"];
    let Ran { code, err, .. } = fleet(&[&line[..], &["--connect", &gateway.connect]].concat());
    assert_eq!(code, Some(0), "{err}");
    let of_left = |node: &serde_json::Value| node["node"] == "left";
    let left = || nodes(&gateway).0.into_iter().find(of_left).expect("known");
    assert_eq!(left()["position"], serde_json::json!([0, 0, 0, 500]));

    // Told of a machine, and that decays: the record before is the same node.
    let (code, _, err) = tell(&board, &["--lidar"]);
    assert_eq!(code, Some(0), "{err}");
    let _lives = runtime.block_on(board.power_off());
    wait_for(&gateway, "left", false);
    decay(&file("flash.bin"), 1);
    let board = power_on();
    wait_for(&gateway, "left", true);
    let said = left().to_string();
    assert!(said.contains("stored configuration damaged"), "{said}");
    assert_ne!(left()["stopped"], serde_json::Value::Null, "{said}");
    let Ran { code, err, .. } = fleet(&["release", "left", "--connect", &gateway.connect]);
    assert_eq!(code, Some(0), "{err}");
    let Ran { code, err, .. } = fleet(&[&line[..], &["--connect", &gateway.connect]].concat());
    assert_eq!(code, Some(0), "somebody has looked: {err}");
    let (_, out, _) = tell(&board, &[]);
    assert!(
        out.contains("record      damaged: the one before is used"),
        "{out}"
    );

    // Told of a signer, and that decays: the record before would believe anybody.
    let signers = file("signers");
    std::fs::write(&signers, format!("alice {}\n", "ab".repeat(32))).expect("written");
    let (code, _, err) = tell(&board, &["--signers", path(&signers)]);
    assert_eq!(code, Some(0), "{err}");
    let _lives = runtime.block_on(board.power_off());
    wait_for(&gateway, "left", false);
    decay(&file("flash.bin"), 1);
    let board = power_on();
    let (_, out, _) = tell(&board, &[]);
    assert!(
        out.contains("record      damaged: the node does nothing"),
        "{out}"
    );
    assert!(out.contains("name        none"), "{out}");
    assert_eq!(left()["alive"], false);
    let (code, _, err) = tell(&board, &[&who[..], &["--restart"]].concat());
    assert_eq!(code, Some(0), "{err}");
    wait_for(&gateway, "left", true);
    let _lives = runtime.block_on(board.power_off());
}
