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
    link::{LinkState, Phase},
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
    /// The way to the fleet was there and is gone.
    Link,
    /// A gateway was there, and now none answers.
    Gateway,
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
    /// Those that are about no node.
    open_of_all: BTreeMap<Cause, u64>,
    had_gateway: bool,
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

    /// Looks at the way to the fleet, which was there or was not.
    pub(super) fn link(&mut self, at: Moment, was_up: bool, link: &LinkState) {
        let (is_up, has_gateway) = (link.is_up(), link.gateway());
        if is_up {
            self.end(at, Cause::Link);
        } else if was_up && *link.phase() == Phase::Down {
            let why = link.why().unwrap_or("it is closed");
            let words = format!("no link: {why}. Nobody here hears of nodes or stops them");
            self.begin(at, Cause::Link, words);
        }
        match has_gateway {
            Some(true) => {
                self.had_gateway = true;
                self.end(at, Cause::Gateway);
            }
            Some(false) if self.had_gateway => {
                let words = "no gateway answers: nobody follows jobs; stops still reach the nodes";
                self.begin(at, Cause::Gateway, words.to_owned());
            }
            Some(false) | None => {}
        }
    }

    fn begin(&mut self, at: Moment, cause: Cause, text: String) {
        if !self.open_of_all.contains_key(&cause) {
            let number = self.raise(at, None, cause, text);
            self.open_of_all.insert(cause, number);
        }
    }

    fn end(&mut self, at: Moment, cause: Cause) {
        let open = self.open_of_all.remove(&cause);
        if let Some(alarm) = open.and_then(|open| self.list.get_mut(&open)) {
            alarm.over = Some(at);
        }
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
        self.open.len() + self.open_of_all.len()
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
        Cause::Link => "no link".to_owned(),
        Cause::Gateway => "no gateway".to_owned(),
    }
}

#[cfg(test)]
mod tests;
