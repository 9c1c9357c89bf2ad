//! Moves that end at another speed than they begin with: lines whose next one takes the speed over, and
//! drives that pass their target.

mod bench;

use bench::{
    Bench, config,
    motor::{HZ, Random, keeps_limits, seeds, steps_of},
};
use emulator::record::Life;
use keys::{AxisId, Command, command::RampShape};
use motion::{Course, Direction, Gait, SoftLimits, Target};

const X: AxisId = AxisId(0);
const Y: AxisId = AxisId(1);
const Z: AxisId = AxisId(2);

fn line(steps: [i32; 4], speed_hz: u32, accel_hz_per_s: u32, jerk_hz_per_s2: u32) -> Command {
    Command::Line {
        steps,
        speed_hz,
        accel_hz_per_s,
        jerk_hz_per_s2,
    }
}

fn bench() -> Bench {
    let mut config = config();
    config.axis_count = 4;
    Bench::new(config)
}

fn run(commands: impl IntoIterator<Item = Command>) -> Life {
    let mut bench = bench();
    bench.order(commands);
    bench.run_to_rest();
    bench.judged()
}

impl Bench {
    fn drive(&mut self, axis: AxisId, target: Target, how: Course) {
        let motion = self.node.node_mut().motion_mut();
        motion.drive(axis, target, how).expect("it is free");
    }

    fn is_driving(&mut self) -> bool {
        self.node.node_mut().motion_mut().is_driving()
    }

    fn rest(&mut self) -> Life {
        let mut waits = 0;
        while self.is_driving() {
            self.run_for(20_000);
            waits += 1;
            assert!(waits < 10_000, "it never ends");
        }
        let life = self.node.life();
        for axis in [X, Y, Z] {
            let counted: i64 = steps_of(&life, axis).iter().map(|step| step.1).sum();
            assert_eq!(self.node.position_steps(axis), counted);
        }
        emulator::oracle::check_pins(&life).expect("the pins are right");
        life
    }
}

/// Speed from the step before a place to the one behind it, Hz.
fn speed_at(steps: &[(f64, i64)], place: usize) -> f64 {
    1.0 / (steps[place].0 - steps[place - 1].0)
}

#[test]
fn a_line_begins_and_ends_at_the_speeds_of_its_neighbours() {
    for jerk in [0, 20_000] {
        let life = run([
            line([2_000, 0, 0, 0], 1_000, 2_000, jerk),
            line([9_000, 0, 0, 0], 4_000, 2_000, jerk),
            line([3_000, 0, 0, 0], 2_000, 2_000, jerk),
        ]);
        let steps = steps_of(&life, X);
        assert_eq!(steps.len(), 14_000);
        // From 1000 to 2000 Hz over 4000 Hz in the second one.
        assert!((speed_at(&steps, 2_000) - 1_000.0).abs() < 2.0, "{jerk}");
        assert!((speed_at(&steps, 7_000) - 4_000.0).abs() < 1.0, "{jerk}");
        assert!((speed_at(&steps, 11_000) - 2_000.0).abs() < 2.0, "{jerk}");
        if jerk == 0 {
            // (4000 - 1000) / 2000 s up, (4000 - 2000) / 2000 s down, the rest at 4000 Hz.
            let coast = 9_000.0 - 15e6 / 4_000.0 - 12e6 / 4_000.0;
            let due = 1.5 + 1.0 + coast / 4_000.0;
            // From the middle of a step to the middle of the next.
            let made = steps[11_000].0 - steps[2_000].0;
            let halves = 0.5 / 2_000.0 - 0.5 / 1_000.0;
            assert!((made - due - halves).abs() < 1e-6, "{made} s of {due} s");
        }
    }
}

#[test]
fn ruckigs_example_of_three_axes_has_its_times_on_a_line() {
    // From {0, 0} to {1, 2} with all limits 1, in 4 s; a unit is 10,000 steps.
    let life = run([line([10_000, 0, 20_000, 0], 10_000, 10_000, 10_000)]);
    let (x, z) = (steps_of(&life, X), steps_of(&life, Z));
    // The first edge of Z is at half a step: t³ = 6·0.5 / j.
    let begin = z[0].0 - (3.0_f64 / 10_000.0).cbrt();
    let at =
        |steps: &[(f64, i64)], place: usize| (steps[place - 1].0 + steps[place].0) / 2.0 - begin;
    assert!((at(&z, 500) - 0.669_432_950_1).abs() < 2e-6);
    assert!((at(&z, 10_000) - 2.0).abs() < 1e-6);
    assert!((at(&x, 5_000) - 2.0).abs() < 1e-6);
    let end = z[19_999].0 + (3.0_f64 / 10_000.0).cbrt() - begin;
    assert!((end - 4.0).abs() < 1e-6, "{end}");
}

