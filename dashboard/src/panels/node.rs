//! One node's page: what it says about itself, its stop, its last minutes as plots, its log.

use super::{node_plots, node_setup};
use crate::{
    message::Answer,
    model::{Model, log::Source, node::Node},
    request::{Order, Request, Requests, Scope},
    text,
    theme::{self, Tone},
    view::View,
};
use egui::{Grid, RichText, ScrollArea, TextStyle, Ui};
use keys::{StopMode, record::NodeWord};
use serde::{Deserialize, Serialize};

/// What stands where a value is wanted that nobody sends.
pub(super) const NOT_TOLD: &str = "not told";

/// Vitals that are older show their age, s: a node tells them every ten seconds.
const VITALS_OLD_S: f64 = 35.0;

/// The parts of a node's page.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub enum Page {
    /// Its present values and faults.
    #[default]
    Overview,
    /// Position, speed and queue over time.
    Motion,
    /// One axis over another: where the tool was.
    Path,
    /// Offset and error of its clock over time.
    Clock,
    /// Its lines.
    Lines,
    /// What it is, as far as it is told.
    Setup,
}

impl Page {
    /// Every page, as shown.
    pub const ALL: [Self; 6] = [
        Self::Overview,
        Self::Motion,
        Self::Path,
        Self::Clock,
        Self::Lines,
        Self::Setup,
    ];

    /// Returns its title.
    pub const fn title(self) -> &'static str {
        match self {
            Self::Overview => "Overview",
            Self::Motion => "Motion",
            Self::Path => "Path",
            Self::Clock => "Clock",
            Self::Lines => "Lines",
            Self::Setup => "Setup",
        }
    }
}

/// What the page remembers.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(default)]
pub struct NodeView {
    /// The page that is open.
    pub page: Page,
    /// The axis that the path shows to the right.
    pub path_right: usize,
    /// The axis that the path shows upwards.
    pub path_up: usize,
    /// Where the pointer is in a plot over time, s before the present.
    #[serde(skip)]
    pub cursor_s: Option<f64>,
    /// The speed that can be set, percent.
    pub speed_percent: u16,
    /// The folder for plots as files.
    pub folder: String,
    /// The plot that is to become a file.
    #[serde(skip)]
    pub export: Option<Export>,
    /// What became of the last one.
    #[serde(skip)]
    pub exported: Option<Result<String, String>>,
}

/// What a plot is to become.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Export {
    /// Its numbers.
    Csv,
    /// The picture of this part of the window.
    Png(egui::Rect),
}

impl Default for NodeView {
    fn default() -> Self {
        Self {
            page: Page::default(),
            path_right: 0,
            path_up: 1,
            cursor_s: None,
            speed_percent: 100,
            folder: ".".to_owned(),
            export: None,
            exported: None,
        }
    }
}

