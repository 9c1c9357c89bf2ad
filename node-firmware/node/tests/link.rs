//! What a node does when nobody can reach it.

mod rig;

use keys::{NodeState, StopReason, status::FaultCode};
use node::LinkLoss;
use rig::{Rig, config, steps};

fn lost_while_moving(link_loss: LinkLoss) -> Rig {
    let mut config = config();
    config.link_loss = link_loss;
    let mut rig = Rig::new(config);
    let _ = rig.batch(&[steps(100_000)]);
    rig.run_until(500_000);
    rig.link(false);
    rig.run_until(2_499_000);
    assert_eq!(rig.state(), NodeState::Running);
    assert!(rig.status().faults.is_empty());
    rig.run_until(2_500_000);
    assert_eq!(rig.status().faults[0].code, FaultCode::LINK_LOST);
    assert_eq!(rig.status().faults[0].at.0, 2_500_000);
    rig
}

#[test]
fn finish_goes_on_to_the_last_step() {
    let mut rig = lost_while_moving(LinkLoss::Finish);
    assert_eq!(rig.state(), NodeState::Running);
    rig.run_until(11_000_000);
    assert_eq!(rig.position(), 100_000);
    assert_eq!(rig.state(), NodeState::Idle);
    rig.link(true);
    let line = "the link was gone for 10500 ms while moving: went on with what the queue held";
    assert!(
        rig.lines().iter().any(|told| told == line),
        "{:?}",
        rig.lines()
    );
}

#[test]
fn decelerate_stops_by_its_ramp_and_latches() {
    let mut rig = lost_while_moving(LinkLoss::Decelerate);
    assert_eq!(rig.state(), NodeState::Stopped);
    rig.run_until(6_000_000);
    let report = rig.status().stop.expect("a report");
    assert_eq!(report.reason, StopReason::Link);
    assert_eq!(report.positions_steps[0], rig.position());
    assert!(rig.position() >= 25_000 && rig.position() < 100_000);
    rig.link(true);
    let (_, status) = rig.statuses().last().cloned().expect("a status at once");
    assert_eq!(status.state, NodeState::Stopped);
    let line = "the link was gone for 5500 ms while moving: decelerated and stopped";
    assert!(
        rig.lines().iter().any(|told| told == line),
        "{:?}",
        rig.lines()
    );
}

#[test]
fn halt_stops_at_that_instant_and_latches() {
    let rig = lost_while_moving(LinkLoss::Halt);
    assert_eq!(rig.state(), NodeState::Stopped);
    assert!((24_999..=25_001).contains(&rig.position()));
    assert_eq!(
        rig.status().stop.expect("a report").reason,
        StopReason::Link
    );
}

#[test]
fn a_link_that_comes_back_in_time_changes_nothing() {
    let mut rig = Rig::new(config());
    let _ = rig.batch(&[steps(100_000)]);
    for _ in 0..3 {
        rig.run_for(500_000);
        rig.link(false);
        rig.run_for(1_900_000);
        rig.link(true);
    }
    rig.run_until(11_000_000);
    assert_eq!(rig.position(), 100_000);
    assert!(rig.status().faults.is_empty());
}

#[test]
fn a_lost_link_at_rest_latches_nothing() {
    let mut rig = Rig::new(config());
    rig.link(false);
    rig.run_for(10_000_000);
    assert_eq!(rig.state(), NodeState::Idle);
    assert!(rig.status().faults.is_empty());
    rig.link(true);
    assert_eq!(rig.state(), NodeState::Idle);
}

#[test]
fn without_a_link_nothing_leaves_and_with_it_a_status_comes_at_once() {
    let mut rig = Rig::new(config());
    rig.link(false);
    let before = rig.sent.len();
    let header = rig.next_header(1);
    let bytes = rig::batch_bytes(header, &[steps(10)]);
    for _ in 0..50 {
        rig.node.handle(keys::NodeTopic::Batch, &bytes, rig.now);
        rig.run_for(100_000);
    }
    assert_eq!(rig.sent.len(), before);
    rig.link(true);
    assert_eq!(rig.sent[before].1, keys::NodeTopic::Status);
    assert!(rig.acks().is_empty());
}
