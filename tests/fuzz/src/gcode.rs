//! A program in G-code for a machine of two or three axes: its commands are such as a node keeps, and
//! what is wrong is at a line and a column that the program has.

use gateway::job::gcode::{Machine, compile};
use keys::Command;

/// See the module. The first byte: how many axes.
pub fn check(data: &[u8]) {
    let Some((axes, text)) = data.split_first() else {
        return;
    };
    let Ok(text) = std::str::from_utf8(text) else {
        return;
    };
    let machine = Machine::alike(2 + usize::from(axes % 2), 80.0, 6_000.0, 500.0);
    match compile(text, &machine) {
        Ok(program) => {
            assert!(!program.commands.is_empty());
            for command in &program.commands {
                let command: Command = command.to_command(|_| 1);
                let again = Command::from_words(&command.to_words()).expect("a node keeps it");
                assert_eq!(again, command);
            }
            let time = program.preview.time_s;
            assert!(time.is_finite() && time >= 0.0, "{time}");
        }
        Err(error) => {
            assert!(!error.message.is_empty());
            assert!(error.line >= 1 && error.line <= text.lines().count().max(1));
            assert!(error.column >= 1);
            assert!(error.message.len() <= 4_096);
        }
    }
}

/// Lines, arcs, offsets, canned ends, and some that are wrong.
pub fn seeds() -> Vec<Vec<u8>> {
    [
        (
            0,
            "G21 G90\nG0 X10 Y5\nG1 X20 F600\nG2 X30 Y15 I10 J0\nM2\n",
        ),
        (
            1,
            "G20 G91 (inches)\nG1 X1 Z-.5 F10\nG3 X0 Y1 R1\nG4 P0.1\nM30",
        ),
        (
            0,
            "G54 G10 L2 P1 X1 Y1\nG28 ; home\nM3 S500\nG1X1Y1F100\nM5",
        ),
        (0, "G1 X1e9 F1\n"),
        (0, "G2 X1 I0 J0\n"),
        (1, "N10 G92 X0\n%\n(open comment\nG1 X"),
    ]
    .map(|(axes, text): (u8, &str)| [&[axes], text.as_bytes()].concat())
    .to_vec()
}
