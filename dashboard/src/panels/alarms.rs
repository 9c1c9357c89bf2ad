//! What needed somebody, newest first, each with what became of it, and who has seen it.

use crate::{
    model::{Model, alarms::Alarm},
    request::{Request, Requests},
    text,
    theme::{self, Badge, Tone},
    view::View,
};
use egui::{Margin, RichText, Ui, UserAttentionType, ViewportCommand};
use egui_table::{CellInfo, Column, HeaderCellInfo, HeaderRow, Table, TableDelegate};
use serde::{Deserialize, Serialize};

/// What the panel remembers.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
#[serde(default)]
pub struct AlarmsView {
    /// Shows those too that are over and acknowledged.
    pub show_past: bool,
    /// Asks the desktop to mark this window when there is a new alarm.
    pub attention: bool,
    /// The latest alarm for which that was done.
    #[serde(skip)]
    called_for: u64,
}

/// Marks the window in the task bar when there is a new alarm, if the operator wants that.
pub fn call_for_attention(ui: &Ui, model: &Model, view: &mut View) {
    let latest = model.alarms().latest();
    let is_new = std::mem::replace(&mut view.alarms.called_for, latest) < latest;
    if is_new && view.alarms.attention {
        let attention = ViewportCommand::RequestUserAttention(UserAttentionType::Critical);
        ui.ctx().send_viewport_cmd(attention);
    }
}

/// Returns the alarms that are listed.
pub fn shown<'m>(model: &'m Model, view: &AlarmsView) -> Vec<&'m Alarm> {
    let past = |alarm: &&Alarm| alarm.over.is_some() && alarm.seen.is_some();
    let alarms = model.alarms().newest_first();
    alarms
        .filter(|alarm| view.show_past || !past(alarm))
        .collect()
}

/// Shows the list.
pub fn alarms_ui(ui: &mut Ui, model: &Model, view: &mut View, requests: &mut Requests) {
    let alarms = model.alarms();
    let rows = shown(model, &view.alarms);
    ui.horizontal_wrapped(|ui| {
        let all = egui::Button::new("Acknowledge all");
        if ui.add_enabled(alarms.unseen() > 0, all).clicked() {
            requests.push(Request::Acknowledge { alarm: None });
        }
        ui.checkbox(&mut view.alarms.show_past, "Show past");
        ui.checkbox(&mut view.alarms.attention, "Mark the window")
            .on_hover_text("Asks the desktop to mark this window when there is a new alarm");
        let words = format!(
            "{} not acknowledged, {} listed",
            alarms.unseen(),
            rows.len()
        );
        ui.label(theme::toned(ui, Tone::Quiet, words));
        if alarms.forgotten_unseen() > 0 {
            let words = format!("⚠ {} older ones did not fit", alarms.forgotten_unseen());
            ui.label(theme::toned(ui, Tone::Warn, words));
        }
    });
    if rows.is_empty() {
        ui.label(theme::toned(ui, Tone::Good, "✔ nothing needs anybody"));
        return;
    }
    let columns = WIDTHS.map(|width| Column::new(width).range(40.0..=900.0));
    let count = rows.len() as u64;
    let mut rows = Rows {
        model,
        view,
        requests,
        rows,
    };
    Table::new()
        .id_salt("alarms")
        .num_rows(count)
        .columns(columns)
        .headers([HeaderRow::new(theme::ROW_HEIGHT)])
        .show(ui, &mut rows);
}

const TITLES: [&str; 6] = ["Time (UTC)", "Node", "Alarm", "Now", "Acknowledged", "What"];
const WIDTHS: [f32; 6] = [105.0, 110.0, 90.0, 120.0, 125.0, 480.0];

struct Rows<'a> {
    model: &'a Model,
    view: &'a mut View,
    requests: &'a mut Requests,
    rows: Vec<&'a Alarm>,
}

impl TableDelegate for Rows<'_> {
    fn header_cell_ui(&mut self, ui: &mut Ui, cell: &HeaderCellInfo) {
        if ui.is_sizing_pass() {
            ui.set_min_width(WIDTHS[cell.col_range.start]);
            return;
        }
        ui.label(RichText::new(TITLES[cell.col_range.start]).strong());
    }

    fn cell_ui(&mut self, ui: &mut Ui, cell: &CellInfo) {
        let Some(alarm) = self.rows.get(cell.row_nr as usize).copied() else {
            return;
        };
        if ui.is_sizing_pass() {
            ui.set_min_width(WIDTHS[cell.col_nr]);
            return;
        }
        egui::Frame::new()
            .inner_margin(Margin::symmetric(4, 2))
            .show(ui, |ui| {
                let text = match cell.col_nr {
                    0 => RichText::new(text::time_of_day(alarm.raised)),
                    1 => return self.node_ui(ui, alarm),
                    2 => theme::alarm_badge(alarm.cause).text(ui),
                    3 => self.now_badge(alarm).text(ui),
                    4 => return self.seen_ui(ui, alarm),
                    _ => RichText::new(&alarm.text),
                };
                ui.add(egui::Label::new(text).truncate());
            });
    }

    fn default_row_height(&self) -> f32 {
        theme::ROW_HEIGHT
    }
}

impl Rows<'_> {
    fn node_ui(&mut self, ui: &mut Ui, alarm: &Alarm) {
        let Some(node) = alarm.node else { return };
        let link = ui.add(egui::Button::new(node.as_str()).frame(false));
        let name = format!("Page of {node}, alarm {}", alarm.id);
        theme::named(&link, egui::Role::Button, &name);
        if link.clicked() {
            self.view.focus = Some(node);
        }
    }

    fn now_badge(&self, alarm: &Alarm) -> Badge {
        let (icon, word, tone) = match alarm.over {
            Some(_) => ("✔", "over", Tone::Quiet),
            None if self.model.link().is_up() => ("●", "open", Tone::Bad),
            None => ("?", "unknown", Tone::Warn),
        };
        Badge { icon, word, tone }
    }

    fn seen_ui(&mut self, ui: &mut Ui, alarm: &Alarm) {
        if let Some(seen) = alarm.seen {
            let words = format!("✔ {}", text::time_of_day(seen));
            ui.label(theme::toned(ui, Tone::Quiet, words));
            return;
        }
        let button = ui.add(egui::Button::new("Acknowledge").small());
        let name = format!("Acknowledge alarm {}", alarm.id);
        theme::named(&button, egui::Role::Button, &name);
        if button.clicked() {
            let alarm = Some(alarm.id);
            self.requests.push(Request::Acknowledge { alarm });
        }
    }
}
