//! Whom a job that is being written would reach: those that are there, and those for which it waits.

use crate::{
    model::{Model, select::Pattern},
    request::Target,
    text,
    theme::{self, Tone},
    view::View,
};
use egui::Ui;
use keys::NodeId;

/// Names of matching nodes that are spelled out.
const NAMES_SHOWN: usize = 8;

/// Whom a job would reach.
pub(super) struct Reach {
    /// Where it goes, or why it goes nowhere.
    pub(super) target: Result<Target, String>,
    /// The nodes that are there.
    pub(super) there: Vec<NodeId>,
    /// Selected ones that are not: their jobs wait.
    pub(super) waiting: Vec<NodeId>,
}

impl Reach {
    pub(super) fn of(model: &Model, view: &View) -> Self {
        if view.composer.to_selection {
            let is_there = |id: &NodeId| model.node(id).is_some_and(|node| node.is_there());
            let (there, waiting) = view.selection.iter().copied().partition(is_there);
            let none = || "no node is selected: Ctrl+click selects several".to_owned();
            let nodes = (!view.selection.is_empty()).then(|| view.selection.clone());
            let target = nodes.map(Target::Nodes).ok_or_else(none);
            return Self {
                target,
                there,
                waiting,
            };
        }
        let pattern = Pattern::new(view.composer.target.trim());
        let there = pattern.as_ref().map(|pattern| {
            let nodes = model.matching(pattern);
            nodes.map(|node| node.id()).collect()
        });
        Self {
            there: there.unwrap_or_default(),
            waiting: Vec::new(),
            target: pattern.map(|pattern| Target::Node(pattern.as_str().to_owned())),
        }
    }

    pub(super) fn count(&self) -> usize {
        self.there.len() + self.waiting.len()
    }

    /// Where a preview begins: at the only node's place, if it rests; else at 0.
    pub(super) fn start_steps(&self, model: &Model) -> Vec<i64> {
        let [node] = &self.there[..] else {
            return Vec::new();
        };
        let node = model.node(node);
        let resting = node.filter(|node| node.speeds_hz().iter().all(|speed| *speed == 0.0));
        resting.map_or(Vec::new(), |node| node.positions_steps())
    }
}

/// Says whom it would reach.
pub(super) fn reach_ui(ui: &mut Ui, model: &Model, reach: &Reach) {
    let (tone, words) = match (&reach.target, &reach.there[..]) {
        (Err(why), _) => (Tone::Quiet, why.clone()),
        (Ok(_), nodes @ [_, ..]) => (Tone::Good, format!("● reaches {}", names(nodes))),
        (Ok(Target::Node(chunk)), []) if !chunk.contains('*') => {
            let known = NodeId::new(chunk).is_ok_and(|id| model.node(&id).is_some());
            let words = match known {
                true => "⚠ offline: the job waits until it returns",
                false => "⚠ never heard of this node",
            };
            (Tone::Warn, words.to_owned())
        }
        (Ok(_), []) => (Tone::Warn, "⚠ reaches no node now".to_owned()),
    };
    ui.label(theme::toned(ui, tone, words));
    if !reach.waiting.is_empty() {
        let words = names(&reach.waiting);
        let words = format!("⚠ offline, so that the job waits there: {words}");
        ui.label(theme::toned(ui, Tone::Warn, words));
    }
}

fn names(nodes: &[NodeId]) -> String {
    let shown: Vec<&str> = nodes.iter().take(NAMES_SHOWN).map(NodeId::as_str).collect();
    let more = match nodes.len().saturating_sub(NAMES_SHOWN) {
        0 => String::new(),
        more => format!(" and {more} more"),
    };
    let count = text::count(nodes.len(), "node");
    format!("{count}: {}{more}", shown.join(", "))
}
