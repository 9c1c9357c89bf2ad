//! A node as the gateway sees one, without motors: it takes numbered commands, lets each take its
//! time, stops, cancels, releases and reports. Written from the messages' documentation, not from
//! the firmware.

use keys::{
    AxisStatus, BatchAck, BatchReader, Command, Features, JobId, LocalMicros, NodeId, NodeState,
    NodeTopic, Order, QueueId, Refusal, Status, Stop, StopMode, StopReason, StopReport, Verdict,
    clock::{ClockMessage, ClockReply},
    signed::Proof,
    start::StartMessage,
};
use std::collections::HashMap;

/// Time between two words that it is ready, µs.
const READY_US: u64 = 100_000;

/// Time between two words that it has started, µs, and how many there are.
const STARTED_US: u64 = 200_000;
const STARTED_COUNT: u32 = 5;

/// A commit that was taken.
#[derive(Clone, Copy, Debug)]
struct Armed {
    start_at: LocalMicros,
    confirm_by: LocalMicros,
    confirmed: bool,
}

/// A start that is told until everybody must have heard it.
#[derive(Clone, Copy, Debug)]
struct Told {
    queue: QueueId,
    command: u64,
    edge_us: u64,
    send_us: u64,
    left_count: u32,
}

/// How long a deceleration takes, µs.
const DECELERATE_US: u64 = 20_000;

#[derive(Clone, Debug)]
pub struct FakeNode {
    pub id: NodeId,
    pub link_up: bool,
    pub features: Features,
    pub axis_count: usize,
    pub ring_commands: usize,
    /// Refuses a command with this many steps, as a firmware with other limits would.
    pub refuses_steps: Option<i32>,
    /// Understands no order.
    pub deaf: bool,
    /// While it is pressed, nothing is released.
    pub stop_pin: bool,
    /// Every command that was ever taken, with its queue and number.
    pub taken: Vec<(QueueId, u64, JobId, Command)>,
    /// How many commands of each job have ended.
    pub done: HashMap<JobId, u64>,
    /// Jobs of the commands in the queue.
    jobs: Vec<JobId>,
    booted_us: u64,
    pub queue: QueueId,
    commands: Vec<Command>,
    executed: u64,
    /// When the command that is executed began.
    began_us: Option<u64>,
    pub positions: Vec<i64>,
    job: Option<(JobId, u64)>,
    pub latched: Option<StopReason>,
    /// Comes to rest: why, and when it does.
    stopping: Option<(StopReason, u64)>,
    last_stop: Option<StopReport>,
    told_us: u64,
    told_state: NodeState,
    outbox: Vec<(NodeTopic, Vec<u8>)>,
    armed: Option<Armed>,
    /// When it says again that it is ready.
    ready_us: Option<u64>,
    starts: Vec<Told>,
    /// Its first edge leaves so much later than it should, µs.
    pub edge_late_us: u64,
    /// It never says that it is ready.
    pub mute: bool,
    /// It never says that it has started.
    pub mute_started: bool,
    /// Every barrier that it passed: job, number of the meeting point, and when.
    pub passed: Vec<(JobId, u16, u64)>,
}

impl FakeNode {
    pub fn new(id: NodeId, boot: u32, now_us: u64) -> Self {
        let mut node = Self {
            id,
            link_up: true,
            features: Features::BASIC,
            axis_count: 2,
            ring_commands: 4096,
            refuses_steps: None,
            deaf: false,
            stop_pin: false,
            taken: Vec::new(),
            done: HashMap::new(),
            jobs: Vec::new(),
            booted_us: now_us,
            queue: QueueId { boot, flush: 0 },
            commands: Vec::new(),
            executed: 0,
            began_us: None,
            positions: vec![0; 2],
            job: None,
            latched: None,
            stopping: None,
            last_stop: None,
            told_us: now_us,
            told_state: NodeState::Idle,
            outbox: Vec::new(),
            armed: None,
            ready_us: None,
            starts: Vec::new(),
            edge_late_us: 0,
            mute: false,
            mute_started: false,
            passed: Vec::new(),
        };
        node.tell(now_us);
        node
    }

