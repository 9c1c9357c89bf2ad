//! `fleet provision` end to end: the program on one end of a pseudo-terminal, the node's side of
//! the dialogue with a flash in memory on the other.
#![cfg(unix)]

use assert_cmd::Command;
use embedded_storage::nor_flash::{ErrorType, NorFlash, NorFlashErrorKind, ReadNorFlash};
use gateway::security::{
    Home, Role,
    home::{read_secret, write_secret},
};
use keys::{NodeId, credentials::Credentials};
use provision::{Dialogue, Record, Store, frame::FRAME_BYTES_MAX};
use serialport::{SerialPort, TTYPort};
use std::{
    io::{ErrorKind, Read, Write},
    sync::{
        Arc,
        atomic::{AtomicBool, Ordering},
    },
    thread::JoinHandle,
    time::Duration,
};

struct Flash(Vec<u8>);

impl ErrorType for Flash {
    type Error = NorFlashErrorKind;
}

impl ReadNorFlash for Flash {
    const READ_SIZE: usize = 4;

    fn read(&mut self, offset: u32, bytes: &mut [u8]) -> Result<(), NorFlashErrorKind> {
        bytes.copy_from_slice(&self.0[offset as usize..][..bytes.len()]);
        Ok(())
    }

    fn capacity(&self) -> usize {
        self.0.len()
    }
}

impl NorFlash for Flash {
    const WRITE_SIZE: usize = 4;
    const ERASE_SIZE: usize = 4096;

    fn erase(&mut self, from: u32, to: u32) -> Result<(), NorFlashErrorKind> {
        self.0[from as usize..to as usize].fill(0xff);
        Ok(())
    }

    fn write(&mut self, offset: u32, bytes: &[u8]) -> Result<(), NorFlashErrorKind> {
        for (to, from) in self.0[offset as usize..].iter_mut().zip(bytes) {
            *to &= from;
        }
        Ok(())
    }
}

/// A node on a line, until it is dropped.
struct Board {
    port: String,
    quit: Arc<AtomicBool>,
    node: JoinHandle<(Record, bool)>,
    /// Keeps the line from hanging up between two programs.
    _line: TTYPort,
}

impl Board {
    fn new(moves: bool) -> Self {
        let (mut master, line) = TTYPort::pair().expect("a pseudo-terminal");
        let port = line.name().expect("it has a path");
        master
            .set_timeout(Duration::from_millis(5))
            .expect("has a timeout");
        let quit = Arc::new(AtomicBool::new(false));
        let until = quit.clone();
        let node = std::thread::spawn(move || {
            let store = Store::new(Flash(vec![0xff; 8192])).expect("room");
            let mut dialogue = Dialogue::new(store, [0, 1, 0]).expect("readable");
            while !until.load(Ordering::Relaxed) {
                let mut bytes = [0; 64];
                let count = match master.read(&mut bytes) {
                    Ok(count) => count,
                    Err(error) if error.kind() == ErrorKind::TimedOut => continue,
                    Err(error) => panic!("{error}"),
                };
                let mut answer = [0; FRAME_BYTES_MAX + 2];
                for byte in &bytes[..count] {
                    if let Some(used) = dialogue.handle_byte(*byte, !moves, &mut answer) {
                        master.write_all(b"wifi: no connection\r\n").expect("sent");
                        master.write_all(&answer[..used]).expect("sent");
                    }
                }
            }
            let restart = dialogue.wants_restart();
            let mut store = dialogue.into_store();
            (store.read().expect("readable").unwrap_or_default(), restart)
        });
        Self {
            port,
            quit,
            node,
            _line: line,
        }
    }

    fn fleet(&self, line: &[&str]) -> (Option<i32>, String, String) {
        let output = Command::new(env!("CARGO_BIN_EXE_fleet"))
            .arg("provision")
            .arg(&self.port)
            .args(line)
            .timeout(Duration::from_secs(60))
            .output()
            .expect("started");
        let text = |bytes: Vec<u8>| String::from_utf8(bytes).expect("UTF-8");
        (
            output.status.code(),
            text(output.stdout),
            text(output.stderr),
        )
    }

