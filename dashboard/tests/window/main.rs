//! The window, clicked by its accessible names, with a model fed from messages, and its pictures.
//! One program, because each would be linked with all of egui and a renderer.

mod fixture;
mod screen;

mod alarms;
mod chooser;
mod composer;
mod groups;
mod history;
mod node_page;
mod node_setup;
mod old;
mod panels;
mod pulses;
mod recording;
mod scale;
mod stop;
mod timeline;
