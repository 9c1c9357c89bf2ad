//! The history of jobs: filtered, exported, written to files.

use crate::fixture::{at_ms, fleet, job_record, node, tell};
use crate::screen::{Window, asked, button, do_files, picture_of, show, shows};
use dashboard::{
    app::Dashboard,
    message::{FileOutcome, Message},
    records,
    request::Request,
};
use keys::record::{ErrorCode, JobError, JobRecord, JobState};

fn filter(screen: &mut Window, node: &str) {
    screen.state_mut().view.jobs.node = node.to_owned();
    screen.run_steps(2);
}

#[test]
fn jobs_are_filtered_by_node_state_and_words_together() {
    let mut screen = show(fleet());
    assert!(shows(&screen, "4 of 4 jobs"));
    filter(&mut screen, "cell-a-$*");
    assert!(shows(&screen, "3 of 4 jobs"), "a part counts");
    filter(&mut screen, "cell-a-3");
    assert!(shows(&screen, "1 of 4 jobs"));
    filter(&mut screen, "cell-a-*");
    assert!(shows(&screen, "inside a name write $*"));
    filter(&mut screen, "cell-a-2");
    screen.state_mut().view.jobs.state = Some(JobState::Succeeded);
    screen.run_steps(2);
    assert!(shows(&screen, "1 of 4 jobs"));
    screen.state_mut().view.jobs.filter = "cut".to_owned();
    screen.run_steps(2);
    assert!(shows(&screen, "no job passes the filter"));
}

#[test]
fn what_is_listed_is_exported() {
    let mut screen = show(fleet());
    filter(&mut screen, "cell-b-1");
    screen.state_mut().view.jobs.export = "refused.csv".to_owned();
    screen.run_steps(2);
    button(&mut screen, "Export CSV");
    let csv = asked(&mut screen);
    let Request::WriteFile { path, text } = &csv[0].1 else {
        panic!("a file is written, not {:?}", csv[0].1);
    };
    assert_eq!(path, "refused.csv");
    let lines: Vec<&str> = text.lines().collect();
    assert_eq!(lines.len(), 2, "names and one job");
    assert!(lines[1].starts_with("drill-2,cell-b-1,,rejected,3,2026-11-21T02:56:40"));
    assert!(lines[1].ends_with("stopped: the stop latch of cell-b-1 is set"));
    let ticket = csv[0].0;
    let path = "/somewhere/refused.csv".to_owned();
    let outcome = FileOutcome::Written { path };
    tell(
        screen.state_mut(),
        at_ms(1_000),
        Message::File { ticket, outcome },
    );
    screen.run_steps(2);
    assert!(shows(&screen, "✔ wrote /somewhere/refused.csv"));
    screen.state_mut().view.jobs.export = "refused.json".to_owned();
    screen.run_steps(2);
    button(&mut screen, "Export JSON");
    let Request::WriteFile { text, .. } = &asked(&mut screen)[0].1 else {
        panic!("a file is written");
    };
    let records: Vec<JobRecord> = serde_json::from_str(text).expect("records");
    assert_eq!(records[0].node, Some(node("cell-b-1")));
}

#[test]
fn a_field_of_a_table_cannot_break_out_of_it() {
    let mut record = job_record("a", "left", JobState::Failed, 0, 1);
    let words = "=1+1, \"quoted\"\nand a second line";
    record.error = Some(JobError::new(ErrorCode::Internal, words));
    let csv = records::csv(&[&record]);
    assert!(csv.ends_with(",\"internal: =1+1, \"\"quoted\"\"\nand a second line\"\r\n"));
}

#[test]
fn the_list_becomes_a_file_and_one_that_exists_is_not_written_over() {
    let folder = tempfile::tempdir().expect("a folder");
    let file = folder.path().join("jobs.csv");
    let mut window = show(fleet());
    window.state_mut().view.jobs.export = file.display().to_string();
    window.run_steps(2);
    button(&mut window, "Export CSV");
    do_files(&mut window);
    assert!(shows(&window, "✔ wrote "));
    let written = std::fs::read_to_string(&file).expect("the file");
    assert_eq!(written.lines().count(), 5, "{written}");
    button(&mut window, "Export JSON");
    do_files(&mut window);
    assert!(shows(&window, "jobs.csv: File exists"));
    assert_eq!(std::fs::read_to_string(&file).expect("the file"), written);
}

#[test]
fn picture_of_the_history() {
    picture_of("history", || -> Dashboard {
        let mut dashboard = fleet();
        dashboard.view.jobs.node = "cell-a-$*".to_owned();
        dashboard.view.jobs.open = Some(crate::fixture::job("drill-1"));
        dashboard
    });
}
