//! Drivers by name, and what their step and direction inputs demand.

/// A driver whose timing is known: LinuxCNC's stepper table, where nothing else is said.
///
/// Some step on the falling edge, as the table says: at the end of the high time. Their profile has
/// one high time at every speed ([`AxisProfile::of_driver`](crate::AxisProfile::of_driver)), so that
/// each falling edge lies as much behind its ideal instant, and from one to the next it is to the tick
/// what the ideal is. The direction is set up before the rising edge, earlier than they demand; and it
/// is held behind the falling one. A step is told of with its rising edge, and a halt plays its high
/// time to the end, so what is counted is what they make. They want the pulse as it is, not inverted.
///
/// | driver | high ns | low ns | hold ns | setup ns | Hz at most | edge |
/// |---|---|---|---|---|---|---|
/// | [`A4988`](Self::A4988) | 1000 | 1000 | 200 | 200 | 500000 | rising |
/// | [`Drv8825`](Self::Drv8825) | 1900 | 1900 | 650 | 650 | 263157 | rising |
/// | [`Tmc22xx`](Self::Tmc22xx) | 100 | 100 | 20 | 20 | 5000000 | rising |
/// | [`Tb6560`](Self::Tb6560) | 150000 | 150000 | 150000 | 150000 | 3333 | falling |
/// | [`Tb6600`](Self::Tb6600) | 2200 | 2200 | 10000 | 5000 | 227272 | rising |
/// | [`Gecko201`](Self::Gecko201) | 500 | 4000 | 20000 | 1000 | 222222 | falling |
/// | [`Gecko203v`](Self::Gecko203v) | 1000 | 2000 | 200 | 200 | 333333 | rising |
/// | [`Gecko540`](Self::Gecko540) | 5000 | 5000 | 10000 | 10000 | 100000 | rising |
/// | [`Dm556`](Self::Dm556) | 2500 | 2500 | 10000 | 5000 | 200000 | rising |
/// | [`Dm422`](Self::Dm422) | 7500 | 7500 | 20000 | 5000 | 66666 | rising |
/// | [`M542`](Self::M542) | 1500 | 1500 | 8000 | 5000 | 333333 | rising |
/// | [`Dq542ma`](Self::Dq542ma) | 5050 | 5050 | 500 | 500 | 99009 | rising |
/// | [`Dm860t`](Self::Dm860t) | 5000 | 5000 | 5000 | 5000 | 100000 | rising |
/// | [`Keling4030`](Self::Keling4030) | 5000 | 5000 | 20000 | 20000 | 100000 | rising |
/// | [`Parker750`](Self::Parker750) | 1000 | 1000 | 1000 | 200000 | 500000 | rising |
/// | [`Xylotex`](Self::Xylotex) | 2000 | 1000 | 200 | 200 | 333333 | rising |
/// | [`Sherline`](Self::Sherline) | 22000 | 22000 | 100000 | 100000 | 22727 | rising |
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Driver {
    /// Allegro A4988 on a Pololu board.
    A4988,
    /// TI DRV8825 on a Pololu board.
    Drv8825,
    /// Trinamic TMC22xx and TMC51xx: data sheet, and the pulse that Klipper takes.
    Tmc22xx,
    /// Toshiba TB6560, the blue board with slow opto-couplers.
    Tb6560,
    /// Toshiba TB6600: 2.2 µs high; of the rest nothing is published, it is as careful as the
    /// opto-couplers of its boards want it.
    Tb6600,
    /// Gecko 201, 202 and 212.
    Gecko201,
    /// Gecko 203v.
    Gecko203v,
    /// Gecko 540.
    Gecko540,
    /// Leadshine DM556, DM856 and DM870.
    Dm556,
    /// Leadshine DM422.
    Dm422,
    /// Leadshine M542.
    M542,
    /// Wantai DQ542MA.
    Dq542ma,
    /// Leadshine DM860T.
    Dm860t,
    /// Keling 4030.
    Keling4030,
    /// Parker OEM750, the longest of what is published.
    Parker750,
    /// Xylotex 8S-3.
    Xylotex,
    /// Sherline.
    Sherline,
}

/// Least times of a driver's inputs, ns.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Needs {
    /// Of a step's active level.
    pub high_ns: u32,
    /// Between two steps.
    pub low_ns: u32,
    /// From the end of a step to a change of direction.
    pub hold_ns: u32,
    /// From a change of direction to the active edge.
    pub setup_ns: u32,
}

impl Driver {
    /// All of them, in the order of the table.
    pub const ALL: [Self; 17] = [
        Self::A4988,
        Self::Drv8825,
        Self::Tmc22xx,
        Self::Tb6560,
        Self::Tb6600,
        Self::Gecko201,
        Self::Gecko203v,
        Self::Gecko540,
        Self::Dm556,
        Self::Dm422,
        Self::M542,
        Self::Dq542ma,
        Self::Dm860t,
        Self::Keling4030,
        Self::Parker750,
        Self::Xylotex,
        Self::Sherline,
    ];

