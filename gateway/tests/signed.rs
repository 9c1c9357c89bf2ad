//! Signed jobs in the gateway: what it demands, what it passes on, and that a restart changes nothing
//! of it. The node's side is in `node/tests/signed.rs`.

mod rig;

use gateway::{
    fleet::{FleetConfig, commands_of, parts_of},
    security::signing::{Signer, root_of, statement},
};
use keys::{
    BatchReader, Command, Features, NodeId, NodeTopic, Order,
    job::{GroupRequest, JobRequest, Work},
    record::JobState,
    signed::{Proof, link_command, root_before, root_of_commands},
};
use rig::{MS, Rig, S, id, moves};
use serde_json::{Value, json};

const COUNT: usize = 2_000;

struct Plant {
    rig: Rig,
    alice: Signer,
    mallory: Signer,
}

/// A gateway that takes what alice has signed, and a node with a short ring.
fn plant() -> Plant {
    let (alice, mallory) = (
        Signer::new().expect("random numbers"),
        Signer::new().expect("random numbers"),
    );
    let config = FleetConfig {
        signers: Some(vec![alice.public().0]),
        ..FleetConfig::default()
    };
    let mut rig = Rig::with(config, 1);
    rig.add("left");
    rig.node("left").ring_commands = 100;
    rig.run(2 * S);
    Plant {
        rig,
        alice,
        mallory,
    }
}

fn commands(job: &Value) -> Vec<Command> {
    let request = JobRequest::from_json(job.to_string().as_bytes()).expect("legal");
    commands_of(&request).to_vec()
}

fn sign(rig: &mut Rig, signer: &Signer, mut job: Value, number: u64) -> Value {
    let boot = rig.node("left").queue.boot;
    let name = id(job["id"].as_str().expect("it has one"));
    let root = root_of(&commands(&job), None).expect("short");
    let node = NodeId::new("left").expect("legal");
    let signature = signer.sign(&statement(&node, &name, boot, number, root));
    job["signature"] = serde_json::to_value(signature).expect("JSON");
    job
}

/// Returns the commands of each order that was sent to a node, with the proof before them and where in
/// what was signed they begin.
fn proved(rig: &Rig) -> Vec<(NodeId, Proof, usize, Vec<Command>)> {
    let batches = rig.sent.iter();
    let batches = batches.filter(|(_, _, topic, _, _)| *topic == NodeTopic::Batch);
    let mut proved = Vec::new();
    for (_, node, _, _, payload) in batches {
        let (proof, order) = Proof::split(payload).expect("an order");
        let mut reader = BatchReader::new(order).expect("an order");
        let Order::Batch(header) = *reader.order() else {
            continue;
        };
        let proof = proof.expect("each order has one");
        assert!(proof.includes(&header));
        let mut inside = Vec::new();
        while let Some(command) = reader.next_command().expect("a command") {
            inside.push(command);
        }
        let from = (header.first_command - proof.first_command) as usize;
        proved.push((*node, proof, from, inside));
    }
    proved
}

#[test]
fn a_signed_job_goes_on_after_restarts_of_the_gateway_and_each_order_proves_itself() {
    let Plant { mut rig, alice, .. } = plant();
    let job = sign(&mut rig, &alice, moves("signed", COUNT, 100), 1);
    let commands = commands(&job);
    let name = rig.accept("left", &job);
    for _ in 0..3 {
        rig.run(S);
        rig.restart_gateway();
        assert_eq!(rig.state(&name), JobState::Running);
    }
    assert_eq!(rig.finish(&name, 60 * S), JobState::Succeeded);
    assert_eq!(rig.node("left").taken.len(), COUNT);
    let mut signatures = Vec::new();
    for (_, proof, from, inside) in proved(&rig) {
        let chain = inside
            .iter()
            .rev()
            .fold(proof.after, |after, command| link_command(command, &after));
        assert_eq!(chain, root_of_commands(&commands[from..]), "from {from}");
        signatures.push(proof.signature());
    }
    assert!(signatures.len() > 10, "it was cut into orders");
    signatures.dedup();
    assert_eq!(signatures.len(), 1, "signed once, by the operator");
}

#[test]
fn a_gateway_with_signers_refuses_what_a_node_would_refuse_and_says_why() {
    let Plant {
        mut rig,
        alice,
        mallory,
    } = plant();
    let job = moves("a", 3, 1_000);
    let good = sign(&mut rig, &alice, job.clone(), 1);
    let foreign = sign(&mut rig, &mallory, job.clone(), 1);
    let mut renamed = good.clone();
    renamed["id"] = json!("b");
    let mut longer = good.clone();
    longer["commands"] = moves("a", 4, 1_000)["commands"].clone();
    let mut cut = good.clone();
    cut["signature"]["signature"] = json!("00");
    for (job, code, words) in [
        (&job, "not_allowed", "has to sign"),
        (&foreign, "not_allowed", "nobody"),
        (&renamed, "not_allowed", "not the signature of this job"),
        (&longer, "not_allowed", "not the signature of this job"),
        (&cut, "bad_json", "128 hexadecimal digits"),
    ] {
        let (found, message) = rig.refuse("left", job);
        assert_eq!(found, code, "{message}");
        assert!(message.contains(words), "{message}");
    }
    rig.reboot("left");
    rig.run(2 * S);
    let (code, message) = rig.refuse("left", &good);
    assert!(
        code == "not_allowed" && message.contains("earlier start"),
        "{message}"
    );
    let again = sign(&mut rig, &alice, job, 2);
    let name = rig.accept("left", &again);
    assert_eq!(rig.finish(&name, 5 * S), JobState::Succeeded);
    rig.run(10 * MS);
    assert_eq!(rig.node("left").taken.len(), 3);
}

