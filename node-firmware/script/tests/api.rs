//! Every function that a script can call, on a bench.

mod rig;

use keys::{
    AxisId, Command,
    command::{Ramp, RampShape},
};
use motion::{Course, Direction, Target};
use rig::{Bench, failed, returned};
use script::{End, LidarReading, NAMES, Step, Wait};

const AXIS: AxisId = AxisId(0);

fn commands(text: &str) -> Vec<Command> {
    let mut bench = Bench::default();
    bench.returned(text);
    bench.commands
}

#[test]
fn every_command_is_queued_as_it_is_meant() {
    let trapezoid = |linear_steps, jump_steps| RampShape::Trapezoid {
        linear_steps,
        jump_steps,
    };
    let ramp = |shape| Ramp {
        speed_hz: 500,
        accel_hz_per_s: 100,
        shape,
    };
    let smooth = || Ramp {
        speed_hz: 1_500,
        accel_hz_per_s: 0,
        shape: RampShape::Smooth {
            start_hz: 500,
            ramp_steps: 400,
        },
    };
    for (text, command) in [
        (
            "motor.queue_move(0, 500, -2000)",
            Command::Move {
                axis: AXIS,
                delay_us: 500,
                steps: -2000,
            },
        ),
        (
            "motor.queue_sync_move(500, 2000, 1000, -1000)",
            Command::SyncMove {
                delay_us: [500, 1000],
                steps: [2000, -1000],
            },
        ),
        ("motor.queue_pause(100)", Command::Pause { pause_ms: 100 }),
        (
            "motor.queue_ramp(1, 1000 / 2, 500, 100)",
            Command::Ramp {
                axis: AxisId(1),
                steps: 500,
                ramp: ramp(trapezoid(0, 0)),
            },
        ),
        (
            "motor.queue_ramp_to(0, -7, 500, 100, {linear_steps = 50, jump_steps = 3})",
            Command::RampTo {
                axis: AXIS,
                position_steps: -7,
                ramp: ramp(trapezoid(50, 3)),
            },
        ),
        (
            "motor.queue_ramp(0, 9, 500, 100, {jerk = 1000})",
            Command::Ramp {
                axis: AXIS,
                steps: 9,
                ramp: ramp(RampShape::Jerk {
                    jerk_hz_per_s2: 1000,
                }),
            },
        ),
        (
            "motor.queue_smooth_ramp(1, -6000, 500, 1500, 400)",
            Command::Ramp {
                axis: AxisId(1),
                steps: -6000,
                ramp: smooth(),
            },
        ),
        (
            "motor.queue_smooth_ramp_to(0, 7, 500, 1500, 400)",
            Command::RampTo {
                axis: AXIS,
                position_steps: 7,
                ramp: smooth(),
            },
        ),
        (
            "motor.queue_line({10, -4}, 5000, 10000, 7)",
            Command::Line {
                steps: [10, -4, 0, 0],
                speed_hz: 5000,
                accel_hz_per_s: 10000,
                jerk_hz_per_s2: 7,
            },
        ),
        (
            "motor.queue_line({10, -4, 3}, 5000, 10000)",
            Command::Line {
                steps: [10, -4, 3, 0],
                speed_hz: 5000,
                accel_hz_per_s: 10000,
                jerk_hz_per_s2: 0,
            },
        ),
        (
            "motor.queue_set_position(2, 99)",
            Command::SetPosition {
                axis: AxisId(2),
                position_steps: 99,
            },
        ),
        ("motor.queue_move_c(4)", Command::MoveC { index: 4 }),
        ("motor.queue_move_d(true)", Command::MoveD { on: true }),
        ("motor.queue_status_cd()", Command::StatusCd),
        ("laser.set_power(50)", Command::Laser { power_percent: 50 }),
    ] {
        let mut bench = Bench::default();
        assert_eq!(bench.returned(&format!("return {text}, {text}")), "[1,2]");
        assert_eq!(bench.commands, [command, command], "{text}");
    }
}

