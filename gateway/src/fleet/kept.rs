//! What operators keep in the gateway beside jobs: templates of jobs, and schedules that hand one in
//! again and again.
//!
//! ```text
//!   get PREFIX/manage/template/NAME   {"text":"…","format":"json|lua|gcode","about":"…"}: kept
//!   get PREFIX/manage/schedule/NAME   {"target":"left","job":{…},"every_s":600}: kept
//!   both                              nothing: shown; {"remove":true}: gone; NAME may be wild for these
//! ```
//!
//! A template is text with `${NAME}` in it; who hands in the job fills it in. A schedule has a whole job
//! in JSON, which is checked when it is kept.
//!
//! # When
//! `every_s` counts from `from`, or from now; `daily` is a time of day. Both in UTC, and both go on when
//! the gateway restarts. A time that passes while the gateway does not run is **not** made up for, and
//! neither is one at which the job before has not ended, or that the machine has slept over: it is counted as missed, and the next one comes
//! in its turn. A job that is due for a node which is away is queued as any other.
//!
//! The job of each time is called `NAME-YYMMDDhhmm`, so that whatever fails in between, a time is never
//! carried out twice.

mod time;

use super::{
    Fleet, error_reply,
    event::{Effect, ReplyTo, Table, Write},
    pattern::Pattern,
};
use crate::job::parse;
use keys::{
    FleetMicros, GroupId, JobId, NodeId,
    record::{ErrorCode, JobError, to_json},
};
use serde::{Deserialize, Serialize, de::DeserializeOwned};
use serde_json::Value;
use std::collections::BTreeMap;
use time::{DAY_US, minute_of, time_of_day_us};

/// Templates and schedules that can be kept, of each kind.
pub const KEPT_MAX: usize = 256;

/// Longest template and longest job of a schedule, bytes.
pub const KEPT_BYTES_MAX: usize = 256 << 10;

/// Shortest time between two jobs of a schedule, s: the jobs' names have minutes.
pub const EVERY_S_MIN: u64 = 60;

/// Longest, s: a year.
pub const EVERY_S_MAX: u64 = 366 * 86_400;

/// Longest name of a schedule: its jobs' names are eleven characters longer.
pub const SCHEDULE_NAME_MAX: usize = keys::ids::NAME_BYTES_MAX - 11;

/// A time that is later than this is missed, µs: the machine has slept.
pub const LATE_US_MAX: u64 = 60_000_000;

/// What is kept.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
    /// Text to be filled in.
    Template,
    /// A job and its times.
    Schedule,
}

impl Kind {
    const fn as_str(self) -> &'static str {
        match self {
            Self::Template => "template",
            Self::Schedule => "schedule",
        }
    }
}

/// A job to be filled in.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Template {
    /// The text, with `${NAME}` where values go.
    pub text: String,
    /// `json`, `lua` or `gcode`.
    pub format: String,
    /// What it is for.
    #[serde(default)]
    pub about: String,
}

/// What a client says of a schedule.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct Wish {
    /// A node's name, a wild chunk, or `@LABEL`.
    target: String,
    /// The job, without an id.
    job: Value,
    every_s: Option<u64>,
    /// `05:00`.
    daily: Option<String>,
    /// The first time, RFC 3339.
    from: Option<String>,
}

/// A job and its times.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Schedule {
    /// A node's name, a wild chunk, or `@LABEL`.
    pub target: String,
    /// The job in JSON.
    pub job: Value,
    /// Time from one to the next, s.
    pub every_s: u64,
    /// When the next one is due, µs.
    pub next_us: u64,
    /// How many were handed in.
    #[serde(default)]
    pub done: u64,
    /// How many were left out.
    #[serde(default)]
    pub missed: u64,
    /// The name of the last job that was handed in.
    #[serde(default)]
    pub last: Option<String>,
}

impl Schedule {
    /// Returns when the next one is due.
    pub const fn next(&self) -> FleetMicros {
        FleetMicros(self.next_us)
    }

