//! The judge is judged on ramps and lines: drawn by the textbook they pass; a tick too much, and
//! they do not.

mod drawing;
#[path = "bench/motor.rs"]
mod motor;

use drawing::Drawing;
use emulator::{kinematics::Ideal, oracle};
use keys::{
    AxisId, Command,
    command::{Ramp, RampShape},
};

const X: AxisId = AxisId(0);
const Y: AxisId = AxisId(1);

const TRAPEZOID: RampShape = RampShape::Trapezoid {
    linear_steps: 0,
    jump_steps: 0,
};

fn ramp(axis: AxisId, steps: i32, speed_hz: u32, accel_hz_per_s: u32, shape: RampShape) -> Command {
    let ramp = Ramp {
        speed_hz,
        accel_hz_per_s,
        shape,
    };
    Command::Ramp { axis, steps, ramp }
}

fn line(steps: [i32; 4], speed_hz: u32, accel_hz_per_s: u32) -> Command {
    Command::Line {
        steps,
        speed_hz,
        accel_hz_per_s,
        jerk_hz_per_s2: 0,
    }
}

fn passes(drawing: &Drawing) {
    if let Err(violations) = oracle::check_life(&drawing.life()) {
        let lines: Vec<_> = violations.iter().map(ToString::to_string).collect();
        panic!("{}", lines.join("\n"));
    }
}

/// What the judge says of a bad record.
fn found(drawing: &Drawing, expected: &str) {
    let violations = oracle::check_life(&drawing.life()).expect_err("it must be found");
    let lines: Vec<_> = violations.iter().map(ToString::to_string).collect();
    let text = lines.join("\n");
    assert!(text.contains(expected), "{expected} is not in:\n{text}");
}

/// Three ramps, one of each shape, and a move.
fn ramps() -> Drawing {
    let mut drawing = Drawing::new();
    drawing.draw(ramp(X, 1_000, 2_000, 10_000, TRAPEZOID));
    let linear = RampShape::Trapezoid {
        linear_steps: 50,
        jump_steps: 3,
    };
    drawing.draw(ramp(X, -500, 3_000, 20_000, linear));
    let curve = RampShape::Jerk {
        jerk_hz_per_s2: 300_000,
    };
    drawing.draw(ramp(Y, 700, 3_000, 20_000, curve));
    drawing.draw(Command::Move {
        axis: X,
        delay_us: 500,
        steps: 30,
    });
    drawing
}

/// Two lines around a gentle corner, and how fast the tool may pass it.
fn corner() -> ([Command; 2], f64) {
    let lines = [
        line([4_000, 1_000, 0, 0], 5_000, 20_000),
        line([3_000, 1_000, 0, 0], 5_000, 20_000),
    ];
    let (before, behind) = (17f64.sqrt(), 10f64.sqrt());
    let jump_x = (4.0 / before - 3.0 / behind).abs();
    let jump_y = (1.0 / before - 1.0 / behind).abs();
    (lines, 200.0 / jump_x.max(jump_y))
}

/// `corner`, passed at this part of the speed that is allowed, and a move.
fn joined(part: f64) -> Drawing {
    let (lines, speed) = corner();
    let mut drawing = Drawing::new();
    drawing.join(&lines, &[speed * part]);
    drawing.draw(Command::Move {
        axis: X,
        delay_us: 500,
        steps: 30,
    });
    drawing
}

#[test]
fn what_is_drawn_by_the_textbook_passes() {
    passes(&ramps());
    passes(&joined(1.0));
    passes(&joined(0.5));
    let mut stopping = Drawing::new();
    for line in corner().0 {
        stopping.draw(line);
    }
    passes(&stopping);
}

