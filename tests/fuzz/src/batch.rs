//! An order with its commands: read once, it is the same when it is written and read again.

use keys::{AxisId, BatchHeader, BatchReader, Command, JobId, Order, QueueId, batch};

fn read(bytes: &[u8]) -> Option<(Order, Vec<Command>, Vec<u8>)> {
    let mut reader = BatchReader::new(bytes).ok()?;
    let mut commands = Vec::new();
    if let Order::Batch(_) = reader.order() {
        while let Some(command) = reader.next_command().ok()? {
            commands.push(command);
        }
    }
    Some((*reader.order(), commands, reader.rest().to_vec()))
}

/// See the module.
pub fn check(data: &[u8]) {
    let Some((order, commands, _)) = read(data) else {
        return;
    };
    let Order::Batch(header) = order else {
        return;
    };
    assert_eq!(commands.len(), usize::from(header.command_count));
    let mut writer = batch::BatchWriter::new();
    if !commands.iter().all(|command| writer.push(command)) {
        // More than one order of ours carries.
        assert!(
            data.len() > batch::ORDER_BYTES_MAX / 2 || commands.len() > batch::BATCH_COMMANDS_MAX
        );
        return;
    }
    let mut buffer = [0; batch::ORDER_BYTES_MAX];
    let written = writer.finish(header, &mut buffer).expect("an order fits");
    let (again, again_commands, rest) = read(written).expect("what was written can be read");
    assert_eq!((again, again_commands), (order, commands));
    assert!(rest.is_empty());
}

/// Batches of one and of many commands, and orders without.
pub fn seeds() -> Vec<Vec<u8>> {
    let queue = QueueId { boot: 7, flush: 1 };
    let header = BatchHeader {
        queue,
        first_command: 1_000,
        command_count: 0,
        job: JobId::new("part-0815").expect("legal"),
        job_end: 2_000,
    };
    let mut seeds = Vec::new();
    for count in [1, 3, 60] {
        let mut writer = batch::BatchWriter::new();
        for number in 0..count {
            let axis = AxisId(number as u8 % 2);
            writer.push(&match number % 3 {
                0 => Command::Move {
                    axis,
                    delay_us: 500,
                    steps: 10 - number,
                },
                1 => Command::Pause { pause_ms: 100 },
                _ => Command::SetPosition {
                    axis,
                    position_steps: -1,
                },
            });
        }
        let mut buffer = [0; batch::ORDER_BYTES_MAX];
        seeds.push(writer.finish(header, &mut buffer).expect("fits").to_vec());
    }
    for order in [
        Order::Cancel {
            queue,
            mode: keys::StopMode::Halt,
        },
        Order::Release { queue },
        Order::ScriptSeen {
            queue,
            first_command: 5,
        },
    ] {
        let mut buffer = [0; 64];
        seeds.push(
            keys::version::encode(&order, &mut buffer)
                .expect("fits")
                .to_vec(),
        );
    }
    seeds
}
