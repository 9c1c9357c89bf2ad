//! The judge of ramps and lines that were held, or told another speed: what is right passes, and what
//! is wrong is found.

mod bench;

use bench::{
    Bench, config,
    motor::{Random, seeds},
};
use emulator::{oracle::check_life, pins::Pin, record::Life};
use keys::{
    AxisId, Command, StopMode,
    command::{Ramp, RampShape},
};
use motion::Ticks;

const X: AxisId = AxisId(0);
const Y: AxisId = AxisId(1);

const TRAPEZOID: RampShape = RampShape::Trapezoid {
    linear_steps: 0,
    jump_steps: 0,
};

fn ramp(steps: i32, speed_hz: u32, accel_hz_per_s: u32, shape: RampShape) -> Command {
    let ramp = Ramp {
        speed_hz,
        accel_hz_per_s,
        shape,
    };
    Command::Ramp {
        axis: X,
        steps,
        ramp,
    }
}

fn line(steps: [i32; 2], speed_hz: u32, accel_hz_per_s: u32, jerk_hz_per_s2: u32) -> Command {
    Command::Line {
        steps: [steps[0], steps[1], 0, 0],
        speed_hz,
        accel_hz_per_s,
        jerk_hz_per_s2,
    }
}

/// Each of these is seen at once, as it is when a message tells it: the record knows of it.
fn hold(bench: &mut Bench) {
    let now = Ticks(bench.now.0 * 16);
    bench.node.node_mut().motion_mut().hold(now);
    bench.run_for(0);
}

fn resume(bench: &mut Bench) {
    bench.node.node_mut().motion_mut().resume();
    bench.run_for(0);
}

fn speed(bench: &mut Bench, percent: u16) {
    let motion = bench.node.node_mut().motion_mut();
    motion.set_speed_percent(percent);
    bench.run_for(0);
}

/// Moves the edges of the nth step of an axis and all behind it.
fn delay(life: &Life, axis: AxisId, from: usize, to: usize, ticks: i64) -> Life {
    let mut life = life.clone();
    let edges = life.edges.iter_mut();
    let edges = edges.filter(|edge| edge.pin == Pin::Step(axis));
    for edge in edges.skip(2 * from).take(2 * (to - from)) {
        edge.at_ticks = edge.at_ticks.checked_add_signed(ticks).expect("late");
    }
    life.edges.sort_by_key(|edge| edge.at_ticks);
    life
}

fn found(life: &Life, expected: &str) {
    let violations = check_life(life).expect_err(expected);
    let all: Vec<_> = violations.iter().map(ToString::to_string).collect();
    assert!(
        all.iter().any(|violation| violation.contains(expected)),
        "{expected}: {all:#?}"
    );
}

/// A ramp that is held after 400 ms for half a second and then goes on at half its speed.
fn held() -> Life {
    let mut bench = Bench::new(config());
    bench.order([ramp(6_000, 5_000, 20_000, TRAPEZOID)]);
    bench.run_until(400_000);
    hold(&mut bench);
    bench.run_for(500_000);
    resume(&mut bench);
    bench.run_for(300_000);
    speed(&mut bench, 50);
    bench.run_to_rest();
    bench.judged()
}

#[test]
fn a_ramp_is_judged_to_the_tick_until_it_is_held() {
    let life = held();
    found(
        &delay(&life, X, 100, 101, 3),
        "before it was changed: axis 0: step 101",
    );
    found(
        &delay(&life, X, 900, 901, -3),
        "before it was changed: axis 0: step 901",
    );
}

#[test]
fn behind_the_hold_it_is_judged_by_its_limits() {
    let life = held();
    let held_ticks = life.holds[0].from_ticks;
    let edges = life.edges.iter();
    let steps = edges.filter(|edge| edge.pin == Pin::Step(X) && edge.level);
    let before = steps.filter(|edge| edge.at_ticks < held_ticks).count();
    for step in [before + 200, before + 700, 5_000] {
        found(&delay(&life, X, step, step + 1, 100), "acceleration");
        found(&delay(&life, X, step, step + 1, -100), "acceleration");
    }
    found(
        &delay(&life, X, before + 700, 6_000, -40_000),
        "acceleration",
    );
    // It is not at rest when it should be.
    let mut longer = life.clone();
    longer.holds[0].until_ticks = Some(held_ticks + 16_000_000);
    found(&longer, "later at rest than a stop allows");
    // Nobody has told it to.
    let mut unexplained = life.clone();
    unexplained.holds.clear();
    unexplained.speeds.clear();
    found(&unexplained, "too late");
}

#[test]
fn a_speed_above_what_was_told_is_found() {
    let mut bench = Bench::new(config());
    bench.order([ramp(4_000, 5_000, 50_000, TRAPEZOID)]);
    bench.run_until(200_000);
    speed(&mut bench, 150);
    bench.run_to_rest();
    let life = bench.judged();
    let mut less = life.clone();
    less.speeds[0].share = (140 << 16) / 100;
    found(&less, "too fast for speed");
}

