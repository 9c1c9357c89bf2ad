//! `fleet serve --otlp`: what a collector of OpenTelemetry gets to see of jobs. The collector is in
//! this file and reads the bytes by the public description of OTLP, not by the crate that wrote them.

#![cfg(all(unix, feature = "demo", feature = "otel"))]

mod program;

use keys::NodeId;
use program::Gateway;
use std::{
    collections::BTreeMap,
    io::{BufRead, BufReader, Read, Write},
    net::{TcpListener, TcpStream},
    sync::mpsc::{Receiver, Sender, channel},
    time::Duration,
};

/// Far more than anything here takes; only a failure waits so long.
const PATIENCE: Duration = Duration::from_secs(120);

/// A field of a protobuf message.
#[derive(Clone, Copy, Debug)]
enum Field<'b> {
    Number(u64),
    Bytes(&'b [u8]),
}

fn varint(bytes: &mut &[u8]) -> u64 {
    let mut value = 0;
    for shift in (0..64).step_by(7) {
        let (byte, rest) = bytes.split_first().expect("the rest of a number");
        *bytes = rest;
        value |= u64::from(byte & 0x7f) << shift;
        if byte & 0x80 == 0 {
            return value;
        }
    }
    panic!("a number without an end");
}

/// Reads a message: the numbers of its fields, and what is in them.
fn fields(mut bytes: &[u8]) -> Vec<(u64, Field<'_>)> {
    let mut fields = Vec::new();
    while !bytes.is_empty() {
        let tag = varint(&mut bytes);
        let fixed = |bytes: &mut &[u8], count: usize| {
            let (value, rest) = bytes.split_at(count);
            *bytes = rest;
            let little = value.iter().rev();
            little.fold(0, |all, byte| all << 8 | u64::from(*byte))
        };
        let field = match tag & 7 {
            0 => Field::Number(varint(&mut bytes)),
            1 => Field::Number(fixed(&mut bytes, 8)),
            5 => Field::Number(fixed(&mut bytes, 4)),
            2 => {
                let length = usize::try_from(varint(&mut bytes)).expect("small");
                let (value, rest) = bytes.split_at(length);
                bytes = rest;
                Field::Bytes(value)
            }
            other => panic!("wire type {other}"),
        };
        fields.push((tag >> 3, field));
    }
    fields
}

/// Returns the messages, texts or bytes with this number.
fn all<'b>(message: &'b [u8], number: u64) -> impl Iterator<Item = &'b [u8]> {
    let chosen = move |(of, field): (u64, Field<'b>)| match field {
        Field::Bytes(bytes) if of == number => Some(bytes),
        _ => None,
    };
    fields(message).into_iter().filter_map(chosen)
}

fn number(message: &[u8], number: u64) -> u64 {
    let chosen = |(of, field): (u64, Field<'_>)| match field {
        Field::Number(value) if of == number => Some(value),
        _ => None,
    };
    fields(message).into_iter().find_map(chosen).unwrap_or(0)
}

fn text(message: &[u8], number: u64) -> String {
    let bytes = all(message, number).next().unwrap_or_default();
    String::from_utf8(bytes.to_vec()).expect("UTF-8")
}

/// `KeyValue`s with texts.
fn attributes(message: &[u8], number: u64) -> BTreeMap<String, String> {
    all(message, number)
        .map(|pair| {
            let value = all(pair, 2).next().unwrap_or_default();
            (text(pair, 1), text(value, 1))
        })
        .collect()
}

/// What is looked at of a span.
#[derive(Clone, Debug)]
struct Span {
    name: String,
    took: Duration,
    attributes: BTreeMap<String, String>,
    states: Vec<String>,
    /// 0 unset, 1 ok, 2 error.
    status: u64,
    description: String,
}

/// Reads an `ExportTraceServiceRequest` of opentelemetry-proto 1.
fn spans(request: &[u8]) -> Vec<Span> {
    let mut spans = Vec::new();
    for of_resource in all(request, 1) {
        let resource = all(of_resource, 1).next().expect("who speaks");
        assert_eq!(attributes(resource, 1)["service.name"], "stepfleet");
        for of_scope in all(of_resource, 2) {
            for span in all(of_scope, 2) {
                let status = all(span, 15).next().unwrap_or_default();
                let states = all(span, 11).filter_map(|event| attributes(event, 3).remove("state"));
                spans.push(Span {
                    name: text(span, 5),
                    took: Duration::from_nanos(number(span, 8) - number(span, 7)),
                    attributes: attributes(span, 9),
                    states: states.collect(),
                    status: number(status, 3),
                    description: text(status, 2),
                });
            }
        }
    }
    spans
}

/// Takes what is posted until the sender closes the connection.
fn take(link: TcpStream, bodies: &Sender<Vec<u8>>) {
    let mut reader = BufReader::new(link);
    loop {
        let mut head = String::new();
        while !head.ends_with("\r\n\r\n") {
            if reader.read_line(&mut head).expect("a line") == 0 {
                return;
            }
        }
        let head = head.to_ascii_lowercase();
        assert!(head.starts_with("post /v1/traces http/1.1\r\n"), "{head}");
        assert!(head.contains("content-type: application/x-protobuf\r\n"));
        let length = head
            .lines()
            .find_map(|line| line.strip_prefix("content-length: "));
        let length = length.expect("a length").parse().expect("a number");
        let mut body = vec![0; length];
        reader.read_exact(&mut body).expect("a body");
        // The test may have seen enough.
        let _ = bodies.send(body);
        let answer =
            "HTTP/1.1 200 OK\r\nContent-Type: application/x-protobuf\r\nContent-Length: 0\r\n\r\n";
        let sent = reader.get_mut().write_all(answer.as_bytes());
        sent.expect("sent");
    }
}

