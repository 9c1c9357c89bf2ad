//! The program `fleet` as an operator or a script meets it.

mod program;

use keys::record::JobState;
use program::{Gateway, PATIENT, Ran, fleet};
use std::{net::Ipv4Addr, time::Duration};
use tokio::net::TcpSocket;

/// Far more than anything here takes; only a failure waits so long.
const PATIENCE: Duration = Duration::from_secs(60);

fn verbs() -> Vec<&'static str> {
    let mut verbs = vec![
        "serve",
        "config",
        "check",
        "init",
        "backup",
        "doctor",
        "users",
        "keys",
        "nodes",
        "submit",
        "jobs",
        "trace",
        "help",
        "completions",
        "man",
        "label",
        "maintenance",
        "move",
        "watch",
        "cancel",
        "stop",
        "release",
        "provision",
        "script",
        "setup",
    ];
    if cfg!(feature = "demo") {
        verbs.extend(["demo", "bench"]);
    }
    verbs
}

#[test]
fn help_names_every_verb_and_every_verb_has_help_with_its_options() {
    let ran = fleet(&["--help"]);
    assert_eq!(ran.code, Some(0));
    assert!(ran.out.contains("Exit codes"), "{}", ran.out);
    for verb in verbs() {
        assert!(ran.out.contains(verb), "{verb}");
        let ran = fleet(&[verb, "--help"]);
        assert_eq!(ran.code, Some(0), "{verb}");
        assert!(ran.out.contains("--connect"), "{verb}");
        if verb != "demo" {
            assert!(ran.out.contains("Examples:"), "{verb}");
        }
    }
    assert_eq!(fleet(&["--version"]).code, Some(0));
}

#[test]
fn bad_options_end_with_2_and_name_what_is_wrong() {
    let good_file = concat!(env!("CARGO_MANIFEST_DIR"), "/examples/jobs/stair.json");
    for (line, named) in [
        (&["fly"][..], "fly"),
        (&["nodes", "--timeout", "0"], "--timeout"),
        (&["nodes", "--prefix", "a//b"], "--prefix"),
        (&["nodes", "--connect", "127.0.0.1:7447"], "--connect"),
        (&["nodes", "--user", "u"], "--password-file"),
        (&["jobs", "--state", "happy"], "--state"),
        (&["jobs", "--limit", "0"], "--limit"),
        (&["submit", good_file], "--node"),
        (&["submit", good_file, "--node", "a/b"], "--node"),
        (
            &["submit", good_file, "--node", "left", "--id", "No"],
            "--id",
        ),
        (&["stop", "Left"], "PATTERN"),
        (&["cancel"], "JOB"),
        (&["serve", "--listen", "7447"], "7447"),
    ] {
        let ran = fleet(line);
        assert_eq!(ran.code, Some(2), "{line:?}: {}", ran.err);
        assert!(ran.err.contains(named), "{line:?}: {}", ran.err);
        assert!(ran.out.is_empty(), "{line:?}: {}", ran.out);
    }
}

#[test]
fn the_printed_settings_are_good_settings_and_a_wrong_one_names_its_line() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("fleet.toml");
    let file = path.to_str().expect("UTF-8");
    let printed = fleet(&["config"]);
    assert_eq!(printed.code, Some(0), "{}", printed.err);
    std::fs::write(&path, &printed.out).expect("written");
    let ran = fleet(&["config", file]);
    assert_eq!(ran.code, Some(0), "{}", ran.err);
    std::fs::write(&path, "[store]\nkeep_jobs = 3\n").expect("written");
    for line in [&["config", file][..], &["serve", "--config", file]] {
        let ran = fleet(line);
        assert_eq!(ran.code, Some(2), "{line:?}");
        assert!(
            ran.err.contains(file) && ran.err.contains("line 2"),
            "{}",
            ran.err
        );
        assert!(ran.err.contains("3 is not within 10 to"), "{}", ran.err);
    }
}

