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
    /// Takes the pins as they are. `level_of` reads one, by index.
    pub fn new(map: InputMap, mut level_of: impl FnMut(usize) -> bool, now: Ticks) -> Self {
        let mut pins = [None; INPUTS_MAX];
        for (index, (pin, config)) in pins.iter_mut().zip(&map.inputs).enumerate() {
            *pin = config.map(|config| {
                Debounce::new(config.filter, config.active_low, level_of(index), now)
            });
        }
        Self {
            map,
            pins,
            latches: [[0; CHANNELS]; INPUTS_MAX],
        }
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
mod tests {
    extern crate std;

    use super::*;
    use std::{vec, vec::Vec};

    const fn us(us: u64) -> Ticks {
        Ticks(us * TICKS_PER_US)
    }

    /// Plays edges (µs, level), polling at each deadline, then up to `end`.
    fn play(pin: &mut Debounce, edges: &[(u64, bool)], end: u64) -> Vec<(bool, u64)> {
        let mut found = Vec::new();
        let tell = |change: Change| (change.active, change.at.0 / TICKS_PER_US);
        for (at, level) in edges {
            while let Some(due) = pin.poll_timeout().filter(|due| *due <= us(*at)) {
                found.extend(pin.poll(due).map(tell));
            }
            found.extend(pin.level(*level, us(*at)).map(tell));
        }
        while let Some(due) = pin.poll_timeout().filter(|due| *due <= us(end)) {
            found.extend(pin.poll(due).map(tell));
        }
        found
    }

    fn debounce(active_us: u32, inactive_us: u32) -> Debounce {
        let filter = Filter {
            active_us,
            inactive_us,
        };
        Debounce::new(filter, false, false, us(0))
    }

    #[test]
    fn a_level_counts_when_it_has_held_and_from_its_edge() {
        let mut pin = debounce(20, 50);
        assert_eq!(pin.level(true, us(100)).count(), 0);
        assert_eq!(pin.poll_timeout(), Some(us(120)));
        assert_eq!(pin.poll(Ticks(us(120).0 - 1)), None);
        assert!(!pin.is_active());
        let (active, at) = (true, us(100));
        assert_eq!(pin.poll(us(120)), Some(Change { active, at }));
        assert!(pin.is_active());
        assert_eq!((pin.poll(us(500)), pin.poll_timeout()), (None, None));
        assert_eq!(play(&mut pin, &[(600, false)], 649), []);
        assert_eq!(play(&mut pin, &[], 650), [(false, 600)]);
    }

    #[test]
    fn bounce_and_glitches_shorter_than_the_filter_do_not_count() {
        let bounce = [
            (100, true),
            (110, false),
            (115, true),
            (130, false),
            (140, true),
        ];
        assert_eq!(
            play(&mut debounce(20, 50), &bounce, 1_000),
            [(true, 140)],
            "from the last edge"
        );
        assert_eq!(
            play(&mut debounce(20, 50), &[(100, true), (119, false)], 1_000),
            [],
            "a glitch"
        );
        assert_eq!(
            play(&mut debounce(20, 50), &[(100, true), (120, false)], 1_000),
            [(true, 100), (false, 120)],
            "just long enough"
        );
    }

    #[test]
    fn a_switch_that_acts_at_once_acts_on_the_first_edge_and_only_once() {
        let mut pin = debounce(0, 5_000);
        let first: Vec<_> = pin.level(true, us(100)).collect();
        let active = true;
        assert_eq!(
            first,
            [Change {
                active,
                at: us(100)
            }]
        );
        let bounce: Vec<_> = (1..200).map(|n| (100 + 20 * n, n % 2 == 0)).collect();
        assert_eq!(play(&mut pin, &bounce, 20_000), [(false, 4_080)]);
    }

    #[test]
    fn a_late_call_loses_nothing() {
        let mut pin = debounce(0, 50);
        assert_eq!(pin.level(true, us(10)).count(), 1);
        assert_eq!(pin.level(false, us(20)).count(), 0);
        // Nobody polled at 70.
        let both: Vec<_> = pin.level(true, us(500)).collect();
        let change = |active, at| Change { active, at: us(at) };
        assert_eq!(both, [change(false, 20), change(true, 500)]);
    }

    #[test]
    fn polarity_and_the_first_level_are_taken_as_they_are() {
        for active_low in [false, true] {
            for level in [false, true] {
                let mut pin = Debounce::new(Filter::default(), active_low, level, us(7));
                let active = level != active_low;
                assert_eq!(pin.is_active(), active);
                assert_eq!((pin.poll(us(1_000_000)), pin.poll_timeout()), (None, None));
                let changes = play(&mut pin, &[(1_000_000, !level)], 2_000_000);
                assert_eq!(changes, [(!active, 1_000_000)]);
            }
        }
    }

    #[test]
    fn time_does_not_go_back_and_a_repeated_level_is_no_edge() {
        let mut pin = debounce(20, 20);
        assert_eq!(
            play(&mut pin, &[(100, true), (110, true)], 121),
            [(true, 100)]
        );
        let mut pin = debounce(20, 20);
        assert_eq!(pin.poll(us(200)), None);
        assert_eq!(pin.level(true, us(100)).count(), 0);
        assert_eq!(pin.poll_timeout(), Some(us(220)));
        let mut far = debounce(u32::MAX, 0);
        assert_eq!(far.level(true, us(0)).count(), 0);
        assert_eq!(far.poll_timeout(), Some(us(u64::from(FILTER_US_MAX))));
        let mut end = Debounce::new(Filter::default(), false, false, Ticks(u64::MAX));
        assert_eq!(end.level(true, Ticks(u64::MAX)).count(), 1, "no overflow");
    }

    #[test]
    fn random_edges_count_exactly_when_a_level_has_held() {
        for seed in 0..300_u64 {
            let mut state = seed;
            let mut random = |below: u64| {
                state = state.wrapping_add(0x9e37_79b9_7f4a_7c15);
                let mut mixed = (state ^ state >> 30).wrapping_mul(0xbf58_476d_1ce4_e5b9);
                mixed = (mixed ^ mixed >> 27).wrapping_mul(0x94d0_49bb_1331_11eb);
                (mixed ^ mixed >> 31) % below
            };
            let times = [random(40), random(40)];
            let mut level = false;
            let mut at = 1;
            let mut edges = Vec::new();
            for _ in 0..100 {
                level = !level;
                edges.push((at, level));
                at += 1 + random(60);
            }
            let end = at + 100;
            // By hand: an edge counts if it changes what counts and the level holds long enough.
            let mut expected = Vec::new();
            let mut counts = false;
            for (index, (at, level)) in edges.iter().enumerate() {
                let until = edges.get(index + 1).map_or(end, |next| next.0);
                if *level != counts && until - at >= times[usize::from(!level)] {
                    counts = *level;
                    expected.push((counts, *at));
                }
            }
            let mut pin = debounce(times[0] as u32, times[1] as u32);
            assert_eq!(play(&mut pin, &edges, end), expected, "seed {seed}");
            // The same without a poll between the edges.
            let mut pin = debounce(times[0] as u32, times[1] as u32);
            let mut late = Vec::new();
            for (at, level) in &edges {
                late.extend(pin.level(*level, us(*at)));
            }
            late.extend(pin.poll(us(end)));
            let late: Vec<_> = late
                .iter()
                .map(|change| (change.active, change.at.0 / TICKS_PER_US))
                .collect();
            assert_eq!(late, expected, "seed {seed}");
        }
    }

    const X_MIN: Role = Role::Axis {
        axis: AxisId(0),
        switch: Switch::Min,
    };

    fn edge(index: usize, level: bool, at_us: u64) -> PinLevel {
        PinLevel {
            index,
            level,
            at: us(at_us),
            counted_steps: [at_us as i64; CHANNELS],
        }
    }

    fn input(role: Role) -> InputConfig {
        InputConfig {
            role,
            active_low: true,
            filter: Filter::default(),
        }
    }

    #[test]
    fn a_map_refuses_what_the_node_does_not_have() {
        let z_max = Role::Axis {
            axis: AxisId(2),
            switch: Switch::Max,
        };
        let map = InputMap::new(&[input(X_MIN), input(z_max)], 3).expect("three axes");
        assert!(map.has(z_max) && map.has(X_MIN) && !map.has(Role::Stop));
        assert_eq!(map.get(1), Some(&input(z_max)));
        assert_eq!((map.get(2), map.get(99)), (None, None));
        assert_eq!(
            InputMap::new(&[input(X_MIN), input(z_max)], 2),
            Err(MapError::Axis {
                index: 1,
                axis: AxisId(2)
            })
        );
        assert_eq!(
            InputMap::new(&[input(Role::C(Switch::Home))], 2),
            Err(MapError::NoHome { index: 0 })
        );
        let slow = InputConfig {
            filter: Filter {
                active_us: 0,
                inactive_us: FILTER_US_MAX + 1,
            },
            ..input(Role::Probe)
        };
        assert_eq!(
            InputMap::new(&[slow], 2),
            Err(MapError::Filter { index: 0 })
        );
        let many = vec![input(Role::Stop); INPUTS_MAX + 1];
        assert_eq!(InputMap::new(&many, 2), Err(MapError::TooMany));
        assert!(InputMap::new(&many[1..], 2).is_ok());
        use std::string::ToString;
        for error in [
            MapError::TooMany,
            MapError::Filter { index: 3 },
            MapError::NoHome { index: 3 },
        ] {
            assert!(!error.to_string().is_empty());
        }
        assert_eq!(
            MapError::Axis {
                index: 1,
                axis: AxisId(2)
            }
            .to_string(),
            "input 1: there is no axis 2"
        );
    }

    #[test]
    fn two_inputs_of_one_role_are_active_while_one_of_them_is() {
        let at_once = |role| InputConfig {
            filter: Filter {
                active_us: 0,
                inactive_us: 0,
            },
            ..input(role)
        };
        let configs = [at_once(Role::Stop), at_once(X_MIN), at_once(Role::Stop)];
        let map = InputMap::new(&configs, 1).expect("legal");
        // Active low: all pins high is all free, but for the limit.
        let mut inputs = Inputs::new(map, |index| index != 1, us(0));
        assert!(inputs.is_active(X_MIN) && !inputs.is_active(Role::Stop));
        let mut at = 0;
        let mut change = |index: usize, level: bool| {
            at += 10;
            inputs
                .level(edge(index, level, at))
                .map(|event| (event.role, event.active))
                .collect::<Vec<_>>()
        };
        assert_eq!(change(0, false), [(Role::Stop, true)]);
        assert_eq!(change(2, false), []);
        assert_eq!(change(0, true), []);
        assert_eq!(change(2, true), [(Role::Stop, false)]);
        assert_eq!(change(1, true), [(X_MIN, false)]);
        assert_eq!(change(3, true), [], "no such input");
        assert_eq!(change(INPUTS_MAX, true), [], "no such input");
    }

    #[test]
    fn a_change_has_the_counters_of_the_edge_since_which_it_holds() {
        let map = InputMap::new(&[input(X_MIN)], 1).expect("legal");
        let mut inputs = Inputs::new(map, |_| true, us(0));
        let told = |event: InputEvent| (event.active, event.at, event.counted_steps[0]);
        for (level, at) in [(false, 100), (true, 105), (false, 110), (false, 115)] {
            assert_eq!(inputs.level(edge(0, level, at)).count(), 0, "bounce");
        }
        assert_eq!(inputs.poll(us(130)).map(told), Some((true, us(110), 110)));
        // Released, and told so only with the next edge.
        assert_eq!(inputs.level(edge(0, true, 1_000)).count(), 0);
        let late: Vec<_> = inputs.level(edge(0, false, 9_000)).map(told).collect();
        assert_eq!(late, [(false, us(1_000), 1_000)]);
        assert_eq!(
            inputs.poll(us(9_020)).map(told),
            Some((true, us(9_000), 9_000))
        );
    }

    #[test]
    fn events_come_in_the_order_in_which_they_count() {
        let with = |role, active_us| InputConfig {
            active_low: false,
            filter: Filter {
                active_us,
                inactive_us: 0,
            },
            role,
        };
        let configs = [with(Role::Probe, 90), with(Role::Stop, 10), with(X_MIN, 30)];
        let map = InputMap::new(&configs, 1).expect("legal");
        let mut inputs = Inputs::new(map, |_| false, us(0));
        assert_eq!(inputs.poll_timeout(), None);
        for (index, at) in [(0, 100), (1, 150), (2, 110)] {
            assert_eq!(inputs.level(edge(index, true, at)).count(), 0);
        }
        assert_eq!(inputs.poll_timeout(), Some(us(140)));
        assert_eq!(inputs.poll(us(139)), None);
        let mut found = Vec::new();
        while let Some(event) = inputs.poll(us(1_000)) {
            found.push((event.role, event.at));
        }
        assert_eq!(
            found,
            [
                (X_MIN, us(110)),
                (Role::Stop, us(150)),
                (Role::Probe, us(100))
            ]
        );
        assert_eq!(inputs.map(), &map);
    }
}
