//! Labels, maintenance, priorities and times of jobs, against a fleet in a bottle.

mod rig;

use gateway::{
    fleet::{
        event::Event,
        kept::Kind,
        manage::{JobWishes, LABELS_MAX, NodeWishes, OrderWishes},
    },
    job::parse,
};
use keys::{Features, JobId, record::JobState};
use rig::{MS, Rig, S, error_of, moves};
use serde_json::{Value, json};

fn manage(rig: &mut Rig, nodes: &str, wishes: &Value) -> Vec<Value> {
    let reply = rig.ask();
    let request = match wishes {
        Value::Null => NodeWishes::from_json(b""),
        wishes => NodeWishes::from_json(wishes.to_string().as_bytes()),
    };
    rig.event(Event::ManageNodes {
        pattern: nodes.to_owned(),
        request,
        reply,
    });
    rig.answers(reply)
}

fn order(rig: &mut Rig, job: &str, wishes: &Value) -> Value {
    let reply = rig.ask();
    rig.event(Event::ManageJob {
        job: job.to_owned(),
        request: OrderWishes::from_json(wishes.to_string().as_bytes()),
        reply,
    });
    rig.answers(reply).remove(0)
}

fn submit_with(rig: &mut Rig, node: &str, job: &Value, wishes: &Value) -> Vec<Value> {
    let reply = rig.ask();
    let parsed = parse::parse("application/json", job.to_string().as_bytes());
    rig.event(Event::SubmitWith {
        wishes: JobWishes::from_json(wishes.to_string().as_bytes()).expect("legal"),
        submit: Box::new(Event::Submit {
            pattern: node.to_owned(),
            request: parsed.request,
            id_hint: parsed.id_hint,
            reply: Some(reply),
        }),
    });
    rig.answers(reply)
}

/// Two nodes that can start together.
fn two() -> Rig {
    let mut rig = Rig::with_left();
    rig.add("right");
    for name in ["left", "right"] {
        rig.node(name).features = Features::BASIC.with(Features::BARRIERS);
    }
    // Both have told it.
    rig.run(2 * S);
    rig
}

fn waiting(rig: &Rig, node: &str) -> Vec<String> {
    let id = keys::NodeId::new(node).expect("legal");
    let node = rig.fleet.node(&id).expect("known");
    node.waiting().map(|job| job.to_string()).collect()
}

fn job(rig: &Rig, name: &str) -> JobState {
    rig.state(&JobId::new(name).expect("legal"))
}

#[test]
fn a_label_means_its_nodes_and_outlives_the_gateway() {
    let mut rig = Rig::with_left();
    rig.add("right");
    rig.add("third");
    rig.run(10 * MS);
    for node in ["left", "third"] {
        let answers = manage(&mut rig, node, &json!({"label": ["mill", "big"]}));
        assert_eq!(answers[0]["labels"], json!(["big", "mill"]));
    }
    manage(&mut rig, "third", &json!({"unlabel": ["big"]}));
    rig.restart_gateway();
    rig.run(S);
    let receipts = rig.get("@mill", &moves("both", 2, 100));
    let names: Vec<&Value> = receipts.iter().map(|receipt| &receipt["job"]).collect();
    assert_eq!(names, ["both-left", "both-third"]);
    let receipts = rig.get("@big", &moves("one", 2, 100));
    assert_eq!(receipts[0]["job"], "one-left", "as on a wild key");
    let (code, message) = rig.refuse("@nothing", &moves("none", 2, 100));
    assert_eq!(
        (code.as_str(), message.as_str()),
        ("unknown_node", "no node has the label `nothing`")
    );
    rig.run(5 * S);
    assert_eq!(job(&rig, "both-third"), JobState::Succeeded);
}

#[test]
fn a_node_in_maintenance_takes_nothing_and_says_why() {
    let mut rig = Rig::with_left();
    let running = rig.accept("left", &moves("running", 10, 1_000));
    let next = rig.accept("left", &moves("next", 2, 100));
    let answers = manage(
        &mut rig,
        "left",
        &json!({"maintenance": {"reason": "new belt"}}),
    );
    assert_eq!(answers[0]["maintenance"], "new belt");
    let refused = rig.refuse("left", &moves("more", 2, 100));
    assert_eq!(refused.0, "not_allowed");
    assert_eq!(refused.1, "node left is in maintenance: new belt");
    // The one that runs ends, the one that waits goes on waiting, also over a restart.
    assert_eq!(rig.finish(&running, 20 * S), JobState::Succeeded);
    rig.restart_gateway();
    rig.run(5 * S);
    assert_eq!(rig.state(&next), JobState::Queued);
    let answers = manage(&mut rig, "left", &Value::Null);
    assert_eq!(
        answers[0],
        json!({
            "node": "left", "labels": [], "maintenance": "new belt", "waiting": ["next"]
        })
    );
    manage(&mut rig, "left", &json!({"maintenance": false}));
    assert_eq!(rig.finish(&next, 5 * S), JobState::Succeeded);
}

