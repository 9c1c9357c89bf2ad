//! A node's page on how it is set: asked when somebody looks, and never taken for newer than it is.

use crate::fixture::{at_ms, connected, node, status, tell, tell_status};
use crate::screen::{Window, asked, button, click, picture, show, show_in, shows};
use dashboard::{
    app::Dashboard,
    message::{Answer, LinkEvent, Message},
    panels::node::Page,
    request::{Request, Ticket},
};
use egui::Role;
use keys::{
    NodeState, QueueId, Setup,
    setup::{
        AxisSetup, EnableSetup, HomingSetup, InputSetup, LinkSetup, PlaceSetup, Reaction, SetupOfC,
        SetupOfD, SoftLimitsSetup, cut, key_mark,
    },
};

/// What a laser with two axes tells.
pub(crate) fn setup() -> Setup {
    let first = AxisSetup {
        driver: Some(cut("tmc2209")),
        direction_inverted: true,
        high_ns_min: 100,
        low_ns_min: 100,
        high_ns: 2_500,
        dir_setup_ns: 20,
        dir_hold_ns: 20,
        speed_hz_max: 4_000_000,
        stop_accel_hz_per_s: 100_000,
        junction_hz: 200,
        soft_limits: Some(SoftLimitsSetup {
            min_steps: -200,
            max_steps: 48_000,
            from_boot: false,
        }),
        homing: Some(HomingSetup {
            switch: cut("min"),
            positive: false,
            seek_hz: 5_000,
            approach_hz: 500,
            accel_hz_per_s: 50_000,
            travel_steps_max: 200_000,
            back_off_steps_max: 4_000,
            margin_steps: 100,
            home_position_steps: 0,
            pull_off_steps: 200,
        }),
    };
    let second = AxisSetup {
        driver: None,
        soft_limits: None,
        homing: None,
        ..first.clone()
    };
    let input = |of, normally_closed| InputSetup {
        of: cut(of),
        normally_closed,
        active_us: 20,
        inactive_us: 5_000,
    };
    let place = |name, position_um| PlaceSetup {
        name: cut(name),
        position_um,
        speed_um_per_s: 10_000,
    };
    let enable = EnableSetup {
        axes: ['0', '1'].into_iter().collect(),
        auto: true,
        delay_on_us: 2_000,
        delay_off_ms: 1_000,
        shift_register: false,
    };
    Setup {
        name: Some(node("laser-1")),
        prefix: cut("fleet"),
        firmware: cut("0.1.0"),
        chip: cut("ESP32-S3"),
        ring_commands: 4_096,
        axes: [first, second].into_iter().collect(),
        inputs: [input("0:min", true), input("probe", false)]
            .into_iter()
            .collect(),
        limit_stop: Reaction::Halt,
        probe_stop: Reaction::GoOn,
        enables: [enable].into_iter().collect(),
        c: Some(SetupOfC {
            steps_per_m: 80_125,
            places: [place("HOME", 0), place("MAX", 100_000)]
                .into_iter()
                .collect(),
        }),
        d: Some(SetupOfD {
            steps_per_m: 80_000,
            travel_um: 50_000,
            speed_um_per_s: 25_000,
        }),
        lidar_wait_ms: Some(1_000),
        boot_script: false,
        signers: [key_mark(&[0x5f; 32])].into_iter().collect(),
        update_key: Some(key_mark(&[0x77; 32])),
        link: LinkSetup {
            router: cut("tls/plant.local:7447"),
            tls: true,
            user: Some(cut("laser-1")),
            networks: [cut("shop")].into_iter().collect(),
            loss: Reaction::Decelerate,
            loss_after_us: 2_000_000,
        },
    }
}

/// A node that is there, with its page on its setup.
fn laser() -> Dashboard {
    let mut dashboard = connected();
    let (id, alive) = (node("laser-1"), true);
    tell(&mut dashboard, at_ms(0), Message::Alive { node: id, alive });
    let idle = status(NodeState::Idle, 0, [0, 0], 0);
    tell_status(&mut dashboard, at_ms(0), "laser-1", idle);
    dashboard.view.focus = Some(id);
    dashboard.view.node.page = Page::Setup;
    dashboard
}

fn told(dashboard: &mut Dashboard, after_ms: u64) {
    let (node, setup) = (node("laser-1"), Box::new(setup()));
    tell(dashboard, at_ms(after_ms), Message::Setup { node, setup });
}

/// The tickets of the questions that were asked since the last call.
fn questions(window: &mut Window) -> Vec<Ticket> {
    let question = Request::Setup {
        node: node("laser-1"),
    };
    let asked = asked(window).into_iter();
    asked
        .map(|(ticket, request)| {
            assert_eq!(request, question);
            ticket
        })
        .collect()
}

