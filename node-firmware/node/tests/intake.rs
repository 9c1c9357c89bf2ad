//! Orders are taken whole or not at all, and never twice.

mod rig;

use keys::{
    AxisId, BatchHeader, Command, NodeState, Order, QueueId, Refusal, StopMode, Verdict,
    batch::BATCH_COMMANDS_MAX,
};
use rig::{BOOT, Rig, batch_bytes, config, job, steps};

#[test]
fn a_batch_is_taken_and_executed_to_its_last_pulse() {
    let mut rig = Rig::new(config());
    let ack = rig.batch(&[steps(1000), steps(-400)]);
    assert_eq!(ack.verdict, Verdict::Accepted);
    assert_eq!(ack.accepted_commands, 2);
    assert_eq!(ack.executed_commands, 0);
    assert_eq!(
        ack.queue,
        QueueId {
            boot: BOOT,
            flush: 0
        }
    );
    assert_eq!(rig.state(), NodeState::Running);
    assert_eq!(rig.status().job, Some(job("j")));
    rig.run_for(1_000_000);
    assert_eq!(rig.position(), 600);
    assert_eq!(rig.status().executed_commands, 2);
    assert_eq!(rig.state(), NodeState::Idle);
    assert_eq!(rig.status().job, None);
}

#[test]
fn the_same_batch_again_has_no_second_effect() {
    let mut rig = Rig::new(config());
    let header = rig.next_header(2);
    let bytes = batch_bytes(header, &[steps(300), steps(200)]);
    assert_eq!(rig.order_bytes(&bytes).verdict, Verdict::Accepted);
    for _ in 0..3 {
        let ack = rig.order_bytes(&bytes);
        assert_eq!(ack.verdict, Verdict::Duplicate);
        assert_eq!(ack.accepted_commands, 2);
        rig.run_for(20_000);
    }
    rig.run_for(1_000_000);
    assert_eq!(rig.position(), 500);
    assert_eq!(rig.order_bytes(&bytes).verdict, Verdict::Duplicate);
    rig.run_for(1_000_000);
    assert_eq!(rig.position(), 500);
}

#[test]
fn a_batch_that_leaves_a_gap_or_overlaps_is_refused() {
    let mut rig = Rig::new(config());
    let _ = rig.batch(&[steps(1), steps(1), steps(1)]);
    let header = rig.next_header(2);
    for (first_command, refusal) in [(4, Refusal::Gap), (2, Refusal::Overlap)] {
        let header = BatchHeader {
            first_command,
            job_end: 10,
            ..header
        };
        let ack = rig.order_bytes(&batch_bytes(header, &[steps(5), steps(5)]));
        assert_eq!(ack.verdict, Verdict::Refused(refusal));
        assert_eq!(ack.accepted_commands, 3);
    }
    rig.run_for(1_000_000);
    assert_eq!(rig.position(), 3);
}

#[test]
fn a_batch_for_another_queue_is_stale() {
    let mut rig = Rig::new(config());
    let header = rig.next_header(1);
    for queue in [
        QueueId {
            boot: BOOT + 1,
            flush: 0,
        },
        QueueId {
            boot: BOOT,
            flush: 1,
        },
    ] {
        let ack = rig.order_bytes(&batch_bytes(BatchHeader { queue, ..header }, &[steps(5)]));
        assert_eq!(ack.verdict, Verdict::Refused(Refusal::Stale));
        assert_eq!(
            ack.queue,
            QueueId {
                boot: BOOT,
                flush: 0
            }
        );
    }
    rig.run_for(100_000);
    assert_eq!(rig.position(), 0);
}

#[test]
fn a_late_batch_after_a_stop_and_release_is_stale() {
    let mut rig = Rig::new(config());
    let late = batch_bytes(rig.next_header(1), &[steps(50)]);
    rig.stop(StopMode::Halt);
    let ack = rig.order_bytes(&late);
    assert_eq!(ack.verdict, Verdict::Refused(Refusal::Stale));
    let ack = rig.release(ack.queue);
    assert_eq!(ack.verdict, Verdict::Accepted);
    assert_eq!(
        rig.order_bytes(&late).verdict,
        Verdict::Refused(Refusal::Stale)
    );
    rig.run_for(1_000_000);
    assert_eq!(rig.position(), 0);
}

#[test]
fn a_batch_that_does_not_fit_leaves_the_ring_as_it_was() {
    let mut small = config();
    small.ring_commands = 16;
    let mut rig = Rig::new(small);
    // One long command keeps the planner busy, so that the ring fills.
    assert_eq!(rig.batch(&[steps(1_000_000)]).verdict, Verdict::Accepted);
    let mut taken = 0;
    let ack = loop {
        let ack = rig.batch(&[steps(1); 5]);
        if ack.verdict != Verdict::Accepted {
            break ack;
        }
        taken += 5;
    };
    assert_eq!(ack.verdict, Verdict::Refused(Refusal::QueueShort));
    assert!(ack.credit_commands < 5);
    assert_eq!(ack.accepted_commands, 1 + taken);
    let fits = ack.credit_commands as usize;
    if fits > 0 {
        assert_eq!(rig.batch(&vec![steps(1); fits]).verdict, Verdict::Accepted);
    }
    rig.run_for(101_000_000);
    assert_eq!(rig.position(), 1_000_000 + taken as i64 + fits as i64);
}

