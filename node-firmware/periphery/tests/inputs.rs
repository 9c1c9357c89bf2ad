//! Edges on a model of the input pins: latched, bounded, never lost at the end.

use keys::AxisId;
use motion::{
    Ticks,
    io::input::{Filter, InputConfig, InputMap, Inputs, PinLevel, Role, Switch},
};
use periphery::{Capture, InputRegisters, inputs::EDGES_MAX};

/// Input pins with their interrupt, which is raised while an edge of a pin that is listened to is
/// not answered.
#[derive(Clone, Debug, Default)]
struct Pins {
    levels: u64,
    status: u64,
    listens: u64,
    now: u64,
    counters: [i16; 2],
}

impl Pins {
    fn is_raised(&self) -> bool {
        self.status & self.listens != 0
    }
}

impl InputRegisters for Pins {
    fn levels(&self) -> u64 {
        self.levels
    }

    fn acknowledge(&mut self, pins: u64) {
        self.status &= !pins;
    }

    fn listen(&mut self, pins: u64) {
        self.listens = pins;
    }

    fn now(&self) -> u64 {
        self.now
    }

    fn counter(&self, axis: usize) -> Option<i16> {
        self.counters.get(axis).copied()
    }
}

/// Pins 4, 40 and 12 are the inputs 0, 1 and 2; 7 is somebody else's.
const PINS: [u8; 3] = [4, 40, 12];

struct Bench {
    capture: Capture<Pins>,
    counted_steps: [i64; 2],
    interrupts: usize,
}

impl Bench {
    fn new(levels: u64) -> Self {
        let mut capture = Capture::new(Pins {
            levels,
            ..Pins::default()
        });
        let begun = capture.begin(&PINS);
        let expected = PINS.iter().enumerate();
        let expected = expected.map(|(index, pin)| ((levels >> pin & 1) as u32) << index);
        assert_eq!(begun, expected.sum::<u32>());
        Self {
            capture,
            counted_steps: [0; 2],
            interrupts: 0,
        }
    }

    /// A pin changes; `served`: the interrupt is let in at once.
    fn set(&mut self, pin: u8, high: bool, at: u64, served: bool) {
        let pins = self.capture.registers_mut();
        pins.now = pins.now.max(at);
        let before = pins.levels;
        pins.levels = before & !(1 << pin) | u64::from(high) << pin;
        pins.status |= before ^ pins.levels;
        if served {
            self.serve();
        }
    }

    fn serve(&mut self) {
        while self.capture.registers().is_raised() {
            self.interrupts += 1;
            self.capture.on_interrupt();
        }
    }

    fn step(&mut self, axis: usize, steps: i64) {
        self.counted_steps[axis] += steps;
        let counter = self.counted_steps[axis] as i16;
        self.capture.registers_mut().counters[axis] = counter;
    }

    fn take(&mut self) -> Vec<PinLevel> {
        let counted = self.counted_steps;
        let steps = |axis: usize| counted.get(axis).copied().unwrap_or_default();
        let levels = std::iter::from_fn(|| self.capture.poll(steps)).collect();
        self.serve();
        levels
    }
}

fn level(index: usize, level: bool, at: u64, steps: [i64; 2]) -> PinLevel {
    PinLevel {
        index,
        level,
        at: Ticks(at),
        counted_steps: [steps[0], steps[1], 0, 0],
    }
}

#[test]
fn an_edge_has_the_time_and_the_counts_of_its_interrupt_however_late_it_is_told() {
    let mut bench = Bench::new(1 << 4);
    // The counter of 16 bits has gone around before, and does again.
    bench.step(0, 65_530);
    bench.step(1, -40_000);
    bench.set(40, true, 1_000, true);
    bench.step(0, 10);
    bench.step(1, -3);
    bench.set(4, false, 1_500, true);
    bench.step(0, 20_000);
    let levels = bench.take();
    assert_eq!(
        levels,
        [
            level(1, true, 1_000, [65_530, -40_000]),
            level(0, false, 1_500, [65_540, -40_003]),
        ]
    );
    assert_eq!(bench.take(), []);
}

