//! One stop path from every state, and the latch.

mod rig;

use keys::{
    Command, LocalMicros, NodeState, QueueId, Refusal, StopMode, StopReason, Verdict,
    status::FaultCode,
};
use rig::{BOOT, Rig, config, steps};

const QUEUE_1: QueueId = QueueId {
    boot: BOOT,
    flush: 1,
};

#[test]
fn a_stop_at_rest_latches_and_reports() {
    let mut rig = Rig::new(config());
    rig.run_for(500_000);
    rig.stop(StopMode::Decelerate);
    assert_eq!(rig.state(), NodeState::Stopped);
    assert_eq!(rig.queue(), QUEUE_1);
    let report = rig.status().stop.expect("a report");
    assert_eq!(
        report.queue,
        QueueId {
            boot: BOOT,
            flush: 0
        }
    );
    assert_eq!(report.reason, StopReason::Client);
    assert_eq!(report.at, LocalMicros(500_000));
    assert_eq!(report.positions_steps.as_slice(), [0, 0]);
    let ack = rig.batch(&[steps(1)]);
    assert_eq!(ack.verdict, Verdict::Refused(Refusal::Stopped));
}

#[test]
fn a_halt_is_complete_at_once_and_exact() {
    for at_us in [1, 50, 99, 100, 101, 12_345, 99_999] {
        let mut rig = Rig::new(config());
        let _ = rig.batch(&[steps(1000), steps(-1000)]);
        rig.run_for(at_us);
        rig.stop(StopMode::Halt);
        assert_eq!(rig.state(), NodeState::Stopped, "{at_us}");
        assert_eq!(rig.queue(), QUEUE_1, "{at_us}");
        let report = rig.status().stop.expect("a report");
        assert_eq!(report.at, LocalMicros(at_us));
        assert_eq!(report.accepted_commands, 2);
        assert_eq!(report.executed_commands, 0);
        assert_eq!(report.positions_steps[0], rig.position());
        let at = rig.position();
        rig.run_for(1_000_000);
        assert_eq!(rig.position(), at, "nothing moves after a stop");
        assert_eq!(rig.status().accepted_commands, 0);
    }
}

#[test]
fn a_decelerated_stop_refuses_at_once_and_reports_at_rest() {
    let mut rig = Rig::new(config());
    let _ = rig.batch(&[steps(100_000)]);
    rig.run_for(1_000_000);
    rig.stop(StopMode::Decelerate);
    assert_eq!(rig.state(), NodeState::Stopped);
    assert_eq!(rig.queue().flush, 0, "it still moves");
    assert_eq!(rig.status().stop, None);
    let before = rig.position();
    let ack = rig.batch(&[steps(1)]);
    assert_eq!(ack.verdict, Verdict::Refused(Refusal::Stopped));
    let ack = rig.release(rig.queue());
    assert_eq!(ack.verdict, Verdict::Refused(Refusal::Stopped));
    rig.run_for(3_000_000);
    assert_eq!(rig.queue(), QUEUE_1);
    assert!(rig.position() > before);
    let report = rig.status().stop.expect("a report");
    assert_eq!(report.at, LocalMicros(1_000_000));
    assert_eq!(report.positions_steps[0], rig.position());
    assert_eq!(rig.state(), NodeState::Stopped);
}

#[test]
fn a_halt_overrides_a_deceleration_and_never_the_other_way() {
    let mut rig = Rig::new(config());
    let _ = rig.batch(&[steps(100_000)]);
    rig.run_for(1_000_000);
    rig.stop(StopMode::Decelerate);
    rig.run_for(1_000);
    rig.stop(StopMode::Halt);
    assert_eq!(rig.queue(), QUEUE_1);
    let at = rig.position();
    rig.stop(StopMode::Decelerate);
    rig.run_for(1_000_000);
    assert_eq!(rig.position(), at);
    assert_eq!(rig.queue(), QUEUE_1);
}

