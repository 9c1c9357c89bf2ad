//! Instructions of the motion core, counted, beside what one core can do: the whole refill interrupt,
//! with its words written to the RMT's RAM, and the planner.
//!
//! Times on a shared PC say little about a chip; instructions are the same on every run. Each case
//! is executed in two lengths, and the difference is taken: what is left is the cost of the added
//! steps, without any beginning or end.
//!
//! - On this PC, under `valgrind --tool=callgrind`: also tells which functions it is spent in.
//! - On a 32-bit machine, by `.ci/rv32/run`: `riscv32imac` under qemu's exact instruction counter,
//!   which lacks the same things as the chip's core: a carry flag, a division of more than 32 bits,
//!   doubles. The shares of a core are told from these counts.
//!
//! Cycles are more still than instructions, since no wait state, no cache miss and no taken branch
//! is counted: the shares of a core are lower bounds. What the interrupt waits for the peripheral
//! bus stands in a column of its own. What is not installed is not counted, and the program says so.

mod cases;
mod run;

use cases::{CASES, Case};
use keys::command::COMMAND_WORDS;
use motion::limits::TICK_HZ;
use std::{
    collections::HashMap,
    env, fs,
    process::{Command as Process, Stdio, id},
    sync::atomic::AtomicU32,
};

/// Cycles of one core in a second.
const CORE_HZ: f64 = 240e6;

/// An access to the RMT's RAM or registers, s: some 100 ns over the peripheral bus of 80 MHz. An
/// assumption until it is measured on a board.
const ACCESS_S: f64 = 100e-9;

/// What was counted of one run, or the difference of two.
#[derive(Default)]
struct Counts {
    words: f64,
    refill: f64,
    plan: f64,
    ticks: f64,
    accesses: f64,
    /// Calls and instructions of each function itself.
    functions: HashMap<String, f64>,
}

/// Runs this program under callgrind.
fn count_here(index: usize, size: u32) -> Option<Counts> {
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
    let words = String::from_utf8_lossy(&output.stdout);
    let mut counts = read(&profile);
    counts.words = words.trim().parse().expect("the case tells its words");
    Some(counts)
}

/// Runs all cases on the 32-bit machine; empty without it. By index and length.
fn count_there() -> HashMap<(usize, u32), Counts> {
    let program = concat!(env!("CARGO_MANIFEST_DIR"), "/../../.ci/rv32/run");
    let output = Process::new(program).stderr(Stdio::null()).output();
    let Ok(output) = output.map(|output| output.stdout) else {
        return HashMap::new();
    };
    let mut all = HashMap::new();
    for line in String::from_utf8_lossy(&output).lines() {
        let numbers: Vec<u64> = line
            .split(' ')
            .map_while(|word| word.parse().ok())
            .collect();
        if let [index, size, words, refill, plan, ticks, accesses, ..] = numbers[..] {
            let counts = Counts {
                words: words as f64,
                refill: refill as f64,
                plan: plan as f64,
                ticks: ticks as f64,
                accesses: accesses as f64,
                functions: HashMap::new(),
            };
            all.insert((index as usize, size as u32), counts);
        }
    }
    all
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
            // What only the count needs.
            let is_own = function.contains("Hardware") && function.contains("play");
            if !is_call && !is_own {
                total += cost;
                *functions.entry(function.clone()).or_default() += cost;
            } else if is_call && called.contains("refill_of_axes") {
                refill += cost;
            }
            is_call = false;
        }
    }
    Counts {
        words: 0.0,
        refill,
        plan: total - refill,
        ticks: 0.0,
        accesses: 0.0,
        functions,
    }
}

fn difference(more: Counts, less: &Counts) -> Counts {
    let functions = more.functions.into_iter().map(|(name, cost)| {
        let before = less.functions.get(&name).copied().unwrap_or(0.0);
        (name, cost - before)
    });
    Counts {
        words: more.words - less.words,
        refill: more.refill - less.refill,
        plan: more.plan - less.plan,
        ticks: more.ticks - less.ticks,
        accesses: more.accesses - less.accesses,
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

fn print_counts(title: &str, counted: &[(&Case, Counts)]) {
    println!(
        "\n{title:>45} {:>8} {:>9} {:>10} {:>10}",
        "per", "refill", "per word", "planner"
    );
    for (case, counts) in counted {
        let [less, more] = case.sizes.map(case.units);
        let units = f64::from(more - less);
        println!(
            "{:>45} {:>8} {:>9.1} {:>10.1} {:>10.1}",
            case.name,
            case.unit,
            counts.refill / units,
            counts.refill / counts.words,
            counts.plan / units,
        );
    }
}

/// Prints the share of one core that each case takes while it moves. Cases of one axis count for
/// four.
fn print_budget(counted: &[(&Case, Counts)]) {
    println!("\npercent of one core of 240 MHz at one instruction a cycle, while it moves");
    println!(
        "{:>45} {:>8} {:>9} {:>9} {:>9} {:>9}",
        "", "axes", "refill", "planner", "bus", "all"
    );
    for (case, counts) in counted {
        let copies = if case.axis_count == 1 { 4 } else { 1 };
        let cycles = counts.ticks / TICK_HZ as f64 * CORE_HZ;
        let percent = |cost: f64| cost * f64::from(copies) / cycles * 100.0;
        let bus = counts.accesses * ACCESS_S * CORE_HZ;
        println!(
            "{:>45} {:>8} {:>9.1} {:>9.1} {:>9.1} {:>9.1}",
            case.name,
            case.axis_count.max(copies as usize),
            percent(counts.refill),
            percent(counts.plan),
            percent(bus),
            percent(counts.refill + counts.plan + bus)
        );
    }
}

fn report_here() {
    if !has_valgrind() {
        println!("valgrind is not installed: nothing is counted on this PC");
        return;
    }
    let mut counted = Vec::new();
    for (index, case) in CASES.iter().enumerate() {
        let [less, more] = case.sizes.map(|size| count_here(index, size));
        match (less, more) {
            (Some(less), Some(more)) => counted.push((case, difference(more, &less))),
            _ => println!("{}: valgrind gave no profile", case.name),
        }
    }
    print_counts("instructions on this PC", &counted);
    for (case, counts) in &counted {
        print_hot(case.name, counts);
    }
}

fn report_there() {
    let mut all = count_there();
    let mut counted = Vec::new();
    for (index, case) in CASES.iter().enumerate() {
        let [less, more] = case.sizes.map(|size| all.remove(&(index, size)));
        if let (Some(less), Some(more)) = (less, more) {
            counted.push((case, difference(more, &less)));
        }
    }
    if counted.len() < CASES.len() {
        println!("\n.ci/rv32/run gave no counts of a 32-bit machine: see there what it needs");
        return;
    }
    print_counts("instructions on a 32-bit machine", &counted);
    print_budget(&counted);
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
        let run = run::execute(
            &memory,
            case.axis_count,
            case.commands(size),
            case.stops,
            || 0,
        );
        println!("{}", run.words);
    } else if arguments.iter().any(|argument| argument == "--bench") {
        report_here();
        report_there();
    }
}
