//! What the contract promises to clients, against a fleet in a bottle.

mod rig;

use gateway::fleet::{FleetConfig, event::Event};
use keys::{
    Features, NodeId, StopMode, StopReason,
    record::{ErrorCode, JobState, NodeWord},
};
use rig::{MS, Rig, S, error_of, id, moves};
use serde_json::{Value, json};

#[test]
fn a_job_goes_from_queued_to_succeeded_and_the_record_tells_where_the_axes_are() {
    let mut rig = Rig::with_left();
    let job = rig.accept("left", &moves("part-1", 10, 1_000));
    assert_eq!(rig.finish(&job, 5 * S), JobState::Succeeded);
    use JobState::{Queued, Running, Sent, Succeeded};
    assert_eq!(rig.states(&job), [Queued, Sent, Running, Succeeded]);
    let record = rig.record(&job);
    assert_eq!((record.progress.done, record.progress.total), (10, 10));
    let result = record.result.as_ref().expect("it has ended");
    assert_eq!(result.position, [10_000, 0]);
    assert_eq!(record.error, None);
    let json = serde_json::to_value(record).expect("JSON");
    for field in ["group", "error", "parts"] {
        assert_eq!(
            json.get(field),
            Some(&Value::Null),
            "{field} is there and null"
        );
    }
}

#[test]
fn a_job_of_a_hundred_thousand_commands_passes_a_ring_of_four_thousand() {
    let mut rig = Rig::with_left();
    let each =
        |index: usize| json!({"move": {"axis": index % 2, "delay_us": 20, "steps": index % 7 + 1}});
    let commands: Vec<Value> = (0..100_000).map(each).collect();
    let job = rig.accept("left", &json!({"commands": commands}));
    assert_eq!(rig.finish(&job, 60 * S), JobState::Succeeded);
    let taken = &rig.node("left").taken;
    assert_eq!(taken.len(), 100_000);
    assert!(
        taken
            .iter()
            .enumerate()
            .all(|(at, (_, number, _, _))| *number == at as u64)
    );
    let updates = rig.records.len();
    assert!(
        updates < 30,
        "{updates} records in 8 s: at most two a second and the changes"
    );
}

#[test]
fn jobs_of_one_node_run_one_after_the_other_in_their_order() {
    let mut rig = Rig::with_left();
    let jobs: Vec<_> = ["c", "a", "b"]
        .into_iter()
        .map(|name| rig.accept("left", &moves(name, 3, 100)))
        .collect();
    rig.finish(&jobs[2], 10 * S);
    let order: Vec<_> = rig
        .node("left")
        .taken
        .iter()
        .map(|(_, _, job, _)| *job)
        .collect();
    let expected: Vec<_> = jobs.iter().flat_map(|job| [*job; 3]).collect();
    assert_eq!(order, expected);
    let running = |rig: &Rig| {
        rig.fleet
            .jobs()
            .filter(|j| j.state() == JobState::Running)
            .count()
    };
    assert_eq!(running(&rig), 0);
}

#[test]
fn the_same_id_again_answers_with_the_job_that_exists_and_does_nothing() {
    let mut rig = Rig::with_left();
    rig.add("right");
    rig.run(10 * MS);
    let job = rig.accept("left", &moves("part-1", 5, 100));
    let before = rig.records.len();
    // Twice, another job, another node, by put: nothing.
    assert_eq!(
        rig.get("left", &moves("part-1", 5, 100))[0]["state"],
        "sent"
    );
    assert_eq!(rig.get("left", &moves("part-1", 9, 9))[0]["job"], "part-1");
    assert_eq!(
        rig.get("right", &moves("part-1", 5, 100))[0]["job"],
        "part-1"
    );
    rig.put("left", &moves("part-1", 5, 100));
    assert_eq!(rig.records.len(), before);
    rig.finish(&job, 5 * S);
    assert_eq!(
        rig.get("left", &moves("part-1", 5, 100))[0]["state"],
        "succeeded"
    );
    assert_eq!(rig.node("left").taken.len(), 5);
}

#[test]
fn ids_that_the_gateway_makes_are_names_that_sort_by_time() {
    let mut rig = Rig::with_left();
    let job = json!({"commands": [{"pause": {"ms": 1}}]});
    let mut made = Vec::new();
    for wait_us in [0, 0, 1, 1_000, 10 * S] {
        rig.run(wait_us);
        made.push(rig.accept("left", &job));
    }
    let mut sorted = made.clone();
    sorted.sort();
    sorted.dedup();
    assert_eq!(made, sorted);
    for id in made {
        let legal = |byte: u8| byte.is_ascii_lowercase() || byte.is_ascii_digit();
        assert!(id.as_str().bytes().all(legal), "{id}");
    }
}

#[test]
fn a_refused_get_gets_an_error_and_leaves_no_record() {
    let mut rig = Rig::with_left();
    let code = |rig: &mut Rig, node: &str, job: &Value| rig.refuse(node, job).0;
    assert_eq!(code(&mut rig, "right", &moves("a", 1, 1)), "unknown_node");
    assert_eq!(code(&mut rig, "RIGHT", &moves("a", 1, 1)), "unknown_node");
    assert_eq!(code(&mut rig, "left", &json!({"comands": []})), "bad_json");
    assert_eq!(
        code(&mut rig, "left", &json!({"commands": []})),
        "bad_command"
    );
    assert_eq!(
        code(&mut rig, "left", &json!({"id": "A", "commands": []})),
        "bad_id"
    );
    assert!(rig.records.is_empty());
    assert_eq!(rig.jobs("*", &[]), Vec::<Value>::new());
}

