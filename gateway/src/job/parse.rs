//! Job text → [`JobRequest`] or [`GroupRequest`]. Owns the meaning of a payload's encoding; what a job must look like
//! is said in [`keys::job`].
//!
//! Promises: nothing is guessed. An encoding that is not in the contract is refused, however much
//! the payload may look like a job. Absent on purpose: anything that needs to know a node.

use super::gcode::{self, Machines};
use crate::fleet::node::Wish;
use keys::{
    JobId, NodeId, NodeTopic,
    job::{GroupRequest, JOB_BYTES_MAX, JobRequest, Offline, Work},
    pace::{SPEED_PERCENT_MAX, SPEED_PERCENT_MIN},
    record::{ErrorCode, JobError},
};

/// Reads what a client wants of a node's pace: nothing on `hold` and `resume`, `{"percent":50}` on
/// `speed`.
///
/// # Errors
/// Something else, or a percentage out of range.
pub fn wish_from(topic: NodeTopic, payload: &[u8]) -> Result<Wish, JobError> {
    #[derive(serde::Deserialize)]
    #[serde(deny_unknown_fields)]
    struct Speed {
        percent: i64,
    }
    #[derive(serde::Deserialize)]
    #[serde(deny_unknown_fields)]
    struct Nothing {}

    let bad = |error: serde_json::Error| JobError::new(ErrorCode::BadJson, error.to_string());
    if topic != NodeTopic::Speed {
        if !payload.is_empty() {
            serde_json::from_slice::<Nothing>(payload).map_err(bad)?;
        }
        return Ok(Wish {
            hold: Some(topic == NodeTopic::Hold),
            percent: None,
        });
    }
    let speed: Speed = serde_json::from_slice(payload).map_err(bad)?;
    let percent = u16::try_from(speed.percent)
        .ok()
        .filter(|percent| (SPEED_PERCENT_MIN..=SPEED_PERCENT_MAX).contains(percent))
        .ok_or_else(|| {
            let message = format!("percent: must be {SPEED_PERCENT_MIN} to {SPEED_PERCENT_MAX}");
            JobError::new(ErrorCode::BadCommand, message)
        })?;
    Ok(Wish {
        hold: None,
        percent: Some(percent),
    })
}

/// What a payload turned out to be.
#[derive(Clone, Debug, PartialEq)]
pub struct Parsed<R = JobRequest> {
    /// The job, or why it is none.
    pub request: Result<R, JobError>,
    /// The id that it gives, also when the rest of it is wrong.
    pub id_hint: Option<JobId>,
}

/// Reads a job. `encoding` is zenoh's text form of the payload's encoding: `application/json`,
/// `text/x-lua`, `application/octet-stream;postcard`, or `zenoh/bytes` when none was given. No node
/// has a machine: G-code is refused.
pub fn parse(encoding: &str, payload: &[u8]) -> Parsed {
    parse_for("", encoding, payload, &Machines::new())
}

/// Reads a job for the node of this name, or the nodes of this wild chunk. As [`parse`]; in addition
/// `text/x-gcode` and `text/x-gcode;id=NAME` are G-code for the machine of the node.
pub fn parse_for(pattern: &str, encoding: &str, payload: &[u8], machines: &Machines) -> Parsed {
    if payload.len() > JOB_BYTES_MAX {
        let message = format!("{} bytes; a job has at most {JOB_BYTES_MAX}", payload.len());
        return Parsed::refused(ErrorCode::TooLarge, message);
    }
    match Form::from_encoding(encoding, payload) {
        Ok(Form::Json) => {
            let request = JobRequest::from_json(payload);
            let id_hint = match &request {
                Ok(request) => request.id,
                Err(_) => JobRequest::id_of_json(payload),
            };
            Parsed { request, id_hint }
        }
        Ok(Form::Postcard) => {
            let request = JobRequest::from_postcard(payload);
            let id_hint = match &request {
                Ok(request) => request.id,
                Err(_) => keys::version::decode::<JobRequest>(payload)
                    .ok()
                    .and_then(|request| request.id),
            };
            Parsed { request, id_hint }
        }
        Ok(Form::Lua) => match std::str::from_utf8(payload) {
            Ok(script) => Parsed {
                request: Ok(JobRequest {
                    id: None,
                    work: Work::Lua(script.to_owned()),
                    offline: Offline::default(),
                    timeout_s: None,
                    signature: None,
                }),
                id_hint: None,
            },
            Err(error) => Parsed::refused(
                ErrorCode::BadJson,
                format!("the script is not UTF-8 at byte {}", error.valid_up_to()),
            ),
        },
        Ok(Form::Gcode { id }) => read_gcode(pattern, id, payload, machines),
        Err(error) => Parsed {
            request: Err(error),
            id_hint: None,
        },
    }
}

