//! Commands to segments, on one timeline for all axes.
//!
//! Every command takes the same time on every axis: who does not step, rests. So axes that began
//! on one tick meet every later command on one tick, and no drift can grow.
//!
//! ```text
//!   axis 0  ─┤move├────────────┤rest├──────┤sync├───────
//!   axis 1  ─┤rest├──┤turn├────┤move├──────┤sync├┤rest├─
//! ```
//!
//! A change of direction needs a window of rest (see the encoder). Mostly the time between two
//! steps is enough; where it is not, all axes rest a little longer, and that is the only time that
//! is added to what a job asks for: at most 210 µs with the default profile, where two steps in opposite directions are next to each
//! other.

use crate::{
    axis::Axis,
    limits::{CHANNELS, WORD_TICKS_MIN},
    lookahead::{Line, Lines, LookAhead},
    path::{Path, State},
    profile::Timing,
    real::Real,
    segment::Direction,
    steps::{Exit, Moment, Steps},
};

mod brake;
mod change;
mod raw;
mod stretch;
mod tail;
mod way;
mod ways;

pub(crate) use raw::{Played, Run, command_ticks, runs_of, ticks_of};
pub(crate) use tail::Tail;
pub(crate) use way::{Ends, Left, Onward};

use stretch::{Ease, Goal, Stretch};
use way::Way;

/// What is known of a ramp or line when it begins.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Begun {
    /// Tick of the first edge of all.
    pub(crate) first_edge_ticks: Option<u64>,
    /// Tick of its end.
    pub(crate) end_ticks: u64,
    /// Where it ends at rest before the line does.
    pub(crate) held: Option<Split>,
}

/// Stretches of path that are not encoded to their end. Full is an answer: the planner waits.
pub(crate) const STRETCHES_MAX: usize = 32;

/// A line that was left in flight.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Split {
    pub(crate) line: Line,
    /// Where it was left, or is.
    pub(crate) from: State,
    /// When it goes on.
    pub(crate) at: Moment,
    pub(crate) base_steps: [i64; CHANNELS],
}

/// So many stretches are forgotten at once: those behind them are moved.
const RETIRED_MIN: usize = 8;

const _: () = assert!(RETIRED_MIN < STRETCHES_MAX / 2);

/// Longest way of one drive, steps: 360,000 years at 200 kHz.
pub(crate) const WAY_STEPS_MAX: i128 = 1 << 61;

/// A path that is left more slowly than one step in this time is at rest: 4.6 hours.
const SLOWEST_TICKS: u64 = 1 << 38;

/// A path that ends within 2⁻²⁰ steps of its line's end makes all of it.
const WHOLE_BITS: i32 = 20;

fn timing_of(axes: &[Axis]) -> [Timing; CHANNELS] {
    core::array::from_fn(|index| axes.get(index).unwrap_or(&axes[0]).timing())
}

/// How the last line is left: speed and acceleration of the tool, and when.
#[derive(Clone, Copy, Debug)]
struct Exited {
    speed: Real,
    accel: Real,
    at: Moment,
}

/// How far an axis is encoded.
#[derive(Clone, Copy, Debug)]
struct Made {
    at: u64,
    booked_steps: i64,
}

/// What is planned so far: where each axis' timeline ends.
#[derive(Clone, Debug)]
pub(crate) struct Planner {
    tails: [Tail; CHANNELS],
    stretches: [Option<Stretch>; STRETCHES_MAX],
    count: usize,
    /// Index of the stretch that is written next.
    writing: usize,
    /// What is not yet written of the one before, if anything is. In place: it has some 4 KB.
    steps: Steps<CHANNELS>,
    is_writing: bool,
    left: Option<Exited>,
    ahead: LookAhead,
    /// What was encoded when the plan was left last.
    rewound: [Made; CHANNELS],
    /// Every line comes to rest as soon as it can.
    holding: bool,
    /// Share of the lines' speeds, 2⁻¹⁶.
    share: u32,
    /// Axes that are driven each by itself.
    ways: [Way; CHANNELS],
    /// When all ways have been left at rest: from when on.
    ways_rest_at: Option<u64>,
    /// An axis has a brake.
    braked: bool,
}

