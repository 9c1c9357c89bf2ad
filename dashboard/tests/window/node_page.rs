//! A node's page: its plots, its path, its clock, its lines and what is known of its setup.

use crate::fixture::{at_ms, connected, node, record, status, tell, tell_status};
use crate::screen::{Window, asked, button, click, picture, point_at, show, show_in, shows};
use dashboard::{
    app::Dashboard,
    message::{Answer, Message},
    panels::node::Page,
};
use egui::Role;
use egui_kittest::kittest::Queryable as _;
use keys::{
    NodeState, Vitals,
    record::{ClockRecord, FaultRecord, LinkRecord, NodeWord, PaceRecord},
};

const SIZE: [f32; 2] = [1_000.0, 900.0];

/// Two axes draw a circle of 4,000 steps in 10 s; the laser is on for the second half. The clock
/// drifts and its error shrinks.
fn circle() -> Dashboard {
    let mut dashboard = connected();
    let (id, alive) = (node("laser-1"), true);
    tell(&mut dashboard, at_ms(0), Message::Alive { node: id, alive });
    for tick in 0..=100_u64 {
        let (at, angle) = (
            at_ms(tick * 100),
            tick as f64 / 100.0 * std::f64::consts::TAU,
        );
        let steps = [2_000.0 * angle.cos(), 2_000.0 * angle.sin()].map(|steps| steps as i64);
        let mut moving = status(NodeState::Running, tick * 100, steps, 0);
        moving.executed_commands = 40 - (100 - tick) * 30 / 100;
        moving.laser_percent = if tick > 50 { 80 } else { 0 };
        let speeds_hz = [-1_257.0 * angle.sin(), 1_257.0 * angle.cos()];
        for (axis, speed_hz) in moving.axes.iter_mut().zip(speeds_hz) {
            axis.speed_mhz = (speed_hz * 1e3) as i32;
        }
        tell_status(&mut dashboard, at, "laser-1", moving);
        if tick.is_multiple_of(10) {
            let mut told = record("laser-1", NodeWord::Running);
            told.clock = Some(ClockRecord {
                offset_us: 1_000.0 - tick as f64,
                error_us: 20.0 + 2_000.0 / (tick + 10) as f64,
                drift_ppm: -10.0,
            });
            told.faults = vec![FaultRecord {
                code: 101,
                message: "link lost while moving".to_owned(),
                at: keys::FleetMicros(crate::fixture::START.0 + 1_500_000),
            }];
            tell(&mut dashboard, at, Message::Node(Box::new(told)));
        }
    }
    for second in 0..=10_u64 {
        let link = LinkRecord {
            node: id,
            rtt_us_min: Some(400.0),
            rtt_us_max: Some(1_000.0 + 100.0 * second as f64),
        };
        let at = at_ms(second * 1_000);
        tell(&mut dashboard, at, Message::Travels(vec![link]));
    }
    for number in 0..3 {
        for name in ["laser-1", "other"] {
            let (node, text) = (node(name), format!("line {number} of {name}"));
            tell(&mut dashboard, at_ms(10_000), Message::Log { node, text });
        }
    }
    dashboard.view.focus = Some(node("laser-1"));
    dashboard
}

fn page(page: Page) -> Window {
    let mut window = show(circle());
    click(&mut window, Role::Button, page.title());
    assert_eq!(window.state().view.node.page, page);
    window
}

/// The same with the vitals of its board.
fn circle_with_vitals() -> Dashboard {
    let mut dashboard = circle();
    let vitals = Vitals {
        chip_celsius: Some(52),
        internal_free_bytes: Some(40_000),
        psram_free_bytes: Some(7_340_032),
        network_stack_free_bytes: Some(12_288),
        planning_stack_free_bytes: Some(6_144),
        ..Vitals::default()
    };
    let node = node("laser-1");
    let told = Message::Vitals { node, vitals };
    tell(&mut dashboard, at_ms(10_000), told);
    dashboard
}

#[test]
fn temperature_heap_and_stack_are_shown_with_their_age_when_they_are_old() {
    let window = show(circle_with_vitals());
    for words in [
        "52 °C",
        "39.1 KiB inside, 7.0 MiB outside",
        "12.0 KiB network, 6.0 KiB planning",
    ] {
        assert!(shows(&window, words), "{words}");
    }
    let mut dashboard = circle_with_vitals();
    let quiet = Message::Log {
        node: node("laser-1"),
        text: "still here".to_owned(),
    };
    tell(&mut dashboard, at_ms(60_000), quiet);
    assert!(shows(&show(dashboard), "52 °C, 50 s ago"));
}

