//! What the model makes of messages.

use super::*;
use crate::model::node::Presence;
use keys::{
    AxisStatus, Features, FleetMicros, JobId, LocalMicros, NodeState, QueueId, StopMode,
    record::{JobRecord, JobState, Progress, QueueRecord},
};

pub(super) fn id(name: &str) -> NodeId {
    NodeId::new(name).expect("a name")
}

pub(super) fn at(ms: u64) -> Moment {
    Moment(1_000_000_000).plus_us(ms * 1_000)
}

pub(crate) fn status(state: NodeState) -> Box<Status> {
    let axis = AxisStatus {
        position_steps: 7,
        speed_mhz: -1_500,
    };
    Box::new(Status {
        at: LocalMicros(5),
        queue: QueueId { boot: 1, flush: 0 },
        state,
        stop: None,
        job: None,
        accepted_commands: 9,
        executed_commands: 4,
        credit_commands: 100,
        axes: std::iter::once(axis).collect(),
        faults: heapless::Vec::new(),
        features: Features::BASIC,
        firmware: [0, 1, 0],
        rssi_dbm: Some(-50),
        laser_percent: 0,
        lidar_mm: None,
    })
}

pub(super) fn says(model: &mut Model, ms: u64, name: &str, state: NodeState) {
    let (node, status) = (id(name), status(state));
    model.apply(at(ms), Message::Status { node, status });
}

pub(super) fn alive(model: &mut Model, ms: u64, name: &str, alive: bool) {
    let node = id(name);
    model.apply(at(ms), Message::Alive { node, alive });
}

pub(crate) fn record(name: &str, state: NodeWord) -> Box<NodeRecord> {
    Box::new(NodeRecord {
        node: id(name),
        alive: state != NodeWord::Offline,
        state,
        position: vec![1],
        queue: QueueRecord::default(),
        job: None,
        stopped: None,
        clock: None,
        firmware: "0.1.0".to_owned(),
        uptime_s: 0,
        rssi_dbm: None,
        faults: Vec::new(),
        pace: None,
    })
}

pub(super) fn job(name: &str, created_us: u64, version: u64, state: JobState) -> JobRecord {
    JobRecord {
        job: JobId::new(name).expect("a name"),
        node: None,
        group: None,
        state,
        version,
        created: FleetMicros(created_us),
        updated: FleetMicros(created_us),
        progress: Progress::default(),
        error: None,
        result: None,
        parts: None,
        start: None,
    }
}

pub(super) fn up(model: &mut Model) {
    let to = "tcp/x:1".to_owned();
    model.apply(at(0), Message::Link(LinkEvent::Connected { to }));
}

#[test]
fn a_node_says_more_about_itself_than_the_gateway_does() {
    let mut model = Model::default();
    model.apply(at(0), Message::Node(record("a", NodeWord::Idle)));
    let node = model.node(&id("a")).expect("known");
    assert_eq!(
        (node.word(), node.positions_steps()),
        (NodeWord::Idle, vec![1])
    );
    says(&mut model, 10, "a", NodeState::Running);
    let node = model.node(&id("a")).expect("known");
    assert_eq!(
        (node.word(), node.positions_steps()),
        (NodeWord::Running, vec![7])
    );
    assert_eq!(node.speeds_hz(), [-1.5]);
    assert_eq!(node.queue(), Some((5, 100)));
    // Its last status was lost on the way: the newer record knows.
    model.apply(at(500), Message::Node(record("a", NodeWord::Stopped)));
    let node = model.node(&id("a")).expect("known");
    assert_eq!(node.word(), NodeWord::Stopped);
}

#[test]
fn silence_grows_old_only_by_the_models_own_time() {
    let mut model = Model::default();
    up(&mut model);
    alive(&mut model, 0, "a", true);
    says(&mut model, 100, "a", NodeState::Idle);
    model.tick(at(3_000));
    assert_eq!(model.totals().alive, 1);
    model.tick(at(3_200));
    let node = model.node(&id("a")).expect("known");
    assert_eq!(node.presence(model.now()), Presence::Stale);
    assert_eq!(model.concern(node), Some(Concern::Silent));
    assert_eq!((model.totals().stale, model.alarms().unseen()), (1, 1));
    model.tick(at(0));
    assert_eq!(model.now(), at(3_200), "time does not go back");
    // With the link down, silence says nothing about the node.
    let why = "cut".to_owned();
    model.apply(at(3_300), Message::Link(LinkEvent::Down { why }));
    let node = model.node(&id("a")).expect("known");
    assert_eq!(model.concern(node), None);
    let totals = model.totals();
    assert_eq!((totals.unknown, totals.alive, totals.stale), (1, 0, 0));
}

#[test]
fn a_node_that_goes_is_lost_and_one_that_was_never_there_is_not() {
    let mut model = Model::default();
    up(&mut model);
    model.apply(at(0), Message::Node(record("old", NodeWord::Offline)));
    alive(&mut model, 0, "a", true);
    alive(&mut model, 50, "a", false);
    let concern = |model: &Model, name| model.concern(model.node(&id(name)).expect("known"));
    assert_eq!(concern(&model, "old"), None);
    assert_eq!(concern(&model, "a"), Some(Concern::Lost));
    alive(&mut model, 60, "a", true);
    assert_eq!(concern(&model, "a"), None);
    let words: Vec<_> = model
        .log()
        .lines()
        .iter()
        .map(|line| &line.text[..])
        .collect();
    assert_eq!(words[1..], ["is there", "is gone", "is there"]);
}

