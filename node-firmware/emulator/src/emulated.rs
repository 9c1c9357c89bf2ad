//! One emulated node without any waiting: bytes and times in, bytes and edges out.
//!
//! Owns the ring's memory, the virtual pulse unit and the same [`Node`] as the board, and records
//! what went in and what the pins did. For virtual time use it directly; `wall.rs` drives it on a
//! real clock.

use crate::{
    config::{EmulatorConfig, Recording},
    firmware::{self, BootLoader, EmulatedKeeper},
    machine::Machine,
    memory::{Borrower, RingMemory, take_plans},
    pins::{Pin, PinEvent},
    pulse::VirtualRmt,
    record::{Held, InputEdge, Life, TakenCommand},
    store::MemoryStore,
    vcd::VcdWriter,
};
use keys::{
    AxisId, BatchReader, Command, LocalMicros, NodeId, NodeTopic, Order, QueueId, Status,
    command::COMMAND_WORDS,
    epoch,
    signed::Proof,
    update::{UpdateMessage, UpdateRefusal, UpdateReply},
};
use motion::{
    MotionConfig, StepBackend, TICKS_PER_US, Ticks,
    io::{enable::OutputChange, input::PinLevel},
};
use node::{
    Inbound, Node, NodeConfig, Outbound, Outputs,
    library::{Library, ScriptStore},
};
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

/// The laser and lidar of an emulated node.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Bench {
    laser_percent: u8,
    lidar_requested: bool,
    enables: Vec<PinEvent>,
    /// What was shifted out and not yet read back.
    shifted: Option<u32>,
    /// What a script has queued since the last look.
    queued: Vec<TakenCommand>,
}

impl Bench {
    /// Returns the laser's power, percent.
    pub fn laser_percent(&self) -> u8 {
        self.laser_percent
    }
}

impl Outputs for Bench {
    fn set_laser(&mut self, power_percent: u8) {
        self.laser_percent = power_percent;
    }

    fn request_lidar(&mut self) {
        self.lidar_requested = true;
    }

    fn shift_out(&mut self, word: u32) {
        self.shifted = Some(word);
    }

    fn set_enable(&mut self, change: OutputChange, at: Ticks) {
        self.enables.push(PinEvent {
            at_ticks: at.0,
            pin: Pin::Enable(change.output as u8),
            level: change.levels()[1],
        });
    }