/// Shows the page of the node that has the focus.
pub fn node_ui(ui: &mut Ui, model: &Model, view: &mut View, requests: &mut Requests) {
    let Some(id) = view.focus else { return };
    ui.horizontal(|ui| {
        ui.heading(id.as_str());
        ui.with_layout(egui::Layout::right_to_left(egui::Align::Center), |ui| {
            let close = ui.button("✖");
            theme::named(&close, egui::Role::Button, "Close page");
            if close.clicked() {
                view.focus = None;
            }
        });
    });
    let Some(node) = model.node(&id) else {
        ui.label("nothing was heard of this node yet");
        return;
    };
    // First, so that nothing that a node says moves what stops it.
    ui.horizontal_wrapped(|ui| {
        let stop = ui.add(theme::stop_button("Stop node"));
        let slow = ui.button("Slow stop node");
        for (button, mode) in [(stop, StopMode::Halt), (slow, StopMode::Decelerate)] {
            if button.clicked() {
                let scope = Scope::node(id);
                requests.push(Request::Stop { scope, mode });
            }
        }
        let stopped = node.word() == NodeWord::Stopped;
        let release = egui::Button::new("Release node…");
        if ui.add_enabled(stopped, release).clicked() {
            view.stop.releasing = Some(Scope::node(id));
        }
    });
    ui.horizontal_wrapped(|ui| {
        let badge = theme::node_badge(node.word());
        let concern = model.concern(node).map(theme::concern_badge);
        let concern = concern.filter(|concern| concern.word != badge.word);
        let is_fresh = model.is_fresh(node);
        for (badge, is_known) in [(Some(badge), is_fresh), (concern, model.link().is_up())] {
            let text = badge.map(|badge| badge.text(ui));
            match text {
                Some(text) if is_known => ui.label(text),
                Some(text) => ui.label(theme::aged(ui, text)),
                None => continue,
            };
        }
        if !is_fresh {
            ui.label(theme::toned(ui, Tone::Warn, old_words(model, node)));
        }
        if let Some(pace) = node.pace() {
            ui.label(theme::toned(ui, Tone::Warn, text::pace(pace)));
        }
    });
    orders_ui(ui, model, node, &mut view.node, requests);
    ui.horizontal_wrapped(|ui| {
        for page in Page::ALL {
            ui.selectable_value(&mut view.node.page, page, page.title());
        }
    });
    ui.separator();
    let of_page = &mut view.node;
    if matches!(of_page.page, Page::Motion | Page::Path | Page::Clock) {
        export_ui(ui, of_page);
    }
    ui.push_id(of_page.page.title(), |ui| match of_page.page {
        Page::Overview => scrolled(ui, |ui| {
            facts_ui(ui, model, node);
            faults_ui(ui, node);
        }),
        Page::Motion => node_plots::motion_ui(ui, model, node, of_page),
        Page::Path => node_plots::path_ui(ui, node, of_page),
        Page::Clock => node_plots::clock_ui(ui, model, node, of_page),
        Page::Lines => lines_ui(ui, model, node),
        Page::Setup => scrolled(ui, |ui| node_setup::setup_ui(ui, model, node, requests)),
    });
}

/// Says that the page is about what was, and why.
fn old_words(model: &Model, node: &Node) -> String {
    let age = text::age(model.now().since_s(node.heard_at()));
    let why = match (model.link().is_up(), node.is_there()) {
        (false, _) => "there is no link",
        (true, false) => "it is gone",
        (true, true) => "it is silent",
    };
    format!("⚠ as it was {age} ago: {why}")
}

/// Shows what holds, resumes and slows the node's motion, and what became of it.
fn orders_ui(
    ui: &mut Ui,
    model: &Model,
    node: &Node,
    view: &mut NodeView,
    requests: &mut Requests,
) {
    let (id, word) = (node.id(), node.word());
    ui.horizontal_wrapped(|ui| {
        let hold = egui::Button::new("Hold");
        let hold = ui.add_enabled(matches!(word, NodeWord::Running | NodeWord::Ready), hold);
        let resume = ui.add_enabled(word == NodeWord::Paused, egui::Button::new("Resume"));
        let label = ui.label("Speed");
        let percent = egui::DragValue::new(&mut view.speed_percent)
            .range(Order::PERCENT)
            .suffix(" %");
        ui.add(percent).labelled_by(label.id);
        let speed = ui.add_enabled(node.is_there(), egui::Button::new("Set speed"));
        for (button, order, hint) in [
            (
                hold,
                Order::Hold,
                "Come to rest on the path; the job goes on with Resume",
            ),
            (resume, Order::Resume, "Go on where it was held"),
            (
                speed,
                Order::Speed(view.speed_percent),
                "Of ramps and lines, from now on",
            ),
        ] {
            if button.on_hover_text(hint).clicked() {
                requests.push(Request::Order { node: id, order });
            }
        }
        if let Some(ordered) = model.orders().of(&id) {
            let (tone, words) = match &ordered.answer {
                None => (Tone::Plain, format!("⌛ {}", ordered.order)),
                Some(Answer::Failed(why)) => (Tone::Bad, format!("✖ {}: {why}", ordered.order)),
                Some(Answer::Done { refused, .. }) if !refused.is_empty() => {
                    (Tone::Bad, format!("✖ {}: {}", ordered.order, refused[0]))
                }
                Some(_) => (Tone::Good, format!("✔ {} taken", ordered.order)),
            };
            ui.label(theme::toned(ui, tone, words));
        }
    });
}

