//! C and D, end to end: the commands, their pulse hardware, limits that bounce, and the log.

mod bench;

use bench::{Bench, config};
use emulator::{
    EmulatorConfig,
    pins::{CARRIAGE_C, CARRIAGE_D, Pin},
};
use keys::{AxisId, Command, Features, NodeState, StopMode, StopReason, status::FaultCode};
use motion::CommandError;

const X: AxisId = AxisId(0);
/// Steps of a millimetre.
const MM: i64 = 80;

const fn c(index: u8) -> Command {
    Command::MoveC { index }
}

const OFF: Command = Command::MoveD { on: false };
const ON: Command = Command::MoveD { on: true };
const STATUS: Command = Command::StatusCd;

/// C has 100 mm between its limits and 0.3 mm more at each end; D 50 mm. Both are switched on in the
/// middle of nowhere.
fn machine() -> EmulatorConfig {
    let mut config = config();
    config.add_cd(3 * MM / 10).expect("room");
    config.machine.bounce_us_max = 1_000;
    config.machine.start_steps[CARRIAGE_D] = 20 * MM;
    config
}

fn steps(x: i32) -> Command {
    Command::Move {
        axis: X,
        delay_us: 100,
        steps: x,
    }
}

impl Bench {
    fn c_place(&self) -> i64 {
        self.node.carriage_steps(CARRIAGE_C)
    }

    fn d_place(&self) -> i64 {
        self.node.carriage_steps(CARRIAGE_D)
    }

    fn status_text(&self) -> String {
        let status = self.node.node().motion().status_cd();
        status.expect("it has C and D").to_string()
    }

    /// Runs all, waits for the log, and gives what it says of C and D.
    fn told(&mut self) -> Vec<String> {
        self.run_to_rest();
        self.run_for(3_000_000);
        let told = self.lines.iter().filter(|line| line.starts_with("C: "));
        told.cloned().collect()
    }

    fn stopped_with(&mut self, code: FaultCode) -> Vec<String> {
        self.run_for(30_000_000);
        let status = self.node.status();
        assert_eq!(status.state, NodeState::Fault);
        assert_eq!(status.faults.last().map(|fault| fault.code), Some(code));
        std::mem::take(&mut self.lines)
    }
}

#[test]
fn the_sequence_of_a_machine_that_clamps_moves_and_releases() {
    let mut bench = Bench::new(machine());
    bench.order([
        OFF,
        STATUS,
        c(2),
        STATUS,
        ON,
        steps(100),
        STATUS,
        c(0),
        STATUS,
    ]);
    let told = bench.told();
    assert_eq!(
        told,
        [
            "C: UNKNOWN (0.0mm) D: OFF",
            "C: POS2 (50.0mm) D: OFF",
            "C: POS2 (50.0mm) D: ON",
            "C: HOME (0.0mm) D: ON",
        ]
    );
    assert_eq!(bench.c_place(), 0);
    // It went on for the filter and the task, a step at most.
    assert!((50 * MM..=50 * MM + 1).contains(&bench.d_place()));
    bench.judged();
}

#[test]
fn what_comes_behind_waits_until_it_is_there() {
    let mut bench = Bench::new(machine());
    bench.order([steps(50), c(1), steps(1)]);
    bench.run_to_rest();
    let life = bench.judged();
    let of = |pin: Pin| {
        let edges = life
            .edges
            .iter()
            .filter(move |edge| edge.pin == pin && edge.level);
        edges.map(|edge| edge.at_ticks).collect::<Vec<_>>()
    };
    let (x, c) = (of(Pin::Step(X)), of(Pin::StepC));
    assert_eq!((x.len(), c.len()), (51, 2_000));
    assert!(x[49] < c[0] && c[1_999] < x[50]);
    // 25 mm at 20 mm/s: 1,600 Hz.
    assert!(c.windows(2).all(|pair| pair[1] - pair[0] == 10_000));
}

#[test]
fn a_position_that_is_none_is_refused_and_nothing_moves() {
    let bench = Bench::new(machine());
    let motion = bench.node.node().motion();
    let refused = motion.check(&c(5)).expect_err("there is none");
    assert_eq!(refused.to_string(), "Invalid C position (0-4)");
    assert!(bench.node.status().features.has(Features::CD));
    let without = Bench::new(config());
    for command in [c(0), ON, STATUS] {
        let checked = without.node.node().motion().check(&command);
        assert_eq!(checked, Err(CommandError::NotSupported));
    }
}

#[test]
fn a_limit_tells_where_c_is_and_ends_a_way_that_leads_there() {
    let mut config = machine();
    config.machine.start_steps[CARRIAGE_C] = -MM / 2;
    let mut bench = Bench::new(config);
    // Pressed at boot: it is at 0.
    assert_eq!(bench.status_text(), "C: HOME (0.0mm) D: UNKNOWN");
    bench.order([c(3), c(0), STATUS]);
    let told = bench.told();
    assert_eq!(told, ["C: HOME (0.0mm) D: UNKNOWN"]);
    // 40 steps below its limit it began, and the limit is 24 below 0.
    assert!(
        (-25..=-24).contains(&bench.c_place()),
        "{}",
        bench.c_place()
    );
    assert_eq!(bench.node.status().faults.len(), 0);
    bench.judged();
}

#[test]
fn without_a_limit_it_stops_on_the_step() {
    let mut bench = Bench::new(machine());
    bench.order([c(3), c(0), c(4), c(3), c(0)]);
    bench.run_to_rest();
    assert_eq!(bench.c_place(), 0);
    bench.judged();
}

