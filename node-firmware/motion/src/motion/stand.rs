//! Hold in the middle of raw moves and pauses.
//!
//! They have no ramp, so for them a hold is a time in which nothing happens: at one tick, just
//! behind what the hardware holds, the timeline of all axes stands still, and with
//! [`Motion::resume`] it goes on from that tick. Every interval but the one that the hold lies in is
//! what it would have been, also between two axes; no step is lost and none is added. A motor that
//! can begin and end a raw move at its rate can be held in it.

use super::{
    Hold, Motion, Phase, Place,
    marks::{Mark, What},
};
use crate::{
    Axis, StepBackend, Ticks,
    planner::{Played, command_ticks},
};

impl<B: StepBackend> Motion<'_, B> {
    /// Stands still behind what the hardware holds. Returns whether that is settled: `false` while
    /// a path begins or ends just there.
    pub(super) fn stand_still(&mut self) -> bool {
        let Phase::Playing { timeline } = self.phase else {
            return false;
        };
        if self.is_driving() {
            return false;
        }
        if let Hold::At(_) = self.hold {
            return true;
        }
        let started_at = self.started_at.0;
        let axes = &mut self.backend.axes()[..self.axis_count];
        let (cut, _) = self.planner.cut_ticks(axes, started_at);
        if axes.iter().any(Axis::has_ended) || !self.planner.is_raw_until(cut, axes, started_at) {
            return false;
        }
        if timeline.0 <= cut {
            // It rests by itself, and nothing follows.
            return true;
        }
        let moves = self.marks.iter().filter_map(|mark| {
            let runs = mark.what.runs();
            runs[0]?;
            let begin = mark.end.0.saturating_sub(command_ticks(&runs));
            Some(Played { runs, begin })
        });
        let end = self.planner.leave_raw(cut, moves, axes, started_at);
        self.phase = Phase::Playing {
            timeline: Ticks(end),
        };
        let mut taken_back = 0_usize;
        let mut own: Option<Mark> = None;
        while let Some(mark) = self.marks.take_back(Ticks(cut)) {
            taken_back += 1;
            self.undo_steps(mark.what);
            own = Some(mark);
        }
        // The first of them is under way.
        self.ring.retract(taken_back.saturating_sub(1));
        if let Some(mark) = own {
            let runs = mark.what.runs();
            let left_ticks = mark.end.0 - cut;
            let left_ticks = match runs[0] {
                // Still in the rest before its first edge, it is whole.
                Some(_) => left_ticks.min(command_ticks(&runs)),
                None => left_ticks,
            };
            self.redo_steps(mark.what);
            self.marks.push(Mark {
                end: Ticks(u64::MAX),
                what: mark.what,
            });
            self.hold = Hold::At(Place::Raw { left_ticks });
        }
        true
    }

    /// Goes on at `begin` with what is left of the command that was held; it is the last that is
    /// planned.
    pub(super) fn go_on_raw(&mut self, left_ticks: u64, begin: Ticks) {
        let Some(mark) = self.marks.take_back(self.now) else {
            return;
        };
        let axes = &mut self.backend.axes()[..self.axis_count];
        let ticks = self.planner.plan_left(mark.what.runs(), left_ticks, axes);
        let end = begin.plus(ticks);
        self.phase = Phase::Playing { timeline: end };
        self.dry_by_hold = false;
        self.marks.push(Mark { end, ..mark });
    }

    fn redo_steps(&mut self, what: What) {
        for run in what.runs().into_iter().flatten() {
            self.planned_steps[usize::from(run.axis.0)] += i64::from(run.steps);
        }
    }
}
