//! Memory of the command ring: PSRAM, or a smaller ring in internal RAM where there is none.
//!
//! The ring is read by the planning task only, never by the interrupt. What PSRAM is left over goes
//! to the heap. The node's log says which it is.

use alloc::vec::Vec;
use core::sync::atomic::AtomicU32;
use keys::command::COMMAND_WORDS;

/// Commands that the ring holds in PSRAM: 512 KiB.
#[cfg(feature = "psram")]
pub(crate) const RING_COMMANDS: usize = 16_384;

/// Commands that the ring holds in internal RAM: 8 KiB. The status tells it as credit.
pub(crate) const SMALL_RING_COMMANDS: usize = 256;

/// Memory of scripts, which internal RAM is too precious for; where PSRAM is missing or full, there is
/// none.
#[cfg(feature = "psram")]
pub(crate) const LUA_HEAP: node::interpreter::Heap = node::interpreter::Heap(allocate_external);

/// Gives memory in PSRAM.
///
/// # Safety
/// As `GlobalAlloc::alloc`.
#[cfg(feature = "psram")]
unsafe fn allocate_external(layout: core::alloc::Layout) -> *mut u8 {
    // SAFETY: as promised.
    unsafe { esp_alloc::HEAP.alloc_caps(esp_alloc::MemoryCapability::External.into(), layout) }
}

/// Makes the small ring, from the heap: a board with PSRAM spares its memory.
fn small_ring() -> &'static [AtomicU32] {
    let words = (0..SMALL_RING_COMMANDS * COMMAND_WORDS).map(|_| AtomicU32::new(0));
    words.collect::<Vec<_>>().leak()
}

/// Takes the PSRAM: ring first, the rest becomes heap. The heap in internal RAM is there.
#[cfg(feature = "psram")]
pub(crate) fn ring_memory(psram: esp_hal::peripherals::PSRAM<'static>) -> &'static [AtomicU32] {
    use esp_alloc::{HeapRegion, MemoryCapability};
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
    unsafe {
        esp_alloc::HEAP.add_region(HeapRegion::new(
            start.add(ring_bytes),
            bytes - ring_bytes,
            MemoryCapability::External.into(),
        ));
    }
    // SAFETY: initialized above, aligned to its page, and never given to anyone else.
    unsafe { core::slice::from_raw_parts(words, ring_words) }
}

/// Gives the small ring. The heap is there.
#[cfg(not(feature = "psram"))]
pub(crate) fn ring_memory() -> &'static [AtomicU32] {
    small_ring()
}
