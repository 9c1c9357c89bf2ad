//! [`Steps`]: a path turned into segments, for all axes of one command.
//!
//! Edge k of an axis with n steps is due when the path passes (k − ½)·N/n: in the middle of its
//! step, at its own ideal time, not at that of the axis with most steps. Edges are put together to
//! segments with evenly changing intervals, as many as stay within a quarter of a tick of the
//! ideal: one edge each at the first steps from rest, thousands at constant speed.
//!
//! Ends are kept together across commands: the last edge of a line that is left at speed waits
//! ([`Tail::edge_at`]) until the first edge of the next line gives its interval.

use crate::{
    axis::Axis,
    limits::WORD_TICKS_MIN,
    path::{Path, Span},
    planner::Tail,
    profile::Timing,
    real::Real,
    segment::{Direction, FRACTION_BITS, Segment},
};

/// Most steps of one segment: what the interval's rounding allows.
const STEPS_MAX: u64 = 1 << 20;

/// Most steps of one segment with changing intervals: what the change's rounding allows.
const CHANGING_STEPS_MAX: u64 = 1 << 11;

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
        let sum = self.part + ticks;
        let whole = sum.fixed(0);
        Self {
            ticks: self.ticks.saturating_add(whole as u64),
            part: sum - Real::of_signed(whole),
        }
    }

    /// Returns the nearest whole tick.
    pub(crate) fn rounded(self) -> u64 {
        self.ticks + u64::from(self.part.twice() >= Real::of(1))
    }
}

/// The edges of one axis that are still to come.
#[derive(Clone, Copy, Debug)]
struct Cursor {
    /// Way of the path for one step of this axis.
    ratio: Real,
    direction: Direction,
    /// Number of the next edge, from 1.
    next: u64,
    /// Number of the last one.
    last: u64,
    /// When the next edge is due, ticks from the path's begin.
    due: Real,
    /// Its tick, once what comes before it is pushed.
    at: Option<u64>,
    /// How many steps the next segment may have.
    guess: u64,
    /// The phase of the path in which the next edge lies, and the last edge in it.
    span: Option<Span>,
    span_last: u64,
    /// Interval at the next edge, and its change from one to the next, ticks.
    pace: [Real; 2],
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
    /// Takes a path and the steps with sign that each axis makes while it goes from 0 to
    /// `major_steps`.
    pub(crate) fn new(
        path: Path,
        begin: Moment,
        exit: Exit,
        major_steps: u64,
        steps: [i64; AXES],
        timing: &[Timing],
    ) -> Self {
        let mut cursors = [None; AXES];
        let from = path.begin_steps();
        let to = path.end_steps();
        let mut end_ticks = begin.plus(path.ticks()).rounded();
        if exit == Exit::Moving {
            end_ticks = begin.plus(path.ticks()).ticks;
        }
        for (index, count) in steps.into_iter().enumerate() {
            if count == 0 {
                continue;
            }
            let ratio = Real::of(major_steps) / Real::of(count.unsigned_abs());
            // The edges within [from, to): k − ½ > from/ratio.
            let before = |place: Real| {
                let number = (place / ratio).rounded().max(0) as u64;
                number.min(count.unsigned_abs())
            };
            let (next, last) = (before(from) + 1, before(to));
            if next > last {
                continue;
            }
            let mut cursor = Cursor {
                ratio,
                direction: Direction::of(count),
                next,
                last,
                due: Real::ZERO,
                at: None,
                guess: 2,
                span: None,
                span_last: 0,
                pace: [Real::ZERO; 2],
            };
            cursor.due = path.ticks_at(cursor.place(next));
            if exit == Exit::Rest && ratio == Real::of(1) {
                // The last step wants its low time too, however hard it brakes.
                let edge = begin.plus(path.ticks_at(cursor.place(last))).rounded();
                end_ticks = end_ticks.max(edge + timing[index].interval_ticks_min());
            }
            cursors[index] = Some(cursor);
        }
        Self {
            path,
            begin,
            end_ticks,
            exit,
            cursors,
        }
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
        Some((self.begin.plus(cursor.due).rounded(), cursor.direction))
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
            .saturating_mul(i64::from(cursor.direction.sign()))
            .max(0) as u64;
        if made >= cursor.last {
            self.cursors[axis] = None;
        } else if made >= cursor.next {
            cursor.next = made + 1;
            cursor.due = self.path.ticks_at(cursor.place(cursor.next));
        }
    }