    pub fn reboot(&mut self, boot: u32, now_us: u64) {
        let fresh = Self::new(self.id, boot, now_us);
        *self = Self {
            features: self.features,
            ring_commands: self.ring_commands,
            refuses_steps: self.refuses_steps,
            taken: std::mem::take(&mut self.taken),
            done: std::mem::take(&mut self.done),
            passed: std::mem::take(&mut self.passed),
            edge_late_us: self.edge_late_us,
            mute: self.mute,
            axis_count: self.axis_count,
            stop_pin: self.stop_pin,
            ..fresh
        };
    }

    pub fn link(&mut self, up: bool, now_us: u64) {
        self.link_up = up;
        self.outbox.clear();
        if up {
            self.tell(now_us);
        }
    }

    pub fn accepted(&self) -> u64 {
        self.commands.len() as u64
    }

    pub fn is_active(&self) -> bool {
        self.stopping.is_some() || self.executed < self.accepted()
    }

    pub fn take_outbox(&mut self) -> Vec<(NodeTopic, Vec<u8>)> {
        std::mem::take(&mut self.outbox)
    }

    pub fn handle(&mut self, topic: NodeTopic, payload: &[u8], now_us: u64) {
        self.poll(now_us);
        match topic {
            NodeTopic::Batch => {
                let verdict = self.order(payload, now_us);
                self.acknowledge(verdict);
            }
            NodeTopic::Stop => {
                let mode = Stop::from_payload(payload).mode;
                self.stop(StopReason::Client, mode, now_us);
            }
            NodeTopic::Clock => {
                let message = keys::version::decode(payload).expect("a clock message");
                let ClockMessage::Probe(probe) = message else {
                    panic!("no probe")
                };
                let reply = ClockMessage::Reply(ClockReply {
                    probe: probe.probe,
                    boot: self.queue.boot,
                    sent_at: probe.sent_at,
                    received_at: self.local(now_us),
                    replied_at: self.local(now_us),
                });
                self.push(NodeTopic::Clock, &reply);
            }
            NodeTopic::Start => {
                let message = keys::version::decode(payload).expect("a start message");
                self.hear_start(message, now_us);
                self.poll(now_us);
            }
            other => panic!("a node does not hear {other:?}"),
        }
    }

    /// The barrier at which it waits, with everything behind it loaded as far as it fits.
    fn barrier(&self) -> Option<(u64, u16)> {
        let Some(Command::Barrier { barrier }) = self.commands.get(self.executed as usize) else {
            return None;
        };
        let (_, job_end) = self.job?;
        let loaded = self.accepted() > self.executed + 1 || self.accepted() == job_end;
        let rests = self.stopping.is_none() && self.latched.is_none();
        (loaded && rests && self.began_us.is_some()).then_some((self.executed, *barrier))
    }

    fn hear_start(&mut self, message: StartMessage, now_us: u64) {
        let queue = self.queue;
        let here = self.barrier().map(|(command, _)| (queue, command));
        let now = self.local(now_us);
        match message {
            StartMessage::Commit {
                queue,
                command,
                start_at,
                confirm_by,
            } => {
                let in_time = now < confirm_by && confirm_by.0 + 2_000 <= start_at.0;
                let confirmed = self.armed.is_some_and(|armed| armed.confirmed);
                if here != Some((queue, command)) || (!in_time && !confirmed) {
                    return;
                }
                if !confirmed {
                    self.armed = Some(Armed {
                        start_at,
                        confirm_by,
                        confirmed: false,
                    });
                }
                self.ready_us = None;
                self.push(NodeTopic::Start, &StartMessage::Armed { queue, command });
            }
            StartMessage::Confirm { queue, command } => {
                if let Some(armed) = &mut self.armed
                    && here == Some((queue, command))
                    && now < armed.confirm_by
                {
                    armed.confirmed = true;
                }
            }
            StartMessage::Abort { queue, command } => {
                if let Some(armed) = self.armed
                    && here == Some((queue, command))
                    && now < armed.start_at
                {
                    self.armed = None;
                }
                if here == Some((queue, command)) && self.armed.is_none() {
                    self.ready_us = Some(now_us);
                }
            }
            StartMessage::Ready { .. }
            | StartMessage::ReadyAt { .. }
            | StartMessage::Armed { .. }
            | StartMessage::Started { .. } => panic!("a node's own word"),
        }
    }