/// Runs a collector; returns its address and what it gets.
fn collector() -> (String, Receiver<Vec<u8>>) {
    let listener = TcpListener::bind("127.0.0.1:0").expect("a port");
    let address = format!("http://{}", listener.local_addr().expect("bound"));
    let (sender, bodies) = channel();
    std::thread::spawn(move || {
        for link in listener.incoming() {
            let bodies = sender.clone();
            std::thread::spawn(move || take(link.expect("a connection"), &bodies));
        }
    });
    (address, bodies)
}

/// Jobs of one node: one that succeeds, one that takes too long, one that still waits at the end.
/// Returns the gateway's log.
fn a_day(gateway: Gateway) -> String {
    let runtime = tokio::runtime::Runtime::new().expect("a runtime");
    let inside = runtime.enter();
    let config = emulator::EmulatorConfig {
        connect: gateway.connect.clone(),
        ..emulator::EmulatorConfig::new(NodeId::new("left").expect("legal"))
    };
    let node = emulator::spawn(config).expect("spawned");
    drop(inside);
    let began = std::time::Instant::now();
    while !gateway
        .fleet(&["nodes", "--json"])
        .out
        .contains("\"alive\":true")
    {
        assert!(began.elapsed() < PATIENCE, "the node is not there");
    }
    let folder = tempfile::tempdir().expect("a folder");
    let submit = |id: &str, job: &str, options: &[&str], code: i32| {
        let file = folder.path().join(format!("{id}.json"));
        std::fs::write(&file, job).expect("written");
        let file = file.to_str().expect("UTF-8");
        let line = ["submit", file, "--node", "left", "--id", id];
        let ran = gateway.fleet(&[&line, options].concat());
        assert_eq!(ran.code, Some(code), "{}{}", ran.out, ran.err);
    };
    let job = r#"{"commands":[{"move":{"axis":0,"delay_us":1000,"steps":500}}]}"#;
    submit("good", job, &["--wait"], 0);
    let late =
        r#"{"timeout_s":0.05,"commands":[{"move":{"axis":0,"delay_us":1000,"steps":50000}}]}"#;
    submit("late", late, &["--wait"], 1);
    assert_eq!(gateway.fleet(&["queue", "left", "hold"]).code, Some(0));
    submit("waiting", job, &[], 0);
    let log = gateway.end();
    let _ended = runtime.block_on(node.shutdown());
    log
}

#[test]
fn a_collector_sees_each_job_from_its_intake_to_its_last_pulse() {
    let (address, bodies) = collector();
    let log = a_day(Gateway::start_with(
        &["--otlp", &address],
        "info,zenoh=error",
    ));
    assert!(log.contains("spans of jobs are sent"), "{log}");
    assert!(!log.contains("are lost"), "{log}");
    let mut seen = BTreeMap::new();
    for body in bodies.try_iter() {
        for span in spans(&body) {
            let job = span.attributes["job"].clone();
            assert!(seen.insert(job, span).is_none(), "one span for each job");
        }
    }
    let names: Vec<&str> = seen.keys().map(String::as_str).collect();
    assert_eq!(names, ["good", "late", "waiting"]);
    assert!(seen.values().all(|span| span.name == "job"));
    assert!(seen.values().all(|span| span.attributes["node"] == "left"));

    let good = &seen["good"];
    assert_eq!(good.status, 1, "{good:?}");
    assert_eq!(good.states.first().map(String::as_str), Some("queued"));
    assert_eq!(good.states.last().map(String::as_str), Some("succeeded"));
    // 500 steps, one each millisecond: whoever ends the span before the last pulse is found out.
    assert!(good.took >= Duration::from_millis(499), "{good:?}");

    let late = &seen["late"];
    assert_eq!(late.status, 2, "{late:?}");
    assert_eq!(late.states.last().map(String::as_str), Some("timed_out"));
    assert!(!late.description.is_empty(), "{late:?}");

    // What had not ended is neither good nor bad.
    let waiting = &seen["waiting"];
    assert_eq!(
        (waiting.status, &*waiting.states),
        (0, &["queued".to_owned()][..])
    );
}

#[test]
fn a_collector_that_does_not_answer_costs_the_spans_and_nothing_else() {
    // Connections are made by the system; nobody reads.
    let silent = TcpListener::bind("127.0.0.1:0").expect("a port");
    let address = format!("http://{}", silent.local_addr().expect("bound"));
    let log = a_day(Gateway::start_with(
        &["--otlp", &address],
        "warn,zenoh=error",
    ));
    assert!(log.contains("the last spans are lost"), "{log}");
}

#[test]
fn an_address_that_is_none_is_refused_before_anything_begins() {
    let ran = program::fleet(&["serve", "--otlp", "localhost:4318"]);
    assert_eq!(ran.code, Some(2));
    assert!(ran.err.contains("http://HOST:PORT"), "{}", ran.err);
}
