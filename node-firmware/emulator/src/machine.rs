//! A virtual machine around the node: carriages that the pulse pins move, and switches in their way.
//!
//! It sees what a machine sees, the pins, and nothing of what the node believes: a carriage is where
//! the edges of its step pin have taken it. A switch is pressed within a range of places and bounces
//! at each change, by random numbers that follow from the seed. The levels have the ticks at which
//! they changed and what the pulse counters showed then, like those that an interrupt takes.

use crate::{
    emulated::splitmix,
    pins::{CARRIAGES, PinEvent},
};
use motion::{TICKS_PER_US, Ticks, io::input::PinLevel};
use std::{collections::VecDeque, ops::RangeInclusive};

/// A switch in the way of a carriage.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct MachineSwitch {
    /// Index of the node's input that it is wired to.
    pub input: usize,
    /// The carriage that presses it: an axis by its number, or [`CARRIAGE_C`], or [`CARRIAGE_D`].
    ///
    /// [`CARRIAGE_C`]: crate::pins::CARRIAGE_C
    /// [`CARRIAGE_D`]: crate::pins::CARRIAGE_D
    pub carriage: usize,
    /// Where it is pressed, steps of the machine.
    pub pressed: RangeInclusive<i64>,
    /// It is released this much outside that.
    pub hysteresis_steps: u64,
}

/// A machine. By default it has no switches.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct MachineConfig {
    /// Where its carriages are when it is switched on, steps of the machine.
    pub start_steps: [i64; CARRIAGES],
    /// Its switches.
    pub switches: Vec<MachineSwitch>,
    /// Longest that a switch bounces, µs; 0: not at all.
    pub bounce_us_max: u64,
}

/// Most changes of one bounce; odd, so that it ends as it shall.
const BOUNCES_MAX: u64 = 9;

/// A change of a switch's contact that is still to come.
#[derive(Clone, Copy, Debug)]
struct Contact {
    at_ticks: u64,
    switch: usize,
    closed: bool,
}

/// See the module.
#[derive(Clone, Debug)]
pub(crate) struct Machine {
    config: MachineConfig,
    /// Pins that are low when their switch is pressed, by input.
    active_low: Vec<bool>,
    /// Steps since the node's boot, as its pulse counters show them.
    counted_steps: [i64; CARRIAGES],
    positive: [bool; CARRIAGES],
    /// Carriages whose direction pin is low for positive.
    inverted: [bool; CARRIAGES],
    pressed: Vec<bool>,
    contacts: VecDeque<Contact>,
    random: u64,
}

impl Machine {
    /// Switches it on. `active_low` tells the polarity of an input.
    pub(crate) fn new(
        config: MachineConfig,
        active_low: impl Fn(usize) -> bool,
        inverted: [bool; CARRIAGES],
        seed: u64,
    ) -> Self {
        let pressed = config.switches.iter();
        let pressed = pressed.map(|switch| {
            switch
                .pressed
                .contains(&config.start_steps[switch.carriage])
        });
        Self {
            pressed: pressed.collect(),
            active_low: config
                .switches
                .iter()
                .map(|switch| active_low(switch.input))
                .collect(),
            counted_steps: [0; CARRIAGES],
            positive: inverted,
            inverted,
            contacts: VecDeque::new(),
            random: splitmix(seed),
            config,
        }
    }

    /// The node boots anew: its counters begin at 0, the carriages stay where they are.
    pub(crate) fn reboot(&mut self) {
        for (start, counted) in self
            .config
            .start_steps
            .iter_mut()
            .zip(&mut self.counted_steps)
        {
            *start += *counted;
            *counted = 0;
        }
        self.positive = self.inverted;
        self.contacts.clear();
    }

    /// Returns whether there is nothing that could press anything.
    pub(crate) fn is_empty(&self) -> bool {
        self.config.switches.is_empty()
    }

    /// Returns the levels of the inputs that have a switch, a bit for each.
    pub(crate) fn levels(&self) -> u32 {
        let switches = self.config.switches.iter().zip(&self.pressed).enumerate();
        switches.fold(0, |levels, (index, (switch, pressed))| {
            levels | u32::from(*pressed != self.active_low[index]) << switch.input
        })
    }

    /// Returns where a carriage is, steps of the machine.
    pub(crate) fn place_steps(&self, carriage: usize) -> i64 {
        self.config.start_steps[carriage] + self.counted_steps[carriage]
    }

    /// Returns for how many steps of any carriage no switch changes.
    pub(crate) fn quiet_steps(&self) -> u64 {
        if !self.contacts.is_empty() {
            return 0;
        }
        let switches = self.config.switches.iter().zip(&self.pressed);
        let quiet = switches.map(|(switch, pressed)| {
            let place = self.place_steps(switch.carriage);
            let slack = if *pressed { switch.hysteresis_steps } else { 0 };
            let low = switch.pressed.start().saturating_sub_unsigned(slack);
            let high = switch.pressed.end().saturating_add_unsigned(slack);
            let ends = if *pressed {
                [low.saturating_sub(1), high.saturating_add(1)]
            } else {
                [low, high]
            };
            let distance = ends.map(|end| end.abs_diff(place));
            distance[0].min(distance[1]).saturating_sub(1)
        });
        quiet.min().unwrap_or(u64::MAX)
    }

    /// Takes what the pins did, in order of time, up to `until`; gives what the inputs did.
    pub(crate) fn follow(&mut self, edges: &[PinEvent], until: Ticks) -> Vec<PinLevel> {
        let mut levels = Vec::new();
        for edge in edges {
            self.pass_contacts(edge.at_ticks, &mut levels);
            if let Some(carriage) = edge.pin.turned_carriage() {
                self.positive[carriage] = edge.level != self.inverted[carriage];
            }
            if let Some(carriage) = edge.pin.stepped_carriage().filter(|_| edge.level) {
                self.counted_steps[carriage] += if self.positive[carriage] { 1 } else { -1 };
                self.look(carriage, edge.at_ticks);
            }
        }
        self.pass_contacts(until.0, &mut levels);
        levels
    }

