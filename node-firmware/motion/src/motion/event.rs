//! What [`Motion::poll`](super::Motion::poll) tells.

use super::{Beyond, CdError};
use crate::{
    Ticks,
    io::{enable::OutputChange, home::HomeError, input::Switch, shift::ShiftFault},
    limits::CHANNELS,
};
use keys::{AxisId, status::FaultCode};

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
    /// [`Motion::take_lidar`](super::Motion::take_lidar) if the configuration says so.
    LidarRequest,
    /// It did not come in time; the queue goes on.
    LidarMissed,
    /// The pulses had to rest although the job has more: see [`Motion::expect_more`](super::Motion::expect_more).
    Underrun,
    /// Everything that was accepted has ended.
    Rest,
    /// A stop is complete: the last pulse has left.
    Stopped,
    /// Motion is held: see [`Motion::hold`](super::Motion::hold).
    Held,
    /// A drive has come to rest: see [`Motion::drive`](super::Motion::drive).
    DriveEnded {
        /// The axis.
        axis: AxisId,
    },
    /// Everything before a barrier has ended; it waits for [`Motion::release_barrier`](super::Motion::release_barrier).
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
    /// An axis is at a limit. Told once; it goes on unless [`Motion::stop`](super::Motion::stop) follows.
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
    /// Homing failed: the queue does not go on without [`Motion::stop`](super::Motion::stop).
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
    /// The shift register is to show this word; [`Motion::take_shift`](super::Motion::take_shift) takes what is read back.
    ShiftOut {
        /// A bit for each pin.
        word: u32,
    },
    /// The shift register does not follow: nothing behind it is known to be on.
    ShiftFault(ShiftFault),
    /// C or D did not arrive: the queue does not go on without [`Motion::stop`](super::Motion::stop).
    CdFailed {
        /// Why.
        error: CdError,
    },
    /// The commands before have ended: [`Motion::status_cd`](super::Motion::status_cd) is asked for.
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
