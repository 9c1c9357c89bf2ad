//! [`Way`]: what one axis does by itself, stretch by stretch.

use super::{Made, STRETCHES_MAX, Split, Stretch, Tail};
use crate::{
    axis::Axis,
    law::Law,
    limits::CHANNELS,
    path::State,
    profile::Timing,
    real::Real,
    segment::Direction,
    steps::{Exit, Moment, Steps},
};

/// Stretches of one way that are not encoded to their end: what was under way, the change, the
/// slowing down before a turn, the way back, the rest behind a place that is passed, and as many for
/// changes within 2 ms.
pub(super) const WAY_STRETCHES_MAX: usize = 8;

// A line and a way are never planned at the same time: drives begin at rest, and lines wait until
// all of them have ended there. So ways lie in the memory of the lines.
const _: () = assert!(CHANNELS * WAY_STRETCHES_MAX <= STRETCHES_MAX);

/// Returns where the stretches of an axis lie among all.
pub(super) const fn room_of(index: usize) -> core::ops::Range<usize> {
    index * WAY_STRETCHES_MAX..(index + 1) * WAY_STRETCHES_MAX
}

/// What one axis does by itself. Its stretches lie in its room among those of the planner.
#[derive(Clone, Debug)]
pub(super) struct Way {
    pub(super) count: usize,
    pub(super) writing: usize,
    pub(super) steps: Option<Steps<1>>,
    pub(super) made: Made,
    /// When the last stretch that was retired ends: it is encoded then, but has not been played.
    pub(super) retired_until: Option<u64>,
    /// Where it was left, it rests short of a whole step.
    pub(super) short: Option<Short>,
}

/// What an axis that has come to rest within a step counts as made, and has not gone. If it goes on the
/// same way, it takes its time for that, too: its steps would come faster than it may.
#[derive(Clone, Copy, Debug)]
pub(super) struct Short {
    /// At rest since, ticks.
    pub(super) at: u64,
    /// Booked steps there.
    pub(super) base_steps: i64,
    pub(super) direction: Direction,
    /// Steps, less than one.
    pub(super) steps: Real,
}

impl Short {
    /// Returns when it would be there at this speed, steps a tick; 0 if that is not its way.
    pub(super) fn made_at(&self, base_steps: i64, direction: Direction, speed: Real) -> u64 {
        if (self.base_steps, self.direction) != (base_steps, direction) {
            return 0;
        }
        let ticks = (self.steps / speed).rounded();
        self.at.saturating_add(u64::try_from(ticks).unwrap_or(0))
    }
}

/// How a way begins and ends.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Ends {
    /// Steps of its ramp that it jumps over.
    pub(crate) jump_steps: u16,
    /// Speed with which it passes its end, steps a tick; 0: it rests there.
    pub(crate) passing: Real,
}

/// How a way goes on.
#[derive(Clone, Copy, Debug)]
pub(crate) enum Onward {
    /// To the end of its line, at rest.
    ToEnd,
    /// Past that at this speed, and to rest.
    Past(Real),
    /// To rest as soon as possible.
    ToRest,
}

/// Where a way was left.
#[derive(Clone, Copy, Debug)]
#[expect(clippy::large_enum_variant, reason = "it lives for one call")]
pub(crate) enum Left {
    /// At rest, from this tick on.
    Resting {
        /// From when on.
        at: u64,
        /// Booked steps there, if that is not the end of what was planned.
        base_steps: Option<i64>,
    },
    /// In motion.
    Moving {
        split: Split,
        /// How far it would have gone that way, steps of its line with sign.
        reach_steps: i64,
    },
}

impl Way {
    pub(super) const NONE: Self = Self {
        count: 0,
        writing: 0,
        steps: None,
        made: Made {
            at: 0,
            booked_steps: 0,
        },
        retired_until: None,
        short: None,
    };

    /// Forgets where it leads.
    pub(super) fn clear(&mut self) {
        self.count = 0;
        self.writing = 0;
        self.steps = None;
        self.retired_until = None;
    }

    /// Becomes as new: time begins anew.
    pub(super) fn reset(&mut self) {
        self.clear();
        self.short = None;
        self.made = Self::NONE.made;
    }

    pub(super) fn is_unfinished(&self) -> bool {
        self.steps.is_some() || self.writing < self.count
    }

