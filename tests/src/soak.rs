//! A larger fleet at work for virtual hours: does anything grow, drift or get stuck?
//!
//! Every node gets a job every half minute or so, and now and then a link breaks, a client cancels,
//! the gateway is killed. At each full hour everything comes to rest, and the hour is judged: each
//! job has its end, each node is where its pulse counter says, clocks are known.

use crate::{
    Random, World, memory,
    world::{MS, S},
};
use emulator::{EmulatorConfig, Recording};
use keys::{NodeId, record::JobState};
use std::fmt;

/// One virtual hour.
#[derive(Clone, Copy, Debug, Default)]
pub struct Hour {
    /// Its number, from 1.
    pub number: u64,
    /// Jobs that were handed in.
    pub jobs: u64,
    /// Of them, those that succeeded.
    pub succeeded: u64,
    /// Links that broke, gateways that were killed, jobs that were canceled.
    pub mishaps: u64,
    /// Resident memory of this process at its end, KiB; 0 where the system does not tell.
    pub resident_kib: u64,
}

impl Hour {
    /// The heads of the columns.
    pub const HEADER: &str = "hour    jobs  succeeded  mishaps  resident KiB";
}

impl fmt::Display for Hour {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self {
            number,
            jobs,
            succeeded,
            mishaps,
            resident_kib,
        } = self;
        write!(
            f,
            "{number:>4} {jobs:>7} {succeeded:>10} {mishaps:>8} {resident_kib:>13}"
        )
    }
}

/// Lets `nodes` nodes work for `hours` virtual hours, and tells each hour.
///
/// # Panics
/// Something is wrong at the end of an hour; the message says what.
pub fn run(nodes: usize, hours: u64, seed: u64, mut told: impl FnMut(Hour)) {
    let mut world = World::new(seed);
    world.set_recording(Recording::Off);
    let mut random = Random(!seed);
    let names: Vec<String> = (1..=nodes).map(|number| format!("node-{number}")).collect();
    for name in &names {
        let drift_ppb = random.between(0, 40_000) as i64 - 20_000;
        let config = EmulatorConfig::new(NodeId::new(name).expect("legal"));
        world.add_node(config, drift_ppb);
    }
    world.run_for(S);
    let mut job_number = 0;
    for number in 1..=hours {
        let mut hour = Hour {
            number,
            ..Hour::default()
        };
        for _ in 0..118 {
            for name in &names {
                let id = format!("job-{job_number}");
                job_number += 1;
                hour.jobs += 1;
                let _ = world.submit(name, &work(&mut random, &id));
                if random.below(200) == 0 {
                    hour.mishaps += 1;
                    match random.below(8) {
                        0 => world.kill_gateway(random.between(1, 3_000) * MS),
                        1..4 => {
                            let _ = world.cancel(&id);
                        }
                        _ => world.break_link(name, random.between(1, 4_000) * MS),
                    }
                }
                world.run_for(random.below(2 * 30 * S / nodes as u64));
            }
        }
        rest(&mut world);
        hour.succeeded = judge(&world, &names);
        world.forget_ended();
        hour.resident_kib = memory::resident_kib();
        told(hour);
    }
}

/// Twenty moves there and twenty back, so that nobody goes far.
fn work(random: &mut Random, id: &str) -> serde_json::Value {
    let mut commands = Vec::new();
    let there: Vec<_> = (0..20)
        .map(|_| (random.below(2), random.between(1, 100)))
        .collect();
    for sign in [1, -1] {
        for (axis, steps) in &there {
            let steps = sign * *steps as i64;
            let way = serde_json::json!({"axis": axis, "delay_us": 200, "steps": steps});
            commands.push(serde_json::json!({"move": way}));
        }
    }
    serde_json::json!({"id": id, "commands": commands})
}

/// Lets everything come to rest, and lifts the latches that a lost link has set.
fn rest(world: &mut World) {
    for _ in 0..3 {
        world.run_for(10 * S);
        let stopped: Vec<_> = world
            .node_records
            .values()
            .filter(|record| record.stopped.is_some())
            .map(|record| record.node)
            .collect();
        for node in stopped {
            let _ = world.release(node.as_str());
        }
    }
    world.run_for(10 * S);
}

/// Returns how many of the jobs that ended succeeded.
fn judge(world: &World, names: &[String]) -> u64 {
    let mut succeeded = 0;
    for records in world.records.values() {
        let last = records.last().expect("a list begins with its first entry");
        assert!(last.state.is_final(), "{last:?} has no end");
        succeeded += u64::from(last.state == JobState::Succeeded);
    }
    for name in names {
        let node = world.node(name);
        let axes = node.status().axes.into_iter();
        let said: Vec<i64> = axes.map(|axis| axis.position_steps).collect();
        assert_eq!(said, node.life().counted_steps, "{name}");
        let record = &world.node_records[&NodeId::new(name).expect("legal")];
        assert!(record.alive, "{record:?}");
        assert!(record.clock.is_some(), "{record:?}");
    }
    succeeded
}
