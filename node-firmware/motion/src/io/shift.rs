//! Output pins behind a shift register, each change confirmed by what is read back.
//!
//! ```text
//!   set ─▶ wanted ─poll─▶ word out ─▶ register ─▶ word back ─confirm─▶ equal: confirmed
//!                           ▲                                          else: again, later
//!                           └───────────── at most RETRIES_MAX times ──────┘ then a fault
//! ```
//!
//! Owns what the pins should show and what is known of what they do. Promises: what is reported as
//! confirmed was read back after it was last changed; a register that does not follow is a fault
//! with both words in it, never an endless loop.
//!
//! Absent: how a word is shifted. The shell sends what [`ShiftPins::poll`] gives and hands back
//! what it read.

use crate::{Ticks, limits::TICKS_PER_US};

/// Most pins behind shift registers: a chain of four with eight each.
pub const SHIFT_PINS_MAX: usize = 32;

/// How often a word is sent again before it is a fault.
pub const RETRIES_MAX: u8 = 4;

/// From one try to the next: 1 ms, longer than what disturbs a wire.
pub const RETRY_TICKS: u64 = 1_000 * TICKS_PER_US;

/// A word that is not read back by then counts as wrong: 20 ms.
pub const ANSWER_TICKS_MAX: u64 = 20_000 * TICKS_PER_US;

/// There is no such pin.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct NoPin;

/// The register does not follow.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ShiftFault {
    /// The word that was sent.
    pub wanted: u32,
    /// What was read back last, `None` if nothing was.
    pub actual: Option<u32>,
}

impl core::fmt::Display for ShiftFault {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        let wanted = self.wanted;
        write!(f, "shift register: sent {wanted:#010x}, ")?;
        match self.actual {
            Some(actual) => write!(f, "read back {actual:#010x}"),
            None => write!(f, "nothing was read back"),
        }
    }
}

impl core::error::Error for ShiftFault {}

/// What to do now.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ShiftEvent {
    /// Send this word, and hand what is read back to [`ShiftPins::confirm`].
    Send(u32),
    /// All pins show what they should.
    Confirmed,
    /// Given up, until [`ShiftPins::reset`].
    Fault(ShiftFault),
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum State {
    /// The pins show `confirmed`.
    Quiet,
    /// To be sent from then on.
    Due(Ticks),
    /// Sent; the answer is awaited until then.
    Sent { word: u32, until: Ticks },
    /// The fault has not been told.
    Failing(ShiftFault),
    /// It has.
    Failed(ShiftFault),
}

/// Pins behind shift registers.
#[derive(Clone, Debug)]
pub struct ShiftPins {
    mask: u32,
    wanted: u32,
    confirmed: Option<u32>,
    state: State,
    /// Wrong answers since the last right one, whatever the words were: a register that does not
    /// follow is found also while the pins are changed all the time.
    wrong_count: u8,
    told: bool,
}

impl ShiftPins {
    /// So many pins, at most [`SHIFT_PINS_MAX`], that show `word`; the first poll sends it.
    ///
    /// # Panics
    /// There are more.
    pub fn new(pin_count: usize, word: u32, now: Ticks) -> Self {
        assert!(
            pin_count <= SHIFT_PINS_MAX,
            "shift registers have at most {SHIFT_PINS_MAX} pins"
        );
        // All of 32 cannot be shifted out of 32.
        let mask = ((1_u64 << pin_count) - 1) as u32;
        Self {
            mask,
            wanted: word & mask,
            confirmed: None,
            state: State::Due(now),
            wrong_count: 0,
            told: false,
        }
    }

    /// Changes one pin. Several changes before the next poll are one word. After a fault the wish
    /// is kept, and sent after [`ShiftPins::reset`].
    ///
    /// # Errors
    /// There is no such pin.
    pub fn set(&mut self, pin: u8, level: bool, now: Ticks) -> Result<(), NoPin> {
        let bit = self.bit(pin)?;
        let wanted = if level {
            self.wanted | bit
        } else {
            self.wanted & !bit
        };
        if wanted == self.wanted {
            return Ok(());
        }
        self.wanted = wanted;
        self.told = false;
        if matches!(self.state, State::Quiet | State::Due(_)) {
            self.state = State::Due(now);
        }
        Ok(())
    }

