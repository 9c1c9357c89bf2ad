//! The exact bytes of every message of version 1.
//!
//! If a test here fails, do not change the test: nodes in the field speak these bytes. Make a new
//! version by the rule in `keys::version` and keep reading this one.

use keys::{
    AxisId, AxisStatus, BatchAck, BatchHeader, BatchReader, Command, Fault, Features, FleetMicros,
    JobId, LocalMicros, NodeState, Order, QueueId, Refusal, Status, StopMode, StopReason,
    StopReport, Verdict,
    batch::BatchWriter,
    clock::{ClockMessage, ClockProbe, ClockReply},
    command::{Ramp, RampShape},
    pace::PaceMessage,
    start::{BarrierName, StartMessage},
    status::{DecodeError, FaultCode},
    trace::{TraceEvent, TraceWord},
    version,
    vitals::{VITALS_BYTES_MAX, Vitals},
};
use serde::{Serialize, de::DeserializeOwned};
use std::fmt::Debug;

fn hex(bytes: &[u8]) -> String {
    bytes
        .iter()
        .map(|byte| format!("{byte:02x}"))
        .collect::<Vec<_>>()
        .join(" ")
}

fn check<M: Serialize + DeserializeOwned + PartialEq + Debug>(message: M, expected: &str) {
    let mut buffer = [0; 1024];
    let bytes = version::encode(&message, &mut buffer).expect("the buffer is large");
    assert_eq!(hex(bytes), expected, "{message:?}");
    assert_eq!(version::decode::<M>(bytes).as_ref(), Ok(&message));
    for end in 0..bytes.len() {
        assert!(
            version::decode::<M>(&bytes[..end]).is_err(),
            "cut at {end}: {message:?}"
        );
    }
    let mut longer = bytes.to_vec();
    longer.push(0);
    assert_eq!(version::decode::<M>(&longer), Err(DecodeError::Trailing));
    longer[0] = version::CURRENT + 1;
    assert_eq!(
        version::decode::<M>(&longer),
        Err(DecodeError::Version(version::CURRENT + 1))
    );
}

const QUEUE: QueueId = QueueId {
    boot: 0x1234_5678,
    flush: 3,
};

fn job() -> JobId {
    JobId::new("part-0815").expect("legal")
}

#[test]
fn every_command_has_its_bytes_and_survives_its_words() {
    let trapezoid = Ramp {
        speed_hz: 500,
        accel_hz_per_s: 100,
        shape: RampShape::Trapezoid {
            linear_steps: 50,
            jump_steps: 7,
        },
    };
    let jerk = Ramp {
        shape: RampShape::Jerk {
            jerk_hz_per_s2: 100_000,
        },
        ..trapezoid
    };
    let cases = [
        (
            Command::Move {
                axis: AxisId(1),
                delay_us: 500,
                steps: -2000,
            },
            "01 00 01 f4 03 9f 1f",
        ),
        (
            Command::Move {
                axis: AxisId(0),
                delay_us: u32::MAX,
                steps: i32::MAX,
            },
            "01 00 00 ff ff ff ff 0f fe ff ff ff 0f",
        ),
        (
            Command::SyncMove {
                delay_us: [500, 1000],
                steps: [2000, -1000],
            },
            "01 01 f4 03 e8 07 a0 1f cf 0f",
        ),
        (Command::Pause { pause_ms: 100 }, "01 02 64"),
        (Command::Laser { power_percent: 50 }, "01 03 32"),
        (Command::LidarRead, "01 04"),
        (
            Command::SetPosition {
                axis: AxisId(0),
                position_steps: -1 << 40,
            },
            "01 05 00 ff ff ff ff ff 3f",
        ),
        (
            Command::Ramp {
                axis: AxisId(2),
                steps: 1000,
                ramp: trapezoid,
            },
            "01 06 02 d0 0f f4 03 64 00 32 07",
        ),
        (
            Command::RampTo {
                axis: AxisId(2),
                position_steps: 1 << 33,
                ramp: jerk,
            },
            "01 07 02 80 80 80 80 40 f4 03 64 01 a0 8d 06",
        ),
        (
            Command::Line {
                steps: [10_000, -4_000, 0, 1],
                speed_hz: 5_000,
                accel_hz_per_s: 10_000,
                jerk_hz_per_s2: 100_000,
            },
            "01 08 a0 9c 01 bf 3e 00 02 88 27 90 4e a0 8d 06",
        ),
        (Command::Home { axis: AxisId(2) }, "01 09 02"),
        (Command::Barrier { barrier: 300 }, "01 0a ac 02"),
    ];
    for (command, expected) in cases {
        check(command, expected);
        assert_eq!(Command::from_words(&command.to_words()), Ok(command));
    }
}

