//! How far apart the parts of a synchronized job began, once their nodes have told.

use crate::{
    fleet::{Fleet, event::Effect, start::Start},
    job::Job,
};
use keys::{FleetMicros, JobId, record::JobState};

/// How long the record of a job whose parts have all succeeded waits for the measurement of its
/// start, µs: nodes tell it five times, 200 ms apart.
const MEASURING_US: u64 = 1_200_000;

impl Fleet {
    /// Takes the nodes' measurement into the record, and lets a record go that waits for it.
    pub(super) fn measure_start(&mut self, id: &JobId, effects: &mut Vec<Effect>) {
        let Some(job) = self.book.get(id).filter(|job| !job.state().is_final()) else {
            return;
        };
        let done = |part: &Job| part.state() == JobState::Succeeded;
        let all_done = job.parts.values().all(done);
        let start = self.groups.get(id).and_then(|group| group.start.as_ref());
        let measured = start.and_then(Start::measured);
        if job.measuring
            && job.has_started()
            && let Some(measured) = measured
        {
            self.book.prepare_whole(id, |job| {
                job.measuring = false;
                job.entry.record.start = Some(Box::new(measured));
            });
            self.book.gather(id, self.now, effects);
        } else if all_done
            && (!job.measuring || job.entry.ending.is_some() || self.now >= measuring_until(job))
        {
            self.book.prepare_whole(id, |job| job.measuring = false);
            self.book.gather(id, self.now, effects);
        }
    }
}

/// Returns until when that is waited for.
pub(super) fn measuring_until(job: &Job) -> FleetMicros {
    let ends = job.parts.values().map(|part| part.entry.record.updated);
    ends.max().unwrap_or_default().plus_us(MEASURING_US)
}
