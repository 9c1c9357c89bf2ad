//! How far synchronized starts are apart on this machine: a gateway and eight emulated nodes, each a
//! process of its own, over real TCP, under the load of their own jobs. The figures are those of the
//! records, as measured by the nodes.
//!
//! ```sh
//! cargo bench -p tests --bench skew             # 100 starts
//! cargo bench -p tests --bench skew -- 1000
//! ```

use serde_json::{Value, json};
use std::{
    path::PathBuf,
    process::{Child, Command, Stdio},
    time::{Duration, Instant},
};
use zenoh::{Config, Session, Wait};

/// Nodes that start together.
const NODES: usize = 8;

/// Far more than a step of this program takes.
const PATIENCE: Duration = Duration::from_secs(60);

/// A child that does not outlive the program.
struct Process(Child);

impl Drop for Process {
    fn drop(&mut self) {
        // It may be gone already.
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

fn main() {
    let starts = std::env::args()
        .skip(1)
        .find_map(|argument| argument.parse().ok())
        .unwrap_or(100);
    let store = tempfile::tempdir().expect("a directory");
    let port = std::net::TcpListener::bind("127.0.0.1:0")
        .and_then(|listener| listener.local_addr())
        .expect("a free port")
        .port();
    let connect = format!("tcp/127.0.0.1:{port}");
    let file = store.path().join("fleet.redb");
    let file = file.to_str().expect("text");
    let serve = ["serve", "--store", file, "--listen", connect.as_str()];
    let _gateway = run("gateway", "fleet", &serve);
    let _nodes: Vec<_> = (1..=NODES)
        .map(|number| {
            // Clocks of their own: hours apart, tens of ppm fast or slow.
            let offset_us = (number as u64 * 3_600_000_000).to_string();
            let drift_ppm = (number as i64 * 20 - 90).to_string();
            let name = format!("node-{number}");
            let arguments = [
                "--name",
                &name,
                "--connect",
                &connect,
                "--clock-offset-us",
                &offset_us,
                "--clock-drift-ppm",
                &drift_ppm,
            ];
            run("emulator", "emulator", &arguments)
        })
        .collect();
    let session = open(&connect);
    wait_for_clocks(&session);

    // 200 short moves on each node: batches, acks and statuses travel while clocks are probed.
    let moves: Vec<_> = (0..200)
        .map(|index| json!({"move": {"axis": index % 2, "delay_us": 100, "steps": 10}}))
        .collect();
    let parts: serde_json::Map<_, _> = (1..=NODES)
        .map(|number| (format!("node-{number}"), json!({"commands": moves})))
        .collect();
    let (mut skews_us, mut claims_us, mut failed) = (Vec::new(), Vec::new(), 0);
    for number in 0..starts {
        let id = format!("start-{number}");
        let job = json!({"id": id, "nodes": parts, "max_skew_us": 5_000});
        let receipt = get(&session, "fleet/group/bench/job", Some(&job));
        assert_eq!(
            receipt.first().map(|answer| &answer["state"]),
            Some(&json!("queued")),
            "{receipt:?}"
        );
        let record = wait_for_end(&session, &id);
        let start = &record["start"];
        match (record["state"].as_str(), start["skew_us"].as_f64()) {
            (Some("succeeded"), Some(skew_us)) => {
                skews_us.push(skew_us);
                claims_us.push(start["uncertainty_us"].as_f64().expect("a number"));
            }
            _ => {
                failed += 1;
                eprintln!("{record}");
            }
        }
    }
    skews_us.sort_by(f64::total_cmp);
    claims_us.sort_by(f64::total_cmp);
    println!("{starts} starts of {NODES} nodes, {failed} failed");
    println!("                     p50      p95      p99      max");
    for (name, sorted) in [("skew, µs", &skews_us), ("uncertainty, µs", &claims_us)] {
        print!("{name:<16}");
        for share in [0.5, 0.95, 0.99, 1.0] {
            print!(" {:>8.1}", percentile(sorted, share));
        }
        println!();
    }
}

fn percentile(sorted: &[f64], share: f64) -> f64 {
    let last = sorted.len().saturating_sub(1);
    sorted
        .get((last as f64 * share) as usize)
        .copied()
        .unwrap_or(f64::NAN)
}

/// Starts one of our binaries, built if it is not there.
fn run(package: &str, name: &str, arguments: &[&str]) -> Process {
    let path = binary(name);
    if !path.exists() {
        let status = Command::new(env!("CARGO"))
            .args(["build", "--release", "--package", package])
            .status()
            .expect("cargo runs");
        assert!(status.success(), "{package} must build");
    }
    let child = Command::new(&path)
        .args(arguments)
        .stdout(Stdio::null())
        .stderr(Stdio::null())
        .spawn();
    Process(child.unwrap_or_else(|error| panic!("{}: {error}", path.display())))
}

/// This program lies in `release/deps`, ours in `release`.
fn binary(name: &str) -> PathBuf {
    let mut path = std::env::current_exe().expect("it has a path");
    path.pop();
    path.pop();
    path.join(name)
}

fn open(connect: &str) -> Session {
    let since = Instant::now();
    loop {
        let mut config = Config::default();
        for (key, value) in [
            ("mode", "\"client\"".to_owned()),
            ("connect/endpoints", format!("[\"{connect}\"]")),
            ("scouting/multicast/enabled", "false".to_owned()),
        ] {
            config.insert_json5(key, &value).expect("a known setting");
        }
        match zenoh::open(config).wait() {
            Ok(session) => return session,
            Err(error) => assert!(since.elapsed() < PATIENCE, "{error}"),
        }
    }
}

fn get(session: &Session, key: &str, payload: Option<&Value>) -> Vec<Value> {
    let mut query = session.get(key);
    if let Some(payload) = payload {
        query = query
            .payload(payload.to_string())
            .encoding(zenoh::bytes::Encoding::APPLICATION_JSON);
    }
    let replies = query.wait().expect("an open session");
    let text = |reply: zenoh::query::Reply| match reply.into_result() {
        Ok(sample) => sample.payload().to_bytes().into_owned(),
        Err(error) => error.payload().to_bytes().into_owned(),
    };
    let json = |bytes: Vec<u8>| serde_json::from_slice(&bytes).expect("JSON");
    replies.into_iter().map(text).map(json).collect()
}

fn wait_for_clocks(session: &Session) {
    let since = Instant::now();
    let changes = session.declare_subscriber("fleet/node/*/state").wait();
    let changes = changes.expect("an open session");
    loop {
        let nodes = get(session, "fleet/node/*/state", None);
        let known = |node: &&Value| {
            node["clock"]["error_us"]
                .as_f64()
                .is_some_and(|us| us < 2_000.0)
        };
        if nodes.iter().filter(known).count() == NODES {
            return;
        }
        assert!(since.elapsed() < PATIENCE, "{nodes:?}");
        let _ = changes.recv_timeout(PATIENCE).expect("an open session");
    }
}

fn wait_for_end(session: &Session, id: &str) -> Value {
    let since = Instant::now();
    let key = format!("fleet/job/{id}");
    let changes = session.declare_subscriber(&key).wait();
    let changes = changes.expect("an open session");
    loop {
        let records = get(session, &key, None);
        let record = records.first().cloned().unwrap_or_default();
        let state = record["state"].as_str().unwrap_or("");
        if ["succeeded", "failed", "canceled", "timed_out", "rejected"].contains(&state) {
            return record;
        }
        assert!(since.elapsed() < PATIENCE, "{record}");
        let _ = changes.recv_timeout(PATIENCE).expect("an open session");
    }
}
