//! What a node tells of itself on the key `setup`.

use emulator::{EmulatedNode, EmulatorConfig, config::Credentials};
use keys::{
    AxisId, NodeId, StopMode,
    setup::{
        AxisSetup, EnableSetup, HomingSetup, InputSetup, Reaction, Setup, SoftLimitsSetup, cut,
    },
};
use motion::{
    AxisProfile, Driver, MotionConfig, SoftLimits,
    io::{
        enable::{AxisSet, EnableConfig},
        home::HomeConfig,
        input::Switch,
    },
};
use node::{LinkLoss, run::Host};

const SECRET: &str = "correct-horse";

fn config() -> EmulatorConfig {
    let mut config = EmulatorConfig::new(NodeId::new("left").expect("legal"));
    config.motion.axes[1] = AxisProfile {
        direction_inverted: true,
        junction_hz: 50,
        ..AxisProfile::of_driver(Driver::Drv8825)
    };
    config
        .add_switch(AxisId(0), Switch::Min, -300)
        .expect("room");
    config.set_home(AxisId(0), HomeConfig::min_switch(20_000));
    config.motion.soft_limits[1] = Some(SoftLimits {
        min_steps: -10,
        max_steps: 5_000,
        from_boot: true,
    });
    let line = EnableConfig {
        delay_off_ms: 250,
        ..EnableConfig::auto(AxisSet::QUEUE)
    };
    config.motion.enables.push(line).expect("room");
    config.motion.limit_stop = StopMode::Decelerate;
    config.link_loss = LinkLoss::Finish;
    config.signers.push([0x5f; 32]).expect("room");
    config.update_key = Some([0x77; 32]);
    config.credentials = Some(Credentials {
        user: "left".to_owned(),
        password: SECRET.to_owned(),
    });
    config
}

#[test]
fn a_node_tells_how_it_is_set_and_no_secret() {
    let node = EmulatedNode::new(config(), 7);
    let told = node.setup();
    let text = std::str::from_utf8(&told).expect("JSON");
    let setup = Setup::from_json(&told).expect("a setup");
    // Nothing is said that a reader does not know.
    let read: serde_json::Value = serde_json::from_slice(&told).expect("JSON");
    assert_eq!(serde_json::to_value(&setup).expect("JSON"), read);

    assert_eq!(setup.name, NodeId::new("left").ok());
    assert_eq!((&*setup.prefix, &*setup.chip), ("fleet", "emulated"));
    assert_eq!((&*setup.firmware, setup.ring_commands), ("0.1.0", 4_096));
    let plain = AxisProfile::default();
    let first = AxisSetup {
        driver: Some(cut("default")),
        high_ns_min: plain.high_ns_min,
        low_ns_min: plain.low_ns_min,
        high_ns: plain.high_ns,
        dir_setup_ns: plain.dir_setup_ns,
        dir_hold_ns: plain.dir_hold_ns,
        speed_hz_max: 1_000_000,
        stop_accel_hz_per_s: plain.stop_accel_hz_per_s,
        junction_hz: plain.junction_hz,
        homing: Some(HomingSetup {
            switch: cut("min"),
            positive: false,
            seek_hz: 5_000,
            approach_hz: 500,
            accel_hz_per_s: 50_000,
            travel_steps_max: 20_000,
            back_off_steps_max: 4_000,
            margin_steps: 100,
            home_position_steps: 0,
            pull_off_steps: 200,
        }),
        ..AxisSetup::default()
    };
    assert_eq!(setup.axes.len(), 2);
    assert_eq!(setup.axes[0], first);
    let second = &setup.axes[1];
    assert_eq!(second.driver.as_deref(), Some("drv8825"));
    assert!(second.direction_inverted);
    // Two parts of 1.9 µs are 31 ticks each.
    assert_eq!((second.speed_hz_max, second.junction_hz), (258_064, 50));
    let reach = SoftLimitsSetup {
        min_steps: -10,
        max_steps: 5_000,
        from_boot: true,
    };
    assert_eq!((second.soft_limits, &second.homing), (Some(reach), &None));
    let input = InputSetup {
        of: cut("0:min"),
        normally_closed: true,
        active_us: 20,
        inactive_us: 5_000,
    };
    assert_eq!(setup.inputs.as_slice(), [input]);
    let enable = EnableSetup {
        axes: ['0', '1'].into_iter().collect(),
        auto: true,
        delay_on_us: 2_000,
        delay_off_ms: 250,
        shift_register: false,
    };
    assert_eq!(setup.enables.as_slice(), [enable]);
    assert_eq!(setup.limit_stop, Reaction::Decelerate);
    assert_eq!(setup.probe_stop, Reaction::GoOn);
    assert!(setup.c.is_none() && setup.d.is_none() && !setup.boot_script);

    assert_eq!(setup.link.router, "tcp/127.0.0.1:7447");
    assert_eq!(setup.link.user.as_deref(), Some("left"));
    assert!(!setup.link.tls && setup.link.networks.is_empty());
    assert_eq!(
        (setup.link.loss, setup.link.loss_after_us),
        (Reaction::GoOn, 2_000_000)
    );
    assert_eq!(setup.signers.as_slice(), ["5f5f5f5f"]);
    assert_eq!(setup.update_key.as_deref(), Some("77777777"));
    assert!(
        !text.contains(SECRET) && !text.contains("5f5f5f5f5f"),
        "{text}"
    );
}

#[test]
fn times_that_are_no_drivers_have_no_name() {
    let mut config = config();
    config.motion = MotionConfig::default();
    config.motion.axes[0].high_ns_min = 700;
    config.add_cd(100).expect("room");
    let node = EmulatedNode::new(config, 7);
    let setup = Setup::from_json(&node.setup()).expect("a setup");
    assert_eq!(setup.axes[0].driver, None);
    let inputs: Vec<&str> = setup.inputs.iter().map(|input| &*input.of).collect();
    assert_eq!(inputs, ["c:min", "c:max", "d:min", "d:max"]);
    let c = setup.c.expect("it is there");
    assert_eq!((c.steps_per_m, c.places.len()), (80_000, 5));
    assert_eq!(
        (&*c.places[4].name, c.places[4].position_um),
        ("MAX", 100_000)
    );
    assert_eq!(setup.d.map(|d| d.travel_um), Some(50_000));
}
