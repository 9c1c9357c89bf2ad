//! What the driver of an axis demands, as an option of `fleet provision` and in words.

use provision::{Setting, driver, record::AxisSettings};

/// A number of [`AxisSettings`] by its name.
type Number = (&'static str, fn(&mut AxisSettings) -> &mut u32);

/// In ns, but for the last two: steps/s² and Hz.
const NUMBERS: [Number; 7] = [
    ("high", |driver| &mut driver.high_ns_min),
    ("low", |driver| &mut driver.low_ns_min),
    ("pulse", |driver| &mut driver.high_ns),
    ("setup", |driver| &mut driver.dir_setup_ns),
    ("hold", |driver| &mut driver.dir_hold_ns),
    ("stop", |driver| &mut driver.stop_accel_hz_per_s),
    ("corner", |driver| &mut driver.junction_hz),
];

/// An axis and what its driver demands.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Driver {
    axis: u8,
    settings: AxisSettings,
}

impl Driver {
    /// Returns the setting.
    pub(crate) fn setting(self) -> Setting {
        Setting::Axis {
            axis: self.axis,
            settings: self.settings,
        }
    }
}

/// Reads `0=tmc2209` or `1=drv8825,setup=1000,inverted`.
pub(crate) fn read(text: &str) -> Result<Driver, String> {
    let parse = || {
        let (axis, words) = text.split_once('=')?;
        let mut words = words.split(',');
        let mut settings = AxisSettings::named(words.next()?)?;
        for word in words {
            if word == "inverted" {
                settings.direction_inverted = true;
                continue;
            }
            let (name, number) = word.split_once('=')?;
            let (_, of) = NUMBERS.iter().find(|(known, _)| *known == name)?;
            *of(&mut settings) = number.parse().ok()?;
        }
        Some(Driver {
            axis: axis.parse().ok()?,
            settings,
        })
    };
    parse().ok_or_else(|| {
        let numbers = NUMBERS.map(|(name, _)| name).join(", ");
        format!(
            "no AXIS=DRIVER,NAME=NUMBER,… with one of {}; {numbers}, inverted",
            driver::names().collect::<Vec<_>>().join(", ")
        )
    })
}

/// Returns a line for each axis, as its option would be given.
pub(crate) fn lines(axes: &[AxisSettings]) -> Vec<(&'static str, String)> {
    let line = |(axis, settings): (usize, &AxisSettings)| ("driver", named(axis, settings));
    axes.iter().enumerate().map(line).collect()
}

/// Names it by the driver from which it differs least.
fn named(axis: usize, settings: &AxisSettings) -> String {
    let words = |name: &str| {
        let mut known = AxisSettings::named(name).expect("it is in the list");
        let mut told = *settings;
        let mut words = vec![name.to_owned()];
        for (name, of) in NUMBERS {
            let number = *of(&mut told);
            if *of(&mut known) != number {
                words.push(format!("{name}={number}"));
            }
        }
        if settings.direction_inverted {
            words.push("inverted".to_owned());
        }
        words
    };
    let nearest = driver::names().map(words).min_by_key(Vec::len);
    format!("{axis}={}", nearest.unwrap_or_default().join(","))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_given_is_what_is_shown() {
        for text in [
            "0=tmc2209",
            "0=default",
            "0=drv8825,setup=1000,inverted",
            "0=a4988,high=1500,low=1200,stop=20000,corner=0",
        ] {
            let driver = read(text).expect("legal");
            assert!(driver.settings.is_legal(), "{text}");
            assert_eq!(lines(&[driver.settings]), [("driver", text.to_owned())]);
        }
        let driver = read("3=default,high=100,low=100,setup=20,hold=20").expect("legal");
        let shown = lines(&[driver.settings]);
        assert_eq!(
            shown,
            [("driver", "0=tmc2209".to_owned())],
            "the same times"
        );
        assert_eq!(driver.axis, 3);
    }

    #[test]
    fn what_is_none_is_refused() {
        for wrong in [
            "",
            "0",
            "0=",
            "x=tmc2209",
            "0=tmc",
            "0=tmc2209,setup",
            "0=tmc2209,setup=-1",
            "0=tmc2209,speed=1",
            "high=1",
        ] {
            assert!(read(wrong).is_err(), "{wrong}");
        }
    }
}