/// Shows the buttons that make files of plots.
fn export_ui(ui: &mut Ui, view: &mut NodeView) {
    let page = ui.available_rect_before_wrap();
    ui.horizontal(|ui| {
        if ui.button("Save CSV").clicked() {
            view.export = Some(Export::Csv);
        }
        if ui.button("Save PNG").clicked() {
            view.export = Some(Export::Png(page));
        }
        let label = ui.label("in");
        let edit = egui::TextEdit::singleline(&mut view.folder).desired_width(120.0);
        ui.add(edit).labelled_by(label.id);
    });
    match &view.exported {
        Some(Ok(name)) => {
            let words = theme::toned(ui, Tone::Good, format!("✔ written: {name}"));
            ui.add(egui::Label::new(words).wrap());
        }
        Some(Err(why)) => {
            let words = theme::toned(ui, Tone::Bad, format!("✖ {why}"));
            ui.add(egui::Label::new(words).wrap());
        }
        None => {}
    }
}

pub(super) fn scrolled(ui: &mut Ui, content: impl FnOnce(&mut Ui)) {
    ScrollArea::vertical()
        .auto_shrink(false)
        .show(ui, |ui| content(ui));
}

fn facts_ui(ui: &mut Ui, model: &Model, node: &Node) {
    let mut facts: Vec<(&str, String)> = Vec::new();
    let age = text::age(model.now().since_s(node.heard_at()));
    facts.push(("heard", format!("{age} ago")));
    if let Some(job) = node.job() {
        let progress = model.jobs().get(&job).map(|record| record.progress);
        let progress = progress.map(|progress| format!(" {}/{}", progress.done, progress.total));
        facts.push(("job", format!("{job}{}", progress.unwrap_or_default())));
    }
    let position = text::positions(&node.positions_steps());
    facts.push(("position", format!("{position} steps")));
    let speeds_hz = node.speeds_hz();
    let still = speeds_hz.iter().all(|speed_hz| *speed_hz == 0.0);
    let unit = if still { "" } else { " steps/s" };
    facts.push(("speed", format!("{}{unit}", text::speeds(&speeds_hz))));
    if let Some((depth, free)) = node.queue() {
        facts.push(("queue", format!("{depth} waiting, room for {free}")));
    }
    if let Some(clock) = node.clock() {
        let drift = format!("{}, {:+.1} ppm", text::clock(&clock), clock.drift_ppm);
        facts.push(("clock", drift));
    }
    let rssi = node.rssi_dbm().map(|rssi_dbm| format!("{rssi_dbm} dBm"));
    facts.push(("RSSI", rssi.unwrap_or_else(|| NOT_TOLD.to_owned())));
    facts.extend(vitals_facts(model, node));
    if let Some(status) = node.latest_status() {
        facts.push(("laser", format!("{} %", status.laser_percent)));
        if let Some(lidar_mm) = status.lidar_mm {
            facts.push(("lidar", format!("{lidar_mm} mm")));
        }
    }
    if let Some(record) = node.latest_record() {
        facts.push(("firmware", record.firmware.clone()));
        facts.push(("up", text::age(record.uptime_s as f64)));
        if let Some(stopped) = record.stopped {
            let at = text::date_and_time(stopped.at);
            facts.push(("stopped", format!("by {} at {at}", stopped.reason.as_str())));
        }
    }
    facts_grid(ui, "facts", facts);
}

