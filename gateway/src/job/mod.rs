//! One job: its record as clients see it, where its commands are, and which changes are legal.
//!
//! ```text
//!            ┌──────────────── lost ◀────────────┐
//!            ▼ node is back      ▲ node is gone  │
//!   queued ─▶ sent ─────────▶ running ───────────┤
//!     │         │                │               ▼
//!     └─────────┴────────────────┴──▶ succeeded · failed · canceled · timed_out
//!   (refused) ─▶ rejected
//! ```
//!
//! Promises: every change of a record goes through [`Job::change`], which asserts the table
//! [`is_legal`], counts the version up by one and stamps the time. A final record never changes.
//!
//! # Why nothing is journaled per batch
//! The queue's commands are numbered, a node says how many it has, and the commands of a job are
//! cut from the stored request in the same order each time. So what must be durable before
//! anything is published is the job itself and its [`Activation`]: which queue, and the number of
//! its first command there. After a restart the place to go on is `accepted_commands - base`.
//!
//! A synchronized job has a part for each of its nodes, which is a [`Job`] of the same name: what
//! `group` says of both.

pub mod book;
pub mod gcode;
pub mod group;
pub mod parse;

use crate::fleet::manage::Turnplace;
use group::{GroupEntry, Passed};
use keys::{
    Command, FleetMicros, JobId, NodeId, QueueId,
    job::JobSignature,
    record::{JobError, JobRecord, JobResult, JobState, Progress},
    trace::TraceWord,
};
use serde::{Deserialize, Serialize};
use std::{collections::BTreeMap, sync::Arc};

/// Where a job's commands are on its node. Durable before the first of them is published.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Activation {
    /// The life of the node's queue that has them.
    pub queue: QueueId,
    /// The number of the job's first command in that queue.
    pub base: u64,
    /// When the first batch was due to leave.
    pub at: FleetMicros,
}

/// How a job must end although its commands are not all done.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub enum Ending {
    /// A client canceled it.
    Cancel,
    /// It took too long.
    Timeout,
    /// Something is wrong with it.
    Fail(JobError),
}

impl Ending {
    /// Returns the change that it leads to.
    pub fn change(&self) -> Change {
        match self {
            Self::Cancel => Change::to(JobState::Canceled),
            // Both states say all there is to say; no error code means either.
            Self::Timeout => Change::to(JobState::TimedOut),
            Self::Fail(error) => Change::to(JobState::Failed).error(error.clone()),
        }
    }
}

/// What is stored of a job beside the request.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct JobEntry {
    /// The record as clients see it.
    pub record: JobRecord,
    /// Grows with each job that is accepted or rejected: the order of history.
    pub sequence: u64,
    /// Where its commands are, from `sent` on.
    pub activation: Option<Activation>,
    /// How it must end.
    pub ending: Option<Ending>,
    /// Longest time from activation to the last pulse, µs.
    pub timeout_us: Option<u64>,
    /// When its turn comes among those that wait.
    #[serde(default, skip_serializing_if = "is_default")]
    pub turn: Turnplace,
    /// When it came into which state, first things first; the first [`STEPS_MAX`].
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub steps: Vec<Step>,
    /// What its nodes have told of it, as it came; the first [`TOLD_MAX`] and the last one.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub told: Vec<Told>,
    /// What else is stored of a synchronized job that is not final.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub group: Option<Box<GroupEntry>>,
    /// How its script has ended, once the node has said so.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub script_end: Option<ScriptEnd>,
    /// The operator's signature.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub signature: Option<JobSignature>,
}

/// Steps that are kept of a job: a node that comes and goes all day makes no more of them.
pub const STEPS_MAX: usize = 32;

/// Events of its nodes that are kept of a job.
pub const TOLD_MAX: usize = 64;

/// Something that a node has told of a job.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Told {
    /// When, on the gateway's clock.
    pub at: FleetMicros,
    /// How far that may be wrong, µs; `None`: the node's clock was not known.
    pub error_us: Option<f64>,
    /// Who.
    pub node: NodeId,
    /// What.
    pub what: TraceWord,
    /// Events of the node before it that were not heard.
    #[serde(default, skip_serializing_if = "is_none_missed")]
    pub missed: u32,
}

#[expect(clippy::trivially_copy_pass_by_ref, reason = "serde calls it so")]
fn is_none_missed(missed: &u32) -> bool {
    *missed == 0
}

/// A change of a job's state.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Step {
    /// When.
    pub at: FleetMicros,
    /// Into which.
    pub state: JobState,
}

/// Returns how many commands would take as much memory as a script.
pub fn held_of_script(script: Option<&str>) -> usize {
    const COMMAND_BYTES: usize = 4 * keys::command::COMMAND_WORDS;
    script.map_or(0, |script| script.len().div_ceil(COMMAND_BYTES))
}

