//! Where is the router? Asked of everybody in the network by UDP multicast, as any zenoh client does.
//!
//! ```text
//!   we ── SCOUT, who is a router? ──▶ 224.0.0.224:7446      after 0, 1, 3, 7, 15, 23 … s
//!   router ── HELLO, its locators ──▶ the port that asked
//!   Scouting::handle_datagram ──▶ where to connect by TCP
//! ```
//!
//! Owns when to ask again and which of the locators is meant for us; no socket, no clock. Absent on
//! purpose: joining the group, since only answers are wanted, and they come to the asking port; and
//! names in locators, which a router's answer does not have.
//!
//! Whoever answers first is believed, as in zenoh: scouting is for networks whose members are trusted,
//! or for nodes that take only what is signed. A password is safe even then: it never crosses the wire.

use crate::random::Random;
use alloc::vec::Vec;
use core::net::{IpAddr, Ipv4Addr, SocketAddr, SocketAddrV4};
use zenoh_codec::{RCodec, WCodec, Zenoh080};
use zenoh_protocol::{
    VERSION,
    core::{WhatAmI, whatami::WhatAmIMatcher},
    scouting::{HelloProto, Scout, ScoutingBody, ScoutingMessage},
};

/// Where zenoh's nodes listen for scouts.
pub const GROUP: SocketAddrV4 = SocketAddrV4::new(Ipv4Addr::new(224, 0, 0, 224), 7446);

/// Longest answer that is looked at, bytes: a datagram that no network cuts into pieces.
pub const HELLO_BYTES_MAX: usize = 1_472;

/// From the first question to the second, µs; the time doubles from then on.
const FIRST_US: u64 = 1_000_000;

/// Longest time from one question to the next, µs. Both are those of zenoh's own clients.
const LONGEST_US: u64 = 8_000_000;

/// A search for a router.
#[derive(Debug)]
pub struct Scouting {
    random: Random,
    due_us: u64,
    wait_us: u64,
}

impl Scouting {
    /// Begins a search. `seed` is random on every start, so that many nodes whose power comes back at
    /// the same moment do not ask in step.
    pub fn new(seed: u64, now_us: u64) -> Self {
        Self {
            random: Random::new(seed),
            due_us: now_us,
            wait_us: FIRST_US,
        }
    }

    /// Returns when to ask next.
    pub fn poll_timeout(&self) -> u64 {
        self.due_us
    }

    /// Gives the question, to be sent to the group, if it is time.
    pub fn poll_transmit(&mut self, now_us: u64) -> Option<Vec<u8>> {
        if now_us < self.due_us {
            return None;
        }
        // Up to a quarter less.
        let jitter_us = self.random.below(self.wait_us / 4);
        self.due_us = now_us + self.wait_us - jitter_us;
        self.wait_us = (2 * self.wait_us).min(LONGEST_US);
        Some(question())
    }

    /// Returns where the router listens by TCP, if the datagram is the answer of one; `from` is who has
    /// sent it.
    pub fn handle_datagram(&self, bytes: &[u8], from: IpAddr) -> Option<SocketAddr> {
        if bytes.len() > HELLO_BYTES_MAX {
            return None;
        }
        let mut reader = bytes;
        let message: ScoutingMessage = Zenoh080::new().read(&mut reader).ok()?;
        match message.body {
            ScoutingBody::Hello(hello) if hello.whatami == WhatAmI::Router => {
                best_locator(&hello, from)
            }
            _ => None,
        }
    }
}

fn question() -> Vec<u8> {
    let scout = Scout {
        version: VERSION,
        what: WhatAmIMatcher::empty().router(),
        // Only who would answer itself needs one.
        zid: None,
    };
    let mut bytes = Vec::new();
    Zenoh080::new()
        .write(&mut bytes, &ScoutingMessage::from(scout))
        .expect("a vector takes three bytes");
    bytes
}

