//! [`Steps`]: a path turned into segments, for all axes of one command.
//!
//! Edge k of an axis with n steps is due when the path passes (k − ½)·N/n: in the middle of its
//! step, at its own ideal time, not at that of the axis with most steps. Edges are put together to
//! segments with evenly changing intervals, as many as stay within a quarter of a tick of the
//! ideal (`steps/cursor.rs`): one edge each at the first steps from rest, thousands at constant speed.
//!
//! Ends are kept together across commands: the last edge of a line that is left at speed waits
//! ([`Tail::edge_at`]) until the first edge of the next line gives its interval.

mod cursor;

use crate::{
    axis::Axis,
    limits::WORD_TICKS_MIN,
    path::{Path, State},
    planner::Tail,
    profile::Timing,
    real::Real,
    segment::Direction,
};
use cursor::Cursor;

/// What a rest keeps back at the end of a line that is left at speed: the next rest of this axis
/// may be shorter than a word, and is added to it.
const KEPT_TICKS: u64 = 2 * WORD_TICKS_MIN;

/// Segments that one edge may need: what was before, turn, steps.
const SEGMENTS: usize = 4;

/// A point of the timeline between ticks.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Moment {
    /// Whole ticks.
    pub(crate) ticks: u64,
    /// Part of a tick, 0 to 1.
    pub(crate) part: Real,
}

impl Moment {
    pub(crate) const fn of(ticks: u64) -> Self {
        Self {
            ticks,
            part: Real::ZERO,
        }
    }

    /// Returns this much later.
    pub(crate) fn plus(self, ticks: Real) -> Self {
        let (whole, part) = (self.part + ticks).split();
        Self {
            ticks: self.ticks.saturating_add(whole as u64),
            part,
        }
    }

    /// Returns the nearest whole tick.
    pub(crate) fn rounded(self) -> u64 {
        self.ticks + u64::from(self.part.twice() >= Real::of(1))
    }
}

/// How a command ends.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Exit {
    /// All axes rest.
    Rest,
    /// The next line follows at speed.
    Moving,
}

/// The segments of one command that are still to come.
#[derive(Clone, Debug)]
pub(crate) struct Steps<const AXES: usize> {
    path: Path,
    begin: Moment,
    /// End of the command.
    end_ticks: u64,
    exit: Exit,
    cursors: [Option<Cursor>; AXES],
}

impl<const AXES: usize> Steps<AXES> {
    /// No steps, before [`Steps::take`].
    pub(crate) const NONE: Self = Self {
        path: Path::at(State::REST),
        begin: Moment::of(0),
        end_ticks: 0,
        exit: Exit::Rest,
        cursors: [None; AXES],
    };

    /// Returns the path, to be planned where it lies before [`Steps::take`].
    pub(crate) fn path_mut(&mut self) -> &mut Path {
        &mut self.path
    }

    /// Takes the steps with sign that each axis makes while the path goes from 0 to `major_steps`.
    pub(crate) fn take(
        &mut self,
        begin: Moment,
        exit: Exit,
        major_steps: u64,
        steps: [i64; AXES],
        timing: &[Timing],
    ) {
        let path = &self.path;
        let end = begin.plus(path.ticks());
        let mut end_ticks = match exit {
            Exit::Rest => end.rounded(),
            Exit::Moving => end.ticks,
        };
        for (index, count) in steps.into_iter().enumerate() {
            let cursor = Cursor::of(path, count, major_steps);
            if let Some(cursor) = &cursor
                && exit == Exit::Rest
                && count.unsigned_abs() == major_steps
            {
                // The last step wants its low time too, however hard it brakes.
                let edge = begin.plus(cursor.last_due(path)).rounded();
                end_ticks = end_ticks.max(edge + timing[index].interval_ticks_min());
            }
            self.cursors[index] = cursor;
        }
        self.begin = begin;
        self.end_ticks = end_ticks;
        self.exit = exit;
    }

    /// Returns when the command ends.
    pub(crate) fn end(&self) -> Moment {
        match self.exit {
            Exit::Rest => Moment::of(self.end_ticks),
            Exit::Moving => self.begin.plus(self.path.ticks()),
        }
    }

