//! What a boot leaves behind for the next one: its last events, and the reason if it panicked.
//!
//! ```text
//!   word 0      1          2       3        4…      …       …
//!   ┌───────┬──────────┬────────┬────────┬────────┬────────┬──────────────────┐
//!   │ magic │ checksum │ bytes  │ count  │ reason │ frames │ events: ms, kind │
//!   └───────┴──────────┴────────┴────────┴────────┴────────┴──────────────────┘
//!             over words 2 to the frames                      each with its own
//! ```
//!
//! It lies in memory that a reset leaves alone. Events are noted as they happen, so that they are there
//! after any reset: a watchdog and a falling voltage let nobody write a last word. Each carries a check
//! of its own, because such a reset may come in the middle of one, and a falling voltage may change bits.

use heapless::{String, Vec};

/// Bytes of the reason that are kept.
pub const REASON_BYTES: usize = 120;
/// Frames of the stack that are kept.
pub const FRAMES: usize = 10;
/// Events that are kept.
pub const EVENTS: usize = 8;
/// Words of the memory.
pub const WORDS: usize = EVENTS_AT + 2 * EVENTS;

const MAGIC: u32 = 0x5354_4f51;
const REASON_AT: usize = 4;
const FRAMES_AT: usize = REASON_AT + REASON_BYTES / 4;
const EVENTS_AT: usize = FRAMES_AT + FRAMES;

/// Memory that a reset leaves alone.
pub trait Words {
    /// Reads a word below [`WORDS`].
    fn get(&self, index: usize) -> u32;

    /// Writes one.
    fn put(&mut self, index: usize, word: u32);
}

/// What has reset the processor.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Reset {
    /// Power on, or the reset button.
    PowerOn,
    /// The program itself, or whoever is on the USB port.
    Asked,
    /// The watchdog of the core that plans.
    PlanningWatchdog,
    /// The watchdog of the core with the network, or that of the boot.
    NetworkWatchdog,
    /// The supply was too low.
    BrownOut,
    /// Something else, by the number in the chip's manual.
    Other(u8),
}

impl Reset {
    /// Returns what the ROM's number of a reset means; the chips of this project agree in these: ESP-IDF,
    /// `soc/reset_reasons.h`. `None`: a number that the HAL does not know.
    #[must_use]
    pub const fn from_number(number: Option<u8>) -> Self {
        match number {
            Some(0x01) => Self::PowerOn,
            // By a program, for a core or for all, or by whoever is on the USB port.
            Some(0x03 | 0x0c | 0x15 | 0x16 | 0x17 | 0x18) => Self::Asked,
            Some(0x08 | 0x11) => Self::PlanningWatchdog,
            // The boot loader and the ROM use the first timer group and the RTC's.
            Some(0x07 | 0x09 | 0x0b | 0x0d | 0x10 | 0x12) => Self::NetworkWatchdog,
            Some(0x0f) => Self::BrownOut,
            Some(number) => Self::Other(number),
            None => Self::Other(0),
        }
    }

    /// Returns whether nobody has asked for it.
    #[must_use]
    pub const fn is_fault(self) -> bool {
        !matches!(self, Self::PowerOn | Self::Asked)
    }
}

impl core::fmt::Display for Reset {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        match self {
            Self::PowerOn => f.write_str("power on"),
            Self::Asked => f.write_str("a restart that was asked for"),
            Self::PlanningWatchdog => f.write_str("the watchdog of the core that plans"),
            Self::NetworkWatchdog => f.write_str("the watchdog of the core with the network"),
            Self::BrownOut => f.write_str("the supply was too low"),
            Self::Other(number) => write!(f, "reset number {number:#x} of the chip"),
        }
    }
}

/// What the boot before left behind.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Report {
    /// What ended it.
    pub reset: Reset,
    /// Where and why it panicked, if it did.
    pub panic: Option<String<REASON_BYTES>>,
    /// Program counters of the panic, innermost first.
    pub frames: Vec<u32, FRAMES>,
    /// Time (ms since that boot) and kind of the last events, oldest first.
    pub events: Vec<(u32, u8), EVENTS>,
}

