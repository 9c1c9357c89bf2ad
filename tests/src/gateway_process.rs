//! The gateway as a process that can be killed: its memory is lost, its disk is not.

use crate::Random;
use gateway::fleet::{
    Fleet, FleetConfig, Stored,
    event::{Effect, Event, Table, Write},
};
use keys::FleetMicros;
use std::collections::{BTreeMap, VecDeque};

/// Longest time from a change to its place on the disk, µs.
const COMMIT_US_MAX: u64 = 3_000;

/// One group of effects that wait for the disk.
#[derive(Debug)]
struct Group {
    due_us: u64,
    effects: Vec<Effect>,
}

/// The gateway of a [`World`](crate::World).
#[derive(Debug)]
pub struct GatewayProcess {
    config: FleetConfig,
    fleet: Option<Fleet>,
    disk: BTreeMap<(Table, String), Vec<u8>>,
    waiting: VecDeque<Group>,
    starts: u64,
    /// What its wall clock shows beyond the world's time, µs.
    clock_ahead_us: i64,
    /// The next commit fails.
    disk_fails: bool,
    /// It has ended by itself, and nobody has asked yet.
    crashed: bool,
}

impl GatewayProcess {
    /// Makes one that is not started, with an empty disk.
    pub fn new(config: FleetConfig) -> Self {
        Self {
            config,
            fleet: None,
            disk: BTreeMap::new(),
            waiting: VecDeque::new(),
            starts: 0,
            clock_ahead_us: 0,
            disk_fails: false,
            crashed: false,
        }
    }

    /// Returns whether it runs.
    pub fn is_up(&self) -> bool {
        self.fleet.is_some()
    }

    /// Starts it from its disk.
    ///
    /// # Panics
    /// The disk does not hold what a gateway wrote.
    pub fn start(&mut self, now_us: u64, random: &mut Random) {
        let mut stored = Stored::default();
        for ((table, key), value) in &self.disk {
            let rows = match table {
                Table::Requests => &mut stored.requests,
                Table::Jobs => &mut stored.jobs,
                Table::Nodes => &mut stored.nodes,
                Table::Kept => &mut stored.kept,
            };
            rows.push((key.clone(), value.clone()));
        }
        let mut effects = Vec::new();
        self.starts += 1;
        self.disk_fails = false;
        let fleet = Fleet::restore(
            self.config.clone(),
            self.starts,
            stored,
            self.clock(now_us),
            &mut effects,
        )
        .expect("a gateway can read its own disk");
        self.fleet = Some(fleet);
        self.wait_for_disk(effects, now_us, random);
    }

    /// Sets the wall clock that the next start reads, µs beyond the world's time: a computer
    /// without a battery, or one that has just asked a time server.
    pub fn set_clock_ahead(&mut self, us: i64) {
        debug_assert!(!self.is_up(), "a gateway reads the wall clock once");
        self.clock_ahead_us = us;
    }

    fn clock(&self, now_us: u64) -> FleetMicros {
        FleetMicros(now_us.saturating_add_signed(self.clock_ahead_us))
    }

    /// Lets the next commit fail: the disk is full. None of it is written, none of what waited for
    /// it is told, and the gateway ends.
    pub fn fail_disk(&mut self) {
        self.disk_fails = self.is_up();
    }

    /// Returns, once, that it has ended by itself.
    pub fn take_crash(&mut self) -> bool {
        std::mem::take(&mut self.crashed)
    }

    /// Kills it. Of what waited for the disk, some may have come so far without being told.
    pub fn kill(&mut self, random: &mut Random) {
        self.fleet = None;
        let written = random.below(self.waiting.len() as u64 + 1) as usize;
        let groups: Vec<_> = self.waiting.drain(..).take(written).collect();
        for group in groups {
            for effect in group.effects {
                if let Effect::Persist(write) = effect {
                    self.write(write);
                }
            }
        }
    }

    /// Tells it what happened. Effects that wait for no disk come back at once.
    pub fn handle(&mut self, event: Event, now_us: u64, random: &mut Random) -> Vec<Effect> {
        let Some(fleet) = self.fleet.as_mut() else {
            return Vec::new();
        };
        let mut effects = Vec::new();
        let now = FleetMicros(now_us.saturating_add_signed(self.clock_ahead_us));
        fleet.handle(event, now, &mut effects);
        let (at_once, rest) = effects.into_iter().partition(|effect| {
            matches!(
                effect,
                Effect::Publish {
                    lane: gateway::fleet::event::Lane::RealTime,
                    ..
                }
            )
        });
        self.wait_for_disk(rest, now_us, random);
        at_once
    }

    fn wait_for_disk(&mut self, effects: Vec<Effect>, now_us: u64, random: &mut Random) {
        if effects.is_empty() {
            return;
        }
        let before = self.waiting.back().map_or(0, |group| group.due_us);
        let due_us = (now_us + random.below(COMMIT_US_MAX)).max(before);
        self.waiting.push_back(Group { due_us, effects });
    }

    fn write(&mut self, write: Write) {
        match write {
            Write::Put { table, key, value } => {
                self.disk.insert((table, key), value);
            }
            Write::Remove { table, key } => {
                self.disk.remove(&(table, key));
            }
        }
    }

    /// Returns when it has something to do by itself.
    pub fn next_at(&self) -> Option<u64> {
        let disk = self.waiting.front().map(|group| group.due_us);
        let fleet = self.fleet.as_ref().and_then(Fleet::poll_timeout);
        let fleet = fleet.map(|at| at.0.saturating_add_signed(-self.clock_ahead_us));
        [disk, fleet].into_iter().flatten().min()
    }

    /// Does what is due: the disk first.
    pub fn poll(&mut self, now_us: u64, random: &mut Random) -> Vec<Effect> {
        let mut done = Vec::new();
        while self
            .waiting
            .front()
            .is_some_and(|group| group.due_us <= now_us)
        {
            let group = self.waiting.pop_front().expect("there is one");
            let writes = |effect: &Effect| matches!(effect, Effect::Persist(_));
            if self.disk_fails && group.effects.iter().any(writes) {
                self.fleet = None;
                self.waiting.clear();
                self.crashed = true;
                return done;
            }
            for effect in group.effects {
                match effect {
                    Effect::Persist(write) => self.write(write),
                    other => done.push(other),
                }
            }
        }
        let due = self.fleet.as_ref().and_then(Fleet::poll_timeout);
        if due.is_some_and(|due| due <= self.clock(now_us)) {
            done.extend(self.handle(Event::Tick, now_us, random));
        }
        done
    }
}
