//! One row per node: the table that an operator looks at all day.

use crate::{
    model::{
        Model,
        node::{Concern, Node},
        select::Pattern,
    },
    text,
    theme::{self, Tone},
    view::View,
};
use egui::{Margin, RichText, Role, TextEdit, Ui};
use egui_table::{CellInfo, HeaderCellInfo, HeaderRow, Table, TableDelegate};
use keys::NodeId;
use serde::{Deserialize, Serialize};
use std::cmp::Ordering;

/// The columns.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub enum Column {
    /// Name.
    #[default]
    Node,
    /// What it does, or why somebody should look at it.
    State,
    /// Job and its progress.
    Job,
    /// Commands waiting and room.
    Queue,
    /// Position of each axis.
    Position,
    /// Speed of each axis.
    Speed,
    /// Clock offset and its error.
    Clock,
    /// Signal strength.
    Rssi,
    /// Last fault.
    Fault,
    /// Time since it was heard of.
    Heard,
}

impl Column {
    /// Every column, as shown.
    pub const ALL: [Self; 10] = [
        Self::Node,
        Self::State,
        Self::Heard,
        Self::Job,
        Self::Queue,
        Self::Position,
        Self::Speed,
        Self::Clock,
        Self::Rssi,
        Self::Fault,
    ];

    const fn title(self) -> &'static str {
        match self {
            Self::Node => "Node",
            Self::State => "State",
            Self::Job => "Job",
            Self::Queue => "Queue",
            Self::Position => "Position (steps)",
            Self::Speed => "Speed (steps/s)",
            Self::Clock => "Clock",
            Self::Rssi => "RSSI",
            Self::Fault => "Last fault",
            Self::Heard => "Heard",
        }
    }

    const fn hint(self) -> &'static str {
        match self {
            Self::Node => "name",
            Self::State => "what it does, or why somebody should look at it",
            Self::Job => "its job, and how many commands of it have ended",
            Self::Queue => "commands waiting, and how many more fit",
            Self::Position => "steps of each axis",
            Self::Speed => "steps per second of each axis",
            Self::Clock => "offset of the node's clock ± how far that may be wrong",
            Self::Rssi => "signal strength",
            Self::Fault => "last fault since its boot",
            Self::Heard => "time since it was heard of",
        }
    }

    const fn width(self) -> f32 {
        match self {
            Self::Node => 140.0,
            Self::State => 90.0,
            Self::Job | Self::Fault => 175.0,
            Self::Queue => 80.0,
            Self::Position | Self::Clock | Self::Speed => 150.0,
            Self::Rssi => 65.0,
            Self::Heard => 60.0,
        }
    }
}

/// What the panel remembers.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(default)]
pub struct FleetView {
    /// What a row must contain; with `*` a key expression that its name must match.
    pub filter: String,
    /// The saved filter that is applied too.
    pub group: Option<String>,
    /// Key expressions with a name of their own.
    pub saved: Vec<String>,
    /// The one being typed.
    #[serde(skip)]
    pub new_group: String,
    /// By what rows are sorted.
    pub sort: Column,
    /// Largest first.
    pub descending: bool,
    /// Nodes that need somebody come first.
    pub alarms_first: bool,
    /// The filter wants the keyboard.
    #[serde(skip)]
    pub take_focus: bool,
}

impl Default for FleetView {
    fn default() -> Self {
        Self {
            filter: String::new(),
            group: None,
            saved: Vec::new(),
            new_group: String::new(),
            sort: Column::Node,
            descending: false,
            alarms_first: true,
            take_focus: false,
        }
    }
}

