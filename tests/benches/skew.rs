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
    process::{Command, Stdio},
    time::Instant,
};
use tests::field::{self, Gateway, PATIENCE, Process, percentile};
use zenoh::Session;

/// Nodes that start together.
const NODES: usize = 8;

fn main() {
    let starts = std::env::args()
        .skip(1)
        .find_map(|argument| argument.parse().ok())
        .unwrap_or(100);
    let store = tempfile::tempdir().expect("a directory");
    let gateway = Gateway::start(&store.path().join("fleet.redb"), None);
    let _nodes: Vec<_> = (1..=NODES)
        .map(|number| emulator(number, &gateway.connect))
        .collect();
    let session = field::open_client(&gateway.connect);
    field::wait_for_nodes(&session, NODES, |node| {
        let error_us = node["clock"]["error_us"].as_f64();
        error_us.is_some_and(|us| us < 2_000.0)
    });

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
        let receipt = field::get(&session, "fleet/group/bench/job", Some(&job));
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

/// Starts a node with a clock of its own: hours apart from the others, tens of ppm fast or slow.
fn emulator(number: usize, connect: &str) -> Process {
    let offset_us = (number as u64 * 3_600_000_000).to_string();
    let drift_ppm = (number as i64 * 20 - 90).to_string();
    let mut command = Command::new(field::binary("emulator"));
    command
        .args(["--name", &format!("node-{number}"), "--connect", connect])
        .args(["--clock-offset-us", &offset_us])
        .args(["--clock-drift-ppm", &drift_ppm])
        .stdout(Stdio::null())
        .stderr(Stdio::null());
    Process::start(&mut command)
}

fn wait_for_end(session: &Session, id: &str) -> Value {
    let since = Instant::now();
    let key = format!("fleet/job/{id}");
    let changes = field::news(session, &key);
    loop {
        let records = field::get(session, &key, None);
        let record = records.first().cloned().unwrap_or_default();
        let state = record["state"].as_str().unwrap_or("");
        if ["succeeded", "failed", "canceled", "timed_out", "rejected"].contains(&state) {
            return record;
        }
        assert!(since.elapsed() < PATIENCE, "{record}");
        let _ = changes.recv_timeout(PATIENCE).expect("an open session");
    }
}
