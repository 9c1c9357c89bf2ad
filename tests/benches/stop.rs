//! From a client's `stop` to the last pulse, on every node of a fleet that is busy, over real TCP:
//! with the gateway's own router, with a router apart and the gateway killed, and while other nodes
//! have stopped reading with full queues.
//!
//! The nodes live in this process, so that the time of a pulse and that of a stop are of one clock;
//! gateway and stalled nodes are processes of their own. Each node takes 40 commands a second from a
//! ring of 256, so batches, acks and statuses are on their way when the stop comes. Nodes that do not
//! move when it comes are not counted.
//!
//! ```sh
//! cargo bench -p tests --bench stop                  # 100 nodes, 10 rounds: two minutes
//! cargo bench -p tests --bench stop -- 100 10 quick  # without the stalled nodes
//! ```

use emulator::{EmulatedHandle, EmulatorConfig, Recording, pins::Pin};
use keys::{LocalMicros, NodeId, NodeState};
use serde_json::json;
use std::time::{Duration, Instant};
use tests::{
    Random,
    field::{self, Gateway, PATIENCE},
};
use zenoh::{
    Session, Wait,
    qos::{CongestionControl, Priority},
};

/// Changes of pins that are kept for each node: more than three minutes at 1 kHz.
const EDGES_MAX: usize = 400_000;

/// Nodes that stall.
const STALLED: usize = 5;

/// Ticks of the pulse hardware in a microsecond.
const TICKS_PER_US: u64 = 16;

fn main() {
    let numbers: Vec<usize> = std::env::args()
        .filter_map(|argument| argument.parse().ok())
        .collect();
    let nodes = numbers.first().copied().unwrap_or(100);
    let rounds = numbers.get(1).copied().unwrap_or(10);
    let quick = std::env::args().any(|argument| argument == "quick");
    let runtime = tokio::runtime::Runtime::new().expect("threads");
    let _inside = runtime.enter();

    println!(
        "stop to last pulse, ms, {nodes} busy nodes      p50     p99     max   rounds    stops"
    );
    let store = tempfile::tempdir().expect("a directory");
    {
        let gateway = Gateway::start(&store.path().join("own.redb"), None);
        let mut fleet = BusyFleet::new(nodes, &gateway.connect);
        fleet.measure("the gateway's own router", rounds, |_| None);
        if !quick {
            let connect = gateway.connect.clone();
            for (name, congestion) in [
                ("5 stalled nodes, flooded (drop)", CongestionControl::Drop),
                ("5 stalled nodes, flooded (block)", CongestionControl::Block),
            ] {
                fleet.measure(name, rounds.div_ceil(2), |_| {
                    Some(Stall::begin(&connect, congestion))
                });
            }
        }
    }
    let (router, connect) = field::open_router();
    let mut gateway = Gateway::start(&store.path().join("apart.redb"), Some(&connect));
    let mut fleet = BusyFleet::new(nodes, &connect);
    fleet.measure("a router apart", rounds, |_| None);
    // Once: who is dead gives no further jobs.
    fleet.measure("a router apart, gateway killed", 1, |_| {
        gateway.process.kill();
        None
    });
    drop(fleet);
    router.close().wait().expect("an open session");
}

/// Nodes in this process, and a client.
struct BusyFleet {
    nodes: Vec<EmulatedHandle>,
    client: Session,
    random: Random,
    jobs: u64,
}

impl BusyFleet {
    fn new(count: usize, connect: &str) -> Self {
        let nodes = (1..=count).map(|number| {
            let name = NodeId::new(&format!("node-{number}")).expect("legal");
            let mut config = EmulatorConfig::new(name);
            config.connect = connect.to_owned();
            config.ring_commands = 256;
            config.record = Recording::Edges { max: EDGES_MAX };
            emulator::spawn(config).expect("a good configuration")
        });
        let nodes: Vec<_> = nodes.collect();
        let client = field::open_client(connect);
        field::wait_for_nodes(&client, count, |node| node["alive"] == true);
        Self {
            nodes,
            client,
            random: Random(1),
            jobs: 0,
        }
    }

    /// Stops the busy fleet so many times. What `meanwhile` gives lasts until all have stopped.
    fn measure(
        &mut self,
        name: &str,
        rounds: usize,
        mut meanwhile: impl FnMut(usize) -> Option<Stall>,
    ) {
        let mut latencies_ms = Vec::new();
        for round in 0..rounds {
            self.make_busy();
            let during = meanwhile(round);
            std::thread::sleep(Duration::from_micros(self.random.below(300_000)));
            let asked = Instant::now();
            self.client
                .put("fleet/node/*/stop", "")
                .priority(Priority::RealTime)
                .congestion_control(CongestionControl::Block)
                .express(true)
                .wait()
                .expect("an open session");
            self.wait_until("stopped", |node| node.status().state == NodeState::Stopped);
            latencies_ms.extend(
                self.nodes
                    .iter()
                    .filter_map(|node| last_pulse_ms(node, asked)),
            );
            drop(during);
            if round + 1 < rounds {
                self.release();
            }
        }
        latencies_ms.sort_by(f64::total_cmp);
        print!("{name:<42}");
        for share in [0.5, 0.99, 1.0] {
            print!(" {:>7.2}", field::percentile(&latencies_ms, share));
        }
        println!(" {rounds:>8} {:>8}", latencies_ms.len());
        if self
            .nodes
            .iter()
            .all(|node| node.status().state == NodeState::Stopped)
        {
            self.release();
        }
    }