    /// Returns the tick of the first edge of an axis, `None` if it makes none.
    pub(crate) fn first_edge(&self, axis: usize) -> Option<(u64, Direction)> {
        let cursor = self.cursors[axis].as_ref()?;
        Some((self.begin.plus(cursor.due()).rounded(), cursor.direction()))
    }

    /// Returns when the command begins.
    pub(crate) fn begin(&self) -> Moment {
        self.begin
    }

    /// Leaves out the edges of an axis that are encoded already; `booked` is how many steps with
    /// sign were, since the line began.
    pub(crate) fn skip(&mut self, axis: usize, booked: i64) {
        let Some(cursor) = self.cursors[axis].as_mut() else {
            return;
        };
        let made = booked
            .saturating_mul(i64::from(cursor.direction().sign()))
            .max(0) as u64;
        if made >= cursor.last() {
            self.cursors[axis] = None;
        } else {
            cursor.skip(&self.path, made);
        }
    }

    /// Returns how many edges of an axis up to its edge `whole`, or to its last one, are not put into
    /// segments; the last one may wait beside.
    pub(crate) fn left(&self, axis: usize, whole: u64) -> u64 {
        let cursor = self.cursors[axis].as_ref();
        cursor.map_or(0, |cursor| cursor.last().max(whole) + 1 - cursor.next())
    }

    /// Begins this much later.
    pub(crate) fn delay(&mut self, ticks: u64) {
        self.begin.ticks += ticks;
        self.end_ticks += ticks;
    }

    /// Writes as many segments as fit. Returns whether all are written.
    pub(crate) fn write(&mut self, axes: &mut [Axis], tails: &mut [Tail]) -> bool {
        let mut done = true;
        for (index, (axis, tail)) in axes.iter_mut().zip(tails).enumerate() {
            done &= self.write_axis(index, axis, tail);
        }
        done
    }

    /// Writes as many segments of one axis as fit. Returns whether all are written.
    pub(crate) fn write_axis(&mut self, index: usize, axis: &mut Axis, tail: &mut Tail) -> bool {
        if self.cursors[index].is_none() {
            return self.write_rest(axis, tail);
        }
        while let Some(cursor) = self.cursors[index].as_mut() {
            if axis.room() < SEGMENTS {
                return false;
            }
            let Some(at) = cursor.at() else {
                let at = self.begin.plus(cursor.due()).rounded();
                cursor.begin_at(tail.approach(axis, at, cursor.direction()));
                continue;
            };
            if cursor.next() == cursor.last() {
                self.write_last(at, axis, tail);
                self.cursors[index] = None;
                return self.write_rest(axis, tail);
            }
            let (begin, path) = (self.begin, &self.path);
            let segment = cursor.segment(path, begin, at);
            tail.steps(axis, segment, at + segment.ticks());
        }
        true
    }

    /// The last edge of an axis in this command, at `at`.
    fn write_last(&self, at: u64, axis: &mut Axis, tail: &mut Tail) {
        tail.edge_at = Some(at);
        tail.at = at;
        let least = axis.timing().interval_ticks_min();
        let rest = self.end_ticks.saturating_sub(at);
        if self.exit == Exit::Rest {
            tail.release_edge(axis, self.end_ticks.max(at + least));
        } else if rest >= least + 2 * KEPT_TICKS {
            tail.release_edge(axis, self.end_ticks - KEPT_TICKS);
        }
    }

    /// No more edges: rest until the end of the command.
    fn write_rest(&self, axis: &mut Axis, tail: &mut Tail) -> bool {
        let until = match self.exit {
            Exit::Rest => self.end_ticks,
            Exit::Moving => self.end_ticks.saturating_sub(KEPT_TICKS),
        };
        let least = axis.timing().interval_ticks_min();
        if tail.edge_at.is_some_and(|edge| edge + least > until) || tail.at >= until {
            return true;
        }
        if axis.room() < SEGMENTS {
            return false;
        }
        tail.rest(axis, until);
        true
    }
}

#[cfg(test)]
mod tests;
