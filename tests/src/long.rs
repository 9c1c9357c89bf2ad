//! A fleet that works on a wall clock, as processes: do memory and file descriptors stay flat?
//!
//! Every node gets a job every few seconds; now and then one is stopped and released, a job is
//! canceled, and all nodes of one process lose their power. What the first minutes need is warm-up: the
//! history fills, which is kept so short for this that they are enough ([`KEPT_JOBS`]). [`Growth`] compares
//! the rest.

use crate::{
    Random,
    field::{self, Gateway, Process},
    memory::Usage,
};
use serde_json::json;
use std::{
    fmt,
    path::Path,
    process::Command,
    time::{Duration, Instant},
};
use zenoh::{Session, Wait, qos::CongestionControl};

/// Jobs that have ended and are kept: as many as are done in the first four minutes. With the 10,000 of
/// the default a gateway grows for as long as they take to be done, and that tells nothing.
pub const KEPT_JOBS: usize = 1_000;

/// One look at the processes.
#[derive(Clone, Copy, Debug, Default)]
pub struct Sample {
    /// Since the beginning.
    pub at: Duration,
    /// Jobs handed in so far.
    pub jobs: u64,
    /// Size of the gateway's store, KiB.
    pub store_kib: u64,
    /// The gateway.
    pub gateway: Usage,
    /// The process of the nodes that never lose their power.
    pub nodes: Usage,
}

impl Sample {
    /// The heads of the columns.
    pub const HEADER: &str =
        "minute     jobs   gateway KiB   fds  threads   CPU s   nodes KiB   fds   store KiB";
}

impl fmt::Display for Sample {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(
            f,
            "{:>6.1} {:>8} {:>13} {:>5} {:>8} {:>7.1} {:>11} {:>5} {:>11}",
            self.at.as_secs_f64() / 60.0,
            self.jobs,
            self.gateway.resident_kib,
            self.gateway.descriptors,
            self.gateway.threads,
            self.gateway.processor_ms as f64 / 1e3,
            self.nodes.resident_kib,
            self.nodes.descriptors,
            self.store_kib,
        )
    }
}

/// Lets `count` nodes work for so long, and tells a sample every so often.
///
/// # Panics
/// A part of the fleet ends, or a node is gone at the end.
pub fn run(count: usize, wall: Duration, every: Duration, seed: u64, mut told: impl FnMut(Sample)) {
    let store = tempfile::tempdir().expect("a directory");
    let file = store.path().join("fleet.redb");
    let settings = store.path().join("fleet.toml");
    let text = format!("[store]\nkeep_jobs = {KEPT_JOBS}\n");
    std::fs::write(&settings, text).expect("the directory is ours");
    let mut program = Command::new(field::binary("fleet"));
    program.env("FLEET_CONFIG", &settings);
    let gateway = Gateway::run(program, &file, None);
    let nodes = field::emulators("node", count, &gateway.connect);
    let mut frail = field::emulators("frail", 2, &gateway.connect);
    let client = field::open_client(&gateway.connect);
    field::wait_for_nodes(&client, count + 2, |node| node["alive"] == true);
    let mut random = Random(seed);
    let since = Instant::now();
    let mut jobs = 0;
    let mut next_sample = Duration::ZERO;
    while since.elapsed() < wall {
        if since.elapsed() >= next_sample {
            next_sample += every;
            told(sample(&gateway, &nodes, &file, since, jobs));
        }
        let name = match random.below(count as u64 + 2) {
            number @ 0..2 => format!("frail-{}", number + 1),
            number => format!("node-{}", number - 1),
        };
        match random.below(300) {
            0 => put(&client, &format!("fleet/node/{name}/stop"), ""),
            1 => put(
                &client,
                &format!("fleet/job/job-{}/cancel", jobs.max(1) - 1),
                "",
            ),
            2 => {
                frail.kill();
                frail = field::emulators("frail", 2, &gateway.connect);
            }
            _ => {
                let commands: Vec<_> = (0..40)
                    .map(|index| {
                        let steps = if index % 2 == 0 { 10 } else { -10 };
                        json!({"move": {"axis": index % 4 / 2, "delay_us": 500, "steps": steps}})
                    })
                    .collect();
                let job = json!({"id": format!("job-{jobs}"), "commands": commands}).to_string();
                put(&client, &format!("fleet/node/{name}/job"), &job);
                jobs += 1;
            }
        }
        // What a stop or a lost link has latched.
        if random.below(50) == 0 {
            let _ = field::get(&client, "fleet/node/*/release", None);
        }
        std::thread::sleep(Duration::from_micros(random.below(400_000)));
    }
    told(sample(&gateway, &nodes, &file, since, jobs));
    let _ = field::get(&client, "fleet/node/*/release", None);
    field::wait_for_nodes(&client, count, |node| {
        node["alive"] == true && node["queue"]["depth"] == 0
    });
}

fn put(client: &Session, key: &str, payload: &str) {
    client
        .put(key, payload)
        .congestion_control(CongestionControl::Block)
        .wait()
        .expect("an open session");
}

fn sample(gateway: &Gateway, nodes: &Process, store: &Path, since: Instant, jobs: u64) -> Sample {
    Sample {
        at: since.elapsed(),
        jobs,
        store_kib: std::fs::metadata(store).map_or(0, |file| file.len() / 1_024),
        gateway: gateway.process.usage(),
        nodes: nodes.usage(),
    }
}

/// What grew between a quarter of the time and the end.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Growth {
    /// Resident memory of the gateway, KiB.
    pub gateway_kib: i64,
    /// Its file descriptors.
    pub gateway_descriptors: i64,
    /// Resident memory of the nodes, KiB.
    pub nodes_kib: i64,
    /// Their file descriptors.
    pub nodes_descriptors: i64,
}

impl Growth {
    /// Compares the samples' last quarter with their second, by its mean.
    pub fn of(samples: &[Sample]) -> Self {
        let quarter = samples.len() / 4;
        let early = samples.get(quarter..2 * quarter).unwrap_or(&[]);
        let late = samples.get(samples.len() - quarter..).unwrap_or(&[]);
        let mean = |samples: &[Sample], of: fn(&Sample) -> u64| {
            let sum: u64 = samples.iter().map(of).sum();
            (sum / samples.len().max(1) as u64) as i64
        };
        let grew = |of| mean(late, of) - mean(early, of);
        Self {
            gateway_kib: grew(|sample| sample.gateway.resident_kib),
            gateway_descriptors: grew(|sample| sample.gateway.descriptors),
            nodes_kib: grew(|sample| sample.nodes.resident_kib),
            nodes_descriptors: grew(|sample| sample.nodes.descriptors),
        }
    }
}
