//! Synchronized jobs: taken whole or not at all, started together, ended together.
//!
//! ```text
//!   submit ─ every node can? ─▶ a part in each node's queue ─ all sent, all ready ─▶ start.rs
//!   a part fails · is canceled · times out · its node goes before the start ─▶ all parts end
//! ```
//!
//! A part waits its turn in its node's queue like any other job; while others are not there yet it
//! waits at the barrier. What touches a part touches its job, and [`Fleet::settle`] looks at each
//! touched job once at the end of every call.
//!
//! Promises: a job that begins to end ends all of its parts, by an abort for those who are armed
//! and by a cancel of each queue, which is repeated until it is seen; whoever may have started
//! although others did not is halted. A start that the gateway's own end has interrupted is never
//! committed again.
//!
//! Absent on purpose: the conversation of a start (`start`), the record (`job::group`).

mod measure;
mod parts;
mod submit;

use measure::measuring_until;
pub(super) use parts::new_part;
pub use parts::parts_of;

use super::{
    Fleet,
    event::{Effect, Lane},
    start::{Edge, Limits, Start, Step},
};
use crate::job::{
    Ending, Job,
    group::{GroupEntry, joined},
};
use keys::{
    FleetMicros, JobId, NodeId, NodeTopic, StopMode,
    job::{GroupRequest, Work},
    record::{ErrorCode, JobError, JobState, StartPlan, to_json},
    start::StartMessage,
};
use std::collections::{BTreeMap, BTreeSet};

/// Largest clock error of a start when a client says nothing, µs.
pub(super) const MAX_SKEW_US: f64 = 1_000.0;

/// How long nodes have to become ready when a client says nothing, ms.
pub(super) const READY_TIMEOUT_MS: f64 = 5_000.0;

/// What a synchronized job in memory needs beside its [`Job`].
#[derive(Debug)]
pub(super) struct Group {
    limits: Limits,
    timeout_us: Option<u64>,
    /// Nodes whose part is a script, also when that has ended.
    scripts: BTreeSet<NodeId>,
    /// The numbers of the meeting points that lists of commands have.
    names: BTreeMap<String, u16>,
    /// From the first part that was sent on.
    start: Option<Start>,
    /// Nodes that may have gone on although others did not: they come to rest at once.
    halts: BTreeSet<NodeId>,
}

impl Group {
    pub(super) fn new(request: &GroupRequest) -> Self {
        // Far beyond any job, and far from the end of the numbers.
        let micros = |time: f64, unit_us: f64| (time * unit_us).clamp(1.0, 1e15) as u64;
        let ready_timeout_ms = request.ready_timeout_ms.unwrap_or(READY_TIMEOUT_MS);
        Self {
            limits: Limits {
                max_skew_us: request.max_skew_us.unwrap_or(MAX_SKEW_US),
                ready_timeout_us: micros(ready_timeout_ms, 1e3),
            },
            timeout_us: request.timeout_s.map(|limit_s| micros(limit_s, 1e6)),
            scripts: request
                .nodes
                .iter()
                .filter(|(_, work)| matches!(work, Work::Lua(_)))
                .map(|(node, _)| *node)
                .collect(),
            names: request
                .barrier_numbers()
                .into_iter()
                .map(|(name, number)| (name.to_owned(), number))
                .collect(),
            start: None,
            halts: BTreeSet::new(),
        }
    }
}

impl Fleet {
    /// A node said something about a meeting point.
    pub(super) fn hear_start(
        &mut self,
        node: NodeId,
        message: &StartMessage,
        effects: &mut Vec<Effect>,
    ) {
        let from_node = matches!(
            message,
            StartMessage::Ready { .. }
                | StartMessage::ReadyAt { .. }
                | StartMessage::Armed { .. }
                | StartMessage::Started { .. }
        );
        let known = self
            .nodes
            .get(&node)
            .filter(|view| view.numbers().is_some());
        let Some(view) = known.filter(|_| from_node) else {
            return;
        };
        if let StartMessage::ReadyAt { queue, command, .. } = message
            && view
                .numbers()
                .is_some_and(|(of, executed)| of == *queue && executed > *command)
        {
            // It comes late: the meeting may be over and forgotten.
            return;
        }
        let edge = match message {
            StartMessage::Started { first_edge_at, .. } => {
                let at = view.clock().fleet_from_local(*first_edge_at);
                let error_us = view.clock().estimate(self.now);
                let error_us = error_us.map(|estimate| estimate.error_us);
                at.zip(error_us).map(|(at, error_us)| Edge { at, error_us })
            }
            _ => None,
        };
        let now = self.now;
        let of = self.started.keys().copied().find(|id| {
            let start = self.groups.get(id).and_then(|group| group.start.as_ref());
            start.is_some_and(|start| start.is_of(node, message))
        });
        let start = of.and_then(|id| Some((id, self.groups.get_mut(&id)?.start.as_mut()?)));
        if let Some((id, start)) = start {
            start.hear(node, message, edge, now);
            self.poll_group(&id, effects);
        }
    }

