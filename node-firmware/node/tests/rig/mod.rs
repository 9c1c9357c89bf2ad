//! A node on a bench: virtual time, virtual pulse unit, everything it says in a list.
#![allow(
    dead_code,
    unreachable_pub,
    missing_docs,
    reason = "each test file uses another part of this one"
)]

use emulator::{EmulatedNode, EmulatorConfig};
use keys::{
    AxisId, BatchAck, BatchHeader, Command, JobId, LocalMicros, NodeId, NodeState, NodeTopic,
    Order, QueueId, Status, StopMode, Verdict,
    batch::{BatchWriter, ORDER_BYTES_MAX},
    version,
};
use node::{
    interpreter::{Interpreter, Mail},
    library::BoxedStore,
};
use script::{Asked, Told};

/// The boot of every node on the bench.
pub const BOOT: u32 = 7;

pub struct Rig {
    pub node: EmulatedNode,
    /// Where scripts are interpreted if the node does not do it itself.
    pub interpreter: Interpreter,
    pub now: LocalMicros,
    pub sent: Vec<(LocalMicros, NodeTopic, Vec<u8>)>,
}

/// The tests whose names end in `_far` are those of another file with the interpreter on another core.
pub fn config() -> EmulatorConfig {
    let mut config = EmulatorConfig::new(NodeId::new("left").expect("legal"));
    config.scripts_elsewhere = env!("CARGO_CRATE_NAME").ends_with("_far");
    config
}

/// Carries letters between the cores without any delay.
pub struct Courier<'a> {
    pub node: &'a mut EmulatedNode,
    pub now: LocalMicros,
}

impl Mail for Courier<'_> {
    fn ask(&mut self, run: u32, asked: Asked) -> Option<Told> {
        self.node.answer_script(run, asked, self.now)
    }

    fn due(&mut self) -> u32 {
        self.node.script_due()
    }
}

/// `steps` steps of axis 0, 100 µs apart.
pub fn steps(steps: i32) -> Command {
    Command::Move {
        axis: AxisId(0),
        delay_us: 100,
        steps,
    }
}

pub fn job(name: &str) -> JobId {
    JobId::new(name).expect("legal")
}

/// Numbers below a bound, from a seed that is not 0 (xorshift).
pub fn random(seed: u64) -> impl FnMut(u64) -> u64 {
    let mut state = seed.wrapping_mul(0x9e37_79b9_7f4a_7c15);
    move |below| {
        state ^= state << 13;
        state ^= state >> 7;
        state ^= state << 17;
        state % below
    }
}

/// The bytes of a batch.
pub fn batch_bytes(header: BatchHeader, commands: &[Command]) -> Vec<u8> {
    let mut writer = BatchWriter::new();
    for command in commands {
        assert!(writer.push(command), "the batch is full");
    }
    let mut buffer = [0; ORDER_BYTES_MAX];
    writer.finish(header, &mut buffer).expect("room").to_vec()
}

impl Rig {
    /// A node with its link up and its first status taken.
    pub fn new(config: EmulatorConfig) -> Self {
        Self::with_node(EmulatedNode::new(config, BOOT))
    }

    /// The same, with its stored scripts in this store.
    pub fn with_store(config: EmulatorConfig, store: BoxedStore) -> Self {
        Self::with_node(EmulatedNode::with_store(config, BOOT, store))
    }

    /// The same around a node that is made already.
    pub fn with_node(node: EmulatedNode) -> Self {
        let mut rig = Self {
            node,
            interpreter: Interpreter::new(),
            now: LocalMicros(0),
            sent: Vec::new(),
        };
        rig.link(true);
        rig
    }

    pub fn link(&mut self, up: bool) {
        self.node.link(up, self.now);
        self.drain();
    }

    /// Lets the other core do what it can at this instant.
    pub fn interpret(&mut self) {
        let (node, now) = (&mut self.node, self.now);
        while let Some(word) = node.take_script_word() {
            self.interpreter
                .handle(now, word, &mut Courier { node, now });
        }
        self.interpreter.step(now, &mut Courier { node, now });
    }

    pub fn drain(&mut self) {
        self.interpret();
        for message in self.node.outbox(self.now) {
            let payload = message.payload.as_slice().to_vec();
            self.sent.push((self.now, message.topic, payload));
        }
    }

    fn due(&self) -> Option<LocalMicros> {
        let due = [self.node.poll_timeout(), self.interpreter.poll_timeout()];
        due.into_iter().flatten().min()
    }

