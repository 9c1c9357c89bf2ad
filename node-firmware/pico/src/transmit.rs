//! The bounded queue of outgoing messages, and how they become batches.
//!
//! ```text
//!  push ─▶ lane 0 control   ─┐
//!          lane 1 real-time ─┼─▶ batch: len │ Frame(sn) m m m │ Frame(sn) m m │
//!          …                 │          len │ Fragment(sn, first, more) ▒▒▒▒▒ │
//!          lane 7 background ┘
//! ```
//!
//! Owns encoded messages, the sequence numbers of what we send, and the chain of a fragmented
//! message that is under way. Promises: order within a lane; a higher lane goes first; a message
//! is queued whole or not at all; lanes 0 and 1 find a reserve when the others are full. Full is
//! answered with [`PushError::Full`]; nothing is ever dropped from here except by `clear`.

use alloc::{collections::VecDeque, vec::Vec};

use zenoh_codec::{WCodec, Zenoh080};
use zenoh_protocol::{
    core::{Priority as WirePriority, Reliability},
    transport::{FragmentHeader, FrameHeader, TransportSn, fragment, frame},
};

use crate::limits::{QUEUE_ENTRY_BYTES, QUEUE_KEEP_BYTES, QUEUE_RESERVE_BYTES, TRANSMIT_BYTES};

/// Control and the seven priorities of the application.
pub(crate) const LANES: usize = 8;
/// The lane of declarations; above all priorities of the application.
pub(crate) const LANE_CONTROL: usize = 0;
/// The last lane that may use the reserve.
const LANE_REAL_TIME: usize = 1;
/// Goes out after everything that was queued before.
pub(crate) const LANE_LAST: usize = LANES - 1;

/// Why a message was not queued.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum PushError {
    Full,
    TooLarge,
}

#[derive(Debug, Clone, Copy)]
struct Entry {
    message_bytes: usize,
    express: bool,
}

#[derive(Debug, Default)]
struct Lane {
    bytes: Vec<u8>,
    /// Where the first message starts in `bytes`; what is before has left.
    start: usize,
    entries: VecDeque<Entry>,
    /// How much of the first message has left in fragments.
    sent_bytes: usize,
}

impl Lane {
    /// The first message, and whether it is express.
    fn front(&self) -> Option<(&[u8], bool)> {
        let entry = self.entries.front()?;
        Some((
            &self.bytes[self.start..self.start + entry.message_bytes],
            entry.express,
        ))
    }

    fn pop(&mut self) -> usize {
        let Some(entry) = self.entries.pop_front() else {
            return 0;
        };
        self.start += entry.message_bytes;
        self.sent_bytes = 0;
        if self.entries.is_empty() {
            self.bytes.clear();
            self.bytes.shrink_to(QUEUE_KEEP_BYTES);
            self.start = 0;
        } else if self.start > self.bytes.len() / 2 {
            self.bytes.drain(..self.start);
            self.start = 0;
        }
        entry.message_bytes + QUEUE_ENTRY_BYTES
    }

    fn clear(&mut self) {
        self.bytes.clear();
        self.bytes.shrink_to(QUEUE_KEEP_BYTES);
        self.start = 0;
        self.entries.clear();
        self.sent_bytes = 0;
    }
}

/// What was agreed with the peer about the way to it.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Terms {
    /// Longest batch, length prefix included.
    pub(crate) batch_bytes: u16,
    /// Every priority has its own sequence.
    pub(crate) qos: bool,
    /// Largest sequence number; one less than a power of two.
    pub(crate) sn_mask: TransportSn,
    /// Of every sequence.
    pub(crate) initial_sn: TransportSn,
    /// The peer understands the markers of first and dropped fragments.
    pub(crate) markers: bool,
}

#[derive(Debug)]
pub(crate) struct TransmitQueue {
    lanes: [Lane; LANES],
    /// One for each lane; without priorities all use the first.
    next_sn: [TransportSn; LANES],
    /// Without priorities: the lane whose chain of fragments nothing may interrupt.
    chain_lane: Option<usize>,
    queued_bytes: usize,
    bytes_max: usize,
    terms: Terms,
}

