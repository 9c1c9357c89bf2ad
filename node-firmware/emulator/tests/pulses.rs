//! Commands to pins on the virtual RMT, judged by the oracle: every promise of the motion core that
//! can be seen at a pin.

mod bench;

use bench::{Bench, config};
use emulator::{
    pins::{Pin, PinEvent},
    record::Life,
};
use keys::{
    AxisId, BatchHeader, Command, JobId, NodeTopic, QueueId, StopMode,
    batch::{BatchWriter, ORDER_BYTES_MAX},
    status::FaultCode,
};

const X: AxisId = AxisId(0);
const Y: AxisId = AxisId(1);

fn steps(axis: AxisId, delay_us: u32, steps: i32) -> Command {
    Command::Move {
        axis,
        delay_us,
        steps,
    }
}

fn rises(life: &Life, axis: AxisId) -> Vec<u64> {
    let edge = |event: &&PinEvent| event.pin == Pin::Step(axis) && event.level;
    life.edges
        .iter()
        .filter(edge)
        .map(|event| event.at_ticks)
        .collect()
}

fn run(commands: impl IntoIterator<Item = Command>) -> Life {
    let mut bench = Bench::new(config());
    bench.order(commands);
    bench.run_to_rest();
    bench.judged()
}

#[test]
fn a_move_has_its_edges_one_interval_apart() {
    let life = run([steps(X, 500, -2_000)]);
    let edges = rises(&life, X);
    assert_eq!(edges.len(), 2_000);
    assert!(edges.windows(2).all(|pair| pair[1] - pair[0] == 8_000));
    assert_eq!(life.status.axes[0].position_steps, -2_000);
    assert_eq!(life.status.axes[1].position_steps, 0);
}

#[test]
fn every_interval_from_one_microsecond_to_ten_seconds_is_exact() {
    for delay_us in [
        1, 2, 3, 199, 200, 250, 251, 252, 253, 2_047, 2_048, 2_049, 4_095, 5_000,
    ] {
        let life = run([steps(X, delay_us, 100)]);
        let edges = rises(&life, X);
        let interval = u64::from(delay_us) * 16;
        assert!(
            edges.windows(2).all(|pair| pair[1] - pair[0] == interval),
            "{delay_us}"
        );
    }
    let life = run([steps(X, 10_000_000, 3)]);
    let edges = rises(&life, X);
    assert!(
        edges
            .windows(2)
            .all(|pair| pair[1] - pair[0] == 160_000_000)
    );
}

#[test]
fn a_sync_move_starts_both_axes_on_one_tick_and_ends_them_together() {
    let life = run([Command::SyncMove {
        delay_us: [500, 1_000],
        steps: [2_000, 1_000],
    }]);
    let (x, y) = (rises(&life, X), rises(&life, Y));
    assert!(x[0].abs_diff(y[0]) <= 3);
    assert_eq!(x[1_999] - x[0], 1_999 * 8_000);
    assert_eq!(y[999] - y[0], 999 * 16_000);
}

#[test]
fn commands_follow_each_other_without_a_gap_on_both_axes() {
    let mut commands = Vec::new();
    for index in 0..200 {
        commands.push(steps(X, 100 + index, 7));
        commands.push(steps(Y, 90, 3));
        commands.push(Command::Pause {
            pause_ms: index % 3,
        });
        commands.push(Command::SyncMove {
            delay_us: [50 + index, 31],
            steps: [11, 40],
        });
    }
    run(commands);
}

#[test]
fn fast_single_steps_follow_each_other_without_a_gap() {
    run((0..5_000).map(|_| steps(X, 5, 1)));
}

#[test]
fn a_turn_costs_no_time_where_the_step_leaves_it() {
    // 2.5 µs high, 100 µs for the half block of the last step, 100 µs and the setup for the turn.
    let life = run((0..40).map(|index| steps(X, 213, if index % 2 == 0 { 3 } else { -3 })));
    let edges = rises(&life, X);
    assert!(edges.windows(2).all(|pair| pair[1] - pair[0] == 213 * 16));
    assert_eq!(life.status.axes[0].position_steps, 0);
}

#[test]
fn a_turn_of_fast_steps_adds_no_more_than_its_window_and_the_axes_stay_together() {
    let mut commands = Vec::new();
    for index in 0..300 {
        let sign = if index % 2 == 0 { 1 } else { -1 };
        commands.push(Command::SyncMove {
            delay_us: [5, 10],
            steps: [20 * sign, 10],
        });
    }
    run(commands);
}

#[test]
fn hundred_thousand_commands_pass_a_ring_of_4096_without_a_stall() {
    let commands = (0..100_000).map(|index: i32| steps(X, 40 + index as u32 % 50, 1 + index % 3));
    let life = run(commands);
    assert_eq!(life.status.executed_commands, 100_000);
    assert!(life.status.faults.is_empty());
    let edges = rises(&life, X);
    let longest = edges.windows(2).map(|pair| pair[1] - pair[0]).max();
    assert_eq!(longest, Some(89 * 16));
}

