//! C and D on a bench of their own.

extern crate std;

use super::*;
use crate::Ticks;
use crate::limits::TICKS_PER_US;
use std::string::{String, ToString};

const fn ms(ms: u64) -> Ticks {
    Ticks(ms * 1_000 * TICKS_PER_US)
}

fn c() -> PositionsC {
    PositionsC::new(ConfigC::default()).expect("legal")
}

/// C at rest on a position.
fn c_at(index: usize) -> PositionsC {
    let mut c = c();
    let steps = c.steps_at(index).expect("a position");
    assert_eq!(c.goto(index as i64, steps), Ok(GoC::default()));
    assert_eq!(c.index(), Some(index));
    c
}

fn d() -> SwitchD {
    SwitchD::new(ConfigD::default()).expect("legal")
}

fn text(c: &PositionsC, c_position_steps: i64, d: &SwitchD) -> String {
    StatusCd {
        c,
        c_position_steps,
        d,
    }
    .to_string()
}

fn run(to_steps: i64, steps: i64, rate_hz: u32) -> GoC {
    GoC {
        at: None,
        run: Some(RunC {
            to_steps,
            steps,
            rate_hz,
        }),
    }
}

#[test]
fn each_position_has_its_place_and_its_speed() {
    // 80 steps/mm: 10 mm/s are 800 Hz.
    let table = [
        ("HOME", 0, 800),
        ("POS1", 2_000, 1_600),
        ("POS2", 4_000, 1_600),
        ("POS3", 6_000, 1_600),
        ("MAX", 8_000, 800),
    ];
    for (index, (name, steps, rate_hz)) in table.into_iter().enumerate() {
        for from in [-7, 3_210, 9_000] {
            let mut c = c();
            assert_eq!(c.steps_at(index), Some(steps));
            let went = c.goto(index as i64, from);
            assert_eq!(went, Ok(run(steps, steps - from, rate_hz)));
            assert_eq!(c.index(), None, "known on arrival only");
            assert!(c.is_moving());
            let moving = text(&c, from, &d());
            assert!(moving.starts_with("C: MOVING ("), "{moving}");
            c.rest(steps);
            assert_eq!((c.index(), c.is_moving()), (Some(index), false));
            let there = text(&c, steps, &d());
            assert!(there.starts_with(&std::format!("C: {name} (")), "{there}");
            let again = c.goto(index as i64, steps);
            assert_eq!(again, Ok(GoC::default()), "it is there");
        }
    }
    assert_eq!(c().steps_at(5), None);
}

#[test]
fn a_position_that_is_none_is_refused_and_nothing_moves() {
    for index in [5, -1, 256, i64::MIN, i64::MAX] {
        let mut c = c_at(2);
        let refused = c.goto(index, 4_000).expect_err("there is none");
        assert_eq!(refused.to_string(), "Invalid C position (0-4)");
        assert_eq!((c.index(), c.is_moving()), (Some(2), false));
    }
}

#[test]
fn one_run_at_a_time() {
    let mut c = c_at(0);
    assert_eq!(c.goto(3, 0), Ok(run(6_000, 6_000, 1_600)));
    assert_eq!(c.goto(1, 100), Err(GotoError::Busy));
    assert_eq!(c.goto(9, 100), Err(GotoError::Position));
    c.rest(6_000);
    assert_eq!(c.index(), Some(3));
    assert!(!GotoError::Busy.to_string().is_empty());
}

#[test]
fn a_stop_between_two_places_leaves_none() {
    let mut c = c_at(1);
    assert_eq!(c.goto(2, 2_000), Ok(run(4_000, 2_000, 1_600)));
    c.rest(3_999);
    assert_eq!((c.index(), c.is_moving()), (None, false));
    assert_eq!(text(&c, 3_999, &d()), "C: UNKNOWN (50.0mm) D: UNKNOWN");
    c.rest(4_000);
    assert_eq!(c.index(), None, "it did not go there");
    assert_eq!(c.goto(2, 3_999), Ok(run(4_000, 1, 1_600)));
    c.rest(4_000);
    assert_eq!(c.index(), Some(2));
}

