//! What each role may say and hear, as the router's access rules. Whatever is not named is denied.
//!
//! | | says | hears |
//! |---|---|---|
//! | operator | jobs, cancels, stops, releases, holds, speeds, jogs, stored scripts, firmware, labels, maintenance, order of jobs, backups | states, statuses, vitals, setups, records, logs, data |
//! | viewer | stops | the same |
//! | node | its own status, ack, clock, start, pace, trace, vitals, setup, log, report, data | its own orders, and every stop |
//! | gateway | everything | everything |
//!
//! **Stops.** The router lets a message pass if a rule's key includes its key. So a stop may be said on
//! every key that ends in `/node/NODES/stop`, whatever is wild in it (`PREFIX/node/*/stop`,
//! `plant/*/node/*/stop`, `**/node/left/stop`), put or deleted. Denied, without a word as by zenoh's ways,
//! is a stop on a key that only includes such ones (`PREFIX/**`, `**/stop`, `PREFIX/node/**/stop`): to
//! whoever may say that everything else may be said, too. An unsecured fleet takes it.
//!
//! A node cannot speak as another, whatever key it uses: rules go by the name under which it
//! authenticated. People are let in by TLS only; a node also by plain TCP, where its password is not
//! sent (it answers a challenge) but what it says can be read.

use super::users::{Role, User};
use crate::bus::backup::BACKUP;
use keys::{Keys, NodeId, NodeTopic};
use serde_json::{Value, json};

/// What a node says.
const SAID: [NodeTopic; 9] = [
    NodeTopic::Trace,
    NodeTopic::Vitals,
    NodeTopic::Pace,
    NodeTopic::Report,
    NodeTopic::Status,
    NodeTopic::Ack,
    NodeTopic::Clock,
    NodeTopic::Start,
    NodeTopic::Log,
];

/// What a node hears.
const HEARD: [NodeTopic; 6] = [
    NodeTopic::Pace,
    NodeTopic::Batch,
    NodeTopic::Stop,
    NodeTopic::Release,
    NodeTopic::Clock,
    NodeTopic::Start,
];

/// What everybody may follow.
const FOLLOWED: [NodeTopic; 5] = [
    NodeTopic::State,
    NodeTopic::Status,
    NodeTopic::Vitals,
    NodeTopic::Log,
    NodeTopic::Stop,
];

/// How a stop is said.
const STOPS: [&str; 2] = ["put", "delete"];

const EVERYTHING: [&str; 9] = [
    "put",
    "delete",
    "declare_subscriber",
    "query",
    "declare_queryable",
    "reply",
    "liveliness_token",
    "declare_liveliness_subscriber",
    "liveliness_query",
];

/// Every key that names a stop, of any prefix. It names nothing else, but for a script and data of a node
/// called [`AMBIGUOUS_NODE`], and below a prefix that ends in that word; and that is denied.
const WIDE_STOP: &str = "**/node/*/stop";

/// The node whose scripts have keys that look like a stop of `script`: it hears no wide stops.
const AMBIGUOUS_NODE: &str = "node";