#[test]
fn a_latched_node_begins_no_other_queue() {
    let mut rig = Rig::new(config());
    rig.stop(StopMode::Halt);
    let report = rig.status().stop;
    for _ in 0..5 {
        rig.run_for(10_000);
        rig.stop(StopMode::Halt);
        rig.node.stop_pin(true, rig.now);
        rig.node.stop_pin(false, rig.now);
    }
    assert_eq!(rig.queue(), QUEUE_1);
    assert_eq!(rig.status().stop, report);
    let ack = rig.cancel(QUEUE_1, StopMode::Halt);
    assert_eq!(ack.verdict, Verdict::Refused(Refusal::Stopped));
    assert_eq!(rig.queue(), QUEUE_1);
}

#[test]
fn a_stop_during_a_cancel_latches() {
    let mut rig = Rig::new(config());
    let _ = rig.batch(&[steps(100_000)]);
    rig.run_for(1_000_000);
    let _ = rig.cancel(rig.queue(), StopMode::Decelerate);
    rig.run_for(1_000);
    rig.stop(StopMode::Decelerate);
    assert_eq!(rig.state(), NodeState::Stopped);
    rig.run_for(3_000_000);
    assert_eq!(rig.queue(), QUEUE_1);
    assert_eq!(rig.state(), NodeState::Stopped);
    let report = rig.status().stop.expect("a report");
    assert_eq!(report.reason, StopReason::Client);
    assert_eq!(report.at, LocalMicros(1_001_000));
}

#[test]
fn a_cancel_during_a_stop_lifts_nothing() {
    let mut rig = Rig::new(config());
    let _ = rig.batch(&[steps(100_000)]);
    rig.run_for(1_000_000);
    rig.stop(StopMode::Decelerate);
    let ack = rig.cancel(rig.queue(), StopMode::Decelerate);
    assert_eq!(ack.verdict, Verdict::Duplicate);
    rig.run_for(3_000_000);
    assert_eq!(rig.state(), NodeState::Stopped);
    assert_eq!(
        rig.status().stop.expect("a report").reason,
        StopReason::Client
    );
}

#[test]
fn a_release_that_is_older_than_a_stop_lifts_nothing() {
    let mut rig = Rig::new(config());
    rig.stop(StopMode::Halt);
    let old = rig.queue();
    assert_eq!(rig.release(old).verdict, Verdict::Accepted);
    assert_eq!(rig.state(), NodeState::Idle);
    assert_eq!(rig.release(old).verdict, Verdict::Duplicate);
    rig.stop(StopMode::Halt);
    let ack = rig.release(old);
    assert_eq!(ack.verdict, Verdict::Refused(Refusal::Stale));
    assert_eq!(rig.state(), NodeState::Stopped);
    assert_eq!(rig.release(ack.queue).verdict, Verdict::Accepted);
    assert_eq!(rig.state(), NodeState::Idle);
    assert_eq!(rig.batch(&[steps(5)]).verdict, Verdict::Accepted);
    rig.run_for(100_000);
    assert_eq!(rig.position(), 5);
}

#[test]
fn the_stop_input_holds_the_latch_while_it_is_active() {
    let mut rig = Rig::new(config());
    let _ = rig.batch(&[steps(1000)]);
    rig.run_for(10_000);
    rig.node.stop_pin(true, rig.now);
    assert_eq!(rig.state(), NodeState::Stopped);
    assert_eq!(rig.status().stop.expect("a report").reason, StopReason::Pin);
    let ack = rig.release(rig.queue());
    assert_eq!(ack.verdict, Verdict::Refused(Refusal::Stopped));
    rig.node.stop_pin(false, rig.now);
    assert_eq!(rig.state(), NodeState::Stopped);
    assert_eq!(rig.release(rig.queue()).verdict, Verdict::Accepted);
    assert_eq!(rig.state(), NodeState::Idle);
}

