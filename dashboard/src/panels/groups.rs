//! Saved filters: key expressions with a name of their own, each with its count, its stop and its
//! release.

use crate::{
    model::{Model, select::Pattern},
    request::{Request, Requests, Scope},
    theme::{self, Tone},
    view::View,
};
use egui::{TextEdit, Ui};
use keys::StopMode;

/// Saved filters that fit.
const SAVED_MAX: usize = 64;

/// Shows the selection and the saved filters.
pub fn groups_ui(ui: &mut Ui, model: &Model, view: &mut View, requests: &mut Requests) {
    egui::ScrollArea::vertical()
        .auto_shrink(false)
        .show(ui, |ui| {
            selection_ui(ui, view, requests);
            ui.separator();
            saved_ui(ui, model, view, requests);
            add_ui(ui, view);
        });
}

fn saved_ui(ui: &mut Ui, model: &Model, view: &mut View, requests: &mut Requests) {
    ui.heading("Groups");
    let everything = view.fleet.group.is_none();
    let words = format!("All nodes ({})", model.nodes().count());
    if ui.selectable_label(everything, words).clicked() {
        view.fleet.group = None;
    }
    let mut removed = None;
    for (index, saved) in view.fleet.saved.iter().enumerate() {
        let Ok(pattern) = Pattern::new(saved) else {
            continue;
        };
        let there = model.matching(&pattern).count();
        let all = model
            .nodes()
            .filter(|node| pattern.matches(node.id().as_str()));
        let all = all.count();
        let shown = view.fleet.group.as_deref() == Some(saved);
        // Without a link nobody knows who is there.
        let there = match model.link().is_up() {
            true => there.to_string(),
            false => "?".to_owned(),
        };
        let label = ui.selectable_label(shown, format!("{saved} ({there}/{all})"));
        let label = label.on_hover_text("nodes that are there / known nodes");
        if label.clicked() {
            view.fleet.group = (!shown).then(|| saved.clone());
        }
        ui.horizontal(|ui| {
            let stop = ui.add(theme::stop_button("Stop"));
            theme::named(&stop, egui::Role::Button, &format!("Stop {saved}"));
            if stop.clicked() {
                let (scope, mode) = (Scope::Pattern(saved.clone()), StopMode::Halt);
                requests.push(Request::Stop { scope, mode });
            }
            let release = ui.button("Release…");
            let name = format!("Release {saved}");
            theme::named(&release, egui::Role::Button, &name);
            if release.clicked() {
                view.stop.releasing = Some(Scope::Pattern(saved.clone()));
            }
            let remove = ui.button("🗑").on_hover_text("Forget this filter");
            theme::named(&remove, egui::Role::Button, &format!("Forget {saved}"));
            if remove.clicked() {
                removed = Some(index);
            }
        });
    }
    if let Some(index) = removed {
        let saved = view.fleet.saved.remove(index);
        if view.fleet.group == Some(saved) {
            view.fleet.group = None;
        }
    }
}

/// The selection's buttons never move: what stops shall be where it was.
fn selection_ui(ui: &mut Ui, view: &mut View, requests: &mut Requests) {
    let count = view.selection.len();
    ui.heading(format!("Selection ({count})"))
        .on_hover_text("Ctrl+click on a name selects several, Ctrl+A all that are shown");
    let scope = || Scope::Nodes(view.selection.clone());
    let mut clear = false;
    let mut release = None;
    ui.add_enabled_ui(count > 0, |ui| {
        ui.horizontal(|ui| {
            let stop = ui.add(theme::stop_button("Stop selected"));
            let slow = ui.button("Slow stop");
            let slow = slow.on_hover_text("With deceleration, on their path");
            for (button, mode) in [(stop, StopMode::Halt), (slow, StopMode::Decelerate)] {
                if button.clicked() {
                    let scope = scope();
                    requests.push(Request::Stop { scope, mode });
                }
            }
        });
        ui.horizontal(|ui| {
            if ui.button("Release selected…").clicked() {
                release = Some(scope());
            }
            clear = ui.button("Clear").clicked();
        });
    });
    if release.is_some() {
        view.stop.releasing = release;
    }
    if clear {
        view.selection.clear();
    }
}

fn add_ui(ui: &mut Ui, view: &mut View) {
    ui.separator();
    let label = ui.label("New group");
    let fleet = &mut view.fleet;
    let edit = TextEdit::singleline(&mut fleet.new_group)
        .hint_text("cell-a-$*")
        .desired_width(f32::INFINITY);
    let edit = ui.add(edit).labelled_by(label.id);
    let entered = edit.lost_focus() && ui.input(|input| input.key_pressed(egui::Key::Enter));
    let pattern = Pattern::new(&fleet.new_group);
    let known = fleet.saved.contains(&fleet.new_group);
    let room = fleet.saved.len() < SAVED_MAX;
    let add = ui.add_enabled(
        pattern.is_ok() && !known && room,
        egui::Button::new("Save group"),
    );
    match pattern {
        Ok(pattern) if !known && room && (add.clicked() || entered) => {
            fleet.saved.push(pattern.as_str().to_owned());
            fleet.new_group.clear();
        }
        Err(why) if !fleet.new_group.is_empty() => {
            ui.label(theme::toned(ui, Tone::Warn, format!("⚠ {why}")));
        }
        _ => {}
    }
}
