//! Ways of axes that are driven each by itself: no line joins them, and each is changed alone.
//!
//! ```text
//!   axis 0  ─┤way──────┊changed──────────────┤rest───────────
//!   axis 1  ─┤rest─────────┤way────┤rest─┤way back────────┤──
//! ```
//!
//! An axis that rests plays on as long as another one is under way, so that it can begin within 2 ms
//! too, and on a timeline that never drifts. What is changed on one axis is taken back and written
//! anew on that axis only.

use super::{
    CUT_MARGIN_TICKS, Ease, Goal, Left, Made, Planner, Split, Stretch, Tail, WAY_STEPS_MAX,
    timing_of,
    way::{Ends, Onward, Short, WAY_STRETCHES_MAX, room_of},
};
use crate::{
    axis::Axis,
    law::Law,
    limits::{CHANNELS, WORD_TICKS_MIN},
    lookahead::Line,
    path::{Path, State},
    profile::Timing,
    real::Real,
    segment::Direction,
    steps::{Exit, Moment, Steps},
};

impl Planner {
    /// Returns whether the way of an axis can be changed now; if not, when more of it is encoded.
    pub(crate) fn can_change_way(&mut self, index: usize, axis: &Axis, started_at: u64) -> bool {
        let way = &mut self.ways[index];
        let room = &mut self.stretches[room_of(index)];
        way.retire(room, started_at + axis.encoded_ticks());
        // It is left, slows down, comes back, and rests behind its target.
        way.count + 3 <= WAY_STRETCHES_MAX && !axis.has_ended()
    }

    /// Takes back what is not encoded of an axis and leaves its way there.
    pub(crate) fn leave_way(&mut self, index: usize, axis: &mut Axis, started_at: u64) -> Left {
        let cut = started_at + axis.committed_ticks() + CUT_MARGIN_TICKS;
        self.rewind_way(index, axis, started_at);
        let room = &mut self.stretches[room_of(index)];
        let left = self.ways[index].leave(room, index, cut, self.tails[index].direction);
        if let Left::Resting { at, .. } = left
            && self.ways.iter().all(|way| way.count == 0)
        {
            self.ways_rest_at = self.ways_rest_at.max(Some(at));
        }
        left
    }

    fn rewind_way(&mut self, index: usize, axis: &mut Axis, started_at: u64) {
        let rewound = axis.rewind();
        let tail = &mut self.tails[index];
        *tail = Tail {
            low_ticks: rewound.low_ticks,
            direction: rewound.direction,
            at: started_at + rewound.encoded_ticks,
            edge_at: None,
        };
        let way = &mut self.ways[index];
        way.made = Made {
            at: tail.at,
            booked_steps: axis.ledger().booked_steps(),
        };
        way.steps = None;
        let at = tail.at;
        way.writing = way
            .all(&self.stretches[room_of(index)])
            .take_while(|stretch| stretch.end_ticks <= at)
            .count();
    }

    /// The channels start; what is written begins at `begin`.
    pub(crate) fn begin_ways(&mut self, begin: u64) {
        // No line is under way; the ways take its room.
        self.count = 0;
        self.writing = 0;
        for (tail, way) in self.tails.iter_mut().zip(&mut self.ways) {
            tail.at = begin;
            way.clear();
        }
        self.ways_rest_at = None;
    }

    /// Begins a way from rest at `begin` or as soon as the axis may turn. Returns its steps with sign
    /// until it rests.
    pub(crate) fn begin_way(
        &mut self,
        index: usize,
        line: Line,
        ends: Ends,
        begin: u64,
        base_steps: i64,
        axes: &[Axis],
    ) -> i64 {
        let timing = timing_of(axes);
        let asked = line;
        let line = self.within(line, &timing[..axes.len()]);
        let mut from = State::REST;
        if ends.jump_steps > 0 {
            let jump = u64::from(ends.jump_steps).min(line.major_steps);
            from.speed = line.law.jump_speed(Real::of(jump)).min(line.speed_max);
        }
        let way = Real::of(line.major_steps);
        let reached = Path::speed_reached(from, way, line.speed_max, &line.law);
        let passing = (ends.passing * self.share()).min(reached);
        let direction = Direction::of(line.steps[index]);
        let short = self.ways[index].short;
        let made_at = short.map(|short| short.made_at(base_steps, direction, line.speed_max));
        let begin = begin.max(made_at.unwrap_or(0));
        let mut all_steps = [0; CHANNELS];
        all_steps[index] = base_steps;
        let mut stretch = Stretch {
            line,
            from,
            goal: Goal::Leave(passing),
            until: None,
            begin: Moment::of(begin),
            end_ticks: 0,
            exit: if passing.is_none() {
                Exit::Rest
            } else {
                Exit::Moving
            },
            share: self.share,
            base_steps: all_steps,
        };
        let mut steps = Steps::NONE;
        stretch.take_steps_of(index, &mut steps, &timing);
        let tail = &self.tails[index];
        if let Some((edge, direction)) = steps.first_edge(0)
            && self.heading(index) != Some(direction)
        {
            // What is planned before rests from its last step on; that is written up to `tail.at`.
            let since = match self.way(index).last() {
                Some(before) => self.rest_before(index, before, begin),
                None => tail.low_ticks.saturating_add(begin.saturating_sub(tail.at)),
            };
            let rest_ticks = since.saturating_add(edge - begin);
            let missing = axes[index]
                .timing()
                .window_ticks()
                .saturating_sub(rest_ticks);
            if missing > 0 {
                steps.delay(missing.max(WORD_TICKS_MIN));
            }
        }
        stretch.begin = steps.begin();
        stretch.end_ticks = steps.end().ticks;
        self.push_way(index, stretch);
        if passing.is_none() {
            return line.steps[index];
        }
        let split = Split {
            line: asked,
            from: steps.path_mut().end_state(),
            at: steps.end(),
            base_steps: all_steps,
        };
        self.go_on_way(index, split, Onward::ToRest, axes).1
    }

