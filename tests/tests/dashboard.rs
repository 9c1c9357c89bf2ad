//! The dashboard without its window against a real fleet: its link, its model and what the composer
//! asks for, a gateway and three emulated nodes in this process, over real sockets.
//!
//! ```text
//!  Dashboard ─requests─▶ Link ──zenoh──▶ gateway ◀──zenoh── emulated nodes
//!      ▲────── heard ─────┘
//! ```
//!
//! Every wait is for something that the model shows; a deadline ends only a test that fails.

mod operator;

use dashboard::{
    message::{Answer, LinkEvent, Message, Moment},
    model::{Model, effort::Sending, node::Concern},
    panels::group_job,
    request::{Order, Request, Scope},
    text,
};
use emulator::{EmulatedHandle, EmulatorConfig};
use gateway::{config::GatewayConfig, service::Service};
use keys::{
    JobId, NodeId, NodeState, Status, StopMode,
    record::{JobRecord, JobState, NodeWord, StartPlan},
    version,
};
use operator::{Operator, answer};
use std::{
    collections::BTreeSet,
    sync::{Arc, Mutex},
};

struct Bench {
    operator: Operator,
    nodes: Vec<EmulatedHandle>,
    service: Option<Service>,
    locator: String,
    store: tempfile::TempDir,
}

const NAMES: [&str; 3] = ["left", "right", "top"];

async fn serve(locator: &str, store: &tempfile::TempDir) -> Service {
    let config = GatewayConfig {
        listen: vec![locator.to_owned()],
        ..GatewayConfig::new(store.path().join("fleet.redb"))
    };
    Service::start(config).await.expect("a gateway")
}

impl Bench {
    async fn start() -> Self {
        let store = tempfile::tempdir().expect("a folder");
        let service = serve("tcp/127.0.0.1:0", &store).await;
        let locator = service.locators().first().expect("a port").clone();
        let nodes = NAMES.map(|name| {
            let config = EmulatorConfig {
                connect: locator.clone(),
                // A busy machine takes its time; what is tested here is not the link loss.
                link_loss_after_us: 600_000_000,
                ..EmulatorConfig::new(NodeId::new(name).expect("a name"))
            };
            emulator::spawn(config).expect("a node")
        });
        Self {
            operator: Operator::at(&locator, None),
            nodes: nodes.into_iter().collect(),
            service: Some(service),
            locator,
            store,
        }
    }

    async fn end(self) {
        self.operator.leave();
        for node in self.nodes {
            node.shutdown().await;
        }
        if let Some(service) = self.service {
            service.shutdown().await.expect("an orderly end");
        }
    }
}

fn state(model: &Model, job: &str) -> Option<JobState> {
    let job = JobId::new(job).expect("a name");
    model.jobs().get(&job).map(|record| record.state)
}

fn all(model: &Model, word: NodeWord) -> bool {
    NAMES.iter().all(|name| {
        let id = NodeId::new(name).expect("a name");
        model.node(&id).is_some_and(|node| node.word() == word)
    })
}

