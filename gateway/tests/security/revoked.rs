//! Who was revoked, at the gateway's next start.

use crate::plant::{PATIENCE, Plant, ask, in_time, job, name, session, until};
use emulator::wall;
use gateway::{
    bus::limits::ClientLimits,
    fleet::commands_of,
    security::{
        Home, Role,
        home::read_secret,
        signing::{Signer, root_of, statement},
    },
};
use keys::{Status, job::JobRequest, version};
use serde_json::Value;
use zenoh::Session;

/// The job, signed for the life of `left` that its next status names.
async fn signed(operator: &Session, key: &Signer, id: &str) -> Value {
    let statuses = in_time(operator.declare_subscriber("fleet/node/left/status")).await;
    let status = in_time(statuses.expect("declared").recv_async()).await;
    let payload = status.expect("a status").payload().to_bytes().into_owned();
    let status: Status = version::decode(&payload).expect("a status");
    let mut job = job(id);
    let request = JobRequest::from_json(job.to_string().as_bytes()).expect("legal");
    let root = root_of(&commands_of(&request), None).expect("short");
    let (node, id) = (name("left"), request.id.expect("it has one"));
    let signature = key.sign(&statement(&node, &id, status.queue.boot, 1, root));
    job["signature"] = serde_json::to_value(&signature).expect("JSON");
    job
}

/// Asks with a job and returns the refusal's code and words, if it is one.
async fn refusal(operator: &Session, job: &Value) -> Option<(String, String)> {
    let answers = ask(operator, "fleet/node/left/job", Some(job)).await;
    let error = answers.into_iter().next()?.err()?.error;
    Some((error.code.as_str().to_owned(), error.message))
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn who_was_revoked_is_refused_from_the_next_start_and_without_a_key_nothing_is_taken() {
    let folder = tempfile::tempdir().expect("a folder");
    let mut home = Home::init(&folder.path().join("home"), &[]).expect("made");
    for (user, role) in [
        ("alice", Role::Operator),
        ("bob", Role::Viewer),
        ("left", Role::Node),
    ] {
        home.add(name(user), role).expect("added");
    }
    let key = home.add_signer(name("alice")).expect("made");
    let key = Signer::parse(&read_secret(&key).expect("private")).expect("a key");
    let mut plant = Plant::start(folder, home, ClientLimits::default()).await;
    let bobs = plant.credentials("bob");
    let bob = plant.session("bob").await;
    in_time(bob.close()).await.expect("closed");

    let restarted = plant.begun_anew(|home| {
        home.revoke(&name("bob")).expect("revoked");
        home.revoke_signer(&name("alice")).expect("revoked");
    });
    plant = restarted.await;
    let refused = tokio::time::timeout(PATIENCE, session(plant.tls(), Some(&bobs))).await;
    assert!(refused.expect("in time").is_err(), "he was revoked");
    let left = wall::spawn(plant.emulator("left")).expect("spawned");
    let alice = plant.session("alice").await;
    until(&alice, "left", |record| record.alive).await;
    for job in [job("unsigned"), signed(&alice, &key, "signed").await] {
        let (code, words) = refusal(&alice, &job).await.expect("a refusal");
        assert_eq!(code, "not_allowed", "{words}");
    }
    in_time(left.shutdown()).await;

    let restarted = plant.begun_anew(|home| {
        home.sign_no_more().expect("told");
    });
    plant = restarted.await;
    let left = wall::spawn(plant.emulator("left")).expect("spawned");
    let alice = plant.session("alice").await;
    until(&alice, "left", |record| record.alive).await;
    assert_eq!(refusal(&alice, &job("unsigned-again")).await, None);
    in_time(left.shutdown()).await;
    in_time(plant.service.shutdown())
        .await
        .expect("a clean end");
}