fn read_gcode(pattern: &str, id: Option<JobId>, payload: &[u8], machines: &Machines) -> Parsed {
    let node = NodeId::new(pattern).ok();
    let refused = |code, message: String| Parsed {
        request: Err(JobError::new(code, message)),
        id_hint: id,
    };
    let Some(node) = node else {
        let message =
            "G-code is for one node: what a millimetre is, differs from machine to machine";
        return refused(ErrorCode::BadCommand, message.to_owned());
    };
    let Some(machine) = machines.get(&node) else {
        let message = format!(
            "the gateway does not know how many steps a millimetre of node {node} has: its fleet.toml \
             needs a section [node.{node}]"
        );
        return refused(ErrorCode::BadCommand, message);
    };
    let text = match std::str::from_utf8(payload) {
        Ok(text) => text,
        Err(error) => {
            let at = error.valid_up_to();
            let message = format!("the program is not UTF-8 at byte {at}");
            return refused(ErrorCode::BadCommand, message);
        }
    };
    let request = gcode::compile(text, machine).map_err(JobError::from);
    Parsed {
        request: request.map(|program| JobRequest {
            id,
            work: Work::Commands(program.commands),
            offline: Offline::default(),
            timeout_s: None,
            signature: None,
        }),
        id_hint: id,
    }
}

/// Reads a synchronized job: JSON or postcard, as [`parse`]. A script alone has no parts.
pub fn parse_group(encoding: &str, payload: &[u8]) -> Parsed<GroupRequest> {
    parse_group_for(encoding, payload, &Machines::new())
}

/// Turns the parts of a synchronized job that are G-code, `{"gcode":"…"}`, into commands for the machines
/// of their nodes. `None`: there is none, or it is no such job, which is told where it is read.
fn without_gcode(payload: &[u8], machines: &Machines) -> Result<Option<Vec<u8>>, JobError> {
    // Most have none, and a large one is not read twice for that.
    if !payload.windows(7).any(|window| window == b"\"gcode\"") {
        return Ok(None);
    }
    let Ok(mut job) = serde_json::from_slice::<serde_json::Value>(payload) else {
        return Ok(None);
    };
    let Some(nodes) = job.get_mut("nodes").and_then(|nodes| nodes.as_object_mut()) else {
        return Ok(None);
    };
    for (name, part) in nodes {
        let Some(part) = part.as_object_mut().filter(|part| part.len() == 1) else {
            continue;
        };
        let Some(serde_json::Value::String(text)) = part.get("gcode") else {
            continue;
        };
        let read = read_gcode(name, None, text.as_bytes(), machines).request;
        let work = read.map_err(|error| {
            let message = format!("nodes.{name}.gcode: {}", error.message);
            JobError::new(error.code, message)
        })?;
        if let Work::Commands(commands) = work.work {
            let commands = serde_json::to_value(commands).expect("commands are written in JSON");
            *part = [("commands".to_owned(), commands)].into_iter().collect();
        }
    }
    Ok(Some(job.to_string().into_bytes()))
}