    /// Leaves out what was due before `now`; returns whether there was something.
    fn skip_to(&mut self, now: FleetMicros) -> bool {
        let every_us = self.every_s * 1_000_000;
        let late = (now.0 >= self.next_us).then(|| (now.0 - self.next_us) / every_us + 1);
        let skipped = late.unwrap_or(0);
        self.missed = self.missed.saturating_add(skipped);
        self.next_us += skipped * every_us;
        skipped > 0
    }
}

/// Everything that is kept, by name.
#[derive(Debug, Default)]
pub(super) struct Kept {
    templates: BTreeMap<GroupId, Template>,
    schedules: BTreeMap<GroupId, Schedule>,
}

impl Kept {
    /// Returns when the next job is due.
    pub(super) fn next(&self) -> Option<FleetMicros> {
        self.schedules.values().map(Schedule::next).min()
    }
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Removal {
    remove: bool,
}

fn bad(message: impl std::fmt::Display) -> JobError {
    JobError::new(ErrorCode::BadJson, message.to_string())
}

fn read<T: DeserializeOwned>(payload: &[u8]) -> Result<T, JobError> {
    serde_json::from_slice(payload).map_err(bad)
}

fn stored_name(kind: Kind, name: &GroupId) -> String {
    format!("{}/{name}", kind.as_str())
}

fn put<T: Serialize>(kind: Kind, name: &GroupId, value: &T) -> Effect {
    Effect::Persist(Write::Put {
        table: Table::Kept,
        key: stored_name(kind, name),
        value: to_json(value),
    })
}

impl Fleet {
    /// Keeps, shows or removes a template or a schedule.
    pub(super) fn keep(
        &mut self,
        kind: Kind,
        pattern: &str,
        payload: &[u8],
        to: ReplyTo,
        effects: &mut Vec<Effect>,
    ) {
        let outcome = if payload.is_empty() {
            Ok(())
        } else if payload.len() > KEPT_BYTES_MAX {
            let message = format!("at most {KEPT_BYTES_MAX} bytes can be kept");
            Err(JobError::new(ErrorCode::TooLarge, message))
        } else if read::<Removal>(payload).is_ok_and(|removal| removal.remove) {
            self.remove_kept(kind, pattern, effects)
        } else {
            self.change_kept(kind, pattern, payload, effects)
        };
        match outcome {
            Ok(()) => self.show_kept(kind, pattern, payload.is_empty(), to, effects),
            Err(error) => effects.push(error_reply(to, error)),
        }
        effects.push(Effect::ReplyEnd { to });
    }

    fn change_kept(
        &mut self,
        kind: Kind,
        pattern: &str,
        payload: &[u8],
        effects: &mut Vec<Effect>,
    ) -> Result<(), JobError> {
        let name = GroupId::new(pattern)
            .map_err(|error| JobError::new(ErrorCode::BadId, format!("{pattern}: {error}")))?;
        let (count, is_new) = match kind {
            Kind::Template => {
                let kept = &self.kept.templates;
                (kept.len(), !kept.contains_key(&name))
            }
            Kind::Schedule => {
                let kept = &self.kept.schedules;
                (kept.len(), !kept.contains_key(&name))
            }
        };
        if is_new && count >= KEPT_MAX {
            let message = format!("{count} are kept already; no more can be");
            return Err(JobError::new(ErrorCode::TooLarge, message));
        }
        match kind {
            Kind::Template => {
                let template: Template = read(payload)?;
                if !["json", "lua", "gcode"].contains(&template.format.as_str()) {
                    return Err(bad("format: json, lua or gcode"));
                }
                effects.push(put(kind, &name, &template));
                self.kept.templates.insert(name, template);
            }
            Kind::Schedule => {
                let schedule = self.schedule_of(&name, &read(payload)?)?;
                effects.push(put(kind, &name, &schedule));
                self.kept.schedules.insert(name, schedule);
            }
        }
        Ok(())
    }

