//! What a node can be told.
//!
//! A [`Command`] is `Copy` and at most 32 bytes, so that it is one record of the node's command
//! ring: eight words, see [`Command::to_words`]. (16 bytes would not hold `sync_move`: two
//! delays and two signed step counts are 16 bytes before the tag.) Variants are only appended.

use crate::{AXES_MAX, AxisId};
use serde::{Deserialize, Serialize};

/// Words of one command in a ring.
pub const COMMAND_WORDS: usize = 8;

/// Axes that a [`Command::Line`] coordinates.
pub const LINE_AXES: usize = 4;

/// The barrier at which a node of its own rests until a client resumes: a part is turned, a tool is
/// changed.
pub const BARRIER_RESUME: u16 = u16::MAX;

/// Highest number of a named position of C.
pub const POSITION_C_MAX: u8 = 4;

/// One thing a node can be told.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Command {
    /// `steps` pulses, `delay_us` apart, no ramp: edges at 0, d, 2d, …; the next command starts
    /// one delay after the last edge. The sign of `steps` is the direction.
    Move {
        /// The axis that moves.
        axis: AxisId,
        /// Time between steps, µs, from 1.
        delay_us: u32,
        /// Steps with sign, never 0.
        steps: i32,
    },
    /// Two [`Command::Move`]s on axes 0 and 1 that start on the same tick. The next command
    /// starts when both have ended. An axis with 0 steps rests.
    SyncMove {
        /// Time between steps of axis 0 and axis 1, µs, from 1.
        delay_us: [u32; 2],
        /// Steps with sign of axis 0 and axis 1, not both 0.
        steps: [i32; 2],
    },
    /// All axes rest this long, timed by the pulse hardware.
    Pause {
        /// Duration, ms.
        pause_ms: u32,
    },
    /// Sets the laser's power when the commands before have ended. Every stop sets it to 0.
    Laser {
        /// 0 to 100.
        power_percent: u8,
    },
    /// Asks for a lidar reading when the commands before have ended.
    LidarRead,
    /// Names the present place of an axis `position_steps`, without motion.
    SetPosition {
        /// The axis.
        axis: AxisId,
        /// Its new position, steps.
        position_steps: i64,
    },
    /// A move relative to the position after the commands before, with a ramp at both ends.
    Ramp {
        /// The axis that moves.
        axis: AxisId,
        /// Steps with sign.
        steps: i32,
        /// The ramp.
        ramp: Ramp,
    },
    /// A move to a position, with a ramp at both ends.
    RampTo {
        /// The axis that moves.
        axis: AxisId,
        /// Target, steps.
        position_steps: i64,
        /// The ramp.
        ramp: Ramp,
    },
    /// All axes start and end together, straight in step space.
    Line {
        /// Steps with sign of each axis.
        steps: [i32; LINE_AXES],
        /// Speed of the axis with most steps, Hz.
        speed_hz: u32,
        /// Acceleration of that axis, steps/s².
        accel_hz_per_s: u32,
        /// Jerk of that axis, steps/s³; 0 = not limited.
        jerk_hz_per_s2: u32,
    },
    /// Finds the axis' reference switch.
    Home {
        /// The axis.
        axis: AxisId,
    },
    /// All axes rest until the meeting point is lifted.
    Barrier {
        /// Number of the meeting point within its job; [`BARRIER_RESUME`]: until a client resumes.
        barrier: u16,
    },
    /// Moves C to one of its named positions.
    MoveC {
        /// Number of the position, 0 to [`POSITION_C_MAX`].
        index: u8,
    },
    /// Moves D to one of its two ends.
    MoveD {
        /// The end: ON, else OFF.
        on: bool,
    },
    /// Asks for a line of text in the node's log: where C and D are.
    StatusCd,
}

/// How a ramped move speeds up and slows down.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Ramp {
    /// Speed to reach, Hz.
    pub speed_hz: u32,
    /// Acceleration, steps/s²; not used by [`RampShape::Smooth`].
    pub accel_hz_per_s: u32,
    /// The limit of jerk, or the shape of the first steps.
    pub shape: RampShape,
}

