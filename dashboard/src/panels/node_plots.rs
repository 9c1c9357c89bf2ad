//! The plots of a node's page: motion over time, the tool's path, the clock.

use super::node::{NodeView, scrolled};
use crate::{
    model::{
        Model,
        node::{Node, Sample, TravelSample},
    },
    text,
    theme::{self, Tone},
};
use egui::{Color32, Id, Role, Ui};
use egui_plot::{Corner, HLine, Legend, Line, LineStyle, Plot, PlotPoints, Points};

/// Least height of a plot, points.
const PLOT_HEIGHT_MIN: f32 = 90.0;

/// How plots are moved.
const HINT: &str = "drag: pan · Ctrl+wheel: zoom · right drag: zoom to a box · double click: all";

/// Points of one line.
type Series = Vec<[f64; 2]>;

/// Shows position, speed and queue over time, one below the other with one cursor.
pub(super) fn motion_ui(ui: &mut Ui, model: &Model, node: &Node, view: &mut NodeView) {
    let axis_count = axis_count(node);
    if axis_count == 0 {
        ui.label("nothing to plot: this node has told no positions yet");
        return;
    }
    let now = model.now();
    let sample_s = |sample: &Sample| -now.since_s(sample.at);
    let at_cursor = view.cursor_s.and_then(|cursor_s| {
        let distance = |sample: &&Sample| (sample_s(sample) - cursor_s).abs();
        let samples = node.samples().iter();
        samples.min_by(|a, b| distance(a).total_cmp(&distance(b)))
    });
    let words = match at_cursor {
        Some(sample) => {
            let axes = || sample.axes.iter();
            let positions: Vec<i64> = axes().map(|axis| axis.position_steps).collect();
            let speeds: Vec<f64> = axes().map(|axis| f64::from(axis.speed_mhz) / 1e3).collect();
            format!(
                "{:.2} s ago: {} steps, {} steps/s, {} waiting",
                now.since_s(sample.at),
                text::positions(&positions),
                text::speeds(&speeds),
                sample.queue_depth
            )
        }
        None => "point at a plot to read its values".to_owned(),
    };
    ui.label(words);
    ui.label(theme::toned(ui, Tone::Quiet, HINT).small());
    let colors = colors(ui, axis_count);
    let of_axis = |value: &dyn Fn(&keys::AxisStatus) -> f64| -> Vec<(String, Color32, Series)> {
        let lines = colors.iter().enumerate().map(|(axis, color)| {
            let samples = node.samples().iter();
            let points = samples
                .filter_map(|sample| Some([sample_s(sample), value(sample.axes.get(axis)?)]));
            (format!("axis {axis}"), *color, points.collect())
        });
        lines.collect()
    };
    let positions = of_axis(&|axis| axis.position_steps as f64);
    let speeds = of_axis(&|axis| f64::from(axis.speed_mhz) / 1e3);
    let depths = node.samples().iter();
    let depths = depths.map(|sample| [sample_s(sample), f64::from(sample.queue_depth)]);
    let depth_color = Tone::Quiet.color(ui);
    let depths = vec![("waiting".to_owned(), depth_color, depths.collect())];
    view.cursor_s = None;
    let height = height_of_one(ui, 3);
    scrolled(ui, |ui| {
        for (title, lines) in [
            ("Position, steps", positions),
            ("Speed, steps/s", speeds),
            ("Queue, commands", depths),
        ] {
            over_time_ui(ui, node, title, height, lines, view);
        }
    });
}