#[test]
fn ruckigs_axis_that_ends_at_a_speed_passes_its_target_at_that_speed() {
    // From -2 to -3, where it goes at 0.3; a unit is 10,000 steps, all limits are 1.
    let course = Course::hz(10_000, 10_000).shaped(RampShape::Jerk {
        jerk_hz_per_s2: 10_000,
    });
    let mut bench = bench();
    // To gain 0.3 takes 0.3^1.5 units: behind the target there must be room for it.
    bench.drive(Y, Target::To(-11_644), course);
    bench.rest();
    bench.drive(Y, Target::To(-10_000), course.passing_mhz(3_000_000));
    let life = bench.rest();
    let steps = steps_of(&life, Y);
    let back = &steps[11_644..];
    let begin = back[0].0 - (3.0_f64 / 10_000.0).cbrt();
    // Its target is passed between the last step up to it and the first one behind.
    let passed = (back[1_643].0 + back[1_644].0) / 2.0 - begin;
    let gained = 2.0 * 0.3_f64.sqrt();
    let rest = (1_644.0 - 0.3_f64.powf(1.5) * 10_000.0) / 3_000.0;
    assert!((passed - gained - rest).abs() < 1e-4, "{passed} s");
    assert!((speed_at(back, 1_644) - 3_000.0).abs() < 1.0);
    // Nothing has taken it over: it rests as far behind as it began before.
    assert_eq!(bench.node.position_steps(Y), -10_000 + 1_643);
    keeps_limits(&life, Y, 10_000.0, 10_000.0, 0.0, "");
}

#[test]
fn compressed_steps_of_klippers_kind_are_there_to_the_tick() {
    // (interval, count, add) in µs: edges at interval·k + add·k(k - 1)/2.
    for (interval, count, add, due_us) in [
        (
            10_000,
            5,
            -100,
            &[10_000, 19_900, 29_700, 39_400, 49_000][..],
        ),
        (
            50_000,
            6,
            -5_000,
            &[50_000, 95_000, 135_000, 170_000, 200_000, 225_000],
        ),
        (1_000, 3, 50, &[1_000, 2_050, 3_150]),
        (5_000, 4, 0, &[5_000, 10_000, 15_000, 20_000]),
    ] {
        let pause = Command::Pause {
            pause_ms: interval as u32 / 1_000,
        };
        let step = |number: i32| Command::Move {
            axis: X,
            delay_us: (interval + add * number) as u32,
            steps: 1,
        };
        // A step before all, to know when they begin.
        let first = Command::Move {
            axis: Y,
            delay_us: 1,
            steps: 1,
        };
        let steps = (1..=count).map(step);
        let life = run([first, pause].into_iter().chain(steps));
        let begin = steps_of(&life, Y)[0].0 + 1e-6;
        let made = steps_of(&life, X);
        assert_eq!(made.len(), due_us.len());
        for ((at, _), due) in made.into_iter().zip(due_us) {
            let ticks = (at - begin) * HZ - f64::from(*due) * 16.0;
            // Two axes start within three ticks of each other.
            assert!(ticks.abs() < 3.5, "{interval}, {add}: {ticks}");
        }
    }
}

#[test]
fn a_drive_passes_its_target_and_rests_behind_it_by_its_ramp() {
    for (passing, accel) in [(1_000_u64, 4_000_u32), (2_500, 40_000), (9_000, 4_000)] {
        let mut bench = bench();
        let course = Course::hz(5_000, accel).passing_mhz(passing * 1_000);
        bench.drive(X, Target::To(-6_000), course);
        let life = bench.rest();
        let steps = steps_of(&life, X);
        // No faster than its own speed.
        let speed = passing.min(5_000) as f64;
        assert!((speed_at(&steps, 6_000) - speed).abs() < speed / 500.0);
        let way = speed * speed / 2.0 / f64::from(accel);
        let rests = (-bench.node.position_steps(X) - 6_000) as f64;
        assert!((rests - way).abs() <= 1.0, "{rests} of {way} steps");
        keeps_limits(&life, X, 5_000.0, f64::from(accel), 0.0, "");
    }
    // Too short a way to reach it: as fast as it can be.
    let mut bench = bench();
    bench.drive(
        X,
        Target::To(50),
        Course::hz(5_000, 4_000).passing_mhz(4_000_000),
    );
    let life = bench.rest();
    assert!((speed_at(&steps_of(&life, X), 50) - 400_000.0_f64.sqrt()).abs() < 5.0);
    assert_eq!(bench.node.position_steps(X), 100);
}

