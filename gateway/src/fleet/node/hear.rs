//! What a node says: its status, its answers to orders, its clock replies, and the end of its
//! liveliness token. Owns the decision which of it is news, and every outcome of a job.

use super::{Node, REPLACED_BOOTS_MAX, SeenFault, TWIN_US, Turn, Twin};
use crate::{
    fleet::{
        clock::Stamps,
        route::{Route, Setback},
    },
    job::{Activation, Change, Ending, Job, ScriptEnd, Told, group::Passed},
    security::signing::Signed,
};
use keys::{
    BatchAck, FleetMicros, NodeState, Order, QueueId, Refusal, ScriptOutcome, ScriptReport, Status,
    StopMode, StopReason, StopReport, Verdict,
    clock::ClockReply,
    record::{ErrorCode, JobError, JobState},
    trace::TraceEvent,
};

impl Node {
    /// The liveliness token went.
    pub(in crate::fleet) fn handle_token_gone(&mut self, turn: &mut Turn<'_>) {
        if self.alive {
            self.go_offline(turn);
        }
    }

    /// The node tells of a job. What it tells before its first status, or of another boot, is nobody's.
    pub(in crate::fleet) fn handle_trace(&mut self, event: &TraceEvent, turn: &mut Turn<'_>) {
        if event.boot != self.facts.queue.boot || self.status.is_none() {
            return;
        }
        let next = self.next_event.filter(|(boot, _)| *boot == event.boot);
        let missed = next.map_or(0, |(_, number)| event.number.wrapping_sub(number));
        if missed > u32::MAX / 2 {
            // It was heard before.
            return;
        }
        self.next_event = Some((event.boot, event.number.wrapping_add(1)));
        let Some(job) = event.job else { return };
        let status_at = self.status.as_ref().map_or(event.at, |status| status.at);
        let at = self.fleet_from_local(event.at, status_at, turn.now);
        let told = Told {
            at,
            error_us: self.clock.estimate(at).map(|estimate| estimate.error_us),
            node: self.id,
            what: event.what,
            missed,
        };
        turn.book.note_told(&job, told, turn.effects);
    }

    /// A status arrived.
    pub(in crate::fleet) fn handle_status(&mut self, status: Status, turn: &mut Turn<'_>) {
        let Some(before) = self.place(&status, turn) else {
            return;
        };
        self.heard_at = turn.now;
        self.alive = true;
        self.stale_record = true;
        if before != Some(status.queue) {
            self.accepted = 0;
            self.executed = 0;
            self.limit = 0;
            self.stop_route();
            self.facts.queue = status.queue;
        }
        // What was to be dropped is over, perhaps since before the gateway came back.
        self.facts.drop_queue = self.facts.drop_queue.filter(|queue| *queue == status.queue);
        self.take_numbers(
            status.accepted_commands,
            status.executed_commands,
            status.credit_commands,
            turn.now,
        );
        self.note_faults(&status, turn.now);
        let same_queue = before.is_none_or(|queue| queue == status.queue);
        self.take_latch(&status, same_queue, turn);
        self.facts.features = status.features;
        self.facts.firmware = status.firmware;
        let axes = status.axes.iter().map(|axis| axis.position_steps);
        if self.stored.is_none() || self.facts.position_steps.len() != status.axes.len() {
            self.facts.position_steps = axes.collect();
        }
        self.status = Some(status);
        self.store(turn);
        self.note_script(turn);
        self.judge_active(turn);
    }

    /// A script's commands are counted as it queues them.
    fn note_script(&self, turn: &mut Turn<'_>) {
        let Some(id) = self.active else { return };
        let here = turn.book.part(&id, self.id).is_some_and(|part| {
            let queue = part.entry.activation.map(|activation| activation.queue);
            part.script.is_some() && queue == Some(self.facts.queue)
        });
        if here {
            let accepted = self.accepted;
            let edit = |part: &mut Job| part.note_accepted(accepted);
            turn.book.prepare(&id, self.id, edit);
        }
    }

