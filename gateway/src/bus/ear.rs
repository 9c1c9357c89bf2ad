//! What callbacks do with what they hear: sort it by key, hand it to the inbox, never wait.
//!
//! Owns the gets that wait for replies; each is ended exactly once, by the last reply, a refusal
//! or the end of the service.
//!
//! A client may name several nodes or jobs by a wild name chunk (`fleet/node/cell-$*/job`). A key
//! that merely includes one of ours (`fleet/**`) reads records and stops nodes, and never gives a
//! job, a cancel or a release: a tool that looks at everything must not move a motor.

use super::{
    Addressee, Arrived, GETS_OPEN_MAX, Inbox, WallClock, busy,
    limits::{Admission, Client, ClientLimits, Limits},
    refusal_event,
    sizes::{SCRIPT_MESSAGE_BYTES_MAX, SMALL_BYTES_MAX},
    too_large, too_often,
    zenoh::Payload,
};
use crate::{
    fleet::{
        event::{Event, ReplyTo},
        kept::Kind,
        manage::{NodeWishes, OrderWishes},
    },
    job::parse::wish_from,
};
use keys::{
    FleetMicros, Keys, NodeId, NodeTopic, Stop, StopMode, Topic,
    record::{ErrorReply, JobError, to_json},
};
use std::{
    collections::HashMap,
    sync::{
        Arc, Mutex, MutexGuard, PoisonError,
        atomic::{AtomicU64, Ordering},
    },
};
use zenoh::{
    Wait,
    bytes::Encoding,
    query::Query,
    sample::{Sample, SampleKind},
};

/// Gets that wait for replies, and what each client has asked for.
pub(super) struct Gets {
    open: Mutex<HashMap<ReplyTo, (Query, Client)>>,
    next: AtomicU64,
    limits: Mutex<Limits>,
}

impl Gets {
    pub(super) fn new(limits: ClientLimits) -> Self {
        Self {
            open: Mutex::default(),
            next: AtomicU64::default(),
            limits: Mutex::new(Limits::new(limits)),
        }
    }

    fn open(&self) -> MutexGuard<'_, HashMap<ReplyTo, (Query, Client)>> {
        self.open.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn limits(&self) -> MutexGuard<'_, Limits> {
        self.limits.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Takes a message of a node, or drops it.
    fn hear(&self, node: NodeId, now: FleetMicros) -> bool {
        self.limits().hear(node, now)
    }

    /// Counts a request of the client that is calling.
    fn count(&self, bytes: usize, now: FleetMicros) -> Admission {
        self.limits().admit(Client::of_this_call(), bytes, now)
    }

    /// Keeps a get until its end; `None`: there are too many, it has been told.
    fn admit(&self, query: &Query, now: FleetMicros) -> Option<ReplyTo> {
        let bytes = query.payload().map_or(0, |payload| payload.len());
        let client = Client::of_this_call();
        if self.count(bytes, now) != Admission::Taken || !self.limits().open_get(client) {
            refuse(query, too_often());
            return None;
        }
        let mut open = self.open();
        if open.len() >= GETS_OPEN_MAX {
            drop(open);
            self.limits().close_get(client);
            refuse(query, busy());
            return None;
        }
        let to = ReplyTo(self.next.fetch_add(1, Ordering::Relaxed));
        open.insert(to, (query.clone(), client));
        Some(to)
    }

    /// Returns an open get.
    pub(super) fn get(&self, to: ReplyTo) -> Option<Query> {
        self.open().get(&to).map(|(query, _)| query.clone())
    }

    /// Forgets a get. The client hears the end when the last copy of the query is dropped.
    pub(super) fn remove(&self, to: ReplyTo) -> Option<Query> {
        let (query, client) = self.open().remove(&to)?;
        self.limits().close_get(client);
        Some(query)
    }

    /// Forgets all.
    pub(super) fn end_all(&self) {
        let all = std::mem::take(&mut *self.open());
        // Outside of the lock: each drop sends a message.
        drop(all);
    }
}

/// Gives the error reply.
pub(super) fn refuse(query: &Query, error: JobError) {
    let reply = query
        .reply_err(to_json(&ErrorReply { error }))
        .encoding(Encoding::APPLICATION_JSON)
        .wait();
    if let Err(error) = reply {
        tracing::debug!("a client left before its reply: {error}");
    }
}

/// A kind of key that the gateway hears or answers, for every name.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Door {
    /// `PREFIX/node/*/TOPIC`
    Node(NodeTopic),
    /// `PREFIX/group/*/job`
    GroupJob,
    /// `PREFIX/job/*`
    Job,
    /// `PREFIX/job/*/cancel`
    JobCancel,
    /// `PREFIX/manage/label/*/job`
    LabelJob,
    /// `PREFIX/manage/node/*`
    ManageNode,
    /// `PREFIX/manage/job/*`
    ManageJob,
    /// `PREFIX/manage/link/*`
    Links,
    /// `PREFIX/manage/template/*` and `…/schedule/*`
    Keep(Kind),
}

impl Door {
    /// Returns the key to declare.
    pub(super) fn key(self, keys: &Keys) -> String {
        let key = match self {
            Self::Node(topic) => keys.every_node(topic),
            Self::GroupJob => keys.every_group_job(),
            Self::Job => keys.every_job(),
            Self::JobCancel => keys.every_job_cancel(),
            Self::LabelJob | Self::ManageNode | Self::ManageJob | Self::Links | Self::Keep(_) => {
                let (before, behind) = self.around_name();
                return format!("{}{before}*{behind}", keys.prefix());
            }
        };
        key.as_str().to_owned()
    }

