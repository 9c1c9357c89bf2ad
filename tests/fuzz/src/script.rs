//! A script of any text: it ends or gives way in every slice, keeps to its memory, and queues no
//! more than there is room for.

use keys::{AxisId, Command, LocalMicros, NodeState, start::BarrierName};
use motion::{CommandError, Course, DriveError, Target};
use script::{BarrierError, Full, Host, LidarReading, Limits, Script, Step};

/// Small limits, so that what runs away ends soon.
const LIMITS: Limits = Limits {
    memory_bytes: 128 * 1024,
    slice_instructions: 1_000,
    slice_us: 1_000,
    work_max: 20_000,
    runaway_instructions: 20_000,
    wall_us: 2_000_000,
};

/// Room of the queue.
const CAPACITY: usize = 16;

/// Meeting points that it knows.
const BARRIERS: usize = 4;

#[derive(Default)]
struct Bench {
    now: LocalMicros,
    queue: Vec<Command>,
    accepted: u64,
    executed: u64,
    published: usize,
    barriers: Vec<BarrierName>,
}

impl Host for Bench {
    fn now(&self) -> LocalMicros {
        self.now
    }
    fn axis_count(&self) -> usize {
        2
    }
    fn check(&self, _: &Command) -> Result<(), CommandError> {
        Ok(())
    }
    fn credit_commands(&self) -> usize {
        CAPACITY - self.queue.len()
    }
    fn barrier(&mut self, name: BarrierName) -> Result<u16, BarrierError> {
        let known = self.barriers.iter().position(|known| *known == name);
        let number = known.unwrap_or(self.barriers.len());
        if known.is_none() {
            if number == BARRIERS {
                return Err(BarrierError::Many);
            }
            self.barriers.push(name);
        }
        Ok(number as u16)
    }
    fn push(&mut self, commands: &[Command]) {
        assert!(commands.len() <= self.credit_commands(), "no more than fit");
        self.queue.extend_from_slice(commands);
        self.accepted += commands.len() as u64;
    }
    fn accepted_commands(&self) -> u64 {
        self.accepted
    }
    fn executed_commands(&self) -> u64 {
        self.executed
    }
    fn position_steps(&self, _: AxisId) -> i64 {
        -20
    }
    fn speed_mhz(&self, _: AxisId) -> i32 {
        1_500
    }
    fn is_active(&self) -> bool {
        !self.queue.is_empty()
    }
    fn state(&self) -> NodeState {
        NodeState::Idle
    }
    fn hold(&mut self) {}
    fn resume(&mut self) {}
    fn set_speed_percent(&mut self, percent: u16) -> Result<(), CommandError> {
        if percent > 200 {
            Err(CommandError::Range)
        } else {
            Ok(())
        }
    }
    fn drive(&mut self, _: AxisId, target: Target, _: Course) -> Result<(), DriveError> {
        if target == Target::By(13) {
            Err(DriveError::Still)
        } else {
            Ok(())
        }
    }
    fn end_drive(&mut self, _: Option<AxisId>) {}
    fn is_driven(&self, _: AxisId) -> bool {
        false
    }
    fn emergency_stop(&mut self) {}
    fn laser_percent(&self) -> u8 {
        7
    }
    fn lidar(&self) -> LidarReading {
        LidarReading::default()
    }
    fn input(&self, name: &str) -> Option<bool> {
        (name == "stop").then_some(false)
    }
    fn print(&mut self, _: &str) {}
    fn publish(&mut self, _: &str, _: &str) -> Result<(), Full> {
        self.published += 1;
        if self.published.is_multiple_of(4) {
            Err(Full)
        } else {
            Ok(())
        }
    }
    fn stored(&self, _: &str) -> Option<&str> {
        None
    }
}

/// See the module.
pub fn check(data: &[u8]) {
    let Ok(text) = std::str::from_utf8(data) else {
        return;
    };
    let mut bench = Bench::default();
    let Ok(mut script) = Script::start(text, "fuzz", "left", 0, LIMITS, bench.now) else {
        return;
    };
    // Past its wall time by far.
    for _ in 0..4_000 {
        match script.step(&mut bench) {
            Step::Ended(_) => return,
            Step::Waits(_) => {
                // A traceback may need more when the memory is used up.
                assert!(script.memory_bytes() <= LIMITS.memory_bytes + 32 * 1024);
                bench.executed += bench.queue.len() as u64;
                bench.queue.clear();
                bench.now = LocalMicros(bench.now.0 + 1_000);
            }
        }
    }
    panic!("the script neither ends nor is ended");
}

/// Work, waiting, recursion, patterns, tables.
pub fn seeds() -> Vec<Vec<u8>> {
    [
        "for i=1,100 do motor.queue_move(0,200,i) end motor.execute() wait_idle() return motor.get_position(0)",
        "local t = setmetatable({}, {__index = function(t, k) return t[k + 1] end}) local x = t[1]",
        "local co = coroutine.wrap(function() while true do coroutine.yield(1) end end) for i=1,9 do co() end",
        "return string.find(string.rep('a', 500), string.rep('a-', 20) .. 'b')",
        "pcall(function() error({}) end) sleep(10) node.publish('x', {a = {1, 2, 3}})",
        "table.sort({5, 4, 3}, function(a, b) return true end) ::top:: goto top",
    ]
    .map(|text| text.as_bytes().to_vec())
    .to_vec()
}
