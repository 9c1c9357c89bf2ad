//! A job as clients write it: JSON, Lua, or postcard of the same type.
//!
//! Reading checks everything that can be known without a node and names the place of the first
//! error (`commands[3].move.delay_us: …`). A job is taken whole or not at all.

use crate::{
    AxisId, Command, JobId, NodeId,
    command::{LINE_AXES, POSITION_C_MAX, Ramp, RampShape},
    record::{ErrorCode, JobError},
    script::SCRIPT_BYTES_MAX,
};
use core::{fmt, marker::PhantomData};
use serde::{Deserialize, Deserializer, Serialize, de};
use std::{
    collections::BTreeMap,
    format,
    string::{String, ToString},
    vec::Vec,
};

/// Largest payload of a job, bytes.
pub const JOB_BYTES_MAX: usize = 64 << 20;

/// Most commands in a job.
pub const JOB_COMMANDS_MAX: usize = 1_000_000;

/// Longest pause, ms: one day.
pub const PAUSE_MS_MAX: u32 = 86_400_000;

/// Highest speed of a ramp or line, Hz: the one of a move whose steps are 1 µs apart.
pub const SPEED_HZ_MAX: u32 = 1_000_000;

/// Longest move, µs: the longest that a node can count, 9,139 years.
pub const MOVE_US_MAX: u64 = 1 << 58;

/// Most nodes of a synchronized job: each change of a part tells the record of all of them.
pub const GROUP_NODES_MAX: usize = 128;

/// Longest name of a barrier, bytes.
pub const BARRIER_BYTES_MAX: usize = 64;

/// A job as a client asks for it.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct JobRequest {
    /// The client's own name for it; makes it idempotent.
    pub id: Option<JobId>,
    /// What to do.
    pub work: Work,
    /// What to do when the node is not there.
    pub offline: Offline,
    /// Longest time from the first command sent to the last pulse, s.
    pub timeout_s: Option<f64>,
    /// The operator's signature, for nodes that ask for one. In JSON only.
    #[serde(skip)]
    pub signature: Option<JobSignature>,
}

/// Who has signed a job, for which life of its node; what is signed stands in `signed.rs`.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct JobSignature {
    /// The Ed25519 public key, 64 hexadecimal digits.
    pub key: Hex<32>,
    /// Random number of the node's boot.
    pub boot: u32,
    /// Used once.
    pub number: u64,
    /// The Ed25519 signature, 128 hexadecimal digits.
    pub signature: Hex<64>,
}

/// Bytes that stand as hexadecimal digits in text.
#[derive(Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub struct Hex<const COUNT: usize>(pub [u8; COUNT]);

impl<const COUNT: usize> fmt::Display for Hex<COUNT> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.0.iter().try_for_each(|byte| write!(f, "{byte:02x}"))
    }
}

impl<const COUNT: usize> fmt::Debug for Hex<COUNT> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        fmt::Display::fmt(self, f)
    }
}

impl<const COUNT: usize> core::str::FromStr for Hex<COUNT> {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let bad = || format!("not {} hexadecimal digits", 2 * COUNT);
        if text.len() != 2 * COUNT || !text.bytes().all(|byte| byte.is_ascii_hexdigit()) {
            return Err(bad());
        }
        let mut bytes = [0; COUNT];
        for (index, byte) in bytes.iter_mut().enumerate() {
            let digits = &text[2 * index..2 * index + 2];
            *byte = u8::from_str_radix(digits, 16).map_err(|_| bad())?;
        }
        Ok(Self(bytes))
    }
}

impl<const COUNT: usize> Serialize for Hex<COUNT> {
    fn serialize<S: serde::Serializer>(&self, writer: S) -> Result<S::Ok, S::Error> {
        writer.collect_str(self)
    }
}

impl<'de, const COUNT: usize> Deserialize<'de> for Hex<COUNT> {
    fn deserialize<D: Deserializer<'de>>(reader: D) -> Result<Self, D::Error> {
        let text = String::deserialize(reader)?;
        text.parse().map_err(de::Error::custom)
    }
}

