//! How large a message may be, by its key, as the router's `low_pass_filter`: what is larger is dropped
//! where it comes in, so that nobody can have the router pass 64 MiB on to every node as a stop.
//!
//! Jobs are bounded by [`MESSAGE_BYTES_MAX`](crate::config::MESSAGE_BYTES_MAX) alone: so that what is too
//! large for one has an answer. What the router puts together from fragments before it looks at the key
//! is bounded by that, too, for each of the lanes of a link.

use keys::{Keys, NodeTopic};
use serde_json::{Value, json};

/// Largest message of those that are small by their nature, with its attachment, bytes: as much as a node
/// puts together from fragments, and three times of what one says.
pub const SMALL_BYTES_MAX: usize = 4_096;

/// Largest message that holds a script or a piece of a firmware, bytes: twice the longest script.
pub const SCRIPT_MESSAGE_BYTES_MAX: usize = 2 * keys::script::SCRIPT_BYTES_MAX;

/// What is small. Of jobs, scripts and firmware the others.
const SMALL: [NodeTopic; 16] = [
    NodeTopic::State,
    NodeTopic::Release,
    NodeTopic::Log,
    NodeTopic::Status,
    NodeTopic::Batch,
    NodeTopic::Ack,
    NodeTopic::Clock,
    NodeTopic::Start,
    NodeTopic::Report,
    NodeTopic::Pace,
    NodeTopic::Hold,
    NodeTopic::Resume,
    NodeTopic::Speed,
    NodeTopic::Trace,
    NodeTopic::Vitals,
    NodeTopic::Setup,
];

/// Returns zenoh's setting `low_pass_filter`.
pub(super) fn low_pass_filter(keys: &Keys) -> Value {
    let prefix = keys.prefix();
    let every = |topic: NodeTopic| keys.every_node(topic).to_string();
    let mut small: Vec<String> = SMALL.into_iter().map(every).collect();
    small.extend([
        // Of any prefix, as a stop on a wide key is.
        format!("**/node/*/{}", NodeTopic::Stop.suffix()),
        format!("{prefix}/node/*/{}/**", NodeTopic::Data.suffix()),
        every(NodeTopic::Jog),
        format!("{prefix}/job/*/cancel"),
        format!("{prefix}/manage/link/*"),
    ]);
    let records = vec![format!("{prefix}/job/*")];
    let larger = vec![
        format!("{prefix}/node/*/script/*"),
        every(NodeTopic::Update),
        format!("{prefix}/manage/node/*"),
        format!("{prefix}/manage/job/*"),
    ];
    // Answers are larger than questions, and come from nodes and this gateway.
    let rule = |id: &str, messages: &[&str], keys: Vec<String>, bytes: usize| {
        json!({
            "id": id, "flows": ["ingress"], "messages": messages, "key_exprs": keys,
            "size_limit": bytes,
        })
    };
    json!([
        rule("small", &["put", "delete", "query"], small, SMALL_BYTES_MAX),
        rule("read", &["query"], records, SMALL_BYTES_MAX),
        rule(
            "larger",
            &["put", "delete", "query"],
            larger,
            SCRIPT_MESSAGE_BYTES_MAX
        ),
    ])
}
