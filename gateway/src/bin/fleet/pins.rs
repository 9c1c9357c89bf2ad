//! Axes and pins of a node, as options of `fleet provision` and in words.

use clap::Args;
use provision::{
    Machine, PinUse, Setting, Wiring,
    wiring::{PinSetting, kit_pin},
};

/// Longest list of pins in a line.
const LINE_CHARS: usize = 66;

#[derive(Debug, Args)]
pub(crate) struct PinArgs {
    /// How many axes the node has, 1 to 4; 0: as its kit has them.
    #[arg(long, value_name = "COUNT", value_parser = clap::value_parser!(u8).range(0..=4))]
    axes: Option<u8>,

    /// Another pin than the kit's: USE=GPIO,… as in `2:step=9,2:dir=12`. USE is, of an axis, 0:step, 0:dir,
    /// 0:enable, 0:min, 0:max or 0:home; else enable, laser, stop, lamp, probe, lidar, c:step, c:min, c:max,
    /// d:step, d:min, d:max, shift:data, shift:clock, shift:latch or shift:back. GPIO is a number, or none
    /// for enable, laser and lamp that are not there. The kit's are in node-firmware/README.md. May be
    /// repeated.
    #[arg(long, value_name = "USE=GPIO,…", value_parser = read, value_delimiter = ',')]
    pin: Vec<PinSetting>,

    /// Forget all pins: the kit's.
    #[arg(long)]
    no_pins: bool,
}

impl PinArgs {
    /// Returns the settings, in the order in which they count.
    pub(crate) fn settings(&self) -> Vec<Setting> {
        let mut settings = Vec::new();
        if self.no_pins {
            settings.push(Setting::NoPins);
        }
        settings.extend(self.axes.map(Setting::Axes));
        settings.extend(self.pin.iter().copied().map(Setting::Pin));
        settings
    }
}

fn read(text: &str) -> Result<PinSetting, String> {
    let parse = || {
        let (of, gpio) = text.split_once('=')?;
        let of: PinUse = of.parse().ok()?;
        let gpio = match gpio {
            "none" => None,
            number => Some(number.parse().ok()?),
        };
        Some(PinSetting { of, gpio })
    };
    parse().ok_or_else(|| "no USE=GPIO like 2:step=9 or laser=none".to_owned())
}

/// Returns how many axes there are, and all pins of a board with this machine.
pub(crate) fn lines(wiring: &Wiring, machine: &Machine) -> Vec<(&'static str, String)> {
    let mut lines = vec![("axes", wiring.axes().to_string())];
    let mut line = String::new();
    for of in wiring.uses(machine) {
        let word = match wiring.pin(of) {
            Some(gpio) => format!("{of}={gpio}"),
            // What the kit has and this board has not.
            None if kit_pin(of).is_some() => format!("{of}=none"),
            None => continue,
        };
        if line.len() + 1 + word.len() > LINE_CHARS {
            lines.push(("pins", std::mem::take(&mut line)));
        }
        if !line.is_empty() {
            line.push(' ');
        }
        line.push_str(&word);
    }
    lines.push(("pins", line));
    lines
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_given_is_what_is_shown() {
        let mut wiring = Wiring::default();
        for text in ["0:step=9", "lamp=none", "1:enable=12"] {
            assert!(wiring.set(read(text).expect("legal")), "{text}");
        }
        let machine = Machine {
            has_lidar: true,
            ..Machine::default()
        };
        assert_eq!(
            lines(&wiring, &machine),
            [
                ("axes", "2".to_owned()),
                (
                    "pins",
                    "0:step=9 0:dir=5 1:step=6 1:dir=7 1:enable=12 enable=15 laser=11".to_owned()
                ),
                ("pins", "stop=10 lamp=none lidar=3".to_owned()),
            ]
        );
    }

    #[test]
    fn what_is_none_is_refused() {
        for wrong in [
            "",
            "0:step",
            "0:step=x",
            "0:step=256",
            "4:step=1",
            "C=1",
            "=1",
        ] {
            assert!(read(wrong).is_err(), "{wrong}");
        }
    }
}