/// A synchronized job as a client asks for it: one part for each node, started together.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct GroupRequest {
    /// The client's own name for it; makes it idempotent.
    pub id: Option<JobId>,
    /// The parts: 1 to [`GROUP_NODES_MAX`].
    pub nodes: BTreeMap<NodeId, Work>,
    /// How far apart the first edges may be by what is known of the nodes' clocks, µs.
    pub max_skew_us: Option<f64>,
    /// How long the nodes have to become ready once all parts were sent, ms.
    pub ready_timeout_ms: Option<f64>,
    /// What to do when a node is not there. Unlike a plain job, one that says nothing is refused.
    pub offline: Option<Offline>,
    /// Longest time from the last part's first command sent to the last pulse, s.
    pub timeout_s: Option<f64>,
}

/// What a job does.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub enum Work {
    /// A list of commands.
    Commands(Vec<JobCommand>),
    /// A Lua script.
    Lua(String),
}

/// What to do with a job for a node that is known but not there.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Offline {
    /// Keep it until the node returns.
    #[default]
    Queue,
    /// Refuse it.
    Reject,
}

/// A command as clients write it: `{"move":{"axis":0,"delay_us":500,"steps":-2000}}`.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case", deny_unknown_fields)]
pub enum JobCommand {
    /// Steps at one interval.
    #[serde(deserialize_with = "object")]
    Move(MoveFields),
    /// Two moves that start on the same tick.
    #[serde(deserialize_with = "object")]
    SyncMove(SyncMoveFields),
    /// A relative move with ramps.
    #[serde(deserialize_with = "object")]
    Ramp(RampFields),
    /// An absolute move with ramps.
    #[serde(deserialize_with = "object")]
    RampTo(RampToFields),
    /// A straight line of all axes.
    #[serde(deserialize_with = "object")]
    Line(LineFields),
    /// A rest.
    #[serde(deserialize_with = "object")]
    Pause(PauseFields),
    /// Laser power.
    #[serde(deserialize_with = "object")]
    Laser(LaserFields),
    /// A lidar reading.
    #[serde(deserialize_with = "object")]
    LidarRead(LidarReadFields),
    /// Find the reference switch.
    #[serde(deserialize_with = "object")]
    Home(HomeFields),
    /// Name the present place.
    #[serde(deserialize_with = "object")]
    SetPosition(SetPositionFields),
    /// A meeting point.
    #[serde(deserialize_with = "object")]
    Barrier(BarrierFields),
    /// C to a named position.
    #[serde(rename = "movc", deserialize_with = "object")]
    MoveC(MoveCFields),
    /// D on or off.
    #[serde(rename = "movd", deserialize_with = "object")]
    MoveD(MoveDFields),
    /// Where C and D are.
    #[serde(rename = "statcd", deserialize_with = "object")]
    StatusCd(StatusCdFields),
}

/// Reads the fields of a command. In text they have names: serde alone would take an array, too.
fn object<'de, D, T>(reader: D) -> Result<T, D::Error>
where
    D: Deserializer<'de>,
    T: Deserialize<'de>,
{
    struct Named<T>(PhantomData<T>);

    impl<'de, T: Deserialize<'de>> de::Visitor<'de> for Named<T> {
        type Value = T;

        fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
            write!(f, "an object")
        }

        fn visit_map<A: de::MapAccess<'de>>(self, fields: A) -> Result<T, A::Error> {
            T::deserialize(de::value::MapAccessDeserializer::new(fields))
        }
    }

    if reader.is_human_readable() {
        reader.deserialize_map(Named(PhantomData))
    } else {
        T::deserialize(reader)
    }
}

