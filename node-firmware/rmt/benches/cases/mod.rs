//! What is counted: commands of two lengths, and by what their cost is told.

use keys::{
    AxisId, Command,
    command::{Ramp, RampShape},
};

/// Commands of a length.
pub(crate) struct Case {
    /// What they are.
    pub(crate) name: &'static str,
    /// How many axes there are.
    pub(crate) axis_count: usize,
    /// The two lengths.
    pub(crate) sizes: [u32; 2],
    /// How many commands a length has.
    pub(crate) count: fn(u32) -> u32,
    /// The command of an index, given the length.
    pub(crate) command: fn(u32, u32) -> Command,
    /// How many of `unit` a length has.
    pub(crate) units: fn(u32) -> u32,
    /// It is stopped as soon as it moves, by the axis' deceleration.
    pub(crate) stops: bool,
    /// What the cost is told for.
    pub(crate) unit: &'static str,
}

impl Case {
    /// Returns the commands of a length.
    pub(crate) fn commands(&self, size: u32) -> impl ExactSizeIterator<Item = Command> {
        let command = self.command;
        (0..(self.count)(size)).map(move |index| command(size, index))
    }
}

const X: AxisId = AxisId(0);

const TRAPEZOID: RampShape = RampShape::Trapezoid {
    linear_steps: 0,
    jump_steps: 0,
};

/// Speed of the fast cases, Hz.
const SPEED_HZ: u32 = 200_000;

/// Acceleration of the ramps, steps/s².
const ACCEL_HZ_PER_S: u32 = 2_000_000;

fn ramp(steps: u32) -> Command {
    let ramp = Ramp {
        speed_hz: SPEED_HZ,
        accel_hz_per_s: ACCEL_HZ_PER_S,
        shape: TRAPEZOID,
    };
    Command::Ramp {
        axis: X,
        steps: steps as i32,
        ramp,
    }
}

fn run(delay_us: u32, steps: u32) -> Command {
    Command::Move {
        axis: X,
        delay_us,
        steps: steps as i32,
    }
}

/// Lines of each quarter of the circle.
const QUARTER: u32 = 157;

/// Length of a short line, steps.
const SHORT: u32 = 20;

/// One of the short lines of a circle on two axes, 20 kHz.
fn curve(index: u32, jerk_hz_per_s2: u32) -> Command {
    // (1 − t²) / (1 + t²) and 2t / (1 + t²) with t from 0 to 1 are a quarter of the circle.
    let (quarter, k) = (index / QUARTER % 4, index % QUARTER);
    let (one, square) = (QUARTER * QUARTER, k * k);
    let rounded = |value: u32| ((2 * value + one + square) / (2 * (one + square))) as i32;
    let (x, y) = (
        rounded(SHORT * (one - square)),
        rounded(SHORT * 2 * QUARTER * k),
    );
    let (x, y) = match quarter {
        0 => (x, y),
        1 => (-y, x),
        2 => (-x, -y),
        _ => (y, -x),
    };
    Command::Line {
        steps: [x, y, 0, 0],
        speed_hz: 20_000,
        accel_hz_per_s: 400_000,
        jerk_hz_per_s2,
    }
}

/// Up to 200 kHz and down again on four axes, then a pause.
fn four(index: u32, jerk_hz_per_s2: u32) -> Command {
    if index % 2 == 1 {
        return Command::Pause { pause_ms: 1 };
    }
    Command::Line {
        steps: [20_000, 19_000, 18_000, 17_000],
        speed_hz: SPEED_HZ,
        accel_hz_per_s: ACCEL_HZ_PER_S,
        jerk_hz_per_s2,
    }
}

