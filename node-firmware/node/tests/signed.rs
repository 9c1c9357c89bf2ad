//! Attempts on a node that executes only what an operator has signed. Whoever makes them has the
//! whole network: every order that was ever sent, and every field of it to change.

mod rig;

use ed25519_dalek::{Signer as _, SigningKey};
use keys::{
    BatchHeader, Command, NodeId, NodeTopic, Order, QueueId, Refusal, ScriptHeader, StopMode,
    Verdict,
    batch::ORDER_BYTES_MAX,
    signed::{
        END, Hash, PROOF_BYTES_MAX, Proof, Statement, link_command, root_before, root_of_commands,
        root_of_script,
    },
    start::StartMessage,
    version,
};
use rig::{Rig, batch_bytes, config, job, steps};

const NOT_SIGNED: Verdict = Verdict::Refused(Refusal::NotSigned);

struct Operator(SigningKey);

impl Operator {
    fn new(secret: u8) -> Self {
        Self(SigningKey::from_bytes(&[secret; 32]))
    }

    fn key(&self) -> Hash {
        self.0.verifying_key().to_bytes()
    }

    fn proof(&self, statement: &Statement<'_>, first_command: u64) -> Proof {
        let signature = self.0.sign(&statement.bytes()).to_bytes();
        let half = |from: usize| {
            let mut half = END;
            half.copy_from_slice(&signature[from..from + 32]);
            half
        };
        Proof {
            key: self.key(),
            number: statement.number,
            first_command,
            command_count: statement.command_count,
            root: statement.root,
            signature: [half(0), half(32)],
            after: END,
        }
    }

    /// Signs these commands for the rig's node as it is now.
    fn commands(&self, rig: &Rig, number: u64, commands: &[Command]) -> Signed {
        let header = rig.next_header(commands.len());
        let statement = Statement {
            node: &NodeId::new("left").expect("legal"),
            boot: header.queue.boot,
            job: &header.job,
            number,
            command_count: commands.len() as u64,
            root: root_of_commands(commands),
        };
        Signed {
            proof: self.proof(&statement, header.first_command),
            header,
            commands: commands.to_vec(),
        }
    }
}

/// A job on its way, as anybody in between sees it.
#[derive(Clone)]
struct Signed {
    proof: Proof,
    header: BatchHeader,
    commands: Vec<Command>,
}

impl Signed {
    /// The order with the commands of this range.
    fn order(&self, from: usize, to: usize) -> Vec<u8> {
        let header = BatchHeader {
            first_command: self.header.first_command + from as u64,
            ..self.header
        };
        let behind = self.commands[to..].iter().rev();
        let after = behind.fold(END, |after, command| link_command(command, &after));
        let proof = Proof {
            after,
            ..self.proof
        };
        wrap(&proof, &batch_bytes(header, &self.commands[from..to]))
    }

    fn whole(&self) -> Vec<u8> {
        self.order(0, self.commands.len())
    }
}

fn wrap(proof: &Proof, order: &[u8]) -> Vec<u8> {
    let mut buffer = [0; PROOF_BYTES_MAX];
    let used = proof.write(&mut buffer).expect("room");
    [&buffer[..used], order].concat()
}

fn secured(operators: &[&Operator]) -> Rig {
    let mut config = config();
    for operator in operators {
        config.signers.push(operator.key()).expect("room");
    }
    Rig::new(config)
}

const JOB: [i32; 5] = [10, 20, 30, 40, 50];

fn commands() -> Vec<Command> {
    JOB.map(steps).to_vec()
}

#[test]
fn a_signed_job_is_executed_however_it_is_cut_into_orders() {
    let alice = Operator::new(1);
    for cuts in [
        vec![0, 5],
        vec![0, 1, 5],
        vec![0, 2, 3, 4, 5],
        vec![0, 4, 5],
    ] {
        let mut rig = secured(&[&alice]);
        let signed = alice.commands(&rig, 1, &commands());
        for cut in cuts.windows(2) {
            let ack = rig.order_bytes(&signed.order(cut[0], cut[1]));
            assert_eq!(ack.verdict, Verdict::Accepted, "{cuts:?}");
            let again = rig.order_bytes(&signed.order(cut[0], cut[1]));
            assert_eq!(again.verdict, Verdict::Duplicate);
        }
        rig.run_for(1_000_000);
        assert_eq!(rig.position(), 150);
    }
}

