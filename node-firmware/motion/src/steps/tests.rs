//! Segments beside the path that they come from.

extern crate std;
use super::*;
use crate::{
    law::{Law, speed_from_hz},
    path::State,
    segment::{FRACTION_BITS, Segment},
};
use keys::command::RampShape;

/// Makes all segments of one axis and returns the farthest that an edge is off its path, ticks in
/// 2⁻⁸, and how many segments there are.
fn worst(path: &Path, steps: i64, major_steps: u64) -> (i64, usize) {
    let mut cursor = Cursor::of(path, steps, major_steps).expect("there are steps");
    let begin = Moment::of(1_000);
    let mut at = begin.plus(cursor.due()).rounded();
    let (mut worst, mut count) = (0, 0);
    let ratio = Real::of(major_steps) / Real::of(steps.unsigned_abs());
    while cursor.next() < cursor.last() {
        let first = cursor.next();
        let segment = cursor.segment(path, begin, at);
        let Segment::Steps {
            step_count,
            offset,
            interval,
            change,
            total_ticks,
        } = segment
        else {
            panic!("{segment:?}")
        };
        assert_eq!(cursor.next(), first + u64::from(step_count));
        for x in 0..u64::from(step_count) {
            let due = i128::from(offset)
                + i128::from(x) * i128::from(interval)
                + i128::from(x) * (i128::from(x) - 1) / 2 * i128::from(change);
            let place = ratio * Real::of(2 * (first + x) - 1).half();
            let ideal = begin.plus(path.ticks_at(place));
            let ideal = i128::from(ideal.ticks) << FRACTION_BITS
                | i128::from(ideal.part.fixed(FRACTION_BITS as i32));
            let off = (i128::from(at) << FRACTION_BITS) + due - ideal;
            worst = worst.max((off.abs() >> (FRACTION_BITS - 8)) as i64);
        }
        at += total_ticks;
        count += 1;
    }
    (worst, count)
}

#[test]
fn no_edge_of_a_segment_is_more_than_a_quarter_of_a_tick_off_its_path() {
    let mut state = 17_u64;
    let mut next = |most: u64| {
        state = state
            .wrapping_mul(6_364_136_223_846_793_005)
            .wrapping_add(1_442_695_040_888_963_407);
        (state >> 33) % most
    };
    for case in 0..160_u64 {
        let major = 1 + next(1 << (2 + case % 13));
        let speed = speed_from_hz(200 + next(1 << (8 + case % 10)) as u32);
        let accel = 100 + next(1 << (8 + case % 15)) as u32;
        let shape = match case % 4 {
            0 => RampShape::Trapezoid {
                linear_steps: 0,
                jump_steps: 0,
            },
            1 => RampShape::Trapezoid {
                linear_steps: 1 + next(500) as u16,
                jump_steps: 0,
            },
            2 => RampShape::Smooth {
                start_hz: 50,
                ramp_steps: 2 + next(2_000) as u32,
            },
            _ => RampShape::Jerk {
                jerk_hz_per_s2: 1_000 + next(1 << (10 + case % 20)) as u32,
            },
        };
        let law = Law::of(speed, accel, shape);
        let way = Real::of(major);
        let path = Path::plan(State::REST, way, Real::ZERO, speed, &law).expect("from rest");
        for steps in [major as i64, -(1 + next(major) as i64)] {
            let (off, count) = worst(&path, steps, major);
            // A quarter, and what the rounding of interval and change adds up to.
            assert!(
                off <= 64 + 20,
                "{case}: {off}/256 ticks off, {count} segments"
            );
        }
    }
}
