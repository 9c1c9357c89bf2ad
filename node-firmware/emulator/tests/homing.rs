//! Homing and limits, end to end: the node, its virtual pulse unit, and a machine whose carriages
//! press switches that bounce. Judged by the oracle, and by where the carriages really are.

mod bench;

use bench::{Bench, config};
use emulator::EmulatorConfig;
use keys::{
    AxisId, Command, Features, LocalMicros, NodeState, StopMode, StopReason,
    command::{Ramp, RampShape},
    status::FaultCode,
};
use motion::{
    Direction, Ticks,
    io::{
        home::HomeConfig,
        input::{Filter, InputConfig, InputMap, Role, Switch},
    },
};

const X: AxisId = AxisId(0);
const Y: AxisId = AxisId(1);
const HOME_X: Command = Command::Home { axis: X };

/// X has a limit at each end, 300 steps below and 5,000 above where it is switched on.
fn machine() -> EmulatorConfig {
    let mut config = config();
    config.add_switch(X, Switch::Min, -300).expect("room");
    config.add_switch(X, Switch::Max, 5_000).expect("room");
    config.machine.bounce_us_max = 2_000;
    config.set_home(X, HomeConfig::min_switch(20_000));
    config
}

fn ramp(axis: AxisId, steps: i32, speed_hz: u32) -> Command {
    Command::Ramp {
        axis,
        steps,
        ramp: Ramp {
            speed_hz,
            accel_hz_per_s: 50_000,
            shape: RampShape::Trapezoid {
                linear_steps: 0,
                jump_steps: 0,
            },
        },
    }
}

fn pause(pause_ms: u32) -> Command {
    Command::Pause { pause_ms }
}

impl Bench {
    fn position(&self, axis: AxisId) -> i64 {
        self.node.position_steps(axis)
    }

    /// The position is that of the carriage, for a switch at `switch_place` that is 0; and that is
    /// what the pulse counter makes of it.
    fn is_homed_at(&self, axis: AxisId, switch_place: i64) {
        let place = self.node.place_steps(axis);
        assert_eq!(self.position(axis), place - switch_place);
    }

    fn faults(&self) -> Vec<FaultCode> {
        let faults = self.node.status().faults;
        faults.iter().map(|fault| fault.code).collect()
    }
}

#[test]
fn an_axis_finds_its_switch_and_knows_where_it_is() {
    let mut bench = Bench::new(machine());
    bench.order([HOME_X]);
    bench.run_to_rest();
    assert_eq!(bench.position(X), 200);
    bench.is_homed_at(X, -300);
    assert!(bench.node.node().motion().is_homed(X));
    assert_eq!(bench.node.status().state, NodeState::Idle);
    assert_eq!(bench.faults(), []);
    bench.judged();
}

#[test]
fn what_comes_behind_it_goes_by_the_new_position() {
    let mut bench = Bench::new(machine());
    let to_1000 = Command::RampTo {
        axis: X,
        position_steps: 1_000,
        ramp: Ramp {
            speed_hz: 5_000,
            accel_hz_per_s: 50_000,
            shape: RampShape::Jerk {
                jerk_hz_per_s2: 1_000_000,
            },
        },
    };
    bench.order([ramp(X, 400, 4_000), pause(1), HOME_X, to_1000, pause(1)]);
    bench.run_to_rest();
    assert_eq!(bench.position(X), 1_000);
    bench.is_homed_at(X, -300);
    bench.judged();
}

#[test]
fn a_switch_that_is_pressed_already_is_left_first() {
    let mut config = machine();
    config.machine.start_steps[0] = -400;
    let mut bench = Bench::new(config);
    bench.order([HOME_X]);
    bench.run_to_rest();
    assert_eq!(bench.position(X), 200);
    bench.is_homed_at(X, -300);
    bench.judged();
}

#[test]
fn each_bounce_leads_to_the_same_place() {
    for seed in 0..40 {
        let mut config = machine();
        config.seed = seed;
        config.rmt.refill_ticks_max = 2_000;
        // Where the axis is when it is switched on does not matter either.
        config.machine.start_steps[0] = 37 * seed as i64 - 250;
        config.homes_x().seek_stop = [StopMode::Halt, StopMode::Decelerate][seed as usize % 2];
        let mut bench = Bench::new(config);
        bench.order([HOME_X, HOME_X]);
        bench.run_to_rest();
        assert_eq!(bench.position(X), 200, "seed {seed}");
        bench.is_homed_at(X, -300);
        bench.judged();
    }
}

