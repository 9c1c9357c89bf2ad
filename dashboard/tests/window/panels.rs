//! Every panel, clicked by its accessible names, with a model fed from messages.

use crate::fixture::{at_ms, fleet, job, node, tell};
use crate::screen::{button, click, picture_of, show, shows};
use dashboard::{
    app::Dashboard,
    message::{Answer, LinkEvent, Message},
    request::{Language, Request, Scope, Target},
    view::Tab,
};
use egui::{Key, Modifiers, Role};
use egui_kittest::{Harness, kittest::Queryable as _};
use keys::{
    StopMode,
    record::{ErrorCode, JobError, JobState, Receipt},
};
use std::collections::BTreeSet;

/// Returns what was asked since the last call, without the tickets.
fn asked(harness: &mut crate::screen::Window) -> Vec<Request> {
    let asked = crate::screen::asked(harness).into_iter();
    asked.map(|(_, request)| request).collect()
}

#[test]
fn every_column_says_what_it_knows_of_a_node() {
    let mut harness = show(fleet());
    harness.state_mut().view.fleet.filter = "cell-a-1".to_owned();
    harness.run_steps(2);
    for words in [
        "▶ running",
        "engrave-7 12/40",
        "28/4096",
        "2\u{a0}000 · -1\u{a0}000",
        "2\u{a0}000 · -1\u{a0}000",
        "+12 µs ± 41 µs",
        "-61 dBm",
        "0.0 s",
    ] {
        assert!(shows(&harness, words), "{words}");
    }
    harness.state_mut().view.fleet.filter = "cell-b-2".to_owned();
    harness.run_steps(2);
    assert!(shows(&harness, "✖ 204 planner too late"));
    harness.state_mut().view.fleet.filter = "spare".to_owned();
    harness.run_steps(2);
    assert!(shows(&harness, "unknown"), "no clock");
    assert!(shows(&harness, "–"), "no RSSI");
}

#[test]
fn several_nodes_are_selected_without_a_mouse() {
    let mut harness = show(fleet());
    click(&mut harness, Role::CheckBox, "Select cell-a-1");
    click(&mut harness, Role::CheckBox, "Select spare");
    let both = BTreeSet::from([node("cell-a-1"), node("spare")]);
    assert_eq!(harness.state().view.selection, both);
    assert_eq!(harness.state().view.focus, None, "no page opens");
    let tick = harness.get_by_role_and_label(Role::CheckBox, "Select spare");
    tick.focus();
    harness.run_steps(2);
    harness.key_press(Key::Space);
    harness.run_steps(2);
    let one = BTreeSet::from([node("cell-a-1")]);
    assert_eq!(harness.state().view.selection, one);
}

#[test]
fn every_panel_has_a_key() {
    let mut harness = show(fleet());
    for (key, tab) in [
        (Key::N, Tab::Compose),
        (Key::G, Tab::GroupJob),
        (Key::M, Tab::Alarms),
        (Key::T, Tab::Timeline),
        (Key::L, Tab::Log),
        (Key::P, Tab::Pulses),
        (Key::R, Tab::Recording),
        (Key::J, Tab::Jobs),
    ] {
        harness.key_press_modifiers(Modifiers::COMMAND, key);
        harness.run_steps(2);
        assert_eq!(harness.state().view.tab, tab);
    }
}

#[test]
fn what_is_looked_at_is_remembered_and_what_is_asked_about_is_not() {
    let mut dashboard = fleet();
    let view = &mut dashboard.view;
    view.tab = Tab::GroupJob;
    view.focus = Some(node("spare"));
    view.fleet.filter = "cell".to_owned();
    view.fleet.sort = dashboard::panels::fleet::Column::Clock;
    view.composer.target = "cell-a-$*".to_owned();
    view.alarms.sound = true;
    view.node.speed_percent = 70;
    view.stop.releasing = Some(Scope::All);
    view.selection.insert(node("spare"));
    let kept = serde_json::to_string(view).expect("text");
    let mut back: dashboard::view::View = serde_json::from_str(&kept).expect("a view");
    assert_eq!((back.tab, back.focus), (Tab::GroupJob, Some(node("spare"))));
    assert_eq!(back.fleet.filter, "cell");
    assert_eq!(back.fleet.sort, dashboard::panels::fleet::Column::Clock);
    assert_eq!(back.composer.target, "cell-a-$*");
    assert!(back.alarms.sound && back.node.speed_percent == 70);
    assert_eq!(back.fleet.saved, ["cell-a-$*", "cell-b-$*"]);
    // What stops or releases is chosen anew each time.
    assert_eq!(back.stop.releasing, None);
    assert!(back.selection.is_empty());
    // Settings of an older program lack what is new.
    back = serde_json::from_str("{\"tab\":\"Log\"}").expect("a view");
    assert_eq!((back.tab, back.node.speed_percent), (Tab::Log, 100));
}

