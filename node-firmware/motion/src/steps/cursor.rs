//! [`Cursor`]: the edges of one axis, put together to segments.
//!
//! A segment is a parabola: the time of its edge x changes evenly. It goes through the first edge and
//! through the one behind the last, and its interval grows by what that of the path does between them.
//! Of a path t(x) it is then off by less than n³ / 96 times the greatest third derivative of t, n edges
//! long:
//!
//! ```text
//!   t' = r / v    t'' = -r²·a / v³    |t'''| ≤ r³·(3a² + |j|·v) / v⁵
//!
//!   r: way of the path for a step   v, a, j: speed, acceleration, jerk
//! ```
//!
//! So n follows from speed and acceleration by logarithms of 16 bits, and no edge between is asked for. At
//! constant speed nothing is off; for a curve, which knows no derivatives, edges between are asked for.

use super::Moment;
use crate::{
    path::{Course, Pass, Path, Span},
    real::Real,
    segment::{Direction, FRACTION_BITS, Segment},
};

/// Most steps of one segment: what the interval's rounding allows.
const STEPS_MAX: u64 = 1 << 20;

/// Most steps of one segment with changing intervals: what the change's rounding allows.
const CHANGING_STEPS_MAX: u64 = 1 << 11;

/// log₂ of 96 · 0.22 ticks, 2⁻¹⁶.
const OFF_LOG: i32 = 288_400;

/// log₂ 3, 2⁻¹⁶.
const THREE_LOG: i32 = 103_872;

/// 1 in 2⁻¹⁶.
const ONE_LOG: i32 = 1 << 16;

/// The edges of one axis that are still to come.
#[derive(Clone, Copy, Debug)]
pub(super) struct Cursor {
    /// Way of the path for one step of this axis, and three times its logarithm.
    ratio: Real,
    ratio_log: i32,
    direction: Direction,
    /// Number of the next edge, from 1.
    next: u64,
    /// Number of the last one.
    last: u64,
    /// How the next edge is passed.
    pass: Pass,
    /// Interval there, r / v; and its change from one edge to the next as it was found last.
    pace: Real,
    change: Real,
    /// Its tick, once what comes before it is pushed.
    at: Option<u64>,
    /// The phase of the path in which the next edge lies, and the last edge in it.
    span: Span,
    span_last: u64,
    /// How many steps the next segment of a curve may have.
    guess: u64,
}

impl Cursor {
    /// Returns the edges of an axis that makes so many steps, with sign, while the path goes from 0 to
    /// `major_steps`; `None` if it makes none on this part of the path.
    pub(super) fn of(path: &Path, count: i64, major_steps: u64) -> Option<Self> {
        let steps = count.unsigned_abs();
        if steps == 0 {
            return None;
        }
        let ratio = if steps == major_steps {
            Real::of(1)
        } else {
            Real::of(major_steps) / Real::of(steps)
        };
        // The edges within [from, to): k − ½ > from/ratio.
        let before = |place: Real| number(place, ratio).min(steps);
        let next = before(path.begin_steps()) + 1;
        let last = before(path.end_steps());
        if next > last {
            return None;
        }
        let (span, pass) = path.enter(place(ratio, next));
        let mut cursor = Self {
            ratio,
            ratio_log: 3 * ratio.log(),
            direction: Direction::of(count),
            next,
            last,
            pass,
            pace: Real::ZERO,
            change: Real::ZERO,
            at: None,
            span,
            span_last: 0,
            guess: 2,
        };
        cursor.enter(path);
        Some(cursor)
    }

    pub(super) fn direction(&self) -> Direction {
        self.direction
    }

    /// Returns the number of the next edge, from 1.
    pub(super) fn next(&self) -> u64 {
        self.next
    }

    /// Returns the number of the last edge.
    pub(super) fn last(&self) -> u64 {
        self.last
    }

    /// Returns when the next edge is due, ticks from the path's begin.
    pub(super) fn due(&self) -> Real {
        self.pass.ticks
    }

    /// Returns when the last edge is due.
    pub(super) fn last_due(&self, path: &Path) -> Real {
        path.ticks_at(self.place(self.last))
    }

    /// Returns the tick of the next edge, if what comes before it is pushed.
    pub(super) fn at(&self) -> Option<u64> {
        self.at
    }

    /// What comes before the next edge is pushed; this is its tick.
    pub(super) fn begin_at(&mut self, at: u64) {
        self.at = Some(at);
    }

