//! A job's JSON before it is known to be legal, and the words for what is wrong with it.
//!
//! Owns the place in an error (`nodes.left.commands[3].move.delay_us`), and how the call of a stored
//! script becomes Lua.

use super::{
    GroupRequest, JOB_BYTES_MAX, JobCommand, JobRequest, JobSignature, Offline, Work,
    command::object,
};
use crate::{
    JobId, NodeId,
    record::{ErrorCode, JobError},
};
use core::fmt;
use serde::{Deserialize, Deserializer, de};
use std::{
    collections::BTreeMap,
    format,
    string::{String, ToString},
    vec::Vec,
};

/// The JSON object, before it is known to be a legal job.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct RawJob {
    #[serde(default)]
    id: Option<String>,
    #[serde(default)]
    commands: Option<Vec<JobCommand>>,
    #[serde(default)]
    lua: Option<String>,
    #[serde(default)]
    call: Option<String>,
    #[serde(default)]
    args: Option<serde_json::Value>,
    #[serde(default)]
    offline: Option<Offline>,
    #[serde(default)]
    timeout_s: Option<f64>,
    #[serde(default)]
    signature: Option<JobSignature>,
}

/// The JSON object of a synchronized job, before it is known to be legal.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct RawGroup {
    #[serde(default)]
    id: Option<String>,
    nodes: RawParts,
    #[serde(default)]
    max_skew_us: Option<f64>,
    #[serde(default)]
    ready_timeout_ms: Option<f64>,
    #[serde(default)]
    offline: Option<Offline>,
    #[serde(default)]
    timeout_s: Option<f64>,
}

/// One part, before it is known to be legal.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct RawPart {
    #[serde(default)]
    commands: Option<Vec<JobCommand>>,
    #[serde(default)]
    lua: Option<String>,
    #[serde(default)]
    call: Option<String>,
    #[serde(default)]
    args: Option<serde_json::Value>,
    #[serde(default)]
    signature: Option<JobSignature>,
}

/// Parts by the name of their node, in the order of the text: a name that comes twice must not
/// hide a part.
struct RawParts(Vec<(String, RawPart)>);

impl<'de> Deserialize<'de> for RawParts {
    fn deserialize<D: Deserializer<'de>>(reader: D) -> Result<Self, D::Error> {
        struct Parts;

        impl<'de> de::Visitor<'de> for Parts {
            type Value = RawParts;

            fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                write!(f, "an object: a part for each node")
            }

            fn visit_map<A: de::MapAccess<'de>>(self, mut map: A) -> Result<RawParts, A::Error> {
                let mut parts = Vec::new();
                while let Some(name) = map.next_key::<String>()? {
                    let Part(part) = map.next_value()?;
                    parts.push((name, part));
                }
                Ok(RawParts(parts))
            }
        }

        /// In text a part has names, too.
        struct Part(RawPart);

        impl<'de> Deserialize<'de> for Part {
            fn deserialize<D: Deserializer<'de>>(reader: D) -> Result<Self, D::Error> {
                object(reader).map(Part)
            }
        }

        reader.deserialize_map(Parts)
    }
}

/// Finds an id in a job that may be refused, so that its record can be named.
#[derive(Deserialize)]
struct OnlyId {
    id: Option<JobId>,
}

impl JobRequest {
    /// Reads a job from JSON and checks it.
    ///
    /// # Errors
    /// The first thing that is wrong, with its place.
    pub fn from_json(payload: &[u8]) -> Result<Self, JobError> {
        if payload.len() > JOB_BYTES_MAX {
            return Err(too_large_bytes(payload.len()));
        }
        let raw: RawJob = read_object(payload)?;
        let script = script_of(raw.lua, raw.call, raw.args)?;
        let work = Work::from_either(raw.commands, script, "job")?;
        let request = Self {
            id: read_id(raw.id)?,
            work,
            offline: raw.offline.unwrap_or_default(),
            timeout_s: raw.timeout_s,
            signature: raw.signature,
        };
        request.check()?;
        Ok(request)
    }

    /// Returns the id that a job's JSON gives, even if the rest of it is wrong.
    pub fn id_of_json(payload: &[u8]) -> Option<JobId> {
        serde_json::from_slice::<OnlyId>(payload).ok()?.id
    }
}

impl GroupRequest {
    /// Reads a synchronized job from JSON and checks it.
    ///
    /// # Errors
    /// The first thing that is wrong, with its place.
    pub fn from_json(payload: &[u8]) -> Result<Self, JobError> {
        if payload.len() > JOB_BYTES_MAX {
            return Err(too_large_bytes(payload.len()));
        }
        let raw: RawGroup = read_object(payload)?;
        let mut nodes = BTreeMap::new();
        let mut signatures = BTreeMap::new();
        for (name, part) in raw.nodes.0 {
            let bad = |words: &dyn fmt::Display| {
                JobError::new(ErrorCode::BadJson, format!("nodes.{name}: {words}"))
            };
            let node = NodeId::new(&name).map_err(|error| bad(&error))?;
            let work = script_of(part.lua, part.call, part.args)
                .and_then(|script| Work::from_either(part.commands, script, "part"))
                .map_err(|error| bad(&error.message))?;
            if nodes.insert(node, work).is_some() {
                return Err(bad(&"there is a part for this node already"));
            }
            signatures.extend(part.signature.map(|signature| (node, signature)));
        }
        let request = Self {
            id: read_id(raw.id)?,
            nodes,
            max_skew_us: raw.max_skew_us,
            ready_timeout_ms: raw.ready_timeout_ms,
            offline: raw.offline,
            timeout_s: raw.timeout_s,
            signatures,
        };
        request.check()?;
        Ok(request)
    }
}

