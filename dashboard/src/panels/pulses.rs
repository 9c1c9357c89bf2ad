//! The pulse inspector: recorded pins as a timeline, what is measured under the pointer, and where
//! the rules of a driver are broken.

use super::chooser::Purpose;
use crate::{
    model::capture,
    model::capture::{
        Capture, PS_PER_S,
        rules::{Findings, Limits, check},
    },
    text,
    theme::{self, Tone},
    view::View,
};
use egui::{Color32, DragValue, Role, ScrollArea, TextEdit, Ui};
use egui_plot::{Line, MarkerShape, Plot, PlotBounds, PlotPoints, Points};
use serde::{Deserialize, Serialize};
use std::sync::Arc;

/// Height of one signal's lane in the plot's units; its line is one unit high.
const LANE: f64 = 1.5;

/// Width of the list of violations, points.
const LIST_WIDTH: f32 = 370.0;

/// Picoseconds in a microsecond: the timeline's unit is 1 µs.
const PS_PER_US: f64 = PS_PER_S / 1e6;

/// Violations that are marked at the same time.
const MARKS_MAX: usize = 500;

/// What the panel remembers.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
#[serde(default)]
pub struct PulsesView {
    /// The file's name as typed.
    pub path: String,
    /// The least times that are checked.
    pub limits: Limits,
    /// Whether the file is to be opened.
    #[serde(skip)]
    pub open_wanted: bool,
    /// Where the pointer is, ps.
    #[serde(skip)]
    pub cursor_ps: Option<u64>,
    #[serde(skip)]
    opened: Opened,
    /// Where the timeline is to go, ps.
    #[serde(skip)]
    go_to_ps: Option<(u64, u64)>,
}

#[derive(Clone, Debug, Default)]
enum Opened {
    #[default]
    Nothing,
    Opening,
    Failed(String),
    Capture(Box<Shown>),
}

#[derive(Clone, Debug)]
struct Shown {
    name: String,
    capture: Arc<Capture>,
    checked: Limits,
    findings: Findings,
}

impl PulsesView {
    /// Takes that the file is being read.
    pub fn opening(&mut self) {
        self.opened = Opened::Opening;
    }

    /// Takes what was read of the file of this name.
    pub fn opened(&mut self, name: String, capture: Result<Arc<Capture>, String>) {
        self.cursor_ps = None;
        self.opened = match capture {
            Ok(capture) => {
                self.go_to_ps = Some((0, capture.end_ps));
                let findings = check(&capture, &self.limits);
                Opened::Capture(Box::new(Shown {
                    name,
                    capture,
                    checked: self.limits,
                    findings,
                }))
            }
            Err(why) => Opened::Failed(format!("{name}: {why}")),
        };
    }
}

/// Shows the inspector.
pub fn pulses_ui(ui: &mut Ui, view: &mut View) {
    let choose = open_ui(ui, &mut view.pulses);
    if choose {
        view.chooser.open(Purpose::Capture, &view.pulses.path);
    }
    let view = &mut view.pulses;
    let PulsesView {
        limits,
        opened,
        cursor_ps,
        go_to_ps,
        ..
    } = view;
    let shown = match opened {
        Opened::Nothing => {
            let words = "The pins of an emulated node (emulator --vcd FILE) or of a logic \
                         analyser (.vcd, .csv with columns such as time, step0, dir0). \
                         A file can also be dropped onto the window.";
            ui.label(theme::toned(ui, Tone::Quiet, words));
            return;
        }
        Opened::Opening => {
            ui.label("⌛ reading…");
            return;
        }
        Opened::Failed(why) => {
            let words = theme::toned(ui, Tone::Bad, format!("✖ {why}"));
            ui.add(egui::Label::new(words).wrap());
            return;
        }
        Opened::Capture(shown) => shown,
    };
    limits_ui(ui, limits);
    if shown.checked != *limits {
        (shown.checked, shown.findings) = (*limits, check(&shown.capture, limits));
    }
    ui.horizontal_top(|ui| {
        let height = ui.available_height();
        let width = (ui.available_width() - LIST_WIDTH - 12.0).max(200.0);
        ui.allocate_ui(egui::vec2(width, height), |ui| {
            *cursor_ps = timeline_ui(ui, shown, go_to_ps.take());
        });
        ui.separator();
        ui.vertical(|ui| {
            // Beside the timeline, so that it does not move under the pointer.
            readings_ui(ui, shown, *cursor_ps);
            let wanted = verdict_ui(ui, shown);
            *go_to_ps = go_to_ps.or(wanted).or(findings_ui(ui, shown));
        });
    });
}

