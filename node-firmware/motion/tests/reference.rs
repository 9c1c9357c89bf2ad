//! The reference cases: durations, edges and speeds of ideal moves, from closed forms and from
//! what LinuxCNC, FastAccelStepper's documentation and ruckig give for them.

use keys::command::RampShape;
use motion::{
    law::{Law, speed_from_hz, speed_from_mhz},
    limits::TICK_HZ,
    path::{Path, State, TooShort},
    real::Real,
};

const HZ: f64 = TICK_HZ as f64;

const TRAPEZOID: RampShape = RampShape::Trapezoid {
    linear_steps: 0,
    jump_steps: 0,
};

fn linear(linear_steps: u16) -> RampShape {
    RampShape::Trapezoid {
        linear_steps,
        jump_steps: 0,
    }
}

fn jerk(jerk_hz_per_s2: u32) -> RampShape {
    RampShape::Jerk { jerk_hz_per_s2 }
}

/// The seeds of a property: so many, or what the environment's `SEEDS` says: as many, or from one to
/// before another (`453..454`).
fn seeds(usual: u64) -> std::ops::Range<u64> {
    let Ok(seeds) = std::env::var("SEEDS") else {
        return 0..usual;
    };
    let number = |text: &str| {
        text.parse()
            .expect("SEEDS is a number, or two with .. between")
    };
    match seeds.split_once("..") {
        Some((from, to)) => number(from)..number(to),
        None => 0..number(&seeds),
    }
}

/// Numbers below a bound, from a seed (xorshift).
fn numbers(seed: u64) -> impl FnMut(u64) -> u64 {
    let mut state = (seed + 1).wrapping_mul(0x9e37_79b9_7f4a_7c15) | 1;
    move |below| {
        state ^= state << 13;
        state ^= state >> 7;
        state ^= state << 17;
        state % below
    }
}

fn double(value: Real) -> f64 {
    let bits = if value < Real::of(1 << 31) { 30 } else { 14 };
    value.fixed(bits) as f64 / f64::from(1 << bits)
}

fn ideal(steps: u64, speed_hz: u32, accel: u32, shape: RampShape) -> Path {
    from_speed(steps, Real::ZERO, speed_hz, accel, shape)
}

fn from_speed(steps: u64, speed: Real, speed_hz: u32, accel: u32, shape: RampShape) -> Path {
    let begin = State {
        speed,
        ..State::REST
    };
    let law = Law::new(accel, shape);
    let speed_max = speed_from_hz(speed_hz);
    Path::plan(begin, Real::of(steps), Real::ZERO, speed_max, &law).expect("a whole move")
}

fn seconds(path: &Path) -> f64 {
    double(path.ticks()) / HZ
}

fn edge_ms(path: &Path, number: u64) -> f64 {
    double(path.ticks_at(Real::of(2 * number - 1).half())) / HZ * 1e3
}

#[track_caller]
fn lasts(path: &Path, expected_s: f64) {
    let found_s = seconds(path);
    // The cases give their figures with 6 to 10 decimals.
    assert!(
        (found_s - expected_s).abs() <= 1.0 / HZ + 5e-7,
        "{found_s} s instead of {expected_s} s"
    );
}

#[test]
fn constant_acceleration_takes_the_time_of_the_closed_form() {
    for (steps, speed_hz, accel, expected_s) in [
        (1_000, 500, 100, 6.324_555_320),
        (2_600, 500, 100, 10.2),
        (2_500, 500, 100, 10.0),
        (15_000, 10_000, 10_000, 2.5),
        (32_000, 4_000, 2_000, 10.0),
        (32_000, 6_400, 1_280, 10.0),
        (256_000, 25_000, 5_000, 15.24),
        (128_000, 4_000, 1_000, 36.0),
        (72_000, 4_000, 1_000, 22.0),
        (44_000, 4_000, 1_000, 15.0),
        (16_040, 4_000, 1_000, 8.01),
        (1_600, 20_000, 10_000, 0.8),
        (1_000, 50_000, 1_000, 2.0),
        (500, 250, 5, 20.0),
        (2_000, 250, 5, 40.0),
        (12_600, 250, 5, 100.4),
        (16_500, 250, 5, 116.0),
        (100, 25_000, 1, 20.0),
        (1, 25_000, 1_000, 0.063_245_553),
        (2, 1_000, 100, 0.282_842_712),
        (1_280, 4_800, 64_000, 0.341_666_667),
        (160, 500, 1_000, 0.8),
    ] {
        lasts(&ideal(steps, speed_hz, accel, TRAPEZOID), expected_s);
    }
}

