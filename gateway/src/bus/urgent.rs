//! What goes ahead of everything else: stops, the releases behind them, and nodes that are gone.
//!
//! A stop means the same however often it is said: one that waits already takes the next one for the
//! same nodes in. So a flood of stops costs the fleet no more than the nodes that it names, and cannot
//! fill the queue for others. What says "stop" in more than [`STOPS_WAITING_MAX`] ways at once has
//! stopped everybody: a stop is never dropped.
//!
//! A release keeps its place among the stops: it lifts those that came before it, and none that came
//! behind.
//!
//! [`Intake`] gives stops their turn before other events, and other events theirs: whatever floods, after
//! [`IN_A_ROW_MAX`] of its kind the others come.

use super::{Arrived, Full};
use crate::fleet::event::Event;
use keys::{NodeId, StopMode};
use std::{
    collections::{HashMap, HashSet, VecDeque},
    sync::{Arc, Mutex, MutexGuard, PoisonError},
};
use tokio::sync::{Notify, mpsc};

/// Stops of different nodes that wait: about as many as there can be nodes. One more makes them a
/// stop of all.
pub const STOPS_WAITING_MAX: usize = 4_096;

/// Releases that wait.
pub const RELEASES_WAITING_MAX: usize = 1_024;

/// Nodes that are gone and wait for somebody to notice.
pub const GONE_WAITING_MAX: usize = 4_096;

/// Stops that are handled before other events get a turn, and other events before stops do.
pub const IN_A_ROW_MAX: u32 = 64;

/// Longest pattern of nodes: what has more than every second byte of the longest name wild matches none.
const PATTERN_BYTES_MAX: usize = 256;

/// What waits, in order.
#[derive(Debug, Default)]
struct Waiting {
    entries: VecDeque<Event>,
    /// Number of the first entry.
    first: u64,
    /// Stops behind the last release, by whom they mean: the number of the entry.
    stops: HashMap<String, u64>,
    /// All stops.
    stop_count: usize,
    release_count: usize,
    gone: HashSet<NodeId>,
}

impl Waiting {
    fn stop(&mut self, pattern: String, mode: StopMode) {
        if pattern.len() > PATTERN_BYTES_MAX {
            return;
        }
        if let Some(number) = self.stops.get(&pattern) {
            let index = (number - self.first) as usize;
            if let Some(Event::Stop { mode: waits, .. }) = self.entries.get_mut(index)
                && mode == StopMode::Halt
            {
                *waits = mode;
            }
            return;
        }
        if self.stop_count >= STOPS_WAITING_MAX {
            return self.stop_all();
        }
        self.push_stop(pattern, mode);
    }

    fn push_stop(&mut self, pattern: String, mode: StopMode) {
        let number = self.first + self.entries.len() as u64;
        self.stops.insert(pattern.clone(), number);
        self.stop_count += 1;
        self.entries.push_back(Event::Stop { pattern, mode });
    }

    /// Makes one stop of all of all that wait. It stands last, behind every release.
    fn stop_all(&mut self) {
        self.entries
            .retain(|event| !matches!(event, Event::Stop { .. }));
        self.stops.clear();
        self.stop_count = 0;
        self.push_stop("*".to_owned(), StopMode::Halt);
    }

    fn release(&mut self, release: Event) -> Result<(), Full> {
        if self.release_count >= RELEASES_WAITING_MAX {
            return Err(Full);
        }
        self.release_count += 1;
        self.stops.clear();
        self.entries.push_back(release);
        Ok(())
    }

    fn gone(&mut self, node: NodeId) -> Result<(), Full> {
        if self.gone.len() >= GONE_WAITING_MAX {
            return Err(Full);
        }
        if self.gone.insert(node) {
            let alive = false;
            self.entries.push_back(Event::Alive { node, alive });
        }
        Ok(())
    }

    fn take(&mut self) -> Option<Event> {
        let event = self.entries.pop_front()?;
        match &event {
            Event::Stop { pattern, .. } => {
                self.stop_count -= 1;
                if self.stops.get(pattern) == Some(&self.first) {
                    self.stops.remove(pattern);
                }
            }
            Event::Alive { node, .. } => {
                self.gone.remove(node);
            }
            _ => self.release_count -= 1,
        }
        self.first += 1;
        Some(event)
    }
}

/// The lane itself. Cheap to clone.
#[derive(Clone, Debug, Default)]
pub struct Urgent {
    waiting: Arc<Mutex<Waiting>>,
    came: Arc<Notify>,
}

impl Urgent {
    fn waiting(&self) -> MutexGuard<'_, Waiting> {
        self.waiting.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Takes a stop.
    pub(super) fn stop(&self, pattern: String, mode: StopMode) {
        self.waiting().stop(pattern, mode);
        self.came.notify_one();
    }

    /// Takes a release, whose place is behind the stops that came before it.
    ///
    /// # Errors
    /// [`Full`]: whoever waits for a reply has to be told.
    pub(super) fn release(&self, release: Event) -> Result<(), Full> {
        self.waiting().release(release)?;
        self.came.notify_one();
        Ok(())
    }

    /// Takes a node whose token is gone.
    ///
    /// # Errors
    /// [`Full`]: it will show by its silence.
    pub(super) fn gone(&self, node: NodeId) -> Result<(), Full> {
        self.waiting().gone(node)?;
        self.came.notify_one();
        Ok(())
    }

    /// Gives what waits longest.
    async fn take(&self) -> Event {
        loop {
            let came = self.came.notified();
            // Taken out before anything is waited for: the lock must not be held so long.
            let event = self.waiting().take();
            match event {
                Some(event) => return event,
                None => came.await,
            }
        }
    }
}

