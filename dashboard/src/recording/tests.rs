//! Recordings: what is written is read, with a bound on everything.

use super::{
    recorder::Recorder,
    replay::{Replay, SLICE},
    session::Session,
    *,
};
use keys::{JobId, StopMode, record::JobRecord};

fn node() -> NodeId {
    NodeId::new("left").expect("a name")
}

fn log(number: u64) -> Message {
    Message::Log {
        node: node(),
        text: format!("line {number}"),
    }
}

fn at_ms(ms: u64) -> Moment {
    Moment(1_795_230_000_000_000).plus_us(ms * 1_000)
}

fn status() -> Message {
    let text = r#"{"at":5,"queue":{"boot":1,"flush":0},"state":"Running","stop":null,"job":null,
        "accepted_commands":4,"executed_commands":1,"credit_commands":9,
        "axes":[{"position_steps":-7,"speed_mhz":1000}],"faults":[],"features":1,
        "firmware":[0,1,0],"rssi_dbm":-61,"laser_percent":0,"lidar_mm":null}"#;
    let status = serde_json::from_str(text).expect("a status");
    let node = node();
    Message::Status { node, status }
}

#[test]
fn a_recording_begins_with_how_nodes_are_set_but_not_with_what_they_told_before_another_boot() {
    let mut live = Model::default();
    live.apply(at_ms(0), status());
    let (node, setup) = (node(), Box::new(keys::Setup::default()));
    live.apply(at_ms(0), Message::Setup { node, setup });
    let told = |live: &Model| {
        let messages = picture(live).into_iter();
        let setups = messages.filter(|message| matches!(message, Message::Setup { .. }));
        setups.count()
    };
    assert_eq!(told(&live), 1);
    let mut anew = status();
    if let Message::Status { status, .. } = &mut anew {
        status.queue.boot = 2;
    }
    live.apply(at_ms(1), anew);
    assert_eq!(told(&live), 0);
}

#[test]
fn what_is_recorded_is_replayed_to_the_same_picture() {
    let folder = tempfile::tempdir().expect("a folder");
    let file = folder.path().join("session.jsonl");
    let mut live = Model::default();
    let to = "tcp/localhost:7447".to_owned();
    live.apply(at_ms(0), Message::Link(LinkEvent::Connected { to }));
    let alive = Message::Alive {
        node: node(),
        alive: true,
    };
    live.apply(at_ms(0), alive);
    live.apply(at_ms(0), status());
    let mut recorder =
        Recorder::start(&file, at_ms(10), picture(&live), BYTES_MAX).expect("a file");
    let stop = Message::StopAsked {
        ticket: crate::request::Ticket(1),
        scope: crate::request::Scope::All,
        mode: StopMode::Halt,
    };
    let record = serde_json::from_str::<JobRecord>(
        r#"{"job":"x","node":"left","group":null,"state":"queued","version":1,
            "created":"2026-11-21T03:00:00.000000Z","updated":"2026-11-21T03:00:00.000000Z",
            "progress":{"done":0,"total":4},"error":null,"result":null}"#,
    )
    .expect("a record");
    let rest = [log(1), stop, Message::Job(Box::new(record)), log(2)];
    for (message, after_ms) in rest.into_iter().zip([1_000, 2_000, 3_000, 4_000]) {
        recorder.heard(at_ms(after_ms), &message);
        live.apply(at_ms(after_ms), message);
    }
    drop(recorder);
    let text = std::fs::read_to_string(&file).expect("the file");
    let recording = Recording::parse(&text).expect("a recording");
    assert_eq!((recording.broken, recording.left_out), (0, 0));
    let mut replay = Replay::new("session".to_owned(), recording);
    let shown = |replay: &Replay| {
        let model = replay.model();
        (
            model.nodes().count(),
            model.log().lines().len(),
            model.efforts().count(),
        )
    };
    assert_eq!(shown(&replay).0, 1, "the picture at the beginning");
    replay.seek(at_ms(60_000));
    assert_eq!(replay.at(), at_ms(4_000), "not beyond its end");
    let job = JobId::new("x").expect("a name");
    assert_eq!(replay.model().jobs().get(&job), live.jobs().get(&job));
    let (then, now) = (replay.model().node(&node()), live.node(&node()));
    let words = |node: Option<&crate::model::node::Node>| {
        node.map(|node| (node.word(), node.positions_steps()))
    };
    assert_eq!(words(then), words(now));
    assert_eq!(shown(&replay).2, 1, "the stop is part of it");
    replay.seek(at_ms(1_500));
    assert_eq!(shown(&replay).2, 0, "back before the stop");
    let error = Recorder::start(&file, at_ms(0), Vec::new(), BYTES_MAX).expect_err("it exists");
    assert_eq!(error.kind(), std::io::ErrorKind::AlreadyExists);
}

#[test]
fn playing_moves_by_the_live_clock_and_ends_at_the_end() {
    let mut text = to_line(&Head {
        stepfleet_recording: VERSION,
        began: at_ms(0),
    });
    for second in 0..=10 {
        let line = Line {
            at: at_ms(second * 1_000),
            message: Some(log(second)),
            left_out: 0,
        };
        text += &to_line(&line);
    }
    let recording = Recording::parse(&text).expect("a recording");
    let mut replay = Replay::new("session".to_owned(), recording);
    let later = |ms: u64| at_ms(1_000_000 + ms);
    replay.play(later(0));
    replay.speed = 2.0;
    replay.play(later(1_500));
    assert_eq!(replay.at(), at_ms(3_000));
    replay.play(later(60_000));
    assert_eq!((replay.at(), replay.speed), (at_ms(10_000), 0.0));
}

