//! What is raised, when it is over, and what is forgotten.

use crate::message::{LinkEvent, Message};
use crate::model::{Model, limits::ALARMS_MAX, tests::*};
use keys::{
    FleetMicros, NodeState,
    record::{NodeWord, StartRecord},
};

fn connected() -> Model {
    let mut model = Model::default();
    let to = "here".to_owned();
    model.apply(at(0), Message::Link(LinkEvent::Connected { to }));
    model
}

/// `cause text [over] [seen]`, newest first.
fn told(model: &Model) -> Vec<String> {
    let alarms = model.alarms().newest_first();
    let words = alarms.map(|alarm| {
        let over = if alarm.over.is_some() { " over" } else { "" };
        let seen = if alarm.seen.is_some() { " seen" } else { "" };
        format!("{}{over}{seen}", alarm.text)
    });
    words.collect()
}

fn acknowledge(model: &mut Model, ms: u64, alarm: Option<u64>) {
    model.apply(at(ms), Message::Acknowledged { alarm });
}

#[test]
fn a_cause_is_raised_once_cleared_and_raised_anew() {
    let mut model = connected();
    alive(&mut model, 0, "left", true);
    for ms in [10, 20, 30] {
        says(&mut model, ms, "left", NodeState::Stopped);
    }
    assert_eq!(told(&model), ["stopped"]);
    assert_eq!(model.alarms().unseen(), 1);
    acknowledge(&mut model, 40, None);
    says(&mut model, 50, "left", NodeState::Stopped);
    assert_eq!(told(&model), ["stopped seen"]);
    says(&mut model, 60, "left", NodeState::Idle);
    assert_eq!(told(&model), ["stopped over seen"]);
    says(&mut model, 70, "left", NodeState::Stopped);
    assert_eq!(told(&model), ["stopped", "stopped over seen"]);
    assert_eq!(model.alarms().unseen(), 1);
}

#[test]
fn a_link_and_a_gateway_that_were_there_and_are_gone_are_alarms() {
    let down = |model: &mut Model, ms, why: &str| {
        let why = why.to_owned();
        model.apply(at(ms), Message::Link(LinkEvent::Down { why }));
    };
    let up = |model: &mut Model, ms| {
        let to = "here".to_owned();
        model.apply(at(ms), Message::Link(LinkEvent::Connected { to }));
    };
    let gateway = |model: &mut Model, ms, present| {
        model.apply(at(ms), Message::Link(LinkEvent::Gateway { present }));
    };
    let mut model = Model::default();
    down(&mut model, 0, "nothing answers");
    up(&mut model, 10);
    gateway(&mut model, 20, false);
    assert_eq!(told(&model), [""; 0], "there never was one");
    gateway(&mut model, 30, true);
    for ms in [40, 50] {
        gateway(&mut model, ms, false);
    }
    assert_eq!(model.alarms().unseen(), 1, "once");
    assert!(told(&model)[0].starts_with("no gateway answers"));
    gateway(&mut model, 60, true);
    assert!(told(&model)[0].ends_with(" over"));
    for ms in [70, 80] {
        down(&mut model, ms, "the router is gone");
    }
    assert_eq!((model.alarms().unseen(), model.alarms().open()), (2, 1));
    assert!(told(&model)[0].starts_with("no link: the router is gone. "));
    up(&mut model, 90);
    assert!(told(&model)[0].ends_with(" over"));
    assert_eq!(model.alarms().open(), 0);
    gateway(&mut model, 95, false);
    assert_eq!(model.alarms().open(), 1, "the router came back without it");
}

#[test]
fn one_alarm_is_acknowledged_alone() {
    let mut model = connected();
    for name in ["left", "right"] {
        alive(&mut model, 0, name, true);
        alive(&mut model, 10, name, false);
    }
    assert_eq!(told(&model), ["gone", "gone"]);
    let last = model.alarms().latest();
    acknowledge(&mut model, 20, Some(last));
    assert_eq!(told(&model), ["gone seen", "gone"]);
    acknowledge(&mut model, 21, Some(last));
    assert_eq!(model.alarms().unseen(), 1, "twice is once");
}

#[test]
fn a_latch_stays_an_alarm_while_its_node_is_gone() {
    let mut model = connected();
    alive(&mut model, 0, "left", true);
    says(&mut model, 10, "left", NodeState::Stopped);
    alive(&mut model, 20, "left", false);
    assert_eq!(told(&model), ["gone", "stopped"]);
    alive(&mut model, 30, "left", true);
    says(&mut model, 40, "left", NodeState::Idle);
    assert_eq!(told(&model), ["gone over", "stopped over"]);
}

