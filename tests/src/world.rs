//! [`World`]: everything, and the loop that goes from one event to the next.

use crate::{
    Faults, Random,
    gateway_process::GatewayProcess,
    network::{Message, Network},
};
use emulator::{
    EmulatedNode, EmulatorConfig, Recording,
    clock::LocalClock,
    pins::{Pin, PinEvent},
};
use gateway::{
    fleet::{
        FleetConfig,
        event::{Effect, Event, ReplyTo},
        node::Wish,
    },
    job::parse,
};
use keys::{
    JobId, Keys, LocalMicros, NodeId, NodeTopic, Stop, StopMode, Topic,
    record::{JobRecord, NodeRecord},
};
use std::collections::BTreeMap;

/// When every world begins: FleetMicros of 2026-11-21 03:00:00 UTC.
pub const EPOCH_US: u64 = 1_795_230_000_000_000;

/// One second, µs.
pub const S: u64 = 1_000_000;

/// One millisecond, µs.
pub const MS: u64 = 1_000;

/// Ticks of the pulse hardware in one microsecond.
const TICKS_PER_US: u64 = 16;

/// Changes of pins that are kept for each boot of a node.
const EDGES_MAX: usize = 2_000_000;

/// A node and its link.
#[derive(Debug)]
pub struct Machine {
    /// The node. On the heap: a map moves its values about on the stack.
    pub node: Box<EmulatedNode>,
    clock: LocalClock,
    drift_ppb: i64,
    /// The link carries messages.
    wired: bool,
    /// The node knows that its link is up.
    link_known: bool,
    /// The gateway knows that the node is alive.
    token_known: bool,
    /// When the node notices that its link is gone.
    notices_at_us: Option<u64>,
    /// When the gateway notices.
    missed_at_us: Option<u64>,
    /// When the link is mended.
    returns_at_us: Option<u64>,
}

/// A get and what came back.
#[derive(Clone, Debug, Default)]
pub struct Answers {
    /// Key (`None`: an error reply) and JSON.
    pub replies: Vec<(Option<String>, serde_json::Value)>,
    /// No more will come.
    pub ended: bool,
}

/// What a gateway does whose fleet another one has taken over.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum OldOwner {
    /// It goes on as if nothing had happened.
    Present,
    /// It hears no node and is heard by none, for this long, µs.
    CutOff(u64),
    /// Its machine sleeps for this long, µs, and knows nothing of it.
    Asleep(u64),
}

/// A gateway that was replaced. It has no say with clients: what it told them was durable, and they
/// follow the versions of records.
#[derive(Debug)]
struct Replaced {
    gateway: GatewayProcess,
    /// Until then it is cut off.
    cut_until_us: u64,
    /// Until then it sleeps.
    sleeps_until_us: u64,
}

/// A fleet in a bottle.
#[derive(Debug)]
pub struct World {
    /// What goes wrong on the way.
    pub faults: Faults,
    /// Where every random number comes from.
    pub random: Random,
    recording: Recording,
    now_us: u64,
    keys: Keys,
    gateway: GatewayProcess,
    replaced: Vec<Replaced>,
    network: Network,
    machines: BTreeMap<NodeId, Machine>,
    returns_at_us: Option<u64>,
    gets: BTreeMap<ReplyTo, Answers>,
    asked: u64,
    /// Every version of every record that clients were told, in order.
    pub records: BTreeMap<JobId, Vec<JobRecord>>,
    /// The last record of each node that clients were told.
    pub node_records: BTreeMap<NodeId, NodeRecord>,
}

impl World {
    /// Makes a gateway that runs and no nodes.
    pub fn new(seed: u64) -> Self {
        let keys = Keys::default();
        let mut world = Self {
            faults: Faults::NONE,
            random: Random(seed),
            recording: Recording::Edges { max: EDGES_MAX },
            now_us: EPOCH_US,
            gateway: GatewayProcess::new(FleetConfig::new(keys.clone())),
            keys,
            replaced: Vec::new(),
            network: Network::new(seed),
            machines: BTreeMap::new(),
            returns_at_us: None,
            gets: BTreeMap::new(),
            asked: 0,
            records: BTreeMap::new(),
            node_records: BTreeMap::new(),
        };
        world.gateway.start(world.now_us, &mut world.random);
        world
    }

