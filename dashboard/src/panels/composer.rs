//! Writing a job and sending it: for whom, the text with the place of its first error, the receipt.

use crate::{
    message::Answer,
    model::{Model, jobs::Sent, select::Pattern},
    request::{Language, Request, Requests, Target, Ticket},
    text,
    theme::{self, Tone},
    view::View,
};
use egui::{ScrollArea, TextEdit, Ui};
use keys::{NodeId, job::JobRequest, record::JobError};
use serde::{Deserialize, Serialize};
use std::collections::BTreeSet;

/// Names of matching nodes that are spelled out.
const NAMES_SHOWN: usize = 8;

/// What the panel remembers.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(default)]
pub struct ComposerView {
    /// A node's name or a wild chunk.
    pub target: String,
    /// The job.
    pub text: String,
    /// The last job that was sent.
    #[serde(skip)]
    pub sent: Option<Ticket>,
    /// The text that was checked last, and what came out.
    #[serde(skip)]
    checked: Option<(String, Result<usize, JobError>)>,
}

impl Default for ComposerView {
    fn default() -> Self {
        let text = "{\"commands\":[\n  {\"ramp\":{\"axis\":0,\"steps\":2000,\"speed_hz\":1000,\"accel\":2000}}\n]}";
        Self {
            target: String::new(),
            text: text.to_owned(),
            sent: None,
            checked: None,
        }
    }
}

impl ComposerView {
    /// Takes the selection as the target, if it is one node.
    pub fn target_nodes(&mut self, nodes: &BTreeSet<NodeId>) {
        if let (Some(node), 1) = (nodes.first(), nodes.len()) {
            self.target = node.as_str().to_owned();
        }
    }

    /// Takes a job that was sent, without its id: the same id would be the same job.
    pub fn again(&mut self, sent: &Sent) {
        self.target.clone_from(&sent.target);
        self.text = without_id(&sent.payload);
        self.sent = None;
    }

    /// Returns how many commands the text has, or what is wrong where.
    pub fn check(&mut self) -> &Result<usize, JobError> {
        if self
            .checked
            .as_ref()
            .is_none_or(|(text, _)| *text != self.text)
        {
            let outcome = JobRequest::from_json(self.text.as_bytes());
            let outcome = outcome.map(|job| match job.work {
                keys::job::Work::Commands(commands) => commands.len(),
                keys::job::Work::Lua(_) => 0,
            });
            self.checked = Some((self.text.clone(), outcome));
        }
        match &self.checked {
            Some((_, outcome)) => outcome,
            None => unreachable!("set above"),
        }
    }
}

fn without_id(payload: &str) -> String {
    type Object = serde_json::Map<String, serde_json::Value>;
    let Ok(mut job) = serde_json::from_str::<Object>(payload) else {
        return payload.to_owned();
    };
    if job.remove("id").is_none() {
        return payload.to_owned();
    }
    serde_json::to_string_pretty(&job).unwrap_or_else(|_| payload.to_owned())
}

/// Shows the composer.
pub fn composer_ui(ui: &mut Ui, model: &Model, view: &mut View, requests: &mut Requests) {
    let composer = &mut view.composer;
    let pattern = Pattern::new(composer.target.trim());
    let reach: Vec<NodeId> = pattern.as_ref().map_or(Vec::new(), |pattern| {
        let nodes = model.matching(pattern);
        nodes.map(|node| node.id()).collect()
    });
    let checked = composer.check().clone();
    ui.horizontal_wrapped(|ui| {
        let label = ui.label("Send to");
        let edit = TextEdit::singleline(&mut composer.target)
            .hint_text("node-1, cell-a-$* or *")
            .desired_width(160.0);
        ui.add(edit).labelled_by(label.id);
        let why = refusal(model, &pattern, reach.len(), &checked);
        let send = ui.add_enabled(why.is_none(), egui::Button::new("Send job"));
        let send = send.on_disabled_hover_text(why.unwrap_or_default());
        if send.clicked()
            && let Ok(pattern) = &pattern
        {
            composer.sent = Some(requests.push(Request::Submit {
                target: Target::Node(pattern.as_str().to_owned()),
                language: Language::Json,
                text: composer.text.clone(),
            }));
        }
        reach_ui(ui, model, &pattern, &reach);
        check_ui(ui, &checked);
    });
    sent_ui(ui, model, view);
    ScrollArea::vertical().auto_shrink(false).show(ui, |ui| {
        let edit = TextEdit::multiline(&mut view.composer.text)
            .code_editor()
            .desired_width(f32::INFINITY)
            .desired_rows(8);
        let label = ui.label("Job text (JSON)");
        ui.add(edit).labelled_by(label.id);
    });
}

