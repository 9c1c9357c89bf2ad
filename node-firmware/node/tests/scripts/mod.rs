//! How a test gives a script to a node, and hears of its end.
#![allow(
    dead_code,
    unreachable_pub,
    missing_docs,
    reason = "each test file uses another part of this one"
)]

use super::rig::{Rig, job};
use keys::{
    NodeTopic, Order, ScriptHeader, ScriptOutcome, ScriptReport, Verdict, batch::ORDER_BYTES_MAX,
    version,
};

/// The orders that carry a script as the next thing of the queue, in parts of this size.
pub fn script_orders(rig: &Rig, name: &str, text: &str, part_bytes: usize) -> Vec<Vec<u8>> {
    let status = rig.status();
    let mut offset_bytes = 0;
    text.as_bytes()
        .chunks(part_bytes)
        .map(|part| {
            let order = Order::Script(ScriptHeader {
                queue: status.queue,
                first_command: status.accepted_commands,
                job: job(name),
                offset_bytes,
                total_bytes: text.len() as u32,
            });
            offset_bytes += part.len() as u32;
            let mut buffer = [0; ORDER_BYTES_MAX];
            let mut bytes = version::encode(&order, &mut buffer).expect("room").to_vec();
            bytes.extend_from_slice(part);
            bytes
        })
        .collect()
}

pub fn send(rig: &mut Rig, text: &str) {
    for order in script_orders(rig, "lua-1", text, 1000) {
        assert_eq!(rig.order_bytes(&order).verdict, Verdict::Accepted);
    }
}

/// The last report that was sent.
pub fn report(rig: &Rig) -> Option<(ScriptReport, String)> {
    let (_, _, payload) = rig
        .sent
        .iter()
        .rfind(|(_, topic, _)| *topic == NodeTopic::Report)?;
    let (report, text) = ScriptReport::decode(payload).expect("a report");
    Some((report, text.to_owned()))
}

/// How the last script ended.
pub fn last(rig: &Rig) -> (ScriptOutcome, String) {
    let (report, text) = report(rig).expect("a report was sent");
    (report.outcome, text)
}

pub fn reported(rig: &Rig, outcome: ScriptOutcome) -> String {
    let (report, text) = report(rig).expect("a report was sent");
    assert_eq!(report.outcome, outcome, "{text}");
    text
}
