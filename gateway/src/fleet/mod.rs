//! The fleet: every job, every node, and what follows from what happens.
//!
//! ```text
//!   Event ─▶ handle ─┬─ clients' wishes ─▶ submit · cancel · stop · release · history
//!                    ├─ nodes' words ────▶ Node::handle_status · handle_ack · handle_clock
//!                    └─ time ────────────▶ the nodes and groups whose hour has come
//!                          then, for each node that was touched:
//!                    Node::poll ─▶ next job, batches, cancels, probes, record ─▶ Effects
//!                          and at the end, for each synchronized job that was touched:
//!                    settle ─▶ commit, confirm, abort, the end of all parts ─▶ Effects
//! ```
//!
//! Owns the order of things: an [`Effect::Persist`] stands before every message that depends on
//! it. Promises: an accepted job ends in exactly one final state that a node's report, a client
//! or a stop has caused; the cost of a status does not grow with the number of jobs; every list
//! has a bound in [`FleetConfig`].
//!
//! Absent on purpose: clock, socket, disk. `now` is given; what shall happen is returned.

pub mod clock;
pub mod event;
mod group;
mod history;
pub mod kept;
pub mod manage;
pub mod node;
pub mod owner;
pub mod pattern;
mod restore;
pub mod route;
pub mod sizes;
pub mod start;
mod submit;
mod timers;
mod wishes;

pub use group::parts_of;
pub use history::{LIMIT_DEFAULT, LIMIT_MAX};
pub use restore::{RestoreError, Stored};
pub use submit::commands_of;

use crate::job::{
    Job,
    book::{Book, Retention},
};
use event::{Effect, Event, ReplyTo};
use group::Group;
use keys::{
    BatchAck, FleetMicros, JobId, Keys, NodeId, NodeTopic, ScriptReport, Status,
    clock::ClockMessage,
    epoch,
    pace::PaceMessage,
    record::{ErrorReply, JobError, NodeRecord, to_json},
    start::StartMessage,
    trace::TraceEvent,
    version,
};
use node::{Node, Turn, Wish};
use std::collections::{BTreeMap, HashMap};
use timers::Timers;
use wishes::no_job;

/// Every number of the fleet, with its reason.
#[derive(Clone, Debug, PartialEq)]
pub struct FleetConfig {
    /// The prefix of all keys.
    pub keys: Keys,
    /// A node that has said nothing for so long is offline, µs. 5 s: a node at rest speaks once a
    /// second, and four of those may be lost.
    pub silence_us: u64,
    /// Batches on the way to one node. 4: a node that executes 100 short moves a second on a way
    /// of 20 ms never runs dry, and a lost one costs little.
    pub window_batches: usize,
    /// Final jobs that are kept; the oldest goes first, and its id is free again.
    pub retention_jobs: usize,
    /// Longest time that a final job is kept, µs; the newest
    /// [`KEPT_JOBS_MIN`](crate::job::book::KEPT_JOBS_MIN) may be older. A year: the question who
    /// made a part comes within its guarantee.
    pub retention_us: u64,
    /// Jobs that may wait for one node; one more is refused as `too_large`.
    pub waiting_jobs_max: usize,
    /// Commands that all jobs which are not final may hold together, 32 bytes each; a script counts
    /// as those that take as much. More are refused as `too_large`.
    pub held_commands_max: usize,
    /// Nodes that are known; another one is not heard.
    pub nodes_max: usize,
    /// Shortest time between two records of a job of which only the progress changed, µs.
    pub progress_us: u64,
    /// Shortest time between two records of one node, µs: 20 a second.
    pub node_record_us: u64,
    /// How long a stop may go without a latch before it is repeated, µs.
    pub stop_repeat_us: u64,
    /// How long a release is tried, µs.
    pub release_patience_us: u64,
    /// Epoch of this gateway, newer than those of all that had the fleet before, see [`owner`]; 0:
    /// it has none, and nodes obey it until they have heard one that has.
    pub epoch: u32,
    /// Public keys of operators: a job that none of them has signed is refused, of an empty list each
    /// one. `None`, the default: jobs need no signature.
    pub signers: Option<Vec<[u8; 32]>>,
}

