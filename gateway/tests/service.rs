//! The running service as a client sees it: a real zenoh session against a router on a free port.
//!
//! Nothing here sleeps to synchronize: every wait is for a message.

use gateway::{
    config::GatewayConfig,
    security::home::write_secret,
    service::{Service, ServiceError},
};
use keys::{
    AxisStatus, Features, Keys, LocalMicros, NodeId, NodeState, QueueId, Status,
    record::{ErrorCode, ErrorReply, JobRecord, JobState},
    version,
};
use serde_json::{Value, json};
use std::{path::Path, time::Duration};
use zenoh::{
    Session,
    bytes::{Encoding, ZBytes},
    handlers::FifoChannelHandler,
    liveliness::LivelinessToken,
    pubsub::Subscriber,
    qos::CongestionControl,
    query::ConsolidationMode,
    sample::Sample,
};

/// Far more than anything here takes; only a failure waits so long.
const PATIENCE: Duration = Duration::from_secs(60);

struct Bench {
    service: Service,
    client: Session,
    store: tempfile::TempDir,
}

type Answer = Result<Value, ErrorReply>;

async fn client(locator: &str, login: Option<(&str, &str)>) -> zenoh::Result<Session> {
    let mut config = zenoh::Config::default();
    let mut pairs = vec![
        ("mode", "\"client\"".to_owned()),
        ("connect/endpoints", format!("[\"{locator}\"]")),
        ("scouting/multicast/enabled", "false".to_owned()),
        // A busy machine is not to be taken for a dead peer.
        (
            "transport/unicast/open_timeout",
            PATIENCE.as_millis().to_string(),
        ),
        ("transport/link/tx/lease", PATIENCE.as_millis().to_string()),
        (
            "transport/link/tx/queue/congestion_control/block/wait_before_close",
            PATIENCE.as_micros().to_string(),
        ),
    ];
    if let Some((user, password)) = login {
        pairs.push(("transport/auth/usrpwd/user", format!("\"{user}\"")));
        pairs.push(("transport/auth/usrpwd/password", format!("\"{password}\"")));
    }
    for (key, value) in pairs {
        config.insert_json5(key, &value).expect("a known setting");
    }
    zenoh::open(config).await
}

fn config(directory: &Path) -> GatewayConfig {
    GatewayConfig {
        listen: vec!["tcp/127.0.0.1:0".to_owned()],
        ..GatewayConfig::new(directory.join("fleet.redb"))
    }
}

async fn in_time<T>(what: impl Future<Output = T>) -> T {
    tokio::time::timeout(PATIENCE, what).await.expect("in time")
}

impl Bench {
    async fn new() -> Self {
        Self::on(tempfile::tempdir().expect("a directory")).await
    }

    async fn on(store: tempfile::TempDir) -> Self {
        let service = in_time(Service::start(config(store.path())))
            .await
            .expect("started");
        let client = in_time(client(&service.locators()[0], None))
            .await
            .expect("connected");
        Self {
            service,
            client,
            store,
        }
    }

    async fn ask(&self, selector: &str, payload: Option<(&[u8], Encoding)>) -> Vec<Answer> {
        let mut get = self
            .client
            .get(selector)
            .consolidation(ConsolidationMode::None)
            .timeout(PATIENCE);
        if let Some((payload, encoding)) = payload {
            get = get.payload(payload.to_vec()).encoding(encoding);
        }
        let replies = get.await.expect("asked");
        let mut answers = Vec::new();
        while let Ok(reply) = in_time(replies.recv_async()).await {
            answers.push(match reply.result() {
                Ok(sample) => {
                    assert_eq!(*sample.encoding(), Encoding::APPLICATION_JSON);
                    Ok(serde_json::from_slice(&sample.payload().to_bytes()).expect("JSON"))
                }
                Err(error) => {
                    let payload = error.payload().to_bytes();
                    Err(serde_json::from_slice(&payload).expect("an error reply"))
                }
            });
        }
        answers
    }

    /// Gets and expects one refusal.
    async fn refusal(&self, selector: &str, payload: Option<(&[u8], Encoding)>) -> ErrorReply {
        let mut answers = self.ask(selector, payload).await;
        assert_eq!(answers.len(), 1, "{selector}: {answers:?}");
        answers.remove(0).expect_err("a refusal")
    }

    async fn code(&self, selector: &str, payload: Option<(&[u8], Encoding)>) -> ErrorCode {
        self.refusal(selector, payload).await.error.code
    }

