//! The functions that a script can call, one by one. `stepfleet.lua` beside this crate says the same
//! to an editor, and a test compares the two.

use crate::{
    engine::Office,
    ffi::{Answer, Call, Calls, Function, REPLIES_MAX, Reply, Value},
    host::{Full, Host},
};
use alloc::{format, string::String, vec::Vec};
use core::fmt::Write;
use keys::{
    AxisId, Command, LocalMicros, NodeState,
    command::{LINE_AXES, POSITION_C_MAX, Ramp, RampShape},
    start::{BARRIER_BYTES_MAX, BarrierName},
};
use motion::{Course, Direction, DriveError, Target};

/// What a script waits for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Wait {
    /// Nothing: it has used up its slice.
    Slice,
    /// Room in the queue.
    Room,
    /// A time.
    Until(LocalMicros),
    /// The end of everything in the queue.
    Idle,
    /// A lidar reading.
    Lidar {
        /// How many readings there were when it was asked for.
        count: u32,
        /// Number of the request in the queue, plus one.
        command: u64,
        /// The latest time for it, once the request has left.
        until: Option<LocalMicros>,
    },
    /// Room for another message.
    Publish,
}

impl Wait {
    /// Returns whether it is over.
    pub(crate) fn is_over(self, host: &dyn Host) -> bool {
        match self {
            Self::Slice | Self::Publish => true,
            Self::Room => host.credit_commands() > 0,
            Self::Until(until) => host.now() >= until,
            Self::Idle => !host.is_active() && host.executed_commands() >= host.accepted_commands(),
            Self::Lidar {
                count,
                command,
                until,
            } => {
                host.lidar().count != count
                    || match until {
                        None => host.executed_commands() >= command,
                        Some(until) => host.now() >= until,
                    }
            }
        }
    }
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Do {
    QueueMove,
    QueueSyncMove,
    QueuePause,
    QueueRamp,
    QueueRampTo,
    QueueSmoothRamp,
    QueueSmoothRampTo,
    QueueLine,
    QueueSetPosition,
    QueueHome,
    QueueMoveC,
    QueueMoveD,
    QueueStatusCd,
    QueueBarrier,
    Execute,
    EmergencyStop,
    IsBusy,
    IsDone,
    GetPosition,
    GetSpeed,
    GetQueueDepth,
    Hold,
    Resume,
    SetSpeedPercent,
    DriveTo,
    DriveBy,
    Run,
    EndDrive,
    IsDriven,
    LaserSetPower,
    LidarRead,
    InputRead,
    NowUs,
    NowMs,
    Status,
    Publish,
    CallStored,
    Sleep,
    WaitIdle,
}

const COUNT: usize = 39;

macro_rules! functions {
    ($(($module:literal, $name:literal, $shape:literal, $what:ident),)*) => {
        /// What C gets.
        pub(crate) static FUNCTIONS: [Function; COUNT] = [$(Function::new($module, $name, $shape),)*];
        const WHAT: [Do; COUNT] = [$(Do::$what,)*];
        /// Every function of the API: module (empty: a global), and name.
        pub const NAMES: [(&str, &str); COUNT] = [$((text($module), text($name)),)*];
    };
}

const fn text(text: &'static core::ffi::CStr) -> &'static str {
    match text.to_str() {
        Ok(text) => text,
        Err(_) => panic!("ASCII"),
    }
}

functions! {
    (c"motor", c"queue_move", c"vvv", QueueMove),
    (c"motor", c"queue_sync_move", c"vvvv", QueueSyncMove),
    (c"motor", c"queue_pause", c"v", QueuePause),
    (c"motor", c"queue_ramp", c"vvvvr", QueueRamp),
    (c"motor", c"queue_ramp_to", c"vvvvr", QueueRampTo),
    (c"motor", c"queue_smooth_ramp", c"vvvvv", QueueSmoothRamp),
    (c"motor", c"queue_smooth_ramp_to", c"vvvvv", QueueSmoothRampTo),
    (c"motor", c"queue_line", c"lvvv", QueueLine),
    (c"motor", c"queue_set_position", c"vv", QueueSetPosition),
    (c"motor", c"queue_home", c"v", QueueHome),
    (c"motor", c"queue_move_c", c"v", QueueMoveC),
    (c"motor", c"queue_move_d", c"v", QueueMoveD),
    (c"motor", c"queue_status_cd", c"", QueueStatusCd),
    (c"motor", c"queue_barrier", c"v", QueueBarrier),
    (c"motor", c"execute", c"", Execute),
    (c"motor", c"emergency_stop", c"", EmergencyStop),
    (c"motor", c"is_busy", c"", IsBusy),
    (c"motor", c"is_done", c"v", IsDone),
    (c"motor", c"get_position", c"v", GetPosition),
    (c"motor", c"get_speed", c"v", GetSpeed),
    (c"motor", c"get_queue_depth", c"", GetQueueDepth),
    (c"motor", c"hold", c"", Hold),
    (c"motor", c"resume", c"", Resume),
    (c"motor", c"set_speed_percent", c"v", SetSpeedPercent),
    (c"motor", c"drive_to", c"vvvvr", DriveTo),
    (c"motor", c"drive_by", c"vvvvr", DriveBy),
    (c"motor", c"run", c"vvvvr", Run),
    (c"motor", c"end_drive", c"v", EndDrive),
    (c"motor", c"is_driven", c"v", IsDriven),
    (c"laser", c"set_power", c"v", LaserSetPower),
    (c"lidar", c"read", c"v", LidarRead),
    (c"input", c"read", c"v", InputRead),
    (c"node", c"now_us", c"", NowUs),
    (c"node", c"now_ms", c"", NowMs),
    (c"node", c"status", c"", Status),
    (c"node", c"publish", c"vt", Publish),
    (c"node", c"call", c"vv", CallStored),
    (c"", c"sleep", c"v", Sleep),
    (c"", c"wait_idle", c"", WaitIdle),
}

/// Longest name that `node.publish` takes.
const SUFFIX_BYTES_MAX: usize = 32;

/// Longest sleep and pause, ms: a day.
const MS_MAX: i64 = 86_400_000;

/// How long `lidar.read` waits for the sensor when nothing is said, ms.
const LIDAR_MS_DEFAULT: i64 = 1_000;

/// When a drive that could not begin is tried again.
const BUSY_US: u64 = 1_000;

/// What looking at the node costs beyond its own instruction, so that a loop that only looks
/// leaves the processor to others.
const LOOK_INSTRUCTIONS: u32 = 200;

/// What a script has done and waits for: its half of the border to the node.
#[derive(Debug)]
pub(crate) struct Doings {
    /// Queued and not executed yet. Never more than fit into the queue.
    staged: Vec<Command>,
    /// Commands that were queued since the script began.
    queued_count: u64,
    /// Number in the node's queue of the script's first command.
    first_command: u64,
    /// Barriers among them.
    barrier_count: u16,
    pub(crate) wait: Option<Wait>,
    text: String,
    pub(crate) stored: Vec<u8>,
    cost: u32,
    /// The script did something that a runaway does not do.
    pub(crate) lives: bool,
    pub(crate) stopped: bool,
}

impl Doings {
    pub(crate) const fn new(first_command: u64) -> Self {
        Self {
            staged: Vec::new(),
            queued_count: 0,
            first_command,
            barrier_count: 0,
            wait: None,
            text: String::new(),
            stored: Vec::new(),
            cost: 0,
            lives: false,
            stopped: false,
        }
    }

    /// Returns how many commands are queued and not executed.
    pub(crate) fn staged_count(&self) -> usize {
        self.staged.len()
    }

    /// Gives what is queued to the node.
    pub(crate) fn execute(&mut self, host: &mut dyn Host) {
        if !self.staged.is_empty() {
            host.push(&self.staged);
            self.staged.clear();
            self.lives = true;
        }
    }
}

/// Why an argument is wrong: what it must be instead.
type Wrong = String;

/// [`Doings`] with the node, for one step.
pub(crate) struct Turn<'a> {
    pub(crate) doings: &'a mut Doings,
    pub(crate) host: &'a mut dyn Host,
}

impl Calls for Turn<'_> {
    fn call(&mut self, call: Call<'_>) -> Answer {
        let again = self.doings.wait.take().filter(|_| call.again);
        match self.carry_out(&call, again) {
            Ok(answer) => answer,
            Err(wrong) => {
                self.doings.text = wrong;
                Answer::Error
            }
        }
    }

