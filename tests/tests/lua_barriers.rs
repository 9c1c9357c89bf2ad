//! Scripts that meet other parts of their job in the middle: at one instant, or with a clear word why
//! not.
//!
//! A failure prints its seed; `SEED=n cargo test -p tests --test lua_barriers` runs that one alone,
//! `RUNS=n` the first so many.

use emulator::oracle;
use keys::record::{JobRecord, JobState};
use serde_json::{Value, json};
use tests::{
    Faults, Random, World,
    network::Delay,
    world::{MS, S},
};

const SKEW_US: f64 = 5_000.0;

fn is_final(world: &World, job: &str) -> bool {
    let id = keys::JobId::new(job).expect("legal");
    let records = world.records.get(&id);
    records.is_some_and(|records| records.last().is_some_and(|last| last.state.is_final()))
}

/// A world whose clocks are known.
fn world(seed: u64, names: &[&str]) -> World {
    let mut world = World::with_nodes(seed, names);
    world.run_for(6 * S);
    world
}

fn run(world: &mut World, parts: &Value) -> JobRecord {
    let job = json!({"id": "cut", "max_skew_us": SKEW_US, "nodes": parts});
    let reply = world.submit_group("g", &job);
    world.run_until(200 * S, |world| is_final(world, "cut"));
    assert!(is_final(world, "cut"), "{:?}", world.answers(reply));
    world.record("cut").clone()
}

/// Runs a job that must fail, and returns why.
fn failed(world: &mut World, parts: &Value) -> String {
    let record = run(world, parts);
    assert_eq!(record.state, JobState::Failed, "{record:?}");
    record.error.expect("an error").message
}

fn list(commands: &Value) -> Value {
    json!({"commands": commands})
}

fn steps(count: i32) -> Value {
    json!({"move": {"axis": 0, "delay_us": 100, "steps": count}})
}

fn barrier(name: &str) -> Value {
    json!({"barrier": {"name": name}})
}

/// How far apart the edges of these numbers are, one for each node.
fn spread_us(world: &World, edges: &[(&str, usize)]) -> f64 {
    let at = edges
        .iter()
        .map(|(name, number)| world.edge_us(name, *number).expect("moved"));
    let (first, last) = at.fold((f64::MAX, f64::MIN), |(first, last), at| {
        (first.min(at), last.max(at))
    });
    last - first
}

fn check_pulses(world: &World, names: &[&str]) {
    for name in names {
        oracle::check_life(&world.node(name).life()).expect("good pulses");
    }
}

