//! Changes in flight, at random instants: hold and resume, another speed, another target, a stop.
//! Judged by what any motor would demand: every step in order, no speed and no acceleration beyond
//! what was asked for, the position exact.

mod bench;

use bench::{
    Bench, config,
    motor::{HZ, Random, keeps_limits, seeds, steps_of},
};
use emulator::record::Life;
use keys::{
    AxisId, Command, LocalMicros, NodeState, StopMode,
    command::{Ramp, RampShape},
    status::FaultCode,
};
use motion::{Course, Direction, Motion, Target, Ticks};

const X: AxisId = AxisId(0);
const Y: AxisId = AxisId(1);

const TRAPEZOID: RampShape = RampShape::Trapezoid {
    linear_steps: 0,
    jump_steps: 0,
};

type InnerMotion<'m> = Motion<'m, emulator::pulse::VirtualRmt>;

fn ramp(axis: AxisId, steps: i32, speed_hz: u32, accel_hz_per_s: u32, shape: RampShape) -> Command {
    Command::Ramp {
        axis,
        steps,
        ramp: Ramp {
            speed_hz,
            accel_hz_per_s,
            shape,
        },
    }
}

impl Bench {
    fn motion(&mut self) -> &mut InnerMotion<'static> {
        self.node.node_mut().motion_mut()
    }

    fn hold(&mut self) {
        let now = Ticks(self.now.0 * 16);
        self.motion().hold(now);
    }

    fn position(&self, axis: AxisId) -> i64 {
        self.node.status().axes[usize::from(axis.0)].position_steps
    }
}

fn pins_are_right(bench: &Bench, what: &str) -> Life {
    let life = bench.node.life();
    for axis in [X, Y] {
        let counted: i64 = steps_of(&life, axis).iter().map(|step| step.1).sum();
        assert_eq!(bench.node.step_count(axis), counted, "{what}");
        assert_eq!(bench.position(axis), counted, "{what}");
    }
    if let Err(violations) = emulator::oracle::check_pins(&life) {
        panic!("{what}: {violations:?}");
    }
    life
}

#[test]
fn a_stop_with_deceleration_ends_on_the_path_where_it_should() {
    // 4000 Hz by 2000/s²: after 3 s at 8000 steps, then 2 s and 4000 steps, and what the hardware
    // held when the stop came: at most 2 ms.
    let mut bench = Bench::new(config());
    bench.order([ramp(X, 32_000, 4_000, 2_000, TRAPEZOID)]);
    bench.run_until(3_000_000);
    bench.stop(StopMode::Decelerate);
    bench.run_until(6_000_000);
    assert_eq!(bench.node.status().state, NodeState::Stopped);
    assert!(
        (12_000..=12_008).contains(&bench.position(X)),
        "{}",
        bench.position(X)
    );
    let life = pins_are_right(&bench, "");
    keeps_limits(&life, X, 4_000.0, 2_000.0, 0.0, "");
    let last = steps_of(&life, X).last().expect("steps").0;
    assert!((4.9..5.002).contains(&last), "{last}");
}

#[test]
fn a_held_path_rests_on_the_path_and_goes_on_to_its_end() {
    let mut bench = Bench::new(config());
    let line = Command::Line {
        steps: [800, 320, 0, 0],
        speed_hz: 4_000,
        accel_hz_per_s: 2_000,
        jerk_hz_per_s2: 0,
    };
    bench.order([line; 40]);
    bench.run_until(3_000_000);
    bench.hold();
    bench.run_until(6_000_000);
    assert!(bench.motion().is_held());
    assert_eq!(bench.node.status().state, NodeState::Paused);
    let held = [bench.position(X), bench.position(Y)];
    assert!((12_000..=12_008).contains(&held[0]), "{held:?}");
    assert!(
        (held[1] * 5 - held[0] * 2).abs() <= 5,
        "off the path: {held:?}"
    );
    let executed = bench.node.status().executed_commands;
    assert_eq!(executed, held[0] as u64 / 800);
    bench.run_until(60_000_000);
    assert_eq!(held, [bench.position(X), bench.position(Y)]);
    bench.motion().resume();
    bench.run_to_rest();
    assert_eq!([bench.position(X), bench.position(Y)], [32_000, 12_800]);
    let life = pins_are_right(&bench, "");
    keeps_limits(&life, X, 4_000.0, 2_000.0, 0.0, "");
    keeps_limits(&life, Y, 1_600.0, 800.0, 0.0, "");
    assert!(bench.node.status().faults.is_empty());
}

