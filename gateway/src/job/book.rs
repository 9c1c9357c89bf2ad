//! Every job that is known, by name and in the order of history. Owns the records; each change
//! leaves as one write and, behind it, one message.
//!
//! Promises: what is published was persisted before; a job that is not final has its request in
//! the store, and the request goes only after the final record is written; final jobs are kept as
//! [`Retention`] says, the ones that ended first go first.
//!
//! Absent on purpose: which job runs where. That is the node's view.

use super::{Change, Job, JobEntry, TOLD_MAX, Told};
use crate::fleet::event::{Effect, Lane, Table, Write};
use keys::{
    FleetMicros, JobId, Keys, NodeId,
    record::{JobState, to_json},
};
use std::collections::{BTreeMap, BTreeSet, HashMap};

/// Final jobs that are kept whatever their age, so that a clock which was wrong at a start cannot
/// empty the history.
pub const KEPT_JOBS_MIN: usize = 1_000;

/// Which share of the kept jobs may be refused ones before these go first: a client that asks for
/// nonsense must not push out what was done.
const REJECTED_SHARE: usize = 10;

/// How long final jobs are kept.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Retention {
    /// Most of them.
    pub jobs: usize,
    /// Longest time since a job's end, µs; the newest [`KEPT_JOBS_MIN`] may be older.
    pub age_us: u64,
}

/// The jobs.
#[derive(Debug)]
pub struct Book {
    keys: Keys,
    retention: Retention,
    jobs: HashMap<JobId, Job>,
    /// By sequence: the order in which they were accepted.
    history: BTreeMap<u64, JobId>,
    /// Final ones by the time of their end.
    finals: BTreeSet<(FleetMicros, u64)>,
    /// Those of them that were refused.
    rejected: BTreeSet<(FleetMicros, u64)>,
    next_sequence: u64,
    held_commands: usize,
    /// Synchronized jobs of which a part has changed since somebody looked.
    touched: BTreeSet<JobId>,
}

impl Book {
    /// Begins an empty book.
    pub fn new(keys: Keys, retention: Retention) -> Self {
        Self {
            keys,
            retention,
            jobs: HashMap::new(),
            history: BTreeMap::new(),
            finals: BTreeSet::new(),
            rejected: BTreeSet::new(),
            next_sequence: 1,
            held_commands: 0,
            touched: BTreeSet::new(),
        }
    }

    /// Returns the job of this name.
    pub fn get(&self, id: &JobId) -> Option<&Job> {
        self.jobs.get(id)
    }

    /// Returns what a node has to do for a job: its part of a synchronized one, else the job.
    pub fn part(&self, id: &JobId, node: NodeId) -> Option<&Job> {
        let job = self.jobs.get(id)?;
        if job.is_group() {
            job.parts.get(&node)
        } else {
            Some(job)
        }
    }

    /// Returns every job, newest first.
    pub fn newest_first(&self) -> impl Iterator<Item = &Job> {
        self.history
            .values()
            .rev()
            .filter_map(|id| self.jobs.get(id))
    }

    /// Returns how many commands all jobs that are not final hold together; a script counts as those that
    /// take as much memory.
    pub fn held_commands(&self) -> usize {
        self.held_commands
    }

    /// Returns the number for the next job, once.
    pub fn take_sequence(&mut self) -> u64 {
        let sequence = self.next_sequence;
        self.next_sequence += 1;
        sequence
    }

    /// Takes a job that was read from the store: nothing is written or published.
    pub fn restore(&mut self, job: Job) {
        self.next_sequence = self.next_sequence.max(job.entry.sequence + 1);
        self.index(job);
    }

    /// Takes a new job, instead of a rejected one of the same name if there is one. `request` is
    /// what a job that is not final needs to be resumed.
    pub fn insert(&mut self, job: Job, request: Option<Vec<u8>>, effects: &mut Vec<Effect>) {
        let (id, now) = (job.id(), job.entry.record.updated);
        if let Some(old) = self.jobs.remove(&id) {
            assert!(old.state().is_final(), "job {id} exists and is not final");
            self.history.remove(&old.entry.sequence);
            let place = (old.entry.record.updated, old.entry.sequence);
            self.finals.remove(&place);
            self.rejected.remove(&place);
        }
        // The request first: a request without a job is dropped at the next start, a job without
        // its request could not be resumed.
        if let Some(value) = request {
            effects.push(Effect::Persist(Write::Put {
                table: Table::Requests,
                key: id.to_string(),
                value,
            }));
        }
        self.index(job);
        self.tell(&id, effects);
        self.prune(now, effects);
    }

