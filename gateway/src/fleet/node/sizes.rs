//! How much is kept of one node, see [`crate::fleet::sizes`].

use super::Node;

impl Node {
    /// Returns how many clock probes have no answer yet.
    pub(in crate::fleet) fn probe_count(&self) -> usize {
        self.probes.len()
    }

    /// Returns how many jobs wait for it or are on it, and ways of their commands.
    pub(in crate::fleet) fn job_count(&self) -> usize {
        let on_it = [self.active.is_some(), self.route.is_some()];
        self.waiting.len() + on_it.into_iter().filter(|there| *there).count()
    }

    /// Returns how many wishes of clients it has not fulfilled.
    pub(in crate::fleet) fn wish_count(&self) -> usize {
        usize::from(self.release.is_some()) + usize::from(self.facts.pending_stop.is_some())
    }
}
