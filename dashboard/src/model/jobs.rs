//! The jobs that the gateway tells of, and those that this window sent.

use super::limits::{JOBS_MAX, SENT_BYTES_MAX, SENT_MAX, SKEW_PROMISED_US};
use crate::{
    message::{Answer, Moment},
    request::{Language, Ticket},
};
use keys::{FleetMicros, JobId, job::GroupRequest, record::JobRecord};
use std::collections::{BTreeMap, BTreeSet, VecDeque};

/// How the target of a synchronized job begins, see [`Target`](crate::request::Target).
const GROUP_MARK: &str = "group ";

/// A job that this window sent.
#[derive(Clone, Debug, PartialEq)]
pub struct Sent {
    /// Identifies the request.
    pub ticket: Ticket,
    /// For whom, as typed.
    pub target: String,
    /// The text; empty if it was longer than [`SENT_BYTES_MAX`].
    pub payload: String,
    /// Its language.
    pub language: Language,
    /// When.
    pub at: Moment,
    /// What the gateway said; `None` until it does.
    pub answer: Option<Answer>,
    /// The largest skew that it asked for, if it is a synchronized job that says so, µs.
    pub max_skew_us: Option<f64>,
}

impl Sent {
    /// Returns whether the gateway took it as this job.
    fn is(&self, job: &JobId) -> bool {
        let jobs = self.answer.as_ref().map(Answer::jobs).unwrap_or_default();
        jobs.contains(job)
    }
}

/// See the module.
#[derive(Debug, Default)]
pub struct Jobs {
    records: BTreeMap<JobId, JobRecord>,
    by_age: BTreeSet<(FleetMicros, JobId)>,
    sent: VecDeque<Sent>,
    revision: u64,
}

impl Jobs {
    pub(super) fn record(&mut self, record: JobRecord) {
        let key = (record.created, record.job);
        match self.records.get(&record.job) {
            // An id that was made again after its record was forgotten starts at version 1.
            Some(known) if known.created == record.created && known.version >= record.version => {
                return;
            }
            Some(known) => {
                self.by_age.remove(&(known.created, known.job));
            }
            None if self.records.len() == JOBS_MAX => {
                if self.by_age.first().is_some_and(|oldest| key < *oldest) {
                    return;
                }
                if let Some((_, oldest)) = self.by_age.pop_first() {
                    self.records.remove(&oldest);
                }
            }
            None => {}
        }
        self.by_age.insert(key);
        self.records.insert(record.job, record);
        self.revision += 1;
    }

    pub(super) fn asked(
        &mut self,
        ticket: Ticket,
        target: String,
        payload: String,
        language: Language,
        at: Moment,
    ) {
        if self.sent.len() == SENT_MAX {
            self.sent.pop_front();
        }
        let group = target.starts_with(GROUP_MARK);
        let request = group.then(|| GroupRequest::from_json(payload.as_bytes()).ok());
        let max_skew_us = request.flatten().and_then(|request| request.max_skew_us);
        let fits = payload.len() <= SENT_BYTES_MAX;
        self.sent.push_back(Sent {
            ticket,
            target,
            payload: if fits { payload } else { String::new() },
            language,
            at,
            answer: None,
            max_skew_us,
        });
    }

    pub(super) fn answer(&mut self, ticket: Ticket, answer: Answer) {
        let mut sent = self.sent.iter_mut();
        if let Some(sent) = sent.find(|sent| sent.ticket == ticket) {
            sent.answer = Some(answer);
        }
    }

    /// Returns a record.
    pub fn get(&self, job: &JobId) -> Option<&JobRecord> {
        self.records.get(job)
    }

    /// Returns the records, newest first.
    pub fn newest_first(&self) -> impl Iterator<Item = &JobRecord> {
        let ids = self.by_age.iter().rev();
        ids.filter_map(|(_, job)| self.records.get(job))
    }

    /// Returns how many records there are.
    pub fn len(&self) -> usize {
        self.records.len()
    }

    /// Returns whether there is none.
    pub fn is_empty(&self) -> bool {
        self.records.is_empty()
    }

    /// Returns a number that grows with each change of a record.
    pub fn revision(&self) -> u64 {
        self.revision
    }

    /// Returns what this window sent, the latest first.
    pub fn sent(&self) -> impl Iterator<Item = &Sent> {
        self.sent.iter().rev()
    }

    /// Returns the largest skew that a synchronized job was promised, µs: what it asked for, if
    /// this window sent it.
    pub(super) fn promised_skew_us(&self, job: &JobId) -> f64 {
        let sent = self.sent().find(|sent| sent.is(job));
        let asked = sent.and_then(|sent| sent.max_skew_us);
        asked.unwrap_or(SKEW_PROMISED_US)
    }

    /// Returns what this window sent as this job, if its text was kept.
    pub fn sent_as(&self, job: &JobId) -> Option<&Sent> {
        self.sent()
            .find(|sent| sent.is(job) && !sent.payload.is_empty())
    }
}
