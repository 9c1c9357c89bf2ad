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
//! backwards: before a line, no faster than what can be slowed down within it. They are kept, so
//! that one line more costs only as many steps backwards as it makes a difference.

use crate::{
    law::{Law, speed_from_hz},
    profile::Timing,
    real::Real,
};
use keys::{
    Command,
    command::{LINE_AXES, RampShape},
};

/// Lines behind the present one that are looked at. With 1 mm lines at 100 mm/s: 640 ms.
pub const LINES_MAX: usize = 64;

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
        let major = Real::of(major_steps);
        let squares = steps.iter().fold(Real::ZERO, |sum, count| {
            sum + (Real::of(count.unsigned_abs()) / major).squared()
        });
        Self {
            steps,
            major_steps,
            speed_max,
            law,
            stretch: squares.root(),
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
        let major = Real::of(self.major_steps);
        let mut most = None;
        for (timing, count) in timing.iter().zip(self.steps) {
            if count != 0 {
                let own = Real::of(timing.interval_ticks_min()) * Real::of(count.unsigned_abs());
                let speed = major / own;
                most = Some(most.map_or(speed, |most: Real| most.min(speed)));
            }
        }
        most.unwrap_or(self.speed_max)
    }

    /// Direction of the tool along an axis, -1 to 1.
    fn slope(&self, axis: usize) -> Real {
        let major = Real::of(self.major_steps);
        Real::of_signed(self.steps[axis]) / major / self.stretch
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

/// Returns the greatest speed of the tool at the corner of two lines.
fn corner_speed(before: &Line, behind: &Line, timing: &[Timing]) -> Real {
    let mut speed = before.tool_speed_max().min(behind.tool_speed_max());
    let mut most_jump = Real::ZERO;
    for (axis, timing) in timing.iter().enumerate() {
        let (a, b) = (before.slope(axis), behind.slope(axis));
        let jump = (a - b).abs();
        if jump.fixed(STRAIGHT_BITS) != 0 {
            speed = speed.min(timing.junction_speed / jump);
            most_jump = most_jump.max(jump);
        }
        if before.steps[axis].signum() * behind.steps[axis].signum() < 0 {
            // It turns: between its last edge and its first one lies a window of rest. With both
            // half steps at this speed and this acceleration at most, there is time for it.
            let window = Real::of(timing.window_ticks());
            let accel = |line: &Line| line.law.accel() * line.stretch;
            let most = (accel(before) * a.abs()).max(accel(behind) * b.abs());
            if most * window.squared() > Real::of(1) {
                return Real::ZERO;
            }
            speed = speed.min(Real::of(1) / window.twice() / a.abs().max(b.abs()));
        }
    }
    if !most_jump.is_none() {
        let accel = before.law.accel().min(behind.law.accel());
        let ways = (before.tool_way() + behind.tool_way()).half();
        speed = speed.min((accel * ways / most_jump).root());
    }
    speed
}

/// Directions that differ by less than 2⁻⁴⁰ are the same.
const STRAIGHT_BITS: i32 = 40;

/// A line behind the present one. Speeds are those of the tool.
#[derive(Clone, Copy, Debug)]
struct Known {
    line: Line,
    /// How the tool gains speed.
    law: Law,
    way: Real,
    speed_max: Real,
    /// Greatest speed at the corner where it begins.
    corner: Real,
    /// Greatest speed with which it may be entered, given what follows.
    entry: Real,
}

/// The lines behind the present one, and how fast each may be entered.
#[derive(Clone, Debug)]
pub(crate) struct LookAhead {
    lines: [Option<Known>; LINES_MAX],
    first: usize,
    count: usize,
    /// The line behind the last one begins at rest.
    closed: bool,
}

impl LookAhead {
    pub(crate) const fn new() -> Self {
        Self {
            lines: [None; LINES_MAX],
            first: 0,
            count: 0,
            closed: false,
        }
    }

    /// Forgets all lines.
    pub(crate) fn clear(&mut self) {
        self.count = 0;
        self.closed = false;
    }

    /// The first line begins.
    pub(crate) fn advance(&mut self) {
        if self.count > 0 {
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
        behind: impl Iterator<Item = Command>,
        within: impl Fn(Line) -> Line,
        timing: &[Timing],
    ) -> Real {
        if !line.joins {
            return Real::ZERO;
        }
        let before = self.count;
        let mut last = if before > 0 {
            self.known(before - 1).line
        } else {
            *line
        };
        if before == LINES_MAX || self.closed {
            return self.first_entry(before) / line.stretch;
        }
        for command in behind.skip(before).take(LINES_MAX - before) {
            let Some(next) = Line::of(&command).map(&within) else {
                break;
            };
            let corner = corner_speed(&last, &next, timing);
            if corner.is_none() {
                self.closed = true;
                break;
            }
            let place = self.place(self.count);
            self.lines[place] = Some(Known {
                line: next,
                law: next.law.scaled(next.stretch),
                way: next.tool_way(),
                speed_max: next.tool_speed_max(),
                corner,
                entry: Real::ZERO,
            });
            self.count += 1;
            last = next;
        }
        self.first_entry(before) / line.stretch
    }

    /// Finds the entry speeds from the last line backwards, given that `before` lines have theirs
    /// already. Returns that of the first one.
    fn first_entry(&mut self, before: usize) -> Real {
        if self.count == before {
            // Nothing is new.
            return match before {
                0 => Real::ZERO,
                _ => self.known(0).entry,
            };
        }
        let mut speed = Real::ZERO;
        for index in (0..self.count).rev() {
            let place = self.place(index);
            let known = self.lines[place].as_mut().expect("below the count");
            let entry = known.law.speed_before(known.way, speed, known.speed_max);
            let entry = entry.min(known.corner);
            if index < before && entry == known.entry {
                break;
            }
            known.entry = entry;
            speed = entry;
        }
        self.known(0).entry
    }
}