#[test]
fn a_barrier_has_a_name_of_its_own_and_waits_for_room_like_any_command() {
    let mut bench = Bench {
        capacity: 1,
        ..Bench::default()
    };
    let text =
        "motor.queue_barrier('a') motor.queue_pause(1) return motor.queue_barrier('layer 2')";
    assert_eq!(bench.returned(text), "3");
    let barrier = |barrier| Command::Barrier { barrier };
    let pause = Command::Pause { pause_ms: 1 };
    assert_eq!(bench.commands, [barrier(0), pause, barrier(1)]);
    for (text, words) in [
        (
            "motor.queue_barrier('a') motor.queue_barrier('a')",
            "the script has been at 'a' already",
        ),
        (
            "for i = 1, 4 do motor.queue_barrier('b' .. i) end",
            "too many barriers",
        ),
        (
            "motor.queue_barrier('')",
            "name: a text of 1 to 64 bytes, got 0 bytes",
        ),
        (
            "motor.queue_barrier(('x'):rep(65))",
            "name: a text of 1 to 64 bytes, got 65 bytes",
        ),
        ("motor.queue_barrier(7)", "name: a text, got"),
        ("motor.queue_barrier()", "name: a text, got"),
    ] {
        assert!(failed(text).contains(words), "{text}: {}", failed(text));
    }
}

#[test]
fn nothing_moves_before_execute_and_what_is_left_moves_at_the_end() {
    let mut bench = Bench::default();
    let text = "motor.queue_pause(1) motor.queue_pause(2) sleep(5)
        assert(motor.get_queue_depth() == 2 and not motor.is_busy())
        motor.execute() assert(motor.is_busy()) sleep(5)
        motor.queue_pause(3)";
    let mut script = bench.start(text).expect("compiles");
    assert!(matches!(
        script.step(&mut bench),
        Step::Waits(Wait::Until(_))
    ));
    assert_eq!((bench.commands.len(), script.staged_count()), (0, 2));
    bench.now = bench.now.plus_us(5_000);
    assert!(matches!(
        script.step(&mut bench),
        Step::Waits(Wait::Until(_))
    ));
    assert_eq!(bench.commands.len(), 2);
    bench.now = bench.now.plus_us(5_000);
    assert_eq!(
        script.step(&mut bench),
        Step::Ended(End::Returned { json: None })
    );
    assert_eq!(bench.commands.len(), 3);
}

#[test]
fn a_script_that_fails_forgets_what_it_did_not_execute() {
    let mut bench = Bench::default();
    bench.failed("motor.queue_pause(1) motor.execute() motor.queue_pause(2) error('x')");
    assert_eq!(bench.commands, [Command::Pause { pause_ms: 1 }]);
}

#[test]
fn a_full_queue_lets_the_script_wait_and_nothing_is_dropped() {
    let mut bench = Bench::default();
    let text = "local last for i = 1, 1000 do last = motor.queue_pause(i) end return last";
    assert_eq!(bench.returned(text), "1000");
    let expected: Vec<_> = (1..=1000)
        .map(|pause_ms| Command::Pause { pause_ms })
        .collect();
    assert_eq!(bench.commands, expected);
    // From within coroutines of its own, too.
    let text = "local co = coroutine.wrap(function()
            for i = 1, 500 do motor.queue_pause(i) if i % 7 == 0 then coroutine.yield(i) end end
        end)
        local n = 0 while true do local i = co() if not i then break end n = n + 1 end return n";
    assert_eq!(Bench::default().returned(text), "71");
    // Where it cannot wait, that is an error and nothing else.
    let text = "for i = 1, 64 do motor.queue_pause(i) end motor.execute()
        table.sort({2, 1}, function() motor.queue_pause(1) end)";
    assert!(failed(text).contains("motor.queue_pause: cannot wait here"));
}

#[test]
fn what_a_script_sees_of_the_node_is_there() {
    for (text, json) in [
        ("motor.get_position(0), motor.get_position(1)", "[10,-20]"),
        ("motor.get_position(2)", "1099511600000.0"),
        ("motor.get_speed(0)", "1.5"),
        ("motor.is_busy(), motor.get_queue_depth()", "[false,0]"),
        ("node.name", "\"left\""),
        ("input.read('stop')", "false"),
        ("node.now_us(), node.now_ms()", "[0,0]"),
        (
            "node.status()",
            r#"{"busy":false,"laser_percent":7,"now_ms":0,"position":"#,
        ),
        ("node.status().position[1]", "-20"),
    ] {
        let text = if text == "node.status()" {
            "local s = node.status() s.position = #s.position + 1 return s".to_owned()
        } else {
            format!("return {text}")
        };
        let got = returned(&text);
        assert!(got.starts_with(json), "{text}: {got}");
    }
    let text = "local id = motor.queue_pause(1) motor.execute()
        local before = motor.is_done(id) wait_idle() return before, motor.is_done(id)";
    assert_eq!(returned(text), "[false,true]");
}

