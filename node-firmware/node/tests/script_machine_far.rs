//! The tests of `script_machine.rs` once more, with the interpreter on another core than the node.

#[path = "script_machine.rs"]
mod near;
