//! Scripts of jobs: they arrive once, move what they say, and end with the truth.

mod rig;
mod scripts;

use emulator::{EmulatorConfig, Recording, oracle};
use keys::{
    AxisId, BatchHeader, Command, NodeState, NodeTopic, Order, Refusal, ScriptOutcome, StopMode,
    Verdict,
    start::{BarrierName, StartMessage},
    version,
};
use node::library::{Change, Library, SaveError, ScriptStore, StoreError, UNSAVED_MAX};
use rig::{Rig, batch_bytes, job, steps};
use scripts::{report, reported, script_orders, send};
use std::sync::{
    Arc,
    atomic::{AtomicBool, AtomicUsize, Ordering},
};

/// A node whose pulses can be judged.
fn config() -> EmulatorConfig {
    let mut config = rig::config();
    config.record = Recording::Edges { max: 1_000_000 };
    config
}

fn check_pulses(rig: &mut Rig) {
    oracle::check_life(&rig.node.life()).expect("good pulses");
}

#[test]
fn a_script_moves_the_axes_and_returns() {
    let mut rig = Rig::new(config());
    let text = "motor.queue_sync_move(100, 300, 200, -100) motor.queue_move(0, 50, -40)
        local id = motor.queue_pause(5)
        motor.execute() wait_idle()
        return {a = motor.get_position(0), b = motor.get_position(1), done = motor.is_done(id)}";
    send(&mut rig, text);
    assert_eq!(rig.status().job, Some(job("lua-1")));
    assert_eq!(rig.state(), NodeState::Running);
    rig.run_for(1_000_000);
    assert_eq!(
        reported(&rig, ScriptOutcome::Returned),
        r#"{"a":260,"b":-100,"done":true}"#
    );
    assert_eq!(rig.position(), 260);
    assert_eq!(rig.status().job, None);
    assert_eq!(rig.state(), NodeState::Idle);
    // One number for the script, three for its commands.
    assert_eq!(rig.status().executed_commands, 4);
    // The queue goes on behind it.
    assert_eq!(rig.batch(&[steps(40)]).verdict, Verdict::Accepted);
    rig.run_for(1_000_000);
    assert_eq!(rig.position(), 300);
    check_pulses(&mut rig);
}

#[test]
fn parts_that_come_twice_late_or_not_at_all_have_no_second_effect() {
    let mut rig = Rig::new(config());
    let text = "motor.queue_move(0, 100, 50) motor.execute() -- a comment to make it longer";
    let orders = script_orders(&rig, "lua-1", text, 20);
    assert!(orders.len() > 3);
    let gap = rig.order_bytes(&orders[1]).verdict;
    assert_eq!(gap, Verdict::Refused(Refusal::Gap));
    for order in &orders[..2] {
        let _ = rig.order_bytes(order);
    }
    assert_eq!(
        rig.order_bytes(&orders[3]).verdict,
        Verdict::Refused(Refusal::Gap)
    );
    // Begun again from the front.
    for order in &orders {
        assert_eq!(rig.order_bytes(order).verdict, Verdict::Accepted);
    }
    for order in &orders {
        assert_eq!(rig.order_bytes(order).verdict, Verdict::Duplicate);
    }
    rig.run_for(1_000_000);
    for order in &orders {
        assert_eq!(rig.order_bytes(order).verdict, Verdict::Duplicate);
    }
    rig.run_for(1_000_000);
    assert_eq!(rig.position(), 50);
}

#[test]
fn while_a_script_runs_the_queue_is_its_own() {
    let mut rig = Rig::new(config());
    send(&mut rig, "sleep(100)");
    let header = rig.next_header(1);
    let verdict = rig.order_bytes(&batch_bytes(header, &[steps(1)])).verdict;
    assert_eq!(verdict, Verdict::Refused(Refusal::ScriptRuns));
    rig.run_for(200_000);
    assert_eq!(rig.batch(&[steps(1)]).verdict, Verdict::Accepted);
}

