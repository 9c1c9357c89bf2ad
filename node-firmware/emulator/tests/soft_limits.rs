//! Soft limits: what would leave them does not begin, and a drive ends on them.

mod bench;

use bench::{
    Bench, config,
    motor::{Random, seeds},
};
use emulator::EmulatorConfig;
use keys::{
    AxisId, BatchAck, BatchHeader, Command, JobId, NodeTopic, StopReason, Verdict,
    batch::{BatchWriter, ORDER_BYTES_MAX, Refusal},
    command::{Ramp, RampShape},
    status::FaultCode,
    version,
};
use motion::{
    CommandError, Course, Direction, SoftLimits, Target,
    io::{home::HomeConfig, input::Switch},
};

const X: AxisId = AxisId(0);
const HOME_X: Command = Command::Home { axis: X };
const RAMP: Ramp = Ramp {
    speed_hz: 5_000,
    accel_hz_per_s: 50_000,
    shape: RampShape::Trapezoid {
        linear_steps: 0,
        jump_steps: 0,
    },
};

const fn limits(min_steps: i64, max_steps: i64, from_boot: bool) -> Option<SoftLimits> {
    Some(SoftLimits {
        min_steps,
        max_steps,
        from_boot,
    })
}

/// X is homed 300 steps below where it is switched on, and may go from 100 to 1,000 then.
fn homed() -> EmulatorConfig {
    let mut config = config();
    config.add_switch(X, Switch::Min, -300).expect("room");
    config.set_home(X, HomeConfig::min_switch(20_000));
    config.motion.soft_limits[0] = limits(100, 1_000, false);
    config
}

/// Y may go from −50 to 50 from boot on.
fn narrow() -> EmulatorConfig {
    let mut config = config();
    config.motion.soft_limits[1] = limits(-50, 50, true);
    config
}

fn by(axis: AxisId, steps: i32) -> Command {
    Command::Ramp {
        axis,
        steps,
        ramp: RAMP,
    }
}

fn to(axis: AxisId, position_steps: i64) -> Command {
    Command::RampTo {
        axis,
        position_steps,
        ramp: RAMP,
    }
}

fn name(axis: AxisId, position_steps: i64) -> Command {
    Command::SetPosition {
        axis,
        position_steps,
    }
}

impl Bench {
    /// What becomes of these commands as one batch.
    fn verdict(&mut self, commands: &[Command]) -> Verdict {
        self.drain();
        let status = self.node.status();
        let mut writer = BatchWriter::new();
        assert!(commands.iter().all(|command| writer.push(command)));
        let header = BatchHeader {
            queue: status.queue,
            first_command: status.accepted_commands,
            command_count: 0,
            job: JobId::new("k").expect("legal"),
            job_end: status.accepted_commands + commands.len() as u64,
        };
        let mut buffer = [0; ORDER_BYTES_MAX];
        let bytes = writer.finish(header, &mut buffer).expect("room").to_vec();
        self.node.handle(NodeTopic::Batch, &bytes, self.now);
        let sent = self.node.outbox(self.now);
        let ack = sent.iter().find(|sent| sent.topic == NodeTopic::Ack);
        let ack: BatchAck = version::decode(&ack.expect("an answer").payload).expect("an ack");
        self.job_end = self.node.status().accepted_commands;
        ack.verdict
    }

    fn positions(&self) -> [i64; 2] {
        [0, 1].map(|axis| self.node.position_steps(AxisId(axis)))
    }
}

const fn refused(index: u16) -> Verdict {
    Verdict::Refused(Refusal::OutOfReach { index })
}

