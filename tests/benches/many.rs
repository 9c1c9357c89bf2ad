//! Ten thousand nodes on the in-memory bus: what the fleet itself costs, without sockets.
//!
//! ```text
//!   scripted nodes ─ status, ack, clock, start ─▶ in-memory bus, 1 ms each way ─▶ the real Fleet
//!         ▲                                                                           │
//!         └──────────── batches, probes, commits, stops ◀─────────────────────────────┘
//! ```
//!
//! Time is virtual; measured is the processor's time inside [`Fleet::handle`] alone, so nodes and bus
//! cost nothing. Memory is what the process grew by from the moment on at which all nodes existed and
//! the fleet knew none.
//!
//! ```sh
//! cargo bench -p tests --bench many             # 100, 1,000 and 10,000 nodes
//! cargo bench -p tests --bench many -- 10000   # one line alone
//! ```

#[allow(
    dead_code,
    unreachable_pub,
    reason = "the gateway's tests use the rest of it"
)]
#[path = "../../gateway/tests/rig/fake.rs"]
mod fake;

use fake::FakeNode;
use gateway::{
    fleet::{
        Fleet, FleetConfig,
        event::{Effect, Event, ReplyTo},
    },
    job::parse,
};
use keys::{
    Features, FleetMicros, JobId, Keys, NodeId, NodeTopic, StopMode, Topic,
    record::{JobState, NodeWord},
};
use serde_json::{Value, json};
use std::{
    cmp::Reverse,
    collections::{BTreeSet, BinaryHeap},
    time::{Duration, Instant},
};
use tests::memory::resident_kib;

/// When it begins, µs of the fleet's clock.
const EPOCH_US: u64 = 1_795_230_000_000_000;

/// One way through the bus, µs.
const WAY_US: u64 = 1_000;

/// Nodes of the synchronized job; one has at most 128.
const TOGETHER: usize = 100;

const S: u64 = 1_000_000;

fn main() {
    let counts: Vec<usize> = std::env::args()
        .filter_map(|argument| argument.parse().ok())
        .collect();
    if let [count] = counts[..] {
        return measure(count);
    }
    println!(
        "nodes   KiB each   statuses/s at rest: core    moving: core   µs each   longest call   \
         start of {TOGETHER}: fleet's time, virtual   stop of all: fleet's time, virtual"
    );
    // A process for each: what one has given back the next would take without growing.
    let program = std::env::current_exe().expect("this program");
    for count in ["100", "1000", "10000"] {
        let ended = std::process::Command::new(&program).arg(count).status();
        assert!(ended.expect("this program").success(), "{count} nodes");
    }
}

fn measure(count: usize) {
    let mut bus = Bus::new(count);
    let before_kib = resident_kib();
    bus.switch_on();
    // All have been asked for their clocks often enough.
    bus.run(120 * S);
    let each_kib = resident_kib().saturating_sub(before_kib) as f64 / count as f64;

    bus.clear();
    bus.run(10 * S);
    let rest = bus.spent.as_secs_f64() / 10.0;
    let rest_rate = bus.status_count / 10;

    // The hundred of the start stay at rest until it.
    let start = bus.start_together();

    let reply = bus.ask();
    bus.submit(
        "*",
        &json!({"commands": [{"pause": {"ms": 3_600_000}}]}),
        reply,
    );
    bus.run(2 * S);
    assert!(bus.nodes.iter().all(FakeNode::is_active), "some rest");
    bus.clear();
    bus.run(10 * S);
    let moving = bus.spent.as_secs_f64() / 10.0;
    let rate = bus.status_count / 10;
    let each_us = bus.spent.as_micros() as f64 / bus.status_count as f64;
    let longest = bus.longest;

    let stop = bus.stop_all();
    println!(
        "{count:>5}   {each_kib:>8.1}   {rest_rate:>10} {:>12.1} %   {rate:>8} {:>5.1} %   \
         {each_us:>7.1}   {:>9.2} ms   {:>16.1} ms, {:>5.2} s   {:>22.1} ms, {:>5.3} s",
        rest * 100.0,
        moving * 100.0,
        longest.as_secs_f64() * 1e3,
        start.0.as_secs_f64() * 1e3,
        start.1 as f64 / 1e6,
        stop.0.as_secs_f64() * 1e3,
        stop.1 as f64 / 1e6,
    );
}

