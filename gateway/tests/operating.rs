//! A day with a fleet, as whoever runs it types it: settings, G-code, labels, maintenance, the order of
//! jobs, history, service manager, help. Every line is one that stands in a page of help or could.

#![cfg(all(unix, feature = "demo"))]

mod program;

use assert_cmd::Command;
use keys::NodeId;
use program::{Ran, fleet};
use std::{
    io::{BufRead, BufReader, Read},
    os::unix::net::UnixDatagram,
    path::{Path, PathBuf},
    process::{Child, ChildStdout, Stdio},
    time::{Duration, Instant},
};

/// Far more than anything here takes; only a failure waits so long.
const PATIENCE: Duration = Duration::from_secs(120);

const MACHINE: &str = "\
[node.left]
steps_per_mm = [80.0, 80.0, 400.0]
speed_mm_min = [12000.0, 12000.0, 3000.0]
accel_mm_s2 = [3000.0, 3000.0, 500.0]
travel_mm = [[-10.0, 300.0], [-10.0, 200.0], [-60.0, 10.0]]
";

/// A gateway in a process of its own, with a folder for files.
struct Plant {
    process: Child,
    out: BufReader<ChildStdout>,
    connect: String,
    folder: tempfile::TempDir,
}

impl Plant {
    fn start(environment: &[(&str, &str)]) -> Self {
        let folder = tempfile::tempdir().expect("a folder");
        std::fs::write(folder.path().join("fleet.toml"), MACHINE).expect("written");
        let log = std::fs::File::create(folder.path().join("log")).expect("made");
        let mut process = std::process::Command::new(env!("CARGO_BIN_EXE_fleet"))
            .args(["serve", "--json", "--listen", "tcp/127.0.0.1:0"])
            .arg("--config")
            .arg(folder.path().join("fleet.toml"))
            .arg("--store")
            .arg(folder.path().join("fleet.redb"))
            .envs(environment.iter().copied())
            .stdout(Stdio::piped())
            .stderr(log)
            .spawn()
            .expect("started");
        let mut out = BufReader::new(process.stdout.take().expect("piped"));
        let mut line = String::new();
        out.read_line(&mut line).expect("a line");
        let ready: serde_json::Value = serde_json::from_str(&line).expect("JSON");
        Self {
            connect: ready["locators"][0].as_str().expect("text").to_owned(),
            process,
            out,
            folder,
        }
    }

    /// Types a line; `good` is whether it must end with 0.
    fn types(&self, good: bool, line: &[&str]) -> Ran {
        let ran = fleet(&[line, &["--connect", &self.connect, "--timeout", "60"]].concat());
        assert_eq!(
            ran.code == Some(0),
            good,
            "{line:?}: {}\n{}",
            ran.out,
            ran.err
        );
        ran
    }

    fn file(&self, name: &str, text: &str) -> String {
        let path = self.path(name);
        std::fs::write(&path, text).expect("written");
        path.to_str().expect("UTF-8").to_owned()
    }

    fn path(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    fn signal(&self, name: &str) {
        let pid = self.process.id().to_string();
        let sent = std::process::Command::new("kill")
            .args([name, &pid])
            .status();
        assert!(sent.expect("there is a kill").success());
    }

    /// Ends it in good order; returns what it said last, and its log.
    fn end(mut self) -> (String, String) {
        self.signal("-TERM");
        let mut said = String::new();
        self.out.read_to_string(&mut said).expect("UTF-8");
        assert!(self.process.wait().expect("it was there").success());
        (said, read(&self.path("log")))
    }
}

impl Drop for Plant {
    fn drop(&mut self) {
        let _ = self.process.kill();
        let _ = self.process.wait();
    }
}

fn read(path: &Path) -> String {
    std::fs::read_to_string(path).expect("a text")
}

/// Waits until the answer to something is so.
fn until<T>(what: &str, mut ask: impl FnMut() -> Option<T>) -> T {
    let began = Instant::now();
    loop {
        if let Some(answer) = ask() {
            return answer;
        }
        assert!(began.elapsed() < PATIENCE, "never {what}");
    }
}

struct Nodes {
    runtime: tokio::runtime::Runtime,
    nodes: Vec<emulator::EmulatedHandle>,
}

impl Nodes {
    fn start(plant: &Plant, names: &[&str]) -> Self {
        let runtime = tokio::runtime::Runtime::new().expect("a runtime");
        let inside = runtime.enter();
        let nodes = names.iter().map(|name| {
            let name = NodeId::new(name).expect("legal");
            let config = emulator::EmulatorConfig {
                connect: plant.connect.clone(),
                axis_count: 3,
                ..emulator::EmulatorConfig::new(name)
            };
            emulator::spawn(config).expect("spawned")
        });
        let nodes = nodes.collect();
        drop(inside);
        until("all nodes are there", || {
            let known = plant.types(true, &["nodes", "--json"]).out;
            (known.matches("\"alive\":true").count() == names.len()).then_some(())
        });
        Self { runtime, nodes }
    }

