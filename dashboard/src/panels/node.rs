//! One node's page: what it says about itself, its stop, and its last minutes as plots.

use crate::{
    model::{Model, node::Node},
    request::{Request, Requests, Scope},
    text,
    theme::{self, Tone},
    view::View,
};
use egui::{Grid, ScrollArea, Ui};
use egui_plot::{Corner, Legend, Line, Plot, PlotPoints};
use keys::{StopMode, record::NodeWord};

/// Height of a plot, points.
const PLOT_HEIGHT: f32 = 150.0;

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
    ui.horizontal_wrapped(|ui| {
        theme::node_badge(node.word()).show(ui);
        if let Some(concern) = model.concern(node)
            && theme::concern_badge(concern).word != theme::node_badge(node.word()).word
        {
            theme::concern_badge(concern).show(ui);
        }
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
    ui.separator();
    ScrollArea::vertical().auto_shrink(false).show(ui, |ui| {
        facts_ui(ui, model, node);
        plot_ui(ui, model, node);
        faults_ui(ui, node);
    });
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
    facts.push(("position", text::positions(&node.positions_steps())));
    facts.push(("speed", text::speeds(&node.speeds_hz())));
    if let Some((depth, free)) = node.queue() {
        facts.push(("queue", format!("{depth} waiting, room for {free}")));
    }
    if let Some(clock) = node.clock() {
        let drift = format!("{}, {:+.1} ppm", text::clock(&clock), clock.drift_ppm);
        facts.push(("clock", drift));
    }
    if let Some(rssi_dbm) = node.rssi_dbm() {
        facts.push(("RSSI", format!("{rssi_dbm} dBm")));
    }
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
    Grid::new("facts")
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

fn plot_ui(ui: &mut Ui, model: &Model, node: &Node) {
    let axis_count = node.samples().last().map_or(0, |sample| sample.axes.len());
    if axis_count == 0 {
        return;
    }
    ui.separator();
    ui.label("Position (steps) over the last minutes (s ago)");
    let now = model.now();
    let colors: Vec<_> = (0..axis_count)
        .map(|axis| theme::axis_color(ui, axis))
        .collect();
    Plot::new(("position", node.id().as_str()))
        .height(PLOT_HEIGHT)
        // The newest is at the right.
        .legend(Legend::default().position(Corner::LeftTop))
        .show(ui, |plot| {
            for (axis, color) in colors.into_iter().enumerate() {
                let points: PlotPoints<'_> = node
                    .samples()
                    .iter()
                    .filter_map(|sample| {
                        let axis = sample.axes.get(axis)?;
                        Some([-now.since_s(sample.at), axis.position_steps as f64])
                    })
                    .collect();
                plot.line(Line::new(format!("axis {axis}"), points).color(color));
            }
        });
}

fn faults_ui(ui: &mut Ui, node: &Node) {
    let Some(record) = node.latest_record() else {
        return;
    };
    if record.faults.is_empty() {
        return;
    }
    ui.separator();
    ui.label("Faults since its boot");
    for fault in record.faults.iter().rev() {
        let at = text::date_and_time(fault.at);
        let words = format!("✖ {at}  {} {}", fault.code, fault.message);
        ui.label(theme::toned(ui, Tone::Bad, words));
    }
}
