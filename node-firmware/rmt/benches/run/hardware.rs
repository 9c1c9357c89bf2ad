//! Registers that play words: no more than what a refill sees of them.

use core::cell::Cell;
use motion::Symbol;
use rmt::{ChannelConfig, ChannelStatus, Events, REFILL_WORDS, Registers, layout::BLOCK_WORDS};

/// The word that is read is one ahead of the word that plays.
pub(super) const PREFETCH_WORDS: u8 = 1;

/// Channels of the chip.
const CHANNELS: usize = 4;

/// One transmitter with one block.
#[derive(Clone, Copy)]
struct Channel {
    plays: bool,
    /// The word that plays, and when it ends.
    word: usize,
    ends_at: u64,
}

pub(super) struct Hardware {
    ram: [u32; CHANNELS * BLOCK_WORDS],
    channels: [Channel; CHANNELS],
    now: Cell<u64>,
    reached: u8,
    ended: u8,
    accesses: Cell<u32>,
}

impl Hardware {
    pub(super) const fn new() -> Self {
        Self {
            ram: [0; CHANNELS * BLOCK_WORDS],
            channels: [Channel {
                plays: false,
                word: 0,
                ends_at: 0,
            }; CHANNELS],
            now: Cell::new(0),
            reached: 0,
            ended: 0,
            accesses: Cell::new(0),
        }
    }

    /// Returns the time, which is no access.
    pub(super) fn time(&self) -> u64 {
        self.now.get()
    }

    /// Returns how often anything was read or written.
    pub(super) fn accesses(&self) -> u32 {
        self.accesses.get()
    }

    /// Lets time pass in which nothing plays.
    pub(super) fn wait_until(&mut self, at: u64) {
        self.now.set(at.max(self.now.get()));
    }

    /// Plays until a unit was played or a channel has ended, at most until an instant. Returns how
    /// many words.
    #[inline(never)]
    pub(super) fn play(&mut self, until: u64) -> u32 {
        let (mut words, mut event) = (0, false);
        loop {
            let next = (0..CHANNELS)
                .filter(|&channel| self.channels[channel].plays)
                .min_by_key(|&channel| self.channels[channel].ends_at);
            // What comes at the same instant comes in the same interrupt.
            let end = if event { self.time() + 1 } else { until };
            let Some(index) = next.filter(|&index| self.channels[index].ends_at < end) else {
                if !event {
                    self.wait_until(until);
                }
                return words;
            };
            words += 1;
            let Channel { word, ends_at, .. } = self.channels[index];
            self.wait_until(ends_at);
            self.enter(index, (word + 1) % BLOCK_WORDS, ends_at);
            if self.ended & 1 << index != 0 {
                event = true;
            } else if self.channels[index].word.is_multiple_of(REFILL_WORDS) {
                self.reached |= 1 << index;
                event = true;
            }
        }
    }

    /// A channel begins a word.
    fn enter(&mut self, index: usize, word: usize, at: u64) {
        let symbol = Symbol(self.ram[index * BLOCK_WORDS + word]);
        let channel = &mut self.channels[index];
        if symbol.is_end() {
            channel.plays = false;
            self.ended |= 1 << index;
        } else {
            channel.word = word;
            channel.ends_at = at + symbol.ticks();
        }
    }

    #[inline(always)]
    fn touch(&self) {
        self.accesses.set(self.accesses.get() + 1);
    }
}

impl Registers for Hardware {
    fn configure(&mut self, _channel: usize, _config: ChannelConfig) {
        self.touch();
    }

    fn set_threshold(&mut self, _channel: usize, _words: u16) {
        self.touch();
    }

    fn update(&mut self, _channel: usize) {
        self.touch();
    }

    fn reset_dividers(&mut self, _channels: u8) {
        self.touch();
    }

    fn start_together(&mut self, _channels: u8) {
        self.touch();
    }

    fn begin(&mut self, channel: usize) {
        self.touch();
        self.channels[channel].plays = true;
        self.enter(channel, 0, self.now.get());
    }

    fn stop(&mut self, channel: usize) {
        self.touch();
        self.channels[channel].plays = false;
    }

    fn status(&self, channel: usize) -> ChannelStatus {
        self.touch();
        let Channel { plays, word, .. } = self.channels[channel];
        let read = (word + usize::from(PREFETCH_WORDS)) % BLOCK_WORDS;
        ChannelStatus {
            read_word: channel * BLOCK_WORDS + read,
            idle: !plays,
        }
    }

    fn ended(&self) -> u8 {
        self.touch();
        self.ended
    }

    fn events(&self) -> Events {
        self.touch();
        Events {
            reached: self.reached,
            ended: self.ended,
        }
    }

    fn clear_events(&mut self, channels: u8, ends: bool) {
        self.touch();
        self.reached &= !channels;
        if ends {
            self.ended &= !channels;
        }
    }

    fn enable_interrupts(&mut self, _channels: u8) {
        self.touch();
    }

    fn write_word(&mut self, word: usize, value: u32) {
        self.touch();
        self.ram[word] = value;
    }

    fn step_pin(&self, _channel: usize) -> bool {
        self.touch();
        false
    }

    fn set_direction(&mut self, _axis: usize, _positive: bool) {
        self.touch();
    }

    fn counter(&self, _axis: usize) -> Option<i16> {
        self.touch();
        Some(0)
    }

    /// Time passes while it is looked at, or the wait for a start would have no end.
    fn now(&self) -> u64 {
        self.touch();
        self.now.set(self.now.get() + 1);
        self.now.get()
    }
}