    /// Leaves out the edges up to this one, if they are not made.
    pub(super) fn skip(&mut self, path: &Path, made: u64) {
        if made >= self.next {
            self.next = made + 1;
            (self.span, self.pass) = path.enter(self.place(self.next));
            self.enter(path);
        }
    }

    fn place(&self, number: u64) -> Real {
        place(self.ratio, number)
    }

    /// The next edge lies in another phase than the one before, and how it is passed is known.
    fn enter(&mut self, path: &Path) {
        let end = path.span_end_steps(&self.span);
        self.span_last = number(end, self.ratio).max(self.next);
        self.pace = self.interval_of(&self.pass);
        self.change = Real::ZERO;
        self.guess = 2;
    }

    /// Interval of steps at this speed; 0 if there is none.
    fn interval_of(&self, pass: &Pass) -> Real {
        if pass.speed.is_none() {
            Real::ZERO
        } else {
            self.ratio / pass.speed
        }
    }

    /// Returns the next segment and goes on behind it. Not for the last edge.
    pub(super) fn segment(&mut self, path: &Path, begin: Moment, at: u64) -> Segment {
        let first = self.pass.ticks;
        let most = self.last.min(self.span_last) - self.next;
        let fit = if most == 0 {
            self.one_on(path, first)
        } else {
            match self.span.course() {
                Course::Steady => self.steady(path, first, most),
                Course::Changing { jerk_log } => self.changing(path, first, most, jerk_log),
                Course::Bent => self.bent(path, first, most),
            }
        };
        let offset = begin.plus(first);
        let offset = match at.saturating_sub(offset.ticks) {
            0 => offset.part,
            late => offset.part - Real::of(late),
        };
        let next_at = begin.plus(self.pass.ticks).rounded().max(at + 1);
        self.at = Some(next_at);
        Segment::Steps {
            step_count: u32::try_from(fit.count).unwrap_or(u32::MAX),
            offset: offset.shifted(FRACTION_BITS as i32).rounded() as i32,
            interval: fit.interval.shifted(FRACTION_BITS as i32).rounded().max(0) as u64,
            change: fit.change.shifted(FRACTION_BITS as i32).rounded(),
            total_ticks: next_at - at,
        }
    }

    /// One step on into the next phase.
    fn one_on(&mut self, path: &Path, first: Real) -> Fit {
        self.next += 1;
        (self.span, self.pass) = path.enter(self.place(self.next));
        self.enter(path);
        Fit::of_one(first, self.pass.ticks)
    }

    /// Steps at constant speed.
    fn steady(&mut self, path: &Path, first: Real, most: u64) -> Fit {
        let count = if self.pace.is_none() {
            // It rests: an edge at the very end of the path.
            1
        } else {
            most.min(STEPS_MAX)
        };
        self.next += count;
        self.pass = path.pass(&self.span, self.place(self.next), first);
        if count == 1 {
            return Fit::of_one(first, self.pass.ticks);
        }
        Fit {
            count,
            interval: self.pace,
            change: Real::ZERO,
        }
    }

    /// Steps that are accelerated.
    fn changing(&mut self, path: &Path, first: Real, most: u64, jerk_log: Option<i32>) -> Fit {
        let before = self.pass;
        // It may have to be shorter farther on.
        let longest = self.longest(&before, &before, jerk_log);
        let mut count = (longest - longest / 16).min(most);
        loop {
            let ahead = match jerk_log {
                Some(_) => {
                    let n = Real::of(count);
                    first + (self.pace + self.change * n.half()) * n
                }
                None => first,
            };
            let place = self.place(self.next + count);
            let pass = path.pass(&self.span, place, ahead);
            if count > 1 {
                let longest = self.longest(&before, &pass, jerk_log);
                if longest < count {
                    count = longest - longest / 16;
                    continue;
                }
            }
            let pace = self.interval_of(&pass);
            let change = (pace - self.pace).over(count as u32);
            let is_even = count > CHANGING_STEPS_MAX;
            if is_even {
                // A change that adds up to less than 1/128 of a tick is none.
                let sum = (change * Real::of(count).squared()).abs();
                if sum.shifted(7).fixed(0) != 0 {
                    count = CHANGING_STEPS_MAX;
                    continue;
                }
            }
            self.next += count;
            (self.pass, self.pace, self.change) = (pass, pace, change);
            if count == 1 {
                return Fit::of_one(first, pass.ticks);
            }
            let change = if is_even { Real::ZERO } else { change };
            let mean = (pass.ticks - first).over(count as u32);
            return Fit {
                count,
                interval: mean - change * Real::of(count - 1).half(),
                change,
            };
        }
    }