#[test]
fn edges_lie_in_the_middle_of_their_steps() {
    let seed = ideal(1_000, 500, 100, TRAPEZOID);
    let fast = ideal(15_000, 10_000, 10_000, TRAPEZOID);
    let linuxcnc = ideal(1_280, 4_800, 64_000, TRAPEZOID);
    for (path, number, expected_ms) in [
        (&seed, 1, 100.0),
        (&seed, 2, 173.205),
        (&seed, 10, 435.890),
        (&seed, 100, 1_410.674),
        (&seed, 500, 3_160.696),
        (&seed, 501, 3_163.859),
        (&seed, 999, 6_151.350),
        (&seed, 1_000, 6_224.555),
        (&fast, 1, 10.0),
        (&fast, 2, 17.321),
        (&fast, 5_000, 999.950),
        (&fast, 5_001, 1_000.050),
        (&fast, 7_500, 1_249.950),
        (&fast, 10_000, 1_499.950),
        (&fast, 14_999, 2_482.679),
        (&fast, 15_000, 2_490.0),
        (&linuxcnc, 1, 3.953),
        (&linuxcnc, 2, 6.847),
        (&linuxcnc, 3, 8.839),
        (&linuxcnc, 4, 10.458),
        (&linuxcnc, 5, 11.859),
        (&linuxcnc, 10, 17.230),
        (&linuxcnc, 640, 170.729),
        (&linuxcnc, 1_271, 324.437),
        (&linuxcnc, 1_279, 334.820),
        (&linuxcnc, 1_280, 337.714),
    ] {
        let found_ms = edge_ms(path, number);
        assert!(
            (found_ms - expected_ms).abs() <= 0.000_51,
            "edge {number}: {found_ms} instead of {expected_ms}"
        );
    }
}

#[test]
fn edges_of_the_longest_moves_are_right_to_a_hundredth_of_a_tick() {
    for (steps, speed_hz, accel) in [
        (1_000_u64, 500, 100),
        (3_000_000, 200_000, 1_000_000),
        (2_000_000_000, 1_000_000, 1),
        (1_u64 << 33, 400_000, u32::MAX),
        (255, 20_000, i32::MAX as u32),
    ] {
        let path = ideal(steps, speed_hz, accel, TRAPEZOID);
        let (v, a, n) = (f64::from(speed_hz), f64::from(accel), steps as f64);
        let coasts = n * a >= v * v;
        let ramp = if coasts { v * v / a / 2.0 } else { n / 2.0 };
        for number in [1_u64, 2, 3, 10, 1_000, steps / 3, steps / 2] {
            if number == 0 || 2 * number > steps {
                continue;
            }
            let s = number as f64 - 0.5;
            // Seen from the slow end on both sides, where the closed form is exact.
            let near = if s <= ramp {
                (2.0 * s / a).sqrt()
            } else {
                v / (2.0 * a) + s / v
            } * HZ;
            let there = double(path.ticks_at(Real::of(2 * number - 1).half()));
            assert!(
                (there - near).abs() <= 0.01 + near * 2e-16,
                "{steps} {number}"
            );
            let mirrored = Real::of(2 * steps) - Real::of(2 * number - 1);
            let back = double(path.ticks() - path.ticks_at(mirrored.half()));
            assert!(
                (back - near).abs() <= 0.01 + near * 4e-16,
                "{steps} {number} from the end: {back} {near}"
            );
        }
    }
}

