//! What needed somebody: raised once for each cause, cleared when the cause is over, raised anew
//! when it returns, and kept until somebody has seen it.
//!
//! ```text
//!   cause begins ─▶ open, new ──acknowledge──▶ open, seen
//!                      │ cause ends                │ cause ends
//!                      ▼                           ▼
//!                   over, new ──acknowledge──▶ over, seen ─▶ the first to be forgotten
//! ```

use super::{
    limits::{ALARMS_MAX, CLOCK_GRACE_S, SKEW_NEWS_S},
    node::{Node, Presence},
};
use crate::{message::Moment, text};
use keys::{
    JobId, NodeId,
    record::{JobRecord, NodeWord},
};
use std::collections::{BTreeMap, VecDeque};

/// Why somebody should look. Of one node each is open at most once.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Cause {
    /// It reports this fault; 0 if it gives no number.
    Fault(u16),
    /// It was there and is gone.
    Lost,
    /// Its stop latch is set.
    Stopped,
    /// It is there and silent for longer than [`super::limits::STALE_AFTER_S`].
    Silent,
    /// It is there and its clock is not known, for longer than [`CLOCK_GRACE_S`].
    Clock,
    /// This synchronized job started further apart than promised. Over at once.
    Skew(JobId),
}

/// One of them.
#[derive(Clone, Debug, PartialEq)]
pub struct Alarm {
    /// Counts up; later alarms have larger ones.
    pub id: u64,
    /// Why.
    pub cause: Cause,
    /// The node; `None` if it is about several.
    pub node: Option<NodeId>,
    /// When it was raised.
    pub raised: Moment,
    /// When the cause was over.
    pub over: Option<Moment>,
    /// When somebody acknowledged it.
    pub seen: Option<Moment>,
    /// The facts, for a person.
    pub text: String,
}

/// See the module.
#[derive(Debug, Default)]
pub struct Alarms {
    next: u64,
    list: BTreeMap<u64, Alarm>,
    open: BTreeMap<(NodeId, Cause), u64>,
    no_clock_since: BTreeMap<NodeId, Moment>,
    skews_told: VecDeque<JobId>,
    unseen: usize,
    forgotten_unseen: u64,
}

impl Alarms {
    /// Looks at a node while there is a link: without one nothing is known, and nothing changes.
    pub(super) fn check(&mut self, at: Moment, node: &Node) {
        let id = node.id();
        let there = node.is_there();
        let clock = self.has_no_clock(at, node);
        let wanted = [
            (there && node.word() == NodeWord::Fault)
                .then(|| Cause::Fault(node.last_fault_code().unwrap_or(0))),
            (!there && node.lost_at().is_some()).then_some(Cause::Lost),
            (there && node.word() == NodeWord::Stopped).then_some(Cause::Stopped),
            (node.presence(at) == Presence::Stale).then_some(Cause::Silent),
            clock.then_some(Cause::Clock),
        ];
        // Of a node that is gone nobody knows whether its latch or fault is still there.
        let unknown = |cause: Cause| !there && matches!(cause, Cause::Fault(_) | Cause::Stopped);
        let of_node = self.open.range((id, Cause::Fault(0))..=(id, Cause::Clock));
        let over: Vec<Cause> = of_node
            .map(|((_, cause), _)| *cause)
            .filter(|cause| !wanted.contains(&Some(*cause)) && !unknown(*cause))
            .collect();
        for cause in over {
            let open = self.open.remove(&(id, cause));
            if let Some(alarm) = open.and_then(|open| self.list.get_mut(&open)) {
                alarm.over = Some(at);
            }
        }
        for cause in wanted.into_iter().flatten() {
            if !self.open.contains_key(&(id, cause)) {
                let number = self.raise(at, Some(id), cause, words(cause, node));
                self.open.insert((id, cause), number);
            }
        }
    }