    fn field(&mut self, _: usize, index: usize) -> Option<[Option<Reply>; REPLIES_MAX]> {
        let pair = |name, value| Some([Some(Reply::Word(name)), Some(value), None]);
        let host = &*self.host;
        match index {
            0 => pair("state", Reply::Word(word_of(host.state()))),
            1 => pair("busy", Reply::Boolean(self.is_busy())),
            2 => pair("queue_depth", Reply::Wide(self.depth())),
            3 => pair(
                "queue_free",
                wide(host.credit_commands() - self.doings.staged.len()),
            ),
            4 => pair("laser_percent", Reply::Integer(host.laser_percent().into())),
            5 => pair(
                "lidar_mm",
                host.lidar()
                    .mm
                    .map_or(Reply::Nil, |mm| Reply::Wide(mm.into())),
            ),
            6 => pair("now_ms", Reply::Integer((host.now().0 / 1000) as i32)),
            index => {
                let axis = index - 7;
                (axis < host.axis_count()).then(|| {
                    let position = host.position_steps(AxisId(axis as u8));
                    [
                        Some(Reply::Word("position")),
                        Some(Reply::Integer(axis as i32)),
                        Some(Reply::Wide(position)),
                    ]
                })
            }
        }
    }

    fn text(&self) -> &[u8] {
        if self.doings.stored.is_empty() {
            self.doings.text.as_bytes()
        } else {
            &self.doings.stored
        }
    }

