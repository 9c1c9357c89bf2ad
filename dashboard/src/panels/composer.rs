//! Writing a job and sending it: for whom, the text with the place of its first error, what it would
//! do, the receipts.

mod file;

pub use file::{open_dropped, take_dropped, take_opened};

use super::{
    editor, preview,
    reach::{Reach, reach_ui},
};
use crate::{
    estimate::{Estimate, estimate},
    lua::{self, Verdict},
    message::Answer,
    model::{Model, jobs::Sent, select::Pattern},
    request::{Language, Request, Requests, Target, Ticket},
    syntax, text,
    theme::{self, Tone},
    view::{Tab, View},
};
use egui::{Panel, ScrollArea, TextEdit, Ui};
use keys::{
    NodeId,
    job::{JobRequest, Work},
    record::JobError,
};
use serde::{Deserialize, Serialize, Serializer};
use std::{collections::BTreeSet, ops::Range, sync::Arc};

/// Least height of the text, rows.
const EDITOR_ROWS: usize = 8;

/// Longest text that is shown for editing and kept between runs, bytes. A longer one, from a file,
/// is checked, previewed and sent as it is.
pub const EDIT_BYTES_MAX: usize = 128 << 10;

/// What the panel remembers.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(default)]
pub struct ComposerView {
    /// A node's name or a wild chunk.
    pub target: String,
    /// Sends to the selected nodes instead.
    #[serde(skip)]
    pub to_selection: bool,
    /// What is being written.
    pub language: Language,
    /// The job, in JSON.
    #[serde(serialize_with = "if_short")]
    pub text: String,
    /// The job, in Lua.
    #[serde(serialize_with = "if_short")]
    pub script: String,
    /// The file to open.
    pub file: String,
    /// The last job that was sent.
    #[serde(skip)]
    pub sent: Option<Ticket>,
    #[serde(skip)]
    opening: Option<Ticket>,
    /// Why the file that was to be opened last is not what is below.
    #[serde(skip)]
    not_opened: Option<String>,
    #[serde(skip)]
    dropped: Option<String>,
    #[serde(skip)]
    dropped_more: usize,
    #[serde(skip)]
    dropped_on_row: bool,
    #[serde(skip)]
    drop_note: Option<String>,
    #[serde(skip)]
    checked: Option<Arc<Checked>>,
}

/// The text that was checked last, and what came out.
#[derive(Clone, Debug)]
struct Checked {
    language: Language,
    text: String,
    start_steps: Vec<i64>,
    outcome: Result<JobRequest, JobError>,
    place: Option<Range<usize>>,
    estimate: Option<Estimate>,
    /// Of a script.
    lua: Option<Verdict>,
}

fn if_short<S: Serializer>(text: &str, serializer: S) -> Result<S::Ok, S::Error> {
    let short = text.len() <= EDIT_BYTES_MAX;
    serializer.serialize_str(if short { text } else { "" })
}

impl Default for ComposerView {
    fn default() -> Self {
        let text = "{\"commands\":[\n  {\"ramp\":{\"axis\":0,\"steps\":2000,\"speed_hz\":1000,\"accel\":2000}}\n]}";
        Self {
            target: String::new(),
            to_selection: false,
            language: Language::Json,
            text: text.to_owned(),
            script: "motor.queue_move(0, 500, 2000)\nmotor.execute()\n".to_owned(),
            file: String::new(),
            sent: None,
            opening: None,
            not_opened: None,
            dropped: None,
            dropped_more: 0,
            dropped_on_row: false,
            drop_note: None,
            checked: None,
        }
    }
}

impl ComposerView {
    /// Takes the selection as the target.
    pub fn target_nodes(&mut self, nodes: &BTreeSet<NodeId>) {
        self.to_selection = nodes.len() > 1;
        if let (Some(node), 1) = (nodes.first(), nodes.len()) {
            self.target = node.as_str().to_owned();
        }
    }