    /// Returns what a pin should show.
    ///
    /// # Errors
    /// There is no such pin.
    pub fn get(&self, pin: u8) -> Result<bool, NoPin> {
        Ok(self.wanted & self.bit(pin)? != 0)
    }

    /// Returns whether a pin is known to show what it should.
    ///
    /// # Errors
    /// There is no such pin.
    pub fn is_confirmed(&self, pin: u8) -> Result<bool, NoPin> {
        let bit = self.bit(pin)?;
        let known = self.confirmed.filter(|_| self.fault().is_none());
        let shows = known.is_some_and(|word| (word ^ self.wanted) & bit == 0);
        // A word on its way may change it, and back again.
        let leaves =
            matches!(self.state, State::Sent { word, .. } if (word ^ self.wanted) & bit != 0);
        Ok(shows && !leaves)
    }

    /// Returns the fault, if there is one.
    pub const fn fault(&self) -> Option<ShiftFault> {
        match self.state {
            State::Failing(fault) | State::Failed(fault) => Some(fault),
            _ => None,
        }
    }

    /// Takes the word that was read back. One that nobody waits for means nothing.
    pub fn confirm(&mut self, actual: u32, now: Ticks) {
        let State::Sent { word, .. } = self.state else {
            return;
        };
        let actual = actual & self.mask;
        if actual == word {
            self.confirmed = Some(actual);
            self.wrong_count = 0;
            self.state = if word == self.wanted {
                State::Quiet
            } else {
                State::Due(now)
            };
        } else {
            self.confirmed = None;
            self.try_again(word, Some(actual), now);
        }
    }

    /// Gives what is to be done now; call it until it gives `None`. A word that it gives leaves `here`:
    /// who makes up for time in which nobody polled is behind it, and the register has its time all
    /// the same.
    pub fn poll(&mut self, now: Ticks, here: Ticks) -> Option<ShiftEvent> {
        if let State::Sent { word, until } = self.state
            && until <= now
        {
            self.confirmed = None;
            self.try_again(word, None, now);
        }
        match self.state {
            State::Due(at) if at <= now => {
                let word = self.wanted;
                let until = now.max(here).plus(ANSWER_TICKS_MAX);
                self.state = State::Sent { word, until };
                Some(ShiftEvent::Send(word))
            }
            State::Failing(fault) => {
                self.state = State::Failed(fault);
                Some(ShiftEvent::Fault(fault))
            }
            State::Quiet if !self.told => {
                self.told = true;
                Some(ShiftEvent::Confirmed)
            }
            _ => None,
        }
    }

    /// Returns when [`ShiftPins::poll`] has something next.
    pub fn poll_timeout(&self) -> Option<Ticks> {
        match self.state {
            State::Due(at) => Some(at),
            State::Sent { until, .. } => Some(until),
            State::Failing(_) => Some(Ticks(0)),
            State::Quiet => (!self.told).then_some(Ticks(0)),
            State::Failed(_) => None,
        }
    }

    /// Ends a fault: the wanted word is sent anew.
    pub fn reset(&mut self, now: Ticks) {
        if self.fault().is_some() {
            self.state = State::Due(now);
            self.wrong_count = 0;
        }
    }

    fn try_again(&mut self, word: u32, actual: Option<u32>, now: Ticks) {
        if self.wrong_count == RETRIES_MAX {
            let wanted = word;
            self.state = State::Failing(ShiftFault { wanted, actual });
            return;
        }
        self.wrong_count += 1;
        self.state = State::Due(if word == self.wanted {
            now.plus(RETRY_TICKS)
        } else {
            now
        });
    }

    fn bit(&self, pin: u8) -> Result<u32, NoPin> {
        let bit = 1_u32.checked_shl(u32::from(pin)).ok_or(NoPin)?;
        if bit & self.mask == 0 {
            return Err(NoPin);
        }
        Ok(bit)
    }
}

