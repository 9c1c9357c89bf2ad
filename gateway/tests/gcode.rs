//! G-code programs: the path against interpreters that are not ours, what is refused and where, and
//! what a preview says.

use gateway::job::{
    gcode::{Machine, Machines, Program, compile},
    parse::{parse_for, parse_group_for},
};
use keys::{
    JobId, NodeId,
    job::{JobCommand, Work},
    record::ErrorCode,
};

fn machine() -> Machine {
    Machine {
        steps_per_mm: vec![80.0, 79.9, 400.0],
        speed_mm_min: vec![6_000.0, 5_000.0, 600.0],
        accel_mm_s2: vec![500.0, 400.0, 50.0],
        offsets_mm: std::array::from_fn(|index| match index {
            1 => vec![100.0, -20.0, 3.0],
            5 => vec![7.5, 8.25, 0.125],
            _ => vec![0.0; 3],
        }),
        ..Machine::alike(3, 80.0, 1.0, 1.0)
    }
}

/// Where the tool is after each command that moves it, steps.
fn places(program: &Program) -> Vec<[f64; 3]> {
    let mut place = [0_i64; 3];
    let mut places = vec![place];
    for command in &program.commands {
        match command {
            JobCommand::Line(line) => {
                for (to, way) in place.iter_mut().zip(&line.steps) {
                    *to += i64::from(*way);
                }
            }
            JobCommand::RampTo(ramp) => place[usize::from(ramp.axis)] = ramp.position,
            _ => continue,
        }
        places.push(place);
    }
    let scale = &machine().steps_per_mm;
    let mm = |place: &[i64; 3]| std::array::from_fn(|axis| place[axis] as f64 / scale[axis]);
    places.iter().map(mm).collect()
}

fn distance(a: [f64; 3], b: [f64; 3]) -> f64 {
    (0..3)
        .map(|axis| (a[axis] - b[axis]).powi(2))
        .sum::<f64>()
        .sqrt()
}

/// Distance of a point from a straight way.
fn off(point: [f64; 3], from: [f64; 3], to: [f64; 3]) -> f64 {
    let way: [f64; 3] = std::array::from_fn(|axis| to[axis] - from[axis]);
    let length = distance(from, to);
    let along = (0..3)
        .map(|axis| (point[axis] - from[axis]) * way[axis])
        .sum::<f64>();
    let share = if length == 0.0 {
        0.0
    } else {
        (along / length / length).clamp(0.0, 1.0)
    };
    distance(
        point,
        std::array::from_fn(|axis| from[axis] + share * way[axis]),
    )
}

/// Half a step of each axis, as a distance.
fn rounding() -> f64 {
    let squares = machine()
        .steps_per_mm
        .iter()
        .map(|scale| (0.5 / scale).powi(2))
        .sum::<f64>();
    squares.sqrt() + 1e-6
}

fn follows(gcode: &str, expected: &str) {
    let program = compile(gcode, &machine()).expect("legal");
    let places = places(&program);
    let mut at = 0;
    for line in expected.lines() {
        let (on_arc, text) = match line.strip_prefix("~ ") {
            Some(text) => (true, text),
            None => (false, line),
        };
        let values: Vec<f64> = text
            .split(' ')
            .map(|text| text.parse().expect("mm"))
            .collect();
        let point = [values[0], values[1], values[2]];
        if on_arc {
            // On the way: the chord that comes closest is not before the last one.
            let tolerance = machine().arc_tolerance_mm + 0.0005 + rounding();
            let found = (at..places.len() - 1)
                .find(|index| off(point, places[*index], places[index + 1]) <= tolerance);
            at = found.unwrap_or_else(|| panic!("the path does not come by {point:?}"));
        } else {
            let found =
                (at..places.len()).find(|index| distance(point, places[*index]) <= rounding());
            at = found.unwrap_or_else(|| panic!("the path has no corner at {point:?}"));
        }
    }
    assert_eq!(at, places.len() - 1, "the path goes on behind its end");
}

#[test]
fn a_square_goes_where_pygcode_says() {
    follows(
        include_str!("gcode/square.gcode"),
        include_str!("gcode/square.expected"),
    );
}

#[test]
fn arcs_in_all_planes_go_where_pygcode_says() {
    follows(
        include_str!("gcode/arcs.gcode"),
        include_str!("gcode/arcs.expected"),
    );
}

#[test]
fn offsets_and_named_places_lead_where_another_interpreter_says() {
    follows(
        include_str!("gcode/offsets.gcode"),
        include_str!("gcode/offsets.expected"),
    );
}

