//! A zenoh session, whatever the router says after a true handshake and whatever the application
//! does meanwhile: no panic, bounded memory, whole batches, and a session that opens again.
//!
//! The first byte is about the session, then comes one deed after the other: an application's verb,
//! or a batch of so many bytes.

use super::Input;
use pico::{
    Congestion, Event, GetOptions, InboundQuery, Priority, PutOptions, Session, SessionConfig,
    limits,
};

/// What a router of zenoh 1.10.2 answered: InitAck and OpenAck, with priorities.
const HANDSHAKE: [&str; 2] = [
    "4b00e109f0ce1d329ca721eaf1bc1943526aab93800a00083130f3207a16f8fbf193a032f57d24931f379693f4c186b7a87a150f68ee2054bdb28eb7a0a7d97d8af653b2ea8e697b062c812701",
    "0600620aafd1fc70",
];

/// The first sequence number that this router uses.
const INITIAL_SN: u8 = 0xaf;

fn unhex(text: &str) -> Vec<u8> {
    let digits = (0..text.len()).step_by(2);
    let byte = |at| u8::from_str_radix(&text[at..at + 2], 16).expect("hexadecimal");
    digits.map(byte).collect()
}

fn handshake(session: &mut Session, now_us: u64) {
    session.handle_connected(now_us);
    for answer in HANDSHAKE {
        session.poll_transmit(now_us, &mut Vec::new());
        session
            .handle_bytes(now_us, &unhex(answer))
            .expect("a true handshake");
    }
    assert!(session.is_open());
}

/// See the module.
pub fn check(data: &[u8]) {
    let mut input = Input(data);
    let about = input.byte();
    let config = SessionConfig {
        batch_bytes: [2048, u16::MAX][usize::from(about & 1)],
        ..SessionConfig::default()
    };
    let mut session = Session::new(config, 7);
    session
        .declare_subscriber("fleet/node/left/*")
        .expect("room");
    session.declare_subscriber("**").expect("room");
    let publisher = session
        .declare_publisher("fleet/node/left/status")
        .expect("room");
    session.declare_queryable("ask/*", true).expect("room");
    session
        .declare_liveliness_subscriber("alive/*")
        .expect("room");
    let mut now_us = 1_000_000;
    if about & 4 == 0 {
        handshake(&mut session, now_us);
    } else {
        session.handle_connected(now_us);
    }
    let mut asked: Vec<InboundQuery> = Vec::new();
    while !input.is_empty() {
        let deed = input.byte();
        match deed % 16 {
            0..=5 => {
                // A batch with a true length, as a router that is one of us might send.
                let count = usize::from(input.byte()) + if deed & 0x80 == 0 { 0 } else { 256 };
                let batch = input.bytes(count);
                let mut bytes = (batch.len() as u16).to_le_bytes().to_vec();
                bytes.extend_from_slice(batch);
                if session.handle_bytes(now_us, &bytes).is_err() {
                    assert!(!session.is_open());
                    break;
                }
            }
            6 => {
                let count = usize::from(input.byte());
                if session.handle_bytes(now_us, input.bytes(count)).is_err() {
                    break;
                }
            }
            7 => {
                let options = PutOptions {
                    priority: if deed & 0x10 == 0 {
                        Priority::Data
                    } else {
                        Priority::RealTime
                    },
                    congestion: if deed & 0x20 == 0 {
                        Congestion::Drop
                    } else {
                        Congestion::Block
                    },
                    express: deed & 0x40 != 0,
                    ..PutOptions::default()
                };
                let payload = vec![1; usize::from(input.short()) % 5_000];
                // Whatever it answers is right.
                let _ = session.put(publisher, &payload, &options);
            }
            8 => {
                let _ = session.get("a/*", "x=1", None, &GetOptions::default(), now_us);
            }
            9 => {
                if let Some(query) = asked.pop() {
                    let _ = session.reply(&query, "ask/x", b"yes", &PutOptions::default());
                    let _ = session.reply_final(&query);
                }
            }
            10 => {
                if let Ok(id) = session.declare_subscriber("more/**")
                    && deed & 0x80 == 0
                {
                    let _ = session.undeclare_subscriber(id);
                }
            }
            11 => {
                let mut out = Vec::new();
                session.poll_transmit(now_us, &mut out);
                whole_batches(&out);
            }
            12 => {
                now_us += u64::from(input.byte()) * 100_000;
                session.handle_timeout(now_us);
            }
            13 if deed & 0xf0 == 0xf0 => session.close(now_us),
            _ => {
                while let Some(event) = session.poll_event() {
                    match event {
                        Event::Query { query, .. } => asked.push(query),
                        Event::Message { sample, .. } => {
                            assert!(sample.payload.len() <= usize::from(u16::MAX));
                        }
                        _ => {}
                    }
                }
            }
        }
    }
    let finished = session.is_finished() || !session.wants_connection(u64::MAX);
    session.handle_disconnected(now_us);
    while session.poll_event().is_some() {}
    assert!(!session.is_open());
    if !finished {
        handshake(&mut session, now_us + 100_000_000);
    }
}

fn whole_batches(mut out: &[u8]) {
    assert!(out.len() <= limits::TRANSMIT_BYTES + 2 * usize::from(u16::MAX));
    while let Some((length, rest)) = out.split_first_chunk::<2>() {
        let bytes = usize::from(u16::from_le_bytes(*length));
        assert!(bytes > 0 && bytes <= rest.len(), "only whole batches");
        out = &rest[bytes..];
    }
    assert!(out.is_empty(), "only whole batches");
}

/// What the recorded router said: declarations, tokens, values, a question.
pub fn seeds() -> Vec<Vec<u8>> {
    let frame = |sn: u8, body: &[u8]| {
        let sn = INITIAL_SN.wrapping_add(sn);
        let mut batch = vec![0x25, sn, 0xd1, 0xfc, 0x70];
        batch.extend_from_slice(body);
        [&[0, batch.len() as u8][..], &batch].concat()
    };
    let said = [
        "a5b0d1fc7031009e21082004000c616c6976652f726f75746572be032108460204be0321081a",
        "a5b2d1fc7031009e2108020102",
    ];
    let mut recorded = vec![1];
    for batch in said.map(unhex) {
        recorded.extend([0, batch.len() as u8]);
        recorded.extend(batch);
        recorded.push(14);
    }
    // A value under a key in full: push, key of 3 bytes, put, 2 bytes.
    let put = [&[0x3d, 0, 3][..], b"a/b", &[0x01, 2, b'h', b'i']].concat();
    let mut values = vec![1];
    values.extend(frame(0, &put));
    values.extend([7, 100, 0, 11, 14, 12, 30, 11]);
    vec![
        recorded,
        values,
        vec![5, 6, 8, 1, 2, 3, 4, 5, 6, 7, 8],
        vec![0, 8, 11, 12, 255, 14],
    ]
}
