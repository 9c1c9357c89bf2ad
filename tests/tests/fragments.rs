//! Somebody who has a link and sends fragments of a message without an end: the router keeps no more of
//! them than the largest message may have, and others are served. The bytes are written by hand, since no
//! client does this.
#![cfg(target_os = "linux")]

use gateway::{
    config::{GatewayConfig, MESSAGE_BYTES_MAX},
    service::Service,
};
use std::{
    io::{Read, Write},
    net::TcpStream,
};
use tests::field;

/// Lowest bits of a transport message's header: what it is.
const INIT: u8 = 0x01;
const OPEN: u8 = 0x02;
const CLOSE: u8 = 0x03;
const FRAGMENT: u8 = 0x06;

/// The whole session is closed, not one link of it.
const CLOSE_SESSION: u8 = 0x20;
/// The lease is in seconds.
const OPEN_SECONDS: u8 = 0x40;
/// An answer.
const ACK: u8 = 0x20;
/// Sizes follow.
const INIT_SIZES: u8 = 0x40;
/// Reliable, and more of it follows.
const MORE: u8 = 0x20 | 0x40;

/// Bytes of the message in each fragment: less than any router's batch has room for.
const PIECE: usize = 30_000;

/// Each piece is kept in the batch in which it came, which takes as much memory as the longest one.
const BATCH: usize = 65_536;

/// Writes a number as zenoh does, seven bits in a byte.
fn number(mut value: u64, out: &mut Vec<u8>) {
    while value > 0x7f {
        out.push(value as u8 | 0x80);
        value >>= 7;
    }
    out.push(value as u8);
}

/// A client's link, by hand.
struct Link {
    stream: TcpStream,
    next_sn: u64,
}

impl Link {
    fn open(locator: &str) -> Self {
        let address = locator.strip_prefix("tcp/").expect("plain TCP");
        let stream = TcpStream::connect(address).expect("it listens");
        stream
            .set_read_timeout(Some(field::PATIENCE))
            .expect("a time");
        let mut link = Self { stream, next_sn: 0 };
        // Version 9, a name of four bytes, a client.
        link.send(&[INIT, 9, 0x32, 7, 7, 7, 7]);
        let answer = link.receive();
        assert_eq!(answer[0] & (ACK | 0x1f), INIT | ACK, "{answer:02x?}");
        let name = usize::from(answer[2] >> 4) + 1;
        let sizes = if answer[0] & INIT_SIZES == 0 { 0 } else { 3 };
        let cookie = &answer[3 + name + sizes..];
        let cookie = &cookie[..=usize::from(cookie[0])];
        link.send(&[&[OPEN | OPEN_SECONDS, 60, 0], cookie].concat());
        let answer = link.receive();
        assert_eq!(answer[0] & (ACK | 0x1f), OPEN | ACK, "{answer:02x?}");
        link
    }

    fn send(&mut self, message: &[u8]) {
        let length = u16::try_from(message.len()).expect("a batch");
        let batch = [&length.to_le_bytes(), message].concat();
        self.stream.write_all(&batch).expect("it reads");
    }

    fn receive(&mut self) -> Vec<u8> {
        let mut length = [0; 2];
        self.stream.read_exact(&mut length).expect("an answer");
        let mut message = vec![0; usize::from(u16::from_le_bytes(length))];
        self.stream.read_exact(&mut message).expect("an answer");
        message
    }

    /// Sends the next piece of a message that never ends.
    fn send_piece(&mut self, bytes: usize) {
        let mut message = vec![FRAGMENT | MORE];
        number(self.next_sn, &mut message);
        self.next_sn += 1;
        message.resize(message.len() + bytes, 0);
        self.send(&message);
    }

    /// Says goodbye, and waits until the other side has read it all.
    fn close(mut self) {
        self.send(&[CLOSE | CLOSE_SESSION, 0]);
        let mut rest = Vec::new();
        // However it ends: it has read.
        let _ = self.stream.read_to_end(&mut rest);
    }
}

/// The most memory that this process ever had, KiB.
fn peak_kib() -> usize {
    let table = std::fs::read_to_string("/proc/self/status").expect("it runs");
    let line = table.lines().find_map(|line| line.strip_prefix("VmHWM:"));
    let word = line.and_then(|line| line.split_whitespace().next());
    word.and_then(|word| word.parse().ok()).expect("a number")
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn fragments_without_an_end_take_no_more_memory_than_the_largest_message() {
    // For whoever wants to know what a piece of one byte costs: PIECE=1 PIECES=10000.
    let told = |name: &str, default: usize| {
        let word = std::env::var(name).ok();
        word.map_or(default, |word| word.parse().expect("a number"))
    };
    let piece = told("PIECE", PIECE);
    let pieces = told("PIECES", 3 * MESSAGE_BYTES_MAX / PIECE);
    let store = tempfile::tempdir().expect("a directory");
    let config = GatewayConfig {
        listen: vec!["tcp/127.0.0.1:0".to_owned()],
        ..GatewayConfig::new(store.path().join("fleet.redb"))
    };
    let service = Service::start(config).await.expect("started");
    let locator = service.locators()[0].clone();
    let attack = move || {
        let client = field::open_client(&locator);
        let before = peak_kib();
        let mut link = Link::open(&locator);
        for _ in 0..pieces {
            link.send_piece(piece);
        }
        link.close();
        let grown = peak_kib() - before;
        println!("{pieces} pieces of {piece} bytes: {grown} KiB");
        let answers = field::get(&client, "fleet/job/none", None);
        assert_eq!(answers[0]["error"]["code"], "bad_id", "others are served");
        grown
    };
    let grown = tokio::task::spawn_blocking(attack).await.expect("no panic");
    if piece == PIECE {
        // And a tenth for the allocator.
        let most = MESSAGE_BYTES_MAX / PIECE * BATCH / 1_024 * 11 / 10 + 8_192;
        assert!(grown < most, "{grown} KiB; expected less than {most}");
    }
    service.shutdown().await.expect("a clean end");
}
