//! A route on its own: windows, losses, refusals.

use super::*;
use keys::{AxisId, BatchReader};

const QUEUE: QueueId = QueueId { boot: 7, flush: 1 };
const BASE: u64 = 100;

fn commands(count: usize) -> Vec<Command> {
    (0..count)
        .map(|index| Command::Move {
            axis: AxisId(0),
            delay_us: 100,
            steps: index as i32 + 1,
        })
        .collect()
}

fn route(count: usize) -> (Route, Vec<Command>) {
    let job = JobId::new("a").expect("legal");
    let end = BASE + count as u64;
    let route = Route::new(job, QUEUE, BASE, end, 4, RoundTrip::default());
    (route, commands(count))
}

/// Sends, and returns first number and count of each batch.
fn sent(route: &mut Route, commands: &[Command], limit: u64, now_us: u64) -> Vec<(u64, u64)> {
    let mut sent = Vec::new();
    route.poll(commands, limit, FleetMicros(now_us), |bytes| {
        let mut reader = BatchReader::new(bytes).expect("reads");
        let Order::Batch(header) = *reader.order() else {
            panic!("no batch")
        };
        for number in header.first_command..header.first_command + u64::from(header.command_count) {
            let command = reader.next_command().expect("reads");
            assert_eq!(command, Some(commands[(number - BASE) as usize]));
        }
        sent.push((header.first_command, u64::from(header.command_count)));
    });
    sent
}

#[test]
fn no_more_batches_are_on_their_way_than_the_window_and_no_command_beyond_the_room() {
    let (mut route, commands) = route(10_000);
    let first = sent(&mut route, &commands, u64::MAX, 0);
    assert_eq!(first.len(), 4);
    assert_eq!(sent(&mut route, &commands, u64::MAX, 1), []);
    let has = first[0].0 + first[0].1;
    route.handle_accepted(has, FleetMicros(1_000));
    assert_eq!(sent(&mut route, &commands, u64::MAX, 1_000).len(), 1);

    let (mut route, commands) = self::route(10_000);
    assert_eq!(sent(&mut route, &commands, BASE + 10, 0), [(BASE, 10)]);
    assert_eq!(sent(&mut route, &commands, BASE + 10, 0), []);
    assert_eq!(sent(&mut route, &commands, BASE + 15, 0), [(BASE + 10, 5)]);
}

#[test]
fn an_unanswered_batch_is_sent_again_and_ever_more_slowly() {
    let (mut route, commands) = route(10);
    assert_eq!(sent(&mut route, &commands, u64::MAX, 0), [(BASE, 10)]);
    let mut at = 0;
    let mut waits = Vec::new();
    for _ in 0..6 {
        let due = route.poll_timeout().expect("waits").0;
        assert_eq!(sent(&mut route, &commands, u64::MAX, due - 1), []);
        assert_eq!(sent(&mut route, &commands, u64::MAX, due), [(BASE, 10)]);
        waits.push(due - at);
        at = due;
    }
    assert_eq!(
        waits,
        [200_000, 400_000, 800_000, 1_600_000, 2_000_000, 2_000_000]
    );
}

#[test]
fn one_lost_batch_is_answered_by_going_back_once() {
    let (mut route, commands) = route(10_000);
    let batches = sent(&mut route, &commands, u64::MAX, 0);
    let has = batches[0].0 + batches[0].1;
    route.handle_accepted(has, FleetMicros(1_000));
    // The second one is lost; the third and fourth leave a gap.
    for _ in 0..2 {
        let setback = route.handle_refusal(Refusal::Gap, has, FleetMicros(2_000));
        assert_eq!(setback, Setback::None);
        let again = sent(&mut route, &commands, u64::MAX, 2_000);
        assert!(again.is_empty() || again[0].0 == has, "{again:?}");
    }
    assert_eq!(route.flights.len(), 4);
    assert_eq!(route.flights[0].end, has + batches[1].1);
}

#[test]
fn an_answer_from_the_past_changes_nothing() {
    let (mut route, commands) = route(1_000);
    sent(&mut route, &commands, u64::MAX, 0);
    route.handle_accepted(BASE + 500, FleetMicros(1_000));
    let before = route.next;
    route.handle_accepted(BASE + 100, FleetMicros(2_000));
    let setback = route.handle_refusal(
        Refusal::BadCommand { index: 3 },
        BASE + 100,
        FleetMicros(2_000),
    );
    assert_eq!((setback, route.next), (Setback::None, before));
}

#[test]
fn a_refused_command_is_named_by_its_place_in_the_job() {
    let (mut route, commands) = route(1_000);
    sent(&mut route, &commands, u64::MAX, 0);
    route.handle_accepted(BASE + 200, FleetMicros(1_000));
    let refusal = Refusal::BadCommand { index: 3 };
    assert_eq!(
        route.handle_refusal(refusal, BASE + 200, FleetMicros(1_000)),
        Setback::BadCommand { index: 203 }
    );
}