#[tokio::test(flavor = "multi_thread", worker_threads = 4)]
async fn a_job_is_followed_to_its_end_and_a_stop_until_all_have_confirmed() {
    let mut bench = Bench::start().await;
    bench.operator.until("the gateway answers", |model| {
        model.link().gateway() == Some(true)
    });
    bench
        .operator
        .until("three idle nodes", |model| all(model, NodeWord::Idle));

    let job = r#"{"id":"first","commands":[{"move":{"axis":0,"delay_us":100,"steps":500}}]}"#;
    let ticket = bench.operator.submit("left", job);
    bench
        .operator
        .until("a receipt", |model| answer(model, ticket).is_some());
    let accepted = answer(bench.operator.model(), ticket).map(Answer::jobs);
    assert_eq!(accepted, Some(vec![JobId::new("first").expect("a name")]));
    bench.operator.until("succeeded", |model| {
        state(model, "first") == Some(JobState::Succeeded)
    });
    let left = NodeId::new("left").expect("a name");
    bench.operator.until("the time of its messages", |model| {
        let travelled = model.node(&left).and_then(|node| node.travelled().last());
        travelled.is_some_and(|known| known.rtt_us[0] > 0.0 && known.rtt_us[0] <= known.rtt_us[1])
    });
    bench.operator.until("the node's own word", |model| {
        let node = model.node(&left).expect("known");
        node.positions_steps().first() == Some(&500)
    });

    let ticket = bench
        .operator
        .submit_unchecked("left", r#"{"commands":[{"jump":{}}]}"#);
    bench
        .operator
        .until("a refusal", |model| answer(model, ticket).is_some());
    match answer(bench.operator.model(), ticket) {
        Some(Answer::Receipts(receipts)) => assert!(receipts[0].is_err()),
        answer => panic!("{answer:?}"),
    }

    // A long job on all, then the red button.
    let job = r#"{"commands":[{"move":{"axis":0,"delay_us":1000,"steps":1000000}}]}"#;
    bench.operator.submit("*", job);
    bench
        .operator
        .until("all run", |model| all(model, NodeWord::Running));
    for (order, pace, word) in [
        (Order::Hold, Some("held"), NodeWord::Paused),
        (Order::Speed(50), Some("held, at 50 %"), NodeWord::Paused),
        (Order::Resume, Some("at 50 %"), NodeWord::Running),
        (Order::Speed(100), None, NodeWord::Running),
    ] {
        let ticket = bench.operator.ask(Request::Order { node: left, order });
        bench.operator.until(&order.to_string(), |model| {
            let ordered = model.orders().of(&left).expect("asked");
            let taken = Some(Answer::Done {
                count: 1,
                refused: Vec::new(),
            });
            let node = model.node(&left).expect("known");
            ordered.ticket == ticket
                && ordered.answer == taken
                && node.pace().map(text::pace).as_deref() == pace
                && node.word() == word
        });
    }
    let (scope, mode) = (Scope::All, StopMode::Halt);
    let ticket = bench.operator.ask(Request::Stop { scope, mode });
    bench.operator.until("three confirmations", |model| {
        let effort = model.efforts().next().expect("begun");
        effort.ticket() == ticket && effort.expected() == 3 && effort.is_complete()
    });
    assert!(all(bench.operator.model(), NodeWord::Stopped));

    let scope = Scope::All;
    let ticket = bench.operator.ask(Request::Release { scope });
    bench.operator.until("three releases", |model| {
        let effort = model.efforts().next().expect("begun");
        effort.ticket() == ticket && effort.expected() == 3 && effort.is_complete()
    });

    // A slow stop is over when the node is at rest, and that it says itself.
    let job = r#"{"commands":[{"ramp":{"axis":0,"steps":1000000,"speed_hz":2000,"accel":4000}}]}"#;
    bench.operator.submit("left", job);
    let moves = |model: &Model| {
        let node = model.node(&left).expect("known");
        node.speeds_hz()
            .first()
            .is_some_and(|speed_hz| *speed_hz != 0.0)
    };
    bench.operator.until("it moves", moves);
    let (scope, mode) = (Scope::node(left), StopMode::Decelerate);
    let ticket = bench.operator.ask(Request::Stop { scope, mode });
    bench.operator.until("it has come to rest", |model| {
        let effort = model.efforts().next().expect("begun");
        effort.ticket() == ticket && effort.expected() == 1 && effort.is_complete()
    });
    assert!(!moves(bench.operator.model()));
    bench.end().await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 4)]
async fn the_link_comes_back_after_the_gateway_and_tells_what_is_true_meanwhile() {
    let mut bench = Bench::start().await;
    bench
        .operator
        .until("three idle nodes", |model| all(model, NodeWord::Idle));
    let service = bench.service.take().expect("it runs");
    service.shutdown().await.expect("an orderly end");
    bench
        .operator
        .until("no link", |model| !model.link().is_up());
    let gone = |model: &Model| {
        model
            .log()
            .lines()
            .iter()
            .any(|line| line.text == "is gone")
    };
    assert!(!gone(bench.operator.model()), "unheard of is not lost");
    let (scope, mode) = (Scope::All, StopMode::Halt);
    let ticket = bench.operator.ask(Request::Stop { scope, mode });
    bench.operator.until("the stop was not sent", |model| {
        let mut efforts = model.efforts();
        let effort = efforts.find(|effort| effort.ticket() == ticket);
        effort.is_some_and(|effort| matches!(effort.sending(), Sending::Failed(_)))
    });
    let locator = bench.locator.clone();
    bench.service = Some(serve(&locator, &bench.store).await);
    bench.operator.until("connected again", |model| {
        model.link().gateway() == Some(true)
    });
    bench.operator.until(
        "three idle nodes again, none stopped by what was asked before",
        |model| all(model, NodeWord::Idle),
    );
    // One goes for good.
    let leaver = bench.nodes.remove(0);
    let id = NodeId::new(NAMES[0]).expect("a name");
    leaver.shutdown().await;
    bench.operator.until("a node is lost", |model| {
        let node = model.node(&id).expect("known");
        model.concern(node) == Some(Concern::Lost)
    });
    bench.end().await;
}