trait HomesX {
    fn homes_x(&mut self) -> &mut HomeConfig;
}

impl HomesX for EmulatorConfig {
    fn homes_x(&mut self) -> &mut HomeConfig {
        self.motion.homes[0].as_mut().expect("it has one")
    }
}

/// What a node says when its homing of X has failed; nothing moves any more.
fn failure_of(config: EmulatorConfig) -> (Bench, String) {
    let mut bench = Bench::new(config);
    bench.order([ramp(Y, 10, 1_000), HOME_X, ramp(Y, 10, 1_000)]);
    let lines = bench.lines_until_stopped();
    let status = bench.node.status();
    assert_eq!(status.state, NodeState::Fault);
    assert_eq!(bench.faults(), [FaultCode::HOMING]);
    let stop = status.stop.expect("it stopped");
    assert_eq!(stop.executed_commands, 1, "and nothing behind it");
    assert_eq!(bench.position(Y), 10);
    bench.judged();
    let line = lines.iter().find(|line| line.starts_with("axis 0:"));
    let line = line.unwrap_or_else(|| panic!("{lines:?}")).clone();
    (bench, line)
}

impl Bench {
    /// Runs until the node has stopped and said so; returns what it has logged since.
    fn lines_until_stopped(&mut self) -> Vec<String> {
        self.lines.clear();
        while !matches!(
            self.node.status().state,
            NodeState::Stopped | NodeState::Fault
        ) {
            let due = self.node.poll_timeout().expect("something is due");
            self.run_until(due.0);
        }
        // Lines leave slowly.
        self.run_for(2_000_000);
        std::mem::take(&mut self.lines)
    }
}

#[test]
fn a_switch_that_is_never_found_ends_the_seek() {
    let mut config = machine();
    config.homes_x().travel_steps_max = 250;
    let (bench, line) = failure_of(config);
    assert_eq!(line, "axis 0: switch never found; it is at -250");
    assert_eq!(bench.node.place_steps(X), -250);
}

#[test]
fn a_switch_that_is_never_released_ends_the_way_back() {
    let mut config = machine();
    config.machine.switches[0].pressed = i64::MIN..=i64::MAX;
    config.homes_x().back_off_steps_max = 700;
    let (_, line) = failure_of(config);
    assert_eq!(line, "axis 0: switch never released; it is at 700");
}

#[test]
fn with_both_ends_pressed_nothing_moves() {
    let mut config = machine();
    config.machine.switches[0].pressed = i64::MIN..=i64::MAX;
    config.machine.switches[1].pressed = i64::MIN..=i64::MAX;
    let (bench, line) = failure_of(config);
    assert_eq!(line, "axis 0: came to the max limit; it is at 0");
    assert_eq!(bench.node.step_count(X), 0);
}

#[test]
fn a_limit_in_the_way_ends_homing_on_the_spot() {
    let mut config = machine();
    config.add_switch(X, Switch::Home, 8_000).expect("room");
    let home = config.homes_x();
    home.switch = Switch::Home;
    home.direction = Direction::Positive;
    let (bench, line) = failure_of(config);
    assert!(line.starts_with("axis 0: came to the max limit"), "{line}");
    // 5 kHz for what the filter and the task take, and a step.
    let place = bench.node.place_steps(X);
    assert!((5_000..=5_002).contains(&place), "{place}");
}

#[test]
fn a_home_switch_may_be_anywhere_and_have_any_position() {
    let mut config = machine();
    config.add_switch(X, Switch::Home, 2_000).expect("room");
    let home = config.homes_x();
    home.switch = Switch::Home;
    home.direction = Direction::Positive;
    home.home_position_steps = -77;
    home.pull_off_steps = 0;
    let mut bench = Bench::new(config);
    bench.order([HOME_X, ramp(X, 3, 100), pause(1)]);
    bench.run_to_rest();
    // It is pressed over a thousand steps, and found at the lower end.
    bench.is_homed_at(X, 1_000 + 77);
    let position = bench.position(X);
    assert!((-74..=-73).contains(&position), "{position}");
    bench.judged();
}

#[test]
fn two_axes_are_homed_one_after_the_other() {
    let mut config = machine();
    config.add_switch(Y, Switch::Max, 900).expect("room");
    let home = HomeConfig {
        switch: Switch::Max,
        direction: Direction::Positive,
        home_position_steps: 4_000,
        ..HomeConfig::min_switch(20_000)
    };
    config.set_home(Y, home);
    let mut bench = Bench::new(config);
    bench.order([
        HOME_X,
        Command::Home { axis: Y },
        Command::Line {
            steps: [100, -200, 0, 0],
            speed_hz: 2_000,
            accel_hz_per_s: 20_000,
            jerk_hz_per_s2: 0,
        },
    ]);
    bench.run_to_rest();
    assert_eq!([bench.position(X), bench.position(Y)], [300, 3_600]);
    bench.is_homed_at(X, -300);
    bench.is_homed_at(Y, 900 - 4_000);
    bench.judged();
}

