//! What may stand before an order: an epoch, and the proof that somebody signed it. What is read is the
//! same when it is written and read again; and whatever numbers it has, it includes no order that ends
//! behind what was signed.

use keys::{
    BatchHeader, JobId, QueueId, epoch,
    signed::{PROOF_BYTES_MAX, Proof},
};

/// See the module. The last 18 bytes are an order's numbers as well.
pub fn check(data: &[u8]) {
    let Ok((number, rest)) = epoch::split(data) else {
        return;
    };
    let again = [epoch::mark(number).as_slice(), rest].concat();
    // A message without a mark and one with epoch 0 say the same.
    if data.first() != Some(&epoch::MARK) || number != 0 {
        assert_eq!(epoch::split(&again), Ok((number, rest)));
    }
    let Ok((Some(proof), order)) = Proof::split(rest) else {
        return;
    };
    let mut buffer = [0; PROOF_BYTES_MAX];
    let used = proof.write(&mut buffer).expect("room for the longest");
    let again = [&buffer[..used], order].concat();
    assert_eq!(Proof::split(&again), Ok((Some(proof), order)));
    assert!(proof.is_of(&proof));
    let mut numbers = [0; 18];
    for (number, byte) in numbers.iter_mut().zip(data.iter().rev()) {
        *number = *byte;
    }
    let long = |at: usize| u64::from_le_bytes(numbers[at..at + 8].try_into().expect("eight"));
    let header = BatchHeader {
        queue: QueueId { boot: 7, flush: 0 },
        first_command: long(0),
        command_count: u16::from_le_bytes([numbers[16], numbers[17]]),
        job: JobId::new("a").expect("legal"),
        job_end: long(8),
    };
    for job_end in [header.job_end, proof.end()] {
        let header = BatchHeader { job_end, ..header };
        if proof.includes(&header) {
            let last = u128::from(header.first_command) + u128::from(header.command_count);
            assert!(last <= u128::from(proof.end()), "{header:?} {proof:?}");
        }
    }
}

/// A proof with and without an epoch, at both ends of the numbers.
pub fn seeds() -> Vec<Vec<u8>> {
    let mut seeds = Vec::new();
    for (first_command, command_count) in [(0, 3), (u64::MAX - 1, 1), (u64::MAX, u64::MAX)] {
        let proof = Proof {
            key: [1; 32],
            number: 1_795_230_000_000_000,
            first_command,
            command_count,
            root: [2; 32],
            signature: [[3; 32], [4; 32]],
            after: [5; 32],
        };
        let mut buffer = [0; PROOF_BYTES_MAX];
        let used = proof.write(&mut buffer).expect("room");
        for number in [0, 1, u32::MAX] {
            let mark = epoch::mark(number);
            seeds.push([mark.as_slice(), &buffer[..used], &[0xff; 18]].concat());
        }
    }
    seeds.push(vec![epoch::MARK, 0x80, 0x80, 0x80, 0x80, 0x10]);
    seeds
}
