//! Hold, resume and speed of a node: what clients want, until the node says that it is so.
//!
//! ```text
//!   client ─▶ wish ── Set, again and again ──▶ node
//!               ▲                               │
//!               └── as wished: receipts ◀─ Told ┘   not in time: an error reply
//! ```
//!
//! Whether it is held is the node's own knowledge: nothing of it is stored here, and a gateway that
//! starts anew asks. A wish names the last change that the node has told, so one that is late or
//! comes twice does nothing.

use super::{Node, Released, Turn};
use crate::fleet::event::{Lane, ReplyTo};
use keys::{
    Features, FleetMicros, NodeTopic,
    pace::PaceMessage,
    record::{ErrorCode, JobError, PaceReceipt, PaceRecord, to_json},
};

/// Gets that may wait for one change.
const WAITERS_MAX: usize = 64;

/// How long a node may take to do what is wished, µs. A start that is agreed comes first.
const PATIENCE_US: u64 = 3_000_000;

/// What a client wants. At least one of both.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Wish {
    /// Rest on the path, or go on.
    pub hold: Option<bool>,
    /// Speed, percent.
    pub percent: Option<u16>,
}

impl Wish {
    fn is_so(self, pace: PaceRecord) -> bool {
        self.hold.is_none_or(|hold| hold == pace.hold)
            && self.percent.is_none_or(|percent| percent == pace.percent)
    }
}

/// A wish that is not fulfilled.
#[derive(Clone, Debug)]
struct OpenWish {
    wish: Wish,
    give_up_at: FleetMicros,
    send_at: FleetMicros,
    waiters: Vec<ReplyTo>,
}

/// What is known and wanted of a node's pace.
#[derive(Clone, Debug, Default)]
pub(super) struct Pace {
    /// The last that it told of its present boot: the number of the change, and how it is.
    told: Option<(u32, PaceRecord)>,
    wish: Option<OpenWish>,
    /// The number of the change that was said last: until another one is told, a word may be on its way.
    said: Option<u32>,
    /// When it is asked again, while nothing is known.
    ask_at: Option<FleetMicros>,
}

impl Node {
    /// Somebody wants it held, resumed, or at another speed.
    pub(in crate::fleet) fn handle_wish(
        &mut self,
        wish: Wish,
        reply: Option<ReplyTo>,
        turn: &mut Turn<'_>,
    ) {
        let id = self.id;
        let refusal = if !self.facts.features.has(Features::PACE) {
            let message = format!("the firmware of node {id} cannot be held");
            Some(JobError::new(ErrorCode::NotAllowed, message))
        } else if wish.hold.is_some() && self.is_stopped() {
            let message = format!("node {id} is stopped; release it first");
            Some(JobError::new(ErrorCode::Stopped, message))
        } else {
            None
        };
        if let Some(error) = refusal {
            turn.released
                .extend(reply.map(|to| Released::refused(to, error)));
            return;
        }
        let open = self.pace.wish.get_or_insert_with(|| OpenWish {
            wish: Wish::default(),
            give_up_at: turn.now,
            send_at: turn.now,
            waiters: Vec::new(),
        });
        // The last word counts.
        open.wish = Wish {
            hold: wish.hold.or(open.wish.hold),
            percent: wish.percent.or(open.wish.percent),
        };
        open.give_up_at = turn.now.plus_us(PATIENCE_US);
        open.send_at = turn.now;
        match reply {
            Some(to) if open.waiters.len() >= WAITERS_MAX => {
                let message = format!("too many wait for an answer of node {id}");
                let error = JobError::new(ErrorCode::TooLarge, message);
                turn.released.push(Released::refused(to, error));
            }
            reply => open.waiters.extend(reply),
        }
    }

    /// The node told how it is, or the gateway's own words came back.
    pub(in crate::fleet) fn handle_pace(&mut self, message: PaceMessage, turn: &mut Turn<'_>) {
        let PaceMessage::Told {
            boot,
            change,
            hold,
            percent,
        } = message
        else {
            return;
        };
        if !self.alive || boot != self.facts.queue.boot {
            return;
        }
        let known = self.pace.told.map(|(known, _)| known);
        if known.is_some_and(|known| change.wrapping_sub(known) > u32::MAX / 2) {
            // It comes late.
            return;
        }
        let pace = PaceRecord { hold, percent };
        self.pace.told = Some((change, pace));
        self.stale_record = true;
        if known != Some(change)
            && let Some(open) = &mut self.pace.wish
        {
            open.send_at = turn.now;
        }
    }

