//! A whole node, told anything in any order while it moves: the oracle judges its pulses, and where
//! it says it is is where its pulse counters are.
//!
//! Deeds follow each other: orders that are meant for its queue, messages of any bytes on any of
//! its keys, stops, links that come and go, and time.

use super::Input;
use emulator::{EmulatedNode, EmulatorConfig, Recording, oracle};
use keys::{
    AxisId, BatchHeader, Command, JobId, LocalMicros, NodeId, NodeTopic, Order, StopMode, batch,
};

/// Topics that a node hears.
const HEARD: [NodeTopic; 4] = [
    NodeTopic::Batch,
    NodeTopic::Stop,
    NodeTopic::Start,
    NodeTopic::Clock,
];

/// See the module.
pub fn check(data: &[u8]) {
    let mut input = Input(data);
    let mut config = EmulatorConfig::new(NodeId::new("left").expect("legal"));
    config.record = Recording::Edges { max: 50_000 };
    let mut node = EmulatedNode::new(config, 1);
    let mut now = LocalMicros(1_000);
    node.link(true, now);
    for _ in 0..200 {
        if input.is_empty() {
            break;
        }
        deed(&mut input, &mut node, &mut now);
        live_until(&mut node, now);
    }
    // It comes to rest by itself, or by a stop.
    now = LocalMicros(now.0 + 2_000_000);
    live_until(&mut node, now);
    node.handle(NodeTopic::Stop, b"", now);
    now = LocalMicros(now.0 + 1_000_000);
    live_until(&mut node, now);
    let life = node.life();
    if let Err(violations) = oracle::check_life(&life) {
        let lines: Vec<_> = violations.iter().map(ToString::to_string).collect();
        panic!(
            "{}; {:?}; {:?}",
            lines.join("; "),
            life.commands,
            life.stops
        );
    }
    // A client may set a position: then they differ, and the oracle has compared them.
    let sets =
        |command: &Command| matches!(command, Command::SetPosition { .. } | Command::Home { .. });
    if !life.commands.iter().any(|taken| sets(&taken.command)) {
        let said: Vec<i64> = node
            .status()
            .axes
            .iter()
            .map(|axis| axis.position_steps)
            .collect();
        assert_eq!(said, life.counted_steps);
    }
}

/// Lets the node do what is due, each at its time, as a driver does.
pub(crate) fn live_until(node: &mut EmulatedNode, now: LocalMicros) {
    while let Some(due) = node.poll_timeout().filter(|due| *due < now) {
        node.poll(due);
        let _ = node.outbox(due);
    }
    node.poll(now);
    let _ = node.outbox(now);
}

fn deed(input: &mut Input<'_>, node: &mut EmulatedNode, now: &mut LocalMicros) {
    let deed = input.byte();
    match deed % 8 {
        0 | 1 => {
            let count = u16::from(input.byte() % 8) + 1;
            let mut writer = batch::BatchWriter::new();
            for _ in 0..count {
                let axis = AxisId(input.byte() % 3);
                let number = i32::from(input.byte());
                writer.push(&match input.byte() % 5 {
                    0..=2 => Command::Move {
                        axis,
                        delay_us: 5 + u32::from(input.byte()),
                        steps: number - 128,
                    },
                    3 => Command::Pause {
                        pause_ms: number as u32,
                    },
                    _ => Command::SetPosition {
                        axis,
                        position_steps: i64::from(number),
                    },
                });
            }
            let status = node.status();
            let header = BatchHeader {
                queue: status.queue,
                first_command: status.accepted_commands + u64::from(deed >> 7),
                command_count: count,
                job: JobId::new("a").expect("legal"),
                job_end: status.accepted_commands + u64::from(count),
            };
            let mut buffer = [0; batch::ORDER_BYTES_MAX];
            let bytes = writer.finish(header, &mut buffer).expect("an order fits");
            node.handle(NodeTopic::Batch, bytes, *now);
        }
        // Commands of any bytes, for the queue that counts.
        2 => {
            let status = node.status();
            let length = usize::from(input.byte());
            let bytes = input.bytes(length);
            let header = BatchHeader {
                queue: status.queue,
                first_command: status.accepted_commands,
                command_count: u16::from(deed >> 3),
                job: JobId::new("b").expect("legal"),
                job_end: status.accepted_commands + u64::from(deed >> 3),
            };
            let mut buffer = [0; 256];
            let order = Order::Batch(header);
            let head = keys::version::encode(&order, &mut buffer).expect("room");
            node.handle(NodeTopic::Batch, &[head, bytes].concat(), *now);
        }
        3 => {
            let topic = HEARD[usize::from(deed >> 3) % HEARD.len()];
            let length = usize::from(input.byte());
            node.handle(topic, input.bytes(length), *now);
        }
        4 => {
            let queue = node.status().queue;
            let order = match deed >> 6 {
                0 => Order::Cancel {
                    queue,
                    mode: StopMode::Decelerate,
                },
                1 => Order::Cancel {
                    queue,
                    mode: StopMode::Halt,
                },
                _ => Order::Release { queue },
            };
            let mut buffer = [0; 64];
            let bytes = keys::version::encode(&order, &mut buffer).expect("room");
            node.handle(NodeTopic::Batch, bytes, *now);
            // A report names one stop. A deceleration that another stop cuts short looks to the
            // oracle like steps that nobody ordered, so it comes to its end here.
            *now = LocalMicros(now.0 + 500_000);
            live_until(node, *now);
        }
        5 => node.link(deed & 0x80 == 0, *now),
        6 => node.stop_pin(deed & 0x80 == 0, *now),
        _ => {
            let us = 1 + u64::from(input.short()) * (1 + u64::from(deed >> 5));
            *now = LocalMicros(now.0 + us);
            live_until(node, *now);
        }
    }
}

/// Moves and time; a stop in between; orders of any bytes.
pub fn seeds() -> Vec<Vec<u8>> {
    vec![
        vec![
            0, 2, 0, 200, 0, 50, 1, 20, 1, 9, 0, 90, 3, 7, 255, 255, 7, 255, 255,
        ],
        vec![
            0, 0, 0, 255, 0, 100, 7, 200, 0, 6, 7, 100, 0, 0x86, 4, 0x84, 0, 0, 0, 255, 0, 9, 7, 9,
            9,
        ],
        vec![
            0, 1, 0, 255, 0, 50, 1, 3, 0, 9, 0x25, 0, 7, 255, 255, 0x85, 7, 255, 255, 5, 7, 255,
            255,
        ],
        vec![0x0a, 8, 0, 0, 200, 1, 20, 6, 1, 1, 7, 255, 255],
    ]
}
