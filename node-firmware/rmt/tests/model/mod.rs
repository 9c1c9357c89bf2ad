//! The RMT at the level of its registers, from the manual, not from the driver.
//!
//! - 8 blocks of 48 words; a channel reads from its own block on, MEM_SIZE blocks, and wraps in
//!   them if MEM_TX_WRAP_EN is set (TRM §37.3.4.2). A word whose period is 0 ends the stream.
//! - The read pointer runs ahead of the word that plays by a prefetch that no manual names, so it is
//!   a parameter here. What was fetched is played as it was when it was fetched.
//! - The threshold event comes whenever so many words were read; whether that means fetched or
//!   played is a parameter too.
//! - CHnCONF0, CHnTX_LIM and TX_STOP take effect with CONF_UPDATE. After a reset the carrier is on,
//!   the divider is 2, wrap is off and the level at rest is not defined.
//! - TX_STOP cuts the word that plays at once.
//! - Channels in TX_SIM begin when the last of them is told to, within a skew.
//! - Every access takes time, in which the transmitters play on.
#![allow(dead_code, reason = "each test uses a part of it")]

use rmt::{ChannelConfig, ChannelStatus, Events, Registers};
use std::{cell::RefCell, collections::VecDeque, rc::Rc};

pub(crate) const CHANNELS: usize = 4;
/// Latest access that a test expects: two minutes.
const ACCESSED_UNTIL: u64 = 2_000_000_000;
const RAM_WORDS: usize = 8 * 48;

/// What the manual leaves open, or what differs by chip and load.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Silicon {
    pub(crate) prefetch_words: usize,
    /// The threshold counts words that were fetched, not those that were played.
    pub(crate) threshold_on_fetch: bool,
    /// Ticks that one access takes.
    pub(crate) access_ticks: u64,
    pub(crate) skew_ticks: [u64; CHANNELS],
    pub(crate) has_counters: bool,
}

impl Default for Silicon {
    fn default() -> Self {
        Self {
            prefetch_words: 1,
            threshold_on_fetch: false,
            access_ticks: 1,
            skew_ticks: [0; CHANNELS],
            has_counters: true,
        }
    }
}

/// A change of an output.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) struct Edge {
    pub(crate) at: u64,
    pub(crate) channel: usize,
    pub(crate) level: bool,
}

/// Settings of a channel in the state after a reset.
const RESET: ChannelConfig = ChannelConfig {
    divider: 2,
    blocks: 1,
    wrap: false,
    continuous: false,
    idle_output: false,
    idle_high: false,
    carrier: true,
};

#[derive(Clone, Debug)]
struct Channel {
    written: ChannelConfig,
    config: ChannelConfig,
    written_limit: u16,
    limit: u16,
    stop_written: bool,
    /// Told to begin, waiting for the others.
    armed: bool,
    running: bool,
    /// Next word to be fetched, in the block.
    address: usize,
    /// Fetched words; the first one plays. `None`: there is no word there any more.
    fetched: VecDeque<u32>,
    word_at: u64,
    /// The second part of the word plays.
    second: bool,
    counted_words: u64,
    level: bool,
}

#[derive(Debug)]
pub(crate) struct Model {
    silicon: Silicon,
    pub(crate) now: u64,
    ram: [u32; RAM_WORDS],
    /// How often a word was written.
    pub(crate) writes: u64,
    channels: [Channel; CHANNELS],
    together: u8,
    threshold_events: u8,
    end_events: u8,
    enabled: u8,
    /// Since when an enabled event is pending.
    pub(crate) pending_since: Option<u64>,
    directions: [bool; CHANNELS],
    /// Which channel an axis' counter and direction belong to.
    channel_of_axis: Vec<usize>,
    counters: [i16; CHANNELS],
    /// Steps with sign at the pin, not modulo anything.
    pub(crate) steps: [i64; CHANNELS],
    pub(crate) edges: Vec<Edge>,
    pub(crate) turns: Vec<Edge>,
}

impl Model {
    pub(crate) fn new(silicon: Silicon, channel_of_axis: Vec<usize>) -> Self {
        let channel = Channel {
            written: RESET,
            config: RESET,
            written_limit: 128,
            limit: 128,
            stop_written: false,
            armed: false,
            running: false,
            address: 0,
            fetched: VecDeque::new(),
            word_at: 0,
            second: false,
            counted_words: 0,
            level: false,
        };
        Self {
            silicon,
            now: 0,
            // What a RAM holds at power-up: anything.
            ram: [0x8123_8123; RAM_WORDS],
            writes: 0,
            channels: std::array::from_fn(|_| channel.clone()),
            together: 0,
            threshold_events: 0,
            end_events: 0,
            enabled: 0,
            pending_since: None,
            directions: [false; CHANNELS],
            channel_of_axis,
            counters: [0; CHANNELS],
            steps: [0; CHANNELS],
            edges: Vec::new(),
            turns: Vec::new(),
        }
    }

