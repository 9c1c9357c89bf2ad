//! The words of G-code, a case for each.

/// What a word does in its program.
#[derive(Clone, Copy, Debug)]
pub(crate) enum Does {
    /// These commands; without the word it would be others, or an error.
    Gives(&'static [&'static str]),
    /// The same as without the word.
    Nothing,
    /// It is known and refused.
    Refused,
}
use Does::{Gives, Nothing, Refused};

/// A word, a program with it, what it does there; a program in which something about it is wrong, and
/// where and why.
pub(crate) type Case = (
    &'static str,
    &'static str,
    Does,
    (&'static str, usize, usize, &'static str),
);

/// What two of a kind in one line are told.
const KIND: &str = "same kind";

/// Codes with G.
pub(crate) const GENERAL: [Case; 30] = [
    (
        "G0",
        "G1 F600\nG91 G0 X1",
        Gives(&["line [80, 0, 0, 0] 8000"]),
        ("G0 G1 X1", 1, 4, KIND),
    ),
    (
        "G1",
        "G91 G1 X1 F600",
        Gives(&["line [80, 0, 0, 0] 800"]),
        ("G91\nG1 X1", 2, 1, "F is missing"),
    ),
    (
        // From 0 to 2 about 1, clockwise: over the top.
        "G2",
        "G91 G2 X2 Y0 I1 J0 F600",
        Gives(&["line [80, 80, 0, 0] 565", "line [80, -80, 0, 0] 565"]),
        ("G91\nG2 X2 Y0 F600", 2, 1, "needs I and J, or R"),
    ),
    (
        "G3",
        "G91 G3 X2 Y0 I1 J0 F600",
        Gives(&["line [80, -80, 0, 0] 565", "line [80, 80, 0, 0] 565"]),
        ("G91 F600\nG3 X2 I5", 2, 1, "does not lie on the arc"),
    ),
    (
        "G4",
        "G4 P1.5",
        Gives(&["pause 1500"]),
        ("G91 G0 X1\n  G4", 2, 3, "needs P"),
    ),
    (
        "G17",
        "G18\nG17 G91 G2 X2 Y0 I1 J0 F600",
        Gives(&["line [80, 80, 0, 0] 565", "line [80, -80, 0, 0] 565"]),
        ("G17 G18", 1, 5, KIND),
    ),
    (
        // Seen from +Y, with Z to the right and X up: clockwise from below is by way of -Z.
        "G18",
        "G91 G18 G2 X2 Z0 I1 K0 F600",
        Gives(&["line [80, 0, -400, 0] 2828", "line [80, 0, 400, 0] 2828"]),
        ("G91 G18 F600\nG2 X2 Z0", 2, 1, "needs K and I, or R"),
    ),
    (
        // Seen from +X, with Y to the right and Z up: by way of +Z.
        "G19",
        "G91 G19 G2 Y2 Z0 J1 K0 F600",
        Gives(&["line [0, 80, 400, 0] 2828", "line [0, 80, -400, 0] 2828"]),
        ("G19 F600 G91\nG2 Y2 I1", 2, 1, "needs J and K, or R"),
    ),
    (
        "G20",
        "G20 G91 G1 X1 F10",
        Gives(&["line [2032, 0, 0, 0] 338"]),
        ("G20 G21", 1, 5, KIND),
    ),
    (
        "G21",
        "G20\nG21 G91 G1 X1 F600",
        Gives(&["line [80, 0, 0, 0] 800"]),
        ("G21 G20", 1, 5, KIND),
    ),
    (
        "G28",
        "G28",
        Gives(&[
            "to 2:1600 4000",
            "to 0:560 8000",
            "to 1:240 8000",
            "to 3:50 600",
        ]),
        ("G92 X5\n G28 X0", 2, 2, "G92 named the place of X"),
    ),
    (
        "G28.1",
        "G0 X1 Y1 Z1 A1\nG28.1\nG0 X9\nG28 X9",
        Gives(&[
            "to 2:400 4000",
            "to 0:160 8000",
            "to 1:80 8000",
            "to 3:10 600",
            "line [640, 0, 0, 0] 8000",
            "line [-640, 0, 0, 0] 8000",
        ]),
        ("G0 X1\nG28.1", 2, 1, "nobody knows where Y is"),
    ),
    (
        "G40",
        "G40 G91 G0 X1",
        Nothing,
        ("G91 G0 X1\nG41", 2, 1, "G41 is not known"),
    ),
    (
        "G49",
        "G49 G91 G0 X1",
        Nothing,
        ("G91 G0 X1\nG43", 2, 1, "G43 is not known"),
    ),
    (
        "G53",
        "G53 G0 X0",
        Gives(&["to 0:0 8000"]),
        ("G0\nG53", 2, 1, "needs a place"),
    ),
    (
        "G54",
        "G55\nG54 G0 X0",
        Gives(&["to 0:80 8000"]),
        ("G54 G55 G0 X0", 1, 5, KIND),
    ),
    (
        "G55",
        "G55 G0 X0",
        Gives(&["to 0:160 8000"]),
        ("G54 G55 G0 X0", 1, 5, KIND),
    ),
    (
        "G56",
        "G56 G0 X0",
        Gives(&["to 0:240 8000"]),
        ("G54 G56 G0 X0", 1, 5, KIND),
    ),
    (
        "G57",
        "G57 G0 X0",
        Gives(&["to 0:320 8000"]),
        ("G54 G57 G0 X0", 1, 5, KIND),
    ),
    (
        "G58",
        "G58 G0 X0",
        Gives(&["to 0:400 8000"]),
        ("G54 G58 G0 X0", 1, 5, KIND),
    ),
    (
        "G59",
        "G59 G0 X0",
        Gives(&["to 0:480 8000"]),
        ("G54 G59.1 G0 X0", 1, 5, "G59.1 is not known"),
    ),
    (
        "G61",
        "G61 G91 G0 X1",
        Nothing,
        ("G91 G0 X1\nG64", 2, 1, "G64 is not known"),
    ),
    (
        // Nothing is in force behind it, until a word says what.
        "G80",
        "G91 G0 X1\nG80\nX1",
        Refused,
        ("G91 G0 X1\nG80\nX1", 3, 1, "after G80"),
    ),
    (
        "G90",
        "G91\nG90 G0 X0",
        Gives(&["to 0:80 8000"]),
        ("G90 G91", 1, 5, KIND),
    ),
    (
        "G91",
        "G91 G0 X1",
        Gives(&["line [80, 0, 0, 0] 8000"]),
        ("G91 G90", 1, 5, KIND),
    ),
    (
        "G91.1",
        "G91.1 G91 G2 X2 I1 F600",
        Nothing,
        ("G90.1", 1, 1, "G90.1 is not known"),
    ),
    (
        "G92",
        "G92 X5\nG0 X6",
        Gives(&["line [80, 0, 0, 0] 8000"]),
        ("G0 X1\nG92", 2, 1, "needs the name"),
    ),
    (
        "G92.1",
        "G92 X5\nG92.1\nG0 X0",
        Gives(&["to 0:80 8000"]),
        ("G92.1 X1", 1, 7, "nothing in this line uses X"),
    ),
    (
        "G93",
        "G93 G91 G1 X30 F2",
        Gives(&["line [2400, 0, 0, 0] 80"]),
        ("G91 F600\nG93\nG1 X1", 3, 1, "its own F"),
    ),
    (
        "G94",
        "G93\nG94 G91 G1 X2 F600",
        Gives(&["line [160, 0, 0, 0] 800"]),
        ("G93 G94", 1, 5, KIND),
    ),
];

