//! On-board tests, for whoever has a board on the desk. It has never run: only its types were
//! checked.
#![no_std]
#![no_main]

fn main() {}
