//! Stops at every tick, late refills, and the traps of the registers.

mod model;
mod rig;

use keys::{AxisId, Command, StopMode, status::FaultCode};
use model::{Model, ModelRegisters, Silicon};
use motion::{StepBackend, Ticks};
use rig::{Bench, Lateness, Rig, rises};
use rmt::{ChannelConfig, Layout, Place, Registers};
use std::{cell::RefCell, rc::Rc};

const X: AxisId = AxisId(0);

/// Begins commands and stops `after` ticks behind the start of the stream.
fn halted_after<const AXES: usize>(
    commands: &[Command],
    places: [Place; AXES],
    silicon: Silicon,
    after: u64,
) -> (Bench<Rig<AXES>>, u64) {
    let prefetch_words = silicon.prefetch_words as u8;
    let rig = Rig::new(silicon, Lateness::default(), places, prefetch_words);
    let mut bench = Bench::new(rig, AXES);
    bench.order(commands.iter().copied());
    bench.poll(Ticks(0));
    let at = bench.motion.backend().model.borrow().now + after;
    bench.poll(Ticks(at));
    bench.motion.stop(StopMode::Halt, Ticks(at));
    let quiet_at = bench.motion.backend().model.borrow().now;
    bench.poll(Ticks(quiet_at + 100_000));
    (bench, quiet_at)
}

fn check_halt<const AXES: usize>(
    commands: &[Command],
    places: [Place; AXES],
    silicon: Silicon,
    after: u64,
) -> i64 {
    let (bench, quiet_at) = halted_after(commands, places, silicon, after);
    let case = format!("{silicon:?}, {after} ticks after the start");
    assert_eq!(bench.fault(), None, "{case}");
    assert!(!bench.motion.backend().is_playing(), "{case}");
    let model = bench.motion.backend().model.borrow();
    for (axis, place) in places.iter().enumerate() {
        let id = AxisId(axis as u8);
        assert_eq!(
            bench.motion.backend().played_steps(id),
            model.steps[axis],
            "axis {axis}: {case}"
        );
        let of: Vec<_> = model
            .edges
            .iter()
            .filter(|edge| edge.channel == place.channel)
            .collect();
        assert!(of.iter().all(|edge| edge.at <= quiet_at), "{case}");
        for pulse in of.chunks(2) {
            assert_eq!(pulse.len(), 2, "the pin is low: {case}");
            // 500 ns at least.
            assert!(pulse[1].at - pulse[0].at >= 8, "{case}");
        }
    }
    model.steps[0]
}

#[test]
fn a_halt_at_every_tick_knows_the_count_and_cuts_no_step() {
    let commands = [
        Command::Move {
            axis: X,
            delay_us: 2,
            steps: 30,
        },
        Command::SyncMove {
            delay_us: [3, 60],
            steps: [-70, 5],
        },
    ];
    for prefetch_words in 0..=2 {
        let silicon = Silicon {
            prefetch_words,
            ..Silicon::default()
        };
        let mut counts = std::collections::BTreeSet::new();
        // Lead-in 33,760 ticks, then 960 + 3,360 ticks of steps with a turn of 3,360 between them.
        let step = if prefetch_words == 1 { 1 } else { 7 };
        for after in (31_800..42_500).step_by(step) {
            counts.insert(check_halt(
                &commands,
                Layout::FOUR.places::<2>(),
                silicon,
                after,
            ));
        }
        assert!(counts.len() > 30, "{counts:?}");
        assert_eq!((counts.first(), counts.last()), (Some(&-40), Some(&30)));
    }
}

#[test]
fn a_halt_of_four_axes_knows_all_counts() {
    let commands: Vec<_> = (0..4)
        .map(|axis| Command::Move {
            axis: AxisId(axis),
            delay_us: 5 + 13 * u32::from(axis),
            steps: 50 - 30 * i32::from(axis),
        })
        .collect();
    for after in (30_000..60_000).step_by(97) {
        check_halt(
            &commands,
            Layout::FOUR.places::<4>(),
            Silicon::default(),
            after,
        );
    }
}

#[test]
fn a_halt_in_a_long_rest_does_not_wait_for_its_end() {
    let commands = [Command::Move {
        axis: X,
        delay_us: 50_000,
        steps: 3,
    }];
    for after in (33_500..40_000).step_by(133) {
        let (bench, quiet_at) = halted_after(
            &commands,
            Layout::FOUR.places::<2>(),
            Silicon::default(),
            after,
        );
        let asked_at = bench.now.0 - 100_000;
        assert_eq!(asked_at, quiet_at);
        let edges = bench.motion.backend().model.borrow().edges.clone();
        assert_eq!(
            rises(&edges, 0).len() as i64,
            bench.motion.backend().played_steps(X)
        );
    }
}

#[test]
fn motion_goes_on_after_a_halt_in_the_right_direction() {
    for after in (32_000..38_000).step_by(61) {
        let commands = [
            Command::Move {
                axis: X,
                delay_us: 4,
                steps: 40,
            },
            Command::Move {
                axis: X,
                delay_us: 4,
                steps: -40,
            },
        ];
        let (mut bench, _) = halted_after(
            &commands,
            Layout::FOUR.places::<2>(),
            Silicon::default(),
            after,
        );
        let stopped_at = bench.motion.backend().played_steps(X);
        bench.motion.begin_queue();
        bench.order([Command::Move {
            axis: X,
            delay_us: 20,
            steps: -100,
        }]);
        bench.run_to_rest();
        assert_eq!(bench.fault(), None, "{after}");
        assert_eq!(bench.motion.backend().played_steps(X), stopped_at - 100);
        let at_pin = bench.motion.backend().model.borrow().steps[0];
        assert_eq!(at_pin, stopped_at - 100, "{after}");
    }
}