/// Signs each part of a synchronized job, as the operator's client does.
fn sign_parts(rig: &mut Rig, signer: &Signer, mut job: Value, number: u64) -> Value {
    let request = GroupRequest::from_json(job.to_string().as_bytes()).expect("legal");
    let name = request.id.expect("it has one");
    for (node, commands) in parts_of(&request) {
        let script = match &request.nodes[&node] {
            Work::Lua(text) => Some(text.as_str()),
            Work::Commands(_) => None,
        };
        let boot = rig.node(node.as_str()).queue.boot;
        let root = root_of(&commands, script).expect("short");
        let signature = signer.sign(&statement(&node, &name, boot, number, root));
        job["nodes"][node.as_str()]["signature"] = serde_json::to_value(signature).expect("JSON");
    }
    job
}

/// A second node beside the one with the short ring, and both can start together.
fn pair() -> Plant {
    let mut plant = plant();
    plant.rig.add("right");
    for name in ["left", "right"] {
        plant.rig.node(name).features = Features::BASIC.with(Features::BARRIERS);
    }
    plant.rig.run(10 * S);
    plant
}

fn together(name: &str) -> Value {
    let commands = |count: usize| {
        let mut commands = moves("x", count, 100)["commands"].clone();
        let meeting = json!({"barrier": {"name": "half"}});
        commands.as_array_mut().expect("a list").insert(1, meeting);
        commands
    };
    json!({"id": name, "nodes": {"left": {"commands": commands(300)}, "right": {"commands": commands(3)}}})
}

#[test]
fn each_part_of_a_signed_synchronized_job_proves_itself_also_after_a_restart_of_the_gateway() {
    let Plant { mut rig, alice, .. } = pair();
    let job = sign_parts(&mut rig, &alice, together("both"), 1);
    let request = GroupRequest::from_json(job.to_string().as_bytes()).expect("legal");
    let parts = parts_of(&request);
    let name = rig.accept_group(&job);
    rig.run(2 * S);
    rig.restart_gateway();
    assert_eq!(rig.finish(&name, 60 * S), JobState::Succeeded);
    let mut counts = std::collections::BTreeMap::new();
    for (node, proof, from, inside) in proved(&rig) {
        let chain = root_before(&inside, proof.after);
        assert_eq!(
            chain,
            root_of_commands(&parts[&node][from..]),
            "{node} from {from}"
        );
        *counts.entry(node).or_insert(0) += inside.len();
    }
    // The barrier of the start and the one in the middle are of it.
    assert_eq!(parts[&NodeId::new("right").expect("legal")].len(), 5);
    assert_eq!(counts.len(), 2, "{counts:?}");
}

#[test]
fn a_synchronized_job_of_which_one_part_is_not_signed_as_it_is_moves_nobody() {
    let Plant {
        mut rig,
        alice,
        mallory,
    } = pair();
    let good = sign_parts(&mut rig, &alice, together("g"), 1);
    let mut half = good.clone();
    half["nodes"]["right"]
        .as_object_mut()
        .expect("a part")
        .remove("signature");
    let mut swapped = good.clone();
    swapped["nodes"]["right"]["signature"] = good["nodes"]["left"]["signature"].clone();
    let mut renamed = good.clone();
    renamed["id"] = json!("h");
    let mut shorter = good.clone();
    shorter["nodes"]["right"]["commands"]
        .as_array_mut()
        .expect("a list")
        .remove(0);
    let mut nameless = good.clone();
    nameless.as_object_mut().expect("a job").remove("id");
    let foreign = sign_parts(&mut rig, &mallory, together("g"), 1);
    for (job, words) in [
        (&together("g"), "has to sign"),
        (&half, "nodes.right: an operator has to sign"),
        // It names the other node's boot.
        (
            &swapped,
            "nodes.right: signature: it is for an earlier start",
        ),
        (&renamed, "not the signature of this job"),
        (&shorter, "nodes.right: signature: it is not the signature"),
        (&nameless, "`id` is missing"),
        (&foreign, "nobody"),
    ] {
        let (code, message) = rig.refuse_group(job);
        assert_eq!(code, "not_allowed", "{message}");
        assert!(message.contains(words), "{message}");
    }
    rig.run(2 * S);
    assert!(rig.node("left").taken.is_empty() && rig.node("right").taken.is_empty());
    let name = rig.accept_group(&good);
    assert_eq!(rig.finish(&name, 60 * S), JobState::Succeeded);
}
