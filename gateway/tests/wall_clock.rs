//! The wall clock is set while a real gateway runs and a real node works: nothing begins anew before the
//! job's end, the gateway does then, and its node obeys it although time went back.
#![cfg(feature = "demo")]

use emulator::EmulatorConfig;
use gateway::{
    clock_watch::Wall,
    config::GatewayConfig,
    service::{self, Ready, Remaining},
};
use keys::{
    NodeId,
    record::{JobRecord, JobState},
};
use serde_json::json;
use std::time::Duration;
use tokio::sync::{mpsc, oneshot};
use zenoh::{Session, bytes::Encoding, query::ConsolidationMode};

/// Far more than anything here takes; only a failure waits so long.
const PATIENCE: Duration = Duration::from_secs(60);

const HOUR_US: i64 = 3_600_000_000;

async fn in_time<T>(what: impl IntoFuture<Output = T>) -> T {
    tokio::time::timeout(PATIENCE, what).await.expect("in time")
}

async fn client(locator: &str) -> Session {
    let mut config = zenoh::Config::default();
    for (key, value) in [
        ("mode", "\"client\"".to_owned()),
        ("connect/endpoints", format!("[\"{locator}\"]")),
        ("scouting/multicast/enabled", "false".to_owned()),
        ("transport/unicast/open_timeout", "60000".to_owned()),
    ] {
        config.insert_json5(key, &value).expect("a known setting");
    }
    in_time(zenoh::open(config)).await.expect("connected")
}

/// Hands a job in; it is queued also while the node is on its way back.
async fn submit(client: &Session, id: &str, steps: u32) {
    let step = json!({"move": {"axis": 0, "delay_us": 2_000, "steps": steps}});
    loop {
        let job = json!({"id": id, "commands": [step]});
        let get = client
            .get("fleet/node/left/job")
            .payload(job.to_string())
            .encoding(Encoding::APPLICATION_JSON)
            .timeout(PATIENCE);
        let replies = in_time(get).await.expect("asked");
        let reply = in_time(replies.recv_async()).await.expect("an answer");
        match reply.result() {
            Ok(_) => return,
            // A node that has never been seen: it is on its way.
            Err(error) => {
                let text = String::from_utf8_lossy(&error.payload().to_bytes()).into_owned();
                assert!(text.contains("unknown_node"), "{text}");
            }
        }
    }
}

/// Asks for something that a node does.
async fn ask(client: &Session, key: &str) {
    let replies = in_time(client.get(key).timeout(PATIENCE)).await;
    let reply = in_time(replies.expect("asked").recv_async()).await;
    let reply = reply.expect("an answer");
    assert!(reply.result().is_ok(), "{key}: {reply:?}");
}

/// The record of a job that has ended.
async fn end_of(client: &Session, id: &str) -> JobRecord {
    let key = format!("fleet/job/{id}");
    let changes = in_time(client.declare_subscriber(&key)).await;
    let changes = changes.expect("declared");
    loop {
        let get = client
            .get(&key)
            .consolidation(ConsolidationMode::None)
            .timeout(PATIENCE);
        let replies = in_time(get).await.expect("asked");
        let reply = in_time(replies.recv_async()).await.expect("an answer");
        let bytes = reply.result().expect("it was taken").payload().to_bytes();
        let record: JobRecord = serde_json::from_slice(&bytes).expect("a record");
        if record.state.is_final() {
            return record;
        }
        in_time(changes.recv_async()).await.expect("a change");
    }
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_wall_clock_that_is_set_while_a_node_works_begins_the_gateway_anew_when_it_rests() {
    let store = tempfile::tempdir().expect("a directory");
    let wall = Wall::to_be_set(Duration::from_millis(20));
    let config = GatewayConfig {
        listen: vec!["tcp/127.0.0.1:0".to_owned()],
        wall: wall.clone(),
        ..GatewayConfig::new(store.path().join("fleet.redb"))
    };
    let (begun, mut begins) = mpsc::unbounded_channel();
    let (shut_down, asked) = oneshot::channel::<()>();
    let (_machines, reloads) = mpsc::channel(1);
    let gateway = tokio::spawn(async move {
        let ready = |ready: Ready<'_>| {
            // The test may have failed and left.
            let _ = begun.send(ready.locators[0].clone());
        };
        let shutdown = async {
            let _ = asked.await;
        };
        service::run(config, None, ready, shutdown, reloads).await
    });
    let locator = in_time(begins.recv()).await.expect("it begins");
    let left = emulator::spawn(EmulatorConfig {
        connect: locator.clone(),
        ..EmulatorConfig::new(NodeId::new("left").expect("legal"))
    })
    .expect("spawned");

    let alice = client(&locator).await;
    let statuses = in_time(alice.declare_subscriber("fleet/node/left/status")).await;
    let statuses = statuses.expect("declared");
    submit(&alice, "before", 1_000).await;
    ask(&alice, "fleet/node/left/hold").await;
    // Held in the middle, it has something to do for as long as anybody likes. It says at least once a
    // second that it is there, and the gateway looks fifty times.
    for ahead_us in [HOUR_US, -HOUR_US, 0, HOUR_US] {
        wall.set_ahead_us(ahead_us);
        in_time(statuses.recv_async()).await.expect("a status");
    }
    assert!(begins.try_recv().is_err(), "not while a node is at work");
    ask(&alice, "fleet/node/left/resume").await;
    let before = end_of(&alice, "before").await;
    assert_eq!(before.state, JobState::Succeeded, "{before:?}");
    let result = before.result.as_ref().expect("what succeeded has one");
    assert_eq!(result.position[0], 1_000, "nothing was disturbed");

    let again = in_time(begins.recv()).await.expect("it begins anew");
    assert_eq!(again, locator, "where it was");
    let bob = client(&locator).await;
    submit(&bob, "ahead", 10).await;
    let ahead = end_of(&bob, "ahead").await;
    assert_eq!(ahead.state, JobState::Succeeded, "{ahead:?}");
    let apart_us = ahead.created.since_us(before.created);
    assert!(apart_us.cast_signed() > HOUR_US - 1_000_000, "{apart_us}");
    assert_eq!(end_of(&bob, "before").await, before, "history stays");

    wall.set_ahead_us(0);
    in_time(begins.recv()).await.expect("once more");
    let carol = client(&locator).await;
    submit(&carol, "right", 10).await;
    let right = end_of(&carol, "right").await;
    assert_eq!(
        right.state,
        JobState::Succeeded,
        "an older date, a newer epoch"
    );
    assert!(right.created < ahead.created, "{right:?}");
    let result = right.result.expect("what succeeded has one");
    assert_eq!(result.position[0], 1_020, "each step once");

    shut_down.send(()).expect("it runs");
    let remaining = in_time(gateway).await.expect("no panic");
    assert_eq!(remaining.expect("a clean end"), Remaining::default());
    assert!(begins.try_recv().is_err(), "three times, no more");
    in_time(left.shutdown()).await;
}
