//! Answers clock probes.
//!
//! The node follows no other clock: it only says what its own one shows. t2 is taken when the
//! probe is handled, t3 when the reply is taken from the outbox, so that a wait between the two
//! is in the stamps and not in the estimate.

use crate::{Node, Outputs, trace::Event};
use keys::{
    LocalMicros,
    clock::{ClockMessage, ClockProbe},
    version,
};
use motion::StepBackend;

/// A probe that came, and when.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Probed {
    pub(crate) probe: ClockProbe,
    pub(crate) received_at: LocalMicros,
}

impl<B: StepBackend, O: Outputs> Node<'_, B, O> {
    /// Takes a message on the key `clock`. The node's own replies travel on the same key.
    pub(crate) fn take_clock(&mut self, payload: &[u8], now: LocalMicros) {
        match version::decode(payload) {
            Ok(ClockMessage::Probe(_)) if !self.link_up() => {}
            Ok(ClockMessage::Probe(probe)) => {
                let overtaken = self.outbox.push_probe(Probed {
                    probe,
                    received_at: now,
                });
                if overtaken {
                    self.trace.note(now, Event::ReplyDropped);
                }
            }
            Ok(ClockMessage::Reply(_)) => {}
            Err(_) => self.trace.note(now, Event::MessageDropped),
        }
    }
}