#[test]
fn what_nobody_sends_is_said_to_be_not_told() {
    let window = show(circle());
    for name in ["RSSI", "temperature", "free heap"] {
        assert!(shows(&window, name), "{name}");
    }
    assert!(shows(&window, "not told"));
}

#[test]
fn a_hold_and_another_speed_are_told_in_the_list_and_on_the_page() {
    for (hold, percent, words) in [(false, 50, "at 50 %"), (true, 50, "held, at 50 %")] {
        let mut dashboard = circle();
        let mut told = record("laser-1", NodeWord::Running);
        told.pace = Some(PaceRecord { hold, percent });
        let message = Message::Node(Box::new(told.clone()));
        tell(&mut dashboard, at_ms(10_000), message);
        let window = show(dashboard);
        let told = window.get_all_by_label_contains(words).count();
        assert!(told >= 2, "{words}: {told}");
    }
}

#[test]
fn faults_have_their_times() {
    let window = show(circle());
    assert!(shows(&window, "03:00:01.500  101 link lost while moving"));
}

#[test]
fn the_cursor_reads_position_speed_and_queue() {
    let mut window = page(Page::Motion);
    assert!(shows(&window, "point at a plot to read its values"));
    for plot in ["Plot of Position", "Plot of Speed", "Plot of Queue"] {
        point_at(&mut window, Role::Image, plot);
        assert!(shows(&window, "s ago: "), "{plot}");
        assert!(shows(&window, "waiting"), "{plot}");
    }
    let cursor_s = window.state().view.node.cursor_s.expect("in the plot");
    assert!((-7.0..-3.0).contains(&cursor_s), "the middle: {cursor_s}");
}

#[test]
fn the_path_shows_any_two_axes() {
    let mut window = page(Page::Path);
    assert!(shows(&window, "Plot of the tool's path"));
    click(&mut window, Role::ComboBox, "Vertical");
    button(&mut window, "axis 0");
    assert_eq!(window.state().view.node.path_up, 0);
}

#[test]
fn the_clock_tells_its_error_at_the_cursor() {
    let mut window = page(Page::Clock);
    assert!(shows(&window, "round trip 0.40 to 2.00 ms"));
    point_at(&mut window, Role::Image, "Plot of Error");
    assert!(shows(&window, "s ago: +"));
}

#[test]
fn a_node_has_only_its_own_lines() {
    let window = page(Page::Lines);
    assert!(shows(&window, "4 lines of this node"));
    assert!(shows(&window, "line 2 of laser-1"));
}

#[test]
fn the_setup_says_what_the_firmware_can_do() {
    let window = page(Page::Setup);
    assert!(shows(&window, "moves"));
    assert!(shows(&window, "room for 4096 commands"));
}

#[test]
fn a_node_that_said_nothing_has_a_page_without_plots() {
    for page in Page::ALL {
        let mut dashboard = connected();
        let (id, alive) = (node("mute"), true);
        tell(&mut dashboard, at_ms(0), Message::Alive { node: id, alive });
        dashboard.view.focus = Some(id);
        dashboard.view.node.page = page;
        let window = show(dashboard);
        assert!(shows(&window, "mute"), "{page:?}");
    }
}

#[test]
fn a_plot_becomes_a_table() {
    let folder = tempfile::tempdir().expect("a folder");
    let mut window = page(Page::Motion);
    window.state_mut().view.node.folder = folder.path().display().to_string();
    button(&mut window, "Save CSV");
    window.state_mut().files.wait();
    window.run_steps(2);
    assert!(shows(&window, "✔ written: "));
    let file = folder.path().join("laser-1-motion-2026-11-21T030010.csv");
    let text = std::fs::read_to_string(&file).expect("the file");
    let mut lines = text.lines();
    let head = "heard_unix_us,node_us,queue_commands,laser_percent,\
                position0_steps,speed0_hz,position1_steps,speed1_hz";
    assert_eq!(lines.next(), Some(head));
    let first = "1795230000000000,0,30,0,2000,0,0,1257";
    assert_eq!(lines.next(), Some(first));
    assert_eq!(lines.count(), 100);
    button(&mut window, "Save CSV");
    window.state_mut().files.wait();
    window.run_steps(2);
    assert!(shows(&window, "File exists"), "never over another one");
}

