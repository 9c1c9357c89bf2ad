//! The session against a scripted router in virtual time.

mod peer;

use peer::{
    Cut, Grants, Marks, Rig, SECOND_US, SN_MASK, bytes, client_key, declare_final, declare_key,
    declare_subscriber, declare_token, interest, key, peer_key, push, query, reply, reply_final,
    undeclare_subscriber, undeclare_token,
};
use pico::{
    CloseReason, Credentials, Event, GetError, GetOptions, InboundQuery, LivelinessId, PeerReason,
    Priority, PublisherId, PutError, PutOptions, QueryId, ReplyError, Sample, Session,
    SessionConfig, SessionError, SubscriberId, UndeclareError, limits,
};
use zenoh_protocol::{
    core::Priority as WirePriority,
    network::{DeclareBody, NetworkBody, interest::InterestMode},
    transport::Close,
    zenoh::{PushBody, RequestBody, ResponseBody},
};

fn messages(events: &[Event]) -> Vec<(SubscriberId, &str, &[u8])> {
    let message = |event| match event {
        &Event::Message {
            subscriber,
            sample:
                Sample {
                    ref key,
                    ref payload,
                    ..
                },
        } => Some((subscriber, key.as_str(), payload.as_slice())),
        _ => None,
    };
    events.iter().filter_map(message).collect()
}

fn put_payloads(heard: &[NetworkBody]) -> Vec<Vec<u8>> {
    let payload = |body: &NetworkBody| match body {
        NetworkBody::Push(push) => match &push.payload {
            PushBody::Put(put) => Some(put.payload.to_zslice().to_vec()),
            PushBody::Del(_) => None,
        },
        _ => None,
    };
    heard.iter().filter_map(payload).collect()
}

fn at(priority: Priority) -> PutOptions {
    PutOptions {
        priority,
        ..PutOptions::default()
    }
}

// ---- opening and ending ----

#[test]
fn the_handshake_opens_with_and_without_what_can_be_agreed() {
    for qos in [true, false] {
        for granted_qos in [true, false] {
            for patch in [0, 1] {
                for batch_bytes in [256, 2048, u16::MAX] {
                    let config = SessionConfig {
                        qos,
                        ..SessionConfig::default()
                    };
                    let grants = Grants {
                        qos: granted_qos,
                        patch,
                        batch_bytes,
                        ..Grants::default()
                    };
                    let mut rig = Rig::opened(config, grants);
                    rig.session
                        .put("a", &[7; 3000], &at(Priority::RealTime))
                        .unwrap();
                    rig.exchange().unwrap();
                    assert_eq!(put_payloads(&rig.take_heard()), [vec![7; 3000]]);
                }
            }
        }
    }
}

#[test]
fn a_grant_beyond_the_offer_is_refused() {
    for (patch, batch_bytes) in [(2, 2048), (1, 255)] {
        let grants = Grants {
            patch,
            batch_bytes,
            ..Grants::default()
        };
        let mut rig = Rig::new(SessionConfig::default(), grants);
        rig.connect();
        assert_eq!(rig.exchange(), Err(Cut));
        let reason = CloseReason::Protocol(SessionError::Handshake);
        assert_eq!(rig.take_events(), [Event::Closed { reason }]);
        assert!(!rig.session.wants_disconnect());
        assert!(!rig.session.wants_connection(rig.now_us));
    }
}

#[test]
fn the_right_password_opens_and_the_wrong_one_is_told() {
    let user = Some(("n1", "secret"));
    let credentials = |user: &str, password: &str| SessionConfig {
        credentials: Some(Credentials {
            user: user.into(),
            password: password.into(),
        }),
        ..SessionConfig::default()
    };
    Rig::opened(
        credentials("n1", "secret"),
        Grants {
            user,
            ..Grants::default()
        },
    );
    for config in [
        SessionConfig::default(),
        credentials("n1", "no"),
        credentials("n2", "secret"),
    ] {
        let mut rig = Rig::new(
            config,
            Grants {
                user,
                ..Grants::default()
            },
        );
        rig.connect();
        rig.exchange().unwrap();
        let reason = CloseReason::Refused(PeerReason::Generic);
        assert_eq!(rig.take_events(), [Event::Closed { reason }]);
        assert!(rig.session.wants_disconnect());
        rig.session.handle_disconnected(rig.now_us);
        assert_eq!(rig.session.counters().failed_connects, 1);
    }
    // A router that does not ask for it is not the one we were configured for.
    let mut rig = Rig::new(credentials("n1", "secret"), Grants::default());
    rig.connect();
    assert_eq!(rig.exchange(), Err(Cut));
    let reason = CloseReason::Protocol(SessionError::NoAuthentication);
    assert_eq!(rig.take_events(), [Event::Closed { reason }]);
}

#[test]
fn every_reason_to_refuse_is_told() {
    for (number, reason) in [
        (0, PeerReason::Generic),
        (1, PeerReason::Unsupported),
        (2, PeerReason::Invalid),
        (3, PeerReason::MaxSessions),
        (4, PeerReason::MaxLinks),
        (5, PeerReason::Expired),
        (6, PeerReason::Unresponsive),
        (7, PeerReason::ConnectionToSelf),
        (99, PeerReason::Other(99)),
    ] {
        let grants = Grants {
            refuse: Some(number),
            ..Grants::default()
        };
        let mut rig = Rig::new(SessionConfig::default(), grants);
        rig.connect();
        rig.exchange().unwrap();
        let reason = CloseReason::Refused(reason);
        assert_eq!(rig.take_events(), [Event::Closed { reason }]);
    }
}

#[test]
fn a_peer_that_does_not_answer_is_given_up() {
    let mut rig = Rig::new(SessionConfig::default(), Grants::default());
    rig.session.handle_connected(rig.now_us);
    let mut unheard = Vec::new();
    rig.session.poll_transmit(rig.now_us, &mut unheard);
    assert_eq!(
        rig.session.poll_timeout(),
        Some(rig.now_us + 10 * SECOND_US)
    );
    rig.now_us += 10 * SECOND_US;
    rig.session.handle_timeout(rig.now_us);
    assert_eq!(
        rig.take_events(),
        [Event::Closed {
            reason: CloseReason::HandshakeTimeout
        }]
    );
    rig.exchange().unwrap();
    assert!(rig.session.wants_disconnect());
}

#[test]
fn a_peer_that_closes_ends_the_session() {
    let mut rig = Rig::plain();
    rig.peer.say_transport(Close {
        reason: 5,
        session: true,
    });
    rig.exchange().unwrap();
    let reason = CloseReason::Peer(PeerReason::Expired);
    assert_eq!(rig.take_events(), [Event::Closed { reason }]);
    assert!(rig.session.wants_disconnect());
    assert_eq!(
        rig.session.put("a", b"", &PutOptions::default()),
        Err(PutError::Closed)
    );
}