/// Shows which file is open, and returns whether one is to be chosen.
fn open_ui(ui: &mut Ui, view: &mut PulsesView) -> bool {
    let mut choose = false;
    ui.horizontal_wrapped(|ui| {
        let label = ui.label("Capture");
        let edit = TextEdit::singleline(&mut view.path)
            .hint_text("left.vcd")
            .desired_width(320.0);
        let edit = ui.add(edit).labelled_by(label.id);
        let entered = edit.lost_focus() && ui.input(|input| input.key_pressed(egui::Key::Enter));
        let there = !view.path.trim().is_empty();
        let open = ui.add_enabled(there, egui::Button::new("Open capture"));
        if there && (open.clicked() || entered) {
            view.open_wanted = true;
        }
        choose = ui.button("Choose capture…").clicked();
        if let Opened::Capture(shown) = &view.opened {
            let file = shown.name.rsplit(['/', '\\']).next().unwrap_or_default();
            let words = format!(
                "{file}: {}, {} edges, {}",
                text::count(shown.capture.axes.len(), "axis").replace("axiss", "axes"),
                shown.capture.edge_count(),
                text::micros(shown.capture.end_ps as f64 / PS_PER_US)
            );
            ui.label(words);
            if shown.capture.other_signals > 0 {
                let words = format!(
                    "{} left out",
                    text::count(shown.capture.other_signals, "other signal")
                );
                ui.label(theme::toned(ui, Tone::Quiet, words));
            }
        }
    });
    choose
}

fn limits_ui(ui: &mut Ui, limits: &mut Limits) {
    ui.horizontal_wrapped(|ui| {
        ui.label("At least, ns:");
        for (name, value) in [
            ("step high", &mut limits.high_min_ns),
            ("step low", &mut limits.low_min_ns),
            ("direction before step", &mut limits.setup_min_ns),
            ("direction after step", &mut limits.hold_min_ns),
        ] {
            let label = ui.label(name);
            ui.add(DragValue::new(value).range(0..=1_000_000).speed(10.0))
                .labelled_by(label.id);
        }
        if ui.button("Defaults").clicked() {
            *limits = Limits::default();
        }
    });
}

/// Shows what is measured at the pointer, an axis a line.
fn readings_ui(ui: &mut Ui, shown: &Shown, cursor_ps: Option<u64>) {
    let Some(at_ps) = cursor_ps else {
        let words = "point at the timeline to measure · drag: pan · wheel: zoom · \
                     right drag: zoom to a box · double click: all";
        let words = theme::toned(ui, Tone::Quiet, words).small();
        ui.add(egui::Label::new(words).wrap());
        return;
    };
    ui.label(format!("at {:.3} µs:", at_ps as f64 / PS_PER_US));
    for axis in &shown.capture.axes {
        let reading = axis.reading(at_ps);
        let mut words = format!("axis {}: {} steps", axis.name, reading.position_steps);
        match (reading.interval_s, reading.speed_hz) {
            (Some(interval_s), Some(speed_hz)) => {
                words += &format!(
                    ", interval {:.4} µs, {speed_hz:.1} steps/s",
                    interval_s * 1e6
                );
            }
            _ => words += ", between no two steps",
        }
        if let Some(acceleration) = reading.acceleration_hz2 {
            words += &format!(", {acceleration:.0} steps/s²");
        }
        ui.label(theme::toned(ui, Tone::Plain, words).small());
    }
}

