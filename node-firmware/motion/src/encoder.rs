//! Segments to symbols, half a block at a time. Runs in the refill interrupt: bounded integer
//! work, internal RAM only.
//!
//! A step is one word, high first; what a slow step still owes to its interval follows as words
//! of rest. Total time is kept to the tick, so axes that began together stay together.
//!
//! **Turning.** The direction pin is no part of the symbol stream; it is switched by software in a
//! refill. So a turn needs a refill at which no step is left in the block:
//!
//! ```text
//!   half h            half h+1              half h+2
//!   step step rest…   rest rest rest rest…  step step …
//!                     ▲ h is consumed: the refill switches the pin, then writes h+2
//! ```
//!
//! The rest of h is filled with short words, the shortest ones if there is no more rest than a turn
//! needs; h+1 lasts at least the refill's latency and the setup time. The planner has left that much
//! rest before every turn (`Timing::window_ticks`); where an axis has rested for longer, the pin is
//! switched at once.
//!
//! **Pace.** Axes look ahead differently: 24 fast steps last 100 µs, 24 words of rest could last
//! 6 ms. The planner can be no further ahead than the ring of the busiest axis allows, so a resting
//! one must not run to the end of the plan and stop: a half block of rest covers at most half of
//! what is planned. Ahead stays a third of it, whatever the others do.
//!
//! **Controlled stop.** v² falls by 2a with each step (constant deceleration), the interval between
//! two steps is 2 / (v₀ + v₁): exact for constant deceleration, one integer root a step. It goes
//! no farther than the plan would have gone, at whose end raw steps stop abruptly anyway.
//!
//! **No plan.** Where the planner comes too late, the segments end in full run. For that the planner
//! leaves a brake with every part of a path that it writes: the axis slows down as in a controlled
//! stop, by the path's own acceleration and on the path's own way. All axes of a line take it at one
//! time, that of the one whose segments end first.

mod fill;
mod rest;
mod run;
mod slower;
mod trend;

pub use fill::Fill;

use fill::{HalfFacts, Out};

use crate::{
    limits::{
        LOW_WORD_TICKS_MAX, PART_TICKS_MIN, REFILL_WORDS, REST_HALF_TICKS_MIN, TICK_HZ,
        WORD_TICKS_MIN,
    },
    profile::Timing,
    segment::{Direction, FRACTION_BITS, Segment, SegmentRing},
    symbol::Symbol,
};

/// How far a turn has come.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Turn {
    None,
    /// The rest of this half block is filled; the next one is the window.
    Filling,
    /// The window is written: the next refill switches the pin.
    Due,
}

/// How to slow down where the planner does not come back.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Brake {
    /// What the square of the speed loses in a step, 2a, mHz², from 1.
    pub(crate) lost: u64,
    /// Steps of the path that are not written and that the axis has still before it, in the same
    /// direction.
    pub(crate) steps_max: u64,
    /// When it is taken, though more of the plan may be written then, ticks since the start: so all
    /// axes of a line begin to slow down together. `u64::MAX`: where what is written ends.
    pub(crate) from_ticks: u64,
}

/// Where another plan goes on.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Rewound {
    /// Time since the start, ticks.
    pub(crate) encoded_ticks: u64,
    /// Rest since the last step's high time, saturating.
    pub(crate) low_ticks: u64,
    /// Direction of what comes next.
    pub(crate) direction: Option<Direction>,
}

