//! The node's side of the serial line.
//!
//! Settings are collected; only [`Request::Commit`] touches the flash. So a line that breaks half
//! way leaves the node as it was.

use crate::{
    chip::Chip,
    frame::{self, FRAME_BYTES_MAX, FrameReader},
    machine::Machine,
    record::{
        AxisSettings, NETWORKS_MAX, Record, SIGNERS_MAX, SSID_BYTES_MAX, Setting, SettingError,
    },
    store::{Found, Store, StoreError},
    tuning::Tuning,
    wiring::{self, PinFault, Wiring},
};
use embedded_storage::nor_flash::NorFlash;
use heapless::{String, Vec};
use keys::{AXES_MAX, NodeId};
use serde::{Deserialize, Serialize};

/// What the other side asks. Appended to, never changed.
#[expect(
    clippy::large_enum_variant,
    reason = "one is alive at a time, and there is no heap here"
)]
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Request {
    /// Who is there?
    Hello,
    /// Change the collected record, which begins as the one that is kept.
    Set(Setting),
    /// Keep the collected record.
    Commit,
    /// Forget what was collected.
    Abandon,
    /// What is kept, without its secrets?
    Show,
    /// Boot again.
    Restart,
    /// How does the machine move by itself?
    ShowTuning,
    /// What do the drivers demand?
    ShowAxes,
    /// Which pins were told?
    ShowPins,
}

/// What the node answers. Appended to, never changed.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Reply {
    /// The answer to [`Request::Hello`].
    Hello {
        /// Version of the firmware.
        firmware: [u8; 3],
        /// The node's name, if it has one.
        name: Option<NodeId>,
        /// It has all that it needs.
        complete: bool,
    },
    /// Done.
    Done,
    /// The record is kept under this sequence number. It takes effect with the next boot.
    Kept {
        /// The number.
        sequence: u32,
    },
    /// The answer to [`Request::Show`].
    Record(Shown),
    /// Not done.
    Refused(Refused),
    /// The answer to [`Request::ShowTuning`].
    Tuning(Tuning),
    /// The answer to [`Request::ShowAxes`], by axis.
    Axes(Vec<AxisSettings, AXES_MAX>),
    /// The answer to [`Request::ShowPins`].
    Pins(Wiring),
}

/// A record without its secrets. Fields are only appended: one that an older firmware does not tell
/// reads as its default.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Shown {
    /// The node's name.
    pub name: Option<NodeId>,
    /// Names of its networks.
    pub networks: Vec<String<SSID_BYTES_MAX>, NETWORKS_MAX>,
    /// Where the router is; empty: scouting.
    pub router: String<{ crate::record::ROUTER_BYTES_MAX }>,
    /// A user is set.
    pub has_login: bool,
    /// How many axes are set.
    pub axes: u8,
    /// A key for updates is set.
    pub has_update_key: bool,
    /// The stored script `boot` runs when the node starts.
    pub boot_script: bool,
    /// The first bytes of the operators' keys, to tell them apart.
    pub signers: Vec<[u8; SIGNER_SHOWN_BYTES], SIGNERS_MAX>,
    /// What is connected beside the drivers.
    pub machine: Machine,
    /// Something was told of how it moves: see [`Request::ShowTuning`].
    pub has_tuning: bool,
    /// It was told whom to trust, and speaks TLS only.
    pub has_authority: bool,
    /// It was told of drivers: see [`Request::ShowAxes`].
    pub has_drivers: bool,
    /// It was told of axes or pins: see [`Request::ShowPins`].
    pub has_wiring: bool,
    /// What the boot found of the record.
    pub found: Found,
}

/// How much of an operator's key is shown.
pub const SIGNER_SHOWN_BYTES: usize = 4;

/// Why not. Appended to, never changed.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Refused {
    /// A setting does not fit.
    Setting(SettingError),
    /// The flash cannot be written while the node moves.
    Moving,
    /// The flash did not take it.
    Flash,
    /// The record has no name or no network.
    Incomplete,
    /// A router by TLS without an authority, or an authority without a router by TLS.
    Authority,
    /// The board cannot be wired like this.
    Pins(PinFault),
}

impl From<StoreError> for Refused {
    fn from(_: StoreError) -> Self {
        Self::Flash
    }
}

/// What a node without a record says on its line, for whoever looks.
pub const PROMPT: &str = "stepfleet node, not provisioned: \
    fleet provision PORT --name NAME --wifi SSID --router tcp/HOST:7447\r\n";

/// The same of a node whose record is damaged.
pub const PROMPT_DAMAGED: &str = "stepfleet node, its record is damaged, so it does nothing: \
    tell it everything again by fleet provision PORT\r\n";

/// See the module.
#[derive(Debug)]
pub struct Dialogue<F> {
    store: Store<F>,
    firmware: [u8; 3],
    chip: Chip,
    found: Found,
    kept: Record,
    collected: Option<Record>,
    reader: FrameReader,
    restart: bool,
}

