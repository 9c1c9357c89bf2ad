//! One emulated node without any waiting: bytes and times in, bytes and edges out.
//!
//! Owns the ring's memory, the virtual pulse unit and the same [`Node`] as the board, and records
//! what went in and what the pins did. For virtual time use it directly; `wall.rs` drives it on a
//! real clock.

mod boot;
mod letters;
mod outputs;
mod recorded;

pub use outputs::Bench;

use crate::{
    config::{EmulatorConfig, Recording},
    firmware::{self, EmulatedKeeper},
    machine::Machine,
    memory::{Borrower, RingMemory},
    pins::{Pin, PinEvent},
    pulse::VirtualRmt,
    record::Life,
    store::MemoryStore,
    vcd::VcdWriter,
};
use boot::boot_node;
use keys::{
    AxisId, LocalMicros, NodeId, NodeTopic, Status,
    command::COMMAND_WORDS,
    update::{UpdateMessage, UpdateRefusal, UpdateReply},
};
use motion::{StepBackend, TICKS_PER_US, Ticks, io::input::PinLevel};
use node::{Inbound, Node, Outbound, library::BoxedStore};
use recorded::Recorded;
use std::{
    io::{self, Write},
    mem,
};

/// Time that the emulated lidar takes for a reading.
pub const LIDAR_US: u64 = 20_000;

/// Time that a word takes to the emulated shift register and back.
pub const SHIFT_US: u64 = 100;

/// Time between two looks at the switches while one could change: how late the node hears of it at
/// most, as a board's task hears of an interrupt.
pub const LOOK_US: u64 = 50;

/// Steps that an axis makes at most in one microsecond.
const STEPS_PER_US: u64 = 5;

/// Past boots that are kept. More: the oldest is forgotten.
pub const PAST_LIVES_MAX: usize = 64;

/// The node inside an [`EmulatedNode`].
pub type InnerNode = Node<'static, VirtualRmt, Bench>;

/// See the module.
pub struct EmulatedNode {
    // Declared before `memory`, so dropped before the memory is handed on.
    node: Borrower,
    memory: RingMemory,
    config: EmulatorConfig,
    machine: Machine,
    /// Up to when the machine was looked at.
    looked_at: LocalMicros,
    boots: u64,
    /// Takes other firmware; `None` without a flash.
    keeper: Option<EmulatedKeeper>,
    /// The firmware wants to boot again.
    wants_restart: bool,
    lidar_due: Option<LocalMicros>,
    /// What the shift register shows, and when that is read back.
    shift_due: Option<(LocalMicros, u32)>,
    /// The next so many words that are read back are wrong.
    shift_errors: u32,
    /// So many words in a row have been wrong, and the most that ever were.
    shift_wrong: u32,
    shift_wrong_max: u32,
    lidar_readings: u64,
    recorded: Recorded,
    past: Vec<Life>,
    vcd: Option<VcdWriter<Box<dyn Write + Send>>>,
    vcd_error: Option<io::Error>,
}

impl std::fmt::Debug for EmulatedNode {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("EmulatedNode")
            .field("name", &self.config.name)
            .field("status", &self.node.status())
            .finish_non_exhaustive()
    }
}

impl EmulatedNode {
    /// Boots a node: its time begins at 0, its link is down, its positions are 0. `boot` is the
    /// random number that tells boots apart.
    ///
    /// # Panics
    /// [`EmulatorConfig::check`] finds something wrong.
    pub fn new(config: EmulatorConfig, boot: u32) -> Self {
        Self::with_store(config, boot, Box::<MemoryStore>::default())
    }

    /// Boots a node whose stored scripts are in this store.
    ///
    /// # Panics
    /// [`EmulatorConfig::check`] finds something wrong.
    pub fn with_store(config: EmulatorConfig, boot: u32, store: BoxedStore) -> Self {
        if let Err(error) = config.check() {
            panic!("{error}");
        }
        let memory = RingMemory::take(config.ring_commands * COMMAND_WORDS);
        let is_active_low = |input| {
            let input = config.motion.inputs.get(input);
            input.is_some_and(|input| input.active_low)
        };
        let inverted = std::array::from_fn(|carriage| {
            let axis = config.motion.axes.get(carriage);
            axis.is_some_and(|axis| axis.direction_inverted)
        });
        let machine = Machine::new(config.machine.clone(), is_active_low, inverted, config.seed);
        let mut node = Self {
            node: boot_node(&memory, &config, machine.levels(), boot, 0),
            memory,
            machine,
            looked_at: LocalMicros(0),
            config,
            boots: 1,
            keeper: None,
            wants_restart: false,
            lidar_due: None,
            shift_due: None,
            shift_errors: 0,
            shift_wrong: 0,
            shift_wrong_max: 0,
            lidar_readings: 0,
            recorded: Recorded::default(),
            past: Vec::new(),
            vcd: None,
            vcd_error: None,
        };
        node.boot_firmware();
        node.open_store(store);
        node
    }