fn too_late<const AXES: usize>(places: [Place; AXES], has_counters: bool) -> Bench<Rig<AXES>> {
    let silicon = Silicon {
        has_counters,
        ..Silicon::default()
    };
    let lateness = Lateness {
        // 24 words of 5 µs last 1,920 ticks.
        interrupt_ticks_min: 9_000,
        interrupt_ticks_max: 30_000,
        ..Lateness::default()
    };
    let mut bench = Bench::new(Rig::new(silicon, lateness, places, 1), AXES);
    bench.order([Command::Move {
        axis: X,
        delay_us: 5,
        steps: 3_000,
    }]);
    bench.run_to_rest();
    bench
}

#[test]
fn a_refill_that_is_too_late_is_a_fault_and_the_counter_has_the_truth() {
    let bench = too_late(Layout::FOUR.places::<4>(), true);
    assert_eq!(bench.fault(), Some(FaultCode::REFILL_LATE));
    let backend = bench.motion.backend();
    assert_eq!(backend.played_steps(X), backend.model.borrow().steps[0]);
    assert!(!backend.is_playing());
}

#[test]
fn a_borrowed_block_that_runs_dry_ends_and_needs_no_counter_to_know_the_count() {
    let bench = too_late(Layout::FOUR.places::<2>(), false);
    assert_eq!(bench.fault(), Some(FaultCode::REFILL_LATE));
    let backend = bench.motion.backend();
    assert_eq!(backend.played_steps(X), backend.model.borrow().steps[0]);
    let edges = rises(&backend.model.borrow().edges, 0);
    assert!(edges.windows(2).all(|pair| pair[1] - pair[0] == 80));
}

#[test]
fn a_direction_that_is_switched_too_late_for_its_driver_is_a_fault_and_never_a_wrong_step() {
    // The window around a turn lasts 100 µs and the driver's setup time; the interrupt comes up to so
    // many ticks late.
    let turned = |latest_ticks: u64| {
        let lateness = Lateness {
            interrupt_ticks_min: latest_ticks,
            interrupt_ticks_max: latest_ticks,
            ..Lateness::default()
        };
        let places = Layout::FOUR.places::<4>();
        let mut bench = Bench::new(Rig::new(Silicon::default(), lateness, places, 1), 4);
        let back_and_forth = (0..10).map(|index| Command::Move {
            axis: X,
            delay_us: 20,
            steps: if index % 2 == 0 { 100 } else { -100 },
        });
        bench.order(back_and_forth);
        bench.run_to_rest();
        bench
    };
    let in_time = turned(motion::limits::TURN_LATENCY_TICKS - 100);
    assert_eq!(in_time.fault(), None);
    let setup_ticks = u64::from(motion::AxisProfile::default().dir_setup_ns) * 16 / 1_000;
    let late = turned(motion::limits::TURN_LATENCY_TICKS + setup_ticks / 2);
    assert_eq!(late.fault(), Some(FaultCode::REFILL_LATE));
    let backend = late.motion.backend();
    assert_eq!(backend.played_steps(X), backend.model.borrow().steps[0]);
}

#[test]
fn a_start_that_comes_too_late_moves_nothing() {
    let rig = Rig::new(
        Silicon::default(),
        Lateness {
            // Planning takes longer than a start may.
            start_plan_ticks: 20_000,
            ..Lateness::default()
        },
        Layout::FOUR.places::<2>(),
        1,
    );
    let mut bench = Bench::new(rig, 2);
    bench.order([Command::Move {
        axis: X,
        delay_us: 5,
        steps: 30,
    }]);
    bench.run_to_rest();
    assert_eq!(bench.fault(), Some(FaultCode::START_LATE));
    assert_eq!(bench.motion.backend().played_steps(X), 0);
    assert!(bench.motion.backend().model.borrow().edges.is_empty());
}

/// A model with one word that lasts, begun by hand.
fn begun(idle_output: bool) -> ModelRegisters {
    let model = Model::new(Silicon::default(), vec![0]);
    let mut registers = ModelRegisters(Rc::new(RefCell::new(model)));
    let config = ChannelConfig {
        divider: 5,
        blocks: 1,
        wrap: true,
        continuous: false,
        idle_output,
        idle_high: false,
        carrier: false,
    };
    registers.configure(0, config);
    registers.update(0);
    registers.write_word(0, motion::Symbol::step(1_000, 1_000).0);
    registers.write_word(1, 0);
    registers.begin(0);
    registers
}

#[test]
fn the_model_keeps_a_stop_back_until_conf_update() {
    let mut registers = begun(true);
    registers.stop(0);
    assert!(!registers.status(0).idle);
    registers.update(0);
    assert!(registers.status(0).idle && !registers.step_pin(0));
}

#[test]
fn the_model_leaves_the_level_after_a_stop_open_without_idle_output() {
    let mut registers = begun(false);
    registers.stop(0);
    registers.update(0);
    assert!(registers.status(0).idle);
    assert!(registers.step_pin(0), "erratum RMT-176");
}
