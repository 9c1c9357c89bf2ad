//! Held on the path, resumed, slower and faster: every step kept, and nothing late has an effect.

mod rig;

use emulator::{EmulatorConfig, Recording, oracle};
use keys::{
    AxisId, Command, LocalMicros, NodeState, NodeTopic, StopMode, StopReason,
    command::BARRIER_RESUME, pace::PaceMessage, start::StartMessage, version,
};
use rig::{BOOT, Rig, batch_bytes, job, steps};

fn config() -> EmulatorConfig {
    let mut config = rig::config();
    config.record = Recording::Edges { max: 1_000_000 };
    config
}

/// What the node said last.
fn told(rig: &Rig) -> (u32, bool, u16) {
    let mut sent = rig.sent.iter().filter(|sent| sent.1 == NodeTopic::Pace);
    let (_, _, payload) = sent.next_back().expect("it was told");
    match version::decode(payload).expect("a message") {
        PaceMessage::Told {
            boot,
            change,
            hold,
            percent,
        } => {
            assert_eq!(boot, BOOT);
            (change, hold, percent)
        }
        other => panic!("{other:?}"),
    }
}

fn put<M: serde::Serialize>(rig: &mut Rig, topic: NodeTopic, message: &M) {
    let mut buffer = [0; 64];
    let bytes = version::encode(message, &mut buffer)
        .expect("room")
        .to_vec();
    rig.put(topic, &bytes);
}

fn set(rig: &mut Rig, change: u32, hold: Option<bool>, percent: Option<u16>) {
    let message = PaceMessage::Set {
        boot: BOOT,
        change,
        hold,
        percent,
    };
    put(rig, NodeTopic::Pace, &message);
}

/// Says it in the knowledge of the last change.
fn set_now(rig: &mut Rig, hold: Option<bool>, percent: Option<u16>) {
    let (change, _, _) = told(rig);
    set(rig, change, hold, percent);
}

fn line(steps: [i32; 2]) -> Command {
    Command::Line {
        steps: [steps[0], steps[1], 0, 0],
        speed_hz: 4_000,
        accel_hz_per_s: 8_000,
        jerk_hz_per_s2: 0,
    }
}

fn check_pulses(rig: &Rig) {
    oracle::check_life(&rig.node.life()).expect("good pulses");
}

/// When the last command ended.
fn run_to_idle(rig: &mut Rig) -> u64 {
    for _ in 0..100_000 {
        if rig.state() == NodeState::Idle {
            return rig.now.0;
        }
        rig.run_for(1_000);
    }
    panic!("it never rests");
}

#[test]
fn held_in_the_middle_of_a_line_it_rests_on_the_path_and_loses_no_step() {
    let mut free = Rig::new(config());
    let _ = free.batch(&[line([8_000, 3_200])]);
    let free_us = run_to_idle(&mut free);

    let mut rig = Rig::new(config());
    assert_eq!(told(&rig), (0, false, 100));
    let _ = rig.batch(&[line([8_000, 3_200])]);
    rig.run_for(1_000_000);
    set_now(&mut rig, Some(true), None);
    assert_eq!(told(&rig), (1, true, 100));
    // On the way to rest it still runs.
    assert_eq!(rig.state(), NodeState::Running);
    rig.run_for(1_000_000);
    assert_eq!(rig.state(), NodeState::Paused);
    let held = [rig.position(), rig.node.position_steps(AxisId(1))];
    assert!((3_000..7_000).contains(&held[0]), "{held:?}");
    // On the line: two fifths of the other axis, to a step.
    assert!((held[1] * 5 - held[0] * 2).abs() <= 5, "{held:?}");
    rig.run_for(60_000_000);
    assert_eq!(rig.position(), held[0]);
    assert_eq!(rig.status().executed_commands, 0);
    let resumed_at = rig.now.0;
    set_now(&mut rig, Some(false), None);
    assert_eq!(told(&rig), (2, false, 100));
    let end_us = run_to_idle(&mut rig);
    assert_eq!(
        [rig.position(), rig.node.position_steps(AxisId(1))],
        [8_000, 3_200]
    );
    // What was left, with two ramps of half a second more: 1 s of way at full speed costs half of it
    // again for each ramp, a quarter of a second each.
    let left_us = end_us - resumed_at;
    let whole_us = 1_000_000 + left_us + 500_000;
    assert!(
        whole_us.abs_diff(free_us + 500_000) < 20_000,
        "{whole_us} {free_us}"
    );
    check_pulses(&rig);
}

