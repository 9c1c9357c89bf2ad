//! What callbacks do with what they hear: sort it by key, hand it to the inbox, never wait.
//!
//! A client may name several nodes or jobs by a wild name chunk (`fleet/node/cell-$*/job`). A key
//! that merely includes one of ours (`fleet/**`) reads records and stops nodes, and never gives a
//! job, a cancel or a release: a tool that looks at everything must not move a motor.

use super::{
    Addressee, Arrived, Inbox, WallClock, busy,
    door::{Door, stop_pattern},
    gets::{Gets, refuse},
    limits::Admission,
    refusal_event,
    sizes::{SCRIPT_MESSAGE_BYTES_MAX, SMALL_BYTES_MAX},
    too_large, too_often,
    zenoh::Payload,
};
use crate::{
    fleet::{
        event::Event,
        manage::{NodeWishes, OrderWishes},
    },
    job::parse::wish_from,
};
use keys::{Keys, NodeId, NodeTopic, Stop, StopMode};
use std::sync::Arc;
use zenoh::{
    query::Query,
    sample::{Sample, SampleKind},
    time::TimestampId,
};

/// Sorts what comes through one door.
pub(super) struct Ear {
    door: Door,
    inbox: Inbox,
    clock: WallClock,
    keys: Keys,
    gets: Arc<Gets>,
    /// Stops with such a stamp are what this gateway says to nodes.
    own_stamps: Option<TimestampId>,
}

impl Ear {
    /// Listens at this door.
    pub(super) fn new(
        door: Door,
        inbox: &Inbox,
        clock: WallClock,
        keys: &Keys,
        gets: &Arc<Gets>,
        own_stamps: Option<TimestampId>,
    ) -> Self {
        Self {
            door,
            inbox: inbox.clone(),
            clock,
            keys: keys.clone(),
            gets: Arc::clone(gets),
            own_stamps,
        }
    }

    /// Returns whether this gateway has said it. A client that takes on its stamp is not heard here, and
    /// stops nodes all the same.
    fn is_own(&self, sample: &Sample) -> bool {
        let stamped_by = sample.timestamp().map(|stamp| *stamp.get_id());
        stamped_by.is_some() && stamped_by == self.own_stamps
    }

    /// Takes a put.
    pub(super) fn put(&self, sample: &Sample) {
        let at = self.clock.now();
        let key = sample.key_expr().as_str();
        if self.door == Door::Node(NodeTopic::Stop) {
            if self.is_own(sample) {
                return;
            }
            // Whatever comes on this key stops, also a value that is deleted: so nodes take it.
            let payload = sample.payload();
            let mode = match payload.len() {
                0..=SMALL_BYTES_MAX => Stop::from_payload(&payload.to_bytes()).mode,
                // Through a router of others: it says nothing, and is not put together for that.
                _ => StopMode::Halt,
            };
            let pattern = stop_pattern(&self.keys, key);
            return self.inbox.stop(pattern, mode);
        }
        if sample.kind() != SampleKind::Put {
            return;
        }
        let Some(name) = self.door.name(&self.keys, key) else {
            tracing::debug!(key, "a put on a key that only includes ours");
            return;
        };
        let pattern = name.to_owned();
        match self.door {
            Door::Node(
                NodeTopic::Job
                | NodeTopic::Release
                | NodeTopic::Hold
                | NodeTopic::Resume
                | NodeTopic::Speed,
            )
            | Door::GroupJob
            | Door::LabelJob
            | Door::JobCancel => match self.gets.count(sample.payload().len(), at) {
                Admission::Taken => {}
                Admission::Refused { tell } => return self.refuse_put(pattern, tell),
            },
            Door::Node(_)
            | Door::Job
            | Door::ManageNode
            | Door::ManageJob
            | Door::Links
            | Door::Keep(_) => {}
        }
        let job = |to| {
            let payload = Payload(sample.payload().clone());
            let wishes = sample.attachment().cloned().map(Payload);
            self.inbox
                .job(to, sample.encoding().to_string(), payload, wishes, None)
        };
        let taken = match self.door {
            Door::Node(NodeTopic::Job) => job(Addressee::Node(pattern)),
            Door::GroupJob => job(Addressee::Group(pattern)),
            Door::LabelJob => job(Addressee::Label(pattern)),
            Door::Node(NodeTopic::Release) => self.inbox.release(Event::Release {
                pattern,
                reply: None,
            }),
            Door::JobCancel => self.inbox.event(Event::Cancel {
                pattern,
                reply: None,
            }),
            Door::Node(topic @ (NodeTopic::Hold | NodeTopic::Resume | NodeTopic::Speed)) => {
                let wish = wish_from(topic, &sample.payload().to_bytes());
                self.inbox.event(Event::Pace {
                    pattern,
                    wish,
                    reply: None,
                })
            }
            Door::Node(topic) => {
                let Ok(node) = NodeId::new(name) else { return };
                // What comes through a router of others may be of any size.
                if sample.payload().len() > SMALL_BYTES_MAX || !self.gets.hear(node, at) {
                    return self.inbox.note_dropped(&"a node says too much");
                }
                let event = Event::FromNode {
                    node,
                    topic,
                    payload: sample.payload().to_bytes().into_owned(),
                };
                let at = (topic == NodeTopic::Clock).then_some(at);
                self.inbox.event(Arrived { event, at })
            }
            Door::Job | Door::ManageNode | Door::ManageJob | Door::Links | Door::Keep(_) => Ok(()),
        };
        // Full: counted by the inbox, and a put has no answer.
        let _ = taken;
    }