#[test]
fn a_malformed_batch_leaves_the_ring_untouched() {
    let mut rig = Rig::new(config());
    let header = rig.next_header(4);
    let commands = [
        steps(10),
        Command::Pause { pause_ms: 3 },
        steps(20),
        steps(30),
    ];
    let good = batch_bytes(header, &commands);
    let credit = rig.status().credit_commands;
    let mut check = |bytes: &[u8]| {
        let ack = rig.order_bytes(bytes);
        assert_eq!(
            ack.verdict,
            Verdict::Refused(Refusal::Malformed),
            "{bytes:02x?}"
        );
        assert_eq!(ack.accepted_commands, 0);
        assert_eq!(ack.credit_commands, credit);
    };
    for end in 0..good.len() {
        check(&good[..end]);
    }
    let mut longer = good.clone();
    longer.push(0);
    check(&longer);
    let mut other_version = good.clone();
    other_version[0] = 99;
    check(&other_version);
    check(&vec![1; 4096]);
    let too_many = BATCH_COMMANDS_MAX as u64 + 1;
    for header in [
        BatchHeader {
            job_end: 3,
            ..header
        },
        BatchHeader {
            first_command: u64::MAX - 1,
            job_end: u64::MAX,
            ..header
        },
    ] {
        check(&batch_bytes(header, &commands));
    }
    check(&batch_bytes(
        BatchHeader {
            job_end: too_many,
            ..header
        },
        &[],
    ));
    assert_eq!(rig.order_bytes(&good).verdict, Verdict::Accepted);
    rig.run_for(1_000_000);
    assert_eq!(rig.position(), 60);
}

#[test]
fn random_bytes_are_answered_and_move_nothing() {
    let seed = 0x5eed;
    let mut state: u64 = seed;
    let mut random = || {
        state ^= state << 13;
        state ^= state >> 7;
        state ^= state << 17;
        state
    };
    let mut rig = Rig::new(config());
    let good = batch_bytes(rig.next_header(3), &[steps(10), steps(20), steps(30)]);
    for round in 0..3_000 {
        let mut bytes = good.clone();
        // The boot number is bytes 2 and on; a changed one makes the batch stale at the latest.
        bytes[2] ^= 0x40;
        for _ in 0..random() % 4 {
            let at = 3 + random() as usize % (bytes.len() - 3);
            bytes[at] = random() as u8;
        }
        let ack = rig.order_bytes(&bytes);
        assert!(
            matches!(ack.verdict, Verdict::Refused(_)),
            "seed {seed:#x} round {round}: {:?} for {bytes:02x?}",
            ack.verdict
        );
    }
    rig.run_for(1_000_000);
    assert_eq!(rig.position(), 0);
}

#[test]
fn a_bad_command_is_named_and_nothing_of_its_batch_is_done() {
    let mut rig = Rig::new(config());
    let bad = [
        Command::Move {
            axis: AxisId(2),
            delay_us: 100,
            steps: 1,
        },
        Command::Move {
            axis: AxisId(0),
            delay_us: 0,
            steps: 1,
        },
        Command::Move {
            axis: AxisId(0),
            delay_us: 100,
            steps: 0,
        },
        Command::Laser { power_percent: 101 },
        Command::Home { axis: AxisId(0) },
    ];
    for bad in bad {
        let ack = rig.batch(&[steps(5), steps(5), bad, steps(5)]);
        assert_eq!(
            ack.verdict,
            Verdict::Refused(Refusal::BadCommand { index: 2 }),
            "{bad:?}"
        );
        assert_eq!(ack.accepted_commands, 0);
    }
    rig.run_for(1_000_000);
    assert_eq!(rig.position(), 0);
}

#[test]
fn credit_grows_only_and_what_it_promises_is_taken() {
    for seed in 1..=20_u64 {
        let mut random = rig::random(seed);
        let mut small = config();
        small.ring_commands = 64;
        let mut rig = Rig::new(small);
        let total = 1_000;
        let mut promised = 64;
        let mut sent = 0;
        let mut position = 0;
        let mut rounds = 0;
        while sent < total {
            rounds += 1;
            assert!(rounds < 100_000, "seed {seed}: stuck at {sent}");
            let room = (promised - sent).min(total - sent).min(20);
            if room > 0 {
                let count = 1 + random(room) as usize;
                let commands: Vec<_> = (0..count).map(|_| steps(1 + random(20) as i32)).collect();
                position += commands
                    .iter()
                    .map(|command| match command {
                        Command::Move { steps, .. } => i64::from(*steps),
                        _ => 0,
                    })
                    .sum::<i64>();
                let header = BatchHeader {
                    job_end: total,
                    ..rig.next_header(count)
                };
                let ack = rig.order_bytes(&batch_bytes(header, &commands));
                assert_eq!(ack.verdict, Verdict::Accepted, "seed {seed} at {sent}");
                sent += count as u64;
            }
            let before = rig.sent.len();
            rig.run_for(random(20_000));
            // Only acks may promise here: without the unasked ones this would get stuck.
            for (_, ack) in rig.acks() {
                let limit = ack.accepted_commands + u64::from(ack.credit_commands);
                promised = promised.max(limit);
            }
            let mut last = 0;
            for (_, ack) in rig.acks() {
                let limit = ack.accepted_commands + u64::from(ack.credit_commands);
                assert!(limit >= last, "seed {seed}: the promise shrank");
                last = limit;
            }
            rig.sent.drain(..before);
        }
        rig.run_for(5_000_000);
        assert_eq!(rig.position(), position, "seed {seed}");
        assert_eq!(rig.status().executed_commands, total, "seed {seed}");
    }
}

