//! What ends when: the planned commands in order of time.

use crate::{
    Ticks,
    limits::{CHANNELS, MARKS_MAX},
    planner::Run,
};
use keys::AxisId;

/// A command that is planned and not yet executed.
#[derive(Clone, Copy, Debug)]
pub(super) struct Mark {
    pub(super) end: Ticks,
    pub(super) what: What,
}

#[derive(Clone, Copy, Debug)]
pub(super) enum What {
    Moves([Option<Run>; 2]),
    /// A ramp or a line, with the steps of each axis.
    Path([i64; CHANNELS]),
    Rest,
    Laser {
        power_percent: u8,
    },
    Lidar,
    StatusCd,
    /// From here on, position = origin + played steps.
    Origin {
        axis: AxisId,
        origin_steps: i64,
        /// What it was before.
        before_steps: i64,
    },
}

impl What {
    /// Returns the steps of a raw move; none of all else.
    pub(super) const fn runs(&self) -> [Option<Run>; 2] {
        match self {
            Self::Moves(runs) => *runs,
            _ => [None, None],
        }
    }

    /// Returns whether somebody is told when its time has come.
    pub(super) const fn tells(&self) -> bool {
        matches!(self, Self::Laser { .. } | Self::Lidar | Self::StatusCd)
    }
}

/// Marks in order of time. Full is an answer: the planner waits.
#[derive(Debug)]
pub(super) struct Marks {
    marks: [Mark; MARKS_MAX],
    first: usize,
    count: usize,
}

impl Marks {
    pub(super) const fn new() -> Self {
        let none = Mark {
            end: Ticks(0),
            what: What::Rest,
        };
        Self {
            marks: [none; MARKS_MAX],
            first: 0,
            count: 0,
        }
    }

    pub(super) fn clear(&mut self) {
        self.count = 0;
    }

    pub(super) fn front(&self) -> Option<&Mark> {
        (self.count > 0).then(|| &self.marks[self.first])
    }

    pub(super) fn iter(&self) -> impl Iterator<Item = &Mark> + Clone {
        (0..self.count).map(|index| &self.marks[(self.first + index) % MARKS_MAX])
    }

    pub(super) fn push(&mut self, mark: Mark) {
        assert!(self.count < MARKS_MAX, "the planner checks the room");
        self.marks[(self.first + self.count) % MARKS_MAX] = mark;
        self.count += 1;
    }

    pub(super) fn pop(&mut self) -> Option<Mark> {
        let mark = *self.front()?;
        self.first = (self.first + 1) % MARKS_MAX;
        self.count -= 1;
        Some(mark)
    }

    pub(super) fn is_full(&self) -> bool {
        self.count == MARKS_MAX
    }

    /// Takes back the latest mark if it ends later than this.
    pub(super) fn take_back(&mut self, at: Ticks) -> Option<Mark> {
        let last = (self.first + self.count.checked_sub(1)?) % MARKS_MAX;
        let mark = self.marks[last];
        (mark.end > at).then(|| {
            self.count -= 1;
            mark
        })
    }

    /// Drops the marks that end later than this.
    pub(super) fn cut(&mut self, at: Ticks) {
        self.count = self.iter().take_while(|mark| mark.end <= at).count();
    }
}
