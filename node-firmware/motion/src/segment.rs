//! What the encoder plays next, in internal RAM: steps, rests and turns.

use crate::limits::SEGMENTS_MAX;

/// A level of the direction pin.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Direction {
    /// The count goes up; the pin is high.
    Positive,
    /// The count goes down; the pin is low.
    Negative,
}

impl Direction {
    /// Returns the direction of this many steps.
    pub const fn of(steps: i32) -> Self {
        if steps < 0 {
            Self::Negative
        } else {
            Self::Positive
        }
    }

    /// Returns what one step adds to the count.
    pub const fn sign(self) -> i8 {
        match self {
            Self::Positive => 1,
            Self::Negative => -1,
        }
    }
}

/// A piece of one axis' timeline.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Segment {
    /// Steps with active edges at 0, interval, 2 · interval, …; it ends one interval after the
    /// last edge.
    Steps {
        /// How many, from 1.
        step_count: u32,
        /// Time between active edges.
        interval_ticks: u64,
    },
    /// Nothing happens.
    Low {
        /// How long, from [`WORD_TICKS_MIN`](crate::limits::WORD_TICKS_MIN).
        ticks: u64,
    },
    /// The direction pin changes somewhere in the rest before this. Takes no time.
    Turn {
        /// From now on.
        direction: Direction,
    },
}

/// Segments that wait for the encoder: one producer (the planner), one consumer (the encoder).
/// Full is an answer: the planner waits.
#[derive(Clone, Debug)]
pub(crate) struct SegmentRing {
    segments: [Segment; SEGMENTS_MAX],
    first: usize,
    count: usize,
}

impl SegmentRing {
    pub(crate) const fn new() -> Self {
        Self {
            segments: [Segment::Low { ticks: 0 }; SEGMENTS_MAX],
            first: 0,
            count: 0,
        }
    }

    pub(crate) const fn room(&self) -> usize {
        SEGMENTS_MAX - self.count
    }

    /// Adds a segment. Rests that follow each other are one.
    ///
    /// # Panics
    /// There is no room: the planner has to ask before.
    pub(crate) fn push(&mut self, segment: Segment) {
        if let Segment::Low { ticks } = segment
            && self.count > 0
            && let Segment::Low { ticks: before } =
                &mut self.segments[(self.first + self.count - 1) % SEGMENTS_MAX]
        {
            *before += ticks;
            return;
        }
        assert!(self.count < SEGMENTS_MAX, "the planner checks the room");
        self.segments[(self.first + self.count) % SEGMENTS_MAX] = segment;
        self.count += 1;
    }

    pub(crate) fn peek(&self) -> Option<Segment> {
        (self.count > 0).then(|| self.segments[self.first])
    }

    pub(crate) fn pop(&mut self) -> Option<Segment> {
        let segment = self.peek()?;
        self.first = (self.first + 1) % SEGMENTS_MAX;
        self.count -= 1;
        Some(segment)
    }

    pub(crate) fn clear(&mut self) {
        self.count = 0;
    }
}
