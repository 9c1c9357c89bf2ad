//! Outputs that go with the motion: laser and enable pins, on the emulated node.

mod bench;

use bench::{Bench, config};
use emulator::{EmulatorConfig, pins::Pin, record::Life};
use keys::{
    AxisId, Command, LocalMicros, NodeState, StopMode,
    command::{Ramp, RampShape},
    status::FaultCode,
};
use motion::{
    ShiftConfig, Ticks,
    io::{
        enable::{AxisSet, EnableConfig, OUTPUTS_MAX},
        home::HomeConfig,
        input::Switch,
    },
};

const X: AxisId = AxisId(0);
const TICKS_PER_MS: u64 = 16_000;

fn ramp(steps: i32) -> Command {
    Command::Ramp {
        axis: X,
        steps,
        ramp: Ramp {
            speed_hz: 2_000,
            accel_hz_per_s: 20_000,
            shape: RampShape::Trapezoid {
                linear_steps: 0,
                jump_steps: 0,
            },
        },
    }
}

const fn laser(power_percent: u8) -> Command {
    Command::Laser { power_percent }
}

impl Bench {
    fn laser(&self) -> u8 {
        let percent = self.node.node().outputs().laser_percent();
        assert_eq!(percent, self.node.status().laser_percent);
        percent
    }

    fn hold(&mut self) {
        let now = Ticks(self.now.0 * 16);
        let motion = self.node.node_mut().motion_mut();
        motion.hold(now);
        self.node.poll(self.now);
    }

    fn resume(&mut self) {
        self.node.node_mut().motion_mut().resume();
        self.node.poll(self.now);
    }
}

#[test]
fn the_laser_is_off_while_motion_is_held() {
    let mut bench = Bench::new(config());
    bench.order([laser(60), ramp(2_000), laser(20), ramp(500), laser(0)]);
    bench.run_until(300_000);
    assert_eq!(bench.laser(), 60);
    bench.hold();
    assert_eq!(bench.laser(), 0, "at once, not at rest");
    bench.run_for(1_000_000);
    assert_eq!(bench.laser(), 0);
    bench.resume();
    bench.run_for(10_000);
    assert_eq!(bench.laser(), 60);
    // Resumed before it has come to rest.
    bench.hold();
    bench.run_for(5_000);
    assert_eq!(bench.laser(), 0);
    bench.resume();
    bench.run_for(5_000);
    assert_eq!(bench.laser(), 60);
    bench.run_for(900_000);
    assert_eq!(bench.laser(), 20);
    bench.run_to_rest();
    assert_eq!(bench.laser(), 0);
}

#[test]
fn the_laser_does_not_burn_at_a_barrier() {
    let mut bench = Bench::new(config());
    bench.order([
        laser(60),
        ramp(200),
        Command::Barrier { barrier: 0 },
        ramp(200),
        laser(0),
    ]);
    bench.run_until(100_000);
    assert_eq!(bench.laser(), 60);
    bench.run_until(1_000_000);
    assert_eq!(bench.laser(), 0);
    let motion = bench.node.node_mut().motion_mut();
    motion.release_barrier(Ticks(2_000 * TICKS_PER_MS));
    bench.run_until(1_990_000);
    assert_eq!(bench.laser(), 0);
    bench.run_until(2_050_000);
    assert_eq!(bench.laser(), 60);
    bench.run_to_rest();
    assert_eq!(bench.laser(), 0);
}

#[test]
fn a_queue_that_runs_dry_switches_the_laser_off_until_it_goes_on() {
    let mut bench = Bench::new(config());
    bench.order([laser(60), ramp(200)]);
    // The job has more.
    bench.node.node_mut().motion_mut().expect_more(10);
    bench.run_until(100_000);
    assert_eq!(bench.laser(), 60);
    bench.run_until(1_000_000);
    assert_eq!(bench.laser(), 0);
    bench.order([ramp(-200)]);
    bench.run_for(50_000);
    assert_eq!(bench.laser(), 60);
    // A command that says so counts more.
    bench.run_to_rest();
    bench.order([laser(5)]);
    bench.run_for(1_000);
    assert_eq!(bench.laser(), 5);
}

#[test]
fn the_laser_stays_off_after_a_stop() {
    for mode in [StopMode::Halt, StopMode::Decelerate] {
        let mut bench = Bench::new(config());
        bench.order([laser(60), ramp(2_000)]);
        bench.run_until(300_000);
        bench.stop(mode);
        assert_eq!(bench.laser(), 0);
        bench.run_for(1_000_000);
        bench.release();
        bench.order([ramp(100)]);
        bench.run_for(50_000);
        assert_eq!(bench.laser(), 0);
    }
}

