//! The panels: what the model knows, on the screen. One noun a file, one function a panel.

pub mod alarms;
pub mod chooser;
pub mod composer;
mod editor;
pub mod fleet;
pub mod group_job;
pub mod groups;
pub mod help;
pub mod jobs;
pub mod log;
pub mod node;
mod node_plots;
mod node_setup;
mod preview;
pub mod pulses;
mod reach;
pub mod recording;
pub mod release;
pub mod stop;
mod table;
pub mod timeline;
pub mod top;