#[test]
fn a_synchronized_job_with_a_node_in_maintenance_is_refused_whole() {
    let mut rig = two();
    manage(
        &mut rig,
        "right",
        &json!({"maintenance": {"reason": "belt"}}),
    );
    let part = json!({"commands": [{"move": {"axis": 0, "delay_us": 100, "steps": 5}}]});
    let (code, message) =
        rig.refuse_group(&json!({"id": "g", "nodes": {"left": part, "right": part}}));
    assert_eq!(code, "not_allowed");
    assert!(
        message.contains("node right is in maintenance: belt"),
        "{message}"
    );
    assert!(!message.contains("left"), "{message}");
}

#[test]
fn the_important_goes_first_and_what_is_for_idle_times_last() {
    let mut rig = Rig::with_left();
    rig.accept("left", &moves("now", 10, 1_000));
    submit_with(
        &mut rig,
        "left",
        &moves("idle", 1, 10),
        &json!({"when_idle": true}),
    );
    rig.accept("left", &moves("first", 1, 10));
    submit_with(
        &mut rig,
        "left",
        &moves("low", 1, 10),
        &json!({"priority": -5}),
    );
    rig.accept("left", &moves("second", 1, 10));
    submit_with(
        &mut rig,
        "left",
        &moves("high", 1, 10),
        &json!({"priority": 7}),
    );
    let expected = ["high", "first", "second", "low", "idle"];
    assert_eq!(waiting(&rig, "left"), expected);
    rig.restart_gateway();
    rig.run(MS);
    assert_eq!(waiting(&rig, "left"), expected, "it is kept");
    rig.run(20 * S);
    let mut order: Vec<String> = Vec::new();
    for (_, _, job, _) in &rig.node("left").taken {
        if order.last().is_none_or(|last| *last != job.to_string()) {
            order.push(job.to_string());
        }
    }
    assert_eq!(order[1..], expected);
}

#[test]
fn jobs_that_wait_are_moved_and_the_others_are_not() {
    let mut rig = Rig::with_left();
    rig.accept("left", &moves("now", 10, 1_000));
    for name in ["a", "b", "c", "d"] {
        rig.accept("left", &moves(name, 1, 10));
    }
    let answer = order(&mut rig, "d", &json!({"before": "b"}));
    assert_eq!(answer["waiting"], json!(["a", "d", "b", "c"]));
    order(&mut rig, "c", &json!({"before": "a"}));
    assert_eq!(waiting(&rig, "left"), ["c", "a", "d", "b"]);
    order(&mut rig, "b", &json!({"priority": 1}));
    assert_eq!(waiting(&rig, "left"), ["b", "c", "a", "d"]);
    // Before one of another priority is with that priority.
    order(&mut rig, "d", &json!({"before": "b"}));
    assert_eq!(waiting(&rig, "left"), ["d", "b", "c", "a"]);
    rig.restart_gateway();
    rig.run(MS);
    assert_eq!(waiting(&rig, "left"), ["d", "b", "c", "a"]);
    let (code, message) = error_of(&order(&mut rig, "now", &json!({"priority": 1})));
    assert_eq!(code, "not_allowed");
    assert!(message.contains("does not wait any more"), "{message}");
    let (_, message) = error_of(&order(&mut rig, "a", &json!({"before": "now"})));
    assert!(message.contains("job now does not wait"), "{message}");
    assert_eq!(error_of(&order(&mut rig, "none", &json!({}))).0, "bad_id");
}

#[test]
fn moving_into_the_same_gap_again_and_again_is_refused_in_the_end_and_breaks_nothing() {
    let mut rig = Rig::with_left();
    rig.accept("left", &moves("now", 10, 1_000));
    for name in ["a", "b", "c"] {
        rig.accept("left", &moves(name, 1, 10));
    }
    let mut refused = 0;
    for turn in 0..60 {
        let (who, before) = if turn % 2 == 0 {
            ("c", "b")
        } else {
            ("b", "c")
        };
        let answer = order(&mut rig, who, &json!({"before": before}));
        if answer.get("error").is_some() {
            refused += 1;
        } else {
            assert_eq!(answer["waiting"], json!(["a", who, before]));
        }
    }
    assert!(refused > 0, "the gap is not endless");
}

