//! Instructions of the motion core, counted, beside what one core can do.
//!
//! Times on a shared PC say little about a chip; instructions are the same on every run. This
//! program runs each case twice under `valgrind --tool=callgrind`, in two lengths, and takes the
//! difference: what is left is the cost of the added steps, without any beginning or end. Without
//! valgrind it says so and does nothing.
//!
//! The counts are those of the 64-bit PC build. The chip is a 32-bit machine without a wide division:
//! [`REFILL_FACTOR`] and [`PLAN_FACTOR`] say how many more instructions the same code takes there.
//! They were counted: the same cases at the same optimization, built for `riscv32imac` (which lacks
//! the same things as the chip's core: a carry flag, a division of more than 32 bits, doubles), under
//! qemu's exact instruction counter. Cycles are more still, since no wait state, no cache miss and no
//! taken branch is counted: the shares of a core are lower bounds.

use keys::{
    AxisId, Command,
    command::{COMMAND_WORDS, Ramp, RampShape},
    status::FaultCode,
};
use motion::{
    Axis, AxisProfile, CommandRing, Motion, MotionConfig, StepBackend, Ticks,
    limits::{CHANNELS, REFILL_WORDS},
};
use std::{
    collections::HashMap,
    env, fs,
    hint::black_box,
    process::{Command as Process, Stdio, id},
    sync::atomic::AtomicU32,
};

/// Instructions of a 32-bit build in the refill, over those counted here: 1.9 to 2.1.
const REFILL_FACTOR: f64 = 2.1;

/// The same in the planner: 10 to 17 for ramps and lines, most of it in 128-bit divisions and roots;
/// 1.5 to 1.8 for raw moves and constant speed.
const PLAN_FACTOR: f64 = 13.0;
const PLAN_FACTOR_OF_MOVES: f64 = 1.8;

/// Cycles of one core in a second.
const CORE_HZ: f64 = 240e6;

/// Consumes half blocks as fast as it can.
struct Sink {
    axes: [Axis; CHANNELS],
    half: usize,
    refills: u64,
    playing: bool,
}

/// The whole refill of one axis, under a name that the counts can be found by.
#[inline(never)]
fn refill_of_axis(axis: &mut Axis, half: usize) {
    black_box(axis.fill(half));
}

impl StepBackend for Sink {
    fn axes(&mut self) -> &mut [Axis] {
        &mut self.axes
    }

    fn start(&mut self, _now: Ticks, lead_ticks: u64) {
        for axis in &mut self.axes {
            black_box(axis.lead_in(lead_ticks));
        }
        self.half = 1;
        self.playing = true;
    }

    fn service(&mut self, until: Ticks) -> Ticks {
        while self.playing {
            self.playing = false;
            for axis in self.axes.iter_mut().filter(|axis| !axis.has_ended()) {
                refill_of_axis(axis, self.half);
                self.refills += 1;
                self.playing |= !axis.has_ended();
            }
            self.half ^= 1;
            if self.axes.iter().any(Axis::wants_planning) {
                return Ticks(until.0 - 1);
            }
        }
        until
    }

    fn is_playing(&self) -> bool {
        self.playing
    }

    fn halt(&mut self, now: Ticks) -> Ticks {
        self.playing = false;
        now
    }

    fn played_steps(&self, axis: AxisId) -> i64 {
        self.axes[usize::from(axis.0)].ledger().booked_steps()
    }

    fn take_fault(&mut self) -> Option<FaultCode> {
        None
    }
}

/// What is counted: commands of a length, and by what the cost is told.
struct Case {
    name: &'static str,
    axis_count: usize,
    /// The two lengths.
    sizes: [u32; 2],
    make: fn(u32) -> Vec<Command>,
    /// How many of `unit` a length has.
    units: fn(u32) -> u64,
    unit: &'static str,
    /// How long the motion of a length lasts, if its share of a core is asked for.
    seconds: Option<fn(u32) -> f64>,
}

const X: AxisId = AxisId(0);

const TRAPEZOID: RampShape = RampShape::Trapezoid {
    linear_steps: 0,
    jump_steps: 0,
};

fn ramp(steps: u32, speed_hz: u32, accel_hz_per_s: u32) -> Command {
    let ramp = Ramp {
        speed_hz,
        accel_hz_per_s,
        shape: TRAPEZOID,
    };
    let steps = steps as i32;
    Command::Ramp {
        axis: X,
        steps,
        ramp,
    }
}