impl<F: NorFlash> Dialogue<F> {
    /// Reads what is kept, of a board with the product's chip.
    ///
    /// # Errors
    /// The flash cannot be read.
    pub fn new(store: Store<F>, firmware: [u8; 3]) -> Result<Self, StoreError> {
        let mut dialogue = Self::blank(store, firmware, Chip::Esp32S3);
        dialogue.read()?;
        Ok(dialogue)
    }

    /// Makes one that has not [read](Self::read) what is kept.
    pub fn blank(store: Store<F>, firmware: [u8; 3], chip: Chip) -> Self {
        Self {
            store,
            firmware,
            chip,
            found: Found::Nothing,
            kept: Record::default(),
            collected: None,
            reader: FrameReader::new(),
            restart: false,
        }
    }

    /// Reads what is kept.
    ///
    /// # Errors
    /// The flash cannot be read.
    pub fn read(&mut self) -> Result<(), StoreError> {
        self.found = self.store.read_into(&mut self.kept)?;
        if self.found == Found::Whole {
            // As it should be since it was written; a cut may have come in between. Else it is tried again
            // at the next boot.
            let _ = self.store.confirm(&self.kept);
        }
        Ok(())
    }

    /// Returns what the last reading found.
    pub fn found(&self) -> Found {
        self.found
    }

    /// Returns what is said on the line of a node that nothing moves on, for whoever looks.
    pub fn prompt(&self) -> &'static str {
        match self.found {
            Found::Damaged => PROMPT_DAMAGED,
            Found::Nothing | Found::Whole | Found::Older => PROMPT,
        }
    }

    /// Returns what is kept.
    pub fn record(&self) -> &Record {
        &self.kept
    }

    /// Returns whether the other side wants the node to boot again.
    pub fn wants_restart(&self) -> bool {
        self.restart
    }

    /// Gives the flash back, as a power cut would.
    pub fn into_store(self) -> Store<F> {
        self.store
    }

    /// Takes a byte. `may_write`: nothing moves, so the flash can be written. Gives how many bytes
    /// of `answer` are to be sent, if any.
    pub fn handle_byte(
        &mut self,
        byte: u8,
        may_write: bool,
        answer: &mut [u8; FRAME_BYTES_MAX + 2],
    ) -> Option<usize> {
        let request = self.reader.handle_byte(byte)?;
        let reply = self.handle(request, may_write);
        Some(frame::write(&reply, answer))
    }

    /// Takes a request and answers it.
    pub fn handle(&mut self, request: Request, may_write: bool) -> Reply {
        match request {
            Request::Hello => Reply::Hello {
                firmware: self.firmware,
                name: self.kept.name,
                complete: self.kept.is_complete(),
            },
            Request::Set(setting) => {
                let collected = self.collected.get_or_insert_with(|| self.kept.clone());
                match collected.apply(setting) {
                    Ok(()) => Reply::Done,
                    Err(error) => Reply::Refused(Refused::Setting(error)),
                }
            }
            Request::Commit => match self.commit(may_write) {
                Ok(sequence) => Reply::Kept { sequence },
                Err(refused) => Reply::Refused(refused),
            },
            Request::Abandon => {
                self.collected = None;
                Reply::Done
            }
            Request::Show => Reply::Record(shown(&self.kept, self.found)),
            Request::ShowTuning => Reply::Tuning(self.kept.tuning.clone()),
            Request::ShowAxes => Reply::Axes(self.kept.axes.clone()),
            Request::ShowPins => Reply::Pins(self.kept.wiring.clone()),
            Request::Restart => {
                self.restart = may_write;
                if may_write {
                    Reply::Done
                } else {
                    Reply::Refused(Refused::Moving)
                }
            }
        }
    }

    fn commit(&mut self, may_write: bool) -> Result<u32, Refused> {
        if !may_write {
            return Err(Refused::Moving);
        }
        let collected = self.collected.as_ref().unwrap_or(&self.kept);
        if !collected.is_consistent() {
            return Err(Refused::Authority);
        }
        if !collected.is_complete() {
            return Err(Refused::Incomplete);
        }
        wiring::check(&collected.wiring, &collected.machine, self.chip).map_err(Refused::Pins)?;
        let sequence = self.store.write(collected)?;
        if let Some(collected) = self.collected.take() {
            self.kept = collected;
        }
        self.found = Found::Whole;
        Ok(sequence)
    }
}

fn shown(record: &Record, found: Found) -> Shown {
    Shown {
        name: record.name,
        networks: record
            .networks
            .iter()
            .map(|network| network.ssid.clone())
            .collect(),
        router: record.router.clone(),
        has_login: record.login.is_some(),
        axes: record.axes.len() as u8,
        has_update_key: record.update_key.is_some(),
        boot_script: record.boot_script,
        signers: record
            .signers
            .iter()
            .map(|key| [key[0], key[1], key[2], key[3]])
            .collect(),
        machine: record.machine.clone(),
        has_tuning: record.tuning != Tuning::default(),
        has_authority: record.authority.is_some(),
        has_drivers: !record.axes.is_empty(),
        has_wiring: record.wiring != Wiring::default(),
        found,
    }
}