#[test]
fn a_halt_at_any_microsecond_leaves_the_exact_position_and_silence() {
    for at_us in (0..3_000).step_by(7) {
        let mut bench = Bench::new(config());
        bench.order([
            steps(X, 13, 60),
            Command::SyncMove {
                delay_us: [9, 300],
                steps: [-90, 4],
            },
            steps(Y, 3, -200),
        ]);
        bench.run_until(at_us);
        bench.stop(StopMode::Halt);
        bench.run_until(at_us + 50_000);
        let life = bench.judged();
        let stopped = life.stops[0].at.0 * 16;
        for axis in [X, Y] {
            assert!(
                rises(&life, axis).iter().all(|at| *at <= stopped),
                "{at_us}"
            );
        }
    }
}

#[test]
fn a_deceleration_slows_down_by_the_profile_and_the_queue_goes_on_after_a_release() {
    for (delay_us, at_us) in [(20, 100_000), (100, 50_000), (1_000, 33_333), (77, 5)] {
        let mut bench = Bench::new(config());
        bench.order([steps(X, delay_us, 1_000_000), steps(Y, 5, 10)]);
        bench.run_until(at_us);
        bench.stop(StopMode::Decelerate);
        bench.run_until(at_us + 2_000_000);
        let life = bench.judged();
        let report = &life.stops[0];
        let speed_hz = 1e6 / f64::from(delay_us);
        let way = rises(&life, X)
            .iter()
            .filter(|at| **at > report.at.0 * 16)
            .count() as f64;
        let ideal = speed_hz * speed_hz / 200_000.0;
        assert!(
            way <= ideal + 50.0,
            "{delay_us}: {way} steps, ideal {ideal}"
        );
        bench.release();
        bench.waiting.clear();
        bench.order([steps(X, 50, -20)]);
        bench.run_to_rest();
        bench.judged();
    }
}

#[test]
fn a_deceleration_does_not_wait_for_the_time_of_a_step_that_is_not_made() {
    let mut bench = Bench::new(config());
    bench.order([steps(X, 3_000_000, 5)]);
    bench.run_until(1_000_000);
    bench.stop(StopMode::Decelerate);
    bench.run_until(1_100_000);
    assert!(bench.node.status().stop.is_some(), "it is at rest");
    assert_eq!(bench.node.position_steps(X), 1);
    bench.judged();
}

#[test]
fn a_set_position_takes_effect_between_the_commands_around_it() {
    let mut bench = Bench::new(config());
    bench.order([
        steps(X, 100, 50),
        Command::SetPosition {
            axis: X,
            position_steps: -1_000,
        },
        steps(X, 100, -25),
    ]);
    bench.run_until(4_000);
    assert!((38..=42).contains(&bench.node.position_steps(X)));
    bench.run_to_rest();
    assert_eq!(bench.node.position_steps(X), -1_025);
    bench.judged();
}

#[test]
fn laser_and_lidar_come_when_the_commands_before_have_ended() {
    let mut bench = Bench::new(config());
    bench.order([
        steps(X, 1_000, 10),
        Command::Laser { power_percent: 40 },
        Command::LidarRead,
        steps(X, 1_000, 10),
        Command::Laser { power_percent: 0 },
    ]);
    bench.run_until(9_900);
    assert_eq!(bench.node.status().laser_percent, 0);
    bench.run_until(10_200);
    assert_eq!(bench.node.status().laser_percent, 40);
    bench.run_until(19_000);
    assert_eq!(bench.node.status().laser_percent, 40);
    bench.run_until(40_000);
    assert_eq!(bench.node.status().laser_percent, 0);
    assert!(bench.node.status().lidar_mm.is_some());
}

#[test]
fn a_late_refill_stops_everything_and_the_position_is_that_of_the_counter() {
    let mut config = config();
    config.rmt.refill_ticks_min = 16 * 400;
    config.rmt.refill_ticks_max = 16 * 500;
    let mut bench = Bench::new(config);
    bench.order([steps(X, 10, 10_000), steps(Y, 10, 10)]);
    bench.run_until(200_000);
    let status = bench.node.status();
    assert_eq!(status.faults[0].code, FaultCode::REFILL_LATE);
    assert_eq!(status.state, keys::NodeState::Fault);
    assert_eq!(status.axes[0].position_steps, bench.node.step_count(X));
    assert!(status.axes[0].position_steps < 200, "it stopped at once");
}

