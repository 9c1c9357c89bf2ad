//! Speeds in Hz, mHz, µs and ticks, as they are met at the pins; and what can be asked about an axis.

mod bench;

use bench::{
    Bench, config,
    motor::{HZ, steps_of},
};
use keys::{AxisId, Command, StopMode};
use motion::{AxisProfile, Course, Direction, Gait, Target};

const X: AxisId = AxisId(0);

#[test]
fn a_speed_in_any_unit_is_the_interval_at_the_pin() {
    for (course, ticks) in [
        (Course::hz(3_000, 2_000_000), 16e6_f64 / 3_000.0),
        (Course::mhz(1_234_567, 2_000_000), 16e9 / 1_234_567.0),
        (Course::mhz(1_500, 2_000_000), 16e6 / 1.5),
        (Course::interval_us(333, 2_000_000), 333.0 * 16.0),
        (Course::interval_ticks(1_333, 2_000_000), 1_333.0),
        (Course::interval_ticks(16, 4_000_000_000), 16.0),
    ] {
        let mut bench = Bench::new(config());
        let motion = bench.node.node_mut().motion_mut();
        motion.drive(X, Target::By(1_000), course).expect("free");
        assert_eq!(course.step_ticks(), ticks.round() as u64);
        let mhz = course.speed_mhz() as f64;
        assert!((mhz - 16e9 / ticks).abs() <= 0.5, "{mhz}");
        while bench.node.node_mut().motion_mut().is_driving() {
            bench.run_for(1_000_000);
        }
        let steps = steps_of(&bench.node.life(), X);
        assert_eq!(steps.len(), 1_000);
        // The middle, at full speed.
        let made = (steps[600].0 - steps[400].0) * HZ / 200.0;
        assert!(
            (made - ticks).abs() <= 2.0 / 200.0,
            "{made} of {ticks} ticks"
        );
    }
}

#[test]
fn the_greatest_speed_of_a_driver_is_told_and_can_be_gone() {
    for profile in [
        AxisProfile::default(),
        AxisProfile::dm556(),
        AxisProfile::drv8825(),
    ] {
        let mut config = config();
        config.motion.axes[0] = profile;
        let mut bench = Bench::new(config);
        let least = profile.step_ticks_min();
        assert_eq!(profile.speed_mhz_max(), 16_000_000_000 / least);
        let motion = bench.node.node_mut().motion_mut();
        let at = |ticks| Course::interval_ticks(ticks, 1_000_000);
        assert!(motion.drive(X, Target::By(100), at(least - 1)).is_err());
        assert!(motion.drive(X, Target::By(100), at(least)).is_ok());
    }
}

#[test]
fn an_axis_tells_what_it_does() {
    let mut bench = Bench::new(config());
    let course = Course::hz(2_000, 4_000);
    let told = |bench: &mut Bench| {
        let motion = bench.node.node_mut().motion_mut();
        (
            motion.gait(X),
            motion.accel_hz_per_s(X),
            motion.is_coming_to_rest(X),
        )
    };
    assert_eq!(told(&mut bench), (Gait::Rest, 0, false));
    let backward = Target::Forever(Direction::Negative);
    let motion = bench.node.node_mut().motion_mut();
    motion.drive(X, backward, course).expect("free");
    bench.run_for(100_000);
    // Towards negative values.
    assert_eq!(told(&mut bench), (Gait::Accelerate, -4_000, false));
    let motion = bench.node.node_mut().motion_mut();
    assert_eq!(motion.course(X), Some(course));
    assert_eq!(motion.target_position(X), None);
    assert!(motion.is_endless(X));
    bench.run_for(900_000);
    assert_eq!(told(&mut bench), (Gait::Coast, 0, false));
    let motion = bench.node.node_mut().motion_mut();
    motion.drive(X, Target::To(50), course).expect("free");
    assert_eq!(motion.target_position(X), Some(50));
    bench.run_for(100_000);
    assert_eq!(told(&mut bench), (Gait::Reverse, 4_000, false));
    bench.run_for(500_000);
    assert_eq!(told(&mut bench), (Gait::Accelerate, 4_000, false));
    bench.node.node_mut().motion_mut().end_drive_of(X);
    bench.run_for(20_000);
    assert_eq!(told(&mut bench), (Gait::Decelerate, -4_000, true));
    bench.run_for(5_000_000);
    assert_eq!(told(&mut bench), (Gait::Rest, 0, false));
    // Lines and raw moves, too.
    let at = bench.now.0;
    bench.order([Command::Line {
        steps: [-4_000, 1_000, 0, 0],
        speed_hz: 4_000,
        accel_hz_per_s: 8_000,
        jerk_hz_per_s2: 0,
    }]);
    bench.run_until(at + 250_000);
    assert_eq!(told(&mut bench), (Gait::Accelerate, -8_000, false));
    let motion = bench.node.node_mut().motion_mut();
    assert_eq!(motion.accel_hz_per_s(AxisId(1)), 2_000);
    let left = motion.planned_ticks();
    // 1.5 s in all.
    assert!((left as f64 / HZ - 1.25).abs() < 0.001, "{left}");
    bench.run_until(at + 1_250_000);
    assert_eq!(told(&mut bench), (Gait::Decelerate, 8_000, false));
    bench.run_to_rest();
    bench.order([Command::Move {
        axis: X,
        delay_us: 500,
        steps: 100_000,
    }]);
    bench.run_for(200_000);
    assert_eq!(told(&mut bench), (Gait::Coast, 0, false));
    bench.stop(StopMode::Decelerate);
    bench.run_for(5_000);
    assert_eq!(told(&mut bench), (Gait::Decelerate, -100_000, true));
    bench.run_for(1_000_000);
    assert_eq!(told(&mut bench), (Gait::Rest, 0, false));
}