/// What bounds the change of acceleration.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum RampShape {
    /// Trapezoid; over the first `linear_steps` acceleration grows linearly, and the first speed
    /// is the one that `jump_steps` of ramp would have reached. Both may be 0.
    Trapezoid {
        /// Steps of linearly growing acceleration.
        linear_steps: u16,
        /// Steps whose speed the move starts with.
        jump_steps: u16,
    },
    /// An S-curve.
    Jerk {
        /// Jerk, steps/s³, from 1.
        jerk_hz_per_s2: u32,
    },
    /// ESP-IDF's smoothstep: over `ramp_steps` steps speed goes from `start_hz` to the ramp's by
    /// 3x² - 2x³, x being the share of the way. A shorter move takes the first half of its way of the
    /// rise, and back. Known to nodes with [`Features::SMOOTH`].
    Smooth {
        /// First and last speed, Hz, from 1, below the ramp's.
        start_hz: u32,
        /// Steps from the first speed to the ramp's, from 2.
        ramp_steps: u32,
    },
}

/// What a node's firmware can do, as bits. Numbers are never reused.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Features(pub u32);

impl Features {
    /// `move`, `sync_move`, `pause`, `laser`, `lidar_read`, `set_position`.
    pub const BASIC: Self = Self(1);
    /// `ramp`, `ramp_to`, `line`.
    pub const RAMPS: Self = Self(2);
    /// `home`.
    pub const HOMING: Self = Self(4);
    /// `barrier` and synchronized starts.
    pub const BARRIERS: Self = Self(8);
    /// Lua scripts.
    pub const LUA: Self = Self(16);
    /// `movc`, `movd`, `statcd`.
    pub const CD: Self = Self(32);
    /// Hold, resume and speed for clients.
    pub const PACE: Self = Self(64);
    /// [`RampShape::Smooth`].
    pub const SMOOTH: Self = Self(128);
    /// Jogging by hand.
    pub const JOG: Self = Self(256);
    /// Messages behind the epoch of their gateway, see [`crate::epoch`].
    pub const EPOCH: Self = Self(512);

    /// `home` of this axis: a bit from 2²⁴ on for each, because it takes a switch.
    pub const fn home_of(axis: AxisId) -> Self {
        match 1_u32.checked_shl(24 + axis.0 as u32) {
            Some(bit) if (axis.0 as usize) < AXES_MAX => Self(bit),
            // A node without such an axis refuses it for that.
            _ => Self(0),
        }
    }

    /// Returns whether all of `others` are here.
    pub const fn has(self, others: Self) -> bool {
        self.0 & others.0 == others.0
    }

    /// Returns both together.
    #[must_use]
    pub const fn with(self, others: Self) -> Self {
        Self(self.0 | others.0)
    }
}

// No two of them share a bit.
const _: () = {
    let all = [
        Features::BASIC,
        Features::RAMPS,
        Features::HOMING,
        Features::BARRIERS,
        Features::LUA,
        Features::CD,
        Features::PACE,
        Features::SMOOTH,
        Features::JOG,
        Features::EPOCH,
    ];
    let (mut seen, mut index) = (0_u32, 0);
    while index < all.len() {
        assert!(seen & all[index].0 == 0 && all[index].0 < 1 << 24);
        seen |= all[index].0;
        index += 1;
    }
};

/// The words hold no command: an unknown tag, or a value that no command has.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct WordsError;

const _: () = assert!(size_of::<Command>() <= 4 * COMMAND_WORDS);
const _: () = assert!(24 + AXES_MAX <= 32, "a bit for the home of each axis");

