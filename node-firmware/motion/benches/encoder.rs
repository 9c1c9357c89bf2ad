//! Cost of one symbol in the refill, and of one command in the planner.
//!
//! A back end without hardware asks for half blocks as fast as it can, so what is measured is the
//! encoder, the ledger and the planner alone.

mod sink;

use criterion::{BatchSize, Criterion, Throughput, criterion_group, criterion_main};
use keys::{AxisId, Command, command::COMMAND_WORDS};
use motion::limits::REFILL_WORDS;
use std::sync::atomic::AtomicU32;

fn run(memory: &[AtomicU32], commands: &[Command]) -> u64 {
    let run = sink::execute(memory, 1, commands.iter().copied(), false, || 0);
    u64::from(run.refills)
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
