//! Direction pins behind a shift register: nothing steps before what was read back confirms them.

mod bench;

use bench::{
    Bench, config,
    motor::{Random, keeps_limits, seeds, steps_of},
};
use emulator::{EmulatorConfig, oracle, pins::Pin, record::Life};
use keys::{
    AxisId, Command, LocalMicros, NodeState, StopMode,
    command::{Ramp, RampShape},
    status::{Fault, FaultCode},
};
use motion::{
    ConfigCd, Course, ShiftConfig, TICKS_PER_US, Target,
    io::{input::Switch, shift::RETRIES_MAX},
};

const X: AxisId = AxisId(0);
const Y: AxisId = AxisId(1);

/// X turns by pin 2, low for positive, Y by itself.
fn shifted() -> EmulatorConfig {
    let mut config = config();
    config.motion.axes[0].direction_inverted = true;
    let mut shift = ShiftConfig {
        pin_count: 8,
        ..ShiftConfig::default()
    };
    shift.direction_pins[0] = Some(2);
    config.motion.shift = Some(shift);
    config
}

fn ramp(steps: i32) -> Command {
    Command::Ramp {
        axis: X,
        steps,
        ramp: Ramp {
            speed_hz: 5_000,
            accel_hz_per_s: 50_000,
            shape: RampShape::Trapezoid {
                linear_steps: 0,
                jump_steps: 0,
            },
        },
    }
}

fn line(steps: [i32; 2]) -> Command {
    Command::Line {
        steps: [steps[0], steps[1], 0, 0],
        speed_hz: 4_000,
        accel_hz_per_s: 60_000,
        jerk_hz_per_s2: 0,
    }
}

fn raw(steps: i32) -> Command {
    Command::Move {
        axis: X,
        delay_us: 150,
        steps,
    }
}

/// Counts at the pins what the directions made of the steps.
fn counted(life: &Life, axis: AxisId, inverted: bool) -> i64 {
    let mut positive = inverted;
    let mut count = 0;
    for edge in &life.edges {
        match edge.pin {
            Pin::Direction(of) if of == axis => positive = edge.level != inverted,
            Pin::Step(of) if of == axis && edge.level => count += if positive { 1 } else { -1 },
            _ => {}
        }
    }
    count
}

fn pins_are_right(bench: &Bench, what: &str) -> Life {
    let life = bench.node.life();
    assert_eq!(
        bench.node.position_steps(X),
        counted(&life, X, true),
        "{what}"
    );
    assert_eq!(
        bench.node.position_steps(Y),
        counted(&life, Y, false),
        "{what}"
    );
    assert_eq!(bench.node.step_count(X), counted(&life, X, true), "{what}");
    if let Err(violations) = oracle::check_pins(&life) {
        panic!("{what}: {violations:?}");
    }
    life
}

#[test]
fn nothing_steps_before_the_register_confirms_the_direction() {
    for errors in [0_u32, 3] {
        let mut bench = Bench::new(shifted());
        bench.run_until(50_000);
        bench.order([ramp(200), ramp(100), ramp(-80)]);
        bench.run_for(30_000);
        // The word for the turn is read back wrong so many times.
        bench.node.disturb_shift(errors);
        bench.run_to_rest();
        assert_eq!(bench.node.position_steps(X), 220, "{errors}");
        let life = pins_are_right(&bench, "");
        let turns: Vec<_> = life
            .edges
            .iter()
            .filter(|edge| edge.pin == Pin::Direction(X))
            .collect();
        let steps = steps_of(&life, X);
        let last_turn = turns.last().expect("it turned").at_ticks;
        let first_back = (steps[300].0 * 16e6).round() as u64;
        assert!(first_back > last_turn, "{errors}");
        // 100 µs for each word on its way, 1 ms before each that is sent again.
        let before = (steps[299].0 * 16e6).round() as u64;
        let waited = (first_back - before) / TICKS_PER_US;
        let least = 100 + u64::from(errors) * 1_100;
        assert!(waited >= least, "{errors}: {waited} of {least} µs");
        let faults = bench.node.status().faults;
        assert!(faults.is_empty(), "{errors}: {faults:?}");
    }
}

#[test]
fn what_goes_on_in_one_direction_never_waits() {
    let run = |config: EmulatorConfig| {
        let mut bench = Bench::new(config);
        bench.run_until(50_000);
        bench.order([
            line([100, 50]),
            line([100, -50]),
            line([100, 70]),
            raw(30),
            ramp(500),
        ]);
        bench.run_to_rest();
        let life = pins_are_right(&bench, "");
        let steps = steps_of(&life, X);
        steps[steps.len() - 1].0 - steps[0].0
    };
    let external = run(shifted());
    let mut own = shifted();
    own.motion.shift = None;
    assert!((external - run(own)).abs() < 1e-6, "{external}");
}

