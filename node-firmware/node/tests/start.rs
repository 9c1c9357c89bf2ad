//! Waiting at a barrier and going on at an instant: the node's side of a synchronized start, with
//! every message lost, late or doubled.

mod rig;

use emulator::{oracle, pins::Pin};
use keys::{
    Command, LocalMicros, NodeState, NodeTopic, QueueId, StopMode, Verdict, start::StartMessage,
    version,
};
use rig::{BOOT, Rig, config, steps};

const QUEUE: QueueId = QueueId {
    boot: BOOT,
    flush: 0,
};

fn barrier() -> Command {
    Command::Barrier { barrier: 0 }
}

/// A node that waits at a barrier with 100 steps behind it.
fn waiting() -> Rig {
    let mut config = config();
    config.record = emulator::Recording::Edges { max: 1_000_000 };
    let mut rig = Rig::new(config);
    assert_eq!(
        rig.batch(&[barrier(), steps(100)]).verdict,
        Verdict::Accepted
    );
    rig.run_for(10_000);
    rig
}

fn say(rig: &mut Rig, message: StartMessage) {
    let mut buffer = [0; 64];
    let bytes = version::encode(&message, &mut buffer)
        .expect("room")
        .to_vec();
    rig.put(NodeTopic::Start, &bytes);
}

fn commit(rig: &mut Rig, start_at_us: u64, confirm_by_us: u64) {
    say(
        rig,
        StartMessage::Commit {
            queue: QUEUE,
            command: 0,
            start_at: LocalMicros(start_at_us),
            confirm_by: LocalMicros(confirm_by_us),
        },
    );
}

fn confirm(rig: &mut Rig) {
    say(
        rig,
        StartMessage::Confirm {
            queue: QUEUE,
            command: 0,
        },
    );
}

fn abort(rig: &mut Rig) {
    say(
        rig,
        StartMessage::Abort {
            queue: QUEUE,
            command: 0,
        },
    );
}

fn said(rig: &Rig) -> Vec<(u64, StartMessage)> {
    rig.sent
        .iter()
        .filter(|(_, topic, _)| *topic == NodeTopic::Start)
        .map(|(at, _, payload)| (at.0, version::decode(payload).expect("a start message")))
        .collect()
}

fn count(rig: &Rig, wanted: impl Fn(&StartMessage) -> bool) -> usize {
    said(rig)
        .iter()
        .filter(|(_, message)| wanted(message))
        .count()
}

fn armed_count(rig: &Rig) -> usize {
    count(rig, |message| matches!(message, StartMessage::Armed { .. }))
}

fn first_rise(rig: &Rig) -> Option<u64> {
    let life = rig.node.life();
    let rise = life
        .edges
        .iter()
        .find(|edge| matches!(edge.pin, Pin::Step(_)) && edge.level);
    rise.map(|edge| edge.at_ticks)
}

#[test]
fn a_node_at_a_barrier_says_ready_ten_times_a_second_and_does_not_move() {
    let mut rig = waiting();
    assert_eq!(rig.state(), NodeState::Ready);
    rig.run_until(1_000_000);
    let ready = StartMessage::Ready {
        queue: QUEUE,
        command: 0,
    };
    let times: Vec<_> = said(&rig)
        .iter()
        .filter(|(_, message)| *message == ready)
        .map(|(at, _)| *at)
        .collect();
    assert_eq!(
        times,
        (0..=10).map(|tenth| tenth * 100_000).collect::<Vec<_>>()
    );
    assert_eq!((rig.position(), rig.status().executed_commands), (0, 0));
}

#[test]
fn a_confirmed_start_has_its_first_edge_on_the_tick() {
    let mut rig = waiting();
    commit(&mut rig, 500_000, 400_000);
    assert_eq!(armed_count(&rig), 1);
    rig.run_until(399_999);
    confirm(&mut rig);
    rig.run_until(2_000_000);
    let rise = first_rise(&rig).expect("it moves");
    assert!((8_000_000..=8_000_003).contains(&rise), "{rise}");
    assert_eq!(rig.position(), 100);
    let started = StartMessage::Started {
        queue: QUEUE,
        command: 0,
        first_edge_at: LocalMicros(500_000),
    };
    let times: Vec<_> = said(&rig)
        .iter()
        .filter(|(_, message)| *message == started)
        .map(|(at, _)| *at)
        .collect();
    assert_eq!(times.len(), 5, "{times:?}");
    assert!((500_000..=500_010).contains(&times[0]));
    assert_eq!(rig.status().executed_commands, 2);
    oracle::check_life(&rig.node.life()).expect("good pulses");
}

#[test]
fn without_a_confirmation_in_time_it_disarms_itself_and_a_late_one_moves_nothing() {
    let mut rig = waiting();
    commit(&mut rig, 500_000, 400_000);
    rig.run_until(400_000);
    confirm(&mut rig);
    rig.run_until(3_000_000);
    assert_eq!(first_rise(&rig), None);
    assert_eq!(rig.state(), NodeState::Ready);
    // And it takes part in the next attempt.
    commit(&mut rig, 3_500_000, 3_400_000);
    confirm(&mut rig);
    rig.run_until(4_000_000);
    assert_eq!(rig.position(), 100);
}

