//! The composer: checked while typing, previewed, opened from files, sent, answered node by node.

use crate::fixture::{at_ms, fleet, job, node, tell};
use crate::screen::{Window, asked, button, click, do_files, picture_of, show, shows};
use dashboard::{
    app::Dashboard,
    message::{Answer, FileOutcome, Message},
    request::{Language, Request, Target, Ticket},
    view::Tab,
};
use egui::Role;
use egui_kittest::kittest::Queryable as _;
use keys::record::{ErrorCode, JobError, JobState, Receipt};
use std::collections::BTreeSet;

const SQUARE: &str = r#"{"commands":[
  {"line":{"steps":[2000,0],"speed_hz":1000,"accel":2000}},
  {"line":{"steps":[0,2000],"speed_hz":1000,"accel":2000}},
  {"line":{"steps":[-2000,0],"speed_hz":1000,"accel":2000}},
  {"line":{"steps":[0,-2000],"speed_hz":1000,"accel":2000}},
  {"home":{"axis":0}}
]}"#;

fn composing(target: &str, text: &str) -> Dashboard {
    let mut dashboard = fleet();
    dashboard.view.tab = Tab::Compose;
    dashboard.view.composer.target = target.to_owned();
    dashboard.view.composer.text = text.to_owned();
    dashboard
}

#[test]
fn what_a_job_would_do_is_told_before_it_is_sent() {
    let screen = show(composing("cell-a-1", SQUARE));
    assert!(shows(&screen, "✔ 5 commands"));
    assert!(shows(&screen, "Estimate: 10.00 s"));
    assert!(shows(&screen, "and what 1 command of unknown length take"));
    assert!(shows(&screen, "travel 4\u{a0}000 steps"));
}

#[test]
fn a_preview_begins_where_the_node_rests() {
    let up = r#"{"commands":[{"ramp_to":{"axis":0,"position":12350,"speed_hz":100,"accel":100}}]}"#;
    let screen = show(composing("cell-a-2", up));
    assert!(shows(
        &screen,
        "axis 0: 12\u{a0}345 to 12\u{a0}350, travel 5 steps"
    ));
}

#[test]
fn a_script_is_sent_as_lua() {
    let mut screen = show(composing("cell-a-2", SQUARE));
    button(&mut screen, "Lua");
    assert!(shows(&screen, "✔ Lua"));
    screen.state_mut().view.composer.script = "motor.execute(\n".to_owned();
    screen.run_steps(2);
    assert!(shows(&screen, "⚠ no Lua? line "));
    screen.state_mut().view.composer.script = "print('hello')".to_owned();
    screen.run_steps(2);
    button(&mut screen, "Send job");
    let submit = Request::Submit {
        target: Target::Node("cell-a-2".to_owned()),
        language: Language::Lua,
        text: "print('hello')".to_owned(),
    };
    assert_eq!(asked(&mut screen)[0].1, submit);
}

#[test]
fn a_selection_gets_a_job_for_each_node_and_one_answer_from_each() {
    let mut dashboard = composing("", SQUARE);
    let nodes = BTreeSet::from([node("cell-a-1"), node("cell-a-2")]);
    dashboard.view.selection.clone_from(&nodes);
    let mut screen = show(dashboard);
    click(&mut screen, Role::CheckBox, "Selection (2)");
    assert!(shows(&screen, "reaches 2 nodes: cell-a-1, cell-a-2"));
    let with_id = SQUARE.replacen('{', "{\"id\":\"one\",", 1);
    screen.state_mut().view.composer.text = with_id;
    screen.run_steps(2);
    button(&mut screen, "Send job");
    assert_eq!(asked(&mut screen), [], "one id is one job");
    screen.state_mut().view.composer.text = SQUARE.to_owned();
    screen.run_steps(2);
    button(&mut screen, "Send job");
    let asked = asked(&mut screen);
    assert!(
        matches!(&asked[0].1, Request::Submit { target, .. } if *target == Target::Nodes(nodes))
    );
    let receipt = Receipt {
        job: job("j-1"),
        state: JobState::Queued,
    };
    let refusal = JobError::new(ErrorCode::Stopped, "cell-a-2 is stopped");
    let (ticket, answer) = (
        asked[0].0,
        Answer::Receipts(vec![Ok(receipt), Err(refusal)]),
    );
    tell(
        screen.state_mut(),
        at_ms(1_000),
        Message::Answer { ticket, answer },
    );
    let record = crate::fixture::job_record("j-1", "cell-a-1", JobState::Running, 1, 5);
    tell(
        screen.state_mut(),
        at_ms(1_000),
        Message::Job(Box::new(record)),
    );
    screen.run_steps(2);
    assert!(shows(&screen, "j-1: running") && shows(&screen, "on cell-a-1"));
    assert!(shows(&screen, "refused: stopped: cell-a-2 is stopped"));
}

