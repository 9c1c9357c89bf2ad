//! The editor of synchronized jobs: parts, readiness, countdown, measured skew.

use crate::fixture::{at_ms, fleet, job, node, tell};
use crate::screen::{Window, asked, button, picture_of, show, shows};
use dashboard::{
    app::Dashboard,
    message::{Answer, Message},
    request::{Language, Request, Target},
    view::Tab,
};
use keys::{
    FleetMicros, GroupId,
    job::GroupRequest,
    record::{JobRecord, JobState, PartRecord, Progress, Receipt, StartPlan, StartRecord},
};
use std::collections::{BTreeMap, BTreeSet};

fn editing() -> Dashboard {
    let mut dashboard = fleet();
    dashboard.view.tab = Tab::GroupJob;
    dashboard.view.selection = BTreeSet::from([node("cell-a-2"), node("cell-a-3")]);
    dashboard
}

fn record(state: JobState, start: Option<StartRecord>) -> JobRecord {
    let mut record = crate::fixture::job_record("cut-9", "cell-a-2", state, 0, 2);
    (record.node, record.group) = (None, GroupId::new("saws").ok());
    let part = |state| PartRecord {
        state,
        progress: Progress::default(),
        error: None,
        result: None,
    };
    let states = match state {
        JobState::Running => [JobState::Running; 2],
        _ => [JobState::Queued, JobState::Sent],
    };
    let parts = [
        (node("cell-a-2"), part(states[0])),
        (node("cell-a-3"), part(states[1])),
    ];
    record.parts = Some(BTreeMap::from(parts));
    record.start = start.map(Box::new);
    record
}

fn sent() -> Window {
    let mut screen = show(editing());
    button(&mut screen, "Add selection");
    screen.state_mut().view.group_job.group = "saws".to_owned();
    screen.run_steps(2);
    button(&mut screen, "Start together");
    let asked = asked(&mut screen);
    let Request::Submit {
        target,
        language,
        text,
    } = &asked[0].1
    else {
        panic!("a job is sent, not {:?}", asked[0].1);
    };
    assert_eq!(
        *target,
        Target::Group(GroupId::new("saws").expect("a name"))
    );
    assert_eq!(*language, Language::Json);
    let request = GroupRequest::from_json(text.as_bytes()).expect("a synchronized job");
    assert_eq!(request.nodes.len(), 2);
    assert_eq!(request.max_skew_us, Some(1_000.0));
    let receipt = Receipt {
        job: job("cut-9"),
        state: JobState::Queued,
    };
    let (ticket, answer) = (asked[0].0, Answer::Receipts(vec![Ok(receipt)]));
    tell(
        screen.state_mut(),
        at_ms(1_000),
        Message::Answer { ticket, answer },
    );
    screen
}

fn told(screen: &mut Window, version: u64, mut record: JobRecord) {
    record.version = version;
    tell(
        screen.state_mut(),
        at_ms(1_000),
        Message::Job(Box::new(record)),
    );
    screen.run_steps(2);
}

/// The record when all are ready.
fn ready() -> JobRecord {
    let mut ready = record(JobState::Sent, None);
    for part in ready.parts.iter_mut().flatten() {
        part.1.state = JobState::Sent;
    }
    ready
}

/// The instant is fixed: half a second ahead, by the gateway's clock.
fn plan() -> StartPlan {
    StartPlan {
        job: job("cut-9"),
        told: FleetMicros(at_ms(700).0),
        starts_at: FleetMicros(at_ms(1_200).0),
        max_skew_us: 1_000.0,
    }
}

fn start(planned_ms: u64, by_node_us: &[(&str, f64)]) -> StartRecord {
    StartRecord {
        planned: FleetMicros(at_ms(planned_ms).0),
        skew_us: 38.2,
        by_node_us: by_node_us
            .iter()
            .map(|(name, us)| (node(name), *us))
            .collect(),
        uncertainty_us: 55.0,
    }
}

