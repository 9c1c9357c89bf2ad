//! The node's name in its network: `left.local`, by multicast DNS (RFC 6762).
//!
//! ```text
//!   question ──▶ Name::handle ──▶ answer, to everybody or to whoever asked (§5.4, §6.7)
//!   address  ──▶ Name::announce ──▶ to everybody, twice, a second apart (§8.3)
//! ```
//!
//! One record, the address of one name: that is all that `ping left.local` needs, and a responder for
//! services would be ten times as long. No socket, no clock.
//!
//! Absent on purpose: probing and the search for another name (§8.1, §9), as a node's name is its
//! fleet's, and two of one name are refused by the router already; and the suppression of answers that
//! are known (§7.1), which saves a packet of 50 bytes.

use core::net::Ipv4Addr;

/// Where questions are asked and answers are heard, with [`PORT`].
pub const GROUP: Ipv4Addr = Ipv4Addr::new(224, 0, 0, 251);

/// See [`GROUP`].
pub const PORT: u16 = 5353;

/// Longest name without `.local`, bytes: that of a label.
pub const NAME_BYTES_MAX: usize = 63;

/// Longest answer: header, a question of the same name, one record.
pub const ANSWER_BYTES_MAX: usize = HEADER_BYTES + 2 * (NAME_BYTES_MAX + 8) + 4 + 14;

/// Most questions of one message that are looked at.
const QUESTIONS_MAX: u16 = 32;

/// How long an answer is good for, s (§10), and one to a resolver that knows only plain DNS (§6.7).
const TTL_S: u32 = 120;
const LEGACY_TTL_S: u32 = 10;

const HEADER_BYTES: usize = 12;
const LOCAL: &[u8] = b"local";
const TYPE_A: u16 = 1;
const TYPE_ANY: u16 = 255;
const CLASS_IN: u16 = 1;
const CLASS_ANY: u16 = 255;
/// In a question: answer me alone. In an answer: forget what you knew.
const TOP_BIT: u16 = 0x8000;

/// Who gets an answer.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum To {
    /// The group.
    Everybody,
    /// Whoever asked, at the port that asked.
    Asker,
}

/// A name that is answered for.
#[derive(Clone, Copy, Debug)]
pub struct Name<'n> {
    label: &'n [u8],
}

impl<'n> Name<'n> {
    /// Returns `None` if it is no label: empty, or longer than [`NAME_BYTES_MAX`].
    pub fn new(name: &'n str) -> Option<Self> {
        let label = name.as_bytes();
        (1..=NAME_BYTES_MAX)
            .contains(&label.len())
            .then_some(Self { label })
    }

    /// Writes what is said to everybody when there is an address. Returns its length.
    pub fn announce(&self, address: Ipv4Addr, out: &mut [u8; ANSWER_BYTES_MAX]) -> usize {
        let mut writer = Writer { out, used: 0 };
        writer.header(0, 0);
        writer.record(self, CLASS_IN | TOP_BIT, TTL_S, address);
        writer.used
    }

    /// Takes a message that came from this port. Writes the answer, if it asks for this name, and
    /// returns its length and who gets it.
    pub fn handle(
        &self,
        message: &[u8],
        from_port: u16,
        address: Ipv4Addr,
        out: &mut [u8; ANSWER_BYTES_MAX],
    ) -> Option<(usize, To)> {
        let word = |at: usize| {
            let bytes = message.get(at..at + 2)?;
            Some(u16::from_be_bytes([bytes[0], bytes[1]]))
        };
        let (id, flags, questions) = (word(0)?, word(2)?, word(4)?);
        // An answer, or another kind of question.
        if flags & 0xf800 != 0 {
            return None;
        }
        let mut at = HEADER_BYTES;
        let mut alone = true;
        let mut asked = false;
        for _ in 0..questions.min(QUESTIONS_MAX) {
            let (is_mine, behind) = self.is_at(message, at)?;
            let (kind, class) = (word(behind)?, word(behind + 2)?);
            at = behind + 4;
            let wants = [TYPE_A, TYPE_ANY].contains(&kind)
                && [CLASS_IN, CLASS_ANY].contains(&(class & !TOP_BIT));
            if is_mine && wants {
                asked = true;
                alone &= class & TOP_BIT != 0;
            }
        }
        if !asked {
            return None;
        }
        let mut writer = Writer { out, used: 0 };
        if from_port == PORT {
            writer.header(0, 0);
            writer.record(self, CLASS_IN | TOP_BIT, TTL_S, address);
            let to = if alone { To::Asker } else { To::Everybody };
            return Some((writer.used, to));
        }
        // A plain resolver: it wants its number and its question back.
        writer.header(id, 1);
        writer.name(self);
        writer.words(&[TYPE_A, CLASS_IN]);
        writer.record(self, CLASS_IN, LEGACY_TTL_S, address);
        Some((writer.used, To::Asker))
    }