#[test]
fn another_target_and_another_speed_change_a_drive_in_flight() {
    // Target 3000, at 500 steps another 1000: no dip in speed, 1.85 s in all.
    let mut bench = Bench::new(config());
    let course = Course::hz(2_500, 10_000);
    bench
        .motion()
        .drive(X, Target::To(3_000), course)
        .expect("free");
    bench.run_until(325_000);
    bench
        .motion()
        .drive(X, Target::By(1_000), course)
        .expect("free");
    bench.run_until(4_000_000);
    assert_eq!(bench.position(X), 4_000);
    let life = pins_are_right(&bench, "");
    keeps_limits(&life, X, 2_500.0, 10_000.0, 0.0, "");
    // The last half step takes 10 ms; the first one began with the lead-in.
    let steps = steps_of(&life, X);
    let total = steps[steps.len() - 1].0 - steps[0].0 + 0.02;
    assert!((total - 1.85).abs() < 1e-6, "{total}");

    // At 500 steps and 1000 Hz back to 0: it turns at 1000, but for what the hardware held.
    let mut bench = Bench::new(config());
    let course = Course::hz(2_500, 1_000);
    bench
        .motion()
        .drive(X, Target::To(20_000), course)
        .expect("free");
    bench.run_until(1_000_000);
    bench
        .motion()
        .drive(X, Target::To(0), course)
        .expect("free");
    bench.run_until(8_000_000);
    assert_eq!(bench.position(X), 0);
    let life = pins_are_right(&bench, "");
    keeps_limits(&life, X, 2_500.0, 1_000.0, 0.0, "");
    let forward = steps_of(&life, X).iter().filter(|step| step.1 > 0).count();
    assert!((1_000..=1_004).contains(&forward), "{forward}");

    // Forward for 40 s.
    let mut bench = Bench::new(config());
    let forever = Target::Forever(Direction::Positive);
    bench
        .motion()
        .drive(X, forever, Course::hz(3_600, 320))
        .expect("free");
    bench.run_until(40_000_000);
    assert_eq!(bench.position(X), 123_750);
    // v²/2a, and what is made until then.
    assert!((20_250..=20_260).contains(&bench.motion().steps_to_stop()));
    bench.motion().end_drive(StopMode::Decelerate);
    bench.run_until(60_000_000);
    assert!(!bench.motion().is_driving());
    assert!((144_000..=144_008).contains(&bench.position(X)));
    pins_are_right(&bench, "");
}

#[test]
fn lines_that_arrive_while_the_last_one_moves_are_joined_without_loss_of_time() {
    for jerk_hz_per_s2 in [0, 80_000] {
        let line = Command::Line {
            steps: [800, 320, 0, 0],
            speed_hz: 4_000,
            accel_hz_per_s: 8_000,
            jerk_hz_per_s2,
        };
        let total_s = |arrives_us: Option<u64>| {
            let what = format!("jerk {jerk_hz_per_s2}, more at {arrives_us:?} µs");
            let mut bench = Bench::new(config());
            if let Some(arrives_us) = arrives_us {
                bench.order([line]);
                bench.run_until(arrives_us);
                bench.order([line; 11]);
            } else {
                bench.order([line; 12]);
            }
            bench.run_to_rest();
            assert_eq!(
                [bench.position(X), bench.position(Y)],
                [9_600, 3_840],
                "{what}"
            );
            let life = pins_are_right(&bench, &what);
            keeps_limits(&life, X, 4_000.0, 8_000.0, 0.0, &what);
            keeps_limits(&life, Y, 1_600.0, 3_200.0, 0.0, &what);
            let steps = steps_of(&life, X);
            steps[steps.len() - 1].0 - steps[0].0
        };
        let at_once_s = total_s(None);
        // While its speed rises as it would in any case; then while an S-curve begins to level out;
        // alone it would rest after 0.63 s or more.
        for (arrives_us, most_s) in [
            (20_000, 1e-5),
            (100_000, 1e-5),
            (150_000, 1e-5),
            (280_000, 0.03),
        ] {
            let later_s = total_s(Some(arrives_us));
            assert!(
                (-1e-5..most_s).contains(&(later_s - at_once_s)),
                "jerk {jerk_hz_per_s2}, more at {arrives_us} µs: {later_s} s, at once {at_once_s} s"
            );
        }
    }
}

