//! The machine around an emulated board: where the switches are that `fleet provision` has told it of.
//!
//! A record says which switches there are, not where. The places are those of the options `--limit` and
//! `--home`; else those of a bed that every axis is switched on near the low end of. C and D have theirs
//! where their tables end. A switch that was not told is not looked at, wherever it is; the probe is
//! pressed by nobody.

use crate::{
    config::EmulatorConfig,
    machine::MachineSwitch,
    pins::{CARRIAGE_C, CARRIAGE_D},
};
use motion::{
    ConfigCd, MotionConfig,
    io::{
        input::{INPUTS_MAX, Role, Switch},
        named::POSITIONS_C,
    },
};
use std::ops::RangeInclusive;

/// The low limit of an axis, steps from where it is switched on.
const LOW_STEPS: i64 = -1_000;

/// The high limit.
const HIGH_STEPS: i64 = 100_000;

/// The places of a home switch.
const HOME_STEPS: RangeInclusive<i64> = -900..=-500;

/// The limits of C lie so far outside its positions: 0.3 mm.
pub const CD_MARGIN_STEPS: i64 = 24;

/// It is released so far outside the place where it is pressed.
const HYSTERESIS_STEPS: u64 = 5;

/// Returns the switches of the machine, one for each input, by what a node knows and the
/// options say.
pub(crate) fn switches(motion: &MotionConfig, base: &EmulatorConfig) -> Vec<MachineSwitch> {
    let inputs = (0..INPUTS_MAX).map_while(|index| motion.inputs.get(index));
    let switches = inputs.enumerate().filter_map(|(input, told)| {
        let (carriage, pressed) = place_of(told.role, motion.cd.as_ref())?;
        let by_option = base.machine.switches.iter().find(|switch| {
            let wired = base.motion.inputs.get(switch.input);
            wired.is_some_and(|wired| wired.role == told.role)
        });
        Some(MachineSwitch {
            input,
            carriage,
            pressed: by_option.map_or(pressed, |switch| switch.pressed.clone()),
            hysteresis_steps: HYSTERESIS_STEPS,
        })
    });
    switches.collect()
}

fn place_of(role: Role, cd: Option<&ConfigCd>) -> Option<(usize, RangeInclusive<i64>)> {
    Some(match role {
        Role::Axis { axis, switch } => {
            let pressed = match switch {
                Switch::Min => i64::MIN..=LOW_STEPS,
                Switch::Max => HIGH_STEPS..=i64::MAX,
                Switch::Home => HOME_STEPS,
            };
            (axis.index(), pressed)
        }
        Role::C(switch) => {
            let high = cd.map(|cd| ends(cd)[0]).unwrap_or_default() + CD_MARGIN_STEPS;
            (CARRIAGE_C, at_end(switch, -CD_MARGIN_STEPS, high))
        }
        Role::D(switch) => {
            let high = cd.map(|cd| ends(cd)[1]).unwrap_or_default();
            (CARRIAGE_D, at_end(switch, 0, high))
        }
        // Pressed by nobody, and so released.
        Role::Probe => (0, i64::MAX..=i64::MAX),
        // The stop is no switch of the record.
        Role::Stop => return None,
    })
}

fn at_end(switch: Switch, low: i64, high: i64) -> RangeInclusive<i64> {
    match switch {
        Switch::Max => high..=i64::MAX,
        Switch::Min | Switch::Home => i64::MIN..=low,
    }
}

/// Returns the last positions of C and D, steps.
pub(crate) fn ends(cd: &ConfigCd) -> [i64; 2] {
    let steps = |um: i64, per_m: u32| um * i64::from(per_m) / 1_000_000;
    let last = cd.c.positions[POSITIONS_C - 1].position_um;
    [
        steps(i64::from(last), cd.c.steps_per_m),
        steps(i64::from(cd.d.travel_um), cd.d.steps_per_m),
    ]
}
