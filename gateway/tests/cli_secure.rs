//! What an operator types to keep a fleet: signing keys, backups, the doctor. The program itself,
//! against a gateway and a node in this process, over TLS.

use emulator::{EmulatorConfig, wall};
use gateway::{
    config::GatewayConfig,
    security::{Home, Role},
    service::Service,
};
use keys::NodeId;
use std::{
    fs,
    path::{Path, PathBuf},
    process::Output,
    time::Duration,
};

/// Far more than anything here takes; only a failure waits so long.
const PATIENCE: Duration = Duration::from_secs(60);

struct Desk {
    folder: tempfile::TempDir,
    connect: String,
}

impl Desk {
    fn path(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    /// Runs the program as the operator.
    async fn fleet(&self, line: &[&str]) -> (i32, String) {
        let credentials = self.path("home/alice.json");
        let mut command = assert_cmd::Command::new(env!("CARGO_BIN_EXE_fleet"));
        command
            .current_dir(self.folder.path())
            .env_clear()
            .timeout(PATIENCE)
            .arg("--credentials")
            .arg(credentials)
            .args(["--connect", &self.connect])
            .args(line);
        let run = tokio::task::spawn_blocking(move || command.output());
        let Output {
            status,
            stdout,
            stderr,
        } = run.await.expect("ran").expect("ran");
        let text = [stdout, stderr].concat();
        let text = String::from_utf8(text).expect("text");
        (status.code().unwrap_or(-1), text)
    }
}

fn signers(home: &Path) -> heapless::Vec<[u8; 32], 8> {
    let text = fs::read_to_string(home.join("signers")).expect("there");
    let list = keys::signers::parse(&text).expect("a list");
    list.iter().map(|signer| signer.key.0).collect()
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn an_operator_makes_a_key_signs_a_job_takes_a_backup_and_has_it_looked_at() {
    let folder = tempfile::tempdir().expect("a folder");
    let home = folder.path().join("home");
    let mut made = Home::init(&home, &[]).expect("made");
    for (user, role) in [("alice", Role::Operator), ("left", Role::Node)] {
        let name = NodeId::new(user).expect("legal");
        made.add(name, role).expect("added");
    }
    let mut desk = Desk {
        folder,
        connect: "tls/localhost:1".to_owned(),
    };
    let (code, text) = desk.fleet(&["keys", "home", "new", "alice"]).await;
    assert!(code == 0 && text.contains("alice.key"), "{text}");
    let (code, text) = desk.fleet(&["keys", "home", "new", "alice"]).await;
    assert!(code == 2 && text.contains("already"), "{text}");
    let (code, text) = desk.fleet(&["keys", "home", "list"]).await;
    assert!(code == 0 && text.starts_with("alice "), "{text}");

    let config = GatewayConfig {
        listen: vec!["tls/127.0.0.1:0".into(), "tcp/127.0.0.1:0".into()],
        secure: Some(home.clone()),
        ..GatewayConfig::new(desk.path("fleet.redb"))
    };
    let service = Service::start(config).await.expect("started");
    let port = |locator: &str| locator.rsplit(':').next().map(str::to_owned);
    let tls = port(&service.locators()[0]).expect("a port");
    desk.connect = format!("tls/localhost:{tls}");
    let user = made
        .users()
        .iter()
        .find(|user| user.name.as_str() == "left");
    let mut config = EmulatorConfig::new(NodeId::new("left").expect("legal"));
    config.connect.clone_from(&service.locators()[1]);
    config.signers = signers(&home);
    config.credentials = Some(emulator::config::Credentials {
        user: "left".into(),
        password: user.expect("added").password.clone(),
    });
    let left = wall::spawn(config).expect("spawned");

    let job = r#"{"commands":[{"move":{"axis":0,"delay_us":500,"steps":20}}]}"#;
    fs::write(desk.path("job.json"), job).expect("written");
    fs::write(
        desk.path("job.lua"),
        "motor.queue_move(0, 500, 5) wait_idle()",
    )
    .expect("written");
    // The node's first status is what a job is signed for.
    let sign = ["--node", "left", "--sign", "home/alice.key", "--wait=50"];
    let line = |file: &'static str| [&["submit", file], &sign[..]].concat();
    let (code, text) = desk.fleet(&line("job.json")).await;
    assert!(code == 0 && text.contains("succeeded 1/1"), "{text}");
    let (code, text) = desk.fleet(&line("job.lua")).await;
    assert!(code == 0 && text.contains("succeeded"), "{text}");
    let (code, text) = desk.fleet(&["submit", "job.json", "--node", "left"]).await;
    assert!(code == 1 && text.contains("not_allowed"), "{text}");
    let together = r#"{"max_skew_us":1e6,"nodes":{"left":{"commands":[
        {"move":{"axis":0,"delay_us":500,"steps":20}}]}}}"#;
    fs::write(desk.path("together.json"), together).expect("written");
    let group = ["submit", "together.json", "--group", "table"];
    let (code, text) = desk.fleet(&group).await;
    assert!(code == 1 && text.contains("not_allowed"), "{text}");
    let signed = [&group[..], &sign[2..]].concat();
    let (code, text) = desk.fleet(&signed).await;
    assert!(code == 0 && text.contains("succeeded"), "{text}");

    let (code, text) = desk.fleet(&["backup", "monday.redb"]).await;
    assert!(code == 0 && text.contains("read back"), "{text}");
    let (code, text) = desk.fleet(&["backup", "monday.redb"]).await;
    assert!(code == 2 && text.contains("exists"), "{text}");
    let (code, text) = desk.fleet(&["doctor", "monday.redb"]).await;
    assert!(code == 0 && text.contains("3 that have ended"), "{text}");
    let (code, text) = desk.fleet(&["doctor", "fleet.redb"]).await;
    assert!(code == 1 && text.contains("in use"), "{text}");

    left.shutdown().await;
    service.shutdown().await.expect("a clean end");
    let (code, text) = desk
        .fleet(&["backup", "cold.redb", "--store", "fleet.redb"])
        .await;
    assert!(code == 0 && text.contains("read back"), "{text}");
    let bytes = fs::read(desk.path("cold.redb")).expect("there");
    fs::write(desk.path("half.redb"), &bytes[..bytes.len() / 2]).expect("written");
    let (code, text) = desk.fleet(&["doctor", "half.redb"]).await;
    assert!(code == 1 && text.contains("damaged"), "{text}");
    let (code, text) = desk.fleet(&["keys", "home", "revoke", "alice"]).await;
    assert!(code == 0 && text.contains("does not count"), "{text}");
}
