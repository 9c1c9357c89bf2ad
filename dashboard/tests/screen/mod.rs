//! A dashboard on a screen that is none: shown, clicked by accessible names, photographed.

#![allow(dead_code, reason = "each test binary uses its own part of it")]

use dashboard::{
    app::Dashboard,
    request::{Request, Ticket},
};
use egui::{Role, Theme};
use egui_kittest::{
    Harness, OsThreshold, SnapshotOptions, SnapshotResults, kittest::Queryable as _,
};

/// What a test holds of the screen.
pub(crate) type Screen = Harness<'static, Dashboard>;

/// Shows a dashboard, large and dark.
pub(crate) fn show(dashboard: Dashboard) -> Screen {
    show_in(dashboard, Theme::Dark, [1_440.0, 860.0])
}

fn show_in(dashboard: Dashboard, theme: Theme, size: [f32; 2]) -> Screen {
    let mut screen = Harness::builder()
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
    screen.run_steps(3);
    screen
}

/// Clicks what has this role and name.
pub(crate) fn click(screen: &mut Screen, role: Role, name: &str) {
    screen.get_by_role_and_label(role, name).click();
    screen.run_steps(3);
}

/// Clicks a button.
pub(crate) fn button(screen: &mut Screen, name: &str) {
    click(screen, Role::Button, name);
}

/// Returns what was asked since the last call.
pub(crate) fn asked(screen: &mut Screen) -> Vec<(Ticket, Request)> {
    let now = screen.state().model.now();
    let asked = screen.state_mut().take_requests(now);
    screen.run_steps(2);
    asked
}

/// Returns whether something with these words is shown.
pub(crate) fn shows(screen: &Screen, words: &str) -> bool {
    screen.query_all_by_label_contains(words).next().is_some()
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