#[test]
fn nothing_that_was_not_signed_moves_the_node() {
    let (alice, mallory) = (Operator::new(1), Operator::new(2));
    let mut rig = secured(&[&alice]);
    let signed = alice.commands(&rig, 1, &commands());
    let plain = batch_bytes(signed.header, &signed.commands);
    let forged = mallory.commands(&rig, 1, &commands());
    let mut more = signed.clone();
    more.commands[2] = steps(31);
    let mut swapped = signed.clone();
    swapped.commands.swap(0, 1);
    let mut other_job = signed.clone();
    other_job.header.job = job("other");
    let mut longer = signed.clone();
    longer.commands.push(steps(60));
    longer.header.job_end += 1;
    longer.proof.command_count += 1;
    let mut shorter = signed.clone();
    shorter.commands.pop();
    shorter.header.job_end -= 1;
    shorter.proof.command_count -= 1;
    let mut borrowed = forged.clone();
    borrowed.proof.key = alice.key();
    let mut renumbered = signed.clone();
    renumbered.proof.number = 2;
    let mut skipping = signed.clone();
    // As if the first command had been executed before.
    skipping.proof.first_command -= u64::from(skipping.proof.first_command > 0);
    skipping.commands.remove(0);
    let end_early = wrap(
        &Proof {
            after: END,
            ..signed.proof
        },
        &batch_bytes(signed.header, &signed.commands[..2]),
    );
    for (what, order) in [
        ("no proof", plain),
        ("another's signature", forged.whole()),
        ("another's signature with her key", borrowed.whole()),
        ("another command", more.whole()),
        ("another order of commands", swapped.whole()),
        ("another name", other_job.whole()),
        ("a command more", longer.whole()),
        ("a command less", shorter.whole()),
        ("another number", renumbered.whole()),
        ("without the first", skipping.order(0, 4)),
        ("a wrong chain", end_early),
    ] {
        assert_eq!(rig.order_bytes(&order).verdict, NOT_SIGNED, "{what}");
    }
    rig.run_for(1_000_000);
    assert_eq!(rig.position(), 0);
    // And what was signed is still good.
    assert_eq!(rig.order_bytes(&signed.whole()).verdict, Verdict::Accepted);
}

#[test]
fn a_command_that_was_changed_on_the_way_is_noticed_before_it_moves_anything() {
    let alice = Operator::new(1);
    let mut rig = secured(&[&alice]);
    let signed = alice.commands(&rig, 1, &commands());
    let ack = rig.order_bytes(&signed.order(0, 2));
    assert_eq!(ack.verdict, Verdict::Accepted);
    let mut changed = signed.clone();
    changed.commands[2] = steps(-30);
    assert_eq!(rig.order_bytes(&changed.order(2, 5)).verdict, NOT_SIGNED);
    let ack = rig.order_bytes(&signed.order(2, 5));
    assert_eq!(ack.verdict, Verdict::Accepted, "it goes on where it was");
    rig.run_for(1_000_000);
    assert_eq!(rig.position(), 150);
}

#[test]
fn a_signed_job_that_is_replayed_does_nothing() {
    let alice = Operator::new(1);
    let mut rig = secured(&[&alice]);
    let signed = alice.commands(&rig, 1, &commands());
    rig.order_bytes(&signed.whole());
    rig.run_for(1_000_000);
    assert_eq!(rig.position(), 150);
    let replay = |rig: &Rig| {
        let mut replay = signed.clone();
        let next = rig.next_header(JOB.len());
        replay.header = next;
        replay.proof.first_command = next.first_command;
        replay.whole()
    };
    // As it was, and at the place that is next now.
    assert_eq!(rig.order_bytes(&signed.whole()).verdict, Verdict::Duplicate);
    let again = replay(&rig);
    assert_eq!(rig.order_bytes(&again).verdict, NOT_SIGNED);
    // In the queue after a stop.
    rig.stop(StopMode::Halt);
    rig.run_for(1_000_000);
    rig.release(rig.queue());
    let again = replay(&rig);
    assert_eq!(rig.order_bytes(&again).verdict, NOT_SIGNED);
    // After many others, when its number is forgotten.
    for number in 2..40 {
        let other = alice.commands(&rig, number, &[steps(1)]);
        assert_eq!(rig.order_bytes(&other.whole()).verdict, Verdict::Accepted);
    }
    let again = replay(&rig);
    assert_eq!(rig.order_bytes(&again).verdict, NOT_SIGNED);
    // Of the life before: a boot has a random number, and it is signed.
    let mut earlier = signed.clone();
    earlier.header = rig.next_header(JOB.len());
    earlier.proof.first_command = earlier.header.first_command;
    earlier.header.queue = QueueId { boot: 6, flush: 0 };
    let verdict = rig.order_bytes(&earlier.whole()).verdict;
    assert_eq!(verdict, Verdict::Refused(Refusal::Stale));
    rig.run_for(1_000_000);
    assert_eq!(rig.position(), 150 + 38);
}