impl FleetConfig {
    /// Every default, for the keys below this prefix.
    pub fn new(keys: Keys) -> Self {
        Self {
            keys,
            silence_us: 5_000_000,
            window_batches: 4,
            retention_jobs: 10_000,
            retention_us: 365 * 86_400_000_000,
            waiting_jobs_max: 1_000,
            held_commands_max: 4_000_000,
            nodes_max: 4_096,
            progress_us: 500_000,
            node_record_us: 50_000,
            stop_repeat_us: 500_000,
            release_patience_us: 3_000_000,
            epoch: 0,
            signers: None,
        }
    }
}

impl Default for FleetConfig {
    fn default() -> Self {
        Self::new(Keys::default())
    }
}

/// Every job and every node.
#[derive(Debug)]
pub struct Fleet {
    config: FleetConfig,
    book: Book,
    nodes: BTreeMap<NodeId, Node>,
    /// When each node's [`Node::poll`] is due.
    timers: Timers<NodeId>,
    /// Synchronized jobs that are not final.
    groups: HashMap<JobId, Group>,
    /// Those of which a part was sent, with the number of their nodes, and the sum of those.
    started: BTreeMap<JobId, usize>,
    meeting_count: usize,
    group_timers: Timers<JobId>,
    split_start_count: u64,
    /// Gets on `release`, `hold`, `resume` and `speed`, and how many nodes still have to answer.
    releases: HashMap<ReplyTo, usize>,
    now: FleetMicros,
    /// When this fleet heard its first event.
    started_at: Option<FleetMicros>,
    last_made_us: u64,
    random: u64,
    ignored_count: u64,
    /// Of the job that is being handed in.
    wishes: manage::JobWishes,
    kept: kept::Kept,
    /// No probe has left in this call.
    may_probe: bool,
}

impl Fleet {
    /// Begins without jobs and nodes. The seed makes ids of different gateways different.
    pub fn new(config: FleetConfig, seed: u64) -> Self {
        Self {
            book: Book::new(
                config.keys.clone(),
                Retention {
                    jobs: config.retention_jobs,
                    age_us: config.retention_us,
                },
            ),
            config,
            nodes: BTreeMap::new(),
            timers: Timers::default(),
            groups: HashMap::new(),
            started: BTreeMap::new(),
            meeting_count: 0,
            group_timers: Timers::default(),
            split_start_count: 0,
            releases: HashMap::new(),
            now: FleetMicros(0),
            started_at: None,
            last_made_us: 0,
            random: seed,
            ignored_count: 0,
            wishes: manage::JobWishes::default(),
            kept: kept::Kept::default(),
            may_probe: true,
        }
    }

