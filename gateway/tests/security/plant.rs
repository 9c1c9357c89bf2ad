//! A secured fleet on this machine, and sessions of those who may connect to it.

use emulator::{EmulatorConfig, wall};
use gateway::{
    bus::limits::ClientLimits,
    config::GatewayConfig,
    security::{Home, Role},
    service::Service,
};
use keys::{
    NodeId,
    credentials::Credentials,
    record::{ErrorReply, NodeRecord},
};
use serde_json::{Value, json};
use std::time::Duration;
use zenoh::{Session, bytes::Encoding, qos::CongestionControl, query::ConsolidationMode};

/// Far more than anything here takes; only a failure waits so long.
pub(crate) const PATIENCE: Duration = Duration::from_secs(60);

pub(crate) struct Plant {
    pub(crate) service: Service,
    pub(crate) home: Home,
    pub(crate) folder: tempfile::TempDir,
}

pub(crate) async fn in_time<T>(what: impl IntoFuture<Output = T>) -> T {
    tokio::time::timeout(PATIENCE, what).await.expect("in time")
}

pub(crate) fn name(text: &str) -> NodeId {
    NodeId::new(text).expect("legal")
}

pub(crate) async fn session(to: &str, credentials: Option<&Credentials>) -> zenoh::Result<Session> {
    let mut config = zenoh::Config::default();
    let pairs = [
        ("mode", json!("client")),
        ("connect/endpoints", json!([to])),
        ("scouting/multicast/enabled", json!(false)),
        ("transport/unicast/open_timeout", json!(60_000)),
    ];
    let mut pairs: Vec<(&str, String)> = pairs.map(|(key, value)| (key, value.to_string())).into();
    if let Some(credentials) = credentials {
        pairs.extend(credentials.zenoh_settings());
    }
    for (key, value) in pairs {
        config.insert_json5(key, &value).expect("known");
    }
    zenoh::open(config).await
}

impl Plant {
    /// A secured fleet with two operators, a viewer and two nodes that may connect.
    pub(crate) async fn new() -> Self {
        Self::with(ClientLimits::default()).await
    }

    pub(crate) async fn with(limits: ClientLimits) -> Self {
        let folder = tempfile::tempdir().expect("a folder");
        let home = folder.path().join("home");
        let mut made = Home::init(&home, &[]).expect("made");
        for (user, role) in [
            ("alice", Role::Operator),
            ("carol", Role::Operator),
            ("bob", Role::Viewer),
            ("left", Role::Node),
            ("right", Role::Node),
        ] {
            made.add(name(user), role).expect("added");
        }
        Self::start(folder, made, limits).await
    }

    /// Ends the gateway, changes its home and starts it again.
    pub(crate) async fn begun_anew(self, change: impl FnOnce(&mut Home)) -> Self {
        let Self {
            service,
            mut home,
            folder,
        } = self;
        in_time(service.shutdown()).await.expect("a clean end");
        change(&mut home);
        Self::start(folder, home, ClientLimits::default()).await
    }

    /// Starts the gateway of a fleet that stands in `home` below the folder.
    pub(crate) async fn start(folder: tempfile::TempDir, home: Home, limits: ClientLimits) -> Self {
        let config = GatewayConfig {
            listen: vec!["tls/127.0.0.1:0".into(), "tcp/127.0.0.1:0".into()],
            secure: Some(folder.path().join("home")),
            limits,
            ..GatewayConfig::new(folder.path().join("fleet.redb"))
        };
        Self {
            service: in_time(Service::start(config)).await.expect("started"),
            home,
            folder,
        }
    }

    pub(crate) fn tls(&self) -> &str {
        &self.service.locators()[0]
    }

    pub(crate) fn tcp(&self) -> &str {
        &self.service.locators()[1]
    }

    pub(crate) fn credentials(&self, user: &str) -> Credentials {
        let mut users = self.home.users().iter();
        let user = users.find(|entry| entry.name.as_str() == user);
        self.home.credentials(user.expect("one of ours"))
    }

    pub(crate) async fn session(&self, user: &str) -> Session {
        let node = ["left", "right"].contains(&user);
        let to = if node { self.tcp() } else { self.tls() };
        let session = in_time(session(to, Some(&self.credentials(user)))).await;
        session.expect("connected")
    }

    /// An emulated node with its own credentials.
    pub(crate) fn emulator(&self, node: &str) -> EmulatorConfig {
        let credentials = self.credentials(node);
        let mut config = EmulatorConfig::new(name(node));
        config.connect = self.tcp().to_owned();
        config.credentials = Some(emulator::config::Credentials {
            user: credentials.user,
            password: credentials.password,
        });
        config
    }

    /// Switches one on.
    pub(crate) fn node(&self, node: &str) -> wall::EmulatedHandle {
        wall::spawn(self.emulator(node)).expect("spawned")
    }
}

pub(crate) async fn ask(
    session: &Session,
    key: &str,
    payload: Option<&Value>,
) -> Vec<Result<Value, ErrorReply>> {
    let mut get = session
        .get(key)
        .consolidation(ConsolidationMode::None)
        .timeout(PATIENCE);
    if let Some(payload) = payload {
        get = get
            .payload(payload.to_string())
            .encoding(Encoding::APPLICATION_JSON);
    }
    let replies = in_time(get).await.expect("asked");
    let mut answers = Vec::new();
    while let Ok(reply) = in_time(replies.recv_async()).await {
        let read = |bytes: &[u8]| serde_json::from_slice::<Value>(bytes).expect("JSON");
        answers.push(match reply.result() {
            Ok(sample) => Ok(read(&sample.payload().to_bytes())),
            Err(error) => {
                let error = read(&error.payload().to_bytes());
                Err(serde_json::from_value(error).expect("an error reply"))
            }
        });
    }
    answers
}

pub(crate) async fn put(session: &Session, key: &str, payload: impl Into<zenoh::bytes::ZBytes>) {
    let put = session
        .put(key, payload)
        .encoding(Encoding::APPLICATION_JSON)
        .congestion_control(CongestionControl::Block);
    in_time(put).await.expect("put");
}

/// Follows a node's records until one is as wanted.
pub(crate) async fn until(
    session: &Session,
    node: &str,
    is_so: impl Fn(&NodeRecord) -> bool,
) -> NodeRecord {
    let key = format!("fleet/node/{node}/state");
    let follow = in_time(session.declare_subscriber(&key)).await;
    let follow = follow.expect("declared");
    for answer in ask(session, &key, None).await.into_iter().flatten() {
        let record: NodeRecord = serde_json::from_value(answer).expect("a node record");
        if is_so(&record) {
            return record;
        }
    }
    loop {
        let sample = in_time(follow.recv_async()).await.expect("a record");
        let record: NodeRecord =
            serde_json::from_slice(&sample.payload().to_bytes()).expect("a node record");
        if is_so(&record) {
            return record;
        }
    }
}

pub(crate) async fn job_exists(operator: &Session, job: &str) -> bool {
    let answers = ask(operator, &format!("fleet/job/{job}"), None).await;
    answers.iter().any(Result::is_ok)
}

pub(crate) fn job(id: &str) -> Value {
    json!({"id": id, "commands": [{"move": {"axis": 0, "delay_us": 500, "steps": 20}}]})
}
