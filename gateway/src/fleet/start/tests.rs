//! The conversation of a start, word by word.

use super::*;
use crate::fleet::clock::Stamps;
use keys::{AxisId, LocalMicros, record::ErrorCode};

const QUEUE: QueueId = QueueId { boot: 7, flush: 1 };

/// A clock that is an hour behind, over a way of so much in each direction.
fn clock(way_us: u64) -> ClockTrack {
    let mut clock = ClockTrack::new();
    for probe in 0..200 {
        let sent_us = 3_600_000_000 + probe * 100_000;
        let stamps = Stamps {
            sent_at: FleetMicros(sent_us),
            received_at: LocalMicros(sent_us + way_us - 3_600_000_000),
            replied_at: LocalMicros(sent_us + way_us - 3_600_000_000),
            back_at: FleetMicros(sent_us + 2 * way_us),
        };
        clock.observe(QUEUE.boot, stamps);
    }
    clock
}

fn node(name: &str) -> NodeId {
    NodeId::new(name).expect("legal")
}

const NOW: FleetMicros = FleetMicros(3_620_000_000);

/// Two nodes that are ready, 100 commands into their queues.
fn ready() -> Start {
    ready_within(10_000.0)
}

fn ready_within(max_skew_us: f64) -> Start {
    let limits = Limits {
        max_skew_us,
        ready_timeout_us: 1_000_000,
    };
    let barrier = Command::Barrier { barrier: 0 };
    let step = Command::Move {
        axis: AxisId(0),
        delay_us: 100,
        steps: 1,
    };
    let pause = Command::Pause { pause_ms: 3 };
    let parts: [(NodeId, &[Command]); 2] = [
        (node("left"), &[barrier, step]),
        (node("right"), &[barrier, pause, step]),
    ];
    let mut start = Start::new(limits, parts, &BTreeMap::new());
    for name in ["left", "right"] {
        start.seat(node(name), QUEUE, 100);
        say(&mut start, name, NOW, |queue, command| {
            StartMessage::Ready { queue, command }
        });
    }
    start
}

fn say(
    start: &mut Start,
    name: &str,
    now: FleetMicros,
    word: impl Fn(QueueId, u64) -> StartMessage,
) {
    start.hear(node(name), &word(QUEUE, 100), None, now);
}

fn armed(queue: QueueId, command: u64) -> StartMessage {
    StartMessage::Armed { queue, command }
}

fn poll(start: &mut Start, clock: &ClockTrack, now: FleetMicros) -> (Vec<Step>, Vec<StartMessage>) {
    let mut said = Vec::new();
    let steps = start.poll(|_| Some(clock), now, |_, message| said.push(message));
    (steps.into_iter().map(|(_, step)| step).collect(), said)
}

#[test]
fn the_instant_is_as_far_ahead_as_the_slowest_way_needs_and_four_seconds_at_most() {
    let ways = [
        (100, 250_000, 50_000),
        (25_000, 400_000, 100_000),
        (900_000, 4_000_000, 1_000_000),
    ];
    for (way_us, lead_us, margin_us) in ways {
        let clock = clock(way_us);
        let mut start = ready_within(1e6);
        let at = FleetMicros(NOW.0 + lead_us);
        assert_eq!(
            poll(&mut start, &clock, NOW),
            (vec![Step::Planned(at)], vec![])
        );
        let (steps, said) = poll(&mut start, &clock, NOW);
        assert_eq!((steps.len(), said.len()), (0, 2));
        let StartMessage::Commit {
            start_at,
            confirm_by,
            command,
            ..
        } = said[0]
        else {
            panic!("{said:?}")
        };
        assert_eq!(command, 100);
        assert_eq!(start_at.0 - confirm_by.0, margin_us);
        let local_us = at.0 - 3_600_000_000;
        assert!(
            start_at.0.abs_diff(local_us) <= 5,
            "{start_at:?} {local_us}"
        );
    }
}

