//! Jogging by hand: moves of single axes that nobody queues, on the key `jog`, by get.
//!
//! ```text
//!   client                                              node
//!     get {"axis":0,"run":"forward","speed_hz":800,"accel":2000} ─▶  speeds up
//!       ◀── {"node":"left","axis":0,"jog":7,"lease_ms":500,…}
//!     get {"renew":7} ─────────────────────────────────▶  goes on for 500 ms more
//!     get {"axis":0,"stop":true} ──────────────────────▶  slows down and rests
//!                       nothing for 500 ms ────────────▶  slows down and rests
//! ```
//!
//! A run has no end of its own, so it has a lease: whoever holds the button renews it, and if nobody
//! does, the axis comes to rest by its own ramp. A renewal names the jog that it is for: one that comes
//! late, or from somebody whose jog another one has replaced, moves nothing. The node itself answers,
//! so nothing between a button and its motor has to be trusted but the network.
//!
//! Owns the words, their ranges, and what they mean together. JSON is read by whoever has an allocator.

use crate::{
    AxisId,
    command::{Ramp, RampShape},
};
use serde::{Deserialize, Serialize};

/// Lease of a run when nothing is said, ms.
pub const LEASE_MS_DEFAULT: u32 = 500;

/// Shortest lease, ms: a renewal has to cross a network.
pub const LEASE_MS_MIN: u32 = 50;

/// Longest lease, ms.
pub const LEASE_MS_MAX: u32 = 10_000;

/// Greatest speed, Hz. What the drivers allow is less.
pub const SPEED_HZ_MAX: u32 = 1_000_000;

/// Most bytes of a request.
pub const REQUEST_BYTES_MAX: usize = 1_024;

/// Which way.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum JogWay {
    /// To higher positions.
    Forward,
    /// To lower ones.
    Backward,
}

/// A request as clients write it. Exactly one of `to`, `by`, `run`, `accelerate`, `coast`, `stop` and
/// `renew`.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct JogRequest {
    /// Axis number, from 0. `stop` without one means all of them, `renew` needs none.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub axis: Option<u8>,
    /// To this position, steps.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub to: Option<i64>,
    /// So many steps from its present target; 0 changes its speed and acceleration only.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub by: Option<i64>,
    /// On and on.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub run: Option<JogWay>,
    /// On and on by this acceleration, steps/s²: its sign is the way. Less than 0 while it moves
    /// forward: it slows down, turns, and runs backward.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub accelerate: Option<i32>,
    /// `true`: on and on at the speed that it has now.
    #[serde(skip_serializing_if = "is_false")]
    pub coast: bool,
    /// `true`: comes to rest by its ramp.
    #[serde(skip_serializing_if = "is_false")]
    pub stop: bool,
    /// The number of a jog that goes on.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub renew: Option<u32>,
    /// Speed, Hz, 1 to [`SPEED_HZ_MAX`].
    #[serde(skip_serializing_if = "Option::is_none")]
    pub speed_hz: Option<u32>,
    /// Acceleration, steps/s², from 1.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub accel: Option<u32>,
    /// Jerk, steps/s³, from 1: makes it an S-curve.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub jerk: Option<u32>,
    /// How long it goes on without a renewal, ms, [`LEASE_MS_MIN`] to [`LEASE_MS_MAX`]. A move to a
    /// place has none unless it is said.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub lease_ms: Option<u32>,
}

fn is_false(value: &bool) -> bool {
    !value
}

/// Where a jog leads.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum JogTarget {
    /// To this position.
    To(i64),
    /// So many steps from its present target.
    By(i64),
    /// On and on.
    Run(JogWay),
}

/// What a request means.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum JogOrder {
    /// Moves an axis, or changes how it moves.
    Move {
        /// The axis.
        axis: AxisId,
        /// Where to.
        target: JogTarget,
        /// How.
        ramp: Ramp,
        /// How long without a renewal; `None`: the usual one if it has no end.
        lease_ms: Option<u32>,
    },
    /// Keeps the present speed.
    Coast {
        /// The axis.
        axis: AxisId,
        /// How long without a renewal; `None`: the usual one.
        lease_ms: Option<u32>,
    },
    /// Comes to rest.
    Stop {
        /// The axis; `None`: all.
        axis: Option<AxisId>,
    },
    /// Goes on.
    Renew {
        /// The jog.
        jog: u32,
    },
}