/// Returns the nodes that pass the filters, in order.
pub fn shown<'m>(model: &'m Model, view: &View) -> Vec<&'m Node> {
    let fleet = &view.fleet;
    let group = fleet
        .group
        .as_deref()
        .and_then(|group| Pattern::new(group).ok());
    let pattern = fleet
        .filter
        .contains('*')
        .then(|| Pattern::new(fleet.filter.trim()).ok())
        .flatten();
    let words = fleet.filter.trim().to_lowercase();
    let mut nodes: Vec<(Option<Concern>, &Node)> = model
        .nodes()
        .filter(|node| {
            let of_group = group.as_ref();
            of_group.is_none_or(|group| group.matches(node.id().as_str()))
        })
        .filter(|node| match &pattern {
            Some(pattern) => pattern.matches(node.id().as_str()),
            None => words.is_empty() || contains(model, node, &words),
        })
        .map(|node| (model.concern(node), node))
        .collect();
    nodes.sort_by(|(concern_a, a), (concern_b, b)| {
        let rank = |concern: &Option<Concern>| concern.map_or(u8::MAX, |concern| concern as u8);
        let alarms = rank(concern_a).cmp(&rank(concern_b));
        let by_column = order(model, fleet.sort, a, b);
        let by_column = if fleet.descending {
            by_column.reverse()
        } else {
            by_column
        };
        let first = if fleet.alarms_first {
            alarms
        } else {
            Ordering::Equal
        };
        first.then(by_column).then_with(|| a.id().cmp(&b.id()))
    });
    nodes.into_iter().map(|(_, node)| node).collect()
}

fn contains(model: &Model, node: &Node, words: &str) -> bool {
    let concern = model
        .concern(node)
        .map(|concern| theme::concern_badge(concern).word);
    node.id().as_str().contains(words)
        || node.word().as_str().contains(words)
        || concern.is_some_and(|concern| concern.contains(words))
        || node.job().is_some_and(|job| job.as_str().contains(words))
        || node
            .last_fault()
            .is_some_and(|(_, fault)| fault.contains(words))
}

fn order(model: &Model, by: Column, a: &Node, b: &Node) -> Ordering {
    let greatest = |speeds: Vec<f64>| speeds.iter().fold(0.0, |most: f64, hz| most.max(hz.abs()));
    match by {
        Column::Node => a.id().cmp(&b.id()),
        Column::State => {
            (model.concern(a), a.word().as_str()).cmp(&(model.concern(b), b.word().as_str()))
        }
        Column::Job => a.job().cmp(&b.job()),
        Column::Queue => a.queue().cmp(&b.queue()),
        Column::Position => a.positions_steps().cmp(&b.positions_steps()),
        Column::Speed => greatest(a.speeds_hz()).total_cmp(&greatest(b.speeds_hz())),
        Column::Clock => {
            let error = |node: &Node| node.clock().map_or(f64::INFINITY, |clock| clock.error_us);
            error(a).total_cmp(&error(b))
        }
        Column::Rssi => a.rssi_dbm().cmp(&b.rssi_dbm()),
        Column::Fault => a.last_fault().cmp(&b.last_fault()),
        Column::Heard => b.heard_at().cmp(&a.heard_at()),
    }
}

/// Shows filter and table.
pub fn fleet_ui(ui: &mut Ui, model: &Model, view: &mut View) {
    let rows: Vec<&Node> = shown(model, view);
    ui.horizontal_wrapped(|ui| {
        let label = ui.label("Filter nodes");
        let edit = TextEdit::singleline(&mut view.fleet.filter)
            .hint_text("word, state, job, or cell-a-$*")
            .desired_width(220.0);
        let edit = ui.add(edit).labelled_by(label.id);
        if std::mem::take(&mut view.fleet.take_focus) {
            edit.request_focus();
        }
        ui.checkbox(&mut view.fleet.alarms_first, "Alarms first");
        let of = text::count(model.nodes().count(), "node");
        let words = format!("{} of {of}", rows.len());
        ui.label(theme::toned(ui, Tone::Quiet, words));
    });
    if let Some(why) = bad_pattern(&view.fleet.filter) {
        ui.label(theme::toned(ui, Tone::Warn, format!("⚠ {why}")));
    }
    if rows.is_empty() {
        empty_ui(ui, model);
        return;
    }
    let columns = Column::ALL.map(|column| {
        egui_table::Column::new(column.width())
            .range(40.0..=600.0)
            .id(egui::Id::unique(column.title()))
    });
    let row_count = rows.len() as u64;
    let mut rows = Rows { model, view, rows };
    Table::new()
        .id_salt("fleet")
        .num_rows(row_count)
        .columns(columns)
        .num_sticky_cols(1)
        .headers([HeaderRow::new(theme::ROW_HEIGHT + 2.0)])
        .show(ui, &mut rows);
}