#[test]
fn the_way_to_stop_is_the_square_of_the_speed_over_twice_the_acceleration() {
    for (speed_hz, accel, expected_steps) in [
        (500, 100, 1_250),
        (4_000, 2_000, 4_000),
        (10_000, 10_000, 5_000),
        (200_000, 1_000_000, 20_000),
    ] {
        let law = Law::new(accel, TRAPEZOID);
        let way = law.way(Real::ZERO, speed_from_hz(speed_hz));
        assert_eq!(way.rounded(), expected_steps);
    }
}

#[test]
fn a_stop_in_flight_ends_where_it_should() {
    // 4000 Hz by 2000/s²: after 3 s at 8000 steps, it takes 2 s and 4000 steps.
    let law = Law::new(2_000, TRAPEZOID);
    let mut path = ideal(32_000, 4_000, 2_000, TRAPEZOID);
    path.cut(Real::of(3 * TICK_HZ));
    path.come_to_rest(&law);
    lasts(&path, 5.0);
    assert_eq!(path.end_steps().shifted(20).rounded(), 12_000 << 20);
}

#[test]
fn speed_and_target_change_in_flight_without_a_stop() {
    let law = Law::new(1_000, TRAPEZOID);
    // At 5000 steps of 20,000 the speed rises from 2500 to 3333.333 Hz.
    let mut path = ideal(20_000, 2_500, 1_000, TRAPEZOID);
    path.cut(path.ticks_at(Real::of(5_000)));
    let faster = speed_from_mhz(3_333_333);
    path.go_on(Real::of(20_000), Real::ZERO, faster, &law)
        .expect("room");
    lasts(&path, 9.520_833);
    // And down to 2000 Hz.
    let mut path = ideal(20_000, 2_500, 1_000, TRAPEZOID);
    path.cut(path.ticks_at(Real::of(5_000)));
    path.go_on(Real::of(20_000), Real::ZERO, speed_from_hz(2_000), &law)
        .expect("room");
    lasts(&path, 11.687_5);
    // At 500 steps the target moves from 3000 to 4000.
    let law = Law::new(10_000, TRAPEZOID);
    let mut path = ideal(3_000, 2_500, 10_000, TRAPEZOID);
    path.cut(path.ticks_at(Real::of(500)));
    path.go_on(Real::of(4_000), Real::ZERO, speed_from_hz(2_500), &law)
        .expect("room");
    lasts(&path, 1.85);
    // Back to 0 from 500 steps at 1000 Hz: there is no way to do that without turning.
    let law = Law::new(1_000, TRAPEZOID);
    let mut path = ideal(20_000, 2_500, 1_000, TRAPEZOID);
    path.cut(path.ticks_at(Real::of(500)));
    let kept = path;
    let refused = path.go_on(Real::of(500), Real::ZERO, speed_from_hz(2_500), &law);
    assert_eq!(refused, Err(TooShort));
    assert_eq!(path.ticks(), kept.ticks());
    path.come_to_rest(&law);
    assert_eq!(path.end_steps().shifted(20).rounded(), 1_000 << 20);
    lasts(&path, 2.0);
}

#[test]
fn linear_acceleration_and_jump_start_are_those_of_fast_accel_stepper() {
    // Speed at the end of the linear part: √(1.5·a·s_h), after √(6·s_h/a).
    for (accel, linear_steps, speed_hz, after_s) in [
        (10_000, 1_000, 3_872.983_3, 0.774_597),
        (10_000, 100, 1_224.744_9, 0.244_949),
        (1_000, 50, 273.861_3, 0.547_723),
    ] {
        let path = ideal(1_000_000, 100_000, accel, linear(linear_steps));
        let at = path.ticks_at(Real::of(u64::from(linear_steps)));
        assert!((double(at) / HZ - after_s).abs() < 1e-6);
        let found_hz = double(path.state_at(at).speed * Real::of(TICK_HZ));
        assert!((found_hz - speed_hz).abs() < 1e-3, "{found_hz}");
    }
    for (linear_steps, jump_steps, speed_hz) in [
        (0, 100, 1_414.213_6),
        (0, 1, 141.421_4),
        (1_000, 100, 834.409_0),
        (1_000, 1_000, 3_872.983_3),
        (1_000, 2_000, 5_916.079_8),
    ] {
        let law = Law::new(10_000, linear(linear_steps));
        let found_hz = double(law.jump_speed(Real::of(jump_steps)) * Real::of(TICK_HZ));
        assert!((found_hz - speed_hz).abs() < 1e-3, "{found_hz}");
    }
    lasts(&ideal(15_000, 10_000, 10_000, linear(1_000)), 3.224_597);
    let law = Law::new(10_000, TRAPEZOID);
    let jump = law.jump_speed(Real::of(100));
    let path = from_speed(15_000, jump, 10_000, 10_000, TRAPEZOID);
    lasts(&path, 2.368_579);
    let law = Law::new(10_000, linear(1_000));
    let jump = law.jump_speed(Real::of(100));
    let path = from_speed(15_000, jump, 10_000, 10_000, linear(1_000));
    lasts(&path, 2.875_061);
}

