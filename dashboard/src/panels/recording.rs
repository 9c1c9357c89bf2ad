//! Recording the session, and the bar that is there while the past is shown.

use super::chooser::Purpose;
use crate::{
    message::Moment,
    model::Model,
    recording::{
        replay::Replay,
        session::{Session, Wish},
    },
    text,
    theme::{self, Tone},
    view::View,
};
use egui::{Button, Role, Slider, TextEdit, Ui};
use keys::FleetMicros;
use serde::{Deserialize, Serialize};

/// What the panel remembers.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
#[serde(default)]
pub struct RecordingView {
    /// The file to record into, as typed.
    pub record_path: String,
    /// The file to show again, as typed.
    pub open_path: String,
    /// What the operator wants.
    #[serde(skip)]
    pub wish: Option<Wish>,
}

/// Shows the panel.
pub fn recording_ui(ui: &mut Ui, session: &Session, view: &mut View) {
    let View {
        recording: view,
        chooser,
        ..
    } = view;
    ui.horizontal_wrapped(|ui| {
        let recording = session.recorder().is_some();
        let edit = path_ui(ui, "Record to", &mut view.record_path, !recording);
        if recording {
            if ui.button("⏹ End recording").clicked() {
                view.wish = Some(Wish::EndRecord);
            }
        } else {
            if ui.button("Choose where…").clicked() {
                chooser.open(Purpose::NewRecording, &view.record_path);
            }
            let begin = ui.add_enabled(edit, Button::new("⏺ Record"));
            if begin.clicked() {
                view.wish = Some(Wish::Record(view.record_path.trim().to_owned()));
            }
        }
        if let Some(recorder) = session.recorder() {
            let file = recorder.path().file_name().unwrap_or_default();
            let file = file.to_string_lossy();
            let written_kb = recorder.written_bytes() / 1_000;
            let words = format!("⏺ recording, {written_kb} kB written to {file}");
            ui.label(theme::toned(ui, Tone::Busy, words));
            if recorder.left_out() > 0 {
                let words = format!("⚠ {} messages left out", recorder.left_out());
                let words = theme::toned(ui, Tone::Warn, words);
                ui.label(words)
                    .on_hover_text("at most 10 statuses a second of each node, 4 MB/s in all");
            }
            if let Some(why) = recorder.failed() {
                ui.label(theme::toned(
                    ui,
                    Tone::Bad,
                    format!("✖ NOT RECORDED: {why}"),
                ));
            }
        }
    });
    ui.horizontal(|ui| {
        let there = path_ui(ui, "Recording", &mut view.open_path, true);
        let open = ui.add_enabled(there, Button::new("▶ Open recording"));
        if open.clicked() {
            view.wish = Some(Wish::Open(view.open_path.trim().to_owned()));
        }
        if ui.button("Choose recording…").clicked() {
            chooser.open(Purpose::Recording, &view.open_path);
        }
    });
    if let Some(why) = session.failed() {
        ui.label(theme::toned(ui, Tone::Bad, format!("✖ {why}")));
    }
    let words = "A recording holds everything that this window hears and asks: positions, jobs \
                 with their texts, logs. A file is never written over.";
    ui.label(theme::toned(ui, Tone::Quiet, words));
}

/// Shows a field for a file's name and returns whether something is in it.
fn path_ui(ui: &mut Ui, name: &str, path: &mut String, enabled: bool) -> bool {
    let label = ui.label(name);
    let edit = TextEdit::singleline(path)
        .hint_text("session.jsonl")
        .desired_width(300.0);
    ui.add_enabled(enabled, edit).labelled_by(label.id);
    !path.trim().is_empty()
}

/// Shows that everything below is the past, and moves in it.
pub fn replay_ui(ui: &mut Ui, session: &Session, live: &Model, view: &mut View) {
    let Some(replay) = session.replay() else {
        return;
    };
    let wish = &mut view.recording.wish;
    ui.horizontal_wrapped(|ui| {
        let words = "⏪ REPLAY: everything below this bar is the past";
        ui.label(theme::toned(ui, Tone::Warn, words).strong().size(16.0));
        let file = replay.name().rsplit(['/', '\\']).next().unwrap_or_default();
        ui.label(file);
        let end = ui.button("End replay");
        if end.clicked() {
            *wish = Some(Wish::EndReplay);
        }
    });
    ui.horizontal(|ui| {
        if replay.speed > 0.0 {
            let pause = ui.button("⏸");
            theme::named(&pause, Role::Button, "Pause replay");
            if pause.clicked() {
                *wish = Some(Wish::Speed(0.0));
            }
        } else {
            let play = ui.button("▶");
            theme::named(&play, Role::Button, "Play replay");
            if play.clicked() {
                *wish = Some(Wish::Speed(1.0));
            }
        }
        for speed in [1.0, 10.0, 60.0] {
            let chosen = replay.speed == speed;
            if ui.selectable_label(chosen, format!("{speed}×")).clicked() {
                *wish = Some(Wish::Speed(speed));
            }
        }
        slider_ui(ui, replay, wish);
        if replay.is_behind() {
            let words = format!("⌛ {} %: going there", replay.done_percent());
            ui.label(theme::toned(ui, Tone::Warn, words));
        }
        let recording = replay.recording();
        if recording.left_out > 0 {
            let words = format!("⚠ {} messages were left out", recording.left_out);
            ui.label(theme::toned(ui, Tone::Warn, words));
        }
        if recording.broken > 0 {
            let lines = text::count(recording.broken, "line");
            let words = format!("⚠ {lines} could not be read");
            ui.label(theme::toned(ui, Tone::Warn, words));
        }
    });
    let totals = live.totals();
    let mut words = format!(
        "The bar above and STOP ALL are live: {} alive, {}. STOP ALL stops the live fleet; \
         nothing else is sent.",
        totals.alive,
        text::count(live.alarms().unseen(), "alarm")
    );
    let mut tone = Tone::Plain;
    if let Some(refused) = session.refused() {
        words = format!("✖ NOT SENT: {refused}. End the replay first. {words}");
        tone = Tone::Bad;
    }
    let words = theme::toned(ui, tone, words);
    ui.add(egui::Label::new(words).wrap());
}

fn slider_ui(ui: &mut Ui, replay: &Replay, wish: &mut Option<Wish>) {
    let began = replay.recording().began;
    let length_s = replay.recording().ended.since_s(began);
    let mut at_s = replay.at().since_s(began);
    let label = ui.label(text::date_and_time(FleetMicros(replay.at().0)));
    ui.spacing_mut().slider_width = (ui.available_width() - 330.0).max(120.0);
    let slider = Slider::new(&mut at_s, 0.0..=length_s.max(0.001))
        .fixed_decimals(1)
        .suffix(format!(" of {length_s:.1} s"));
    let slider = ui.add(slider).labelled_by(label.id);
    if slider.changed() {
        *wish = Some(Wish::Seek(Moment(began.0).plus_us((at_s * 1e6) as u64)));
    }
}
