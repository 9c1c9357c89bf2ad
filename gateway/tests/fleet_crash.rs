//! The power of the gateway fails after every single write of a day's work: every job whose
//! receipt a client holds ends, and no command is ever run twice.

mod rig;

use gateway::{
    fleet::{Fleet, FleetConfig, RestoreError},
    journal::Journal,
};
use keys::{FleetMicros, JobId, StopReason, record::JobState};
use rig::{MS, Rig, S, moves};
use serde_json::{Value, json};

/// A job whose commands can be told apart: `count` moves of 1, 2, 3, … steps.
fn counted(name: &str, count: u64) -> Value {
    let each = |index: u64| json!({"move": {"axis": 0, "delay_us": 1_000, "steps": index + 1}});
    json!({"id": name, "commands": (0..count).map(each).collect::<Vec<_>>()})
}

/// One day. Returns the receipts that were given.
fn day(rig: &mut Rig) -> Vec<JobId> {
    let mut receipts = Vec::new();
    let mut get = |rig: &mut Rig, node: &str, job: &Value| {
        if rig.dead {
            return;
        }
        let reply = rig.ask();
        let parsed = gateway::job::parse::parse("application/json", job.to_string().as_bytes());
        rig.event(gateway::fleet::event::Event::Submit {
            pattern: node.into(),
            request: parsed.request,
            id_hint: parsed.id_hint,
            reply: Some(reply),
        });
        for (_, answer) in rig.replies.remove(&reply).unwrap_or_default() {
            if let Some(name) = answer["job"].as_str() {
                receipts.push(rig::id(name));
            }
        }
    };
    rig.add("left");
    rig.add("right");
    rig.run(10 * MS);
    get(rig, "left", &counted("long", 40));
    get(rig, "left", &counted("next", 10));
    get(rig, "left", &counted("never", 10));
    get(rig, "*", &counted("both", 12));
    let mut slow = counted("slow", 60);
    slow["timeout_s"] = json!(0.3);
    get(rig, "right", &slow);
    rig.run(300 * MS);
    cancel(rig, "never");
    cancel(rig, "long");
    rig.run(S);
    rig.link("right", false);
    get(rig, "right", &counted("patient", 8));
    rig.put("left", &json!({"id": "wrong", "commands": []}));
    rig.run(S);
    rig.link("right", true);
    rig.run(2 * S);
    get(rig, "left", &counted("doomed", 90));
    get(rig, "left", &counted("behind", 5));
    rig.run(200 * MS);
    rig.stop("left");
    rig.run(100 * MS);
    rig.event(gateway::fleet::event::Event::Release {
        pattern: "left".into(),
        reply: None,
    });
    rig.run(S);
    get(rig, "left", &counted("after", 20));
    rig.run(3 * S);
    receipts
}

fn cancel(rig: &mut Rig, job: &str) {
    rig.event(gateway::fleet::event::Event::Cancel {
        pattern: job.into(),
        reply: None,
    });
}

/// What must be true of every fleet that has come to rest.
fn check(rig: &mut Rig, receipts: &[JobId], story: &str) {
    for id in receipts {
        let state = rig.state(id);
        let ended = state.is_final() && state != JobState::Rejected;
        let record = rig.record(id);
        let view = record.node.and_then(|node| rig.fleet.node(&node));
        assert!(ended, "{story}: job {id} is {state}; {view:#?}");
    }
    let jobs: Vec<_> = rig
        .fleet
        .jobs()
        .map(|job| job.entry.record.clone())
        .collect();
    for record in jobs
        .iter()
        .filter(|record| record.state != JobState::Rejected)
    {
        let node = record.node.expect("it has one");
        let node = &rig.nodes[&node];
        let steps: Vec<i32> = node
            .taken
            .iter()
            .filter(|(_, _, job, _)| *job == record.job)
            .map(|(_, _, _, command)| match command {
                keys::Command::Move { steps, .. } => *steps,
                other => panic!("{other:?}"),
            })
            .collect();
        let expected: Vec<i32> = (1..=steps.len() as i32).collect();
        assert_eq!(
            steps, expected,
            "{story}: job {} ran once, in order",
            record.job
        );
        let done = node.done.get(&record.job).copied().unwrap_or(0);
        assert!(record.progress.done <= done, "{story}: {record:?}");
        if record.state == JobState::Succeeded {
            assert_eq!(done, record.progress.total, "{story}: {record:?}");
        }
    }
}

#[test]
fn every_accepted_job_ends_and_no_command_runs_twice_wherever_the_power_fails() {
    let mut whole = Rig::new();
    let receipts = day(&mut whole);
    assert_eq!(receipts.len(), 10);
    check(&mut whole, &receipts, "without a failure");
    let write_count = whole.writes.len();
    assert!(write_count > 50, "{write_count}");
    for writes in 1..=write_count {
        for downtime_us in [50 * MS, 8 * S] {
            let story = format!("failure after write {writes}, away for {downtime_us} µs");
            let mut rig = Rig::new();
            rig.writes_left = Some(writes);
            let receipts = day_with_failure(&mut rig, downtime_us);
            heal(&mut rig);
            check(&mut rig, &receipts, &story);
        }
    }
}

