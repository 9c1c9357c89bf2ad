//! Times of day and minutes, as schedules write them.

use keys::FleetMicros;

pub(super) const DAY_US: u64 = 86_400_000_000;

/// Reads `05:00` or `05:00:30`.
pub(super) fn time_of_day_us(text: &str) -> Option<u64> {
    let whole = match text.len() {
        5 => format!("1970-01-01T{text}:00Z"),
        8 => format!("1970-01-01T{text}Z"),
        _ => return None,
    };
    FleetMicros::from_rfc3339(&whole).map(|at| at.0)
}

/// `2611220500`: year, month, day, hour and minute of an instant.
pub(super) fn minute_of(at: FleetMicros) -> String {
    let text = at.to_string();
    let digits = text.chars().filter(char::is_ascii_digit);
    digits.skip(2).take(10).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_minute_has_a_name_that_sorts() {
        let at = FleetMicros::from_rfc3339("2026-11-22T05:07:09.5Z").expect("a time");
        assert_eq!(minute_of(at), "2611220507");
    }

    #[test]
    fn times_of_day_have_two_forms() {
        assert_eq!(time_of_day_us("05:00"), Some(5 * 3_600_000_000));
        assert_eq!(time_of_day_us("00:00:01"), Some(1_000_000));
        for bad in ["5:00", "24:00", "05-00", "", "05:00:00.5"] {
            assert_eq!(time_of_day_us(bad), None, "{bad}");
        }
    }
}
