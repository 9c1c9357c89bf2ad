//! What follows a halt at once: a driver that needs the direction to be held after the last step
//! gets it, whatever the next queue begins with.

use emulator::{EmulatedNode, EmulatorConfig, Recording, oracle};
use keys::{
    AxisId, BatchHeader, Command, JobId, LocalMicros, NodeId, NodeTopic, Order, StopMode,
    batch::{BatchWriter, ORDER_BYTES_MAX},
};

fn give(node: &mut EmulatedNode, delay_us: u32, steps: i32, now: LocalMicros) {
    let mut writer = BatchWriter::new();
    assert!(writer.push(&Command::Move {
        axis: AxisId(0),
        delay_us,
        steps,
    }));
    let header = BatchHeader {
        queue: node.status().queue,
        first_command: 0,
        command_count: 0,
        job: JobId::new("j").expect("legal"),
        job_end: 1,
    };
    let mut buffer = [0; ORDER_BYTES_MAX];
    let bytes = writer.finish(header, &mut buffer).expect("room");
    node.handle(NodeTopic::Batch, bytes, now);
}

#[test]
fn a_queue_that_begins_at_once_behind_a_halt_turns_no_sooner_than_the_driver_allows() {
    for halt_us in 2_000..2_020 {
        let mut config = EmulatorConfig::new(NodeId::new("bench").expect("legal"));
        config.record = Recording::Edges { max: 100_000 };
        let mut node = EmulatedNode::new(config, 7);
        give(&mut node, 10, -1_000, LocalMicros(1_000));
        let at = LocalMicros(halt_us);
        let order = Order::Cancel {
            queue: node.status().queue,
            mode: StopMode::Halt,
        };
        let mut buffer = [0; 64];
        let cancel = keys::version::encode(&order, &mut buffer).expect("room");
        node.handle(NodeTopic::Batch, cancel, at);
        give(&mut node, 10, 100, at);
        node.poll(LocalMicros(1_000_000));
        if let Err(violations) = oracle::check_life(&node.life()) {
            let lines: Vec<_> = violations.iter().map(ToString::to_string).collect();
            panic!("halted at {halt_us} µs: {}", lines.join("; "));
        }
    }
}

#[test]
fn a_stop_that_overrides_a_cancel_finds_the_axis_slowing_down_already() {
    for later_us in 0..3_000 {
        let mut config = EmulatorConfig::new(NodeId::new("bench").expect("legal"));
        config.record = Recording::Edges { max: 100_000 };
        let mut node = EmulatedNode::new(config, 7);
        give(&mut node, 161, -100, LocalMicros(1_000));
        let order = Order::Cancel {
            queue: node.status().queue,
            mode: StopMode::Decelerate,
        };
        let mut buffer = [0; 64];
        let cancel = keys::version::encode(&order, &mut buffer).expect("room");
        node.handle(NodeTopic::Batch, cancel, LocalMicros(2_000));
        let stop = br#"{"mode":"decelerate"}"#;
        node.handle(NodeTopic::Stop, stop, LocalMicros(2_000 + later_us));
        node.poll(LocalMicros(1_000_000));
        if let Err(violations) = oracle::check_life(&node.life()) {
            let lines: Vec<_> = violations.iter().map(ToString::to_string).collect();
            panic!("stopped {later_us} µs later: {}", lines.join("; "));
        }
    }
}
