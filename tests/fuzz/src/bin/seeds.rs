//! Writes the first inputs of each corpus: `cargo run --bin seeds` in this folder; with
//! `--features store` of those that need the gateway, too.

#[cfg(feature = "store")]
#[path = "../gcode.rs"]
mod gcode;
#[cfg(feature = "store")]
#[path = "../store.rs"]
mod store;

use std::{fs, path::Path};

fn main() {
    let of = |target: &fuzz::Target| (target.name, (target.seeds)());
    let mut all: Vec<_> = fuzz::TARGETS.iter().map(of).collect();
    #[cfg(feature = "store")]
    all.extend([("gcode", gcode::seeds()), ("store", store::seeds())]);
    let corpus = Path::new(env!("CARGO_MANIFEST_DIR")).join("corpus");
    for (name, seeds) in all {
        let folder = corpus.join(name);
        fs::create_dir_all(&folder).expect("a folder");
        for (number, seed) in seeds.iter().enumerate() {
            let file = folder.join(format!("seed-{number:02}"));
            fs::write(file, seed).expect("a file");
        }
    }
}
