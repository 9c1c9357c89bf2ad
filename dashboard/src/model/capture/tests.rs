//! Captures: what is read, what is measured, what is refused.

use super::{
    rules::{Limits, Rule, check},
    *,
};

/// As the emulator writes it: units of 100 ps, one character a pin.
const VCD: &str = "\
$comment pins of node left, 16 MHz ticks since its boot $end
$timescale 100 ps $end
$scope module left $end
$var wire 1 ! step0 $end
$var wire 1 \" dir0 $end
$var wire 1 # step1 $end
$var wire 1 $ dir1 $end
$upscope $end
$enddefinitions $end
#0
$dumpvars
0!
0\"
0#
0$
$end
#10000
1\"
#100000
1!
#120000
0!
#10100000
1!
#10120000
0!
#15100000
1!
#15120000
0!
#15130000
0\"
#15133000
1!
#15134000
0!
#20000000
";

fn read(text: &str) -> Capture {
    Capture::parse("left.vcd", text).expect("a dump")
}

#[test]
fn a_dump_gives_edges_steps_and_positions() {
    let capture = read(VCD);
    assert_eq!(capture.end_ps, 2_000_000_000);
    assert_eq!(capture.axes.len(), 2);
    let axis = &capture.axes[0];
    assert_eq!((axis.name.as_str(), axis.step_edges.len()), ("0", 8));
    let positions: Vec<i64> = axis.steps.iter().map(|step| step.position_steps).collect();
    assert_eq!(positions, [1, 2, 3, 2]);
    assert_eq!(axis.steps[0].at_ps, 10_000_000);
    assert!(capture.axes[1].steps.is_empty());
}

#[test]
fn interval_speed_and_acceleration_are_measured_between_steps() {
    let axis = &read(VCD).axes[0];
    let reading = axis.reading(500_000_000);
    assert_eq!(reading.position_steps, 1);
    assert_eq!(reading.interval_s, Some(0.001));
    assert_eq!(reading.speed_hz, Some(1_000.0));
    // 2,000 steps/s follow, their middles 0.75 ms apart.
    let acceleration = reading.acceleration_hz2.expect("three steps");
    assert!(
        (acceleration - 1_000.0 / 0.000_75).abs() < 1e-3,
        "{acceleration}"
    );
    assert_eq!(axis.reading(0), Reading::default());
    let last = axis.reading(u64::MAX);
    assert_eq!((last.position_steps, last.speed_hz), (2, None));
    let reversed = axis.reading(1_512_000_000).speed_hz.expect("between two");
    assert!(reversed < 0.0, "the last step goes back: {reversed}");
}

#[test]
fn broken_rules_are_found_at_their_places() {
    let capture = read(VCD);
    let findings = check(&capture, &Limits::default());
    let rules: Vec<_> = findings.listed.iter().map(|found| found.rule).collect();
    assert_eq!(rules, [Rule::Low, Rule::Setup, Rule::High]);
    let setup = findings.listed[1];
    assert_eq!((setup.at_ps, setup.was_ps), (1_513_000_000, 300_000));
    assert_eq!(findings.count, 3);
    let generous = Limits {
        high_min_ns: 100,
        low_min_ns: 100,
        setup_min_ns: 20,
        hold_min_ns: 20,
    };
    assert_eq!(check(&capture, &generous).count, 0);
    let strict = Limits {
        hold_min_ns: 4_000,
        ..generous
    };
    let held = check(&capture, &strict);
    assert_eq!(held.listed[0].rule, Rule::Hold);
    assert_eq!(held.listed[0].was_ps, 3_000_000);
}

#[test]
fn a_table_of_an_analyser_is_the_same() {
    let text = "; saved by an analyser\nTime [us],X_STEP,X_DIR,uart\n-1,0,0,1\n0,0,1,1\n9,1,1,0\n11,0,1,0\n";
    let capture = Capture::parse("x.CSV", text).expect("a table");
    assert_eq!(capture.other_signals, 1);
    assert_eq!(capture.axes[0].name, "x");
    let steps = &capture.axes[0].steps;
    let expected = Step {
        at_ps: 10_000_000,
        position_steps: 1,
    };
    assert_eq!(steps[..], [expected], "the first line is zero");
    let seconds = Capture::parse("x.csv", "time,step0\n0,0\n0.5,1\n").expect("a table");
    assert_eq!(seconds.axes[0].steps[0].at_ps, 500_000_000_000);
}