/// What is wrong with a request, and where.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct JogError {
    /// The field; empty: the whole.
    pub place: &'static str,
    /// What is wrong with it.
    pub message: &'static str,
}

impl core::fmt::Display for JogError {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        if !self.place.is_empty() {
            write!(f, "{}: ", self.place)?;
        }
        f.write_str(self.message)
    }
}

impl core::error::Error for JogError {}

const fn wrong<T>(place: &'static str, message: &'static str) -> Result<T, JogError> {
    Err(JogError { place, message })
}

impl JogRequest {
    /// Returns what it means.
    ///
    /// # Errors
    /// The first thing that is missing, too much, or out of range.
    pub fn order(&self) -> Result<JogOrder, JogError> {
        let verbs = [
            self.to.is_some(),
            self.by.is_some(),
            self.run.is_some(),
            self.accelerate.is_some(),
            self.coast,
            self.stop,
            self.renew.is_some(),
        ];
        if verbs.iter().filter(|said| **said).count() != 1 {
            return wrong(
                "",
                "exactly one of to, by, run, accelerate, coast, stop and renew",
            );
        }
        if let Some(lease_ms) = self.lease_ms
            && !(LEASE_MS_MIN..=LEASE_MS_MAX).contains(&lease_ms)
        {
            return wrong("lease_ms", "out of range; 50 to 10000");
        }
        if let Some(jog) = self.renew {
            let bare = Self {
                renew: Some(jog),
                ..Self::default()
            };
            return match *self == bare {
                true => Ok(JogOrder::Renew { jog }),
                false => wrong("renew", "it stands alone; the lease stays as it was"),
            };
        }
        let has_ramp = self.speed_hz.is_some() || self.accel.is_some() || self.jerk.is_some();
        if (self.stop || self.coast) && has_ramp {
            return wrong(
                "",
                "stop and coast have neither speed_hz nor accel nor jerk",
            );
        }
        let axis = self.axis.map(AxisId);
        if self.stop {
            return match self.lease_ms {
                None => Ok(JogOrder::Stop { axis }),
                Some(_) => wrong("lease_ms", "not with stop"),
            };
        }
        let Some(axis) = axis else {
            return wrong("axis", "missing");
        };
        let lease_ms = self.lease_ms;
        if self.coast {
            return Ok(JogOrder::Coast { axis, lease_ms });
        }
        let target = match (self.to, self.by, self.run, self.accelerate) {
            (Some(to), ..) => JogTarget::To(to),
            (_, Some(by), ..) => JogTarget::By(by),
            (.., Some(run), _) => JogTarget::Run(run),
            (.., Some(accel)) if accel < 0 => JogTarget::Run(JogWay::Backward),
            _ => JogTarget::Run(JogWay::Forward),
        };
        let accel_hz_per_s = match (self.accelerate, self.accel) {
            (Some(0), _) => return wrong("accelerate", "0 keeps the speed: that is coast"),
            (Some(_), Some(_)) => return wrong("accel", "not with accelerate, which is one"),
            (Some(accel), None) => accel.unsigned_abs(),
            (None, Some(accel)) => accel,
            (None, None) => return wrong("accel", "missing"),
        };
        if accel_hz_per_s == 0 {
            return wrong("accel", "0 is out of range; it must be at least 1");
        }
        let speed_hz = match self.speed_hz {
            Some(speed_hz @ 1..=SPEED_HZ_MAX) => speed_hz,
            Some(_) => return wrong("speed_hz", "out of range; 1 to 1000000"),
            None => return wrong("speed_hz", "missing"),
        };
        let shape = match self.jerk {
            Some(0) => return wrong("jerk", "0 is out of range; leave it out for no limit"),
            Some(jerk_hz_per_s2) => RampShape::Jerk { jerk_hz_per_s2 },
            None => RampShape::Trapezoid {
                linear_steps: 0,
                jump_steps: 0,
            },
        };
        Ok(JogOrder::Move {
            axis,
            target,
            ramp: Ramp {
                speed_hz,
                accel_hz_per_s,
                shape,
            },
            lease_ms,
        })
    }
}