    fn has_no_clock(&mut self, at: Moment, node: &Node) -> bool {
        let record = node.latest_record();
        let missing = node.is_there() && record.is_some_and(|record| record.clock.is_none());
        if !missing {
            self.no_clock_since.remove(&node.id());
            return false;
        }
        let since = *self.no_clock_since.entry(node.id()).or_insert(at);
        at.since_s(since) > CLOCK_GRACE_S
    }

    /// Looks at a job; `promised_us` is the largest skew that it was promised.
    pub(super) fn job(&mut self, at: Moment, record: &JobRecord, promised_us: f64) {
        let Some(start) = &record.start else { return };
        // The gateway also tells what happened long ago.
        let age_s = at.since_s(Moment(start.planned.0));
        let told = self.skews_told.contains(&record.job);
        if start.skew_us <= promised_us || age_s > SKEW_NEWS_S || told {
            return;
        }
        if self.skews_told.len() == ALARMS_MAX {
            self.skews_told.pop_front();
        }
        self.skews_told.push_back(record.job);
        let text = format!(
            "{} started {} apart ± {}, promised {}",
            record.job,
            text::micros(start.skew_us),
            text::micros(start.uncertainty_us),
            text::micros(promised_us)
        );
        let number = self.raise(at, None, Cause::Skew(record.job), text);
        if let Some(alarm) = self.list.get_mut(&number) {
            alarm.over = Some(at);
        }
    }

    /// Notes that somebody has seen this one, or all if `None`.
    pub(super) fn acknowledge(&mut self, at: Moment, alarm: Option<u64>) {
        let meant = |known: &&mut Alarm| alarm.is_none_or(|alarm| alarm == known.id);
        for alarm in self.list.values_mut().filter(meant) {
            if alarm.seen.is_none() {
                alarm.seen = Some(at);
                self.unseen -= 1;
            }
        }
    }

    fn raise(&mut self, at: Moment, node: Option<NodeId>, cause: Cause, text: String) -> u64 {
        if self.list.len() >= ALARMS_MAX {
            self.forget_one();
        }
        self.next += 1;
        let alarm = Alarm {
            id: self.next,
            cause,
            node,
            raised: at,
            over: None,
            seen: None,
            text,
        };
        self.list.insert(self.next, alarm);
        self.unseen += 1;
        self.next
    }

    /// Forgets the oldest of those that matter least.
    fn forget_one(&mut self) {
        let rank = |alarm: &Alarm| match (alarm.over, alarm.seen) {
            (Some(_), Some(_)) => 0,
            (None, Some(_)) => 1,
            (Some(_), None) => 2,
            (None, None) => 3,
        };
        let least = self
            .list
            .values()
            .min_by_key(|alarm| (rank(alarm), alarm.id));
        if let Some(id) = least.map(|alarm| alarm.id)
            && let Some(alarm) = self.list.remove(&id)
            && alarm.seen.is_none()
        {
            self.unseen -= 1;
            self.forgotten_unseen += 1;
        }
    }

    /// Returns the alarms, newest first.
    pub fn newest_first(&self) -> impl Iterator<Item = &Alarm> {
        self.list.values().rev()
    }

    /// Returns how many nobody has seen.
    pub fn unseen(&self) -> usize {
        self.unseen
    }

    /// Returns how many were forgotten although nobody had seen them: there were more than
    /// [`ALARMS_MAX`].
    pub fn forgotten_unseen(&self) -> u64 {
        self.forgotten_unseen
    }

    /// Returns how many have a cause that is not over.
    pub fn open(&self) -> usize {
        self.open.len()
    }

    /// Returns the number of the latest, 0 before the first: tells whether there is a new one.
    pub fn latest(&self) -> u64 {
        self.next
    }
}

