//! Input pins: each edge with its time and what the pulse counters showed.
//!
//! ```text
//!   edge ─interrupt─▶ Capture::on_interrupt ─▶ queue of EDGES_MAX ─task─▶ Capture::poll ─▶ PinLevel
//! ```
//!
//! Two contexts use it, never at once: the interrupt, and the planning task, which masks interrupts
//! for the length of a call. A contact that chatters fills the queue: then the interrupt is left off until the
//! task's next turn, which looks at the pins itself. So no wire can keep the processor busy, and the
//! last level is never lost. What is lost is only how often it changed in between.
//!
//! Absent: debouncing and meaning, which are [`motion::io::input`]'s. The hardware's glitch filter is
//! set by the board: it hides what is shorter than two cycles of the bus clock, 25 ns.

use motion::{
    Ticks,
    io::input::{INPUTS_MAX, PinLevel},
    limits::CHANNELS,
};

/// Edges that wait for the task: at most one turn's.
pub const EDGES_MAX: usize = 16;

/// The registers of the input pins and what is latched with them.
///
/// Levels are a bit for each of the chip's pins.
pub trait InputRegisters {
    /// Reads GPIO_IN and GPIO_IN1.
    fn levels(&self) -> u64;

    /// Writes GPIO_STATUS_W1TC: edges of these pins until now are answered.
    fn acknowledge(&mut self, pins: u64);

    /// Lets edges of these pins interrupt, and no others.
    fn listen(&mut self, pins: u64);

    /// Returns the time: ticks of 62.5 ns (16 MHz) since boot.
    fn now(&self) -> u64;

    /// Reads the pulse counter of an axis: active edges with sign, modulo 2¹⁶. `None` where the chip
    /// has none.
    fn counter(&self, axis: usize) -> Option<i16>;
}

/// What the interrupt found.
#[derive(Clone, Copy, Debug)]
struct Edge {
    levels: u64,
    at_ticks: u64,
    counters: [Option<i16>; CHANNELS],
}

/// See the module.
#[derive(Debug)]
pub struct Capture<R> {
    registers: R,
    /// The chip's pin of each input, by the index that motion knows it by.
    pins: [Option<u8>; INPUTS_MAX],
    mask: u64,
    edges: heapless::Deque<Edge, EDGES_MAX>,
    /// Levels that the task was told.
    told: u64,
    /// The queue was full: the interrupt is off.
    choked: bool,
}

impl<R: InputRegisters> Capture<R> {
    /// No inputs yet: [`Capture::begin`] names them.
    pub const fn new(registers: R) -> Self {
        Self {
            registers,
            pins: [None; INPUTS_MAX],
            mask: 0,
            edges: heapless::Deque::new(),
            told: 0,
            choked: false,
        }
    }

    /// Takes the pins by input and lets them interrupt. Returns the levels of the inputs now, a bit
    /// for each: what motion is told at its boot.
    ///
    /// # Panics
    /// There are more than [`INPUTS_MAX`], or a number above 63.
    pub fn begin(&mut self, pins: &[u8]) -> u32 {
        assert!(pins.len() <= INPUTS_MAX, "as many as motion has");
        self.registers.listen(0);
        self.pins = [None; INPUTS_MAX];
        self.mask = 0;
        for (to, pin) in self.pins.iter_mut().zip(pins) {
            *to = Some(*pin);
            self.mask |= 1_u64.checked_shl(u32::from(*pin)).expect("a pin's number");
        }
        self.edges.clear();
        self.choked = false;
        // Edges from here on are seen; one that is in both is told once.
        self.registers.acknowledge(self.mask);
        self.told = self.registers.levels() & self.mask;
        self.registers.listen(self.mask);
        let inputs = self.pins.iter().flatten().enumerate();
        inputs.fold(0, |levels, (index, pin)| {
            levels | u32::from(self.told >> pin & 1 != 0) << index
        })
    }

    /// The interrupt of the pins. Bounded: a look at a handful of registers.
    pub fn on_interrupt(&mut self) {
        // In this order: a change after the look interrupts again.
        self.registers.acknowledge(self.mask);
        let edge = look(&self.registers, self.mask);
        let last = self.edges.back().map_or(self.told, |edge| edge.levels);
        if edge.levels != last && self.edges.push_back(edge).is_err() {
            self.choked = true;
            self.registers.listen(0);
        }
    }

    /// Gives the next change of an input, `None` if there is no more; each is told once, in order of
    /// time. `counted_steps` are the full counts of the axes now, from which those of the edges
    /// follow.
    pub fn poll(&mut self, counted_steps: impl Fn(usize) -> i64) -> Option<PinLevel> {
        let level = self.next_level(counted_steps);
        if self.choked && level.is_none() {
            // Everything was told, so there is room again. An edge since the last look has not been
            // answered, so it interrupts at once.
            self.choked = false;
            self.registers.listen(self.mask);
        }
        level
    }

    fn next_level(&mut self, counted_steps: impl Fn(usize) -> i64) -> Option<PinLevel> {
        loop {
            let edge = match self.edges.front() {
                Some(edge) => *edge,
                // Levels that nobody has caught.
                None if self.choked => {
                    self.registers.acknowledge(self.mask);
                    look(&self.registers, self.mask)
                }
                None => return None,
            };
            let changed = edge.levels ^ self.told;
            let inputs = self.pins.iter().enumerate();
            let mut inputs = inputs.filter_map(|(index, pin)| Some((index, (*pin)?)));
            let Some((index, pin)) = inputs.find(|(_, pin)| changed >> pin & 1 != 0) else {
                if self.edges.pop_front().is_some() {
                    continue;
                }
                return None;
            };
            self.told ^= 1 << pin;
            let counted_steps = core::array::from_fn(|axis| {
                let now_steps = counted_steps(axis);
                // The counter goes around every 65,536 steps: an edge is never so old.
                let since = edge.counters[axis]
                    .map_or(0, |at_edge| (now_steps as i16).wrapping_sub(at_edge));
                now_steps - i64::from(since)
            });
            return Some(PinLevel {
                index,
                level: edge.levels >> pin & 1 != 0,
                at: Ticks(edge.at_ticks),
                counted_steps,
            });
        }
    }

    /// Returns the hardware.
    pub fn registers(&self) -> &R {
        &self.registers
    }

    /// Returns the hardware, for those who model it.
    pub fn registers_mut(&mut self) -> &mut R {
        &mut self.registers
    }
}

fn look<R: InputRegisters>(registers: &R, mask: u64) -> Edge {
    Edge {
        levels: registers.levels() & mask,
        at_ticks: registers.now(),
        counters: core::array::from_fn(|axis| registers.counter(axis)),
    }
}
