//! Gets that wait for replies; each is ended exactly once, by the last reply, a refusal or the end of the
//! service. What each client has asked for is counted here, too.

use super::{
    GETS_OPEN_MAX, busy,
    limits::{Admission, Client, ClientLimits, Limits},
    too_often,
};
use crate::fleet::event::ReplyTo;
use keys::{
    FleetMicros, NodeId,
    record::{ErrorReply, JobError, to_json},
};
use std::{
    collections::HashMap,
    sync::{
        Mutex, MutexGuard, PoisonError,
        atomic::{AtomicU64, Ordering},
    },
};
use zenoh::{Wait, bytes::Encoding, key_expr::keyexpr, query::Query};

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
    pub(super) fn hear(&self, node: NodeId, now: FleetMicros) -> bool {
        self.limits().hear(node, now)
    }

    /// Counts a request of the client that is calling.
    pub(super) fn count(&self, bytes: usize, now: FleetMicros) -> Admission {
        self.limits().admit(Client::of_this_call(), bytes, now)
    }

    /// Keeps a get until its end; `None`: there are too many, it has been told.
    pub(super) fn admit(&self, query: &Query, now: FleetMicros) -> Option<ReplyTo> {
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

/// Returns the key under which a record answers a get: its own, if the get's key includes it.
///
/// Zenoh carries only replies on keys that the get's includes. So a job's record answers a cancel
/// on the key of that job's cancel, and a node's record a release on that of the node's release.
/// A record that a wide get (`fleet/node/l*/**`) does not mean is left out.
pub(super) fn reply_key(asked: &keyexpr, key: &str) -> Option<String> {
    let verb = asked.as_str().rsplit('/').next().unwrap_or_default();
    let parent = key.rsplit_once('/').map_or(key, |(parent, _)| parent);
    // A label's nodes all answer on the one key of its jobs, which names none of them.
    let of_label = asked.as_str().contains("/manage/label/");
    [
        key.to_owned(),
        format!("{key}/{verb}"),
        format!("{parent}/{verb}"),
    ]
    .into_iter()
    .chain(of_label.then(|| asked.as_str().to_owned()))
    .find(|key| {
        keyexpr::new(key.as_str()).is_ok_and(|key| asked.intersects(key) && !key.contains('*'))
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_record_answers_on_a_key_that_was_asked_for() {
        let key = |asked: &str, key: &str| {
            reply_key(keyexpr::new(asked).expect("legal"), key).unwrap_or_default()
        };
        let job = "fleet/job/part-1";
        assert_eq!(key("fleet/job/*", job), job);
        assert_eq!(key("fleet/**", job), job);
        let cancel = "fleet/job/part-1/cancel";
        assert_eq!(key(cancel, job), cancel);
        assert_eq!(key("fleet/job/part-$*/cancel", job), cancel);
        assert_eq!(key("fleet/job/other/cancel", job), "");
        let state = "fleet/node/left/state";
        let release = "fleet/node/left/release";
        assert_eq!(key(release, state), release);
        assert_eq!(key("fleet/node/*/release", state), release);
        assert_eq!(key("fleet/node/r$*/**", state), "");
    }
}