fn words(cause: Cause, node: &Node) -> String {
    match cause {
        Cause::Fault(_) => match node.last_fault() {
            Some((code, words)) => format!("fault {code}: {words}"),
            None => "fault".to_owned(),
        },
        Cause::Lost => match node.job() {
            Some(job) => format!("gone, in the middle of {job}"),
            None => "gone".to_owned(),
        },
        Cause::Stopped => match node.stop_reason() {
            Some(reason) => format!("stopped: {reason}"),
            None => "stopped".to_owned(),
        },
        Cause::Silent => "there, but says nothing".to_owned(),
        Cause::Clock => "its clock is not known: it cannot start together with others".to_owned(),
        Cause::Skew(job) => format!("{job} started too far apart"),
    }
}

#[cfg(test)]
mod tests {
    use crate::message::{LinkEvent, Message};
    use crate::model::{Model, limits::ALARMS_MAX, tests::*};
    use keys::{
        FleetMicros, NodeState,
        record::{NodeWord, StartRecord},
    };

    fn connected() -> Model {
        let mut model = Model::default();
        let to = "here".to_owned();
        model.apply(at(0), Message::Link(LinkEvent::Connected { to }));
        model
    }

    /// `cause text [over] [seen]`, newest first.
    fn told(model: &Model) -> Vec<String> {
        let alarms = model.alarms().newest_first();
        let words = alarms.map(|alarm| {
            let over = if alarm.over.is_some() { " over" } else { "" };
            let seen = if alarm.seen.is_some() { " seen" } else { "" };
            format!("{}{over}{seen}", alarm.text)
        });
        words.collect()
    }

    fn acknowledge(model: &mut Model, ms: u64, alarm: Option<u64>) {
        model.apply(at(ms), Message::Acknowledged { alarm });
    }

    #[test]
    fn a_cause_is_raised_once_cleared_and_raised_anew() {
        let mut model = connected();
        alive(&mut model, 0, "left", true);
        for ms in [10, 20, 30] {
            says(&mut model, ms, "left", NodeState::Stopped);
        }
        assert_eq!(told(&model), ["stopped"]);
        assert_eq!(model.alarms().unseen(), 1);
        acknowledge(&mut model, 40, None);
        says(&mut model, 50, "left", NodeState::Stopped);
        assert_eq!(told(&model), ["stopped seen"]);
        says(&mut model, 60, "left", NodeState::Idle);
        assert_eq!(told(&model), ["stopped over seen"]);
        says(&mut model, 70, "left", NodeState::Stopped);
        assert_eq!(told(&model), ["stopped", "stopped over seen"]);
        assert_eq!(model.alarms().unseen(), 1);
    }

    #[test]
    fn one_alarm_is_acknowledged_alone() {
        let mut model = connected();
        for name in ["left", "right"] {
            alive(&mut model, 0, name, true);
            alive(&mut model, 10, name, false);
        }
        assert_eq!(told(&model), ["gone", "gone"]);
        let last = model.alarms().latest();
        acknowledge(&mut model, 20, Some(last));
        assert_eq!(told(&model), ["gone seen", "gone"]);
        acknowledge(&mut model, 21, Some(last));
        assert_eq!(model.alarms().unseen(), 1, "twice is once");
    }

    #[test]
    fn a_latch_stays_an_alarm_while_its_node_is_gone() {
        let mut model = connected();
        alive(&mut model, 0, "left", true);
        says(&mut model, 10, "left", NodeState::Stopped);
        alive(&mut model, 20, "left", false);
        assert_eq!(told(&model), ["gone", "stopped"]);
        alive(&mut model, 30, "left", true);
        says(&mut model, 40, "left", NodeState::Idle);
        assert_eq!(told(&model), ["gone over", "stopped over"]);
    }

    #[test]
    fn a_clock_gets_time_to_be_known_and_silence_is_noticed_without_messages() {
        let mut model = connected();
        alive(&mut model, 0, "left", true);
        let mut unlocked = record("left", NodeWord::Idle);
        unlocked.clock = None;
        model.apply(at(0), Message::Node(unlocked.clone()));
        for ms in [2_700, 5_000] {
            says(&mut model, ms, "left", NodeState::Idle);
            assert_eq!(told(&model), [""; 0]);
        }
        model.apply(at(5_500), Message::Node(unlocked));
        assert_eq!(model.alarms().unseen(), 1);
        assert!(told(&model)[0].contains("clock is not known"));
        model.tick(at(9_000));
        assert!(told(&model)[0].contains("says nothing"));
        says(&mut model, 9_100, "left", NodeState::Idle);
        assert!(told(&model)[0].ends_with("over"));
    }