    fn end(self) -> (Record, bool) {
        self.quit.store(true, Ordering::Relaxed);
        self.node.join().expect("it did not panic")
    }
}

#[test]
fn a_node_is_told_its_name_network_and_router_and_says_no_secret() {
    let board = Board::new(false);
    let files = tempfile::tempdir().expect("a folder");
    let password = files.path().join("wifi");
    write_secret(&password, "correct horse\n").expect("written");
    let password = password.to_str().expect("a path");
    let (code, out, err) = board.fleet(&[
        "--name",
        "left",
        "--wifi",
        "shop",
        "--wifi-password-file",
        password,
        "--router",
        "tcp/10.0.0.1:7447",
        "--user",
        "left",
        "--password-file",
        password,
        "--restart",
    ]);
    assert_eq!((code, err.as_str()), (Some(0), ""));
    assert!(out.contains("name        left") && out.contains("networks    shop"));
    assert!(!out.contains("horse"));
    let (code, out, _) = board.fleet(&["--json"]);
    assert_eq!(code, Some(0));
    let shown: serde_json::Value = serde_json::from_str(&out).expect("JSON");
    assert_eq!(shown["node"], "left");
    assert_eq!(shown["login"], true);
    let (record, restart) = board.end();
    assert_eq!(record.networks[0].password, "correct horse");
    assert_eq!(record.router, "tcp/10.0.0.1:7447");
    assert!(restart);
}

#[test]
fn a_node_of_a_secured_fleet_is_told_the_file_that_was_made_for_it() {
    let board = Board::new(false);
    let folder = tempfile::tempdir().expect("a folder");
    let mut home = Home::init(&folder.path().join("home"), &[]).expect("made");
    let left = NodeId::new("left").expect("legal");
    home.add(left, Role::Node).expect("added");
    let file = folder.path().join("home/left.json");
    let path = file.to_str().expect("a path");
    let text = read_secret(&file).expect("private");
    let made = Credentials::from_json(&text).expect("credentials");
    let (code, _, err) = board.fleet(&["--name", "left", "--wifi", "shop", "--login", path]);
    assert_eq!((code, err.as_str()), (Some(0), ""));
    let both = ["--login", path, "--user", "left", "--password-file", path];
    assert_eq!(board.fleet(&both).0, Some(2));
    let (code, _, err) = board.fleet(&["--login", "/dev/null"]);
    assert_eq!(code, Some(2), "{err}");
    let (record, _) = board.end();
    let login = record.login.expect("it was told");
    assert_eq!(login.user, "left");
    assert_eq!(login.password, made.password.as_str());
}

#[test]
fn a_boot_script_is_allowed_and_forbidden_and_signers_are_told_by_their_list() {
    let board = Board::new(false);
    let files = tempfile::tempdir().expect("a folder");
    let list = files.path().join("signers");
    std::fs::write(&list, format!("# who\nalice {}\n", "ab".repeat(32))).expect("written");
    let list = list.to_str().expect("a path");
    let shown = |line: &[&str]| {
        let (code, out, err) = board.fleet(&[line, &["--json"]].concat());
        assert_eq!((code, err.as_str()), (Some(0), ""), "{line:?}");
        let shown: serde_json::Value = serde_json::from_str(&out).expect("JSON");
        (shown["boot_script"].clone(), shown["signers"].clone())
    };
    let none = serde_json::json!([]);
    let first = shown(&["--name", "left", "--wifi", "shop"]);
    assert_eq!(
        first,
        (false.into(), none.clone()),
        "nothing is allowed unasked"
    );
    let alice = serde_json::json!(["abababab"]);
    let told = shown(&["--boot-script", "--signers", list]);
    assert_eq!(told, (true.into(), alice.clone()));
    assert_eq!(shown(&["--boot-script=no"]), (false.into(), alice));
    assert_eq!(shown(&["--no-signers"]), (false.into(), none));
    let (_, out, _) = board.fleet(&["--signers", list]);
    assert!(
        out.contains("boot script no\nsigners     abababab…"),
        "{out}"
    );
    std::fs::write(list, "alice 00").expect("written");
    let (code, _, err) = board.fleet(&["--signers", list]);
    assert_eq!(code, Some(2));
    assert!(err.contains("signers: line 1: not 64"), "{err}");
    let (record, _) = board.end();
    assert_eq!(record.signers, [[0xab; 32]]);
}