/// A script has returned; the commands that it queued may still be executed.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct ScriptEnd {
    /// The number behind its last command in the node's queue.
    pub end: u64,
    /// What it returned.
    pub returned: Option<serde_json::Value>,
}

fn is_default(turn: &Turnplace) -> bool {
    *turn == Turnplace::default()
}

impl JobEntry {
    /// Of a job that is no node's yet and has no limit.
    pub fn new(record: JobRecord, sequence: u64) -> Self {
        let begin = Step {
            at: record.created,
            state: record.state,
        };
        Self {
            record,
            sequence,
            activation: None,
            ending: None,
            timeout_us: None,
            turn: Turnplace::default(),
            steps: vec![begin],
            told: Vec::new(),
            group: None,
            script_end: None,
            signature: None,
        }
    }
}

impl JobEntry {
    /// Notes the record's state, if it is another one than before.
    fn note_step(&mut self) {
        let (at, state) = (self.record.updated, self.record.state);
        let news = self.steps.last().is_none_or(|step| step.state != state);
        // The last place is kept for the end.
        if news && (self.steps.len() + 1 < STEPS_MAX || state.is_final()) {
            self.steps.push(Step { at, state });
        }
    }
}

/// A job as the fleet keeps it.
#[derive(Clone, Debug)]
pub struct Job {
    /// What is stored.
    pub entry: JobEntry,
    /// Its commands, empty when it is final.
    pub commands: Arc<[Command]>,
    /// Its script, if it has one and is not final.
    pub script: Option<Arc<str>>,
    /// How many commands come before the client's own: in a part the barrier of its start, and with
    /// a script the number that the script itself takes.
    pub head_commands: u64,
    /// When its progress was published last.
    pub progress_told_at: FleetMicros,
    /// The parts of a synchronized job, by node; none of any other.
    pub parts: BTreeMap<NodeId, Job>,
    /// Of a part: whether its node has passed the start.
    pub passed: Passed,
    /// Of a synchronized job: its record waits for the nodes' measurement of the start, although
    /// all parts have succeeded.
    pub measuring: bool,
    /// Of a synchronized job that is final: its start was not over, and some nodes have passed it
    /// or may have.
    pub split: bool,
}

/// Returns whether a job may go from one state to another. Staying is a change of progress.
pub const fn is_legal(from: JobState, to: JobState) -> bool {
    use JobState::{Canceled, Failed, Lost, Queued, Running, Sent, Succeeded, TimedOut};
    match from {
        Queued => matches!(to, Sent | Failed | Canceled),
        Sent | Running | Lost if matches!(to, Succeeded | Failed | Canceled | TimedOut) => true,
        Sent => matches!(to, Sent | Running | Lost),
        Running => matches!(to, Running | Lost),
        Lost => matches!(to, Sent | Running),
        Succeeded | Failed | Canceled | TimedOut | JobState::Rejected => false,
    }
}

impl Job {
    /// Makes the job of a record that was just accepted, rejected or read from the store.
    pub fn new(entry: JobEntry, commands: Arc<[Command]>) -> Self {
        Self {
            progress_told_at: entry.record.updated,
            entry,
            commands,
            script: None,
            head_commands: 0,
            parts: BTreeMap::new(),
            passed: Passed::No,
            measuring: false,
            split: false,
        }
    }

    /// Returns its name.
    pub fn id(&self) -> JobId {
        self.entry.record.job
    }

    /// Returns its node, `None` for a refused one that names none.
    pub fn node(&self) -> Option<NodeId> {
        self.entry.record.node
    }

    /// Returns where it is.
    pub fn state(&self) -> JobState {
        self.entry.record.state
    }

    /// Returns how much it takes in memory while it is not final, in commands; without its parts.
    pub fn held(&self) -> usize {
        self.commands.len() + held_of_script(self.script.as_deref())
    }

    /// Gives it a script, for which it has no commands of its own.
    #[must_use]
    pub fn with_script(mut self, script: Option<Arc<str>>) -> Self {
        if script.is_some() {
            self.script = script;
            self.head_commands += 1;
        }
        self
    }

    /// Returns the number behind everything that the gateway sends of it.
    pub fn end(&self) -> Option<u64> {
        let activation = self.entry.activation?;
        let sent = self.commands.len() as u64 + u64::from(self.script.is_some());
        Some(activation.base + sent)
    }

    /// Returns whether all its commands have ended when the queue has executed so many. A script
    /// may queue more until it has ended.
    pub fn is_done(&self, executed_commands: u64) -> bool {
        match (&self.script, &self.entry.script_end) {
            (Some(_), None) => false,
            (Some(_), Some(script_end)) => executed_commands >= script_end.end,
            (None, _) => self.done_of(executed_commands) >= self.entry.record.progress.total,
        }
    }

