//! How the machine moves by itself: speeds of homing, soft limits, filters of switches, the places of C
//! and the way of D.
//!
//! Only what was told differs from motion's defaults. Each is checked when it is set, by motion's own
//! rules; what only shows together with the rest of the record is found by
//! [`MotionConfig::check`](motion::MotionConfig::check) at the boot.
//!
//! Every default is a row of zero bytes, and fields are only appended.

use crate::machine::{End, HOME_STEPS_MAX, SwitchOf, SwitchSettings};
use heapless::Vec;
use keys::{AXES_MAX, AxisId};
use motion::{
    ConfigCd, MotionConfig, SoftLimits,
    io::{
        home::HomeConfig,
        input::{FILTER_US_MAX, Filter, INPUTS_MAX, InputConfig, InputMap},
        named::{ConfigC, ConfigD, POSITIONS_C, PositionsC, SwitchD},
    },
};
use serde::{Deserialize, Serialize};

/// Most filters that differ from the default.
pub const FILTERS_MAX: usize = 8;

/// Fastest homing, Hz. A driver may be slower: that is found at the boot.
pub const HOME_HZ_MAX: u32 = 200_000;

/// How an axis is homed.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct HomingSettings {
    /// Its number.
    pub axis: u8,
    /// Speed of the seek, Hz, 1 to [`HOME_HZ_MAX`].
    pub seek_hz: u32,
    /// Speed of the approach, Hz, 1 to `seek_hz`.
    pub approach_hz: u32,
    /// Acceleration, steps/s², from 1.
    pub accel_hz_per_s: u32,
    /// Longest way of the seek, steps, from 1.
    pub travel_steps: u32,
    /// Where it ends, steps off the switch.
    pub pull_off_steps: u32,
}

impl HomingSettings {
    /// Motion's defaults for an axis.
    pub const fn new(axis: u8) -> Self {
        let home = HomeConfig::min_switch(HOME_STEPS_MAX);
        Self {
            axis,
            seek_hz: home.seek_hz,
            approach_hz: home.approach_hz,
            accel_hz_per_s: home.accel_hz_per_s,
            travel_steps: home.travel_steps_max as u32,
            pull_off_steps: home.pull_off_steps as u32,
        }
    }

    fn tell(&self, home: &mut HomeConfig) {
        home.seek_hz = self.seek_hz;
        home.approach_hz = self.approach_hz;
        home.accel_hz_per_s = self.accel_hz_per_s;
        home.travel_steps_max = self.travel_steps.into();
        home.pull_off_steps = self.pull_off_steps.into();
    }

    /// Returns whether an axis can be homed so.
    pub fn is_legal(&self) -> bool {
        let mut home = HomeConfig::min_switch(1);
        self.tell(&mut home);
        usize::from(self.axis) < AXES_MAX && self.seek_hz <= HOME_HZ_MAX && home.check().is_ok()
    }
}

/// How far an axis may go.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct ReachSettings {
    /// Its number.
    pub axis: u8,
    /// Lowest position, steps.
    pub min_steps: i32,
    /// Highest position, steps.
    pub max_steps: i32,
    /// They count before the axis is homed, too.
    pub from_boot: bool,
}

impl ReachSettings {
    /// Returns whether there is something between them.
    pub const fn is_legal(&self) -> bool {
        (self.axis as usize) < AXES_MAX && self.min_steps < self.max_steps
    }
}

/// How long a switch must hold a level before it counts.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct FilterSettings {
    /// Whose switch.
    pub of: SwitchOf,
    /// Which.
    pub end: End,
    /// To count as pressed, µs.
    pub active_us: u32,
    /// To count as released, µs.
    pub inactive_us: u32,
}

impl FilterSettings {
    const fn switch(&self) -> SwitchSettings {
        SwitchSettings {
            of: self.of,
            end: self.end,
            normally_closed: false,
            homes: false,
        }
    }

    /// Returns whether there can be such a switch and motion takes such times.
    pub fn is_legal(&self) -> bool {
        self.switch().is_legal() && self.active_us.max(self.inactive_us) <= FILTER_US_MAX
    }
}

/// The places of C.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct PlacesC {
    /// Steps of one metre.
    pub steps_per_m: u32,
    /// Each with its place, µm, and the speed on the way there, µm/s; from the low limit to the high one.
    pub places: [(i32, u32); POSITIONS_C],
}

