//! Several axes, each driven by itself: with its own ramp and target, begun, changed and ended while
//! the others go on.

mod bench;

use bench::{
    Bench, config,
    motor::{HZ, Random, keeps_limits, seeds, steps_of},
};
use emulator::record::Life;
use keys::{AxisId, Command, NodeState, StopMode, command::RampShape};
use motion::{Course, Direction, DriveError, Motion, Target, Ticks};

const X: AxisId = AxisId(0);
const Y: AxisId = AxisId(1);
const Z: AxisId = AxisId(2);
const A: AxisId = AxisId(3);

type InnerMotion = Motion<'static, emulator::pulse::VirtualRmt>;

fn bench() -> Bench {
    let mut config = config();
    config.axis_count = 4;
    Bench::new(config)
}

impl Bench {
    fn motion(&mut self) -> &mut InnerMotion {
        self.node.node_mut().motion_mut()
    }

    fn drive(&mut self, axis: AxisId, target: Target, how: Course) {
        self.motion().drive(axis, target, how).expect("it is free");
    }

    fn hold(&mut self) {
        let now = Ticks(self.now.0 * 16);
        self.motion().hold(now);
    }

    fn position(&self, axis: AxisId) -> i64 {
        self.node.status().axes[axis.index()].position_steps
    }

    fn run_to_ends(&mut self, what: &str) {
        let mut waits = 0;
        while self.motion().is_driving() {
            self.run_for(50_000);
            waits += 1;
            assert!(waits < 10_000, "{what}: it never ends");
        }
    }
}

fn pins_are_right(bench: &Bench, what: &str) -> Life {
    let life = bench.node.life();
    for axis in [X, Y, Z, A] {
        let counted: i64 = steps_of(&life, axis).iter().map(|step| step.1).sum();
        assert_eq!(bench.node.step_count(axis), counted, "{what}");
        assert_eq!(bench.position(axis), counted, "{what}");
    }
    if let Err(violations) = emulator::oracle::check_pins(&life) {
        panic!("{what}: {violations:?}");
    }
    life
}

/// When a trapezoid from rest passes the middle of each step, s.
fn trapezoid(steps: u32, speed: f64, accel: f64) -> Vec<f64> {
    let way = f64::from(steps);
    let ramp = (speed * speed / 2.0 / accel).min(way / 2.0);
    let top = (2.0 * accel * ramp).sqrt();
    let total = 2.0 * top / accel + (way - 2.0 * ramp) / top;
    let at = |place: f64| {
        if place <= ramp {
            (2.0 * place / accel).sqrt()
        } else if place <= way - ramp {
            top / accel + (place - ramp) / top
        } else {
            total - (2.0 * (way - place) / accel).sqrt()
        }
    };
    (0..steps).map(|step| at(f64::from(step) + 0.5)).collect()
}

#[test]
fn the_speed_that_is_told_only_falls_on_the_way_to_rest() {
    for end_us in (20_000..60_000).step_by(311) {
        let mut bench = bench();
        bench.drive(
            X,
            Target::Forever(Direction::Negative),
            Course::hz(900, 8_000),
        );
        bench.run_for(end_us);
        bench.motion().end_drive(StopMode::Decelerate);
        // What the hardware holds is still planned before.
        bench.run_for(3_000);
        let mut before = i32::MAX;
        while bench.motion().is_driving() {
            let speed_mhz = -bench.node.status().axes[X.index()].speed_mhz;
            assert!(
                (0..=before).contains(&speed_mhz),
                "ended at {end_us} µs: {before} mHz, then {speed_mhz}"
            );
            before = speed_mhz;
            bench.run_for(100);
        }
        let rests = bench.node.status().axes[X.index()].speed_mhz;
        assert_eq!(rests, 0, "ended at {end_us} µs");
    }
}

