//! How many axes a board has, and which pin of its chip is for what.
//!
//! Only what was told differs from the table of the named kit ([`kit_pin`]). Whether all of it fits together
//! depends on the machine, too, and is found by [`check`]: when a record is kept, and again at the boot.
//!
//! Every default is a row of zero bytes, and fields are only appended.

use crate::{
    chip::{Chip, PinWhy},
    machine::{End, Machine, SwitchOf, SwitchSettings},
};
use core::{fmt, str::FromStr};
use heapless::Vec;
use motion::{
    io::input::{Role, Switch},
    limits::CHANNELS,
};
use serde::{Deserialize, Serialize};

/// Pins that may be told: as many as a chip has that are good for something.
pub const PINS_MAX: usize = 32;

/// Axes of a board that was told no number.
pub const AXES_DEFAULT: usize = 2;

/// What a pin is for. One byte in a record (`code`), which has little room.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(into = "u8", try_from = "u8")]
pub enum PinUse {
    /// Step output of an axis of the queue.
    Step(u8),
    /// Its direction output, high counts up.
    Direction(u8),
    /// An enable output of its own, which goes with [`PinUse::Enable`]; none by default.
    AxisEnable(u8),
    /// The drivers' enable output, high: on.
    Enable,
    /// The laser's output, high: on.
    Laser,
    /// The stop input; open is a stop.
    Stop,
    /// The lamp that says how the node is.
    Lamp,
    /// Step output of C.
    StepC,
    /// Step output of D.
    StepD,
    /// The shift register's data.
    ShiftData,
    /// Its clock.
    ShiftClock,
    /// Its latch.
    ShiftLatch,
    /// What comes back from it.
    ShiftBack,
    /// Where the lidar's line comes in.
    Lidar,
    /// A switch to ground.
    Switch {
        /// Whose.
        of: SwitchOf,
        /// Which.
        end: End,
    },
}

impl PinUse {
    /// Returns the pin of a switch.
    pub const fn of_switch(switch: &SwitchSettings) -> Self {
        Self::Switch {
            of: switch.of,
            end: switch.end,
        }
    }

    /// Returns the pin of an input of motion's; the stop is no switch.
    pub const fn of_role(role: Role) -> Option<Self> {
        let (of, switch) = match role {
            Role::Axis { axis, switch } => (SwitchOf::Axis(axis.0), switch),
            Role::C(switch) => (SwitchOf::C, switch),
            Role::D(switch) => (SwitchOf::D, switch),
            Role::Probe => (SwitchOf::Probe, Switch::Min),
            Role::Stop => return None,
        };
        let end = match switch {
            Switch::Min => End::Min,
            Switch::Max => End::Max,
            Switch::Home => End::Home,
        };
        Some(Self::Switch { of, end })
    }

    /// Returns the axis of the queue that it belongs to.
    const fn axis(self) -> Option<u8> {
        match self {
            Self::Step(axis)
            | Self::Direction(axis)
            | Self::AxisEnable(axis)
            | Self::Switch {
                of: SwitchOf::Axis(axis),
                ..
            } => Some(axis),
            _ => None,
        }
    }

    /// Returns whether a board can be without it.
    const fn is_optional(self) -> bool {
        matches!(
            self,
            Self::AxisEnable(_) | Self::Enable | Self::Laser | Self::Lamp
        )
    }

    /// Returns whether it switches something on that must be off while the chip starts.
    pub(crate) const fn must_start_low(self) -> bool {
        matches!(self, Self::AxisEnable(_) | Self::Enable | Self::Laser)
    }

    /// Returns whether there can be such a use.
    pub fn is_legal(self) -> bool {
        let is_axis = self.axis().is_none_or(|axis| usize::from(axis) < CHANNELS);
        let is_switch = match self {
            Self::Switch { of, end } => SwitchSettings {
                of,
                end,
                normally_closed: false,
                homes: false,
            }
            .is_legal(),
            _ => true,
        };
        is_axis && is_switch
    }
}