#[test]
fn s_curves_are_those_of_the_closed_form_and_of_ruckig() {
    for (steps, speed_hz, accel, jerk_hz, expected_s) in [
        (1, 1, 1, 1, 3.174_802_103_9),
        (2, 1, 1, 1, 4.0),
        (3, 1, 1, 1, 5.0),
        (32_000, 4_000, 8_000, 80_000, 8.6),
        (1_000, 1_000, 10_000, 100_000, 1.2),
        (10_000, 5_000, 20_000, 400_000, 2.3),
        (100, 5_000, 20_000, 400_000, 0.2),
    ] {
        lasts(&ideal(steps, speed_hz, accel, jerk(jerk_hz)), expected_s);
    }
    let path = ideal(32_000, 4_000, 8_000, jerk(80_000));
    let early = path.state_at(Real::of(TICK_HZ / 10));
    assert!((double(early.place) - 13.333_333).abs() < 1e-6);
    assert!((double(early.speed * Real::of(TICK_HZ)) - 400.0).abs() < 1e-6);
    let risen = path.state_at(Real::of(TICK_HZ * 6 / 10));
    assert!((double(risen.place) - 1_200.0).abs() < 1e-6);
    let unit = ideal(1, 1, 1, jerk(1));
    let middle = unit.state_at(unit.ticks().half());
    assert!((double(middle.place) - 0.5).abs() < 1e-8);
    assert!((double(middle.speed * Real::of(TICK_HZ)) - 0.629_961).abs() < 1e-6);
}

/// Speed, acceleration and jerk by differences; place by the sum of speeds.
#[test]
fn random_paths_keep_their_limits_and_pass_every_place_when_they_say() {
    for case in seeds(3_000) {
        let mut next = numbers(case);
        let mut of_size = |bits: u64| {
            let size = 1 + next(bits);
            1 + next(1 << size)
        };
        let steps = of_size(20);
        let speed_hz = of_size(18) as u32;
        let accel = of_size(22) as u32;
        let jerk_hz = of_size(26) as u32;
        let shape = match next(3) {
            0 => TRAPEZOID,
            1 => linear(1 + next(2_000) as u16),
            _ => jerk(jerk_hz),
        };
        let law = Law::new(accel, shape);
        let mut path = ideal(steps, speed_hz, accel, shape);
        if next(3) == 0 {
            let at = path.ticks() * Real::of(next(1_000)) / Real::of(1_000);
            path.cut(at);
            if next(2) == 0 {
                path.come_to_rest(&law);
            } else {
                let slower = speed_from_hz(1 + speed_hz / 2);
                let _ = path.go_on(Real::of(steps), Real::ZERO, slower, &law);
            }
        }
        let what = format!("case {case}: {steps} {speed_hz} {accel} {shape:?}");
        let speed_max = double(speed_from_hz(speed_hz).shifted(30)) * 1.001 + 1e-6;
        let accel_max = double(law.accel().shifted(60)) * 1.001;
        let parts = 200_u64;
        let mut before = path.state_at(Real::ZERO);
        for part in 1..=parts {
            let at = path.ticks() * Real::of(part) / Real::of(parts);
            let found = path.state_at(at);
            assert!(found.place >= before.place, "{what}");
            // The limits of an S-curve hold unless a change in flight has to end its acceleration.
            let speed = double(found.speed.shifted(30));
            assert!(speed <= speed_max, "{what}: speed {speed} > {speed_max}");
            let accel = double(found.accel.abs().shifted(60));
            assert!(accel <= accel_max, "{what}: {accel} > {accel_max}");
            if !found.speed.is_none() && !(found.place - before.place).is_none() {
                let again = path.ticks_at(found.place);
                let off = double((again - at).abs());
                // At rest the time of a place is not sharp.
                let slack = 0.05 + double(found.place.shifted(-40) / found.speed);
                let slack = slack + double(at.shifted(-30));
                assert!(off <= slack, "{what}: {part} {off} > {slack}");
            }
            before = found;
        }
    }
}

