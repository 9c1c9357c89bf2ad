//! What must hold for any bytes that reach this code from outside: one function for each border,
//! which panics if it does not.
//!
//! | module | border |
//! |---|---|
//! | [`wire`] | messages between gateway and node, and their records |
//! | [`batch`] | orders with their commands, as a node reads them |
//! | [`reader`] | a zenoh stream, cut anywhere |
//! | [`session`] | a zenoh conversation, whatever the router says |
//! | [`job`] | jobs as clients write them |
//! | [`key`] | keys |
//! | [`provision`] | the serial line, and the flash behind it |
//! | [`update`] | images over the network, and the flash behind them |
//! | [`node`] | a whole node, told anything in any order |
//! | [`script`] | Lua |
//! | [`tls`] | TLS of a node: records, what happens to them, certificates |
//! | [`proof`] | what stands before an order: an epoch, a proof that it is signed |
//! | [`signed`] | a whole node that asks for signatures, told anything by somebody who has no key |
//! | [`jog`] | moves by hand as clients write them |
//! | `store.rs` | the gateway's file, and what it takes up from it; apart, because it needs the gateway |
//! | `gcode.rs` | G-code; apart for the same reason |
//!
//! Each module has `check`, and `seeds`: a few inputs that reach far.

pub mod batch;
pub mod flash;
pub mod job;
pub mod jog;
pub mod key;
pub mod node;
pub mod proof;
pub mod provision;
pub mod reader;
pub mod script;
pub mod session;
pub mod signed;
pub mod tls;
pub mod update;
pub mod wire;

/// What a target consists of.
pub struct Target {
    /// Its name, and that of its corpus.
    pub name: &'static str,
    /// Panics if something is wrong.
    pub check: fn(&[u8]),
    /// A few inputs that reach far.
    pub seeds: fn() -> Vec<Vec<u8>>,
}

/// All targets that need no gateway.
pub const TARGETS: [Target; 14] = [
    Target {
        name: "wire",
        check: wire::check,
        seeds: wire::seeds,
    },
    Target {
        name: "batch",
        check: batch::check,
        seeds: batch::seeds,
    },
    Target {
        name: "reader",
        check: reader::check,
        seeds: reader::seeds,
    },
    Target {
        name: "session",
        check: session::check,
        seeds: session::seeds,
    },
    Target {
        name: "job",
        check: job::check,
        seeds: job::seeds,
    },
    Target {
        name: "key",
        check: key::check,
        seeds: key::seeds,
    },
    Target {
        name: "provision",
        check: provision::check,
        seeds: provision::seeds,
    },
    Target {
        name: "update",
        check: update::check,
        seeds: update::seeds,
    },
    Target {
        name: "node",
        check: node::check,
        seeds: node::seeds,
    },
    Target {
        name: "script",
        check: script::check,
        seeds: script::seeds,
    },
    Target {
        name: "tls",
        check: tls::check,
        seeds: tls::seeds,
    },
    Target {
        name: "proof",
        check: proof::check,
        seeds: proof::seeds,
    },
    Target {
        name: "signed",
        check: signed::check,
        seeds: signed::seeds,
    },
    Target {
        name: "jog",
        check: jog::check,
        seeds: jog::seeds,
    },
];

/// Takes pieces off the input: what is a choice here is a byte there.
pub struct Input<'d>(pub &'d [u8]);

impl<'d> Input<'d> {
    /// Takes a byte; 0 at the end.
    pub fn byte(&mut self) -> u8 {
        let Some((first, rest)) = self.0.split_first() else {
            return 0;
        };
        self.0 = rest;
        *first
    }

    /// Takes two bytes as a number.
    pub fn short(&mut self) -> u16 {
        u16::from_le_bytes([self.byte(), self.byte()])
    }

    /// Takes up to so many bytes.
    pub fn bytes(&mut self, count: usize) -> &'d [u8] {
        let (first, rest) = self.0.split_at(count.min(self.0.len()));
        self.0 = rest;
        first
    }

    /// Nothing is left.
    pub fn is_empty(&self) -> bool {
        self.0.is_empty()
    }
}