#[test]
fn a_refused_put_leaves_a_rejected_record_under_its_id_or_a_made_one() {
    let mut rig = Rig::with_left();
    rig.put("right", &moves("part-1", 1, 1));
    let record = rig.record(&id("part-1")).clone();
    assert_eq!(record.state, JobState::Rejected);
    assert_eq!(record.error.expect("why").code, ErrorCode::UnknownNode);
    assert_eq!(record.node, NodeId::new("right").ok());
    rig.put("left", &json!({"commands": [{"move": {"axis": 0}}]}));
    let made = rig.records.last().expect("a record");
    assert_eq!(made.state, JobState::Rejected);
    assert_eq!(
        made.error.as_ref().expect("why").code,
        ErrorCode::BadCommand
    );

    // The id of a rejected job is free, and its record goes on.
    let job = rig.accept("left", &moves("part-1", 2, 100));
    assert_eq!(rig.record(&job).version, 3, "rejected, queued, sent");
    rig.finish(&job, 5 * S);
    // The id of another job is not: a wrong job under it gets a made one.
    let version = rig.record(&job).version;
    rig.put("left", &json!({"id": "part-1", "commands": []}));
    assert_eq!(rig.record(&job).version, version);
    let last = rig.records.last().expect("a record");
    assert_ne!(last.job, job);
    assert_eq!(last.state, JobState::Rejected);
}

#[test]
fn what_a_node_cannot_do_is_refused_with_the_place() {
    let mut rig = Rig::with_left();
    let pause = json!({"pause": {"ms": 1}});
    let ramp = json!({"ramp": {"axis": 0, "steps": 10, "speed_hz": 5, "accel": 1}});
    for (commands, expected) in [
        (
            json!([pause, ramp]),
            "commands[1].ramp: not supported by this node's firmware",
        ),
        (
            json!([{"ramp_to": {"axis": 0, "position": 10, "speed_hz": 5, "accel": 1}}]),
            "commands[0].ramp_to: not supported by this node's firmware",
        ),
        (
            json!([{"line": {"steps": [10, 5], "speed_hz": 5, "accel": 1}}]),
            "commands[0].line: not supported by this node's firmware",
        ),
        (
            json!([{"smooth_ramp": {"axis": 0, "steps": 10, "start_hz": 1, "speed_hz": 5, "ramp_steps": 2}}]),
            "commands[0].smooth_ramp: not supported by this node's firmware",
        ),
        (
            json!([{"home": {"axis": 0}}]),
            "commands[0].home.axis: axis 0 of this node has no reference switch",
        ),
        (
            json!([pause, pause, {"barrier": {"name": "x"}}]),
            "commands[2].barrier: not supported by this node's firmware",
        ),
        (
            json!([pause, {"move": {"axis": 2, "delay_us": 5, "steps": 1}}]),
            "commands[1].move.axis: axis 2 does not exist; the node has axes 0 to 1",
        ),
        (
            json!([{"set_position": {"axis": 7, "position": 1}}]),
            "commands[0].set_position.axis: axis 7 does not exist; the node has axes 0 to 1",
        ),
    ] {
        let (code, message) = rig.refuse("left", &json!({"commands": commands}));
        assert_eq!((code.as_str(), message.as_str()), ("bad_command", expected));
    }
    let (code, message) = rig.refuse("left", &json!({"lua": "motor.execute()"}));
    assert_eq!(code, "bad_command");
    assert_eq!(message, "lua: not supported by this node's firmware");

    let cut = json!({"id": "cut-7", "nodes": {"left": {"commands": [ramp]}}});
    let expected = "nodes.left: synchronized jobs are not supported by this node's firmware";
    assert_eq!(
        rig.refuse_group(&cut),
        ("bad_command".into(), expected.into())
    );
    rig.submit_group("g1", &cut, None);
    let record = rig.record(&id("cut-7"));
    assert_eq!(record.state, JobState::Rejected);
    assert_eq!(
        record.group.map(|group| group.to_string()),
        Some("g1".into())
    );

    // A firmware that can, may.
    rig.node("left").features = Features::BASIC.with(Features::RAMPS);
    rig.run(2 * S);
    rig.accept("left", &json!({"commands": [ramp]}));
    // Ramps alone are not all of them.
    let smooth = json!({"smooth_ramp_to":
        {"axis": 0, "position": 10, "start_hz": 1, "speed_hz": 5, "ramp_steps": 2}});
    let (_, message) = rig.refuse("left", &json!({"commands": [ramp, smooth]}));
    let expected = "commands[1].smooth_ramp_to: not supported by this node's firmware";
    assert_eq!(message, expected);
    let features = Features::BASIC.with(Features::RAMPS);
    rig.node("left").features = features.with(Features::SMOOTH);
    rig.run(2 * S);
    rig.accept("left", &json!({"commands": [smooth]}));
}