#[test]
fn a_braking_that_began_by_another_law_never_turns_the_motion_round() {
    let hard = Law::new(100_000, jerk(10_000_000));
    let soft = Law::new(1_000, jerk(1_000));
    for part in 1..100 {
        let mut path = ideal(1_000, 5_000, 100_000, jerk(10_000_000));
        path.cut(path.ticks() * Real::of(part) / Real::of(100));
        let (place, ticks) = (path.end_steps(), path.ticks());
        path.come_to_rest(&soft);
        assert!(path.end_steps() >= place, "{part}");
        let mut before = place;
        for more in 0..=100 {
            let at = ticks + (path.ticks() - ticks) * Real::of(more) / Real::of(100);
            let found = path.state_at(at).place;
            assert!(found + Real::of(1).shifted(-20) >= before, "{part} {more}");
            before = found;
        }
        assert!(path.end_state().speed <= hard.accel(), "{part}");
    }
}

#[test]
fn a_stop_that_comes_while_an_s_curve_brakes_changes_nothing() {
    let law = Law::new(10_000, jerk(100_000));
    let whole = ideal(200, 1_000, 10_000, jerk(100_000));
    let mut braking = 0;
    for part in 1..200 {
        let mut path = whole;
        path.cut(path.ticks() * Real::of(part) / Real::of(200));
        let accel = path.end_state().accel;
        path.come_to_rest(&law);
        let early = double(whole.end_steps() - path.end_steps());
        assert!(early > -1e-6, "{part}: {early}");
        if accel.is_negative() {
            braking += 1;
            assert!(early.abs() < 1e-6, "{part}: {early}");
            assert!(double((path.ticks() - whole.ticks()).abs()) < 1.0, "{part}");
        }
    }
    assert!(braking > 50);
}

#[test]
fn the_smoothstep_takes_the_time_of_its_table_and_has_its_speeds() {
    // ESP-IDF's example: 500 frequencies from 500 to 1500 Hz, 5000 steps, and back.
    let (start, end) = (speed_from_hz(500), speed_from_hz(1_500));
    let law = Law::smooth(start, end, 500);
    let whole = |steps: u64| {
        Path::plan(State::REST, Real::of(steps), Real::ZERO, end, &law).expect("a whole move")
    };
    let path = whole(6_000);
    let share = |index: u32| f64::from(index) / 499.0;
    let frequency =
        |index: u32| 500.0 + 1_000.0 * share(index).powi(2) * (3.0 - 2.0 * share(index));
    let table: f64 = (0..500).map(|index| 1.0 / frequency(index)).sum();
    assert!((table - 0.575_122_04).abs() < 1e-8, "{table}");
    let rise = double(path.ticks_at(Real::of(500))) / HZ;
    assert!(
        (rise - table).abs() < 0.5 / HZ,
        "{rise} s instead of {table} s"
    );
    lasts(&path, 4.483_577_42);
    for (index, period_us) in [
        (0, 2_000.0),
        (1, 1_999.951_9),
        (100, 1_654.574_3),
        (249, 1_001.505_3),
        (250, 998.499_3),
        (374, 744.498_5),
        (498, 666.672),
    ] {
        let at = path.ticks_at(Real::of(2 * index + 1).half());
        let found_us =
            1e6 / HZ / path.state_at(at).speed.shifted(40).rounded() as f64 * 40.0_f64.exp2();
        assert!(
            (found_us - period_us).abs() < 1e-4,
            "step {index}: {found_us} µs"
        );
    }
    // A part of the table and its mirror image; one step at the first frequency.
    let part: f64 = (0..150).map(|index| 2.0 / frequency(index)).sum();
    let found = seconds(&whole(300));
    assert!(
        (found / part - 1.0).abs() < 1e-5,
        "{found} s, about {part} s"
    );
    lasts(&whole(1), 0.002);
    lasts(&whole(2), 0.004);
}