    fn make_busy(&mut self) {
        self.jobs += 1;
        let commands: Vec<_> = (0..2_000)
            .map(|index| {
                let steps = if index % 2 == 0 { 25 } else { -25 };
                json!({"move": {"axis": 0, "delay_us": 1_000, "steps": steps}})
            })
            .collect();
        let before: Vec<_> = self.nodes.iter().map(rises).collect();
        for node in &self.nodes {
            let job = json!({"commands": commands, "id": format!("{}-{}", node.name(), self.jobs)});
            self.client
                .put(format!("fleet/node/{}/job", node.name()), job.to_string())
                .encoding(zenoh::bytes::Encoding::APPLICATION_JSON)
                .congestion_control(CongestionControl::Block)
                .wait()
                .expect("an open session");
        }
        let since = Instant::now();
        for (node, before) in self.nodes.iter().zip(before) {
            // 50 pulses: it takes commands as fast as it executes them.
            while rises(node) < before + 50 {
                assert!(since.elapsed() < PATIENCE, "{} does not move", node.name());
                std::thread::sleep(Duration::from_millis(5));
            }
        }
    }

    fn release(&self) {
        let answers = field::get(&self.client, "fleet/node/*/release", None);
        if !answers.iter().any(serde_json::Value::is_object) {
            // There is no gateway: nobody answers, or the router says that nobody does.
            return;
        }
        for answer in answers.iter().filter(|answer| answer["state"] != "idle") {
            eprintln!("not released: {answer}");
        }
        self.wait_until("released", |node| node.status().state == NodeState::Idle);
        // The jobs that were stopped must have their end before the next ones come.
        let count = self.nodes.len();
        field::wait_for_nodes(&self.client, count, |node| {
            node["state"] == "idle" && node["job"].is_null()
        });
    }

    fn wait_until(&self, what: &str, holds: impl Fn(&EmulatedHandle) -> bool) {
        let since = Instant::now();
        for node in &self.nodes {
            while !holds(node) {
                assert!(since.elapsed() < PATIENCE, "{} is not {what}", node.name());
                std::thread::sleep(Duration::from_millis(2));
            }
        }
    }
}

fn rises(node: &EmulatedHandle) -> usize {
    node.with(|node, _| node.edges().len() / 2)
}

/// How long after `asked` the last pulse rose; `None` if the node did not move then.
fn last_pulse_ms(node: &EmulatedHandle, asked: Instant) -> Option<f64> {
    let (last_us, now, at) = node.with(|node, now| {
        let edges = node.edges();
        assert!(edges.len() < EDGES_MAX, "the record is too small");
        let rise = edges
            .iter()
            .rev()
            .find(|edge| matches!(edge.pin, Pin::Step(_)) && edge.level);
        let last_us = rise.map_or(0, |edge| edge.at_ticks / TICKS_PER_US);
        (last_us, now, Instant::now())
    });
    // Clocks of these nodes have no offset and no drift: only where they begin is to be found.
    let LocalMicros(now_us) = now;
    let asked_us = now_us as f64 - at.duration_since(asked).as_secs_f64() * 1e6;
    let after_ms = (last_us as f64 - asked_us) / 1e3;
    // A pulse each millisecond: whoever made none for longer was at rest.
    (after_ms > -2.0).then_some(after_ms.max(0.0))
}

/// Nodes whose process is stopped while a client floods them.
struct Stall {
    nodes: field::Process,
    flood: Option<std::thread::JoinHandle<()>>,
    over: std::sync::Arc<std::sync::atomic::AtomicBool>,
}

impl Stall {
    fn begin(connect: &str, congestion: CongestionControl) -> Self {
        let nodes = field::emulators("stuck", STALLED, connect);
        let client = field::open_client(connect);
        field::wait_for_nodes(&client, STALLED, |node| {
            node["alive"] == true
                && node["node"]
                    .as_str()
                    .is_some_and(|name| name.starts_with("stuck"))
        });
        nodes.signal("STOP");
        let over = std::sync::Arc::new(std::sync::atomic::AtomicBool::new(false));
        let ended = over.clone();
        let (full, is_full) = std::sync::mpsc::channel();
        let flood = std::thread::spawn(move || {
            let payload = vec![0_u8; 8 * 1024];
            let since = Instant::now();
            let mut sent = 0;
            while !ended.load(std::sync::atomic::Ordering::Relaxed) {
                for number in 1..=STALLED {
                    // When the link of a stalled node is closed there is nobody to send to.
                    let _ = client
                        .put(
                            format!("fleet/node/stuck-{number}/batch"),
                            payload.as_slice(),
                        )
                        .congestion_control(congestion)
                        .wait();
                    sent += payload.len();
                }
                // Far more than the sockets and queues on the way hold.
                if sent > 64 << 20 || since.elapsed() > Duration::from_secs(2) {
                    let _ = full.send(());
                    std::thread::sleep(Duration::from_millis(1));
                }
            }
        });
        is_full.recv_timeout(PATIENCE).expect("the flood goes on");
        Self {
            nodes,
            flood: Some(flood),
            over,
        }
    }
}

impl Drop for Stall {
    fn drop(&mut self) {
        self.over.store(true, std::sync::atomic::Ordering::Relaxed);
        self.nodes.kill();
        if let Some(flood) = self.flood.take() {
            // It has nothing to say.
            let _ = flood.join();
        }
    }
}