#[test]
fn a_curve_of_short_lines_may_be_passed_by_its_acceleration_and_not_by_its_corners_alone() {
    // A circle in lines of 200 steps, whose jumps of 200 Hz would allow 20 kHz.
    let (radius, accel) = (20_000.0_f64, 2_000);
    let point = |index: i32| {
        let angle = f64::from(index) / 100.0;
        [radius * angle.sin(), radius * (1.0 - angle.cos())].map(|place| place.round() as i32)
    };
    let way = |index: i32| {
        let (from, to) = (point(index), point(index + 1));
        [to[0] - from[0], to[1] - from[1], 0, 0]
    };
    let lines: Vec<_> = (0..628)
        .map(|index| line(way(index), 100_000, accel))
        .collect();
    let tool = |index: i32| {
        let [x, y, ..] = way(index);
        f64::from(x).hypot(f64::from(y))
    };
    // Up and down by three quarters of the acceleration of every line.
    let ways: Vec<f64> = (0..628)
        .scan(0.0, |sum, index| {
            *sum += tool(index);
            Some(*sum)
        })
        .collect();
    let total = ways[627];
    let corners = |top: f64| -> Vec<f64> {
        let speed = |way: &f64| (2.0 * 0.75 * f64::from(accel) * way.min(total - way)).sqrt();
        ways[..627].iter().map(|way| speed(way).min(top)).collect()
    };
    let drawn = |top: f64| {
        let mut drawing = Drawing::new();
        drawing.join(&lines, &corners(top));
        drawing
    };
    let due = (f64::from(accel) * radius).sqrt();
    passes(&drawn(due));
    found(&drawn(1.9 * due), "turned by");
}

#[test]
fn a_target_counts_from_where_the_commands_before_lead() {
    let to = |position_steps| Command::RampTo {
        axis: X,
        position_steps,
        ramp: Ramp {
            speed_hz: 5_000,
            accel_hz_per_s: 50_000,
            shape: TRAPEZOID,
        },
    };
    let mut drawing = Drawing::new();
    drawing.draw(to(300));
    drawing.draw(to(300));
    drawing.draw(Command::SetPosition {
        axis: X,
        position_steps: -1_000,
    });
    drawing.draw(to(-1_200));
    drawing.draw(line([50, 20, 0, -7], 1_000, 5_000));
    drawing.draw(to(0));
    passes(&drawing);
    let commands = drawing.commands.clone();
    assert_eq!(oracle::positions_after(&commands, 4), [0, 20, 0, -7]);
    let mut wrong = drawing.clone();
    wrong.commands[5] = to(1);
    found(&wrong, "of command 5");
}

#[test]
fn random_ramps_and_lines_pass() {
    for seed in motor::seeds(300) {
        println!("seed {seed}");
        let mut numbers = motor::Random(seed ^ 0x0dd5);
        let mut random = |from: u64, to: u64| from + numbers.below(to - from);
        let mut drawing = Drawing::new();
        for _ in 0..10 {
            let sign = if random(0, 2) == 0 { 1 } else { -1 };
            let mut steps = || sign * random(0, 400) as i32;
            let many = [steps(), steps(), steps(), steps()];
            let (speed, accel) = (random(50, 30_000) as u32, random(2_000, 500_000) as u32);
            let jerk = random(10_000, 10_000_000) as u32;
            drawing.draw(match random(0, 5) {
                0 => ramp(X, many[0], speed, accel, TRAPEZOID),
                1 => {
                    let shape = RampShape::Trapezoid {
                        linear_steps: random(0, 300) as u16,
                        jump_steps: random(0, 10) as u16,
                    };
                    ramp(X, many[0], speed, accel, shape)
                }
                2 => {
                    let shape = RampShape::Jerk {
                        jerk_hz_per_s2: jerk,
                    };
                    ramp(Y, many[0], speed, accel, shape)
                }
                3 => Command::Line {
                    steps: many,
                    speed_hz: speed,
                    accel_hz_per_s: accel,
                    jerk_hz_per_s2: jerk,
                },
                _ => line(many, speed, accel),
            });
            if random(0, 3) == 0 {
                drawing.draw(Command::Pause { pause_ms: 1 });
            }
        }
        passes(&drawing);
    }
}

#[test]
fn an_edge_that_is_three_ticks_off_is_found() {
    for command in 0..3 {
        for late in [true, false] {
            let mut drawing = ramps();
            let axis = usize::from(command == 2);
            let index = drawing.nth(command, axis, 30);
            let at = &mut drawing.strokes[index].at;
            *at = if late { *at + 3 } else { *at - 3 };
            let way = if late { "late" } else { "early" };
            found(
                &drawing,
                &format!(
                    "step 31 of {} of command {command} is",
                    [1_000, 500, 700][command]
                ),
            );
            found(&drawing, way);
        }
    }
    let mut drawing = Drawing::new();
    drawing.draw(line([1_000, -700, 3, 0], 2_000, 10_000));
    drawing.strokes[1_000 + 41].at += 3;
    found(&drawing, "axis 1: step 42 of 700 of command 0 is");
}

