//! What operators arrange besides jobs: labels of nodes, maintenance, and the order of jobs that wait.
//!
//! | get on | with | answers |
//! |---|---|---|
//! | `PREFIX/manage/node/NODE`, also wild | [`NodeWishes`] in JSON, or nothing | [`Arrangement`] of each node |
//! | `PREFIX/manage/job/JOB` | [`OrderWishes`] in JSON, or nothing | its [`Story`] |
//! | `PREFIX/manage/link/NODE`, also wild | nothing | [`LinkRecord`](keys::record::LinkRecord) of each node |
//! | `PREFIX/manage/label/LABEL/job`, also put | a job | as on a wild key: a receipt for each node that has the label and is alive |
//!
//! Beside the job itself an attachment in JSON, [`JobWishes`], says how important it is and when it may
//! begin. All of it is durable. A node in maintenance is given no job: a new one is refused with the
//! reason, those that wait go on waiting, the one that runs ends.
//!
//! # Order
//! Jobs that wait for a node are taken by priority, then by their place, which is the order of their
//! coming unless somebody moved them. Synchronized jobs are not moved and have priority 0: in another
//! order on another node, two of them would wait for each other for ever.

use super::{
    Fleet, error_reply,
    event::{Effect, Event, ReplyTo},
    no_job,
    pattern::Pattern,
};
use crate::job::{Job, JobEntry};
use keys::{
    FleetMicros, GroupId, JobId, NodeId,
    record::{ErrorCode, JobError, JobState, to_json},
};
use serde::{Deserialize, Deserializer, Serialize, de};
use std::{cmp::Reverse, collections::BTreeSet};

/// Priorities, both ways from 0. Higher goes first.
pub const PRIORITY_MAX: i8 = 100;

/// Labels of one node at most.
pub const LABELS_MAX: usize = 32;

/// Longest reason of a maintenance, bytes.
pub const REASON_BYTES_MAX: usize = 200;

/// Places between two jobs that came one after the other: twenty moves into the same gap.
const PLACES_PER_JOB: u64 = 1 << 20;

/// How important a job is, and when it may begin: the attachment beside a job.
#[derive(Clone, Debug, Default, PartialEq, Eq, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct JobWishes {
    /// −[`PRIORITY_MAX`] to [`PRIORITY_MAX`]. Default 0.
    pub priority: i8,
    /// Not before this instant; RFC 3339 in UTC. It waits in its node's queue meanwhile.
    #[serde(deserialize_with = "instant")]
    pub not_before: Option<FleetMicros>,
    /// Only when nothing else waits for the node: behind every priority.
    pub when_idle: bool,
}

/// What to change of a node. What is absent stays.
#[derive(Clone, Debug, Default, PartialEq, Eq, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct NodeWishes {
    /// Labels to add.
    pub label: Vec<GroupId>,
    /// Labels to take away.
    pub unlabel: Vec<GroupId>,
    /// `{"reason":"…"}` begins a maintenance, `false` ends it.
    pub maintenance: Option<MaintenanceWish>,
    /// `true`: jobs are taken and wait, the one that runs ends; `false`: they go on.
    pub hold_queue: Option<bool>,
}

/// Begins or ends a maintenance.
#[derive(Clone, Debug, PartialEq, Eq, Deserialize)]
#[serde(untagged)]
pub enum MaintenanceWish {
    /// Ends it (`false`); `true` is refused, because it gives no reason.
    On(bool),
    /// Begins it.
    Because {
        /// Why, for whoever is refused.
        reason: String,
    },
}

/// Where to put a job among those that wait. One of the two.
#[derive(Clone, Debug, Default, PartialEq, Eq, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct OrderWishes {
    /// −[`PRIORITY_MAX`] to [`PRIORITY_MAX`].
    pub priority: Option<i8>,
    /// Right before this job, with its priority.
    pub before: Option<JobId>,
}

/// How a node is arranged.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct Arrangement {
    /// The node.
    pub node: NodeId,
    /// Its labels.
    pub labels: BTreeSet<GroupId>,
    /// Why it takes no jobs.
    pub maintenance: Option<String>,
    /// Jobs are taken, and none begins.
    #[serde(skip_serializing_if = "is_false")]
    pub queue_held: bool,
    /// The jobs that wait, in the order in which they would be taken.
    pub waiting: Vec<JobId>,
}

