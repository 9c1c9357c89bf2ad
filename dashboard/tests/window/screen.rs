//! The window on a harness: clicks by accessible name, pictures in both themes.

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

/// Shows a dashboard in a window of the usual size.
pub(crate) fn show(dashboard: Dashboard) -> Window {
    show_in(dashboard, Theme::Dark, [1_440.0, 860.0])
}

/// Shows a dashboard in a window of so many points.
pub(crate) fn show_in(dashboard: Dashboard, theme: Theme, size: [f32; 2]) -> Window {
    show_at(dashboard, theme, size, 1.0)
}

/// Shows a dashboard in a window of so many points, each of so many pixels.
pub(crate) fn show_at(
    dashboard: Dashboard,
    theme: Theme,
    size: [f32; 2],
    pixels_per_point: f32,
) -> Window {
    let mut window = Harness::builder()
        .with_size(size)
        .with_theme(theme)
        .with_pixels_per_point(pixels_per_point)
        .with_context_setup(dashboard::theme::apply)
        .build_ui_state(
            |ui, dashboard: &mut Dashboard| {
                // The harness leaves a transparent border, which the packed pictures cannot have.
                let background = egui::LayerId::background();
                let (all, fill) = (ui.ctx().content_rect(), ui.visuals().panel_fill);
                let painter = ui.ctx().layer_painter(background);
                painter.rect_filled(all, 0.0, fill);
                dashboard.logic(ui.ctx());
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

/// Returns what was asked since the last call.
pub(crate) fn asked(screen: &mut Window) -> Vec<(Ticket, Request)> {
    let now = screen.state().model.now();
    let asked = screen.state_mut().take_requests(now);
    screen.run_steps(2);
    asked
}

/// Begins what was asked of files, waits until it is done, and shows it.
pub(crate) fn do_files(window: &mut Window) {
    let context = window.ctx.clone();
    for (ticket, request) in asked(window) {
        let is_file = window.state_mut().files.ask(&context, ticket, &request);
        assert!(is_file, "{request:?}");
    }
    window.run_steps(1);
    window.state_mut().files.wait();
    window.run_steps(3);
}

/// Small, so that each picture stays below 100 kB; also what a small screen shows.
pub(crate) const PICTURE_SIZE: [f32; 2] = [980.0, 560.0];

/// Compares with the pictures `<name>_dark.png` and `<name>_light.png`, which were looked at.
pub(crate) fn picture(name: &str, prepare: impl Fn(Theme) -> Window) {
    // Other versions of the software renderer draw edges of glyphs a little differently.
    let options = SnapshotOptions::new()
        .threshold(OsThreshold::new(1.5))
        .max_failed_pixels(OsThreshold::new(400));
    let mut results = SnapshotResults::new();
    for (theme, suffix) in [(Theme::Dark, "dark"), (Theme::Light, "light")] {
        let mut window = prepare(theme);
        window.snapshot_options(format!("{name}_{suffix}"), &options);
        results.extend_harness(&mut window);
    }
    results.unwrap();
}

/// The same of a dashboard in a small window.
pub(crate) fn picture_of(name: &str, dashboard: impl Fn() -> Dashboard) {
    picture(name, |theme| {
        let mut window = show_in(dashboard(), theme, PICTURE_SIZE);
        window.remove_cursor();
        window.run_steps(2);
        window
    });
}