impl PlacesC {
    fn config(&self) -> ConfigC {
        let mut config = ConfigC {
            steps_per_m: self.steps_per_m,
            ..ConfigC::default()
        };
        for (to, (position_um, speed_um_per_s)) in config.positions.iter_mut().zip(self.places) {
            to.position_um = position_um;
            to.speed_um_per_s = speed_um_per_s;
        }
        config
    }

    /// Returns whether C can move like this.
    pub fn is_legal(&self) -> bool {
        PositionsC::new(self.config()).is_ok()
    }
}

/// The way of D.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct WayD {
    /// Steps of one metre.
    pub steps_per_m: u32,
    /// Between OFF and ON, µm.
    pub travel_um: u32,
    /// Speed, µm/s.
    pub speed_um_per_s: u32,
}

impl WayD {
    fn tell(&self, d: &mut ConfigD) {
        d.steps_per_m = self.steps_per_m;
        d.travel_um = self.travel_um;
        d.speed_um_per_s = self.speed_um_per_s;
    }

    /// Returns whether D can move like this.
    pub fn is_legal(&self) -> bool {
        let mut config = ConfigD::default();
        self.tell(&mut config);
        SwitchD::new(config).is_ok()
    }
}

/// See the module.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Tuning {
    /// By axis, each at most once.
    pub homing: Vec<HomingSettings, AXES_MAX>,
    /// By axis, each at most once.
    pub reach: Vec<ReachSettings, AXES_MAX>,
    /// By switch, each at most once.
    pub filters: Vec<FilterSettings, FILTERS_MAX>,
    /// C's.
    pub c: Option<PlacesC>,
    /// D's.
    pub d: Option<WayD>,
}

/// Replaces the one that is meant, or adds it. Returns whether there was room.
fn put<T, const N: usize>(list: &mut Vec<T, N>, item: T, is_it: impl Fn(&T) -> bool) -> bool {
    match list.iter_mut().find(|known| is_it(known)) {
        Some(known) => *known = item,
        None => return list.push(item).is_ok(),
    }
    true
}

impl Tuning {
    /// Sets how an axis is homed; `false`: it cannot be so.
    pub fn set_homing(&mut self, new: HomingSettings) -> bool {
        new.is_legal() && put(&mut self.homing, new, |known| known.axis == new.axis)
    }

    /// Sets how far an axis may go; `false`: it cannot be so.
    pub fn set_reach(&mut self, new: ReachSettings) -> bool {
        new.is_legal() && put(&mut self.reach, new, |known| known.axis == new.axis)
    }

    /// Sets the filter of a switch; `false`: it cannot be so, or [`FILTERS_MAX`] are set.
    pub fn set_filter(&mut self, new: FilterSettings) -> bool {
        let role = new.switch().role();
        let is_it = |known: &FilterSettings| known.switch().role() == role;
        new.is_legal() && put(&mut self.filters, new, is_it)
    }

