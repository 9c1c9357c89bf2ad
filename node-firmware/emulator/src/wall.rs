//! Emulated nodes on a real clock and a real socket: one task each, no thread of their own.
//!
//! A node is advanced lazily: it sleeps until its own next deadline or the next byte, and then
//! catches up with everything that its pulse unit has done in between, at the right ticks. So a
//! late wake-up of the PC shows in no edge.

use crate::{
    clock::LocalClock,
    config::EmulatorConfig,
    emulated::{EmulatedNode, splitmix},
    record::Life,
    store::{FolderStore, MemoryStore},
    stream::{Connector, NoWay, Way},
};
use keys::{AxisId, LocalMicros, NodeId, Status};
use node::{
    Inbound,
    library::{BoxedStore, SaveError, flash::FlashStore},
    run::NodeLink,
};
use pico::{
    driver::{self, App, Next, Timer},
    session::{Session, SessionConfig},
};
use std::{
    hash::{BuildHasher, RandomState},
    sync::{
        Arc, Mutex, MutexGuard, PoisonError,
        atomic::{AtomicBool, Ordering},
    },
    time::Duration,
};
use tokio::{sync::Notify, task::JoinHandle, time::Instant};
use update::Region;

/// Why a node cannot be spawned.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum SpawnError {
    /// The locator is not `tcp/HOST:PORT` or `tls/HOST:PORT`.
    Locator(String),
    /// The locator asks for TLS, but the node was told no authority.
    NoAuthority(String),
    /// The node was told an authority, but the locator does not ask for TLS.
    Open(String),
    /// What the node was told is no authority.
    Authority(tls::AuthorityError),
    /// The axes cannot be like this.
    Motion(motion::ConfigError),
    /// The ring holds no command.
    Ring,
    /// The folder, or the flash, of the stored scripts cannot be made or read.
    Scripts(String),
}

impl std::fmt::Display for SpawnError {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Locator(locator) => {
                write!(
                    f,
                    "{locator:?} is no address of the form tcp/HOST:PORT or tls/HOST:PORT"
                )
            }
            Self::NoAuthority(locator) => write!(
                f,
                "{locator:?} asks for TLS, and the node was told no authority to trust"
            ),
            Self::Open(locator) => write!(
                f,
                "a node that was told an authority speaks TLS only: {locator:?} must be tls/HOST:PORT"
            ),
            Self::Authority(error) => write!(f, "the authority: {error}"),
            Self::Motion(error) => error.fmt(f),
            Self::Ring => write!(f, "the ring must hold at least one command"),
            Self::Scripts(error) => write!(f, "the stored scripts: {error}"),
        }
    }
}

impl std::error::Error for SpawnError {}

/// What the task and its handle share.
struct Shared {
    node: Mutex<EmulatedNode>,
    clock: Mutex<LocalClock>,
    epoch: Instant,
    /// The node was touched from outside: its deadlines may be others now.
    touched: Notify,
    /// The power was cut: the link breaks without a word.
    rebooted: Notify,
    quit: AtomicBool,
    /// Why the router that was reached last was not spoken to.
    refusal: Mutex<Option<String>>,
}

impl Shared {
    /// Keeps why a router is not spoken to, and says it once.
    fn refused(&self, name: &NodeId, why: &str) {
        let mut refusal = self.refusal.lock().unwrap_or_else(PoisonError::into_inner);
        if refusal.as_deref() != Some(why) {
            tracing::warn!("{name}: no link: {why}");
            *refusal = Some(why.to_owned());
        }
    }

    fn node(&self) -> MutexGuard<'_, EmulatedNode> {
        self.node.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn clock(&self) -> MutexGuard<'_, LocalClock> {
        self.clock.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Cuts the power and boots again.
    fn reset(&self) {
        {
            let mut node = self.node();
            let config = node.config();
            let real_us = self.real_us();
            let clock = LocalClock::new(real_us, config.clock_offset_us, config.clock_drift_ppb);
            *self.clock() = clock;
            node.reset(random() as u32);
        }
        self.rebooted.notify_one();
    }

    fn real_us(&self) -> u64 {
        u64::try_from(self.epoch.elapsed().as_micros()).unwrap_or(u64::MAX)
    }

