//! A model of the ESP32-S3's RMT, honest about what can go wrong.
//!
//! ```text
//!   block of a channel (48 words, wrap mode)         TRM §37.3.4.2
//!   ┌──────── half 0 ────────┬──────── half 1 ────────┐
//!   │ playing ▶              │ next                   │──▶ back to half 0
//!   └────────────────────────┴────────────────────────┘
//!                            ▲ threshold: half 0 is consumed; the refill interrupt comes
//!                              after its latency and writes half 0
//! ```
//!
//! - Four transmitters; they start together within 3 ticks (TRM §37.3.4.5).
//! - A refill that is later than the other half lasts finds the transmitter playing stale words
//!   again. That is what the hardware does, so the model does it too: the pulses leave, the pulse
//!   counter sees them, and the fault [`FaultCode::REFILL_LATE`] is raised.
//! - A stop truncates: the word that plays is cut. [`StepBackend::halt`] therefore waits until the
//!   pin is low, as the board's does, so that no step is cut in half.
//! - The direction pin is set by the refill interrupt, with its latency.
//! - Playing is lazy: [`StepBackend::service`] catches up with everything since the last call, at
//!   the right ticks.
//!
//! Beside the model, [`VirtualRmt::step_count`] counts at the pin like the chip's PCNT, and knows
//! nothing of the ledger.

use crate::{
    cd::VirtualCd,
    emulated::splitmix,
    pins::{Pin, PinEvent},
};
use keys::{AxisId, status::FaultCode};
use motion::{
    Axis, CdBackend, Direction, Fill, StepBackend, Symbol, TICKS_PER_US, Ticks,
    limits::{CHANNEL_WORDS, CHANNELS, REFILL_WORDS},
};

/// How the virtual hardware differs from the ideal.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct RmtConfig {
    /// Shortest time from the threshold to the refill, ticks; 1 µs by default.
    pub refill_ticks_min: u64,
    /// Longest; 5 µs by default.
    pub refill_ticks_max: u64,
    /// Most that channels of one start differ, ticks; 3 by default.
    pub start_skew_ticks_max: u64,
    /// Longest time from when an axis wants planning until the planner runs, ticks; 0 by default.
    pub plan_ticks_max: u64,
}

impl Default for RmtConfig {
    fn default() -> Self {
        Self {
            refill_ticks_min: TICKS_PER_US,
            refill_ticks_max: 5 * TICKS_PER_US,
            start_skew_ticks_max: 3,
            plan_ticks_max: 0,
        }
    }
}

/// The transmitter of one axis.
#[derive(Clone, Debug)]
struct Channel {
    words: [Symbol; CHANNEL_WORDS],
    /// Index of the word that plays.
    reading: usize,
    /// When it began.
    word_at: u64,
    playing: bool,
    /// A half that was consumed, and when its refill comes.
    refill: Option<Refill>,
    /// Words of this half were played again before their refill came.
    stale: bool,
    level: bool,
    /// Level of the direction pin.
    direction: bool,
    /// It is low for positive.
    inverted: bool,
    /// It is behind a shift register: the refill has no hold of it.
    external: bool,
    /// The pulse counter: active edges with sign.
    counted_steps: i64,
    /// When the half that plays has been played, `None` if it ends the transmission.
    half_end: Option<u64>,
    /// No word of that half is high anywhere.
    half_low: bool,
}

#[derive(Clone, Copy, Debug)]
struct Refill {
    half: usize,
    at: u64,
}

/// The pulse unit of an emulated node.
#[derive(Clone, Debug)]
pub struct VirtualRmt {
    config: RmtConfig,
    random: u64,
    axes: [Axis; CHANNELS],
    channels: [Channel; CHANNELS],
    now: u64,
    fault: Option<FaultCode>,
    /// When the planner runs that an axis waits for.
    plan_at: Option<u64>,
    /// Words were played twice, or a direction came too late for its driver: until the next halt only
    /// the counter knows the count.
    lapped: bool,
    record: bool,
    edges: Vec<PinEvent>,
    cd: VirtualCd,
}

/// Where edges go.
struct Scope<'e> {
    axis: AxisId,
    record: bool,
    edges: &'e mut Vec<PinEvent>,
}

impl Scope<'_> {
    fn note(&mut self, at_ticks: u64, pin: Pin, level: bool) {
        if self.record {
            self.edges.push(PinEvent {
                at_ticks,
                pin,
                level,
            });
        }
    }
}

