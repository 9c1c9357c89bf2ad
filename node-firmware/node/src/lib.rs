//! The node without hardware: messages to motion and back.
//!
//! ```text
//!                    ┌────────────────────────── Node ──────────────────────────┐
//!  script ─────────▶ │ script.rs ── Lua ──▶ │                                    │
//!  batch ──────────▶ │ intake.rs ── CommandRing ──▶ motion ──▶ StepBackend ─────│──▶ pins
//!  stop, pin, link ▶ │ stop.rs ─────────── stop ──────▲ │                       │
//!  switches ───────▶ │ inputs.rs ── limits, homing ───▶ │                       │
//!  start ──────────▶ │ start.rs ── barrier ───────────▶ │                       │
//!  hold, speed ────▶ │ pace.rs ── hold, resume, speed ▶ │                       │
//!  jog ────────────▶ │ jog.rs ─── drives, leases ─────▶ │                       │
//!  clock ──────────▶ │ clock.rs                         ├── Laser, Lidar ───────│──▶ Outputs
//!                    │          report.rs ◀── position ─┘                       │
//!                    │              │                                           │
//!                    └──────── outbox.rs ────────────────────────────────────────┘
//!                        ack, status, start, clock, log
//! ```
//!
//! Start with [`Node`]: five verbs ([`Node::handle`], [`Node::poll`], [`Node::poll_timeout`],
//! [`Node::poll_outbox`], [`Node::stop`]), no socket, no clock, no pin. `intake.rs` is the way of
//! a batch, `stop.rs` the one stop path, `run.rs` the zenoh session around it.
#![no_std]

extern crate alloc;

pub mod interpreter;
pub mod library;
pub mod limits;
pub mod outbox;
pub mod run;
pub mod setup;
pub mod signed;
pub mod trace;

mod around;
mod clock;
mod inputs;
mod intake;
mod jog;
mod pace;
mod report;
mod script;
mod shelf;
mod start;
mod stop;
mod tell;

pub use outbox::Outbound;

use crate::{
    intake::CurrentJob,
    interpreter::Letters,
    jog::Jogs,
    library::Library,
    limits::{LINK_LOSS_AFTER_US_DEFAULT, OUTBOUND_BYTES_MAX, PUBLICATIONS_MAX},
    outbox::Outbox,
    pace::Pace,
    script::{Barriers, Publication, Slot},
    signed::Verifier,
    start::{Start, Told},
    stop::Phase,
    tell::Teller,
    trace::{Event, Trace},
};
use ::script::Limits;
use core::sync::atomic::AtomicU32;
use keys::{
    AxisId, Command, Fault, JobId, Keys, LocalMicros, NodeId, NodeState, NodeTopic, QueueId,
    Refusal, Stop, StopMode, StopReason, StopReport,
    clock::{ClockMessage, ClockReply},
    command::Ramp,
    epoch,
    script::REPORT_BYTES_MAX,
    status::{FAULTS_MAX, FaultCode},
    version,
};
use motion::{
    CommandRing, Motion, MotionConfig, MotionEvent, Plans, StepBackend, TICKS_PER_US, Ticks,
    io::{enable::OutputChange, input::PinLevel},
};

/// What to do when the link stays away while commands are executed.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum LinkLoss {
    /// Execute what the ring holds.
    Finish,
    /// Stop by the ramp that each axis allows; the latch is set.
    #[default]
    Decelerate,
    /// Stop at once; the latch is set.
    Halt,
}

/// What a node is told at its boot.
#[derive(Clone, Debug)]
pub struct NodeConfig {
    /// Its name: the chunk in its keys.
    pub name: NodeId,
    /// The keys of its fleet.
    pub keys: Keys,
    /// Random number of this boot: the gateway sees by it that the queue began anew.
    pub boot: u32,
    /// Version of the firmware.
    pub firmware: [u8; 3],
    /// The axes.
    pub motion: MotionConfig,
    /// What to do when the link stays away while commands are executed.
    pub link_loss: LinkLoss,
    /// How long the link must be gone for that, µs.
    pub link_loss_after_us: u64,
    /// What a script may take.
    pub script: Limits,
    /// Scripts are interpreted on another core: whoever keeps the node has an
    /// [`Interpreter`](interpreter::Interpreter) there, and carries the letters. Else the node does it
    /// itself, in slices between everything else.
    pub scripts_elsewhere: bool,
    /// Whether the stored script `boot` runs when the node starts.
    pub boot_script: bool,
    /// Public keys of operators: the node executes only what one of them has signed. None:
    /// whatever its gateway sends.
    pub signers: signed::Keys,
}

