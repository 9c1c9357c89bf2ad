//! `kill -9` of the gateway at any moment: every accepted job is finished, failed with a reason or
//! still queued, and no command runs twice.

use keys::record::JobState;
use tests::{
    World,
    verdict::Book,
    world::{MS, S},
};

#[test]
fn killed_at_any_millisecond_the_gateway_goes_on_where_the_node_is() {
    for at_ms in 0..300 {
        let mut world = World::with_nodes(at_ms, &["left", "right"]);
        let mut book = Book::new();
        for (name, node) in [("a", "left"), ("b", "left"), ("c", "right")] {
            let steps: Vec<_> = (0..120).map(|index| ((index % 2) as u8, 20)).collect();
            let _ = world.submit(node, &book.job(name, &steps));
        }
        world.run_for(at_ms * MS);
        world.kill_gateway(300 * MS);
        world.run_for(20 * S);
        world.verdict(&book);
        for (job, records) in &world.records {
            let last = records.last().expect("a list begins with its first entry");
            assert_eq!(
                last.state,
                JobState::Succeeded,
                "killed after {at_ms} ms: {job}"
            );
        }
    }
}

#[test]
fn a_gateway_that_is_killed_again_and_again_still_gets_every_job_done() {
    let mut world = World::with_nodes(5, &["left"]);
    let mut book = Book::new();
    for number in 0..4 {
        let steps: Vec<_> = (0..200).map(|_| (0, 25)).collect();
        let _ = world.submit("left", &book.job(&format!("job-{number}"), &steps));
    }
    world.run_for(50 * MS);
    for _ in 0..12 {
        world.kill_gateway(200 * MS);
        world.run_for(900 * MS);
    }
    world.run_for(30 * S);
    world.verdict(&book);
    assert_eq!(world.records.len(), 4);
    let succeeded = |records: &Vec<keys::record::JobRecord>| {
        records
            .last()
            .is_some_and(|last| last.state == JobState::Succeeded)
    };
    assert!(world.records.values().all(succeeded));
}