#[test]
fn a_barrier_before_homing_holds_it_back() {
    let mut bench = Bench::new(machine());
    bench.order([ramp(X, 50, 1_000), Command::Barrier { barrier: 0 }, HOME_X]);
    bench.run_until(3_000_000);
    assert_eq!(bench.node.status().executed_commands, 1);
    assert_eq!(bench.position(X), 50);
    let start_at = Ticks(4_000_000 * 16);
    let motion = bench.node.node_mut().motion_mut();
    motion.release_barrier(start_at);
    bench.run_until(3_999_999);
    assert_eq!(bench.position(X), 50);
    bench.run_to_rest();
    bench.is_homed_at(X, -300);
    let life = bench.judged();
    let after = life.edges.iter().find(|edge| edge.at_ticks >= start_at.0);
    let first = after.expect("it moves").at_ticks - start_at.0;
    assert!(first < 1_000 * 16, "{first} ticks later");
}

#[test]
fn a_stop_at_any_instant_of_homing_keeps_every_step() {
    for round in 0..60u64 {
        let mut bench = Bench::new(machine());
        bench.order([HOME_X]);
        bench.run_until(1_000 + round * 17_313);
        let mode = [StopMode::Halt, StopMode::Decelerate][round as usize % 2];
        bench.stop(mode);
        bench.run_for(1_500_000);
        assert_eq!(
            bench.node.status().state,
            NodeState::Stopped,
            "round {round}"
        );
        // Slowing down, it may run into the switch that it was looking for.
        let faults = bench.faults();
        let ran_in = mode == StopMode::Decelerate && faults == [FaultCode::LIMIT];
        assert!(faults.is_empty() || ran_in, "round {round}: {faults:?}");
        bench.judged();
        bench.release();
        bench.order([HOME_X]);
        bench.run_to_rest();
        assert_eq!(bench.position(X), 200, "round {round}");
        bench.is_homed_at(X, -300);
        bench.judged();
    }
}

impl Bench {
    /// All is executed after so many wakes.
    fn ends_within(&mut self, round: u64, wakes_max: u32) {
        let mut wakes = 0;
        while self.node.status().executed_commands < self.job_end {
            let due = self.node.poll_timeout().expect("something is due");
            self.run_until(due.0);
            wakes += 1;
            let status = self.node.status();
            assert!(wakes < wakes_max, "round {round}: {status:?}");
        }
    }
}

#[test]
fn held_at_any_instant_homing_goes_on_and_ends_at_the_same_place() {
    for round in 0..60u64 {
        let mut bench = Bench::new(machine());
        bench.order([HOME_X]);
        bench.run_until(1_000 + round * 17_313);
        if bench.node.status().executed_commands > 0 {
            break;
        }
        let now = Ticks(bench.now.0 * 16);
        bench.node.node_mut().motion_mut().hold(now);
        bench.run_for(300_000);
        assert_eq!(
            bench.node.status().state,
            NodeState::Paused,
            "round {round}"
        );
        let held = bench.position(X);
        bench.run_for(500_000);
        assert_eq!(bench.position(X), held, "round {round}");
        bench.node.node_mut().motion_mut().resume();
        bench.ends_within(round, 3_000);
        assert_eq!(bench.position(X), 200, "round {round}");
        bench.is_homed_at(X, -300);
        assert_eq!(bench.faults(), [], "round {round}");
        bench.judged();
    }
}

