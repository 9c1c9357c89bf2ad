//! Orders of the gateway, each taken whole or not at all.
//!
//! Commands are numbered, so what becomes of a batch follows from two numbers: what it begins
//! with and what the node has.
//!
//! ```text
//!   node has        0 ─────────────── accepted
//!   Duplicate             first ── end
//!   Overlap                     first ── ── end
//!   taken                             first ──── end
//!   Gap                                    first ──── end
//! ```
//!
//! Before that: older gateway → `Superseded`, other queue → `Stale`, stop → `Stopped`. After it: every command is read and
//! checked (`Malformed`, `BadCommand`, `OutOfReach`), then `QueueShort`, and only then the first one is written
//! to the ring. So a refused batch leaves no trace in it.

use crate::{Node, Outputs, limits::CREDIT_SHARE, signed::Ends, stop::Phase, trace::Event};
use keys::{
    BatchAck, BatchHeader, BatchReader, JobId, LocalMicros, Order, QueueId, Refusal, StopMode,
    StopReason, Verdict,
    batch::{BATCH_COMMANDS_MAX, ORDER_BYTES_MAX},
    signed::Proof,
};
use motion::StepBackend;

/// The job whose commands were accepted last.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct CurrentJob {
    pub(crate) id: JobId,
    /// Number after its last command in this queue.
    pub(crate) end: u64,
}

