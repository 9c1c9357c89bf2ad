//! Chance against the fleet: messages are lost, doubled and overtake each other, links break,
//! nodes and the gateway restart, clients do what they like. Afterwards, with a quiet network,
//! everything that was accepted ends, nothing has run twice, and no record says more than its
//! node has done.

mod rig;

use gateway::fleet::event::Event;
use keys::{Command, JobId, StopMode, StopReason, record::JobState};
use rig::{Chance, Faults, MS, Rig, S};
use serde_json::{Value, json};

const NODES: [&str; 3] = ["left", "right", "middle"];

fn job(name: &str, count: u64) -> Value {
    let each = |index: u64| json!({"move": {"axis": 0, "delay_us": 100, "steps": index % 50 + 1}});
    json!({"id": name, "commands": (0..count).map(each).collect::<Vec<_>>()})
}

/// One random life of a fleet.
fn live(seed: u64) {
    let mut chance = Chance(seed);
    let mut rig = Rig::with(gateway::fleet::FleetConfig::default(), seed);
    rig.faults = Faults {
        delay_us_min: 100,
        delay_us_max: 1 + chance.below(300) * MS,
        drop_percent: chance.below(30),
        duplicate_percent: chance.below(30),
    };
    rig.faults.delay_us_max = rig.faults.delay_us_max.max(rig.faults.delay_us_min);
    for name in NODES {
        rig.add(name);
        rig.node(name).ring_commands = 16 + chance.below(500) as usize;
    }
    rig.run(3 * S);
    let mut receipts: Vec<JobId> = Vec::new();
    for step in 0..30 {
        let node = NODES[chance.below(3) as usize];
        match chance.below(16) {
            0..6 => {
                let most = if chance.percent(10) { 2_000 } else { 60 };
                let count = 1 + chance.below(most);
                let mut job = job(&format!("j{step}"), count);
                if chance.percent(15) {
                    job["timeout_s"] = json!(0.05 + chance.below(20) as f64 / 10.0);
                }
                receipts.extend(names(&rig.get(node, &job)));
            }
            6 => receipts.extend(names(&rig.get("*", &job(&format!("w{step}"), 20)))),
            7 | 8 => {
                if let Some(id) = receipts.get(chance.below(receipts.len().max(1) as u64) as usize)
                {
                    let id = id.to_string();
                    rig.cancel(&id);
                }
            }
            9 => rig.stop(node),
            10 | 11 => {
                rig.release(node);
            }
            12 => {
                let up = rig.node(node).link_up;
                rig.link(node, !up);
            }
            13 if chance.percent(50) => rig.reboot(node),
            14 if chance.percent(50) => {
                rig.dead = true;
                rig.run(chance.below(3) * S);
                rig.restart_gateway();
            }
            15 if chance.percent(50) => {
                let reason = [StopReason::Pin, StopReason::Link][chance.below(2) as usize];
                let now_us = rig.now_us;
                rig.node(node).stop(reason, StopMode::Decelerate, now_us);
            }
            _ => {}
        }
        let pause_us = chance.below(800) * MS;
        rig.run(pause_us);
    }
    rig.faults = Faults::NONE;
    for name in NODES {
        if !rig.node(name).link_up {
            rig.link(name, true);
        }
    }
    for _ in 0..2 {
        rig.run(8 * S);
        rig.event(Event::Release {
            pattern: "*".into(),
            reply: None,
        });
    }
    // Long enough for every job that can wait.
    for _ in 0..360 {
        if rig.fleet.jobs().all(|job| job.state().is_final()) {
            break;
        }
        rig.run(10 * S);
    }
    check(&rig, &receipts);
}

fn names(replies: &[Value]) -> Vec<JobId> {
    let name = |reply: &Value| reply["job"].as_str().map(rig::id);
    replies.iter().filter_map(name).collect()
}

fn check(rig: &Rig, receipts: &[JobId]) {
    let seed = rig.seed;
    for id in receipts {
        let record = rig.record(id);
        let view = record.node.and_then(|node| rig.fleet.node(&node));
        assert!(record.state.is_final(), "seed {seed}: {record:?} {view:#?}");
    }
    for job in rig
        .fleet
        .jobs()
        .filter(|job| job.state() != JobState::Rejected)
    {
        let record = &job.entry.record;
        let node = &rig.nodes[&record.node.expect("it has one")];
        let mine = node
            .taken
            .iter()
            .filter(|(_, _, job, _)| *job == record.job);
        let steps: Vec<i32> = mine
            .map(|(_, _, _, command)| match command {
                Command::Move { steps, .. } => *steps,
                other => panic!("{other:?}"),
            })
            .collect();
        let expected: Vec<i32> = (0..steps.len() as i32).map(|at| at % 50 + 1).collect();
        assert_eq!(
            steps, expected,
            "seed {seed}: {} ran once, in order",
            record.job
        );
        let done = node.done.get(&record.job).copied().unwrap_or(0);
        assert!(
            record.progress.done <= done,
            "seed {seed}: {record:?}, in fact {done}"
        );
        if record.state == JobState::Succeeded {
            let whole = (record.progress.total, record.progress.total);
            assert_eq!(
                (record.progress.done, done),
                whole,
                "seed {seed}: {record:?}"
            );
        }
    }
}

#[test]
fn three_hundred_random_lives_lose_no_job_and_run_no_command_twice() {
    for seed in 1..=300 {
        let outcome = std::panic::catch_unwind(|| live(seed));
        if let Err(panic) = outcome {
            eprintln!("seed {seed}");
            std::panic::resume_unwind(panic);
        }
    }
}
