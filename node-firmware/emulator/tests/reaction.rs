//! How soon a change takes effect: within 2 ms of motion, whatever moves, at whatever speed.
//!
//! The same motion is run twice, once with a change. Up to the instant of its effect both have the
//! same edges to the tick; so the last edge that they have in common is no later than that.

mod bench;

use bench::{Bench, config, motor::steps_of};
use emulator::EmulatorConfig;
use keys::{
    AxisId, Command, StopMode,
    command::{Ramp, RampShape},
};
use motion::AxisProfile;

const X: AxisId = AxisId(0);

/// From the call until another plan takes effect, s.
const REACTION_S_MAX: f64 = 2e-3;

/// So hard that half a tick is to be seen after some µs.
const ACCEL_HZ_PER_S: u32 = 50_000_000;

const TRAPEZOID: RampShape = RampShape::Trapezoid {
    linear_steps: 0,
    jump_steps: 0,
};

/// What a change does.
#[derive(Clone, Copy, Debug)]
enum Change {
    Slower,
    Faster,
    Hold,
    Stop,
}

impl Bench {
    fn make(&mut self, change: Change) {
        let now = motion::Ticks(self.now.0 * 16);
        let motion = self.node.node_mut().motion_mut();
        match change {
            Change::Slower => motion.set_speed_percent(50),
            Change::Faster => motion.set_speed_percent(150),
            Change::Hold => motion.hold(now),
            Change::Stop => self.stop(StopMode::Decelerate),
        }
    }
}

fn profiles() -> [AxisProfile; 4] {
    [
        AxisProfile::default(),
        AxisProfile::dm556(),
        // Opto-couplers want long low times.
        AxisProfile {
            low_ns_min: 60_000,
            ..AxisProfile::default()
        },
        AxisProfile {
            high_ns_min: 20_000,
            high_ns: 20_000,
            low_ns_min: 20_000,
            ..AxisProfile::default()
        },
    ]
}

fn bench(profile: AxisProfile) -> Bench {
    let mut config: EmulatorConfig = config();
    config.motion.axes = [AxisProfile {
        stop_accel_hz_per_s: ACCEL_HZ_PER_S,
        ..profile
    }; 4];
    Bench::new(config)
}

/// Returns how long after the call the last edge comes that is where it would be without it.
fn reaction_s(commands: &[Command], profile: AxisProfile, at_us: u64, change: Change) -> f64 {
    let edges = |change: Option<Change>| {
        let mut bench = bench(profile);
        bench.order(commands.iter().copied());
        bench.run_until(at_us);
        if let Some(change) = change {
            bench.make(change);
        }
        bench.run_for(60_000);
        steps_of(&bench.node.life(), X)
    };
    let (plain, changed) = (edges(None), edges(Some(change)));
    let call_s = at_us as f64 / 1e6;
    let same = plain
        .iter()
        .zip(&changed)
        .take_while(|(a, b)| a == b)
        .count();
    assert!(plain.len() > same, "{change:?} has no effect");
    plain[same - 1].0 - call_s
}

fn speeds(profile: &AxisProfile) -> impl Iterator<Item = u32> + use<> {
    let most = 1_000_000_000 / (profile.high_ns_min + profile.low_ns_min).max(1);
    // About 23.5 kHz a step is one word of the pulse hardware, and as long as one can be.
    [
        300, 5_000, 12_000, 16_000, 23_400, 23_530, 24_900, 25_100, 100_000,
    ]
    .into_iter()
    .filter(move |speed| *speed <= most)
}

fn ramp(speed_hz: u32) -> Command {
    Command::Ramp {
        axis: X,
        steps: 100_000,
        ramp: Ramp {
            speed_hz,
            accel_hz_per_s: ACCEL_HZ_PER_S,
            shape: TRAPEZOID,
        },
    }
}

fn lines(speed_hz: u32) -> Vec<Command> {
    // Y has the same steps now and then: another axis, with other words.
    let line = Command::Line {
        steps: [200, 7, 0, 0],
        speed_hz,
        accel_hz_per_s: ACCEL_HZ_PER_S,
        jerk_hz_per_s2: 0,
    };
    vec![line; 200]
}

#[test]
fn another_speed_a_hold_or_a_stop_on_a_path_takes_effect_within_two_milliseconds() {
    for profile in profiles() {
        for speed_hz in speeds(&profile) {
            for change in [Change::Slower, Change::Faster, Change::Hold, Change::Stop] {
                if matches!(change, Change::Faster)
                    && u64::from(speed_hz) * 3 / 2
                        > 1_000_000_000 / u64::from(profile.high_ns_min + profile.low_ns_min)
                {
                    continue;
                }
                for (name, commands) in [("ramp", vec![ramp(speed_hz)]), ("lines", lines(speed_hz))]
                {
                    for at_us in [60_000, 60_777] {
                        let is_s = reaction_s(&commands, profile, at_us, change);
                        assert!(
                            is_s <= REACTION_S_MAX,
                            "{name} at {speed_hz} Hz, {change:?} at {at_us} µs: {:.3} ms, {profile:?}",
                            is_s * 1e3
                        );
                    }
                }
            }
        }
    }
}

#[test]
fn a_stop_of_raw_moves_slows_down_within_two_milliseconds() {
    for profile in profiles() {
        let least_us = (profile.high_ns_min + profile.low_ns_min).div_ceil(1_000);
        for delay_us in [2, 10, 38, 40, 41, 42, 43, 60, 85, 100, 700, 3_000] {
            if delay_us < least_us {
                continue;
            }
            let moves = vec![
                Command::Move {
                    axis: X,
                    delay_us,
                    steps: 100_000,
                };
                10
            ];
            for at_us in [60_000, 60_777] {
                let is_s = reaction_s(&moves, profile, at_us, Change::Stop);
                assert!(
                    is_s <= REACTION_S_MAX,
                    "{delay_us} µs at {at_us} µs: {:.3} ms, {profile:?}",
                    is_s * 1e3
                );
            }
        }
    }
}