#[test]
fn a_flood_is_thinned_and_counted_in_the_file() {
    let folder = tempfile::tempdir().expect("a folder");
    let file = folder.path().join("flood.jsonl");
    let mut recorder = Recorder::start(&file, at_ms(0), Vec::new(), BYTES_MAX).expect("a file");
    for ms in 0..1_000 {
        recorder.heard(at_ms(ms), &status());
    }
    let left_out = recorder.left_out();
    assert!((980..=990).contains(&left_out), "{left_out}");
    recorder.heard(at_ms(1_000), &log(1));
    drop(recorder);
    let text = std::fs::read_to_string(&file).expect("the file");
    let recording = Recording::parse(&text).expect("a recording");
    assert_eq!(recording.left_out, left_out);
    assert_eq!(recording.messages.len() as u64, 1_001 - left_out);
}

#[test]
fn bytes_have_a_rate() {
    let mut thinner = Thinner::default();
    let half = BYTES_PER_S as usize / 2;
    let kept = [0, 0, 0, 500, 500, 10_000].map(|ms| thinner.keeps(at_ms(ms), &log(0), half));
    assert_eq!(kept, [true, true, false, true, false, true]);
}

#[test]
fn a_file_that_is_none_and_one_cut_by_a_crash() {
    for text in ["", "{}", "hello\n", "\u{0}\u{1}"] {
        assert!(Recording::parse(text).is_err(), "{text}");
    }
    let head = to_line(&Head {
        stepfleet_recording: VERSION + 1,
        began: at_ms(0),
    });
    let error = Recording::parse(&head).expect_err("too new");
    assert!(error.contains("version 2"), "{error}");
    let head = head.replace(":2,", ":1,");
    let line = to_line(&Line {
        at: at_ms(5),
        message: Some(log(5)),
        left_out: 0,
    });
    let cut = format!("{head}{line}{}", &line[..20]);
    let recording = Recording::parse(&cut).expect("what was written before");
    assert_eq!((recording.messages.len(), recording.broken), (1, 1));
    let garbage = format!("{head}{}", "rubbish\n".repeat(BROKEN_MAX + 1));
    assert!(Recording::parse(&garbage).is_err());
}

#[test]
fn a_full_file_is_followed_by_the_next_which_can_be_shown_alone() {
    let folder = tempfile::tempdir().expect("a folder");
    let first = folder.path().join("day.jsonl");
    let mut live = Model::default();
    let alive = Message::Alive {
        node: node(),
        alive: true,
    };
    live.apply(at_ms(0), alive);
    let mut session = Session::default();
    session.part_bytes_max = 1_500;
    session.record(&first.display().to_string(), &live);
    for number in 0..40 {
        session.heard(at_ms(number), &log(number), &live);
        live.apply(at_ms(number), log(number));
    }
    let path = session.recorder().expect("it goes on").path().to_owned();
    assert_eq!(session.recorder().and_then(Recorder::failed), None);
    session.end_record();
    assert_eq!(path, folder.path().join("day-3.jsonl"));
    let mut lines = Vec::new();
    for name in ["day.jsonl", "day-2.jsonl", "day-3.jsonl"] {
        let text = std::fs::read_to_string(folder.path().join(name)).expect("a file");
        assert!(text.len() <= 1_500, "{name}: {}", text.len());
        let recording = Recording::parse(&text).expect("a recording");
        let replay = Replay::new(name.to_owned(), recording.clone());
        assert_eq!(replay.model().nodes().count(), 1, "{name}");
        let is_line = |(_, message): &(Moment, Message)| match message {
            Message::Log { text, .. } => Some(text.clone()),
            _ => None,
        };
        lines.extend(recording.messages.iter().filter_map(is_line));
    }
    let expected: Vec<String> = (0..40).map(|number| format!("line {number}")).collect();
    assert_eq!(lines, expected, "none is lost, none twice");
    // The next name is taken: told, and nothing is written over.
    session.record(
        &folder.path().join("night.jsonl").display().to_string(),
        &live,
    );
    std::fs::write(folder.path().join("night-2.jsonl"), "mine").expect("written");
    for number in 0..40 {
        session.heard(at_ms(number), &log(number), &live);
    }
    let failed = session.recorder().and_then(Recorder::failed);
    assert!(failed.is_some_and(|why| why.contains("night-2.jsonl")));
}

#[test]
fn a_seek_over_many_messages_is_done_in_slices() {
    let count = 3 * SLICE as u64;
    let messages = (0..count).map(|ms| (at_ms(ms), log(ms))).collect();
    let recording = Recording {
        began: at_ms(0),
        ended: at_ms(count - 1),
        messages,
        ..Recording::default()
    };
    let mut replay = Replay::new("day".to_owned(), recording);
    replay.seek(at_ms(count));
    let told = |replay: &Replay| replay.model().log().count() as usize;
    assert_eq!((told(&replay), replay.is_behind()), (SLICE + 1, true));
    assert_eq!(replay.done_percent(), 33);
    replay.play(at_ms(0));
    replay.play(at_ms(0));
    assert_eq!((told(&replay), replay.is_behind()), (3 * SLICE, false));
    // Back: from the beginning, in slices again, and its clock waits until it is there.
    replay.seek(at_ms(count - 2));
    assert!(replay.is_behind());
    replay.speed = 1.0;
    replay.play(at_ms(500));
    replay.play(at_ms(900));
    assert_eq!(replay.at(), at_ms(count - 2));
    assert_eq!((told(&replay), replay.is_behind()), (3 * SLICE - 1, false));
}