#[test]
fn the_top_bar_counts_faults_and_marks_a_recording() {
    let folder = tempfile::tempdir().expect("a folder");
    let mut harness = show(fleet());
    assert!(shows(&harness, "✖ 1 fault"));
    assert!(!shows(&harness, "⏺ recording"));
    let dashboard = harness.state_mut();
    dashboard.session.part_bytes_max = 200_000;
    let file = folder.path().join("day.jsonl").display().to_string();
    dashboard.session.record(&file, &dashboard.model);
    std::fs::write(folder.path().join("day-2.jsonl"), "mine").expect("written");
    harness.run_steps(2);
    button(&mut harness, "⏺ recording");
    assert_eq!(harness.state().view.tab, Tab::Recording);
    // The next file cannot be made.
    for number in 0..100 {
        let (node, text) = (node("spare"), "x".repeat(5_000) + &number.to_string());
        let at = at_ms(1_000 + 10 * number);
        harness.state_mut().hear(at, Message::Log { node, text });
    }
    harness.run_steps(2);
    harness.state_mut().view.tab = Tab::Jobs;
    harness.run_steps(2);
    assert!(shows(&harness, "✖ NOT RECORDED"));
}

#[test]
fn typing_asks_for_nothing() {
    let mut harness = show(fleet());
    harness
        .get_by_role_and_label(Role::TextInput, "Filter nodes")
        .focus();
    harness.run_steps(2);
    for text in ["?", "/", " ", "s", "stop", "\u{7f}"] {
        harness.event(egui::Event::Text(text.to_owned()));
        harness.run_steps(1);
    }
    for key in [Key::Space, Key::Enter, Key::S, Key::Escape] {
        harness.key_press(key);
        harness.run_steps(1);
    }
    assert_eq!(asked(&mut harness), []);
    assert!(!harness.state().view.help_open);
    assert!(harness.state().view.fleet.filter.contains("?/ sstop"));
}

#[test]
fn a_node_has_its_page_and_its_stop() {
    let mut harness = show(fleet());
    button(&mut harness, "cell-a-1");
    assert_eq!(harness.state().view.focus, Some(node("cell-a-1")));
    assert!(shows(&harness, "28 waiting, room for 4068"));
    button(&mut harness, "Stop node");
    let (scope, mode) = (Scope::node(node("cell-a-1")), StopMode::Halt);
    assert_eq!(asked(&mut harness), [Request::Stop { scope, mode }]);
    button(&mut harness, "Close page");
    assert_eq!(harness.state().view.focus, None);
}

#[test]
fn the_fleet_is_filtered_by_words_and_by_key_expressions() {
    let mut harness = show(fleet());
    assert!(shows(&harness, "7 of 7 nodes"));
    let filter = |harness: &mut Harness<'_, Dashboard>, text: &str| {
        harness.state_mut().view.fleet.filter = text.to_owned();
        harness.run_steps(2);
    };
    filter(&mut harness, "engrave");
    assert!(shows(&harness, "1 of 7 nodes"));
    filter(&mut harness, "cell-b-$*");
    assert!(shows(&harness, "3 of 7 nodes"));
    filter(&mut harness, "lost");
    assert!(shows(&harness, "1 of 7 nodes"));
    filter(&mut harness, "nothing like it");
    assert!(shows(&harness, "no node passes the filter"));
}

#[test]
fn nodes_that_need_somebody_come_first_and_columns_sort() {
    let mut harness = show(fleet());
    let order = |harness: &Harness<'_, Dashboard>| -> Vec<String> {
        let state = harness.state();
        let rows = dashboard::panels::fleet::shown(&state.model, &state.view);
        rows.iter().map(|row| row.id().to_string()).collect()
    };
    assert_eq!(order(&harness)[..3], ["cell-b-2", "cell-b-3", "cell-b-1"]);
    click(&mut harness, Role::CheckBox, "Alarms first");
    assert_eq!(order(&harness)[0], "cell-a-1");
    button(&mut harness, "Sort by Node");
    assert_eq!(order(&harness)[0], "spare");
    button(&mut harness, "Sort by Speed (steps/s)");
    button(&mut harness, "Sort by Speed (steps/s)");
    assert_eq!(order(&harness)[0], "cell-a-1");
}

