//! An in-process router of the zenoh crate, and a session of ours on a real socket to it.
#![allow(dead_code, reason = "each test file uses its part")]

use std::{
    future::Future,
    net::SocketAddr,
    sync::{
        Arc, Mutex,
        atomic::{AtomicU64, Ordering},
    },
    time::{Duration, Instant},
};

use embedded_io_adapters::tokio_1::FromTokio;
use pico::{
    Event, GetOptions, Session, SessionConfig,
    driver::{self, App, Connect, ConnectError, Next, Timer},
};
use tokio::{
    net::{
        TcpStream,
        tcp::{OwnedReadHalf, OwnedWriteHalf},
    },
    sync::{Notify, mpsc},
    task::JoinHandle,
};

/// Generous: only a hang reaches it.
pub(crate) const PATIENCE: Duration = Duration::from_secs(60);

/// How often a port that was free and then taken by somebody else is replaced by another one.
const PORT_ATTEMPTS_MAX: usize = 16;

/// Opens a router on a port from the system.
pub(crate) async fn open_router() -> (zenoh::Session, SocketAddr) {
    open_router_with(|_| {}).await
}

/// Opens a router on a port from the system; `configure` may add to its configuration.
pub(crate) async fn open_router_with(
    configure: impl Fn(&mut zenoh::Config),
) -> (zenoh::Session, SocketAddr) {
    let mut attempts = 0;
    loop {
        attempts += 1;
        let address = std::net::TcpListener::bind("127.0.0.1:0")
            .unwrap()
            .local_addr()
            .unwrap();
        let mut config = patient_config();
        let mut set = |key: &str, value: &str| config.insert_json5(key, value).unwrap();
        set("mode", r#""router""#);
        set("listen/endpoints", &format!(r#"["tcp/{address}"]"#));
        set("scouting/gossip/enabled", "false");
        configure(&mut config);
        match zenoh::open(config).await {
            Ok(router) => return (router, address),
            // Between choosing a port and listening on it somebody else may have taken it.
            Err(error) => assert!(attempts < PORT_ATTEMPTS_MAX, "{error}"),
        }
    }
}

/// Opens a client of the zenoh crate.
pub(crate) async fn open_client(address: SocketAddr) -> zenoh::Session {
    open_client_with(address, |_| {}).await
}

/// The same; `configure` may add to its configuration.
pub(crate) async fn open_client_with(
    address: SocketAddr,
    configure: impl FnOnce(&mut zenoh::Config),
) -> zenoh::Session {
    let mut config = patient_config();
    let mut set = |key: &str, value: &str| config.insert_json5(key, value).unwrap();
    set("mode", r#""client""#);
    set("connect/endpoints", &format!(r#"["tcp/{address}"]"#));
    configure(&mut config);
    zenoh::open(config).await.unwrap()
}

/// A configuration in which a busy machine is not taken for a dead peer.
fn patient_config() -> zenoh::Config {
    let mut config = zenoh::Config::default();
    let mut set = |key: &str, value: u128| config.insert_json5(key, &value.to_string()).unwrap();
    set("transport/unicast/open_timeout", PATIENCE.as_millis());
    set("transport/unicast/accept_timeout", PATIENCE.as_millis());
    set("transport/link/tx/lease", PATIENCE.as_millis());
    set(
        "transport/link/tx/queue/congestion_control/block/wait_before_close",
        PATIENCE.as_micros(),
    );
    set("queries_default_timeout", PATIENCE.as_millis());
    config
        .insert_json5("scouting/multicast/enabled", "false")
        .unwrap();
    config
}

/// Where a client connects to, if anywhere: what the test says last.
#[derive(Clone)]
pub(crate) struct Target(Arc<Mutex<Option<SocketAddr>>>);

impl Target {
    pub(crate) fn new(address: SocketAddr) -> Self {
        Self(Arc::new(Mutex::new(Some(address))))
    }

    /// Sends the next attempt elsewhere; `None`: nobody is there.
    pub(crate) fn set(&self, address: Option<SocketAddr>) {
        *self.0.lock().unwrap() = address;
    }
}

/// Connects to its target.
pub(crate) struct Tcp {
    pub(crate) target: Target,
}

impl Connect for Tcp {
    type Reader = FromTokio<OwnedReadHalf>;
    type Writer = FromTokio<OwnedWriteHalf>;

    async fn connect(&mut self) -> Result<(Self::Reader, Self::Writer), ConnectError> {
        let address = *self.target.0.lock().unwrap();
        let stream = TcpStream::connect(address.ok_or(ConnectError)?)
            .await
            .map_err(|_| ConnectError)?;
        stream.set_nodelay(true).map_err(|_| ConnectError)?;
        let (reader, writer) = stream.into_split();
        Ok((FromTokio::new(reader), FromTokio::new(writer)))
    }
}

/// The system's clock.
pub(crate) struct Wall {
    start: Instant,
}

impl Wall {
    pub(crate) fn new() -> Self {
        Self {
            start: Instant::now(),
        }
    }
}

impl Timer for Wall {
    fn now_us(&self) -> u64 {
        self.start.elapsed().as_micros() as u64
    }

    fn sleep_until_us(&self, at_us: u64) -> impl Future<Output = ()> {
        let at = self.start + Duration::from_micros(at_us);
        tokio::time::sleep_until(at.into())
    }
}

type Errand = Box<dyn FnOnce(&mut Session, u64) + Send>;

/// An application that does errands and passes events on.
struct Porter {
    errands: Arc<Mutex<Vec<Errand>>>,
    errand_came: Arc<Notify>,
    events: mpsc::UnboundedSender<Event>,
    quit: Arc<AtomicU64>,
}

impl App for Porter {
    fn poll(&mut self, now_us: u64, session: &mut Session) -> Next {
        for errand in std::mem::take(&mut *self.errands.lock().unwrap()) {
            errand(session, now_us);
        }
        while let Some(event) = session.poll_event() {
            let _ = self.events.send(event);
        }
        Next {
            wake_at_us: None,
            quit: self.quit.load(Ordering::SeqCst) != 0,
        }
    }

    async fn touched(&self) {
        self.errand_came.notified().await;
    }
}

/// A session of ours that runs on a task of its own.
pub(crate) struct Client {
    errands: Arc<Mutex<Vec<Errand>>>,
    errand_came: Arc<Notify>,
    events: mpsc::UnboundedReceiver<Event>,
    quit: Arc<AtomicU64>,
    task: JoinHandle<()>,
}

impl Client {
    /// Starts one that takes a busy machine for nothing else.
    pub(crate) fn start(target: Target, config: SessionConfig) -> Self {
        let config = SessionConfig {
            lease_us: PATIENCE.as_micros() as u64,
            connect_timeout_us: PATIENCE.as_micros() as u64,
            ..config
        };
        let errands = Arc::<Mutex<Vec<Errand>>>::default();
        let errand_came = Arc::new(Notify::new());
        let quit = Arc::new(AtomicU64::new(0));
        let (sender, events) = mpsc::unbounded_channel();
        let mut porter = Porter {
            errands: errands.clone(),
            errand_came: errand_came.clone(),
            events: sender,
            quit: quit.clone(),
        };
        // Sessions of one router must differ; more is not needed here.
        static SEED: AtomicU64 = AtomicU64::new(1);
        let seed = SEED.fetch_add(1, Ordering::Relaxed);
        // On a threaded runtime: the driver's future is Send when those below it are.
        let task = tokio::spawn(async move {
            let mut session = Session::new(config, seed);
            let mut tcp = Tcp { target };
            driver::run(&mut session, &mut tcp, &Wall::new(), &mut porter).await;
        });
        Self {
            errands,
            errand_came,
            events,
            quit,
            task,
        }
    }

    pub(crate) async fn open(address: SocketAddr, config: SessionConfig) -> Self {
        let mut client = Self::start(Target::new(address), config);
        client.opened().await;
        client
    }

    /// Waits for the session.
    pub(crate) async fn opened(&mut self) {
        assert_eq!(self.event().await, Event::Opened);
    }

    /// Does something with the session and brings the result back.
    pub(crate) async fn with<R: Send + 'static>(
        &self,
        errand: impl FnOnce(&mut Session, u64) -> R + Send + 'static,
    ) -> R {
        let (sender, result) = tokio::sync::oneshot::channel();
        self.errands
            .lock()
            .unwrap()
            .push(Box::new(move |session, now_us| {
                let _ = sender.send(errand(session, now_us));
            }));
        self.errand_came.notify_one();
        tokio::time::timeout(PATIENCE, result)
            .await
            .expect("the driver hangs")
            .unwrap()
    }

    /// The next event.
    pub(crate) async fn event(&mut self) -> Event {
        let event = tokio::time::timeout(PATIENCE, self.events.recv()).await;
        event
            .expect("no event comes")
            .expect("the driver has ended")
    }

    /// Waits until the router has taken what was declared so far: it answers a question after it.
    /// No other event may be due.
    pub(crate) async fn settled(&mut self) {
        let ask = |session: &mut Session, now_us| {
            session.get("nobody/knows", "", None, &patient_get(), now_us)
        };
        let query = self.with(ask).await.unwrap();
        assert_eq!(
            self.event().await,
            Event::ReplyFinal {
                query,
                timed_out: false
            }
        );
    }

    /// Ends the session in order.
    pub(crate) async fn quit(mut self) -> Vec<Event> {
        self.quit.store(1, Ordering::SeqCst);
        self.errand_came.notify_one();
        tokio::time::timeout(PATIENCE, self.task)
            .await
            .expect("the driver does not end")
            .unwrap();
        let mut events = Vec::new();
        while let Ok(event) = self.events.try_recv() {
            events.push(event);
        }
        events
    }
}

/// Options of a question that waits for its answers as long as the test does.
pub(crate) fn patient_get() -> GetOptions {
    GetOptions {
        timeout_us: PATIENCE.as_micros() as u64,
        ..GetOptions::default()
    }
}

/// Waits for something that the other side does.
pub(crate) async fn patiently<F: Future>(future: F) -> F::Output {
    tokio::time::timeout(PATIENCE, future)
        .await
        .expect("it does not happen")
}
