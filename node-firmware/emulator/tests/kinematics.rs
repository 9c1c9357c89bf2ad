//! The judge's own textbook against the reference cases, and against its own derivatives.

#[path = "bench/motor.rs"]
mod motor;

use emulator::kinematics::Ideal;
use keys::Command;

fn near(found: f64, expected: f64, tolerance: f64) {
    assert!(
        (found - expected).abs() <= tolerance,
        "{found}, not {expected}"
    );
}

/// One tick of 16 MHz and a billionth.
fn lasts(ideal: &Ideal, expected_s: f64) {
    near(ideal.total_s(), expected_s, 62.5e-9 + expected_s * 1e-9);
}

#[test]
fn trapezoids_last_as_long_as_the_textbook_says() {
    for (steps, speed, accel, total_s) in [
        (1_000.0, 500.0, 100.0, 40f64.sqrt()),
        (2_600.0, 500.0, 100.0, 10.2),
        (2_500.0, 500.0, 100.0, 10.0),
        (15_000.0, 10_000.0, 10_000.0, 2.5),
        (32_000.0, 4_000.0, 2_000.0, 10.0),
        (32_000.0, 6_400.0, 1_280.0, 10.0),
        (256_000.0, 25_000.0, 5_000.0, 15.24),
        (128_000.0, 4_000.0, 1_000.0, 36.0),
        (72_000.0, 4_000.0, 1_000.0, 22.0),
        (44_000.0, 4_000.0, 1_000.0, 15.0),
        (16_040.0, 4_000.0, 1_000.0, 8.01),
        (1_600.0, 20_000.0, 10_000.0, 0.8),
        (1_000.0, 50_000.0, 1_000.0, 2.0),
        (500.0, 250.0, 5.0, 20.0),
        (2_000.0, 250.0, 5.0, 40.0),
        (12_600.0, 250.0, 5.0, 100.4),
        (16_500.0, 250.0, 5.0, 116.0),
        (100.0, 25_000.0, 1.0, 20.0),
        (1.0, 1_000.0, 1_000.0, 0.004f64.sqrt()),
        (2.0, 1_000.0, 100.0, 0.08f64.sqrt()),
        (1_280.0, 4_800.0, 64_000.0, 1_280.0 / 4_800.0 + 0.075),
        (160.0, 500.0, 1_000.0, 0.8),
    ] {
        lasts(&Ideal::trapezoid(steps, speed, accel), total_s);
    }
    near(
        Ideal::trapezoid(1_000.0, 500.0, 100.0).peak_speed(),
        316.2278,
        5e-5,
    );
    near(
        Ideal::trapezoid(160.0, 500.0, 1_000.0).peak_speed(),
        400.0,
        1e-9,
    );
}

#[test]
fn edges_are_in_the_middle_of_their_steps() {
    let edges = |ideal: &Ideal, count: u64, expected: &[(u64, f64)]| {
        for (number, at_s) in expected {
            near(ideal.edge_s(*number, count), *at_s, 5.1e-7);
        }
    };
    edges(
        &Ideal::trapezoid(1_000.0, 500.0, 100.0),
        1_000,
        &[
            (1, 0.1),
            (2, 0.173205),
            (10, 0.435890),
            (100, 1.410674),
            (500, 3.160696),
            (501, 3.163859),
            (999, 6.151350),
            (1_000, 6.224555),
        ],
    );
    edges(
        &Ideal::trapezoid(15_000.0, 10_000.0, 10_000.0),
        15_000,
        &[
            (1, 0.01),
            (2, 0.017321),
            (5_000, 0.999950),
            (5_001, 1.000050),
            (7_500, 1.249950),
            (10_000, 1.499950),
            (14_999, 2.482679),
            (15_000, 2.49),
        ],
    );
    edges(
        &Ideal::trapezoid(1_280.0, 4_800.0, 64_000.0),
        1_280,
        &[
            (1, 3.953e-3),
            (2, 6.847e-3),
            (3, 8.839e-3),
            (4, 10.458e-3),
            (5, 11.859e-3),
            (10, 17.230e-3),
            (640, 170.729e-3),
            (1_271, 324.437e-3),
            (1_279, 334.820e-3),
            (1_280, 337.714e-3),
        ],
    );
    edges(&Ideal::trapezoid(1.0, 1e9, 1_000.0), 1, &[(1, 0.031_622_8)]);
}

