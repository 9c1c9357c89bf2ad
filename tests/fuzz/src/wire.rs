//! Messages between gateway and node: the first byte says which, the rest is the message.
//!
//! Whatever can be read can be written, and reads as the same again.

use keys::{
    BatchAck, Command, FleetMicros, LocalMicros, NodeId, QueueId, ScriptHeader, ScriptReport,
    Status, Stop, StopMode, StopReport,
    clock::{ClockMessage, ClockReply},
    command::COMMAND_WORDS,
    job::{GroupRequest, JobRequest},
    record::{JobRecord, NodeRecord},
    start::StartMessage,
    version,
};
use serde::{Serialize, de::DeserializeOwned};
use std::fmt::Debug;

/// Longest message that is written again.
const BYTES_MAX: usize = 1 << 16;

fn message<M: Serialize + DeserializeOwned + PartialEq + Debug>(bytes: &[u8]) {
    let Ok(message) = version::decode::<M>(bytes) else {
        return;
    };
    let mut buffer = vec![0; BYTES_MAX];
    // What a client wrote longer than it needs to be may not be longer here.
    let written = version::encode(&message, &mut buffer).expect("what was read can be written");
    assert!(written.len() <= bytes.len(), "{message:?}");
    let again = version::decode::<M>(written).expect("what was written can be read");
    assert_eq!(again, message);
}

fn record<M: Serialize + DeserializeOwned + PartialEq + Debug>(bytes: &[u8]) {
    let Ok(record) = serde_json::from_slice::<M>(bytes) else {
        return;
    };
    let written = keys::record::to_json(&record);
    let again = serde_json::from_slice::<M>(&written).expect("what was written can be read");
    assert_eq!(again, record);
}

/// See the module.
pub fn check(data: &[u8]) {
    let Some((kind, bytes)) = data.split_first() else {
        return;
    };
    match kind % 14 {
        0 => message::<BatchAck>(bytes),
        1 => message::<Status>(bytes),
        2 => message::<StopReport>(bytes),
        3 => message::<ClockMessage>(bytes),
        4 => message::<StartMessage>(bytes),
        5 => message::<Command>(bytes),
        6 => message::<ScriptHeader>(bytes),
        7 => {
            // An order to stop is never malformed: whatever it is, it stops.
            let stop = Stop::from_payload(bytes);
            assert_eq!(Stop::from_payload(stop.to_payload()), stop);
        }
        8 => {
            if let Ok((report, text)) = ScriptReport::decode(bytes) {
                let mut buffer = [0; keys::script::REPORT_BYTES_MAX];
                let written = report.encode(text, &mut buffer);
                let (again, begun) = ScriptReport::decode(written).expect("reads");
                assert_eq!(again, report);
                assert!(text.starts_with(begun));
            }
        }
        9 => {
            let mut words = [0; COMMAND_WORDS];
            for (word, four) in words.iter_mut().zip(bytes.chunks(4)) {
                let mut all = [0; 4];
                all[..four.len()].copy_from_slice(four);
                *word = u32::from_le_bytes(all);
            }
            if let Ok(command) = Command::from_words(&words) {
                let again = Command::from_words(&command.to_words()).expect("reads");
                assert_eq!(again, command);
            }
        }
        10 => record::<JobRecord>(bytes),
        11 => record::<NodeRecord>(bytes),
        // NaN is no time, and is not equal to itself: those are checked before they are compared.
        12 => {
            if JobRequest::from_postcard(bytes).is_ok() {
                message::<JobRequest>(bytes);
            }
        }
        _ => {
            if GroupRequest::from_postcard(bytes).is_ok() {
                message::<GroupRequest>(bytes);
            }
        }
    }
}

/// One of each kind.
pub fn seeds() -> Vec<Vec<u8>> {
    fn of<M: Serialize>(kind: u8, message: &M) -> Vec<u8> {
        let mut buffer = vec![0; BYTES_MAX];
        let written = version::encode(message, &mut buffer).expect("room");
        [&[kind], written].concat()
    }
    let queue = QueueId {
        boot: 0x1234_5678,
        flush: 3,
    };
    let ack = BatchAck {
        queue,
        verdict: keys::Verdict::Refused(keys::Refusal::Gap),
        accepted_commands: 300,
        executed_commands: 200,
        credit_commands: 3_900,
    };
    let report = StopReport {
        queue,
        reason: keys::StopReason::Client,
        at: LocalMicros(1 << 33),
        accepted_commands: 40,
        executed_commands: 12,
        positions_steps: [1, -70_000].into_iter().collect(),
    };
    let reply = ClockMessage::Reply(ClockReply {
        probe: 7,
        boot: 0x1234_5678,
        sent_at: FleetMicros(1 << 50),
        received_at: LocalMicros(1 << 30),
        replied_at: LocalMicros((1 << 30) + 40),
    });
    let move_ = Command::Move {
        axis: keys::AxisId(1),
        delay_us: 500,
        steps: -2_000,
    };
    let mut words = vec![9];
    words.extend(move_.to_words().iter().flat_map(|word| word.to_le_bytes()));
    let stop = Stop {
        mode: StopMode::Decelerate,
    };
    let job = JobRequest::from_json(br#"{"id":"a","commands":[{"pause":{"ms":100}}]}"#);
    let group =
        GroupRequest::from_json(br#"{"nodes":{"left":{"commands":[{"pause":{"ms":100}}]}}}"#);
    let node = NodeId::new("left").expect("legal");
    vec![
        of(0, &ack),
        of(2, &report),
        of(3, &reply),
        of(5, &move_),
        words,
        [&[7], stop.to_payload()].concat(),
        of(12, &job.expect("a job")),
        of(13, &group.expect("a job")),
        format!("\x0b{{\"node\":\"{node}\",\"alive\":true,\"state\":\"idle\",\"position\":[0],\"queue\":{{\"depth\":0,\"free\":4096}},\"job\":null,\"stopped\":null,\"clock\":null,\"firmware\":\"0.1.0\",\"uptime_s\":12,\"rssi_dbm\":null,\"faults\":[]}}").into_bytes(),
        b"\x0a{\"job\":\"cut-7\",\"node\":\"left\",\"group\":null,\"state\":\"running\",\"version\":3,\"created\":\"2026-11-21T03:00:00.123Z\",\"updated\":\"2026-11-21T03:00:00.123Z\",\"progress\":{\"done\":1200,\"total\":4000},\"error\":null,\"result\":null}".to_vec(),
    ]
}
