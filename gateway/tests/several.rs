//! Two of a kind, against a fleet in a bottle: two controllers of one name, and another gateway that
//! orders the same nodes about.

mod rig;

use gateway::fleet::{FleetConfig, event::Event};
use keys::{
    BatchAck, Features, LocalMicros, NodeId, NodeTopic, QueueId, Refusal, Status, Verdict, epoch,
    record::{JobState, NodeRecord},
    version,
};
use rig::{Rig, S, moves};

const TWIN_BOOT: u32 = 4_711;

fn left() -> NodeId {
    NodeId::new("left").expect("legal")
}

fn from_left(rig: &mut Rig, topic: NodeTopic, message: &impl serde::Serialize) {
    let mut buffer = [0; 512];
    let payload = version::encode(message, &mut buffer)
        .expect("room")
        .to_vec();
    rig.event(Event::FromNode {
        node: left(),
        topic,
        payload,
    });
}

/// A word of a controller of that name that has been running for so long, µs.
fn speak(rig: &mut Rig, boot: u32, at_us: u64) {
    let status = Status {
        at: LocalMicros(at_us),
        queue: QueueId { boot, flush: 0 },
        state: keys::NodeState::Idle,
        stop: None,
        job: None,
        accepted_commands: 0,
        executed_commands: 0,
        credit_commands: 4_096,
        axes: [keys::AxisStatus::default(); 2].into_iter().collect(),
        faults: heapless::Vec::new(),
        features: Features::BASIC,
        firmware: [0, 1, 0],
        rssi_dbm: None,
        laser_percent: 0,
        lidar_mm: None,
    };
    from_left(rig, NodeTopic::Status, &status);
}

fn codes(rig: &Rig) -> Vec<u16> {
    let record: NodeRecord = rig.fleet.node_record(&left()).expect("known");
    record.faults.iter().map(|fault| fault.code).collect()
}

#[test]
fn two_controllers_of_one_name_are_told_and_get_no_jobs_until_one_has_gone() {
    let mut rig = Rig::with_left();
    rig.run(2 * S);
    // The twin comes, and from then on both speak once a second.
    for second in 0..6 {
        speak(&mut rig, TWIN_BOOT, second * S);
        rig.run(S);
    }
    assert_eq!(codes(&rig), [401]);
    let told = serde_json::to_string(&rig.fleet.node_record(&left())).expect("JSON");
    assert!(
        told.contains("another controller speaks under this name"),
        "{told}"
    );
    let job = rig.accept("left", &moves("a", 5, 10));
    rig.run(2 * S);
    assert_eq!(
        rig.fleet.job(&job).expect("known").state(),
        JobState::Queued
    );
    // It goes; the job runs on the one that is left.
    rig.run(20 * S);
    assert_eq!(codes(&rig), [0_u16; 0]);
    let state = rig.fleet.job(&job).expect("known").state();
    assert_eq!(state, JobState::Succeeded);
}

#[test]
fn a_late_word_from_before_a_reboot_is_no_other_controller() {
    let mut rig = Rig::with_left();
    rig.run(2 * S);
    let before = rig.node("left").queue.boot;
    rig.reboot("left");
    rig.run(2 * S);
    // All that a slow way has kept, in one heap, and once more.
    for _ in 0..2 {
        for late in 0..5 {
            speak(&mut rig, before, 1_500_000 + late * 100_000);
        }
        rig.run(S);
    }
    rig.run(S);
    assert_eq!(codes(&rig), [0_u16; 0]);
    let job = rig.accept("left", &moves("a", 5, 10));
    rig.run(5 * S);
    let state = rig.fleet.job(&job).expect("known").state();
    assert_eq!(state, JobState::Succeeded);
}

#[test]
fn a_node_that_obeys_a_newer_gateway_gets_no_jobs_and_its_record_says_why() {
    let config = FleetConfig {
        epoch: 5,
        ..FleetConfig::default()
    };
    let mut rig = Rig::with(config, 1);
    rig.add("left");
    rig.run(2 * S);
    let refused = |rig: &Rig, epoch: u32| BatchAck {
        queue: rig.nodes[&left()].queue,
        verdict: Verdict::Refused(Refusal::Superseded { epoch }),
        accepted_commands: 0,
        executed_commands: 0,
        credit_commands: 4_096,
    };
    // What it answered to somebody older, who is told of us.
    let ack = refused(&rig, 5);
    from_left(&mut rig, NodeTopic::Ack, &ack);
    rig.run(S);
    assert_eq!(codes(&rig), [0_u16; 0]);
    let ack = refused(&rig, 6);
    from_left(&mut rig, NodeTopic::Ack, &ack);
    rig.run(S);
    assert_eq!(codes(&rig), [402]);
    let job = rig.accept("left", &moves("a", 5, 10));
    rig.run(5 * S);
    assert_eq!(
        rig.fleet.job(&job).expect("known").state(),
        JobState::Queued
    );
    // A boot makes it forget whom it obeyed.
    rig.reboot("left");
    rig.run(10 * S);
    assert_eq!(codes(&rig), [0_u16; 0]);
    let state = rig.fleet.job(&job).expect("known").state();
    assert_eq!(state, JobState::Succeeded);
}

#[test]
fn what_another_gateway_says_to_a_node_is_no_word_of_the_node() {
    let mut rig = Rig::with_left();
    rig.run(2 * S);
    let ignored = rig.fleet.ignored_count();
    for topic in [NodeTopic::Clock, NodeTopic::Start, NodeTopic::Pace] {
        rig.event(Event::FromNode {
            node: left(),
            topic,
            payload: [epoch::mark(9).as_slice(), &[1, 0, 0]].concat(),
        });
    }
    assert_eq!(rig.fleet.ignored_count(), ignored);
}