    /// Makes a world with these nodes, ready.
    pub fn with_nodes(seed: u64, names: &[&str]) -> Self {
        let mut world = Self::new(seed);
        for name in names {
            world.add_node(EmulatorConfig::new(NodeId::new(name).expect("legal")), 0);
        }
        world.run_for(100 * MS);
        world
    }

    /// Sets what is recorded of nodes that are added from now on: everything by default, which a
    /// life of hours has no room for.
    pub fn set_recording(&mut self, recording: Recording) {
        self.recording = recording;
    }

    /// Forgets the records of jobs that have ended, and answers that are complete.
    pub fn forget_ended(&mut self) {
        let has_end = |records: &Vec<JobRecord>| records.last().is_some_and(|r| r.state.is_final());
        self.records.retain(|_, records| !has_end(records));
        self.gets.retain(|_, answers| !answers.ended);
    }

    /// Switches a node on whose clock is too fast by `drift_ppb`.
    pub fn add_node(&mut self, mut config: EmulatorConfig, drift_ppb: i64) {
        config.record = self.recording;
        config.seed = self.random.number();
        let name = config.name;
        let offset_us = self.random.below(1 << 40);
        let machine = Machine {
            clock: LocalClock::new(self.now_us, offset_us, drift_ppb),
            drift_ppb,
            node: Box::new(EmulatedNode::new(config, self.random.number() as u32)),
            wired: true,
            link_known: false,
            token_known: false,
            notices_at_us: None,
            missed_at_us: None,
            returns_at_us: Some(self.now_us),
        };
        self.machines.insert(name, machine);
        self.mend(name);
    }

    /// Lets the rates of all clocks wander, as crystals do with temperature: a random walk of
    /// `ppb_per_sqrt_s`, one step of it for the time that has passed since the last call.
    pub fn wander(&mut self, passed_us: u64, ppb_per_sqrt_s: f64) {
        for machine in self.machines.values_mut() {
            let step = ppb_per_sqrt_s * (passed_us as f64 / 1e6).sqrt() * self.random.normal();
            machine.drift_ppb += step as i64;
            machine.clock.set_drift(self.now_us, machine.drift_ppb);
        }
    }

    /// Returns the time, µs since 1970.
    pub fn now_us(&self) -> u64 {
        self.now_us
    }

    /// Returns the nodes.
    pub fn machines(&self) -> &BTreeMap<NodeId, Machine> {
        &self.machines
    }

    /// Returns a node.
    ///
    /// # Panics
    /// There is none of this name.
    pub fn node(&self, name: &str) -> &EmulatedNode {
        &self.machines[&NodeId::new(name).expect("legal")].node
    }

    /// Changes something on a node, as a person in front of it could.
    ///
    /// # Panics
    /// There is none of this name.
    pub fn node_mut(&mut self, name: &str, change: impl FnOnce(&mut EmulatedNode)) {
        let id = NodeId::new(name).expect("legal");
        change(&mut self.machines.get_mut(&id).expect("a node").node);
    }

    /// Returns when the active edge of this number since boot left a node, in real time, µs; `None`
    /// if it has not. Real time is what no node and no gateway knows: only the world does. The
    /// node's clock must not have wandered since.
    ///
    /// # Panics
    /// There is no node of this name.
    pub fn edge_us(&self, name: &str, number: usize) -> Option<f64> {
        let machine = &self.machines[&NodeId::new(name).expect("legal")];
        let rise = rises(&machine.node).nth(number)?;
        let local_us = LocalMicros(rise.at_ticks / TICKS_PER_US);
        let real_us = machine.clock.real_from_local(local_us) as f64;
        Some(real_us + (rise.at_ticks % TICKS_PER_US) as f64 / TICKS_PER_US as f64)
    }

    /// Returns how many active edges have left a node since its boot.
    ///
    /// # Panics
    /// There is no node of this name.
    pub fn edge_count(&self, name: &str) -> usize {
        rises(&self.machines[&NodeId::new(name).expect("legal")].node).count()
    }

    /// Returns the latest record of a job that clients were told.
    ///
    /// # Panics
    /// There is none.
    pub fn record(&self, job: &str) -> &JobRecord {
        let records = &self.records[&JobId::new(job).expect("legal")];
        records.last().expect("a list begins with its first entry")
    }

    // ── clients ──

