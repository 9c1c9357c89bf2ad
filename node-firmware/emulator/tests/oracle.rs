//! The judge is judged: a good record passes, and every single thing that is changed in it is found.

use emulator::{
    EmulatedNode, EmulatorConfig, Recording, oracle,
    pins::{Pin, PinEvent},
    record::Life,
};
use keys::{
    AxisId, BatchHeader, Command, JobId, LocalMicros, NodeId, NodeTopic,
    batch::{BatchWriter, ORDER_BYTES_MAX},
};

const X: AxisId = AxisId(0);

/// The record of a job of moves both ways on both axes.
fn good_life() -> Life {
    let mut config = EmulatorConfig::new(NodeId::new("bench").expect("legal"));
    config.record = Recording::Edges { max: 100_000 };
    let mut node = EmulatedNode::new(config, 7);
    let mut writer = BatchWriter::new();
    for index in 0..20 {
        let steps = if index % 2 == 0 { 50 } else { -20 };
        assert!(writer.push(&Command::Move {
            axis: AxisId(index % 2),
            delay_us: 100,
            steps,
        }));
        assert!(writer.push(&Command::SyncMove {
            delay_us: [100, 50],
            steps: [steps, 2 * steps],
        }));
    }
    let header = BatchHeader {
        queue: node.status().queue,
        first_command: 0,
        command_count: 0,
        job: JobId::new("j").expect("legal"),
        job_end: 40,
    };
    let mut buffer = [0; ORDER_BYTES_MAX];
    let bytes = writer.finish(header, &mut buffer).expect("room");
    node.handle(NodeTopic::Batch, bytes, LocalMicros(1_000));
    node.poll(LocalMicros(2_000_000));
    node.life()
}

fn found(change: impl FnOnce(&mut Life)) -> String {
    let mut life = good_life();
    change(&mut life);
    let violations = oracle::check_life(&life).expect_err("the change must be found");
    let lines: Vec<_> = violations.iter().map(ToString::to_string).collect();
    lines.join("\n")
}

/// Index of a rising edge in the middle of the first move.
fn rise(life: &Life) -> usize {
    nth_rise(life, 30)
}

fn nth_rise(life: &Life, count: usize) -> usize {
    let edge = |event: &PinEvent| event.pin == Pin::Step(X) && event.level;
    let rises = life
        .edges
        .iter()
        .enumerate()
        .filter(|(_, event)| edge(event));
    rises
        .map(|(index, _)| index)
        .nth(count)
        .expect("there are more")
}

#[test]
fn a_good_record_passes() {
    let summary = oracle::check_life(&good_life()).expect("good");
    assert_eq!(summary.commands, 40);
    assert_eq!(summary.steps, [1_200, 1_600]);
    assert!(summary.skew_ticks_max <= 3);
}

#[test]
fn an_edge_that_is_one_tick_late_is_found() {
    assert!(
        found(|life| {
            let index = rise(life);
            life.edges[index].at_ticks += 1;
        })
        .contains("of its 50 steps")
    );
}

#[test]
fn a_lost_pulse_is_found() {
    found(|life| {
        let index = rise(life);
        life.edges.drain(index..index + 2);
    });
}

#[test]
fn a_pulse_too_many_at_the_end_is_found() {
    assert!(
        found(|life| {
            let at_ticks = life.edges.last().expect("edges").at_ticks + 10_000;
            for (level, at_ticks) in [(true, at_ticks), (false, at_ticks + 40)] {
                life.edges.push(PinEvent {
                    at_ticks,
                    pin: Pin::Step(X),
                    level,
                });
            }
        })
        .contains("nobody ordered")
    );
}

#[test]
fn a_pulse_that_is_too_short_is_found() {
    assert!(
        found(|life| {
            let index = rise(life);
            let at_ticks = life.edges[index].at_ticks;
            let fall = life.edges[index..]
                .iter_mut()
                .find(|event| event.pin == Pin::Step(X) && !event.level);
            fall.expect("it falls").at_ticks = at_ticks + 7;
            life.edges.sort_by_key(|event| event.at_ticks);
        })
        .contains("high time of 7 ticks")
    );
}

#[test]
fn a_direction_that_changes_too_late_is_found() {
    assert!(
        found(|life| {
            let turns = |event: &&mut PinEvent| matches!(event.pin, Pin::Direction(_));
            let next = life.edges.clone();
            let turn = life
                .edges
                .iter_mut()
                .filter(turns)
                .nth(4)
                .expect("it turns");
            let Pin::Direction(axis) = turn.pin else {
                unreachable!()
            };
            let step = next
                .iter()
                .find(|event| event.pin == Pin::Step(axis) && event.at_ticks > turn.at_ticks);
            turn.at_ticks = step.expect("it steps").at_ticks - 100;
            life.edges.sort_by_key(|event| event.at_ticks);
        })
        .contains("direction setup of 100 ticks")
    );
}

#[test]
fn a_wrong_direction_is_found() {
    found(|life| {
        for event in &mut life.edges {
            if event.pin == Pin::Direction(X) {
                event.level = !event.level;
            }
        }
    });
}

#[test]
fn a_position_that_is_off_by_one_is_found() {
    assert!(found(|life| life.status.axes[0].position_steps += 1).contains("the status says"));
    assert!(found(|life| life.counted_steps[1] -= 1).contains("pulse counter"));
}

#[test]
fn a_gap_between_commands_is_found() {
    assert!(
        found(|life| {
            // Behind the last pulse of the first command.
            let at = life.edges[nth_rise(life, 49)].at_ticks + 40;
            for event in &mut life.edges {
                if event.at_ticks > at {
                    event.at_ticks += 400_000;
                }
            }
            // As if the commands had been there for long.
            for event in &mut life.edges {
                event.at_ticks += 16_000_000;
            }
        })
        .contains("a gap of")
    );
}

#[test]
fn a_turn_that_has_had_its_rest_before_is_no_reason_for_a_gap() {
    assert!(
        found(|life| {
            // X turns there, and has rested for 2 ms while Y has moved: 60 µs more are a gap.
            let at = life.edges[nth_rise(life, 100)].at_ticks - 10;
            for event in &mut life.edges {
                if event.at_ticks > at {
                    event.at_ticks += 960;
                }
                event.at_ticks += 16_000_000;
            }
        })
        .contains("a gap of")
    );
}

#[test]
fn a_command_that_was_taken_and_not_played_is_found() {
    found(|life| {
        let mut more = life.commands[0];
        more.number = 40;
        life.commands.push(more);
        life.status.accepted_commands = 41;
        life.status.executed_commands = 41;
    });
}

#[test]
fn positions_follow_from_commands_by_addition() {
    let commands: Vec<_> = good_life()
        .commands
        .iter()
        .map(|taken| taken.command)
        .collect();
    let life = good_life();
    let expected: Vec<_> = life
        .status
        .axes
        .iter()
        .map(|axis| axis.position_steps)
        .collect();
    assert_eq!(oracle::positions_after(&commands, 2), expected);
}
