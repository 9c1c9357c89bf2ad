//! Meeting points of scripts, which are known only when a script comes to one.
//!
//! ```text
//!   node: ReadyAt "layer-2" ─▶ known? ─ no ─▶ a seat for every part that is a script
//!                                │                        │
//!                                └─ yes ──────────────────┴─▶ like any other meeting point
//! ```
//!
//! Who takes part: every part whose list has the name, and every part that is a script. It fails
//! clearly, and with it the job,
//!
//! - when a script ends without coming to it, or no other part can come;
//! - when every part waits, and none for another one at the same place.
//!
//! A name that several lists have and no script comes to is theirs alone; they wait until the scripts
//! have ended, because one might still come.
//!
//! Whoever waits at a barrier says so again and again, so a gateway that starts anew learns the names
//! anew. Only a plan needs them in the store: a node that is past its barrier does not say its name.

use super::{
    FleetMicros, Start, Step,
    meeting::{Meeting, Phase, Seat, Stage, not_ready},
};
use keys::{NodeId, record::JobError, start::StartMessage};
use serde::{Deserialize, Serialize};
use std::collections::{BTreeMap, BTreeSet};

/// What is stored of a meeting point to which scripts have come.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct NamedMeeting {
    /// Its name.
    pub name: String,
    /// Where in the part of each script it is, counted as a part's commands are.
    pub indices: BTreeMap<NodeId, u64>,
}

/// The parts that are scripts, and where they may meet.
#[derive(Clone, Debug, Default)]
pub(super) struct Scripts {
    nodes: BTreeSet<NodeId>,
    /// How many parts the job has, with those that are no scripts.
    part_count: usize,
    ended: BTreeSet<NodeId>,
    /// Every name that was heard, also when the meeting is over.
    numbers: BTreeMap<String, u16>,
}

impl Start {
    /// Takes which parts are scripts, what the lists call their meeting points, and those that
    /// scripts had come to before the gateway's start.
    #[must_use]
    pub fn with_scripts(
        mut self,
        nodes: &BTreeSet<NodeId>,
        names: &BTreeMap<String, u16>,
        named: &BTreeMap<u16, NamedMeeting>,
        planned: &BTreeMap<u16, FleetMicros>,
    ) -> Self {
        if nodes.is_empty() {
            return self;
        }
        self.scripts.nodes.clone_from(nodes);
        self.scripts.part_count = self.ways.len();
        for (name, number) in names {
            self.add_script_seats(name, *number, None);
        }
        for (number, stored) in named {
            self.add_script_seats(&stored.name, *number, planned.get(number).copied());
            for (node, index) in &stored.indices {
                // Its place follows when the part is known to be on its way.
                let way = self.ways.entry(*node).or_default();
                way.push_back((*index, *number));
                way.make_contiguous().sort_unstable();
            }
        }
        self
    }

    /// Returns what must be stored of a meeting point with its plan; `None` if no script takes part.
    pub fn named(&self, number: u16) -> Option<NamedMeeting> {
        let meeting = self.meetings.get(&number)?;
        let scripts = meeting.seats.iter().filter(|(_, seat)| seat.script);
        let indices: BTreeMap<NodeId, u64> = scripts
            .filter_map(|(node, seat)| {
                let (_, base) = self.bases.get(node)?;
                Some((*node, seat.place?.1 - base))
            })
            .collect();
        (!indices.is_empty()).then(|| NamedMeeting {
            name: meeting.name.clone(),
            indices,
        })
    }

    /// Returns the largest skew that a meeting is promised, µs.
    pub fn max_skew_us(&self, number: u16) -> Option<f64> {
        Some(self.meetings.get(&number)?.limits.max_skew_us)
    }

    /// Returns whether this is a script of this job that comes to a meeting point.
    pub(super) fn may_name(&self, node: NodeId, message: &StartMessage) -> bool {
        self.named_index(node, message).is_some()
    }

    /// A script says where it waits: the first time it gets its place.
    pub(super) fn hear_name(&mut self, node: NodeId, message: &StartMessage) {
        let StartMessage::ReadyAt {
            queue,
            command,
            name,
        } = message
        else {
            return;
        };
        let Some(index) = self.named_index(node, message) else {
            return;
        };
        let number = match self.scripts.numbers.get(name.as_str()) {
            Some(number) => *number,
            None => {
                let last = self.scripts.numbers.values().max().copied().unwrap_or(0);
                // Scripts have far fewer barriers together.
                let Some(number) = last.checked_add(1) else {
                    return;
                };
                self.add_script_seats(name.as_str(), number, None);
                number
            }
        };
        // Nothing to take if the meeting is over.
        let meeting = self.meetings.get_mut(&number);
        let seat = meeting.and_then(|meeting| meeting.seats.get_mut(&node));
        if let Some(seat) = seat.filter(|seat| seat.place.is_none()) {
            seat.place = Some((*queue, *command));
            self.ways
                .entry(node)
                .or_default()
                .push_back((index, number));
        }
    }

