//! What a boot leaves behind, after each kind of reset.

use periphery::blackbox::{BlackBox, EVENTS, FRAMES, REASON_BYTES, Reset, WORDS, Words};

/// Memory that outlives a boot.
#[derive(Clone, Debug)]
struct Memory([u32; WORDS]);

impl Words for &mut Memory {
    fn get(&self, index: usize) -> u32 {
        self.0[index]
    }

    fn put(&mut self, index: usize, word: u32) {
        self.0[index] = word;
    }
}

/// What lies in memory after power on: anything.
fn noise(seed: u32) -> Memory {
    let mut state = seed;
    Memory(std::array::from_fn(|_| {
        state ^= state << 13;
        state ^= state >> 17;
        state ^= state << 5;
        state
    }))
}

fn events(memory: &mut Memory, count: usize) {
    let mut kept = BlackBox::new(memory);
    for slot in 0..count {
        kept.keep_event(slot, 1_000 + slot as u32, slot as u8);
    }
}

#[test]
fn a_panic_is_told_once_with_reason_frames_and_the_last_events() {
    let mut memory = noise(1);
    assert_eq!(BlackBox::new(&mut memory).take(Reset::PowerOn), None);
    events(&mut memory, EVENTS + 3);
    BlackBox::new(&mut memory).keep_panic(b"plan.rs:12: caf\xe9", &[1, 2, 3]);
    let report = BlackBox::new(&mut memory).take(Reset::Asked);
    let report = report.expect("it panicked");
    assert_eq!(report.panic.as_deref(), Some("plan.rs:12: caf?"));
    assert_eq!(report.frames[..], [1, 2, 3]);
    let expected: Vec<_> = (3..EVENTS + 3)
        .map(|slot| (1_000 + slot as u32, slot as u8))
        .collect();
    assert_eq!(report.events[..], expected);
    assert_eq!(BlackBox::new(&mut memory).take(Reset::Asked), None);
}

#[test]
fn a_reset_that_nobody_asked_for_is_told_with_the_events_before_it() {
    for (number, reset) in [
        (0x08, Reset::PlanningWatchdog),
        (0x10, Reset::NetworkWatchdog),
        (0x0f, Reset::BrownOut),
        (0x13, Reset::Other(0x13)),
    ] {
        let mut memory = noise(2);
        BlackBox::new(&mut memory).take(Reset::PowerOn);
        events(&mut memory, 2);
        assert_eq!(Reset::from_number(Some(number)), reset);
        let report = BlackBox::new(&mut memory).take(reset).expect("a fault");
        assert_eq!((report.reset, report.panic), (reset, None));
        assert_eq!(report.events[..], [(1_000, 0), (1_001, 1)]);
        assert!(report.frames.is_empty());
    }
}

#[test]
fn a_restart_that_was_asked_for_is_no_news_and_its_events_are_forgotten() {
    for reset in [
        Reset::from_number(Some(1)),
        Reset::from_number(Some(3)),
        Reset::from_number(Some(0x15)),
    ] {
        let mut memory = noise(3);
        BlackBox::new(&mut memory).take(Reset::PowerOn);
        events(&mut memory, 4);
        assert_eq!(BlackBox::new(&mut memory).take(reset), None);
        let report = BlackBox::new(&mut memory).take(Reset::BrownOut);
        assert!(report.expect("a fault").events.is_empty());
    }
}

#[test]
fn an_event_that_is_torn_or_has_lost_a_bit_is_left_out() {
    let mut whole = noise(4);
    BlackBox::new(&mut whole).take(Reset::PowerOn);
    events(&mut whole, EVENTS);
    for index in WORDS - 2 * EVENTS..WORDS {
        for bit in 0..32 {
            let mut memory = whole.clone();
            memory.0[index] ^= 1 << bit;
            let report = BlackBox::new(&mut memory).take(Reset::BrownOut);
            let told = report.expect("a fault").events;
            assert_eq!(told.len(), EVENTS - 1, "word {index} bit {bit}");
        }
    }
}

#[test]
fn noise_is_neither_a_panic_nor_an_event() {
    for seed in 1..2_000 {
        let mut memory = noise(seed);
        let report = BlackBox::new(&mut memory).take(Reset::BrownOut);
        let report = report.expect("a fault");
        assert_eq!((report.panic, report.events.len()), (None, 0), "{seed}");
    }
}

#[test]
fn what_is_too_long_is_cut() {
    let mut memory = noise(5);
    let mut kept = BlackBox::new(&mut memory);
    kept.keep_panic(&[b'a'; REASON_BYTES + 9], &[7; FRAMES + 3]);
    let report = kept.take(Reset::Asked).expect("it panicked");
    assert_eq!(report.panic.map(|reason| reason.len()), Some(REASON_BYTES));
    assert_eq!(report.frames[..], [7; FRAMES]);
}