#[test]
fn closing_sends_what_is_queued_and_then_says_so() {
    let mut rig = Rig::plain();
    rig.session
        .put("a", &[1; 9000], &PutOptions::default())
        .unwrap();
    rig.session.close(rig.now_us);
    assert_eq!(
        rig.session.put("a", b"late", &PutOptions::default()),
        Err(PutError::Closed)
    );
    rig.exchange().unwrap();
    assert_eq!(put_payloads(&rig.take_heard()), [vec![1; 9000]]);
    assert_eq!(rig.peer.heard_close, Some(0));
    assert_eq!(
        rig.take_events(),
        [Event::Closed {
            reason: CloseReason::Local
        }]
    );
    assert!(rig.session.wants_disconnect());
    rig.session.handle_disconnected(rig.now_us);
    assert!(rig.session.is_finished());
    assert!(!rig.session.wants_connection(u64::MAX));
    assert_eq!(rig.session.poll_timeout(), None);
}

#[test]
fn closing_towards_a_peer_that_takes_nothing_ends_after_a_second() {
    let mut rig = Rig::plain();
    rig.session
        .put("a", b"stuck", &PutOptions::default())
        .unwrap();
    rig.session.close(rig.now_us);
    let at_us = rig.session.poll_timeout().unwrap();
    assert_eq!(at_us, rig.now_us + limits::CLOSE_TIMEOUT_US);
    rig.session.handle_timeout(at_us);
    assert_eq!(
        rig.take_events(),
        [Event::Closed {
            reason: CloseReason::Local
        }]
    );
    assert_eq!(rig.session.counters().unsent, 1);
}

#[test]
fn closing_before_the_handshake_is_through_ends_it() {
    let mut rig = Rig::new(SessionConfig::default(), Grants::default());
    rig.connect();
    rig.session.close(rig.now_us);
    assert_eq!(
        rig.take_events(),
        [Event::Closed {
            reason: CloseReason::Local
        }]
    );
    rig.session.handle_disconnected(rig.now_us);
    assert!(rig.session.is_finished());
    let mut unconnected = Session::new(SessionConfig::default(), 1);
    unconnected.close(0);
    assert!(unconnected.is_finished());
}

// ---- time ----

#[test]
fn silence_is_broken_four_times_in_a_lease() {
    let mut rig = Rig::plain();
    for _ in 0..3 {
        rig.advance(9 * SECOND_US);
        rig.peer.say_keep_alive();
        rig.exchange().unwrap();
    }
    // 27 s of silence from us at a lease of 10 s: one each 2.5 s.
    assert_eq!(rig.peer.heard_keep_alives, 10);
    assert!(rig.session.is_open());
}

#[test]
fn talking_makes_keep_alives_needless() {
    let mut rig = Rig::plain();
    for _ in 0..20 {
        rig.session.put("a", b"", &PutOptions::default()).unwrap();
        rig.exchange().unwrap();
        rig.advance(SECOND_US);
        rig.peer.say_keep_alive();
    }
    assert_eq!(rig.peer.heard_keep_alives, 0);
}

#[test]
fn a_silent_peer_is_dropped_at_its_lease_and_told() {
    let lease = std::time::Duration::from_millis(3500);
    let mut rig = Rig::opened(
        SessionConfig::default(),
        Grants {
            lease,
            ..Grants::default()
        },
    );
    rig.advance(3_499_999);
    assert!(rig.session.is_open());
    rig.advance(1);
    assert_eq!(
        rig.take_events(),
        [Event::Closed {
            reason: CloseReason::LeaseExpired
        }]
    );
    rig.exchange().unwrap();
    assert_eq!(rig.peer.heard_close, Some(5));
    assert!(rig.session.wants_disconnect());
}

#[test]
fn pauses_between_attempts_grow_to_the_cap_and_start_anew_after_a_good_session() {
    let config = SessionConfig {
        backoff_us_min: 100_000,
        backoff_us_max: 1_000_000,
        ..SessionConfig::default()
    };
    let mut rig = Rig::new(config, Grants::default());
    assert!(rig.session.wants_connection(rig.now_us));
    let mut pauses_us = Vec::new();
    for _ in 0..7 {
        rig.session.handle_connect_failed(rig.now_us);
        let retry_at_us = rig.session.poll_timeout().unwrap();
        assert!(!rig.session.wants_connection(retry_at_us - 1));
        assert!(rig.session.wants_connection(retry_at_us));
        pauses_us.push(retry_at_us - rig.now_us);
        rig.now_us = retry_at_us;
    }
    for (pause_us, ceiling_us) in pauses_us
        .iter()
        .zip([100, 200, 400, 800, 1000, 1000, 1000].map(|ms| ms * 1000))
    {
        assert!(
            (ceiling_us / 2..=ceiling_us).contains(pause_us),
            "{pauses_us:?}"
        );
    }
    // A router that accepts and closes at once is not a good session.
    rig.connect();
    rig.exchange().unwrap();
    rig.session.handle_disconnected(rig.now_us);
    assert!(rig.session.poll_timeout().unwrap() - rig.now_us >= 500_000);
    rig.now_us += SECOND_US;
    rig.connect();
    rig.exchange().unwrap();
    rig.advance(9 * SECOND_US);
    rig.peer.say_keep_alive();
    rig.exchange().unwrap();
    rig.advance(2 * SECOND_US);
    rig.session.handle_disconnected(rig.now_us);
    assert!(rig.session.poll_timeout().unwrap() - rig.now_us <= 100_000);
}

#[test]
fn every_connection_has_an_id_of_its_own() {
    let mut rig = Rig::plain();
    for _ in 0..5 {
        rig.session.handle_disconnected(rig.now_us);
        rig.connect();
        rig.exchange().unwrap();
    }
    let mut zids: Vec<_> = rig.peer.zids.iter().map(|zid| zid.to_le_bytes()).collect();
    zids.sort_unstable();
    zids.dedup();
    assert_eq!(zids.len(), 6);
    assert_eq!(rig.session.counters().reconnects, 5);
}

// ---- declarations ----

/// What the peer was told, in short.
fn told(heard: &[NetworkBody]) -> Vec<String> {
    let name = |body: &NetworkBody| match body {
        NetworkBody::Declare(declare) => match &declare.body {
            DeclareBody::DeclareKeyExpr(d) => format!("key {} {}", d.id, d.wire_expr),
            DeclareBody::UndeclareKeyExpr(d) => format!("-key {}", d.id),
            DeclareBody::DeclareSubscriber(d) => format!("subscriber on {}", d.wire_expr.scope),
            DeclareBody::UndeclareSubscriber(_) => "-subscriber".to_string(),
            DeclareBody::DeclareQueryable(d) => format!("queryable on {}", d.wire_expr.scope),
            DeclareBody::UndeclareQueryable(_) => "-queryable".to_string(),
            DeclareBody::DeclareToken(d) => format!("token on {}", d.wire_expr.scope),
            DeclareBody::UndeclareToken(_) => "-token".to_string(),
            DeclareBody::DeclareFinal(_) => "final".to_string(),
        },
        NetworkBody::Interest(interest) if interest.mode == InterestMode::Final => {
            "-interest".to_string()
        }
        NetworkBody::Interest(interest) => {
            let what = if interest.options.tokens() {
                "tokens"
            } else {
                "subscribers"
            };
            format!(
                "interest in {what} on {}",
                interest.wire_expr.as_ref().unwrap().scope
            )
        }
        NetworkBody::Push(push) => format!("push on {}", push.wire_expr),
        other => panic!("{other:?}"),
    };
    heard.iter().map(name).collect()
}

