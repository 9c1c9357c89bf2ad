//! The driver's pulses on the model of the RMT, beside those of the emulator for the same commands.

mod model;
mod rig;

use emulator::pulse::{RmtConfig, VirtualRmt};
use keys::{
    AxisId, Command,
    command::{Ramp, RampShape},
};
use model::Silicon;
use motion::{Motion, StepBackend};
use rig::{Bench, Lateness, Rig, rises, splitmix};
use rmt::{Layout, Place};

const X: AxisId = AxisId(0);
const Y: AxisId = AxisId(1);

fn steps(axis: AxisId, delay_us: u32, steps: i32) -> Command {
    Command::Move {
        axis,
        delay_us,
        steps,
    }
}

/// Edges of each axis after the first edge of all, as the emulator plays them.
fn emulated(commands: &[Command], axes: usize) -> Vec<Vec<u64>> {
    let config = RmtConfig {
        start_skew_ticks_max: 0,
        ..RmtConfig::default()
    };
    let mut backend = VirtualRmt::new(config, 3);
    backend.record_edges(true);
    let mut bench = Bench::new(backend, axes);
    bench.order(commands.iter().copied());
    bench.run_to_rest();
    assert_eq!(bench.fault(), None);
    let edges: Vec<_> = bench.motion.backend_mut().take_edges().collect();
    let rise = |axis: usize| {
        let pin = emulator::pins::Pin::Step(AxisId(axis as u8));
        let of = |edge: &&emulator::pins::PinEvent| edge.pin == pin && edge.level;
        edges
            .iter()
            .filter(of)
            .map(|edge| edge.at_ticks)
            .collect::<Vec<_>>()
    };
    from_first((0..axes).map(rise).collect())
}

fn from_first(mut all: Vec<Vec<u64>>) -> Vec<Vec<u64>> {
    let first = all.iter().filter_map(|edges| edges.first()).min().copied();
    for edge in all.iter_mut().flatten() {
        *edge -= first.expect("there is an edge");
    }
    all
}

/// Runs commands on the driver; returns the bench and its edges after the first.
fn driven<const AXES: usize>(
    commands: &[Command],
    places: [Place; AXES],
    silicon: Silicon,
    lateness: Lateness,
) -> (Bench<Rig<AXES>>, Vec<Vec<u64>>) {
    let prefetch_words = silicon.prefetch_words as u8;
    let mut bench = Bench::new(Rig::new(silicon, lateness, places, prefetch_words), AXES);
    bench.order(commands.iter().copied());
    bench.run_to_rest();
    let edges = bench.motion.backend().model.borrow().edges.clone();
    let all = places.map(|place| rises(&edges, place.channel)).to_vec();
    if all.iter().all(Vec::is_empty) {
        return (bench, all);
    }
    (bench, from_first(all))
}

fn assert_same<const AXES: usize>(commands: &[Command], places: [Place; AXES], silicon: Silicon) {
    let (bench, edges) = driven(commands, places, silicon, Lateness::default());
    assert_eq!(bench.fault(), None, "{silicon:?}");
    assert_eq!(edges, emulated(commands, AXES), "{silicon:?}");
    check_counts(&bench.motion, AXES);
}

/// The ledger, the counter and the pin agree.
fn check_counts<const AXES: usize>(motion: &Motion<'_, Rig<AXES>>, axes: usize) {
    for axis in 0..axes {
        let id = AxisId(axis as u8);
        let at_pin = motion.backend().model.borrow().steps[axis];
        assert_eq!(motion.backend().played_steps(id), at_pin, "axis {axis}");
        if let Some(counted) = motion.backend().counted_steps(id) {
            assert_eq!(counted, at_pin, "axis {axis}");
        }
    }
}

fn mixed(seed: u64, count: usize, axes: u8) -> Vec<Command> {
    let mut random = seed;
    let mut next = |below: u64| {
        random = splitmix(random);
        random % below
    };
    (0..count)
        .map(|_| {
            let axis = AxisId(next(u64::from(axes)) as u8);
            let count = 1 + next(60) as i32;
            let sign = if next(3) == 0 { -1 } else { 1 };
            match next(8) {
                0 => Command::Pause {
                    pause_ms: next(3) as u32,
                },
                1 if axes > 1 => Command::SyncMove {
                    delay_us: [10 + next(90) as u32, 10 + next(90) as u32],
                    steps: [sign * count, count],
                },
                _ => steps(axis, 6 + next(300) as u32, sign * count),
            }
        })
        .collect()
}

