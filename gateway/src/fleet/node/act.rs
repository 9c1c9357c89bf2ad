//! What is due: silences and deadlines, what must be said until it is heard, the next job, its
//! batches, and clock probes. Owns all of a node's timers.

use super::{Node, PROBES_MAX, Released, Repeat, Turn, Twin};
use crate::{
    fleet::{
        FleetConfig,
        event::{Effect, Lane, Table, Write},
        route::Route,
        submit::check_script,
    },
    job::{Activation, Change, Ending, Job, book::Book},
    security::signing::Signed,
};
use keys::{
    FleetMicros, JobId, NodeTopic, Order, Stop, StopMode,
    batch::ORDER_BYTES_MAX,
    clock::{ClockMessage, ClockProbe},
    record::{ErrorCode, JobError, JobState, to_json},
};

impl Node {
    /// Does everything that is due and possible now.
    pub(in crate::fleet) fn poll(&mut self, turn: &mut Turn<'_>) {
        self.watch_silence(turn);
        self.watch_twin(turn);
        self.watch_deadline(turn);
        if self.alive {
            self.say_stop(turn);
            self.say_cancel(turn);
            self.say_release(turn);
            self.say_pace(turn);
            self.start_next(turn);
            self.say_batches(turn);
            self.say_probe(turn);
        }
        self.tell(turn);
    }

    /// Returns when [`Node::poll`] is due.
    pub(in crate::fleet) fn poll_timeout(
        &self,
        book: &Book,
        config: &FleetConfig,
    ) -> Option<FleetMicros> {
        let active = self.active.and_then(|id| book.part(&id, self.id));
        let silence = (self.alive || active.is_some_and(|job| job.state() != JobState::Lost))
            .then(|| self.heard_at.plus_us(config.silence_us));
        let deadline = active.and_then(Job::deadline);
        let tell = self
            .stale_record
            .then(|| self.told_at.plus_us(config.node_record_us));
        let twin = self
            .twin
            .map(|twin| twin.last_at.plus_us(config.silence_us));
        let always = [silence, deadline, tell, twin];
        let next = self.next_at;
        let here = [
            self.facts.pending_stop.and(self.stop.send_at),
            self.facts.drop_queue.and(self.cancel.send_at),
            self.release
                .as_ref()
                .map(|wish| wish.send_at.min(wish.give_up_at)),
            self.route.as_ref().and_then(Route::poll_timeout),
            self.pace_timeout(),
            Some(self.probe_at.unwrap_or(FleetMicros(0))),
            next,
        ];
        let here = here.into_iter().filter(|_| self.alive);
        always.into_iter().chain(here).flatten().min()
    }

    fn watch_silence(&mut self, turn: &mut Turn<'_>) {
        if turn.now.since_us(self.heard_at) < turn.config.silence_us {
            return;
        }
        if self.alive {
            self.go_offline(turn);
        } else {
            // After a start of the gateway, a node that does not come back.
            self.lose_active(turn);
        }
    }

    /// The other controller of this name has gone.
    fn watch_twin(&mut self, turn: &Turn<'_>) {
        let gone = |twin: &Twin| turn.now.since_us(twin.last_at) >= turn.config.silence_us;
        if self.twin.as_ref().is_some_and(gone) {
            self.twin = None;
            self.stale_record = true;
        }
    }

    pub(super) fn go_offline(&mut self, turn: &mut Turn<'_>) {
        self.alive = false;
        self.stale_record = true;
        self.stop_route();
        self.clock.forget();
        self.probe_at = None;
        self.probes.clear();
        self.cancel = Repeat::default();
        self.stop = Repeat::default();
        if let Some(status) = &self.status {
            self.facts.position_steps =
                status.axes.iter().map(|axis| axis.position_steps).collect();
        }
        self.store(turn);
        self.lose_active(turn);
        self.forget_pace();
        self.refuse_wish(ErrorCode::NodeOffline, "the node went away", turn);
        if let Some(wish) = self.release.take() {
            for to in wish.waiters {
                let error = JobError::new(ErrorCode::NodeOffline, "the node went away");
                turn.released.push(Released::refused(to, error));
            }
        }
    }

