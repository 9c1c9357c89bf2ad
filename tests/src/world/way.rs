//! Links, and what comes and goes by them.

use super::World;
use crate::network::Message;
use gateway::fleet::event::{Effect, Event};
use keys::{
    LocalMicros, NodeId, NodeTopic, Topic,
    record::{JobRecord, NodeRecord},
};

impl World {
    pub(super) fn step_link(&mut self, name: NodeId) {
        let now_us = self.now_us;
        let due = |at_us: &mut Option<u64>| at_us.take_if(|at_us| *at_us <= now_us).is_some();
        let gateway_up = self.gateway.is_up();
        let machine = self.machines.get_mut(&name).expect("a node");
        let local = machine.clock.local_from_real(now_us);
        if due(&mut machine.notices_at_us) {
            machine.link_known = false;
            machine.node.link(false, local);
            machine.touched = true;
        }
        if due(&mut machine.missed_at_us) {
            machine.token_known = false;
            self.tell(Event::Alive {
                node: name,
                alive: false,
            });
        }
        let machine = self.machines.get_mut(&name).expect("a node");
        if gateway_up && due(&mut machine.returns_at_us) {
            self.mend(name);
        }
    }

    pub(super) fn mend(&mut self, name: NodeId) {
        let machine = self.machines.get_mut(&name).expect("a node");
        let local = machine.clock.local_from_real(self.now_us);
        machine.wired = true;
        machine.returns_at_us = None;
        machine.notices_at_us = None;
        // Whoever had not noticed sees a new session, which begins with the end of the old one.
        if machine.link_known {
            machine.node.link(false, local);
        }
        machine.link_known = true;
        machine.node.link(true, local);
        machine.touched = true;
        let known = machine.token_known && machine.missed_at_us.take().is_some();
        machine.token_known = true;
        if !known {
            self.tell(Event::Alive {
                node: name,
                alive: true,
            });
        }
        self.drain(name);
    }

    pub(super) fn deliver(&mut self, message: Message) {
        let Message {
            node,
            to_node,
            topic,
            payload,
        } = message;
        if !to_node {
            self.tell(Event::FromNode {
                node,
                topic,
                payload,
            });
            return;
        }
        let machine = self.machines.get_mut(&node).expect("a node");
        if !machine.link_known {
            return;
        }
        let local = machine.clock.local_from_real(self.now_us);
        machine.node.handle(topic, &payload, local);
        machine.touched = true;
        self.drain(node);
    }

    /// Sends what a node has to say.
    pub(super) fn drain(&mut self, name: NodeId) {
        let machine = self.machines.get_mut(&name).expect("a node");
        let local: LocalMicros = machine.clock.local_from_real(self.now_us);
        let wired = machine.wired;
        for outbound in machine.node.outbox(local) {
            let of_gateway = matches!(
                outbound.topic,
                NodeTopic::Status
                    | NodeTopic::Ack
                    | NodeTopic::Clock
                    | NodeTopic::Start
                    | NodeTopic::Report
                    | NodeTopic::Pace
            );
            // Into a broken link a node can speak until it notices.
            if wired && of_gateway {
                let message = Message {
                    node: name,
                    to_node: false,
                    topic: outbound.topic,
                    payload: outbound.payload.to_vec(),
                };
                self.network
                    .send(message, self.now_us, &self.faults, &mut self.random);
            }
        }
    }

    pub(super) fn send_to(&mut self, node: NodeId, topic: NodeTopic, payload: Vec<u8>) {
        if self
            .machines
            .get(&node)
            .is_some_and(|machine| machine.wired)
        {
            let message = Message {
                node,
                to_node: true,
                topic,
                payload,
            };
            self.network
                .send(message, self.now_us, &self.faults, &mut self.random);
        }
    }

    pub(super) fn tell(&mut self, event: Event) {
        if !self.replaced.is_empty() {
            self.tell_replaced(&event);
        }
        let effects = self.gateway.handle(event, self.now_us, &mut self.random);
        self.carry_out(effects);
    }

    pub(super) fn carry_out(&mut self, effects: Vec<Effect>) {
        for effect in effects {
            match effect {
                Effect::Persist(_) => unreachable!("the disk has taken it"),
                Effect::Publish { key, payload, .. } => self.publish(&key, payload),
                Effect::Reply { to, key, payload } => {
                    let json = serde_json::from_slice(&payload).expect("replies are JSON");
                    self.gets.entry(to).or_default().replies.push((key, json));
                }
                Effect::ReplyEnd { to } => self.gets.entry(to).or_default().ended = true,
            }
        }
    }

    fn publish(&mut self, key: &str, payload: Vec<u8>) {
        let keys = self.keys.clone();
        match keys.parse(key).expect("a key of the fleet") {
            Topic::Node {
                node,
                topic: NodeTopic::State,
            } => {
                let record: NodeRecord = serde_json::from_slice(&payload).expect("a node record");
                assert_eq!(record.node.as_str(), node);
                self.node_records.insert(record.node, record);
            }
            Topic::Node { node, topic } => {
                let node = NodeId::new(node).expect("orders go to one node");
                self.send_to(node, topic, payload);
            }
            Topic::Job { job } => {
                let record: JobRecord = serde_json::from_slice(&payload).expect("a job record");
                assert_eq!(record.job.as_str(), job);
                self.records.entry(record.job).or_default().push(record);
            }
            Topic::StartPlan { .. } => {}
            other => panic!("the gateway does not publish on {other:?}"),
        }
    }
}
