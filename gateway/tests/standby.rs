//! The hand-over with processes, sockets and one store in a file: the owner is killed by `kill -9`, and
//! the gateway that stood by goes on in the middle of a job.
#![cfg(feature = "demo")]

use emulator::{EmulatedHandle, EmulatorConfig};
use keys::{NodeId, record::to_json};
use serde_json::{Value, json};
use std::{
    io::{BufRead, BufReader},
    path::Path,
    process::{Child, ChildStdout, Command, Stdio},
    time::{Duration, Instant},
};
use zenoh::{Session, Wait, bytes::Encoding};

/// Far more than anything here takes; only a failure waits so long.
const PATIENCE: Duration = Duration::from_secs(60);

/// Steps of one job, one in each command: more commands than a node's queue holds.
const STEPS: usize = 6_000;

/// A gateway that has a store and a network with others.
struct Gateway {
    process: Child,
    out: BufReader<ChildStdout>,
}

impl Drop for Gateway {
    fn drop(&mut self) {
        // It may be gone already.
        let _ = self.process.kill();
        let _ = self.process.wait();
    }
}

impl Gateway {
    fn start(store: &Path, network: &str) -> Self {
        let mut process = Command::new(env!("CARGO_BIN_EXE_fleet"))
            .args([
                "--json",
                "--connect",
                network,
                "serve",
                "--standby",
                "--store",
            ])
            .arg(store)
            .env("RUST_LOG", "error")
            .stdout(Stdio::piped())
            .spawn()
            .expect("started");
        let out = BufReader::new(process.stdout.take().expect("it is piped"));
        let mut gateway = Self { process, out };
        assert_eq!(gateway.says(), json!({"standing_by": true}));
        gateway
    }

    fn says(&mut self) -> Value {
        let mut line = String::new();
        self.out.read_line(&mut line).expect("text");
        serde_json::from_str(&line).expect("JSON in each line")
    }

    /// Waits until it has the fleet.
    fn serving(mut self) -> Self {
        let said = self.says();
        assert_eq!(said["ready"], true, "{said}");
        self
    }
}

fn session(mode: &str, endpoints: &str, address: &str) -> Session {
    let mut config = zenoh::Config::default();
    for (key, value) in [
        ("mode", json!(mode)),
        (endpoints, json!([address])),
        ("scouting/multicast/enabled", json!(false)),
    ] {
        config
            .insert_json5(key, &value.to_string())
            .expect("a known setting");
    }
    zenoh::open(config).wait().expect("opened")
}

fn node(name: &str, address: &str) -> EmulatedHandle {
    let config = EmulatorConfig {
        connect: address.to_owned(),
        ..EmulatorConfig::new(NodeId::new(name).expect("legal"))
    };
    emulator::spawn(config).expect("spawned")
}

/// A job that counts its steps: one more than it has commands if anything is done twice.
fn job(name: &str) -> Value {
    let step = json!({"move": {"axis": 0, "delay_us": 300, "steps": 1}});
    json!({"id": name, "commands": vec![step; STEPS]})
}

fn get(session: &Session, key: &str, payload: Option<&Value>) -> Value {
    let mut query = session.get(key).timeout(PATIENCE);
    if let Some(payload) = payload {
        query = query
            .payload(to_json(payload))
            .encoding(Encoding::APPLICATION_JSON);
    }
    let replies = query.wait().expect("an open session");
    let text = |reply: zenoh::query::Reply| match reply.into_result() {
        Ok(sample) => sample.payload().to_bytes().into_owned(),
        Err(error) => error.payload().to_bytes().into_owned(),
    };
    let reply = replies.into_iter().map(text).next();
    reply
        .and_then(|reply| serde_json::from_slice(&reply).ok())
        .unwrap_or_default()
}

/// Asks, whenever one of these keys has news and at the latest each second, until the answer is as
/// wanted.
fn ask_until(session: &Session, key: &str, is_so: impl Fn(&Value) -> bool) -> Value {
    // One that fills would keep back the answers, which the same thread brings.
    let news = session.declare_subscriber(key);
    let news = news.with(zenoh::handlers::RingChannel::new(1)).wait();
    let news = news.expect("an open session");
    let since = Instant::now();
    loop {
        let answer = get(session, key, None);
        if is_so(&answer) {
            return answer;
        }
        assert!(since.elapsed() < PATIENCE, "{key}: {answer}");
        let _ = news.recv_timeout(Duration::from_secs(1));
    }
}

#[test]
fn the_owner_is_killed_and_the_standby_goes_on_in_the_middle_of_a_job() {
    let port = std::net::TcpListener::bind("127.0.0.1:0")
        .and_then(|listener| listener.local_addr())
        .expect("a free port")
        .port();
    let address = format!("tcp/127.0.0.1:{port}");
    let _router = session("router", "listen/endpoints", &address);
    let folder = tempfile::tempdir().expect("a folder");
    let store = folder.path().join("fleet.redb");
    let owner = Gateway::start(&store, &address).serving();
    let standby = Gateway::start(&store, &address);
    let runtime = tokio::runtime::Runtime::new().expect("a runtime");
    let _inside = runtime.enter();
    let _node = node("left", &address);
    let client = session("client", "connect/endpoints", &address);
    let state = "fleet/node/left/state";
    ask_until(&client, state, |node| node["state"] == "idle");
    for name in ["a", "b"] {
        let receipt = get(&client, "fleet/node/left/job", Some(&job(name)));
        assert_eq!(receipt, json!({"job": name, "state": "queued"}));
    }
    let is_under_way = |record: &Value| record["progress"]["done"].as_u64() > Some(0);
    let before = ask_until(&client, "fleet/job/a", is_under_way);

    // `kill -9`: no farewell.
    drop(owner);
    let next = standby.serving();

    let has_ended = |record: &Value| record["state"] == "succeeded";
    let a = ask_until(&client, "fleet/job/a", has_ended);
    let b = ask_until(&client, "fleet/job/b", has_ended);
    assert!(a["version"].as_u64() > before["version"].as_u64(), "{a}");
    // Every step of both once: none was lost with the owner, none was done for both.
    assert_eq!(a["result"]["position"][0], STEPS, "{a}");
    assert_eq!(b["result"]["position"][0], 2 * STEPS, "{b}");
    // What was accepted by the one is known to the other, and not done again.
    let again = get(&client, "fleet/node/left/job", Some(&job("a")));
    assert_eq!(again["state"], "succeeded", "{again}");

    // And back again.
    let back = Gateway::start(&store, &address);
    drop(next);
    drop(back.serving());
}

#[test]
fn a_gateway_cannot_stand_by_without_a_network_that_outlives_the_other() {
    let output = Command::new(env!("CARGO_BIN_EXE_fleet"))
        .args(["serve", "--standby"])
        .output()
        .expect("started");
    assert_eq!(output.status.code(), Some(2));
    assert!(String::from_utf8_lossy(&output.stderr).contains("--connect"));
}