    fn lose_active(&mut self, turn: &mut Turn<'_>) {
        let Some(id) = self.active else { return };
        let Some(job) = turn.book.part(&id, self.id) else {
            return;
        };
        if job.state() != JobState::Lost {
            let done = job.done_of(self.executed);
            let change = Change::to(JobState::Lost).done(done);
            turn.book
                .change(&id, self.id, change, turn.now, turn.effects);
        }
    }

    fn watch_deadline(&mut self, turn: &mut Turn<'_>) {
        let due = self
            .active
            .and_then(|id| turn.book.part(&id, self.id))
            .and_then(Job::deadline)
            .is_some_and(|deadline| turn.now >= deadline);
        if due {
            self.end_active(Ending::Timeout, StopMode::Decelerate, turn);
        }
    }

    fn say_stop(&mut self, turn: &mut Turn<'_>) {
        let Some(mode) = self.facts.pending_stop else {
            return;
        };
        if self.stop.take(turn.now, turn.config.stop_repeat_us) {
            let payload = Stop { mode }.to_payload().to_vec();
            turn.publish(&self.id, NodeTopic::Stop, payload, Lane::RealTime);
        }
    }

    fn say_cancel(&mut self, turn: &mut Turn<'_>) {
        let Some(queue) = self.facts.drop_queue else {
            return;
        };
        if self.cancel.take(turn.now, self.round_trip.retry_us()) {
            let mode = if self.facts.drop_halts {
                StopMode::Halt
            } else {
                StopMode::Decelerate
            };
            self.order(&Order::Cancel { queue, mode }, turn);
        }
    }

    fn say_release(&mut self, turn: &mut Turn<'_>) {
        let Some(wish) = &mut self.release else {
            return;
        };
        if turn.now >= wish.give_up_at {
            let wish = self.release.take().expect("it was just there");
            let message = "the node stays stopped: its stop input is active, or it is still \
                           coming to rest";
            self.refuse_release(wish, message, turn);
            return;
        }
        if turn.now < wish.send_at {
            return;
        }
        wish.send_at = turn.now.plus_us(self.round_trip.retry_us());
        if self.facts.latch.is_some() {
            let queue = self.facts.queue;
            self.order(&Order::Release { queue }, turn);
        }
    }

    pub(super) fn order(&self, order: &Order, turn: &mut Turn<'_>) {
        let mut buffer = [0; ORDER_BYTES_MAX];
        let bytes = keys::version::encode(order, &mut buffer)
            .expect("an order without commands is shorter than any with them");
        turn.tell(&self.facts, &self.id, NodeTopic::Batch, bytes, Lane::Order);
    }

