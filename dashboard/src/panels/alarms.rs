//! What needed somebody, newest first, each with what became of it, and who has seen it.

use super::table::table_ui;
use crate::{
    model::{
        Model,
        alarms::{Alarm, Cause},
    },
    request::{Request, Requests},
    sound::Sound,
    text,
    theme::{self, Badge, Tone},
    view::View,
};
use egui::{Context, RichText, Ui, UserAttentionType, ViewportCommand};
use serde::{Deserialize, Serialize};
use std::time::Duration;

/// Time between two looks whether the sound has ended.
const SOUND_POLL_EVERY: Duration = Duration::from_millis(200);

/// What the panel remembers.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
#[serde(default)]
pub struct AlarmsView {
    /// Shows those too that are over and acknowledged.
    pub show_past: bool,
    /// Asks the desktop to mark this window when there is a new alarm.
    pub attention: bool,
    /// Plays a sound when there is a new alarm.
    pub sound: bool,
    /// The latest alarm for which that was done.
    #[serde(skip)]
    called_for: u64,
}

/// Marks the window in the task bar and plays a sound when there is a new alarm, each if the
/// operator wants that.
pub fn call(ctx: &Context, model: &Model, view: &mut View, sound: &mut Sound) {
    let latest = model.alarms().latest();
    let is_new = std::mem::replace(&mut view.alarms.called_for, latest) < latest;
    if is_new && view.alarms.attention {
        let attention = ViewportCommand::RequestUserAttention(UserAttentionType::Critical);
        ctx.send_viewport_cmd(attention);
    }
    if is_new && view.alarms.sound {
        sound.play();
    }
    if sound.poll() {
        ctx.request_repaint_after(SOUND_POLL_EVERY);
    }
}

/// Returns the alarms that are listed.
pub fn shown<'m>(model: &'m Model, view: &AlarmsView) -> Vec<&'m Alarm> {
    let past = |alarm: &&Alarm| alarm.over.is_some() && alarm.seen.is_some();
    let alarms = model.alarms().newest_first();
    alarms
        .filter(|alarm| view.show_past || !past(alarm))
        .collect()
}

/// Shows the list.
pub fn alarms_ui(
    ui: &mut Ui,
    model: &Model,
    sound: &mut Sound,
    view: &mut View,
    requests: &mut Requests,
) {
    let alarms = model.alarms();
    let rows = shown(model, &view.alarms);
    ui.horizontal_wrapped(|ui| {
        let all = egui::Button::new("Acknowledge all");
        if ui.add_enabled(alarms.unseen() > 0, all).clicked() {
            requests.push(Request::Acknowledge { alarm: None });
        }
        ui.checkbox(&mut view.alarms.show_past, "Show past");
        ui.checkbox(&mut view.alarms.attention, "Mark the window")
            .on_hover_text("Asks the desktop to mark this window when there is a new alarm");
        ui.checkbox(&mut view.alarms.sound, "Sound")
            .on_hover_text("Plays a short sound when there is a new alarm");
        if view.alarms.sound && ui.button("Try the sound").clicked() {
            sound.play();
        }
        if let Some(why) = sound.failed() {
            let words = format!("⚠ no sound: {why}");
            ui.label(theme::toned(ui, Tone::Warn, words));
        }
        let words = format!(
            "{} not acknowledged, {} listed",
            alarms.unseen(),
            rows.len()
        );
        ui.label(theme::toned(ui, Tone::Quiet, words));
        if alarms.forgotten_unseen() > 0 {
            let words = format!("⚠ {} older ones did not fit", alarms.forgotten_unseen());
            ui.label(theme::toned(ui, Tone::Warn, words));
        }
    });
    if rows.is_empty() {
        ui.label(theme::toned(ui, Tone::Good, "✔ nothing needs anybody"));
        return;
    }
    table_ui(ui, "alarms", &COLUMNS, &rows, |ui, alarm, column| {
        Some(match column {
            0 => RichText::new(text::time_of_day(alarm.raised)),
            1 => {
                node_ui(ui, alarm, view);
                return None;
            }
            2 => theme::alarm_badge(alarm.cause).text(ui),
            3 => now_badge(model, alarm).text(ui),
            4 => {
                seen_ui(ui, alarm, requests);
                return None;
            }
            _ => RichText::new(&alarm.text),
        })
    });
}

const COLUMNS: [(&str, f32); 6] = [
    ("Time (UTC)", 105.0),
    ("Node", 110.0),
    ("Alarm", 90.0),
    ("Now", 120.0),
    ("Acknowledged", 125.0),
    ("What", 480.0),
];

fn node_ui(ui: &mut Ui, alarm: &Alarm, view: &mut View) {
    let Some(node) = alarm.node else { return };
    let link = ui.add(egui::Button::new(node.as_str()).frame(false));
    let name = format!("Page of {node}, alarm {}", alarm.id);
    theme::named(&link, egui::Role::Button, &name);
    if link.clicked() {
        view.focus = Some(node);
    }
}

fn now_badge(model: &Model, alarm: &Alarm) -> Badge {
    let (icon, word, tone) = match alarm.over {
        Some(_) => ("✔", "over", Tone::Quiet),
        // Of nodes nobody knows without a link; that there is none, everybody.
        None if model.link().is_up() || alarm.cause == Cause::Link => ("●", "open", Tone::Bad),
        None => ("?", "unknown", Tone::Warn),
    };
    Badge { icon, word, tone }
}

fn seen_ui(ui: &mut Ui, alarm: &Alarm, requests: &mut Requests) {
    if let Some(seen) = alarm.seen {
        let words = format!("✔ {}", text::time_of_day(seen));
        ui.label(theme::toned(ui, Tone::Quiet, words));
        return;
    }
    let button = ui.add(egui::Button::new("Acknowledge").small());
    let name = format!("Acknowledge alarm {}", alarm.id);
    theme::named(&button, egui::Role::Button, &name);
    if button.clicked() {
        let alarm = Some(alarm.id);
        requests.push(Request::Acknowledge { alarm });
    }
}