fn opened(screen: &mut Window, text: &str) -> String {
    let asked = asked(screen);
    let [(ticket, Request::ReadFile { path })] = &asked[..] else {
        panic!("one file is read, not {asked:?}");
    };
    let outcome = FileOutcome::Read {
        path: path.clone(),
        text: text.to_owned(),
    };
    let ticket = *ticket;
    tell(
        screen.state_mut(),
        at_ms(1_000),
        Message::File { ticket, outcome },
    );
    screen.run_steps(3);
    path.clone()
}

#[test]
fn a_file_is_opened_and_its_name_says_the_language() {
    let mut screen = show(composing("cell-a-2", ""));
    screen.state_mut().view.composer.file = "jobs/square.lua".to_owned();
    screen.run_steps(2);
    button(&mut screen, "Open file");
    assert_eq!(opened(&mut screen, "print(1)"), "jobs/square.lua");
    let composer = &screen.state().view.composer;
    assert_eq!(
        (composer.language, composer.script.as_str()),
        (Language::Lua, "print(1)")
    );
}

#[test]
fn a_file_that_cannot_be_read_says_why_and_leaves_the_text() {
    let mut screen = show(composing("cell-a-2", SQUARE));
    screen.state_mut().view.composer.file = "/nowhere/at/all.json".to_owned();
    screen.run_steps(2);
    button(&mut screen, "Open file");
    do_files(&mut screen);
    assert!(shows(&screen, "✖ /nowhere/at/all.json"));
    assert_eq!(screen.state().view.composer.text, SQUARE);
    button(&mut screen, "Send job");
    assert_eq!(asked(&mut screen), [], "it is not what was to be opened");
    button(&mut screen, "Keep the text below");
    button(&mut screen, "Send job");
    assert_eq!(asked(&mut screen).len(), 1);
}

#[test]
fn nothing_is_sent_while_a_file_is_being_opened_whatever_else_is_written_meanwhile() {
    let mut screen = show(composing("cell-a-2", SQUARE));
    screen.state_mut().view.composer.file = "jobs/later.json".to_owned();
    screen.run_steps(2);
    button(&mut screen, "Open file");
    let (ticket, _) = asked(&mut screen)[0];
    button(&mut screen, "Send job");
    assert_eq!(asked(&mut screen), [], "the text is that of before");
    // Read while another tab is open, and a history is written right behind it.
    screen.state_mut().view.tab = dashboard::view::Tab::Jobs;
    let outcome = FileOutcome::Read {
        path: "jobs/later.json".to_owned(),
        text: "{\"later\":1}".to_owned(),
    };
    let read = Message::File { ticket, outcome };
    tell(screen.state_mut(), at_ms(1_000), read);
    screen.run_steps(1);
    let (ticket, path) = (Ticket(1_000), "history.csv".to_owned());
    let outcome = FileOutcome::Written { path };
    let written = Message::File { ticket, outcome };
    tell(screen.state_mut(), at_ms(1_000), written);
    screen.run_steps(1);
    screen.state_mut().view.tab = dashboard::view::Tab::Compose;
    screen.run_steps(2);
    assert_eq!(screen.state().view.composer.text, "{\"later\":1}");
    assert!(!shows(&screen, "⌛ opening"));
}

#[derive(Debug)]
struct Dropped;