    fn end(self) {
        for node in self.nodes {
            let _lives = self.runtime.block_on(node.shutdown());
        }
    }
}

const PART: &str = "\
(a part)
G21 G90
G0 Z5
G0 X0 Y0
M3 S500
G1 X30 F6000
G3 X30 Y20 J10
G1 X0
G1 Y0
M5
G0 Z0
M2
";

/// Asserts that all of these are in a text, one behind the other.
fn assert_in_order(text: &str, words: &[&str]) {
    let places: Vec<Option<usize>> = words.iter().map(|word| text.find(word)).collect();
    assert!(
        places.iter().all(Option::is_some) && places.is_sorted(),
        "{text}"
    );
}

#[test]
fn a_part_in_gcode_is_checked_made_and_accounted_for() {
    let plant = Plant::start(&[]);
    let settings = plant.path("fleet.toml");
    let settings = settings.to_str().expect("UTF-8");
    let nodes = Nodes::start(&plant, &["left"]);
    let part = plant.file("part.gcode", PART);

    // Before anything moves, and without a gateway.
    let ran = fleet(&["check", &part, "--config", settings]);
    assert_eq!(ran.code, Some(0), "{}", ran.err);
    assert!(ran.out.contains("X  0.000 to 39.998 mm"), "{}", ran.out);
    assert!(ran.out.contains("Y  0.000 to 20.000 mm"), "{}", ran.out);
    let wrong = plant.file("wrong.gcode", "G0 X1\nG1 X2 Q3 F100\n");
    let ran = fleet(&["check", &wrong, "--config", settings, "--node", "left"]);
    assert_eq!(ran.code, Some(1));
    assert!(
        ran.err.contains("wrong.gcode: line 2, column 7: `Q`"),
        "{}",
        ran.err
    );

    let line = [
        "submit", &part, "--node", "left", "--id", "part-7", "--wait", "--json",
    ];
    let ran = plant.types(true, &line);
    let record: serde_json::Value = serde_json::from_str(&ran.out).expect("a record");
    assert_eq!(record["state"], "succeeded", "{record}");
    assert_eq!(record["result"]["position"], serde_json::json!([0, 0, 0]));

    // The job that the check shows is the same one, and a client can hand it in as JSON.
    let ran = fleet(&["check", &part, "--config", settings, "--commands"]);
    let job: serde_json::Value = serde_json::from_str(&ran.out).expect("a job");
    let count = job["commands"].as_array().map(Vec::len);
    assert_eq!(
        count.map(|count| count as u64),
        record["progress"]["total"].as_u64()
    );

    // What is wrong is said with its place, and by whom it cannot be made.
    let ran = plant.types(false, &["submit", &wrong, "--node", "left"]);
    assert!(
        ran.err.contains("line 2, column 7: `Q` means nothing"),
        "{}",
        ran.err
    );
    let far = plant.file("far.gcode", "G0 X301\n");
    let ran = plant.types(false, &["submit", &far, "--node", "left"]);
    assert!(
        ran.err.contains("its travel is -10 to 300 mm"),
        "{}",
        ran.err
    );

    let ran = plant.types(true, &["trace", "part-7"]);
    let events = [
        "queued for left",
        "sent: ",
        "first pulse",
        "last pulse is out",
        "succeeded [0, 0, 0]",
    ];
    assert_in_order(&ran.out, &events);
    nodes.end();
}

#[test]
fn settings_are_read_again_while_the_gateway_runs() {
    let plant = Plant::start(&[]);
    let nodes = Nodes::start(&plant, &["right"]);
    let part = plant.file("part.gcode", "G91 G1 X1 F600\n");
    let ran = plant.types(false, &["submit", &part, "--node", "right"]);
    assert!(
        ran.err.contains("needs a section [node.right]"),
        "{}",
        ran.err
    );
    let both = MACHINE.to_owned() + &MACHINE.replace("left", "right");
    plant.file("fleet.toml", &both);
    plant.signal("-HUP");
    let log = plant.path("log");
    until("it was read again", || {
        read(&log).contains("were read again").then_some(())
    });
    let ran = until("the new machine counts", || {
        let line = [
            "submit",
            &part,
            "--node",
            "right",
            "--wait",
            "--connect",
            &plant.connect,
        ];
        let ran = fleet(&line);
        (ran.code == Some(0)).then_some(ran)
    });
    assert!(ran.out.contains("[80, 0, 0]"), "{}", ran.out);
    // What is wrong changes nothing, what cannot change now is said.
    plant.file("fleet.toml", "[node.right]\nsteps_per_mm = [0]\n");
    plant.signal("-HUP");
    until("the error is told", || {
        read(&log).contains("nothing is changed").then_some(())
    });
    plant.types(true, &["submit", &part, "--node", "right", "--wait"]);
    plant.file("fleet.toml", &("[fleet]\nnodes = 5\n".to_owned() + &both));
    plant.signal("-HUP");
    until("the rest is told", || {
        read(&log)
            .contains("count from the next start")
            .then_some(())
    });
    nodes.end();
}

#[test]
fn labels_maintenance_order_templates_and_history() {
    let plant = Plant::start(&[]);
    let nodes = Nodes::start(&plant, &["left", "right", "third"]);
    plant.types(true, &["label", "left", "mill", "big"]);
    plant.types(true, &["label", "right", "mill"]);
    let template = plant.file(
        "turn.json",
        r#"{"commands":[{"move":{"axis":${axis},"delay_us":100,"steps":${steps}}}]}"#,
    );
    let set = ["--set", "axis=1", "--set", "steps=250"];
    let line = [
        "submit", &template, "--label", "mill", "--wait", "--id", "t",
    ];
    let ran = plant.types(true, &[&line[..], &set].concat());
    assert!(
        ran.out.contains("t-left succeeded 1/1 [0, 250, 0]"),
        "{}",
        ran.out
    );
    assert!(
        ran.out.contains("t-right succeeded") && !ran.out.contains("third"),
        "{}",
        ran.out
    );
    let ran = plant.types(
        false,
        &["submit", &template, "--node", "left", "--set", "axis=1"],
    );
    assert!(ran.err.contains("--set steps="), "{}", ran.err);

    let both = plant.file(
        "both.json",
        r#"{"max_skew_us":1e6,"commands":[{"move":{"axis":1,"delay_us":100,"steps":250}}]}"#,
    );
    let line = ["submit", &both, "--label", "mill", "--together", "--wait"];
    let ran = plant.types(true, &line);
    assert!(ran.out.contains("started"), "{}", ran.out);

    plant.types(true, &["maintenance", "right", "new belt"]);
    let line = ["submit", &template, "--label", "mill"];
    let ran = plant.types(false, &[&line[..], &set].concat());
    assert!(
        ran.err.contains("node right is in maintenance: new belt"),
        "{}",
        ran.err
    );
    let ran = plant.types(true, &["label"]);
    assert!(
        ran.out.contains("new belt") && ran.out.contains("big mill"),
        "{}",
        ran.out
    );
    plant.types(true, &["maintenance", "right", "--end"]);

    // One that runs, three that wait.
    let long = plant.file(
        "long.json",
        r#"{"commands":[{"move":{"axis":0,"delay_us":1000,"steps":1000000}}]}"#,
    );
    plant.types(true, &["submit", &long, "--node", "third", "--id", "long"]);
    for name in ["a", "b"] {
        plant.types(true, &["submit", &long, "--node", "third", "--id", name]);
    }
    plant.types(
        true,
        &[
            "submit",
            &long,
            "--node",
            "third",
            "--id",
            "c",
            "--priority",
            "5",
        ],
    );
    let idle = [
        "submit",
        &long,
        "--node",
        "third",
        "--id",
        "idle",
        "--when-idle",
    ];
    plant.types(true, &idle);
    let ran = plant.types(true, &["move", "b", "--before", "a"]);
    assert_eq!(ran.out, "waiting: c b a idle\n");
    let ran = plant.types(true, &["label", "third", "--json"]);
    assert!(
        ran.out.contains(r#""waiting":["c","b","a","idle"]"#),
        "{}",
        ran.out
    );
    let ran = plant.types(true, &["trace", "idle"]);
    assert!(
        ran.out.contains("3 before it; priority behind all others"),
        "{}",
        ran.out
    );
    let late = [
        "submit",
        &long,
        "--node",
        "left",
        "--id",
        "late",
        "--at",
        "2100-01-01T00:00:00Z",
    ];
    plant.types(true, &late);
    let ran = plant.types(true, &["trace", "late"]);
    assert!(
        ran.out.contains("not before 2100-01-01T00:00:00.000000Z"),
        "{}",
        ran.out
    );
    plant.types(true, &["stop", "third"]);

    let ran = plant.types(true, &["jobs", "--export", "csv", "--node", "right"]);
    let lines: Vec<&str> = ran.out.lines().collect();
    assert_eq!(
        lines[0],
        "job,node,group,state,created,updated,done,total,error,position"
    );
    assert!(
        lines
            .iter()
            .any(|line| line.starts_with("t-right,right,,succeeded,")),
        "{lines:?}"
    );
    assert!(
        lines.iter().any(|line| line.ends_with(",\"[0, 250, 0]\"")),
        "{lines:?}"
    );
    let ran = plant.types(true, &["jobs", "--export", "json"]);
    let list: serde_json::Value = serde_json::from_str(&ran.out).expect("JSON");
    assert!(list.as_array().is_some_and(|list| list.len() > 5));
    nodes.end();
    let (said, _) = plant.end();
    assert_eq!(said, "{\"ended\":true,\"on_nodes\":0,\"waiting\":1}\n");
}

#[test]
fn a_service_manager_hears_ready_alive_and_stopping() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("notify");
    let socket = UnixDatagram::bind(&path).expect("bound");
    socket.set_read_timeout(Some(PATIENCE)).expect("set");
    let path = path.to_str().expect("UTF-8");
    // Three heartbeats a second.
    let environment = [
        ("NOTIFY_SOCKET", path),
        ("WATCHDOG_USEC", "1000000"),
        ("FLEET_LOG", "json"),
    ];
    let plant = Plant::start(&environment);
    let hear = || {
        let mut bytes = [0; 4_096];
        let count = socket.recv(&mut bytes).expect("in time");
        String::from_utf8_lossy(&bytes[..count]).into_owned()
    };
    let ready = hear();
    assert!(
        ready.contains("READY=1") && ready.contains("STATUS=listening on tcp/127.0.0.1:"),
        "{ready}"
    );
    assert_eq!(hear().trim_end(), "WATCHDOG=1");
    assert_eq!(hear().trim_end(), "WATCHDOG=1");
    plant.signal("-HUP");
    let reloading = until("it reloads", || {
        Some(hear()).filter(|text| text.contains("RELOADING"))
    });
    assert!(reloading.contains("MONOTONIC_USEC="), "{reloading}");
    until("it is ready again", || {
        hear().contains("READY=1").then_some(())
    });
    let nodes = Nodes::start(&plant, &["left"]);
    let part = plant.file("part.gcode", "G91 G1 X1 F600\n");
    plant.types(
        true,
        &[
            "submit", &part, "--node", "left", "--id", "logged", "--wait",
        ],
    );
    nodes.end();
    let (said, log) = plant.end();
    assert!(said.contains("\"waiting\":0"), "{said}");
    until("it said so", || hear().contains("STOPPING=1").then_some(()));
    // Each line of the log is an object, and those of a job carry its span.
    let lines: Vec<serde_json::Value> = log
        .lines()
        .map(|line| serde_json::from_str(line).unwrap_or_else(|error| panic!("{error}: {line}")))
        .collect();
    let of_job = lines.iter().filter(|line| line["span"]["job"] == "logged");
    let states: Vec<&serde_json::Value> = of_job.map(|line| &line["fields"]["state"]).collect();
    assert_eq!(
        states.first().map(|state| *state == "queued"),
        Some(true),
        "{states:?}"
    );
    assert_eq!(
        states.last().map(|state| *state == "succeeded"),
        Some(true),
        "{states:?}"
    );
}

#[test]
fn every_symptom_of_the_page_on_trouble_is_what_is_really_said() {
    let page = fleet(&["help", "trouble"]).out;
    let plant = Plant::start(&[]);
    let nodes = Nodes::start(&plant, &["left", "right"]);
    let file = |name: &str, text: &str| plant.file(name, text);
    let one = file(
        "one.json",
        r#"{"commands":[{"move":{"axis":0,"delay_us":100,"steps":5}}]}"#,
    );
    let far = file(
        "far.json",
        r#"{"commands":[{"move":{"axis":5,"delay_us":100,"steps":5}}]}"#,
    );
    let home = file("home.json", r#"{"commands":[{"home":{"axis":0}}]}"#);
    let odd = file("odd.json", r#"{"comands":[]}"#);
    let part = file("part.gcode", "G0 X1\n");
    let beam = file("beam.gcode", "M3 S9\nG1 X1 F100\n");
    let away = file("away.gcode", "G0 X999\n");
    let bad = file("bad.toml", "[fleet]\nnodse = 1\n");
    let store = plant.path("fleet.redb");
    let store = store.to_str().expect("UTF-8");
    let taken = plant.connect.clone();
    plant.types(true, &["maintenance", "right", "belt"]);
    // The page has what is said; its left column is the fragment.
    let mut tried = vec![
        "is offline",
        "is stopped; release it first",
        // By an older node, in `group.rs`.
        "not supported by this node's firmware",
        "(nothing: the receipt of another job)",
        "did not answer within",
    ];
    for (symptom, line) in [
        (
            "cannot connect to",
            &["nodes", "--connect", "tcp/127.0.0.1:1"][..],
        ),
        ("no gateway answers", &["nodes", "--prefix", "other"]),
        ("has ever been seen", &["submit", &one, "--node", "nobody"]),
        ("is in maintenance", &["submit", &one, "--node", "right"]),
        ("the node has axes", &["submit", &far, "--node", "left"]),
        (
            "has no reference switch",
            &["submit", &home, "--node", "left"],
        ),
        (
            "how many steps a millimetre",
            &["submit", &part, "--node", "right"],
        ),
        ("nobody knows where", &["submit", &beam, "--node", "left"]),
        ("its travel is", &["submit", &away, "--node", "left"]),
        (
            "is in use by another gateway",
            &["serve", "--store", store, "--listen", "tcp/127.0.0.1:0"],
        ),
        (
            "cannot listen on",
            &[
                "serve",
                "--store",
                &file("new.redb", ""),
                "--listen",
                &taken,
            ],
        ),
        ("unknown field", &["config", &bad]),
        ("unknown field", &["submit", &odd, "--node", "left"]),
    ] {
        assert!(
            page.contains(&format!("\n{symptom} ")),
            "{symptom} is on the page"
        );
        let connect = ["--connect", &plant.connect[..], "--timeout", "60"];
        let of_gateway = line[0] == "serve" || line.contains(&"--connect");
        let ran = if of_gateway {
            if line.contains(&"--listen") && symptom == "cannot listen on" {
                std::fs::remove_file(plant.path("new.redb")).expect("it was there");
            }
            fleet(&[line, &["--timeout", "1"]].concat())
        } else {
            fleet(&[line, &connect].concat())
        };
        assert_ne!(ran.code, Some(0), "{line:?}");
        assert!(ran.err.contains(symptom), "{line:?}: {}", ran.err);
        tried.push(symptom);
    }
    let rows = page
        .lines()
        .skip_while(|line| !line.starts_with("---"))
        .skip(1);
    for row in rows.filter(|row| !row.starts_with(' ')) {
        let symptom = row.split("  ").next().unwrap_or_default();
        assert!(tried.contains(&symptom), "nobody has tried {symptom:?}");
    }
    // Somebody who hears questions and says nothing.
    let mute = nodes.runtime.block_on(async {
        let mut config = zenoh::Config::default();
        let endpoints = format!("[\"{}\"]", plant.connect);
        for (key, value) in [("mode", "\"client\""), ("connect/endpoints", &endpoints)] {
            config.insert_json5(key, value).expect("legal");
        }
        let session = zenoh::open(config).await.expect("connected");
        let held = std::sync::Mutex::new(Vec::new());
        let hold = move |query| held.lock().expect("alone").push(query);
        let queryable = session.declare_queryable("mute/**").callback(hold).await;
        (queryable.expect("declared"), session)
    });
    let ran = fleet(&[
        "nodes",
        "--prefix",
        "mute",
        "--connect",
        &plant.connect,
        "--timeout",
        "1",
    ]);
    assert_eq!(ran.code, Some(3));
    assert!(ran.err.contains("did not answer within"), "{}", ran.err);
    drop(mute);
    let again = |steps: u32| {
        let job = format!(
            r#"{{"id":"again","commands":[{{"move":{{"axis":0,"delay_us":100,"steps":{steps}}}}}]}}"#
        );
        let file = plant.file("again.json", &job);
        plant.types(true, &["submit", &file, "--node", "left", "--json"])
    };
    again(1);
    assert!(
        again(2).out.contains("again"),
        "and the first one is what counts"
    );
    plant.types(true, &["stop", "left"]);
    let ran = plant.types(false, &["submit", &one, "--node", "left"]);
    assert!(
        page.contains("\nis stopped; release it first ")
            && ran.err.contains("is stopped; release it first")
    );
    nodes.end();
    let offline = file(
        "offline.json",
        r#"{"offline":"reject","commands":[{"move":{"axis":0,"delay_us":100,"steps":5}}]}"#,
    );
    plant.types(true, &["maintenance", "right", "--end"]);
    let ran = until("it is seen to be away", || {
        let line = [
            "submit",
            &offline,
            "--node",
            "right",
            "--connect",
            &plant.connect,
        ];
        let ran = fleet(&line);
        (ran.code != Some(0)).then_some(ran)
    });
    assert!(
        page.contains("\nis offline ") && ran.err.contains("is offline"),
        "{}",
        ran.err
    );
}

#[test]
fn help_has_topics_and_the_shell_gets_completions_and_a_manual_page() {
    let ran = fleet(&["help"]);
    for topic in ["node", "stop", "trouble", "client", "gcode", "service"] {
        assert!(ran.out.contains(&format!("  {topic} ")), "{topic}");
        let page = fleet(&["help", topic]).out;
        assert!(page.lines().count() > 10, "{topic}");
        assert!(
            page.lines().all(|line| line.chars().count() <= 110),
            "{topic}"
        );
    }
    let ran = fleet(&["help", "submit"]);
    assert!(
        ran.out.contains("--priority") && ran.out.contains("--connect"),
        "{}",
        ran.out
    );
    assert_eq!(fleet(&["help", "nonsense"]).code, Some(2));
    for shell in ["bash", "zsh", "fish", "elvish", "powershell"] {
        let ran = fleet(&["completions", shell]);
        assert_eq!(ran.code, Some(0), "{shell}");
        assert!(ran.out.contains("maintenance"), "{shell}");
    }
    let page = fleet(&["man"]).out;
    assert!(
        page.contains(".TH fleet 1") && page.contains("fleet\\-submit"),
        "{page}"
    );
}

#[test]
fn what_goes_into_a_pipe_has_no_colours_and_no_bars_and_keeps_its_width() {
    let plant = Plant::start(&[]);
    let nodes = Nodes::start(&plant, &["left"]);
    let long = format!(
        r#"{{"id":"{}","commands":[{{"move":{{"axis":0,"delay_us":100,"steps":500}}}}]}}"#,
        "n".repeat(32)
    );
    let job = plant.file("job.json", &long);
    let ran = plant.types(true, &["submit", &job, "--node", "left", "--wait"]);
    for text in [
        &ran.out,
        &ran.err,
        &plant.types(true, &["jobs"]).out,
        &plant.types(true, &["nodes"]).out,
    ] {
        assert!(!text.contains('\u{1b}') && !text.contains('\r'), "{text:?}");
    }
    let narrow = Command::new(env!("CARGO_BIN_EXE_fleet"))
        .args(["jobs", "--connect", &plant.connect])
        .env("COLUMNS", "20")
        .output()
        .expect("started");
    let text = String::from_utf8(narrow.stdout).expect("UTF-8");
    assert!(text.contains(&"n".repeat(32)), "a name is not cut: {text}");
    nodes.end();
}

#[test]
fn templates_schedules_and_queues_are_kept_by_the_gateway() {
    let plant = Plant::start(&[]);
    let nodes = Nodes::start(&plant, &["left"]);
    let types = |line: &[&str]| plant.types(true, line);
    let step = r#"{"commands":[{"move":{"axis":0,"delay_us":100,"steps":${steps}}}]}"#;
    let file = plant.file("step.json", step);
    let put = ["template", "put", "step", &file, "--about", "some steps"];
    assert_eq!(types(&put).out, "template step kept\n");
    let ran = types(&["template", "list"]);
    for word in ["step", "json", "steps", "some steps"] {
        assert!(ran.out.contains(word), "{}", ran.out);
    }
    assert_eq!(types(&["template", "show", "step"]).out.trim_end(), step);
    let by = ["submit", "--template", "step", "--node", "left"];
    let ran = plant.types(false, &by);
    assert!(
        ran.err.contains("template step: ${steps} has no value"),
        "{}",
        ran.err
    );
    let ran = types(&[&by[..], &["--set", "steps=7", "--id", "seven", "--wait"]].concat());
    assert!(ran.out.contains("succeeded"), "{}", ran.out);

    let add = ["schedule", "add", "warm", "--template", "step", "--set"];
    let rest = ["steps=5", "--node", "left", "--every", "10m"];
    let ran = types(&[&add[..], &rest].concat());
    assert!(
        ran.out.starts_with("schedule warm kept; next at 20"),
        "{}",
        ran.out
    );
    let ran = types(&["schedule", "list"]);
    for word in ["warm", "left", "10m"] {
        assert!(ran.out.contains(word), "{}", ran.out);
    }
    let gcode = plant.file("a.gcode", "G0 X1\n");
    let line = [
        "schedule", "add", "g", &gcode, "--node", "left", "--daily", "05:00",
    ];
    let ran = plant.types(false, &line);
    assert!(ran.err.contains("fleet check --commands"), "{}", ran.err);
    assert_eq!(
        types(&["schedule", "delete", "warm"]).out,
        "schedule warm deleted\n"
    );
    assert_eq!(types(&["schedule", "list"]).out, "no schedules\n");
    types(&["template", "delete", "step"]);
    let ran = plant.types(false, &["template", "show", "step"]);
    assert!(ran.err.contains("no template `step`"), "{}", ran.err);

    let ran = types(&["queue", "left", "hold"]);
    assert!(ran.out.contains("held"), "{}", ran.out);
    let job = plant.file("seven.json", &step.replace("${steps}", "7"));
    types(&["submit", &job, "--node", "left", "--id", "waits"]);
    let ran = types(&["jobs", "--state", "queued"]);
    assert!(ran.out.contains("waits"), "{}", ran.out);
    types(&["queue", "left", "resume"]);
    let ran = types(&["submit", &job, "--node", "left", "--id", "after", "--wait"]);
    assert!(ran.out.contains("succeeded"), "{}", ran.out);
    nodes.end();
}

#[test]
fn a_program_waits_at_m0_until_somebody_resumes_it() {
    let plant = Plant::start(&[]);
    let nodes = Nodes::start(&plant, &["left"]);
    let part = plant.file("turn.gcode", "G91 F600\nG1 X1\nM0 (turn the part)\nG1 X1\n");
    plant.types(true, &["submit", &part, "--node", "left", "--id", "turn"]);
    until("it waits", || {
        let ran = plant.types(true, &["nodes", "--json"]);
        ran.out.contains(r#""state":"paused""#).then_some(())
    });
    plant.types(true, &["resume", "left"]);
    until("it goes on to its end", || {
        let ran = plant.types(true, &["jobs", "--json"]);
        ran.out.contains(r#""state":"succeeded""#).then_some(())
    });
    let ran = plant.types(true, &["trace", "turn"]);
    let events = [
        "first pulse",
        "held on its path",
        "goes on",
        "last pulse is out",
    ];
    assert_in_order(&ran.out, &events);
    nodes.end();
}
