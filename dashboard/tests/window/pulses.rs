//! The pulse inspector, from the file to the list of violations.

use crate::screen::{Window, button, picture, point_at, show, show_in, shows};
use dashboard::{app::Dashboard, model::capture::Capture, view::Tab};
use egui::Role;
use std::sync::Arc;

/// Two axes speed up and turn round; one pulse of axis 1 is too narrow, and its direction turns
/// 100 ns before a step.
fn dump() -> String {
    let mut text = String::from(
        "$timescale 100 ps $end\n$var wire 1 ! step0 $end\n$var wire 1 \" dir0 $end\n\
         $var wire 1 # step1 $end\n$var wire 1 $ dir1 $end\n$enddefinitions $end\n",
    );
    let mut changes: Vec<(u64, &str)> = vec![(0, "1\""), (0, "1$")];
    let us = |us: f64| (us * 1e4) as u64;
    let mut at_us = 20.0;
    for step in 0..60_u32 {
        changes.push((us(at_us), "1!"));
        changes.push((us(at_us + 2.0), "0!"));
        if step % 2 == 0 {
            let narrow = if step == 20 { 0.5 } else { 2.0 };
            changes.push((us(at_us + 5.0), "1#"));
            changes.push((us(at_us + 5.0 + narrow), "0#"));
        }
        if step == 30 {
            changes.push((us(at_us + 10.0), "0\""));
        }
        at_us += 20.0 + 600.0 / f64::from(step + 3);
        if step == 39 {
            changes.push((us(at_us + 4.9), "0$"));
        }
    }
    changes.sort_by_key(|(at, _)| *at);
    for (at, change) in changes {
        text += &format!("#{at}\n{change}\n");
    }
    text
}

fn inspector(text: &str) -> Dashboard {
    let mut dashboard = crate::fixture::connected();
    dashboard.view.tab = Tab::Pulses;
    let capture = Capture::parse("left.vcd", text).map(Arc::new);
    dashboard.view.pulses.opened("left.vcd".to_owned(), capture);
    dashboard
}

fn served(window: &mut Window) {
    window.run_steps(1);
    window.state_mut().files.wait();
    window.run_steps(3);
}

#[test]
fn a_file_is_opened_by_its_name() {
    let folder = tempfile::tempdir().expect("a folder");
    let file = folder.path().join("left.vcd");
    std::fs::write(&file, dump()).expect("a file");
    let mut dashboard = crate::fixture::connected();
    dashboard.view.tab = Tab::Pulses;
    dashboard.view.pulses.path = file.display().to_string();
    let mut window = show(dashboard);
    button(&mut window, "Open capture");
    served(&mut window);
    assert!(shows(&window, "left.vcd: 2 axes, 184 edges"));
    window.state_mut().view.pulses.path = folder.path().join("none.vcd").display().to_string();
    button(&mut window, "Open capture");
    served(&mut window);
    assert!(shows(&window, "none.vcd: No such file"));
}

#[derive(Debug)]
struct Dropped(std::path::PathBuf);

impl egui::DroppedFile for Dropped {
    fn path(&self) -> &std::path::Path {
        &self.0
    }

    fn bytes(&self) -> Result<Vec<u8>, String> {
        Err("read by its path".to_owned())
    }
}

#[test]
fn a_file_that_is_dropped_is_opened() {
    let mut window = show(crate::fixture::connected());
    let file = Dropped("/nowhere/dropped.vcd".into());
    window.input_mut().dropped_files.push(Arc::new(file));
    served(&mut window);
    assert_eq!(window.state().view.tab, Tab::Pulses);
    assert!(shows(&window, "/nowhere/dropped.vcd: No such file"));
}

#[test]
fn the_pointer_measures_interval_speed_and_acceleration() {
    let mut window = show(inspector(&dump()));
    assert!(shows(&window, "point at the timeline to measure"));
    point_at(&mut window, Role::Image, "Timeline of the pins");
    assert!(window.state().view.pulses.cursor_ps.is_some());
    assert!(shows(&window, "axis 0: 1"));
    assert!(shows(&window, " steps/s²"));
    assert!(shows(&window, "interval "));
}

