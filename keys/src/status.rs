//! What a node knows about itself, complete each time: losing one loses nothing that the next
//! does not say.

use crate::{AXES_MAX, Features, JobId, LocalMicros, batch::QueueId, stop::StopReport};
use serde::{Deserialize, Serialize};

/// Most bytes of a status on the wire.
pub const STATUS_BYTES_MAX: usize = 512;

/// Most faults that a status lists.
pub const FAULTS_MAX: usize = 4;

/// Why bytes are no message.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum DecodeError {
    /// The first byte is a version that this code does not know.
    Version(u8),
    /// The bytes end early or hold no such message.
    Malformed,
    /// Bytes are left over.
    Trailing,
}

impl core::fmt::Display for DecodeError {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        match self {
            Self::Version(version) => write!(f, "message version {version} is not known"),
            Self::Malformed => write!(f, "malformed message"),
            Self::Trailing => write!(f, "bytes after the end of the message"),
        }
    }
}

impl core::error::Error for DecodeError {}

/// What a node does.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub enum NodeState {
    /// Nothing to do.
    #[default]
    Idle,
    /// At a barrier, loaded, waiting for the start.
    Ready,
    /// Commands are being executed.
    Running,
    /// Held on its path.
    Paused,
    /// The stop latch is set: every batch is refused.
    Stopped,
    /// Something is broken; the latch is set too.
    Fault,
}

/// What is wrong. Numbers are fixed: 1xx link, 2xx motion, 3xx memory, 4xx what a gateway sees of a
/// node; never reused.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Fault {
    /// The number.
    pub code: FaultCode,
    /// When it was seen.
    pub at: LocalMicros,
}

/// The number of a fault.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct FaultCode(pub u16);

impl FaultCode {
    /// The link was lost while commands were executed.
    pub const LINK_LOST: Self = Self(101);
    /// A refill came too late: pulses may have been played twice.
    pub const REFILL_LATE: Self = Self(201);
    /// The queue ran dry although the job has more.
    pub const UNDERRUN: Self = Self(202);
    /// The planner came too late: the axes stood still in the middle of a ramp or a path.
    pub const PLAN_LATE: Self = Self(204);
    /// Ledger and pulse counter disagree.
    pub const COUNT_MISMATCH: Self = Self(203);
    /// An axis came to a limit, or was told to go beyond one.
    pub const LIMIT: Self = Self(205);
    /// An axis did not find its reference switch.
    pub const HOMING: Self = Self(206);
    /// C or D did not arrive where it was sent.
    pub const NOT_THERE: Self = Self(207);
    /// The shift register does not show what it was sent.
    pub const SHIFT_REGISTER: Self = Self(208);
    /// The channels could not be started when it was ordered; nothing was played.
    pub const START_LATE: Self = Self(209);
    /// The program panicked; outputs were switched off.
    pub const PANIC: Self = Self(301);
    /// The processor was reset by a watchdog, by too low a supply, or by itself.
    pub const RESET: Self = Self(302);
    /// Stored scripts do not fit in the memory: some of them were not loaded.
    pub const SCRIPTS: Self = Self(303);
    /// What the node was told last can no longer be read: drivers, switches and tuning are older.
    pub const RECORD: Self = Self(304);
    /// Another controller speaks under the same name.
    pub const TWIN: Self = Self(401);
    /// The node obeys another gateway.
    pub const OTHER_GATEWAY: Self = Self(402);

    /// Returns the words that clients see.
    pub const fn as_str(self) -> &'static str {
        match self {
            Self::LINK_LOST => "link lost while moving",
            Self::REFILL_LATE => "pulse refill too late",
            Self::UNDERRUN => "queue ran dry in the middle of a job",
            Self::PLAN_LATE => "planner too late in the middle of a path",
            Self::START_LATE => "start too late, nothing was played",
            Self::COUNT_MISMATCH => "position and pulse counter disagree",
            Self::LIMIT => "an axis at its limit",
            Self::HOMING => "homing failed",
            Self::NOT_THERE => "C or D did not arrive",
            Self::SHIFT_REGISTER => "shift register does not follow",
            Self::PANIC => "firmware panic",
            Self::RESET => "the controller was reset, the log says by what",
            Self::SCRIPTS => "stored scripts do not fit in memory",
            Self::RECORD => "stored configuration damaged, an older one is in use",
            Self::TWIN => {
                "another controller speaks under this name; it gets no jobs until only one does"
            }
            Self::OTHER_GATEWAY => "obeys another gateway that is newer, by this one's clock",
            _ => "unknown fault",
        }
    }
}

/// One axis.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct AxisStatus {
    /// Exact position, steps.
    pub position_steps: i64,
    /// Speed with sign, mHz (thousandths of a step per second).
    pub speed_mhz: i32,
}

/// What a node knows about itself.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Status {
    /// The node's clock when this was written: also its time since boot.
    pub at: LocalMicros,
    /// Its queue.
    pub queue: QueueId,
    /// What it does.
    pub state: NodeState,
    /// How the queue before this one ended; `None` since boot if none did.
    pub stop: Option<StopReport>,
    /// The job whose commands were accepted last and have not all ended.
    pub job: Option<JobId>,
    /// How many commands this queue has taken.
    pub accepted_commands: u64,
    /// How many of them have ended: their last pulse has left the pin.
    pub executed_commands: u64,
    /// How many more fit.
    pub credit_commands: u32,
    /// The axes, by number.
    pub axes: heapless::Vec<AxisStatus, AXES_MAX>,
    /// The last faults since boot, oldest first.
    pub faults: heapless::Vec<Fault, FAULTS_MAX>,
    /// What the firmware can do.
    pub features: Features,
    /// Version of the firmware.
    pub firmware: [u8; 3],
    /// Signal strength, dBm; `None` without WiFi.
    pub rssi_dbm: Option<i8>,
    /// Laser power now, percent.
    pub laser_percent: u8,
    /// Last lidar reading, mm.
    pub lidar_mm: Option<u32>,
}