/// Shows one axis over another.
pub(super) fn path_ui(ui: &mut Ui, node: &Node, view: &mut NodeView) {
    let axis_count = axis_count(node);
    if axis_count < 2 {
        ui.label("a path needs a node with two axes that has told its positions");
        return;
    }
    ui.horizontal(|ui| {
        axis_choice(ui, "Horizontal", &mut view.path_right, axis_count);
        axis_choice(ui, "Vertical", &mut view.path_up, axis_count);
    });
    ui.label(theme::toned(ui, Tone::Quiet, HINT).small());
    let (right, up) = (view.path_right, view.path_up);
    let point = |sample: &Sample| {
        let at = |axis: usize| Some(sample.axes.get(axis)?.position_steps as f64);
        Some([at(right)?, at(up)?])
    };
    let trail: Series = node.samples().iter().filter_map(point).collect();
    let burnt = laser_runs(node, point);
    let tool = trail.last().copied();
    let (color, laser) = (Tone::Busy.color(ui), Tone::Bad.color(ui));
    let tool_color = Tone::Plain.color(ui);
    let plot = Plot::new(("path", node.id().as_str()))
        .height((ui.available_height() - 4.0).max(PLOT_HEIGHT_MIN))
        .data_aspect(1.0)
        .allow_scroll(false)
        .x_axis_label(format!("axis {right}, steps"))
        .y_axis_label(format!("axis {up}, steps"))
        .legend(Legend::default().position(Corner::LeftTop))
        .show(ui, move |plot| {
            plot.line(
                Line::new("trail", trail)
                    .allow_band(false)
                    .color(color)
                    .width(1.5),
            );
            for run in burnt {
                plot.line(Line::new("laser on", run).color(laser).width(3.0));
            }
            if let Some(tool) = tool {
                let tool = Points::new("tool", vec![tool]).color(tool_color);
                plot.points(tool.radius(5.0));
            }
        });
    theme::named(&plot.response, Role::Image, "Plot of the tool's path");
}

/// Shows offset and error of the clock over time.
pub(super) fn clock_ui(ui: &mut Ui, model: &Model, node: &Node, view: &mut NodeView) {
    let Some(clock) = node.clock() else {
        ui.label("the gateway does not know this node's clock");
        return;
    };
    let drift = format!("{}, {:+.1} ppm", text::clock(&clock), clock.drift_ppm);
    ui.label(drift);
    let now = model.now();
    let travelled = node.travelled();
    ui.label(match travelled.last() {
        None => theme::toned(ui, Tone::Quiet, "round trip time: not told"),
        Some(last) => text::travel(last.rtt_us).into(),
    });
    let travels = |which: usize| -> Series {
        let point = |known: &TravelSample| [-now.since_s(known.at), known.rtt_us[which] / 1e3];
        travelled.iter().map(point).collect()
    };
    let series = |value: &dyn Fn(keys::record::ClockRecord) -> f64| -> Series {
        let clocks = node.clocks().iter();
        let points = clocks.map(|known| [-now.since_s(known.at), value(known.clock)]);
        points.collect()
    };
    // The offset as such is large and says nothing; how it moves does.
    let first_us = node
        .clocks()
        .iter()
        .next()
        .map_or(0.0, |known| known.clock.offset_us);
    let (plain, quiet) = (Tone::Busy.color(ui), Tone::Quiet.color(ui));
    let since =
        |sign: f64| series(&move |clock| clock.offset_us - first_us + sign * clock.error_us);
    let offsets = vec![
        ("offset".to_owned(), plain, since(0.0)),
        ("+ error".to_owned(), quiet, since(1.0)),
        ("− error".to_owned(), quiet, since(-1.0)),
    ];
    let errors = vec![("error".to_owned(), plain, series(&|clock| clock.error_us))];
    let travels = vec![
        ("shortest".to_owned(), plain, travels(0)),
        ("longest".to_owned(), quiet, travels(1)),
    ];
    let words = match view.cursor_s {
        Some(cursor_s) => {
            let distance = |at_s: f64| (at_s - cursor_s).abs();
            let nearest = node.clocks().iter().min_by(|a, b| {
                let of = |known: &crate::model::node::ClockSample| distance(-now.since_s(known.at));
                of(a).total_cmp(&of(b))
            });
            nearest.map_or_else(String::new, |known| {
                let age = text::age(now.since_s(known.at));
                format!("{age} ago: {}", text::clock(&known.clock))
            })
        }
        None => "point at a plot to read its values".to_owned(),
    };
    ui.label(words);
    view.cursor_s = None;
    let height = height_of_one(ui, 3);
    let title = format!("Offset, µs from {first_us:+.0} µs");
    scrolled(ui, |ui| {
        over_time_ui(ui, node, &title, height, offsets, view);
        over_time_ui(ui, node, "Error, ± µs", height, errors, view);
        over_time_ui(ui, node, "Round trip, ms", height, travels, view);
    });
}

