//! [`Motion`]: the ring, the planner, the axes and what ends when, behind one door.

mod change;
mod check;
mod config;
mod drive;
mod homing;
mod inputs;
mod marks;
mod named;
mod outputs;
mod reach;

pub use check::CommandError;
pub use config::{ConfigError, MotionConfig, ShiftConfig};
pub use drive::{Course, DriveError, Target};
pub use named::{CdError, ConfigCd};
pub use reach::{Beyond, Outlook, SoftLimits};

use drive::Drive;
use homing::Homing;
use marks::{Mark, Marks, What};
use named::Cd;
use outputs::{Laser, Shift};

use crate::{
    Axis, CommandRing, Direction, Full, Reservation, StepBackend, Ticks,
    io::{
        enable::{AxisSet, Enables, OutputChange},
        home::{HomeConfig, HomeError, Switches},
        input::{Inputs, Role, Switch},
        shift::ShiftFault,
    },
    law::speed_from_hz,
    limits::{
        ALARM_TICKS, CHANNELS, HOLD_TICKS_MAX, MARKS_MAX, PATH_AHEAD_TICKS, TICK_HZ, TICKS_PER_US,
    },
    lookahead::{LINES_MAX, Line},
    planner::{Begun, Planner, Run, Split, runs_of, ticks_of},
    profile::Timing,
    steps::Moment,
};
use core::mem;
use keys::{
    AxisId, Command, Features, StopMode,
    command::{Ramp, RampShape},
    status::FaultCode,
};

/// What an axis came to.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum LimitHit {
    /// It runs into this limit.
    Switch(Switch),
    /// A command would move it further into this limit. Nothing of it has moved.
    Blocked {
        /// Number of the command in the queue.
        command: u64,
        /// The limit.
        switch: Switch,
    },
    /// A command would move it beyond a soft limit. Nothing of it has moved.
    Soft {
        /// Number of the command in the queue.
        command: u64,
        /// Where to.
        beyond: Beyond,
    },
}

impl core::fmt::Display for LimitHit {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        match self {
            Self::Switch(switch) => write!(f, "ran into its {switch}"),
            Self::Blocked { command, switch } => {
                write!(
                    f,
                    "command {command} would move it further into its {switch}"
                )
            }
            Self::Soft { command, beyond } => write!(f, "command {command} would move it {beyond}"),
        }
    }
}

/// What happened since the last call.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum MotionEvent {
    /// The commands before have ended, or motion is interrupted or goes on: the laser takes this
    /// power.
    Laser {
        /// 0 to 100.
        power_percent: u8,
    },
    /// The commands before have ended: a lidar reading is due. What follows waits for
    /// [`Motion::take_lidar`] if the configuration says so.
    LidarRequest,
    /// It did not come in time; the queue goes on.
    LidarMissed,
    /// The pulses had to rest although the job has more: see [`Motion::expect_more`].
    Underrun,
    /// Everything that was accepted has ended.
    Rest,
    /// A stop is complete: the last pulse has left.
    Stopped,
    /// Motion is held: see [`Motion::hold`].
    Held,
    /// A drive has come to rest: see [`Motion::drive`].
    DriveEnded,
    /// Everything before a barrier has ended; it waits for [`Motion::release_barrier`].
    AtBarrier {
        /// Number of the barrier in the queue.
        command: u64,
    },
    /// The release came too late for its instant; it still waits.
    BarrierMissed {
        /// Number of the barrier in the queue.
        command: u64,
    },
    /// The first active edge behind a barrier has left.
    Started {
        /// Number of the barrier in the queue.
        command: u64,
        /// When; if nothing steps before the next barrier or the end, the instant of the release.
        first_edge_at: Ticks,
    },
    /// An axis is at a limit. Told once; it goes on unless [`Motion::stop`] follows.
    Limit {
        /// The axis.
        axis: AxisId,
        /// Its position when this was found.
        position_steps: i64,
        /// What it came to.
        hit: LimitHit,
    },
    /// An axis has been homed.
    Homed {
        /// The axis.
        axis: AxisId,
        /// Where it rests now.
        position_steps: i64,
    },
    /// Homing failed: the queue does not go on without [`Motion::stop`].
    HomeFailed {
        /// The axis.
        axis: AxisId,
        /// Where it is, as far as it knows.
        position_steps: i64,
        /// Why.
        error: HomeError,
    },
    /// An enable output switches.
    Output(OutputChange),
    /// The shift register is to show this word; [`Motion::take_shift`] takes what is read back.
    ShiftOut {
        /// A bit for each pin.
        word: u32,
    },
    /// The shift register does not follow: nothing behind it is known to be on.
    ShiftFault(ShiftFault),
    /// C or D did not arrive: the queue does not go on without [`Motion::stop`].
    CdFailed {
        /// Why.
        error: CdError,
    },
    /// The commands before have ended: [`Motion::status_cd`] is asked for.
    StatusCd,
    /// A stop input changed.
    StopInput {
        /// Whether the stop is demanded.
        active: bool,
    },
    /// The probe changed.
    Probe {
        /// Whether it touches.
        active: bool,
        /// Where each axis was at that edge.
        positions_steps: [i64; CHANNELS],
    },
    /// The pulse hardware found a fault.
    Fault(FaultCode),
    /// At rest, ledger and pulse counter disagree about an axis.
    Miscount {
        /// The axis.
        axis: AxisId,
        /// What the ledger says, steps since boot.
        ledger_steps: i64,
        /// What was counted at the pin, steps since boot.
        counted_steps: i64,
    },
}

