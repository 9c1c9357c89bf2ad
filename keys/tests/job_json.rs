//! Job text: what is taken, and the exact words for what is not.
#![cfg(feature = "json")]

use keys::{
    AxisId, Command,
    command::{Ramp, RampShape},
    job::{GROUP_NODES_MAX, GroupRequest, JobRequest, Offline, Work},
    record::{ErrorCode, JobRecord},
};

const EVERY_COMMAND: &str = r#"{"id":"part-0815", "commands":[
  {"move":{"axis":0,"delay_us":500,"steps":-2000}},
  {"sync_move":{"delay_us":[500,1000],"steps":[2000,1000]}},
  {"ramp":{"axis":0,"steps":1000,"speed_hz":500,"accel":100}},
  {"ramp_to":{"axis":0,"position":0,"speed_hz":500,"accel":100,"linear_steps":50,"jump_steps":0}},
  {"line":{"steps":[10000,4000],"speed_hz":5000,"accel":10000,"jerk":100000}},
  {"pause":{"ms":100}}, {"laser":{"power_percent":50}}, {"lidar_read":{}},
  {"home":{"axis":2}}, {"set_position":{"axis":0,"position":0}}, {"barrier":{"name":"layer-2"}} ]}"#;

#[test]
fn the_example_of_the_contract_is_taken() {
    let job = JobRequest::from_json(EVERY_COMMAND.as_bytes()).expect("legal");
    assert_eq!(
        job.id.map(|id| id.as_str().to_owned()),
        Some("part-0815".to_owned())
    );
    assert_eq!(job.offline, Offline::Queue);
    let Work::Commands(commands) = &job.work else {
        panic!("commands were given")
    };
    assert_eq!(commands.len(), 11);
    let mut barriers = Vec::new();
    for command in commands {
        let command = command.to_command(|name| {
            barriers.push(name.to_owned());
            7
        });
        assert_eq!(Command::from_words(&command.to_words()), Ok(command));
    }
    assert_eq!(barriers, ["layer-2"]);
}

#[test]
fn the_same_job_survives_postcard() {
    let job = JobRequest::from_json(EVERY_COMMAND.as_bytes()).expect("legal");
    let mut buffer = [0; 1024];
    let bytes = keys::version::encode(&job, &mut buffer).expect("fits");
    assert_eq!(JobRequest::from_postcard(bytes), Ok(job));
}

#[test]
fn optional_fields_are_read() {
    let text = br#"{"lua":"x = 1","offline":"reject","timeout_s":1.5}"#;
    let job = JobRequest::from_json(text).expect("legal");
    assert_eq!(job.work, Work::Lua("x = 1".into()));
    assert_eq!((job.offline, job.timeout_s), (Offline::Reject, Some(1.5)));
}

fn refused(text: &str) -> (ErrorCode, String) {
    let error = JobRequest::from_json(text.as_bytes()).expect_err(text);
    (error.code, error.message)
}