impl fmt::Display for PinUse {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match *self {
            Self::Step(axis) => write!(f, "{axis}:step"),
            Self::Direction(axis) => write!(f, "{axis}:dir"),
            Self::AxisEnable(axis) => write!(f, "{axis}:enable"),
            Self::Switch { of, end } => {
                let end = match end {
                    End::Min => "min",
                    End::Max => "max",
                    End::Home => "home",
                };
                match of {
                    SwitchOf::Axis(axis) => write!(f, "{axis}:{end}"),
                    SwitchOf::C => write!(f, "c:{end}"),
                    SwitchOf::D => write!(f, "d:{end}"),
                    SwitchOf::Probe => f.write_str("probe"),
                }
            }
            other => {
                let named = NAMED.iter().find(|(_, of)| *of == other);
                f.write_str(named.map_or("?", |(name, _)| name))
            }
        }
    }
}

/// Those that belong to no axis and are no switch.
const NAMED: [(&str, PinUse); 11] = [
    ("enable", PinUse::Enable),
    ("laser", PinUse::Laser),
    ("stop", PinUse::Stop),
    ("lamp", PinUse::Lamp),
    ("c:step", PinUse::StepC),
    ("d:step", PinUse::StepD),
    ("shift:data", PinUse::ShiftData),
    ("shift:clock", PinUse::ShiftClock),
    ("shift:latch", PinUse::ShiftLatch),
    ("shift:back", PinUse::ShiftBack),
    ("lidar", PinUse::Lidar),
];

impl PinUse {
    /// Returns the number of a legal use. Never another one for the same use.
    const fn code(self) -> u8 {
        match self {
            Self::Step(axis) => axis,
            Self::Direction(axis) => 8 + axis,
            Self::AxisEnable(axis) => 16 + axis,
            Self::Switch { of, end } => {
                let end = match end {
                    End::Min => 0,
                    End::Max => 1,
                    End::Home => 2,
                };
                end + match of {
                    SwitchOf::Axis(axis) => 24 + 3 * axis,
                    SwitchOf::C => 48,
                    SwitchOf::D => 51,
                    SwitchOf::Probe => 54,
                }
            }
            Self::Enable => 64,
            Self::Laser => 65,
            Self::Stop => 66,
            Self::Lamp => 67,
            Self::StepC => 68,
            Self::StepD => 69,
            Self::ShiftData => 70,
            Self::ShiftClock => 71,
            Self::ShiftLatch => 72,
            Self::ShiftBack => 73,
            Self::Lidar => 74,
        }
    }
}

impl From<PinUse> for u8 {
    fn from(of: PinUse) -> Self {
        of.code()
    }
}

impl TryFrom<u8> for PinUse {
    type Error = NoUse;

    fn try_from(code: u8) -> Result<Self, NoUse> {
        let switch = |of, end| {
            let end = match end {
                0 => End::Min,
                1 => End::Max,
                _ => End::Home,
            };
            Self::Switch { of, end }
        };
        let found = match code {
            0..8 => Self::Step(code),
            8..16 => Self::Direction(code - 8),
            16..24 => Self::AxisEnable(code - 16),
            24..48 => switch(SwitchOf::Axis((code - 24) / 3), code % 3),
            48..51 => switch(SwitchOf::C, code - 48),
            51..54 => switch(SwitchOf::D, code - 51),
            54 => switch(SwitchOf::Probe, 0),
            _ => {
                let mut named = NAMED.iter().map(|(_, of)| *of);
                named.find(|of| of.code() == code).ok_or(NoUse)?
            }
        };
        if found.is_legal() {
            Ok(found)
        } else {
            Err(NoUse)
        }
    }
}

/// A name or a number that no pin has.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct NoUse;

impl fmt::Display for NoUse {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("no pin is for this")
    }
}

impl core::error::Error for NoUse {}

impl FromStr for PinUse {
    type Err = NoUse;