impl Channel {
    fn new() -> Self {
        Self {
            words: [Symbol::END; CHANNEL_WORDS],
            reading: 0,
            word_at: 0,
            playing: false,
            refill: None,
            stale: false,
            level: false,
            direction: false,
            inverted: false,
            external: false,
            counted_steps: 0,
            half_end: None,
            half_low: false,
        }
    }

    /// The half at `reading` begins at `word_at`: its words stay what they are until it is over.
    fn begin_half(&mut self) {
        let words = &self.words[self.reading..][..REFILL_WORDS];
        let ends = words.iter().any(|word| word.is_end());
        let ticks: u64 = words.iter().map(|word| word.ticks()).sum();
        self.half_end = (!ends).then_some(self.word_at + ticks);
        self.half_low = words.iter().all(|word| !word.first().1 && !word.second().1);
    }

    fn set_level(&mut self, at: u64, level: bool, scope: &mut Scope<'_>) {
        if level == self.level {
            return;
        }
        self.level = level;
        if level {
            let positive = self.direction != self.inverted;
            self.counted_steps += if positive { 1 } else { -1 };
        }
        scope.note(at, Pin::Step(scope.axis), level);
    }

    fn turn(&mut self, at: u64, level: bool, inverted: bool, scope: &mut Scope<'_>) {
        self.inverted = inverted;
        if level != self.direction {
            self.direction = level;
            scope.note(at, Pin::Direction(scope.axis), level);
        }
    }

    fn load(&mut self, half: usize, fill: &Fill) {
        self.words[half * REFILL_WORDS..][..REFILL_WORDS].copy_from_slice(&fill.words);
    }

    /// Begins the word at `reading`, if it is none that ends the transmission.
    fn begin_word(&mut self, scope: &mut Scope<'_>) {
        let word = self.words[self.reading];
        let (first_ticks, first_level) = word.first();
        if first_ticks == 0 {
            self.playing = false;
            self.set_level(self.word_at, false, scope);
            return;
        }
        self.set_level(self.word_at, first_level, scope);
    }

    /// Plays up to `until`, or up to the next refill, whichever comes first; an edge at `until`
    /// has left. Returns the refill that is due.
    fn play(
        &mut self,
        until: u64,
        latency: impl Fn(u64) -> u64,
        scope: &mut Scope<'_>,
    ) -> Option<Refill> {
        loop {
            if let Some(refill) = self.refill
                && refill.at <= until
                && (!self.playing || refill.at <= self.word_end())
            {
                self.second_part(refill.at, scope);
                return self.refill.take();
            }
            if !self.playing {
                return None;
            }
            self.pass_rest(until);
            self.second_part(until, scope);
            let end = self.word_end();
            if end > until {
                return None;
            }
            let (second_ticks, _) = self.words[self.reading].second();
            if second_ticks == 0 {
                self.playing = false;
                self.set_level(end, false, scope);
                continue;
            }
            let half = self.reading / REFILL_WORDS;
            self.reading = (self.reading + 1) % CHANNEL_WORDS;
            self.word_at = end;
            if self.reading.is_multiple_of(REFILL_WORDS) {
                // The half that begins should have been written by now.
                if self.refill.is_some() {
                    self.stale = true;
                } else {
                    self.refill = Some(Refill {
                        half,
                        at: end + latency(end),
                    });
                }
                self.begin_half();
            }
            self.begin_word(scope);
        }
    }

    /// Goes to the last word of a half in which nothing happens, if that is over by `until`: most of
    /// what is played is rest.
    fn pass_rest(&mut self, until: u64) {
        let Some(end) = self.half_end.filter(|end| *end <= until) else {
            return;
        };
        if self.half_low && !self.level && self.refill.is_none() {
            self.reading = self.reading / REFILL_WORDS * REFILL_WORDS + REFILL_WORDS - 1;
            self.word_at = end - self.words[self.reading].ticks();
        }
    }

    fn word_end(&self) -> u64 {
        self.word_at + self.words[self.reading].ticks()
    }

    /// Sets the level of the word's second part if it has begun by `until`.
    fn second_part(&mut self, until: u64, scope: &mut Scope<'_>) {
        if !self.playing {
            return;
        }
        let word = self.words[self.reading];
        let at = self.word_at + word.first().0;
        if at <= until && word.second().0 > 0 {
            self.set_level(at, word.second().1, scope);
        }
    }
}

