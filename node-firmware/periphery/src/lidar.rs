//! The lidar: Benewake TF-Luna on its serial line, 115,200 baud, 100 frames a second unasked.
//!
//! ```text
//!   0x59 0x59 │ distance, cm │ strength │ temperature │ sum of the eight bytes before
//!             │  low   high  │ low high │  low  high  │
//! ```
//!
//! Format and bounds are those of its product manual (A05, §7). Its driver in the registry serves I²C
//! only and rests on a crate that was withdrawn, so the decoder is here.
//!
//! Bytes that are no frame are skipped; a frame may begin within one that was broken.

/// Bytes of a frame.
pub const FRAME_BYTES: usize = 9;

/// Baud rate of the line.
pub const BAUD: u32 = 115_200;

/// Weakest signal of a reading that counts.
pub const STRENGTH_MIN: u16 = 100;

/// Longest distance, cm.
pub const DISTANCE_CM_MAX: u16 = 800;

const HEAD: u8 = 0x59;

/// A whole frame without a distance: nothing there, too far, or dazzled.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct NoDistance;

/// Takes the bytes of the line.
#[derive(Clone, Debug, Default)]
pub struct TfLuna {
    bytes: heapless::Vec<u8, FRAME_BYTES>,
}

impl TfLuna {
    /// Nothing has come yet.
    pub const fn new() -> Self {
        Self {
            bytes: heapless::Vec::new(),
        }
    }

    /// Forgets a frame that has begun: what comes next was measured later.
    pub fn clear(&mut self) {
        self.bytes.clear();
    }

    /// Takes a byte. Gives the distance, mm, when a frame is whole.
    pub fn handle_byte(&mut self, byte: u8) -> Option<Result<u32, NoDistance>> {
        // Never full here: a whole frame is taken out below.
        let _ = self.bytes.push(byte);
        while !self.may_be_frame() {
            self.bytes.remove(0);
        }
        if self.bytes.len() < FRAME_BYTES {
            return None;
        }
        let (sum, frame) = self.bytes.split_last().expect("it is whole");
        let right = frame.iter().fold(0_u8, |sum, byte| sum.wrapping_add(*byte)) == *sum;
        if !right {
            self.bytes.remove(0);
            while !self.may_be_frame() {
                self.bytes.remove(0);
            }
            return None;
        }
        let word = |at: usize| u16::from_le_bytes([frame[at], frame[at + 1]]);
        let (distance_cm, strength) = (word(2), word(4));
        self.bytes.clear();
        // All ones: overexposed.
        let counts = (STRENGTH_MIN..u16::MAX).contains(&strength)
            && (1..=DISTANCE_CM_MAX).contains(&distance_cm);
        Some(if counts {
            Ok(u32::from(distance_cm) * 10)
        } else {
            Err(NoDistance)
        })
    }

    fn may_be_frame(&self) -> bool {
        self.bytes.iter().take(2).all(|byte| *byte == HEAD)
    }
}

#[cfg(test)]
mod tests {
    extern crate std;

    use super::*;
    use std::{vec, vec::Vec};

    fn frame(distance_cm: u16, strength: u16) -> Vec<u8> {
        let mut bytes = vec![HEAD, HEAD];
        bytes.extend(distance_cm.to_le_bytes());
        bytes.extend(strength.to_le_bytes());
        bytes.extend(0x0a28_u16.to_le_bytes());
        bytes.push(
            bytes
                .iter()
                .fold(0, |sum: u8, byte| sum.wrapping_add(*byte)),
        );
        bytes
    }

    fn readings(bytes: &[u8]) -> Vec<Result<u32, NoDistance>> {
        let mut lidar = TfLuna::new();
        let readings = bytes.iter().filter_map(|byte| lidar.handle_byte(*byte));
        readings.collect()
    }

    #[test]
    fn a_frame_of_the_manual_is_its_distance() {
        // 59 59: head; 012c: 300 cm; 03e8: strength; 0a28: 69 °C; sum.
        let bytes = [0x59, 0x59, 0x2c, 0x01, 0xe8, 0x03, 0x28, 0x0a, 0xfc];
        assert_eq!(readings(&bytes), [Ok(3_000)]);
        assert_eq!(bytes.to_vec(), frame(300, 1_000));
    }

    #[test]
    fn weak_dazzled_and_far_readings_have_no_distance() {
        for (distance_cm, strength) in [(300, 99), (300, 0xffff), (0, 1_000), (801, 1_000)] {
            assert_eq!(readings(&frame(distance_cm, strength)), [Err(NoDistance)]);
        }
        assert_eq!(readings(&frame(800, 100)), [Ok(8_000)]);
    }

    #[test]
    fn a_line_that_is_cut_anywhere_finds_its_next_frame() {
        // The distance is the head's own bytes: the worst case.
        let good = frame(0x0159, 0x5959);
        for cut in 0..FRAME_BYTES {
            let mut bytes = good[cut..].to_vec();
            for _ in 0..3 {
                bytes.extend(&good);
            }
            let found = readings(&bytes);
            assert!((2..=4).contains(&found.len()), "cut {cut}: {found:?}");
            assert!(found.iter().all(|reading| *reading == Ok(3_450)));
        }
    }

    #[test]
    fn noise_is_skipped_and_a_flipped_bit_costs_its_frame_only() {
        let mut bytes = vec![HEAD, 0x00, HEAD, HEAD, 0x01, 0xff, HEAD];
        bytes.extend(frame(100, 500));
        let mut broken = frame(200, 500);
        broken[3] ^= 0x10;
        bytes.extend(broken);
        bytes.extend(frame(300, 500));
        assert_eq!(readings(&bytes), [Ok(1_000), Ok(3_000)]);
    }

    #[test]
    fn any_bytes_are_taken() {
        let mut random = 7_u32;
        let mut lidar = TfLuna::new();
        for _ in 0..100_000 {
            random = random.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            let byte = if random >> 30 == 0 {
                HEAD
            } else {
                (random >> 16) as u8
            };
            lidar.handle_byte(byte);
        }
    }
}
