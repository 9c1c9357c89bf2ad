//! Hold, resume and speed the whole way: from a client's wish to a machine that rests on its path, and
//! back as a receipt and in the node's record.

use emulator::oracle;
use gateway::fleet::{event::ReplyTo, node::Wish};
use keys::{
    NodeId, StopMode,
    record::{JobState, NodeWord},
};
use serde_json::{Value, json};
use tests::{
    Faults, World,
    network::Delay,
    world::{MS, S},
};

const HOLD: Wish = Wish {
    hold: Some(true),
    percent: None,
};
const RESUME: Wish = Wish {
    hold: Some(false),
    percent: None,
};

fn speed(percent: u16) -> Wish {
    Wish {
        hold: None,
        percent: Some(percent),
    }
}

/// A world with a node that draws a line of ten seconds, and is two seconds into it.
fn drawing(seed: u64) -> World {
    let mut world = World::with_nodes(seed, &["left"]);
    world.run_for(S);
    let job = json!({"id": "draw", "commands": [
        {"line": {"steps": [20_000, 8_000], "speed_hz": 2000, "accel": 10_000}}]});
    let _ = world.submit("left", &job);
    world.run_for(2 * S);
    assert_eq!(world.record("draw").state, JobState::Running);
    world
}

/// The one reply to a get, when it has come.
fn reply(world: &mut World, of: ReplyTo) -> (bool, Value) {
    world.run_until(5 * S, |world| world.answers(of).ended);
    let answers = world.answers(of);
    assert!(answers.ended && answers.replies.len() == 1, "{answers:?}");
    let (key, json) = &answers.replies[0];
    (key.is_some(), json.clone())
}

fn ask(world: &mut World, wish: Wish) -> (bool, Value) {
    let of = world.pace("left", wish);
    reply(world, of)
}

fn state(world: &World) -> Value {
    let record = &world.node_records[&NodeId::new("left").expect("legal")];
    json!([record.state, record.pace])
}

fn position(world: &World) -> i64 {
    world.node("left").status().axes[0].position_steps
}

/// Lets the job end well, and judges it.
fn finish(world: &mut World) {
    world.run_until(60 * S, |world| world.record("draw").state.is_final());
    let record = world.record("draw");
    assert_eq!(record.state, JobState::Succeeded, "{record:?}");
    let result = record.result.as_ref().expect("a result");
    assert_eq!(result.position, [20_000, 8_000]);
    oracle::check_life(&world.node("left").life()).expect("good pulses");
}

#[test]
fn a_client_holds_resumes_and_changes_speed_and_reads_it_in_the_record() {
    let mut world = drawing(1);
    assert_eq!(state(&world), json!(["running", null]));
    let receipt = |hold, percent| {
        (
            true,
            json!({"node": "left", "hold": hold, "percent": percent}),
        )
    };
    assert_eq!(ask(&mut world, HOLD), receipt(true, 100));
    world.run_for(2 * S);
    assert_eq!(
        state(&world),
        json!(["paused", {"hold": true, "percent": 100}])
    );
    assert_eq!(world.record("draw").state, JobState::Running);
    let held = position(&world);
    assert_eq!(ask(&mut world, speed(50)), receipt(true, 50));
    // Held already: the same answer, and nothing else.
    assert_eq!(ask(&mut world, HOLD), receipt(true, 50));
    world.run_for(60 * S);
    assert_eq!(position(&world), held);
    assert_eq!(ask(&mut world, RESUME), receipt(false, 50));
    world.run_for(2 * S);
    assert_eq!(
        state(&world),
        json!(["running", {"hold": false, "percent": 50}])
    );
    // Two seconds at half of 2,000 steps a second, less a ramp.
    let way = position(&world) - held;
    assert!((1_800..2_100).contains(&way), "{way}");
    finish(&mut world);
}

