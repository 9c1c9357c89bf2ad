//! Conversations that were recorded with a real router, played back without one.
//!
//! If our side differs, either the bytes changed on purpose (record again with
//! `examples/record.rs` and read the difference) or by accident.

mod script;

use std::collections::VecDeque;

use pico::{Session, SessionConfig};
use script::{NOW_US, SEED, act, batches, event_line, hex, set, unhex};

fn replay(name: &str, chunk_bytes: usize) {
    let path = format!("{}/tests/captures/{name}.txt", env!("CARGO_MANIFEST_DIR"));
    let text = std::fs::read_to_string(path).unwrap();
    let mut config = SessionConfig::default();
    for line in text.lines() {
        if let Some(setting) = line.strip_prefix("set ") {
            set(&mut config, setting);
        }
    }
    let mut session = Session::new(config, SEED);
    let mut asked = Vec::new();
    let mut ours = VecDeque::new();
    let mut events = VecDeque::new();
    session.handle_connected(NOW_US);
    for (index, line) in text.lines().enumerate() {
        let place = format!("{name}.txt:{}", index + 1);
        let (sign, rest) = line.split_once(' ').unwrap();
        let mut out = Vec::new();
        while session.poll_transmit(NOW_US, &mut out) > 0 {}
        ours.extend(batches(&mut out));
        assert!(out.is_empty(), "{place}: part of a batch");
        match sign {
            "do" => act(&mut session, &mut asked, rest),
            ">" => {
                let batch = ours.pop_front().unwrap_or_default();
                assert_eq!(hex(&batch), rest, "{place}: what we say");
            }
            "<" => {
                for chunk in unhex(rest).chunks(chunk_bytes) {
                    session.handle_bytes(NOW_US, chunk).unwrap();
                }
                while let Some(event) = event_line(&mut session, &mut asked) {
                    events.push_back(event);
                }
            }
            "!" => {
                while let Some(event) = event_line(&mut session, &mut asked) {
                    events.push_back(event);
                }
                assert_eq!(
                    events.pop_front().as_deref(),
                    Some(line),
                    "{place}: what happens"
                );
            }
            "#" | "set" | "router" => {}
            other => panic!("{place}: {other}"),
        }
    }
    assert!(ours.is_empty(), "{name}: we say more");
    assert!(events.is_empty(), "{name}: more happens");
    let counters = session.counters();
    assert_eq!(
        (counters.gaps, counters.stale, counters.unknown_ids),
        (0, 0, 0),
        "{name}"
    );
}

#[test]
fn the_recorded_conversations_are_held_again_byte_for_byte() {
    for name in ["qos", "flat", "password", "wrong_password"] {
        for chunk_bytes in [usize::MAX, 1, 2, 7] {
            replay(name, chunk_bytes);
        }
    }
}