#[test]
fn the_lidar_is_read_behind_what_is_queued() {
    let mut bench = Bench::default();
    assert_eq!(
        bench.returned("motor.queue_pause(1) return lidar.read()"),
        "1234"
    );
    assert_eq!(
        bench.commands,
        [Command::Pause { pause_ms: 1 }, Command::LidarRead]
    );
    // A sensor that says nothing.
    let mut bench = Bench::default();
    let mut script = bench.start("return lidar.read(20)").expect("compiles");
    assert!(matches!(
        script.step(&mut bench),
        Step::Waits(Wait::Lidar { .. })
    ));
    bench.executed = bench.accepted;
    bench.lidar = LidarReading::default();
    bench.now = bench.now.plus_us(1_000);
    assert!(matches!(
        script.step(&mut bench),
        Step::Waits(Wait::Lidar { until: Some(_), .. })
    ));
    bench.now = script.poll_timeout();
    let nil = End::Returned {
        json: Some("null".into()),
    };
    assert_eq!(script.step(&mut bench), Step::Ended(nil));
}

#[test]
fn flight_changes_and_the_emergency_stop_reach_the_node() {
    let mut bench = Bench::default();
    bench.returned("motor.hold()");
    assert!(bench.held);
    bench.returned("motor.resume() motor.set_speed_percent(50)");
    assert!(!bench.held);
    assert_eq!(bench.percent, 50);
    let text =
        "motor.queue_pause(1) pcall(motor.emergency_stop) motor.queue_pause(2) motor.execute()";
    assert_eq!(bench.run(text), End::Stopped);
    assert!(bench.stopped && bench.commands.is_empty());
}

#[test]
fn values_are_told_as_json() {
    let mut bench = Bench::default();
    bench.returned(
        "node.publish('a-1', {x = 1, list = {1, 2.5, 'q\"'}, ok = true}) node.publish('b')",
    );
    let published = [
        (
            "a-1".to_owned(),
            r#"{"list":[1,2.5,"q\""],"ok":true,"x":1}"#.to_owned(),
        ),
        ("b".to_owned(), "null".to_owned()),
    ];
    assert_eq!(bench.published, published);
    // More than may wait: the script waits instead.
    bench.returned("for i = 1, 20 do node.publish('c', i) end");
    for (value, json) in [
        (
            "{x = 1, list = {1, 2.5, 'q\"\\n'}, ok = true}",
            r#"{"list":[1,2.5,"q\"\n"],"ok":true,"x":1}"#,
        ),
        ("{}", "{}"),
        ("0/0", "null"),
        ("1e30", "1e30"),
        ("'é'", "\"é\""),
        ("nil", "null"),
    ] {
        assert_eq!(returned(&format!("return {value}")), json);
    }
    for (text, why) in [
        ("local t = {} t[1] = t return t", "nested deeper"),
        ("return print", "no JSON"),
        ("return {1, 2, x = 3}", "either items"),
        ("return {[true] = 1}", "either items"),
        ("return ('x'):rep(2000)", "more than 1024 bytes"),
        (
            "local t = {} for i = 1, 500 do t[i] = i end return t",
            "more than 1024",
        ),
        (
            "local t = {} for i = 1, 500 do t['k' .. i] = i end return t",
            "more than 1024",
        ),
    ] {
        assert!(failed(text).contains(why), "{text}: {}", failed(text));
    }
}

#[test]
fn print_makes_one_line_of_its_values() {
    let mut bench = Bench::default();
    bench.returned("print('a', 1, 2.0, nil, true) print()");
    assert_eq!(bench.lines, ["a\t1\t2.0\tnil\ttrue", ""]);
}