    /// Returns the speed, up to this one, with which a way that was left can pass the end of its line;
    /// `None`: it would be faster, or rests there.
    pub(crate) fn passing_speed(&self, split: &Split, speed: Real, axes: &[Axis]) -> Option<Real> {
        let timing = timing_of(axes);
        let line = self.within(split.line, &timing[..axes.len()]);
        let end = Real::of(line.major_steps);
        let way = end - split.from.place;
        if speed.is_none() || way.is_none() {
            return None;
        }
        let reached = Path::speed_reached(split.from, way, line.speed_max, &line.law);
        let speed = (speed * self.share()).min(reached);
        let path = Path::plan(split.from, end, speed, line.speed_max, &line.law);
        path.is_ok().then_some(speed)
    }

    fn way(&self, index: usize) -> impl Iterator<Item = &Stretch> {
        self.ways[index].all(&self.stretches[room_of(index)])
    }

    fn push_way(&mut self, index: usize, stretch: Stretch) {
        self.ways[index].push(&mut self.stretches[room_of(index)], stretch);
        self.ways_rest_at = None;
    }

    /// Which way an axis goes at the end of what is planned.
    fn heading(&self, index: usize) -> Option<Direction> {
        let last = self.way(index).last();
        match last {
            Some(stretch) if stretch.end_ticks > self.tails[index].at => {
                Some(Direction::of(stretch.line.steps[index]))
            }
            _ => self.tails[index].direction,
        }
    }

    /// Least rest from the last step's high time of a stretch until `begin`, behind its end.
    fn rest_before(&self, index: usize, before: &Stretch, begin: u64) -> u64 {
        let tail = &self.tails[index];
        if before.end_ticks <= tail.at {
            return tail.low_ticks.saturating_add(begin.saturating_sub(tail.at));
        }
        begin - before.end_ticks
    }

    /// Goes on with a way that was left. Returns where it rests: the tick, and steps of the line with
    /// sign.
    pub(crate) fn go_on_way(
        &mut self,
        index: usize,
        split: Split,
        onward: Onward,
        axes: &[Axis],
    ) -> (u64, i64) {
        let timing = timing_of(axes);
        let to_rest = matches!(onward, Onward::ToRest);
        let mut line = split.line;
        let sign = line.steps[index].signum();
        if to_rest {
            line.major_steps = WAY_STEPS_MAX as u64;
            line.steps[index] = sign * WAY_STEPS_MAX as i64;
        }
        let mut stretch = Stretch {
            line: self.within(line, &timing[..axes.len()]),
            from: split.from,
            goal: match onward {
                Onward::ToRest => Goal::Rest(Ease::none(&split.line)),
                Onward::ToEnd => Goal::Leave(Real::ZERO),
                Onward::Past(speed) => Goal::Leave(speed),
            },
            until: None,
            begin: split.at,
            end_ticks: 0,
            exit: match onward {
                Onward::Past(_) => Exit::Moving,
                Onward::ToEnd | Onward::ToRest => Exit::Rest,
            },
            share: self.share,
            base_steps: split.base_steps,
        };
        let mut steps = Steps::NONE;
        stretch.take_steps_of(index, &mut steps, &timing);
        let end_steps = steps.path_mut().end_steps();
        stretch.end_ticks = steps.end().ticks;
        self.push_way(index, stretch);
        if let Onward::Past(_) = onward {
            let behind = Split {
                from: steps.path_mut().end_state(),
                at: steps.end(),
                ..split
            };
            return self.go_on_way(index, behind, Onward::ToRest, axes);
        }
        let made = match to_rest {
            true => sign * end_steps.rounded(),
            false => line.steps[index],
        };
        let base_steps = split.base_steps[index] + made;
        let steps = Real::of_signed(sign * made) - end_steps;
        self.ways[index].short = (to_rest && !steps.is_negative()).then_some(Short {
            at: stretch.end_ticks,
            base_steps,
            direction: Direction::of(sign),
            steps,
        });
        (stretch.end_ticks, made)
    }