#[test]
fn a_smoothstep_drive_has_every_edge_where_its_curve_says() {
    for (start_hz, speed_hz, ramp_steps, way) in [
        // ESP-IDF's example: 4.48357742 s.
        (500_u32, 1_500_u32, 500_u32, 6_000_i64),
        (100, 150_000, 8_000, 40_000),
        (1_000, 30_000, 700, 901),
        (20, 21, 2, 7),
    ] {
        let what = format!("{start_hz} to {speed_hz} Hz over {ramp_steps}, {way} steps");
        let mut bench = Bench::new(config());
        let course = Course::smooth(start_hz, speed_hz, ramp_steps);
        bench
            .motion()
            .drive(X, Target::By(way), course)
            .expect("free");
        bench.run_until(6_000_000);
        assert!(!bench.motion().is_driving(), "{what}");
        let life = pins_are_right(&bench, &what);
        let steps = steps_of(&life, X);
        assert_eq!(steps.len() as i64, way, "{what}");
        // The time of each step's halves by the midpoint rule in 64 parts, from both ends.
        let (start, gain) = (f64::from(start_hz), f64::from(speed_hz - start_hz));
        let speed = |place: f64| {
            let near = place.min(way as f64 - place);
            let x = ((near - 0.5) / f64::from(ramp_steps - 1)).clamp(0.0, 1.0);
            start + gain * x * x * (3.0 - 2.0 * x)
        };
        let mut due = 0.0;
        for (index, step) in steps.iter().enumerate().skip(1) {
            for part in 0..64 {
                let place = index as f64 - 0.5 + (f64::from(part) + 0.5) / 64.0;
                due += 1.0 / speed(place) / 64.0;
            }
            let error = (step.0 - steps[0].0 - due) * HZ;
            assert!(
                error.abs() < 1.5,
                "{what}: step {index} is {error} ticks late"
            );
        }
        if way == 6_000 {
            let total = steps[steps.len() - 1].0 - steps[0].0 + 0.002;
            assert!((total - 4.483_577_42).abs() < 1e-7, "{total} s");
        }
    }
    // It comes to rest by its own curve, from wherever it is.
    for stop_us in [3_000, 60_000, 130_000, 300_000] {
        let mut bench = Bench::new(config());
        let course = Course::smooth(200, 20_000, 900);
        let forever = Target::Forever(Direction::Negative);
        bench.motion().drive(X, forever, course).expect("free");
        bench.run_until(stop_us);
        bench.motion().end_drive(StopMode::Decelerate);
        bench.run_until(3_000_000);
        assert!(!bench.motion().is_driving(), "{stop_us}");
        let life = pins_are_right(&bench, "");
        let steps = steps_of(&life, X);
        let (first, last) = (
            steps[1].0 - steps[0].0,
            steps[steps.len() - 1].0 - steps[steps.len() - 2].0,
        );
        assert!(
            (first / last - 1.0).abs() < 0.05,
            "{stop_us}: from {first} s to {last} s"
        );
    }
    let nothing = [
        Course::smooth(0, 1_000, 10),
        Course::smooth(1_000, 1_000, 10),
        Course::smooth(10, 1_000, 1),
    ];
    for course in nothing {
        let mut bench = Bench::new(config());
        let refused = bench.motion().drive(X, Target::By(10), course);
        assert!(refused.is_err(), "{course:?}");
    }
}

