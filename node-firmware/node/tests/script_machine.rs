//! Scripts on a machine with switches, C and D, a lidar and a probe: what they do is what its carriages
//! do, and what they read is what it is.

mod rig;
mod scripts;

use emulator::{EmulatorConfig, Recording, oracle, wiring::Wiring};
use keys::{AxisId, NodeState, ScriptOutcome};
use motion::io::input::{Filter, InputConfig, InputMap, Role};
use rig::{Rig, config};
use scripts::{reported, send};

fn recorded(mut config: EmulatorConfig) -> EmulatorConfig {
    config.record = Recording::Edges { max: 1_000_000 };
    config
}

/// What the options `--limit` and `--home` of the emulator do.
fn wired(limits: &[&str], homes: &[&str]) -> EmulatorConfig {
    let mut config = recorded(config());
    for words in limits {
        let wiring: Wiring = words.parse().expect("legal");
        wiring.wire(&mut config).expect("room");
    }
    for words in homes {
        let wiring: Wiring = words.parse().expect("legal");
        wiring.wire_home(&mut config).expect("room");
    }
    config
}

#[test]
fn a_script_homes_an_axis_and_knows_where_it_is() {
    let mut rig = Rig::new(wired(&[], &["0:min@-300"]));
    let text = "assert(not input.read('0:min'))
        motor.queue_home(0) motor.execute() local seen = false
        while motor.is_busy() do seen = seen or input.read('0:min') sleep(1) end
        motor.queue_move(0, 200, 100) wait_idle()
        return motor.get_position(0), seen, input.read('0:min'), input.read('stop')";
    send(&mut rig, text);
    rig.run_for(60_000_000);
    let told = reported(&rig, ScriptOutcome::Returned);
    let position = rig.node.position_steps(AxisId(0));
    assert_eq!(told, format!("[{position},true,false,false]"));
    // The switch is 0 now, and it is 300 steps from where the machine was switched on.
    let place = rig.node.place_steps(AxisId(0));
    assert!((place - position + 300).abs() <= 5, "{place} {position}");
    oracle::check_life(&rig.node.life()).expect("good pulses");
}

#[test]
fn a_limit_ends_a_script_and_is_read_by_the_next_one() {
    let mut rig = Rig::new(wired(&["0:max@500"], &[]));
    send(
        &mut rig,
        "motor.queue_move(0, 100, 2000) wait_idle() return 'never'",
    );
    rig.run_for(2_000_000);
    assert_eq!(rig.state(), NodeState::Stopped);
    let lines = rig.lines();
    assert!(
        lines
            .iter()
            .any(|line| line.starts_with("script ended: limit")),
        "{lines:?}"
    );
    let _ = rig.release(rig.queue());
    rig.run_for(100_000);
    let text = "local before = input.read('0:max') motor.queue_move(0, 200, -300) wait_idle()
        return before, input.read('0:max')";
    send(&mut rig, text);
    rig.run_for(2_000_000);
    assert_eq!(reported(&rig, ScriptOutcome::Returned), "[true,false]");
    oracle::check_life(&rig.node.life()).expect("good pulses");
}

#[test]
fn inputs_have_the_names_of_the_configuration_and_no_others() {
    let mut config = wired(&["1:max@900"], &[]);
    let probe = InputConfig {
        role: Role::Probe,
        active_low: false,
        filter: Filter::default(),
    };
    let limit = *config.motion.inputs.get(0).expect("the limit");
    config.motion.inputs = InputMap::new(&[limit, probe], 2).expect("room");
    let mut rig = Rig::new(config);
    let read = |rig: &mut Rig, name: &str| {
        send(rig, &format!("return input.read('{name}')"));
        rig.run_for(1_000_000);
        scripts::last(rig)
    };
    for name in ["stop", "probe", "1:max"] {
        assert_eq!(
            read(&mut rig, name),
            (ScriptOutcome::Returned, "false".into()),
            "{name}"
        );
    }
    let now = rig.now;
    rig.node.set_input(1, true, now);
    rig.run_for(1_000_000);
    assert_eq!(
        read(&mut rig, "probe"),
        (ScriptOutcome::Returned, "true".into())
    );
    for name in [
        "1:min", "0:max", "c:min", "9:max", "max", "0:up", "probe ", "", ":",
    ] {
        let (outcome, text) = read(&mut rig, name);
        assert_eq!(outcome, ScriptOutcome::Failed, "{name}: {text}");
        assert!(text.contains("name: "), "{name}: {text}");
    }
}