#[test]
fn who_cannot_be_held_says_why() {
    let mut world = drawing(2);
    let code = |(is_receipt, json): (bool, Value)| {
        assert!(!is_receipt);
        json["error"]["code"].as_str().expect("a code").to_owned()
    };
    let of = world.pace("right", HOLD);
    assert_eq!(code(reply(&mut world, of)), "unknown_node");
    world.stop("left", StopMode::Halt);
    world.run_for(S);
    assert_eq!(code(ask(&mut world, HOLD)), "stopped");
    assert_eq!(code(ask(&mut world, RESUME)), "stopped");
    let _ = world.release("left");
    world.run_for(S);
    assert!(ask(&mut world, HOLD).0);
    world.break_link("left", 60 * S);
    world.run_for(20 * S);
    assert_eq!(code(ask(&mut world, RESUME)), "node_offline");
}

#[test]
fn a_stop_beats_a_hold_and_ends_the_job() {
    let mut world = drawing(3);
    assert!(ask(&mut world, HOLD).0);
    world.run_for(2 * S);
    let held = position(&world);
    world.stop("left", StopMode::Decelerate);
    world.run_for(2 * S);
    assert_eq!(state(&world), json!(["stopped", null]));
    assert_eq!(world.record("draw").state, JobState::Failed);
    let _ = world.release("left");
    world.run_for(5 * S);
    assert_eq!(state(&world), json!(["idle", null]));
    assert_eq!(position(&world), held);
}

#[test]
fn a_cancel_and_a_timeout_end_a_job_that_is_held() {
    for timeout in [false, true] {
        let mut world = World::with_nodes(4, &["left"]);
        let job = json!({"id": "draw", "timeout_s": 4.0, "commands": [
            {"line": {"steps": [20_000, 8_000], "speed_hz": 2000, "accel": 10_000}}]});
        let _ = world.submit("left", &job);
        world.run_for(S);
        assert!(ask(&mut world, HOLD).0);
        if !timeout {
            world.run_for(S);
            let _ = world.cancel("draw");
        }
        world.run_for(6 * S);
        let expected = if timeout {
            JobState::TimedOut
        } else {
            JobState::Canceled
        };
        assert_eq!(world.record("draw").state, expected);
    }
}

#[test]
fn the_link_that_goes_while_held_stops_the_node_and_the_record_tells_it() {
    let mut world = drawing(5);
    assert!(ask(&mut world, HOLD).0);
    world.run_for(S);
    let held = position(&world);
    world.break_link("left", 8 * S);
    world.run_for(20 * S);
    assert_eq!(state(&world), json!(["stopped", null]));
    assert_eq!(position(&world), held);
    assert_eq!(world.record("draw").state, JobState::Failed);
}

#[test]
fn a_hold_is_the_nodes_own_and_survives_the_gateway() {
    let mut world = drawing(6);
    assert!(ask(&mut world, HOLD).0);
    assert!(ask(&mut world, speed(150)).0);
    world.run_for(S);
    let held = position(&world);
    world.node_records.clear();
    world.kill_gateway(S);
    world.run_for(5 * S);
    assert_eq!(
        state(&world),
        json!(["paused", {"hold": true, "percent": 150}])
    );
    assert_eq!(position(&world), held);
    assert!(ask(&mut world, RESUME).0);
    finish(&mut world);
}

#[test]
fn doubled_late_and_reordered_words_leave_it_as_the_last_client_wanted() {
    for seed in 1..=20 {
        let mut world = drawing(100 + seed);
        world.faults = Faults {
            delay: Delay::Uniform {
                us_min: 200,
                us_max: 40_000,
            },
            lose_per_mille: 0,
            duplicate_per_mille: 300,
            reorder_per_mille: 200,
        };
        // Without waiting for the receipts.
        for number in 0..6_u64 {
            let _ = world.pace("left", if number % 2 == 0 { HOLD } else { RESUME });
            world.run_for((number * seed * 7) % 60 * MS);
        }
        assert!(ask(&mut world, HOLD).0, "seed {seed}");
        world.run_for(3 * S);
        let record = &world.node_records[&NodeId::new("left").expect("legal")];
        assert_eq!(record.state, NodeWord::Paused, "seed {seed}");
        let held = position(&world);
        world.run_for(3 * S);
        assert_eq!(position(&world), held, "seed {seed}");
        assert!(ask(&mut world, RESUME).0, "seed {seed}");
        finish(&mut world);
    }
}
