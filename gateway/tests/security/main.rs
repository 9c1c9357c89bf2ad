//! Attempts on a secured fleet: each a real session with real credentials that asks for more than
//! its role may have.
//!
//! What is denied has no answer, so nothing waits for one: after each attempt the same session, or
//! the operator's, does something that is allowed, and when that has come to pass the attempt has
//! been passed over.

mod limits;
mod modes;
mod plant;
mod revoked;
mod stops;

use emulator::wall;
use gateway::{
    bus::limits::ClientLimits,
    fleet::commands_of,
    journal::{
        Journal,
        copy::{CopyFile, Piece},
    },
    security::{
        Home, Role,
        home::read_secret,
        signing::{Signer, root_of, statement},
    },
};
use keys::{
    BatchAck, BatchReader, Order, Refusal, Status, Verdict,
    batch::{BatchWriter, ORDER_BYTES_MAX},
    credentials::Credentials,
    epoch,
    job::JobRequest,
    record::{JobRecord, NodeRecord, NodeWord},
    signed::{PROOF_BYTES_MAX, Proof},
    version,
};
use plant::{PATIENCE, Plant, ask, in_time, job, job_exists, name, put, session, until};
use serde_json::{Value, json};
use zenoh::{Session, query::ConsolidationMode};

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn an_operator_works_over_tls_with_a_node_that_has_its_own_password() {
    let plant = Plant::new().await;
    let left = plant.node("left");
    let alice = plant.session("alice").await;
    until(&alice, "left", |record| {
        record.alive && record.clock.is_some()
    })
    .await;
    let follow = in_time(alice.declare_subscriber("fleet/job/*")).await;
    let follow = follow.expect("declared");
    let receipt = ask(&alice, "fleet/node/left/job", Some(&job("one"))).await;
    assert!(receipt[0].is_ok(), "{receipt:?}");
    loop {
        let sample = in_time(follow.recv_async()).await.expect("a record");
        let record: JobRecord =
            serde_json::from_slice(&sample.payload().to_bytes()).expect("a job record");
        if record.state.is_final() {
            assert_eq!(record.state.as_str(), "succeeded", "{record:?}");
            break;
        }
    }
    // A stored script is put, read, and called.
    let key = "fleet/node/left/script/far";
    let text = "motor.queue_move(0, 200, 10) node.publish('x', 1) return (...).by";
    put(&alice, key, text).await;
    loop {
        let replies = in_time(alice.get(key).timeout(PATIENCE))
            .await
            .expect("asked");
        let reply = in_time(replies.recv_async()).await.ok();
        if reply.is_some_and(|reply| reply.result().is_ok()) {
            break;
        }
    }
    let data = in_time(alice.declare_subscriber("fleet/node/*/data/**")).await;
    let data = data.expect("declared");
    let call = json!({"id": "two", "call": "far", "args": {"by": 7}});
    let receipt = ask(&alice, "fleet/node/left/job", Some(&call)).await;
    assert!(receipt[0].is_ok(), "{receipt:?}");
    loop {
        let sample = in_time(follow.recv_async()).await.expect("a record");
        let record: JobRecord =
            serde_json::from_slice(&sample.payload().to_bytes()).expect("a job record");
        if record.job.as_str() == "two" && record.state.is_final() {
            assert_eq!(record.state.as_str(), "succeeded", "{record:?}");
            let result = record.result.as_ref().expect("a result");
            assert_eq!(result.returned, Some(json!(7)), "{record:?}");
            break;
        }
    }
    let sample = in_time(data.recv_async()).await.expect("data");
    assert_eq!(sample.key_expr().as_str(), "fleet/node/left/data/x");
    in_time(left.shutdown()).await;
    in_time(plant.service.shutdown())
        .await
        .expect("a clean end");
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn nobody_gets_in_without_the_right_password_or_with_another_authority() {
    let plant = Plant::new().await;
    let alice = plant.credentials("alice");
    let wrong = Credentials {
        password: "wrong".into(),
        ..alice.clone()
    };
    let nobody = Credentials {
        user: "nobody".into(),
        ..alice.clone()
    };
    let other = tempfile::tempdir().expect("a folder");
    let mut other = Home::init(other.path(), &[]).expect("made");
    other.add(name("alice"), Role::Operator).expect("added");
    let foreign = Credentials {
        ca: other.gateway().ca,
        ..alice.clone()
    };
    for to in [plant.tls(), plant.tcp()] {
        assert!(in_time(session(to, None)).await.is_err(), "{to}: no user");
        assert!(in_time(session(to, Some(&wrong))).await.is_err(), "{to}");
        assert!(in_time(session(to, Some(&nobody))).await.is_err(), "{to}");
    }
    // Whoever poses as the router has no certificate of this fleet's.
    let refused = in_time(session(plant.tls(), Some(&foreign))).await;
    assert!(refused.is_err(), "another authority");
    assert!(in_time(session(plant.tls(), Some(&alice))).await.is_ok());
    in_time(plant.service.shutdown())
        .await
        .expect("a clean end");
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_viewer_looks_on_and_stops_and_can_do_nothing_else() {
    let plant = Plant::new().await;
    let left = plant.node("left");
    let alice = plant.session("alice").await;
    let bob = plant.session("bob").await;
    until(&bob, "left", |record| record.alive).await;
    let travels = ask(&bob, "fleet/manage/link/left", None).await;
    assert!(travels.iter().any(Result::is_ok), "{travels:?}");
    // The node itself says how it is set, but not what its password is.
    let setup = ask(&bob, "fleet/node/*/setup", None).await;
    let setup = setup[0].as_ref().expect("a viewer may");
    assert_eq!(setup["link"]["user"], json!("left"));
    let password = &plant.credentials("left").password;
    assert!(!setup.to_string().contains(password.as_str()));
    put(&bob, "fleet/node/left/job", job("bobs").to_string()).await;
    put(&bob, "fleet/group/g/job", "{}").await;
    put(&bob, "fleet/node/left/speed", "{\"percent\":50}").await;
    put(&bob, "fleet/node/left/hold", "").await;
    let jog = json!({"axis": 0, "by": 1, "speed_hz": 500, "accel": 2_000});
    let get = bob
        .get("fleet/node/left/jog")
        .payload(jog.to_string())
        .timeout(PATIENCE);
    let his_jog = in_time(get).await.expect("asked");
    put(&bob, "fleet/node/left/stop", "").await;
    until(&bob, "left", |record| record.stopped.is_some()).await;
    assert!(!job_exists(&alice, "bobs").await);
    // His release is behind his stop; the operator's record shows that it did nothing.
    put(&bob, "fleet/node/left/release", "").await;
    put(&bob, "fleet/node/left/stop", "").await;
    let refused = ask(&alice, "fleet/node/left/job", Some(&job("refused"))).await;
    let error = refused[0].as_ref().expect_err("the latch is set");
    assert_eq!(error.error.code.as_str(), "stopped");
    let released = ask(&alice, "fleet/node/left/release", None).await;
    assert!(released[0].is_ok(), "{released:?}");
    let record = until(&alice, "left", |record| record.stopped.is_none()).await;
    assert_eq!(
        record.pace, None,
        "a speed survives a stop: his was never heard"
    );
    // The node counts them: his was none.
    let jogged = ask(&alice, "fleet/node/left/jog", Some(&jog)).await;
    let jogged = jogged[0].as_ref().expect("an operator may");
    assert_eq!(
        (&jogged["jog"], &jogged["position"]),
        (&json!(1), &json!(0))
    );
    while let Ok(Some(reply)) = his_jog.try_recv() {
        assert!(reply.result().is_err(), "somebody has taken it");
    }
    let at_rest =
        |record: &NodeRecord| record.state == NodeWord::Idle && record.position.first() == Some(&1);
    until(&alice, "left", at_rest).await;
    for (word, hold) in [("hold", true), ("resume", false)] {
        let key = format!("fleet/node/left/{word}");
        let answers = ask(&alice, &key, None).await;
        assert!(answers[0].is_ok(), "{answers:?}");
        until(&alice, "left", |record| {
            record.pace.is_some_and(|pace| pace.hold) == hold
        })
        .await;
    }
    in_time(left.shutdown()).await;
    in_time(plant.service.shutdown())
        .await
        .expect("a clean end");
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_node_cannot_speak_as_another_nor_forge_a_record_nor_move_anybody() {
    let plant = Plant::new().await;
    let alice = plant.session("alice").await;
    let left = plant.session("left").await;
    let follow = in_time(alice.declare_subscriber("fleet/job/*")).await;
    let follow = follow.expect("declared");
    let bytes = stops::idle_status();
    put(&left, "fleet/node/right/status", bytes.clone()).await;
    let vitals = in_time(alice.declare_subscriber("fleet/node/*/vitals")).await;
    let vitals = vitals.expect("declared");
    // An answer comes behind it: then the router knows what she wants to hear.
    let _ = ask(&alice, "fleet/node/right/state", None).await;
    put(&left, "fleet/node/right/vitals", "not its own").await;
    let _token = in_time(left.liveliness().declare_token("fleet/node/right/alive")).await;
    put(&left, "fleet/node/left/job", job("lefts").to_string()).await;
    put(
        &left,
        "fleet/job/forged",
        json!({"job": "forged"}).to_string(),
    )
    .await;
    put(&left, "fleet/node/right/stop", "").await;
    // What it may say comes last, and through the same link.
    let _own = in_time(left.liveliness().declare_token("fleet/node/left/alive")).await;
    put(&left, "fleet/node/left/vitals", "its own").await;
    put(&left, "fleet/node/left/status", bytes).await;
    until(&alice, "left", |record| {
        record.alive && record.firmware == "0.1.0"
    })
    .await;

    let sample = in_time(vitals.recv_async()).await.expect("vitals");
    assert_eq!(sample.key_expr().as_str(), "fleet/node/left/vitals");
    assert!(vitals.try_recv().expect("open").is_none());
    let right = ask(&alice, "fleet/node/right/state", None).await;
    assert!(right.iter().all(Result::is_err), "{right:?}");
    assert!(!job_exists(&alice, "lefts").await);
    // An allowed job is the first that the operator hears of.
    let receipt = ask(&alice, "fleet/node/left/job", Some(&job("first"))).await;
    assert!(receipt[0].is_ok(), "{receipt:?}");
    let sample = in_time(follow.recv_async()).await.expect("a record");
    assert_eq!(sample.key_expr().as_str(), "fleet/job/first");
    in_time(plant.service.shutdown())
        .await
        .expect("a clean end");
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_client_that_floods_is_refused_and_another_one_gets_its_turn() {
    let limits = ClientLimits {
        requests_per_s: 1,
        ..ClientLimits::default()
    };
    let plant = Plant::with(limits).await;
    let (alice, carol) = (plant.session("alice").await, plant.session("carol").await);
    // Twice what may come at once, by put and by get; each get is answered one way or the other.
    for index in 0..10 {
        put(&alice, "fleet/job/none/cancel", format!("{index}")).await;
    }
    let mut refused = 0;
    for _ in 0..10 {
        for answer in ask(&alice, "fleet/job/none", None).await {
            let error = answer.expect_err("there is no such job").error;
            match error.code.as_str() {
                "not_allowed" => refused += 1,
                _ => assert!(error.message.contains("none"), "{error:?}"),
            }
        }
    }
    assert!(refused > 0, "20 requests came through, 10 may");
    // A put that is refused leaves one record, not one for each.
    let follow = in_time(carol.declare_subscriber("fleet/job/*")).await;
    let follow = follow.expect("declared");
    for index in 0..20 {
        let job = job(&format!("flood-{index}")).to_string();
        put(&alice, "fleet/node/left/job", job).await;
    }
    ask(&alice, "fleet/job/none", None).await;
    let answer = ask(&carol, "fleet/node/nobody/job", Some(&job("carols"))).await;
    let error = answer[0].as_ref().expect_err("there is no such node");
    assert_eq!(
        error.error.code.as_str(),
        "unknown_node",
        "her own limit is untouched"
    );
    in_time(plant.service.shutdown())
        .await
        .expect("a clean end");
    let mut records = 0;
    while let Ok(Some(sample)) = follow.try_recv() {
        let record: JobRecord =
            serde_json::from_slice(&sample.payload().to_bytes()).expect("a job record");
        assert_eq!(record.state.as_str(), "rejected");
        records += 1;
    }
    assert!(records < 20, "{records} records of 20 puts");
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_job_that_is_too_large_is_refused_and_the_client_may_go_on() {
    let plant = Plant::new().await;
    let alice = plant.session("alice").await;
    let large = Value::from("x".repeat(keys::job::JOB_BYTES_MAX));
    let answer = ask(&alice, "fleet/node/left/job", Some(&large)).await;
    let error = answer[0].as_ref().expect_err("it is too large");
    assert_eq!(error.error.code.as_str(), "too_large");
    let answer = ask(&alice, "fleet/node/left/job", Some(&job("small"))).await;
    let error = answer[0].as_ref().expect_err("there is no such node");
    // Her bytes are used up for now, or there was time enough.
    let code = error.error.code.as_str();
    assert!(["not_allowed", "unknown_node"].contains(&code), "{code}");
    in_time(plant.service.shutdown())
        .await
        .expect("a clean end");
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn an_operator_gets_a_backup_of_a_running_gateway_and_nobody_else_does() {
    let plant = Plant::new().await;
    let left = plant.node("left");
    let alice = plant.session("alice").await;
    until(&alice, "left", |record| record.alive).await;
    let receipt = ask(&alice, "fleet/node/left/job", Some(&job("one"))).await;
    assert!(receipt[0].is_ok(), "{receipt:?}");
    let begin = async |session: &Session| {
        let get = session
            .get("fleet/store/backup")
            .consolidation(ConsolidationMode::None)
            .timeout(PATIENCE);
        in_time(get).await.expect("asked")
    };
    let (bob, right) = (plant.session("bob").await, plant.session("right").await);
    let denied = [begin(&bob).await, begin(&right).await];
    // Behind his question: it has been passed over.
    ask(&bob, "fleet/node/left/state", None).await;
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("backup.redb");
    let mut file = CopyFile::create(&path).expect("created");
    let replies = begin(&alice).await;
    while let Ok(reply) = in_time(replies.recv_async()).await {
        let sample = reply.result().expect("a piece");
        let piece = Piece::decode(&sample.payload().to_bytes()).expect("a piece");
        file.take(piece).expect("the next one");
    }
    // One backup is given at a time: theirs would have come before hers.
    for replies in denied {
        while let Ok(Some(reply)) = replies.try_recv() {
            assert!(reply.result().is_err(), "somebody got it");
        }
    }
    file.finish().expect("whole");
    let (_journal, stored) = Journal::open(&path).expect("a store");
    assert!(stored.jobs.iter().any(|(name, _)| name == "one"));
    in_time(left.shutdown()).await;
    in_time(plant.service.shutdown())
        .await
        .expect("a clean end");
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn what_an_operator_signed_is_executed_once_even_if_the_router_belongs_to_somebody_else() {
    let folder = tempfile::tempdir().expect("a folder");
    let home = folder.path().join("home");
    let mut made = Home::init(&home, &[]).expect("made");
    for (user, role) in [("alice", Role::Operator), ("left", Role::Node)] {
        made.add(name(user), role).expect("added");
    }
    let key = made.add_signer(name("alice")).expect("made");
    let key = Signer::parse(&read_secret(&key).expect("private")).expect("a key");
    let signers = made.signers().expect("a list");
    let plant = Plant::start(folder, made, ClientLimits::default()).await;
    let mut config = plant.emulator("left");
    config.signers.push(signers[0].key.0).expect("room");
    let left = wall::spawn(config).expect("spawned");
    let alice = plant.session("alice").await;
    // Whoever has the router has its rights.
    let mallory = plant.session("gateway").await;
    let orders = in_time(mallory.declare_subscriber("fleet/node/left/batch")).await;
    let orders = orders.expect("declared");
    let acks = in_time(mallory.declare_subscriber("fleet/node/left/ack")).await;
    let acks = acks.expect("declared");
    let statuses = in_time(alice.declare_subscriber("fleet/node/left/status")).await;
    let statuses = statuses.expect("declared");
    until(&alice, "left", |record| {
        record.alive && record.clock.is_some()
    })
    .await;
    let status = in_time(statuses.recv_async()).await.expect("a status");
    let status: Status = version::decode(&status.payload().to_bytes()).expect("a status");
    let boot = status.queue.boot;

    let unsigned = ask(&alice, "fleet/node/left/job", Some(&job("unsigned"))).await;
    let error = unsigned[0].as_ref().expect_err("it is not signed");
    assert_eq!(error.error.code.as_str(), "not_allowed");
    let mut signed = job("signed");
    let request = JobRequest::from_json(signed.to_string().as_bytes()).expect("legal");
    let root = root_of(&commands_of(&request), None).expect("short");
    let node = name("left");
    let id = request.id.expect("it has one");
    let signature = key.sign(&statement(&node, &id, boot, 1, root));
    let mut stolen = job("stolen");
    stolen["signature"] = serde_json::to_value(&signature).expect("JSON");
    let refused = ask(&alice, "fleet/node/left/job", Some(&stolen)).await;
    let error = refused[0].as_ref().expect_err("it is another job's");
    assert_eq!(error.error.code.as_str(), "not_allowed");

    let follow = in_time(alice.declare_subscriber("fleet/job/signed")).await;
    let follow = follow.expect("declared");
    signed["signature"] = serde_json::to_value(&signature).expect("JSON");
    let receipt = ask(&alice, "fleet/node/left/job", Some(&signed)).await;
    assert!(receipt[0].is_ok(), "{receipt:?}");
    loop {
        let sample = in_time(follow.recv_async()).await.expect("a record");
        let record: JobRecord =
            serde_json::from_slice(&sample.payload().to_bytes()).expect("a job record");
        if record.state.is_final() {
            assert_eq!(record.state.as_str(), "succeeded", "{record:?}");
            assert_eq!(record.result.expect("it moved").position[0], 20);
            break;
        }
    }

    // The order once more, at the place that is next now.
    let order = in_time(orders.recv_async()).await.expect("an order");
    let order = order.payload().to_bytes().into_owned();
    let (epoch, order) = epoch::split(&order).expect("an order");
    let (proof, plain) = Proof::split(order).expect("an order");
    let mut proof = proof.expect("it is signed");
    let mut reader = BatchReader::new(plain).expect("a batch");
    let Order::Batch(mut header) = *reader.order() else {
        panic!("no batch")
    };
    let mut writer = BatchWriter::new();
    while let Some(command) = reader.next_command().expect("a command") {
        assert!(writer.push(&command));
    }
    header.first_command = header.job_end;
    header.job_end += u64::from(header.command_count);
    proof.first_command = header.first_command;
    let mut buffer = [0; ORDER_BYTES_MAX];
    let plain = writer.finish(header, &mut buffer).expect("room");
    let mut replay = vec![0; PROOF_BYTES_MAX];
    let used = proof.write(&mut replay).expect("room");
    replay.truncate(used);
    replay.extend_from_slice(plain);
    // She can say whatever epoch she has heard.
    let mark = epoch::mark(epoch);
    for attempt in [replay.as_slice(), plain] {
        let attempt = [mark.as_slice(), attempt].concat();
        put(&mallory, "fleet/node/left/batch", attempt).await;
        loop {
            let ack = in_time(acks.recv_async()).await.expect("an answer");
            let ack: BatchAck = version::decode(&ack.payload().to_bytes()).expect("an ack");
            assert_eq!(ack.accepted_commands, 1);
            if ack.verdict == Verdict::Refused(Refusal::NotSigned) {
                break;
            }
        }
    }
    let record = until(&alice, "left", |record| record.job.is_none()).await;
    assert_eq!(record.position[0], 20, "it moved once");
    in_time(left.shutdown()).await;
    in_time(plant.service.shutdown())
        .await
        .expect("a clean end");
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_person_who_comes_without_tls_is_told_nothing() {
    let plant = Plant::new().await;
    let alice = plant.session("alice").await;
    let plain = in_time(session(plant.tcp(), Some(&plant.credentials("alice")))).await;
    let plain = plain.expect("the password is right");
    put(&plain, "fleet/node/left/job", job("plain").to_string()).await;
    in_time(plain.close()).await.expect("closed");
    // The plain session has ended, so what it said has been passed over.
    assert!(!job_exists(&alice, "plain").await);
    in_time(plant.service.shutdown())
        .await
        .expect("a clean end");
}
