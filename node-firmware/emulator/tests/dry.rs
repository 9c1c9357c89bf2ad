//! A queue that runs dry: lines stop coming, and the axes rest at the end of the last one on a ramp
//! that was planned with it; that is flagged, and what comes later goes on without a lost step.

mod bench;

use bench::{
    Bench, config,
    motor::{Random, keeps_limits, seeds, steps_of},
};
use keys::{AxisId, Command, NodeState, status::FaultCode};

const X: AxisId = AxisId(0);
const Y: AxisId = AxisId(1);

impl Bench {
    /// Sends so many of the commands that wait; the job has all of them.
    fn send(&mut self, count: usize) {
        let later = self.waiting.split_off(count.min(self.waiting.len()));
        self.feed();
        self.waiting = later;
    }

    fn position(&self, axis: AxisId) -> i64 {
        self.node.status().axes[axis.index()].position_steps
    }

    fn underruns(&self) -> usize {
        let told = FaultCode::UNDERRUN.as_str();
        self.lines.iter().filter(|line| line.contains(told)).count()
    }

    /// Runs until everything that was sent has ended, and the axes rest.
    fn run_dry(&mut self) {
        let mut wakes = 0;
        while self.node.status().executed_commands < self.node.status().accepted_commands {
            let due = self.node.poll_timeout().expect("something is due");
            // Without what waits.
            self.now = self.now.max(due);
            self.node.poll(self.now);
            self.drain();
            wakes += 1;
            assert!(wakes < 1_000_000, "it does not end");
        }
        self.now.0 += 5_000;
        self.node.poll(self.now);
        self.drain();
    }
}

#[test]
fn lines_that_stop_coming_end_at_rest_on_a_planned_ramp_and_go_on_later() {
    let line = Command::Line {
        steps: [500, 200, 0, 0],
        speed_hz: 20_000,
        accel_hz_per_s: 100_000,
        jerk_hz_per_s2: 0,
    };
    let mut bench = Bench::new(config());
    bench.job_end = 60;
    bench.waiting.extend([line; 60]);
    bench.send(30);
    bench.run_dry();
    assert_eq!([bench.position(X), bench.position(Y)], [15_000, 6_000]);
    assert_eq!(bench.underruns(), 1);
    let status = bench.node.status();
    assert_eq!(status.faults[0].code, FaultCode::UNDERRUN);
    assert_ne!(status.state, NodeState::Fault, "it goes on by itself");
    let life = bench.judged();
    // It went at full speed, and slowed down to rest: the last step takes √2 times as long as the first
    // half step from rest, less than that would be a halt.
    let steps = steps_of(&life, X);
    let interval = |index: usize| steps[index + 1].0 - steps[index].0;
    assert!((interval(7_500) - 1.0 / 20_000.0).abs() < 1e-6);
    let last = interval(steps.len() - 2);
    let least = (3.0_f64.sqrt() - 1.0) / 100_000.0_f64.sqrt();
    assert!((last - least).abs() < 1e-6, "{last} s, {least} s");
    bench.send(30);
    bench.run_dry();
    assert_eq!([bench.position(X), bench.position(Y)], [30_000, 12_000]);
    assert_eq!(bench.underruns(), 1, "the job has ended");
    bench.judged();
}

/// A node whose planner comes up to 10 s too late.
fn starving(commands: impl IntoIterator<Item = Command>) -> Bench {
    let mut config = config();
    config.rmt.plan_ticks_max = 10_000_000 * 16;
    let mut bench = Bench::new(config);
    bench.order(commands);
    bench.now.0 += 1_000;
    while bench.node.status().state != NodeState::Fault {
        let due = bench.node.poll_timeout().expect("something is due");
        bench.now = bench.now.max(due);
        assert!(bench.now.0 < 400_000_000, "it comes in time");
        bench.node.poll(bench.now);
        bench.drain();
    }
    let fault = bench.node.status().faults.last().map(|fault| fault.code);
    assert_eq!(fault, Some(FaultCode::PLAN_LATE));
    bench
}

/// From full run to rest by this deceleration, and no harder; every step counts. Returns the greatest
/// speed.
fn rests(bench: &Bench, axis: AxisId, accel: f64) -> f64 {
    let life = bench.node.life();
    let steps = steps_of(&life, axis);
    let made: i64 = steps.iter().map(|step| step.1).sum();
    assert_eq!(bench.position(axis), made);
    assert_eq!(bench.node.step_count(axis), bench.position(axis));
    // The speed is taken from one interval.
    keeps_limits(&life, axis, 100_000.0, accel * 1.005, 0.0, "starved");
    let speeds: Vec<f64> = steps
        .windows(2)
        .map(|pair| 1.0 / (pair[1].0 - pair[0].0))
        .collect();
    // Three steps from rest at most: v² = 2·a·s.
    let last = speeds[speeds.len() - 1];
    assert!(last <= (6.0 * accel).sqrt(), "it ends at {last} Hz");
    speeds.into_iter().fold(0.0, f64::max)
}

