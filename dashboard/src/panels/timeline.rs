//! What the nodes did over time, one lane each: jobs, stops, faults, losses. The lanes are those of
//! the fleet's table, in its order.

use crate::{
    message::Moment,
    model::{
        Model,
        history::{Doing, Stretch},
        node::Node,
    },
    panels::fleet,
    text,
    theme::{self, Badge, Tone},
    view::View,
};
use egui::{Align2, FontId, Rect, Response, Role, ScrollArea, Sense, Ui, pos2, vec2};
use keys::NodeId;
use serde::{Deserialize, Serialize};

/// Shortest and longest time that is shown, s.
const SPAN_S: std::ops::RangeInclusive<f64> = 1.0..=86_400.0;

/// How much a button zooms.
const ZOOM: f64 = 2.0;

/// Width of the names beside the lanes, points.
const NAMES_WIDTH: f32 = 130.0;

/// Height of the times above the lanes, points.
const TIMES_HEIGHT: f32 = 18.0;

/// Least distance of two times, points.
const TIMES_EVERY: f32 = 110.0;

/// Narrowest block that has an icon, and that has words too, points.
const ICON_WIDTH: f32 = 14.0;
const WORDS_WIDTH: f32 = 60.0;

/// Distances of two times that can be read, s.
const STEPS_S: [f64; 15] = [
    0.1, 0.5, 1.0, 2.0, 5.0, 10.0, 30.0, 60.0, 120.0, 300.0, 600.0, 1_800.0, 3_600.0, 7_200.0,
    21_600.0,
];

/// What the panel remembers.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(default)]
pub struct TimelineView {
    /// The time that is shown, s.
    pub span_s: f64,
    /// The latest moment that is shown; `None` follows the present.
    #[serde(skip)]
    pub end: Option<Moment>,
    /// Where the pointer is: node and moment.
    #[serde(skip)]
    pub cursor: Option<(NodeId, Moment)>,
}

impl Default for TimelineView {
    fn default() -> Self {
        Self {
            span_s: 300.0,
            end: None,
            cursor: None,
        }
    }
}

impl TimelineView {
    /// Returns the first moment that is shown and the last one.
    fn window(&self, now: Moment) -> (Moment, Moment) {
        let end = self.end.unwrap_or(now);
        (minus_s(end, self.span_s), end)
    }

    /// Moves the window; beyond the present it follows it.
    fn pan(&mut self, now: Moment, by_s: f64) {
        let (_, end) = self.window(now);
        let end = plus_s(end, by_s);
        self.end = (end < now).then_some(end);
    }

    /// Makes the span so many times as long; the moment at this share of it stays where it is.
    fn zoom(&mut self, now: Moment, times: f64, share: f64) {
        let span_s = (self.span_s * times).clamp(*SPAN_S.start(), *SPAN_S.end());
        let ahead_s = (1.0 - share) * (span_s - self.span_s);
        self.span_s = span_s;
        if self.end.is_some() {
            self.pan(now, ahead_s);
        }
    }
}

fn plus_s(at: Moment, s: f64) -> Moment {
    let us = (s.abs() * 1e6) as u64;
    if s >= 0.0 {
        at.plus_us(us)
    } else {
        Moment(at.0.saturating_sub(us))
    }
}

fn minus_s(at: Moment, s: f64) -> Moment {
    plus_s(at, -s)
}

