//! Value change dumps.

use super::{Builder, Capture, Pin, pin, verdict::MARK};
use std::collections::HashMap;

/// Reads a value change dump.
pub(super) fn parse(text: &str) -> Result<Capture, String> {
    let mut builder = Builder::new();
    let mut pins: HashMap<&str, Option<(usize, Pin)>> = HashMap::new();
    let (mut ps_per_unit, mut at_ps, mut declared) = (None, 0_u64, false);
    let mut words = Words::new(text);
    while let Some(word) = words.next() {
        let line = words.line;
        let fail = |why: String| format!("line {line}: {why}");
        match word {
            "$timescale" => {
                let scale: String = words.until_end()?.concat();
                ps_per_unit = Some(timescale_ps(&scale).map_err(fail)?);
            }
            "$var" => {
                let parts = words.until_end()?;
                let [_, width, code, name, ..] = parts[..] else {
                    return Err(fail("$var wants type, width, code and name".to_owned()));
                };
                let found = pin(name).filter(|_| width == "1");
                let place = match found {
                    Some((axis, pin)) => Some((builder.capture.axis(&axis).map_err(fail)?, pin)),
                    None => {
                        builder.capture.other_signals += 1;
                        None
                    }
                };
                pins.insert(code, place);
            }
            "$comment" => {
                let comment = words.until_end()?;
                // The verdict comes last, so the scale is known.
                if let Some(said) = comment.split_first().filter(|(mark, _)| **mark == MARK) {
                    let verdict = builder.capture.verdict.get_or_insert_default();
                    verdict
                        .hear(said.1, ps_per_unit.unwrap_or(1))
                        .map_err(fail)?;
                }
            }
            "$enddefinitions" => {
                words.until_end()?;
                declared = true;
            }
            "$dumpvars" | "$dumpall" | "$dumpon" | "$dumpoff" | "$end" => {}
            _ if word.starts_with('$') => {
                words.until_end()?;
            }
            _ if !declared => return Err(fail(format!("{} before $enddefinitions", short(word)))),
            _ => {
                let ps_per_unit =
                    ps_per_unit.ok_or_else(|| fail("there is no $timescale".to_owned()))?;
                let (first, rest) = word.split_at(word.chars().next().map_or(0, char::len_utf8));
                let (value, code) = match first {
                    "#" => {
                        let units: u64 = rest
                            .parse()
                            .map_err(|_| fail(format!("{} is no time", short(word))))?;
                        let then_ps = units
                            .checked_mul(ps_per_unit)
                            .ok_or_else(|| fail("the time is too large".to_owned()))?;
                        if then_ps < at_ps {
                            return Err(fail("time goes back".to_owned()));
                        }
                        at_ps = then_ps;
                        continue;
                    }
                    "0" | "1" | "x" | "X" | "z" | "Z" => (first, rest),
                    "b" | "B" | "r" | "R" => {
                        let code = words.next();
                        (
                            rest,
                            code.ok_or_else(|| fail("a value without a code".to_owned()))?,
                        )
                    }
                    _ => return Err(fail(format!("{} is no value change", short(word)))),
                };
                let place = pins.get(code);
                let place =
                    place.ok_or_else(|| fail(format!("{} was not declared", short(code))))?;
                if let Some(place) = place {
                    match value {
                        "0" => builder.level(*place, at_ps, false).map_err(fail)?,
                        "1" => builder.level(*place, at_ps, true).map_err(fail)?,
                        _ => {}
                    }
                }
            }
        }
    }
    if !declared {
        return Err("this is no value change dump: it has no $enddefinitions".to_owned());
    }
    builder.capture.end_ps = at_ps;
    builder.capture.finish()
}

fn timescale_ps(scale: &str) -> Result<u64, String> {
    let wrong = || format!("timescale {}: 1 ps to 100 s are understood", short(scale));
    let unit_at = scale
        .find(|c: char| c.is_ascii_alphabetic())
        .ok_or_else(wrong)?;
    let (number, unit) = scale.split_at(unit_at);
    let ps = match unit {
        "ps" => 1,
        "ns" => 1_000,
        "us" => 1_000_000,
        "ms" => 1_000_000_000,
        "s" => 1_000_000_000_000,
        _ => return Err(wrong()),
    };
    match number {
        "1" => Ok(ps),
        "10" => Ok(10 * ps),
        "100" => Ok(100 * ps),
        _ => Err(wrong()),
    }
}

/// Returns the beginning of a word, for a message.
fn short(word: &str) -> String {
    let mut text: String = word.chars().take(20).filter(|c| !c.is_control()).collect();
    if text.len() < word.len() {
        text.push('…');
    }
    format!("`{text}`")
}

/// The words of a text with the number of their line.
struct Words<'t> {
    lines: std::iter::Enumerate<std::str::Lines<'t>>,
    words: std::str::SplitWhitespace<'t>,
    line: usize,
}

impl<'t> Words<'t> {
    fn new(text: &'t str) -> Self {
        Self {
            lines: text.lines().enumerate(),
            words: "".split_whitespace(),
            line: 0,
        }
    }

    /// Returns the words before the next `$end`.
    fn until_end(&mut self) -> Result<Vec<&'t str>, String> {
        let line = self.line;
        let mut words = Vec::new();
        for word in self.by_ref() {
            if word == "$end" {
                return Ok(words);
            }
            words.push(word);
        }
        Err(format!("line {line}: $end is missing"))
    }
}

impl<'t> Iterator for Words<'t> {
    type Item = &'t str;

    fn next(&mut self) -> Option<&'t str> {
        loop {
            if let Some(word) = self.words.next() {
                return Some(word);
            }
            let (index, line) = self.lines.next()?;
            (self.line, self.words) = (index + 1, line.split_whitespace());
        }
    }
}