#[test]
fn what_comes_late_or_twice_moves_nothing() {
    let mut rig = Rig::new(config());
    let _ = rig.batch(&[line([8_000, 0])]);
    rig.run_for(500_000);
    set(&mut rig, 0, Some(true), None);
    rig.run_for(2_000_000);
    let held = rig.position();
    // The resume of somebody who did not know of the hold, and one for another boot.
    set(&mut rig, 0, Some(false), Some(50));
    put(
        &mut rig,
        NodeTopic::Pace,
        &PaceMessage::Set {
            boot: BOOT + 1,
            change: 1,
            hold: Some(false),
            percent: None,
        },
    );
    rig.put(NodeTopic::Pace, b"nonsense");
    rig.run_for(2_000_000);
    assert_eq!((rig.position(), rig.state()), (held, NodeState::Paused));
    // Each was answered with how it is.
    assert_eq!(told(&rig), (1, true, 100));
    set(&mut rig, 1, Some(false), None);
    set(&mut rig, 1, Some(false), None);
    assert_eq!(told(&rig), (2, false, 100));
    put(&mut rig, NodeTopic::Pace, &PaceMessage::Ask);
    assert_eq!(told(&rig), (2, false, 100));
    run_to_idle(&mut rig);
    assert_eq!(rig.position(), 8_000);
    check_pulses(&rig);
}

#[test]
fn another_speed_takes_the_time_that_it_says() {
    // Twelve seconds at full speed, so that the ramps do not count.
    let mut rig = Rig::new(config());
    set_now(&mut rig, None, Some(50));
    assert_eq!(told(&rig), (1, false, 50));
    let _ = rig.batch(&[line([48_000, 0])]);
    let half_us = run_to_idle(&mut rig);
    assert!((24_000_000..24_800_000).contains(&half_us), "{half_us}");
    set_now(&mut rig, None, Some(100));
    let from_us = rig.now.0;
    let _ = rig.batch(&[line([48_000, 0])]);
    rig.run_for(6_000_000);
    set_now(&mut rig, None, Some(200));
    let us = run_to_idle(&mut rig) - from_us;
    assert!((8_800_000..9_800_000).contains(&us), "{us}");
    assert_eq!(rig.position(), 96_000);
    for percent in [0, 401] {
        set_now(&mut rig, None, Some(percent));
        assert_eq!(told(&rig).2, 200);
    }
    check_pulses(&rig);
}

#[test]
fn a_stop_that_comes_to_rest_on_the_path_is_no_hold() {
    let mut rig = Rig::new(config());
    let _ = rig.batch(&[line([80_000, 0]), line([100, 0])]);
    rig.run_for(500_000);
    let before = told(&rig);
    rig.stop(StopMode::Decelerate);
    for _ in 0..2_000 {
        rig.run_for(1_000);
        assert_eq!(told(&rig), before);
    }
    assert_eq!(rig.state(), NodeState::Stopped);
    check_pulses(&rig);
}

#[test]
fn a_stop_beats_a_hold_and_nothing_goes_on_after_the_release() {
    for mode in [StopMode::Halt, StopMode::Decelerate] {
        let mut rig = Rig::new(config());
        let _ = rig.batch(&[line([8_000, 0]), line([100, 0])]);
        rig.run_for(500_000);
        set_now(&mut rig, Some(true), None);
        rig.run_for(2_000_000);
        assert_eq!(rig.state(), NodeState::Paused);
        let held = rig.position();
        rig.stop(mode);
        rig.run_for(2_000_000);
        assert_eq!(rig.state(), NodeState::Stopped);
        assert!(!told(&rig).1);
        // A latched node cannot be held or resumed.
        set_now(&mut rig, Some(true), None);
        assert!(!told(&rig).1);
        let _ = rig.release(rig.queue());
        rig.run_for(2_000_000);
        assert_eq!((rig.position(), rig.state()), (held, NodeState::Idle));
        let _ = rig.batch(&[steps(10)]);
        run_to_idle(&mut rig);
        assert_eq!(rig.position(), held + 10);
        check_pulses(&rig);
    }
}

#[test]
fn the_link_that_goes_while_it_is_held_stops_it() {
    let mut rig = Rig::new(config());
    let _ = rig.batch(&[line([8_000, 0])]);
    rig.run_for(500_000);
    set_now(&mut rig, Some(true), None);
    rig.run_for(2_000_000);
    let held = rig.position();
    rig.link(false);
    rig.run_for(10_000_000);
    rig.link(true);
    assert_eq!((rig.position(), rig.state()), (held, NodeState::Stopped));
    let stop = rig.node.node().last_stop().map(|stop| stop.reason);
    assert_eq!(stop, Some(StopReason::Link));
    assert!(!told(&rig).1, "told anew with the link");
    check_pulses(&rig);
}