    /// Returns what stands around the name in keys of management.
    fn around_name(self) -> (&'static str, &'static str) {
        match self {
            Self::LabelJob => ("/manage/label/", "/job"),
            Self::ManageNode => ("/manage/node/", ""),
            Self::Links => ("/manage/link/", ""),
            Self::Keep(Kind::Template) => ("/manage/template/", ""),
            Self::Keep(Kind::Schedule) => ("/manage/schedule/", ""),
            _ => ("/manage/job/", ""),
        }
    }

    /// Returns the name chunk of a key of this kind; `None`: it only includes such keys.
    fn name<'k>(self, keys: &Keys, key: &'k str) -> Option<&'k str> {
        if matches!(
            self,
            Self::LabelJob | Self::ManageNode | Self::ManageJob | Self::Links | Self::Keep(_)
        ) {
            let (before, behind) = self.around_name();
            let name = key.strip_prefix(keys.prefix())?.strip_prefix(before)?;
            let name = name.strip_suffix(behind)?;
            return (!name.contains('/') && name != "**").then_some(name);
        }
        let name = match (self, keys.parse(key)?) {
            (Self::Node(declared), Topic::Node { node, topic }) if topic == declared => node,
            (Self::GroupJob, Topic::GroupJob { group }) => group,
            (Self::Job, Topic::Job { job }) | (Self::JobCancel, Topic::JobCancel { job }) => job,
            _ => return None,
        };
        (name != "**").then_some(name)
    }
}

/// Sorts what comes through one door.
pub(super) struct Ear {
    door: Door,
    inbox: Inbox,
    clock: WallClock,
    keys: Keys,
    gets: Arc<Gets>,
}

impl Ear {
    /// Listens at this door.
    pub(super) fn new(
        door: Door,
        inbox: &Inbox,
        clock: WallClock,
        keys: &Keys,
        gets: &Arc<Gets>,
    ) -> Self {
        Self {
            door,
            inbox: inbox.clone(),
            clock,
            keys: keys.clone(),
            gets: Arc::clone(gets),
        }
    }

    /// Takes a put.
    pub(super) fn put(&self, sample: &Sample) {
        let at = self.clock.now();
        let key = sample.key_expr().as_str();
        if self.door == Door::Node(NodeTopic::Stop) {
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

/// Returns whom a stop means. A key that includes stop keys without being one (`fleet/**`) means
/// all nodes, or those of its name chunk, also when the prefix is wild (`plant/*/node/left/stop`): what
/// nodes hear, the gateway must not miss.
fn stop_pattern(keys: &Keys, key: &str) -> String {
    let name = key
        .strip_prefix(keys.prefix())
        .and_then(|rest| rest.strip_prefix("/node/"))
        .and_then(|rest| rest.split('/').next());
    let of_any_prefix = || {
        let (_, name) = key.strip_suffix("/stop")?.rsplit_once("/node/")?;
        (!name.contains('/')).then_some(name)
    };
    match name.or_else(of_any_prefix) {
        Some(name) if !name.contains("**") => name.to_owned(),
        _ => "*".to_owned(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_stop_on_a_wide_key_means_whom_the_key_includes() {
        let keys = Keys::default();
        assert_eq!(stop_pattern(&keys, "fleet/node/left/stop"), "left");
        assert_eq!(stop_pattern(&keys, "fleet/node/cell-$*/stop"), "cell-$*");
        assert_eq!(stop_pattern(&keys, "fleet/node/left/**"), "left");
        assert_eq!(stop_pattern(&keys, "fleet/node/**"), "*");
        assert_eq!(stop_pattern(&keys, "**/stop"), "*");
        let keys = Keys::new("plant/line-a").expect("legal");
        assert_eq!(stop_pattern(&keys, "plant/*/node/*/stop"), "*");
        assert_eq!(stop_pattern(&keys, "plant/*/node/left/stop"), "left");
        assert_eq!(stop_pattern(&keys, "plant/**/node/l$*/stop"), "l$*");
        assert_eq!(stop_pattern(&keys, "plant/*/node/**/stop"), "*");
    }

    #[test]
    fn only_a_key_of_its_own_kind_gives_a_door_a_name() {
        let keys = Keys::default();
        let job = Door::Node(NodeTopic::Job);
        assert_eq!(job.name(&keys, "fleet/node/left/job"), Some("left"));
        assert_eq!(job.name(&keys, "fleet/node/cell-$*/job"), Some("cell-$*"));
        for wide in [
            "fleet/**",
            "fleet/node/**",
            "fleet/node/**/job",
            "fleet/node/left/*",
        ] {
            assert_eq!(job.name(&keys, wide), None, "{wide}");
        }
        assert_eq!(Door::Job.name(&keys, "fleet/job/*"), Some("*"));
        assert_eq!(Door::Job.name(&keys, "fleet/job/**"), None);
        assert_eq!(Door::JobCancel.name(&keys, "fleet/job/**"), None);
        assert_eq!(Door::JobCancel.name(&keys, "fleet/job/a/cancel"), Some("a"));
    }

    #[test]
    fn a_door_hears_its_own_keys() {
        let keys = Keys::default();
        for door in [
            Door::Node(NodeTopic::Job),
            Door::GroupJob,
            Door::Job,
            Door::JobCancel,
            Door::LabelJob,
            Door::ManageNode,
            Door::ManageJob,
        ] {
            assert_eq!(door.name(&keys, &door.key(&keys)), Some("*"), "{door:?}");
        }
    }
}
