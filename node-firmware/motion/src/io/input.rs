//! Input pins: limit, home, stop and probe switches, debounced.
//!
//! Owns the levels and what they mean. A level counts once it has held for its filter time, and
//! then it counts from the edge with which it began, so that a position taken at that edge is
//! exact however long the filter is. Pressing and releasing have their own times: a switch that
//! must act at once has 0 for the first, and its bounce is hidden by the second.
//!
//! Absent: what an input leads to. A pulse that is over before its interrupt reads the pin is not
//! seen; what must be seen that short needs a latch in hardware.

use crate::{
    Ticks,
    limits::{CHANNELS, TICKS_PER_US},
};
use keys::AxisId;

/// Most inputs of a node: 4 axes with 3 switches each, C and D with 2 each, stop and probe are 18.
pub const INPUTS_MAX: usize = 20;

/// Longest filter time: 100 ms.
pub const FILTER_US_MAX: u32 = 100_000;

/// How long a level must hold before it counts.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Filter {
    /// To count as active, µs; 0 is at once.
    pub active_us: u32,
    /// To count as inactive, µs; 0 is at once.
    pub inactive_us: u32,
}

impl Filter {
    /// Active at once, inactive after 5 ms: a switch that bounces and must act.
    pub const AT_ONCE: Self = Self {
        active_us: 0,
        inactive_us: 5_000,
    };
}

impl Default for Filter {
    /// Active after 20 µs, longer than what a motor's wires induce; inactive after 5 ms, longer
    /// than a switch bounces.
    fn default() -> Self {
        Self {
            active_us: 20,
            inactive_us: 5_000,
        }
    }
}

/// A change that counts.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Change {
    /// Whether the input is active now.
    pub active: bool,
    /// The edge since which it has held.
    pub at: Ticks,
}

/// One input pin.
#[derive(Clone, Copy, Debug)]
pub struct Debounce {
    active_ticks: u64,
    inactive_ticks: u64,
    active_low: bool,
    active: bool,
    /// A state that does not count yet, and its edge.
    candidate: Option<Change>,
    seen_at: Ticks,
}

impl Debounce {
    /// Takes the pin as it is: a switch that is pressed now counts as pressed.
    pub fn new(filter: Filter, active_low: bool, level: bool, at: Ticks) -> Self {
        let ticks = |us: u32| u64::from(us.min(FILTER_US_MAX)) * TICKS_PER_US;
        Self {
            active_ticks: ticks(filter.active_us),
            inactive_ticks: ticks(filter.inactive_us),
            active_low,
            active: level != active_low,
            candidate: None,
            seen_at: at,
        }
    }

    /// Returns whether the input is active, as far as it counts.
    pub const fn is_active(&self) -> bool {
        self.active
    }

    /// Takes the level of the pin at an edge; gives the changes that count by then: one that had
    /// held long enough before, and this one if it counts at once. An edge that is told later than
    /// a later one counts from that.
    pub fn level(&mut self, level: bool, at: Ticks) -> impl Iterator<Item = Change> + use<> {
        let at = at.max(self.seen_at);
        let before = self.poll(at);
        let active = level != self.active_low;
        self.candidate = match self.candidate {
            _ if active == self.active => None,
            Some(candidate) => Some(candidate),
            None => Some(Change { active, at }),
        };
        before.into_iter().chain(self.poll(at))
    }

    /// Gives the change that counts by now.
    pub fn poll(&mut self, now: Ticks) -> Option<Change> {
        self.seen_at = self.seen_at.max(now);
        let due = self.poll_timeout()?;
        if self.seen_at < due {
            return None;
        }
        let change = self.candidate.take()?;
        self.active = change.active;
        Some(change)
    }

    /// Returns when a change will count if the level holds.
    pub fn poll_timeout(&self) -> Option<Ticks> {
        let candidate = self.candidate?;
        let ticks = if candidate.active {
            self.active_ticks
        } else {
            self.inactive_ticks
        };
        Some(candidate.at.plus(ticks))
    }
}

/// A switch of an axis.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Switch {
    /// The limit at the low end.
    Min,
    /// The limit at the high end.
    Max,
    /// The reference switch.
    Home,
}

impl core::fmt::Display for Switch {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        f.write_str(match self {
            Self::Min => "min limit",
            Self::Max => "max limit",
            Self::Home => "home switch",
        })
    }
}

/// A level of an input pin, as its interrupt found it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct PinLevel {
    /// Index of the input.
    pub index: usize,
    /// The level from then on.
    pub level: bool,
    /// When.
    pub at: Ticks,
    /// What the pulse counters of the axes showed then, steps since boot. So a position taken at
    /// the edge is exact however late the edge is told.
    pub counted_steps: [i64; CHANNELS],
}