#[derive(Clone, Debug)]
pub(crate) struct Encoder {
    timing: Timing,
    direction: Option<Direction>,
    /// Steps of the present segment that are still to come.
    steps_left: u32,
    /// Time from the next edge to the end of the present segment.
    left_ticks: u64,
    /// Present interval and its change, in fractions of a tick.
    interval: i64,
    change: i64,
    /// What the last edge lies behind its due time, in fractions of a tick.
    offset: i64,
    /// Time from the last edge to the next.
    interval_ticks: u64,
    /// The last interval that tells how fast it is: behind the last step before a rest none does.
    speed_ticks: u64,
    /// Rest that is owed before anything else.
    low_ticks: u64,
    /// The rest is more than the last step's own interval.
    resting: bool,
    /// Rest since the last step's high time, saturating.
    low_ticks_since_step: u64,
    turn: Turn,
    /// How to slow down if the plan ends here.
    brake: Option<Brake>,
    /// It ended in full run, and the brake was taken.
    starved: bool,
    /// What the square of the speed loses in a step of a controlled stop, mHz²; `None`: by the
    /// deceleration of the profile.
    stop_lost: Option<u64>,
    /// Speed of a controlled stop, mHz, rounded down.
    stopping_mhz: Option<u64>,
    /// Its square, mHz².
    stopping_square: u64,
    /// Steps that it may still make.
    stopping_steps_max: u64,
    trend: trend::Trend,
    /// Down to this speed its steps are computed quickly, mHz.
    quick_mhz_min: u32,
    ended: bool,
    half_before: HalfFacts,
    /// The last half of the last word of that, ticks.
    last_part_ticks: u32,
    encoded_ticks: u64,
    /// Longest rest in one word of this fill.
    low_word_ticks: u64,
}

impl Encoder {
    pub(crate) const fn new(timing: Timing) -> Self {
        Self {
            timing,
            direction: None,
            steps_left: 0,
            left_ticks: 0,
            interval: 0,
            change: 0,
            offset: 0,
            interval_ticks: 0,
            speed_ticks: 0,
            low_ticks: 0,
            resting: true,
            low_ticks_since_step: u64::MAX,
            turn: Turn::None,
            brake: None,
            starved: false,
            stop_lost: None,
            stopping_mhz: None,
            stopping_square: 0,
            stopping_steps_max: 0,
            trend: trend::Trend::NONE,
            quick_mhz_min: 0,
            ended: true,
            half_before: HalfFacts {
                has_steps: false,
                ticks: 0,
            },
            last_part_ticks: 0,
            encoded_ticks: 0,
            low_word_ticks: LOW_WORD_TICKS_MAX,
        }
    }

    pub(crate) fn timing(&self) -> &Timing {
        &self.timing
    }

    /// Returns whether the end marker is written: nothing is played behind it.
    pub(crate) fn has_ended(&self) -> bool {
        self.ended
    }

    /// Returns the time that was encoded since the start, ticks.
    pub(crate) fn encoded_ticks(&self) -> u64 {
        self.encoded_ticks
    }

    /// Returns the present speed of a controlled stop with sign, mHz.
    pub(crate) fn stopping_mhz(&self) -> Option<i64> {
        let speed_mhz = i64::try_from(self.stopping_mhz?).unwrap_or(i64::MAX);
        Some(match self.direction {
            Some(Direction::Negative) => -speed_mhz,
            _ => speed_mhz,
        })
    }

    /// Returns the speed of the step that was encoded last with sign, mHz; 0 at rest.
    pub(crate) fn speed_mhz(&self) -> i64 {
        if self.resting || self.ended || self.speed_ticks == 0 {
            return 0;
        }
        let speed_mhz = (1_000 * TICK_HZ / self.speed_ticks) as i64;
        match self.direction {
            Some(Direction::Negative) => -speed_mhz,
            _ => speed_mhz,
        }
    }

    /// The direction pin was switched by somebody else, while nothing steps.
    pub(crate) fn take_direction(&mut self, direction: Direction) {
        self.direction = Some(direction);
    }

    /// Forgets everything but the direction pin: the channel was halted or has ended.
    pub(crate) fn reset(&mut self) {
        *self = Self {
            direction: self.direction,
            ..Self::new(self.timing)
        };
    }

    /// Returns the time behind which [`Encoder::rewind`] leaves the plan, ticks.
    pub(crate) fn committed_ticks(&self) -> u64 {
        self.encoded_ticks + self.kept_ticks()
    }

