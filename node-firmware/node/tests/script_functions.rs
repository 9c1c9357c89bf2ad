//! Every function that a script can call, on an emulated node with a whole machine around it: what it
//! returns, what leaves the pins, and nothing that the oracle objects to.

mod rig;
mod scripts;

use emulator::{Recording, oracle, wiring::Wiring};
use keys::{AxisId, NodeTopic, ScriptOutcome};
use rig::{Rig, config};
use script::NAMES;
use scripts::{last, send};

struct Case {
    /// What it is about.
    function: &'static str,
    text: &'static str,
    /// What the script returns, JSON.
    returned: &'static str,
    /// Steps that axes 0 and 1 have taken in the end, as counted at their pins; `None`: more than this
    /// table wants to know.
    counted: Option<[i64; 2]>,
}

const fn case(
    function: &'static str,
    text: &'static str,
    returned: &'static str,
    counted: [i64; 2],
) -> Case {
    Case {
        function,
        text,
        returned,
        counted: Some(counted),
    }
}

const CASES: [Case; 41] = [
    case(
        "motor.queue_move",
        "motor.queue_move(0, 100, 300) motor.queue_move(1, 200, -20) wait_idle() return motor.get_position(0)",
        "300",
        [300, -20],
    ),
    case(
        "motor.queue_sync_move",
        "motor.queue_sync_move(100, 40, 200, -10) wait_idle() return motor.get_position(1)",
        "-10",
        [40, -10],
    ),
    case(
        "motor.queue_pause",
        "local t = node.now_us() motor.queue_pause(30) motor.queue_move(0, 100, 5) wait_idle() return node.now_us() - t >= 30000",
        "true",
        [5, 0],
    ),
    case(
        "motor.queue_ramp",
        "motor.queue_ramp(0, 500, 4000, 20000) motor.queue_ramp(0, -100, 4000, 20000, {jerk = 200000}) wait_idle() return motor.get_position(0)",
        "400",
        [400, 0],
    ),
    case(
        "motor.queue_ramp_to",
        "motor.queue_move(0, 100, 50) motor.queue_ramp_to(0, -30, 2000, 10000, {jump_steps = 3}) wait_idle() return motor.get_position(0)",
        "-30",
        [-30, 0],
    ),
    case(
        "motor.queue_smooth_ramp",
        "motor.queue_smooth_ramp(0, 500, 100, 4000, 90) motor.queue_smooth_ramp(0, -1, 100, 4000, 90) wait_idle() return motor.get_position(0)",
        "499",
        [499, 0],
    ),
    case(
        "motor.queue_smooth_ramp_to",
        "motor.queue_move(0, 100, 50) motor.queue_smooth_ramp_to(0, -30, 200, 2000, 100) wait_idle() return motor.get_position(0)",
        "-30",
        [-30, 0],
    ),
    case(
        "motor.queue_line",
        "motor.queue_line({90, -40}, 3000, 20000) motor.queue_line({10, 0}, 3000, 20000, 400000) wait_idle() return motor.get_position(1)",
        "-40",
        [100, -40],
    ),
    case(
        "motor.queue_set_position",
        "motor.queue_move(0, 100, 7) motor.queue_set_position(0, 1000) motor.queue_move(0, 100, 1) wait_idle() return motor.get_position(0)",
        "1001",
        [8, 0],
    ),
    Case {
        function: "motor.queue_home",
        text: "motor.queue_home(1) motor.queue_ramp_to(1, 25, 1000, 10000) wait_idle() return motor.get_position(1)",
        returned: "25",
        counted: None,
    },
    case(
        "motor.queue_move_c",
        "motor.queue_move_c(4) motor.queue_move_c(2) wait_idle() return input.read('c:max')",
        "false",
        [0, 0],
    ),
    case(
        "motor.queue_move_d",
        "motor.queue_move_d(true) wait_idle() local far = input.read('d:max') motor.queue_move_d(false) wait_idle() return far, input.read('d:min')",
        "[true,true]",
        [0, 0],
    ),
    case(
        "motor.queue_status_cd",
        "motor.queue_move_c(1) return motor.queue_status_cd()",
        "2",
        [0, 0],
    ),
    case(
        "motor.execute",
        "motor.queue_move(0, 100, 9) sleep(20) local before = motor.get_position(0) motor.execute() sleep(20) return before, motor.get_position(0)",
        "[0,9]",
        [9, 0],
    ),
    case(
        "motor.is_busy",
        "local a = motor.is_busy() motor.queue_move(0, 100, 90) motor.execute() sleep(2) local b = motor.is_busy() wait_idle() return a, b, motor.is_busy()",
        "[false,true,false]",
        [90, 0],
    ),
    case(
        "motor.is_done",
        "local first, last = motor.queue_move(0, 100, 9), motor.queue_move(0, 100, 900) motor.execute() sleep(10) local a, b = motor.is_done(first), motor.is_done(last) wait_idle() return a, b, motor.is_done(last)",
        "[true,false,true]",
        [909, 0],
    ),
    case(
        "motor.get_position",
        "motor.queue_move(0, 1000, 100) motor.execute() sleep(50) local p = motor.get_position(0) wait_idle() return p > 30 and p < 60, motor.get_position(0)",
        "[true,100]",
        [100, 0],
    ),
    case(
        "motor.get_speed",
        "motor.queue_move(0, 1000, -100) motor.execute() sleep(50) local v = motor.get_speed(0) wait_idle() return v, motor.get_speed(0)",
        "[-1000.0,0.0]",
        [-100, 0],
    ),
    case(
        "motor.get_queue_depth",
        "motor.queue_pause(1) motor.queue_pause(1) local a = motor.get_queue_depth() wait_idle() return a, motor.get_queue_depth()",
        "[2,0]",
        [0, 0],
    ),
    case(
        "motor.hold",
        "motor.queue_ramp(0, 2000, 4000, 40000) motor.execute() sleep(200) motor.hold() sleep(500) local a, v = motor.get_position(0), motor.get_speed(0) sleep(100) local same = a == motor.get_position(0) motor.resume() wait_idle() return a < 2000, v, same",
        "[true,0.0,true]",
        [2000, 0],
    ),
    case(
        "motor.resume",
        "motor.hold() motor.queue_ramp(0, 100, 4000, 40000) motor.execute() sleep(300) local a = motor.get_position(0) motor.resume() wait_idle() return a, motor.get_position(0)",
        "[0,100]",
        [100, 0],
    ),
    case(
        "motor.set_speed_percent",
        "motor.set_speed_percent(50) local t = node.now_ms() motor.queue_ramp(0, 2000, 4000, 400000) wait_idle() return node.now_ms() - t >= 900",
        "true",
        [2000, 0],
    ),
    case(
        "laser.set_power",
        "laser.set_power(30) motor.queue_move(0, 1000, 50) motor.execute() sleep(20) local on = node.status().laser_percent laser.set_power(0) wait_idle() return on, node.status().laser_percent",
        "[30,0]",
        [50, 0],
    ),
    case(
        "lidar.read",
        "local mm = lidar.read() return math.type(mm), mm == node.status().lidar_mm",
        r#"["integer",true]"#,
        [0, 0],
    ),
    case(
        "input.read",
        "return input.read('stop'), input.read('0:max'), input.read('1:home')",
        "[false,false,false]",
        [0, 0],
    ),
    case(
        "node.now_us",
        "local t = node.now_us() sleep(7) local d = node.now_us() - t return d >= 7000 and d < 9000",
        "true",
        [0, 0],
    ),
    case(
        "node.now_ms",
        "local t = node.now_ms() sleep(7) local d = node.now_ms() - t return d >= 7 and d < 9",
        "true",
        [0, 0],
    ),
    case(
        "node.status",
        "motor.queue_move(0, 100, 4) wait_idle() local s = node.status() return s.state, s.position[0], s.queue_depth, node.name",
        r#"["idle",4,0,"left"]"#,
        [4, 0],
    ),
    case(
        "node.publish",
        "node.publish('part', {done = 3}) return 0",
        "0",
        [0, 0],
    ),
    case("node.call", "return node.call('twice', 21)", "42", [0, 0]),
    case(
        "sleep",
        "local t = node.now_ms() sleep(250) return node.now_ms() - t >= 250",
        "true",
        [0, 0],
    ),
    case(
        "wait_idle",
        "motor.queue_move(0, 100, 50) wait_idle() return motor.get_position(0), motor.get_queue_depth()",
        "[50,0]",
        [50, 0],
    ),
    case(
        "motor.drive_to",
        "motor.drive_to(0, -300, 1500, 8000) motor.drive_to(1, 40, 500, 8000) while motor.is_driven(0) or motor.is_driven(1) do sleep(10) end return motor.get_position(0)",
        "-300",
        [-300, 40],
    ),
    case(
        "motor.drive_by",
        "motor.drive_by(0, 100, 1500, 8000) motor.drive_by(0, 50, 2000, 8000, {jerk = 80000}) while motor.is_driven(0) do sleep(10) end return motor.get_position(0)",
        "150",
        [150, 0],
    ),
    case(
        "motor.drive_by",
        "motor.drive_by(0, 90, 1500, 8000, {jump_steps = 5}) while motor.is_driven(0) do sleep(10) end motor.drive_by(0, -20, 1500, 8000, {linear_steps = 9, jump_steps = 4}) while motor.is_driven(0) do sleep(10) end return motor.get_position(0)",
        "70",
        [70, 0],
    ),
    case(
        "motor.drive_to",
        "motor.drive_to(0, 200, 1000, 8000, {unit = 'us', passing = 2000}) motor.drive_to(0, 400, 1000, 8000, {unit = 'us'}) while motor.is_driven(0) do sleep(10) end return motor.get_position(0)",
        "400",
        [400, 0],
    ),
    case(
        "motor.run",
        "motor.run(0, -1, 1000, 8000) sleep(500) local at = motor.get_position(0) motor.drive_to(0, 30, 2000, 8000) while motor.is_driven(0) do sleep(10) end return at < -300",
        "true",
        [30, 0],
    ),
    case(
        "motor.end_drive",
        "motor.run(0, 1, 1000, 8000) sleep(300) motor.end_drive(0) while motor.is_driven(0) do sleep(10) end local at = motor.get_position(0) sleep(500) local rests = at == motor.get_position(0) motor.drive_to(0, 7, 2000, 8000) while motor.is_driven(0) do sleep(10) end return rests",
        "true",
        [7, 0],
    ),
    case(
        "motor.is_driven",
        "motor.drive_by(1, 20, 500, 8000) local one, other = motor.is_driven(1), motor.is_driven(0) while motor.is_driven(1) do sleep(10) end return one, other, motor.is_driven(1)",
        "[true,false,false]",
        [0, 20],
    ),
    // The two below end otherwise, or need others: see the tests of their own.
    case("motor.emergency_stop", "return 0", "0", [0, 0]),
    case("motor.queue_barrier", "return 0", "0", [0, 0]),
];

