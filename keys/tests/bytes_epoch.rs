//! The exact bytes before a message of a gateway with an epoch, and of a node's answer to an older one.
//!
//! If a test here fails, do not change the test: nodes and gateways in the field speak these bytes.

use keys::{Refusal, epoch, version};

#[test]
fn an_epoch_is_these_bytes_before_a_message() {
    assert_eq!(epoch::mark(0).as_slice(), [0_u8; 0]);
    assert_eq!(epoch::mark(7).as_slice(), [0x45, 7]);
    let of_2026 = [0x45, 0xb0, 0x98, 0x84, 0xd8, 0x06];
    assert_eq!(epoch::mark(1_795_230_768).as_slice(), of_2026);
    let whole = [&of_2026[..], &[1, 2, 3]].concat();
    assert_eq!(epoch::split(&whole), Ok((1_795_230_768, &[1, 2, 3][..])));
}

#[test]
fn a_node_that_obeys_another_gateway_says_so_by_this_number() {
    let mut buffer = [0; 8];
    let refusal = Refusal::Superseded { epoch: 300 };
    let bytes = version::encode(&refusal, &mut buffer).expect("room");
    assert_eq!(bytes, [1, 10, 0xac, 0x02]);
    assert_eq!(version::decode::<Refusal>(bytes), Ok(refusal));
}
