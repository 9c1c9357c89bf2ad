//! Somebody who may look on connects as what he is not: as a peer, as another router. Rights go by the name
//! under which he got in, whatever his session calls itself.

use crate::plant::{PATIENCE, Plant, ask, in_time, job, job_exists, put, until};
use keys::record::JobRecord;
use serde_json::json;
use zenoh::{Session, sample::Locality};

/// A session that calls itself this.
async fn session_as(plant: &Plant, user: &str, mode: &str) -> Session {
    let credentials = plant.credentials(user);
    let mut config = zenoh::Config::default();
    let pairs = [
        ("mode", json!(mode)),
        ("connect/endpoints", json!([plant.tls()])),
        ("listen/endpoints", json!([])),
        ("scouting/multicast/enabled", json!(false)),
        ("transport/unicast/open_timeout", json!(60_000)),
    ];
    let pairs = pairs.map(|(key, value)| (key, value.to_string()));
    for (key, value) in pairs.into_iter().chain(credentials.zenoh_settings()) {
        config.insert_json5(key, &value).expect("known");
    }
    in_time(zenoh::open(config)).await.expect("connected")
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn whoever_calls_himself_a_peer_says_and_hears_no_more_than_before() {
    let plant = Plant::new().await;
    let left = plant.node("left");
    let alice = plant.session("alice").await;
    until(&alice, "left", |record| record.alive).await;
    {
        let mode = "peer";
        let bob = session_as(&plant, "bob", mode).await;
        let heard = bob
            .declare_subscriber("fleet/**")
            // What he says himself he hears at home.
            .allowed_origin(Locality::Remote);
        let heard = in_time(heard).await.expect("declared");
        // A record of the node that he may follow: then the router knows what he wants to hear.
        until(&bob, "left", |record| record.alive).await;
        let forged = format!("forged-{mode}");
        put(&bob, "fleet/node/left/job", job(&forged).to_string()).await;
        let record = json!({"job": forged}).to_string();
        put(&bob, &format!("fleet/job/{forged}"), record).await;
        put(&bob, "fleet/node/left/status", "not his").await;
        let _token = in_time(bob.liveliness().declare_token("fleet/node/right/alive")).await;
        // Orders to the node pass the router, and statuses of it, which he may hear.
        let follow = in_time(alice.declare_subscriber("fleet/job/*")).await;
        let follow = follow.expect("declared");
        let honest = format!("honest-{mode}");
        let receipt = ask(&alice, "fleet/node/left/job", Some(&job(&honest))).await;
        assert!(receipt[0].is_ok(), "{receipt:?}");
        loop {
            let sample = in_time(follow.recv_async()).await.expect("a record");
            let record: JobRecord =
                serde_json::from_slice(&sample.payload().to_bytes()).expect("a job record");
            assert_ne!(record.job.as_str(), forged);
            if record.state.is_final() {
                assert_eq!(record.state.as_str(), "succeeded", "{record:?}");
                break;
            }
        }
        // What he may: the stop, behind all that he may not.
        put(&bob, "fleet/node/left/stop", "").await;
        until(&alice, "left", |record| record.stopped.is_some()).await;
        assert!(!job_exists(&alice, &forged).await);
        let right = ask(&alice, "fleet/node/right/state", None).await;
        assert!(right.iter().all(Result::is_err), "{right:?}");
        let may_hear = ["state", "status", "vitals", "log", "stop"];
        let mut statuses = 0;
        while let Ok(Some(sample)) = heard.try_recv() {
            let key = sample.key_expr().as_str();
            let last = key.rsplit('/').next().unwrap_or_default();
            let may = key.starts_with("fleet/job/") || may_hear.contains(&last);
            assert!(may, "{mode}: he heard {key}");
            statuses += usize::from(last == "status");
        }
        assert!(statuses > 0, "{mode}: he hears what he may");
        let released = ask(&alice, "fleet/node/left/release", None).await;
        assert!(released[0].is_ok(), "{released:?}");
        in_time(async { bob.close().await }).await.expect("closed");
    }
    // As another router he is told nothing at all, and what he says leads nowhere. His session ends, so
    // it has been passed over.
    let bob = session_as(&plant, "bob", "router").await;
    put(&bob, "fleet/node/left/job", job("routed").to_string()).await;
    put(&bob, "fleet/job/routed", "{}").await;
    let _token = in_time(bob.liveliness().declare_token("fleet/node/right/alive")).await;
    in_time(async { bob.close().await }).await.expect("closed");
    assert!(!job_exists(&alice, "routed").await);
    let nodes = in_time(alice.get("fleet/node/*/state").timeout(PATIENCE)).await;
    let nodes = nodes.expect("asked");
    let mut names = Vec::new();
    while let Ok(reply) = in_time(nodes.recv_async()).await {
        let sample = reply.into_result().expect("a record");
        names.push(sample.key_expr().to_string());
    }
    assert_eq!(names, ["fleet/node/left/state"]);
    in_time(left.shutdown()).await;
    in_time(plant.service.shutdown())
        .await
        .expect("a clean end");
}
