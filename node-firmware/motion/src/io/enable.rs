//! Enable outputs: on before the first step, off when nothing has moved for a while.
//!
//! ```text
//!            wants_motion             delay_on              rest of all axes       delay_off
//!   off ──────────────────▶ on, early ────────▶ on, ready ────────────────▶ idle ──────────▶ off
//!                                                   ▲───── wants_motion ──────┘
//! ```
//!
//! Owns which axes share an output and whether each output is on. An output is up to two pins, one
//! low-active and one high-active, both driven. While it is on because somebody asked for it, or
//! because an axis moves, it does not go off by itself. An output behind a shift register is on
//! when that confirms it.
//!
//! Absent: the pins. [`Enables::poll`] tells which output changes.

use crate::{
    Ticks,
    limits::{CHANNELS, TICKS_PER_US},
};
use core::mem;

/// Most enable outputs: one for each axis of the queue, C and D.
pub const OUTPUTS_MAX: usize = CHANNELS + 2;

/// Axes that an output can serve: those of the queue by number, then C, then D.
pub const ENABLED_AXES: usize = CHANNELS + 2;

/// Longest time from on to the first step: 120 ms.
pub const DELAY_ON_US_MAX: u32 = 120_000;

/// Longest time from rest to off: one hour.
pub const DELAY_OFF_MS_MAX: u32 = 3_600_000;

/// A set of axes, a bit for each.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct AxisSet(u8);

impl AxisSet {
    /// None.
    pub const NONE: Self = Self(0);
    /// C alone.
    pub const C: Self = Self(1 << CHANNELS);
    /// D alone.
    pub const D: Self = Self(2 << CHANNELS);
    /// Those of the queue.
    pub const QUEUE: Self = Self((1 << CHANNELS) - 1);

    /// One axis of the queue.
    ///
    /// # Panics
    /// There is no such axis in any node.
    pub const fn axis(axis: keys::AxisId) -> Self {
        assert!((axis.0 as usize) < CHANNELS, "an axis of the queue");
        Self(1 << axis.0)
    }

    /// Those of both.
    #[must_use]
    pub const fn with(self, others: Self) -> Self {
        Self(self.0 | others.0)
    }

    /// Those that are not in the other.
    #[must_use]
    pub const fn without(self, others: Self) -> Self {
        Self(self.0 & !others.0)
    }

    /// Those that are in both.
    #[must_use]
    pub const fn common(self, others: Self) -> Self {
        Self(self.0 & others.0)
    }

    /// Returns whether both have one in common.
    pub const fn meets(self, others: Self) -> bool {
        self.0 & others.0 != 0
    }

    /// Returns whether there is none.
    pub const fn is_empty(self) -> bool {
        self.0 == 0
    }
}

/// One enable output.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct EnableConfig {
    /// Whose drivers it enables.
    pub axes: AxisSet,
    /// Whether motion switches it on, and rest off.
    pub auto: bool,
    /// From on to the first step, µs, 1 to [`DELAY_ON_US_MAX`].
    pub delay_on_us: u32,
    /// From rest to off, ms, at most [`DELAY_OFF_MS_MAX`].
    pub delay_off_ms: u32,
    /// Whether it counts as on only when [`Enables::confirm`] tells: it is behind a shift register.
    pub external: bool,
}

impl EnableConfig {
    /// On 2 ms before motion, off after a second of rest.
    pub const fn auto(axes: AxisSet) -> Self {
        Self {
            axes,
            auto: true,
            delay_on_us: 2_000,
            delay_off_ms: 1_000,
            external: false,
        }
    }
}

/// Why outputs cannot be.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum EnableError {
    /// More than [`OUTPUTS_MAX`].
    TooMany,
    /// `delay_on_us` is 0.
    DelayOnTooLow,
    /// `delay_on_us` is more than [`DELAY_ON_US_MAX`].
    DelayOnTooHigh,
    /// `delay_off_ms` is more than [`DELAY_OFF_MS_MAX`].
    DelayOffTooHigh,
}

impl core::fmt::Display for EnableError {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        match self {
            Self::TooMany => write!(f, "more than {OUTPUTS_MAX} enable outputs"),
            Self::DelayOnTooLow => write!(f, "the delay after on is at least 1 µs"),
            Self::DelayOnTooHigh => {
                write!(f, "the delay after on is at most {DELAY_ON_US_MAX} µs")
            }
            Self::DelayOffTooHigh => {
                write!(f, "the delay before off is at most {DELAY_OFF_MS_MAX} ms")
            }
        }
    }
}