#[test]
fn a_change_takes_effect_within_two_milliseconds() {
    for speed_hz in [10_u32, 300, 5_000, 100_000] {
        let mut bench = Bench::new(config());
        let course = Course::hz(speed_hz, 1_000_000);
        let forever = Target::Forever(Direction::Positive);
        bench.motion().drive(X, forever, course).expect("free");
        bench.run_until(1_000_000);
        let before = bench.position(X);
        bench.motion().end_drive(StopMode::Decelerate);
        bench.run_until(3_000_000);
        let slowing = f64::from(speed_hz) * f64::from(speed_hz) / 2e6;
        let made = (bench.position(X) - before) as f64;
        let most = slowing + f64::from(speed_hz) * 0.002 + 2.0;
        assert!(made <= most, "{speed_hz} Hz: {made} steps of {most}");
    }
}

#[test]
fn raw_moves_tell_the_way_that_their_stop_takes() {
    // v²/2a, and what the hardware holds; or what is left of the queue.
    for (delay_us, steps, least, most) in [
        (100_u32, 5_000, 500, 521),
        (20, 100_000, 12_500, 12_549),
        (20, 5_000, 1_900, 2_100),
        (4_000, 100, 0, 1),
    ] {
        let mut bench = Bench::new(config());
        bench.order([Command::Move {
            axis: Y,
            delay_us,
            steps: -steps,
        }]);
        bench.run_until(60_000);
        let (way, before) = (bench.motion().steps_to_stop(), bench.position(Y));
        assert!((least..=most).contains(&way), "{delay_us} µs: {way}");
        bench.stop(StopMode::Decelerate);
        bench.run_until(70_000);
        let (left, here) = (bench.motion().steps_to_stop(), bench.position(Y));
        bench.run_until(3_000_000);
        // The stop computes with whole mHz, rounded down.
        for (from, way) in [(before, way), (here, left)] {
            let made = from.abs_diff(bench.position(Y));
            assert!(
                (made..=made + 1 + made / 2_000).contains(&way),
                "{delay_us} µs: {made}, told {way}"
            );
        }
        assert_eq!(bench.motion().steps_to_stop(), 0, "it rests");
    }
}

#[test]
fn any_number_of_changes_at_one_instant_or_in_quick_succession_is_taken() {
    for wait_us in [0, 1, 130] {
        let mut bench = Bench::new(config());
        let line = Command::Line {
            steps: [4_000, 1_000, 0, 0],
            speed_hz: 100_000,
            accel_hz_per_s: 1_000_000,
            jerk_hz_per_s2: 0,
        };
        bench.order([line; 20]);
        bench.run_until(60_000);
        for percent in 0..300 {
            bench.motion().set_speed_percent(50 + percent % 50);
            bench.run_for(wait_us);
        }
        bench.run_to_rest();
        assert_eq!([bench.position(X), bench.position(Y)], [80_000, 20_000]);
        let life = pins_are_right(&bench, "");
        keeps_limits(&life, X, 100_000.0, 1_000_000.0, 0.0, "");
    }
}

#[test]
fn a_speed_that_is_told_before_a_ramp_begins_is_that_of_the_ramp() {
    // It is planned before the pause has ended, and cannot be changed before it begins.
    let mut bench = Bench::new(config());
    bench.order([
        Command::Pause { pause_ms: 60 },
        ramp(X, 600, 3_000, 20_000, TRAPEZOID),
        Command::Line {
            steps: [500, 300, 0, 0],
            speed_hz: 3_000,
            accel_hz_per_s: 20_000,
            jerk_hz_per_s2: 0,
        },
    ]);
    bench.run_until(1_000);
    for percent in [66, 20] {
        bench.motion().set_speed_percent(percent);
        bench.run_for(0);
    }
    bench.run_to_rest();
    let life = pins_are_right(&bench, "");
    keeps_limits(&life, X, 600.0, 20_000.0, 0.0, "");
    emulator::oracle::check_life(&life).expect("good pulses");
}

