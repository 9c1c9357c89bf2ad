//! The jobs that the gateway tells of, and those that this window sent.

use super::limits::{CANCELS_MAX, JOBS_MAX, SENT_BYTES_MAX, SENT_MAX, SKEW_PROMISED_US};
use crate::{
    message::{Answer, Moment},
    request::{Language, Ticket},
};
use keys::{
    FleetMicros, JobId,
    job::GroupRequest,
    record::{JobRecord, StartPlan},
};
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

/// What this window asked to end.
#[derive(Clone, Debug, PartialEq)]
pub struct Cancel {
    /// Identifies the request.
    pub ticket: Ticket,
    /// Which job.
    pub job: JobId,
    /// When.
    pub at: Moment,
    /// What the gateway said; `None` until it does.
    pub answer: Option<Answer>,
}

/// See the module.
#[derive(Debug, Default)]
pub struct Jobs {
    records: BTreeMap<JobId, JobRecord>,
    // By this window's clock; of those alone whose start is fixed and not over.
    starts: BTreeMap<JobId, Moment>,
    /// Largest skews that synchronized jobs were promised, µs.
    promised: BTreeMap<JobId, f64>,
    cancels: VecDeque<Cancel>,
    by_age: BTreeSet<(FleetMicros, JobId)>,
    sent: VecDeque<Sent>,
    revision: u64,
}

impl Jobs {
    pub(super) fn plan(&mut self, at: Moment, plan: &StartPlan) {
        // One of a job whose record nobody keeps would stay for ever.
        if self.promised.len() >= JOBS_MAX {
            self.promised
                .retain(|job, _| self.records.contains_key(job));
            self.starts.retain(|job, _| self.records.contains_key(job));
        }
        self.promised.insert(plan.job, plan.max_skew_us);
        let known = self.records.get(&plan.job);
        if known.is_some_and(|record| record.start.is_some() || record.state.is_final()) {
            return;
        }
        // The gateway's clock may be another one: the plan was true when it was written, and that is
        // now.
        let left_us = plan.starts_at.0.saturating_sub(plan.told.0);
        self.starts.insert(plan.job, at.plus_us(left_us));
        self.revision += 1;
    }

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
                    self.starts.remove(&oldest);
                    self.promised.remove(&oldest);
                }
            }
            None => {}
        }
        if record.start.is_some() || record.state.is_final() {
            self.starts.remove(&record.job);
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

    pub(super) fn cancel_asked(&mut self, at: Moment, ticket: Ticket, job: JobId) {
        self.cancels.retain(|cancel| cancel.job != job);
        if self.cancels.len() == CANCELS_MAX {
            self.cancels.pop_front();
        }
        let answer = None;
        self.cancels.push_back(Cancel {
            ticket,
            job,
            at,
            answer,
        });
    }

    pub(super) fn answer(&mut self, ticket: Ticket, answer: Answer) {
        let mut cancels = self.cancels.iter_mut();
        if let Some(cancel) = cancels.find(|cancel| cancel.ticket == ticket) {
            cancel.answer = Some(answer);
            return;
        }
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

    /// Returns what this window asked of a job's end.
    pub fn cancel(&self, job: &JobId) -> Option<&Cancel> {
        self.cancels.iter().find(|cancel| cancel.job == *job)
    }

    /// Returns when a synchronized job starts, while that is fixed and not over.
    pub fn starts(&self, job: &JobId) -> Option<Moment> {
        self.starts.get(job).copied()
    }

    /// Returns whether a start is still to come.
    pub fn is_counting_down(&self, now: Moment) -> bool {
        self.starts.values().any(|starts| *starts > now)
    }

    /// Returns the largest skew that a synchronized job was promised, µs: what the gateway says,
    /// else what this window asked for. `None` if neither is known: then nobody can say whether it
    /// was kept.
    pub(super) fn promised_skew_us(&self, record: &JobRecord) -> Option<f64> {
        let told = self.promised.get(&record.job).copied();
        let sent = || self.sent().find(|sent| sent.is(&record.job));
        let asked = || Some(sent()?.max_skew_us.unwrap_or(SKEW_PROMISED_US));
        told.or_else(asked)
    }

    /// Returns what this window sent as this job, if its text was kept.
    pub fn sent_as(&self, job: &JobId) -> Option<&Sent> {
        self.sent()
            .find(|sent| sent.is(job) && !sent.payload.is_empty())
    }
}

#[cfg(test)]
mod tests {
    use crate::{
        message::{Answer, Message},
        model::{Model, tests::*},
        request::Ticket,
    };
    use keys::{
        FleetMicros, JobId,
        record::{JobState, StartPlan},
    };

    #[test]
    fn a_start_is_counted_down_by_this_computers_own_clock() {
        let mut model = Model::default();
        let id = JobId::new("cut").expect("a name");
        // The gateway's clock is an hour ahead.
        let written_us = at(3_600_000).0;
        let mut record = job("cut", written_us, 1, JobState::Sent);
        model.apply(at(1_000), Message::Job(Box::new(record.clone())));
        let plan = StartPlan {
            job: id,
            told: FleetMicros(written_us),
            starts_at: FleetMicros(written_us + 250_000),
            max_skew_us: 1_000.0,
        };
        model.apply(at(1_000), Message::StartPlan(plan));
        assert_eq!(model.jobs().starts(&id), Some(at(1_250)));
        assert!(model.jobs().is_counting_down(at(1_249)));
        assert!(!model.jobs().is_counting_down(at(1_250)));
        // Told with progress: the start itself does not move.
        (record.version, record.updated) = (2, FleetMicros(written_us + 100_000));
        model.apply(at(1_120), Message::Job(Box::new(record.clone())));
        assert_eq!(model.jobs().starts(&id), Some(at(1_250)));
        (record.version, record.state) = (3, JobState::Succeeded);
        model.apply(at(1_300), Message::Job(Box::new(record)));
        assert_eq!(model.jobs().starts(&id), None);
    }

    #[test]
    fn what_became_of_a_cancel_is_known_until_it_is_asked_again() {
        let mut model = Model::default();
        let id = JobId::new("cut").expect("a name");
        let ask = |model: &mut Model, ms, number| {
            let ticket = Ticket(number);
            model.apply(at(ms), Message::CancelAsked { ticket, job: id });
        };
        ask(&mut model, 0, 1);
        let told = |model: &Model| model.jobs().cancel(&id).expect("asked").answer.clone();
        assert_eq!(told(&model), None);
        let (ticket, answer) = (Ticket(1), Answer::Failed("nobody".to_owned()));
        let failed = Message::Answer { ticket, answer };
        model.apply(at(5), failed);
        assert_eq!(told(&model), Some(Answer::Failed("nobody".to_owned())));
        ask(&mut model, 9, 2);
        assert_eq!(told(&model), None);
    }
}