/// Codes with M.
pub(crate) const OTHER: [Case; 11] = [
    (
        "M0",
        "G91 G0 X1\nM0\nX1",
        Gives(&[
            "line [80, 0, 0, 0] 8000",
            "wait_resume",
            "line [80, 0, 0, 0] 8000",
        ]),
        ("M0 M1", 1, 4, KIND),
    ),
    (
        "M1",
        "G91 G0 X1\nM1\nX1",
        Gives(&[
            "line [80, 0, 0, 0] 8000",
            "wait_resume",
            "line [80, 0, 0, 0] 8000",
        ]),
        ("M1.1", 1, 1, "M1.1 is not known"),
    ),
    (
        "M2",
        "G91 G0 X1\nM2\nX1",
        Gives(&["line [80, 0, 0, 0] 8000"]),
        ("M2 M30", 1, 4, KIND),
    ),
    (
        "M3",
        "G91 M3 S500 G1 X1 F600",
        Gives(&["laser 50", "line [80, 0, 0, 0] 800", "laser 0"]),
        ("M3 M5", 1, 4, KIND),
    ),
    (
        "M4",
        "G91 M4 S1000 G1 X1 F600",
        Gives(&["laser 100", "line [80, 0, 0, 0] 800", "laser 0"]),
        ("M4 S10\nG1 X1 F9", 2, 1, "nobody knows where X is"),
    ),
    (
        "M5",
        "G91 M3 S500 G1 X1 F600\nM5\nX1",
        Gives(&[
            "laser 50",
            "line [80, 0, 0, 0] 800",
            "laser 0",
            "line [80, 0, 0, 0] 800",
        ]),
        ("M5 M4", 1, 4, KIND),
    ),
    (
        "M6",
        "G91 G0 X1 M6",
        Refused,
        ("X1\nM6 T1", 2, 1, "no tool changer"),
    ),
    (
        "M7",
        "G91 G0 X1 M7",
        Refused,
        ("G91 X1\n M7", 2, 2, "no coolant"),
    ),
    (
        "M8",
        "G91 G0 X1 M8",
        Refused,
        ("G91 X1\nX1 M8", 2, 4, "no coolant"),
    ),
    ("M9", "G91 G0 X1 M9", Nothing, ("M9 M9", 1, 4, KIND)),
    (
        "M30",
        "G91 G0 X1\nM30\nX1",
        Gives(&["line [80, 0, 0, 0] 8000"]),
        ("G91 X1\nM30 M2", 2, 5, KIND),
    ),
];