impl core::error::Error for EnableError {}

/// When motion may begin.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Start {
    /// From then on.
    At(Ticks),
    /// When an output behind a shift register is confirmed: ask again then.
    Unconfirmed,
    /// Not before somebody switches on an output that is not automatic.
    Disabled,
}

/// Why an output stays on.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Moving;

/// An output switches.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct OutputChange {
    /// Index of the output.
    pub output: usize,
    /// Whether it is on now.
    pub on: bool,
}

impl OutputChange {
    /// Returns the levels of its low-active and its high-active pin.
    pub const fn levels(self) -> [bool; 2] {
        [!self.on, self.on]
    }
}

/// Whether an output is on.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum State {
    Off,
    /// Switched on, not confirmed.
    Rising,
    /// On; steps may come from `ready_at` on.
    On {
        ready_at: Ticks,
    },
}

#[derive(Clone, Copy, Debug)]
struct Output {
    config: EnableConfig,
    state: State,
    /// Somebody asked for it.
    held: bool,
    /// What moves or wants to.
    moving: AxisSet,
    /// When it goes off if nothing moves.
    off_at: Option<Ticks>,
    /// What the pins show.
    shown: Option<bool>,
    /// They have to show off first, whatever was asked for since.
    drops: bool,
}

/// The enable outputs of a node. All are off at first, and told so.
#[derive(Clone, Debug)]
pub struct Enables {
    outputs: [Option<Output>; OUTPUTS_MAX],
}

impl Enables {
    /// No output: motion may begin at once.
    pub const NONE: Self = Self {
        outputs: [None; OUTPUTS_MAX],
    };

    /// Takes the outputs by index.
    ///
    /// # Errors
    /// The first that cannot be.
    pub fn new(configs: &[EnableConfig]) -> Result<Self, EnableError> {
        if configs.len() > OUTPUTS_MAX {
            return Err(EnableError::TooMany);
        }
        let mut enables = Self::NONE;
        for (output, config) in enables.outputs.iter_mut().zip(configs) {
            match config.delay_on_us {
                0 => return Err(EnableError::DelayOnTooLow),
                1..=DELAY_ON_US_MAX => {}
                _ => return Err(EnableError::DelayOnTooHigh),
            }
            if config.delay_off_ms > DELAY_OFF_MS_MAX {
                return Err(EnableError::DelayOffTooHigh);
            }
            *output = Some(Output {
                config: *config,
                state: State::Off,
                held: false,
                moving: AxisSet::NONE,
                off_at: None,
                shown: None,
                drops: false,
            });
        }
        Ok(enables)
    }

    /// These axes are to move. Gives the earliest start: that of the last of their outputs. With
    /// [`Start::Disabled`] nothing was switched on.
    pub fn wants_motion(&mut self, axes: AxisSet, now: Ticks) -> Start {
        let disabled = |output: &Output| {
            output.config.axes.meets(axes) && !output.config.auto && output.state == State::Off
        };
        if self.outputs.iter().flatten().any(disabled) {
            return Start::Disabled;
        }
        let mut start = Start::At(now);
        for output in self.outputs.iter_mut().flatten() {
            if !output.config.axes.meets(axes) {
                continue;
            }
            output.moving = output.moving.with(output.config.axes.common(axes));
            output.off_at = None;
            output.switch_on(now);
            start = match (start, output.state) {
                (Start::At(start_at), State::On { ready_at }) => Start::At(start_at.max(ready_at)),
                _ => Start::Unconfirmed,
            };
        }
        start
    }

    /// These axes have come to rest, or will not move after all.
    pub fn rests(&mut self, axes: AxisSet, now: Ticks) {
        for output in self.outputs.iter_mut().flatten() {
            if output.moving.meets(axes) {
                output.moving = output.moving.without(axes);
                output.wait_for_off(now);
            }
        }
    }

    /// Switches on the outputs of these axes, to stay on until [`Enables::disable`].
    pub fn enable(&mut self, axes: AxisSet, now: Ticks) {
        for output in self.outputs.iter_mut().flatten() {
            if output.config.axes.meets(axes) {
                output.held = true;
                output.off_at = None;
                output.switch_on(now);
            }
        }
    }