    /// Takes a job that was sent, without its id: the same id would be the same job. It is for the
    /// node that had it, if that is known, also where it was one of several.
    pub fn again(&mut self, sent: &Sent, node: Option<NodeId>) {
        self.to_selection = false;
        self.target = match node {
            Some(node) => node.to_string(),
            None if Pattern::new(&sent.target).is_ok() => sent.target.clone(),
            None => String::new(),
        };
        self.language = sent.language;
        match sent.language {
            Language::Json => self.text = without_id(&sent.payload),
            Language::Lua => self.script.clone_from(&sent.payload),
        }
        (self.sent, self.opening, self.not_opened) = (None, None, None);
    }

    /// Returns why what is below may not be what the operator means.
    fn other_text(&self) -> Option<String> {
        match (&self.opening, &self.not_opened) {
            (Some(_), _) => Some("the file is still being opened".to_owned()),
            (None, Some(_)) => Some("the file was not opened: this is another text".to_owned()),
            (None, None) => None,
        }
    }

    fn text_mut(&mut self) -> &mut String {
        match self.language {
            Language::Json => &mut self.text,
            Language::Lua => &mut self.script,
        }
    }

    /// Checks the text with the rules that the gateway has, if it is another one than last time. A
    /// long one is compared each time, and neither copied nor read again.
    fn check(&mut self, start_steps: &[i64]) -> Arc<Checked> {
        let language = self.language;
        let text = match language {
            Language::Json => &self.text,
            Language::Lua => &self.script,
        };
        if let Some(known) = &self.checked
            && known.language == language
            && known.text == *text
            && known.start_steps == start_steps
        {
            return Arc::clone(known);
        }
        let outcome = match language {
            Language::Json => JobRequest::from_json(text.as_bytes()),
            Language::Lua => Ok(JobRequest {
                id: None,
                work: Work::Lua(text.clone()),
                offline: keys::job::Offline::default(),
                timeout_s: None,
                signature: None,
            }),
        };
        let error = outcome.as_ref().err();
        let lua = (language == Language::Lua).then(|| lua::check(text));
        let place = match &lua {
            Some(Verdict::Wrong(wrong)) => Some(wrong.place.clone()),
            _ => error.and_then(|error| syntax::error_place(text, &error.message)),
        };
        let work = outcome.as_ref().ok().map(|job| &job.work);
        let checked = Arc::new(Checked {
            language,
            start_steps: start_steps.to_vec(),
            place,
            estimate: work.and_then(|work| estimate(work, start_steps)),
            text: text.clone(),
            outcome,
            lua,
        });
        self.checked = Some(Arc::clone(&checked));
        checked
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

/// Sends what is written to whom it is for: what the button does.
///
/// # Errors
/// Why it cannot be sent, for a person.
pub fn send(model: &Model, view: &mut View, requests: &mut Requests) -> Result<Ticket, String> {
    let reach = Reach::of(model, view);
    let checked = view.composer.check(&reach.start_steps(model));
    if let Some(why) = refusal(model, &view.composer, &reach, &checked) {
        return Err(why);
    }
    let ticket = requests.push(Request::Submit {
        target: reach.target?,
        language: checked.language,
        text: checked.text.clone(),
    });
    view.composer.sent = Some(ticket);
    Ok(ticket)
}

/// Shows the composer.
pub fn composer_ui(ui: &mut Ui, model: &Model, view: &mut View, requests: &mut Requests) {
    let reach = Reach::of(model, view);
    let checked = view.composer.check(&reach.start_steps(model));
    ui.horizontal_wrapped(|ui| {
        let composer = &mut view.composer;
        ui.selectable_value(&mut composer.language, Language::Json, "JSON");
        ui.selectable_value(&mut composer.language, Language::Lua, "Lua");
        let label = ui.label("Send to");
        let edit = TextEdit::singleline(&mut composer.target)
            .hint_text("node-1, cell-a-$* or *")
            .desired_width(150.0);
        ui.add_enabled(!composer.to_selection, edit)
            .labelled_by(label.id);
        let words = format!("Selection ({})", view.selection.len());
        ui.checkbox(&mut composer.to_selection, words);
        let why = refusal(model, composer, &reach, &checked);
        let button = ui.add_enabled(why.is_none(), egui::Button::new("Send job"));
        let button = button.on_disabled_hover_text(why.unwrap_or_default());
        if button.clicked() {
            // It can be sent, or the button would not be there to be clicked.
            let _ = send(model, view, requests);
        }
        reach_ui(ui, model, &reach);
        check_ui(ui, &checked);
    });
    file::file_ui(ui, view, requests);
    sent_ui(ui, model, view);
    if let Some(estimate) = &checked.estimate {
        Panel::right("preview")
            .resizable(true)
            .default_size(330.0)
            .show(ui, |ui| preview::preview_ui(ui, estimate));
    }
    text_ui(ui, &mut view.composer, checked.place.clone());
}

/// Returns why the job cannot be sent.
fn refusal(
    model: &Model,
    composer: &ComposerView,
    reach: &Reach,
    checked: &Checked,
) -> Option<String> {
    if let Some(why) = no_way(model).or_else(|| composer.other_text()) {
        return Some(why);
    }
    let job = match (&reach.target, &checked.outcome) {
        (Err(why), _) => return Some(why.clone()),
        (_, Err(error)) => return Some(error.to_string()),
        (Ok(_), Ok(job)) => job,
    };
    let selected = matches!(reach.target, Ok(Target::Nodes(_)));
    let wild = matches!(&reach.target, Ok(Target::Node(chunk)) if chunk.contains('*'));
    if wild && reach.there.is_empty() {
        return Some("no node that is there matches".to_owned());
    }
    if selected && reach.count() > 1 && job.id.is_some() {
        return Some("one id is one job: leave `id` out for several nodes".to_owned());
    }
    match &job.work {
        Work::Lua(script) if script.trim().is_empty() => Some("the script is empty".to_owned()),
        _ => None,
    }
}

/// Returns why nothing can be sent to a gateway.
pub(super) fn no_way(model: &Model) -> Option<String> {
    if !model.link().is_up() {
        Some("there is no link".to_owned())
    } else if model.link().gateway() == Some(false) {
        Some("no gateway answers".to_owned())
    } else {
        None
    }
}

fn text_ui(ui: &mut Ui, composer: &mut ComposerView, place: Option<Range<usize>>) {
    let language = composer.language;
    ScrollArea::vertical().auto_shrink(false).show(ui, |ui| {
        let label = ui.label(match language {
            Language::Json => "Job text (JSON)",
            Language::Lua => "Job script (Lua)",
        });
        let text = composer.text_mut();
        if text.len() > EDIT_BYTES_MAX {
            let words = format!("{} bytes: too long to edit here, sent as it is", text.len());
            ui.label(theme::toned(ui, Tone::Warn, words));
            if ui.button("Clear text").clicked() {
                text.clear();
            }
            return;
        }
        editor::editor_ui(ui, text, language, place.as_ref(), EDITOR_ROWS).labelled_by(label.id);
    });
}

/// A script is never held back: what runs it is the node's own engine.
fn lua_words(lua: Option<&Verdict>) -> (Tone, String) {
    match lua {
        Some(Verdict::Good) => {
            let words = "✔ Lua; what its functions do the node finds out";
            (Tone::Good, words.to_owned())
        }
        Some(Verdict::Wrong(wrong)) => (Tone::Warn, format!("⚠ no Lua? {}", wrong.words)),
        Some(Verdict::Unknown) | None => {
            let words = "a long script: the node checks it";
            (Tone::Plain, words.to_owned())
        }
    }
}

fn check_ui(ui: &mut Ui, checked: &Checked) {
    let (tone, words) = match checked.outcome.as_ref().map(|job| &job.work) {
        Ok(Work::Lua(_)) => lua_words(checked.lua.as_ref()),
        Ok(Work::Commands(list)) => {
            let count = text::count(list.len(), "command");
            (Tone::Good, format!("✔ {count}"))
        }
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
                            view.tab = Tab::Jobs;
                        }
                        if let Some(node) = record.and_then(|record| record.node) {
                            ui.label(format!("on {node}"));
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