#[test]
fn a_report_is_said_again_until_it_is_seen() {
    let mut rig = Rig::new(config());
    send(&mut rig, "return 1");
    rig.run_for(3_000_000);
    let count = |rig: &Rig| {
        let reports = rig.sent.iter().filter(|sent| sent.1 == NodeTopic::Report);
        reports.count()
    };
    let told = count(&rig);
    assert!((5..=8).contains(&told), "{told}");
    rig.link(false);
    rig.run_for(3_000_000);
    assert_eq!(count(&rig), told);
    rig.link(true);
    rig.run_for(10_000);
    assert_eq!(count(&rig), told + 1);
    let (report, _) = report(&rig).expect("said");
    let _ = rig.order(&Order::ScriptSeen {
        queue: report.queue,
        first_command: report.first_command,
    });
    rig.run_for(3_000_000);
    assert_eq!(count(&rig), told + 1);
}

#[test]
fn a_report_is_said_by_a_stopped_node_too_and_does_not_keep_it_awake() {
    let mut rig = Rig::new(config());
    send(&mut rig, "error('x')");
    rig.run_for(100_000);
    rig.stop(StopMode::Halt);
    let count = |rig: &Rig| {
        let reports = rig.sent.iter().filter(|sent| sent.1 == NodeTopic::Report);
        reports.count()
    };
    let before = count(&rig);
    rig.run_for(3_000_000);
    assert_eq!(rig.state(), NodeState::Stopped);
    assert_eq!(count(&rig), before + 6);
}

#[test]
fn a_script_that_fails_stops_what_it_moved_and_says_where() {
    let mut rig = Rig::new(config());
    send(
        &mut rig,
        "motor.queue_move(0, 100, 100000)\nmotor.execute()\nsleep(50)\nlocal x = nil + 1",
    );
    rig.run_for(2_000_000);
    let text = reported(&rig, ScriptOutcome::Failed);
    assert!(
        text.starts_with("lua-1:4: attempt to perform arithmetic on a nil value"),
        "{text}"
    );
    assert!(text.contains("in main chunk"), "{text}");
    assert_eq!(rig.state(), NodeState::Idle);
    assert!((500..2_000).contains(&rig.position()), "{}", rig.position());
    assert_eq!(rig.queue().flush, 1);
    assert_eq!(rig.batch(&[steps(1)]).verdict, Verdict::Accepted);
    rig.run_for(100_000);
    check_pulses(&mut rig);
}

#[test]
fn a_script_that_does_not_compile_moves_nothing() {
    let mut rig = Rig::new(config());
    send(&mut rig, "motor.queue_move(0, 100, 1)\nmotor.execute(");
    rig.run_for(100_000);
    let text = reported(&rig, ScriptOutcome::Failed);
    assert_eq!(text, "lua-1:2: unexpected symbol near <eof>");
    assert_eq!(rig.position(), 0);
}

#[test]
fn a_stop_ends_the_script_and_nothing_is_resumed() {
    for (stop, expected) in [(true, NodeState::Stopped), (false, NodeState::Idle)] {
        let mut rig = Rig::new(config());
        send(
            &mut rig,
            "while true do motor.queue_move(0, 100, 1000)\nwait_idle() end",
        );
        rig.run_for(250_000);
        let queue = rig.queue();
        if stop {
            rig.stop(StopMode::Halt);
        } else {
            let _ = rig.cancel(queue, StopMode::Decelerate);
        }
        rig.run_for(1_000_000);
        assert_eq!(rig.state(), expected);
        let position = rig.position();
        let reason = if stop { "client" } else { "cancel" };
        let words = format!("script ended: {reason}; it was at lua-1:2: in main chunk");
        assert!(rig.lines().contains(&words), "{:?}", rig.lines());
        if stop {
            let _ = rig.release(rig.queue());
        }
        rig.link(false);
        rig.link(true);
        rig.run_for(3_000_000);
        assert_eq!(rig.position(), position);
        assert!(report(&rig).is_none());
    }
}

#[test]
fn an_endless_loop_leaves_status_motion_and_stop_alone() {
    let mut rig = Rig::new(config());
    send(
        &mut rig,
        "for i = 1, 100 do motor.queue_move(0, 100, 100) end motor.execute() while true do end",
    );
    let before = rig.statuses().len();
    // Twenty more for the first turn.
    rig.run_for(500_020);
    assert!(rig.statuses().len() >= before + 5);
    assert_eq!(rig.position(), 5_000);
    rig.stop(StopMode::Halt);
    rig.run_for(10_000);
    assert_eq!(rig.state(), NodeState::Stopped);
    check_pulses(&mut rig);
}