    fn print(&mut self, line: &[u8]) {
        self.host.print(&String::from_utf8_lossy(line));
    }

    fn take_cost(&mut self) -> u32 {
        core::mem::take(&mut self.doings.cost)
    }

    fn is_ended(&self) -> bool {
        self.doings.stopped
    }
}

impl Office for Turn<'_> {
    fn is_due(&mut self, wait: Wait, _: LocalMicros) -> bool {
        wait.is_over(self.host)
    }

    fn wait(&self) -> Option<Wait> {
        self.doings.wait
    }

    fn take_lives(&mut self) -> bool {
        core::mem::take(&mut self.doings.lives)
    }

    fn execute(&mut self) {
        self.doings.execute(self.host);
    }
}

fn wide(value: usize) -> Reply {
    Reply::Wide(i64::try_from(value).unwrap_or(i64::MAX))
}

fn returns(reply: Reply) -> Answer {
    Answer::Return([Some(reply), None, None])
}

const NOTHING: Answer = Answer::Return([None; REPLIES_MAX]);

fn word_of(state: NodeState) -> &'static str {
    match state {
        NodeState::Idle => "idle",
        NodeState::Ready => "ready",
        NodeState::Running => "running",
        NodeState::Paused => "paused",
        NodeState::Stopped => "stopped",
        NodeState::Fault => "fault",
    }
}

