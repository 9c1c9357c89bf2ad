//! Waiting at a barrier, and going on at an instant that all nodes of a job agree on.
//!
//! ```text
//!            AtBarrier            Commit              Confirm
//!   running ───────────▶ Waiting ────────▶ Armed ───────────────▶ Confirmed ─ start_at ─▶ running
//!                         ▲  │ Ready ×     │  │ Armed ×             │                    Started ×
//!                         │  ▼             │  │ confirm_by passes   │
//!                         └─── Abort ◀─────┴──┴─────── Abort ◀──────┘
//! ```
//!
//! The rule that keeps a fleet together: without a confirmation by `confirm_by` this node does not
//! start, whatever it has promised before. So a gateway that dies, or a message that is lost,
//! leaves a machine at rest. A stop, a cancel and a fault drop the queue and with it the start.
//!
//! What is said is said again (Ready each [`READY_US`], Started [`STARTED_COUNT`] times), so a lost
//! message costs time and nothing else.

use crate::{
    Node, Outputs,
    limits::{CONFIRM_MARGIN_US, READY_US, STARTED_COUNT, STARTED_US},
    stop::Phase,
    trace::Event,
};
use keys::{LocalMicros, QueueId, StopMode, StopReason, batch, start::StartMessage, version};
use motion::{StepBackend, Ticks};

/// Where the node is on its way through a barrier.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Start {
    /// No barrier.
    Open,
    /// Everything before the barrier has ended.
    Waiting {
        command: u64,
        /// When Ready is said next.
        ready_at: LocalMicros,
    },
    /// An instant is agreed, and not confirmed.
    Armed {
        command: u64,
        start_at: LocalMicros,
        confirm_by: LocalMicros,
    },
    /// It will start then.
    Confirmed { command: u64, start_at: LocalMicros },
}

/// A start that is told several times.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Told {
    message: StartMessage,
    left_count: u8,
    next_at: LocalMicros,
}