/// Returns in which boot a node told how it is set.
fn told_in(model: &Model, node: &NodeId) -> Option<u32> {
    let node = model.node(node)?;
    let told = node.setup().told()?;
    assert_eq!(told.setup.name, Some(node.id()));
    told.boot
}

#[tokio::test(flavor = "multi_thread", worker_threads = 4)]
async fn a_node_tells_how_it_is_set_again_after_it_has_started_anew_and_not_when_it_is_gone() {
    let mut bench = Bench::start().await;
    let ids = NAMES.map(|name| NodeId::new(name).expect("a name"));
    bench
        .operator
        .until("three nodes by their own word", |model| {
            ids.iter()
                .all(|id| model.node(id).is_some_and(|node| node.boot().is_some()))
        });
    for id in ids {
        assert!(bench.operator.model().setup_is_due(&id));
        bench.operator.ask(Request::Setup { node: id });
        assert!(!bench.operator.model().setup_is_due(&id));
    }
    bench.operator.until("all have told", |model| {
        ids.iter().all(|id| told_in(model, id).is_some())
    });
    let left = bench.operator.model().node(&ids[0]).expect("known");
    let setup = &left.setup().told().expect("told").setup;
    assert_eq!(setup.link.router.as_str(), bench.locator);
    assert_eq!((setup.axes.len(), &*setup.chip), (2, "emulated"));
    assert_eq!(setup.link.loss_after_us, 600_000_000);
    bench.operator.until("the question is answered", |model| {
        let asked = model.node(&ids[0]).and_then(|node| node.setup().asked());
        let done = Answer::Done {
            count: 1,
            refused: Vec::new(),
        };
        asked.is_some_and(|asked| asked.answer == Some(done))
    });

    let before = told_in(bench.operator.model(), &ids[0]);
    bench.nodes[0].reset();
    bench.operator.until("it is to be asked anew", |model| {
        model.setup_is_due(&ids[0])
    });
    assert_eq!(told_in(bench.operator.model(), &ids[0]), before);
    bench.operator.ask(Request::Setup { node: ids[0] });
    bench.operator.until("it tells in its new boot", |model| {
        let boot = model.node(&ids[0]).and_then(|node| node.boot());
        told_in(model, &ids[0]) == boot && boot != before
    });

    let leaver = bench.nodes.remove(0);
    leaver.shutdown().await;
    bench.operator.until("it is gone", |model| {
        !model.node(&ids[0]).expect("known").is_there()
    });
    bench.operator.ask(Request::Setup { node: ids[0] });
    bench.operator.until("nobody answers", |model| {
        let asked = model.node(&ids[0]).and_then(|node| node.setup().asked());
        let failed = |answer: &Answer| matches!(answer, Answer::Failed(_));
        asked.is_some_and(|asked| asked.answer.as_ref().is_some_and(failed))
    });
    bench.end().await;
}

/// What was said about jobs, and which nodes said that they are ready, in order.
#[derive(Default)]
struct Said {
    records: Vec<JobRecord>,
    plans: Vec<StartPlan>,
    ready: BTreeSet<String>,
}

/// Writes down everything from now on. The window itself shows the latest only, and on a busy
/// machine passes over what lasts a quarter of a second.
async fn listener(locator: &str) -> (zenoh::Session, Arc<Mutex<Said>>) {
    let mut config = zenoh::Config::default();
    for (key, value) in [
        ("mode", "\"client\"".to_owned()),
        ("connect/endpoints", format!("[\"{locator}\"]")),
        ("scouting/multicast/enabled", "false".to_owned()),
    ] {
        config.insert_json5(key, &value).expect("a setting");
    }
    let session = zenoh::open(config).await.expect("a session");
    let said = Arc::new(Mutex::new(Said::default()));
    let of_records = Arc::clone(&said);
    let records = session.declare_subscriber("fleet/job/*");
    let records = records.callback(move |sample| {
        if let Ok(record) = serde_json::from_slice(&sample.payload().to_bytes()) {
            of_records.lock().expect("whole").records.push(record);
        }
    });
    records.background().await.expect("declared");
    let of_plans = Arc::clone(&said);
    let plans = session.declare_subscriber("fleet/manage/start/*");
    let plans = plans.callback(move |sample| {
        let plan = serde_json::from_slice(&sample.payload().to_bytes()).expect("a plan");
        of_plans.lock().expect("whole").plans.push(plan);
    });
    plans.background().await.expect("declared");
    let of_states = Arc::clone(&said);
    let states = session.declare_subscriber("fleet/node/*/status");
    let states = states.callback(move |sample| {
        let status: Result<Status, _> = version::decode(&sample.payload().to_bytes());
        if status.is_ok_and(|status| status.state == NodeState::Ready) {
            let key = sample.key_expr().to_string();
            of_states.lock().expect("whole").ready.insert(key);
        }
    });
    states.background().await.expect("declared");
    // On the same way as what was declared, so behind it.
    let replies = session.get("fleet/job/nobody").await.expect("asked");
    while replies.recv_async().await.is_ok() {}
    (session, said)
}