#[test]
fn a_secured_fleet_is_made_its_users_come_and_go_and_exposed_credentials_are_refused() {
    let folder = tempfile::tempdir().expect("a folder");
    let home = folder.path().join("plant");
    let home = home.to_str().expect("UTF-8");
    let made = fleet(&["init", home, "--host", "plant.local"]);
    assert_eq!(made.code, Some(0), "{}", made.err);
    assert!(made.out.contains("fleet serve --secure"), "{}", made.out);
    let again = fleet(&["init", home]);
    assert_eq!(again.code, Some(2), "{}", again.out);
    assert!(again.err.contains("already"), "{}", again.err);

    let added = fleet(&["users", home, "add", "left", "--role", "node"]);
    assert_eq!(added.code, Some(0), "{}", added.err);
    let list = fleet(&["users", home, "list"]);
    for user in ["gateway", "operator", "left"] {
        assert!(list.out.contains(user), "{}", list.out);
    }
    assert_eq!(fleet(&["users", home, "revoke", "left"]).code, Some(0));
    assert_eq!(fleet(&["users", home, "revoke", "left"]).code, Some(2));

    #[cfg(unix)]
    {
        use std::os::unix::fs::PermissionsExt as _;
        let file = format!("{home}/operator.json");
        let shown = std::fs::Permissions::from_mode(0o644);
        std::fs::set_permissions(&file, shown).expect("set");
        let ran = fleet(&["--credentials", &file, "nodes"]);
        assert_eq!(ran.code, Some(2), "{}", ran.err);
        assert!(ran.err.contains("mode 644"), "{}", ran.err);
    }
}

#[test]
#[cfg(unix)]
fn metrics_and_health_are_served_by_http() {
    let gateway = Gateway::start();
    let _token = show_node(&gateway.connect);
    let (status, body) = gateway.http("/healthz");
    assert_eq!(status, 200, "{body}");
    // A job that is accepted has been written, and that is counted before its receipt leaves.
    let job = r#"{"id": "one", "commands": [{"pause": {"ms": 1}}]}"#;
    let folder = tempfile::tempdir().expect("a folder");
    let file = folder.path().join("one.json");
    std::fs::write(&file, job).expect("written");
    let ran = gateway.fleet(&["submit", file.to_str().expect("UTF-8"), "--node", "left"]);
    assert_eq!(ran.code, Some(0), "{}", ran.err);
    let (status, body) = gateway.http("/metrics");
    assert_eq!(status, 200, "{body}");
    let value = |series: &str| {
        let line = body.lines().find_map(|line| line.strip_prefix(series));
        line.and_then(|rest| rest.trim().parse::<f64>().ok())
    };
    assert!(value("stepfleet_store_writes_total") >= Some(1.0), "{body}");
    assert!(
        value("stepfleet_store_commit_seconds_count") >= Some(1.0),
        "{body}"
    );
    let jobs = JobState::ALL.map(|state| value(&format!("stepfleet_jobs{{state=\"{state}\"}}")));
    assert_eq!(jobs.into_iter().flatten().sum::<f64>(), 1.0, "{body}");
    assert_eq!(gateway.http("/other").0, 404);
}

#[test]
fn without_a_gateway_every_client_ends_with_3_and_says_so() {
    // Ours, and nobody listens there: so no gateway of another test gets it meanwhile.
    let port = TcpSocket::new_v4().expect("a socket");
    port.bind((Ipv4Addr::LOCALHOST, 0).into())
        .expect("a free port");
    let connect = format!("tcp/{}", port.local_addr().expect("bound"));
    let file = concat!(env!("CARGO_MANIFEST_DIR"), "/examples/jobs/stair.json");
    for line in [
        &["nodes"][..],
        &["jobs"],
        &["watch"],
        &["cancel", "part-1"],
        &["stop"],
        &["release"],
        &["hold", "left"],
        &["resume", "left"],
        &["speed", "left", "50"],
        &["submit", file, "--node", "left"],
    ] {
        let ran = fleet(&[line, &["--connect", &connect], &PATIENT].concat());
        assert_eq!(ran.code, Some(3), "{line:?}: {}", ran.err);
        assert!(ran.err.contains(&connect), "{line:?}: {}", ran.err);
        assert!(ran.err.contains("fleet serve"), "{line:?}: {}", ran.err);
    }
}