    /// Publishes a job by get. The receipt comes later: see [`World::answers`].
    pub fn submit(&mut self, pattern: &str, job: &serde_json::Value) -> ReplyTo {
        let reply = self.ask();
        let parsed = parse::parse("application/json", job.to_string().as_bytes());
        self.tell(Event::Submit {
            pattern: pattern.to_owned(),
            request: parsed.request,
            id_hint: parsed.id_hint,
            reply: Some(reply),
        });
        reply
    }

    /// Publishes a synchronized job by get.
    pub fn submit_group(&mut self, group: &str, job: &serde_json::Value) -> ReplyTo {
        let reply = self.ask();
        let parsed = parse::parse_group("application/json", job.to_string().as_bytes());
        self.tell(Event::SubmitGroup {
            pattern: group.to_owned(),
            request: parsed.request,
            id_hint: parsed.id_hint,
            reply: Some(reply),
        });
        reply
    }

    /// Cancels a job.
    pub fn cancel(&mut self, job: &str) -> ReplyTo {
        let reply = self.ask();
        self.tell(Event::Cancel {
            pattern: job.to_owned(),
            reply: Some(reply),
        });
        reply
    }

    /// Lifts the stop latch of a node.
    pub fn release(&mut self, node: &str) -> ReplyTo {
        let reply = self.ask();
        self.tell(Event::Release {
            pattern: node.to_owned(),
            reply: Some(reply),
        });
        reply
    }

    /// Holds, resumes or changes the speed of a node.
    pub fn pace(&mut self, node: &str, wish: Wish) -> ReplyTo {
        let reply = self.ask();
        self.tell(Event::Pace {
            pattern: node.to_owned(),
            wish: Ok(wish),
            reply: Some(reply),
        });
        reply
    }

    /// Puts a stop on a node's key: node and gateway hear it, each if its link is there.
    pub fn stop(&mut self, node: &str, mode: StopMode) {
        self.tell(Event::Stop {
            pattern: node.to_owned(),
            mode,
        });
        let node = NodeId::new(node).expect("legal");
        self.send_to(node, NodeTopic::Stop, Stop { mode }.to_payload().to_vec());
    }

    /// Returns what came back to a get so far.
    pub fn answers(&self, of: ReplyTo) -> Answers {
        self.gets.get(&of).cloned().unwrap_or_default()
    }

    fn ask(&mut self) -> ReplyTo {
        self.asked += 1;
        ReplyTo(self.asked)
    }

    // ── what goes wrong ──

    /// Breaks a node's link for this long. Node and gateway notice each in its own time.
    pub fn break_link(&mut self, node: &str, for_us: u64) {
        let name = NodeId::new(node).expect("legal");
        self.break_link_of(name, for_us);
    }

    fn break_link_of(&mut self, name: NodeId, for_us: u64) {
        self.network.cut(name);
        let (notices_us, missed_us) = (self.random.below(3 * S), self.random.below(3 * S));
        let now_us = self.now_us;
        let machine = self.machines.get_mut(&name).expect("a node");
        machine.wired = false;
        machine.notices_at_us = machine.link_known.then_some(now_us + notices_us);
        machine.missed_at_us = machine.token_known.then_some(now_us + missed_us);
        machine.returns_at_us = Some(now_us + for_us);
    }

    /// Restarts a router between the gateway and all nodes: every link is broken at once, and each
    /// node comes back in its own time within `within_us` after `for_us`.
    pub fn restart_router(&mut self, for_us: u64, within_us: u64) {
        for name in self.names() {
            let later_us = self.random.below(within_us);
            self.break_link_of(name, for_us + later_us);
        }
    }

    /// Lets a node neither hear nor be heard for this long, while its link stands: a channel that
    /// is held, or a peer that reads nothing. What was sent arrives afterwards, in order.
    pub fn stall(&mut self, node: &str, for_us: u64) {
        let name = NodeId::new(node).expect("legal");
        for to_node in [true, false] {
            self.network.stall(name, to_node, self.now_us + for_us);
        }
    }

    /// Lets a node's crystal change its rate to `drift_ppb`.
    pub fn set_drift(&mut self, node: &str, drift_ppb: i64) {
        let machine = self.machines.get_mut(&NodeId::new(node).expect("legal"));
        let machine = machine.expect("a node");
        machine.drift_ppb = drift_ppb;
        machine.clock.set_drift(self.now_us, drift_ppb);
    }