    /// A client has put too much: a job leaves a record, if that is not too much as well.
    fn refuse_put(&self, pattern: String, tell: bool) {
        let to = match self.door {
            Door::Node(NodeTopic::Job) if tell => Addressee::Node(pattern),
            Door::GroupJob if tell => Addressee::Group(pattern),
            Door::LabelJob if tell => Addressee::Label(pattern),
            _ => return self.inbox.note_dropped(&"a client asks for too much"),
        };
        // Full: counted by the inbox.
        let _ = self.inbox.event(refusal_event(to, too_often(), None));
    }

    /// Takes a get.
    pub(super) fn get(&self, query: &Query) {
        let key = query.key_expr().as_str();
        let reads = matches!(self.door, Door::Job | Door::Node(NodeTopic::State));
        let pattern = match self.door.name(&self.keys, key) {
            Some(name) => name.to_owned(),
            None if reads => "*".to_owned(),
            None => return,
        };
        let Some(to) = self.gets.admit(query, self.clock.now()) else {
            return;
        };
        let is_job = matches!(
            self.door,
            Door::Node(NodeTopic::Job) | Door::GroupJob | Door::LabelJob | Door::Keep(_)
        );
        let bytes = query.payload().map_or(0, |payload| payload.len());
        if !is_job && bytes > SCRIPT_MESSAGE_BYTES_MAX {
            self.gets.remove(to);
            return refuse(query, too_large());
        }
        let reply = Some(to);
        let job = |addressee| {
            let payload = Payload(query.payload().cloned().unwrap_or_default());
            let encoding = query.encoding().cloned().unwrap_or_default().to_string();
            let wishes = query.attachment().cloned().map(Payload);
            self.inbox.job(addressee, encoding, payload, wishes, reply)
        };
        let taken = match self.door {
            Door::Node(NodeTopic::Job) => job(Addressee::Node(pattern)),
            Door::GroupJob => job(Addressee::Group(pattern)),
            Door::LabelJob => job(Addressee::Label(pattern)),
            Door::ManageNode => self.inbox.event(Event::ManageNodes {
                pattern,
                request: NodeWishes::from_json(&asked(query)),
                reply: to,
            }),
            Door::ManageJob => self.inbox.event(Event::ManageJob {
                job: pattern,
                request: OrderWishes::from_json(&asked(query)),
                reply: to,
            }),
            Door::Links => self.inbox.event(Event::GetLinks { pattern, reply: to }),
            Door::Keep(kind) => self.inbox.event(Event::Keep {
                kind,
                pattern,
                payload: asked(query),
                reply: to,
            }),
            Door::Node(NodeTopic::Release) => self.inbox.release(Event::Release { pattern, reply }),
            Door::JobCancel => self.inbox.event(Event::Cancel { pattern, reply }),
            Door::Node(topic @ (NodeTopic::Hold | NodeTopic::Resume | NodeTopic::Speed)) => {
                let payload = query.payload().map(|payload| payload.to_bytes());
                let wish = wish_from(topic, &payload.unwrap_or_default());
                self.inbox.event(Event::Pace {
                    pattern,
                    wish,
                    reply,
                })
            }
            Door::Node(_) => self.inbox.event(Event::GetNodes { pattern, reply: to }),
            Door::Job => self.inbox.event(Event::GetJobs {
                pattern,
                parameters: query
                    .parameters()
                    .iter()
                    .map(|(name, value)| (name.to_owned(), value.to_owned()))
                    .collect(),
                reply: to,
            }),
        };
        if taken.is_err() {
            self.gets.remove(to);
            refuse(query, busy());
        }
    }

    /// Takes a node's coming or going.
    pub(super) fn alive(&self, sample: &Sample) {
        // A token that comes tells nothing: the node's status follows it.
        if sample.kind() == SampleKind::Put {
            return;
        }
        let name = self.door.name(&self.keys, sample.key_expr().as_str());
        if let Some(node) = name.and_then(|name| NodeId::new(name).ok()) {
            self.inbox.gone(node);
        }
    }
}

/// Returns the payload of a get; none is an empty one.
fn asked(query: &Query) -> Vec<u8> {
    query
        .payload()
        .map(|payload| payload.to_bytes().into_owned())
        .unwrap_or_default()
}
