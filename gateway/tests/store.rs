//! The store over the years: formats, damage, copies, compaction, retention.

mod rig;

use gateway::{
    fleet::{
        Fleet, FleetConfig, Stored,
        event::{Table, Write},
    },
    job::book::KEPT_JOBS_MIN,
    journal::{
        COMPACT_BYTES_MIN, Journal, JournalError, check,
        copy::{Content, CopyError, CopyFile, PIECE_BYTES, Piece},
    },
};
use keys::record::JobState;
use rig::{MS, Rig, S, id, moves};
use serde_json::json;
use std::{fs, path::Path};

/// The stores in `tests/stores` were written by this on the day when their format was current.
///
/// A store with every kind of row: jobs that have ended, that run, that wait, that were refused, a
/// synchronized one and a script; nodes that are there and that are not.
fn day() -> Rig {
    let mut rig = Rig::new();
    for name in ["left", "right"] {
        rig.add(name);
    }
    rig.run(10 * MS);
    let ended = rig.accept("left", &moves("ended", 10, 1_000));
    rig.finish(&ended, 5 * S);
    rig.put(
        "left",
        &json!({"id": "refused", "commands": [{"jump": {}}]}),
    );
    rig.link("right", false);
    rig.run(10 * S);
    rig.accept("right", &moves("waits", 20, 1_000));
    rig.accept("left", &moves("runs", 5_000, 1_000));
    rig.accept("left", &moves("waits-too", 7, 1_000));
    rig.run(S);
    rig
}

fn store(path: &Path, rig: &Rig) {
    let (mut journal, _) = Journal::open(path).expect("opens");
    for writes in rig.writes.chunks(100) {
        journal.commit(writes).expect("commits");
    }
}

fn open_error(path: &Path) -> JournalError {
    Journal::open(path)
        .map(|_| ())
        .expect_err("it must be refused")
}

/// A store of each format, how many of its jobs wait or run, and how many have ended.
const STORES: [(&str, usize, usize); 1] = [("format-1", 3, 2)];

#[test]
fn a_store_of_every_format_is_read_and_taken_up() {
    let folder = tempfile::tempdir().expect("a folder");
    for (name, open, ended) in STORES {
        // A gateway writes into what it opens.
        let path = folder.path().join(name);
        let kept = format!("{}/tests/stores/{name}.redb", env!("CARGO_MANIFEST_DIR"));
        fs::copy(kept, &path).expect("it is there");
        let findings = check::check(&path).expect("a store");
        assert_eq!(findings.wrong, [] as [&str; 0], "{name}");
        assert_eq!(
            (findings.open_jobs, findings.ended_jobs),
            (open, ended),
            "{name}"
        );
        let (_journal, stored) = Journal::open(&path).expect("opens");
        let mut effects = Vec::new();
        let config = FleetConfig::default();
        let fleet = Fleet::restore(config, 1, stored, Rig::new().now(), &mut effects);
        let fleet = fleet.expect("is ours");
        let state = |name: &str| fleet.job(&id(name)).expect("it is there").state();
        assert_eq!(state("ended"), JobState::Succeeded);
        assert_eq!(state("refused"), JobState::Rejected);
        assert_eq!(state("runs"), JobState::Running);
        assert_eq!(state("waits"), JobState::Queued);
        let runs = fleet.job(&id("runs")).expect("it is there");
        assert_eq!(runs.commands.len(), 5_000, "what it has to do is there too");
        assert_eq!(fleet.nodes().count(), 2);
    }
}

#[test]
fn a_bit_that_has_changed_on_the_disk_is_noticed_and_the_file_left_as_it_is() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("fleet.redb");
    store(&path, &day());
    let (journal, whole) = Journal::open(&path).expect("opens");
    drop(journal);
    let bytes = fs::read(&path).expect("reads");
    let used: Vec<usize> = (0..bytes.len()).filter(|at| bytes[*at] != 0).collect();
    let mut noticed = 0;
    for round in 0..60 {
        // Spread over what is used, the first of it in the header.
        let at = used[round * used.len() / 60];
        let mut damaged = bytes.clone();
        damaged[at] ^= 1 << (round % 8);
        fs::write(&path, &damaged).expect("writes");
        match Journal::open(&path) {
            // A page that nobody needs, or a copy of what stands elsewhere.
            Ok((_, stored)) => assert_eq!(stored, whole, "byte {at}"),
            Err(error) => {
                noticed += 1;
                let words = error.to_string();
                assert!(words.contains("fleet.redb"), "{words}");
            }
        }
    }
    assert!(noticed > 0, "nothing was noticed at all");

    fs::write(&path, &bytes[..bytes.len() / 2]).expect("writes");
    let error = open_error(&path);
    assert!(matches!(error, JournalError::Damaged { .. }), "{error}");
    assert!(error.to_string().contains("fleet doctor"), "{error}");
    assert_eq!(fs::read(&path).expect("reads"), bytes[..bytes.len() / 2]);
}