#[test]
fn whom_to_trust_is_told_with_a_router_by_tls_and_not_without() {
    let board = Board::new(false);
    let files = tempfile::tempdir().expect("a folder");
    let home = gateway::security::Home::init(&files.path().join("home"), &[]).expect("made");
    let ca = files.path().join("home/ca.pem");
    let ca = ca.to_str().expect("a path");
    let (code, _, err) = board.fleet(&[
        "--name",
        "left",
        "--wifi",
        "shop",
        "--router",
        "tls/plant:7447",
    ]);
    assert_eq!(code, Some(1));
    assert!(err.contains("needs an authority to trust (--ca)"), "{err}");
    let (code, _, err) = board.fleet(&[
        "--ca",
        files.path().join("no.pem").to_str().expect("a path"),
    ]);
    assert_eq!(code, Some(2));
    assert!(err.contains("--ca"), "{err}");
    let key = files.path().join("home/ca.key");
    let (code, _, err) = board.fleet(&["--ca", key.to_str().expect("a path")]);
    assert_eq!(code, Some(2));
    assert!(err.contains("no certificate in it"), "{err}");
    let all = [
        "--name",
        "left",
        "--wifi",
        "shop",
        "--router",
        "tls/plant:7447",
        "--ca",
        ca,
        "--json",
    ];
    let (code, out, err) = board.fleet(&all);
    assert_eq!((code, err.as_str()), (Some(0), ""));
    let shown: serde_json::Value = serde_json::from_str(&out).expect("JSON");
    assert_eq!(shown["tls"], true);
    // Back to plain TCP: both have to be said.
    let (code, _, err) = board.fleet(&["--router", "tcp/plant:7448"]);
    assert_eq!(code, Some(1));
    assert!(err.contains("needs an authority"), "{err}");
    let (code, out, _) = board.fleet(&["--router", "tcp/plant:7448", "--no-ca"]);
    assert_eq!(code, Some(0));
    assert!(out.contains("tls         no: plain TCP"), "{out}");
    board.fleet(&all);
    let (record, _) = board.end();
    let kept = record.authority.expect("told");
    let pem = home.gateway().ca.expect("it has one");
    let authority = tls::Authority::from_pem(pem.as_bytes()).expect("an authority");
    let again = tls::Authority::from_parts(&kept.subject, &kept.key);
    assert_eq!(again, Ok(authority));
}

#[test]
fn refusals_have_words_and_change_nothing() {
    let board = Board::new(false);
    let (code, _, err) = board.fleet(&["--name", "left"]);
    assert_eq!(code, Some(1));
    assert!(err.contains("a name and a WiFi network"), "{err}");
    let (code, _, err) = board.fleet(&["--router", "udp/1"]);
    assert_eq!(code, Some(1));
    assert!(err.contains("Router"), "{err}");
    let (code, _, err) = board.fleet(&["--name", "Left"]);
    assert_eq!(code, Some(2));
    assert!(err.contains("--name"), "{err}");
    let (record, _) = board.end();
    assert_eq!(record, Record::default());

    let board = Board::new(true);
    let (code, _, err) = board.fleet(&["--name", "left", "--wifi", "shop"]);
    assert_eq!(code, Some(1));
    assert!(err.contains("the node moves"), "{err}");
    board.end();
}

#[test]
fn a_port_that_is_not_there_is_said_to_be_missing() {
    let output = Command::new(env!("CARGO_BIN_EXE_fleet"))
        .args(["provision", "/dev/no-such-port"])
        .output()
        .expect("started");
    assert_eq!(output.status.code(), Some(3));
    let words = String::from_utf8(output.stderr).expect("UTF-8");
    assert!(words.contains("/dev/no-such-port"), "{words}");
}

