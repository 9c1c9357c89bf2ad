//! The program `fleet`, run to its end.

use assert_cmd::Command;
use std::time::Duration;

/// Far more than a program takes that waits for several things; only a failure waits so long.
const PROGRAM_PATIENCE: Duration = Duration::from_secs(300);

/// What a program said, and how it ended.
pub(crate) struct Ran {
    pub(crate) code: Option<i32>,
    pub(crate) out: String,
    pub(crate) err: String,
}

/// Runs `fleet` with these words.
pub(crate) fn fleet(line: &[&str]) -> Ran {
    let output = Command::new(env!("CARGO_BIN_EXE_fleet"))
        .args(line)
        .timeout(PROGRAM_PATIENCE)
        .output()
        .expect("started");
    let text = |bytes: Vec<u8>| String::from_utf8(bytes).expect("UTF-8");
    Ran {
        code: output.status.code(),
        out: text(output.stdout),
        err: text(output.stderr),
    }
}