    /// Returns the way that a left one still needs until rest by this law, from its line's begin.
    pub(crate) fn least_way(split: &Split, law: &Law) -> Real {
        let mut to_rest = Path::at(split.from);
        to_rest.come_to_rest(law);
        to_rest.end_steps()
    }

    fn within(&self, mut line: Line, timing: &[Timing]) -> Line {
        line.speed_max = (line.speed_max * self.share()).min(line.driver_speed_max(timing));
        line
    }

    /// Returns when the last of the ways ends; one that was left before its first step, too.
    pub(crate) fn ways_end(&self) -> Option<u64> {
        let ends = (0..CHANNELS).filter_map(|index| self.way(index).last());
        let end = ends.map(|stretch| stretch.end_ticks).max();
        end.or(self.ways_rest_at)
    }

    /// Returns when the way of an axis ends or has ended.
    pub(crate) fn way_end(&self, index: usize) -> Option<u64> {
        let last = self.way(index).last().map(|stretch| stretch.end_ticks);
        last.or(self.ways[index].retired_until)
    }

    /// Goes on with all ways, and with the rest of who has none, up to `until`.
    pub(crate) fn write_ways(&mut self, axes: &mut [Axis], until: u64, started_at: u64) {
        let timing = timing_of(axes);
        let timing = &timing[..axes.len()];
        for (index, axis) in axes.iter_mut().enumerate() {
            if self.tails[index].at > until && !axis.has_ended() {
                // Another axis ends earlier than it was to.
                self.rewind_way(index, axis, started_at);
            }
            let tail = &mut self.tails[index];
            let way = &mut self.ways[index];
            let room = &self.stretches[room_of(index)];
            if way.write(room, index, axis, tail, timing) && tail.at < until && axis.has_room() {
                let ends_in_a_word = until - tail.at < WORD_TICKS_MIN && tail.edge_at.is_none();
                if !ends_in_a_word {
                    tail.rest(axis, until);
                }
            }
        }
    }

    /// Forgets what is encoded of the ways.
    pub(crate) fn retire_ways(&mut self, axes: &[Axis], started_at: u64) {
        for (index, axis) in axes.iter().enumerate() {
            let room = &mut self.stretches[room_of(index)];
            self.ways[index].retire(room, started_at + axis.encoded_ticks());
        }
    }

    /// Returns the way of one axis from `now` until rest if it slowed down as soon as it can.
    pub(crate) fn way_to_stop_of(
        &self,
        index: usize,
        axis: &Axis,
        started_at: u64,
        now: u64,
    ) -> Real {
        let Some((stretch, cut)) = self.under_way(index, axis, started_at) else {
            return Real::ZERO;
        };
        let path = stretch.path();
        let mut slower = path;
        slower.cut(Real::of(cut - stretch.begin.ticks));
        slower.come_to_rest(&stretch.line.law);
        let since = Real::of(now.saturating_sub(stretch.begin.ticks));
        slower.end_steps() - path.state_at(since).place
    }

    /// Returns the speed of an axis with sign, steps a tick, where its way can be changed now; 0 where it
    /// rests.
    pub(crate) fn way_speed(&self, index: usize, axis: &Axis, started_at: u64) -> Real {
        let Some((stretch, cut)) = self.under_way(index, axis, started_at) else {
            return Real::ZERO;
        };
        let since = Real::of(cut - stretch.begin.ticks);
        let speed = stretch.path().state_at(since).speed;
        match Direction::of(stretch.line.steps[index]) {
            Direction::Positive => speed,
            Direction::Negative => Real::ZERO - speed,
        }
    }

    /// Returns speed and acceleration of an axis with sign where its way can be changed now, steps a
    /// tick and a tick², and whether it turns behind that; `None`: it rests.
    pub(crate) fn way_pace(
        &self,
        index: usize,
        axis: &Axis,
        started_at: u64,
    ) -> Option<([Real; 2], bool)> {
        let (stretch, cut) = self.under_way(index, axis, started_at)?;
        let since = Real::of(cut - stretch.begin.ticks);
        let State { speed, accel, .. } = stretch.path().state_at(since);
        let sign = stretch.line.steps[index].signum();
        let last = self.way(index).last()?;
        let turns = last.line.steps[index].signum() != sign;
        let pace = if sign < 0 {
            [-speed, -accel]
        } else {
            [speed, accel]
        };
        Some((pace, turns))
    }

    /// What an axis does when its way can be changed, and when that is; `None`: it rests.
    fn under_way(&self, index: usize, axis: &Axis, started_at: u64) -> Option<(&Stretch, u64)> {
        let cut = started_at + axis.committed_ticks() + CUT_MARGIN_TICKS;
        let under_way = |stretch: &&Stretch| stretch.begin.ticks <= cut && cut < stretch.end_ticks;
        Some((self.way(index).find(under_way)?, cut))
    }
}
