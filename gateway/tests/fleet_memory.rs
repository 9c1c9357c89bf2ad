//! What a client can make a gateway keep: every list and every text that it gives has an end.

mod rig;

use gateway::fleet::{FleetConfig, sizes::REFUSAL_BYTES_MAX};
use keys::Features;
use rig::{MS, Rig};
use serde_json::json;

#[test]
fn scripts_that_wait_are_counted_by_their_length_and_given_back_when_they_end() {
    let config = FleetConfig {
        held_commands_max: 10_000,
        ..FleetConfig::default()
    };
    let mut rig = Rig::with(config, 1);
    rig.add("left");
    rig.node("left").features = Features::BASIC.with(Features::LUA);
    // It says once a second what it can.
    rig.run(2_000 * MS);
    rig.link("left", false);
    rig.run(10_000 * MS);
    // 60,000 bytes take as much as 1,875 commands.
    let script = |name: &str| json!({"id": name, "lua": "-".repeat(60_000)});
    for name in ["a", "b", "c", "d", "e"] {
        rig.accept("left", &script(name));
    }
    assert_eq!(rig.fleet.sizes().held_commands, 5 * 1_875);
    let (code, message) = rig.refuse("left", &script("f"));
    assert_eq!(code, "too_large");
    assert!(message.contains("11250 commands"), "{message}");
    rig.restart_gateway();
    assert_eq!(rig.fleet.sizes().held_commands, 5 * 1_875, "restored");
    for name in ["a", "b", "c", "d", "e"] {
        rig.cancel(name);
    }
    assert_eq!(rig.fleet.sizes().held_commands, 0);
}

#[test]
fn a_refusal_keeps_no_more_of_a_clients_text_than_a_message_has_room_for() {
    let mut rig = Rig::with_left();
    let long = "ü".repeat(1 << 20);
    rig.put("left", &json!({"id": "field", &long: 1}));
    rig.put("left", &json!({"id": long}));
    rig.put("left", &json!({"id": "kind", "commands": [{&long: {}}]}));
    rig.put(
        &long,
        &json!({"id": "node", "commands": [{"pause": {"ms": 1}}]}),
    );
    rig.run(10 * MS);
    assert_eq!(rig.fleet.sizes().jobs, 4);
    for job in rig.fleet.jobs() {
        let error = job.entry.record.error.as_ref().expect("refused");
        let bytes = error.message.len();
        assert!(bytes <= REFUSAL_BYTES_MAX + 3, "{} has {bytes}", job.id());
    }
    let longest = rig.rows.values().map(Vec::len).max();
    assert!(longest.is_some_and(|bytes| bytes < 4 * REFUSAL_BYTES_MAX));
}
