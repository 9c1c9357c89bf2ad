//! The registers of the pulse hardware, its interrupt, and the back end that the node holds.
//!
//! Logic is in the `rmt` crate; here is one access after the other. Everything that the interrupt
//! reaches lies in internal RAM: see `pulse.x`.

use crate::board::{self, LAYOUT, PREFETCH_WORDS, RMT_DIVIDER, RMT_RAM, pin};
use core::{
    cell::UnsafeCell,
    mem::MaybeUninit,
    ptr::addr_of_mut,
    sync::atomic::{AtomicBool, Ordering},
};
use esp_hal::{
    gpio::{
        Flex, InputConfig, Level, OutputConfig, OutputSignal,
        interconnect::{InputSignal, OutputSignal as OutputSignalOf},
    },
    handler,
    interrupt::Priority,
    peripherals::{GPIO, RMT, SYSTIMER},
    ram,
    rmt::{Rmt, TxChannelConfig, TxChannelCreator},
    time::Rate,
};
use keys::{AxisId, status::FaultCode};
use motion::{Axis, StepBackend, Ticks, limits::CHANNELS};
use rmt::{ChannelConfig, ChannelStatus, Events, Registers, Streamer, StreamerConfig};

#[cfg(feature = "counters")]
use esp_hal::pcnt::{
    Pcnt,
    channel::{CtrlMode, EdgeMode},
};

/// The hardware itself; there is nothing to hold.
#[derive(Debug)]
pub(crate) struct Chip;

/// Ticks of 62.5 ns since boot: the system timer counts them.
#[inline(always)]
pub(crate) fn now_ticks() -> u64 {
    let timer = SYSTIMER::regs();
    timer.unit_op(0).write(|w| w.update().set_bit());
    while timer.unit_op(0).read().value_valid().bit_is_clear() {}
    let value = timer.unit_value(0);
    let mut low = value.lo().read().bits();
    loop {
        // The other core may update between the two halves.
        let high = value.hi().read().bits();
        let again = value.lo().read().bits();
        if again == low {
            return u64::from(high) << 32 | u64::from(low);
        }
        low = again;
    }
}

impl Registers for Chip {
    #[inline(always)]
    fn configure(&mut self, channel: usize, config: ChannelConfig) {
        RMT::regs().ch_tx_conf0(channel).modify(|_, w| {
            // SAFETY: any divider and 1 to 8 blocks are legal values of these fields.
            unsafe {
                w.div_cnt().bits(config.divider);
                w.mem_size().bits(config.blocks);
            }
            w.mem_tx_wrap_en().bit(config.wrap);
            w.tx_conti_mode().bit(config.continuous);
            w.idle_out_en().bit(config.idle_output);
            w.idle_out_lv().bit(config.idle_high);
            w.carrier_en().bit(config.carrier)
        });
    }

    #[inline(always)]
    fn set_threshold(&mut self, channel: usize, words: u16) {
        RMT::regs().ch_tx_lim(channel).modify(|_, w| {
            w.tx_loop_cnt_en().clear_bit();
            // SAFETY: nine bits, and a block is shorter.
            unsafe { w.tx_lim().bits(words) }
        });
    }

    #[inline(always)]
    fn update(&mut self, channel: usize) {
        RMT::regs()
            .ch_tx_conf0(channel)
            .modify(|_, w| w.conf_update().set_bit());
    }

    #[inline(always)]
    fn reset_dividers(&mut self, channels: u8) {
        // SAFETY: bit n is transmitter n; the bits clear themselves.
        RMT::regs()
            .ref_cnt_rst()
            .write(|w| unsafe { w.bits(u32::from(channels)) });
    }

    #[inline(always)]
    fn start_together(&mut self, channels: u8) {
        RMT::regs().tx_sim().write(|w| {
            w.ch0().bit(channels & 1 != 0);
            w.ch1().bit(channels & 2 != 0);
            #[cfg(not(feature = "esp32c6"))]
            w.ch2().bit(channels & 4 != 0);
            #[cfg(not(feature = "esp32c6"))]
            w.ch3().bit(channels & 8 != 0);
            w.en().bit(channels != 0)
        });
    }

    #[inline(always)]
    fn begin(&mut self, channel: usize) {
        let conf0 = RMT::regs().ch_tx_conf0(channel);
        conf0.modify(|_, w| {
            w.mem_rd_rst().set_bit();
            w.apb_mem_rst().set_bit()
        });
        conf0.modify(|_, w| {
            w.mem_rd_rst().clear_bit();
            w.apb_mem_rst().clear_bit();
            w.conf_update().set_bit()
        });
        conf0.modify(|_, w| w.tx_start().set_bit());
    }

