//! A script on a bench: a queue that executes nothing by itself, in virtual time.
#![allow(
    dead_code,
    unreachable_pub,
    missing_docs,
    reason = "each test file uses another part of this one"
)]

use keys::{AxisId, Command, LocalMicros, NodeState, start::BarrierName};
use motion::{CommandError, Course, DriveError, Target};
use script::{BarrierError, End, Full, Host, LidarReading, Limits, Script, Step, Wait};

pub struct Bench {
    pub now: LocalMicros,
    pub capacity: usize,
    pub queue: Vec<Command>,
    pub accepted: u64,
    pub executed: u64,
    pub lidar: LidarReading,
    pub lines: Vec<String>,
    pub published: Vec<(String, String)>,
    pub stored: Vec<(String, String)>,
    pub held: bool,
    pub percent: u16,
    pub stopped: bool,
    pub driven: Vec<(AxisId, Target, Course)>,
    pub barriers: Vec<BarrierName>,
    /// Every command that ever came.
    pub commands: Vec<Command>,
}

impl Default for Bench {
    fn default() -> Self {
        Self {
            now: LocalMicros(0),
            capacity: 64,
            queue: Vec::new(),
            accepted: 0,
            executed: 0,
            lidar: LidarReading::default(),
            lines: Vec::new(),
            published: Vec::new(),
            stored: Vec::new(),
            held: false,
            percent: 100,
            stopped: false,
            driven: Vec::new(),
            barriers: Vec::new(),
            commands: Vec::new(),
        }
    }
}

impl Host for Bench {
    fn now(&self) -> LocalMicros {
        self.now
    }
    fn axis_count(&self) -> usize {
        4
    }
    fn check(&self, command: &Command) -> Result<(), CommandError> {
        match command {
            Command::Home { .. } => Err(CommandError::NotSupported),
            _ => Ok(()),
        }
    }
    fn credit_commands(&self) -> usize {
        self.capacity - self.queue.len()
    }
    fn barrier(&mut self, name: BarrierName) -> Result<u16, BarrierError> {
        let known = self.barriers.iter().position(|known| *known == name);
        let number = known.unwrap_or(self.barriers.len());
        if number >= 3 {
            return Err(BarrierError::Many);
        }
        if known.is_none() {
            self.barriers.push(name);
        }
        Ok(number as u16)
    }
    fn push(&mut self, commands: &[Command]) {
        assert!(commands.len() <= self.credit_commands(), "no more than fit");
        self.queue.extend_from_slice(commands);
        self.commands.extend_from_slice(commands);
        self.accepted += commands.len() as u64;
    }
    fn accepted_commands(&self) -> u64 {
        self.accepted
    }
    fn executed_commands(&self) -> u64 {
        self.executed
    }
    fn position_steps(&self, axis: AxisId) -> i64 {
        [10, -20, 1 << 40, 0][axis.index()]
    }
    fn speed_mhz(&self, _: AxisId) -> i32 {
        1500
    }
    fn is_active(&self) -> bool {
        !self.queue.is_empty()
    }
    fn state(&self) -> NodeState {
        NodeState::Idle
    }
    fn hold(&mut self) {
        self.held = true;
    }
    fn resume(&mut self) {
        self.held = false;
    }
    fn set_speed_percent(&mut self, percent: u16) -> Result<(), CommandError> {
        if percent > 200 {
            return Err(CommandError::Range);
        }
        self.percent = percent;
        Ok(())
    }
    fn drive(&mut self, axis: AxisId, target: Target, course: Course) -> Result<(), DriveError> {
        if target == Target::By(13) {
            return Err(DriveError::Still);
        }
        self.driven.push((axis, target, course));
        Ok(())
    }
    fn end_drive(&mut self, _: Option<AxisId>) {
        self.driven.clear();
    }
    fn is_driven(&self, axis: AxisId) -> bool {
        self.driven.iter().any(|(driven, ..)| *driven == axis)
    }
    fn emergency_stop(&mut self) {
        self.stopped = true;
    }
    fn laser_percent(&self) -> u8 {
        7
    }
    fn lidar(&self) -> LidarReading {
        self.lidar
    }
    fn input(&self, name: &str) -> Option<bool> {
        (name == "stop").then_some(false)
    }
    fn print(&mut self, line: &str) {
        self.lines.push(line.into());
    }
    fn publish(&mut self, suffix: &str, json: &str) -> Result<(), Full> {
        if self.published.len() >= 4 {
            return Err(Full);
        }
        self.published.push((suffix.into(), json.into()));
        Ok(())
    }
    fn stored(&self, name: &str) -> Option<&str> {
        let found = self.stored.iter().find(|(stored, _)| stored == name);
        found.map(|(_, text)| text.as_str())
    }
}

/// Small limits, so that what runs away ends soon.
pub fn limits() -> Limits {
    Limits {
        memory_bytes: 256 * 1024,
        slice_instructions: 2_000,
        slice_us: 1_000,
        work_max: 50_000,
        runaway_instructions: 200_000,
        wall_us: 60_000_000,
    }
}

impl Bench {
    pub fn start(&self, text: &str) -> Result<Script, String> {
        Script::start(text, "test", "left", self.accepted, limits(), self.now)
    }

    /// Executes everything that is in the queue.
    pub fn execute_all(&mut self) {
        self.executed += self.queue.len() as u64;
        if self.queue.contains(&Command::LidarRead) {
            self.lidar.count += 1;
            self.lidar.mm = Some(1234);
        }
        self.queue.clear();
    }

    /// Runs a script to its end; whenever it waits, the queue is executed and time passes.
    pub fn run(&mut self, text: &str) -> End {
        let mut script = match self.start(text) {
            Ok(script) => script,
            Err(message) => return End::Failed { message },
        };
        for _ in 0..200_000 {
            match script.step(self) {
                Step::Ended(end) => return end,
                Step::Waits(wait) => {
                    if wait != Wait::Slice {
                        self.execute_all();
                        self.published.clear();
                    }
                    self.now = LocalMicros(self.now.0 + 1_000);
                }
            }
        }
        panic!("the script neither ends nor is ended");
    }

    /// Runs a script that must return, and gives the JSON of what it does.
    pub fn returned(&mut self, text: &str) -> String {
        match self.run(text) {
            End::Returned { json } => json.unwrap_or_default(),
            other => panic!("{text}\n{other:?}"),
        }
    }

    /// Runs a script that must fail, and gives the message.
    pub fn failed(&mut self, text: &str) -> String {
        match self.run(text) {
            End::Failed { message } => message,
            other => panic!("{text}\n{other:?}"),
        }
    }
}

pub fn returned(text: &str) -> String {
    Bench::default().returned(text)
}

pub fn failed(text: &str) -> String {
    Bench::default().failed(text)
}

/// Numbers below a bound, from a seed that is not 0 (xorshift).
pub fn random(seed: u64) -> impl FnMut(usize) -> usize {
    let mut state = seed.wrapping_mul(0x9e37_79b9_7f4a_7c15) | 1;
    move |below| {
        state ^= state << 13;
        state ^= state >> 7;
        state ^= state << 17;
        (state >> 11) as usize % below
    }
}
