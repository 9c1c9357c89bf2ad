//! Random input must not panic, hang or grow: mutated conversations, and bytes from nowhere.
//!
//! Each case has its own seed, which a failure prints. `PICO_FUZZ_SEED` runs one case again,
//! `PICO_FUZZ_CASES` runs more of them.

mod peer;
mod script;

use peer::{
    Grants, Marks, Peer, declare_final, declare_key, declare_subscriber, declare_token, key,
    peer_key, push, query, reply, reply_final,
};
use pico::{
    Credentials, Event, GetOptions, InboundQuery, Priority, PutOptions, Session, SessionConfig,
    limits,
};
use script::{batches, unhex};

/// Cases of a normal run: one to two seconds in a debug build.
const CASES: u64 = 1000;

struct Random(u64);

impl Random {
    fn next(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        z ^ (z >> 31)
    }

    fn below(&mut self, bound: usize) -> usize {
        (self.next() % bound.max(1) as u64) as usize
    }

    fn one_in(&mut self, count: usize) -> bool {
        self.below(count) == 0
    }
}

/// Says which case was running when it panicked.
struct Case(u64);

impl Drop for Case {
    fn drop(&mut self) {
        if std::thread::panicking() {
            eprintln!("this was PICO_FUZZ_SEED={}", self.0);
        }
    }
}

fn cases(test: fn(&mut Random)) {
    let number = |name: &str| {
        std::env::var(name)
            .ok()
            .map(|text| text.parse::<u64>().unwrap())
    };
    let seeds = match number("PICO_FUZZ_SEED") {
        Some(seed) => seed..seed + 1,
        None => 0..number("PICO_FUZZ_CASES").unwrap_or(CASES),
    };
    for seed in seeds {
        let _case = Case(seed);
        test(&mut Random(seed));
    }
}

/// What routers said in the recorded conversations, by conversation.
fn recorded() -> Vec<Vec<Vec<u8>>> {
    let texts = [
        include_str!("captures/qos.txt"),
        include_str!("captures/flat.txt"),
        include_str!("captures/password.txt"),
    ];
    let theirs = |text: &str| {
        text.lines()
            .filter_map(|l| l.strip_prefix("< "))
            .map(unhex)
            .collect()
    };
    texts.into_iter().map(theirs).collect()
}

fn mutate(random: &mut Random, bytes: &mut Vec<u8>) {
    if bytes.is_empty() {
        return;
    }
    for _ in 0..=random.below(3) {
        let at = random
            .below(bytes.len().max(1))
            .min(bytes.len().saturating_sub(1));
        match random.below(6) {
            0 => bytes[at] ^= 1 << random.below(8),
            1 => bytes[at] = random.next() as u8,
            2 => bytes.insert(at, random.next() as u8),
            3 if bytes.len() > 1 => drop(bytes.remove(at)),
            4 => bytes.truncate(at.max(1)),
            _ => {
                let copy = bytes[at..].to_vec();
                bytes.extend(copy);
            }
        }
    }
}

/// A batch with a true length prefix, so that what is inside is reached.
fn framed(mut batch: Vec<u8>) -> Vec<u8> {
    batch.truncate(usize::from(u16::MAX));
    let mut bytes = (batch.len() as u16).to_le_bytes().to_vec();
    bytes.append(&mut batch);
    bytes
}

fn session(random: &mut Random) -> Session {
    let config = SessionConfig {
        qos: !random.one_in(4),
        batch_bytes: [256, 2048, u16::MAX][random.below(3)],
        credentials: random.one_in(4).then(|| Credentials {
            user: "n1".to_string(),
            password: "secret".to_string(),
        }),
        ..SessionConfig::default()
    };
    let mut session = Session::new(config, random.next());
    session.declare_subscriber("fleet/node/left/*").unwrap();
    session.declare_subscriber("**").unwrap();
    session.declare_publisher("fleet/node/left/status").unwrap();
    session.declare_queryable("ask/*", true).unwrap();
    session.declare_liveliness_subscriber("alive/*").unwrap();
    session
}