/// Where the pulses are.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Phase {
    /// No channel plays.
    Rest,
    /// The channels play; `timeline` is the end of what is planned.
    Playing { timeline: Ticks },
    /// A controlled stop.
    Decelerating,
    /// The stop is complete, and nobody has been told.
    Stopped,
}

/// At which barrier the queue waits.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Barrier {
    /// None, or nobody has been told.
    Open,
    /// Told.
    Waiting,
    /// To be released at this instant.
    Armed { start_at: Ticks },
}

/// Whether motion is held.
#[derive(Clone, Copy, Debug)]
enum Hold {
    None,
    /// It slows down, or a command without a path is under way.
    Slowing,
    /// It rests or will, within this line.
    At(Split),
    /// It goes on with this line.
    Resuming(Split),
}

/// A barrier was released, and its first edge has not been told.
#[derive(Clone, Copy, Debug)]
struct Start {
    command: u64,
    start_at: Ticks,
    first_edge_at: Option<Ticks>,
}

/// Events that wait for the next poll: two of an input's level, two of what follows from them.
const TOLD_MAX: usize = 8;

/// Motion of one node. See the crate for the picture.
///
/// Call [`Motion::poll`] until it gives `None`, at [`Motion::poll_timeout`] or earlier; a late call
/// delays events, never pulses.
#[derive(Debug)]
pub struct Motion<'m, B: StepBackend> {
    ring: CommandRing<'m>,
    backend: B,
    axis_count: usize,
    timing: [Timing; CHANNELS],
    /// Rest between the start of the channels and the first command: time for the direction pins.
    lead_ticks: u64,
    planner: Planner,
    marks: Marks,
    phase: Phase,
    barrier: Barrier,
    start: Option<Start>,
    hold: Hold,
    /// A change in flight has not been made yet.
    change_due: bool,
    /// How many commands there were when the end of the path was looked at.
    extended_commands: u64,
    drive: Option<Drive>,
    homing: Option<Homing>,
    cd: Option<Cd>,
    laser: Laser,
    /// How long a reading is waited for, and until when it is now.
    lidar_wait_ticks: Option<u64>,
    lidar_until: Option<Ticks>,
    enables: Enables,
    shift: Option<Shift>,
    /// When the drivers that were switched on let the queue begin.
    enabled_at: Option<Ticks>,
    /// A command that waits for rest runs: homing, C or D.
    station: bool,
    homes: [Option<HomeConfig>; CHANNELS],
    /// Position = frame + played steps, as it was when the axis was homed, whatever was renamed
    /// since; `None`: it is not homed.
    frames_steps: [Option<i64>; CHANNELS],
    soft_limits: [Option<SoftLimits>; CHANNELS],
    inputs: Inputs,
    switches: [Switches; CHANNELS],
    /// A limit was told, and nothing was stopped since.
    limit_told: bool,
    /// Whether an axis has a limit.
    has_limits: bool,
    /// Which way each axis has stepped last, while it moves.
    headings: [Option<Direction>; CHANNELS],
    /// Played steps when that was found.
    seen_steps: [i64; CHANNELS],
    told: heapless::Deque<MotionEvent, TOLD_MAX>,
    /// Share of the lines' speed, 2⁻¹⁶.
    share: u32,
    /// What is planned from rest begins no earlier: a barrier was released for this instant.
    resume_at: Ticks,
    now: Ticks,
    /// Earliest start: when the pins are quiet after a halt, and the last direction was held.
    quiet_at: Ticks,
    /// When the channels were started.
    started_at: Ticks,
    /// Speed of what each axis has encoded last.
    encoded_mhz: [i32; CHANNELS],
    origins_steps: [i64; CHANNELS],
    /// Origins at the end of what is planned.
    planned_origins_steps: [i64; CHANNELS],
    /// Played steps at the end of what is planned.
    planned_steps: [i64; CHANNELS],
    accepted_commands: u64,
    executed_commands: u64,
    expected_commands: u64,
    fault: Option<FaultCode>,
    /// Axes that are to be compared with their counters.
    unchecked_axes: usize,
    /// By how much each counter is known to differ from the ledger.
    miscounts_steps: [i64; CHANNELS],
}

