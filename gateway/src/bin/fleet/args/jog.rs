//! What can be typed about moves by hand.

use clap::Args;
use keys::{
    NodeId,
    jog::{JogWay, LEASE_MS_DEFAULT, LEASE_MS_MAX, LEASE_MS_MIN},
};

#[derive(Debug, Args)]
#[command(group = clap::ArgGroup::new("what").required(true))]
pub(crate) struct Jog {
    /// Node.
    #[arg(value_name = "NODE")]
    pub(crate) node: NodeId,

    /// Axis number, from 0.
    #[arg(long, required_unless_present = "stop")]
    pub(crate) axis: Option<u8>,

    /// To this position, steps.
    #[arg(
        long,
        value_name = "POSITION",
        group = "what",
        allow_hyphen_values = true
    )]
    pub(crate) to: Option<i64>,

    /// So many steps from where it is going.
    #[arg(long, value_name = "STEPS", group = "what", allow_hyphen_values = true)]
    pub(crate) by: Option<i64>,

    /// One step.
    #[arg(long, value_name = "+|-", group = "what", value_parser = way, allow_hyphen_values = true)]
    pub(crate) step: Option<JogWay>,

    /// On and on, until this command ends.
    #[arg(long, value_name = "+|-", group = "what", value_parser = way, allow_hyphen_values = true)]
    pub(crate) run: Option<JogWay>,

    /// Comes to rest by its ramp; without --axis all of them.
    #[arg(long, group = "what")]
    pub(crate) stop: bool,

    /// Speed, Hz.
    #[arg(long, default_value_t = 500, value_name = "HZ")]
    pub(crate) speed: u32,

    /// Acceleration, steps/s².
    #[arg(long, default_value_t = 2_000, value_name = "STEPS/S2")]
    pub(crate) accel: u32,

    /// Jerk, steps/s³: makes it an S-curve.
    #[arg(long, value_name = "STEPS/S3")]
    pub(crate) jerk: Option<u32>,

    /// How long a run goes on when this command is gone, ms.
    #[arg(long, default_value_t = LEASE_MS_DEFAULT, value_name = "MS",
        value_parser = clap::value_parser!(u32).range(i64::from(LEASE_MS_MIN)..=i64::from(LEASE_MS_MAX)))]
    pub(crate) lease: u32,
}

fn way(text: &str) -> Result<JogWay, String> {
    match text {
        "+" | "forward" => Ok(JogWay::Forward),
        "-" | "backward" => Ok(JogWay::Backward),
        _ => Err("+ or -".into()),
    }
}
