//! What a command costs that a script queues, beside one that comes in a batch.
//! `cargo bench -p node --bench script`

use emulator::{EmulatedNode, EmulatorConfig};
use keys::{
    BatchHeader, Command, JobId, LocalMicros, NodeId, NodeTopic, Order, ScriptHeader,
    batch::{BatchWriter, ORDER_BYTES_MAX},
    version,
};
use std::time::{Duration, Instant};

const COMMANDS: u32 = 4_000;

fn node() -> EmulatedNode {
    let mut config = EmulatorConfig::new(NodeId::new("left").expect("a name"));
    config.ring_commands = 8_192;
    let mut node = EmulatedNode::new(config, 1);
    node.link(true, LocalMicros(0));
    node
}

fn job() -> JobId {
    JobId::new("j").expect("a name")
}

/// The time that a node's processor spends until it has all commands, and the node's own time.
fn by_script(text: &str) -> (Duration, u64) {
    let mut node = node();
    let order = Order::Script(ScriptHeader {
        queue: node.status().queue,
        first_command: 0,
        job: job(),
        offset_bytes: 0,
        total_bytes: text.len() as u32,
    });
    let mut buffer = [0; ORDER_BYTES_MAX];
    let mut bytes = version::encode(&order, &mut buffer).expect("room").to_vec();
    bytes.extend_from_slice(text.as_bytes());
    let mut now = LocalMicros(0);
    let begin = Instant::now();
    node.handle(NodeTopic::Batch, &bytes, now);
    while node.status().accepted_commands <= u64::from(COMMANDS) {
        now = now.plus_us(1_000);
        node.poll(now);
    }
    (begin.elapsed(), now.0)
}

fn by_batches() -> Duration {
    let mut node = node();
    let queue = node.status().queue;
    let mut orders = Vec::new();
    let mut first_command = 0;
    while first_command < u64::from(COMMANDS) {
        let mut writer = BatchWriter::new();
        while first_command + u64::from(writer.command_count()) < u64::from(COMMANDS)
            && writer.push(&Command::SyncMove {
                delay_us: [50_000, 60_000],
                steps: [1000, 1000],
            })
        {}
        let header = BatchHeader {
            queue,
            first_command,
            command_count: 0,
            job: job(),
            job_end: u64::from(COMMANDS),
        };
        first_command += u64::from(writer.command_count());
        let mut buffer = [0; ORDER_BYTES_MAX];
        orders.push(writer.finish(header, &mut buffer).expect("room").to_vec());
    }
    let begin = Instant::now();
    for order in &orders {
        node.handle(NodeTopic::Batch, order, LocalMicros(0));
    }
    assert_eq!(node.status().accepted_commands, u64::from(COMMANDS));
    begin.elapsed()
}

fn median<T: Ord + Copy>(mut measure: impl FnMut() -> T) -> T {
    let mut all: Vec<T> = (0..21).map(|_| measure()).collect();
    all.sort_unstable();
    all[10]
}

fn main() {
    let text = format!(
        "for i = 1, {COMMANDS} do motor.queue_sync_move(50000, 1000, 60000, 1000) end motor.execute()"
    );
    let (script, node_us) = median(|| by_script(&text));
    let batches = median(by_batches);
    for (name, took) in [("script", script), ("batches", batches)] {
        println!(
            "{name}: {COMMANDS} commands in {:.2} ms of processor time, {:.0} ns each, {:.0} a second",
            took.as_secs_f64() * 1e3,
            took.as_secs_f64() * 1e9 / f64::from(COMMANDS),
            f64::from(COMMANDS) / took.as_secs_f64()
        );
    }
    println!(
        "in the node's own time, slice by slice: {} ms",
        node_us / 1000
    );
}