#[test]
fn an_axis_is_homed_if_it_has_a_switch() {
    let mut rig = Rig::with_left();
    let home = |axis: u8| json!({"commands": [{"home": {"axis": axis}}]});
    let of_1 = keys::Command::Home {
        axis: keys::AxisId(1),
    };
    rig.node("left").features = Features::BASIC.with(of_1.feature());
    rig.run(2 * S);
    rig.accept("left", &home(1));
    let (_, message) = rig.refuse("left", &home(0));
    let expected = "commands[0].home.axis: axis 0 of this node has no reference switch";
    assert_eq!(message, expected);
    let (_, message) = rig.refuse("left", &home(7));
    assert!(message.contains("axis 7 does not exist"), "{message}");
}

#[test]
fn a_job_for_a_node_that_is_offline_waits_unless_it_says_otherwise() {
    let mut rig = Rig::with_left();
    rig.link("left", false);
    let mut job = moves("b", 1, 10);
    job["offline"] = json!("reject");
    assert_eq!(rig.refuse("left", &job).0, "node_offline");
    let job = rig.accept("left", &moves("a", 4, 100));
    rig.run(20 * S);
    assert_eq!(rig.state(&job), JobState::Queued);
    rig.link("left", true);
    assert_eq!(rig.finish(&job, 5 * S), JobState::Succeeded);
}

#[test]
fn a_job_that_waited_is_checked_again_when_its_node_returns_with_another_firmware() {
    let mut rig = Rig::with_left();
    rig.link("left", false);
    let command = json!({"move": {"axis": 1, "delay_us": 50, "steps": 10}});
    let job = rig.accept("left", &json!({"commands": [command]}));
    rig.node("left").axis_count = 1;
    rig.link("left", true);
    assert_eq!(rig.finish(&job, 5 * S), JobState::Failed);
    let error = rig.record(&job).error.clone().expect("why");
    assert_eq!(error.code, ErrorCode::BadCommand);
    assert!(rig.node("left").taken.is_empty());
}

#[test]
fn a_wild_key_makes_one_job_for_each_node_that_is_there() {
    let mut rig = Rig::new();
    for name in ["cell-a-1", "cell-a-2", "cell-a-3", "cell-b-1"] {
        rig.add(name);
    }
    rig.run(10 * MS);
    rig.link("cell-a-3", false);
    let replies = rig.get("cell-a-$*", &moves("cut", 3, 100));
    let named: Vec<_> = replies.iter().map(|reply| reply["job"].as_str()).collect();
    assert_eq!(named, [Some("cut-cell-a-1"), Some("cut-cell-a-2")]);
    // The same again changes nothing, and one job more is made for a node that came since.
    rig.link("cell-a-3", true);
    rig.run(10 * MS);
    let replies = rig.get("cell-a-$*", &moves("cut", 3, 100));
    assert_eq!(replies.len(), 3);
    assert_eq!(replies[2]["state"], "queued");
    for name in ["cut-cell-a-1", "cut-cell-a-2", "cut-cell-a-3"] {
        assert_eq!(rig.finish(&id(name), 5 * S), JobState::Succeeded);
    }
    assert!(rig.node("cell-b-1").taken.is_empty());
    let unnamed = rig.get("*", &json!({"commands": [{"pause": {"ms": 1}}]}));
    assert_eq!(unnamed.len(), 4);
}

#[test]
fn a_wild_key_that_reaches_nobody_says_whether_somebody_was_ever_there() {
    let mut rig = Rig::with_left();
    assert_eq!(rig.refuse("cell-$*", &moves("a", 1, 1)).0, "unknown_node");
    rig.link("left", false);
    assert_eq!(rig.refuse("*", &moves("a", 1, 1)).0, "node_offline");
    rig.put("*", &moves("a", 1, 1));
    let record = rig.record(&id("a"));
    assert_eq!((record.state, record.node), (JobState::Rejected, None));
    rig.link("left", true);
    rig.run(10 * MS);
    let long = "a".repeat(30);
    assert_eq!(rig.refuse("*", &moves(&long, 1, 1)).0, "bad_id");
}

#[test]
fn a_job_that_waits_is_canceled_at_once_and_one_that_runs_after_its_last_pulse() {
    let mut rig = Rig::with_left();
    let first = rig.accept("left", &moves("first", 100, 1_000));
    let second = rig.accept("left", &moves("second", 1, 1_000));
    assert_eq!(rig.cancel("second")[0]["state"], "canceled");
    rig.run_until(5 * S, |rig| rig.state(&first) == JobState::Running);
    assert_eq!(rig.cancel("first")[0]["state"], "running");
    assert_eq!(rig.finish(&first, S), JobState::Canceled);
    let record = rig.record(&first).clone();
    let position = record.result.expect("it has ended").position;
    assert_eq!(position, rig.node("left").positions);
    assert!(position[0] > 0 && position[0] < 100_000, "{position:?}");
    assert_eq!(rig.node("left").latched, None);
    // The node is free again, and what was canceled does not run.
    let third = rig.accept("left", &moves("third", 1, 10));
    assert_eq!(rig.finish(&third, 5 * S), JobState::Succeeded);
    assert_eq!(rig.state(&second), JobState::Canceled);
}

