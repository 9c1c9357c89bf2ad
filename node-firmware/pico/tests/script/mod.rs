//! Conversations written down, one line each:
//!
//! ```text
//! set qos              part of the session's configuration
//! do subscribe a/*     what the application does
//! router put a/b x     what the router's side did (only the recorder does it)
//! > 1a 00 c1 …         a batch of ours
//! < 3a 00 e1 …         a batch of the router
//! ! Opened             an event
//! ```
//!
//! The recorder (`examples/record.rs`) writes such files against a real router; the test
//! `captures.rs` plays the router's part from them and expects ours byte for byte.
#![allow(dead_code, reason = "the recorder and the test use their parts")]

use pico::{
    Congestion, Credentials, Encoding, Event, GetOptions, InboundQuery, PutOptions, Session,
    SessionConfig,
};

/// The time at which all of it happens.
pub(crate) const NOW_US: u64 = 1_000_000;
/// Makes our bytes the same every time.
pub(crate) const SEED: u64 = 7;

/// Applies a `set` line.
pub(crate) fn set(config: &mut SessionConfig, line: &str) {
    let (what, value) = line.split_once(' ').unwrap_or((line, ""));
    match what {
        "qos" => config.qos = true,
        "flat" => config.qos = false,
        "user" => {
            let (user, password) = value.split_once(' ').unwrap();
            config.credentials = Some(Credentials {
                user: user.to_string(),
                password: password.to_string(),
            });
        }
        other => panic!("{other}"),
    }
}

/// Does a `do` line. `asked` are the questions of others that wait for answers.
pub(crate) fn act(session: &mut Session, asked: &mut Vec<InboundQuery>, line: &str) {
    let (verb, rest) = line.split_once(' ').unwrap_or((line, ""));
    let (key, value) = rest.split_once(' ').unwrap_or((rest, ""));
    let block = PutOptions {
        congestion: Congestion::Block,
        ..PutOptions::default()
    };
    match verb {
        "subscribe" => drop(session.declare_subscriber(key).unwrap()),
        "publish" => drop(session.declare_publisher(key).unwrap()),
        "offer" => drop(session.declare_queryable(key, false).unwrap()),
        "token" => drop(session.declare_token(key).unwrap()),
        "watch" => drop(session.declare_liveliness_subscriber(key).unwrap()),
        "put" => session.put(key, value.as_bytes(), &block).unwrap(),
        "put-long" => session
            .put(key, &vec![b'x'; value.parse().unwrap()], &block)
            .unwrap(),
        "delete" => session.delete(key, &block).unwrap(),
        "get" => drop(
            session
                .get(key, value, None, &GetOptions::default(), NOW_US)
                .unwrap(),
        ),
        "answer" => {
            let query = asked.pop().expect("somebody asked");
            session
                .reply(&query, key, value.as_bytes(), &block)
                .unwrap();
            session
                .reply_error(&query, b"no more", &Encoding::default())
                .unwrap();
            session.reply_final(&query).unwrap();
        }
        "close" => session.close(NOW_US),
        other => panic!("{other}"),
    }
}

/// The next event as a line.
pub(crate) fn event_line(session: &mut Session, asked: &mut Vec<InboundQuery>) -> Option<String> {
    let mut event = session.poll_event()?;
    let mut cut_bytes = 0;
    match &mut event {
        Event::Query { query, .. } => asked.push(*query),
        // The bytes stand above already.
        Event::Message { sample, .. } => {
            cut_bytes = sample.payload.len().saturating_sub(16);
            sample.payload.truncate(16);
        }
        _ => {}
    }
    Some(format!("! {event:?} and {cut_bytes} bytes more"))
}

/// Bytes as text.
pub(crate) fn hex(bytes: &[u8]) -> String {
    bytes.iter().map(|byte| format!("{byte:02x}")).collect()
}

/// Text as bytes.
pub(crate) fn unhex(text: &str) -> Vec<u8> {
    (0..text.len())
        .step_by(2)
        .map(|at| u8::from_str_radix(&text[at..at + 2], 16).unwrap())
        .collect()
}

/// Cuts whole batches, prefix included, off the front of a stream.
pub(crate) fn batches(stream: &mut Vec<u8>) -> Vec<Vec<u8>> {
    let mut batches = Vec::new();
    while stream.len() >= 2 {
        let length = 2 + usize::from(u16::from_le_bytes([stream[0], stream[1]]));
        if stream.len() < length {
            break;
        }
        batches.push(stream.drain(..length).collect());
    }
    batches
}
