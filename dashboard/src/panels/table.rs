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
        ui.label(RichText::new(title).strong());
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
                if let Some(text) = (self.cell)(ui, record, cell.col_nr) {
                    ui.add(Label::new(text).truncate());
                }
            });
    }

    fn default_row_height(&self) -> f32 {
        theme::ROW_HEIGHT
    }
}
