//! What is told of a job while it happens: one event in each message on the key `trace`.
//!
//! Owns the queue of [`TOLD_EVENTS_MAX`] events, which outlives a broken link. Full: the new one is
//! dropped, and the gap in the numbers says so.

use crate::{Node, Outputs, limits::TOLD_EVENTS_MAX};
use alloc::collections::VecDeque;
use keys::{
    JobId, LocalMicros,
    trace::{TraceEvent, TraceWord},
};
use motion::{StepBackend, TICKS_PER_US, Ticks};

/// See the module.
#[derive(Debug, Default)]
pub(crate) struct Teller {
    /// At most [`TOLD_EVENTS_MAX`], which most nodes never have: so on the heap.
    events: VecDeque<TraceEvent>,
    number: u32,
    first_pulse_due: bool,
}

impl Teller {
    pub(crate) fn pop(&mut self) -> Option<TraceEvent> {
        self.events.pop_front()
    }
}

fn local(at: Ticks) -> LocalMicros {
    LocalMicros(at.0 / TICKS_PER_US)
}

impl<B: StepBackend, O: Outputs> Node<'_, B, O> {
    /// Tells that something happened at an instant that may have passed.
    pub(crate) fn tell_event(&mut self, at: LocalMicros, job: Option<JobId>, what: TraceWord) {
        let event = TraceEvent {
            boot: self.queue.boot,
            number: self.teller.number,
            at,
            job,
            what,
        };
        self.teller.number = self.teller.number.wrapping_add(1);
        // Full: the number says that one is missing.
        if self.teller.events.len() < TOLD_EVENTS_MAX {
            self.teller.events.push_back(event);
        }
    }

    /// Tells that something happened to the present job.
    pub(crate) fn tell_of_job(&mut self, at: LocalMicros, what: TraceWord) {
        self.tell_event(at, self.job(), what);
    }

    /// A job begins with this command of the queue and ends before that one.
    pub(crate) fn begin_job(&mut self, first_command: u64, end_command: u64, now: LocalMicros) {
        self.motion.watch(first_command, end_command);
        self.teller.first_pulse_due = true;
        self.tell_of_job(now, TraceWord::Taken);
    }

    /// Tells the first pulse once it has left.
    pub(crate) fn watch_pulses(&mut self) {
        if self.teller.first_pulse_due
            && let Some(at) = self.motion.first_edge_at()
        {
            self.teller.first_pulse_due = false;
            self.tell_of_job(local(at), TraceWord::FirstPulse);
        }
    }

    /// The last command of a job has ended.
    pub(crate) fn tell_ended(&mut self, now: LocalMicros) {
        let at = self.motion.ended_at().map_or(now, local);
        self.teller.first_pulse_due = false;
        self.tell_of_job(at, TraceWord::Ended);
    }
}
