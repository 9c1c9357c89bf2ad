//! The tests of `script_functions.rs` once more, with the interpreter on another core than the node.

#[path = "script_functions.rs"]
mod near;