fn bad_pattern(filter: &str) -> Option<String> {
    filter
        .contains('*')
        .then(|| Pattern::new(filter.trim()).err())
        .flatten()
}

fn empty_ui(ui: &mut Ui, model: &Model) {
    let link = model.link();
    let words = if model.nodes().next().is_some() {
        "no node passes the filter".to_owned()
    } else if link.is_up() {
        "no node is known yet: switch one on, or start `emulator --nodes 3`".to_owned()
    } else {
        let why = link.why().unwrap_or("not connected yet");
        // Where somebody answers and says no, another gateway is no help.
        match link.why().is_none() || why.contains("nothing answers") {
            true => format!(
                "{why}. Start a gateway: `fleet serve`, or connect elsewhere with --connect."
            ),
            false => format!("{why}."),
        }
    };
    ui.vertical_centered(|ui| {
        ui.add_space(24.0);
        ui.label(theme::toned(ui, Tone::Quiet, words));
    });
}

struct Rows<'a> {
    model: &'a Model,
    view: &'a mut View,
    rows: Vec<&'a Node>,
}

impl TableDelegate for Rows<'_> {
    fn header_cell_ui(&mut self, ui: &mut Ui, cell: &HeaderCellInfo) {
        let column = Column::ALL[cell.col_range.start];
        if ui.is_sizing_pass() {
            // The table measures once, before anything is there: a column is as wide as it says.
            ui.set_min_width(column.width());
            return;
        }
        let fleet = &mut self.view.fleet;
        let mark = match (fleet.sort == column, fleet.descending) {
            (false, _) => "",
            (true, false) => " ⏶",
            (true, true) => " ⏷",
        };
        let title = RichText::new(format!("{}{mark}", column.title())).strong();
        let button = egui::Frame::new()
            .inner_margin(Margin::symmetric(4, 2))
            .show(ui, |ui| {
                super::table::keep_in_sight(ui);
                ui.add(egui::Button::new(title).frame(false).truncate())
            })
            .inner;
        theme::named(
            &button,
            Role::Button,
            &format!("Sort by {}", column.title()),
        );
        if button.on_hover_text(column.hint()).clicked() {
            fleet.descending = fleet.sort == column && !fleet.descending;
            fleet.sort = column;
        }
    }

    fn row_ui(&mut self, ui: &mut Ui, row_nr: u64) {
        let Some(node) = self.rows.get(row_nr as usize) else {
            return;
        };
        let rect = ui.max_rect();
        self.view.composer.drop_on(ui, rect, node.id());
        let visuals = ui.visuals();
        if self.view.selection.contains(&node.id()) || self.view.focus == Some(node.id()) {
            let fill = visuals.selection.bg_fill.gamma_multiply(0.4);
            ui.painter().rect_filled(rect, 0.0, fill);
        } else if row_nr % 2 == 1 {
            ui.painter().rect_filled(rect, 0.0, visuals.faint_bg_color);
        }
    }

    fn cell_ui(&mut self, ui: &mut Ui, cell: &CellInfo) {
        let Some(node) = self.rows.get(cell.row_nr as usize).copied() else {
            return;
        };
        let column = Column::ALL[cell.col_nr];
        if ui.is_sizing_pass() {
            ui.set_min_width(column.width());
            return;
        }
        egui::Frame::new()
            .inner_margin(Margin::symmetric(4, 2))
            .show(ui, |ui| {
                super::table::keep_in_sight(ui);
                ui.set_min_size(ui.available_size());
                match column {
                    Column::Node => self.name_ui(ui, node),
                    _ => cell_text_ui(ui, self.model, node, column),
                }
            });
    }

    fn default_row_height(&self) -> f32 {
        theme::ROW_HEIGHT
    }
}