impl NodeConfig {
    /// Returns the defaults for a node of this name.
    pub fn new(name: NodeId, boot: u32) -> Self {
        Self {
            name,
            keys: Keys::default(),
            boot,
            firmware: [0, 1, 0],
            motion: MotionConfig::default(),
            link_loss: LinkLoss::default(),
            link_loss_after_us: LINK_LOSS_AFTER_US_DEFAULT,
            script: Limits::default(),
            scripts_elsewhere: false,
            boot_script: false,
            signers: signed::Keys::new(),
        }
    }
}

/// What comes in.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Inbound<'b> {
    /// The session is open and everything is declared.
    LinkUp,
    /// The session is gone.
    LinkDown,
    /// A message on one of the node's keys.
    Message {
        /// The last chunk of the key.
        topic: NodeTopic,
        /// Its bytes.
        payload: &'b [u8],
    },
    /// A lidar reading, mm.
    Lidar {
        /// The distance.
        mm: u32,
    },
    /// The stop input: `active` stops at once, and no release is taken until it is inactive.
    StopPin {
        /// Whether the stop is demanded.
        active: bool,
    },
    /// What the shift register was read back to show.
    Shift {
        /// A bit for each pin.
        word: u32,
    },
    /// A level of an input pin.
    Input(PinLevel),
    /// Signal strength of the link, dBm.
    SignalStrength {
        /// `None` without WiFi.
        rssi_dbm: Option<i8>,
    },
}

/// The outputs beside the step pins.
pub trait Outputs {
    /// Sets the laser's power, 0 to 100 percent.
    fn set_laser(&mut self, power_percent: u8);

    /// Asks for a lidar reading; it comes back as [`Inbound::Lidar`].
    fn request_lidar(&mut self);

    /// Switches an enable output now, its low-active and its high-active pin; `at` is when motion
    /// has asked for it.
    fn set_enable(&mut self, change: OutputChange, at: Ticks);

    /// Shifts a word into the shift register; what it shows then comes back as [`Inbound::Shift`].
    fn shift_out(&mut self, word: u32);

    /// An axis is driven outside the queue by this ramp from now on; `None`: at the speed that it has.
    /// Whoever judges the pulses wants to know; a board does not.
    fn note_drive(&mut self, axis: AxisId, ramp: Option<Ramp>, now: LocalMicros) {
        let _ = (axis, ramp, now);
    }

    /// An axis that was driven rests; after a stop nobody says so.
    fn note_rest(&mut self, axis: AxisId, at: Ticks) {
        let _ = (axis, at);
    }

    /// A script has put these commands into the queue, the first one as this number. Whoever
    /// judges the pulses wants to know; a board does not.
    fn note_queued(
        &mut self,
        queue: QueueId,
        first_command: u64,
        commands: &[Command],
        now: LocalMicros,
    ) {
        let _ = (queue, first_command, commands, now);
    }
}

/// The firmware minus hardware. See the crate for the picture.
#[derive(Debug)]
pub struct Node<'m, B: StepBackend, O: Outputs> {
    config: NodeConfig,
    motion: Motion<'m, B>,
    outputs: O,
    ring_commands: usize,
    /// The latest `now`: time does not go back here, whatever the caller says.
    now: LocalMicros,
    queue: QueueId,
    phase: Phase,
    job: Option<CurrentJob>,
    last_stop: Option<StopReport>,
    start: Start,
    told: Option<Told>,
    stop_pin_active: bool,
    /// Since when the link is gone, `None` while it is there.
    link_gone_at: Option<LocalMicros>,
    /// The policy was applied to this absence.
    link_loss_settled: bool,
    /// What it did, to be told when the link is back.
    link_loss_outcome: Option<&'static str>,
    credit_told: usize,
    status_due: bool,
    status_told_at: LocalMicros,
    state_told: NodeState,
    faults: heapless::Vec<Fault, FAULTS_MAX>,
    laser_percent: u8,
    lidar_mm: Option<u32>,
    lidar_count: u32,
    pace: Pace,
    jogs: Jogs,
    script: Slot,
    /// What waits for the interpreter on the other core, if there is one.
    letters: Letters,
    /// Barriers of the present script, or of the last one: their commands may wait longer than it.
    barriers: Barriers,
    /// When a script queued something last.
    script_queued_at: LocalMicros,
    report_due: bool,
    publications: heapless::Deque<Publication, PUBLICATIONS_MAX>,
    stored: Library,
    signed: Verifier,
    /// The newest epoch of a gateway that was heard since the boot: none older is obeyed.
    epoch: u32,
    rssi_dbm: Option<i8>,
    outbox: Outbox,
    teller: Teller,
    /// The link has come, and no status has left since.
    greets: bool,
    trace: Trace,
}