/// A message on its way, ordered by its arrival.
#[derive(PartialEq, Eq, PartialOrd, Ord)]
struct Message {
    at_us: u64,
    number: u64,
    node: usize,
    to_node: bool,
    suffix: &'static str,
    payload: Vec<u8>,
}

/// The nodes, the fleet, and what is on its way between them.
struct Bus {
    fleet: Fleet,
    keys: Keys,
    now_us: u64,
    nodes: Vec<FakeNode>,
    /// When each node wants to be polled, and the same in order.
    due_us: Vec<u64>,
    due: BTreeSet<(u64, usize)>,
    network: BinaryHeap<Reverse<Message>>,
    message_count: u64,
    reply_count: u64,
    /// Spent inside the fleet, its longest call, and the statuses that it took.
    spent: Duration,
    longest: Duration,
    status_count: u64,
}

impl Bus {
    fn new(count: usize) -> Self {
        let config = FleetConfig {
            nodes_max: count,
            ..FleetConfig::default()
        };
        let nodes: Vec<FakeNode> = (0..count)
            .map(|index| {
                let id = NodeId::new(&name(index)).expect("legal");
                let mut node = FakeNode::new(id, index as u32 + 1, EPOCH_US);
                node.features = Features::BASIC.with(Features::BARRIERS);
                node
            })
            .collect();
        Self {
            keys: config.keys.clone(),
            fleet: Fleet::new(config, 1),
            now_us: EPOCH_US,
            due_us: vec![u64::MAX; nodes.len()],
            nodes,
            due: BTreeSet::new(),
            network: BinaryHeap::new(),
            message_count: 0,
            reply_count: 0,
            spent: Duration::ZERO,
            longest: Duration::ZERO,
            status_count: 0,
        }
    }

    fn clear(&mut self) {
        (self.spent, self.longest, self.status_count) = (Duration::ZERO, Duration::ZERO, 0);
    }

    /// They come one after the other within a second.
    fn switch_on(&mut self) {
        for index in 0..self.nodes.len() {
            let at_us = EPOCH_US + S * index as u64 / self.nodes.len() as u64;
            self.run(at_us - self.now_us);
            self.handle(Event::Alive {
                node: self.nodes[index].id,
                alive: true,
            });
            self.nodes[index].tell(at_us);
            self.carry(index);
        }
    }

    /// Hands in a job of a hundred that start together; returns the fleet's time for it, and how long
    /// it took until all had started, µs.
    fn start_together(&mut self) -> (Duration, u64) {
        let part = json!({"commands": [{"pause": {"ms": 1}}]});
        let parts: serde_json::Map<String, Value> = (0..TOGETHER.min(self.nodes.len()))
            .map(|index| (name(index), part.clone()))
            .collect();
        self.clear();
        let begun_us = self.now_us;
        let text = json!({"id": "together", "nodes": parts}).to_string();
        let parsed = parse::parse_group("application/json", text.as_bytes());
        let reply = self.ask();
        self.handle(Event::SubmitGroup {
            pattern: "all".to_owned(),
            request: parsed.request,
            id_hint: parsed.id_hint,
            reply: Some(reply),
        });
        let job = JobId::new("together").expect("legal");
        loop {
            self.run(10_000);
            if self.state(&job) == Some(JobState::Succeeded) {
                break;
            }
            let late = self.now_us > begun_us + 60 * S;
            if late || self.state(&job).is_some_and(JobState::is_final) {
                let record = self.fleet.job(&job).map(|job| &job.entry.record);
                panic!("no start: {record:?}");
            }
        }
        (self.spent, self.now_us - begun_us)
    }