    async fn job(&self, node: &str, job: &Value) -> Vec<Answer> {
        let text = job.to_string();
        let payload = (text.as_bytes(), Encoding::APPLICATION_JSON);
        self.ask(&format!("fleet/node/{node}/job"), Some(payload))
            .await
    }

    async fn subscribe(&self, key: &str) -> Subscriber<FifoChannelHandler<Sample>> {
        self.client
            .declare_subscriber(key)
            .with(zenoh::handlers::FifoChannel::new(1_000))
            .await
            .expect("subscribed")
    }

    /// Puts so that nothing is dropped on the way: zenoh's default gives a large message up when
    /// its link is busy for a moment.
    async fn put(&self, key: &str, payload: impl Into<ZBytes>, encoding: Encoding) {
        self.client
            .put(key, payload)
            .encoding(encoding)
            .congestion_control(CongestionControl::Block)
            .await
            .expect("put");
    }

    /// Makes the gateway see a node that is idle and takes no batch.
    async fn fake_node(&self, name: &str) -> LivelinessToken {
        let keys = Keys::default();
        let name = NodeId::new(name).expect("legal");
        let token = self
            .client
            .liveliness()
            .declare_token(keys.node(&name, keys::NodeTopic::Alive).as_str())
            .await
            .expect("declared");
        let status = idle_status();
        let mut buffer = [0; keys::status::STATUS_BYTES_MAX];
        let bytes: &[u8] = version::encode(&status, &mut buffer).expect("room");
        let key = keys.node(&name, keys::NodeTopic::Status);
        self.put(key.as_str(), bytes, Encoding::ZENOH_BYTES).await;
        // Asked behind the status on the same way, so answered behind it. Whether a node that
        // said no more than that still counts as alive is a matter of time.
        let states = self.ask("fleet/node/*/state", None).await;
        let known = |state: &Answer| {
            let state = state.as_ref().expect("a record");
            state["node"] == name.as_str()
        };
        assert!(states.iter().any(known), "{states:?}");
        token
    }

    async fn end(self) -> tempfile::TempDir {
        in_time(async { self.client.close().await })
            .await
            .expect("closed");
        in_time(self.service.shutdown()).await.expect("a clean end");
        self.store
    }
}

fn idle_status() -> Status {
    Status {
        at: LocalMicros(1_000_000),
        queue: QueueId { boot: 7, flush: 0 },
        state: NodeState::Idle,
        stop: None,
        job: None,
        accepted_commands: 0,
        executed_commands: 0,
        credit_commands: 4_096,
        axes: [AxisStatus::default(); 2].into_iter().collect(),
        faults: Default::default(),
        features: Features::BASIC,
        firmware: [0, 1, 0],
        rssi_dbm: None,
        laser_percent: 0,
        lidar_mm: None,
    }
}

