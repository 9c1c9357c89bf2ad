//! A stop at any moment: silence on the pins, the exact position in every record, and nothing more
//! until a release.

use emulator::{oracle, pins::Pin};
use keys::{NodeId, StopMode, record::JobState};
use serde_json::json;
use tests::{
    World,
    network::Delay,
    world::{MS, S},
};

fn moves(name: &str, count: usize) -> serde_json::Value {
    let one = |index: usize| {
        let steps = if index.is_multiple_of(2) { 700 } else { -300 };
        json!({"move": {"axis": index % 2, "delay_us": 40, "steps": steps}})
    };
    json!({"id": name, "commands": (0..count).map(one).collect::<Vec<_>>()})
}

#[test]
fn a_stop_leaves_exact_positions_in_node_and_record_and_refuses_what_follows() {
    for (seed, mode) in (0..40).zip([StopMode::Halt, StopMode::Decelerate].into_iter().cycle()) {
        let mut world = World::with_nodes(seed, &["left", "right"]);
        let _ = world.submit("left", &moves("first", 200));
        let _ = world.submit("left", &moves("second", 10));
        let _ = world.submit("right", &moves("other", 20));
        let us = world.random.below(2 * S);
        world.run_for(20 * MS + us);
        world.stop("left", mode);
        world.run_for(2 * S);

        let first = world.record("first");
        assert_eq!(first.state, JobState::Failed, "seed {seed}");
        let code = first.error.as_ref().expect("a reason").code;
        assert_eq!(code.as_str(), "stopped");
        assert_eq!(world.record("second").state, JobState::Failed);
        assert_eq!(world.record("other").state, JobState::Succeeded);
        let life = world.node("left").life();
        oracle::check_life(&life).unwrap_or_else(|found| panic!("seed {seed}: {found:?}"));
        let result = first.result.as_ref().expect("a result");
        assert_eq!(result.position, life.counted_steps, "seed {seed}");
        let left = &world.node_records[&NodeId::new("left").expect("legal")];
        assert_eq!(left.state.as_str(), "stopped");
        assert_eq!(left.position, life.counted_steps);
        assert!(left.stopped.is_some());

        let refused = world.submit("left", &moves("refused", 1));
        world.run_for(100 * MS);
        let answers = world.answers(refused);
        assert_eq!(
            answers.replies[0].1["error"]["code"], "stopped",
            "seed {seed}"
        );
        let _ = world.release("left");
        world.run_for(500 * MS);
        let _ = world.submit("left", &moves("after", 3));
        world.run_for(S);
        assert_eq!(
            world.record("after").state,
            JobState::Succeeded,
            "seed {seed}"
        );
        oracle::check_life(&world.node("left").life()).expect("good pulses");
    }
}

#[test]
fn after_a_halt_no_edge_leaves_whatever_the_network_still_delivers() {
    for seed in 0..40 {
        let mut world = World::with_nodes(seed, &["left"]);
        world.faults.delay = Delay::Uniform {
            us_min: MS,
            us_max: 60 * MS,
        };
        world.faults.duplicate_per_mille = 300;
        world.faults.reorder_per_mille = 100;
        let _ = world.submit("left", &moves("first", 600));
        let us = world.random.below(S);
        world.run_for(us);
        world.stop("left", StopMode::Halt);
        world.run_for(10 * S);
        let life = world.node("left").life();
        let stopped_at = life.stops[0].at.0 * 16;
        let late = life.edges.iter().filter(|edge| {
            matches!(edge.pin, Pin::Step(_)) && edge.level && edge.at_ticks > stopped_at
        });
        assert_eq!(late.count(), 0, "seed {seed}");
    }
}