/// Returns the locator that leads to the router from here: the one with the address that the answer
/// came from; else the first of IPv4, else the first. What means the router itself, or everybody,
/// counts for nobody else.
fn best_locator(hello: &HelloProto, from: IpAddr) -> Option<SocketAddr> {
    let addresses = hello.locators.iter().filter_map(|locator| {
        let address = locator.as_str().strip_prefix("tcp/")?;
        // Behind `?` stands what else there is to know about it.
        let address = address.split('?').next()?;
        address.parse::<SocketAddr>().ok()
    });
    addresses
        .filter(|address| {
            let ip = address.ip();
            address.port() != 0
                && !ip.is_unspecified()
                && !ip.is_multicast()
                && (!ip.is_loopback() || from.is_loopback())
        })
        .min_by_key(|address| match address.ip() {
            ip if ip == from => 0,
            IpAddr::V4(_) => 1,
            IpAddr::V6(_) => 2,
        })
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::{string::ToString, vec};
    use zenoh_protocol::core::{Locator, ZenohIdProto};

    const ROUTER: IpAddr = IpAddr::V4(Ipv4Addr::new(10, 0, 0, 2));

    fn hello(whatami: WhatAmI, locators: &[&str]) -> Vec<u8> {
        let locators = locators
            .iter()
            .map(|locator| Locator::try_from(locator.to_string()).expect("legal"))
            .collect();
        let hello = HelloProto {
            version: VERSION,
            whatami,
            zid: ZenohIdProto::try_from([7; 16].as_slice()).expect("not 0"),
            locators,
        };
        let mut bytes = vec![];
        let message = ScoutingMessage::from(hello);
        Zenoh080::new().write(&mut bytes, &message).expect("room");
        bytes
    }

    fn found(locators: &[&str]) -> Option<vec::Vec<u8>> {
        let found = Scouting::new(1, 0).handle_datagram(&hello(WhatAmI::Router, locators), ROUTER);
        found.map(|address| address.to_string().into_bytes())
    }

    #[test]
    fn it_asks_at_once_and_then_less_and_less_often() {
        let mut scouting = Scouting::new(5, 100);
        let mut asked = vec![];
        for _ in 0..8 {
            let now_us = scouting.poll_timeout();
            assert!(now_us == 100 || scouting.poll_transmit(now_us - 1).is_none());
            assert_eq!(scouting.poll_transmit(now_us), Some(question()));
            asked.push(now_us);
        }
        assert_eq!(asked[0], 100);
        let waits = asked.windows(2).map(|pair| pair[1] - pair[0]);
        for (wait_us, seconds) in waits.zip([1, 2, 4, 8, 8, 8, 8]) {
            let most_us = seconds * 1_000_000;
            assert!((most_us * 3 / 4..=most_us).contains(&wait_us), "{wait_us}");
        }
    }

    #[test]
    fn the_question_has_the_bytes_of_the_protocol() {
        // SCOUT, version 9, routers only, no id.
        assert_eq!(question(), [0x01, 0x09, 0x01]);
    }

    #[test]
    fn the_locator_that_leads_here_is_taken() {
        for (locators, expected) in [
            (&["tcp/10.0.0.2:7447"][..], Some("10.0.0.2:7447")),
            (
                &[
                    "tcp/127.0.0.1:7447",
                    "tcp/192.168.1.9:7447",
                    "tcp/10.0.0.2:7448",
                ],
                Some("10.0.0.2:7448"),
            ),
            (
                &[
                    "tcp/[fe80::1]:7447",
                    "tcp/0.0.0.0:7447",
                    "tcp/192.168.1.9:7447",
                ],
                Some("192.168.1.9:7447"),
            ),
            (&["tcp/[2001:db8::1]:7447"], Some("[2001:db8::1]:7447")),
            (&["tls/10.0.0.2:7447", "udp/10.0.0.2:7447"], None),
            (&["tcp/plant.local:7447"], None),
            (&["tcp/127.0.0.1:7447"], None),
            (&[], None),
        ] {
            let expected = expected.map(|text| text.as_bytes().to_vec());
            assert_eq!(found(locators), expected, "{locators:?}");
        }
    }

    #[test]
    fn only_routers_count_and_no_other_bytes_do() {
        let scouting = Scouting::new(1, 0);
        let locators = ["tcp/10.0.0.2:7447"];
        for other in [WhatAmI::Peer, WhatAmI::Client] {
            let bytes = hello(other, &locators);
            assert_eq!(scouting.handle_datagram(&bytes, ROUTER), None);
        }
        let whole = hello(WhatAmI::Router, &locators);
        for end in 0..whole.len() {
            assert_eq!(scouting.handle_datagram(&whole[..end], ROUTER), None);
        }
        assert_eq!(scouting.handle_datagram(&question(), ROUTER), None);
        let mut random = Random::new(9);
        for _ in 0..if cfg!(miri) { 20 } else { 20_000 } {
            let count = random.below(64) as usize;
            let mut bytes = vec![0_u8; count];
            bytes.fill_with(|| random.next_u64() as u8);
            let _ = scouting.handle_datagram(&bytes, ROUTER);
            // And an answer of which one byte is another.
            let mut changed = whole.clone();
            let at = random.below(whole.len() as u64) as usize;
            changed[at] = random.next_u64() as u8;
            let _ = scouting.handle_datagram(&changed, ROUTER);
        }
        let long = vec![0x02; HELLO_BYTES_MAX + 1];
        assert_eq!(scouting.handle_datagram(&long, ROUTER), None);
    }
}