#[test]
fn from_pos3_to_home_ends_at_0_with_and_without_the_limit() {
    let mut c = c_at(3);
    assert_eq!(c.goto(0, 6_000), Ok(run(0, -6_000, 800)));
    c.rest(0);
    assert_eq!(c.index(), Some(0));
    assert_eq!(text(&c, 0, &d()), "C: HOME (0.0mm) D: UNKNOWN");
    // The limit comes at any count: at -0.3 mm, before 0, or where it should be.
    for _count in [-24, 24, 0, 5_999] {
        let mut c = c_at(3);
        assert_eq!(c.goto(0, 6_000), Ok(run(0, -6_000, 800)));
        let at = c.limit(Switch::Min, true);
        assert_eq!(at, Some(AtLimit { position_steps: 0 }));
        assert_eq!(c.index(), Some(0));
        c.rest(0);
        assert_eq!((c.index(), c.is_moving()), (Some(0), false));
    }
}

#[test]
fn the_high_limit_is_the_last_position() {
    let mut c = c_at(0);
    assert_eq!(c.goto(3, 0), Ok(run(6_000, 6_000, 1_600)));
    let at = c.limit(Switch::Max, true);
    let position_steps = 8_000;
    assert_eq!(at, Some(AtLimit { position_steps }));
    assert_eq!(c.index(), Some(4));
    assert_eq!(text(&c, 8_000, &d()), "C: MAX (100.0mm) D: UNKNOWN");
    // From there it may go down, and the switch that it leaves may bounce.
    assert_eq!(c.goto(3, 8_000), Ok(run(6_000, -2_000, 1_600)));
    for active in [false, true, false, true, false] {
        assert_eq!(c.limit(Switch::Max, active), None);
        assert!(c.is_moving());
    }
    c.rest(6_000);
    assert_eq!(c.index(), Some(3));
    assert_eq!(c.limit(Switch::Home, true), None, "C has none");
}

#[test]
fn a_limit_that_is_pressed_knows_better_than_the_count() {
    // At boot, and by hand.
    let mut boot = c();
    let position_steps = 0;
    let at = Some(AtLimit { position_steps });
    assert_eq!(boot.limit(Switch::Min, true), at);
    assert_eq!(boot.index(), Some(0));

    // Left, and stopped before the switch let go: not against the switch again.
    assert_eq!(boot.goto(1, 0), Ok(run(2_000, 2_000, 1_600)));
    boot.rest(5);
    let there = GoC { at, run: None };
    assert_eq!(boot.goto(0, 5), Ok(there));
    assert_eq!(boot.index(), Some(0));

    // The count is 3 mm wrong: from the limit's place, down.
    let mut high = c_at(2);
    let position_steps = 8_000;
    let at = Some(AtLimit { position_steps });
    assert_eq!(high.limit(Switch::Max, true), at);
    let down = GoC {
        at,
        ..run(6_000, -2_000, 1_600)
    };
    assert_eq!(high.goto(3, 5_760), Ok(down));

    let mut both = c_at(2);
    both.limit(Switch::Min, true);
    assert_eq!(both.limit(Switch::Max, true), None, "which one?");
    assert_eq!(both.goto(1, 4_000), Err(GotoError::Limits));
    assert!(!both.is_moving());
    assert!(!GotoError::Limits.to_string().is_empty());
}

#[test]
fn d_runs_to_its_limit() {
    for (on, switch, way) in [
        (true, Switch::Max, Direction::Positive),
        (false, Switch::Min, Direction::Negative),
    ] {
        let mut d = d();
        assert_eq!(d.is_on(), None, "nobody knows at boot");
        let rate_hz = 2_000;
        assert_eq!(d.go(on, ms(5)), Ok(Some(RunD { way, rate_hz })));
        assert_eq!((d.is_on(), d.is_moving()), (None, true));
        assert_eq!(d.go(on, ms(6)), Err(BusyD));
        assert_eq!(d.limit(switch, true), Some(EndD::Arrived));
        assert_eq!((d.is_on(), d.is_moving()), (Some(on), false));
        assert_eq!(d.poll_timeout(), None);
        assert_eq!(d.poll(ms(999_999)), None);
        assert_eq!(d.go(on, ms(7)), Ok(None), "it is there");
        assert!(text(&c_at(0), 0, &d).ends_with(if on { "D: ON" } else { "D: OFF" }));
    }
}