    /// Another boot, or it is gone: nothing is known.
    pub(super) fn forget_pace(&mut self) {
        self.pace.told = None;
        self.pace.said = None;
        self.pace.ask_at = None;
    }

    /// Nobody who waits will get what was wished.
    pub(super) fn refuse_wish(&mut self, code: ErrorCode, message: &str, turn: &mut Turn<'_>) {
        for to in self
            .pace
            .wish
            .take()
            .into_iter()
            .flat_map(|open| open.waiters)
        {
            let error = JobError::new(code, message);
            turn.released.push(Released::refused(to, error));
        }
    }

    /// Says what is due.
    pub(super) fn say_pace(&mut self, turn: &mut Turn<'_>) {
        if !self.knows_pace() {
            return self.give_up_wish(turn);
        }
        let again_at = turn.now.plus_us(self.round_trip.retry_us());
        let Some((change, pace)) = self.pace.told else {
            if self.pace.ask_at.is_none_or(|at| turn.now >= at) {
                self.pace.ask_at = Some(again_at);
                self.say_pace_message(&PaceMessage::Ask, turn);
            }
            return self.give_up_wish(turn);
        };
        let Some(open) = &mut self.pace.wish else {
            return;
        };
        // A word of somebody else that is still on its way could undo it.
        if open.wish.is_so(pace) && self.pace.said != Some(change) {
            let receipt = PaceReceipt {
                node: self.id,
                pace,
            };
            for to in self
                .pace
                .wish
                .take()
                .into_iter()
                .flat_map(|open| open.waiters)
            {
                turn.released.push(Released {
                    to,
                    outcome: Ok(()),
                    receipt: Some(to_json(&receipt)),
                });
            }
            return;
        }
        if turn.now >= open.send_at {
            open.send_at = again_at;
            self.pace.said = Some(change);
            let set = PaceMessage::Set {
                boot: self.facts.queue.boot,
                change,
                hold: open.wish.hold,
                percent: open.wish.percent,
            };
            self.say_pace_message(&set, turn);
        }
        self.give_up_wish(turn);
    }

    fn give_up_wish(&mut self, turn: &mut Turn<'_>) {
        let late = |open: &OpenWish| turn.now >= open.give_up_at;
        if self.pace.wish.as_ref().is_some_and(late) {
            let message = "the node did not do it in time: a start is agreed, or it comes to rest";
            self.refuse_wish(ErrorCode::NotAllowed, message, turn);
        }
    }

    fn say_pace_message(&self, message: &PaceMessage, turn: &mut Turn<'_>) {
        let mut buffer = [0; 32];
        let bytes = keys::version::encode(message, &mut buffer)
            .expect("a message about the pace has at most 18 bytes");
        turn.tell(
            &self.facts,
            &self.id,
            NodeTopic::Pace,
            bytes,
            Lane::RealTime,
        );
    }

    /// Returns when [`Node::say_pace`] is due.
    pub(super) fn pace_timeout(&self) -> Option<FleetMicros> {
        let wish = self.pace.wish.as_ref();
        let says_at = match self.pace.told {
            _ if !self.knows_pace() => None,
            None => Some(self.pace.ask_at.unwrap_or(FleetMicros(0))),
            Some(_) => wish.map(|open| open.send_at),
        };
        let give_up_at = wish.map(|open| open.give_up_at);
        [says_at, give_up_at].into_iter().flatten().min()
    }

    /// Returns whether its firmware takes words about the pace.
    fn knows_pace(&self) -> bool {
        self.status.is_some() && self.facts.features.has(Features::PACE)
    }

    /// Returns what clients see of it.
    pub(super) fn pace_record(&self) -> Option<PaceRecord> {
        self.pace.told.map(|(_, pace)| pace)
    }
}