#[test]
fn declarations_are_told_at_once_and_again_on_every_connection() {
    let mut rig = Rig::new(SessionConfig::default(), Grants::default());
    rig.session.declare_subscriber("a/*").unwrap();
    rig.session.declare_queryable("a/*", true).unwrap();
    rig.session.declare_publisher("b").unwrap();
    rig.connect();
    rig.exchange().unwrap();
    let before = [
        "key 1 a/*",
        "subscriber on 1",
        "queryable on 1",
        "key 2 b",
        "interest in subscribers on 2",
    ];
    assert_eq!(told(&rig.take_heard()), before);
    rig.session.declare_token("c").unwrap();
    rig.session.declare_liveliness_subscriber("d/**").unwrap();
    rig.session.declare_key("e").unwrap();
    rig.exchange().unwrap();
    let after = [
        "key 3 c",
        "token on 3",
        "key 4 d/**",
        "interest in tokens on 4",
        "key 5 e",
    ];
    assert_eq!(told(&rig.take_heard()), after);
    for _ in 0..2 {
        rig.session.handle_disconnected(rig.now_us);
        rig.connect();
        rig.exchange().unwrap();
        assert_eq!(told(&rig.take_heard()), [&before[..], &after[..]].concat());
    }
}

#[test]
fn what_is_taken_back_is_told_and_its_key_last() {
    let mut rig = Rig::plain();
    let subscriber = rig.session.declare_subscriber("a").unwrap();
    let queryable = rig.session.declare_queryable("a", false).unwrap();
    let publisher = rig.session.declare_publisher("b").unwrap();
    let token = rig.session.declare_token("c").unwrap();
    let liveliness = rig.session.declare_liveliness_subscriber("d").unwrap();
    let declared = rig.session.declare_key("e").unwrap();
    rig.exchange().unwrap();
    rig.take_heard();
    rig.session.undeclare_subscriber(subscriber).unwrap();
    rig.exchange().unwrap();
    assert_eq!(
        told(&rig.take_heard()),
        ["-subscriber"],
        "a queryable still needs the key"
    );
    rig.session
        .put(publisher, b"last words", &at(Priority::Background))
        .unwrap();
    rig.session.undeclare_queryable(queryable).unwrap();
    rig.session.undeclare_publisher(publisher).unwrap();
    rig.session.undeclare_token(token).unwrap();
    rig.session
        .undeclare_liveliness_subscriber(liveliness)
        .unwrap();
    rig.session.undeclare_key(declared).unwrap();
    assert_eq!(
        rig.session.undeclare_key(declared),
        Err(UndeclareError::Unknown)
    );
    rig.exchange().unwrap();
    let heard = told(&rig.take_heard());
    let expected = [
        "-queryable",
        "-interest",
        "-token",
        "-interest",
        "push on 2:Sender:",
        "-key 1",
        "-key 2",
        "-key 3",
        "-key 4",
        "-key 5",
    ];
    assert_eq!(heard, expected);
    rig.session.handle_disconnected(rig.now_us);
    rig.connect();
    rig.exchange().unwrap();
    assert!(rig.take_heard().is_empty());
}

#[test]
fn a_peer_that_asks_what_is_declared_is_told_where_the_list_ends() {
    let mut rig = Rig::plain();
    rig.session.declare_subscriber("a").unwrap();
    rig.peer.say([interest(31)]);
    rig.exchange().unwrap();
    let heard = rig.take_heard();
    assert_eq!(told(&heard), ["key 1 a", "subscriber on 1", "final"]);
    let Some(NetworkBody::Declare(last)) = heard.last() else {
        panic!("the end")
    };
    assert_eq!(last.interest_id, Some(31));
}

#[test]
fn every_table_has_a_bound_and_says_so() {
    use pico::DeclareError::{Full, Key};
    let mut session = Session::new(SessionConfig::default(), 1);
    let mut fill = |count: usize, declare: fn(&mut Session, &str) -> Result<(), _>| {
        for index in 0..count {
            declare(&mut session, &format!("k/{index}")).unwrap();
        }
        assert_eq!(declare(&mut session, "k/0"), Err(Full));
    };
    fill(limits::SUBSCRIBERS_MAX, |s, key| {
        s.declare_subscriber(key).map(drop)
    });
    fill(limits::QUERYABLES_MAX, |s, key| {
        s.declare_queryable(key, false).map(drop)
    });
    fill(limits::PUBLISHERS_MAX, |s, key| {
        s.declare_publisher(key).map(drop)
    });
    fill(limits::TOKENS_MAX, |s, key| s.declare_token(key).map(drop));
    fill(limits::LIVELINESS_SUBSCRIBERS_MAX, |s, key| {
        s.declare_liveliness_subscriber(key).map(drop)
    });
    fill(limits::KEYS_MAX, |s, key| s.declare_key(key).map(drop));
    let long = "k".repeat(limits::KEY_BYTES_MAX + 1);
    for bad in ["", "/a", "a/", "a//b", "a/**/**", "a?b", "a#", &long] {
        assert_eq!(session.declare_subscriber(bad), Err(Key), "{bad}");
    }
}

#[test]
fn taking_back_more_than_can_be_told_is_refused_until_it_is_told() {
    let mut rig = Rig::plain();
    let subscribers: Vec<SubscriberId> = (0..limits::SUBSCRIBERS_MAX)
        .map(|index| {
            let key = format!("k/{index}");
            rig.session.declare_subscriber(&key).unwrap()
        })
        .collect();
    rig.exchange().unwrap();
    rig.take_heard();
    // Not a byte of room is left for what is taken back.
    for payload in [&[0; 500][..], &[]] {
        let options = at(Priority::RealTime);
        while rig.session.put("x", payload, &options).is_ok() {}
    }
    let taken_back = |rig: &mut Rig, subscribers: &[SubscriberId]| {
        let undeclare = |id: &&SubscriberId| rig.session.undeclare_subscriber(**id).is_ok();
        subscribers.iter().take_while(undeclare).count()
    };
    // Each leaves a subscriber and a key to tell.
    let first_count = taken_back(&mut rig, &subscribers);
    assert_eq!(first_count, limits::LEAVING_MAX / 2);
    let next = rig.session.undeclare_subscriber(subscribers[first_count]);
    assert_eq!(next, Err(UndeclareError::Full));
    rig.exchange().unwrap();
    let rest_count = taken_back(&mut rig, &subscribers[first_count..]);
    assert_eq!(first_count + rest_count, subscribers.len());
    rig.exchange().unwrap();
    let heard = told(&rig.take_heard());
    let count = |what: &str| heard.iter().filter(|told| told.starts_with(what)).count();
    assert_eq!(count("-subscriber"), subscribers.len());
    assert_eq!(count("-key"), subscribers.len());
}

