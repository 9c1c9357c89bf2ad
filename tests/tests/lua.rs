//! Scripts the whole way: from a job's text to pulses, and back as a result or an error, while links
//! break, nodes lose their power, gateways die and clients stop and cancel.
//!
//! A failure prints its seed; `SEED=n cargo test -p tests --test lua` runs that one alone.

use emulator::oracle;
use keys::{
    StopMode,
    record::{ErrorCode, JobRecord, JobState},
};
use serde_json::{Value, json};
use tests::{
    Faults, Random, World,
    network::Delay,
    world::{MS, S},
};

fn is_final(world: &World, job: &str) -> bool {
    let id = keys::JobId::new(job).expect("legal");
    let records = world.records.get(&id);
    records.is_some_and(|records| records.last().is_some_and(|last| last.state.is_final()))
}

/// Runs one script to its end.
fn run(world: &mut World, job: &Value) -> JobRecord {
    let name = job["id"].as_str().expect("a name").to_owned();
    let _ = world.submit("left", job);
    world.run_until(100 * S, |world| is_final(world, &name));
    world.record(&name).clone()
}

fn returned(record: &JobRecord) -> Value {
    assert_eq!(record.state, JobState::Succeeded, "{record:?}");
    let result = record.result.as_ref().expect("a result");
    result.returned.clone().unwrap_or_default()
}