#[test]
fn scripts_and_lists_meet_in_the_middle_of_a_job() {
    let names = ["left", "right", "top"];
    let mut world = world(1, &names);
    let parts = json!({
        "left": list(&json!([steps(100), barrier("layer 1"), steps(50), barrier("layer 2"), steps(10)])),
        // Much later than the others, and it queues everything ahead.
        "right": {"lua": "motor.queue_pause(3000) motor.queue_move(0, 100, 100)
            for i = 1, 2 do motor.queue_barrier('layer ' .. i) motor.queue_move(0, 100, 20) end"},
        // Comes to the second one long after it has passed the first, and looks all the time.
        "top": {"lua": "motor.queue_barrier('layer 1') motor.queue_move(0, 100, 30) wait_idle() sleep(500)
            motor.queue_barrier('layer 2') motor.queue_move(0, 100, 5) motor.execute()
            while motor.is_busy() do end return motor.get_position(0)"}});
    let record = run(&mut world, &parts);
    assert_eq!(record.state, JobState::Succeeded, "{record:?}");
    let first = spread_us(&world, &[("left", 100), ("right", 100), ("top", 0)]);
    let second = spread_us(&world, &[("left", 150), ("right", 120), ("top", 30)]);
    assert!(first < SKEW_US && second < SKEW_US, "{first} {second}");
    // The late one was waited for.
    let waited_us =
        world.edge_us("left", 100).expect("moved") - world.edge_us("left", 99).expect("moved");
    assert!(waited_us > 2_900_000.0, "{waited_us}");
    check_pulses(&world, &names);
}

#[test]
fn a_name_that_only_lists_have_is_theirs_once_no_script_can_come() {
    let names = ["left", "right", "top"];
    let mut world = world(2, &names);
    let both = list(&json!([barrier("ours"), steps(10)]));
    let parts = json!({"left": both, "right": both, "top": {"lua": "sleep(4000) return 1"}});
    let record = run(&mut world, &parts);
    assert_eq!(record.state, JobState::Succeeded, "{record:?}");
    assert!(spread_us(&world, &[("left", 0), ("right", 0)]) < SKEW_US);
}

#[test]
fn a_part_that_does_not_come_fails_the_job_with_its_name() {
    let waits =
        "motor.queue_move(0, 100, 10) motor.queue_barrier('x') motor.queue_move(0, 100, 90)";
    let script = |text: &str| json!({ "lua": text });
    for (number, (parts, words)) in [
        (
            json!({"left": script(waits), "right": script("motor.queue_move(0, 100, 10) sleep(2000)")}),
            "right: the script ended without coming to barrier `x`",
        ),
        (
            json!({"left": script("return 1"), "right": list(&json!([barrier("x"), steps(100)]))}),
            "left: the script ended without coming to barrier `x`",
        ),
        (
            json!({"left": script(waits), "right": list(&json!([steps(10)]))}),
            "left: no other part comes to barrier `x`",
        ),
        (
            json!({"left": script("motor.queue_barrier('x') motor.queue_barrier('y')"),
                "right": script("motor.queue_barrier('y') motor.queue_barrier('x')")}),
            "left: it waits at barrier `x`, and every other part somewhere else; right: it waits at barrier `y`",
        ),
        (
            json!({"left": script("motor.queue_barrier('x') sleep(500) error('broken')"),
                "right": script("sleep(60000) motor.queue_barrier('x')")}),
            "left: lua: cut:1: broken",
        ),
    ]
    .into_iter()
    .enumerate()
    {
        let mut world = world(10 + number as u64, &["left", "right"]);
        let message = failed(&mut world, &parts);
        assert!(message.contains(words), "{message}");
        world.run_for(5 * S);
        // Nobody has gone beyond the meeting point, and nobody does.
        assert!(world.edge_count("left") <= 10 && world.edge_count("right") <= 10);
        check_pulses(&world, &["left", "right"]);
    }
}

#[test]
fn a_stop_and_a_timeout_end_everybody_who_waits() {
    let waits = json!({"lua": "motor.queue_barrier('x') motor.queue_move(0, 100, 90)"});
    let late = json!({"lua": "sleep(60000) motor.queue_barrier('x')"});
    for stopped in [true, false] {
        let mut world = world(20, &["left", "right"]);
        let job = json!({"id": "cut", "timeout_s": 10.0, "nodes": {"left": waits, "right": late}});
        let _ = world.submit_group("g", &job);
        world.run_for(5 * S);
        assert_eq!(world.node("left").status().state, keys::NodeState::Ready);
        if stopped {
            world.stop("right", keys::StopMode::Halt);
        }
        world.run_until(100 * S, |world| is_final(world, "cut"));
        let expected = if stopped {
            JobState::Failed
        } else {
            JobState::TimedOut
        };
        assert_eq!(world.record("cut").state, expected);
        world.run_for(5 * S);
        assert_eq!(world.node("left").status().state, keys::NodeState::Idle);
        assert_eq!(world.edge_count("left"), 0);
    }
}

#[test]
fn a_job_of_one_script_passes_its_barriers_alone() {
    let mut world = world(30, &["left"]);
    let parts = json!({"left": {"lua": "motor.queue_barrier('x') motor.queue_move(0, 100, 7)"}});
    assert_eq!(run(&mut world, &parts).state, JobState::Succeeded);
    assert_eq!(world.edge_count("left"), 7);
}

/// One job of several meetings with faults; returns whether it succeeded.
fn campaign(seed: u64) -> bool {
    let names = ["left", "right", "top"];
    let mut world = world(seed, &names);
    let mut random = Random(!seed);
    world.faults = Faults {
        delay: Delay::Uniform {
            us_min: 200,
            us_max: random.between(300, 20_000),
        },
        lose_per_mille: 0,
        duplicate_per_mille: random.below(100),
        reorder_per_mille: random.below(30),
    };
    let rounds = random.between(2, 5);
    let text = |pause: u64| {
        format!(
            "for i = 1, {rounds} do motor.queue_pause({pause}) motor.queue_barrier('b' .. i)
             motor.queue_move(0, 100, 10) end"
        )
    };
    let mut commands = Vec::new();
    for round in 1..=rounds {
        commands.extend([barrier(&format!("b{round}")), steps(10)]);
    }
    let job = json!({"id": "cut", "max_skew_us": 20_000.0, "ready_timeout_ms": 20_000, "nodes": {
        "left": list(&json!(commands)),
        "right": {"lua": text(random.below(800))},
        "top": {"lua": text(random.below(800))}}});
    let _ = world.submit_group("g", &job);
    for _ in 0..random.below(3) {
        world.run_for(random.below(2 * S));
        match random.below(3) {
            0 => world.break_link(names[random.below(3) as usize], random.below(1500 * MS)),
            _ => world.kill_gateway(random.below(2 * S)),
        }
    }
    world.run_until(200 * S, |world| is_final(world, "cut"));
    let record = world.record("cut");
    assert!(record.state.is_final(), "seed {seed}: {record:?}");
    let succeeded = record.state == JobState::Succeeded;
    // What all have passed, all have passed together.
    let counts = names.map(|name| world.edge_count(name));
    for round in 0..rounds as usize {
        if counts.iter().all(|count| *count > 10 * round) {
            let edges = names.map(|name| (name, 10 * round));
            let spread = spread_us(&world, &edges);
            assert!(spread < 20_000.0, "seed {seed}: round {round}: {spread} µs");
        }
    }
    if succeeded {
        assert_eq!(counts, [10 * rounds as usize; 3], "seed {seed}");
    } else {
        assert!(record.error.is_some(), "seed {seed}: {record:?}");
    }
    for name in names {
        if let Err(violations) = oracle::check_life(&world.node(name).life()) {
            panic!("seed {seed}: {name}: {}", violations[0]);
        }
    }
    succeeded
}

#[test]
fn meetings_of_scripts_survive_broken_links_and_gateways_or_say_why_not() {
    let seeds: Vec<u64> = match std::env::var("SEED") {
        Ok(seed) => vec![seed.parse().expect("a number")],
        Err(_) => {
            let runs = std::env::var("RUNS").map_or(3, |runs| runs.parse().expect("a number"));
            (1..=runs).collect()
        }
    };
    let count = seeds.len();
    let succeeded = seeds.into_iter().filter(|seed| campaign(*seed)).count();
    println!("{succeeded} of {count} jobs succeeded");
    assert!(count == 1 || succeeded > 0);
}