    fn schedule_of(&self, name: &GroupId, wish: &Wish) -> Result<Schedule, JobError> {
        if name.as_str().len() > SCHEDULE_NAME_MAX {
            let message = format!("the name of a schedule has at most {SCHEDULE_NAME_MAX} letters");
            return Err(JobError::new(ErrorCode::BadId, message));
        }
        if self.config.signers.is_some() {
            let message = "an operator has to sign what is executed here, and nobody is there to \
                           sign the job of a schedule";
            return Err(JobError::new(ErrorCode::NotAllowed, message));
        }
        match Pattern::new(&wish.target) {
            Pattern::Malformed(_) => return Err(bad("target: a node, a pattern or @LABEL")),
            Pattern::Name(target) => {
                let known = NodeId::new(target).is_ok_and(|id| self.nodes.contains_key(&id));
                if !known {
                    return Err(self.nobody(target));
                }
            }
            Pattern::Wild(_) | Pattern::Label(_) => {}
        }
        if wish.job.get("id").is_some() {
            return Err(bad("job.id: each job of a schedule gets a name of its own"));
        }
        let text = to_json(&wish.job);
        parse::parse("application/json", &text).request?;
        let at = |text: &String| {
            let at = FleetMicros::from_rfc3339(text);
            at.ok_or_else(|| bad(format!("`{text}` is no time in UTC: 2026-11-22T03:00:00Z")))
        };
        let from = wish.from.as_ref().map(at).transpose()?;
        let (every_s, first) = match (wish.every_s, &wish.daily) {
            (Some(every_s), None) if (EVERY_S_MIN..=EVERY_S_MAX).contains(&every_s) => {
                let first = from.unwrap_or(self.now.plus_us(every_s * 1_000_000));
                (every_s, first)
            }
            (Some(_), None) => {
                return Err(bad(format!("every_s: {EVERY_S_MIN} to {EVERY_S_MAX}")));
            }
            (None, Some(daily)) => {
                let of_day_us = time_of_day_us(daily)
                    .ok_or_else(|| bad(format!("daily: `{daily}` is no time of day: 05:00")))?;
                let day = from.unwrap_or(self.now).0 / DAY_US;
                (86_400, FleetMicros(day * DAY_US + of_day_us))
            }
            _ => return Err(bad("either `every_s` or `daily`")),
        };
        let mut schedule = Schedule {
            target: wish.target.clone(),
            job: wish.job.clone(),
            every_s,
            next_us: first.0,
            done: 0,
            missed: 0,
            last: None,
        };
        schedule.skip_to(self.now);
        schedule.missed = 0;
        Ok(schedule)
    }

    fn remove_kept(
        &mut self,
        kind: Kind,
        pattern: &str,
        effects: &mut Vec<Effect>,
    ) -> Result<(), JobError> {
        let name = GroupId::new(pattern).ok();
        let removed = name.filter(|name| match kind {
            Kind::Template => self.kept.templates.remove(name).is_some(),
            Kind::Schedule => self.kept.schedules.remove(name).is_some(),
        });
        let name = removed.ok_or_else(|| no_such(kind, pattern))?;
        effects.push(Effect::Persist(Write::Remove {
            table: Table::Kept,
            key: stored_name(kind, &name),
        }));
        Ok(())
    }

    fn show_kept(
        &self,
        kind: Kind,
        pattern: &str,
        asked: bool,
        to: ReplyTo,
        effects: &mut Vec<Effect>,
    ) {
        let meant = Pattern::new(pattern);
        let before = effects.len();
        let mut show = |name: &GroupId, mut value: Value| {
            value["name"] = name.as_str().into();
            effects.push(Effect::Reply {
                to,
                key: Some(format!(
                    "{}/manage/{}/{name}",
                    self.config.keys.prefix(),
                    kind.as_str()
                )),
                payload: to_json(&value),
            });
        };
        let shown = "texts, numbers and lists of them";
        match kind {
            Kind::Template => {
                let meant = |name: &&GroupId| meant.matches(name.as_str());
                for name in self.kept.templates.keys().filter(meant) {
                    let value = serde_json::to_value(&self.kept.templates[name]);
                    show(name, value.expect(shown));
                }
            }
            Kind::Schedule => {
                for (name, schedule) in &self.kept.schedules {
                    if meant.matches(name.as_str()) {
                        let mut value = serde_json::to_value(schedule).expect(shown);
                        value["next"] = schedule.next().to_string().into();
                        show(name, value);
                    }
                }
            }
        }
        if asked && effects.len() == before && matches!(meant, Pattern::Name(_)) {
            effects.push(error_reply(to, no_such(kind, pattern)));
        }
    }

