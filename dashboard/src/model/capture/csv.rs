//! Tables of logic analysers: a head with names, then a time and a level for each signal a line.
//!
//! Lines that begin with `;` or `#` are remarks. The first column is the time, in seconds unless
//! its name says `ms`, `us`, `µs`, `ns` or `ps`.

use super::{Builder, Capture, PS_PER_S};

/// Reads a table.
pub(super) fn parse(text: &str) -> Result<Capture, String> {
    let mut builder = Builder::new();
    let lines = text.lines().enumerate();
    let mut lines = lines.filter(|(_, line)| {
        let line = line.trim();
        !(line.is_empty() || line.starts_with([';', '#']))
    });
    let (_, head) = lines.next().ok_or("the file is empty")?;
    let mut names = head.split(',').map(|name| name.trim().trim_matches('"'));
    let time = names.next().unwrap_or_default();
    if time.is_empty() || time.starts_with(|c: char| c.is_ascii_digit() || c == '-') {
        return Err("the first line must name the columns: time, step0, dir0".to_owned());
    }
    let ps_per_unit = unit_ps(time);
    let mut places = Vec::new();
    for name in names {
        places.push(match super::pin(name) {
            Some((axis, pin)) => Some((builder.capture.axis(&axis)?, pin)),
            None => {
                builder.capture.other_signals += 1;
                None
            }
        });
    }
    let mut zero = None;
    let mut before_ps = 0;
    for (index, line) in lines {
        let fail = |why: &str| format!("line {}: {why}", index + 1);
        let mut cells = line.split(',').map(str::trim);
        let time: f64 = cells
            .next()
            .and_then(|time| time.parse().ok())
            .filter(|time: &f64| time.is_finite())
            .ok_or_else(|| fail("the time is no number"))?;
        // Analysers call the trigger zero, so that what was before it is negative.
        let zero = *zero.get_or_insert(time.min(0.0));
        let at = ((time - zero) * ps_per_unit).round();
        if !(0.0..=u64::MAX as f64 / 2.0).contains(&at) {
            return Err(fail("the time goes back or is too large"));
        }
        let at_ps = at as u64;
        if at_ps < before_ps {
            return Err(fail("time goes back"));
        }
        before_ps = at_ps;
        for place in &places {
            let cell = cells.next().ok_or_else(|| fail("a column is missing"))?;
            let Some(place) = place else { continue };
            let high = match cell {
                "0" => false,
                "1" => true,
                _ => return Err(fail("a level is neither 0 nor 1")),
            };
            builder
                .level(*place, at_ps, high)
                .map_err(|why| fail(&why))?;
        }
    }
    builder.capture.end_ps = before_ps;
    builder.capture.finish()
}

fn unit_ps(name: &str) -> f64 {
    let name = name.to_lowercase();
    let mut words = name.split(|c: char| !c.is_alphabetic());
    let unit = words.rfind(|word| !word.is_empty());
    match unit.unwrap_or_default() {
        "ms" => PS_PER_S / 1e3,
        "us" | "µs" | "μs" => PS_PER_S / 1e6,
        "ns" => PS_PER_S / 1e9,
        "ps" => 1.0,
        _ => PS_PER_S,
    }
}