impl Work {
    fn from_either(
        commands: Option<Vec<JobCommand>>,
        script: Option<String>,
        what: &str,
    ) -> Result<Self, JobError> {
        let message = match (commands, script) {
            (Some(commands), None) => return Ok(Self::Commands(commands)),
            (None, Some(script)) => return Ok(Self::Lua(script)),
            (None, None) => format!("a {what} needs `commands` or `lua`"),
            (Some(_), Some(_)) => format!("a {what} has either `commands` or `lua`, not both"),
        };
        Err(JobError::new(ErrorCode::BadJson, message))
    }
}

/// Returns the script of a job: its own, or one that calls a stored one.
fn script_of(
    lua: Option<String>,
    call: Option<String>,
    args: Option<serde_json::Value>,
) -> Result<Option<String>, JobError> {
    let refuse = |message: String| Err(JobError::new(ErrorCode::BadJson, message));
    match (lua, call, args) {
        (lua, None, None) => Ok(lua),
        (_, None, Some(_)) => refuse("args: only a `call` has arguments".into()),
        (Some(_), Some(_), _) => refuse("either `lua` or `call`, not both".into()),
        (None, Some(name), args) => {
            if let Err(error) = NodeId::new(&name) {
                return refuse(format!("call: {error}"));
            }
            let mut text = format!("return node.call(\"{name}\", ");
            write_lua(&args.unwrap_or_default(), &mut text);
            text.push(')');
            Ok(Some(text))
        }
    }
}

/// Writes a JSON value as Lua says it.
fn write_lua(value: &serde_json::Value, to: &mut String) {
    use serde_json::Value;
    match value {
        Value::Null => to.push_str("nil"),
        Value::Bool(value) => to.push_str(if *value { "true" } else { "false" }),
        Value::Number(number) => match number.as_i64() {
            Some(whole) if i32::try_from(whole).is_ok() => to.push_str(&format!("{whole}")),
            _ => to.push_str(&format!("{:e}", number.as_f64().unwrap_or(0.0))),
        },
        Value::String(text) => write_lua_text(text, to),
        Value::Array(items) => {
            to.push('{');
            for item in items {
                write_lua(item, to);
                to.push(',');
            }
            to.push('}');
        }
        Value::Object(fields) => {
            to.push('{');
            for (name, value) in fields {
                to.push('[');
                write_lua_text(name, to);
                to.push_str("]=");
                write_lua(value, to);
                to.push(',');
            }
            to.push('}');
        }
    }
}

fn write_lua_text(text: &str, to: &mut String) {
    to.push('"');
    for letter in text.chars() {
        match letter {
            '"' | '\\' => to.extend(['\\', letter]),
            letter if letter.is_ascii_control() => to.push_str(&format!("\\{:03}", letter as u8)),
            letter => to.push(letter),
        }
    }
    to.push('"');
}

/// Reads an object of one of ours, and nothing behind it.
fn read_object<T: de::DeserializeOwned>(payload: &[u8]) -> Result<T, JobError> {
    let mut reader = serde_json::Deserializer::from_slice(payload);
    let first = payload.iter().find(|byte| !byte.is_ascii_whitespace());
    if first == Some(&b'[') {
        let message = "a job is a JSON object, not an array";
        return Err(JobError::new(ErrorCode::BadJson, message));
    }
    let raw = serde_path_to_error::deserialize(&mut reader).map_err(|error| {
        let place = error.path().to_string();
        json_error(payload, &place, error.inner())
    })?;
    reader
        .end()
        .map_err(|error| json_error(payload, ".", &error))?;
    Ok(raw)
}

fn read_id(text: Option<String>) -> Result<Option<JobId>, JobError> {
    text.map(|text| JobId::new(&text))
        .transpose()
        .map_err(|error| JobError::new(ErrorCode::BadId, format!("id: {error}")))
}

pub(super) fn too_large_bytes(byte_count: usize) -> JobError {
    let message = format!("{byte_count} bytes; a job has at most {JOB_BYTES_MAX}");
    JobError::new(ErrorCode::TooLarge, message)
}

/// Turns serde's message into ours: the place first, line and column last.
fn json_error(payload: &[u8], place: &str, error: &serde_json::Error) -> JobError {
    use serde_json::error::Category;
    // In a part, the place begins with the part's.
    let of_command = match place.strip_prefix("commands[") {
        Some(rest) => Some(rest),
        None => place.split_once(".commands[").map(|(_, rest)| rest),
    };
    let in_commands = of_command.is_some();
    // One item too many is a syntax error to the reader of a list, although the text is JSON.
    let too_many = error.is_syntax() && serde_json::from_slice::<de::IgnoredAny>(payload).is_ok();
    let code = match error.classify() {
        Category::Data if in_commands => ErrorCode::BadCommand,
        Category::Syntax if in_commands && too_many => ErrorCode::BadCommand,
        _ => ErrorCode::BadJson,
    };
    let words = if too_many {
        let (line, column) = (error.line(), error.column());
        let what = match of_command {
            Some(rest) if rest.ends_with(']') && !rest.contains('.') => {
                "more than one command in one object"
            }
            _ => "too many items",
        };
        format!("{what} at line {line} column {column}")
    } else {
        error.to_string()
    };
    // An unknown field's path ends in the field itself; serde's words name it again.
    let message = if place == "." || place.is_empty() || place == "?" {
        words
    } else {
        format!("{place}: {words}")
    };
    JobError::new(code, message)
}