#[cfg(test)]
mod tests {
    extern crate std;

    use super::*;
    use std::{string::ToString, vec::Vec};

    const fn ms(ms: u64) -> Ticks {
        Ticks(ms * 1_000 * TICKS_PER_US)
    }

    /// Polls in time.
    fn poll(pins: &mut ShiftPins, now: Ticks) -> Option<ShiftEvent> {
        pins.poll(now, now)
    }

    /// Sixteen pins that show this word, confirmed.
    fn quiet(word: u32) -> ShiftPins {
        let mut pins = ShiftPins::new(16, word, ms(0));
        assert_eq!(poll(&mut pins, ms(0)), Some(ShiftEvent::Send(word)));
        pins.confirm(word, ms(0));
        assert_eq!(poll(&mut pins, ms(0)), Some(ShiftEvent::Confirmed));
        assert_eq!((poll(&mut pins, ms(0)), pins.poll_timeout()), (None, None));
        pins
    }

    #[test]
    fn a_change_is_sent_and_confirmed_by_what_is_read_back() {
        let mut pins = quiet(0x00f0);
        assert_eq!(pins.set(0, true, ms(5)), Ok(()));
        assert_eq!(pins.is_confirmed(0), Ok(false));
        assert_eq!(pins.is_confirmed(4), Ok(true), "another pin");
        assert_eq!(pins.poll_timeout(), Some(ms(5)));
        assert_eq!(poll(&mut pins, ms(5)), Some(ShiftEvent::Send(0x00f1)));
        assert_eq!(poll(&mut pins, ms(6)), None);
        assert_eq!(pins.poll_timeout(), Some(ms(25)));
        // Bits of pins that are not there mean nothing.
        pins.confirm(0xffff_00f1, ms(7));
        assert_eq!(pins.is_confirmed(0), Ok(true));
        assert_eq!(pins.poll_timeout(), Some(Ticks(0)));
        assert_eq!(poll(&mut pins, ms(7)), Some(ShiftEvent::Confirmed));
        assert_eq!((poll(&mut pins, ms(99)), pins.poll_timeout()), (None, None));
        assert_eq!((pins.get(0), pins.get(1)), (Ok(true), Ok(false)));
    }

    #[test]
    fn several_changes_are_one_word_and_none_is_no_word() {
        let mut pins = quiet(0);
        for pin in [1, 3, 15] {
            assert_eq!(pins.set(pin, true, ms(1)), Ok(()));
        }
        assert_eq!(poll(&mut pins, ms(1)), Some(ShiftEvent::Send(0x800a)));
        pins.confirm(0x800a, ms(1));
        assert_eq!(poll(&mut pins, ms(1)), Some(ShiftEvent::Confirmed));
        assert_eq!(pins.set(3, true, ms(2)), Ok(()), "it is");
        assert_eq!((poll(&mut pins, ms(2)), pins.poll_timeout()), (None, None));
        // There and back is sent, and so confirmed anew.
        assert_eq!(pins.set(3, false, ms(3)), Ok(()));
        assert_eq!(pins.set(3, true, ms(3)), Ok(()));
        assert_eq!(poll(&mut pins, ms(3)), Some(ShiftEvent::Send(0x800a)));
    }

    #[test]
    fn a_change_while_a_word_is_under_way_follows_it() {
        let mut pins = quiet(0);
        assert_eq!(pins.set(0, true, ms(1)), Ok(()));
        assert_eq!(poll(&mut pins, ms(1)), Some(ShiftEvent::Send(1)));
        assert_eq!(pins.set(0, false, ms(2)), Ok(()));
        assert_eq!(
            pins.is_confirmed(0),
            Ok(false),
            "the word under way sets it"
        );
        assert_eq!(poll(&mut pins, ms(2)), None, "one word at a time");
        pins.confirm(1, ms(3));
        assert_eq!(pins.is_confirmed(0), Ok(false));
        assert_eq!(poll(&mut pins, ms(3)), Some(ShiftEvent::Send(0)));
        pins.confirm(0, ms(4));
        assert_eq!(pins.is_confirmed(0), Ok(true));
        assert_eq!(poll(&mut pins, ms(4)), Some(ShiftEvent::Confirmed));
    }