#[test]
fn a_smoothstep_slows_down_to_rest_from_everywhere() {
    let law = Law::smooth(speed_from_hz(20), speed_from_hz(50_000), 2_000);
    let speed_max = speed_from_hz(50_000);
    let whole = Path::plan(State::REST, Real::of(9_000), Real::ZERO, speed_max, &law);
    let whole = whole.expect("a whole move");
    for part in 1..40 {
        let at = whole.ticks() * Real::of(part) / Real::of(40);
        let mut path = whole;
        path.cut(at);
        let State { place, .. } = whole.state_at(at);
        path.come_to_rest(&law);
        let way = double(path.end_steps() - place);
        let mirrored = double(place.min(Real::of(9_000) - place)).min(1_999.5);
        assert!((way - mirrored).abs() < 1e-3, "{part}: {way} of {mirrored}");
        // To the other end of it, slower, and as fast as before.
        for most in [speed_max, speed_max.half()] {
            let mut path = whole;
            path.cut(at);
            if path.go_on(Real::of(12_000), Real::ZERO, most, &law).is_ok() {
                assert!((double(path.end_steps()) - 12_000.0).abs() < 1e-6, "{part}");
            }
        }
    }
}

#[test]
fn to_go_on_as_before_changes_nothing_wherever_an_s_curve_is() {
    // Both with and without a time of constant acceleration and of constant speed.
    for (steps, speed_hz, accel, jerk_hz_per_s2) in [
        (32_000, 4_000, 8_000, 80_000),
        (1_200, 4_000, 8_000, 80_000),
        (2_000, 10_000, 40_000, 100_000),
        (900, 3_000, 200_000, 50_000),
    ] {
        let law = Law::new(accel, jerk(jerk_hz_per_s2));
        let speed_max = speed_from_hz(speed_hz);
        let place = Real::of(steps);
        let whole = Path::plan(State::REST, place, Real::ZERO, speed_max, &law);
        let whole = whole.expect("a whole move");
        for part in 1..200 {
            let at = whole.ticks() * Real::of(part) / Real::of(200);
            let rest = Path::plan(whole.state_at(at), place, Real::ZERO, speed_max, &law);
            let rest = rest.expect("the way suffices");
            let (found, expected) = (double(at) / HZ + seconds(&rest), seconds(&whole));
            let off_ticks = (found - expected) * HZ;
            assert!(
                off_ticks.abs() < 0.5,
                "{steps} steps, part {part}: {off_ticks} ticks of {expected} s"
            );
        }
    }
}

#[test]
fn a_higher_speed_while_an_s_curve_speeds_up_costs_no_time() {
    let law = Law::new(8_000, jerk(80_000));
    let whole = |speed_hz: u32| {
        let speed_max = speed_from_hz(speed_hz);
        Path::plan(State::REST, Real::of(32_000), Real::ZERO, speed_max, &law).expect("a move")
    };
    let (slow, fast) = (whole(4_000), whole(7_000));
    // Its acceleration ends from 0.5 s to 0.6 s: until then both are the same.
    for part in 1..50 {
        let mut path = slow;
        path.cut(Real::of(TICK_HZ / 100 * part));
        let target = Real::of(32_000);
        path.go_on(target, Real::ZERO, speed_from_hz(7_000), &law)
            .expect("way enough");
        let (found, expected) = (seconds(&path), seconds(&fast));
        assert!(
            (found - expected).abs() < 1e-6,
            "{part}: {found} s of {expected} s"
        );
    }
    // Later it is between both, and nowhere is a limit exceeded.
    let mut path = slow;
    path.cut(Real::of(TICK_HZ * 55 / 100));
    let target = Real::of(32_000);
    path.go_on(target, Real::ZERO, speed_from_hz(7_000), &law)
        .expect("way enough");
    assert!(seconds(&path) > seconds(&fast) && seconds(&path) < seconds(&fast) + 0.02);
}

