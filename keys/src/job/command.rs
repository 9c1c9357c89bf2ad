//! The commands of a job as clients write them, one by one.
//!
//! Owns their names, their fields and the ranges of these; [`JobCommand::to_command`] makes of each
//! what a node takes.

mod taken;

use super::{BARRIER_BYTES_MAX, MOVE_US_MAX, PAUSE_MS_MAX, SPEED_HZ_MAX};
use crate::{
    command::{LINE_AXES, POSITION_C_MAX},
    record::{ErrorCode, JobError},
};
use core::{fmt, marker::PhantomData};
use serde::{Deserialize, Deserializer, Serialize, de};
use std::{format, string::String, vec::Vec};

/// A command as clients write it: `{"move":{"axis":0,"delay_us":500,"steps":-2000}}`.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case", deny_unknown_fields)]
pub enum JobCommand {
    /// Steps at one interval.
    #[serde(deserialize_with = "object")]
    Move(MoveFields),
    /// Two moves that start on the same tick.
    #[serde(deserialize_with = "object")]
    SyncMove(SyncMoveFields),
    /// A relative move with ramps.
    #[serde(deserialize_with = "object")]
    Ramp(RampFields),
    /// An absolute move with ramps.
    #[serde(deserialize_with = "object")]
    RampTo(RampToFields),
    /// A straight line of all axes.
    #[serde(deserialize_with = "object")]
    Line(LineFields),
    /// A rest.
    #[serde(deserialize_with = "object")]
    Pause(PauseFields),
    /// Laser power.
    #[serde(deserialize_with = "object")]
    Laser(LaserFields),
    /// A lidar reading.
    #[serde(deserialize_with = "object")]
    LidarRead(LidarReadFields),
    /// Find the reference switch.
    #[serde(deserialize_with = "object")]
    Home(HomeFields),
    /// Name the present place.
    #[serde(deserialize_with = "object")]
    SetPosition(SetPositionFields),
    /// A meeting point.
    #[serde(deserialize_with = "object")]
    Barrier(BarrierFields),
    /// C to a named position.
    #[serde(rename = "movc", deserialize_with = "object")]
    MoveC(MoveCFields),
    /// D on or off.
    #[serde(rename = "movd", deserialize_with = "object")]
    MoveD(MoveDFields),
    /// Where C and D are.
    #[serde(rename = "statcd", deserialize_with = "object")]
    StatusCd(StatusCdFields),
    /// A rest until a client resumes the node.
    #[serde(deserialize_with = "object")]
    WaitResume(WaitResumeFields),
    /// A relative move with ESP-IDF's smoothstep at both ends.
    #[serde(deserialize_with = "object")]
    SmoothRamp(SmoothRampFields),
    /// An absolute move with ESP-IDF's smoothstep at both ends.
    #[serde(deserialize_with = "object")]
    SmoothRampTo(SmoothRampToFields),
}

/// Reads the fields of a command. In text they have names: serde alone would take an array, too.
pub(super) fn object<'de, D, T>(reader: D) -> Result<T, D::Error>
where
    D: Deserializer<'de>,
    T: Deserialize<'de>,
{
    struct Named<T>(PhantomData<T>);

    impl<'de, T: Deserialize<'de>> de::Visitor<'de> for Named<T> {
        type Value = T;

        fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
            write!(f, "an object")
        }

        fn visit_map<A: de::MapAccess<'de>>(self, fields: A) -> Result<T, A::Error> {
            T::deserialize(de::value::MapAccessDeserializer::new(fields))
        }
    }

    if reader.is_human_readable() {
        reader.deserialize_map(Named(PhantomData))
    } else {
        T::deserialize(reader)
    }
}

