//! Writing a synchronized job: a part for each of several nodes, started together; then who is
//! ready, how long until the start, and how far apart it was.

use super::{composer, editor::editor_ui, preview};
use crate::{
    estimate::{Estimate, estimate},
    message::Answer,
    model::{Model, jobs::Sent, node::Node},
    request::{Language, Request, Requests, Target, Ticket},
    syntax, text,
    theme::{self, Tone},
    view::View,
};
use egui::{Panel, ScrollArea, TextEdit, Ui};
use keys::{
    GroupId, JobId, NodeId,
    job::{GROUP_NODES_MAX, GroupRequest},
    record::{JobRecord, JobState, PartRecord},
};
use serde::{Deserialize, Serialize};
use serde_json::{Map, Value, json};
use std::{
    collections::{BTreeMap, BTreeSet},
    sync::Arc,
};

/// Least height of a part's text, rows.
const EDITOR_ROWS: usize = 6;

/// The part that a node gets when it is added.
const PART: &str = "{\"commands\":[\n  {\"ramp\":{\"axis\":0,\"steps\":2000,\"speed_hz\":1000,\"accel\":2000}}\n]}";

/// How long behind its instant a start may go untold and still be taken for going on, s.
const START_TOLD_WITHIN_S: f64 = 2.0;

/// Nodes that are named when they are waited for; of more it is said how many.
const NAMED_MAX: usize = 4;

/// What the panel remembers.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(default)]
pub struct GroupJobView {
    /// The group's name.
    pub group: String,
    /// The part of each node, JSON.
    pub parts: BTreeMap<NodeId, String>,
    /// The node whose part is edited.
    pub open: Option<NodeId>,
    /// Largest skew, µs.
    pub max_skew_us: f64,
    /// Time to become ready, ms.
    pub ready_timeout_ms: f64,
    /// The last one that was sent.
    #[serde(skip)]
    pub sent: Option<Ticket>,
    #[serde(skip)]
    checked: Option<Arc<Checked>>,
    #[serde(skip)]
    estimated: Option<Estimated>,
}

/// The parts that were checked last, and what came out.
#[derive(Debug)]
struct Checked {
    parts: BTreeMap<NodeId, String>,
    numbers: [f64; 2],
    whole: Result<(String, GroupRequest), String>,
}

/// The estimate of one part.
#[derive(Clone, Debug)]
struct Estimated {
    of: Arc<Checked>,
    node: NodeId,
    start_steps: Vec<i64>,
    estimate: Option<Arc<Estimate>>,
}

impl Default for GroupJobView {
    fn default() -> Self {
        Self {
            group: "group".to_owned(),
            parts: BTreeMap::new(),
            open: None,
            max_skew_us: 1_000.0,
            ready_timeout_ms: 5_000.0,
            sent: None,
            checked: None,
            estimated: None,
        }
    }
}

impl GroupJobView {
    /// Takes nodes in, as many as a synchronized job can have.
    pub fn add(&mut self, nodes: &BTreeSet<NodeId>) {
        let part = match self.open.and_then(|open| self.parts.get(&open)) {
            Some(part) => part.clone(),
            None => PART.to_owned(),
        };
        for node in nodes {
            if self.parts.len() < GROUP_NODES_MAX {
                self.parts.entry(*node).or_insert_with(|| part.clone());
            }
        }
        self.open = self.open.or_else(|| nodes.first().copied());
    }

    /// Takes a synchronized job that was sent.
    pub fn again(&mut self, sent: &Sent) {
        let Ok(Value::Object(mut job)) = serde_json::from_str::<Value>(&sent.payload) else {
            return;
        };
        if let Some(group) = sent.target.strip_prefix("group ") {
            self.group = group.to_owned();
        }
        let number = |name: &str, default: f64| {
            let value = job.get(name).and_then(Value::as_f64);
            value.unwrap_or(default)
        };
        self.max_skew_us = number("max_skew_us", self.max_skew_us);
        self.ready_timeout_ms = number("ready_timeout_ms", self.ready_timeout_ms);
        let Some(Value::Object(nodes)) = job.remove("nodes") else {
            return;
        };
        let parts = nodes.into_iter().filter_map(|(name, part)| {
            let text = serde_json::to_string_pretty(&part).ok()?;
            Some((NodeId::new(&name).ok()?, text))
        });
        self.parts = parts.collect();
        self.open = self.parts.keys().next().copied();
        self.sent = None;
    }

