//! Recording and replay as the operator uses them: what is shown, and what is not sent.

use crate::fixture::{at_ms, fleet, node, status, tell_status};
use crate::screen::{Window, button, click, picture, show, show_in, shows};
use dashboard::{
    app::Dashboard, message::Message, recording::session::Wish, request::Request, request::Scope,
    view::Tab,
};
use egui::Role;
use keys::{NodeState, StopMode};
use std::path::Path;

/// Records ten seconds in which `spare` moves to step 900 and `cell-a-1` writes a line.
fn record(file: &Path) {
    let mut dashboard = fleet();
    dashboard
        .session
        .record(&file.display().to_string(), &dashboard.model);
    for second in 1..=10_u64 {
        let at = at_ms(1_000 + second * 1_000);
        let steps = [90 * second as i64, 0];
        let status = Box::new(status(NodeState::Running, second * 1_000, steps, 90));
        let node = node("spare");
        dashboard.hear(at, Message::Status { node, status });
    }
    let (node, text) = (node("cell-a-1"), "recorded words".to_owned());
    dashboard.hear(at_ms(9_000), Message::Log { node, text });
    assert!(dashboard.session.recorder().is_some());
    dashboard.session.end_record();
}

fn replaying(file: &Path) -> Dashboard {
    let mut dashboard = crate::fixture::connected();
    dashboard.view.recording.wish = Some(Wish::Open(file.display().to_string()));
    dashboard
}

fn settle(window: &mut Window) {
    window.run_steps(1);
    window.state_mut().files.wait();
    window.run_steps(3);
}

fn asked(window: &mut Window) -> Vec<Request> {
    let now = window.state().model.now();
    let asked = window.state_mut().take_requests(now);
    window.run_steps(2);
    asked.into_iter().map(|(_, request)| request).collect()
}

#[test]
fn a_session_is_recorded_by_a_button_and_never_over_another_one() {
    let folder = tempfile::tempdir().expect("a folder");
    let file = folder.path().join("day.jsonl");
    let mut dashboard = fleet();
    dashboard.view.tab = Tab::Recording;
    dashboard.view.recording.record_path = file.display().to_string();
    let mut window = show(dashboard);
    button(&mut window, "⏺ Record");
    assert!(shows(&window, "⏺ recording, "));
    button(&mut window, "⏹ End recording");
    let text = std::fs::read_to_string(&file).expect("the file");
    assert!(text.starts_with("{\"stepfleet_recording\":1,"), "{text}");
    assert!(
        text.contains("engrave-7"),
        "what was known at the beginning"
    );
    button(&mut window, "⏺ Record");
    assert!(shows(&window, "day.jsonl: File exists"));
    assert_eq!(std::fs::read_to_string(&file).expect("the file"), text);
}

#[test]
fn a_recording_is_shown_as_the_past_and_moves_by_the_slider() {
    let folder = tempfile::tempdir().expect("a folder");
    let file = folder.path().join("day.jsonl");
    record(&file);
    let mut window = show(replaying(&file));
    settle(&mut window);
    assert!(shows(
        &window,
        "REPLAY: everything below this bar is the past"
    ));
    assert!(shows(&window, "7 of 7 nodes"), "those of the recording");
    assert!(
        shows(&window, "○ 0 alive") || shows(&window, "● 0 alive"),
        "the bar above is live"
    );
    window.state_mut().view.recording.wish = Some(Wish::Seek(at_ms(11_000)));
    window.state_mut().view.focus = Some(node("spare"));
    window.run_steps(3);
    assert!(shows(&window, "900 · 0"));
    window.state_mut().view.recording.wish = Some(Wish::Seek(at_ms(6_000)));
    window.run_steps(3);
    assert!(shows(&window, "450 · 0"), "and back");
    button(&mut window, "Play replay");
    let now = window.state().model.now();
    window.state_mut().model.tick(now.plus_us(2_000_000));
    window.run_steps(2);
    assert!(shows(&window, "630 · 0"), "two seconds on");
    button(&mut window, "Pause replay");
    window.state_mut().view.selection.insert(node("spare"));
    button(&mut window, "End replay");
    assert!(!shows(&window, "REPLAY"));
    assert!(
        window.state().view.selection.is_empty(),
        "chosen in the past"
    );
    assert!(shows(&window, "0 of 0 nodes"), "the live fleet again");
}