#[test]
fn what_is_connected_to_a_node_is_told_and_shown_and_forgotten() {
    let board = Board::new(false);
    let shown = |line: &[&str]| {
        let (code, out, err) = board.fleet(&[line, &["--json"]].concat());
        assert_eq!(code, Some(0), "{err}");
        let shown: serde_json::Value = serde_json::from_str(&out).expect("JSON");
        serde_json::json!([shown["switches"], shown["cd"], shown["lidar"]])
    };
    let name = ["--name", "left", "--wifi", "shop"];
    assert_eq!(shown(&name), serde_json::json!([[], false, false]));
    let told = [
        "--switch",
        "0:min=nc,home",
        "--switch",
        "probe=no",
        "--switch",
        "d:max=nc",
        "--cd",
        "--lidar",
    ];
    let switches = serde_json::json!(["0:min=nc,home", "probe=no", "d:max=nc"]);
    assert_eq!(shown(&told), serde_json::json!([switches, true, true]));
    let again = shown(&["--switch", "probe=nc", "--lidar=no"]);
    let switches = serde_json::json!(["0:min=nc,home", "probe=nc", "d:max=nc"]);
    assert_eq!(again, serde_json::json!([switches, true, false]));
    for wrong in [
        "0:min",
        "9:min=no",
        "c:home=no",
        "d:min=nc,home",
        "x:min=no",
        "probe=yes",
    ] {
        let (code, _, err) = board.fleet(&["--switch", wrong]);
        assert_eq!(code, Some(2), "{wrong}");
        assert!(err.contains("OF:END=KIND") && err.contains(wrong), "{err}");
    }
    let (_, out, _) = board.fleet(&["--no-switches", "--cd=no"]);
    assert!(out.contains("switches    none\nC and D     no\n"), "{out}");
    let (record, _) = board.end();
    assert_eq!(record.machine, provision::Machine::default());
}

#[test]
fn how_a_machine_moves_is_told_and_shown_as_it_was_given_and_refused_with_words() {
    let board = Board::new(false);
    let (code, out, err) = board.fleet(&["--name", "left", "--wifi", "shop"]);
    assert_eq!(code, Some(0), "{err}");
    assert!(out.ends_with("lidar       no\n"), "nothing differs: {out}");
    let told = [
        "--homing",
        "1:seek=800,approach=100",
        "--soft-limits",
        "0:-100..20000",
        "--filter",
        "0:min=100/9000",
        "--c-places",
        "160:0@10,1@20,2@20,3.5@20,40@10",
        "--d-way",
        "80:5@2.5",
    ];
    let (code, out, err) = board.fleet(&told);
    assert_eq!(code, Some(0), "{err}");
    let lines = "homing      1:seek=800,approach=100,accel=50000,travel=200000,pull-off=200
soft limits 0:-100..20000
filter      0:min=100/9000
C places    160:0@10,1@20,2@20,3.5@20,40@10
D way       80:5@2.5
";
    assert!(out.ends_with(lines), "{out}");
    for (option, wrong, words) in [
        ("--homing", "0:seek=100,approach=500", "approach no faster"),
        ("--homing", "9:seek=100,approach=50", "Homing"),
        ("--soft-limits", "0:5..5", "nothing between"),
        ("--filter", "c:home=1/1", "Filter"),
        ("--filter", "0:min=1/999999", "too long"),
        (
            "--c-places",
            "80:0@10,1@20,1@20,3@20,4@10",
            "above the one before",
        ),
        ("--d-way", "80:0@1", "Way of D"),
    ] {
        let (code, _, err) = board.fleet(&[option, wrong]);
        assert_eq!(code, Some(1), "{wrong}");
        assert!(err.contains(words), "{err}");
    }
    let (code, _, err) = board.fleet(&["--d-way", "80"]);
    assert_eq!(code, Some(2), "{err}");
    let (_, out, _) = board.fleet(&[]);
    assert!(out.ends_with(lines), "nothing was changed: {out}");
    let (_, out, _) = board.fleet(&["--no-tuning"]);
    assert!(out.ends_with("lidar       no\n"), "{out}");
    let (record, _) = board.end();
    assert_eq!(record.tuning, provision::Tuning::default());
}

