//! A driver on the model, with interrupts that are late, as the back end of a whole [`Motion`].
#![allow(dead_code, reason = "each test uses a part of it")]

use crate::model::{Edge, Model, ModelRegisters, Silicon};
use keys::{AxisId, Command, command::COMMAND_WORDS, status::FaultCode};
use motion::{
    Axis, CommandRing, Motion, MotionConfig, MotionEvent, PlanMemory, StepBackend, Ticks,
};
use rmt::{Place, Streamer, StreamerConfig};
use std::{cell::RefCell, rc::Rc, sync::atomic::AtomicU32};

pub(crate) const CLOCK_DIVIDER: u8 = 5;

/// How late things are.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Lateness {
    /// From event to interrupt, ticks.
    pub(crate) interrupt_ticks_min: u64,
    pub(crate) interrupt_ticks_max: u64,
    /// What each look of the planner at the axes costs while they play, ticks.
    pub(crate) plan_ticks: u64,
    /// The same at rest.
    pub(crate) start_plan_ticks: u64,
    pub(crate) seed: u64,
}

impl Default for Lateness {
    fn default() -> Self {
        Self {
            interrupt_ticks_min: 16,
            interrupt_ticks_max: 80,
            plan_ticks: 0,
            start_plan_ticks: 0,
            seed: 1,
        }
    }
}

pub(crate) fn splitmix(seed: u64) -> u64 {
    let mut x = seed.wrapping_add(0x9e37_79b9_7f4a_7c15);
    x = (x ^ x >> 30).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    x = (x ^ x >> 27).wrapping_mul(0x94d0_49bb_1331_11eb);
    x ^ x >> 31
}

/// The streamer and the world around it.
pub(crate) struct Rig<const AXES: usize> {
    pub(crate) streamer: Streamer<ModelRegisters, [Axis; AXES]>,
    pub(crate) model: Rc<RefCell<Model>>,
    lateness: Lateness,
    random: u64,
}

impl<const AXES: usize> Rig<AXES> {
    pub(crate) fn new(
        silicon: Silicon,
        lateness: Lateness,
        places: [Place; AXES],
        prefetch_words: u8,
    ) -> Self {
        let channels = places.iter().map(|place| place.channel).collect();
        let model = Rc::new(RefCell::new(Model::new(silicon, channels)));
        let axes = [const { Axis::new() }; AXES];
        let config = StreamerConfig {
            places: &places,
            divider: CLOCK_DIVIDER,
            prefetch_words,
        };
        let mut streamer = Streamer::new(ModelRegisters(model.clone()), config, axes);
        streamer.begin();
        Self {
            streamer,
            model,
            lateness,
            random: lateness.seed,
        }
    }

    fn latency(&mut self) -> u64 {
        self.random = splitmix(self.random);
        let span = self.lateness.interrupt_ticks_max - self.lateness.interrupt_ticks_min + 1;
        self.lateness.interrupt_ticks_min + self.random % span
    }

    /// Lets time pass with interrupts; stops early when the interrupt asks for the task.
    fn run(&mut self, until: u64) -> u64 {
        self.streamer.resume();
        loop {
            self.model.borrow_mut().advance(until, true);
            let pending = self.model.borrow().pending_since;
            let Some(since) = pending else { break };
            let at = (since + self.latency()).max(self.model.borrow().now);
            self.model.borrow_mut().advance(at, false);
            if self.streamer.on_interrupt().wake {
                break;
            }
        }
        self.model.borrow().now
    }
}

impl<const AXES: usize> StepBackend for Rig<AXES> {
    fn axes(&mut self) -> &mut [Axis] {
        let now = self.model.borrow().now;
        let until = if self.streamer.is_playing() {
            now + self.lateness.plan_ticks
        } else {
            now + self.lateness.start_plan_ticks
        };
        self.model.borrow_mut().advance(until, false);
        self.streamer.axes()
    }

    fn start_ticks(&self) -> u64 {
        self.streamer.start_ticks()
    }

    fn start(&mut self, now: Ticks, lead_ticks: u64) {
        self.streamer.start(now, lead_ticks);
    }

    fn service(&mut self, until: Ticks) -> Ticks {
        let _ = self.streamer.service(until);
        let now = self.run(until.0);
        Ticks(now.min(until.0))
    }

    fn is_playing(&self) -> bool {
        self.streamer.is_playing()
    }

    fn halt(&mut self, now: Ticks) -> Ticks {
        self.streamer.halt(now)
    }

    fn played_steps(&self, axis: AxisId) -> i64 {
        self.streamer.played_steps(axis)
    }

    fn counted_steps(&self, axis: AxisId) -> Option<i64> {
        self.streamer.counted_steps(axis)
    }

    fn take_fault(&mut self) -> Option<FaultCode> {
        self.streamer.take_fault()
    }
}

/// Memory of a ring for this many commands, for the length of the test program.
pub(crate) fn memory(commands: usize) -> &'static [AtomicU32] {
    let words = (0..commands * COMMAND_WORDS).map(|_| AtomicU32::new(0));
    Box::leak(words.collect())
}

/// A whole motion on a back end, fed from a list.
pub(crate) struct Bench<B: StepBackend> {
    pub(crate) motion: Motion<'static, B>,
    pub(crate) waiting: std::collections::VecDeque<Command>,
    pub(crate) events: Vec<MotionEvent>,
    pub(crate) now: Ticks,
}

impl<B: StepBackend> Bench<B> {
    pub(crate) fn new(backend: B, axis_count: usize) -> Self {
        let config = MotionConfig {
            axis_count,
            ..MotionConfig::default()
        };
        let plans = Box::leak(Box::new(PlanMemory::new())).plans();
        Self {
            motion: Motion::new(CommandRing::new(memory(512)), plans, backend, config),
            waiting: std::collections::VecDeque::new(),
            events: Vec::new(),
            now: Ticks(0),
        }
    }

    pub(crate) fn order(&mut self, commands: impl IntoIterator<Item = Command>) {
        self.waiting.extend(commands);
        self.feed();
    }

    fn feed(&mut self) {
        let count = self.motion.credit_commands().min(self.waiting.len());
        if count == 0 {
            return;
        }
        let mut reservation = self.motion.reserve(count).expect("there is room");
        for command in self.waiting.drain(..count) {
            reservation.push(&command);
        }
        reservation.commit();
    }

    pub(crate) fn poll(&mut self, now: Ticks) {
        self.now = now;
        while let Some(event) = self.motion.poll(now) {
            self.events.push(event);
        }
        self.feed();
    }

    /// Polls every millisecond, as the board's task does, until all is executed and quiet.
    pub(crate) fn run_to_rest(&mut self) {
        for _ in 0..100_000 {
            self.poll(self.now.plus(16_000));
            let left = self.motion.accepted_commands() - self.motion.executed_commands();
            if left == 0 && self.waiting.is_empty() && !self.motion.backend().is_playing() {
                self.poll(self.now.plus(160_000));
                return;
            }
            if self.fault().is_some() {
                return;
            }
        }
        panic!("it does not come to rest");
    }

    pub(crate) fn fault(&self) -> Option<FaultCode> {
        self.events.iter().find_map(|event| match event {
            MotionEvent::Fault(code) => Some(*code),
            MotionEvent::Miscount { .. } => Some(FaultCode::COUNT_MISMATCH),
            _ => None,
        })
    }
}

/// Rising edges of a channel.
pub(crate) fn rises(edges: &[Edge], channel: usize) -> Vec<u64> {
    let rise = |edge: &&Edge| edge.channel == channel && edge.level;
    edges.iter().filter(rise).map(|edge| edge.at).collect()
}