/// Returns the tick that begins at this microsecond.
pub(crate) const fn ticks_from_local(at: LocalMicros) -> Ticks {
    Ticks(at.0.saturating_mul(TICKS_PER_US))
}

/// Returns the first microsecond that does not lie before this tick.
const fn local_from_ticks(at: Ticks) -> LocalMicros {
    LocalMicros(at.0.div_ceil(TICKS_PER_US))
}

impl<'m, B: StepBackend, O: Outputs> Node<'m, B, O> {
    /// Boots: an empty queue over `memory` (8 words a command), positions at 0, no latch, no link.
    pub fn new(
        memory: &'m [AtomicU32],
        plans: Plans<'m>,
        backend: B,
        outputs: O,
        config: NodeConfig,
    ) -> Self {
        let motion_config = config.motion.clone();
        let mut node = Self {
            queue: QueueId {
                boot: config.boot,
                flush: 0,
            },
            config,
            motion: Motion::new(CommandRing::new(memory), plans, backend, motion_config),
            outputs,
            ring_commands: 0,
            now: LocalMicros(0),
            phase: Phase::Open,
            job: None,
            last_stop: None,
            start: Start::Open,
            told: None,
            stop_pin_active: false,
            link_gone_at: Some(LocalMicros(0)),
            link_loss_settled: false,
            link_loss_outcome: None,
            credit_told: 0,
            status_due: false,
            status_told_at: LocalMicros(0),
            state_told: NodeState::Idle,
            faults: heapless::Vec::new(),
            laser_percent: 0,
            lidar_mm: None,
            lidar_count: 0,
            pace: Pace::new(),
            jogs: Jogs::default(),
            script: Slot::None,
            letters: Letters::default(),
            barriers: Barriers::default(),
            script_queued_at: LocalMicros(0),
            report_due: false,
            publications: heapless::Deque::new(),
            stored: Library::default(),
            signed: Verifier::default(),
            epoch: 0,
            rssi_dbm: None,
            outbox: Outbox::new(),
            teller: Teller::default(),
            greets: false,
            trace: Trace::new(),
        };
        node.ring_commands = node.motion.credit_commands();
        node.credit_told = node.ring_commands;
        let [major, minor, patch] = node.config.firmware;
        node.log(
            LocalMicros(0),
            format_args!("started, firmware {major}.{minor}.{patch}"),
        );
        node
    }