    /// Sends the next job on its way, if nothing is outstanding.
    fn start_next(&mut self, turn: &mut Turn<'_>) {
        let open = self.active.is_none()
            && !self.is_stopped()
            && self.facts.drop_queue.is_none()
            && self.status.is_some()
            && self.facts.maintenance.is_none()
            && !self.facts.queue_held
            // Nobody knows which of two machines would move, and which gateway moves this one.
            && !self.has_twin()
            && !self.is_disobedient()
            && self.executed >= self.accepted;
        self.next_at = None;
        if !open {
            return;
        }
        while let Some(id) = self.take_ready(turn) {
            let Some(job) = turn.book.part(&id, self.id) else {
                continue;
            };
            // The firmware may have changed while the job waited.
            let own = job.commands.get(job.head_commands as usize..);
            let synchronized = job.entry.record.group.is_some();
            let scripts = match &job.script {
                Some(_) => check_script(self.facts.features),
                None => Ok(()),
            };
            let checked = self.check(own.unwrap_or_default(), synchronized);
            if let Err(error) = scripts.and(checked) {
                let change = Change::to(JobState::Failed).error(error);
                turn.book
                    .change(&id, self.id, change, turn.now, turn.effects);
                continue;
            }
            let activation = Activation {
                queue: self.facts.queue,
                base: self.accepted,
                at: turn.now,
            };
            let script = job.script.clone();
            let end = activation.base + job.commands.len() as u64 + u64::from(script.is_some());
            turn.book.prepare(&id, self.id, |part| {
                part.entry.activation = Some(activation);
            });
            let change = Change::to(JobState::Sent);
            turn.book
                .change(&id, self.id, change, turn.now, turn.effects);
            self.active = Some(id);
            self.stale_record = true;
            let window_batches = turn.config.window_batches;
            let (queue, base) = (activation.queue, activation.base);
            let route = Route::new(id, queue, base, end, window_batches, self.round_trip);
            let signed = turn.book.part(&id, self.id).and_then(Signed::of);
            self.route = Some(route.with_script(script).with_signature(signed));
            return;
        }
    }

    /// Takes the first job that waits and may begin.
    fn take_ready(&mut self, turn: &Turn<'_>) -> Option<JobId> {
        let mut first = None;
        for (index, id) in self.waiting.iter().enumerate() {
            let job = turn.book.part(id, self.id);
            match job.and_then(|job| job.entry.turn.not_before) {
                Some(at) if at > turn.now => {
                    first = Some(first.map_or(at, |first: FleetMicros| first.min(at)));
                }
                _ => return self.waiting.remove(index),
            }
        }
        self.next_at = first;
        None
    }

    fn say_batches(&mut self, turn: &mut Turn<'_>) {
        let Some(route) = &mut self.route else { return };
        let Some(job) = self.active.and_then(|id| turn.book.part(&id, self.id)) else {
            return;
        };
        let key = turn.config.keys.node(&self.id, NodeTopic::Batch);
        let effects = &mut *turn.effects;
        let (facts, epoch) = (&self.facts, turn.config.epoch);
        route.poll(&job.commands, self.limit, turn.now, |bytes| {
            effects.push(Effect::Publish {
                key: key.as_str().to_owned(),
                payload: facts.with_epoch(epoch, bytes),
                json: false,
                lane: Lane::Order,
            });
        });
    }

    fn say_probe(&mut self, turn: &mut Turn<'_>) {
        let period_us = self.clock.probe_period_us().max(turn.probe_us_min);
        // Who was probed seldom may have become one that is soon to start with others.
        let soon = turn.now.plus_us(period_us);
        self.probe_at = self.probe_at.map(|at| at.min(soon));
        if !turn.may_probe || self.probe_at.is_some_and(|at| turn.now < at) {
            return;
        }
        turn.may_probe = false;
        let probe = ClockProbe {
            probe: self.next_probe,
            sent_at: turn.now,
        };
        self.next_probe = self.next_probe.wrapping_add(1);
        if self.probes.len() == PROBES_MAX {
            self.probes.pop_front();
        }
        self.probes.push_back((probe.probe, probe.sent_at));
        self.probe_at = Some(soon);
        let mut buffer = [0; 64];
        let bytes = keys::version::encode(&ClockMessage::Probe(probe), &mut buffer)
            .expect("a probe has at most 17 bytes");
        turn.tell(
            &self.facts,
            &self.id,
            NodeTopic::Clock,
            bytes,
            Lane::RealTime,
        );
    }

    pub(super) fn store(&mut self, turn: &mut Turn<'_>) {
        if self.stored.as_ref() == Some(&self.facts) {
            return;
        }
        turn.effects.push(Effect::Persist(Write::Put {
            table: Table::Nodes,
            key: self.id.to_string(),
            value: to_json(&self.facts),
        }));
        self.stored = Some(self.facts.clone());
    }
}