#[test]
fn a_missing_step_is_found() {
    let mut drawing = ramps();
    let index = drawing.nth(0, 0, 30);
    drawing.strokes.remove(index);
    found(&drawing, "axis 0: step 31 of 1000 of command 0 is");
    let mut drawing = ramps();
    let index = drawing.nth(2, 1, 699);
    drawing.strokes.remove(index);
    found(&drawing, "command 2 counts as executed, 699 of its 700");
}

#[test]
fn too_much_acceleration_is_found() {
    for accel in [10_200, 9_800] {
        let mut drawing = Drawing::new();
        let told = ramp(X, 1_000, 2_000, 10_000, TRAPEZOID);
        drawing.draw_as(told, ramp(X, 1_000, 2_000, accel, TRAPEZOID));
        found(&drawing, "axis 0: step 2 of 1000 of command 0 is");
    }
    let (lines, speed) = corner();
    let faster = lines.map(|line| {
        let Command::Line {
            steps, speed_hz, ..
        } = line
        else {
            unreachable!()
        };
        self::line(steps, speed_hz, 20_400)
    });
    let mut drawing = Drawing::new();
    drawing.join(&faster, &[speed]);
    drawing.commands = lines.to_vec();
    found(&drawing, "acceleration 20");
    found(&drawing, "too fast");
}

#[test]
fn the_wrong_shape_is_found() {
    let linear = |linear_steps, jump_steps| RampShape::Trapezoid {
        linear_steps,
        jump_steps,
    };
    let jerk = |jerk_hz_per_s2| RampShape::Jerk { jerk_hz_per_s2 };
    let smooth = |start_hz, ramp_steps| RampShape::Smooth {
        start_hz,
        ramp_steps,
    };
    for (told, drawn) in [
        (linear(50, 0), linear(51, 0)),
        (linear(50, 0), linear(0, 0)),
        (linear(0, 2), linear(0, 0)),
        (linear(0, 0), linear(0, 1)),
        (jerk(500_000), jerk(501_000)),
        (jerk(500_000), linear(0, 0)),
        (smooth(400, 300), smooth(401, 300)),
        (smooth(400, 300), smooth(400, 301)),
        (smooth(400, 300), linear(0, 0)),
    ] {
        let mut drawing = Drawing::new();
        let shape = |shape| ramp(X, 1_000, 2_000, 10_000, shape);
        drawing.draw_as(shape(told), shape(drawn));
        found(&drawing, "of command 0 is");
    }
}

#[test]
fn the_wrong_way_is_found() {
    let mut drawing = ramps();
    for stroke in &mut drawing.strokes {
        stroke.sign = -stroke.sign;
    }
    found(&drawing, "step 1 of 1000 of command 0 goes the wrong way");
    let mut drawing = joined(1.0);
    let index = drawing.nth(1, 1, 500);
    drawing.strokes[index].sign = -1;
    found(
        &drawing,
        "500 of 1000 steps of command 1, then one the wrong way",
    );
}

#[test]
fn a_gap_is_found() {
    for (command, axis) in [(1, 0), (2, 1), (3, 0)] {
        let mut drawing = ramps();
        let from = drawing.strokes[drawing.nth(command, axis, 0)].at;
        drawing.delay(from, 2_000);
        found(&drawing, "a gap of ");
    }
    let mut drawing = joined(1.0);
    let from = drawing.strokes[drawing.nth(2, 0, 0)].at;
    drawing.delay(from, 2_000);
    found(&drawing, "a gap of ");
    // Lines that stop at the corner, and there for a moment longer.
    let mut drawing = Drawing::new();
    for line in corner().0 {
        drawing.draw(line);
    }
    let from = drawing.strokes[drawing.nth(1, 0, 0)].at;
    drawing.delay(from, 2_000);
    found(&drawing, "where lines meet");
    found(&drawing, "longer than with a halt at each corner");
}

#[test]
fn a_command_that_begins_early_is_found() {
    let mut drawing = ramps();
    for stroke in drawing
        .strokes
        .iter_mut()
        .filter(|stroke| stroke.command > 1)
    {
        stroke.at -= 10;
    }
    found(&drawing, "too early");
    let mut drawing = ramps();
    for stroke in drawing
        .strokes
        .iter_mut()
        .filter(|stroke| stroke.command > 2)
    {
        stroke.at -= 10;
    }
    found(&drawing, "ticks early");
}

