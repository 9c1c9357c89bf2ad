//! A gateway that has as much history as it keeps does not grow any more: what its fleet and its store
//! hold on the heap is counted by the allocator after every full turn of the history.

use dhat::HeapStats;
use gateway::{
    fleet::{
        Fleet, FleetConfig,
        event::{Effect, Event, ReplyTo, Write},
    },
    job::parse,
    journal::Journal,
};
use keys::{
    AxisStatus, BatchReader, Features, FleetMicros, LocalMicros, NodeId, NodeState, NodeTopic,
    Order, QueueId, Status, Topic, record::JobState, version,
};

#[global_allocator]
static ALLOCATOR: dhat::Alloc = dhat::Alloc;

/// Jobs that are kept.
const KEPT: usize = 200;

/// Events whose writes are committed together, as by the service.
const EVENTS_PER_COMMIT: usize = 100;

/// A fleet with one node that executes a command as soon as it has it.
struct Plant {
    fleet: Fleet,
    journal: Journal,
    now_us: u64,
    queue: QueueId,
    executed: u64,
    submitted: u64,
    writes: Vec<Write>,
    event_count: usize,
}

impl Plant {
    fn new(journal: Journal) -> Self {
        let config = FleetConfig {
            retention_jobs: KEPT,
            ..FleetConfig::default()
        };
        Self {
            fleet: Fleet::new(config, 1),
            journal,
            now_us: 1_795_230_000_000_000,
            queue: QueueId { boot: 7, flush: 0 },
            executed: 0,
            submitted: 0,
            writes: Vec::new(),
            event_count: 0,
        }
    }

    fn event(&mut self, event: Event) {
        let mut events = vec![event];
        while let Some(event) = events.pop() {
            self.now_us += 1_000;
            let mut effects = Vec::new();
            self.fleet
                .handle(event, FleetMicros(self.now_us), &mut effects);
            for effect in effects {
                match effect {
                    Effect::Persist(write) => self.writes.push(write),
                    Effect::Publish { key, payload, .. } => {
                        events.extend(self.execute(&key, &payload));
                    }
                    _ => {}
                }
            }
        }
        self.event_count += 1;
        if self.event_count.is_multiple_of(EVENTS_PER_COMMIT) {
            let writes = std::mem::take(&mut self.writes);
            self.journal.commit(&writes).expect("there is room");
        }
    }

    /// The node's answer to a batch: it is done.
    fn execute(&mut self, key: &str, payload: &[u8]) -> Option<Event> {
        let topic = keys::Keys::default().parse(key).map(|topic| match topic {
            Topic::Node { topic, .. } => Some(topic),
            _ => None,
        })??;
        if topic != NodeTopic::Batch {
            return None;
        }
        let reader = BatchReader::new(payload).expect("an order");
        let Order::Batch(header) = *reader.order() else {
            return None;
        };
        self.executed = header.first_command + u64::from(header.command_count);
        Some(self.status())
    }

    fn status(&self) -> Event {
        let status = Status {
            at: LocalMicros(self.now_us),
            queue: self.queue,
            state: NodeState::Idle,
            stop: None,
            job: None,
            accepted_commands: self.executed,
            executed_commands: self.executed,
            credit_commands: 4_096,
            axes: [AxisStatus::default(); 2].into_iter().collect(),
            faults: Default::default(),
            features: Features::BASIC,
            firmware: [0, 1, 0],
            rssi_dbm: None,
            laser_percent: 0,
            lidar_mm: None,
        };
        let mut buffer = [0; 512];
        Event::FromNode {
            node: NodeId::new("left").expect("legal"),
            topic: NodeTopic::Status,
            payload: version::encode(&status, &mut buffer)
                .expect("room")
                .to_vec(),
        }
    }

    /// A job, one time in eight one that is refused, and what clients ask for meanwhile.
    fn job(&mut self) {
        let number = self.submitted;
        self.submitted += 1;
        let node = if number.is_multiple_of(8) {
            "nobody"
        } else {
            "left"
        };
        let text = format!(
            r#"{{"id":"job-{number:08}","commands":[{{"move":{{"axis":0,"delay_us":500,"steps":5}}}}]}}"#
        );
        let parsed = parse::parse("application/json", text.as_bytes());
        let reply = Some(ReplyTo(number));
        self.event(Event::Submit {
            pattern: node.to_owned(),
            request: parsed.request,
            id_hint: parsed.id_hint,
            reply,
        });
        let status = self.status();
        self.event(status);
        self.event(Event::GetJobs {
            pattern: "*".to_owned(),
            parameters: vec![("limit".to_owned(), "3".to_owned())],
            reply: ReplyTo(1 << 40 | number),
        });
        self.event(Event::Tick);
    }
}

#[test]
fn a_gateway_whose_history_is_full_takes_no_more_memory_for_another_thousand_jobs() {
    let profiler = dhat::Profiler::builder().testing().build();
    let folder = tempfile::tempdir().expect("a folder");
    let (journal, _) = Journal::open(folder.path().join("fleet.redb")).expect("opens");
    let mut plant = Plant::new(journal);
    let status = plant.status();
    plant.event(status);
    let mut held = Vec::new();
    for turn in 0..8 {
        for _ in 0..KEPT {
            plant.job();
        }
        let stats = HeapStats::get();
        println!(
            "turn {turn}: {} blocks, {} bytes",
            stats.curr_blocks, stats.curr_bytes
        );
        held.push((stats.curr_blocks, stats.curr_bytes));
    }
    let done = plant
        .fleet
        .jobs()
        .filter(|job| job.state() == JobState::Succeeded);
    assert!(done.count() > KEPT / 2, "jobs are done");
    assert!(plant.fleet.jobs().count() <= KEPT + 1);
    // The first two turns fill history, tables and the store's pages.
    let (settled, last) = (held[3], held[7]);
    assert!(
        last.0 < settled.0 + settled.0 / 20,
        "{settled:?}, and {last:?} after {} more jobs",
        4 * KEPT
    );
    // A table may double once more; four turns of history that nobody keeps would be far more.
    assert!(last.1 < 2 * settled.1, "{settled:?}, and {last:?}");
    drop(profiler);
}
