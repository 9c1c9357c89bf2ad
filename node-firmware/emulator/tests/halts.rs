//! What follows a halt at once: a driver that needs the direction to be held after the last step
//! gets it, whatever the next queue begins with.

mod bench;

use bench::{Bench, config};
use emulator::{EmulatedNode, EmulatorConfig, Recording, oracle};
use keys::{
    AxisId, BatchHeader, Command, JobId, LocalMicros, NodeId, NodeTopic, Order, StopMode,
    batch::{BatchWriter, ORDER_BYTES_MAX},
};

use motion::{
    MotionEvent, Ticks,
    io::input::{Filter, InputConfig, InputMap, PinLevel, Role},
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

#[test]
fn a_probe_that_touches_just_before_a_stop_is_told_with_its_place() {
    let probe = InputConfig {
        role: Role::Probe,
        active_low: false,
        filter: Filter::default(),
    };
    for mode in [StopMode::Halt, StopMode::Decelerate] {
        let mut config = config();
        config.motion.inputs = InputMap::new(&[probe], 2).expect("legal");
        let mut bench = Bench::new(config);
        let steps = |steps| Command::Move {
            axis: AxisId(0),
            delay_us: 250,
            steps,
        };
        bench.order([steps(3_000)]);
        bench.run_until(400_000);
        let touched = bench.node.status().axes[0].position_steps;
        let now = Ticks(bench.now.0 * 16);
        let motion = bench.node.node_mut().motion_mut();
        motion.input(PinLevel {
            index: 0,
            level: true,
            at: now,
            counted_steps: [touched, 0, 0, 0],
        });
        // Its level counts when it has been the same for a while: nobody looks until the stop comes.
        let later = Ticks(now.0 + 10_000 * 16);
        motion.stop(mode, later);
        let mut told = Vec::new();
        while let Some(event) = motion.poll(later) {
            if let MotionEvent::Probe {
                active,
                positions_steps,
            } = event
            {
                told.push((active, positions_steps[0]));
            }
        }
        assert_eq!(told, [(true, touched)], "{mode:?}");
    }
}