fn machine() -> Rig {
    let mut config = config();
    config.record = Recording::Edges { max: 1_000_000 };
    let wiring = |words: &str| words.parse::<Wiring>().expect("legal");
    wiring("0:max@5000").wire(&mut config).expect("room");
    wiring("1:home@-60").wire_home(&mut config).expect("room");
    config.add_cd(24).expect("room");
    let mut rig = Rig::new(config);
    let text: &[u8] = b"return 2 * (...)";
    let now = rig.now;
    rig.node.node_mut().store_script(now, "twice", Some(text));
    rig
}

#[test]
fn every_function_does_what_it_says_at_the_pins() {
    let mut named: Vec<&str> = CASES.iter().map(|case| case.function).collect();
    named.sort_unstable();
    named.dedup();
    let full = |(module, name): &(&str, &str)| match *module {
        "" => (*name).to_owned(),
        module => format!("{module}.{name}"),
    };
    let mut existing: Vec<String> = NAMES.iter().map(full).collect();
    existing.sort_unstable();
    assert_eq!(named, existing, "a function without a case");
    let mut wrong = Vec::new();
    for case in CASES {
        let function = case.function;
        let mut rig = machine();
        send(&mut rig, case.text);
        rig.run_for(60_000_000);
        let (outcome, told) = last(&rig);
        if (outcome, told.as_str()) != (ScriptOutcome::Returned, case.returned) {
            wrong.push(format!("{function}: {told} instead of {}", case.returned));
        }
        let at_pins = [0, 1].map(|axis| rig.node.step_count(AxisId(axis)));
        if case.counted.is_some_and(|counted| counted != at_pins) {
            wrong.push(format!(
                "{function}: {at_pins:?} instead of {:?}",
                case.counted
            ));
        }
        if let Err(violations) = oracle::check_life(&rig.node.life()) {
            wrong.push(format!("{function}: {violations:?}"));
        }
    }
    assert!(wrong.is_empty(), "{wrong:#?}");
}