#[test]
fn the_way_to_rest_is_v2_by_2a() {
    for (speed, accel, way) in [
        (500.0, 100.0, 1_250.0),
        (4_000.0, 2_000.0, 4_000.0),
        (10_000.0, 10_000.0, 5_000.0),
        (200_000.0, 1e6, 20_000.0),
    ] {
        let ideal = Ideal::trapezoid(1e6, speed, accel);
        near(ideal.fall_steps(), way, 1e-6);
        near(ideal.fall_s(), speed / accel, 1e-9);
    }
}

#[test]
fn the_shortest_moves_at_the_greatest_acceleration_have_all_their_edges() {
    for steps in 1..=255 {
        let ideal = Ideal::trapezoid(steps as f64, 20_000.0, f64::from(i32::MAX));
        let edges: Vec<_> = (1..=steps).map(|k| ideal.edge_s(k, steps)).collect();
        assert!(edges.windows(2).all(|pair| pair[1] > pair[0]));
        assert!(edges[0] > 0.0 && edges[edges.len() - 1] < ideal.total_s());
    }
}

#[test]
fn linear_acceleration_and_jump_start_are_the_reference() {
    for (accel, linear, speed, handover_s) in [
        (10_000.0, 1_000.0, 3_872.983_3, 0.774_597),
        (10_000.0, 100.0, 1_224.744_9, 0.244_949),
        (1_000.0, 50.0, 273.861_3, 0.547_723),
    ] {
        let ideal = Ideal::linear(2.0 * linear, 1e6, accel, linear, 0.0);
        near(ideal.peak_speed(), speed, 5e-5);
        near(ideal.fall_s(), handover_s, 5e-7);
    }
    let ideal = Ideal::linear(15_000.0, 10_000.0, 10_000.0, 1_000.0, 0.0);
    near(ideal.at(0.5).accel / 0.5, 12_909.944, 5e-4);
    for (linear, jump, speed) in [
        (0.0, 100.0, 1_414.213_6),
        (0.0, 1.0, 141.421_4),
        (1_000.0, 100.0, 834.409_0),
        (1_000.0, 1_000.0, 3_872.983_3),
        (1_000.0, 2_000.0, 5_916.079_8),
    ] {
        let ideal = Ideal::linear(15_000.0, 10_000.0, 10_000.0, linear, jump);
        near(ideal.at(0.0).speed, speed, 5e-5);
    }
    let ideal = Ideal::linear(15_000.0, 10_000.0, 10_000.0, 1_000.0, 0.0);
    near(ideal.total_s(), 3.224_597, 5e-7);
    near(ideal.fall_steps(), 5_250.0, 1e-9);
    let ideal = Ideal::linear(15_000.0, 10_000.0, 10_000.0, 0.0, 100.0);
    near(ideal.total_s(), 2.368_579, 5e-7);
}

#[test]
fn a_jump_has_its_bounds() {
    // All steps of the move: it begins at its peak.
    let ideal = Ideal::linear(50.0, 1e6, 10_000.0, 0.0, 60_000.0);
    near(ideal.at(0.0).speed, 1_000.0, 1e-9);
    near(ideal.total_s(), 0.1, 1e-12);
    // The top speed: it begins with it.
    let ideal = Ideal::linear(5_000.0, 100.0, 10_000.0, 0.0, 60_000.0);
    near(ideal.at(0.0).speed, 100.0, 1e-9);
    near(ideal.total_s(), 50.0 + 0.005, 1e-9);
}