impl<'m, B: StepBackend> Motion<'m, B> {
    /// Takes the ring and the hardware; all axes rest at position 0. The back end's axes become
    /// those of `config`.
    ///
    /// # Panics
    /// [`MotionConfig::check`] finds something wrong, or the back end has fewer axes.
    pub fn new(ring: CommandRing<'m>, mut backend: B, config: MotionConfig) -> Self {
        if let Err(error) = config.check() {
            panic!("{error}");
        }
        assert!(
            backend.axes().len() >= config.axis_count,
            "the back end has fewer channels than axes"
        );
        let start_ticks = backend.start_ticks();
        for (axis, profile) in backend.axes().iter_mut().zip(config.axes) {
            *axis = crate::Axis::new(profile);
        }
        let timing = config.axes.map(Timing::from);
        let lead_ticks = timing[..config.axis_count].iter().map(Timing::turn_ticks);
        let is_high = |index: usize| config.input_levels >> index & 1 != 0;
        let inputs = Inputs::new(config.inputs, is_high, Ticks(0));
        let axes = (0..).map(AxisId);
        let is_pressed = |axis, switch| inputs.is_active(Role::Axis { axis, switch });
        let mut switches = [Switches::default(); CHANNELS];
        for (switches, axis) in switches.iter_mut().zip(axes.clone()) {
            for switch in [Switch::Min, Switch::Max, Switch::Home] {
                switches.set(switch, is_pressed(axis, switch));
            }
        }
        let has_limit = |axis| {
            let has = |switch| config.inputs.has(Role::Axis { axis, switch });
            has(Switch::Min) || has(Switch::Max)
        };
        let has_limits = axes.take(CHANNELS).any(has_limit);
        let mut enables = Enables::new(&config.enables).expect("it is checked");
        for output in config.enables.iter().filter(|output| !output.auto) {
            enables.enable(output.axes, Ticks(0));
        }
        let cd = config.cd.map(|cd| {
            assert!(backend.cd().is_some(), "the back end has no C and D");
            Cd::new(cd, |role| inputs.is_active(role)).expect("it is checked")
        });
        Self {
            ring,
            backend,
            axis_count: config.axis_count,
            timing,
            lead_ticks: start_ticks + lead_ticks.max().expect("there is an axis"),
            planner: Planner::new(),
            marks: Marks::new(),
            phase: Phase::Rest,
            barrier: Barrier::Open,
            start: None,
            hold: Hold::None,
            change_due: false,
            extended_commands: 0,
            drive: None,
            homing: None,
            cd,
            laser: Laser::default(),
            lidar_wait_ticks: config
                .lidar_wait_ms
                .map(|ms| u64::from(ms) * 1_000 * TICKS_PER_US),
            lidar_until: None,
            enables,
            shift: config.shift.map(Shift::new),
            enabled_at: None,
            station: false,
            homes: config.homes,
            frames_steps: [None; CHANNELS],
            soft_limits: config.soft_limits,
            inputs,
            switches,
            limit_told: false,
            has_limits,
            headings: [None; CHANNELS],
            seen_steps: [0; CHANNELS],
            told: heapless::Deque::new(),
            share: 1 << 16,
            resume_at: Ticks(0),
            now: Ticks(0),
            quiet_at: Ticks(0),
            started_at: Ticks(0),
            encoded_mhz: [0; CHANNELS],
            origins_steps: [0; CHANNELS],
            planned_origins_steps: [0; CHANNELS],
            planned_steps: [0; CHANNELS],
            accepted_commands: 0,
            executed_commands: 0,
            expected_commands: 0,
            fault: None,
            unchecked_axes: 0,
            miscounts_steps: [0; CHANNELS],
        }
    }

    /// Returns how far it has come: the time of what it tells. Not later than that of the last call.
    pub fn now(&self) -> Ticks {
        self.now
    }

    /// Returns how many axes there are.
    pub fn axis_count(&self) -> usize {
        self.axis_count
    }

    /// Returns what this firmware can do.
    pub fn features(&self) -> Features {
        let mut features = Features::BASIC
            .with(Features::RAMPS)
            .with(Features::BARRIERS);
        if self.cd.is_some() {
            features = features.with(Features::CD);
        }
        let homes = (0..).map(AxisId).zip(&self.homes[..self.axis_count]);
        homes
            .filter(|(_, home)| home.is_some())
            .fold(features, |features, (axis, _)| {
                features.with(Command::Home { axis }.feature())
            })
    }

    /// Returns how many commands still fit.
    pub fn credit_commands(&self) -> usize {
        self.ring.room()
    }

    /// Sets `count` places of the ring aside; push commands that [`Motion::check`] has approved.
    ///
    /// # Errors
    /// [`Full`]: not all of them fit now.
    pub fn reserve(&mut self, count: usize) -> Result<Reservation<'_, 'm>, Full> {
        self.ring
            .reserve_counted(count, &mut self.accepted_commands)
    }

    /// Returns how many commands were accepted since the queue began.
    pub fn accepted_commands(&self) -> u64 {
        self.accepted_commands
    }

    /// Returns how many of them have ended: their last pulse and its interval have passed.
    pub fn executed_commands(&self) -> u64 {
        self.executed_commands
    }

    /// The job goes on up to the command of this number: to run dry before it is an underrun.
    pub fn expect_more(&mut self, until_command: u64) {
        self.expected_commands = until_command;
    }

    /// Returns whether something was accepted and has not ended, or a stop is under way.
    pub fn is_active(&self) -> bool {
        self.accepted_commands > self.executed_commands
            || self.drive.is_some()
            || matches!(self.phase, Phase::Decelerating | Phase::Stopped)
    }

    /// Returns whether the queue rests at a barrier, told by [`MotionEvent::AtBarrier`].
    pub fn is_at_barrier(&self) -> bool {
        self.barrier != Barrier::Open
    }

    /// Goes on at `start_at`: the commands behind the barrier begin on that tick, by the lead-in of
    /// the pulse train. Not at a barrier, nothing happens.
    pub fn release_barrier(&mut self, start_at: Ticks) {
        if self.barrier != Barrier::Open {
            self.barrier = Barrier::Armed { start_at };
        }
    }

    /// Takes a release back. Returns whether that was in time: `false` once the lead-in plays.
    pub fn hold_barrier(&mut self) -> bool {
        if let Barrier::Armed { .. } = self.barrier {
            self.barrier = Barrier::Waiting;
        }
        self.barrier == Barrier::Waiting
    }