/// What an input is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Role {
    /// A switch of an axis of the queue.
    Axis {
        /// The axis.
        axis: AxisId,
        /// Which of its switches.
        switch: Switch,
    },
    /// A limit of C: [`Switch::Min`] or [`Switch::Max`].
    C(Switch),
    /// A limit of D: [`Switch::Min`] or [`Switch::Max`].
    D(Switch),
    /// The stop.
    Stop,
    /// The probe.
    Probe,
}

/// One input.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct InputConfig {
    /// What it is. Inputs of one role are one input that is active while any of them is.
    pub role: Role,
    /// Whether low is active: a switch to ground, normally open, with a pull-up. A switch to ground
    /// that is normally closed is active high, and a cut wire then is, too.
    pub active_low: bool,
    /// Its filter.
    pub filter: Filter,
}

/// Which input is what.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct InputMap {
    inputs: [Option<InputConfig>; INPUTS_MAX],
}

/// Why inputs are no map.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum MapError {
    /// More than [`INPUTS_MAX`].
    TooMany,
    /// The input at this index is for an axis that the node does not have.
    Axis {
        /// Of the input.
        index: usize,
        /// The axis.
        axis: AxisId,
    },
    /// The input at this index has a longer filter than [`FILTER_US_MAX`].
    Filter {
        /// Of the input.
        index: usize,
    },
    /// The input at this index is a reference switch of C or D, which have none.
    NoHome {
        /// Of the input.
        index: usize,
    },
}

impl core::fmt::Display for MapError {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        match self {
            Self::TooMany => write!(f, "more than {INPUTS_MAX} inputs"),
            Self::Axis { index, axis } => {
                write!(f, "input {index}: there is no axis {}", axis.0)
            }
            Self::Filter { index } => {
                write!(f, "input {index}: a filter is at most {FILTER_US_MAX} µs")
            }
            Self::NoHome { index } => {
                write!(f, "input {index}: C and D have limits only")
            }
        }
    }
}

impl core::error::Error for MapError {}

impl InputMap {
    /// No inputs.
    pub const EMPTY: Self = Self {
        inputs: [None; INPUTS_MAX],
    };

    /// Takes the inputs of a node with so many axes, by index.
    ///
    /// # Errors
    /// The first input that cannot be.
    pub fn new(configs: &[InputConfig], axis_count: usize) -> Result<Self, MapError> {
        if configs.len() > INPUTS_MAX {
            return Err(MapError::TooMany);
        }
        let mut map = Self::EMPTY;
        for (to, config) in map.inputs.iter_mut().zip(configs) {
            *to = Some(*config);
        }
        map.check(axis_count)?;
        Ok(map)
    }

    /// Checks that a node with so many axes can have these inputs.
    ///
    /// # Errors
    /// The first input that cannot be.
    pub fn check(&self, axis_count: usize) -> Result<(), MapError> {
        let configs = self.inputs.iter().enumerate();
        for (index, config) in configs.filter_map(|(index, input)| Some((index, (*input)?))) {
            match config.role {
                Role::Axis { axis, .. } if usize::from(axis.0) >= axis_count => {
                    return Err(MapError::Axis { index, axis });
                }
                Role::C(Switch::Home) | Role::D(Switch::Home) => {
                    return Err(MapError::NoHome { index });
                }
                _ => {}
            }
            if config.filter.active_us.max(config.filter.inactive_us) > FILTER_US_MAX {
                return Err(MapError::Filter { index });
            }
        }
        Ok(())
    }

    /// Returns an input's settings.
    pub fn get(&self, index: usize) -> Option<&InputConfig> {
        self.inputs.get(index)?.as_ref()
    }

    /// Returns whether an input has this role.
    pub fn has(&self, role: Role) -> bool {
        self.inputs.iter().flatten().any(|input| input.role == role)
    }
}

/// An input of this role became active or inactive.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct InputEvent {
    /// Which.
    pub role: Role,
    /// Whether it is active now.
    pub active: bool,
    /// The edge since which it has held.
    pub at: Ticks,
    /// What the pulse counters showed at that edge.
    pub counted_steps: [i64; CHANNELS],
}

/// The inputs of a node.
#[derive(Clone, Debug)]
pub struct Inputs {
    map: InputMap,
    pins: [Option<Debounce>; INPUTS_MAX],
    /// Counters at the edge of each pin that does not count yet.
    latches: [[i64; CHANNELS]; INPUTS_MAX],
}

