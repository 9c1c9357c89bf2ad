//! Scenarios: what a fleet goes through in a bad hour, drawn from a seed, and judged.
//!
//! [`run`] is one scenario: three nodes, jobs and synchronized jobs coming in, and whatever can fail
//! failing meanwhile. Then everything is mended, and [`World::verdict`] must find that records,
//! commands and pulses tell one story and that no job is left without an end.
//!
//! `tests/seeds.rs` runs the first of them with every test run; `cargo world` runs any number.

use crate::{
    Faults, Random, World,
    verdict::Book,
    world::{EPOCH_US, MS, OldOwner, S},
};
use gateway::fleet::event::ReplyTo;
use keys::{JobId, StopMode, record::JobState};
use serde_json::json;
use std::{collections::BTreeSet, fmt, ops};

/// The nodes of a scenario.
pub const NODES: [&str; 3] = ["left", "middle", "right"];

/// When everything is mended, every job has its end within this time, s.
const PATIENCE_S: u64 = 64;

/// What can happen in a scenario.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Happening {
    /// A job for one node, of moves or of every kind of motion; one of four clients hands it in twice.
    Job,
    /// A synchronized job for two or three nodes.
    Group,
    /// The link of one node breaks for up to 4 s.
    Link,
    /// Several links break at once, for up to 4 s.
    Partition,
    /// A router between gateway and nodes restarts: all links break.
    Router,
    /// A node neither hears nor is heard for up to 8 s while its link stands.
    Stall,
    /// A node loses its power for up to 2 s.
    Reboot,
    /// The gateway is killed, and with it what waited for its disk.
    Kill,
    /// The gateway is killed, and its wall clock is wrong by up to an hour at its next start.
    WallClock,
    /// The wall clock is set while the gateway runs, by up to an hour either way, or right again.
    WallSet,
    /// The disk is full: the gateway ends by itself.
    Disk,
    /// A node's crystal changes its rate, to anything within ±100 ppm.
    Drift,
    /// A node's clock jumps ahead by up to 3 s, as after a long interrupt or a wrong register.
    Jump,
    /// A client stops one node, or all.
    Stop,
    /// A client lifts a node's latch.
    Release,
    /// A client cancels a job, which may have ended long ago.
    Cancel,
    /// Nothing.
    Calm,
}

impl Happening {
    /// All of them.
    pub const ALL: [Self; 17] = [
        Self::Job,
        Self::Group,
        Self::Link,
        Self::Partition,
        Self::Router,
        Self::Stall,
        Self::Reboot,
        Self::Kill,
        Self::WallClock,
        Self::WallSet,
        Self::Disk,
        Self::Drift,
        Self::Jump,
        Self::Stop,
        Self::Release,
        Self::Cancel,
        Self::Calm,
    ];

    /// How often, of [`SHARES`].
    const fn share(self) -> u64 {
        match self {
            Self::Job => 14,
            Self::Group => 4,
            Self::Cancel | Self::Stop | Self::Release | Self::Calm | Self::Link => 2,
            _ => 1,
        }
    }

    fn draw(random: &mut Random) -> Self {
        let mut at = random.below(SHARES);
        for happening in Self::ALL {
            match at.checked_sub(happening.share()) {
                Some(rest) => at = rest,
                None => return happening,
            }
        }
        unreachable!("the shares add up")
    }
}

/// The sum of all shares.
const SHARES: u64 = {
    let (mut sum, mut index) = (0, 0);
    while index < Happening::ALL.len() {
        sum += Happening::ALL[index].share();
        index += 1;
    }
    sum
};

/// What a scenario, or many, came to.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Outcome {
    /// Commands that nodes took.
    pub commands: u64,
    /// Jobs that clients handed in.
    pub jobs: u64,
    /// Of them, those for which somebody heard a receipt: each has a record with one end.
    pub accepted: u64,
    /// Of them, those that succeeded.
    pub succeeded: u64,
    /// How often the gateway began anew because its wall clock was set.
    pub begun_anew: u64,
    /// How often each thing happened.
    pub happened: [u64; Happening::ALL.len()],
}

impl ops::AddAssign for Outcome {
    fn add_assign(&mut self, other: Self) {
        self.commands += other.commands;
        self.jobs += other.jobs;
        self.accepted += other.accepted;
        self.succeeded += other.succeeded;
        self.begun_anew += other.begun_anew;
        for (sum, more) in self.happened.iter_mut().zip(other.happened) {
            *sum += more;
        }
    }
}

