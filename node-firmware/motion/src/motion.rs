//! [`Motion`]: the ring, the planner, the axes and what ends when, behind one door.

mod change;
mod check;
mod config;
mod course;
mod drive;
mod event;
mod gait;
mod homing;
mod inputs;
mod legs;
mod marks;
mod named;
mod outputs;
mod pass;
mod plan;
mod plans;
mod reach;
mod stand;
mod stop;
mod turns;
mod watch;

pub use check::CommandError;
pub use config::{ConfigError, MotionConfig, ShiftConfig};
pub use course::{Course, DriveError, Target};
pub use event::{LimitHit, MotionEvent};
pub use gait::Gait;
pub use named::{CdError, ConfigCd};
pub use plans::{PlanMemory, Plans};
pub use reach::{Beyond, Outlook, SoftLimits};

use drive::Drive;
use homing::Homing;
use marks::{Marks, What};
use named::Cd;
use outputs::{Laser, Shift};
use turns::Turns;
use watch::Watch;

use crate::{
    CommandRing, Direction, Full, Reservation, StepBackend, Ticks,
    io::{
        enable::Enables,
        home::{HomeConfig, Switches},
        input::{Inputs, Role, Switch},
    },
    limits::{CHANNELS, HOLD_TICKS_MAX, TICK_HZ, TICKS_PER_US},
    planner::{Planner, Split, command_ticks},
    profile::Timing,
};
use keys::{AxisId, Command, Features, status::FaultCode};

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
    /// It slows down, or nothing is under way.
    Slowing,
    /// It rests or will, here.
    At(Place),
    /// It goes on from here.
    Resuming(Place),
}

/// Where motion is held.
#[derive(Clone, Copy, Debug)]
#[expect(
    clippy::large_enum_variant,
    reason = "there is one, and nothing is allocated"
)]
enum Place {
    /// Within this line.
    Path(Split),
    /// So long before the end of a raw move or a pause.
    Raw { left_ticks: u64 },
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
    planner: &'m mut Planner,
    marks: &'m mut Marks,
    phase: Phase,
    barrier: Barrier,
    start: Option<Start>,
    watch: Option<Watch>,
    hold: Hold,
    /// A change in flight has not been made yet.
    change_due: bool,
    /// Since a hold nothing was planned to go on with: to run dry is what it asked for.
    dry_by_hold: bool,
    /// How many commands there were when the end of the path was looked at.
    extended_commands: u64,
    drives: &'m mut [Option<Drive>; CHANNELS],
    homing: Option<Homing>,
    cd: Option<Cd>,
    laser: Laser,
    /// How long a reading is waited for, and until when it is now.
    lidar_wait_ticks: Option<u64>,
    lidar_until: Option<Ticks>,
    enables: Enables,
    shift: Option<Shift>,
    turns: Turns,
    /// When the drivers that were switched on let the queue begin.
    enabled_at: Option<Ticks>,
    /// It waits for them.
    waits_enable: bool,
    /// A command that waits for rest runs: homing, C or D.
    station: bool,
    homes: [Option<HomeConfig>; CHANNELS],
    /// Position = frame + played steps, as it was when the axis was homed, whatever was renamed
    /// since; `None`: it is not homed.
    frames_steps: [Option<i64>; CHANNELS],
    soft_limits: [Option<SoftLimits>; CHANNELS],
    inputs: &'m mut Inputs,
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
    /// Takes the ring, memory for plans and the hardware; all axes rest at position 0. The back
    /// end's axes become those of `config`.
    ///
    /// # Panics
    /// [`MotionConfig::check`] finds something wrong, or the back end has fewer axes.
    pub fn new(
        ring: CommandRing<'m>,
        plans: Plans<'m>,
        mut backend: B,
        config: MotionConfig,
    ) -> Self {
        let Plans {
            planner,
            marks,
            drives,
            inputs,
        } = plans;
        planner.reset();
        marks.clear();
        drives.fill(None);
        if let Err(error) = config.check() {
            panic!("{error}");
        }
        assert!(
            backend.axes().len() >= config.axis_count,
            "the back end has fewer channels than axes"
        );
        let start_ticks = backend.start_ticks();
        for (axis, profile) in backend.axes().iter_mut().zip(config.axes) {
            axis.reset(profile);
        }
        let timing = config.axes.map(Timing::from);
        let lead_ticks = timing[..config.axis_count].iter().map(Timing::turn_ticks);
        let is_high = |index: usize| config.input_levels >> index & 1 != 0;
        inputs.reset(&config.inputs, is_high, Ticks(0));
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
            planner,
            marks,
            phase: Phase::Rest,
            barrier: Barrier::Open,
            start: None,
            watch: None,
            hold: Hold::None,
            change_due: false,
            dry_by_hold: false,
            extended_commands: 0,
            drives,
            homing: None,
            cd,
            laser: Laser::default(),
            lidar_wait_ticks: config
                .lidar_wait_ms
                .map(|ms| u64::from(ms) * 1_000 * TICKS_PER_US),
            lidar_until: None,
            enables,
            shift: config.shift.map(Shift::new),
            turns: Turns::new(|axis| {
                let shift = config.shift;
                shift.is_some_and(|shift| shift.direction_pin_of(axis).is_some())
            }),
            enabled_at: None,
            waits_enable: false,
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

    /// Ends, and gives the memory for plans back.
    pub fn into_plans(self) -> Plans<'m> {
        Plans {
            planner: self.planner,
            marks: self.marks,
            drives: self.drives,
            inputs: self.inputs,
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
            .with(Features::SMOOTH)
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
            || self.is_driving()
            || matches!(self.phase, Phase::Decelerating | Phase::Stopped)
    }

    /// Returns whether the queue rests at a barrier, told by [`MotionEvent::AtBarrier`].
    pub fn is_at_barrier(&self) -> bool {
        self.barrier != Barrier::Open
    }

    /// Returns the oldest command that is not planned: at a barrier, the barrier.
    pub fn waiting_command(&self) -> Option<Command> {
        self.ring.peek()
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
        if self.phase == Phase::Decelerating || self.is_driving() {
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
            if let Some(event) = self.pass_enables(now) {
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
}

/// A hold that could not be made is tried again after this: 1 ms.
const CHANGE_AGAIN_TICKS: u64 = 1_000 * TICKS_PER_US;

/// Returns when the channels are surely quiet after the end of a timeline: the last step's hold
/// time and the start skew.
const fn rest_from(timeline: Ticks) -> Ticks {
    timeline.plus(HOLD_TICKS_MAX)
}
