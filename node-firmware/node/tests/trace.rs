//! What a node tells of a job: which events, in which order, at which instants.

mod rig;

use emulator::{Recording, pins::Pin};
use keys::{
    AxisId, Command, LocalMicros, NodeTopic, StopMode, StopReason,
    pace::PaceMessage,
    trace::{TRACE_BYTES_MAX, TraceEvent, TraceWord},
    version,
};
use rig::{BOOT, Rig, job, steps};

/// What was told, as it left; each event is of this boot and one number behind the one before.
fn told(rig: &Rig) -> Vec<(u64, TraceWord)> {
    let sent = rig.sent.iter().filter(|sent| sent.1 == NodeTopic::Trace);
    let events = sent.map(|(_, _, payload)| {
        assert!(payload.len() <= TRACE_BYTES_MAX);
        version::decode::<TraceEvent>(payload).expect("an event")
    });
    let events: Vec<TraceEvent> = events.collect();
    for (number, event) in events.iter().enumerate() {
        assert_eq!((event.boot, event.number as usize), (BOOT, number));
        assert_eq!(event.job, Some(job("j")));
    }
    let events = events.iter().map(|event| (event.at.0, event.what));
    events.collect()
}

fn words(rig: &Rig) -> Vec<TraceWord> {
    told(rig).iter().map(|(_, word)| *word).collect()
}

#[test]
fn a_job_is_told_from_its_intake_by_its_first_pulse_to_its_last() {
    let mut config = rig::config();
    config.record = Recording::Edges { max: 10_000 };
    let mut rig = Rig::new(config);
    let begun = rig.now.0;
    let _ = rig.batch(&[Command::Pause { pause_ms: 50 }, steps(100), steps(100)]);
    rig.run_for(3_000_000);
    let told = told(&rig);
    let words: Vec<TraceWord> = told.iter().map(|(_, word)| *word).collect();
    assert_eq!(
        words,
        [TraceWord::Taken, TraceWord::FirstPulse, TraceWord::Ended]
    );
    // The instants are those of the edges at the pin.
    let life = rig.node.life();
    let rises = life.edges.iter().filter(|edge| edge.level);
    let rises = rises.filter(|edge| edge.pin == Pin::Step(AxisId(0)));
    let rises: Vec<u64> = rises.map(|edge| edge.at_ticks / 16).collect();
    let (first, last) = (rises[0], rises[rises.len() - 1]);
    assert_eq!(told[0].0, begun);
    assert!(
        told[1].0.abs_diff(first) <= 1,
        "{told:?}, first edge {first}"
    );
    assert!(
        told[2].0 > last && told[2].0 - last <= 2_000,
        "the interval behind it counts: {told:?}, last edge {last}"
    );
}

#[test]
fn holds_speeds_and_stops_are_told_where_they_happen() {
    let mut rig = Rig::new(rig::config());
    let _ = rig.batch(&[steps(5_000)]);
    let set = |rig: &mut Rig, change: u32, hold: Option<bool>, percent: Option<u16>| {
        let message = PaceMessage::Set {
            boot: BOOT,
            change,
            hold,
            percent,
        };
        let mut buffer = [0; 64];
        let bytes = version::encode(&message, &mut buffer)
            .expect("room")
            .to_vec();
        rig.put(NodeTopic::Pace, &bytes);
        rig.run_for(100_000);
    };
    rig.run_for(100_000);
    set(&mut rig, 0, Some(true), None);
    set(&mut rig, 1, Some(false), None);
    set(&mut rig, 2, None, Some(50));
    rig.stop(StopMode::Halt);
    rig.run_for(100_000);
    assert_eq!(
        words(&rig),
        [
            TraceWord::Taken,
            TraceWord::FirstPulse,
            TraceWord::Held,
            TraceWord::Resumed,
            TraceWord::Speed { percent: 50 },
            TraceWord::StopTaken(StopReason::Client),
            TraceWord::Stopped(StopReason::Client),
        ]
    );
}

#[test]
fn an_event_is_as_long_as_is_claimed() {
    let name = [b'x'; 32];
    let name = core::str::from_utf8(&name).expect("ASCII");
    let longest = TraceEvent {
        boot: u32::MAX,
        number: u32::MAX,
        at: LocalMicros(u64::MAX),
        job: keys::JobId::new(name).ok(),
        what: TraceWord::Fault(keys::status::FaultCode(u16::MAX)),
    };
    let mut buffer = [0; TRACE_BYTES_MAX];
    version::encode(&longest, &mut buffer).expect("room");
}