#[test]
fn a_replay_that_stands_still_draws_only_for_the_live_fleet() {
    let folder = tempfile::tempdir().expect("a folder");
    let file = folder.path().join("day.jsonl");
    record(&file);
    let mut window = show(replaying(&file));
    settle(&mut window);
    let delay = |window: &Window| {
        let root = egui::ViewportId::ROOT;
        window.output().viewport_output[&root].repaint_delay
    };
    // What was opened just now may still settle.
    window.run_steps(20);
    assert!(delay(&window) > dashboard::app::FRAME_EVERY);
    button(&mut window, "Play replay");
    window.run_steps(20);
    assert!(delay(&window) <= dashboard::app::FRAME_EVERY);
}

#[test]
fn nothing_but_stop_all_leaves_while_the_past_is_shown() {
    let folder = tempfile::tempdir().expect("a folder");
    let file = folder.path().join("day.jsonl");
    record(&file);
    let mut window = show(replaying(&file));
    settle(&mut window);
    button(&mut window, "cell-a-1");
    button(&mut window, "Stop node");
    assert_eq!(asked(&mut window), []);
    assert!(shows(
        &window,
        "NOT SENT: stop of cell-a-1. End the replay first."
    ));
    assert!(
        window.state().model.efforts().next().is_none(),
        "nothing was begun"
    );
    button(&mut window, "engrave-7");
    button(&mut window, "Cancel job…");
    button(&mut window, "Really cancel");
    assert_eq!(asked(&mut window), []);
    assert!(shows(&window, "NOT SENT: cancel of engrave-7"));
    button(&mut window, "STOP ALL");
    let (scope, mode) = (Scope::All, StopMode::Halt);
    assert_eq!(asked(&mut window), [Request::Stop { scope, mode }]);
    assert!(
        shows(&window, "Software stop of all nodes"),
        "its effect is live"
    );
}

#[test]
fn the_live_fleet_is_heard_behind_the_replay() {
    let folder = tempfile::tempdir().expect("a folder");
    let file = folder.path().join("day.jsonl");
    record(&file);
    let mut window = show(replaying(&file));
    settle(&mut window);
    let (id, alive) = (node("newcomer"), true);
    let dashboard = window.state_mut();
    dashboard.hear(at_ms(1), Message::Alive { node: id, alive });
    tell_status(
        dashboard,
        at_ms(1),
        "newcomer",
        status(NodeState::Idle, 1, [0, 0], 0),
    );
    window.run_steps(2);
    assert!(shows(&window, "STOP ALL are live: 1 alive"));
    assert!(shows(&window, "7 of 7 nodes"), "the past has no newcomer");
}

#[test]
fn a_file_that_is_no_recording_says_why() {
    let folder = tempfile::tempdir().expect("a folder");
    let file = folder.path().join("none.jsonl");
    std::fs::write(&file, "hello").expect("a file");
    let mut dashboard = replaying(&file);
    dashboard.view.tab = Tab::Recording;
    let mut window = show(dashboard);
    settle(&mut window);
    assert!(shows(&window, "none.jsonl: this is no recording"));
    click(&mut window, Role::Button, "Jobs");
    assert!(!shows(&window, "REPLAY:"));
}

#[test]
fn picture_of_a_running_recording() {
    let folder = tempfile::tempdir().expect("a folder");
    picture("recording", |theme| {
        let mut dashboard = fleet();
        let file = folder.path().join(format!("{theme:?}.jsonl"));
        dashboard.view.recording.record_path = "monday.jsonl".to_owned();
        let file = file.display().to_string();
        dashboard.session.record(&file, &dashboard.model);
        let recorder = dashboard.session.recorder().expect("it runs");
        while recorder.written_bytes() < recorder.taken_bytes() {
            std::thread::yield_now();
        }
        dashboard.view.tab = Tab::Recording;
        show_in(dashboard, theme, crate::screen::PICTURE_SIZE)
    });
}

#[test]
fn picture_of_a_replay() {
    let folder = tempfile::tempdir().expect("a folder");
    let file = folder.path().join("day.jsonl");
    record(&file);
    picture("replay", |theme| {
        let mut dashboard = replaying(&file);
        dashboard.view.tab = Tab::Recording;
        let mut window = show_in(dashboard, theme, [1_000.0, 600.0]);
        settle(&mut window);
        window.state_mut().view.recording.wish = Some(Wish::Seek(at_ms(6_000)));
        window.run_steps(3);
        button(&mut window, "cell-a-1");
        button(&mut window, "Stop node");
        asked(&mut window);
        window
    });
}