#[test]
fn random_paths_with_random_holds_speeds_and_stops_keep_every_promise() {
    for seed in seeds(120) {
        let mut random = Random(seed);
        let speed_hz = 50 + random.of_size(14) as u32;
        let accel = 100 + random.of_size(17) as u32;
        let shape = match random.below(3) {
            0 => RampShape::Jerk {
                jerk_hz_per_s2: accel.saturating_mul(1 + random.below(50) as u32),
            },
            1 => RampShape::Trapezoid {
                linear_steps: random.below(300) as u16,
                jump_steps: 0,
            },
            _ => TRAPEZOID,
        };
        let what = format!("seed {seed}, {speed_hz} Hz, {accel}, {shape:?}");
        let mut bench = Bench::new(config());
        let mut end = [0_i64; 2];
        let lines = random.below(2) == 0;
        let commands: Vec<_> = (0..1 + random.below(20))
            .map(|_| {
                let mut way = || (random.of_size(9) as i32) - 200;
                let steps = [way() | 1, way()];
                if lines {
                    end[0] += i64::from(steps[0]);
                    end[1] += i64::from(steps[1]);
                    return Command::Line {
                        steps: [steps[0], steps[1], 0, 0],
                        speed_hz,
                        accel_hz_per_s: accel,
                        jerk_hz_per_s2: match shape {
                            RampShape::Jerk { jerk_hz_per_s2 } => jerk_hz_per_s2,
                            RampShape::Trapezoid { .. } | RampShape::Smooth { .. } => 0,
                        },
                    };
                }
                end[0] += i64::from(steps[0]);
                ramp(X, steps[0], speed_hz, accel, shape)
            })
            .collect();
        bench.order(commands);
        let mut stopped = false;
        for _ in 0..random.below(6) {
            bench.run_for(random.of_size(20));
            let op = random.below(6);
            match op {
                0 | 1 => bench.hold(),
                2 => bench.motion().resume(),
                3 | 4 => {
                    let percent = 5 + random.below(96) as u16;
                    bench.motion().set_speed_percent(percent);
                }
                _ => {
                    stopped = true;
                    let halt = random.below(2) == 0;
                    bench.stop(if halt {
                        StopMode::Halt
                    } else {
                        StopMode::Decelerate
                    });
                    break;
                }
            }
        }
        bench.motion().set_speed_percent(100);
        bench.motion().resume();
        if stopped {
            bench.run_for(20_000_000);
            assert_eq!(bench.node.status().state, NodeState::Stopped, "{what}");
        } else {
            bench.run_to_rest();
            assert_eq!([bench.position(X), bench.position(Y)], end, "{what}");
        }
        let life = pins_are_right(&bench, &what);
        if let Err(violations) = emulator::oracle::check_life(&life) {
            panic!("{what}: {violations:#?}");
        }
        // Corners may jump; an S-curve that is changed in flight first ends its acceleration.
        let jump = if lines { 200.0 } else { 0.0 };
        for axis in [X, Y] {
            keeps_limits(
                &life,
                axis,
                f64::from(speed_hz),
                f64::from(accel),
                jump,
                &what,
            );
        }
        assert!(bench.node.status().faults.is_empty(), "{what}");
    }
}

