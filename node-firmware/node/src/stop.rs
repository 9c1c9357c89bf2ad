//! The one stop path: message, pin, lost link, limit and fault all end in [`Node::stop`].
//!
//! ```text
//!            stop                       all pulses out
//!   Open ────────────▶ Stopping ─────────────────────────▶ Latched ── release ──▶ Open
//!     │ cancel             ▲ stop                            new queue, report
//!     └──────────▶ Stopping(cancel) ── all pulses out ──▶ Open, new queue, report
//! ```
//!
//! Every stop switches the laser off before anything else. A stop at rest goes the same way, so
//! that its latch and its report are as good as any. While stopping, a halt overrides a
//! deceleration, a stop overrides a cancel, and a fault overrides the reason; nothing is ever
//! softened. A latched node has dropped its queue already: another stop begins no other queue.

use crate::{LinkLoss, Node, Outputs, start::Start, trace::Event};
use keys::{LocalMicros, StopMode, StopReason, StopReport, status::FaultCode, trace::TraceWord};
use motion::StepBackend;

/// Where the node is on the stop path.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Phase {
    /// Batches are taken.
    Open,
    /// Coming to rest; what follows is dropped.
    Stopping {
        reason: StopReason,
        mode: StopMode,
        at: LocalMicros,
    },
    /// At rest, until released.
    Latched { reason: StopReason },
}

impl Phase {
    /// Returns why every batch is refused, `None` if it is not for a latch.
    pub(crate) fn latch(self) -> Option<StopReason> {
        match self {
            Self::Open
            | Self::Stopping {
                reason: StopReason::Cancel,
                ..
            } => None,
            Self::Stopping { reason, .. } | Self::Latched { reason } => Some(reason),
        }
    }
}

impl<B: StepBackend, O: Outputs> Node<'_, B, O> {
    /// Stops: laser off, queue dropped, and unless the reason is [`StopReason::Cancel`], every
    /// batch refused until a release. A halt is complete when this returns.
    pub fn stop(&mut self, reason: StopReason, mode: StopMode, now: LocalMicros) {
        let now = self.advance_to(now);
        self.begin_stop(reason, mode, now);
        self.run_motion(now);
        self.settle(now);
    }

    /// Notes a fault and stops at once.
    pub fn fault(&mut self, code: FaultCode, now: LocalMicros) {
        let now = self.advance_to(now);
        self.note_fault(code, now);
        self.stop(StopReason::Fault, StopMode::Halt, now);
    }

    /// Sets the stop going; [`Node::run_motion`] completes it.
    pub(crate) fn begin_stop(&mut self, reason: StopReason, mode: StopMode, now: LocalMicros) {
        self.set_laser(0);
        self.forget_hold();
        self.jogs.forget();
        self.start = Start::Open;
        self.status_due = true;
        match self.phase {
            Phase::Open => {
                self.trace.note(now, Event::StopTaken(reason));
                self.tell_of_job(now, TraceWord::StopTaken(reason));
                self.phase = Phase::Stopping {
                    reason,
                    mode,
                    at: now,
                };
                self.motion.stop(mode, crate::ticks_from_local(now));
                self.drop_script(now);
            }
            Phase::Stopping {
                reason: reason_before,
                mode: mode_before,
                at,
            } => {
                let harder = mode == StopMode::Halt && mode_before == StopMode::Decelerate;
                let overrides = reason != reason_before
                    && (reason_before == StopReason::Cancel || reason == StopReason::Fault);
                if overrides {
                    self.trace.note(now, Event::StopTaken(reason));
                    self.tell_of_job(now, TraceWord::StopTaken(reason));
                }
                self.phase = Phase::Stopping {
                    reason: if overrides { reason } else { reason_before },
                    mode: if harder { StopMode::Halt } else { mode_before },
                    at: if overrides { now } else { at },
                };
                if harder {
                    self.motion
                        .stop(StopMode::Halt, crate::ticks_from_local(now));
                }
            }
            Phase::Latched { .. } => {
                if reason == StopReason::Fault {
                    self.phase = Phase::Latched { reason };
                }
            }
        }
    }

    /// The last pulse of a dropped queue has left the pin: reports, and begins the next queue.
    pub(crate) fn complete_stop(&mut self, now: LocalMicros) {
        let Phase::Stopping { reason, at, .. } = self.phase else {
            return;
        };
        let axis_count = self.motion.axis_count();
        let report = StopReport {
            queue: self.queue,
            reason,
            at,
            accepted_commands: self.motion.accepted_commands(),
            executed_commands: self.motion.executed_commands(),
            positions_steps: (0..axis_count)
                .map(|axis| self.motion.position_steps(keys::AxisId(axis as u8)))
                .collect(),
        };
        self.motion.begin_queue();
        self.queue.flush = self.queue.flush.wrapping_add(1);
        self.phase = if reason == StopReason::Cancel {
            Phase::Open
        } else {
            Phase::Latched { reason }
        };
        self.tell_of_job(now, TraceWord::Stopped(reason));
        self.job = None;
        self.credit_told = self.motion.credit_commands();
        self.status_due = true;
        self.trace.note(now, Event::StopComplete(reason));
        self.log(
            now,
            format_args!(
                "stopped: {}; {} of {} commands done; at {:?}",
                reason.as_str(),
                report.executed_commands,
                report.accepted_commands,
                report.positions_steps.as_slice(),
            ),
        );
        self.last_stop = Some(report);
    }

    /// Applies the policy when the link has been gone for too long while commands are executed.
    pub(crate) fn watch_link(&mut self, now: LocalMicros) {
        let Some(gone_at) = self.link_gone_at else {
            return;
        };
        // At a barrier nothing moves, and nothing will without a confirmation.
        if self.rests_at_barrier()
            || self.link_loss_settled
            || now.since_us(gone_at) < self.config.link_loss_after_us
        {
            return;
        }
        self.link_loss_settled = true;
        if !self.is_busy() {
            return;
        }
        self.trace.note(now, Event::LinkLost);
        self.tell_of_job(now, TraceWord::LinkLost);
        self.note_fault(FaultCode::LINK_LOST, now);
        let (mode, outcome) = match self.config.link_loss {
            _ if self.phase != Phase::Open => (None, "was stopping already"),
            LinkLoss::Finish => (None, "went on with what the queue held"),
            LinkLoss::Decelerate => (Some(StopMode::Decelerate), "decelerated and stopped"),
            LinkLoss::Halt => (Some(StopMode::Halt), "stopped at once"),
        };
        self.link_loss_outcome = Some(outcome);
        let Some(mode) = mode else {
            return;
        };
        self.begin_stop(StopReason::Link, mode, now);
    }
}