#[test]
fn everything_wrong_is_named_with_its_place() {
    use ErrorCode::{BadCommand, BadId, BadJson};
    let command = |command: &str| format!(r#"{{"commands":[{{"lidar_read":{{}}}},{command}]}}"#);
    let cases: &[(String, ErrorCode, &str)] = &[
        ("".into(), BadJson, "EOF while parsing"),
        ("{".into(), BadJson, "EOF while parsing"),
        ("[]".into(), BadJson, ""),
        ("{}".into(), BadJson, "a job needs `commands` or `lua`"),
        (r#"{"commands":[],"lua":""}"#.into(), BadJson, "not both"),
        (
            command(r#"{"laser":{"power_percent":1},"pause":{"ms":1}}"#),
            BadCommand,
            "commands[1]: more than one command in one object at line 1 column",
        ),
        (
            command(r#"{"move":[0,5,1]}"#),
            BadCommand,
            "commands[1].move: invalid type: sequence, expected an object",
        ),
        (
            command(r#"{"lidar_read":[]}"#),
            BadCommand,
            "commands[1].lidar_read: invalid type: sequence, expected an object",
        ),
        (
            r#" ["a",[{"lidar_read":{}}],null,null,null]"#.into(),
            BadJson,
            "a job is a JSON object",
        ),
        (
            command(r#"{"sync_move":{"delay_us":[5,5],"steps":[5,5,5]}}"#),
            BadCommand,
            "commands[1].sync_move.steps: too many items at line 1 column",
        ),
        (
            command(r#"{"move":{"axis":0,"delay_us":134217729,"steps":-2147483647}}"#),
            BadCommand,
            "commands[1].move.delay_us: 134217729 is out of range; with so many steps at most 134217728 µs",
        ),
        (
            command(r#"{"sync_move":{"delay_us":[5,4294967295],"steps":[5,2147483647]}}"#),
            BadCommand,
            "commands[1].sync_move.delay_us[1]: 4294967295 is out of range",
        ),
        (
            r#"{"commands":[{"lidar_read":{}},]}"#.into(),
            BadJson,
            "trailing comma",
        ),
        (
            r#"{"commands":[]}"#.into(),
            BadCommand,
            "commands: the list is empty",
        ),
        (r#"{"lua":"","x":1}"#.into(), BadJson, "unknown field `x`"),
        (r#"{"lua":""} x"#.into(), BadJson, "trailing characters"),
        (
            r#"{"lua":"","id":"A"}"#.into(),
            BadId,
            "id: a name consists of",
        ),
        (r#"{"lua":"","id":7}"#.into(), BadJson, "id: invalid type"),
        (
            r#"{"lua":"","timeout_s":0}"#.into(),
            BadJson,
            "timeout_s: 0 is not a time",
        ),
        (
            r#"{"lua":"","offline":"maybe"}"#.into(),
            BadJson,
            "offline: unknown variant `maybe`",
        ),
        (command(r#"{"mvoe":{}}"#), BadCommand, "commands[1]"),
        (
            command(r#"{"move":{"axis":0,"delay_us":500}}"#),
            BadCommand,
            "commands[1].move: missing field `steps`",
        ),
        (
            command(r#"{"move":{"axis":0,"delay_us":-1,"steps":1}}"#),
            BadCommand,
            "commands[1].move.delay_us: invalid value: integer `-1`, expected u32",
        ),
        (
            command(r#"{"move":{"axis":0,"delay_us":1.5,"steps":1}}"#),
            BadCommand,
            "commands[1].move.delay_us: invalid type: floating point `1.5`",
        ),
        (
            command(r#"{"move":{"axis":0,"delay_us":0,"steps":1}}"#),
            BadCommand,
            "commands[1].move.delay_us: 0 is out of range",
        ),
        (
            command(r#"{"move":{"axis":0,"delay_us":1,"steps":0}}"#),
            BadCommand,
            "commands[1].move.steps: 0 steps move nothing",
        ),
        (
            command(r#"{"move":{"axis":0,"delay_us":1,"steps":-2147483648}}"#),
            BadCommand,
            "commands[1].move.steps: out of range",
        ),
        (
            command(r#"{"move":{"axis":0,"delay_us":1,"steps":2147483648}}"#),
            BadCommand,
            "commands[1].move.steps: invalid value",
        ),
        (
            command(r#"{"move":{"axis":256,"delay_us":1,"steps":1}}"#),
            BadCommand,
            "commands[1].move.axis: invalid value",
        ),
        (
            command(r#"{"move":{"axis":0,"delay_us":1,"steps":1,"speed":1}}"#),
            BadCommand,
            "unknown field `speed`",
        ),
        (
            command(r#"{"sync_move":{"delay_us":[1],"steps":[1,1]}}"#),
            BadCommand,
            "commands[1].sync_move.delay_us",
        ),
        (
            command(r#"{"sync_move":{"delay_us":[1,0],"steps":[1,1]}}"#),
            BadCommand,
            "commands[1].sync_move.delay_us[1]: 0",
        ),
        (
            command(r#"{"ramp":{"axis":0,"steps":1,"speed_hz":0,"accel":1}}"#),
            BadCommand,
            "commands[1].ramp.speed_hz: 0 is out of range",
        ),
        (
            command(r#"{"ramp":{"axis":0,"steps":1,"speed_hz":1000001,"accel":1}}"#),
            BadCommand,
            "commands[1].ramp.speed_hz: 1000001 is out of range; 1 to 1000000",
        ),
        (
            command(r#"{"line":{"steps":[],"speed_hz":1,"accel":1}}"#),
            BadCommand,
            "commands[1].line.steps: 0 axes",
        ),
        (
            command(r#"{"laser":{"power_percent":101}}"#),
            BadCommand,
            "commands[1].laser.power_percent: 101 is out of range",
        ),
        (
            command(r#"{"pause":{"ms":86400001}}"#),
            BadCommand,
            "commands[1].pause.ms: 86400001 is out of range",
        ),
        (
            command(r#"{"lidar_read":{"x":1}}"#),
            BadCommand,
            "commands[1].lidar_read",
        ),
        (
            command(r#"{"barrier":{"name":""}}"#),
            BadCommand,
            "commands[1].barrier.name",
        ),
        (
            command(r#"{"move":{"axis":0,"delay_us":1,"steps":1},"laser":{}}"#),
            BadJson,
            "",
        ),
    ];
    for (text, code, words) in cases {
        let (found, message) = refused(text);
        assert!(
            message.contains(words),
            "{text}\n  said    {message}\n  without {words}"
        );
        if !words.is_empty() {
            assert_eq!(found, *code, "{text}: {message}");
        }
    }
}

const GROUP: &str = r#"{"id":"cut-7","nodes":{
  "right":{"commands":[{"barrier":{"name":"b"}},{"move":{"axis":0,"delay_us":500,"steps":5}},{"barrier":{"name":"a"}}]},
  "left":{"commands":[{"pause":{"ms":5}},{"barrier":{"name":"b"}}]},
  "up":{"commands":[{"barrier":{"name":"a"}}]},
  "down":{"lua":"motor.execute()"}},
  "max_skew_us":1000,"ready_timeout_ms":2500.5,"offline":"queue","timeout_s":60}"#;

#[test]
fn a_synchronized_job_is_read_and_its_meeting_points_are_numbered() {
    let job = GroupRequest::from_json(GROUP.as_bytes()).expect("legal");
    let nodes: Vec<&str> = job.nodes.keys().map(keys::NodeId::as_str).collect();
    assert_eq!(nodes, ["down", "left", "right", "up"]);
    assert_eq!(job.max_skew_us, Some(1000.0));
    assert_eq!(job.ready_timeout_ms, Some(2500.5));
    assert_eq!(
        (job.offline, job.timeout_s),
        (Some(Offline::Queue), Some(60.0))
    );
    // By the order of the nodes' names: `left` comes before `right`.
    let numbers: Vec<_> = job.barrier_numbers().into_iter().collect();
    assert_eq!(numbers, [("a", 2), ("b", 1)]);
    let mut buffer = [0; 512];
    let bytes = keys::version::encode(&job, &mut buffer).expect("fits");
    assert_eq!(GroupRequest::from_postcard(bytes), Ok(job));
    let few = GroupRequest::from_json(br#"{"nodes":{"a":{"lua":""}}}"#).expect("legal");
    assert_eq!(
        (few.max_skew_us, few.ready_timeout_ms, few.offline),
        (None, None, None)
    );
}

#[test]
fn everything_wrong_with_a_synchronized_job_is_named_with_its_place() {
    use ErrorCode::{BadCommand, BadId, BadJson, TooLarge};
    let part = r#"{"commands":[{"pause":{"ms":1}}]}"#;
    let left = |commands: &str| {
        format!(
            r#"{{"nodes":{{"a":{part},"left":{{"commands":[{{"lidar_read":{{}}}},{commands}]}}}}}}"#
        )
    };
    let pair = |left: &str, right: &str| {
        format!(
            r#"{{"nodes":{{"left":{{"commands":[{left}]}},"right":{{"commands":[{right}]}}}}}}"#
        )
    };
    let field = |field: &str| format!(r#"{{"nodes":{{"a":{part}}},{field}}}"#);
    let (a, b) = (r#"{"barrier":{"name":"a"}}"#, r#"{"barrier":{"name":"b"}}"#);
    let many: Vec<String> = (0..=GROUP_NODES_MAX)
        .map(|number| format!(r#""n{number}":{part}"#))
        .collect();
    let cases: &[(String, ErrorCode, &str)] = &[
        ("[]".into(), BadJson, "a job is a JSON object, not an array"),
        ("{}".into(), BadJson, "missing field `nodes`"),
        (
            r#"{"nodes":{}}"#.into(),
            BadJson,
            "nodes: there must be a part for at least one node",
        ),
        (
            r#"{"nodes":[]}"#.into(),
            BadJson,
            "nodes: invalid type: sequence, expected an object: a part for each node",
        ),
        (
            r#"{"nodes":{"a":[]}}"#.into(),
            BadJson,
            "nodes.a: invalid type: sequence, expected an object",
        ),
        (
            r#"{"nodes":{"a":{}}}"#.into(),
            BadJson,
            "nodes.a: a part needs `commands` or `lua`",
        ),
        (
            r#"{"nodes":{"a":{"commands":[],"lua":""}}}"#.into(),
            BadJson,
            "nodes.a: a part has either `commands` or `lua`, not both",
        ),
        (
            r#"{"nodes":{"a":{"lua":"","id":"x"}}}"#.into(),
            BadJson,
            "nodes.a.id: unknown field `id`",
        ),
        (
            r#"{"nodes":{"A":{"lua":""}}}"#.into(),
            BadJson,
            "nodes.A: a name consists of",
        ),
        (
            r#"{"nodes":{"a":{"lua":""},"a":{"lua":""}}}"#.into(),
            BadJson,
            "nodes.a: there is a part for this node already",
        ),
        (
            format!(r#"{{"nodes":{{{}}}}}"#, many.join(",")),
            TooLarge,
            "nodes: 129 of them; a synchronized job has at most 128",
        ),
        (field(r#""id":"A""#), BadId, "id: a name consists of"),
        (
            field(r#""max_skew_us":0"#),
            BadJson,
            "max_skew_us: 0 is not a time; it must be more than 0",
        ),
        (
            field(r#""ready_timeout_ms":-1"#),
            BadJson,
            "ready_timeout_ms: -1 is not a time; it must be more than 0",
        ),
        (
            field(r#""timeout_s":0"#),
            BadJson,
            "timeout_s: 0 is not a time",
        ),
        (
            field(r#""max_skew_us":"1""#),
            BadJson,
            "max_skew_us: invalid type: string",
        ),
        (
            field(r#""offline":"maybe""#),
            BadJson,
            "offline: unknown variant `maybe`",
        ),
        (field(r#""skew":1"#), BadJson, "unknown field `skew`"),
        (
            r#"{"nodes":{"a":{"commands":[]}}}"#.into(),
            BadCommand,
            "nodes.a.commands: the list is empty",
        ),
        (
            left(r#"{"move":{"axis":0,"delay_us":0,"steps":1}}"#),
            BadCommand,
            "nodes.left.commands[1].move.delay_us: 0 is out of range",
        ),
        (
            left(r#"{"move":{"axis":0,"delay_us":-1,"steps":1}}"#),
            BadCommand,
            "nodes.left.commands[1].move.delay_us: invalid value: integer `-1`, expected u32",
        ),
        (
            left(r#"{"laser":{"power_percent":1},"pause":{"ms":1}}"#),
            BadCommand,
            "nodes.left.commands[1]: more than one command in one object at line 1 column",
        ),
        (
            pair(a, r#"{"pause":{"ms":1}}"#),
            BadCommand,
            "nodes.left.commands[0].barrier: no other part meets at `a`",
        ),
        (
            pair(&format!("{a},{a}"), a),
            BadCommand,
            "nodes.left.commands[1].barrier: `a` is met in commands[0] already",
        ),
        (
            pair(&format!("{a},{b}"), &format!("{b},{a}")),
            BadCommand,
            "nodes.left.commands[0].barrier: `a` is never met: another part waits for this one somewhere else",
        ),
    ];
    for (text, code, words) in cases {
        let error = GroupRequest::from_json(text.as_bytes()).expect_err(text);
        assert!(
            error.message.contains(words),
            "{text}\n  said    {}\n  without {words}",
            error.message
        );
        assert_eq!(error.code, *code, "{text}: {}", error.message);
    }
    assert!(
        GroupRequest::from_json(pair(&format!("{a},{b}"), &format!("{a},{b}")).as_bytes()).is_ok()
    );
}

#[test]
fn a_refused_job_still_tells_its_id() {
    let text = br#"{"id":"part-1","commands":[{"move":{}}]}"#;
    assert!(JobRequest::from_json(text).is_err());
    assert_eq!(
        JobRequest::id_of_json(text).map(|id| id.as_str().to_owned()),
        Some("part-1".into())
    );
    assert_eq!(JobRequest::id_of_json(br#"{"id":"NO"}"#), None);
}

#[test]
fn a_record_reads_as_the_contract_writes_it() {
    let text = r#"{"job":"cut-7","node":"left","group":null,"state":"running","version":3,"created":"2026-11-21T03:00:00.123000Z","updated":"2026-11-21T03:00:01.000000Z","progress":{"done":1200,"total":4000},"error":null,"result":null,"parts":null}"#;
    let record: JobRecord = serde_json::from_str(text).expect("legal");
    assert_eq!(serde_json::to_string(&record).expect("JSON"), text);
}

#[test]
fn commands_of_c_and_d_are_read_and_their_errors_have_their_places() {
    let text = br#"{"commands":[{"movd":{"on":false}},{"movc":{"position":2}},{"movd":{"on":true}},{"statcd":{}}]}"#;
    let job = JobRequest::from_json(text).expect("legal");
    let Work::Commands(list) = &job.work else {
        panic!("commands were given")
    };
    let commands: Vec<_> = list.iter().map(|one| one.to_command(|_| 0)).collect();
    assert_eq!(
        commands,
        [
            Command::MoveD { on: false },
            Command::MoveC { index: 2 },
            Command::MoveD { on: true },
            Command::StatusCd,
        ]
    );
    assert_eq!(
        serde_json::to_string(list).expect("JSON"),
        r#"[{"movd":{"on":false}},{"movc":{"position":2}},{"movd":{"on":true}},{"statcd":{}}]"#
    );
    let mut buffer = [0; 64];
    let bytes = keys::version::encode(&job, &mut buffer).expect("fits");
    assert_eq!(JobRequest::from_postcard(bytes), Ok(job.clone()));
    for position in 0..=4 {
        let text = format!(r#"{{"commands":[{{"movc":{{"position":{position}}}}}]}}"#);
        assert!(JobRequest::from_json(text.as_bytes()).is_ok(), "{position}");
    }

    let cases = [
        (
            r#"{"movc":{"position":5}}"#,
            "commands[1].movc.position: Invalid C position (0-4)",
        ),
        (
            r#"{"movc":{"position":-1}}"#,
            "commands[1].movc.position: Invalid C position (0-4)",
        ),
        (
            r#"{"movc":{"position":260}}"#,
            "commands[1].movc.position: Invalid C position (0-4)",
        ),
        (
            r#"{"movc":{"position":2.0}}"#,
            "commands[1].movc.position: invalid type: floating point",
        ),
        (
            r#"{"movc":{}}"#,
            "commands[1].movc: missing field `position`",
        ),
        (
            r#"{"movd":{"on":2}}"#,
            "commands[1].movd.on: invalid type: integer `2`, expected a boolean",
        ),
        (
            r#"{"movd":{"state":1}}"#,
            "commands[1].movd.state: unknown field `state`",
        ),
        (r#"{"statcd":{"x":1}}"#, "commands[1].statcd"),
        (
            r#"{"statcd":[]}"#,
            "commands[1].statcd: invalid type: sequence",
        ),
    ];
    refuses_behind_another(&cases);
}

/// Each of these commands, the second of a job, is refused with these words among others.
fn refuses_behind_another(cases: &[(&str, &str)]) {
    for (command, words) in cases {
        let text = format!(r#"{{"commands":[{{"lidar_read":{{}}}},{command}]}}"#);
        let (code, message) = refused(&text);
        assert_eq!(code, ErrorCode::BadCommand, "{text}: {message}");
        assert!(
            message.contains(words),
            "{text}\n  said    {message}\n  without {words}"
        );
    }
}

#[test]
fn smooth_ramps_are_read_and_their_errors_have_their_places() {
    let text = br#"{"commands":[{"smooth_ramp":{"axis":1,"steps":-6000,"start_hz":500,"speed_hz":1500,"ramp_steps":500}},{"smooth_ramp_to":{"axis":0,"position":7,"start_hz":1,"speed_hz":2,"ramp_steps":2}}]}"#;
    let job = JobRequest::from_json(text).expect("legal");
    let Work::Commands(list) = &job.work else {
        panic!("commands were given")
    };
    let smooth = |start_hz, speed_hz, ramp_steps| Ramp {
        speed_hz,
        accel_hz_per_s: 0,
        shape: RampShape::Smooth {
            start_hz,
            ramp_steps,
        },
    };
    let commands: Vec<_> = list.iter().map(|one| one.to_command(|_| 0)).collect();
    assert_eq!(
        commands,
        [
            Command::Ramp {
                axis: AxisId(1),
                steps: -6_000,
                ramp: smooth(500, 1_500, 500),
            },
            Command::RampTo {
                axis: AxisId(0),
                position_steps: 7,
                ramp: smooth(1, 2, 2),
            },
        ]
    );
    let again = format!(
        r#"{{"commands":{}}}"#,
        serde_json::to_string(list).expect("JSON")
    );
    assert_eq!(JobRequest::from_json(again.as_bytes()), Ok(job.clone()));
    let mut buffer = [0; 64];
    let bytes = keys::version::encode(&job, &mut buffer).expect("fits");
    assert_eq!(JobRequest::from_postcard(bytes), Ok(job));

    let cases = [
        (
            r#"{"smooth_ramp":{"axis":0,"steps":0,"start_hz":1,"speed_hz":2,"ramp_steps":2}}"#,
            "commands[1].smooth_ramp.steps: 0 steps move nothing",
        ),
        (
            r#"{"smooth_ramp":{"axis":0,"steps":1,"start_hz":0,"speed_hz":2,"ramp_steps":2}}"#,
            "commands[1].smooth_ramp.start_hz: 0 is out of range; it must be at least 1",
        ),
        (
            r#"{"smooth_ramp":{"axis":0,"steps":1,"start_hz":5,"speed_hz":5,"ramp_steps":2}}"#,
            "commands[1].smooth_ramp.start_hz: 5 is out of range; it must be below speed_hz",
        ),
        (
            r#"{"smooth_ramp_to":{"axis":0,"position":1,"start_hz":1,"speed_hz":1000001,"ramp_steps":2}}"#,
            "commands[1].smooth_ramp_to.speed_hz: 1000001 is out of range; 1 to 1000000",
        ),
        (
            r#"{"smooth_ramp_to":{"axis":0,"position":1,"start_hz":1,"speed_hz":2,"ramp_steps":1}}"#,
            "commands[1].smooth_ramp_to.ramp_steps: 1 is out of range; it must be at least 2",
        ),
        (
            r#"{"smooth_ramp":{"axis":0,"steps":1,"start_hz":1,"speed_hz":2}}"#,
            "commands[1].smooth_ramp: missing field `ramp_steps`",
        ),
        (
            r#"{"smooth_ramp":{"axis":0,"steps":1,"start_hz":1,"speed_hz":2,"ramp_steps":2,"accel":1}}"#,
            "commands[1].smooth_ramp.accel: unknown field `accel`",
        ),
        (
            r#"{"ramp":{"axis":0,"steps":1,"speed_hz":2,"accel":1,"ramp_steps":2}}"#,
            "commands[1].ramp.ramp_steps: unknown field `ramp_steps`",
        ),
    ];
    refuses_behind_another(&cases);
}