#[test]
fn the_driver_of_an_axis_is_told_by_name_or_number_and_shown_as_it_was_given() {
    let board = Board::new(false);
    let (code, out, err) = board.fleet(&["--name", "left", "--wifi", "shop"]);
    assert_eq!(code, Some(0), "{err}");
    assert!(!out.contains("driver"), "{out}");
    let told = [
        "--driver",
        "0=tmc2209",
        "--driver",
        "1=drv8825,setup=1000,inverted",
    ];
    let (code, out, err) = board.fleet(&told);
    assert_eq!(code, Some(0), "{err}");
    let lines = "driver      0=tmc2209\ndriver      1=drv8825,setup=1000,inverted\n";
    assert!(out.ends_with(lines), "{out}");
    let (code, _, err) = board.fleet(&["--driver", "0=tmc2209,setup=200001"]);
    assert_eq!(code, Some(1), "{err}");
    assert!(err.contains("Driver: a step's parts"), "{err}");
    let (code, _, err) = board.fleet(&["--driver", "0=tmc9999"]);
    assert_eq!(code, Some(2), "{err}");
    assert!(err.contains("AXIS=DRIVER"), "{err}");
    let (_, out, _) = board.fleet(&[]);
    assert!(out.ends_with(lines), "nothing was changed: {out}");
    let (record, _) = board.end();
    let axes = provision::kit::motion_of(&record, 2).axes;
    assert_eq!((axes[0].high_ns_min, axes[0].dir_hold_ns), (100, 20));
    assert_eq!((axes[1].dir_setup_ns, axes[1].dir_hold_ns), (1_000, 650));
    assert!(!axes[0].direction_inverted && axes[1].direction_inverted);
}

#[test]
fn axes_and_pins_are_told_and_shown_and_one_that_cannot_be_is_named_with_the_reason() {
    let board = Board::new(false);
    let (code, out, err) = board.fleet(&["--name", "left", "--wifi", "shop"]);
    assert_eq!(code, Some(0), "{err}");
    assert!(!out.contains("pins"), "as the kit has them: {out}");
    let told = [
        "--axes",
        "4",
        "--pin",
        "2:step=9,2:dir=12",
        "--pin",
        "lamp=none",
    ];
    let (code, out, err) = board.fleet(&told);
    assert_eq!(code, Some(0), "{err}");
    let lines = "axes        4
pins        0:step=4 0:dir=5 1:step=6 1:dir=7 2:step=9 2:dir=12 3:step=21
pins        3:dir=47 enable=15 laser=11 stop=10 lamp=none
";
    assert!(out.ends_with(lines), "{out}");
    for (line, words) in [
        (
            &["--pin", "3:step=33"][..],
            "GPIO 33 cannot be 3:step: the module's octal PSRAM is there",
        ),
        (
            &["--pin", "3:step=20"],
            "GPIO 20 cannot be 3:step: USB is there",
        ),
        (
            &["--pin", "laser=18"],
            "GPIO 18 cannot be laser: it is driven high for 60 µs at power on",
        ),
        (
            &["--pin", "3:step=4"],
            "GPIO 4 cannot be 3:step: it is 0:step",
        ),
        (
            &["--switch", "c:min=nc", "--pin", "c:min=21"],
            "GPIO 21 cannot be c:min: it is 3:step",
        ),
        (&["--switch", "2:min=nc"], "2:min: it has no pin (--pin)"),
        (
            &["--axes", "2"],
            "GPIO 9 cannot be 2:step: there are 2 axes",
        ),
        (&["--pin", "stop=none"], "there can be no such pin"),
    ] {
        let (code, _, err) = board.fleet(line);
        assert_eq!(code, Some(1), "{line:?}");
        assert!(err.contains(words), "{err}");
    }
    for line in [["--axes", "5"], ["--pin", "4:step=1"], ["--pin", "laser"]] {
        let (code, _, err) = board.fleet(&line);
        assert_eq!(code, Some(2), "{line:?} {err}");
    }
    let (_, out, _) = board.fleet(&[]);
    assert!(out.ends_with(lines), "nothing was changed: {out}");
    let (code, out, err) = board.fleet(&["--no-pins", "--axes", "0"]);
    assert_eq!(code, Some(0), "{err}");
    assert!(!out.contains("pins"), "{out}");
    let (record, _) = board.end();
    assert_eq!(record.wiring, provision::Wiring::default());
}
