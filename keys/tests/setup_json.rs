//! What a node tells of itself on the key `setup`, as clients read it.
#![cfg(feature = "json")]

use heapless::{String, Vec};
use keys::{
    AXES_MAX, NodeId,
    setup::{
        AxisSetup, EnableSetup, HomingSetup, InputSetup, LinkSetup, PlaceSetup, Reaction,
        SETUP_BYTES_MAX, Setup, SetupOfC, SetupOfD, SoftLimitsSetup, cut, key_mark,
    },
};

/// As long as it can be.
fn text<const N: usize>() -> String<N> {
    cut(&"\"".repeat(N))
}

fn full<T: Clone, const N: usize>(item: &T) -> Vec<T, N> {
    std::iter::repeat_n(item.clone(), N).collect()
}

fn largest() -> Setup {
    let most = u32::MAX;
    let axis = AxisSetup {
        driver: Some(text()),
        direction_inverted: false,
        high_ns_min: most,
        low_ns_min: most,
        high_ns: most,
        dir_setup_ns: most,
        dir_hold_ns: most,
        speed_hz_max: most,
        stop_accel_hz_per_s: most,
        junction_hz: most,
        soft_limits: Some(SoftLimitsSetup {
            min_steps: i64::MIN,
            max_steps: i64::MIN,
            from_boot: false,
        }),
        homing: Some(HomingSetup {
            switch: cut("home"),
            positive: false,
            seek_hz: most,
            approach_hz: most,
            accel_hz_per_s: most,
            travel_steps_max: u64::MAX,
            back_off_steps_max: u64::MAX,
            margin_steps: u64::MAX,
            home_position_steps: i64::MIN,
            pull_off_steps: u64::MAX,
        }),
    };
    let input = InputSetup {
        of: cut("0:home"),
        normally_closed: false,
        active_us: most,
        inactive_us: most,
    };
    let enable = EnableSetup {
        axes: full(&'0'),
        auto: false,
        delay_on_us: most,
        delay_off_ms: most,
        shift_register: false,
    };
    let place = PlaceSetup {
        name: text(),
        position_um: i32::MIN,
        speed_um_per_s: most,
    };
    Setup {
        name: Some(NodeId::new(&"n".repeat(32)).expect("legal")),
        prefix: cut(&"p".repeat(64)),
        firmware: cut("255.255.255"),
        chip: text(),
        ring_commands: most,
        axes: full::<_, AXES_MAX>(&axis),
        inputs: full(&input),
        limit_stop: Reaction::Decelerate,
        probe_stop: Reaction::Decelerate,
        enables: full(&enable),
        c: Some(SetupOfC {
            steps_per_m: most,
            places: full(&place),
        }),
        d: Some(SetupOfD {
            steps_per_m: most,
            travel_um: most,
            speed_um_per_s: most,
        }),
        lidar_wait_ms: Some(most),
        boot_script: false,
        signers: full(&key_mark(&[0xff; 32])),
        update_key: Some(key_mark(&[0xff; 32])),
        link: LinkSetup {
            router: text(),
            tls: false,
            user: Some(text()),
            networks: full(&text()),
            loss: Reaction::Decelerate,
            loss_after_us: u64::MAX,
        },
    }
}

#[test]
fn the_largest_setup_has_room_and_is_read_as_it_was_written() {
    let setup = largest();
    let written = serde_json::to_vec(&setup).expect("numbers and texts");
    assert!(written.len() <= SETUP_BYTES_MAX, "{}", written.len());
    assert_eq!(Setup::from_json(&written), Ok(setup));
}

#[test]
fn what_an_older_node_leaves_out_is_its_default_and_what_a_newer_one_adds_is_passed_over() {
    let text = r#"{"name":"left","later":{"a":[1]},"axes":[{"driver":null,"later":1}],
        "link":{"router":"tcp/plant:7447","loss":"go_on"}}"#;
    let setup = Setup::from_json(text.as_bytes()).expect("a setup");
    let expected = Setup {
        name: NodeId::new("left").ok(),
        axes: full::<_, 1>(&AxisSetup::default()).into_iter().collect(),
        link: LinkSetup {
            router: cut("tcp/plant:7447"),
            loss: Reaction::GoOn,
            ..LinkSetup::default()
        },
        ..Setup::default()
    };
    assert_eq!(setup, expected);
}

#[test]
fn what_is_none_is_refused() {
    let long = format!("{{\"prefix\":\"{}\"}}", " ".repeat(SETUP_BYTES_MAX));
    let axes = format!("{{\"axes\":[{}]}}", ["{}"; AXES_MAX + 1].join(","));
    for text in ["", "7", "{\"axes\":7}", "{", &long, &axes] {
        assert!(Setup::from_json(text.as_bytes()).is_err(), "{text:.20}");
    }
}

#[test]
fn a_text_that_is_too_long_is_cut_between_two_characters() {
    assert_eq!(cut::<5>("ab\u{e4}\u{e4}x"), "ab\u{e4}");
    assert_eq!(key_mark(&[0x0a; 32]), "0a0a0a0a");
}