    /// A part has ended well: it comes to no other meeting point.
    pub(super) fn note_ended(&mut self, node: NodeId) {
        if !self.scripts.nodes.contains(&node) || !self.scripts.ended.insert(node) {
            return;
        }
        for (number, meeting) in &mut self.meetings {
            if let Some(seat) = meeting.seats.get_mut(&node)
                && seat.script
                && seat.stage == Stage::Coming
            {
                seat.absent = true;
                self.open.insert(*number);
            }
        }
    }

    /// Every part waits, and nowhere are all who are needed: none will ever go on.
    pub(super) fn find_deadlock(&mut self, now: FleetMicros) -> Option<(u16, Step)> {
        if self.scripts.nodes.is_empty() {
            return None;
        }
        let mut waiting: BTreeMap<NodeId, u16> = BTreeMap::new();
        for (number, meeting) in &self.meetings {
            if *number == 0 || !matches!(meeting.phase, Phase::Gathering) {
                continue;
            }
            if meeting
                .seats
                .values()
                .all(|seat| seat.stage != Stage::Coming)
            {
                return None;
            }
            let ready = meeting
                .seats
                .iter()
                .filter(|(_, seat)| seat.stage == Stage::Ready);
            waiting.extend(ready.map(|(node, _)| (*node, *number)));
        }
        let all = self.ways.keys().all(|node| waiting.contains_key(node));
        let number = *waiting.values().next().filter(|_| all)?;
        let reasons = waiting.iter().map(|(node, at)| {
            let name = &self.meetings[at].name;
            let words =
                format!("it waits at barrier `{name}`, and every other part somewhere else");
            (*node, not_ready(words))
        });
        let reasons = reasons.collect();
        let meeting = self.meetings.get_mut(&number)?;
        Some((number, meeting.fail(reasons, now)))
    }

    /// Returns where in its part a script waits, if the message says so.
    fn named_index(&self, node: NodeId, message: &StartMessage) -> Option<u64> {
        let StartMessage::ReadyAt { queue, command, .. } = message else {
            return None;
        };
        let here = self.scripts.nodes.contains(&node) && !self.scripts.ended.contains(&node);
        let (of, base) = *self.bases.get(&node).filter(|_| here)?;
        let index = command.checked_sub(base)?;
        (of == *queue && index > 0).then_some(index)
    }

    /// Gives every script a seat at a meeting point, which is made if there is none.
    fn add_script_seats(&mut self, name: &str, number: u16, planned: Option<FleetMicros>) {
        self.scripts.numbers.insert(name.to_owned(), number);
        let limits = self.limits;
        let meeting = self.meetings.entry(number);
        let meeting = meeting.or_insert_with(|| Meeting::new(limits, planned));
        name.clone_into(&mut meeting.name);
        for node in &self.scripts.nodes {
            meeting.seats.entry(*node).or_insert_with(|| Seat {
                script: true,
                absent: self.scripts.ended.contains(node),
                ..Seat::new(0)
            });
        }
        meeting.alone = meeting.seats.len() == 1 && self.scripts.part_count > 1;
    }
}

impl Meeting {
    /// Deals with scripts that do not come: returns why the meeting fails for it, or goes on without
    /// them.
    pub(super) fn take_absent(&mut self) -> Option<Vec<(NodeId, JobError)>> {
        if !matches!(self.phase, Phase::Gathering) {
            return None;
        }
        let name = &self.name;
        let came = |seat: &Seat| seat.script && seat.place.is_some();
        if self.alone && self.seats.values().any(came) {
            let words = format!("no other part comes to barrier `{name}`");
            let seats = self.seats.keys();
            return Some(
                seats
                    .map(|node| (*node, not_ready(words.as_str())))
                    .collect(),
            );
        }
        let absent = self.seats.iter().filter(|(_, seat)| seat.absent);
        let absent: Vec<NodeId> = absent.map(|(node, _)| *node).collect();
        if absent.is_empty() {
            return None;
        }
        let lists = self.seats.values().filter(|seat| !seat.script).count();
        if lists < 2 || self.seats.values().any(came) {
            let words = format!("the script ended without coming to barrier `{name}`");
            let reasons = absent.iter();
            return Some(
                reasons
                    .map(|node| (*node, not_ready(words.as_str())))
                    .collect(),
            );
        }
        if self.seats.values().all(|seat| seat.script == seat.absent) {
            self.seats.retain(|_, seat| !seat.absent);
        }
        None
    }
}
