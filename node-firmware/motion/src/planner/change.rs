//! Changes in flight: what is not encoded is left, and a line goes on from there.

use super::{Begun, CUT_MARGIN_TICKS, Made, Planner, Split, Tail, stretch::Stretch, unshared};
use crate::{
    axis::Axis,
    lookahead::Lines,
    path::{Path, State},
    real::Real,
    steps::{Exit, Moment},
};

impl Planner {
    /// Leaves everything that is not encoded. Returns from when on another plan can take effect,
    /// ticks since boot; `started_at` is when the channels were started.
    pub(crate) fn rewind(&mut self, axes: &mut [Axis], started_at: u64) -> u64 {
        let mut cut = 0;
        let mut least = u64::MAX;
        let kept = self.tails.iter_mut().zip(&mut self.rewound);
        for (axis, (tail, made)) in axes.iter_mut().zip(kept) {
            let rewound = axis.rewind();
            *tail = Tail {
                low_ticks: rewound.low_ticks,
                direction: rewound.direction,
                at: started_at + rewound.encoded_ticks,
                edge_at: None,
            };
            *made = Made {
                at: tail.at,
                booked_steps: axis.ledger().booked_steps(),
            };
            cut = cut.max(tail.at);
            least = least.min(tail.at);
        }
        self.is_writing = false;
        self.writing = self.stretches[..self.count]
            .iter()
            .flatten()
            .take_while(|stretch| stretch.end_ticks <= least)
            .count();
        cut + CUT_MARGIN_TICKS
    }

    /// Returns the tick from which on a change in flight would take effect, and whether a ramp or a
    /// line is under way then. All that is not encoded until then must be path, because nothing
    /// else can be written again.
    pub(crate) fn cut_ticks(&self, axes: &[Axis], started_at: u64) -> (u64, bool) {
        let committed = axes.iter().map(Axis::committed_ticks);
        let (mut least, mut most) = (u64::MAX, 0);
        for ticks in committed {
            least = least.min(started_at + ticks);
            most = most.max(started_at + ticks);
        }
        let cut = most + CUT_MARGIN_TICKS;
        let Some(mut index) = self.stretch_at(cut) else {
            return (cut, false);
        };
        let at = |index: usize| self.stretches[index].expect("below the count");
        while index > 0 && at(index - 1).end_ticks == at(index).begin.ticks {
            index -= 1;
        }
        (cut, at(index).begin.ticks <= least)
    }

    /// Returns the way from `now` until rest if the path slowed down as soon as it can, steps of
    /// its longest axis.
    pub(crate) fn way_to_stop(&self, axes: &[Axis], started_at: u64, now: u64) -> Real {
        let (cut, _) = self.cut_ticks(axes, started_at);
        let place_at = |stretch: &Stretch, path: &Path, at: u64| {
            let since = Real::of(at.saturating_sub(stretch.begin.ticks));
            path.state_at(since).place
        };
        let Some(index) = self.stretch_at(cut) else {
            return Real::ZERO;
        };
        let stretch = self.stretches[index].expect("below the count");
        let path = stretch.path();
        let mut slower = path;
        slower.cut(Real::of(cut - stretch.begin.ticks));
        slower.come_to_rest(&stretch.line.law);
        slower.end_steps() - place_at(&stretch, &path, now)
    }

    /// Returns speed and acceleration of an axis with sign where its part of the path can be changed
    /// now, steps a tick and a tick²; `None`: no path is under way there.
    pub(crate) fn pace_of(&self, index: usize, axis: &Axis, started_at: u64) -> Option<[Real; 2]> {
        let cut = started_at + axis.committed_ticks();
        let stretch = self.stretches[self.stretch_at(cut)?].as_ref()?;
        let line = &stretch.line;
        let share = Real::of_signed(line.steps[index]) / Real::of(line.major_steps);
        let since = Real::of(cut - stretch.begin.ticks);
        let State { speed, accel, .. } = stretch.path().state_at(since);
        Some([speed * share, accel * share])
    }

    /// Returns whether a change in flight would take effect within the last line that is planned.
    pub(crate) fn is_last_under_way(&self, axes: &[Axis], started_at: u64) -> bool {
        let (cut, on_path) = self.cut_ticks(axes, started_at);
        on_path && self.stretch_at(cut) == self.count.checked_sub(1)
    }

    pub(super) fn stretch_at(&self, ticks: u64) -> Option<usize> {
        self.stretches[..self.count]
            .iter()
            .flatten()
            .position(|stretch| stretch.begin.ticks <= ticks && ticks < stretch.end_ticks)
    }

    /// Ends the stretch that is under way at `cut`, drops those behind it, and gives its line to
    /// go on with.
    pub(crate) fn split(&mut self, cut: u64) -> Option<Split> {
        let index = self.stretch_at(cut)?;
        self.count = index + 1;
        self.left = None;
        self.ahead.clear();
        let stretch = self.stretches[index].as_mut()?;
        if stretch.begin.ticks == cut {
            // It has not begun: a change on top of another.
            let Stretch {
                line,
                mut from,
                begin,
                share,
                base_steps,
                ..
            } = *stretch;
            self.count = index;
            self.writing = self.writing.min(index);
            if line.law.jerk().is_none() {
                from.accel = Real::ZERO;
            }
            return Some(Split {
                line: unshared(line, share),
                from,
                at: begin,
                base_steps,
            });
        }
        let since = Real::of(cut - stretch.begin.ticks) - stretch.begin.part;
        let mut from = stretch.path().state_at(since);
        if stretch.line.law.jerk().is_none() {
            // Its acceleration may end at once.
            from.accel = Real::ZERO;
        }
        stretch.until = Some(since);
        stretch.exit = Exit::Moving;
        stretch.end_ticks = cut;
        let (line, base_steps) = (stretch.line, stretch.base_steps);
        Some(Split {
            line: unshared(line, stretch.share),
            from,
            at: Moment::of(cut),
            base_steps,
        })
    }

    /// Goes on after a split: comes to rest if it is held.
    pub(crate) fn go_on(&mut self, split: Split, behind: impl Lines, axes: &[Axis]) -> Begun {
        let Split {
            line,
            from,
            at,
            base_steps,
        } = split;
        let moving = !from.speed.is_none();
        self.begin_at(line, from, behind, at, moving, base_steps, axes)
    }
}
