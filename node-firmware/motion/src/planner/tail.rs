//! [`Tail`]: where one axis' segments end, and what is still to be written before the next ones.

use crate::{
    axis::Axis,
    limits::WORD_TICKS_MIN,
    segment::{Direction, Segment},
};

/// Where one axis' segments end.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Tail {
    /// Planned rest since the last step's high time, saturating.
    pub(super) low_ticks: u64,
    pub(super) direction: Option<Direction>,
    /// Up to where segments are written, while a path is.
    pub(crate) at: u64,
    /// An edge that is not written: its interval depends on what comes next.
    pub(crate) edge_at: Option<u64>,
}

impl Tail {
    pub(super) const REST: Self = Self {
        low_ticks: u64::MAX,
        direction: None,
        at: 0,
        edge_at: None,
    };

    /// Writes what comes before an edge at `at`, turned to `direction`. Returns its tick: up to two
    /// off where the hardware cannot rest so shortly, which only a change in flight asks for.
    pub(crate) fn approach(&mut self, axis: &mut Axis, at: u64, direction: Direction) -> u64 {
        let at = match self.edge_at {
            Some(edge) => {
                let at = at.max(edge + axis.timing().interval_ticks_min());
                self.release_edge(axis, at);
                at
            }
            // Less than a word cannot be rested: the nearer of both ends.
            None if at > self.at + WORD_TICKS_MIN / 2 => {
                let at = at.max(self.at + WORD_TICKS_MIN);
                self.rest(axis, at);
                at
            }
            None => self.at,
        };
        if self.direction != Some(direction) {
            axis.push(Segment::Turn { direction });
            self.direction = Some(direction);
        }
        at
    }

    /// Writes steps that end at `until`.
    pub(crate) fn steps(&mut self, axis: &mut Axis, segment: Segment, until: u64) {
        axis.push(segment);
        self.at = until;
        self.edge_at = None;
        self.low_ticks = 0;
    }

    /// Writes the edge that waits, with the time up to `until`.
    pub(crate) fn release_edge(&mut self, axis: &mut Axis, until: u64) {
        if let Some(edge) = self.edge_at.take() {
            let ticks = until - edge;
            axis.push(Segment::steady(1, ticks));
            self.low_ticks = ticks - axis.timing().high_of(ticks);
            self.at = until;
        }
    }

    /// Rests up to `until`.
    pub(crate) fn rest(&mut self, axis: &mut Axis, until: u64) {
        if self.edge_at.is_some() {
            self.release_edge(axis, until);
        } else if until > self.at {
            let ticks = until - self.at;
            axis.push(Segment::Low { ticks });
            self.low_ticks = self.low_ticks.saturating_add(ticks);
            self.at = until;
        }
    }
}
