//! A synchronized job and its parts.
//!
//! ```text
//!   Job cut-7 ─┬─ parts[left]  Job cut-7: commands, activation, ending, state
//!              └─ parts[right] Job cut-7: …        all of it in one row of the store
//! ```
//!
//! A part is a [`Job`] of the same name, with a barrier in front of its commands; its node treats
//! it like any other job. Owns how the record of the whole follows from the parts:
//!
//! | the parts are | the whole is |
//! |---|---|
//! | not all sent | queued |
//! | all sent | sent |
//! | one runs or has run | running |
//! | one is lost | lost, unless it is queued |
//! | all final | succeeded if all are; else what ended it: failed, timed out, canceled |
//!
//! Promises: the record of the whole is a function of its parts and never goes back; each change of
//! a part is one version of it, and one write. Absent on purpose: what makes a part end because
//! another one did, and the start. Those are the fleet's.

use super::{Activation, Change, Ending, Job, ScriptEnd, is_legal};
use crate::fleet::start::NamedMeeting;
use keys::{
    FleetMicros, NodeId,
    job::JobSignature,
    record::{ErrorCode, JobError, JobState, PartRecord, Progress},
};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// What is stored of a synchronized job beside its record.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct GroupEntry {
    /// What clients do not see of each part.
    pub parts: BTreeMap<NodeId, PartEntry>,
    /// Meeting points for which a commit may be on its way, with the planned instant. Durable
    /// before the first commit leaves.
    pub planned: BTreeMap<u16, FleetMicros>,
    /// Those of them to which scripts have come.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub named: BTreeMap<u16, NamedMeeting>,
    /// Every node has passed the start.
    pub started: bool,
}

/// What is stored of one part beside its record.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct PartEntry {
    /// Where its commands are.
    pub activation: Option<Activation>,
    /// How it must end.
    pub ending: Option<Ending>,
    /// Whether its node has passed the start.
    pub passed: Passed,
    /// How its script has ended.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub script_end: Option<ScriptEnd>,
    /// The operator's signature.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub signature: Option<JobSignature>,
}

/// Whether a node has passed the barrier of a start, as far as is known.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub enum Passed {
    /// It has not, or has not said so yet.
    #[default]
    No,
    /// It has.
    Yes,
    /// The node went away without saying.
    Unknown,
}

impl Job {
    /// Returns whether it is a synchronized job.
    pub fn is_group(&self) -> bool {
        !self.parts.is_empty()
    }

    /// Returns whether every node has passed the start of this synchronized job.
    pub fn has_started(&self) -> bool {
        self.entry.group.as_ref().is_some_and(|group| group.started)
    }

    /// Returns when the last part's first command was sent; `None` until then.
    pub fn all_sent_at(&self) -> Option<FleetMicros> {
        let mut at = FleetMicros(0);
        for part in self.parts.values() {
            at = at.max(part.entry.activation?.at);
        }
        Some(at)
    }

    /// Makes the first record of the whole, of the version that it has.
    pub(crate) fn begin(&mut self) {
        let version = self.entry.record.version;
        self.gather(self.entry.record.updated);
        self.entry.record.version = version;
    }

    /// Writes down what clients do not see of the parts.
    pub(super) fn note_parts(&mut self) {
        let Some(group) = &mut self.entry.group else {
            return;
        };
        for (node, part) in &self.parts {
            group.parts.insert(
                *node,
                PartEntry {
                    activation: part.entry.activation,
                    ending: part.entry.ending.clone(),
                    passed: part.passed,
                    script_end: part.entry.script_end.clone(),
                    signature: part.entry.signature.clone(),
                },
            );
        }
    }

    /// Makes the record of the whole from the parts: one version more.
    ///
    /// # Panics
    /// The change is not legal: a bug of the caller.
    pub(super) fn gather(&mut self, now: FleetMicros) {
        let change = self.conclusion();
        let record = &mut self.entry.record;
        let before = record.state;
        assert!(
            is_legal(before, change.state) || (before == change.state && !before.is_final()),
            "job {}: {before} may not become {}",
            record.job,
            change.state
        );
        record.state = change.state;
        record.version += 1;
        record.updated = FleetMicros(now.0.max(record.updated.0));
        record.progress = Progress::default();
        for part in self.parts.values() {
            record.progress.done += part.entry.record.progress.done;
            record.progress.total += part.entry.record.progress.total;
        }
        record.parts = Some(self.parts.iter().map(part_record).collect());
        self.progress_told_at = now;
        for part in self.parts.values_mut() {
            part.progress_told_at = now;
        }
        self.entry.note_step();
        let record = &mut self.entry.record;
        if change.state.is_final() {
            record.error = change.error;
            self.split = self.is_split();
            self.entry.ending = None;
            self.entry.group = None;
        } else {
            self.note_parts();
        }
    }

