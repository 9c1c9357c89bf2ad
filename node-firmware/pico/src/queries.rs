//! Questions that wait for answers, in both directions.
//!
//! Owns one bounded table for what we asked and one for what we are asked. Promises that every
//! question of ours gets exactly one final, be it by timeout or by the end of the connection, and
//! that what we are asked is completed towards the peer even if the application forgets.

use alloc::{string::String, vec::Vec};

use crate::{
    event::{Congestion, Consolidation, Priority, QueryableId, Sample, Timestamp},
    key::Key,
    limits,
};

/// A question of ours.
#[derive(Debug)]
pub(crate) struct QueryOut {
    pub(crate) id: u32,
    pub(crate) deadline_us: u64,
    pub(crate) consolidation: Consolidation,
    /// With [`Consolidation::Latest`]: the newest reply for each key.
    held: Vec<Sample>,
    /// With [`Consolidation::Monotonic`]: the newest time for each key.
    passed: Vec<(Key, Option<Timestamp>)>,
}

impl QueryOut {
    pub(crate) fn new(id: u32, deadline_us: u64, asked: Consolidation, parameters: &str) -> Self {
        let consolidation = match asked {
            Consolidation::Auto if parameters.contains("_time") => Consolidation::None,
            Consolidation::Auto => Consolidation::Latest,
            other => other,
        };
        Self {
            id,
            deadline_us,
            consolidation,
            held: Vec::new(),
            passed: Vec::new(),
        }
    }

    /// Takes a reply and gives what is to be passed on now.
    pub(crate) fn consolidate(&mut self, sample: Sample) -> Option<Sample> {
        match self.consolidation {
            Consolidation::Auto | Consolidation::None => Some(sample),
            Consolidation::Monotonic => {
                let has_room = self.passed.len() < limits::REPLIES_HELD_MAX;
                match self.passed.iter_mut().find(|(key, _)| *key == sample.key) {
                    Some((_, time)) if sample.timestamp < *time => return None,
                    Some((_, time)) => *time = sample.timestamp,
                    None if has_room => {
                        self.passed.push((sample.key.clone(), sample.timestamp));
                    }
                    None => {}
                }
                Some(sample)
            }
            Consolidation::Latest => {
                let has_room = self.held.len() < limits::REPLIES_HELD_MAX;
                match self.held.iter_mut().find(|held| held.key == sample.key) {
                    Some(held) if sample.timestamp < held.timestamp => None,
                    Some(held) => {
                        *held = sample;
                        None
                    }
                    None if has_room => {
                        self.held.push(sample);
                        None
                    }
                    None => Some(sample),
                }
            }
        }
    }

    /// What was kept back, once no more replies come.
    pub(crate) fn into_held(self) -> Vec<Sample> {
        self.held
    }
}

/// A question of somebody.
#[derive(Debug)]
pub(crate) struct QueryIn {
    pub(crate) serial: u32,
    /// The peer's number.
    pub(crate) id: u32,
    pub(crate) key: String,
    /// Queryables that have not said their final.
    pub(crate) waiting: Vec<QueryableId>,
    pub(crate) deadline_us: u64,
    /// Answers travel as the question did, so that the final does not overtake a reply.
    pub(crate) priority: Priority,
    pub(crate) congestion: Congestion,
    pub(crate) express: bool,
}

#[derive(Debug, Default)]
pub(crate) struct Queries {
    pub(crate) outbound: Vec<QueryOut>,
    pub(crate) inbound: Vec<QueryIn>,
    last_id: u32,
    last_serial: u32,
}

impl Queries {
    /// A number for a question of ours, within what was agreed.
    pub(crate) fn free_id(&mut self, mask: u32) -> u32 {
        // Fewer than QUERIES_OUT_MAX of at least 127 are taken.
        loop {
            self.last_id = self.last_id.wrapping_add(1) & mask;
            if self.outbound.iter().all(|query| query.id != self.last_id) {
                return self.last_id;
            }
        }
    }

    pub(crate) fn next_serial(&mut self) -> u32 {
        self.last_serial = self.last_serial.wrapping_add(1);
        self.last_serial
    }

    pub(crate) fn outbound(&mut self, id: u32) -> Option<&mut QueryOut> {
        self.outbound.iter_mut().find(|query| query.id == id)
    }

    pub(crate) fn take_outbound(&mut self, id: u32) -> Option<QueryOut> {
        let index = self.outbound.iter().position(|query| query.id == id)?;
        Some(self.outbound.remove(index))
    }

    pub(crate) fn inbound(&mut self, serial: u32) -> Option<&mut QueryIn> {
        self.inbound.iter_mut().find(|query| query.serial == serial)
    }

    /// When the first of all questions runs out.
    pub(crate) fn deadline_us(&self) -> Option<u64> {
        let outbound = self.outbound.iter().map(|query| query.deadline_us);
        let inbound = self.inbound.iter().map(|query| query.deadline_us);
        outbound.chain(inbound).min()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::event::{Encoding, SampleKind};
    use alloc::string::ToString;

    fn sample(key: &str, time: u64) -> Sample {
        let id = zenoh_protocol::core::TimestampId::try_from([1u8].as_slice()).unwrap();
        Sample {
            key: key.into(),
            payload: Vec::new(),
            kind: SampleKind::Put,
            encoding: Encoding::default(),
            attachment: None,
            timestamp: Some(Timestamp::new(zenoh_protocol::core::NTP64(time), id)),
            priority: Priority::Data,
            congestion: Congestion::Drop,
            express: false,
        }
    }

    #[test]
    fn the_latest_reply_for_each_key_is_kept_until_the_end() {
        let mut query = QueryOut::new(1, 0, Consolidation::Auto, "");
        for (key, time) in [("a", 2), ("b", 1), ("a", 1), ("a", 3)] {
            assert_eq!(query.consolidate(sample(key, time)), None);
        }
        assert_eq!(query.into_held(), [sample("a", 3), sample("b", 1)]);
    }

    #[test]
    fn monotonic_replies_pass_at_once_and_older_ones_never() {
        let mut query = QueryOut::new(1, 0, Consolidation::Monotonic, "");
        assert!(query.consolidate(sample("a", 2)).is_some());
        assert!(query.consolidate(sample("a", 1)).is_none());
        assert!(query.consolidate(sample("a", 3)).is_some());
        assert!(query.consolidate(sample("b", 1)).is_some());
    }

    #[test]
    fn a_question_about_a_time_range_gets_every_reply() {
        let mut query = QueryOut::new(1, 0, Consolidation::Auto, "_time=[..]");
        for time in [2, 1, 1] {
            assert!(query.consolidate(sample("a", time)).is_some());
        }
    }

    #[test]
    fn more_keys_than_can_be_kept_pass_on_at_once() {
        let mut query = QueryOut::new(1, 0, Consolidation::Latest, "");
        for index in 0..limits::REPLIES_HELD_MAX {
            assert!(query.consolidate(sample(&index.to_string(), 1)).is_none());
        }
        assert!(query.consolidate(sample("more", 1)).is_some());
    }
}