#[test]
fn a_path_rests_at_the_corner_where_such_an_axis_turns() {
    let mut bench = Bench::new(shifted());
    let path = [
        [90, 200],
        [40, 200],
        [-3, 200],
        [0, 200],
        [50, 200],
        [50, 200],
    ];
    bench.order(path.map(line));
    bench.run_to_rest();
    let life = pins_are_right(&bench, "");
    assert_eq!(bench.node.position_steps(X), 227);
    assert_eq!(bench.node.position_steps(Y), 1_200);
    keeps_limits(&life, X, 4_000.0, 60_000.0, 200.0, "");
    keeps_limits(&life, Y, 4_000.0, 60_000.0, 200.0, "");
}

#[test]
fn a_drive_turns_behind_its_confirmation_while_another_axis_moves_on() {
    let mut bench = Bench::new(shifted());
    let motion = |bench: &mut Bench, axis, target, hz| {
        let motion = bench.node.node_mut().motion_mut();
        motion
            .drive(axis, target, Course::hz(hz, 40_000))
            .expect("free");
    };
    motion(&mut bench, Y, Target::To(100_000), 9_000);
    motion(&mut bench, X, Target::To(3_000), 4_000);
    bench.run_for(400_000);
    bench.node.disturb_shift(2);
    motion(&mut bench, X, Target::To(-500), 4_000);
    bench.run_for(3_000_000);
    assert_eq!(bench.node.position_steps(X), -500);
    assert!(
        bench.node.node_mut().motion_mut().is_driven(Y),
        "Y moves on"
    );
    motion(&mut bench, X, Target::To(40), 4_000);
    bench.run_for(20_000_000);
    assert_eq!(bench.node.position_steps(X), 40);
    assert_eq!(bench.node.position_steps(Y), 100_000);
    let life = pins_are_right(&bench, "");
    keeps_limits(&life, X, 4_000.0, 40_000.0, 0.0, "");
    keeps_limits(&life, Y, 9_000.0, 40_000.0, 0.0, "");
}

#[test]
fn a_register_that_does_not_turn_an_axis_is_a_fault_and_nothing_steps() {
    let mut bench = Bench::new(shifted());
    bench.run_until(50_000);
    bench.order([ramp(-50)]);
    bench.run_to_rest();
    bench.node.disturb_shift(100);
    bench.order([ramp(100)]);
    bench.run_for(3_000_000);
    let status = bench.node.status();
    assert_eq!(status.state, NodeState::Fault);
    assert_eq!(status.faults[0].code, FaultCode::SHIFT_REGISTER);
    assert_eq!(bench.node.step_count(X), -50);
    bench.node.disturb_shift(0);
    bench.release();
    bench.order([ramp(100), ramp(-20)]);
    bench.run_to_rest();
    assert_eq!(bench.node.step_count(X), 30);
    pins_are_right(&bench, "");
}

#[test]
fn c_and_d_turn_by_the_register_too() {
    let mut config = config();
    let mut shift = ShiftConfig {
        pin_count: 16,
        ..ShiftConfig::default()
    };
    (shift.direction_pins[4], shift.direction_pins[5]) = (Some(9), Some(10));
    config.motion.shift = Some(shift);
    config.motion.cd = Some(ConfigCd::default());
    config.motion.cd.as_mut().expect("it is set").d.has_min = false;
    config.motion.cd.as_mut().expect("it is set").d.has_max = false;
    let mut bench = Bench::new(config);
    bench.run_until(50_000);
    bench.order([
        Command::MoveC { index: 2 },
        Command::MoveD { on: true },
        Command::MoveC { index: 1 },
        Command::MoveD { on: false },
    ]);
    bench.run_for(60_000_000);
    let status = bench.node.node_mut().motion_mut();
    let status = status.status_cd().expect("it has them").to_string();
    assert_eq!(status, "C: POS1 (25.0mm) D: OFF");
    let life = bench.node.life();
    let turned = |pin| {
        life.edges
            .iter()
            .filter(move |edge| edge.pin == pin)
            .count()
    };
    assert_eq!((turned(Pin::DirectionC), turned(Pin::DirectionD)), (2, 2));
    let counted = life
        .edges
        .iter()
        .fold((0_i64, false), |(count, up), edge| match edge.pin {
            Pin::DirectionC => (count, edge.level),
            Pin::StepC if edge.level => (count + if up { 1 } else { -1 }, up),
            _ => (count, up),
        });
    let backend = bench.node.node_mut().motion_mut().backend_mut();
    assert_eq!(motion::StepBackend::counted_c(backend), counted.0);
    assert!(counted.0 > 0);
}

#[test]
fn an_axis_behind_the_register_is_homed() {
    let mut config = shifted();
    config.add_switch(X, Switch::Min, -300).expect("room");
    config.set_home(X, motion::io::home::HomeConfig::min_switch(20_000));
    let mut bench = Bench::new(config);
    bench.order([ramp(50), Command::Home { axis: X }, ramp(-30), ramp(100)]);
    bench.run_to_rest();
    assert_eq!(bench.node.place_steps(X), -30);
    bench.judged();
}