/// All of a line's speed.
const WHOLE: u32 = 1 << 16;

/// A change in flight takes effect this much behind what is encoded: no rest between two edges is
/// then shorter than a word.
const CUT_MARGIN_TICKS: u64 = 4 * WORD_TICKS_MIN;

fn share_of(share: u32) -> Real {
    Real::of(u64::from(share)).shifted(-16)
}

/// Returns a line that was planned with this share of its speed as it was asked for.
fn unshared(mut line: Line, share: u32) -> Line {
    line.speed_max = line.speed_max / share_of(share);
    line
}

impl Planner {
    pub(crate) const fn new() -> Self {
        Self {
            tails: [Tail::REST; CHANNELS],
            stretches: [None; STRETCHES_MAX],
            count: 0,
            writing: 0,
            steps: Steps::NONE,
            is_writing: false,
            left: None,
            ahead: LookAhead::new(),
            rewound: [Made {
                at: 0,
                booked_steps: 0,
            }; CHANNELS],
            holding: false,
            share: WHOLE,
            ways: [Way::NONE; CHANNELS],
            ways_rest_at: None,
            braked: false,
        }
    }

    /// Becomes as new, field by field: another one would be put together on the stack.
    pub(crate) fn reset(&mut self) {
        self.forget();
        self.rewound = [Made {
            at: 0,
            booked_steps: 0,
        }; CHANNELS];
        self.share = WHOLE;
        self.ways.iter_mut().for_each(Way::reset);
        self.ways_rest_at = None;
    }

    /// An axis that rests was turned by somebody else.
    pub(crate) fn take_direction(&mut self, index: usize, axis: &mut Axis, direction: Direction) {
        self.tails[index].direction = Some(direction);
        axis.take_direction(direction);
    }

    /// Returns whether the next line must follow without a gap.
    pub(crate) fn is_at_speed(&self) -> bool {
        self.left.is_some()
    }

    /// Returns whether the last that is planned, up to `timeline`, is a line that ends at rest
    /// although it could be left at speed if another one followed.
    pub(crate) fn ends_early(&self, timeline: u64) -> bool {
        let last = self.stretches[..self.count].last().copied().flatten();
        last.is_some_and(|stretch| {
            stretch.line.joins && stretch.exit == Exit::Rest && stretch.end_ticks == timeline
        })
    }

    /// Returns whether something of a path is not written.
    pub(crate) fn is_unfinished(&self) -> bool {
        let ways = self.ways.iter().any(Way::is_unfinished);
        ways || self.left.is_some() || self.is_writing || self.writing < self.count
    }

    /// All axes rest, and nothing is planned.
    pub(crate) fn rest(&mut self) {
        for tail in &mut self.tails {
            tail.low_ticks = u64::MAX;
        }
        self.drop_path();
    }

    /// The queue was dropped: what was planned for the direction pins may not have happened.
    pub(crate) fn forget(&mut self) {
        self.tails = [Tail::REST; CHANNELS];
        self.drop_path();
        self.holding = false;
    }

    fn drop_path(&mut self) {
        self.count = 0;
        self.writing = 0;
        self.is_writing = false;
        self.left = None;
        self.ahead.clear();
        self.ways.iter_mut().for_each(Way::clear);
        self.ways_rest_at = None;
    }

    /// Returns whether another line can begin; a change and a stop then still can, too.
    pub(crate) fn has_room(&self) -> bool {
        self.count + 2 < STRETCHES_MAX
    }

    /// Returns whether what is under way at `cut` can be left for something else; after a change
    /// that is no stop, a stop still can.
    pub(crate) fn can_change(&self, cut: u64, stops: bool) -> bool {
        let spare = if stops { 1 } else { 2 };
        let under_way = self.stretch_at(cut);
        under_way.is_some_and(|index| index + spare < STRETCHES_MAX)
    }

    /// Returns whether something of a path is planned.
    pub(crate) fn has_path(&self) -> bool {
        self.count > 0
    }

