//! Laws against their closed forms.

use super::*;

/// The highest speed from `low` to `high` whose way is at most `way`.
fn bisect(mut low: Real, mut high: Real, way: Real, needs: impl Fn(Real) -> Real) -> Real {
    for _ in 0..80 {
        let middle = (low + high).half();
        if needs(middle) <= way {
            low = middle;
        } else {
            high = middle;
        }
    }
    low
}

#[test]
fn the_searched_speeds_of_an_s_curve_are_those_of_a_bisection() {
    let mut state = 17_u64;
    let mut next = |most: u64| {
        state = state
            .wrapping_mul(6_364_136_223_846_793_005)
            .wrapping_add(1_442_695_040_888_963_407);
        (state >> 24) % most
    };
    for case in 0..3_000 {
        // Each over its orders of magnitude, so that every order of limits comes about.
        let mut any = |most: u64| {
            let size = next(most) + 1;
            (next(1 << size) + 1) as u32
        };
        let shape = RampShape::Jerk {
            jerk_hz_per_s2: any(31),
        };
        let law = Law::new(any(24), shape);
        let (from, to) = (speed_from_hz(any(18)), speed_from_hz(any(18)));
        let from = if case % 7 == 0 { Real::ZERO } else { from };
        let to = if case % 5 == 0 { from } else { to };
        let (low, high) = (from.min(to), from.max(to));
        let way = law.way(low, high) + Real::of(u64::from(any(24)));
        let most = (low + high + (law.accel() * way).root().twice()).twice();
        let close = |found: Real, expected: Real, needs: Real| {
            let error = (found - expected).abs();
            assert!(
                error <= expected.shifted(-40),
                "{case}: {law:?} {from:?} {to:?} {way:?}: {found:?}, not {expected:?}"
            );
            assert!(needs <= way + way.shifted(-45), "{case}: it needs more way");
        };
        let needs = |peak: Real| law.way(from, peak) + law.way(to, peak);
        let found = law.peak(way, from, to, None);
        close(found, bisect(high, most, way, needs), needs(found));
        assert_eq!(
            law.peak(way, from, to, Some(found.half().max(high))),
            found.half().max(high)
        );
        assert_eq!(
            law.speed_before(Real::ZERO, to, most),
            to,
            "no way, no gain"
        );
        assert_eq!(law.peak(Real::ZERO, from, from, None), from, "likewise");
        let needs = |speed: Real| law.way(to, speed);
        let found = law.speed_before(way, to, most);
        close(found, bisect(to, most, way, needs), needs(found));
    }
}
