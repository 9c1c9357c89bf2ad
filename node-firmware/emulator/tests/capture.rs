//! Captures of a logic analyser: read, judged, and every fault told with its line.

use emulator::{
    EmulatedNode, EmulatorConfig, Recording,
    capture::Capture,
    pins::{Pin, PinEvent},
    vcd::VcdWriter,
};
use keys::{
    AxisId, BatchHeader, Command, JobId, LocalMicros, NodeId, NodeTopic,
    batch::{BatchWriter, ORDER_BYTES_MAX},
};

fn name() -> NodeId {
    NodeId::new("bench").expect("legal")
}

fn commands() -> Vec<Command> {
    let mut commands = Vec::new();
    for steps in [50, -20, 7] {
        commands.push(Command::SyncMove {
            delay_us: [100, 50],
            steps: [steps, 2 * steps],
        });
        commands.push(Command::Move {
            axis: AxisId(1),
            delay_us: 200,
            steps,
        });
    }
    commands
}

fn edges() -> Vec<PinEvent> {
    let mut config = EmulatorConfig::new(name());
    config.record = Recording::Edges { max: 100_000 };
    let mut node = EmulatedNode::new(config, 7);
    let mut writer = BatchWriter::new();
    for command in &commands() {
        assert!(writer.push(command));
    }
    let header = BatchHeader {
        queue: node.status().queue,
        first_command: 0,
        command_count: 0,
        job: JobId::new("j").expect("legal"),
        job_end: 6,
    };
    let mut buffer = [0; ORDER_BYTES_MAX];
    let bytes = writer.finish(header, &mut buffer).expect("room");
    node.handle(NodeTopic::Batch, bytes, LocalMicros(1_000));
    node.poll(LocalMicros(2_000_000));
    node.edges().to_vec()
}

/// A table as an analyser exports it: one line for each change, sampled at `sample_hz`.
fn csv(edges: &[PinEvent], sample_hz: u64) -> String {
    let pins = [0, 1].map(|axis| [Pin::Step(AxisId(axis)), Pin::Direction(AxisId(axis))]);
    let pins = pins.concat();
    let mut levels = [false; 4];
    let mut text = "Time [s],step0,dir0,step1,dir1,laser\n-0.001,0,0,0,0,1\n".to_owned();
    for edge in edges {
        let index = pins.iter().position(|pin| *pin == edge.pin);
        levels[index.expect("an axis' pin")] = edge.level;
        // The sample behind the edge.
        let sample = (edge.at_ticks * sample_hz).div_ceil(16_000_000);
        let ps = u128::from(sample) * 1_000_000_000_000 / u128::from(sample_hz);
        let [a, b, c, d] = levels.map(u8::from);
        let (s, rest) = (ps / 1_000_000_000_000, ps % 1_000_000_000_000);
        text += &format!("{s}.{rest:012},{a},{b},{c},{d},1\n");
    }
    text
}

fn verdict(text: &str) -> Result<String, String> {
    let capture = Capture::read(text).map_err(|error| error.to_string())?;
    let summary = capture.check(&commands());
    summary
        .map(|summary| summary.to_string())
        .map_err(|violations| violations.join("\n"))
}

#[test]
fn a_good_capture_passes_at_any_rate_from_16_mhz_on() {
    let edges = edges();
    for sample_hz in [16_000_000, 24_000_000, 50_000_000, 100_000_000] {
        let said = verdict(&csv(&edges, sample_hz)).expect("good");
        assert!(said.starts_with("6 commands, steps [77, 231]"), "{said}");
    }
}

#[test]
fn the_emulators_own_dump_passes() {
    let mut file = Vec::new();
    let pins = [0, 1].map(|axis| [Pin::Step(AxisId(axis)), Pin::Direction(AxisId(axis))]);
    let mut vcd = VcdWriter::new(&mut file, &name(), pins.concat()).expect("memory");
    for edge in edges() {
        vcd.write(&edge).expect("memory");
    }
    vcd.finish(40_000_000).expect("memory");
    let said = verdict(&String::from_utf8(file).expect("ASCII")).expect("good");
    assert!(said.starts_with("6 commands, steps [77, 231]"), "{said}");
}

#[test]
fn a_missing_pulse_and_a_late_one_are_told_with_their_lines() {
    let edges = edges();
    let rises = |edge: &&PinEvent| edge.pin == Pin::Step(AxisId(0)) && edge.level;
    let tenth = edges
        .iter()
        .filter(rises)
        .nth(10)
        .copied()
        .expect("it moves");
    let without: Vec<_> = {
        let is_tenth = |edge: &PinEvent| {
            edge.pin == tenth.pin && (tenth.at_ticks..tenth.at_ticks + 100).contains(&edge.at_ticks)
        };
        edges
            .iter()
            .copied()
            .filter(|edge| !is_tenth(edge))
            .collect()
    };
    let said = verdict(&csv(&without, 16_000_000)).expect_err("a pulse is missing");
    assert!(said.contains("line "), "{said}");
    let mut late = edges.clone();
    let place = late
        .iter()
        .position(|edge| *edge == tenth)
        .expect("it is there");
    late[place].at_ticks += 4;
    let text = csv(&late, 16_000_000);
    let said = verdict(&text).expect_err("a pulse is late");
    assert!(said.contains("line "), "{said}");
}

#[test]
fn what_cannot_be_read_is_told_with_its_line() {
    let head = "Time [s],step0,dir0\n";
    for (text, line, what) in [
        (String::new(), 1, "empty"),
        (
            "step0,dir0\n0,0\n".into(),
            1,
            "first column must be the time",
        ),
        ("Time [s],a,b\n".into(), 1, "no signal is called step0"),
        (format!("{head}0.0,0,0\nx,0,0\n"), 3, "no time in seconds"),
        (
            format!("{head}0.0,0,0\n0.1,2,0\n"),
            3,
            "step0: Some(\"2\") is no level",
        ),
        (format!("{head}0.0,0\n"), 2, "dir0: None is no level"),
        (format!("{head}0.0,1,0\n"), 2, "in the middle of a step"),
        (
            format!("{head}0.2,0,0\n0.3,1,0\n0.25,0,0\n"),
            4,
            "runs backwards",
        ),
        ("$timescale 1 parsec $end".into(), 1, "no time scale"),
        ("$timescale 1 ns $end\n".into(), 1, "no $enddefinitions"),
    ] {
        let error = Capture::read(&text).expect_err("must be refused");
        assert_eq!(error.line, line, "{error}");
        assert!(error.message.contains(what), "{error}");
    }
}