/// Returns zenoh's setting `access_control` for these users.
pub fn access_control(keys: &Keys, users: &[User]) -> Value {
    let mut rules = Rules::default();
    let all = format!("{}/**", keys.prefix());
    rules.add(
        "gateway",
        &["ingress", "egress"],
        &EVERYTHING,
        vec![all.clone()],
    );
    // A wide stop means the nodes of this gateway too.
    let stops = vec![WIDE_STOP.to_owned()];
    rules.add("gateway-stops", &["egress"], &STOPS, stops.clone());

    let each = |topics: &[NodeTopic]| -> Vec<String> {
        let every = topics.iter().map(|topic| keys.every_node(*topic));
        every.map(|key| key.to_string()).collect()
    };
    let prefix = keys.prefix();
    let jobs = [format!("{prefix}/job/*")];
    let alive = each(&[NodeTopic::Alive]);
    let mut followed = each(&FOLLOWED);
    followed.extend(jobs.clone());
    followed.push(keys.every_start_plan().to_string());
    followed.push(format!("{prefix}/node/*/{}/**", NodeTopic::Data.suffix()));
    rules.add("follow", &["egress"], &["put"], followed);
    let asks = [
        "declare_subscriber",
        "declare_liveliness_subscriber",
        "liveliness_query",
    ];
    // What it hears is limited where it is said to it; so it may ask for anything.
    rules.add("ask", &["ingress"], &asks, vec![all]);
    rules.add("alive", &["egress"], &["liveliness_token"], alive);
    // The node itself answers for its setup.
    let mut read = each(&[NodeTopic::State, NodeTopic::Setup]);
    read.extend(jobs);
    read.push(format!("{prefix}/manage/link/*"));
    rules.add("read", &["ingress"], &["query"], read.clone());
    rules.add("answers", &["egress"], &["reply"], read);
    rules.add("stop", &["ingress"], &STOPS, stops);
    // What looks like a stop and is none.
    let data = format!("{prefix}/node/*/{}/**", NodeTopic::Data.suffix());
    let records = format!("{prefix}/job/*");
    let scripts = format!("{prefix}/node/*/script/*");
    rules.deny("no-forgery", &STOPS, vec![data, records]);
    rules.deny("no-script", &STOPS, vec![scripts]);

    let mut work = each(&[
        NodeTopic::Job,
        NodeTopic::Release,
        NodeTopic::Hold,
        NodeTopic::Resume,
        NodeTopic::Speed,
    ]);
    work.extend([
        format!("{prefix}/group/*/job"),
        format!("{prefix}/job/*/cancel"),
        format!("{prefix}/manage/**"),
    ]);
    work.push(format!("{prefix}/node/*/script/*"));
    // Other firmware: what is signed counts, but who may ask is the operator's affair.
    work.push(keys.every_node(NodeTopic::Update).to_string());
    // The node itself answers a jog.
    work.push(keys.every_node(NodeTopic::Jog).to_string());
    rules.add(
        "work",
        &["ingress"],
        &["put", "delete", "query"],
        work.clone(),
    );
    let store = vec![format!("{prefix}/{BACKUP}")];
    rules.add("save", &["ingress"], &["query"], store.clone());
    rules.add("saved", &["egress"], &["reply"], store);
    rules.add("receipts", &["egress"], &["reply"], work);

    let looks = [
        "follow",
        "ask",
        "alive",
        "read",
        "answers",
        "stop",
        "no-forgery",
    ];
    let mut policies = Vec::new();
    let mut subjects = Vec::new();
    for role in Role::ALL {
        let names: Vec<&str> = users
            .iter()
            .filter(|user| user.role == role)
            .map(|user| user.name.as_str())
            .collect();
        if names.is_empty() {
            continue;
        }
        let mut policy = |subject: &str, rules: Vec<String>| {
            policies.push(json!({"rules": rules, "subjects": [subject]}));
        };
        let owned = |ids: &[&str]| ids.iter().map(|id| (*id).to_owned()).collect::<Vec<_>>();
        match role {
            Role::Gateway => {
                subjects.push(json!({"id": "gateway", "usernames": names}));
                policy("gateway", owned(&["gateway", "gateway-stops"]));
            }
            Role::Operator => {
                subjects.push(
                    json!({"id": "operators", "usernames": names, "link_protocols": ["tls"]}),
                );
                policy(
                    "operators",
                    [owned(&looks), owned(&["work", "receipts", "save", "saved"])].concat(),
                );
            }
            Role::Viewer => {
                subjects
                    .push(json!({"id": "viewers", "usernames": names, "link_protocols": ["tls"]}));
                policy("viewers", [owned(&looks), owned(&["no-script"])].concat());
            }
            Role::Node => {
                for name in names {
                    let subject = format!("node-{name}");
                    subjects.push(json!({"id": subject, "usernames": [name]}));
                    let name = NodeId::new(name).expect("a user's name is one");
                    policy(&subject, rules.of_node(keys, &name));
                }
            }
        }
    }
    json!({
        "enabled": true,
        "default_permission": "deny",
        "rules": rules.rules,
        "subjects": subjects,
        "policies": policies,
    })
}

#[derive(Default)]
struct Rules {
    rules: Vec<Value>,
}

