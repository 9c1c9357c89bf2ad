//! The link goes while the machine moves: its policy, what clients are told, and what happens when
//! it is back.

use emulator::{EmulatorConfig, oracle};
use keys::{NodeId, NodeState, StopReason, record::JobState};
use node::LinkLoss;
use serde_json::json;
use tests::{
    World,
    world::{MS, S},
};

fn world(policy: LinkLoss) -> World {
    world_with(policy, 4_000)
}

/// A node on its way through this many steps, 1 ms apart.
fn world_with(policy: LinkLoss, steps: u32) -> World {
    let mut world = World::new(3);
    let mut config = EmulatorConfig::new(NodeId::new("left").expect("legal"));
    config.link_loss = policy;
    world.add_node(config, 20_000);
    world.run_for(100 * MS);
    let moves = json!([{"move": {"axis": 0, "delay_us": 1000, "steps": steps}}]);
    let _ = world.submit("left", &json!({"id": "job", "commands": moves}));
    world.run_for(500 * MS);
    world
}

#[test]
fn a_short_loss_changes_nothing() {
    let mut world = world(LinkLoss::Decelerate);
    world.break_link("left", 700 * MS);
    world.run_for(6 * S);
    assert_eq!(world.record("job").state, JobState::Succeeded);
    oracle::check_life(&world.node("left").life()).expect("good pulses");
}

#[test]
fn by_default_a_machine_slows_down_and_stops_when_the_link_stays_away() {
    // Node and gateway notice within three seconds; then the node waits for two more.
    let mut world = world_with(LinkLoss::Decelerate, 20_000);
    world.break_link("left", 10 * S);
    world.run_for(7 * S);
    assert_eq!(
        world.record("job").state,
        JobState::Lost,
        "nobody knows better"
    );
    assert_eq!(world.node("left").status().state, NodeState::Stopped);
    world.run_for(4 * S);
    let record = world.record("job");
    assert_eq!(
        record.state,
        JobState::Failed,
        "the node's own report decides"
    );
    let life = world.node("left").life();
    assert_eq!(life.stops[0].reason, StopReason::Link);
    assert_eq!(
        record.result.as_ref().expect("a result").position,
        life.counted_steps
    );
    oracle::check_life(&life).expect("good pulses");
}

#[test]
fn with_the_policy_finish_the_job_succeeds_although_nobody_could_see_it() {
    let mut world = world(LinkLoss::Finish);
    world.break_link("left", 10 * S);
    world.run_for(8 * S);
    assert_eq!(world.record("job").state, JobState::Lost);
    world.run_for(3 * S);
    assert_eq!(world.record("job").state, JobState::Succeeded);
    assert_eq!(world.node("left").status().axes[0].position_steps, 4_000);
}

#[test]
fn a_lost_job_can_be_canceled_and_the_nodes_report_does_not_change_that() {
    let mut world = world(LinkLoss::Finish);
    world.break_link("left", 10 * S);
    world.run_for(8 * S);
    let _ = world.cancel("job");
    world.run_for(S);
    assert_eq!(world.record("job").state, JobState::Canceled);
    world.run_for(4 * S);
    assert_eq!(world.record("job").state, JobState::Canceled);
}

#[test]
fn a_node_that_restarts_fails_its_job_and_the_rest_is_not_replayed() {
    let mut world = world(LinkLoss::Decelerate);
    world.reboot("left", 300 * MS);
    world.run_for(5 * S);
    let record = world.record("job");
    assert_eq!(record.state, JobState::Failed);
    let message = &record.error.as_ref().expect("a reason").message;
    assert!(message.contains("restarted"), "{message}");
    assert_eq!(world.node("left").status().accepted_commands, 0);
    assert_eq!(world.node("left").step_count(keys::AxisId(0)), 0);
}
