//! A script whose interpreter is on another core than the node.
//!
//! ```text
//!      core with the network                             core that plans
//!   Engine ─ a call ─▶ Post::ask ── Asked ──────────────▶ Desk::answer ─▶ Host (the node)
//!                          ▲                                   │
//!                          └───────────── Told ◀───────────────┘
//! ```
//!
//! There is at most one letter on its way: a script that has called waits for the answer before its
//! next instruction. So nothing can pile up, a script sees the node as if it was beside it, and when it
//! has moved something the next call knows it. What no answer can be given to yet (room in the queue, a
//! time, the end of everything) is answered with a wait, and asked again when that is over.
//!
//! The desk belongs to the node. A stop takes it away, and whatever the interpreter does then, in
//! however long a loop, has no effect: its next letter is answered by nothing, which ends it.

use crate::{
    End, Host, JsonError, Wait,
    api::{Doings, Turn},
    engine::Office,
    ffi::{Answer, Call, Calls, REPLIES_MAX, Reply, Value},
};
use alloc::{
    string::{String, ToString},
    vec::Vec,
};
use keys::LocalMicros;

/// Most bytes of one text in a letter. No function takes one of more than 65 bytes, and the log cuts
/// its lines: what is longer is cut.
const TEXT_BYTES_MAX: usize = 1_024;

/// Instructions that a call costs beyond its own when it goes to another core: about as long as the
/// letter takes, so that a slice of many calls is no longer than one of none.
const LETTER_INSTRUCTIONS: u32 = 50;

/// What a script has to say to its node.
#[derive(Clone, Debug, PartialEq)]
pub enum Asked {
    /// It calls a function.
    Call(FarCall),
    /// It prints a line.
    Print(String),
    /// It is over, by itself.
    Ended(End),
    /// It was ended, for this reason, and was at this place.
    WasAt {
        /// Why.
        reason: &'static str,
        /// Chunk and line.
        place: String,
    },
}

/// A call with its arguments.
#[derive(Clone, Debug, PartialEq)]
pub struct FarCall {
    function: usize,
    args: Vec<Arg>,
    again: bool,
    json: Option<Result<String, JsonError>>,
}

#[derive(Clone, Debug, PartialEq)]
enum Arg {
    Nil,
    Boolean(bool),
    Integer(i32),
    Number(f32),
    Text(Vec<u8>),
    Other(String),
}

impl Arg {
    fn of(value: &Value<'_>) -> Self {
        match *value {
            Value::Nil => Self::Nil,
            Value::Boolean(value) => Self::Boolean(value),
            Value::Integer(value) => Self::Integer(value),
            Value::Number(value) => Self::Number(value),
            Value::Text(text) => Self::Text(text[..text.len().min(TEXT_BYTES_MAX)].to_vec()),
            Value::Other(kind) => Self::Other(kind.to_string()),
        }
    }

    fn value(&self) -> Value<'_> {
        match self {
            Self::Nil => Value::Nil,
            Self::Boolean(value) => Value::Boolean(*value),
            Self::Integer(value) => Value::Integer(*value),
            Self::Number(value) => Value::Number(*value),
            Self::Text(text) => Value::Text(text),
            Self::Other(kind) => Value::Other(kind),
        }
    }
}

/// What the node says to it.
#[derive(Clone, Debug, PartialEq)]
pub struct Told {
    answer: Answer,
    /// Why not, or a stored script.
    text: Vec<u8>,
    /// The table, where the answer is one.
    fields: Vec<[Option<Reply>; REPLIES_MAX]>,
    cost: u32,
    lives: bool,
    wait: Option<Wait>,
}

impl Told {
    /// It was heard.
    pub const HEARD: Self = Self {
        answer: Answer::Return([None; REPLIES_MAX]),
        text: Vec::new(),
        fields: Vec::new(),
        cost: 0,
        lives: false,
        wait: None,
    };
}

/// Whoever carries letters between the cores.
pub trait Post {
    /// Carries a letter to the node and its answer back. `None`: the script is over.
    fn ask(&mut self, asked: Asked) -> Option<Told>;
    /// Returns whether what the last answer waits for is there, as the node has said.
    fn is_due(&mut self) -> bool;
}