#[test]
fn a_complete_job_is_not_told_credit() {
    let mut small = config();
    small.ring_commands = 16;
    let mut rig = Rig::new(small);
    assert_eq!(rig.batch(&[steps(100); 16]).verdict, Verdict::Accepted);
    rig.run_for(1_000_000);
    assert_eq!(rig.acks().len(), 1);
}

#[test]
fn a_cancel_drops_the_queue_without_a_latch() {
    let mut rig = Rig::new(config());
    let queue = rig.queue();
    let _ = rig.batch(&[steps(1000), steps(1000)]);
    rig.run_for(50_000);
    let ack = rig.cancel(queue, StopMode::Halt);
    assert_eq!(ack.verdict, Verdict::Accepted);
    assert_eq!(
        ack.queue,
        QueueId {
            boot: BOOT,
            flush: 1
        }
    );
    assert_eq!(rig.state(), NodeState::Idle);
    let at = rig.position();
    assert!((495..=505).contains(&at), "{at}");
    let report = rig.status().stop.expect("a report");
    assert_eq!(report.queue, queue);
    assert_eq!(report.reason, keys::StopReason::Cancel);
    assert_eq!(report.accepted_commands, 2);
    assert_eq!(report.executed_commands, 0);
    assert_eq!(report.positions_steps[0], at);
    assert_eq!(
        rig.cancel(queue, StopMode::Halt).verdict,
        Verdict::Duplicate
    );
    assert_eq!(rig.queue(), ack.queue);
    assert_eq!(rig.batch(&[steps(10)]).verdict, Verdict::Accepted);
    rig.run_for(1_000_000);
    assert_eq!(rig.position(), at + 10);
}

#[test]
fn a_cancel_that_comes_after_the_last_pulse_says_that_all_was_done() {
    let mut rig = Rig::new(config());
    let queue = rig.queue();
    let _ = rig.batch(&[steps(10)]);
    rig.run_for(100_000);
    let ack = rig.cancel(queue, StopMode::Decelerate);
    assert_eq!(ack.verdict, Verdict::Accepted);
    let report = rig.status().stop.expect("a report");
    assert_eq!((report.accepted_commands, report.executed_commands), (1, 1));
    assert_eq!(
        rig.queue(),
        QueueId {
            boot: BOOT,
            flush: 1
        }
    );
}

#[test]
fn a_cancel_for_another_queue_does_nothing() {
    let mut rig = Rig::new(config());
    let _ = rig.batch(&[steps(100)]);
    for queue in [
        QueueId {
            boot: BOOT + 1,
            flush: 0,
        },
        QueueId {
            boot: BOOT,
            flush: 1,
        },
    ] {
        let ack = rig.cancel(queue, StopMode::Halt);
        assert_eq!(ack.verdict, Verdict::Refused(Refusal::Stale));
    }
    rig.run_for(1_000_000);
    assert_eq!(rig.position(), 100);
}

#[test]
fn a_batch_during_a_cancel_is_stale() {
    let mut rig = Rig::new(config());
    let queue = rig.queue();
    let _ = rig.batch(&[steps(100_000)]);
    rig.run_for(1_000_000);
    let ack = rig.cancel(queue, StopMode::Decelerate);
    assert_eq!(ack.verdict, Verdict::Accepted);
    assert_eq!(rig.queue(), queue, "it still moves");
    assert_eq!(rig.state(), NodeState::Running);
    let ack = rig.batch(&[steps(5)]);
    assert_eq!(ack.verdict, Verdict::Refused(Refusal::Stale));
    let again = rig.order(&Order::Cancel {
        queue,
        mode: StopMode::Decelerate,
    });
    assert_eq!(again.verdict, Verdict::Duplicate);
    rig.run_for(2_000_000);
    assert_eq!(
        rig.queue(),
        QueueId {
            boot: BOOT,
            flush: 1
        }
    );
    assert_eq!(rig.state(), NodeState::Idle);
    assert_eq!(
        rig.status().stop.expect("a report").positions_steps[0],
        rig.position()
    );
}