#[test]
fn a_cancel_of_what_is_over_answers_with_the_record_and_of_nothing_with_an_error() {
    let mut rig = Rig::with_left();
    let job = rig.accept("left", &moves("a", 1, 10));
    rig.finish(&job, 5 * S);
    let version = rig.record(&job).version;
    assert_eq!(rig.cancel("a")[0]["state"], "succeeded");
    assert_eq!(rig.record(&job).version, version);
    let replies = rig.cancel("b");
    assert_eq!(error_of(&replies[0]).0, "bad_id");
    assert_eq!(rig.cancel("*"), Vec::<Value>::new());
    let jobs = [
        rig.accept("left", &moves("c", 50, 1_000)),
        rig.accept("left", &moves("d", 50, 1_000)),
    ];
    assert_eq!(rig.cancel("*").len(), 2);
    for job in jobs {
        assert_eq!(rig.finish(&job, 5 * S), JobState::Canceled);
    }
}

#[test]
fn a_cancel_that_comes_too_late_does_not_hit_the_next_job() {
    let mut rig = Rig::with_left();
    let first = rig.accept("left", &moves("first", 1, 1_000));
    let second = rig.accept("left", &moves("second", 10, 100));
    // The last pulse of the first one leaves while the cancel is on its way.
    let end_us = rig.now_us + 101 * MS;
    rig.run(end_us - rig.now_us - MS / 2);
    rig.cancel("first");
    assert_eq!(rig.finish(&first, 5 * S), JobState::Succeeded);
    assert_eq!(rig.finish(&second, 5 * S), JobState::Succeeded);
    assert_eq!(rig.node("left").positions, [2_000, 0]);
}

#[test]
fn a_job_that_takes_too_long_is_stopped_without_a_latch() {
    let mut rig = Rig::with_left();
    let mut job = moves("slow", 100, 1_000);
    job["timeout_s"] = json!(1.5);
    let slow = rig.accept("left", &job);
    let next = rig.accept("left", &moves("next", 1, 10));
    let begun_us = rig.now_us;
    assert_eq!(rig.finish(&slow, 10 * S), JobState::TimedOut);
    let took_us = rig.now_us - begun_us;
    assert!((1_500 * MS..1_700 * MS).contains(&took_us), "{took_us}");
    assert!(rig.record(&slow).result.is_some());
    assert_eq!(rig.finish(&next, S), JobState::Succeeded);
}

#[test]
fn after_a_stop_nothing_moves_until_the_release_and_then_only_new_jobs() {
    let mut rig = Rig::with_left();
    let first = rig.accept("left", &moves("first", 100, 1_000));
    let second = rig.accept("left", &moves("second", 1, 1_000));
    rig.run(S);
    rig.stop("*");
    assert_eq!(rig.state(&second), JobState::Failed);
    assert_eq!(rig.refuse("left", &moves("early", 1, 1)).0, "stopped");
    assert_eq!(rig.finish(&first, S), JobState::Failed);
    for job in [first, second] {
        let error = rig.record(&job).error.clone().expect("why");
        assert_eq!(error.code, ErrorCode::Stopped);
        assert!(error.message.contains("client"), "{error}");
    }
    let position = rig
        .record(&first)
        .result
        .clone()
        .expect("it has ended")
        .position;
    assert_eq!(position, rig.node("left").positions);
    rig.run(100 * MS);
    let view = rig.view("left");
    assert_eq!(view.state, NodeWord::Stopped);
    assert_eq!(view.stopped.expect("it is").reason, StopReason::Client);
    assert_eq!(rig.refuse("left", &moves("third", 1, 1)).0, "stopped");

    let taken = rig.node("left").taken.len();
    let reply = rig.release("left");
    rig.run(S);
    let replies = rig.answers(reply);
    assert_eq!(replies[0]["state"], "idle");
    assert_eq!(replies[0]["stopped"], Value::Null);
    rig.run(5 * S);
    assert_eq!(rig.node("left").taken.len(), taken, "nothing old moves");
    let fourth = rig.accept("left", &moves("fourth", 1, 10));
    assert_eq!(rig.finish(&fourth, S), JobState::Succeeded);
}

#[test]
fn a_release_is_not_done_because_of_a_status_from_before_the_stop() {
    let mut rig = Rig::with_left();
    rig.accept("left", &moves("a", 50, 100));
    rig.run(100 * MS);
    // What the node said last is still on its way when it hears the stop.
    let now_us = rig.now_us;
    rig.stop("left");
    rig.node("left").tell(now_us);
    let reply = rig.release("left");
    rig.run(2 * S);
    let answers = rig.answers(reply);
    assert_eq!(answers.len(), 1, "{answers:?}");
    assert_eq!(answers[0]["state"], "idle", "{answers:?}");
    assert_eq!(rig.node("left").latched, None, "told as released");
}

#[test]
fn a_release_answers_for_every_case() {
    let mut rig = Rig::with_left();
    // Not stopped: the record.
    let reply = rig.release("left");
    assert_eq!(rig.answers(reply)[0]["state"], "idle");
    let reply = rig.release("right");
    assert_eq!(error_of(&rig.answers(reply)[0]).0, "unknown_node");
    rig.add("right");
    rig.run(10 * MS);
    rig.stop("*");
    rig.run(10 * MS);
    // All at once: a reply each.
    let reply = rig.release("*");
    rig.run(10 * MS);
    assert_eq!(rig.answers(reply).len(), 2);
    // With the stop input active it stays stopped.
    rig.stop("left");
    rig.node("left").stop_pin = true;
    rig.run(10 * MS);
    let reply = rig.release("left");
    rig.run(5 * S);
    assert_eq!(error_of(&rig.answers(reply)[0]).0, "not_allowed");
    assert_eq!(rig.view("left").state, NodeWord::Stopped);
    // Gone while the release is on its way, and before.
    let reply = rig.release("left");
    rig.link("left", false);
    assert_eq!(error_of(&rig.answers(reply)[0]).0, "node_offline");
    let reply = rig.release("left");
    assert_eq!(error_of(&rig.answers(reply)[0]).0, "node_offline");
}