#[test]
fn orders_have_their_bytes() {
    check(
        Order::Cancel {
            queue: QUEUE,
            mode: StopMode::Decelerate,
        },
        "01 01 f8 ac d1 91 01 03 01",
    );
    check(Order::Release { queue: QUEUE }, "01 02 f8 ac d1 91 01 03");
    let header = BatchHeader {
        queue: QUEUE,
        first_command: 1_000,
        command_count: 2,
        job: job(),
        job_end: 4_000,
    };
    check(
        Order::Batch(header),
        "01 00 f8 ac d1 91 01 03 e8 07 02 09 70 61 72 74 2d 30 38 31 35 a0 1f",
    );

    let commands = [
        Command::Move {
            axis: AxisId(0),
            delay_us: 500,
            steps: -2000,
        },
        Command::Laser { power_percent: 9 },
    ];
    let mut writer = BatchWriter::new();
    for command in &commands {
        assert!(writer.push(command));
    }
    let mut buffer = [0; keys::batch::ORDER_BYTES_MAX];
    let bytes = writer.finish(header, &mut buffer).expect("fits");
    assert_eq!(
        hex(bytes),
        "01 00 f8 ac d1 91 01 03 e8 07 02 09 70 61 72 74 2d 30 38 31 35 a0 1f 00 00 f4 03 9f 1f 03 09"
    );

    let mut reader = BatchReader::new(bytes).expect("legal");
    assert_eq!(*reader.order(), Order::Batch(header));
    for command in commands {
        assert_eq!(reader.next_command(), Ok(Some(command)));
    }
    assert_eq!(reader.next_command(), Ok(None));
    for end in 0..bytes.len() {
        let whole = BatchReader::new(&bytes[..end]).and_then(|mut reader| {
            while reader.next_command()?.is_some() {}
            Ok(())
        });
        assert!(whole.is_err(), "cut at {end}");
    }
}

#[test]
fn acks_have_their_bytes() {
    let ack = |verdict| BatchAck {
        queue: QUEUE,
        verdict,
        accepted_commands: 300,
        executed_commands: 128,
        credit_commands: 4_096,
    };
    check(
        ack(Verdict::Accepted),
        "01 f8 ac d1 91 01 03 00 ac 02 80 01 80 20",
    );
    check(
        ack(Verdict::Duplicate),
        "01 f8 ac d1 91 01 03 01 ac 02 80 01 80 20",
    );
    check(
        ack(Verdict::Credit),
        "01 f8 ac d1 91 01 03 03 ac 02 80 01 80 20",
    );
    let refusals = [
        (
            Refusal::Malformed,
            "01 f8 ac d1 91 01 03 02 00 ac 02 80 01 80 20",
        ),
        (
            Refusal::Stale,
            "01 f8 ac d1 91 01 03 02 01 ac 02 80 01 80 20",
        ),
        (Refusal::Gap, "01 f8 ac d1 91 01 03 02 02 ac 02 80 01 80 20"),
        (
            Refusal::Overlap,
            "01 f8 ac d1 91 01 03 02 03 ac 02 80 01 80 20",
        ),
        (
            Refusal::QueueShort,
            "01 f8 ac d1 91 01 03 02 04 ac 02 80 01 80 20",
        ),
        (
            Refusal::Stopped,
            "01 f8 ac d1 91 01 03 02 05 ac 02 80 01 80 20",
        ),
        (
            Refusal::BadCommand { index: 200 },
            "01 f8 ac d1 91 01 03 02 06 c8 01 ac 02 80 01 80 20",
        ),
        (
            Refusal::OutOfReach { index: 200 },
            "01 f8 ac d1 91 01 03 02 07 c8 01 ac 02 80 01 80 20",
        ),
    ];
    for (refusal, expected) in refusals {
        check(ack(Verdict::Refused(refusal)), expected);
    }
}

fn status() -> Status {
    Status {
        at: LocalMicros(1_000_000),
        queue: QUEUE,
        state: NodeState::Stopped,
        stop: Some(StopReport {
            queue: QueueId { flush: 2, ..QUEUE },
            reason: StopReason::Client,
            at: LocalMicros(999_999),
            accepted_commands: 12,
            executed_commands: 11,
            positions_steps: heapless::Vec::from_slice(&[-5, 1 << 40]).expect("two axes"),
        }),
        job: Some(job()),
        accepted_commands: 300,
        executed_commands: 128,
        credit_commands: 4_096,
        axes: heapless::Vec::from_slice(&[
            AxisStatus {
                position_steps: -5,
                speed_mhz: 0,
            },
            AxisStatus {
                position_steps: 1 << 40,
                speed_mhz: -2_000_000,
            },
        ])
        .expect("two axes"),
        faults: heapless::Vec::from_slice(&[Fault {
            code: FaultCode::LINK_LOST,
            at: LocalMicros(5),
        }])
        .expect("one fault"),
        features: Features::BASIC,
        firmware: [0, 1, 0],
        rssi_dbm: Some(-67),
        laser_percent: 0,
        lidar_mm: Some(1_234),
    }
}