    /// Ends a synchronized job because a client says so.
    pub(super) fn cancel_group(&mut self, id: &JobId, effects: &mut Vec<Effect>) {
        let open = self.book.get(id).filter(|job| !job.state().is_final());
        if open.is_some_and(|job| job.entry.ending.is_none()) {
            self.end_group(id, Ending::Cancel, BTreeMap::new(), effects);
        }
        self.poll_group(id, effects);
    }

    // ───────────────────────────── what follows ─────────────────────────────

    /// Looks at every synchronized job of which something is news.
    pub(super) fn settle(&mut self, effects: &mut Vec<Effect>) {
        while let Some(id) = self.group_timers.take_due(self.now) {
            self.book.touch(&id);
        }
        while let Some(id) = self.book.take_touched() {
            self.poll_group(&id, effects);
        }
    }

    fn poll_group(&mut self, id: &JobId, effects: &mut Vec<Effect>) {
        let open = |fleet: &Self| {
            let job = fleet.book.get(id);
            job.is_some_and(|job| job.is_group() && !job.state().is_final())
        };
        if open(self) {
            self.feed_start(id);
            self.watch_parts(id, effects);
            self.advance_start(id, effects);
            self.apply_ending(id, effects);
            self.measure_start(id, effects);
        }
        if open(self) {
            let due = self.group_due(id);
            self.group_timers.set(*id, due, self.now);
        } else if self.groups.remove(id).is_some() {
            let split = self.book.get(id).is_some_and(|job| job.split);
            self.split_start_count += u64::from(split);
            self.meeting_count -= self.started.remove(id).unwrap_or(0);
            self.group_timers.set(*id, None, self.now);
        }
    }

    /// Tells the start where the parts are.
    fn feed_start(&mut self, id: &JobId) {
        let (Some(job), Some(group)) = (self.book.get(id), self.groups.get_mut(id)) else {
            return;
        };
        let sent = |part: &Job| part.entry.activation.is_some();
        if group.start.is_none() && !job.parts.values().any(sent) {
            return;
        }
        let entry = job.entry.group.as_deref();
        let start = group.start.get_or_insert_with(|| {
            let parts = job.parts.iter();
            let parts = parts.map(|(node, part)| (*node, part.commands.as_ref()));
            let none = GroupEntry::default();
            let entry = entry.unwrap_or(&none);
            Start::new(group.limits, parts, &entry.planned).with_scripts(
                &group.scripts,
                &group.names,
                &entry.named,
                &entry.planned,
            )
        });
        if !self.started.contains_key(id) {
            self.started.insert(*id, job.parts.len());
            self.meeting_count += job.parts.len();
        }
        for (node, part) in &job.parts {
            if let Some(activation) = part.entry.activation {
                start.seat(*node, activation.queue, activation.base);
            }
            if part.state().is_final() {
                start.leave(*node, part.state() == JobState::Succeeded);
                continue;
            }
            let view = self.nodes.get(node);
            let view = view.filter(|view| view.active() == Some(*id));
            if let Some((queue, executed)) = view.and_then(|view| view.numbers()) {
                start.note_executed(*node, queue, executed);
            }
        }
        if let Some(at) = job.all_sent_at().filter(|_| !job.has_started()) {
            // What went by while there was no gateway does not count.
            let at = at.max(self.started_at.unwrap_or(at));
            start.limit(at.plus_us(group.limits.ready_timeout_us));
        }
    }

