//! Meeting points: several nodes go on at one instant, or none does. The start of a synchronized
//! job is the first one, number 0.
//!
//! ```text
//!   Gathering ─ all ready, clocks known ─▶ Committed ─ all armed ─▶ Confirmed ─ all passed ─▶ Over
//!       │ too late                             │ too late              │ one is not heard to start
//!       └──────────────────────────────────────┴───────────────────────┴──────────────▶ Broken
//! ```
//!
//! | time | gateway | node |
//! |---|---|---|
//! | | | `Ready` at once and every 100 ms |
//! | T0 − lead | plan is stored, then `Commit` every [`COMMIT_US`] until | `Armed` |
//! | | all armed: `Confirm` every [`CONFIRM_US`] until T0 | |
//! | confirm_by − [`ARM_MARGIN_US`] | one is not armed: `Abort` every [`ABORT_US`] until T0 | `Ready` |
//! | confirm_by | | without `Confirm`: disarms itself, `Ready` |
//! | T0 | | goes on, `Started` |
//! | T0 + [`STARTED_PATIENCE_US`] | one has not been heard to go on: failed | |
//!
//! Where the parts meet is known from their commands, and of scripts when they come there: see
//! `script`.
//!
//! Owns phases, deadlines and repetitions of one meeting point, and the choice of T0. A plan is
//! made at most once for each meeting point, and a plan that was found in the store is never
//! committed again.
//!
//! # The window that is left
//! Two generals cannot agree over a lossy way. Nobody moves unless every node was ready and armed
//! and every clock was known. But from the first `Confirm` to T0, the lead at most, a start can be
//! split:
//!
//! - a node gets none of the repetitions of `Confirm` before confirm_by and disarms itself, and its
//!   `Ready`, or the `Abort` that follows it to the others, is lost or comes after T0;
//! - a node has confirmed and then boots, stops or loses its link, and the gateway hears of it, or
//!   its `Abort` reaches the others, only after T0;
//! - a node has confirmed, and no `Abort` and no cancel reaches it before T0: its link or the
//!   gateway has gone.
//!
//! The gateway learns of it from the node's `Ready`, from its silence or from its numbers, halts
//! those that have moved, and the record says `failed`, who moved and who did not.
//! [`Fleet::split_start_count`](super::Fleet::split_start_count) counts these starts.
//!
//! Absent on purpose: jobs and records, the store, and how a node waits.

mod script;

pub use script::NamedMeeting;

use super::clock::ClockTrack;
use keys::{
    Command, FleetMicros, LocalMicros, NodeId, QueueId,
    record::{ErrorCode, JobError, StartRecord},
    start::StartMessage,
};
use script::Scripts;
use std::collections::{BTreeMap, BTreeSet, VecDeque};

/// Shortest time from a plan to its instant, µs.
pub const LEAD_US_MIN: u64 = 250_000;

/// The lead in slowest round trips.
pub const LEAD_ROUND_TRIPS: f64 = 8.0;

/// Shortest time from the end of confirmations to the instant, µs: an abort still gets through.
pub const CONFIRM_MARGIN_US: u64 = 50_000;

/// That time in slowest round trips.
pub const CONFIRM_MARGIN_ROUND_TRIPS: f64 = 2.0;

/// Shortest time for confirmations, µs.
pub const ARM_MARGIN_US: u64 = 20_000;

/// Time between two commits to a node that is not armed, µs.
pub const COMMIT_US: u64 = 50_000;

/// Time between two confirmations, µs.
pub const CONFIRM_US: u64 = 20_000;

/// Time between two aborts, µs.
pub const ABORT_US: u64 = 20_000;

/// How long after the instant a node has to be heard, µs.
pub const STARTED_PATIENCE_US: u64 = 1_000_000;

/// What a client allows.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Limits {
    /// Largest sum of the two worst clock errors, µs.
    pub max_skew_us: f64,
    /// How long nodes have to become ready, µs.
    pub ready_timeout_us: u64,
}

/// What a poll has found out.
#[derive(Clone, Debug, PartialEq)]
pub enum Step {
    /// Nothing new.
    Nothing,
    /// An instant was chosen; it must be durable before the next poll, which says it.
    Planned(FleetMicros),
    /// Every node has passed.
    Met,
    /// It will not be met, and why: by node.
    Failed(Vec<(NodeId, JobError)>),
}