#[test]
fn a_clock_gets_time_to_be_known_and_silence_is_noticed_without_messages() {
    let mut model = connected();
    alive(&mut model, 0, "left", true);
    let mut unlocked = record("left", NodeWord::Idle);
    unlocked.clock = None;
    model.apply(at(0), Message::Node(unlocked.clone()));
    for ms in [2_700, 5_000] {
        says(&mut model, ms, "left", NodeState::Idle);
        assert_eq!(told(&model), [""; 0]);
    }
    model.apply(at(5_500), Message::Node(unlocked));
    assert_eq!(model.alarms().unseen(), 1);
    assert!(told(&model)[0].contains("clock is not known"));
    model.tick(at(9_000));
    assert!(told(&model)[0].contains("says nothing"));
    says(&mut model, 9_100, "left", NodeState::Idle);
    assert!(told(&model)[0].ends_with("over"));
}

#[test]
fn without_a_link_nothing_but_that_is_raised_and_nothing_is_over() {
    let mut model = connected();
    alive(&mut model, 0, "left", true);
    let why = "cut".to_owned();
    model.apply(at(10), Message::Link(LinkEvent::Down { why }));
    model.tick(at(60_000));
    let words = "no link: cut. Nobody here hears of nodes or stops them";
    assert_eq!(told(&model), [words]);
}

#[test]
fn a_node_has_time_to_speak_after_the_link_returned() {
    let mut model = connected();
    alive(&mut model, 0, "left", true);
    says(&mut model, 10, "left", NodeState::Idle);
    let why = "cut".to_owned();
    model.apply(at(20), Message::Link(LinkEvent::Down { why }));
    let to = "here".to_owned();
    model.apply(at(60_000), Message::Link(LinkEvent::Connected { to }));
    model.tick(at(62_000));
    assert!(told(&model).len() == 1 && told(&model)[0].starts_with("no link: cut"));
    model.tick(at(64_000));
    assert!(told(&model)[0].contains("says nothing"));
}

#[test]
fn skew_beyond_the_promise_is_told_once_and_old_news_are_none() {
    let mut model = connected();
    let mut late = job("cut", at(0).0, 1, keys::record::JobState::Running);
    let start = |skew_us, planned| StartRecord {
        planned: FleetMicros(planned),
        skew_us,
        by_node_us: std::collections::BTreeMap::new(),
        uncertainty_us: 20.0,
    };
    let promise = |name: &str, max_skew_us| {
        Message::StartPlan(keys::record::StartPlan {
            job: keys::JobId::new(name).expect("a name"),
            told: FleetMicros(1),
            starts_at: FleetMicros(2),
            max_skew_us,
        })
    };
    model.apply(at(900), promise("cut", 1_000.0));
    for (version, skew_us) in [(1, 900.0), (2, 1_200.0), (3, 1_200.0)] {
        late.version = version;
        late.start = Some(Box::new(start(skew_us, at(0).0)));
        model.apply(at(1_000), Message::Job(Box::new(late.clone())));
    }
    let words = "cut started 1.2 ms apart ± 20 µs, promised 1.0 ms over";
    assert_eq!(told(&model), [words]);
    let mut old = job("old", 1, 1, keys::record::JobState::Running);
    old.start = Some(Box::new(start(5_000.0, 1)));
    model.apply(at(1_000), Message::Job(Box::new(old)));
    assert_eq!(told(&model).len(), 1);
    // What others were promised is theirs to say; without a word nobody knows.
    model.apply(at(900), promise("theirs", 8_000.0));
    for name in ["theirs", "silent"] {
        let mut other = job(name, at(0).0, 1, keys::record::JobState::Running);
        other.start = Some(Box::new(start(5_000.0, at(0).0)));
        model.apply(at(1_000), Message::Job(Box::new(other)));
    }
    assert_eq!(told(&model).len(), 1);
}

#[test]
fn the_list_has_a_bound_and_forgets_first_what_is_over_and_seen() {
    let mut model = connected();
    alive(&mut model, 0, "left", true);
    alive(&mut model, 0, "right", true);
    says(&mut model, 1, "right", NodeState::Stopped);
    for turn in 0..ALARMS_MAX as u64 {
        says(&mut model, 10 + 2 * turn, "left", NodeState::Stopped);
        says(&mut model, 11 + 2 * turn, "left", NodeState::Idle);
    }
    assert_eq!(told(&model).len(), ALARMS_MAX);
    assert_eq!(model.alarms().forgotten_unseen(), 1);
    assert!(told(&model).contains(&"stopped".to_owned()), "still open");
}