impl Command {
    /// Returns what firmware must be able to do for this command.
    pub const fn feature(&self) -> Features {
        match self {
            Self::Move { .. }
            | Self::SyncMove { .. }
            | Self::Pause { .. }
            | Self::Laser { .. }
            | Self::LidarRead
            | Self::SetPosition { .. } => Features::BASIC,
            Self::Ramp { ramp, .. } | Self::RampTo { ramp, .. } => match ramp.shape {
                RampShape::Smooth { .. } => Features::RAMPS.with(Features::SMOOTH),
                RampShape::Trapezoid { .. } | RampShape::Jerk { .. } => Features::RAMPS,
            },
            Self::Line { .. } => Features::RAMPS,
            Self::Home { axis } => Features::HOMING.with(Features::home_of(*axis)),
            Self::Barrier { .. } => Features::BARRIERS,
            Self::MoveC { .. } | Self::MoveD { .. } | Self::StatusCd => Features::CD,
        }
    }

    /// Returns the highest axis number that the command uses, `None` if it uses none. C and D have
    /// names, not numbers.
    pub fn axis_max(&self) -> Option<AxisId> {
        match *self {
            Self::Move { axis, .. }
            | Self::SetPosition { axis, .. }
            | Self::Ramp { axis, .. }
            | Self::RampTo { axis, .. }
            | Self::Home { axis } => Some(axis),
            Self::SyncMove { steps, .. } => Some(AxisId(u8::from(steps[1] != 0))),
            Self::Line { steps, .. } => steps
                .iter()
                .rposition(|count| *count != 0)
                .map(|index| AxisId(index as u8)),
            Self::Pause { .. }
            | Self::Laser { .. }
            | Self::LidarRead
            | Self::Barrier { .. }
            | Self::MoveC { .. }
            | Self::MoveD { .. }
            | Self::StatusCd => None,
        }
    }

    /// Packs the command into the words of one ring record. Word 0 holds tag, axis and small
    /// values, low byte first.
    pub fn to_words(&self) -> [u32; COMMAND_WORDS] {
        let head = |tag: u8, axis: AxisId| u32::from(tag) | u32::from(axis.0) << 8;
        let none = AxisId(0);
        match *self {
            Self::Move {
                axis,
                delay_us,
                steps,
            } => [head(0, axis), delay_us, steps as u32, 0, 0, 0, 0, 0],
            Self::SyncMove { delay_us, steps } => {
                let [s0, s1] = steps.map(|count| count as u32);
                [head(1, none), delay_us[0], delay_us[1], s0, s1, 0, 0, 0]
            }
            Self::Pause { pause_ms } => [head(2, none), pause_ms, 0, 0, 0, 0, 0, 0],
            Self::Laser { power_percent } => {
                [head(3, none), u32::from(power_percent), 0, 0, 0, 0, 0, 0]
            }
            Self::LidarRead => [head(4, none), 0, 0, 0, 0, 0, 0, 0],
            Self::SetPosition {
                axis,
                position_steps,
            } => {
                let [low, high] = words_from_i64(position_steps);
                [head(5, axis), low, high, 0, 0, 0, 0, 0]
            }
            Self::Ramp { axis, steps, ramp } => {
                let (kind, [shape, more]) = ramp.shape.to_words();
                [
                    head(6, axis) | kind << 16,
                    steps as u32,
                    0,
                    ramp.speed_hz,
                    ramp.accel_hz_per_s,
                    shape,
                    more,
                    0,
                ]
            }
            Self::RampTo {
                axis,
                position_steps,
                ramp,
            } => {
                let (kind, [shape, more]) = ramp.shape.to_words();
                let [low, high] = words_from_i64(position_steps);
                [
                    head(7, axis) | kind << 16,
                    low,
                    high,
                    ramp.speed_hz,
                    ramp.accel_hz_per_s,
                    shape,
                    more,
                    0,
                ]
            }
            Self::Line {
                steps,
                speed_hz,
                accel_hz_per_s,
                jerk_hz_per_s2,
            } => {
                let [s0, s1, s2, s3] = steps.map(|count| count as u32);
                [
                    head(8, none),
                    s0,
                    s1,
                    s2,
                    s3,
                    speed_hz,
                    accel_hz_per_s,
                    jerk_hz_per_s2,
                ]
            }
            Self::Home { axis } => [head(9, axis), 0, 0, 0, 0, 0, 0, 0],
            Self::Barrier { barrier } => [head(10, none), u32::from(barrier), 0, 0, 0, 0, 0, 0],
            Self::MoveC { index } => [head(11, none), u32::from(index), 0, 0, 0, 0, 0, 0],
            Self::MoveD { on } => [head(12, none), u32::from(on), 0, 0, 0, 0, 0, 0],
            Self::StatusCd => [head(13, none), 0, 0, 0, 0, 0, 0, 0],
        }
    }

