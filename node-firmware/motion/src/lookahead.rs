//! How fast a line may be left, given the lines behind it.
//!
//! Consecutive lines are one path. At a corner the tool keeps its speed w (steps per tick, in the
//! straight-line measure of step space, |n| = √Σn²), so the speed of axis i jumps by
//! w·|n_i/|n| − m_i/|m||. That jump is limited for each axis; where the path goes straight on it
//! is 0 and the corner costs nothing.
//!
//! Many small jumps in a row are an acceleration: a curve in short lines. So each jump must also
//! last as long as the lines' acceleration a needs for it, in the time from the middle of the line
//! before to the middle of the line behind: w·|n_i/|n| − m_i/|m|| ≤ a·(|n| + |m|) / 2w for each
//! axis. Around a circle of radius r that is the textbook's w² ≤ a·r. A corner of long lines is
//! bounded by its jump alone.
//!
//! From the last line that is known, which must be able to end at rest, the speeds are found
//! backwards: before a line, no faster than what can be slowed down within it. Where a corner or a line
//! allows no more than that anyway, nothing that may still follow changes it: the speeds before are
//! settled. So the lines are looked at in bursts, as many as there is room for, and only when the
//! next speed is not settled: each of them once or twice, not once for every line before it.

use crate::{
    law::{Approach, Law, Pace, speed_from_hz},
    profile::Timing,
    real::Real,
};
use keys::{
    Command,
    command::{LINE_AXES, RampShape},
};

/// Lines behind the present one that are looked at. With 1 mm lines at 100 mm/s: 640 ms.
pub const LINES_MAX: usize = 64;

/// The pulses of fewer steps than this last a time that 64 bits hold.
const SHORT_STEPS_MAX: u64 = 1 << 40;

/// One line, in the measure of its axis with most steps (its place runs from 0 to `major_steps`).
#[derive(Clone, Copy, Debug)]
pub struct Line {
    /// Steps with sign of each axis.
    pub steps: [i64; LINE_AXES],
    /// Steps of the axis with most of them.
    pub major_steps: u64,
    /// Speed of that axis at most, steps per tick.
    pub speed_max: Real,
    /// How that axis gains speed.
    pub law: Law,
    /// |n| / `major_steps`, from 1 to 2.
    pub stretch: Real,
    /// It may be left at speed; a ramp ends at rest.
    pub joins: bool,
}

impl Line {
    /// Makes a line of at least one step that gains speed by this law.
    ///
    /// # Panics
    /// No steps.
    pub fn new(steps: [i64; LINE_AXES], speed_max: Real, law: Law) -> Self {
        let major_steps = steps.map(i64::unsigned_abs).into_iter().max();
        let major_steps = major_steps.expect("there are axes");
        assert!(major_steps > 0, "a line has steps");
        let others = steps.iter().filter(|count| **count != 0).count() > 1;
        let stretch = if others {
            let squares = steps.iter().fold(Real::ZERO, |sum, count| {
                sum + Real::of(count.unsigned_abs()).squared()
            });
            squares.root() / Real::of(major_steps)
        } else {
            Real::of(1)
        };
        Self {
            steps,
            major_steps,
            speed_max,
            law,
            stretch,
            joins: true,
        }
    }

    /// Returns the way of a [`Command::Line`] that has steps, `None` for other commands.
    pub(crate) fn of(command: &Command) -> Option<Self> {
        let Command::Line {
            steps,
            speed_hz,
            accel_hz_per_s,
            jerk_hz_per_s2,
        } = *command
        else {
            return None;
        };
        let shape = match jerk_hz_per_s2 {
            0 => RampShape::Trapezoid {
                linear_steps: 0,
                jump_steps: 0,
            },
            jerk_hz_per_s2 => RampShape::Jerk { jerk_hz_per_s2 },
        };
        let steps = steps.map(i64::from);
        let speed = speed_from_hz(speed_hz);
        Some(Self::new(steps, speed, Law::new(accel_hz_per_s, shape)))
    }