impl Inputs {
    /// No inputs.
    pub const NONE: Self = Self {
        map: InputMap::EMPTY,
        pins: [None; INPUTS_MAX],
        latches: [[0; CHANNELS]; INPUTS_MAX],
    };

    /// Takes the pins as they are. `level_of` reads one, by index.
    pub fn new(map: InputMap, level_of: impl FnMut(usize) -> bool, now: Ticks) -> Self {
        let mut inputs = Self::NONE;
        inputs.reset(&map, level_of, now);
        inputs
    }

    /// Becomes what [`Inputs::new`] makes, in place.
    pub fn reset(&mut self, map: &InputMap, mut level_of: impl FnMut(usize) -> bool, now: Ticks) {
        self.map = *map;
        for (index, (pin, config)) in self.pins.iter_mut().zip(&map.inputs).enumerate() {
            *pin = config.map(|config| {
                Debounce::new(config.filter, config.active_low, level_of(index), now)
            });
        }
        self.latches = [[0; CHANNELS]; INPUTS_MAX];
    }

    /// Returns which input is what.
    pub const fn map(&self) -> &InputMap {
        &self.map
    }

    /// Returns whether an input of this role is active.
    pub fn is_active(&self, role: Role) -> bool {
        self.of(role).any(|pin| pin.is_active())
    }

    /// Takes the level of a pin at an edge; an index without an input means nothing. Gives at most
    /// two events. Call [`Inputs::poll`] up to that time before.
    pub fn level(&mut self, edge: PinLevel) -> impl Iterator<Item = InputEvent> + use<> {
        let mut events = [None; 2];
        let index = edge.index;
        if let (Some(config), Some(Some(pin))) = (self.map.get(index), self.pins.get_mut(index)) {
            let role = config.role;
            let latch = &mut self.latches[index];
            let before = pin.poll(edge.at).map(|change| (change, *latch));
            // Until then nothing waited to count: if something does now, it began here.
            if pin.candidate.is_none() {
                *latch = edge.counted_steps;
            }
            let change = pin.level(edge.level, edge.at).next();
            let changes = [before, change.map(|change| (change, *latch))];
            let others = self.others_active(index, role);
            for (event, (change, latch)) in events.iter_mut().zip(changes.into_iter().flatten()) {
                *event = event_of(role, change, latch, others);
            }
        }
        events.into_iter().flatten()
    }

    /// Gives the next event that counts by now; call it until it gives `None`. The order is that
    /// of the times at which they count.
    pub fn poll(&mut self, now: Ticks) -> Option<InputEvent> {
        while let Some((due, index)) = self.next_due()
            && due <= now
        {
            let change = self.pins[index].as_mut().and_then(|pin| pin.poll(now));
            let role = self.map.get(index).map(|config| config.role);
            if let (Some(change), Some(role)) = (change, role) {
                let others = self.others_active(index, role);
                if let Some(event) = event_of(role, change, self.latches[index], others) {
                    return Some(event);
                }
            }
        }
        None
    }

    /// Returns when [`Inputs::poll`] may have something next.
    pub fn poll_timeout(&self) -> Option<Ticks> {
        self.next_due().map(|(due, _)| due)
    }

    fn next_due(&self) -> Option<(Ticks, usize)> {
        let pins = self.pins.iter().enumerate();
        pins.filter_map(|(index, pin)| Some((pin.as_ref()?.poll_timeout()?, index)))
            .min()
    }

    fn of(&self, role: Role) -> impl Iterator<Item = &Debounce> {
        let inputs = self.map.inputs.iter().zip(&self.pins);
        inputs
            .filter(move |(config, _)| config.is_some_and(|config| config.role == role))
            .filter_map(|(_, pin)| pin.as_ref())
    }

    fn others_active(&self, index: usize, role: Role) -> bool {
        let inputs = self.map.inputs.iter().zip(&self.pins).enumerate();
        inputs
            .filter(|(other, (config, _))| {
                *other != index && config.is_some_and(|config| config.role == role)
            })
            .any(|(_, (_, pin))| pin.is_some_and(|pin| pin.is_active()))
    }
}

/// While another input of the role is active, nothing changes.
fn event_of(
    role: Role,
    change: Change,
    counted_steps: [i64; CHANNELS],
    others_active: bool,
) -> Option<InputEvent> {
    (!others_active).then_some(InputEvent {
        role,
        active: change.active,
        at: change.at,
        counted_steps,
    })
}

#[cfg(test)]
mod tests;