#[test]
fn each_axis_has_the_edges_that_it_would_have_alone() {
    let mut bench = bench();
    // FastAccelStepper's example on X; the others begin and end while it is under way.
    bench.drive(X, Target::To(1_000), Course::hz(500, 100));
    bench.run_for(1_300_000);
    bench.drive(Y, Target::By(-15_000), Course::hz(10_000, 10_000));
    bench.run_for(900_123);
    bench.drive(Z, Target::By(7), Course::hz(20, 1_000));
    bench.run_for(1_000_000);
    assert!(bench.motion().is_driven(X) && bench.motion().is_driven(Y));
    assert!(!bench.motion().is_driven(Z), "it has arrived");
    bench.drive(Z, Target::By(-50_000), Course::hz(100_000, 400_000));
    bench.run_to_ends("");
    let life = pins_are_right(&bench, "");
    for (axis, from, steps, speed, accel) in [
        (X, 0, 1_000, 500.0, 100.0),
        (Y, 0, 15_000, 10_000.0, 10_000.0),
        (Z, 0, 7, 20.0, 1_000.0),
        (Z, 7, 50_000, 100_000.0, 400_000.0),
    ] {
        let made = steps_of(&life, axis);
        let made = &made[from..from + steps as usize];
        let due = trapezoid(steps, speed, accel);
        let shift = made[0].0 - due[0];
        for (number, (made, due)) in made.iter().zip(&due).enumerate() {
            let error = (made.0 - due - shift) * HZ;
            // The first edge is rounded as well.
            assert!(error.abs() < 1.5, "{axis:?}, edge {number}: {error} ticks");
        }
    }
}

#[test]
fn an_axis_begins_within_two_milliseconds_while_another_moves() {
    for (speed_hz, wait_us) in [(3, 1_000_000), (700, 501_003), (150_000, 100_000)] {
        let mut bench = bench();
        let forever = Target::Forever(Direction::Positive);
        bench.drive(X, forever, Course::hz(speed_hz, 1_000_000));
        bench.run_for(wait_us);
        let at = bench.now.0 as f64 / 1e6;
        bench.drive(Y, Target::By(-10), Course::hz(1_000_000, 4_000_000_000));
        bench.run_for(100_000);
        assert_eq!(bench.position(Y), -10);
        let life = pins_are_right(&bench, "");
        let first = steps_of(&life, Y)[0].0;
        assert!(first - at < 0.0022, "{speed_hz} Hz: {} s", first - at);
        bench.motion().end_drive(StopMode::Decelerate);
        bench.run_to_ends("");
        pins_are_right(&bench, "");
    }
}

#[test]
fn one_axis_ends_while_the_others_go_on() {
    let mut bench = bench();
    let course = Course::hz(4_000, 20_000);
    for axis in [X, Y, Z] {
        bench.drive(axis, Target::Forever(Direction::Positive), course);
    }
    bench.run_for(500_000);
    bench.motion().end_drive_of(Y);
    bench.run_for(400_000);
    assert!(!bench.motion().is_driven(Y));
    let y = bench.position(Y);
    bench.run_for(400_000);
    assert_eq!(bench.position(Y), y);
    assert!(bench.position(X) > y + 2_000);
    // The queue waits for all of them.
    let pause = Command::Pause { pause_ms: 1 };
    bench.order([pause]);
    bench.run_for(100_000);
    assert_eq!(bench.node.status().executed_commands, 0);
    bench.motion().end_drive(StopMode::Halt);
    bench.run_for(100_000);
    assert_eq!(bench.node.status().executed_commands, 1);
    assert!(!bench.motion().is_driving());
    let life = pins_are_right(&bench, "");
    keeps_limits(&life, Y, 4_000.0, 20_000.0, 0.0, "");
    let busy = bench.motion().drive(AxisId(4), Target::By(1), course);
    assert!(matches!(busy, Err(DriveError::Command(_))));
}

#[test]
fn a_stop_brings_all_axes_to_rest_each_by_its_own_ramp() {
    for stop_us in [3_000, 250_000, 700_000] {
        let mut bench = bench();
        bench.drive(X, Target::To(90_000), Course::hz(8_000, 10_000));
        bench.drive(Y, Target::To(-90_000), Course::hz(3_000, 90_000));
        bench.run_until(stop_us);
        bench.drive(Z, Target::To(500), Course::hz(700, 2_000));
        bench.run_for(10_000);
        bench.stop(StopMode::Decelerate);
        bench.run_for(5_000_000);
        assert_eq!(bench.node.status().state, NodeState::Stopped);
        assert!(!bench.motion().is_driving());
        let life = pins_are_right(&bench, "");
        keeps_limits(&life, X, 8_000.0, 10_000.0, 0.0, "");
        keeps_limits(&life, Y, 3_000.0, 90_000.0, 0.0, "");
        keeps_limits(&life, Z, 700.0, 2_000.0, 0.0, "");
        assert!(bench.position(X) < 90_000);
    }
}