    /// Takes in what happened.
    pub fn handle(&mut self, now: LocalMicros, inbound: Inbound<'_>) {
        let now = self.advance_to(now);
        match inbound {
            // What is urgent goes before the planning that the others begin with.
            Inbound::Message {
                topic: NodeTopic::Stop,
                payload,
            } => {
                self.begin_stop(StopReason::Client, Stop::from_payload(payload).mode, now);
            }
            Inbound::StopPin { active } => self.take_stop_pin(active, now),
            Inbound::Shift { word } => {
                self.run_motion(now);
                self.motion.take_shift(word);
            }
            Inbound::Input(level) => {
                // What comes before it has happened before it.
                self.run_motion(now);
                self.motion.input(level);
            }
            Inbound::Message {
                topic: NodeTopic::Jog,
                payload,
            } => self.ask_jog(payload, now),
            Inbound::Message { topic, payload } => match (topic, self.obey(payload)) {
                (NodeTopic::Clock, Ok(payload)) => {
                    self.take_clock(payload, now);
                    return;
                }
                (NodeTopic::Batch, payload) => {
                    // Books what has ended, so that the answer counts it.
                    self.run_motion(now);
                    let verdict = self.take_order(payload, now);
                    self.run_motion(now);
                    self.acknowledge(verdict, now);
                }
                (NodeTopic::Start, Ok(payload)) => {
                    self.run_motion(now);
                    self.take_start(payload, now);
                }
                (NodeTopic::Pace, Ok(payload)) => {
                    self.run_motion(now);
                    self.take_pace(payload, now);
                }
                // Nobody is told: its gateway hears it by the answer to an order.
                (NodeTopic::Clock | NodeTopic::Start | NodeTopic::Pace, Err(refusal)) => {
                    self.trace.note(now, Event::Refused(refusal));
                }
                _ => self.trace.note(now, Event::MessageDropped),
            },
            Inbound::LinkUp => self.take_link_up(now),
            Inbound::LinkDown => self.take_link_down(now),
            Inbound::Lidar { mm } => {
                self.run_motion(now);
                self.lidar_mm = Some(mm);
                self.lidar_count = self.lidar_count.wrapping_add(1);
                self.log(now, format_args!("lidar: {mm} mm"));
                self.motion.take_lidar();
            }
            Inbound::SignalStrength { rssi_dbm } => self.rssi_dbm = rssi_dbm,
        }
        self.run_motion(now);
        self.run_script(now);
        self.run_motion(now);
        self.settle(now);
    }

