//! Side by side with FastAccelStepper: the moves whose times and edges were measured there, through
//! this node and its emulated pulse unit.
//!
//! `cargo test -p emulator --test against_fas -- --nocapture` prints the tables. FastAccelStepper's
//! columns are measurements of its version 1.2.7 on a PC, by its own tests' inputs; ours are measured
//! here and are what the tests judge. The ideal is the textbook's ([`emulator::kinematics`]): edge k
//! where the path passes k − ½.

mod bench;

use bench::{Bench, config};
use emulator::{
    kinematics::Ideal,
    pins::{Pin, PinEvent},
    record::Life,
};
use keys::{
    AxisId, Command, StopMode,
    command::{Ramp, RampShape},
};
use motion::{Course, Direction, Target};

const X: AxisId = AxisId(0);
const TICK_HZ: f64 = 16e6;

/// A move from rest to rest that was measured there.
struct Case {
    name: &'static str,
    steps: i32,
    /// Interval at full speed.
    interval_us: u32,
    accel: u32,
    linear_steps: u16,
    jump_steps: u16,
    /// Its total time there.
    fas_s: f64,
    /// Largest error of an edge there, ms, after the best shift; largest local acceleration over
    /// the one asked for. Not measured for all.
    fas_edges: Option<(f64, f64)>,
    /// Its first intervals there, ms.
    fas_first_ms: &'static [f64],
}

const fn case(name: &'static str, steps: i32, interval_us: u32, accel: u32, fas_s: f64) -> Case {
    Case {
        name,
        steps,
        interval_us,
        accel,
        linear_steps: 0,
        jump_steps: 0,
        fas_s,
        fas_edges: None,
        fas_first_ms: &[],
    }
}

impl Case {
    const fn shaped(self, linear_steps: u16, jump_steps: u16) -> Self {
        Self {
            linear_steps,
            jump_steps,
            ..self
        }
    }

    const fn edges(self, error_ms: f64, accel: f64, first_ms: &'static [f64]) -> Self {
        Self {
            fas_edges: Some((error_ms, accel)),
            fas_first_ms: first_ms,
            ..self
        }
    }

    fn shape(&self) -> RampShape {
        RampShape::Trapezoid {
            linear_steps: self.linear_steps,
            jump_steps: self.jump_steps,
        }
    }

    fn ideal(&self) -> Ideal {
        Ideal::linear(
            f64::from(self.steps),
            1e6 / f64::from(self.interval_us),
            f64::from(self.accel),
            f64::from(self.linear_steps),
            f64::from(self.jump_steps),
        )
    }
}

const CASES: [Case; 23] = [
    case("f1", 1_000, 4_300, 10_000, 4.309_736),
    case("f2", 10_000, 5_000, 100, 51.864_472),
    case("f4", 1_600, 5_000, 1_000, 8.157_216),
    case("f5", 15_000, 100, 10_000, 2.488_052).edges(2.38, 30.6, &[7.08, 5.00, 4.08]),
    case("f6", 100, 5_000, 10_000, 0.506_236),
    case("f7", 1_600, 50, 10_000, 0.787_024).edges(0.87, 8.7, &[7.08, 5.00, 4.08]),
    case("f8", 128_000, 250, 1_000, 35.964_586),
    case("f11", 16_040, 250, 1_000, 7.974_586),
    case("f12", 1_000, 20, 1_000, 1.958_515),
    case("f13", 500, 4_000, 5, 19.397_472),
    case("f14", 2_000, 4_000, 5, 39.407_784),
    case("f15", 12_600, 4_000, 5, 99.842_208),
    case("f17", 100, 40, 1, 18.647_680),
    case("f18", 256_000, 40, 5_000, 15.230_679),
    case("f23", 1, 100, 1_000, 0.022_368),
    case("f24", 5_000, 200, 9_999, 1.487_194),
    case("seq_06", 54, 40, 1_000_000, 0.016_046),
    case("example", 1_000, 2_000, 100, 6.189_936).edges(2.67, 1.9, &[70.72, 49.98, 40.80]),
    case("ramp.md", 32_000, 250, 2_000, 9.973_206).edges(2.58, 14.9, &[15.82, 11.18]),
    case("fast", 20_000, 100, 20_000, 2.491_266),
    case("jump 100", 15_000, 100, 10_000, 2.366_674).shaped(0, 100),
    case("linear 1000", 15_000, 100, 10_000, 3.124_304).shaped(1_000, 0),
    case("linear, jump", 15_000, 100, 10_000, 2.837_545).shaped(1_000, 100),
];