#[test]
fn a_direction_that_is_held_up_between_changes_is_never_turned_in_a_step() {
    let mut bench = bench();
    // Many changes at one instant and in quick succession: full is an answer, not a loss.
    for round in 0..40_i64 {
        for target in [300, -300, 20, 0, 5] {
            let course = Course::hz(2_000 + 17 * round as u32, 300_000);
            bench.drive(X, Target::To(target * (round % 5)), course);
            bench.drive(Y, Target::By(target), course);
        }
        bench.run_for(150 * (1 + round as u64 % 7));
    }
    bench.run_to_ends("");
    assert_eq!(bench.position(X), 5 * 4);
    assert_eq!(bench.position(Y), 40 * 25);
    pins_are_right(&bench, "");
}

#[test]
fn a_drive_that_is_left_before_its_first_step_ends() {
    let forward = Target::Forever(Direction::Positive);
    let backward = Target::Forever(Direction::Negative);
    for end_us in [0, 5, 700, 2_929, 9_000, 60_000] {
        for turn_us in [None, Some(0), Some(5), Some(2_929)] {
            let what = format!("{turn_us:?}, {end_us}");
            let mut bench = bench();
            if let Some(turn_us) = turn_us {
                bench.drive(Y, forward, Course::hz(14, 679));
                bench.run_for(5);
                bench.drive(Y, backward, Course::hz(448, 10_703));
                bench.run_for(turn_us);
            }
            bench.drive(Y, forward, Course::hz(5, 5_962));
            bench.run_for(end_us);
            bench.motion().end_drive_of(Y);
            bench.run_for(8_000_000);
            assert!(!bench.motion().is_driving(), "{what}");
            pins_are_right(&bench, &what);
        }
    }
}

#[test]
fn random_drives_of_four_axes_end_where_each_was_sent_last() {
    for seed in seeds(20) {
        let mut random = Random(seed ^ 0xa11);
        let mut bench = bench();
        let mut targets = [0_i64; 4];
        let mut accels = [0_u32; 4];
        let speeds = [(); 4].map(|()| 50 + random.of_size(13) as u32);
        let least = [(); 4].map(|()| 200 + random.of_size(14) as u32);
        let what = format!("seed {seed}");
        for _ in 0..2 + random.below(16) {
            let axis = random.below(4) as usize;
            let speed_hz = 1 + random.below(u64::from(speeds[axis])) as u32;
            let accel = least[axis] * (1 + random.below(4) as u32);
            accels[axis] = accels[axis].max(accel);
            let mut course = Course::hz(speed_hz, accel);
            if random.below(3) == 0 {
                course = course.shaped(RampShape::Jerk {
                    jerk_hz_per_s2: accel.saturating_mul(1 + random.below(50) as u32),
                });
            }
            targets[axis] = random.of_size(11) as i64 - 1_000;
            bench.drive(AxisId(axis as u8), Target::To(targets[axis]), course);
            bench.run_for(random.of_size(19));
            match random.below(6) {
                0 => {
                    bench.hold();
                    bench.run_for(random.of_size(19));
                    bench.motion().resume();
                }
                1 => bench
                    .motion()
                    .set_speed_percent(20 + random.below(80) as u16),
                _ => {}
            }
        }
        bench.motion().set_speed_percent(100);
        for (index, accel) in accels
            .into_iter()
            .enumerate()
            .filter(|(_, accel)| *accel > 0)
        {
            let course = Course::hz(speeds[index], accel);
            bench.drive(AxisId(index as u8), Target::To(targets[index]), course);
        }
        bench.run_to_ends(&what);
        let life = pins_are_right(&bench, &what);
        for (index, target) in targets.into_iter().enumerate() {
            let axis = AxisId(index as u8);
            assert_eq!(bench.position(axis), target, "{what}, {axis:?}");
            let (speed, accel) = (f64::from(speeds[index]), f64::from(accels[index]));
            keeps_limits(&life, axis, speed, accel, 0.0, &what);
        }
        assert!(bench.node.status().faults.is_empty(), "{what}");
    }
}
