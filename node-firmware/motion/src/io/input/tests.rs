//! Inputs that bounce.

extern crate std;

use super::*;
use std::{vec, vec::Vec};

const fn us(us: u64) -> Ticks {
    Ticks(us * TICKS_PER_US)
}

/// Plays edges (µs, level), polling at each deadline, then up to `end`.
fn play(pin: &mut Debounce, edges: &[(u64, bool)], end: u64) -> Vec<(bool, u64)> {
    let mut found = Vec::new();
    let tell = |change: Change| (change.active, change.at.0 / TICKS_PER_US);
    for (at, level) in edges {
        while let Some(due) = pin.poll_timeout().filter(|due| *due <= us(*at)) {
            found.extend(pin.poll(due).map(tell));
        }
        found.extend(pin.level(*level, us(*at)).map(tell));
    }
    while let Some(due) = pin.poll_timeout().filter(|due| *due <= us(end)) {
        found.extend(pin.poll(due).map(tell));
    }
    found
}

fn debounce(active_us: u32, inactive_us: u32) -> Debounce {
    let filter = Filter {
        active_us,
        inactive_us,
    };
    Debounce::new(filter, false, false, us(0))
}

#[test]
fn a_level_counts_when_it_has_held_and_from_its_edge() {
    let mut pin = debounce(20, 50);
    assert_eq!(pin.level(true, us(100)).count(), 0);
    assert_eq!(pin.poll_timeout(), Some(us(120)));
    assert_eq!(pin.poll(Ticks(us(120).0 - 1)), None);
    assert!(!pin.is_active());
    let (active, at) = (true, us(100));
    assert_eq!(pin.poll(us(120)), Some(Change { active, at }));
    assert!(pin.is_active());
    assert_eq!((pin.poll(us(500)), pin.poll_timeout()), (None, None));
    assert_eq!(play(&mut pin, &[(600, false)], 649), []);
    assert_eq!(play(&mut pin, &[], 650), [(false, 600)]);
}

#[test]
fn bounce_and_glitches_shorter_than_the_filter_do_not_count() {
    let bounce = [
        (100, true),
        (110, false),
        (115, true),
        (130, false),
        (140, true),
    ];
    assert_eq!(
        play(&mut debounce(20, 50), &bounce, 1_000),
        [(true, 140)],
        "from the last edge"
    );
    assert_eq!(
        play(&mut debounce(20, 50), &[(100, true), (119, false)], 1_000),
        [],
        "a glitch"
    );
    assert_eq!(
        play(&mut debounce(20, 50), &[(100, true), (120, false)], 1_000),
        [(true, 100), (false, 120)],
        "just long enough"
    );
}

#[test]
fn a_switch_that_acts_at_once_acts_on_the_first_edge_and_only_once() {
    let mut pin = debounce(0, 5_000);
    let first: Vec<_> = pin.level(true, us(100)).collect();
    let active = true;
    assert_eq!(
        first,
        [Change {
            active,
            at: us(100)
        }]
    );
    let bounce: Vec<_> = (1..200).map(|n| (100 + 20 * n, n % 2 == 0)).collect();
    assert_eq!(play(&mut pin, &bounce, 20_000), [(false, 4_080)]);
}

#[test]
fn a_late_call_loses_nothing() {
    let mut pin = debounce(0, 50);
    assert_eq!(pin.level(true, us(10)).count(), 1);
    assert_eq!(pin.level(false, us(20)).count(), 0);
    // Nobody polled at 70.
    let both: Vec<_> = pin.level(true, us(500)).collect();
    let change = |active, at| Change { active, at: us(at) };
    assert_eq!(both, [change(false, 20), change(true, 500)]);
}

#[test]
fn polarity_and_the_first_level_are_taken_as_they_are() {
    for active_low in [false, true] {
        for level in [false, true] {
            let mut pin = Debounce::new(Filter::default(), active_low, level, us(7));
            let active = level != active_low;
            assert_eq!(pin.is_active(), active);
            assert_eq!((pin.poll(us(1_000_000)), pin.poll_timeout()), (None, None));
            let changes = play(&mut pin, &[(1_000_000, !level)], 2_000_000);
            assert_eq!(changes, [(!active, 1_000_000)]);
        }
    }
}

