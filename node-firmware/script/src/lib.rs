//! Lua on the node: a script can only produce commands, into the same queue as everything else.
//!
//! ```text
//!   text ─▶ Script::start ─▶ ┌──────── Script ────────┐
//!   now, Host ─────────────▶ │ step: one slice of Lua │ ─▶ Step::Running(Wait) | Ended(End)
//!                            │  api ─▶ Host::push     │
//!                            └────────────────────────┘
//! ```
//!
//! The engine is PUC Lua 5.4 with 32-bit integers and floats, the same on a board and a PC, so a
//! script that was tried on an emulated node does the same on the board. Read `api.rs` for what a
//! script can call, `host.rs` for what that needs, `ffi.rs` and `csrc/sandbox.c` for the border.
//!
//! [`Script`] is both halves of a script on one core: the interpreter ([`Engine`]) and what it has
//! queued. A board with two cores keeps them apart, and each call of a script is a letter from the one
//! to the other: see `desk.rs`.
//!
//! # What keeps a script harmless
//! - It runs in slices: a hook counts instructions, and work in C functions that no hook sees
//!   (patterns, sorting, tables with lengths of their own making) is counted in them and bounded.
//! - It gives way by a yield that goes through all its coroutines and that `pcall` cannot catch. A
//!   script that must end is simply never resumed.
//! - Its memory has a limit, and so have the depth of its calls and the time it may take.
//! - There is no `io`, `os`, `debug`, `package`, no bytecode, no finalizer.
//!
//! Absent on purpose: clock, queue, network. [`Host`] is all of that.
#![no_std]

extern crate alloc;

mod api;
mod desk;
mod engine;
mod ffi;
mod host;
mod json;

pub use api::{NAMES, Wait};
pub use desk::{Asked, Desk, FarCall, Post, Told};
pub use engine::Engine;
pub use ffi::Heap;
pub use host::{BarrierError, Full, Host, LidarReading};
pub use json::{JSON_BYTES_MAX, JsonError};

use alloc::string::String;
use api::{Doings, Turn};
use keys::LocalMicros;

/// Longest text of a script, bytes.
pub const SCRIPT_BYTES_MAX: usize = 64 * 1024;

/// What a script may take.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Limits {
    /// Memory for everything that Lua holds, bytes. An empty state has about 20,000.
    pub memory_bytes: usize,
    /// Instructions of one slice. About 30 million a second run on a PC, one million on the board.
    pub slice_instructions: u32,
    /// Time from the begin of one slice to the next, µs. The rest belongs to others.
    pub slice_us: u64,
    /// Work that one C function may do without giving way: characters compared, elements moved.
    pub work_max: usize,
    /// Instructions without waiting for anything, moving anything, or looking at something that
    /// moves, after which a script is a runaway.
    pub runaway_instructions: u64,
    /// Longest time from its begin to its end, µs.
    pub wall_us: u64,
}

impl Default for Limits {
    /// For a PC: a fifth of one processor at most, runaways end after 10 s, others after a day.
    fn default() -> Self {
        Self {
            memory_bytes: 1 << 20,
            slice_instructions: 10_000,
            slice_us: 1_000,
            work_max: 200_000,
            runaway_instructions: 100_000_000,
            wall_us: 86_400_000_000,
        }
    }
}

/// How a script ended by itself.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum End {
    /// It returned; everything that it queued is in the node's queue.
    Returned {
        /// What it returned, as JSON: a list if there was more than one value.
        json: Option<String>,
    },
    /// It failed, or was ended by a limit. What it queued and did not execute is forgotten.
    Failed {
        /// Chunk, line, what went wrong, and the traceback.
        message: String,
    },
    /// It asked for an emergency stop.
    Stopped,
}

/// Where a script is after a step.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Step {
    /// It goes on when this is over.
    Waits(Wait),
    /// It is over.
    Ended(End),
}

/// A script that runs. Dropping it ends it at whatever instruction it is.
#[derive(Debug)]
pub struct Script {
    engine: Engine,
    doings: Doings,
}

impl Script {
    /// Compiles a script. `name` is its chunk's name in messages; `first_command` the number that
    /// its first command gets in the node's queue, less one.
    ///
    /// # Errors
    /// What is wrong with the text, with chunk and line.
    pub fn start(
        text: &str,
        name: &str,
        node_name: &str,
        first_command: u64,
        limits: Limits,
        now: LocalMicros,
    ) -> Result<Self, String> {
        Ok(Self {
            engine: Engine::start(text, name, node_name, limits, None, now)?,
            doings: Doings::new(first_command),
        })
    }

    /// Lets the script go on if what it waits for is there, for one slice at most.
    pub fn step(&mut self, host: &mut dyn Host) -> Step {
        let now = host.now();
        let doings = &mut self.doings;
        self.engine.step(now, &mut Turn { doings, host })
    }

    /// Returns when [`Script::step`] has something to do by the clock; what depends on the queue or
    /// the sensors is seen when they change.
    pub fn poll_timeout(&self) -> LocalMicros {
        self.engine.poll_timeout()
    }

    /// Returns what it waits for.
    pub fn wait(&self) -> Wait {
        self.engine.wait()
    }

    /// Returns how many commands it has queued and not executed.
    pub fn staged_count(&self) -> usize {
        self.doings.staged_count()
    }

    /// Returns how much memory it holds, bytes.
    pub fn memory_bytes(&self) -> usize {
        self.engine.memory_bytes()
    }

    /// Returns these words with a traceback of where the script is now.
    pub fn traceback(&mut self, words: &str) -> String {
        self.engine.traceback(words)
    }
}