#[test]
fn a_limit_that_does_not_come_is_told() {
    let mut off = d();
    assert!(off.go(false, ms(0)).is_ok());
    assert_eq!(off.poll(ms(2_250)), Some(EndD::NotReached));
    let mut d = d();
    assert!(d.go(true, ms(100)).is_ok());
    // 50 mm at 25 mm/s and an eighth.
    assert_eq!(d.poll_timeout(), Some(ms(100 + 2_250)));
    assert_eq!(d.poll(ms(2_349)), None);
    assert_eq!(d.poll(ms(2_350)), Some(EndD::NotReached));
    assert_eq!((d.is_on(), d.is_moving()), (None, false));
    assert_eq!(text(&c_at(0), 0, &d), "C: HOME (0.0mm) D: UNKNOWN");
    assert!(d.go(true, ms(5_000)).is_ok_and(|run| run.is_some()));
}

#[test]
fn without_a_limit_the_time_of_the_way_decides() {
    let mut d = SwitchD::new(ConfigD {
        has_max: false,
        ..ConfigD::default()
    })
    .expect("legal");
    assert!(d.go(true, ms(0)).is_ok());
    assert_eq!(d.poll_timeout(), Some(ms(2_000)));
    assert_eq!(d.poll(Ticks(ms(2_000).0 - 1)), None);
    assert_eq!(d.poll(ms(2_000)), Some(EndD::Arrived));
    assert_eq!(d.is_on(), Some(true));
}

#[test]
fn limits_of_d_that_bounce_or_contradict_do_no_harm() {
    let mut d = d();
    assert_eq!(d.limit(Switch::Min, true), Some(EndD::Arrived));
    assert_eq!(d.is_on(), Some(false));
    assert!(d.go(true, ms(0)).is_ok_and(|run| run.is_some()));
    for active in [false, true, false, true, false] {
        assert_eq!(d.limit(Switch::Min, active), None);
        assert!(d.is_moving());
    }
    d.stop();
    assert_eq!((d.is_on(), d.is_moving()), (None, false));
    assert_eq!(d.poll_timeout(), None);
    // Back before the switch had let go: it is there.
    assert_eq!(d.limit(Switch::Min, true), Some(EndD::Arrived));
    d.stop();
    assert_eq!(d.is_on(), Some(false), "it rested");
    assert_eq!(d.go(false, ms(1)), Ok(None));
    assert_eq!(d.limit(Switch::Max, true), None, "which one?");
    assert_eq!(d.go(true, ms(2)), Err(BusyD));
    assert_eq!(d.limit(Switch::Home, true), None, "D has none");
}

#[test]
fn the_rate_of_d_is_clamped_and_its_time_follows() {
    let d = |speed_um_per_s, steps_per_m| {
        let mut d = SwitchD::new(ConfigD {
            speed_um_per_s,
            steps_per_m,
            has_min: false,
            ..ConfigD::default()
        })
        .expect("legal");
        let run = d.go(false, ms(0)).expect("free").expect("not there");
        (run.rate_hz, d.poll_timeout().expect("it moves"))
    };
    assert_eq!(d(25_000, 80_000), (2_000, ms(2_000)));
    // 1 MHz wanted: 500,000 steps of way at 40 kHz are 12.5 s.
    assert_eq!(d(100_000, 10_000_000), (40_000, ms(12_500)));
    // 0.001 Hz wanted: 4,000 steps a metre are 200 steps of way at 1 Hz.
    assert_eq!(d(1, 4_000), (1, ms(200_000)));
    // 214 km of way at 40 kHz: no overflow.
    let mut far = SwitchD::new(ConfigD {
        travel_um: u32::MAX,
        steps_per_m: STEPS_PER_M_MAX,
        ..ConfigD::default()
    })
    .expect("legal");
    assert!(far.go(true, Ticks(u64::MAX)).is_ok());
    assert_eq!(far.poll_timeout(), Some(Ticks(u64::MAX)));
}

#[test]
fn a_rate_of_0_is_rest_and_divides_nothing() {
    assert_eq!(interval_ticks(0), None);
    assert_eq!(interval_ticks(1), Some(TICK_HZ));
    assert_eq!(interval_ticks(D_HZ_MAX), Some(400));
    assert_eq!(interval_ticks(30_000), Some(534), "never faster than told");
    assert!(interval_ticks(u32::MAX).is_some_and(|ticks| ticks > 0));
    // After a stop nothing asks for a rate: no run is under way, and none begins by itself.
    let mut d = d();
    assert!(d.go(true, ms(0)).is_ok());
    d.stop();
    assert_eq!((d.poll(ms(99_999)), d.poll_timeout()), (None, None));
    assert!(!d.is_moving());
}