    fn now(&self) -> LocalMicros {
        self.clock().local_from_real(self.real_us())
    }
}

/// The node's own clock, which may be off, drift and jump.
struct NodeTimer(Arc<Shared>);

impl Timer for NodeTimer {
    fn now_us(&self) -> u64 {
        self.0.now().0
    }

    async fn sleep_until_us(&self, at_us: u64) {
        let real_us = self.0.clock().real_from_local(LocalMicros(at_us));
        let at = self.0.epoch.checked_add(Duration::from_micros(real_us));
        match at {
            Some(at) => tokio::time::sleep_until(at).await,
            // So far ahead that nobody will be there.
            None => std::future::pending().await,
        }
    }
}

struct NodeApp {
    shared: Arc<Shared>,
    link: NodeLink,
    boot: u32,
}

impl App for NodeApp {
    fn poll(&mut self, now_us: u64, session: &mut Session) -> Next {
        let mut node = self.shared.node();
        if node.node().queue().boot != self.boot {
            // The power was cut a moment ago: this session ends without another word, and its time
            // may be that of the boot before, far ahead of the present one.
            return Next::default();
        }
        let wake_at = self.link.exchange(&mut *node, session, LocalMicros(now_us));
        if node.wants_restart() {
            drop(node);
            self.shared.reset();
            return Next::default();
        }
        Next {
            wake_at_us: wake_at.map(|at| at.0),
            quit: self.shared.quit.load(Ordering::Relaxed),
        }
    }

    async fn touched(&self) {
        self.shared.touched.notified().await;
    }
}

/// Boots a node and lets it run in a task of the present tokio runtime; it connects, and connects
/// again, until [`EmulatedHandle::shutdown`]. Dropping the handle leaves it running.
///
/// # Errors
/// A setting is out of range.
///
/// # Panics
/// There is no tokio runtime.
pub fn spawn(config: EmulatorConfig) -> Result<EmulatedHandle, SpawnError> {
    let way = Way::new(&config.connect, config.authority.as_ref()).map_err(|why| {
        let locator = config.connect.clone();
        match why {
            NoWay::Locator => SpawnError::Locator(locator),
            NoWay::NoAuthority => SpawnError::NoAuthority(locator),
            NoWay::Open => SpawnError::Open(locator),
        }
    })?;
    config.check().map_err(SpawnError::Motion)?;
    if config.ring_commands == 0 {
        return Err(SpawnError::Ring);
    }
    let store = store_of(&config)?;
    let shared = Arc::new(Shared {
        clock: Mutex::new(LocalClock::new(
            0,
            config.clock_offset_us,
            config.clock_drift_ppb,
        )),
        node: Mutex::new(EmulatedNode::with_store(config, random() as u32, store)),
        epoch: Instant::now(),
        touched: Notify::new(),
        rebooted: Notify::new(),
        quit: AtomicBool::new(false),
        refusal: Mutex::new(None),
    });
    let task = tokio::spawn(live(shared.clone(), way));
    Ok(EmulatedHandle { shared, task })
}

/// Returns where the stored scripts outlive the node: a folder, else the board's flash, else memory.
fn store_of(config: &EmulatorConfig) -> Result<BoxedStore, SpawnError> {
    if let Some(folder) = &config.scripts {
        let store = FolderStore::open(folder);
        let told = |error| SpawnError::Scripts(format!("{}: {error}", folder.display()));
        return Ok(Box::new(store.map_err(told)?));
    }
    let Some(flash) = &config.flash else {
        return Ok(Box::<MemoryStore>::default());
    };
    let store = FlashStore::open(Region::new(flash.clone(), update::layout::SCRIPTS));
    let told = |error: SaveError| SpawnError::Scripts(format!("in the flash: {error}"));
    Ok(Box::new(store.map_err(told)?))
}

/// Boot after boot until the node quits.
async fn live(shared: Arc<Shared>, way: Way) {
    while !shared.quit.load(Ordering::Relaxed) {
        let boot = boot(shared.clone(), way.clone());
        tokio::select! {
            () = boot => {}
            () = shared.rebooted.notified() => {}
        }
    }
    let now = shared.now();
    shared.node().inbound(Inbound::LinkDown, now);
}