#[test]
fn a_synchronized_job_keeps_its_place_and_others_pass_it() {
    let mut rig = two();
    rig.accept("left", &moves("now", 10, 1_000));
    let part = json!({"commands": [{"move": {"axis": 0, "delay_us": 100, "steps": 5}}]});
    let group = rig.accept_group(&json!({"id": "g", "nodes": {"left": part, "right": part}}));
    rig.accept("left", &moves("late", 1, 10));
    let (code, _) = error_of(&order(&mut rig, "g", &json!({"priority": 3})));
    assert_eq!(code, "not_allowed");
    order(&mut rig, "late", &json!({"before": "g"}));
    assert_eq!(waiting(&rig, "left"), ["late", "g"]);
    assert_eq!(rig.finish(&group, 30 * S), JobState::Succeeded);
    assert_eq!(job(&rig, "late"), JobState::Succeeded);
}

#[test]
fn a_job_for_later_waits_for_its_time_and_holds_up_nobody() {
    let mut rig = Rig::with_left();
    let at = rig.now().plus_us(60 * S);
    let wishes = json!({"not_before": at.to_string()});
    submit_with(&mut rig, "left", &moves("late", 1, 10), &wishes);
    let soon = rig.accept("left", &moves("soon", 1, 10));
    assert_eq!(rig.finish(&soon, 5 * S), JobState::Succeeded);
    rig.restart_gateway();
    rig.run(50 * S);
    assert_eq!(job(&rig, "late"), JobState::Queued);
    rig.run(11 * S);
    assert_eq!(job(&rig, "late"), JobState::Succeeded);
    let record = rig.record(&JobId::new("late").expect("legal"));
    assert!(record.updated >= at);
    // A stop takes it like any other that waits.
    let at = rig.now().plus_us(60 * S);
    let wishes = json!({"not_before": at.to_string()});
    submit_with(&mut rig, "left", &moves("never", 1, 10), &wishes);
    rig.stop("left");
    assert_eq!(job(&rig, "never"), JobState::Failed);
}

#[test]
fn a_job_tells_its_way_also_after_the_gateway_was_away() {
    let mut rig = Rig::with_left();
    let job = rig.accept("left", &moves("part", 10, 1_000));
    rig.run(100 * MS);
    rig.restart_gateway();
    assert_eq!(rig.finish(&job, 20 * S), JobState::Succeeded);
    let story = order(&mut rig, "part", &json!({}));
    assert_eq!(story["state"], "succeeded");
    assert_eq!(story["node"], "left");
    let steps = story["steps"].as_array().expect("a list");
    let states: Vec<&Value> = steps.iter().map(|step| &step[1]).collect();
    assert_eq!(states, ["queued", "sent", "running", "succeeded"]);
    let times: Vec<&str> = steps.iter().filter_map(|step| step[0].as_str()).collect();
    assert!(times.is_sorted() && times.len() == 4, "{times:?}");
}

#[test]
fn a_job_whose_node_comes_and_goes_all_day_makes_no_endless_story() {
    let mut rig = Rig::with_left();
    let job = rig.accept("left", &moves("long", 4_000, 1_000));
    for _ in 0..40 {
        rig.link("left", false);
        rig.run(7 * S);
        rig.link("left", true);
        rig.run(2 * S);
    }
    rig.cancel("long");
    rig.run(20 * S);
    assert!(rig.state(&job).is_final());
    let story = order(&mut rig, "long", &json!({}));
    let steps = story["steps"].as_array().expect("a list");
    assert!(steps.len() <= gateway::job::STEPS_MAX);
    assert_eq!(steps.last().map(|step| &step[1]), Some(&story["state"]));
}

#[test]
fn wishes_that_cannot_be_meant_are_refused() {
    for bad in [
        json!({"priority": 101}),
        json!({"priority": 1, "when_idle": true}),
        json!({"prio": 1}),
        json!({"not_before": "tomorrow"}),
        json!([]),
    ] {
        assert!(
            JobWishes::from_json(bad.to_string().as_bytes()).is_err(),
            "{bad}"
        );
    }
    for bad in [
        json!({"label": ["Mill"]}),
        json!({"maintenance": true}),
        json!({"maintenance": {"reason": ""}}),
        json!({"maintenance": {"reason": "x".repeat(201)}}),
        json!({"labels": []}),
    ] {
        assert!(
            NodeWishes::from_json(bad.to_string().as_bytes()).is_err(),
            "{bad}"
        );
    }
    assert!(OrderWishes::from_json(b"{\"priority\":1,\"before\":\"a\"}").is_err());
    let mut rig = Rig::with_left();
    let labels: Vec<String> = (0..=LABELS_MAX).map(|index| format!("l{index}")).collect();
    let answers = manage(&mut rig, "left", &json!({"label": labels}));
    assert!(error_of(&answers[0]).1.contains("more than 32 labels"));
    let answers = manage(&mut rig, "nobody", &Value::Null);
    assert_eq!(error_of(&answers[0]).0, "unknown_node");
    assert_eq!(manage(&mut rig, "*", &Value::Null).len(), 1);
}

