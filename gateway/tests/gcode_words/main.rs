//! Every word of G-code that the reader knows: a program in which it does what it says, and one in which
//! it is wrong. A word that the reader learns has to come into the tables here.

mod table;

use gateway::job::gcode::{Machine, compile};
use keys::job::JobCommand;
use std::collections::BTreeSet;
use table::{
    Case,
    Does::{Gives, Nothing, Refused},
    GENERAL, OTHER, VALUES,
};

/// 80 steps a mm, 400 for Z, 10 a degree; G0 goes 100 mm/s, Z 10 mm/s, A 60 °/s. The zeros of G54 to
/// G59 are at X 1 to 6 mm, the home is at 7, 3, 4, 5.
fn machine() -> Machine {
    Machine {
        steps_per_mm: vec![80.0, 80.0, 400.0, 10.0],
        speed_mm_min: vec![6_000.0, 6_000.0, 600.0, 3_600.0],
        g28_mm: vec![7.0, 3.0, 4.0, 5.0],
        offsets_mm: std::array::from_fn(|index| vec![1.0 + index as f64, 0.0, 0.0, 0.0]),
        // Half a circle of 1 mm is two chords.
        arc_tolerance_mm: 0.3,
        ..Machine::alike(4, 80.0, 6_000.0, 500.0)
    }
}

fn cases() -> impl Iterator<Item = Case> {
    GENERAL.into_iter().chain(OTHER).chain(VALUES)
}

/// A program's commands in short, or what is wrong with it.
fn run(text: &str) -> Result<Vec<String>, String> {
    let program = compile(text, &machine()).map_err(|error| error.to_string())?;
    let command = |command: &JobCommand| match command {
        JobCommand::Line(line) => format!("line {:?} {}", line.steps, line.speed_hz),
        JobCommand::RampTo(ramp) => format!("to {}:{} {}", ramp.axis, ramp.position, ramp.speed_hz),
        JobCommand::Laser(laser) => format!("laser {}", laser.power_percent),
        JobCommand::Pause(pause) => format!("pause {}", pause.ms),
        other => other.word().to_owned(),
    };
    Ok(program.commands.iter().map(command).collect())
}

/// The program without the word; lines and columns are of no meaning then.
fn without(text: &str, word: &str) -> String {
    let keep = |line: &str| {
        let words = line.split(' ').filter(|other| *other != word);
        words.collect::<Vec<_>>().join(" ")
    };
    let rest: Vec<String> = text.lines().map(keep).collect();
    let rest = rest.join("\n");
    assert_ne!(rest, text, "{word} is not in its program");
    rest
}

#[test]
fn every_word_does_what_it_says() {
    for (word, text, does, _) in cases() {
        let outcome = run(text);
        let others = run(&without(text, word));
        match does {
            Gives(commands) => {
                let commands: Vec<String> = commands.iter().map(|text| (*text).into()).collect();
                assert_eq!(outcome, Ok(commands), "{word} in {text:?}");
                assert_ne!(others, outcome, "{word} has no part in what {text:?} does");
            }
            Nothing => {
                assert!(outcome.is_ok(), "{word}: {outcome:?}");
                assert_eq!(others, outcome, "{word} in {text:?}");
            }
            Refused => {
                assert!(outcome.is_err(), "{word}: {outcome:?}");
                assert!(others.is_ok(), "{word}: {others:?}");
            }
        }
    }
}

#[test]
fn what_is_wrong_about_a_word_is_told_with_line_and_column() {
    for (word, _, _, (text, line, column, words)) in cases() {
        let error = run(text).expect_err(text);
        let place = format!("line {line}, column {column}: ");
        assert!(error.starts_with(&place), "{word}, {text:?}: {error}");
        assert!(error.contains(words), "{word}, {text:?}: {error}");
    }
}

/// The codes that the reader does not call unknown.
fn known(letter: char) -> BTreeSet<String> {
    let code = |tenths: u32| match tenths % 10 {
        0 => format!("{letter}{}", tenths / 10),
        tenth => format!("{letter}{}.{tenth}", tenths / 10),
    };
    let is_known = |code: &String| match run(code) {
        Ok(_) => true,
        Err(error) => !error.contains("is not known"),
    };
    (0..=9_999).map(code).filter(is_known).collect()
}

#[test]
fn every_code_that_the_reader_knows_stands_in_the_tables() {
    let words = |cases: &[Case]| -> BTreeSet<String> {
        cases.iter().map(|(word, ..)| (*word).to_owned()).collect()
    };
    assert_eq!(known('G'), words(&GENERAL));
    assert_eq!(known('M'), words(&OTHER));
}

#[test]
fn every_letter_that_the_reader_knows_stands_in_the_tables() {
    let is_known = |letter: &char| {
        let error = run(&format!("{letter}1")).err().unwrap_or_default();
        !error.contains("means nothing") && !error.contains("not understood")
    };
    let known: BTreeSet<char> = ('A'..='Z').filter(is_known).collect();
    let cases = cases().filter_map(|(word, ..)| word.chars().next());
    assert_eq!(known, cases.collect());
    // Small letters are the same.
    assert_eq!(run("g91 g1 x1 f600"), run("G91 G1 X1 F600"));
}

#[test]
fn the_page_of_help_names_every_code() {
    let page = include_str!("../../src/bin/fleet/help/gcode.txt");
    let named = |code: &str| {
        // G54 to G59 are a range there.
        let code = match code {
            "G55" | "G56" | "G57" | "G58" => "G54",
            code => code,
        };
        page.split(|letter: char| !letter.is_ascii_alphanumeric() && letter != '.')
            .any(|word| word.trim_end_matches('.') == code)
    };
    for (code, ..) in GENERAL.into_iter().chain(OTHER) {
        assert!(named(code), "{code} is not on the page");
    }
}