// ---- publishing ----

#[test]
fn small_messages_share_a_batch_and_express_ends_it() {
    let mut rig = Rig::plain();
    for index in 0..10u8 {
        let express = index == 4;
        let options = PutOptions {
            express,
            ..PutOptions::default()
        };
        rig.session.put("a", &[index], &options).unwrap();
    }
    rig.peer.batch_lengths.clear();
    rig.exchange().unwrap();
    assert_eq!(rig.peer.batch_lengths.len(), 2);
    assert_eq!(rig.peer.heard_frames, 2);
    let payloads = put_payloads(&rig.take_heard());
    assert_eq!(payloads, (0..10u8).map(|i| vec![i]).collect::<Vec<_>>());
}

#[test]
fn a_full_queue_says_so_takes_nothing_and_keeps_a_reserve() {
    let mut rig = Rig::plain();
    let mut count = 0u32;
    while rig
        .session
        .put("flood", &[0; 100], &PutOptions::default())
        .is_ok()
    {
        count += 1;
    }
    assert!(count > 50);
    let full = rig.session.put("flood", &[0; 100], &PutOptions::default());
    assert_eq!(full, Err(PutError::Full));
    while rig.session.put("f", b"", &PutOptions::default()).is_ok() {
        count += 1;
    }
    let asked = rig
        .session
        .get("f", "", None, &GetOptions::default(), rig.now_us);
    assert_eq!(asked, Err(GetError::Full));
    rig.session
        .put("stop", b"now", &at(Priority::RealTime))
        .unwrap();
    let huge = vec![0; rig.session.config().queue_bytes];
    let options = PutOptions::default();
    assert_eq!(
        rig.session.put("flood", &huge, &options),
        Err(PutError::TooLarge)
    );
    assert_eq!(rig.session.put("a/", b"", &options), Err(PutError::Key));
    rig.exchange().unwrap();
    let heard = rig.take_heard();
    let pushes: Vec<_> = told(&heard[..1]);
    assert_eq!(pushes, ["push on stop"], "real time goes first");
    assert_eq!(put_payloads(&heard).len() as u32, count + 1);
    rig.session
        .put("flood", &[0; 100], &PutOptions::default())
        .unwrap();
}

#[test]
fn a_long_message_is_overtaken_where_priorities_are_agreed_and_only_there() {
    for qos in [true, false] {
        let config = SessionConfig {
            qos,
            queue_bytes: 64 * 1024,
            ..SessionConfig::default()
        };
        let mut rig = Rig::opened(config, Grants::default());
        let long = vec![1; 20_000];
        rig.session
            .put("long", &long, &PutOptions::default())
            .unwrap();
        let mut out = Vec::new();
        rig.session.poll_transmit(rig.now_us, &mut out);
        rig.peer.hear(&out);
        rig.session
            .put("stop", b"now", &at(Priority::RealTime))
            .unwrap();
        rig.exchange().unwrap();
        let payloads = put_payloads(&rig.take_heard());
        let (first, second) = if qos { (0, 1) } else { (1, 0) };
        assert_eq!(payloads[first], b"now");
        assert_eq!(payloads[second], long);
        assert!(rig.peer.heard_fragments >= 10);
    }
}

#[test]
fn a_call_of_poll_transmit_is_bounded() {
    let config = SessionConfig {
        queue_bytes: 1 << 20,
        ..SessionConfig::default()
    };
    let mut rig = Rig::opened(config, Grants::default());
    for _ in 0..1000 {
        rig.session
            .put("a", &[0; 500], &PutOptions::default())
            .unwrap();
    }
    let mut out = Vec::new();
    while rig.session.poll_transmit(rig.now_us, &mut out) > 0 {
        assert!(out.len() <= limits::TRANSMIT_BYTES + 2048);
        rig.peer.hear(&out);
        assert!(rig.peer.heard_whole_batches());
        out.clear();
    }
    assert_eq!(rig.take_heard().len(), 1000);
}

#[test]
fn publishing_by_number_waits_until_the_number_is_told() {
    let mut rig = Rig::new(SessionConfig::default(), Grants::default());
    let publisher = rig.session.declare_publisher("some/long/key").unwrap();
    assert_eq!(
        rig.session.put(publisher, b"", &PutOptions::default()),
        Err(PutError::Closed)
    );
    rig.connect();
    rig.exchange().unwrap();
    rig.take_heard();
    rig.session
        .put(publisher, b"1", &PutOptions::default())
        .unwrap();
    let declared = rig.session.declare_key("other/key").unwrap();
    rig.session
        .put(
            pico::KeyRef::Declared(declared),
            b"2",
            &PutOptions::default(),
        )
        .unwrap();
    rig.session
        .delete(publisher, &PutOptions::default())
        .unwrap();
    rig.exchange().unwrap();
    let heard = told(&rig.take_heard());
    let expected = [
        "key 2 other/key",
        "push on 1:Sender:",
        "push on 2:Sender:",
        "push on 1:Sender:",
    ];
    assert_eq!(heard, expected);
}

#[test]
fn a_publisher_is_wanted_until_the_router_says_otherwise() {
    let mut rig = Rig::plain();
    let publisher = rig.session.declare_publisher("a/b").unwrap();
    assert!(rig.session.is_wanted(publisher), "nobody has answered");
    rig.exchange().unwrap();
    let Some(NetworkBody::Interest(interest)) = rig.take_heard().pop() else {
        panic!("it asks")
    };
    assert_eq!(interest.mode, InterestMode::CurrentFuture);
    assert!(interest.options.aggregate());
    let wanted = |wanted| Event::Wanted { publisher, wanted };
    rig.peer.say([declare_final(interest.id)]);
    rig.exchange().unwrap();
    assert_eq!(rig.take_events(), [wanted(false)]);
    assert!(!rig.session.is_wanted(publisher));
    rig.peer.say([
        declare_subscriber(None, 7, key("a/*")),
        declare_subscriber(None, 8, key("**")),
    ]);
    rig.exchange().unwrap();
    assert_eq!(rig.take_events(), [wanted(true)]);
    rig.peer.say([undeclare_subscriber(7)]);
    rig.exchange().unwrap();
    assert_eq!(rig.take_events(), []);
    rig.peer
        .say([undeclare_subscriber(8), undeclare_subscriber(9)]);
    rig.exchange().unwrap();
    assert_eq!(rig.take_events(), [wanted(false)]);
    assert_eq!(rig.session.counters().unknown_ids, 1);
    // Sending is possible all the same.
    rig.session
        .put(publisher, b"", &PutOptions::default())
        .unwrap();
    // More subscribers than can be remembered: wanted for good.
    for id in 0..=limits::PEER_SUBSCRIBERS_MAX as u32 {
        rig.peer
            .say([declare_subscriber(None, id, key("elsewhere"))]);
    }
    rig.exchange().unwrap();
    assert_eq!(rig.take_events(), [wanted(true)]);
    assert_eq!(rig.session.counters().refused, 1);
}