    /// Returns the whole job as text and as checked, or what is wrong with it.
    pub fn whole(&self) -> Result<(String, GroupRequest), String> {
        let mut nodes = Map::new();
        for (node, part) in &self.parts {
            let part = serde_json::from_str::<Value>(part)
                .map_err(|error| format!("part of {node}: {error}"))?;
            nodes.insert(node.to_string(), part);
        }
        let job = json!({
            "nodes": nodes,
            "max_skew_us": self.max_skew_us,
            "ready_timeout_ms": self.ready_timeout_ms,
        });
        let text = job.to_string();
        let request =
            GroupRequest::from_json(text.as_bytes()).map_err(|error| error.to_string())?;
        Ok((text, request))
    }
}

impl GroupJobView {
    /// Does [`Self::whole`] anew only if something was changed: parts may be long.
    fn check(&mut self) -> Arc<Checked> {
        let numbers = [self.max_skew_us, self.ready_timeout_ms];
        if let Some(known) = &self.checked
            && known.numbers == numbers
            && known.parts == self.parts
        {
            return Arc::clone(known);
        }
        let checked = Arc::new(Checked {
            parts: self.parts.clone(),
            numbers,
            whole: self.whole(),
        });
        self.checked = Some(Arc::clone(&checked));
        checked
    }

    /// Returns what the open part would do from here, anew only if it is another one.
    fn estimate(
        &mut self,
        checked: &Arc<Checked>,
        node: NodeId,
        start_steps: Vec<i64>,
    ) -> Option<Arc<Estimate>> {
        if let Some(known) = &self.estimated
            && Arc::ptr_eq(&known.of, checked)
            && known.node == node
            && known.start_steps == start_steps
        {
            return known.estimate.clone();
        }
        let job = checked.whole.as_ref().ok();
        let work = job.and_then(|(_, job)| job.nodes.get(&node));
        let estimate = work.and_then(|work| estimate(work, &start_steps));
        let estimate = estimate.map(Arc::new);
        self.estimated = Some(Estimated {
            of: Arc::clone(checked),
            node,
            start_steps,
            estimate: estimate.clone(),
        });
        estimate
    }
}

/// Shows the editor and what became of the job that was sent last.
pub fn group_job_ui(ui: &mut Ui, model: &Model, view: &mut View, requests: &mut Requests) {
    let checked = view.group_job.check();
    let whole = &checked.whole;
    head_ui(ui, model, view, requests, whole);
    Panel::left("group parts")
        .resizable(true)
        .default_size(330.0)
        .show(ui, |ui| parts_ui(ui, model, view));
    let Some(open) = view.group_job.open else {
        let words = "select nodes in the fleet, then “Add selection”";
        ui.label(theme::toned(ui, Tone::Quiet, words));
        return;
    };
    let place = model.node(&open).map(Node::positions_steps);
    let estimate = view
        .group_job
        .estimate(&checked, open, place.unwrap_or_default());
    if let Some(estimate) = estimate {
        Panel::right("part preview")
            .resizable(true)
            .default_size(240.0)
            .show(ui, |ui| preview::preview_ui(ui, &estimate));
    }
    part_ui(ui, view, open, whole.as_ref().err());
}

fn head_ui(
    ui: &mut Ui,
    model: &Model,
    view: &mut View,
    requests: &mut Requests,
    whole: &Result<(String, GroupRequest), String>,
) {
    ui.horizontal_wrapped(|ui| {
        let editor = &mut view.group_job;
        let label = ui.label("Group");
        let name = TextEdit::singleline(&mut editor.group).desired_width(100.0);
        ui.add(name).labelled_by(label.id);
        let label = ui.label("Max skew");
        let skew = egui::DragValue::new(&mut editor.max_skew_us);
        ui.add(skew.range(1.0..=1e6).suffix(" µs"))
            .labelled_by(label.id);
        let label = ui.label("Ready within");
        let ready = egui::DragValue::new(&mut editor.ready_timeout_ms);
        ui.add(ready.range(100.0..=600_000.0).suffix(" ms"))
            .labelled_by(label.id);
        let selected = !view.selection.is_empty();
        if ui
            .add_enabled(selected, egui::Button::new("Add selection"))
            .clicked()
        {
            editor.add(&view.selection);
        }
        let why = refusal(model, editor, whole);
        let send = ui.add_enabled(why.is_none(), egui::Button::new("Start together"));
        let send = send.on_disabled_hover_text(why.clone().unwrap_or_default());
        if send.clicked() {
            // It can be sent, or the button would not be there to be clicked.
            let _ = self::send(model, view, requests);
        }
        match why {
            Some(why) => ui.label(theme::toned(ui, Tone::Warn, format!("⚠ {why}"))),
            None => ui.label(theme::toned(ui, Tone::Good, "✔ can be sent")),
        };
    });
    sent_ui(ui, model, view);
}