    /// Hands in the jobs whose time has come.
    pub(super) fn run_schedules(&mut self, effects: &mut Vec<Effect>) {
        while let Some(name) = self.due_schedule() {
            let at = self.kept.schedules[&name].next();
            let stem = format!("{name}-{}", minute_of(at));
            let schedule = &self.kept.schedules[&name];
            let late = self.now.since_us(at) > LATE_US_MAX;
            let busy = late
                || schedule
                    .last
                    .as_ref()
                    .is_some_and(|last| self.is_open(last));
            let (target, text) = (schedule.target.clone(), to_json(&schedule.job));
            let now = self.now;
            let schedule = self.kept.schedules.get_mut(&name).expect("it is due");
            schedule.next_us += schedule.every_s * 1_000_000;
            if busy {
                schedule.missed = schedule.missed.saturating_add(1);
            } else {
                schedule.done = schedule.done.saturating_add(1);
                schedule.last = Some(stem.clone());
            }
            // What is left over after a pause of the machine itself.
            schedule.skip_to(now);
            effects.push(put(Kind::Schedule, &name, &*schedule));
            if busy {
                continue;
            }
            let id = JobId::new(&stem).ok();
            let request = parse::parse("application/json", &text).request;
            let request = request.map(|request| keys::job::JobRequest { id, ..request });
            self.submit(&target, request, id, None, effects);
        }
    }

    fn due_schedule(&self) -> Option<GroupId> {
        let due = self.kept.schedules.iter();
        due.filter(|(_, schedule)| schedule.next() <= self.now)
            .map(|(name, _)| *name)
            .next()
    }

    /// Returns whether the job of this name, or one of its nodes' jobs, has not ended.
    fn is_open(&self, stem: &str) -> bool {
        self.book.newest_first().any(|job| {
            let id = job.id();
            let rest = id.as_str().strip_prefix(stem);
            !job.state().is_final()
                && rest.is_some_and(|rest| rest.is_empty() || rest.starts_with('-'))
        })
    }

    /// Takes what was kept; what was due while nobody was there is left out.
    ///
    /// # Errors
    /// What is wrong with it.
    pub(super) fn restore_kept(
        &mut self,
        key: &str,
        value: &[u8],
        effects: &mut Vec<Effect>,
    ) -> Result<(), String> {
        let (kind, name) = key.split_once('/').ok_or("it has no kind")?;
        let name = GroupId::new(name).map_err(|error| error.to_string())?;
        match kind {
            "template" => {
                let template = serde_json::from_slice(value).map_err(|error| error.to_string())?;
                self.kept.templates.insert(name, template);
            }
            "schedule" => {
                let mut schedule: Schedule =
                    serde_json::from_slice(value).map_err(|error| error.to_string())?;
                if !(EVERY_S_MIN..=EVERY_S_MAX).contains(&schedule.every_s) {
                    return Err("its times are too near to each other, or too far apart".to_owned());
                }
                if schedule.skip_to(self.now) {
                    effects.push(put(Kind::Schedule, &name, &schedule));
                }
                self.kept.schedules.insert(name, schedule);
            }
            other => return Err(format!("its kind `{other}` is not known")),
        }
        Ok(())
    }
}

fn no_such(kind: Kind, pattern: &str) -> JobError {
    JobError::new(
        ErrorCode::BadId,
        format!("no {} `{pattern}`", kind.as_str()),
    )
}
