//! When somebody wants to be called again: at most one time each. Owns the order of those times.

use keys::FleetMicros;
use std::collections::{BTreeMap, BTreeSet};

/// One time for each name, kept in both directions.
#[derive(Debug)]
pub(super) struct Timers<K> {
    by_time: BTreeSet<(FleetMicros, K)>,
    by_name: BTreeMap<K, FleetMicros>,
}

impl<K> Default for Timers<K> {
    fn default() -> Self {
        Self {
            by_time: BTreeSet::new(),
            by_name: BTreeMap::new(),
        }
    }
}

impl<K: Copy + Ord> Timers<K> {
    /// Replaces somebody's time. One that is due already is put behind `now`: it would be called
    /// again without time having passed.
    pub(super) fn set(&mut self, name: K, due: Option<FleetMicros>, now: FleetMicros) {
        if let Some(at) = self.by_name.remove(&name) {
            self.by_time.remove(&(at, name));
        }
        if let Some(at) = due {
            let at = at.max(now.plus_us(1));
            self.by_time.insert((at, name));
            self.by_name.insert(name, at);
        }
    }

    /// Returns how many wait.
    pub(super) fn len(&self) -> usize {
        self.by_name.len()
    }

    /// Returns the next time.
    pub(super) fn first(&self) -> Option<FleetMicros> {
        self.by_time.first().map(|(at, _)| *at)
    }

    /// Returns whose time has come, once.
    pub(super) fn take_due(&mut self, now: FleetMicros) -> Option<K> {
        let (at, name) = *self.by_time.first()?;
        if at > now {
            return None;
        }
        self.by_time.remove(&(at, name));
        self.by_name.remove(&name);
        Some(name)
    }
}
