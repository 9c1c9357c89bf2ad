//! A back end without hardware: it asks for half blocks as fast as it can, so that what is measured
//! is the encoder, the ledger and the planner alone. Also for a machine without an operating
//! system.

use core::{hint::black_box, sync::atomic::AtomicU32};
use keys::{AxisId, Command, StopMode, status::FaultCode};
use motion::{
    Axis, CommandRing, Fill, Motion, MotionConfig, MotionEvent, PlanMemory, StepBackend, Ticks,
    limits,
};

/// Consumes half blocks at once.
struct Sink {
    axes: [Axis; limits::CHANNELS],
    half: usize,
    count: fn() -> u32,
    run: Run,
    playing: bool,
    /// It consumes one half block a call, so that a stop comes before the end.
    is_slow: bool,
}

/// What a run took.
#[derive(Clone, Copy, Default)]
pub(crate) struct Run {
    /// Half blocks that were refilled.
    pub(crate) refills: u32,
    /// Instructions of that, as the given counter counts.
    pub(crate) refill_instructions: u64,
    /// Instructions of what only the count needs.
    pub(crate) own_instructions: u64,
    /// How long the motion lasted, ticks.
    pub(crate) ticks: u64,
}

/// The whole refill of one axis, under a name that a profiler's counts can be found by.
#[inline(never)]
fn refill_of_axis(axis: &mut Axis, half: usize) -> Fill {
    black_box(axis.fill(half))
}

impl StepBackend for Sink {
    fn axes(&mut self) -> &mut [Axis] {
        &mut self.axes
    }

    fn start(&mut self, _now: Ticks, lead_ticks: u64) {
        for axis in &mut self.axes {
            black_box(axis.lead_in(lead_ticks));
        }
        self.half = 1;
        self.playing = true;
    }

    fn service(&mut self, until: Ticks) -> Ticks {
        while self.playing {
            self.playing = false;
            for (index, axis) in self.axes.iter_mut().enumerate() {
                if axis.has_ended() {
                    continue;
                }
                let before = (self.count)();
                let fill = refill_of_axis(axis, self.half);
                let behind = (self.count)();
                self.run.refills += 1;
                self.playing |= !axis.has_ended();
                if index == 0 {
                    self.run.ticks += fill.words.iter().map(|word| word.ticks()).sum::<u64>();
                }
                let instructions = behind.wrapping_sub(before);
                self.run.refill_instructions += u64::from(instructions);
                let own = (self.count)().wrapping_sub(behind);
                self.run.own_instructions += u64::from(own);
            }
            self.half ^= 1;
            if self.is_slow {
                break;
            }
            if self.axes.iter().any(Axis::wants_planning) {
                return Ticks(until.0 - 1);
            }
        }
        until
    }

    fn is_playing(&self) -> bool {
        self.playing
    }

    fn halt(&mut self, now: Ticks) -> Ticks {
        self.playing = false;
        now
    }

    fn played_steps(&self, axis: AxisId) -> i64 {
        self.axes[usize::from(axis.0)].ledger().booked_steps()
    }

    fn take_fault(&mut self) -> Option<FaultCode> {
        None
    }
}

/// Executes commands to their end, or stops the first one at once; `count` tells how many instructions were executed so far.
#[inline(never)]
pub(crate) fn execute(
    memory: &[AtomicU32],
    axis_count: usize,
    commands: impl ExactSizeIterator<Item = Command>,
    stops: bool,
    count: fn() -> u32,
) -> Run {
    let sink = Sink {
        axes: [const { Axis::new() }; limits::CHANNELS],
        half: 0,
        count,
        run: Run::default(),
        playing: false,
        is_slow: stops,
    };
    let config = MotionConfig {
        axis_count,
        ..MotionConfig::default()
    };
    let mut memory_of_plans = PlanMemory::new();
    let plans = memory_of_plans.plans();
    let mut motion = Motion::new(CommandRing::new(memory), plans, sink, config);
    let accepted = commands.len();
    let mut reservation = motion.reserve(accepted).expect("room");
    for command in commands {
        reservation.push(&command);
    }
    reservation.commit();
    let mut now = Ticks(1);
    if stops {
        black_box(motion.poll(now));
        motion.stop(StopMode::Decelerate, now);
        while !matches!(motion.poll(now), Some(MotionEvent::Stopped)) {
            now = now.plus(1_000_000_000_000);
        }
        return motion.backend().run;
    }
    while motion.executed_commands() < accepted as u64 {
        black_box(motion.poll(now));
        now = now.plus(1_000_000_000_000);
    }
    motion.backend().run
}
