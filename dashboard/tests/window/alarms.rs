//! The list of alarms: raised by messages, acknowledged by clicks.

mod fixture;
mod screen;

use dashboard::{app::Dashboard, message::Message, view::Tab};
use egui::{Key, Modifiers, Role};
use fixture::{at_ms, fleet, node, status, tell, tell_status};
use keys::NodeState;
use screen::{asked, button, click, picture, show, shows};

fn with_alarms() -> Dashboard {
    let mut dashboard = fleet();
    dashboard.view.tab = Tab::Alarms;
    dashboard
}

#[test]
fn the_top_bar_counts_what_nobody_has_seen() {
    let mut screen = show(fleet());
    button(&mut screen, "⚠ 3 alarms");
    assert_eq!(screen.state().view.tab, Tab::Alarms);
    assert!(shows(&screen, "3 not acknowledged, 3 listed"));
    button(&mut screen, "Acknowledge alarm 1");
    asked(&mut screen);
    assert!(shows(&screen, "⚠ 2 alarms"));
    button(&mut screen, "Acknowledge all");
    asked(&mut screen);
    assert!(shows(&screen, "⚠ 0 alarms"));
    assert!(shows(&screen, "3 listed"), "still open, and still listed");
}

#[test]
fn what_is_over_and_seen_is_past_and_what_returns_is_new() {
    let mut screen = show(with_alarms());
    button(&mut screen, "Acknowledge all");
    asked(&mut screen);
    let idle = status(NodeState::Idle, 2_000, [0, 0], 0);
    tell_status(screen.state_mut(), at_ms(1_100), "cell-b-1", idle);
    screen.run_steps(2);
    assert!(shows(&screen, "0 not acknowledged, 2 listed"));
    click(&mut screen, Role::CheckBox, "Show past");
    assert!(shows(&screen, "0 not acknowledged, 3 listed"));
    assert!(shows(&screen, "✔ over"));
    let stopped = status(NodeState::Stopped, 2_100, [0, 0], 0);
    tell_status(screen.state_mut(), at_ms(1_200), "cell-b-1", stopped);
    screen.run_steps(2);
    assert!(shows(&screen, "1 not acknowledged, 4 listed"));
}

#[test]
fn an_alarm_leads_to_its_node() {
    let mut screen = show(with_alarms());
    let alarm = dashboard::panels::alarms::shown(&screen.state().model, &Default::default())
        .into_iter()
        .find(|alarm| alarm.node == Some(node("cell-b-3")))
        .map(|alarm| alarm.id)
        .expect("it is gone");
    button(&mut screen, &format!("Page of cell-b-3, alarm {alarm}"));
    assert_eq!(screen.state().view.focus, Some(node("cell-b-3")));
}

#[test]
fn the_list_has_a_key_and_says_when_nothing_is_wrong() {
    let mut screen = show(fixture::connected());
    screen.key_press_modifiers(Modifiers::COMMAND, Key::M);
    screen.run_steps(3);
    assert!(shows(&screen, "nothing needs anybody"));
    let node = node("left");
    for alive in [true, false] {
        let message = Message::Alive { node, alive };
        tell(screen.state_mut(), at_ms(10), message);
    }
    screen.run_steps(2);
    assert!(shows(&screen, "1 not acknowledged, 1 listed"));
}

#[test]
fn picture_of_alarms() {
    picture("alarms", || {
        let mut dashboard = with_alarms();
        for alarm in [1, 3] {
            let seen = Message::Acknowledged { alarm: Some(alarm) };
            tell(&mut dashboard, at_ms(1_000), seen);
        }
        dashboard.view.alarms.show_past = true;
        let idle = status(NodeState::Idle, 2_000, [0, 0], 0);
        tell_status(&mut dashboard, at_ms(1_100), "cell-b-1", idle);
        dashboard
    });
}