    /// Ends the job if one of its parts has ended, is gone before the start, or takes too long.
    fn watch_parts(&mut self, id: &JobId, effects: &mut Vec<Effect>) {
        let Some(job) = self.book.get(id).filter(|job| job.entry.ending.is_none()) else {
            return;
        };
        let planned = job.entry.group.as_ref().map(|group| &group.planned);
        let meets = !job.has_started() || planned.is_some_and(|planned| !planned.is_empty());
        let mut reasons = BTreeMap::new();
        for (node, part) in &job.parts {
            let error = match part.state() {
                JobState::Failed | JobState::Canceled | JobState::TimedOut => {
                    let error = part.entry.record.error.clone();
                    error.unwrap_or_else(|| {
                        let message = format!("the part was {}", part.state());
                        JobError::new(ErrorCode::Internal, message)
                    })
                }
                JobState::Lost if !job.has_started() => JobError::new(
                    ErrorCode::NodeOffline,
                    "the node went away before the start was over",
                ),
                // Its report comes when it is at rest, and that may be too late for the others.
                JobState::Sent | JobState::Running if meets && self.is_stopped(node) => {
                    JobError::new(ErrorCode::Stopped, "the node was stopped during the start")
                }
                _ => continue,
            };
            reasons.insert(*node, error);
        }
        let late = self.deadline(id).is_some_and(|at| self.now >= at);
        match joined(reasons.clone()) {
            Some(error) => self.end_group(id, Ending::Fail(error), reasons, effects),
            None if late => self.end_group(id, Ending::Timeout, reasons, effects),
            None => {}
        }
    }

    fn is_stopped(&self, node: &NodeId) -> bool {
        self.nodes.get(node).is_some_and(|view| view.is_stopped())
    }

    fn deadline(&self, id: &JobId) -> Option<FleetMicros> {
        let job = self.book.get(id).filter(|job| job.entry.ending.is_none())?;
        let timeout_us = self.groups.get(id)?.timeout_us?;
        Some(job.all_sent_at()?.plus_us(timeout_us))
    }

    /// Lets the start say what is due, and draws the conclusions.
    fn advance_start(&mut self, id: &JobId, effects: &mut Vec<Effect>) {
        loop {
            let steps = self.poll_start(id, true, effects);
            if steps.is_empty() {
                return;
            }
            for (number, step) in steps {
                match step {
                    Step::Nothing => {}
                    Step::Planned(at) => {
                        let group = self.groups.get(id);
                        let start = group.and_then(|group| group.start.as_ref());
                        let named = start.and_then(|start| start.named(number));
                        let max_skew_us = start.and_then(|start| start.max_skew_us(number));
                        if let (0, Some(max_skew_us)) = (number, max_skew_us) {
                            effects.push(self.start_plan(id, at, max_skew_us));
                        }
                        self.book.edit_whole(
                            id,
                            |job| {
                                if let Some(group) = &mut job.entry.group {
                                    group.planned.insert(number, at);
                                    group.named.extend(named.map(|named| (number, named)));
                                }
                            },
                            effects,
                        );
                    }
                    Step::Met => self.book.edit_whole(
                        id,
                        |job| {
                            if let Some(group) = &mut job.entry.group {
                                group.planned.remove(&number);
                                group.named.remove(&number);
                                group.started |= number == 0;
                            }
                        },
                        effects,
                    ),
                    Step::Failed(reasons) => {
                        let reasons: BTreeMap<_, _> = reasons.into_iter().collect();
                        if let Some(error) = joined(reasons.clone()) {
                            self.end_group(id, Ending::Fail(error), reasons, effects);
                        }
                    }
                }
            }
        }
    }

    /// Tells clients when a job starts, so that they can count down.
    fn start_plan(&self, id: &JobId, starts_at: FleetMicros, max_skew_us: f64) -> Effect {
        let plan = StartPlan {
            job: *id,
            told: self.now,
            starts_at,
            max_skew_us,
        };
        Effect::Publish {
            key: self.config.keys.start_plan(id).as_str().to_owned(),
            payload: to_json(&plan),
            json: true,
            lane: Lane::Record,
        }
    }

    fn start_message(&self, node: &NodeId, message: &StartMessage) -> Effect {
        let mut buffer = [0; 64];
        let bytes = keys::version::encode(message, &mut buffer)
            .expect("a message of a start has at most 47 bytes");
        Effect::Publish {
            key: self
                .config
                .keys
                .node(node, NodeTopic::Start)
                .as_str()
                .to_owned(),
            payload: match self.nodes.get(node) {
                Some(node) => node.facts().with_epoch(self.config.epoch, bytes),
                None => bytes.to_vec(),
            },
            json: false,
            // Only a commit needs the plan to be durable; whatever else is said depends on the
            // answer to one, or holds nodes back.
            lane: match message {
                StartMessage::Commit { .. } => Lane::Commit,
                _ => Lane::RealTime,
            },
        }
    }