#[test]
fn time_does_not_go_back_and_a_repeated_level_is_no_edge() {
    let mut pin = debounce(20, 20);
    assert_eq!(
        play(&mut pin, &[(100, true), (110, true)], 121),
        [(true, 100)]
    );
    let mut pin = debounce(20, 20);
    assert_eq!(pin.poll(us(200)), None);
    assert_eq!(pin.level(true, us(100)).count(), 0);
    assert_eq!(pin.poll_timeout(), Some(us(220)));
    let mut far = debounce(u32::MAX, 0);
    assert_eq!(far.level(true, us(0)).count(), 0);
    assert_eq!(far.poll_timeout(), Some(us(u64::from(FILTER_US_MAX))));
    let mut end = Debounce::new(Filter::default(), false, false, Ticks(u64::MAX));
    assert_eq!(end.level(true, Ticks(u64::MAX)).count(), 1, "no overflow");
}

#[test]
fn random_edges_count_exactly_when_a_level_has_held() {
    for seed in 0..300_u64 {
        let mut state = seed;
        let mut random = |below: u64| {
            state = state.wrapping_add(0x9e37_79b9_7f4a_7c15);
            let mut mixed = (state ^ state >> 30).wrapping_mul(0xbf58_476d_1ce4_e5b9);
            mixed = (mixed ^ mixed >> 27).wrapping_mul(0x94d0_49bb_1331_11eb);
            (mixed ^ mixed >> 31) % below
        };
        let times = [random(40), random(40)];
        let mut level = false;
        let mut at = 1;
        let mut edges = Vec::new();
        for _ in 0..100 {
            level = !level;
            edges.push((at, level));
            at += 1 + random(60);
        }
        let end = at + 100;
        // By hand: an edge counts if it changes what counts and the level holds long enough.
        let mut expected = Vec::new();
        let mut counts = false;
        for (index, (at, level)) in edges.iter().enumerate() {
            let until = edges.get(index + 1).map_or(end, |next| next.0);
            if *level != counts && until - at >= times[usize::from(!level)] {
                counts = *level;
                expected.push((counts, *at));
            }
        }
        let mut pin = debounce(times[0] as u32, times[1] as u32);
        assert_eq!(play(&mut pin, &edges, end), expected, "seed {seed}");
        // The same without a poll between the edges.
        let mut pin = debounce(times[0] as u32, times[1] as u32);
        let mut late = Vec::new();
        for (at, level) in &edges {
            late.extend(pin.level(*level, us(*at)));
        }
        late.extend(pin.poll(us(end)));
        let late: Vec<_> = late
            .iter()
            .map(|change| (change.active, change.at.0 / TICKS_PER_US))
            .collect();
        assert_eq!(late, expected, "seed {seed}");
    }
}

const X_MIN: Role = Role::Axis {
    axis: AxisId(0),
    switch: Switch::Min,
};

fn edge(index: usize, level: bool, at_us: u64) -> PinLevel {
    PinLevel {
        index,
        level,
        at: us(at_us),
        counted_steps: [at_us as i64; CHANNELS],
    }
}

fn input(role: Role) -> InputConfig {
    InputConfig {
        role,
        active_low: true,
        filter: Filter::default(),
    }
}

#[test]
fn a_map_refuses_what_the_node_does_not_have() {
    let z_max = Role::Axis {
        axis: AxisId(2),
        switch: Switch::Max,
    };
    let map = InputMap::new(&[input(X_MIN), input(z_max)], 3).expect("three axes");
    assert!(map.has(z_max) && map.has(X_MIN) && !map.has(Role::Stop));
    assert_eq!(map.get(1), Some(&input(z_max)));
    assert_eq!((map.get(2), map.get(99)), (None, None));
    assert_eq!(
        InputMap::new(&[input(X_MIN), input(z_max)], 2),
        Err(MapError::Axis {
            index: 1,
            axis: AxisId(2)
        })
    );
    assert_eq!(
        InputMap::new(&[input(Role::C(Switch::Home))], 2),
        Err(MapError::NoHome { index: 0 })
    );
    let slow = InputConfig {
        filter: Filter {
            active_us: 0,
            inactive_us: FILTER_US_MAX + 1,
        },
        ..input(Role::Probe)
    };
    assert_eq!(
        InputMap::new(&[slow], 2),
        Err(MapError::Filter { index: 0 })
    );
    let many = vec![input(Role::Stop); INPUTS_MAX + 1];
    assert_eq!(InputMap::new(&many, 2), Err(MapError::TooMany));
    assert!(InputMap::new(&many[1..], 2).is_ok());
    use std::string::ToString;
    for error in [
        MapError::TooMany,
        MapError::Filter { index: 3 },
        MapError::NoHome { index: 3 },
    ] {
        assert!(!error.to_string().is_empty());
    }
    assert_eq!(
        MapError::Axis {
            index: 1,
            axis: AxisId(2)
        }
        .to_string(),
        "input 1: there is no axis 2"
    );
}