    /// Changes what a node does for a job, writes the record that follows and tells it.
    ///
    /// # Panics
    /// There is no such job, or the change is not legal.
    pub fn change(
        &mut self,
        id: &JobId,
        node: NodeId,
        change: Change,
        now: FleetMicros,
        effects: &mut Vec<Effect>,
    ) {
        let part = self.part_mut(id, node);
        let held_before = part.held();
        part.change(change, now);
        let held = part.held();
        self.held_commands -= held_before - held;
        if self.jobs[id].is_group() {
            self.touched.insert(*id);
            self.gather(id, now, effects);
        } else {
            self.tell_change(id, now, effects);
        }
    }

    /// Makes the record of a synchronized job from its parts anew, writes it and tells it.
    ///
    /// # Panics
    /// There is no such job.
    pub fn gather(&mut self, id: &JobId, now: FleetMicros, effects: &mut Vec<Effect>) {
        let job = self.jobs.get_mut(id).expect("the caller has found the job");
        job.gather(now);
        self.tell_change(id, now, effects);
    }

    /// Notes how far a part is without telling it: the next version of the record does.
    pub fn note_done(&mut self, id: &JobId, node: NodeId, done: u64) {
        let job = self.jobs.get_mut(id).filter(|job| job.is_group());
        if let Some(part) = job.and_then(|job| job.parts.get_mut(&node)) {
            let progress = &mut part.entry.record.progress;
            progress.done = progress.done.max(done);
        }
    }

    /// Notes what a node has told of a job. It is written with the next version of the record; at once
    /// if there will be none.
    pub fn note_told(&mut self, id: &JobId, told: Told, effects: &mut Vec<Effect>) {
        let Some(job) = self.jobs.get_mut(id) else {
            return;
        };
        if job.node() != Some(told.node) && !job.parts.contains_key(&told.node) {
            return;
        }
        let list = &mut job.entry.told;
        if list.len() >= TOLD_MAX {
            list.pop();
        }
        list.push(told);
        if job.state().is_final() {
            let value = to_json(&job.entry);
            effects.push(Effect::Persist(put(id, value)));
        }
    }

    /// Says that something about a synchronized job's nodes is news.
    pub fn touch(&mut self, id: &JobId) {
        self.touched.insert(*id);
    }

    /// Returns how many synchronized jobs have something new about them.
    pub fn touched_count(&self) -> usize {
        self.touched.len()
    }

    /// Returns a synchronized job of which something is news, once.
    pub fn take_touched(&mut self) -> Option<JobId> {
        self.touched.pop_first()
    }

    fn tell_change(&mut self, id: &JobId, now: FleetMicros, effects: &mut Vec<Effect>) {
        let job = self.jobs.get_mut(id).expect("the caller has found the job");
        let is_final = job.state().is_final();
        if is_final {
            let place = (job.entry.record.updated, job.entry.sequence);
            self.finals.insert(place);
        }
        job.progress_told_at = now;
        self.tell(id, effects);
        if is_final {
            effects.push(Effect::Persist(Write::Remove {
                table: Table::Requests,
                key: id.to_string(),
            }));
            self.prune(now, effects);
        }
    }

    /// Edits what clients do not see of a node's part, and writes it. The record itself must stay
    /// as it is.
    ///
    /// # Panics
    /// There is no such job.
    pub fn edit(
        &mut self,
        id: &JobId,
        node: NodeId,
        edit: impl FnOnce(&mut Job),
        effects: &mut Vec<Effect>,
    ) {
        self.prepare(id, node, edit);
        self.edit_whole(id, Job::note_parts, effects);
    }

