//! An emulated node over real TCP to a router of the zenoh crate in this process.
//!
//! Nothing here sleeps to synchronize: every wait is for a message.

use emulator::{EmulatedHandle, EmulatorConfig, Recording, oracle, scout::ScoutConfig, spawn};
use keys::{
    AxisId, BatchAck, BatchHeader, Command, JobId, Keys, NodeId, NodeState, NodeTopic, Order,
    QueueId, Setup, Status, Verdict,
    batch::{BatchWriter, ORDER_BYTES_MAX},
    clock::{ClockMessage, ClockProbe},
    version,
    vitals::{VITALS_US, Vitals},
};
use std::{
    net::{Ipv4Addr, SocketAddrV4, TcpListener, UdpSocket},
    time::Duration,
};
use zenoh::{
    Config, Session,
    handlers::FifoChannelHandler,
    pubsub::Subscriber,
    qos::CongestionControl,
    sample::{Sample, SampleKind},
};

/// Far more than anything here takes; only a failure waits so long.
const PATIENCE: Duration = Duration::from_secs(60);

/// How often a port that was free and then taken by somebody else is replaced by another one.
const PORT_ATTEMPTS_MAX: usize = 16;

/// Opens a router on a port that was free a moment ago; taken meanwhile, on another one.
async fn router() -> (Session, String) {
    router_with(&[("scouting/multicast/enabled", "false".to_owned())]).await
}

/// The same with more settings.
async fn router_with(more: &[(&str, String)]) -> (Session, String) {
    let mut attempts = 0;
    loop {
        attempts += 1;
        let port = TcpListener::bind((Ipv4Addr::LOCALHOST, 0))
            .and_then(|listener| listener.local_addr())
            .expect("a free port")
            .port();
        let locator = format!("tcp/127.0.0.1:{port}");
        let mut config = Config::default();
        for (key, value) in [
            ("mode", "\"router\"".to_owned()),
            ("listen/endpoints", format!("[\"{locator}\"]")),
            // A busy machine is not to be taken for a dead peer.
            (
                "transport/unicast/accept_timeout",
                PATIENCE.as_millis().to_string(),
            ),
            // All nodes of a test may knock at the same time.
            ("transport/unicast/accept_pending", "1000".to_owned()),
            ("transport/link/tx/lease", PATIENCE.as_millis().to_string()),
            (
                "transport/link/tx/queue/congestion_control/block/wait_before_close",
                PATIENCE.as_micros().to_string(),
            ),
        ] {
            config.insert_json5(key, &value).expect("a known setting");
        }
        for (key, value) in more {
            config.insert_json5(key, value).expect("a known setting");
        }
        match zenoh::open(config).await {
            Ok(session) => return (session, locator),
            Err(error) => assert!(attempts < PORT_ATTEMPTS_MAX, "{error}"),
        }
    }
}

/// Puts so that nothing is dropped on the way.
async fn put(router: &Session, key: &str, payload: &[u8]) {
    router
        .put(key, payload)
        .congestion_control(CongestionControl::Block)
        .await
        .expect("put");
}

struct Bench {
    router: Session,
    keys: Keys,
    name: NodeId,
    acks: Subscriber<FifoChannelHandler<Sample>>,
    statuses: Subscriber<FifoChannelHandler<Sample>>,
    clock: Subscriber<FifoChannelHandler<Sample>>,
    alive: Subscriber<FifoChannelHandler<Sample>>,
    node: EmulatedHandle,
}

async fn next(of: &Subscriber<FifoChannelHandler<Sample>>) -> Sample {
    tokio::time::timeout(PATIENCE, of.recv_async())
        .await
        .expect("a message in time")
        .expect("an open session")
}

impl Bench {
    async fn new(name: &str, configure: impl FnOnce(&mut EmulatorConfig)) -> Self {
        let (router, locator) = router().await;
        let keys = Keys::default();
        let name = NodeId::new(name).expect("legal");
        let key = |topic| keys.node(&name, topic).as_str().to_owned();
        let subscribe = async |topic| {
            router
                .declare_subscriber(key(topic))
                .await
                .expect("subscribed")
        };
        let acks = subscribe(NodeTopic::Ack).await;
        let statuses = subscribe(NodeTopic::Status).await;
        let clock = subscribe(NodeTopic::Clock).await;
        let alive = router
            .liveliness()
            .declare_subscriber(key(NodeTopic::Alive))
            .await
            .expect("subscribed");
        let mut config = EmulatorConfig::new(name);
        config.connect = locator;
        config.record = Recording::Edges { max: 1_000_000 };
        configure(&mut config);
        let node = spawn(config).expect("spawned");
        let bench = Self {
            router,
            keys,
            name,
            acks,
            statuses,
            clock,
            alive,
            node,
        };
        assert_eq!(next(&bench.alive).await.kind(), SampleKind::Put);
        bench
    }

