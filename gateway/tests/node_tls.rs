//! Nodes that speak TLS 1.3 to the router of a secured fleet: a real router, a real socket, and
//! somebody in between.

#[cfg(unix)]
mod program;

use emulator::{EmulatorConfig, wall};
use gateway::{
    config::GatewayConfig,
    security::{Home, Role},
    service::Service,
};
use keys::{
    NodeId,
    credentials::Credentials,
    record::{JobRecord, NodeRecord},
};
use serde_json::json;
use std::{
    path::PathBuf,
    sync::{
        Arc, Mutex,
        atomic::{AtomicBool, Ordering},
    },
    time::Duration,
};
use tokio::{
    io::{AsyncReadExt as _, AsyncWriteExt as _},
    net::{TcpListener, TcpStream},
};
use zenoh::{Session, handlers::FifoChannelHandler, pubsub::Subscriber, sample::Sample};

/// Far more than anything here takes; only a failure waits so long.
const PATIENCE: Duration = Duration::from_secs(60);

async fn in_time<T>(what: impl IntoFuture<Output = T>) -> T {
    tokio::time::timeout(PATIENCE, what).await.expect("in time")
}

struct Plant {
    service: Service,
    home: Home,
    folder: tempfile::TempDir,
}

impl Plant {
    /// A secured fleet that listens by TLS only, for everybody.
    async fn new(hosts: &[String]) -> Self {
        let folder = tempfile::tempdir().expect("a folder");
        let path = folder.path().join("home");
        let mut home = Home::init(&path, hosts).expect("made");
        for (user, role) in [("alice", Role::Operator), ("left", Role::Node)] {
            let name = NodeId::new(user).expect("legal");
            home.add(name, role).expect("added");
        }
        let config = GatewayConfig {
            listen: vec!["tls/127.0.0.1:0".into()],
            secure: Some(path),
            ..GatewayConfig::new(folder.path().join("fleet.redb"))
        };
        let service = in_time(Service::start(config)).await.expect("started");
        Self {
            service,
            home,
            folder,
        }
    }

    fn port(&self) -> u16 {
        let locator = &self.service.locators()[0];
        let port = locator.rsplit(':').next().expect("a port");
        port.parse().expect("a port")
    }

    fn ca(&self) -> PathBuf {
        self.folder.path().join("home/ca.pem")
    }

    fn credentials(&self, user: &str) -> Credentials {
        let mut users = self.home.users().iter();
        let user = users.find(|entry| entry.name.as_str() == user);
        self.home.credentials(user.expect("one of ours"))
    }

    /// What the node `left` is told.
    fn left(&self, connect: String) -> EmulatorConfig {
        let credentials = self.credentials("left");
        let ca = std::fs::read(self.ca()).expect("there");
        EmulatorConfig {
            connect,
            authority: Some(tls::Authority::from_pem(&ca).expect("an authority")),
            credentials: Some(emulator::config::Credentials {
                user: credentials.user,
                password: credentials.password,
            }),
            ..EmulatorConfig::new(NodeId::new("left").expect("legal"))
        }
    }

    async fn operator(&self) -> Session {
        let mut config = zenoh::Config::default();
        let to = format!("tls/localhost:{}", self.port());
        let mut pairs = vec![
            ("mode", json!("client").to_string()),
            ("connect/endpoints", json!([to]).to_string()),
            ("scouting/multicast/enabled", json!(false).to_string()),
        ];
        pairs.extend(self.credentials("alice").zenoh_settings());
        for (key, value) in pairs {
            config.insert_json5(key, &value).expect("known");
        }
        in_time(zenoh::open(config)).await.expect("connected")
    }
}

type Records = Subscriber<FifoChannelHandler<Sample>>;

async fn follow(operator: &Session, key: &str) -> Records {
    let records = in_time(operator.declare_subscriber(key)).await;
    records.expect("declared")
}

/// Follows a node until it is alive, or gone.
async fn until_alive(records: &Records, alive: bool) {
    loop {
        let sample = in_time(records.recv_async()).await.expect("a record");
        let bytes = sample.payload().to_bytes();
        let record: NodeRecord = serde_json::from_slice(&bytes).expect("a node record");
        if record.alive == alive && (!alive || record.clock.is_some()) {
            return;
        }
    }
}

