//! Memory of the command ring: PSRAM, or a smaller ring in internal RAM where there is none.
//!
//! The ring is read by the planning task only, never by the interrupt, and its words are loaded and
//! stored, no more. What PSRAM is left over is a heap: see `heap.rs`. The node's log says which it is.

use alloc::vec::Vec;
use core::sync::atomic::AtomicU32;
use keys::command::COMMAND_WORDS;

/// Commands that the ring holds in PSRAM: 512 KiB.
#[cfg(feature = "psram")]
pub(crate) const RING_COMMANDS: usize = 16_384;

/// Commands that the ring holds in internal RAM: 8 KiB. The status tells it as credit.
pub(crate) const SMALL_RING_COMMANDS: usize = 256;

/// Budget of the PSRAM, bytes: `.ci/image-size` prints it, and this holds that the smallest module has
/// room for all of it at once.
#[cfg(feature = "psram")]
pub(crate) mod budget {
    use keys::{command::COMMAND_WORDS, script::SCRIPT_BYTES_MAX};
    use node::library::STORED_MAX;

    /// The command ring.
    pub(crate) const RING: usize = super::RING_COMMANDS * COMMAND_WORDS * 4;
    /// Lua: what a script may take.
    pub(crate) const LUA: usize = crate::lua::LIMITS.memory_bytes as usize;
    /// Stored scripts: both cores have all of them, and three are under way between them.
    pub(crate) const SCRIPTS: usize = (2 * STORED_MAX + 3) * SCRIPT_BYTES_MAX;
    /// Buffers of the socket, the session's queue and its batches, twice for what moves as they grow.
    pub(crate) const NETWORK: usize = 2 * (2 * crate::link::SOCKET_BYTES + 64 * 1024);
    /// The N8R8 module has 8 MiB.
    const MODULE: usize = 8 << 20;

    const _: () = assert!(RING + LUA + SCRIPTS + NETWORK <= MODULE);
}

/// Makes the small ring, from the heap: a board with PSRAM spares its memory.
fn small_ring() -> &'static [AtomicU32] {
    let words = (0..SMALL_RING_COMMANDS * COMMAND_WORDS).map(|_| AtomicU32::new(0));
    words.collect::<Vec<_>>().leak()
}

/// Takes the PSRAM: ring first, the rest becomes heap. The heap in internal RAM is there.
#[cfg(feature = "psram")]
pub(crate) fn ring_memory(psram: esp_hal::peripherals::PSRAM<'static>) -> &'static [AtomicU32] {
    use esp_hal::psram::{Psram, PsramConfig};

    let psram = Psram::new(psram, PsramConfig::default());
    let (start, bytes) = psram.raw_parts();
    let ring_words = RING_COMMANDS * COMMAND_WORDS;
    let ring_bytes = ring_words * size_of::<AtomicU32>();
    if bytes < 2 * ring_bytes {
        return small_ring();
    }
    let words = start.cast::<AtomicU32>();
    for index in 0..ring_words {
        // SAFETY: within the mapped memory, which nobody else has: `Psram::new` takes the
        // peripheral, and the heap gets what is behind.
        unsafe { words.add(index).write(AtomicU32::new(0)) };
    }
    // SAFETY: the memory behind the ring is mapped for ever and is used by nobody else.
    unsafe { crate::heap::add_external(start.add(ring_bytes), bytes - ring_bytes) };
    // SAFETY: initialized above, aligned to its page, and never given to anyone else.
    unsafe { core::slice::from_raw_parts(words, ring_words) }
}

/// Gives the small ring. The heap is there.
#[cfg(not(feature = "psram"))]
pub(crate) fn ring_memory() -> &'static [AtomicU32] {
    small_ring()
}
