//! What a gateway takes up from its file. A file with any damage is opened or refused in words, and
//! so is a file whose rows hold anything; a fleet that was taken up can go on and says what it says
//! in records.
//!
//! The first byte: damage to a file, or rows. A row is a table, the length of its key and of its
//! value, and both.

use gateway::{
    fleet::{
        Fleet, FleetConfig, Stored,
        event::{Effect, Event, Table, Write},
    },
    journal::Journal,
};
use keys::{FleetMicros, Keys};
use std::{fs, sync::OnceLock};

const NOW: FleetMicros = FleetMicros(1_795_230_000_000_000);

/// See the module.
pub fn check(data: &[u8]) {
    let Some((kind, rest)) = data.split_first() else {
        return;
    };
    if kind & 1 == 0 {
        damaged(rest);
    } else {
        rows(rest);
    }
}

/// Triples of place (two bytes, in steps of 13 bytes) and value change a good file.
fn damaged(data: &[u8]) {
    let mut bytes = file().clone();
    for change in data.chunks_exact(3) {
        let place = usize::from(u16::from_le_bytes([change[0], change[1]])) * 13 % bytes.len();
        bytes[place] ^= change[2];
    }
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("fleet.redb");
    fs::write(&path, &bytes).expect("writes");
    match Journal::open(&path) {
        Ok((_journal, stored)) => take_up(stored),
        Err(error) => assert!(!error.to_string().is_empty()),
    }
}

fn rows(mut data: &[u8]) {
    let mut stored = Stored::default();
    while let Some(([table, key, low, high], rest)) = data.split_first_chunk::<4>() {
        let (key, rest) = rest.split_at(usize::from(*key).min(rest.len()));
        let length = usize::from(u16::from_le_bytes([*low, *high]));
        let (value, rest) = rest.split_at(length.min(rest.len()));
        data = rest;
        let row = (String::from_utf8_lossy(key).into_owned(), value.to_vec());
        match table % 4 {
            0 => stored.requests.push(row),
            1 => stored.jobs.push(row),
            2 => stored.nodes.push(row),
            _ => stored.kept.push(row),
        }
    }
    // A table has each key once, in order.
    for rows in [
        &mut stored.requests,
        &mut stored.jobs,
        &mut stored.nodes,
        &mut stored.kept,
    ] {
        rows.sort();
        rows.dedup_by(|a, b| a.0 == b.0);
    }
    take_up(stored);
}

fn take_up(stored: Stored) {
    let mut effects = Vec::new();
    let config = FleetConfig::new(Keys::default());
    let mut fleet = match Fleet::restore(config, 1, stored, NOW, &mut effects) {
        Ok(fleet) => fleet,
        Err(error) => {
            assert!(!error.to_string().is_empty());
            return;
        }
    };
    for s in 1..20 {
        fleet.handle(
            Event::Tick,
            FleetMicros(NOW.0 + s * 1_000_000),
            &mut effects,
        );
    }
    for effect in effects {
        if let Effect::Reply { payload, .. } = effect {
            assert!(serde_json::from_slice::<serde_json::Value>(&payload).is_ok());
        }
    }
}

/// What a fleet of one node wrote that got two jobs.
fn written() -> Vec<Write> {
    let mut effects = Vec::new();
    let config = FleetConfig::new(Keys::default());
    let mut fleet = Fleet::restore(config, 1, Stored::default(), NOW, &mut effects).expect("empty");
    let node = keys::NodeId::new("left").expect("legal");
    fleet.handle(Event::Alive { node, alive: true }, NOW, &mut effects);
    for id in ["a", "b"] {
        let text = format!(r#"{{"id":"{id}","commands":[{{"pause":{{"ms":100}}}}]}}"#);
        let parsed = gateway::job::parse::parse("application/json", text.as_bytes());
        let submit = Event::Submit {
            pattern: "left".into(),
            request: parsed.request,
            id_hint: parsed.id_hint,
            reply: None,
        };
        fleet.handle(submit, NOW, &mut effects);
    }
    let writes = effects.into_iter().filter_map(|effect| match effect {
        Effect::Persist(write) => Some(write),
        _ => None,
    });
    writes.collect()
}

fn file() -> &'static Vec<u8> {
    static FILE: OnceLock<Vec<u8>> = OnceLock::new();
    FILE.get_or_init(|| {
        let folder = tempfile::tempdir().expect("a folder");
        let path = folder.path().join("fleet.redb");
        let (mut journal, _) = Journal::open(&path).expect("opens");
        journal.commit(&written()).expect("commits");
        drop(journal);
        fs::read(&path).expect("reads")
    })
}

/// Rows as a gateway writes them, and damage.
pub fn seeds() -> Vec<Vec<u8>> {
    let mut rows = vec![1];
    for write in written() {
        let Write::Put { table, key, value } = write else {
            continue;
        };
        rows.push(match table {
            Table::Requests => 0,
            Table::Jobs => 1,
            Table::Nodes => 2,
            Table::Kept => 3,
        });
        rows.push(key.len() as u8);
        rows.extend((value.len() as u16).to_le_bytes());
        rows.extend(key.as_bytes());
        rows.extend(value);
    }
    vec![
        rows,
        vec![0, 0, 0, 1],
        vec![0, 10, 2, 0x80, 77, 3, 1],
        vec![0],
    ]
}
