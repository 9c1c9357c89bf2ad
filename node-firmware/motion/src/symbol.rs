//! The RMT word: two levels, each with a duration.
//!
//! ```text
//!   bit   31    30 … 16     15    14 … 0
//!       ┌─────┬──────────┬─────┬──────────┐
//!       │ lv1 │ ticks 1  │ lv0 │ ticks 0  │      part 0 is sent first; 0 ticks: end marker
//!       └─────┴──────────┴─────┴──────────┘      (ESP32-S3 TRM §37.3.2)
//! ```

use crate::limits::{PART_TICKS_MAX, PART_TICKS_MIN, WORD_TICKS_MIN};

/// One RMT word.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Symbol(pub u32);

impl Symbol {
    /// The transmitter stops here, at the idle level.
    pub const END: Self = Self(0);

    /// A step: high, then low; its active edge is the word's first tick.
    ///
    /// # Panics
    /// A part is shorter or longer than the hardware can play.
    pub fn step(high_ticks: u64, low_ticks: u64) -> Self {
        Self(part(high_ticks) | 1 << 15 | part(low_ticks) << 16)
    }

    /// A rest.
    ///
    /// # Panics
    /// A part is shorter or longer than the hardware can play.
    pub fn low(ticks: u64) -> Self {
        assert!(ticks >= WORD_TICKS_MIN, "a word has two parts");
        let first = ticks / 2;
        Self(part(first) | part(ticks - first) << 16)
    }

    /// Returns duration (ticks) and level of the part that is sent first.
    #[inline]
    pub const fn first(self) -> (u64, bool) {
        ((self.0 & 0x7fff) as u64, self.0 & 1 << 15 != 0)
    }

    /// Returns duration (ticks) and level of the part that is sent second.
    #[inline]
    pub const fn second(self) -> (u64, bool) {
        ((self.0 >> 16 & 0x7fff) as u64, self.0 & 1 << 31 != 0)
    }

    /// Returns how long the word lasts, ticks; 0 for the end marker.
    #[inline]
    pub const fn ticks(self) -> u64 {
        self.first().0 + self.second().0
    }

    /// Returns whether the transmitter stops within this word.
    #[inline]
    pub const fn is_end(self) -> bool {
        self.first().0 == 0 || self.second().0 == 0
    }

    /// Returns whether the word begins with an active edge, when the level before it was low.
    #[inline]
    pub const fn is_step(self) -> bool {
        self.first().1
    }
}

fn part(ticks: u64) -> u32 {
    assert!(
        (PART_TICKS_MIN..=PART_TICKS_MAX).contains(&ticks),
        "a part of a symbol has 2 to 32767 ticks"
    );
    u32::try_from(ticks).expect("the range was checked")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bits_lie_where_the_manual_says() {
        assert_eq!(Symbol::step(3, 497), Symbol(0x01f1_8003));
        assert_eq!(Symbol::low(9), Symbol(0x0005_0004));
        let step = Symbol::step(3, 497);
        assert_eq!((step.first(), step.second()), ((3, true), (497, false)));
        assert_eq!(step.ticks(), 500);
        assert!(step.is_step() && !step.is_end());
        assert!(Symbol::END.is_end() && !Symbol::low(4).is_step());
    }
}
