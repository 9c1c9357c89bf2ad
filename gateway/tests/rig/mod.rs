//! A fleet in a bottle: the real [`Fleet`], scripted nodes, a network with faults and a store,
//! all in virtual time and from one seed.
//!
//! ```text
//!   client ─▶ Fleet ─ effects ─▶ store (at once) · network ─▶ FakeNode
//!               ▲                                  │             │
//!               └──────────────────────────────────┴─────────────┘
//! ```
//!
//! What holds at every instant is asserted here, so that each test asserts it: a record is in the
//! store before it is published, versions grow by one, a final record never changes, progress
//! never falls, every message takes its lane, and every get ends once and says nothing afterwards.

// Each test file uses a part of it, and each is a crate of its own.
#![allow(dead_code, unreachable_pub)]

pub mod fake;

use fake::FakeNode;
use gateway::{
    fleet::{
        Fleet, FleetConfig, Stored,
        event::{Effect, Event, Lane, ReplyTo, Table, Write},
    },
    job::{JobEntry, parse},
};
use keys::{
    FleetMicros, JobId, Keys, NodeId, NodeTopic, StopMode, Topic,
    record::{JobRecord, JobState, NodeRecord, StartPlan},
    start::StartMessage,
};
use serde_json::Value;
use std::collections::{BTreeMap, HashMap};

/// When every test begins.
pub const EPOCH_US: u64 = 1_795_230_000_000_000;

/// One second, µs.
pub const S: u64 = 1_000_000;

/// One millisecond, µs.
pub const MS: u64 = 1_000;

/// A seeded source of chance (splitmix64).
#[derive(Clone, Debug)]
pub struct Chance(pub u64);

