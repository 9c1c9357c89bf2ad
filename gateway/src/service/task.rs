//! The task that owns the fleet: it takes what comes, lets time pass, and hands on what follows.

use super::{observer::Question, writer::EffectBatch};
use crate::{
    bus::{Arrived, WallClock, store_failed, urgent::Intake, zenoh::Bus},
    fleet::{
        Fleet,
        event::{Effect, Event, Lane, ReplyTo},
    },
    observe::{self, Snapshot},
    service::Remaining,
    spans::JobSpans,
};
use keys::{FleetMicros, Keys};
use metrics::counter;
use std::{
    sync::{
        Arc,
        atomic::{AtomicBool, Ordering},
    },
    time::Duration,
};
use tokio::sync::{mpsc, watch};

pub(super) struct FleetTask {
    pub(super) fleet: Fleet,
    pub(super) clock: WallClock,
    pub(super) bus: Arc<Bus>,
    pub(super) batches: mpsc::Sender<EffectBatch>,
    pub(super) store_failed: Arc<AtomicBool>,
    pub(super) spans: JobSpans,
    pub(super) keys: Keys,
}

impl FleetTask {
    pub(super) async fn run(
        mut self,
        mut events: Intake,
        mut asked: mpsc::Receiver<Question>,
        mut stopping: watch::Receiver<bool>,
    ) -> Remaining {
        loop {
            // First, so that a flood of events cannot keep time from passing.
            let due_in = self.due_in();
            if due_in == Some(Duration::ZERO) {
                self.handle(Event::Tick.into()).await;
                tokio::task::consume_budget().await;
            }
            let due = async {
                match self.due_in() {
                    Some(due_in) => tokio::time::sleep(due_in).await,
                    None => std::future::pending().await,
                }
            };
            let arrived = tokio::select! {
                biased;
                arrived = events.next() => arrived,
                _ = stopping.wait_for(|stop| *stop) => return Remaining::of(&self.fleet),
                Some(answer) = asked.recv() => {
                    // Whoever asked may have left.
                    let _ = answer.send(Snapshot::of(&self.fleet));
                    continue;
                }
                () = due => Event::Tick.into(),
            };
            self.handle(arrived).await;
        }
    }

    /// Returns how long nothing has to be done; zero: something is due.
    fn due_in(&self) -> Option<Duration> {
        let due = self.fleet.poll_timeout()?;
        Some(Duration::from_micros(due.since_us(self.clock.now())))
    }

    async fn handle(&mut self, arrived: Arrived) {
        if self.store_failed.load(Ordering::Acquire) {
            if let Some(reply) = reply_of(&arrived.event) {
                self.bus.refuse(reply, store_failed());
            }
            return;
        }
        let now: FleetMicros = arrived.at.unwrap_or_else(|| self.clock.now());
        let mut effects = Vec::new();
        self.fleet.handle(arrived.event, now, &mut effects);
        counter!(observe::EVENTS).increment(1);
        self.carry_out(effects).await;
    }

    /// Sends what overtakes everything and hands the rest to the writer.
    pub(super) async fn carry_out(&mut self, mut effects: Vec<Effect>) {
        effects.retain_mut(|effect| match effect {
            Effect::Publish {
                key,
                payload,
                lane: Lane::Record,
                ..
            } => {
                self.spans.published(&self.keys, key, payload);
                true
            }
            Effect::Publish {
                key,
                payload,
                json,
                lane: lane @ Lane::RealTime,
            } => {
                let payload = std::mem::take(payload);
                self.bus.publish(key, payload, *json, *lane);
                false
            }
            _ => true,
        });
        if !effects.is_empty() && self.batches.send(effects).await.is_err() {
            tracing::error!("the writer is gone");
        }
    }
}

/// Returns who waits for an answer to this.
fn reply_of(event: &Event) -> Option<ReplyTo> {
    match event {
        Event::Submit { reply, .. }
        | Event::SubmitGroup { reply, .. }
        | Event::Cancel { reply, .. }
        | Event::Release { reply, .. }
        | Event::Pace { reply, .. } => *reply,
        Event::GetJobs { reply, .. }
        | Event::GetNodes { reply, .. }
        | Event::GetLinks { reply, .. }
        | Event::ManageNodes { reply, .. }
        | Event::Keep { reply, .. }
        | Event::ManageJob { reply, .. } => Some(*reply),
        Event::SubmitWith { submit, .. } => reply_of(submit),
        Event::Stop { .. } | Event::Alive { .. } | Event::FromNode { .. } | Event::Tick => None,
    }
}