/// First edge of a node behind a barrier, in our time.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Edge {
    /// When.
    pub at: FleetMicros,
    /// How far that may be wrong, µs.
    pub error_us: f64,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Stage {
    Coming,
    Ready,
    Armed,
    Passed,
}

/// One node's place at the meeting point.
#[derive(Clone, Debug)]
struct Seat {
    /// Time from the barrier to the first edge behind it as the commands say, µs.
    offset_us: u64,
    /// The queue and the number of the barrier in it, once it is sent.
    place: Option<(QueueId, u64)>,
    stage: Stage,
    /// The node has told since the gateway's start that it has not passed.
    waits: bool,
    /// What a commit says: start_at, confirm_by.
    orders: Option<(LocalMicros, LocalMicros)>,
    edge: Option<Edge>,
    /// Its part is a script: whether it comes is not known before it does.
    script: bool,
    /// The script has ended without coming here.
    absent: bool,
}

impl Seat {
    fn new(offset_us: u64) -> Self {
        Self {
            offset_us,
            place: None,
            stage: Stage::Coming,
            waits: false,
            orders: None,
            edge: None,
            script: false,
            absent: false,
        }
    }
}

#[derive(Clone, Copy, Debug)]
struct Plan {
    start_at: FleetMicros,
    confirm_by: FleetMicros,
    arm_by: FleetMicros,
    send_at: FleetMicros,
}

#[derive(Clone, Copy, Debug)]
enum Phase {
    Gathering,
    Committed(Plan),
    Confirmed(Plan),
    /// Planned before the gateway's start: it can only turn out to be over.
    Resumed(FleetMicros),
    Over,
    /// Nobody shall go on; those who are armed are told so until then.
    Broken {
        abort_until: FleetMicros,
        send_at: FleetMicros,
        /// Somebody may go on all the same, or has.
        confirmed: bool,
    },
}

/// One meeting point of one job.
#[derive(Clone, Debug)]
pub struct Meeting {
    limits: Limits,
    /// What clients call it; empty where nobody asks.
    name: String,
    /// No other part of the job can come.
    alone: bool,
    seats: BTreeMap<NodeId, Seat>,
    phase: Phase,
    /// Until when all must be ready and all clocks known.
    give_up_at: Option<FleetMicros>,
    planned_at: Option<FleetMicros>,
}

impl Meeting {
    fn new(limits: Limits, planned: Option<FleetMicros>) -> Self {
        Self {
            limits,
            name: String::new(),
            alone: false,
            seats: BTreeMap::new(),
            phase: planned.map_or(Phase::Gathering, Phase::Resumed),
            give_up_at: None,
            planned_at: planned,
        }
    }

    fn hear(&mut self, node: NodeId, message: &StartMessage, edge: Option<Edge>, now: FleetMicros) {
        let Some(seat) = self.seats.get_mut(&node) else {
            return;
        };
        match (message, self.phase) {
            (StartMessage::Started { .. }, _) => {
                seat.stage = Stage::Passed;
                seat.edge = seat.edge.or(edge);
            }
            (_, Phase::Over) => {}
            _ if seat.stage == Stage::Passed => {}
            (StartMessage::Ready { .. } | StartMessage::ReadyAt { .. }, Phase::Confirmed(plan)) => {
                // Before, it can only be a late word from before it was armed.
                let slack_us = self.limits.max_skew_us as u64;
                if now.plus_us(slack_us) >= plan.confirm_by {
                    seat.stage = Stage::Ready;
                }
            }
            (StartMessage::Ready { .. } | StartMessage::ReadyAt { .. }, _) => {
                seat.stage = Stage::Ready;
            }
            (StartMessage::Armed { .. }, Phase::Committed(_) | Phase::Broken { .. }) => {
                seat.stage = Stage::Armed;
            }
            _ => {}
        }
    }

    fn note_executed(&mut self, node: NodeId, queue: QueueId, executed: u64) {
        let Some(seat) = self.seats.get_mut(&node) else {
            return;
        };
        let Some((_, command)) = seat.place.filter(|(of, _)| *of == queue) else {
            return;
        };
        if executed > command {
            seat.stage = Stage::Passed;
        } else {
            seat.waits = true;
        }
    }