    /// Returns the rest that a turn which has begun still needs, ticks; and what is more than that by
    /// less than a word, because that cannot be rested alone.
    fn kept_ticks(&self) -> u64 {
        let turn_ticks = self.timing.turn_ticks();
        match self.turn {
            Turn::Filling if self.low_ticks < turn_ticks + WORD_TICKS_MIN => self.low_ticks,
            Turn::Filling => turn_ticks,
            Turn::None | Turn::Due => 0,
        }
    }

    /// Leaves the plan; another one follows. A turn that has begun is kept, with the rest that it
    /// needs.
    pub(crate) fn rewind(&mut self, segments: &mut SegmentRing) -> Rewound {
        let turn = match segments.peek() {
            Some(Segment::Turn { direction }) if self.turn != Turn::None => Some(direction),
            _ => None,
        };
        segments.clear();
        self.brake = None;
        self.steps_left = 0;
        self.low_ticks = self.kept_ticks();
        match turn {
            Some(direction) => segments.push(Segment::Turn { direction }),
            None => self.turn = Turn::None,
        }
        Rewound {
            encoded_ticks: self.encoded_ticks + self.low_ticks,
            low_ticks: self.low_ticks_since_step.saturating_add(self.low_ticks),
            direction: turn.or(self.direction),
        }
    }

    /// Begins: the first half block is a rest of `lead_ticks`, so that all axes start on one tick.
    pub(crate) fn lead_in(&mut self, lead_ticks: u64, fill: &mut Fill) {
        self.reset();
        self.ended = false;
        let mut out = Out::new(fill);
        self.low_ticks = lead_ticks;
        self.spread(&mut out, lead_ticks);
        self.finish(&mut out);
    }

    /// Writes the next half block. `ahead_ticks` is what is planned and not encoded.
    pub(crate) fn fill(&mut self, segments: &mut SegmentRing, ahead_ticks: u64, fill: &mut Fill) {
        let mut out = Out::new(fill);
        // Short before it is divided: the chip divides 32 bits.
        let ahead_ticks = u32::try_from(ahead_ticks).unwrap_or(u32::MAX);
        self.low_word_ticks = if ahead_ticks <= 2 * REST_HALF_TICKS_MIN as u32 {
            LOW_WORD_TICKS_MAX
        } else {
            let half_ticks = (ahead_ticks / 2).max(REST_HALF_TICKS_MIN as u32);
            u64::from(half_ticks / REFILL_WORDS as u32).min(LOW_WORD_TICKS_MAX)
        };
        if self.turn == Turn::Due {
            self.turn = Turn::None;
            if let Some(Segment::Turn { direction }) = segments.peek() {
                segments.pop();
                self.direction = Some(direction);
                out.fill.turn = Some(direction);
            }
        }
        let mut brake_at = self.brake_at();
        while out.left() > 0 && !self.ended {
            if out.facts.ticks >= brake_at {
                brake_at = u32::MAX;
                self.brake(segments);
            }
            if self.turn == Turn::Filling && out.count == 0 {
                self.window(&mut out);
            } else if self.low_ticks > 0 {
                self.rest(segments, &mut out);
            } else if let Some(speed_mhz) = self.stopping_mhz {
                if !self.slower_run(speed_mhz, &mut out) {
                    self.slower_step(speed_mhz, &mut out);
                }
            } else if self.steps_left > 0 {
                if self.brakes_within(brake_at, &out) || !self.run(&mut out) {
                    self.step(segments, &mut out);
                }
            } else {
                self.next(segments, &mut out);
            }
        }
        self.finish(&mut out);
    }

    /// Adds up what was written. Behind an end marker lie others.
    fn finish(&mut self, out: &mut Out<'_>) {
        out.fill.words[out.count..].fill(Symbol::END);
        self.half_before = out.facts;
        self.last_part_ticks = out.fill.words[REFILL_WORDS - 1].second().0 as u32;
        self.encoded_ticks += u64::from(out.facts.ticks);
        out.fill.sign = self.direction.map_or(1, Direction::sign);
        if out.fill.turn.is_some() {
            let first_step = (out.fill.step_words.trailing_zeros() as usize).min(REFILL_WORDS);
            let rest = out.fill.words[..first_step].iter();
            let rest_ticks: u64 = rest.map(|word| word.ticks()).sum();
            out.fill.turn_by_ticks = rest_ticks as i32 - self.timing.setup_ticks as i32;
        }
        out.fill.ticks = out.facts.ticks;
    }

