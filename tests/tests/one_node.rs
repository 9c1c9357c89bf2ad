//! One job through every stage: text, record, batch, ring, segments, symbols, pins, and back.

use emulator::oracle;
use keys::record::JobState;
use serde_json::json;
use tests::{
    World,
    network::Delay,
    world::{MS, S},
};

#[test]
fn a_job_becomes_exact_pulses_and_its_record_comes_back() {
    let mut world = World::with_nodes(1, &["left"]);
    let job = json!({"id": "part-0815", "commands": [
        {"move": {"axis": 0, "delay_us": 500, "steps": -2000}},
        {"sync_move": {"delay_us": [500, 1000], "steps": [2000, 1000]}},
        {"pause": {"ms": 100}}, {"laser": {"power_percent": 50}}, {"lidar_read": {}},
        {"set_position": {"axis": 0, "position": 7}}]});
    let get = world.submit("left", &job);
    world.run_until(S, |world| world.answers(get).ended);
    let receipt = json!({"job": "part-0815", "state": "queued"});
    assert_eq!(world.answers(get).replies[0].1, receipt);
    world.run_until(5 * S, |world| world.record("part-0815").state.is_final());
    let states: Vec<_> = world
        .records
        .values()
        .flatten()
        .map(|record| record.state)
        .collect();
    let mut in_order = states.clone();
    in_order.dedup();
    assert_eq!(
        in_order,
        [
            JobState::Queued,
            JobState::Sent,
            JobState::Running,
            JobState::Succeeded
        ]
    );
    let record = world.record("part-0815");
    assert_eq!((record.progress.done, record.progress.total), (6, 6));
    assert_eq!(
        record.result.as_ref().expect("a result").position,
        [7, 1000]
    );
    let life = world.node("left").life();
    let summary = oracle::check_life(&life).expect("good pulses");
    assert_eq!((summary.commands, summary.steps), (6, vec![4_000, 1_000]));
}

#[test]
fn a_hundred_thousand_commands_pass_a_ring_of_4096_without_a_stall() {
    let mut world = World::with_nodes(2, &["left"]);
    // WiFi: 1 to 20 ms, both ways.
    world.faults.delay = Delay::Uniform {
        us_min: MS,
        us_max: 20 * MS,
    };
    let steps = |index: u32| json!({"move": {"axis": 0, "delay_us": 200 + index % 50, "steps": 1 + index % 5}});
    let commands: Vec<_> = (0..100_000).map(steps).collect();
    let _ = world.submit("left", &json!({"id": "long", "commands": commands}));
    world.run_until(120 * S, |world| {
        let records = world.records.values().next();
        records.is_some_and(|records| records.last().is_some_and(|last| last.state.is_final()))
    });
    let record = world.record("long");
    assert_eq!(record.state, JobState::Succeeded, "{record:?}");
    assert_eq!(record.progress.done, 100_000);
    let life = world.node("left").life();
    assert!(life.status.faults.is_empty(), "{:?}", life.status.faults);
    assert_eq!(life.commands.len(), 100_000);
    // Gaps are the oracle's business: every command follows the one before to the tick.
    let summary = oracle::check_life(&life).expect("good pulses");
    assert_eq!(summary.steps[0], 300_000);
}