    /// Plays on until `until`, or until an enabled event comes up if `stop_at_event`.
    pub(crate) fn advance(&mut self, until: u64, stop_at_event: bool) {
        loop {
            if stop_at_event && self.pending_since.is_some() {
                return;
            }
            let next = (0..CHANNELS)
                .filter_map(|channel| Some((self.part_end(channel)?, channel)))
                .min();
            match next {
                Some((at, channel)) if at <= until => {
                    self.now = self.now.max(at);
                    self.pass(channel, at);
                }
                _ => {
                    self.now = self.now.max(until);
                    return;
                }
            }
        }
    }

    fn part_end(&self, channel: usize) -> Option<u64> {
        let state = &self.channels[channel];
        if !state.running {
            return None;
        }
        let word = *state.fetched.front()?;
        let first = u64::from(word & 0x7fff);
        let second = u64::from(word >> 16 & 0x7fff);
        Some(state.word_at + if state.second { first + second } else { first })
    }

    /// A part has ended at `at`.
    fn pass(&mut self, channel: usize, at: u64) {
        let state = &mut self.channels[channel];
        let word = state.fetched[0];
        if !state.second {
            if word >> 16 & 0x7fff == 0 {
                self.end(channel, at);
                return;
            }
            state.second = true;
            self.set_level(channel, word >> 31 != 0, at);
            return;
        }
        state.fetched.pop_front();
        state.word_at = at;
        self.fetch(channel, at);
        if !self.silicon.threshold_on_fetch {
            self.count_word(channel, at);
        }
        self.begin_word(channel, at);
    }

    fn begin_word(&mut self, channel: usize, at: u64) {
        let state = &mut self.channels[channel];
        state.second = false;
        let word = state.fetched[0];
        if word & 0x7fff == 0 {
            self.end(channel, at);
        } else {
            self.set_level(channel, word >> 15 & 1 != 0, at);
        }
    }

    fn fetch(&mut self, channel: usize, at: u64) {
        let state = &mut self.channels[channel];
        let words = usize::from(state.config.blocks) * 48;
        let index = channel * 48 + state.address;
        assert!(
            index < RAM_WORDS,
            "a channel without wrap has left its block"
        );
        state.fetched.push_back(self.ram[index]);
        state.address += 1;
        if state.config.wrap {
            state.address %= words;
        }
        if self.silicon.threshold_on_fetch {
            self.count_word(channel, at);
        }
    }

    fn count_word(&mut self, channel: usize, at: u64) {
        let state = &mut self.channels[channel];
        state.counted_words += 1;
        if state.counted_words.is_multiple_of(u64::from(state.limit)) {
            self.threshold_events |= 1 << channel;
            self.interrupt(at);
        }
    }

    fn end(&mut self, channel: usize, at: u64) {
        assert!(
            !self.channels[channel].config.continuous,
            "continuous mode repeats a block, which no stream wants"
        );
        self.channels[channel].running = false;
        self.rest(channel, at);
        self.end_events |= 1 << channel;
        self.interrupt(at);
    }

    /// The channel is idle: its pin takes the idle level, or keeps what it has (RMT-176).
    fn rest(&mut self, channel: usize, at: u64) {
        let config = self.channels[channel].config;
        if config.idle_output {
            self.set_level(channel, config.idle_high, at);
        }
    }

    fn interrupt(&mut self, at: u64) {
        if (self.threshold_events | self.end_events) & self.enabled != 0 {
            self.pending_since.get_or_insert(at);
        } else {
            self.pending_since = None;
        }
    }

    fn set_level(&mut self, channel: usize, level: bool, at: u64) {
        let state = &mut self.channels[channel];
        if state.level == level {
            return;
        }
        state.level = level;
        self.edges.push(Edge { at, channel, level });
        let axis = self.channel_of_axis.iter().position(|of| *of == channel);
        if let Some(axis) = axis
            && level
        {
            let sign = if self.directions[axis] { 1 } else { -1 };
            self.counters[axis] = self.counters[axis].wrapping_add(sign);
            self.steps[axis] += i64::from(sign);
        }
    }