    fn from_str(name: &str) -> Result<Self, NoUse> {
        if let Some((_, of)) = NAMED.iter().find(|(known, _)| *known == name) {
            return Ok(*of);
        }
        if name == "probe" {
            let (of, end) = (SwitchOf::Probe, End::Min);
            return Ok(Self::Switch { of, end });
        }
        let (of, what) = name.split_once(':').ok_or(NoUse)?;
        let end = match what {
            "min" => Some(End::Min),
            "max" => Some(End::Max),
            "home" => Some(End::Home),
            _ => None,
        };
        let axis = of.parse().ok();
        let found = match (of, axis, what, end) {
            ("c", _, _, Some(end)) => Self::Switch {
                of: SwitchOf::C,
                end,
            },
            ("d", _, _, Some(end)) => Self::Switch {
                of: SwitchOf::D,
                end,
            },
            (_, Some(axis), _, Some(end)) => Self::Switch {
                of: SwitchOf::Axis(axis),
                end,
            },
            (_, Some(axis), "step", _) => Self::Step(axis),
            (_, Some(axis), "dir", _) => Self::Direction(axis),
            (_, Some(axis), "enable", _) => Self::AxisEnable(axis),
            _ => return Err(NoUse),
        };
        if found.is_legal() {
            Ok(found)
        } else {
            Err(NoUse)
        }
    }
}

/// The table of the named kit, an ESP32-S3-DevKitC-1 with the N8R8 module: see the wiring diagram in
/// `node-firmware/README.md`. The third and the fourth axis take the pins of the switches of C and D.
pub const fn kit_pin(of: PinUse) -> Option<u8> {
    Some(match of {
        PinUse::Step(0) => 4,
        PinUse::Direction(0) => 5,
        PinUse::Step(1) => 6,
        PinUse::Direction(1) => 7,
        PinUse::Step(2) => 16,
        PinUse::Direction(2) => 17,
        PinUse::Step(3) => 21,
        PinUse::Direction(3) => 47,
        PinUse::Enable => 15,
        PinUse::Laser => 11,
        PinUse::Stop => 10,
        PinUse::Lamp => 18,
        PinUse::StepC => 38,
        PinUse::StepD => 48,
        PinUse::ShiftData => 39,
        PinUse::ShiftClock => 40,
        PinUse::ShiftLatch => 41,
        PinUse::ShiftBack => 42,
        PinUse::Lidar => 3,
        PinUse::Switch { of, end } => match (of, end) {
            (SwitchOf::Axis(0), End::Min) => 1,
            (SwitchOf::Axis(0), End::Max) => 2,
            (SwitchOf::Axis(0), End::Home) => 8,
            (SwitchOf::Axis(1), End::Min) => 9,
            (SwitchOf::Axis(1), End::Max) => 12,
            (SwitchOf::Axis(1), End::Home) => 13,
            (SwitchOf::Probe, _) => 14,
            (SwitchOf::C, End::Min) => 16,
            (SwitchOf::C, End::Max) => 17,
            (SwitchOf::D, End::Min) => 21,
            (SwitchOf::D, End::Max) => 47,
            _ => return None,
        },
        _ => return None,
    })
}

/// The switches that the kit has a pin for.
pub const KIT_SWITCHES: [(SwitchOf, End); 11] = [
    (SwitchOf::Axis(0), End::Min),
    (SwitchOf::Axis(0), End::Max),
    (SwitchOf::Axis(0), End::Home),
    (SwitchOf::Axis(1), End::Min),
    (SwitchOf::Axis(1), End::Max),
    (SwitchOf::Axis(1), End::Home),
    (SwitchOf::Probe, End::Min),
    (SwitchOf::C, End::Min),
    (SwitchOf::C, End::Max),
    (SwitchOf::D, End::Min),
    (SwitchOf::D, End::Max),
];

/// Another pin than the kit's.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct PinSetting {
    /// What it is for.
    pub of: PinUse,
    /// Its GPIO number; `None`: there is no such pin on this board.
    pub gpio: Option<u8>,
}

