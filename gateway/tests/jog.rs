//! `fleet jog` as an operator types it: real processes, and a node on the wall clock.

#![cfg(all(unix, feature = "demo"))]

mod program;

use program::Gateway;
use serde_json::Value;
use std::{
    io::{BufRead, BufReader, Lines},
    process::{Child, ChildStdout, Command, Stdio},
    time::{Duration, Instant},
};

/// Far more than anything here takes; only a failure waits so long.
const PATIENCE: Duration = Duration::from_secs(60);

/// A gateway and the node `left`.
struct Desk {
    gateway: Gateway,
    runtime: tokio::runtime::Runtime,
    node: emulator::wall::EmulatedHandle,
}

impl Desk {
    fn new() -> Self {
        let gateway = Gateway::start();
        let runtime = tokio::runtime::Runtime::new().expect("a runtime");
        let _inside = runtime.enter();
        let name = keys::NodeId::new("left").expect("legal");
        let config = emulator::EmulatorConfig {
            connect: gateway.connect.clone(),
            ..emulator::EmulatorConfig::new(name)
        };
        let node = emulator::spawn(config).expect("spawned");
        let desk = Self {
            gateway,
            node,
            runtime,
        };
        desk.until(|node| node["alive"] == true);
        desk
    }

    /// Waits until what is known of the node is so.
    fn until(&self, is_so: impl Fn(&Value) -> bool) -> Value {
        let began = Instant::now();
        loop {
            let ran = self.gateway.fleet(&["nodes", "--json"]);
            let first = ran.out.lines().next();
            let node = first.map(|line| serde_json::from_str(line).expect("JSON"));
            match node {
                Some(node) if is_so(&node) => return node,
                node => assert!(began.elapsed() < PATIENCE, "{node:?}"),
            }
        }
    }

    /// Runs `fleet jog left …`; returns what it says, good or not.
    fn jog(&self, line: &[&str]) -> (Option<i32>, String) {
        let ran = self.gateway.fleet(&[&["jog", "left"], line].concat());
        (ran.code, ran.out + &ran.err)
    }

    fn end(self) {
        let _lives = self.runtime.block_on(self.node.shutdown());
    }
}

/// A `fleet jog … --run` that goes on.
struct Run {
    process: Child,
    lines: Lines<BufReader<ChildStdout>>,
}

impl Run {
    fn start(desk: &Desk, line: &[&str]) -> Self {
        let mut process = Command::new(env!("CARGO_BIN_EXE_fleet"))
            .args(["jog", "left", "--axis", "0", "--json"])
            .args(line)
            .args(["--connect", &desk.gateway.connect])
            .stdout(Stdio::piped())
            .spawn()
            .expect("started");
        let lines = BufReader::new(process.stdout.take().expect("piped")).lines();
        Self { process, lines }
    }

    /// What it says next.
    fn says(&mut self) -> Value {
        let line = self.lines.next().expect("a line").expect("text");
        serde_json::from_str(&line).expect("JSON")
    }

    fn interrupt(&self) {
        let pid = self.process.id().to_string();
        let killed = Command::new("kill").args(["-INT", &pid]).status();
        assert!(killed.expect("there is a kill").success());
    }
}

impl Drop for Run {
    fn drop(&mut self) {
        // It may have ended by itself, and in a good test it has.
        let _ = self.process.kill();
        let _ = self.process.wait();
    }
}

fn rests_at(position: i64) -> impl Fn(&Value) -> bool {
    move |node| node["state"] == "idle" && node["position"][0] == position
}

