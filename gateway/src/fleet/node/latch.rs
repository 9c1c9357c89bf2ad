//! The stop latch of a node: what sets it, what the node says of it, and who wants it lifted.

use super::{Latch, Node, ReleaseWish, Released, Repeat, Turn};
use crate::fleet::event::ReplyTo;
use keys::{
    NodeState, Status, StopMode, StopReason,
    record::{ErrorCode, JobError},
};

/// Gets that may wait for one release.
const RELEASE_WAITERS_MAX: usize = 64;

impl Node {
    /// Somebody stopped this node: nothing that waits may move after a release.
    pub(in crate::fleet) fn handle_stop(&mut self, mode: StopMode, turn: &mut Turn<'_>) {
        let error = JobError::new(
            ErrorCode::Stopped,
            "the node was stopped (client) before the job began",
        );
        self.fail_waiting(&error, turn);
        self.stale_record = true;
        let latched = self.alive && self.facts.latch.is_some();
        if !latched && self.facts.pending_stop != Some(StopMode::Halt) {
            self.facts.pending_stop = Some(mode);
            // It has heard the message itself, if it is there: only a missing latch is a reason
            // to repeat it.
            self.stop = Repeat {
                send_at: self
                    .alive
                    .then(|| turn.now.plus_us(turn.config.stop_repeat_us)),
                sent_count: 0,
            };
            self.store(turn);
        }
        if let Some(wish) = self.release.take() {
            self.refuse_release(wish, "the node was stopped again", turn);
        }
        self.refuse_wish(ErrorCode::Stopped, "the node was stopped", turn);
    }

    /// Somebody wants the latch lifted; `reply` is answered when it is, or when it cannot be.
    pub(in crate::fleet) fn handle_release(&mut self, reply: Option<ReplyTo>, turn: &mut Turn<'_>) {
        if !self.is_stopped() {
            turn.released.extend(reply.map(Released::done));
            return;
        }
        let wish = self.release.get_or_insert_with(|| ReleaseWish {
            give_up_at: turn.now.plus_us(turn.config.release_patience_us),
            send_at: turn.now,
            waiters: Vec::new(),
        });
        if let Some(reply) = reply {
            if wish.waiters.len() >= RELEASE_WAITERS_MAX {
                let error = JobError::new(
                    ErrorCode::TooLarge,
                    "too many releases of this node wait for an answer",
                );
                turn.released.push(Released::refused(reply, error));
                return;
            }
            wish.waiters.push(reply);
        }
    }

    pub(super) fn refuse_release(&mut self, wish: ReleaseWish, message: &str, turn: &mut Turn<'_>) {
        for to in wish.waiters {
            let error = JobError::new(ErrorCode::NotAllowed, message);
            turn.released.push(Released::refused(to, error));
        }
    }

    /// Takes what a status says of the latch.
    pub(super) fn take_latch(&mut self, status: &Status, same_queue: bool, turn: &mut Turn<'_>) {
        let before = self.facts.latch;
        if !matches!(status.state, NodeState::Stopped | NodeState::Fault) {
            self.facts.latch = None;
            self.coming_to_rest = false;
            // While its latch is still to come this was said before the stop, and ends no release.
            let released = self.facts.pending_stop.is_none();
            if let Some(wish) = self.release.take_if(|_| released) {
                turn.released
                    .extend(wish.waiters.into_iter().map(Released::done));
            }
            return;
        }
        // A latch that closes over a queue which was open is on its way: the report that is in
        // the status belongs to an earlier stop.
        let was_open = self.status.is_some() && before.is_none();
        if !same_queue {
            self.coming_to_rest = false;
        } else if was_open {
            self.coming_to_rest = true;
        }
        let report = status
            .stop
            .as_ref()
            .filter(|report| !self.coming_to_rest && report.reason != StopReason::Cancel);
        let reason = match (status.state, report) {
            (NodeState::Fault, _) => Some(StopReason::Fault),
            (_, Some(report)) => Some(report.reason),
            (_, None) if self.facts.pending_stop.is_some() => Some(StopReason::Client),
            (_, None) => before.and_then(|latch| latch.reason),
        };
        let kept = before.filter(|latch| latch.queue == status.queue && latch.reason == reason);
        let latch = kept.unwrap_or_else(|| Latch {
            queue: status.queue,
            reason,
            at: report.map_or(turn.now, |report| {
                self.fleet_from_local(report.at, status.at, turn.now)
            }),
        });
        self.facts.latch = Some(latch);
        self.facts.pending_stop = None;
        self.stop = Repeat::default();
        // A lost link is nobody's wish to end what waits; whatever else latches is.
        let news = before.and_then(|latch| latch.reason) != reason;
        if let Some(reason) = reason.filter(|reason| news && *reason != StopReason::Link) {
            let message = format!(
                "the node was stopped ({}) before the job began",
                reason.as_str()
            );
            let error = JobError::new(ErrorCode::Stopped, message);
            self.fail_waiting(&error, turn);
        }
    }
}