#[test]
fn a_fault_stops_at_once_and_outranks_the_reason() {
    let rig_node = |rig: &mut Rig| {
        let now = rig.now;
        rig.node.fault(FaultCode::COUNT_MISMATCH, now);
        rig.drain();
    };
    let mut rig = Rig::new(config());
    let _ = rig.batch(&[steps(100_000)]);
    rig.run_for(1_000_000);
    rig.stop(StopMode::Decelerate);
    rig_node(&mut rig);
    assert_eq!(rig.state(), NodeState::Fault);
    assert_eq!(
        rig.status().stop.expect("a report").reason,
        StopReason::Fault
    );
    assert_eq!(rig.status().faults[0].code, FaultCode::COUNT_MISMATCH);
    let mut rig = Rig::new(config());
    rig.stop(StopMode::Halt);
    rig_node(&mut rig);
    assert_eq!(rig.state(), NodeState::Fault);
    assert_eq!(rig.queue(), QUEUE_1);
    assert_eq!(rig.release(rig.queue()).verdict, Verdict::Accepted);
    assert_eq!(rig.state(), NodeState::Idle);
}

#[test]
fn every_stop_switches_the_laser_off() {
    for mode in [StopMode::Halt, StopMode::Decelerate] {
        let mut rig = Rig::new(config());
        let ack = rig.batch(&[
            Command::Laser { power_percent: 40 },
            steps(10_000),
            Command::Laser { power_percent: 80 },
        ]);
        assert_eq!(ack.verdict, Verdict::Accepted);
        rig.run_for(500_000);
        assert_eq!(rig.status().laser_percent, 40);
        assert_eq!(rig.node.node().outputs().laser_percent(), 40);
        rig.stop(mode);
        assert_eq!(rig.status().laser_percent, 0);
        assert_eq!(rig.node.node().outputs().laser_percent(), 0);
        rig.run_for(3_000_000);
        assert_eq!(rig.status().laser_percent, 0);
    }
    let mut rig = Rig::new(config());
    let _ = rig.batch(&[Command::Laser { power_percent: 40 }, steps(10_000)]);
    rig.run_for(500_000);
    let _ = rig.cancel(rig.queue(), StopMode::Decelerate);
    assert_eq!(rig.status().laser_percent, 0);
}

#[test]
fn whatever_the_stop_says_it_is_a_stop() {
    let mut rig = Rig::new(config());
    let _ = rig.batch(&[steps(1000)]);
    rig.run_for(10_000);
    rig.put(keys::NodeTopic::Stop, b"\xff{}");
    assert_eq!(rig.queue(), QUEUE_1);
}

#[test]
fn stops_and_orders_at_random_keep_position_and_queue_true() {
    for seed in 1..=60_u64 {
        let mut random = rig::random(seed);
        let mut rig = Rig::new(config());
        let mut flush_last = 0;
        for step in 0..60 {
            match random(10) {
                0 => rig.stop(StopMode::Halt),
                1 => rig.stop(StopMode::Decelerate),
                2 => {
                    let _ = rig.cancel(rig.queue(), StopMode::Decelerate);
                }
                3 | 4 => {
                    let _ = rig.release(rig.queue());
                }
                _ => {
                    let count = random(2_000) as i32 - 1_000;
                    if count != 0 {
                        let _ = rig.batch(&[steps(count), steps(7)]);
                    }
                }
            }
            rig.run_for(random(60_000));
            let flush = rig.queue().flush;
            assert!(flush >= flush_last, "seed {seed} step {step}");
            if flush != flush_last {
                let report = rig.status().stop.expect("a report");
                assert_eq!(report.queue.flush + 1, flush, "seed {seed} step {step}");
            }
            flush_last = flush;
            let _ = rig.position();
        }
        rig.run_for(20_000_000);
        let _ = rig.position();
        assert_ne!(rig.state(), NodeState::Running, "seed {seed}");
    }
}