    fn poll_start(&mut self, now_us: u64) {
        if let Some(armed) = self.armed
            && !armed.confirmed
            && self.local(now_us) >= armed.confirm_by
        {
            self.armed = None;
        }
        let Some((command, _)) = self.barrier() else {
            self.ready_us = None;
            self.armed = None;
            return;
        };
        if self.armed.is_none() && !self.mute {
            let at_us = *self.ready_us.get_or_insert(now_us);
            if now_us >= at_us {
                self.ready_us = Some(now_us + READY_US);
                let queue = self.queue;
                self.push(NodeTopic::Start, &StartMessage::Ready { queue, command });
            }
        }
    }

    fn poll_started(&mut self, now_us: u64) {
        let mut said = Vec::new();
        for told in &mut self.starts {
            if now_us >= told.send_us {
                told.left_count -= 1;
                told.send_us = now_us + STARTED_US;
                said.push(*told);
            }
        }
        self.starts.retain(|told| told.left_count > 0);
        if self.mute_started {
            return;
        }
        for told in said {
            let started = StartMessage::Started {
                queue: told.queue,
                command: told.command,
                first_edge_at: self.local(told.edge_us),
            };
            self.push(NodeTopic::Start, &started);
        }
    }

    /// It goes on at a barrier.
    fn pass(&mut self, barrier: u16, at_us: u64) {
        self.armed = None;
        self.ready_us = None;
        let job = self.jobs[self.executed as usize];
        self.passed.push((job, barrier, at_us));
        let mut edge_us = at_us;
        for command in &self.commands[self.executed as usize + 1..] {
            match command {
                Command::Pause { pause_ms } => edge_us += u64::from(*pause_ms) * 1_000,
                Command::Move { .. } | Command::SyncMove { .. } => {
                    edge_us += self.edge_late_us;
                    break;
                }
                Command::Barrier { .. } => {
                    edge_us = at_us;
                    break;
                }
                _ => {}
            }
        }
        self.starts.push(Told {
            queue: self.queue,
            command: self.executed,
            edge_us,
            send_us: edge_us,
            left_count: STARTED_COUNT,
        });
    }

    pub fn poll(&mut self, now_us: u64) {
        if let Some((reason, at_us)) = self.stopping
            && now_us >= at_us
        {
            self.stopping = None;
            self.end_queue(reason, at_us, now_us);
        }
        while let Some(end_us) = self.command_end() {
            if now_us < end_us {
                break;
            }
            let command = self.commands[self.executed as usize];
            if let Command::Barrier { barrier } = command {
                self.pass(barrier, end_us);
                self.executed += 1;
                self.began_us = (self.executed < self.accepted()).then_some(end_us);
                continue;
            }
            for (position, steps) in self.positions.iter_mut().zip(steps_of(&command)) {
                *position += steps;
            }
            if let Command::SetPosition {
                axis,
                position_steps,
            } = command
            {
                self.positions[axis.index()] = position_steps;
            }
            *self
                .done
                .entry(self.jobs[self.executed as usize])
                .or_default() += 1;
            self.executed += 1;
            self.began_us = (self.executed < self.accepted()).then_some(end_us);
            if self.job.is_some_and(|(_, end)| self.executed >= end) {
                self.job = None;
                self.tell(now_us);
            }
        }
        let was_ready = self.state() == NodeState::Ready;
        self.poll_start(now_us);
        self.poll_started(now_us);
        let new_state = was_ready != (self.told_state == NodeState::Ready);
        if new_state || now_us >= self.told_us + self.period_us() {
            self.tell(now_us);
        }
    }

    pub fn poll_timeout(&self) -> Option<u64> {
        let at_rest = self.stopping.map(|(_, at_us)| at_us);
        let status = self.link_up.then_some(self.told_us + self.period_us());
        let disarm = self.armed.filter(|armed| !armed.confirmed);
        let disarm = disarm.map(|armed| armed.confirm_by.0 + self.booted_us);
        let ready = self.ready_us.filter(|_| self.armed.is_none());
        let told = self.starts.iter().map(|told| told.send_us).min();
        [self.command_end(), at_rest, status, disarm, ready, told]
            .into_iter()
            .flatten()
            .min()
    }