    /// Steps of a curve: what a segment is off is looked up in its quarters.
    fn bent(&mut self, path: &Path, first: Real, most: u64) -> Fit {
        let place = self.place(self.next);
        path.know(&mut self.span, place, first);
        let due = |number: u64| path.pass(&self.span, self.place(number), first);
        let mut count = self.guess.min(most).min(STEPS_MAX);
        let (fit, better, last) = loop {
            if count > 1 {
                // Its half is a step.
                count &= !1;
            }
            let last = due(self.next + count);
            if count == 1 {
                break (Fit::of_one(first, last.ticks), 2, last);
            }
            let n = Real::of(count);
            let half = count / 2;
            let middle = due(self.next + half).ticks;
            let mean = (last.ticks - first).over(count as u32);
            let early = (middle - first).over(half as u32);
            let mut change = (mean - early).over(count as u32).shifted(2);
            if (change * n.squared()).abs().shifted(7).fixed(0) == 0 {
                change = Real::ZERO;
            }
            let interval = mean - change * (n - Real::of(1)).half();
            let error = |number: u64| {
                if number == 0 || number == half {
                    return Real::ZERO;
                }
                let x = Real::of(number);
                let made = first + (interval + change * (x - Real::of(1)).half()) * x;
                (made - due(self.next + number).ticks).abs()
            };
            let error = error(count / 4).max(error(3 * count / 4));
            let better = (count * eighths(error) / 8).min(STEPS_MAX);
            let small = change == Real::ZERO || count <= CHANGING_STEPS_MAX;
            if small && error.shifted(2).fixed(0) == 0 {
                let fit = Fit {
                    count,
                    interval,
                    change,
                };
                break (fit, better.max(2), last);
            }
            count = better.min(count - 2).max(2);
            if !small {
                count = count.min(CHANGING_STEPS_MAX);
            }
        };
        self.guess = better;
        self.next += fit.count;
        self.pass = last;
        fit
    }

    /// Returns how many steps a segment between two places may have, from 1.
    fn longest(&self, from: &Pass, to: &Pass, jerk_log: Option<i32>) -> u64 {
        let speed = from.speed.min(to.speed);
        if speed.is_none() {
            return 1;
        }
        let speed = speed.log();
        let accel = from.accel.max(to.accel);
        let bend = (!accel.is_none()).then(|| THREE_LOG + 2 * accel.log());
        let bend = match (bend, jerk_log.map(|jerk| jerk + speed)) {
            (Some(accel), Some(jerk)) => log_of_sum(accel, jerk),
            (Some(either), None) | (None, Some(either)) => either,
            (None, None) => return STEPS_MAX,
        };
        let log = (OFF_LOG + 5 * speed - self.ratio_log - bend) / 3;
        if log < ONE_LOG {
            return 1;
        }
        let (whole, share) = (log >> 16, (log & 0xffff) as u64);
        if whole >= STEPS_MAX.ilog2() as i32 {
            return STEPS_MAX;
        }
        // 2^x is near to 1 + x - 0.34·x·(1 − x).
        let bent = (share * (0x1_0000 - share)) >> 16;
        let power = 0x1_0000 + share - ((bent * 22_500) >> 16);
        (power << whole) >> 16
    }
}

/// Returns the place of an edge on the path.
fn place(ratio: Real, number: u64) -> Real {
    ratio * Real::of(2 * number - 1).half()
}

/// Returns the number of the last edge before a place, 0 if there is none.
fn number(place: Real, ratio: Real) -> u64 {
    if place.is_none() {
        return 0;
    }
    let number = if ratio == Real::of(1) {
        place
    } else {
        place / ratio
    };
    number.rounded().max(0) as u64
}

/// Returns the logarithm of a sum from those of its parts; not too small.
fn log_of_sum(a: i32, b: i32) -> i32 {
    let (large, small) = if a > b { (a, b) } else { (b, a) };
    // log₂(1 + 2^-d) at the begin of each whole d.
    let more = match (large - small) >> 16 {
        0 => 65_536,
        1 => 38_336,
        2 => 21_098,
        3 => 11_137,
        4 => 5_732,
        _ => 2_909,
    };
    large + more
}

/// A segment between edges that lie where the path says.
struct Fit {
    count: u64,
    interval: Real,
    change: Real,
}

impl Fit {
    fn of_one(first: Real, last: Real) -> Self {
        Self {
            count: 1,
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