    /// Returns how many edges of an axis up to its edge `whole`, or to its last one, are not put into
    /// segments; the last one may wait beside.
    pub(crate) fn left(&self, axis: usize, whole: u64) -> u64 {
        let cursor = self.cursors[axis].as_ref();
        cursor.map_or(0, |cursor| cursor.last.max(whole) + 1 - cursor.next)
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
            let Some(at) = cursor.at else {
                let at = self.begin.plus(cursor.due).rounded();
                cursor.at = Some(tail.approach(axis, at, cursor.direction));
                continue;
            };
            let left = cursor.last - cursor.next;
            if left == 0 {
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

impl Cursor {
    fn place(&self, number: u64) -> Real {
        self.ratio * Real::of(2 * number - 1).half()
    }

    /// Returns the next segment and goes on behind it. Not for the last edge.
    fn segment(&mut self, path: &Path, begin: Moment, at: u64) -> Segment {
        if self.next > self.span_last {
            let end = path.phase_end_steps(self.place(self.next));
            let last = (end / self.ratio).rounded().max(0) as u64;
            self.span_last = last.max(self.next);
            self.span = None;
        }
        let first = self.due;
        let fit = if self.next == self.span_last {
            // On into the next phase.
            let last = path.ticks_at(self.place(self.next + 1));
            Fit::of_one(first, last)
        } else {
            let place = self.place(self.next);
            let mut span = self.span.take().unwrap_or_else(|| path.span_at(place));
            span.know(place, first);
            let fit = self.fit(&span, first);
            self.span = Some(span);
            fit
        };
        self.guess = fit.better;
        let offset = begin.plus(first);
        let offset = offset.part - Real::of(at - offset.ticks.min(at));
        let next_at = begin.plus(fit.last).rounded().max(at + 1);
        let segment = Segment::Steps {
            step_count: u32::try_from(fit.count).unwrap_or(u32::MAX),
            offset: offset.shifted(FRACTION_BITS as i32).rounded() as i32,
            interval: fit.interval.shifted(FRACTION_BITS as i32).rounded().max(0) as u64,
            change: fit.change.shifted(FRACTION_BITS as i32).rounded(),
            total_ticks: next_at - at,
        };
        self.next += fit.count;
        self.due = fit.last;
        self.at = Some(next_at);
        self.pace = [fit.interval + fit.change * Real::of(fit.count), fit.change];
        segment
    }

    /// Returns the longest segment that is surely within a quarter of a tick of the ideal, from the
    /// next edge on, which is due at `first`.
    fn fit(&self, span: &Span, first: Real) -> Fit {
        let most = self.last.min(self.span_last) - self.next;
        let [pace, change] = self.pace;
        let due = |number: u64, guess: Real| span.ticks_near(self.place(number), guess);
        let mut count = self.guess.min(most).min(STEPS_MAX);
        loop {
            if count > 1 {
                // Its half is a step.
                count &= !1;
            }
            let n = Real::of(count);
            let ahead = first + pace * n + change * n.squared().half();
            let last = due(self.next + count, ahead);
            if count == 1 {
                return Fit::of_one(first, last);
            }
            let half = count / 2;
            let middle = due(self.next + half, (first + last).half());
            let inverse = Real::of(1) / n;
            let mean = (last - first) * inverse;
            let early = ((middle - first) * inverse).twice();
            let mut change = ((mean - early) * inverse).shifted(2);
            if (change * n.squared()).abs().shifted(7).fixed(0) == 0 {
                // It adds up to less than 1/128 of a tick: constant speed.
                change = Real::ZERO;
            }
            let interval = mean - change * (n - Real::of(1)).half();
            let error = |number: u64| {
                if number == 0 || number == half {
                    return Real::ZERO;
                }
                let x = Real::of(number);
                let made = first + (interval + change * (x - Real::of(1)).half()) * x;
                (made - due(self.next + number, made)).abs()
            };
            let error = error(count / 4).max(error(3 * count / 4));
            let better = (count * eighths(error) / 8).min(STEPS_MAX);
            let small = change == Real::ZERO || count <= CHANGING_STEPS_MAX;
            if small && error.shifted(2).fixed(0) == 0 {
                return Fit {
                    count,
                    better: better.max(2),
                    last,
                    interval,
                    change,
                };
            }
            count = better.min(count - 2).max(2);
            if !small {
                count = count.min(CHANGING_STEPS_MAX);
            }
        }
    }
}

/// A segment between edges that lie where the path says.
struct Fit {
    count: u64,
    /// How many steps the next one may have.
    better: u64,
    /// When the edge behind it is due.
    last: Real,
    interval: Real,
    change: Real,
}

impl Fit {
    fn of_one(first: Real, last: Real) -> Self {
        Self {
            count: 1,
            better: 2,
            last,
            interval: last - first,
            change: Real::ZERO,
        }
    }
}

/// Returns how much longer a segment could be that is so far off the ideal, in eighths: what
/// evenly changing intervals leave out grows with the cube of the length.
fn eighths(error: Real) -> u64 {
    // 0.22 ticks, 2⁻¹⁰, times 8³.
    const MOST: u64 = 115_343;
    const LONGEST: u64 = 32;
    let error = error.fixed(10).unsigned_abs();
    let (mut low, mut high) = (1, LONGEST + 1);
    while low + 1 < high {
        let middle = (low + high) / 2;
        if (error + 1).saturating_mul(middle * middle * middle) <= MOST {
            low = middle;
        } else {
            high = middle;
        }
    }
    low
}