/// The way of a job, as far as it has come.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Story {
    /// The job.
    pub job: JobId,
    /// Its node.
    pub node: Option<NodeId>,
    /// Where it is.
    pub state: JobState,
    /// Its priority; `-32768`: when idle.
    pub priority: i16,
    /// When it may begin, RFC 3339.
    pub not_before: Option<String>,
    /// While it waits: all that wait for its node, in their order.
    pub waiting: Option<Vec<JobId>>,
    /// When it came into which state, RFC 3339, first things first.
    pub steps: Vec<(String, JobState)>,
    /// What its nodes have told of it, first things first.
    pub told: Vec<ToldStep>,
}

/// What a node has told of a job.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct ToldStep {
    /// When, on the gateway's clock, RFC 3339.
    pub at: String,
    /// How far that may be wrong, µs; `null`: the node's clock was not known.
    pub error_us: Option<f64>,
    /// Who.
    pub node: NodeId,
    /// What, in words.
    pub event: String,
    /// Events before it that were not heard.
    pub missed: u32,
}

/// What a job waits for: kept with it.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Turnplace {
    /// Higher goes first.
    #[serde(default, skip_serializing_if = "is_zero")]
    pub priority: i16,
    /// Its place, when it was moved.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub place: Option<u64>,
    /// When it may begin.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub not_before: Option<FleetMicros>,
}

#[expect(clippy::trivially_copy_pass_by_ref, reason = "serde calls it so")]
fn is_false(value: &bool) -> bool {
    !*value
}

#[expect(clippy::trivially_copy_pass_by_ref, reason = "serde calls it so")]
fn is_zero(value: &i16) -> bool {
    *value == 0
}

impl JobWishes {
    /// Reads an attachment.
    ///
    /// # Errors
    /// What is wrong with it.
    pub fn from_json(payload: &[u8]) -> Result<Self, JobError> {
        let wishes: Self = read(payload, "attachment")?;
        check_priority(wishes.priority)?;
        if wishes.when_idle && wishes.priority != 0 {
            return Err(bad(
                "attachment: `when_idle` is behind every priority: give one of the two",
            ));
        }
        Ok(wishes)
    }

    pub(super) fn turnplace(&self) -> Turnplace {
        Turnplace {
            priority: if self.when_idle {
                i16::MIN
            } else {
                i16::from(self.priority)
            },
            place: None,
            not_before: self.not_before,
        }
    }
}

impl NodeWishes {
    /// Reads a payload; an empty one changes nothing.
    ///
    /// # Errors
    /// What is wrong with it.
    pub fn from_json(payload: &[u8]) -> Result<Self, JobError> {
        if payload.is_empty() {
            return Ok(Self::default());
        }
        let wishes: Self = read(payload, "manage")?;
        match &wishes.maintenance {
            Some(MaintenanceWish::On(true)) => {
                Err(bad("maintenance: a reason is missing: {\"reason\":\"…\"}"))
            }
            Some(MaintenanceWish::Because { reason })
                if reason.is_empty() || reason.len() > REASON_BYTES_MAX =>
            {
                Err(bad(&format!(
                    "maintenance.reason: 1 to {REASON_BYTES_MAX} bytes"
                )))
            }
            _ => Ok(wishes),
        }
    }
}

impl OrderWishes {
    /// Reads a payload; an empty one changes nothing.
    ///
    /// # Errors
    /// What is wrong with it.
    pub fn from_json(payload: &[u8]) -> Result<Self, JobError> {
        if payload.is_empty() {
            return Ok(Self::default());
        }
        let wishes: Self = read(payload, "manage")?;
        if let Some(priority) = wishes.priority {
            check_priority(priority)?;
            if wishes.before.is_some() {
                return Err(bad("either `priority` or `before`"));
            }
        }
        Ok(wishes)
    }
}

fn instant<'de, D: Deserializer<'de>>(from: D) -> Result<Option<FleetMicros>, D::Error> {
    let text = String::deserialize(from)?;
    let error = || de::Error::custom(format!("`{text}` is no time in UTC: 2026-11-22T03:00:00Z"));
    FleetMicros::from_rfc3339(&text).map(Some).ok_or_else(error)
}

