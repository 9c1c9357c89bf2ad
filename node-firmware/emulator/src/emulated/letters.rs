//! Scripts that whoever has the node interprets.

use super::EmulatedNode;
use keys::LocalMicros;
use node::interpreter::ToInterpreter;
use script::{Asked, Told};

impl EmulatedNode {
    /// Gives what the interpreter has to know: see [`node::Node::take_script_word`].
    pub fn take_script_word(&mut self) -> Option<ToInterpreter> {
        self.node.take_script_word()
    }

    /// Returns the script whose wait is over: see [`node::Node::script_due`].
    pub fn script_due(&self) -> u32 {
        self.node.script_due()
    }

    /// Takes a letter of a script, and answers it: see [`node::Node::answer_script`].
    pub fn answer_script(&mut self, run: u32, asked: Asked, now: LocalMicros) -> Option<Told> {
        self.look(now);
        let told = self.node.answer_script(now, run, asked);
        self.observe(now);
        told
    }
}