#[test]
fn two_inputs_of_one_role_are_active_while_one_of_them_is() {
    let at_once = |role| InputConfig {
        filter: Filter {
            active_us: 0,
            inactive_us: 0,
        },
        ..input(role)
    };
    let configs = [at_once(Role::Stop), at_once(X_MIN), at_once(Role::Stop)];
    let map = InputMap::new(&configs, 1).expect("legal");
    // Active low: all pins high is all free, but for the limit.
    let mut inputs = Inputs::new(map, |index| index != 1, us(0));
    assert!(inputs.is_active(X_MIN) && !inputs.is_active(Role::Stop));
    let mut at = 0;
    let mut change = |index: usize, level: bool| {
        at += 10;
        inputs
            .level(edge(index, level, at))
            .map(|event| (event.role, event.active))
            .collect::<Vec<_>>()
    };
    assert_eq!(change(0, false), [(Role::Stop, true)]);
    assert_eq!(change(2, false), []);
    assert_eq!(change(0, true), []);
    assert_eq!(change(2, true), [(Role::Stop, false)]);
    assert_eq!(change(1, true), [(X_MIN, false)]);
    assert_eq!(change(3, true), [], "no such input");
    assert_eq!(change(INPUTS_MAX, true), [], "no such input");
}

#[test]
fn a_change_has_the_counters_of_the_edge_since_which_it_holds() {
    let map = InputMap::new(&[input(X_MIN)], 1).expect("legal");
    let mut inputs = Inputs::new(map, |_| true, us(0));
    let told = |event: InputEvent| (event.active, event.at, event.counted_steps[0]);
    for (level, at) in [(false, 100), (true, 105), (false, 110), (false, 115)] {
        assert_eq!(inputs.level(edge(0, level, at)).count(), 0, "bounce");
    }
    assert_eq!(inputs.poll(us(130)).map(told), Some((true, us(110), 110)));
    // Released, and told so only with the next edge.
    assert_eq!(inputs.level(edge(0, true, 1_000)).count(), 0);
    let late: Vec<_> = inputs.level(edge(0, false, 9_000)).map(told).collect();
    assert_eq!(late, [(false, us(1_000), 1_000)]);
    assert_eq!(
        inputs.poll(us(9_020)).map(told),
        Some((true, us(9_000), 9_000))
    );
}

#[test]
fn events_come_in_the_order_in_which_they_count() {
    let with = |role, active_us| InputConfig {
        active_low: false,
        filter: Filter {
            active_us,
            inactive_us: 0,
        },
        role,
    };
    let configs = [with(Role::Probe, 90), with(Role::Stop, 10), with(X_MIN, 30)];
    let map = InputMap::new(&configs, 1).expect("legal");
    let mut inputs = Inputs::new(map, |_| false, us(0));
    assert_eq!(inputs.poll_timeout(), None);
    for (index, at) in [(0, 100), (1, 150), (2, 110)] {
        assert_eq!(inputs.level(edge(index, true, at)).count(), 0);
    }
    assert_eq!(inputs.poll_timeout(), Some(us(140)));
    assert_eq!(inputs.poll(us(139)), None);
    let mut found = Vec::new();
    while let Some(event) = inputs.poll(us(1_000)) {
        found.push((event.role, event.at));
    }
    assert_eq!(
        found,
        [
            (X_MIN, us(110)),
            (Role::Stop, us(150)),
            (Role::Probe, us(100))
        ]
    );
    assert_eq!(inputs.map(), &map);
}
