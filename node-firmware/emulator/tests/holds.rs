//! Feed hold in the midst of raw moves: the timeline stands still and goes on, judged by the oracle
//! to the tick.

mod bench;

use bench::{
    Bench, config,
    motor::{Random, seeds},
};
use emulator::{pins::Pin, record::Life};
use keys::{
    AxisId, Command, NodeState, StopMode,
    command::{Ramp, RampShape},
};
use motion::Ticks;

const X: AxisId = AxisId(0);
const Y: AxisId = AxisId(1);

/// What the hardware holds at most, and a word: nothing leaves later than this after a hold.
const HELD_TICKS: u64 = 2_000 * 16;

fn steps(axis: AxisId, delay_us: u32, steps: i32) -> Command {
    Command::Move {
        axis,
        delay_us,
        steps,
    }
}

fn rises(life: &Life, axis: AxisId) -> Vec<u64> {
    let edges = life.edges.iter();
    let rises = edges.filter(|edge| edge.pin == Pin::Step(axis) && edge.level);
    rises.map(|edge| edge.at_ticks).collect()
}

fn hold(bench: &mut Bench) {
    let now = Ticks(bench.now.0 * 16);
    bench.node.node_mut().motion_mut().hold(now);
}

fn resume(bench: &mut Bench) {
    bench.node.node_mut().motion_mut().resume();
}

fn position(bench: &Bench, axis: AxisId) -> i64 {
    bench.node.status().axes[axis.index()].position_steps
}

/// Demands that nothing steps while it is held.
fn is_silent(life: &Life, what: &str) {
    for held in &life.holds {
        let (from, until) = (held.from_ticks + HELD_TICKS, held.until_ticks);
        let until = until.unwrap_or(u64::MAX);
        for edge in &life.edges {
            assert!(
                !(from..until).contains(&edge.at_ticks),
                "{what}: an edge {} µs after a hold",
                (edge.at_ticks - held.from_ticks) / 16
            );
        }
    }
}

#[test]
fn a_held_move_rests_within_two_milliseconds_and_goes_on_with_the_rest() {
    for delay_us in [1, 5, 100, 3_000, 700_000] {
        let count = (5_000_000 / delay_us).clamp(4, 20_000) as i32;
        let mut bench = Bench::new(config());
        bench.order([steps(X, delay_us, count)]);
        let total_us = u64::from(delay_us) * count as u64;
        bench.run_until(total_us / 3 + 777);
        hold(&mut bench);
        bench.run_for(5_000);
        assert_eq!(bench.node.status().state, NodeState::Paused, "{delay_us}");
        let held = position(&bench, X);
        assert!((1..i64::from(count)).contains(&held), "{delay_us}: {held}");
        bench.run_for(3_000_000);
        assert_eq!(position(&bench, X), held);
        resume(&mut bench);
        bench.run_to_rest();
        assert_eq!(position(&bench, X), i64::from(count));
        let life = bench.judged();
        is_silent(&life, "");
        let edges = rises(&life, X);
        let interval = u64::from(delay_us) * 16;
        let odd = edges
            .windows(2)
            .filter(|pair| pair[1] - pair[0] != interval);
        assert_eq!(odd.count(), 1, "{delay_us}: one interval holds the hold");
    }
}

#[test]
fn two_axes_that_are_held_keep_every_distance_between_their_edges() {
    let sync = Command::SyncMove {
        delay_us: [31, 50],
        steps: [9_000, -5_000],
    };
    let run = |hold_us: Option<u64>| {
        let mut bench = Bench::new(config());
        bench.order([sync]);
        if let Some(hold_us) = hold_us {
            bench.run_until(hold_us);
            hold(&mut bench);
            bench.run_for(100_003);
            resume(&mut bench);
        }
        bench.run_to_rest();
        let life = bench.judged();
        (rises(&life, X), rises(&life, Y))
    };
    let (x, y) = run(None);
    for hold_us in [3_000, 50_001, 200_017, 278_000] {
        let (held_x, held_y) = run(Some(hold_us));
        assert_eq!((held_x.len(), held_y.len()), (9_000, 5_000));
        // Before the hold nothing is different; behind it all is later by the same.
        let later = held_x[8_999] - x[8_999];
        assert!((98_000 * 16..104_000 * 16).contains(&later), "{later}");
        for (held, free) in held_x.iter().zip(&x).chain(held_y.iter().zip(&y)) {
            let own = held - free;
            assert!(own <= 3 || own.abs_diff(later) <= 3, "{own} or {later}");
        }
    }
}

#[test]
fn a_pause_that_is_held_is_as_long_as_it_would_have_been() {
    let mut bench = Bench::new(config());
    let pause = Command::Pause { pause_ms: 500 };
    bench.order([steps(X, 100, 100), pause, steps(X, 100, -100)]);
    bench.run_until(200_000);
    hold(&mut bench);
    bench.run_until(2_000_000);
    assert_eq!(bench.node.status().executed_commands, 1);
    resume(&mut bench);
    bench.run_to_rest();
    let life = bench.judged();
    let edges = rises(&life, X);
    let gap = edges[100] - edges[99];
    let moved = 500_000 + 100 + 1_800_000;
    assert!(gap.abs_diff(moved * 16) < 4_000 * 16, "{gap}");
}

