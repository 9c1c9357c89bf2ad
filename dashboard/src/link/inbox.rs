//! What was heard and not yet looked at: bounded, and for what is complete each time the latest
//! wins.
//!
//! | kind | kept | full |
//! |---|---|---|
//! | status | the last [`STATUSES_MAX`] of a node | the oldest goes; the next is complete |
//! | node record | the last of a node | it is replaced; records are complete |
//! | job record | the last of a job, [`JOBS_MAX`] jobs | counted, and everything is asked for again |
//! | log line | the last [`LINES_MAX`] | the oldest goes, counted |
//! | everything else | [`EVENTS_MAX`] | counted, and everything is asked for again |
//!
//! A window that draws takes all of it many times a second. The bounds are for one that does not. It is
//! woken for news only: a status or a record that differs from the one before by times and clocks
//! alone waits for the next frame, which comes within a second anyway, and so do vitals.

use super::Clock;
use crate::message::{Message, Moment};
use keys::{JobId, NodeId, Status, record::NodeRecord};
use std::{
    collections::{BTreeMap, VecDeque},
    sync::{
        Mutex, MutexGuard, PoisonError,
        atomic::{AtomicBool, Ordering},
    },
};

/// Statuses of one node: three seconds at 10/s.
pub const STATUSES_MAX: usize = 32;

/// Nodes whose statuses or records wait.
pub const NODES_MAX: usize = crate::model::limits::NODES_MAX;

/// Jobs whose records wait.
pub const JOBS_MAX: usize = 4_096;

/// Log lines.
pub const LINES_MAX: usize = crate::model::limits::LOG_LINES_MAX;

/// Everything else.
pub const EVENTS_MAX: usize = 16_384;

type Heard = (Moment, Message);

#[derive(Default)]
struct Waiting {
    statuses: BTreeMap<NodeId, VecDeque<Heard>>,
    records: BTreeMap<NodeId, Heard>,
    jobs: BTreeMap<JobId, Heard>,
    lines: VecDeque<Heard>,
    events: VecDeque<Heard>,
    missed: u64,
    /// The last status and record of each node, which stay when all is taken.
    last: Last,
}

#[derive(Default)]
struct Last {
    statuses: BTreeMap<NodeId, Status>,
    records: BTreeMap<NodeId, NodeRecord>,
}

/// See the module.
pub struct Inbox {
    clock: Clock,
    waiting: Mutex<Waiting>,
    dirty: AtomicBool,
    incomplete: AtomicBool,
    wake: Box<dyn Fn() + Send + Sync>,
}

impl Inbox {
    /// Makes an empty one.
    pub fn new(clock: Clock, wake: impl Fn() + Send + Sync + 'static) -> Self {
        Self {
            clock,
            waiting: Mutex::default(),
            dirty: AtomicBool::new(false),
            incomplete: AtomicBool::new(false),
            wake: Box::new(wake),
        }
    }

    /// Takes what was heard just now.
    pub fn push(&self, message: Message) {
        let heard = (self.clock.now(), message);
        let mut waiting = self.lock();
        let is_news = waiting.is_news(&heard.1);
        if !waiting.push(heard) {
            self.incomplete.store(true, Ordering::Relaxed);
        }
        drop(waiting);
        if is_news && !self.dirty.swap(true, Ordering::AcqRel) {
            (self.wake)();
        }
    }

    /// Returns everything in the order in which it was heard.
    pub fn take(&self) -> Vec<Heard> {
        // Cleared first: what comes in between wakes once too often rather than never.
        self.dirty.store(false, Ordering::Release);
        let waiting = self.lock().take();
        let mut heard: Vec<Heard> = Vec::new();
        heard.extend(waiting.statuses.into_values().flatten());
        heard.extend(waiting.records.into_values());
        heard.extend(waiting.jobs.into_values());
        heard.extend(waiting.lines);
        heard.extend(waiting.events);
        heard.sort_by_key(|(at, _)| *at);
        if waiting.missed > 0 {
            let messages = waiting.missed;
            heard.push((self.clock.now(), Message::Missed { messages }));
        }
        heard
    }