    /// Returns its name in configurations: small letters and digits.
    pub const fn name(self) -> &'static str {
        match self {
            Self::A4988 => "a4988",
            Self::Drv8825 => "drv8825",
            Self::Tmc22xx => "tmc2209",
            Self::Tb6560 => "tb6560",
            Self::Tb6600 => "tb6600",
            Self::Gecko201 => "gecko201",
            Self::Gecko203v => "gecko203v",
            Self::Gecko540 => "gecko540",
            Self::Dm556 => "dm556",
            Self::Dm422 => "dm422",
            Self::M542 => "m542",
            Self::Dq542ma => "dq542ma",
            Self::Dm860t => "dm860t",
            Self::Keling4030 => "keling4030",
            Self::Parker750 => "parker750",
            Self::Xylotex => "xylotex",
            Self::Sherline => "sherline",
        }
    }

    /// Returns whether its active edge is the falling one.
    pub const fn steps_on_falling_edge(self) -> bool {
        matches!(self, Self::Tb6560 | Self::Gecko201)
    }

    /// Returns what its inputs demand.
    pub const fn needs(self) -> Needs {
        let (high_ns, low_ns, hold_ns, setup_ns) = match self {
            Self::A4988 => (1_000, 1_000, 200, 200),
            Self::Drv8825 => (1_900, 1_900, 650, 650),
            Self::Tmc22xx => (100, 100, 20, 20),
            Self::Tb6560 => (150_000, 150_000, 150_000, 150_000),
            Self::Tb6600 => (2_200, 2_200, 10_000, 5_000),
            Self::Gecko201 => (500, 4_000, 20_000, 1_000),
            Self::Gecko203v => (1_000, 2_000, 200, 200),
            Self::Gecko540 => (5_000, 5_000, 10_000, 10_000),
            Self::Dm556 => (2_500, 2_500, 10_000, 5_000),
            Self::Dm422 => (7_500, 7_500, 20_000, 5_000),
            Self::M542 => (1_500, 1_500, 8_000, 5_000),
            Self::Dq542ma => (5_050, 5_050, 500, 500),
            Self::Dm860t => (5_000, 5_000, 5_000, 5_000),
            Self::Keling4030 => (5_000, 5_000, 20_000, 20_000),
            Self::Parker750 => (1_000, 1_000, 1_000, 200_000),
            Self::Xylotex => (2_000, 1_000, 200, 200),
            Self::Sherline => (22_000, 22_000, 100_000, 100_000),
        };
        Needs {
            high_ns,
            low_ns,
            hold_ns,
            setup_ns,
        }
    }
}

impl core::str::FromStr for Driver {
    type Err = UnknownDriver;

    fn from_str(name: &str) -> Result<Self, UnknownDriver> {
        let mut all = Self::ALL.into_iter();
        all.find(|driver| driver.name() == name)
            .ok_or(UnknownDriver)
    }
}

/// No driver has this name.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct UnknownDriver;

impl core::fmt::Display for UnknownDriver {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        f.write_str("no known driver; there are ")?;
        for (index, driver) in Driver::ALL.into_iter().enumerate() {
            let comma = if index == 0 { "" } else { ", " };
            write!(f, "{comma}{}", driver.name())?;
        }
        Ok(())
    }
}

impl core::error::Error for UnknownDriver {}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{
        AxisProfile,
        limits::{HOLD_TICKS_MAX, SETUP_TICKS_MAX, TICK_HZ},
        profile::Timing,
    };

    #[test]
    fn every_driver_gets_what_it_demands_and_is_known_by_its_name() {
        for driver in Driver::ALL {
            assert_eq!(driver.name().parse(), Ok(driver));
            let needs = driver.needs();
            let timing = Timing::from(AxisProfile::of_driver(driver));
            let holds = |ticks: u64, ns: u32| ticks * 1_000_000_000 >= u64::from(ns) * TICK_HZ;
            let name = driver.name();
            assert!(holds(timing.high_ticks_min, needs.high_ns), "{name}");
            assert!(holds(timing.low_ticks_min, needs.low_ns), "{name}");
            assert!(holds(timing.setup_ticks, needs.setup_ns), "{name}");
            assert!(holds(timing.hold_ticks, needs.hold_ns), "{name}");
            assert!(timing.setup_ticks <= SETUP_TICKS_MAX, "{name}");
            assert!(timing.hold_ticks <= HOLD_TICKS_MAX, "{name}");
        }
        for driver in Driver::ALL
            .into_iter()
            .filter(|driver| driver.steps_on_falling_edge())
        {
            let timing = Timing::from(AxisProfile::of_driver(driver));
            let least = timing.interval_ticks_min();
            for interval in [least, least + 1, 2 * least, 1_000_000] {
                assert_eq!(timing.high_of(interval), timing.high_ticks_min);
            }
        }
        assert_eq!("a4989".parse::<Driver>(), Err(UnknownDriver));
        // LinuxCNC's table: rates of the slow ones.
        let rate = |driver: Driver| {
            let needs = driver.needs();
            1_000_000_000 / (needs.high_ns + needs.low_ns)
        };
        assert_eq!(rate(Driver::Tb6560), 3_333);
        assert_eq!(rate(Driver::Gecko540), 100_000);
        assert_eq!(rate(Driver::Dq542ma), 99_009);
        assert_eq!(rate(Driver::Sherline), 22_727);
    }
}
