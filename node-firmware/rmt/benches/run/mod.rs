//! The pulse path as the chip runs it, on registers that play words in a time of their own: the
//! streamer with its lanes, the encoder, the ledger and the planner. Also for a machine without an
//! operating system.

mod hardware;

use core::{hint::black_box, sync::atomic::AtomicU32};
use hardware::Hardware;
use keys::{AxisId, Command, StopMode, status::FaultCode};
use motion::{
    Axis, AxisProfile, CommandRing, Motion, MotionConfig, MotionEvent, PlanMemory, StepBackend,
    Ticks, limits,
};
use rmt::{Place, START_TICKS, Streamer, StreamerConfig};

/// A turn of the planning task while a stop is under way: 1 ms.
const TURN_TICKS: u64 = 1_000 * motion::TICKS_PER_US;

/// Corner speed of the lines: what the short ones of the cases pass at 20 kHz.
const JUNCTION_HZ: u32 = 3_000;

/// Consumes words and lets the interrupt in whenever a unit was played.
struct Pulses<const AXES: usize> {
    streamer: Streamer<Hardware, [Axis; AXES]>,
    count: fn() -> u32,
    run: Run,
}

/// What a run took.
#[derive(Clone, Copy, Default)]
pub(crate) struct Run {
    /// Words that were played.
    pub(crate) words: u32,
    /// Instructions of the refill interrupts, as the given counter counts.
    pub(crate) refill_instructions: u64,
    /// Instructions of what only the count needs.
    pub(crate) own_instructions: u64,
    /// Registers and words of RMT RAM that the interrupts touched.
    pub(crate) accesses: u32,
    /// How long it moved, ticks.
    pub(crate) ticks: u64,
}

/// The whole interrupt, under a name that a profiler's counts can be found by.
#[inline(never)]
fn refill_of_axes<const AXES: usize>(streamer: &mut Streamer<Hardware, [Axis; AXES]>) -> bool {
    black_box(streamer.on_interrupt()).wake
}

impl<const AXES: usize> Pulses<AXES> {
    fn new(count: fn() -> u32) -> Self {
        let mut channel = 0;
        // A block each, as on a chip with four axes.
        let places = [(); AXES].map(|()| {
            channel += 1;
            Place {
                channel: channel - 1,
                blocks: 1,
            }
        });
        let axes = [const { Axis::new() }; AXES];
        let config = StreamerConfig {
            places: &places,
            divider: 5,
            prefetch_words: hardware::PREFETCH_WORDS,
        };
        let mut streamer = Streamer::new(Hardware::new(), config, axes);
        streamer.begin();
        Self {
            streamer,
            count,
            run: Run::default(),
        }
    }
}

impl<const AXES: usize> StepBackend for Pulses<AXES> {
    fn axes(&mut self) -> &mut [Axis] {
        self.streamer.axes()
    }

    fn start_ticks(&self) -> u64 {
        START_TICKS
    }

    fn start(&mut self, now: Ticks, lead_ticks: u64) {
        self.streamer.registers_mut().wait_until(now.0);
        self.streamer.start(now, lead_ticks);
    }

    fn service(&mut self, until: Ticks) -> Ticks {
        self.streamer.resume();
        while self.streamer.is_playing() {
            let before = (self.count)();
            let hardware = self.streamer.registers_mut();
            let from = hardware.time();
            let played = hardware.play(until.0);
            self.run.words += played;
            self.run.ticks += hardware.time() - from;
            let accesses = hardware.accesses();
            let is_due = hardware.time() < until.0;
            let begun = (self.count)();
            let own = u64::from(begun.wrapping_sub(before));
            self.run.own_instructions += own;
            if !is_due {
                break;
            }
            let wanted = refill_of_axes(&mut self.streamer);
            let ended = (self.count)();
            self.run.refill_instructions += u64::from(ended.wrapping_sub(begun));
            self.run.accesses += self.streamer.registers().accesses() - accesses;
            if wanted {
                let now = self.streamer.registers().time();
                self.streamer.hold();
                return Ticks(now.min(until.0 - 1));
            }
            self.run.own_instructions += u64::from((self.count)().wrapping_sub(ended));
        }
        self.streamer.hold();
        self.streamer.registers_mut().wait_until(until.0);
        until
    }

    fn is_playing(&self) -> bool {
        self.streamer.is_playing()
    }

    fn halt(&mut self, now: Ticks) -> Ticks {
        self.streamer.halt(now)
    }

    fn played_steps(&self, axis: AxisId) -> i64 {
        self.streamer.played_steps(axis)
    }

    fn take_fault(&mut self) -> Option<FaultCode> {
        self.streamer.take_fault()
    }
}

/// Executes commands to their end, or stops the first one as soon as it moves; `count` tells how
/// many instructions were executed so far.
#[inline(never)]
pub(crate) fn execute(
    memory: &[AtomicU32],
    axis_count: usize,
    commands: impl ExactSizeIterator<Item = Command>,
    stops: bool,
    count: fn() -> u32,
) -> Run {
    match axis_count {
        1 => execute_on::<1>(memory, commands, stops, count),
        2 => execute_on::<2>(memory, commands, stops, count),
        _ => execute_on::<{ limits::CHANNELS }>(memory, commands, stops, count),
    }
}

fn execute_on<const AXES: usize>(
    memory: &[AtomicU32],
    commands: impl ExactSizeIterator<Item = Command>,
    stops: bool,
    count: fn() -> u32,
) -> Run {
    let mut config = MotionConfig {
        axis_count: AXES,
        ..MotionConfig::default()
    };
    config.axes = [AxisProfile {
        junction_hz: JUNCTION_HZ,
        ..AxisProfile::default()
    }; limits::CHANNELS];
    let mut memory_of_plans = PlanMemory::new();
    let plans = memory_of_plans.plans();
    let pulses = Pulses::<AXES>::new(count);
    let mut motion = Motion::new(CommandRing::new(memory), plans, pulses, config);
    let accepted = commands.len();
    let mut reservation = motion.reserve(accepted).expect("room");
    for command in commands {
        reservation.push(&command);
    }
    reservation.commit();
    let mut now = Ticks(1);
    if stops {
        while motion.backend().run.words < limits::CHANNEL_WORDS as u32 {
            black_box(motion.poll(now));
            now = now.plus(TURN_TICKS);
        }
        motion.stop(StopMode::Decelerate, now);
        while !matches!(motion.poll(now), Some(MotionEvent::Stopped)) {
            now = now.plus(TURN_TICKS);
        }
        return motion.backend().run;
    }
    while motion.executed_commands() < accepted as u64 {
        let event = black_box(motion.poll(now));
        assert!(!matches!(event, Some(MotionEvent::Fault(_))), "{event:?}");
        now = now.plus(1_000_000_000_000);
    }
    motion.backend().run
}
