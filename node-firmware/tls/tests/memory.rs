//! What a link asks of the heap, counted by the allocator, beside that of the router in the same
//! process; and how long its handshake takes here, which is printed and not judged.

mod peer;

use dhat::HeapStats;
use peer::{Ca, Router, YEARS};
use rustls::version::TLS13;
use std::time::Instant;
use tls::{TlsConfig, TlsLink};

/// Most that a link takes while it is opened, bytes.
const OPENING_BYTES_MAX: usize = 8 * 1024;

/// Most that an open link keeps, bytes.
const OPEN_BYTES_MAX: usize = 4 * 1024;

/// Most that a message of a full batch takes for a moment, bytes, with what the link keeps.
const BUSY_BYTES_MAX: usize = 12 * 1024;

/// What the node's client negotiates.
const BATCH_BYTES: usize = 2_048;

#[global_allocator]
static ALLOCATOR: dhat::Alloc = dhat::Alloc;

/// The link's part of the heap.
#[derive(Default)]
struct Part {
    held_bytes: usize,
    peak_bytes: usize,
}

impl Part {
    /// Runs a step of the link.
    fn step<T>(&mut self, step: impl FnOnce() -> T) -> T {
        let stats = HeapStats::get();
        // As much as was ever taken is taken now, so that the step's own peak is a new one.
        let ballast = vec![0_u8; stats.max_bytes - stats.curr_bytes];
        let before = HeapStats::get().curr_bytes;
        let result = step();
        let after = HeapStats::get();
        drop(ballast);
        let peak_bytes = self.held_bytes + (after.max_bytes - before);
        self.peak_bytes = self.peak_bytes.max(peak_bytes);
        self.held_bytes = (self.held_bytes + after.curr_bytes).saturating_sub(before);
        result
    }
}

#[test]
fn a_link_takes_little_of_the_heap_and_an_open_one_less() {
    let ca = Ca::new();
    let settings = ca.router(&["plant"], YEARS, &[&TLS13]);
    let authority = ca.authority();
    let profiler = dhat::Profiler::builder().testing().build();
    let (mut shared, mut part) = (Part::default(), Part::default());
    let config = shared.step(|| TlsConfig::new(&authority, "plant", None).expect("a name"));
    let mut router = Router::new(&settings);
    let mut out = Vec::with_capacity(4 * BATCH_BYTES);
    let mut flights = Vec::new();
    let mut took_us = 0;
    let mut link = part.step(|| TlsLink::new(&config).expect("random numbers"));
    loop {
        out.clear();
        part.step(|| link.poll_transmit(&mut out));
        router.handle_bytes(&out);
        let back = router.transmit();
        if back.is_empty() {
            break;
        }
        let begun = Instant::now();
        part.step(|| link.handle_bytes(&back)).expect("good");
        took_us += begun.elapsed().as_micros();
        flights.push(back.len());
    }
    assert!(link.is_open());
    let (opening_bytes, open_bytes) = (part.peak_bytes, part.held_bytes);
    part.peak_bytes = 0;
    let batch = [7; BATCH_BYTES + 2];
    let mut buffer = [0; BATCH_BYTES + 2];
    for _ in 0..3 {
        out.clear();
        part.step(|| link.send(&batch, &mut out)).expect("open");
        router.handle_bytes(&out);
        router.heard();
        let record = router.say(&batch);
        part.step(|| link.handle_bytes(&record)).expect("good");
        part.step(|| assert_eq!(link.receive(&mut buffer), batch.len()));
    }
    let busy_bytes = part.peak_bytes;
    drop(profiler);
    println!(
        "heap of a link: {opening_bytes} bytes while it opens, {open_bytes} when it is open, \
         {busy_bytes} with full batches, beside {} of itself and {} of its settings; the router's \
         flights {flights:?} bytes; the node's part of the handshake took {took_us} us here",
        size_of::<TlsLink>(),
        shared.held_bytes,
    );
    assert!(opening_bytes <= OPENING_BYTES_MAX, "{opening_bytes} bytes");
    assert!(open_bytes <= OPEN_BYTES_MAX, "{open_bytes} bytes");
    assert!(busy_bytes <= BUSY_BYTES_MAX, "{busy_bytes} bytes");
}