#[test]
fn s_curves_last_as_long_as_the_reference_says() {
    for (steps, speed, accel, jerk, total_s) in [
        (1.0, 1.0, 1.0, 1.0, 3.174_802_103_9),
        (2.0, 1.0, 1.0, 1.0, 4.0),
        (3.0, 1.0, 1.0, 1.0, 5.0),
        (32_000.0, 4_000.0, 8_000.0, 80_000.0, 8.6),
        (1_000.0, 1_000.0, 10_000.0, 100_000.0, 1.2),
        (10_000.0, 5_000.0, 20_000.0, 400_000.0, 2.3),
        (100.0, 5_000.0, 20_000.0, 400_000.0, 0.2),
    ] {
        let ideal = Ideal::s_curve(steps, speed, accel, jerk);
        near(ideal.total_s(), total_s, 1e-10);
    }
    let ideal = Ideal::s_curve(1.0, 1.0, 1.0, 1.0);
    near(ideal.peak_speed(), 0.629_961, 5e-7);
    near(ideal.at(ideal.total_s() / 4.0).accel, 0.793_701, 5e-7);
    near(ideal.at(ideal.total_s() / 2.0).place, 0.5, 1e-12);
    let ideal = Ideal::s_curve(32_000.0, 4_000.0, 8_000.0, 80_000.0);
    near(ideal.at(0.1).place, 13.333_333_3, 1e-6);
    near(ideal.at(0.1).speed, 400.0, 1e-9);
    near(ideal.fall_s(), 0.6, 1e-12);
    near(ideal.fall_steps(), 1_200.0, 1e-9);
}

#[test]
fn axes_of_a_line_share_one_path() {
    let line = |steps, speed_hz, accel_hz_per_s| Command::Line {
        steps,
        speed_hz,
        accel_hz_per_s,
        jerk_hz_per_s2: 0,
    };
    // As good as without a ramp: three seconds, three milliseconds apart.
    let ideal = Ideal::of_line(&line([3_000, -1_000, 0, 0], 1_000, u32::MAX)).expect("steps");
    near(ideal.total_s(), 3.0, 1e-6);
    for number in 2..=1_000 {
        let interval_s = ideal.edge_s(number, 1_000) - ideal.edge_s(number - 1, 1_000);
        near(interval_s, 0.003, 1e-9);
    }
    let ideal = Ideal::of_line(&line([10_000, 4_000, 0, 0], 5_000, 10_000)).expect("steps");
    lasts(&ideal, 2.5);
    near(ideal.at(1.25).place, 5_000.0, 1e-9);
    near(ideal.edge_s(2_000, 4_000), 1.249_75, 1e-12);
    // The other axis alone, with its share of the limits.
    let alone = Ideal::trapezoid(4_000.0, 2_000.0, 4_000.0);
    for number in 1..=4_000 {
        near(
            ideal.edge_s(number, 4_000),
            alone.edge_s(number, 4_000),
            1e-12,
        );
    }
    assert_eq!(Ideal::of_line(&line([0; 4], 1, 1)), None);
}