impl VirtualRmt {
    /// Makes a pulse unit at rest. Latencies and skews follow from `seed`.
    pub fn new(config: RmtConfig, seed: u64) -> Self {
        Self {
            config,
            random: splitmix(seed),
            axes: std::array::from_fn(|_| Axis::new()),
            channels: std::array::from_fn(|_| Channel::new()),
            now: 0,
            fault: None,
            plan_at: None,
            lapped: false,
            record: false,
            edges: Vec::new(),
            cd: VirtualCd::new(),
        }
    }

    /// A shift register gives the direction pin of an axis this level (C and D are behind the axes
    /// of the queue): from now on it is behind that.
    pub fn set_direction_pin(&mut self, axis: usize, level: bool, now: Ticks) {
        let Some(channel) = self.channels.get_mut(axis) else {
            self.cd.set_direction_pin(axis - CHANNELS, level, now);
            return;
        };
        channel.external = true;
        let mut scope = Scope {
            axis: AxisId(axis as u8),
            record: self.record,
            edges: &mut self.edges,
        };
        let inverted = !self.axes[axis].direction_level(Direction::Positive);
        channel.turn(now.0, level, inverted, &mut scope);
    }

    /// Returns C and D, to look at.
    pub fn cd_pins(&self) -> &VirtualCd {
        &self.cd
    }

    /// Begins or ends keeping every change of a pin for [`VirtualRmt::take_edges`].
    pub fn record_edges(&mut self, record: bool) {
        self.record = record;
    }

    /// Gives the changes of pins since the last call, each axis in order of time.
    pub fn take_edges(&mut self) -> impl Iterator<Item = PinEvent> + use<'_> {
        let record = self.record;
        let cd = self.cd.take_edges().filter(move |_| record);
        self.edges.drain(..).chain(cd)
    }

    /// Returns the emulated pulse counter: steps with sign since boot, counted at the pins.
    pub fn step_count(&self, axis: AxisId) -> i64 {
        self.channels
            .get(usize::from(axis.0))
            .map_or(0, |channel| channel.counted_steps)
    }

    /// Lets the pulse counter of an axis lose or find steps, as noise on its wire would.
    pub fn disturb_counter(&mut self, axis: AxisId, steps: i64) {
        if let Some(channel) = self.channels.get_mut(usize::from(axis.0)) {
            channel.counted_steps += steps;
        }
    }

    fn random_up_to(&mut self, most: u64) -> u64 {
        self.random = splitmix(self.random);
        self.random % (most + 1)
    }

    /// Plays one channel up to `until` or through its next refill; `Some`: when that refill was.
    fn play_channel(&mut self, index: usize, until: u64) -> Option<u64> {
        let span = self
            .config
            .refill_ticks_max
            .saturating_sub(self.config.refill_ticks_min);
        let seed = self.random ^ index as u64;
        let least = self.config.refill_ticks_min;
        let latency = |at: u64| least + splitmix(seed ^ at) % (span + 1);
        let channel = &mut self.channels[index];
        let mut scope = Scope {
            axis: AxisId(index as u8),
            record: self.record,
            edges: &mut self.edges,
        };
        let refill = channel.play(until, latency, &mut scope)?;
        if channel.stale {
            channel.stale = false;
            self.lapped = true;
            return Some(refill.at);
        }
        let axis = &mut self.axes[index];
        let fill = axis.fill(refill.half);
        if let Some(direction) = fill.turn.filter(|_| !channel.external) {
            let inverted = !axis.direction_level(Direction::Positive);
            channel.turn(
                refill.at,
                axis.direction_level(direction),
                inverted,
                &mut scope,
            );
            // The half that plays is the rest around the turn; behind it comes what was filled.
            let by = channel
                .half_end
                .map(|end| end.saturating_add_signed(fill.turn_by_ticks.into()));
            self.lapped |= by.is_some_and(|by| refill.at > by);
        }
        channel.load(refill.half, &fill);
        Some(refill.at)
    }

    /// Returns when the next refill of a channel comes at the latest, if it plays.
    fn next_refill(&self, index: usize) -> Option<u64> {
        let channel = &self.channels[index];
        if let Some(refill) = channel.refill {
            return Some(refill.at);
        }
        if !channel.playing {
            return None;
        }
        Some(channel.half_end? + self.config.refill_ticks_min)
    }
}

impl StepBackend for VirtualRmt {
    fn axes(&mut self) -> &mut [Axis] {
        &mut self.axes
    }

