//! Pins as a value change dump, which GTKWave, PulseView and Surfer open.
//!
//! A tick of 62.5 ns is 625 units of 100 ps, so every edge is at its exact place. The file is
//! written as the node runs; what was written is readable at any moment.

use crate::pins::{Pin, PinEvent};
use keys::{AxisId, NodeId};
use std::io::{self, Write};

/// Units of the file in one tick of 16 MHz.
pub const UNITS_PER_TICK: u64 = 625;

/// Writes one node's pins.
#[derive(Debug)]
pub struct VcdWriter<W> {
    out: W,
    axis_count: usize,
    written_at_ticks: Option<u64>,
}

impl<W: Write> VcdWriter<W> {
    /// Writes the head: all pins are low at first.
    ///
    /// # Errors
    /// Those of `out`.
    pub fn new(mut out: W, node: &NodeId, axis_count: usize) -> io::Result<Self> {
        writeln!(
            out,
            "$comment pins of node {node}, 16 MHz ticks since its boot $end"
        )?;
        writeln!(out, "$timescale 100 ps $end")?;
        // Some viewers take a `-` in a name for an operator.
        writeln!(
            out,
            "$scope module {} $end",
            node.as_str().replace('-', "_")
        )?;
        for axis in 0..axis_count {
            let axis = AxisId(axis as u8);
            writeln!(
                out,
                "$var wire 1 {} step{} $end",
                code(Pin::Step(axis)),
                axis.0
            )?;
            writeln!(
                out,
                "$var wire 1 {} dir{} $end",
                code(Pin::Direction(axis)),
                axis.0
            )?;
        }
        writeln!(out, "$upscope $end\n$enddefinitions $end\n#0\n$dumpvars")?;
        for axis in 0..axis_count {
            let axis = AxisId(axis as u8);
            writeln!(
                out,
                "0{}\n0{}",
                code(Pin::Step(axis)),
                code(Pin::Direction(axis))
            )?;
        }
        writeln!(out, "$end")?;
        Ok(Self {
            out,
            axis_count,
            written_at_ticks: None,
        })
    }

    /// Writes one change. Changes come in the order of their times.
    ///
    /// # Errors
    /// Those of `out`; [`io::ErrorKind::InvalidInput`] for a time before the last one or an axis
    /// that the head does not name.
    pub fn write(&mut self, event: &PinEvent) -> io::Result<()> {
        let (Pin::Step(axis) | Pin::Direction(axis)) = event.pin;
        if axis.index() >= self.axis_count || self.written_at_ticks > Some(event.at_ticks) {
            return Err(io::ErrorKind::InvalidInput.into());
        }
        if self.written_at_ticks != Some(event.at_ticks) {
            self.written_at_ticks = Some(event.at_ticks);
            writeln!(self.out, "#{}", event.at_ticks * UNITS_PER_TICK)?;
        }
        writeln!(self.out, "{}{}", u8::from(event.level), code(event.pin))
    }

    /// Writes out what is buffered.
    ///
    /// # Errors
    /// Those of `out`.
    pub fn flush(&mut self) -> io::Result<()> {
        self.out.flush()
    }

    /// Writes the time at which the record ends.
    ///
    /// # Errors
    /// Those of `out`.
    pub fn finish(mut self, at_ticks: u64) -> io::Result<()> {
        if self.written_at_ticks < Some(at_ticks) {
            writeln!(self.out, "#{}", at_ticks * UNITS_PER_TICK)?;
        }
        self.out.flush()
    }
}

/// The identifier of a pin in the file: one printable character.
fn code(pin: Pin) -> char {
    let (axis, odd) = match pin {
        Pin::Step(axis) => (axis, 0),
        Pin::Direction(axis) => (axis, 1),
    };
    char::from(b'!' + (2 * axis.0 + odd) % 94)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_file_is_as_the_standard_says() {
        let mut file = Vec::new();
        let node = NodeId::new("cell-a").expect("legal");
        let mut vcd = VcdWriter::new(&mut file, &node, 2).expect("memory");
        for (at_ticks, pin, level) in [
            (16, Pin::Direction(AxisId(1)), true),
            (160, Pin::Step(AxisId(0)), true),
            (160, Pin::Step(AxisId(1)), true),
            (192, Pin::Step(AxisId(0)), false),
        ] {
            let event = PinEvent {
                at_ticks,
                pin,
                level,
            };
            vcd.write(&event).expect("memory");
        }
        let late = PinEvent {
            at_ticks: 191,
            pin: Pin::Step(AxisId(0)),
            level: true,
        };
        assert!(vcd.write(&late).is_err());
        let unknown = PinEvent {
            at_ticks: 200,
            pin: Pin::Step(AxisId(2)),
            level: true,
        };
        assert!(vcd.write(&unknown).is_err());
        vcd.finish(16_000).expect("memory");
        let expected = "\
$comment pins of node cell-a, 16 MHz ticks since its boot $end
$timescale 100 ps $end
$scope module cell_a $end
$var wire 1 ! step0 $end
$var wire 1 \" dir0 $end
$var wire 1 # step1 $end
$var wire 1 $ dir1 $end
$upscope $end
$enddefinitions $end
#0
$dumpvars
0!
0\"
0#
0$
$end
#10000
1$
#100000
1!
1#
#120000
0!
#10000000
";
        assert_eq!(String::from_utf8(file).expect("ASCII"), expected);
    }
}