#[test]
fn a_refill_that_turns_the_motor_too_late_for_its_driver_stops_everything() {
    let fault_of = |refill_us: u64| {
        let mut config = config();
        config.rmt.refill_ticks_min = 16 * refill_us;
        config.rmt.refill_ticks_max = 16 * refill_us;
        let mut bench = Bench::new(config);
        bench.order((0..10).map(|index| steps(X, 20, if index % 2 == 0 { 100 } else { -100 })));
        bench.run_until(200_000);
        let status = bench.node.status();
        assert_eq!(status.axes[0].position_steps, bench.node.step_count(X));
        status.faults.first().map(|fault| fault.code)
    };
    // The window is 100 µs and the driver's 10 µs of setup.
    assert_eq!(fault_of(100), None);
    assert_eq!(fault_of(105), Some(FaultCode::REFILL_LATE));
}

#[test]
fn a_refill_within_its_deadline_changes_nothing() {
    let mut config = config();
    // Nothing rests beside it: half a block of rest may be shorter.
    config.axis_count = 1;
    // 24 steps of 10 µs are 240 µs.
    config.rmt.refill_ticks_min = 0;
    config.rmt.refill_ticks_max = 16 * 230;
    let mut bench = Bench::new(config);
    bench.order((0..200).map(|index| steps(X, 10, 10 + index)));
    bench.run_to_rest();
    bench.judged();
}

#[test]
fn a_queue_that_runs_dry_says_so_and_goes_on_later() {
    let mut bench = Bench::new(config());
    bench.order([steps(X, 100, 10)]);
    bench.job_end = 2;
    let status = bench.node.status();
    let mut writer = BatchWriter::new();
    assert!(writer.push(&steps(X, 100, 10)));
    let header = BatchHeader {
        queue: status.queue,
        first_command: 1,
        command_count: 0,
        job: JobId::new("j").expect("legal"),
        job_end: 3,
    };
    let mut buffer = [0; ORDER_BYTES_MAX];
    let bytes = writer.finish(header, &mut buffer).expect("room").to_vec();
    bench.node.handle(NodeTopic::Batch, &bytes, bench.now);
    bench.run_until(100_000);
    assert_eq!(bench.node.status().faults[0].code, FaultCode::UNDERRUN);
    bench.order([steps(X, 100, 10)]);
    bench.run_to_rest();
    let life = bench.judged();
    assert_eq!(life.status.axes[0].position_steps, 30);
}

/// Splitmix64: every test that draws numbers prints its seed when it fails.
struct Random(u64);

impl Random {
    fn below(&mut self, most: u64) -> u64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut mixed = self.0;
        mixed = (mixed ^ mixed >> 30).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        mixed = (mixed ^ mixed >> 27).wrapping_mul(0x94d0_49bb_1331_11eb);
        (mixed ^ mixed >> 31) % most
    }

    /// Small and large numbers alike, below 2^bits.
    fn spread(&mut self, bits: u64) -> u64 {
        let bits = self.below(bits);
        self.below(1 << bits)
    }

    fn steps(&mut self) -> i32 {
        let steps = 1 + self.spread(9) as i32;
        if self.below(2) == 0 { steps } else { -steps }
    }

    fn delay_us(&mut self) -> u32 {
        // Up to 200 kHz: a controlled stop from there takes two seconds.
        5 + self.spread(12) as u32
    }

    fn command(&mut self) -> Command {
        match self.below(10) {
            0..5 => steps(AxisId(self.below(4) as u8), self.delay_us(), self.steps()),
            5..8 => Command::SyncMove {
                delay_us: [self.delay_us(), self.delay_us()],
                steps: [self.steps(), self.steps()],
            },
            8 => Command::Pause {
                pause_ms: self.below(4) as u32,
            },
            _ => match self.below(3) {
                0 => Command::Laser { power_percent: 1 },
                1 => Command::LidarRead,
                _ => Command::SetPosition {
                    axis: AxisId(self.below(4) as u8),
                    position_steps: self.below(1_000) as i64 - 500,
                },
            },
        }
    }
}

#[test]
fn random_jobs_with_random_stops_keep_every_promise() {
    for seed in bench::motor::seeds(150) {
        println!("seed {seed}");
        let mut random = Random(seed);
        let mut config = config();
        config.axis_count = 4;
        config.seed = seed;
        config.ring_commands = 16 + random.below(100) as usize;
        let mut bench = Bench::new(config);
        for _ in 0..4 {
            let count = 1 + random.below(120);
            let commands: Vec<_> = (0..count).map(|_| random.command()).collect();
            bench.order(commands);
            if random.below(3) == 0 {
                bench.run_to_rest();
                continue;
            }
            let at = bench.now.0 + random.spread(20);
            bench.run_until(at);
            let mode = if random.below(2) == 0 {
                StopMode::Halt
            } else {
                StopMode::Decelerate
            };
            bench.waiting.clear();
            bench.stop(mode);
            let at = bench.now.0 + 3_000_000;
            bench.run_until(at);
            bench.release();
            assert_eq!(bench.node.status().state, keys::NodeState::Idle);
        }
        let last = bench.node.status();
        assert_eq!(
            last.queue,
            QueueId {
                boot: 7,
                flush: last.queue.flush
            }
        );
        bench.judged();
    }
}