#[test]
fn garbage_names_its_line_and_panics_nowhere() {
    let cases = [
        ("a.vcd", String::new(), "no $enddefinitions"),
        ("a.vcd", "hello".to_owned(), "line 1: `hello`"),
        ("a.vcd", "$timescale 100 ps".to_owned(), "$end is missing"),
        (
            "a.vcd",
            VCD.replace("100 ps", "3 weeks"),
            "line 2: timescale",
        ),
        ("a.vcd", VCD.replace("#120000\n", "#-5\n"), "line 21: `#-5`"),
        (
            "a.vcd",
            VCD.replace("#120000\n", "#1\n"),
            "line 21: time goes back",
        ),
        (
            "a.vcd",
            VCD.replace("#120000\n", "1?\n"),
            "`?` was not declared",
        ),
        (
            "a.vcd",
            VCD.replace("#120000\n", "#18446744073709551615\n"),
            "too large",
        ),
        ("a.vcd", VCD.replace("step", "clk"), "no edge of a step pin"),
        ("a.vcd", VCD.replace("1!", "é!"), "is no value change"),
        ("a.csv", String::new(), "empty"),
        ("a.csv", "0,1,1\n".to_owned(), "must name the columns"),
        ("a.csv", "time,step0\nx,1\n".to_owned(), "line 2: the time"),
        (
            "a.csv",
            "time,step0\nNaN,1\n".to_owned(),
            "line 2: the time",
        ),
        ("a.csv", "time,step0\n0,1\n-1,0\n".to_owned(), "line 3"),
        ("a.csv", "time,step0\n1e300,1\n".to_owned(), "too large"),
        (
            "a.csv",
            "time,step0\n0,high\n".to_owned(),
            "neither 0 nor 1",
        ),
        (
            "a.csv",
            "time,step0,dir0\n0,1\n".to_owned(),
            "column is missing",
        ),
    ];
    for (name, text, expected) in cases {
        let error = Capture::parse(name, &text).expect_err(&text);
        assert!(error.contains(expected), "{error} instead of {expected}");
    }
}

#[test]
fn a_dump_cut_anywhere_is_read_or_refused() {
    for end in 0..VCD.len() {
        let cut = &VCD[..end];
        if let Ok(capture) = Capture::parse("cut.vcd", cut) {
            assert!(!capture.axes[0].steps.is_empty());
        }
    }
}

#[test]
fn unknown_levels_change_nothing_and_vectors_of_one_bit_count() {
    let capture = read(&VCD.replace("#10100000\n1!", "#10100000\nx!\nz!\nb1 !"));
    assert_eq!(capture.axes[0].steps.len(), 4);
}

#[test]
fn the_number_of_edges_has_a_bound() {
    let mut builder = Builder::new();
    let axis = builder.capture.axis("0").expect("room");
    builder.edges = EDGES_MAX - 1;
    assert_eq!(builder.level((axis, Pin::Step), 1, true), Ok(()));
    let full = builder.level((axis, Pin::Step), 2, false);
    assert!(full.expect_err("full").contains("more than 4000000 edges"));
    let axes = (0..=AXES_MAX).map(|axis| format!("$var wire 1 {axis} step{axis} $end\n"));
    let text: String = axes.collect();
    let error = Capture::parse("a.vcd", &text).expect_err("too many");
    assert!(error.contains("more than 32 axes"), "{error}");
}

#[test]
fn a_screen_gets_no_more_corners_than_it_has_columns() {
    let edges: Vec<Edge> = (0..100_000)
        .map(|index| Edge {
            at_ps: index * 1_000,
            high: index % 2 == 0,
        })
        .collect();
    let all = corners(&edges, 0, 100_000_000, 500);
    assert!((900..=4 * 500 + 8).contains(&all.len()), "{}", all.len());
    let few = corners(&edges, 10_500, 12_500, 500);
    let expected = [
        (10_500, true),
        (11_000, true),
        (11_000, false),
        (12_000, false),
        (12_000, true),
        (12_500, true),
    ];
    assert_eq!(few, expected);
}
