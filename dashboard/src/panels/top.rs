//! The bar that is always there: the fleet in numbers, the link, and STOP ALL.

use crate::{
    model::{
        Model, Totals,
        alarms::Alarms,
        link::{LinkState, Phase},
    },
    recording::session::Session,
    request::{Request, Requests, Scope},
    text,
    theme::{self, Badge, Tone},
    view::{Tab, View},
};
use egui::{Align, Label, Layout, RichText, Ui};
use keys::StopMode;

/// Room for the buttons at the right, points.
const BUTTONS_WIDTH: f32 = 145.0;

/// Least room for the numbers, points.
const NUMBERS_WIDTH_MIN: f32 = 150.0;

/// Shows the bar.
pub fn top_ui(
    ui: &mut Ui,
    model: &Model,
    session: &Session,
    view: &mut View,
    requests: &mut Requests,
) {
    ui.add_space(4.0);
    ui.horizontal(|ui| {
        ui.set_min_height(theme::STOP_ALL_SIZE.y);
        stop_all_ui(ui, requests);
        let totals = model.totals();
        let stopped = totals.stopped > 0;
        let release = ui.add_enabled(stopped, egui::Button::new("Release…"));
        let release =
            release.on_hover_text("Lift the stop latch of stopped nodes, in a second step");
        let release = release.on_disabled_hover_text("no node is stopped");
        if release.clicked() {
            view.stop.releasing = Some(Scope::All);
        }
        ui.separator();
        ui.vertical(|ui| {
            ui.set_max_width((ui.available_width() - BUTTONS_WIDTH).max(NUMBERS_WIDTH_MIN));
            ui.horizontal_wrapped(|ui| {
                counts_ui(ui, &totals);
                alarms_ui(ui, model.alarms(), view);
                recording_ui(ui, session, view);
            });
            ui.horizontal_wrapped(|ui| {
                link_ui(ui, model);
                clock_ui(ui, totals.worst_clock_error_us, totals.clocks_unknown);
            });
        });
        ui.with_layout(Layout::right_to_left(Align::Center), |ui| {
            let help = ui.button("?").on_hover_text("Keys");
            theme::named(&help, egui::Role::Button, "Keys");
            if help.clicked() {
                view.help_open = !view.help_open;
            }
            egui::global_theme_preference_buttons(ui);
        });
    });
    ui.add_space(4.0);
}

fn stop_all_ui(ui: &mut Ui, requests: &mut Requests) {
    let text = RichText::new("STOP ALL")
        .size(24.0)
        .strong()
        .color(theme::STOP_TEXT);
    let button = egui::Button::new(text)
        .fill(theme::STOP_FILL)
        .min_size(theme::STOP_ALL_SIZE);
    let response = ui.add(button).on_hover_text(
        "Every node halts at once (F1 or Ctrl+Space).\n\
         A software stop: it needs the network and the nodes' programs. It replaces no emergency stop.",
    );
    if response.clicked() {
        let (scope, mode) = (Scope::All, StopMode::Halt);
        requests.push(Request::Stop { scope, mode });
    }
}

fn counts_ui(ui: &mut Ui, totals: &Totals) {
    let count = |ui: &mut Ui, tone: Tone, icon: &str, count: usize, word: &str| {
        let tone = if count == 0 { Tone::Quiet } else { tone };
        let words = theme::toned(ui, tone, format!("{icon} {count} {word}"));
        // Never in the middle of it onto the next line.
        ui.add(Label::new(words).extend());
    };
    if totals.unknown > 0 {
        count(ui, Tone::Bad, "?", totals.unknown, "unknown");
    }
    count(ui, Tone::Good, "●", totals.alive, "alive");
    count(ui, Tone::Busy, "▶", totals.running, "running");
    count(ui, Tone::Quiet, "○", totals.offline, "offline");
    count(ui, Tone::Bad, "⏹", totals.stopped, "stopped");
    // Rare, and room is short on a small screen.
    for (tone, icon, number, word) in [
        (Tone::Warn, "⚠", totals.stale, "silent"),
        (Tone::Bad, "✖", totals.faults, "fault"),
    ] {
        if number > 0 {
            count(ui, tone, icon, number, word);
        }
    }
}