#[test]
fn homing_is_held_for_as_long_as_a_client_likes_and_a_stop_meanwhile_leaves_the_axis_unhomed() {
    for round in 0..30u64 {
        let mut bench = Bench::new(machine());
        // The place of the switch is known, and not any more once it is looked for again.
        bench.order([HOME_X]);
        bench.run_to_rest();
        bench.order([HOME_X]);
        bench.run_for(1_000 + round * 20_011);
        if bench.node.status().executed_commands > 1 {
            break;
        }
        bench.pace(true);
        bench.run_for(300_000);
        let held = (bench.position(X), bench.node.place_steps(X));
        assert_eq!(
            bench.node.status().state,
            NodeState::Paused,
            "round {round}"
        );
        // Nothing about it runs out: neither travel nor time counts on while it is held.
        bench.run_for(60_000_000);
        assert_eq!((bench.position(X), bench.node.place_steps(X)), held);
        assert_eq!(bench.faults(), [], "round {round}");
        if round % 2 == 0 {
            bench.pace(false);
            bench.ends_within(round, 3_000);
            bench.is_homed_at(X, -300);
            assert!(bench.node.node().motion().is_homed(X), "round {round}");
        } else {
            bench.stop(StopMode::Decelerate);
            bench.run_for(1_000_000);
            assert_eq!(
                bench.node.status().state,
                NodeState::Stopped,
                "round {round}"
            );
            assert_eq!(bench.node.place_steps(X), held.1, "round {round}");
            assert!(!bench.node.node().motion().is_homed(X), "round {round}");
        }
        assert_eq!(bench.faults(), [], "round {round}");
        bench.judged();
    }
}

#[test]
fn a_node_without_a_home_refuses_it_with_its_axis() {
    let mut config = machine();
    config.motion.homes = [None; 4];
    let bench = Bench::new(config);
    let check = |bench: &Bench, axis| {
        let checked = bench.node.node().motion().check(&Command::Home { axis });
        checked.expect_err("refused").to_string()
    };
    assert_eq!(check(&bench, X), "axis 0 has no reference switch");
    let features = bench.node.status().features;
    assert!(!features.has(Features::HOMING));
    let bench = Bench::new(machine());
    let features = bench.node.status().features;
    assert!(features.has(HOME_X.feature()) && features.has(Features::HOMING));
    assert!(!features.has(Command::Home { axis: Y }.feature()));
    assert_eq!(check(&bench, Y), "axis 1 has no reference switch");
    assert_eq!(check(&bench, AxisId(2)), "there is no axis 2");
}

#[test]
fn a_limit_stops_what_runs_into_it() {
    for (command, most_steps) in [
        (
            Command::Move {
                axis: X,
                delay_us: 100,
                steps: -2_000,
            },
            2,
        ),
        (ramp(X, -2_000, 20_000), 3),
        (
            Command::Line {
                steps: [-2_000, 1_000, 0, 0],
                speed_hz: 10_000,
                accel_hz_per_s: 50_000,
                jerk_hz_per_s2: 0,
            },
            2,
        ),
    ] {
        let mut bench = Bench::new(machine());
        bench.order([command, ramp(Y, 10, 1_000)]);
        let lines = bench.lines_until_stopped();
        let status = bench.node.status();
        assert_eq!(status.state, NodeState::Stopped);
        assert_eq!(status.stop.expect("it stopped").reason, StopReason::Limit);
        assert_eq!(bench.faults(), [FaultCode::LIMIT]);
        let place = bench.node.place_steps(X);
        assert!((-300 - most_steps..=-300).contains(&place), "{place}");
        assert_eq!(bench.position(X), place);
        let told = format!("axis 0: ran into its min limit; it is at {place}");
        assert!(lines.contains(&told), "{lines:?}");
        bench.judged();
    }
}

#[test]
fn a_limit_may_be_reached_by_a_ramp_down_if_the_machine_has_room() {
    let mut config = machine();
    config.motion.limit_stop = StopMode::Decelerate;
    let mut bench = Bench::new(config);
    bench.order([ramp(X, -2_000, 5_000)]);
    bench.lines_until_stopped();
    let stop = bench.node.status().stop.expect("it stopped");
    assert_eq!(stop.reason, StopReason::Limit);
    // v²/2a = 250 steps, and 2 ms of what the hardware holds.
    let place = bench.node.place_steps(X);
    assert!((-300 - 250 - 15..-300 - 200).contains(&place), "{place}");
    bench.judged();
}

#[test]
fn an_axis_leaves_its_limit_and_does_not_go_further_into_it() {
    let mut bench = Bench::new(machine());
    bench.order([ramp(X, -2_000, 5_000)]);
    bench.lines_until_stopped();
    let place = bench.node.place_steps(X);
    bench.release();
    let accepted = bench.node.status().state;
    assert_eq!(accepted, NodeState::Idle);

    // Further in: nothing moves, also of what comes behind it.
    bench.order([pause(10), ramp(X, -1, 100), ramp(X, 100, 1_000)]);
    let lines = bench.lines_until_stopped();
    let told =
        format!("axis 0: command 1 would move it further into its min limit; it is at {place}");
    assert!(lines.contains(&told), "{lines:?}");
    assert_eq!(bench.node.place_steps(X), place);
    assert_eq!(
        bench.node.status().stop.expect("stopped").reason,
        StopReason::Limit
    );
    bench.release();

    // Off it, while it bounces, and back, but not as far as the switch.
    bench.order([ramp(X, 300, 5_000), ramp(X, -250, 5_000), pause(10)]);
    bench.run_to_rest();
    assert_eq!(bench.node.place_steps(X), place + 50);
    assert_eq!(bench.node.status().state, NodeState::Idle);
    bench.judged();
}