#[test]
fn a_node_is_asked_once_when_its_page_is_opened_and_again_in_another_boot() {
    let mut dashboard = laser();
    dashboard.view.node.page = Page::Overview;
    let mut window = show(dashboard);
    assert_eq!(questions(&mut window), [], "nobody looks");
    click(&mut window, Role::Button, "Setup");
    let first = questions(&mut window);
    assert_eq!(first.len(), 1);
    assert!(shows(&window, "⌛ asking it"));
    assert_eq!(questions(&mut window), [], "it was asked");

    told(window.state_mut(), 100);
    let (ticket, refused) = (first[0], Vec::new());
    let answer = Answer::Done { count: 1, refused };
    let message = Message::Answer { ticket, answer };
    tell(window.state_mut(), at_ms(100), message);
    window.run_steps(2);
    assert!(shows(
        &window,
        "as it told at 03:00:00.100 UTC; it is set like this"
    ));
    assert_eq!(questions(&mut window), []);

    let mut anew = status(NodeState::Idle, 0, [0, 0], 0);
    anew.queue = QueueId { boot: 2, flush: 0 };
    tell_status(window.state_mut(), at_ms(5_000), "laser-1", anew);
    window.run_steps(2);
    assert!(shows(
        &window,
        "⚠ as it told at 03:00:00.100 UTC, before it started"
    ));
    assert_eq!(questions(&mut window).len(), 1, "it may be another machine");
    told(window.state_mut(), 5_100);
    window.run_steps(2);
    assert!(shows(
        &window,
        "as it told at 03:00:05.100 UTC; it is set like this"
    ));
}

#[test]
fn everything_that_is_set_stands_in_words_with_units() {
    let mut dashboard = laser();
    told(&mut dashboard, 100);
    let window = show(dashboard);
    for words in [
        "ESP32-S3",
        "tls/plant.local:7447",
        "on; only to a router whose certificate",
        "after 2.00 s it comes to rest by its ramps, stopped",
        "yes, by one of 1 key: 5f5f5f5f",
        "signed by the key 77777777",
        "Axis 0",
        "tmc2209",
        "high 100 ns at least, 2.5 µs when slow; low 100 ns at least",
        "20 ns before a step, 20 ns behind one; the pin is low for positive",
        "4\u{a0}000\u{a0}000 steps/s",
        "100\u{a0}000 steps/s²",
        "-200 to 48\u{a0}000 steps, once it is homed",
        "to the switch `min`, negative; seek 5\u{a0}000 steps/s",
        "the switch is at 0, it ends 200 steps off it",
        "Axis 1",
        "times of its own",
        "80.125 steps/mm",
        "at 100 mm, 10 mm/s on the way there",
        "50 mm, 25 mm/s",
        "0:min",
        "normally closed; counts as pressed after 20 µs, as released after 5.0 ms",
        "everything halts",
        "axes 0, 1: on 2.0 ms before motion, off after 1.00 s of rest",
        "a reading is waited for at rest, 1000 ms at most",
        "in the gateway's fleet.toml",
    ] {
        assert!(shows(&window, words), "{words}");
    }
}

#[test]
fn what_is_not_told_says_why() {
    let mut window = show(laser());
    let ticket = questions(&mut window)[0];
    let answer = Answer::Failed("it does not answer: its firmware may be older".to_owned());
    let message = Message::Answer { ticket, answer };
    tell(window.state_mut(), at_ms(1_000), message);
    window.run_steps(2);
    assert!(shows(&window, "not told: it does not answer: its firmware"));
    assert_eq!(questions(&mut window), [], "not again and again");
    button(&mut window, "Ask again");
    assert_eq!(questions(&mut window).len(), 1);

    let mut dashboard = laser();
    let (id, alive) = (node("laser-1"), false);
    tell(
        &mut dashboard,
        at_ms(10),
        Message::Alive { node: id, alive },
    );
    let mut window = show(dashboard);
    assert!(shows(&window, "not told: it is not there"));
    assert_eq!(questions(&mut window), [], "nobody is there to ask");
}

#[test]
fn what_cannot_be_asked_now_is_shown_as_what_was_told_then() {
    let mut dashboard = laser();
    told(&mut dashboard, 100);
    let (id, alive) = (node("laser-1"), false);
    tell(
        &mut dashboard,
        at_ms(200),
        Message::Alive { node: id, alive },
    );
    let window = show(dashboard);
    assert!(shows(
        &window,
        "⚠ as it told at 03:00:00.100 UTC; it cannot be asked"
    ));
    assert!(shows(&window, "tmc2209"));

    let mut dashboard = laser();
    told(&mut dashboard, 100);
    let why = "the router is gone".to_owned();
    let down = Message::Link(LinkEvent::Down { why });
    tell(&mut dashboard, at_ms(200), down);
    let mut window = show(dashboard);
    assert!(shows(
        &window,
        "⚠ as it told at 03:00:00.100 UTC; it cannot be asked"
    ));
    assert_eq!(questions(&mut window), [], "there is no link");
    let to = "tcp/localhost:7447".to_owned();
    let up = Message::Link(LinkEvent::Connected { to });
    tell(window.state_mut(), at_ms(9_000), up);
    window.run_steps(2);
    assert_eq!(questions(&mut window).len(), 1, "there is one again");
}

#[test]
fn picture_of_the_setup() {
    picture("node_setup", |theme| {
        let mut dashboard = laser();
        told(&mut dashboard, 100);
        show_in(dashboard, theme, [860.0, 2_050.0])
    });
}

#[test]
fn picture_of_a_setup_that_is_not_told() {
    picture("node_setup_not_told", |theme| {
        let mut window = show_in(laser(), theme, [1_000.0, 720.0]);
        let ticket = questions(&mut window)[0];
        let answer = Answer::Failed(
            "it does not answer: its firmware may be older than this question".to_owned(),
        );
        let message = Message::Answer { ticket, answer };
        tell(window.state_mut(), at_ms(1_000), message);
        window.run_steps(2);
        window
    });
}