    pub(super) fn all<'r>(
        &self,
        room: &'r [Option<Stretch>],
    ) -> impl Iterator<Item = &'r Stretch> + use<'r> {
        room[..self.count].iter().flatten()
    }

    pub(super) fn retire(&mut self, room: &mut [Option<Stretch>], encoded_ticks: u64) {
        let ended = |stretch: &&Stretch| stretch.end_ticks <= encoded_ticks;
        let done = self.all(room).take_while(ended).count().min(self.writing);
        if let Some(last) = self.all(room).take(done).last() {
            self.retired_until = Some(last.end_ticks);
        }
        room.copy_within(done..self.count, 0);
        self.count -= done;
        self.writing -= done;
    }

    pub(super) fn write(
        &mut self,
        room: &[Option<Stretch>],
        index: usize,
        axis: &mut Axis,
        tail: &mut Tail,
        timing: &[Timing],
    ) -> bool {
        loop {
            if let Some(steps) = self.steps.as_mut() {
                if !steps.write_axis(0, axis, tail) {
                    return false;
                }
                self.steps = None;
            }
            if self.writing == self.count {
                return true;
            }
            let stretch = room[self.writing].as_ref().expect("below the count");
            let mut steps = Steps::NONE;
            stretch.take_steps_of(index, &mut steps, timing);
            if self.made.at > stretch.begin.ticks {
                steps.skip(0, self.made.booked_steps - stretch.base_steps[index]);
            }
            self.steps = Some(steps);
            self.writing += 1;
        }
    }

    /// Returns the stretch that is being written, and how many of its edges are left; `None`: all
    /// are written, to rest.
    pub(super) fn left<'r>(
        &self,
        room: &'r [Option<Stretch>],
        index: usize,
    ) -> Option<(&'r Stretch, u64)> {
        let steps = self.steps.as_ref()?;
        let stretch = room[self.writing.checked_sub(1)?].as_ref()?;
        let mut left = steps.left(0, stretch.whole_steps(index));
        if stretch.exit == Exit::Moving && stretch.until.is_none() {
            // It passes its end, and the next one comes to rest.
            let behind = self.all(room).nth(self.writing);
            let way = behind.map_or(0, |behind| behind.path().end_steps().rounded());
            left += way.unsigned_abs().saturating_sub(stretch.line.major_steps);
        }
        Some((stretch, left))
    }

    /// Leaves it at `cut`; all behind is dropped. The pin shows `direction` by then.
    pub(super) fn leave(
        &mut self,
        room: &mut [Option<Stretch>],
        index: usize,
        cut: u64,
        direction: Option<Direction>,
    ) -> Left {
        let Some(place) = self.all(room).position(|stretch| stretch.end_ticks > cut) else {
            let end = self
                .all(room)
                .last()
                .map_or(cut, |stretch| stretch.end_ticks);
            return Left::Resting {
                at: end.max(cut),
                base_steps: None,
            };
        };
        let reach_steps = reach(index, &room[place..self.count]);
        let stretch = room[place].as_mut().expect("below the count");
        let base_steps = stretch.base_steps;
        let line = stretch.line;
        let turned = direction == Some(Direction::of(line.steps[index]));
        let booked_steps = self.made.booked_steps;
        if !turned && booked_steps != base_steps[index] {
            // All its edges are made: the pin has turned for what comes behind it.
            let at = stretch.end_ticks;
            self.count = place + 1;
            return Left::Resting {
                at,
                base_steps: Some(booked_steps),
            };
        }
        if stretch.begin.ticks >= cut || !turned {
            // It has not begun, or makes no step before it has turned.
            self.count = place;
            if stretch.from.place.is_none() || !turned {
                return Left::Resting {
                    at: cut,
                    base_steps: Some(base_steps[index]),
                };
            }
            let split = Split {
                line,
                from: without_accel(stretch.from, &line.law),
                at: stretch.begin,
                base_steps,
            };
            return Left::Moving { split, reach_steps };
        }
        let since = Real::of(cut - stretch.begin.ticks) - stretch.begin.part;
        let from = without_accel(stretch.path().state_at(since), &line.law);
        stretch.until = Some(since);
        stretch.exit = Exit::Moving;
        stretch.end_ticks = cut;
        self.count = place + 1;
        let split = Split {
            line,
            from,
            at: Moment::of(cut),
            base_steps,
        };
        Left::Moving { split, reach_steps }
    }

    pub(super) fn push(&mut self, room: &mut [Option<Stretch>], stretch: Stretch) {
        assert!(self.count < room.len(), "asked before");
        room[self.count] = Some(stretch);
        self.count += 1;
    }
}

/// Returns how far an axis goes by these stretches until it turns or rests for good, steps of the
/// first one's line with sign.
fn reach(index: usize, stretches: &[Option<Stretch>]) -> i64 {
    let mut stretches = stretches.iter().flatten();
    let Some(first) = stretches.next() else {
        return 0;
    };
    let (base, sign) = (first.base_steps[index], first.line.steps[index].signum());
    let end = |stretch: &Stretch| {
        // Where it was left, the next one goes on.
        let whole = Stretch {
            until: None,
            ..*stretch
        };
        let made = whole.path().end_steps().rounded();
        stretch.base_steps[index] - base + sign * made
    };
    stretches
        .take_while(|stretch| stretch.line.steps[index].signum() == sign)
        .last()
        .map_or_else(|| end(first), end)
}

/// Without a limit of jerk an acceleration may end at once.
fn without_accel(from: State, law: &Law) -> State {
    match law.jerk() {
        Some(_) => from,
        None => State {
            accel: Real::ZERO,
            ..from
        },
    }
}