/// All that is counted.
pub(crate) const CASES: [Case; 16] = [
    Case {
        name: "move at 200 kHz",
        axis_count: 1,
        sizes: [20_000, 120_000],
        count: |_| 1,
        command: |size, _| run(5, size),
        units: |size| size,
        stops: false,
        unit: "step",
    },
    Case {
        name: "stop of a move at 200 kHz",
        axis_count: 1,
        sizes: [5_000, 25_000],
        count: |_| 1,
        command: |size, _| run(5, size),
        units: |size| size,
        stops: true,
        unit: "step",
    },
    Case {
        name: "stop of a move at 10 kHz",
        axis_count: 1,
        sizes: [100, 400],
        count: |_| 1,
        command: |size, _| run(100, size),
        units: |size| size,
        stops: true,
        unit: "step",
    },
    Case {
        name: "move at 1 kHz",
        axis_count: 1,
        sizes: [1_000, 5_000],
        count: |_| 1,
        command: |size, _| run(1_000, size),
        units: |size| size,
        stops: false,
        unit: "step",
    },
    Case {
        name: "pause",
        axis_count: 1,
        sizes: [1_000, 5_000],
        count: |_| 1,
        command: |size, _| Command::Pause { pause_ms: size },
        units: |size| size,
        stops: false,
        unit: "ms",
    },
    Case {
        name: "moves of one step",
        axis_count: 1,
        sizes: [500, 3_500],
        count: |size| size,
        command: |_, _| run(10, 1),
        units: |size| size,
        stops: false,
        unit: "command",
    },
    Case {
        name: "ramps of 20 steps: their starts and ends",
        axis_count: 1,
        sizes: [100, 500],
        count: |size| size,
        command: |_, _| ramp(20),
        units: |size| 20 * size,
        stops: false,
        unit: "step",
    },
    Case {
        name: "ramps of 1 step",
        axis_count: 1,
        sizes: [100, 500],
        count: |size| size,
        command: |_, _| ramp(1),
        units: |size| size,
        stops: false,
        unit: "command",
    },
    Case {
        name: "ramps to 200 kHz and down",
        axis_count: 1,
        sizes: [2, 6],
        count: |size| size,
        command: |_, _| ramp(20_000),
        units: |size| 20_000 * size,
        stops: false,
        unit: "step",
    },
    Case {
        name: "ramps near 200 kHz: 180 to 200 and down",
        axis_count: 1,
        sizes: [16_200, 20_000],
        count: |_| 1,
        command: |size, _| ramp(size),
        units: |size| size,
        stops: false,
        unit: "step",
    },
    Case {
        name: "coast at 200 kHz",
        axis_count: 1,
        sizes: [120_000, 520_000],
        count: |_| 1,
        command: |size, _| ramp(size),
        units: |size| size,
        stops: false,
        unit: "step",
    },
    Case {
        name: "coast of a line on four axes, 200 kHz each",
        axis_count: 4,
        sizes: [60_000, 160_000],
        count: |_| 1,
        command: |size, _| Command::Line {
            steps: [size as i32; 4],
            speed_hz: SPEED_HZ,
            accel_hz_per_s: ACCEL_HZ_PER_S,
            jerk_hz_per_s2: 0,
        },
        units: |size| 4 * size,
        stops: false,
        unit: "step",
    },
    Case {
        name: "short lines, 64 looked at",
        axis_count: 2,
        sizes: [200, 600],
        count: |size| size,
        command: |_, index| curve(index, 0),
        units: |size| size,
        stops: false,
        unit: "line",
    },
    Case {
        name: "short S-curve lines, 64 looked at",
        axis_count: 2,
        sizes: [200, 600],
        count: |size| size,
        command: |_, index| curve(index, 20_000_000),
        units: |size| size,
        stops: false,
        unit: "line",
    },
    Case {
        name: "lines on four axes, up to 200 kHz and down",
        axis_count: 4,
        sizes: [1, 3],
        count: |size| 2 * size,
        command: |_, index| four(index, 0),
        units: |size| 74_000 * size,
        stops: false,
        unit: "step",
    },
    Case {
        name: "S-curve lines on four axes, likewise",
        axis_count: 4,
        sizes: [1, 3],
        count: |size| 2 * size,
        command: |_, index| four(index, 100_000_000),
        units: |size| 74_000 * size,
        stops: false,
        unit: "step",
    },
];
