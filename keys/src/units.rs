//! Two clocks that cannot be mixed, and UTC as clients read it.

use core::fmt;
use serde::{Deserialize, Serialize};

/// A node's own free-running clock: microseconds since its boot. Never set, never steered.
#[derive(
    Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize,
)]
pub struct LocalMicros(pub u64);

/// The gateway's clock: microseconds of UTC since 1970-01-01.
#[derive(
    Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize,
)]
pub struct FleetMicros(pub u64);

impl LocalMicros {
    /// Returns the time since `earlier`, zero if that lies ahead.
    pub const fn since_us(self, earlier: Self) -> u64 {
        self.0.saturating_sub(earlier.0)
    }

    /// Returns this instant moved later by `delay_us`.
    #[must_use]
    pub const fn plus_us(self, delay_us: u64) -> Self {
        Self(self.0.saturating_add(delay_us))
    }
}

impl FleetMicros {
    /// Returns the time since `earlier`, zero if that lies ahead.
    pub const fn since_us(self, earlier: Self) -> u64 {
        self.0.saturating_sub(earlier.0)
    }

    /// Returns this instant moved later by `delay_us`.
    #[must_use]
    pub const fn plus_us(self, delay_us: u64) -> Self {
        Self(self.0.saturating_add(delay_us))
    }

    /// Reads RFC 3339 in UTC (`…Z`) with up to six digits of fraction, as [`fmt::Display`] writes it.
    pub fn from_rfc3339(text: &str) -> Option<Self> {
        let bytes = text.as_bytes();
        let number = |from: usize, to: usize| -> Option<u64> {
            let digits = bytes.get(from..to)?;
            if !digits.iter().all(u8::is_ascii_digit) {
                return None;
            }
            core::str::from_utf8(digits).ok()?.parse().ok()
        };
        let mark = |at: usize, byte: u8| (bytes.get(at) == Some(&byte)).then_some(());
        let (year, month, day) = (number(0, 4)?, number(5, 7)?, number(8, 10)?);
        let (hour, minute, second) = (number(11, 13)?, number(14, 16)?, number(17, 19)?);
        mark(4, b'-')?;
        mark(7, b'-')?;
        mark(10, b'T')?;
        mark(13, b':')?;
        mark(16, b':')?;
        if !(1970..=9999).contains(&year)
            || !(1..=12).contains(&month)
            || !(1..=31).contains(&day)
            || hour > 23
            || minute > 59
            || second > 59
        {
            return None;
        }
        let mut at = 19;
        let mut fraction_us = 0;
        if bytes.get(at) == Some(&b'.') {
            let from = at + 1;
            at = from;
            while bytes.get(at).is_some_and(u8::is_ascii_digit) {
                at += 1;
            }
            let count = at - from;
            if !(1..=6).contains(&count) {
                return None;
            }
            fraction_us = number(from, at)? * 10u64.pow(6 - count as u32);
        }
        mark(at, b'Z')?;
        if at + 1 != bytes.len() {
            return None;
        }
        let days = days_from_civil(year, month, day);
        let seconds = days * 86_400 + hour * 3_600 + minute * 60 + second;
        Some(Self(seconds * 1_000_000 + fraction_us))
    }
}

/// Days since 1970-01-01 of a date of the Gregorian calendar; the year is counted from March, so
/// that the leap day is the last one.
const fn days_from_civil(year: u64, month: u64, day: u64) -> u64 {
    let shifted_year = if month <= 2 { year - 1 } else { year };
    let month_from_march = (month + 9) % 12;
    let day_of_year = (153 * month_from_march + 2) / 5 + day - 1;
    let leap_days = shifted_year / 4 - shifted_year / 100 + shifted_year / 400;
    // 719_468 days lie between 0000-03-01 and 1970-01-01.
    365 * shifted_year + leap_days + day_of_year - 719_468
}

/// The inverse of [`days_from_civil`].
const fn civil_from_days(days: u64) -> (u64, u64, u64) {
    let shifted = days + 719_468;
    let era = shifted / 146_097;
    let day_of_era = shifted % 146_097;
    let year_of_era =
        (day_of_era - day_of_era / 1_460 + day_of_era / 36_524 - day_of_era / 146_096) / 365;
    let day_of_year = day_of_era - (365 * year_of_era + year_of_era / 4 - year_of_era / 100);
    let month_from_march = (5 * day_of_year + 2) / 153;
    let day = day_of_year - (153 * month_from_march + 2) / 5 + 1;
    let month = if month_from_march < 10 {
        month_from_march + 3
    } else {
        month_from_march - 9
    };
    let year = year_of_era + era * 400 + if month <= 2 { 1 } else { 0 };
    (year, month, day)
}

impl fmt::Display for FleetMicros {
    /// RFC 3339 in UTC with microseconds: `2026-11-21T03:00:00.123000Z`.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let (seconds, fraction_us) = (self.0 / 1_000_000, self.0 % 1_000_000);
        let (year, month, day) = civil_from_days(seconds / 86_400);
        let of_day = seconds % 86_400;
        let (hour, minute, second) = (of_day / 3_600, of_day / 60 % 60, of_day % 60);
        write!(
            f,
            "{year:04}-{month:02}-{day:02}T{hour:02}:{minute:02}:{second:02}.{fraction_us:06}Z"
        )
    }
}

#[cfg(feature = "json")]
pub mod rfc3339 {
    //! `#[serde(with = "rfc3339")]` for a [`FleetMicros`] in JSON.
    use super::FleetMicros;
    use serde::{Deserialize, Deserializer, Serializer, de::Error};

    /// Writes the instant as RFC 3339.
    ///
    /// # Errors
    /// Those of the serializer.
    pub fn serialize<S: Serializer>(at: &FleetMicros, to: S) -> Result<S::Ok, S::Error> {
        to.collect_str(at)
    }

    /// Reads the instant from RFC 3339.
    ///
    /// # Errors
    /// Anything that is not RFC 3339 in UTC.
    pub fn deserialize<'de, D: Deserializer<'de>>(from: D) -> Result<FleetMicros, D::Error> {
        let text = std::string::String::deserialize(from)?;
        FleetMicros::from_rfc3339(&text).ok_or_else(|| D::Error::custom("not a time in RFC 3339"))
    }
}

#[cfg(test)]
mod tests {
    extern crate std;
    use super::*;
    use std::string::ToString;

    #[test]
    fn a_known_instant_reads_as_the_calendar_says() {
        // `date -u -d '2026-11-21T03:00:00Z' +%s` prints 1795230000.
        let at = FleetMicros(1_795_230_000_123_456);
        assert_eq!(at.to_string(), "2026-11-21T03:00:00.123456Z");
        assert_eq!(FleetMicros(0).to_string(), "1970-01-01T00:00:00.000000Z");
    }

    #[test]
    fn every_day_of_four_centuries_survives_the_round_trip() {
        for day in 0..146_097_u64 {
            let at = FleetMicros(day * 86_400_000_000 + 1);
            assert_eq!(FleetMicros::from_rfc3339(&at.to_string()), Some(at));
        }
    }

    #[test]
    fn times_that_are_not_utc_are_refused() {
        for text in [
            "",
            "2026-11-21",
            "2026-11-21T03:00:00",
            "2026-11-21T03:00:00+01:00",
            "2026-13-21T03:00:00Z",
        ] {
            assert_eq!(FleetMicros::from_rfc3339(text), None, "{text}");
        }
        assert!(FleetMicros::from_rfc3339("2026-11-21T03:00:00.1Z").is_some());
    }
}