    /// What a boot does with the slots.
    fn boot_firmware(&mut self) {
        let Some(flash) = &self.config.flash else {
            return;
        };
        self.wants_restart = false;
        self.keeper = firmware::boot(flash, self.config.update_key, 0)
            .inspect_err(|error| tracing::error!("{}: {error}", self.config.name))
            .ok();
    }

    /// Returns what takes other firmware, `None` without a flash.
    pub fn keeper(&self) -> Option<&EmulatedKeeper> {
        self.keeper.as_ref()
    }

    /// Returns whether the firmware wants to boot again: call [`EmulatedNode::reset`].
    pub fn wants_restart(&self) -> bool {
        self.wants_restart
    }

    /// Takes a message about another firmware.
    pub fn update(&mut self, message: &UpdateMessage<'_>, now: LocalMicros) -> UpdateReply {
        self.look(now);
        let moves = self.node.motion().is_active();
        match self.keeper.as_mut() {
            Some(keeper) => keeper.handle(message, moves, now.0),
            None => UpdateReply::Refused(UpdateRefusal::NoSlot),
        }
    }

    /// What a boot does with the stored scripts.
    fn open_store(&mut self, store: BoxedStore) {
        let start = LocalMicros(0);
        self.node.open_store(start, store);
        self.node.run_boot_script(start);
        self.observe(start);
    }

    /// Writes the pins of this boot as a value change dump from now on.
    ///
    /// # Errors
    /// Those of `out`.
    pub fn dump_to(&mut self, out: Box<dyn Write + Send>) -> io::Result<()> {
        let axes = (0..self.node.motion().axis_count()).map(|axis| AxisId(axis as u8));
        let mut pins: Vec<_> = axes
            .flat_map(|axis| [Pin::Step(axis), Pin::Direction(axis)])
            .collect();
        if self.config.motion.cd.is_some() {
            pins.extend([Pin::StepC, Pin::DirectionC, Pin::StepD, Pin::DirectionD]);
        }
        let enables = 0..self.config.motion.enables.len();
        pins.extend(enables.map(|output| Pin::Enable(output as u8)));
        let vcd = VcdWriter::new(out, &self.config.name, pins)?;
        self.vcd = Some(vcd);
        self.node.motion_mut().backend_mut().record_edges(true);
        Ok(())
    }

    /// Ends the value change dump and tells whether it is whole.
    ///
    /// # Errors
    /// The first error of its `out` since [`EmulatedNode::dump_to`].
    pub fn finish_dump(&mut self) -> io::Result<()> {
        if let Some(error) = self.vcd_error.take() {
            self.vcd = None;
            return Err(error);
        }
        let at_ticks = self.node.status().at.0 * motion::TICKS_PER_US;
        self.vcd.take().map_or(Ok(()), |vcd| vcd.finish(at_ticks))
    }

    /// Returns its name.
    pub fn name(&self) -> NodeId {
        self.config.name
    }

    /// Returns its settings.
    pub fn config(&self) -> &EmulatorConfig {
        &self.config
    }

    /// Takes a message on one of the node's keys.
    pub fn handle(&mut self, topic: NodeTopic, payload: &[u8], now: LocalMicros) {
        self.look(now);
        let queue = self.node.queue();
        let accepted = self.node.motion().accepted_commands();
        self.inbound(Inbound::Message { topic, payload }, now);
        if topic == NodeTopic::Batch && self.node.queue() == queue {
            self.record_taken(payload, accepted, now);
        }
    }

    /// Takes anything else that comes in.
    pub fn inbound(&mut self, inbound: Inbound<'_>, now: LocalMicros) {
        self.look(now);
        self.node.handle(now, inbound);
        self.observe(now);
    }

    /// Gives an input pin a level by hand: a stop button, a probe.
    pub fn set_input(&mut self, index: usize, level: bool, now: LocalMicros) {
        self.look(now);
        self.poll(now);
        let counted_steps = std::array::from_fn(|axis| self.step_count(AxisId(axis as u8)));
        let level = PinLevel {
            index,
            level,
            at: Ticks(now.0 * TICKS_PER_US),
            counted_steps,
        };
        self.record_input(level);
        self.inbound(Inbound::Input(level), now);
    }