    #[inline(always)]
    fn stop(&mut self, channel: usize) {
        RMT::regs()
            .ch_tx_conf0(channel)
            .modify(|_, w| w.tx_stop().set_bit());
    }

    #[inline(always)]
    fn status(&self, channel: usize) -> ChannelStatus {
        let status = RMT::regs().ch_tx_status(channel).read();
        ChannelStatus {
            read_word: usize::from(status.mem_raddr_ex().bits()),
            idle: status.state().bits() == 0,
        }
    }

    #[inline(always)]
    fn ended(&self) -> u8 {
        let raw = RMT::regs().int_raw().read();
        (0..LAYOUT.transmitters as u8).fold(0, |mask, channel| {
            let ended = raw.ch_tx_end(channel).bit_is_set();
            mask | u8::from(ended) << channel
        })
    }

    #[inline(always)]
    fn events(&self) -> Events {
        let raw = RMT::regs().int_raw().read();
        (0..LAYOUT.transmitters as u8).fold(Events::default(), |events, number| {
            let (reached, ended) = (raw.ch_tx_thr_event(number), raw.ch_tx_end(number));
            Events {
                reached: events.reached | u8::from(reached.bit_is_set()) << number,
                ended: events.ended | u8::from(ended.bit_is_set()) << number,
            }
        })
    }

    #[inline(always)]
    fn clear_events(&mut self, channels: u8, ends: bool) {
        RMT::regs().int_clr().write(|w| {
            for channel in 0..LAYOUT.transmitters as u8 {
                let mine = channels & 1 << channel != 0;
                w.ch_tx_thr_event(channel).bit(mine);
                w.ch_tx_end(channel).bit(mine && ends);
            }
            w
        });
    }

    #[inline(always)]
    fn enable_interrupts(&mut self, channels: u8) {
        RMT::regs().int_ena().write(|w| {
            for channel in 0..LAYOUT.transmitters as u8 {
                let mine = channels & 1 << channel != 0;
                w.ch_tx_thr_event(channel).bit(mine);
                w.ch_tx_end(channel).bit(mine);
            }
            w
        });
    }

    #[inline(always)]
    fn write_word(&mut self, word: usize, value: u32) {
        let ram = RMT_RAM as *mut u32;
        // SAFETY: `word` lies in the block of a channel that this driver owns: it comes from
        // `Place`, whose bounds a const assertion and a test hold.
        unsafe { ram.add(word).write_volatile(value) };
    }

    #[inline(always)]
    fn step_pin(&self, channel: usize) -> bool {
        board::step_pin_of(channel).is_some_and(reads_high)
    }

    #[inline(always)]
    fn set_direction(&mut self, axis: usize, positive: bool) {
        if let Some(number) = board::direction_pin(axis) {
            set_pin(number, positive);
        }
    }

    #[inline(always)]
    fn counter(&self, axis: usize) -> Option<i16> {
        #[cfg(feature = "counters")]
        {
            let counter = || esp_hal::peripherals::PCNT::regs().u_cnt(axis).read();
            (axis < board::counted_axes()).then(|| counter().cnt().bits() as i16)
        }
        #[cfg(not(feature = "counters"))]
        {
            let _ = axis;
            None
        }
    }

    #[inline(always)]
    fn now(&self) -> u64 {
        now_ticks()
    }
}

/// Returns the level of a pin that is read.
#[inline(always)]
pub(crate) fn reads_high(number: u8) -> bool {
    let gpio = GPIO::regs();
    let levels = if number < 32 {
        gpio.in_().read().bits()
    } else {
        gpio.in1().read().bits()
    };
    levels & 1 << (number % 32) != 0
}

/// Sets an output by its own bit, so that no other pin is disturbed.
#[inline(always)]
pub(crate) fn set_pin(number: u8, high: bool) {
    let gpio = GPIO::regs();
    let bit = 1 << (number % 32);
    // SAFETY: one bit of a register that ignores zeros.
    unsafe {
        match (number < 32, high) {
            (true, true) => gpio.out_w1ts().write(|w| w.bits(bit)),
            (true, false) => gpio.out_w1tc().write(|w| w.bits(bit)),
            (false, true) => gpio.out1_w1ts().write(|w| w.bits(bit)),
            (false, false) => gpio.out1_w1tc().write(|w| w.bits(bit)),
        };
    }
}

/// Takes an output away from whatever peripheral drives it, and sets it low: at once, whatever that
/// peripheral does.
#[inline(always)]
pub(crate) fn take_pin(number: u8) {
    set_pin(number, false);
    route_pin(number, OutputSignal::GPIO);
}