/// Sends what is written: what the button does.
///
/// # Errors
/// Why it cannot be sent, for a person.
pub fn send(model: &Model, view: &mut View, requests: &mut Requests) -> Result<Ticket, String> {
    let editor = &mut view.group_job;
    let checked = editor.check();
    if let Some(why) = refusal(model, editor, &checked.whole) {
        return Err(why);
    }
    let group = GroupId::new(editor.group.trim()).map_err(|error| error.to_string())?;
    let (text, _) = checked.whole.as_ref().map_err(Clone::clone)?;
    let ticket = requests.push(Request::Submit {
        target: Target::Group(group),
        language: Language::Json,
        text: text.clone(),
    });
    editor.sent = Some(ticket);
    Ok(ticket)
}

/// Returns why the job cannot be sent.
fn refusal(
    model: &Model,
    editor: &GroupJobView,
    whole: &Result<(String, GroupRequest), String>,
) -> Option<String> {
    match (
        composer::no_way(model),
        GroupId::new(editor.group.trim()),
        whole,
    ) {
        (Some(why), _, _) => Some(why),
        (_, Err(_), _) => Some("a group's name is a-z, 0-9, _ and -".to_owned()),
        (_, _, Err(why)) => Some(why.clone()),
        _ => not_there(model, &editor.parts),
    }
}

/// A synchronized job is refused if one node is not there.
fn not_there(model: &Model, parts: &BTreeMap<NodeId, String>) -> Option<String> {
    let gone = |id: &&NodeId| !model.node(id).is_some_and(|node| node.is_there());
    let gone: Vec<&str> = parts.keys().filter(gone).map(NodeId::as_str).collect();
    (!gone.is_empty()).then(|| format!("not there: {}", gone.join(", ")))
}

fn parts_ui(ui: &mut Ui, model: &Model, view: &mut View) {
    let record = record(model, view).cloned();
    let editor = &mut view.group_job;
    let mut removed = None;
    ScrollArea::vertical().auto_shrink(false).show(ui, |ui| {
        for id in editor.parts.keys() {
            ui.horizontal(|ui| {
                let open = editor.open == Some(*id);
                let name = ui.selectable_label(open, id.as_str());
                theme::named(&name, egui::Role::Button, &format!("Part of {id}"));
                if name.clicked() {
                    editor.open = Some(*id);
                }
                light_ui(ui, model, record.as_ref(), id);
                let remove = ui.button("🗑").on_hover_text("Leave this node out");
                theme::named(&remove, egui::Role::Button, &format!("Leave {id} out"));
                if remove.clicked() {
                    removed = Some(*id);
                }
            });
        }
    });
    if let Some(removed) = removed {
        editor.parts.remove(&removed);
        if editor.open == Some(removed) {
            editor.open = editor.parts.keys().next().copied();
        }
    }
}

/// What a node's part does, or, before it is sent, the node itself.
fn light_ui(ui: &mut Ui, model: &Model, record: Option<&JobRecord>, id: &NodeId) {
    let part = record.and_then(|record| record.parts.as_ref()?.get(id));
    let node = model.node(id);
    let ready = record.is_some_and(|record| model.jobs().starts(&record.job).is_some())
        || node.is_some_and(|node| node.word() == keys::record::NodeWord::Ready);
    match part {
        Some(part) if part.state == JobState::Sent && ready => {
            theme::node_badge(keys::record::NodeWord::Ready).show(ui);
        }
        Some(part) => {
            theme::job_badge(part.state).show(ui);
            if let Some(error) = &part.error {
                ui.label(theme::toned(ui, Tone::Bad, error.to_string()));
            }
        }
        None => {
            if let Some(node) = node {
                theme::node_badge(node.word()).show(ui);
            } else {
                ui.label(theme::toned(ui, Tone::Warn, "⚠ never heard of"));
            }
        }
    }
    let start = record.and_then(|record| record.start.as_ref());
    if let Some(late_us) = start.and_then(|start| start.by_node_us.get(id)) {
        ui.label(format!("+{late_us:.1} µs"));
    }
}

fn sent_job(model: &Model, view: &View) -> Option<JobId> {
    let ticket = view.group_job.sent?;
    let sent = model.jobs().sent().find(|sent| sent.ticket == ticket)?;
    sent.answer.as_ref()?.jobs().first().copied()
}

fn record<'m>(model: &'m Model, view: &View) -> Option<&'m JobRecord> {
    model.jobs().get(&sent_job(model, view)?)
}