    /// Returns the exact position of an axis, as of the last `now`, steps; 0 for an axis that does
    /// not exist.
    pub fn position_steps(&self, axis: AxisId) -> i64 {
        self.origins_steps
            .get(usize::from(axis.0))
            .map_or(0, |origin| {
                origin.wrapping_add(self.backend.played_steps(axis))
            })
    }

    /// Returns the speed of an axis with sign, as of the last `now`, mHz.
    pub fn speed_mhz(&self, axis: AxisId) -> i32 {
        let encoded_mhz = self.encoded_mhz.get(usize::from(axis.0));
        let encoded_mhz = encoded_mhz.copied().unwrap_or(0);
        if self.phase == Phase::Decelerating || self.drive.is_some() {
            return encoded_mhz;
        }
        let Some(mark) = self.marks.iter().find(|mark| mark.end > self.now) else {
            return 0;
        };
        let runs = match mark.what {
            What::Moves(runs) => runs,
            What::Path(_) => return encoded_mhz,
            _ => return 0,
        };
        let run = runs.into_iter().flatten().find(|run| run.axis == axis);
        let Some(run) = run else { return 0 };
        let begin = mark.end.0 - command_ticks(&runs);
        if !(begin..begin + run.ticks().unwrap_or(0)).contains(&self.now.0) {
            return 0;
        }
        let speed = (1_000 * TICK_HZ / run.interval_ticks).min(i32::MAX as u64);
        let speed = i32::try_from(speed).unwrap_or(i32::MAX);
        if run.steps < 0 { -speed } else { speed }
    }

    /// Returns the hardware.
    pub fn backend(&self) -> &B {
        &self.backend
    }

    /// Returns the hardware, for those who emulate it.
    pub fn backend_mut(&mut self) -> &mut B {
        &mut self.backend
    }

    /// Lets time pass up to `now`: plays, plans, books. Call it until it gives `None`.
    pub fn poll(&mut self, now: Ticks) -> Option<MotionEvent> {
        let now = now.max(self.now);
        loop {
            if let Some(code) = self.fault.take() {
                return Some(MotionEvent::Fault(code));
            }
            self.pass_inputs();
            self.pass_cd();
            if let Some(event) = self.told.pop_front() {
                return Some(event);
            }
            if let Some(event) = self.check_counters() {
                return Some(event);
            }
            if let Some(event) = self.pass_marks() {
                return Some(event);
            }
            if let Some(event) = self.pass_phase() {
                return Some(event);
            }
            if let Some(event) = self.pass_barrier() {
                return Some(event);
            }
            self.pass_lidar();
            self.pass_station();
            self.pass_homing();
            self.plan();
            if let Some(event) = self.pass_enables() {
                return Some(event);
            }
            if let Some(event) = self.pass_start() {
                return Some(event);
            }
            let has_ended = self.marks.front().is_some_and(|mark| mark.end <= self.now);
            if has_ended || !self.told.is_empty() {
                continue;
            }
            if self.now >= now {
                return None;
            }
            // An input counts at its own time, and so does a driver that is ready.
            let inputs = self.inputs.poll_timeout();
            let due = inputs.into_iter().chain(self.outputs_timeout()).min();
            let until = due.map_or(now, |due| due.max(self.now).min(now));
            self.now = match self.phase {
                Phase::Rest => {
                    let alarm = self.alarm();
                    self.service_cd(alarm.map_or(until, |alarm| alarm.max(self.now).min(until)))
                }
                Phase::Stopped => until,
                Phase::Playing { .. } | Phase::Decelerating => self.backend.service(until),
            };
            self.fault = self.backend.take_fault();
            self.note_speeds();
            if self.has_limits {
                self.note_headings();
            }
        }
    }

    /// Returns when [`Motion::poll`] has something to tell, `None` if only a command or a stop can
    /// change anything.
    pub fn poll_timeout(&self) -> Option<Ticks> {
        let told = (!self.told.is_empty()).then_some(self.now);
        [
            self.phase_timeout(),
            self.inputs.poll_timeout(),
            self.cd_timeout(),
            self.outputs_timeout(),
            told,
        ]
        .into_iter()
        .flatten()
        .min()
    }

    fn phase_timeout(&self) -> Option<Ticks> {
        match self.phase {
            Phase::Stopped => Some(self.now),
            // Its end depends on what the hardware still holds.
            Phase::Decelerating => Some(self.now.plus(1_000 * TICKS_PER_US)),
            Phase::Rest | Phase::Playing { .. } => {
                let event = self.marks.iter().find(|mark| mark.what.tells());
                let end = match self.phase {
                    Phase::Playing { timeline } if self.now < timeline => Some(timeline),
                    Phase::Playing { timeline } => {
                        Some(rest_from(timeline).max(self.now.plus(TICKS_PER_US)))
                    }
                    _ => None,
                };
                // Half of what is planned has ended: room for more of what waits.
                let plan = (self.ring.count() > 0)
                    .then(|| self.marks.iter().nth(MARKS_MAX / 2))
                    .flatten();
                let marks = [event, plan].into_iter().flatten().map(|mark| mark.end);
                let first_edge = self.start.map(|start| {
                    start
                        .first_edge_at
                        .unwrap_or(start.start_at)
                        .max(self.now.plus(1))
                });
                let alarm = self.alarm().filter(|_| self.phase == Phase::Rest);
                // A drive or a resumption begins with the next call.
                let begins = matches!(self.hold, Hold::Resuming(_))
                    || self
                        .drive
                        .is_some_and(|drive| drive.next.is_some() && !self.is_held());
                let begin = (begins && self.phase == Phase::Rest).then_some(self.now);
                marks
                    .chain(end)
                    .chain(first_edge)
                    .chain(alarm)
                    .chain(begin)
                    .min()
            }
        }
    }