impl TransmitQueue {
    pub(crate) fn new(bytes_max: usize) -> Self {
        Self {
            lanes: Default::default(),
            next_sn: [0; LANES],
            chain_lane: None,
            queued_bytes: 0,
            bytes_max: bytes_max.max(2 * QUEUE_RESERVE_BYTES),
            terms: Terms {
                batch_bytes: 0,
                qos: false,
                sn_mask: 0,
                initial_sn: 0,
                markers: false,
            },
        }
    }

    /// Starts a connection: empty, with the agreed terms.
    pub(crate) fn open(&mut self, terms: Terms) {
        self.clear();
        self.terms = terms;
        self.next_sn = [terms.initial_sn; LANES];
    }

    /// Drops everything and tells how many messages of the application that were.
    pub(crate) fn clear(&mut self) -> usize {
        let unsent_count = self.lanes[LANE_CONTROL + 1..]
            .iter()
            .map(|l| l.entries.len())
            .sum();
        for lane in &mut self.lanes {
            lane.clear();
        }
        self.chain_lane = None;
        self.queued_bytes = 0;
        unsent_count
    }

    pub(crate) fn is_empty(&self) -> bool {
        self.queued_bytes == 0
    }

    fn bytes_max(&self, lane: usize) -> usize {
        if lane <= LANE_REAL_TIME {
            self.bytes_max
        } else {
            self.bytes_max - QUEUE_RESERVE_BYTES
        }
    }

    /// Queues what `encode` writes. `bytes_hint` is a lower bound of its size, by which a message
    /// that cannot fit is refused before it is encoded.
    pub(crate) fn push<E>(
        &mut self,
        lane: usize,
        express: bool,
        bytes_hint: usize,
        encode: impl FnOnce(&mut Vec<u8>) -> Result<(), E>,
    ) -> Result<(), PushError> {
        let bytes_max = self.bytes_max(lane);
        let queued_bytes = self.queued_bytes;
        let check = |message_bytes: usize| {
            let cost_bytes = message_bytes.saturating_add(QUEUE_ENTRY_BYTES);
            if cost_bytes > bytes_max {
                Err(PushError::TooLarge)
            } else if queued_bytes + cost_bytes > bytes_max {
                Err(PushError::Full)
            } else {
                Ok(cost_bytes)
            }
        };
        check(bytes_hint)?;
        let lane = &mut self.lanes[lane];
        let mark = lane.bytes.len();
        let encoded = encode(&mut lane.bytes);
        let message_bytes = lane.bytes.len() - mark;
        // Only a length beyond its field cannot be written to a growing buffer.
        let checked = encoded
            .map_err(|_| PushError::TooLarge)
            .and_then(|()| check(message_bytes));
        match checked {
            Ok(cost_bytes) => {
                lane.entries.push_back(Entry {
                    message_bytes,
                    express,
                });
                self.queued_bytes += cost_bytes;
                Ok(())
            }
            Err(error) => {
                lane.bytes.truncate(mark);
                Err(error)
            }
        }
    }

    /// Appends whole batches to `out` until the queue is empty or [`TRANSMIT_BYTES`] are reached.
    pub(crate) fn poll(&mut self, out: &mut Vec<u8>) {
        let start = out.len();
        while !self.is_empty() && out.len() - start < TRANSMIT_BYTES {
            if !self.poll_batch(out) {
                break;
            }
        }
    }

    /// Appends one batch; `false` if there was nothing to say.
    fn poll_batch(&mut self, out: &mut Vec<u8>) -> bool {
        let prefix = out.len();
        out.extend_from_slice(&[0, 0]);
        let body = out.len();
        let end = prefix + usize::from(self.terms.batch_bytes);
        let lanes = match self.chain_lane {
            // One reassembly on the other side: nothing may come between the fragments.
            Some(lane) => lane..lane + 1,
            None => 0..LANES,
        };
        for index in lanes {
            if !self.fill(index, out, body, end) {
                break;
            }
        }
        let batch_bytes = out.len() - body;
        if batch_bytes == 0 {
            out.truncate(prefix);
            return false;
        }
        let length = u16::try_from(batch_bytes).expect("a batch ends at its u16 bound");
        out[prefix..body].copy_from_slice(&length.to_le_bytes());
        true
    }