/// Hands in a job and follows it to its end.
async fn play(operator: &Session, id: &str) {
    let records = follow(operator, &format!("fleet/job/{id}")).await;
    let job = json!({"id": id, "commands": [{"move": {"axis": 0, "delay_us": 500, "steps": 20}}]});
    let get = operator
        .get("fleet/node/left/job")
        .payload(job.to_string())
        .encoding(zenoh::bytes::Encoding::APPLICATION_JSON)
        .timeout(PATIENCE);
    let replies = in_time(get).await.expect("asked");
    let reply = in_time(replies.recv_async()).await.expect("a receipt");
    assert!(reply.result().is_ok(), "{reply:?}");
    loop {
        let sample = in_time(records.recv_async()).await.expect("a record");
        let bytes = sample.payload().to_bytes();
        let record: JobRecord = serde_json::from_slice(&bytes).expect("a job record");
        if record.state.is_final() {
            assert_eq!(record.state.as_str(), "succeeded", "{record:?}");
            return;
        }
    }
}

/// Waits until a node says why it does not speak to a router.
async fn refusal(node: &wall::EmulatedHandle) -> String {
    in_time(async {
        loop {
            match node.refusal() {
                Some(why) => return why,
                None => tokio::task::yield_now().await,
            }
        }
    })
    .await
}

/// Somebody between node and router, who listens to everything and can change a byte.
struct Between {
    port: u16,
    seen: Arc<Mutex<Vec<u8>>>,
    changes: Arc<AtomicBool>,
}

impl Between {
    async fn new(router: u16) -> Self {
        let listener = TcpListener::bind("127.0.0.1:0").await.expect("a port");
        let port = listener.local_addr().expect("an address").port();
        let (seen, changes) = (Arc::default(), Arc::new(AtomicBool::new(false)));
        let between = Self {
            port,
            seen: Arc::clone(&seen),
            changes: Arc::clone(&changes),
        };
        tokio::spawn(async move {
            while let Ok((node, _)) = listener.accept().await {
                let Ok(router) = TcpStream::connect(("127.0.0.1", router)).await else {
                    return;
                };
                let (from_node, to_node) = node.into_split();
                let (from_router, to_router) = router.into_split();
                tokio::spawn(pass(from_node, to_router, seen.clone(), Arc::default()));
                tokio::spawn(pass(from_router, to_node, seen.clone(), changes.clone()));
            }
        });
        between
    }
}

