//! From our types to the official messages and back.
//!
//! The bytes are those of `zenoh-codec`; this module only fills and empties its structures.
//! [`handshake`] holds the four messages that open a session, [`network`] what is said in frames,
//! [`push`] the one message that is read part by part.

pub(crate) mod handshake;
pub(crate) mod network;
pub(crate) mod push;