    #[test]
    fn it_is_sent_again_until_it_is_equal() {
        let mut pins = quiet(0);
        assert_eq!(pins.set(2, true, ms(10)), Ok(()));
        let mut now = ms(10);
        for wrong in 0..RETRIES_MAX {
            assert_eq!(
                poll(&mut pins, now),
                Some(ShiftEvent::Send(4)),
                "try {wrong}"
            );
            pins.confirm(0, now);
            assert_eq!(pins.is_confirmed(2), Ok(false));
            assert_eq!(pins.is_confirmed(1), Ok(false), "nothing is known");
            assert_eq!(pins.poll_timeout(), Some(now.plus(RETRY_TICKS)));
            assert_eq!(poll(&mut pins, Ticks(now.0 + RETRY_TICKS - 1)), None);
            now = now.plus(RETRY_TICKS);
        }
        assert_eq!(poll(&mut pins, now), Some(ShiftEvent::Send(4)));
        pins.confirm(4, now);
        assert_eq!(poll(&mut pins, now), Some(ShiftEvent::Confirmed));
        assert_eq!(pins.is_confirmed(1), Ok(true));
        // All tries are there again for the next word.
        assert_eq!(pins.set(2, false, now), Ok(()));
        assert_eq!(poll(&mut pins, now), Some(ShiftEvent::Send(0)));
        pins.confirm(4, now);
        assert_eq!(pins.fault(), None);
    }

    /// Answers everything with `answer` until all is confirmed or nothing happens; returns the
    /// words and the fault.
    fn exhaust(
        pins: &mut ShiftPins,
        answer: Option<u32>,
        mut now: Ticks,
    ) -> (Vec<u32>, Option<ShiftFault>) {
        let mut words = Vec::new();
        let mut found = None;
        while let Some(at) = pins.poll_timeout() {
            now = now.max(at);
            while let Some(event) = poll(pins, now) {
                match event {
                    ShiftEvent::Send(word) => {
                        words.push(word);
                        if let Some(answer) = answer {
                            pins.confirm(answer, now);
                        }
                    }
                    ShiftEvent::Confirmed => return (words, found),
                    ShiftEvent::Fault(fault) => assert_eq!(found.replace(fault), None),
                }
            }
        }
        (words, found)
    }

    #[test]
    fn a_register_that_does_not_follow_is_a_fault_with_both_words() {
        let tries = 1 + usize::from(RETRIES_MAX);
        let mut pins = quiet(0);
        assert_eq!(pins.set(2, true, ms(1)), Ok(()));
        let (words, fault) = exhaust(&mut pins, Some(0x40), ms(1));
        assert_eq!(words, std::vec![4; tries]);
        let expected = ShiftFault {
            wanted: 4,
            actual: Some(0x40),
        };
        assert_eq!((fault, pins.fault()), (Some(expected), Some(expected)));
        assert_eq!(
            expected.to_string(),
            "shift register: sent 0x00000004, read back 0x00000040"
        );
        assert_eq!(pins.is_confirmed(0), Ok(false));
        // A wish is kept, and nothing is sent until the fault is over.
        assert_eq!(pins.set(0, true, ms(50)), Ok(()));
        pins.confirm(5, ms(50));
        assert_eq!((poll(&mut pins, ms(50)), pins.poll_timeout()), (None, None));
        assert_eq!(pins.fault(), Some(expected));
        pins.reset(ms(60));
        assert_eq!(poll(&mut pins, ms(60)), Some(ShiftEvent::Send(5)));
        pins.confirm(5, ms(60));
        assert_eq!(poll(&mut pins, ms(60)), Some(ShiftEvent::Confirmed));
        assert_eq!(pins.is_confirmed(0), Ok(true));
        pins.reset(ms(70));
        assert_eq!(poll(&mut pins, ms(70)), None, "there was no fault");

        let (words, fault) = {
            assert_eq!(pins.set(0, false, ms(80)), Ok(()));
            exhaust(&mut pins, None, ms(80))
        };
        assert_eq!(words, std::vec![4; tries]);
        let silent = ShiftFault {
            wanted: 4,
            actual: None,
        };
        assert_eq!(fault, Some(silent));
        assert_eq!(
            silent.to_string(),
            "shift register: sent 0x00000004, nothing was read back"
        );
    }