#[test]
fn what_would_leave_is_refused_with_its_place_and_nothing_moves() {
    const Y: AxisId = AxisId(1);
    let mut bench = Bench::new(narrow());
    let line = |steps| Command::Line {
        steps: [10, steps, 0, 0],
        speed_hz: 1_000,
        accel_hz_per_s: 10_000,
        jerk_hz_per_s2: 0,
    };
    for (commands, index) in [
        (vec![by(Y, 51)], 0),
        (vec![by(Y, 50), by(Y, 1)], 1),
        (vec![by(Y, -50), by(X, 900), by(Y, 101)], 2),
        (vec![to(Y, -51)], 0),
        (vec![line(30), line(21)], 1),
        (vec![by(Y, 50), name(Y, 0), by(Y, 51)], 2),
        (
            vec![Command::SyncMove {
                delay_us: [100; 2],
                steps: [1, -51],
            }],
            0,
        ),
    ] {
        assert_eq!(bench.verdict(&commands), refused(index), "{commands:?}");
        bench.run_for(10_000);
    }
    assert_eq!(bench.positions(), [0, 0]);
    // What was accepted before counts, too, whether or not it has been executed.
    assert_eq!(bench.verdict(&[by(Y, 40), line(10)]), Verdict::Accepted);
    assert_eq!(bench.verdict(&[by(Y, 1)]), refused(0));
    assert_eq!(bench.verdict(&[by(Y, -100)]), Verdict::Accepted);
    bench.run_to_rest();
    assert_eq!(bench.positions(), [10, -50]);
    assert_eq!(bench.verdict(&[by(Y, -1)]), refused(0));
    bench.run_for(3_000_000);
    let told = "command 3: axis 1 would move to -51, beyond its soft limit -50";
    assert!(
        bench.lines.iter().any(|line| line == told),
        "{:?}",
        bench.lines
    );
    bench.judged();
}

#[test]
fn limits_count_when_the_axis_is_homed_and_stay_with_the_machine() {
    let mut bench = Bench::new(homed());
    // Not homed: nobody knows where 1,000 is.
    assert_eq!(
        bench.verdict(&[by(X, 1_500), by(X, -1_500)]),
        Verdict::Accepted
    );
    bench.run_to_rest();
    assert_eq!(bench.verdict(&[HOME_X]), Verdict::Accepted);
    bench.run_to_rest();
    assert_eq!(bench.positions(), [200, 0]);
    assert_eq!(bench.verdict(&[to(X, 1_001)]), refused(0));
    assert_eq!(bench.verdict(&[to(X, 99)]), refused(0));
    // Another name for the place moves no limit.
    assert_eq!(
        bench.verdict(&[name(X, 0), to(X, 800), to(X, -100)]),
        Verdict::Accepted
    );
    assert_eq!(bench.verdict(&[to(X, 801)]), refused(0));
    bench.run_to_rest();
    assert_eq!(bench.positions(), [-100, 0]);
    bench.judged();
}

#[test]
fn behind_a_homing_it_is_found_when_its_turn_comes() {
    let mut bench = Bench::new(homed());
    assert_eq!(
        bench.verdict(&[HOME_X, to(X, 1_000), to(X, 1_001)]),
        Verdict::Accepted
    );
    bench.run_for(5_000_000);
    let stop = bench.node.status().stop.expect("it stopped");
    assert_eq!(
        (stop.reason, stop.executed_commands),
        (StopReason::Limit, 2)
    );
    assert_eq!(bench.positions(), [1_000, 0]);
    let faults = bench.node.status().faults;
    assert_eq!(faults.last().expect("a fault").code, FaultCode::LIMIT);
    let told = "axis 0: command 2 would move it to 1001, beyond its soft limit 1000; it is at 1000";
    assert!(
        bench.lines.iter().any(|line| line == told),
        "{:?}",
        bench.lines
    );
    bench.judged();
}

#[test]
fn from_outside_only_the_way_back_is_open() {
    let mut config = homed();
    config.motion.soft_limits[0] = limits(500, 1_000, false);
    let mut bench = Bench::new(config);
    assert_eq!(bench.verdict(&[HOME_X]), Verdict::Accepted);
    bench.run_to_rest();
    assert_eq!(bench.positions(), [200, 0]);
    assert_eq!(bench.verdict(&[by(X, -1)]), refused(0));
    assert_eq!(bench.verdict(&[by(X, 100), by(X, 300)]), Verdict::Accepted);
    bench.run_to_rest();
    assert_eq!(bench.positions(), [600, 0]);
    bench.judged();
}