/// Letters with a value of their own.
pub(crate) const VALUES: [Case; 14] = [
    (
        "X2",
        "G91 G0 X2",
        Gives(&["line [160, 0, 0, 0] 8000"]),
        ("G0 X1 X2", 1, 7, "twice"),
    ),
    (
        "Y2",
        "G91 G0 Y2",
        Gives(&["line [0, 160, 0, 0] 8000"]),
        ("G91 G0 Y", 1, 8, "a number is missing"),
    ),
    (
        "Z2",
        "G91 G0 Z2",
        Gives(&["line [0, 0, 800, 0] 4000"]),
        ("G0 Z1.2.3", 1, 8, "not understood"),
    ),
    (
        "A2",
        "G20 G91 G0 A2",
        Gives(&["line [0, 0, 0, 20] 600"]),
        ("G0 A--1", 1, 4, "a number is missing"),
    ),
    (
        // A quarter about (1, 0), where the tool is at 9 o'clock.
        "I1",
        "G91 G2 X1 Y1 I1 F600",
        Gives(&["line [80, 80, 0, 0] 565"]),
        ("G91 G0 X1 I1", 1, 11, "nothing in this line uses I"),
    ),
    (
        "J1",
        "G91 G3 X1 Y1 J1 F600",
        Gives(&["line [80, 80, 0, 0] 565"]),
        (
            "G18 G91 F600\nG2 X2 I1 J1",
            2,
            10,
            "nothing in this line uses J",
        ),
    ),
    (
        "K1",
        "G91 G19 G3 Y1 Z1 K1 F600",
        Gives(&["line [0, 80, 400, 0] 2828"]),
        ("G91 F600 G2 X2 I1 K1", 1, 19, "nothing in this line uses K"),
    ),
    (
        "R1",
        "G91 G2 X2 R1 F600",
        Gives(&["line [80, 80, 0, 0] 565", "line [80, -80, 0, 0] 565"]),
        ("G91 F600\nG2 X2 I1 R1", 2, 10, "either R or its centre"),
    ),
    (
        "P0.25",
        "G4 P0.25",
        Gives(&["pause 250"]),
        ("G4 P-1", 1, 4, "0 to 86400 seconds"),
    ),
    (
        "F600",
        "G91 G1 X1 F600",
        Gives(&["line [80, 0, 0, 0] 800"]),
        ("G91 X1\nG1 X1 F0", 2, 7, "more than 0"),
    ),
    (
        "S250",
        "G91 M3 S250 G1 X1 F600",
        Gives(&["laser 25", "line [80, 0, 0, 0] 800", "laser 0"]),
        ("G91 G0 X1\nM3 S2000", 2, 4, "not within 0 to 1000"),
    ),
    (
        "T2",
        "G91 T2 G0 X1",
        Nothing,
        ("T2 Q1", 1, 4, "`Q` means nothing"),
    ),
    (
        "N10",
        "N10 G91 G0 X1",
        Nothing,
        ("N1 G91 G5", 1, 8, "G5 is not known"),
    ),
    (
        "O100",
        "O100\nG91 G0 X1",
        Nothing,
        ("O1\nW2", 2, 1, "`W` means nothing"),
    ),
];