#[test]
fn an_s_curve_changed_in_flight_keeps_its_limits_and_ends_where_it_should() {
    let (mut short, mut cases) = (0, 0);
    for case in seeds(4_000) {
        cases += 1;
        let mut next = numbers(case);
        let mut of_size = |least: u64, bits: u64| {
            let size = least + next(bits - least);
            1 + next(1 << size)
        };
        let (steps, more) = (of_size(4, 18), of_size(1, 18));
        let (speed_hz, other_hz) = (of_size(3, 18) as u32, of_size(3, 18) as u32);
        let (accel, jerk_hz) = (of_size(6, 22) as u32, of_size(8, 26) as u32);
        let law = Law::new(accel, jerk(jerk_hz));
        let before = ideal(steps, speed_hz, accel, jerk(jerk_hz));
        let begin = before.state_at(before.ticks() * Real::of(next(1_000)) / Real::of(1_000));
        // To a place from where it is on, as near as that may be.
        let target = begin.place + Real::of(more);
        let what =
            format!("case {case}: {steps} {speed_hz} {other_hz} {accel} {jerk_hz} {begin:?}");
        let speed_max = speed_from_hz(other_hz);
        let Ok(path) = Path::plan(begin, target, Real::ZERO, speed_max, &law) else {
            let mut rest = Path::at(begin);
            rest.come_to_rest(&law);
            assert!(
                rest.end_steps() + Real::of(1).shifted(-10) > target,
                "{what}: refused"
            );
            short += 1;
            continue;
        };
        let level = double(begin.speed.shifted(30)) + {
            let accel = double(begin.accel.abs().shifted(60));
            let jerk_shifted = double(law.jerk().expect("an S-curve").shifted(90));
            accel * accel / 2.0 / jerk_shifted
        };
        let speed_max = double(speed_max.shifted(30)).max(level) * 1.001 + 1e-6;
        let (accel_max, jerk_max) = (law.accel(), law.jerk().expect("an S-curve"));
        let parts = 300_u64;
        let mut last = begin;
        for part in 1..=parts {
            let at = path.ticks() * Real::of(part) / Real::of(parts);
            let dt = path.ticks() / Real::of(parts);
            let found = path.state_at(at);
            assert!(
                found.place + Real::of(1).shifted(-20) >= last.place,
                "{what}: back"
            );
            let speed = double(found.speed.shifted(30));
            assert!(speed <= speed_max, "{what}: speed {speed} > {speed_max}");
            let slack = accel_max.shifted(-9);
            assert!(found.accel.abs() <= accel_max + slack, "{what}: {found:?}");
            if part < parts {
                let change = (found.accel - last.accel).abs();
                let most = jerk_max * dt;
                assert!(
                    change <= most + most.shifted(-9) + slack,
                    "{what}: jerk at {part}"
                );
            }
            last = found;
        }
        let off = (path.end_steps() - target).abs();
        assert!(off.shifted(20).fixed(0) == 0, "{what}: it ends elsewhere");
    }
    assert!(short * 4 < cases * 3, "{short} of {cases}");
}

/// R15: one step at 1,000 steps/s² takes √(4/1000) s, and its edge is in the middle of that.
#[test]
fn a_single_step_has_its_edge_in_the_middle_of_its_time() {
    let path = ideal(1, 1_000, 1_000, TRAPEZOID);
    lasts(&path, 0.063_245_6);
    assert!((edge_ms(&path, 1) - 31.622_8).abs() < 1e-4);
}

