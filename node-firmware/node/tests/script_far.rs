//! The tests of `script.rs` once more, with the interpreter on another core than the node.

#[path = "script.rs"]
mod near;
