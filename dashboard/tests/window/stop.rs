//! Stops and releases: one key, out at once, and what the nodes say of it.

use crate::fixture::{at_ms, fleet, node, status, tell, tell_status};
use crate::screen::{button, picture_of, show, shows};
use dashboard::{
    app::Dashboard,
    message::{Answer, LinkEvent, Message},
    request::{Request, Scope},
};
use egui::{Key, Modifiers, Role};
use egui_kittest::{Harness, kittest::Queryable as _};
use keys::{NodeState, StopMode};
use std::collections::BTreeSet;

/// Returns what was asked since the last call, without the tickets.
fn asked(harness: &mut crate::screen::Window) -> Vec<Request> {
    let asked = crate::screen::asked(harness).into_iter();
    asked.map(|(_, request)| request).collect()
}

fn stop_all() -> Request {
    Request::Stop {
        scope: Scope::All,
        mode: StopMode::Halt,
    }
}

#[test]
fn stop_all_is_one_click_and_one_key_also_while_typing() {
    let mut harness = show(fleet());
    button(&mut harness, "STOP ALL");
    assert_eq!(asked(&mut harness), [stop_all()]);
    harness.key_press(Key::F1);
    harness.run_steps(2);
    assert_eq!(asked(&mut harness), [stop_all()]);
    harness
        .get_by_role_and_label(Role::TextInput, "Filter nodes")
        .focus();
    harness.run_steps(2);
    harness.key_press_modifiers(Modifiers::CTRL, Key::Space);
    harness.run_steps(2);
    assert_eq!(asked(&mut harness), [stop_all()]);
}

#[test]
fn a_stop_key_that_is_held_down_is_one_stop() {
    let mut harness = show(fleet());
    let press = |harness: &mut Harness<'_, Dashboard>, pressed| {
        harness.event(egui::Event::Key {
            key: Key::F1,
            physical_key: None,
            pressed,
            repeat: false,
            modifiers: Modifiers::NONE,
        });
        harness.run_steps(1);
    };
    // A system repeats the press while the key is down.
    for _ in 0..5 {
        press(&mut harness, true);
    }
    assert_eq!(asked(&mut harness), [stop_all()]);
    press(&mut harness, false);
    press(&mut harness, true);
    assert_eq!(asked(&mut harness), [stop_all()], "pressed again");
}

#[test]
fn a_stop_is_out_in_the_frame_of_its_key_and_shown_as_confirmed_with_the_status() {
    let mut harness = show(fleet());
    let id = node("cell-a-1");
    harness.state_mut().view.selection = BTreeSet::from([id]);
    // The frame with the key press, and what this frame hands to the link.
    harness.key_press(Key::F1);
    harness.run_steps(1);
    let pressed = at_ms(1_000);
    let out = harness.state_mut().take_requests(pressed);
    assert_eq!(out.len(), 1);
    assert_eq!(out[0].1, stop_all());
    // Half a round trip there, half a round trip back: 8 ms later the statuses are here.
    let names = [
        "cell-a-1", "cell-a-2", "cell-a-3", "cell-b-1", "cell-b-2", "spare",
    ];
    for name in names {
        let stopped = status(NodeState::Stopped, 2_000, [0, 0], 0);
        tell_status(harness.state_mut(), pressed.plus_us(8_000), name, stopped);
    }
    // One frame shows it.
    harness.run_steps(1);
    assert!(shows(&harness, "confirmed 6/6") && shows(&harness, "in 8.0 ms"));
}

#[test]
fn a_slow_stop_says_who_is_latched_and_still_comes_to_rest() {
    let mut harness = show(fleet());
    harness.state_mut().view.selection = BTreeSet::from([node("cell-a-1")]);
    harness.run_steps(2);
    button(&mut harness, "Slow stop");
    asked(&mut harness);
    let slowing = status(NodeState::Stopped, 2_000, [0, 0], 800);
    tell_status(harness.state_mut(), at_ms(1_010), "cell-a-1", slowing);
    harness.run_steps(2);
    assert!(shows(&harness, "confirmed 0/1"));
    assert!(shows(&harness, "still coming to rest: cell-a-1"));
    assert!(!shows(&harness, "missing:"));
    let resting = status(NodeState::Stopped, 2_400, [0, 0], 0);
    tell_status(harness.state_mut(), at_ms(1_400), "cell-a-1", resting);
    harness.run_steps(2);
    assert!(shows(&harness, "confirmed 1/1") && shows(&harness, "in 400.0 ms"));
}