    async fn put(&self, topic: NodeTopic, payload: &[u8]) {
        let key = self.keys.node(&self.name, topic);
        put(&self.router, key.as_str(), payload).await;
    }

    async fn status_where(&self, wanted: impl Fn(&Status) -> bool) -> Status {
        loop {
            let sample = next(&self.statuses).await;
            let status = version::decode(&sample.payload().to_bytes()).expect("a status");
            if wanted(&status) {
                return status;
            }
        }
    }

    async fn batch(&self, queue: QueueId, first_command: u64, commands: &[Command]) -> BatchAck {
        let mut writer = BatchWriter::new();
        for command in commands {
            assert!(writer.push(command));
        }
        let header = BatchHeader {
            queue,
            first_command,
            command_count: 0,
            job: JobId::new("j").expect("legal"),
            job_end: first_command + commands.len() as u64,
        };
        let mut buffer = [0; ORDER_BYTES_MAX];
        let bytes = writer.finish(header, &mut buffer).expect("room");
        self.put(NodeTopic::Batch, bytes).await;
        self.ack().await
    }

    async fn order(&self, order: &Order) -> BatchAck {
        let mut buffer = [0; 64];
        let bytes = version::encode(order, &mut buffer).expect("room");
        self.put(NodeTopic::Batch, bytes).await;
        self.ack().await
    }

    async fn ack(&self) -> BatchAck {
        let sample = next(&self.acks).await;
        version::decode(&sample.payload().to_bytes()).expect("an ack")
    }
}

fn steps(steps: i32) -> Command {
    steps_apart(50, steps)
}

