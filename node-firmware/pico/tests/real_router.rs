//! The client against the router of the zenoh crate, on real sockets.

mod router;

use pico::{
    CloseReason, Congestion, Credentials, Encoding, Event, GetOptions, KeyRef, PeerReason,
    Priority, PutOptions, SampleKind, SessionConfig,
};
use router::{Client, Target, open_client, open_router, open_router_with, patient_get, patiently};
use zenoh::{qos::CongestionControl, sample::SampleKind as RustKind};

type Test = Result<(), Box<dyn std::error::Error + Send + Sync>>;

fn block() -> PutOptions {
    PutOptions {
        congestion: Congestion::Block,
        ..PutOptions::default()
    }
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn values_go_both_ways_with_everything_pinned_to_them() -> Test {
    for qos in [true, false] {
        let (router, address) = open_router().await;
        let mut client = Client::open(
            address,
            SessionConfig {
                qos,
                ..SessionConfig::default()
            },
        )
        .await;
        let subscriber = client
            .with(|session, _| session.declare_subscriber("fleet/node/left/*"))
            .await?;
        let theirs = router.declare_subscriber("fleet/node/*/status").await?;

        let publisher = client
            .with(|session, _| session.declare_publisher("fleet/node/left/status"))
            .await?;
        assert_eq!(
            client.event().await,
            Event::Wanted {
                publisher,
                wanted: true
            }
        );
        let options = PutOptions {
            encoding: Encoding {
                id: 5,
                schema: Some(b"utf-8".to_vec()),
            },
            attachment: Some(b"pinned".to_vec()),
            priority: Priority::InteractiveHigh,
            congestion: Congestion::Block,
            express: true,
            timestamp: None,
        };
        client
            .with(move |session, _| {
                session.put(KeyRef::Publisher(publisher), b"all well", &options)?;
                session.delete("fleet/node/left/status", &block())
            })
            .await?;
        let sample = patiently(theirs.recv_async()).await?;
        assert_eq!(sample.key_expr().as_str(), "fleet/node/left/status");
        assert_eq!(&*sample.payload().to_bytes(), b"all well");
        assert_eq!(sample.encoding().to_string(), "application/json;utf-8");
        assert_eq!(&*sample.attachment().unwrap().to_bytes(), b"pinned");
        assert_eq!(sample.priority(), zenoh::qos::Priority::InteractiveHigh);
        assert!(sample.express());
        let sample = patiently(theirs.recv_async()).await?;
        assert_eq!(sample.kind(), RustKind::Delete);

        // A wild key reaches the narrow subscriber and is told as it was sent.
        router
            .put("fleet/node/*/stop", "now")
            .attachment("why")
            .encoding("text/plain;utf-8")
            .congestion_control(CongestionControl::Block)
            .priority(zenoh::qos::Priority::RealTime)
            .await?;
        let Event::Message {
            subscriber: whose,
            sample,
        } = client.event().await
        else {
            panic!("a message")
        };
        assert_eq!(whose, subscriber);
        assert_eq!(sample.key, "fleet/node/*/stop");
        assert_eq!(sample.payload, b"now");
        assert_eq!(sample.kind, SampleKind::Put);
        assert_eq!(sample.attachment.as_deref(), Some(&b"why"[..]));
        assert_eq!(sample.encoding.schema.as_deref(), Some(&b"utf-8"[..]));
        assert_eq!(sample.priority, Priority::RealTime);
        assert_eq!(sample.congestion, Congestion::Block);

        let events = client.quit().await;
        assert_eq!(
            events,
            [Event::Closed {
                reason: CloseReason::Local
            }]
        );
        router.close().await?;
    }
    Ok(())
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_hundred_kilobytes_go_both_ways_in_fragments() -> Test {
    for qos in [true, false] {
        let (router, address) = open_router().await;
        let config = SessionConfig {
            qos,
            queue_bytes: 256 * 1024,
            fragment_bytes_max: 128 * 1024,
            ..SessionConfig::default()
        };
        let mut client = Client::open(address, config).await;
        client
            .with(|session, _| session.declare_subscriber("down"))
            .await?;
        let theirs = router.declare_subscriber("up").await?;
        let publisher = client
            .with(|session, _| session.declare_publisher("up"))
            .await?;
        assert_eq!(
            client.event().await,
            Event::Wanted {
                publisher,
                wanted: true
            }
        );
        let payload: Vec<u8> = (0..100_000u32)
            .map(|i| (i.wrapping_mul(i) >> 3) as u8)
            .collect();
        for _ in 0..3 {
            let sent = payload.clone();
            client
                .with(move |session, _| session.put(publisher, &sent, &block()))
                .await?;
            let sample = patiently(theirs.recv_async()).await?;
            assert_eq!(*sample.payload().to_bytes(), payload);
            router
                .put("down", &payload)
                .congestion_control(CongestionControl::Block)
                .await?;
            let Event::Message { sample, .. } = client.event().await else {
                panic!("a message")
            };
            assert_eq!(sample.payload, payload);
        }
        let counters = client.with(|session, _| session.counters()).await;
        assert_eq!(
            (counters.gaps, counters.stale, counters.reassembly_drops),
            (0, 0, 0)
        );
        client.quit().await;
        router.close().await?;
    }
    Ok(())
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn three_thousand_messages_come_in_order_both_ways() -> Test {
    let (router, address) = open_router().await;
    let other = open_client(address).await;
    let mut client = Client::open(address, SessionConfig::default()).await;
    client
        .with(|session, _| session.declare_subscriber("down"))
        .await?;
    // Room for all: a full one would hold up a thread that all sessions here share.
    let theirs = other
        .declare_subscriber("up")
        .with(zenoh::handlers::FifoChannel::new(3000))
        .await?;
    let publisher = client
        .with(|session, _| session.declare_publisher("up"))
        .await?;
    while client.event().await
        != (Event::Wanted {
            publisher,
            wanted: true,
        })
    {}
    let sending = tokio::spawn(async move {
        let publisher = other
            .declare_publisher("down")
            .congestion_control(CongestionControl::Block)
            .await?;
        for index in 0..3000u32 {
            publisher.put(index.to_le_bytes()).await?;
        }
        drop(publisher);
        Test::Ok(()).map(|()| other)
    });
    let mut sent = 0u32;
    let mut received = 0u32;
    while sent < 3000 || received < 3000 {
        if sent < 3000 {
            sent = client
                .with(move |session, _| {
                    let mut sent = sent;
                    while sent < 3000
                        && session
                            .put(publisher, &sent.to_le_bytes(), &block())
                            .is_ok()
                    {
                        sent += 1;
                    }
                    sent
                })
                .await;
        }
        if received < 3000 {
            let Event::Message { sample, .. } = client.event().await else {
                panic!("a message")
            };
            assert_eq!(sample.payload, received.to_le_bytes());
            received += 1;
        }
    }
    for index in 0..3000u32 {
        assert_eq!(
            *patiently(theirs.recv_async()).await?.payload().to_bytes(),
            index.to_le_bytes()
        );
    }
    patiently(sending).await??;
    client.quit().await;
    router.close().await?;
    Ok(())
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn questions_of_ours_are_answered() -> Test {
    let (router, address) = open_router().await;
    let _good = router
        .declare_queryable("shelf/book")
        .callback(|query| {
            use zenoh::Wait;
            let question = query
                .payload()
                .unwrap()
                .try_to_string()
                .unwrap()
                .into_owned();
            let answer = format!("{}?{question}", query.parameters());
            query.reply("shelf/book", answer).wait().unwrap();
        })
        .await?;
    let _bad = router
        .declare_queryable("shelf/lamp")
        .callback(|query| {
            use zenoh::Wait;
            query.reply_err("no lamp").wait().unwrap();
        })
        .await?;
    let mut client = Client::open(address, SessionConfig::default()).await;
    let ask = |key: &'static str, target| {
        client.with(move |session, now_us| {
            let options = GetOptions {
                target,
                ..patient_get()
            };
            session.get(key, "page=3", Some(b"who"), &options, now_us)
        })
    };
    let book = ask("shelf/book", pico::QueryTarget::BestMatching).await?;
    let lamp = ask("shelf/lamp", pico::QueryTarget::All).await?;
    let nobody = ask("shelf/cat", pico::QueryTarget::All).await?;
    let mut finals = 0;
    let (mut replies, mut errors) = (Vec::new(), Vec::new());
    while finals < 3 {
        match client.event().await {
            Event::Reply { query, sample } => {
                replies.push((query, sample.key.to_string(), sample.payload))
            }
            Event::ReplyError { query, payload, .. } => errors.push((query, payload)),
            Event::ReplyFinal { query, timed_out } => {
                assert!([book, lamp, nobody].contains(&query));
                assert!(!timed_out);
                finals += 1;
            }
            other => panic!("{other:?}"),
        }
    }
    assert_eq!(
        replies,
        [(book, "shelf/book".to_string(), b"page=3?who".to_vec())]
    );
    assert_eq!(errors, [(lamp, b"no lamp".to_vec())]);
    client.quit().await;
    router.close().await?;
    Ok(())
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn questions_of_others_are_answered() -> Test {
    let (router, address) = open_router().await;
    let other = open_client(address).await;
    let mut client = Client::open(address, SessionConfig::default()).await;
    let queryable = client
        .with(|session, _| session.declare_queryable("node/left/*", false))
        .await?;
    client.settled().await;

    let replies = other
        .get("node/left/position?unit=steps")
        .payload("please")
        .attachment("pin")
        .target(zenoh::query::QueryTarget::All)
        .await?;
    let Event::Query {
        query,
        queryable: whose,
        key,
        parameters,
        payload,
        attachment,
        ..
    } = client.event().await
    else {
        panic!("a query")
    };
    assert_eq!(whose, queryable);
    assert_eq!(
        (key.as_str(), parameters.as_str()),
        ("node/left/position", "unit=steps")
    );
    assert_eq!(payload.as_deref(), Some(&b"please"[..]));
    assert_eq!(attachment.as_deref(), Some(&b"pin"[..]));
    client
        .with(move |session, _| {
            let options = PutOptions {
                encoding: Encoding {
                    id: 1,
                    schema: None,
                },
                attachment: Some(b"back".to_vec()),
                ..PutOptions::default()
            };
            session.reply(&query, "node/left/position", b"42", &options)?;
            session.reply_error(&query, b"and no more", &Encoding::default())?;
            session.reply_final(&query)
        })
        .await?;
    let (mut good, mut bad) = (Vec::new(), Vec::new());
    while let Ok(reply) = patiently(replies.recv_async()).await {
        match reply.into_result() {
            Ok(sample) => {
                assert_eq!(&*sample.attachment().unwrap().to_bytes(), b"back");
                assert_eq!(sample.encoding().to_string(), "zenoh/string");
                good.push(sample.payload().to_bytes().into_owned());
            }
            Err(error) => bad.push(error.payload().to_bytes().into_owned()),
        }
    }
    assert_eq!(good, [b"42".to_vec()]);
    assert_eq!(bad, [b"and no more".to_vec()]);
    let again = client
        .with(move |session, _| session.reply_final(&query))
        .await;
    assert_eq!(again, Err(pico::ReplyError::Unknown));
    client.quit().await;
    router.close().await?;
    Ok(())
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn liveliness_is_told_both_ways() -> Test {
    let (router, address) = open_router().await;
    let before = router.liveliness().declare_token("alive/before").await?;
    let mut client = Client::open(address, SessionConfig::default()).await;
    let subscriber = client
        .with(|session, _| session.declare_liveliness_subscriber("alive/**"))
        .await?;
    let told = |key: &str, alive| Event::Liveliness {
        subscriber,
        key: key.to_string(),
        alive,
    };
    assert_eq!(client.event().await, told("alive/before", true));
    let after = router.liveliness().declare_token("alive/after").await?;
    assert_eq!(client.event().await, told("alive/after", true));
    before.undeclare().await?;
    assert_eq!(client.event().await, told("alive/before", false));

    let theirs = router
        .liveliness()
        .declare_subscriber("alive/node/*")
        .await?;
    let token = client
        .with(|session, _| session.declare_token("alive/node/left"))
        .await?;
    // A router may say more than once that a token is there.
    let told = async |key: &str, kind| -> Test {
        loop {
            let sample = patiently(theirs.recv_async()).await?;
            if (sample.key_expr().as_str(), sample.kind()) == (key, kind) {
                return Ok(());
            }
            assert_eq!(sample.kind(), RustKind::Put, "{}", sample.key_expr());
        }
    };
    told("alive/node/left", RustKind::Put).await?;
    client
        .with(move |session, _| session.undeclare_token(token))
        .await?;
    told("alive/node/left", RustKind::Delete).await?;
    client
        .with(|session, _| session.declare_token("alive/node/right"))
        .await?;
    told("alive/node/right", RustKind::Put).await?;
    // A token ends with its session.
    client.quit().await;
    told("alive/node/right", RustKind::Delete).await?;
    drop(after);
    router.close().await?;
    Ok(())
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_publisher_hears_whether_anybody_wants_its_data() -> Test {
    let (router, address) = open_router().await;
    let mut client = Client::open(address, SessionConfig::default()).await;
    let publisher = client
        .with(|session, _| session.declare_publisher("status/left"))
        .await?;
    assert_eq!(
        client.event().await,
        Event::Wanted {
            publisher,
            wanted: false
        }
    );
    assert!(
        !client
            .with(move |session, _| session.is_wanted(publisher))
            .await
    );
    let theirs = router.declare_subscriber("status/*").await?;
    assert_eq!(
        client.event().await,
        Event::Wanted {
            publisher,
            wanted: true
        }
    );
    assert!(
        client
            .with(move |session, _| session.is_wanted(publisher))
            .await
    );
    theirs.undeclare().await?;
    assert_eq!(
        client.event().await,
        Event::Wanted {
            publisher,
            wanted: false
        }
    );
    client
        .with(move |session, _| session.undeclare_publisher(publisher))
        .await?;
    let gone = client
        .with(move |session, _| session.put(publisher, b"", &block()))
        .await;
    assert_eq!(gone, Err(pico::PutError::Unknown));
    client.quit().await;
    router.close().await?;
    Ok(())
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_taken_back_subscriber_hears_nothing_more() -> Test {
    let (router, address) = open_router().await;
    let mut client = Client::open(address, SessionConfig::default()).await;
    let first = client
        .with(|session, _| session.declare_subscriber("a/*"))
        .await?;
    let second = client
        .with(|session, _| session.declare_subscriber("a/**"))
        .await?;
    client.settled().await;
    router
        .put("a/b", "1")
        .congestion_control(CongestionControl::Block)
        .await?;
    for _ in 0..2 {
        assert!(matches!(client.event().await, Event::Message { .. }));
    }
    client
        .with(move |session, _| session.undeclare_subscriber(first))
        .await?;
    router
        .put("a/b", "2")
        .congestion_control(CongestionControl::Block)
        .await?;
    router
        .put("a/b", "3")
        .congestion_control(CongestionControl::Block)
        .await?;
    for payload in ["2", "3"] {
        let Event::Message { subscriber, sample } = client.event().await else {
            panic!("one")
        };
        assert_eq!(
            (subscriber, sample.payload.as_slice()),
            (second, payload.as_bytes())
        );
    }
    client.quit().await;
    router.close().await?;
    Ok(())
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn only_the_right_password_opens() -> Test {
    use std::io::Write;
    let mut users = tempfile::NamedTempFile::new()?;
    writeln!(users, "n1:secret")?;
    let path = users.path().to_str().unwrap().to_string();
    let (router, address) = open_router_with(|config| {
        let value = format!("\"{path}\"");
        config
            .insert_json5("transport/auth/usrpwd/dictionary_file", &value)
            .unwrap();
        config
            .insert_json5("transport/auth/usrpwd/user", "\"router\"")
            .unwrap();
        config
            .insert_json5("transport/auth/usrpwd/password", "\"router\"")
            .unwrap();
    })
    .await;
    let with = |credentials| SessionConfig {
        credentials,
        ..SessionConfig::default()
    };
    let credentials = |user: &str, password: &str| {
        Some(Credentials {
            user: user.to_string(),
            password: password.to_string(),
        })
    };
    for wrong in [
        None,
        credentials("n1", "wrong"),
        credentials("n2", "secret"),
    ] {
        let mut client = Client::start(Target::new(address), with(wrong));
        let refused = CloseReason::Refused(PeerReason::Generic);
        assert_eq!(client.event().await, Event::Closed { reason: refused });
        client.quit().await;
    }
    let client = Client::open(address, with(credentials("n1", "secret"))).await;
    client.quit().await;
    router.close().await?;
    Ok(())
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn after_the_router_returns_everything_is_declared_again() -> Test {
    let (router, address) = open_router().await;
    let config = SessionConfig {
        backoff_us_min: 20_000,
        backoff_us_max: 100_000,
        ..SessionConfig::default()
    };
    let target = Target::new(address);
    let mut client = Client::start(target.clone(), config);
    client.opened().await;
    let subscriber = client
        .with(|session, _| session.declare_subscriber("down"))
        .await?;
    let publisher = client
        .with(|session, _| session.declare_publisher("up"))
        .await?;
    assert_eq!(
        client.event().await,
        Event::Wanted {
            publisher,
            wanted: false
        }
    );
    // The port of a router that has gone may become somebody else's: so the client is not to knock
    // there, and the router returns wherever there is room.
    target.set(None);
    router.close().await?;
    assert!(matches!(client.event().await, Event::Closed { .. }));
    let (router, address) = open_router().await;
    let theirs = router.declare_subscriber("up").await?;
    target.set(Some(address));
    let mut wanted = false;
    while !wanted {
        // Attempts against nobody make no event.
        match client.event().await {
            Event::Opened | Event::Closed { .. } => {}
            Event::Wanted { wanted: now, .. } => wanted = now,
            other => panic!("{other:?}"),
        }
    }
    client
        .with(move |session, _| session.put(publisher, b"back", &block()))
        .await?;
    assert_eq!(
        *patiently(theirs.recv_async()).await?.payload().to_bytes(),
        b"back"[..]
    );
    router
        .put("down", "again")
        .congestion_control(CongestionControl::Block)
        .await?;
    let Event::Message {
        subscriber: whose,
        sample,
    } = client.event().await
    else {
        panic!("one")
    };
    assert_eq!(
        (whose, sample.payload.as_slice()),
        (subscriber, &b"again"[..])
    );
    let counters = client.with(|session, _| session.counters()).await;
    assert!(counters.reconnects >= 1);
    client.quit().await;
    router.close().await?;
    Ok(())
}
