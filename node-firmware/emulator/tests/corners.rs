//! How fast the tool goes where lines meet: as fast as a gentle corner allows, and around a curve of
//! short lines no faster than their acceleration turns it.

mod bench;

use bench::{Bench, config, motor::HZ};
use emulator::{
    pins::{Pin, PinEvent},
    record::Life,
};
use keys::{AxisId, Command};

const X: AxisId = AxisId(0);
const Y: AxisId = AxisId(1);

fn line(way: [i32; 2], speed_hz: u32, accel_hz_per_s: u32) -> Command {
    Command::Line {
        steps: [way[0], way[1], 0, 0],
        speed_hz,
        accel_hz_per_s,
        jerk_hz_per_s2: 0,
    }
}

fn run(commands: impl IntoIterator<Item = Command>) -> Life {
    let mut bench = Bench::new(config());
    bench.order(commands);
    bench.run_to_rest();
    bench.judged()
}

/// When an axis passes the middle of each step, s, and where that is.
fn places(life: &Life, axis: AxisId) -> Vec<(f64, f64)> {
    let mut positive = false;
    let mut place = 0.0;
    let mut places = Vec::new();
    let event = |event: &PinEvent| (event.pin, event.level, event.at_ticks as f64 / HZ);
    for (pin, level, at_s) in life.edges.iter().map(event) {
        match pin {
            Pin::Direction(of) if of == axis => positive = level,
            Pin::Step(of) if of == axis && level => {
                let half = if positive { 0.5 } else { -0.5 };
                places.push((at_s, place + half));
                place += 2.0 * half;
            }
            _ => {}
        }
    }
    places
}

/// Where an axis is, between the middles of its steps.
fn place_at(places: &[(f64, f64)], at_s: f64) -> f64 {
    let next = places.partition_point(|place| place.0 <= at_s);
    let (Some(behind), Some(before)) = (places.get(next), places.get(next.wrapping_sub(1))) else {
        let end = places.last().filter(|place| place.0 <= at_s);
        return end.map_or(0.0, |place| place.1);
    };
    before.1 + (behind.1 - before.1) * (at_s - before.0) / (behind.0 - before.0)
}

#[test]
fn a_gentle_corner_is_passed_at_the_speed_that_its_jump_allows() {
    let ways = [[4_000, 1_000], [3_000, 1_000]];
    let (speed, accel) = (5_000.0, 20_000.0);
    let life = run(ways.map(|way| line(way, speed as u32, accel as u32)));
    let tools = ways.map(|way| f64::from(way[0]).hypot(f64::from(way[1])));
    let slope = |line: usize, axis: usize| f64::from(ways[line][axis]) / tools[line];
    let jump = |axis: usize| (slope(0, axis) - slope(1, axis)).abs();
    let corner = 200.0 / jump(0).max(jump(1));
    assert!((2_700.0..2_750.0).contains(&corner), "{corner}");

    // The tool from 20 steps before the corner to it, and from it on.
    let x = places(&life, X);
    assert_eq!(x.len(), 7_000);
    let passed = |first: usize, line: usize| {
        let (begin, end) = (x[first], x[first + 20]);
        (end.1 - begin.1) / (end.0 - begin.0) / slope(line, 0)
    };
    let mean = |line: usize| {
        let share = tools[line] / f64::from(ways[line][0]);
        // From the corner's speed in 20 steps of X, on the average.
        let other = (corner * corner + 2.0 * accel * share * 20.0 * share).sqrt();
        (corner + other) / 2.0
    };
    for (first, line) in [(3_980 - 1, 0), (4_000, 1)] {
        let (is, due) = (passed(first, line), mean(line));
        assert!(
            (is / due - 1.0).abs() < 0.002,
            "{is} steps/s, {due} are due"
        );
    }

    // All of it takes as long as the textbook says: no halt, and no slower before or behind.
    let total_s: f64 = [0, 1]
        .map(|line| {
            let share = tools[line] / f64::from(ways[line][0]);
            let (top, accel) = (speed * share, accel * share);
            let ways = (top * top + top * top - corner * corner) / (2.0 * accel);
            (2.0 * top - corner) / accel + (tools[line] - ways) / top
        })
        .iter()
        .sum();
    // To and from rest a half step takes 10 ms.
    let ends_s = 2.0 * (1.0 / accel).sqrt();
    let is_s = x[x.len() - 1].0 - x[0].0 + ends_s;
    assert!(
        (is_s - total_s).abs() < 3.0 / HZ,
        "{is_s} s, {total_s} s are due"
    );
}

#[test]
fn around_a_curve_of_short_lines_no_axis_is_turned_harder_than_its_acceleration() {
    // Half a circle in lines of 400 steps. The jump of 200 Hz at each corner would allow 20 kHz,
    // and so 10,000 steps/s² towards the middle.
    let (radius, count, accel) = (40_000.0, 314, 4_000.0);
    let point = |index: i32| {
        let angle = f64::from(index) / f64::from(count) * std::f64::consts::PI;
        [radius * angle.sin(), radius * (1.0 - angle.cos())].map(|place: f64| place.round() as i32)
    };
    let way = |index: i32| {
        let (from, to) = (point(index), point(index + 1));
        [to[0] - from[0], to[1] - from[1]]
    };
    let life = run((0..count).map(|index| line(way(index), 100_000, accel as u32)));
    let axes = [X, Y].map(|axis| places(&life, axis));
    let end_s = axes
        .iter()
        .map(|axis| axis[axis.len() - 1].0)
        .fold(0.0, f64::max);
    // Windows of some lines each.
    let window_s = 0.1;
    let mut at_s = window_s;
    let mut fastest = 0.0_f64;
    while at_s < end_s - window_s {
        let mut square = 0.0;
        let mut hardest = 0.0_f64;
        for axis in &axes {
            let [before, here, behind] =
                [-1.0, 0.0, 1.0].map(|side| place_at(axis, at_s + side * window_s));
            let mean = (behind - 2.0 * here + before) / (window_s * window_s);
            square += ((behind - before) / (2.0 * window_s)).powi(2);
            hardest = hardest.max(mean.abs());
        }
        let speed = square.sqrt();
        fastest = fastest.max(speed);
        // A corner more or less within the window, and half a step at each of its ends.
        let slack = 200.0 / window_s + 2.0 / (window_s * window_s);
        // It speeds up and turns at the same time: each by as much as it may.
        let most = if (2.5..end_s - 2.5).contains(&at_s) {
            accel * 1.1
        } else {
            accel * 2.0
        };
        assert!(
            hardest <= most + slack,
            "at {at_s} s: {hardest} steps/s² at {speed} steps/s"
        );
        at_s += window_s / 4.0;
    }
    // And not more slowly than it must.
    let due = (accel * radius).sqrt();
    assert!(
        (0.85 * due..1.2 * due).contains(&fastest),
        "{fastest} of {due}"
    );
}