#[test]
fn stored_scripts_are_called_by_name_with_arguments() {
    let mut bench = Bench::default();
    bench.stored.extend([
        (
            "double".into(),
            "local args = ... return args.x * 2, args".into(),
        ),
        ("bad".into(), "return 1 +".into()),
        ("fails".into(), "\n\nerror('no')".into()),
        (
            "waits".into(),
            "sleep(3) motor.queue_pause(1) wait_idle() return 'done'".into(),
        ),
    ]);
    assert_eq!(
        bench.returned("return (node.call('double', {x = 21}))"),
        "42"
    );
    assert_eq!(bench.returned("return node.call('waits')"), "\"done\"");
    assert!(
        bench
            .failed("node.call('bad')")
            .contains("bad:1: unexpected symbol near <eof>")
    );
    let message = bench.failed("node.call('fails')");
    assert!(message.starts_with("fails:3: no"), "{message}");
    assert!(message.contains("test:1: in main chunk"), "{message}");
    assert!(
        bench
            .failed("node.call('none')")
            .contains("no script 'none' is stored")
    );
}

#[test]
fn wrong_arguments_name_the_function_and_the_argument() {
    for (text, words) in [
        (
            "motor.queue_move(4, 500, 1)",
            "test:1: motor.queue_move: axis: a whole number from 0 to 3, got 4",
        ),
        (
            "motor.queue_move(0, 0, 1)",
            "motor.queue_move: delay_us: a whole number from 1 to 2147483647, got 0",
        ),
        (
            "motor.queue_move(0, 1, 0)",
            "motor.queue_move: steps: 0 steps move nothing",
        ),
        (
            "motor.queue_move(0, 1)",
            "motor.queue_move: steps: a whole number from -2147483647 to 2147483647, got nothing",
        ),
        (
            "motor.queue_move(0, 1.5, 1)",
            "delay_us: a whole number from 1 to 2147483647, got 1.5",
        ),
        (
            "motor.queue_move('0', 1, 1)",
            "axis: a whole number from 0 to 3, got the text '0'",
        ),
        (
            "motor.queue_move(0, 1, 1, 1)",
            "motor.queue_move takes 3 arguments, got 4",
        ),
        (
            "motor.queue_move({}, 1, 1)",
            "axis: a whole number from 0 to 3, got a table",
        ),
        (
            "motor.queue_line(5, 1, 1)",
            "motor.queue_line: steps: a whole number",
        ),
        (
            "motor.queue_line({1, 2, 3, 4, 5}, 1, 1)",
            "motor.queue_line: steps: a list of 1 to 4 numbers, got 5",
        ),
        (
            "motor.queue_line({1, 'a'}, 1, 1)",
            "motor.queue_line: steps: a whole number",
        ),
        (
            "motor.queue_ramp(0, 1, 1, 1, {jrk = 1})",
            "options: unknown option 'jrk'",
        ),
        (
            "motor.queue_ramp(0, 1, 1, 1, 5)",
            "motor.queue_ramp: options: a table, got number",
        ),
        (
            "motor.queue_ramp(0, 1, 1, 1, {jerk = 1, jump_steps = 1})",
            "options.jerk: not together",
        ),
        (
            "motor.queue_home(0)",
            "motor.queue_home: not supported by this node's firmware",
        ),
        (
            "laser.set_power(101)",
            "laser.set_power: power: a whole number from 0 to 100, got 101",
        ),
        (
            "motor.queue_move_d(1)",
            "motor.queue_move_d: on: true or false, got 1",
        ),
        ("motor.is_done(1)", "motor.is_done: id: a whole number"),
        (
            "motor.set_speed_percent(300)",
            "motor.set_speed_percent: percent: a value is out of range",
        ),
        (
            "input.read('x')",
            "input.read: name: the node has no input 'x'",
        ),
        (
            "node.publish('A', 1)",
            "node.publish: suffix: a name consists of",
        ),
        ("node.publish('a', print)", "node.publish: value: functions"),
        (
            "sleep(-1)",
            "test:1: sleep: ms: a whole number from 0 to 86400000, got -1",
        ),
        (
            "motor.queue_pause(0/0)",
            "motor.queue_pause: ms: a whole number from 0 to 86400000, got NaN",
        ),
    ] {
        let message = failed(text);
        assert!(message.contains(words), "{text}: {message}");
    }
}