    /// Unpacks what [`Command::to_words`] packed.
    ///
    /// # Errors
    /// The words hold no command.
    pub fn from_words(words: &[u32; COMMAND_WORDS]) -> Result<Self, WordsError> {
        let head = words[0];
        let axis = AxisId((head >> 8) as u8);
        let ramp = || -> Result<Ramp, WordsError> {
            Ok(Ramp {
                speed_hz: words[3],
                accel_hz_per_s: words[4],
                shape: RampShape::from_words(head >> 16 & 0xff, [words[5], words[6]])?,
            })
        };
        Ok(match head as u8 {
            0 => Self::Move {
                axis,
                delay_us: words[1],
                steps: words[2] as i32,
            },
            1 => Self::SyncMove {
                delay_us: [words[1], words[2]],
                steps: [words[3] as i32, words[4] as i32],
            },
            2 => Self::Pause { pause_ms: words[1] },
            3 => Self::Laser {
                power_percent: u8::try_from(words[1]).map_err(|_| WordsError)?,
            },
            4 => Self::LidarRead,
            5 => Self::SetPosition {
                axis,
                position_steps: i64_from_words(words[1], words[2]),
            },
            6 => Self::Ramp {
                axis,
                steps: words[1] as i32,
                ramp: ramp()?,
            },
            7 => Self::RampTo {
                axis,
                position_steps: i64_from_words(words[1], words[2]),
                ramp: ramp()?,
            },
            8 => Self::Line {
                steps: [words[1], words[2], words[3], words[4]].map(|word| word as i32),
                speed_hz: words[5],
                accel_hz_per_s: words[6],
                jerk_hz_per_s2: words[7],
            },
            9 => Self::Home { axis },
            10 => Self::Barrier {
                barrier: u16::try_from(words[1]).map_err(|_| WordsError)?,
            },
            11 => Self::MoveC {
                index: u8::try_from(words[1]).map_err(|_| WordsError)?,
            },
            12 => Self::MoveD {
                on: match words[1] {
                    0 => false,
                    1 => true,
                    _ => return Err(WordsError),
                },
            },
            13 => Self::StatusCd,
            _ => return Err(WordsError),
        })
    }
}

impl RampShape {
    fn to_words(self) -> (u32, [u32; 2]) {
        match self {
            Self::Trapezoid {
                linear_steps,
                jump_steps,
            } => {
                let steps = u32::from(linear_steps) | u32::from(jump_steps) << 16;
                (0, [steps, 0])
            }
            Self::Jerk { jerk_hz_per_s2 } => (1, [jerk_hz_per_s2, 0]),
            Self::Smooth {
                start_hz,
                ramp_steps,
            } => (2, [start_hz, ramp_steps]),
        }
    }

    fn from_words(kind: u32, [shape, more]: [u32; 2]) -> Result<Self, WordsError> {
        match kind {
            0 => Ok(Self::Trapezoid {
                linear_steps: shape as u16,
                jump_steps: (shape >> 16) as u16,
            }),
            1 => Ok(Self::Jerk {
                jerk_hz_per_s2: shape,
            }),
            2 => Ok(Self::Smooth {
                start_hz: shape,
                ramp_steps: more,
            }),
            _ => Err(WordsError),
        }
    }
}

const fn words_from_i64(value: i64) -> [u32; 2] {
    [value as u32, (value >> 32) as u32]
}

const fn i64_from_words(low: u32, high: u32) -> i64 {
    (high as i64) << 32 | low as i64
}
