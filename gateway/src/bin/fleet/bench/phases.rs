//! What is measured.

use super::{
    Figures,
    field::{Field, boot},
};
use crate::link::{Failure, Link, read};
use anyhow::anyhow;
use emulator::{EmulatedHandle, Recording, pins::Pin};
use keys::{
    LocalMicros, NodeId, NodeState, NodeTopic, Status, Stop, StopMode, Topic,
    record::{JobRecord, JobState},
    version,
};
use serde_json::json;
use std::{
    collections::{BTreeSet, HashSet},
    sync::{
        Arc, Mutex, PoisonError,
        atomic::{AtomicU64, Ordering},
    },
    time::{Duration, Instant},
};
use zenoh::bytes::Encoding;

/// Jobs that are on their way to the gateway at the same time.
const CLIENTS: usize = 64;

/// Commands of all jobs of [`batches`] together: ten times what the rings of a hundred nodes hold, so
/// that credit and not the first burst is measured.
const COMMANDS: usize = 4_000_000;

/// Most commands of one of these jobs.
const COMMANDS_EACH_MAX: usize = 50_000;

/// Largest fleet for which the first pulse is measured.
pub(super) const PULSE_NODES_MAX: usize = 100;

/// Nodes that start together.
const GROUP: usize = 100;

/// Longest wait for what takes seconds.
const PATIENCE: Duration = Duration::from_secs(60);

/// Ticks of the pulse hardware in a microsecond.
const TICKS_PER_US: u64 = 16;

/// Hands a job in and waits until it is accepted.
async fn submit(link: &Link, key: &str, job: &serde_json::Value) -> Result<(), Failure> {
    let payload = (job.to_string().into_bytes(), Encoding::APPLICATION_JSON);
    let answers = link.get(key, Some(payload)).await?;
    if answers.is_empty() {
        return Err(anyhow!("{key}: nobody answers").into());
    }
    for answer in answers {
        answer.map_err(|error| anyhow!("{key}: {error}"))?;
    }
    Ok(())
}

/// Waits until something holds; `false` if it does not come to that.
async fn wait_until(mut holds: impl FnMut() -> bool, patience: Duration) -> bool {
    let began = Instant::now();
    while !holds() {
        if began.elapsed() > patience {
            return false;
        }
        tokio::time::sleep(Duration::from_millis(1)).await;
    }
    true
}

/// Records that were heard, and jobs that ended.
#[derive(Default)]
struct Heard {
    records: AtomicU64,
    ended: AtomicU64,
}

/// Jobs of one command: how many are accepted, durably, and how many end meanwhile.
pub(super) async fn intake(
    figures: &Figures,
    field: &Field,
    lasting: Duration,
) -> Result<(), Failure> {
    let heard = Arc::new(Heard::default());
    let counted = heard.clone();
    let key = field.link.keys().every_job();
    let _records = field
        .link
        .listen(key.as_str(), move |sample| {
            counted.records.fetch_add(1, Ordering::Relaxed);
            let ended = read::<JobRecord>(&sample.payload().to_bytes())
                .is_ok_and(|record| record.state.is_final());
            counted.ended.fetch_add(u64::from(ended), Ordering::Relaxed);
        })
        .await?;
    let before = field.gateway();
    let began = Instant::now();
    let clients = (0..CLIENTS).map(|client| {
        let link = field.link.clone();
        let names = field.names.clone();
        tokio::spawn(async move {
            let mut times_ms = Vec::new();
            for number in 0.. {
                if began.elapsed() > lasting {
                    break;
                }
                let node = &names[(client + number * CLIENTS) % names.len()];
                let key = link.keys().node(node, NodeTopic::Job);
                let job = json!({
                    "id": format!("bench-{client}-{number}"),
                    "commands": [{"set_position": {"axis": 0, "position": number}}],
                });
                let put = Instant::now();
                submit(&link, key.as_str(), &job).await?;
                times_ms.push(put.elapsed().as_secs_f64() * 1e3);
            }
            Ok::<_, Failure>(times_ms)
        })
    });
    let mut times_ms = Vec::new();
    for client in clients.collect::<Vec<_>>() {
        times_ms.extend(client.await.map_err(anyhow::Error::from)??);
    }
    let accepted = times_ms.len();
    let took = began.elapsed().as_secs_f64();
    figures.tell("jobs accepted durably", accepted as f64 / took, "1/s");
    figures.tell_times("a job until it is accepted, 64 at a time", times_ms);
    let used = field.gateway().processor_s - before.processor_s;
    figures.tell(
        "gateway's processor time for each",
        used * 1e6 / accepted as f64,
        "µs",
    );
    let ended = || heard.ended.load(Ordering::Relaxed);
    let all = wait_until(|| ended() >= accepted as u64, 4 * lasting).await;
    let whole = began.elapsed().as_secs_f64();
    let share = if all { "all" } else { "what ended of them" };
    figures.tell(
        format!("jobs executed, {share}"),
        ended() as f64 / whole,
        "1/s",
    );
    let records = heard.records.load(Ordering::Relaxed);
    figures.tell("records published", records as f64 / whole, "1/s");
    Ok(())
}