#[test]
fn a_corner_that_is_passed_too_fast_is_found() {
    for part in [1.02, 1.5] {
        found(&joined(part), "too fast");
    }
    // Without slowing down at all.
    let lines = [
        line([3_000, 0, 0, 0], 1_000, 20_000),
        line([0, 3_000, 0, 0], 1_000, 20_000),
    ];
    let mut drawing = Drawing::new();
    drawing.join(&lines, &[200.0]);
    passes(&drawing);
    let mut drawing = Drawing::new();
    drawing.join(&lines, &[1_000.0]);
    found(&drawing, "too fast");
}

#[test]
fn a_jump_of_the_tools_speed_at_a_corner_is_found() {
    // As if the second line began behind a slower corner than the first one ended with.
    let (lines, speed) = corner();
    let mut drawing = Drawing::new();
    drawing.join(&lines, &[speed]);
    let mut slower = Drawing::new();
    slower.join(&lines, &[speed / 2.0]);
    let mut mixed = drawing.clone();
    mixed.strokes.retain(|stroke| stroke.command == 0);
    let end = |drawing: &Drawing| drawing.strokes[drawing.nth(1, 0, 0)].at;
    let (at, from) = (end(&drawing), end(&slower));
    let rest = slower.strokes.iter().filter(|stroke| stroke.command == 1);
    mixed.strokes.extend(rest.map(|stroke| {
        let mut stroke = *stroke;
        stroke.at = at + stroke.at - from;
        stroke
    }));
    found(&mixed, "acceleration -");
}

#[test]
fn an_axis_off_the_line_is_found() {
    let mut drawing = joined(1.0);
    for stroke in drawing.strokes.iter_mut().filter(|stroke| stroke.axis == 1) {
        stroke.at += 2_000;
    }
    found(&drawing, "off the straight line");
    // A step of the second line among those of the first.
    let mut drawing = joined(1.0);
    let index = drawing.nth(1, 1, 0);
    drawing.strokes[index].at = drawing.strokes[drawing.nth(0, 1, 999)].at - 10_000;
    found(&drawing, "off the straight line");
}

#[test]
fn lines_that_are_too_fast_are_found() {
    let lines = [
        line([9_000, 0, 0, 0], 5_000, 20_000),
        line([9_000, 0, 0, 0], 5_000, 20_000),
    ];
    let mut drawing = Drawing::new();
    drawing.join(&lines, &[5_000.0]);
    passes(&drawing);
    let faster = lines.map(|_| line([9_000, 0, 0, 0], 5_005, 20_000));
    let mut drawing = Drawing::new();
    drawing.join(&faster, &[5_005.0]);
    drawing.commands = lines.to_vec();
    found(&drawing, "too fast");
}

/// A ramp of ten seconds that is stopped after three, at 8000 steps and 4000 Hz; the deceleration
/// begins so many seconds later.
fn stopped(late_s: f64, accel: f64) -> Drawing {
    let mut drawing = Drawing::new();
    let at = drawing.now + 48_000_000;
    drawing.draw(ramp(X, 32_000, 4_000, 2_000, TRAPEZOID));
    let cut = at + (late_s * 16e6) as u64;
    drawing.stop(at, cut, 0);
    let place = 8_000.0 + 4_000.0 * late_s;
    drawing.brake(cut, &[32_000], place, 4_000.0, accel);
    drawing
}

#[test]
fn a_ramp_that_is_stopped_decelerates_by_its_own_law() {
    let drawing = stopped(0.0, 2_000.0);
    passes(&drawing);
    assert_eq!(drawing.position(0), 12_000);
    passes(&stopped(0.002, 2_000.0));
    // A halt.
    let mut drawing = Drawing::new();
    let at = drawing.now + 48_000_000;
    drawing.draw(ramp(X, 32_000, 4_000, 2_000, TRAPEZOID));
    drawing.stop(at, at, 0);
    passes(&drawing);
    // All was over before.
    let mut drawing = ramps();
    drawing.stop(drawing.now, drawing.now, 4);
    passes(&drawing);
}