    /// Says what is due and finds out where the meeting is.
    fn poll<'c>(
        &mut self,
        clock: impl Fn(&NodeId) -> Option<&'c ClockTrack>,
        now: FleetMicros,
        mut say: impl FnMut(NodeId, StartMessage),
    ) -> Step {
        if let Some(reasons) = self.take_absent() {
            return self.fail(reasons, now);
        }
        let all = |stage: Stage| {
            let mut seats = self.seats.values();
            seats.all(|seat| seat.stage == stage || seat.stage == Stage::Passed)
        };
        let (all_ready, all_armed) = (all(Stage::Ready), all(Stage::Armed));
        if all(Stage::Passed) && !matches!(self.phase, Phase::Over | Phase::Broken { .. }) {
            self.phase = Phase::Over;
            return Step::Met;
        }
        match self.phase {
            Phase::Gathering => {
                let reasons = if all_ready {
                    let patience_us = self.limits.ready_timeout_us;
                    self.give_up_at.get_or_insert(now.plus_us(patience_us));
                    match self.plan(clock, now) {
                        Ok(at) => return Step::Planned(at),
                        Err(reasons) => reasons,
                    }
                } else {
                    self.not_ready()
                };
                if self.give_up_at.is_some_and(|at| now >= at) {
                    return self.fail(reasons, now);
                }
                Step::Nothing
            }
            Phase::Committed(mut plan) => {
                if now >= plan.arm_by {
                    let words = "the node did not answer the commit in time";
                    return self.fail(self.those(Stage::Armed, words), now);
                }
                if all_armed {
                    plan.send_at = now;
                    self.phase = Phase::Confirmed(plan);
                    return self.poll(clock, now, say);
                }
                if now >= plan.send_at {
                    plan.send_at = now.plus_us(COMMIT_US);
                    self.phase = Phase::Committed(plan);
                    for (node, seat) in &self.seats {
                        if let (Some((queue, command)), Some((start_at, confirm_by))) =
                            (seat.place, seat.orders)
                            && seat.stage == Stage::Ready
                        {
                            let commit = StartMessage::Commit {
                                queue,
                                command,
                                start_at,
                                confirm_by,
                            };
                            say(*node, commit);
                        }
                    }
                }
                Step::Nothing
            }
            Phase::Confirmed(mut plan) => {
                let disarmed = self.seats.values().any(|seat| seat.stage == Stage::Ready);
                let patient = now < plan.start_at.plus_us(STARTED_PATIENCE_US);
                if disarmed {
                    let words = "no confirmation reached the node in time";
                    let disarmed = self.seats.iter();
                    let disarmed = disarmed.filter(|(_, seat)| seat.stage == Stage::Ready);
                    let reasons = disarmed.map(|(node, _)| (*node, offline(words))).collect();
                    return self.fail(reasons, now);
                }
                if !patient {
                    let words = "the node was not heard to start";
                    return self.fail(self.those(Stage::Passed, words), now);
                }
                if now < plan.start_at && now >= plan.send_at {
                    plan.send_at = now.plus_us(CONFIRM_US);
                    self.phase = Phase::Confirmed(plan);
                    for (node, seat) in &self.seats {
                        if let Some((queue, command)) = seat.place
                            && seat.stage != Stage::Passed
                        {
                            say(*node, StartMessage::Confirm { queue, command });
                        }
                    }
                }
                Step::Nothing
            }
            Phase::Resumed(_) => {
                let waits = self.seats.values().any(|seat| seat.waits);
                if !waits {
                    return Step::Nothing;
                }
                let words = "the gateway restarted during the start";
                let mut reasons = self.those(Stage::Passed, words);
                for (_, error) in &mut reasons {
                    error.code = ErrorCode::Internal;
                }
                self.fail(reasons, now)
            }
            Phase::Broken {
                abort_until,
                send_at,
                confirmed,
            } => {
                if now < abort_until && now >= send_at {
                    self.phase = Phase::Broken {
                        abort_until,
                        send_at: now.plus_us(ABORT_US),
                        confirmed,
                    };
                    for (node, seat) in &self.seats {
                        if let Some((queue, command)) = seat.place
                            && matches!(seat.stage, Stage::Coming | Stage::Armed)
                        {
                            say(*node, StartMessage::Abort { queue, command });
                        }
                    }
                }
                Step::Nothing
            }
            Phase::Over => Step::Nothing,
        }
    }

    fn poll_timeout(&self) -> Option<FleetMicros> {
        match self.phase {
            Phase::Gathering => self.give_up_at,
            Phase::Committed(plan) => Some(plan.send_at.min(plan.arm_by)),
            Phase::Confirmed(plan) if plan.send_at < plan.start_at => Some(plan.send_at),
            Phase::Confirmed(plan) => Some(plan.start_at.plus_us(STARTED_PATIENCE_US)),
            Phase::Broken {
                abort_until,
                send_at,
                ..
            } => {
                let mut seats = self.seats.values();
                let armed = seats.any(|seat| {
                    seat.place.is_some() && matches!(seat.stage, Stage::Coming | Stage::Armed)
                });
                (armed && send_at < abort_until).then_some(send_at)
            }
            Phase::Resumed(_) | Phase::Over => None,
        }
    }

    /// Chooses the instant.
    ///
    /// # Errors
    /// The clocks that are not known well enough.
    fn plan<'c>(
        &mut self,
        clock: impl Fn(&NodeId) -> Option<&'c ClockTrack>,
        now: FleetMicros,
    ) -> Result<FleetMicros, Vec<(NodeId, JobError)>> {
        let unknown = |node: &NodeId| (*node, not_ready("the node's clock is not known yet"));
        let mut rtt_us: f64 = 0.0;
        for node in self.seats.keys() {
            let slowest_us = clock(node).and_then(ClockTrack::rtt_us_max);
            rtt_us = rtt_us.max(slowest_us.ok_or_else(|| vec![unknown(node)])?);
        }
        let trips = |count: f64, least_us: u64| least_us.max((count * rtt_us) as u64);
        let start_at = now.plus_us(trips(LEAD_ROUND_TRIPS, LEAD_US_MIN));
        let margin_us = trips(CONFIRM_MARGIN_ROUND_TRIPS, CONFIRM_MARGIN_US);
        let confirm_by = FleetMicros(start_at.0 - margin_us);
        let arm_by = FleetMicros(confirm_by.0 - trips(1.0, ARM_MARGIN_US));
        let mut errors = Vec::new();
        let mut orders = Vec::new();
        for node in self.seats.keys() {
            let local = |at: FleetMicros| {
                let estimate = clock(node)?.estimate(at)?;
                let rounded_us = estimate.local.0 + u64::from(estimate.fraction_us >= 0.5);
                Some((LocalMicros(rounded_us), estimate.error_us))
            };
            let times = local(start_at).zip(local(confirm_by));
            let ((start_at, error_us), (confirm_by, _)) =
                times.ok_or_else(|| vec![unknown(node)])?;
            errors.push((error_us, *node));
            orders.push((start_at, confirm_by));
        }
        errors.sort_by(|(a, _), (b, _)| b.total_cmp(a));
        let worst: f64 = errors.iter().take(2).map(|(error_us, _)| error_us).sum();
        if worst > self.limits.max_skew_us {
            let allowed_us = self.limits.max_skew_us;
            let reasons = errors.iter().take(2).map(|(error_us, node)| {
                let message = format!(
                    "the node's clock is known to ±{error_us:.1} µs only; max_skew_us is {allowed_us}"
                );
                (*node, not_ready(message))
            });
            return Err(reasons.collect());
        }
        for (seat, orders) in self.seats.values_mut().zip(orders) {
            seat.orders = Some(orders);
        }
        self.planned_at = Some(start_at);
        self.phase = Phase::Committed(Plan {
            start_at,
            confirm_by,
            arm_by,
            send_at: now,
        });
        Ok(start_at)
    }

    fn not_ready(&self) -> Vec<(NodeId, JobError)> {
        let timeout_ms = self.limits.ready_timeout_us as f64 / 1e3;
        let message = format!("the node was not ready within {timeout_ms} ms");
        let late = self.seats.iter();
        let late = late.filter(|(_, seat)| seat.stage == Stage::Coming);
        late.map(|(node, _)| (*node, not_ready(message.as_str())))
            .collect()
    }

    /// Returns everybody who has not come as far as this.
    fn those(&self, below: Stage, words: &str) -> Vec<(NodeId, JobError)> {
        let late = self.seats.iter();
        let late = late.filter(|(_, seat)| seat.stage != below && seat.stage != Stage::Passed);
        late.map(|(node, _)| (*node, offline(words))).collect()
    }

    fn fail(&mut self, reasons: Vec<(NodeId, JobError)>, now: FleetMicros) -> Step {
        self.break_off(now);
        Step::Failed(reasons)
    }

    /// Nobody shall go on. Returns whether somebody may do so all the same, or has.
    fn break_off(&mut self, now: FleetMicros) -> bool {
        let (abort_until, confirmed) = match self.phase {
            Phase::Over => return false,
            Phase::Broken { confirmed, .. } => return confirmed,
            Phase::Gathering => (now, false),
            Phase::Committed(plan) => (plan.start_at, false),
            Phase::Confirmed(plan) => (plan.start_at, true),
            Phase::Resumed(start_at) => (start_at, true),
        };
        if matches!(self.phase, Phase::Resumed(_) | Phase::Committed(_)) {
            // A commit may be on its way to whoever said that it is ready.
            for seat in self.seats.values_mut() {
                if seat.stage == Stage::Ready {
                    seat.stage = Stage::Coming;
                }
            }
        }
        self.phase = Phase::Broken {
            abort_until,
            send_at: now,
            confirmed,
        };
        confirmed
    }

    /// Returns the start as the nodes measured it, once all have.
    fn measured(&self) -> Option<StartRecord> {
        let planned = self.planned_at?;
        let mut late_us = Vec::with_capacity(self.seats.len());
        let mut errors_us = Vec::with_capacity(self.seats.len());
        for (node, seat) in &self.seats {
            let edge = seat.edge?;
            let behind_us = edge.at.0 as i64 - planned.0 as i64 - seat.offset_us as i64;
            late_us.push((*node, behind_us));
            errors_us.push(edge.error_us);
        }
        let first_us = late_us.iter().map(|(_, us)| *us).min()?;
        let last_us = late_us.iter().map(|(_, us)| *us).max()?;
        errors_us.sort_by(|a, b| b.total_cmp(a));
        Some(StartRecord {
            planned,
            skew_us: (last_us - first_us) as f64,
            by_node_us: late_us
                .into_iter()
                .map(|(node, us)| (node, (us - first_us) as f64))
                .collect(),
            uncertainty_us: errors_us.iter().take(2).sum(),
        })
    }
}