#[test]
fn a_stop_that_a_node_could_not_hear_reaches_it_when_it_returns() {
    let mut rig = Rig::with_left();
    rig.link("left", false);
    let job = rig.accept("left", &moves("a", 1, 10));
    rig.stop("*");
    assert_eq!(rig.state(&job), JobState::Failed);
    assert_eq!(rig.refuse("left", &moves("b", 1, 10)).0, "stopped");
    rig.run(10 * S);
    rig.restart_gateway();
    assert_eq!(rig.refuse("left", &moves("b", 1, 10)).0, "stopped");
    rig.link("left", true);
    rig.run(100 * MS);
    assert_eq!(rig.node("left").latched, Some(StopReason::Client));
    assert_eq!(rig.view("left").state, NodeWord::Stopped);
    let reply = rig.release("left");
    rig.run(3 * S);
    assert_eq!(rig.answers(reply)[0]["state"], "idle");
    assert_eq!(rig.node("left").latched, None, "the stop is not repeated");
    let job = rig.accept("left", &moves("c", 1, 10));
    assert_eq!(rig.finish(&job, S), JobState::Succeeded);
}

#[test]
fn a_node_that_stops_itself_fails_its_job_and_what_waits_unless_only_the_link_was_lost() {
    for (reason, word, waiting) in [
        (StopReason::Pin, "pin", JobState::Failed),
        (StopReason::Fault, "fault", JobState::Failed),
        (StopReason::Limit, "limit", JobState::Failed),
        (StopReason::Link, "link", JobState::Queued),
    ] {
        let mut rig = Rig::with_left();
        let first = rig.accept("left", &moves("first", 100, 1_000));
        let second = rig.accept("left", &moves("second", 1, 10));
        rig.run(S);
        let now_us = rig.now_us;
        rig.node("left").stop(reason, StopMode::Decelerate, now_us);
        assert_eq!(rig.finish(&first, S), JobState::Failed);
        let error = rig.record(&first).error.clone().expect("why");
        assert_eq!(error.code, ErrorCode::Stopped);
        assert!(error.message.contains(word), "{error}");
        rig.run(100 * MS);
        assert_eq!(rig.view("left").stopped.expect("it is").reason, reason);
        assert_eq!(rig.state(&second), waiting, "{word}");
        let reply = rig.release("left");
        rig.run(100 * MS);
        assert_eq!(rig.answers(reply)[0]["alive"], true);
        if waiting == JobState::Queued {
            assert_eq!(rig.finish(&second, S), JobState::Succeeded);
        }
    }
}

#[test]
fn a_job_whose_node_is_gone_is_lost_until_the_node_tells_how_it_went() {
    let mut rig = Rig::with_left();
    let job = rig.accept("left", &moves("a", 30, 1_000));
    rig.run(S);
    rig.link("left", false);
    assert_eq!(rig.state(&job), JobState::Lost);
    assert_eq!(rig.view("left").state, NodeWord::Offline);
    rig.run(S);
    // Back in the middle of it.
    rig.link("left", true);
    rig.run(10 * MS);
    assert_eq!(rig.state(&job), JobState::Running);
    // Back after the end of it.
    rig.link("left", false);
    rig.run(20 * S);
    rig.link("left", true);
    assert_eq!(rig.finish(&job, S), JobState::Succeeded);
    assert_eq!(rig.node("left").taken.len(), 30);
}

#[test]
fn a_node_that_stopped_while_it_was_away_tells_so_when_it_returns() {
    let mut rig = Rig::with_left();
    let job = rig.accept("left", &moves("a", 30, 1_000));
    rig.run(S);
    rig.link("left", false);
    rig.run(S);
    let now_us = rig.now_us;
    rig.node("left")
        .stop(StopReason::Link, StopMode::Decelerate, now_us);
    rig.run(10 * S);
    rig.link("left", true);
    assert_eq!(rig.finish(&job, S), JobState::Failed);
    let record = rig.record(&job).clone();
    assert!(record.progress.done >= 19, "{:?}", record.progress);
    let position = record.result.expect("it has ended").position;
    assert_eq!(position, rig.node("left").positions);
}

#[test]
fn a_node_that_restarted_fails_its_job_and_never_gets_its_commands_again() {
    let mut rig = Rig::with_left();
    let first = rig.accept("left", &moves("first", 30, 1_000));
    let second = rig.accept("left", &moves("second", 2, 100));
    rig.run(S);
    rig.reboot("left");
    assert_eq!(rig.finish(&first, S), JobState::Failed);
    let error = rig.record(&first).error.clone().expect("why");
    assert_eq!(error.code, ErrorCode::NodeOffline);
    assert!(error.message.starts_with("the node restarted; "), "{error}");
    assert!(
        error
            .message
            .ends_with(" of 30 commands were done when last heard"),
        "{error}"
    );
    assert_eq!(rig.finish(&second, S), JobState::Succeeded);
    assert_eq!(rig.node("left").taken.len(), 30 + 2);
}