    /// A script has queued so many commands that its queue has accepted so many.
    pub fn note_accepted(&mut self, accepted_commands: u64) {
        let Some(activation) = self.entry.activation else {
            return;
        };
        if self.script.is_some() && self.entry.script_end.is_none() {
            let own = accepted_commands.saturating_sub(activation.base + self.head_commands);
            let progress = &mut self.entry.record.progress;
            progress.total = progress.total.max(own);
        }
    }

    /// Returns when it must be stopped, if it has a limit and runs.
    pub fn deadline(&self) -> Option<FleetMicros> {
        let limited = self.entry.ending.is_none() && !self.state().is_final();
        let activation = self.entry.activation.filter(|_| limited)?;
        Some(activation.at.plus_us(self.entry.timeout_us?))
    }

    /// Returns how many of its commands are done when the queue has executed so many.
    pub fn done_of(&self, executed_commands: u64) -> u64 {
        let base = self
            .entry
            .activation
            .map_or(0, |activation| activation.base);
        executed_commands
            .saturating_sub(base + self.head_commands)
            .min(self.entry.record.progress.total)
    }

    /// Changes the record: the only way to do so.
    ///
    /// # Panics
    /// The change is not legal: a bug of the caller.
    pub fn change(&mut self, change: Change, now: FleetMicros) {
        let record = &mut self.entry.record;
        assert!(
            is_legal(record.state, change.state),
            "job {}: {} may not become {}",
            record.job,
            record.state,
            change.state
        );
        record.state = change.state;
        record.version += 1;
        record.updated = FleetMicros(now.0.max(record.updated.0));
        if let Some(done) = change.done {
            // A node's older word must not take back what was reported.
            record.progress.done = record.progress.done.max(done);
        }
        self.entry.note_step();
        let record = &mut self.entry.record;
        if change.state.is_final() {
            record.error = change.error;
            record.result = change.result;
            self.commands = Arc::new([]);
            self.script = None;
            self.entry.signature = None;
            self.entry.ending = None;
            self.entry.script_end = None;
        }
    }
}

/// One change of a record.
#[derive(Clone, Debug)]
pub struct Change {
    /// Where the job is now.
    pub state: JobState,
    /// How many commands are done, if that is news.
    pub done: Option<u64>,
    /// Why it ended early; kept for final states only.
    pub error: Option<JobError>,
    /// What it left behind; kept for final states only.
    pub result: Option<JobResult>,
}

impl Change {
    /// Changes the state alone.
    pub const fn to(state: JobState) -> Self {
        Self {
            state,
            done: None,
            error: None,
            result: None,
        }
    }

    /// Tells also how many commands are done.
    #[must_use]
    pub const fn done(mut self, done: u64) -> Self {
        self.done = Some(done);
        self
    }

    /// Tells also why.
    #[must_use]
    pub fn error(mut self, error: JobError) -> Self {
        self.error = Some(error);
        self
    }

    /// Tells also where the axes are.
    #[must_use]
    pub fn position(mut self, position: impl IntoIterator<Item = i64>) -> Self {
        self.result = Some(JobResult {
            position: position.into_iter().collect(),
            returned: None,
        });
        self
    }

    /// Tells also what its script returned.
    #[must_use]
    pub fn returned(mut self, script_end: Option<ScriptEnd>) -> Self {
        if let Some(result) = &mut self.result {
            result.returned = script_end.and_then(|script_end| script_end.returned);
        }
        self
    }
}

/// Makes a record of version 1.
pub(crate) fn new_record(
    job: JobId,
    node: Option<NodeId>,
    state: JobState,
    total: u64,
    now: FleetMicros,
) -> JobRecord {
    JobRecord {
        job,
        node,
        group: None,
        state,
        version: 1,
        created: now,
        updated: now,
        progress: Progress { done: 0, total },
        error: None,
        result: None,
        parts: None,
        start: None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_final_state_is_the_last_one_and_every_other_leads_to_one() {
        for from in JobState::ALL {
            let ways_out = JobState::ALL
                .into_iter()
                .filter(|to| is_legal(from, *to))
                .count();
            assert_eq!(ways_out == 0, from.is_final(), "{from}");
            assert_eq!(is_legal(from, JobState::Failed), !from.is_final(), "{from}");
            assert!(!is_legal(from, JobState::Queued), "{from}");
            assert!(!is_legal(from, JobState::Rejected), "{from}");
        }
    }

    #[test]
    #[should_panic(expected = "succeeded may not become running")]
    fn an_illegal_change_is_a_bug() {
        let id = JobId::new("a").expect("legal");
        let record = new_record(id, None, JobState::Succeeded, 1, FleetMicros(1));
        Job::new(JobEntry::new(record, 1), Arc::new([]))
            .change(Change::to(JobState::Running), FleetMicros(2));
    }
}
