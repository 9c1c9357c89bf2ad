//! Job records, newest first, and one of them in detail.

use super::{chooser::Purpose, table::table_ui};
use crate::{
    message::{Answer, FileOutcome},
    model::{Model, jobs::Cancel, select::Pattern},
    records,
    request::{Request, Requests, Ticket},
    text,
    theme::{self, Tone},
    view::{Tab, View},
};
use egui::{Grid, Panel, RichText, Role, ScrollArea, TextEdit, Ui};
use keys::{
    JobId,
    record::{JobRecord, JobState},
};
use serde::{Deserialize, Serialize};

/// What the panel remembers.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
#[serde(default)]
pub struct JobsView {
    /// What job, node, group or error must contain.
    pub filter: String,
    /// A node's name or a wild chunk; all if empty.
    pub node: String,
    /// The file that an export is written to.
    pub export: String,
    /// The export that was asked for.
    #[serde(skip)]
    pub exported: Option<Ticket>,
    /// The state that is shown; all if `None`.
    pub state: Option<JobState>,
    /// The job whose detail is open.
    #[serde(skip)]
    pub open: Option<JobId>,
    /// The job that shall be canceled, once more asked for.
    #[serde(skip)]
    pub canceling: Option<JobId>,
}

/// Returns the records that pass the filters, newest first.
pub fn shown<'m>(model: &'m Model, view: &JobsView) -> Vec<&'m JobRecord> {
    let words = view.filter.trim().to_lowercase();
    let pattern = Pattern::new(view.node.trim()).ok();
    model
        .jobs()
        .newest_first()
        .filter(|record| view.state.is_none_or(|state| record.state == state))
        .filter(|record| {
            let pattern = pattern.as_ref();
            pattern.is_none_or(|pattern| is_for(record, pattern))
        })
        .filter(|record| words.is_empty() || contains(record, &words))
        .collect()
}

/// Without a gateway nobody knows what became since of a job that had not ended.
fn is_old(model: &Model, record: &JobRecord) -> bool {
    !model.follows_jobs() && !record.state.is_final()
}

fn is_for(record: &JobRecord, pattern: &Pattern) -> bool {
    let parts = record.parts.iter().flatten().map(|(node, _)| node);
    let mut nodes = record.node.iter().chain(parts);
    nodes.any(|node| pattern.matches(node.as_str()))
}

fn contains(record: &JobRecord, words: &str) -> bool {
    let parts = record.parts.iter().flatten();
    record.job.as_str().contains(words)
        || whose(record).contains(words)
        || parts
            .into_iter()
            .any(|(node, _)| node.as_str().contains(words))
        || outcome(record).to_lowercase().contains(words)
}

/// Shows filters, list and detail.
pub fn jobs_ui(ui: &mut Ui, model: &Model, view: &mut View, requests: &mut Requests) {
    let rows = shown(model, &view.jobs);
    ui.horizontal_wrapped(|ui| {
        let label = ui.label("Filter jobs");
        let edit = TextEdit::singleline(&mut view.jobs.filter)
            .hint_text("job, node or group")
            .desired_width(150.0);
        ui.add(edit).labelled_by(label.id);
        let label = ui.label("Node");
        let edit = TextEdit::singleline(&mut view.jobs.node)
            .hint_text("name or cell-a-$*")
            .desired_width(110.0);
        ui.add(edit).labelled_by(label.id);
        let state = view.jobs.state.map_or("all states", JobState::as_str);
        let label = ui.label("State");
        egui::ComboBox::from_id_salt("job state")
            .selected_text(state)
            .show_ui(ui, |ui| {
                ui.selectable_value(&mut view.jobs.state, None, "all states");
                for state in JobState::ALL {
                    let word = state.as_str();
                    ui.selectable_value(&mut view.jobs.state, Some(state), word);
                }
            })
            .response
            .labelled_by(label.id);
        let words = format!(
            "{} of {}",
            rows.len(),
            text::count(model.jobs().len(), "job")
        );
        ui.label(theme::toned(ui, Tone::Quiet, words));
        if rows.iter().any(|record| is_old(model, record)) {
            ui.label(theme::toned(ui, Tone::Warn, OLD));
        }
        export_ui(ui, model, view, &rows, requests);
    });
    if let (false, Err(why)) = (
        view.jobs.node.is_empty(),
        Pattern::new(view.jobs.node.trim()),
    ) {
        ui.label(theme::toned(ui, Tone::Warn, format!("⚠ {why}")));
    }
    let open = view.jobs.open.and_then(|job| model.jobs().get(&job));
    if let Some(record) = open {
        Panel::right("job detail")
            .resizable(true)
            .default_size(380.0)
            .show(ui, |ui| detail_ui(ui, model, view, record, requests));
    }
    if rows.is_empty() {
        let words = if model.jobs().is_empty() {
            "no jobs yet: compose one with Ctrl+N"
        } else {
            "no job passes the filter"
        };
        ui.label(theme::toned(ui, Tone::Quiet, words));
        return;
    }
    table_ui(ui, "jobs", &COLUMNS, &rows, |ui, record, column| {
        let text = match column {
            0 => {
                let open = view.jobs.open == Some(record.job);
                let label = ui.selectable_label(open, record.job.as_str());
                if label.clicked() {
                    view.jobs.open = (!open).then_some(record.job);
                }
                return None;
            }
            1 => RichText::new(whose(record)),
            2 => theme::job_badge(record.state).text(ui),
            3 => RichText::new(progress(record)),
            4 => RichText::new(text::date_and_time(record.created)),
            _ => RichText::new(now_or_outcome(model, record)),
        };
        Some(match is_old(model, record) {
            true => theme::aged(ui, text),
            false => text,
        })
    });
}

