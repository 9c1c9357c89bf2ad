//! Four axes at 200 kHz each, while every refill comes up to 100 µs late, or as late as the shortest
//! half block of rest allows ([`REST_HALF_TICKS_MIN`]), if that is less.
//!
//! The arithmetic of the deadline, for four blocks of 48 words at 16 MHz:
//!
//! | | |
//! |---|---|
//! | one step at 200 kHz, one word | 16,000,000 / 200,000 = 80 ticks = 5 µs |
//! | half a block, which plays while the other half is written | 24 · 80 = 1,920 ticks = 120 µs |
//! | refills | 4 axes · 200,000 / 24 = 33,333 a second, all four at one time |
//! | from the threshold until a refill interrupt runs, at most | 1,600 ticks = 100 µs |
//! | left for four refills in a row | 320 ticks = 20 µs, 5 µs each |
//! | on a core of 240 MHz | 20 µs = 4,800 cycles for 96 words: 50 a word |
//! | half a block of rest, where a path ends | never less than [`REST_HALF_TICKS_MIN`] |
//!
//! The latency is drawn for each refill of each channel by itself; what a channel waits for the
//! refills of the other three is part of it. A turn is made in a refill, too: its window is made for
//! the same 100 µs, and so is the half block before it, however few steps it holds.

mod bench;

use bench::{Bench, config};
use emulator::{
    EmulatorConfig,
    pins::{Pin, PinEvent},
    record::Life,
};
use keys::{AxisId, Command, NodeState, StopMode, status::FaultCode};
use motion::limits::REST_HALF_TICKS_MIN;

const AXES: usize = 4;

/// One step at 200 kHz.
const STEP_TICKS: u64 = 80;

/// Half a block of them.
const HALF_TICKS: u64 = 24 * STEP_TICKS;

/// What is asked for: 100 µs.
const WANTED_TICKS: u64 = 1_600;

/// What is injected.
const LATENCY_TICKS: u64 = if REST_HALF_TICKS_MIN < WANTED_TICKS {
    REST_HALF_TICKS_MIN
} else {
    WANTED_TICKS
};

fn late(ticks_min: u64, ticks_max: u64, seed: u64) -> EmulatorConfig {
    let mut config = config();
    config.axis_count = AXES;
    config.seed = seed;
    config.rmt.refill_ticks_min = ticks_min;
    config.rmt.refill_ticks_max = ticks_max;
    config
}

fn line(steps: [i32; AXES], accel_hz_per_s: u32, jerk_hz_per_s2: u32) -> Command {
    Command::Line {
        steps,
        speed_hz: 200_000,
        accel_hz_per_s,
        jerk_hz_per_s2,
    }
}

fn rises(life: &Life, axis: usize) -> Vec<u64> {
    let pin = Pin::Step(AxisId(axis as u8));
    let edge = |event: &&PinEvent| event.pin == pin && event.level;
    let edges = life.edges.iter().filter(edge);
    edges.map(|event| event.at_ticks).collect()
}

/// Runs to the end: no fault, every edge where the oracle wants it.
fn run(config: EmulatorConfig, commands: impl IntoIterator<Item = Command>) -> Life {
    let mut bench = Bench::new(config);
    bench.order(commands);
    bench.run_to_rest();
    let life = bench.judged();
    assert!(life.status.faults.is_empty(), "{:?}", life.status.faults);
    life
}

#[test]
fn four_axes_ramp_to_200_khz_at_once_with_late_refills() {
    for (least, seed) in [
        (0, 1),
        (16, 2),
        (LATENCY_TICKS - 100, 3),
        (LATENCY_TICKS, 4),
    ] {
        println!("latency {least} to {LATENCY_TICKS}, seed {seed}");
        let config = late(least, LATENCY_TICKS, seed);
        let steps = [40_000, -40_000, 40_000, 39_999];
        let life = run(config, [line(steps, 2_000_000, 0)]);
        for (axis, count) in steps.into_iter().enumerate() {
            let edges = rises(&life, axis);
            assert_eq!(edges.len(), count.unsigned_abs() as usize);
            // 20,000 steps of ramp, as many at full speed.
            let fast = |pair: &&[u64]| pair[1] - pair[0] <= STEP_TICKS;
            assert!(edges.windows(2).filter(fast).count() >= 19_990);
        }
    }
}

