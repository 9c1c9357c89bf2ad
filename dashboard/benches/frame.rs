//! What a frame costs: 500 nodes that all move, 10 statuses a second each, a window of 1440 × 860.
//!
//! ```text
//! cargo bench -p dashboard --profile dev     without building every dependency once more
//! cargo bench -p dashboard
//! ```
//!
//! Measured is our own part: messages into the model, the panels, and egui's tessellation. What the
//! graphics card or its software stand-in adds is not.

#[path = "../tests/window/fixture.rs"]
mod fixture;

use criterion::{Criterion, criterion_group, criterion_main};
use dashboard::{
    app::Dashboard, message::Message, model::limits::SAMPLES_MAX, panels::node::Page, view::Tab,
};
use egui::{Context, RawInput, Rect, Shape, pos2, vec2};
use fixture::{at_ms, many, node, statuses, tell};
use std::hint::black_box;

const NODES: usize = 500;

fn input() -> RawInput {
    RawInput {
        screen_rect: Some(Rect::from_min_size(pos2(0.0, 0.0), vec2(1_440.0, 860.0))),
        ..RawInput::default()
    }
}

fn frame(context: &Context, dashboard: &mut Dashboard) {
    let mut output = context.run_ui(input(), |ui| dashboard.ui(ui));
    // Nothing draws them.
    output.textures_delta.clear();
    black_box(context.tessellate(output.shapes, 1.0));
}

/// Returns how many lines of many points a frame has.
fn lines_drawn(context: &Context, dashboard: &mut Dashboard) -> usize {
    let mut count = 0;
    // The first frame of a panel only measures it.
    for _ in 0..3 {
        let mut output = context.run_ui(input(), |ui| dashboard.ui(ui));
        output.textures_delta.clear();
        let shapes = output.shapes.iter();
        count = shapes.filter(|shape| has_line(&shape.shape)).count();
    }
    count
}

fn has_line(shape: &Shape) -> bool {
    match shape {
        Shape::Path(path) => path.points.len() > SAMPLES_MAX / 2,
        Shape::Vec(shapes) => shapes.iter().any(has_line),
        _ => false,
    }
}

fn benches(criterion: &mut Criterion) {
    let context = Context::default();
    dashboard::theme::apply(&context);

    let mut fleet = many(NODES);
    let mut tick = 0;
    criterion.bench_function(
        "one status of each of 500 nodes into the model",
        |bencher| {
            bencher.iter(|| {
                tick += 1;
                statuses(&mut fleet, NODES, tick);
            });
        },
    );
    criterion.bench_function("a frame, 500 nodes, nothing new", |bencher| {
        bencher.iter(|| frame(&context, &mut fleet));
    });
    // 20 frames and 5,000 statuses a second: half of the nodes have spoken since the last frame.
    criterion.bench_function(
        "a frame, 500 nodes, 250 statuses since the last",
        |bencher| {
            bencher.iter(|| {
                tick += 1;
                statuses(&mut fleet, NODES / 2, tick);
                frame(&context, &mut fleet);
            });
        },
    );
    for _ in 0..SAMPLES_MAX {
        tick += 1;
        statuses(&mut fleet, NODES, tick);
    }
    let plotted = node("node-007");
    let samples = fleet
        .model
        .node(&plotted)
        .map(|node| node.samples().iter().len());
    assert_eq!(samples, Some(SAMPLES_MAX), "two minutes at 10/s");
    (fleet.view.focus, fleet.view.node.page) = (Some(plotted), Page::Motion);
    // Whoever breaks the way to the plots shall not measure a page without them.
    assert!(lines_drawn(&context, &mut fleet) > 0, "the plots are drawn");
    criterion.bench_function(
        "a frame, 500 nodes, one page with two minutes of plots",
        |bencher| {
            bencher.iter(|| frame(&context, &mut fleet));
        },
    );
    fleet.view.focus = None;
    fleet.view.tab = Tab::Timeline;
    criterion.bench_function("a frame, 500 nodes, their timeline", |bencher| {
        bencher.iter(|| frame(&context, &mut fleet));
    });
    fleet.view.tab = Tab::Log;
    for number in 0..10_000 {
        let (node, text) = (node("node-001"), format!("line {number}"));
        tell(&mut fleet, at_ms(tick * 100), Message::Log { node, text });
    }
    fleet.view.log.filter = "line 9".to_owned();
    criterion.bench_function("a frame, 10,000 log lines, one new, filtered", |bencher| {
        bencher.iter(|| {
            let (node, text) = (node("node-001"), "line 9".to_owned());
            tell(&mut fleet, at_ms(tick * 100), Message::Log { node, text });
            frame(&context, &mut fleet);
        });
    });
}

criterion_group!(group, benches);
criterion_main!(group);
