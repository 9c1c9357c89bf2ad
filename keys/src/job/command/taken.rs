//! What a node takes for each command of a job.

use super::JobCommand;
use crate::{
    AxisId, Command,
    command::{BARRIER_RESUME, LINE_AXES, Ramp, RampShape},
};

impl JobCommand {
    /// Returns the command as a node takes it. `barrier_from_name` numbers the meeting points.
    pub fn to_command(&self, barrier_from_name: impl FnOnce(&str) -> u16) -> Command {
        let shape = |jerk: Option<u32>, linear_steps, jump_steps| match jerk {
            Some(jerk_hz_per_s2) => RampShape::Jerk { jerk_hz_per_s2 },
            None => RampShape::Trapezoid {
                linear_steps,
                jump_steps,
            },
        };
        let smooth = |start_hz, speed_hz, ramp_steps| Ramp {
            speed_hz,
            accel_hz_per_s: 0,
            shape: RampShape::Smooth {
                start_hz,
                ramp_steps,
            },
        };
        match self {
            Self::Move(f) => Command::Move {
                axis: AxisId(f.axis),
                delay_us: f.delay_us,
                steps: f.steps,
            },
            Self::SyncMove(f) => Command::SyncMove {
                delay_us: f.delay_us,
                steps: f.steps,
            },
            Self::Ramp(f) => Command::Ramp {
                axis: AxisId(f.axis),
                steps: f.steps,
                ramp: Ramp {
                    speed_hz: f.speed_hz,
                    accel_hz_per_s: f.accel,
                    shape: shape(f.jerk, f.linear_steps, f.jump_steps),
                },
            },
            Self::RampTo(f) => Command::RampTo {
                axis: AxisId(f.axis),
                position_steps: f.position,
                ramp: Ramp {
                    speed_hz: f.speed_hz,
                    accel_hz_per_s: f.accel,
                    shape: shape(f.jerk, f.linear_steps, f.jump_steps),
                },
            },
            Self::Line(f) => {
                let mut steps = [0; LINE_AXES];
                for (to, from) in steps.iter_mut().zip(&f.steps) {
                    *to = *from;
                }
                Command::Line {
                    steps,
                    speed_hz: f.speed_hz,
                    accel_hz_per_s: f.accel,
                    jerk_hz_per_s2: f.jerk.unwrap_or(0),
                }
            }
            Self::Pause(f) => Command::Pause { pause_ms: f.ms },
            Self::Laser(f) => Command::Laser {
                power_percent: f.power_percent,
            },
            Self::LidarRead(_) => Command::LidarRead,
            Self::Home(f) => Command::Home {
                axis: AxisId(f.axis),
            },
            Self::SetPosition(f) => Command::SetPosition {
                axis: AxisId(f.axis),
                position_steps: f.position,
            },
            Self::Barrier(f) => Command::Barrier {
                barrier: barrier_from_name(&f.name),
            },
            Self::MoveC(f) => Command::MoveC {
                // One that was not checked stays wrong.
                index: u8::try_from(f.position).unwrap_or(u8::MAX),
            },
            Self::MoveD(f) => Command::MoveD { on: f.on },
            Self::StatusCd(_) => Command::StatusCd,
            Self::WaitResume(_) => Command::Barrier {
                barrier: BARRIER_RESUME,
            },
            Self::SmoothRamp(f) => Command::Ramp {
                axis: AxisId(f.axis),
                steps: f.steps,
                ramp: smooth(f.start_hz, f.speed_hz, f.ramp_steps),
            },
            Self::SmoothRampTo(f) => Command::RampTo {
                axis: AxisId(f.axis),
                position_steps: f.position,
                ramp: smooth(f.start_hz, f.speed_hz, f.ramp_steps),
            },
        }
    }
}
