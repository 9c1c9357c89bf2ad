//! Scripts on the wire: exact bytes, and jobs that carry or call one.
#![cfg(feature = "json")]

use keys::{
    BatchReader, JobId, Order, QueueId, ScriptHeader, ScriptOutcome, ScriptReport,
    job::{JobRequest, Work},
    record::ErrorCode,
    script::{PART_BYTES_MAX, REPORT_BYTES_MAX, REPORT_TEXT_BYTES_MAX, SCRIPT_BYTES_MAX},
    version,
};

const QUEUE: QueueId = QueueId { boot: 7, flush: 1 };

fn job(name: &str) -> JobId {
    JobId::new(name).expect("a name")
}

#[test]
fn the_bytes_of_scripts_did_not_change() {
    let header = ScriptHeader {
        queue: QUEUE,
        first_command: 300,
        job: job("a"),
        offset_bytes: 1400,
        total_bytes: 2000,
    };
    let mut buffer = [0; 128];
    let bytes = version::encode(&Order::Script(header), &mut buffer).expect("room");
    assert_eq!(
        bytes,
        [1, 3, 7, 1, 0xac, 2, 1, b'a', 0xf8, 10, 0xd0, 15],
        "if this fails, do not change the test"
    );
    let mut bytes = bytes.to_vec();
    bytes.extend_from_slice(b"return 1");
    let reader = BatchReader::new(&bytes).expect("reads");
    assert_eq!(*reader.order(), Order::Script(header));
    assert_eq!(reader.rest(), b"return 1");

    let seen = Order::ScriptSeen {
        queue: QUEUE,
        first_command: 300,
    };
    let bytes = version::encode(&seen, &mut buffer).expect("room");
    assert_eq!(
        bytes,
        [1, 4, 7, 1, 0xac, 2],
        "if this fails, do not change the test"
    );

    let report = ScriptReport {
        queue: QUEUE,
        first_command: 300,
        end_command: 301,
        job: job("a"),
        outcome: ScriptOutcome::Failed,
    };
    let mut buffer = [0; REPORT_BYTES_MAX];
    let bytes = report.encode("no", &mut buffer);
    assert_eq!(
        bytes,
        [1, 7, 1, 0xac, 2, 0xad, 2, 1, b'a', 1, b'n', b'o'],
        "if this fails, do not change the test"
    );
    assert_eq!(ScriptReport::decode(bytes), Ok((report, "no")));
}

#[test]
fn the_longest_messages_fit() {
    let longest = job("01234567890123456789012345678901");
    let queue = QueueId {
        boot: u32::MAX,
        flush: u32::MAX,
    };
    let header = Order::Script(ScriptHeader {
        queue,
        first_command: u64::MAX,
        job: longest,
        offset_bytes: u32::MAX,
        total_bytes: u32::MAX,
    });
    let mut buffer = [0; keys::batch::ORDER_BYTES_MAX];
    let used = version::encode(&header, &mut buffer).expect("room").len();
    assert!(
        used + PART_BYTES_MAX <= keys::batch::ORDER_BYTES_MAX,
        "{used}"
    );
    let report = ScriptReport {
        queue,
        first_command: u64::MAX,
        end_command: u64::MAX,
        job: longest,
        outcome: ScriptOutcome::Returned,
    };
    let mut buffer = [0; REPORT_BYTES_MAX];
    let text = "é".repeat(REPORT_TEXT_BYTES_MAX);
    let (read, kept) = ScriptReport::decode(report.encode(&text, &mut buffer)).expect("reads");
    assert_eq!((read, kept.len()), (report, REPORT_TEXT_BYTES_MAX));
}

#[test]
fn a_call_is_a_script_that_calls() {
    let script = |text: &str| match JobRequest::from_json(text.as_bytes()).map(|job| job.work) {
        Ok(Work::Lua(script)) => script,
        other => panic!("{text}: {other:?}"),
    };
    assert_eq!(
        script(r#"{"call":"spiral"}"#),
        "return node.call(\"spiral\", nil)"
    );
    assert_eq!(
        script(
            r#"{"call":"a-1","args":{"n":-5,"f":2.5,"big":3000000000,"t":"q\"\n","l":[true,null]}}"#
        ),
        "return node.call(\"a-1\", {[\"big\"]=3e9,[\"f\"]=2.5e0,[\"l\"]={true,nil,},[\"n\"]=-5,[\"t\"]=\"q\\\"\\010\",})"
    );
    for (text, words) in [
        (r#"{"call":"A"}"#, "call: a name consists of"),
        (r#"{"call":"a","lua":"x"}"#, "either `lua` or `call`"),
        (r#"{"call":"a","commands":[]}"#, "not both"),
        (r#"{"lua":"x","args":{}}"#, "args: only a `call`"),
    ] {
        let error = JobRequest::from_json(text.as_bytes()).expect_err(text);
        assert_eq!(error.code, ErrorCode::BadJson, "{text}: {error}");
        assert!(error.message.contains(words), "{text}: {error}");
    }
    let long = format!(r#"{{"lua":"{}"}}"#, "x".repeat(SCRIPT_BYTES_MAX + 1));
    let error = JobRequest::from_json(long.as_bytes()).expect_err("too long");
    assert_eq!(error.code, ErrorCode::TooLarge);
}