    /// Returns once whether something was dropped that only asking again can bring back.
    pub fn take_incomplete(&self) -> bool {
        self.incomplete.swap(false, Ordering::Relaxed)
    }

    fn lock(&self) -> MutexGuard<'_, Waiting> {
        // Nothing in there is half done when a callback panics.
        self.waiting.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Waiting {
    /// Takes everything that waits.
    fn take(&mut self) -> Self {
        let last = std::mem::take(&mut self.last);
        let fresh = Self {
            last,
            ..Self::default()
        };
        std::mem::replace(self, fresh)
    }

    /// Returns whether a message says something that an operator waits for.
    fn is_news(&mut self, message: &Message) -> bool {
        match message {
            Message::Status { node, status } => {
                let before = exchange(&mut self.last.statuses, *node, status);
                before.is_none_or(|before| {
                    let at = status.at;
                    Status { at, ..before } != **status
                })
            }
            Message::Node(record) => {
                let before = exchange(&mut self.last.records, record.node, record);
                before.is_none_or(|before| {
                    let is_known = before.clock.is_some() == record.clock.is_some();
                    let clock = if is_known { record.clock } else { before.clock };
                    let uptime_s = record.uptime_s;
                    NodeRecord {
                        clock,
                        uptime_s,
                        ..before
                    } != **record
                })
            }
            Message::Vitals { .. } => false,
            _ => true,
        }
    }

    /// Returns whether it could be kept, or will be followed by one that is complete.
    fn push(&mut self, heard: Heard) -> bool {
        match &heard.1 {
            Message::Status { node, .. } => {
                if self.statuses.len() >= NODES_MAX && !self.statuses.contains_key(node) {
                    self.missed += 1;
                    return true;
                }
                let of_node = self.statuses.entry(*node).or_default();
                if of_node.len() == STATUSES_MAX {
                    of_node.pop_front();
                }
                of_node.push_back(heard);
            }
            Message::Node(record) => {
                if self.records.len() >= NODES_MAX && !self.records.contains_key(&record.node) {
                    self.missed += 1;
                    return false;
                }
                self.records.insert(record.node, heard);
            }
            Message::Job(record) => {
                let newer = |known: &Heard| match &known.1 {
                    Message::Job(known) => {
                        known.created == record.created && known.version > record.version
                    }
                    _ => false,
                };
                match self.jobs.get(&record.job) {
                    Some(known) if newer(known) => {}
                    None if self.jobs.len() >= JOBS_MAX => {
                        self.missed += 1;
                        return false;
                    }
                    _ => {
                        self.jobs.insert(record.job, heard);
                    }
                }
            }
            Message::Log { .. } => {
                if self.lines.len() == LINES_MAX {
                    self.lines.pop_front();
                    self.missed += 1;
                }
                self.lines.push_back(heard);
            }
            _ => {
                if self.events.len() == EVENTS_MAX {
                    self.missed += 1;
                    return false;
                }
                self.events.push_back(heard);
            }
        }
        true
    }
}

/// Keeps a node's latest and returns the one before, of as many nodes as fit.
fn exchange<T: Clone>(last: &mut BTreeMap<NodeId, T>, node: NodeId, latest: &T) -> Option<T> {
    if last.len() >= NODES_MAX && !last.contains_key(&node) {
        return None;
    }
    last.insert(node, latest.clone())
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::sync::{Arc, atomic::AtomicUsize};

    fn line(number: usize) -> Message {
        Message::Log {
            node: NodeId::new("left").expect("a name"),
            text: number.to_string(),
        }
    }

    #[test]
    fn many_messages_wake_the_window_once() {
        let wakes = Arc::new(AtomicUsize::new(0));
        let counted = Arc::clone(&wakes);
        let inbox = Inbox::new(Clock::start(), move || {
            counted.fetch_add(1, Ordering::Relaxed);
        });
        for number in 0..100 {
            inbox.push(line(number));
        }
        assert_eq!(wakes.load(Ordering::Relaxed), 1);
        assert_eq!(inbox.take().len(), 100);
        inbox.push(line(100));
        assert_eq!(wakes.load(Ordering::Relaxed), 2);
    }

    #[test]
    fn a_node_at_rest_does_not_wake_the_window() {
        let wakes = Arc::new(AtomicUsize::new(0));
        let counted = Arc::clone(&wakes);
        let inbox = Inbox::new(Clock::start(), move || {
            counted.fetch_add(1, Ordering::Relaxed);
        });
        let tell = |at_us: u64, laser_percent: u8| {
            let mut status = crate::model::tests::status(keys::NodeState::Idle);
            status.at = keys::LocalMicros(at_us);
            status.laser_percent = laser_percent;
            inbox.push(Message::Status {
                node: NodeId::new("left").expect("a name"),
                status,
            });
        };
        tell(1, 0);
        assert_eq!((wakes.load(Ordering::Relaxed), inbox.take().len()), (1, 1));
        tell(2, 0);
        tell(3, 0);
        assert_eq!(wakes.load(Ordering::Relaxed), 1, "only the time moved on");
        assert_eq!(inbox.take().len(), 2, "they are kept for the next frame");
        tell(4, 10);
        tell(5, 10);
        assert_eq!(wakes.load(Ordering::Relaxed), 2);
    }

    #[test]
    fn a_clock_measured_anew_and_vitals_do_not_wake_the_window_but_a_clock_found_does() {
        let wakes = Arc::new(AtomicUsize::new(0));
        let counted = Arc::clone(&wakes);
        let inbox = Inbox::new(Clock::start(), move || {
            counted.fetch_add(1, Ordering::Relaxed);
        });
        let woken_by = |message: Message| {
            let before = wakes.load(Ordering::Relaxed);
            inbox.push(message);
            let woken = wakes.load(Ordering::Relaxed) - before;
            assert_eq!(inbox.take().len(), 1, "it is kept for the next frame");
            woken
        };
        let record = |offset_us: Option<f64>, uptime_s: u64| {
            let mut record = crate::model::tests::record("left", keys::record::NodeWord::Idle);
            record.clock = offset_us.map(|offset_us| keys::record::ClockRecord {
                offset_us,
                error_us: 100.0,
                drift_ppm: 1.0,
            });
            record.uptime_s = uptime_s;
            Message::Node(record)
        };
        assert_eq!(woken_by(record(None, 1)), 1);
        assert_eq!(woken_by(record(Some(5.0), 2)), 1);
        assert_eq!(woken_by(record(Some(6.0), 3)), 0);
        assert_eq!(woken_by(record(None, 4)), 1);
        let node = NodeId::new("left").expect("a name");
        let vitals = keys::Vitals::default();
        assert_eq!(woken_by(Message::Vitals { node, vitals }), 0);
    }

    #[test]
    fn what_does_not_fit_is_counted_and_told() {
        let inbox = Inbox::new(Clock::start(), || {});
        for number in 0..LINES_MAX + 7 {
            inbox.push(line(number));
        }
        let heard = inbox.take();
        assert_eq!(heard.len(), LINES_MAX + 1);
        assert_eq!(heard[0].1, line(7));
        let last = heard.last().map(|(_, message)| message);
        assert_eq!(last, Some(&Message::Missed { messages: 7 }));
        assert!(!inbox.take_incomplete(), "a lost line cannot be asked for");
        for number in 0..=EVENTS_MAX {
            let why = number.to_string();
            inbox.push(Message::Unreadable {
                key: String::new(),
                why,
            });
        }
        assert!(inbox.take_incomplete());
        assert!(!inbox.take_incomplete(), "told once");
    }
}