fn moves(delay_us: u32, steps: u32) -> Vec<Command> {
    let steps = steps as i32;
    vec![Command::Move {
        axis: X,
        delay_us,
        steps,
    }]
}

/// A circle of short lines on two axes, about 20 steps each, 20 kHz.
fn curve(count: u32, jerk_hz_per_s2: u32) -> Vec<Command> {
    let line = |index: u32| {
        let angle = f64::from(index) * 0.01;
        let (x, y) = (20.0 * angle.cos(), 20.0 * angle.sin());
        Command::Line {
            steps: [x.round() as i32, y.round() as i32, 0, 0],
            speed_hz: 20_000,
            accel_hz_per_s: 400_000,
            jerk_hz_per_s2,
        }
    };
    (0..count).map(line).collect()
}

/// Up to 200 kHz and down again on four axes.
fn four(count: u32, jerk_hz_per_s2: u32) -> Vec<Command> {
    let line = Command::Line {
        steps: [20_000, 19_000, 18_000, 17_000],
        speed_hz: 200_000,
        accel_hz_per_s: 2_000_000,
        jerk_hz_per_s2,
    };
    let pause = Command::Pause { pause_ms: 1 };
    (0..count).flat_map(|_| [line, pause]).collect()
}

/// Acceleration of the ramps, steps/s².
const ACCEL: f64 = 2e6;

const CASES: [Case; 13] = [
    Case {
        name: "move at 200 kHz",
        axis_count: 1,
        sizes: [20_000, 120_000],
        make: |size| moves(5, size),
        units: u64::from,
        unit: "step",
        seconds: Some(|size| f64::from(size) * 5e-6),
    },
    Case {
        name: "move at 1 kHz",
        axis_count: 1,
        sizes: [1_000, 5_000],
        make: |size| moves(1_000, size),
        units: u64::from,
        unit: "step",
        seconds: None,
    },
    Case {
        name: "pause",
        axis_count: 1,
        sizes: [1_000, 5_000],
        make: |size| vec![Command::Pause { pause_ms: size }],
        units: u64::from,
        unit: "ms",
        seconds: None,
    },
    Case {
        name: "moves of one step",
        axis_count: 1,
        sizes: [500, 3_500],
        make: |size| moves(10, 1).repeat(size as usize),
        units: u64::from,
        unit: "command",
        seconds: None,
    },
    Case {
        name: "ramps of 20 steps: their starts and ends",
        axis_count: 1,
        sizes: [100, 500],
        make: |size| vec![ramp(20, 200_000, 2_000_000); size as usize],
        units: |size| 20 * u64::from(size),
        unit: "step",
        seconds: Some(|size| f64::from(size) * 2.0 * (20.0 / ACCEL).sqrt()),
    },
    Case {
        name: "ramps of 1 step",
        axis_count: 1,
        sizes: [100, 500],
        make: |size| vec![ramp(1, 200_000, 2_000_000); size as usize],
        units: u64::from,
        unit: "command",
        seconds: None,
    },
    Case {
        name: "ramps to 200 kHz and down",
        axis_count: 1,
        sizes: [2, 6],
        make: |size| vec![ramp(20_000, 200_000, 2_000_000); size as usize],
        units: |size| 20_000 * u64::from(size),
        unit: "step",
        seconds: Some(|size| f64::from(size) * 0.2),
    },
    Case {
        name: "ramps near 200 kHz: 180 to 200 and down",
        axis_count: 1,
        sizes: [16_200, 20_000],
        make: |size| vec![ramp(size, 200_000, 2_000_000)],
        units: u64::from,
        unit: "step",
        seconds: Some(|size| 2.0 * (f64::from(size) / ACCEL).sqrt()),
    },
    Case {
        name: "coast at 200 kHz",
        axis_count: 1,
        sizes: [120_000, 520_000],
        make: |size| vec![ramp(size, 200_000, 2_000_000)],
        units: u64::from,
        unit: "step",
        seconds: Some(|size| f64::from(size) * 5e-6),
    },
    Case {
        name: "short lines, 32 looked at",
        axis_count: 2,
        sizes: [200, 600],
        make: |size| curve(size, 0),
        units: u64::from,
        unit: "line",
        seconds: Some(|size| f64::from(size) * 1e-3),
    },
    Case {
        name: "short S-curve lines, 32 looked at",
        axis_count: 2,
        sizes: [200, 600],
        make: |size| curve(size, 20_000_000),
        units: u64::from,
        unit: "line",
        seconds: Some(|size| f64::from(size) * 1e-3),
    },
    Case {
        name: "lines on four axes, up to 200 kHz and down",
        axis_count: 4,
        sizes: [1, 3],
        make: |size| four(size, 0),
        units: |size| 74_000 * u64::from(size),
        unit: "step",
        seconds: Some(|size| f64::from(size) * 0.201),
    },
    Case {
        name: "S-curve lines on four axes, likewise",
        axis_count: 4,
        sizes: [1, 3],
        make: |size| four(size, 100_000_000),
        units: |size| 74_000 * u64::from(size),
        unit: "step",
        seconds: Some(|size| f64::from(size) * 0.221),
    },
];

