//! The step back end on the RMT's registers: starts, refills, halts, counts.
//!
//! Two contexts use it, never at once: the refill interrupt ([`Streamer::on_interrupt`]) and the
//! planning task (everything else). The task's first call holds the interrupt off
//! ([`Streamer::hold`]); [`Streamer::resume`] at the end of its turn lets it in again. A long turn
//! does not starve the pins: whenever the planner looks at the axes, refills that are due are made
//! first, from those that have plenty ahead.

use crate::{
    lane::{Course, Lane},
    layout::Place,
    registers::{ChannelConfig, Events, Registers},
};
use keys::{AxisId, status::FaultCode};
use motion::{
    Axis, Fill, StepBackend, TICKS_PER_US, Ticks,
    limits::{CHANNELS, LOW_WORD_TICKS_MAX, REFILL_WORDS},
};

/// Most that a start may be prepared before its lead-in begins to be cut: 2 ms. The planning that
/// goes before it is part of that.
pub const START_TICKS: u64 = 2_000 * TICKS_PER_US;

/// From the last reading of the clock to the start of the channels: 40 µs, for the lead-ins of four
/// channels, some hundred accesses each at 100 ns.
const TRIGGER_TICKS: u64 = 40 * TICKS_PER_US;

/// What lies ahead in a block is not more than this, unless it is two units: 1.9 ms, what two units
/// of the longest rests last. So a change of plan waits no longer than that for a borrowed block.
const AHEAD_TICKS: u64 = 2 * REFILL_WORDS as u64 * LOW_WORD_TICKS_MAX;

/// Most time for a transmitter that was stopped to come to rest: 10 µs.
const IDLE_TICKS: u64 = 10 * TICKS_PER_US;

/// How the streamer's hardware is set.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct StreamerConfig<'p> {
    /// The transmitter of each axis.
    pub places: &'p [Place],
    /// DIV_CNT of all channels, so that a tick is 62.5 ns.
    pub divider: u8,
    /// How many words the read pointer is ahead of the word that plays: the one number that must be
    /// calibrated, by the loopback test against the pulse counter.
    pub prefetch_words: u8,
}

/// What the interrupt has for the planning task.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Attention {
    /// An axis wants planning, or there is a fault: wake the task.
    pub wake: bool,
}

/// See the module. The axes are the caller's memory, some 8 KB each, so that a board has no more of them
/// than motors: an array, or a loan.
#[derive(Debug)]
pub struct Streamer<R, A> {
    registers: R,
    /// Those of the axes come first.
    lanes: [Lane; CHANNELS],
    axes: A,
    /// Where units are put together.
    fill: Fill,
    divider: u8,
    held: bool,
    /// Whose interrupts are let in.
    enabled: u8,
    fault: Option<FaultCode>,
}

impl<R: Registers, A: AsRef<[Axis]> + AsMut<[Axis]>> Streamer<R, A> {
    /// Makes a pulse unit of these axes, whose hardware nobody has touched: [`Streamer::begin`] comes next.
    ///
    /// # Panics
    /// There is no axis, or not a place for each, or more than [`CHANNELS`].
    pub fn new(registers: R, config: StreamerConfig<'_>, axes: A) -> Self {
        let count = axes.as_ref().len();
        assert!(
            count == config.places.len() && (1..=CHANNELS).contains(&count),
            "an axis for each place"
        );
        let prefetch_words = config.prefetch_words.into();
        let mut lanes = [const { Lane::UNPLACED }; CHANNELS];
        for (axis, (lane, place)) in lanes.iter_mut().zip(config.places).enumerate() {
            *lane = Lane::new(axis, *place, prefetch_words);
        }
        Self {
            registers,
            lanes,
            axes,
            fill: Fill::END,
            divider: config.divider,
            held: true,
            enabled: 0,
            fault: None,
        }
    }

    /// Sets the hardware, at rest: pins low, interrupts held off until [`Streamer::resume`].
    pub fn begin(&mut self) {
        self.registers.enable_interrupts(0);
        self.enabled = 0;
        for index in 0..self.count() {
            self.configure(index);
            self.lanes[index].count(&self.registers);
        }
    }

    /// Axes, which are no more than lanes.
    fn count(&self) -> usize {
        self.axes.as_ref().len().min(CHANNELS)
    }

    fn configure(&mut self, index: usize) {
        let place = self.lanes[index].place();
        let config = ChannelConfig {
            divider: self.divider,
            blocks: place.blocks as u8,
            wrap: true,
            continuous: false,
            idle_output: true,
            idle_high: false,
            carrier: false,
        };
        self.registers.configure(place.channel, config);
        let words = REFILL_WORDS as u16;
        self.registers.set_threshold(place.channel, words);
        self.registers.update(place.channel);
    }

    /// Returns the hardware.
    pub fn registers(&self) -> &R {
        &self.registers
    }

