//! One motor: its segments, its encoder, its ledger. Lives in internal RAM beside the pulse
//! hardware; the planner writes segments, the refill reads them, each under the back end's
//! exclusive access.

use crate::{
    encoder::{Brake, Encoder, Fill, Rewound},
    ledger::Ledger,
    limits::{
        LOW_WATER_TICKS, LOW_WORD_TICKS_MAX, REFILL_WORDS, SEGMENTS_MAX, SEGMENTS_PER_COMMAND,
    },
    profile::{AxisProfile, Timing},
    segment::{Direction, Segment, SegmentRing},
};

/// One motor.
#[derive(Clone, Debug)]
pub struct Axis {
    segments: SegmentRing,
    encoder: Encoder,
    ledger: Ledger,
    /// End of what was planned since the start, ticks.
    planned_ticks: u64,
    /// Rest before that.
    lead_ticks: u64,
    direction_inverted: bool,
}

impl Axis {
    /// Makes an axis at rest at count 0 that no motor is known of yet: [`Motion::new`] tells it.
    ///
    /// [`Motion::new`]: crate::Motion::new
    pub const fn new() -> Self {
        Self {
            segments: SegmentRing::new(),
            encoder: Encoder::new(Timing::LEAST),
            ledger: Ledger::new(),
            planned_ticks: 0,
            lead_ticks: 0,
            direction_inverted: false,
        }
    }

    /// Becomes the axis of this motor, at rest at count 0. In place: an axis has some 8 KB.
    pub(crate) fn reset(&mut self, profile: AxisProfile) {
        self.segments.clear();
        self.encoder = Encoder::new(Timing::from(profile));
        self.ledger = Ledger::new();
        self.planned_ticks = 0;
        self.lead_ticks = 0;
        self.direction_inverted = profile.direction_inverted;
    }

    /// Returns the level of the direction pin for a direction.
    pub fn direction_level(&self, direction: Direction) -> bool {
        (direction == Direction::Positive) != self.direction_inverted
    }

    /// Gives the half block with which the channel starts, a rest of `lead_ticks`, and books it as
    /// half 0. Half 1 follows by [`Axis::fill`].
    pub fn lead_in(&mut self, lead_ticks: u64) -> Fill {
        let mut fill = Fill::END;
        self.lead_ticks = lead_ticks;
        self.encoder.lead_in(lead_ticks, &mut fill);
        self.ledger.book(0, fill.step_words, fill.sign);
        fill
    }

    /// Gives the next half block and books it as `half` (0 or 1).
    pub fn fill(&mut self, half: usize) -> Fill {
        let mut fill = Fill::END;
        self.fill_into(half, &mut fill);
        fill
    }

    /// The same where the fill lies: a copy of it costs as much as its words. Called by the refill.
    #[inline]
    pub fn fill_into(&mut self, half: usize, fill: &mut Fill) {
        let ahead_ticks = self.ahead_ticks();
        self.encoder.fill(&mut self.segments, ahead_ticks, fill);
        self.ledger.book(half, fill.step_words, fill.sign);
    }

    /// Returns the account of steps.
    pub fn ledger(&self) -> &Ledger {
        &self.ledger
    }

    /// Returns whether the end marker is written.
    pub fn has_ended(&self) -> bool {
        self.encoder.has_ended()
    }

    /// Returns whether the planner should be called: little is left to encode.
    pub fn wants_planning(&self) -> bool {
        !self.has_ended() && self.ahead_ticks() < LOW_WATER_TICKS
    }

    /// Returns whether a refill leaves the planner a choice: a half block takes from more than
    /// there is in it. A back end may then refill between two looks of the planner.
    pub fn can_spare(&self) -> bool {
        let segments = SEGMENTS_MAX - self.segments.room();
        self.ahead_ticks() > 2 * REFILL_WORDS as u64 * LOW_WORD_TICKS_MAX
            || segments > 2 * REFILL_WORDS
    }

    /// Returns what is planned and not encoded.
    fn ahead_ticks(&self) -> u64 {
        let encoded_ticks = self.encoder.encoded_ticks();
        (self.lead_ticks + self.planned_ticks).saturating_sub(encoded_ticks)
    }

    /// The channel was halted or has ended: what was not played is un-booked.
    pub fn halt(&mut self, played_steps: i64) {
        self.segments.clear();
        self.encoder.reset();
        self.ledger.settle(played_steps);
        self.planned_ticks = 0;
    }

    pub(crate) fn timing(&self) -> Timing {
        *self.encoder.timing()
    }

    pub(crate) fn has_room(&self) -> bool {
        self.segments.room() >= SEGMENTS_PER_COMMAND
    }

    pub(crate) fn room(&self) -> usize {
        self.segments.room()
    }

    pub(crate) fn push(&mut self, segment: Segment) {
        self.planned_ticks += segment.ticks();
        self.segments.push(segment);
    }

    pub(crate) fn encoded_ticks(&self) -> u64 {
        self.encoder.encoded_ticks()
    }

    /// Returns the time since the start behind which the plan can be changed, ticks.
    pub(crate) fn committed_ticks(&self) -> u64 {
        self.encoder.committed_ticks()
    }

    /// Its pin was turned by somebody else than the refill.
    pub(crate) fn take_direction(&mut self, direction: Direction) {
        self.encoder.take_direction(direction);
    }

    /// Leaves the plan; another one follows.
    pub(crate) fn rewind(&mut self) -> Rewound {
        let rewound = self.encoder.rewind(&mut self.segments);
        self.planned_ticks = rewound.encoded_ticks.saturating_sub(self.lead_ticks);
        rewound
    }

    /// Returns how many steps follow behind what is encoded if it slows down now.
    pub(crate) fn steps_to_rest(&self) -> u64 {
        let goes_on = matches!(self.segments.peek(), Some(Segment::Steps { .. }));
        let steps_ahead = self.segments.steps_ahead();
        self.encoder.steps_to_rest(goes_on, steps_ahead)
    }

    /// Leaves the plan and slows down.
    pub(crate) fn decelerate(&mut self) {
        let goes_on = matches!(self.segments.peek(), Some(Segment::Steps { .. }));
        let steps_ahead = self.segments.steps_ahead();
        self.segments.clear();
        self.encoder.decelerate(goes_on, steps_ahead);
    }

    /// Another axis has slowed down for want of a plan: so does this one, now or when it is time.
    pub(crate) fn slow_down_with_others(&mut self) {
        if self.encoder.is_starved() || self.encoder.brakes_in_time() {
            return;
        }
        if self.encoder.has_brake() {
            self.encoder.brake(&mut self.segments);
        } else {
            self.decelerate();
        }
    }

    /// Takes how to slow down if the planner comes too late.
    pub(crate) fn set_brake(&mut self, brake: Option<Brake>) {
        self.encoder.set_brake(brake);
    }

    /// Returns whether the planner came too late: the axis slows down, or rests already.
    pub(crate) fn is_starved(&self) -> bool {
        self.encoder.is_starved()
    }

    /// Returns the speed of what was encoded last with sign, mHz.
    pub(crate) fn speed_mhz(&self) -> i64 {
        self.encoder
            .stopping_mhz()
            .unwrap_or_else(|| self.encoder.speed_mhz())
    }
}

impl Default for Axis {
    fn default() -> Self {
        Self::new()
    }
}