    /// The one stop: drops everything that is not played. [`StopMode::Halt`] is complete when this
    /// returns, [`StopMode::Decelerate`] when [`Motion::poll`] says [`MotionEvent::Stopped`].
    pub fn stop(&mut self, mut mode: StopMode, now: Ticks) {
        // What belongs to the time before the stop happened before it. Of its events only what is
        // wrong still matters, and what the stop pin says.
        let mut missed = None;
        while let Some(event) = self.poll(now) {
            match event {
                MotionEvent::Limit { .. } => {
                    mode = StopMode::Halt;
                    missed = Some(event);
                    break;
                }
                MotionEvent::HomeFailed { .. }
                | MotionEvent::CdFailed { .. }
                | MotionEvent::StopInput { .. } => {
                    missed = Some(event);
                    break;
                }
                MotionEvent::Fault(code) => {
                    self.fault = Some(code);
                    break;
                }
                MotionEvent::Miscount { axis, .. } => {
                    // Told again when the stop is complete.
                    self.miscounts_steps[usize::from(axis.0)] = 0;
                    break;
                }
                MotionEvent::Stopped => {
                    self.phase = Phase::Stopped;
                    break;
                }
                _ => {}
            }
        }
        missed.into_iter().for_each(|event| self.tell(event));
        self.homing = None;
        self.station = false;
        self.lidar_until = None;
        self.halt_cd();
        match (self.phase, mode) {
            (Phase::Stopped, _) | (Phase::Decelerating, StopMode::Decelerate) => {}
            (Phase::Rest, _) => self.end_stop(),
            (Phase::Playing { .. }, StopMode::Decelerate) => self.decelerate(),
            (Phase::Playing { .. } | Phase::Decelerating, StopMode::Halt) => {
                self.halt_backend();
                self.end_stop();
            }
        }
    }

    /// Halts the channels. What comes next may begin with a turn, and the last step's direction has
    /// to be held before it.
    fn halt_backend(&mut self) {
        let timing = &self.timing[..self.axis_count];
        let hold_ticks = timing.iter().map(|axis| axis.hold_ticks).max();
        self.quiet_at = self.backend.halt(self.now).plus(hold_ticks.unwrap_or(0));
    }

    /// After [`MotionEvent::Stopped`]: the next queue begins, its counters at 0.
    pub fn begin_queue(&mut self) {
        self.accepted_commands = 0;
        self.executed_commands = 0;
        self.expected_commands = 0;
        self.extended_commands = 0;
    }

    /// Takes what has ended by `self.now`.
    fn pass_marks(&mut self) -> Option<MotionEvent> {
        while let Some(mark) = self.marks.front()
            && mark.end <= self.now
        {
            let what = mark.what;
            self.marks.pop();
            self.ring.pop();
            self.executed_commands += 1;
            match what {
                What::Moves(_) | What::Path(_) | What::Rest => {}
                What::Origin {
                    axis, origin_steps, ..
                } => {
                    self.origins_steps[usize::from(axis.0)] = origin_steps;
                }
                What::Laser { power_percent } => {
                    if let Some(event) = self.set_laser(power_percent) {
                        return Some(event);
                    }
                }
                What::Lidar => return Some(MotionEvent::LidarRequest),
                What::StatusCd => return Some(MotionEvent::StatusCd),
            }
        }
        None
    }

    /// Returns when the channels must be started for an armed barrier.
    fn alarm(&self) -> Option<Ticks> {
        match self.barrier {
            Barrier::Armed { start_at } => Some(Ticks(start_at.0.saturating_sub(ALARM_TICKS))),
            Barrier::Open | Barrier::Waiting => None,
        }
    }

    /// Waits at a barrier, or goes on.
    fn pass_barrier(&mut self) -> Option<MotionEvent> {
        let at_barrier = self.phase == Phase::Rest
            && self.marks.front().is_none()
            && matches!(self.ring.peek(), Some(Command::Barrier { .. }));
        if !at_barrier {
            return None;
        }
        let command = self.executed_commands;
        match self.barrier {
            Barrier::Open => {
                self.barrier = Barrier::Waiting;
                self.withhold_laser();
                // So that none of them delays the start.
                self.enables.wants_motion(AxisSet::QUEUE, self.now);
                Some(MotionEvent::AtBarrier { command })
            }
            Barrier::Waiting => None,
            Barrier::Armed { .. } if self.alarm() > Some(self.now) => None,
            Barrier::Armed { start_at }
                if self.now.max(self.quiet_at).plus(self.lead_ticks) > start_at =>
            {
                self.barrier = Barrier::Waiting;
                Some(MotionEvent::BarrierMissed { command })
            }
            Barrier::Armed { start_at } => {
                self.ring.advance();
                self.marks.push(Mark {
                    end: start_at,
                    what: What::Rest,
                });
                self.barrier = Barrier::Open;
                self.resume_at = start_at;
                self.start = Some(Start {
                    command,
                    start_at,
                    first_edge_at: None,
                });
                None
            }
        }
    }