#[test]
fn a_stop_expects_the_nodes_that_were_there_and_takes_only_their_own_word() {
    let mut model = Model::default();
    for name in ["a", "b"] {
        alive(&mut model, 0, name, true);
    }
    alive(&mut model, 0, "gone", true);
    alive(&mut model, 1, "gone", false);
    says(&mut model, 5, "a", NodeState::Stopped);
    let ticket = Ticket(1);
    let asked = Message::StopAsked {
        ticket,
        scope: Scope::All,
        mode: StopMode::Halt,
    };
    model.apply(at(10), asked);
    let answer = Answer::Sent;
    model.apply(at(11), Message::Answer { ticket, answer });
    model.apply(at(12), Message::Node(record("b", NodeWord::Stopped)));
    let effort = model.efforts().next().expect("begun");
    assert_eq!(
        (effort.confirmed(), effort.expected()),
        (0, 2),
        "old or hearsay"
    );
    rests(&mut model, 15, "b", NodeState::Fault);
    rests(&mut model, 30, "a", NodeState::Stopped);
    rests(&mut model, 900, "a", NodeState::Stopped);
    let effort = model.efforts().next().expect("begun");
    assert!(effort.is_complete());
    assert_eq!(effort.took_s(), Some(0.020));
}

/// The same of a node whose axes all stand still.
fn rests(model: &mut Model, ms: u64, name: &str, state: NodeState) {
    let (node, mut status) = (id(name), status(state));
    for axis in &mut status.axes {
        axis.speed_mhz = 0;
    }
    model.apply(at(ms), Message::Status { node, status });
}

#[test]
fn a_slow_stop_is_confirmed_when_the_node_is_at_rest_and_not_when_its_latch_is_set() {
    let mut model = Model::default();
    alive(&mut model, 0, "a", true);
    let asked = Message::StopAsked {
        ticket: Ticket(1),
        scope: Scope::All,
        mode: StopMode::Decelerate,
    };
    model.apply(at(10), asked);
    says(&mut model, 20, "a", NodeState::Stopped);
    let effort = |model: &Model| {
        let effort = model.efforts().next().expect("begun").clone();
        let coming: Vec<_> = effort.coming_to_rest().collect();
        (effort.confirmed(), coming, effort.missing().count())
    };
    assert_eq!(effort(&model), (0, vec![id("a")], 0), "it decelerates");
    rests(&mut model, 420, "a", NodeState::Stopped);
    assert_eq!(effort(&model), (1, Vec::new(), 0));
    let effort = model.efforts().next().expect("begun");
    assert_eq!((effort.is_complete(), effort.took_s()), (true, Some(0.41)));
}

#[test]
fn a_job_is_what_its_highest_version_says() {
    let mut model = Model::default();
    let job = JobId::new("j").expect("a name");
    let tell = |model: &mut Model, version, state| {
        let record = self::job("j", 1, version, state);
        model.apply(at(0), Message::Job(Box::new(record)));
        model.jobs().get(&job).map(|record| record.state)
    };
    assert_eq!(
        tell(&mut model, 1, JobState::Queued),
        Some(JobState::Queued)
    );
    assert_eq!(
        tell(&mut model, 3, JobState::Succeeded),
        Some(JobState::Succeeded)
    );
    assert_eq!(
        tell(&mut model, 2, JobState::Running),
        Some(JobState::Succeeded)
    );
}

#[test]
fn everything_that_is_kept_has_a_bound() {
    let mut model = Model::default();
    for number in 0..limits::SAMPLES_MAX as u64 + 10 {
        says(&mut model, number, "a", NodeState::Idle);
    }
    let node = model.node(&id("a")).expect("known");
    assert_eq!(node.samples().iter().len(), limits::SAMPLES_MAX);
    for number in 0..limits::NODES_MAX + 3 {
        alive(&mut model, 0, &format!("n{number}"), true);
    }
    assert_eq!(model.nodes().count(), limits::NODES_MAX);
    assert_eq!(model.nodes_refused(), 4);
    for number in 0..limits::EFFORTS_MAX as u64 + 5 {
        let asked = Message::ReleaseAsked {
            ticket: Ticket(number),
            scope: Scope::All,
        };
        model.apply(at(0), asked);
    }
    assert_eq!(model.efforts().count(), limits::EFFORTS_MAX);
}

#[test]
fn retries_do_not_fill_the_log() {
    let mut model = Model::default();
    for second in 0..100 {
        let to = "tcp/x:1".to_owned();
        model.apply(
            at(second * 1_000),
            Message::Link(LinkEvent::Connecting { to }),
        );
        let why = "nobody".to_owned();
        model.apply(
            at(second * 1_000 + 9),
            Message::Link(LinkEvent::Down { why }),
        );
    }
    assert_eq!(model.log().lines().len(), 1);
    assert_eq!(model.link().since(), at(9), "down since the first failure");
}
