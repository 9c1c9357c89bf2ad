//! The interpreter on another core than the node: whatever happens on the one while the other waits for
//! an answer, nothing of a script that is over moves anything.

mod rig;
mod scripts;

use emulator::{EmulatorConfig, Recording, oracle};
use keys::{LocalMicros, NodeState, ScriptOutcome, StopMode, StopReason};
use node::interpreter::{Asked, Mail, Told};
use rig::{Rig, random};
use scripts::{reported, send};

fn config() -> EmulatorConfig {
    let mut config = rig::config();
    config.scripts_elsewhere = true;
    config.ring_commands = 64;
    config.record = Recording::Edges { max: 1_000_000 };
    config
}

#[test]
fn a_stop_does_not_wait_for_a_script_in_a_long_loop() {
    let mut rig = Rig::new(config());
    send(&mut rig, "motor.run(0, 1, 1000, 5000) while true do end");
    rig.run_for(100_000);
    assert_eq!(rig.state(), NodeState::Running);
    // The other core is in its loop: nothing of it runs until the stop is complete.
    let payload = keys::Stop {
        mode: StopMode::Halt,
    };
    let (topic, now) = (keys::NodeTopic::Stop, rig.now);
    rig.node.handle(topic, payload.to_payload(), now);
    let later = LocalMicros(now.0 + 1_000);
    rig.node.poll(later);
    assert_eq!(rig.state(), NodeState::Stopped);
    let at = rig.position();
    let late = rig.node.answer_script(1, Asked::Print("x".into()), later);
    assert_eq!(late, None, "it is over");
    assert_eq!(
        rig.interpreter.poll_timeout().map(|due| due <= later),
        Some(true)
    );
    rig.run_for(1_000_000);
    assert_eq!(rig.interpreter.poll_timeout(), None, "it has heard it");
    assert_eq!(rig.position(), at);
    let line = "script ended: client; it was at lua-1:1: in main chunk";
    assert!(
        rig.lines().iter().any(|told| told == line),
        "{:?}",
        rig.lines()
    );
}

/// While a letter is on its way, the node's core goes on.
struct SlowMail<'a, R: FnMut(u64) -> u64> {
    rig: &'a mut Rig,
    random: &'a mut R,
    letters: &'a mut u32,
}

impl<R: FnMut(u64) -> u64> SlowMail<'_, R> {
    /// Some turns of the planning task, and what may come over the network.
    fn live(&mut self) {
        for _ in 0..(self.random)(3) {
            let turn_us = 1 + (self.random)(2_000);
            self.rig.now = LocalMicros(self.rig.now.0 + turn_us);
            self.rig.node.poll(self.rig.now);
            let _ = self.rig.node.outbox(self.rig.now);
        }
        let now = self.rig.now;
        match (self.random)(4_000) {
            0 | 1 => {
                let mode = [StopMode::Halt, StopMode::Decelerate][(self.random)(2) as usize];
                let payload = keys::Stop { mode }.to_payload();
                self.rig.node.handle(keys::NodeTopic::Stop, payload, now);
            }
            2 => {
                self.rig.node.link(false, now);
                self.rig.node.link(true, now);
            }
            3 => self.rig.node.stop_pin(true, now),
            _ => {}
        }
    }
}

impl<R: FnMut(u64) -> u64> Mail for SlowMail<'_, R> {
    fn ask(&mut self, run: u32, asked: Asked) -> Option<Told> {
        *self.letters += 1;
        self.live();
        let ended = self.rig.status().stop;
        let accepted = self.rig.status().accepted_commands;
        let told = self.rig.node.answer_script(run, asked, self.rig.now);
        if self.rig.state() == NodeState::Stopped && ended.is_some() {
            assert_eq!(told, None, "a script that is over is told nothing");
            assert_eq!(self.rig.status().accepted_commands, accepted, "nor heard");
        }
        self.live();
        told
    }

    fn due(&mut self) -> u32 {
        self.rig.node.script_due()
    }
}

const SCRIPT: &str = "
    local sum = 0
    for round = 1, 40 do
        for step = 1, 5 do motor.queue_move(step % 2, 40 + step, 7 - 2 * step) end
        motor.queue_ramp(0, 20, 4000, 90000)
        motor.execute()
        sum = sum + motor.get_position(0) + node.status().queue_depth
        if round % 7 == 0 then wait_idle() end
        if round % 11 == 0 then sleep(2) end
        if round % 13 == 0 then wait_idle() motor.drive_by(1, 50, 3000, 50000) end
        table.sort({3, 1, 2}, function(a, b) motor.is_busy() return a < b end)
        print(round, sum)
    end
    return 'done'";

#[test]
fn whatever_happens_between_a_letter_and_its_answer_the_pulses_are_those_of_the_queue() {
    let (mut whole, mut stopped, mut letters) = (0, 0, 0);
    for seed in 1..=100 {
        let mut random = random(seed);
        let mut rig = Rig::new(config());
        rig.sent.clear();
        send_quietly(&mut rig);
        let mut interpreter = std::mem::take(&mut rig.interpreter);
        let mut turns = 0;
        loop {
            turns += 1;
            assert!(turns < 200_000, "seed {seed}: no end");
            let now = rig.now;
            let mut mail = SlowMail {
                rig: &mut rig,
                random: &mut random,
                letters: &mut letters,
            };
            mail.live();
            while let Some(word) = mail.rig.node.take_script_word() {
                interpreter.handle(now, word, &mut mail);
            }
            let now = mail.rig.now;
            interpreter.step(now, &mut mail);
            if interpreter.poll_timeout().is_none() && rig.state() != NodeState::Running {
                break;
            }
            rig.now = LocalMicros(rig.now.0 + 50);
        }
        rig.interpreter = interpreter;
        rig.run_for(2_000_000);
        let status = rig.status();
        assert_eq!(status.axes[0].speed_mhz, 0, "seed {seed}");
        let _ = rig.position();
        if let Err(violations) = oracle::check_life(&rig.node.life()) {
            panic!("seed {seed}: {violations:?}");
        }
        match status.stop {
            None => {
                whole += 1;
                assert_eq!(
                    reported(&rig, ScriptOutcome::Returned),
                    "\"done\"",
                    "seed {seed}"
                );
                // One number for itself.
                assert_eq!(status.executed_commands, 1 + 40 * 6, "seed {seed}");
            }
            Some(stop) => {
                stopped += 1;
                assert!(
                    matches!(stop.reason, StopReason::Client | StopReason::Pin),
                    "seed {seed}: {:?}, {:?}",
                    stop.reason,
                    scripts::report(&rig)
                );
            }
        }
        // The next script has the node for itself.
        rig.node.stop_pin(false, rig.now);
        let _ = rig.release(rig.queue());
        rig.sent.clear();
        send(
            &mut rig,
            "motor.queue_pause(1) motor.execute() wait_idle() return 2",
        );
        rig.run_for(1_000_000);
        assert_eq!(reported(&rig, ScriptOutcome::Returned), "2", "seed {seed}");
    }
    assert!(letters > 5_000, "{letters} letters");
    assert!(whole > 5 && stopped > 5, "{whole} whole, {stopped} stopped");
}

fn send_quietly(rig: &mut Rig) {
    let orders = scripts::script_orders(rig, "lua-1", SCRIPT, 1000);
    for order in orders {
        rig.node.handle(keys::NodeTopic::Batch, &order, rig.now);
    }
}