    pub fn stop(&mut self, reason: StopReason, mode: StopMode, now_us: u64) {
        if self.latched.is_some() {
            return;
        }
        match (mode, self.stopping) {
            (StopMode::Halt, _) => {
                self.stopping = None;
                self.end_queue(reason, now_us, now_us);
            }
            (StopMode::Decelerate, Some((StopReason::Cancel, at_us))) => {
                self.stopping = Some((reason, at_us));
                self.tell(now_us);
            }
            (StopMode::Decelerate, Some(_)) => {}
            (StopMode::Decelerate, None) => {
                self.cut_short(now_us);
                self.stopping = Some((reason, now_us + DECELERATE_US));
                self.tell(now_us);
            }
        }
    }

    fn order(&mut self, payload: &[u8], now_us: u64) -> Verdict {
        // It asks for no signature; what signs an order stands before it.
        let order = Proof::split(payload).map(|(_, order)| order);
        let reader = order.and_then(BatchReader::new).ok();
        let reader = reader.filter(|_| !self.deaf);
        let Some(mut reader) = reader else {
            return Verdict::Refused(Refusal::Malformed);
        };
        let header = match *reader.order() {
            Order::Batch(header) => header,
            Order::Cancel { queue, mode } => {
                if queue != self.queue {
                    let over = queue.boot == self.queue.boot && queue.flush < self.queue.flush;
                    return if over {
                        Verdict::Duplicate
                    } else {
                        Verdict::Refused(Refusal::Stale)
                    };
                }
                if self.latched.is_some() {
                    return Verdict::Refused(Refusal::Stopped);
                }
                if self.stopping.is_some() {
                    return Verdict::Duplicate;
                }
                self.stop(StopReason::Cancel, mode, now_us);
                return Verdict::Accepted;
            }
            Order::Release { queue } => {
                if queue != self.queue {
                    return Verdict::Refused(Refusal::Stale);
                }
                if self.stopping.is_some() || self.stop_pin {
                    return Verdict::Refused(Refusal::Stopped);
                }
                if self.latched.take().is_none() {
                    return Verdict::Duplicate;
                }
                self.tell(now_us);
                return Verdict::Accepted;
            }
            // A node without Lua.
            Order::Script(_) | Order::ScriptSeen { .. } => {
                return Verdict::Refused(Refusal::Malformed);
            }
        };
        if header.queue != self.queue {
            return Verdict::Refused(Refusal::Stale);
        }
        if self.latched.is_some() || self.stopping.is_some() {
            return Verdict::Refused(Refusal::Stopped);
        }
        let end = header.first_command + u64::from(header.command_count);
        if end <= self.accepted() {
            return Verdict::Duplicate;
        }
        if header.first_command < self.accepted() {
            return Verdict::Refused(Refusal::Overlap);
        }
        if header.first_command > self.accepted() {
            return Verdict::Refused(Refusal::Gap);
        }
        let mut commands = Vec::new();
        while let Some(command) = reader.next_command().expect("well formed") {
            if steps_of(&command).any(|steps| Some(steps) == self.refuses_steps.map(i64::from)) {
                let index = commands.len() as u16;
                return Verdict::Refused(Refusal::BadCommand { index });
            }
            commands.push(command);
        }
        if commands.len() > self.credit() {
            return Verdict::Refused(Refusal::QueueShort);
        }
        for command in commands {
            let number = self.accepted();
            self.taken.push((self.queue, number, header.job, command));
            self.commands.push(command);
            self.jobs.push(header.job);
        }
        self.began_us.get_or_insert(now_us);
        if self.job != Some((header.job, header.job_end)) {
            self.job = Some((header.job, header.job_end));
            self.tell(now_us);
        }
        Verdict::Accepted
    }

    fn credit(&self) -> usize {
        let held = (self.accepted() - self.executed) as usize;
        self.ring_commands.saturating_sub(held)
    }

    fn period_us(&self) -> u64 {
        if self.is_active() { 100_000 } else { 1_000_000 }
    }

    fn local(&self, now_us: u64) -> LocalMicros {
        LocalMicros(now_us - self.booted_us)
    }

    fn command_end(&self) -> Option<u64> {
        let command = self.commands.get(self.executed as usize)?;
        if self.stopping.is_some() {
            return None;
        }
        if let Command::Barrier { .. } = command {
            let armed = self.armed.filter(|armed| armed.confirmed)?;
            return Some(armed.start_at.0 + self.booted_us);
        }
        Some(self.began_us? + duration_us(command))
    }