#[test]
fn a_script_moves_c_and_d_between_their_limits() {
    let mut config = recorded(config());
    config.add_cd(24).expect("room");
    let mut rig = Rig::new(config);
    let text = "for _, to in ipairs {4, 0, 2} do motor.queue_move_c(to) end
        motor.queue_move_d(true) motor.queue_move_d(false) motor.queue_move_d(true) motor.queue_status_cd() wait_idle()
        return input.read('c:min'), input.read('c:max'), input.read('d:min'), input.read('d:max')";
    send(&mut rig, text);
    rig.run_for(600_000_000);
    assert_eq!(
        reported(&rig, ScriptOutcome::Returned),
        "[false,false,false,true]"
    );
    let status = rig.node.node().motion().status_cd().expect("it has both");
    let lines = rig.lines();
    assert!(lines.contains(&status.to_string()), "{lines:?} {status}");
}

#[test]
fn what_a_machine_does_not_have_is_refused_at_the_call() {
    let mut rig = Rig::new(config());
    for (text, words) in [
        ("motor.queue_home(0)", "motor.queue_home: "),
        ("motor.queue_move_c(1)", "motor.queue_move_c: "),
        ("motor.queue_move_d(true)", "motor.queue_move_d: "),
        ("motor.queue_status_cd()", "motor.queue_status_cd: "),
        ("input.read('0:min')", "the node has no input '0:min'"),
    ] {
        send(&mut rig, &format!("motor.queue_move(0, 100, 5) {text}"));
        rig.run_for(100_000);
        let told = reported(&rig, ScriptOutcome::Failed);
        assert!(told.contains(words), "{told}");
        assert_eq!(rig.position(), 0);
    }
}

#[test]
fn the_lidar_is_read_when_what_came_before_has_ended() {
    let mut rig = Rig::new(recorded(config()));
    let text = "motor.queue_move(0, 100, 1000) local before = node.now_ms()
        local mm = lidar.read() return mm, motor.get_position(0), node.now_ms() - before >= 100";
    send(&mut rig, text);
    rig.run_for(2_000_000);
    let mm = rig.status().lidar_mm.expect("read");
    assert_eq!(
        reported(&rig, ScriptOutcome::Returned),
        format!("[{mm},1000,true]")
    );
}

#[test]
fn a_script_drives_axes_each_by_itself_and_changes_them_in_flight() {
    let mut rig = Rig::new(recorded(config()));
    let text = "motor.queue_move(0, 500, 100)
        motor.drive_to(0, -3000, 1500, 8000)
        assert(motor.get_position(0) == 100, 'what is queued before comes first')
        motor.run(1, 1, 800, 4000, {jerk = 40000})
        sleep(400) assert(motor.is_driven(0) and motor.is_driven(1))
        motor.drive_by(1, 0, 1600, 4000) sleep(600)
        assert(motor.get_speed(1) > 1590)
        motor.drive_to(0, 50, 2000, 9000)
        motor.end_drive(1)
        while motor.is_driven(1) do sleep(1) end
        motor.queue_move(1, 500, 7) wait_idle()
        assert(motor.get_position(0) == 50 and not motor.is_driven(0))
        motor.run(1, -1, 900, 4000) sleep(500)
        motor.drive_to(0, 10, 100, 1000)
        return 'done'";
    send(&mut rig, text);
    rig.run_for(20_000_000);
    assert_eq!(reported(&rig, ScriptOutcome::Returned), "\"done\"");
    assert_eq!(rig.state(), NodeState::Idle);
    // What has a target arrives when the script is over, what has none comes to rest.
    assert_eq!(rig.node.position_steps(AxisId(0)), 10);
    let life = rig.node.life();
    assert_eq!(life.drives.len(), 4);
    oracle::check_life(&life).expect("good pulses");
}

#[test]
fn a_script_that_fails_or_is_stopped_ends_its_drives() {
    for end in ["error('enough')", "motor.emergency_stop()"] {
        let mut rig = Rig::new(recorded(config()));
        let text = format!("motor.run(0, 1, 900, 4000) sleep(500) {end}");
        send(&mut rig, &text);
        rig.run_for(3_000_000);
        let at = rig.node.position_steps(AxisId(0));
        assert!((300..600).contains(&at), "{end}: {at}");
        rig.run_for(1_000_000);
        assert_eq!(rig.node.position_steps(AxisId(0)), at);
        oracle::check_life(&rig.node.life()).expect("good pulses");
    }
}