    /// Returns whether this name is at a place of a message, and the place behind it.
    fn is_at(&self, message: &[u8], from: usize) -> Option<(bool, usize)> {
        let mut expected = [self.label, LOCAL].into_iter();
        let mut same = true;
        let mut behind = None;
        let mut at = from;
        // Pointers lead back only, so this ends; a name has at most 128 labels anyway.
        for _ in 0..128 {
            let length = usize::from(*message.get(at)?);
            match length {
                0 => {
                    same &= expected.next().is_none();
                    return Some((same, behind.unwrap_or(at + 1)));
                }
                1..=63 => {
                    let label = message.get(at + 1..at + 1 + length)?;
                    same &= expected
                        .next()
                        .is_some_and(|mine| mine.eq_ignore_ascii_case(label));
                    at += 1 + length;
                }
                0xc0.. => {
                    let low = usize::from(*message.get(at + 1)?);
                    let to = (length & 0x3f) << 8 | low;
                    behind = behind.or(Some(at + 2));
                    if to >= at {
                        return None;
                    }
                    at = to;
                }
                _ => return None,
            }
        }
        None
    }
}

struct Writer<'o> {
    out: &'o mut [u8; ANSWER_BYTES_MAX],
    used: usize,
}

impl Writer<'_> {
    fn bytes(&mut self, bytes: &[u8]) {
        self.out[self.used..self.used + bytes.len()].copy_from_slice(bytes);
        self.used += bytes.len();
    }

    fn words(&mut self, words: &[u16]) {
        for word in words {
            self.bytes(&word.to_be_bytes());
        }
    }

    /// An answer of one record, whose sender is who knows best.
    fn header(&mut self, id: u16, questions: u16) {
        self.words(&[id, 0x8400, questions, 1, 0, 0]);
    }

    fn name(&mut self, name: &Name<'_>) {
        for label in [name.label, LOCAL] {
            self.bytes(&[label.len() as u8]);
            self.bytes(label);
        }
        self.bytes(&[0]);
    }

    fn record(&mut self, name: &Name<'_>, class: u16, ttl_s: u32, address: Ipv4Addr) {
        self.name(name);
        self.words(&[TYPE_A, class]);
        self.bytes(&ttl_s.to_be_bytes());
        self.words(&[4]);
        self.bytes(&address.octets());
    }
}

#[cfg(test)]
mod tests {
    extern crate std;

    use super::*;
    use std::{vec, vec::Vec};

    const ADDRESS: Ipv4Addr = Ipv4Addr::new(10, 0, 0, 7);

    fn question(names: &[(&[&str], u16, u16)]) -> Vec<u8> {
        let mut bytes = vec![0x12, 0x34, 0, 0, 0, names.len() as u8, 0, 0, 0, 0, 0, 0];
        for (labels, kind, class) in names {
            for label in *labels {
                bytes.push(label.len() as u8);
                bytes.extend(label.bytes());
            }
            bytes.push(0);
            bytes.extend(kind.to_be_bytes());
            bytes.extend(class.to_be_bytes());
        }
        bytes
    }

    fn ask(message: &[u8], port: u16) -> Option<(Vec<u8>, To)> {
        let mut out = [0; ANSWER_BYTES_MAX];
        let name = Name::new("left").expect("a label");
        let (used, to) = name.handle(message, port, ADDRESS, &mut out)?;
        Some((out[..used].to_vec(), to))
    }

    /// As RFC 6762 §18 and RFC 1035 §4 have it, by hand.
    const ANSWER: &[u8] = b"\x00\x00\x84\x00\x00\x00\x00\x01\x00\x00\x00\x00\
        \x04left\x05local\x00\x00\x01\x80\x01\x00\x00\x00\x78\x00\x04\x0a\x00\x00\x07";

