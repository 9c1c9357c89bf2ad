//! A whole board on this machine, as an operator sees it: `emulator --flash left.flash --serial
//! left.port`, told everything over its serial line, given a signed boot script, its power cut.
#![cfg(target_os = "linux")]

use serde_json::{Value, json};
use std::{
    path::Path,
    process::{Command, Stdio},
    time::Instant,
};
use tests::field::{self, Gateway, PATIENCE, Process};

/// What somebody types, and what is said to it. The public key is alice's, and differs each time.
const TRANSCRIPT: &str = "\
$ fleet init home --host localhost
$ fleet keys home new alice
$ fleet provision left.port
firmware    0.1.0
name        none
networks
router
tls         no: plain TCP
login       none
update key  none
boot script no
signers     none: executes what its gateway sends
switches    none
C and D     no
lidar       no
$ fleet provision left.port --name left --wifi shop --wifi-password-file wifi.txt --router ROUTER --boot-script --signers home/signers --restart
firmware    0.1.0
name        left
networks    shop
router      ROUTER
tls         no: plain TCP
login       none
update key  none
boot script allowed
signers     ALICE…
switches    none
C and D     no
lidar       no
$ fleet script left boot --put boot.lua
fleet: script boot not taken: it is not signed
exit code 1
$ fleet script left boot --put boot.lua --sign home/alice.key
script boot stored
$ fleet script left
 NAME  BYTES  SIGNED WITH
 boot  270    ALICE…
(the power is cut, and comes back)
the axis is at 30
$ fleet submit job.json --node left --wait
exit code 1
$ fleet submit job.json --node left --sign home/alice.key --wait
the axis is at 35
$ fleet provision left.port --boot-script=no --restart
boot script no
the axis is at 0
$ fleet script left boot --remove --sign home/alice.key
script boot removed
(the power is cut, and comes back)
$ fleet script left
 NAME  BYTES  SIGNED WITH
";

struct Desk {
    folder: tempfile::TempDir,
    router: String,
    said: String,
}

impl Desk {
    /// Types a command; `keep` says which lines of the answer are of interest.
    fn fleet(&mut self, line: &str, keep: impl Fn(&str) -> bool) {
        let words = line
            .split(' ')
            .map(|word| word.replace("ROUTER", &self.router));
        let output = Command::new(field::binary("fleet"))
            .args(words)
            .current_dir(self.folder.path())
            .env("FLEET_CONNECT", &self.router)
            .stdin(Stdio::null())
            .output()
            .expect("started");
        self.said.push_str(&format!("$ fleet {line}\n"));
        for text in [output.stdout, output.stderr] {
            let text = String::from_utf8(text).expect("UTF-8");
            for line in text.lines().filter(|line| keep(line)) {
                let line = line.replace(&self.router, "ROUTER");
                self.said.push_str(line.trim_end());
                self.said.push('\n');
            }
        }
        match output.status.code() {
            Some(0) => {}
            code => self
                .said
                .push_str(&format!("exit code {}\n", code.unwrap_or(-1))),
        }
    }

    /// Switches the board on.
    fn power_on(&self) -> Process {
        let path = |name: &str| self.folder.path().join(name);
        let mut command = Command::new(field::binary("emulator"));
        command.arg("--flash").arg(path("left.flash"));
        command.arg("--serial").arg(path("left.port"));
        command.stdout(Stdio::null()).stderr(Stdio::null());
        // Left over from before: it would look as if the board was there.
        let _ = std::fs::remove_file(path("left.port"));
        let board = Process::start(&mut command);
        let since = Instant::now();
        while !path("left.port").is_symlink() {
            assert!(since.elapsed() < PATIENCE, "the board has no port");
            std::thread::yield_now();
        }
        board
    }

    fn cut_and_come_back(&mut self, mut board: Process) -> Process {
        board.kill();
        self.said.push_str("(the power is cut, and comes back)\n");
        self.power_on()
    }

    /// Waits until the node is alive and rests at this position.
    fn wait_for_position(&mut self, client: &zenoh::Session, steps: i64) {
        let is_there = |node: &Value| {
            node["alive"] == true && node["state"] == "idle" && node["position"][0] == steps
        };
        field::wait_for_nodes(client, 1, is_there);
        self.said.push_str(&format!("the axis is at {steps}\n"));
    }

    fn write(&self, name: &str, text: &str) {
        std::fs::write(self.folder.path().join(name), text).expect("written");
    }
}

fn alice(home: &Path) -> String {
    let list = std::fs::read_to_string(home.join("signers")).expect("a list");
    let key = list.lines().find_map(|line| line.strip_prefix("alice "));
    key.expect("alice is on it")[..8].to_owned()
}

#[test]
fn a_board_is_told_everything_over_its_line_and_remembers_it_without_power() {
    let all = |_: &str| true;
    let none = |_: &str| false;
    let folder = tempfile::tempdir().expect("a folder");
    let gateway = Gateway::start(&folder.path().join("fleet.redb"), None);
    let client = field::open_client(&gateway.connect);
    let mut desk = Desk {
        folder,
        router: gateway.connect.clone(),
        said: String::new(),
    };
    let wifi = desk.folder.path().join("wifi.txt");
    gateway::security::home::write_secret(&wifi, "correct horse\n").expect("written");
    desk.write("boot.lua", "motor.queue_move(0, 100, 30)\nwait_idle()\n");
    let job = json!({"commands": [{"move": {"axis": 0, "delay_us": 100, "steps": 5}}]});
    desk.write("job.json", &job.to_string());
    desk.fleet("init home --host localhost", none);
    desk.fleet("keys home new alice", none);

    let board = desk.power_on();
    desk.fleet("provision left.port", all);
    desk.fleet(
        "provision left.port --name left --wifi shop --wifi-password-file wifi.txt \
         --router ROUTER --boot-script --signers home/signers --restart",
        all,
    );
    field::wait_for_nodes(&client, 1, |node| node["alive"] == true);
    desk.fleet("script left boot --put boot.lua", all);
    desk.fleet("script left boot --put boot.lua --sign home/alice.key", all);
    desk.fleet("script left", all);

    let board = desk.cut_and_come_back(board);
    desk.wait_for_position(&client, 30);
    desk.fleet("submit job.json --node left --wait", none);
    desk.fleet(
        "submit job.json --node left --sign home/alice.key --wait",
        none,
    );
    desk.wait_for_position(&client, 35);
    desk.fleet("provision left.port --boot-script=no --restart", |line| {
        line.starts_with("boot script")
    });
    desk.wait_for_position(&client, 0);
    desk.fleet("script left boot --remove --sign home/alice.key", all);

    let _board = desk.cut_and_come_back(board);
    desk.fleet("provision left.port", none);
    let shown = desk.said.rfind("$ fleet provision").expect("typed");
    desk.said.truncate(shown);
    field::wait_for_nodes(&client, 1, |node| node["alive"] == true);
    desk.fleet("script left", all);
    let said = desk
        .said
        .replace(&alice(&desk.folder.path().join("home")), "ALICE");
    assert_eq!(said, TRANSCRIPT, "{said}");
}
