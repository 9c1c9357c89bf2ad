//! The gateway as a process that can be killed: its memory is lost, its disk is not.

use crate::Random;
use gateway::{
    clock_watch::{Advice, ClockWatch, LOOK_EVERY_US, disagree},
    fleet::{
        Fleet, FleetConfig, Stored,
        event::{Effect, Event, Table, Write},
    },
    observe::Snapshot,
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
    /// What the wall clock shows beyond the world's time, µs: read at the start, and looked at then.
    wall_ahead_us: i64,
    /// What its own time shows beyond the world's, µs.
    clock_ahead_us: i64,
    watch: ClockWatch,
    /// When it looks at the wall again.
    look_at_us: u64,
    /// How often it began anew because the wall was set.
    begun_anew: u64,
    /// The next commit fails.
    disk_fails: bool,
    /// It has ended by itself, and nobody has asked yet.
    ended: bool,
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
            wall_ahead_us: 0,
            clock_ahead_us: 0,
            watch: ClockWatch::default(),
            look_at_us: 0,
            begun_anew: 0,
            disk_fails: false,
            ended: false,
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
        self.clock_ahead_us = self.wall_ahead_us;
        self.watch = ClockWatch::default();
        self.look_at_us = now_us + LOOK_EVERY_US;
        let config = FleetConfig {
            epoch: self.starts as u32,
            ..self.config.clone()
        };
        let fleet = Fleet::restore(
            config,
            self.starts,
            stored,
            self.clock(now_us),
            &mut effects,
        )
        .expect("a gateway can read its own disk");
        self.fleet = Some(fleet);
        self.wait_for_disk(effects, now_us, random);
    }

    /// Takes the store away from it, which it does not know, and returns the gateway that has it
    /// now, not yet started. Of what waited for the disk some has come so far and will be told; at
    /// the next write the old one ends. With `copied` it writes on into a copy of the store, as
    /// nothing should let it.
    pub fn hand_over(&mut self, copied: bool, random: &mut Random) -> Self {
        let written = random.below(self.waiting.len() as u64 + 1) as usize;
        for index in 0..written {
            let effects = std::mem::take(&mut self.waiting[index].effects);
            for effect in effects {
                match effect {
                    Effect::Persist(write) => self.write(write),
                    other => self.waiting[index].effects.push(other),
                }
            }
        }
        self.disk_fails = !copied;
        Self {
            disk: self.disk.clone(),
            starts: self.starts,
            wall_ahead_us: self.wall_ahead_us,
            begun_anew: self.begun_anew,
            ..Self::new(self.config.clone())
        }
    }

    /// Sets the wall clock, µs beyond the world's time: somebody does it by hand, a time server
    /// answers, a computer without a battery starts. It is read at a start; one that runs notices when
    /// it looks.
    pub fn set_wall_ahead(&mut self, us: i64) {
        self.wall_ahead_us = us;
    }

    /// Returns how often it began anew because the wall was set while it ran.
    pub fn begun_anew(&self) -> u64 {
        self.begun_anew
    }

    /// Returns the fleet, if it runs.
    pub fn fleet(&self) -> Option<&Fleet> {
        self.fleet.as_ref()
    }

    /// Returns how many rows of this table are on the disk.
    pub fn row_count(&self, of: Table) -> usize {
        self.disk.keys().filter(|(table, _)| *table == of).count()
    }

    /// Returns how many groups of effects wait for the disk.
    pub fn waiting_count(&self) -> usize {
        self.waiting.len()
    }

    fn clock(&self, now_us: u64) -> FleetMicros {
        FleetMicros(now_us.saturating_add_signed(self.clock_ahead_us))
    }

    /// Lets the next commit fail: the disk is full. None of it is written, none of what waited for
    /// it is told, and the gateway ends.
    pub fn fail_disk(&mut self) {
        self.disk_fails = self.is_up();
    }

    /// Returns, once, that it has ended by itself: its disk failed, or it begins anew.
    pub fn take_end(&mut self) -> bool {
        std::mem::take(&mut self.ended)
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
        let look = self.is_up().then_some(self.look_at_us);
        [disk, fleet, look].into_iter().flatten().min()
    }

    /// Looks at the wall if it is time for that; returns whether to begin anew.
    fn look(&mut self, now_us: u64) -> bool {
        let Some(fleet) = self.fleet.as_ref().filter(|_| self.look_at_us <= now_us) else {
            return false;
        };
        self.look_at_us = now_us + LOOK_EVERY_US;
        let ahead_us = self.wall_ahead_us - self.clock_ahead_us;
        let at_rest = disagree(ahead_us) && Snapshot::of(fleet).is_at_rest();
        self.watch.look(ahead_us, at_rest) == Advice::BeginAnew
    }

    /// Does what is due: the disk first.
    pub fn poll(&mut self, now_us: u64, random: &mut Random) -> Vec<Effect> {
        let mut done = Vec::new();
        let begins_anew = self.look(now_us);
        if begins_anew {
            // It takes nothing more, and lets out what it has.
            let waiting = self.waiting.iter_mut();
            waiting.for_each(|group| group.due_us = group.due_us.min(now_us));
        }
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
                self.ended = true;
                return done;
            }
            for effect in group.effects {
                match effect {
                    Effect::Persist(write) => self.write(write),
                    other => done.push(other),
                }
            }
        }
        if begins_anew {
            self.fleet = None;
            self.begun_anew += 1;
            self.ended = true;
            return done;
        }
        let due = self.fleet.as_ref().and_then(Fleet::poll_timeout);
        if due.is_some_and(|due| due <= self.clock(now_us)) {
            done.extend(self.handle(Event::Tick, now_us, random));
        }
        done
    }
}
