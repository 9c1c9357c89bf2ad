//! What was and may be no more is never shown as what is.

use crate::fixture::{at_ms, fleet, job, node, tell};
use crate::screen::{Window, asked, button, show, shows};
use dashboard::{
    message::{LinkEvent, Message},
    view::Tab,
};
use egui_kittest::kittest::Queryable as _;

#[test]
fn a_lost_link_makes_everything_old() {
    let mut harness = show(fleet());
    let why = "the router is gone".to_owned();
    let down = Message::Link(LinkEvent::Down { why });
    tell(harness.state_mut(), at_ms(1_000), down);
    harness.state_mut().model.tick(at_ms(13_000));
    harness.run_steps(2);
    assert!(shows(&harness, "no link for 12 s: what you see is old"));
    assert!(
        shows(&harness, "cell-a-$* (?/3)"),
        "nobody knows who is there"
    );
    assert!(shows(&harness, "⚠ as it was: no gateway tells of it now"));
    harness.state_mut().view.focus = Some(node("cell-a-1"));
    harness.run_steps(2);
    assert!(shows(&harness, "ago: there is no link"));
    harness.state_mut().view.tab = Tab::Compose;
    harness.state_mut().view.composer.target = "*".to_owned();
    harness.run_steps(2);
    button(&mut harness, "Send job");
    assert_eq!(asked(&mut harness), []);
}

#[test]
fn without_a_gateway_jobs_that_had_not_ended_are_as_they_were() {
    let mut harness = show(fleet());
    let told = |harness: &mut Window, present| {
        let event = LinkEvent::Gateway { present };
        tell(harness.state_mut(), at_ms(1_000), Message::Link(event));
        harness.state_mut().view.jobs.open = Some(job("engrave-7"));
        harness.run_steps(2);
        let words = "⚠ as it was: no gateway tells of it now";
        harness.query_all_by_label_contains(words).count()
    };
    assert_eq!(told(&mut harness, true), 0);
    assert_eq!(
        told(&mut harness, false),
        2,
        "in the list and in the detail"
    );
    assert_eq!(told(&mut harness, true), 0);
}

#[test]
fn the_page_of_a_node_that_is_gone_or_silent_says_that_it_is_old() {
    let mut harness = show(fleet());
    harness.state_mut().view.focus = Some(node("cell-a-1"));
    harness.run_steps(2);
    assert!(!shows(&harness, "⚠ as it was"));
    let stop = |harness: &Window| harness.get_by_label("Stop node").rect();
    let place = stop(&harness);
    harness.state_mut().model.tick(at_ms(9_000));
    harness.run_steps(2);
    assert!(shows(&harness, "ago: it is silent"));
    assert_eq!(stop(&harness), place, "what stops is where it was");
    let (node, alive) = (node("cell-a-1"), false);
    let gone = Message::Alive { node, alive };
    tell(harness.state_mut(), at_ms(9_000), gone);
    harness.run_steps(2);
    assert!(shows(&harness, "ago: it is gone"));
}