#[test]
fn a_lost_job_can_be_canceled_and_its_commands_are_dropped_when_the_node_returns() {
    let mut rig = Rig::with_left();
    let first = rig.accept("left", &moves("first", 100, 1_000));
    let second = rig.accept("left", &moves("second", 2, 100));
    rig.run(S);
    rig.link("left", false);
    assert_eq!(rig.cancel("first")[0]["state"], "canceled");
    rig.run(S);
    rig.restart_gateway();
    rig.link("left", true);
    assert_eq!(rig.finish(&second, S), JobState::Succeeded);
    assert_eq!(rig.state(&first), JobState::Canceled);
    let moved = rig.node("left").positions[0];
    assert!(
        (20_000..25_000).contains(&moved),
        "{moved}: the rest was dropped"
    );
}

#[test]
fn a_node_that_says_nothing_for_five_seconds_is_offline() {
    let mut rig = Rig::with_left();
    let job = rig.accept("left", &moves("a", 300, 1_000));
    rig.run(S);
    rig.node("left").link_up = false;
    rig.run(4 * S);
    assert!(rig.view("left").alive);
    rig.run(1_200 * MS);
    assert!(!rig.view("left").alive);
    assert_eq!(rig.state(&job), JobState::Lost);
    let (_, told) = rig.node_records.last().expect("a record");
    assert_eq!(told.state, NodeWord::Offline);
}

#[test]
fn a_command_that_the_node_itself_refuses_ends_the_job_with_its_place() {
    let mut rig = Rig::with_left();
    rig.node("left").refuses_steps = Some(77);
    let mut job = moves("a", 5_000, 10);
    job["commands"][3_000]["move"]["steps"] = json!(77);
    let job = rig.accept("left", &job);
    let next = rig.accept("left", &moves("next", 1, 10));
    assert_eq!(rig.finish(&job, 10 * S), JobState::Failed);
    let error = rig.record(&job).error.clone().expect("why");
    assert_eq!(error.code, ErrorCode::BadCommand);
    assert!(error.message.starts_with("commands[3000]"), "{error}");
    assert_eq!(rig.finish(&next, S), JobState::Succeeded);
}

#[test]
fn history_is_newest_first_filtered_and_limited() {
    let mut rig = Rig::with_left();
    rig.add("right");
    rig.run(10 * MS);
    for index in 0..120 {
        let node = if index % 3 == 0 { "right" } else { "left" };
        let name = format!("job-{index}");
        rig.accept(
            node,
            &json!({"id": name, "commands": [{"pause": {"ms": 1}}]}),
        );
        rig.run(5 * MS);
    }
    rig.run(S);
    rig.put("left", &json!({"id": "wrong", "commands": []}));
    let names = |replies: Vec<Value>| -> Vec<String> {
        let name = |reply: &Value| reply["job"].as_str().expect("a record").to_owned();
        replies.iter().map(name).collect()
    };
    let all = names(rig.jobs("*", &[]));
    assert_eq!(all.len(), 100);
    assert_eq!(all[..3], ["wrong", "job-119", "job-118"]);
    for limit in ["1000", "1001", "18446744073709551615"] {
        assert_eq!(names(rig.jobs("*", &[("limit", limit)])).len(), 121);
    }
    assert_eq!(
        names(rig.jobs("*", &[("limit", "2"), ("node", "right")])),
        ["job-117", "job-114"]
    );
    assert_eq!(names(rig.jobs("*", &[("state", "rejected")])), ["wrong"]);
    assert_eq!(
        names(rig.jobs("*", &[("state", "running")])),
        Vec::<String>::new()
    );
    assert_eq!(names(rig.jobs("job-11$*", &[])).len(), 11);
    assert_eq!(names(rig.jobs("job-7", &[])), ["job-7"]);
    let error = error_of(&rig.jobs("job-500", &[])[0]);
    assert_eq!(error.0, "bad_id");
    for (name, value) in [
        ("limit", "0"),
        ("limit", "many"),
        ("limit", ""),
        ("state", "done"),
        ("node", "No Node"),
        ("colour", "red"),
    ] {
        let replies = rig.jobs("*", &[(name, value)]);
        let (code, message) = error_of(&replies[0]);
        assert_eq!(
            (replies.len(), code.as_str()),
            (1, "bad_json"),
            "{name}={value}"
        );
        assert!(message.starts_with(name), "{message}");
    }
}

#[test]
fn node_records_answer_a_get_and_are_told_at_most_twenty_times_a_second() {
    let mut rig = Rig::with_left();
    rig.add("right");
    rig.run(10 * MS);
    assert_eq!(rig.node_states("*").len(), 2);
    assert_eq!(rig.node_states("left")[0]["node"], "left");
    assert_eq!(error_of(&rig.node_states("middle")[0]).0, "unknown_node");
    assert_eq!(rig.node_states("cell-$*"), Vec::<Value>::new());

    let before = rig.node_records.len();
    rig.run(10 * S);
    let at_rest = rig.node_records.len() - before;
    assert!(
        (18..=22).contains(&at_rest),
        "{at_rest}: two nodes, once a second"
    );

    // Many short jobs change the record much more often than it is told.
    let begun_us = rig.now_us;
    for index in 0..200 {
        rig.accept("left", &moves(&format!("j{index}"), 1, 10));
    }
    rig.finish(&id("j199"), 10 * S);
    let told: Vec<u64> = rig
        .node_records
        .iter()
        .filter(|(at, record)| *at >= begun_us && record.node.as_str() == "left")
        .map(|(at, _)| *at)
        .collect();
    assert!(told.windows(2).all(|pair| pair[1] - pair[0] >= 50 * MS));
    assert!(told.len() > 5);
    rig.run(S);
    let (_, last) = rig
        .node_records
        .iter()
        .rev()
        .find(|(_, r)| r.node.as_str() == "left")
        .expect("told");
    assert_eq!((last.job, last.position[0]), (None, 2_000));
    let clock = last.clock.expect("it is known");
    assert!(
        clock.error_us < 500.0 && clock.drift_ppm.abs() < 50.0,
        "{clock:?}"
    );
}