    #[test]
    fn a_register_that_does_not_follow_is_found_while_pins_change_all_the_time() {
        let mut pins = quiet(0);
        let mut now = ms(1);
        let mut sent_count = 0;
        let fault = loop {
            assert_eq!(pins.set(0, sent_count % 2 == 0, now), Ok(()));
            match poll(&mut pins, now) {
                Some(ShiftEvent::Send(_)) => sent_count += 1,
                Some(ShiftEvent::Fault(fault)) => break fault,
                other => panic!("{other:?}"),
            }
            assert_eq!(pins.set(0, sent_count % 2 == 0, now), Ok(()));
            pins.confirm(0x8000, now);
            now = now.plus(1);
        };
        assert_eq!(sent_count, 1 + u32::from(RETRIES_MAX));
        assert_eq!(fault.actual, Some(0x8000));
    }

    #[test]
    fn a_word_that_is_sent_late_has_its_time_on_the_wire() {
        // Nobody polled for 300 ms: what should have happened meanwhile is made up for at once.
        let mut pins = quiet(0);
        assert_eq!(pins.set(0, true, ms(0)), Ok(()));
        assert_eq!(poll(&mut pins, ms(0)), Some(ShiftEvent::Send(1)));
        let (here, mut words) = (ms(300), 0);
        while let Some(at) = pins.poll_timeout().filter(|at| *at <= here) {
            match pins.poll(at, here) {
                Some(ShiftEvent::Send(1)) => words += 1,
                other => assert_eq!(other, None),
            }
        }
        assert_eq!(words, 1);
        assert_eq!(pins.poll_timeout(), Some(ms(320)));
        pins.confirm(1, ms(319));
        assert_eq!(poll(&mut pins, ms(319)), Some(ShiftEvent::Confirmed));
    }

    #[test]
    fn an_answer_that_comes_too_late_means_nothing() {
        let mut pins = quiet(0);
        assert_eq!(pins.set(0, true, ms(0)), Ok(()));
        assert_eq!(poll(&mut pins, ms(0)), Some(ShiftEvent::Send(1)));
        assert_eq!(poll(&mut pins, ms(20)), None, "too late; again in 1 ms");
        pins.confirm(1, ms(20));
        assert_eq!(pins.is_confirmed(0), Ok(false));
        assert_eq!(poll(&mut pins, ms(21)), Some(ShiftEvent::Send(1)));
        pins.confirm(1, ms(22));
        assert_eq!(poll(&mut pins, ms(22)), Some(ShiftEvent::Confirmed));
        pins.confirm(0, ms(23));
        assert_eq!(pins.is_confirmed(0), Ok(true), "nobody asked");
    }

    #[test]
    fn there_are_as_many_pins_as_there_are() {
        for pin_count in [0, 1, 8, 31, 32_u8] {
            let mut pins = ShiftPins::new(usize::from(pin_count), u32::MAX, ms(0));
            for pin in 0..=255 {
                let there = pin < pin_count;
                let answer = if there { Ok(true) } else { Err(NoPin) };
                assert_eq!(pins.get(pin), answer, "{pin} of {pin_count}");
                assert_eq!(pins.is_confirmed(pin).is_ok(), there);
                assert_eq!(pins.set(pin, true, ms(0)).is_ok(), there);
            }
            let all = ((1_u64 << pin_count) - 1) as u32;
            assert_eq!(poll(&mut pins, ms(0)), Some(ShiftEvent::Send(all)));
        }
    }
}
