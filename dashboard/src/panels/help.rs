//! The keys, shown by `?`.

use crate::{keyboard, theme, view::View};
use egui::{RichText, Ui};

/// Shows the keys, if they are asked for.
pub fn help_ui(ui: &Ui, view: &mut View) {
    if !view.help_open {
        return;
    }
    let mut open = true;
    theme::window(ui.ctx(), "Keys")
        .resizable(false)
        .open(&mut open)
        .show(ui.ctx(), |ui| {
            let words = "STOP ALL is a software stop. It replaces no emergency stop.";
            ui.label(theme::toned(ui, theme::Tone::Warn, words));
            // On a small screen they are scrolled.
            let keys = egui::ScrollArea::vertical().max_height(theme::window_room(ui.ctx()) - 80.0);
            keys.show(ui, keys_ui);
        });
    view.help_open &= open;
}

fn keys_ui(ui: &mut Ui) {
    egui::Grid::new("keys").num_columns(2).show(ui, |ui| {
        for (stroke, does) in keyboard::table() {
            ui.label(RichText::new(stroke).monospace().strong());
            ui.label(does);
            ui.end_row();
        }
        ui.label(RichText::new("click").monospace().strong());
        ui.label("open a node's page; with Ctrl select several");
        ui.end_row();
    });
}