#[test]
fn a_gateway_of_another_prefix_is_none() {
    let gateway = Gateway::start();
    let ran = gateway.fleet(&["nodes", "--prefix", "plant-2"]);
    assert_eq!(ran.code, Some(3), "{}", ran.err);
    assert!(ran.err.contains("no gateway answers"), "{}", ran.err);
    assert!(ran.err.contains("plant-2"), "{}", ran.err);
}

#[test]
fn a_gateway_without_nodes_answers_every_verb() {
    let gateway = Gateway::start();
    let file = concat!(env!("CARGO_MANIFEST_DIR"), "/examples/jobs/stair.json");
    let ran = gateway.fleet(&["nodes"]);
    assert_eq!(
        (ran.code, ran.out.as_str()),
        (Some(0), "no nodes: the gateway has not seen any yet\n")
    );
    let ran = gateway.fleet(&["nodes", "--json"]);
    assert_eq!((ran.code, ran.out.as_str()), (Some(0), ""));
    let ran = gateway.fleet(&["jobs"]);
    assert_eq!((ran.code, ran.out.as_str()), (Some(0), "no such jobs\n"));
    let ran = gateway.fleet(&["submit", file, "--node", "left"]);
    assert_eq!(ran.code, Some(1));
    assert!(ran.err.contains("unknown_node"), "{}", ran.err);
    let ran = gateway.fleet(&["submit", file, "--group", "table"]);
    assert_eq!(ran.code, Some(1), "{}", ran.err);
    assert!(ran.err.contains("bad_json"), "{}", ran.err);
    let ran = gateway.fleet(&["submit", "/no/such/file.json", "--node", "left"]);
    assert_eq!(ran.code, Some(2));
    assert!(ran.err.contains("/no/such/file.json"), "{}", ran.err);
    let ran = gateway.fleet(&["cancel", "nothing"]);
    assert_eq!(ran.code, Some(1));
    assert!(ran.err.contains("bad_id"), "{}", ran.err);
    let ran = gateway.fleet(&["release", "left"]);
    assert_eq!(ran.code, Some(1));
    assert!(ran.err.contains("unknown_node"), "{}", ran.err);
    let ran = gateway.fleet(&["setup", "left"]);
    assert_eq!(ran.code, Some(1));
    assert!(ran.err.contains("left: no node answers"), "{}", ran.err);
    let ran = gateway.fleet(&["stop"]);
    assert_eq!(ran.code, Some(1));
    assert!(ran.err.contains("no node"), "{}", ran.err);
    let ran = gateway.fleet(&["watch", "--json", "--seconds", "0.1"]);
    assert_eq!((ran.code, ran.out.as_str()), (Some(0), ""), "{}", ran.err);
}

/// Makes the gateway see a node, so that it keeps jobs for it.
#[cfg(unix)]
fn show_node(connect: &str) -> zenoh::Session {
    use keys::{LocalMicros, NodeState, QueueId, Status};
    use zenoh::Wait;
    let mut config = zenoh::Config::default();
    for (key, value) in [
        ("mode", "\"client\"".to_owned()),
        ("connect/endpoints", format!("[\"{connect}\"]")),
        ("scouting/multicast/enabled", "false".to_owned()),
    ] {
        config.insert_json5(key, &value).expect("a known setting");
    }
    let session = zenoh::open(config).wait().expect("connected");
    let status = Status {
        at: LocalMicros(1_000_000),
        queue: QueueId { boot: 7, flush: 0 },
        state: NodeState::Idle,
        stop: None,
        job: None,
        accepted_commands: 0,
        executed_commands: 0,
        credit_commands: 4_096,
        axes: [keys::AxisStatus::default(); 2].into_iter().collect(),
        faults: Default::default(),
        features: keys::Features::BASIC,
        firmware: [0, 1, 0],
        rssi_dbm: None,
        laser_percent: 0,
        lidar_mm: None,
    };
    let mut buffer = [0; keys::status::STATUS_BYTES_MAX];
    let bytes = keys::version::encode(&status, &mut buffer).expect("room");
    session
        .put("fleet/node/left/status", bytes)
        .congestion_control(zenoh::qos::CongestionControl::Block)
        .wait()
        .expect("put");
    // Asked behind the status on the same way, so answered behind it.
    let states = session
        .get("fleet/node/left/state")
        .timeout(PATIENCE)
        .wait()
        .expect("asked");
    let state = states.recv().expect("an answer");
    assert!(state.result().is_ok(), "{state:?}");
    session
}

