//! Numbers and times as an operator reads them.

use crate::message::Moment;
use keys::{
    FleetMicros,
    record::{ClockRecord, PaceRecord},
};

/// Returns the words for a hold, or a speed that is not the usual one: `held, at 50 %`.
pub fn pace(pace: PaceRecord) -> String {
    match (pace.hold, pace.percent) {
        (true, 100) => "held".to_owned(),
        (true, percent) => format!("held, at {percent} %"),
        (false, percent) => format!("at {percent} %"),
    }
}

/// Returns the words for the shortest and the longest round trip, µs.
pub fn travel([shortest_us, longest_us]: [f64; 2]) -> String {
    let (shortest_ms, longest_ms) = (shortest_us / 1e3, longest_us / 1e3);
    format!("round trip {shortest_ms:.2} to {longest_ms:.2} ms")
}

/// Returns `2026-11-21 03:00:00.123` of `2026-11-21T03:00:00.123456Z`.
pub fn date_and_time(at: FleetMicros) -> String {
    let text = at.to_string();
    format!("{} {}", &text[..10], &text[11..23])
}

/// Returns the time of day in UTC with milliseconds.
pub fn time_of_day(at: Moment) -> String {
    FleetMicros(at.0).to_string()[11..23].to_owned()
}

/// Returns how long ago: `0.3 s`, `12 s`, `5 min`, `3 h`, `2 d`.
pub fn age(seconds: f64) -> String {
    match seconds {
        ..9.95 => format!("{seconds:.1} s"),
        ..99.5 => format!("{seconds:.0} s"),
        ..5_940.0 => format!("{:.0} min", seconds / 60.0),
        ..172_800.0 => format!("{:.0} h", seconds / 3_600.0),
        _ => format!("{:.0} d", seconds / 86_400.0),
    }
}

/// Returns an amount of memory: `512 B`, `39.1 KiB`, `7.0 MiB`.
pub fn bytes(bytes: u32) -> String {
    let bytes = f64::from(bytes);
    match bytes {
        ..1_024.0 => format!("{bytes} B"),
        ..1_048_576.0 => format!("{:.1} KiB", bytes / 1_024.0),
        _ => format!("{:.1} MiB", bytes / 1_048_576.0),
    }
}

/// Returns a whole number in groups of three: `-1 234 567`, with no-break spaces.
pub fn steps(steps: i64) -> String {
    let digits = steps.unsigned_abs().to_string();
    let mut text = String::with_capacity(digits.len() * 2);
    if steps < 0 {
        text.push('-');
    }
    for (index, digit) in digits.chars().enumerate() {
        if index > 0 && (digits.len() - index).is_multiple_of(3) {
            text.push('\u{a0}');
        }
        text.push(digit);
    }
    text
}

/// Returns the positions of all axes on one line.
pub fn positions(positions_steps: &[i64]) -> String {
    let texts: Vec<String> = positions_steps.iter().map(|at| steps(*at)).collect();
    texts.join(" · ")
}

/// Returns the speeds of all axes on one line, `–` when nothing moves.
pub fn speeds(speeds_hz: &[f64]) -> String {
    if speeds_hz.iter().all(|speed| *speed == 0.0) {
        return "–".to_owned();
    }
    let texts: Vec<String> = speeds_hz
        .iter()
        .map(|speed| steps(speed.round() as i64))
        .collect();
    texts.join(" · ")
}

/// Returns a duration of unknown size: `41 µs`, `12.3 ms`, `1.20 s`.
pub fn micros(us: f64) -> String {
    match us.abs() {
        ..1_000.0 => format!("{us:.0} µs"),
        ..1e6 => format!("{:.1} ms", us / 1e3),
        _ => format!("{:.2} s", us / 1e6),
    }
}

/// Returns offset and error of a clock: `+12 µs ± 41 µs`.
pub fn clock(clock: &ClockRecord) -> String {
    let sign = if clock.offset_us >= 0.0 { "+" } else { "" };
    let (offset, error) = (micros(clock.offset_us), micros(clock.error_us));
    format!("{sign}{offset} ± {error}")
}

/// Returns a count with its noun: `1 node`, `3 nodes`.
pub fn count(count: usize, noun: &str) -> String {
    if count == 1 {
        format!("1 {noun}")
    } else {
        format!("{count} {noun}s")
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_read_as_an_operator_expects() {
        assert_eq!(steps(-1_234_567).replace('\u{a0}', "_"), "-1_234_567");
        assert_eq!(steps(999), "999");
        assert_eq!(steps(i64::MIN).len(), 20 + 6 * 2);
        assert_eq!(speeds(&[0.0, -0.0]), "–");
        assert_eq!(micros(-12_345.0), "-12.3 ms");
        assert_eq!(
            [0.31, 12.4, 61.0, 7_200.0].map(age),
            ["0.3 s", "12 s", "61 s", "2 h"]
        );
        let record = ClockRecord {
            offset_us: 12.3,
            error_us: 1_500.0,
            drift_ppm: 0.0,
        };
        assert_eq!(clock(&record), "+12 µs ± 1.5 ms");
    }

    #[test]
    fn times_are_utc() {
        let at = FleetMicros(1_795_230_000_123_456);
        assert_eq!(date_and_time(at), "2026-11-21 03:00:00.123");
        assert_eq!(time_of_day(Moment(at.0)), "03:00:00.123");
    }
}