#[test]
fn a_group_is_saved_and_forgotten() {
    let mut harness = show(fleet());
    harness.state_mut().view.fleet.new_group = "cell-*".to_owned();
    harness.run_steps(2);
    assert!(shows(&harness, "inside a name write $*"));
    harness.state_mut().view.fleet.new_group = "spare".to_owned();
    harness.run_steps(2);
    button(&mut harness, "Save group");
    button(&mut harness, "spare (1/1)");
    assert!(shows(&harness, "1 of 7 nodes"));
    button(&mut harness, "Forget spare");
    assert!(shows(&harness, "7 of 7 nodes"));
}

#[test]
fn a_job_is_checked_sent_and_followed() {
    let mut harness = show(fleet());
    harness.key_press_modifiers(Modifiers::COMMAND, Key::N);
    harness.run_steps(2);
    let state = harness.state_mut();
    state.view.composer.target = "cell-a-$*".to_owned();
    state.view.composer.text =
        r#"{"commands":[{"move":{"axis":0,"delay_us":0,"steps":1}}]}"#.into();
    harness.run_steps(2);
    assert!(shows(
        &harness,
        "reaches 3 nodes: cell-a-1, cell-a-2, cell-a-3"
    ));
    assert!(shows(&harness, "commands[0].move.delay_us"));
    button(&mut harness, "Send job");
    assert_eq!(asked(&mut harness), [], "what is wrong is not sent");
    let text = r#"{"id":"x","commands":[{"move":{"axis":0,"delay_us":5,"steps":1}}]}"#;
    harness.state_mut().view.composer.text = text.to_owned();
    harness.run_steps(2);
    assert!(shows(&harness, "✔ 1 command"));
    button(&mut harness, "Send job");
    let now = at_ms(1_000);
    let asked = harness.state_mut().take_requests(now);
    let expected = Request::Submit {
        target: Target::Node("cell-a-$*".to_owned()),
        language: Language::Json,
        text: text.to_owned(),
    };
    assert_eq!(asked[0].1, expected);
    harness.run_steps(2);
    assert!(shows(&harness, "no receipt yet"));
    let receipt = Receipt {
        job: job("x"),
        state: JobState::Queued,
    };
    let refusal = JobError::new(ErrorCode::Stopped, "cell-a-3 is stopped");
    let answer = Answer::Receipts(vec![Ok(receipt), Err(refusal)]);
    let ticket = asked[0].0;
    tell(harness.state_mut(), now, Message::Answer { ticket, answer });
    harness.run_steps(2);
    assert!(shows(&harness, "refused: stopped: cell-a-3 is stopped"));
    let done = crate::fixture::job_record("x", "cell-a-1", JobState::Succeeded, 1, 1);
    tell(harness.state_mut(), now, Message::Job(Box::new(done)));
    harness.run_steps(2);
    button(&mut harness, "✔ x: succeeded");
    assert_eq!(harness.state().view.tab, Tab::Jobs);
    button(&mut harness, "Run again…");
    assert_eq!(harness.state().view.tab, Tab::Compose);
    let composer = &harness.state().view.composer;
    assert!(!composer.text.contains("id"), "a new job");
    assert_eq!(composer.target, "cell-a-1", "for the node that had it");
}

#[test]
fn a_job_is_canceled_in_two_steps() {
    let mut harness = show(fleet());
    button(&mut harness, "engrave-7");
    button(&mut harness, "Cancel job…");
    assert_eq!(asked(&mut harness), []);
    button(&mut harness, "Really cancel");
    let job = job("engrave-7");
    assert_eq!(asked(&mut harness), [Request::Cancel { job }]);
    assert!(shows(&harness, "⌛ cancel asked for"));
}

#[test]
fn what_became_of_a_cancel_stands_at_its_job() {
    let job = job("engrave-7");
    let refused = vec![JobError::new(ErrorCode::NotAllowed, "not yours")];
    for (answer, words) in [
        (
            Answer::Failed("no gateway answers".to_owned()),
            "✖ NOT CANCELED: no gateway answers",
        ),
        (
            Answer::Done { count: 0, refused },
            "✖ NOT CANCELED: not_allowed: not yours",
        ),
        (
            Answer::Done {
                count: 1,
                refused: Vec::new(),
            },
            "⏹ cancel taken: it ends when its nodes are at rest",
        ),
    ] {
        let mut harness = show(fleet());
        let now = at_ms(1_000);
        let state = harness.state_mut();
        let ticket = state.requests.push(Request::Cancel { job });
        state.take_requests(now);
        tell(state, now, Message::Answer { ticket, answer });
        harness.run_steps(2);
        assert!(shows(&harness, words), "in the list: {words}");
        button(&mut harness, "engrave-7");
        let count = harness.query_all_by_label_contains(words).count();
        assert_eq!(count, 2, "and in the detail: {words}");
    }
}