    /// Moves messages of one lane into the batch; `true` if a lower lane may go on with it.
    fn fill(&mut self, index: usize, out: &mut Vec<u8>, body: usize, end: usize) -> bool {
        let Terms { qos, sn_mask, .. } = self.terms;
        let priority = if qos {
            wire_priority(index)
        } else {
            WirePriority::DEFAULT
        };
        let lane = &mut self.lanes[index];
        let sequence = &mut self.next_sn[if qos { index } else { 0 }];
        let mut in_frame = false;
        while let Some((message, express)) = lane.front() {
            let mark = out.len();
            if lane.sent_bytes == 0 {
                if !in_frame {
                    write_frame_header(out, *sequence, priority);
                }
                if out.len() + message.len() <= end {
                    out.extend_from_slice(message);
                    if !in_frame {
                        *sequence = sequence.wrapping_add(1) & sn_mask;
                        in_frame = true;
                    }
                    self.queued_bytes -= lane.pop();
                    if express {
                        return false;
                    }
                    continue;
                }
                out.truncate(mark);
            }
            // What is longer than a whole batch goes in fragments, one to a batch.
            if mark == body {
                self.fill_fragment(index, out, end);
            }
            return false;
        }
        true
    }

    /// Fills the batch with the next fragment of a lane's first message.
    fn fill_fragment(&mut self, index: usize, out: &mut Vec<u8>, end: usize) {
        let Terms {
            qos,
            sn_mask,
            markers,
            ..
        } = self.terms;
        let lane = &mut self.lanes[index];
        let sequence = &mut self.next_sn[if qos { index } else { 0 }];
        let Some((message, _)) = lane.front() else {
            return;
        };
        let rest = &message[lane.sent_bytes..];
        let mut header = FragmentHeader {
            reliability: Reliability::Reliable,
            more: true,
            sn: *sequence,
            ext_qos: fragment::ext::QoSType::new(if qos {
                wire_priority(index)
            } else {
                WirePriority::DEFAULT
            }),
            ext_first: (markers && lane.sent_bytes == 0).then(fragment::ext::First::new),
            ext_drop: None,
        };
        let mark = out.len();
        write_fragment_header(out, &header);
        let taken_bytes = rest.len().min(end - out.len());
        if taken_bytes == rest.len() {
            out.truncate(mark);
            header.more = false;
            write_fragment_header(out, &header);
        }
        out.extend_from_slice(&rest[..taken_bytes]);
        *sequence = sequence.wrapping_add(1) & sn_mask;
        if header.more {
            lane.sent_bytes += taken_bytes;
            self.chain_lane = (!qos).then_some(index);
        } else {
            self.queued_bytes -= lane.pop();
            self.chain_lane = None;
        }
    }
}

fn write_frame_header(out: &mut Vec<u8>, sn: TransportSn, priority: WirePriority) {
    let header = FrameHeader {
        reliability: Reliability::Reliable,
        sn,
        ext_qos: frame::ext::QoSType::new(priority),
    };
    Zenoh080::new()
        .write(out, &header)
        .expect("a growing buffer takes a header");
}

fn write_fragment_header(out: &mut Vec<u8>, header: &FragmentHeader) {
    Zenoh080::new()
        .write(out, header)
        .expect("a growing buffer takes a header");
}

