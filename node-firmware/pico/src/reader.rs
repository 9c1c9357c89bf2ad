//! Cuts a byte stream into batches.
//!
//! ```text
//!  +---------+---------+------------------+---------+---------+---
//!  | len: u16 little endian | batch: len bytes | len          | …
//!  +---------+---------+------------------+---------+---------+---
//! ```
//!
//! Owns the input that is not yet a whole batch. Promises that chunks may be cut anywhere and
//! that nothing is lost when a read is cancelled: partial input lives here, never in a future.
//! Knows nothing of what a batch contains.

use alloc::{sync::Arc, vec::Vec};

use zenoh_buffers::ZSlice;

use crate::limits::INPUT_BYTES_MAX;

/// Why input cannot be cut into batches.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum ReadError {
    /// A batch is longer than was agreed.
    Oversized,
    /// More input waits than [`INPUT_BYTES_MAX`].
    Full,
}

/// Keeps partial batches between reads.
#[derive(Debug)]
pub struct BatchReader {
    waiting: Vec<u8>,
    /// Where the next batch starts in `waiting`; everything before is consumed.
    start: usize,
    batch_bytes_max: usize,
}

impl BatchReader {
    /// A reader that refuses batches of more than `batch_bytes_max` bytes.
    pub fn new(batch_bytes_max: u16) -> Self {
        Self {
            waiting: Vec::new(),
            start: 0,
            batch_bytes_max: usize::from(batch_bytes_max),
        }
    }

    /// Forgets all input and changes the bound: a new connection starts.
    pub fn reset(&mut self, batch_bytes_max: u16) {
        self.waiting.clear();
        self.start = 0;
        self.batch_bytes_max = usize::from(batch_bytes_max);
    }

    /// Changes the bound after negotiation; input that waits is kept.
    pub fn set_batch_bytes_max(&mut self, batch_bytes_max: u16) {
        self.batch_bytes_max = usize::from(batch_bytes_max);
    }

    /// How many bytes wait to be taken as batches.
    pub fn waiting_bytes(&self) -> usize {
        self.waiting.len() - self.start
    }

    /// Takes a chunk of input, cut anywhere.
    ///
    /// # Errors
    /// [`ReadError::Full`] if more than [`INPUT_BYTES_MAX`] would wait; nothing is taken then.
    pub fn push(&mut self, bytes: &[u8]) -> Result<(), ReadError> {
        if self.waiting_bytes() + bytes.len() > INPUT_BYTES_MAX {
            return Err(ReadError::Full);
        }
        if self.start == self.waiting.len() {
            self.waiting.clear();
            self.start = 0;
        } else if self.start >= self.waiting.len() / 2 {
            self.waiting.drain(..self.start);
            self.start = 0;
        }
        self.waiting.extend_from_slice(bytes);
        Ok(())
    }

    /// The next whole batch, without its length; it is taken.
    ///
    /// # Errors
    /// [`ReadError::Oversized`] as soon as the length is known; the stream cannot go on.
    pub fn next_batch(&mut self) -> Result<Option<&[u8]>, ReadError> {
        let waiting = &self.waiting[self.start..];
        let Some((length, rest)) = waiting.split_first_chunk::<2>() else {
            return Ok(None);
        };
        let batch_bytes = usize::from(u16::from_le_bytes(*length));
        if batch_bytes > self.batch_bytes_max {
            return Err(ReadError::Oversized);
        }
        let Some(batch) = rest.get(..batch_bytes) else {
            return Ok(None);
        };
        self.start += 2 + batch_bytes;
        Ok(Some(batch))
    }
}

/// Memory for the batch that is decoded, in the form that the codec shares parts of. It is used
/// again as soon as nobody holds a part, so a message costs no memory but its own. Keeps the longest
/// batch so far: at most what was agreed.
#[derive(Debug, Default)]
pub(crate) struct BatchMemory(Arc<Vec<u8>>);

impl BatchMemory {
    /// Copies a batch and gives the whole of it.
    pub(crate) fn hold(&mut self, batch: &[u8]) -> ZSlice {
        if Arc::get_mut(&mut self.0).is_none() {
            self.0 = Arc::default();
        }
        let bytes = Arc::get_mut(&mut self.0).expect("it is new, or nobody shares it");
        bytes.clear();
        bytes.extend_from_slice(batch);
        ZSlice::new(self.0.clone(), 0, batch.len()).expect("it is as long as it is")
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use alloc::vec;

    fn batches(reader: &mut BatchReader) -> Vec<Vec<u8>> {
        let mut batches = Vec::new();
        while let Some(batch) = reader.next_batch().unwrap() {
            batches.push(batch.to_vec());
        }
        batches
    }

    #[test]
    fn batches_are_the_same_however_the_stream_is_cut() {
        let stream = [2, 0, 1, 2, 0, 0, 1, 0, 9, 3, 0, 4, 5, 6];
        let whole = vec![vec![1, 2], vec![], vec![9], vec![4, 5, 6]];
        for piece in 1..=stream.len() {
            let mut reader = BatchReader::new(16);
            let mut taken = Vec::new();
            for chunk in stream.chunks(piece) {
                reader.push(chunk).unwrap();
                taken.extend(batches(&mut reader));
            }
            assert_eq!(taken, whole, "pieces of {piece}");
            assert_eq!(reader.waiting_bytes(), 0);
        }
    }

    #[test]
    fn a_batch_beyond_the_bound_is_refused_before_it_arrives() {
        let mut reader = BatchReader::new(16);
        reader.push(&[17, 0]).unwrap();
        assert_eq!(reader.next_batch(), Err(ReadError::Oversized));
    }

    #[test]
    #[cfg_attr(miri, ignore = "thirty thousand batches")]
    fn input_that_nobody_takes_is_refused_at_the_bound_and_not_half_taken() {
        let mut reader = BatchReader::new(16);
        reader.push(&vec![0; INPUT_BYTES_MAX]).unwrap();
        assert_eq!(reader.push(&[0]), Err(ReadError::Full));
        assert_eq!(reader.waiting_bytes(), INPUT_BYTES_MAX);
        assert_eq!(batches(&mut reader).len(), INPUT_BYTES_MAX / 2);
        reader.push(&[0, 0]).unwrap();
        assert_eq!(batches(&mut reader).len(), 1);
    }
}