    /// Returns the speed that the drivers' pulses allow, in the line's measure.
    pub(crate) fn driver_speed_max(&self, timing: &[Timing]) -> Real {
        // Time that the pulses of each axis need at least.
        let counts = self.steps.map(i64::unsigned_abs);
        let needs = timing.iter().map(Timing::interval_ticks_min).zip(counts);
        let longest = if self.major_steps < SHORT_STEPS_MAX {
            let ticks = needs.map(|(interval_ticks, count)| interval_ticks * count);
            Real::of(ticks.max().unwrap_or(0))
        } else {
            let ticks = needs.map(|(interval_ticks, count)| (interval_ticks, Real::of(count)));
            ticks.fold(Real::ZERO, |most, (ticks, count)| {
                most.max(Real::of(ticks) * count)
            })
        };
        if longest.is_none() {
            return self.speed_max;
        }
        Real::of(self.major_steps) / longest
    }

    /// Direction of the tool along each axis, -1 to 1.
    fn slopes(&self, tool_way: Real) -> [Real; LINE_AXES] {
        let inverse = Real::of(1) / tool_way;
        self.steps.map(|count| Real::of_signed(count) * inverse)
    }

    /// Way of the tool.
    fn tool_way(&self) -> Real {
        Real::of(self.major_steps) * self.stretch
    }

    /// Speed of the tool at most.
    fn tool_speed_max(&self) -> Real {
        self.speed_max * self.stretch
    }
}

/// What the corners of a line are judged by.
#[derive(Clone, Copy)]
struct Edge {
    steps: [i64; LINE_AXES],
    slopes: [Real; LINE_AXES],
    /// Way, greatest speed and greatest acceleration of the tool.
    way: Real,
    speed_max: Real,
    accel: Real,
    /// Greatest acceleration of the axis with most steps.
    own_accel: Real,
}

impl Edge {
    fn of(line: &Line) -> Self {
        let way = line.tool_way();
        Self {
            steps: line.steps,
            slopes: line.slopes(way),
            way,
            speed_max: line.tool_speed_max(),
            accel: line.law.accel() * line.stretch,
            own_accel: line.law.accel(),
        }
    }
}

/// Returns the greatest speed of the tool at the corner of two lines.
fn corner_speed(before: &Edge, behind: &Edge, timing: &[Timing]) -> Real {
    let mut speed = before.speed_max.min(behind.speed_max);
    let mut most_jump = Real::ZERO;
    for (axis, timing) in timing.iter().enumerate() {
        let steps = [before.steps[axis], behind.steps[axis]];
        if steps == [0; 2] {
            continue;
        }
        let (a, b) = (before.slopes[axis], behind.slopes[axis]);
        let jump = (a - b).abs();
        if jump.fixed(STRAIGHT_BITS) != 0 {
            if speed * jump > timing.junction_speed {
                speed = timing.junction_speed / jump;
            }
            most_jump = most_jump.max(jump);
        }
        if steps[0].signum() * steps[1].signum() < 0 {
            // It turns: between its last edge and its first one lies a window of rest. With both
            // half steps at this speed and this acceleration at most, there is time for it.
            let window = Real::of(timing.window_ticks());
            let most = (before.accel * a.abs()).max(behind.accel * b.abs());
            if most * window.squared() > Real::of(1) {
                return Real::ZERO;
            }
            let slope = a.abs().max(b.abs());
            if speed * slope * window.twice() > Real::of(1) {
                speed = Real::of(1) / window.twice() / slope;
            }
        }
    }
    if !most_jump.is_none() {
        let accel = before.own_accel.min(behind.own_accel);
        let most = accel * (before.way + behind.way).half();
        if speed.squared() * most_jump > most {
            speed = (most / most_jump).root();
        }
    }
    speed
}

/// Directions that differ by less than 2⁻⁴⁰ are the same.
const STRAIGHT_BITS: i32 = 40;

/// The commands for lines that follow the present one, in order.
pub(crate) trait Lines: Iterator<Item = Command> + Clone {
    /// Leaves out so many places of the queue, which were looked at before.
    fn leave_out(&mut self, places: usize);

    /// Returns how many places of the queue were looked at, up to the last line.
    fn places(&self) -> usize;
}

/// A line behind the present one. Speeds are those of the tool.
#[derive(Clone, Copy, Debug)]
struct Known {
    line: Line,
    /// Places of the queue from the line before to this one.
    places: usize,
    approach: Approach,
    /// Greatest speed with which it may be entered, whatever follows; and its square.
    entry_max: Real,
    square_max: Real,
    /// The same, given what follows.
    entry: Pace,
    /// Nothing that may still follow changes that.
    settled: bool,
}

