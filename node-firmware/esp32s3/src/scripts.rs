//! Stored scripts on the board: the node, which runs them, is on core 1; the flash, which keeps them,
//! belongs to core 0.
//!
//! ```text
//!   link.rs ─put─▶ TO_NODE ─▶ Node: signed? room? ─▶ TO_FLASH ─▶ Shelf ─▶ flash, in a window
//!   link.rs ◀─get─ Shelf                          ◀─ SAVED ◀───────┘
//! ```
//!
//! Both hold all texts: a get is answered here, a call there. A full queue drops what is put, as if the
//! network had lost it: whoever puts a script hears nothing of it in the log. So does a memory without
//! room for both. What the flash holds beyond it, written by a board with more, is not loaded, and the
//! node says so.

use crate::{
    flash::CoreFlash,
    heap::has_room,
    plan::{OUTGOING, WAKE, in_window},
    rmt::RmtBackend,
};
use alloc::{string::String, vec::Vec};
use core::{
    cell::Cell,
    sync::atomic::{AtomicUsize, Ordering},
};
use embassy_sync::{
    blocking_mutex::{Mutex, raw::CriticalSectionRawMutex},
    channel::Channel,
};
use keys::{LocalMicros, status::FaultCode};
use node::{
    Node, Outputs,
    library::{Change, Library, SaveError, Saved, ScriptStore, flash::FlashStore},
};
use update::{Region, layout};

/// What was put and the node has not seen.
static TO_NODE: Channel<CriticalSectionRawMutex, (String, Option<Vec<u8>>), 2> = Channel::new();
/// What the node has taken and is not in the flash.
static TO_FLASH: Channel<CriticalSectionRawMutex, Change, 2> = Channel::new();
/// What is in the flash and the node does not know.
static SAVED: Channel<CriticalSectionRawMutex, Saved, 4> = Channel::new();
/// What the flash held at the start.
static STOCK: Mutex<CriticalSectionRawMutex, Cell<Option<Vec<(String, String)>>>> =
    Mutex::new(Cell::new(None));

/// How many of them the memory had no room for.
static LEFT_OUT: AtomicUsize = AtomicUsize::new(0);

/// A store of which is loaded what the memory has room for.
#[derive(Debug)]
struct Bounded<'a, S>(&'a mut S);

impl<S: ScriptStore> ScriptStore for Bounded<'_, S> {
    fn load(&mut self, take: &mut dyn FnMut(&str, &[u8])) -> Result<(), SaveError> {
        self.0.load(&mut |name, text| {
            // Here, on its way, and there.
            if has_room(3, text.len()) {
                take(name, text);
            } else {
                LEFT_OUT.fetch_add(1, Ordering::Relaxed);
            }
        })
    }

    fn save(&mut self, name: &str, text: &[u8]) -> Result<(), SaveError> {
        self.0.save(name, text)
    }

    fn remove(&mut self, name: &str) -> Result<(), SaveError> {
        self.0.remove(name)
    }
}

/// The scripts on core 0.
pub(crate) struct Shelf {
    library: Library,
    /// `None`: the region cannot be read, and scripts last until the next start.
    store: Option<FlashStore<Region<CoreFlash>>>,
}

impl Shelf {
    /// Reads what the flash holds, and lays it out for the node.
    pub(crate) fn open(flash: CoreFlash) -> Self {
        let mut library = Library::default();
        let mut store = FlashStore::open(Region::new(flash, layout::SCRIPTS)).ok();
        if let Some(store) = store.as_mut() {
            // What cannot be read is not there, and a get shows that.
            let _ = library.load(&mut Bounded(store));
        }
        let texts = library.iter();
        let texts = texts.map(|(name, text)| (String::from(name), String::from(text)));
        let texts = texts.collect();
        STOCK.lock(|stock| stock.set(Some(texts)));
        Self { library, store }
    }

    /// Gives a change to the node.
    pub(crate) fn put(&self, name: &str, text: Option<&[u8]>) {
        // On its way, there, on its way back, and here.
        if !text.is_none_or(|text| has_room(4, text.len())) {
            return;
        }
        let change = (String::from(name), text.map(Vec::from));
        // Full: lost, as on the way here.
        let _ = TO_NODE.try_send(change);
        WAKE.signal(());
    }

    pub(crate) fn library(&self) -> &Library {
        &self.library
    }

    /// Follows what the node has taken, and saves one change if nothing moves.
    pub(crate) fn poll(&mut self) {
        while let Ok(change) = TO_FLASH.try_receive() {
            // The node has as much room.
            let _ = self.library.follow(&change);
        }
        let Some(store) = self.store.as_mut() else {
            return;
        };
        if !self.library.has_unsaved() || SAVED.is_full() {
            return;
        }
        let library = &mut self.library;
        let store: &mut dyn ScriptStore = store;
        if let Some(Some(saved)) = in_window(|| library.save_next_to(store)) {
            let _ = SAVED.try_send(saved);
            WAKE.signal(());
        }
    }

    /// Returns whether [`Shelf::poll`] is to be called again soon.
    pub(crate) fn is_due(&self) -> bool {
        self.store.is_some() && self.library.has_unsaved()
    }
}

/// The node's side, in each of its turns.
pub(crate) fn exchange<O: Outputs>(node: &mut Node<'static, RmtBackend, O>, now: LocalMicros) {
    if let Some(stock) = STOCK.lock(Cell::take) {
        node.stock_scripts(now, stock);
        let left_out = LEFT_OUT.load(Ordering::Relaxed);
        if left_out > 0 {
            node.fault(FaultCode::SCRIPTS, now);
            node.tell(
                now,
                format_args!("memory has no room for {left_out} of the stored scripts"),
            );
        }
        node.run_boot_script(now);
    }
    // Checking a signature takes longer than a plan lasts.
    while !node.motion().is_active() {
        let Ok((name, text)) = TO_NODE.try_receive() else {
            break;
        };
        node.store_script(now, &name, text.as_deref());
    }
    while let Ok(saved) = SAVED.try_receive() {
        node.note_saved(now, &saved);
    }
    while !TO_FLASH.is_full() {
        let Some(change) = node.take_change() else {
            break;
        };
        let _ = TO_FLASH.try_send(change);
        OUTGOING.signal(());
    }
}
