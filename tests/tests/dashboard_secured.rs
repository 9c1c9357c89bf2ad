//! The dashboard's link to a secured fleet: by TLS, with the fleet's own authority, as a user. What
//! the user may not do is refused, and why a door stays shut is said.

mod operator;

use dashboard::{
    credentials,
    message::Answer,
    model::{Model, effort::Sending},
    request::{Request, Scope},
};
use emulator::EmulatorConfig;
use gateway::{
    config::GatewayConfig,
    security::{Home, Role},
    service::Service,
};
use keys::{
    NodeId, StopMode,
    credentials::Credentials,
    record::{JobState, NodeWord},
};
use operator::{Operator, answer};
use std::path::Path;

const JOB: &str = r#"{"id":"ten","commands":[{"move":{"axis":0,"delay_us":500,"steps":10}}]}"#;

struct Plant {
    service: Service,
    home: Home,
    folder: tempfile::TempDir,
}

fn name(text: &str) -> NodeId {
    NodeId::new(text).expect("a name")
}

impl Plant {
    async fn new() -> Self {
        let folder = tempfile::tempdir().expect("a folder");
        let at = folder.path().join("home");
        let mut home = Home::init(&at, &[]).expect("made");
        for (user, role) in [
            ("alice", Role::Operator),
            ("bob", Role::Viewer),
            ("left", Role::Node),
        ] {
            home.add(name(user), role).expect("added");
        }
        let service = Service::start(GatewayConfig {
            listen: vec!["tls/127.0.0.1:0".into(), "tcp/127.0.0.1:0".into()],
            secure: Some(at),
            ..GatewayConfig::new(folder.path().join("fleet.redb"))
        });
        Self {
            service: service.await.expect("a gateway"),
            home,
            folder,
        }
    }

    /// What a user's file would hold.
    fn of(&self, user: &str) -> Credentials {
        let mut users = self.home.users().iter();
        let user = users.find(|entry| entry.name.as_str() == user);
        self.home.credentials(user.expect("one of ours"))
    }

    fn operator(&self, credentials: Credentials) -> Operator {
        Operator::at(&self.service.locators()[0], Some(credentials))
    }

    fn node(&self) -> emulator::EmulatedHandle {
        let Credentials { user, password, .. } = self.of("left");
        let config = EmulatorConfig {
            connect: self.service.locators()[1].clone(),
            credentials: Some(emulator::Credentials { user, password }),
            link_loss_after_us: 600_000_000,
            ..EmulatorConfig::new(name("left"))
        };
        emulator::spawn(config).expect("a node")
    }
}

fn is(model: &Model, word: NodeWord) -> bool {
    model
        .node(&name("left"))
        .is_some_and(|node| node.word() == word)
}

fn stopped(model: &Model) -> bool {
    let effort = model.efforts().next();
    effort.is_some_and(|effort| effort.expected() == 1 && effort.is_complete())
}