async fn boot(shared: Arc<Shared>, way: Way) {
    let (keys, name, credentials, scout, boot) = {
        let node = shared.node();
        let config = node.config();
        let boot = node.node().queue().boot;
        (
            config.keys.clone(),
            config.name,
            config.credentials.clone(),
            config.scout,
            boot,
        )
    };
    let config = SessionConfig {
        credentials,
        // A PC has memory for the longest script that can be stored.
        fragment_bytes_max: 4096 + keys::script::SCRIPT_BYTES_MAX,
        queue_bytes: 32 * 1024 + keys::script::SCRIPT_BYTES_MAX,
        ..SessionConfig::default()
    };
    let mut session = Session::new(config, random());
    let link = NodeLink::declare(&mut session, &keys, &name)
        .expect("a session has room for one node's keys");
    let mut app = NodeApp {
        shared: shared.clone(),
        link,
        boot,
    };
    let timer = NodeTimer(shared.clone());
    let mut connector = Connector {
        way,
        scout,
        refused: |why: &str| shared.refused(&name, why),
    };
    driver::run(&mut session, &mut connector, &timer, &mut app).await;
}

/// Where boot numbers and session ids come from: the operating system, by way of the hasher.
pub(crate) fn random() -> u64 {
    splitmix(RandomState::new().hash_one(()))
}

/// A running node, from outside.
pub struct EmulatedHandle {
    shared: Arc<Shared>,
    task: JoinHandle<()>,
}

impl std::fmt::Debug for EmulatedHandle {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("EmulatedHandle")
            .field("node", &*self.shared.node())
            .finish_non_exhaustive()
    }
}

impl EmulatedHandle {
    /// Gives the node to a closure, with its present time, after it has caught up.
    pub fn with<R>(&self, f: impl FnOnce(&mut EmulatedNode, LocalMicros) -> R) -> R {
        let result = {
            let mut node = self.shared.node();
            let now = self.shared.now();
            node.poll(now);
            f(&mut node, now)
        };
        self.shared.touched.notify_one();
        result
    }

    /// Returns a look at the node as it is, for another thread.
    pub(crate) fn look<R, F>(&self, f: F) -> impl Fn() -> R + use<R, F>
    where
        F: Fn(&EmulatedNode) -> R,
    {
        let shared = self.shared.clone();
        move || f(&shared.node())
    }

    /// Returns its name.
    pub fn name(&self) -> NodeId {
        self.shared.node().name()
    }

    /// Returns what it says about itself now.
    pub fn status(&self) -> Status {
        self.with(|node, _| node.status())
    }

    /// Returns the exact position of an axis now, as the node knows it.
    pub fn position_steps(&self, axis: AxisId) -> i64 {
        self.with(|node, _| node.position_steps(axis))
    }

    /// Returns the emulated pulse counter of an axis now.
    pub fn step_count(&self, axis: AxisId) -> i64 {
        self.with(|node, _| node.step_count(axis))
    }

    /// Returns whether its session is open.
    pub fn link_up(&self) -> bool {
        self.shared.node().node().link_up()
    }

    /// Returns why the router that was reached last was not spoken to, in words.
    pub fn refusal(&self) -> Option<String> {
        let refusal = self.shared.refusal.lock();
        refusal.unwrap_or_else(PoisonError::into_inner).clone()
    }

    /// Presses or frees the stop input.
    pub fn stop_pin(&self, active: bool) {
        self.with(|node, now| node.stop_pin(active, now));
    }

    /// Lets its clock jump ahead.
    pub fn jump_clock(&self, ahead_us: u64) {
        let real_us = self.shared.real_us();
        self.shared.clock().jump(real_us, ahead_us);
        self.shared.touched.notify_one();
    }

    /// Cuts the power and boots again: everything in its memory is lost, the link breaks without a
    /// word.
    pub fn reset(&self) {
        self.shared.reset();
    }

    /// Ends the node with an orderly close of its session and gives the records of its boots.
    pub async fn shutdown(self) -> Vec<Life> {
        self.with(|_, _| ());
        self.shared.quit.store(true, Ordering::Relaxed);
        self.shared.touched.notify_one();
        // A task that panicked has nothing more to say than its message, which is printed.
        let _ = self.task.await;
        self.shared.node().take_lives()
    }
}