    fn launch(&mut self, channel: usize) {
        let at = self.now + self.silicon.skew_ticks[channel];
        let config = self.channels[channel].config;
        assert_eq!(config.divider, 5, "a tick is 62.5 ns");
        assert!(!config.carrier, "no carrier on a step pin");
        let state = &mut self.channels[channel];
        state.running = true;
        state.address = 0;
        state.counted_words = 0;
        state.fetched.clear();
        state.word_at = at;
        for _ in 0..=self.silicon.prefetch_words {
            self.fetch(channel, at);
        }
        self.begin_word(channel, at);
    }
}

/// The registers of a [`Model`], as the driver holds them.
#[derive(Clone, Debug)]
pub(crate) struct ModelRegisters(pub(crate) Rc<RefCell<Model>>);

impl ModelRegisters {
    fn access<T>(&self, f: impl FnOnce(&mut Model) -> T) -> T {
        let mut model = self.0.borrow_mut();
        let until = model.now + model.silicon.access_ticks;
        assert!(until < ACCESSED_UNTIL, "the driver waits for ever");
        model.advance(until, false);
        f(&mut model)
    }
}

impl Registers for ModelRegisters {
    fn configure(&mut self, channel: usize, config: ChannelConfig) {
        self.access(|model| model.channels[channel].written = config);
    }

    fn set_threshold(&mut self, channel: usize, words: u16) {
        self.access(|model| model.channels[channel].written_limit = words);
    }

    fn update(&mut self, channel: usize) {
        self.access(|model| {
            let now = model.now;
            let state = &mut model.channels[channel];
            state.config = state.written;
            state.limit = state.written_limit;
            if std::mem::take(&mut state.stop_written) && state.running {
                state.running = false;
                model.rest(channel, now);
            }
        });
    }

    fn reset_dividers(&mut self, _channels: u8) {
        self.access(|_| ());
    }

    fn start_together(&mut self, channels: u8) {
        self.access(|model| model.together = channels);
    }

    fn begin(&mut self, channel: usize) {
        self.access(|model| {
            model.channels[channel].armed = true;
            let armed = |index: &usize| model.channels[*index].armed;
            let group: Vec<_> = (0..CHANNELS)
                .filter(|index| {
                    *index == channel || model.together & 1 << index & model.together != 0
                })
                .collect();
            let in_group = model.together & 1 << channel != 0;
            if !in_group {
                model.channels[channel].armed = false;
                model.launch(channel);
            } else if group.iter().all(armed) {
                for index in group {
                    model.channels[index].armed = false;
                    model.launch(index);
                }
            }
        });
    }

    fn stop(&mut self, channel: usize) {
        self.access(|model| model.channels[channel].stop_written = true);
    }

    fn status(&self, channel: usize) -> ChannelStatus {
        self.access(|model| {
            let state = &model.channels[channel];
            // The pointer stands at the word that was fetched last.
            let words = usize::from(state.config.blocks) * 48;
            let read = (state.address + words - 1) % words;
            ChannelStatus {
                read_word: channel * 48 + read,
                idle: !state.running,
            }
        })
    }

    fn ended(&self) -> u8 {
        self.access(|model| model.end_events)
    }

    /// By two accesses, as a chip with two registers would: an event may come in between.
    fn events(&self) -> Events {
        Events {
            reached: self.access(|model| model.threshold_events),
            ended: self.ended(),
        }
    }

    fn clear_events(&mut self, channels: u8, ends: bool) {
        self.access(|model| {
            model.threshold_events &= !channels;
            if ends {
                model.end_events &= !channels;
            }
            model.interrupt(model.now);
        });
    }

    fn enable_interrupts(&mut self, channels: u8) {
        self.access(|model| {
            model.enabled = channels;
            model.interrupt(model.now);
        });
    }

    fn write_word(&mut self, word: usize, value: u32) {
        self.access(|model| {
            model.ram[word] = value;
            model.writes += 1;
        });
    }

    fn step_pin(&self, channel: usize) -> bool {
        self.access(|model| model.channels[channel].level)
    }

    fn set_direction(&mut self, axis: usize, positive: bool) {
        self.access(|model| {
            if model.directions[axis] != positive {
                model.directions[axis] = positive;
                model.turns.push(Edge {
                    at: model.now,
                    channel: axis,
                    level: positive,
                });
            }
        });
    }

    fn counter(&self, axis: usize) -> Option<i16> {
        self.access(|model| model.silicon.has_counters.then(|| model.counters[axis]))
    }

    fn now(&self) -> u64 {
        self.access(|model| model.now)
    }
}
