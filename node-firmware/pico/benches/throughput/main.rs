//! Messages a second and round trips through an in-process router on loopback, beside the zenoh
//! crate's own client in the same role, in the same run, with the same batch size.
//!
//! ```sh
//! cargo bench -p pico                   # everything: under two minutes
//! cargo bench -p pico -- publishing 8   # lines that begin so
//! ```
//!
//! All sides share the machine's cores, so only the ratios say something. Everybody sends with
//! blocking congestion control, so every message arrives. The other side of a publisher or
//! subscriber is always the zenoh crate's client as it is by default; both ends of a round trip are
//! of the same kind. The last column compares with the zenoh crate's default client, whose batches
//! are the largest there are.
//!
//! “bare” is the same session on a thread that does nothing but block in the socket's read: what tells
//! how much of a round trip is the runtime's.

mod roundtrip;
#[path = "../../tests/router/mod.rs"]
mod router;
mod side;
mod stream;

use std::{collections::HashMap, time::Duration};

use side::Side;

/// Each figure takes about this long.
const ROUND: Duration = Duration::from_millis(800);

/// Sizes of values, bytes.
const PAYLOADS: [usize; 3] = [8, 64, 1_024];

/// zenoh-pico's default, and the largest.
const BATCHES: [u16; 2] = [2_048, u16::MAX];

#[tokio::main]
async fn main() {
    let wanted: Vec<String> = std::env::args()
        .skip(1)
        .filter(|argument| !argument.starts_with('-'))
        .collect();
    let wanted = wanted.join(" ");
    println!("messages/s    bytes sent    batch      ours     zenoh   ratio  of default");
    for role in ["publishing", "subscribing"] {
        for payload_bytes in PAYLOADS {
            for express in [false, true] {
                let name = name(role, payload_bytes, express);
                if !name.starts_with(&wanted) {
                    continue;
                }
                let measure = async |side| {
                    let default = Side::Rust(u16::MAX);
                    let (publisher, subscriber) = match role {
                        "publishing" => (side, default),
                        _ => (default, side),
                    };
                    stream::measure(publisher, subscriber, payload_bytes, express).await
                };
                let mut rates = HashMap::new();
                for side in sides() {
                    rates.insert(side, measure(side).await);
                }
                print_lines(&name, &rates, |ours, zenoh| ours / zenoh);
            }
        }
    }
    println!(
        "round trip, µs median              ours     zenoh   ratio  of default      bare   ratio"
    );
    for payload_bytes in PAYLOADS {
        for express in [false, true] {
            let name = name("there, back", payload_bytes, express);
            if !name.starts_with(&wanted) {
                continue;
            }
            let mut medians = HashMap::new();
            let bare = BATCHES.map(Side::Bare);
            for side in sides().chain(bare) {
                medians.insert(side, roundtrip::measure(side, payload_bytes, express).await);
            }
            print_lines(&name, &medians, |ours, zenoh| zenoh / ours);
        }
    }
}

fn name(role: &str, payload_bytes: usize, express: bool) -> String {
    let sent = if express { "express" } else { "batched" };
    format!("{role} {payload_bytes} {sent}")
}

fn sides() -> impl Iterator<Item = Side> {
    let both = |batch_bytes| [Side::Ours(batch_bytes), Side::Rust(batch_bytes)];
    BATCHES.into_iter().flat_map(both)
}

/// One line for each batch size. `better` says how much better the first figure is.
fn print_lines(name: &str, figures: &HashMap<Side, f64>, better: impl Fn(f64, f64) -> f64) {
    let mut words: Vec<&str> = name.rsplitn(3, ' ').collect();
    words.reverse();
    for batch_bytes in BATCHES {
        let ours = figures[&Side::Ours(batch_bytes)];
        let zenoh = figures[&Side::Rust(batch_bytes)];
        let default = figures[&Side::Rust(u16::MAX)];
        println!(
            "{:12} {:>6} {} {batch_bytes:>6} {ours:>9.0} {zenoh:>9.0} {:>7.2} {:>11.2}{}",
            words[0],
            words[1],
            words[2],
            better(ours, zenoh),
            better(ours, default),
            figures
                .get(&Side::Bare(batch_bytes))
                .map_or_else(String::new, |bare| {
                    format!(" {bare:>9.0} {:>7.2}", better(*bare, zenoh))
                }),
        );
    }
}