impl fmt::Display for Outcome {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self {
            commands,
            jobs,
            accepted,
            succeeded,
            begun_anew,
            happened,
        } = self;
        write!(
            f,
            "{jobs} jobs, {accepted} with a receipt, {succeeded} succeeded, {commands} commands taken; \
             the gateway began anew {begun_anew} times;"
        )?;
        for (happening, count) in Happening::ALL.iter().zip(happened) {
            write!(f, " {happening:?} {count}")?;
        }
        Ok(())
    }
}

/// A wall clock that is wrong by up to an hour, µs.
fn wrong_us(random: &mut Random) -> i64 {
    random.between(0, 7_200 * S) as i64 - 3_600 * S as i64
}

fn any_node(random: &mut Random) -> &'static str {
    NODES[random.below(NODES.len() as u64) as usize]
}

fn moves(random: &mut Random) -> Vec<(u8, i32)> {
    let count = random.between(1, 40);
    (0..count)
        .map(|_| {
            let steps = random.between(1, 60) as i32;
            let sign = if random.below(2) == 0 { 1 } else { -1 };
            (random.below(2) as u8, sign * steps)
        })
        .collect()
}

/// A command of any kind of motion that carries this number.
fn motion(random: &mut Random, number: u32) -> serde_json::Value {
    let axis = random.below(2);
    let sign = if random.below(2) == 0 { 1 } else { -1 };
    let steps = sign * random.between(1, 60) as i64;
    let speed_hz = random.between(500, 4_000);
    let accel = Book::accel_of(number, random.between(20_000, 200_000) as u32);
    match random.below(8) {
        0..4 => json!({"move": {"axis": axis, "delay_us": number, "steps": steps}}),
        4 => {
            json!({"ramp": {"axis": axis, "steps": 4 * steps, "speed_hz": speed_hz, "accel": accel}})
        }
        5 => {
            json!({"ramp_to": {"axis": axis, "position": steps, "speed_hz": speed_hz, "accel": accel}})
        }
        6 => {
            let both = [steps, sign * random.between(1, 60) as i64];
            json!({"line": {"steps": both, "speed_hz": speed_hz, "accel": accel}})
        }
        _ => json!({"set_position": {"axis": axis, "position": number}}),
    }
}

/// Returns whether a client was told that its job is kept.
fn is_receipt(world: &World, get: ReplyTo) -> bool {
    let answers = world.answers(get);
    let told = answers.replies.iter().filter(|(key, _)| key.is_some());
    // A job that was refused is answered by an error, without a key.
    told.count() > 0
}

/// Runs one scenario.
///
/// # Panics
/// Something is wrong in what was told, taken or played; the message says what.
pub fn run(seed: u64) -> Outcome {
    run_told(seed, |_, _, _| ())
}

/// Runs one scenario in which, besides, other gateways take the fleet over while those before
/// go on, are cut off and come back, or sleep and wake. Returns how often.
///
/// # Panics
/// See [`run`].
pub fn run_handed_over(seed: u64) -> (Outcome, u64) {
    let mut random = Random(seed.rotate_left(32) ^ 0x5bd1_e995);
    let mut count = 0;
    let outcome = run_with(
        seed,
        |_, _, _| (),
        |world| {
            if random.below(4) > 0 {
                return;
            }
            let us = random.between(1, 8_000) * MS;
            let old = match random.below(3) {
                0 => OldOwner::Present,
                1 => OldOwner::CutOff(us),
                _ => OldOwner::Asleep(us),
            };
            world.hand_over(old, false);
            count += 1;
        },
    );
    (outcome, count)
}

/// Runs one scenario and tells what happens in it: when, µs since its beginning, what, and to which
/// node if it concerns one.
///
/// # Panics
/// See [`run`].
pub fn run_told(seed: u64, tell: impl FnMut(u64, Happening, &str)) -> Outcome {
    run_with(seed, tell, |_| ())
}