#[test]
fn jobs_of_one_life_may_come_in_another_order_than_they_were_signed_but_not_twice() {
    let alice = Operator::new(1);
    let mut rig = secured(&[&alice]);
    for (number, verdict) in [
        (10, Verdict::Accepted),
        (7, Verdict::Accepted),
        (10, NOT_SIGNED),
        (8, Verdict::Accepted),
        (7, NOT_SIGNED),
    ] {
        let one = alice.commands(&rig, number, &[steps(1)]);
        assert_eq!(rig.order_bytes(&one.whole()).verdict, verdict, "{number}");
    }
}

#[test]
fn a_script_runs_if_it_is_the_one_that_was_signed() {
    let alice = Operator::new(1);
    let mut rig = secured(&[&alice]);
    let text = b"motor.queue_move(0, 100, 25) wait_idle()";
    let order = |rig: &Rig, text: &[u8], number, signed_text: &[u8]| {
        let next = rig.next_header(0);
        let statement = Statement {
            node: &NodeId::new("left").expect("legal"),
            boot: next.queue.boot,
            job: &next.job,
            number,
            command_count: 0,
            root: root_of_script(signed_text),
        };
        let header = ScriptHeader {
            queue: next.queue,
            first_command: next.first_command,
            job: next.job,
            offset_bytes: 0,
            total_bytes: text.len() as u32,
        };
        let mut buffer = [0; ORDER_BYTES_MAX];
        let bytes = version::encode(&Order::Script(header), &mut buffer).expect("room");
        let bytes = [bytes, text].concat();
        (
            wrap(&alice.proof(&statement, next.first_command), &bytes),
            bytes,
        )
    };
    let (_, unsigned) = order(&rig, text, 1, text);
    assert_eq!(rig.order_bytes(&unsigned).verdict, NOT_SIGNED);
    let (changed, _) = order(&rig, b"motor.queue_move(0, 100, 26) wait_idle()", 1, text);
    assert_eq!(rig.order_bytes(&changed).verdict, NOT_SIGNED);
    let (signed, _) = order(&rig, text, 1, text);
    assert_eq!(rig.order_bytes(&signed).verdict, Verdict::Accepted);
    rig.run_for(2_000_000);
    assert_eq!(rig.position(), 25);
    let (again, _) = order(&rig, text, 1, text);
    assert_eq!(rig.order_bytes(&again).verdict, NOT_SIGNED, "replayed");
    rig.run_for(2_000_000);
    assert_eq!(rig.position(), 25);
}

/// Lets the node start at the barrier that has this number.
fn start(rig: &mut Rig, command: u64) {
    rig.run_for(10_000);
    let queue = rig.queue();
    let commit = StartMessage::Commit {
        queue,
        command,
        start_at: rig.now.plus_us(400_000),
        confirm_by: rig.now.plus_us(200_000),
    };
    for message in [commit, StartMessage::Confirm { queue, command }] {
        let mut buffer = [0; 64];
        let bytes = version::encode(&message, &mut buffer).expect("room");
        let bytes = bytes.to_vec();
        rig.put(NodeTopic::Start, &bytes);
        rig.drain();
    }
    rig.run_for(2_000_000);
}

fn barrier(barrier: u16) -> Command {
    Command::Barrier { barrier }
}

#[test]
fn a_part_of_a_synchronized_job_is_signed_with_its_meeting_points() {
    let alice = Operator::new(1);
    let mut rig = secured(&[&alice]);
    let part = [barrier(0), steps(10), barrier(1), steps(20)];
    let signed = alice.commands(&rig, 1, &part);
    let without = |index: usize| {
        let mut changed = signed.clone();
        changed.commands.remove(index);
        changed.order(0, 3)
    };
    let with = |index: usize, command| {
        let mut changed = signed.clone();
        changed.commands[index] = command;
        changed.whole()
    };
    let mut early = signed.clone();
    early.commands.swap(1, 2);
    for (what, order) in [
        ("at once", without(0)),
        ("through the second meeting point", without(2)),
        ("at another meeting point", with(2, barrier(2))),
        ("a meeting point for a command", with(1, barrier(1))),
        ("a command for a meeting point", with(2, steps(1))),
        ("before the meeting point", early.whole()),
    ] {
        assert_eq!(rig.order_bytes(&order).verdict, NOT_SIGNED, "{what}");
    }
    assert_eq!(rig.order_bytes(&signed.whole()).verdict, Verdict::Accepted);
    rig.run_for(1_000_000);
    assert_eq!(rig.position(), 0, "it waits for the others");
    start(&mut rig, 0);
    assert_eq!(rig.position(), 10);
    start(&mut rig, 2);
    assert_eq!(rig.position(), 30);
    let mut replay = signed.clone();
    replay.header = rig.next_header(part.len());
    replay.proof.first_command = replay.header.first_command;
    assert_eq!(rig.order_bytes(&replay.whole()).verdict, NOT_SIGNED);
}

