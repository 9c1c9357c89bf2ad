//! One client that asks for too much, or too large, and what another one notices of it.

use crate::plant::{Plant, ask, in_time, put};
use gateway::bus::limits::ClientLimits;
use serde_json::json;

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_client_that_floods_speeds_and_releases_is_refused_and_another_one_is_not() {
    let limits = ClientLimits {
        requests_per_s: 1,
        ..ClientLimits::default()
    };
    let plant = Plant::with(limits).await;
    let (alice, carol) = (plant.session("alice").await, plant.session("carol").await);
    let wish = |word: &str| (word == "speed").then(|| json!({"percent": 50}));
    for word in ["speed", "hold", "resume", "release"] {
        let mut codes = Vec::new();
        for _ in 0..20 {
            let key = format!("fleet/node/left/{word}");
            for answer in ask(&alice, &key, wish(word).as_ref()).await {
                let error = answer.expect_err("nobody is there").error;
                codes.push(error.code.as_str().to_owned());
            }
        }
        assert!(
            codes.iter().any(|code| code == "not_allowed"),
            "{word}: {codes:?}"
        );
    }
    for word in ["release", "hold", "resume", "speed"] {
        let key = format!("fleet/node/left/{word}");
        let answer = ask(&carol, &key, wish(word).as_ref()).await;
        let error = &answer[0].as_ref().expect_err("nobody is there").error;
        assert_eq!(error.code.as_str(), "unknown_node", "{word}: {error:?}");
    }
    in_time(plant.service.shutdown())
        .await
        .expect("a clean end");
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn what_is_too_large_for_its_key_is_passed_on_to_nobody() {
    let plant = Plant::new().await;
    // Whoever has the router's rights hears everything that it passes on.
    let ears = plant.session("gateway").await;
    let heard = in_time(ears.declare_subscriber("fleet/node/**")).await;
    let heard = heard.expect("declared");
    let (alice, bob) = (plant.session("alice").await, plant.session("bob").await);
    let left = plant.session("left").await;
    // An answer comes behind it: then the router knows what is listened to.
    ask(&ears, "fleet/node/left/state", None).await;
    let large = vec![b' '; 1 << 20];
    for (session, key) in [
        (&bob, "fleet/node/*/stop"),
        (&bob, "**/node/left/stop"),
        (&alice, "fleet/node/left/release"),
        (&alice, "fleet/node/left/speed"),
        (&alice, "fleet/node/left/script/x"),
        (&left, "fleet/node/left/status"),
        (&left, "fleet/node/left/ack"),
        (&left, "fleet/node/left/report"),
        (&left, "fleet/node/left/data/x"),
        (&left, "fleet/node/left/log"),
    ] {
        put(session, key, large.clone()).await;
        // The same key with little in it: the large one has been passed over.
        put(session, key, "little").await;
        loop {
            let sample = in_time(heard.recv_async()).await.expect("a message");
            let bytes = sample.payload().len();
            assert!(bytes < large.len(), "{key} of {bytes} bytes");
            if sample.key_expr().as_str() == key {
                break;
            }
        }
    }
    in_time(plant.service.shutdown())
        .await
        .expect("a clean end");
}