fn run_with(
    seed: u64,
    mut tell: impl FnMut(u64, Happening, &str),
    mut besides: impl FnMut(&mut World),
) -> Outcome {
    let mut world = World::with_nodes(seed, &NODES);
    let mut random = Random(!seed);
    world.faults = Faults::drawn(&mut random);
    let mut book = Book::new();
    let mut outcome = Outcome::default();
    let mut asked: Vec<(String, ReplyTo)> = Vec::new();
    for _ in 0..random.between(8, 25) {
        let happening = Happening::draw(&mut random);
        outcome.happened[happening as usize] += 1;
        let node = any_node(&mut random);
        tell(world.now_us() - EPOCH_US, happening, node);
        match happening {
            Happening::Job => {
                let name = format!("job-{}", outcome.jobs);
                let job = if random.below(3) > 0 {
                    book.job(&name, &moves(&mut random))
                } else {
                    let count = random.between(1, 12) as usize;
                    book.job_of(&name, count, |_, number| motion(&mut random, number))
                };
                outcome.jobs += 1;
                asked.push((name.clone(), world.submit(node, &job)));
                if random.below(4) == 0 {
                    // The client did not hear the receipt and asks again.
                    asked.push((name, world.submit(node, &job)));
                }
            }
            Happening::Group => {
                let absent = random.below(NODES.len() as u64 + 1) as usize;
                let members = (0..).zip(NODES).filter(|(index, _)| *index != absent);
                let parts: Vec<_> = members
                    .map(|(_, node)| (node, moves(&mut random)))
                    .collect();
                let name = format!("job-{}", outcome.jobs);
                let job = book.group(&name, &parts);
                outcome.jobs += 1;
                asked.push((name, world.submit_group("table", &job)));
            }
            Happening::Link => world.break_link(node, random.between(1, 4_000) * MS),
            Happening::Partition => {
                for node in NODES {
                    if random.below(2) == 0 {
                        world.break_link(node, random.between(1, 4_000) * MS);
                    }
                }
            }
            Happening::Router => world.restart_router(random.between(1, 1_000) * MS, 2 * S),
            Happening::Stall => world.stall(node, random.between(1, 8_000) * MS),
            Happening::Reboot => world.reboot(node, random.between(1, 2_000) * MS),
            Happening::Kill => world.kill_gateway(random.between(1, 3_000) * MS),
            Happening::WallClock => {
                world.kill_gateway(random.between(1, 3_000) * MS);
                world.set_wall_ahead(wrong_us(&mut random));
            }
            Happening::WallSet => {
                let right = random.below(3) == 0;
                world.set_wall_ahead(if right { 0 } else { wrong_us(&mut random) });
            }
            Happening::Disk => world.fill_disk(),
            Happening::Drift => {
                let ppb = random.between(0, 200_000) as i64 - 100_000;
                world.set_drift(node, ppb);
            }
            Happening::Jump => world.jump_clock(node, random.between(1, 3_000) * MS),
            Happening::Stop => {
                let mode = if random.below(2) == 0 {
                    StopMode::Halt
                } else {
                    StopMode::Decelerate
                };
                if random.below(4) == 0 {
                    NODES.iter().for_each(|node| world.stop(node, mode));
                } else {
                    world.stop(node, mode);
                }
            }
            Happening::Release => {
                let _ = world.release(node);
            }
            Happening::Cancel if outcome.jobs > 0 => {
                let _ = world.cancel(&format!("job-{}", random.below(outcome.jobs)));
            }
            Happening::Cancel | Happening::Calm => {}
        }
        besides(&mut world);
        world.run_for(random.below(400 * MS));
    }
    // The faults end, the latches are lifted, and everything comes to its end.
    world.faults = Faults::NONE;
    for _ in 0..3 {
        world.run_for(4 * S);
        for node in NODES {
            let _ = world.release(node);
        }
    }
    // A start behind a link that was held for seconds is planned seconds ahead.
    for _ in 0..PATIENCE_S / 8 {
        world.run_for(8 * S);
        let mut records = world.records.values().filter_map(|records| records.last());
        if records.all(|record| record.state.is_final()) {
            break;
        }
    }
    outcome.commands = world.verdict(&book);
    let heard = asked.iter().filter(|(_, get)| is_receipt(&world, *get));
    let accepted: BTreeSet<&str> = heard.map(|(name, _)| name.as_str()).collect();
    for name in &accepted {
        let id = JobId::new(name).expect("legal");
        let ends = world.records.get(&id).is_some_and(|records| {
            let last = records.last().expect("a list begins with its first entry");
            last.state.is_final()
        });
        assert!(
            ends,
            "job {name} was accepted and has no record with an end"
        );
    }
    outcome.accepted = accepted.len() as u64;
    let last = world.records.values().filter_map(|records| records.last());
    outcome.succeeded = last
        .filter(|record| record.state == JobState::Succeeded)
        .count() as u64;
    outcome.begun_anew = world.begun_anew();
    world.check_bounds();
    outcome
}
