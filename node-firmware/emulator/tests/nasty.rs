//! What nobody should order and somebody will: one step by every ramp, ways without end, stops in the
//! midst of a turn while refills come late.

mod bench;

use bench::{Bench, config, motor::steps_of};
use keys::{
    AxisId, Command, StopMode,
    command::{Ramp, RampShape},
};
use motion::{Course, Direction, Target};

const X: AxisId = AxisId(0);
const Y: AxisId = AxisId(1);

fn trapezoid(linear_steps: u16, jump_steps: u16) -> RampShape {
    RampShape::Trapezoid {
        linear_steps,
        jump_steps,
    }
}

fn ramp(steps: i32, speed_hz: u32, accel_hz_per_s: u32, shape: RampShape) -> Command {
    Command::Ramp {
        axis: X,
        steps,
        ramp: Ramp {
            speed_hz,
            accel_hz_per_s,
            shape,
        },
    }
}

fn raw(axis: AxisId, steps: i32, delay_us: u32) -> Command {
    Command::Move {
        axis,
        delay_us,
        steps,
    }
}

#[test]
fn one_and_two_steps_by_every_ramp_are_made() {
    let shapes = [
        trapezoid(0, 0),
        trapezoid(u16::MAX, 0),
        trapezoid(0, u16::MAX),
        trapezoid(3, 1),
        RampShape::Jerk { jerk_hz_per_s2: 1 },
        RampShape::Jerk {
            jerk_hz_per_s2: u32::MAX,
        },
        RampShape::Smooth {
            start_hz: 1,
            ramp_steps: 2,
        },
        RampShape::Smooth {
            start_hz: 1,
            ramp_steps: u32::MAX,
        },
    ];
    let mut bench = Bench::new(config());
    let mut commands = Vec::new();
    for shape in shapes {
        for (speed_hz, accel) in [(2, 1), (1_000_000, u32::MAX), (2, u32::MAX), (1_000_000, 1)] {
            for steps in [1, -1, -2, 2, 1, 1] {
                commands.push(ramp(steps, speed_hz, accel, shape));
            }
        }
    }
    let steps: usize = commands
        .iter()
        .map(|command| match command {
            Command::Ramp { steps, .. } => steps.unsigned_abs() as usize,
            _ => 0,
        })
        .sum();
    bench.order(commands);
    bench.run_to_rest();
    let life = bench.judged();
    assert_eq!(steps_of(&life, X).len(), steps);
    assert_eq!(bench.node.position_steps(X), 2 * 8 * 4);
}

#[test]
fn ways_of_all_the_steps_there_are_can_be_begun_and_stopped() {
    for (steps, mode) in [
        (i32::MAX, StopMode::Decelerate),
        (-i32::MAX, StopMode::Halt),
    ] {
        let to = |position_steps| Command::RampTo {
            axis: X,
            position_steps,
            ramp: Ramp {
                speed_hz: 1_000_000,
                accel_hz_per_s: 40_000_000,
                shape: trapezoid(0, 0),
            },
        };
        for command in [
            raw(X, steps, 1),
            ramp(steps, 1_000_000, u32::MAX, trapezoid(0, 0)),
            ramp(
                steps,
                900_000,
                9_000_000,
                RampShape::Jerk {
                    jerk_hz_per_s2: u32::MAX,
                },
            ),
            to(i64::from(steps) << 31),
            to(i64::MIN),
            to(i64::MAX),
        ] {
            let mut bench = Bench::new(config());
            bench.order([command]);
            bench.run_until(40_000);
            bench.stop(mode);
            bench.run_for(2_000_000);
            let life = bench.judged();
            let counted: i64 = steps_of(&life, X).iter().map(|step| step.1).sum();
            assert_eq!(bench.node.position_steps(X), counted, "{command:?}");
            assert!(counted.abs() > 500, "{command:?}: {counted}");
        }
    }
    // Positions are a ring: behind the last one comes the first.
    let mut bench = Bench::new(config());
    let name = Command::SetPosition {
        axis: X,
        position_steps: i64::MAX,
    };
    bench.order([
        name,
        raw(X, 5, 100),
        ramp(-3, 1_000, 1_000, trapezoid(0, 0)),
    ]);
    bench.run_to_rest();
    assert_eq!(
        bench.node.status().axes[0].position_steps,
        i64::MAX.wrapping_add(2)
    );
}

#[test]
fn a_stop_in_the_midst_of_a_turn_with_late_refills_keeps_every_step() {
    for mode in [StopMode::Halt, StopMode::Decelerate] {
        for at_us in (300..1_400).step_by(23) {
            let what = format!("{mode:?} at {at_us} µs");
            let mut config = config();
            config.rmt.refill_ticks_min = 1_600;
            config.rmt.refill_ticks_max = 1_600;
            let mut bench = Bench::new(config);
            let there_and_back = |index: i32| {
                let steps = if index % 2 == 0 {
                    3 + index
                } else {
                    -3 - index
                };
                [raw(X, steps, 10), raw(Y, -steps, 7)]
            };
            bench.order((0..40).flat_map(there_and_back));
            bench.run_until(at_us);
            bench.stop(mode);
            bench.run_for(300_000);
            let life = bench.judged();
            for axis in [X, Y] {
                let counted: i64 = steps_of(&life, axis).iter().map(|step| step.1).sum();
                assert_eq!(bench.node.position_steps(axis), counted, "{what}");
            }
            assert!(bench.node.status().faults.is_empty(), "{what}");
            bench.release();
            bench.order([raw(X, -5, 10), raw(Y, 4, 10), raw(X, 6, 10)]);
            bench.run_to_rest();
            bench.judged();
        }
    }
}

#[test]
fn orders_at_every_instant_of_a_drive_that_passes_lose_nothing() {
    let course = Course::hz(3_000, 60_000);
    for wait_us in (0..120_000).step_by(1_777) {
        let mut bench = Bench::new(config());
        let drive = |bench: &mut Bench, target, how| {
            let motion = bench.node.node_mut().motion_mut();
            motion.drive(X, target, how).expect("free");
        };
        drive(&mut bench, Target::To(150), course.passing_mhz(900_000));
        bench.run_for(wait_us);
        drive(&mut bench, Target::By(-40), course.passing_mhz(2_000_000));
        bench.run_for(wait_us / 3);
        drive(
            &mut bench,
            Target::Forever(Direction::Negative),
            course.passing_mhz(5),
        );
        bench.run_for(20_000);
        drive(&mut bench, Target::To(7), course);
        bench.run_for(3_000_000);
        let motion = bench.node.node_mut().motion_mut();
        assert!(!motion.is_driving(), "{wait_us}");
        assert_eq!(bench.node.position_steps(X), 7, "{wait_us}");
        let life = bench.node.life();
        let counted: i64 = steps_of(&life, X).iter().map(|step| step.1).sum();
        assert_eq!(counted, 7, "{wait_us}");
        emulator::oracle::check_pins(&life).expect("the pins are right");
    }
}
