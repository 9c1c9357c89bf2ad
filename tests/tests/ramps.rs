//! Ramps and lines the whole way from job to record: every edge judged, every position exact, while
//! links break, nodes lose their power, gateways die and clients stop and cancel.
//!
//! A failure prints its seed; `SEED=n cargo test -p tests --test ramps` runs that one alone.

use emulator::{
    oracle,
    pins::{Pin, PinEvent},
    record::Life,
};
use keys::{
    JobId, NodeId, StopMode,
    job::{JobRequest, Work},
    record::JobState,
};
use serde_json::{Value, json};
use tests::{
    Faults, Random, World,
    network::Delay,
    verdict::Book,
    world::{MS, S},
};

const RUNS: u64 = 300;

const NODES: [&str; 3] = ["left", "middle", "right"];

/// A number from `from` to `to`, as often small as large.
fn spread(random: &mut Random, from: u32, to: u32) -> u32 {
    let (low, high) = (f64::from(from).ln(), f64::from(to).ln());
    (low + random.unit() * (high - low)).exp().round() as u32
}

fn signed(random: &mut Random, steps: u32) -> i64 {
    let sign = if random.below(2) == 0 { 1 } else { -1 };
    sign * i64::from(steps)
}

/// Adds what a ramp needs besides its way.
fn limits(random: &mut Random, mut fields: Value, number: u32) -> Value {
    let accel = spread(random, 100_000, 8_000_000);
    fields["speed_hz"] = spread(random, 1_000, 150_000).into();
    fields["accel"] = Book::accel_of(number, accel).into();
    fields
}

fn shape(random: &mut Random, mut fields: Value) -> Value {
    match random.below(5) {
        0 => fields["linear_steps"] = spread(random, 1, 500).into(),
        1 => fields["jump_steps"] = spread(random, 1, 500).into(),
        2 => {
            fields["linear_steps"] = spread(random, 1, 100).into();
            fields["jump_steps"] = spread(random, 1, 100).into();
        }
        3 => fields["jerk"] = spread(random, 3_000_000, 3_000_000_000).into(),
        _ => {}
    }
    fields
}

/// One command of any kind that moves, with this number.
fn command(random: &mut Random, number: u32) -> Value {
    let axis = random.below(2);
    let way = spread(random, 1, 400);
    let steps = signed(random, way);
    match random.below(8) {
        0 => json!({"move": {"axis": axis, "delay_us": number, "steps": steps % 40 * 2 + 1}}),
        1 => json!({"set_position": {"axis": axis, "position": number}}),
        2 if random.below(2) == 0 => {
            let start_hz = spread(random, 100, 5_000);
            let fields = json!({
                "start_hz": start_hz,
                "speed_hz": start_hz + spread(random, 1, 100_000),
                "ramp_steps": Book::ramp_steps_of(number),
            });
            smooth(random, fields, axis, steps)
        }
        2..5 => {
            let fields = limits(random, json!({"axis": axis, "steps": steps}), number);
            json!({"ramp": shape(random, fields)})
        }
        5 | 6 => {
            let fields = limits(random, json!({"axis": axis, "position": steps}), number);
            json!({"ramp_to": shape(random, fields)})
        }
        _ => {
            let steps = [steps, signed(random, way)];
            line(random, steps, number)
        }
    }
}

fn smooth(random: &mut Random, mut fields: Value, axis: u64, steps: i64) -> Value {
    fields["axis"] = axis.into();
    if random.below(3) == 0 {
        fields["position"] = steps.into();
        return json!({"smooth_ramp_to": fields});
    }
    fields["steps"] = steps.into();
    json!({"smooth_ramp": fields})
}

fn line(random: &mut Random, steps: [i64; 2], number: u32) -> Value {
    let mut fields = limits(random, json!({"steps": steps}), number);
    if random.below(3) == 0 {
        fields["jerk"] = spread(random, 3_000_000, 3_000_000_000).into();
    }
    json!({"line": fields})
}

/// Short lines that keep about their direction, so that most corners can be passed.
fn path(random: &mut Random, book: &mut Book, name: &str) -> Value {
    let count = random.between(2, 60) as usize;
    let mut angle = random.unit() * core::f64::consts::TAU;
    let length = f64::from(spread(random, 2, 60));
    let bend = random.unit() * 0.5;
    let same = limits(random, json!({}), 0);
    book.job_of(name, count, |_, number| {
        angle += (random.unit() - 0.4) * bend;
        let steps = [angle.cos(), angle.sin()].map(|part| (part * length).round() as i64);
        let mut made = line(random, if steps == [0, 0] { [1, 0] } else { steps }, number);
        made["line"]["speed_hz"] = same["speed_hz"].clone();
        made
    })
}