/// Returns why the job cannot be sent.
fn refusal(
    model: &Model,
    pattern: &Result<Pattern, String>,
    reached: usize,
    checked: &Result<usize, JobError>,
) -> Option<String> {
    if !model.link().is_up() {
        return Some("there is no link".to_owned());
    }
    if model.link().gateway() == Some(false) {
        return Some("no gateway answers".to_owned());
    }
    match (pattern, checked) {
        (Err(why), _) => Some(why.clone()),
        (_, Err(error)) => Some(error.to_string()),
        (Ok(pattern), Ok(_)) if pattern.is_wild() && reached == 0 => {
            Some("no node that is there matches".to_owned())
        }
        _ => None,
    }
}

fn reach_ui(ui: &mut Ui, model: &Model, pattern: &Result<Pattern, String>, reach: &[NodeId]) {
    let (tone, words) = match (pattern, reach) {
        (Err(why), _) => (Tone::Quiet, why.clone()),
        (Ok(pattern), []) if !pattern.is_wild() => {
            let known = NodeId::new(pattern.as_str()).is_ok_and(|id| model.node(&id).is_some());
            if known {
                (
                    Tone::Warn,
                    "⚠ offline: the job waits until it returns".to_owned(),
                )
            } else {
                (Tone::Warn, "⚠ never heard of this node".to_owned())
            }
        }
        (Ok(_), []) => (Tone::Warn, "⚠ reaches no node".to_owned()),
        (Ok(_), nodes) => {
            let names: Vec<&str> = nodes.iter().take(NAMES_SHOWN).map(NodeId::as_str).collect();
            let more = nodes.len().saturating_sub(NAMES_SHOWN);
            let more = if more > 0 {
                format!(" and {more} more")
            } else {
                String::new()
            };
            let count = text::count(nodes.len(), "node");
            (
                Tone::Good,
                format!("● reaches {count}: {}{more}", names.join(", ")),
            )
        }
    };
    ui.label(theme::toned(ui, tone, words));
}

fn check_ui(ui: &mut Ui, checked: &Result<usize, JobError>) {
    let (tone, words) = match checked {
        Ok(0) => (Tone::Good, "✔ a script".to_owned()),
        Ok(count) => (Tone::Good, format!("✔ {}", text::count(*count, "command"))),
        Err(error) => (Tone::Bad, format!("✖ {error}")),
    };
    ui.label(theme::toned(ui, tone, words));
}

/// Shows what became of the job that was sent last.
fn sent_ui(ui: &mut Ui, model: &Model, view: &mut View) {
    let Some(ticket) = view.composer.sent else {
        return;
    };
    let Some(sent) = model.jobs().sent().find(|sent| sent.ticket == ticket) else {
        return;
    };
    ui.horizontal_wrapped(|ui| match &sent.answer {
        None => {
            ui.label(format!("⌛ sent to {}, no receipt yet", sent.target));
        }
        Some(Answer::Receipts(receipts)) => {
            for receipt in receipts {
                match receipt {
                    Ok(receipt) => {
                        let record = model.jobs().get(&receipt.job);
                        let state = record.map_or(receipt.state, |record| record.state);
                        let badge = theme::job_badge(state);
                        let words = format!("{} {}: {}", badge.icon, receipt.job, badge.word);
                        let color = badge.tone.color(ui);
                        let link = ui.button(egui::RichText::new(words).color(color));
                        if link.clicked() {
                            view.jobs.open = Some(receipt.job);
                            view.tab = crate::view::Tab::Jobs;
                        }
                    }
                    Err(error) => {
                        ui.label(theme::toned(ui, Tone::Bad, format!("✖ refused: {error}")));
                    }
                }
            }
        }
        Some(Answer::Failed(why)) => {
            ui.label(theme::toned(ui, Tone::Bad, format!("✖ {why}")));
        }
        Some(Answer::Sent | Answer::Done { .. }) => {}
    });
}