impl<B: StepBackend, O: Outputs> Node<'_, B, O> {
    /// Takes an order and returns what became of it.
    pub(crate) fn take_order(
        &mut self,
        payload: Result<&[u8], Refusal>,
        now: LocalMicros,
    ) -> Verdict {
        let verdict = match payload {
            Ok(payload) => self.order(payload, now),
            Err(refusal) => Verdict::Refused(refusal),
        };
        match verdict {
            Verdict::Refused(refusal) => self.trace.note(now, Event::Refused(refusal)),
            Verdict::Duplicate => self.trace.note(now, Event::Duplicate),
            Verdict::Accepted | Verdict::Credit => {}
        }
        verdict
    }

    fn order(&mut self, payload: &[u8], now: LocalMicros) -> Verdict {
        let Ok((proof, payload)) = Proof::split(payload) else {
            return Verdict::Refused(Refusal::Malformed);
        };
        let proof = proof.as_ref();
        if payload.len() > ORDER_BYTES_MAX {
            return Verdict::Refused(Refusal::Malformed);
        }
        let Ok(reader) = BatchReader::new(payload) else {
            return Verdict::Refused(Refusal::Malformed);
        };
        match *reader.order() {
            Order::Batch(header) => self
                .batch(header, reader, proof, now)
                .unwrap_or_else(Verdict::Refused),
            Order::Cancel { queue, mode } => self.cancel(queue, mode, now),
            Order::Release { queue } => self.release(queue, now),
            Order::Script(header) => self
                .take_script(header, reader.rest(), proof, now)
                .unwrap_or_else(Verdict::Refused),
            Order::ScriptSeen {
                queue,
                first_command,
            } => self.take_script_seen(queue, first_command),
        }
    }

    fn batch(
        &mut self,
        header: BatchHeader,
        reader: BatchReader<'_>,
        proof: Option<&Proof>,
        now: LocalMicros,
    ) -> Result<Verdict, Refusal> {
        let count = usize::from(header.command_count);
        let end = header
            .first_command
            .checked_add(u64::from(header.command_count))
            .filter(|end| *end <= header.job_end)
            .filter(|_| (1..=BATCH_COMMANDS_MAX).contains(&count))
            .ok_or(Refusal::Malformed)?;
        self.demand_open(header.queue)?;
        let accepted = self.motion.accepted_commands();
        if end <= accepted {
            return Ok(Verdict::Duplicate);
        }
        if header.first_command < accepted {
            return Err(Refusal::Overlap);
        }
        if header.first_command > accepted {
            return Err(Refusal::Gap);
        }
        if self.script.is_running() {
            return Err(Refusal::ScriptRuns);
        }
        let mut check = reader.clone();
        let bytes = reader.rest();
        let mut ends = Ends::new();
        let mut outlook = self.motion.outlook();
        for index in 0..header.command_count {
            let command = check
                .next_command()
                .ok()
                .flatten()
                .ok_or(Refusal::Malformed)?;
            // Both fit: a batch has at most so many commands and so many bytes.
            let _ = ends.push((bytes.len() - check.rest().len()) as u16);
            self.motion
                .check(&command)
                .map_err(|_| Refusal::BadCommand { index })?;
            let Some(outlook) = outlook.as_mut() else {
                continue;
            };
            if let Err(error) = self.motion.check_reach(outlook, &command) {
                let number = header.first_command + u64::from(index);
                self.log(now, format_args!("command {number}: {error}"));
                return Err(Refusal::OutOfReach { index });
            }
        }
        if check.next_command().is_err() {
            return Err(Refusal::Malformed);
        }
        let (signers, name) = (&self.config.signers, &self.config.name);
        let signed = self
            .signed
            .check_commands(signers, name, proof, &header, bytes, &ends)?;

        let mut reader = reader;
        let mut reservation = self
            .motion
            .reserve(count)
            .map_err(|_| Refusal::QueueShort)?;
        while let Ok(Some(command)) = reader.next_command() {
            reservation.push(&command);
        }
        reservation.commit();
        self.signed.advance(&self.config.signers, signed);
        self.motion.expect_more(header.job_end);
        let job = CurrentJob {
            id: header.job,
            end: header.job_end,
        };
        if self.job != Some(job) {
            let begins = self.job() != Some(job.id);
            self.watch_pulses();
            self.job = Some(job);
            if begins {
                self.begin_job(header.first_command, header.job_end, now);
            }
            self.status_due = true;
        }
        self.trace.note(
            now,
            Event::BatchTaken {
                command_count: header.command_count,
            },
        );
        Ok(Verdict::Accepted)
    }

    /// Demands that commands for this queue may come.
    pub(crate) fn demand_open(&self, queue: QueueId) -> Result<(), Refusal> {
        if queue != self.queue {
            return Err(Refusal::Stale);
        }
        match self.phase {
            Phase::Open => Ok(()),
            // The queue is on its way out; the one after it is open.
            Phase::Stopping {
                reason: StopReason::Cancel,
                ..
            } => Err(Refusal::Stale),
            Phase::Stopping { .. } | Phase::Latched { .. } => Err(Refusal::Stopped),
        }
    }

    fn cancel(&mut self, queue: QueueId, mode: StopMode, now: LocalMicros) -> Verdict {
        if queue != self.queue {
            // A queue of this boot that is over: the cancel, or something like it, was carried out.
            let over = queue.boot == self.queue.boot && queue.flush < self.queue.flush;
            return if over {
                Verdict::Duplicate
            } else {
                Verdict::Refused(Refusal::Stale)
            };
        }
        match self.phase {
            Phase::Open => {
                self.begin_stop(StopReason::Cancel, mode, now);
                Verdict::Accepted
            }
            Phase::Stopping { .. } => {
                // Nothing is dropped twice, but a halt is still harder than a deceleration.
                self.begin_stop(StopReason::Cancel, mode, now);
                Verdict::Duplicate
            }
            Phase::Latched { .. } => Verdict::Refused(Refusal::Stopped),
        }
    }

    fn release(&mut self, queue: QueueId, now: LocalMicros) -> Verdict {
        if queue != self.queue {
            return Verdict::Refused(Refusal::Stale);
        }
        match self.phase {
            Phase::Open => Verdict::Duplicate,
            // The queue that begins with this stop does not exist yet, so this is an older release.
            Phase::Stopping { .. } => Verdict::Refused(Refusal::Stopped),
            Phase::Latched { .. } if self.stop_pin_active => Verdict::Refused(Refusal::Stopped),
            Phase::Latched { .. } => {
                self.phase = Phase::Open;
                self.motion.reset_shift();
                self.status_due = true;
                self.trace.note(now, Event::Released);
                self.log(now, format_args!("released"));
                Verdict::Accepted
            }
        }
    }

    /// Queues the answer to an order, or a credit. Without a link there is nobody to tell.
    pub(crate) fn acknowledge(&mut self, verdict: Verdict, now: LocalMicros) {
        if !self.link_up() {
            return;
        }
        let credit = self.motion.credit_commands();
        self.credit_told = credit;
        let overtaken = self.outbox.push_ack(BatchAck {
            queue: self.queue,
            verdict,
            accepted_commands: self.motion.accepted_commands(),
            executed_commands: self.motion.executed_commands(),
            credit_commands: u32::try_from(credit).unwrap_or(u32::MAX),
        });
        if overtaken {
            self.trace.note(now, Event::ReplyDropped);
        }
    }

    /// Tells the credit unasked when much room has become free and the job has more to send.
    pub(crate) fn tell_credit(&mut self, now: LocalMicros) {
        let more_to_come = self
            .job
            .is_some_and(|job| self.motion.accepted_commands() < job.end)
            && !self.script.is_running();
        let grown = self
            .motion
            .credit_commands()
            .saturating_sub(self.credit_told);
        let share = self.ring_commands.div_ceil(CREDIT_SHARE);
        if more_to_come && self.phase == Phase::Open && grown >= share {
            self.acknowledge(Verdict::Credit, now);
        }
    }
}