/// One run; returns how many commands nodes took and how many jobs succeeded.
fn run(seed: u64) -> (u64, usize) {
    let mut world = World::with_nodes(seed, &NODES);
    let mut random = Random(!seed);
    world.faults = Faults::drawn(&mut random);
    let mut book = Book::new();
    let mut jobs = 0;
    for _ in 0..random.between(8, 20) {
        let node = NODES[random.below(3) as usize];
        match random.below(16) {
            0..9 => {
                let name = format!("job-{jobs}");
                let job = if random.below(2) == 0 {
                    path(&mut random, &mut book, &name)
                } else {
                    let count = random.between(1, 15) as usize;
                    book.job_of(&name, count, |_, number| command(&mut random, number))
                };
                jobs += 1;
                let _ = world.submit(node, &job);
                if random.below(4) == 0 {
                    // The client did not hear the receipt and asks again.
                    let _ = world.submit(node, &job);
                }
            }
            9 => world.break_link(node, random.between(1, 4_000) * MS),
            10 => world.reboot(node, random.between(1, 2_000) * MS),
            11 => world.kill_gateway(random.between(1, 3_000) * MS),
            12 if jobs > 0 => {
                let _ = world.cancel(&format!("job-{}", random.below(jobs)));
            }
            13 => world.stop(node, mode(&mut random)),
            14 => {
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
    world.run_for(30 * S);
    let taken = world.verdict(&book);
    let last_states = world.records.values().filter_map(|records| records.last());
    let succeeded = last_states.filter(|record| record.state == JobState::Succeeded);
    (taken, succeeded.count())
}

fn mode(random: &mut Random) -> StopMode {
    if random.below(2) == 0 {
        StopMode::Halt
    } else {
        StopMode::Decelerate
    }
}

#[test]
fn ramps_and_lines_are_exact_whatever_fails() {
    if let Ok(seed) = std::env::var("SEED") {
        let seed = seed.parse().expect("SEED is a number");
        println!("seed {seed}: {:?}", run(seed));
        return;
    }
    let runs = std::env::var("RUNS").map_or(RUNS, |runs| runs.parse().expect("RUNS is a number"));
    let (mut commands, mut succeeded) = (0, 0);
    for seed in 0..runs {
        // Shown only if the run fails.
        println!("seed {seed}");
        let (taken, done) = run(seed);
        commands += taken;
        succeeded += done;
    }
    println!("{commands} commands, {succeeded} jobs succeeded");
    // A campaign in which nothing happens proves nothing.
    assert!(commands > 40 * runs, "{commands} commands");
    assert!(succeeded as u64 > 2 * runs, "{succeeded} jobs succeeded");
}

/// Lets time pass until a job has ended.
fn run_to_end(world: &mut World, job: &str, most_us: u64) {
    let id = JobId::new(job).expect("legal");
    world.run_until(most_us, |world| {
        let last = world.records.get(&id).and_then(|records| records.last());
        last.is_some_and(|record| record.state.is_final())
    });
}

fn judged(world: &World, seed: u64) -> Life {
    let life = world.node("left").life();
    oracle::check_life(&life).unwrap_or_else(|found| panic!("seed {seed}: {found:?}"));
    life
}

/// Ramps one after the other, and a path.
fn long_way(random: &mut Random) -> Value {
    let shapes = ["linear_steps", "jump_steps", "jerk"];
    let ramp = |random: &mut Random| {
        let mut fields = json!({"axis": random.below(2), "speed_hz": 20_000, "accel": 40_000});
        let steps = random.between(3_000, 20_000) as u32;
        fields["steps"] = signed(random, steps).into();
        match shapes.get(random.below(4) as usize) {
            Some(&"jerk") => fields["jerk"] = 800_000.into(),
            Some(shape) => fields[shape] = 300.into(),
            None => {}
        }
        json!({"ramp": fields})
    };
    let line = |index: u32| {
        let angle = f64::from(index) * 0.02;
        let steps = [angle.cos(), angle.sin()].map(|part| (part * 40.0).round() as i64);
        json!({"line": {"steps": steps, "speed_hz": 8_000, "accel": 60_000}})
    };
    let mut commands: Vec<Value> = (0..random.below(4)).map(|_| ramp(random)).collect();
    commands.extend((0..800).map(line));
    json!({"id": "first", "commands": commands})
}

#[test]
fn a_stop_or_cancel_in_a_ramp_or_path_leaves_exact_positions_and_a_way_home() {
    for seed in 0..60 {
        let mut world = World::with_nodes(seed, &["left"]);
        let mut random = Random(!seed);
        let _ = world.submit("left", &long_way(&mut random));
        let us = random.below(4 * S);
        world.run_for(20 * MS + us);
        let how = random.below(3);
        match how {
            0 => world.stop("left", StopMode::Halt),
            1 => world.stop("left", StopMode::Decelerate),
            _ => {
                let _ = world.cancel("first");
            }
        }
        // From 20 kHz it takes half a second, by an S-curve some more.
        world.run_for(2 * S);
        let life = judged(&world, seed);
        let first = world.record("first");
        let state = if how == 2 { "canceled" } else { "failed" };
        assert_eq!(first.state.as_str(), state, "seed {seed}: {first:?}");
        let result = first.result.as_ref().expect("a result");
        assert_eq!(result.position, life.counted_steps, "seed {seed}");
        assert_eq!(
            life.stops[0].positions_steps.as_slice(),
            life.counted_steps,
            "seed {seed}"
        );
        if how < 2 {
            let _ = world.release("left");
            world.run_for(500 * MS);
        }
        let to = |axis: u32| {
            json!({"ramp_to": {
                "axis": axis, "position": 0, "speed_hz": 50_000, "accel": 500_000, "jump_steps": 3
            }})
        };
        let _ = world.submit("left", &json!({"id": "home", "commands": [to(0), to(1)]}));
        run_to_end(&mut world, "home", 10 * S);
        let home = world.record("home");
        assert_eq!(home.state, JobState::Succeeded, "seed {seed}: {home:?}");
        assert_eq!(home.result.as_ref().expect("a result").position, [0, 0]);
        assert_eq!(judged(&world, seed).counted_steps, [0, 0], "seed {seed}");
        let name = NodeId::new("left").expect("legal");
        world.run_for(2 * S);
        assert_eq!(world.node_records[&name].position, [0, 0], "seed {seed}");
    }
}

/// Returns the ticks from the first to the last active edge.
fn span_ticks(life: &Life) -> u64 {
    let is_step = |edge: &&PinEvent| matches!(edge.pin, Pin::Step(_)) && edge.level;
    let mut ticks = life.edges.iter().filter(is_step).map(|edge| edge.at_ticks);
    let first = ticks.next().expect("it moved");
    ticks.next_back().expect("it moved") - first
}

#[test]
fn twenty_thousand_short_lines_over_a_bad_link_keep_their_speed() {
    let mut world = World::with_nodes(2, &["left"]);
    world.faults.delay = Delay::Uniform {
        us_min: MS,
        us_max: 20 * MS,
    };
    let line = json!({"line": {"steps": [5, 2], "speed_hz": 5_000, "accel": 100_000}});
    let job = json!({"id": "long", "commands": vec![line; 20_000]});
    let _ = world.submit("left", &job);
    run_to_end(&mut world, "long", 60 * S);
    let record = world.record("long");
    assert_eq!(record.state, JobState::Succeeded, "{record:?}");
    assert_eq!(
        record.result.as_ref().expect("a result").position,
        [100_000, 40_000]
    );
    let life = judged(&world, 2);
    assert!(life.status.faults.is_empty(), "{:?}", life.status.faults);
    // 100,000 steps at 5 kHz and one ramp up and down. With a halt at each line it were 265 s.
    let ideal_ticks = 16_000_000 * (20_000 + 50) / 1_000;
    let ticks = span_ticks(&life);
    assert!(
        ticks.abs_diff(ideal_ticks) < ideal_ticks / 100,
        "{ticks} ticks, ideal {ideal_ticks}"
    );
}

#[test]
fn every_example_job_leads_where_its_commands_say() {
    let folder = concat!(env!("CARGO_MANIFEST_DIR"), "/../gateway/examples/jobs");
    let mut names = Vec::new();
    for entry in std::fs::read_dir(folder).expect("the examples") {
        let path = entry.expect("an entry").path();
        let name = path.file_stem().and_then(|name| name.to_str());
        let name = name.expect("a name").to_owned();
        let text = std::fs::read(&path).expect("a file");
        let request = JobRequest::from_json(&text).expect("a legal job");
        let mut world = World::with_nodes(3, &["left"]);
        let mut job: Value = serde_json::from_slice(&text).expect("JSON");
        job["id"] = name.clone().into();
        let _ = world.submit("left", &job);
        run_to_end(&mut world, &name, 60 * S);
        let record = world.record(&name);
        assert_eq!(record.state, JobState::Succeeded, "{record:?}");
        let result = record.result.as_ref().expect("a result");
        let life = world.node("left").life();
        let commands: Vec<_> = match request.work {
            Work::Commands(commands) => commands.iter().map(|c| c.to_command(|_| 0)).collect(),
            // What a script says is known when it has said it.
            _ => life.commands.iter().map(|taken| taken.command).collect(),
        };
        let expected = oracle::positions_after(&commands, 2);
        assert_eq!(result.position, expected, "{name}");
        oracle::check_life(&life).unwrap_or_else(|found| panic!("{name}: {found:?}"));
        assert_eq!(life.commands.len(), commands.len(), "{name}");
        names.push(name);
    }
    names.sort();
    assert_eq!(
        names,
        ["path", "ramp", "ripples", "spiral", "squares", "stair"]
    );
}