    /// Takes the next segment.
    fn next(&mut self, segments: &mut SegmentRing, out: &mut Out<'_>) {
        match segments.peek() {
            Some(Segment::Steps {
                step_count,
                offset,
                interval,
                change,
                total_ticks,
            }) => {
                segments.pop();
                self.steps_left = step_count;
                self.left_ticks = total_ticks;
                self.interval = interval as i64;
                self.change = change;
                self.offset = i64::from(offset);
            }
            Some(Segment::Low { ticks }) => {
                segments.pop();
                self.low_ticks = ticks;
                self.resting = true;
            }
            Some(Segment::Turn { .. }) => self.begin_turn(segments, out),
            None if self.brake(segments) => {}
            None => self.end(out),
        }
    }

    /// Writes a step of the present segment.
    fn step(&mut self, segments: &mut SegmentRing, out: &mut Out<'_>) {
        self.steps_left -= 1;
        self.next_interval();
        let high_ticks = self.timing.high_of(self.interval_ticks);
        let low_ticks = self.interval_ticks - high_ticks;
        let goes_on =
            self.steps_left > 0 || matches!(segments.front(), Some(Segment::Steps { .. }));
        if goes_on || self.resting {
            self.speed_ticks = self.interval_ticks;
        }
        if goes_on {
            // What is left of a long low time is rest in other words.
            let most = LOW_WORD_TICKS_MAX.saturating_sub(high_ticks);
            let in_word = self.low_word_ticks.max(self.timing.low_ticks_min);
            let in_word = in_word.min(most).max(PART_TICKS_MIN);
            self.write_step(high_ticks, low_ticks, in_word, out);
        } else {
            // What follows may be a turn: it wants the hold time in this word and all the rest
            // still unwritten.
            let mut low_ticks = low_ticks;
            let rest = segments.peek();
            if let Some(Segment::Low { ticks }) = rest {
                segments.pop();
                low_ticks += ticks;
            }
            let wanted = self.timing.hold_ticks.max(self.timing.low_ticks_min);
            self.write_step(high_ticks, low_ticks, wanted, out);
            self.resting = matches!(rest, Some(Segment::Low { .. } | Segment::Turn { .. }));
        }
    }

    /// Takes the time from this edge to the next one of the segment, or to its end.
    fn next_interval(&mut self) {
        if self.steps_left == 0 {
            self.interval_ticks = self.left_ticks;
            return;
        }
        // Rounded to the nearest tick; what is over is kept for the next one.
        self.offset += self.interval;
        self.interval += self.change;
        let ticks = (self.offset + (1 << (FRACTION_BITS - 1))) >> FRACTION_BITS;
        // At the driver's limit two edges may round to one tick less; the second one waits.
        let ticks = ticks.max(self.timing.interval_ticks_min() as i64);
        self.offset -= ticks << FRACTION_BITS;
        self.interval_ticks = ticks as u64;
        self.left_ticks = self.left_ticks.saturating_sub(self.interval_ticks);
    }

    /// Writes the word of a step with up to `word_low_ticks` of its low time, and owes the rest.
    fn write_step(
        &mut self,
        high_ticks: u64,
        low_ticks: u64,
        word_low_ticks: u64,
        out: &mut Out<'_>,
    ) {
        let mut in_word = low_ticks.min(word_low_ticks);
        let owed = low_ticks - in_word;
        if owed > 0 && owed < WORD_TICKS_MIN {
            // Less than a word: the two parts share it.
            in_word = if in_word >= WORD_TICKS_MIN + PART_TICKS_MIN {
                in_word - WORD_TICKS_MIN
            } else {
                low_ticks
            };
        }
        out.push_step(Symbol::step(high_ticks, in_word));
        self.low_ticks = low_ticks - in_word;
        self.low_ticks_since_step = in_word;
        self.resting = false;
    }
}
