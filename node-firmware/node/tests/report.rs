//! Statuses, log lines, clock replies and their bounds.

mod rig;

use keys::{
    BatchHeader, FleetMicros, LocalMicros, NodeState, NodeTopic, StopMode,
    clock::{ClockMessage, ClockProbe, ClockReply},
    status::FaultCode,
    version,
};
use node::{
    limits::{CLOCK_REPLIES_MAX, LOG_BURST_LINES},
    trace::Event,
};
use rig::{BOOT, Rig, batch_bytes, config, steps};

#[test]
fn a_node_at_rest_tells_its_status_once_a_second() {
    let mut rig = Rig::new(config());
    rig.run_for(10_000_000);
    let times: Vec<_> = rig.statuses().iter().map(|(at, _)| at.0).collect();
    let expected: Vec<_> = (0..=10).map(|second| second * 1_000_000).collect();
    assert_eq!(times, expected);
}

#[test]
fn a_moving_node_tells_its_status_ten_times_a_second_and_at_both_ends() {
    let mut rig = Rig::new(config());
    rig.run_until(500_000);
    let _ = rig.batch(&[steps(9_990)]);
    rig.run_until(1_600_000);
    let told: Vec<_> = rig
        .statuses()
        .iter()
        .map(|(at, status)| (at.0, status.state))
        .collect();
    let mut expected = vec![(0, NodeState::Idle)];
    expected.extend((5..15).map(|tenth| (tenth * 100_000, NodeState::Running)));
    assert_eq!(told[..11], expected);
    let (ended_at, state) = told[11];
    assert_eq!(state, NodeState::Idle);
    // The lead-in, and what the first turn needs beyond it and the first step's time.
    assert!((1_499_000..=1_499_110).contains(&ended_at), "{ended_at}");
    assert_eq!(told.len(), 12);
    let (_, last) = rig.statuses().last().cloned().expect("a status");
    assert_eq!(last.axes[0].position_steps, 9_990);
    assert_eq!((last.accepted_commands, last.executed_commands), (1, 1));
    assert_eq!(last.job, None);
}

#[test]
fn a_stop_and_a_release_are_told_at_once() {
    let mut rig = Rig::new(config());
    rig.run_until(300_000);
    rig.stop(StopMode::Halt);
    let (at, status) = rig.statuses().last().cloned().expect("a status");
    assert_eq!((at.0, status.state), (300_000, NodeState::Stopped));
    rig.run_until(400_000);
    let _ = rig.release(rig.queue());
    let (at, status) = rig.statuses().last().cloned().expect("a status");
    assert_eq!((at.0, status.state), (400_000, NodeState::Idle));
}

#[test]
fn a_queue_that_runs_dry_in_a_job_is_a_fault_but_no_latch() {
    let mut rig = Rig::new(config());
    for _ in 0..10 {
        let header = BatchHeader {
            job_end: 1_000,
            ..rig.next_header(1)
        };
        let _ = rig.order_bytes(&batch_bytes(header, &[steps(10)]));
        rig.run_for(200_000);
    }
    let status = rig.status();
    assert_eq!(
        status.faults.len(),
        1,
        "a fault that repeats keeps one place"
    );
    assert_eq!(status.faults[0].code, FaultCode::UNDERRUN);
    assert_eq!(status.state, NodeState::Idle);
    assert!(status.job.is_some(), "the job is not over");
    assert_eq!(rig.position(), 100);
}

#[test]
fn a_clock_probe_is_answered_with_both_stamps() {
    let mut rig = Rig::new(config());
    rig.run_until(123_456);
    let probe = ClockProbe {
        probe: 9,
        sent_at: FleetMicros(1_000_000),
    };
    let mut buffer = [0; 64];
    let bytes = version::encode(&ClockMessage::Probe(probe), &mut buffer).expect("room");
    rig.node.handle(NodeTopic::Clock, bytes, rig.now);
    rig.now = LocalMicros(123_500);
    rig.drain();
    let (_, topic, payload) = rig.sent.last().expect("a reply");
    assert_eq!(*topic, NodeTopic::Clock);
    assert_eq!(
        version::decode(payload),
        Ok(ClockMessage::Reply(ClockReply {
            probe: 9,
            boot: BOOT,
            sent_at: FleetMicros(1_000_000),
            received_at: LocalMicros(123_456),
            replied_at: LocalMicros(123_500),
        }))
    );
    // Its own reply comes back on the shared key and is not answered.
    let reply = payload.clone();
    let before = rig.sent.len();
    rig.put(NodeTopic::Clock, &reply);
    rig.put(NodeTopic::Clock, b"nonsense");
    assert_eq!(rig.sent.len(), before);
}

#[test]
fn a_flood_without_a_reader_stays_within_its_bounds_and_the_newest_wins() {
    let mut rig = Rig::new(config());
    let header = rig.next_header(1);
    let bytes = batch_bytes(header, &[steps(10)]);
    for number in 0..1_000 {
        let probe = ClockProbe {
            probe: number,
            sent_at: FleetMicros(0),
        };
        let mut buffer = [0; 64];
        let probe = version::encode(&ClockMessage::Probe(probe), &mut buffer).expect("room");
        rig.now = LocalMicros(rig.now.0 + 1_000);
        rig.node.handle(NodeTopic::Clock, probe, rig.now);
        rig.node.handle(NodeTopic::Batch, &bytes, rig.now);
        rig.node.handle(NodeTopic::Stop, b"", rig.now);
        rig.node.poll(rig.now);
    }
    let before = rig.sent.len();
    rig.drain();
    let count = |topic| {
        rig.sent[before..]
            .iter()
            .filter(|(_, sent, _)| *sent == topic)
            .count()
    };
    assert_eq!(count(NodeTopic::Clock), CLOCK_REPLIES_MAX);
    assert_eq!(count(NodeTopic::Ack), node::limits::ACKS_MAX);
    assert_eq!(count(NodeTopic::Status), 1);
    assert!(count(NodeTopic::Log) <= usize::from(LOG_BURST_LINES));
    let (_, _, last) = rig.sent[before..]
        .iter()
        .rfind(|(_, topic, _)| *topic == NodeTopic::Clock)
        .expect("a reply");
    let Ok(ClockMessage::Reply(reply)) = version::decode(last) else {
        panic!("not a reply");
    };
    assert_eq!(reply.probe, 999);
    assert!(rig.node.node().trace().count(&Event::ReplyDropped) > 0);
}

#[test]
fn a_lidar_reading_comes_with_the_status() {
    let mut rig = Rig::new(config());
    let _ = rig.batch(&[steps(10), keys::Command::LidarRead, steps(10)]);
    rig.run_for(500_000);
    let mm = rig.status().lidar_mm.expect("a reading");
    assert!((500..2_500).contains(&mm));
    assert_eq!(rig.position(), 20);
}

#[test]
fn a_reboot_is_another_queue_with_no_position() {
    let mut rig = Rig::new(config());
    let _ = rig.batch(&[steps(1_000)]);
    rig.run_for(50_000);
    rig.node.reset(BOOT + 1);
    rig.now = LocalMicros(0);
    rig.link(true);
    let (_, status) = rig.statuses().last().cloned().expect("a status");
    assert_eq!((status.queue.boot, status.queue.flush), (BOOT + 1, 0));
    assert_eq!(status.accepted_commands, 0);
    assert_eq!(status.axes[0].position_steps, 0);
    assert_eq!(status.stop, None);
    rig.run_for(1_000_000);
    assert_eq!(rig.position(), 0);
}