/// Long jobs on all nodes: how many batches and commands a second go out.
pub(super) async fn batches(figures: &Figures, field: &Field) -> Result<(), Failure> {
    /// Orders that were heard, and the times of the first and last, µs from the beginning.
    #[derive(Default)]
    struct Orders {
        count: AtomicU64,
        bytes: AtomicU64,
        first_us: AtomicU64,
        last_us: AtomicU64,
    }
    let began = Instant::now();
    let orders = Arc::new(Orders::default());
    let counted = orders.clone();
    let key = field.link.keys().every_node(NodeTopic::Batch);
    let _orders = field
        .link
        .listen(key.as_str(), move |sample| {
            let now_us = u64::try_from(began.elapsed().as_micros()).unwrap_or(u64::MAX);
            if counted.count.fetch_add(1, Ordering::Relaxed) == 0 {
                counted.first_us.store(now_us, Ordering::Relaxed);
            }
            let bytes = sample.payload().len() as u64;
            counted.bytes.fetch_add(bytes, Ordering::Relaxed);
            counted.last_us.store(now_us, Ordering::Relaxed);
        })
        .await?;
    let ended = Arc::new(AtomicU64::new(0));
    let counted = ended.clone();
    let key = field.link.keys().every_job();
    let _records = field
        .link
        .listen(key.as_str(), move |sample| {
            let succeeded = read::<JobRecord>(&sample.payload().to_bytes())
                .is_ok_and(|record| record.state == JobState::Succeeded);
            counted.fetch_add(u64::from(succeeded), Ordering::Relaxed);
        })
        .await?;
    let nodes = field.names.len();
    let each = (COMMANDS / nodes).clamp(1, COMMANDS_EACH_MAX);
    let commands: Vec<_> = (0..each)
        .map(|number| json!({"set_position": {"axis": 0, "position": number}}))
        .collect();
    let job = json!({ "commands": commands });
    let every = field.link.keys().every_node(NodeTopic::Job);
    let before = field.gateway();
    submit(&field.link, every.as_str(), &job).await?;
    let all = wait_until(|| ended.load(Ordering::Relaxed) >= nodes as u64, PATIENCE).await;
    if !all {
        let message = "the jobs of the benchmark did not end".to_owned();
        return Err(Failure::TimedOut(message));
    }
    let used = field.gateway().processor_s - before.processor_s;
    let count = orders.count.load(Ordering::Relaxed) as f64;
    let first_us = orders.first_us.load(Ordering::Relaxed);
    let lasted = orders
        .last_us
        .load(Ordering::Relaxed)
        .saturating_sub(first_us);
    let lasted_s = (lasted as f64 / 1e6).max(1e-6);
    figures.tell("batches to nodes", count / lasted_s, "1/s");
    let commands = (nodes * each) as f64;
    figures.tell("commands to nodes", commands / lasted_s, "1/s");
    figures.tell(
        "gateway's processor time for each batch",
        used * 1e6 / count,
        "µs",
    );
    Ok(())
}

/// From the put of a job to the first pulse at the pin, nodes at rest.
pub(super) async fn pulse(
    figures: &Figures,
    field: &Field,
    lasting: Duration,
) -> Result<(), Failure> {
    let nodes = boot(figures.nodes, &field.connect, |config| {
        config.record = Recording::Edges { max: 100_000 };
    })?;
    field.wait_for_nodes(figures.nodes).await?;
    let mut times_ms = Vec::new();
    let began = Instant::now();
    while began.elapsed() < lasting {
        let node = &nodes[times_ms.len() % nodes.len()];
        let key = field.link.keys().node(&node.name(), NodeTopic::Job);
        let before = rises(node);
        let job = json!({"commands": [{"move": {"axis": 0, "delay_us": 50, "steps": 1}}]});
        let put = Instant::now();
        submit(&field.link, key.as_str(), &job).await?;
        if !wait_until(|| rises(node) > before, PATIENCE).await {
            return Err(Failure::TimedOut(format!("{} does not move", node.name())));
        }
        times_ms.push(last_rise_ms(node, put));
    }
    figures.tell_times("put to first pulse", times_ms);
    for node in nodes {
        node.shutdown().await;
    }
    Ok(())
}