    /// Returns the hardware, for what does not belong to pulses.
    pub fn registers_mut(&mut self) -> &mut R {
        &mut self.registers
    }

    /// Holds the refill interrupt off, so that the axes can be used.
    pub fn hold(&mut self) {
        if !self.held {
            self.held = true;
            self.enabled = 0;
            self.registers.enable_interrupts(0);
        }
    }

    /// Lets the refill interrupt in again, after what has become due meanwhile. The end of every
    /// turn of the planning task.
    pub fn resume(&mut self) {
        if self.held {
            let ended = self.refill(true);
            self.held = false;
            self.let_in(ended);
        }
    }

    /// Enables the interrupts of those that play. An end stays pending, as the mark of a channel
    /// that is at rest, and must not interrupt again and again.
    fn let_in(&mut self, ended: u8) {
        let mask = self.mask() & !ended;
        if mask != self.enabled {
            self.enabled = mask;
            self.registers.enable_interrupts(mask);
        }
    }

    /// The refill interrupt. Bounded: at most one block of words for each axis.
    pub fn on_interrupt(&mut self) -> Attention {
        let ended = self.refill(true);
        self.let_in(ended);
        Attention {
            wake: self.fault.is_some() || self.axes.as_ref().iter().any(Axis::wants_planning),
        }
    }

    fn mask(&self) -> u8 {
        let lanes = &self.lanes[..self.count()];
        lanes.iter().fold(0, |mask, lane| mask | lane.mask())
    }

    /// Refills every block. `all`: also from axes that have little ahead, whose planner may be in
    /// the middle of a change. Returns which channels have ended.
    fn refill(&mut self, all: bool) -> u8 {
        let Events { reached, mut ended } = self.registers.events();
        if all {
            // Otherwise an event that is not answered yet must come up again. So must one that came
            // since they were read.
            self.registers.clear_events(self.mask() & reached, false);
        }
        loop {
            let mut soon = false;
            for index in 0..self.count() {
                if all || self.axes.as_ref()[index].can_spare() {
                    let leaves = reached & self.lanes[index].mask() != 0;
                    soon |= self.refill_axis(index, leaves, ended);
                }
            }
            // What is due within a word is waited for: no other event would come.
            if !(all && soon) {
                return ended;
            }
            ended = self.registers.ended();
        }
    }

    /// Refills one block. Returns whether it must be looked at again within a word; `reached`: its
    /// threshold was; `ended`: which channels have.
    fn refill_axis(&mut self, index: usize, reached: bool, ended: u8) -> bool {
        let Self {
            registers,
            lanes,
            axes,
            fill,
            ..
        } = self;
        let (lane, axis) = (&mut lanes[index], &mut axes.as_mut()[index]);
        if !lane.plays(ended) {
            // At rest, or at the end marker behind what was written.
            if lane.has_begun() && !axis.has_ended() {
                self.give_up();
            }
            return false;
        }
        lane.count(registers);
        lane.look(registers);
        let mut course = lane.turn(registers);
        while course != Course::Late && !axis.has_ended() && lane.has_room(registers, AHEAD_TICKS) {
            let due_at = lane.due_at();
            write_unit(lane, axis, fill, registers);
            lane.look(registers);
            course = lane.judge(due_at, registers.now());
            if course != Course::Late {
                course = lane.turn(registers);
            }
        }
        if course == Course::Late {
            self.give_up();
            return false;
        }
        course == Course::Soon || reached && lane.is_leaving()
    }

    /// Words may have been played twice, or an axis stands still in the middle of its plan. The
    /// interrupt itself stops everything: nobody else is quick enough.
    fn give_up(&mut self) {
        self.fault = Some(FaultCode::REFILL_LATE);
        self.silence(true);
    }

    /// Quiets all channels and settles the axes. `lost`: the counters have the truth.
    fn silence(&mut self, lost: bool) {
        let Self {
            registers,
            lanes,
            axes,
            ..
        } = self;
        let axes = axes.as_mut();
        let count = axes.len().min(CHANNELS);
        let lanes = &mut lanes[..count];
        let mut cuts = [None; CHANNELS];
        let mut playing = [false; CHANNELS];
        for (index, lane) in lanes.iter_mut().enumerate() {
            playing[index] = lane.is_playing(registers);
            if playing[index] {
                cuts[index] = lane.cut(registers);
            } else if lane.has_begun() && !axes[index].has_ended() {
                cuts[index] = Some(lane.starved_at(registers));
            }
        }
        let mut certain = [true; CHANNELS];
        for index in 0..count {
            // A channel without a cut has lost the race against its transmitter.
            certain[index] = !(playing[index] && cuts[index].is_none());
        }
        while playing.contains(&true) {
            for (index, lane) in lanes.iter_mut().enumerate() {
                if !playing[index] {
                    continue;
                }
                if registers.ended() & lane.mask() != 0 {
                    playing[index] = false;
                } else if lane.can_truncate(cuts[index], registers)
                    || (cuts[index].is_none() && !registers.step_pin(lane.place().channel))
                {
                    stop_channel(lane, registers);
                    playing[index] = false;
                }
            }
        }
        registers.clear_events(lanes.iter().fold(0, |mask, lane| mask | lane.mask()), true);
        for (index, (lane, axis)) in lanes.iter_mut().zip(axes).enumerate() {
            if !lane.has_begun() {
                continue;
            }
            let unplayed_steps = lane.end(cuts[index], registers);
            let played_steps = axis.ledger().booked_steps() - unplayed_steps;
            let counted = lane
                .counted_steps(registers)
                .filter(|_| lost || !certain[index]);
            axis.halt(counted.unwrap_or(played_steps));
            lane.reset();
        }
    }

