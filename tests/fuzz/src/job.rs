//! A job as a client writes it. What is accepted can be kept and taken up again, commands and all;
//! what is refused says why in words.
//!
//! The first byte: JSON or postcard, for one node or for several.

use keys::{
    Command,
    job::{GroupRequest, JobRequest, Work},
    record::JobError,
    version,
};

fn refused(error: &JobError) {
    assert!(!error.message.is_empty());
    // The refusal is told to the client: it must not grow with what was wrong.
    assert!(
        error.message.len() <= 4_096,
        "{} bytes",
        error.message.len()
    );
}

fn commands(work: &Work) {
    if let Work::Commands(commands) = work {
        for command in commands {
            let command: Command = command.to_command(|_| 1);
            let again = Command::from_words(&command.to_words()).expect("a node keeps it");
            assert_eq!(again, command);
        }
    }
}

fn kept<M: serde::Serialize + serde::de::DeserializeOwned + PartialEq + std::fmt::Debug>(
    request: &M,
    text_bytes: usize,
) {
    let mut buffer = vec![0; 64 + 64 * text_bytes];
    let bytes = version::encode(request, &mut buffer).expect("what was accepted can be kept");
    let again = version::decode::<M>(bytes).expect("what was kept can be taken up");
    assert_eq!(&again, request);
}

/// See the module.
pub fn check(data: &[u8]) {
    let Some((form, text)) = data.split_first() else {
        return;
    };
    let request = match form % 4 {
        0 => JobRequest::from_json(text),
        1 => JobRequest::from_postcard(text),
        form => {
            let request = match form {
                2 => GroupRequest::from_json(text),
                _ => GroupRequest::from_postcard(text),
            };
            match request {
                Ok(request) => {
                    request.nodes.values().for_each(commands);
                    let _ = request.barrier_numbers();
                    kept(&request, text.len());
                }
                Err(error) => refused(&error),
            }
            return;
        }
    };
    match request {
        Ok(request) => {
            commands(&request.work);
            kept(&request, text.len());
        }
        Err(error) => refused(&error),
    }
    let _ = JobRequest::id_of_json(text);
}

/// Every command once, a script, a synchronized job, and some that are wrong.
pub fn seeds() -> Vec<Vec<u8>> {
    let texts: [(u8, &str); 6] = [
        (
            0,
            r#"{"id":"part-0815","commands":[{"move":{"axis":0,"delay_us":500,"steps":-2000}},{"sync_move":{"delay_us":[500,1000],"steps":[2000,1000]}},{"ramp":{"axis":0,"steps":1000,"speed_hz":500,"accel":100}},{"ramp_to":{"axis":0,"position":0,"speed_hz":500,"accel":100,"linear_steps":50,"jump_steps":0}},{"line":{"steps":[10000,4000],"speed_hz":5000,"accel":10000,"jerk":100000}},{"pause":{"ms":100}},{"laser":{"power_percent":50}},{"lidar_read":{}},{"home":{"axis":2}},{"set_position":{"axis":0,"position":0}},{"barrier":{"name":"layer-2"}}]}"#,
        ),
        (
            0,
            r#"{"id":"x","lua":"motor.queue_move(0, 500, 1000) motor.execute()","timeout_s":2.5,"offline":"reject"}"#,
        ),
        (
            0,
            r#"{"commands":[{"move":{"axis":0,"delay_us":0,"steps":1}}]}"#,
        ),
        (0, r#"{"commands":[{"nothing":{}}],"unknown":1}"#),
        (
            2,
            r#"{"id":"cut-7","nodes":{"left":{"commands":[{"barrier":{"name":"a"}},{"pause":{"ms":1}}]},"right":{"commands":[{"barrier":{"name":"a"}}]},"far":{"lua":"return 1"}},"max_skew_us":1000,"ready_timeout_ms":5000}"#,
        ),
        (2, r#"{"nodes":{}}"#),
    ];
    let mut seeds: Vec<Vec<u8>> = texts
        .iter()
        .map(|(form, text)| [&[*form], text.as_bytes()].concat())
        .collect();
    let job = JobRequest::from_json(texts[0].1.as_bytes()).expect("a job");
    let group = GroupRequest::from_json(texts[4].1.as_bytes()).expect("a job");
    let mut buffer = [0; 1_024];
    let bytes = version::encode(&job, &mut buffer).expect("room");
    seeds.push([&[1], bytes].concat());
    let bytes = version::encode(&group, &mut buffer).expect("room");
    seeds.push([&[3], bytes].concat());
    seeds
}