/// Shows the lanes.
pub fn timeline_ui(ui: &mut Ui, model: &Model, view: &mut View) {
    let nodes = fleet::shown(model, view);
    let now = model.now();
    tools_ui(ui, model, &mut view.timeline);
    if nodes.is_empty() {
        let words = "no node to show: none is known, or the filter of the fleet lets none through";
        ui.label(theme::toned(ui, Tone::Quiet, words));
        return;
    }
    let (from, to) = view.timeline.window(now);
    times_ui(ui, from, to);
    let mut cursor = None;
    let mut opened = None;
    ScrollArea::vertical().auto_shrink(false).show_rows(
        ui,
        theme::ROW_HEIGHT,
        nodes.len(),
        |ui, rows| {
            for node in &nodes[rows] {
                ui.horizontal(|ui| {
                    if name_ui(ui, node, view.focus) {
                        opened = Some(node.id());
                    }
                    let lane = lane_ui(ui, model, node, (from, to));
                    let rect = lane.rect;
                    if let Some(pointer) = lane.hover_pos() {
                        let share = f64::from((pointer.x - rect.left()) / rect.width());
                        cursor = Some((node.id(), plus_s(from, share * view.timeline.span_s)));
                        let zoom = f64::from(ui.input(egui::InputState::zoom_delta));
                        if zoom != 1.0 {
                            view.timeline.zoom(now, 1.0 / zoom, share);
                        }
                    }
                    if lane.dragged() {
                        let share = f64::from(lane.drag_delta().x / rect.width());
                        view.timeline.pan(now, -share * view.timeline.span_s);
                    }
                    if lane.double_clicked() {
                        view.timeline = TimelineView::default();
                    }
                });
            }
        },
    );
    if cursor.is_some() || !ui.ctx().input(|input| input.pointer.any_down()) {
        view.timeline.cursor = cursor;
    }
    if opened.is_some() {
        view.focus = opened;
    }
}

/// Shows what moves the window in time, and what is at the cursor.
fn tools_ui(ui: &mut Ui, model: &Model, view: &mut TimelineView) {
    let now = model.now();
    ui.horizontal_wrapped(|ui| {
        for (sign, name, hint) in [
            ("−", "Longer time", "Show a longer time"),
            ("+", "Shorter time", "Show a shorter time"),
            ("◀", "Earlier", "Go back in time"),
            ("▶", "Later", "Go on in time"),
        ] {
            let button = ui.button(sign).on_hover_text(hint);
            theme::named(&button, Role::Button, name);
            if button.clicked() {
                match sign {
                    "−" => view.zoom(now, ZOOM, 0.5),
                    "+" => view.zoom(now, 1.0 / ZOOM, 0.5),
                    "◀" => view.pan(now, -view.span_s / 2.0),
                    _ => view.pan(now, view.span_s / 2.0),
                }
            }
        }
        let follows = view.end.is_none();
        if ui.selectable_label(follows, "Follow the present").clicked() {
            view.end = None;
        }
        let span = text::age(view.span_s);
        let words = match view.end {
            None => format!("the last {span}"),
            Some(end) => format!("{span} until {}", text::time_of_day(end)),
        };
        ui.label(words);
        let node = view.cursor.and_then(|(id, _)| model.node(&id));
        let words = match (node, view.cursor) {
            (Some(node), Some((_, at))) => reading(node, at, now),
            _ => "point at a lane to read it · drag: pan · Ctrl+wheel: zoom · double click: all"
                .to_owned(),
        };
        ui.label(theme::toned(ui, Tone::Quiet, words));
    });
}

/// What a node did at a moment, in words.
fn reading(node: &Node, at: Moment, now: Moment) -> String {
    let time = text::time_of_day(at);
    let Some(stretch) = node.history().at(at) else {
        return format!("{time}  {}: not heard of yet", node.id());
    };
    let mut stretches = node.history().stretches();
    let next = stretches.find(|next| next.since > stretch.since);
    let lasted_s = next.map_or(now, |next| next.since).since_s(stretch.since);
    let lasted = text::age(lasted_s);
    let still = if next.is_none() { " so far" } else { "" };
    let words = words(stretch);
    let since = text::time_of_day(stretch.since);
    format!(
        "{time}  {}: {words}, since {since}, {lasted}{still}",
        node.id()
    )
}

fn words(stretch: &Stretch) -> String {
    let badge = badge(stretch.doing);
    match stretch.job {
        Some(job) => format!("{} {} {job}", badge.icon, badge.word),
        None => format!("{} {}", badge.icon, badge.word),
    }
}