#[test]
fn a_node_is_held_resumed_and_slowed_and_says_what_became_of_it() {
    use dashboard::request::{Order, Request};
    let order = |order| Request::Order {
        node: node("laser-1"),
        order,
    };
    let mut window = show(circle());
    button(&mut window, "Hold");
    let asked_for = asked(&mut window);
    assert_eq!(asked_for[0].1, order(Order::Hold));
    assert!(shows(&window, "⌛ hold"));
    let ticket = asked_for[0].0;
    let answer = Answer::Failed("no gateway answers".to_owned());
    let told = Message::Answer { ticket, answer };
    tell(window.state_mut(), at_ms(10_100), told);
    window.run_steps(2);
    assert!(shows(&window, "✖ hold: no gateway answers"));
    button(&mut window, "Resume");
    assert_eq!(asked(&mut window), [], "it is not paused");
    let paused = status(NodeState::Paused, 10_200, [0, 0], 0);
    tell_status(window.state_mut(), at_ms(10_200), "laser-1", paused);
    window.run_steps(2);
    button(&mut window, "Resume");
    assert_eq!(asked(&mut window)[0].1, order(Order::Resume));
    window.state_mut().view.node.speed_percent = 50;
    window.run_steps(2);
    button(&mut window, "Set speed");
    let asked_for = asked(&mut window);
    assert_eq!(asked_for[0].1, order(Order::Speed(50)));
    assert_eq!(
        Order::Speed(50).message(),
        ("speed", r#"{"percent":50}"#.to_owned())
    );
    let (ticket, refused) = (asked_for[0].0, Vec::new());
    let answer = Answer::Done { count: 1, refused };
    tell(
        window.state_mut(),
        at_ms(10_300),
        Message::Answer { ticket, answer },
    );
    window.run_steps(2);
    assert!(shows(&window, "✔ speed 50 % taken"));
}

#[test]
fn the_clocks_table_has_the_round_trips() {
    let folder = tempfile::tempdir().expect("a folder");
    let mut window = page(Page::Clock);
    window.state_mut().view.node.folder = folder.path().display().to_string();
    button(&mut window, "Save CSV");
    window.state_mut().files.wait();
    window.run_steps(2);
    let file = folder.path().join("laser-1-clock-2026-11-21T030010.csv");
    let text = std::fs::read_to_string(&file).expect("the file");
    let lines: Vec<&str> = text.lines().collect();
    let head = "heard_unix_us,offset_us,error_us,drift_ppm,rtt_us_min,rtt_us_max";
    assert_eq!(lines[0], head);
    assert_eq!(lines[1], "1795230000000000,1000,220,-10,400,1000");
    assert!(lines.last().is_some_and(|last| last.ends_with(",400,2000")));
}

#[test]
fn a_plot_becomes_a_picture() {
    let folder = tempfile::tempdir().expect("a folder");
    let mut window = page(Page::Motion);
    window.state_mut().view.node.folder = folder.path().display().to_string();
    button(&mut window, "Save PNG");
    window.run_steps(4);
    assert!(shows(&window, "✔ written: "));
    let file = folder.path().join("laser-1-motion-2026-11-21T030010.png");
    let bytes = std::fs::read(file).expect("the file");
    assert!(bytes.starts_with(b"\x89PNG\r\n"), "{} bytes", bytes.len());
}

fn picture_of_page(name: &str, page: Page) {
    picture(name, |theme| {
        let mut dashboard = circle();
        dashboard.view.node.page = page;
        show_in(dashboard, theme, SIZE)
    });
}

#[test]
fn picture_of_the_overview() {
    picture("node_overview", |theme| {
        show_in(circle_with_vitals(), theme, SIZE)
    });
}

#[test]
fn picture_of_the_lines() {
    picture_of_page("node_lines", Page::Lines);
}

#[test]
fn picture_of_the_motion() {
    picture_of_page("node_motion", Page::Motion);
}

#[test]
fn picture_of_the_path() {
    picture_of_page("node_path", Page::Path);
}

#[test]
fn picture_of_the_clock() {
    picture_of_page("node_clock", Page::Clock);
}