    #[test]
    fn who_asks_for_the_name_gets_the_address() {
        let to_all = question(&[(&["left", "local"], 1, 1)]);
        assert_eq!(ask(&to_all, PORT), Some((ANSWER.to_vec(), To::Everybody)));
        let to_me = question(&[(&["LEFT", "Local"], 255, 0x8001)]);
        assert_eq!(ask(&to_me, PORT), Some((ANSWER.to_vec(), To::Asker)));
        let second = question(&[(&["right", "local"], 1, 1), (&["left", "local"], 1, 1)]);
        assert_eq!(ask(&second, PORT), Some((ANSWER.to_vec(), To::Everybody)));
        let mut out = [0; ANSWER_BYTES_MAX];
        let name = Name::new("left").expect("a label");
        let used = name.announce(ADDRESS, &mut out);
        assert_eq!(&out[..used], ANSWER);
    }

    #[test]
    fn a_plain_resolver_gets_its_number_and_its_question_back() {
        let message = question(&[(&["left", "local"], 1, 1)]);
        let (answer, to) = ask(&message, 40_000).expect("it asks");
        assert_eq!(to, To::Asker);
        assert_eq!(answer[..2], [0x12, 0x34]);
        assert_eq!(answer[4..8], [0, 1, 0, 1]);
        assert_eq!(answer[12..28], message[12..28], "the question");
        let record =
            b"\x04left\x05local\x00\x00\x01\x00\x01\x00\x00\x00\x0a\x00\x04\x0a\x00\x00\x07";
        assert_eq!(&answer[28..], record);
    }

    #[test]
    fn nobody_else_is_answered() {
        for names in [
            (&["left"][..], 1, 1),
            (&["left", "local", "net"], 1, 1),
            (&["lef", "local"], 1, 1),
            (&["left", "local"], 28, 1),
            (&["left", "local"], 1, 3),
        ] {
            assert_eq!(ask(&question(&[names]), PORT), None, "{names:?}");
        }
        let mut answer = question(&[(&["left", "local"], 1, 1)]);
        answer[2] = 0x84;
        assert_eq!(ask(&answer, PORT), None);
        assert!(Name::new("").is_none());
    }

    #[test]
    fn a_name_in_two_pieces_is_read_and_one_that_bites_its_tail_is_not() {
        // `x.local`, then `left` with a pointer to that `local`.
        let mut bytes = question(&[(&["x", "local"], 1, 1)]);
        bytes[5] = 2;
        bytes.extend(b"\x04left\xc0\x0e\x00\x01\x00\x01");
        assert_eq!(ask(&bytes, PORT), Some((ANSWER.to_vec(), To::Everybody)));
        for pointer in [b"\xc0\x0c", b"\xc0\x0d", b"\xc0\xff"] {
            let mut bytes = question(&[]);
            bytes[5] = 1;
            bytes.extend(pointer);
            bytes.extend(b"\x00\x01\x00\x01");
            assert_eq!(ask(&bytes, PORT), None);
        }
    }

    #[test]
    fn any_bytes_are_taken() {
        let mut random = 3_u32;
        let mut next = || {
            random = random.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            (random >> 24) as u8
        };
        let good = question(&[(&["left", "local"], 1, 1), (&["left", "local"], 1, 1)]);
        for cut in 0..=good.len() {
            ask(&good[..cut], PORT);
            for _ in 0..200 {
                let mut bytes = good[..cut].to_vec();
                for _ in 0..3 {
                    if cut > 0 {
                        let at = usize::from(next()) % cut;
                        bytes[at] = next();
                    }
                }
                ask(&bytes, u16::from(next()));
            }
        }
    }

    #[test]
    fn the_longest_name_has_room() {
        let long = core::str::from_utf8(&[b'n'; NAME_BYTES_MAX]).expect("letters");
        let name = Name::new(long).expect("a label");
        let message = question(&[(&[long, "local"], 1, 1)]);
        let mut out = [0; ANSWER_BYTES_MAX];
        assert!(name.handle(&message, 1, ADDRESS, &mut out).is_some());
    }
}