#[test]
fn violations_are_listed_and_follow_the_limits() {
    let mut window = show(inspector(&dump()));
    assert!(shows(&window, "✖ 2 violations of the rules"));
    assert!(shows(
        &window,
        "axis 1: 500.0 of 1900 ns, step high too short"
    ));
    let setup = "axis 1: 100.0 of 650 ns, direction changed too shortly before a step";
    assert!(shows(&window, setup));
    window.state_mut().view.pulses.limits.setup_min_ns = 90;
    window.run_steps(2);
    assert!(shows(&window, "✖ 1 violation of the rules"));
    window.state_mut().view.pulses.limits.high_min_ns = 400;
    window.run_steps(2);
    assert!(shows(&window, "no time is too short"));
    button(&mut window, "Defaults");
    assert!(shows(&window, "✖ 2 violations of the rules"));
}

#[test]
fn a_click_on_a_violation_goes_to_it() {
    let mut window = show(inspector(&dump()));
    let found = inspector_violation(&window, "step high too short");
    button(&mut window, &found);
    point_at(&mut window, Role::Image, "Timeline of the pins");
    let at_ps = window
        .state()
        .view
        .pulses
        .cursor_ps
        .expect("in the timeline");
    let at_us: f64 = found
        .split(' ')
        .next()
        .and_then(|word| word.parse().ok())
        .expect("µs");
    assert!(
        (at_ps as f64 / 1e6 - at_us).abs() < 10.0,
        "{at_ps} ps is far from {at_us} µs"
    );
}

fn inspector_violation(window: &Window, words: &str) -> String {
    use egui_kittest::kittest::{NodeT as _, Queryable as _};
    let node = window.get_by_label_contains(words);
    let label = node.accesskit_node().label();
    label.expect("a button has a name")
}

/// The dump with what the oracle says about it.
fn judged(words: &[&str]) -> String {
    let comments = words.iter();
    let comments = comments.map(|words| format!("$comment stepfleet-verdict {words} $end\n"));
    dump() + &comments.collect::<String>()
}

#[test]
fn what_the_oracle_found_is_shown_and_a_click_goes_there() {
    let window = show(inspector(&dump()));
    assert!(shows(&window, "no oracle judged this file"));
    let window = show(inspector(&judged(&["good 2 commands, steps [60, 30]"])));
    assert!(shows(
        &window,
        "✔ the oracle found nothing wrong: 2 commands"
    ));
    let found = [
        "violation 20000000 speed jumps by 400 Hz",
        "violation - 3 steps are missing",
    ];
    let mut window = show(inspector(&judged(&found)));
    assert!(shows(&window, "✖ 2 violations found by the oracle"));
    assert!(shows(&window, "3 steps are missing"));
    button(&mut window, "2000.000 µs: speed jumps by 400 Hz");
    point_at(&mut window, Role::Image, "Timeline of the pins");
    let at_ps = window
        .state()
        .view
        .pulses
        .cursor_ps
        .expect("in the timeline");
    assert!(at_ps.abs_diff(2_000_000_000) < 50_000_000, "{at_ps} ps");
}

#[test]
fn what_is_no_capture_says_why() {
    let window = show(inspector("PK\u{3}\u{4}"));
    assert!(shows(&window, "✖ left.vcd: line 1:"));
}

#[test]
fn picture_of_the_pulses() {
    let size = [1_100.0, 640.0];
    picture("pulses", |theme| {
        let dump = judged(&["violation 20000000 speed jumps by 400 Hz: at most 200 are allowed"]);
        let mut window = show_in(inspector(&dump), theme, size);
        point_at(&mut window, Role::Image, "Timeline of the pins");
        window
    });
}
