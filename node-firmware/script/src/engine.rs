//! The interpreter's half of a script: its state in Lua, its slices, its limits.
//!
//! Owns no command and knows no node: what the script calls is answered by whoever lets it step.

use crate::{
    End, Heap, Limits, Step, Wait,
    api::FUNCTIONS,
    desk::{Far, Post},
    ffi::{Calls, Sandbox, Stepped},
};
use alloc::{format, string::String};
use keys::LocalMicros;

/// Whoever carries out what a script calls, and knows when what it waits for is there.
pub(crate) trait Office: Calls {
    /// Returns whether what it waits for is there.
    fn is_due(&mut self, wait: Wait, now: LocalMicros) -> bool;
    /// Returns what its last call waits for.
    fn wait(&self) -> Option<Wait>;
    /// Returns whether it has done something that a runaway does not do.
    fn take_lives(&mut self) -> bool;
    /// It has returned: what it queued is executed.
    fn execute(&mut self);
}

/// See the module. Dropping it ends the script at whatever instruction it is.
#[derive(Debug)]
pub struct Engine {
    sandbox: Sandbox,
    limits: Limits,
    started_at: LocalMicros,
    slice_at: LocalMicros,
    slice_left: u32,
    wait: Wait,
}

impl Engine {
    /// Compiles a script. `name` is its chunk's name in messages; `heap` where its memory comes from,
    /// by default the program's heap.
    ///
    /// # Errors
    /// What is wrong with the text, with chunk and line.
    pub fn start(
        text: &str,
        name: &str,
        node_name: &str,
        limits: Limits,
        heap: Option<Heap>,
        now: LocalMicros,
    ) -> Result<Self, String> {
        let memory = limits.memory_bytes;
        let opened = Sandbox::new(memory, heap, limits.work_max, &FUNCTIONS, node_name);
        let mut sandbox = opened.ok_or_else(|| format!("{name}: not enough memory for Lua"))?;
        sandbox.compile(text, &format!("={name}"))?;
        Ok(Self {
            sandbox,
            limits,
            started_at: now,
            slice_at: now,
            slice_left: limits.slice_instructions,
            wait: Wait::Slice,
        })
    }

    /// Lets the script go on, for one slice at most; each of its calls is a letter to the node. When it
    /// has ended, the node must be told how.
    pub fn step_far(&mut self, now: LocalMicros, post: &mut dyn Post) -> Step {
        self.step(now, &mut Far::new(post))
    }

    /// Lets the script go on if what it waits for is there, for one slice at most.
    pub(crate) fn step(&mut self, now: LocalMicros, office: &mut dyn Office) -> Step {
        if now.since_us(self.started_at) >= self.limits.wall_us {
            let seconds = self.limits.wall_us / 1_000_000;
            return self.end(format!("the script took longer than {seconds} s"));
        }
        if now >= self.slice_at.plus_us(self.limits.slice_us) {
            self.slice_at = now;
            self.slice_left = self.limits.slice_instructions;
        }
        if self.slice_left == 0 || !office.is_due(self.wait, now) {
            return Step::Waits(self.wait);
        }
        let stepped = self.sandbox.step(self.slice_left, office);
        self.slice_left = self.sandbox.slice_left();
        if office.is_ended() {
            return Step::Ended(End::Stopped);
        }
        match stepped {
            Stepped::Yielded => {}
            Stepped::Returned(Ok(json)) => {
                office.execute();
                return Step::Ended(End::Returned { json });
            }
            Stepped::Returned(Err(error)) => {
                return self.end(format!("what the script returned: {error}"));
            }
            Stepped::Failed(message) => return Step::Ended(End::Failed { message }),
        }
        if office.take_lives() {
            self.sandbox.forgive();
        }
        if self.sandbox.is_starving() {
            let bytes = self.limits.memory_bytes;
            return self.end(format!(
                "the script asks for more than {bytes} bytes of memory"
            ));
        }
        if self.sandbox.used_instructions() >= self.limits.runaway_instructions {
            let count = self.limits.runaway_instructions;
            return self.end(format!(
                "runaway: {count} instructions without moving or waiting for anything"
            ));
        }
        self.wait = office.wait().unwrap_or(Wait::Slice);
        Step::Waits(self.wait)
    }

    /// Returns when a step has something to do by the clock; what depends on the queue or the sensors
    /// is seen when they change.
    pub fn poll_timeout(&self) -> LocalMicros {
        let next = self.slice_at.plus_us(self.limits.slice_us);
        let wall = self.started_at.plus_us(self.limits.wall_us);
        let due = match self.wait {
            Wait::Slice => next,
            Wait::Until(until)
            | Wait::Lidar {
                until: Some(until), ..
            } => until.max(next),
            Wait::Publish => next,
            // It may be over already, and only the slice used up.
            Wait::Room | Wait::Idle | Wait::Lidar { until: None, .. } if self.slice_left == 0 => {
                next
            }
            Wait::Room | Wait::Idle | Wait::Lidar { until: None, .. } => wall,
        };
        due.min(wall)
    }

    /// Returns what it waits for.
    pub fn wait(&self) -> Wait {
        self.wait
    }

    /// Returns how much memory it holds, bytes.
    pub fn memory_bytes(&self) -> usize {
        self.sandbox.memory_bytes()
    }

    /// Returns these words with a traceback of where the script is now.
    pub fn traceback(&mut self, words: &str) -> String {
        self.sandbox.traceback(words)
    }

    fn end(&mut self, words: String) -> Step {
        let message = self.sandbox.traceback(&words);
        Step::Ended(End::Failed { message })
    }
}