fn not_ready(message: impl Into<String>) -> JobError {
    JobError::new(ErrorCode::NotAllowed, message)
}

fn offline(message: &str) -> JobError {
    JobError::new(ErrorCode::NodeOffline, message)
}

/// All meeting points of one job.
#[derive(Clone, Debug)]
pub struct Start {
    meetings: BTreeMap<u16, Meeting>,
    /// Meeting points that each node has not passed yet, with the index of their command, in order.
    ways: BTreeMap<NodeId, VecDeque<(u64, u16)>>,
    /// Where each part begins.
    bases: BTreeMap<NodeId, (QueueId, u64)>,
    /// Meeting points at which something has happened and that are not over.
    open: BTreeSet<u16>,
    limits: Limits,
    scripts: Scripts,
}

impl Start {
    /// Takes the parts' commands, and the plans that were made before the gateway's start.
    pub fn new<'p>(
        limits: Limits,
        parts: impl IntoIterator<Item = (NodeId, &'p [Command])>,
        planned: &BTreeMap<u16, FleetMicros>,
    ) -> Self {
        let mut start = Self {
            meetings: BTreeMap::new(),
            ways: BTreeMap::new(),
            bases: BTreeMap::new(),
            open: planned.keys().copied().collect(),
            limits,
            scripts: Scripts::default(),
        };
        for (node, commands) in parts {
            let way = start.ways.entry(node).or_default();
            for (index, command) in commands.iter().enumerate() {
                let Command::Barrier { barrier } = *command else {
                    continue;
                };
                let meeting = start.meetings.entry(barrier);
                let meeting =
                    meeting.or_insert_with(|| Meeting::new(limits, planned.get(&barrier).copied()));
                let offset_us = first_edge_us(&commands[index + 1..]);
                meeting.seats.insert(node, Seat::new(offset_us));
                way.push_back((index as u64, barrier));
            }
        }
        start
    }