#[test]
fn what_is_held_is_not_turned_for_the_command_behind_it() {
    for first in [raw(85), ramp(85), line([85, 20])] {
        let mut bench = Bench::new(shifted());
        bench.order([first, ramp(-93)]);
        bench.run_until(9_000);
        let motion = bench.node.node_mut().motion_mut();
        motion.hold(motion::Ticks(9_000 * TICKS_PER_US));
        // Long enough to turn.
        bench.run_for(100_000);
        let held = bench.node.position_steps(X);
        assert!((1..85).contains(&held), "{first:?}: {held}");
        bench.node.node_mut().motion_mut().resume();
        bench.run_to_rest();
        assert_eq!(bench.node.position_steps(X), 85 - 93, "{first:?}");
        pins_are_right(&bench, "");
    }
}

#[test]
fn what_is_resumed_just_as_it_comes_to_rest_has_not_run_dry() {
    for resume_us in (3_000..9_000).step_by(20) {
        let mut bench = Bench::new(shifted());
        bench.run_until(50_000);
        // The second one is planned at rest only: it turns.
        bench.order([raw(30), raw(-12)]);
        bench.run_for(2_000);
        let now = motion::Ticks(bench.now.0 * TICKS_PER_US);
        bench.node.node_mut().motion_mut().hold(now);
        bench.run_for(resume_us - 2_000);
        resume(&mut bench);
        bench.run_to_rest();
        assert_eq!(bench.node.position_steps(X), 18, "{resume_us}");
        let faults = bench.node.status().faults;
        assert!(faults.is_empty(), "{resume_us}: {faults:?}");
    }
}

#[test]
fn a_node_that_is_not_polled_while_a_word_is_out_has_not_tried_in_vain() {
    let mut bench = Bench::new(shifted());
    bench.run_until(50_000);
    bench.order([ramp(-50)]);
    // The word is out; for 300 ms nobody looks, and then the answer comes.
    let late = LocalMicros(bench.now.0 + 300_000);
    bench.node.node_mut().poll(late);
    bench.now = late;
    bench.run_to_rest();
    assert_eq!(bench.node.position_steps(X), -50);
    let faults = bench.node.status().faults;
    assert!(faults.is_empty(), "{faults:?}");
}

/// Goes on, and lets the node see at once what there is to be done, as its own resumption does.
fn resume(bench: &mut Bench) {
    bench.node.node_mut().motion_mut().resume();
    bench.run_for(0);
}

#[test]
fn random_moves_holds_and_stops_keep_position_and_count() {
    for seed in seeds(2_000) {
        println!("seed {seed}");
        let mut random = Random(seed ^ 0x7075);
        let mut bench = Bench::new(shifted());
        let commands: Vec<_> = (0..3 + random.below(20))
            .map(|_| {
                let mut way = || random.below(200) as i32 - 100;
                let steps = [way() | 1, way()];
                match random.below(3) {
                    0 => line(steps),
                    1 => ramp(steps[0]),
                    _ => raw(steps[0]),
                }
            })
            .collect();
        let end = oracle::positions_after(&commands, 2);
        bench.order(commands);
        let mut stopped = false;
        for _ in 0..random.below(5) {
            bench.run_for(random.of_size(18));
            match random.below(5) {
                0 | 1 => bench.node.disturb_shift(random.below(4) as u32),
                2 => bench
                    .node
                    .node_mut()
                    .motion_mut()
                    .hold(motion::Ticks(u64::MAX)),
                3 => resume(&mut bench),
                _ => {
                    stopped = true;
                    let halt = random.below(2) == 0;
                    bench.stop(if halt {
                        StopMode::Halt
                    } else {
                        StopMode::Decelerate
                    });
                    break;
                }
            }
        }
        resume(&mut bench);
        let what = format!("seed {seed}");
        if !stopped {
            bench.run_for(10_000_000);
            let status = bench.node.status();
            // Disturbed too often in a row, the register is a fault, and that a stop like any other;
            // nothing else is one.
            let disturbed = bench.node.shift_wrong_max() > u32::from(RETRIES_MAX);
            stopped = status.state == NodeState::Fault;
            assert_eq!(stopped, disturbed, "{what}: {:?}", status.faults);
            let is_told = |fault: &Fault| fault.code == FaultCode::SHIFT_REGISTER;
            assert_eq!(status.faults.iter().any(is_told), disturbed, "{what}");
        }
        if stopped {
            bench.run_for(5_000_000);
            bench.release();
            bench.order([ramp(-9), ramp(9)]);
            bench.run_to_rest();
        } else {
            bench.run_to_rest();
            let made = [X, Y].map(|axis| bench.node.position_steps(axis));
            assert_eq!(made.as_slice(), end, "{what}");
        }
        pins_are_right(&bench, &what);
    }
}
