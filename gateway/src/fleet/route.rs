//! One job's commands → numbered batches for one node, by credit. Owns what is on its way; the
//! commands themselves stay with the job and are cut anew from wherever the node says it is.
//!
//! ```text
//!   base           accepted          next              limit          end
//!    │── the node has ──│── on its way ──│── may be sent ──│── no room ──│
//! ```
//!
//! Promises: at most [`Route::window_batches`] batches are unanswered; nothing is sent beyond the
//! room that the node has told; a batch that is not answered in time, or that the node could not
//! place, is sent again from the number that the node asks for (go-back-N). A command that the
//! node has is never sent a second time under another number.
//!
//! Absent on purpose: persistence. Numbers make a repeated batch harmless, so what was sent need
//! not be remembered over a restart.

use crate::security::signing::{Signed, script_bytes};
use keys::{
    BatchHeader, Command, FleetMicros, JobId, Order, QueueId, Refusal, ScriptHeader,
    batch::{BatchWriter, ORDER_BYTES_MAX},
    script::PART_BYTES_MAX,
    signed::PROOF_BYTES_MAX,
};
use std::{collections::VecDeque, sync::Arc};

/// Shortest wait for an answer before a batch is sent again, µs.
pub const RETRY_US_MIN: u64 = 200_000;

/// Longest such wait, µs.
pub const RETRY_US_MAX: u64 = 2_000_000;

/// How often a node may call the same batch malformed before its job is given up.
pub const MALFORMED_COUNT_MAX: u32 = 8;

/// The smoothed time from an order to its answer; outlives a route.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct RoundTrip {
    smoothed_us: Option<u64>,
}

impl RoundTrip {
    /// Takes one measurement, with the weight 1/8 that TCP uses (RFC 6298).
    pub fn observe(&mut self, rtt_us: u64) {
        self.smoothed_us = Some(match self.smoothed_us {
            None => rtt_us,
            Some(smoothed_us) => smoothed_us - smoothed_us / 8 + rtt_us / 8,
        });
    }

    /// Returns how long to wait for an answer, µs.
    pub fn retry_us(&self) -> u64 {
        let patient_us = self.smoothed_us.unwrap_or(0).saturating_mul(4);
        patient_us.clamp(RETRY_US_MIN, RETRY_US_MAX)
    }
}

/// A batch that was sent and not answered.
#[derive(Clone, Copy, Debug)]
struct Flight {
    end: u64,
    sent_at: FleetMicros,
    /// Sent before: an answer tells nothing about the time it took (Karn).
    again: bool,
}

/// The way of one job's commands to its node.
#[derive(Clone, Debug)]
pub struct Route {
    job: JobId,
    queue: QueueId,
    base: u64,
    end: u64,
    /// What the node has, as far as is known.
    accepted: u64,
    next: u64,
    /// Highest number that was ever sent.
    sent_max: u64,
    flights: VecDeque<Flight>,
    window_batches: usize,
    /// What the node had when it went back last, and when that was.
    back: Option<(u64, FleetMicros)>,
    hold_until: Option<FleetMicros>,
    /// Doubles the wait while nothing gets through.
    retry_shift: u32,
    malformed_count: u32,
    round_trip: RoundTrip,
    /// Takes the last number of all.
    script: Option<Arc<str>>,
    signed: Option<Signed>,
}

/// What a refusal means for the job.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Setback {
    /// The route deals with it.
    None,
    /// The node does not take the command at this index of the job.
    BadCommand {
        /// Index in the job, from 0.
        index: u64,
    },
    /// The command at this index of the job would lead an axis of the node out of its soft limits.
    OutOfReach {
        /// Index in the job, from 0.
        index: u64,
    },
    /// The node does not understand the orders at all.
    Malformed,
    /// The node executes only what is signed by somebody whom it knows, once.
    NotSigned,
}