/// Uses the session at random and checks what must always hold.
fn use_at_random(
    random: &mut Random,
    session: &mut Session,
    now_us: u64,
    asked: &mut Vec<InboundQuery>,
) {
    // Whatever they answer is right; that they answer is what counts.
    match random.below(12) {
        0 => {
            let payload = vec![1; random.below(5000)];
            let _ = session.put("a/b", &payload, &PutOptions::default());
        }
        1 => {
            let options = PutOptions {
                priority: Priority::RealTime,
                ..PutOptions::default()
            };
            let _ = session.put("stop", b"now", &options);
        }
        2 => {
            let _ = session.get("a", "", None, &GetOptions::default(), now_us);
        }
        3 => {
            if let Some(query) = asked.pop() {
                let _ = session.reply(&query, "ask/x", b"yes", &PutOptions::default());
                let _ = session.reply_final(&query);
            }
        }
        4 => {
            if let Ok(id) = session.declare_subscriber("more/**") {
                let _ = session.undeclare_subscriber(id);
            }
        }
        5 => {
            let mut out = Vec::new();
            session.poll_transmit(now_us, &mut out);
            assert!(out.len() <= limits::TRANSMIT_BYTES + 2 * usize::from(u16::MAX));
            batches(&mut out);
            assert!(out.is_empty(), "only whole batches");
        }
        6 => session.handle_timeout(now_us),
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
    if !session.is_open() {
        assert!(session.put("a", b"", &PutOptions::default()).is_err());
    }
}

/// Feeds a stream in random chunks while the session is used. Returns whether it was all taken.
fn feed(random: &mut Random, session: &mut Session, stream: &[u8]) -> bool {
    let mut asked = Vec::new();
    let mut now_us = 1_000_000;
    let mut rest = stream;
    while !rest.is_empty() {
        let (chunk, later) = rest.split_at(1 + random.below(rest.len().min(400)));
        rest = later;
        if session.handle_bytes(now_us, chunk).is_err() {
            assert!(!session.is_open());
            return false;
        }
        now_us += random.below(100_000) as u64;
        use_at_random(random, session, now_us, &mut asked);
    }
    true
}

/// The session can be used again whatever happened.
fn recover(session: &mut Session, now_us: u64) {
    session.handle_disconnected(now_us);
    while session.poll_event().is_some() {}
    assert!(!session.is_open());
    let mut peer = Peer::new(Grants {
        user: session
            .config()
            .credentials
            .as_ref()
            .map(|_| ("n1", "secret")),
        ..Grants::default()
    });
    session.handle_connected(now_us);
    for _ in 0..4 {
        let mut out = Vec::new();
        session.poll_transmit(now_us, &mut out);
        peer.hear(&out);
        session.handle_bytes(now_us, &peer.take_said()).unwrap();
    }
    assert!(session.is_open());
    assert!(peer.heard.len() >= 8, "everything is declared again");
}

#[test]
fn recorded_conversations_with_random_damage_do_no_harm() {
    cases(|random| {
        let recorded = recorded();
        let conversation = &recorded[random.below(recorded.len())];
        let mut session = session(random);
        session.handle_connected(1_000_000);
        let mut stream = Vec::new();
        for batch in conversation {
            let mut batch = batch.clone();
            if random.one_in(conversation.len()) {
                if random.one_in(3) {
                    mutate(random, &mut batch);
                } else {
                    let mut inside = batch[2..].to_vec();
                    mutate(random, &mut inside);
                    batch = framed(inside);
                }
            }
            if random.one_in(20) {
                stream.extend_from_slice(&batch);
            }
            if !random.one_in(50) {
                stream.extend(batch);
            }
        }
        feed(random, &mut session, &stream);
        recover(&mut session, 1_000_000_000);
    });
}

#[test]
fn an_open_session_survives_whatever_a_router_might_say() {
    cases(|random| {
        let mut session = session(random);
        let mut peer = Peer::new(Grants {
            user: session
                .config()
                .credentials
                .as_ref()
                .map(|_| ("n1", "secret")),
            ..Grants::default()
        });
        session.handle_connected(1_000_000);
        for _ in 0..3 {
            let mut out = Vec::new();
            session.poll_transmit(1_000_000, &mut out);
            peer.hear(&out);
            session.handle_bytes(1_000_000, &peer.take_said()).unwrap();
        }
        assert!(session.is_open());
        let mut stream = Vec::new();
        for _ in 0..random.below(12) {
            let id = random.below(4) as u32;
            let name = ["a/b", "fleet/node/*/x", "ask/x", "alive/y", "**", "//"][random.below(6)];
            let payload = vec![1; random.below(300)];
            let message = match random.below(10) {
                0 => push(key(name), &payload),
                1 => push(peer_key(id as u16, "/x"), &payload),
                2 => declare_key(id as u16, key(name)),
                3 => declare_subscriber(Some(id), id, key(name)),
                4 => declare_token(random.one_in(2).then_some(id), id, key(name)),
                5 => declare_final(id),
                6 => query(id, key(name)),
                7 => reply(id, key(name), &payload),
                8 => reply_final(id),
                _ => peer::undeclare_token(id),
            };
            match random.below(3) {
                0 => peer.say_fragmented(message, 1 + random.below(100)),
                1 => peer.say([message]),
                _ => {
                    let marks = Marks {
                        first: random.one_in(2),
                        more: random.one_in(2),
                        drop: random.one_in(4),
                    };
                    let sn = 100 + random.below(10) as u32;
                    peer.say_fragment(sn, marks, &peer::bytes(message));
                }
            }
            for mut batch in batches(&mut peer.take_said()) {
                if random.one_in(6) {
                    let mut inside = batch[2..].to_vec();
                    mutate(random, &mut inside);
                    batch = framed(inside);
                }
                stream.extend(batch);
            }
        }
        feed(random, &mut session, &stream);
        recover(&mut session, 1_000_000_000);
    });
}

#[test]
fn bytes_from_nowhere_do_no_harm() {
    cases(|random| {
        let mut session = session(random);
        session.handle_connected(1_000_000);
        let bytes = (0..random.below(200))
            .map(|_| random.next() as u8)
            .collect();
        let stream = if random.one_in(3) {
            bytes
        } else {
            framed(bytes)
        };
        feed(random, &mut session, &stream);
        recover(&mut session, 1_000_000_000);
    });
}
