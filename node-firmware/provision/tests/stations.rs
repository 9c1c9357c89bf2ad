//! Which network a node tries, in virtual time.

use provision::stations::{
    BACK_OFF_US_MAX, BACK_OFF_US_MIN, Failure, GOOD_DBM, Next, PASSWORD_US, SCAN_US_MAX, Stations,
};

const S: u64 = 1_000_000;

fn tried(stations: &mut Stations, now_us: u64) -> usize {
    match stations.poll(now_us) {
        Next::Try(index) => index,
        other => panic!("{other:?} at {now_us}"),
    }
}

#[test]
fn the_first_that_is_heard_well_counts_and_else_the_loudest() {
    for (heard, expected) in [
        (&[(0, -60), (1, -40)][..], 0),
        (&[(0, -80), (1, -40)], 1),
        (&[(0, -90), (1, -85), (2, -80)], 2),
        (&[(2, -80), (1, -80)], 1),
        (&[(0, GOOD_DBM), (1, -30)], 0),
        // One name, two access points.
        (&[(0, -90), (0, -50), (1, -40)], 0),
        (&[(2, -88)], 2),
        // Nobody is heard: names may be hidden.
        (&[], 0),
        // A number that is none.
        (&[(9, -20)], 0),
    ] {
        let mut stations = Stations::new(3);
        assert_eq!(stations.poll(0), Next::Scan);
        stations.handle_scan(heard.iter().copied(), 0);
        assert_eq!(tried(&mut stations, 0), expected, "{heard:?}");
    }
}

#[test]
fn after_a_failure_the_others_are_tried_and_then_the_air_is_heard_again() {
    let mut stations = Stations::new(3);
    stations.handle_scan([(0, -60), (1, -50)], 0);
    let mut now_us = 0;
    for expected in [0, 1, 2] {
        assert_eq!(tried(&mut stations, now_us), expected);
        stations.handle_failure(expected, Failure::Other, now_us);
        now_us += S / 2;
    }
    // All back off; the first of them is free first.
    assert_eq!(
        stations.poll(now_us),
        Next::Wait {
            until_us: BACK_OFF_US_MIN
        }
    );
    assert_eq!(stations.poll(BACK_OFF_US_MIN), Next::Scan, "all were tried");
    stations.handle_scan([(1, -50)], BACK_OFF_US_MIN);
    assert_eq!(
        tried(&mut stations, BACK_OFF_US_MIN),
        0,
        "1 is not free yet"
    );
    assert_eq!(tried(&mut stations, BACK_OFF_US_MIN + S), 1);
}

#[test]
fn a_network_that_fails_again_and_again_is_left_alone_longer_and_longer_but_not_for_ever() {
    let mut stations = Stations::new(1);
    let mut now_us = 0;
    let mut waits = Vec::new();
    for _ in 0..7 {
        assert_eq!(tried(&mut stations, now_us), 0, "one alone needs no scan");
        stations.handle_failure(0, Failure::Other, now_us);
        let Next::Wait { until_us } = stations.poll(now_us) else {
            panic!("it backs off");
        };
        waits.push((until_us - now_us) / S);
        assert!(matches!(stations.poll(until_us - 1), Next::Wait { .. }));
        now_us = until_us;
    }
    assert_eq!(waits, [2, 4, 8, 16, 30, 30, 30]);
    assert_eq!(BACK_OFF_US_MAX, 30 * S);
    // A success forgets all that.
    stations.handle_up(0);
    stations.handle_lost();
    assert_eq!(tried(&mut stations, now_us), 0);
    stations.handle_failure(0, Failure::Other, now_us);
    let until_us = now_us + BACK_OFF_US_MIN;
    assert_eq!(stations.poll(now_us), Next::Wait { until_us });
}

#[test]
fn a_wrong_password_is_not_tried_soon_and_does_not_keep_from_the_others() {
    let mut stations = Stations::new(2);
    stations.handle_scan([(0, -40), (1, -60)], 0);
    assert_eq!(tried(&mut stations, 0), 0);
    stations.handle_failure(0, Failure::Password, 0);
    assert_eq!(tried(&mut stations, 0), 1);
    stations.handle_failure(1, Failure::Other, S);
    let mut now_us = S;
    let mut attempts = [0; 2];
    while now_us < PASSWORD_US {
        match stations.poll(now_us) {
            Next::Wait { until_us } => now_us = until_us,
            Next::Scan => stations.handle_scan([(0, -40), (1, -60)], now_us),
            Next::Try(index) => {
                attempts[index] += 1;
                stations.handle_failure(index, Failure::Other, now_us);
            }
            Next::Stay => panic!("it is not connected"),
        }
    }
    assert_eq!(
        attempts,
        [0, 4],
        "after 2, 4, 8, 16 s, and 30 more are beyond"
    );
    assert_eq!(stations.poll(PASSWORD_US), Next::Scan);
}

#[test]
fn what_was_lost_is_tried_again_at_once_and_if_it_is_gone_the_air_is_heard() {
    let mut stations = Stations::new(2);
    stations.handle_scan([(1, -40)], 0);
    assert_eq!(tried(&mut stations, 0), 1);
    stations.handle_up(1);
    assert_eq!(stations.poll(S), Next::Stay);
    stations.handle_lost();
    assert_eq!(tried(&mut stations, 100 * S), 1);
    stations.handle_up(1);
    assert_eq!(stations.poll(101 * S), Next::Stay);
    stations.handle_lost();
    assert_eq!(tried(&mut stations, 102 * S), 1);
    stations.handle_failure(1, Failure::Other, 103 * S);
    assert_eq!(stations.poll(103 * S), Next::Scan);
    stations.handle_scan([(0, -50)], 104 * S);
    assert_eq!(tried(&mut stations, 104 * S), 0);
    // Lost without having been had is nothing.
    let mut stations = Stations::new(1);
    stations.handle_lost();
    assert_eq!(tried(&mut stations, 0), 0);
}

#[test]
fn what_was_heard_long_ago_counts_no_more() {
    let mut stations = Stations::new(2);
    stations.handle_scan([(0, -40)], 0);
    assert_eq!(tried(&mut stations, SCAN_US_MAX - 1), 0);
    assert_eq!(stations.poll(SCAN_US_MAX), Next::Scan);
    // A scan that fails is one that hears nothing: then they are tried in their order.
    stations.handle_scan([], SCAN_US_MAX);
    assert_eq!(tried(&mut stations, SCAN_US_MAX), 0);
}

#[test]
fn without_a_network_nothing_is_ever_done() {
    let mut stations = Stations::new(0);
    assert_eq!(stations.poll(5), Next::Wait { until_us: u64::MAX });
    stations.handle_up(0);
    stations.handle_failure(0, Failure::Other, 5);
    assert_eq!(stations.poll(6), Next::Wait { until_us: u64::MAX });
}
