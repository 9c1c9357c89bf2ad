//! A thousand seeded runs of a fleet in which everything goes wrong: delay, loss of link, duplicate
//! and reordered messages, restarts of nodes and gateway, stops, cancels, while jobs come in.
//!
//! A failure prints its seed; `SEED=n cargo test -p tests --test seeds` runs that one alone.

use keys::{StopMode, record::JobState};
use tests::{
    Faults, Random, World,
    network::Delay,
    verdict::Book,
    world::{MS, S},
};

const RUNS: u64 = 1_000;

const NODES: [&str; 3] = ["left", "middle", "right"];

/// One run; returns how many commands nodes took and how many jobs succeeded.
fn run(seed: u64) -> (u64, usize) {
    let mut world = World::with_nodes(seed, &NODES);
    let mut random = Random(!seed);
    world.faults = Faults {
        delay: Delay::Uniform {
            us_min: 200,
            us_max: random.between(300, 30_000),
        },
        lose_per_mille: 0,
        duplicate_per_mille: random.below(50),
        reorder_per_mille: random.below(20),
    };
    let mut book = Book::new();
    let mut jobs = 0;
    for _ in 0..random.between(8, 25) {
        let node = NODES[random.below(3) as usize];
        match random.below(14) {
            0..7 => {
                let count = random.between(1, 40);
                let steps: Vec<_> = (0..count)
                    .map(|_| {
                        let steps = random.between(1, 60) as i32;
                        let sign = if random.below(2) == 0 { 1 } else { -1 };
                        (random.below(2) as u8, sign * steps)
                    })
                    .collect();
                let job = book.job(&format!("job-{jobs}"), &steps);
                jobs += 1;
                let _ = world.submit(node, &job);
                if random.below(4) == 0 {
                    // The client did not hear the receipt and asks again.
                    let _ = world.submit(node, &job);
                }
            }
            7 => world.break_link(node, random.between(1, 4_000) * MS),
            8 => world.reboot(node, random.between(1, 2_000) * MS),
            9 => world.kill_gateway(random.between(1, 3_000) * MS),
            10 if jobs > 0 => {
                let _ = world.cancel(&format!("job-{}", random.below(jobs)));
            }
            11 => {
                let mode = if random.below(2) == 0 {
                    StopMode::Halt
                } else {
                    StopMode::Decelerate
                };
                world.stop(node, mode);
            }
            12 => {
                let _ = world.release(node);
            }
            _ => {}
        }
        let us = random.below(400 * MS);
        world.run_for(us);
    }
    // The faults end, the latches are lifted, and everything comes to its end.
    world.faults = Faults::NONE;
    for _ in 0..3 {
        world.run_for(4 * S);
        for node in NODES {
            let _ = world.release(node);
        }
    }
    world.run_for(8 * S);
    let taken = world.verdict(&book);
    let is_done = |records: &&Vec<keys::record::JobRecord>| {
        records
            .last()
            .is_some_and(|record| record.state == JobState::Succeeded)
    };
    (taken, world.records.values().filter(is_done).count())
}

#[test]
fn no_command_is_lost_doubled_or_half_taken_whatever_fails() {
    if let Ok(seed) = std::env::var("SEED") {
        let seed = seed.parse().expect("SEED is a number");
        println!("seed {seed}: {:?}", run(seed));
        return;
    }
    let (mut commands, mut succeeded) = (0, 0);
    for seed in 0..RUNS {
        // Shown only if the run fails.
        println!("seed {seed}");
        let (taken, done) = run(seed);
        commands += taken;
        succeeded += done;
    }
    // A campaign in which nothing happens proves nothing.
    assert!(commands > 50_000, "{commands} commands");
    assert!(succeeded > 2_000, "{succeeded} jobs succeeded");
}

#[test]
fn the_same_seed_gives_the_same_run() {
    assert_eq!(run(7), run(7));
}