impl<B: StepBackend, O: Outputs> Node<'_, B, O> {
    /// Takes a message on the key `start`. The node's own messages travel on the same key.
    pub(crate) fn take_start(&mut self, payload: &[u8], now: LocalMicros) {
        let Ok(message) = version::decode::<StartMessage>(payload) else {
            self.trace.note(now, Event::MessageDropped);
            return;
        };
        match message {
            StartMessage::Commit {
                queue,
                command,
                start_at,
                confirm_by,
            } if self.is_for(queue, command) => self.commit(command, start_at, confirm_by, now),
            StartMessage::Confirm { queue, command } if self.is_for(queue, command) => {
                self.confirm(now);
            }
            StartMessage::Abort { queue, command } if self.is_for(queue, command) => {
                self.abort(command, now);
            }
            StartMessage::Commit { .. }
            | StartMessage::Confirm { .. }
            | StartMessage::Abort { .. }
            | StartMessage::Ready { .. }
            | StartMessage::ReadyAt { .. }
            | StartMessage::Armed { .. }
            | StartMessage::Started { .. } => {}
        }
    }

    /// Returns whether a message is about the barrier at which the node is.
    fn is_for(&self, queue: QueueId, command: u64) -> bool {
        let at = match self.start {
            Start::Open => None,
            Start::Waiting { command, .. }
            | Start::Armed { command, .. }
            | Start::Confirmed { command, .. } => Some(command),
        };
        queue == self.queue && at == Some(command) && self.phase == Phase::Open
    }

    fn commit(
        &mut self,
        command: u64,
        start_at: LocalMicros,
        confirm_by: LocalMicros,
        now: LocalMicros,
    ) {
        let in_time = now < confirm_by && confirm_by.plus_us(CONFIRM_MARGIN_US) <= start_at;
        let ready =
            !matches!(self.start, Start::Confirmed { .. }) && self.is_filled() && !self.is_held();
        if in_time && ready {
            self.start = Start::Armed {
                command,
                start_at,
                confirm_by,
            };
            self.say(StartMessage::Armed {
                queue: self.queue,
                command,
            });
        }
    }

    fn confirm(&mut self, now: LocalMicros) {
        if let Start::Armed {
            command,
            start_at,
            confirm_by,
        } = self.start
            && now < confirm_by
        {
            self.start = Start::Confirmed { command, start_at };
            self.motion
                .release_barrier(crate::ticks_from_local(start_at));
        }
    }

    fn abort(&mut self, command: u64, now: LocalMicros) {
        if let Start::Confirmed { start_at, .. } = self.start
            && !self.motion.hold_barrier()
        {
            if now < start_at {
                // The lead-in plays already, and there is only one way to stop pulses.
                self.begin_stop(StopReason::Cancel, StopMode::Halt, now);
            }
            return;
        }
        self.start = Start::Waiting {
            command,
            ready_at: now,
        };
    }

    /// Returns whether what follows the barrier is in the ring, or as much of it as fits.
    fn is_filled(&self) -> bool {
        let rest_is_here = if self.script.is_running() {
            self.script_rests(self.now)
        } else {
            self.job
                .is_some_and(|job| self.motion.accepted_commands() >= job.end)
        };
        rest_is_here || self.motion.credit_commands() < batch::BATCH_COMMANDS_MAX
    }

    /// Everything before a barrier has ended.
    pub(crate) fn reach_barrier(&mut self, command: u64, now: LocalMicros) {
        if self.rest_until_resumed(command, now) {
            return;
        }
        self.start = Start::Waiting {
            command,
            ready_at: now,
        };
    }

    /// The instant has passed before motion was told: it still waits.
    pub(crate) fn miss_barrier(&mut self, command: u64, now: LocalMicros) {
        self.log(
            now,
            format_args!("too late for the start at command {command}"),
        );
        self.reach_barrier(command, now);
    }

    /// The first edge behind a barrier has left.
    pub(crate) fn tell_started(&mut self, command: u64, first_edge_at: Ticks, now: LocalMicros) {
        if self.pace.is_own(command) {
            return;
        }
        if let Start::Confirmed {
            command: confirmed, ..
        } = self.start
            && confirmed == command
        {
            self.start = Start::Open;
        }
        self.told = Some(Told {
            message: StartMessage::Started {
                queue: self.queue,
                command,
                first_edge_at: LocalMicros(first_edge_at.0 / motion::TICKS_PER_US),
            },
            left_count: STARTED_COUNT,
            next_at: now,
        });
    }

    /// Lets time pass: disarms, says again.
    pub(crate) fn watch_start(&mut self, now: LocalMicros) {
        match self.start {
            Start::Armed {
                command,
                confirm_by,
                ..
            } if confirm_by <= now => {
                self.start = Start::Waiting {
                    command,
                    ready_at: now,
                };
            }
            // The lead-in has begun, and the barrier is behind: nothing holds the queue any more.
            Start::Confirmed { start_at, .. } if start_at <= now => self.start = Start::Open,
            _ => {}
        }
        if let Start::Waiting { command, ready_at } = self.start
            && ready_at <= now
            && self.link_up()
        {
            // Held, it would not start with the others.
            if self.is_filled() && !self.is_held() {
                let queue = self.queue;
                self.say(match self.barrier_name(command) {
                    Some(name) => StartMessage::ReadyAt {
                        queue,
                        command,
                        name,
                    },
                    None => StartMessage::Ready { queue, command },
                });
            }
            self.start = Start::Waiting {
                command,
                ready_at: now.plus_us(READY_US),
            };
        }
        if let Some(told) = self.told
            && told.next_at <= now
        {
            self.say(told.message);
            self.told = (told.left_count > 1).then(|| Told {
                left_count: told.left_count - 1,
                next_at: now.plus_us(STARTED_US),
                ..told
            });
        }
    }

    /// Returns when [`Node::watch_start`] has something to do next.
    pub(crate) fn start_timeout(&self) -> Option<LocalMicros> {
        let at = match self.start {
            Start::Open => None,
            Start::Waiting { ready_at, .. } => self.link_up().then_some(ready_at),
            Start::Armed { confirm_by, .. } => Some(confirm_by),
            Start::Confirmed { start_at, .. } => Some(start_at),
        };
        let told = self.told.map(|told| told.next_at);
        at.into_iter().chain(told).min()
    }

    /// Returns whether the node rests at a barrier, so that nothing moves without a confirmation.
    pub(crate) fn rests_at_barrier(&self) -> bool {
        self.pace.waits() || matches!(self.start, Start::Waiting { .. } | Start::Armed { .. })
    }

    fn say(&mut self, message: StartMessage) {
        if self.link_up() {
            self.outbox.push_start(message);
        }
    }
}