/// Channels that start on one tick, so that times can be compared with those of the orders.
fn bench() -> Bench {
    let mut config = config();
    config.rmt.start_skew_ticks_max = 0;
    Bench::new(config)
}

fn rises(life: &Life) -> Vec<u64> {
    let edge = |event: &&PinEvent| event.pin == Pin::Step(X) && event.level;
    let edges = life.edges.iter().filter(edge);
    edges.map(|event| event.at_ticks).collect()
}

/// Time from an order at rest to its begin: room for the direction pins.
fn lead_ticks() -> u64 {
    let mut bench = bench();
    bench.run_until(1_000);
    bench.order([mark()]);
    bench.run_to_rest();
    rises(&bench.judged())[0] - 16_000
}

/// One step whose edge marks an instant, one millisecond before what follows.
fn mark() -> Command {
    Command::Move {
        axis: X,
        delay_us: 1_000,
        steps: 1,
    }
}

/// The edges of a move, ticks since its begin, and how long it took.
struct Made {
    edges: Vec<u64>,
    /// Not seen of a drive, whose end is no edge.
    total_ticks: Option<u64>,
}

/// As a command of the queue between two marks, where its speed is a whole number of Hz; as a drive
/// otherwise.
fn make(case: &Case) -> Made {
    let mut bench = bench();
    if 1_000_000 % case.interval_us == 0 {
        let ramp = Ramp {
            speed_hz: 1_000_000 / case.interval_us,
            accel_hz_per_s: case.accel,
            shape: case.shape(),
        };
        let steps = case.steps;
        let ramp = Command::Ramp {
            axis: X,
            steps,
            ramp,
        };
        bench.order([mark(), ramp, mark()]);
        bench.run_to_rest();
        let edges = rises(&bench.judged());
        let begin = edges[0] + 16_000;
        let [_, made @ .., end] = &edges[..] else {
            panic!("two marks");
        };
        return Made {
            edges: made.iter().map(|at| at - begin).collect(),
            total_ticks: Some(end - begin),
        };
    }
    bench.run_until(1_000);
    let course = Course::interval_us(case.interval_us, case.accel).shaped(case.shape());
    drive(&mut bench, Target::By(i64::from(case.steps)), course);
    drive_to_rest(&mut bench);
    let begin = 16_000 + lead_ticks();
    let edges = rises(&bench.node.life());
    Made {
        edges: edges.iter().map(|at| at - begin).collect(),
        total_ticks: None,
    }
}

fn drive(bench: &mut Bench, target: Target, course: Course) {
    let motion = bench.node.node_mut().motion_mut();
    motion.drive(X, target, course).expect("it can be driven");
    bench.run_until(bench.now.0);
}

fn drive_to_rest(bench: &mut Bench) {
    while bench.node.node().motion().is_driving() {
        let due = bench.node.poll_timeout().expect("it moves").0;
        bench.run_until(due.max(bench.now.0));
    }
}

/// Largest acceleration between three neighbouring edges.
fn local_accel(edges: &[f64]) -> f64 {
    let accel = |edges: &[f64]| {
        let (first, second) = (edges[1] - edges[0], edges[2] - edges[1]);
        ((1.0 / second - 1.0 / first) / ((first + second) / 2.0)).abs() * TICK_HZ * TICK_HZ
    };
    edges.windows(3).map(accel).fold(0.0, f64::max)
}

fn largest_error(edges: &[u64], ideal: impl Fn(u64) -> f64) -> f64 {
    let due = (1..).map(|number| ideal(number) * TICK_HZ);
    let errors = edges
        .iter()
        .zip(due)
        .map(|(at, due)| (*at as f64 - due).abs());
    errors.fold(0.0, f64::max)
}