#[test]
fn a_planner_that_comes_too_late_finds_the_axes_at_rest_on_a_ramp_and_every_step_counted() {
    // So slow a ramp needs more segments than there is room for.
    let slow = keys::command::Ramp {
        speed_hz: 20_000,
        accel_hz_per_s: 100,
        shape: keys::command::RampShape::Trapezoid {
            linear_steps: 0,
            jump_steps: 0,
        },
    };
    let bench = starving([Command::Ramp {
        axis: X,
        steps: 1_000_000,
        ramp: slow,
    }]);
    assert!(rests(&bench, X, 100.0) > 50.0);
    // Of short lines in a row, too: each axis by its own share.
    let line = Command::Line {
        steps: [500, 250, 0, 0],
        speed_hz: 50_000,
        accel_hz_per_s: 2_000,
        jerk_hz_per_s2: 0,
    };
    let bench = starving([line; 400]);
    assert!(rests(&bench, X, 2_000.0) > 1_000.0);
    rests(&bench, Y, 1_000.0);
    assert!(bench.position(X) < 200_000, "all of it was made");
    // Drives rest likewise.
    let mut config = config();
    config.rmt.plan_ticks_max = 10_000_000 * 16;
    let mut bench = Bench::new(config);
    let motion = bench.node.node_mut().motion_mut();
    let forever = motion::Target::Forever(motion::Direction::Negative);
    let course = motion::Course::hz(20_000, 100);
    motion.drive(X, forever, course).expect("free");
    for _ in 0..100 {
        // Nobody looks at it for 3 s.
        bench.now.0 += 3_000_000;
        bench.node.poll(bench.now);
    }
    let fault = bench.node.status().faults.last().map(|fault| fault.code);
    assert_eq!(fault, Some(FaultCode::PLAN_LATE));
    assert!(rests(&bench, X, 100.0) > 50.0);
}

/// Steps of X and Y with their times, in order.
fn both(life: &emulator::record::Life) -> Vec<(f64, usize)> {
    let mut all: Vec<_> = [X, Y]
        .into_iter()
        .flat_map(|axis| {
            let steps = steps_of(life, axis).into_iter();
            steps.map(move |(at, _)| (at, axis.index()))
        })
        .collect();
    all.sort_by(|a, b| a.0.total_cmp(&b.0));
    all
}

/// Up to a step by the edges themselves, up to one because each begins to slow down at its next edge, and
/// half a step because its speed is that of the last whole interval.
const OFF_MAX: f64 = 2.5;

/// How far the shorter axis is off the line at most, steps, and where both rest. An edge is in the middle
/// of its step, so both edges alone make up to a step.
fn off_the_line(life: &emulator::record::Life, steps: [i32; 2]) -> (f64, [f64; 2]) {
    let [x, y] = steps.map(f64::from);
    let short = usize::from(steps[0] >= steps[1]);
    let (mut place, mut off) = ([0.0; 2], 0.0_f64);
    for (_, axis) in both(life) {
        place[axis] += 1.0;
        // On the way of the shorter one.
        let of_short = [x, y][short];
        let apart = place[0] * of_short / x - place[1] * of_short / y;
        off = off.max(apart.abs());
    }
    (off, place)
}

#[test]
fn axes_of_a_line_stay_on_it_while_they_slow_down_for_want_of_a_plan() {
    // Their segments end far apart: there are as many of each, and Y makes few steps with each.
    for (steps, speed_hz, accel, jerk) in [
        ([1_000_000, 400_000], 50_000, 100, 0),
        ([1_000_000, 10_000], 50_000, 500, 0),
        ([1_000_000, 999_999], 100_000, 3_000, 0),
        ([700, 1_000_000], 30_000, 1_000, 0),
        ([1_000_000, 300_000], 40_000, 500, 100),
        ([1_000_000, 70_000], 40_000, 5_000, 500),
    ] {
        let what = format!("{steps:?} at {speed_hz} Hz, {accel}, {jerk}");
        let bench = starving([Command::Line {
            steps: [steps[0], steps[1], 0, 0],
            speed_hz,
            accel_hz_per_s: accel,
            jerk_hz_per_s2: jerk,
        }]);
        let (off, place) = off_the_line(&bench.node.life(), steps);
        println!("{what}: off by {off:.2} steps, at rest at {place:?}");
        assert!(place[0] + place[1] < 900_000.0, "{what}: it starved");
        assert!(off <= OFF_MAX, "{what}: {off} steps off the line");
        // An S-curve's acceleration holds, though not its jerk.
        let longest = f64::from(steps[0].max(steps[1]));
        for axis in [X, Y] {
            let share = f64::from(steps[axis.index()]) / longest;
            if place[axis.index()] > 3.0 {
                rests(&bench, axis, f64::from(accel) * share);
            }
        }
    }
}