#[test]
fn nobody_is_confirmed_before_all_are_armed_and_all_are_held_when_one_is_late() {
    let clock = clock(100);
    let mut start = ready();
    poll(&mut start, &clock, NOW);
    poll(&mut start, &clock, NOW);
    say(&mut start, "left", NOW, armed);
    assert_eq!(poll(&mut start, &clock, NOW), (vec![], vec![]));
    let again = FleetMicros(NOW.0 + COMMIT_US);
    let (_, said) = poll(&mut start, &clock, again);
    assert!(
        matches!(said[..], [StartMessage::Commit { .. }]),
        "{said:?}"
    );
    let late = FleetMicros(NOW.0 + LEAD_US_MIN - CONFIRM_MARGIN_US - ARM_MARGIN_US);
    let (steps, _) = poll(&mut start, &clock, late);
    let [Step::Failed(reasons)] = &steps[..] else {
        panic!("{steps:?}")
    };
    assert_eq!(reasons.len(), 1);
    assert_eq!(reasons[0].0, node("right"));
    assert!(start.break_off(late).is_empty(), "nobody was confirmed");
    let (_, said) = poll(&mut start, &clock, late);
    assert!(
        matches!(
            said[..],
            [StartMessage::Abort { .. }, StartMessage::Abort { .. }]
        ),
        "{said:?}"
    );
    // Whoever says that it waits needs no more aborts, and after the instant nobody does.
    say(&mut start, "left", late, |queue, command| {
        StartMessage::Ready { queue, command }
    });
    let (_, said) = poll(&mut start, &clock, late.plus_us(ABORT_US));
    assert_eq!(said.len(), 1);
    let (_, said) = poll(&mut start, &clock, NOW.plus_us(LEAD_US_MIN));
    assert_eq!(said, []);
}

#[test]
fn a_word_from_before_it_was_armed_does_not_disarm_a_node() {
    let clock = clock(100);
    let mut start = ready();
    poll(&mut start, &clock, NOW);
    for name in ["left", "right"] {
        say(&mut start, name, NOW, armed);
    }
    let (_, said) = poll(&mut start, &clock, NOW);
    assert!(matches!(said[0], StartMessage::Confirm { .. }), "{said:?}");
    let ready = |queue, command| StartMessage::Ready { queue, command };
    say(&mut start, "left", NOW.plus_us(1_000), ready);
    assert_eq!(poll(&mut start, &clock, NOW.plus_us(1_000)).0, []);
    // After the last moment for confirmations it can only mean that there was none.
    let after = NOW.plus_us(LEAD_US_MIN - CONFIRM_MARGIN_US);
    say(&mut start, "left", after, ready);
    let (steps, _) = poll(&mut start, &clock, after);
    assert!(
        matches!(&steps[..], [Step::Failed(reasons)] if reasons.len() == 1),
        "{steps:?}"
    );
    let halts = start.break_off(after);
    assert_eq!(halts.len(), 2, "whoever was confirmed may have gone on");
}

#[test]
fn a_plan_of_an_earlier_gateway_is_never_committed_and_may_turn_out_to_be_over() {
    let clock = clock(100);
    let planned = BTreeMap::from([(0, NOW)]);
    let limits = Limits {
        max_skew_us: 10_000.0,
        ready_timeout_us: 1_000_000,
    };
    let parts = || {
        let part: &[Command] = &[Command::Barrier { barrier: 0 }, Command::LidarRead];
        [(node("left"), part), (node("right"), part)]
    };
    for passed in [true, false] {
        let mut start = Start::new(limits, parts(), &planned);
        start.seat(node("left"), QUEUE, 100);
        start.seat(node("right"), QUEUE, 100);
        start.note_executed(node("left"), QUEUE, 101);
        assert_eq!(poll(&mut start, &clock, NOW), (vec![], vec![]));
        start.note_executed(node("right"), QUEUE, 100 + u64::from(passed));
        let (steps, said) = poll(&mut start, &clock, NOW);
        assert_eq!(said, []);
        match &steps[..] {
            [Step::Met] => assert!(passed),
            [Step::Failed(reasons)] => {
                assert!(!passed);
                assert_eq!(reasons[0].1.code, ErrorCode::Internal);
            }
            other => panic!("{other:?}"),
        }
    }
}
