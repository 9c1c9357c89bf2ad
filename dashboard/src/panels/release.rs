//! The question before a release: the second of two deliberate steps.

use crate::{
    model::Model,
    request::{Request, Requests, Scope},
    text,
    theme::{self, Tone},
    view::View,
};
use egui::Ui;
use keys::record::NodeWord;

/// Asks, if a release was begun.
pub fn release_ui(ui: &Ui, model: &Model, view: &mut View, requests: &mut Requests) {
    let Some(scope) = view.stop.releasing.clone() else {
        return;
    };
    let stopped: Vec<_> = model
        .nodes()
        .filter(|node| node.word() == NodeWord::Stopped)
        .filter(|node| match &scope {
            Scope::Nodes(nodes) => nodes.contains(&node.id()),
            Scope::All => true,
            Scope::Pattern(pattern) => crate::model::select::Pattern::new(pattern)
                .is_ok_and(|pattern| pattern.matches(node.id().as_str())),
        })
        .collect();
    let mut open = true;
    let mut done = false;
    theme::window(ui.ctx(), "Release")
        .resizable(false)
        .open(&mut open)
        .show(ui.ctx(), |ui| {
            let count = text::count(stopped.len(), "node");
            ui.label(format!("{count} will take commands again ({scope}):"));
            let names: Vec<_> = stopped.iter().map(|node| node.id().to_string()).collect();
            egui::ScrollArea::vertical()
                .max_height(120.0)
                .show(ui, |ui| {
                    ui.label(names.join(", "));
                });
            let words = "⚠ Queued jobs of these nodes start at once. Is everybody clear?";
            ui.label(theme::toned(ui, Tone::Warn, words));
            ui.horizontal(|ui| {
                let release = egui::Button::new(format!("Release {count}"));
                if ui.add_enabled(!stopped.is_empty(), release).clicked() {
                    // Those that were shown, and nobody that stopped since.
                    let nodes = stopped.iter().map(|node| node.id()).collect();
                    let scope = Scope::Nodes(nodes);
                    requests.push(Request::Release { scope });
                    done = true;
                }
                if ui.button("Keep stopped").clicked() {
                    done = true;
                }
            });
        });
    if done || !open {
        view.stop.releasing = None;
    }
}