/// Reads a synchronized job whose parts may be G-code, too.
pub fn parse_group_for(
    encoding: &str,
    payload: &[u8],
    machines: &Machines,
) -> Parsed<GroupRequest> {
    if payload.len() > JOB_BYTES_MAX {
        let message = format!("{} bytes; a job has at most {JOB_BYTES_MAX}", payload.len());
        return Parsed::refused(ErrorCode::TooLarge, message);
    }
    let request = match Form::from_encoding(encoding, payload) {
        Ok(Form::Json) => without_gcode(payload, machines)
            .and_then(|read| GroupRequest::from_json(read.as_deref().unwrap_or(payload))),
        Ok(Form::Postcard) => GroupRequest::from_postcard(payload),
        Ok(Form::Lua) => Err(JobError::new(
            ErrorCode::BadJson,
            "a synchronized job is JSON or postcard; a script goes into the part of each node",
        )),
        Ok(Form::Gcode { .. }) => Err(JobError::new(
            ErrorCode::BadJson,
            "a synchronized job is JSON or postcard; `fleet check --commands` turns G-code into commands",
        )),
        Err(error) => Err(error),
    };
    let id_hint = match &request {
        Ok(request) => request.id,
        Err(_) => JobRequest::id_of_json(payload),
    };
    Parsed { request, id_hint }
}

impl<R> Parsed<R> {
    fn refused(code: ErrorCode, message: String) -> Self {
        Self {
            request: Err(JobError::new(code, message)),
            id_hint: None,
        }
    }
}

/// The ways to write a job.
enum Form {
    Json,
    Lua,
    Postcard,
    Gcode { id: Option<JobId> },
}

/// zenoh's name for "no encoding was given".
const NO_ENCODING: &str = "zenoh/bytes";

