//! Holds of raw moves: the timeline stands still, for all axes equally long.
//!
//! Whoever holds says when, not where in the pulses that takes effect: within what the hardware
//! holds. So the first interval that is longer tells for how long the timeline stood, and every
//! other one must agree.

use super::Limits;
use crate::record::Held;

/// One hold.
#[derive(Clone, Copy, Debug)]
struct Stand {
    from: u64,
    until: u64,
    /// For how long the timeline stood, ticks, once an interval has told.
    ticks: Option<u64>,
    /// The edges between which it stood.
    edges: (u64, u64),
    /// It is part of the present command's time already.
    counted: bool,
}

/// The holds of one life.
#[derive(Clone, Debug)]
pub(super) struct Holds(Vec<Stand>);

impl Holds {
    pub(super) fn new(holds: &[Held]) -> Self {
        let stand = |held: &Held| Stand {
            from: held.from_ticks,
            until: held.until_ticks.unwrap_or(u64::MAX),
            ticks: None,
            edges: (0, u64::MAX),
            counted: false,
        };
        Self(holds.iter().map(stand).collect())
    }

    /// Returns whether two edges are so far apart because the timeline stood between them, rather
    /// than `interval` ticks.
    pub(super) fn explain(&mut self, before: u64, at: u64, interval: u64, limits: &Limits) -> bool {
        let Some(mut more) = (at - before).checked_sub(interval) else {
            return false;
        };
        let slack = 2 * limits.stop_begin_ticks;
        // One that was part of an earlier command is over, however near.
        let between = |stand: &&mut Stand| {
            let near = before < stand.from + slack && stand.until <= at;
            near && !stand.counted && before < stand.edges.1 && at > stand.edges.0
        };
        let mut open = Vec::new();
        let mut any = false;
        for stand in self.0.iter_mut().filter(between) {
            match stand.ticks {
                Some(ticks) => more = more.saturating_sub(ticks),
                None => open.push(stand),
            }
            any = true;
        }
        if open.is_empty() {
            return any && more <= limits.skew_ticks;
        }
        // It stood from somewhere within the slack until it was told to go on, and the lead-in.
        let fits =
            |told: u64, slack: u64| more >= told.saturating_sub(slack) && more <= told + slack;
        let told = |stand: &Stand| stand.until - stand.from;
        if let Some(index) = open.iter().position(|stand| fits(told(stand), slack)) {
            // Another one may show between other edges.
            open.drain(..index);
            open.truncate(1);
        }
        // Of several, held again before a step was made, only the sum can be told.
        let count = open.len() as u64;
        let sum = open.iter().map(|stand| told(stand)).sum();
        for (index, stand) in open.into_iter().enumerate() {
            stand.ticks = Some(if index == 0 { more } else { 0 });
            stand.edges = (before, at);
        }
        fits(sum, count * slack)
    }

    /// What has ended by then is over.
    pub(super) fn pass(&mut self, until: u64) {
        for stand in self.0.iter_mut().filter(|stand| stand.until <= until) {
            stand.counted = true;
        }
    }

    /// Returns by how much the end of a command is later: what was found since the last call.
    pub(super) fn take_found(&mut self) -> u64 {
        let found = self.0.iter_mut().filter(|stand| !stand.counted);
        let found = found.filter_map(|stand| {
            stand.counted = stand.ticks.is_some();
            stand.ticks
        });
        found.sum()
    }

    /// A command that is due at `due` begins only at `at`: returns whether a hold lies between that
    /// nothing else has shown.
    pub(super) fn fills_gap(&mut self, due: f64, at: f64, limits: &Limits) -> bool {
        let slack = 2 * limits.stop_begin_ticks;
        let mut stands = self.0.iter_mut();
        let stand = stands.find(|stand| {
            let in_gap = stand.from as f64 <= due + slack as f64 && stand.until as f64 <= at;
            in_gap && !stand.counted
        });
        stand.is_some_and(|stand| {
            stand.counted = true;
            true
        })
    }
}
