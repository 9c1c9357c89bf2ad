//! Commands in a second: decoded, checked, put into the ring, planned, encoded.
//!
//! A back end that plays by virtual time asks for half blocks when the chip would, so the look-ahead
//! sees what it would see there: a ring that is full while the tool moves. Wall time is that of this
//! PC; what a chip needs is counted by the bench `instructions`.

use keys::{
    AxisId, BatchHeader, BatchReader, Command, JobId, QueueId,
    batch::{BatchWriter, ORDER_BYTES_MAX},
    command::COMMAND_WORDS,
    status::FaultCode,
};
use motion::{
    Axis, AxisProfile, CommandRing, Motion, MotionConfig, MotionEvent, PlanMemory, StepBackend,
    TICKS_PER_US, Ticks, limits::CHANNELS,
};
use std::{array, sync::atomic::AtomicU32, time::Instant};

/// Commands that the ring holds, as on the board.
const RING_COMMANDS: usize = 4_096;

/// How often the planner is called without being asked.
const POLL_TICKS: u64 = 5_000 * TICKS_PER_US;

/// Plays by virtual time, without pins.
struct Paced {
    axes: [Axis; CHANNELS],
    axis_count: usize,
    /// When the half block begins that was encoded last, and when it ends.
    last: [(u64, u64); CHANNELS],
    half: usize,
    halves: [usize; CHANNELS],
    playing: bool,
}

impl Paced {
    fn fill(&mut self, index: usize) {
        let half = self.halves[index] % 2;
        let fill = self.axes[index].fill(half);
        self.halves[index] += 1;
        let ticks: u64 = fill.words.iter().map(|word| word.ticks()).sum();
        let begin = self.last[index].1;
        self.last[index] = (begin, begin + ticks);
        self.half += 1;
    }
}

impl StepBackend for Paced {
    fn axes(&mut self) -> &mut [Axis] {
        &mut self.axes
    }

    fn start(&mut self, now: Ticks, lead_ticks: u64) {
        for index in 0..self.axis_count {
            self.axes[index].lead_in(lead_ticks);
            self.halves[index] = 1;
            self.last[index] = (now.0, now.0 + lead_ticks);
            self.fill(index);
        }
        self.playing = true;
    }