impl Form {
    fn from_encoding(encoding: &str, payload: &[u8]) -> Result<Self, JobError> {
        // Clients that have no number for an encoding put its name into the schema.
        let named = encoding
            .strip_prefix(NO_ENCODING)
            .and_then(|rest| rest.strip_prefix(';'))
            .unwrap_or(encoding);
        let (name, schema) = named.split_once(';').unwrap_or((named, ""));
        match (name.trim(), schema.trim()) {
            ("application/json" | "text/json", _) => Ok(Self::Json),
            ("text/x-lua", _) => Ok(Self::Lua),
            ("text/x-gcode", "") => Ok(Self::Gcode { id: None }),
            ("text/x-gcode", schema) => match schema.strip_prefix("id=").map(JobId::new) {
                Some(Ok(id)) => Ok(Self::Gcode { id: Some(id) }),
                Some(Err(error)) => Err(JobError::new(ErrorCode::BadId, format!("id: {error}"))),
                None => Err(JobError::new(
                    ErrorCode::BadJson,
                    "encoding text/x-gcode has no schema but id=NAME",
                )),
            },
            ("application/octet-stream", "postcard") => Ok(Self::Postcard),
            ("application/octet-stream", _) => Err(JobError::new(
                ErrorCode::BadJson,
                "encoding application/octet-stream needs the schema `postcard`",
            )),
            ("" | NO_ENCODING, "") => {
                let first = payload.iter().find(|byte| !byte.is_ascii_whitespace());
                match first {
                    Some(b'{') => Ok(Self::Json),
                    Some(_) => Err(JobError::new(
                        ErrorCode::BadJson,
                        "a job without an encoding must be a JSON object, beginning with `{`",
                    )),
                    None => Err(JobError::new(ErrorCode::BadJson, "the job is empty")),
                }
            }
            _ => Err(JobError::new(
                ErrorCode::BadJson,
                format!(
                    "encoding `{encoding}` is not known; a job is application/json, text/x-lua, \
                     text/x-gcode or application/octet-stream;postcard"
                ),
            )),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_wish_is_nothing_or_a_percentage_in_range() {
        let code = |topic, payload: &str| wish_from(topic, payload.as_bytes()).map_err(|e| e.code);
        let (hold, speed) = (NodeTopic::Hold, NodeTopic::Speed);
        let held = |hold| Wish {
            hold: Some(hold),
            percent: None,
        };
        assert_eq!(code(hold, ""), Ok(held(true)));
        assert_eq!(code(hold, "{}"), Ok(held(true)));
        assert_eq!(code(NodeTopic::Resume, ""), Ok(held(false)));
        for percent in [1, 50, 400] {
            let wish = code(speed, &format!("{{\"percent\":{percent}}}"));
            assert_eq!(wish.map(|wish| wish.percent), Ok(Some(percent)));
        }
        for payload in ["{\"percent\":0}", "{\"percent\":401}", "{\"percent\":-1}"] {
            assert_eq!(
                code(speed, payload),
                Err(ErrorCode::BadCommand),
                "{payload}"
            );
        }
        for payload in [
            "",
            "50",
            "{}",
            "{\"percent\":1.5}",
            "{\"percent\":1,\"x\":1}",
        ] {
            assert_eq!(code(speed, payload), Err(ErrorCode::BadJson), "{payload}");
        }
        assert_eq!(code(hold, "{\"percent\":1}"), Err(ErrorCode::BadJson));
    }

    const JOB: &[u8] = br#" {"id":"a-1","commands":[{"pause":{"ms":5}}]}"#;

    fn code(encoding: &str, payload: &[u8]) -> Option<ErrorCode> {
        parse(encoding, payload)
            .request
            .err()
            .map(|error| error.code)
    }

    #[test]
    fn every_encoding_of_the_contract_is_read() {
        let id = JobId::new("a-1").ok();
        for encoding in [
            "application/json",
            "application/json;utf-8",
            "zenoh/bytes",
            "",
        ] {
            let parsed = parse(encoding, JOB);
            assert_eq!(parsed.id_hint, id, "{encoding}");
            assert!(parsed.request.is_ok(), "{encoding}");
        }
        let request = parse("application/json", JOB).request.expect("read above");
        let mut bytes = vec![keys::version::CURRENT];
        bytes.extend(postcard::to_allocvec(&request).expect("encodes"));
        for encoding in [
            "application/octet-stream;postcard",
            "zenoh/bytes;application/octet-stream;postcard",
        ] {
            let parsed = parse(encoding, &bytes);
            assert_eq!(parsed.id_hint, id);
            assert_eq!(parsed.request.as_ref(), Ok(&request));
        }
        for encoding in ["text/x-lua", "zenoh/bytes;text/x-lua"] {
            let parsed = parse(encoding, b"motor.execute()");
            assert_eq!(
                parsed.request.expect("a script").work,
                Work::Lua("motor.execute()".into())
            );
        }
    }

    #[test]
    fn what_the_contract_does_not_know_is_refused() {
        assert_eq!(
            code("zenoh/bytes", b"motor.execute()"),
            Some(ErrorCode::BadJson)
        );
        assert_eq!(code("zenoh/bytes", b"  "), Some(ErrorCode::BadJson));
        assert_eq!(code("zenoh/bytes", b"[]"), Some(ErrorCode::BadJson));
        assert_eq!(code("image/png", JOB), Some(ErrorCode::BadJson));
        assert_eq!(code("zenoh/bytes;image/png", JOB), Some(ErrorCode::BadJson));
        assert_eq!(
            code("zenoh/bytes;zenoh/bytes;image/png", JOB),
            Some(ErrorCode::BadJson)
        );
        assert_eq!(
            code("application/octet-stream", JOB),
            Some(ErrorCode::BadJson)
        );
        assert_eq!(code("text/x-lua", b"\xff"), Some(ErrorCode::BadJson));
        assert_eq!(
            code("application/octet-stream;postcard", JOB),
            Some(ErrorCode::BadJson)
        );
        assert_eq!(
            code("application/json", &vec![b' '; JOB_BYTES_MAX + 1]),
            Some(ErrorCode::TooLarge)
        );
    }

    #[test]
    fn the_id_of_a_wrong_job_is_found() {
        let parsed = parse(
            "application/json",
            br#"{"id":"a-1","commands":[{"jump":{}}]}"#,
        );
        assert_eq!(parsed.id_hint, JobId::new("a-1").ok());
        assert_eq!(
            parsed.request.map_err(|error| error.code),
            Err(ErrorCode::BadCommand)
        );
        let parsed = parse("application/json", br#"{"id":"A 1","commands":[]}"#);
        assert_eq!(parsed.id_hint, None);
        assert_eq!(
            parsed.request.map_err(|error| error.code),
            Err(ErrorCode::BadId)
        );
    }
}