    /// Lets a node's clock jump ahead: to the node this much time has passed at once.
    pub fn jump_clock(&mut self, node: &str, ahead_us: u64) {
        let machine = self.machines.get_mut(&NodeId::new(node).expect("legal"));
        machine.expect("a node").clock.jump(self.now_us, ahead_us);
    }

    /// Lets the gateway's next write fail: the disk is full. It ends then, and starts again with
    /// room on the disk.
    pub fn fill_disk(&mut self) {
        self.gateway.fail_disk();
    }

    /// Sets the wall clock that the gateway reads at its next start, µs beyond the world's time.
    /// It must be down.
    pub fn set_gateway_clock_ahead(&mut self, us: i64) {
        self.gateway.set_clock_ahead(us);
    }

    /// Cuts a node's power and lets it boot again; it is back after this long.
    pub fn reboot(&mut self, node: &str, after_us: u64) {
        let name = NodeId::new(node).expect("legal");
        self.break_link_of(name, after_us);
        let boot = self.random.number() as u32;
        let offset_us = self.random.below(1 << 40);
        let machine = self.machines.get_mut(&name).expect("a node");
        machine.node.reset(boot);
        machine.clock = LocalClock::new(self.now_us, offset_us, machine.drift_ppb);
        machine.link_known = false;
        machine.notices_at_us = None;
    }

    /// Kills the gateway, and with it the router; it starts again after this long.
    pub fn kill_gateway(&mut self, for_us: u64) {
        self.gateway.kill(&mut self.random);
        self.lose_gateway(for_us);
    }

    /// Lets another gateway take the store and the fleet, while the present one does not know that it
    /// has lost them. `copied`: its store lets it write on, into a copy. Nothing if there is none.
    pub fn hand_over(&mut self, old: OldOwner, copied: bool) {
        if !self.gateway.is_up() {
            return;
        }
        let next = self.gateway.hand_over(copied, &mut self.random);
        let gateway = std::mem::replace(&mut self.gateway, next);
        let until_us = |us: u64| self.now_us + us;
        self.replaced.push(Replaced {
            gateway,
            cut_until_us: match old {
                OldOwner::CutOff(us) => until_us(us),
                _ => 0,
            },
            sleeps_until_us: match old {
                OldOwner::Asleep(us) => until_us(us),
                _ => 0,
            },
        });
        // Whoever waited for a reply of the old one gets none.
        let waiting = self.gets.values_mut();
        waiting.for_each(|answers| answers.ended = true);
        self.gateway.start(self.now_us, &mut self.random);
    }

    /// Returns how many gateways still believe that the fleet is theirs, beside the one that has it.
    pub fn replaced_count(&self) -> usize {
        self.replaced.len()
    }

    fn lose_gateway(&mut self, for_us: u64) {
        self.returns_at_us = Some(self.now_us + for_us);
        self.gets
            .values_mut()
            .for_each(|answers| answers.ended = true);
        for name in self.names() {
            self.network.cut(name);
            let machine = self.machines.get_mut(&name).expect("a node");
            machine.wired = false;
            machine.token_known = false;
            machine.missed_at_us = None;
            machine.notices_at_us = machine.link_known.then_some(self.now_us);
            let later_us = self.random.below(500 * MS);
            machine.returns_at_us = Some(self.now_us + for_us + later_us);
        }
    }

    // ── time ──

    /// Lets this much time pass.
    pub fn run_for(&mut self, us: u64) {
        let until_us = self.now_us + us;
        while let Some(at_us) = self.next_at().filter(|at_us| *at_us <= until_us) {
            self.now_us = self.now_us.max(at_us);
            self.step();
        }
        self.now_us = until_us;
        self.step();
    }

    /// Lets time pass until this is true.
    ///
    /// # Panics
    /// It is not after `most_us`.
    pub fn run_until(&mut self, most_us: u64, mut is_so: impl FnMut(&Self) -> bool) {
        let until_us = self.now_us + most_us;
        while !is_so(self) {
            let at_us = self.next_at().expect("something is due");
            assert!(at_us <= until_us, "it did not come to that in {most_us} µs");
            self.now_us = self.now_us.max(at_us);
            self.step();
        }
    }

    fn names(&self) -> Vec<NodeId> {
        self.machines.keys().copied().collect()
    }