    /// Loads lead-in and second unit of every axis, without starting.
    fn load(&mut self, lead_ticks: u64) {
        for (lane, axis) in self.lanes.iter_mut().zip(self.axes.as_mut()) {
            lane.reset();
            let fill = axis.lead_in(lead_ticks);
            lane.write(&fill, &mut self.registers);
            write_unit(lane, axis, &mut self.fill, &mut self.registers);
        }
    }
}

/// Fills and writes the next unit of an axis.
fn write_unit(lane: &mut Lane, axis: &mut Axis, fill: &mut Fill, registers: &mut impl Registers) {
    axis.fill_into(lane.next_half(), fill);
    lane.write(fill, registers);
}

fn stop_channel(lane: &Lane, registers: &mut impl Registers) {
    let channel = lane.place().channel;
    registers.stop(channel);
    registers.update(channel);
    let from = registers.now();
    while !registers.status(channel).idle && registers.now() < from + IDLE_TICKS {}
}

impl<R: Registers, A: AsRef<[Axis]> + AsMut<[Axis]>> StepBackend for Streamer<R, A> {
    fn axes(&mut self) -> &mut [Axis] {
        self.hold();
        self.refill(false);
        self.axes.as_mut()
    }

    fn start_ticks(&self) -> u64 {
        START_TICKS
    }

    fn start(&mut self, now: Ticks, lead_ticks: u64) {
        self.hold();
        let deadline = now.0 + START_TICKS;
        let count = self.count();
        let mut counts = [0; CHANNELS];
        for (to, axis) in counts.iter_mut().zip(self.axes.as_ref()) {
            *to = axis.ledger().booked_steps();
        }
        self.load(lead_ticks);
        for index in 0..count {
            self.configure(index);
        }
        let mask = self.mask();
        self.registers.clear_events(mask, true);
        self.registers.reset_dividers(mask);
        self.registers.start_together(mask);
        let trigger_at = self.registers.now().max(now.0) + TRIGGER_TICKS;
        if trigger_at > deadline {
            self.fault = Some(FaultCode::START_LATE);
            let axes = self.axes.as_mut().iter_mut();
            for ((axis, lane), count) in axes.zip(&mut self.lanes).zip(counts) {
                lane.end(None, &self.registers);
                axis.halt(count);
                lane.reset();
            }
            return;
        }
        for lane in &mut self.lanes[..count] {
            let left_ticks = now.0 + lead_ticks - trigger_at;
            lane.lead_in(left_ticks, &mut self.registers);
            lane.turn_at_rest(&mut self.registers);
        }
        let (last, others) = self.lanes[..count]
            .split_last_mut()
            .expect("a pulse unit has an axis");
        for lane in others {
            lane.begin(trigger_at);
            self.registers.begin(lane.place().channel);
        }
        while self.registers.now() < trigger_at {}
        last.begin(trigger_at);
        self.registers.begin(last.place().channel);
        self.refill(true);
    }

    fn service(&mut self, until: Ticks) -> Ticks {
        self.hold();
        self.refill(false);
        until
    }

    fn is_playing(&self) -> bool {
        let lanes = &self.lanes[..self.count()];
        lanes.iter().any(|lane| lane.is_playing(&self.registers))
    }

    fn halt(&mut self, now: Ticks) -> Ticks {
        self.hold();
        self.silence(false);
        Ticks(self.registers.now()).max(now)
    }

    fn played_steps(&self, axis: AxisId) -> i64 {
        let index = usize::from(axis.0);
        let (Some(lane), Some(axis)) = (self.lanes.get(index), self.axes.as_ref().get(index))
        else {
            return 0;
        };
        axis.ledger().booked_steps() - lane.unplayed_steps(&self.registers)
    }

    fn counted_steps(&self, axis: AxisId) -> Option<i64> {
        let lanes = &self.lanes[..self.count()];
        lanes
            .get(usize::from(axis.0))?
            .counted_steps(&self.registers)
    }

    fn take_fault(&mut self) -> Option<FaultCode> {
        self.fault.take()
    }
}
