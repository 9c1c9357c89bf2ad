//! A node that executes only what an operator signed, told anything by somebody who has no key: it takes
//! no command and no step, and can be stopped and released as ever.
//!
//! Deeds follow each other: orders for its queue behind proofs that name the right key and everything else
//! at will, orders without, messages of any bytes, and time.

use super::{Input, node::live_until};
use emulator::{EmulatedNode, EmulatorConfig, Recording, oracle};
use keys::{
    AxisId, BatchHeader, Command, JobId, LocalMicros, NodeId, NodeTopic, batch, epoch,
    signed::{PROOF_BYTES_MAX, Proof, link_command, root_of_commands},
};

/// The operator's public key: a point of the curve, of which nobody here has the private half.
const KEY: [u8; 32] = [
    0xd7, 0x5a, 0x98, 0x01, 0x82, 0xb1, 0x0a, 0xb7, 0xd5, 0x4b, 0xfe, 0xd3, 0xc9, 0x64, 0x07, 0x3a,
    0x0e, 0xe1, 0x72, 0xf3, 0xda, 0xa6, 0x23, 0x25, 0xaf, 0x02, 0x1a, 0x68, 0xf7, 0x07, 0x51, 0x1a,
];

/// Topics that a node hears.
const HEARD: [NodeTopic; 5] = [
    NodeTopic::Batch,
    NodeTopic::Stop,
    NodeTopic::Start,
    NodeTopic::Clock,
    NodeTopic::Pace,
];

/// See the module.
pub fn check(data: &[u8]) {
    let mut input = Input(data);
    let mut config = EmulatorConfig::new(NodeId::new("left").expect("legal"));
    config.record = Recording::Edges { max: 1_000 };
    config.signers.push(KEY).expect("room");
    let mut node = EmulatedNode::new(config, 1);
    let mut now = LocalMicros(1_000);
    node.link(true, now);
    for _ in 0..100 {
        if input.is_empty() {
            break;
        }
        deed(&mut input, &mut node, &mut now);
        live_until(&mut node, now);
    }
    now = LocalMicros(now.0 + 1_000_000);
    live_until(&mut node, now);
    let life = node.life();
    assert!(life.commands.is_empty(), "unsigned: {:?}", life.commands);
    assert!(life.counted_steps.iter().all(|steps| *steps == 0));
    oracle::check_life(&life).expect("nothing happened");
}

fn deed(input: &mut Input<'_>, node: &mut EmulatedNode, now: &mut LocalMicros) {
    let deed = input.byte();
    match deed % 4 {
        0 | 1 => {
            let count = u16::from(input.byte() % 4) + 1;
            let mut writer = batch::BatchWriter::new();
            let mut commands = Vec::new();
            for _ in 0..count {
                let command = Command::Move {
                    axis: AxisId(input.byte() % 2),
                    delay_us: 5 + u32::from(input.byte()),
                    steps: i32::from(input.byte()) + 1,
                };
                assert!(writer.push(&command));
                commands.push(command);
            }
            let status = node.status();
            let header = BatchHeader {
                queue: status.queue,
                first_command: status.accepted_commands,
                command_count: count,
                job: JobId::new("a").expect("legal"),
                job_end: status.accepted_commands + u64::from(count),
            };
            let mut buffer = [0; batch::ORDER_BYTES_MAX];
            let plain = writer.finish(header, &mut buffer).expect("an order fits");
            let mut order = epoch::mark(u32::from(input.byte())).to_vec();
            if deed & 0x80 == 0 {
                let mut half = || {
                    let byte = input.byte();
                    std::array::from_fn(|at| byte.wrapping_mul(at as u8 + 1))
                };
                let proof = Proof {
                    key: KEY,
                    signature: [half(), half()],
                    number: u64::from(input.short()),
                    first_command: header.first_command,
                    command_count: u64::from(count) + u64::from(deed >> 6),
                    root: root_of_commands(&commands),
                    after: match deed & 0x20 {
                        0 => keys::signed::END,
                        _ => link_command(&commands[0], &keys::signed::END),
                    },
                };
                let mut buffer = [0; PROOF_BYTES_MAX];
                let used = proof.write(&mut buffer).expect("room");
                order.extend_from_slice(&buffer[..used]);
            }
            order.extend_from_slice(plain);
            node.handle(NodeTopic::Batch, &order, *now);
        }
        2 => {
            let topic = HEARD[usize::from(deed >> 2) % HEARD.len()];
            let length = usize::from(input.byte());
            node.handle(topic, input.bytes(length), *now);
        }
        _ => *now = LocalMicros(now.0 + 1 + 10 * u64::from(input.short())),
    }
}

/// Orders with a forged proof and without any, and time for them.
pub fn seeds() -> Vec<Vec<u8>> {
    vec![
        vec![0, 1, 0, 100, 20, 1, 100, 20, 0, 7, 9, 1, 0, 3, 255, 255],
        vec![0x80, 0, 0, 100, 20, 1, 3, 255, 255],
        vec![
            0x20, 2, 0, 9, 9, 1, 9, 9, 0, 9, 9, 2, 0, 0, 1, 0, 3, 255, 255,
        ],
        vec![2, 6, 0x53, 1, 2, 3, 4, 5, 6, 0, 0, 3, 255, 255],
    ]
}