    fn start(&mut self, now: Ticks, lead_ticks: u64) {
        let now = now.0.max(self.now);
        for index in 0..CHANNELS {
            let skew = self.random_up_to(self.config.start_skew_ticks_max);
            let channel = &mut self.channels[index];
            let axis = &mut self.axes[index];
            let mut scope = Scope {
                axis: AxisId(index as u8),
                record: self.record,
                edges: &mut self.edges,
            };
            for half in 0..2 {
                let fill = if half == 0 {
                    axis.lead_in(lead_ticks)
                } else {
                    axis.fill(half)
                };
                if let Some(direction) = fill.turn {
                    let inverted = !axis.direction_level(Direction::Positive);
                    channel.turn(now, axis.direction_level(direction), inverted, &mut scope);
                }
                channel.load(half, &fill);
            }
            channel.reading = 0;
            channel.word_at = now + skew;
            channel.playing = true;
            channel.refill = None;
            channel.begin_half();
            channel.begin_word(&mut scope);
        }
    }

    fn service(&mut self, until: Ticks) -> Ticks {
        let until = until.0.max(self.now);
        loop {
            // Refills in order of time, so that the planner is asked at the right moment.
            let next = (0..CHANNELS)
                .filter_map(|index| Some((self.next_refill(index)?, index)))
                .min();
            let Some((at, index)) = next.filter(|(at, _)| *at <= until) else {
                break;
            };
            // The latency is known only when the threshold is passed.
            let latest = at + self.config.refill_ticks_max;
            let Some(refilled_at) = self.play_channel(index, latest.min(until)) else {
                continue;
            };
            if self.lapped {
                self.give_up(refilled_at);
                return Ticks(self.now);
            }
            // At `until` itself the caller plans anyway, once all channels have come so far.
            if refilled_at < until && self.axes[index].wants_planning() {
                let late_ticks = self.config.plan_ticks_max;
                let due = *self.plan_at.get_or_insert_with(|| {
                    refilled_at + splitmix(self.random ^ refilled_at) % (late_ticks + 1)
                });
                if refilled_at >= due {
                    self.plan_at = None;
                    self.now = self.now.max(refilled_at);
                    return Ticks(self.now);
                }
            }
        }
        for index in 0..CHANNELS {
            // No refill is due any more, only words.
            let refill = self.play_channel(index, until);
            debug_assert_eq!(refill, None);
        }
        self.now = until;
        Ticks(until)
    }

    fn is_playing(&self) -> bool {
        self.channels.iter().any(|channel| channel.playing)
    }

    fn halt(&mut self, now: Ticks) -> Ticks {
        while self.service(now) < now {}
        self.halt_channels(now.0.max(self.now))
    }

    fn played_steps(&self, axis: AxisId) -> i64 {
        let Some(channel) = self.channels.get(usize::from(axis.0)) else {
            return 0;
        };
        if self.lapped {
            return channel.counted_steps;
        }
        let ledger = self.axes[usize::from(axis.0)].ledger();
        if channel.playing {
            ledger.played_steps(channel.reading, channel.refill.map(|refill| refill.half))
        } else {
            ledger.booked_steps()
        }
    }

    fn counted_steps(&self, axis: AxisId) -> Option<i64> {
        Some(self.step_count(axis))
    }

    fn cd(&mut self) -> Option<&mut dyn CdBackend> {
        Some(&mut self.cd)
    }

    fn counted_c(&self) -> i64 {
        CdBackend::counted_c(&self.cd)
    }

    fn take_fault(&mut self) -> Option<FaultCode> {
        self.fault.take()
    }
}

impl VirtualRmt {
    /// A refill found that words were played twice. The interrupt itself stops everything: nobody
    /// else is quick enough.
    fn give_up(&mut self, at: u64) {
        for index in 0..CHANNELS {
            self.play_channel(index, at);
        }
        self.fault = Some(FaultCode::REFILL_LATE);
        self.halt_channels(at.max(self.now));
    }

    fn halt_channels(&mut self, now: u64) -> Ticks {
        let mut quiet_at = now;
        for index in 0..CHANNELS {
            let played_steps = self.played_steps(AxisId(index as u8));
            let channel = &mut self.channels[index];
            let mut scope = Scope {
                axis: AxisId(index as u8),
                record: self.record,
                edges: &mut self.edges,
            };
            if channel.playing && channel.level {
                let low_at = channel.word_at + channel.words[channel.reading].first().0;
                quiet_at = quiet_at.max(low_at);
                channel.set_level(low_at, false, &mut scope);
            }
            channel.playing = false;
            channel.refill = None;
            self.axes[index].halt(played_steps);
        }
        self.lapped = false;
        self.now = quiet_at;
        Ticks(quiet_at)
    }
}
