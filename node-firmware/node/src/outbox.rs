//! What waits for the link, with its bounds.
//!
//! | what | bound | when full |
//! |---|---|---|
//! | clock replies | [`CLOCK_REPLIES_MAX`] | the oldest is dropped: it would only measure the wait |
//! | starts | [`STARTS_MAX`] | the oldest is dropped: it is said again |
//! | acks | [`ACKS_MAX`] | the oldest is dropped: the newest tells all numbers, and an order without an answer is sent again |
//! | status | 1 | made when it is taken, so it is always the newest |
//! | log lines | [`LOG_LINES_MAX`] | the new one is dropped and counted; the count goes out as a line |
//!
//! They leave in this order. Without a link nothing leaves; acks and clock replies are forgotten
//! when the link goes, because the next status says what they said.

use crate::{
    clock::Probed,
    limits::{
        ACKS_MAX, CLOCK_REPLIES_MAX, LOG_BURST_LINES, LOG_LINE_BYTES_MAX, LOG_LINE_US,
        LOG_LINES_MAX, OUTBOUND_BYTES_MAX, STARTS_MAX,
    },
};
use core::fmt::{self, Write};
use keys::{BatchAck, LocalMicros, NodeTopic, start::StartMessage};

/// A message on its way out.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Outbound {
    /// What kind of message it is, and so on which key it goes.
    pub topic: NodeTopic,
    /// What comes behind the topic in the key; empty for most.
    pub suffix: heapless::String<32>,
    /// Its bytes.
    pub payload: heapless::Vec<u8, OUTBOUND_BYTES_MAX>,
}

/// One line of text.
pub(crate) type Line = heapless::String<LOG_LINE_BYTES_MAX>;

/// See the module.
#[derive(Debug)]
pub(crate) struct Outbox {
    probes: heapless::Deque<Probed, CLOCK_REPLIES_MAX>,
    starts: heapless::Deque<StartMessage, STARTS_MAX>,
    acks: heapless::Deque<BatchAck, ACKS_MAX>,
    lines: heapless::Deque<Line, LOG_LINES_MAX>,
    lines_dropped: u32,
    line_tokens: u8,
    line_tokens_at: LocalMicros,
}

impl Outbox {
    pub(crate) const fn new() -> Self {
        Self {
            probes: heapless::Deque::new(),
            starts: heapless::Deque::new(),
            acks: heapless::Deque::new(),
            lines: heapless::Deque::new(),
            lines_dropped: 0,
            line_tokens: LOG_BURST_LINES,
            line_tokens_at: LocalMicros(0),
        }
    }

    /// Takes a probe to answer; `true` when an older one had to go for it.
    pub(crate) fn push_probe(&mut self, probed: Probed) -> bool {
        push_newest(&mut self.probes, probed)
    }

    /// Takes an ack; `true` when an older one had to go for it.
    pub(crate) fn push_ack(&mut self, ack: BatchAck) -> bool {
        push_newest(&mut self.acks, ack)
    }

    /// Takes a line, cut at [`LOG_LINE_BYTES_MAX`]; `false` when there is no room.
    pub(crate) fn push_line(&mut self, text: fmt::Arguments<'_>) -> bool {
        if self.lines.push_back(line(text)).is_err() {
            self.lines_dropped = self.lines_dropped.saturating_add(1);
            return false;
        }
        true
    }

    pub(crate) fn pop_probe(&mut self) -> Option<Probed> {
        self.probes.pop_front()
    }

    /// Takes a message about a start; the oldest goes for it when full.
    pub(crate) fn push_start(&mut self, message: StartMessage) {
        let _ = push_newest(&mut self.starts, message);
    }

    pub(crate) fn pop_start(&mut self) -> Option<StartMessage> {
        self.starts.pop_front()
    }

    pub(crate) fn pop_ack(&mut self) -> Option<BatchAck> {
        self.acks.pop_front()
    }