#[tokio::test(flavor = "multi_thread", worker_threads = 4)]
async fn an_operator_moves_and_a_viewer_looks_on_and_stops() {
    let plant = Plant::new().await;
    let node = plant.node();
    let file = plant.folder.path().join("alice.json");
    std::fs::write(&file, plant.of("alice").to_json()).expect("a file");
    let error = credentials::read(&file).expect_err("others may read it");
    assert!(format!("{error:#}").contains("chmod 600"), "{error:#}");
    for_its_owner_alone(&file);
    let mut alice = plant.operator(credentials::read(&file).expect("credentials"));
    alice.until("an idle node", |model| is(model, NodeWord::Idle));
    alice.until("a gateway", |model| model.link().gateway() == Some(true));
    alice.submit("left", JOB);
    let ten = keys::JobId::new("ten").expect("a name");
    alice.until("succeeded", |model| {
        let record = model.jobs().get(&ten);
        record.is_some_and(|record| record.state == JobState::Succeeded)
    });

    let mut bob = plant.operator(plant.of("bob"));
    bob.until("an idle node", |model| is(model, NodeWord::Idle));
    bob.until("the job that ended", |model| {
        model.jobs().get(&ten).is_some()
    });
    bob.until("a gateway", |model| model.link().gateway() == Some(true));
    bob.ask(Request::Setup { node: name("left") });
    bob.until("how the node is set", |model| {
        let node = model.node(&name("left")).expect("known");
        let told = node.setup().told();
        told.is_some_and(|told| told.setup.link.user.as_deref() == Some("left"))
    });
    let ticket = bob.submit("left", &JOB.replace("ten", "more"));
    bob.until("an answer", |model| answer(model, ticket).is_some());
    let Some(Answer::Failed(why)) = answer(bob.model(), ticket) else {
        panic!("a viewer's job was answered");
    };
    assert!(why.contains("user bob may not do this"), "{why}");
    let (scope, mode) = (Scope::All, StopMode::Halt);
    bob.ask(Request::Stop { scope, mode });
    bob.until("his stop is confirmed", stopped);
    let scope = Scope::All;
    let ticket = bob.ask(Request::Release { scope });
    bob.until("his release is refused", |model| {
        let effort = model.efforts().next().expect("begun");
        let refused = matches!(effort.sending(), Sending::Failed(why) if why.contains("bob"));
        effort.ticket() == ticket && refused
    });
    alice.until("still stopped", |model| is(model, NodeWord::Stopped));
    let more = keys::JobId::new("more").expect("a name");
    assert!(alice.model().jobs().get(&more).is_none());
    let scope = Scope::All;
    alice.ask(Request::Release { scope });
    alice.until("released", |model| is(model, NodeWord::Idle));
    alice.leave();
    bob.leave();
    node.shutdown().await;
    plant.service.shutdown().await.expect("an orderly end");
}

#[cfg(unix)]
fn for_its_owner_alone(file: &Path) {
    use std::os::unix::fs::PermissionsExt as _;
    let mode = std::fs::Permissions::from_mode(0o600);
    std::fs::set_permissions(file, mode).expect("ours");
}

#[tokio::test(flavor = "multi_thread", worker_threads = 4)]
async fn a_door_that_stays_shut_says_why() {
    let plant = Plant::new().await;
    let stranger = plant.folder.path().join("another");
    let mut stranger = Home::init(&stranger, &[]).expect("made");
    stranger.add(name("alice"), Role::Operator).expect("added");
    let alice = plant.of("alice");
    let foreign = stranger.credentials(&stranger.users()[0]).ca;
    let wrong_password = Credentials {
        password: "hush".to_owned(),
        ..alice.clone()
    };
    let with_ca = |ca: Option<&str>| Credentials {
        ca: ca.map(str::to_owned),
        ..alice.clone()
    };
    let (tls, tcp) = (&plant.service.locators()[0], &plant.service.locators()[1]);
    // A port that was somebody's a moment ago.
    let nobody = std::net::TcpListener::bind("127.0.0.1:0").and_then(|bound| bound.local_addr());
    let nobody = &format!("tls/{}", nobody.expect("a port"));
    let doors = [
        (
            tls,
            Some(wrong_password),
            "wrong user or password, or revoked",
        ),
        (
            tls,
            Some(with_ca(foreign.as_deref())),
            "its certificate is not one of this fleet",
        ),
        (
            tls,
            Some(with_ca(None)),
            "cannot be checked: nobody said whose to trust",
        ),
        (
            tls,
            Some(with_ca(Some("rubbish"))),
            "there is no certificate in `ca`",
        ),
        (tls, None, "nobody said whose to trust"),
        (tcp, None, "it asks for a user"),
        (nobody, Some(alice), "nothing answers at tls/127.0.0.1:"),
    ];
    for (locator, credentials, words) in doors {
        let mut operator = Operator::at(locator, credentials);
        operator.until(words, |model| model.link().why().is_some());
        let why = operator.model().link().why().expect("told");
        assert!(why.contains(words), "{why}, not: {words}");
        assert!(!why.contains("hush"), "{why}");
        operator.leave();
    }
    plant.service.shutdown().await.expect("an orderly end");
}