    /// Decides whether a status is news. `None`: it is not. Else the queue that was known before.
    fn place(&mut self, status: &Status, turn: &Turn<'_>) -> Option<Option<QueueId>> {
        if self.stored.is_none() {
            return Some(None);
        }
        let known = self.facts.queue;
        let silent_us = turn.now.since_us(self.heard_at);
        if status.queue.boot != known.boot {
            let replaced = self.facts.replaced_boots.contains(&status.queue.boot);
            // Two controllers of one name, or a boot number that came twice: whoever speaks when
            // the other one has long been silent is believed.
            if replaced && silent_us < turn.config.silence_us {
                self.note_twin(status, turn.now);
                return None;
            }
            self.twin = None;
            self.disobeys_at = None;
            self.facts
                .replaced_boots
                .retain(|boot| *boot != status.queue.boot);
            if self.facts.replaced_boots.len() == REPLACED_BOOTS_MAX {
                self.facts.replaced_boots.pop_front();
            }
            self.facts.replaced_boots.push_back(known.boot);
            self.status = None;
            self.faults.clear();
            self.forget_pace();
            return Some(Some(known));
        }
        if status.queue.flush < known.flush {
            return None;
        }
        let older = self
            .status
            .as_ref()
            .is_some_and(|last| status.queue == known && status.at < last.at);
        // No message is late for that long: the node's clock was set back.
        if older && silent_us < turn.config.silence_us / 2 {
            return None;
        }
        Some(Some(known))
    }

    /// A boot that was replaced speaks: late, or because it is another controller.
    fn note_twin(&mut self, status: &Status, now: FleetMicros) {
        let known = self.twin.filter(|twin| twin.boot == status.queue.boot);
        let mut twin = known.unwrap_or(Twin {
            boot: status.queue.boot,
            first_at: now,
            first_local: status.at,
            last_at: now,
            certain: false,
        });
        twin.last_at = now;
        let lives = status.at.since_us(twin.first_local) >= TWIN_US / 2;
        if !twin.certain && lives && now.since_us(twin.first_at) >= TWIN_US {
            twin.certain = true;
            self.stale_record = true;
        }
        self.twin = Some(twin);
    }

    fn take_numbers(&mut self, accepted: u64, executed: u64, credit: u32, now: FleetMicros) {
        self.accepted = self.accepted.max(accepted);
        self.executed = self.executed.max(executed);
        // Room never shrinks: commands leave it only by being executed.
        self.limit = self.limit.max(accepted.saturating_add(u64::from(credit)));
        if let Some(route) = &mut self.route {
            route.handle_accepted(self.accepted, now);
        }
    }

    fn note_faults(&mut self, status: &Status, now: FleetMicros) {
        self.faults
            .retain(|seen| status.faults.contains(&seen.fault));
        for fault in &status.faults {
            if !self.faults.iter().any(|seen| seen.fault == *fault) {
                let at = self.fleet_from_local(fault.at, status.at, now);
                self.faults.push(SeenFault { fault: *fault, at });
            }
        }
        self.faults.sort_by_key(|seen| seen.fault.at);
    }