    /// Takes what happened at `now` and appends what shall be done about it, in order. A `now`
    /// before the last one is taken as the last one, except as the arrival of a clock reply: a
    /// shell that stamps messages when they come may hand them on later.
    pub fn handle(&mut self, event: Event, now: FleetMicros, effects: &mut Vec<Effect>) {
        let happened_at = now;
        self.may_probe = true;
        let now = self.begin(now);
        match event {
            Event::Submit {
                pattern,
                request,
                id_hint,
                reply,
            } => self.submit(&pattern, request, id_hint, reply, effects),
            Event::SubmitGroup {
                pattern,
                request,
                id_hint,
                reply,
            } => self.submit_group(&pattern, request, id_hint, reply, effects),
            Event::SubmitWith { wishes, submit } => {
                return self.submit_with(wishes, *submit, now, effects);
            }
            Event::ManageNodes {
                pattern,
                request,
                reply,
            } => self.manage_nodes(&pattern, request, reply, effects),
            Event::ManageJob {
                job,
                request,
                reply,
            } => self.manage_job(&job, request, reply, effects),
            Event::Keep {
                kind,
                pattern,
                payload,
                reply,
            } => self.keep(kind, &pattern, &payload, reply, effects),
            Event::Cancel { pattern, reply } => self.cancel(&pattern, reply, effects),
            Event::Release { pattern, reply } => self.release(&pattern, reply, effects),
            Event::Pace {
                pattern,
                wish,
                reply,
            } => self.pace(&pattern, wish, reply, effects),
            Event::Stop { pattern, mode } => {
                for id in self.matching(&pattern) {
                    self.with_node(id, effects, |node, turn| node.handle_stop(mode, turn));
                }
            }
            Event::GetJobs {
                pattern,
                parameters,
                reply,
            } => self.get_jobs(&pattern, &parameters, reply, effects),
            Event::GetNodes { pattern, reply } => self.get_nodes(&pattern, reply, effects),
            Event::GetLinks { pattern, reply } => self.get_links(&pattern, reply, effects),
            Event::Alive { node, alive } => {
                // A token alone tells nothing; the node's status follows it.
                if !alive {
                    self.with_node(node, effects, Node::handle_token_gone);
                }
            }
            Event::FromNode {
                node,
                topic,
                payload,
            } => self.hear(node, topic, &payload, happened_at, effects),
            Event::Tick => {
                while let Some(id) = self.timers.take_due(now) {
                    self.with_node(id, effects, |_, _| {});
                }
            }
        }
        self.run_schedules(effects);
        self.settle(effects);
    }

    /// Returns when [`Event::Tick`] is due: call [`Fleet::handle`] with the `now` of that call, and
    /// ask again. At most one clock probe leaves in each call, because a probe's stamp is the
    /// `now` of its call, so this may be due again at once.
    pub fn poll_timeout(&self) -> Option<FleetMicros> {
        let due = [
            self.timers.first(),
            self.group_timers.first(),
            self.kept.next(),
        ];
        due.into_iter().flatten().min()
    }

    /// Returns every job, newest first.
    pub fn jobs(&self) -> impl Iterator<Item = &Job> {
        self.book.newest_first()
    }

    /// Returns the job of this name.
    pub fn job(&self, id: &JobId) -> Option<&Job> {
        self.book.get(id)
    }

    /// Returns every node that is known, by name.
    pub fn nodes(&self) -> impl Iterator<Item = &Node> {
        self.nodes.values()
    }

    /// Returns the node of this name, if it is known.
    pub fn node(&self, id: &NodeId) -> Option<&Node> {
        self.nodes.get(id)
    }

    /// Returns a node's record as a get would answer it now.
    pub fn node_record(&self, id: &NodeId) -> Option<NodeRecord> {
        let node = self.nodes.get(id)?;
        Some(node.record(self.now, self.started_at.unwrap_or(self.now)))
    }

    /// Returns how many messages were no messages, or came from more nodes than can be known.
    pub fn ignored_count(&self) -> u64 {
        self.ignored_count
    }

    /// Returns how many synchronized jobs ended during their start although some nodes had passed
    /// it, or may have: see [`start`].
    pub fn split_start_count(&self) -> u64 {
        self.split_start_count
    }

    // ───────────────────────────── nodes ─────────────────────────────