    /// Presses and releases what a carriage has come to.
    fn look(&mut self, carriage: usize, at_ticks: u64) {
        let place = self.place_steps(carriage);
        for index in 0..self.config.switches.len() {
            let switch = &self.config.switches[index];
            if switch.carriage != carriage {
                continue;
            }
            let slack = if self.pressed[index] {
                switch.hysteresis_steps
            } else {
                0
            };
            let low = switch.pressed.start().saturating_sub_unsigned(slack);
            let high = switch.pressed.end().saturating_add_unsigned(slack);
            let pressed = (low..=high).contains(&place);
            if pressed != self.pressed[index] {
                self.pressed[index] = pressed;
                self.bounce(index, pressed, at_ticks);
            }
        }
    }

    /// The contact changes to and fro, and is as it shall be in the end.
    fn bounce(&mut self, switch: usize, closed: bool, at_ticks: u64) {
        // A bounce that was under way is over: the switch has another state.
        self.contacts.retain(|contact| contact.switch != switch);
        let most_ticks = self.config.bounce_us_max * TICKS_PER_US;
        let count = match most_ticks {
            0 => 1,
            _ => 1 + 2 * (self.random() % BOUNCES_MAX.div_ceil(2)),
        };
        let mut times: Vec<u64> = (1..count)
            .map(|_| at_ticks + self.random() % most_ticks)
            .collect();
        times.push(at_ticks);
        times.sort_unstable();
        for (number, at_ticks) in times.into_iter().enumerate() {
            self.contacts.push_back(Contact {
                at_ticks,
                switch,
                closed: closed == number.is_multiple_of(2),
            });
        }
        let contacts = self.contacts.make_contiguous();
        contacts.sort_by_key(|contact| contact.at_ticks);
    }

    fn pass_contacts(&mut self, until_ticks: u64, levels: &mut Vec<PinLevel>) {
        while let Some(contact) = self.contacts.front()
            && contact.at_ticks <= until_ticks
        {
            levels.push(PinLevel {
                index: self.config.switches[contact.switch].input,
                level: contact.closed != self.active_low[contact.switch],
                at: Ticks(contact.at_ticks),
                counted_steps: std::array::from_fn(|axis| self.counted_steps[axis]),
            });
            self.contacts.pop_front();
        }
    }

    fn random(&mut self) -> u64 {
        self.random = splitmix(self.random);
        self.random
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::pins::Pin;
    use keys::AxisId;

    fn machine(bounce_us_max: u64) -> Machine {
        let switch = MachineSwitch {
            input: 3,
            carriage: 1,
            pressed: i64::MIN..=-10,
            hysteresis_steps: 2,
        };
        let config = MachineConfig {
            switches: vec![switch],
            bounce_us_max,
            ..MachineConfig::default()
        };
        Machine::new(config, |_| true, [false; CARRIAGES], 1)
    }

    /// Steps of axis 1, one each 100 ticks from `at` on.
    fn steps(at: u64, count: i64) -> Vec<PinEvent> {
        let axis = AxisId(1);
        let turn = PinEvent {
            at_ticks: at,
            pin: Pin::Direction(axis),
            level: count > 0,
        };
        let step = |number: u64, level| PinEvent {
            at_ticks: at + 100 * number + if level { 0 } else { 50 },
            pin: Pin::Step(axis),
            level,
        };
        let pulses = (1..=count.unsigned_abs())
            .flat_map(|number| [true, false].map(|level| step(number, level)));
        std::iter::once(turn).chain(pulses).collect()
    }

    #[test]
    fn a_switch_changes_on_the_step_that_reaches_it() {
        let mut machine = machine(0);
        assert_eq!((machine.levels(), machine.quiet_steps()), (1 << 3, 9));
        assert_eq!(machine.follow(&steps(0, -9), Ticks(1_000)), []);
        let level = |level, at, steps| PinLevel {
            index: 3,
            level,
            at: Ticks(at),
            counted_steps: [0, steps, 0, 0],
        };
        let pressed = machine.follow(&steps(1_000, -5), Ticks(2_000));
        assert_eq!(pressed, [level(false, 1_100, -10)]);
        assert_eq!((machine.levels(), machine.quiet_steps()), (0, 6));
        let released = machine.follow(&steps(2_000, 10), Ticks(9_000));
        assert_eq!(released, [level(true, 2_700, -7)]);
        assert_eq!(machine.place_steps(1), -4);
        machine.reboot();
        assert_eq!((machine.place_steps(1), machine.counted_steps[1]), (-4, 0));
    }

    #[test]
    fn a_bounce_ends_as_it_shall() {
        let mut most = 0;
        for seed in 0..50 {
            let mut machine = machine(1_000);
            machine.random = seed;
            let mut levels = machine.follow(&steps(0, -10), Ticks(1_500));
            levels.extend(machine.follow(&[], Ticks(100_000)));
            most = most.max(levels.len());
            assert_eq!(levels.len() % 2, 1, "seed {seed}");
            assert_eq!(levels[0].at, Ticks(1_000), "the first contact");
            for pair in levels.windows(2) {
                assert!(pair[0].at <= pair[1].at && pair[0].level != pair[1].level);
            }
            assert!(!levels[levels.len() - 1].level, "active low, and pressed");
        }
        assert!(most > 3, "it bounces");
    }
}