#[test]
fn a_jobs_id_and_the_log_are_copied() {
    let copied = |harness: &Harness<'_, Dashboard>| {
        let mut commands = harness.output().platform_output.commands.iter();
        commands.find_map(|command| match command {
            egui::OutputCommand::CopyText(text) => Some(text.clone()),
            _ => None,
        })
    };
    let mut harness = show(fleet());
    button(&mut harness, "engrave-7");
    harness
        .get_by_role_and_label(Role::Button, "Copy id")
        .click();
    harness.run_steps(1);
    assert_eq!(copied(&harness).as_deref(), Some("engrave-7"));
    harness.state_mut().view.tab = Tab::Log;
    harness.state_mut().view.log.filter = "layer".to_owned();
    harness.run_steps(2);
    harness
        .get_by_role_and_label(Role::Button, "Copy log")
        .click();
    harness.run_steps(1);
    let expected = "2026-11-21 03:00:01.000 cell-a-1 layer 3 of 12\n";
    assert_eq!(copied(&harness).as_deref(), Some(expected));
}

#[test]
fn a_synchronized_job_shows_parts_and_skew() {
    let mut harness = show(fleet());
    button(&mut harness, "cut-7");
    assert!(shows(&harness, "+38.2 µs"));
    assert!(shows(&harness, "started 38 µs apart ± 55 µs"));
}

#[test]
fn ten_thousand_lines_are_filtered() {
    let mut dashboard = fleet();
    for number in 0..10_000 {
        let (node, text) = (node("spare"), format!("line {number}"));
        tell(&mut dashboard, at_ms(1_000), Message::Log { node, text });
    }
    dashboard.view.tab = Tab::Log;
    let mut harness = show(dashboard);
    assert!(shows(&harness, "10000 of 10000 lines"));
    assert!(shows(&harness, "line 9999"), "the newest is in sight");
    assert!(
        !shows(&harness, "line 1234"),
        "what is out of sight is not drawn"
    );
    harness.state_mut().view.log.filter = "line 1234".to_owned();
    harness.run_steps(2);
    assert!(shows(&harness, "1 of 10000 lines"));
}

#[test]
fn the_keys_are_shown_by_a_question_mark() {
    let mut harness = show(fleet());
    harness.event(egui::Event::Text("?".to_owned()));
    harness.run_steps(3);
    assert!(shows(&harness, "Ctrl+Space"));
    harness.key_press(Key::Escape);
    harness.run_steps(3);
    assert!(!shows(&harness, "Ctrl+Space"));
}

#[test]
fn the_log_shows_its_newest_lines() {
    let mut dashboard = fleet();
    for number in 0..500 {
        let (node, text) = (node("cell-a-1"), format!("number {number}."));
        tell(&mut dashboard, at_ms(1_000), Message::Log { node, text });
    }
    let mut harness = show(dashboard);
    // What another panel remembers of its place is none of its business.
    for key in [Key::T, Key::L] {
        harness.key_press_modifiers(Modifiers::COMMAND, key);
        harness.run_steps(4);
    }
    assert!(shows(&harness, "number 499.") && !shows(&harness, "number 1."));
}

#[test]
fn picture_of_the_fleet_and_the_jobs() {
    picture_of("fleet", fleet);
}

#[test]
fn picture_of_a_node_and_the_composer() {
    picture_of("node", || {
        let mut dashboard = fleet();
        dashboard.view.focus = Some(node("cell-a-1"));
        dashboard.view.tab = Tab::Compose;
        dashboard.view.composer.target = "cell-a-$*".to_owned();
        dashboard.view.composer.text = "{\"commands\":[\n  {\"ramp\":{\"axis\":0}}\n]}".to_owned();
        dashboard
    });
}

#[test]
fn picture_of_the_log_and_the_keys() {
    picture_of("log", || {
        let mut dashboard = fleet();
        dashboard.view.tab = Tab::Log;
        dashboard.view.help_open = true;
        dashboard
    });
}

#[test]
fn picture_of_a_job_in_detail() {
    picture_of("job", || {
        let mut dashboard = fleet();
        dashboard.view.jobs.open = Some(job("cut-7"));
        dashboard
    });
}

#[test]
fn picture_before_anything_is_connected() {
    picture_of("no_gateway", || {
        let mut dashboard = Dashboard::default();
        let to = "tcp/localhost:7447".to_owned();
        let connecting = Message::Link(LinkEvent::Connecting { to });
        tell(&mut dashboard, crate::fixture::START, connecting);
        let why =
            "nothing answers at tcp/localhost:7447: Connection refused (os error 111)".to_owned();
        tell(
            &mut dashboard,
            at_ms(10),
            Message::Link(LinkEvent::Down { why }),
        );
        dashboard.model.tick(at_ms(4_000));
        dashboard
    });
}