    /// A client stops all; returns the fleet's time for it, and how long it took until it knew of
    /// each node's stop, µs.
    fn stop_all(&mut self) -> (Duration, u64) {
        self.clear();
        let begun_us = self.now_us;
        for index in 0..self.nodes.len() {
            self.send(
                index,
                true,
                NodeTopic::Stop,
                b"{\"mode\":\"halt\"}".to_vec(),
            );
        }
        self.handle(Event::Stop {
            pattern: "*".to_owned(),
            mode: StopMode::Halt,
        });
        let stopped = |bus: &Self| {
            let is_stopped = |node: &FakeNode| {
                let record = bus.fleet.node_record(&node.id).expect("known");
                record.state == NodeWord::Stopped
            };
            bus.nodes.iter().all(is_stopped)
        };
        while !stopped(self) {
            self.run(1_000);
            assert!(self.now_us < begun_us + 10 * S, "no stop");
        }
        (self.spent, self.now_us - begun_us)
    }

    fn state(&self, job: &JobId) -> Option<JobState> {
        Some(self.fleet.job(job)?.entry.record.state)
    }

    fn ask(&mut self) -> ReplyTo {
        self.reply_count += 1;
        ReplyTo(self.reply_count)
    }

    fn submit(&mut self, pattern: &str, job: &Value, reply: ReplyTo) {
        let parsed = parse::parse("application/json", job.to_string().as_bytes());
        self.handle(Event::Submit {
            pattern: pattern.to_owned(),
            request: parsed.request,
            id_hint: parsed.id_hint,
            reply: Some(reply),
        });
    }

    /// Lets time pass.
    fn run(&mut self, us: u64) {
        let until_us = self.now_us + us;
        loop {
            let node = self.due.first().map(|due| due.0);
            let message = self.network.peek().map(|Reverse(message)| message.at_us);
            let fleet = self.fleet.poll_timeout().map(|at| at.0);
            let next = [node, message, fleet].into_iter().flatten().min();
            let Some(next_us) = next.filter(|at_us| *at_us <= until_us) else {
                break;
            };
            self.now_us = self.now_us.max(next_us);
            if node == Some(next_us) {
                let (_, index) = self.due.pop_first().expect("just seen");
                self.due_us[index] = u64::MAX;
                self.nodes[index].poll(self.now_us);
                self.carry(index);
            } else if message == Some(next_us) {
                let Reverse(message) = self.network.pop().expect("just seen");
                self.deliver(message);
            } else {
                self.handle(Event::Tick);
            }
        }
        self.now_us = until_us;
    }

    fn deliver(&mut self, message: Message) {
        let topic = NodeTopic::from_suffix(message.suffix).expect("one of ours");
        if message.to_node {
            self.nodes[message.node].handle(topic, &message.payload, self.now_us);
            self.carry(message.node);
        } else {
            self.status_count += u64::from(topic == NodeTopic::Status);
            self.handle(Event::FromNode {
                node: self.nodes[message.node].id,
                topic,
                payload: message.payload,
            });
        }
    }

    /// Takes what a node says and when it wants to be polled.
    fn carry(&mut self, index: usize) {
        for (topic, payload) in self.nodes[index].take_outbox() {
            self.send(index, false, topic, payload);
        }
        self.due.remove(&(self.due_us[index], index));
        self.due_us[index] = self.nodes[index].poll_timeout().unwrap_or(u64::MAX);
        self.due.insert((self.due_us[index], index));
    }

    fn send(&mut self, node: usize, to_node: bool, topic: NodeTopic, payload: Vec<u8>) {
        self.message_count += 1;
        self.network.push(Reverse(Message {
            at_us: self.now_us + WAY_US,
            number: self.message_count,
            node,
            to_node,
            suffix: topic.suffix(),
            payload,
        }));
    }

    fn handle(&mut self, event: Event) {
        let mut effects = Vec::new();
        let begun = Instant::now();
        self.fleet
            .handle(event, FleetMicros(self.now_us), &mut effects);
        let spent = begun.elapsed();
        self.spent += spent;
        self.longest = self.longest.max(spent);
        for effect in effects {
            let Effect::Publish { key, payload, .. } = effect else {
                continue;
            };
            let Some(Topic::Node { node, topic }) = self.keys.parse(&key) else {
                continue;
            };
            if matches!(
                topic,
                NodeTopic::Batch | NodeTopic::Clock | NodeTopic::Start | NodeTopic::Stop
            ) {
                let index = node[1..].parse().expect("a number");
                self.send(index, true, topic, payload);
            }
        }
    }
}

fn name(index: usize) -> String {
    format!("n{index}")
}