#[test]
fn four_axes_at_200_khz_follow_s_curves_and_joined_lines_with_late_refills() {
    let curve = [line(
        [40_000, 39_000, 38_000, -40_000],
        4_000_000,
        200_000_000,
    )];
    run(late(0, LATENCY_TICKS, 5), curve);
    // Straight on, in 100 lines. To stop takes 10,000 steps: 25 lines that are known ahead.
    let path = (0..100).map(|_| line([400, -400, 400, 400], 2_000_000, 0));
    let life = run(late(LATENCY_TICKS, LATENCY_TICKS, 6), path);
    let edges = rises(&life, 0);
    let at_speed = &edges[18_000..19_000];
    assert_eq!(at_speed[999] - at_speed[0], 999 * STEP_TICKS);
}

#[test]
fn turns_at_speed_and_out_of_rest_make_no_gap_with_late_refills() {
    // A half block ends with any number of steps before the turn: 1 to 24 of them.
    let sync = |count: i32, way: i32| Command::SyncMove {
        delay_us: [5, 5],
        steps: [way * count, -way * count],
    };
    let raw = (1..=60).flat_map(|count| [sync(count, 1), sync(count, -1)]);
    // From one direction to the other by the hardest ramp, and by a soft one.
    let ramps = [80_000_000, 2_000_000].into_iter().flat_map(|accel| {
        let there = line([3_000, -2_999, 1_500, 1], accel, 0);
        let back = line([-3_000, 2_999, -1_500, -1], accel, 0);
        [there, back, there, back]
    });
    let zigzag = (0..40).map(|index| {
        let way = if index % 2 == 0 { 25 } else { -25 };
        line([400, way, -way, 200], 2_000_000, 0)
    });
    let commands: Vec<_> = raw.chain(ramps).chain(zigzag).collect();
    for (least, seed) in [
        (0, 11),
        (LATENCY_TICKS / 2, 12),
        (LATENCY_TICKS - 16, 13),
        (LATENCY_TICKS, 14),
    ] {
        println!("latency {least} to {LATENCY_TICKS}, seed {seed}");
        let life = run(late(least, LATENCY_TICKS, seed), commands.clone());
        let steps = commands.iter().map(|command| match command {
            Command::SyncMove { steps, .. } => steps[0].unsigned_abs() as usize,
            Command::Line { steps, .. } => steps[0].unsigned_abs() as usize,
            _ => 0,
        });
        assert_eq!(rises(&life, 0).len(), steps.sum::<usize>());
    }
}

#[test]
fn a_planner_that_is_held_up_for_15_ms_as_well_makes_no_gap() {
    let mut config = late(0, LATENCY_TICKS, 7);
    config.rmt.plan_ticks_max = 240_000;
    run(config, [line([40_000; AXES], 2_000_000, 0)]);
}

#[test]
fn stops_at_200_khz_with_late_refills_leave_exact_positions() {
    for (index, mode) in [StopMode::Halt, StopMode::Decelerate]
        .into_iter()
        .enumerate()
    {
        for at_us in [30_017, 99_999, 120_003] {
            println!("{mode:?} at {at_us} µs");
            let mut bench = Bench::new(late(0, LATENCY_TICKS, 8 + index as u64));
            bench.order([line([40_000; AXES], 2_000_000, 0)]);
            bench.run_until(at_us);
            bench.stop(mode);
            bench.run_until(at_us + 500_000);
            let life = bench.judged();
            for (axis, status) in life.status.axes.iter().enumerate() {
                assert_eq!(status.position_steps, life.counted_steps[axis]);
            }
        }
    }
}

#[test]
fn a_refill_that_comes_when_its_half_block_at_200_khz_has_been_played_is_told_at_once() {
    let mut bench = Bench::new(late(HALF_TICKS + 1, HALF_TICKS + 1, 10));
    bench.order([line([40_000; AXES], 2_000_000, 0)]);
    bench.run_until(1_000_000);
    let status = bench.node.status();
    assert_eq!(status.state, NodeState::Fault);
    assert_eq!(status.faults[0].code, FaultCode::REFILL_LATE);
    for (axis, status) in status.axes.iter().enumerate() {
        let counted = bench.node.step_count(AxisId(axis as u8));
        assert_eq!(status.position_steps, counted);
        // It had come to full speed: 10,000 steps of ramp.
        assert!((10_000..10_200).contains(&counted), "{counted}");
    }
}