#[tokio::test(flavor = "multi_thread", worker_threads = 4)]
async fn a_synchronized_job_is_followed_from_ready_through_the_countdown_to_the_measured_skew() {
    let mut bench = Bench::start().await;
    bench
        .operator
        .until("three idle nodes, and clocks", |model| {
            let mut nodes = model.nodes();
            let clocks = nodes.all(|node| node.clock().is_some());
            all(model, NodeWord::Idle) && clocks && model.link().gateway() == Some(true)
        });
    let (session, said) = listener(&bench.locator).await;
    let ids = NAMES.map(|name| NodeId::new(name).expect("a name"));
    let part = r#"{"commands":[{"move":{"axis":0,"delay_us":500,"steps":200}}]}"#;
    let parts = ids.map(|id| (id, part.to_owned()));
    // Such as a busy machine's clocks can keep.
    bench.operator.dashboard.view.group_job.max_skew_us = 500_000.0;
    bench.operator.dashboard.view.group_job.ready_timeout_ms = 60_000.0;
    let ticket = bench.operator.start_together("saws", &parts);
    bench
        .operator
        .until("a receipt", |model| answer(model, ticket).is_some());
    let job = answer(bench.operator.model(), ticket).map(Answer::jobs);
    let job = *job.expect("an answer").first().expect("it is taken");
    bench.operator.until("it has ended", |model| {
        let record = model.jobs().get(&job);
        record.is_some_and(|record| record.state.is_final())
    });
    let model = bench.operator.model();
    let record = model.jobs().get(&job).expect("known").clone();
    let (_, words) = group_job::progress(model, &record);
    assert_eq!(record.state, JobState::Succeeded, "{words}");
    let start = record.start.as_ref().expect("measured");
    assert_eq!(start.by_node_us.len(), 3);
    assert!(
        words.contains(", started ") && words.contains(" apart ± "),
        "{words}"
    );
    assert_eq!(model.jobs().starts(&job), None);

    // What the window shows of each record at the moment of its writing.
    let said = std::mem::take(&mut *said.lock().expect("whole"));
    let ready: Vec<&str> = said.ready.iter().map(String::as_str).collect();
    let all_ready = NAMES.map(|name| format!("fleet/node/{name}/status"));
    assert_eq!(ready, all_ready);
    let mut window = Model::default();
    let to = bench.locator.clone();
    let connected = Message::Link(LinkEvent::Connected { to });
    window.apply(Moment(0), connected);
    let mut shown = Vec::new();
    let [plan] = said.plans[..] else {
        panic!("one plan, not {:?}", said.plans);
    };
    assert_eq!(
        (plan.job, plan.starts_at, plan.max_skew_us),
        (job, start.planned, 500_000.0)
    );
    let records = said.records.iter().filter(|told| told.job == job);
    let (before, behind): (Vec<_>, Vec<_>) = records.partition(|told| told.updated <= plan.told);
    let mut show = |at, message, record: &JobRecord| {
        window.apply(at, message);
        shown.push(group_job::progress(&window, record).1);
    };
    let tell = |told: &JobRecord| (Moment(told.updated.0), Message::Job(Box::new(told.clone())));
    for told in &before {
        let (at, message) = tell(told);
        show(at, message, told);
    }
    let last = before.last().expect("a record before the plan");
    show(Moment(plan.told.0), Message::StartPlan(plan), last);
    for told in behind {
        let (at, message) = tell(told);
        show(at, message, told);
    }
    let at = |part: &str| shown.iter().position(|words| words.contains(part));
    let (waits, counts) = (at(" of 3 ready"), at(", all ready, starts in "));
    let measured = at(" apart ± ");
    let in_order = waits.is_some() && waits < counts && counts < measured;
    assert!(in_order, "{shown:#?}");
    session.close().await.expect("closed");
    bench.end().await;
}
