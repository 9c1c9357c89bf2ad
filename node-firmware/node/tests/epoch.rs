//! A node obeys the newest gateway that it has heard since its boot, and stops for everybody.

mod rig;

use keys::{
    NodeState, NodeTopic, Order, Refusal, StopMode, Verdict,
    clock::{ClockMessage, ClockProbe},
    epoch::mark,
    pace::PaceMessage,
    version,
};
use rig::{BOOT, Rig, batch_bytes, config, steps};

/// A message as the gateway of this epoch says it.
fn of(epoch: u32, message: &[u8]) -> Vec<u8> {
    [mark(epoch).as_slice(), message].concat()
}

fn batch_of(rig: &mut Rig, epoch: u32) -> Verdict {
    let header = rig.next_header(1);
    let bytes = of(epoch, &batch_bytes(header, &[steps(10)]));
    rig.order_bytes(&bytes).verdict
}

fn pace_of(rig: &mut Rig, epoch: u32, change: u32, hold: bool) {
    let set = PaceMessage::Set {
        boot: BOOT,
        change,
        hold: Some(hold),
        percent: None,
    };
    let mut buffer = [0; 32];
    let bytes = version::encode(&set, &mut buffer).expect("room").to_vec();
    rig.put(NodeTopic::Pace, &of(epoch, &bytes));
    rig.drain();
}

fn probe_of(rig: &mut Rig, epoch: u32) {
    let probe = ClockMessage::Probe(ClockProbe {
        probe: 1,
        sent_at: keys::FleetMicros(5),
    });
    let mut buffer = [0; 32];
    let bytes = version::encode(&probe, &mut buffer).expect("room").to_vec();
    rig.put(NodeTopic::Clock, &of(epoch, &bytes));
    rig.drain();
}

fn probe_replies(rig: &Rig) -> usize {
    let clocks = rig.sent.iter();
    clocks
        .filter(|(_, topic, _)| *topic == NodeTopic::Clock)
        .count()
}

#[test]
fn after_a_newer_gateway_no_older_one_is_obeyed() {
    let mut rig = Rig::new(config());
    assert_eq!(batch_of(&mut rig, 0), Verdict::Accepted);
    assert_eq!(batch_of(&mut rig, 5), Verdict::Accepted);
    let superseded = Verdict::Refused(Refusal::Superseded { epoch: 5 });
    assert_eq!(batch_of(&mut rig, 4), superseded);
    // Nor one that has none.
    assert_eq!(batch_of(&mut rig, 0), superseded);
    assert_eq!(batch_of(&mut rig, 5), Verdict::Accepted);
    assert_eq!(batch_of(&mut rig, 900), Verdict::Accepted);
    let superseded = Verdict::Refused(Refusal::Superseded { epoch: 900 });
    assert_eq!(batch_of(&mut rig, 5), superseded);
    rig.run_for(1_000_000);
    assert_eq!(rig.position(), 40, "four of them were taken");
}

#[test]
fn a_clock_probe_is_enough_to_be_the_newest() {
    let mut rig = Rig::new(config());
    probe_of(&mut rig, 5);
    assert_eq!(probe_replies(&rig), 1);
    probe_of(&mut rig, 4);
    assert_eq!(probe_replies(&rig), 1, "an older one gets no clock");
    let superseded = Verdict::Refused(Refusal::Superseded { epoch: 5 });
    assert_eq!(batch_of(&mut rig, 4), superseded);
}

#[test]
fn an_older_gateway_neither_holds_nor_resumes_nor_cancels() {
    let mut rig = Rig::new(config());
    let header = rig.next_header(1);
    let bytes = of(5, &batch_bytes(header, &[steps(20_000)]));
    assert_eq!(rig.order_bytes(&bytes).verdict, Verdict::Accepted);
    rig.run_for(10_000);
    pace_of(&mut rig, 4, 0, true);
    rig.run_for(10_000);
    assert_eq!(rig.state(), NodeState::Running);
    pace_of(&mut rig, 5, 0, true);
    rig.run_for(100_000);
    assert_eq!(rig.state(), NodeState::Paused);
    pace_of(&mut rig, 4, 1, false);
    rig.run_for(100_000);
    assert_eq!(rig.state(), NodeState::Paused);
    let cancel = Order::Cancel {
        queue: rig.queue(),
        mode: StopMode::Halt,
    };
    let mut buffer = [0; 32];
    let bytes = version::encode(&cancel, &mut buffer)
        .expect("room")
        .to_vec();
    let verdict = rig.order_bytes(&of(4, &bytes)).verdict;
    assert_eq!(verdict, Verdict::Refused(Refusal::Superseded { epoch: 5 }));
    assert_eq!(rig.queue(), header.queue, "the queue is the same");
}

#[test]
fn everybody_may_stop_whatever_the_epoch() {
    let mut rig = Rig::new(config());
    assert_eq!(batch_of(&mut rig, 5), Verdict::Accepted);
    rig.stop(StopMode::Halt);
    rig.run_for(10_000);
    assert_eq!(rig.state(), NodeState::Stopped);
}

#[test]
fn an_epoch_that_is_cut_off_is_refused_and_changes_nothing() {
    let mut rig = Rig::new(config());
    let bytes = of(u32::MAX, &[]);
    for end in 1..bytes.len() {
        let verdict = rig.order_bytes(&bytes[..end]).verdict;
        assert_eq!(
            verdict,
            Verdict::Refused(Refusal::Malformed),
            "cut at {end}"
        );
    }
    assert_eq!(batch_of(&mut rig, 1), Verdict::Accepted);
}
