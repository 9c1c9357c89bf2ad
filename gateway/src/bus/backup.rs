//! A copy of the store for whoever may have it: a get on `PREFIX/store/backup`.
//!
//! The copy is sent by a thread of its own, in the order of its pieces, with the priority of the get;
//! a client that asks with the lowest one is behind everything else in its link. A client that takes
//! nothing loses its link after [`STALLED_PEER_US`](crate::config::STALLED_PEER_US), as any other.

use super::{busy, gets::refuse};
use crate::journal::copy::Copier;
use keys::record::{ErrorCode, JobError};
use std::sync::{
    Arc,
    atomic::{AtomicBool, Ordering},
};
use zenoh::{Wait, bytes::Encoding, query::Query};

/// The key behind the prefix.
pub const BACKUP: &str = "store/backup";

/// Answers such gets.
pub(super) struct Backup {
    key: String,
    copier: Copier,
    is_busy: Arc<AtomicBool>,
}

impl Backup {
    pub(super) fn new(key: String, copier: Copier) -> Self {
        Self {
            key,
            copier,
            is_busy: Arc::default(),
        }
    }

    /// Begins a copy, unless one is under way. Never waits.
    pub(super) fn answer(&self, query: Query) {
        // A tool that looks at everything must not carry the whole store away.
        if query.key_expr().as_str() != self.key {
            return;
        }
        if self.is_busy.swap(true, Ordering::AcqRel) {
            return refuse(&query, busy());
        }
        let (key, copier) = (self.key.clone(), self.copier.clone());
        let is_busy = Arc::clone(&self.is_busy);
        let thread = std::thread::Builder::new().name("gateway-backup".to_owned());
        let begun = thread.spawn(move || {
            send(&query, &key, &copier);
            is_busy.store(false, Ordering::Release);
        });
        if let Err(error) = begun {
            tracing::error!("no thread for a backup: {error}");
            self.is_busy.store(false, Ordering::Release);
        }
    }
}

fn send(query: &Query, key: &str, copier: &Copier) {
    let mut sent = 0_usize;
    let copied = copier.copy(|piece| {
        let bytes = piece.encode();
        sent += bytes.len();
        let reply = query
            .reply(key, bytes)
            .encoding(Encoding::APPLICATION_OCTET_STREAM.with_schema("postcard"))
            .wait();
        if let Err(error) = &reply {
            tracing::debug!("a client left before its backup: {error}");
        }
        reply.is_ok()
    });
    match copied {
        Ok(()) => tracing::info!(bytes = sent, "a backup was sent"),
        Err(error) => {
            tracing::error!("no backup, the store cannot be read: {error}");
            let message = "the store cannot be read";
            refuse(query, JobError::new(ErrorCode::Internal, message));
        }
    }
}