// ---- hearing ----

#[test]
fn a_message_goes_to_every_subscriber_whose_key_meets_it() {
    let mut rig = Rig::plain();
    let narrow = rig
        .session
        .declare_subscriber("fleet/node/left/stop")
        .unwrap();
    let wide = rig.session.declare_subscriber("fleet/node/**").unwrap();
    let other = rig
        .session
        .declare_subscriber("fleet/node/right/*")
        .unwrap();
    rig.exchange().unwrap();
    rig.peer.say([
        push(key("fleet/node/*/stop"), b"1"),
        push(key("fleet/node/left/stop"), b"2"),
        push(client_key(1, ""), b"3"),
        push(client_key(3, "").clone(), b"4"),
        push(key("nobody"), b"5"),
    ]);
    rig.exchange().unwrap();
    let events = rig.take_events();
    let stop = "fleet/node/left/stop";
    assert_eq!(
        messages(&events),
        [
            (narrow, "fleet/node/*/stop", &b"1"[..]),
            (wide, "fleet/node/*/stop", b"1"),
            (other, "fleet/node/*/stop", b"1"),
            (narrow, stop, b"2"),
            (wide, stop, b"2"),
            (narrow, stop, b"3"),
            (wide, stop, b"3"),
            (wide, "fleet/node/right/*", b"4"),
            (other, "fleet/node/right/*", b"4"),
        ]
    );
    assert_eq!(rig.session.counters().unwanted, 1);
}

#[test]
fn keys_come_by_either_side_s_numbers_and_unknown_ones_are_counted() {
    let mut rig = Rig::plain();
    let subscriber = rig.session.declare_subscriber("a/**").unwrap();
    rig.exchange().unwrap();
    rig.peer.say([
        declare_key(9, key("a/nine")),
        declare_key(10, peer_key(9, "/ten")),
        push(peer_key(10, ""), b"1"),
        push(peer_key(9, "/x"), b"2"),
        push(peer_key(11, "/x"), b"unknown"),
        push(client_key(77, "/x"), b"unknown"),
        push(peer_key(9, "//"), b"not canonical"),
        push(key("a/last"), b"3"),
    ]);
    rig.exchange().unwrap();
    let events = rig.take_events();
    let expected: [(_, _, &[u8]); 3] = [
        (subscriber, "a/nine/ten", b"1"),
        (subscriber, "a/nine/x", b"2"),
        (subscriber, "a/last", b"3"),
    ];
    assert_eq!(messages(&events), expected);
    assert_eq!(rig.session.counters().unknown_ids, 3);
    assert!(rig.session.is_open());
    // Numbers beyond the bound are refused, and messages under them dropped.
    for id in 100..100 + limits::PEER_KEYS_MAX as u16 {
        rig.peer.say([declare_key(id, key("a/many"))]);
    }
    rig.exchange().unwrap();
    assert_eq!(rig.session.counters().refused, 2);
}

#[test]
fn wrong_sequence_numbers_drop_the_frame_and_skipped_ones_are_counted() {
    let mut rig = Rig::plain();
    rig.session.declare_subscriber("a").unwrap();
    rig.exchange().unwrap();
    let data = WirePriority::Data;
    for (sn, payload) in [
        (100, 0u8),
        (100, 1),
        (99, 2),
        (101, 3),
        (105, 4),
        (104, 5),
        (100 + SN_MASK / 2, 6),
        (106, 7),
    ] {
        rig.peer.say_frame(data, sn, [push(key("a"), &[payload])]);
    }
    // Every priority has its own sequence.
    rig.peer
        .say_frame(WirePriority::RealTime, 100, [push(key("a"), &[8])]);
    rig.exchange().unwrap();
    let events = rig.take_events();
    let payloads: Vec<u8> = messages(&events)
        .iter()
        .map(|(_, _, payload)| payload[0])
        .collect();
    assert_eq!(payloads, [0, 3, 4, 6, 8]);
    let counters = rig.session.counters();
    assert_eq!(counters.stale, 4);
    assert_eq!(counters.gaps, 3 + SN_MASK / 2 - 6);
    rig.peer.say_frame(data, SN_MASK + 1, []);
    assert_eq!(rig.exchange(), Err(Cut));
    let reason = CloseReason::Protocol(SessionError::SequenceNumber);
    assert_eq!(rig.take_events(), [Event::Closed { reason }]);
}

#[test]
fn sequence_numbers_go_round() {
    let grants = Grants {
        initial_sn: SN_MASK - 1,
        ..Grants::default()
    };
    let mut rig = Rig::opened(SessionConfig::default(), grants);
    rig.session.declare_subscriber("a").unwrap();
    rig.exchange().unwrap();
    for index in 0..5u8 {
        rig.peer.say([push(key("a"), &[index])]);
    }
    rig.exchange().unwrap();
    assert_eq!(messages(&rig.take_events()).len(), 5);
    assert_eq!(rig.session.counters().gaps, 0);
}

#[test]
fn a_priority_that_was_not_agreed_ends_the_session() {
    let mut rig = Rig::opened(
        SessionConfig::default(),
        Grants {
            qos: false,
            ..Grants::default()
        },
    );
    rig.peer.say_frame(WirePriority::RealTime, 100, []);
    assert_eq!(rig.exchange(), Err(Cut));
    let reason = CloseReason::Protocol(SessionError::Priority);
    assert_eq!(rig.take_events(), [Event::Closed { reason }]);
}

// ---- fragments ----

#[test]
fn fragments_become_one_message_up_to_the_bound() {
    for patch in [0, 1] {
        let mut rig = Rig::opened(
            SessionConfig::default(),
            Grants {
                patch,
                ..Grants::default()
            },
        );
        rig.session.declare_subscriber("a").unwrap();
        rig.exchange().unwrap();
        let overhead = bytes(push(key("a"), &[1; 4000])).len() - 4000;
        let fitting = limits::FRAGMENT_BYTES_MAX_DEFAULT - overhead;
        for payload_bytes in [fitting, fitting + 1, 100, fitting] {
            rig.peer
                .say_fragmented(push(key("a"), &vec![1; payload_bytes]), 700);
            rig.peer.say([push(key("a"), b"between")]);
        }
        rig.exchange().unwrap();
        let events = rig.take_events();
        let lengths: Vec<usize> = messages(&events).iter().map(|(_, _, p)| p.len()).collect();
        assert_eq!(
            lengths,
            [fitting, 7, 7, 100, 7, fitting, 7],
            "patch {patch}"
        );
        let counters = rig.session.counters();
        assert_eq!((counters.reassembly_drops, counters.gaps), (1, 0));
    }
}

