//! When a run of commands began to step and when it ended, for whoever tells it.

use super::Motion;
use crate::{StepBackend, Ticks};

/// Commands that are watched, and what was seen of them.
#[derive(Clone, Copy, Debug)]
pub(super) struct Watch {
    first: u64,
    end: u64,
    /// The command that steps first, and when; a change in flight may still move it.
    first_edge: Option<(u64, Ticks)>,
    ended_at: Option<Ticks>,
}

impl<B: StepBackend> Motion<'_, B> {
    /// Watches the commands from this number on up to, but not including, another one; what was watched
    /// before is forgotten.
    pub fn watch(&mut self, first_command: u64, end_command: u64) {
        self.watch = Some(Watch {
            first: first_command,
            end: end_command,
            first_edge: None,
            ended_at: None,
        });
    }

    /// Returns when the first active edge of what is watched has left, as soon as it has.
    pub fn first_edge_at(&self) -> Option<Ticks> {
        let (_, at) = self.watch?.first_edge?;
        (at <= self.now).then_some(at)
    }

    /// Returns when the last of the watched commands that have ended did so.
    pub fn ended_at(&self) -> Option<Ticks> {
        self.watch?.ended_at
    }

    /// The command that was taken from the ring last is planned; its first edge is due then.
    pub(super) fn watch_edge(&mut self, at: Option<Ticks>) {
        let planned = self.accepted_commands - self.ring.count() as u64;
        let (Some(watch), Some(at), Some(number)) =
            (self.watch.as_mut(), at, planned.checked_sub(1))
        else {
            return;
        };
        let known = watch.first_edge;
        // What has left stays; a plan that was taken back begins with the same command again.
        let news = known.is_none_or(|(known, at)| number <= known && at > self.now);
        if news && (watch.first..watch.end).contains(&number) {
            watch.first_edge = Some((number, at));
        }
    }

    /// One more command has been executed.
    pub(super) fn watch_end(&mut self, at: Ticks) {
        let executed = self.executed_commands;
        if let Some(watch) = self.watch.as_mut()
            && executed > watch.first
            && executed <= watch.end
        {
            watch.ended_at = Some(at);
        }
    }
}