#[test]
fn inches_lead_where_another_interpreter_says() {
    follows(
        include_str!("gcode/inches.gcode"),
        include_str!("gcode/inches.expected"),
    );
}

/// A program's commands in short.
fn short(text: &str) -> Vec<String> {
    let program = compile(text, &machine()).unwrap_or_else(|error| panic!("{text}: {error}"));
    let command = |command: &JobCommand| match command {
        JobCommand::Line(line) => format!("line {:?} {}", line.steps, line.speed_hz),
        JobCommand::RampTo(ramp) => format!("to {}:{} {}", ramp.axis, ramp.position, ramp.speed_hz),
        JobCommand::Laser(laser) => format!("laser {}", laser.power_percent),
        JobCommand::Pause(pause) => format!("pause {}", pause.ms),
        other => format!("{other:?}"),
    };
    program.commands.iter().map(command).collect()
}

#[test]
fn the_first_absolute_way_is_an_approach_and_z_goes_first() {
    assert_eq!(
        short("G0 X1 Y1 Z1\nG1 X2 F600"),
        [
            "to 2:400 4000",
            "to 0:80 8000",
            "to 1:80 6658",
            "line [80, 0, 0] 800"
        ]
    );
    // A relative way needs no beginning, nor does one from a place that has a name.
    assert_eq!(short("G91 G1 X1 F600"), ["line [80, 0, 0] 800"]);
    assert_eq!(short("G92 X10\nG1 X11 F600"), ["line [80, 0, 0] 800"]);
}

#[test]
fn a_beam_burns_on_feeds_only_and_is_off_at_the_end() {
    assert_eq!(
        short("G0X0Y0\nM3 S500\nG1 X1 F600\nG0 X2\nG1 X3\nS250 X4\nG4 P0.5\nM5\nG1 X5"),
        [
            "to 0:0 8000",
            "to 1:0 6658",
            "laser 50",
            "line [80, 0, 0] 800",
            "laser 0",
            "line [80, 0, 0] 8000",
            "laser 50",
            "line [80, 0, 0] 800",
            "laser 25",
            "line [80, 0, 0] 800",
            "pause 500",
            "laser 0",
            "line [80, 0, 0] 800",
        ]
    );
    let last = short("G91 M4 S1000 G1 X1 F600\nM2\nG1 X7").pop();
    assert_eq!(last.as_deref(), Some("laser 0"), "and nothing behind M2");
    assert_eq!(
        short("G91 M3 S1 G1 X1 F600")[0],
        "laser 1",
        "little is not nothing"
    );
}

#[test]
fn feeds_are_along_the_path_and_never_beyond_an_axis() {
    // 3-4-5: the longer axis has 4/5 of the feed.
    assert_eq!(short("G91 G1 X4 Z3 F100")[0], "line [320, 0, 1200] 400");
    // Z goes 600 mm/min at most.
    assert_eq!(short("G91 G1 Z1 F100000")[0], "line [0, 0, 400] 4000");
    // G93: the whole way in half a minute.
    assert_eq!(short("G91 G93 G1 X30 F2")[0], "line [2400, 0, 0] 80");
    // G20: the feed is in inches, too.
    assert_eq!(short("G20 G91 G1 X1 F10")[0], "line [2032, 0, 0] 338");
}

#[test]
fn rounding_to_steps_does_not_add_up() {
    let text = format!("G91 F600\n{}", "G1 X0.003\n".repeat(1_000));
    let program = compile(&text, &machine()).expect("legal");
    let last = places(&program).pop().expect("one");
    assert!((last[0] - 3.0).abs() < 0.01, "{last:?}");
    assert!(
        program.commands.len() < 300,
        "what is no step is no command"
    );
}