impl Turn<'_> {
    fn carry_out(&mut self, call: &Call<'_>, again: Option<Wait>) -> Result<Answer, Wrong> {
        let args = Args(call.args);
        self.doings.stored.clear();
        match WHAT[call.function] {
            Do::QueueMove => {
                let axis = self.axis(&args)?;
                let delay_us = args.positive(1, "delay_us")?;
                let steps = args.steps(2, "steps")?;
                self.queue(Command::Move {
                    axis,
                    delay_us,
                    steps,
                })
            }
            Do::QueueSyncMove => {
                let delay_us = [args.positive(0, "delay1")?, args.positive(2, "delay2")?];
                let steps = [args.steps(1, "steps1")?, args.steps(3, "steps2")?];
                self.queue(Command::SyncMove { delay_us, steps })
            }
            Do::QueuePause => {
                let pause_ms = args.whole(0, "ms", 0, MS_MAX)? as u32;
                self.queue(Command::Pause { pause_ms })
            }
            Do::QueueRamp => {
                let axis = self.axis(&args)?;
                let steps = args.steps(1, "steps")?;
                let ramp = args.ramp()?;
                self.queue(Command::Ramp { axis, steps, ramp })
            }
            Do::QueueRampTo => {
                let axis = self.axis(&args)?;
                let position_steps = args.any(1, "position")?;
                let ramp = args.ramp()?;
                self.queue(Command::RampTo {
                    axis,
                    position_steps,
                    ramp,
                })
            }
            Do::QueueSmoothRamp => {
                let axis = self.axis(&args)?;
                let steps = args.steps(1, "steps")?;
                let ramp = args.smooth_ramp()?;
                self.queue(Command::Ramp { axis, steps, ramp })
            }
            Do::QueueSmoothRampTo => {
                let axis = self.axis(&args)?;
                let position_steps = args.any(1, "position")?;
                let ramp = args.smooth_ramp()?;
                self.queue(Command::RampTo {
                    axis,
                    position_steps,
                    ramp,
                })
            }
            Do::QueueLine => {
                let mut steps = [0; LINE_AXES];
                for (index, to) in steps.iter_mut().enumerate() {
                    if index == 0 || call.args[index] != Value::Nil {
                        *to = args.any(index, "steps")? as i32;
                    }
                }
                let speed_hz = args.positive(4, "speed_hz")?;
                let accel_hz_per_s = args.positive(5, "accel")?;
                let jerk_hz_per_s2 = match call.args[6] {
                    Value::Nil => 0,
                    _ => args.positive(6, "jerk")?,
                };
                self.queue(Command::Line {
                    steps,
                    speed_hz,
                    accel_hz_per_s,
                    jerk_hz_per_s2,
                })
            }
            Do::QueueSetPosition => {
                let axis = self.axis(&args)?;
                let position_steps = args.any(1, "position")?;
                self.queue(Command::SetPosition {
                    axis,
                    position_steps,
                })
            }
            Do::QueueHome => {
                let axis = self.axis(&args)?;
                self.queue(Command::Home { axis })
            }
            Do::QueueMoveC => {
                let index = args.whole(0, "position", 0, POSITION_C_MAX.into())? as u8;
                self.queue(Command::MoveC { index })
            }
            Do::QueueMoveD => {
                let on = args.boolean(0, "on")?;
                self.queue(Command::MoveD { on })
            }
            Do::QueueStatusCd => self.queue(Command::StatusCd),
            Do::QueueBarrier => {
                let name = args.text(0, "name", BARRIER_BYTES_MAX)?;
                let named = BarrierName::new(name).ok_or("name: it cannot be one")?;
                let number = self.host.barrier(named);
                let number = number.map_err(|error| format!("{error}"))?;
                // A number is given before there is room, and the same one when it is tried again.
                if number < self.doings.barrier_count {
                    return Err(format!("name: the script has been at '{name}' already"));
                }
                let queued = self.queue(Command::Barrier { barrier: number })?;
                if let Answer::Return(_) = queued {
                    self.doings.barrier_count = number + 1;
                }
                Ok(queued)
            }
            Do::LaserSetPower => {
                let power_percent = args.whole(0, "power", 0, 100)? as u8;
                self.queue(Command::Laser { power_percent })
            }
            Do::Execute => {
                self.doings.execute(self.host);
                Ok(NOTHING)
            }
            Do::EmergencyStop => {
                self.doings.staged.clear();
                self.doings.stopped = true;
                self.host.emergency_stop();
                Ok(Answer::Wait)
            }
            Do::IsBusy => {
                self.look();
                Ok(returns(Reply::Boolean(self.is_busy())))
            }
            Do::IsDone => {
                let last = i64::try_from(self.doings.queued_count).unwrap_or(i64::MAX);
                let id = args.whole(0, "id", 1, last)?;
                self.look();
                let number = self.doings.first_command + id.unsigned_abs();
                let done = self.host.executed_commands() >= number;
                Ok(returns(Reply::Boolean(done)))
            }
            Do::GetPosition => {
                let axis = self.axis(&args)?;
                self.look();
                Ok(returns(Reply::Wide(self.host.position_steps(axis))))
            }
            Do::GetSpeed => {
                let axis = self.axis(&args)?;
                self.look();
                let speed_hz = self.host.speed_mhz(axis) as f32 / 1000.0;
                Ok(returns(Reply::Number(speed_hz)))
            }
            Do::GetQueueDepth => {
                self.look();
                Ok(returns(Reply::Wide(self.depth())))
            }
            Do::Hold => {
                self.host.hold();
                Ok(NOTHING)
            }
            Do::Resume => {
                self.host.resume();
                Ok(NOTHING)
            }
            Do::SetSpeedPercent => {
                let percent = args.whole(0, "percent", 1, i64::from(u16::MAX))? as u16;
                let set = self.host.set_speed_percent(percent);
                set.map_err(|error| format!("percent: {error}"))?;
                Ok(NOTHING)
            }
            Do::DriveTo => {
                let to = args.any(1, "position")?;
                self.drive(&args, Target::To(to))
            }
            Do::DriveBy => {
                let by = args.any(1, "steps")?;
                self.drive(&args, Target::By(by))
            }
            Do::Run => {
                let way = match args.whole(1, "direction", -1, 1)? {
                    0 => return Err("direction: 1 or -1, got 0".into()),
                    way => Direction::of(way),
                };
                self.drive(&args, Target::Forever(way))
            }
            Do::EndDrive => {
                let axis = match call.args[0] {
                    Value::Nil => None,
                    _ => Some(self.axis(&args)?),
                };
                self.host.end_drive(axis);
                Ok(NOTHING)
            }
            Do::IsDriven => {
                let axis = self.axis(&args)?;
                self.look();
                Ok(returns(Reply::Boolean(self.host.is_driven(axis))))
            }
            Do::LidarRead => self.read_lidar(&args, again),
            Do::InputRead => {
                let name = args.name(0, "name")?;
                self.look();
                match self.host.input(name) {
                    Some(active) => Ok(returns(Reply::Boolean(active))),
                    None => Err(format!("name: the node has no input '{name}'")),
                }
            }
            Do::NowUs => {
                self.look();
                Ok(returns(Reply::Integer(self.host.now().0 as i32)))
            }
            Do::NowMs => {
                self.look();
                Ok(returns(Reply::Integer((self.host.now().0 / 1000) as i32)))
            }
            Do::Status => {
                self.look();
                Ok(Answer::Table)
            }
            Do::Publish => {
                let suffix = args.name(0, "suffix")?;
                keys::NodeId::new(suffix).map_err(|error| format!("suffix: {error}"))?;
                let json = match &call.json {
                    Some(Ok(json)) => json,
                    Some(Err(error)) => return Err(format!("value: {error}")),
                    None => "null",
                };
                match self.host.publish(suffix, json) {
                    Ok(()) => Ok(NOTHING),
                    Err(Full) => self.wait_for(Wait::Publish),
                }
            }
            Do::CallStored => {
                let name = args.name(0, "name")?;
                let Some(text) = self.host.stored(name) else {
                    return Err(format!("name: no script '{name}' is stored on this node"));
                };
                self.doings.stored.extend_from_slice(text.as_bytes());
                Ok(Answer::Script)
            }
            Do::Sleep => {
                let ms = args.whole(0, "ms", 0, MS_MAX)?.unsigned_abs();
                match again {
                    Some(Wait::Until(until)) if self.host.now() >= until => Ok(NOTHING),
                    Some(wait) => self.wait_for(wait),
                    None => {
                        let until = self.host.now().plus_us(ms.saturating_mul(1000));
                        self.wait_for(Wait::Until(until))
                    }
                }
            }
            Do::WaitIdle => {
                self.doings.execute(self.host);
                if self.is_busy() {
                    self.wait_for(Wait::Idle)
                } else {
                    Ok(NOTHING)
                }
            }
        }
    }

    fn wait_for(&mut self, wait: Wait) -> Result<Answer, Wrong> {
        self.doings.wait = Some(wait);
        self.doings.lives = true;
        Ok(Answer::Wait)
    }

    /// Queues a command, to be executed later: by `execute`, or when no more fit.
    fn queue(&mut self, command: Command) -> Result<Answer, Wrong> {
        self.host.check(&command).map_err(|error| {
            let mut wrong = String::new();
            let _ = write!(wrong, "{error}");
            wrong
        })?;
        if self.doings.staged.len() >= self.host.credit_commands() {
            self.doings.execute(self.host);
            if self.host.credit_commands() == 0 {
                return self.wait_for(Wait::Room);
            }
        }
        if self.doings.staged.try_reserve(1).is_err() {
            return Err("not enough memory".into());
        }
        self.doings.staged.push(command);
        self.doings.queued_count += 1;
        Ok(returns(Reply::Integer(self.doings.queued_count as i32)))
    }

    /// Drives an axis outside the queue, once what was queued before has ended.
    fn drive(&mut self, args: &Args<'_>, target: Target) -> Result<Answer, Wrong> {
        let axis = self.axis(args)?;
        let course = args.course()?;
        self.doings.execute(self.host);
        if self.host.executed_commands() < self.host.accepted_commands() {
            return self.wait_for(Wait::Idle);
        }
        self.doings.lives = true;
        match self.host.drive(axis, target, course) {
            Ok(()) => Ok(NOTHING),
            // The last step is not quite over, or it is held: nothing that lasts by itself.
            Err(DriveError::Busy) => {
                let again = self.host.now().plus_us(BUSY_US);
                self.wait_for(Wait::Until(again))
            }
            Err(error) => Err(format!("{error}")),
        }
    }

    fn read_lidar(&mut self, args: &Args<'_>, again: Option<Wait>) -> Result<Answer, Wrong> {
        let timeout_ms = match args.0[0] {
            Value::Nil => LIDAR_MS_DEFAULT,
            _ => args.whole(0, "timeout_ms", 1, MS_MAX)?,
        };
        let reading = self.host.lidar();
        let now = self.host.now();
        match again {
            Some(Wait::Lidar {
                count,
                command,
                until,
            }) => {
                if reading.count != count {
                    let mm = reading.mm.map_or(Reply::Nil, |mm| Reply::Wide(mm.into()));
                    return Ok(returns(mm));
                }
                if until.is_some_and(|until| now >= until) {
                    return Ok(returns(Reply::Nil));
                }
                let left = self.host.executed_commands() >= command;
                let timeout_us = timeout_ms.unsigned_abs() * 1000;
                let until = until.or_else(|| left.then(|| now.plus_us(timeout_us)));
                self.wait_for(Wait::Lidar {
                    count,
                    command,
                    until,
                })
            }
            _ => {
                let queued = self.queue(Command::LidarRead)?;
                if queued == Answer::Wait {
                    return Ok(queued);
                }
                self.doings.execute(self.host);
                let command = self.host.accepted_commands();
                self.wait_for(Wait::Lidar {
                    count: reading.count,
                    command,
                    until: None,
                })
            }
        }
    }

    /// Something that polls while the node works is not a runaway.
    fn look(&mut self) {
        self.doings.cost = LOOK_INSTRUCTIONS;
        if self.host.is_active() {
            self.doings.lives = true;
        }
    }

    fn is_busy(&self) -> bool {
        self.host.is_active() || self.host.executed_commands() < self.host.accepted_commands()
    }

    fn depth(&self) -> i64 {
        let pending = self.host.accepted_commands() - self.host.executed_commands();
        let staged = self.doings.staged.len() as u64;
        i64::try_from(pending + staged).unwrap_or(i64::MAX)
    }

    fn axis(&self, args: &Args<'_>) -> Result<AxisId, Wrong> {
        let count = self.host.axis_count();
        let max = i64::try_from(count).unwrap_or(0) - 1;
        Ok(AxisId(args.whole(0, "axis", 0, max)? as u8))
    }
}