#[cfg(unix)]
#[test]
fn a_gateway_whose_store_is_full_takes_nothing_more_and_ends_with_an_error() {
    let mut gateway = Gateway::start_with_files_up_to(4 * 1_024);
    let _node = show_node(&gateway.connect);
    // Each is some hundred KiB in the store.
    let file = concat!(env!("CARGO_MANIFEST_DIR"), "/examples/jobs/ripples.json");
    let refused = (0..100)
        .map(|_| gateway.fleet(&["submit", file, "--node", "left"]))
        .find(|ran| ran.code != Some(0))
        .expect("100 of them cannot fit");
    // Refused, or the gateway is already gone.
    match refused.code {
        // While it ends it may hear a job no more and still say that it is there.
        Some(1) => assert!(
            refused.err.contains("internal") || refused.err.contains("no receipt"),
            "{}",
            refused.err
        ),
        code => assert_eq!(code, Some(3), "{}", refused.err),
    }
    let status = gateway.process.wait().expect("ended");
    assert_eq!(status.code(), Some(1));
    let mut log = String::new();
    let mut stderr = gateway.process.stderr.take().expect("piped");
    std::io::Read::read_to_string(&mut stderr, &mut log).expect("UTF-8");
    assert!(log.contains("fleet: store"), "{log}");
}

#[cfg(feature = "demo")]
fn json_lines(ran: &Ran) -> Vec<serde_json::Value> {
    let lines = ran.out.lines();
    lines
        .map(|line| serde_json::from_str(line).expect("JSON"))
        .collect()
}

