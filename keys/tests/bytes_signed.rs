//! The exact bytes of what operators sign and nodes verify.
//!
//! If a test here fails, do not change the test: signatures that were made before would be worth
//! nothing, and nodes in the field verify these bytes.
#![cfg(feature = "signed")]

use keys::{
    JobId, NodeId, Refusal,
    signed::{END, Proof, Statement, link, root_of_script},
};

fn hex(bytes: &[u8]) -> String {
    bytes.iter().map(|byte| format!("{byte:02x}")).collect()
}

#[test]
fn a_statement_is_signed_in_these_bytes() {
    let statement = Statement {
        node: &NodeId::new("left").expect("legal"),
        boot: 0x0102_0304,
        job: &JobId::new("a-1").expect("legal"),
        number: 5,
        command_count: 6,
        root: [7; 32],
    };
    let expected = [
        b"stepfleet job 1\0".as_slice(),
        b"\x04left\x03a-1",
        &[4, 3, 2, 1],
        &[5, 0, 0, 0, 0, 0, 0, 0],
        &[6, 0, 0, 0, 0, 0, 0, 0],
        &[7; 32],
    ];
    assert_eq!(statement.bytes().as_slice(), expected.concat());
}

#[test]
fn the_chain_and_the_root_of_a_script_are_these_hashes() {
    let expected = "cf32617f2a61f623ef7b28ff1a9ac6578c8ba66a4ef344c8ad91c83cf0da09a2";
    assert_eq!(hex(&link(&[0, 7], &END)), expected);
    let expected = "cb804773481a6a64069c57f3176f1a693a4af3dc38c4276b0234e5515a1b6303";
    assert_eq!(hex(&root_of_script(b"motor.execute()")), expected);
}

#[test]
fn a_proof_travels_in_these_bytes() {
    let proof = Proof {
        key: [1; 32],
        number: 300,
        first_command: 10,
        command_count: 5,
        root: [2; 32],
        signature: [[3; 32], [4; 32]],
        after: [5; 32],
    };
    let mut buffer = [0; 256];
    let used = proof.write(&mut buffer).expect("room");
    let expected = [
        [0x53].as_slice(),
        &[1; 32],
        &[0xac, 0x02, 10, 5],
        &[2; 32],
        &[3; 32],
        &[4; 32],
        &[5; 32],
    ];
    assert_eq!(&buffer[..used], expected.concat());
    assert_eq!(Proof::split(&buffer[..used]), Ok((Some(proof), &[][..])));
}

#[test]
fn a_node_that_asks_for_signatures_says_so_by_this_number() {
    let mut buffer = [0; 4];
    let bytes = keys::version::encode(&Refusal::NotSigned, &mut buffer).expect("room");
    assert_eq!(hex(bytes), "0109");
}