    #[test]
    fn without_a_link_nothing_is_raised_and_nothing_is_over() {
        let mut model = connected();
        alive(&mut model, 0, "left", true);
        let why = "cut".to_owned();
        model.apply(at(10), Message::Link(LinkEvent::Down { why }));
        model.tick(at(60_000));
        assert_eq!(told(&model), [""; 0]);
    }

    #[test]
    fn a_node_has_time_to_speak_after_the_link_returned() {
        let mut model = connected();
        alive(&mut model, 0, "left", true);
        says(&mut model, 10, "left", NodeState::Idle);
        let why = "cut".to_owned();
        model.apply(at(20), Message::Link(LinkEvent::Down { why }));
        let to = "here".to_owned();
        model.apply(at(60_000), Message::Link(LinkEvent::Connected { to }));
        model.tick(at(62_000));
        assert_eq!(told(&model), [""; 0]);
        model.tick(at(64_000));
        assert!(told(&model)[0].contains("says nothing"));
    }

    #[test]
    fn skew_beyond_the_promise_is_told_once_and_old_news_are_none() {
        let mut model = connected();
        let mut late = job("cut", at(0).0, 1, keys::record::JobState::Running);
        let start = |skew_us, planned| StartRecord {
            planned: FleetMicros(planned),
            skew_us,
            by_node_us: std::collections::BTreeMap::new(),
            uncertainty_us: 20.0,
        };
        let promise = |name: &str, max_skew_us| {
            Message::StartPlan(keys::record::StartPlan {
                job: keys::JobId::new(name).expect("a name"),
                told: FleetMicros(1),
                starts_at: FleetMicros(2),
                max_skew_us,
            })
        };
        model.apply(at(900), promise("cut", 1_000.0));
        for (version, skew_us) in [(1, 900.0), (2, 1_200.0), (3, 1_200.0)] {
            late.version = version;
            late.start = Some(Box::new(start(skew_us, at(0).0)));
            model.apply(at(1_000), Message::Job(Box::new(late.clone())));
        }
        let words = "cut started 1.2 ms apart ± 20 µs, promised 1.0 ms over";
        assert_eq!(told(&model), [words]);
        let mut old = job("old", 1, 1, keys::record::JobState::Running);
        old.start = Some(Box::new(start(5_000.0, 1)));
        model.apply(at(1_000), Message::Job(Box::new(old)));
        assert_eq!(told(&model).len(), 1);
        // What others were promised is theirs to say; without a word nobody knows.
        model.apply(at(900), promise("theirs", 8_000.0));
        for name in ["theirs", "silent"] {
            let mut other = job(name, at(0).0, 1, keys::record::JobState::Running);
            other.start = Some(Box::new(start(5_000.0, at(0).0)));
            model.apply(at(1_000), Message::Job(Box::new(other)));
        }
        assert_eq!(told(&model).len(), 1);
    }

    #[test]
    fn the_list_has_a_bound_and_forgets_first_what_is_over_and_seen() {
        let mut model = connected();
        alive(&mut model, 0, "left", true);
        alive(&mut model, 0, "right", true);
        says(&mut model, 1, "right", NodeState::Stopped);
        for turn in 0..ALARMS_MAX as u64 {
            says(&mut model, 10 + 2 * turn, "left", NodeState::Stopped);
            says(&mut model, 11 + 2 * turn, "left", NodeState::Idle);
        }
        assert_eq!(told(&model).len(), ALARMS_MAX);
        assert_eq!(model.alarms().forgotten_unseen(), 1);
        assert!(told(&model).contains(&"stopped".to_owned()), "still open");
    }
}
