//! G-code the whole way to the pins: every pulse judged, the tool where the program ends, and the time
//! that the preview told.

use emulator::{oracle, pins::Pin};
use gateway::job::gcode::{Machine, compile};
use keys::{AxisId, record::JobState};
use serde_json::json;
use tests::{World, world::S};

/// Ticks of the virtual pulse unit in a second.
const TICKS_PER_S: f64 = 16e6;

const PART: &str = "\
G21 G90
G0 X0 Y0        ; that is where it is
G1 X40 F3000
G3 X50 Y10 J10
G1 Y30
G2 X40 Y40 I-10 J0
G1 X10
X0 Y20 F1500
G2 X0 Y20 I8 J0
G91 G20
G1 X0.5 Y-0.25
G90 G21
G0 X0 Y0
M30
";

#[test]
fn a_part_in_gcode_ends_where_it_should_and_takes_the_time_that_was_told() {
    let machine = Machine::alike(2, 80.0, 6_000.0, 800.0);
    let program = compile(PART, &machine).expect("legal");
    let mut world = World::with_nodes(3, &["left"]);
    let job = json!({"id": "part", "commands": program.commands});
    let _ = world.submit("left", &job);
    world.run_until(60 * S, |world| {
        let records = world.records.values().next();
        records.is_some_and(|records| records.last().is_some_and(|last| last.state.is_final()))
    });
    let record = world.record("part");
    assert_eq!(record.state, JobState::Succeeded, "{:?}", record.error);
    assert_eq!(record.result.as_ref().expect("ended").position, [0, 0]);
    let life = world.node("left").life();
    oracle::check_life(&life).expect("good pulses");
    let steps = life
        .edges
        .iter()
        .filter(|event| event.level && matches!(event.pin, Pin::Step(AxisId(0 | 1))));
    let ticks: Vec<u64> = steps.map(|event| event.at_ticks).collect();
    let (first, last) = (ticks.iter().min(), ticks.iter().max());
    let (first, last) = first.zip(last).expect("it moved");
    let took_s = (last - first) as f64 / TICKS_PER_S;
    let told_s = program.preview.time_s;
    println!("took {took_s:.3} s, told {told_s:.3} s");
    assert!(
        (took_s / told_s - 1.0).abs() < 0.03,
        "took {took_s} s, told {told_s} s"
    );
}
