//! Stored scripts on a node that executes only what an operator has signed: what is stored, what
//! runs, what is left where it is. Stored in flash, as on a board.

mod rig;

// The same flash in memory, whose power can be cut.
#[path = "../../provision/tests/flash/mod.rs"]
mod flash;

use ed25519_dalek::{Signer as _, SigningKey};
use flash::Flash;
use keys::{
    NodeId, NodeTopic,
    signed_script::{Line, Statement},
};
use node::library::{ScriptStore, flash::FlashStore};
use rig::{BOOT, Rig, config};

const MOVE: &str = "motor.queue_move(0, 100, 30)";

fn operator(secret: u8) -> SigningKey {
    SigningKey::from_bytes(&[secret; 32])
}

/// The text as it is put, signed for the node `left`.
fn signed(by: &SigningKey, boot: u32, name: &str, number: u64, text: &str) -> String {
    let node = NodeId::new("left").expect("legal");
    let statement = Statement {
        node: &node,
        boot,
        name,
        number,
        text,
    };
    let line = Line {
        key: by.verifying_key().to_bytes(),
        boot,
        number,
        signature: by.sign(&statement.bytes().expect("short")).to_bytes(),
    };
    format!("{line}{text}")
}

/// A node that trusts alice, with what is in the flash.
fn booted(flash: &Flash, boot: u32) -> Rig {
    let mut config = config();
    config.boot_script = true;
    let key = operator(1).verifying_key().to_bytes();
    config.signers.push(key).expect("room");
    let store = FlashStore::open(flash.clone()).expect("a region");
    let node = emulator::EmulatedNode::with_store(config, boot, Box::new(store));
    Rig::with_node(node)
}

/// Puts a text, or deletes it, and returns what the log says to that.
fn put(rig: &mut Rig, name: &str, text: Option<&str>) -> String {
    let before = rig.sent.len();
    let now = rig.now;
    let bytes = text.map(str::as_bytes);
    rig.node.node_mut().store_script(now, name, bytes);
    rig.run_for(5_000_000);
    let lines = rig.sent[before..].iter();
    let mut lines = lines.filter(|(_, topic, _)| *topic == NodeTopic::Log);
    let line = lines.next().map_or(Vec::new(), |(_, _, line)| line.clone());
    String::from_utf8(line).expect("UTF-8")
}

fn stored(rig: &Rig, name: &str) -> Option<String> {
    rig.node.node().library().get(name).map(String::from)
}

#[test]
fn only_what_an_operator_signed_for_this_name_node_and_boot_is_stored() {
    let (alice, mallory) = (operator(1), operator(2));
    let mut rig = booted(&Flash::new(8), BOOT);
    let good = signed(&alice, BOOT, "a", 1, MOVE);
    let other_node = {
        let node = NodeId::new("right").expect("legal");
        let statement = Statement {
            node: &node,
            boot: BOOT,
            name: "a",
            number: 1,
            text: MOVE,
        };
        let signature = alice.sign(&statement.bytes().expect("short")).to_bytes();
        let key = alice.verifying_key().to_bytes();
        format!(
            "{}{MOVE}",
            Line {
                key,
                boot: BOOT,
                number: 1,
                signature
            }
        )
    };
    let not_here = "script a not taken: its signature does not count here";
    for (text, words) in [
        (MOVE.to_owned(), "script a not taken: it is not signed"),
        (good.replace("30", "31"), not_here),
        (signed(&mallory, BOOT, "a", 1, MOVE), not_here),
        (signed(&alice, BOOT, "b", 1, MOVE), not_here),
        (other_node, not_here),
        (
            signed(&alice, BOOT - 1, "a", 1, MOVE),
            "script a not taken: it was signed for an earlier start of the node",
        ),
    ] {
        assert_eq!(put(&mut rig, "a", Some(&text)), words);
        assert_eq!(stored(&rig, "a"), None);
    }
    assert_eq!(put(&mut rig, "a", Some(&good)), "script a stored");
    assert_eq!(stored(&rig, "a"), Some(good.clone()));
    // Twice over the network is as good as once.
    assert_eq!(put(&mut rig, "a", Some(&good)), "script a stored");
    // What was replaced does not come back.
    let newer = signed(&alice, BOOT, "a", 2, "return 2");
    assert_eq!(put(&mut rig, "a", Some(&newer)), "script a stored");
    let words = "script a not taken: its signature was used before";
    assert_eq!(put(&mut rig, "a", Some(&good)), words);
    assert_eq!(stored(&rig, "a"), Some(newer));
}