/// One output for all axes of the queue: on 5 ms before motion, off after 200 ms of rest.
fn enabled() -> EmulatorConfig {
    let mut config = config();
    let output = EnableConfig {
        delay_on_us: 5_000,
        delay_off_ms: 200,
        ..EnableConfig::auto(AxisSet::QUEUE)
    };
    config.motion.enables.push(output).expect("room");
    config
}

/// When an output switched, ticks, and to what; the first says that it is off.
fn switched(life: &Life, output: u8) -> Vec<(u64, bool)> {
    let own = life
        .edges
        .iter()
        .filter(|edge| edge.pin == Pin::Enable(output));
    let all: Vec<_> = own.map(|edge| (edge.at_ticks, edge.level)).collect();
    assert_eq!(all.first(), Some(&(0, false)), "off at boot");
    all[1..].to_vec()
}

fn steps(life: &Life) -> Vec<u64> {
    let own = life.edges.iter();
    let own = own.filter(|edge| edge.pin == Pin::Step(X) && edge.level);
    own.map(|edge| edge.at_ticks).collect()
}

#[test]
fn drivers_are_on_before_the_first_step_and_off_after_a_while() {
    let mut bench = Bench::new(enabled());
    bench.run_until(100_000);
    bench.order([ramp(100), Command::Pause { pause_ms: 500 }, ramp(100)]);
    bench.run_for(3_000_000);
    let life = bench.judged();
    let (switched, steps) = (switched(&life, 0), steps(&life));
    let [(on_at, true), (off_at, false)] = switched[..] else {
        panic!("{switched:?}");
    };
    assert_eq!(steps.len(), 200);
    // The ramp's first step is 7 ms from its beginning.
    let first = steps[0] - on_at;
    assert!(
        (5 * TICKS_PER_MS..13 * TICKS_PER_MS).contains(&first),
        "{first}"
    );
    let rest = off_at - steps[199];
    assert!(
        (200 * TICKS_PER_MS..212 * TICKS_PER_MS).contains(&rest),
        "{rest}"
    );
}

#[test]
fn what_follows_before_they_are_off_does_not_wait() {
    let mut bench = Bench::new(enabled());
    bench.order([ramp(100)]);
    bench.run_to_rest();
    bench.run_for(100_000);
    let at = bench.now;
    bench.order([ramp(100)]);
    bench.run_for(2_000_000);
    let life = bench.judged();
    assert_eq!(switched(&life, 0).len(), 2);
    let first = steps(&life)[100] - at.0 * 16;
    assert!(first < 8 * TICKS_PER_MS, "{first}");
}

#[test]
fn a_start_at_an_instant_is_not_late_for_them() {
    let mut bench = Bench::new(enabled());
    bench.order([
        Command::Barrier { barrier: 0 },
        Command::Move {
            axis: X,
            delay_us: 100,
            steps: 10,
        },
    ]);
    bench.run_until(1_000_000);
    let motion = bench.node.node_mut().motion_mut();
    motion.release_barrier(Ticks(1_010 * TICKS_PER_MS));
    bench.run_to_rest();
    let life = bench.judged();
    let first = steps(&life)[0];
    assert!(first - 1_010 * TICKS_PER_MS <= 3, "{first}");
}

#[test]
fn a_stop_leaves_them_on_for_as_long_as_a_rest() {
    let mut bench = Bench::new(enabled());
    bench.order([ramp(5_000)]);
    bench.run_until(500_000);
    bench.stop(StopMode::Halt);
    let at = bench.now;
    bench.run_for(1_000_000);
    let life = bench.judged();
    let [_, (off_at, false)] = switched(&life, 0)[..] else {
        panic!("not off");
    };
    assert!((200..=201).contains(&((off_at / 16 - at.0) / 1_000)));
}

#[test]
fn an_output_that_is_not_automatic_is_on_from_boot_on() {
    let mut config = config();
    let output = EnableConfig {
        auto: false,
        ..EnableConfig::auto(AxisSet::QUEUE)
    };
    config.motion.enables.push(output).expect("room");
    let mut bench = Bench::new(config);
    bench.order([ramp(10)]);
    bench.run_to_rest();
    bench.run_for(5_000_000);
    let life = bench.judged();
    let all: Vec<_> = life
        .edges
        .iter()
        .filter(|edge| edge.pin == Pin::Enable(0))
        .collect();
    assert_eq!(all.len(), 1);
    assert!(all[0].level && steps(&life)[0] >= 2 * TICKS_PER_MS);
    assert!(bench.now > LocalMicros(0));
}