/// What a node answers to a request that it has taken: how things are now.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct JogReceipt<'n> {
    /// The node.
    #[serde(borrow)]
    pub node: &'n str,
    /// The axis; `null` for a stop of all.
    pub axis: Option<u8>,
    /// The number of the jog, for renewals; `null` for a stop.
    pub jog: Option<u32>,
    /// Its lease; `null`: it ends by itself.
    pub lease_ms: Option<u32>,
    /// Position of the axis, steps; for a stop of all, of axis 0.
    pub position: i64,
    /// Whether anything that is jogged moves, or is about to.
    pub moving: bool,
}

/// What it answers to one that it has not.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
pub struct JogRefusal<'m> {
    /// Its one field.
    pub error: JogRefusalError<'m>,
}

/// See [`JogRefusal`].
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
pub struct JogRefusalError<'m> {
    /// `bad_json`, `bad_command`, `stopped` or `not_allowed`.
    pub code: &'static str,
    /// Why.
    pub message: &'m str,
}

#[cfg(test)]
mod tests {
    use super::*;

    fn run(run: JogWay) -> JogRequest {
        JogRequest {
            axis: Some(1),
            run: Some(run),
            speed_hz: Some(800),
            accel: Some(2_000),
            ..JogRequest::default()
        }
    }

    #[test]
    fn a_request_says_exactly_one_thing() {
        let two = JogRequest {
            by: Some(1),
            ..run(JogWay::Forward)
        };
        for request in [JogRequest::default(), two] {
            let place = request.order().expect_err("it says none or two").place;
            assert_eq!(place, "");
        }
        let renewed_and_more = JogRequest {
            renew: Some(3),
            axis: Some(0),
            ..JogRequest::default()
        };
        assert_eq!(
            renewed_and_more.order().map_err(|error| error.place),
            Err("renew")
        );
        let renewed = JogRequest {
            axis: None,
            ..renewed_and_more
        };
        assert_eq!(renewed.order(), Ok(JogOrder::Renew { jog: 3 }));
    }

    #[test]
    fn what_is_missing_or_out_of_range_is_named() {
        let good = run(JogWay::Backward);
        assert!(good.order().is_ok());
        let place = |request: JogRequest| request.order().map_err(|error| error.place);
        for (request, expected) in [
            (JogRequest { axis: None, ..good }, "axis"),
            (
                JogRequest {
                    accel: None,
                    ..good
                },
                "accel",
            ),
            (
                JogRequest {
                    accel: Some(0),
                    ..good
                },
                "accel",
            ),
            (
                JogRequest {
                    speed_hz: None,
                    ..good
                },
                "speed_hz",
            ),
            (
                JogRequest {
                    speed_hz: Some(0),
                    ..good
                },
                "speed_hz",
            ),
            (
                JogRequest {
                    jerk: Some(0),
                    ..good
                },
                "jerk",
            ),
            (
                JogRequest {
                    lease_ms: Some(49),
                    ..good
                },
                "lease_ms",
            ),
            (
                JogRequest {
                    run: None,
                    accelerate: Some(-5),
                    ..good
                },
                "accel",
            ),
            (
                JogRequest {
                    run: None,
                    accel: None,
                    accelerate: Some(0),
                    ..good
                },
                "accelerate",
            ),
        ] {
            assert_eq!(place(request), Err(expected));
        }
    }

    #[test]
    fn an_acceleration_says_the_way_by_its_sign() {
        let request = JogRequest {
            run: None,
            accel: None,
            accelerate: Some(-500),
            ..run(JogWay::Forward)
        };
        let Ok(JogOrder::Move { target, ramp, .. }) = request.order() else {
            panic!("it moves");
        };
        assert_eq!(target, JogTarget::Run(JogWay::Backward));
        assert_eq!(ramp.accel_hz_per_s, 500);
    }
}