/// What a speed is told in.
#[derive(Clone, Copy)]
enum Unit {
    Hz,
    MilliHz,
    /// From step to step.
    Us,
    /// The same, of 62.5 ns.
    Ticks,
}

impl Unit {
    const ALL: [Self; 4] = [Self::Hz, Self::MilliHz, Self::Us, Self::Ticks];

    const fn name(self) -> &'static str {
        match self {
            Self::Hz => "hz",
            Self::MilliHz => "mhz",
            Self::Us => "us",
            Self::Ticks => "ticks",
        }
    }

    fn course(self, value: u32, accel_hz_per_s: u32) -> Course {
        match self {
            Self::Hz => Course::hz(value, accel_hz_per_s),
            Self::MilliHz => Course::mhz(value.into(), accel_hz_per_s),
            Self::Us => Course::interval_us(value, accel_hz_per_s),
            Self::Ticks => Course::interval_ticks(value.into(), accel_hz_per_s),
        }
    }

    /// Returns the speed in Hz, if that is a whole number.
    fn whole_hz(self, value: u32) -> Option<u32> {
        let (dividend, divisor) = match self {
            Self::Hz => return Some(value),
            Self::MilliHz => (value, 1_000),
            Self::Us => (1_000_000, value),
            Self::Ticks => (1_000_000 * motion::TICKS_PER_US as u32, value),
        };
        dividend.is_multiple_of(divisor).then(|| dividend / divisor)
    }
}