macro_rules! fields {
    ($(#[$doc:meta])* $name:ident { $($(#[$field_doc:meta])* $field:ident: $type:ty,)* }) => {
        $(#[$doc])*
        #[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
        #[serde(deny_unknown_fields)]
        pub struct $name {
            $($(#[$field_doc])* pub $field: $type,)*
        }
    };
}

fields! {
    /// Fields of `move`.
    MoveFields {
        /// Axis number, from 0.
        axis: u8,
        /// Time between steps, µs, from 1.
        delay_us: u32,
        /// Steps with sign, never 0.
        steps: i32,
    }
}
fields! {
    /// Fields of `sync_move`.
    SyncMoveFields {
        /// Time between steps of axes 0 and 1, µs, from 1.
        delay_us: [u32; 2],
        /// Steps with sign of axes 0 and 1, never 0.
        steps: [i32; 2],
    }
}
fields! {
    /// Fields of `ramp`.
    RampFields {
        /// Axis number, from 0.
        axis: u8,
        /// Steps with sign, never 0.
        steps: i32,
        /// Speed, Hz, 1 to [`SPEED_HZ_MAX`].
        speed_hz: u32,
        /// Acceleration, steps/s², from 1.
        accel: u32,
        /// Jerk, steps/s³; makes it an S-curve.
        #[serde(default)]
        jerk: Option<u32>,
        /// Steps of linearly growing acceleration.
        #[serde(default)]
        linear_steps: u16,
        /// Steps whose speed the move starts with.
        #[serde(default)]
        jump_steps: u16,
    }
}
fields! {
    /// Fields of `ramp_to`.
    RampToFields {
        /// Axis number, from 0.
        axis: u8,
        /// Target, steps.
        position: i64,
        /// Speed, Hz, 1 to [`SPEED_HZ_MAX`].
        speed_hz: u32,
        /// Acceleration, steps/s², from 1.
        accel: u32,
        /// Jerk, steps/s³; makes it an S-curve.
        #[serde(default)]
        jerk: Option<u32>,
        /// Steps of linearly growing acceleration.
        #[serde(default)]
        linear_steps: u16,
        /// Steps whose speed the move starts with.
        #[serde(default)]
        jump_steps: u16,
    }
}
fields! {
    /// Fields of `line`.
    LineFields {
        /// Steps with sign of each axis from 0 on, one to four of them, not all 0.
        steps: Vec<i32>,
        /// Speed of the axis with most steps, Hz, 1 to [`SPEED_HZ_MAX`].
        speed_hz: u32,
        /// Its acceleration, steps/s², from 1.
        accel: u32,
        /// Its jerk, steps/s³.
        #[serde(default)]
        jerk: Option<u32>,
    }
}
fields! {
    /// Fields of `pause`.
    PauseFields {
        /// Duration, ms.
        ms: u32,
    }
}
fields! {
    /// Fields of `laser`.
    LaserFields {
        /// Power, 0 to 100 %.
        power_percent: u8,
    }
}
fields! {
    /// `lidar_read` has no fields.
    LidarReadFields {}
}
fields! {
    /// Fields of `home`.
    HomeFields {
        /// Axis number, from 0.
        axis: u8,
    }
}
fields! {
    /// Fields of `set_position`.
    SetPositionFields {
        /// Axis number, from 0.
        axis: u8,
        /// Its new position, steps.
        position: i64,
    }
}
fields! {
    /// Fields of `wait_resume`: none.
    WaitResumeFields {}
}
fields! {
    /// Fields of `smooth_ramp`. (Not of `ramp`: in postcard fields have places, not names, and
    /// `accel` means nothing here.)
    SmoothRampFields {
        /// Axis number, from 0.
        axis: u8,
        /// Steps with sign, never 0.
        steps: i32,
        /// First and last speed, Hz, from 1, below `speed_hz`.
        start_hz: u32,
        /// Speed, Hz, 2 to [`SPEED_HZ_MAX`].
        speed_hz: u32,
        /// Steps from the first speed to `speed_hz`, from 2; a shorter move turns back half way.
        ramp_steps: u32,
    }
}
fields! {
    /// Fields of `smooth_ramp_to`.
    SmoothRampToFields {
        /// Axis number, from 0.
        axis: u8,
        /// Target, steps.
        position: i64,
        /// First and last speed, Hz, from 1, below `speed_hz`.
        start_hz: u32,
        /// Speed, Hz, 2 to [`SPEED_HZ_MAX`].
        speed_hz: u32,
        /// Steps from the first speed to `speed_hz`, from 2; a shorter move turns back half way.
        ramp_steps: u32,
    }
}
fields! {
    /// Fields of `barrier`.
    BarrierFields {
        /// Name of the meeting point, the same in every part that meets there.
        name: String,
    }
}
fields! {
    /// Fields of `movc`.
    MoveCFields {
        /// Number of the position, 0 to [`POSITION_C_MAX`]. Wide, so that every wrong one gets the
        /// same answer.
        position: i64,
    }
}
fields! {
    /// Fields of `movd`.
    MoveDFields {
        /// To ON, else to OFF.
        on: bool,
    }
}
fields! {
    /// `statcd` has no fields.
    StatusCdFields {}
}

/// What is wrong with a command, without its index.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct CommandError {
    /// The command's word and the field: `move.delay_us`.
    pub place: String,
    /// What is wrong there.
    pub message: String,
}

impl CommandError {
    /// Makes it the error of the command at this index of its job.
    pub fn at(&self, index: usize) -> JobError {
        let Self { place, message } = self;
        JobError::new(
            ErrorCode::BadCommand,
            format!("commands[{index}].{place}: {message}"),
        )
    }
}

impl JobCommand {
    /// Returns the word that names the command in JSON.
    pub const fn word(&self) -> &'static str {
        match self {
            Self::Move(_) => "move",
            Self::SyncMove(_) => "sync_move",
            Self::Ramp(_) => "ramp",
            Self::RampTo(_) => "ramp_to",
            Self::Line(_) => "line",
            Self::Pause(_) => "pause",
            Self::Laser(_) => "laser",
            Self::LidarRead(_) => "lidar_read",
            Self::Home(_) => "home",
            Self::SetPosition(_) => "set_position",
            Self::Barrier(_) => "barrier",
            Self::MoveC(_) => "movc",
            Self::MoveD(_) => "movd",
            Self::StatusCd(_) => "statcd",
            Self::WaitResume(_) => "wait_resume",
            Self::SmoothRamp(_) => "smooth_ramp",
            Self::SmoothRampTo(_) => "smooth_ramp_to",
        }
    }

    fn error(&self, field: &str, message: impl Into<String>) -> CommandError {
        let word = self.word();
        let place = if field.is_empty() {
            word.into()
        } else {
            format!("{word}.{field}")
        };
        CommandError {
            place,
            message: message.into(),
        }
    }

    /// Checks the ranges that the types do not.
    ///
    /// # Errors
    /// The first value that is out of range, with its place in the command.
    pub fn check(&self) -> Result<(), CommandError> {
        let delay = |field: &str, delay_us: u32| match delay_us {
            0 => Err(self.error(field, "0 is out of range; it must be at least 1 µs")),
            _ => Ok(()),
        };
        let steps = |field: &str, steps: i32| match steps {
            0 => Err(self.error(field, "0 steps move nothing; it must not be 0")),
            i32::MIN => Err(self.error(field, "out of range; at most 2147483647 steps either way")),
            _ => Ok(()),
        };
        let duration = |field: &str, delay_us: u32, steps: i32| {
            let takes_us = u64::from(delay_us) * u64::from(steps.unsigned_abs());
            if takes_us > MOVE_US_MAX {
                return Err(self.error(
                    field,
                    format!(
                        "{delay_us} is out of range; with so many steps at most {} µs",
                        MOVE_US_MAX / u64::from(steps.unsigned_abs())
                    ),
                ));
            }
            Ok(())
        };
        let positive = |field: &str, value: u32| match value {
            0 => Err(self.error(field, "0 is out of range; it must be at least 1")),
            _ => Ok(()),
        };
        let speed = |speed_hz: u32| match speed_hz {
            1..=SPEED_HZ_MAX => Ok(()),
            _ => {
                let message = format!("{speed_hz} is out of range; 1 to {SPEED_HZ_MAX}");
                Err(self.error("speed_hz", message))
            }
        };
        let shape = |jerk: Option<u32>, linear_steps: u16, jump_steps: u16| match jerk {
            Some(0) => Err(self.error("jerk", "0 is out of range; leave it out for no limit")),
            Some(_) if linear_steps != 0 || jump_steps != 0 => {
                Err(self.error("jerk", "cannot be combined with linear_steps or jump_steps"))
            }
            _ => Ok(()),
        };
        let smooth = |start_hz: u32, speed_hz: u32, ramp_steps: u32| {
            speed(speed_hz)?;
            positive("start_hz", start_hz)?;
            if start_hz >= speed_hz {
                let message = format!("{start_hz} is out of range; it must be below speed_hz");
                return Err(self.error("start_hz", message));
            }
            if ramp_steps < 2 {
                let message = format!("{ramp_steps} is out of range; it must be at least 2");
                return Err(self.error("ramp_steps", message));
            }
            Ok(())
        };
        match self {
            Self::Move(fields) => {
                delay("delay_us", fields.delay_us)?;
                steps("steps", fields.steps)?;
                duration("delay_us", fields.delay_us, fields.steps)
            }
            Self::SyncMove(fields) => {
                for index in 0..2 {
                    delay(&format!("delay_us[{index}]"), fields.delay_us[index])?;
                    steps(&format!("steps[{index}]"), fields.steps[index])?;
                    let place = format!("delay_us[{index}]");
                    duration(&place, fields.delay_us[index], fields.steps[index])?;
                }
                Ok(())
            }
            Self::Ramp(fields) => {
                steps("steps", fields.steps)?;
                speed(fields.speed_hz)?;
                positive("accel", fields.accel)?;
                shape(fields.jerk, fields.linear_steps, fields.jump_steps)
            }
            Self::RampTo(fields) => {
                speed(fields.speed_hz)?;
                positive("accel", fields.accel)?;
                shape(fields.jerk, fields.linear_steps, fields.jump_steps)
            }
            Self::SmoothRamp(fields) => {
                steps("steps", fields.steps)?;
                smooth(fields.start_hz, fields.speed_hz, fields.ramp_steps)
            }
            Self::SmoothRampTo(fields) => {
                smooth(fields.start_hz, fields.speed_hz, fields.ramp_steps)
            }
            Self::Line(fields) => {
                if fields.steps.is_empty() || fields.steps.len() > LINE_AXES {
                    let message =
                        format!("{} axes; it must be 1 to {LINE_AXES}", fields.steps.len());
                    return Err(self.error("steps", message));
                }
                if fields.steps.contains(&i32::MIN) {
                    return Err(self.error("steps", "at most 2147483647 steps either way"));
                }
                if fields.steps.iter().all(|count| *count == 0) {
                    return Err(self.error("steps", "all 0: nothing would move"));
                }
                speed(fields.speed_hz)?;
                positive("accel", fields.accel)?;
                shape(fields.jerk, 0, 0)
            }
            Self::Pause(fields) if fields.ms > PAUSE_MS_MAX => {
                let message = format!(
                    "{} is out of range; at most {PAUSE_MS_MAX} (a day)",
                    fields.ms
                );
                Err(self.error("ms", message))
            }
            Self::Laser(fields) if fields.power_percent > 100 => {
                let message = format!("{} is out of range; 0 to 100", fields.power_percent);
                Err(self.error("power_percent", message))
            }
            Self::Barrier(fields)
                if fields.name.is_empty() || fields.name.len() > BARRIER_BYTES_MAX =>
            {
                Err(self.error("name", format!("must have 1 to {BARRIER_BYTES_MAX} bytes")))
            }
            Self::MoveC(fields) if !(0..=i64::from(POSITION_C_MAX)).contains(&fields.position) => {
                let message = format!("Invalid C position (0-{POSITION_C_MAX})");
                Err(self.error("position", message))
            }
            Self::Pause(_)
            | Self::Laser(_)
            | Self::LidarRead(_)
            | Self::Home(_)
            | Self::SetPosition(_)
            | Self::Barrier(_)
            | Self::MoveC(_)
            | Self::MoveD(_)
            | Self::StatusCd(_)
            | Self::WaitResume(_) => Ok(()),
        }
    }
}