    /// Draws the conclusion for the active job from the last status.
    pub(super) fn judge_active(&mut self, turn: &mut Turn<'_>) {
        let Some(id) = self.active else { return };
        let (Some(job), Some(status)) = (turn.book.part(&id, self.id), &self.status) else {
            return;
        };
        let Some(Activation { queue, base, .. }) = job.entry.activation else {
            return;
        };
        let total = job.entry.record.progress.total;
        if queue != status.queue {
            let report = status.stop.clone();
            // A script that fails drops its queue; why it failed comes by itself.
            let failed = job.script.is_some() && job.entry.ending.is_none();
            let by_itself = report
                .as_ref()
                .is_some_and(|report| report.queue == queue && report.reason == StopReason::Cancel);
            if failed && by_itself && queue.boot == status.queue.boot {
                return;
            }
            let change = self.outcome_of_dropped(job, queue, report.as_ref());
            let passed = match report.filter(|report| report.queue == queue) {
                _ if job.passed == Passed::Yes => Passed::Yes,
                Some(report) if report.executed_commands > base => Passed::Yes,
                Some(_) => Passed::No,
                None => Passed::Unknown,
            };
            turn.book.prepare(&id, self.id, |part| part.passed = passed);
            self.finish_active(change, turn);
            return;
        }
        // Success needs the word that also tells the positions; an answer may have been quicker.
        if job.is_done(status.executed_commands) {
            let script_end = job.entry.script_end.clone();
            turn.book
                .prepare(&id, self.id, |part| part.passed = Passed::Yes);
            let change = Change::to(JobState::Succeeded)
                .done(total)
                .position(status.axes.iter().map(|axis| axis.position_steps))
                .returned(script_end);
            self.facts.position_steps = status.axes.iter().map(|a| a.position_steps).collect();
            self.finish_active(change, turn);
            return;
        }
        let script = job.script.clone();
        let done = job.done_of(self.executed);
        // A part waits at the barrier of its start until that is over.
        let begun = self.executed >= base + job.head_commands;
        let moving = begun && status.state == NodeState::Running && status.job == Some(id);
        let passed = begun && job.head_commands > 0;
        let state = if done > 0 || moving || passed || job.state() == JobState::Running {
            JobState::Running
        } else {
            JobState::Sent
        };
        let told = job.entry.record.progress.done;
        let progress_due =
            done > told && turn.now.since_us(job.progress_told_at) >= turn.config.progress_us;
        let resumable = job.entry.ending.is_none();
        let (before, end) = (job.state(), job.end().unwrap_or(base));
        if passed && job.passed != Passed::Yes {
            let edit = |part: &mut Job| part.passed = Passed::Yes;
            turn.book.prepare(&id, self.id, edit);
        }
        if state != before || progress_due {
            let change = Change::to(state).done(done);
            turn.book
                .change(&id, self.id, change, turn.now, turn.effects);
        } else {
            turn.book.note_done(&id, self.id, done);
        }
        if self.route.is_none() && resumable {
            let mut route = Route::new(
                id,
                queue,
                base,
                end,
                turn.config.window_batches,
                self.round_trip,
            );
            route.handle_accepted(self.accepted, turn.now);
            let signed = turn.book.part(&id, self.id).and_then(Signed::of);
            self.route = Some(route.with_script(script).with_signature(signed));
        }
    }

    /// The outcome of a job whose queue is over.
    fn outcome_of_dropped(&self, job: &Job, queue: QueueId, report: Option<&StopReport>) -> Change {
        let total = job.entry.record.progress.total;
        let report = report.filter(|report| report.queue == queue);
        let same_boot = queue.boot == self.facts.queue.boot;
        let done = match report {
            Some(report) => job.done_of(report.executed_commands),
            None => job.entry.record.progress.done,
        };
        let all = report.is_some_and(|report| job.is_done(report.executed_commands));
        let change = if all || (job.script.is_none() && done >= total) {
            Change::to(JobState::Succeeded)
        } else {
            match (&job.entry.ending, report) {
                (Some(ending), _) => ending.change(),
                (None, Some(report)) => {
                    let message = format!(
                        "stopped ({}); {done} of {total} commands were done",
                        report.reason.as_str()
                    );
                    let error = JobError::new(ErrorCode::Stopped, message);
                    Change::to(JobState::Failed).error(error)
                }
                (None, None) if same_boot => {
                    let message = format!(
                        "the node stopped more than once while it was not heard; \
                         {done} of {total} commands were done when last heard"
                    );
                    let error = JobError::new(ErrorCode::Stopped, message);
                    Change::to(JobState::Failed).error(error)
                }
                (None, None) => {
                    let message = format!(
                        "the node restarted; {done} of {total} commands were done when last heard"
                    );
                    let error = JobError::new(ErrorCode::NodeOffline, message);
                    Change::to(JobState::Failed).error(error)
                }
            }
        };
        let change = change.done(done);
        match report {
            Some(report) => change
                .position(report.positions_steps.iter().copied())
                .returned(job.entry.script_end.clone()),
            None => change,
        }
    }