#[test]
fn moves_from_rest_to_rest_last_as_long_as_the_ideal_and_have_its_edges() {
    println!("total time: FAS and ours against the ideal; edges: largest error against the ideal");
    println!(
        "{:>12} {:>7} {:>5} {:>8} {:>11} {:>10} {:>7} {:>12} {:>6} {:>9} {:>8}",
        "case",
        "steps",
        "µs",
        "accel",
        "ideal s",
        "FAS s",
        "FAS %",
        "ours s",
        "ticks",
        "FAS edge",
        "our edge"
    );
    for case in &CASES {
        let ideal = case.ideal();
        let made = make(case);
        let count = made.edges.len() as u64;
        assert_eq!(count, case.steps as u64, "{}", case.name);
        let edge_error = largest_error(&made.edges, |number| ideal.edge_s(number, count));
        assert!(edge_error <= 1.0, "{}: {edge_error} ticks", case.name);
        let ideal_s = ideal.total_s();
        let total_ticks = made.total_ticks.map_or_else(
            || {
                // What follows the last edge was not seen.
                let last = made.edges[made.edges.len() - 1] as f64;
                last + (ideal_s - ideal.edge_s(count, count)) * TICK_HZ
            },
            |ticks| ticks as f64,
        );
        let error = total_ticks - ideal_s * TICK_HZ;
        assert!(error.abs() <= 1.0, "{}: {error} ticks", case.name);
        let fas_edge = case
            .fas_edges
            .map_or_else(String::new, |(ms, _)| format!("{ms:.2} ms"));
        println!(
            "{:>12} {:>7} {:>5} {:>8} {:>11.6} {:>10.6} {:>+7.2} {:>12.7} {:>+6.2} {:>9} {:>5.2} tk",
            case.name,
            case.steps,
            case.interval_us,
            case.accel,
            ideal_s,
            case.fas_s,
            (case.fas_s / ideal_s - 1.0) * 100.0,
            total_ticks / TICK_HZ,
            error,
            fas_edge,
            edge_error,
        );
    }
}

#[test]
fn the_first_intervals_and_the_local_acceleration_are_those_that_were_asked_for() {
    println!("local acceleration between neighbouring edges, over the one asked for;");
    println!("\"16 MHz\" is what remains of the ideal when its edges are rounded to ticks");
    println!(
        "{:>12} {:>7} {:>7} {:>7}  first intervals, ms: FAS / ours / ideal",
        "case", "FAS", "ours", "16 MHz"
    );
    for case in &CASES {
        let Some((_, fas_accel)) = case.fas_edges else {
            continue;
        };
        let ideal = case.ideal();
        let made = make(case);
        let count = made.edges.len() as u64;
        let due = |number: u64| ideal.edge_s(number, count) * TICK_HZ;
        let interval_ms =
            |of: &dyn Fn(usize) -> f64, index| (of(index + 1) - of(index)) / TICK_HZ * 1e3;
        let seen = |index: usize| made.edges[index] as f64;
        let wanted = |index: usize| due(index as u64 + 1);
        let first = |of: &dyn Fn(usize) -> f64| {
            let intervals = (0..3).map(|index| format!("{:.2}", interval_ms(of, index)));
            intervals.collect::<Vec<_>>().join(" ")
        };
        for index in 0..10 {
            let error = interval_ms(&seen, index) - interval_ms(&wanted, index);
            assert!(
                error.abs() * TICK_HZ / 1e3 <= 1.5,
                "{}: {error} ms",
                case.name
            );
        }
        let edges: Vec<_> = made.edges.iter().map(|at| *at as f64).collect();
        let rounded: Vec<_> = (1..=count).map(|number| due(number).round()).collect();
        let accel = f64::from(case.accel);
        let (ours, least) = (local_accel(&edges) / accel, local_accel(&rounded) / accel);
        let fas = case.fas_first_ms.iter().map(|ms| format!("{ms:.2}"));
        println!(
            "{:>12} {fas_accel:>6.1}x {ours:>6.2}x {least:>6.2}x  {} / {} / {}",
            case.name,
            fas.collect::<Vec<_>>().join(" "),
            first(&seen),
            first(&wanted),
        );
        // Beyond what was asked for, only what a tick more or less at each edge makes.
        let speed = ideal.peak_speed();
        let tick = 4.0 * speed.powi(3) / TICK_HZ / accel;
        assert!(ours <= 1.01 + tick, "{}: {ours}", case.name);
        assert!(ours <= fas_accel, "{}: {ours}", case.name);
    }
}

/// A path of constant accelerations, in f64: (seconds, steps/s²), from rest.
struct Drawn(Vec<(f64, f64)>);

impl Drawn {
    fn total_s(&self) -> f64 {
        self.0.iter().map(|(seconds, _)| seconds).sum()
    }