/// Executes a case. Returns the half blocks that were refilled.
#[inline(never)]
fn execute(memory: &[AtomicU32], case: &Case, commands: &[Command]) -> u64 {
    let sink = Sink {
        axes: std::array::from_fn(|_| Axis::new(AxisProfile::default())),
        half: 0,
        refills: 0,
        playing: false,
    };
    let config = MotionConfig {
        axis_count: case.axis_count,
        ..MotionConfig::default()
    };
    let mut motion = Motion::new(CommandRing::new(memory), sink, config);
    let mut reservation = motion.reserve(commands.len()).expect("room");
    for command in commands {
        reservation.push(command);
    }
    reservation.commit();
    let mut now = Ticks(1);
    while motion.executed_commands() < commands.len() as u64 {
        black_box(motion.poll(now));
        now = now.plus(1_000_000_000);
    }
    motion.backend().refills
}

/// What was counted of one run, or the difference of two.
struct Counts {
    units: f64,
    seconds: Option<f64>,
    words: f64,
    refill: f64,
    plan: f64,
    /// Calls and instructions of each function itself.
    functions: HashMap<String, f64>,
}

/// Runs this program under callgrind.
fn count(index: usize, size: u32) -> Option<Counts> {
    let program = env::current_exe().ok()?;
    let path = env::temp_dir().join(format!("instructions-{}-{index}-{size}", id()));
    let mut file = std::ffi::OsString::from("--callgrind-out-file=");
    file.push(&path);
    let output = Process::new("valgrind")
        .args(["--tool=callgrind", "--compress-strings=no"])
        .args(["--compress-pos=no", "--collect-atstart=no"])
        .arg("--toggle-collect=*instructions*execute*")
        .arg(file)
        .arg(program)
        .args(["--case", &index.to_string(), &size.to_string()])
        .stderr(Stdio::null())
        .output()
        .ok()?;
    let profile = fs::read_to_string(&path).ok()?;
    let _ = fs::remove_file(&path);
    assert!(output.status.success(), "the case failed under valgrind");
    let refills = String::from_utf8_lossy(&output.stdout);
    let refills: u64 = refills.trim().parse().expect("the case tells its refills");
    let mut counts = read(&profile);
    counts.words = (refills * REFILL_WORDS as u64) as f64;
    counts.units = (CASES[index].units)(size) as f64;
    counts.seconds = CASES[index].seconds.map(|seconds| seconds(size));
    Some(counts)
}

/// Reads callgrind's format: costs of the function named last, and of its calls.
fn read(profile: &str) -> Counts {
    let mut functions = HashMap::new();
    let (mut total, mut refill) = (0.0, 0.0);
    let (mut function, mut called) = (String::new(), String::new());
    let mut is_call = false;
    for line in profile.lines() {
        if let Some(name) = line.strip_prefix("fn=") {
            function = name.to_owned();
        } else if let Some(name) = line.strip_prefix("cfn=") {
            called = name.to_owned();
        } else if line.starts_with("calls=") {
            is_call = true;
        } else if line.starts_with(|first: char| first.is_ascii_digit()) {
            let cost = line.split(' ').nth(1).and_then(|cost| cost.parse().ok());
            let cost: f64 = cost.unwrap_or(0.0);
            if !is_call {
                total += cost;
                *functions.entry(function.clone()).or_default() += cost;
            } else if called.contains("refill_of_axis") {
                refill += cost;
            }
            is_call = false;
        }
    }
    Counts {
        units: 0.0,
        seconds: None,
        words: 0.0,
        refill,
        plan: total - refill,
        functions,
    }
}