#[test]
fn no_list_grows_without_bound() {
    let config = FleetConfig {
        waiting_jobs_max: 3,
        held_commands_max: 100,
        retention_jobs: 4,
        nodes_max: 2,
        ..FleetConfig::default()
    };
    let mut rig = Rig::with(config, 1);
    for name in ["left", "right", "third"] {
        rig.add(name);
    }
    rig.run(10 * MS);
    assert_eq!(rig.refuse("third", &moves("a", 1, 1)).0, "unknown_node");
    assert_eq!(rig.refuse("right", &moves("a", 101, 1)).0, "too_large");
    for name in ["a", "b", "c", "d"] {
        rig.accept("left", &moves(name, 1, 1_000));
    }
    let (code, message) = rig.refuse("left", &moves("e", 1, 1));
    assert_eq!(code, "too_large");
    assert!(message.contains("3 jobs wait"), "{message}");
    rig.finish(&id("d"), S);
    assert_eq!(rig.jobs("*", &[]).len(), 4);
    let job = rig.accept("right", &moves("f", 100, 1));
    rig.finish(&job, S);
    let names: Vec<String> = rig.fleet.jobs().map(|job| job.id().to_string()).collect();
    assert_eq!(names, ["f", "d", "c", "b"], "the oldest has gone");
    assert_eq!(rig.rows.keys().filter(|(_, key)| key == "a").count(), 0);
    let final_requests = rig
        .rows
        .keys()
        .filter(|(table, _)| *table == gateway::fleet::event::Table::Requests);
    assert_eq!(final_requests.count(), 0);
}

#[test]
fn a_status_that_was_overtaken_by_a_newer_one_is_not_believed() {
    let mut rig = Rig::with_left();
    let node = NodeId::new("left").expect("legal");
    let hear = |rig: &mut Rig, status: &keys::Status| {
        let mut buffer = [0; 512];
        let payload = keys::version::encode(status, &mut buffer)
            .expect("fits")
            .to_vec();
        let topic = keys::NodeTopic::Status;
        rig.event(Event::FromNode {
            node,
            topic,
            payload,
        });
    };
    // The estimate of the clock grows more careful all the time.
    let view = |rig: &Rig| keys::record::NodeRecord {
        clock: None,
        ..rig.view("left")
    };
    rig.run(S);
    let now_us = rig.now_us;
    let idle = rig.node("left").status(now_us);
    let job = rig.accept("left", &moves("a", 30, 100));
    rig.run(105 * MS);
    let moving = view(&rig);
    assert_eq!(moving.state, NodeWord::Running);
    hear(&mut rig, &idle);
    assert_eq!(view(&rig), moving);
    rig.stop("left");
    rig.finish(&job, S);
    rig.run(100 * MS);
    let stopped = view(&rig);
    assert_eq!(stopped.state, NodeWord::Stopped);
    hear(&mut rig, &idle);
    assert_eq!(view(&rig), stopped);
    assert_eq!(rig.refuse("left", &moves("b", 1, 1)).0, "stopped");
    // Neither is one of the boot before, whatever its time.
    rig.reboot("left");
    rig.run(100 * MS);
    let fresh = view(&rig);
    hear(&mut rig, &idle);
    assert_eq!(view(&rig), fresh);
    assert_eq!(fresh.state, NodeWord::Idle);
}

#[test]
fn a_gateway_without_a_store_lets_a_node_finish_what_it_has_before_it_sends_more() {
    let mut rig = Rig::with_left();
    rig.accept("left", &moves("before", 40, 1_000));
    rig.run(S);
    rig.rows.clear();
    rig.records.clear();
    rig.restart_gateway();
    rig.run(S);
    assert_eq!(rig.view("left").job, Some(id("before")), "the node says so");
    let job = rig.accept("left", &moves("after", 3, 100));
    rig.run(200 * MS);
    assert_eq!(rig.state(&job), JobState::Queued);
    assert_eq!(rig.finish(&job, 5 * S), JobState::Succeeded);
    assert_eq!(
        rig.record(&job).result.as_ref().expect("ended").position,
        [40_300, 0]
    );
}

