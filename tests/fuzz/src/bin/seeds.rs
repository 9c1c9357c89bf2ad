//! Writes the first inputs of each corpus: `cargo run --bin seeds` in this folder.

use std::{fs, path::Path};

fn main() {
    let corpus = Path::new(env!("CARGO_MANIFEST_DIR")).join("corpus");
    for target in &fuzz::TARGETS {
        let folder = corpus.join(target.name);
        fs::create_dir_all(&folder).expect("a folder");
        for (number, seed) in (target.seeds)().iter().enumerate() {
            let file = folder.join(format!("seed-{number:02}"));
            fs::write(file, seed).expect("a file");
        }
    }
}
