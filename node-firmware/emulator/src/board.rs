//! A whole emulated board: its flash, its serial line, and a node once it was told who it is.
//!
//! ```text
//!   fleet provision ──▶ pseudo-terminal ──▶ provision::Dialogue ──▶ record in the flash
//!                                                  │ restart
//!                              record complete ────┴──▶ a node of that name, at that router
//!                              none, or not whole ────▶ no node: nothing moves; the line says how
//! ```
//!
//! The dialogue, the record and its two copies are the board's own code. A pseudo-terminal stands
//! for the cable; WiFi networks are kept and not used.

use crate::{
    EmulatedHandle, EmulatorConfig,
    config::Credentials,
    emulated::EmulatedNode,
    firmware::BootLoader,
    flash::Flash,
    record::Life,
    wall::{self, SpawnError},
};
use keys::Keys;
use motion::{AxisProfile, limits::CHANNELS};
use provision::{Dialogue, Record, Store, dialogue::PROMPT, frame::FRAME_BYTES_MAX};
use serialport::{SerialPort, TTYPort};
use std::{
    io::{self, ErrorKind, Read, Write},
    sync::{
        Arc, Mutex, PoisonError,
        atomic::{AtomicBool, Ordering},
    },
    thread,
    time::{Duration, Instant},
};
use tokio::{sync::Notify, task::JoinHandle};
use update::{Region, layout};

/// From one look at the line to the next.
const LOOK: Duration = Duration::from_millis(20);

/// From one prompt to the next.
const PROMPT_EVERY: Duration = Duration::from_secs(5);

// A node takes as many keys as its record has.
const _: () = assert!(provision::record::SIGNERS_MAX == node::signed::KEYS_MAX);

type BoardDialogue = Dialogue<Region<Flash>>;

/// What the line, the node's task and the handle share.
#[derive(Default)]
struct Shared {
    /// Says whether the node moves, while there is one.
    moves: Mutex<Option<Box<dyn Fn() -> bool + Send>>>,
    restart: Notify,
    quit: Notify,
    unplugged: AtomicBool,
}

impl Shared {
    fn set_moves(&self, moves: Option<Box<dyn Fn() -> bool + Send>>) {
        *self.moves.lock().unwrap_or_else(PoisonError::into_inner) = moves;
    }

    fn moves(&self) -> bool {
        let moves = self.moves.lock().unwrap_or_else(PoisonError::into_inner);
        moves.as_ref().is_some_and(|moves| moves())
    }
}

/// A board with its power on.
pub struct EmulatedBoard {
    port: String,
    shared: Arc<Shared>,
    life: JoinHandle<Vec<Life>>,
    line: Option<thread::JoinHandle<()>>,
}

impl EmulatedBoard {
    /// Switches a board on, in the present tokio runtime. What its record says comes before what
    /// `base` says.
    ///
    /// # Errors
    /// There is no pseudo-terminal, or the flash is none of a board.
    ///
    /// # Panics
    /// There is no tokio runtime.
    pub fn power_on(flash: Flash, base: EmulatorConfig) -> io::Result<Self> {
        let (mut near, far) = TTYPort::pair()?;
        near.set_timeout(LOOK)?;
        let port = far
            .name()
            .ok_or_else(|| io::Error::other("a pseudo-terminal without a name"))?;
        let dialogue = dialogue_of(&flash)?;
        let shared = Arc::new(Shared::default());
        let line = thread::spawn({
            let (shared, flash) = (shared.clone(), flash.clone());
            // The far end stays open here, or the line would hang up between two programs.
            move || talk(&shared, near, &far, dialogue, &flash)
        });
        let life = tokio::spawn(live(shared.clone(), flash, base));
        Ok(Self {
            port,
            shared,
            life,
            line: Some(line),
        })
    }

    /// Returns the path of the serial port.
    pub fn port(&self) -> &str {
        &self.port
    }

    /// Switches it off and gives the records of its boots.
    pub async fn power_off(mut self) -> Vec<Life> {
        self.shared.quit.notify_one();
        // A task that panicked has said so.
        let lives = (&mut self.life).await.unwrap_or_default();
        self.unplug();
        lives
    }

    fn unplug(&mut self) {
        self.shared.unplugged.store(true, Ordering::Relaxed);
        if let Some(line) = self.line.take() {
            let _ = line.join();
        }
    }
}

impl Drop for EmulatedBoard {
    fn drop(&mut self) {
        self.life.abort();
        self.unplug();
    }
}