    /// Switches off the outputs of these axes, now.
    ///
    /// # Errors
    /// An axis of one of them moves; nothing was switched.
    pub fn disable(&mut self, axes: AxisSet) -> Result<(), Moving> {
        let mut outputs = self.outputs.iter().flatten();
        if outputs.any(|output| output.config.axes.meets(axes) && !output.moving.is_empty()) {
            return Err(Moving);
        }
        for output in self.outputs.iter_mut().flatten() {
            if output.config.axes.meets(axes) {
                output.switch_off();
            }
        }
        Ok(())
    }

    /// Switches everything off, whatever moves. Motors lose their place.
    pub fn disable_all(&mut self) {
        for output in self.outputs.iter_mut().flatten() {
            output.switch_off();
        }
    }

    /// An output behind a shift register is on, as it was last told.
    pub fn confirm(&mut self, output: usize, now: Ticks) {
        if let Some(Some(output)) = self.outputs.get_mut(output)
            && output.state == State::Rising
            && output.shown == Some(true)
            && !output.drops
        {
            output.is_on_from(now);
        }
    }

    /// Gives the next output that switches; call it until it gives `None`, and again before steps
    /// that [`Enables::wants_motion`] allowed.
    pub fn poll(&mut self, now: Ticks) -> Option<OutputChange> {
        for (index, output) in self.outputs.iter_mut().enumerate() {
            let Some(output) = output else { continue };
            if output.off_at.is_some_and(|off_at| off_at <= now) {
                output.switch_off();
            }
            let drops = mem::take(&mut output.drops) && output.shown == Some(true);
            let on = output.state != State::Off && !drops;
            if output.shown != Some(on) {
                output.shown = Some(on);
                return Some(OutputChange { output: index, on });
            }
        }
        None
    }

    /// Returns when an output goes off by itself.
    pub fn poll_timeout(&self) -> Option<Ticks> {
        let outputs = self.outputs.iter().flatten();
        outputs.filter_map(|output| output.off_at).min()
    }

    /// Returns whether an output is switched on.
    pub fn is_on(&self, output: usize) -> bool {
        let output = self.outputs.get(output).and_then(Option::as_ref);
        output.is_some_and(|output| output.state != State::Off)
    }
}

impl Output {
    fn switch_on(&mut self, now: Ticks) {
        if self.state != State::Off {
            return;
        }
        if self.config.external {
            self.state = State::Rising;
        } else {
            self.is_on_from(now);
        }
    }

    fn is_on_from(&mut self, now: Ticks) {
        let ticks = u64::from(self.config.delay_on_us) * TICKS_PER_US;
        let ready_at = now.plus(ticks);
        self.state = State::On { ready_at };
    }

    fn switch_off(&mut self) {
        self.drops |= self.state != State::Off;
        self.state = State::Off;
        self.held = false;
        self.moving = AxisSet::NONE;
        self.off_at = None;
    }

    fn wait_for_off(&mut self, now: Ticks) {
        if self.config.auto && !self.held && self.moving.is_empty() {
            let ticks = u64::from(self.config.delay_off_ms) * 1_000 * TICKS_PER_US;
            self.off_at = Some(now.plus(ticks));
        }
    }
}

#[cfg(test)]
mod tests {
    extern crate std;

    use super::*;
    use keys::AxisId;
    use std::{string::ToString, vec, vec::Vec};

    const X: AxisSet = AxisSet::axis(AxisId(0));
    const Y: AxisSet = AxisSet::axis(AxisId(1));
    const Z: AxisSet = AxisSet::axis(AxisId(2));

    const fn us(us: u64) -> Ticks {
        Ticks(us * TICKS_PER_US)
    }

    fn changes(enables: &mut Enables, now: Ticks) -> Vec<(usize, bool)> {
        std::iter::from_fn(|| enables.poll(now))
            .map(|change| (change.output, change.on))
            .collect()
    }

    /// One output, off and told so.
    fn one(config: EnableConfig) -> Enables {
        let mut enables = Enables::new(&[config]).expect("legal");
        assert_eq!(changes(&mut enables, us(0)), [(0, false)], "off at first");
        enables
    }