#[test]
fn a_script_becomes_exact_pulses_and_what_it_returns_comes_back() {
    let mut world = World::with_nodes(1, &["left"]);
    let job = json!({"id": "spiral", "lua": "
        for i = 1, 500 do motor.queue_sync_move(100 + i, 1 + i % 7, 200, -1 - i % 3) end
        motor.execute() wait_idle()
        return {at = motor.get_position(0), text = 'done'}"});
    let record = run(&mut world, &job);
    let result = record.result.clone().expect("a result");
    assert_eq!(
        returned(&record),
        json!({"at": result.position[0], "text": "done"})
    );
    assert_eq!((record.progress.done, record.progress.total), (500, 500));
    let summary = oracle::check_life(&world.node("left").life()).expect("good pulses");
    assert_eq!(summary.commands, 501);
    // Another job goes on in the same queue.
    let next =
        json!({"id": "next", "commands": [{"move": {"axis": 0, "delay_us": 100, "steps": 9}}]});
    let next = run(&mut world, &next);
    assert_eq!(next.state, JobState::Succeeded);
    assert_eq!(
        next.result.expect("a result").position[0],
        result.position[0] + 9
    );
    assert_eq!(next.progress.total, 1);
}

#[test]
fn what_is_wrong_with_a_script_is_in_the_record_with_its_line() {
    let mut world = World::with_nodes(2, &["left"]);
    for (id, text, words) in [
        (
            "syntax",
            "motor.execute()\nx = = 1",
            "lua: syntax:2: unexpected symbol near '='",
        ),
        ("runtime", "\n\nerror('broken')", "lua: runtime:3: broken"),
        (
            "argument",
            "motor.queue_move(9, 1, 1)",
            "motor.queue_move: axis: a whole number from 0 to",
        ),
    ] {
        let record = run(&mut world, &json!({"id": id, "lua": text}));
        assert_eq!(record.state, JobState::Failed);
        let error = record.error.expect("an error");
        assert_eq!(error.code, ErrorCode::BadCommand);
        assert!(error.message.contains(words), "{error}");
    }
    let text = "local function deeper()\n  error('broken')\nend\ndeeper()";
    let record = run(&mut world, &json!({"id": "deep", "lua": text}));
    let message = record.error.expect("an error").message;
    let (_, way) = message
        .split_once("stack traceback:")
        .expect("how it came there");
    for place in ["deep:2: in", "deep:4: in main chunk"] {
        assert!(way.contains(place), "{place}: {message}");
    }
    let record = run(
        &mut world,
        &json!({"id": "long", "lua": format!("return 7 --{}", "x".repeat(60_000))}),
    );
    assert_eq!(returned(&record), json!(7));
    let record = run(&mut world, &json!({"id": "empty", "lua": ""}));
    assert_eq!(returned(&record), Value::Null);
}

#[test]
fn a_job_calls_a_stored_script_with_arguments() {
    let mut world = World::with_nodes(3, &["left"]);
    world.node_mut("left", |node| {
        let text = "local a = ... return a.list[2], a.text, a.none == nil, a.big";
        let library = node.node_mut().library_mut();
        library.put("show", text.as_bytes()).expect("stored");
    });
    let args =
        json!({"list": [1, 2.5], "text": "a\"b\\\n\u{e9}", "none": null, "big": 5_000_000_000_u64});
    let record = run(
        &mut world,
        &json!({"id": "call", "call": "show", "args": args}),
    );
    assert_eq!(
        returned(&record),
        json!([2.5, "a\"b\\\n\u{e9}", true, 5_000_000_000.0])
    );
    let record = run(&mut world, &json!({"id": "none", "call": "nothing"}));
    assert!(
        record
            .error
            .expect("an error")
            .message
            .contains("no script 'nothing' is stored")
    );
}

#[test]
fn stop_cancel_and_timeout_end_a_script() {
    let endless = "while true do motor.queue_move(0, 100, 1000) wait_idle() end";
    let mut world = World::with_nodes(4, &["left"]);
    let _ = world.submit("left", &json!({"id": "a", "lua": endless}));
    world.run_for(S);
    assert_eq!(world.record("a").state, JobState::Running);
    let _ = world.cancel("a");
    world.run_until(5 * S, |world| is_final(world, "a"));
    assert_eq!(world.record("a").state, JobState::Canceled);
    let record = run(
        &mut world,
        &json!({"id": "b", "lua": endless, "timeout_s": 1.5}),
    );
    assert_eq!(record.state, JobState::TimedOut);
    let _ = world.submit("left", &json!({"id": "c", "lua": endless}));
    world.run_for(S);
    world.stop("left", StopMode::Halt);
    world.run_until(5 * S, |world| is_final(world, "c"));
    let record = world.record("c");
    assert_eq!(record.state, JobState::Failed);
    assert_eq!(
        record.error.as_ref().map(|error| error.code),
        Some(ErrorCode::Stopped)
    );
    let position = world.node("left").status().axes[0].position_steps;
    let _ = world.release("left");
    world.run_for(5 * S);
    assert_eq!(world.node("left").status().axes[0].position_steps, position);
    assert_eq!(
        returned(&run(&mut world, &json!({"id": "d", "lua": "return 1"}))),
        json!(1)
    );
}

#[test]
fn parts_with_scripts_start_together_with_others() {
    let mut world = World::with_nodes(5, &["left", "right", "top"]);
    world.run_for(20 * S);
    let job = json!({"id": "cut", "max_skew_us": 5000, "nodes": {
        "left": {"commands": [{"move": {"axis": 0, "delay_us": 100, "steps": 2000}}]},
        "right": {"lua": "for i = 1, 20 do motor.queue_move(0, 100, 100) end motor.execute() wait_idle() return 'r'"},
        "top": {"lua": "motor.queue_move(0, 50, 4000)"}}});
    let _ = world.submit_group("g", &job);
    world.run_until(60 * S, |world| is_final(world, "cut"));
    let record = world.record("cut").clone();
    assert_eq!(record.state, JobState::Succeeded, "{record:?}");
    let parts = record.parts.expect("parts");
    let part = &parts[&keys::NodeId::new("right").expect("legal")];
    let result = part.result.as_ref().expect("a result");
    assert_eq!(result.returned, Some(json!("r")));
    assert_eq!((part.progress.done, part.progress.total), (20, 20));
    assert!(record.start.expect("measured").skew_us < 5000.0);
    let first: Vec<f64> = ["left", "right", "top"]
        .map(|name| world.edge_us(name, 0).expect("moved"))
        .to_vec();
    let spread = first
        .iter()
        .fold(0.0_f64, |most, edge| most.max((edge - first[0]).abs()));
    assert!(spread < 5000.0, "{first:?}");
}

#[test]
fn a_part_whose_script_does_not_compile_lets_nobody_move() {
    let mut world = World::with_nodes(6, &["left", "right"]);
    world.run_for(20 * S);
    let job = json!({"id": "cut", "nodes": {
        "left": {"commands": [{"move": {"axis": 0, "delay_us": 100, "steps": 2000}}]},
        "right": {"lua": "motor.queue_move("}}});
    let _ = world.submit_group("g", &job);
    world.run_until(60 * S, |world| is_final(world, "cut"));
    assert_eq!(world.record("cut").state, JobState::Failed);
    world.run_for(5 * S);
    assert_eq!(
        (world.edge_count("left"), world.edge_count("right")),
        (0, 0)
    );
}

/// One run with faults; returns how the jobs ended.
fn campaign(seed: u64) -> [usize; 2] {
    let mut world = World::with_nodes(seed, &["left"]);
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
    let mut names = Vec::new();
    for number in 0..6 {
        let name = format!("job-{number}");
        let steps = random.between(1, 50);
        let text = match random.below(5) {
            0 => format!(
                "for i = 1, {steps} do motor.queue_move(0, 200, i) end return {number} --{}",
                "x".repeat(5000)
            ),
            1 => format!("motor.queue_move(1, 300, {steps}) wait_idle() sleep(20) return {number}"),
            2 => format!("motor.queue_move(0, 500, {steps}) motor.execute() error('no')"),
            3 => "while true do end".to_owned(),
            _ => format!(
                "for i = 1, 300 do motor.queue_move(0, 100, {steps}) motor.execute() end return {number}"
            ),
        };
        let _ = world.submit("left", &json!({"id": name, "lua": text, "timeout_s": 4.0}));
        names.push((name, number));
    }
    for _ in 0..3 {
        world.run_for(random.below(2 * S));
        match random.below(4) {
            0 => world.break_link("left", random.below(1500 * MS)),
            1 => world.kill_gateway(random.below(2 * S)),
            2 => world.reboot("left", random.below(2 * S)),
            _ => {
                let name = &names[random.below(names.len() as u64) as usize].0;
                let _ = world.cancel(name);
            }
        }
    }
    for (name, _) in &names {
        world.run_until(200 * S, |world| {
            is_final(world, name)
                || !world.node_records.is_empty()
                    && world
                        .node_records
                        .values()
                        .all(|node| node.stopped.is_some())
        });
    }
    let _ = world.release("left");
    for (name, _) in &names {
        world.run_until(200 * S, |world| is_final(world, name));
    }
    let mut ended = [0, 0];
    for (name, number) in &names {
        let record = world.record(name);
        assert!(record.state.is_final(), "seed {seed}: {record:?}");
        if record.state == JobState::Succeeded {
            assert_eq!(returned(record), json!(number), "seed {seed}: {record:?}");
            assert_eq!(record.progress.done, record.progress.total, "seed {seed}");
            ended[0] += 1;
        } else {
            ended[1] += 1;
        }
    }
    let node = world.node("left");
    for life in node.past_lives().iter().chain([&node.life()]) {
        if let Err(violations) = oracle::check_life(life) {
            panic!("seed {seed}: {}", violations[0]);
        }
    }
    ended
}

#[test]
fn scripts_survive_what_commands_survive() {
    let seeds: Vec<u64> = match std::env::var("SEED") {
        Ok(seed) => vec![seed.parse().expect("a number")],
        Err(_) => (1..=60).collect(),
    };
    let mut all = [0, 0];
    for seed in seeds {
        let ended = campaign(seed);
        all = [all[0] + ended[0], all[1] + ended[1]];
    }
    println!("{} scripts succeeded, {} did not", all[0], all[1]);
    assert!(all[0] > 0 && all[1] > 0);
}