    /// Lets the job end. `reasons`: of the nodes that are the cause.
    fn end_group(
        &mut self,
        id: &JobId,
        ending: Ending,
        reasons: BTreeMap<NodeId, JobError>,
        effects: &mut Vec<Effect>,
    ) {
        let open = self.book.get(id);
        if !open.is_some_and(|job| job.entry.ending.is_none() && !job.state().is_final()) {
            return;
        }
        self.book
            .edit_whole(id, |job| job.entry.ending = Some(ending), effects);
        self.end_parts(id, &reasons, effects);
    }

    /// Ends every part that has not been told to, also after a start of the gateway.
    fn apply_ending(&mut self, id: &JobId, effects: &mut Vec<Effect>) {
        let ending = self.book.get(id).and_then(|job| job.entry.ending.as_ref());
        if ending.is_some() {
            self.end_parts(id, &BTreeMap::new(), effects);
        }
    }

    fn end_parts(
        &mut self,
        id: &JobId,
        reasons: &BTreeMap<NodeId, JobError>,
        effects: &mut Vec<Effect>,
    ) {
        let now = self.now;
        let Some(group) = self.groups.get_mut(id) else {
            return;
        };
        if let Some(start) = &mut group.start {
            group.halts.extend(start.break_off(now));
        }
        let halts = group.halts.clone();
        // Aborts first: they depend on no write.
        self.advance_aborts(id, effects);
        let Some(job) = self.book.get(id) else { return };
        let Some(ending) = job.entry.ending.clone() else {
            return;
        };
        let parts = job.parts.iter().filter(|(_, part)| {
            let state = part.state();
            !state.is_final() && (part.entry.ending.is_none() || state == JobState::Lost)
        });
        let open: Vec<NodeId> = parts.map(|(node, _)| *node).collect();
        for node in open {
            let ending = match (&ending, reasons.get(&node)) {
                (Ending::Fail(_), Some(own)) => Ending::Fail(own.clone()),
                (Ending::Fail(error), None) => {
                    let message = format!("ended because of another part: {}", error.message);
                    Ending::Fail(JobError::new(error.code, message))
                }
                (ending, _) => ending.clone(),
            };
            let mode = if halts.contains(&node) {
                StopMode::Halt
            } else {
                StopMode::Decelerate
            };
            self.with_node(node, effects, |node, turn| {
                node.end_job(id, ending, mode, turn);
            });
        }
    }

    fn advance_aborts(&mut self, id: &JobId, effects: &mut Vec<Effect>) {
        // Whatever was broken off says nothing but aborts, and asks no clock.
        let steps = self.poll_start(id, false, effects);
        debug_assert!(steps.is_empty(), "{steps:?}");
    }

    /// Says what is due in a job's start, and returns what follows from it; nothing without a start.
    /// `with_clocks` lets it ask the clocks of nodes that are alive.
    fn poll_start(
        &mut self,
        id: &JobId,
        with_clocks: bool,
        effects: &mut Vec<Effect>,
    ) -> Vec<(u16, Step)> {
        let group = self.groups.get_mut(id);
        let Some(start) = group.and_then(|group| group.start.as_mut()) else {
            return Vec::new();
        };
        let mut said = Vec::new();
        let clock = |node: &NodeId| {
            let view = self.nodes.get(node);
            let view = view.filter(|view| with_clocks && view.is_alive());
            view.map(|view| view.clock())
        };
        let steps = start.poll(clock, self.now, |node, message| said.push((node, message)));
        for (node, message) in said {
            effects.push(self.start_message(&node, &message));
        }
        steps
    }

    fn group_due(&self, id: &JobId) -> Option<FleetMicros> {
        let job = self.book.get(id)?;
        let start = self.groups.get(id).and_then(|group| group.start.as_ref());
        let done = |part: &Job| part.state() == JobState::Succeeded;
        let all_done = job.parts.values().all(done);
        [
            start.and_then(Start::poll_timeout),
            self.deadline(id).filter(|_| !all_done),
            all_done.then(|| measuring_until(job)),
        ]
        .into_iter()
        .flatten()
        .min()
    }
}