/// Gives an output to a peripheral.
#[inline(always)]
pub(crate) fn route_pin(number: u8, signal: OutputSignal) {
    let config = GPIO::regs().func_out_sel_cfg(usize::from(number));
    config.modify(|_, w| {
        // It is an output whatever the peripheral thinks of it.
        w.oen_sel().set_bit();
        // SAFETY: the numbers of the chip's own signals are legal.
        unsafe { w.out_sel().bits(signal as _) }
    });
}

/// The refill interrupt wants planning. It only sets this: waking a task would lead it into flash.
pub(crate) static WANTED: AtomicBool = AtomicBool::new(false);

/// The streamer with as many axes as the board was told.
type BoardStreamer = Streamer<Chip, &'static mut [Axis]>;

struct Shared(UnsafeCell<Option<BoardStreamer>>);

// SAFETY: it is used by one core only, by its interrupt and by its planning task, and never by both
// at once: every call of `RmtBackend` first holds the interrupt off (`Streamer::hold`), and the
// interrupt cannot be interrupted by the task.
unsafe impl Sync for Shared {}

static STREAMER: Shared = Shared(UnsafeCell::new(None));

/// The axes: segments, encoders, ledgers, some 8 KB each. On the ESP32-S3 they are where half of the data
/// cache would be (`data-cache-size` in `.cargo/config.toml`): internal RAM like any other, which static data
/// with a content cannot have.
#[cfg_attr(feature = "esp32s3", ram(unstable(dcache_reclaimed)))]
static mut AXES_MEMORY: MaybeUninit<[Axis; board::AXES_MAX]> = MaybeUninit::uninit();

/// Makes so many axes where they stay.
///
/// # Safety
/// It is called once.
#[inline(never)]
unsafe fn made_axes(count: usize) -> &'static mut [Axis] {
    let first = addr_of_mut!(AXES_MEMORY).cast::<Axis>();
    let count = count.min(board::AXES_MAX);
    for index in 0..count {
        // SAFETY: within the array, and nobody has it yet.
        unsafe { first.add(index).write(Axis::new()) };
    }
    // SAFETY: these are made now, and nobody else ever gets them.
    unsafe { core::slice::from_raw_parts_mut(first, count) }
}

/// The refill interrupt.
#[handler(priority = Priority::Priority3)]
#[ram]
fn refill() {
    // SAFETY: the interrupt is enabled by `Streamer::resume` only, so the task does not use it.
    let streamer = unsafe { &mut *STREAMER.0.get() };
    let Some(streamer) = streamer else {
        return;
    };
    if streamer.on_interrupt().wake {
        WANTED.store(true, Ordering::Release);
    }
}

/// The node's back end: the one handle to the streamer.
#[derive(Debug)]
pub(crate) struct RmtBackend {
    /// C and D, of a board that has them.
    #[cfg(feature = "timers")]
    cd: Option<crate::cd::Cd>,
}

impl RmtBackend {
    /// Sets up clock, pins, RAM and interrupt on the core that calls it, which is the one that plans. The
    /// board is wired.
    ///
    /// # Panics
    /// It is called twice; or the RMT refuses its settings, which are those of [`LAYOUT`].
    pub(crate) fn new(
        rmt: RMT<'static>,
        #[cfg(feature = "counters")] counters: &Pcnt<'static>,
    ) -> Self {
        let mut rmt = Rmt::new(rmt, Rate::from_mhz(80)).expect("80 MHz is a source of its clock");
        // On this core. Nothing raises it before `Streamer::resume`.
        rmt.set_interrupt_handler(refill);
        let mut channel0 = Some(rmt.channel0);
        let mut channel1 = Some(rmt.channel1);
        #[cfg(not(feature = "esp32c6"))]
        let (mut channel2, mut channel3) = (Some(rmt.channel2), Some(rmt.channel3));
        let axes = board::axes();
        let mut places = [LAYOUT.place(0, axes); CHANNELS];
        // The HAL keeps clock, pins and RAM for as long as these exist.
        macro_rules! transmit {
            ($place:ident, $pin:ident, $channel:ident) => {{
                let config = TxChannelConfig::default()
                    .with_clk_divider(RMT_DIVIDER)
                    .with_idle_output(true)
                    .with_idle_output_level(Level::Low)
                    .with_memsize($place.blocks as u8);
                let channel = $channel.take().expect("each axis has another one");
                let channel = channel.configure_tx(&config);
                let channel = channel.expect("its blocks belong to no other axis");
                core::mem::forget(channel.with_pin($pin));
            }};
        }
        for (axis, to) in places.iter_mut().enumerate().take(axes) {
            let place = LAYOUT.place(axis, axes);
            *to = place;
            let told = "a wiring that was checked";
            let (step_in, step) = split(board::step_pin(axis).expect(told));
            let (direction_in, direction) = split(board::direction_pin(axis).expect(told));
            core::mem::forget(direction);
            match place.channel {
                0 => transmit!(place, step, channel0),
                1 => transmit!(place, step, channel1),
                #[cfg(not(feature = "esp32c6"))]
                2 => transmit!(place, step, channel2),
                #[cfg(not(feature = "esp32c6"))]
                3 => transmit!(place, step, channel3),
                // There are no more, see `board::LAYOUT`.
                _ => {}
            }
            #[cfg(feature = "counters")]
            count(counters, axis, step_in, direction_in);
            #[cfg(not(feature = "counters"))]
            let _ = (step_in, direction_in);
        }
        // SAFETY: there is one RMT, which was given to this call.
        let axes = unsafe { made_axes(axes) };
        let config = StreamerConfig {
            places: &places[..axes.len()],
            divider: RMT_DIVIDER,
            prefetch_words: PREFETCH_WORDS,
        };
        // SAFETY: the interrupt is off, and there is no handle yet.
        unsafe { *STREAMER.0.get() = Some(Streamer::new(Chip, config, axes)) };
        let backend = Self {
            #[cfg(feature = "timers")]
            cd: None,
        };
        backend.held().begin();
        backend
    }

