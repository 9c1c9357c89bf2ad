//! The look-ahead beside a plain one, which goes back from the last line for each line anew.

extern crate std;
use super::*;
use crate::AxisProfile;
use std::vec::Vec;

#[derive(Clone)]
struct Ahead<'c> {
    commands: &'c [Command],
    next: usize,
}

impl Iterator for Ahead<'_> {
    type Item = Command;

    fn next(&mut self) -> Option<Command> {
        let command = self.commands.get(self.next).copied();
        self.next += usize::from(command.is_some());
        command
    }
}

impl Lines for Ahead<'_> {
    fn leave_out(&mut self, places: usize) {
        self.next = places;
    }

    fn places(&self) -> usize {
        self.next
    }
}

/// Returns the exit speed of the first of these lines, given the others.
fn plain_exit_speed(commands: &[Command], timing: &[Timing]) -> Real {
    let lines: Vec<_> = commands.iter().filter_map(Line::of).collect();
    let mut corners = Vec::new();
    for pair in lines.windows(2).take(LINES_MAX) {
        let corner = corner_speed(&Edge::of(&pair[0]), &Edge::of(&pair[1]), timing);
        if corner.is_none() {
            break;
        }
        corners.push(corner);
    }
    let mut speed = Real::ZERO;
    for (line, corner) in lines[1..].iter().zip(&corners).rev() {
        let law = line.law.scaled(line.stretch);
        let before = law.speed_before(line.tool_way(), speed, line.tool_speed_max());
        speed = before.min(*corner);
    }
    speed / lines[0].stretch
}

#[test]
fn every_exit_speed_is_that_of_a_whole_pass_and_never_above_it() {
    let profile = AxisProfile {
        junction_hz: 2_000,
        ..AxisProfile::default()
    };
    let timing = [Timing::from(profile); LINE_AXES];
    let mut state = 11_u64;
    let mut next = |most: u64| {
        state = state
            .wrapping_mul(6_364_136_223_846_793_005)
            .wrapping_add(1_442_695_040_888_963_407);
        (state >> 33) % most
    };
    for case in 0..60 {
        let length = [3, 30, 300, 3_000][next(4) as usize];
        let accel = [20_000, 400_000, 3_000_000][next(3) as usize];
        let jerk = [0, 0, 2_000_000, 90_000_000][next(4) as usize];
        let mut steps = [0; LINE_AXES];
        let commands: Vec<_> = (0..150)
            .map(|_| {
                if next(6) == 0 {
                    // A corner, sharp or not.
                    steps = core::array::from_fn(|_| next(2 * length) as i32 - length as i32 / 2);
                }
                steps[0] = steps[0].max(1);
                Command::Line {
                    steps,
                    speed_hz: 5_000 + next(60_000) as u32,
                    accel_hz_per_s: accel,
                    jerk_hz_per_s2: if jerk != 0 && next(9) == 0 {
                        5_000_000
                    } else {
                        jerk
                    },
                }
            })
            .collect();
        let mut ahead = LookAhead::new();
        let mut known = 1;
        let mut begun = Real::ZERO;
        for present in 0..commands.len() {
            // They arrive while the tool moves.
            known = (known + next(4) as usize).clamp(present + 1, commands.len());
            let line = Line::of(&commands[present]).expect("a line");
            let behind = Ahead {
                commands: &commands[present + 1..known],
                next: 0,
            };
            let found = ahead.exit_speed(&line, behind, |line| line, &timing);
            let plain = plain_exit_speed(&commands[present..known], &timing);
            let slack = plain.shifted(-20);
            assert!(found <= plain + slack, "{case}, {present}: above");
            // An S-curve's speed must still be good when more becomes known.
            let off = plain - found;
            let most = plain.shifted(if jerk == 0 { -14 } else { -3 });
            assert!(off <= most, "{case}, {present}: below");
            // The line can be left like this, as it was begun.
            let (law, way) = (line.law.scaled(line.stretch), line.tool_way());
            let exit = found * line.stretch;
            if exit < begun {
                let needed = law.way(exit, begun);
                assert!(
                    needed <= way + way.shifted(-18),
                    "{case}, {present}: too fast"
                );
                begun = exit;
            } else {
                begun = exit.min(law.speed_before(way, begun, line.tool_speed_max()));
            }
            if found.is_none() {
                ahead.clear();
            } else {
                ahead.advance();
            }
        }
    }
}