impl egui::DroppedFile for Dropped {
    fn path(&self) -> &std::path::Path {
        std::path::Path::new("square.json")
    }

    fn bytes(&self) -> Result<Vec<u8>, String> {
        Err("the window reads files away from its thread".to_owned())
    }
}

#[test]
fn a_file_dropped_on_a_row_is_for_that_node() {
    let mut screen = show(fleet());
    let row = screen
        .get_by_role_and_label(Role::Button, "cell-b-1")
        .rect();
    screen.hover_at(row.center());
    screen.run_steps(2);
    let file = std::sync::Arc::new(Dropped);
    screen.input_mut().dropped_files.push(file);
    screen.run_steps(1);
    opened(&mut screen, SQUARE);
    let view = &screen.state().view;
    assert_eq!(
        (view.tab, view.composer.target.as_str()),
        (Tab::Compose, "cell-b-1")
    );
    assert_eq!(view.composer.text, SQUARE);
}

#[test]
fn where_the_system_tells_no_place_a_dropped_file_is_for_what_is_selected_and_says_so() {
    let drop = |prepare: &dyn Fn(&mut Dashboard)| {
        let mut dashboard = fleet();
        dashboard.view.composer.target = "spare".to_owned();
        prepare(&mut dashboard);
        let mut screen = show(dashboard);
        screen.remove_cursor();
        screen.run_steps(2);
        let file = std::sync::Arc::new(Dropped);
        screen.input_mut().dropped_files.push(file);
        screen.run_steps(1);
        opened(&mut screen, SQUARE);
        screen
    };
    let screen = drop(&|dashboard| dashboard.view.focus = Some(node("cell-b-1")));
    assert_eq!(screen.state().view.composer.target, "cell-b-1");
    assert!(shows(
        &screen,
        "did not tell where the file fell; it is for cell-b-1"
    ));
    let both = BTreeSet::from([node("cell-a-1"), node("cell-a-2")]);
    let screen = drop(&|dashboard| dashboard.view.selection.clone_from(&both));
    assert!(screen.state().view.composer.to_selection);
    assert!(shows(&screen, "it is for the 2 selected nodes"));
    let screen = drop(&|_| {});
    assert!(shows(&screen, "no node is selected: say for whom it is"));
}

#[test]
fn of_several_dropped_files_one_is_opened_and_the_others_are_not_passed_over_in_silence() {
    let mut screen = show(fleet());
    for _ in 0..3 {
        let file = std::sync::Arc::new(Dropped);
        screen.input_mut().dropped_files.push(file);
    }
    screen.run_steps(1);
    opened(&mut screen, SQUARE);
    assert!(shows(
        &screen,
        "one job at a time: 2 other files not opened"
    ));
}

#[test]
fn a_selection_says_who_is_there_and_who_is_not() {
    let mut dashboard = composing("", SQUARE);
    dashboard.view.selection = BTreeSet::from([node("cell-a-1"), node("cell-b-3")]);
    dashboard.view.composer.to_selection = true;
    let screen = show(dashboard);
    assert!(shows(&screen, "● reaches 1 node: cell-a-1"));
    assert!(shows(
        &screen,
        "so that the job waits there: 1 node: cell-b-3"
    ));
}

#[test]
fn a_text_that_is_too_long_to_edit_is_sent_as_it_is() {
    let one = r#"{"move":{"axis":0,"delay_us":10,"steps":5}}"#;
    let text = format!("{{\"commands\":[{}]}}", vec![one; 4_000].join(","));
    let mut screen = show(composing("cell-a-2", &text));
    assert!(shows(&screen, "too long to edit here"));
    assert!(shows(&screen, "✔ 4000 commands"));
    button(&mut screen, "Send job");
    assert!(
        matches!(&asked(&mut screen)[0].1, Request::Submit { text: sent, .. } if *sent == text)
    );
}

#[test]
fn picture_of_the_composer() {
    picture_of("composer", || composing("cell-a-$*", SQUARE));
}

#[test]
fn picture_of_an_error_in_the_composer() {
    let wrong = SQUARE.replacen("1000", "0", 1);
    picture_of("composer_error", || composing("cell-a-2", &wrong));
}
