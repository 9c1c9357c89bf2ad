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

mod meeting;
mod script;

pub use script::NamedMeeting;

use super::clock::ClockTrack;
use keys::{
    Command, FleetMicros, NodeId, QueueId,
    record::{JobError, StartRecord},
    start::StartMessage,
};
use meeting::{Meeting, Seat, Stage};
use script::Scripts;
use std::collections::{BTreeMap, BTreeSet, VecDeque};

/// Shortest time from a plan to its instant, µs.
pub const LEAD_US_MIN: u64 = 250_000;

/// The lead in slowest round trips.
pub const LEAD_ROUND_TRIPS: f64 = 8.0;

/// Longest round trip that a plan reckons with, µs: four seconds of lead. A node that was slower once,
/// while hundreds connected, is not waited for any longer; if it is still so, the start fails before
/// anybody moves.
pub const ROUND_TRIP_US_MAX: f64 = 500_000.0;

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
mod tests;