fn difference(more: Counts, less: &Counts) -> Counts {
    let functions = more.functions.into_iter().map(|(name, cost)| {
        let before = less.functions.get(&name).copied().unwrap_or(0.0);
        (name, cost - before)
    });
    Counts {
        units: more.units - less.units,
        seconds: more
            .seconds
            .zip(less.seconds)
            .map(|(more, less)| more - less),
        words: more.words - less.words,
        refill: more.refill - less.refill,
        plan: more.plan - less.plan,
        functions: functions.collect(),
    }
}

fn has_valgrind() -> bool {
    let mut version = Process::new("valgrind");
    version.arg("--version").stdout(Stdio::null());
    version.status().is_ok_and(|status| status.success())
}

/// Functions that are listed.
const HOT_MAX: usize = 10;

fn print_hot(what: &str, counts: &Counts) {
    let total: f64 = counts.functions.values().sum();
    let mut functions: Vec<_> = counts.functions.iter().collect();
    functions.sort_by(|a, b| b.1.total_cmp(a.1));
    println!("\nwhere: {what}");
    for (name, cost) in functions.into_iter().take(HOT_MAX) {
        let name: String = name.chars().take(90).collect();
        println!("{:>6.1} %  {name}", cost / total * 100.0);
    }
}

/// Prints the share of one core that a case takes while it moves. Cases of one axis count for four.
fn print_budget(case: &Case, counts: &Counts) {
    let Some(seconds) = counts.seconds else {
        return;
    };
    let copies = if case.axis_count == 1 { 4.0 } else { 1.0 };
    let plan_factor = if case.name.starts_with("move") || case.name.starts_with("coast") {
        PLAN_FACTOR_OF_MOVES
    } else {
        PLAN_FACTOR
    };
    let percent = |cost: f64| cost * copies / seconds / CORE_HZ * 100.0;
    let (refill, plan) = (percent(counts.refill), percent(counts.plan));
    let (chip_refill, chip_plan) = (refill * REFILL_FACTOR, plan * plan_factor);
    println!(
        "{:>45} {:>8} {refill:>7.1} {plan:>7.1} {chip_refill:>9.1} {chip_plan:>9.1} {:>9.1}",
        case.name,
        case.axis_count.max(copies as usize),
        chip_refill + chip_plan
    );
}

fn report() {
    if !has_valgrind() {
        println!("instructions are counted by valgrind, which is not installed: nothing counted");
        return;
    }
    println!(
        "{:>45} {:>8} {:>9} {:>10} {:>10}",
        "instructions", "per", "refill", "per word", "planner"
    );
    let mut all = Vec::new();
    for (index, case) in CASES.iter().enumerate() {
        let [less, more] = case.sizes.map(|size| count(index, size));
        let (Some(less), Some(more)) = (less, more) else {
            println!("{:>45} valgrind gave no profile", case.name);
            continue;
        };
        let counts = difference(more, &less);
        println!(
            "{:>45} {:>8} {:>9.1} {:>10.1} {:>10.1}",
            case.name,
            case.unit,
            counts.refill / counts.units,
            counts.refill / counts.words,
            counts.plan / counts.units,
        );
        all.push((case, counts));
    }
    println!("\npercent of one core of 240 MHz at one instruction a cycle, while it moves");
    println!(
        "{:>45} {:>8} {:>7} {:>7} {:>9} {:>9} {:>9}",
        "", "axes", "refill", "planner", "32: refill", "planner", "both"
    );
    for (case, counts) in &all {
        print_budget(case, counts);
    }
    for (case, counts) in &all {
        print_hot(case.name, counts);
    }
}

fn main() {
    let arguments: Vec<_> = env::args().collect();
    if let Some(at) = arguments.iter().position(|argument| argument == "--case") {
        let index: usize = arguments[at + 1].parse().expect("a number");
        let size: u32 = arguments[at + 2].parse().expect("a number");
        let case = &CASES[index];
        let memory: Vec<_> = (0..4_096 * COMMAND_WORDS)
            .map(|_| AtomicU32::new(0))
            .collect();
        let commands = (case.make)(size);
        println!("{}", execute(&memory, case, &commands));
    } else if arguments.iter().any(|argument| argument == "--bench") {
        report();
    }
}