    /// Edits what clients do not see of a whole job, and writes it.
    ///
    /// # Panics
    /// There is no such job.
    pub fn edit_whole(
        &mut self,
        id: &JobId,
        edit: impl FnOnce(&mut Job),
        effects: &mut Vec<Effect>,
    ) {
        let job = self.jobs.get_mut(id).expect("the caller has found the job");
        edit(job);
        let value = to_json(&job.entry);
        effects.push(Effect::Persist(put(id, value)));
    }

    /// Edits what clients do not see; a [`Book::change`] follows and writes both at once.
    ///
    /// # Panics
    /// There is no such job.
    pub fn prepare(&mut self, id: &JobId, node: NodeId, edit: impl FnOnce(&mut Job)) {
        edit(self.part_mut(id, node));
    }

    /// Edits a whole job; a [`Book::gather`] follows and writes it.
    ///
    /// # Panics
    /// There is no such job.
    pub fn prepare_whole(&mut self, id: &JobId, edit: impl FnOnce(&mut Job)) {
        edit(self.jobs.get_mut(id).expect("the caller has found the job"));
    }

    fn part_mut(&mut self, id: &JobId, node: NodeId) -> &mut Job {
        let job = self.jobs.get_mut(id).expect("the caller has found the job");
        if job.is_group() {
            let part = job.parts.get_mut(&node);
            part.expect("a node has only jobs with a part for it")
        } else {
            job
        }
    }

    /// Tells every record that is not final and the `final_count` ones that ended last again, as
    /// they are.
    pub fn tell_again(&self, final_count: usize, effects: &mut Vec<Effect>) {
        let ended = self.finals.iter().rev().take(final_count);
        let ended: BTreeSet<u64> = ended.map(|(_, sequence)| *sequence).collect();
        for job in self.history.values().filter_map(|id| self.jobs.get(id)) {
            if !job.state().is_final() || ended.contains(&job.entry.sequence) {
                effects.push(self.message(&job.entry));
            }
        }
    }

    /// Removes the final jobs that ended first until no more are left than are kept.
    pub fn prune(&mut self, now: FleetMicros, effects: &mut Vec<Effect>) {
        while let Some(place) = self.next_to_go(now) {
            let (_, sequence) = place;
            self.finals.remove(&place);
            self.rejected.remove(&place);
            let Some(id) = self.history.remove(&sequence) else {
                continue;
            };
            self.jobs.remove(&id);
            effects.push(Effect::Persist(Write::Remove {
                table: Table::Jobs,
                key: id.to_string(),
            }));
        }
    }

    fn next_to_go(&self, now: FleetMicros) -> Option<(FleetMicros, u64)> {
        let Retention { jobs, age_us } = self.retention;
        let oldest = *self.finals.first()?;
        let count = self.finals.len();
        if count > jobs {
            let refused = self.rejected.first();
            let many = self.rejected.len() > jobs / REJECTED_SHARE;
            return refused.filter(|_| many).or(Some(&oldest)).copied();
        }
        let is_old = count > KEPT_JOBS_MIN && now.since_us(oldest.0) > age_us;
        is_old.then_some(oldest)
    }

    fn index(&mut self, job: Job) {
        let (id, sequence) = (job.id(), job.entry.sequence);
        if job.state().is_final() {
            let place = (job.entry.record.updated, sequence);
            self.finals.insert(place);
            if job.state() == JobState::Rejected {
                self.rejected.insert(place);
            }
        }
        let parts = job.parts.values().map(Job::held);
        self.held_commands += job.held() + parts.sum::<usize>();
        self.history.insert(sequence, id);
        self.jobs.insert(id, job);
    }

    fn tell(&self, id: &JobId, effects: &mut Vec<Effect>) {
        let entry = &self.jobs[id].entry;
        effects.push(Effect::Persist(put(id, to_json(entry))));
        effects.push(self.message(entry));
    }

    fn message(&self, entry: &JobEntry) -> Effect {
        Effect::Publish {
            key: self.keys.job(&entry.record.job).as_str().to_owned(),
            payload: to_json(&entry.record),
            json: true,
            lane: Lane::Record,
        }
    }
}

fn put(id: &JobId, value: Vec<u8>) -> Write {
    Write::Put {
        table: Table::Jobs,
        key: id.to_string(),
        value,
    }
}