#[test]
fn broken_chains_are_dropped_counted_once_and_harm_nothing() {
    let first = Marks {
        first: true,
        more: true,
        drop: false,
    };
    let more = Marks {
        more: true,
        ..Marks::default()
    };
    let last = Marks::default();
    let drop = Marks {
        more: true,
        drop: true,
        ..Marks::default()
    };
    let message = bytes(push(key("a"), &[1; 300]));
    let (one, two) = message.split_at(100);
    let (two, three) = two.split_at(100);
    // Steps are (skipped numbers, marks, payload).
    type Step<'a> = (u32, Marks, &'a [u8]);
    let chains: [(&str, Vec<Step<'_>>); 6] = [
        (
            "the beginning is missing",
            vec![(0, more, two), (0, more, two), (0, last, three)],
        ),
        (
            "the middle is missing",
            vec![(0, first, one), (1, last, three)],
        ),
        (
            "given up by the peer",
            vec![(0, first, one), (0, more, two), (0, drop, &[])],
        ),
        (
            "begun anew",
            vec![(0, first, one), (0, first, one), (0, drop, &[])],
        ),
        (
            "too long",
            vec![
                (0, first, &[0; 2000]),
                (0, more, &[0; 2000]),
                (0, more, &[0; 97]),
                (0, last, one),
            ],
        ),
        (
            "given up and still going on",
            vec![(0, first, one), (0, drop, &[]), (0, last, three)],
        ),
    ];
    for (what, steps) in chains {
        let mut rig = Rig::plain();
        rig.session.declare_subscriber("a").unwrap();
        rig.exchange().unwrap();
        for (skipped, marks, payload) in steps {
            for _ in 0..skipped {
                rig.peer.next_sn(WirePriority::DEFAULT);
            }
            let sn = rig.peer.next_sn(WirePriority::DEFAULT);
            rig.peer.say_fragment(sn, marks, payload);
        }
        rig.peer.say_fragmented(push(key("a"), b"whole"), 3);
        rig.exchange().unwrap();
        let events = rig.take_events();
        assert_eq!(messages(&events).len(), 1, "{what}");
        let expected = match what {
            "begun anew" | "given up and still going on" => 2,
            _ => 1,
        };
        assert_eq!(rig.session.counters().reassembly_drops, expected, "{what}");
    }
}

#[test]
fn a_chain_that_makes_no_message_ends_the_session() {
    let mut rig = Rig::plain();
    let sn = rig.peer.next_sn(WirePriority::DEFAULT);
    rig.peer.say_fragment(
        sn,
        Marks {
            first: true,
            ..Marks::default()
        },
        &[0x1d, 0xff],
    );
    assert_eq!(rig.exchange(), Err(Cut));
    let reason = CloseReason::Protocol(SessionError::Decode);
    assert_eq!(rig.take_events(), [Event::Closed { reason }]);
}

// ---- liveliness ----

#[test]
fn each_liveliness_subscriber_hears_of_each_token_once() {
    let mut rig = Rig::plain();
    let first = rig.session.declare_liveliness_subscriber("n/*").unwrap();
    rig.exchange().unwrap();
    let told = |subscriber: LivelinessId, key: &str, alive| Event::Liveliness {
        subscriber,
        key: key.to_string(),
        alive,
    };
    rig.peer.say([
        declare_token(Some(1), 5, key("n/a")),
        declare_final(1),
        declare_token(None, 5, key("n/a")),
        declare_token(None, 6, key("n/b")),
        declare_token(None, 7, key("m/b")),
    ]);
    rig.exchange().unwrap();
    assert_eq!(
        rig.take_events(),
        [told(first, "n/a", true), told(first, "n/b", true)]
    );
    let second = rig.session.declare_liveliness_subscriber("n/**").unwrap();
    rig.exchange().unwrap();
    rig.peer.say([
        declare_token(Some(2), 5, key("n/a")),
        undeclare_token(5),
        undeclare_token(77),
    ]);
    rig.exchange().unwrap();
    let expected = [
        told(second, "n/a", true),
        told(first, "n/a", false),
        told(second, "n/a", false),
    ];
    assert_eq!(rig.take_events(), expected);
    assert_eq!(rig.session.counters().unknown_ids, 1);
    rig.session.undeclare_liveliness_subscriber(first).unwrap();
    rig.peer.say([undeclare_token(6)]);
    rig.exchange().unwrap();
    assert_eq!(rig.take_events(), []);
}

// ---- questions ----

#[test]
fn a_question_of_ours_gets_its_replies_and_one_final() {
    let mut rig = Rig::plain();
    let id = rig
        .session
        .get("a/*", "x=1", Some(b"q"), &GetOptions::default(), rig.now_us)
        .unwrap();
    rig.exchange().unwrap();
    let Some(NetworkBody::Request(request)) = rig.take_heard().pop() else {
        panic!("a request")
    };
    let RequestBody::Query(asked) = request.payload;
    assert_eq!(asked.parameters, "x=1");
    assert_eq!(asked.ext_body.unwrap().payload.to_zslice(), b"q");
    let rid = request.id;
    rig.peer.say([
        reply(rid, key("a/1"), b"one"),
        reply(rid + 1, key("a/1"), b"nobody asked"),
        reply(rid, key("a/2"), b"two"),
        reply_final(rid),
        reply_final(rid),
    ]);
    rig.exchange().unwrap();
    let events = rig.take_events();
    let keys: Vec<&str> = events
        .iter()
        .filter_map(|event| match event {
            Event::Reply { query, sample } if *query == id => Some(sample.key.as_str()),
            _ => None,
        })
        .collect();
    assert_eq!(keys, ["a/1", "a/2"]);
    assert_eq!(
        events[2..],
        [Event::ReplyFinal {
            query: id,
            timed_out: false
        }]
    );
    assert_eq!(rig.session.counters().unknown_ids, 2);
}

#[test]
fn a_question_ends_by_itself_at_its_timeout_or_with_the_connection() {
    let mut rig = Rig::plain();
    let options = GetOptions {
        timeout_us: 3 * SECOND_US,
        ..GetOptions::default()
    };
    let id = rig
        .session
        .get("a", "", None, &options, rig.now_us)
        .unwrap();
    rig.exchange().unwrap();
    rig.advance(3 * SECOND_US - 1);
    assert_eq!(rig.take_events(), []);
    rig.advance(1);
    assert_eq!(
        rig.take_events(),
        [Event::ReplyFinal {
            query: id,
            timed_out: true
        }]
    );
    let id = rig
        .session
        .get("a", "", None, &options, rig.now_us)
        .unwrap();
    rig.session.handle_disconnected(rig.now_us);
    let closed = Event::Closed {
        reason: CloseReason::Lost,
    };
    assert_eq!(
        rig.take_events(),
        [
            Event::ReplyFinal {
                query: id,
                timed_out: true
            },
            closed
        ]
    );
    assert_eq!(
        rig.session.get("a", "", None, &options, rig.now_us),
        Err(GetError::Closed)
    );
}

#[test]
fn questions_of_ours_are_bounded() {
    let mut rig = Rig::plain();
    let options = GetOptions::default();
    let ids: Vec<QueryId> = (0..limits::QUERIES_OUT_MAX)
        .map(|_| {
            rig.session
                .get("a", "", None, &options, rig.now_us)
                .unwrap()
        })
        .collect();
    assert!(ids.windows(2).all(|pair| pair[0] != pair[1]));
    assert_eq!(
        rig.session.get("a", "", None, &options, rig.now_us),
        Err(GetError::TooMany)
    );
    assert_eq!(
        rig.session.get("a//", "", None, &options, rig.now_us),
        Err(GetError::Key)
    );
}