#[test]
fn a_status_has_its_bytes() {
    check(
        status(),
        "01 c0 84 3d f8 ac d1 91 01 03 04 01 f8 ac d1 91 01 02 00 bf 84 3d 0c 0b 02 09 80 80 80 80 80 40 01 09 70 61 72 74 2d 30 38 31 35 ac 02 80 01 80 20 02 09 00 80 80 80 80 80 40 ff 91 f4 01 01 65 05 01 00 01 00 01 bd 00 01 d2 09",
    );
    let idle = Status {
        state: NodeState::Idle,
        stop: None,
        job: None,
        axes: heapless::Vec::new(),
        faults: heapless::Vec::new(),
        rssi_dbm: None,
        lidar_mm: None,
        ..status()
    };
    check(
        idle,
        "01 c0 84 3d f8 ac d1 91 01 03 00 00 00 ac 02 80 01 80 20 00 00 01 00 01 00 00 00 00",
    );
    for (state, number) in [
        (NodeState::Idle, 0),
        (NodeState::Ready, 1),
        (NodeState::Running, 2),
        (NodeState::Paused, 3),
        (NodeState::Stopped, 4),
        (NodeState::Fault, 5),
    ] {
        check(state, &format!("01 {number:02x}"));
    }
    for (reason, number) in [
        (StopReason::Client, 0),
        (StopReason::Pin, 1),
        (StopReason::Link, 2),
        (StopReason::Fault, 3),
        (StopReason::Limit, 4),
        (StopReason::Cancel, 5),
    ] {
        check(reason, &format!("01 {number:02x}"));
    }
}

#[test]
fn clock_messages_have_their_bytes() {
    let sent_at = FleetMicros(1_795_230_000_123_456);
    check(
        ClockMessage::Probe(ClockProbe { probe: 7, sent_at }),
        "01 00 07 c0 9c ca f3 88 98 98 03",
    );
    let reply = ClockReply {
        probe: 7,
        boot: QUEUE.boot,
        sent_at,
        received_at: LocalMicros(10_050),
        replied_at: LocalMicros(10_060),
    };
    check(
        ClockMessage::Reply(reply),
        "01 01 07 f8 ac d1 91 01 c0 9c ca f3 88 98 98 03 c2 4e cc 4e",
    );
}

#[test]
fn start_messages_have_their_bytes() {
    let (queue, command) = (QUEUE, 300);
    check(
        StartMessage::Ready { queue, command },
        "01 00 f8 ac d1 91 01 03 ac 02",
    );
    let commit = StartMessage::Commit {
        queue,
        command,
        start_at: LocalMicros(2_000_000),
        confirm_by: LocalMicros(1_980_000),
    };
    check(commit, "01 01 f8 ac d1 91 01 03 ac 02 80 89 7a e0 ec 78");
    check(
        StartMessage::Armed { queue, command },
        "01 02 f8 ac d1 91 01 03 ac 02",
    );
    check(
        StartMessage::Confirm { queue, command },
        "01 03 f8 ac d1 91 01 03 ac 02",
    );
    check(
        StartMessage::Abort { queue, command },
        "01 04 f8 ac d1 91 01 03 ac 02",
    );
    let started = StartMessage::Started {
        queue,
        command,
        first_edge_at: LocalMicros(2_000_001),
    };
    check(started, "01 05 f8 ac d1 91 01 03 ac 02 81 89 7a");
}

#[test]
fn pace_messages_have_their_bytes() {
    check(PaceMessage::Ask, "01 00");
    let set = |hold, percent| PaceMessage::Set {
        boot: QUEUE.boot,
        change: 300,
        hold,
        percent,
    };
    check(set(Some(true), None), "01 01 f8 ac d1 91 01 ac 02 01 01 00");
    check(
        set(None, Some(400)),
        "01 01 f8 ac d1 91 01 ac 02 00 01 90 03",
    );
    let told = PaceMessage::Told {
        boot: QUEUE.boot,
        change: 300,
        hold: true,
        percent: 50,
    };
    check(told, "01 02 f8 ac d1 91 01 ac 02 01 32");
    check(Features::PACE, "01 40");
}