    /// Tells motion of it, behind [`Machine::tell`](crate::Machine::tell): it changes what is there.
    pub fn tell(&self, config: &mut MotionConfig) {
        for homing in &self.homing {
            if let Some(Some(home)) = config.homes.get_mut(usize::from(homing.axis)) {
                homing.tell(home);
            }
        }
        for reach in &self.reach {
            if let Some(limits) = config.soft_limits.get_mut(AxisId(reach.axis).index()) {
                *limits = Some(SoftLimits {
                    min_steps: reach.min_steps.into(),
                    max_steps: reach.max_steps.into(),
                    from_boot: reach.from_boot,
                });
            }
        }
        let inputs = (0..INPUTS_MAX).map_while(|index| config.inputs.get(index).copied());
        let inputs: Vec<InputConfig, INPUTS_MAX> = inputs
            .map(|input| {
                let mut filters = self.filters.iter();
                let told = filters.find(|filter| filter.switch().role() == input.role);
                InputConfig {
                    filter: told.map_or(input.filter, |told| Filter {
                        active_us: told.active_us,
                        inactive_us: told.inactive_us,
                    }),
                    ..input
                }
            })
            .collect();
        if let Ok(map) = InputMap::new(&inputs, AXES_MAX) {
            config.inputs = map;
        }
        if let Some(ConfigCd { c, d }) = config.cd.as_mut() {
            if let Some(places) = &self.c {
                *c = places.config();
            }
            if let Some(way) = &self.d {
                way.tell(d);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::machine::Machine;
    use motion::io::input::{Role, Switch};

    fn filter(end: End, active_us: u32) -> FilterSettings {
        FilterSettings {
            of: SwitchOf::Axis(0),
            end,
            active_us,
            inactive_us: 9_000,
        }
    }

    const PLACES: PlacesC = PlacesC {
        steps_per_m: 160_000,
        places: [
            (0, 5_000),
            (1_000, 5_000),
            (2_000, 5_000),
            (3_000, 5_000),
            (40_000, 9_000),
        ],
    };

    #[test]
    fn what_was_told_differs_from_the_defaults_and_nothing_else() {
        let mut machine = Machine {
            has_cd: true,
            ..Machine::default()
        };
        for (of, end, homes) in [
            (SwitchOf::Axis(0), End::Min, true),
            (SwitchOf::Axis(1), End::Max, true),
        ] {
            assert!(machine.add(SwitchSettings {
                of,
                end,
                normally_closed: true,
                homes,
            }));
        }
        let mut plain = MotionConfig::default();
        machine.tell(&mut plain);
        let mut told = plain.clone();
        Tuning::default().tell(&mut told);
        assert_eq!(told, plain);

        let mut tuning = Tuning::default();
        let homing = HomingSettings {
            seek_hz: 800,
            approach_hz: 100,
            travel_steps: 4_000,
            ..HomingSettings::new(1)
        };
        let reach = ReachSettings {
            axis: 0,
            min_steps: -10,
            max_steps: 5_000,
            from_boot: false,
        };
        assert!(tuning.set_homing(HomingSettings::new(1)) && tuning.set_homing(homing));
        assert!(tuning.set_reach(reach) && tuning.set_filter(filter(End::Min, 100)));
        tuning.c = Some(PLACES);
        assert!(PLACES.is_legal());
        assert_eq!(tuning.homing.len(), 1, "the last one replaced the first");
        tuning.tell(&mut told);
        assert_eq!(told.check(), Ok(()));
        assert_eq!(told.homes[0], plain.homes[0]);
        let home = told.homes[1].expect("it is homed");
        assert_eq!((home.seek_hz, home.travel_steps_max), (800, 4_000));
        assert_eq!(home.switch, Switch::Max, "which one it is was told before");
        assert_eq!(
            told.soft_limits[0].map(|limits| limits.max_steps),
            Some(5_000)
        );
        let filter = |config: &MotionConfig, index| {
            let input = config.inputs.get(index).copied();
            input.expect("an input").filter
        };
        assert_eq!(filter(&told, 0).active_us, 100);
        assert_eq!(filter(&told, 1), filter(&plain, 1));
        let cd = told.cd.expect("it is there");
        assert_eq!(cd.c.positions[4].position_um, 40_000);
        assert_eq!(Some(cd.d), plain.cd.map(|cd| cd.d));
        let role = told.inputs.get(0).map(|input| input.role);
        assert_eq!(
            role,
            Some(Role::Axis {
                axis: AxisId(0),
                switch: Switch::Min
            })
        );
    }

    #[test]
    fn what_cannot_be_is_refused_and_changes_nothing() {
        let mut tuning = Tuning::default();
        let homing = HomingSettings::new(0);
        for wrong in [
            HomingSettings {
                seek_hz: 0,
                ..homing
            },
            HomingSettings {
                approach_hz: 6_000,
                ..homing
            },
            HomingSettings {
                seek_hz: HOME_HZ_MAX + 1,
                ..homing
            },
            HomingSettings {
                accel_hz_per_s: 0,
                ..homing
            },
            HomingSettings {
                travel_steps: 0,
                ..homing
            },
            HomingSettings::new(AXES_MAX as u8),
        ] {
            assert!(!tuning.set_homing(wrong), "{wrong:?}");
        }
        let reach = ReachSettings {
            axis: 0,
            min_steps: 5,
            max_steps: 5,
            from_boot: true,
        };
        assert!(!tuning.set_reach(reach));
        assert!(!tuning.set_filter(filter(End::Min, FILTER_US_MAX + 1)));
        let mut places = PLACES;
        places.places[3].0 = 2_000;
        assert!(!places.is_legal());
        let way = WayD {
            steps_per_m: 80_000,
            travel_um: 0,
            speed_um_per_s: 1,
        };
        assert!(!way.is_legal());
        assert_eq!(tuning, Tuning::default());
    }
}
