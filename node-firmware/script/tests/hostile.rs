//! A thousand scripts that somebody could write in anger. None may hang, crash or starve the node:
//! each ends, or gives way in every slice.

mod generator;
mod rig;

use generator::block;
use rig::{Bench, limits, random};
use script::{Script, Step};
use std::time::{Duration, Instant};

/// The end of a script that has used up its memory is told, too.
const FOR_A_TRACEBACK: usize = 32 * 1024;

#[test]
fn a_thousand_hostile_scripts_end_or_give_way() {
    let seeds: Vec<u64> = match std::env::var("SEED") {
        Ok(seed) => vec![seed.parse().expect("a number")],
        Err(_) => (1..=1000).collect(),
    };
    let (mut ended, mut gave_way, mut refused) = (0, 0, 0);
    let mut worst = (Duration::ZERO, 0);
    for seed in seeds {
        let mut random = random(seed);
        let text = block(&mut random, 3);
        let mut bench = Bench::default();
        let Ok(mut script) = Script::start(&text, "hostile", "left", 0, limits(), bench.now) else {
            refused += 1;
            continue;
        };
        let mut over = false;
        for _ in 0..100 {
            let begin = Instant::now();
            let step = script.step(&mut bench);
            let took = begin.elapsed();
            if took > worst.0 {
                worst = (took, seed);
            }
            // Not a measurement, and far above what a busy machine needs: hanging is for ever.
            assert!(
                took < Duration::from_secs(20),
                "seed {seed}: a step took {took:?}\n{text}"
            );
            assert!(
                script.memory_bytes() <= limits().memory_bytes + FOR_A_TRACEBACK,
                "seed {seed}: {} bytes",
                script.memory_bytes()
            );
            assert!(bench.queue.len() <= bench.capacity, "seed {seed}");
            match step {
                Step::Ended(_) => {
                    over = true;
                    break;
                }
                Step::Waits(_) => {
                    bench.execute_all();
                    bench.published.clear();
                    bench.now = bench.now.plus_us(1_000);
                }
            }
        }
        if over {
            ended += 1;
        } else {
            gave_way += 1;
        }
    }
    println!("{ended} ended, {gave_way} gave way, {refused} refused; longest step {worst:?}");
    assert!(
        std::env::var("SEED").is_ok() || refused < 100,
        "most of them are scripts"
    );
}