/// A script behind the barrier of a start, as anybody in between sees it.
struct SignedScript {
    proof: Proof,
    header: BatchHeader,
}

const PART_SCRIPT: &[u8] = b"motor.queue_move(0, 100, 25) wait_idle()";

impl SignedScript {
    fn new(operator: &Operator, rig: &Rig, number: u64) -> Self {
        let mut header = rig.next_header(1);
        header.job_end += 1;
        let script = root_of_script(PART_SCRIPT);
        let statement = Statement {
            node: &NodeId::new("left").expect("legal"),
            boot: header.queue.boot,
            job: &header.job,
            number,
            command_count: 2,
            root: root_before(&[barrier(0)], script),
        };
        let proof = Proof {
            after: script,
            ..operator.proof(&statement, header.first_command)
        };
        Self { proof, header }
    }

    fn barrier(&self) -> Vec<u8> {
        wrap(&self.proof, &batch_bytes(self.header, &[barrier(0)]))
    }

    /// A script as the command of this number.
    fn script(&self, number: u64, text: &[u8]) -> Vec<u8> {
        let header = ScriptHeader {
            queue: self.header.queue,
            first_command: number,
            job: self.header.job,
            offset_bytes: 0,
            total_bytes: text.len() as u32,
        };
        let mut buffer = [0; ORDER_BYTES_MAX];
        let bytes = version::encode(&Order::Script(header), &mut buffer).expect("room");
        wrap(&self.proof, &[bytes, text].concat())
    }
}

#[test]
fn the_script_of_a_part_runs_behind_its_barrier_and_never_without_it() {
    let alice = Operator::new(1);
    let mut rig = secured(&[&alice]);
    let signed = SignedScript::new(&alice, &rig, 1);
    let verdict = |rig: &mut Rig, order: &[u8]| rig.order_bytes(order).verdict;
    // In place of the barrier it would run at once.
    assert_eq!(
        verdict(&mut rig, &signed.script(0, PART_SCRIPT)),
        NOT_SIGNED
    );
    let mut ends_early = SignedScript::new(&alice, &rig, 1);
    ends_early.proof.after = END;
    assert_eq!(verdict(&mut rig, &ends_early.barrier()), NOT_SIGNED);
    assert_eq!(verdict(&mut rig, &signed.barrier()), Verdict::Accepted);
    let other = signed.script(1, b"motor.queue_move(0, 100, 26) wait_idle()");
    assert_eq!(verdict(&mut rig, &other), NOT_SIGNED);
    let script = signed.script(1, PART_SCRIPT);
    assert_eq!(verdict(&mut rig, &script), Verdict::Accepted);
    rig.run_for(1_000_000);
    assert_eq!(rig.position(), 0, "it waits for the others");
    start(&mut rig, 0);
    assert_eq!(rig.position(), 25);
    // Replayed: at its place, behind it, and as a whole.
    assert_eq!(verdict(&mut rig, &script), Verdict::Duplicate);
    let next = rig.next_header(1).first_command;
    assert_eq!(
        verdict(&mut rig, &signed.script(next, PART_SCRIPT)),
        NOT_SIGNED
    );
    let mut replay = SignedScript::new(&alice, &rig, 1);
    replay.proof.signature = signed.proof.signature;
    assert_eq!(verdict(&mut rig, &replay.barrier()), NOT_SIGNED);
    rig.run_for(1_000_000);
    assert_eq!(rig.position(), 25);
}

#[test]
fn a_node_without_keys_takes_orders_with_proof_and_without() {
    let alice = Operator::new(1);
    let mut rig = secured(&[]);
    let signed = alice.commands(&rig, 1, &commands());
    assert_eq!(rig.order_bytes(&signed.whole()).verdict, Verdict::Accepted);
    assert_eq!(rig.batch(&[steps(1)]).verdict, Verdict::Accepted);
}