#[test]
fn held_at_rest_it_takes_commands_and_begins_them_when_it_is_resumed() {
    let mut rig = Rig::new(config());
    set_now(&mut rig, Some(true), None);
    assert_eq!(rig.state(), NodeState::Paused);
    let _ = rig.batch(&[steps(10), line([100, 0])]);
    rig.run_for(5_000_000);
    assert_eq!((rig.position(), rig.state()), (0, NodeState::Paused));
    set_now(&mut rig, Some(false), None);
    run_to_idle(&mut rig);
    assert_eq!(rig.position(), 110);
    check_pulses(&rig);
}

/// A node at the barrier of a synchronized start, its last words behind it.
fn at_barrier() -> Rig {
    let mut rig = Rig::new(config());
    let mut header = rig.next_header(2);
    header.job = job("cut");
    let barrier = Command::Barrier { barrier: 0 };
    let _ = rig.order_bytes(&batch_bytes(header, &[barrier, line([8_000, 0])]));
    rig.run_for(150_000);
    rig.sent.retain(|sent| sent.1 == NodeTopic::Pace);
    rig
}

fn starts(rig: &Rig) -> Vec<StartMessage> {
    let sent = rig.sent.iter().filter(|sent| sent.1 == NodeTopic::Start);
    sent.map(|sent| version::decode(&sent.2).expect("a message"))
        .collect()
}

fn commit(rig: &mut Rig) {
    let queue = rig.queue();
    let now_us = rig.now.0;
    let commit = StartMessage::Commit {
        queue,
        command: 0,
        start_at: LocalMicros(now_us + 100_000),
        confirm_by: LocalMicros(now_us + 50_000),
    };
    put(rig, NodeTopic::Start, &commit);
}

#[test]
fn a_held_node_is_not_ready_for_a_start_and_takes_none() {
    let mut rig = at_barrier();
    set_now(&mut rig, Some(true), None);
    rig.run_for(1_000_000);
    assert_eq!(rig.state(), NodeState::Paused);
    commit(&mut rig);
    rig.run_for(1_000_000);
    assert_eq!(starts(&rig), []);
    set_now(&mut rig, Some(false), None);
    rig.run_for(150_000);
    assert!(matches!(starts(&rig)[0], StartMessage::Ready { .. }));
    assert_eq!(rig.position(), 0);
}

#[test]
fn a_start_that_is_agreed_is_made_and_held_right_behind() {
    let mut rig = at_barrier();
    let queue = rig.queue();
    commit(&mut rig);
    let confirm = StartMessage::Confirm { queue, command: 0 };
    put(&mut rig, NodeTopic::Start, &confirm);
    set_now(&mut rig, Some(true), None);
    assert!(told(&rig).1);
    rig.run_for(2_000_000);
    let started = |message: &StartMessage| matches!(message, StartMessage::Started { .. });
    assert!(starts(&rig).iter().any(started));
    assert_eq!(rig.state(), NodeState::Paused);
    let held = rig.position();
    assert!((0..1_000).contains(&held), "{held}");
    set_now(&mut rig, Some(false), None);
    run_to_idle(&mut rig);
    assert_eq!(rig.position(), 8_000);
    check_pulses(&rig);
}

#[test]
fn a_job_rests_where_it_says_so_until_somebody_resumes_it() {
    let mut rig = Rig::new(config());
    let rest = Command::Barrier {
        barrier: BARRIER_RESUME,
    };
    let _ = rig.batch(&[steps(100), rest, steps(50)]);
    rig.run_for(5_000_000);
    assert_eq!(rig.state(), NodeState::Paused);
    assert_eq!(rig.position(), 100);
    assert_eq!(told(&rig), (1, true, 100), "it is held, for whoever looks");
    assert!(
        rig.lines()
            .iter()
            .any(|line| line.contains("until it is resumed"))
    );
    // The link may go meanwhile: nothing moves.
    rig.link(false);
    rig.run_for(5_000_000);
    rig.link(true);
    assert_eq!(rig.state(), NodeState::Paused);
    assert!(rig.status().faults.is_empty(), "{:?}", rig.status().faults);
    set_now(&mut rig, Some(false), None);
    rig.run_for(1_000_000);
    assert_eq!((rig.state(), rig.position()), (NodeState::Idle, 150));
    check_pulses(&rig);

    // A stop ends the rest as it ends any hold.
    let _ = rig.batch(&[steps(10), rest, steps(10)]);
    rig.run_for(1_000_000);
    rig.stop(StopMode::Halt);
    rig.run_for(1_000_000);
    assert_eq!(rig.state(), NodeState::Stopped);
    let queue = rig.queue();
    let _ = rig.release(queue);
    let _ = rig.batch(&[steps(10)]);
    rig.run_for(1_000_000);
    assert_eq!((rig.state(), rig.position()), (NodeState::Idle, 170));
}