#[test]
fn the_next_order_takes_the_speed_over_without_a_dip() {
    let course = Course::hz(2_000, 20_000).passing_mhz(2_000_000);
    for wait_us in [0, 300_000, 700_000, 1_030_000] {
        let mut bench = bench();
        bench.drive(X, Target::To(2_000), course);
        bench.run_for(wait_us);
        bench.drive(X, Target::To(5_000), Course::hz(2_000, 20_000));
        let life = bench.rest();
        assert_eq!(bench.node.position_steps(X), 5_000);
        let steps = steps_of(&life, X);
        let coasts = &steps[200..4_800];
        let slowest = coasts.windows(2).map(|pair| pair[1].0 - pair[0].0);
        let slowest = slowest.fold(0.0, f64::max);
        assert!(slowest < 1.0 / 1_990.0, "{wait_us}: {slowest} s");
    }
}

#[test]
fn a_target_that_is_too_near_to_pass_slowly_is_passed_on_the_way_back() {
    let mut bench = bench();
    bench.drive(
        X,
        Target::Forever(Direction::Positive),
        Course::hz(4_000, 8_000),
    );
    bench.run_for(1_000_000);
    let here = bench.node.position_steps(X);
    bench.drive(
        X,
        Target::To(here + 300),
        Course::hz(4_000, 8_000).passing_mhz(500_000),
    );
    bench.run_for(100_000);
    let motion = bench.node.node_mut().motion_mut();
    assert_eq!(motion.gait(X), Gait::Reverse);
    assert!(motion.accel_hz_per_s(X) < 0);
    assert_eq!(motion.target_position(X), Some(here + 300));
    let life = bench.rest();
    // 500² / 2·8000 steps behind it, on the way back.
    let rests = here + 300 - bench.node.position_steps(X);
    assert!((15..=17).contains(&rests), "{rests}");
    keeps_limits(&life, X, 4_000.0, 8_000.0, 0.0, "");
}

#[test]
fn a_target_that_was_passed_is_passed_once_whatever_is_changed_then() {
    for change in 0..3 {
        let mut bench = bench();
        let course = Course::hz(4_000, 4_000).passing_mhz(3_000_000);
        bench.drive(X, Target::To(4_000), course);
        let mut waits = 0;
        while bench.node.position_steps(X) < 4_300 {
            bench.run_for(10_000);
            waits += 1;
            assert!(waits < 1_000);
        }
        let now = motion::Ticks(bench.now.0 * 16);
        let motion = bench.node.node_mut().motion_mut();
        match change {
            0 => motion.set_speed_percent(50),
            1 => motion.hold(now),
            _ => motion.end_drive_of(X),
        }
        bench.run_for(2_000_000);
        bench.node.node_mut().motion_mut().resume();
        bench.rest();
        // 3000² / 2·4000 steps behind it; the braking that is begun anew may end a step elsewhere.
        let rests = bench.node.position_steps(X);
        assert!((5_124..=5_126).contains(&rests), "{change}: {rests}");
    }
}

#[test]
fn what_could_not_rest_before_a_soft_limit_rests_on_its_target() {
    for (bound, rests) in [(3_000, 2_000), (5_000, 4_000)] {
        let mut config = config();
        config.motion.soft_limits[0] = Some(SoftLimits {
            min_steps: -100,
            max_steps: bound,
            from_boot: true,
        });
        let mut bench = Bench::new(config);
        let course = Course::hz(4_000, 4_000).passing_mhz(4_000_000);
        bench.drive(X, Target::To(2_000), course);
        bench.rest();
        let position = bench.node.position_steps(X);
        assert!((position - rests).abs() <= 1, "{bound}: {position}");
    }
}

#[test]
fn random_drives_that_pass_their_targets_keep_their_limits_and_every_step() {
    for seed in seeds(40) {
        let mut random = Random(seed ^ 0x9a55);
        let what = format!("seed {seed}");
        let mut bench = bench();
        let speed_hz = 50 + random.of_size(14) as u32;
        let accel = 200 + random.of_size(16) as u32;
        let shape = match random.below(3) {
            0 => RampShape::Jerk {
                jerk_hz_per_s2: accel.saturating_mul(1 + random.below(40) as u32),
            },
            _ => RampShape::Trapezoid {
                linear_steps: random.below(40) as u16,
                jump_steps: 0,
            },
        };
        let course = Course::hz(speed_hz, accel).shaped(shape);
        for _ in 0..2 + random.below(12) {
            let target = random.of_size(13) as i64 - 1_500;
            let passing = random.below(u64::from(speed_hz) * 1_300);
            bench.drive(X, Target::To(target), course.passing_mhz(passing));
            bench.run_for(random.of_size(19));
        }
        let end = random.below(4_000) as i64 - 2_000;
        bench.drive(X, Target::To(end), course);
        let life = bench.rest();
        assert_eq!(bench.node.position_steps(X), end, "{what}");
        keeps_limits(&life, X, f64::from(speed_hz), f64::from(accel), 0.0, &what);
        assert!(bench.node.status().faults.is_empty(), "{what}");
    }
}