    /// When it passes a place the first time.
    fn time_at(&self, place: f64) -> f64 {
        let (mut begin_s, mut from, mut speed) = (0.0, 0.0, 0.0);
        let last = self.0.len() - 1;
        for (index, (seconds, accel)) in self.0.iter().enumerate() {
            let way = speed * seconds + accel * seconds * seconds / 2.0;
            if place <= from + way || index == last {
                let left = from + way - place;
                let end_speed = speed + accel * seconds;
                if *accel < 0.0 && end_speed.abs() < 1e-6 {
                    // From its end, where it is slow.
                    return begin_s + seconds - (2.0 * left.max(0.0) / -accel).sqrt();
                }
                let square = speed * speed + 2.0 * accel * (place - from);
                return begin_s + 2.0 * (place - from) / (speed + square.max(0.0).sqrt());
            }
            begin_s += seconds;
            from += way;
            speed += accel * seconds;
        }
        begin_s
    }

    fn error(&self, edges: &[u64]) -> f64 {
        largest_error(edges, |number| self.time_at(number as f64 - 0.5))
    }
}

/// Finds when a change took effect, within [`REACTION_S_MAX`] of the call: the instant with which the
/// drawn path has the edges that were seen, and its largest error then.
fn taken_at(edges: &[u64], call_s: f64, draw: impl Fn(f64) -> Drawn) -> (f64, f64) {
    let error = |at_s: f64| draw(at_s).error(edges);
    // To some ticks by the last edge, whose own rounding counts for several ticks of the change.
    let place = edges.len() as f64 - 0.5;
    let seen_s = edges[edges.len() - 1] as f64 / TICK_HZ;
    let is_late = |at_s: f64| draw(at_s).time_at(place) > seen_s;
    let (mut low, mut high) = (call_s, call_s + REACTION_S_MAX);
    let is_late_before = is_late(low);
    assert_ne!(is_late_before, is_late(high), "it took effect in time");
    for _ in 0..60 {
        let middle = (low + high) / 2.0;
        if is_late(middle) == is_late_before {
            low = middle;
        } else {
            high = middle;
        }
    }
    // Then by all edges: so near, the error of each is a straight line, and the largest has one
    // valley.
    let near = 6.0 / TICK_HZ;
    (low, high) = (low - near, high + near);
    for _ in 0..60 {
        let third = (high - low) / 3.0;
        if error(low + third) < error(high - third) {
            high -= third;
        } else {
            low += third;
        }
    }
    (low, error(low))
}

/// A change of speed in the middle of a move.
fn other_speed(steps: f64, accel: f64, before: f64, after: f64, at_s: f64) -> Drawn {
    let up_s = before / accel;
    let change_s = (after - before).abs() / accel;
    let way = before * up_s / 2.0
        + before * (at_s - up_s)
        + (before + after) / 2.0 * change_s
        + after * after / accel / 2.0;
    Drawn(vec![
        (up_s, accel),
        (at_s - up_s, 0.0),
        (change_s, accel * (after - before).signum()),
        ((steps - way) / after, 0.0),
        (after / accel, -accel),
    ])
}

fn row(name: &str, ideal_s: f64, fas_s: f64, ours_s: f64, reaction_s: f64, edge_error: f64) {
    println!(
        "{name:>12} {ideal_s:>11.6} {fas_s:>10.6} {:>+7.3} {ours_s:>11.6} {:>+8.4} {:>8.2} {edge_error:>6.2}",
        (fas_s / ideal_s - 1.0) * 100.0,
        (ours_s / ideal_s - 1.0) * 100.0,
        reaction_s * 1e3,
    );
}

/// From a call to when it takes effect: what the pulse hardware holds and the margin behind it.
const REACTION_S_MAX: f64 = 2e-3;

