//! The lanes of the nodes: read at the pointer, moved in time, and told to a screen reader.

use crate::{
    fixture::{at_ms, connected, fleet, job, node, status, tell, tell_status},
    screen::{Window, button, picture_of, point_at, show, shows},
};
use dashboard::{
    app::Dashboard,
    message::{LinkEvent, Message},
    view::Tab,
};
use egui::{Key, Modifiers, Role};
use keys::{Fault, LocalMicros, NodeState, status::FaultCode};

/// Ten minutes of three nodes: two jobs, a stop, a fault, a loss, a link that was cut.
fn shift() -> Dashboard {
    let mut dashboard = connected();
    let names = ["left", "right", "top"];
    for name in names {
        let (node, alive) = (node(name), true);
        tell(&mut dashboard, at_ms(0), Message::Alive { node, alive });
    }
    for second in 0..600_u64 {
        let at = at_ms(second * 1_000);
        let link = match second {
            450 => Some(LinkEvent::Down {
                why: "the router is gone".to_owned(),
            }),
            480 => Some(LinkEvent::Connected {
                to: "tcp/localhost:7447".to_owned(),
            }),
            _ => None,
        };
        if let Some(event) = link {
            tell(&mut dashboard, at, Message::Link(event));
        }
        if (450..480).contains(&second) {
            continue;
        }
        let states = [
            match second {
                30..200 => (NodeState::Running, Some("engrave-7")),
                200..260 => (NodeState::Stopped, None),
                280..430 => (NodeState::Running, Some("engrave-8")),
                _ => (NodeState::Idle, None),
            },
            match second {
                60..180 => (NodeState::Running, Some("cut-1")),
                180..240 => (NodeState::Paused, Some("cut-1")),
                240..300 => (NodeState::Running, Some("cut-1")),
                300.. => (NodeState::Fault, None),
                _ => (NodeState::Idle, None),
            },
            (NodeState::Idle, None),
        ];
        for (name, (state, of)) in names.into_iter().zip(states) {
            if name == "top" && second >= 360 {
                continue;
            }
            let mut status = status(state, second * 1_000, [0, 0], 0);
            status.job = of.map(job);
            if state == NodeState::Fault {
                let (code, at) = (FaultCode::PLAN_LATE, LocalMicros(300_000_000));
                status.faults.push(Fault { code, at }).expect("room");
            }
            tell_status(&mut dashboard, at, name, status);
        }
        if second == 360 {
            let (node, alive) = (node("top"), false);
            tell(&mut dashboard, at, Message::Alive { node, alive });
        }
    }
    dashboard.view.tab = Tab::Timeline;
    dashboard.view.timeline.span_s = 620.0;
    dashboard
}

#[test]
fn a_screen_reader_hears_what_each_lane_shows_last() {
    let window = show(shift());
    assert!(shows(&window, "left: ● idle for "));
    assert!(shows(&window, "right: ✖ fault for "));
    assert!(shows(&window, "top: ⚠ lost for "));
}

#[test]
fn the_pointer_reads_a_lane_in_the_middle_of_its_job() {
    let mut window = show(shift());
    let lane = name_of(&window, "left: ● idle for ");
    point_at(&mut window, Role::Image, &lane);
    assert!(shows(
        &window,
        "left: ▶ running engrave-8, since 03:04:40.000, 2 min"
    ));
    let (of, at) = window.state().view.timeline.cursor.expect("on a lane");
    assert_eq!(of, node("left"));
    assert!(at > at_ms(280_000) && at < at_ms(310_000));
}

/// Returns the whole name of what begins so.
fn name_of(window: &Window, begins: &str) -> String {
    use egui_kittest::kittest::{NodeT as _, Queryable as _};
    let node = window.get_by_label_contains(begins);
    node.accesskit_node().label().expect("a name")
}

#[test]
fn the_window_in_time_is_moved_without_a_mouse() {
    let mut window = show(shift());
    assert!(shows(&window, "the last 10 min"));
    button(&mut window, "Shorter time");
    assert!(shows(&window, "the last 5 min"));
    button(&mut window, "Earlier");
    assert!(shows(&window, "5 min until 03:07:"));
    button(&mut window, "Later");
    assert!(shows(&window, "the last 5 min"), "not beyond the present");
    button(&mut window, "Earlier");
    button(&mut window, "Earlier");
    button(&mut window, "Longer time");
    assert!(shows(&window, "10 min until "));
    button(&mut window, "Follow the present");
    assert!(shows(&window, "the last 10 min"));
}

#[test]
fn the_lanes_are_those_of_the_fleets_table_and_lead_to_the_pages() {
    let mut window = show(fleet());
    window.key_press_modifiers(Modifiers::COMMAND, Key::T);
    window.run_steps(3);
    assert!(shows(&window, "cell-a-1: ▶ running engrave-7 for "));
    window.state_mut().view.fleet.filter = "cell-b".to_owned();
    window.run_steps(2);
    assert!(!shows(&window, "cell-a-1: ▶ running"));
    button(&mut window, "Lane of cell-b-2");
    assert_eq!(window.state().view.focus, Some(node("cell-b-2")));
    window.state_mut().view.fleet.filter = "nobody".to_owned();
    window.run_steps(2);
    assert!(shows(&window, "no node to show"));
}

#[test]
fn picture_of_the_timeline() {
    picture_of("timeline", shift);
}