/// A day in which the gateway is away for a while after its last write. Clients do not know: what
/// they ask meanwhile is lost.
fn day_with_failure(rig: &mut Rig, downtime_us: u64) -> Vec<JobId> {
    rig.restart_after_us = Some(downtime_us);
    day(rig)
}

fn heal(rig: &mut Rig) {
    rig.run(20 * S);
    assert!(!rig.dead);
    rig.event(gateway::fleet::event::Event::Release {
        pattern: "*".into(),
        reply: None,
    });
    rig.run(20 * S);
}

#[test]
fn a_gateway_that_restarts_in_the_middle_of_a_job_goes_on_where_the_node_is() {
    let mut rig = Rig::with_left();
    rig.node("left").ring_commands = 100;
    rig.run(2 * S);
    let job = rig.accept("left", &moves("a", 2_000, 100));
    for _ in 0..10 {
        rig.run(S);
        rig.restart_gateway();
        assert_eq!(rig.state(&job), JobState::Running);
        let has = rig.node("left").accepted();
        let said = rig.sent.len();
        rig.run(S);
        let batches = rig.sent[said..]
            .iter()
            .filter(|(_, _, topic, _, _)| *topic == keys::NodeTopic::Batch);
        for (_, _, _, _, payload) in batches {
            let reader = keys::BatchReader::new(payload).expect("an order");
            let keys::Order::Batch(header) = reader.order() else {
                panic!("no batch")
            };
            assert!(
                header.first_command >= has,
                "sent again although the node has it"
            );
        }
    }
    assert_eq!(rig.finish(&job, 60 * S), JobState::Succeeded);
    assert_eq!(rig.node("left").taken.len(), 2_000);
    assert!(!rig.states(&job).contains(&JobState::Lost));
}

#[test]
fn what_happened_to_a_node_while_the_gateway_was_away_is_found_out() {
    // It went on to the end.
    let story = |what: &dyn Fn(&mut Rig)| {
        let mut rig = Rig::with_left();
        let job = rig.accept("left", &moves("a", 20, 1_000));
        rig.run(S);
        rig.dead = true;
        rig.run(S / 2);
        what(&mut rig);
        rig.run(S);
        rig.restart_gateway();
        rig.run(10 * S);
        (rig.record(&job).clone(), rig)
    };
    let (record, _) = story(&|_| {});
    assert_eq!(record.state, JobState::Succeeded);
    // It was stopped.
    let (record, mut rig) = story(&|rig| {
        let now_us = rig.now_us;
        rig.node("left")
            .stop(StopReason::Pin, keys::StopMode::Halt, now_us);
    });
    assert_eq!(record.state, JobState::Failed);
    assert!(record.error.expect("why").message.contains("pin"));
    assert_eq!(
        record.result.expect("it ended").position,
        rig.node("left").positions
    );
    // It restarted.
    let (record, _) = story(&|rig| rig.reboot("left"));
    assert_eq!(record.state, JobState::Failed);
    assert!(record.error.expect("why").message.contains("restarted"));
    // It went away.
    let (record, mut rig) = story(&|rig| rig.link("left", false));
    assert_eq!(record.state, JobState::Lost);
    rig.link("left", true);
    rig.run(S);
    assert_eq!(rig.state(&record.job), JobState::Succeeded);
}

#[test]
fn a_day_in_a_file_is_the_same_after_the_next_start() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("fleet.redb");
    let mut rig = Rig::new();
    let receipts = day(&mut rig);
    let (mut journal, _) = Journal::open(&path).expect("opens");
    for writes in rig.writes.chunks(7) {
        journal.commit(writes).expect("commits");
    }
    drop(journal);
    let (_journal, stored) = Journal::open(&path).expect("opens again");
    assert_eq!(stored, rig.stored());
    let mut effects = Vec::new();
    let config = FleetConfig::default();
    let fleet = Fleet::restore(config, 1, stored, rig.now(), &mut effects).expect("is ours");
    for id in receipts {
        let (before, after) = (rig.fleet.job(&id), fleet.job(&id));
        assert_eq!(before.map(|job| &job.entry), after.map(|job| &job.entry));
    }
}

#[test]
fn a_store_that_cannot_be_read_is_refused_and_says_where() {
    let mut rig = Rig::with_left();
    rig.accept("left", &moves("a", 100, 1_000));
    rig.run(S);
    let restore = |stored| {
        let mut effects = Vec::new();
        let config = FleetConfig::default();
        let error = Fleet::restore(config, 1, stored, FleetMicros(1), &mut effects);
        error.expect_err("it must be refused")
    };
    let mut stored = rig.stored();
    stored.jobs[0].1.truncate(20);
    let error = restore(stored);
    assert!(
        matches!(&error, RestoreError::Job { job, .. } if job == "a"),
        "{error}"
    );
    let mut stored = rig.stored();
    stored.requests.clear();
    let error = restore(stored);
    assert!(
        matches!(&error, RestoreError::Request { job, .. } if job == "a"),
        "{error}"
    );
    let mut stored = rig.stored();
    stored.requests[0].1[0] = 99;
    let error = restore(stored);
    assert!(error.to_string().contains("version 99"), "{error}");
    let mut stored = rig.stored();
    stored.nodes[0].1.clear();
    let error = restore(stored);
    assert!(
        matches!(&error, RestoreError::Node { node, .. } if node == "left"),
        "{error}"
    );
}
