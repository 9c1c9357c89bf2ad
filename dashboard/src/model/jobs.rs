//! The jobs that the gateway tells of, and those that this window sent.

use super::limits::{JOBS_MAX, SENT_BYTES_MAX, SENT_MAX};
use crate::{
    message::{Answer, Moment},
    request::Ticket,
};
use keys::{FleetMicros, JobId, record::JobRecord};
use std::collections::{BTreeMap, BTreeSet, VecDeque};

/// A job that this window sent.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Sent {
    /// Identifies the request.
    pub ticket: Ticket,
    /// For whom, as typed.
    pub target: String,
    /// The text; empty if it was longer than [`SENT_BYTES_MAX`].
    pub payload: String,
    /// When.
    pub at: Moment,
    /// What the gateway said; `None` until it does.
    pub answer: Option<Answer>,
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

    pub(super) fn asked(&mut self, ticket: Ticket, target: String, payload: String, at: Moment) {
        if self.sent.len() == SENT_MAX {
            self.sent.pop_front();
        }
        let fits = payload.len() <= SENT_BYTES_MAX;
        self.sent.push_back(Sent {
            ticket,
            target,
            payload: if fits { payload } else { String::new() },
            at,
            answer: None,
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

    /// Returns what this window sent as this job, if its text was kept.
    pub fn sent_as(&self, job: &JobId) -> Option<&Sent> {
        self.sent().find(|sent| {
            let jobs = sent.answer.as_ref().map(Answer::jobs).unwrap_or_default();
            jobs.contains(job) && !sent.payload.is_empty()
        })
    }
}