    /// Tells when the first edge behind a barrier has left.
    fn pass_start(&mut self) -> Option<MotionEvent> {
        let start = self.start?;
        let nothing_steps = self.phase == Phase::Rest
            && self.marks.front().is_none()
            && self
                .ring
                .peek()
                .is_none_or(|next| matches!(next, Command::Barrier { .. }));
        let first_edge_at = match start.first_edge_at {
            Some(at) => at,
            None if nothing_steps => start.start_at,
            None => return None,
        };
        if first_edge_at > self.now {
            return None;
        }
        self.start = None;
        Some(MotionEvent::Started {
            command: start.command,
            first_edge_at,
        })
    }

    /// Notices that the channels have come to rest.
    fn pass_phase(&mut self) -> Option<MotionEvent> {
        match self.phase {
            // A drive that was ended before it began, or while it was held.
            Phase::Rest if matches!(self.hold, Hold::None) => self.pass_drive(),
            Phase::Rest => None,
            Phase::Stopped => {
                self.phase = Phase::Rest;
                Some(MotionEvent::Stopped)
            }
            Phase::Decelerating if self.backend.is_playing() => None,
            Phase::Decelerating => {
                self.settle_axes();
                self.end_stop();
                self.phase = Phase::Rest;
                Some(MotionEvent::Stopped)
            }
            Phase::Playing { timeline } => {
                if self.now < rest_from(timeline) || self.backend.is_playing() {
                    return None;
                }
                self.settle_axes();
                self.phase = Phase::Rest;
                self.rest_enables();
                if self.planner.is_unfinished() {
                    // The axes stood still in the middle of a path. Nothing goes on from there by
                    // itself.
                    self.fault = Some(FaultCode::PLAN_LATE);
                }
                self.planner.rest();
                match self.hold {
                    Hold::None if self.drive.is_some() => return self.pass_drive(),
                    Hold::None => {}
                    Hold::Slowing | Hold::At(_) => return Some(MotionEvent::Held),
                    Hold::Resuming(_) => return None,
                }
                let waits = self.ring.peek();
                let waits = waits.is_some_and(|next| self.waits_for_rest(&next));
                if self.executed_commands < self.expected_commands && !waits {
                    self.withhold_laser();
                    Some(MotionEvent::Underrun)
                } else {
                    Some(MotionEvent::Rest)
                }
            }
        }
    }

    /// Compares the ledger with the counters after the axes have come to rest. A difference is told
    /// once.
    fn check_counters(&mut self) -> Option<MotionEvent> {
        while self.unchecked_axes > 0 {
            self.unchecked_axes -= 1;
            let index = self.unchecked_axes;
            let axis = AxisId(index as u8);
            let ledger_steps = self.backend.played_steps(axis);
            let counted_steps = self.backend.counted_steps(axis).unwrap_or(ledger_steps);
            let miscount = counted_steps - ledger_steps;
            if mem::replace(&mut self.miscounts_steps[index], miscount) != miscount {
                // Nobody knows where the axis is.
                self.frames_steps[index] = None;
                return Some(MotionEvent::Miscount {
                    axis,
                    ledger_steps,
                    counted_steps,
                });
            }
        }
        None
    }

    /// All channels have ended by themselves.
    fn settle_axes(&mut self) {
        self.unchecked_axes = self.axis_count;
        for axis in 0..self.axis_count {
            let played = self.backend.played_steps(AxisId(axis as u8));
            self.backend.axes()[axis].halt(played);
        }
    }

    /// Begins a controlled stop: on its path, by its own law, where a ramp or a line is under way;
    /// else each axis by itself.
    fn decelerate(&mut self) {
        self.planner.hold(true);
        if self.is_drive_ending() || self.change_path().is_some() {
            self.phase = Phase::Decelerating;
            self.note_speeds();
            return;
        }
        self.ring.clear();
        self.planner.forget();
        let mut cut_ticks = u64::MAX;
        for axis in &mut self.backend.axes()[..self.axis_count] {
            cut_ticks = cut_ticks.min(axis.encoded_ticks());
            axis.decelerate();
        }
        // Up to there every axis plays what was planned.
        let cut = self.started_at.plus(cut_ticks);
        self.marks.cut(cut);
        self.phase = Phase::Decelerating;
        self.note_speeds();
    }

    fn note_speeds(&mut self) {
        let axes = &self.backend.axes()[..self.axis_count];
        for (to, axis) in self.encoded_mhz.iter_mut().zip(axes) {
            let speed_mhz = axis.speed_mhz();
            *to = match i32::try_from(speed_mhz) {
                Ok(speed_mhz) => speed_mhz,
                Err(_) if speed_mhz < 0 => i32::MIN,
                Err(_) => i32::MAX,
            };
        }
    }

    fn end_stop(&mut self) {
        self.unchecked_axes = self.axis_count;
        self.marks.cut(self.now);
        self.pass_marks_silently();
        self.ring.clear();
        self.planner.forget();
        self.hold = Hold::None;
        self.change_due = false;
        self.drive = None;
        self.homing = None;
        self.laser = Laser::default();
        self.rest_enables();
        self.limit_told = false;
        self.headings = [None; CHANNELS];
        for axis in 0..self.axis_count {
            self.planned_steps[axis] = self.backend.played_steps(AxisId(axis as u8));
        }
        self.planned_origins_steps = self.origins_steps;
        self.phase = Phase::Stopped;
        self.barrier = Barrier::Open;
        self.start = None;
        self.resume_at = Ticks(0);
    }

    fn pass_marks_silently(&mut self) {
        while self.pass_marks().is_some() {}
    }

    fn is_stopping(&self) -> bool {
        matches!(self.phase, Phase::Decelerating | Phase::Stopped)
    }

