//! Runs `script/examples/spiral.lua` on an emulated node in virtual time and plots the step pins:
//! `cargo run -p emulator --example spiral > node-firmware/script/examples/spiral.svg`

use emulator::{
    EmulatedNode, EmulatorConfig, Recording, oracle,
    pins::{Pin, PinEvent},
};
use keys::{
    AxisId, JobId, LocalMicros, NodeId, NodeTopic, Order, ScriptHeader, ScriptReport,
    batch::ORDER_BYTES_MAX, script::PART_BYTES_MAX, version,
};

const SCRIPT: &str = include_str!("../../script/examples/spiral.lua");

fn main() {
    let mut config = EmulatorConfig::new(NodeId::new("plotter").expect("a name"));
    config.record = Recording::Edges { max: 10_000_000 };
    let mut node = EmulatedNode::new(config, 1);
    let mut now = LocalMicros(0);
    node.link(true, now);
    let mut offset_bytes = 0;
    for part in SCRIPT.as_bytes().chunks(PART_BYTES_MAX) {
        let order = Order::Script(ScriptHeader {
            queue: node.status().queue,
            first_command: 0,
            job: JobId::new("spiral").expect("a name"),
            offset_bytes,
            total_bytes: SCRIPT.len() as u32,
        });
        let mut buffer = [0; ORDER_BYTES_MAX];
        let mut bytes = version::encode(&order, &mut buffer).expect("room").to_vec();
        bytes.extend_from_slice(part);
        node.handle(NodeTopic::Batch, &bytes, now);
        offset_bytes += part.len() as u32;
    }
    let report = loop {
        let due = node
            .poll_timeout()
            .expect("a script that runs wants to be called");
        now = now.max(due);
        node.poll(now);
        let told = node.outbox(now).into_iter().find_map(|message| {
            (message.topic == NodeTopic::Report).then(|| {
                let (report, text) = ScriptReport::decode(&message.payload).expect("a report");
                (report, text.to_owned())
            })
        });
        if let Some(told) = told {
            break told;
        }
    };
    let summary = oracle::check_life(&node.life()).expect("good pulses");
    eprintln!(
        "{:?}: {}; {} commands, {:?} steps, {:.1} s",
        report.0.outcome,
        report.1,
        summary.commands,
        summary.steps,
        now.0 as f64 / 1e6
    );
    println!("{}", plot(node.edges()));
}

/// Draws the way of axes 0 and 1, a point for each eighth step.
fn plot(edges: &[PinEvent]) -> String {
    let mut at = [0_i64; 2];
    let mut direction = [1_i64; 2];
    let mut points = String::from("0,0");
    let mut steps = 0;
    for edge in edges {
        match edge.pin {
            Pin::Direction(AxisId(axis @ 0..2)) => {
                direction[usize::from(axis)] = if edge.level { 1 } else { -1 };
            }
            Pin::Step(AxisId(axis @ 0..2)) if edge.level => {
                at[usize::from(axis)] += direction[usize::from(axis)];
                steps += 1;
                if steps % 8 == 0 {
                    points += &format!(" {},{}", at[0], at[1]);
                }
            }
            _ => {}
        }
    }
    format!(
        "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"-2100 -2100 4200 4200\" width=\"600\">\
         <rect x=\"-2100\" y=\"-2100\" width=\"4200\" height=\"4200\" fill=\"#fff\"/>\
         <polyline points=\"{points}\" fill=\"none\" stroke=\"#135\" stroke-width=\"12\"/></svg>"
    )
}