    #[test]
    fn delays_are_bounded() {
        let on = |delay_on_us| {
            Enables::new(&[EnableConfig {
                delay_on_us,
                ..EnableConfig::auto(X)
            }])
            .err()
        };
        assert_eq!(on(0), Some(EnableError::DelayOnTooLow));
        assert_eq!((on(1), on(DELAY_ON_US_MAX)), (None, None));
        assert_eq!(on(DELAY_ON_US_MAX + 1), Some(EnableError::DelayOnTooHigh));
        let off = |delay_off_ms| {
            Enables::new(&[EnableConfig {
                delay_off_ms,
                ..EnableConfig::auto(X)
            }])
            .err()
        };
        assert_eq!((off(0), off(DELAY_OFF_MS_MAX)), (None, None));
        assert_eq!(
            off(DELAY_OFF_MS_MAX + 1),
            Some(EnableError::DelayOffTooHigh)
        );
        let many = vec![EnableConfig::auto(X); OUTPUTS_MAX + 1];
        assert_eq!(Enables::new(&many).err(), Some(EnableError::TooMany));
        assert!(Enables::new(&many[1..]).is_ok());
        for error in [
            EnableError::TooMany,
            EnableError::DelayOnTooLow,
            EnableError::DelayOnTooHigh,
            EnableError::DelayOffTooHigh,
        ] {
            assert!(!error.to_string().is_empty());
        }
    }

    #[test]
    fn both_pins_show_the_same_in_their_own_way() {
        let levels = |on| OutputChange { output: 0, on }.levels();
        assert_eq!(levels(true), [false, true]);
        assert_eq!(levels(false), [true, false]);
    }

    #[test]
    fn motion_switches_on_and_begins_after_the_delay() {
        let mut enables = one(EnableConfig::auto(X));
        assert_eq!(enables.wants_motion(X, us(100)), Start::At(us(2_100)));
        assert!(enables.is_on(0));
        assert_eq!(changes(&mut enables, us(100)), [(0, true)]);
        // Asked again: not later.
        assert_eq!(enables.wants_motion(X, us(1_100)), Start::At(us(2_100)));
        assert_eq!(enables.wants_motion(X, us(9_000)), Start::At(us(9_000)));
        assert_eq!(changes(&mut enables, us(9_000)), []);
        // It does not go off in motion.
        assert_eq!(enables.poll_timeout(), None);
        assert_eq!(changes(&mut enables, us(9_000_000_000)), []);
    }

    #[test]
    fn rest_switches_off_after_the_delay_and_not_a_tick_before() {
        let mut enables = one(EnableConfig::auto(X));
        enables.wants_motion(X, us(0));
        assert_eq!(changes(&mut enables, us(0)), [(0, true)]);
        enables.rests(X, us(5_000));
        let due = us(1_005_000);
        assert_eq!(enables.poll_timeout(), Some(due));
        assert_eq!(changes(&mut enables, Ticks(due.0 - 1)), []);
        assert_eq!(changes(&mut enables, due), [(0, false)]);
        assert_eq!(enables.poll_timeout(), None);
        assert_eq!(enables.wants_motion(X, due), Start::At(due.plus(32_000)));
        assert_eq!(changes(&mut enables, due), [(0, true)]);
    }

    #[test]
    fn motion_within_the_delay_keeps_it_on_and_needs_no_delay() {
        let mut enables = one(EnableConfig::auto(X));
        enables.wants_motion(X, us(0));
        changes(&mut enables, us(0));
        enables.rests(X, us(5_000));
        assert_eq!(enables.wants_motion(X, us(900_000)), Start::At(us(900_000)));
        assert_eq!(enables.poll_timeout(), None);
        // Also when it is due but the pins were not told: they are still on.
        enables.rests(X, us(1_000_000));
        let late = us(3_000_000);
        assert_eq!(enables.wants_motion(X, late), Start::At(late));
        assert_eq!(changes(&mut enables, late), []);
        // A second rest of an axis that rests does not put it off.
        enables.rests(X, late);
        enables.rests(X, us(3_500_000));
        assert_eq!(enables.poll_timeout(), Some(us(4_000_000)));
    }

