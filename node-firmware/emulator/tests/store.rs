//! Stored scripts in a folder: there again after a restart, never half of one.

use emulator::{EmulatedNode, EmulatorConfig, store::FolderStore};
use keys::{AxisId, LocalMicros, NodeId};
use node::library::{SaveError, ScriptStore};
use std::{fs, path::PathBuf};

/// A folder of this test's own, empty.
fn folder(name: &str) -> PathBuf {
    let folder = std::env::temp_dir().join(format!("stepfleet-{name}-{}", std::process::id()));
    let _ = fs::remove_dir_all(&folder);
    folder
}

fn loaded(store: &mut FolderStore) -> Vec<(String, String)> {
    let mut all = Vec::new();
    let mut take = |name: &str, text: &[u8]| {
        all.push((name.to_owned(), String::from_utf8_lossy(text).into_owned()));
    };
    store.load(&mut take).expect("readable");
    all.sort();
    all
}

#[test]
fn a_folder_gives_back_what_was_saved_and_nothing_else() {
    let folder = folder("store");
    let mut store = FolderStore::open(&folder).expect("made");
    store.save("a", b"return 1").expect("saved");
    store.save("a", b"return 2").expect("saved");
    store.save("b-2", b"").expect("saved");
    store.save("c", b"gone").expect("saved");
    store.remove("c").expect("removed");
    store.remove("never").expect("nothing to do");
    // A write that was cut off, and files of others.
    fs::write(folder.join("a.unfinished"), "retu").expect("written");
    fs::write(folder.join("README.md"), "words").expect("written");
    fs::write(folder.join("Not A Name.lua"), "x").expect("written");
    let mut store = FolderStore::open(&folder).expect("opened");
    let expected = [("a", "return 2"), ("b-2", "")];
    assert_eq!(
        loaded(&mut store),
        expected.map(|(name, text)| (name.to_owned(), text.to_owned()))
    );
    assert!(!folder.join("a.unfinished").exists());
    assert!(folder.join("README.md").exists());
    fs::remove_dir_all(&folder).expect("removed");
    assert_eq!(store.save("a", b""), Err(SaveError::Broken));
}

#[test]
fn a_boot_script_in_the_folder_of_a_new_emulator_runs() {
    let folder = folder("boot");
    let node = |boot_script| {
        let mut config = EmulatorConfig::new(NodeId::new("left").expect("legal"));
        config.boot_script = boot_script;
        let store = FolderStore::open(&folder).expect("opened");
        EmulatedNode::with_store(config, 1, Box::new(store))
    };
    let mut first = node(true);
    let text: &[u8] = b"motor.queue_move(0, 100, 30)";
    first
        .node_mut()
        .store_script(LocalMicros(0), "boot", Some(text));
    drop(first);
    for (boot_script, steps) in [(false, 0), (true, 30)] {
        let mut second = node(boot_script);
        while let Some(due) = second.poll_timeout()
            && due.0 < 1_000_000
        {
            second.poll(due);
        }
        assert_eq!(second.position_steps(AxisId(0)), steps);
    }
    fs::remove_dir_all(&folder).expect("removed");
}
