//! A whole emulated board: its flash, its serial line, and a node once it was told who it is.
//!
//! ```text
//!   fleet provision ──▶ pseudo-terminal ──▶ provision::Dialogue ──▶ record in the flash
//!                                                  │ restart
//!                              record complete ────┴──▶ a node of that name, at that router
//!                              none, or not whole ────▶ no node: nothing moves; the line says how
//! ```
//!
//! The dialogue, the record, its two copies and what follows from it for motion are the board's own
//! code. A pseudo-terminal stands for the cable, `bed.rs` for the machine that the switches are on; WiFi
//! networks are kept and not used.

use crate::{
    EmulatedHandle, EmulatorConfig, bed,
    config::Credentials,
    emulated::EmulatedNode,
    firmware::BootLoader,
    flash::Flash,
    record::Life,
    wall::{self, SpawnError},
};
use keys::Keys;
use motion::limits::CHANNELS;
use provision::{Chip, Dialogue, Record, Store, frame::FRAME_BYTES_MAX, wiring};
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
            let _ = near.write_all(dialogue.prompt().as_bytes());
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
    let mut record = Record::default();
    let found = store_of(flash).ok()?.read_into(&mut record).ok()?;
    // A record that is not there, or damaged, is the empty one.
    if !record.is_complete() {
        return None;
    }
    let fault = wiring::check(&record.wiring, &record.machine, Chip::Esp32S3).err();
    if let Some(fault) = fault {
        tracing::error!("the board does not start: {fault}");
        return None;
    }
    let base = &EmulatorConfig {
        found,
        ..base.clone()
    };
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
    // As many as it was told. Else a PC has room for each that it was told the driver of.
    config.axis_count = match record.wiring.axis_count {
        0 => config.axis_count.max(record.axes.len()).min(CHANNELS),
        _ => record.wiring.axes(),
    };
    config.motion = provision::kit::motion_of(record, config.axis_count);
    config.machine.switches = bed::switches(&config.motion, base);
    config.check().map_err(SpawnError::Motion)?;
    Ok(config)
}

impl EmulatedHandle {
    /// Returns a look at whether the node moves, for whoever wants to write its flash.
    fn watch_motion(&self) -> impl Fn() -> bool + Send + use<> {
        self.look(|node: &EmulatedNode| node.node().motion().is_active())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{Recording, oracle};
    use keys::{
        AxisId, BatchHeader, Command, JobId, LocalMicros, NodeId, NodeTopic,
        batch::{BatchWriter, ORDER_BYTES_MAX},
    };
    use motion::{Direction, io::input::Switch};
    use provision::machine::{End, SwitchOf, SwitchSettings};

    fn record() -> Record {
        let mut record = Record {
            name: NodeId::new("left").ok(),
            ..Record::default()
        };
        let told = [
            (SwitchOf::Axis(0), End::Min, true, true),
            (SwitchOf::Axis(1), End::Home, false, true),
            (SwitchOf::Axis(1), End::Max, true, false),
            (SwitchOf::C, End::Min, true, false),
            (SwitchOf::D, End::Max, true, false),
            (SwitchOf::Probe, End::Min, false, false),
        ];
        for (of, end, normally_closed, homes) in told {
            let switch = SwitchSettings {
                of,
                end,
                normally_closed,
                homes,
            };
            assert!(record.machine.add(switch));
        }
        (record.machine.has_cd, record.machine.has_lidar) = (true, true);
        record
    }

    fn base() -> EmulatorConfig {
        let mut base = EmulatorConfig::new(NodeId::new("nobody").expect("legal"));
        base.record = Recording::Edges { max: 1_000_000 };
        base
    }

    fn play(config: EmulatorConfig, commands: &[Command]) -> EmulatedNode {
        let mut node = EmulatedNode::new(config, 7);
        node.link(true, LocalMicros(0));
        let mut writer = BatchWriter::new();
        assert!(commands.iter().all(|command| writer.push(command)));
        let header = BatchHeader {
            queue: node.status().queue,
            first_command: 0,
            command_count: 0,
            job: JobId::new("j").expect("legal"),
            job_end: commands.len() as u64,
        };
        let mut buffer = [0; ORDER_BYTES_MAX];
        let bytes = writer.finish(header, &mut buffer).expect("room");
        node.handle(NodeTopic::Batch, bytes, LocalMicros(0));
        let mut now = LocalMicros(0);
        while node.status().executed_commands < commands.len() as u64 {
            assert!(now.0 < 60_000_000, "{:?}", node.status());
            now = node.poll_timeout().unwrap_or(now).max(now.plus_us(1));
            node.poll(now);
            let _ = node.outbox(now);
        }
        node
    }

    #[test]
    fn what_a_record_tells_is_the_machine_that_moves() {
        let flash = Flash::blank();
        let config = config_of(&record(), &flash, &base()).expect("a machine");
        let commands = [
            Command::Home { axis: AxisId(0) },
            Command::Home { axis: AxisId(1) },
            Command::MoveC { index: 2 },
            Command::MoveD { on: true },
            Command::LidarRead,
        ];
        let node = play(config, &commands);
        let status = node.status();
        assert_eq!(status.faults.as_slice(), []);
        // Pulled off the switch, which is where the bed has it.
        assert_eq!(status.axes[0].position_steps, 200);
        assert!((node.place_steps(AxisId(0)) + 800).abs() <= 10);
        assert_eq!(node.carriage_steps(crate::pins::CARRIAGE_C), 4_000);
        assert!(status.lidar_mm.is_some());
        oracle::check_life(&node.life()).expect("good pulses");
    }

    #[test]
    fn an_option_says_where_a_switch_is_and_the_record_whether_it_is_looked_at() {
        let mut base = base();
        for (axis, at_steps) in [(0, -300), (1, -10)] {
            base.add_switch(AxisId(axis), Switch::Min, at_steps)
                .expect("room");
        }
        let config = config_of(&record(), &Flash::blank(), &base).expect("a machine");
        let home = config.motion.homes[0].expect("it is homed");
        assert_eq!(
            (home.switch, home.direction),
            (Switch::Min, Direction::Negative)
        );
        let back = Command::Move {
            axis: AxisId(1),
            delay_us: 100,
            steps: -400,
        };
        let node = play(config, &[Command::Home { axis: AxisId(0) }, back]);
        assert!((node.place_steps(AxisId(0)) + 100).abs() <= 10);
        assert_eq!(
            node.place_steps(AxisId(1)),
            -400,
            "nobody looks at that one"
        );
        assert_eq!(node.status().faults.as_slice(), []);
    }

    #[test]
    fn a_board_of_which_nothing_was_told_has_no_machine() {
        let config = config_of(&Record::default(), &Flash::blank(), &base()).expect("legal");
        assert!(config.machine.switches.is_empty());
        assert_eq!(config.motion, base().motion_config());
    }
}