#[test]
fn edges_of_one_instant_and_of_foreign_pins_are_told_once_and_never() {
    let mut bench = Bench::new(0);
    bench.set(7, true, 10, true);
    assert_eq!((bench.take(), bench.interrupts), (vec![], 0));
    bench.set(4, true, 20, false);
    bench.set(12, true, 20, false);
    bench.serve();
    let mut told = bench.take();
    told.sort_by_key(|level| level.index);
    assert_eq!(
        told,
        [level(0, true, 20, [0, 0]), level(2, true, 20, [0, 0])]
    );
    // Shorter than the way into the interrupt: the hardware saw an edge, nobody a level.
    bench.set(4, false, 30, false);
    bench.set(4, true, 31, false);
    bench.serve();
    assert_eq!(bench.take(), []);
}

#[test]
fn a_wire_that_chatters_cannot_keep_the_processor_busy_and_ends_as_it_ends() {
    for last in [false, true] {
        let mut bench = Bench::new(0);
        let mut high = false;
        for at in 1..10_000 {
            high = !high;
            bench.set(40, high, at, true);
        }
        if high != last {
            bench.set(40, last, 10_000, true);
        }
        assert!(bench.interrupts <= EDGES_MAX + 1, "{}", bench.interrupts);
        let told = bench.take();
        assert!(told.len() <= EDGES_MAX + 1);
        assert!(told.windows(2).all(|pair| pair[0].at <= pair[1].at));
        assert!(told.windows(2).all(|pair| pair[0].level != pair[1].level));
        assert_eq!(told.last().map(|level| level.level), Some(last));
        // It listens again.
        bench.set(40, !last, 20_000, true);
        assert_eq!(bench.take(), [level(1, !last, 20_000, [0, 0])]);
    }
}

#[test]
fn an_edge_while_the_task_looks_is_not_lost() {
    for before in 0..3 {
        let mut bench = Bench::new(0);
        for number in 0..before {
            bench.set(4, number % 2 == 0, 10 + number, true);
        }
        let told = before as usize;
        let mut levels = Vec::new();
        for _ in 0..told {
            levels.extend(bench.capture.poll(|_| 0));
        }
        // Held off: it is not served before the task's last look lets the interrupt in.
        bench.set(12, true, 100, false);
        levels.extend(bench.take());
        levels.extend(bench.take());
        assert_eq!(levels.len(), told + 1);
        assert_eq!(levels[told], level(2, true, 100, [0, 0]));
    }
}

#[test]
fn a_limit_that_bounces_counts_from_its_first_edge_and_at_its_place() {
    let mut bench = Bench::new(0);
    let role = Role::Axis {
        axis: AxisId(0),
        switch: Switch::Min,
    };
    let switch = InputConfig {
        role,
        active_low: false,
        filter: Filter::default(),
    };
    let map = InputMap::new(&[switch], 2).expect("two axes");
    let mut inputs = Inputs::new(map, |_| false, Ticks(0));
    bench.step(0, -700);
    bench.set(4, true, 16_000, true);
    // It bounces within the 20 µs of its filter, and holds from 16,200 on.
    bench.set(4, false, 16_100, true);
    bench.step(0, -1);
    bench.set(4, true, 16_200, true);
    bench.step(0, -30);
    let mut events = Vec::new();
    for edge in bench.take() {
        while let Some(event) = inputs.poll(edge.at) {
            events.push(event);
        }
        events.extend(inputs.level(edge));
    }
    while let Some(event) = inputs.poll(Ticks(20_000)) {
        events.push(event);
    }
    assert_eq!(events.len(), 1);
    assert!(events[0].active && events[0].role == role);
    assert_eq!(events[0].at, Ticks(16_200));
    assert_eq!(events[0].counted_steps[0], -701);
}

#[test]
fn a_board_without_inputs_asks_nothing_of_its_pins() {
    let mut capture = Capture::new(Pins {
        levels: u64::MAX,
        ..Pins::default()
    });
    assert_eq!(capture.begin(&[]), 0);
    assert_eq!(capture.poll(|_| 0), None);
    assert_eq!(capture.registers().listens, 0);
}
