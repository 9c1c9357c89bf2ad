//! `cargo world`: any number of scenarios, or a long quiet life of a larger fleet.
//!
//! ```text
//!   cargo world -- scenarios --count 100000          from seed 0, on all cores
//!   cargo world -- scenarios --seed 4711             one, told in a line
//!   cargo world -- soak --nodes 20 --hours 24        virtual hours; memory at each of them
//!   cargo world -- soak --wall 30                    minutes, with real processes and sockets
//!   cargo world -- cables --seconds 60               network namespaces, delay, loss, pulled cables
//! ```

use clap::{Parser, Subcommand};
use std::{
    io::{self, Write},
    panic,
    process::ExitCode,
    sync::atomic::{AtomicU64, Ordering},
    sync::{Mutex, PoisonError},
    thread,
    time::{Duration, Instant},
};
use tests::{
    cables,
    campaign::{self, Outcome},
    field,
    long::{self, Growth, Sample},
    memory,
    soak::{self, Hour},
};

/// The fleet in a bottle, for as long as it takes.
#[derive(Debug, Parser)]
#[command(name = "world", max_term_width = 100)]
struct Line {
    #[command(subcommand)]
    verb: Verb,
}

#[derive(Debug, Subcommand)]
enum Verb {
    /// Run scenarios in which everything fails, and judge each.
    Scenarios {
        /// How many.
        #[arg(long, default_value_t = 100_000)]
        count: u64,
        /// The first seed.
        #[arg(long, default_value_t = 0)]
        from: u64,
        /// Run this seed alone.
        #[arg(long, conflicts_with_all = ["count", "from"])]
        seed: Option<u64>,
        /// How many at once [default: the cores of this machine].
        #[arg(long)]
        threads: Option<usize>,
    },
    /// Let a fleet work through virtual hours, and tell the memory of this process at each.
    Soak {
        /// How many nodes.
        #[arg(long, default_value_t = 20)]
        nodes: usize,
        /// How many virtual hours.
        #[arg(long, default_value_t = 24)]
        hours: u64,
        /// Where its random numbers come from.
        #[arg(long, default_value_t = 1)]
        seed: u64,
        /// So many minutes of a real clock instead, with a gateway and nodes as processes; memory and
        /// file descriptors of both twice a minute.
        #[arg(long, value_name = "MINUTES", conflicts_with = "hours")]
        wall: Option<u64>,
    },
    /// Router, gateway and nodes in network namespaces of their own, with delay and loss; cables are
    /// pulled, the gateway is killed, the router restarts. As root; says so where that is not allowed.
    Cables {
        /// How long things go wrong.
        #[arg(long, default_value_t = 60)]
        seconds: u64,
        /// Where its random numbers come from.
        #[arg(long, default_value_t = 1)]
        seed: u64,
        /// It runs in this namespace already.
        #[arg(long, hide = true)]
        inside: Option<String>,
    },
    /// A zenoh router and nothing else, until it is killed.
    #[command(hide = true)]
    Router {
        /// Where it listens.
        address: String,
    },
}

fn main() -> ExitCode {
    match Line::parse().verb {
        Verb::Scenarios {
            seed: Some(seed), ..
        } => {
            let outcome = campaign::run_told(seed, |us, happening, node| {
                println!("{:>10} ms  {happening:?} {node}", us / 1_000);
            });
            println!("seed {seed}: {outcome}");
            ExitCode::SUCCESS
        }
        Verb::Scenarios {
            count,
            from,
            threads,
            ..
        } => scenarios(from, count, threads),
        Verb::Cables {
            seconds,
            seed,
            inside: Some(space),
        } => match cables::run(&space, Duration::from_secs(seconds), seed) {
            Ok(outcome) => {
                println!("{outcome}");
                ExitCode::SUCCESS
            }
            Err(error) => skipped(&error),
        },
        Verb::Cables { .. } => {
            let arguments: Vec<_> = std::env::args().skip(1).collect();
            cables::enter(&arguments).map_or_else(|error| skipped(&error), |()| ExitCode::SUCCESS)
        }
        Verb::Router { address } => {
            let _router = field::open_router_on(&address);
            loop {
                thread::park();
            }
        }
        Verb::Soak {
            nodes,
            seed,
            wall: Some(minutes),
            ..
        } => {
            let mut samples = Vec::new();
            println!("{}", Sample::HEADER);
            let wall = Duration::from_secs(60 * minutes);
            long::run(nodes, wall, Duration::from_secs(30), seed, |sample| {
                println!("{sample}");
                let _ = io::stdout().flush();
                samples.push(sample);
            });
            println!("{:?}", Growth::of(&samples));
            ExitCode::SUCCESS
        }
        Verb::Soak {
            nodes, hours, seed, ..
        } => {
            println!("{}", Hour::HEADER);
            soak::run(nodes, hours, seed, |hour| {
                println!("{hour}");
                // A closed pipe ends nothing that has begun.
                let _ = io::stdout().flush();
            });
            ExitCode::SUCCESS
        }
    }
}

fn skipped(why: &str) -> ExitCode {
    println!("skipped, nothing was tested: this machine does not allow network namespaces ({why})");
    ExitCode::SUCCESS
}

fn scenarios(from: u64, count: u64, threads: Option<usize>) -> ExitCode {
    let cores = || thread::available_parallelism().map_or(1, usize::from);
    let threads = threads.unwrap_or_else(cores).max(1);
    let begun = Instant::now();
    let next = AtomicU64::new(from);
    let all = Mutex::new((Outcome::default(), Vec::new()));
    // Each scenario begins with nothing, so memory is that of the largest one, however many there
    // are: told with the progress, so that somebody can see it.
    let tell = (count / 20).max(1_000);
    let work = || {
        loop {
            let seed = next.fetch_add(1, Ordering::Relaxed);
            if seed >= from + count {
                return;
            }
            let done = seed - from;
            if done > 0 && done.is_multiple_of(tell) {
                let rate = done as f64 / begun.elapsed().as_secs_f64();
                println!(
                    "{done:>9}  {rate:>6.1}/s  {:>8} KiB",
                    memory::resident_kib()
                );
                let _ = io::stdout().flush();
            }
            let outcome = panic::catch_unwind(|| campaign::run(seed));
            let mut all = all.lock().unwrap_or_else(PoisonError::into_inner);
            match outcome {
                Ok(outcome) => all.0 += outcome,
                Err(_) => {
                    eprintln!("seed {seed} failed: cargo world -- scenarios --seed {seed}");
                    all.1.push(seed);
                }
            }
        }
    };
    thread::scope(|scope| {
        for _ in 0..threads {
            scope.spawn(work);
        }
    });
    let (outcome, failed) = all.into_inner().unwrap_or_else(PoisonError::into_inner);
    let seconds = begun.elapsed().as_secs_f64();
    let rate = count as f64 / seconds;
    println!("{count} scenarios in {seconds:.0} s ({rate:.1}/s): {outcome}");
    if failed.is_empty() {
        println!("nothing lost, nothing doubled, every job has its end");
        ExitCode::SUCCESS
    } else {
        println!("{} failed: {failed:?}", failed.len());
        ExitCode::FAILURE
    }
}