fn steps_apart(delay_us: u32, steps: i32) -> Command {
    Command::Move {
        axis: AxisId(0),
        delay_us,
        steps,
    }
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn orders_become_pulses_and_a_wild_stop_ends_them() {
    let bench = Bench::new("left", |_| {}).await;
    let status = bench.status_where(|_| true).await;
    assert_eq!(status.state, NodeState::Idle);
    assert_eq!(status.credit_commands, 4096);

    let ack = bench
        .batch(status.queue, 0, &[steps(2_000), steps(-500)])
        .await;
    assert_eq!(ack.verdict, Verdict::Accepted);
    let ack = bench
        .batch(status.queue, 0, &[steps(2_000), steps(-500)])
        .await;
    assert_eq!(ack.verdict, Verdict::Duplicate);
    let done = bench
        .status_where(|status| status.executed_commands == 2 && status.state == NodeState::Idle)
        .await;
    assert_eq!(done.axes[0].position_steps, 1_500);

    // An hour of motion, ended by a stop for every node long before the record is full.
    let ack = bench
        .batch(status.queue, 2, &[steps_apart(1_000, 3_600_000)])
        .await;
    assert_eq!(ack.verdict, Verdict::Accepted);
    bench
        .status_where(|status| status.axes[0].position_steps > 1_600)
        .await;
    let every = bench.keys.every_node(NodeTopic::Stop);
    put(&bench.router, every.as_str(), b"").await;
    let stopped = bench.status_where(|status| status.stop.is_some()).await;
    assert_eq!(stopped.state, NodeState::Stopped);
    let report = stopped.stop.expect("a report");
    assert_eq!(report.queue, status.queue);
    assert_eq!(report.positions_steps[0], stopped.axes[0].position_steps);

    let ack = bench.batch(stopped.queue, 0, &[steps(5)]).await;
    assert_eq!(ack.verdict, Verdict::Refused(keys::Refusal::Stopped));
    let ack = bench
        .order(&Order::Release {
            queue: stopped.queue,
        })
        .await;
    assert_eq!(ack.verdict, Verdict::Accepted);
    let ack = bench.batch(stopped.queue, 0, &[steps(5)]).await;
    assert_eq!(ack.verdict, Verdict::Accepted);
    let done = bench
        .status_where(|status| status.executed_commands == 1)
        .await;
    assert_eq!(
        done.axes[0].position_steps,
        stopped.axes[0].position_steps + 5
    );

    let lives = bench.node.shutdown().await;
    assert_eq!(lives.len(), 1);
    assert_eq!(lives[0].commands.len(), 4);
    assert_eq!(lives[0].counted_steps[0], done.axes[0].position_steps);
    if let Err(violations) = oracle::check_life(&lives[0]) {
        panic!("{violations:?}");
    }
}

/// What a plain zenoh client gets: the JSON of the answer, or of the refusal; `None`: nobody answered.
async fn ask(
    router: &Session,
    key: &str,
    request: &str,
) -> Option<Result<serde_json::Value, serde_json::Value>> {
    let get = router.get(key).payload(request).timeout(PATIENCE);
    let replies = get.await.expect("asked");
    let reply = replies.recv_async().await.ok()?;
    let json = |bytes: &[u8]| serde_json::from_slice(bytes).expect("JSON");
    Some(match reply.result() {
        Ok(sample) => Ok(json(&sample.payload().to_bytes())),
        Err(error) => Err(json(&error.payload().to_bytes())),
    })
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_jog_is_answered_by_the_node_itself_and_rests_when_nobody_renews_it() {
    let bench = Bench::new("left", |_| {}).await;
    bench.status_where(|_| true).await;
    let key = bench.keys.node(&bench.name, NodeTopic::Jog);
    let run = r#"{"axis":1,"run":"backward","speed_hz":2000,"accel":20000,"lease_ms":200}"#;
    // One button moves one machine.
    let wild = bench.keys.every_node(NodeTopic::Jog);
    assert_eq!(ask(&bench.router, wild.as_str(), run).await, None);
    let refused = ask(&bench.router, key.as_str(), r#"{"axis":1,"run":"up"}"#).await;
    let refused = refused.expect("an answer").expect_err("a refusal");
    assert_eq!(refused["error"]["code"], "bad_json");
    let answer = ask(&bench.router, key.as_str(), run).await;
    let answer = answer.expect("an answer").expect("it is taken");
    assert_eq!(answer["node"], "left");
    assert_eq!(answer["lease_ms"], 200);
    bench
        .status_where(|status| status.axes[1].position_steps < 0)
        .await;
    // Nobody renews it.
    let rests = bench
        .status_where(|status| status.state == NodeState::Idle)
        .await;
    let lives = bench.node.shutdown().await;
    assert_eq!(lives[0].counted_steps[1], rests.axes[1].position_steps);
    assert_eq!(lives[0].drives.len(), 1);
    if let Err(violations) = oracle::check_life(&lives[0]) {
        panic!("{violations:?}");
    }
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_clock_probe_is_answered_in_the_nodes_own_time() {
    let bench = Bench::new("left", |config| config.clock_offset_us = 3_600_000_000).await;
    let probe = ClockProbe {
        probe: 5,
        sent_at: keys::FleetMicros(77),
    };
    let mut buffer = [0; 64];
    let bytes = version::encode(&ClockMessage::Probe(probe), &mut buffer).expect("room");
    bench.put(NodeTopic::Clock, bytes).await;
    let reply = loop {
        let sample = next(&bench.clock).await;
        match version::decode(&sample.payload().to_bytes()) {
            Ok(ClockMessage::Reply(reply)) => break reply,
            // Our own probe.
            Ok(ClockMessage::Probe(_)) => {}
            Err(error) => panic!("{error}"),
        }
    };
    assert_eq!((reply.probe, reply.sent_at.0), (5, 77));
    assert!(reply.received_at.0 >= 3_600_000_000);
    assert!(reply.replied_at >= reply.received_at);
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_node_that_was_told_no_router_finds_it_by_scouting() {
    // A group of this test's own, in the loopback network.
    let port = UdpSocket::bind((Ipv4Addr::LOCALHOST, 0))
        .and_then(|socket| socket.local_addr())
        .expect("a free port")
        .port();
    let group = SocketAddrV4::new(Ipv4Addr::new(224, 0, 0, 224), port);
    let mut config = EmulatorConfig::new(NodeId::new("left").expect("legal"));
    config.connect = String::new();
    config.scout = ScoutConfig {
        from: Ipv4Addr::LOCALHOST,
        group,
    };
    // It asks before there is anybody, and again.
    let node = spawn(config).expect("spawned");
    let (router, _) = router_with(&[
        ("scouting/multicast/enabled", "true".to_owned()),
        ("scouting/multicast/address", format!("\"{group}\"")),
        ("scouting/multicast/interface", "\"127.0.0.1\"".to_owned()),
    ])
    .await;
    let statuses = router
        .declare_subscriber("fleet/node/left/status")
        .with(zenoh::handlers::FifoChannel::new(1_000))
        .await
        .expect("subscribed");
    next(&statuses).await;
    let _ = node.shutdown().await;
    router.close().await.expect("closed");
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn vitals_are_said_when_the_link_comes_and_each_ten_seconds_behind_it() {
    let (router, locator) = router().await;
    let vitals = router
        .declare_subscriber("fleet/node/left/vitals")
        .with(zenoh::handlers::FifoChannel::new(1_000))
        .await
        .expect("subscribed");
    let mut config = EmulatorConfig::new(NodeId::new("left").expect("legal"));
    config.connect = locator;
    config.clock_offset_us = 3_600_000_000;
    let node = spawn(config).expect("spawned");
    let told = async || {
        let sample = next(&vitals).await;
        Vitals::decode(&sample.payload().to_bytes()).expect("vitals")
    };
    let first = told().await;
    assert!(first.at.0 >= 3_600_000_000);
    let uptime_s = first.uptime_s.expect("it knows");
    assert!(u64::from(uptime_s) < PATIENCE.as_secs(), "since its boot");
    let nothing_else = Vitals {
        at: first.at,
        uptime_s: first.uptime_s,
        ..Vitals::default()
    };
    assert_eq!(first, nothing_else, "an emulated node knows no chip");
    node.jump_clock(VITALS_US);
    let second = told().await;
    assert!(second.at.since_us(first.at) >= VITALS_US);
    assert!(second.uptime_s >= Some(uptime_s + 10));
    let _ = node.shutdown().await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn the_node_itself_answers_who_asks_for_its_setup_by_its_name_or_a_wild_key() {
    let bench = Bench::new("left", |config| config.ring_commands = 77).await;
    for asked in ["fleet/node/left/setup", "fleet/node/*/setup"] {
        let replies = bench.router.get(asked).await.expect("asked");
        let reply = replies.recv_async().await.expect("answered");
        let sample = reply.result().expect("no error");
        assert_eq!(sample.key_expr().as_str(), "fleet/node/left/setup");
        let setup = Setup::from_json(&sample.payload().to_bytes()).expect("a setup");
        assert_eq!(setup.name, Some(bench.name));
        assert_eq!(setup.ring_commands, 77);
        assert!(setup.link.router.starts_with("tcp/127.0.0.1:"));
        assert!(replies.recv_async().await.is_err(), "answered once");
    }
    let _ = bench.node.shutdown().await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_node_that_is_gone_takes_its_token_along() {
    let bench = Bench::new("left", |_| {}).await;
    let _ = bench.node.shutdown().await;
    // The router may say more than once that the node is there, but then that it is gone.
    while next(&bench.alive).await.kind() != SampleKind::Delete {}
}

/// Its token says nothing here: a router that sees the new connection before the end of the
/// old one never misses the node. Only the queue's id tells a reboot.
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_reboot_brings_another_queue() {
    let bench = Bench::new("left", |_| {}).await;
    let first = bench.status_where(|_| true).await;
    bench.node.reset();
    let second = bench
        .status_where(|status| status.queue != first.queue)
        .await;
    assert_ne!(second.queue.boot, first.queue.boot);
    assert_eq!(second.queue.flush, 0);
    let lives = bench.node.shutdown().await;
    assert_eq!(lives.len(), 2);
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_hundred_nodes_run_in_one_process_and_one_stop_reaches_all() {
    let (router, locator) = router().await;
    let keys = Keys::default();
    let statuses = router
        .declare_subscriber(keys.every_node(NodeTopic::Status).as_str())
        .with(zenoh::handlers::FifoChannel::new(100_000))
        .await
        .expect("subscribed");
    let nodes: Vec<_> = (1..=100)
        .map(|number| {
            let name = NodeId::new(&format!("node-{number}")).expect("legal");
            let mut config = EmulatorConfig::new(name);
            config.connect = locator.clone();
            spawn(config).expect("spawned")
        })
        .collect();
    let mut seen = std::collections::HashSet::new();
    while seen.len() < nodes.len() {
        seen.insert(next(&statuses).await.key_expr().to_string());
    }
    let every = keys.every_node(NodeTopic::Stop);
    put(&router, every.as_str(), b"").await;
    let mut stopped = std::collections::HashSet::new();
    while stopped.len() < nodes.len() {
        let sample = next(&statuses).await;
        let status: Status = version::decode(&sample.payload().to_bytes()).expect("a status");
        if status.state == NodeState::Stopped {
            stopped.insert(sample.key_expr().to_string());
        }
    }
    for node in nodes {
        let _ = node.shutdown().await;
    }
    router.close().await.expect("closed");
}