fn inbound(events: &[Event]) -> Vec<InboundQuery> {
    let query = |event: &Event| match event {
        Event::Query { query, .. } => Some(*query),
        _ => None,
    };
    events.iter().filter_map(query).collect()
}

fn heard_finals(heard: &[NetworkBody]) -> Vec<u32> {
    let last = |body: &NetworkBody| match body {
        NetworkBody::ResponseFinal(last) => Some(last.rid),
        _ => None,
    };
    heard.iter().filter_map(last).collect()
}

#[test]
fn a_question_of_others_is_over_when_all_queryables_have_said_so() {
    let mut rig = Rig::plain();
    rig.session.declare_queryable("a/*", false).unwrap();
    rig.session.declare_queryable("a/**", false).unwrap();
    rig.exchange().unwrap();
    rig.take_heard();
    rig.peer
        .say([query(50, key("a/b")), query(51, key("nobody/here"))]);
    rig.exchange().unwrap();
    let queries = inbound(&rig.take_events());
    assert_eq!(queries.len(), 2);
    assert_eq!(
        heard_finals(&rig.take_heard()),
        [51],
        "what nobody answers is over at once"
    );
    let options = PutOptions::default();
    rig.session
        .reply(&queries[0], "a/b", b"1", &options)
        .unwrap();
    rig.session.reply_final(&queries[0]).unwrap();
    let over = Err(ReplyError::Unknown);
    assert_eq!(
        rig.session.reply(&queries[0], "a/b", b"late", &options),
        over
    );
    rig.exchange().unwrap();
    assert!(heard_finals(&rig.take_heard()).is_empty());
    rig.session
        .reply_delete(&queries[1], "a/b", &options)
        .unwrap();
    rig.session
        .reply_error(&queries[1], b"enough", &pico::Encoding::default())
        .unwrap();
    rig.session.reply_final(&queries[1]).unwrap();
    rig.exchange().unwrap();
    let heard = rig.take_heard();
    assert_eq!(heard_finals(&heard), [50]);
    assert!(matches!(&heard[1], NetworkBody::Response(response)
        if matches!(response.payload, ResponseBody::Err(_)) && response.rid == 50));
    assert_eq!(rig.session.reply_final(&queries[1]), over);
}

#[test]
fn answers_do_not_cross_connections() {
    let mut rig = Rig::plain();
    rig.session.declare_queryable("a", false).unwrap();
    rig.exchange().unwrap();
    rig.peer.say([query(50, key("a"))]);
    rig.exchange().unwrap();
    let old = inbound(&rig.take_events())[0];
    rig.session.handle_disconnected(rig.now_us);
    assert_eq!(rig.session.reply_final(&old), Err(ReplyError::Closed));
    rig.connect();
    rig.exchange().unwrap();
    rig.peer.say([query(50, key("a"))]);
    rig.exchange().unwrap();
    assert_eq!(rig.session.reply_final(&old), Err(ReplyError::Unknown));
}

#[test]
fn forgotten_questions_of_others_are_completed_and_too_many_turned_away() {
    let mut rig = Rig::plain();
    rig.session.declare_queryable("a", false).unwrap();
    rig.exchange().unwrap();
    rig.take_heard();
    let count = limits::QUERIES_IN_MAX as u32;
    rig.peer.say((0..=count).map(|id| query(id, key("a"))));
    rig.exchange().unwrap();
    assert_eq!(inbound(&rig.take_events()).len(), limits::QUERIES_IN_MAX);
    assert_eq!(heard_finals(&rig.take_heard()), [count]);
    assert_eq!(rig.session.counters().refused, 1);
    rig.advance(5 * SECOND_US);
    assert_eq!(
        heard_finals(&rig.take_heard()),
        (0..count).collect::<Vec<_>>()
    );
    assert_eq!(rig.session.counters().unanswered, count);
}

// ---- bad input ----

#[test]
fn garbage_ends_the_session_with_a_reason() {
    use SessionError::{Decode, Handshake, Oversized};
    for (bytes, error) in [
        (&[1u8, 0, 0xff][..], Decode),
        (&[2, 0, 0x25, 0x80], Decode),
        (&[5, 0, 0x25, 100, 0x1d, 0x05, 0x00], Decode),
        (&[0xff, 0xff], Oversized),
        (&[1, 8], Oversized),
        // An InitSyn and an OpenAck out of turn.
        (&[9, 0, 0x01, 0x09, 0x12, 1, 1, 1, 1, 1, 1], Handshake),
        (&[3, 0, 0x62, 10, 0], Handshake),
    ] {
        let mut rig = Rig::plain();
        let taken = rig.session.handle_bytes(rig.now_us, bytes);
        assert_eq!(taken, Err(error), "{bytes:?}");
        let events = rig.take_events();
        let reason = CloseReason::Protocol(error);
        assert_eq!(events, [Event::Closed { reason }]);
        assert_eq!(rig.session.counters().decode_errors, 1);
        assert!(!rig.session.is_open());
        let late = rig.session.handle_bytes(rig.now_us, &[0, 0]);
        assert_eq!(late, Err(SessionError::NotConnected));
        assert!(
            rig.session
                .poll_timeout()
                .is_some_and(|at_us| at_us > rig.now_us)
        );
    }
}

#[test]
fn frames_before_the_session_is_open_end_it() {
    let mut rig = Rig::new(SessionConfig::default(), Grants::default());
    rig.session.handle_connected(rig.now_us);
    rig.peer.say([push(key("a"), b"")]);
    assert_eq!(rig.exchange(), Err(Cut));
    let reason = CloseReason::Protocol(SessionError::Handshake);
    assert_eq!(rig.take_events(), [Event::Closed { reason }]);
}

#[test]
fn events_that_nobody_takes_hold_the_input_back_and_nothing_is_lost() {
    let mut rig = Rig::plain();
    rig.session.declare_subscriber("a").unwrap();
    rig.exchange().unwrap();
    for index in 0..1000u32 {
        rig.peer
            .say([push(key("a"), &index.to_le_bytes()), push(key("a"), b"and")]);
    }
    let said = rig.peer.take_said();
    let mut delivered = 0;
    for chunk in said.chunks(1000) {
        if !rig.session.wants_bytes() {
            break;
        }
        rig.session.handle_bytes(rig.now_us, chunk).unwrap();
        delivered += chunk.len();
    }
    assert!(delivered < said.len(), "the session takes everything");
    // The peer's silence is our doing now, so it does not count.
    let later_us = rig.now_us + 60 * SECOND_US;
    rig.session.handle_timeout(later_us);
    assert!(rig.session.is_open());
    let mut payloads = Vec::new();
    let mut rest = said[delivered..].chunks(1000);
    loop {
        while let Some(event) = rig.session.poll_event() {
            let Event::Message { sample, .. } = event else {
                panic!("{event:?}")
            };
            payloads.push(sample.payload);
        }
        let Some(chunk) = rest.next() else { break };
        rig.session.handle_bytes(later_us, chunk).unwrap();
    }
    assert_eq!(payloads.len(), 2000);
    for (index, pair) in payloads.chunks(2).enumerate() {
        assert_eq!(
            pair,
            [(index as u32).to_le_bytes().to_vec(), b"and".to_vec()]
        );
    }
}