fn silicons() -> impl Iterator<Item = Silicon> + Clone {
    (0..=2).flat_map(|prefetch_words| {
        [false, true].map(|threshold_on_fetch| Silicon {
            prefetch_words,
            threshold_on_fetch,
            ..Silicon::default()
        })
    })
}

#[test]
fn a_word_that_the_block_holds_is_not_written_again() {
    let fast = |speed_hz| Ramp {
        speed_hz,
        accel_hz_per_s: 2_000_000,
        shape: keys::command::RampShape::Trapezoid {
            linear_steps: 0,
            jump_steps: 0,
        },
    };
    // Whole ticks, and intervals that take turns.
    for (speed_hz, percent_max) in [(100_000, 75), (97_777, 90)] {
        let commands = [Command::Ramp {
            axis: X,
            steps: 40_000,
            ramp: fast(speed_hz),
        }];
        let places = Layout::FOUR.places::<4>();
        let lateness = Lateness::default();
        let (bench, edges) = driven(&commands, places, Silicon::default(), lateness);
        assert_eq!(bench.fault(), None);
        assert_eq!(edges, emulated(&commands, 4));
        let writes = bench.motion.backend().model.borrow().writes;
        let words = edges[0].len() as u64;
        // The other axes rest in long words, all alike.
        assert!(
            100 * writes < percent_max * words,
            "{speed_hz} Hz: {writes} writes for {words} words"
        );
    }
}

#[test]
fn the_pulses_are_those_of_the_emulator_whatever_the_prefetch() {
    for (seed, silicon) in (11..).zip(silicons().cycle().take(30)) {
        println!("seed {seed}");
        let commands = mixed(seed, 150, 2);
        assert_same(&commands, Layout::FOUR.places::<2>(), silicon);
        assert_same(&commands, Layout::TWO.places::<2>(), silicon);
    }
}

#[test]
fn four_axes_with_a_block_each_play_what_the_emulator_plays() {
    for seed in 0..6 {
        println!("seed {seed}");
        let commands = mixed(seed, 200, 4);
        assert_same(&commands, Layout::FOUR.places::<4>(), Silicon::default());
    }
}

#[test]
fn three_axes_have_blocks_of_three_lengths_and_play_what_the_emulator_plays() {
    let places = Layout::FOUR.places::<3>();
    assert_eq!(places.map(|place| place.words()), [48, 96, 240]);
    for (seed, silicon) in (31..).zip(silicons()) {
        println!("seed {seed}");
        assert_same(&mixed(seed, 150, 3), places, silicon);
    }
}

#[test]
fn ramps_are_those_of_the_emulator() {
    let ramp = |axis, steps, jerk_hz_per_s2| Command::Ramp {
        axis,
        steps,
        ramp: Ramp {
            speed_hz: 20_000,
            accel_hz_per_s: 400_000,
            shape: if jerk_hz_per_s2 > 0 {
                RampShape::Jerk { jerk_hz_per_s2 }
            } else {
                RampShape::Trapezoid {
                    linear_steps: 0,
                    jump_steps: 0,
                }
            },
        },
    };
    let commands = [
        ramp(X, 1_500, 0),
        ramp(Y, -700, 50_000_000),
        ramp(X, -900, 0),
    ];
    assert_same(&commands, Layout::FOUR.places::<2>(), Silicon::default());
    assert_same(&commands, Layout::FOUR.places::<4>(), Silicon::default());
}

#[test]
fn a_long_stream_wraps_its_block_without_a_gap() {
    let commands = [steps(X, 5, 20_000), steps(X, 5, 20_000)];
    let (bench, edges) = driven(
        &commands,
        Layout::FOUR.places::<2>(),
        Silicon::default(),
        Lateness::default(),
    );
    assert_eq!(bench.fault(), None);
    assert_eq!(edges[0].len(), 40_000);
    assert!(edges[0].windows(2).all(|pair| pair[1] - pair[0] == 80));
    // More than the counter's 16 bits hold.
    assert_eq!(bench.motion.backend().counted_steps(X), Some(40_000));
}