/// Opens the list. What somebody has seen counts on while its cause is there.
fn alarms_ui(ui: &mut Ui, alarms: &Alarms, view: &mut View) {
    let (unseen, open) = (alarms.unseen(), alarms.open());
    let mut words = format!("⚠ {}", text::count(unseen, "alarm"));
    if unseen == 0 && open > 0 {
        words += &format!(", {open} still open");
    }
    let tone = match (unseen, open) {
        (0, 0) => Tone::Quiet,
        (0, _) => Tone::Warn,
        _ => Tone::Bad,
    };
    let words = theme::toned(ui, tone, words);
    let button = ui.add(egui::Button::new(words).small());
    if button
        .on_hover_text("not acknowledged; opens the list (Ctrl+M)")
        .clicked()
    {
        view.tab = Tab::Alarms;
    }
}

/// Says that a recording runs, or that it should and does not; opens the panel.
fn recording_ui(ui: &mut Ui, session: &Session, view: &mut View) {
    let Some(recorder) = session.recorder() else {
        return;
    };
    let (words, tone, hint) = match recorder.failed() {
        None => (
            "⏺ recording",
            Tone::Busy,
            recorder.path().display().to_string(),
        ),
        Some(why) => ("✖ NOT RECORDED", Tone::Bad, why),
    };
    let words = theme::toned(ui, tone, words);
    let button = ui.add(egui::Button::new(words).small());
    if button.on_hover_text(hint).clicked() {
        view.tab = Tab::Recording;
    }
}

fn link_ui(ui: &mut Ui, model: &Model) {
    let link = model.link();
    let badge = link_badge(link);
    let since = text::age(model.now().since_s(link.since()));
    let words = match link.phase() {
        Phase::Up => format!("{} to {}", badge.word, link.to()),
        Phase::Connecting => format!("{} to {}", badge.word, link.to()),
        Phase::Down => format!("{} for {since}: what you see is old", badge.word),
        Phase::Unused => badge.word.to_owned(),
    };
    let text = theme::toned(ui, badge.tone, format!("{} {words}", badge.icon));
    let response = ui.label(text);
    if let Some(why) = link.why() {
        response.on_hover_text(format!("{why}. Trying {} again and again.", link.to()));
    }
}

/// Returns the badge of the link.
pub fn link_badge(link: &LinkState) -> Badge {
    let (icon, word, tone) = match (link.phase(), link.gateway()) {
        (Phase::Unused, _) => ("○", "not connected", Tone::Quiet),
        (Phase::Connecting, _) => ("⌛", "connecting", Tone::Warn),
        (Phase::Down, _) => ("✖", "no link", Tone::Bad),
        (Phase::Up, Some(true)) => ("●", "connected", Tone::Good),
        (Phase::Up, Some(false)) => ("⚠", "NO GATEWAY; connected", Tone::Bad),
        (Phase::Up, None) => ("●", "connected", Tone::Good),
    };
    Badge { icon, word, tone }
}

fn clock_ui(ui: &mut Ui, worst_us: Option<f64>, unknown: usize) {
    let words = match worst_us {
        Some(worst_us) => format!("worst clock error ±{}", text::micros(worst_us)),
        None => "no clock known".to_owned(),
    };
    ui.label(theme::toned(ui, Tone::Quiet, words));
    if unknown > 0 && worst_us.is_some() {
        let words = format!("⚠ {} without a clock", text::count(unknown, "node"));
        let words = theme::toned(ui, Tone::Warn, words);
        ui.add(Label::new(words).extend());
    }
}
