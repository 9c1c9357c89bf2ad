//! The last events and a counter for each kind: what to look at when a node did something odd.
//!
//! Owns a ring of [`TRACE_EVENTS`] and the counters. Full: the oldest event is overwritten, its
//! counter keeps it. Nothing here is sent by itself.

use crate::limits::TRACE_EVENTS;
use keys::{LocalMicros, Refusal, StopReason, status::FaultCode};

/// What happened.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Event {
    /// A batch is in the ring.
    BatchTaken {
        /// Its commands.
        command_count: u16,
    },
    /// An order came again.
    Duplicate,
    /// An order had no effect.
    Refused(Refusal),
    /// A stop began.
    StopTaken(StopReason),
    /// A stop is complete: a new queue began.
    StopComplete(StopReason),
    /// The latch was lifted.
    Released,
    /// The link is there.
    LinkUp,
    /// The link is gone.
    LinkDown,
    /// The link stayed away while commands were executed.
    LinkLost,
    /// A fault was noted.
    Fault(FaultCode),
    /// A message was not for this node, not known or not readable, and was dropped.
    MessageDropped,
    /// A log line found its queue full.
    LogDropped,
    /// An ack or clock reply was overtaken by newer ones and dropped.
    ReplyDropped,
    /// A script began.
    ScriptBegun,
    /// A script returned, or a stop ended it.
    ScriptEnded,
    /// A script failed.
    ScriptFailed,
    /// A request for a jog was taken.
    JogTaken,
    /// A request for a jog had no effect.
    JogRefused,
}

/// Kinds of [`Event`].
pub const EVENT_KINDS: usize = 18;

impl Event {
    /// Returns the number of the event's kind, below [`EVENT_KINDS`].
    pub const fn kind(&self) -> usize {
        match self {
            Self::BatchTaken { .. } => 0,
            Self::Duplicate => 1,
            Self::Refused(_) => 2,
            Self::StopTaken(_) => 3,
            Self::StopComplete(_) => 4,
            Self::Released => 5,
            Self::LinkUp => 6,
            Self::LinkDown => 7,
            Self::LinkLost => 8,
            Self::Fault(_) => 9,
            Self::MessageDropped => 10,
            Self::LogDropped => 11,
            Self::ReplyDropped => 12,
            Self::ScriptBegun => 13,
            Self::ScriptEnded => 14,
            Self::ScriptFailed => 15,
            Self::JogTaken => 16,
            Self::JogRefused => 17,
        }
    }
}

/// The last events, oldest first, and how many of each kind there were since boot.
#[derive(Clone, Debug, Default)]
pub struct Trace {
    events: heapless::Deque<(LocalMicros, Event), TRACE_EVENTS>,
    counts: [u32; EVENT_KINDS],
}

impl Trace {
    /// Returns an empty trace.
    pub const fn new() -> Self {
        Self {
            events: heapless::Deque::new(),
            counts: [0; EVENT_KINDS],
        }
    }

    /// Notes an event.
    pub fn note(&mut self, at: LocalMicros, event: Event) {
        let count = &mut self.counts[event.kind()];
        *count = count.saturating_add(1);
        if self.events.is_full() {
            self.events.pop_front();
        }
        // Cannot fail: there is room for one.
        let _ = self.events.push_back((at, event));
    }

    /// Returns how many events of this kind there were since boot; the fields do not matter.
    pub fn count(&self, like: &Event) -> u32 {
        self.counts[like.kind()]
    }

    /// Gives the last events, oldest first.
    pub fn events(&self) -> impl Iterator<Item = &(LocalMicros, Event)> {
        self.events.iter()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_ring_keeps_the_last_events_and_the_counter_keeps_all() {
        let mut trace = Trace::new();
        for at in 0..1000 {
            trace.note(LocalMicros(at), Event::LinkUp);
        }
        trace.note(LocalMicros(1000), Event::Released);
        assert_eq!(trace.count(&Event::LinkUp), 1000);
        assert_eq!(trace.events().count(), TRACE_EVENTS);
        assert_eq!(
            trace.events().last(),
            Some(&(LocalMicros(1000), Event::Released))
        );
    }
}