fn a_move(id: Option<&str>) -> Value {
    let mut job = json!({"commands": [{"move": {"axis": 0, "delay_us": 500, "steps": 2000}}]});
    if let Some(id) = id {
        job["id"] = id.into();
    }
    job
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn what_cannot_be_done_is_answered_with_its_code() {
    let bench = Bench::new().await;
    let json = Encoding::APPLICATION_JSON;
    let job = a_move(None).to_string();
    let key = "fleet/node/nobody/job";
    assert_eq!(
        bench.code(key, Some((job.as_bytes(), json.clone()))).await,
        ErrorCode::UnknownNode
    );
    assert_eq!(
        bench.code(key, Some((b"{", json.clone()))).await,
        ErrorCode::BadJson
    );
    assert_eq!(bench.code(key, None).await, ErrorCode::BadJson);
    assert_eq!(
        bench
            .code(key, Some((job.as_bytes(), Encoding::IMAGE_PNG)))
            .await,
        ErrorCode::BadJson
    );
    let wrong = br#"{"commands":[{"pause":{"ms":1}},{"move":{"axis":0,"delay_us":0,"steps":1}}]}"#;
    let refusal = bench.refusal(key, Some((wrong, json.clone()))).await.error;
    assert_eq!(refusal.code, ErrorCode::BadCommand);
    assert!(
        refusal.message.starts_with("commands[1].move.delay_us"),
        "{refusal}"
    );
    assert_eq!(
        bench.code("fleet/job/nothing", None).await,
        ErrorCode::BadId
    );
    assert_eq!(
        bench.code("fleet/job/nothing/cancel", None).await,
        ErrorCode::BadId
    );
    assert_eq!(
        bench.code("fleet/node/nobody/release", None).await,
        ErrorCode::UnknownNode
    );
    assert_eq!(
        bench.code("fleet/job/*?limit=many", None).await,
        ErrorCode::BadJson
    );
    let group = br#"{"nodes":{"left":{"commands":[{"pause":{"ms":1}}]}}}"#;
    assert_eq!(
        bench.code("fleet/group/g1/job", Some((group, json))).await,
        ErrorCode::UnknownNode
    );
    assert!(bench.ask("fleet/node/*/state", None).await.is_empty());
    bench.end().await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_refused_put_leaves_a_record_under_the_id_that_it_gave() {
    let bench = Bench::new().await;
    let records = bench.subscribe("fleet/job/*").await;
    let text = a_move(Some("lost-1")).to_string();
    bench
        .put("fleet/node/nobody/job", text, Encoding::APPLICATION_JSON)
        .await;
    let sample = in_time(records.recv_async()).await.expect("open");
    assert_eq!(sample.key_expr().as_str(), "fleet/job/lost-1");
    let record: JobRecord = serde_json::from_slice(&sample.payload().to_bytes()).expect("JSON");
    assert_eq!(record.state, JobState::Rejected);
    assert_eq!(record.error.expect("a reason").code, ErrorCode::UnknownNode);
    let stored = bench.ask("fleet/job/lost-1", None).await;
    assert_eq!(stored[0].as_ref().expect("a record")["state"], "rejected");
    bench.end().await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn the_history_is_newest_first_and_survives_a_restart() {
    let bench = Bench::new().await;
    let token = bench.fake_node("left").await;
    for number in 1..=5 {
        let id = format!("part-{number}");
        let answers = bench.job("left", &a_move(Some(&id))).await;
        assert_eq!(answers.len(), 1);
        assert_eq!(answers[0].as_ref().expect("a receipt")["job"], id.as_str());
    }
    let again = bench.job("left", &a_move(Some("part-3"))).await;
    assert_eq!(again[0].as_ref().expect("a receipt")["job"], "part-3");
    let names = async |bench: &Bench, selector: &str| -> Vec<String> {
        let answers = bench.ask(selector, None).await;
        let jobs = answers.iter().map(|answer| {
            let record = answer.as_ref().expect("a record");
            record["job"].as_str().expect("text").to_owned()
        });
        jobs.collect()
    };
    let newest_first = ["part-5", "part-4", "part-3", "part-2", "part-1"];
    assert_eq!(names(&bench, "fleet/job/*").await, newest_first);
    assert_eq!(
        names(&bench, "fleet/job/*?limit=2").await,
        newest_first[..2]
    );
    assert_eq!(
        names(&bench, "fleet/job/*?node=left;limit=1").await,
        newest_first[..1]
    );
    assert!(names(&bench, "fleet/job/*?node=right").await.is_empty());
    assert!(names(&bench, "fleet/job/*?state=failed").await.is_empty());
    // A tool that looks at everything sees the records and moves nothing.
    assert_eq!(names(&bench, "fleet/job/**").await.len(), 5);

    let answers = bench.ask("fleet/job/part-5/cancel", None).await;
    assert_eq!(answers[0].as_ref().expect("a record")["state"], "canceled");
    let answers = bench.ask("fleet/job/part-$*/cancel", None).await;
    // The ones that had not ended.
    assert_eq!(answers.len(), 4, "{answers:?}");

    drop(token);
    let store = bench.end().await;
    let bench = Bench::on(store).await;
    assert_eq!(names(&bench, "fleet/job/*").await, newest_first);
    assert_eq!(
        names(&bench, "fleet/job/*?state=canceled").await[..1],
        newest_first[..1]
    );
    let nodes = bench.ask("fleet/node/*/state", None).await;
    let node = nodes[0].as_ref().expect("a record");
    assert_eq!(
        (&node["node"], &node["state"]),
        (&json!("left"), &json!("offline"))
    );
    bench.end().await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn jobs_of_one_client_keep_their_order_though_large_ones_take_longer_to_read() {
    let bench = Bench::new().await;
    let token = bench.fake_node("left").await;
    let records = bench.subscribe("fleet/job/*").await;
    let step = json!({"move": {"axis": 0, "delay_us": 500, "steps": 1}});
    let large = json!({"id": "large", "commands": vec![step; 50_000]}).to_string();
    for text in [
        a_move(Some("first")).to_string(),
        large,
        a_move(Some("last")).to_string(),
    ] {
        bench
            .put("fleet/node/left/job", text, Encoding::APPLICATION_JSON)
            .await;
    }
    let mut seen: Vec<String> = Vec::new();
    while seen.len() < 3 {
        let sample = in_time(records.recv_async()).await.expect("open");
        let record: JobRecord = serde_json::from_slice(&sample.payload().to_bytes()).expect("JSON");
        if record.version == 1 {
            seen.push(record.job.to_string());
        }
    }
    assert_eq!(seen, ["first", "large", "last"]);
    drop(token);
    bench.end().await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_store_in_use_and_a_port_in_use_are_told_apart() {
    let bench = Bench::new().await;
    let same_store = config(bench.store.path());
    let error = in_time(Service::start(same_store))
        .await
        .expect_err("locked");
    assert!(matches!(error, ServiceError::Store(_)), "{error}");
    let other = tempfile::tempdir().expect("a directory");
    let mut same_port = config(other.path());
    same_port.listen = bench.service.locators().to_vec();
    let error = in_time(Service::start(same_port))
        .await
        .expect_err("in use");
    assert!(error.to_string().starts_with("cannot listen on"), "{error}");
    bench.end().await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_second_gateway_in_one_network_is_refused_and_one_with_its_own_prefix_is_not() {
    let bench = Bench::new().await;
    let other = tempfile::tempdir().expect("a directory");
    let mut joining = config(other.path());
    joining.connect = bench.service.locators().to_vec();
    let error = in_time(Service::start(joining.clone()))
        .await
        .expect_err("a rival");
    assert!(error.to_string().contains("another gateway"), "{error}");
    joining.keys = Keys::new("plant-2").expect("legal");
    let second = in_time(Service::start(joining)).await.expect("started");
    let text = a_move(None).to_string();
    let payload = (text.as_bytes(), Encoding::APPLICATION_JSON);
    assert_eq!(
        bench.code("plant-2/node/nobody/job", Some(payload)).await,
        ErrorCode::UnknownNode
    );
    in_time(second.shutdown()).await.expect("a clean end");
    bench.end().await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_gateway_that_begins_anew_in_its_process_is_found_where_it_was() {
    let store = tempfile::tempdir().expect("a directory");
    let mut config = config(store.path());
    let mut where_it_was = None;
    for _ in 0..3 {
        let service = in_time(Service::start(config.clone()))
            .await
            .expect("started");
        config.listen = service.locators().to_vec();
        let before = where_it_was.replace(config.listen.clone());
        assert!(before.is_none_or(|before| before == config.listen));
        let client = in_time(client(&config.listen[0], None)).await;
        let client = client.expect("connected");
        in_time(async { client.close().await })
            .await
            .expect("closed");
        in_time(service.shutdown()).await.expect("a clean end");
    }
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn with_a_users_file_only_its_users_get_in() {
    let store = tempfile::tempdir().expect("a directory");
    let users = store.path().join("users.txt");
    let mut guarded = config(store.path());
    guarded.users = Some(users.clone());
    #[cfg(unix)]
    {
        use std::os::unix::fs::PermissionsExt as _;
        std::fs::write(&users, "gateway:own\n").expect("written");
        let all = std::fs::Permissions::from_mode(0o644);
        std::fs::set_permissions(&users, all).expect("ours");
        let error = in_time(Service::start(guarded.clone()))
            .await
            .expect_err("others may read it");
        assert!(error.to_string().contains("chmod 600"), "{error}");
    }
    write_secret(&users, "operator:secret\n").expect("written");
    let error = in_time(Service::start(guarded.clone()))
        .await
        .expect_err("no entry for the gateway");
    assert!(error.to_string().contains("gateway:PASSWORD"), "{error}");
    write_secret(&users, "gateway:own\noperator:secret\n").expect("written");
    let service = in_time(Service::start(guarded)).await.expect("started");
    let locator = service.locators()[0].clone();
    assert!(in_time(client(&locator, None)).await.is_err());
    assert!(
        in_time(client(&locator, Some(("operator", "wrong"))))
            .await
            .is_err()
    );
    let client = in_time(client(&locator, Some(("operator", "secret"))))
        .await
        .expect("connected");
    let bench = Bench {
        service,
        client,
        store,
    };
    assert_eq!(
        bench.code("fleet/job/nothing", None).await,
        ErrorCode::BadId
    );
    bench.end().await;
}
