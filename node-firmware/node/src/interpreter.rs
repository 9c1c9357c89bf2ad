//! Scripts whose interpreter is on another core than the node.
//!
//! ```text
//!   Node ── take_script_word ── ToInterpreter ─▶ Interpreter      begin this text, end that run
//!   Node ◀─ answer_script ───── Asked ────────── Interpreter      one letter, one answer
//! ```
//!
//! Runs have numbers, so that what is late is known as such: the node answers nothing to a script that
//! it has ended, and the interpreter ends nothing that has begun since. `Letters` is what waits on the
//! node's side: at most the end of one run and the text of the next.
//!
//! Which core has which, and how letters get there, is the board's affair: see [`Mail`].

use crate::{NodeConfig, script::place_of};
use alloc::{boxed::Box, string::String};
use heapless::Deque;
use keys::{JobId, LocalMicros, NodeId};
pub use script::{Asked, Heap, Limits, Told};
use script::{End, Engine, Post, Step};

/// Words that wait for the interpreter: the end of one run, and the beginning of the next.
const WORDS_MAX: usize = 2;

/// What a node says to its interpreter.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum ToInterpreter {
    /// A script begins.
    Begin {
        /// Its number.
        run: u32,
        /// Its text.
        text: String,
        /// Its job, which is the chunk's name.
        job: JobId,
        /// The node's name.
        node: NodeId,
        /// What it may take.
        limits: Limits,
    },
    /// A script is over.
    End {
        /// Its number.
        run: u32,
        /// Why.
        reason: &'static str,
    },
}

/// The node's side.
#[derive(Debug, Default)]
pub(crate) struct Letters {
    words: Deque<ToInterpreter, WORDS_MAX>,
    /// Number of the last run.
    run: u32,
    /// The run whose wait is over; 0: none.
    pub(crate) due: u32,
}

impl Letters {
    /// A script begins; returns its number, which is never 0.
    pub(crate) fn begin(&mut self, text: String, job: JobId, config: &NodeConfig) -> u32 {
        self.run = self.run.wrapping_add(1).max(1);
        self.due = 0;
        // Cannot fail: at most the end of the run before waits.
        let _ = self.words.push_back(ToInterpreter::Begin {
            run: self.run,
            text,
            job,
            node: config.name,
            limits: config.script,
        });
        self.run
    }

    /// A script is over. Returns whether its interpreter has to know: not if it has not begun.
    pub(crate) fn end(&mut self, run: u32, reason: &'static str) -> bool {
        self.due = 0;
        if let Some(ToInterpreter::Begin { run: last, .. }) = self.words.back()
            && *last == run
        {
            self.words.pop_back();
            return false;
        }
        // Cannot fail: what waited when this run began was taken before its text was.
        let _ = self.words.push_back(ToInterpreter::End { run, reason });
        true
    }

    pub(crate) fn pop(&mut self) -> Option<ToInterpreter> {
        self.words.pop_front()
    }
}

/// How letters get to the node.
pub trait Mail {
    /// Carries a letter to [`Node::answer_script`](crate::Node::answer_script), and its answer back.
    fn ask(&mut self, run: u32, asked: Asked) -> Option<Told>;
    /// Returns what [`Node::script_due`](crate::Node::script_due) said last.
    fn due(&mut self) -> u32;
}

/// The other side: a script's interpreter, one at a time.
#[derive(Debug, Default)]
pub struct Interpreter {
    heap: Option<Heap>,
    runs: Option<Run>,
}

#[derive(Debug)]
struct Run {
    run: u32,
    engine: Box<Engine>,
    /// The node has ended it, and will say so.
    is_over: bool,
}

/// The letters of one run.
struct Stamped<'a> {
    run: u32,
    mail: &'a mut dyn Mail,
}

impl Post for Stamped<'_> {
    fn ask(&mut self, asked: Asked) -> Option<Told> {
        self.mail.ask(self.run, asked)
    }

    fn is_due(&mut self) -> bool {
        self.mail.due() == self.run
    }
}

impl Interpreter {
    /// Returns one without a script.
    pub const fn new() -> Self {
        Self {
            heap: None,
            runs: None,
        }
    }

    /// Scripts have their memory from here instead of the program's heap.
    pub fn set_heap(&mut self, heap: Heap) {
        self.heap = Some(heap);
    }

    /// Takes a word of the node.
    pub fn handle(&mut self, now: LocalMicros, word: ToInterpreter, mail: &mut dyn Mail) {
        match word {
            ToInterpreter::Begin {
                run,
                text,
                job,
                node,
                limits,
            } => {
                // Its memory first: the next one has as much.
                self.runs = None;
                let (job, node) = (job.as_str(), node.as_str());
                match Engine::start(&text, job, node, limits, self.heap, now) {
                    Ok(engine) => {
                        self.runs = Some(Run {
                            run,
                            engine: Box::new(engine),
                            is_over: false,
                        });
                    }
                    Err(message) => {
                        let _ = mail.ask(run, Asked::Ended(End::Failed { message }));
                    }
                }
            }
            ToInterpreter::End { run, reason } => {
                let ended = self.runs.take_if(|known| known.run == run);
                let place = ended.map_or_else(
                    // It has ended by itself at the same moment.
                    || String::from("its end"),
                    |mut ended| place_of(&ended.engine.traceback("")),
                );
                let _ = mail.ask(run, Asked::WasAt { reason, place });
            }
        }
    }

    /// Lets the script go on, for one slice at most. It keeps on until a step waits.
    pub fn step(&mut self, now: LocalMicros, mail: &mut dyn Mail) {
        let Some(running) = self.runs.as_mut().filter(|running| !running.is_over) else {
            return;
        };
        let run = running.run;
        match running.engine.step_far(now, &mut Stamped { run, mail }) {
            Step::Waits(_) => {}
            Step::Ended(End::Stopped) => running.is_over = true,
            Step::Ended(end) => {
                self.runs = None;
                let _ = mail.ask(run, Asked::Ended(end));
            }
        }
    }

    /// Returns when [`Interpreter::step`] has something to do by the clock; what depends on the node is
    /// said by [`Mail::due`].
    pub fn poll_timeout(&self) -> Option<LocalMicros> {
        let running = self.runs.as_ref().filter(|running| !running.is_over);
        running.map(|running| running.engine.poll_timeout())
    }
}