    /// Plans as much as fits.
    fn plan(&mut self) {
        if self.phase == Phase::Stopped {
            return;
        }
        self.pass_change();
        self.change_drive();
        self.extend_path();
        if self.phase != Phase::Rest {
            let axes = &self.backend.axes()[..self.axis_count];
            let encoded = axes.iter().map(Axis::encoded_ticks).min().unwrap_or(0);
            self.planner.retire(self.started_at.0 + encoded);
        }
        let mut starts_at = None;
        let mut lead_ticks = self.lead_ticks;
        while self
            .planner
            .write(&mut self.backend.axes()[..self.axis_count])
            && self.planner.has_room()
        {
            if self.phase == Phase::Decelerating && !self.planner.is_at_speed() {
                break;
            }
            if let Hold::Resuming(split) = self.hold {
                if self.phase != Phase::Rest || !self.are_enabled(AxisSet::QUEUE, lead_ticks) {
                    break;
                }
                let at = self.now.max(self.quiet_at);
                starts_at = Some(at);
                self.hold = Hold::None;
                let own = self.marks.take_back(self.now);
                let at = Moment::of(at.plus(lead_ticks).0);
                if let Some(own) = own {
                    self.undo_steps(own);
                }
                self.go_on(Split { at, ..split }, own);
                continue;
            }
            if let Some(Drive {
                axis, next, due, ..
            }) = self.drive
            {
                let begins = (!due || self.phase == Phase::Rest) && !self.is_held();
                let Some(leg) = next.filter(|_| begins) else {
                    break;
                };
                let appends = self.can_append(starts_at.is_some());
                let enabled =
                    self.phase != Phase::Rest || self.are_enabled(AxisSet::QUEUE, lead_ticks);
                let begin = match self.phase {
                    _ if !enabled => break,
                    Phase::Playing { timeline } if appends => timeline,
                    Phase::Rest => {
                        let at = self.now.max(self.quiet_at);
                        starts_at = Some(at);
                        at.plus(lead_ticks)
                    }
                    _ => break,
                };
                self.drive = Some(Drive {
                    axis,
                    next: None,
                    due: false,
                    ending: false,
                });
                self.begin_leg(axis, leg, begin);
                continue;
            }
            let Some(command) = self.ring.peek() else {
                break;
            };
            if self.marks.is_full()
                || self.waits_for_rest(&command)
                || self.refuse_blocked(&command)
            {
                break;
            }
            if self.is_held() && !self.planner.is_at_speed() {
                break;
            }
            let line = self.line_of(&command);
            if self.phase == Phase::Decelerating && line.is_none() {
                // It takes no time; what it would do is over.
                self.ring.advance();
                continue;
            }
            let takes_time = line.is_some() || ticks_of(&command).is_some_and(|ticks| ticks > 0);
            let enabled = self.phase != Phase::Rest || !takes_time || {
                let lead_ticks = self.resume_at.0.saturating_sub(self.now.0).max(lead_ticks);
                self.are_enabled(AxisSet::QUEUE, lead_ticks)
            };
            let begin = match self.phase {
                Phase::Stopped => break,
                Phase::Decelerating => Ticks(0),
                Phase::Playing { timeline }
                    if matches!(command, Command::Line { .. })
                        && starts_at.is_none()
                        && timeline > self.now.plus(PATH_AHEAD_TICKS) =>
                {
                    break;
                }
                Phase::Playing { timeline } => {
                    if takes_time && !self.can_append(starts_at.is_some()) {
                        break;
                    }
                    timeline
                }
                Phase::Rest if takes_time && !enabled => break,
                Phase::Rest if takes_time => {
                    let at = self.now.max(self.quiet_at);
                    lead_ticks = self.resume_at.0.saturating_sub(at.0).max(self.lead_ticks);
                    starts_at = Some(at);
                    at.plus(lead_ticks)
                }
                Phase::Rest => self.now.max(self.resume_at),
            };
            let mut first_edge_at = None;
            if let Some((line, jump_steps)) = line {
                let begun = self.begin_line(line, jump_steps, begin);
                first_edge_at = begun.first_edge_ticks.map(Ticks);
                self.ring.advance();
                if self.phase == Phase::Decelerating {
                    continue;
                }
                for (planned, steps) in self.planned_steps.iter_mut().zip(line.steps) {
                    *planned += steps;
                }
                self.note_path(&begun, Some(What::Path(line.steps)));
            } else {
                let mut end = begin;
                if takes_time {
                    let axes = &mut self.backend.axes()[..self.axis_count];
                    end = begin.plus(self.planner.plan(&command, axes));
                    self.phase = Phase::Playing { timeline: end };
                }
                let mut runs = runs_of(&command);
                let runs = [runs.next(), runs.next()];
                if runs[0].is_some() {
                    first_edge_at = Some(Ticks(end.0 - command_ticks(&runs)));
                }
                self.ring.advance();
                self.note(&command, runs, end);
            }
            if let Some(start) = self.start.as_mut()
                && start.first_edge_at.is_none()
            {
                start.first_edge_at = first_edge_at;
            }
        }
        if let Some(at) = starts_at {
            self.started_at = at;
            self.backend.start(at, lead_ticks);
            if self.drive.is_none() {
                self.give_laser_back();
            }
        }
    }

    /// Returns whether a command begins only when all before it has ended.
    fn waits_for_rest(&self, command: &Command) -> bool {
        match command {
            Command::Barrier { .. }
            | Command::Home { .. }
            | Command::MoveC { .. }
            | Command::MoveD { .. } => true,
            Command::LidarRead => self.lidar_wait_ticks.is_some(),
            _ => false,
        }
    }