#[test]
fn numbers_that_lead_nowhere_are_refused_in_words_by_gateway_and_doctor() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("fleet.redb");
    store(&path, &day());
    let bytes = fs::read(&path).expect("reads");
    let used: Vec<usize> = (0..bytes.len() - 4).filter(|at| bytes[*at] != 0).collect();
    for round in 0..80 {
        let mut damaged = bytes.clone();
        let at = used[round * used.len() / 80];
        damaged[at..at + 4].fill(0x7f);
        fs::write(&path, &damaged).expect("writes");
        // Whatever is found: in words, and by both.
        let refused = check::check(&path).is_err();
        match Journal::open(&path) {
            Ok(_) => {}
            Err(error) => {
                assert!(refused, "byte {at}: the doctor found nothing");
                assert!(error.to_string().contains("fleet.redb"), "{error}");
            }
        }
    }
}

#[test]
fn a_copy_is_the_store_of_one_instant_whatever_is_written_meanwhile() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("fleet.redb");
    let copy = folder.path().join("backup.redb");
    let mut rig = day();
    // More than one piece.
    let big = Write::Put {
        table: Table::Requests,
        key: "big".into(),
        value: vec![7; 2 * PIECE_BYTES],
    };
    rig.writes.push(big);
    store(&path, &rig);
    let (mut journal, before) = Journal::open(&path).expect("opens");
    let mut file = CopyFile::create(&copy).expect("created");
    let copier = journal.copier();
    let mut pieces = 0;
    copier
        .copy(|piece| {
            let later = Write::Put {
                table: Table::Jobs,
                key: format!("later-{pieces}"),
                value: b"x".to_vec(),
            };
            journal.commit(&[later]).expect("nobody is in its way");
            pieces += 1;
            let piece = Piece::decode(&piece.encode()).expect("what was sent");
            file.take(piece).expect("the next one");
            true
        })
        .expect("copied");
    assert!(pieces >= 3, "{pieces} pieces");
    let rows = file.finish().expect("whole");
    assert_eq!(
        rows as usize,
        before.jobs.len() + before.nodes.len() + before.requests.len()
    );
    let (_copy, copied) = Journal::open(&copy).expect("a store like any other");
    assert_eq!(copied, before);
    assert!(matches!(CopyFile::create(&copy), Err(CopyError::Exists(_))));
}

#[test]
fn a_copy_that_is_not_whole_gets_no_name() {
    let folder = tempfile::tempdir().expect("a folder");
    let copy = folder.path().join("backup.redb");
    let rows = |index| Piece {
        index,
        content: Content::Rows(vec![(1, "a".into(), b"x".to_vec())]),
    };
    let end = |index, row_count| Piece {
        index,
        content: Content::End {
            format: 1,
            row_count,
        },
    };
    let attempts: [(&[Piece], &str); 4] = [
        (&[rows(0)], "ends after 1 rows"),
        (&[rows(0), rows(2)], "piece 2 came in place of 1"),
        (&[rows(0), end(1, 2)], "1 rows of 2 came"),
        (&[end(0, 0), rows(1)], "piece 1 came in place of 1"),
    ];
    for (pieces, words) in attempts {
        let mut file = CopyFile::create(&copy).expect("created");
        let taken: Result<(), CopyError> = pieces
            .iter()
            .cloned()
            .try_for_each(|piece| file.take(piece));
        let error = taken
            .and_then(|()| file.finish().map(|_| ()))
            .expect_err("not whole");
        assert!(error.to_string().contains(words), "{error}");
        assert!(!copy.exists());
    }
}

#[test]
fn a_doctor_names_everything_that_is_wrong_and_changes_nothing() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("fleet.redb");
    let rig = day();
    store(&path, &rig);
    let healthy = check::check(&path).expect("a store");
    assert_eq!(healthy.wrong, [] as [&str; 0]);
    assert_eq!(
        (healthy.open_jobs, healthy.ended_jobs, healthy.nodes),
        (3, 2, 2)
    );

    let put = |table, key: &str| Write::Put {
        table,
        key: key.into(),
        value: b"{".to_vec(),
    };
    let (mut journal, _) = Journal::open(&path).expect("opens");
    assert!(matches!(
        check::check(&path),
        Err(JournalError::InUse { .. })
    ));
    let spoil = [
        put(Table::Jobs, "ended"),
        put(Table::Nodes, "left"),
        put(Table::Requests, "waits"),
    ];
    journal.commit(&spoil).expect("commits");
    drop(journal);
    let before = fs::read(&path).expect("reads");
    let findings = check::check(&path).expect("a store");
    assert_eq!(findings.wrong.len(), 3, "{:?}", findings.wrong);
    for (words, at) in [("job `ended`", 0), ("job `waits`", 1), ("node `left`", 2)] {
        assert!(findings.wrong[at].contains(words), "{:?}", findings.wrong);
    }
    assert_eq!(fs::read(&path).expect("reads"), before);
    assert_eq!(
        fs::read_dir(folder.path()).expect("reads").count(),
        1,
        "no copy is left"
    );
}