impl Chance {
    pub fn next(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut mixed = self.0;
        mixed = (mixed ^ (mixed >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        mixed = (mixed ^ (mixed >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        mixed ^ (mixed >> 31)
    }

    pub fn below(&mut self, end: u64) -> u64 {
        self.next() % end
    }

    pub fn percent(&mut self, percent: u64) -> bool {
        self.below(100) < percent
    }
}

/// What the network does to messages between gateway and nodes.
#[derive(Clone, Copy, Debug)]
pub struct Faults {
    pub delay_us_min: u64,
    pub delay_us_max: u64,
    pub drop_percent: u64,
    pub duplicate_percent: u64,
}

impl Faults {
    /// Always 1 ms, nothing is lost.
    pub const NONE: Self = Self {
        delay_us_min: MS,
        delay_us_max: MS,
        drop_percent: 0,
        duplicate_percent: 0,
    };
}

/// What happens to one message.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Spoil {
    /// It is lost.
    Lose,
    /// It comes twice, the second time so much later, µs.
    Twice(u64),
    /// It comes so much later, µs, and what its sender says behind it on that key, too.
    Late(u64),
    /// It is lost, and everything that its sender says on that key from then on.
    Silence,
}

#[derive(Clone, Debug)]
struct Message {
    node: NodeId,
    to_node: bool,
    topic: NodeTopic,
    payload: Vec<u8>,
}

/// The store as a map, and how often it was written.
pub type Rows = BTreeMap<(Table, String), Vec<u8>>;

/// The bottle.
pub struct Rig {
    pub fleet: Fleet,
    pub config: FleetConfig,
    pub now_us: u64,
    pub nodes: BTreeMap<NodeId, FakeNode>,
    pub rows: Rows,
    /// Every write, in order.
    pub writes: Vec<Write>,
    pub faults: Faults,
    pub chance: Chance,
    network: BTreeMap<(u64, u64), Message>,
    next_number: u64,
    next_reply: u64,
    call_count: u64,
    pub replies: HashMap<ReplyTo, Vec<(Option<String>, Value)>>,
    pub ended: Vec<ReplyTo>,
    /// Every record that was published, in order.
    pub records: Vec<JobRecord>,
    pub node_records: Vec<(u64, NodeRecord)>,
    /// Plans of starts, in order.
    pub plans: Vec<StartPlan>,
    /// Messages to nodes: the number of the call that sent it, topic and lane.
    pub sent: Vec<(u64, NodeId, NodeTopic, Lane, Vec<u8>)>,
    pub seed: u64,
    /// Writes until the power fails.
    pub writes_left: Option<usize>,
    /// The power has failed: nothing reaches the gateway and it does nothing.
    pub dead: bool,
    /// How long the gateway is away after the power failed.
    pub restart_after_us: Option<u64>,
    restart_at_us: Option<u64>,
    /// Which messages of a synchronized job are spoilt, counted from 0, and how.
    pub spoils: BTreeMap<u64, Spoil>,
    /// How many such messages there were.
    pub start_message_count: u64,
    /// Until when nothing more arrives on a way, and ways that are cut for good.
    held_until: BTreeMap<(NodeId, bool, &'static str), u64>,
    /// The gateway has died once: versions that were written and not told may be missing.
    pub died: bool,
}

impl Rig {
    pub fn new() -> Self {
        Self::with(FleetConfig::default(), 1)
    }

    pub fn with(config: FleetConfig, seed: u64) -> Self {
        Self {
            fleet: Fleet::new(config.clone(), seed),
            config,
            now_us: EPOCH_US,
            nodes: BTreeMap::new(),
            rows: Rows::new(),
            writes: Vec::new(),
            faults: Faults::NONE,
            chance: Chance(seed),
            network: BTreeMap::new(),
            next_number: 0,
            next_reply: 0,
            call_count: 0,
            replies: HashMap::new(),
            ended: Vec::new(),
            records: Vec::new(),
            node_records: Vec::new(),
            plans: Vec::new(),
            sent: Vec::new(),
            seed,
            writes_left: None,
            dead: false,
            restart_after_us: None,
            restart_at_us: None,
            spoils: BTreeMap::new(),
            start_message_count: 0,
            held_until: BTreeMap::new(),
            died: false,
        }
    }

    /// A rig with one node `left` that has said hello.
    pub fn with_left() -> Self {
        let mut rig = Self::new();
        rig.add("left");
        rig.run(10 * MS);
        rig
    }

    pub fn now(&self) -> FleetMicros {
        FleetMicros(self.now_us)
    }

    pub fn keys(&self) -> &Keys {
        &self.config.keys
    }

    /// Switches a new node on.
    pub fn add(&mut self, name: &str) {
        let id = NodeId::new(name).expect("legal");
        let boot = self.chance.next() as u32;
        let node = FakeNode::new(id, boot, self.now_us);
        self.nodes.insert(id, node);
        self.event(Event::Alive {
            node: id,
            alive: true,
        });
        self.carry_from_nodes();
    }

    pub fn node(&mut self, name: &str) -> &mut FakeNode {
        let id = NodeId::new(name).expect("legal");
        self.nodes.get_mut(&id).expect("was added")
    }

    /// Cuts or mends the link of a node; the router notices at once.
    pub fn link(&mut self, name: &str, up: bool) {
        let now_us = self.now_us;
        let node = self.node(name);
        let id = node.id;
        node.link(up, now_us);
        self.cut(id);
        self.event(Event::Alive {
            node: id,
            alive: up,
        });
        self.carry_from_nodes();
    }

    /// From now on every message comes through.
    pub fn heal(&mut self) {
        self.spoils.clear();
        self.held_until.clear();
    }

    /// What was on its way to a node is gone; what it said last may still arrive.
    fn cut(&mut self, id: NodeId) {
        self.network
            .retain(|_, message| message.node != id || !message.to_node);
    }

    /// Switches a node off and on.
    pub fn reboot(&mut self, name: &str) {
        let boot = self.chance.next() as u32;
        let now_us = self.now_us;
        let id = self.node(name).id;
        self.cut(id);
        self.node(name).reboot(boot, now_us);
        for alive in [false, true] {
            self.event(Event::Alive { node: id, alive });
        }
        self.carry_from_nodes();
    }

    // ───────────────────────────── clients ─────────────────────────────

    fn submit(&mut self, pattern: &str, payload: &[u8], reply: Option<ReplyTo>) {
        let parsed = parse::parse("application/json", payload);
        self.event(Event::Submit {
            pattern: pattern.into(),
            request: parsed.request,
            id_hint: parsed.id_hint,
            reply,
        });
    }

    /// Puts a job.
    pub fn put(&mut self, pattern: &str, job: &Value) {
        self.submit(pattern, job.to_string().as_bytes(), None);
    }

    /// Gets a job: returns every reply.
    pub fn get(&mut self, pattern: &str, job: &Value) -> Vec<Value> {
        let reply = self.ask();
        self.submit(pattern, job.to_string().as_bytes(), Some(reply));
        self.answers(reply)
    }

    /// Gets a job for one node that must take it; returns its name.
    pub fn accept(&mut self, node: &str, job: &Value) -> JobId {
        let replies = self.get(node, job);
        assert_eq!(replies.len(), 1, "{replies:?}");
        assert_eq!(replies[0]["state"], "queued", "{replies:?}");
        id(replies[0]["job"].as_str().expect("a name"))
    }

    /// Gets a job that must be refused; returns code and message.
    pub fn refuse(&mut self, pattern: &str, job: &Value) -> (String, String) {
        let replies = self.get(pattern, job);
        assert_eq!(replies.len(), 1, "{replies:?}");
        error_of(&replies[0])
    }

    /// Puts or gets a synchronized job.
    pub fn submit_group(&mut self, group: &str, job: &Value, reply: Option<ReplyTo>) {
        let parsed = parse::parse_group("application/json", job.to_string().as_bytes());
        self.event(Event::SubmitGroup {
            pattern: group.into(),
            request: parsed.request,
            id_hint: parsed.id_hint,
            reply,
        });
    }

    /// Gets a synchronized job that must be taken; returns its name.
    pub fn accept_group(&mut self, job: &Value) -> JobId {
        let reply = self.ask();
        self.submit_group("g1", job, Some(reply));
        let replies = self.answers(reply);
        assert_eq!(replies.len(), 1, "{replies:?}");
        assert!(replies[0]["job"].is_string(), "{replies:?}");
        id(replies[0]["job"].as_str().expect("a name"))
    }

    /// Gets a synchronized job that must be refused; returns code and message.
    pub fn refuse_group(&mut self, job: &Value) -> (String, String) {
        let reply = self.ask();
        self.submit_group("g1", job, Some(reply));
        error_of(&self.answers(reply)[0])
    }

    /// A fresh name for a get.
    pub fn ask(&mut self) -> ReplyTo {
        self.next_reply += 1;
        ReplyTo(self.next_reply)
    }

    /// Returns the replies of a get that must be over.
    pub fn answers(&mut self, reply: ReplyTo) -> Vec<Value> {
        assert!(self.ended.contains(&reply), "the get is not over");
        let replies = self.replies.remove(&reply).unwrap_or_default();
        replies.into_iter().map(|(_, value)| value).collect()
    }

    pub fn cancel(&mut self, pattern: &str) -> Vec<Value> {
        let reply = self.ask();
        self.event(Event::Cancel {
            pattern: pattern.into(),
            reply: Some(reply),
        });
        self.answers(reply)
    }

    /// A client's stop: the node and the gateway hear it.
    pub fn stop(&mut self, pattern: &str) {
        let key = format!("fleet/node/{pattern}/stop");
        self.publish_stop(&key, b"{\"mode\":\"halt\"}");
    }

    pub fn release(&mut self, pattern: &str) -> ReplyTo {
        let reply = self.ask();
        self.event(Event::Release {
            pattern: pattern.into(),
            reply: Some(reply),
        });
        reply
    }

    pub fn jobs(&mut self, pattern: &str, parameters: &[(&str, &str)]) -> Vec<Value> {
        let reply = self.ask();
        self.event(Event::GetJobs {
            pattern: pattern.into(),
            parameters: parameters
                .iter()
                .map(|(name, value)| ((*name).into(), (*value).into()))
                .collect(),
            reply,
        });
        self.answers(reply)
    }

    pub fn node_states(&mut self, pattern: &str) -> Vec<Value> {
        let reply = self.ask();
        self.event(Event::GetNodes {
            pattern: pattern.into(),
            reply,
        });
        self.answers(reply)
    }

    // ───────────────────────────── what is known ─────────────────────────────

    pub fn record(&self, id: &JobId) -> &JobRecord {
        &self.fleet.job(id).expect("a job").entry.record
    }

    pub fn state(&self, id: &JobId) -> JobState {
        self.record(id).state
    }

    /// The states of a job in the order in which they were published, without repetitions.
    pub fn states(&self, id: &JobId) -> Vec<JobState> {
        let mut states: Vec<JobState> = self
            .records
            .iter()
            .filter(|record| record.job == *id)
            .map(|record| record.state)
            .collect();
        states.dedup();
        states
    }

    pub fn view(&self, name: &str) -> NodeRecord {
        let id = NodeId::new(name).expect("legal");
        self.fleet.node_record(&id).expect("a node")
    }

    // ───────────────────────────── time ─────────────────────────────

    /// Lets time pass.
    pub fn run(&mut self, us: u64) {
        let until_us = self.now_us + us;
        self.run_to(until_us, |_| false);
        self.now_us = until_us;
    }

    /// Lets time pass until it is so, at most that long.
    pub fn run_until(&mut self, us: u64, so: impl FnMut(&Self) -> bool) {
        let until_us = self.now_us + us;
        let done = self.run_to(until_us, so);
        assert!(done, "seed {}: not so within {us} µs", self.seed);
    }

    /// Lets time pass until the job is final.
    pub fn finish(&mut self, id: &JobId, us: u64) -> JobState {
        self.run_until(us, |rig| rig.state(id).is_final());
        self.state(id)
    }

    fn run_to(&mut self, until_us: u64, mut so: impl FnMut(&Self) -> bool) -> bool {
        loop {
            if so(self) {
                return true;
            }
            let network = self.network.keys().next().map(|(at, _)| *at);
            let fleet = self
                .fleet
                .poll_timeout()
                .map(|at| at.0)
                .filter(|_| !self.dead);
            let nodes = self.nodes.values().filter_map(FakeNode::poll_timeout).min();
            let next = [network, fleet, nodes, self.restart_at_us]
                .into_iter()
                .flatten()
                .min();
            let Some(next_us) = next.filter(|at| *at <= until_us) else {
                return false;
            };
            self.now_us = self.now_us.max(next_us);
            let now_us = self.now_us;
            if self.restart_at_us.is_some_and(|at| at <= now_us) {
                self.restart_at_us = None;
                self.restart_gateway();
            }
            for node in self.nodes.values_mut() {
                node.poll(now_us);
            }
            self.carry_from_nodes();
            while let Some((place, _)) = self.network.first_key_value() {
                if place.0 > now_us {
                    break;
                }
                let (_, message) = self.network.pop_first().expect("just seen");
                self.deliver(message);
            }
            if !self.dead && self.fleet.poll_timeout().is_some_and(|at| at.0 <= now_us) {
                self.event(Event::Tick);
            }
        }
    }

    /// Something happens to the fleet.
    pub fn event(&mut self, event: Event) {
        if self.dead {
            return;
        }
        let mut effects = Vec::new();
        let now = self.now();
        self.call_count += 1;
        self.fleet.handle(event, now, &mut effects);
        self.carry_out(effects);
    }

    /// What a store would give back.
    pub fn stored(&self) -> Stored {
        let table = |table: Table| {
            self.rows
                .iter()
                .filter(|((of, _), _)| *of == table)
                .map(|((_, key), value)| (key.clone(), value.clone()))
                .collect()
        };
        Stored {
            requests: table(Table::Requests),
            jobs: table(Table::Jobs),
            nodes: table(Table::Nodes),
            kept: table(Table::Kept),
        }
    }

    /// The gateway dies and comes back with what the store holds.
    pub fn restart_gateway(&mut self) {
        let stored = self.stored();
        (self.dead, self.died, self.writes_left) = (false, true, None);
        let mut effects = Vec::new();
        let seed = self.chance.next();
        let config = self.config.clone();
        self.fleet = Fleet::restore(config, seed, stored, self.now(), &mut effects)
            .expect("the store is ours");
        self.carry_out(effects);
        // The router tells who is there.
        let alive: Vec<NodeId> = self
            .nodes
            .values()
            .filter(|node| node.link_up)
            .map(|node| node.id)
            .collect();
        for node in alive {
            self.event(Event::Alive { node, alive: true });
        }
    }

    fn carry_out(&mut self, effects: Vec<Effect>) {
        for effect in effects {
            if self.dead {
                return;
            }
            match effect {
                Effect::Persist(write) => self.persist(write),
                Effect::Publish {
                    key,
                    payload,
                    json,
                    lane,
                } => self.publish(&key, payload, json, lane),
                Effect::Reply { to, key, payload } => {
                    assert!(!self.ended.contains(&to), "a reply after the end");
                    let value: Value = serde_json::from_slice(&payload).expect("JSON");
                    assert_eq!(
                        key.is_none(),
                        value.get("error").is_some_and(Value::is_object)
                            && value.get("job").is_none()
                    );
                    self.replies.entry(to).or_default().push((key, value));
                }
                Effect::ReplyEnd { to } => {
                    assert!(!self.ended.contains(&to), "ended twice");
                    self.ended.push(to);
                }
            }
        }
    }

    fn persist(&mut self, write: Write) {
        self.writes.push(write.clone());
        match write {
            Write::Put { table, key, value } => {
                self.rows.insert((table, key), value);
            }
            Write::Remove { table, key } => {
                self.rows.remove(&(table, key));
            }
        }
        if let Some(left) = &mut self.writes_left {
            *left -= 1;
            if *left == 0 {
                self.dead = true;
                self.writes_left = None;
                self.restart_at_us = self.restart_after_us.map(|us| self.now_us + us);
            }
        }
    }

    fn publish(&mut self, key: &str, payload: Vec<u8>, json: bool, lane: Lane) {
        match self.config.keys.parse(key).expect("one of our keys") {
            Topic::Job { job } => {
                assert!(json && lane == Lane::Record);
                let record: JobRecord = serde_json::from_slice(&payload).expect("a record");
                let row = &self.rows[&(Table::Jobs, job.to_owned())];
                let entry: JobEntry = serde_json::from_slice(row).expect("an entry");
                assert_eq!(entry.record, record, "published, but not persisted");
                let last = self
                    .records
                    .iter()
                    .rev()
                    .find(|last| last.job == record.job);
                if let Some(last) = last {
                    if self.died && record.version == last.version {
                        assert_eq!(*last, record, "told again after a start");
                        return;
                    }
                    let next = record.version == last.version + 1;
                    let skips = self.died && record.version > last.version;
                    assert!(next || skips, "{last:?} {record:?}");
                    let again = last.state == JobState::Rejected;
                    assert!(
                        !last.state.is_final() || again,
                        "seed {}: {last:?} {record:?}",
                        self.seed
                    );
                    assert!(record.updated >= last.updated);
                    assert!(again || record.progress.done >= last.progress.done);
                } else {
                    assert!(record.version == 1 || self.died, "{record:?}");
                }
                self.records.push(record);
            }
            Topic::StartPlan { job } => {
                assert!(json && lane == Lane::Record);
                let plan: StartPlan = serde_json::from_slice(&payload).expect("a plan");
                assert_eq!(plan.job.as_str(), job);
                assert_eq!(plan.told.0, self.now().0, "told at once");
                self.plans.push(plan);
            }
            Topic::Node {
                node,
                topic: NodeTopic::State,
            } => {
                assert!(json && lane == Lane::Record);
                let record: NodeRecord = serde_json::from_slice(&payload).expect("a record");
                assert_eq!(record.node.as_str(), node);
                self.node_records.push((self.now_us, record));
            }
            Topic::Node {
                topic: NodeTopic::Stop,
                ..
            } => {
                assert!(json && lane == Lane::RealTime);
                self.publish_stop(key, &payload);
            }
            Topic::Node { node, topic } => {
                let id = NodeId::new(node).expect("legal");
                assert!(!json);
                match topic {
                    NodeTopic::Batch => assert_eq!(lane, Lane::Order),
                    NodeTopic::Clock => assert_eq!(lane, Lane::RealTime),
                    NodeTopic::Start => self.check_start(lane, &payload),
                    other => panic!("the gateway says nothing on {other:?}"),
                }
                self.sent
                    .push((self.call_count, id, topic, lane, payload.clone()));
                self.send(Message {
                    node: id,
                    to_node: true,
                    topic,
                    payload,
                });
            }
            other => panic!("the gateway says nothing on {other:?}"),
        }
    }

    /// What is said of a start takes its lane, and a commit's plan is in the store.
    fn check_start(&self, lane: Lane, payload: &[u8]) {
        let message: StartMessage = keys::version::decode(payload).expect("a start message");
        let StartMessage::Commit { .. } = message else {
            assert_eq!(lane, Lane::RealTime);
            return;
        };
        assert_eq!(lane, Lane::Commit);
        let planned = self.rows.iter().any(|((table, _), row)| {
            *table == Table::Jobs
                && serde_json::from_slice::<JobEntry>(row)
                    .is_ok_and(|entry| entry.group.is_some_and(|group| !group.planned.is_empty()))
        });
        assert!(planned, "committed, but not persisted");
    }

    fn publish_stop(&mut self, key: &str, payload: &[u8]) {
        let Some(Topic::Node { node, .. }) = self.config.keys.parse(key) else {
            panic!("no stop key")
        };
        let pattern = node.to_owned();
        let matching: Vec<NodeId> = self
            .nodes
            .keys()
            .filter(|id| pattern == "*" || pattern == id.as_str())
            .copied()
            .collect();
        for node in matching {
            self.send(Message {
                node,
                to_node: true,
                topic: NodeTopic::Stop,
                payload: payload.to_vec(),
            });
        }
        let mode = keys::Stop::from_payload(payload).mode;
        assert!(matches!(mode, StopMode::Halt | StopMode::Decelerate));
        self.event(Event::Stop { pattern, mode });
    }

    fn carry_from_nodes(&mut self) {
        let mut said = Vec::new();
        for node in self.nodes.values_mut() {
            for (topic, payload) in node.take_outbox() {
                said.push(Message {
                    node: node.id,
                    to_node: false,
                    topic,
                    payload,
                });
            }
        }
        for message in said {
            self.send(message);
        }
    }

    fn send(&mut self, message: Message) {
        let faults = self.faults;
        // A stop is the one message whose loss the network may not be asked to cause: it travels
        // reliably, and a node without a link does not get it.
        let reliable = message.topic == NodeTopic::Stop;
        if !reliable && self.chance.percent(faults.drop_percent) {
            return;
        }
        let way = (message.node, message.to_node, message.topic.suffix());
        let mut at_least_us = 0;
        let mut again_us = None;
        if matches!(
            message.topic,
            NodeTopic::Start | NodeTopic::Batch | NodeTopic::Ack
        ) {
            let spoil = self.spoils.get(&self.start_message_count).copied();
            self.start_message_count += 1;
            match spoil {
                None => {}
                Some(Spoil::Lose) => return,
                Some(Spoil::Twice(later_us)) => again_us = Some(later_us),
                Some(Spoil::Late(us)) => {
                    self.held_until.insert(way, self.now_us + us);
                }
                Some(Spoil::Silence) => {
                    self.held_until.insert(way, u64::MAX);
                }
            }
            at_least_us = self.held_until.get(&way).copied().unwrap_or(0);
            if at_least_us == u64::MAX {
                return;
            }
        }
        let copies = if self.chance.percent(faults.duplicate_percent) {
            2
        } else {
            1
        };
        for _ in 0..copies {
            let spread = faults.delay_us_max - faults.delay_us_min + 1;
            let at_us = self.now_us + faults.delay_us_min + self.chance.below(spread);
            let at_us = at_us.max(at_least_us);
            self.next_number += 1;
            self.network
                .insert((at_us, self.next_number), message.clone());
            if let Some(later_us) = again_us {
                self.next_number += 1;
                self.network
                    .insert((at_us + later_us, self.next_number), message.clone());
            }
        }
    }

    fn deliver(&mut self, message: Message) {
        let now_us = self.now_us;
        let node = self.nodes.get_mut(&message.node).expect("was added");
        if message.to_node {
            if !node.link_up {
                return;
            }
            node.handle(message.topic, &message.payload, now_us);
            self.carry_from_nodes();
        } else {
            self.event(Event::FromNode {
                node: message.node,
                topic: message.topic,
                payload: message.payload,
            });
        }
    }
}

/// A job's name.
pub fn id(text: &str) -> JobId {
    JobId::new(text).expect("legal")
}

/// A job of moves on axis 0, each of so many steps 100 µs apart.
pub fn moves(name: &str, count: usize, steps: i32) -> Value {
    let each = serde_json::json!({"move": {"axis": 0, "delay_us": 100, "steps": steps}});
    serde_json::json!({"id": name, "commands": vec![each; count]})
}

/// Code and message of an error reply.
pub fn error_of(reply: &Value) -> (String, String) {
    let text = |name: &str| {
        let value = &reply["error"][name];
        value
            .as_str()
            .unwrap_or_else(|| panic!("no error: {reply}"))
            .to_owned()
    };
    (text("code"), text("message"))
}
