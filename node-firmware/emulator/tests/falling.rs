//! Drivers that step on the falling edge: all that they demand holds at that edge.

mod bench;

use bench::{Bench, config};
use emulator::{
    oracle::{self, Limits},
    pins::Pin,
};
use keys::{
    AxisId, Command,
    command::{Ramp, RampShape},
};
use motion::{AxisProfile, Driver};

const X: AxisId = AxisId(0);

#[test]
fn setup_hold_and_intervals_hold_at_the_falling_edge() {
    let falling = Driver::ALL.into_iter();
    let falling: Vec<_> = falling
        .filter(|driver| driver.steps_on_falling_edge())
        .collect();
    assert_eq!(falling, [Driver::Tb6560, Driver::Gecko201]);
    for driver in falling {
        let needs = driver.needs();
        let ticks = |ns: u32| u64::from(ns) * 16 / 1_000;
        let mut config = config();
        config.motion.axes[0] = AxisProfile::of_driver(driver);
        let mut bench = Bench::new(config);
        let fastest_us = (needs.high_ns + needs.low_ns).div_ceil(1_000);
        let raw = [7_i32, -3, 1, -1, 30, -24]
            .into_iter()
            .map(|steps| Command::Move {
                axis: X,
                delay_us: fastest_us + steps.unsigned_abs() % 3,
                steps,
            });
        let ramp = |steps: i32| Command::Ramp {
            axis: X,
            steps,
            ramp: Ramp {
                speed_hz: 1_000_000 / fastest_us,
                accel_hz_per_s: 20_000_000 / fastest_us,
                shape: RampShape::Trapezoid {
                    linear_steps: 0,
                    jump_steps: 0,
                },
            },
        };
        bench.order(raw.chain([300, -200, 1, -1].map(ramp)));
        bench.run_to_rest();
        let life = bench.node.life();
        // What the window adds: the half block before it, and the latest refill.
        let turn_ns = needs.high_ns + needs.hold_ns + needs.setup_ns + 201_000;
        let limits = Limits {
            high_ticks_min: ticks(needs.high_ns),
            low_ticks_min: ticks(needs.low_ns),
            setup_ticks_min: ticks(needs.setup_ns),
            hold_ticks_min: ticks(needs.hold_ns),
            turn_ticks_max: ticks(turn_ns),
            ..Limits::default()
        };
        let judged = oracle::check_life_by(&life, &limits);
        assert!(judged.is_ok(), "{}: {judged:?}", driver.name());
        let name = driver.name();
        let (mut rises, mut falls) = (Vec::new(), Vec::new());
        let (mut turned_at, mut count, mut sign) = (None, 0_i64, -1);
        for edge in &life.edges {
            match edge.pin {
                Pin::Step(of) if of == X && edge.level => rises.push(edge.at_ticks),
                Pin::Step(of) if of == X => {
                    if let Some(turned_at) = turned_at {
                        let setup = edge.at_ticks - turned_at;
                        assert!(
                            setup >= ticks(needs.setup_ns),
                            "{name}: set up {setup} ticks"
                        );
                    }
                    falls.push(edge.at_ticks);
                    count += sign;
                }
                Pin::Direction(of) if of == X => {
                    if let Some(fell_at) = falls.last() {
                        let held = edge.at_ticks - fell_at;
                        assert!(held >= ticks(needs.hold_ns), "{name}: held {held} ticks");
                    }
                    turned_at = Some(edge.at_ticks);
                    sign = if edge.level { 1 } else { -1 };
                }
                _ => {}
            }
        }
        // As far behind the other edge every time: as exact as that.
        let high: Vec<_> = rises
            .iter()
            .zip(&falls)
            .map(|(rise, fall)| fall - rise)
            .collect();
        assert!(high.iter().all(|ticks| *ticks == high[0]), "{name}");
        // What the driver makes of its edges is what is told.
        assert_eq!(count, bench.node.position_steps(X), "{name}");
        assert_eq!(rises.len(), falls.len(), "{name}");
    }
}