#[test]
fn a_hold_that_cost_one_axis_a_tick_too_many_is_found() {
    let mut bench = Bench::new(config());
    bench.order([Command::SyncMove {
        delay_us: [100, 70],
        steps: [900, 900],
    }]);
    bench.run_until(30_000);
    hold(&mut bench);
    bench.run_for(50_000);
    resume(&mut bench);
    bench.run_to_rest();
    let life = bench.judged();
    let resumed = life.holds[0].until_ticks.expect("it goes on");
    let mut moved = life.clone();
    for edge in &mut moved.edges {
        // More than the channels may begin apart.
        let late = edge.at_ticks > resumed && edge.pin == Pin::Step(Y);
        edge.at_ticks += if late { 8 } else { 0 };
    }
    moved.edges.sort_by_key(|edge| edge.at_ticks);
    assert!(emulator::oracle::check_life(&moved).is_err());
    let mut unexplained = life;
    unexplained.holds.clear();
    assert!(emulator::oracle::check_life(&unexplained).is_err());
}

#[test]
fn a_stop_ends_a_held_move_where_it_rests() {
    for mode in [StopMode::Halt, StopMode::Decelerate] {
        for rests in [false, true] {
            let mut bench = Bench::new(config());
            bench.order([steps(X, 50, 10_000), steps(Y, 70, 900)]);
            bench.run_until(100_000);
            hold(&mut bench);
            bench.run_for(if rests { 10_000 } else { 100 });
            bench.stop(mode);
            bench.run_for(1_000_000);
            assert_eq!(bench.node.status().state, NodeState::Stopped);
            bench.release();
            assert!(!bench.node.node_mut().motion_mut().is_held());
            bench.order([steps(X, 50, 10)]);
            bench.run_for(1_000_000);
            bench.judged();
        }
    }
}

#[test]
fn random_raw_moves_with_random_holds_lose_no_step_and_no_tick() {
    // In the last ones a hold falls into the half block before a turn.
    for seed in seeds(400).chain([3_549, 4_708, 7_005, 14_452]) {
        let mut random = Random(seed);
        let mut bench = Bench::new(config());
        let mut end = [0_i64; 2];
        let commands: Vec<_> = (0..5 + random.below(60))
            .map(|_| {
                let bits = 1 + random.below(10);
                let delay_us = 3 + random.below(1 << bits) as u32;
                let mut count = || random.below(120) as i32 - 60;
                let (a, b) = (count() | 1, count());
                match random.below(6) {
                    0 => Command::Pause {
                        pause_ms: random.below(20) as u32,
                    },
                    1 => Command::Laser { power_percent: 30 },
                    2 => {
                        end[0] += i64::from(a);
                        end[1] += i64::from(b);
                        Command::SyncMove {
                            delay_us: [delay_us, delay_us + 7],
                            steps: [a, b],
                        }
                    }
                    3 => {
                        end[1] += i64::from(a);
                        steps(Y, delay_us, a)
                    }
                    _ => {
                        end[0] += i64::from(a);
                        steps(X, delay_us, a)
                    }
                }
            })
            .collect();
        bench.order(commands);
        for _ in 0..1 + random.below(4) {
            bench.run_for(random.below(200_000));
            hold(&mut bench);
            bench.run_for(random.below(20_000));
            if random.below(4) == 0 {
                // There and back again at once.
                resume(&mut bench);
                hold(&mut bench);
                bench.run_for(random.below(3_000));
            }
            resume(&mut bench);
        }
        bench.run_to_rest();
        let what = format!("seed {seed}");
        assert_eq!([position(&bench, X), position(&bench, Y)], end, "{what}");
        let life = bench.node.life();
        if let Err(violations) = emulator::oracle::check_life(&life) {
            panic!("{what}: {violations:?}");
        }
        is_silent(&life, &what);
    }
}

#[test]
fn raw_moves_among_ramps_and_lines_are_held_at_once_or_behind_a_ramp() {
    for seed in seeds(60) {
        let mut random = Random(seed ^ 0xfeed);
        let mut bench = Bench::new(config());
        let mut end = [0_i64; 2];
        let commands: Vec<_> = (0..5 + random.below(40))
            .map(|_| {
                let count = random.below(300) as i32 - 150;
                end[0] += i64::from(count | 1);
                match random.below(4) {
                    0 => {
                        end[1] += i64::from(count);
                        Command::Line {
                            steps: [count | 1, count, 0, 0],
                            speed_hz: 8_000,
                            accel_hz_per_s: 90_000,
                            jerk_hz_per_s2: 0,
                        }
                    }
                    1 => Command::Ramp {
                        axis: X,
                        steps: count | 1,
                        ramp: Ramp {
                            speed_hz: 5_000,
                            accel_hz_per_s: 70_000,
                            shape: RampShape::Jerk {
                                jerk_hz_per_s2: 900_000,
                            },
                        },
                    },
                    _ => steps(X, 60 + random.below(100) as u32, count | 1),
                }
            })
            .collect();
        bench.order(commands);
        for _ in 0..1 + random.below(4) {
            bench.run_for(random.below(300_000));
            hold(&mut bench);
            bench.run_for(200_000);
            assert!(
                bench.node.node_mut().motion_mut().is_paused(),
                "seed {seed}"
            );
            resume(&mut bench);
        }
        bench.run_to_rest();
        assert_eq!(
            [position(&bench, X), position(&bench, Y)],
            end,
            "seed {seed}"
        );
        let life = bench.node.life();
        if let Err(violations) = emulator::oracle::check_life(&life) {
            panic!("seed {seed}: {violations:?}");
        }
    }
}
