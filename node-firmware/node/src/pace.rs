//! Hold, resume and speed, for clients and for scripts: one state, told at each change.
//!
//! Owns the count of changes by which a late word has no effect: one for each word that was taken, and for
//! each change by a script or a stop. Motion does the work. A start that is
//! agreed is not held back, since the others would go without this node: the hold counts from then on.
//! A stop ends a hold; the speed stays until it is changed or the node boots.

use crate::{Node, Outputs, limits::RESUME_LEAD_US, start::Start, stop::Phase, trace::Event};
use keys::{
    Command, LocalMicros,
    command::BARRIER_RESUME,
    pace::{PaceMessage, SPEED_PERCENT_MAX, SPEED_PERCENT_MIN},
    trace::TraceWord,
    version,
};
use motion::StepBackend;

/// See the module.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Pace {
    /// Changes since boot, with words that changed nothing.
    change: u32,
    /// A hold waits for an agreed start to be over.
    hold_due: bool,
    percent: u16,
    /// What was counted last.
    counted: (bool, u16),
    /// It must be told.
    pub(crate) due: bool,
    /// The barrier of this number is its own, and whether it still rests there.
    own: Option<(u64, bool)>,
}

impl Pace {
    pub(crate) const fn new() -> Self {
        Self {
            change: 0,
            hold_due: false,
            percent: 100,
            counted: (false, 100),
            due: false,
            own: None,
        }
    }

    /// Returns whether the node rests at a barrier of its own.
    pub(crate) const fn waits(&self) -> bool {
        matches!(self.own, Some((_, true)))
    }

    /// Returns whether a barrier is nobody else's.
    pub(crate) fn is_own(&self, command: u64) -> bool {
        self.own.is_some_and(|(own, _)| own == command)
    }
}

impl<B: StepBackend, O: Outputs> Node<'_, B, O> {
    /// Takes a message on the key `pace`. The node's own messages travel on the same key.
    pub(crate) fn take_pace(&mut self, payload: &[u8], now: LocalMicros) {
        let Ok(message) = version::decode::<PaceMessage>(payload) else {
            self.trace.note(now, Event::MessageDropped);
            return;
        };
        match message {
            PaceMessage::Told { .. } => {}
            PaceMessage::Ask => self.pace.due = true,
            PaceMessage::Set {
                boot,
                change,
                hold,
                percent,
            } => {
                // Whatever becomes of it is told.
                self.pace.due = true;
                if (boot, change) != (self.queue.boot, self.pace.change) {
                    return;
                }
                if let Some(percent) = percent {
                    self.change_speed(percent);
                }
                match hold.filter(|_| self.phase == Phase::Open) {
                    Some(true) => self.hold(now),
                    Some(false) => self.resume(now),
                    None => {}
                }
                // Also if all is as before: what was said with the same number is old now.
                self.count_change(now);
            }
        }
    }

    /// Comes to rest on the path.
    pub(crate) fn hold(&mut self, now: LocalMicros) {
        if matches!(self.start, Start::Armed { .. } | Start::Confirmed { .. }) {
            self.pace.hold_due = true;
        } else {
            self.motion.hold(crate::ticks_from_local(now));
        }
    }

    /// Goes on after a hold.
    pub(crate) fn resume(&mut self, now: LocalMicros) {
        self.pace.hold_due = false;
        self.motion.resume();
        if let Some((_, waits @ true)) = &mut self.pace.own {
            *waits = false;
            let at = now.plus_us(RESUME_LEAD_US);
            self.motion.release_barrier(crate::ticks_from_local(at));
        }
    }

    /// Everything before a barrier has ended. Returns whether it is the node's own: it rests there until
    /// it is resumed, as if it were held.
    pub(crate) fn rest_until_resumed(&mut self, command: u64, now: LocalMicros) -> bool {
        let next = self.motion.waiting_command();
        let own = next
            == Some(Command::Barrier {
                barrier: BARRIER_RESUME,
            });
        if own {
            self.pace.own = Some((command, true));
            self.log(
                now,
                format_args!("waits at command {command} until it is resumed"),
            );
        }
        own
    }

    /// Sets the speed of ramps and lines; `false`: it is out of range, and nothing has changed.
    pub(crate) fn change_speed(&mut self, percent: u16) -> bool {
        if !(SPEED_PERCENT_MIN..=SPEED_PERCENT_MAX).contains(&percent) {
            return false;
        }
        if !matches!(self.phase, Phase::Stopping { .. }) {
            self.motion.set_speed_percent(percent);
            self.pace.percent = percent;
        }
        true
    }

    /// Returns whether it rests on its path, or is about to. A stop that comes to rest on the path is
    /// no hold.
    pub fn is_held(&self) -> bool {
        let waits = self.phase == Phase::Open && self.pace.waits();
        self.pace.hold_due || waits || self.motion.is_held()
    }

    /// Returns how fast it executes, percent of what the commands ask for.
    pub fn speed_percent(&self) -> u16 {
        self.pace.percent
    }

    /// A stop ends a hold that has not begun.
    pub(crate) fn forget_hold(&mut self) {
        self.pace.hold_due = false;
        self.pace.own = None;
    }

    /// Makes a hold that had to wait, and counts what has changed.
    pub(crate) fn watch_pace(&mut self, now: LocalMicros) {
        let agreed = matches!(self.start, Start::Armed { .. } | Start::Confirmed { .. });
        if self.pace.hold_due && !agreed {
            self.pace.hold_due = false;
            self.motion.hold(crate::ticks_from_local(now));
        }
        if (self.is_held(), self.pace.percent) != self.pace.counted {
            self.count_change(now);
        }
    }

    fn count_change(&mut self, now: LocalMicros) {
        let (held_before, percent_before) = self.pace.counted;
        self.pace.counted = (self.is_held(), self.pace.percent);
        let (held, percent) = self.pace.counted;
        // A stop tells itself that it ends a hold.
        if held != held_before && self.phase == Phase::Open {
            let word = if held {
                TraceWord::Held
            } else {
                TraceWord::Resumed
            };
            self.tell_of_job(now, word);
        }
        if percent != percent_before {
            self.tell_of_job(now, TraceWord::Speed { percent });
        }
        self.pace.change = self.pace.change.wrapping_add(1);
        self.pace.due = true;
        self.status_due = true;
    }

    /// Returns what is told.
    pub(crate) fn pace_message(&self) -> PaceMessage {
        PaceMessage::Told {
            boot: self.queue.boot,
            change: self.pace.change,
            hold: self.is_held(),
            percent: self.pace.percent,
        }
    }
}
