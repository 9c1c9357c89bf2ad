//! The client in Rust against a gateway and an emulated node, over real sockets.

use client::{
    Fleet, FleetError,
    keys::{GroupId, JobId, Keys, NodeId, StopMode, record::JobState},
};
use gateway::{
    config::GatewayConfig,
    job::gcode::{Machine, Machines},
    service::Service,
};
use std::time::Duration;

/// Far more than anything here takes; only a failure waits so long.
const PATIENCE: Duration = Duration::from_secs(60);

async fn in_time<T>(what: impl Future<Output = T>) -> T {
    tokio::time::timeout(PATIENCE, what).await.expect("in time")
}

fn node(name: &str) -> NodeId {
    NodeId::new(name).expect("legal")
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_client_hands_in_follows_stops_releases_and_is_told_what_cannot_be() {
    let store = tempfile::tempdir().expect("a folder");
    let machine = Machine::alike(2, 80.0, 6_000.0, 500.0);
    let config = GatewayConfig {
        listen: vec!["tcp/127.0.0.1:0".to_owned()],
        machines: Machines::from([(node("left"), machine)]),
        ..GatewayConfig::new(store.path().join("fleet.redb"))
    };
    let service = Service::start(config).await.expect("started");
    let locator = service.locators()[0].clone();
    let nodes = ["left", "right"].map(|name| {
        let config = emulator::EmulatorConfig {
            connect: locator.clone(),
            ..emulator::EmulatorConfig::new(node(name))
        };
        emulator::spawn(config).expect("spawned")
    });
    let fleet = in_time(Fleet::open(&locator)).await.expect("connected");
    let fleet = fleet.with_patience(PATIENCE);
    in_time(async {
        loop {
            let known = fleet.nodes().await.expect("answered");
            if known.iter().filter(|node| node.alive).count() == 2 {
                return;
            }
        }
    })
    .await;

    let left = node("left");
    let job = br#"{"id":"a","commands":[{"move":{"axis":0,"delay_us":100,"steps":500}}]}"#;
    let receipt = in_time(fleet.submit(&left, job)).await.expect("taken");
    let mut follow = in_time(fleet.follow(&receipt.job)).await.expect("there");
    let mut versions = Vec::new();
    let last = loop {
        let record = in_time(follow.next()).await.expect("a record");
        versions.push(record.version);
        if record.state.is_final() {
            break record;
        }
    };
    assert!(versions.is_sorted(), "{versions:?}");
    assert_eq!(last.state, JobState::Succeeded);
    assert_eq!(last.result.expect("ended").position, [500, 0]);

    let id = JobId::new("g").expect("legal");
    let receipt = in_time(fleet.submit_gcode(&left, "G91 G1 X-1 F6000", Some(&id)))
        .await
        .expect("taken");
    assert_eq!(receipt.job, id);
    let record = in_time(fleet.wait(&id)).await.expect("ended");
    assert_eq!(record.result.expect("ended").position, [420, 0]);

    let part = r#"{"commands":[{"move":{"axis":1,"delay_us":100,"steps":5}}]}"#;
    let both = format!(r#"{{"nodes":{{"left":{part},"right":{part}}},"max_skew_us":1e6}}"#);
    let group = GroupId::new("both").expect("legal");
    let receipt = in_time(fleet.submit_together(&group, both.as_bytes())).await;
    let record = in_time(fleet.wait(&receipt.expect("taken").job)).await;
    assert_eq!(record.expect("ended").state, JobState::Succeeded);

    let long = br#"{"id":"long","commands":[{"move":{"axis":0,"delay_us":1000,"steps":1000000}}]}"#;
    let receipt = in_time(fleet.submit(&left, long)).await.expect("taken");
    in_time(fleet.stop(&left, StopMode::Halt))
        .await
        .expect("said");
    let record = in_time(fleet.wait(&receipt.job)).await.expect("ended");
    assert_eq!(record.state, JobState::Failed);
    let released = in_time(fleet.release(&left)).await.expect("released");
    assert!(released.stopped.is_none());

    let short = br#"{"commands":[{"pause":{"ms":1}}]}"#;
    for refused in [
        in_time(fleet.submit(&node("nobody"), short)).await,
        in_time(fleet.submit(&left, b"{}")).await,
        // No router would say a word about this one.
        in_time(fleet.submit(&left, &vec![b' '; 80 << 20])).await,
        in_time(fleet.submit_gcode(&left, "G0 X", None)).await,
    ] {
        assert!(
            matches!(refused, Err(FleetError::Refused(_))),
            "{refused:?}"
        );
    }
    let keys = Keys::new("other").expect("legal");
    let other = in_time(Fleet::open_with(&locator, keys, None)).await;
    let nobody = in_time(other.expect("connected").job(&id)).await;
    assert!(
        matches!(nobody, Err(FleetError::NoGateway(_))),
        "{nobody:?}"
    );

    // Whoever does not read what he follows still gets his answers.
    let unread = in_time(fleet.follow(&id)).await.expect("there");
    let mut config = zenoh::Config::default();
    for (key, value) in [
        ("mode", "\"client\"".to_owned()),
        ("connect/endpoints", format!("[\"{locator}\"]")),
        ("scouting/multicast/enabled", "false".to_owned()),
    ] {
        config.insert_json5(key, &value).expect("a known setting");
    }
    let talker = in_time(async { zenoh::open(config).await })
        .await
        .expect("connected");
    for _ in 0..2_000 {
        let key = fleet.keys().job(&id).as_str().to_owned();
        let put = talker
            .put(key, "{}")
            .congestion_control(zenoh::qos::CongestionControl::Block);
        in_time(async { put.await }).await.expect("said");
    }
    assert!(in_time(fleet.job(&id)).await.is_ok());
    drop(unread);
    in_time(async { talker.close().await })
        .await
        .expect("closed");

    for node in nodes {
        in_time(node.shutdown()).await;
    }
    in_time(fleet.close()).await.expect("closed");
    in_time(service.shutdown()).await.expect("a clean end");
}