fn rises(node: &EmulatedHandle) -> usize {
    node.with(|node, _| node.edges().len() / 2)
}

/// How long after `put` the last pulse rose.
fn last_rise_ms(node: &EmulatedHandle, put: Instant) -> f64 {
    let (rise_us, LocalMicros(now_us), at) = node.with(|node, now| {
        let rise = node
            .edges()
            .iter()
            .rev()
            .find(|edge| matches!(edge.pin, Pin::Step(_)) && edge.level);
        let rise_us = rise.map_or(0, |edge| edge.at_ticks / TICKS_PER_US);
        (rise_us, now, Instant::now())
    });
    // Clocks of these nodes have no offset and no drift: only where they begin is to be found.
    let put_us = now_us as f64 - at.duration_since(put).as_secs_f64() * 1e6;
    (rise_us as f64 - put_us) / 1e3
}

/// A start together, everybody in motion with ten statuses a second each, and a stop for all.
pub(super) async fn scale(
    figures: &Figures,
    field: &Field,
    lasting: Duration,
) -> Result<(), Failure> {
    let nodes = field.names.len();
    figures.tell("nodes there after", field.came_up.as_secs_f64(), "s");
    let memory = field.gateway().resident_kib - field.empty.resident_kib;
    figures.tell("gateway's memory for each", memory / nodes as f64, "KiB");
    let at_rest = share(field, lasting).await;
    figures.tell("gateway's processors, nodes at rest", at_rest.0, "%");
    start_together(figures, field).await?;

    // A pulse every 10 ms, for longer than this lasts.
    let job = json!({"commands": [{"move": {"axis": 0, "delay_us": 10_000, "steps": 12_000}}]});
    let every = field.link.keys().every_node(NodeTopic::Job);
    let put = Instant::now();
    let states = Arc::new(Mutex::new(BTreeSet::new()));
    let moving = states.clone();
    let statuses = Arc::new(AtomicU64::new(0));
    let counted = statuses.clone();
    let key = field.link.keys().every_node(NodeTopic::Status);
    let hearing = field
        .link
        .listen(key.as_str(), move |sample| {
            counted.fetch_add(1, Ordering::Relaxed);
            if let Some((node, NodeState::Running)) = status_of(&sample) {
                lock(&moving).insert(node);
            }
        })
        .await?;
    submit(&field.link, every.as_str(), &job).await?;
    if !wait_until(|| lock(&states).len() >= nodes, PATIENCE).await {
        let message = format!("{} of {nodes} nodes move", lock(&states).len());
        return Err(Failure::TimedOut(message));
    }
    figures.tell(
        "a job for each: all move after",
        put.elapsed().as_secs_f64() * 1e3,
        "ms",
    );
    let (before, from) = (statuses.load(Ordering::Relaxed), Instant::now());
    let watched = share(field, lasting).await;
    let heard = statuses.load(Ordering::Relaxed) - before;
    let rate = heard as f64 / from.elapsed().as_secs_f64();
    figures.tell("statuses that a client hears", rate, "1/s");
    figures.tell(
        "gateway's processors, all moving, a client watches",
        watched.0,
        "%",
    );
    drop(hearing);
    let alone = share(field, lasting).await;
    figures.tell(
        "gateway's processors, all moving, nobody watches",
        alone.0,
        "%",
    );
    figures.tell("processors of all nodes meanwhile", alone.1, "%");
    let memory = field.gateway().resident_kib - field.empty.resident_kib;
    figures.tell(
        "gateway's memory for each, moving",
        memory / nodes as f64,
        "KiB",
    );
    let memory = field.nodes().resident_kib;
    figures.tell("an emulated node's memory", memory / nodes as f64, "KiB");
    stop_all(figures, field).await
}

