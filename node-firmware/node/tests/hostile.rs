//! Hostile scripts on a whole node: its status flows, its motion keeps its pulses, stops are heard, and the
//! next job runs as if nothing had been.

#[path = "../../script/tests/generator/mod.rs"]
mod generator;
mod rig;
mod scripts;

use emulator::{Recording, oracle};
use keys::{NodeState, ScriptOutcome, StopMode, Verdict};
use rig::{Rig, random, steps};
use scripts::{last, script_orders, send};

/// Scripts of one run.
const SCRIPTS: u64 = 30;

#[test]
fn a_node_that_runs_hostile_scripts_stays_alive_and_does_its_work() {
    let seeds = match std::env::var("SEED") {
        Ok(seed) => {
            let seed: u64 = seed.parse().expect("a number");
            seed..=seed
        }
        Err(_) => 1..=SCRIPTS,
    };
    for seed in seeds {
        let mut config = rig::config();
        config.record = Recording::Edges { max: 1_000_000 };
        config.script.memory_bytes = 256 * 1024;
        config.script.slice_instructions = 500;
        let mut rig = Rig::new(config);
        // Half a second of steps, which the script shall not disturb.
        assert_eq!(rig.batch(&[steps(5_000)]).verdict, Verdict::Accepted);
        let mut random = random(seed);
        let text = generator::block(&mut |below| random(below as u64) as usize, 3);
        for order in script_orders(&rig, "hostile", &text, 1000) {
            let _ = rig.order_bytes(&order);
        }
        rig.run_for(2_500_000);
        // Ten a second while it works, one a second when the script has ended and took the queue with it.
        let told: Vec<u64> = rig.statuses().iter().map(|(at, _)| at.0).collect();
        let silent_us = told.windows(2).map(|pair| pair[1] - pair[0]).max();
        assert!(
            told.len() > 3 && silent_us <= Some(1_000_000),
            "seed {seed}: {silent_us:?} µs without a status\n{text}"
        );
        // Whatever it does: a stop is heard at once, and after the release everything is as before.
        rig.stop(StopMode::Halt);
        rig.run_for(200_000);
        assert_eq!(rig.state(), NodeState::Stopped, "seed {seed}\n{text}");
        let _ = rig.release(rig.queue());
        let from = rig.position();
        assert_eq!(
            rig.batch(&[steps(100)]).verdict,
            Verdict::Accepted,
            "seed {seed}"
        );
        rig.run_for(100_000);
        send(
            &mut rig,
            "motor.queue_move(0, 100, 10) wait_idle() return 'well'",
        );
        rig.run_for(300_000);
        assert_eq!(
            last(&rig),
            (ScriptOutcome::Returned, "\"well\"".into()),
            "seed {seed}"
        );
        assert_eq!(rig.position(), from + 110, "seed {seed}");
        if let Err(violations) = oracle::check_life(&rig.node.life()) {
            panic!("seed {seed}: {}\n{text}", violations[0]);
        }
    }
}