    /// Forgets what is encoded on every axis: several stretches at once, or the last ones.
    pub(crate) fn retire(&mut self, encoded_ticks: u64) {
        let ended = |stretch: &Option<Stretch>| {
            stretch.is_none_or(|stretch| stretch.end_ticks <= encoded_ticks)
        };
        let done = self.stretches[..self.writing]
            .iter()
            .take_while(|stretch| ended(stretch))
            .count();
        if done >= RETIRED_MIN || done == self.count {
            self.stretches.copy_within(done..self.count, 0);
            self.count -= done;
            self.writing -= done;
        }
    }

    /// Goes on with the path. Returns whether it is written to its end.
    pub(crate) fn write(&mut self, axes: &mut [Axis]) -> bool {
        loop {
            if self.is_writing {
                if !self.steps.write(axes, &mut self.tails[..axes.len()]) {
                    return false;
                }
                self.is_writing = false;
            }
            if self.writing == self.count {
                return true;
            }
            let stretch = self.stretches[self.writing].as_ref();
            let stretch = stretch.expect("below the count");
            let timing = timing_of(axes);
            stretch.plan(self.steps.path_mut());
            stretch.take_steps(&mut self.steps, &timing[..axes.len()]);
            self.begin_writing();
        }
    }

    /// Writes the next stretch, whose steps are taken, but for what was encoded of it before the plan
    /// was left.
    fn begin_writing(&mut self) {
        let stretch = self.stretches[self.writing].as_ref();
        let stretch = stretch.expect("below the count");
        for (index, rewound) in self.rewound.iter().enumerate() {
            if rewound.at > stretch.begin.ticks {
                let booked = rewound.booked_steps - stretch.base_steps[index];
                self.steps.skip(index, booked);
            }
        }
        self.is_writing = true;
        self.writing += 1;
    }

    /// Returns what is being written, if anything is.
    fn written(&self) -> Option<&Steps<CHANNELS>> {
        self.is_writing.then_some(&self.steps)
    }

    /// Begins a ramp or a line at `begin` (or where the last line is left, at speed). `behind` are
    /// the lines after it, `base_steps` what is planned for each axis before it.
    pub(crate) fn begin(
        &mut self,
        line: Line,
        jump_steps: u16,
        behind: impl Lines,
        begin: u64,
        base_steps: [i64; CHANNELS],
        axes: &[Axis],
    ) -> Begun {
        let (from, begin, moving) = match self.left.take() {
            Some(left) => (
                State {
                    place: Real::ZERO,
                    speed: left.speed / line.stretch,
                    accel: left.accel / line.stretch,
                },
                left.at,
                true,
            ),
            None => (State::REST, Moment::of(begin), false),
        };
        if moving {
            self.ahead.advance();
        } else {
            self.ahead.clear();
        }
        let speed = if jump_steps > 0 && !moving {
            let jump = u64::from(jump_steps).min(line.major_steps);
            line.law
                .jump_speed(Real::of(jump))
                .min(line.speed_max * self.share())
        } else {
            from.speed
        };
        let from = State { speed, ..from };
        self.begin_at(line, from, behind, begin, moving, base_steps, axes)
    }

