//! Where memory comes from: two heaps that never lend to each other.
//!
//! | heap | from | what |
//! |---|---|---|
//! | internal | esp-alloc's own | everything below [`LARGE_BYTES`]; the radio and the tasks' stacks, which ask for it by name |
//! | external | PSRAM | everything from [`LARGE_BYTES`] on: texts of scripts, buffers of sockets and batches; Lua, which asks for it by name |
//!
//! Atomic operations other than load and store do not work in the PSRAM of an ESP32-S3. What needs them on
//! a heap is shared by counting (`Arc`): the session's and TLS's, all of them small. So size alone decides,
//! and a full internal heap is not filled up from PSRAM. On a chip without PSRAM there is one heap.

use core::alloc::{GlobalAlloc, Layout};
use esp_alloc::HEAP;
#[cfg(feature = "psram")]
use esp_alloc::{EspHeap, HeapRegion, MemoryCapability};

/// What counts as large, bytes.
const LARGE_BYTES: usize = 512;

// Nothing that TLS shares is large.
#[cfg(all(feature = "psram", feature = "tls"))]
const _: () = assert!(tls::link::SHARED_BYTES_MAX < LARGE_BYTES);

/// What texts of scripts must leave in their heap, bytes: room for a link with TLS and what comes with it.
const RESERVE_BYTES: usize = 12 * 1024;

#[cfg(feature = "psram")]
static EXTERNAL: EspHeap = EspHeap::empty();

#[global_allocator]
static GLOBAL: BySize = BySize;

/// See the module.
struct BySize;

// SAFETY: each block comes from one of two allocators and goes back to the same one: their memory does
// not overlap.
unsafe impl GlobalAlloc for BySize {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        #[cfg(feature = "psram")]
        if layout.size() >= LARGE_BYTES && external::is_there() {
            // SAFETY: as promised by the caller.
            return unsafe { EXTERNAL.alloc(layout) };
        }
        // SAFETY: as promised by the caller.
        unsafe { HEAP.alloc(layout) }
    }

    unsafe fn dealloc(&self, block: *mut u8, layout: Layout) {
        #[cfg(feature = "psram")]
        if external::holds(block) {
            // SAFETY: it came from there.
            return unsafe { GlobalAlloc::dealloc(&EXTERNAL, block, layout) };
        }
        // SAFETY: it came from there.
        unsafe { GlobalAlloc::dealloc(&HEAP, block, layout) }
    }
}

/// The external heap's place.
#[cfg(feature = "psram")]
mod external {
    use core::sync::atomic::{AtomicUsize, Ordering};

    static FROM: AtomicUsize = AtomicUsize::new(0);
    static TO: AtomicUsize = AtomicUsize::new(0);

    pub(super) fn set(from: usize, to: usize) {
        FROM.store(from, Ordering::Release);
        TO.store(to, Ordering::Release);
    }

    pub(super) fn is_there() -> bool {
        TO.load(Ordering::Acquire) != 0
    }

    pub(super) fn holds(block: *mut u8) -> bool {
        (FROM.load(Ordering::Acquire)..TO.load(Ordering::Acquire)).contains(&block.addr())
    }
}

/// Makes a heap of PSRAM. Call it once, before anything large is asked for.
///
/// # Safety
/// The memory is mapped for ever, and nobody else uses it.
#[cfg(feature = "psram")]
pub(crate) unsafe fn add_external(start: *mut u8, bytes: usize) {
    // SAFETY: as promised.
    unsafe {
        EXTERNAL.add_region(HeapRegion::new(
            start,
            bytes,
            MemoryCapability::External.into(),
        ));
    }
    external::set(start.addr(), start.addr() + bytes);
}

/// Memory of scripts: in PSRAM whatever its size, for internal RAM is too precious; where PSRAM is
/// missing or full, there is none.
#[cfg(feature = "psram")]
pub(crate) const LUA_HEAP: node::interpreter::Heap = node::interpreter::Heap(allocate_external);

/// Gives memory in PSRAM.
///
/// # Safety
/// As `GlobalAlloc::alloc`.
#[cfg(feature = "psram")]
unsafe fn allocate_external(layout: Layout) -> *mut u8 {
    // SAFETY: as promised.
    unsafe { EXTERNAL.alloc(layout) }
}

/// Returns what is free in internal RAM.
pub(crate) fn internal_free_bytes() -> usize {
    HEAP.free()
}

/// Returns what is free in PSRAM; `None`: there is none.
pub(crate) fn external_free_bytes() -> Option<usize> {
    #[cfg(feature = "psram")]
    return external::is_there().then(|| EXTERNAL.free());
    #[cfg(not(feature = "psram"))]
    None
}

/// Returns whether `count` texts of so many bytes each fit beside all else.
pub(crate) fn has_room(count: usize, bytes: usize) -> bool {
    let external = external_free_bytes().filter(|_| bytes >= LARGE_BYTES);
    let free = external.unwrap_or_else(internal_free_bytes);
    free >= count.saturating_mul(bytes).saturating_add(RESERVE_BYTES)
}