#[test]
fn random_drives_with_random_changes_end_where_they_were_sent_last() {
    for seed in seeds(120) {
        let mut random = Random(seed ^ 0xd1ce);
        let accel_max = 200 + random.of_size(17) as u32;
        let speed_max = 50 + random.of_size(14) as u32;
        let what = format!("seed {seed}, {speed_max} Hz, {accel_max}");
        let mut bench = Bench::new(config());
        let mut target = 0_i64;
        for _ in 0..1 + random.below(8) {
            let speed_hz = 1 + random.below(u64::from(speed_max)) as u32;
            let accel = 100 + random.below(u64::from(accel_max) - 99) as u32;
            let mut course = Course::hz(speed_hz, accel);
            if random.below(2) == 0 {
                course = course.shaped(RampShape::Jerk {
                    jerk_hz_per_s2: accel.saturating_mul(1 + random.below(50) as u32),
                });
            }
            target = random.of_size(12) as i64 - 2_000;
            let status = bench.node.status();
            bench
                .motion()
                .drive(X, Target::To(target), course)
                .unwrap_or_else(|error| panic!("{what}: {error} {status:?}"));
            bench.run_for(random.of_size(20));
        }
        bench
            .motion()
            .drive(X, Target::To(target), Course::hz(speed_max, accel_max))
            .expect("free");
        let mut waits = 0;
        while bench.motion().is_driving() {
            bench.run_for(100_000);
            waits += 1;
            assert!(waits < 10_000, "{what}: it never ends");
        }
        assert_eq!(bench.position(X), target, "{what}");
        let life = pins_are_right(&bench, &what);
        let (speed, accel) = (f64::from(speed_max), f64::from(accel_max));
        keeps_limits(&life, X, speed, accel, 0.0, &what);
    }
}

#[test]
fn a_planner_that_is_held_up_for_15_ms_changes_nothing() {
    let run = |plan_ticks_max: u64| {
        let mut config = config();
        config.rmt.plan_ticks_max = plan_ticks_max;
        let mut bench = Bench::new(config);
        let ramped = ramp(X, -30_000, 40_000, 100_000, TRAPEZOID);
        let line = Command::Line {
            steps: [500, 400, 0, 0],
            speed_hz: 20_000,
            accel_hz_per_s: 50_000,
            jerk_hz_per_s2: 0,
        };
        bench.order([ramped].into_iter().chain([line; 50]));
        bench.run_to_rest();
        let life = bench.judged();
        [steps_of(&life, X), steps_of(&life, Y)]
    };
    assert!(run(0) == run(15_000 * 16));
}

#[test]
fn a_planner_that_comes_too_late_is_a_fault_and_costs_no_step() {
    let mut config = config();
    config.rmt.plan_ticks_max = 10_000_000 * 16;
    let mut bench = Bench::new(config);
    // So slow a ramp needs more segments than the ring holds.
    bench.order([ramp(X, 1_000_000, 20_000, 100, TRAPEZOID)]);
    bench.run_until(300_000_000);
    let status = bench.node.status();
    assert_eq!(status.state, NodeState::Fault);
    assert_eq!(
        status.faults.last().map(|fault| fault.code),
        Some(FaultCode::PLAN_LATE)
    );
    let made = bench.position(X);
    assert!(made > 0);
    pins_are_right(&bench, "");
    // Nothing goes on by itself.
    bench.run_until(400_000_000);
    assert_eq!(bench.position(X), made);
}

#[test]
fn a_ledger_and_a_counter_that_disagree_are_a_fault_that_names_both() {
    let mut bench = Bench::new(config());
    bench.order([ramp(X, 1_000, 5_000, 20_000, TRAPEZOID)]);
    bench.run_until(50_000);
    bench.motion().backend_mut().disturb_counter(X, -1);
    let mut lines = Vec::new();
    for ms in 50..1_000 {
        let now = LocalMicros(ms * 1_000);
        bench.node.poll(now);
        let told = bench.node.outbox(now);
        lines.extend(
            told.iter()
                .map(|out| String::from_utf8_lossy(&out.payload).into_owned()),
        );
    }
    let status = bench.node.status();
    assert_eq!(status.state, NodeState::Fault);
    let code = status.faults.last().map(|fault| fault.code);
    assert_eq!(code, Some(FaultCode::COUNT_MISMATCH));
    assert_eq!(status.axes[0].position_steps, 1_000);
    let told = "axis 0: 1000 steps in the ledger, 999 counted at the pin";
    assert!(lines.iter().any(|line| line.contains(told)), "{lines:?}");
}
