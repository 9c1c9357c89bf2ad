//! A stream gives the same batches however it is cut, and none that is longer than was agreed.

use super::Input;
use pico::reader::{BatchReader, ReadError};

fn all(chunks: impl Iterator<Item = Vec<u8>>, most: u16) -> (Vec<Vec<u8>>, Option<ReadError>) {
    let mut reader = BatchReader::new(most);
    let mut batches = Vec::new();
    for chunk in chunks {
        if let Err(error) = reader.push(&chunk) {
            return (batches, Some(error));
        }
        loop {
            match reader.next_batch() {
                Ok(Some(batch)) => {
                    assert!(batch.len() <= usize::from(most));
                    batches.push(batch.to_vec());
                }
                Ok(None) => break,
                Err(error) => return (batches, Some(error)),
            }
        }
    }
    (batches, None)
}

/// The first two bytes bound a batch, the third says how to cut.
pub fn check(data: &[u8]) {
    let mut input = Input(data);
    let most = input.short();
    let piece = usize::from(input.byte()) + 1;
    let stream = input.0;
    let whole = all(stream.chunks(4096).map(<[u8]>::to_vec), most);
    let cut = all(stream.chunks(piece).map(<[u8]>::to_vec), most);
    assert_eq!(cut, whole);
}

/// Small batches, an empty one, one that is too long.
pub fn seeds() -> Vec<Vec<u8>> {
    vec![
        [&[16, 0, 0][..], &[2, 0, 1, 2, 0, 0, 1, 0, 9, 3, 0, 4, 5, 6]].concat(),
        [&[16, 0, 2][..], &[17, 0, 1]].concat(),
        [&[255, 255, 6][..], &[0; 300]].concat(),
    ]
}
