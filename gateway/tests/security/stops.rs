//! A stop on a wide key in a secured fleet: whoever may stop may say it in every form that ends in
//! `/node/NODES/stop`, and nothing else gets through by those forms.

use crate::plant::{Plant, ask, in_time, job_exists, put, until};
use keys::{AxisStatus, Features, LocalMicros, NodeState, QueueId, Status, version};
use serde_json::json;
use std::time::Duration;

/// Every form that a secured fleet takes.
const TAKEN: [&str; 8] = [
    "fleet/node/left/stop",
    "fleet/node/*/stop",
    "fleet/node/l$*/stop",
    "*/node/*/stop",
    "*/node/left/stop",
    "**/node/*/stop",
    "fleet/**/node/le$*/stop",
    "fl$*/node/*/stop",
];

/// Keys that include a stop's without naming it.
const REFUSED: [&str; 6] = [
    "fleet/**",
    "**/stop",
    "fleet/node/**",
    "fleet/node/left/**",
    "fleet/node/*/*",
    "fleet/node/**/stop",
];

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_stop_in_every_form_that_names_it_is_heard_from_operator_and_viewer() {
    let plant = Plant::new().await;
    let left = plant.node("left");
    let (alice, bob) = (plant.session("alice").await, plant.session("bob").await);
    until(&alice, "left", |record| record.alive).await;
    let stopped_and_released = async |form: &str| {
        until(&alice, "left", |record| record.stopped.is_some()).await;
        let released = ask(&alice, "fleet/node/left/release", None).await;
        assert!(released[0].is_ok(), "{form}: {released:?}");
        until(&alice, "left", |record| record.stopped.is_none()).await;
    };
    for (index, form) in TAKEN.into_iter().enumerate() {
        let session = if index % 2 == 0 { &bob } else { &alice };
        put(session, form, "").await;
        stopped_and_released(form).await;
    }
    // A value that is deleted stops like one that is put.
    in_time(bob.delete("fleet/node/*/stop"))
        .await
        .expect("deleted");
    stopped_and_released("delete").await;
    in_time(left.shutdown()).await;
    in_time(plant.service.shutdown())
        .await
        .expect("a clean end");
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_key_that_only_includes_stops_is_denied_and_so_is_what_a_wide_stop_could_carry_along() {
    let plant = Plant::new().await;
    let left = plant.node("left");
    let (alice, bob) = (plant.session("alice").await, plant.session("bob").await);
    until(&alice, "left", |record| record.alive).await;
    let data = in_time(alice.declare_subscriber("fleet/node/*/data/**")).await;
    let data = data.expect("declared");
    let records = in_time(alice.declare_subscriber("fleet/job/*")).await;
    let records = records.expect("declared");
    // An answer comes behind it: then the router knows what she wants to hear.
    ask(&alice, "fleet/node/left/state", None).await;
    for form in REFUSED {
        put(&bob, form, "").await;
    }
    for forged in [
        "fleet/node/left/data/node/a/stop",
        "fleet/job/stop",
        "fleet/**/job/stop",
    ] {
        put(&bob, forged, "{}").await;
    }
    put(&bob, "fleet/node/left/script/stop", "return 1").await;
    // Behind all of that: what he may say, and so the rest has been passed over.
    ask(&bob, "fleet/node/left/state", None).await;
    let record = until(&alice, "left", |_| true).await;
    assert_eq!(record.stopped, None, "a key that names no stop");
    put(&bob, "fleet/node/left/stop", "").await;
    until(&alice, "left", |record| record.stopped.is_some()).await;
    assert!(data.try_recv().expect("open").is_none(), "forged data");
    assert!(
        records.try_recv().expect("open").is_none(),
        "a forged record"
    );
    assert!(!job_exists(&alice, "stop").await);
    let scripts = ask(&alice, "fleet/node/left/script/*", None).await;
    assert!(scripts.is_empty(), "{scripts:?}");
    let refused = json!({"id": "late", "commands": []});
    assert!(
        ask(&bob, "fleet/node/left/job", Some(&refused))
            .await
            .iter()
            .all(Result::is_err)
    );
    in_time(left.shutdown()).await;
    in_time(plant.service.shutdown())
        .await
        .expect("a clean end");
}

/// The word of a node that is idle.
pub(crate) fn idle_status() -> Vec<u8> {
    let status = Status {
        at: LocalMicros(1),
        queue: QueueId { boot: 1, flush: 0 },
        state: NodeState::Idle,
        stop: None,
        job: None,
        accepted_commands: 0,
        executed_commands: 0,
        credit_commands: 16,
        axes: [AxisStatus::default()].into_iter().collect(),
        faults: [].into_iter().collect(),
        features: Features::BASIC,
        firmware: [0, 1, 0],
        rssi_dbm: None,
        laser_percent: 0,
        lidar_mm: None,
    };
    let mut buffer = [0; 512];
    let bytes = version::encode(&status, &mut buffer);
    bytes.expect("it fits").to_vec()
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_stop_that_the_gateway_repeats_is_not_taken_for_a_clients() {
    let plant = Plant::new().await;
    let (alice, bob) = (plant.session("alice").await, plant.session("bob").await);
    // A node that hears no stop.
    let left = plant.session("left").await;
    let _token = in_time(left.liveliness().declare_token("fleet/node/left/alive")).await;
    put(&left, "fleet/node/left/status", idle_status()).await;
    until(&alice, "left", |record| record.alive).await;
    let stops = in_time(alice.declare_subscriber("fleet/node/left/stop")).await;
    let stops = stops.expect("declared");
    // An answer comes behind it: then the router knows what she wants to hear.
    ask(&alice, "fleet/node/left/state", None).await;
    put(&bob, "fleet/node/left/stop", "{\"mode\":\"decelerate\"}").await;
    // Bob's, and behind it the gateway's: after half a second, another half, and a second. One that heard
    // its own words as a client's would begin to count anew with each.
    let mut stamps = Vec::new();
    for _ in 0..4 {
        let sample = in_time(stops.recv_async()).await.expect("a stop");
        let stamp = sample.timestamp().expect("the router stamps all");
        stamps.push(stamp.get_time().to_duration());
    }
    let apart: Vec<Duration> = stamps.windows(2).map(|pair| pair[1] - pair[0]).collect();
    assert!(apart[2] > Duration::from_millis(900), "{apart:?}");
    in_time(plant.service.shutdown())
        .await
        .expect("a clean end");
}