#[test]
fn the_name_of_a_barrier_has_its_bytes_and_its_bounds() {
    let (queue, command) = (QUEUE, 300);
    let name = BarrierName::new("layer-2").expect("legal");
    check(
        StartMessage::ReadyAt {
            queue,
            command,
            name,
        },
        "01 06 f8 ac d1 91 01 03 ac 02 07 6c 61 79 65 72 2d 32",
    );
    assert_eq!(BarrierName::new(""), None);
    let longest = "x".repeat(64);
    assert_eq!(
        BarrierName::new(&longest).map(|name| name.as_str() == longest),
        Some(true)
    );
    assert_eq!(BarrierName::new(&"x".repeat(65)), None);
    for wrong in ["01 06 01 01 01 00", "01 06 01 01 01 01 ff"] {
        let bytes: Vec<u8> = wrong
            .split(' ')
            .map(|byte| u8::from_str_radix(byte, 16).expect("hex"))
            .collect();
        assert!(version::decode::<StartMessage>(&bytes).is_err(), "{wrong}");
    }
}

#[test]
fn the_longest_messages_fit_the_stated_bounds() {
    let longest_job = JobId::new("01234567890123456789012345678901").expect("legal");
    let queue = QueueId {
        boot: u32::MAX,
        flush: u32::MAX,
    };
    let positions = heapless::Vec::from_slice(&[i64::MIN; keys::AXES_MAX]).expect("all axes");
    let axis = AxisStatus {
        position_steps: i64::MIN,
        speed_mhz: i32::MIN,
    };
    let fault = Fault {
        code: FaultCode(u16::MAX),
        at: LocalMicros(u64::MAX),
    };
    let longest = Status {
        at: LocalMicros(u64::MAX),
        queue,
        state: NodeState::Fault,
        stop: Some(StopReport {
            queue,
            reason: StopReason::Cancel,
            at: LocalMicros(u64::MAX),
            accepted_commands: u64::MAX,
            executed_commands: u64::MAX,
            positions_steps: positions,
        }),
        job: Some(longest_job),
        accepted_commands: u64::MAX,
        executed_commands: u64::MAX,
        credit_commands: u32::MAX,
        axes: heapless::Vec::from_slice(&[axis; keys::AXES_MAX]).expect("all axes"),
        faults: heapless::Vec::from_slice(&[fault; keys::status::FAULTS_MAX]).expect("all"),
        features: Features(u32::MAX),
        firmware: [255; 3],
        rssi_dbm: Some(i8::MIN),
        laser_percent: 100,
        lidar_mm: Some(u32::MAX),
    };
    let mut buffer = [0; keys::status::STATUS_BYTES_MAX];
    assert!(version::encode(&longest, &mut buffer).is_ok());

    let line = Command::Line {
        steps: [i32::MIN; 4],
        speed_hz: u32::MAX,
        accel_hz_per_s: u32::MAX,
        jerk_hz_per_s2: u32::MAX,
    };
    let header = BatchHeader {
        queue,
        first_command: u64::MAX,
        command_count: 0,
        job: longest_job,
        job_end: u64::MAX,
    };
    for command in [line, Command::LidarRead] {
        let mut writer = BatchWriter::new();
        while writer.push(&command) {}
        let mut buffer = [0; keys::batch::ORDER_BYTES_MAX];
        let bytes = writer
            .finish(header, &mut buffer)
            .expect("the writer keeps its bound");
        let mut reader = BatchReader::new(bytes).expect("legal");
        let mut count = 0;
        while reader.next_command().expect("legal").is_some() {
            count += 1;
        }
        assert_eq!(count, writer.command_count());
    }
}

#[test]
fn commands_of_c_and_d_have_their_bytes_and_survive_their_words() {
    let cases = [
        (Command::MoveC { index: 0 }, "01 0b 00"),
        (Command::MoveC { index: 4 }, "01 0b 04"),
        (Command::MoveD { on: false }, "01 0c 00"),
        (Command::MoveD { on: true }, "01 0c 01"),
        (Command::StatusCd, "01 0d"),
    ];
    for (command, expected) in cases {
        check(command, expected);
        assert_eq!(Command::from_words(&command.to_words()), Ok(command));
        assert_eq!(command.feature(), Features::CD);
        assert_eq!(command.axis_max(), None);
    }
    check(Features::CD, "01 20");
    assert!(
        Command::from_words(&[11, 256, 0, 0, 0, 0, 0, 0]).is_err(),
        "no such index"
    );
    assert!(
        Command::from_words(&[12, 2, 0, 0, 0, 0, 0, 0]).is_err(),
        "neither on nor off"
    );
    assert!(Command::from_words(&[14, 0, 0, 0, 0, 0, 0, 0]).is_err());
}