impl Route {
    /// Begins or resumes a job: its commands are `base..end` of that queue.
    pub fn new(
        job: JobId,
        queue: QueueId,
        base: u64,
        end: u64,
        window_batches: usize,
        round_trip: RoundTrip,
    ) -> Self {
        Self {
            job,
            queue,
            base,
            end,
            accepted: base,
            next: base,
            sent_max: base,
            flights: VecDeque::with_capacity(window_batches),
            window_batches,
            back: None,
            hold_until: None,
            retry_shift: 0,
            malformed_count: 0,
            round_trip,
            script: None,
            signed: None,
        }
    }

    /// Sends the proof of a signature with each order.
    #[must_use]
    pub fn with_signature(mut self, signed: Option<Signed>) -> Self {
        self.signed = signed;
        self
    }

    /// Sends a script behind the commands; `end` counts it.
    #[must_use]
    pub fn with_script(mut self, script: Option<Arc<str>>) -> Self {
        self.script = script;
        self
    }

    /// The node has answered a part of something: it is not lost, only long.
    pub fn handle_part(&mut self, now: FleetMicros) {
        if self.script.is_some()
            && let Some(oldest) = self.flights.front_mut()
        {
            oldest.sent_at = now;
            oldest.again = true;
        }
    }

    /// Returns what was learnt about the way.
    pub fn round_trip(&self) -> RoundTrip {
        self.round_trip
    }

    /// Returns how many batches may be unanswered at a time.
    pub fn window_batches(&self) -> usize {
        self.window_batches
    }

    /// The node has so many commands of the queue.
    pub fn handle_accepted(&mut self, accepted: u64, now: FleetMicros) {
        if accepted <= self.accepted {
            return;
        }
        self.accepted = accepted;
        self.next = self.next.max(accepted).min(self.end);
        self.retry_shift = 0;
        self.malformed_count = 0;
        self.hold_until = None;
        while let Some(flight) = self.flights.front().copied() {
            if flight.end > accepted {
                break;
            }
            if flight.end == accepted && !flight.again {
                self.round_trip.observe(now.since_us(flight.sent_at));
            }
            self.flights.pop_front();
        }
    }

    /// The node refused something while it had so many commands.
    pub fn handle_refusal(&mut self, refusal: Refusal, accepted: u64, now: FleetMicros) -> Setback {
        // An answer from before what is known already: its cause is dealt with.
        if accepted < self.accepted {
            return Setback::None;
        }
        match refusal {
            Refusal::Gap | Refusal::Overlap => {
                // Every batch behind a lost one is refused; going back once answers them all.
                let answered = self.back.is_some_and(|(back_accepted, at)| {
                    back_accepted == accepted && now.since_us(at) < self.retry_us()
                });
                if !answered {
                    self.go_back(now);
                }
                Setback::None
            }
            Refusal::QueueShort | Refusal::Stale | Refusal::Stopped | Refusal::ScriptRuns => {
                // The next status tells more; until then the node has nothing to gain from us.
                self.hold(now);
                Setback::None
            }
            Refusal::BadCommand { index } => match self.index_of(accepted, index) {
                Some(index) => Setback::BadCommand { index },
                None => Setback::None,
            },
            Refusal::OutOfReach { index } => match self.index_of(accepted, index) {
                Some(index) => Setback::OutOfReach { index },
                None => Setback::None,
            },
            Refusal::NotSigned => Setback::NotSigned,
            // It obeys another gateway. This one goes on asking, in case that one is gone with its
            // clock: nothing that it says is taken meanwhile.
            Refusal::Superseded { .. } => {
                self.hold(now);
                Setback::None
            }
            Refusal::Malformed => {
                self.malformed_count += 1;
                if self.malformed_count >= MALFORMED_COUNT_MAX {
                    return Setback::Malformed;
                }
                self.hold(now);
                Setback::None
            }
        }
    }

    /// Returns the place in the job of a command in the batch that was refused, if it is there.
    fn index_of(&self, accepted: u64, index: u16) -> Option<u64> {
        let number = accepted + u64::from(index);
        (number < self.end).then(|| number - self.base)
    }

