//! [`World`]: everything, and what can be seen of it.
//!
//! Here: what there is. `bounds`: what must not be left over. `clients`: what clients want. `mishaps`: what goes wrong. `time`: the loop
//! that goes from one event to the next. `way`: links, and what comes and goes by them.

mod bounds;
mod clients;
mod mishaps;
mod time;
mod way;

pub use clients::Answers;
pub use mishaps::OldOwner;

use crate::{Faults, Random, gateway_process::GatewayProcess, network::Network};
use emulator::{
    EmulatedNode, EmulatorConfig, Recording,
    clock::LocalClock,
    pins::{Pin, PinEvent},
};
use gateway::fleet::{FleetConfig, event::ReplyTo};
use keys::{
    JobId, Keys, LocalMicros, NodeId,
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

/// Later than any world lasts.
const NEVER_US: u64 = u64::MAX;

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
    /// When the node has something to do by itself, in real time, unless it was touched since.
    due_us: Option<u64>,
    /// Something was said or done to it since it was last looked at.
    touched: bool,
}

impl Machine {
    /// Returns when its node has something to do by itself, in real time.
    fn node_due_us(&self) -> Option<u64> {
        if self.touched {
            self.ask_due_us()
        } else {
            self.due_us
        }
    }

    fn ask_due_us(&self) -> Option<u64> {
        let at = self.node.poll_timeout()?;
        Some(self.clock.real_from_local(at))
    }

    /// It has been looked at.
    fn rest(&mut self) {
        self.due_us = self.ask_due_us();
        self.touched = false;
    }

    /// Returns when something is due, in real time, [`NEVER_US`] if nothing is: at its node, or at its
    /// link. Without a router there is nothing to come back to.
    fn due_at_us(&self, gateway_up: bool) -> u64 {
        let node_us = self.node_due_us().unwrap_or(NEVER_US);
        node_us.min(self.link_due_at_us(gateway_up))
    }

    fn link_due_at_us(&self, gateway_up: bool) -> u64 {
        let returns_us = match self.returns_at_us {
            Some(at_us) if gateway_up => at_us,
            _ => NEVER_US,
        };
        let notices_us = self.notices_at_us.unwrap_or(NEVER_US);
        let missed_us = self.missed_at_us.unwrap_or(NEVER_US);
        returns_us.min(notices_us).min(missed_us)
    }
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
            due_us: None,
            touched: true,
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
            machine.touched = true;
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
        let machine = self.machines.get_mut(&id).expect("a node");
        change(&mut machine.node);
        machine.touched = true;
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
}

fn rises(node: &EmulatedNode) -> impl Iterator<Item = &PinEvent> {
    let edges = node.edges().iter();
    edges.filter(|edge| matches!(edge.pin, Pin::Step(_)) && edge.level)
}