/// See the module.
#[derive(Debug)]
pub struct BlackBox<W>(W);

impl<W: Words> BlackBox<W> {
    /// Takes the memory as it is.
    pub const fn new(words: W) -> Self {
        Self(words)
    }

    /// Notes an event: `slot` counts up.
    pub fn keep_event(&mut self, slot: usize, at_ms: u32, kind: u8) {
        let at = EVENTS_AT + 2 * (slot % EVENTS);
        self.0.put(at, at_ms);
        self.0.put(at + 1, checked(at_ms, kind));
    }

    /// Notes why and where it panics.
    pub fn keep_panic(&mut self, reason: &[u8], frames: &[u32]) {
        self.0.put(0, 0);
        let used = reason.len().min(REASON_BYTES);
        self.0.put(2, used as u32);
        for index in 0..REASON_BYTES / 4 {
            let byte = |byte: usize| reason.get(4 * index + byte).copied().unwrap_or(0);
            let word = u32::from_le_bytes([byte(0), byte(1), byte(2), byte(3)]);
            self.0.put(REASON_AT + index, word);
        }
        self.0.put(3, frames.len().min(FRAMES) as u32);
        for index in 0..FRAMES {
            let frame = frames.get(index).copied().unwrap_or(0);
            self.0.put(FRAMES_AT + index, frame);
        }
        let sum = self.checksum();
        self.0.put(1, sum);
        self.0.put(0, MAGIC);
    }

    /// Takes what the boot before left behind, and forgets it. `None`: it ended as it should.
    pub fn take(&mut self, reset: Reset) -> Option<Report> {
        let panicked = self.0.get(0) == MAGIC && self.0.get(1) == self.checksum();
        let report = (panicked || reset.is_fault()).then(|| {
            let count = if panicked { self.0.get(3) as usize } else { 0 };
            let frames = (0..count.min(FRAMES)).map(|index| self.0.get(FRAMES_AT + index));
            Report {
                reset,
                panic: panicked.then(|| self.reason()),
                frames: frames.collect(),
                events: self.events(),
            }
        });
        self.0.put(0, 0);
        for index in EVENTS_AT..WORDS {
            self.0.put(index, 0);
        }
        report
    }

    fn reason(&self) -> String<REASON_BYTES> {
        let used = (self.0.get(2) as usize).min(REASON_BYTES);
        let bytes = (0..used).map(|at| self.0.get(REASON_AT + at / 4).to_le_bytes()[at % 4]);
        let shown = |byte: u8| {
            if byte.is_ascii() {
                char::from(byte)
            } else {
                '?'
            }
        };
        let mut reason = String::new();
        for byte in bytes {
            // There is room: it is no longer than this.
            let _ = reason.push(shown(byte));
        }
        reason
    }

    fn events(&self) -> Vec<(u32, u8), EVENTS> {
        let event = |slot: usize| {
            let at = EVENTS_AT + 2 * slot;
            let (at_ms, word) = (self.0.get(at), self.0.get(at + 1));
            (word == checked(at_ms, word as u8)).then_some((at_ms, word as u8))
        };
        let mut events: Vec<_, EVENTS> = (0..EVENTS).filter_map(event).collect();
        events.sort_unstable();
        events
    }

    fn checksum(&self) -> u32 {
        (2..EVENTS_AT).fold(MAGIC, |sum, index| sum.rotate_left(5) ^ self.0.get(index))
    }
}

/// Returns the kind of an event with a check of both its words, never zero.
const fn checked(at_ms: u32, kind: u8) -> u32 {
    // Every bit of either changes about half of the check: the finalizer of MurmurHash3.
    let mut mixed = at_ms ^ MAGIC ^ (kind as u32).rotate_right(11);
    mixed = (mixed ^ mixed >> 16).wrapping_mul(0x85eb_ca6b);
    mixed = (mixed ^ mixed >> 13).wrapping_mul(0xc2b2_ae35);
    mixed ^= mixed >> 16;
    mixed & !0xff | 0x8000_0000 | kind as u32
}