    fn next_at(&self) -> Option<u64> {
        let nodes = self.machines.values().flat_map(|machine| {
            let node = machine.node.poll_timeout();
            [
                node.map(|at| machine.clock.real_from_local(at)),
                machine.notices_at_us,
                machine.missed_at_us,
                // Without a router there is nothing to come back to.
                machine.returns_at_us.filter(|_| self.gateway.is_up()),
            ]
        });
        let others = [
            self.network.next_at(),
            self.gateway.next_at(),
            self.returns_at_us,
        ];
        let replaced = self.replaced.iter().map(|old| {
            let at_us = old.gateway.next_at()?;
            Some(at_us.max(old.sleeps_until_us))
        });
        nodes.chain(others).chain(replaced).flatten().min()
    }

    /// Does everything that is due now.
    fn step(&mut self) {
        let now_us = self.now_us;
        if self.returns_at_us.is_some_and(|at_us| at_us <= now_us) {
            self.returns_at_us = None;
            self.gateway.start(now_us, &mut self.random);
        }
        for name in self.names() {
            self.step_link(name);
        }
        while let Some(message) = self.network.arrived(now_us) {
            self.deliver(message);
        }
        for name in self.names() {
            let machine = self.machines.get_mut(&name).expect("a node");
            let local = machine.clock.local_from_real(now_us);
            if machine.node.poll_timeout().is_some_and(|due| due <= local) {
                machine.node.poll(local);
            }
            self.drain(name);
        }
        let effects = self.gateway.poll(now_us, &mut self.random);
        self.carry_out(effects);
        self.step_replaced();
        if self.gateway.take_crash() {
            let for_us = self.random.below(2 * S);
            self.lose_gateway(for_us);
        }
    }

    fn step_replaced(&mut self) {
        let now_us = self.now_us;
        for mut old in std::mem::take(&mut self.replaced) {
            if old.sleeps_until_us <= now_us {
                let effects = old.gateway.poll(now_us, &mut self.random);
                self.carry_out_of_replaced(&old, effects);
            }
            if !old.gateway.take_crash() {
                self.replaced.push(old);
            }
        }
    }

    /// What comes from nodes, and what clients want that needs no store, the replaced ones hear too.
    fn tell_replaced(&mut self, event: &Event) {
        let now_us = self.now_us;
        for mut old in std::mem::take(&mut self.replaced) {
            let event = match event.clone() {
                event @ (Event::FromNode { .. } | Event::Stop { .. }) => Some(event),
                Event::Release { pattern, .. } => Some(Event::Release {
                    pattern,
                    reply: None,
                }),
                Event::Pace { pattern, wish, .. } => Some(Event::Pace {
                    pattern,
                    wish,
                    reply: None,
                }),
                _ => None,
            };
            let hears = old.sleeps_until_us <= now_us && old.cut_until_us <= now_us;
            if let Some(event) = event.filter(|_| hears) {
                let effects = old.gateway.handle(event, now_us, &mut self.random);
                self.carry_out_of_replaced(&old, effects);
            }
            self.replaced.push(old);
        }
    }

    fn carry_out_of_replaced(&mut self, old: &Replaced, effects: Vec<Effect>) {
        if old.cut_until_us > self.now_us {
            return;
        }
        for effect in effects {
            let Effect::Publish { key, payload, .. } = effect else {
                continue;
            };
            let keys = self.keys.clone();
            match keys.parse(&key) {
                Some(Topic::Node { node, topic }) if topic != NodeTopic::State => {
                    let node = NodeId::new(node).expect("orders go to one node");
                    self.send_to(node, topic, payload);
                }
                _ => {}
            }
        }
    }

    fn step_link(&mut self, name: NodeId) {
        let now_us = self.now_us;
        let due = |at_us: &mut Option<u64>| at_us.take_if(|at_us| *at_us <= now_us).is_some();
        let gateway_up = self.gateway.is_up();
        let machine = self.machines.get_mut(&name).expect("a node");
        let local = machine.clock.local_from_real(now_us);
        if due(&mut machine.notices_at_us) {
            machine.link_known = false;
            machine.node.link(false, local);
        }
        if due(&mut machine.missed_at_us) {
            machine.token_known = false;
            self.tell(Event::Alive {
                node: name,
                alive: false,
            });
        }
        let machine = self.machines.get_mut(&name).expect("a node");
        if gateway_up && due(&mut machine.returns_at_us) {
            self.mend(name);
        }
    }