/// Shows the lanes and returns where the pointer is, ps.
fn timeline_ui(ui: &mut Ui, shown: &Shown, go_to_ps: Option<(u64, u64)>) -> Option<u64> {
    let capture = &*shown.capture;
    let lanes: Vec<(String, &[capture::Edge], Color32)> = capture
        .axes
        .iter()
        .enumerate()
        .flat_map(|(index, axis)| {
            let color = theme::axis_color(ui, index);
            [
                (format!("step {}", axis.name), &axis.step_edges[..], color),
                (
                    format!("dir {}", axis.name),
                    &axis.direction_edges[..],
                    color,
                ),
            ]
        })
        .collect();
    let lane_count = lanes.len();
    // The first axis is on top.
    let base = |lane: usize| (lane_count - 1 - lane) as f64 * LANE;
    let names: Vec<String> = lanes.iter().map(|(name, ..)| name.clone()).collect();
    let bad = Tone::Bad.color(ui);
    let columns = ui.available_width().max(100.0) as usize;
    let end_us = capture.end_ps as f64 / PS_PER_US;
    let height = (ui.available_height() - 4.0).max(90.0);
    let plot = Plot::new("timeline")
        .height(height)
        .allow_zoom([true, false])
        .allow_scroll(false)
        .allow_drag([true, false])
        .show_grid([true, false])
        .y_axis_min_width(52.0)
        .x_axis_formatter(|mark, _| axis_mark(mark.value, mark.step_size))
        .y_grid_spacer(move |_| {
            let lane_marks = (0..lane_count).map(|lane| egui_plot::GridMark {
                value: base(lane) + 0.5,
                // As large as this, so that the names are drawn however low the lanes are.
                step_size: 100.0,
            });
            lane_marks.collect()
        })
        .y_axis_formatter(move |mark, _| {
            let lane = (0..lane_count).find(|lane| (base(*lane) + 0.5 - mark.value).abs() < 0.1);
            lane.map_or_else(String::new, |lane| names[lane].clone())
        })
        .label_formatter(|_| None)
        .default_x_bounds(0.0, end_us)
        .default_y_bounds(-0.5, lane_count as f64 * LANE)
        .show(ui, |plot| {
            if let Some((from_ps, to_ps)) = go_to_ps {
                let x = [from_ps as f64 / PS_PER_US, to_ps as f64 / PS_PER_US];
                let top = lane_count as f64 * LANE;
                plot.set_plot_bounds(PlotBounds::from_min_max([x[0], -0.5], [x[1], top]));
            }
            let hovered = plot.response().hovered();
            let turned = plot.ctx().input(|input| input.smooth_scroll_delta().y);
            if hovered && turned != 0.0 {
                plot.zoom_bounds_around_hovered(egui::vec2((turned / 200.0).exp(), 1.0));
            }
            let bounds = plot.plot_bounds();
            let ps = |us: f64| (us * PS_PER_US).clamp(0.0, capture.end_ps as f64) as u64;
            let (from_ps, to_ps) = (ps(bounds.min()[0]), ps(bounds.max()[0]));
            for (lane, (name, edges, color)) in lanes.into_iter().enumerate() {
                let corners = capture::corners(edges, from_ps, to_ps, columns);
                let corners = corners.into_iter().map(|(at_ps, high)| {
                    [
                        at_ps as f64 / PS_PER_US,
                        base(lane) + f64::from(u8::from(high)),
                    ]
                });
                let points: PlotPoints<'_> = corners.collect();
                // A band of points a pixel apart would be a slope, not an edge.
                let line = Line::new(name, points).allow_band(false);
                plot.line(line.color(color).width(1.2));
            }
            let listed = &shown.findings.listed;
            let first = listed.partition_point(|found| found.at_ps < from_ps);
            let in_sight = listed[first..]
                .iter()
                .take_while(|found| found.at_ps <= to_ps);
            let judged = shown.capture.verdict.iter().flat_map(|it| &it.found);
            let judged = judged.filter_map(|(at_ps, _)| *at_ps);
            let top = (lane_count - 1) as f64 * LANE + 1.2;
            let judged = judged.filter(|at_ps| (from_ps..=to_ps).contains(at_ps));
            let judged: PlotPoints<'_> = judged
                .map(|at_ps| [at_ps as f64 / PS_PER_US, top])
                .collect();
            let judged = Points::new("found by the oracle", judged).shape(MarkerShape::Cross);
            plot.points(judged.color(bad).radius(6.0));
            let marks: PlotPoints<'_> = in_sight
                .take(MARKS_MAX)
                .map(|found| [found.at_ps as f64 / PS_PER_US, base(2 * found.axis) + 1.15])
                .collect();
            let marks = Points::new("violation", marks).shape(MarkerShape::Down);
            plot.points(marks.color(bad).radius(5.0));
            let pointer = plot.pointer_coordinate().filter(|_| hovered)?;
            (0.0..=end_us).contains(&pointer.x).then(|| ps(pointer.x))
        });
    theme::named(&plot.response, Role::Image, "Timeline of the pins");
    plot.inner
}