    /// A part is on its way: its first command has this number.
    pub fn seat(&mut self, node: NodeId, queue: QueueId, base: u64) {
        if self.bases.insert(node, (queue, base)).is_some() {
            return;
        }
        for (index, number) in self.ways.get(&node).into_iter().flatten() {
            let meeting = self.meetings.get_mut(number);
            if let Some(seat) = meeting.and_then(|meeting| meeting.seats.get_mut(&node)) {
                seat.place = Some((queue, base + index));
            }
        }
    }

    /// Until when everybody must be ready for the start.
    pub fn limit(&mut self, give_up_at: FleetMicros) {
        if let Some(meeting) = self.meetings.get_mut(&0) {
            meeting.give_up_at = Some(give_up_at);
            self.open.insert(0);
        }
    }

    /// Returns whether a message of this node is about one of these meeting points.
    pub fn is_of(&self, node: NodeId, message: &StartMessage) -> bool {
        self.number_of(node, message).is_some() || self.may_name(node, message)
    }

    fn number_of(&self, node: NodeId, message: &StartMessage) -> Option<u16> {
        let (queue, command) = place_of(message);
        let (of, base) = *self.bases.get(&node)?;
        let index = command.checked_sub(base).filter(|_| of == queue)?;
        // The start's measurement may come when the node is long past it.
        if index == 0 {
            return self.meetings.contains_key(&0).then_some(0);
        }
        let way = self.ways.get(&node)?;
        let at = way.binary_search_by_key(&index, |(index, _)| *index);
        at.ok().map(|at| way[at].1)
    }