    fn service(&mut self, until: Ticks) -> Ticks {
        loop {
            let axes = 0..self.axis_count;
            let next = axes
                .filter(|index| !self.axes[*index].has_ended())
                .min_by_key(|index| self.last[*index].0);
            let Some(index) = next.filter(|index| self.last[*index].0 <= until.0) else {
                let ends = self.last[..self.axis_count].iter().map(|last| last.1);
                self.playing = next.is_some() || ends.max() > Some(until.0);
                return until;
            };
            let at = self.last[index].0;
            self.fill(index);
            if self.axes[index].wants_planning() {
                return Ticks(at);
            }
        }
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

/// Commands of one batch.
const BATCH_COMMANDS: usize = 64;

/// The bytes of one batch, as a gateway sends them.
fn batch(commands: impl Iterator<Item = Command>) -> (Vec<u8>, usize) {
    let mut writer = BatchWriter::new();
    for command in commands {
        assert!(writer.push(&command), "they fit");
    }
    let header = BatchHeader {
        queue: QueueId::default(),
        first_command: 0,
        command_count: 0,
        job: JobId::new("bench").expect("legal"),
        job_end: u64::MAX,
    };
    let mut buffer = [0; ORDER_BYTES_MAX];
    let count = usize::from(writer.command_count());
    let bytes = writer.finish(header, &mut buffer).expect("room").to_vec();
    (bytes, count)
}

struct Case {
    name: &'static str,
    axis_count: usize,
    count: usize,
    command: fn(u32) -> Command,
    /// How long the motion lasts if nothing rests, s.
    ideal_s: f64,
}

/// Lines of the circle below.
const CIRCLE: u32 = 628;

/// Short lines of about 20 steps along a circle of 2,000 steps, 20 kHz.
fn curve(index: u32) -> Command {
    let place = |number: u32| {
        let angle = f64::from(number % CIRCLE) * std::f64::consts::TAU / f64::from(CIRCLE);
        [2_000.0 * angle.cos(), 2_000.0 * angle.sin()].map(|place| place.round() as i32)
    };
    let (from, to) = (place(index), place(index + 1));
    Command::Line {
        steps: [to[0] - from[0], to[1] - from[1], 0, 0],
        speed_hz: 20_000,
        accel_hz_per_s: 400_000,
        jerk_hz_per_s2: 0,
    }
}

/// The same as S-curves on four axes.
fn curve_of_four(index: u32) -> Command {
    let Command::Line { steps, .. } = curve(index) else {
        unreachable!("a line")
    };
    Command::Line {
        steps: [steps[0], steps[1], steps[0] / 2, 3],
        speed_hz: 20_000,
        accel_hz_per_s: 400_000,
        jerk_hz_per_s2: 40_000_000,
    }
}

const fn step(_: u32) -> Command {
    Command::Move {
        axis: AxisId(0),
        delay_us: 20,
        steps: 1,
    }
}

const CASES: [Case; 3] = [
    Case {
        name: "short lines, 2 axes, trapezoid",
        axis_count: 2,
        count: 1_000_000,
        command: curve,
        ideal_s: 0.0,
    },
    Case {
        name: "short lines, 4 axes, S-curve",
        axis_count: 4,
        count: 200_000,
        command: curve_of_four,
        ideal_s: 0.0,
    },
    Case {
        name: "moves of one step, 50 kHz",
        axis_count: 1,
        count: 1_000_000,
        command: step,
        ideal_s: 20.0,
    },
];

/// Executes a case from its bytes on; prints a row.
fn report(case: &Case) {
    let mut commands = (0..case.count as u32).map(case.command);
    let mut batches = Vec::new();
    let mut made = 0;
    while made < case.count {
        let (bytes, count) = batch(commands.by_ref().take(BATCH_COMMANDS));
        made += count;
        batches.push((bytes, count));
    }
    let ideal_s = if case.ideal_s > 0.0 {
        case.ideal_s
    } else {
        let longest = |index: u32| match (case.command)(index) {
            Command::Line { steps, .. } => steps.iter().map(|steps| steps.abs()).max(),
            _ => None,
        };
        let steps = (0..case.count as u32).filter_map(longest).map(f64::from);
        steps.sum::<f64>() / 20_000.0
    };
    let memory: Vec<_> = (0..RING_COMMANDS * COMMAND_WORDS)
        .map(|_| AtomicU32::new(0))
        .collect();
    let backend = Paced {
        axes: array::from_fn(|_| Axis::new()),
        axis_count: case.axis_count,
        last: [(0, 0); CHANNELS],
        half: 0,
        halves: [0; CHANNELS],
        playing: false,
    };
    // Corners of whole steps: of this size, at 20 kHz, they jump by 1 kHz.
    let profile = AxisProfile {
        junction_hz: 3_000,
        ..AxisProfile::default()
    };
    let config = MotionConfig {
        axis_count: case.axis_count,
        axes: [profile; CHANNELS],
        ..MotionConfig::default()
    };
    let mut plans = Box::new(PlanMemory::new());
    let ring = CommandRing::new(&memory);
    let mut motion = Motion::new(ring, plans.plans(), backend, config);
    motion.expect_more(case.count as u64);
    let mut next = batches.iter();
    let mut waiting = next.next();
    let mut now = Ticks(1);
    let mut underruns = 0;
    let begin = Instant::now();
    while motion.executed_commands() < case.count as u64 {
        while let Some((bytes, count)) = waiting {
            if motion.credit_commands() < *count {
                break;
            }
            let mut reader = BatchReader::new(bytes).expect("a batch");
            let mut check = reader.clone();
            while let Some(command) = check.next_command().expect("a command") {
                motion.check(&command).expect("it can be done");
            }
            let mut reservation = motion.reserve(*count).expect("room");
            while let Some(command) = reader.next_command().expect("a command") {
                reservation.push(&command);
            }
            reservation.commit();
            waiting = next.next();
        }
        while let Some(event) = motion.poll(now) {
            underruns += u32::from(event == MotionEvent::Underrun);
        }
        now = now.plus(POLL_TICKS);
    }
    let wall_s = begin.elapsed().as_secs_f64();
    let moved_s = now.0 as f64 / 16e6;
    println!(
        "| {} | {} | {:.0} | {:.2} | {moved_s:.1} | {:.3} | {underruns} | {} |",
        case.name,
        case.count,
        case.count as f64 / wall_s,
        wall_s * 1e6 / case.count as f64,
        moved_s / ideal_s,
        motion.backend().half,
    );
}

fn main() {
    println!(
        "| commands | how many | per second | µs each | motion, s | of the ideal at full speed | underruns | half blocks |"
    );
    println!("|---|---|---|---|---|---|---|---|");
    CASES.iter().for_each(report);
}