macro_rules! fields {
    ($(#[$doc:meta])* $name:ident { $($(#[$field_doc:meta])* $field:ident: $type:ty,)* }) => {
        $(#[$doc])*
        #[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
        #[serde(deny_unknown_fields)]
        pub struct $name {
            $($(#[$field_doc])* pub $field: $type,)*
        }
    };
}

fields! {
    /// Fields of `move`.
    MoveFields {
        /// Axis number, from 0.
        axis: u8,
        /// Time between steps, µs, from 1.
        delay_us: u32,
        /// Steps with sign, never 0.
        steps: i32,
    }
}
fields! {
    /// Fields of `sync_move`.
    SyncMoveFields {
        /// Time between steps of axes 0 and 1, µs, from 1.
        delay_us: [u32; 2],
        /// Steps with sign of axes 0 and 1, never 0.
        steps: [i32; 2],
    }
}
fields! {
    /// Fields of `ramp`.
    RampFields {
        /// Axis number, from 0.
        axis: u8,
        /// Steps with sign, never 0.
        steps: i32,
        /// Speed, Hz, 1 to [`SPEED_HZ_MAX`].
        speed_hz: u32,
        /// Acceleration, steps/s², from 1.
        accel: u32,
        /// Jerk, steps/s³; makes it an S-curve.
        #[serde(default)]
        jerk: Option<u32>,
        /// Steps of linearly growing acceleration.
        #[serde(default)]
        linear_steps: u16,
        /// Steps whose speed the move starts with.
        #[serde(default)]
        jump_steps: u16,
    }
}
fields! {
    /// Fields of `ramp_to`.
    RampToFields {
        /// Axis number, from 0.
        axis: u8,
        /// Target, steps.
        position: i64,
        /// Speed, Hz, 1 to [`SPEED_HZ_MAX`].
        speed_hz: u32,
        /// Acceleration, steps/s², from 1.
        accel: u32,
        /// Jerk, steps/s³; makes it an S-curve.
        #[serde(default)]
        jerk: Option<u32>,
        /// Steps of linearly growing acceleration.
        #[serde(default)]
        linear_steps: u16,
        /// Steps whose speed the move starts with.
        #[serde(default)]
        jump_steps: u16,
    }
}
fields! {
    /// Fields of `line`.
    LineFields {
        /// Steps with sign of each axis from 0 on, one to four of them, not all 0.
        steps: Vec<i32>,
        /// Speed of the axis with most steps, Hz, 1 to [`SPEED_HZ_MAX`].
        speed_hz: u32,
        /// Its acceleration, steps/s², from 1.
        accel: u32,
        /// Its jerk, steps/s³.
        #[serde(default)]
        jerk: Option<u32>,
    }
}
fields! {
    /// Fields of `pause`.
    PauseFields {
        /// Duration, ms.
        ms: u32,
    }
}
fields! {
    /// Fields of `laser`.
    LaserFields {
        /// Power, 0 to 100 %.
        power_percent: u8,
    }
}
fields! {
    /// `lidar_read` has no fields.
    LidarReadFields {}
}
fields! {
    /// Fields of `home`.
    HomeFields {
        /// Axis number, from 0.
        axis: u8,
    }
}
fields! {
    /// Fields of `set_position`.
    SetPositionFields {
        /// Axis number, from 0.
        axis: u8,
        /// Its new position, steps.
        position: i64,
    }
}
fields! {
    /// Fields of `barrier`.
    BarrierFields {
        /// Name of the meeting point, the same in every part that meets there.
        name: String,
    }
}
fields! {
    /// Fields of `movc`.
    MoveCFields {
        /// Number of the position, 0 to [`POSITION_C_MAX`]. Wide, so that every wrong one gets the
        /// same answer.
        position: i64,
    }
}
fields! {
    /// Fields of `movd`.
    MoveDFields {
        /// To ON, else to OFF.
        on: bool,
    }
}
fields! {
    /// `statcd` has no fields.
    StatusCdFields {}
}

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

    /// Reads a job from postcard (version byte and message) and checks it.
    ///
    /// # Errors
    /// The first thing that is wrong.
    pub fn from_postcard(payload: &[u8]) -> Result<Self, JobError> {
        let request: Self = from_postcard(payload, "JobRequest")?;
        request.check()?;
        Ok(request)
    }

    /// Returns the id that a job's JSON gives, even if the rest of it is wrong.
    pub fn id_of_json(payload: &[u8]) -> Option<JobId> {
        serde_json::from_slice::<OnlyId>(payload).ok()?.id
    }

    /// Checks what the types do not.
    ///
    /// # Errors
    /// The first value that is out of range, with its place.
    pub fn check(&self) -> Result<(), JobError> {
        check_time("timeout_s", self.timeout_s)?;
        self.work.check()
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

    fn check(&self) -> Result<(), JobError> {
        let commands = match self {
            Self::Commands(commands) => commands,
            Self::Lua(script) if script.len() > SCRIPT_BYTES_MAX => {
                let message = format!(
                    "lua: {} bytes; a script has at most {SCRIPT_BYTES_MAX}",
                    script.len()
                );
                return Err(JobError::new(ErrorCode::TooLarge, message));
            }
            Self::Lua(_) => return Ok(()),
        };
        if commands.is_empty() {
            return Err(JobError::new(
                ErrorCode::BadCommand,
                "commands: the list is empty",
            ));
        }
        if commands.len() > JOB_COMMANDS_MAX {
            let message = format!(
                "commands: {} of them; a job has at most {JOB_COMMANDS_MAX}",
                commands.len()
            );
            return Err(JobError::new(ErrorCode::TooLarge, message));
        }
        for (index, command) in commands.iter().enumerate() {
            command.check().map_err(|error| error.at(index))?;
        }
        Ok(())
    }

    /// Returns the names of its meeting points and the indices of their commands, in order.
    fn barriers(&self) -> impl Iterator<Item = (&str, usize)> {
        let commands = match self {
            Self::Commands(commands) => commands.as_slice(),
            Self::Lua(_) => &[],
        };
        commands
            .iter()
            .enumerate()
            .filter_map(|(index, command)| match command {
                JobCommand::Barrier(fields) => Some((fields.name.as_str(), index)),
                _ => None,
            })
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
        }
        let request = Self {
            id: read_id(raw.id)?,
            nodes,
            max_skew_us: raw.max_skew_us,
            ready_timeout_ms: raw.ready_timeout_ms,
            offline: raw.offline,
            timeout_s: raw.timeout_s,
        };
        request.check()?;
        Ok(request)
    }

    /// Reads a synchronized job from postcard (version byte and message) and checks it.
    ///
    /// # Errors
    /// The first thing that is wrong.
    pub fn from_postcard(payload: &[u8]) -> Result<Self, JobError> {
        let request: Self = from_postcard(payload, "GroupRequest")?;
        request.check()?;
        Ok(request)
    }

    /// Checks what the types do not.
    ///
    /// # Errors
    /// The first value that is out of range, with its place.
    pub fn check(&self) -> Result<(), JobError> {
        check_time("max_skew_us", self.max_skew_us)?;
        check_time("ready_timeout_ms", self.ready_timeout_ms)?;
        check_time("timeout_s", self.timeout_s)?;
        if self.nodes.is_empty() {
            let message = "nodes: there must be a part for at least one node";
            return Err(JobError::new(ErrorCode::BadJson, message));
        }
        if self.nodes.len() > GROUP_NODES_MAX {
            let message = format!(
                "nodes: {} of them; a synchronized job has at most {GROUP_NODES_MAX}",
                self.nodes.len()
            );
            return Err(JobError::new(ErrorCode::TooLarge, message));
        }
        for (node, work) in &self.nodes {
            work.check().map_err(|error| {
                JobError::new(error.code, format!("nodes.{node}.{}", error.message))
            })?;
        }
        self.check_barriers()
    }

    /// Meeting points that could never be lifted: met by one part only, twice in one part, or in
    /// an order in which two parts wait for each other.
    fn check_barriers(&self) -> Result<(), JobError> {
        let bad = |node: &NodeId, index: usize, words: &str| {
            let message = format!("nodes.{node}.commands[{index}].barrier: {words}");
            Err(JobError::new(ErrorCode::BadCommand, message))
        };
        let mut parts_of: BTreeMap<&str, usize> = BTreeMap::new();
        let mut lists: Vec<(&NodeId, Vec<(&str, usize)>)> = Vec::new();
        for (node, work) in &self.nodes {
            let list: Vec<_> = work.barriers().collect();
            let mut here: BTreeMap<&str, usize> = BTreeMap::new();
            for (name, index) in &list {
                if let Some(first) = here.insert(name, *index) {
                    let words = format!("`{name}` is met in commands[{first}] already");
                    return bad(node, *index, &words);
                }
                *parts_of.entry(name).or_default() += 1;
            }
            lists.push((node, list));
        }
        if parts_of.len() > usize::from(u16::MAX) {
            let message = format!(
                "nodes: {} meeting points; there can be at most {}",
                parts_of.len(),
                u16::MAX
            );
            return Err(JobError::new(ErrorCode::TooLarge, message));
        }
        for (node, list) in &lists {
            for (name, index) in list {
                if parts_of[name] == 1 {
                    return bad(node, *index, &format!("no other part meets at `{name}`"));
                }
            }
        }
        // Meets what can be met until nothing is left, or nothing can be.
        let mut fronts = std::vec![0; lists.len()];
        let mut waiting: BTreeMap<&str, Vec<usize>> = BTreeMap::new();
        let mut arriving: Vec<usize> = (0..lists.len()).collect();
        while let Some(part) = arriving.pop() {
            let Some((name, _)) = lists[part].1.get(fronts[part]) else {
                continue;
            };
            let here = waiting.entry(name).or_default();
            here.push(part);
            if here.len() == parts_of[name] {
                for part in waiting.remove(name).unwrap_or_default() {
                    fronts[part] += 1;
                    arriving.push(part);
                }
            }
        }
        for (part, (node, list)) in lists.iter().enumerate() {
            if let Some((name, index)) = list.get(fronts[part]) {
                let words = format!(
                    "`{name}` is never met: another part waits for this one somewhere else"
                );
                return bad(node, *index, &words);
            }
        }
        Ok(())
    }

    /// Returns the number of each meeting point: 1, 2, … by first appearance, parts in the order
    /// of their nodes' names. 0 is the start.
    pub fn barrier_numbers(&self) -> BTreeMap<&str, u16> {
        let mut numbers = BTreeMap::new();
        for (name, _) in self.nodes.values().flat_map(Work::barriers) {
            let next = numbers.len() as u16 + 1;
            numbers.entry(name).or_insert(next);
        }
        numbers
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

fn check_time(field: &str, value: Option<f64>) -> Result<(), JobError> {
    match value {
        Some(value) if !(value > 0.0 && value.is_finite()) => {
            let message = format!("{field}: {value} is not a time; it must be more than 0");
            Err(JobError::new(ErrorCode::BadJson, message))
        }
        _ => Ok(()),
    }
}

/// What is wrong with a command, without its index.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct CommandError {
    /// The command's word and the field: `move.delay_us`.
    pub place: String,
    /// What is wrong there.
    pub message: String,
}

impl CommandError {
    /// Makes it the error of the command at this index of its job.
    pub fn at(&self, index: usize) -> JobError {
        let Self { place, message } = self;
        JobError::new(
            ErrorCode::BadCommand,
            format!("commands[{index}].{place}: {message}"),
        )
    }
}

impl JobCommand {
    /// Returns the word that names the command in JSON.
    pub const fn word(&self) -> &'static str {
        match self {
            Self::Move(_) => "move",
            Self::SyncMove(_) => "sync_move",
            Self::Ramp(_) => "ramp",
            Self::RampTo(_) => "ramp_to",
            Self::Line(_) => "line",
            Self::Pause(_) => "pause",
            Self::Laser(_) => "laser",
            Self::LidarRead(_) => "lidar_read",
            Self::Home(_) => "home",
            Self::SetPosition(_) => "set_position",
            Self::Barrier(_) => "barrier",
            Self::MoveC(_) => "movc",
            Self::MoveD(_) => "movd",
            Self::StatusCd(_) => "statcd",
        }
    }

    fn error(&self, field: &str, message: impl Into<String>) -> CommandError {
        let word = self.word();
        let place = if field.is_empty() {
            word.into()
        } else {
            format!("{word}.{field}")
        };
        CommandError {
            place,
            message: message.into(),
        }
    }

    /// Checks the ranges that the types do not.
    ///
    /// # Errors
    /// The first value that is out of range, with its place in the command.
    pub fn check(&self) -> Result<(), CommandError> {
        let delay = |field: &str, delay_us: u32| match delay_us {
            0 => Err(self.error(field, "0 is out of range; it must be at least 1 µs")),
            _ => Ok(()),
        };
        let steps = |field: &str, steps: i32| match steps {
            0 => Err(self.error(field, "0 steps move nothing; it must not be 0")),
            i32::MIN => Err(self.error(field, "out of range; at most 2147483647 steps either way")),
            _ => Ok(()),
        };
        let duration = |field: &str, delay_us: u32, steps: i32| {
            let takes_us = u64::from(delay_us) * u64::from(steps.unsigned_abs());
            if takes_us > MOVE_US_MAX {
                return Err(self.error(
                    field,
                    format!(
                        "{delay_us} is out of range; with so many steps at most {} µs",
                        MOVE_US_MAX / u64::from(steps.unsigned_abs())
                    ),
                ));
            }
            Ok(())
        };
        let positive = |field: &str, value: u32| match value {
            0 => Err(self.error(field, "0 is out of range; it must be at least 1")),
            _ => Ok(()),
        };
        let speed = |speed_hz: u32| match speed_hz {
            1..=SPEED_HZ_MAX => Ok(()),
            _ => {
                let message = format!("{speed_hz} is out of range; 1 to {SPEED_HZ_MAX}");
                Err(self.error("speed_hz", message))
            }
        };
        let shape = |jerk: Option<u32>, linear_steps: u16, jump_steps: u16| match jerk {
            Some(0) => Err(self.error("jerk", "0 is out of range; leave it out for no limit")),
            Some(_) if linear_steps != 0 || jump_steps != 0 => {
                Err(self.error("jerk", "cannot be combined with linear_steps or jump_steps"))
            }
            _ => Ok(()),
        };
        match self {
            Self::Move(fields) => {
                delay("delay_us", fields.delay_us)?;
                steps("steps", fields.steps)?;
                duration("delay_us", fields.delay_us, fields.steps)
            }
            Self::SyncMove(fields) => {
                for index in 0..2 {
                    delay(&format!("delay_us[{index}]"), fields.delay_us[index])?;
                    steps(&format!("steps[{index}]"), fields.steps[index])?;
                    let place = format!("delay_us[{index}]");
                    duration(&place, fields.delay_us[index], fields.steps[index])?;
                }
                Ok(())
            }
            Self::Ramp(fields) => {
                steps("steps", fields.steps)?;
                speed(fields.speed_hz)?;
                positive("accel", fields.accel)?;
                shape(fields.jerk, fields.linear_steps, fields.jump_steps)
            }
            Self::RampTo(fields) => {
                speed(fields.speed_hz)?;
                positive("accel", fields.accel)?;
                shape(fields.jerk, fields.linear_steps, fields.jump_steps)
            }
            Self::Line(fields) => {
                if fields.steps.is_empty() || fields.steps.len() > LINE_AXES {
                    let message =
                        format!("{} axes; it must be 1 to {LINE_AXES}", fields.steps.len());
                    return Err(self.error("steps", message));
                }
                if fields.steps.contains(&i32::MIN) {
                    return Err(self.error("steps", "at most 2147483647 steps either way"));
                }
                if fields.steps.iter().all(|count| *count == 0) {
                    return Err(self.error("steps", "all 0: nothing would move"));
                }
                speed(fields.speed_hz)?;
                positive("accel", fields.accel)?;
                shape(fields.jerk, 0, 0)
            }
            Self::Pause(fields) if fields.ms > PAUSE_MS_MAX => {
                let message = format!(
                    "{} is out of range; at most {PAUSE_MS_MAX} (a day)",
                    fields.ms
                );
                Err(self.error("ms", message))
            }
            Self::Laser(fields) if fields.power_percent > 100 => {
                let message = format!("{} is out of range; 0 to 100", fields.power_percent);
                Err(self.error("power_percent", message))
            }
            Self::Barrier(fields)
                if fields.name.is_empty() || fields.name.len() > BARRIER_BYTES_MAX =>
            {
                Err(self.error("name", format!("must have 1 to {BARRIER_BYTES_MAX} bytes")))
            }
            Self::MoveC(fields) if !(0..=i64::from(POSITION_C_MAX)).contains(&fields.position) => {
                let message = format!("Invalid C position (0-{POSITION_C_MAX})");
                Err(self.error("position", message))
            }
            Self::Pause(_)
            | Self::Laser(_)
            | Self::LidarRead(_)
            | Self::Home(_)
            | Self::SetPosition(_)
            | Self::Barrier(_)
            | Self::MoveC(_)
            | Self::MoveD(_)
            | Self::StatusCd(_) => Ok(()),
        }
    }

    /// Returns the command as a node takes it. `barrier_from_name` numbers the meeting points.
    pub fn to_command(&self, barrier_from_name: impl FnOnce(&str) -> u16) -> Command {
        let shape = |jerk: Option<u32>, linear_steps, jump_steps| match jerk {
            Some(jerk_hz_per_s2) => RampShape::Jerk { jerk_hz_per_s2 },
            None => RampShape::Trapezoid {
                linear_steps,
                jump_steps,
            },
        };
        match self {
            Self::Move(f) => Command::Move {
                axis: AxisId(f.axis),
                delay_us: f.delay_us,
                steps: f.steps,
            },
            Self::SyncMove(f) => Command::SyncMove {
                delay_us: f.delay_us,
                steps: f.steps,
            },
            Self::Ramp(f) => Command::Ramp {
                axis: AxisId(f.axis),
                steps: f.steps,
                ramp: Ramp {
                    speed_hz: f.speed_hz,
                    accel_hz_per_s: f.accel,
                    shape: shape(f.jerk, f.linear_steps, f.jump_steps),
                },
            },
            Self::RampTo(f) => Command::RampTo {
                axis: AxisId(f.axis),
                position_steps: f.position,
                ramp: Ramp {
                    speed_hz: f.speed_hz,
                    accel_hz_per_s: f.accel,
                    shape: shape(f.jerk, f.linear_steps, f.jump_steps),
                },
            },
            Self::Line(f) => {
                let mut steps = [0; LINE_AXES];
                for (to, from) in steps.iter_mut().zip(&f.steps) {
                    *to = *from;
                }
                Command::Line {
                    steps,
                    speed_hz: f.speed_hz,
                    accel_hz_per_s: f.accel,
                    jerk_hz_per_s2: f.jerk.unwrap_or(0),
                }
            }
            Self::Pause(f) => Command::Pause { pause_ms: f.ms },
            Self::Laser(f) => Command::Laser {
                power_percent: f.power_percent,
            },
            Self::LidarRead(_) => Command::LidarRead,
            Self::Home(f) => Command::Home {
                axis: AxisId(f.axis),
            },
            Self::SetPosition(f) => Command::SetPosition {
                axis: AxisId(f.axis),
                position_steps: f.position,
            },
            Self::Barrier(f) => Command::Barrier {
                barrier: barrier_from_name(&f.name),
            },
            Self::MoveC(f) => Command::MoveC {
                // One that was not checked stays wrong.
                index: u8::try_from(f.position).unwrap_or(u8::MAX),
            },
            Self::MoveD(f) => Command::MoveD { on: f.on },
            Self::StatusCd(_) => Command::StatusCd,
        }
    }
}

/// Decodes a request of client's postcard, not yet checked; `name` is the message's in the error.
fn from_postcard<T: de::DeserializeOwned>(payload: &[u8], name: &str) -> Result<T, JobError> {
    if payload.len() > JOB_BYTES_MAX {
        return Err(too_large_bytes(payload.len()));
    }
    crate::version::decode(payload).map_err(|error| {
        let message = format!("no postcard {name}: {error}");
        JobError::new(ErrorCode::BadJson, message)
    })
}

fn too_large_bytes(byte_count: usize) -> JobError {
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