fn wire_priority(lane: usize) -> WirePriority {
    match lane {
        0 => WirePriority::Control,
        1 => WirePriority::RealTime,
        2 => WirePriority::InteractiveHigh,
        3 => WirePriority::InteractiveLow,
        4 => WirePriority::DataHigh,
        5 => WirePriority::Data,
        6 => WirePriority::DataLow,
        _ => WirePriority::Background,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use alloc::vec;

    const DATA: usize = 5;

    fn queue(bytes_max: usize, qos: bool) -> TransmitQueue {
        let mut queue = TransmitQueue::new(bytes_max);
        queue.open(Terms {
            batch_bytes: 256,
            qos,
            sn_mask: 0x7f,
            initial_sn: 0x7f,
            markers: true,
        });
        queue
    }

    fn push(queue: &mut TransmitQueue, lane: usize, bytes: &[u8]) -> Result<(), PushError> {
        queue.push(lane, false, 0, |out| {
            out.extend_from_slice(bytes);
            Ok::<(), ()>(())
        })
    }

    fn poll(queue: &mut TransmitQueue) -> Vec<u8> {
        let mut out = Vec::new();
        queue.poll(&mut out);
        out
    }

    #[test]
    fn messages_of_one_priority_share_a_frame_and_numbers_go_round() {
        let mut queue = queue(8192, true);
        push(&mut queue, DATA, &[1, 1]).unwrap();
        push(&mut queue, DATA, &[2]).unwrap();
        push(&mut queue, LANE_REAL_TIME, &[3]).unwrap();
        // Length, a frame of priority 1 with its number, a frame of the default priority.
        assert_eq!(
            poll(&mut queue),
            [10, 0, 0xa5, 0x7f, 0x31, 1, 3, 0x25, 0x7f, 1, 1, 2]
        );
        push(&mut queue, DATA, &[4]).unwrap();
        assert_eq!(poll(&mut queue), [3, 0, 0x25, 0, 4]);
        assert!(queue.is_empty());
        assert!(poll(&mut queue).is_empty());
    }

    #[test]
    fn without_priorities_all_lanes_share_one_sequence() {
        let mut queue = queue(8192, false);
        push(&mut queue, DATA, &[1]).unwrap();
        push(&mut queue, LANE_REAL_TIME, &[2]).unwrap();
        assert_eq!(poll(&mut queue), [6, 0, 0x25, 0x7f, 2, 0x25, 0, 1]);
    }

    #[test]
    fn a_message_of_exactly_a_batch_is_not_cut() {
        for (message_bytes, first) in [(252, 0x25), (253, 0xe6)] {
            let mut queue = queue(8192, true);
            push(&mut queue, DATA, &vec![9; message_bytes]).unwrap();
            let out = poll(&mut queue);
            assert_eq!((out[0], out[2]), (254, first), "{message_bytes} bytes");
        }
    }

    #[test]
    fn what_does_not_fit_leaves_no_trace() {
        let mut queue = queue(8192, true);
        let refused = queue.push(DATA, false, 0, |out| {
            out.extend_from_slice(&[1; 9000]);
            Ok::<(), ()>(())
        });
        assert_eq!(refused, Err(PushError::TooLarge));
        let unwritable = queue.push(DATA, false, 0, |out| {
            out.push(1);
            Err(())
        });
        assert_eq!(unwritable, Err(PushError::TooLarge));
        assert!(queue.is_empty());
        push(&mut queue, DATA, &[7]).unwrap();
        assert_eq!(poll(&mut queue), [3, 0, 0x25, 0x7f, 7]);
    }

    #[test]
    fn the_reserve_is_for_control_and_real_time_only() {
        let mut queue = queue(8192, true);
        while push(&mut queue, DATA, &[0; 92]).is_ok() {}
        for lane in [DATA, LANE_LAST, 2] {
            assert_eq!(push(&mut queue, lane, &[0; 92]), Err(PushError::Full));
        }
        let mut reserve_count = 0;
        while push(&mut queue, LANE_REAL_TIME, &[0; 92]).is_ok() {
            reserve_count += 1;
        }
        assert!(reserve_count >= QUEUE_RESERVE_BYTES / 100);
        assert_eq!(
            push(&mut queue, LANE_CONTROL, &[0; 92]),
            Err(PushError::Full)
        );
    }

    #[test]
    fn memory_of_a_burst_is_given_back() {
        let mut queue = queue(1 << 20, true);
        for _ in 0..100 {
            push(&mut queue, DATA, &[0; 9000]).unwrap();
        }
        while !poll(&mut queue).is_empty() {}
        assert!(queue.lanes[DATA].bytes.capacity() <= QUEUE_KEEP_BYTES);
    }
}