    /// Goes on with a line from this place and speed.
    #[expect(
        clippy::too_many_arguments,
        reason = "one call from each of three beginnings"
    )]
    fn begin_at(
        &mut self,
        mut line: Line,
        from: State,
        behind: impl Lines,
        begin: Moment,
        moving: bool,
        base_steps: [i64; CHANNELS],
        axes: &[Axis],
    ) -> Begun {
        let timing = timing_of(axes);
        let timing = &timing[..axes.len()];
        let share = self.share();
        line.speed_max = (line.speed_max * share).min(line.driver_speed_max(timing));
        let within = |mut line: Line| {
            line.speed_max = (line.speed_max * share).min(line.driver_speed_max(timing));
            line
        };
        let goal = if self.holding && line.law.jerk().is_none() {
            Goal::Rest(Ease::none(&line))
        } else if self.holding {
            let exit_speed = self.ahead.exit_speed(&line, behind.clone(), within, timing);
            self.ahead.clear();
            Goal::Rest(Ease::of(&line, from, exit_speed, behind))
        } else {
            let exit_speed = self.ahead.exit_speed(&line, behind, within, timing);
            // No faster than can be reached within the line.
            let slows = from.accel == Real::ZERO && exit_speed <= from.speed;
            if slows && from.speed <= line.speed_max {
                Goal::Leave(exit_speed)
            } else {
                let way = Real::of(line.major_steps) - from.place;
                let reached = Path::speed_reached(from, way, line.speed_max, &line.law);
                Goal::Leave(exit_speed.min(reached))
            }
        };
        let mut stretch = Stretch {
            line,
            from,
            goal,
            until: None,
            begin,
            end_ticks: 0,
            exit: Exit::Rest,
            share: self.share,
            base_steps,
        };
        assert!(!self.is_writing, "all before is written, or left");
        let path = self.steps.path_mut();
        stretch.plan(path);
        let end = path.end_state();
        let end_steps = path.end_steps();
        let whole = Real::of(line.major_steps) - end_steps;
        let held = self.holding && whole.shifted(WHOLE_BITS).rounded() > 0;
        // A smoothstep rests from its first speed.
        let moves = line.joins && (end.speed * Real::of(SLOWEST_TICKS)).fixed(0) > 0;
        if moves && !held {
            stretch.exit = Exit::Moving;
        }
        stretch.take_steps(&mut self.steps, timing);
        if !moving {
            let missing_ticks = missing_rest(&self.steps, begin.ticks, axes, &self.tails);
            if missing_ticks > 0 {
                self.steps.delay(missing_ticks.max(WORD_TICKS_MIN));
            }
            for tail in &mut self.tails {
                tail.at = begin.ticks;
            }
            stretch.begin = self.steps.begin();
        }
        let steps = &self.steps;
        stretch.end_ticks = steps.end().ticks;
        if stretch.exit == Exit::Moving {
            self.left = Some(Exited {
                speed: end.speed * line.stretch,
                // Without a limit of jerk an acceleration ends at once.
                accel: match line.law.jerk() {
                    Some(_) => end.accel * line.stretch,
                    None => Real::ZERO,
                },
                at: steps.end(),
            });
        }
        let edges = (0..axes.len()).filter_map(|axis| steps.first_edge(axis));
        let begun = Begun {
            first_edge_ticks: edges.map(|(at, _)| at).min(),
            end_ticks: stretch.end_ticks,
            held: held.then(|| Split {
                line: unshared(line, self.share),
                from: State {
                    place: end_steps,
                    ..State::REST
                },
                at: steps.end(),
                base_steps,
            }),
        };
        assert!(self.count < STRETCHES_MAX, "asked before");
        self.stretches[self.count] = Some(stretch);
        self.count += 1;
        if self.writing + 1 == self.count {
            self.begin_writing();
        }
        begun
    }

    fn share(&self) -> Real {
        share_of(self.share)
    }

    /// Runs lines at this share of their speed, 2⁻¹⁶ (from 1), from the next one or the next
    /// [`Planner::go_on`] on.
    pub(crate) fn set_share(&mut self, share: u32) {
        self.share = share.max(1);
        self.ahead.clear();
    }

    /// From now on every line comes to rest as soon as it can, or no longer.
    pub(crate) fn hold(&mut self, holding: bool) {
        self.holding = holding;
        self.ahead.clear();
    }
}

/// Returns what the begin must be delayed for, ticks, so that every axis that turns has rested for long
/// enough.
fn missing_rest(steps: &Steps<CHANNELS>, begin: u64, axes: &[Axis], tails: &[Tail]) -> u64 {
    let mut missing_ticks = 0;
    for (index, (axis, tail)) in axes.iter().zip(tails).enumerate() {
        let Some((edge, direction)) = steps.first_edge(index) else {
            continue;
        };
        if tail.direction != Some(direction) {
            let rest_ticks = tail.low_ticks.saturating_add(edge - begin);
            let window_ticks = axis.timing().window_ticks();
            missing_ticks = missing_ticks.max(window_ticks.saturating_sub(rest_ticks));
        }
    }
    missing_ticks
}