#[test]
fn a_ramp_that_is_stopped_wrongly_is_found() {
    found(
        &stopped(0.0, 2_050.0),
        "behind a stop: axis 0, command 0: acceleration -20",
    );
    found(&stopped(0.0, 1_900.0), "later at rest than a stop allows");
    found(&stopped(0.1, 2_000.0), "later at rest than a stop allows");
    // It ends in the middle of its deceleration.
    let mut drawing = stopped(0.0, 2_000.0);
    drawing.strokes.truncate(10_000);
    found(&drawing, "too fast");
    // One more.
    let mut drawing = stopped(0.0, 2_000.0);
    let mut more = drawing.strokes[drawing.strokes.len() - 1];
    more.sign = -1;
    more.at += 16_000_000;
    drawing.strokes.push(more);
    found(&drawing, "wrong way");
    // Off its plan before the stop.
    let mut drawing = stopped(0.0, 2_000.0);
    drawing.strokes[4_000].at += 3;
    found(&drawing, "step 4001 of 32000 of command 0 is");
}

#[test]
fn a_line_that_is_stopped_stays_on_its_path() {
    let draw = || {
        let mut drawing = Drawing::new();
        let begin = drawing.now;
        let command = line([8_000, -3_000, 17, 0], 4_000, 20_000);
        let ideal = Ideal::of_line(&command).expect("steps");
        drawing.draw(command);
        let at = begin + 16_000_000;
        let state = ideal.at(1.0);
        drawing.stop(at, at, 0);
        let axes = [8_000, -3_000, 17];
        drawing.brake(at, &axes, state.place, state.speed, 20_000.0);
        drawing
    };
    passes(&draw());
    let mut drawing = draw();
    let last = drawing.strokes.iter().rposition(|stroke| stroke.axis == 1);
    drawing.strokes[last.expect("steps")].at += 1_000_000;
    found(&drawing, "off the straight line");
    let mut life = draw().life();
    life.stops[0].positions_steps[1] += 1;
    let violations = oracle::check_life(&life).expect_err("found");
    assert!(violations[0].to_string().contains("stopped at"));
}

#[test]
fn joined_lines_may_be_stopped_before_their_first_step_and_make_it_late() {
    let lines = [
        line([600, 0, 150, 0], 5_000, 1_000),
        line([600, 0, 200, 0], 5_000, 1_000),
    ];
    let drawn = |delay: u64| {
        let mut drawing = Drawing::new();
        drawing.draw(Command::Move {
            axis: Y,
            delay_us: 500,
            steps: 30,
        });
        let begin = drawing.now;
        drawing.join(&lines, &[100.0]);
        // The first step is due after 31.6 ms; by then it slows down since 25 ms.
        drawing.stop(begin + 23 * 16_000, begin, 1);
        let at = begin + 25 * 16_000 + delay;
        drawing.brake(at, &[600, 0, 150, 0], 0.3125, 25.0, 1_000.0);
        drawing
    };
    let drawing = drawn(0);
    assert_eq!(drawing.strokes.len(), 31);
    passes(&drawing);
}

#[test]
fn joined_lines_that_are_stopped_come_to_rest_on_their_path() {
    let draw = |late_s: f64, accel: f64| {
        let half = [9_000, 0, 0, 0];
        let lines = [line(half, 4_000, 20_000), line(half, 4_000, 20_000)];
        let mut drawing = Drawing::new();
        let begin = drawing.now;
        drawing.join(&lines, &[4_000.0]);
        // At 8800 steps, just before the second line.
        let at = begin + 36_800_000;
        let cut = at + (late_s * 16e6) as u64;
        drawing.stop(at, cut, 0);
        let place = 8_800.0 + 4_000.0 * late_s;
        drawing.brake(cut, &[18_000], place, 4_000.0, accel);
        drawing
    };
    let good = draw(0.001, 20_000.0);
    assert_eq!(good.position(0), 9_204);
    passes(&good);
    found(&draw(0.001, 20_400.0), "acceleration -20");
    found(&draw(0.001, 19_000.0), "later at rest");
    found(&draw(0.1, 20_000.0), "later at rest");
    let mut halted = draw(0.001, 20_000.0);
    halted.strokes.truncate(8_950);
    found(&halted, "behind a stop: axis 0, command 0: too fast");
}