    fn note_queued(
        &mut self,
        queue: QueueId,
        first_command: u64,
        commands: &[Command],
        now: LocalMicros,
    ) {
        self.queued.extend(
            commands
                .iter()
                .zip(first_command..)
                .map(|(command, number)| TakenCommand {
                    at: now,
                    queue,
                    number,
                    command: *command,
                }),
        );
    }
}

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
    lidar_readings: u64,
    commands: Vec<TakenCommand>,
    stops: Vec<keys::StopReport>,
    edges: Vec<PinEvent>,
    inputs: Vec<InputEdge>,
    holds: Vec<Held>,
    /// See [`Life::paced`].
    paced: bool,
    cut: bool,
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
    pub fn with_store(config: EmulatorConfig, boot: u32, store: Box<dyn ScriptStore>) -> Self {
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
            lidar_readings: 0,
            commands: Vec::new(),
            stops: Vec::new(),
            edges: Vec::new(),
            inputs: Vec::new(),
            holds: Vec::new(),
            paced: false,
            cut: false,
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
    fn open_store(&mut self, store: Box<dyn ScriptStore>) {
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
        &self.edges
    }

    /// Returns the record of this boot so far. Copies it.
    pub fn life(&self) -> Life {
        Life {
            boot: self.node.queue().boot,
            axis_count: self.node.motion().axis_count(),
            commands: self.commands.clone(),
            stops: self.stops.clone(),
            edges: self.edges.clone(),
            inputs: self.inputs.clone(),
            holds: self.holds.clone(),
            homes: self.config.home_facts(),
            beside: self.config.beside_facts(),
            inverted: self.config.inverted(),
            external: self.config.external(),
            lidar_waits: self.config.motion.lidar_wait_ms.is_some(),
            paced: self.paced,
            cut: self.cut,
            counted_steps: self.counted_steps(),
            status: self.status(),
        }
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

    fn take_life(&mut self) -> Life {
        Life {
            boot: self.node.queue().boot,
            axis_count: self.node.motion().axis_count(),
            commands: mem::take(&mut self.commands),
            stops: mem::take(&mut self.stops),
            edges: mem::take(&mut self.edges),
            inputs: mem::take(&mut self.inputs),
            holds: mem::take(&mut self.holds),
            homes: self.config.home_facts(),
            beside: self.config.beside_facts(),
            inverted: self.config.inverted(),
            external: self.config.external(),
            lidar_waits: self.config.motion.lidar_wait_ms.is_some(),
            paced: mem::take(&mut self.paced),
            cut: mem::take(&mut self.cut),
            counted_steps: self.counted_steps(),
            status: self.status(),
        }
    }

    fn counted_steps(&self) -> Vec<i64> {
        (0..self.node.motion().axis_count())
            .map(|axis| self.step_count(AxisId(axis as u8)))
            .collect()
    }

    /// Notes the commands that went into the ring, now that it has more than `accepted_before`.
    fn record_taken(&mut self, payload: &[u8], accepted_before: u64, now: LocalMicros) {
        let Recording::Edges { max } = self.config.record else {
            return;
        };
        if self.cut || self.node.motion().accepted_commands() == accepted_before {
            return;
        }
        // Who says it and who signs it is not for the judge of pulses.
        let Ok(mut reader) = epoch::split(payload)
            .and_then(|(_, order)| Proof::split(order))
            .and_then(|(_, order)| BatchReader::new(order))
        else {
            return;
        };
        let Order::Batch(header) = *reader.order() else {
            return;
        };
        if self.commands.len() + usize::from(header.command_count) > max {
            self.cut = true;
            return;
        }
        let mut number = header.first_command;
        while let Ok(Some(command)) = reader.next_command() {
            self.commands.push(TakenCommand {
                at: now,
                queue: header.queue,
                number,
                command,
            });
            number += 1;
        }
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

    /// Notes whether motion is held now.
    fn record_hold(&mut self) {
        let motion = self.node.motion();
        let at = motion.now().0;
        let open = self.holds.last_mut();
        let open = open.filter(|held| held.until_ticks.is_none());
        match (open, motion.is_held(), self.config.record) {
            (Some(held), false, _) => held.until_ticks = Some(at),
            (None, true, Recording::Edges { max }) if !self.cut => {
                self.holds.push(Held {
                    from_ticks: at,
                    until_ticks: None,
                });
                self.cut |= self.holds.len() > max;
            }
            _ => {}
        }
    }

    /// Notes what the last call did, and tells the node what its inputs did.
    fn observe(&mut self, now: LocalMicros) {
        self.record_hold();
        if mem::take(&mut self.node.outputs_mut().lidar_requested) {
            self.lidar_due.get_or_insert(now.plus_us(LIDAR_US));
        }
        self.paced |= self.node.is_held() || self.node.speed_percent() != 100;
        let queued = mem::take(&mut self.node.outputs_mut().queued);
        if let Recording::Edges { max } = self.config.record
            && !self.cut
        {
            self.commands.extend(queued);
            self.cut |= self.commands.len() > max;
        }
        if let Some(word) = self.node.outputs_mut().shifted.take() {
            self.shift_due = Some((now.plus_us(SHIFT_US), word));
        }
        loop {
            let from = self.edges.len();
            self.take_edges();
            let until = Ticks(now.0 * TICKS_PER_US);
            let levels = self.machine.follow(&self.edges[from..], until);
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
            && self.stops.last() != Some(stop)
        {
            self.stops.push(stop.clone());
        }
    }

    /// Takes the changes of pins since the last call, in order of time.
    fn take_edges(&mut self) {
        let from = self.edges.len();
        self.edges
            .extend(self.node.motion_mut().backend_mut().take_edges());
        if self.watches_pins() {
            self.edges.append(&mut self.node.outputs_mut().enables);
        } else {
            self.node.outputs_mut().enables.clear();
        }
        // Axes play one after the other within one call.
        self.edges[from..].sort_by_key(|event| event.at_ticks);
    }

    /// Keeps what is recorded of them.
    fn keep_edges(&mut self, from: usize) {
        if let Some(vcd) = self.vcd.as_mut() {
            for event in &self.edges[from..] {
                if let Err(error) = vcd.write(event) {
                    self.vcd_error.get_or_insert(error);
                    self.vcd = None;
                    break;
                }
            }
        }
        let edges_max = self.recorded_max();
        if self.cut || edges_max == 0 {
            self.edges.truncate(from);
        } else if self.edges.len() > edges_max {
            self.edges.truncate(edges_max);
            self.cut = true;
        }
    }

    fn record_input(&mut self, level: PinLevel) {
        if self.inputs.len() < self.recorded_max() {
            self.inputs.push(InputEdge {
                at_ticks: level.at.0,
                index: level.index,
                level: level.level,
                counted_steps: level.counted_steps,
            });
        }
    }

    fn watches_pins(&self) -> bool {
        self.vcd.is_some() || self.recorded_max() > 0
    }

    fn recorded_max(&self) -> usize {
        match self.config.record {
            Recording::Off => 0,
            Recording::Edges { max } => max,
        }
    }
}

impl node::run::Host for EmulatedNode {
    fn handle(&mut self, now: LocalMicros, inbound: Inbound<'_>) {
        match inbound {
            Inbound::Message { topic, payload } => Self::handle(self, topic, payload, now),
            other => self.inbound(other, now),
        }
    }

    fn poll(&mut self, now: LocalMicros) {
        Self::poll(self, now);
    }

    fn poll_timeout(&self) -> Option<LocalMicros> {
        Self::poll_timeout(self)
    }

    fn poll_outbox(&mut self, now: LocalMicros) -> Option<Outbound> {
        Self::poll_outbox(self, now)
    }

    fn store_script(&mut self, now: LocalMicros, name: &str, text: Option<&[u8]>) {
        self.node.store_script(now, name, text);
    }

    fn library(&self) -> &Library {
        self.node.library()
    }

    fn update(&mut self, now: LocalMicros, message: &UpdateMessage<'_>) -> UpdateReply {
        EmulatedNode::update(self, message, now)
    }
}

fn boot_node(
    memory: &RingMemory,
    config: &EmulatorConfig,
    input_levels: u32,
    boot: u32,
    boots: u64,
) -> Borrower {
    let seed = splitmix(config.seed.wrapping_add(boots));
    let mut backend = VirtualRmt::new(config.rmt.clone(), seed);
    let watched = !config.machine.switches.is_empty();
    backend.record_edges(config.record != Recording::Off || watched);
    let node_config = NodeConfig {
        keys: config.keys.clone(),
        motion: MotionConfig {
            input_levels,
            ..config.motion_config()
        },
        link_loss: config.link_loss,
        link_loss_after_us: config.link_loss_after_us,
        script: config.script,
        boot_script: config.boot_script,
        firmware: config.flash.as_ref().map_or(firmware::FACTORY, |flash| {
            BootLoader::boot(flash).version(flash)
        }),
        signers: config.signers.clone(),
        ..NodeConfig::new(config.name, boot)
    };
    let node = Node::new(
        memory.words(),
        take_plans(),
        backend,
        Bench::default(),
        node_config,
    );
    Borrower::from(node)
}

/// One step of splitmix64: well-mixed bits from any number.
pub(crate) fn splitmix(seed: u64) -> u64 {
    let mut mixed = seed.wrapping_add(0x9e37_79b9_7f4a_7c15);
    mixed = (mixed ^ mixed >> 30).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    mixed = (mixed ^ mixed >> 27).wrapping_mul(0x94d0_49bb_1331_11eb);
    mixed ^ mixed >> 31
}