    /// Takes the epoch off a gateway's message, which is obeyed unless a newer one was heard.
    fn obey<'b>(&mut self, payload: &'b [u8]) -> Result<&'b [u8], Refusal> {
        let (epoch, payload) = epoch::split(payload).map_err(|_| Refusal::Malformed)?;
        if epoch < self.epoch {
            return Err(Refusal::Superseded { epoch: self.epoch });
        }
        self.epoch = epoch;
        Ok(payload)
    }

    /// Lets time pass: plans, books, reports. Call it at [`Node::poll_timeout`], or earlier.
    pub fn poll(&mut self, now: LocalMicros) {
        let now = self.advance_to(now);
        self.run_motion(now);
        self.watch_link(now);
        self.run_script(now);
        self.run_motion(now);
        self.settle(now);
    }

    /// Returns when [`Node::poll`] has something to do next, or [`Node::poll_outbox`] something
    /// to give; `None` if only a message can change anything.
    pub fn poll_timeout(&self) -> Option<LocalMicros> {
        let link_loss = self
            .link_gone_at
            .filter(|_| !self.link_loss_settled && !self.rests_at_barrier())
            .map(|gone_at| gone_at.plus_us(self.config.link_loss_after_us));
        let line = self.outbox.line_timeout().filter(|_| self.link_up());
        let save = (self.stored.can_save() && self.may_save()).then_some(self.now);
        [
            self.motion.poll_timeout().map(local_from_ticks),
            self.status_timeout(),
            self.start_timeout(),
            self.script_timeout(),
            self.jogs.timeout(),
            link_loss,
            line,
            save,
        ]
        .into_iter()
        .flatten()
        .min()
    }

    /// Gives the next message that may leave now, `None` if there is none or no link. Call it
    /// after every [`Node::handle`] and [`Node::poll`] until it gives `None`.
    pub fn poll_outbox(&mut self, now: LocalMicros) -> Option<Outbound> {
        let now = self.advance_to(now);
        if !self.link_up() {
            return None;
        }
        if let Some(probed) = self.outbox.pop_probe() {
            let reply = ClockMessage::Reply(ClockReply {
                probe: probed.probe.probe,
                boot: self.queue.boot,
                sent_at: probed.probe.sent_at,
                received_at: probed.received_at,
                replied_at: now,
            });
            return Some(outbound(NodeTopic::Clock, &reply));
        }
        if let Some(message) = self.outbox.pop_start() {
            return Some(outbound(NodeTopic::Start, &message));
        }
        if let Some(answer) = self.jogs.pop_answer() {
            return Some(answer);
        }
        if let Some(ack) = self.outbox.pop_ack() {
            return Some(outbound(NodeTopic::Ack, &ack));
        }
        // Before the status, so that who hears of a job's end knows its story; but a link begins with a
        // status, which says whose story it is.
        if !self.greets
            && let Some(event) = self.teller.pop()
        {
            return Some(outbound(NodeTopic::Trace, &event));
        }
        if self.status_due {
            self.status_due = false;
            self.greets = false;
            self.status_told_at = now;
            return Some(outbound(NodeTopic::Status, &self.status()));
        }
        if self.pace.due {
            self.pace.due = false;
            return Some(outbound(NodeTopic::Pace, &self.pace_message()));
        }
        if let Slot::Ended { report, text, .. } = &self.script
            && self.report_due
        {
            self.report_due = false;
            let mut buffer = [0; REPORT_BYTES_MAX];
            return Some(Outbound {
                topic: NodeTopic::Report,
                suffix: heapless::String::new(),
                payload: report.encode(text, &mut buffer).iter().copied().collect(),
            });
        }
        if let Some(publication) = self.publications.pop_front() {
            return Some(Outbound {
                topic: NodeTopic::Data,
                suffix: publication.suffix,
                payload: publication.json.bytes().collect(),
            });
        }
        let line = self.outbox.pop_line(now)?;
        Some(Outbound {
            topic: NodeTopic::Log,
            suffix: heapless::String::new(),
            payload: line.as_bytes().iter().copied().collect(),
        })
    }

    /// Ends, and gives the memory for plans back.
    pub fn into_plans(self) -> Plans<'m> {
        self.motion.into_plans()
    }

    /// Returns what it was told at its boot.
    pub fn config(&self) -> &NodeConfig {
        &self.config
    }

    /// Returns the present queue.
    pub fn queue(&self) -> QueueId {
        self.queue
    }

    /// Returns the job whose commands were accepted last and have not all ended.
    pub fn job(&self) -> Option<JobId> {
        self.job.map(|job| job.id)
    }

    /// Returns how the queue before this one ended, `None` since boot if none did.
    pub fn last_stop(&self) -> Option<&StopReport> {
        self.last_stop.as_ref()
    }

    /// Returns how many commands the ring holds when empty.
    pub fn ring_commands(&self) -> usize {
        self.ring_commands
    }

    /// Returns whether the link is there.
    pub fn link_up(&self) -> bool {
        self.link_gone_at.is_none()
    }

    /// Returns motion, to look at.
    pub fn motion(&self) -> &Motion<'m, B> {
        &self.motion
    }

    /// Returns motion, for those who emulate its hardware.
    pub fn motion_mut(&mut self) -> &mut Motion<'m, B> {
        &mut self.motion
    }

    /// Returns the outputs.
    pub fn outputs(&self) -> &O {
        &self.outputs
    }

    /// Returns the outputs, for those who emulate them.
    pub fn outputs_mut(&mut self) -> &mut O {
        &mut self.outputs
    }

    /// Returns the stored scripts.
    pub fn library(&self) -> &Library {
        &self.stored
    }

    /// Returns the stored scripts, to change them.
    pub fn library_mut(&mut self) -> &mut Library {
        &mut self.stored
    }

    /// Returns the last events and their counters.
    pub fn trace(&self) -> &Trace {
        &self.trace
    }

    fn advance_to(&mut self, now: LocalMicros) -> LocalMicros {
        self.now = self.now.max(now);
        self.now
    }

    /// Lets motion plan and book up to `now`, and acts on what it says.
    fn run_motion(&mut self, now: LocalMicros) {
        while let Some(event) = self.motion.poll(ticks_from_local(now)) {
            match event {
                // A stop has switched the laser off; what was planned before it does not count.
                MotionEvent::Laser { .. } if self.phase != Phase::Open => {}
                MotionEvent::Laser { power_percent } => self.set_laser(power_percent),
                MotionEvent::LidarRequest => self.outputs.request_lidar(),
                MotionEvent::LidarMissed => {
                    self.log(now, format_args!("lidar: no reading in time"))
                }
                MotionEvent::Underrun => self.note_fault(FaultCode::UNDERRUN, now),
                MotionEvent::Rest | MotionEvent::Held => {}
                MotionEvent::DriveEnded { axis } => {
                    self.jogs.forget_axis(axis);
                    self.outputs.note_rest(axis, self.motion.now());
                }
                MotionEvent::AtBarrier { command } => self.reach_barrier(command, now),
                MotionEvent::BarrierMissed { command } => self.miss_barrier(command, now),
                MotionEvent::Started {
                    command,
                    first_edge_at,
                } => self.tell_started(command, first_edge_at, now),
                MotionEvent::Limit {
                    axis,
                    position_steps,
                    hit,
                } => self.reach_limit(axis, position_steps, hit, now),
                MotionEvent::Homed {
                    axis,
                    position_steps,
                } => self.note_homed(axis, position_steps, now),
                MotionEvent::HomeFailed {
                    axis,
                    position_steps,
                    error,
                } => self.fail_homing(axis, position_steps, error, now),
                MotionEvent::Output(change) => {
                    let at = self.motion.now();
                    self.outputs.set_enable(change, at);
                }
                MotionEvent::ShiftOut { word } => self.outputs.shift_out(word),
                MotionEvent::ShiftFault(fault) => self.fail_shift(fault, now),
                MotionEvent::CdFailed { error } => self.fail_cd(error, now),
                MotionEvent::StatusCd => self.tell_status_cd(now),
                MotionEvent::StopInput { active } => self.take_stop_pin(active, now),
                MotionEvent::Probe {
                    active,
                    positions_steps,
                } => self.take_probe(active, &positions_steps, now),
                MotionEvent::Stopped => self.complete_stop(now),
                MotionEvent::Fault(code) => {
                    self.note_fault(code, now);
                    self.begin_stop(StopReason::Fault, StopMode::Halt, now);
                }
                MotionEvent::Miscount {
                    axis,
                    ledger_steps,
                    counted_steps,
                } => {
                    self.note_fault(FaultCode::COUNT_MISMATCH, now);
                    self.log(
                        now,
                        format_args!(
                            "axis {}: {ledger_steps} steps in the ledger, {counted_steps} counted at the pin",
                            axis.0
                        ),
                    );
                    self.begin_stop(StopReason::Fault, StopMode::Halt, now);
                }
            }
        }
    }

    /// Draws the conclusions after anything happened: job over, credit, status.
    fn settle(&mut self, now: LocalMicros) {
        self.watch_pulses();
        if self
            .job
            .is_some_and(|job| self.motion.executed_commands() >= job.end)
        {
            self.tell_ended(now);
            self.job = None;
            self.status_due = true;
        }
        self.watch_start(now);
        self.watch_pace(now);
        self.watch_jogs(now);
        self.save_scripts(now);
        self.tell_credit(now);
        self.outbox.earn_line_tokens(now);
        let state = self.state();
        if state != self.state_told {
            self.state_told = state;
            self.status_due = true;
        }
        if self.status_timeout().is_some_and(|due| due <= now) {
            self.status_due = true;
        }
    }

    fn set_laser(&mut self, power_percent: u8) {
        self.laser_percent = power_percent;
        self.outputs.set_laser(power_percent);
    }

    fn take_link_up(&mut self, now: LocalMicros) {
        self.trace.note(now, Event::LinkUp);
        let gone_at = self.link_gone_at.take().unwrap_or(now);
        if let Some(outcome) = self.link_loss_outcome.take() {
            let gone_ms = now.since_us(gone_at) / 1000;
            self.log(
                now,
                format_args!("the link was gone for {gone_ms} ms while moving: {outcome}"),
            );
        }
        self.link_loss_settled = false;
        self.status_due = true;
        self.greets = true;
        self.pace.due = true;
        // What was on its way when the link went may be lost.
        if let Slot::Ended { say_at, .. } = &mut self.script {
            *say_at = now;
        }
    }

    fn take_link_down(&mut self, now: LocalMicros) {
        self.outbox.link_down();
        self.jogs.link_down();
        if self.link_gone_at.is_none() {
            self.trace.note(now, Event::LinkDown);
            self.link_gone_at = Some(now);
            self.link_loss_settled = false;
        }
    }
}

fn outbound<M: serde::Serialize>(topic: NodeTopic, message: &M) -> Outbound {
    let mut bytes = [0; OUTBOUND_BYTES_MAX];
    let used = version::encode(message, &mut bytes)
        .expect("OUTBOUND_BYTES_MAX holds every message of a node");
    Outbound {
        topic,
        suffix: heapless::String::new(),
        payload: used.iter().copied().collect(),
    }
}