fn badge(doing: Doing) -> Badge {
    match doing {
        Doing::Unknown => Badge {
            icon: "?",
            word: "no link",
            tone: Tone::Quiet,
        },
        Doing::Silent => theme::concern_badge(crate::model::node::Concern::Silent),
        Doing::Lost => theme::concern_badge(crate::model::node::Concern::Lost),
        Doing::Word(word) => theme::node_badge(word),
    }
}

/// Shows the node's name and returns whether its page is wanted.
fn name_ui(ui: &mut Ui, node: &Node, focus: Option<NodeId>) -> bool {
    let id = node.id();
    let size = vec2(NAMES_WIDTH, theme::ROW_HEIGHT);
    let layout = egui::Layout::left_to_right(egui::Align::Center);
    let name = ui.allocate_ui_with_layout(size, layout, |ui| {
        ui.set_min_width(NAMES_WIDTH);
        let button = egui::Button::selectable(focus == Some(id), id.as_str());
        ui.add(button.truncate())
    });
    theme::named(&name.inner, Role::Button, &format!("Lane of {id}"));
    name.inner.clicked()
}

/// Shows the times above the lanes.
fn times_ui(ui: &mut Ui, from: Moment, to: Moment) {
    let (rect, _) =
        ui.allocate_exact_size(vec2(ui.available_width(), TIMES_HEIGHT), Sense::hover());
    let left = rect.left() + NAMES_WIDTH + ui.spacing().item_spacing.x;
    let lanes = Rect::from_min_max(pos2(left, rect.top()), rect.max);
    let font = FontId::proportional(11.0);
    let color = Tone::Quiet.color(ui);
    for at in marks(from, to, f64::from(lanes.width())) {
        let x = x_of(at, (from, to), lanes);
        let digits = if to.since_s(from) < 5.0 { 10 } else { 8 };
        let time = &text::time_of_day(at)[..digits];
        let painter = ui.painter();
        painter.vline(x, rect.y_range(), egui::Stroke::new(1.0, color));
        if x + TIMES_EVERY / 2.0 < rect.right() {
            let place = pos2(x + 3.0, rect.center().y);
            painter.text(place, Align2::LEFT_CENTER, time, font.clone(), color);
        }
    }
}

/// Returns the moments that are written above lanes of so many points.
fn marks(from: Moment, to: Moment, width: f64) -> Vec<Moment> {
    let span_s = to.since_s(from);
    let fewest_s = span_s * f64::from(TIMES_EVERY) / width.max(1.0);
    let step_s = STEPS_S.into_iter().find(|step_s| *step_s >= fewest_s);
    let step_us = (step_s.unwrap_or(86_400.0) * 1e6) as u64;
    let first = from.0.next_multiple_of(step_us);
    let marks = (first..=to.0).step_by(usize::try_from(step_us).unwrap_or(usize::MAX));
    marks.map(Moment).collect()
}

fn x_of(at: Moment, (from, to): (Moment, Moment), rect: Rect) -> f32 {
    let span_us = to.0.saturating_sub(from.0).max(1) as f64;
    let share = (at.0 as f64 - from.0 as f64) / span_us;
    rect.left() + (share.clamp(0.0, 1.0) as f32) * rect.width()
}