    fn conclusion(&self) -> Change {
        use JobState::{Canceled, Failed, Lost, Queued, Running, Sent, Succeeded, TimedOut};
        let states = || self.parts.values().map(Job::state);
        let before = self.state();
        if states().all(|state| state == Succeeded) {
            let held = self.measuring && self.entry.ending.is_none();
            return Change::to(if held { Running } else { Succeeded });
        }
        if states().all(JobState::is_final) {
            let change = match &self.entry.ending {
                Some(ending) => ending.change(),
                None => match self.reasons() {
                    Some(error) => Change::to(Failed).error(error),
                    None if states().any(|state| state == TimedOut) => Change::to(TimedOut),
                    None => Change::to(Canceled),
                },
            };
            let error = change.error.clone();
            return Change {
                error: error.map(|error| self.with_who_moved(error)),
                ..change
            };
        }
        let all_sent = states().all(|state| state != Queued);
        let moves = |part: &Job| part.state() == Running || part.passed == Passed::Yes;
        Change::to(match before {
            Queued if !all_sent => Queued,
            _ if states().any(|state| state == Lost) && before != Queued => Lost,
            Running => Running,
            _ if before != Queued && (self.has_started() || self.parts.values().any(moves)) => {
                Running
            }
            _ => Sent,
        })
    }

    /// Returns what the parts that failed say, each with the name of its node.
    pub fn reasons(&self) -> Option<JobError> {
        let failed = self.parts.iter().filter_map(|(node, part)| {
            let error = part.entry.record.error.as_ref();
            error.map(|error| (*node, error.clone()))
        });
        joined(failed)
    }

    /// A start that failed must say who moved all the same.
    fn with_who_moved(&self, error: JobError) -> JobError {
        if self.has_started() {
            return error;
        }
        let names = |passed: Passed| {
            let parts = self.parts.iter();
            let parts = parts.filter(|(_, part)| self.has_passed(part) == passed);
            let names: Vec<&str> = parts.map(|(node, _)| node.as_str()).collect();
            names.join(", ")
        };
        let (moved, unknown) = (names(Passed::Yes), names(Passed::Unknown));
        let mut message = error.message;
        if moved.is_empty() && unknown.is_empty() {
            message += "; no node moved";
        }
        for (what, names) in [
            ("moved", moved),
            ("did not move", names(Passed::No)),
            ("may have moved", unknown),
        ] {
            let plain = what == "did not move" && message.ends_with("no node moved");
            if !names.is_empty() && !plain {
                message += &format!("; {what}: {names}");
            }
        }
        JobError::new(error.code, message)
    }

    /// A start that is not over although some nodes have passed it, or may have.
    fn is_split(&self) -> bool {
        let moved = |part: &Job| self.has_passed(part) != Passed::No;
        !self.has_started() && self.parts.values().any(moved)
    }

    /// Without a commit on its way nothing can have moved, whatever a node did not say.
    fn has_passed(&self, part: &Job) -> Passed {
        let group = self.entry.group.as_ref();
        match part.passed {
            Passed::Unknown if !group.is_some_and(|group| group.planned.contains_key(&0)) => {
                Passed::No
            }
            passed => passed,
        }
    }
}

/// Puts the reasons of several nodes together; the first one gives the code.
pub fn joined(reasons: impl IntoIterator<Item = (NodeId, JobError)>) -> Option<JobError> {
    let mut whole: Option<(ErrorCode, String)> = None;
    for (node, error) in reasons {
        let words = format!("{node}: {}", error.message);
        match &mut whole {
            None => whole = Some((error.code, words)),
            Some((_, message)) => {
                *message += "; ";
                *message += &words;
            }
        }
    }
    whole.map(|(code, message)| JobError::new(code, message))
}

fn part_record((node, part): (&NodeId, &Job)) -> (NodeId, PartRecord) {
    let record = &part.entry.record;
    (
        *node,
        PartRecord {
            state: record.state,
            progress: record.progress,
            error: record.error.clone(),
            result: record.result.clone(),
        },
    )
}