#[test]
fn an_application_that_never_takes_events_ends_the_session_at_the_bound() {
    let mut rig = Rig::plain();
    rig.session.declare_subscriber("a").unwrap();
    rig.exchange().unwrap();
    for _ in 0..200 {
        rig.peer.say([push(key("a"), &[0; 1000])]);
    }
    let said = rig.peer.take_said();
    let taken = rig.session.handle_bytes(rig.now_us, &said);
    assert_eq!(taken, Err(SessionError::InputFull));
    let events = rig.take_events();
    assert_eq!(events.len(), limits::EVENTS_MAX + 1);
}

// ---- a link that breaks anywhere ----

/// Says and hears a bit of everything.
fn converse(rig: &mut Rig, declared: &Declared) -> Result<(), Cut> {
    rig.connect();
    rig.exchange()?;
    assert!(rig.session.is_open());
    let interests: Vec<u32> = rig
        .take_heard()
        .iter()
        .filter_map(|body| match body {
            NetworkBody::Interest(interest) => Some(interest.id),
            _ => None,
        })
        .collect();
    assert_eq!(
        interests.len(),
        2,
        "both interests are told on every connection"
    );
    rig.peer.say([
        declare_key(3, key("down")),
        declare_subscriber(Some(interests[0]), 1, key("up")),
        declare_final(interests[0]),
        declare_token(Some(interests[1]), 2, key("alive/x")),
        declare_final(interests[1]),
    ]);
    rig.exchange()?;
    rig.peer
        .say([push(peer_key(3, "/a"), b"hello"), query(9, key("ask"))]);
    rig.exchange()?;
    let asked = inbound(&rig.events);
    let asked = asked.last().expect("a query came");
    rig.session
        .reply(asked, "ask", b"answer", &PutOptions::default())
        .unwrap();
    rig.session.reply_final(asked).unwrap();
    rig.session
        .put(declared.publisher, &[5; 5000], &PutOptions::default())
        .unwrap();
    let question = rig
        .session
        .get("x", "", None, &GetOptions::default(), rig.now_us)
        .expect("it is open");
    rig.exchange()?;
    let heard = rig.take_heard();
    assert_eq!(put_payloads(&heard), [vec![5; 5000]]);
    assert_eq!(heard_finals(&heard), [9]);
    let rid = heard
        .iter()
        .find_map(|body| match body {
            NetworkBody::Request(request) => Some(request.id),
            _ => None,
        })
        .unwrap();
    rig.peer
        .say([reply(rid, key("x"), b"yes"), reply_final(rid)]);
    rig.exchange()?;
    assert!(rig.events.contains(&Event::ReplyFinal {
        query: question,
        timed_out: false
    }));
    rig.peer
        .say_fragmented(push(key("down/b"), &[6; 2500]), 1000);
    rig.exchange()?;
    Ok(())
}

struct Declared {
    publisher: PublisherId,
}

fn declare_all(rig: &mut Rig) -> Declared {
    rig.session.declare_subscriber("down/*").unwrap();
    rig.session.declare_queryable("ask", true).unwrap();
    let publisher = rig.session.declare_publisher("up").unwrap();
    rig.session
        .declare_liveliness_subscriber("alive/*")
        .unwrap();
    rig.session.declare_token("alive/me").unwrap();
    Declared { publisher }
}

#[test]
fn a_link_that_breaks_after_any_byte_is_made_again_and_nothing_is_left_behind() {
    let mut rig = Rig::new(SessionConfig::default(), Grants::default());
    let declared = declare_all(&mut rig);
    converse(&mut rig, &declared).unwrap();
    let whole = rig.take_events();
    let conversation_bytes = rig.delivered_bytes;
    assert!(conversation_bytes > 2500);
    // Every byte of the short messages, and steps through the long ones.
    let cuts = (1..400).chain((400..conversation_bytes).step_by(61));
    for cut_after_bytes in cuts {
        let mut rig = Rig::new(SessionConfig::default(), Grants::default());
        let declared = declare_all(&mut rig);
        rig.cut_after_bytes = Some(cut_after_bytes);
        assert_eq!(
            converse(&mut rig, &declared),
            Err(Cut),
            "cut after {cut_after_bytes}"
        );
        let events = rig.take_events();
        let closed = Event::Closed {
            reason: CloseReason::Lost,
        };
        assert_eq!(events.last(), Some(&closed), "cut after {cut_after_bytes}");
        assert!(events.len() <= whole.len() + 1);
        assert!(!rig.session.is_open());
        rig.now_us = rig.session.poll_timeout().unwrap();
        assert!(rig.session.wants_connection(rig.now_us));
        converse(&mut rig, &declared).unwrap();
        assert_eq!(
            kinds(&rig.take_events()),
            kinds(&whole),
            "cut after {cut_after_bytes}"
        );
        let counters = rig.session.counters();
        assert_eq!(
            (counters.gaps, counters.stale, counters.unknown_ids),
            (0, 0, 0)
        );
    }
}

/// Events without the numbers that differ between connections.
fn kinds(events: &[Event]) -> Vec<String> {
    let kind = |event: &Event| match event {
        Event::Message { sample, .. } => format!("message {} {}", sample.key, sample.payload.len()),
        Event::Reply { sample, .. } => format!("reply {} {}", sample.key, sample.payload.len()),
        Event::Query { key, .. } => format!("query {key}"),
        Event::ReplyFinal { timed_out, .. } => format!("final {timed_out}"),
        other => format!("{other:?}"),
    };
    events.iter().map(kind).collect()
}

#[test]
fn the_conversation_is_the_same_in_chunks_of_any_length() {
    let mut rig = Rig::plain();
    rig.session.declare_subscriber("a").unwrap();
    rig.exchange().unwrap();
    rig.peer.say([push(key("a"), b"1"), push(key("a"), b"22")]);
    rig.peer.say_keep_alive();
    rig.peer.say_fragmented(push(key("a"), &[3; 333]), 50);
    rig.peer.say_batch(&[]);
    rig.peer.say([push(key("a"), b"4444")]);
    let said = rig.peer.take_said();
    for chunk_bytes in 1..said.len() {
        let mut rig = Rig::plain();
        rig.session.declare_subscriber("a").unwrap();
        rig.exchange().unwrap();
        for chunk in said.chunks(chunk_bytes) {
            rig.session.handle_bytes(rig.now_us, chunk).unwrap();
        }
        let events = rig.take_events();
        let lengths: Vec<usize> = messages(&events).iter().map(|(_, _, p)| p.len()).collect();
        assert_eq!(lengths, [1, 2, 333, 4], "chunks of {chunk_bytes}");
    }
}