fn sent_ui(ui: &mut Ui, model: &Model, view: &mut View) {
    let Some(ticket) = view.group_job.sent else {
        return;
    };
    let sent = model.jobs().sent().find(|sent| sent.ticket == ticket);
    let (tone, words) = match sent.map(|sent| &sent.answer) {
        None => return,
        Some(None) => (Tone::Plain, "⌛ sent, no receipt yet".to_owned()),
        Some(Some(Answer::Failed(why))) => (Tone::Bad, format!("✖ {why}")),
        Some(Some(Answer::Receipts(receipts))) => match receipts.first() {
            Some(Err(error)) => (Tone::Bad, format!("✖ refused: {error}")),
            _ => match record(model, view) {
                Some(record) => progress(model, record),
                None => (Tone::Plain, "⌛ taken".to_owned()),
            },
        },
        Some(Some(Answer::Sent | Answer::Done { .. })) => return,
    };
    ui.horizontal_wrapped(|ui| {
        ui.label(theme::toned(ui, tone, words).strong());
        if let Some(job) = sent_job(model, view)
            && ui.button("Record").clicked()
        {
            view.jobs.open = Some(job);
            view.tab = crate::view::Tab::Jobs;
        }
    });
}

/// Returns the words for the time until a start that is fixed; `None` when there is none, and when
/// it is measured.
pub(super) fn countdown(model: &Model, record: &JobRecord) -> Option<String> {
    let starts = model.jobs().starts(&record.job);
    let starts = starts.filter(|_| model.follows_jobs())?;
    let (left_s, past_s) = (starts.since_s(model.now()), model.now().since_s(starts));
    Some(if left_s > 0.0 {
        format!("starts in {}", text::micros(left_s * 1e6))
    } else if past_s < START_TOLD_WITHIN_S {
        "starts now".to_owned()
    } else {
        // The nodes tell it within a second; until then nobody knows whether it did.
        format!(
            "the start was due {} ago and is not told yet",
            text::age(past_s)
        )
    })
}

/// Returns the words for who is not ready yet: some names, and how many more.
fn awaited(nodes: &[&NodeId]) -> String {
    let named = nodes.iter().take(NAMED_MAX);
    let names: Vec<&str> = named.map(|node| node.as_str()).collect();
    match nodes.len().saturating_sub(NAMED_MAX) {
        0 => names.join(", "),
        more => format!("{} and {more} more", names.join(", ")),
    }
}

/// Returns where a synchronized job is, from the first part sent to the measured skew.
pub fn progress(model: &Model, record: &JobRecord) -> (Tone, String) {
    let badge = theme::job_badge(record.state);
    let mut words = format!("{} {}: {}", badge.icon, record.job, badge.word);
    if let Some(error) = &record.error {
        words += &format!(", {error}");
    }
    let parts = record.parts.iter().flatten();
    let is_ready = |(id, part): &(&NodeId, &PartRecord)| {
        let node = model.node(id);
        let waits = node.is_some_and(|node| node.word() == keys::record::NodeWord::Ready);
        part.state == JobState::Running || waits
    };
    let all = parts.clone().count();
    let missing: Vec<&NodeId> = parts
        .filter(|part| !is_ready(part))
        .map(|(id, _)| id)
        .collect();
    match (&record.start, countdown(model, record)) {
        (Some(start), _) => {
            let (skew, error) = (start.skew_us, start.uncertainty_us);
            words += &format!(
                ", started {} apart ± {}",
                text::micros(skew),
                text::micros(error)
            );
        }
        // Nothing is planned before all are.
        (None, Some(countdown)) => words += &format!(", all ready, {countdown}"),
        (None, None) if !record.state.is_final() => {
            words += &format!(", {} of {all} ready", all - missing.len());
            if !missing.is_empty() {
                words += &format!(", waiting for {}", awaited(&missing));
            }
        }
        (None, None) => {}
    }
    if !model.follows_jobs() && !record.state.is_final() {
        words += "; as it was: no gateway tells of it now";
        return (Tone::Quiet, words);
    }
    (badge.tone, words)
}

fn part_ui(ui: &mut Ui, view: &mut View, open: NodeId, wrong: Option<&String>) {
    let editor = &mut view.group_job;
    let Some(text) = editor.parts.get_mut(&open) else {
        return;
    };
    let prefix = format!("nodes.{open}.");
    let message = wrong.and_then(|wrong| wrong.split_once(&prefix).map(|(_, rest)| rest));
    let place = message.and_then(|message| syntax::error_place(text, message));
    ScrollArea::vertical().auto_shrink(false).show(ui, |ui| {
        let label = ui.label(format!("Part of {open} (JSON: commands or lua)"));
        let edit = editor_ui(ui, text, Language::Json, place.as_ref(), EDITOR_ROWS);
        edit.labelled_by(label.id);
    });
}
