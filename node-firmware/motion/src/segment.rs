//! What the encoder plays next, in internal RAM: steps, rests and turns.

use crate::limits::SEGMENTS_MAX;

/// Fraction of a tick in a [`Segment`]: 2⁻²⁴, so that 10⁶ steps of rounded intervals add up to less
/// than a thirtieth of a tick, and an interval may still be 19 hours.
pub const FRACTION_BITS: u32 = 24;

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
    pub const fn of(steps: i64) -> Self {
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
    /// Steps whose intervals change by the same amount from one to the next: the edge of step x
    /// (from 0) is due x · interval + x · (x − 1) / 2 · change + offset after the segment's begin,
    /// rounded to a tick; the first one at its begin.
    Steps {
        /// How many, from 1.
        step_count: u32,
        /// What the first edge lies behind the segment's begin before rounding, [`FRACTION_BITS`]
        /// of a tick, with sign.
        offset: i32,
        /// Time between the first two active edges, [`FRACTION_BITS`] of a tick.
        interval: u64,
        /// What each interval is longer than the one before, [`FRACTION_BITS`] of a tick.
        change: i64,
        /// From the first edge to the segment's end.
        total_ticks: u64,
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

impl Segment {
    /// Returns steps at equal intervals, the last one with its interval.
    pub const fn steady(step_count: u32, interval_ticks: u64) -> Self {
        Self::Steps {
            step_count,
            offset: 0,
            interval: interval_ticks << FRACTION_BITS,
            change: 0,
            total_ticks: step_count as u64 * interval_ticks,
        }
    }

    /// Returns how long it lasts, ticks.
    pub const fn ticks(&self) -> u64 {
        match *self {
            Self::Steps { total_ticks, .. } => total_ticks,
            Self::Low { ticks } => ticks,
            Self::Turn { .. } => 0,
        }
    }
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

    pub(crate) fn front(&self) -> Option<&Segment> {
        (self.count > 0).then(|| &self.segments[self.first])
    }

    pub(crate) fn peek(&self) -> Option<Segment> {
        self.front().copied()
    }

    pub(crate) fn pop(&mut self) -> Option<Segment> {
        let segment = self.peek()?;
        self.first = (self.first + 1) % SEGMENTS_MAX;
        self.count -= 1;
        Some(segment)
    }

    /// Returns the steps before the next rest or turn.
    pub(crate) fn steps_ahead(&self) -> u64 {
        (0..self.count)
            .map_while(
                |index| match self.segments[(self.first + index) % SEGMENTS_MAX] {
                    Segment::Steps { step_count, .. } => Some(u64::from(step_count)),
                    Segment::Low { .. } | Segment::Turn { .. } => None,
                },
            )
            .sum()
    }

    /// Returns whether nothing waits but steps.
    pub(crate) fn are_steps(&self) -> bool {
        let mut all =
            (0..self.count).map(|index| &self.segments[(self.first + index) % SEGMENTS_MAX]);
        all.all(|segment| matches!(segment, Segment::Steps { .. }))
    }

    pub(crate) fn clear(&mut self) {
        self.count = 0;
    }
}
