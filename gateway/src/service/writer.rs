//! The thread that has the store: commits what has gathered, then lets out what waited for it.

use super::BATCHES_PER_COMMIT_MAX;
use crate::{
    bus::{store_failed, zenoh::Bus},
    fleet::event::Effect,
    journal::{Journal, JournalError},
    observe,
};
use metrics::{counter, gauge, histogram};
use std::{
    sync::{
        Arc,
        atomic::{AtomicBool, Ordering},
    },
    time::Instant,
};
use tokio::sync::{mpsc, watch};

/// The effects of one handled event that go through the writer.
pub(super) type EffectBatch = Vec<Effect>;

pub(super) struct Writer {
    pub(super) journal: Journal,
    pub(super) bus: Arc<Bus>,
    pub(super) batches: mpsc::Receiver<EffectBatch>,
    pub(super) store_failed: Arc<AtomicBool>,
    pub(super) failed: watch::Sender<bool>,
}

impl Writer {
    /// Works until all who give effects are gone.
    pub(super) fn run(mut self) -> Result<(), JournalError> {
        let mut first_error = None;
        let mut writes = Vec::new();
        let mut others = Vec::new();
        while let Some(mut batch) = self.batches.blocking_recv() {
            let mut batch_count = 1;
            loop {
                for effect in batch {
                    match effect {
                        Effect::Persist(write) => writes.push(write),
                        other => others.push(other),
                    }
                }
                if batch_count == BATCHES_PER_COMMIT_MAX {
                    break;
                }
                match self.batches.try_recv() {
                    Ok(next) => batch = next,
                    Err(_) => break,
                }
                batch_count += 1;
            }
            gauge!(observe::STORE_WAITING).set(self.batches.len() as f64);
            counter!(observe::STORE_WRITES).increment(writes.len() as u64);
            let begun = Instant::now();
            if first_error.is_none()
                && !writes.is_empty()
                && let Err(error) = self.journal.commit(&writes)
            {
                tracing::error!("the store failed: {error}");
                self.store_failed.store(true, Ordering::Release);
                self.failed.send_replace(true);
                first_error = Some(error);
            }
            if !writes.is_empty() {
                histogram!(observe::STORE_COMMIT).record(begun.elapsed());
            }
            writes.clear();
            for effect in others.drain(..) {
                self.carry_out(effect, first_error.is_some());
            }
        }
        first_error.map_or(Ok(()), Err)
    }

    /// Lets one effect out. After a failure of the store: none, and each get gets the refusal.
    fn carry_out(&self, effect: Effect, failed: bool) {
        match effect {
            Effect::Persist(_) => unreachable!("writes are set apart before"),
            Effect::Publish {
                key,
                payload,
                json,
                lane,
            } => {
                if !failed {
                    self.bus.publish(&key, payload, json, lane);
                }
            }
            Effect::Reply { to, .. } if failed => self.bus.refuse(to, store_failed()),
            Effect::Reply { to, key, payload } => self.bus.reply(to, key.as_deref(), payload),
            Effect::ReplyEnd { to } => self.bus.end(to),
        }
    }
}