fn store_of(flash: &Flash) -> io::Result<Store<Region<Flash>>> {
    Store::new(Region::new(flash.clone(), layout::RECORD)).map_err(io::Error::other)
}

fn dialogue_of(flash: &Flash) -> io::Result<BoardDialogue> {
    let version = BootLoader::boot(flash).version(flash);
    Dialogue::new(store_of(flash)?, version).map_err(io::Error::other)
}

/// The serial line.
fn talk(
    shared: &Shared,
    mut near: TTYPort,
    _far: &TTYPort,
    mut dialogue: BoardDialogue,
    flash: &Flash,
) {
    let mut prompted_at: Option<Instant> = None;
    while !shared.unplugged.load(Ordering::Relaxed) {
        let is_due = prompted_at.is_none_or(|at| at.elapsed() >= PROMPT_EVERY);
        if !dialogue.record().is_complete() && is_due {
            prompted_at = Some(Instant::now());
            // Nobody listens: then nobody misses it.
            let _ = near.write_all(PROMPT.as_bytes());
        }
        let mut bytes = [0; 64];
        let count = match near.read(&mut bytes) {
            Ok(count) => count,
            Err(error) if error.kind() == ErrorKind::TimedOut => continue,
            Err(error) => {
                tracing::error!("the serial line: {error}");
                return;
            }
        };
        let mut answer = [0; FRAME_BYTES_MAX + 2];
        for byte in &bytes[..count] {
            if let Some(used) = dialogue.handle_byte(*byte, !shared.moves(), &mut answer) {
                let _ = near.write_all(&answer[..used]);
            }
        }
        if dialogue.wants_restart() {
            match dialogue_of(flash) {
                Ok(fresh) => dialogue = fresh,
                Err(error) => tracing::error!("the flash: {error}"),
            }
            shared.restart.notify_one();
        }
    }
}

/// Boot after boot until the power is cut.
async fn live(shared: Arc<Shared>, flash: Flash, base: EmulatorConfig) -> Vec<Life> {
    let mut lives = Vec::new();
    loop {
        let node = boot(&flash, &base);
        shared.set_moves(node.as_ref().map(|node| {
            let moves = node.watch_motion();
            Box::new(moves) as Box<dyn Fn() -> bool + Send>
        }));
        let quits = tokio::select! {
            () = shared.restart.notified() => false,
            () = shared.quit.notified() => true,
        };
        shared.set_moves(None);
        if let Some(node) = node {
            lives.extend(node.shutdown().await);
        }
        if quits {
            return lives;
        }
    }
}

/// Starts the node that the record names, if it is complete.
fn boot(flash: &Flash, base: &EmulatorConfig) -> Option<EmulatedHandle> {
    let record = store_of(flash).ok()?.read().ok()??;
    if !record.is_complete() {
        return None;
    }
    let node = config_of(&record, flash, base).and_then(wall::spawn);
    node.inspect_err(|error| tracing::error!("the board does not start: {error}"))
        .ok()
}

/// Returns the settings of a node with this record.
fn config_of(
    record: &Record,
    flash: &Flash,
    base: &EmulatorConfig,
) -> Result<EmulatorConfig, SpawnError> {
    let mut config = EmulatorConfig {
        name: record.name.unwrap_or(base.name),
        keys: Keys::new(&record.prefix).unwrap_or_default(),
        flash: Some(flash.clone()),
        update_key: record.update_key,
        // Empty: scouting.
        connect: record.router.as_str().to_owned(),
        boot_script: record.boot_script,
        signers: record.signers.iter().copied().collect(),
        ..base.clone()
    };
    config.credentials = record.login.as_ref().map(|login| Credentials {
        user: login.user.as_str().to_owned(),
        password: login.password.as_str().to_owned(),
    });
    config.authority = match &record.authority {
        None => None,
        Some(kept) => {
            let authority = tls::Authority::from_parts(&kept.subject, &kept.key);
            Some(authority.map_err(SpawnError::Authority)?)
        }
    };
    for (to, from) in config.motion.axes.iter_mut().zip(&record.axes) {
        *to = AxisProfile::from(*from);
    }
    config.axis_count = config.axis_count.max(record.axes.len()).min(CHANNELS);
    config.check().map_err(SpawnError::Motion)?;
    Ok(config)
}

impl EmulatedHandle {
    /// Returns a look at whether the node moves, for whoever wants to write its flash.
    fn watch_motion(&self) -> impl Fn() -> bool + Send + use<> {
        self.look(|node: &EmulatedNode| node.node().motion().is_active())
    }
}