#[test]
fn an_abort_disarms_armed_confirmed_and_in_the_lead_in() {
    for (confirmed, abort_at_us) in [
        (false, 300_000),
        (true, 450_000),
        (true, 496_500),
        (true, 498_000),
        (true, 499_999),
    ] {
        let mut rig = waiting();
        commit(&mut rig, 500_000, 400_000);
        if confirmed {
            confirm(&mut rig);
        }
        rig.run_until(abort_at_us);
        abort(&mut rig);
        rig.run_until(2_000_000);
        assert_eq!(first_rise(&rig), None, "{abort_at_us}");
        assert_eq!(rig.position(), 0);
    }
}

#[test]
fn an_abort_after_the_start_changes_nothing() {
    let mut rig = waiting();
    commit(&mut rig, 500_000, 400_000);
    confirm(&mut rig);
    rig.run_until(500_100);
    abort(&mut rig);
    rig.run_until(2_000_000);
    assert_eq!(rig.position(), 100);
}

#[test]
fn a_stop_at_a_barrier_drops_the_start() {
    for confirmed in [false, true] {
        let mut rig = waiting();
        commit(&mut rig, 500_000, 400_000);
        if confirmed {
            confirm(&mut rig);
        }
        rig.run_until(300_000);
        rig.stop(StopMode::Halt);
        assert_eq!(rig.state(), NodeState::Stopped);
        confirm(&mut rig);
        rig.run_until(2_000_000);
        assert_eq!(first_rise(&rig), None);
    }
}

#[test]
fn messages_for_another_queue_or_command_and_impossible_instants_arm_nothing() {
    let mut rig = waiting();
    let other = QueueId { boot: 1, flush: 0 };
    for (queue, command, start_at, confirm_by) in [
        (other, 0, 500_000, 400_000),
        (QUEUE, 1, 500_000, 400_000),
        // Confirmed by a time that has passed; too close to the start; after it.
        (QUEUE, 0, 500_000, 10_000),
        (QUEUE, 0, 500_000, 498_001),
        (QUEUE, 0, 500_000, 600_000),
        (QUEUE, 0, 5_000, 4_000),
    ] {
        say(
            &mut rig,
            StartMessage::Commit {
                queue,
                command,
                start_at: LocalMicros(start_at),
                confirm_by: LocalMicros(confirm_by),
            },
        );
        confirm(&mut rig);
    }
    rig.put(NodeTopic::Start, b"\xff\xff");
    rig.run_until(1_000_000);
    assert_eq!((armed_count(&rig), first_rise(&rig)), (0, None));
}

#[test]
fn a_barrier_in_the_middle_rests_both_axes_and_later_commands_follow_without_a_gap() {
    let mut config = config();
    config.record = emulator::Recording::Edges { max: 1_000_000 };
    let mut rig = Rig::new(config);
    let _ = rig.batch(&[
        steps(50),
        Command::Barrier { barrier: 1 },
        Command::Pause { pause_ms: 20 },
        steps(-30),
        steps(7),
    ]);
    rig.run_until(100_000);
    assert_eq!(rig.state(), NodeState::Ready);
    assert_eq!((rig.position(), rig.status().executed_commands), (50, 1));
    say(
        &mut rig,
        StartMessage::Commit {
            queue: QUEUE,
            command: 1,
            start_at: LocalMicros(300_000),
            confirm_by: LocalMicros(250_000),
        },
    );
    say(
        &mut rig,
        StartMessage::Confirm {
            queue: QUEUE,
            command: 1,
        },
    );
    rig.run_until(1_000_000);
    assert_eq!(rig.position(), 27);
    let started = said(&rig)
        .into_iter()
        .find_map(|(_, message)| match message {
            StartMessage::Started { first_edge_at, .. } => Some(first_edge_at),
            _ => None,
        });
    assert_eq!(started, Some(LocalMicros(320_000)));
    oracle::check_life(&rig.node.life()).expect("good pulses");
}

#[test]
fn a_lost_link_at_a_barrier_moves_nothing_and_latches_nothing() {
    let mut rig = waiting();
    rig.link(false);
    rig.run_until(10_000_000);
    assert_eq!(rig.state(), NodeState::Ready);
    rig.link(true);
    let now = rig.now.0;
    commit(&mut rig, now + 200_000, now + 100_000);
    confirm(&mut rig);
    rig.run_until(now + 1_000_000);
    assert_eq!(rig.position(), 100);
}

#[test]
fn a_part_without_steps_starts_too() {
    let mut rig = Rig::new(config());
    let _ = rig.batch(&[barrier(), Command::Laser { power_percent: 9 }]);
    rig.run_until(10_000);
    commit(&mut rig, 500_000, 400_000);
    confirm(&mut rig);
    rig.run_until(499_999);
    assert_eq!(rig.status().laser_percent, 0);
    rig.run_until(600_000);
    assert_eq!(rig.status().laser_percent, 9);
    assert_eq!(rig.status().executed_commands, 2);
    assert_eq!(
        count(&rig, |said| matches!(said, StartMessage::Started { .. })),
        1
    );
}