    /// Adds C and D.
    #[cfg(feature = "timers")]
    pub(crate) fn add_cd(&mut self, cd: crate::cd::Cd) {
        self.cd = Some(cd);
    }

    /// Gives the streamer with its interrupt held off.
    fn held(&self) -> &'static mut BoardStreamer {
        // The interrupt must be off before there is a reference.
        Chip.enable_interrupts(0);
        // SAFETY: there is one handle, it does not leave its core, and the references that it gives
        // do not outlive its methods, but for the axes, whose borrow of `self` keeps it from
        // giving another.
        let streamer = unsafe { &mut *STREAMER.0.get() };
        let streamer = streamer.as_mut().expect("it is made before the handle");
        streamer.hold();
        streamer
    }

    /// The end of the task's turn: lets the interrupt in again.
    pub(crate) fn resume(&mut self) {
        self.held().resume();
    }
}

/// Takes a pin of an axis: an output, low, that is read back.
fn split(number: u8) -> (InputSignal<'static>, OutputSignalOf<'static>) {
    let mut flex = Flex::new(pin(number));
    flex.apply_output_config(&OutputConfig::default());
    flex.apply_input_config(&InputConfig::default());
    flex.set_input_enable(true);
    flex.set_low();
    flex.set_output_enable(true);
    flex.split()
}

/// Lets an axis have the pulse counter of its number: steps, and which way by the direction pin.
#[cfg(feature = "counters")]
fn count(
    counters: &Pcnt<'static>,
    axis: usize,
    step: InputSignal<'static>,
    direction: InputSignal<'static>,
) {
    if axis >= board::counted_axes() {
        return;
    }
    macro_rules! count {
        ($unit:ident) => {{
            let unit = &counters.$unit;
            unit.channel0.set_edge_signal(step);
            unit.channel0.set_ctrl_signal(direction);
            unit.channel0
                .set_input_mode(EdgeMode::Hold, EdgeMode::Increment);
            unit.channel0
                .set_ctrl_mode(CtrlMode::Reverse, CtrlMode::Keep);
            unit.clear();
            unit.resume();
        }};
    }
    match axis {
        0 => count!(unit0),
        1 => count!(unit1),
        2 => count!(unit2),
        _ => count!(unit3),
    }
}

impl StepBackend for RmtBackend {
    fn axes(&mut self) -> &mut [Axis] {
        self.held().axes()
    }

    fn start_ticks(&self) -> u64 {
        rmt::START_TICKS
    }

    fn start(&mut self, now: Ticks, lead_ticks: u64) {
        self.held().start(now, lead_ticks);
    }

    fn service(&mut self, until: Ticks) -> Ticks {
        self.held().service(until)
    }

    fn is_playing(&self) -> bool {
        self.held().is_playing()
    }

    fn halt(&mut self, now: Ticks) -> Ticks {
        self.held().halt(now)
    }

    fn played_steps(&self, axis: AxisId) -> i64 {
        self.held().played_steps(axis)
    }

    fn counted_steps(&self, axis: AxisId) -> Option<i64> {
        self.held().counted_steps(axis)
    }

    #[cfg(feature = "timers")]
    fn cd(&mut self) -> Option<&mut dyn motion::CdBackend> {
        let cd = self.cd.as_mut()?;
        Some(cd)
    }

    #[cfg(feature = "timers")]
    fn counted_c(&self) -> i64 {
        use motion::CdBackend;

        self.cd.as_ref().map_or(0, crate::cd::Cd::counted_c)
    }

    fn take_fault(&mut self) -> Option<FaultCode> {
        self.held().take_fault()
    }
}
