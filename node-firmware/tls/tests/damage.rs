//! A stream that is cut, changed, repeated or replaced on its way to the node. Whatever happens,
//! nothing panics, and what the session gets is the beginning of what the router said.

mod peer;

use peer::{Ca, Router, YEARS, received};
use rustls::{ServerConfig, version::TLS13};
use std::sync::Arc;
use tls::{TlsConfig, TlsError, TlsLink};

/// What the router says when the link is open, in two records.
const WORDS: [&[u8]; 2] = [b"an order to the node", b"and another"];

struct Wire {
    config: TlsConfig,
    router: Arc<ServerConfig>,
}

/// How a conversation ended.
struct Outcome {
    /// Bytes that came from the router, before anything was done to them.
    bytes: usize,
    result: Result<(), TlsError>,
    opened: bool,
    heard: Vec<u8>,
}

impl Wire {
    fn new() -> Self {
        let ca = Ca::new();
        Self {
            config: TlsConfig::new(&ca.authority(), "plant", None).expect("a name"),
            router: ca.router(&["plant"], YEARS, &[&TLS13]),
        }
    }

    /// Lets them talk; `damage` sees each flight with the place of its first byte.
    fn talk(&self, mut damage: impl FnMut(usize, &mut Vec<u8>)) -> Outcome {
        let mut link = TlsLink::new(&self.config).expect("random numbers");
        let mut router = Router::new(&self.router);
        let mut outcome = Outcome {
            bytes: 0,
            result: Ok(()),
            opened: false,
            heard: Vec::new(),
        };
        let mut words = WORDS.iter();
        loop {
            let mut out = Vec::new();
            link.poll_transmit(&mut out);
            router.handle_bytes(&out);
            let mut back = router.transmit();
            if back.is_empty() && !router.0.is_handshaking() {
                back = words.next().map_or(back, |words| router.say(words));
            }
            if out.is_empty() && back.is_empty() {
                break;
            }
            let begin = outcome.bytes;
            outcome.bytes += back.len();
            damage(begin, &mut back);
            outcome.result = link.handle_bytes(&back);
            outcome.heard.extend(received(&mut link));
            outcome.opened |= link.is_open();
            if outcome.result.is_err() {
                break;
            }
        }
        assert!(WORDS.concat().starts_with(&outcome.heard));
        assert!(outcome.opened || outcome.heard.is_empty());
        outcome
    }
}

#[test]
fn a_bit_that_is_turned_anywhere_gives_the_session_nothing_false() {
    let wire = Wire::new();
    let whole = wire.talk(|_, _| {});
    assert_eq!(whole.heard, WORDS.concat());
    let mut refused = 0;
    for place in 0..whole.bytes {
        let outcome = wire.talk(|begin, flight| {
            let at = place.wrapping_sub(begin);
            if let Some(byte) = flight.get_mut(at) {
                *byte ^= 1 << (place % 8);
            }
        });
        if outcome.result.is_err() {
            refused += 1;
        } else {
            // Not said to be wrong: then it waits for more, or the byte does not matter (the
            // version in the header of a record, RFC 8446, 5.1).
            let all = outcome.heard == WORDS.concat();
            assert!(all || outcome.heard.len() < WORDS.concat().len());
        }
    }
    assert!(
        refused * 100 > whole.bytes * 95,
        "{refused} of {}",
        whole.bytes
    );
}

#[test]
fn a_stream_that_is_cut_anywhere_opens_nothing_by_half() {
    let wire = Wire::new();
    let whole = wire.talk(|_, _| {}).bytes;
    for place in 0..whole {
        let outcome = wire.talk(|begin, flight| flight.truncate(place.saturating_sub(begin)));
        assert_eq!(outcome.result, Ok(()), "cut at {place}: it waits");
    }
}

/// splitmix64.
struct Random(u64);

impl Random {
    fn below(&mut self, end: usize) -> usize {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut mixed = self.0;
        mixed = (mixed ^ (mixed >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        mixed = (mixed ^ (mixed >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        (mixed ^ (mixed >> 31)) as usize % end.max(1)
    }
}

#[test]
fn pieces_that_are_lost_repeated_or_made_up_give_the_session_nothing_false() {
    let wire = Wire::new();
    for seed in 0..1_000 {
        let mut random = Random(seed);
        let outcome = std::panic::catch_unwind(std::panic::AssertUnwindSafe(|| {
            wire.talk(|_, flight| {
                if random.below(3) > 0 {
                    return;
                }
                let from = random.below(flight.len());
                let to = from + random.below(flight.len() - from + 1);
                match random.below(4) {
                    0 => drop(flight.drain(from..to)),
                    1 => {
                        let twice = flight[from..to].to_vec();
                        flight.splice(to..to, twice);
                    }
                    2 => {
                        let noise: Vec<u8> = (0..random.below(400))
                            .map(|_| random.below(256) as u8)
                            .collect();
                        flight.splice(from..from, noise);
                    }
                    _ => flight[from..to].reverse(),
                }
            })
        }));
        assert!(outcome.is_ok(), "seed {seed}");
    }
}
