//! What clients want of a fleet, and what they are answered.

use super::World;
use gateway::{
    fleet::{
        event::{Event, ReplyTo},
        node::Wish,
    },
    job::parse,
};
use keys::{NodeId, NodeTopic, Stop, StopMode};

/// A get and what came back.
#[derive(Clone, Debug, Default)]
pub struct Answers {
    /// Key (`None`: an error reply) and JSON.
    pub replies: Vec<(Option<String>, serde_json::Value)>,
    /// No more will come.
    pub ended: bool,
}

impl World {
    /// Publishes a job by get. The receipt comes later: see [`World::answers`].
    pub fn submit(&mut self, pattern: &str, job: &serde_json::Value) -> ReplyTo {
        let reply = self.ask();
        let parsed = parse::parse("application/json", job.to_string().as_bytes());
        self.tell(Event::Submit {
            pattern: pattern.to_owned(),
            request: parsed.request,
            id_hint: parsed.id_hint,
            reply: Some(reply),
        });
        reply
    }

    /// Publishes a synchronized job by get.
    pub fn submit_group(&mut self, group: &str, job: &serde_json::Value) -> ReplyTo {
        let reply = self.ask();
        let parsed = parse::parse_group("application/json", job.to_string().as_bytes());
        self.tell(Event::SubmitGroup {
            pattern: group.to_owned(),
            request: parsed.request,
            id_hint: parsed.id_hint,
            reply: Some(reply),
        });
        reply
    }

    /// Cancels a job.
    pub fn cancel(&mut self, job: &str) -> ReplyTo {
        let reply = self.ask();
        self.tell(Event::Cancel {
            pattern: job.to_owned(),
            reply: Some(reply),
        });
        reply
    }

    /// Lifts the stop latch of a node.
    pub fn release(&mut self, node: &str) -> ReplyTo {
        let reply = self.ask();
        self.tell(Event::Release {
            pattern: node.to_owned(),
            reply: Some(reply),
        });
        reply
    }

    /// Holds, resumes or changes the speed of a node.
    pub fn pace(&mut self, node: &str, wish: Wish) -> ReplyTo {
        let reply = self.ask();
        self.tell(Event::Pace {
            pattern: node.to_owned(),
            wish: Ok(wish),
            reply: Some(reply),
        });
        reply
    }

    /// Puts a stop on a node's key: node and gateway hear it, each if its link is there.
    pub fn stop(&mut self, node: &str, mode: StopMode) {
        self.tell(Event::Stop {
            pattern: node.to_owned(),
            mode,
        });
        let node = NodeId::new(node).expect("legal");
        self.send_to(node, NodeTopic::Stop, Stop { mode }.to_payload().to_vec());
    }

    /// Returns what came back to a get so far.
    pub fn answers(&self, of: ReplyTo) -> Answers {
        self.gets.get(&of).cloned().unwrap_or_default()
    }

    fn ask(&mut self) -> ReplyTo {
        self.asked += 1;
        ReplyTo(self.asked)
    }
}