/// Share of one processor that gateway and nodes use for a while, %.
async fn share(field: &Field, lasting: Duration) -> (f64, f64) {
    let (gateway, nodes, from) = (field.gateway(), field.nodes(), Instant::now());
    tokio::time::sleep(lasting).await;
    let took = from.elapsed().as_secs_f64();
    let of = |before: f64, after: f64| (after - before) / took * 100.0;
    (
        of(gateway.processor_s, field.gateway().processor_s),
        of(nodes.processor_s, field.nodes().processor_s),
    )
}

fn lock<T>(mutex: &Mutex<T>) -> std::sync::MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

fn status_of(sample: &zenoh::sample::Sample) -> Option<(NodeId, NodeState)> {
    let keys = keys::Keys::default();
    let Some(Topic::Node { node, .. }) = keys.parse(sample.key_expr().as_str()) else {
        return None;
    };
    let status: Status = version::decode(&sample.payload().to_bytes()).ok()?;
    Some((NodeId::new(node).ok()?, status.state))
}

async fn start_together(figures: &Figures, field: &Field) -> Result<(), Failure> {
    let group: Vec<_> = field.names.iter().take(GROUP).collect();
    let part = json!({"commands": [{"move": {"axis": 0, "delay_us": 1_000, "steps": 10}}]});
    let parts: serde_json::Map<_, _> = group
        .iter()
        .map(|node| (node.to_string(), part.clone()))
        .collect();
    // Clocks of nodes that have just come are not well known yet; what they come to is told.
    let job = json!({
        "id": "bench-together", "nodes": parts,
        "max_skew_us": 50_000, "ready_timeout_ms": 60_000,
    });
    let ends = Arc::new(Mutex::new(None));
    let told = ends.clone();
    let key = field.link.keys().every_job();
    let _records = field
        .link
        .listen(key.as_str(), move |sample| {
            let Ok(record) = read::<JobRecord>(&sample.payload().to_bytes()) else {
                return;
            };
            if record.job.as_str() == "bench-together" && record.state.is_final() {
                *lock(&told) = Some(record);
            }
        })
        .await?;
    let put = Instant::now();
    let key = format!("{}/group/bench/job", field.link.keys().prefix());
    submit(&field.link, &key, &job).await?;
    wait_until(|| lock(&ends).is_some(), PATIENCE).await;
    let took = put.elapsed();
    let Some(record) = lock(&ends).take() else {
        return Err(Failure::TimedOut("the group did not start".to_owned()));
    };
    let count = group.len();
    let Some(start) = record.start else {
        // A machine that is busy for a quarter of a second is late for a start; then nobody moves.
        figures.tell(format!("a start of {count} together, too late"), 1.0, "");
        return Ok(());
    };
    let name = format!("a start of {count} together, put to end");
    figures.tell(name, took.as_secs_f64() * 1e3, "ms");
    figures.tell("its skew, as the nodes measured it", start.skew_us, "µs");
    figures.tell("how sure that is, ±", start.uncertainty_us, "µs");
    Ok(())
}

/// A client's stop for everybody, until the client has heard of each node that it has stopped.
async fn stop_all(figures: &Figures, field: &Field) -> Result<(), Failure> {
    let prefix = field.link.keys().prefix();
    let nodes = field.names.len();
    let times_ms = Arc::new(Mutex::new(Vec::new()));
    let asked = Arc::new(Mutex::new(None::<Instant>));
    let (noted, from) = (times_ms.clone(), asked.clone());
    let known = Mutex::new(HashSet::new());
    let key = field.link.keys().every_node(NodeTopic::Status);
    let _statuses = field
        .link
        .listen(key.as_str(), move |sample| {
            if let Some((node, NodeState::Stopped)) = status_of(&sample)
                && let Some(asked) = *lock(&from)
                && lock(&known).insert(node)
            {
                lock(&noted).push(asked.elapsed().as_secs_f64() * 1e3);
            }
        })
        .await?;
    *lock(&asked) = Some(Instant::now());
    let stop = Stop {
        mode: StopMode::Halt,
    };
    let key = format!("{prefix}/node/*/stop");
    field.link.put_now(&key, stop.to_payload()).await?;
    wait_until(|| lock(&times_ms).len() >= nodes, PATIENCE).await;
    let times_ms = lock(&times_ms).clone();
    figures.tell(
        "nodes that confirmed a stop for all",
        times_ms.len() as f64,
        "",
    );
    let last = times_ms.iter().copied().fold(f64::NAN, f64::max);
    figures.tell_times("stop for all, put to confirmation", times_ms);
    figures.tell("stop for all, put to the last confirmation", last, "ms");
    Ok(())
}