#[test]
fn a_drive_ends_on_the_limit() {
    const Y: AxisId = AxisId(1);
    for (target, end) in [
        (Target::Forever(Direction::Positive), 50),
        (Target::Forever(Direction::Negative), -50),
        (Target::To(51), 50),
        (Target::By(-900), -50),
        (Target::To(-7), -7),
    ] {
        let mut bench = Bench::new(narrow());
        let motion = bench.node.node_mut().motion_mut();
        let how = Course::hz(1_000, 20_000);
        motion.drive(Y, target, how).expect("free");
        bench.run_for(500_000);
        assert_eq!(bench.positions(), [0, end], "{target:?}");
        let motion = bench.node.node_mut().motion_mut();
        assert!(!motion.is_driving());
        let none = motion.drive(AxisId(2), target, how);
        assert_eq!(none, Err(CommandError::Axis(AxisId(2)).into()));
    }
}

#[test]
fn a_drive_that_is_told_to_accelerate_less_still_ends_inside() {
    const X: AxisId = AxisId(0);
    let fast = Course::hz(10_000, 100_000);
    for (gentle, target) in [
        // By these alone it would need 5,000 steps to rest, or 50 million.
        (
            Course::hz(10_000, 10_000),
            Target::Forever(Direction::Positive),
        ),
        (Course::hz(10_000, 1), Target::Forever(Direction::Positive)),
        (Course::hz(200, 1), Target::To(1_500)),
        // Back: it turns inside, too.
        (Course::hz(10_000, 1_000), Target::To(0)),
        (
            Course::hz(5_000, 10_000).shaped(RampShape::Jerk {
                jerk_hz_per_s2: 20_000,
            }),
            Target::To(1_400),
        ),
    ] {
        for at_us in [60_000, 100_000, 190_000, 240_000] {
            let mut config = config();
            config.motion.soft_limits[0] = limits(-100, 2_000, true);
            let mut bench = Bench::new(config);
            let motion = bench.node.node_mut().motion_mut();
            motion
                .drive(X, Target::Forever(Direction::Positive), fast)
                .expect("free");
            bench.run_for(at_us);
            let motion = bench.node.node_mut().motion_mut();
            motion.drive(X, target, gentle).expect("free");
            let mut waits = 0;
            let mut farthest = 0;
            while bench.node.node_mut().motion_mut().is_driving() && waits < 20_000 {
                bench.run_for(10_000);
                farthest = farthest.max(bench.positions()[0]);
                waits += 1;
                // The way back is as slow as it was asked for.
                if waits > 200 {
                    bench.run_for(1_000_000);
                }
            }
            let what = format!("{gentle:?} to {target:?} at {at_us} µs");
            assert!(farthest <= 2_000, "{what}: at {farthest}");
            let end = match target {
                Target::To(end) => end,
                _ => 2_000,
            };
            assert_eq!(bench.positions()[0], end, "{what}");
        }
    }
}

#[test]
fn random_jobs_never_leave() {
    for seed in seeds(5) {
        println!("seed {seed}");
        random_jobs(Random(seed ^ 0x11317));
    }
}

fn random_jobs(mut numbers: Random) {
    const Y: AxisId = AxisId(1);
    let mut bench = Bench::new(narrow());
    let mut random = |below: u64| numbers.below(below);
    let (mut taken, mut left_out) = (0, 0);
    // Where Y really is, and what its name for 0 is: by addition alone.
    let (mut place, mut zero) = (0_i64, 0_i64);
    for _ in 0..300 {
        let way = random(121) as i64 - 60;
        let here = place + zero;
        let (command, steps) = match random(3) {
            0 => (to(Y, way), way - here),
            1 => (by(Y, way as i32), way),
            _ => (name(Y, way), 0),
        };
        if command == by(Y, 0) {
            continue;
        }
        let end = here + steps;
        let leaves = (steps > 0 && end > 50) || (steps < 0 && end < -50);
        let verdict = bench.verdict(&[command]);
        let expected = if leaves {
            refused(0)
        } else {
            Verdict::Accepted
        };
        assert_eq!(verdict, expected, "{command:?} at {here}");
        if verdict == Verdict::Accepted {
            taken += 1;
            place += steps;
            // Y is not homed: its limits go by the names.
            if let Command::SetPosition { .. } = command {
                zero = way - place;
            }
            bench.run_to_rest();
            assert_eq!(bench.positions()[1], place + zero);
        } else {
            left_out += 1;
        }
    }
    assert!(taken > 60 && left_out > 20, "{taken} {left_out}");
    bench.judged();
}