    fn hear(
        &mut self,
        id: NodeId,
        topic: NodeTopic,
        payload: &[u8],
        happened_at: FleetMicros,
        effects: &mut Vec<Effect>,
    ) {
        match topic {
            NodeTopic::Status => {
                let Ok(status) = version::decode::<Status>(payload) else {
                    self.ignored_count += 1;
                    return;
                };
                if !self.nodes.contains_key(&id) {
                    if self.nodes.len() >= self.config.nodes_max {
                        self.ignored_count += 1;
                        return;
                    }
                    self.nodes.insert(id, Node::new(id, None, self.now));
                }
                self.with_node(id, effects, |node, turn| node.handle_status(status, turn));
            }
            NodeTopic::Ack => match version::decode::<BatchAck>(payload) {
                Ok(ack) => self.with_node(id, effects, |node, turn| node.handle_ack(&ack, turn)),
                Err(_) => self.ignored_count += 1,
            },
            // Nodes say nothing behind an epoch: this is another gateway's word to the node.
            NodeTopic::Clock | NodeTopic::Start | NodeTopic::Pace
                if payload.first() == Some(&epoch::MARK) => {}
            NodeTopic::Clock => match version::decode::<ClockMessage>(payload) {
                Ok(ClockMessage::Reply(reply)) => {
                    self.with_node(id, effects, |node, _| {
                        node.handle_clock(reply, happened_at);
                    });
                }
                Ok(ClockMessage::Probe(_)) => {}
                Err(_) => self.ignored_count += 1,
            },
            NodeTopic::Pace => match version::decode::<PaceMessage>(payload) {
                Ok(message) => {
                    self.with_node(id, effects, |node, turn| node.handle_pace(message, turn));
                }
                Err(_) => self.ignored_count += 1,
            },
            NodeTopic::Trace => match version::decode::<TraceEvent>(payload) {
                Ok(event) => self.with_node(id, effects, |node, turn| {
                    node.handle_trace(&event, turn);
                }),
                Err(_) => self.ignored_count += 1,
            },
            NodeTopic::Report => match ScriptReport::decode(payload) {
                Ok((report, text)) => {
                    self.with_node(id, effects, |node, turn| {
                        node.handle_report(&report, text, turn);
                    });
                }
                Err(_) => self.ignored_count += 1,
            },
            NodeTopic::Start => match version::decode::<StartMessage>(payload) {
                Ok(message) => self.hear_start(id, &message, effects),
                Err(_) => self.ignored_count += 1,
            },
            _ => {}
        }
    }

    /// Lets a node act, then do what is due, and notes when it wants to be called again.
    fn with_node(
        &mut self,
        id: NodeId,
        effects: &mut Vec<Effect>,
        act: impl FnOnce(&mut Node, &mut Turn<'_>),
    ) {
        let started_at = self.started_at.unwrap_or(self.now);
        let all_count = self.nodes.len();
        let Some(node) = self.nodes.get_mut(&id) else {
            return;
        };
        // The start of a few among thousands needs their clocks, and needs them now.
        let meets = node
            .active()
            .is_some_and(|job| self.started.contains_key(&job));
        let sharing_count = if meets { self.meeting_count } else { all_count };
        let probe_us_min = sharing_count.min(all_count) as u64 * clock::PROBE_SHARE_US;
        let mut turn = Turn {
            now: self.now,
            started_at,
            config: &self.config,
            book: &mut self.book,
            effects,
            released: Vec::new(),
            may_probe: self.may_probe,
            probe_us_min,
        };
        act(node, &mut turn);
        node.poll(&mut turn);
        self.may_probe = turn.may_probe;
        let released = turn.released;
        let due = node.poll_timeout(&self.book, &self.config);
        let active = node.active();
        self.timers.set(id, due, self.now);
        if let Some(job) = active.filter(|job| self.groups.contains_key(job)) {
            self.book.touch(&job);
        }
        for release in released {
            let reply = match (release.outcome, release.receipt) {
                (Ok(()), None) => self.node_reply(&id, release.to),
                (Ok(()), Some(payload)) => Some(Effect::Reply {
                    to: release.to,
                    key: Some(
                        self.config
                            .keys
                            .node(&id, NodeTopic::State)
                            .as_str()
                            .to_owned(),
                    ),
                    payload,
                }),
                (Err(error), _) => Some(error_reply(release.to, error)),
            };
            effects.extend(reply);
            self.end_release(release.to, effects);
        }
    }

    /// Takes the time, which never goes back.
    fn begin(&mut self, now: FleetMicros) -> FleetMicros {
        self.now = self.now.max(now);
        self.started_at.get_or_insert(self.now);
        self.now
    }
}

fn error_reply(to: ReplyTo, error: JobError) -> Effect {
    Effect::Reply {
        to,
        key: None,
        payload: to_json(&ErrorReply { error }),
    }
}