#[test]
fn changes_in_flight_take_effect_within_2_ms_and_are_exact_from_there() {
    println!("changes in flight; a change at the instant of the call would give the ideal");
    println!(
        "{:>12} {:>11} {:>10} {:>7} {:>11} {:>8} {:>8} {:>6}",
        "case", "ideal s", "FAS s", "FAS %", "ours s", "ours %", "react ms", "edge tk"
    );
    let lead = lead_ticks();
    let begin = 16_000 + lead;
    // A move that begins 1 ms after boot; the call comes so long after its begin.
    let start = |target: Target, course: Course| {
        let mut bench = bench();
        bench.run_until(1_000);
        drive(&mut bench, target, course);
        bench
    };
    let call_us = |at_s: f64| (begin as f64 / 16.0 + at_s * 1e6).round() as u64;
    let edges_of = |bench: &Bench| -> Vec<u64> {
        let edges = rises(&bench.node.life());
        edges.iter().map(|at| at - begin).collect()
    };

    // At 5,000 steps: 2.5 s and 3,125 steps until full speed, then the rest at 2,500 Hz.
    for (name, interval_us, ideal_s, fas_s) in [
        ("faster", 300, 9.520_833, 9.489_413),
        ("slower", 500, 11.687_5, 11.641_875),
    ] {
        let call_s = 2.5 + (5_000.0 - 3_125.0) / 2_500.0;
        let mut bench = start(Target::To(20_000), Course::interval_us(400, 1_000));
        bench.run_until(call_us(call_s));
        let course = Course::interval_us(interval_us, 1_000);
        drive(&mut bench, Target::To(20_000), course);
        drive_to_rest(&mut bench);
        let edges = edges_of(&bench);
        assert_eq!(edges.len(), 20_000);
        let after = 1e6 / f64::from(interval_us);
        let draw = |at_s: f64| other_speed(20_000.0, 1_000.0, 2_500.0, after, at_s);
        assert!((draw(call_s).total_s() - ideal_s).abs() < 1e-5, "{name}");
        let (at_s, edge_error) = taken_at(&edges, call_s, draw);
        let ours_s = draw(at_s).total_s();
        row(name, ideal_s, fas_s, ours_s, at_s - call_s, edge_error);
        assert!(edge_error <= 1.0, "{name}: {edge_error} ticks");
    }

    // Another target, seen before the move slows down for the first one: the same path.
    let mut bench = start(Target::To(3_000), Course::interval_us(400, 10_000));
    bench.run_until(call_us(0.25 + (500.0 - 312.5) / 2_500.0));
    let course = Course::interval_us(400, 10_000);
    drive(&mut bench, Target::To(4_000), course);
    drive_to_rest(&mut bench);
    let edges = edges_of(&bench);
    let ideal = Ideal::trapezoid(4_000.0, 2_500.0, 10_000.0);
    let edge_error = largest_error(&edges, |number| ideal.edge_s(number, 4_000));
    assert_eq!(edges.len(), 4_000);
    let rest_s = ideal.total_s() - ideal.edge_s(4_000, 4_000);
    let ours_s = edges[3_999] as f64 / TICK_HZ + rest_s;
    row(
        "retarget",
        ideal.total_s(),
        1.836_749,
        ours_s,
        0.0,
        edge_error,
    );
    assert!(edge_error <= 1.0, "{edge_error} ticks");

    // A stop while it speeds up, then the target once more.
    let course = Course::interval_us(100, 100);
    let mut bench = start(Target::Forever(Direction::Positive), course);
    let call_s = 2f64.sqrt();
    bench.run_until(call_us(call_s));
    let motion = bench.node.node_mut().motion_mut();
    motion.end_drive(StopMode::Decelerate);
    drive_to_rest(&mut bench);
    let stopped = edges_of(&bench);
    let again = bench.now.0 * 16 + lead - begin;
    drive(&mut bench, Target::To(9_999), course);
    drive_to_rest(&mut bench);
    let edges = edges_of(&bench);
    assert_eq!(edges.len(), 9_999);
    let draw = |at_s: f64| Drawn(vec![(at_s, 100.0), (at_s, -100.0)]);
    let (at_s, stop_error) = taken_at(&stopped, call_s, draw);
    let second = Ideal::trapezoid((9_999 - stopped.len()) as f64, 10_000.0, 100.0);
    let count = (9_999 - stopped.len()) as u64;
    let behind: Vec<_> = edges[stopped.len()..].iter().map(|at| at - again).collect();
    let again_error = largest_error(&behind, |number| second.edge_s(number, count));
    let edge_error = stop_error.max(again_error);
    let ours_s = again as f64 / TICK_HZ + second.total_s();
    row(
        "stop, go on",
        22.626_406,
        22.421_983,
        ours_s,
        at_s - call_s,
        edge_error,
    );
    println!(
        "(it rested at {} and was told to go on at once)",
        stopped.len()
    );
    assert!(stop_error <= 1.0, "{stop_error} ticks");
    assert!(again_error <= 1.0, "{again_error} ticks");
}