    /// An answer to an order arrived.
    pub(in crate::fleet) fn handle_ack(&mut self, ack: &BatchAck, turn: &mut Turn<'_>) {
        // Only a status tells how a queue ended, so an answer of any other one says nothing.
        if !self.alive || ack.queue != self.facts.queue || self.status.is_none() {
            return;
        }
        self.heard_at = turn.now;
        self.stale_record = true;
        self.take_numbers(
            ack.accepted_commands,
            ack.executed_commands,
            ack.credit_commands,
            turn.now,
        );
        let Verdict::Refused(refusal) = ack.verdict else {
            if let Some(route) = &mut self.route {
                route.handle_part(turn.now);
            }
            return;
        };
        // Answers to another gateway's orders are heard here, too: that one is told of our epoch.
        if let Refusal::Superseded { epoch } = refusal {
            if epoch <= turn.config.epoch {
                return;
            }
            self.disobeys_at.get_or_insert(turn.now);
        }
        let Some(route) = &mut self.route else { return };
        match route.handle_refusal(refusal, ack.accepted_commands, turn.now) {
            Setback::None => {
                if refusal == Refusal::QueueShort && ack.accepted_commands == self.accepted {
                    self.limit = ack.accepted_commands + u64::from(ack.credit_commands);
                }
            }
            setback @ (Setback::BadCommand { index } | Setback::OutOfReach { index }) => {
                let what = match setback {
                    Setback::OutOfReach { .. } => "it leads an axis beyond its soft limit",
                    _ => "the node does not take it",
                };
                let part = self.active.and_then(|id| turn.book.part(&id, self.id));
                let head_commands = part.map_or(0, |part| part.head_commands);
                let message = match index.checked_sub(head_commands) {
                    Some(index) => format!("commands[{index}]: {what}"),
                    None => "the node does not take the barrier of the start".to_owned(),
                };
                let error = JobError::new(ErrorCode::BadCommand, message);
                self.end_active(Ending::Fail(error), StopMode::Decelerate, turn);
            }
            Setback::NotSigned => {
                let message = "the node executes only what an operator whom it knows has signed, \
                               and each job once; this one it does not";
                let error = JobError::new(ErrorCode::NotAllowed, message);
                self.end_active(Ending::Fail(error), StopMode::Decelerate, turn);
            }
            Setback::Malformed => {
                let message = "the node does not understand this gateway's orders; \
                               are their versions too far apart?";
                let error = JobError::new(ErrorCode::Internal, message);
                self.end_active(Ending::Fail(error), StopMode::Decelerate, turn);
            }
        }
    }

    /// The end of a script arrived. Once it is written down, the node may forget it.
    pub(in crate::fleet) fn handle_report(
        &mut self,
        report: &ScriptReport,
        text: &str,
        turn: &mut Turn<'_>,
    ) {
        let part = self
            .active
            .filter(|id| *id == report.job)
            .and_then(|id| turn.book.part(&id, self.id))
            .filter(|part| part.script.is_some());
        let mine = part
            .and_then(|part| Some((part.entry.activation?, part.head_commands)))
            .filter(|(activation, head_commands)| {
                activation.queue == report.queue
                    && activation.base + head_commands == report.first_command + 1
            });
        if let Some((activation, head_commands)) = mine {
            match report.outcome {
                ScriptOutcome::Returned => {
                    let end = report.end_command;
                    let script_end = ScriptEnd {
                        end,
                        returned: serde_json::from_str(text).ok(),
                    };
                    let total = end.saturating_sub(activation.base + head_commands);
                    let edit = |part: &mut Job| {
                        part.entry.record.progress.total = total;
                        part.entry.script_end = Some(script_end);
                    };
                    turn.book.edit(&report.job, self.id, edit, turn.effects);
                }
                ScriptOutcome::Failed => {
                    let message = format!("lua: {text}");
                    let error = JobError::new(ErrorCode::BadCommand, message);
                    self.end_active(Ending::Fail(error), StopMode::Decelerate, turn);
                }
            }
            self.judge_active(turn);
        }
        let seen = Order::ScriptSeen {
            queue: report.queue,
            first_command: report.first_command,
        };
        self.order(&seen, turn);
    }

    /// A clock reply arrived, and when.
    pub(in crate::fleet) fn handle_clock(&mut self, reply: ClockReply, arrived_at: FleetMicros) {
        let asked = (reply.probe, reply.sent_at);
        let Some(at) = self.probes.iter().position(|probe| *probe == asked) else {
            return;
        };
        self.probes.remove(at);
        if reply.boot != self.facts.queue.boot {
            return;
        }
        let stamps = Stamps {
            sent_at: reply.sent_at,
            received_at: reply.received_at,
            replied_at: reply.replied_at,
            back_at: arrived_at,
        };
        self.clock.observe(reply.boot, stamps);
    }
}
