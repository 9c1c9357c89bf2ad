//! The list of alarms: raised by messages, acknowledged by clicks.

use crate::fixture::{at_ms, fleet, node, status, tell, tell_status};
use crate::screen::{asked, button, click, picture_of, show, shows};
use dashboard::{app::Dashboard, message::Message, view::Tab};
use egui::{Key, Modifiers, Role};
use keys::NodeState;

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
    assert!(shows(&screen, "⚠ 0 alarms, 3 still open"));
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
    let mut screen = show(crate::fixture::connected());
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

/// Loses a node at this moment.
fn lose(dashboard: &mut Dashboard, name: &str, ms: u64) {
    for alive in [true, false] {
        let node = node(name);
        tell(dashboard, at_ms(ms), Message::Alive { node, alive });
    }
}

#[cfg(unix)]
#[test]
fn a_sound_is_off_until_it_is_wanted_and_then_plays_for_what_is_new_and_live() {
    use dashboard::sound::{Player, Sound};
    let folder = tempfile::tempdir().expect("a folder");
    let heard = folder.path().join("heard");
    let mut dashboard = with_alarms();
    dashboard.sound = Sound::with(vec![Player::new(
        "cp",
        &["{}", &heard.display().to_string()],
    )]);
    let mut window = show(dashboard);
    assert!(!window.state().view.alarms.sound);
    lose(window.state_mut(), "one", 1_000);
    window.run_steps(2);
    assert!(!window.state().sound.is_playing(), "nobody wants it");
    click(&mut window, Role::CheckBox, "Sound");
    assert!(!window.state().sound.is_playing(), "nothing is new");
    lose(window.state_mut(), "two", 1_100);
    window.run_steps(1);
    window.state_mut().sound.wait();
    assert!(heard.exists(), "played");
    std::fs::remove_file(&heard).expect("it was there");
    window.run_steps(3);
    window.state_mut().sound.wait();
    assert!(!heard.exists(), "once for each time that something is new");
    button(&mut window, "Try the sound");
    window.state_mut().sound.wait();
    assert!(heard.exists());
}

#[cfg(unix)]
#[test]
fn a_hidden_window_calls_too() {
    use dashboard::sound::{Player, Sound};
    let folder = tempfile::tempdir().expect("a folder");
    let heard = folder.path().join("heard");
    let mut dashboard = with_alarms();
    let copy = heard.display().to_string();
    dashboard.sound = Sound::with(vec![Player::new("cp", &["{}", &copy])]);
    dashboard.view.alarms.sound = true;
    // Nothing is drawn: `ui` is not called.
    let context = egui::Context::default();
    lose(&mut dashboard, "one", 1_000);
    dashboard.logic(&context);
    dashboard.sound.wait();
    assert!(heard.exists());
}

#[test]
fn a_computer_without_sound_is_told_so() {
    use dashboard::sound::{Player, Sound};
    let mut dashboard = with_alarms();
    dashboard.sound = Sound::with(vec![Player::new("/nowhere/aplay", &["{}"])]);
    dashboard.view.alarms.sound = true;
    let mut window = show(dashboard);
    button(&mut window, "Try the sound");
    assert!(shows(
        &window,
        "⚠ no sound: nothing here can play it: /nowhere/aplay"
    ));
}

#[test]
fn picture_of_alarms() {
    picture_of("alarms", || {
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
