//! What became of the latest stop or release: who has confirmed, who is missing, how long it took.

use crate::{
    model::{
        Model,
        effort::{Effort, Kind, Sending},
    },
    request::{Requests, Scope, Ticket},
    text,
    theme::{self, Tone},
    view::View,
};
use egui::{RichText, Ui};
use keys::{NodeId, StopMode};
use serde::{Deserialize, Serialize};

/// Names of missing nodes that are spelled out; the rest is a number.
const NAMES_SHOWN: usize = 12;

/// What the panel and the question before a release remember.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
#[serde(default)]
pub struct StopView {
    /// The latest effort whose effect was put away.
    #[serde(skip)]
    pub dismissed: Option<Ticket>,
    /// Whose release is being asked about.
    #[serde(skip)]
    pub releasing: Option<Scope>,
}

/// Returns whether there is an effect to show.
pub fn is_shown(model: &Model, view: &View) -> bool {
    let latest = model.efforts().next();
    latest.is_some_and(|effort| view.stop.dismissed != Some(effort.ticket()))
}

/// Shows the effect of the latest stop or release.
pub fn stop_ui(ui: &mut Ui, model: &Model, view: &mut View, _requests: &mut Requests) {
    let Some(effort) = model.efforts().next() else {
        return;
    };
    ui.horizontal_wrapped(|ui| {
        let (icon, tone) = match (effort.sending(), effort.is_complete()) {
            (Sending::Failed(_), _) => ("✖", Tone::Bad),
            (_, true) if effort.refused().is_empty() => ("✔", Tone::Good),
            _ => ("⌛", Tone::Warn),
        };
        let title = format!("{icon} {}", title(effort));
        ui.label(theme::toned(ui, tone, title).strong());
        ui.label(theme::toned(ui, tone, effect(effort)).strong());
        if let Some(took_s) = effort.took_s() {
            let took = text::micros(took_s * 1e6);
            let words = if effort.is_complete() {
                format!("in {took}")
            } else {
                format!("so far, the last after {took}")
            };
            ui.label(words);
        }
        let age = text::age(model.now().since_s(effort.asked()));
        ui.label(theme::toned(ui, Tone::Quiet, format!("asked {age} ago")));
        if ui.button("Dismiss").clicked() {
            view.stop.dismissed = Some(effort.ticket());
        }
    });
    missing_ui(ui, model, effort);
    let coming: Vec<_> = effort.coming_to_rest().collect();
    if !coming.is_empty() {
        let words = names(model, &coming);
        let words = format!("latched, and still coming to rest: {words}");
        ui.label(theme::toned(ui, Tone::Warn, words));
    }
    for refusal in effort.refused() {
        ui.label(theme::toned(ui, Tone::Bad, format!("✖ refused: {refusal}")));
    }
    if matches!(effort.kind(), Kind::Stop(_)) {
        let words = "A software stop: it needs the network and the nodes' programs. \
                     For danger use the stop buttons of the machines.";
        ui.label(RichText::new(words).small());
    }
}

fn title(effort: &Effort) -> String {
    let scope = effort.scope();
    match effort.kind() {
        Kind::Stop(StopMode::Halt) => format!("Software stop of {scope}:"),
        Kind::Stop(StopMode::Decelerate) => format!("Software stop with deceleration of {scope}:"),
        Kind::Release => format!("Release of {scope}:"),
    }
}

fn effect(effort: &Effort) -> String {
    if let Sending::Failed(why) = effort.sending() {
        return why.clone();
    }
    if effort.expected() == 0 {
        return match effort.kind() {
            Kind::Stop(_) => "sent; no node is known to be there".to_owned(),
            Kind::Release => "no such node was stopped".to_owned(),
        };
    }
    format!("confirmed {}/{}", effort.confirmed(), effort.expected())
}

fn missing_ui(ui: &mut Ui, model: &Model, effort: &Effort) {
    let missing: Vec<_> = effort.missing().collect();
    if missing.is_empty() {
        return;
    }
    let words = format!("missing: {}", names(model, &missing));
    ui.label(theme::toned(ui, Tone::Bad, words));
}

/// Returns the names of nodes, as many as fit.
fn names(model: &Model, nodes: &[NodeId]) -> String {
    let names = nodes.iter().take(NAMES_SHOWN).map(|id| {
        let gone = model.node(id).is_some_and(|node| !node.is_there());
        let mark = if gone { " (gone)" } else { "" };
        format!("{id}{mark}")
    });
    let mut words = names.collect::<Vec<_>>().join(", ");
    if nodes.len() > NAMES_SHOWN {
        words += &format!(" and {} more", nodes.len() - NAMES_SHOWN);
    }
    words
}
