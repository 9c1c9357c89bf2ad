//! What a node did over the last hours, stretch by stretch, for its lane of the timeline.

use super::{
    limits::{FAULTS_MAX, STRETCHES_MAX},
    ring::Ring,
};
use crate::message::Moment;
use keys::{JobId, record::NodeWord};

/// What a node does, as far as this window knows.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Doing {
    /// There was no link: nobody knows.
    Unknown,
    /// There, and silent for longer than [`STALE_AFTER_S`](super::limits::STALE_AFTER_S).
    Silent,
    /// This window saw it go.
    Lost,
    /// Its own word.
    Word(NodeWord),
}

/// It did the same from this moment until the next stretch begins.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Stretch {
    /// When it began.
    pub since: Moment,
    /// What.
    pub doing: Doing,
    /// For which job.
    pub job: Option<JobId>,
}

/// See the module.
#[derive(Clone, Debug, Default)]
pub struct History {
    stretches: Ring<Stretch, STRETCHES_MAX>,
    faults: Ring<(Moment, u16), FAULTS_MAX>,
}

impl History {
    /// Takes what it does now.
    pub(super) fn note(&mut self, since: Moment, doing: Doing, job: Option<JobId>) {
        // Of a silence nobody knows which job it belongs to, and a job's end is told with the word.
        let same = |last: &Stretch| last.doing == doing && last.job == job;
        if !self.stretches.last().is_some_and(same) {
            self.stretches.push(Stretch { since, doing, job });
        }
    }

    /// Takes a fault that was not there before.
    pub(super) fn fault(&mut self, at: Moment, code: u16) {
        self.faults.push((at, code));
    }

    /// Returns the stretches, oldest first; each ends where the next begins, the last one lasts.
    pub fn stretches(&self) -> impl DoubleEndedIterator<Item = &Stretch> + ExactSizeIterator {
        self.stretches.iter()
    }

    /// Returns moment and number of each fault, oldest first.
    pub fn faults(&self) -> impl DoubleEndedIterator<Item = &(Moment, u16)> + ExactSizeIterator {
        self.faults.iter()
    }

    /// Returns what it did at a moment; `None` before the first stretch.
    pub fn at(&self, at: Moment) -> Option<&Stretch> {
        self.stretches().rev().find(|stretch| stretch.since <= at)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{
        message::{LinkEvent, Message},
        model::{Model, tests::*},
    };
    use keys::{Fault, LocalMicros, NodeState, status::FaultCode};

    fn doings(model: &Model, name: &str) -> Vec<(u64, Doing)> {
        let node = model.node(&id(name)).expect("known");
        let stretches = node.history().stretches();
        stretches
            .map(|stretch| ((stretch.since.0 - at(0).0) / 1_000, stretch.doing))
            .collect()
    }

    #[test]
    fn a_lane_has_a_stretch_for_each_change_and_none_for_what_stays() {
        use {Doing::*, NodeWord::*};
        let mut model = Model::default();
        let to = "here".to_owned();
        let up = Message::Link(LinkEvent::Connected { to });
        model.apply(at(0), up.clone());
        alive(&mut model, 0, "left", true);
        for ms in [100, 200, 300] {
            says(&mut model, ms, "left", NodeState::Running);
        }
        says(&mut model, 400, "left", NodeState::Stopped);
        alive(&mut model, 500, "left", false);
        alive(&mut model, 600, "left", true);
        says(&mut model, 700, "left", NodeState::Idle);
        model.tick(at(4_000));
        let why = "cut".to_owned();
        model.apply(at(5_000), Message::Link(LinkEvent::Down { why }));
        model.apply(at(6_000), up);
        says(&mut model, 6_100, "left", NodeState::Idle);
        let expected = [
            (0, Word(Idle)),
            (100, Word(Running)),
            (400, Word(NodeWord::Stopped)),
            (500, Lost),
            // Its last word, until it says another one.
            (600, Word(NodeWord::Stopped)),
            (700, Word(Idle)),
            (4_000, Silent),
            (5_000, Unknown),
            (6_100, Word(Idle)),
        ];
        assert_eq!(doings(&model, "left"), expected);
        let history = model.node(&id("left")).expect("known").history();
        assert_eq!(history.at(at(550)).map(|it| it.doing), Some(Lost));
        assert!(history.at(Moment(at(0).0 - 1)).is_none());
    }

    #[test]
    fn a_fault_is_marked_once() {
        let mut model = Model::default();
        let mut broken = status(NodeState::Fault);
        for (ms, boot_us) in [(100, 7), (200, 7), (300, 9)] {
            broken.faults.clear();
            let (code, at_node) = (FaultCode::PLAN_LATE, LocalMicros(boot_us));
            let fault = Fault { code, at: at_node };
            broken.faults.push(fault).expect("room");
            let (node, status) = (id("left"), broken.clone());
            model.apply(at(ms), Message::Status { node, status });
        }
        let node = model.node(&id("left")).expect("known");
        let faults: Vec<_> = node.history().faults().copied().collect();
        assert_eq!(faults, [(at(100), 204), (at(300), 204)]);
    }
}
