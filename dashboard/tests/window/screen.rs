//! The window on a harness: clicks by accessible name, pictures in both themes.

#![allow(dead_code, reason = "each test binary uses its own part of it")]

use dashboard::{
    app::Dashboard,
    request::{Request, Ticket},
};
use egui::{Role, Theme};
use egui_kittest::{
    Harness, OsThreshold, SnapshotOptions, SnapshotResults, kittest::Queryable as _,
};

/// The window with a dashboard in it.
pub(crate) type Window = Harness<'static, Dashboard>;

/// The same.
pub(crate) type Screen = Window;

/// Shows a dashboard in a window of the usual size.
pub(crate) fn show(dashboard: Dashboard) -> Window {
    show_in(dashboard, egui::Theme::Dark, [1_440.0, 860.0])
}

/// Shows a dashboard.
pub(crate) fn show_in(dashboard: Dashboard, theme: egui::Theme, size: [f32; 2]) -> Window {
    let mut window = Harness::builder()
        .with_size(size)
        .with_theme(theme)
        .with_context_setup(dashboard::theme::apply)
        .build_ui_state(
            |ui, dashboard: &mut Dashboard| {
                // The harness leaves a transparent border, which the packed pictures cannot have.
                let background = egui::LayerId::background();
                let (all, fill) = (ui.ctx().content_rect(), ui.visuals().panel_fill);
                let painter = ui.ctx().layer_painter(background);
                painter.rect_filled(all, 0.0, fill);
                dashboard.ui(ui);
            },
            dashboard,
        );
    window.run_steps(3);
    window
}

/// Clicks what has this role and name.
pub(crate) fn click(window: &mut Window, role: Role, name: &str) {
    window.get_by_role_and_label(role, name).click();
    window.run_steps(3);
}

/// Clicks a button.
pub(crate) fn button(window: &mut Window, name: &str) {
    click(window, Role::Button, name);
}

/// Moves the pointer into the middle of what has this role and name.
pub(crate) fn point_at(window: &mut Window, role: Role, name: &str) {
    window.get_by_role_and_label(role, name).hover();
    window.run_steps(3);
}

/// Returns whether words stand somewhere.
pub(crate) fn shows(window: &Window, words: &str) -> bool {
    window.query_all_by_label_contains(words).next().is_some()
}

/// Compares with the pictures `<name>_dark.png` and `<name>_light.png`.
pub(crate) fn snapshot(name: &str, prepare: impl Fn(egui::Theme) -> Window) {
    let mut results = SnapshotResults::new();
    // Other versions of the software renderer draw edges of glyphs a little differently.
    let options = SnapshotOptions::new()
        .threshold(OsThreshold::new(1.5))
        .max_failed_pixels(OsThreshold::new(400));
    for (theme, suffix) in [(egui::Theme::Dark, "dark"), (egui::Theme::Light, "light")] {
        let mut window = prepare(theme);
        window.snapshot_options(format!("{name}_{suffix}"), &options);
        results.extend_harness(&mut window);
    }
    results.unwrap();
}

/// Returns what was asked since the last call.
pub(crate) fn asked(screen: &mut Screen) -> Vec<(Ticket, Request)> {
    let now = screen.state().model.now();
    let asked = screen.state_mut().take_requests(now);
    screen.run_steps(2);
    asked
}

/// Small, so that each picture stays below 100 kB; also what a small screen shows.
const PICTURE_SIZE: [f32; 2] = [980.0, 560.0];

/// Compares pictures, dark and light, with those that were looked at.
pub(crate) fn picture(name: &str, dashboard: impl Fn() -> Dashboard) {
    // Other versions of the software renderer draw edges of glyphs a little differently.
    let options = SnapshotOptions::new()
        .threshold(OsThreshold::new(1.5))
        .max_failed_pixels(OsThreshold::new(400));
    let mut results = SnapshotResults::new();
    for (theme, suffix) in [(Theme::Dark, "dark"), (Theme::Light, "light")] {
        let mut screen = show_in(dashboard(), theme, PICTURE_SIZE);
        screen.remove_cursor();
        screen.run_steps(2);
        screen.snapshot_options(format!("{name}_{suffix}"), &options);
        results.extend_harness(&mut screen);
    }
    results.unwrap();
}
