//! What a job would do: how long, how far, and the way of the first two axes that move,
//! the first one to the right.

use crate::{
    estimate::Estimate,
    text,
    theme::{self, Tone},
};
use egui::Ui;
use egui_plot::{Line, Plot, PlotPoints};

/// Least height of the path, points; where there is less room, it is scrolled.
const PATH_HEIGHT_MIN: f32 = 80.0;

/// Least height of a path that has room for the names of its axes, points.
const NAMED_HEIGHT_MIN: f32 = 130.0;

/// Shows an estimate.
pub(super) fn preview_ui(ui: &mut Ui, estimate: &Estimate) {
    egui::ScrollArea::vertical()
        .id_salt("preview")
        .auto_shrink(false)
        .show(ui, |ui| {
            facts_and_path_ui(ui, estimate);
        });
}

fn facts_and_path_ui(ui: &mut Ui, estimate: &Estimate) {
    ui.horizontal_wrapped(|ui| {
        ui.label(format!(
            "Estimate: {}",
            text::micros(estimate.duration_s * 1e6)
        ));
        if estimate.open_ended > 0 {
            let count = text::count(estimate.open_ended, "command");
            let words = format!("⚠ and what {count} of unknown length take");
            ui.label(theme::toned(ui, Tone::Warn, words));
        }
    });
    let moving: Vec<usize> = (0..estimate.reach.len())
        .filter(|axis| estimate.reach[*axis].moves)
        .collect();
    if moving.is_empty() {
        ui.label(theme::toned(ui, Tone::Quiet, "nothing moves"));
        return;
    }
    ui.spacing_mut().item_spacing.y = 1.0;
    for axis in &moving {
        let reach = estimate.reach[*axis];
        let words = format!(
            "axis {axis}: {} to {}, travel {} steps",
            text::steps(reach.least_steps),
            text::steps(reach.most_steps),
            text::steps(i64::try_from(reach.travel_steps).unwrap_or(i64::MAX))
        );
        ui.label(egui::RichText::new(words).small());
    }
    // One axis alone is drawn over the order of its commands.
    let (x, y) = (moving[0], moving.get(1).copied());
    let color = theme::axis_color(ui, 0);
    let mut plot = Plot::new("job path");
    if y.is_some() {
        plot = plot.data_aspect(1.0);
    }
    let height = ui.available_height().max(PATH_HEIGHT_MIN);
    if height >= NAMED_HEIGHT_MIN {
        plot = plot
            .x_axis_label(match y {
                Some(_) => format!("axis {x}, steps"),
                None => "commands".to_owned(),
            })
            .y_axis_label(format!("axis {}, steps", y.unwrap_or(x)));
    }
    plot.height(height).allow_scroll(false).show(ui, |plot| {
        let mut count = 0;
        for (number, line) in estimate.lines.iter().enumerate() {
            let points = line.iter().map(|at| {
                count += 1_u32;
                match y {
                    Some(y) => [at[x] as f64, at[y] as f64],
                    None => [f64::from(count - 1), at[x] as f64],
                }
            });
            let points: PlotPoints<'_> = points.collect();
            plot.line(Line::new(format!("part {number}"), points).color(color));
        }
    });
}