    /// Returns where the carriage of an axis is, steps of the machine.
    pub fn place_steps(&self, axis: AxisId) -> i64 {
        self.carriage_steps(axis.index())
    }

    /// Returns where a carriage is, that of an axis or of C or D, steps of the machine. Without any
    /// switch nobody has looked.
    pub fn carriage_steps(&self, carriage: usize) -> i64 {
        self.machine.place_steps(carriage)
    }

    /// Connects or cuts the link.
    pub fn link(&mut self, up: bool, now: LocalMicros) {
        let inbound = if up {
            Inbound::LinkUp
        } else {
            Inbound::LinkDown
        };
        self.inbound(inbound, now);
    }

    /// Presses or frees the stop input.
    pub fn stop_pin(&mut self, active: bool, now: LocalMicros) {
        self.inbound(Inbound::StopPin { active }, now);
    }

    /// Lets the node find this fault, as the board would.
    pub fn fault(&mut self, code: keys::status::FaultCode, now: LocalMicros) {
        self.look(now);
        self.node.fault(code, now);
        self.observe(now);
    }

    /// Lets time pass.
    pub fn poll(&mut self, now: LocalMicros) {
        self.look(now);
        if self.lidar_due.is_some_and(|due| due <= now) {
            self.lidar_due = None;
            self.lidar_readings += 1;
            // Half a metre to two and a half.
            let mm = 500 + splitmix(self.config.seed ^ self.lidar_readings) % 2_000;
            self.node.handle(now, Inbound::Lidar { mm: mm as u32 });
        }
        if let Some((due, word)) = self.shift_due
            && due <= now
        {
            self.shift_due = None;
            let wrong = self.shift_errors > 0;
            self.shift_errors = self.shift_errors.saturating_sub(1);
            self.shift_wrong = if wrong { self.shift_wrong + 1 } else { 0 };
            self.shift_wrong_max = self.shift_wrong_max.max(self.shift_wrong);
            let word = if wrong { !word } else { word };
            self.show(word, now);
            self.node.handle(now, Inbound::Shift { word });
        }
        self.node.poll(now);
        self.observe(now);
        if let Some(keeper) = self.keeper.as_mut() {
            if self.node.link_up() {
                keeper.link_up();
            }
            self.wants_restart |= keeper.poll(now.0, self.node.motion().is_active());
        }
    }

    /// The pins of the shift register take these levels.
    fn show(&mut self, word: u32, now: LocalMicros) {
        let Some(shift) = self.config.motion.shift else {
            return;
        };
        let backend = self.node.motion_mut().backend_mut();
        for axis in 0..shift.direction_pins.len() {
            if let Some(pin) = shift.direction_pin_of(axis) {
                let level = word >> pin & 1 != 0;
                backend.set_direction_pin(axis, level, Ticks(now.0 * TICKS_PER_US));
            }
        }
    }

    /// Disturbs the shift register: the next so many words that are read back are wrong.
    pub fn disturb_shift(&mut self, words: u32) {
        self.shift_errors = words;
    }

    /// Returns the most words in a row that were read back wrong.
    pub fn shift_wrong_max(&self) -> u32 {
        self.shift_wrong_max
    }

    /// Returns when [`EmulatedNode::poll`] has something to do next.
    pub fn poll_timeout(&self) -> Option<LocalMicros> {
        let shift_due = self.shift_due.map(|(due, _)| due);
        let firmware = self.keeper.as_ref().and_then(EmulatedKeeper::poll_timeout);
        let firmware = firmware.filter(|_| !self.wants_restart).map(LocalMicros);
        [
            self.node.poll_timeout(),
            self.lidar_due,
            shift_due,
            firmware,
        ]
        .into_iter()
        .flatten()
        .min()
    }

    /// Gives the next message that leaves; `None` if there is none or no link.
    pub fn poll_outbox(&mut self, now: LocalMicros) -> Option<Outbound> {
        self.node.poll_outbox(now)
    }

    /// Gives every message that leaves now.
    pub fn outbox(&mut self, now: LocalMicros) -> Vec<Outbound> {
        std::iter::from_fn(|| self.node.poll_outbox(now)).collect()
    }