/// Returns a time on the axis with as many digits as the marks' distance wants.
fn axis_mark(at_us: f64, step_us: f64) -> String {
    match step_us {
        1e5.. => format!("{:.1} s", at_us / 1e6),
        100.0.. => format!("{:.1} ms", at_us / 1e3),
        1.0.. => format!("{at_us:.0} µs"),
        _ => format!("{at_us:.2} µs"),
    }
}

/// Height of the oracle's list, points; the rest is scrolled.
const VERDICT_HEIGHT: f32 = 90.0;

/// Half of the time that is shown around what the oracle found, ps.
const AROUND_PS: u64 = 100_000_000;

/// Shows what the oracle found, and returns where the operator wants to look, ps.
fn verdict_ui(ui: &mut Ui, shown: &Shown) -> Option<(u64, u64)> {
    let Some(verdict) = &shown.capture.verdict else {
        let words = "○ no oracle judged this file: `emulator --vcd … --check` does";
        let words = theme::toned(ui, Tone::Quiet, words);
        ui.add(egui::Label::new(words).wrap());
        return None;
    };
    if verdict.cut {
        let words = "⚠ the end was not judged: the record was full";
        ui.label(theme::toned(ui, Tone::Warn, words));
    }
    if verdict.found.is_empty() {
        let judged = verdict.good.as_deref().unwrap_or_default();
        let words = format!("✔ the oracle found nothing wrong: {judged}");
        let words = theme::toned(ui, Tone::Good, words);
        ui.add(egui::Label::new(words).wrap());
        return None;
    }
    let count = text::count(verdict.found.len(), "violation");
    let words = format!("✖ {count} found by the oracle");
    ui.label(theme::toned(ui, Tone::Bad, words));
    let mut wanted = None;
    ScrollArea::vertical()
        .id_salt("verdict")
        .max_height(VERDICT_HEIGHT)
        .auto_shrink([false, true])
        .show(ui, |ui| {
            for (at_ps, message) in &verdict.found {
                let Some(at_ps) = *at_ps else {
                    ui.label(theme::toned(ui, Tone::Bad, message));
                    continue;
                };
                let words = format!("{:.3} µs: {message}", at_ps as f64 / PS_PER_US);
                let words = theme::toned(ui, Tone::Bad, words);
                let button = egui::Button::new(words).frame(false).wrap();
                if ui.add(button).on_hover_text("Show it").clicked() {
                    let from_ps = at_ps.saturating_sub(AROUND_PS);
                    wanted = Some((from_ps, at_ps.saturating_add(AROUND_PS)));
                }
            }
        });
    wanted
}

/// Lists what was found and returns where the operator wants to look, ps.
fn findings_ui(ui: &mut Ui, shown: &Shown) -> Option<(u64, u64)> {
    let Findings { listed, count } = &shown.findings;
    if *count == 0 {
        let words = "✔ no time is too short";
        ui.label(theme::toned(ui, Tone::Good, words));
        return None;
    }
    let total = usize::try_from(*count).unwrap_or(usize::MAX);
    let words = format!("✖ {} of the rules", text::count(total, "violation"));
    ui.label(theme::toned(ui, Tone::Bad, words));
    if listed.len() < total {
        let words = format!("the first {} are listed", listed.len());
        ui.label(theme::toned(ui, Tone::Quiet, words));
    }
    let mut wanted = None;
    let height = ui.spacing().interact_size.y;
    ScrollArea::vertical()
        .auto_shrink(false)
        .show_rows(ui, height, listed.len(), |ui, rows| {
            for found in &listed[rows] {
                let axis = &shown.capture.axes[found.axis].name;
                let at_us = found.at_ps as f64 / PS_PER_US;
                let (was_ns, least_ns) = (found.was_ps as f64 / 1e3, found.least_ps / 1_000);
                // The numbers first: the end of a long line may be cut off.
                let words = format!(
                    "{at_us:.3} µs axis {axis}: {was_ns:.1} of {least_ns} ns, {}",
                    found.rule.as_str()
                );
                let hint = format!("{words}\nClick: show it");
                let words = theme::toned(ui, Tone::Bad, words);
                let button = egui::Button::new(words).frame(false).truncate();
                if ui.add(button).on_hover_text(hint).clicked() {
                    let around_ps = 10 * found.least_ps.max(1_000);
                    let from_ps = found.at_ps.saturating_sub(around_ps);
                    wanted = Some((from_ps, found.at_ps.saturating_add(around_ps)));
                }
            }
        });
    wanted
}
