//! What any motor would demand of its pulses, and random numbers that a seed repeats.

#![allow(dead_code, reason = "each test uses a part of it")]

use emulator::{pins::Pin, record::Life};
use keys::AxisId;

/// Ticks of one second.
pub(crate) const HZ: f64 = 16e6;

/// Returns the seeds of a property: so many, or what the environment's `SEEDS` says: as many
/// (`1000`), or from one to before another (`453..454`).
pub(crate) fn seeds(usual: u64) -> std::ops::Range<u64> {
    seeds_from(0, usual)
}

/// The same for a property whose first seed is not 0.
pub(crate) fn seeds_from(first: u64, usual: u64) -> std::ops::Range<u64> {
    let Ok(seeds) = std::env::var("SEEDS") else {
        return first..first + usual;
    };
    let number = |text: &str| {
        text.parse()
            .expect("SEEDS is a number, or two with .. between")
    };
    match seeds.split_once("..") {
        Some((from, to)) => number(from)..number(to),
        None => first..first + number(&seeds),
    }
}

/// Numbers that follow from a seed.
pub(crate) struct Random(pub(crate) u64);

impl Random {
    pub(crate) fn below(&mut self, bound: u64) -> u64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.0;
        z = (z ^ z >> 30).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ z >> 27).wrapping_mul(0x94d0_49bb_1331_11eb);
        (z ^ z >> 31) % bound
    }

    /// Small ones as often as large ones.
    pub(crate) fn of_size(&mut self, bits: u64) -> u64 {
        let size = self.below(bits) + 1;
        1 + self.below(1 << size)
    }
}

/// Times (s) and signs of an axis' steps.
pub(crate) fn steps_of(life: &Life, axis: AxisId) -> Vec<(f64, i64)> {
    let mut sign = -1;
    let mut steps = Vec::new();
    for event in &life.edges {
        match event.pin {
            Pin::Direction(of) if of == axis => sign = if event.level { 1 } else { -1 },
            Pin::Step(of) if of == axis && event.level => {
                steps.push((event.at_ticks as f64 / HZ, sign));
            }
            _ => {}
        }
    }
    steps
}

/// Demands that no speed and no acceleration is greater; each edge may be a tick off. `jump` is
/// allowed on top of a change of speed.
pub(crate) fn keeps_limits(
    life: &Life,
    axis: AxisId,
    speed: f64,
    accel: f64,
    jump: f64,
    what: &str,
) {
    let steps = steps_of(life, axis);
    for run in steps.chunk_by(|a, b| a.1 == b.1) {
        for window in [1, 2, 5, 20] {
            let mut index = 0;
            while index + 2 * window < run.len() {
                let at = |offset: usize| run[index + offset].0;
                let (first, second) = (at(window) - at(0), at(2 * window) - at(window));
                let (slow, fast) = (window as f64 / first, window as f64 / second);
                let error = 2.0 / HZ * (slow / first + fast / second);
                assert!(
                    fast <= speed + error + jump,
                    "{what}: axis {} at {:.6} s: {fast} Hz of {speed}",
                    axis.0,
                    at(window)
                );
                let most = accel * (first + second) / 2.0 + error + jump;
                assert!(
                    (fast - slow).abs() <= most,
                    "{what}: axis {} at {:.6} s: from {slow} to {fast} Hz, {} steps/s²",
                    axis.0,
                    at(window),
                    (fast - slow) / (first + second) * 2.0
                );
                index += 1;
            }
        }
    }
}