impl Rows<'_> {
    fn name_ui(&mut self, ui: &mut Ui, node: &Node) {
        let id = node.id();
        let selected = self.view.selection.contains(&id);
        ui.horizontal(|ui| {
            ui.spacing_mut().item_spacing.x = 3.0;
            let mut ticked = selected;
            let tick = ui.add(egui::Checkbox::without_text(&mut ticked));
            tick.widget_info(|| {
                let name = format!("Select {id}");
                egui::WidgetInfo::selected(Role::CheckBox, true, ticked, name)
            });
            if tick.changed() {
                toggle(&mut self.view.selection, id);
            }
            let chosen = self.view.focus == Some(id) || selected;
            let label = egui::Button::selectable(chosen, id.as_str());
            if ui.add(label.truncate()).clicked() {
                if ui.input(|input| input.modifiers.command) {
                    toggle(&mut self.view.selection, id);
                } else {
                    self.view.focus = (self.view.focus != Some(id)).then_some(id);
                    self.view.selection = std::iter::once(id).collect();
                }
            }
        });
    }
}

fn toggle(selection: &mut std::collections::BTreeSet<NodeId>, id: NodeId) {
    if !selection.remove(&id) {
        selection.insert(id);
    }
}

fn cell_text_ui(ui: &mut Ui, model: &Model, node: &Node, column: Column) {
    let text = match column {
        Column::State => match model.concern(node) {
            Some(concern) => theme::concern_badge(concern).text(ui),
            None => theme::node_badge(node.word()).text(ui),
        },
        Column::Heard => {
            let age_s = model.now().since_s(node.heard_at());
            let stale = model.concern(node) == Some(Concern::Silent);
            let tone = if stale { Tone::Warn } else { Tone::Quiet };
            theme::toned(ui, tone, text::age(age_s))
        }
        Column::Fault => {
            let fault = node.last_fault();
            let words = fault.map(|(code, words)| format!("✖ {code} {words}"));
            theme::toned(ui, Tone::Bad, words.unwrap_or_default())
        }
        _ => RichText::new(words(model, node, column)),
    };
    // What a node that is gone or silent said last is old; without a link, everything is.
    let old = !model.is_fresh(node) && !matches!(column, Column::State | Column::Heard);
    let text = match old || !model.link().is_up() {
        true => theme::aged(ui, text),
        false => text,
    };
    let numbers = matches!(column, Column::Position | Column::Speed | Column::Queue);
    let text = if numbers { text.monospace() } else { text };
    ui.add(egui::Label::new(text).truncate());
}

/// Returns the job, how much of it is done, and whether it is held or at another speed.
fn job_words(model: &Model, node: &Node) -> String {
    let mut words = Vec::new();
    if let Some(job) = node.job() {
        words.push(job.to_string());
        let progress = model.jobs().get(&job).map(|record| record.progress);
        if let Some(progress) = progress.filter(|progress| progress.total > 0) {
            words.push(format!("{}/{}", progress.done, progress.total));
        }
    }
    words.extend(node.pace().map(text::pace));
    words.join(" ")
}

fn words(model: &Model, node: &Node, column: Column) -> String {
    match column {
        Column::Job => job_words(model, node),
        Column::Queue => node.queue().map_or(String::new(), |(depth, free)| {
            format!("{depth}/{}", depth + free)
        }),
        Column::Position => text::positions(&node.positions_steps()),
        Column::Speed => text::speeds(&node.speeds_hz()),
        Column::Clock => match node.clock() {
            Some(clock) => text::clock(&clock),
            None if node.is_there() => "unknown".to_owned(),
            None => String::new(),
        },
        Column::Rssi => node
            .rssi_dbm()
            .map_or("–".to_owned(), |rssi_dbm| format!("{rssi_dbm} dBm")),
        Column::Node | Column::State | Column::Fault | Column::Heard => String::new(),
    }
}