/// Temperature, free heap and free stack, each with its age when the node has not said it for long.
fn vitals_facts(model: &Model, node: &Node) -> Vec<(&'static str, String)> {
    let (at, vitals) = node.vitals().copied().unwrap_or_default();
    let age_s = model.now().since_s(at);
    let known = |value: Option<String>| match value {
        None => NOT_TOLD.to_owned(),
        Some(value) if age_s > VITALS_OLD_S => format!("{value}, {} ago", text::age(age_s)),
        Some(value) => value,
    };
    let both = |first: Option<u32>, second: Option<u32>, words: [&str; 2]| {
        let told = [first, second].into_iter().zip(words);
        let told = told.filter_map(|(bytes, word)| Some(format!("{} {word}", text::bytes(bytes?))));
        let told: Vec<String> = told.collect();
        (!told.is_empty()).then(|| told.join(", "))
    };
    let heap = both(
        vitals.internal_free_bytes,
        vitals.psram_free_bytes,
        ["inside", "outside"],
    );
    let stack = both(
        vitals.network_stack_free_bytes,
        vitals.planning_stack_free_bytes,
        ["network", "planning"],
    );
    let celsius = vitals.chip_celsius.map(|celsius| format!("{celsius} °C"));
    vec![
        ("temperature", known(celsius)),
        ("free heap", known(heap)),
        ("least free stack", known(stack)),
    ]
}

/// Shows names and what is known of each, under an id of its own.
pub(super) fn facts_grid<N: Into<String>>(ui: &mut Ui, id: &str, facts: Vec<(N, String)>) {
    Grid::new(id).num_columns(2).striped(true).show(ui, |ui| {
        for (name, value) in facts {
            ui.label(theme::toned(ui, Tone::Quiet, name));
            let tone = if value == NOT_TOLD {
                Tone::Quiet
            } else {
                Tone::Plain
            };
            let value = theme::toned(ui, tone, value);
            ui.add(egui::Label::new(value).wrap());
            ui.end_row();
        }
    });
}

fn faults_ui(ui: &mut Ui, node: &Node) {
    ui.separator();
    let mut words = Vec::new();
    match (node.latest_record(), node.latest_status()) {
        // The gateway's times are those of the fleet.
        (Some(record), _) if !record.faults.is_empty() => {
            for fault in &record.faults {
                let at = text::date_and_time(fault.at);
                words.push(format!("✖ {at}  {} {}", fault.code, fault.message));
            }
        }
        (_, Some(status)) => {
            for fault in &status.faults {
                let at_s = fault.at.0 as f64 / 1e6;
                let (code, name) = (fault.code.0, fault.code.as_str());
                words.push(format!("✖ {at_s:.3} s after its boot  {code} {name}"));
            }
        }
        _ => {}
    }
    if words.is_empty() {
        ui.label(theme::toned(ui, Tone::Quiet, "no fault since its boot"));
        return;
    }
    ui.label("Faults since its boot, the last first");
    for words in words.into_iter().rev() {
        let words = theme::toned(ui, Tone::Bad, words);
        ui.add(egui::Label::new(words).wrap());
    }
}

fn lines_ui(ui: &mut Ui, model: &Model, node: &Node) {
    let lines = model.log().lines();
    let its = |line: &&crate::model::log::Line| line.source == Source::Node(node.id());
    let lines: Vec<_> = lines.iter().filter(its).collect();
    let count = text::count(lines.len(), "line");
    let words = format!("{count} of this node, the newest at the bottom");
    ui.horizontal_wrapped(|ui| {
        ui.label(theme::toned(ui, Tone::Quiet, words));
        if ui.button("Copy lines").clicked() {
            ui.copy_text(super::log::copied(lines.iter().copied()));
        }
    });
    let height = ui.text_style_height(&TextStyle::Monospace);
    ScrollArea::both()
        .auto_shrink(false)
        .stick_to_bottom(true)
        .show_rows(ui, height, lines.len(), |ui, rows| {
            for line in &lines[rows] {
                let words = format!("{}  {}", text::time_of_day(line.at), line.text);
                let words = RichText::new(words).monospace();
                ui.add(egui::Label::new(words).wrap_mode(egui::TextWrapMode::Extend));
            }
        });
}
