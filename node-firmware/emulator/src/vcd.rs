//! Pins as a value change dump, which GTKWave, PulseView and Surfer open.
//!
//! A tick of 62.5 ns is 625 units of 100 ps, so every edge is at its exact place. The file is
//! written as the node runs; what was written is readable at any moment.

use crate::pins::{Pin, PinEvent};
use keys::NodeId;
use std::io::{self, Write};

/// Units of the file in one tick of 16 MHz.
pub const UNITS_PER_TICK: u64 = 625;

/// Writes one node's pins.
#[derive(Debug)]
pub struct VcdWriter<W> {
    out: W,
    pins: Vec<Pin>,
    written_at_ticks: Option<u64>,
}

impl<W: Write> VcdWriter<W> {
    /// Writes the head: all pins are low at first.
    ///
    /// # Errors
    /// Those of `out`.
    pub fn new(mut out: W, node: &NodeId, pins: Vec<Pin>) -> io::Result<Self> {
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
        for (index, pin) in pins.iter().enumerate() {
            writeln!(out, "$var wire 1 {} {} $end", code(index), name(*pin))?;
        }
        writeln!(out, "$upscope $end\n$enddefinitions $end\n#0\n$dumpvars")?;
        for index in 0..pins.len() {
            writeln!(out, "0{}", code(index))?;
        }
        writeln!(out, "$end")?;
        Ok(Self {
            out,
            pins,
            written_at_ticks: None,
        })
    }

    /// Writes one change. Changes come in the order of their times.
    ///
    /// # Errors
    /// Those of `out`; [`io::ErrorKind::InvalidInput`] for a time before the last one or a pin
    /// that the head does not name.
    pub fn write(&mut self, event: &PinEvent) -> io::Result<()> {
        let index = self.pins.iter().position(|pin| *pin == event.pin);
        let in_order = self.written_at_ticks <= Some(event.at_ticks);
        let index = index.filter(|_| in_order);
        let index = index.ok_or(io::ErrorKind::InvalidInput)?;
        if self.written_at_ticks != Some(event.at_ticks) {
            self.written_at_ticks = Some(event.at_ticks);
            writeln!(self.out, "#{}", event.at_ticks * UNITS_PER_TICK)?;
        }
        writeln!(self.out, "{}{}", u8::from(event.level), code(index))
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
fn code(index: usize) -> char {
    char::from(b'!' + (index % 94) as u8)
}

fn name(pin: Pin) -> String {
    match pin {
        Pin::Step(axis) => format!("step{}", axis.0),
        Pin::Direction(axis) => format!("dir{}", axis.0),
        Pin::Enable(output) => format!("enable{output}"),
        Pin::StepC => "stepC".to_owned(),
        Pin::DirectionC => "dirC".to_owned(),
        Pin::StepD => "stepD".to_owned(),
        Pin::DirectionD => "dirD".to_owned(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use keys::AxisId;

    #[test]
    fn the_file_is_as_the_standard_says() {
        let mut file = Vec::new();
        let node = NodeId::new("cell-a").expect("legal");
        let pins = [0, 1].map(|axis| [Pin::Step(AxisId(axis)), Pin::Direction(AxisId(axis))]);
        let mut vcd = VcdWriter::new(&mut file, &node, pins.concat()).expect("memory");
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