    /// A node said something.
    pub fn hear(
        &mut self,
        node: NodeId,
        message: &StartMessage,
        edge: Option<Edge>,
        now: FleetMicros,
    ) {
        self.hear_name(node, message);
        let Some(number) = self.number_of(node, message) else {
            return;
        };
        self.open.insert(number);
        if let Some(meeting) = self.meetings.get_mut(&number) {
            meeting.hear(node, message, edge, now);
        }
        let (queue, command) = place_of(message);
        let passed = matches!(message, StartMessage::Started { .. });
        self.note_executed(node, queue, command + u64::from(passed));
    }

    /// A node's queue has executed so many commands.
    pub fn note_executed(&mut self, node: NodeId, queue: QueueId, executed: u64) {
        let Some(way) = self.ways.get_mut(&node) else {
            return;
        };
        while let Some((_, number)) = way.front().copied() {
            if let Some(meeting) = self.meetings.get_mut(&number) {
                meeting.note_executed(node, queue, executed);
                if meeting.seats[&node].stage != Stage::Passed {
                    return;
                }
                self.open.insert(number);
            }
            way.pop_front();
        }
    }

    /// A node has ended its part, and `all`: passed every meeting point.
    pub fn leave(&mut self, node: NodeId, all: bool) {
        for (_, number) in self.ways.remove(&node).unwrap_or_default() {
            let meeting = self.meetings.get_mut(&number);
            let Some(seat) = meeting.and_then(|meeting| meeting.seats.get_mut(&node)) else {
                continue;
            };
            if all {
                seat.stage = Stage::Passed;
                self.open.insert(number);
            } else {
                // Its queue is gone: there is nobody to talk to.
                seat.place = None;
            }
        }
        if all {
            self.note_ended(node);
        }
    }

    /// Says what is due. Returns what is new, each with its number.
    pub fn poll<'c>(
        &mut self,
        clock: impl Fn(&NodeId) -> Option<&'c ClockTrack>,
        now: FleetMicros,
        mut say: impl FnMut(NodeId, StartMessage),
    ) -> Vec<(u16, Step)> {
        let mut steps = Vec::new();
        let open: Vec<u16> = self.open.iter().copied().collect();
        for number in open {
            let Some(meeting) = self.meetings.get_mut(&number) else {
                self.open.remove(&number);
                continue;
            };
            let step = meeting.poll(&clock, now, &mut say);
            if step == Step::Met {
                self.open.remove(&number);
                if number != 0 {
                    self.meetings.remove(&number);
                }
            }
            if step != Step::Nothing {
                steps.push((number, step));
            }
        }
        if steps.is_empty() {
            steps.extend(self.find_deadlock(now));
        }
        steps
    }

    /// Returns when [`Start::poll`] is due.
    pub fn poll_timeout(&self) -> Option<FleetMicros> {
        let open = self.open.iter();
        let open = open.filter_map(|number| self.meetings.get(number));
        open.filter_map(Meeting::poll_timeout).min()
    }

    /// Nobody shall go on any more. Returns who may have, while others did not.
    pub fn break_off(&mut self, now: FleetMicros) -> BTreeSet<NodeId> {
        let mut halts = BTreeSet::new();
        for meeting in self.meetings.values_mut() {
            if meeting.break_off(now) {
                halts.extend(meeting.seats.keys());
            }
        }
        halts
    }

    /// Returns the start as the nodes measured it, once all have.
    pub fn measured(&self) -> Option<StartRecord> {
        self.meetings.get(&0)?.measured()
    }
}

/// Returns which barrier a message is about.
fn place_of(message: &StartMessage) -> (QueueId, u64) {
    match *message {
        StartMessage::Ready { queue, command }
        | StartMessage::ReadyAt { queue, command, .. }
        | StartMessage::Commit { queue, command, .. }
        | StartMessage::Armed { queue, command }
        | StartMessage::Confirm { queue, command }
        | StartMessage::Abort { queue, command }
        | StartMessage::Started { queue, command, .. } => (queue, command),
    }
}