#[test]
fn the_emergency_stop_of_a_script_is_a_stop() {
    let mut rig = Rig::new(config());
    send(
        &mut rig,
        "motor.queue_move(0, 100, 10000) motor.execute() sleep(100) pcall(motor.emergency_stop)",
    );
    rig.run_for(1_000_000);
    assert_eq!(rig.state(), NodeState::Stopped);
    assert!((990..1010).contains(&rig.position()), "{}", rig.position());
    check_pulses(&mut rig);
}

#[test]
fn a_lost_link_ends_a_script_even_while_nothing_moves() {
    let mut rig = Rig::new(config());
    send(&mut rig, "sleep(60000) motor.queue_move(0, 100, 1000)");
    rig.link(false);
    rig.run_for(5_000_000);
    rig.link(true);
    rig.run_for(60_000_000);
    assert_eq!(rig.state(), NodeState::Stopped);
    assert_eq!(rig.position(), 0);
}

#[test]
fn thousands_of_commands_flow_through_a_small_queue() {
    let mut small = config();
    small.ring_commands = 32;
    let mut rig = Rig::new(small);
    send(
        &mut rig,
        "for i = 1, 5000 do motor.queue_move(i % 2, 20, 1 + i % 5) end",
    );
    rig.run_for(10_000_000);
    reported(&rig, ScriptOutcome::Returned);
    assert_eq!(rig.status().executed_commands, 5001);
    assert_eq!(rig.position(), 7_500);
    check_pulses(&mut rig);
}

#[test]
fn hold_resume_and_speed_act_on_lines_under_way() {
    let mut rig = Rig::new(config());
    send(
        &mut rig,
        "motor.queue_line({32000, 12800}, 4000, 2000) motor.execute() sleep(3000) motor.hold() sleep(3000) local held = motor.get_position(0)
         local state = node.status().state sleep(500)
         local still = motor.get_position(0) == held and state
         motor.set_speed_percent(50) motor.resume() wait_idle()
         return still, motor.get_position(0), motor.get_position(1)",
    );
    rig.run_for(60_000_000);
    assert_eq!(
        reported(&rig, ScriptOutcome::Returned),
        r#"["paused",32000,12800]"#
    );
    assert_eq!(rig.node.position_steps(AxisId(1)), 12_800);
}