#[test]
fn what_is_wrong_is_told_with_line_and_column() {
    for (text, place, words) in [
        ("G0 X1\nG1 X", "line 2, column 4: ", "a number is missing"),
        ("G1 X5", "line 1, column 1: ", "F is missing"),
        ("G0 X0\n\nG1 X5 F0", "line 3, column 7: ", "more than 0"),
        ("G5 X1", "line 1, column 1: ", "G5 is not known"),
        ("G0 X1 W2", "line 1, column 7: ", "`W` means nothing"),
        ("G0 X1 X2", "line 1, column 7: ", "twice"),
        ("G0 G1 X1", "line 1, column 4: ", "same kind"),
        ("G0 A1", "line 1, column 4: ", "no axis A"),
        (
            "G0 X1 P3",
            "line 1, column 7: ",
            "nothing in this line uses P",
        ),
        (
            "G0 X0 Y0\nG2 X1 Y1 F9",
            "line 2, column 1: ",
            "needs I and J",
        ),
        (
            "G0 X0 Y0\nG2 X9 Y0 I1 F9",
            "line 2, column 1: ",
            "does not lie on the arc",
        ),
        (
            "G2 X1 Y1 R5 F9",
            "line 1, column 1: ",
            "nobody knows where X is",
        ),
        (
            "M3 S5\nG1 X1 F9",
            "line 2, column 1: ",
            "nobody knows where X is",
        ),
        ("G92 X1\nG53 G0 X1", "line 2, column 8: ", "G92 named"),
        ("G53 G2 X1 I1 F9", "line 1, column 1: ", "G0 and G1 only"),
        ("G93\nG91 G1 X1", "line 2, column 5: ", "its own F"),
        ("S2000", "line 1, column 1: ", "not within 0 to 1000"),
        ("G4", "line 1, column 1: ", "needs P"),
        ("G80\nX1", "line 2, column 1: ", "G80"),
        ("M6", "line 1, column 1: ", "no tool changer"),
        ("M6 T1", "line 1, column 1: ", "tool"),
        ("M8", "line 1, column 1: ", "coolant"),
        ("G0 X1 (open\nG0 X2", "line 1, column 7: ", "not closed"),
        ("(nothing)\n\n", "line 2, column 1: ", "does nothing"),
        ("G0 X1e300", "line 1, column 6: ", "means nothing"),
        ("G0 X99999999999999999999", "line 1, column 1: ", "too far"),
        (
            "G0 X0\nG1 X99999999 F100",
            "line 2, column 1: ",
            "too many for one line",
        ),
    ] {
        let error = compile(text, &machine()).expect_err(text).to_string();
        assert!(error.starts_with(place), "{text:?}: {error}");
        assert!(error.contains(words), "{text:?}: {error}");
    }
}

#[test]
fn a_way_beyond_the_travel_is_refused_also_in_the_middle_of_an_arc() {
    let mut machine = machine();
    machine.travel_mm = Some(vec![[0.0, 20.0], [-1.0, 20.0], [-5.0, 5.0]]);
    let error = |text: &str| compile(text, &machine).expect_err(text).to_string();
    assert!(compile("G0 X20 Y-1 Z5\nG0 X0", &machine).is_ok());
    assert!(error("G0 X20.1").contains("travel is 0 to 20 mm"));
    // Half a circle below the line between two legal places.
    let arc = error("G0 X0 Y0\nG3 X10 Y0 I5 J0 F100");
    assert!(
        arc.starts_with("line 2, column 1: Y would go to -1."),
        "{arc}"
    );
}

#[test]
fn a_preview_tells_time_way_and_bounds() {
    let text = "G0 X0 Y0\nG1 X30 F1800\nG1 Y-40\nG1 X0 Y0\nG4 P2";
    let preview = compile(text, &machine()).expect("legal").preview;
    // 120 mm at 30 mm/s, three corners, and the dwell; the approach is not known.
    assert!((6.0..6.7).contains(&preview.time_s), "{}", preview.time_s);
    assert!((preview.way_mm - 120.0).abs() < 0.1, "{}", preview.way_mm);
    assert_eq!(preview.bounds[&'X'].machine_mm, Some([0.0, 30.0]));
    assert_eq!(preview.bounds[&'Y'].machine_mm, Some([-40.0, 0.0]));
    assert!(!preview.bounds.contains_key(&'Z'));
    let preview = compile("G91 G0 X5\nX-7", &machine())
        .expect("legal")
        .preview;
    assert_eq!(preview.bounds[&'X'].from_begin_mm, Some([-2.0, 5.0]));
}

#[test]
fn a_hundred_thousand_lines_take_no_long_time_and_a_million_commands_are_too_many() {
    let mut text = "G91 F6000\n".to_owned();
    text += &"G1 X0.1 Y0.1\nG1 X0.1 Y-0.1\n".repeat(50_000);
    let program = compile(&text, &machine()).expect("legal");
    assert_eq!(program.commands.len(), 100_000);
    let mut tight = machine();
    tight.arc_tolerance_mm = 0.000_1;
    let circles = format!("G91 F6000\n{}", "G2 I500 J0\n".repeat(1_000));
    let error = compile(&circles, &tight).expect_err("too much").to_string();
    assert!(error.contains("more than 1000000 commands"), "{error}");
}