    /// Returns the way of a ramp or a line and how many steps of its ramp it jumps over; `None`
    /// for other commands and where there is no way to go.
    fn line_of(&self, command: &Command) -> Option<(Line, u16)> {
        self.line_from(command, &self.planned_steps, &self.planned_origins_steps)
    }

    /// The same from these steps since boot and origins.
    fn line_from(
        &self,
        command: &Command,
        from_steps: &[i64; CHANNELS],
        origins_steps: &[i64; CHANNELS],
    ) -> Option<(Line, u16)> {
        let ramp = |axis: AxisId, steps: i64, ramp: Ramp| {
            if steps == 0 {
                return None;
            }
            let mut all = [0; CHANNELS];
            all[usize::from(axis.0)] = steps;
            let jump_steps = match ramp.shape {
                RampShape::Trapezoid { jump_steps, .. } => jump_steps,
                RampShape::Jerk { .. } => 0,
            };
            let speed = speed_from_hz(ramp.speed_hz);
            let line = Line {
                joins: false,
                ..Line::new(all, speed, ramp.accel_hz_per_s, ramp.shape)
            };
            Some((line, jump_steps))
        };
        match *command {
            Command::Ramp {
                axis,
                steps,
                ramp: how,
            } => ramp(axis, i64::from(steps), how),
            Command::RampTo {
                axis,
                position_steps,
                ramp: how,
            } => {
                let index = usize::from(axis.0);
                let here = origins_steps[index].wrapping_add(from_steps[index]);
                let way = i128::from(position_steps) - i128::from(here);
                let way = way.clamp(-WAY_STEPS_MAX, WAY_STEPS_MAX);
                ramp(axis, way as i64, how)
            }
            _ => Line::of(command).map(|line| (line, 0)),
        }
    }

    fn begin_line(&mut self, line: Line, jump_steps: u16, begin: Ticks) -> Begun {
        let ring = &self.ring;
        let behind = lines_behind(ring, 1, self.lidar_wait_ticks.is_some());
        let axes = &self.backend.axes()[..self.axis_count];
        let base_steps = self.planned_steps;
        self.planner
            .begin(line, jump_steps, behind, begin.0, base_steps, axes)
    }

    /// Returns whether every axis can take one more command. An axis that has ended cannot go on,
    /// and then none does: all rest, and start anew together.
    fn can_append(&mut self, before_start: bool) -> bool {
        let axes = &self.backend.axes()[..self.axis_count];
        axes.iter()
            .all(|axis| axis.has_room() && (before_start || !axis.has_ended()))
    }

    /// Notes what ends when, of what is no path.
    fn note(&mut self, command: &Command, runs: [Option<Run>; 2], end: Ticks) {
        let what = match *command {
            Command::Laser { power_percent } => What::Laser { power_percent },
            Command::LidarRead => What::Lidar,
            Command::StatusCd => What::StatusCd,
            Command::SetPosition {
                axis,
                position_steps,
            } => {
                let index = usize::from(axis.0);
                let before_steps = self.planned_origins_steps[index];
                // A position is a place on a ring of 2⁶⁴ steps.
                let origin_steps = position_steps.wrapping_sub(self.planned_steps[index]);
                self.planned_origins_steps[index] = origin_steps;
                What::Origin {
                    axis,
                    origin_steps,
                    before_steps,
                }
            }
            _ if runs[0].is_some() => What::Moves(runs),
            _ => What::Rest,
        };
        for run in runs.into_iter().flatten() {
            self.planned_steps[usize::from(run.axis.0)] += i64::from(run.steps);
        }
        self.marks.push(Mark { end, what });
    }
}

/// Longest way of one ramp: 4·10¹⁸ steps, 630,000 years at 200 kHz.
const WAY_STEPS_MAX: i128 = 1 << 62;

/// Commands behind a line that are looked at: [`LINES_MAX`] lines and as many between them that
/// take no time.
const LOOK_COMMANDS_MAX: usize = 2 * LINES_MAX;

/// Returns the commands for lines that follow behind so many commands. What takes no time does not end
/// a path, but for a reading that is waited for.
fn lines_behind<'r>(
    ring: &'r CommandRing<'_>,
    count: usize,
    lidar_waits: bool,
) -> impl Iterator<Item = Command> + use<'r> {
    let all = (count..).map_while(|index| ring.peek_at(index));
    all.take(LOOK_COMMANDS_MAX)
        .take_while(move |next| !(lidar_waits && matches!(next, Command::LidarRead)))
        .filter(|next| !takes_no_time(next))
        .take_while(|next| matches!(next, Command::Line { .. }))
}

fn takes_no_time(command: &Command) -> bool {
    matches!(
        command,
        Command::Laser { .. }
            | Command::LidarRead
            | Command::SetPosition { .. }
            | Command::StatusCd
    )
}

/// Returns when the channels are surely quiet after the end of a timeline: the last step's hold
/// time and the start skew.
const fn rest_from(timeline: Ticks) -> Ticks {
    timeline.plus(HOLD_TICKS_MAX)
}

/// Returns how long the longer of the runs takes, ticks.
fn command_ticks(runs: &[Option<Run>; 2]) -> u64 {
    let ticks = runs.iter().flatten().filter_map(Run::ticks);
    ticks.max().unwrap_or(0)
}