#[test]
fn lidar_laser_log_and_values_get_where_they_belong() {
    let mut rig = Rig::new(config());
    send(
        &mut rig,
        "laser.set_power(40) print('hello', node.name) node.publish('height', {mm = 3})
         return lidar.read()",
    );
    rig.run_for(3_000_000);
    let text = reported(&rig, ScriptOutcome::Returned);
    assert_eq!(Some(text), rig.status().lidar_mm.map(|mm| mm.to_string()));
    assert_eq!(rig.status().laser_percent, 40);
    assert!(
        rig.lines().contains(&"hello left".to_owned()),
        "{:?}",
        rig.lines()
    );
    let data = rig.sent.iter().find(|sent| sent.1 == NodeTopic::Data);
    assert_eq!(
        data.map(|sent| sent.2.as_slice()),
        Some(&br#"{"mm":3}"#[..])
    );
}

#[test]
fn a_boot_script_runs_only_where_the_configuration_allows_it() {
    for allowed in [false, true] {
        let mut config = config();
        config.boot_script = allowed;
        let mut rig = Rig::new(config);
        let now = rig.now;
        let text: &[u8] = b"motor.queue_move(0, 100, 30)";
        rig.node.node_mut().store_script(now, "boot", Some(text));
        rig.run_for(1_000_000);
        assert_eq!(rig.position(), 0);
        rig.node.reset(99);
        rig.now = keys::LocalMicros(0);
        rig.link(true);
        rig.run_for(1_000_000);
        assert_eq!(rig.position(), if allowed { 30 } else { 0 });
        check_pulses(&mut rig);
        // Removed, it is gone for good.
        let now = rig.now;
        rig.node.node_mut().store_script(now, "boot", None);
        assert!(rig.node.node().library().iter().next().is_none());
    }
}

#[test]
fn a_script_names_the_barrier_that_it_waits_at_and_goes_on_when_told() {
    let mut rig = Rig::new(config());
    // A part of a synchronized job begins with the barrier of its start.
    let queue = rig.queue();
    let start = BatchHeader {
        queue,
        first_command: 0,
        command_count: 1,
        job: job("lua-1"),
        job_end: 2,
    };
    let barrier = Command::Barrier { barrier: 0 };
    let _ = rig.order_bytes(&batch_bytes(start, &[barrier]));
    // It never rests, but it has queued what it will.
    let text =
        "motor.queue_move(0, 100, 50) motor.queue_barrier('layer 2') motor.queue_move(0, 100, 7)
        motor.execute() while motor.is_busy() do end return motor.get_position(0)";
    send(&mut rig, text);
    let said = |rig: &Rig| {
        let mut messages = rig.sent.iter().filter(|sent| sent.1 == NodeTopic::Start);
        let (_, _, payload) = messages.next_back().expect("something was said");
        version::decode::<StartMessage>(payload).expect("a message")
    };
    let lift = |rig: &mut Rig, command: u64| {
        let now_us = rig.now.0;
        for message in [
            StartMessage::Commit {
                queue,
                command,
                start_at: keys::LocalMicros(now_us + 100_000),
                confirm_by: keys::LocalMicros(now_us + 50_000),
            },
            StartMessage::Confirm { queue, command },
        ] {
            let mut buffer = [0; 64];
            let bytes = version::encode(&message, &mut buffer)
                .expect("room")
                .to_vec();
            rig.put(NodeTopic::Start, &bytes);
        }
    };
    rig.run_for(300_000);
    assert_eq!(said(&rig), StartMessage::Ready { queue, command: 0 });
    lift(&mut rig, 0);
    rig.run_for(400_000);
    assert_eq!(rig.position(), 50);
    assert_eq!(rig.state(), NodeState::Ready);
    let name = BarrierName::new("layer 2").expect("legal");
    let waits = StartMessage::ReadyAt {
        queue,
        command: 3,
        name,
    };
    assert_eq!(said(&rig), waits);
    lift(&mut rig, 3);
    rig.run_for(400_000);
    assert_eq!(reported(&rig, ScriptOutcome::Returned), "57");
    check_pulses(&mut rig);
    // Alone there is nobody to meet.
    send(&mut rig, "motor.queue_barrier('x')");
    rig.run_for(10_000);
    let text = reported(&rig, ScriptOutcome::Failed);
    assert!(
        text.contains("only a part of a synchronized job can meet others"),
        "{text}"
    );
}

/// A store that counts, and fails when it is told to.
#[derive(Clone, Debug, Default)]
struct Shelf {
    saves: Arc<AtomicUsize>,
    fails: Arc<AtomicBool>,
}

impl ScriptStore for Shelf {
    fn load(&mut self, take: &mut dyn FnMut(&str, &[u8])) -> Result<(), SaveError> {
        take("good", b"return 'good'");
        take("Not a name", b"");
        take("not-utf8", &[0xff]);
        Ok(())
    }

    fn save(&mut self, _: &str, _: &[u8]) -> Result<(), SaveError> {
        self.saves.fetch_add(1, Ordering::Relaxed);
        if self.fails.load(Ordering::Relaxed) {
            return Err(SaveError::Full);
        }
        Ok(())
    }

    fn remove(&mut self, name: &str) -> Result<(), SaveError> {
        self.save(name, b"")
    }
}

#[test]
fn stored_scripts_are_saved_only_while_nothing_moves() {
    let shelf = Shelf::default();
    let saves = || shelf.saves.load(Ordering::Relaxed);
    let mut rig = Rig::with_store(config(), Box::new(shelf.clone()));
    rig.run_for(1);
    let library = rig.node.node().library();
    assert_eq!(
        library.iter().collect::<Vec<_>>(),
        [("good", "return 'good'")]
    );
    assert!(
        rig.lines()
            .contains(&"stored scripts: the store cannot be read or written".into())
    );
    let store = |rig: &mut Rig, name: &str, text: Option<&[u8]>| {
        let now = rig.now;
        rig.node.node_mut().store_script(now, name, text);
        rig.drain();
    };
    store(&mut rig, "a", Some(b"return 1"));
    assert_eq!(saves(), 1);
    assert_eq!(
        rig.lines().last().map(String::as_str),
        Some("script a stored")
    );
    // One that is not there costs no flash.
    store(&mut rig, "none", None);
    assert_eq!(saves(), 1);
    let _ = rig.batch(&[steps(1_000)]);
    for text in [b"return 2", b"return 3"] {
        store(&mut rig, "a", Some(text));
    }
    store(&mut rig, "good", None);
    rig.run_for(50_000);
    assert_eq!(
        (saves(), rig.node.node().library().get("a")),
        (1, Some("return 3"))
    );
    rig.run_for(100_000);
    assert_eq!(rig.position(), 1_000);
    // The second text of `a` never had to be written.
    assert_eq!(saves(), 3);
    shelf.fails.store(true, Ordering::Relaxed);
    store(&mut rig, "b", Some(b"return 4"));
    rig.run_for(5_000_000);
    let words = "script b stored until the next start only: there is no room for it";
    assert_eq!(rig.lines().last().map(String::as_str), Some(words));
    assert_eq!(saves(), 4);
}

#[test]
fn scripts_that_are_kept_by_the_other_core_are_given_to_it_while_nothing_moves() {
    let mut rig = Rig::new(config());
    let now = rig.now;
    let node = rig.node.node_mut();
    let store = node.library_mut().detach();
    assert!(store.is_some());
    let stock = [
        ("a".to_owned(), "return 1".to_owned()),
        ("No".into(), "".into()),
    ];
    node.stock_scripts(now, stock);
    assert_eq!(node.library().iter().count(), 1);
    assert_eq!(node.take_change(), None);
    let _ = rig.batch(&[steps(1_000)]);
    let now = rig.now;
    let node = rig.node.node_mut();
    node.store_script(now, "b", Some(b"return 2"));
    node.store_script(now, "a", None);
    assert_eq!(node.take_change(), None, "it moves");
    rig.run_for(200_000);
    let node = rig.node.node_mut();
    let change = |name: &str, text: Option<&str>| Change {
        name: name.into(),
        text: text.map(String::from),
    };
    // The other core follows, and saves.
    let mut mirror = Library::default();
    mirror.stock([("a".to_owned(), "return 1".to_owned())]);
    let mut shelf = Shelf::default();
    for expected in [change("b", Some("return 2")), change("a", None)] {
        let change = node.take_change().expect("a change");
        assert_eq!(change, expected);
        assert_eq!(mirror.follow(&change), Ok(()));
        let saved = mirror.save_next_to(&mut shelf).expect("it is new");
        node.note_saved(rig.now, &saved);
    }
    assert_eq!(node.take_change(), None);
    assert_eq!(shelf.saves.load(Ordering::Relaxed), 2);
    rig.run_for(5_000_000);
    let lines = rig.lines();
    assert_eq!(
        lines[lines.len() - 2..],
        ["script b stored", "script a removed"]
    );
}

#[test]
fn changes_of_stored_scripts_during_a_motion_are_bounded() {
    let mut rig = Rig::new(config());
    let _ = rig.batch(&[steps(10_000)]);
    for number in 0..UNSAVED_MAX {
        let name = format!("s{number}");
        let library = rig.node.node_mut().library_mut();
        assert_eq!(library.put(&name, b""), Ok(()));
        assert_eq!(library.remove(&name), Ok(()));
    }
    let library = rig.node.node_mut().library_mut();
    assert_eq!(library.put("more", b""), Err(StoreError::Busy));
    assert_eq!(library.put("s0", b"again"), Ok(()));
    rig.run_for(5_000_000);
    let library = rig.node.node_mut().library_mut();
    assert_eq!(library.put("more", b""), Ok(()));
}

#[test]
fn a_stored_script_is_called_with_arguments() {
    let mut rig = Rig::new(config());
    let library = rig.node.node_mut().library_mut();
    let text =
        b"local a = ... motor.queue_move(0, 100, a.steps) wait_idle() return motor.get_position(0)";
    assert_eq!(library.put("step", text), Ok(()));
    send(&mut rig, "return node.call('step', {steps = 77})");
    rig.run_for(1_000_000);
    assert_eq!(reported(&rig, ScriptOutcome::Returned), "77");
    assert_eq!(rig.position(), 77);
}
