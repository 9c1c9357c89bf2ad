//! Levels of pins and their times: high, low, setup, hold; and the steps that follow from them.

use super::{Judge, Step};
use crate::pins::{Pin, PinEvent};

impl Judge<'_> {
    /// Levels and their times.
    pub(super) fn read_pins(&mut self, edges: &[PinEvent]) {
        #[derive(Clone, Copy, Default)]
        struct Line {
            level: bool,
            positive: bool,
            rose_at: Option<u64>,
            fell_at: Option<u64>,
            turned_at: Option<u64>,
        }
        let mut lines = vec![Line::default(); self.axes.len()];
        for (line, inverted) in lines.iter_mut().zip(self.inverted) {
            line.positive = *inverted;
        }
        let mut before = 0;
        for event in edges {
            let at = event.at_ticks;
            let (Pin::Step(axis) | Pin::Direction(axis)) = event.pin else {
                continue;
            };
            if at < before {
                self.wrong(at, "the record is not in order of time".to_owned());
            }
            before = at;
            let Some(line) = lines.get_mut(axis.index()) else {
                self.wrong(at, format!("axis {} does not exist", axis.0));
                continue;
            };
            let since = |then: Option<u64>| then.map_or(u64::MAX, |then| at - then);
            let demand = |what: &str, ticks: u64, least: u64| {
                let message = || format!("{what} of {ticks} ticks, at least {least} are needed");
                (ticks < least).then(message)
            };
            let mut bad = [None, None];
            match event.pin {
                Pin::Step(_) if event.level == line.level => {
                    bad[0] = Some("the step pin had that level already".to_owned());
                }
                Pin::Step(_) if event.level => {
                    let limits = self.limits;
                    bad = [
                        demand("low time", since(line.fell_at), limits.low_ticks_min),
                        demand(
                            "direction setup",
                            since(line.turned_at),
                            limits.setup_ticks_min,
                        ),
                    ];
                    line.rose_at = Some(at);
                    let sign = if line.positive { 1 } else { -1 };
                    self.axes[axis.index()].steps.push(Step { at, sign });
                }
                Pin::Step(_) => {
                    let least = self.limits.high_ticks_min;
                    bad[0] = demand("high time", since(line.rose_at), least);
                    line.fell_at = Some(at);
                }
                _ => {
                    if line.level {
                        bad[0] = Some("it turns while a step is high".to_owned());
                    }
                    let least = self.limits.hold_ticks_min;
                    bad[1] = demand("direction hold", since(line.fell_at), least);
                    let inverted = self.inverted.get(axis.index()).copied().unwrap_or(false);
                    line.positive = event.level != inverted;
                    line.turned_at = Some(at);
                }
            }
            if matches!(event.pin, Pin::Step(_)) {
                line.level = event.level;
            }
            for message in bad.into_iter().flatten() {
                self.wrong(at, format!("axis {}: {message}", axis.0));
            }
        }
    }
}
