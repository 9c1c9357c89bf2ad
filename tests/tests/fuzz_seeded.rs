//! The fuzz targets of `tests/fuzz` with seeded input, on any toolchain: every input of the committed
//! corpora, and mutations of those.
//!
//! A failure prints its target and number; `FUZZ=job:4711 cargo test -p tests --test fuzz_seeded`
//! runs that one alone, `FUZZ_CASES=100000` more of them.

#![expect(unreachable_pub, reason = "a library there, modules here")]

#[path = "../fuzz/src/lib.rs"]
mod targets;

#[path = "../fuzz/src/gcode.rs"]
mod gcode;
#[path = "../fuzz/src/store.rs"]
mod store;

use std::{fs, path::Path};
use targets::{TARGETS, Target};
use tests::Random;

/// Mutations of each target in a normal run; a whole node and Lua take some hundred times longer
/// than the others.
const CASES: u64 = 4_000;
const SLOW_CASES: u64 = 200;

/// Inputs grow to this by mutation.
const BYTES_MAX: usize = 4_096;

/// Says what was running when it panicked.
struct Case<'t>(&'t str, u64);

impl Drop for Case<'_> {
    fn drop(&mut self) {
        if std::thread::panicking() {
            eprintln!("this was FUZZ={}:{}", self.0, self.1);
        }
    }
}

fn corpus(target: &Target) -> Vec<Vec<u8>> {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("fuzz/corpus");
    let mut files: Vec<_> = fs::read_dir(folder.join(target.name))
        .into_iter()
        .flatten()
        .map(|entry| entry.expect("an entry").path())
        .collect();
    files.sort();
    let read = |path| fs::read(path).expect("a file");
    let mut inputs: Vec<_> = files.into_iter().map(read).collect();
    inputs.extend((target.seeds)());
    inputs
}

fn mutate(random: &mut Random, bytes: &mut Vec<u8>, others: &[Vec<u8>]) {
    for _ in 0..=random.below(6) {
        let at = random.below(bytes.len() as u64 + 1) as usize;
        match random.below(8) {
            0 if at < bytes.len() => bytes[at] ^= 1 << random.below(8),
            1 if at < bytes.len() => bytes[at] = random.number() as u8,
            2 => bytes.insert(at, random.number() as u8),
            3 if at < bytes.len() => drop(bytes.remove(at)),
            4 => bytes.truncate(at),
            5 => {
                let copy = bytes[at..].to_vec();
                bytes.extend(copy);
            }
            6 => {
                // The end of another input.
                let other = &others[random.below(others.len() as u64) as usize];
                let from = random.below(other.len() as u64 + 1) as usize;
                bytes.truncate(at);
                bytes.extend_from_slice(&other[from..]);
            }
            _ => {
                // Numbers at the edge of what a field holds.
                let edge = [0, 1, 0x7f, 0x80, 0xff][random.below(5) as usize];
                let end = (at + 1 + random.below(8) as usize).min(bytes.len());
                bytes[at..end].fill(edge);
            }
        }
    }
    bytes.truncate(BYTES_MAX);
}

fn run(target: &Target) {
    let corpus = corpus(target);
    for (number, input) in corpus.iter().enumerate() {
        let _case = Case(target.name, number as u64);
        (target.check)(input);
    }
    let alone = std::env::var("FUZZ").ok().map(|text| {
        let (name, number) = text.split_once(':').expect("TARGET:NUMBER");
        (name.to_owned(), number.parse::<u64>().expect("a number"))
    });
    let slow = [
        "node",
        "signed",
        "script",
        "tls",
        "update",
        "provision",
        "store",
    ]
    .contains(&target.name);
    let cases = std::env::var("FUZZ_CASES")
        .ok()
        .map(|text| text.parse().expect("a number"));
    let cases = cases.unwrap_or(if slow { SLOW_CASES } else { CASES });
    let numbers = match alone {
        Some((name, number)) if name == target.name => number..number + 1,
        Some(_) => 0..0,
        None => 0..cases,
    };
    for number in numbers {
        let mut random = Random(number);
        let mut input = corpus[random.below(corpus.len() as u64) as usize].clone();
        mutate(&mut random, &mut input, &corpus);
        let _case = Case(target.name, number);
        (target.check)(&input);
    }
}

macro_rules! seeded {
    ($($test:ident: $target:literal,)*) => {$(
        #[test]
        fn $test() {
            run(TARGETS.iter().find(|target| target.name == $target).expect("a target"));
        }
    )*};
}

seeded! {
    messages_that_can_be_read_can_be_written: "wire",
    orders_are_read_whole_or_not_at_all: "batch",
    a_stream_is_the_same_however_it_is_cut: "reader",
    a_session_survives_whatever_a_router_says: "session",
    jobs_that_are_accepted_can_be_kept: "job",
    keys_name_what_they_are_built_from: "key",
    noise_on_the_serial_line_harms_nothing: "provision",
    no_message_makes_an_unsigned_image_boot: "update",
    a_node_that_is_told_anything_keeps_its_position: "node",
    scripts_end_or_give_way: "script",
    a_router_proves_who_it_is_or_is_not_heard: "tls",
    a_proof_includes_nothing_behind_what_was_signed: "proof",
    without_a_key_nobody_moves_a_node_that_asks_for_signatures: "signed",
    a_wish_to_move_by_hand_is_an_order_or_is_refused_at_a_place: "jog",
}

#[test]
fn a_program_that_is_taken_can_be_kept() {
    run(&Target {
        name: "gcode",
        check: gcode::check,
        seeds: gcode::seeds,
    });
}

#[test]
fn a_damaged_store_is_opened_or_refused_in_words() {
    run(&Target {
        name: "store",
        check: store::check,
        seeds: store::seeds,
    });
}