#[test]
fn events_of_a_job_have_their_bytes() {
    let event = |what| TraceEvent {
        boot: 7,
        number: 300,
        at: LocalMicros(1_000),
        job: JobId::new("j").ok(),
        what,
    };
    let cases = [
        (TraceWord::Taken, "00"),
        (TraceWord::FirstPulse, "01"),
        (TraceWord::Ended, "02"),
        (TraceWord::Held, "03"),
        (TraceWord::Resumed, "04"),
        (TraceWord::Speed { percent: 50 }, "05 32"),
        (TraceWord::StopTaken(StopReason::Client), "06 00"),
        (TraceWord::Stopped(StopReason::Cancel), "07 05"),
        (TraceWord::LinkLost, "08"),
        (TraceWord::Fault(FaultCode::UNDERRUN), "09 ca 01"),
        (TraceWord::ScriptEnded, "0a"),
        (TraceWord::ScriptFailed, "0b"),
    ];
    for (what, bytes) in cases {
        check(event(what), &format!("01 07 ac 02 e8 07 01 01 6a {bytes}"));
    }
}

#[test]
fn vitals_have_their_bytes_and_are_read_with_fewer_fields_or_more() {
    let told = |vitals: Vitals| {
        let mut buffer = [0; VITALS_BYTES_MAX];
        vitals.encode(&mut buffer).to_vec()
    };
    let all = Vitals {
        at: LocalMicros(1_000),
        uptime_s: Some(300),
        chip_celsius: Some(-5),
        internal_free_bytes: Some(40_000),
        psram_free_bytes: Some(7_000_000),
        network_stack_free_bytes: Some(0),
        planning_stack_free_bytes: Some(50_000),
    };
    let bytes = told(all);
    assert_eq!(
        hex(&bytes),
        "01 e8 07 01 ac 02 01 09 01 c0 b8 02 01 c0 9f ab 03 01 00 01 d0 86 03"
    );
    assert_eq!(Vitals::decode(&bytes), Ok(all));
    let emulated = Vitals {
        at: LocalMicros(1_000),
        uptime_s: Some(300),
        ..Vitals::default()
    };
    assert_eq!(hex(&told(emulated)), "01 e8 07 01 ac 02 00 00 00 00 00");
    let older = &told(emulated)[..6];
    assert_eq!(Vitals::decode(older), Ok(emulated));
    let newer = [&bytes[..], &[1, 0xff, 0xff, 1]].concat();
    assert_eq!(Vitals::decode(&newer), Ok(all));
    let most = Vitals {
        at: LocalMicros(u64::MAX),
        uptime_s: Some(u32::MAX),
        chip_celsius: Some(i16::MIN),
        internal_free_bytes: Some(u32::MAX),
        psram_free_bytes: Some(u32::MAX),
        network_stack_free_bytes: Some(u32::MAX),
        planning_stack_free_bytes: Some(u32::MAX),
    };
    assert_eq!(Vitals::decode(&told(most)), Ok(most));
    for nonsense in [&[][..], &[1], &[2, 0], &[1, 0, 2], &[1; 65]] {
        assert!(Vitals::decode(nonsense).is_err(), "{nonsense:?}");
    }
}

#[test]
fn a_smooth_ramp_has_its_bytes_and_survives_its_words() {
    let ramp = Ramp {
        speed_hz: 1_500,
        accel_hz_per_s: 0,
        shape: RampShape::Smooth {
            start_hz: 500,
            ramp_steps: 70_000,
        },
    };
    let cases = [
        (
            Command::Ramp {
                axis: AxisId(2),
                steps: -6_000,
                ramp,
            },
            "01 06 02 df 5d dc 0b 00 02 f4 03 f0 a2 04",
        ),
        (
            Command::RampTo {
                axis: AxisId(1),
                position_steps: 1 << 33,
                ramp,
            },
            "01 07 01 80 80 80 80 40 dc 0b 00 02 f4 03 f0 a2 04",
        ),
    ];
    for (command, expected) in cases {
        check(command, expected);
        assert_eq!(Command::from_words(&command.to_words()), Ok(command));
        assert_eq!(
            command.feature(),
            Features::RAMPS.with(Features::SMOOTH),
            "a firmware that does not know it is not told"
        );
    }
    check(Features::SMOOTH, "01 80 01");
    let unknown = 6 | 3 << 16;
    assert!(Command::from_words(&[unknown, 1, 0, 1, 1, 1, 1, 0]).is_err());
}