/// Writes what is listed to a new file.
fn export_ui(
    ui: &mut Ui,
    model: &Model,
    view: &mut View,
    rows: &[&JobRecord],
    requests: &mut Requests,
) {
    let View {
        jobs: view,
        chooser,
        ..
    } = view;
    let label = ui.label("Export to");
    let edit = TextEdit::singleline(&mut view.export)
        .hint_text("a new file")
        .desired_width(100.0);
    ui.add(edit).labelled_by(label.id);
    // A short one: everything stays in one row.
    let choose = ui.button("…");
    theme::named(&choose, Role::Button, "Choose where to export");
    if choose.clicked() {
        chooser.open(Purpose::NewHistory, &view.export);
    }
    let path = view.export.trim();
    let possible = !path.is_empty() && !rows.is_empty();
    let mut write = |text: String| {
        let path = path.to_owned();
        view.exported = Some(requests.push(Request::WriteFile { path, text }));
    };
    let button = |ui: &mut Ui, name: &str| {
        let button = ui.add_enabled(possible, egui::Button::new(name));
        theme::named(&button, Role::Button, &format!("Export {name}"));
        button.clicked()
    };
    if button(ui, "CSV") {
        write(records::csv(rows));
    }
    if button(ui, "JSON") {
        write(records::json(rows));
    }
    match view.exported.and_then(|ticket| model.file(ticket)) {
        Some(FileOutcome::Written { path }) => {
            ui.label(theme::toned(ui, Tone::Good, format!("✔ wrote {path}")));
        }
        Some(FileOutcome::Failed(why)) => {
            ui.label(theme::toned(ui, Tone::Bad, format!("✖ {why}")));
        }
        Some(FileOutcome::Read { .. }) | None => {}
    }
}

/// What is said of jobs of which nobody tells any more.
const OLD: &str = "⚠ as it was: no gateway tells of it now";

const COLUMNS: [(&str, f32); 6] = [
    ("Job", 200.0),
    ("For", 110.0),
    ("State", 100.0),
    ("Done", 90.0),
    ("Created (UTC)", 170.0),
    ("Outcome", 420.0),
];

fn whose(record: &JobRecord) -> String {
    match (record.node, record.group) {
        (Some(node), _) => node.to_string(),
        (None, Some(group)) => format!("group {group}"),
        (None, None) => "–".to_owned(),
    }
}

fn progress(record: &JobRecord) -> String {
    format!("{}/{}", record.progress.done, record.progress.total)
}

fn outcome(record: &JobRecord) -> String {
    match (&record.error, &record.start, &record.result) {
        (Some(error), _, _) => error.to_string(),
        (None, Some(start), _) => format!(
            "started {} apart ± {}",
            text::micros(start.skew_us),
            text::micros(start.uncertainty_us)
        ),
        (None, None, Some(result)) => {
            format!("at {} steps", text::positions(&result.position))
        }
        (None, None, None) => String::new(),
    }
}

/// Returns what is about to become of a job that has no outcome yet, else its outcome.
fn now_or_outcome(model: &Model, record: &JobRecord) -> String {
    if !record.state.is_final()
        && let Some(cancel) = model.jobs().cancel(&record.job)
    {
        return cancel_words(cancel).1;
    }
    match super::group_job::countdown(model, record) {
        Some(words) => words,
        None => outcome(record),
    }
}