#[test]
fn a_synchronized_job_is_followed_from_ready_to_the_measured_skew() {
    let mut screen = sent();
    told(&mut screen, 4, record(JobState::Sent, None));
    assert!(shows(&screen, "1 of 2 ready, waiting for cell-a-"));
    told(&mut screen, 5, ready());
    tell(screen.state_mut(), at_ms(1_000), Message::StartPlan(plan()));
    screen.run_steps(2);
    assert!(shows(&screen, "all ready, starts in 500.0 ms"));
    let repeat = screen.output().viewport_output[&egui::ViewportId::ROOT].repaint_delay;
    assert!(repeat <= dashboard::app::FRAME_EVERY, "{repeat:?}");
    screen.state_mut().model.tick(at_ms(1_400));
    screen.run_steps(2);
    assert!(shows(&screen, "starts in 100.0 ms"));
    screen.state_mut().model.tick(at_ms(1_501));
    screen.run_steps(2);
    assert!(shows(&screen, "starts now"));
    // Whatever became of it, it does not start now any more.
    screen.state_mut().model.tick(at_ms(3_600));
    screen.run_steps(2);
    assert!(shows(
        &screen,
        "the start was due 2.1 s ago and is not told yet"
    ));
    let measured = start(900, &[("cell-a-2", 0.0), ("cell-a-3", 38.2)]);
    told(&mut screen, 6, record(JobState::Running, Some(measured)));
    assert!(shows(&screen, "started 38 µs apart ± 55 µs"));
    assert!(shows(&screen, "+38.2 µs"));
    button(&mut screen, "Record");
    assert_eq!(screen.state().view.jobs.open, Some(job("cut-9")));
}

#[test]
fn a_synchronized_job_is_run_again_from_the_history() {
    let mut screen = sent();
    told(&mut screen, 4, record(JobState::Failed, None));
    screen.state_mut().view.group_job.parts.clear();
    screen.state_mut().view.jobs.open = Some(job("cut-9"));
    screen.state_mut().view.tab = Tab::Jobs;
    screen.run_steps(2);
    button(&mut screen, "Run again…");
    assert_eq!(screen.state().view.tab, Tab::GroupJob);
    assert_eq!(screen.state().view.group_job.parts.len(), 2);
}

#[test]
fn what_is_wrong_with_one_part_is_told_with_its_node_and_nothing_is_sent() {
    let mut screen = show(editing());
    button(&mut screen, "Add selection");
    let parts = &mut screen.state_mut().view.group_job.parts;
    parts.insert(node("cell-a-3"), r#"{"commands":[]}"#.to_owned());
    screen.run_steps(2);
    assert!(shows(&screen, "nodes.cell-a-3.commands"));
    button(&mut screen, "Start together");
    assert_eq!(asked(&mut screen), []);
    button(&mut screen, "Leave cell-a-3 out");
    assert!(shows(&screen, "✔ can be sent"));
}

#[test]
fn a_node_that_is_not_there_is_named_before_sending() {
    let mut dashboard = editing();
    dashboard.view.selection.insert(node("cell-b-3"));
    let mut screen = show(dashboard);
    button(&mut screen, "Add selection");
    assert!(shows(&screen, "not there: cell-b-3"));
}

fn picture_of_record(name: &str, record: impl Fn() -> JobRecord, plan: Option<StartPlan>) {
    picture_of(name, || {
        let mut dashboard = editing();
        let selection = dashboard.view.selection.clone();
        dashboard.view.group_job.add(&selection);
        dashboard.view.group_job.group = "saws".to_owned();
        let text = dashboard.view.group_job.whole().expect("a job").0;
        let ticket = dashboard.requests.push(Request::Submit {
            target: Target::Group(GroupId::new("saws").expect("a name")),
            language: Language::Json,
            text,
        });
        dashboard.take_requests(at_ms(1_000));
        dashboard.view.group_job.sent = Some(ticket);
        let receipt = Receipt {
            job: job("cut-9"),
            state: JobState::Queued,
        };
        let answer = Answer::Receipts(vec![Ok(receipt)]);
        tell(
            &mut dashboard,
            at_ms(1_000),
            Message::Answer { ticket, answer },
        );
        let record = Message::Job(Box::new(record()));
        tell(&mut dashboard, at_ms(1_000), record);
        if let Some(plan) = plan {
            tell(&mut dashboard, at_ms(1_000), Message::StartPlan(plan));
        }
        dashboard
    });
}

#[test]
fn picture_of_a_synchronized_job() {
    let record = || {
        let measured = start(900, &[("cell-a-2", 0.0), ("cell-a-3", 38.2)]);
        record(JobState::Running, Some(measured))
    };
    picture_of_record("group_job", record, None);
}

#[test]
fn picture_of_a_countdown() {
    picture_of_record("countdown", ready, Some(plan()));
}
