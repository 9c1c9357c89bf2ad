//! Jobs from files: typed, chosen or dropped on the window, opened, and never taken for another text.

use super::ComposerView;
use crate::{
    files::is_capture,
    message::FileOutcome,
    model::Model,
    panels::chooser::Purpose,
    request::{Language, Request, Requests},
    text,
    theme::{self, Tone},
    view::{Tab, View},
};
use egui::{Rect, TextEdit, Ui};
use keys::NodeId;
use std::collections::BTreeSet;

impl ComposerView {
    /// Takes a file that was dropped on a node's row.
    pub fn drop_on(&mut self, ui: &Ui, row: Rect, node: NodeId) {
        let pointer = ui.input(|input| input.pointer.latest_pos());
        if self.dropped.is_some() && pointer.is_some_and(|at| row.contains(at)) {
            self.target = node.as_str().to_owned();
            self.to_selection = false;
            self.dropped_on_row = true;
        }
    }

    /// Opens a file.
    pub fn open_file(&mut self, path: String, requests: &mut Requests) {
        self.file.clone_from(&path);
        self.not_opened = None;
        self.opening = Some(requests.push(Request::ReadFile { path }));
    }
}

/// Notes a file that was dropped on the window in this frame.
pub fn take_dropped(ui: &Ui, view: &mut View) {
    let dropped = ui.input(|input| input.raw.dropped_files.clone());
    // A capture is the pulse inspector's, wherever it falls.
    let mut jobs = dropped.iter().filter(|file| !is_capture(file.path()));
    let job = jobs.next();
    view.composer.dropped = job.map(|file| file.path().display().to_string());
    view.composer.dropped_more = jobs.count();
}

/// Opens the file that was dropped, for the node on whose row it fell, if on one.
pub fn open_dropped(ui: &Ui, view: &mut View, requests: &mut Requests) {
    let on_row = std::mem::take(&mut view.composer.dropped_on_row);
    let Some(path) = view.composer.dropped.take() else {
        return;
    };
    // During a drag from elsewhere not every system tells where the pointer is.
    let nowhere = ui.input(|input| input.pointer.latest_pos()).is_none();
    view.composer.drop_note = (!on_row && nowhere).then(|| {
        let focus = view.focus.filter(|_| view.selection.is_empty());
        let nodes = focus.map_or_else(|| view.selection.clone(), |node| BTreeSet::from([node]));
        view.composer.target_nodes(&nodes);
        let whom = match (nodes.first(), nodes.len()) {
            (None, _) => "no node is selected: say for whom it is".to_owned(),
            (Some(node), 1) => format!("it is for {node}, which is selected"),
            (_, count) => format!("it is for the {count} selected nodes"),
        };
        format!("⚠ the system did not tell where the file fell; {whom}")
    });
    let more = std::mem::take(&mut view.composer.dropped_more);
    if more > 0 {
        let count = text::count(more, "other file");
        let words = format!("⚠ one job at a time: {count} not opened");
        let note = view.composer.drop_note.take();
        view.composer.drop_note =
            Some(note.map_or(words.clone(), |note| format!("{note}; {words}")));
    }
    view.tab = Tab::Compose;
    view.composer.open_file(path, requests);
}

/// Takes a file that was read. Each frame, whatever is shown: the model keeps the last outcome only.
pub fn take_opened(model: &Model, composer: &mut ComposerView) {
    let Some(outcome) = composer.opening.and_then(|ticket| model.file(ticket)) else {
        return;
    };
    composer.opening = None;
    match outcome {
        FileOutcome::Read { path, text } => {
            let is_lua = std::path::Path::new(path)
                .extension()
                .is_some_and(|extension| extension.eq_ignore_ascii_case("lua"));
            composer.language = if is_lua {
                Language::Lua
            } else {
                Language::Json
            };
            composer.text_mut().clone_from(text);
            composer.sent = None;
        }
        FileOutcome::Failed(why) => composer.not_opened = Some(why.clone()),
        FileOutcome::Written { .. } => {}
    }
}

/// Shows what a file is opened by, and what became of the last one.
pub(super) fn file_ui(ui: &mut Ui, view: &mut View, requests: &mut Requests) {
    ui.horizontal_wrapped(|ui| {
        let composer = &mut view.composer;
        let label = ui.label("File");
        let edit = TextEdit::singleline(&mut composer.file)
            .hint_text("path, or drop a file on a node or here")
            .desired_width(260.0);
        ui.add(edit).labelled_by(label.id);
        let named = !composer.file.trim().is_empty();
        if ui
            .add_enabled(named, egui::Button::new("Open file"))
            .clicked()
        {
            let path = composer.file.trim().to_owned();
            composer.drop_note = None;
            composer.open_file(path, requests);
        }
        if ui.button("Choose job…").clicked() {
            view.chooser.open(Purpose::Job, &composer.file);
        }
        let composer = &mut view.composer;
        if let Some(why) = &composer.not_opened {
            ui.label(theme::toned(ui, Tone::Bad, format!("✖ {why}")));
            let keep = ui.button("Keep the text below");
            if keep.on_hover_text("It is not that file's").clicked() {
                composer.not_opened = None;
            }
        } else if composer.opening.is_some() {
            ui.label("⌛ opening");
        }
        if let Some(note) = &composer.drop_note {
            ui.label(theme::toned(ui, Tone::Warn, note));
        }
    });
}
