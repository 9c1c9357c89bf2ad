//! A node in virtual time that is fed as a gateway would feed it.
#![allow(dead_code, reason = "each test uses a part of it")]

pub(crate) mod motor;

use emulator::{EmulatedNode, EmulatorConfig, Recording, oracle, record::Life};
use keys::{
    BatchHeader, Command, JobId, LocalMicros, NodeId, NodeTopic, QueueId, StopMode,
    batch::{BatchWriter, ORDER_BYTES_MAX},
    pace::PaceMessage,
};

/// A node in virtual time that is fed from a list as the gateway would: whenever there is room.
pub(crate) struct Bench {
    pub(crate) node: EmulatedNode,
    pub(crate) now: LocalMicros,
    pub(crate) waiting: std::collections::VecDeque<Command>,
    pub(crate) job_end: u64,
    /// What the node has logged.
    pub(crate) lines: Vec<String>,
}

pub(crate) fn config() -> EmulatorConfig {
    let mut config = EmulatorConfig::new(NodeId::new("bench").expect("legal"));
    config.record = Recording::Edges { max: 10_000_000 };
    config
}

impl Bench {
    pub(crate) fn new(config: EmulatorConfig) -> Self {
        let mut node = EmulatedNode::new(config, 7);
        node.link(true, LocalMicros(0));
        Self {
            node,
            now: LocalMicros(0),
            waiting: std::collections::VecDeque::new(),
            job_end: 0,
            lines: Vec::new(),
        }
    }

    pub(crate) fn order(&mut self, commands: impl IntoIterator<Item = Command>) {
        self.waiting.extend(commands);
        self.job_end = self.node.status().accepted_commands + self.waiting.len() as u64;
        self.feed();
    }

    pub(crate) fn feed(&mut self) {
        loop {
            let status = self.node.status();
            let mut writer = BatchWriter::new();
            while (u32::from(writer.command_count())) < status.credit_commands
                && let Some(command) = self.waiting.front()
                && writer.push(command)
            {
                self.waiting.pop_front();
            }
            if writer.command_count() == 0 {
                return;
            }
            let header = BatchHeader {
                queue: status.queue,
                first_command: status.accepted_commands,
                command_count: 0,
                job: JobId::new("j").expect("legal"),
                job_end: self.job_end,
            };
            let mut buffer = [0; ORDER_BYTES_MAX];
            let bytes = writer.finish(header, &mut buffer).expect("room").to_vec();
            self.node.handle(NodeTopic::Batch, &bytes, self.now);
            let taken = self.node.status().accepted_commands - status.accepted_commands;
            assert_eq!(taken, u64::from(writer.command_count()));
        }
    }

    pub(crate) fn run_until(&mut self, at_us: u64) {
        while let Some(due) = self.node.poll_timeout().filter(|due| due.0 <= at_us) {
            self.now = self.now.max(due);
            self.node.poll(self.now);
            self.drain();
            self.feed();
        }
        self.now = LocalMicros(at_us);
        self.node.poll(self.now);
        self.drain();
    }

    pub(crate) fn drain(&mut self) {
        let sent = self.node.outbox(self.now).into_iter();
        let lines = sent.filter(|sent| sent.topic == NodeTopic::Log);
        let text = |payload: &[u8]| String::from_utf8(payload.to_vec()).expect("text");
        self.lines.extend(lines.map(|line| text(&line.payload)));
    }

    pub(crate) fn run_for(&mut self, us: u64) {
        let at = self.now.0 + us;
        self.run_until(at);
    }

    pub(crate) fn run_to_rest(&mut self) {
        let mut wakes = 0u32;
        while self.node.status().executed_commands < self.job_end {
            let due = self.node.poll_timeout().expect("something is due");
            self.run_until(due.0.max(self.now.0));
            wakes += 1;
            let status = self.node.status();
            let faults = &status.faults;
            assert!(wakes < 5_000_000, "{:?}, {faults:?}", status.state);
        }
        let at = self.now.0 + 1_000;
        self.run_until(at);
    }

    pub(crate) fn stop(&mut self, mode: StopMode) {
        let payload = keys::Stop { mode }.to_payload();
        self.node.handle(NodeTopic::Stop, payload, self.now);
    }

    /// Runs until the stop of a queue is reported, and a second more, in which nothing may move.
    ///
    /// [`keys::NodeState::Stopped`] says that the latch is set, which it is while the axes still slow
    /// down; and the judge knows of a stop only by its report.
    pub(crate) fn run_to_report(&mut self, queue: QueueId) {
        let latest_us = self.now.0 + 300_000_000;
        let reported = |stop: keys::StopReport| stop.queue == queue;
        while !self.node.status().stop.is_some_and(reported) {
            assert!(self.now.0 < latest_us, "{queue:?} does not come to rest");
            self.run_for(20_000);
        }
        self.run_for(1_000_000);
    }

    pub(crate) fn release(&mut self) {
        let queue = self.node.status().queue;
        let mut buffer = [0; 64];
        let order = keys::Order::Release { queue };
        let bytes = keys::version::encode(&order, &mut buffer)
            .expect("room")
            .to_vec();
        self.node.handle(NodeTopic::Batch, &bytes, self.now);
    }

    /// Holds or resumes, as a gateway would that knows the node's last change.
    pub(crate) fn pace(&mut self, hold: bool) {
        self.node
            .handle(NodeTopic::Pace, &encoded(PaceMessage::Ask), self.now);
        let told = self.node.outbox(self.now);
        let told = told.iter().rfind(|out| out.topic == NodeTopic::Pace);
        let told = keys::version::decode(&told.expect("it is asked").payload);
        let Ok(PaceMessage::Told { boot, change, .. }) = told else {
            panic!("{told:?}");
        };
        let set = PaceMessage::Set {
            boot,
            change,
            hold: Some(hold),
            percent: None,
        };
        self.node.handle(NodeTopic::Pace, &encoded(set), self.now);
    }

    pub(crate) fn judged(&self) -> Life {
        let life = self.node.life();
        if let Err(violations) = oracle::check_life(&life) {
            let lines: Vec<_> = violations.iter().map(ToString::to_string).collect();
            panic!("{}", lines.join("\n"));
        }
        life
    }
}

fn encoded(message: PaceMessage) -> Vec<u8> {
    let mut buffer = [0; 64];
    keys::version::encode(&message, &mut buffer)
        .expect("room")
        .to_vec()
}