    /// Lets time pass to `at_us`, waking whenever the node asks for it.
    pub fn run_until(&mut self, at_us: u64) {
        let mut wakes_now = 0;
        while let Some(due) = self.due()
            && due.0 <= at_us
        {
            wakes_now = if due > self.now { 0 } else { wakes_now + 1 };
            assert!(
                wakes_now < 100,
                "the node asks to be woken at once for ever"
            );
            self.now = self.now.max(due);
            self.node.poll(self.now);
            self.drain();
        }
        self.now = LocalMicros(at_us.max(self.now.0));
        self.node.poll(self.now);
        self.drain();
    }

    pub fn run_for(&mut self, us: u64) {
        self.run_until(self.now.0 + us);
    }

    pub fn put(&mut self, topic: NodeTopic, payload: &[u8]) {
        self.node.handle(topic, payload, self.now);
        self.drain();
    }

    /// Sends an order's bytes and returns the answer.
    pub fn order_bytes(&mut self, bytes: &[u8]) -> BatchAck {
        let before = self.sent.len();
        self.put(NodeTopic::Batch, bytes);
        let acks: Vec<_> = self.sent[before..]
            .iter()
            .filter(|(_, topic, _)| *topic == NodeTopic::Ack)
            .map(|(_, _, payload)| version::decode::<BatchAck>(payload).expect("an ack"))
            .collect();
        let answers: Vec<_> = acks
            .iter()
            .filter(|ack| ack.verdict != Verdict::Credit)
            .collect();
        assert_eq!(answers.len(), 1, "one answer for one order");
        *answers[0]
    }

    pub fn order(&mut self, order: &Order) -> BatchAck {
        let mut buffer = [0; ORDER_BYTES_MAX];
        let bytes = version::encode(order, &mut buffer).expect("room").to_vec();
        self.order_bytes(&bytes)
    }

    /// The header of commands that come next in the present queue and end their job.
    pub fn next_header(&self, count: usize) -> BatchHeader {
        let status = self.node.status();
        BatchHeader {
            queue: status.queue,
            first_command: status.accepted_commands,
            command_count: count as u16,
            job: job("j"),
            job_end: status.accepted_commands + count as u64,
        }
    }

    /// Sends commands that come next.
    pub fn batch(&mut self, commands: &[Command]) -> BatchAck {
        let header = self.next_header(commands.len());
        self.order_bytes(&batch_bytes(header, commands))
    }

    pub fn stop(&mut self, mode: StopMode) {
        self.put(NodeTopic::Stop, keys::Stop { mode }.to_payload());
    }

    pub fn cancel(&mut self, queue: QueueId, mode: StopMode) -> BatchAck {
        self.order(&Order::Cancel { queue, mode })
    }

    pub fn release(&mut self, queue: QueueId) -> BatchAck {
        self.order(&Order::Release { queue })
    }

    pub fn status(&self) -> Status {
        self.node.status()
    }

    pub fn state(&self) -> NodeState {
        self.node.status().state
    }

    pub fn queue(&self) -> QueueId {
        self.node.status().queue
    }

    /// The position of axis 0; it must be what the pulse counter says.
    pub fn position(&self) -> i64 {
        let position = self.node.position_steps(AxisId(0));
        assert_eq!(position, self.node.step_count(AxisId(0)), "ledger and pins");
        position
    }

    /// The statuses that were sent.
    pub fn statuses(&self) -> Vec<(LocalMicros, Status)> {
        self.sent
            .iter()
            .filter(|(_, topic, _)| *topic == NodeTopic::Status)
            .map(|(at, _, payload)| (*at, version::decode(payload).expect("a status")))
            .collect()
    }

    /// The log lines that were sent.
    pub fn lines(&self) -> Vec<String> {
        self.sent
            .iter()
            .filter(|(_, topic, _)| *topic == NodeTopic::Log)
            .map(|(_, _, payload)| String::from_utf8(payload.clone()).expect("text"))
            .collect()
    }

    /// The acks that were sent.
    pub fn acks(&self) -> Vec<(LocalMicros, BatchAck)> {
        self.sent
            .iter()
            .filter(|(_, topic, _)| *topic == NodeTopic::Ack)
            .map(|(at, _, payload)| (*at, version::decode(payload).expect("an ack")))
            .collect()
    }
}