#[test]
fn every_node_is_probed_and_no_two_probes_leave_in_one_call() {
    let mut rig = Rig::new();
    for index in 0..20 {
        rig.add(&format!("n{index}"));
    }
    rig.run(10 * S);
    for index in 0..20 {
        let clock = rig.view(&format!("n{index}")).clock.expect("it is known");
        assert!(clock.error_us < 200.0, "{clock:?}");
    }
    let probes = rig
        .sent
        .iter()
        .filter(|(_, _, topic, _, _)| *topic == keys::NodeTopic::Clock);
    let mut calls: Vec<u64> = probes.map(|(call, ..)| *call).collect();
    assert!(
        calls.len() > 20 * 100,
        "{}: ten a second for each",
        calls.len()
    );
    let count = calls.len();
    calls.dedup();
    assert_eq!(calls.len(), count);
}

#[test]
fn a_job_whose_time_runs_out_while_its_node_is_away_is_stopped_when_it_returns() {
    for (away_us, expected) in [(3 * S, JobState::TimedOut), (20 * S, JobState::Succeeded)] {
        let mut rig = Rig::with_left();
        let mut job = moves("slow", 100, 1_000);
        job["timeout_s"] = json!(2);
        let slow = rig.accept("left", &job);
        let next = rig.accept("left", &moves("next", 1, 10));
        rig.run(S);
        rig.link("left", false);
        rig.run(away_us);
        assert_eq!(rig.state(&slow), JobState::Lost, "only the node knows");
        rig.link("left", true);
        // Whose last pulse has left before anybody could stop it, has succeeded.
        assert_eq!(rig.finish(&slow, S), expected);
        assert_eq!(rig.finish(&next, S), JobState::Succeeded);
    }
}

#[test]
fn a_node_that_stopped_twice_unheard_says_too_little_for_more_than_failed() {
    let mut rig = Rig::with_left();
    let job = rig.accept("left", &moves("a", 30, 1_000));
    rig.run(S);
    rig.link("left", false);
    let now_us = rig.now_us;
    let node = rig.node("left");
    for _ in 0..2 {
        node.stop(StopReason::Pin, StopMode::Halt, now_us);
        node.latched = None;
    }
    rig.link("left", true);
    assert_eq!(rig.finish(&job, S), JobState::Failed);
    let record = rig.record(&job);
    let error = record.error.clone().expect("why");
    assert_eq!(error.code, ErrorCode::Stopped);
    assert!(error.message.contains("more than once"), "{error}");
    assert_eq!(record.result, None, "where this job ended, nobody knows");
}

#[test]
fn a_node_that_has_less_room_than_it_told_gets_the_rest_later() {
    let mut rig = Rig::with_left();
    rig.node("left").ring_commands = 20;
    let job = rig.accept("left", &moves("a", 1_000, 10));
    assert_eq!(rig.finish(&job, 60 * S), JobState::Succeeded);
    assert_eq!(rig.node("left").taken.len(), 1_000);
}

#[test]
fn a_node_that_understands_no_order_fails_its_job_and_keeps_the_others_waiting() {
    let mut rig = Rig::with_left();
    rig.node("left").deaf = true;
    let job = rig.accept("left", &moves("a", 10, 10));
    let next = rig.accept("left", &moves("b", 10, 10));
    rig.run(60 * S);
    // It cannot be told to drop the queue either, so nothing else may go there.
    assert_eq!(rig.state(&job), JobState::Sent);
    assert_eq!(rig.state(&next), JobState::Queued);
    rig.reboot("left");
    assert_eq!(rig.finish(&job, S), JobState::Failed);
    let error = rig.record(&job).error.clone().expect("why");
    assert_eq!(error.code, ErrorCode::Internal, "{error}");
}

#[test]
fn an_answer_that_is_quicker_than_the_status_does_not_end_a_job_at_a_place_on_its_way() {
    let mut rig = Rig::with_left();
    let job = rig.accept("left", &moves("a", 10, 1_000));
    rig.run(450 * MS);
    let node = rig.node("left").id;
    let now_us = rig.now_us;
    let half_way = rig.node("left").status(now_us);
    let ack = keys::BatchAck {
        queue: half_way.queue,
        verdict: keys::Verdict::Credit,
        accepted_commands: 10,
        executed_commands: 10,
        credit_commands: 4096,
    };
    let mut buffer = [0; 512];
    for (topic, payload) in [
        (
            keys::NodeTopic::Ack,
            keys::version::encode(&ack, &mut buffer)
                .expect("fits")
                .to_vec(),
        ),
        (
            keys::NodeTopic::Status,
            keys::version::encode(&half_way, &mut buffer)
                .expect("fits")
                .to_vec(),
        ),
    ] {
        rig.event(Event::FromNode {
            node,
            topic,
            payload,
        });
    }
    assert_eq!(rig.state(&job), JobState::Running);
    assert_eq!(rig.finish(&job, 5 * S), JobState::Succeeded);
    let result = rig.record(&job).result.clone().expect("it has ended");
    assert_eq!(result.position, [10_000, 0]);
}

#[test]
fn noise_is_ignored() {
    let mut rig = Rig::with_left();
    let node = NodeId::new("left").expect("legal");
    let before = rig.fleet.ignored_count();
    for topic in keys::NodeTopic::ALL {
        for payload in [&b""[..], b"\x01", b"\xff\xff\xff", &[0; 600]] {
            rig.event(Event::FromNode {
                node,
                topic,
                payload: payload.to_vec(),
            });
        }
    }
    assert!(rig.fleet.ignored_count() > before);
    let job = rig.accept("left", &moves("a", 1, 10));
    assert_eq!(rig.finish(&job, S), JobState::Succeeded);
}