#[test]
fn turns_are_made_where_nothing_steps() {
    let commands: Vec<_> = (0..60)
        .flat_map(|index| {
            let sign = if index % 2 == 0 { 1 } else { -1 };
            [steps(X, 8, 37 * sign), steps(Y, 300, 3 * sign)]
        })
        .collect();
    for silicon in silicons() {
        let (bench, edges) = driven(
            &commands,
            Layout::FOUR.places::<2>(),
            silicon,
            Lateness::default(),
        );
        assert_eq!(bench.fault(), None);
        check_counts(&bench.motion, 2);
        assert_eq!(edges, emulated(&commands, 2));
        let model = bench.motion.backend().model.borrow();
        assert!(model.turns.len() > 100);
        for turn in &model.turns {
            let channel = [0, 3][turn.channel];
            let of = model.edges.iter().filter(|edge| edge.channel == channel);
            // Default profile: 10 µs each way.
            let near = of.filter(|edge| edge.at.abs_diff(turn.at) < 160).count();
            assert_eq!(near, 0, "{turn:?} {silicon:?}");
        }
    }
}

#[test]
fn the_first_edge_comes_when_it_was_ordered_and_on_all_axes() {
    let sync = Command::SyncMove {
        delay_us: [500, 700],
        steps: [20, 10],
    };
    let silicon = Silicon {
        skew_ticks: [3, 0, 0, 1],
        ..Silicon::default()
    };
    let rig = Rig::new(
        silicon,
        Lateness::default(),
        Layout::FOUR.places::<2>(),
        silicon.prefetch_words as u8,
    );
    let mut bench = Bench::new(rig, 2);
    bench.order([Command::Barrier { barrier: 1 }, sync]);
    bench.poll(motion::Ticks(1_000));
    let start_at = motion::Ticks(400_000);
    bench.motion.release_barrier(start_at);
    let alarm = bench.motion.poll_timeout().expect("the alarm");
    let model = bench.motion.backend().model.clone();
    model.borrow_mut().advance(alarm.0, false);
    bench.poll(alarm);
    bench.run_to_rest();
    let edges = &model.borrow().edges;
    for channel in [0, 3] {
        let first = rises(edges, channel)[0];
        assert!(first.abs_diff(start_at.0) <= 4, "{first}");
    }
}

#[test]
fn an_event_that_comes_while_another_is_answered_is_answered_too() {
    for seed in 30..60 {
        println!("seed {seed}");
        let silicon = Silicon {
            prefetch_words: 2,
            threshold_on_fetch: true,
            access_ticks: 1 + seed % 8,
            ..Silicon::default()
        };
        let commands = mixed(seed, 150, 2);
        assert_same(&commands, Layout::TWO.places::<2>(), silicon);
    }
}

#[test]
fn late_interrupts_are_caught_up_by_a_borrowed_block() {
    // 10 µs a step: 24 words are 240 µs, 120 words 1.2 ms.
    let commands = [Command::SyncMove {
        delay_us: [10, 10],
        steps: [5_000, 5_000],
    }];
    let lateness = Lateness {
        interrupt_ticks_min: 100,
        interrupt_ticks_max: 12_000,
        ..Lateness::default()
    };
    let (bench, edges) = driven(
        &commands,
        Layout::FOUR.places::<2>(),
        Silicon::default(),
        lateness,
    );
    assert_eq!(bench.fault(), None);
    assert!(edges[0].windows(2).all(|pair| pair[1] - pair[0] == 160));
    check_counts(&bench.motion, 2);
}

#[test]
fn planning_does_not_starve_the_pins() {
    // Every look of the planner takes 100 µs; a block of 48 words lasts 240 µs.
    let commands: Vec<_> = (0..400).map(|index| steps(X, 5, 20 + index % 7)).collect();
    let lateness = Lateness {
        plan_ticks: 800,
        ..Lateness::default()
    };
    let (bench, edges) = driven(
        &commands,
        Layout::FOUR.places::<2>(),
        Silicon::default(),
        lateness,
    );
    assert_eq!(bench.fault(), None);
    assert!(edges[0].windows(2).all(|pair| pair[1] - pair[0] == 80));
}
