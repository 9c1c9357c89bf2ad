//! Lines of the nodes and of this window, newest at the bottom; only those in sight are drawn.

use crate::{
    model::{
        Model,
        log::{Line, Source},
    },
    text,
    theme::{self, Tone},
    view::View,
};
use egui::{RichText, ScrollArea, TextEdit, TextStyle, Ui};
use keys::FleetMicros;
use serde::{Deserialize, Serialize};

/// What the panel remembers.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
#[serde(default)]
pub struct LogView {
    /// What a line or its writer's name must contain.
    pub filter: String,
    /// The lines that pass, found again only when something changed.
    #[serde(skip)]
    found: Option<Found>,
}

#[derive(Clone, Debug)]
struct Found {
    filter: String,
    count: u64,
    lines: Vec<usize>,
}

/// Shows the log.
pub fn log_ui(ui: &mut Ui, model: &Model, view: &mut View) {
    let log = model.log();
    let view = &mut view.log;
    ui.horizontal(|ui| {
        let label = ui.label("Filter log");
        let edit = TextEdit::singleline(&mut view.filter)
            .hint_text("word or node")
            .desired_width(240.0);
        ui.add(edit).labelled_by(label.id);
        let found = view.find(model).len();
        let words = format!("{found} of {} lines", log.lines().len());
        ui.label(theme::toned(ui, Tone::Quiet, words));
        if ui
            .button("Copy log")
            .on_hover_text("Copies the lines that pass the filter")
            .clicked()
        {
            let lines = view.find(model).iter();
            ui.copy_text(copied(lines.filter_map(|index| log.lines().get(*index))));
        }
        if model.missed() > 0 {
            let words = format!("⚠ {} messages were dropped", model.missed());
            ui.label(theme::toned(ui, Tone::Warn, words));
        }
    });
    let height = ui.text_style_height(&TextStyle::Monospace);
    let found = view.find(model);
    ScrollArea::both()
        .auto_shrink(false)
        .stick_to_bottom(true)
        .show_rows(ui, height, found.len(), |ui, rows| {
            for index in &found[rows] {
                let Some(line) = log.lines().get(*index) else {
                    continue;
                };
                let tone = match line.source {
                    Source::Node(_) => Tone::Plain,
                    Source::Window => Tone::Quiet,
                };
                let at = text::time_of_day(line.at);
                let words = format!("{at}  {:<12}  {}", line.source.as_str(), line.text);
                let words = RichText::new(words).monospace().color(tone.color(ui));
                ui.add(egui::Label::new(words).wrap_mode(egui::TextWrapMode::Extend));
            }
        });
}

/// Returns lines as they are pasted elsewhere.
pub(super) fn copied<'l>(lines: impl Iterator<Item = &'l Line>) -> String {
    let mut text = String::new();
    for line in lines {
        let (at, source) = (
            text::date_and_time(FleetMicros(line.at.0)),
            line.source.as_str(),
        );
        text += &format!("{at} {source} {}\n", line.text);
    }
    text
}

impl LogView {
    /// Returns the indices of the lines that pass the filter.
    fn find(&mut self, model: &Model) -> &[usize] {
        let log = model.log();
        let fresh = self
            .found
            .as_ref()
            .is_some_and(|found| found.count == log.count() && found.filter == self.filter);
        if !fresh {
            let wanted = self.filter.to_lowercase();
            let passes = |line: &Line| {
                wanted.is_empty()
                    || line.source.as_str().contains(&wanted)
                    || line.text.to_lowercase().contains(&wanted)
            };
            let lines = log.lines().iter().enumerate();
            let lines = lines
                .filter(|(_, line)| passes(line))
                .map(|(index, _)| index);
            self.found = Some(Found {
                filter: self.filter.clone(),
                count: log.count(),
                lines: lines.collect(),
            });
        }
        self.found.as_ref().map_or(&[], |found| &found.lines)
    }
}