/// See the module.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Wiring {
    /// Axes of the queue; 0: [`AXES_DEFAULT`].
    pub axis_count: u8,
    /// By use, each at most once.
    pub pins: Vec<PinSetting, PINS_MAX>,
}

impl Wiring {
    /// Returns how many axes there are.
    pub fn axes(&self) -> usize {
        match self.axis_count {
            0 => AXES_DEFAULT,
            told => usize::from(told),
        }
    }

    /// Tells a pin. Returns whether there can be such a one, and there was room.
    pub fn set(&mut self, new: PinSetting) -> bool {
        if !new.of.is_legal() {
            return false;
        }
        match self.pins.iter_mut().find(|known| known.of == new.of) {
            Some(known) => *known = new,
            None => return self.pins.push(new).is_ok(),
        }
        true
    }

    /// Returns the pin for a use: as it was told, or as the kit has it.
    pub fn pin(&self, of: PinUse) -> Option<u8> {
        match self.pins.iter().find(|told| told.of == of) {
            Some(told) => told.gpio,
            None => kit_pin(of),
        }
    }

    /// Returns everything that a board with this machine wants a pin for.
    pub fn uses<'a>(&'a self, machine: &'a Machine) -> impl Iterator<Item = PinUse> + Clone + 'a {
        let axes = (0..self.axes() as u8).flat_map(|axis| {
            [
                PinUse::Step(axis),
                PinUse::Direction(axis),
                PinUse::AxisEnable(axis),
            ]
        });
        let cd = NAMED[4..10].iter().filter(|_| machine.has_cd);
        let lidar = NAMED[10..].iter().filter(|_| machine.has_lidar);
        let named = NAMED[..4].iter().chain(cd).chain(lidar).map(|(_, of)| *of);
        let switches = machine.switches.iter().map(PinUse::of_switch);
        axes.chain(named).chain(switches)
    }
}

/// A pin that cannot be.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct PinFault {
    /// What it was to be for.
    pub of: PinUse,
    /// The pin; `None`: there is none.
    pub gpio: Option<u8>,
    /// Why not.
    pub why: PinWhy,
}

impl fmt::Display for PinFault {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self.gpio {
            Some(gpio) => write!(f, "GPIO {gpio} cannot be {}: {}", self.of, self.why),
            None => write!(f, "{}: {}", self.of, self.why),
        }
    }
}

impl core::error::Error for PinFault {}

/// Looks whether a board can be wired like this.
///
/// # Errors
/// The first pin that cannot be.
pub fn check(wiring: &Wiring, machine: &Machine, chip: Chip) -> Result<(), PinFault> {
    let fault = |of, gpio, why| Err(PinFault { of, gpio, why });
    let axes = wiring.axes();
    if axes > chip.axes_max() {
        let max = chip.axes_max() as u8;
        return fault(PinUse::Step(max), None, PinWhy::Axes { max });
    }
    for told in &wiring.pins {
        if told.of.axis().is_some_and(|axis| usize::from(axis) >= axes) {
            let axes = axes as u8;
            return fault(told.of, told.gpio, PinWhy::NoAxis { axes });
        }
        if let Some(gpio) = told.gpio
            && let Some(why) = chip.refuses(gpio, told.of)
        {
            return fault(told.of, told.gpio, why);
        }
    }
    for (index, of) in wiring.uses(machine).enumerate() {
        let Some(gpio) = wiring.pin(of) else {
            if of.is_optional() {
                continue;
            }
            return fault(of, None, PinWhy::Missing);
        };
        if let Some(why) = chip.refuses(gpio, of) {
            return fault(of, Some(gpio), why);
        }
        let mut before = wiring.uses(machine).take(index);
        if let Some(other) = before.find(|other| wiring.pin(*other) == Some(gpio)) {
            return fault(of, Some(gpio), PinWhy::Taken(other));
        }
    }
    Ok(())
}