/// Passes bytes on until one side ends; changes the last byte of a piece when it is told to, once.
async fn pass(
    mut from: tokio::net::tcp::OwnedReadHalf,
    mut to: tokio::net::tcp::OwnedWriteHalf,
    seen: Arc<Mutex<Vec<u8>>>,
    changes: Arc<AtomicBool>,
) {
    let mut buffer = [0; 4096];
    while let Ok(count @ 1..) = from.read(&mut buffer).await {
        seen.lock()
            .expect("whole")
            .extend_from_slice(&buffer[..count]);
        if changes.swap(false, Ordering::Relaxed) {
            buffer[count - 1] ^= 1;
        }
        if to.write_all(&buffer[..count]).await.is_err() {
            return;
        }
    }
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_node_works_over_tls_and_whoever_listens_sees_nothing_and_changes_nothing() {
    let plant = Plant::new(&[]).await;
    let between = Between::new(plant.port()).await;
    let alice = plant.operator().await;
    let records = follow(&alice, "fleet/node/left/state").await;
    let left = wall::spawn(plant.left(format!("tls/localhost:{}", between.port)));
    let left = left.expect("spawned");
    until_alive(&records, true).await;
    play(&alice, "one").await;
    // A byte that is changed on the way ends the connection; the next one goes on.
    between.changes.store(true, Ordering::Relaxed);
    until_alive(&records, false).await;
    until_alive(&records, true).await;
    play(&alice, "two").await;
    assert_eq!(left.position_steps(keys::AxisId(0)), 40);
    let seen = between.seen.lock().expect("whole").clone();
    for word in [&b"fleet"[..], b"left", b"status"] {
        let shows = seen.windows(word.len()).any(|window| window == word);
        assert!(!shows, "{}", String::from_utf8_lossy(word));
    }
    in_time(left.shutdown()).await;
    in_time(plant.service.shutdown())
        .await
        .expect("a clean end");
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_router_of_another_fleet_or_another_name_is_refused_in_words() {
    let plant = Plant::new(&[]).await;
    let other = Plant::new(&["other.local".to_owned()]).await;
    let foreign = wall::spawn(plant.left(format!("tls/localhost:{}", other.port())));
    let foreign = foreign.expect("spawned");
    assert_eq!(
        refusal(&foreign).await,
        "the router's certificate is not signed by the authority that this node trusts"
    );
    // Whoever passes on everything from an address that is not in the certificate.
    let listener = TcpListener::bind("127.0.0.2:0").await.expect("a port");
    let port = listener.local_addr().expect("an address").port();
    let router = plant.port();
    tokio::spawn(async move {
        while let Ok((mut node, _)) = listener.accept().await {
            let mut router = TcpStream::connect(("127.0.0.1", router))
                .await
                .expect("there");
            // Until one of the two has enough.
            let _ = tokio::io::copy_bidirectional(&mut node, &mut router).await;
        }
    });
    let elsewhere = wall::spawn(plant.left(format!("tls/127.0.0.2:{port}")));
    let elsewhere = elsewhere.expect("spawned");
    assert_eq!(
        refusal(&elsewhere).await,
        "the router's certificate is not for the name under which this node reaches it"
    );
    assert!(!foreign.link_up() && !elsewhere.link_up());
    in_time(foreign.shutdown()).await;
    in_time(elsewhere.shutdown()).await;
    for plant in [plant, other] {
        in_time(plant.service.shutdown())
            .await
            .expect("a clean end");
    }
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_node_that_was_told_an_authority_never_speaks_in_the_open() {
    let plant = Plant::new(&[]).await;
    for (connect, words) in [
        ("tcp/127.0.0.1:7448", "speaks TLS only"),
        ("", "speaks TLS only"),
    ] {
        let told = wall::spawn(plant.left(connect.to_owned()));
        let error = told.map(|_| ()).expect_err("must be refused");
        assert!(error.to_string().contains(words), "{error}");
    }
    let mut config = plant.left("tls/localhost:7447".to_owned());
    config.authority = None;
    let error = wall::spawn(config)
        .map(|_| ())
        .expect_err("must be refused");
    assert!(error.to_string().contains("no authority"), "{error}");
    in_time(plant.service.shutdown())
        .await
        .expect("a clean end");
}

#[cfg(unix)]
#[tokio::test(flavor = "multi_thread", worker_threads = 3)]
async fn a_board_that_is_told_whom_to_trust_over_its_line_works_over_tls() {
    use emulator::{board::EmulatedBoard, flash::Flash};
    let plant = Plant::new(&[]).await;
    let alice = plant.operator().await;
    let records = follow(&alice, "fleet/node/left/state").await;
    let flash = Flash::open(&plant.folder.path().join("left.flash")).expect("a file");
    let base = EmulatorConfig::new(NodeId::new("nobody").expect("legal"));
    let board = EmulatedBoard::power_on(flash, base).expect("a pseudo-terminal");
    let password = plant.folder.path().join("left.password");
    gateway::security::home::write_secret(&password, &plant.credentials("left").password)
        .expect("written");
    let text = |path: &std::path::Path| path.to_str().expect("UTF-8").to_owned();
    let line = [
        "provision".to_owned(),
        board.port().to_owned(),
        "--name=left".to_owned(),
        "--wifi=shop".to_owned(),
        format!("--router=tls/localhost:{}", plant.port()),
        format!("--ca={}", text(&plant.ca())),
        "--user=left".to_owned(),
        format!("--password-file={}", text(&password)),
        "--restart".to_owned(),
    ];
    let told = tokio::task::spawn_blocking(move || {
        let line: Vec<_> = line.iter().map(String::as_str).collect();
        program::fleet(&line)
    });
    let told = in_time(told).await.expect("ran");
    assert_eq!(told.code, Some(0), "{}", told.err);
    until_alive(&records, true).await;
    play(&alice, "one").await;
    in_time(board.power_off()).await;
    in_time(plant.service.shutdown())
        .await
        .expect("a clean end");
}
