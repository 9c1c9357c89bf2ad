//! Cost of one symbol in the refill, and of one command in the planner.
//!
//! A back end without hardware asks for half blocks as fast as it can, so what is measured is the
//! encoder, the ledger and the planner alone.

use criterion::{BatchSize, Criterion, Throughput, criterion_group, criterion_main};
use keys::{AxisId, Command, command::COMMAND_WORDS, status::FaultCode};
use motion::{
    Axis, AxisProfile, CommandRing, Motion, MotionConfig, StepBackend, Ticks,
    limits::{CHANNELS, REFILL_WORDS},
};
use std::{hint::black_box, sync::atomic::AtomicU32};

/// Consumes half blocks at once.
struct Sink {
    axes: [Axis; CHANNELS],
    half: usize,
    refills: u64,
    playing: bool,
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
            for axis in self.axes.iter_mut().filter(|axis| !axis.has_ended()) {
                black_box(axis.fill(self.half));
                self.refills += 1;
                self.playing |= !axis.has_ended();
            }
            self.half ^= 1;
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

fn run(memory: &[AtomicU32], commands: &[Command]) -> u64 {
    let sink = Sink {
        axes: std::array::from_fn(|_| Axis::new(AxisProfile::default())),
        half: 0,
        refills: 0,
        playing: false,
    };
    let config = MotionConfig {
        axis_count: 1,
        ..MotionConfig::default()
    };
    let mut motion = Motion::new(CommandRing::new(memory), sink, config);
    let mut reservation = motion.reserve(commands.len()).expect("room");
    for command in commands {
        reservation.push(command);
    }
    reservation.commit();
    let mut now = Ticks(1);
    while motion.executed_commands() < commands.len() as u64 {
        black_box(motion.poll(now));
        now = now.plus(1_000_000_000_000);
    }
    motion.backend().refills
}

fn benches(criterion: &mut Criterion) {
    let memory: Vec<_> = (0..4_096 * COMMAND_WORDS)
        .map(|_| AtomicU32::new(0))
        .collect();
    let mut group = criterion.benchmark_group("encoder, one axis");
    let cases = [
        ("fast steps, one symbol each", 10, 24_000),
        ("slow steps, two symbols each", 400, 24_000),
    ];
    for (name, delay_us, steps) in cases {
        let commands = [Command::Move {
            axis: AxisId(0),
            delay_us,
            steps,
        }];
        let symbols = run(&memory, &commands) * REFILL_WORDS as u64;
        group.throughput(Throughput::Elements(symbols));
        group.bench_function(format!("{name}, per symbol"), |bencher| {
            bencher.iter_batched(|| (), |()| run(&memory, &commands), BatchSize::SmallInput);
        });
    }
    group.finish();
    let mut group = criterion.benchmark_group("planner and encoder, one axis");
    let commands: Vec<_> = (0..4_000)
        .map(|_| Command::Move {
            axis: AxisId(0),
            delay_us: 10,
            steps: 1,
        })
        .collect();
    group.throughput(Throughput::Elements(commands.len() as u64));
    group.bench_function("moves of one step, per command", |bencher| {
        bencher.iter(|| run(&memory, &commands));
    });
    group.finish();
}

criterion_group!(encoder, benches);
criterion_main!(encoder);