#[test]
fn an_emergency_stop_of_a_script_ends_the_pulses() {
    let mut rig = machine();
    let text = "motor.queue_move(0, 100, 2000) motor.execute() sleep(50) motor.emergency_stop() print('never')";
    send(&mut rig, text);
    rig.run_for(5_000_000);
    let counted = rig.node.step_count(AxisId(0));
    assert!((400..=600).contains(&counted), "{counted}");
    assert_eq!(rig.node.position_steps(AxisId(0)), counted);
    assert!(!rig.lines().iter().any(|line| line == "never"));
    oracle::check_life(&rig.node.life()).expect("good pulses");
}

#[test]
fn what_a_script_prints_is_limited_to_a_rate_and_says_what_is_missing() {
    let mut rig = machine();
    send(
        &mut rig,
        "for i = 1, 1000 do print('line', i) sleep(1) end return 'done'",
    );
    rig.run_for(20_000_000);
    assert_eq!(last(&rig), (ScriptOutcome::Returned, "\"done\"".into()));
    let lines: Vec<_> = rig
        .sent
        .iter()
        .filter(|(_, topic, _)| *topic == NodeTopic::Log)
        .map(|(at, _, line)| (at.0, String::from_utf8_lossy(line).into_owned()))
        .collect();
    let printed = lines.iter().filter(|(_, line)| line.contains("line"));
    let printed = printed.count();
    assert!((8..60).contains(&printed), "{printed} of 1000");
    // Five a second, after a burst.
    for window in lines.windows(12) {
        assert!(window[11].0 - window[0].0 >= 400_000, "{window:?}");
    }
    assert!(
        lines.iter().any(|(_, line)| line.contains("were dropped")),
        "{lines:?}"
    );
}