impl Rules {
    fn add(&mut self, id: &str, flows: &[&str], messages: &[&str], keys: Vec<String>) {
        self.rules.push(json!({
            "id": id, "permission": "allow", "flows": flows, "messages": messages, "key_exprs": keys,
        }));
    }

    /// What is denied to somebody stays denied, whatever is allowed.
    fn deny(&mut self, id: &str, messages: &[&str], keys: Vec<String>) {
        self.rules.push(json!({
            "id": id, "permission": "deny", "flows": ["ingress"], "messages": messages,
            "key_exprs": keys,
        }));
    }

    /// Adds the rules of one node and returns their names.
    fn of_node(&mut self, keys: &Keys, name: &NodeId) -> Vec<String> {
        let own = |topics: &[NodeTopic]| -> Vec<String> {
            let own = topics.iter().map(|topic| keys.node(name, *topic));
            own.map(|key| key.to_string()).collect()
        };
        // A stop on a wild key is heard under that key.
        let mut heard = own(&HEARD);
        heard.push(match name.as_str() {
            AMBIGUOUS_NODE => keys.every_node(NodeTopic::Stop).to_string(),
            _ => WIDE_STOP.to_owned(),
        });
        // Stored scripts: put, deleted and read on keys below one of its own; by a wild key too.
        let prefix = keys.prefix();
        let scripts = vec![format!("{prefix}/node/{name}/script/*")];
        let mut asked = vec![format!("{prefix}/node/*/script/*")];
        heard.extend(asked.clone());
        // Other firmware is asked for, on one key.
        asked.push(keys.every_node(NodeTopic::Update).to_string());
        asked.push(keys.every_node(NodeTopic::Jog).to_string());
        asked.push(keys.every_node(NodeTopic::Setup).to_string());
        let mut said = own(&SAID);
        said.push(format!("{}/**", keys.node(name, NodeTopic::Data)));
        let mut listened = own(&HEARD);
        listened.extend(scripts.clone());
        let mut kept = scripts;
        kept.extend(own(&[NodeTopic::Update, NodeTopic::Jog, NodeTopic::Setup]));
        let verbs = ["says", "lives", "listens", "hears", "keeps", "asked"];
        let ids = verbs.map(|verb| format!("{name}-{verb}"));
        let [says, lives, listens, hears, keeps, asks] = &ids;
        self.add(keeps, &["ingress"], &["declare_queryable", "reply"], kept);
        self.add(asks, &["egress"], &["query"], asked);
        self.add(says, &["ingress"], &["put"], said);
        self.add(
            lives,
            &["ingress"],
            &["liveliness_token"],
            own(&[NodeTopic::Alive]),
        );
        self.add(listens, &["ingress"], &["declare_subscriber"], listened);
        self.add(hears, &["egress"], &["put", "delete"], heard);
        ids.into()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_user_is_the_subject_of_exactly_one_policy() {
        let names = [
            ("gateway", Role::Gateway),
            ("alice", Role::Operator),
            ("bob", Role::Viewer),
            ("left", Role::Node),
            ("right", Role::Node),
        ];
        let users = names.map(|(name, role)| {
            User::new(NodeId::new(name).expect("legal"), role).expect("random numbers")
        });
        let access = access_control(&Keys::default(), &users);
        let subjects = access["subjects"].as_array().expect("a list");
        for (name, _) in names {
            let of = subjects.iter().filter(|subject| {
                let names = subject["usernames"].as_array().expect("a list");
                names.iter().any(|word| word == name)
            });
            assert_eq!(of.count(), 1, "{name}");
        }
        let policies = access["policies"].as_array().expect("a list");
        assert_eq!(policies.len(), subjects.len());
        let rules = access["rules"].as_array().expect("a list");
        let defined = |id: &Value| rules.iter().any(|rule| rule["id"] == *id);
        for policy in policies {
            assert!(
                policy["rules"]
                    .as_array()
                    .expect("a list")
                    .iter()
                    .all(defined),
                "{policy}"
            );
        }
        let text = access.to_string();
        assert!(users.iter().all(|user| !text.contains(&user.password)));
    }
}
