//! Hold, resume and speed on the key `pace`: rest on the path without losing it, go on, run slower or
//! faster.
//!
//! ```text
//!   gateway                                     node
//!      Ask ──────────────────────────────────────▶
//!        ◀──────────────────────────────── Told { change: 4, hold: false, percent: 100 }
//!      Set { change: 4, hold: true } ─────────────▶   held, and one change more
//!        ◀──────────────────────────────── Told { change: 5, hold: true, percent: 100 }
//!      Set { change: 4, hold: true } ─────────────▶   late or twice: no effect
//! ```
//!
//! What a node does is its own state: it counts the changes of it, by whomever, and takes only what
//! was said in the knowledge of the last one. So nothing that comes late or twice lets a machine move.
//! The node tells each change, and all of it when its link comes.
//!
//! Held while it homes an axis, a node brings that to rest by its own ramp, wherever it is on its way,
//! and goes on from there: a switch that is reached meanwhile counts when it was reached, and the axis
//! ends at the same place. It may be held as long as one likes; nothing runs out. A stop while it is held
//! ends homing, and the axis is as unhomed as by any stop of it.

use serde::{Deserialize, Serialize};

/// Slowest speed, percent of what the commands ask for.
pub const SPEED_PERCENT_MIN: u16 = 1;

/// Fastest speed, percent of what the commands ask for; never faster than the drivers allow.
pub const SPEED_PERCENT_MAX: u16 = 400;

/// Both directions share the key, so the message says which one it is. Append only.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum PaceMessage {
    /// Gateway → node: tell.
    Ask,
    /// Gateway → node: change, if nothing has changed since.
    Set {
        /// The node's boot.
        boot: u32,
        /// The last change that the node has told.
        change: u32,
        /// Rest on the path, or go on; `None`: as it is.
        hold: Option<bool>,
        /// Speed, percent; `None`: as it is.
        percent: Option<u16>,
    },
    /// Node → gateway: how it is.
    Told {
        /// The node's boot.
        boot: u32,
        /// Number of changes since its boot.
        change: u32,
        /// Whether it rests on its path or is about to.
        hold: bool,
        /// Speed, percent.
        percent: u16,
    },
}