/// Shows one node's lane.
fn lane_ui(ui: &mut Ui, model: &Model, node: &Node, window: (Moment, Moment)) -> Response {
    let size = vec2(ui.available_width(), theme::ROW_HEIGHT - 2.0);
    let (rect, response) = ui.allocate_exact_size(size, Sense::click_and_drag());
    let now = model.now();
    let last = node.history().stretches().next_back();
    let latest = last.map_or("not heard of yet".to_owned(), |stretch| {
        let lasts = text::age(now.since_s(stretch.since));
        format!("{} for {lasts}", words(stretch))
    });
    let name = format!("{}: {latest}", node.id());
    theme::named(&response, Role::Image, &name);
    let painter = ui.painter_at(rect);
    painter.rect_filled(rect, 2.0, ui.visuals().faint_bg_color);
    let stretches: Vec<&Stretch> = node.history().stretches().collect();
    let ends = stretches.iter().skip(1).map(|next| next.since);
    let ends = ends.chain(std::iter::once(now));
    for (stretch, end) in stretches.iter().zip(ends) {
        if end < window.0 || stretch.since > window.1 {
            continue;
        }
        let (left, right) = (x_of(stretch.since, window, rect), x_of(end, window, rect));
        // What lasted for less than a pixel is seen too.
        let block = rect.with_min_x(left).with_max_x(right.max(left + 1.5));
        block_ui(ui, &painter, block, stretch);
    }
    let font = FontId::proportional(12.0);
    for (at, _) in node.history().faults() {
        if (window.0..=window.1).contains(at) {
            let sides = rect.left() + ICON_WIDTH / 2.0..=rect.right() - ICON_WIDTH / 2.0;
            let x = x_of(*at, window, rect).clamp(*sides.start(), *sides.end());
            let place = pos2(x, rect.top());
            let color = Tone::Bad.color(ui);
            painter.text(place, Align2::CENTER_TOP, "✖", font.clone(), color);
        }
    }
    if let Some(pointer) = response.hover_pos() {
        let stroke = ui.visuals().widgets.active.fg_stroke;
        painter.vline(pointer.x, rect.y_range(), stroke);
    }
    response
}

fn block_ui(ui: &Ui, painter: &egui::Painter, block: Rect, stretch: &Stretch) {
    let badge = badge(stretch.doing);
    let color = badge.tone.color(ui);
    // What is as usual stays in the background.
    let strength = match badge.tone {
        Tone::Bad => 0.45,
        Tone::Warn | Tone::Busy => 0.35,
        _ => 0.12,
    };
    painter.rect_filled(block, 2.0, color.gamma_multiply(strength));
    let stroke = egui::Stroke::new(1.0, color.gamma_multiply(0.8));
    painter.vline(block.left(), block.y_range(), stroke);
    let words = match block.width() {
        ..ICON_WIDTH => return,
        ..WORDS_WIDTH => badge.icon.to_owned(),
        _ => match stretch.job {
            Some(job) => format!("{} {job}", badge.icon),
            None => format!("{} {}", badge.icon, badge.word),
        },
    };
    let clipped = painter.with_clip_rect(block.intersect(painter.clip_rect()));
    let place = block.left_center() + vec2(3.0, 0.0);
    let font = FontId::proportional(12.0);
    clipped.text(
        place,
        Align2::LEFT_CENTER,
        words,
        font,
        ui.visuals().text_color(),
    );
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_window_follows_the_present_until_it_is_moved_back() {
        let now = Moment(10_000_000_000);
        let mut view = TimelineView::default();
        assert_eq!(view.window(now), (Moment(9_700_000_000), now));
        view.zoom(now, 0.5, 0.5);
        assert_eq!(view.window(now), (Moment(9_850_000_000), now));
        view.pan(now, -200.0);
        let later = now.plus_us(1_000_000);
        assert_eq!(view.window(later).1, Moment(9_800_000_000));
        view.zoom(later, 2.0, 0.0);
        assert_eq!(view.window(later).0, Moment(9_650_000_000), "stays");
        view.pan(later, 500.0);
        assert_eq!(view.end, None, "not beyond the present");
        for times in [1e-9, 1e9] {
            view.zoom(later, times, 0.5);
            assert!(SPAN_S.contains(&view.span_s));
        }
    }

    #[test]
    fn times_stand_at_round_moments_and_apart() {
        let (from, to) = (Moment(1_000_300_000), Moment(1_300_300_000));
        let marks = marks(from, to, 660.0);
        assert_eq!(marks.len(), 5);
        assert!(marks.iter().all(|mark| mark.0.is_multiple_of(60_000_000)));
    }
}