#[test]
fn a_limit_before_the_position_is_a_fault_that_says_so() {
    let mut config = machine();
    config.machine.start_steps[CARRIAGE_C] = 60 * MM;
    let mut bench = Bench::new(config);
    // POS2 would be 110 mm up.
    bench.order([c(2), steps(10)]);
    let lines = bench.stopped_with(FaultCode::NOT_THERE);
    let told = "C came to its max limit before its position";
    assert!(lines.iter().any(|line| line == told), "{lines:?}");
    assert_eq!(bench.node.position_steps(X), 0, "and nothing behind it");
    let end = 100 * MM + 3 * MM / 10;
    assert!((end..=end + 1).contains(&bench.c_place()));
    assert_eq!(bench.status_text(), "C: MAX (100.0mm) D: UNKNOWN");
    // From there it knows where it is.
    bench.release();
    bench.order([c(2)]);
    bench.run_to_rest();
    assert!((50 * MM..=50 * MM + 30).contains(&bench.c_place()));
}

#[test]
fn d_that_does_not_come_to_its_limit_is_a_fault() {
    let mut config = machine();
    config.machine.switches[3].pressed = 60 * MM..=i64::MAX;
    config.machine.start_steps[CARRIAGE_D] = 0;
    let mut bench = Bench::new(config);
    assert_eq!(bench.status_text(), "C: UNKNOWN (0.0mm) D: OFF");
    bench.order([ON]);
    let lines = bench.stopped_with(FaultCode::NOT_THERE);
    let told = "D did not come to its limit in time";
    assert!(lines.iter().any(|line| line == told), "{lines:?}");
    // 50 mm and an eighth.
    let most = 50 * MM + 50 * MM / 8;
    assert!(
        (most - 2..=most).contains(&bench.d_place()),
        "{}",
        bench.d_place()
    );
}

#[test]
fn no_edge_leaves_after_a_stop() {
    for (mode, command) in [
        (StopMode::Halt, c(4)),
        (StopMode::Decelerate, c(4)),
        (StopMode::Halt, ON),
    ] {
        let mut bench = Bench::new(machine());
        bench.order([command, steps(10)]);
        bench.run_until(300_123);
        let places = [bench.c_place(), bench.d_place()];
        assert_ne!(places, [0, 20 * MM]);
        bench.stop(mode);
        bench.run_for(1_000_000);
        assert_eq!([bench.c_place(), bench.d_place()], places);
        let stop = bench.node.status().stop.expect("stopped");
        assert_eq!(
            (stop.reason, stop.executed_commands),
            (StopReason::Client, 0)
        );
        assert!(bench.status_text().contains("UNKNOWN"));
        let life = bench.judged();
        let last = life.edges.last().expect("it moved");
        assert!(
            last.at_ticks <= 300_123 * 16 && !last.level,
            "low, and no later"
        );
        // C still counts.
        bench.release();
        bench.order([c(1), c(0)]);
        bench.run_to_rest();
        assert_eq!(bench.c_place(), 0);
    }
}

#[test]
fn with_both_limits_pressed_nothing_moves() {
    for (first, command, told) in [
        (0, c(1), "both limits of C are pressed"),
        (2, ON, "both limits of D are pressed"),
    ] {
        let mut config = machine();
        config.machine.switches[first].pressed = i64::MIN..=i64::MAX;
        config.machine.switches[first + 1].pressed = i64::MIN..=i64::MAX;
        let mut bench = Bench::new(config);
        bench.order([Command::Pause { pause_ms: 10 }, command]);
        let lines = bench.stopped_with(FaultCode::NOT_THERE);
        assert!(lines.iter().any(|line| line == told), "{lines:?}");
        assert_eq!([bench.c_place(), bench.d_place()], [0, 20 * MM]);
    }
}

#[test]
fn the_oracle_finds_a_missing_step_a_wrong_pace_and_a_wrong_turn_of_c_and_d() {
    let mut bench = Bench::new(machine());
    bench.order([OFF, c(0), c(2), ON, c(1)]);
    bench.run_to_rest();
    bench.run_for(1_000_000);
    let life = bench.judged();
    for (pin, number) in [(Pin::StepC, 700), (Pin::StepC, 4_000), (Pin::StepD, 900)] {
        let mut edges = life.edges.iter().enumerate();
        let rises = edges
            .by_ref()
            .filter(|(_, edge)| edge.pin == pin && edge.level);
        let at = rises.map(|(at, _)| at).nth(number).expect("so many steps");
        let mut missing = life.clone();
        missing.edges.remove(at);
        assert!(
            emulator::oracle::check_life(&missing).is_err(),
            "{pin:?} {number}"
        );
        let mut early = life.clone();
        early.edges[at].at_ticks -= 5;
        assert!(
            emulator::oracle::check_life(&early).is_err(),
            "{pin:?} {number}"
        );
    }
    let mut reversed = life.clone();
    let last = reversed
        .edges
        .iter_mut()
        .filter(|edge| edge.pin == Pin::DirectionC);
    let last = last.last().expect("it turned");
    last.level = !last.level;
    assert!(emulator::oracle::check_life(&reversed).is_err());
    let mut unordered = life;
    unordered.commands.retain(|taken| taken.command != ON);
    assert!(emulator::oracle::check_life(&unordered).is_err());
}