#[test]
fn what_leads_off_a_limit_and_back_into_it_stops_there() {
    let mut config = machine();
    config.machine.switches[0].hysteresis_steps = 50;
    config.machine.start_steps[0] = -310;
    let mut bench = Bench::new(config);
    bench.order([ramp(X, 20, 1_000), ramp(X, -300, 1_000)]);
    bench.lines_until_stopped();
    let stop = bench.node.status().stop.expect("stopped");
    assert_eq!(
        (stop.reason, stop.executed_commands),
        (StopReason::Limit, 1)
    );
    // It was never released: the first steps back are the last.
    let place = bench.node.place_steps(X);
    assert!((-293..=-290).contains(&place), "{place}");
    bench.judged();
}

#[test]
fn a_switch_that_nobody_runs_into_stops_nothing() {
    let mut bench = Bench::new(machine());
    bench.order([ramp(Y, 3_000, 2_000), ramp(X, 100, 1_000)]);
    bench.run_until(500_000);
    // Pressed by hand while X rests; and X leaves that end.
    bench.node.set_input(0, true, bench.now);
    bench.run_to_rest();
    assert_eq!([bench.position(X), bench.position(Y)], [100, 3_000]);
    assert_eq!(bench.faults(), []);
    bench.judged();
}

#[test]
fn a_reboot_forgets_the_position_and_not_the_place() {
    let mut bench = Bench::new(machine());
    bench.order([ramp(X, 700, 4_000)]);
    bench.run_to_rest();
    bench.node.reset(8);
    assert_eq!(bench.node.place_steps(X), 700);
    bench.now = LocalMicros(0);
    bench.node.link(true, bench.now);
    assert!(!bench.node.node().motion().is_homed(X));
    bench.order([HOME_X]);
    bench.run_to_rest();
    assert_eq!(bench.node.place_steps(X), -100);
    bench.is_homed_at(X, -300);
    bench.judged();
}

/// A node with one more input of this role, which is active when high.
fn with_input(role: Role) -> EmulatorConfig {
    let mut config = config();
    let input = InputConfig {
        role,
        active_low: false,
        filter: Filter::default(),
    };
    config.motion.inputs = InputMap::new(&[input], 2).expect("legal");
    config
}

#[test]
fn a_stop_input_stops_like_the_stop_pin() {
    let mut bench = Bench::new(with_input(Role::Stop));
    bench.order([ramp(X, 5_000, 4_000)]);
    bench.run_until(500_000);
    bench.node.set_input(0, true, bench.now);
    bench.run_for(10_000);
    let stop = bench.node.status().stop.expect("stopped");
    assert_eq!(stop.reason, StopReason::Pin);
    bench.release();
    assert_eq!(
        bench.node.status().state,
        NodeState::Stopped,
        "still demanded"
    );
    bench.node.set_input(0, false, bench.now);
    bench.run_for(10_000);
    bench.release();
    assert_eq!(bench.node.status().state, NodeState::Idle);
    bench.judged();
}

#[test]
fn a_probe_tells_where_it_was_touched_and_may_stop() {
    for stop in [None, Some(StopMode::Decelerate)] {
        let mut config = with_input(Role::Probe);
        config.motion.probe_stop = stop;
        let mut bench = Bench::new(config);
        bench.order([ramp(X, 3_000, 4_000)]);
        bench.run_until(400_000);
        let touched = bench.position(X);
        bench.node.set_input(0, true, bench.now);
        bench.run_for(1_000_000);
        let told = format!("probe: touched at [{touched}, 0]");
        assert!(bench.lines.contains(&told), "{:?}", bench.lines);
        let reason = bench.node.status().stop.map(|stop| stop.reason);
        assert_eq!(reason, stop.map(|_| StopReason::Pin));
        let end = bench.position(X);
        assert_eq!(end == 3_000, stop.is_none(), "{end}");
        assert!(stop.is_none() || (touched + 100..touched + 250).contains(&end));
        bench.judged();
    }
}
