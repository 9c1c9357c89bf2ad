//! Several gateways for one fleet: another one takes over, and the one before is not dead. It goes on,
//! comes back from a cut cable, or wakes from a sleep, and does not know that the fleet is not its
//! own any more. See `gateway::fleet::owner`.

use keys::record::JobState;
use std::{sync::Mutex, thread};
use tests::{
    World,
    campaign::run_handed_over,
    verdict::Book,
    world::{MS, OldOwner, S},
};

const RUNS: u64 = 100;

fn long_job(book: &mut Book, name: &str) -> serde_json::Value {
    let steps: Vec<_> = (0..120).map(|index| ((index % 2) as u8, 20)).collect();
    book.job(name, &steps)
}

fn all_succeeded(world: &World) -> bool {
    let mut records = world.records.values().filter_map(|records| records.last());
    records.all(|record| record.state == JobState::Succeeded)
}

#[test]
fn no_command_is_lost_or_doubled_whoever_believes_to_own_the_fleet() {
    if let Ok(seed) = std::env::var("SEED") {
        let seed = seed.parse().expect("SEED is a number");
        println!("seed {seed}: {:?}", run_handed_over(seed));
        return;
    }
    let all = Mutex::new((0, 0, 0));
    thread::scope(|scope| {
        for part in 0..2 {
            let all = &all;
            scope.spawn(move || {
                for seed in (part..RUNS).step_by(2) {
                    // Shown only if the run fails.
                    println!("seed {seed}");
                    let (outcome, count) = run_handed_over(seed);
                    let mut all = all.lock().expect("nobody failed with it");
                    all.0 += count;
                    all.1 += outcome.commands;
                    all.2 += outcome.succeeded;
                }
            });
        }
    });
    let (hand_overs, commands, succeeded) = all.into_inner().expect("nobody failed with it");
    println!("{hand_overs} hand-overs, {commands} commands taken, {succeeded} jobs succeeded");
    assert!(hand_overs > 2 * RUNS && commands > 30 * RUNS && succeeded > RUNS);
}

#[test]
fn at_any_moment_another_gateway_goes_on_where_the_node_is() {
    for at_ms in (0..200).step_by(3) {
        let mut world = World::with_nodes(at_ms, &["left", "right"]);
        let mut book = Book::new();
        for (name, node) in [("a", "left"), ("b", "left"), ("c", "right")] {
            let job = long_job(&mut book, name);
            let _ = world.submit(node, &job);
        }
        world.run_for(at_ms * MS);
        let old = match (at_ms / 3) % 3 {
            0 => OldOwner::Present,
            1 => OldOwner::CutOff(at_ms * 20 * MS),
            _ => OldOwner::Asleep(at_ms * 20 * MS),
        };
        let before = world.records.len();
        world.hand_over(old, false);
        world.run_for(20 * S);
        world.verdict(&book);
        // What was not durable yet was not accepted: its client heard no receipt.
        assert!(world.records.len() >= before);
        assert!(all_succeeded(&world), "handed over after {at_ms} ms");
    }
}

#[test]
fn an_old_owner_with_a_copy_of_the_store_moves_nothing_when_it_is_back() {
    for seed in 0..10 {
        let mut world = World::with_nodes(seed, &["left", "right"]);
        let mut book = Book::new();
        // The first one runs, the others wait: both gateways know them and want to do them.
        for name in ["a", "b", "c"] {
            let job = long_job(&mut book, name);
            let _ = world.submit("left", &job);
        }
        world.run_for(300 * MS);
        // So long that its nodes have heard the new one, so short that it misses none of them.
        world.hand_over(OldOwner::CutOff(1_500 * MS + seed * 40 * MS), true);
        world.run_for(30 * S);
        assert_eq!(world.replaced_count(), 1, "it lives and has a disk");
        world.verdict(&book);
        assert!(all_succeeded(&world), "seed {seed}");
        assert_eq!(world.records.len(), 3);
    }
}