#[cfg(feature = "demo")]
#[test]
fn an_operator_plays_stops_releases_and_cancels_on_emulated_nodes() {
    let gateway = Gateway::start();
    let runtime = tokio::runtime::Runtime::new().expect("a runtime");
    let _inside = runtime.enter();
    let nodes = ["left", "right"].map(|name| {
        let name = keys::NodeId::new(name).expect("legal");
        let config = emulator::EmulatorConfig {
            connect: gateway.connect.clone(),
            ..emulator::EmulatorConfig::new(name)
        };
        emulator::spawn(config).expect("spawned")
    });
    let began = std::time::Instant::now();
    loop {
        let known = json_lines(&gateway.fleet(&["nodes", "--json"]));
        if known.iter().filter(|node| node["alive"] == true).count() == 2 {
            break;
        }
        assert!(began.elapsed() < PATIENCE, "{known:?}");
    }

    let ran = gateway.fleet(&["setup", "left"]);
    assert_eq!(ran.code, Some(0), "{}", ran.err);
    assert!(
        ran.out.contains("name") && ran.out.contains("left"),
        "{}",
        ran.out
    );
    assert!(
        ran.out.contains("axes[1].stop_accel_hz_per_s"),
        "{}",
        ran.out
    );
    let setups = json_lines(&gateway.fleet(&["setup", "*", "--json"]));
    let names: Vec<_> = setups.iter().map(|setup| setup["name"].as_str()).collect();
    assert_eq!(names, [Some("left"), Some("right")]);

    let files = tempfile::tempdir().expect("a directory");
    let file = |name: &str, text: &str| {
        let path = files.path().join(name);
        std::fs::write(&path, text).expect("written");
        path.to_str().expect("UTF-8").to_owned()
    };
    let short = file(
        "short.json",
        r#"{"commands":[{"move":{"axis":0,"delay_us":100,"steps":500}}]}"#,
    );
    let long = file(
        "long.json",
        r#"{"commands":[{"move":{"axis":0,"delay_us":1000,"steps":1000000}}]}"#,
    );

    let ran = gateway.fleet(&["submit", &short, "--node", "*", "--wait", "--json"]);
    assert_eq!(ran.code, Some(0), "{}", ran.err);
    let records = json_lines(&ran);
    assert_eq!(records.len(), 2);
    for record in &records {
        assert_eq!(record["state"], "succeeded", "{record}");
        assert_eq!(record["result"]["position"][0], 500, "{record}");
    }

    let ran = gateway.fleet(&[
        "submit",
        &long,
        "--node",
        "left",
        "--id",
        "l1",
        "--wait=0.2",
    ]);
    assert_eq!(ran.code, Some(4), "{}", ran.err);
    assert!(ran.err.contains("l1"), "{}", ran.err);
    let ran = gateway.fleet(&["cancel", "l1"]);
    assert_eq!(ran.code, Some(0), "{}", ran.err);
    let ran = gateway.fleet(&["submit", &long, "--node", "left", "--id", "l1", "--wait"]);
    assert_eq!(ran.code, Some(1), "{}", ran.err);
    assert!(ran.out.starts_with("l1 canceled"), "{}", ran.out);

    let ran = gateway.fleet(&["submit", &long, "--node", "*", "--id", "l2"]);
    assert_eq!(ran.code, Some(0), "{}", ran.err);
    assert_eq!(ran.out, "l2-left queued\nl2-right queued\n");
    let ran = gateway.fleet(&["stop", "--json"]);
    assert_eq!(ran.code, Some(0), "{}", ran.err);
    let confirmed = json_lines(&ran);
    assert_eq!(confirmed.len(), 2);
    assert!(
        confirmed.iter().all(|node| node["stopped"] == true),
        "{}",
        ran.out
    );
    // Nothing runs any more, and what was under way says why.
    let ran = gateway.fleet(&["submit", &long, "--node", "*", "--id", "l2", "--wait"]);
    assert_eq!(ran.code, Some(1), "{}", ran.err);
    let ran = gateway.fleet(&["jobs", "--state", "failed", "--json"]);
    let failed = json_lines(&ran);
    assert_eq!(failed.len(), 2, "{}", ran.out);
    assert!(
        failed.iter().all(|job| job["error"]["code"] == "stopped"),
        "{}",
        ran.out
    );
    let ran = gateway.fleet(&["submit", &short, "--node", "left"]);
    assert_eq!(ran.code, Some(1));
    assert!(ran.err.contains("stopped"), "{}", ran.err);

    let ran = gateway.fleet(&["release", "left"]);
    assert_eq!(ran.code, Some(0), "{}", ran.err);
    assert!(
        ran.out.contains("released") && !ran.out.contains("right"),
        "{}",
        ran.out
    );
    let ran = gateway.fleet(&["submit", &short, "--node", "left", "--wait"]);
    assert_eq!(ran.code, Some(0), "{}", ran.err);
    let ran = gateway.fleet(&["nodes"]);
    assert!(ran.out.contains("stopped (client)"), "{}", ran.out);
    for node in nodes {
        let _lives = runtime.block_on(node.shutdown());
    }
}

#[cfg(feature = "demo")]
#[test]
fn the_demo_plays_six_jobs_and_one_together_and_accounts_for_every_pulse() {
    let ran = fleet(&[&["demo", "--json"][..], &PATIENT].concat());
    assert_eq!(ran.code, Some(0), "{}\n{}", ran.out, ran.err);
    let mut lines: Vec<serde_json::Value> = ran
        .out
        .lines()
        .map(|line| serde_json::from_str(line).expect("JSON"))
        .collect();
    assert_eq!(lines.len(), 7);
    let together = lines.pop().expect("seven");
    assert_eq!(together["state"], "succeeded", "{together}");
    let started = together["start"]["by_node_us"].as_object();
    assert_eq!(started.map(serde_json::Map::len), Some(6), "{together}");
    for line in lines {
        assert_eq!(line["good"], true, "{line}");
        assert_eq!(line["state"], "succeeded", "{line}");
        assert_eq!(line["counted"], line["expected"], "{line}");
        assert_eq!(line["reported"], line["expected"], "{line}");
    }
}