#[test]
fn any_text_is_a_program_or_an_error_and_never_a_panic() {
    let alphabet: Vec<char> = "GMXYZAIJKRFPSTNO0123456789.-+ \n()%;/#[]äe\u{0}"
        .chars()
        .collect();
    let seed = 20_261_122_u64;
    let mut random = seed;
    for run in 0..20_000 {
        let mut text = String::new();
        for _ in 0..24 {
            random = random
                .wrapping_mul(6_364_136_223_846_793_005)
                .wrapping_add(1);
            text.push(alphabet[(random >> 33) as usize % alphabet.len()]);
        }
        let outcome = std::panic::catch_unwind(|| compile(&text, &machine()).is_ok());
        assert!(outcome.is_ok(), "seed {seed}, run {run}: {text:?}");
    }
}

#[test]
fn a_job_in_gcode_is_for_one_node_whose_machine_is_known() {
    let left = NodeId::new("left").expect("legal");
    let machines = Machines::from([(left, machine())]);
    let parse =
        |pattern: &str, encoding: &str| parse_for(pattern, encoding, b"G91 G1 X1 F600", &machines);
    let parsed = parse("left", "text/x-gcode;id=part-7");
    let request = parsed.request.expect("a job");
    assert_eq!(request.id, JobId::new("part-7").ok());
    assert!(matches!(&request.work, Work::Commands(commands) if commands.len() == 1));
    assert!(request.check().is_ok());
    // A client without a number for the encoding.
    assert!(parse("left", "zenoh/bytes;text/x-gcode").request.is_ok());
    for (pattern, encoding, code, words) in [
        (
            "right",
            "text/x-gcode",
            ErrorCode::BadCommand,
            "[node.right]",
        ),
        ("*", "text/x-gcode", ErrorCode::BadCommand, "one node"),
        ("left", "text/x-gcode;id=A", ErrorCode::BadId, "id: "),
        ("left", "text/x-gcode;x", ErrorCode::BadJson, "no schema"),
    ] {
        let error = parse(pattern, encoding).request.expect_err(encoding);
        assert_eq!(error.code, code, "{error}");
        assert!(error.message.contains(words), "{error}");
    }
}

#[test]
fn m0_and_m1_rest_until_somebody_resumes_and_the_beam_comes_back_behind_them() {
    let program = compile("G91 F600 M3 S500\nG1 X1\nM0\nX1\nm01\nX1 M5\n", &machine());
    let commands = program.expect("legal").commands;
    let words: Vec<&str> = commands.iter().map(JobCommand::word).collect();
    assert_eq!(
        words,
        [
            "laser",
            "line",
            "wait_resume",
            "line",
            "wait_resume",
            "laser",
            "line"
        ]
    );
    let error = compile("M0 M1\n", &machine()).expect_err("two of a kind");
    assert_eq!((error.line, error.column), (1, 4));
}

#[test]
fn parts_of_a_synchronized_job_may_be_gcode_each_for_its_own_machine() {
    let node = |name: &str| NodeId::new(name).expect("legal");
    let coarse = Machine::alike(3, 10.0, 6_000.0, 500.0);
    let machines = Machines::from([(node("left"), machine()), (node("right"), coarse)]);
    let read = |text: &str| parse_group_for("application/json", text.as_bytes(), &machines);
    let both = r#"{"id":"g","nodes":{"left":{"gcode":"G91 G0 X1"},"right":{"gcode":"G91 G0 X1"}}}"#;
    let request = read(both).request.expect("legal");
    let steps = |name: &str| match &request.nodes[&node(name)] {
        Work::Commands(commands) => match &commands[..] {
            [JobCommand::Line(line)] => line.steps[0],
            other => panic!("{other:?}"),
        },
        other => panic!("{other:?}"),
    };
    assert_eq!((steps("left"), steps("right")), (80, 10));
    let wrong = both.replace("G91 G0 X1\"}}", "G91\\nG0 Q1\"}}");
    let error = read(&wrong).request.expect_err("Q");
    assert_eq!(
        error.message,
        "nodes.right.gcode: line 2, column 4: `Q` means nothing here"
    );
    let error = read(&both.replace("right", "third"))
        .request
        .expect_err("unknown");
    assert!(
        error
            .message
            .starts_with("nodes.third.gcode: the gateway does not know")
    );
}