/// The node's half of a script.
#[derive(Debug)]
pub struct Desk {
    doings: Doings,
}

impl Desk {
    /// Opens one; `first_command` is the number that the script's first command gets in the node's
    /// queue, less one.
    pub const fn new(first_command: u64) -> Self {
        Self {
            doings: Doings::new(first_command),
        }
    }

    /// Carries out a call.
    pub fn answer(&mut self, host: &mut dyn Host, call: &FarCall) -> Told {
        let args: Vec<Value<'_>> = call.args.iter().map(Arg::value).collect();
        let doings = &mut self.doings;
        let mut turn = Turn { doings, host };
        let answer = turn.call(Call {
            function: call.function,
            args: &args,
            again: call.again,
            json: call.json.clone(),
        });
        let fields = match answer {
            Answer::Table => (0..)
                .map_while(|index| turn.field(call.function, index))
                .collect(),
            _ => Vec::new(),
        };
        let has_text = matches!(answer, Answer::Error | Answer::Script);
        let text = if has_text { turn.text() } else { &[] };
        Told {
            answer,
            text: text.to_vec(),
            fields,
            cost: turn.take_cost(),
            lives: turn.take_lives(),
            wait: self.doings.wait,
        }
    }

    /// Returns what the script waits for.
    pub fn wait(&self) -> Wait {
        self.doings.wait.unwrap_or(Wait::Slice)
    }

    /// Returns whether that is there.
    pub fn is_due(&self, host: &dyn Host) -> bool {
        self.wait().is_over(host)
    }

    /// The script has returned: what it queued is executed.
    pub fn finish(&mut self, host: &mut dyn Host) {
        self.doings.execute(host);
    }
}

/// The calls of a script as letters, for one step.
pub(crate) struct Far<'a> {
    post: &'a mut dyn Post,
    told: Told,
    is_over: bool,
}

impl<'a> Far<'a> {
    pub(crate) fn new(post: &'a mut dyn Post) -> Self {
        Self {
            post,
            told: Told::HEARD,
            is_over: false,
        }
    }

    fn ask(&mut self, asked: Asked) -> Option<Told> {
        if self.is_over {
            return None;
        }
        let told = self.post.ask(asked);
        self.is_over = told.is_none();
        told
    }
}

impl Calls for Far<'_> {
    fn call(&mut self, call: Call<'_>) -> Answer {
        let lives = self.told.lives;
        let told = self.ask(Asked::Call(FarCall {
            function: call.function,
            args: call.args.iter().map(Arg::of).collect(),
            again: call.again,
            json: call.json,
        }));
        let Some(told) = told else {
            return Answer::Wait;
        };
        self.told = told;
        self.told.cost += LETTER_INSTRUCTIONS;
        self.told.lives |= lives;
        self.told.answer
    }

    fn field(&mut self, _: usize, index: usize) -> Option<[Option<Reply>; REPLIES_MAX]> {
        self.told.fields.get(index).copied()
    }

    fn text(&self) -> &[u8] {
        &self.told.text
    }

    fn print(&mut self, line: &[u8]) {
        let line = &line[..line.len().min(TEXT_BYTES_MAX)];
        let line = String::from_utf8_lossy(line).into_owned();
        let _ = self.ask(Asked::Print(line));
    }

    fn take_cost(&mut self) -> u32 {
        core::mem::take(&mut self.told.cost)
    }

    fn is_ended(&self) -> bool {
        self.is_over
    }
}

impl Office for Far<'_> {
    fn is_due(&mut self, wait: Wait, now: LocalMicros) -> bool {
        match wait {
            Wait::Slice | Wait::Publish => true,
            // Both cores have the same clock.
            Wait::Until(until)
            | Wait::Lidar {
                until: Some(until), ..
            } if now >= until => true,
            _ => self.post.is_due(),
        }
    }

    fn wait(&self) -> Option<Wait> {
        self.told.wait
    }

    fn take_lives(&mut self) -> bool {
        core::mem::take(&mut self.told.lives)
    }

    fn execute(&mut self) {
        // The node does that when it hears that the script has returned.
    }
}