#[test]
fn an_operator_moves_an_axis_to_a_place_by_steps_and_reads_what_happens() {
    let desk = Desk::new();
    let (code, said) = desk.jog(&["--axis", "0", "--by", "100"]);
    assert_eq!(
        (code, said.as_str()),
        (Some(0), "left, axis 0: moves, from 0\n")
    );
    desk.until(rests_at(100));
    let (code, said) = desk.jog(&["--axis", "0", "--to", "-20", "--speed", "1000"]);
    assert_eq!(
        (code, said.as_str()),
        (Some(0), "left, axis 0: moves, from 100\n")
    );
    desk.until(rests_at(-20));
    for (way, position) in [("+", -19), ("-", -20)] {
        let (code, said) = desk.jog(&["--axis", "0", "--step", way]);
        assert_eq!(code, Some(0), "{said}");
        desk.until(rests_at(position));
    }
    let (code, said) = desk.jog(&["--stop"]);
    assert_eq!((code, said.as_str()), (Some(0), "left: all axes rest\n"));
    for (line, expected, says) in [
        (
            &["--axis", "9", "--by", "1"][..],
            1,
            "refused: bad_command: there is no axis 9",
        ),
        (&["--by", "1"], 2, "--axis <AXIS>"),
        (&["--axis", "0"], 2, "--run <+|->"),
        (&["--axis", "0", "--run", "up"], 2, "+ or -"),
    ] {
        let (code, said) = desk.jog(line);
        assert_eq!(code, Some(expected), "{said}");
        assert!(said.contains(says), "{said}");
    }
    let nobody = desk
        .gateway
        .fleet(&["jog", "right", "--axis", "0", "--by", "1"]);
    assert_eq!(nobody.code, Some(1));
    assert!(
        nobody.err.contains("right does not answer"),
        "{}",
        nobody.err
    );
    desk.end();
}

#[test]
fn a_run_is_renewed_until_ctrl_c_and_a_killed_one_rests_by_its_lease() {
    let desk = Desk::new();
    // The longest lease: only the program's end brings it to rest.
    let mut run = Run::start(&desk, &["--run", "-", "--lease", "10000"]);
    let began = run.says();
    assert_eq!(
        (&began["moving"], &began["lease_ms"]),
        (&true.into(), &10_000.into())
    );
    let renewed = run.says();
    assert_eq!(renewed["jog"], began["jog"]);
    run.interrupt();
    // Renewals may be on their way.
    let stopped = loop {
        let said = run.says();
        if said["jog"].is_null() {
            break said;
        }
    };
    assert!(
        stopped["position"].as_i64() <= renewed["position"].as_i64(),
        "{stopped}"
    );
    let ended = run.process.wait().expect("it ends");
    assert_eq!(ended.code(), Some(0));
    let node = desk.until(|node| node["state"] == "idle");
    assert!(
        node["position"][0].as_i64() <= stopped["position"].as_i64(),
        "{node}"
    );

    let mut run = Run::start(&desk, &["--run", "+"]);
    assert_eq!(run.says()["moving"], true);
    drop(run);
    desk.until(|node| node["state"] == "idle");
    desk.end();
}

#[test]
fn it_is_refused_while_a_job_runs_and_while_the_node_is_stopped() {
    let desk = Desk::new();
    let files = tempfile::tempdir().expect("a folder");
    let long = files.path().join("long.json");
    let text = r#"{"commands":[{"move":{"axis":0,"delay_us":1000,"steps":1000000}}]}"#;
    std::fs::write(&long, text).expect("written");
    let long = long.to_str().expect("UTF-8");
    let ran = desk
        .gateway
        .fleet(&["submit", long, "--node", "left", "--id", "l"]);
    assert_eq!(ran.code, Some(0), "{}", ran.err);
    desk.until(|node| node["state"] == "running");
    let step = ["--axis", "1", "--step", "+"];
    let refused = "fleet: refused: not_allowed: a job runs\n";
    assert_eq!(desk.jog(&step), (Some(1), refused.to_owned()));
    let ran = desk.gateway.fleet(&["stop", "left"]);
    assert_eq!(ran.code, Some(0), "{}", ran.err);
    let refused = "fleet: refused: stopped: the node is stopped; release it first\n";
    assert_eq!(desk.jog(&step), (Some(1), refused.to_owned()));
    let ran = desk.gateway.fleet(&["release", "left"]);
    assert_eq!(ran.code, Some(0), "{}", ran.err);
    let (code, said) = desk.jog(&step);
    assert_eq!(code, Some(0), "{said}");
    desk.until(|node| node["state"] == "idle" && node["position"][1] == 1);

    // A stop ends a run, and who renews it is told.
    let mut run = Run::start(&desk, &["--run", "+"]);
    assert_eq!(run.says()["moving"], true);
    let ran = desk.gateway.fleet(&["stop", "left"]);
    assert_eq!(ran.code, Some(0), "{}", ran.err);
    let ended = run.process.wait().expect("it ends");
    assert_eq!(ended.code(), Some(1));
    desk.end();
}
