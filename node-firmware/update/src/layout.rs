//! Where everything lies in the flash of a board: `esp32s3/partitions.csv` as numbers. A test holds
//! the two together.

use crate::region::Place;

/// Bytes of the flash.
pub const FLASH_BYTES: u32 = 0x80_0000;

/// The boot loader's own note of which slot it starts.
pub const OTADATA: Place = Place::new(0xd000, 0x2000);

/// The two slots for images.
pub const SLOTS: [Place; 2] = [
    Place::new(0x1_0000, 0x30_0000),
    Place::new(0x31_0000, 0x30_0000),
];

/// What `fleet provision` writes: two copies.
pub const RECORD: Place = Place::new(0x61_0000, 0x2000);

/// The journal of trials: see [`Trial`](crate::Trial).
pub const JOURNAL: Place = Place::new(0x61_2000, 0x2000);

/// Stored scripts.
pub const SCRIPTS: Place = Place::new(0x61_4000, 0x18_0000);

const _: () = assert!(SCRIPTS.at + SCRIPTS.bytes <= FLASH_BYTES);