#[test]
fn random_lines_that_starve_rest_on_their_line() {
    let mut starved = 0;
    for seed in seeds(20) {
        let mut random = Random(seed ^ 0x57a2);
        let mut way = || 200 + random.of_size(20) as i32;
        let steps = [way(), way()];
        let (speed_hz, accel) = (
            100 + random.of_size(16) as u32,
            50 + random.of_size(14) as u32,
        );
        let jerk_hz_per_s2 = match random.below(2) {
            0 => accel.saturating_mul(1 + random.below(20) as u32),
            _ => 0,
        };
        let mut config = config();
        // The planner comes up to 3 s late, and looks at any time before.
        config.rmt.plan_ticks_max = 3_000_000 * 16;
        config.seed = seed;
        let mut bench = Bench::new(config);
        bench.order([Command::Line {
            steps: [steps[0], steps[1], 0, 0],
            speed_hz,
            accel_hz_per_s: accel,
            jerk_hz_per_s2,
        }]);
        let status = |bench: &Bench| bench.node.status();
        while status(&bench).executed_commands == 0 && status(&bench).state != NodeState::Fault {
            let due = bench.node.poll_timeout().expect("something is due");
            bench.now = bench.now.max(due);
            bench.node.poll(bench.now);
            bench.drain();
        }
        bench.now.0 += 5_000;
        bench.node.poll(bench.now);
        starved += usize::from(status(&bench).state == NodeState::Fault);
        let life = bench.node.life();
        let what = format!("seed {seed}: {steps:?}, {speed_hz} Hz, {accel}, {jerk_hz_per_s2}");
        let (off, place) = off_the_line(&life, steps);
        assert!(
            off <= OFF_MAX,
            "{what}: {off} steps off the line, {place:?}"
        );
        let longest = f64::from(steps[0].max(steps[1]));
        for axis in [X, Y] {
            let share = f64::from(steps[axis.index()]) / longest;
            let (speed, accel) = (f64::from(speed_hz) * share, f64::from(accel) * share);
            keeps_limits(&life, axis, speed, accel * 1.005, 0.0, &what);
            assert_eq!(bench.position(axis), place[axis.index()] as i64, "{what}");
        }
    }
    println!("{starved} starved");
    assert!(starved > 0);
}

#[test]
fn commands_that_come_in_bits_at_random_times_cost_no_step_and_keep_every_limit() {
    let (mut dry, mut fed) = (0, 0);
    for seed in seeds(60) {
        let mut random = Random(seed ^ 0xd27);
        let speed_hz = 100 + random.of_size(15) as u32;
        let accel = 2_000 + random.of_size(17) as u32;
        let jerk_hz_per_s2 = match random.below(3) {
            0 => accel.saturating_mul(1 + random.below(50) as u32),
            _ => 0,
        };
        let ramps = random.below(4) == 0;
        let what = format!("seed {seed}, {speed_hz} Hz, {accel}, {jerk_hz_per_s2}");
        let mut end = [0_i64; 2];
        let straight = random.below(2) == 0;
        let count = 20 + random.below(60);
        let commands: Vec<_> = (0..count)
            .map(|_| {
                let mut way = || random.of_size(8) as i32;
                let steps = if straight {
                    let length = way();
                    [4 * length, length]
                } else {
                    [way(), way() - 60]
                };
                end[0] += i64::from(steps[0]);
                if ramps {
                    return Command::Ramp {
                        axis: X,
                        steps: steps[0],
                        ramp: keys::command::Ramp {
                            speed_hz,
                            accel_hz_per_s: accel,
                            shape: keys::command::RampShape::Trapezoid {
                                linear_steps: 0,
                                jump_steps: 0,
                            },
                        },
                    };
                }
                end[1] += i64::from(steps[1]);
                Command::Line {
                    steps: [steps[0], steps[1], 0, 0],
                    speed_hz,
                    accel_hz_per_s: accel,
                    jerk_hz_per_s2,
                }
            })
            .collect();
        let mut bench = Bench::new(config());
        bench.job_end = count;
        bench.waiting.extend(commands);
        while !bench.waiting.is_empty() {
            bench.send(1 + random.below(12) as usize);
            let rest = std::mem::take(&mut bench.waiting);
            if random.below(3) == 0 {
                bench.run_dry();
            } else {
                bench.run_for(random.of_size(19));
            }
            bench.waiting = rest;
            let status = bench.node.status();
            let is_dry = status.executed_commands == status.accepted_commands;
            dry += usize::from(is_dry);
            fed += usize::from(!is_dry);
            if is_dry && !bench.waiting.is_empty() {
                assert!(bench.underruns() > 0, "{what}");
                bench.judged();
            }
        }
        bench.run_dry();
        assert_eq!([bench.position(X), bench.position(Y)], end, "{what}");
        println!("{what}");
        let life = bench.judged();
        for axis in [X, Y] {
            let speed = f64::from(speed_hz);
            keeps_limits(&life, axis, speed, f64::from(accel), 200.0, &what);
        }
        let faults = bench.node.status().faults;
        let others = faults
            .iter()
            .filter(|fault| fault.code != FaultCode::UNDERRUN);
        assert_eq!(others.count(), 0, "{what}");
    }
    assert!(dry > 20 && fed > 20, "{dry} dry, {fed} fed");
}