    fn mend(&mut self, name: NodeId) {
        let machine = self.machines.get_mut(&name).expect("a node");
        let local = machine.clock.local_from_real(self.now_us);
        machine.wired = true;
        machine.returns_at_us = None;
        machine.notices_at_us = None;
        // Whoever had not noticed sees a new session, which begins with the end of the old one.
        if machine.link_known {
            machine.node.link(false, local);
        }
        machine.link_known = true;
        machine.node.link(true, local);
        let known = machine.token_known && machine.missed_at_us.take().is_some();
        machine.token_known = true;
        if !known {
            self.tell(Event::Alive {
                node: name,
                alive: true,
            });
        }
        self.drain(name);
    }

    fn deliver(&mut self, message: Message) {
        let Message {
            node,
            to_node,
            topic,
            payload,
        } = message;
        if !to_node {
            self.tell(Event::FromNode {
                node,
                topic,
                payload,
            });
            return;
        }
        let machine = self.machines.get_mut(&node).expect("a node");
        if !machine.link_known {
            return;
        }
        let local = machine.clock.local_from_real(self.now_us);
        machine.node.handle(topic, &payload, local);
        self.drain(node);
    }

    /// Sends what a node has to say.
    fn drain(&mut self, name: NodeId) {
        let machine = self.machines.get_mut(&name).expect("a node");
        let local: LocalMicros = machine.clock.local_from_real(self.now_us);
        let wired = machine.wired;
        for outbound in machine.node.outbox(local) {
            let of_gateway = matches!(
                outbound.topic,
                NodeTopic::Status
                    | NodeTopic::Ack
                    | NodeTopic::Clock
                    | NodeTopic::Start
                    | NodeTopic::Report
                    | NodeTopic::Pace
            );
            // Into a broken link a node can speak until it notices.
            if wired && of_gateway {
                let message = Message {
                    node: name,
                    to_node: false,
                    topic: outbound.topic,
                    payload: outbound.payload.to_vec(),
                };
                self.network
                    .send(message, self.now_us, &self.faults, &mut self.random);
            }
        }
    }

    fn send_to(&mut self, node: NodeId, topic: NodeTopic, payload: Vec<u8>) {
        if self
            .machines
            .get(&node)
            .is_some_and(|machine| machine.wired)
        {
            let message = Message {
                node,
                to_node: true,
                topic,
                payload,
            };
            self.network
                .send(message, self.now_us, &self.faults, &mut self.random);
        }
    }

    fn tell(&mut self, event: Event) {
        if !self.replaced.is_empty() {
            self.tell_replaced(&event);
        }
        let effects = self.gateway.handle(event, self.now_us, &mut self.random);
        self.carry_out(effects);
    }

    fn carry_out(&mut self, effects: Vec<Effect>) {
        for effect in effects {
            match effect {
                Effect::Persist(_) => unreachable!("the disk has taken it"),
                Effect::Publish { key, payload, .. } => self.publish(&key, payload),
                Effect::Reply { to, key, payload } => {
                    let json = serde_json::from_slice(&payload).expect("replies are JSON");
                    self.gets.entry(to).or_default().replies.push((key, json));
                }
                Effect::ReplyEnd { to } => self.gets.entry(to).or_default().ended = true,
            }
        }
    }

    fn publish(&mut self, key: &str, payload: Vec<u8>) {
        let keys = self.keys.clone();
        match keys.parse(key).expect("a key of the fleet") {
            Topic::Node {
                node,
                topic: NodeTopic::State,
            } => {
                let record: NodeRecord = serde_json::from_slice(&payload).expect("a node record");
                assert_eq!(record.node.as_str(), node);
                self.node_records.insert(record.node, record);
            }
            Topic::Node { node, topic } => {
                let node = NodeId::new(node).expect("orders go to one node");
                self.send_to(node, topic, payload);
            }
            Topic::Job { job } => {
                let record: JobRecord = serde_json::from_slice(&payload).expect("a job record");
                assert_eq!(record.job.as_str(), job);
                self.records.entry(record.job).or_default().push(record);
            }
            Topic::StartPlan { .. } => {}
            other => panic!("the gateway does not publish on {other:?}"),
        }
    }
}

fn rises(node: &EmulatedNode) -> impl Iterator<Item = &PinEvent> {
    let edges = node.edges().iter();
    edges.filter(|edge| matches!(edge.pin, Pin::Step(_)) && edge.level)
}