/// A number from 1 to 10^`decades`, as often small as large.
fn random(seed: &mut u64, decades: f64) -> f64 {
    *seed = seed.wrapping_add(0x9e37_79b9_7f4a_7c15);
    let mut word = *seed;
    word = (word ^ (word >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    word = (word ^ (word >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    word ^= word >> 31;
    let unit = (word >> 11) as f64 / (1u64 << 53) as f64;
    10f64.powf(unit * decades).round()
}

/// Limits are kept, and place, speed and acceleration are each other's derivatives.
fn is_consistent(ideal: &Ideal, speed: f64, accel: f64, jerk: Option<f64>) {
    let total = ideal.total_s();
    near(ideal.at(total).place, ideal.steps(), 0.0);
    near(ideal.at(0.0).place, 0.0, 1e-9 * ideal.steps());
    let samples = 400;
    let dt = total / f64::from(samples);
    let states: Vec<_> = (0..=samples)
        .map(|index| ideal.at(dt * f64::from(index)))
        .collect();
    let more = 1.0 + 1e-9;
    let tiny = 1e-9 * ideal.steps() / dt;
    for (index, pair) in states.windows(2).enumerate() {
        let (a, b) = (pair[0], pair[1]);
        assert!(b.place >= a.place);
        for state in [a, b] {
            assert!((0.0..=speed * more).contains(&state.speed), "{state:?}");
            assert!(state.accel.abs() <= accel * more, "{state:?}");
        }
        let mean = (b.place - a.place) / dt;
        assert!(mean <= speed * more + tiny);
        // The midpoint rule is exact up to the change of acceleration.
        let middle = ideal.at(dt * (index as f64 + 0.5));
        near(mean, middle.speed, accel * dt / 4.0 * more + tiny);
        assert!((b.speed - a.speed).abs() <= accel * dt * more + tiny);
        if let Some(jerk) = jerk {
            assert!((b.accel - a.accel).abs() <= jerk * dt * more + tiny / dt);
            near(mean, middle.speed, jerk * dt * dt / 16.0 + tiny);
        }
    }
    for index in 1..100 {
        let place = ideal.steps() * f64::from(index) / 100.0;
        let t = ideal.time_at(place);
        near(ideal.at(t).place, place, 1e-9 * ideal.steps());
    }
}

#[test]
fn random_moves_keep_their_limits_and_are_consistent() {
    for before in motor::seeds(3_000) {
        let mut seed = before.wrapping_mul(0x2026_0000_0001);
        let steps = random(&mut seed, 6.0);
        let (speed, accel) = (random(&mut seed, 5.3), random(&mut seed, 7.0));
        let (linear, jump) = (random(&mut seed, 4.8) - 1.0, random(&mut seed, 3.0) - 1.0);
        let jerk = random(&mut seed, 9.0);
        println!("seed {before}: {steps} {speed} {accel} {linear} {jump} {jerk}");
        is_consistent(&Ideal::trapezoid(steps, speed, accel), speed, accel, None);
        is_consistent(
            &Ideal::linear(steps, speed, accel, linear, jump),
            speed,
            accel,
            None,
        );
        let curve = Ideal::s_curve(steps, speed, accel, jerk);
        is_consistent(&curve, speed, accel, Some(jerk));
        assert!(curve.total_s() >= Ideal::trapezoid(steps, speed, accel).total_s());
    }
}

#[test]
fn a_smoothstep_lasts_as_long_as_its_table_and_has_its_periods() {
    // ESP-IDF's example: 500 frequencies from 500 to 1500 Hz, 5000 steps, and back.
    let ideal = Ideal::smoothstep(6_000.0, 500.0, 1_500.0, 500.0, 1_500.0);
    near(ideal.total_s(), 4.483_577_42, 5e-9);
    near(ideal.time_at(500.0), 0.575_122_04, 5e-9);
    near(ideal.total_s() - ideal.time_at(5_500.0), 0.575_122_04, 5e-9);
    for (index, period_us) in [
        (0, 2_000.0),
        (1, 1_999.951_9),
        (10, 1_995.256_4),
        (50, 1_893.551),
        (100, 1_654.574_3),
        (249, 1_001.505_3),
        (250, 998.499_3),
        (374, 744.498_5),
        (498, 666.672),
        (499, 666.666_7),
    ] {
        let at = ideal.time_at(f64::from(index) + 0.5);
        near(1e6 / ideal.at(at).speed, period_us, 1e-4);
        near(ideal.at(at).place, f64::from(index) + 0.5, 1e-6);
    }
    // Half way, and no way at all.
    let part = Ideal::smoothstep(300.0, 500.0, 1_500.0, 500.0, 1_500.0);
    near(part.total_s(), 2.0 * ideal.time_at(150.0), 1e-9);
    near(
        Ideal::smoothstep(1.0, 500.0, 1_500.0, 500.0, 1_500.0).total_s(),
        0.002,
        1e-12,
    );
    // Left at a lower speed it has risen as the whole one.
    let slower = Ideal::smoothstep(6_000.0, 500.0, 1_500.0, 500.0, 1_000.0);
    near(slower.peak_speed(), 1_000.0, 1e-6);
    near(slower.time_at(200.0), ideal.time_at(200.0), 1e-12);
    near(slower.fall_steps(), 250.0, 1e-6);
    near(
        slower.total_s(),
        2.0 * ideal.time_at(250.0) + 5_500.0 / 1_000.0,
        1e-6,
    );
}