    #[test]
    fn a_shared_output_waits_for_all_of_its_axes() {
        let mut enables = one(EnableConfig::auto(X.with(Y)));
        assert_eq!(enables.wants_motion(X, us(0)), Start::At(us(2_000)));
        assert_eq!(enables.wants_motion(Y, us(500)), Start::At(us(2_000)));
        assert_eq!(changes(&mut enables, us(500)), [(0, true)]);
        enables.rests(X, us(10_000));
        assert_eq!(enables.poll_timeout(), None);
        assert_eq!(enables.disable(X), Err(Moving), "Y moves");
        enables.rests(Y, us(20_000));
        assert_eq!(enables.poll_timeout(), Some(us(1_020_000)));
        let start = enables.wants_motion(Z, us(30_000));
        assert_eq!(start, Start::At(us(30_000)));
        assert_eq!(enables.poll_timeout(), Some(us(1_020_000)), "Z has none");
    }

    #[test]
    fn axes_that_start_together_wait_for_the_last_of_their_outputs() {
        let slow = EnableConfig {
            delay_on_us: DELAY_ON_US_MAX,
            ..EnableConfig::auto(Y)
        };
        let other = EnableConfig::auto(AxisSet::C.with(AxisSet::D));
        let mut enables = Enables::new(&[EnableConfig::auto(X), slow, other]).expect("legal");
        changes(&mut enables, us(0));
        let start = enables.wants_motion(X.with(Y), us(1_000));
        assert_eq!(start, Start::At(us(121_000)));
        assert_eq!(changes(&mut enables, us(1_000)), [(0, true), (1, true)]);
        assert_eq!(enables.wants_motion(X, us(5_000)), Start::At(us(5_000)));
        let start = enables.wants_motion(AxisSet::D, us(5_000));
        assert_eq!(start, Start::At(us(7_000)));
        assert_eq!(
            enables.wants_motion(AxisSet::NONE, us(5_001)),
            Start::At(us(5_001))
        );
        assert!(!AxisSet::QUEUE.meets(AxisSet::C.with(AxisSet::D)));
        assert!(AxisSet::QUEUE.meets(AxisSet::axis(AxisId(3))));
    }

    #[test]
    fn what_somebody_switched_on_stays_on_until_somebody_switches_it_off() {
        let mut enables = one(EnableConfig::auto(X));
        enables.enable(X, us(0));
        assert_eq!(changes(&mut enables, us(0)), [(0, true)]);
        assert_eq!(enables.wants_motion(X, us(500)), Start::At(us(2_000)));
        enables.rests(X, us(5_000));
        assert_eq!(enables.poll_timeout(), None);
        assert_eq!(enables.disable(X), Ok(()));
        assert_eq!(changes(&mut enables, us(9_000_000)), [(0, false)]);
        // Automatic again.
        enables.wants_motion(X, us(10_000_000));
        enables.rests(X, us(10_000_000));
        assert_eq!(enables.poll_timeout(), Some(us(11_000_000)));
        // Somebody wants it just before it goes off.
        enables.enable(X, us(10_999_999));
        assert_eq!(enables.poll_timeout(), None);
    }

    #[test]
    fn an_output_that_is_not_automatic_refuses_motion_until_it_is_on() {
        let manual = EnableConfig {
            auto: false,
            ..EnableConfig::auto(X)
        };
        let mut enables = Enables::new(&[manual, EnableConfig::auto(Y)]).expect("legal");
        assert_eq!(changes(&mut enables, us(0)), [(0, false), (1, false)]);
        assert_eq!(enables.wants_motion(X.with(Y), us(0)), Start::Disabled);
        assert_eq!(changes(&mut enables, us(0)), [], "nothing half-taken");
        enables.enable(X, us(0));
        let start = enables.wants_motion(X.with(Y), us(100));
        assert_eq!(start, Start::At(us(2_100)));
        assert_eq!(changes(&mut enables, us(100)), [(0, true), (1, true)]);
        enables.rests(X.with(Y), us(5_000));
        let due = enables.poll_timeout().expect("the automatic one");
        assert_eq!(changes(&mut enables, due), [(1, false)]);
        assert_eq!(enables.poll_timeout(), None);
        assert!(enables.is_on(0));
    }