#[test]
fn a_direction_pin_may_be_low_for_positive() {
    let mut config = config();
    config.motion.axes[0].direction_inverted = true;
    config.add_switch(X, Switch::Min, -300).expect("room");
    config.set_home(X, HomeConfig::min_switch(20_000));
    let mut bench = Bench::new(config);
    bench.order([ramp(50), Command::Home { axis: X }, ramp(-30), ramp(100)]);
    bench.run_to_rest();
    assert_eq!(bench.node.position_steps(X), 270);
    assert_eq!(bench.node.place_steps(X), -30);
    let life = bench.judged();
    let turns = life
        .edges
        .iter()
        .filter(|edge| edge.pin == Pin::Direction(X));
    let levels: Vec<_> = turns.map(|edge| edge.level).collect();
    // It is low at boot, which is positive; then there, back, there, off, back, up.
    assert_eq!(levels, [true, false, true, false, true, false]);
}

#[test]
fn what_follows_a_lidar_read_waits_for_the_reading() {
    let mut config = config();
    config.motion.lidar_wait_ms = Some(100);
    let mut bench = Bench::new(config);
    let line = Command::Line {
        steps: [100, 0, 0, 0],
        speed_hz: 2_000,
        accel_hz_per_s: 20_000,
        jerk_hz_per_s2: 0,
    };
    bench.order([line, Command::LidarRead, line]);
    bench.run_to_rest();
    bench.run_for(1_000_000);
    let steps = steps(&bench.judged());
    // The emulated lidar takes 20 ms.
    let rest = steps[100] - steps[99];
    assert!(
        (20 * TICKS_PER_MS..50 * TICKS_PER_MS).contains(&rest),
        "{rest}"
    );
    let mm = bench.node.status().lidar_mm.expect("a reading");
    let told = format!("lidar: {mm} mm");
    assert!(bench.lines.contains(&told), "{:?}", bench.lines);
}

#[test]
fn a_reading_that_does_not_come_does_not_hold_the_queue_for_ever() {
    let mut config = config();
    config.motion.lidar_wait_ms = Some(10);
    let mut bench = Bench::new(config);
    bench.order([Command::LidarRead, ramp(10)]);
    bench.run_to_rest();
    bench.run_for(1_000_000);
    let told = "lidar: no reading in time";
    assert!(
        bench.lines.iter().any(|line| line == told),
        "{:?}",
        bench.lines
    );
    assert_eq!(bench.node.position_steps(X), 10);
}

/// The same output behind pin 3 of a shift register.
fn shifted() -> EmulatorConfig {
    let mut config = enabled();
    config.motion.enables[0].external = true;
    let mut enable_pins = [None; OUTPUTS_MAX];
    enable_pins[0] = Some(3);
    config.motion.shift = Some(ShiftConfig {
        pin_count: 8,
        enable_pins,
        ..ShiftConfig::default()
    });
    config
}

#[test]
fn a_driver_behind_a_shift_register_is_on_when_that_confirms_it() {
    for (errors, least_ms) in [(0, 5), (2, 7)] {
        let mut bench = Bench::new(shifted());
        bench.run_until(100_000);
        bench.node.disturb_shift(errors);
        bench.order([Command::Move {
            axis: X,
            delay_us: 100,
            steps: 10,
        }]);
        bench.run_to_rest();
        let life = bench.judged();
        let first = steps(&life)[0] - 100 * TICKS_PER_MS;
        // Its delay from the confirmation on, and a millisecond for each word that was wrong.
        let window = least_ms * TICKS_PER_MS..(least_ms + 2) * TICKS_PER_MS;
        assert!(window.contains(&first), "{errors} errors: {first}");
        assert_eq!(bench.node.status().faults.len(), 0);
    }
}

#[test]
fn a_shift_register_that_does_not_follow_is_a_fault_and_nothing_steps() {
    let mut bench = Bench::new(shifted());
    bench.run_until(100_000);
    bench.node.disturb_shift(100);
    bench.order([ramp(100)]);
    bench.run_for(3_000_000);
    let status = bench.node.status();
    assert_eq!(status.state, NodeState::Fault);
    assert_eq!(status.faults[0].code, FaultCode::SHIFT_REGISTER);
    let told = "shift register: sent 0x00000008, read back 0x000000f7";
    assert!(
        bench.lines.iter().any(|line| line == told),
        "{:?}",
        bench.lines
    );
    assert_eq!(bench.node.step_count(X), 0);
    // Repaired and released, it works.
    bench.node.disturb_shift(0);
    bench.release();
    bench.order([ramp(100)]);
    bench.run_to_rest();
    assert_eq!(bench.node.step_count(X), 100);
    bench.judged();
}

#[test]
fn an_external_output_needs_a_pin() {
    let mut config = shifted();
    config.motion.shift = None;
    let error = config.check().expect_err("no register").to_string();
    assert_eq!(
        error,
        "enable output 0: it has no pin of the shift register"
    );
}