/// Returns what became of a cancel, as far as the gateway's answer tells.
fn cancel_words(cancel: &Cancel) -> (Tone, String) {
    match &cancel.answer {
        None => (Tone::Plain, "⌛ cancel asked for".to_owned()),
        Some(Answer::Failed(why)) => (Tone::Bad, format!("✖ NOT CANCELED: {why}")),
        Some(Answer::Done { refused, .. }) if !refused.is_empty() => {
            (Tone::Bad, format!("✖ NOT CANCELED: {}", refused[0]))
        }
        Some(_) => {
            let words = "⏹ cancel taken: it ends when its nodes are at rest";
            (Tone::Warn, words.to_owned())
        }
    }
}

fn detail_ui(
    ui: &mut Ui,
    model: &Model,
    view: &mut View,
    record: &JobRecord,
    requests: &mut Requests,
) {
    ui.horizontal_wrapped(|ui| {
        ui.heading(record.job.as_str());
        let badge = theme::job_badge(record.state).text(ui);
        if is_old(model, record) {
            ui.label(theme::aged(ui, badge));
            ui.label(theme::toned(ui, Tone::Warn, OLD));
        } else {
            ui.label(badge);
        }
    });
    ui.horizontal_wrapped(|ui| {
        cancel_ui(ui, view, record, requests);
        let sent = model.jobs().sent_as(&record.job);
        let again = ui.add_enabled(sent.is_some(), egui::Button::new("Run again…"));
        let again = again.on_hover_text("Opens it in its editor, under a new id");
        let again = again.on_disabled_hover_text(
            "Only jobs that this window sent since its start can be sent again",
        );
        if again.clicked()
            && let Some(sent) = sent
        {
            if record.group.is_some() {
                view.group_job.again(sent);
                view.tab = Tab::GroupJob;
            } else {
                view.composer.again(sent, record.node);
                view.tab = Tab::Compose;
            }
        }
        if ui.button("Copy id").clicked() {
            ui.copy_text(record.job.to_string());
        }
        if ui.button("Close detail").clicked() {
            view.jobs.open = None;
        }
    });
    if let Some(cancel) = model.jobs().cancel(&record.job) {
        let (tone, words) = cancel_words(cancel);
        if tone == Tone::Bad || !record.state.is_final() {
            let words = theme::toned(ui, tone, words);
            ui.add(egui::Label::new(words).wrap());
        }
    }
    ScrollArea::vertical().auto_shrink(false).show(ui, |ui| {
        facts_ui(ui, record);
        parts_ui(ui, record);
    });
}

fn cancel_ui(ui: &mut Ui, view: &mut View, record: &JobRecord, requests: &mut Requests) {
    if record.state.is_final() {
        return;
    }
    if view.jobs.canceling == Some(record.job) {
        if ui.button("Really cancel").clicked() {
            requests.push(Request::Cancel { job: record.job });
            view.jobs.canceling = None;
        }
        if ui.button("Let it run").clicked() {
            view.jobs.canceling = None;
        }
    } else if ui.button("Cancel job…").clicked() {
        view.jobs.canceling = Some(record.job);
    }
}

fn facts_ui(ui: &mut Ui, record: &JobRecord) {
    let mut facts = vec![
        ("for", whose(record)),
        ("done", format!("{} commands", progress(record))),
        ("created", text::date_and_time(record.created)),
        ("updated", text::date_and_time(record.updated)),
        ("version", record.version.to_string()),
    ];
    if let Some(error) = &record.error {
        facts.push(("error", error.to_string()));
    }
    if let Some(result) = &record.result {
        let position = text::positions(&result.position);
        facts.push(("final position", format!("{position} steps")));
        if let Some(returned) = &result.returned {
            facts.push(("returned", returned.to_string()));
        }
    }
    if let Some(start) = &record.start {
        facts.push(("planned start", text::date_and_time(start.planned)));
        facts.push(("start", outcome(record)));
    }
    Grid::new("job facts")
        .num_columns(2)
        .striped(true)
        .show(ui, |ui| {
            for (name, value) in facts {
                ui.label(theme::toned(ui, Tone::Quiet, name));
                ui.add(egui::Label::new(value).wrap());
                ui.end_row();
            }
        });
}

fn parts_ui(ui: &mut Ui, record: &JobRecord) {
    let Some(parts) = &record.parts else { return };
    ui.separator();
    ui.label("Parts, with the first edge of each after the earliest one");
    Grid::new("parts")
        .num_columns(4)
        .striped(true)
        .show(ui, |ui| {
            for (node, part) in parts {
                ui.label(node.as_str());
                theme::job_badge(part.state).show(ui);
                ui.label(format!("{}/{}", part.progress.done, part.progress.total));
                let start = record.start.as_ref();
                let skew = start.and_then(|start| start.by_node_us.get(node));
                let error = part.error.as_ref().map(ToString::to_string);
                let skew = skew.map(|us| format!("+{us:.1} µs"));
                ui.label(error.or(skew).unwrap_or_default());
                ui.end_row();
            }
        });
}