/// R21: LinuxCNC's own expected file of its test `stepgen.0`, a sample each 100 µs.
#[test]
fn the_edges_of_linuxcnc_are_within_three_of_its_samples() {
    let path = ideal(1_280, 4_800, 64_000, TRAPEZOID);
    lasts(&path, 0.341_667);
    let first = [39, 68, 88, 104, 118, 131, 142, 153, 163, 172];
    let others = [(640, 1_707), (1_271, 3_246), (1_279, 3_351), (1_280, 3_380)];
    let early = (1..)
        .zip(first)
        .map(|(number, sample)| (number, sample, 1.0));
    let late = others.map(|(number, sample)| (number, sample, 3.0));
    for (number, sample, most) in early.chain(late) {
        let off = edge_ms(&path, number) * 10.0 - f64::from(sample);
        assert!(off.abs() <= most, "edge {number}: {off} samples off");
    }
}

/// R22: LinuxCNC's `limit3`, a semi-implicit Euler sum with a step of 1 ms, which is ahead of the
/// ideal by half a step of its speed.
#[test]
fn the_places_of_linuxcncs_limiter_are_those_of_the_path_half_a_sample_later() {
    let path = ideal(160, 500, 1_000, TRAPEZOID);
    lasts(&path, 0.8);
    let place = |sample: f64| double(path.state_at(Real::of((sample * 16_000.0) as u64)).place);
    for (sample, expected) in [(1.0, 0.001), (2.0, 0.003), (3.0, 0.006), (4.0, 0.010)] {
        // n·(n + 1)/2 instead of n²/2 thousandths.
        assert!((place(sample) + sample / 2_000.0 - expected).abs() < 1e-9);
    }
    // There it slows down already: the sum has passed its own peak.
    assert!((place(400.5) - 80.599).abs() < 0.41, "{}", place(400.5));
    assert!((place(798.0) - 160.0).abs() < 0.003, "{}", place(798.0));
    let peak = double(path.state_at(Real::of(6_400_000)).speed * Real::of(16_000_000));
    assert!((peak - 400.0).abs() < 1e-6, "{peak} Hz");
}

/// R31: from -2·10⁹ to 2·10⁹ are 4·10⁹ steps: no count wraps.
#[test]
fn a_way_of_more_than_32_bits_is_gone_in_full() {
    let path = ideal(4_000_000_000, 200_000, 100_000, TRAPEZOID);
    // 2 s and 200,000 steps at each end.
    lasts(&path, 4.0 + (4e9 - 400_000.0) / 200_000.0);
    assert_eq!(path.end_steps().rounded(), 4_000_000_000);
}

/// A move that ends at speed is one that begins with it, backwards in time: start and end speed may
/// differ.
#[test]
fn a_move_may_end_at_another_speed_than_it_begins_with() {
    for shape in [TRAPEZOID, linear(100), jerk(1_000)] {
        let law = Law::new(1_000, shape);
        let (slow, fast, most) = (speed_from_hz(200), speed_from_hz(300), speed_from_hz(700));
        let at = |speed: Real| State {
            speed,
            ..State::REST
        };
        let way = Real::of(1_000);
        for (from, to) in [(Real::ZERO, fast), (slow, fast), (fast, slow)] {
            let path = Path::plan(at(from), way, to, most, &law).expect("there is way enough");
            let back = Path::plan(at(to), way, from, most, &law).expect("there is way enough");
            let end = path.end_state();
            assert!((end.speed - to).abs() * Real::of(1 << 40) < Real::of(1));
            assert!((end.place - way).abs() * Real::of(1 << 20) < Real::of(1));
            lasts(&path, seconds(&back));
        }
    }
    // From rest to 300 Hz over 145 steps by 1,000/s² up to 700 Hz: (2·v² - 300²)/2a of 145 steps.
    let law = Law::new(1_000, TRAPEZOID);
    let path = Path::plan(
        State::REST,
        Real::of(145),
        speed_from_hz(300),
        speed_from_hz(700),
        &law,
    );
    let peak = ((2.0 * 1_000.0 * 145.0 + 300.0_f64.powi(2)) / 2.0).sqrt();
    lasts(
        &path.expect("45 are enough"),
        (2.0 * peak - 300.0) / 1_000.0,
    );
}