/// The lines behind the present one, and how fast each may be entered.
#[derive(Clone, Debug)]
pub(crate) struct LookAhead {
    lines: [Option<Known>; LINES_MAX],
    first: usize,
    count: usize,
    /// Places of the queue behind the present line that were looked at.
    places: usize,
    /// The line behind the last one begins at rest.
    closed: bool,
}

impl LookAhead {
    pub(crate) const fn new() -> Self {
        Self {
            lines: [None; LINES_MAX],
            first: 0,
            count: 0,
            places: 0,
            closed: false,
        }
    }

    /// Forgets all lines.
    pub(crate) fn clear(&mut self) {
        self.count = 0;
        self.places = 0;
        self.closed = false;
    }

    /// The first line begins.
    pub(crate) fn advance(&mut self) {
        if self.count > 0 {
            self.places -= self.known(0).places;
            self.first = (self.first + 1) % LINES_MAX;
            self.count -= 1;
        }
    }

    /// Returns the lines that are known behind the present one.
    pub(crate) fn lines(&self) -> impl Iterator<Item = &Line> {
        (0..self.count).map(|index| &self.known(index).line)
    }

    fn place(&self, index: usize) -> usize {
        (self.first + index) % LINES_MAX
    }

    fn known(&self, index: usize) -> &Known {
        self.lines[self.place(index)]
            .as_ref()
            .expect("below the count")
    }

    /// Returns the greatest speed with which `line` may be left, in its own measure, steps per
    /// tick; `behind` gives the commands of all the lines after it, `within` a line as fast as it
    /// may be.
    pub(crate) fn exit_speed(
        &mut self,
        line: &Line,
        behind: impl Lines,
        within: impl Fn(Line) -> Line,
        timing: &[Timing],
    ) -> Real {
        if !line.joins {
            return Real::ZERO;
        }
        let settled = self.count > 0 && self.known(0).settled;
        if !settled && !self.closed && self.count < LINES_MAX {
            let before = self.count;
            self.look(line, behind, within, timing);
            self.settle(before);
        }
        match self.count {
            0 => Real::ZERO,
            _ => self.first_entry() / line.stretch,
        }
    }

    fn first_entry(&self) -> Real {
        let first = self.known(0);
        if first.entry.reaches(first.entry_max, first.square_max) {
            return first.entry_max;
        }
        first.entry.speed()
    }

    /// Looks at as many lines as there is room for.
    fn look(
        &mut self,
        line: &Line,
        mut behind: impl Lines,
        within: impl Fn(Line) -> Line,
        timing: &[Timing],
    ) {
        behind.leave_out(self.places);
        let mut edge = None;
        while self.count < LINES_MAX {
            let Some(next) = behind.next().as_ref().and_then(Line::of).map(&within) else {
                break;
            };
            let before = edge.unwrap_or_else(|| match self.count {
                0 => Edge::of(line),
                count => Edge::of(&self.known(count - 1).line),
            });
            let behind_it = Edge::of(&next);
            edge = Some(behind_it);
            let corner = corner_speed(&before, &behind_it, timing);
            if corner.is_none() {
                self.closed = true;
                break;
            }
            let entry_max = corner.min(behind_it.speed_max);
            let law = next.law.scaled(next.stretch);
            let places = behind.places();
            let place = self.place(self.count);
            self.lines[place] = Some(Known {
                line: next,
                places: places - self.places,
                approach: Approach::new(&law, behind_it.way),
                entry_max,
                square_max: entry_max.squared(),
                entry: Pace::REST,
                settled: false,
            });
            self.places = places;
            self.count += 1;
        }
    }

    /// Finds the entry speeds from the last line backwards, given that `before` lines have theirs
    /// already.
    fn settle(&mut self, before: usize) {
        if self.count == before {
            // Nothing is new.
            return;
        }
        let (mut pace, mut settled) = (Pace::REST, self.closed);
        for index in (0..self.count).rev() {
            let place = self.place(index);
            let known = self.lines[place].as_mut().expect("below the count");
            if index < before && known.settled {
                return;
            }
            let mut entry = known.approach.before(pace, settled);
            if entry.reaches(known.entry_max, known.square_max) {
                settled = true;
                entry = match entry {
                    Pace::Square(_) => Pace::Square(known.square_max),
                    Pace::Speed(_) => Pace::Speed(known.entry_max),
                };
            }
            let same = (entry, settled) == (known.entry, known.settled);
            if index < before && same {
                return;
            }
            (known.entry, known.settled) = (entry, settled);
            pace = entry;
        }
    }
}

#[cfg(test)]
mod tests;