#[test]
fn a_store_that_is_mostly_waste_is_made_smaller_when_it_is_opened() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("fleet.redb");
    let (mut journal, _) = Journal::open(&path).expect("opens");
    let name = |index: u64| format!("job-{index}");
    let count = 2 * COMPACT_BYTES_MIN / (1 << 20);
    let put = |index| Write::Put {
        table: Table::Requests,
        key: name(index),
        value: vec![index as u8; 1 << 20],
    };
    let all: Vec<Write> = (0..count).map(put).collect();
    journal.commit(&all).expect("commits");
    let remove = |index| Write::Remove {
        table: Table::Requests,
        key: name(index),
    };
    // The last one holds the end of the file in its place.
    let last = count - 1;
    let removed: Vec<Write> = (0..last).map(remove).collect();
    journal.commit(&removed).expect("commits");
    drop(journal);
    let before = fs::metadata(&path).expect("there").len();
    let (_journal, stored) = Journal::open(&path).expect("opens");
    let after = fs::metadata(&path).expect("there").len();
    assert!(after < before / 2, "{before} bytes became {after}");
    assert_eq!(stored.requests, [(name(last), vec![last as u8; 1 << 20])]);
}

#[test]
fn jobs_go_when_they_are_old_but_a_wrong_clock_does_not_empty_the_history() {
    const KEEP_US: u64 = 3_600 * S;
    let config = FleetConfig {
        retention_us: KEEP_US,
        ..FleetConfig::default()
    };
    let count = KEPT_JOBS_MIN + 20;
    let mut rig = Rig::with(config.clone(), 1);
    rig.add("left");
    rig.run(10 * MS);
    for index in 0..count {
        let wrong = json!({"id": format!("job-{index}"), "commands": []});
        rig.put("left", &wrong);
    }
    assert_eq!(rig.fleet.jobs().count(), count);
    // A new start, a year later by its clock.
    let stored = rig.stored();
    let later = rig.now().plus_us(365 * 24 * KEEP_US);
    let mut effects = Vec::new();
    let fleet = Fleet::restore(config, 1, stored.clone(), later, &mut effects).expect("is ours");
    assert_eq!(fleet.jobs().count(), KEPT_JOBS_MIN);
    assert!(fleet.job(&id("job-0")).is_none(), "the oldest went");
    // And one with a clock that is wrong the other way.
    let mut effects = Vec::new();
    let early = keys::FleetMicros(1);
    let fleet = Fleet::restore(rig.config.clone(), 1, stored, early, &mut effects);
    assert_eq!(fleet.expect("is ours").jobs().count(), count);
}

#[test]
fn refused_jobs_do_not_push_out_what_was_done() {
    let config = FleetConfig {
        retention_jobs: 20,
        ..FleetConfig::default()
    };
    let mut rig = Rig::with(config, 1);
    rig.add("left");
    rig.run(10 * MS);
    let done = rig.accept("left", &moves("done", 1, 1_000));
    rig.finish(&done, 5 * S);
    for index in 0..100 {
        let wrong = json!({"id": format!("wrong-{index}"), "commands": []});
        rig.put("left", &wrong);
    }
    assert_eq!(rig.fleet.jobs().count(), 20);
    assert_eq!(rig.state(&done), JobState::Succeeded);
    assert!(rig.fleet.job(&done).is_some(), "the history is still there");
    assert!(rig.fleet.job(&id("wrong-0")).is_none());
    assert!(rig.fleet.job(&id("wrong-99")).is_some());
}

#[test]
fn an_empty_store_has_nothing_wrong() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("fleet.redb");
    let (journal, stored) = Journal::open(&path).expect("opens");
    assert_eq!(stored, Stored::default());
    drop(journal);
    let findings = check::check(&path).expect("a store");
    assert_eq!(
        (findings.open_jobs, findings.ended_jobs, findings.nodes),
        (0, 0, 0)
    );
    assert!(findings.wrong.is_empty() && !findings.cut_off);
}

#[test]
#[cfg(unix)]
fn a_store_and_its_copy_are_their_owners_alone_and_given_permissions_stay() {
    use std::os::unix::fs::PermissionsExt as _;
    let folder = tempfile::tempdir().expect("a folder");
    let mode = |path: &Path| {
        let found = std::fs::metadata(path).expect("there");
        found.permissions().mode() & 0o777
    };
    let store = folder.path().join("fleet.redb");
    drop(Journal::open(&store).expect("made"));
    assert_eq!(mode(&store), 0o600);
    let given = std::fs::Permissions::from_mode(0o640);
    std::fs::set_permissions(&store, given).expect("ours");
    let (journal, _) = Journal::open(&store).expect("opens");
    assert_eq!(mode(&store), 0o640);

    let copy = folder.path().join("monday.redb");
    let mut file = CopyFile::create(&copy).expect("created");
    assert_eq!(mode(&folder.path().join("monday.redb.part")), 0o600);
    let pieces = |piece| file.take(piece).is_ok();
    journal.copier().copy(pieces).expect("copied");
    file.finish().expect("whole");
    assert_eq!(mode(&copy), 0o600);
}