#[test]
fn the_effect_of_a_stop_names_who_is_missing_until_all_have_said_so_themselves() {
    let mut harness = show(fleet());
    button(&mut harness, "STOP ALL");
    asked(&mut harness);
    assert!(shows(&harness, "confirmed 0/6"), "one of seven is offline");
    let stopped = || status(NodeState::Stopped, 2_000, [0, 0], 0);
    for (ms, name) in [
        (1_008, "cell-a-1"),
        (1_009, "cell-a-2"),
        (1_012, "cell-b-1"),
    ] {
        tell_status(harness.state_mut(), at_ms(ms), name, stopped());
    }
    // A status that says otherwise confirms nothing.
    let running = status(NodeState::Running, 2_000, [0, 0], 100);
    tell_status(harness.state_mut(), at_ms(1_013), "cell-a-3", running);
    harness.run_steps(2);
    assert!(shows(&harness, "confirmed 3/6"));
    assert!(shows(&harness, "missing: cell-a-3, cell-b-2, spare"));
    assert!(shows(&harness, "Software stop of all nodes"));
    for name in ["cell-a-3", "cell-b-2", "spare"] {
        tell_status(harness.state_mut(), at_ms(1_020), name, stopped());
    }
    harness.run_steps(2);
    assert!(shows(&harness, "confirmed 6/6"));
    assert!(shows(&harness, "in 20.0 ms"));
    assert!(!shows(&harness, "missing:"));
    button(&mut harness, "Dismiss");
    assert!(!shows(&harness, "confirmed 6/6"));
}

#[test]
fn a_stop_that_was_not_sent_says_so() {
    let mut harness = show(fleet());
    button(&mut harness, "STOP ALL");
    let now = at_ms(1_000);
    let asked = harness.state_mut().take_requests(now);
    let answer = Answer::Failed("NOT SENT: there is no link".to_owned());
    let ticket = asked[0].0;
    tell(harness.state_mut(), now, Message::Answer { ticket, answer });
    harness.run_steps(2);
    assert!(shows(&harness, "NOT SENT"));
    assert!(!shows(&harness, "confirmed"));
}

#[test]
fn a_release_takes_two_steps_and_means_those_that_were_shown() {
    let mut harness = show(fleet());
    button(&mut harness, "Release…");
    assert_eq!(asked(&mut harness), []);
    button(&mut harness, "Keep stopped");
    assert_eq!(asked(&mut harness), []);
    button(&mut harness, "Release…");
    button(&mut harness, "Release 1 node");
    let scope = Scope::node(node("cell-b-1"));
    assert_eq!(asked(&mut harness), [Request::Release { scope }]);
    assert!(shows(&harness, "confirmed 0/1"));
    let idle = status(NodeState::Idle, 2_000, [0, 0], 0);
    tell_status(harness.state_mut(), at_ms(1_030), "cell-b-1", idle);
    harness.run_steps(2);
    assert!(shows(&harness, "confirmed 1/1"));
}

#[test]
fn a_group_has_its_own_stop() {
    let mut harness = show(fleet());
    button(&mut harness, "Stop cell-a-$*");
    let scope = Scope::Pattern("cell-a-$*".to_owned());
    let mode = StopMode::Halt;
    assert_eq!(asked(&mut harness), [Request::Stop { scope, mode }]);
    assert!(shows(&harness, "confirmed 0/3"));
}

#[test]
fn a_selection_is_stopped_with_deceleration() {
    let mut harness = show(fleet());
    harness.state_mut().view.selection = BTreeSet::from([node("cell-a-1"), node("spare")]);
    harness.run_steps(2);
    button(&mut harness, "Slow stop");
    let scope = Scope::Nodes(BTreeSet::from([node("cell-a-1"), node("spare")]));
    let mode = StopMode::Decelerate;
    assert_eq!(asked(&mut harness), [Request::Stop { scope, mode }]);
}

#[test]
fn picture_of_a_stop_that_somebody_misses() {
    picture_of("stop", || {
        let mut dashboard = fleet();
        dashboard.requests.push(stop_all());
        dashboard.take_requests(at_ms(1_000));
        for name in ["cell-a-1", "cell-a-2", "cell-b-1"] {
            let stopped = status(NodeState::Stopped, 2_000, [2_000, -678], 0);
            tell_status(&mut dashboard, at_ms(1_009), name, stopped);
        }
        dashboard.view.stop.releasing = Some(Scope::All);
        dashboard
    });
}

#[test]
fn picture_of_a_lost_link() {
    picture_of("lost_link", || {
        let mut dashboard = fleet();
        let why = "the router is gone".to_owned();
        let down = Message::Link(LinkEvent::Down { why });
        tell(&mut dashboard, at_ms(1_000), down);
        let stop = dashboard.requests.push(stop_all());
        dashboard.take_requests(at_ms(12_000));
        let words = "NOT SENT: there is no link. Use the stop buttons of the machines";
        let answer = Answer::Failed(words.to_owned());
        let told = Message::Answer {
            ticket: stop,
            answer,
        };
        tell(&mut dashboard, at_ms(12_000), told);
        dashboard.model.tick(at_ms(13_000));
        dashboard
    });
}
