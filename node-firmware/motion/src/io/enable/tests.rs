//! Enable pins: delays, sharing, and what a stop leaves on.

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
