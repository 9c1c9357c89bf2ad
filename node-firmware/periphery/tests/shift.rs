//! Words through a model of 74HC595 and 74HC165 chips, whole and broken.

use motion::{
    Ticks,
    io::shift::{RETRY_TICKS, ShiftEvent, ShiftPins},
};
use periphery::{
    ShiftLines,
    shift::{begin, exchange},
};

/// A chain of chips: as many outputs as inputs, output n wired to input n.
#[derive(Clone, Debug, Default)]
struct Chain {
    pins: usize,
    data: bool,
    clock: bool,
    latch: bool,
    /// Shift stages of the 595s, bit 0 nearest to the board.
    stages: u32,
    /// Their outputs.
    shown: u32,
    /// Stages of the 165s.
    back: u32,
    /// Every word that the outputs have shown.
    seen: Vec<u32>,
    // What is broken.
    clock_cut: bool,
    data_stuck: Option<bool>,
    /// Outputs that a short holds low.
    shorted: u32,
    /// A clock pulse too many by a spike, once, after so many pulses.
    spike_in: Option<u32>,
}

impl Chain {
    fn new(pins: usize) -> Self {
        let mut chain = Self {
            pins,
            shown: 0x5a5a_5a5a & mask(pins),
            ..Self::default()
        };
        begin(&mut chain);
        chain
    }

    fn levels(&self) -> u32 {
        self.shown & !self.shorted
    }

    fn shift(&mut self) {
        let bit = u32::from(self.data_stuck.unwrap_or(self.data));
        self.stages = (self.stages << 1 | bit) & mask(self.pins);
        // Its serial input is low.
        if self.latch {
            self.back = self.back << 1 & mask(self.pins);
        }
    }
}

fn mask(pins: usize) -> u32 {
    ((1_u64 << pins) - 1) as u32
}

impl ShiftLines for Chain {
    fn set_data(&mut self, high: bool) {
        self.data = high;
    }

    fn set_clock(&mut self, high: bool) {
        if high && !self.clock && !self.clock_cut {
            self.shift();
            if let Some(left) = self.spike_in.as_mut() {
                *left -= 1;
                if *left == 0 {
                    self.spike_in = None;
                    self.shift();
                }
            }
        }
        self.clock = high;
    }

    fn set_latch(&mut self, high: bool) {
        if high && !self.latch {
            self.shown = self.stages;
            self.seen.push(self.shown);
        }
        self.latch = high;
        if !high {
            self.back = self.levels();
        }
    }

    fn back(&self) -> bool {
        self.back >> (self.pins - 1) & 1 != 0
    }
}

#[test]
fn every_word_is_shown_and_comes_back() {
    for pins in [1, 2, 7, 8, 16, 24, 31, 32] {
        let mut chain = Chain::new(pins);
        for word in [0, u32::MAX, 0xdead_beef, 0x8000_0001, 0x0f0f_1248] {
            let word = word & mask(pins);
            chain.seen.clear();
            assert_eq!(exchange(&mut chain, word, pins), word, "{pins} pins");
            assert_eq!(chain.levels(), word, "{pins} pins");
            assert!(
                chain.seen.iter().all(|seen| *seen == word),
                "the outputs showed something else in between"
            );
        }
    }
}

#[test]
fn what_is_broken_comes_back_as_it_is_and_not_as_it_should_be() {
    let word = 0xa5c3;
    let mut cut = Chain::new(16);
    cut.clock_cut = true;
    assert_ne!(exchange(&mut cut, word, 16), word);
    for level in [false, true] {
        let mut stuck = Chain::new(16);
        stuck.data_stuck = Some(level);
        assert_ne!(exchange(&mut stuck, word, 16), word);
    }
    let mut shorted = Chain::new(16);
    shorted.shorted = 1 << 8;
    assert_eq!(exchange(&mut shorted, word, 16), word & !(1 << 8));
    for pulse in 1..=16 {
        let mut disturbed = Chain::new(16);
        disturbed.spike_in = Some(pulse);
        let back = exchange(&mut disturbed, word, 16);
        assert_eq!(back, disturbed.levels(), "after pulse {pulse}");
        // The first bit twice drops out at the end of the chain: no harm is done.
        assert_eq!(back == word, pulse == 1, "after pulse {pulse}");
        // The next try is right.
        assert_eq!(exchange(&mut disturbed, word, 16), word);
    }
}

/// Lets motion's pins and the chain come to an end; returns the last event.
fn settle(pins: &mut ShiftPins, chain: &mut Chain, mut now: u64) -> (ShiftEvent, u32) {
    let mut sends = 0;
    for _ in 0..100 {
        match pins.poll(Ticks(now), Ticks(now)) {
            Some(ShiftEvent::Send(word)) => {
                sends += 1;
                let back = exchange(chain, word, 16);
                pins.confirm(back, Ticks(now + 500));
            }
            Some(event) => return (event, sends),
            None => now += RETRY_TICKS,
        }
    }
    panic!("it comes to no end");
}

#[test]
fn motions_pins_are_confirmed_by_what_they_show_and_a_short_is_a_fault() {
    let mut chain = Chain::new(16);
    let mut pins = ShiftPins::new(16, 0, Ticks(0));
    assert_eq!(settle(&mut pins, &mut chain, 0), (ShiftEvent::Confirmed, 1));
    pins.set(9, true, Ticks(100_000)).expect("a pin");
    chain.spike_in = Some(9);
    assert_eq!(
        settle(&mut pins, &mut chain, 100_000),
        (ShiftEvent::Confirmed, 2)
    );
    assert_eq!(pins.is_confirmed(9), Ok(true));
    chain.shorted = 1 << 3;
    pins.set(3, true, Ticks(900_000)).expect("a pin");
    let (event, _) = settle(&mut pins, &mut chain, 900_000);
    let ShiftEvent::Fault(fault) = event else {
        panic!("{event:?}");
    };
    assert_eq!((fault.wanted, fault.actual), (0x208, Some(0x200)));
}