    #[test]
    fn an_external_output_is_on_when_it_is_confirmed() {
        let mut enables = one(EnableConfig {
            external: true,
            ..EnableConfig::auto(X)
        });
        enables.confirm(0, us(0));
        assert_eq!(enables.wants_motion(X, us(100)), Start::Unconfirmed);
        enables.confirm(0, us(101));
        let start = enables.wants_motion(X, us(102));
        assert_eq!(start, Start::Unconfirmed, "the pins were not told");
        assert_eq!(changes(&mut enables, us(200)), [(0, true)]);
        assert_eq!(enables.wants_motion(X, us(4_000)), Start::Unconfirmed);
        enables.confirm(0, us(5_000));
        assert_eq!(enables.poll_timeout(), None, "X still wants");
        assert_eq!(enables.wants_motion(X, us(5_500)), Start::At(us(7_000)));
        enables.confirm(0, us(6_000));
        enables.confirm(7, us(6_000));
        assert_eq!(enables.wants_motion(X, us(6_500)), Start::At(us(7_000)));
        // Given up before it was confirmed: it goes off all the same.
        enables.disable_all();
        assert_eq!(changes(&mut enables, us(8_000)), [(0, false)]);
        assert_eq!(enables.wants_motion(X, us(8_000)), Start::Unconfirmed);
        assert_eq!(changes(&mut enables, us(8_000)), [(0, true)]);
        enables.rests(X, us(9_000));
        assert_eq!(enables.poll_timeout(), Some(us(1_009_000)));
        assert_eq!(changes(&mut enables, us(1_009_000)), [(0, false)]);
    }

    #[test]
    fn each_output_waits_for_its_own_axes_only() {
        let configs = [EnableConfig::auto(X), EnableConfig::auto(Y)];
        let mut enables = Enables::new(&configs).expect("legal");
        enables.wants_motion(X.with(Y), us(0));
        assert_eq!(changes(&mut enables, us(0)), [(0, true), (1, true)]);
        enables.rests(X, us(1_000));
        assert_eq!(changes(&mut enables, us(1_001_000)), [(0, false)]);
        assert_eq!(enables.disable(X), Ok(()));
        assert_eq!(enables.disable(Y), Err(Moving));
        enables.rests(Y, us(1_002_000));
        enables.wants_motion(X, us(1_003_000));
        enables.rests(X, us(1_004_000));
        assert_eq!(enables.poll_timeout(), Some(us(2_002_000)), "the first");
    }

    #[test]
    fn an_off_that_was_asked_for_is_shown_even_if_on_is_asked_for_at_once() {
        for external in [false, true] {
            let mut enables = one(EnableConfig {
                external,
                ..EnableConfig::auto(X)
            });
            enables.enable(X, us(0));
            assert_eq!(changes(&mut enables, us(0)), [(0, true)]);
            enables.confirm(0, us(1));
            assert_eq!(enables.disable(X), Ok(()));
            enables.enable(X, us(10));
            enables.confirm(0, us(11));
            assert_eq!(changes(&mut enables, us(10)), [(0, false), (0, true)]);
            // Off twice is off once.
            assert_eq!(enables.disable(X), Ok(()));
            assert_eq!(enables.disable(X), Ok(()));
            enables.enable(X, us(10));
            assert_eq!(changes(&mut enables, us(10)), [(0, false), (0, true)]);
            // On and off before either is shown is nothing to show.
            assert_eq!(enables.disable(X), Ok(()));
            assert_eq!(changes(&mut enables, us(10)), [(0, false)]);
            enables.enable(X, us(11));
            assert_eq!(enables.disable(X), Ok(()));
            assert_eq!(changes(&mut enables, us(12)), []);
            enables.enable(X, us(13));
            assert_eq!(changes(&mut enables, us(13)), [(0, true)]);
        }
    }

    #[test]
    fn everything_goes_off_at_once_whatever_moves() {
        let configs = [EnableConfig::auto(X), EnableConfig::auto(Y)];
        let mut enables = Enables::new(&configs).expect("legal");
        changes(&mut enables, us(0));
        enables.wants_motion(X, us(0));
        enables.enable(Y, us(0));
        assert_eq!(changes(&mut enables, us(0)), [(0, true), (1, true)]);
        assert_eq!(enables.disable(X.with(Y)), Err(Moving));
        assert!(enables.is_on(0) && enables.is_on(1), "nothing half-taken");
        enables.disable_all();
        assert_eq!(changes(&mut enables, us(1)), [(0, false), (1, false)]);
        // A rest that is told late switches nothing.
        enables.rests(X, us(2));
        assert_eq!(enables.poll_timeout(), None);
        assert_eq!(
            Enables::NONE.clone().wants_motion(X, us(7)),
            Start::At(us(7))
        );
    }
}