/// The arguments of one call.
struct Args<'a>(&'a [Value<'a>]);

impl<'a> Args<'a> {
    /// Returns a whole number in a range. A float that is one counts.
    fn whole(&self, index: usize, name: &str, min: i64, max: i64) -> Result<i64, Wrong> {
        let got = self.0.get(index).copied().unwrap_or(Value::Nil);
        let value = match got {
            Value::Integer(value) => Some(i64::from(value)),
            // The nearest whole number: equal only if it is one.
            Value::Number(value) if value as i64 as f32 == value => Some(value as i64),
            _ => None,
        };
        match value {
            Some(value) if (min..=max).contains(&value) => Ok(value),
            _ => Err(format!(
                "{name}: a whole number from {min} to {max}, got {}",
                show(got)
            )),
        }
    }

    fn any(&self, index: usize, name: &str) -> Result<i64, Wrong> {
        self.whole(index, name, -i64::from(i32::MAX), i32::MAX.into())
    }

    fn positive(&self, index: usize, name: &str) -> Result<u32, Wrong> {
        Ok(self.whole(index, name, 1, i32::MAX.into())? as u32)
    }

    fn steps(&self, index: usize, name: &str) -> Result<i32, Wrong> {
        match self.any(index, name)? {
            0 => Err(format!("{name}: 0 steps move nothing")),
            steps => Ok(steps as i32),
        }
    }

    fn boolean(&self, index: usize, name: &str) -> Result<bool, Wrong> {
        match self.0[index] {
            Value::Boolean(value) => Ok(value),
            got => Err(format!("{name}: true or false, got {}", show(got))),
        }
    }

    fn name(&self, index: usize, name: &str) -> Result<&'a str, Wrong> {
        self.text(index, name, SUFFIX_BYTES_MAX)
    }

    fn text(&self, index: usize, name: &str, bytes_max: usize) -> Result<&'a str, Wrong> {
        match self.0[index] {
            Value::Text(text) => match core::str::from_utf8(text) {
                Ok(text) if (1..=bytes_max).contains(&text.len()) => Ok(text),
                _ => Err(format!(
                    "{name}: a text of 1 to {bytes_max} bytes, got {} bytes",
                    text.len()
                )),
            },
            got => Err(format!("{name}: a text, got {}", show(got))),
        }
    }

    /// Reads a ramp of the queue: speed, acceleration and options, which are its last seven values.
    fn ramp(&self) -> Result<Ramp, Wrong> {
        let (value, unit) = self.speed(2)?;
        if !matches!(self.0[8], Value::Nil) {
            return Err(
                "options.passing: a drive can pass its target, a queued ramp rests there; \
                        lines are joined at speed"
                    .into(),
            );
        }
        let Some(speed_hz) = unit.whole_hz(value) else {
            return Err(format!(
                "speed_hz: a queued ramp has whole Hz, {value} {} is none; drives take it",
                unit.name()
            ));
        };
        Ok(Ramp {
            speed_hz,
            accel_hz_per_s: self.positive(3, "accel")?,
            shape: self.shape()?,
        })
    }

    /// Reads the same of a drive.
    fn course(&self) -> Result<Course, Wrong> {
        let (value, unit) = self.speed(2)?;
        let course = unit.course(value, self.positive(3, "accel")?);
        let course = course.shaped(self.shape()?);
        if let Value::Nil = self.0[8] {
            return Ok(course);
        }
        let passing = unit.course(self.positive(8, "options.passing")?, 1);
        Ok(course.passing_mhz(passing.speed_mhz()))
    }

    /// Reads a speed and its unit.
    fn speed(&self, index: usize) -> Result<(u32, Unit), Wrong> {
        let unit = match self.0[7] {
            Value::Nil => Unit::Hz,
            _ => {
                let name = self.text(7, "options.unit", 5)?;
                let known = Unit::ALL.into_iter().find(|unit| unit.name() == name);
                known.ok_or("options.unit: \"hz\", \"mhz\", \"us\" or \"ticks\"")?
            }
        };
        let name = match unit {
            Unit::Hz => "speed_hz",
            _ => "speed",
        };
        Ok((self.positive(index, name)?, unit))
    }

    fn shape(&self) -> Result<RampShape, Wrong> {
        let short = |index: usize, name: &str| match self.0[index] {
            Value::Nil => Ok(0),
            _ => Ok::<u16, Wrong>(self.whole(index, name, 0, u16::MAX.into())? as u16),
        };
        let linear_steps = short(5, "options.linear_steps")?;
        let jump_steps = short(6, "options.jump_steps")?;
        match self.0[4] {
            Value::Nil => Ok(RampShape::Trapezoid {
                linear_steps,
                jump_steps,
            }),
            _ if linear_steps != 0 || jump_steps != 0 => {
                Err("options.jerk: not together with linear_steps or jump_steps".into())
            }
            _ => Ok(RampShape::Jerk {
                jerk_hz_per_s2: self.positive(4, "options.jerk")?,
            }),
        }
    }

    fn smooth_ramp(&self) -> Result<Ramp, Wrong> {
        let start_hz = self.positive(2, "start_hz")?;
        let speed_hz = self.positive(3, "speed_hz")?;
        if start_hz >= speed_hz {
            return Err("start_hz: it must be below speed_hz".into());
        }
        let ramp_steps = self.whole(4, "ramp_steps", 2, u32::MAX.into())? as u32;
        Ok(Ramp {
            speed_hz,
            accel_hz_per_s: 0,
            shape: RampShape::Smooth {
                start_hz,
                ramp_steps,
            },
        })
    }
}

fn show(value: Value<'_>) -> String {
    match value {
        Value::Nil => "nothing".into(),
        Value::Boolean(value) => format!("{value}"),
        Value::Integer(value) => format!("{value}"),
        Value::Number(value) => format!("{value:?}"),
        Value::Text(text) if text.len() <= 20 => {
            format!("the text '{}'", String::from_utf8_lossy(text))
        }
        Value::Text(_) => "a text".into(),
        Value::Other(kind) => format!("a {kind}"),
    }
}