#[test]
fn a_signed_nothing_removes_and_a_plain_delete_does_not() {
    let alice = operator(1);
    let mut rig = booted(&Flash::new(8), BOOT);
    put(&mut rig, "a", Some(&signed(&alice, BOOT, "a", 1, MOVE)));
    assert_eq!(
        put(&mut rig, "a", None),
        "script a not taken: it is not signed"
    );
    assert!(stored(&rig, "a").is_some());
    let nothing = signed(&alice, BOOT, "a", 2, "");
    assert_eq!(put(&mut rig, "a", Some(&nothing)), "script a removed");
    assert_eq!(stored(&rig, "a"), None);
}

#[test]
fn a_signed_boot_script_runs_at_every_later_start_and_one_without_signature_at_none() {
    let alice = operator(1);
    let mut store = FlashStore::open(Flash::new(8)).expect("a region");
    // Put there before the node was told whose signature counts.
    store
        .save("boot", b"motor.queue_move(0, 100, 7)")
        .expect("room");
    store.save("tool", MOVE.as_bytes()).expect("room");
    let flash = store.into_flash();
    let mut rig = booted(&flash, BOOT);
    rig.run_for(2_000_000);
    assert_eq!(rig.position(), 0);
    let lines = rig.lines();
    let words = "script boot and 1 more are not signed: they do not run";
    assert!(lines.iter().any(|line| line == words), "{lines:?}");
    // They can be read, and replaced.
    assert_eq!(stored(&rig, "tool").as_deref(), Some(MOVE));

    let text = signed(&alice, 5, "boot", 1, MOVE);
    let mut store = FlashStore::open(flash).expect("a region");
    store.save("boot", text.as_bytes()).expect("room");
    let flash = store.into_flash();
    // It was signed for the boot in which it was put; from then on it is there.
    for boot in [6, 7] {
        let mut rig = booted(&flash, boot);
        rig.run_for(2_000_000);
        assert_eq!(rig.position(), 30);
        let lines = rig.lines();
        let words = "script tool is not signed: it does not run";
        assert!(lines.iter().any(|line| line == words), "{lines:?}");
    }
}

#[test]
fn a_signed_script_calls_only_what_is_signed_too() {
    let alice = operator(1);
    let mut store = FlashStore::open(Flash::new(8)).expect("a region");
    let boot = "node.call('good') local ok, why = pcall(node.call, 'plain') \
                node.publish('why', why) motor.queue_move(0, 100, ok and 1 or 2)";
    store
        .save("boot", signed(&alice, 1, "boot", 1, boot).as_bytes())
        .expect("room");
    store
        .save("good", signed(&alice, 1, "good", 2, MOVE).as_bytes())
        .expect("room");
    store
        .save("plain", b"motor.queue_move(0, 100, 1000)")
        .expect("room");
    let mut rig = booted(&store.into_flash(), BOOT);
    rig.run_for(2_000_000);
    assert_eq!(rig.position(), 32);
    let told = rig.sent.iter().find(|sent| sent.1 == NodeTopic::Data);
    let told = told.map(|sent| String::from_utf8_lossy(&sent.2).into_owned());
    let words = "no script 'plain' is stored";
    assert!(
        told.as_deref().unwrap_or_default().contains(words),
        "{told:?}"
    );
}