/// What the fleet is given next.
#[derive(Debug)]
pub struct Intake {
    urgent: Urgent,
    events: mpsc::Receiver<Arrived>,
    /// Whose turn it is first: the urgent, or the others.
    others_first: bool,
    in_a_row: u32,
}

impl Intake {
    /// Takes from both.
    pub(super) fn new(urgent: Urgent, events: mpsc::Receiver<Arrived>) -> Self {
        Self {
            urgent,
            events,
            others_first: false,
            in_a_row: 0,
        }
    }

    /// Gives the next event, of those that wait.
    ///
    /// # Cancellation safety
    /// May be dropped and called again; nothing is lost.
    pub async fn next(&mut self) -> Arrived {
        let (arrived, is_urgent) = tokio::select! {
            biased;
            event = self.urgent.take(), if !self.others_first => (event.into(), true),
            Some(arrived) = self.events.recv() => (arrived, false),
            event = self.urgent.take(), if self.others_first => (event.into(), true),
        };
        if is_urgent == self.others_first {
            // The others had nothing: the turn is this one's.
            self.in_a_row = 0;
            self.others_first = false;
        }
        if is_urgent != self.others_first {
            self.in_a_row += 1;
        }
        if self.in_a_row >= IN_A_ROW_MAX {
            self.in_a_row = 0;
            self.others_first = !self.others_first;
        }
        arrived
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn stop(lane: &Urgent, pattern: &str) {
        lane.stop(pattern.to_owned(), StopMode::Decelerate);
    }

    fn release(pattern: &str) -> Event {
        Event::Release {
            pattern: pattern.to_owned(),
            reply: None,
        }
    }

    /// Everything that waits, in words.
    fn waiting(lane: &Urgent) -> Vec<String> {
        let mut all = Vec::new();
        while let Some(event) = lane.waiting().take() {
            all.push(match event {
                Event::Stop { pattern, mode } => format!("stop {pattern} {mode:?}"),
                Event::Release { pattern, .. } => format!("release {pattern}"),
                Event::Alive { node, .. } => format!("gone {node}"),
                other => format!("{other:?}"),
            });
        }
        all
    }

    #[test]
    fn a_stop_that_waits_takes_in_the_next_for_the_same_nodes_and_the_harder_one_counts() {
        let lane = Urgent::default();
        for _ in 0..1_000_000 {
            stop(&lane, "left");
        }
        lane.stop("left".into(), StopMode::Halt);
        stop(&lane, "left");
        stop(&lane, "*");
        assert_eq!(waiting(&lane), ["stop left Halt", "stop * Decelerate"]);
        stop(&lane, "left");
        assert_eq!(waiting(&lane), ["stop left Decelerate"], "a new one");
    }

    #[test]
    fn a_release_stays_between_the_stops_that_it_stood_between() {
        let lane = Urgent::default();
        stop(&lane, "left");
        lane.release(release("left")).expect("room");
        stop(&lane, "left");
        stop(&lane, "left");
        let all = [
            "stop left Decelerate",
            "release left",
            "stop left Decelerate",
        ];
        assert_eq!(waiting(&lane), all);
    }

    #[test]
    fn stops_of_more_nodes_than_there_can_be_stop_all_and_releases_before_them_lift_nothing() {
        let lane = Urgent::default();
        for index in 0..STOPS_WAITING_MAX {
            stop(&lane, &format!("node-{index}"));
        }
        lane.release(release("*")).expect("room");
        stop(&lane, "one-more");
        stop(&lane, "*");
        assert_eq!(waiting(&lane), ["release *", "stop * Halt"]);
        for _ in 0..RELEASES_WAITING_MAX {
            lane.release(release("*")).expect("room");
        }
        assert_eq!(lane.release(release("*")), Err(Full));
        stop(&lane, "left");
        assert_eq!(waiting(&lane).len(), RELEASES_WAITING_MAX + 1);
    }

    #[test]
    fn a_node_that_flaps_waits_once_and_a_name_that_matches_nobody_does_not() {
        let lane = Urgent::default();
        let left = NodeId::new("left").expect("legal");
        for _ in 0..2 * GONE_WAITING_MAX {
            lane.gone(left).expect("room");
        }
        stop(&lane, &"x$*".repeat(PATTERN_BYTES_MAX));
        assert_eq!(waiting(&lane), ["gone left"]);
    }

    #[tokio::test]
    async fn a_flood_of_stops_lets_other_events_through_and_a_flood_of_those_a_stop() {
        const EVENTS: usize = 10 * IN_A_ROW_MAX as usize;
        let lane = Urgent::default();
        let (sender, events) = mpsc::channel(2 * EVENTS);
        let mut intake = Intake::new(lane.clone(), events);
        for _ in 0..EVENTS {
            sender.try_send(Event::Tick.into()).expect("room");
        }
        // Whenever the fleet looks, more stops have come than it has handled.
        let mut ticks = 0;
        for round in 0..2 * EVENTS {
            stop(&lane, &format!("node-{round}"));
            stop(&lane, &format!("other-{round}"));
            ticks += usize::from(matches!(intake.next().await.event, Event::Tick));
        }
        assert_eq!(ticks, EVENTS, "half of the turns");

        waiting(&lane);
        for round in 0..2 * EVENTS {
            sender.try_send(Event::Tick.into()).expect("room");
            intake.next().await;
            if round % 7 == 0 {
                stop(&lane, "left");
            }
            let handled = !lane.waiting().stops.contains_key("left");
            assert!(handled || round % 7 < 1, "it waits for one event at most");
        }
    }
}