/// Returns the time from a barrier to the first edge behind it, µs; 0 if nothing steps before the
/// next one or the end.
fn first_edge_us(commands: &[Command]) -> u64 {
    let mut offset_us = 0;
    for command in commands {
        match *command {
            Command::Pause { pause_ms } => offset_us += u64::from(pause_ms) * 1_000,
            Command::Barrier { .. } => return 0,
            Command::Laser { .. }
            | Command::LidarRead
            | Command::SetPosition { .. }
            | Command::StatusCd => {}
            Command::Move { .. }
            | Command::SyncMove { .. }
            | Command::Ramp { .. }
            | Command::RampTo { .. }
            | Command::Line { .. }
            | Command::Home { .. }
            | Command::MoveC { .. }
            | Command::MoveD { .. } => return offset_us,
        }
    }
    0
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fleet::clock::Stamps;
    use keys::AxisId;

    const QUEUE: QueueId = QueueId { boot: 7, flush: 1 };

    /// A clock that is an hour behind, over a way of so much in each direction.
    fn clock(way_us: u64) -> ClockTrack {
        let mut clock = ClockTrack::new();
        for probe in 0..200 {
            let sent_us = 3_600_000_000 + probe * 100_000;
            let stamps = Stamps {
                sent_at: FleetMicros(sent_us),
                received_at: LocalMicros(sent_us + way_us - 3_600_000_000),
                replied_at: LocalMicros(sent_us + way_us - 3_600_000_000),
                back_at: FleetMicros(sent_us + 2 * way_us),
            };
            clock.observe(QUEUE.boot, stamps);
        }
        clock
    }

    fn node(name: &str) -> NodeId {
        NodeId::new(name).expect("legal")
    }

    const NOW: FleetMicros = FleetMicros(3_620_000_000);

    /// Two nodes that are ready, 100 commands into their queues.
    fn ready() -> Start {
        let limits = Limits {
            max_skew_us: 10_000.0,
            ready_timeout_us: 1_000_000,
        };
        let barrier = Command::Barrier { barrier: 0 };
        let step = Command::Move {
            axis: AxisId(0),
            delay_us: 100,
            steps: 1,
        };
        let pause = Command::Pause { pause_ms: 3 };
        let parts: [(NodeId, &[Command]); 2] = [
            (node("left"), &[barrier, step]),
            (node("right"), &[barrier, pause, step]),
        ];
        let mut start = Start::new(limits, parts, &BTreeMap::new());
        for name in ["left", "right"] {
            start.seat(node(name), QUEUE, 100);
            say(&mut start, name, NOW, |queue, command| {
                StartMessage::Ready { queue, command }
            });
        }
        start
    }

    fn say(
        start: &mut Start,
        name: &str,
        now: FleetMicros,
        word: impl Fn(QueueId, u64) -> StartMessage,
    ) {
        start.hear(node(name), &word(QUEUE, 100), None, now);
    }

    fn armed(queue: QueueId, command: u64) -> StartMessage {
        StartMessage::Armed { queue, command }
    }

    fn poll(
        start: &mut Start,
        clock: &ClockTrack,
        now: FleetMicros,
    ) -> (Vec<Step>, Vec<StartMessage>) {
        let mut said = Vec::new();
        let steps = start.poll(|_| Some(clock), now, |_, message| said.push(message));
        (steps.into_iter().map(|(_, step)| step).collect(), said)
    }

    #[test]
    fn the_instant_is_as_far_ahead_as_the_slowest_way_needs() {
        for (way_us, lead_us, margin_us) in [(100, 250_000, 50_000), (25_000, 400_000, 100_000)] {
            let clock = clock(way_us);
            let mut start = ready();
            let at = FleetMicros(NOW.0 + lead_us);
            assert_eq!(
                poll(&mut start, &clock, NOW),
                (vec![Step::Planned(at)], vec![])
            );
            let (steps, said) = poll(&mut start, &clock, NOW);
            assert_eq!((steps.len(), said.len()), (0, 2));
            let StartMessage::Commit {
                start_at,
                confirm_by,
                command,
                ..
            } = said[0]
            else {
                panic!("{said:?}")
            };
            assert_eq!(command, 100);
            assert_eq!(start_at.0 - confirm_by.0, margin_us);
            let local_us = at.0 - 3_600_000_000;
            assert!(
                start_at.0.abs_diff(local_us) <= 5,
                "{start_at:?} {local_us}"
            );
        }
    }

    #[test]
    fn nobody_is_confirmed_before_all_are_armed_and_all_are_held_when_one_is_late() {
        let clock = clock(100);
        let mut start = ready();
        poll(&mut start, &clock, NOW);
        poll(&mut start, &clock, NOW);
        say(&mut start, "left", NOW, armed);
        assert_eq!(poll(&mut start, &clock, NOW), (vec![], vec![]));
        let again = FleetMicros(NOW.0 + COMMIT_US);
        let (_, said) = poll(&mut start, &clock, again);
        assert!(
            matches!(said[..], [StartMessage::Commit { .. }]),
            "{said:?}"
        );
        let late = FleetMicros(NOW.0 + LEAD_US_MIN - CONFIRM_MARGIN_US - ARM_MARGIN_US);
        let (steps, _) = poll(&mut start, &clock, late);
        let [Step::Failed(reasons)] = &steps[..] else {
            panic!("{steps:?}")
        };
        assert_eq!(reasons.len(), 1);
        assert_eq!(reasons[0].0, node("right"));
        assert!(start.break_off(late).is_empty(), "nobody was confirmed");
        let (_, said) = poll(&mut start, &clock, late);
        assert!(
            matches!(
                said[..],
                [StartMessage::Abort { .. }, StartMessage::Abort { .. }]
            ),
            "{said:?}"
        );
        // Whoever says that it waits needs no more aborts, and after the instant nobody does.
        say(&mut start, "left", late, |queue, command| {
            StartMessage::Ready { queue, command }
        });
        let (_, said) = poll(&mut start, &clock, late.plus_us(ABORT_US));
        assert_eq!(said.len(), 1);
        let (_, said) = poll(&mut start, &clock, NOW.plus_us(LEAD_US_MIN));
        assert_eq!(said, []);
    }

    #[test]
    fn a_word_from_before_it_was_armed_does_not_disarm_a_node() {
        let clock = clock(100);
        let mut start = ready();
        poll(&mut start, &clock, NOW);
        for name in ["left", "right"] {
            say(&mut start, name, NOW, armed);
        }
        let (_, said) = poll(&mut start, &clock, NOW);
        assert!(matches!(said[0], StartMessage::Confirm { .. }), "{said:?}");
        let ready = |queue, command| StartMessage::Ready { queue, command };
        say(&mut start, "left", NOW.plus_us(1_000), ready);
        assert_eq!(poll(&mut start, &clock, NOW.plus_us(1_000)).0, []);
        // After the last moment for confirmations it can only mean that there was none.
        let after = NOW.plus_us(LEAD_US_MIN - CONFIRM_MARGIN_US);
        say(&mut start, "left", after, ready);
        let (steps, _) = poll(&mut start, &clock, after);
        assert!(
            matches!(&steps[..], [Step::Failed(reasons)] if reasons.len() == 1),
            "{steps:?}"
        );
        let halts = start.break_off(after);
        assert_eq!(halts.len(), 2, "whoever was confirmed may have gone on");
    }

    #[test]
    fn a_plan_of_an_earlier_gateway_is_never_committed_and_may_turn_out_to_be_over() {
        let clock = clock(100);
        let planned = BTreeMap::from([(0, NOW)]);
        let limits = Limits {
            max_skew_us: 10_000.0,
            ready_timeout_us: 1_000_000,
        };
        let parts = || {
            let part: &[Command] = &[Command::Barrier { barrier: 0 }, Command::LidarRead];
            [(node("left"), part), (node("right"), part)]
        };
        for passed in [true, false] {
            let mut start = Start::new(limits, parts(), &planned);
            start.seat(node("left"), QUEUE, 100);
            start.seat(node("right"), QUEUE, 100);
            start.note_executed(node("left"), QUEUE, 101);
            assert_eq!(poll(&mut start, &clock, NOW), (vec![], vec![]));
            start.note_executed(node("right"), QUEUE, 100 + u64::from(passed));
            let (steps, said) = poll(&mut start, &clock, NOW);
            assert_eq!(said, []);
            match &steps[..] {
                [Step::Met] => assert!(passed),
                [Step::Failed(reasons)] => {
                    assert!(!passed);
                    assert_eq!(reasons[0].1.code, ErrorCode::Internal);
                }
                other => panic!("{other:?}"),
            }
        }
    }
}