/// Shows lines over the seconds before the present.
fn over_time_ui(
    ui: &mut Ui,
    node: &Node,
    title: &str,
    height: f32,
    lines: Vec<(String, Color32, Series)>,
    view: &mut NodeView,
) {
    ui.label(theme::toned(ui, Tone::Quiet, title));
    let group = Id::unique(("over time", node.id().as_str()));
    let zero = ui.visuals().weak_text_color();
    let shown = Plot::new((title, node.id().as_str()))
        .height(height)
        .link_axis(group, [true, false])
        .link_cursor(group, [true, false])
        .allow_scroll(false)
        .y_axis_min_width(52.0)
        .x_axis_formatter(|mark, _| format!("{:.1} s", mark.value))
        .label_formatter(|_| None)
        // The newest is at the right.
        .legend(Legend::default().position(Corner::LeftTop))
        .show(ui, |plot| {
            plot.hline(
                HLine::new("", 0.0)
                    .color(zero)
                    .style(LineStyle::dotted_dense()),
            );
            for (name, color, points) in lines {
                // A band of points a pixel apart would be a wedge where the value jumps.
                let line = Line::new(name, PlotPoints::from(points)).allow_band(false);
                plot.line(line.color(color));
            }
            let hovered = plot.response().hovered();
            plot.pointer_coordinate().filter(|_| hovered)
        });
    let name = format!("Plot of {}", title.split(',').next().unwrap_or(title));
    theme::named(&shown.response, Role::Image, &name);
    if let Some(pointer) = shown.inner {
        view.cursor_s = Some(pointer.x);
    }
}

/// Returns the parts of the path on which the laser was on.
fn laser_runs(node: &Node, point: impl Fn(&Sample) -> Option<[f64; 2]>) -> Vec<Series> {
    let mut runs: Vec<Series> = Vec::new();
    let (mut before, mut burning) = (None, false);
    for sample in node.samples().iter() {
        let here = point(sample);
        if sample.laser_percent > 0 {
            if !burning {
                runs.push(before.into_iter().collect());
            }
            if let Some(run) = runs.last_mut() {
                run.extend(here);
            }
        }
        (before, burning) = (here, sample.laser_percent > 0);
    }
    runs
}

fn axis_choice(ui: &mut Ui, name: &str, chosen: &mut usize, axis_count: usize) {
    *chosen = (*chosen).min(axis_count - 1);
    egui::ComboBox::from_label(name)
        .selected_text(format!("axis {chosen}"))
        .show_ui(ui, |ui| {
            for axis in 0..axis_count {
                ui.selectable_value(chosen, axis, format!("axis {axis}"));
            }
        });
}

fn axis_count(node: &Node) -> usize {
    let last = node.samples().last();
    last.map_or(0, |sample| sample.axes.len())
}

fn colors(ui: &Ui, axis_count: usize) -> Vec<Color32> {
    let axes = 0..axis_count;
    axes.map(|axis| theme::axis_color(ui, axis)).collect()
}

/// Returns the height of one of so many plots with their titles, so that all are in sight.
fn height_of_one(ui: &Ui, count: usize) -> f32 {
    let of_title = 26.0;
    (ui.available_height() / count as f32 - of_title).max(PLOT_HEIGHT_MIN)
}
