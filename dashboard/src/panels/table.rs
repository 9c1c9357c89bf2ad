//! A table of records with fixed columns; only the rows in sight are drawn.

use crate::theme;
use egui::{Label, Margin, RichText, Ui};
use egui_table::{CellInfo, Column, HeaderCellInfo, HeaderRow, Table, TableDelegate};

/// Title and first width, points, of each column.
pub(super) type Columns = [(&'static str, f32)];

/// Shows a row for each record. `cell` returns the text of the column of this index, or `None` if
/// it has shown something else there.
pub(super) fn table_ui<R>(
    ui: &mut Ui,
    name: &str,
    columns: &Columns,
    records: &[R],
    cell: impl FnMut(&mut Ui, &R, usize) -> Option<RichText>,
) {
    let mut rows = Rows {
        columns,
        records,
        cell,
    };
    let widths = columns.iter().map(|(_, width)| Column::new(*width));
    let widths: Vec<Column> = widths.map(|column| column.range(40.0..=900.0)).collect();
    Table::new()
        .id_salt(name)
        .num_rows(records.len() as u64)
        .columns(widths)
        .num_sticky_cols(1)
        .headers([HeaderRow::new(theme::ROW_HEIGHT)])
        .show(ui, &mut rows);
}

/// Lets a cell at the edge of the table be cut with dots: half of a number is another number.
pub(super) fn keep_in_sight(ui: &mut Ui) {
    let in_sight = ui.clip_rect().right() - ui.max_rect().left();
    if in_sight < ui.available_width() {
        ui.set_max_width(in_sight.max(0.0));
    }
}

struct Rows<'a, R, F> {
    columns: &'a Columns,
    records: &'a [R],
    cell: F,
}

impl<R, F> TableDelegate for Rows<'_, R, F>
where
    F: FnMut(&mut Ui, &R, usize) -> Option<RichText>,
{
    fn header_cell_ui(&mut self, ui: &mut Ui, cell: &HeaderCellInfo) {
        let (title, width) = self.columns[cell.col_range.start];
        if ui.is_sizing_pass() {
            // The table measures once, before anything is there: a column is as wide as it says.
            ui.set_min_width(width);
            return;
        }
        egui::Frame::new()
            .inner_margin(Margin::symmetric(4, 2))
            .show(ui, |ui| {
                keep_in_sight(ui);
                ui.add(Label::new(RichText::new(title).strong()).truncate());
            });
    }

    fn cell_ui(&mut self, ui: &mut Ui, cell: &CellInfo) {
        let Some(record) = self.records.get(cell.row_nr as usize) else {
            return;
        };
        if ui.is_sizing_pass() {
            ui.set_min_width(self.columns[cell.col_nr].1);
            return;
        }
        egui::Frame::new()
            .inner_margin(Margin::symmetric(4, 2))
            .show(ui, |ui| {
                keep_in_sight(ui);
                if let Some(text) = (self.cell)(ui, record, cell.col_nr) {
                    ui.add(Label::new(text).truncate());
                }
            });
    }

    fn default_row_height(&self) -> f32 {
        theme::ROW_HEIGHT
    }
}