#[test]
fn a_ramp_at_half_its_speed_is_judged_to_the_tick() {
    for (percent, shape) in [
        (50, TRAPEZOID),
        (
            33,
            RampShape::Jerk {
                jerk_hz_per_s2: 300_000,
            },
        ),
        (170, TRAPEZOID),
        (
            70,
            RampShape::Smooth {
                start_hz: 400,
                ramp_steps: 700,
            },
        ),
    ] {
        let mut bench = Bench::new(config());
        speed(&mut bench, percent);
        bench.run_until(100_000);
        bench.order([
            ramp(3_000, 5_000, 20_000, shape),
            Command::Pause { pause_ms: 5 },
            ramp(2_000, 3_000, 20_000, shape),
        ]);
        bench.run_to_rest();
        let life = bench.judged();
        found(
            &delay(&life, X, 1_500, 1_501, 3),
            "step 1501 of 3000 of command 0 is",
        );
        found(&delay(&life, X, 3_000, 5_000, 40), "before command 2");
        let mut unexplained = life.clone();
        unexplained.speeds.clear();
        found(&unexplained, "of command 0 is");
    }
}

#[test]
fn a_held_line_stays_on_its_line() {
    let mut bench = Bench::new(config());
    bench.order([
        line([4_000, 3_000], 6_000, 30_000, 0),
        line([4_000, 3_200], 6_000, 30_000, 0),
    ]);
    bench.run_until(300_000);
    hold(&mut bench);
    bench.run_for(400_000);
    resume(&mut bench);
    bench.run_for(200_000);
    speed(&mut bench, 60);
    bench.run_to_rest();
    let life = bench.judged();
    for from in [900, 2_000, 4_000] {
        found(
            &delay(&life, Y, from, 6_200, 4_000),
            "off the straight line",
        );
    }
}

#[test]
fn random_paths_with_random_changes_keep_their_limits_and_their_line() {
    for seed in seeds(150) {
        println!("seed {seed}");
        let mut random = Random(seed ^ 0x9ace);
        let speed_hz = 200 + random.of_size(14) as u32;
        let accel = 1_000 + random.of_size(17) as u32;
        let shape = match random.below(4) {
            0 => RampShape::Jerk {
                jerk_hz_per_s2: accel.saturating_mul(1 + random.below(50) as u32),
            },
            1 => RampShape::Trapezoid {
                linear_steps: random.below(300) as u16,
                jump_steps: random.below(8) as u16,
            },
            2 => RampShape::Smooth {
                start_hz: 20 + random.below(u64::from(speed_hz) - 21) as u32,
                ramp_steps: 2 + random.below(400) as u32,
            },
            _ => TRAPEZOID,
        };
        let lines = random.below(3) == 0;
        let commands: Vec<_> = (0..1 + random.below(20))
            .map(|_| {
                let mut way = || (random.of_size(10) as i32) - 300;
                let steps = [way() | 1, way()];
                let jerk = match shape {
                    RampShape::Jerk { jerk_hz_per_s2 } => jerk_hz_per_s2,
                    RampShape::Trapezoid { .. } | RampShape::Smooth { .. } => 0,
                };
                match random.below(8) {
                    0 => Command::Pause {
                        pause_ms: random.below(60) as u32,
                    },
                    1 => Command::Move {
                        axis: X,
                        delay_us: 200 + random.below(300) as u32,
                        steps: (steps[0] % 50) | 1,
                    },
                    _ if lines => line(steps, speed_hz, accel, jerk),
                    _ => ramp(steps[0], speed_hz, accel, shape),
                }
            })
            .collect();
        let mut bench = Bench::new(config());
        bench.order(commands);
        let mut stopped = false;
        for _ in 0..random.below(6) {
            bench.run_for(random.of_size(20));
            match random.below(12) {
                0..4 => hold(&mut bench),
                4..7 => resume(&mut bench),
                7..11 => speed(&mut bench, 5 + random.below(150) as u16),
                _ => {
                    stopped = true;
                    bench.stop(StopMode::Decelerate);
                    break;
                }
            }
        }
        resume(&mut bench);
        if stopped {
            bench.run_for(20_000_000);
        } else {
            bench.run_to_rest();
        }
        if let Err(violations) = check_life(&bench.node.life()) {
            panic!("seed {seed}, {speed_hz} Hz, {accel}, {shape:?}: {violations:#?}");
        }
    }
}

#[test]
fn a_raw_move_that_is_held_again_at_once_is_explained() {
    let mut bench = Bench::new(config());
    bench.order([
        Command::Move {
            axis: X,
            delay_us: 279,
            steps: -49,
        },
        ramp(-173, 500, 4_000, TRAPEZOID),
    ]);
    bench.run_for(6_000);
    hold(&mut bench);
    bench.run_for(700_000);
    resume(&mut bench);
    bench.run_for(15);
    hold(&mut bench);
    resume(&mut bench);
    bench.run_to_rest();
    bench.judged();
}