#[test]
fn the_status_is_one_line_in_tenths_of_a_mm() {
    let d = {
        let mut d = d();
        d.limit(Switch::Max, true);
        d
    };
    let c = c_at(2);
    for (steps, words) in [
        (4_000, "C: POS2 (50.0mm) D: ON"),
        (4_003, "C: POS2 (50.0mm) D: ON"),
        (4_004, "C: POS2 (50.1mm) D: ON"),
        (3, "C: POS2 (0.0mm) D: ON"),
        (-3, "C: POS2 (0.0mm) D: ON"),
        (-4, "C: POS2 (-0.1mm) D: ON"),
        (-24, "C: POS2 (-0.3mm) D: ON"),
        (-8_024, "C: POS2 (-100.3mm) D: ON"),
        (i64::MIN, "C: POS2 (-115292150460684697.6mm) D: ON"),
    ] {
        assert_eq!(text(&c, steps, &d), words, "{steps}");
    }
}

#[test]
fn d_off_then_c_to_2_then_d_on() {
    let (mut c, mut d) = (c_at(0), d());
    d.limit(Switch::Max, true);
    assert!(d.go(false, ms(0)).is_ok_and(|run| run.is_some()));
    d.limit(Switch::Max, false);
    assert_eq!(d.limit(Switch::Min, true), Some(EndD::Arrived));
    assert_eq!(text(&c, 0, &d), "C: HOME (0.0mm) D: OFF");
    assert_eq!(c.goto(2, 0), Ok(run(4_000, 4_000, 1_600)));
    assert_eq!(text(&c, 1_000, &d), "C: MOVING (12.5mm) D: OFF");
    c.rest(4_000);
    assert!(d.go(true, ms(9_000)).is_ok_and(|run| run.is_some()));
    assert_eq!(text(&c, 4_000, &d), "C: POS2 (50.0mm) D: MOVING");
    d.limit(Switch::Min, false);
    assert_eq!(d.limit(Switch::Max, true), Some(EndD::Arrived));
    assert_eq!(text(&c, 4_000, &d), "C: POS2 (50.0mm) D: ON");
}

#[test]
fn steps_round_to_the_nearest_and_rates_down() {
    assert_eq!(steps_of(25_000, 80_000), 2_000);
    assert_eq!(steps_of(1, 499_999), 0);
    assert_eq!(steps_of(1, 500_000), 1);
    assert_eq!(steps_of(-1, 499_999), 0);
    assert_eq!(steps_of(-1, 500_000), -1);
    assert_eq!(steps_of(i32::MIN, u32::MAX), -9_223_372_034_707);
    assert_eq!(rate_of(1_999, 1_000), 1);
    assert_eq!(rate_of(999, 1_000), 0);
}

#[test]
fn what_cannot_be_is_refused() {
    let c = |change: fn(&mut ConfigC)| {
        let mut config = ConfigC::default();
        change(&mut config);
        PositionsC::new(config).err()
    };
    let scale = Some(NamedConfigError::Scale);
    assert_eq!(c(|_| {}), None);
    assert_eq!(c(|config| config.steps_per_m = 0), scale);
    assert_eq!(c(|config| config.steps_per_m = u32::MAX), scale);
    let order = Some(NamedConfigError::Order { index: 3 });
    assert_eq!(c(|config| config.positions[3].position_um = 50_000), order);
    assert_eq!(c(|config| config.positions[3].position_um = 50_006), order);
    assert_eq!(c(|config| config.positions[3].position_um = 50_007), None);
    let slow = Some(NamedConfigError::Speed { index: 0 });
    assert_eq!(c(|config| config.positions[0].speed_um_per_s = 0), slow);
    assert_eq!(c(|config| config.positions[0].speed_um_per_s = 12), slow);
    assert_eq!(c(|config| config.positions[0].speed_um_per_s = 13), None);
    let fast = Some(NamedConfigError::Speed { index: 1 });
    assert_eq!(
        c(|config| config.positions[1].speed_um_per_s = 2_500_013),
        fast
    );
    let d = |change: fn(&mut ConfigD)| {
        let mut config = ConfigD::default();
        change(&mut config);
        SwitchD::new(config).err()
    };
    assert_eq!(d(|_| {}), None);
    assert_eq!(d(|config| config.steps_per_m = 0), scale);
    let travel = Some(NamedConfigError::Travel);
    assert_eq!(d(|config| config.travel_um = 0), travel);
    assert_eq!(d(|config| config.speed_um_per_s = 0), slow);
    for error in [scale, order, slow, travel].into_iter().flatten() {
        assert!(!error.to_string().is_empty());
    }
}