    /// Cuts the power and boots again with this random number: queue, latch and positions are
    /// lost, its time begins at 0, the link is down.
    pub fn reset(&mut self, boot: u32) {
        if let Some(vcd) = self.vcd.as_mut()
            && let Err(error) = vcd.flush()
        {
            self.vcd_error.get_or_insert(error);
        }
        // Ticks begin at 0 again, which a dump cannot show.
        self.vcd = None;
        let life = self.take_life();
        if self.past.len() == PAST_LIVES_MAX {
            self.past.remove(0);
        }
        self.past.push(life);
        self.machine.reboot();
        self.looked_at = LocalMicros(0);
        let levels = self.machine.levels();
        // What was saved stays, as in flash.
        let store = self.node.library_mut().detach();
        self.node = boot_node(&self.memory, &self.config, levels, boot, self.boots);
        self.boots += 1;
        self.lidar_due = None;
        self.shift_due = None;
        self.boot_firmware();
        self.open_store(store.expect("a node has its store since its boot"));
    }

    /// Returns what the node says about itself.
    pub fn status(&self) -> Status {
        self.node.status()
    }

    /// Returns the exact position of an axis, as the node knows it.
    pub fn position_steps(&self, axis: AxisId) -> i64 {
        self.node.motion().position_steps(axis)
    }

    /// Returns the emulated pulse counter of an axis: steps with sign since boot, counted at the
    /// pins.
    pub fn step_count(&self, axis: AxisId) -> i64 {
        self.node.motion().backend().step_count(axis)
    }

    /// Returns the node itself, to look at.
    pub fn node(&self) -> &InnerNode {
        &self.node
    }

    /// Gives the node inside, for what no message asks of it.
    pub fn node_mut(&mut self) -> &mut InnerNode {
        &mut self.node
    }

    /// Returns the changes of pins that were recorded since this boot.
    pub fn edges(&self) -> &[PinEvent] {
        &self.recorded.edges
    }

    /// Returns the records of the boots before, oldest first.
    pub fn past_lives(&self) -> &[Life] {
        &self.past
    }

    /// Gives the records of all boots, oldest first, and forgets them.
    pub fn take_lives(&mut self) -> Vec<Life> {
        let last = self.take_life();
        self.past.push(last);
        mem::take(&mut self.past)
    }

    /// Lets time pass up to `now`, in steps that are short where a switch could change, so that the
    /// node hears of it in time.
    fn look(&mut self, now: LocalMicros) {
        self.record_hold();
        if self.machine.is_empty() {
            return;
        }
        while self.looked_at < now {
            let at = self.looked_at;
            let mut next = now;
            let backend = self.node.motion().backend();
            if backend.is_playing() || backend.cd_pins().is_running() {
                let quiet_us = self.machine.quiet_steps() / STEPS_PER_US;
                next = next.min(at.plus_us(quiet_us.max(LOOK_US)));
            }
            if let Some(due) = self.node.poll_timeout() {
                next = next.min(due.max(at.plus_us(1)));
            }
            self.looked_at = next;
            self.node.poll(next);
            self.observe(next);
        }
    }

    /// Notes what the last call did, and tells the node what its inputs did.
    fn observe(&mut self, now: LocalMicros) {
        self.record_hold();
        if mem::take(&mut self.node.outputs_mut().lidar_requested) {
            self.lidar_due.get_or_insert(now.plus_us(LIDAR_US));
        }
        let share = self.node.motion().speed_share();
        self.recorded.paced |= self.node.is_held() || share != recorded::SHARE_AT_BOOT;
        self.record_drives();
        let queued = mem::take(&mut self.node.outputs_mut().queued);
        if let Recording::Edges { max } = self.config.record
            && !self.recorded.cut
        {
            self.recorded.commands.extend(queued);
            self.recorded.cut |= self.recorded.commands.len() > max;
        }
        if let Some(word) = self.node.outputs_mut().shifted.take() {
            self.shift_due = Some((now.plus_us(SHIFT_US), word));
        }
        loop {
            let from = self.recorded.edges.len();
            self.take_edges();
            let until = Ticks(now.0 * TICKS_PER_US);
            let levels = self.machine.follow(&self.recorded.edges[from..], until);
            self.keep_edges(from);
            if levels.is_empty() {
                break;
            }
            for level in levels {
                self.record_input(level);
                self.node.handle(now, Inbound::Input(level));
            }
        }
        if self.config.record != Recording::Off
            && let Some(stop) = self.node.last_stop()
            && self.recorded.stops.last() != Some(stop)
        {
            self.recorded.stops.push(stop.clone());
        }
    }
}

/// One step of splitmix64: well-mixed bits from any number.
pub(crate) fn splitmix(seed: u64) -> u64 {
    let mut mixed = seed.wrapping_add(0x9e37_79b9_7f4a_7c15);
    mixed = (mixed ^ mixed >> 30).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    mixed = (mixed ^ mixed >> 27).wrapping_mul(0x94d0_49bb_1331_11eb);
    mixed ^ mixed >> 31
}