fn read<'p, T: Deserialize<'p>>(payload: &'p [u8], what: &str) -> Result<T, JobError> {
    // A list of values would be taken for the fields in their order.
    if payload.trim_ascii_start().first() != Some(&b'{') {
        return Err(bad(&format!("{what}: an object is needed")));
    }
    serde_json::from_slice(payload).map_err(|error| bad(&format!("{what}: {error}")))
}

fn bad(message: &str) -> JobError {
    JobError::new(ErrorCode::BadJson, message)
}

fn check_priority(priority: i8) -> Result<(), JobError> {
    if (-PRIORITY_MAX..=PRIORITY_MAX).contains(&priority) {
        return Ok(());
    }
    Err(bad(&format!(
        "priority: {priority} is not within -{PRIORITY_MAX} to {PRIORITY_MAX}"
    )))
}

/// Returns what jobs that wait are sorted by.
pub(super) fn rank(entry: &JobEntry) -> (Reverse<i16>, u64) {
    let place = entry.turn.place;
    let place = place.unwrap_or_else(|| entry.sequence.saturating_mul(PLACES_PER_JOB));
    (Reverse(entry.turn.priority), place)
}

impl Fleet {
    /// Takes a job with wishes.
    pub(super) fn submit_with(
        &mut self,
        wishes: JobWishes,
        submit: Event,
        now: FleetMicros,
        effects: &mut Vec<Effect>,
    ) {
        self.wishes = wishes;
        self.handle(submit, now, effects);
        self.wishes = JobWishes::default();
    }

    pub(super) fn manage_nodes(
        &mut self,
        pattern: &str,
        request: Result<NodeWishes, JobError>,
        to: ReplyTo,
        effects: &mut Vec<Effect>,
    ) {
        let found = self.matching(pattern);
        let outcome = request.and_then(|wishes| {
            if found.is_empty() && matches!(Pattern::new(pattern), Pattern::Name(_)) {
                return Err(self.nobody(pattern));
            }
            let full = |id: &NodeId| {
                let labels = &self.nodes[id].facts().labels;
                let added = wishes.label.iter().filter(|label| !labels.contains(label));
                labels.len() + added.count() > LABELS_MAX
            };
            match found.iter().find(|id| full(id)) {
                Some(id) => Err(bad(&format!(
                    "node {id} would have more than {LABELS_MAX} labels"
                ))),
                None => Ok(wishes),
            }
        });
        match outcome {
            Err(error) => effects.push(error_reply(to, error)),
            Ok(wishes) => {
                for id in found {
                    self.with_node(id, effects, |node, turn| node.arrange(&wishes, turn));
                    effects.push(self.arrangement_reply(&id, format!("node/{id}"), to));
                }
            }
        }
        effects.push(Effect::ReplyEnd { to });
    }

    pub(super) fn manage_job(
        &mut self,
        name: &str,
        request: Result<OrderWishes, JobError>,
        to: ReplyTo,
        effects: &mut Vec<Effect>,
    ) {
        let outcome = request.and_then(|wishes| self.reorder(name, &wishes, effects));
        match outcome {
            Err(error) => effects.push(error_reply(to, error)),
            Ok(id) => effects.extend(self.story_reply(&id, to)),
        }
        effects.push(Effect::ReplyEnd { to });
    }