    /// The command that is executed is left where it is.
    fn cut_short(&mut self, now_us: u64) {
        if let (Some(command), Some(began_us)) = (
            self.commands.get(self.executed as usize).copied(),
            self.began_us,
        ) {
            let total_us = duration_us(&command).max(1);
            let part_us = (now_us - began_us).min(total_us);
            for (position, steps) in self.positions.iter_mut().zip(steps_of(&command)) {
                *position += steps * part_us as i64 / total_us as i64;
            }
        }
        self.began_us = None;
    }

    fn end_queue(&mut self, reason: StopReason, at_us: u64, now_us: u64) {
        self.cut_short(now_us);
        self.last_stop = Some(StopReport {
            queue: self.queue,
            reason,
            at: self.local(at_us),
            accepted_commands: self.accepted(),
            executed_commands: self.executed,
            positions_steps: self.positions.iter().copied().collect(),
        });
        self.queue.flush += 1;
        self.armed = None;
        self.ready_us = None;
        self.commands.clear();
        self.jobs.clear();
        self.executed = 0;
        self.began_us = None;
        self.job = None;
        self.latched = (reason != StopReason::Cancel).then_some(reason);
        self.tell(now_us);
    }

    fn acknowledge(&mut self, verdict: Verdict) {
        let ack = BatchAck {
            queue: self.queue,
            verdict,
            accepted_commands: self.accepted(),
            executed_commands: self.executed,
            credit_commands: self.credit() as u32,
        };
        self.push(NodeTopic::Ack, &ack);
    }

    pub fn status(&self, now_us: u64) -> Status {
        Status {
            at: self.local(now_us),
            queue: self.queue,
            state: self.state(),
            stop: self.last_stop.clone(),
            job: self.job.map(|(job, _)| job),
            accepted_commands: self.accepted(),
            executed_commands: self.executed,
            credit_commands: self.credit() as u32,
            axes: self
                .positions
                .iter()
                .take(self.axis_count)
                .map(|position| AxisStatus {
                    position_steps: *position,
                    speed_mhz: 0,
                })
                .collect(),
            faults: Default::default(),
            features: self.features,
            firmware: [0, 1, 0],
            rssi_dbm: None,
            laser_percent: 0,
            lidar_mm: None,
        }
    }

    fn state(&self) -> NodeState {
        let stopping = self
            .stopping
            .filter(|(reason, _)| *reason != StopReason::Cancel);
        match self.latched.or(stopping.map(|(reason, _)| reason)) {
            Some(StopReason::Fault) => NodeState::Fault,
            Some(_) => NodeState::Stopped,
            None if self.barrier().is_some() => NodeState::Ready,
            None if self.is_active() => NodeState::Running,
            None => NodeState::Idle,
        }
    }

    pub fn tell(&mut self, now_us: u64) {
        self.told_us = now_us;
        self.told_state = self.state();
        let status = self.status(now_us);
        self.push(NodeTopic::Status, &status);
    }

    fn push<M: serde::Serialize>(&mut self, topic: NodeTopic, message: &M) {
        if !self.link_up {
            return;
        }
        let mut buffer = [0; 512];
        let bytes = keys::version::encode(message, &mut buffer).expect("fits");
        self.outbox.push((topic, bytes.to_vec()));
    }
}

/// Steps of each axis.
fn steps_of(command: &Command) -> impl Iterator<Item = i64> {
    let steps = match *command {
        Command::Move { axis, steps, .. } if axis.0 == 0 => [steps, 0],
        Command::Move { steps, .. } => [0, steps],
        Command::SyncMove { steps, .. } => steps,
        _ => [0, 0],
    };
    steps.into_iter().map(i64::from)
}

fn duration_us(command: &Command) -> u64 {
    let one = |delay_us: u32, steps: i32| u64::from(delay_us) * u64::from(steps.unsigned_abs());
    match *command {
        Command::Move {
            delay_us, steps, ..
        } => one(delay_us, steps),
        Command::SyncMove { delay_us, steps } => {
            one(delay_us[0], steps[0]).max(one(delay_us[1], steps[1]))
        }
        Command::Pause { pause_ms } => u64::from(pause_ms) * 1_000,
        _ => 0,
    }
}
