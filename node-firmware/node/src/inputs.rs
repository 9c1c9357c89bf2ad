//! What the inputs and the axes at their limits mean for the node: stops, faults, log lines.
//!
//! Owns the wording. A limit stops by [`StopReason::Limit`]: its own fault, its own latch. Homing
//! that fails is a fault like any other. A stop input is the stop pin, from wherever it is told.

use crate::{Node, Outputs, local_from_ticks, outbox::Line};
use core::fmt::Write;
use keys::{AxisId, LocalMicros, StopMode, StopReason, status::FaultCode};
use motion::{
    CdError, LimitHit, StepBackend,
    io::{
        home::HomeError,
        input::{Role, Switch},
        shift::ShiftFault,
    },
};

/// Returns the input that a script calls by this name: `stop`, `probe`, `0:min`, `0:max`, `0:home` and so
/// on for the axes, `c:min`, `c:max`, `d:min`, `d:max`.
fn role_of(name: &str) -> Option<Role> {
    let (of, switch) = match name {
        "stop" => return Some(Role::Stop),
        "probe" => return Some(Role::Probe),
        _ => name.split_once(':')?,
    };
    let switch = match switch {
        "min" => Switch::Min,
        "max" => Switch::Max,
        "home" => Switch::Home,
        _ => return None,
    };
    match of.as_bytes() {
        b"c" => Some(Role::C(switch)),
        b"d" => Some(Role::D(switch)),
        [digit @ b'0'..=b'9'] => Some(Role::Axis {
            axis: AxisId(digit - b'0'),
            switch,
        }),
        _ => None,
    }
}

impl<B: StepBackend, O: Outputs> Node<'_, B, O> {
    /// Returns whether an input is active; `None`: the configuration has none of this name. The stop
    /// is always there, from wherever it comes.
    pub(crate) fn input_named(&self, name: &str) -> Option<bool> {
        let role = role_of(name)?;
        if role == Role::Stop {
            return Some(self.stop_pin_active || self.motion.is_input_active(role));
        }
        let has = self.config.motion.inputs.has(role);
        has.then(|| self.motion.is_input_active(role))
    }

    /// The stop is demanded, or no longer.
    pub(crate) fn take_stop_pin(&mut self, active: bool, now: LocalMicros) {
        self.stop_pin_active = active;
        if active {
            self.begin_stop(StopReason::Pin, StopMode::Halt, now);
        }
    }

    /// An axis is at a limit.
    pub(crate) fn reach_limit(
        &mut self,
        axis: AxisId,
        position_steps: i64,
        hit: LimitHit,
        now: LocalMicros,
    ) {
        self.note_fault(FaultCode::LIMIT, now);
        self.log(
            now,
            format_args!("axis {}: {hit}; it is at {position_steps}", axis.0),
        );
        let mode = self.config.motion.limit_stop;
        self.begin_stop(StopReason::Limit, mode, self.moved_until(now));
    }

    pub(crate) fn note_homed(&mut self, axis: AxisId, position_steps: i64, now: LocalMicros) {
        self.log(
            now,
            format_args!("axis {}: homed; it is at {position_steps}", axis.0),
        );
    }

    /// Homing failed: nothing behind it knows where it would be.
    pub(crate) fn fail_homing(
        &mut self,
        axis: AxisId,
        position_steps: i64,
        error: HomeError,
        now: LocalMicros,
    ) {
        self.note_fault(FaultCode::HOMING, now);
        self.log(
            now,
            format_args!("axis {}: {error}; it is at {position_steps}", axis.0),
        );
        self.begin_stop(StopReason::Fault, StopMode::Halt, now);
    }

    /// C or D is not where it was sent.
    pub(crate) fn fail_cd(&mut self, error: CdError, now: LocalMicros) {
        self.note_fault(FaultCode::NOT_THERE, now);
        self.log(now, format_args!("{error}"));
        self.begin_stop(StopReason::Fault, StopMode::Halt, now);
    }

    /// The shift register does not follow: drivers may be off that should be on.
    pub(crate) fn fail_shift(&mut self, fault: ShiftFault, now: LocalMicros) {
        self.note_fault(FaultCode::SHIFT_REGISTER, now);
        self.log(now, format_args!("{fault}"));
        self.begin_stop(StopReason::Fault, StopMode::Halt, now);
    }

    /// Says where C and D are.
    pub(crate) fn tell_status_cd(&mut self, now: LocalMicros) {
        let mut text = Line::new();
        if let Some(status) = self.motion.status_cd()
            && write!(text, "{status}").is_ok()
        {
            self.log(now, format_args!("{text}"));
        }
    }

    /// The probe touched, or no longer: where everything was is in the log.
    pub(crate) fn take_probe(&mut self, active: bool, positions_steps: &[i64], now: LocalMicros) {
        let axis_count = self.motion.axis_count();
        let positions_steps = &positions_steps[..axis_count];
        let what = if active { "touched" } else { "released" };
        self.log(now, format_args!("probe: {what} at {positions_steps:?}"));
        if let Some(mode) = self.config.motion.probe_stop
            && active
            && self.motion.is_active()
        {
            self.begin_stop(StopReason::Pin, mode, self.moved_until(now));
        }
    }

    /// Up to when motion has played: not farther than what it tells of now.
    fn moved_until(&self, now: LocalMicros) -> LocalMicros {
        local_from_ticks(self.motion.now()).min(now)
    }
}
