//! [`Fill`]: the words of one half block, and what has to be known of them.

use crate::{limits::REFILL_WORDS, segment::Direction, symbol::Symbol};

/// One half block.
#[derive(Clone, Debug)]
pub struct Fill {
    /// The words, to be written to the half that was consumed.
    pub words: [Symbol; REFILL_WORDS],
    /// The direction pin takes this level now, before anything of `words` is played.
    pub turn: Option<Direction>,
    /// When the pin must have it at the latest, for the driver's setup time: ticks after the first of
    /// `words` begins, mostly before it.
    pub turn_by_ticks: i32,
    /// Which of the words hold a step, bit 0 the first one; all of them in one direction.
    pub(crate) step_words: u32,
    /// That direction, +1 or -1.
    pub(crate) sign: i8,
    /// How long the words last together, ticks.
    pub(crate) ticks: u32,
}

impl Fill {
    /// Returns which of the words hold a step, bit 0 the first one.
    #[inline]
    pub fn step_words(&self) -> u32 {
        self.step_words
    }

    /// Returns what each of the steps adds to the count: +1 or -1.
    #[inline]
    pub fn sign(&self) -> i8 {
        self.sign
    }

    /// Returns how long the words last together, ticks.
    #[inline]
    pub fn ticks(&self) -> u32 {
        self.ticks
    }
}

impl Fill {
    /// Nothing: end markers only.
    pub const END: Self = Self {
        words: [Symbol::END; REFILL_WORDS],
        turn: None,
        turn_by_ticks: 0,
        step_words: 0,
        sign: 1,
        ticks: 0,
    };
}

#[derive(Clone, Copy, Debug, Default)]
pub(super) struct HalfFacts {
    pub(super) has_steps: bool,
    pub(super) ticks: u32,
}

/// Where the words of one fill go.
pub(super) struct Out<'f> {
    /// Its words are those of another fill where none are written yet.
    pub(super) fill: &'f mut Fill,
    pub(super) count: usize,
    pub(super) facts: HalfFacts,
}

impl<'f> Out<'f> {
    pub(super) fn new(fill: &'f mut Fill) -> Self {
        fill.turn = None;
        fill.turn_by_ticks = 0;
        fill.step_words = 0;
        Self {
            fill,
            count: 0,
            facts: HalfFacts::default(),
        }
    }

    pub(super) fn left(&self) -> usize {
        REFILL_WORDS - self.count
    }

    pub(super) fn push(&mut self, symbol: Symbol) {
        self.fill.words[self.count] = symbol;
        self.count += 1;
        self.facts.ticks += symbol.ticks() as u32;
    }

    pub(super) fn push_step(&mut self, symbol: Symbol) {
        self.fill.step_words |= 1 << self.count;
        self.facts.has_steps = true;
        self.push(symbol);
    }
}