fn keep(rig: &mut Rig, kind: Kind, name: &str, wish: &Value) -> Vec<Value> {
    let reply = rig.ask();
    let payload = match wish {
        Value::Null => Vec::new(),
        wish => wish.to_string().into_bytes(),
    };
    rig.event(Event::Keep {
        kind,
        pattern: name.to_owned(),
        payload,
        reply,
    });
    rig.answers(reply)
}

fn short() -> Value {
    json!({"commands": [{"move": {"axis": 0, "delay_us": 100, "steps": 5}}]})
}

#[test]
fn a_held_queue_takes_jobs_and_begins_none_also_over_a_restart() {
    let mut rig = Rig::with_left();
    let running = rig.accept("left", &moves("running", 10, 1_000));
    let next = rig.accept("left", &moves("next", 2, 100));
    let answers = manage(&mut rig, "left", &json!({"hold_queue": true}));
    assert_eq!(answers[0]["queue_held"], true);
    let more = rig.accept("left", &moves("more", 2, 100));
    assert_eq!(
        rig.finish(&running, 20 * S),
        JobState::Succeeded,
        "what runs ends"
    );
    rig.restart_gateway();
    rig.run(5 * S);
    assert_eq!(rig.state(&next), JobState::Queued);
    let answers = manage(&mut rig, "left", &json!({"hold_queue": false}));
    assert!(answers[0].get("queue_held").is_none(), "{answers:?}");
    assert_eq!(rig.finish(&next, 5 * S), JobState::Succeeded);
    assert_eq!(rig.finish(&more, 5 * S), JobState::Succeeded);
}

#[test]
fn templates_are_kept_shown_and_removed_and_outlive_the_gateway() {
    let mut rig = Rig::with_left();
    let drill = json!({"text": "G1 Z-${depth}", "format": "gcode", "about": "a hole"});
    let answers = keep(&mut rig, Kind::Template, "drill", &drill);
    assert_eq!(answers[0]["name"], "drill");
    keep(
        &mut rig,
        Kind::Template,
        "clean",
        &json!({"text": "wait_idle()", "format": "lua"}),
    );
    rig.restart_gateway();
    let all = keep(&mut rig, Kind::Template, "*", &Value::Null);
    let names: Vec<&Value> = all.iter().map(|template| &template["name"]).collect();
    assert_eq!(names, ["clean", "drill"]);
    assert_eq!(all[1]["text"], "G1 Z-${depth}");
    keep(&mut rig, Kind::Template, "drill", &json!({"remove": true}));
    for (name, wish) in [("drill", Value::Null), ("drill", json!({"remove": true}))] {
        let answers = keep(&mut rig, Kind::Template, name, &wish);
        assert_eq!(error_of(&answers[0]).1, "no template `drill`");
    }
    let answers = keep(
        &mut rig,
        Kind::Template,
        "x",
        &json!({"text": "", "format": "basic"}),
    );
    assert_eq!(error_of(&answers[0]).1, "format: json, lua or gcode");
    let answers = keep(&mut rig, Kind::Template, "No!", &drill);
    assert_eq!(error_of(&answers[0]).0, "bad_id");
}

#[test]
fn a_schedule_hands_in_its_job_at_its_times_and_leaves_out_what_nobody_was_there_for() {
    let mut rig = Rig::with_left();
    let wish = json!({"target": "left", "job": short(), "every_s": 60});
    let answers = keep(&mut rig, Kind::Schedule, "warm", &wish);
    assert_eq!(answers[0]["done"], 0, "{answers:?}");
    let count = |rig: &Rig| {
        rig.fleet
            .jobs()
            .filter(|job| job.id().as_str().starts_with("warm-"))
            .count()
    };
    rig.run(59 * S);
    assert_eq!(count(&rig), 0);
    rig.run(122 * S);
    assert_eq!(count(&rig), 3);
    assert!(
        rig.fleet
            .jobs()
            .all(|job| job.state() == JobState::Succeeded)
    );
    // It is dead for five of its times.
    rig.dead = true;
    rig.run(300 * S);
    rig.restart_gateway();
    assert_eq!(count(&rig), 3, "nothing is made up for");
    rig.run(62 * S);
    assert_eq!(count(&rig), 4);
    let shown = keep(&mut rig, Kind::Schedule, "warm", &Value::Null);
    assert_eq!(
        (&shown[0]["done"], &shown[0]["missed"]),
        (&json!(4), &json!(5)),
        "{shown:?}"
    );
    keep(&mut rig, Kind::Schedule, "warm", &json!({"remove": true}));
    rig.run(300 * S);
    assert_eq!(count(&rig), 4);
}
