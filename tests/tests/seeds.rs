//! Two thousand seeded scenarios of a fleet in which everything goes wrong, see
//! [`tests::campaign`].
//!
//! A failure prints its seed; `SEED=n cargo test -p tests --test seeds` runs that one alone, and
//! `cargo world` any number.

use std::{sync::Mutex, thread};
use tests::campaign::{Happening, Outcome, run};

const RUNS: u64 = 2_000;

#[test]
fn no_command_is_lost_doubled_or_half_taken_whatever_fails() {
    if let Ok(seed) = std::env::var("SEED") {
        let seed = seed.parse().expect("SEED is a number");
        println!("seed {seed}: {}", run(seed));
        return;
    }
    let all = Mutex::new(Outcome::default());
    thread::scope(|scope| {
        for part in 0..2 {
            let all = &all;
            scope.spawn(move || {
                for seed in (part..RUNS).step_by(2) {
                    // Shown only if the run fails.
                    println!("seed {seed}");
                    let outcome = run(seed);
                    *all.lock().expect("nobody failed with it") += outcome;
                }
            });
        }
    });
    let all = all.into_inner().expect("nobody failed with it");
    println!("{all}");
    // A campaign in which nothing happens proves nothing.
    assert!(all.commands > 100_000, "{all}");
    assert!(all.succeeded > 4_000, "{all}");
    assert!(
        all.accepted >= all.succeeded && all.accepted > all.jobs / 2,
        "{all}"
    );
    assert!(all.begun_anew > RUNS / 20, "{all}");
    for happening in Happening::ALL {
        let count = all.happened[happening as usize];
        assert!(count > RUNS / 10, "{happening:?} {count} times only");
    }
}

#[test]
fn the_same_seed_gives_the_same_run() {
    assert_eq!(run(7), run(7));
}