    /// Gives the next line if its time has come.
    pub(crate) fn pop_line(&mut self, now: LocalMicros) -> Option<Line> {
        self.earn_line_tokens(now);
        if self.line_tokens == 0 {
            return None;
        }
        let next = match self.lines.pop_front() {
            Some(next) => next,
            None if self.lines_dropped > 0 => {
                let dropped = core::mem::take(&mut self.lines_dropped);
                line(format_args!("{dropped} log lines were dropped"))
            }
            None => return None,
        };
        self.line_tokens -= 1;
        Some(next)
    }

    /// Returns when a waiting line may leave; `None` if none waits or it may leave already.
    pub(crate) fn line_timeout(&self) -> Option<LocalMicros> {
        let waits = !self.lines.is_empty() || self.lines_dropped > 0;
        (waits && self.line_tokens == 0).then(|| self.line_tokens_at.plus_us(LOG_LINE_US))
    }

    /// Forgets what only this link was waiting for.
    pub(crate) fn link_down(&mut self) {
        self.probes.clear();
        self.starts.clear();
        self.acks.clear();
    }

    /// Lets lines leave again as time passes.
    pub(crate) fn earn_line_tokens(&mut self, now: LocalMicros) {
        let earned = now.since_us(self.line_tokens_at) / LOG_LINE_US;
        let missing = u64::from(LOG_BURST_LINES - self.line_tokens);
        if earned >= missing {
            self.line_tokens = LOG_BURST_LINES;
            self.line_tokens_at = now.max(self.line_tokens_at);
        } else {
            self.line_tokens += earned as u8;
            self.line_tokens_at = self.line_tokens_at.plus_us(earned * LOG_LINE_US);
        }
    }
}

/// Adds at the end; when full, the oldest goes and `true` is returned.
fn push_newest<T, const N: usize>(queue: &mut heapless::Deque<T, N>, item: T) -> bool {
    let full = queue.is_full();
    if full {
        queue.pop_front();
    }
    // Cannot fail: there is room for one.
    let _ = queue.push_back(item);
    full
}

/// Writes one line, cut where it gets too long.
fn line(text: fmt::Arguments<'_>) -> Line {
    struct Cut(Line);
    impl Write for Cut {
        fn write_str(&mut self, text: &str) -> fmt::Result {
            for letter in text.chars() {
                let letter = if letter.is_control() { ' ' } else { letter };
                self.0.push(letter).map_err(|_| fmt::Error)?;
            }
            Ok(())
        }
    }
    let mut cut = Cut(Line::new());
    // An error only says that the line was cut.
    let _ = cut.write_fmt(text);
    cut.0
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_flood_of_lines_leaves_slowly_and_says_how_many_were_dropped() {
        let mut outbox = Outbox::new();
        let mut now = LocalMicros(1_000_000);
        for number in 0..100 {
            assert_eq!(
                outbox.push_line(format_args!("line {number}")),
                number < LOG_LINES_MAX
            );
        }
        for number in 0..LOG_BURST_LINES {
            let line = outbox.pop_line(now).expect("the burst");
            assert_eq!(line, line_text(number));
        }
        assert_eq!(outbox.pop_line(now), None);
        for number in LOG_BURST_LINES..LOG_LINES_MAX as u8 {
            now = outbox.line_timeout().expect("lines wait");
            assert_eq!(outbox.pop_line(now), Some(line_text(number)));
            assert_eq!(outbox.pop_line(now), None);
        }
        now = outbox.line_timeout().expect("the count waits");
        assert_eq!(
            outbox.pop_line(now).as_deref(),
            Some("84 log lines were dropped")
        );
        assert_eq!(outbox.line_timeout(), None);
        assert_eq!(now.0, 1_000_000 + 9 * LOG_LINE_US);
    }

    fn line_text(number: u8) -> Line {
        line(format_args!("line {number}"))
    }

    #[test]
    fn a_line_is_one_line_and_is_cut() {
        let long = [b'x'; 2 * LOG_LINE_BYTES_MAX];
        let long = core::str::from_utf8(&long).expect("ASCII");
        assert_eq!(line(format_args!("{long}")).len(), LOG_LINE_BYTES_MAX);
        assert_eq!(line(format_args!("a\nb")), "a b");
    }
}