#[test]
fn a_drive_takes_its_speed_in_every_unit_and_may_pass_its_target() {
    let driven = |text: &str| {
        let mut bench = Bench::default();
        bench.returned(text);
        bench.driven
    };
    for (text, target, course) in [
        (
            "motor.drive_to(0, 5, 1500, 8000)",
            Target::To(5),
            Course::hz(1_500, 8_000),
        ),
        (
            "motor.drive_by(0, -7, 1500, 8000, {unit = 'hz'})",
            Target::By(-7),
            Course::hz(1_500, 8_000),
        ),
        (
            "motor.drive_by(0, 5, 2500, 8, {unit = 'mhz'})",
            Target::By(5),
            Course::mhz(2_500, 8),
        ),
        (
            "motor.run(0, -1, 125, 8000, {unit = 'us', jerk = 90})",
            Target::Forever(Direction::Negative),
            Course::interval_us(125, 8_000).shaped(RampShape::Jerk { jerk_hz_per_s2: 90 }),
        ),
        (
            "motor.drive_to(0, 5, 1333, 8000, {unit = 'ticks', passing = 4000})",
            Target::To(5),
            Course::interval_ticks(1_333, 8_000).passing_mhz(4_000_000),
        ),
    ] {
        assert_eq!(driven(text), [(AXIS, target, course)], "{text}");
    }
    // The queue has whole Hz.
    for (unit, value) in [
        ("mhz", 2_000_000),
        ("us", 500),
        ("ticks", 8_000),
        ("hz", 2_000),
    ] {
        let queued = commands(&format!(
            "motor.queue_ramp(0, 9, {value}, 50, {{unit = '{unit}'}})"
        ));
        let Some(Command::Ramp { ramp, .. }) = queued.first() else {
            panic!("{unit}: {queued:?}");
        };
        assert_eq!(ramp.speed_hz, 2_000, "{unit}");
    }
    for (text, words) in [
        (
            "motor.queue_ramp(0, 9, 2500, 50, {unit = 'mhz'})",
            "speed_hz: a queued ramp has whole Hz, 2500 mhz is none",
        ),
        (
            "motor.queue_ramp_to(0, 9, 300, 50, {unit = 'us'})",
            "whole Hz, 300 us is none",
        ),
        (
            "motor.drive_by(0, 9, 300, 50, {unit = 'rpm'})",
            "options.unit: \"hz\", \"mhz\", \"us\" or \"ticks\"",
        ),
        (
            "motor.drive_by(0, 9, 0, 50, {unit = 'us'})",
            "speed: a whole number from 1",
        ),
        (
            "motor.queue_ramp(0, 9, 300, 50, {passing = 5})",
            "options.passing: a drive can pass its target",
        ),
        (
            "motor.drive_by(0, 9, 300, 50, {passing = 'x'})",
            "options.passing: a whole number",
        ),
    ] {
        let message = failed(text);
        assert!(message.contains(words), "{text}: {message}");
    }
}

#[test]
fn errors_have_chunk_line_and_traceback() {
    let message = failed("local function f()\n  error('broken')\nend\nf()");
    assert_eq!(
        message,
        "test:2: broken\nstack traceback:\n\t[C]: in function 'error'\n\ttest:2: in local 'f'\n\ttest:4: in main chunk"
    );
    assert!(failed("x = = 1").starts_with("test:1: unexpected symbol near '='"));
    assert!(failed("error({})").starts_with("(error object is a table value)"));
    assert!(failed("error()").starts_with("(error object is a nil value)"));
}

#[test]
fn the_reference_for_editors_lists_exactly_the_functions_that_exist() {
    let reference = include_str!("../stepfleet.lua");
    let mut documented: Vec<&str> = reference
        .lines()
        .filter_map(|line| line.strip_prefix("function ")?.split('(').next())
        .collect();
    let mut existing: Vec<String> = NAMES
        .iter()
        .map(|(module, name)| match *module {
            "" => (*name).to_owned(),
            module => format!("{module}.{name}"),
        })
        .collect();
    documented.sort_unstable();
    existing.sort_unstable();
    assert_eq!(documented, existing);
    // It is Lua itself, and changes nothing but tables of its own.
    assert_eq!(returned(reference), "");
    for name in &existing {
        assert_eq!(
            returned(&format!("return type({name})")),
            "\"function\"",
            "{name}"
        );
    }
    assert!(commands("return nil").is_empty());
}