    fn reorder(
        &mut self,
        name: &str,
        wishes: &OrderWishes,
        effects: &mut Vec<Effect>,
    ) -> Result<JobId, JobError> {
        let id = JobId::new(name).ok();
        let job = id
            .and_then(|id| self.book.get(&id))
            .ok_or_else(|| no_job(name))?;
        if *wishes == OrderWishes::default() {
            return Ok(job.id());
        }
        let (id, node) = (job.id(), movable(job)?);
        let mut turn = job.entry.turn;
        if let Some(priority) = wishes.priority {
            turn.priority = i16::from(priority);
            turn.place = None;
        } else if let Some(before) = wishes.before {
            let other = self
                .book
                .get(&before)
                .ok_or_else(|| no_job(before.as_str()))?;
            // A synchronized one stays where it is, but another may go before it.
            let waits = other.state() == JobState::Queued;
            let view = &self.nodes[&node];
            let mut waiting: Vec<JobId> = view.waiting().filter(|other| *other != id).collect();
            let index = waiting.iter().position(|other| *other == before);
            let Some(index) = index.filter(|_| waits) else {
                let message = format!("job {before} does not wait for node {node}");
                return Err(JobError::new(ErrorCode::NotAllowed, message));
            };
            let rank_of = |id: &JobId| {
                let part = self.book.part(id, node);
                part.map(|job| rank(&job.entry))
            };
            let behind = rank_of(&before).map_or(0, |(_, place)| place);
            let ahead = waiting
                .drain(..index)
                .next_back()
                .and_then(|id| rank_of(&id));
            let ahead = ahead
                .filter(|(Reverse(priority), _)| *priority == other.entry.turn.priority)
                .map_or(0, |(_, place)| place);
            let place = u64::midpoint(ahead, behind);
            if place <= ahead && place != 0 {
                let message = "too many jobs were moved into this gap: move another one";
                return Err(JobError::new(ErrorCode::TooLarge, message));
            }
            turn.priority = other.entry.turn.priority;
            turn.place = Some(place);
        }
        self.book
            .edit_whole(&id, |job| job.entry.turn = turn, effects);
        self.with_node(node, effects, |node, turn| node.sort_waiting(turn.book));
        Ok(id)
    }

    /// Answers with a job's way up to now.
    fn story_reply(&self, id: &JobId, to: ReplyTo) -> Option<Effect> {
        let entry = &self.book.get(id)?.entry;
        let waiting = entry
            .record
            .node
            .filter(|_| entry.record.state == JobState::Queued);
        let waiting = waiting.and_then(|node| self.nodes.get(&node));
        let mut told = entry.told.clone();
        told.sort_by_key(|told| told.at);
        let told = told.iter().map(|told| ToldStep {
            at: told.at.to_string(),
            error_us: told.error_us,
            node: told.node,
            event: told.what.to_string(),
            missed: told.missed,
        });
        let story = Story {
            job: *id,
            node: entry.record.node,
            state: entry.record.state,
            priority: entry.turn.priority,
            not_before: entry.turn.not_before.map(|at| at.to_string()),
            waiting: waiting.map(|node| node.waiting().collect()),
            steps: entry
                .steps
                .iter()
                .map(|step| (step.at.to_string(), step.state))
                .collect(),
            told: told.collect(),
        };
        Some(Effect::Reply {
            to,
            key: Some(format!("{}/manage/job/{id}", self.config.keys.prefix())),
            payload: to_json(&story),
        })
    }

    /// Answers how long messages travel to each node.
    pub(super) fn get_links(&self, pattern: &str, to: ReplyTo, effects: &mut Vec<Effect>) {
        let prefix = self.config.keys.prefix();
        for id in self.matching(pattern) {
            effects.push(Effect::Reply {
                to,
                key: Some(format!("{prefix}/manage/link/{id}")),
                payload: to_json(&self.nodes[&id].link_record(self.now)),
            });
        }
        effects.push(Effect::ReplyEnd { to });
    }

    fn arrangement_reply(&self, id: &NodeId, key: String, to: ReplyTo) -> Effect {
        let node = &self.nodes[id];
        let arrangement = Arrangement {
            node: *id,
            labels: node.facts().labels.clone(),
            maintenance: node.facts().maintenance.clone(),
            queue_held: node.facts().queue_held,
            waiting: node.waiting().collect(),
        };
        Effect::Reply {
            to,
            key: Some(format!("{}/manage/{key}", self.config.keys.prefix())),
            payload: to_json(&arrangement),
        }
    }
}

/// Returns the node of a job that can be moved.
fn movable(job: &Job) -> Result<NodeId, JobError> {
    let refused = |message: String| Err(JobError::new(ErrorCode::NotAllowed, message));
    let id = job.id();
    if job.is_group() {
        return refused(format!(
            "{id} is a synchronized job: move the others around it"
        ));
    }
    match job.node() {
        Some(node) if job.state() == JobState::Queued => Ok(node),
        _ => refused(format!(
            "{id} does not wait any more: it is {}",
            job.state()
        )),
    }
}