    /// Sends what may be sent: `limit` is the number up to which the node has room, `commands`
    /// are all of the job.
    pub fn poll(
        &mut self,
        commands: &[Command],
        limit: u64,
        now: FleetMicros,
        mut send: impl FnMut(&[u8]),
    ) {
        if let Some(until) = self.hold_until {
            if now < until {
                return;
            }
            self.hold_until = None;
        }
        if self.retry_at().is_some_and(|at| now >= at) {
            self.retry_shift = (self.retry_shift + 1).min(4);
            self.go_back(now);
        }
        let limit = limit.min(self.end);
        let signed = self.signed.clone();
        let mut send = |bytes: &[u8], end: u64| match &signed {
            None => send(bytes),
            Some(signed) => {
                let mut buffer = [0; PROOF_BYTES_MAX + ORDER_BYTES_MAX];
                let used = signed
                    .proof(end)
                    .write(&mut buffer)
                    .expect("the buffer has room for a proof");
                buffer[used..used + bytes.len()].copy_from_slice(bytes);
                send(&buffer[..used + bytes.len()]);
            }
        };
        while self.flights.len() < self.window_batches && self.next < limit {
            let first = self.next;
            if let Some(script) = &self.script
                && first + 1 == self.end
            {
                self.send_script(script, first, &mut send);
                self.next = self.end;
                self.flights.push_back(Flight {
                    end: self.next,
                    sent_at: now,
                    again: first < self.sent_max,
                });
                self.sent_max = self.sent_max.max(self.next);
                return;
            }
            let mut writer = BatchWriter::new();
            let from = usize::try_from(first - self.base).unwrap_or(usize::MAX);
            let to = usize::try_from(limit - self.base).unwrap_or(usize::MAX);
            let to = to.min(commands.len());
            for command in commands.get(from..to).unwrap_or_default() {
                if !writer.push(command) {
                    break;
                }
            }
            let count = u64::from(writer.command_count());
            if count == 0 {
                return;
            }
            let header = BatchHeader {
                queue: self.queue,
                first_command: first,
                command_count: 0,
                job: self.job,
                job_end: self.end,
            };
            let mut buffer = [0; ORDER_BYTES_MAX];
            let bytes = writer
                .finish(header, &mut buffer)
                .expect("the buffer has the size that the writer asks for");
            send(bytes, first + count);
            self.next += count;
            self.flights.push_back(Flight {
                end: self.next,
                sent_at: now,
                again: first < self.sent_max,
            });
            self.sent_max = self.sent_max.max(self.next);
        }
    }

    fn send_script(&self, script: &str, first: u64, send: &mut impl FnMut(&[u8], u64)) {
        let text = script_bytes(script);
        let mut offset_bytes = 0;
        for part in text.chunks(PART_BYTES_MAX) {
            let order = Order::Script(ScriptHeader {
                queue: self.queue,
                first_command: first,
                job: self.job,
                offset_bytes,
                total_bytes: text.len() as u32,
            });
            let mut buffer = [0; ORDER_BYTES_MAX];
            let used = keys::version::encode(&order, &mut buffer)
                .expect("a header has at most 80 bytes")
                .len();
            buffer[used..used + part.len()].copy_from_slice(part);
            send(&buffer[..used + part.len()], self.end);
            offset_bytes += part.len() as u32;
        }
    }

    /// Returns when [`Route::poll`] has something to do although nothing has arrived.
    pub fn poll_timeout(&self) -> Option<FleetMicros> {
        self.hold_until.or_else(|| self.retry_at())
    }

    fn retry_us(&self) -> u64 {
        (self.round_trip.retry_us() << self.retry_shift).min(RETRY_US_MAX)
    }

    fn retry_at(&self) -> Option<FleetMicros> {
        let oldest = self.flights.front()?;
        Some(oldest.sent_at.plus_us(self.retry_us()))
    }

    fn go_back(&mut self, now: FleetMicros) {
        self.back = Some((self.accepted, now));
        self.next = self.accepted.min(self.end);
        self.flights.clear();
    }

    fn hold(&mut self, now: FleetMicros) {
        self.go_back(now);
        self.hold_until = Some(now.plus_us(self.retry_us()));
    }
}

#[cfg(test)]
mod tests;
