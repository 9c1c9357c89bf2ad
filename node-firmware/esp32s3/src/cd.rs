//! C and D: the registers of their timers and of C's counter, and its interrupt.
//!
//! Logic is in [`periphery::cd`]; here is one access after the other. C has timer and operator 0 of
//! MCPWM0 and unit 3 of the pulse counter, D the LEDC's channel 1.

use crate::{
    board::{Other, other_pin, pin},
    pwm::PwmChip,
    rmt::{reads_high, route_pin, take_pin},
};
use core::cell::UnsafeCell;
use esp_hal::{
    gpio::{Flex, InputConfig, OutputConfig, OutputSignal},
    handler,
    interrupt::Priority,
    mcpwm::{
        McPwm, PeripheralClockConfig,
        operator::{PwmActions, PwmPinConfig, PwmUpdateMethod, UpdateAction},
    },
    pcnt::{
        Pcnt,
        channel::{CtrlMode, EdgeMode},
    },
    peripherals::{MCPWM0, PCNT},
    ram,
    time::Rate,
};
use motion::{CdBackend, Direction, Ticks, limits::TICK_HZ};
use periphery::{CdRegisters, PwmRegisters, PwmTimer, Timers, cd::StepTimer};

/// Unit of the pulse counter: the last one, see `board::counted_axes`.
const UNIT: usize = 3;

/// The hardware itself; there is nothing to hold.
#[derive(Debug)]
struct CdChip;

impl PwmRegisters for CdChip {
    fn set_timer(&mut self, timer: usize, setting: PwmTimer) {
        PwmChip.set_timer(timer, setting);
    }

    fn set_duty(&mut self, channel: usize, from: u32, counts: u32) {
        PwmChip.set_duty(channel, from, counts);
    }

    fn output(&mut self, channel: usize, on: bool) {
        PwmChip.output(channel, on);
    }
}

impl CdRegisters for CdChip {
    fn set_step_timer(&mut self, setting: StepTimer) {
        let timer = MCPWM0::regs().timer(0);
        // SAFETY: the fields hold what `StepTimer` promises, less one where the manual says so.
        unsafe {
            timer.cfg1().write(|w| w.mod_().bits(0));
            let toggle = !timer.sync().read().sw().bit();
            timer.sync().write(|w| {
                w.phase().bits(0);
                w.phase_direction().clear_bit();
                w.sw().bit(toggle)
            });
            timer.cfg0().write(|w| {
                w.prescale().bits((setting.prescale - 1) as u8);
                w.period().bits((setting.period - 1) as u16);
                w.period_upmethod().bits(0)
            });
            let operator = MCPWM0::regs().ch(0);
            #[cfg(feature = "esp32s3")]
            operator.cmpr_value0().write(|w| w.a().bits(setting.rise()));
            #[cfg(feature = "esp32c6")]
            operator.gen_tstmp_a().write(|w| w.a().bits(setting.rise()));
        }
    }

    fn run_step_timer(&mut self) {
        // SAFETY: START 2 is "runs on", MOD 1 counts up.
        MCPWM0::regs().timer(0).cfg1().write(|w| unsafe {
            w.start().bits(2);
            w.mod_().bits(1)
        });
    }

    #[inline(always)]
    fn end_step_timer(&mut self) {
        // SAFETY: START 0 is "ends at zero", MOD 1 counts up.
        MCPWM0::regs().timer(0).cfg1().write(|w| unsafe {
            w.start().bits(0);
            w.mod_().bits(1)
        });
    }

    fn set_gate(&mut self, open: bool) {
        let Some(number) = other_pin(Other::StepC) else {
            return;
        };
        if open {
            route_pin(number, OutputSignal::PWM0_0A);
        } else {
            take_pin(number);
        }
    }

    fn step_pin_c(&self) -> bool {
        other_pin(Other::StepC).is_some_and(reads_high)
    }

    fn reset_counter(&mut self, steps: u16) {
        let unit = PCNT::regs().unit(UNIT);
        // SAFETY: any 16 bits are a threshold.
        unit.conf1()
            .modify(|_, w| unsafe { w.cnt_thres0().bits(steps) });
        unit.conf0().modify(|_, w| w.thr_thres0_en().set_bit());
        let ctrl = PCNT::regs().ctrl();
        ctrl.modify(|_, w| w.cnt_rst_u(UNIT as u8).set_bit());
        ctrl.modify(|_, w| w.cnt_rst_u(UNIT as u8).clear_bit());
    }

    #[inline(always)]
    fn count_c(&self) -> u16 {
        PCNT::regs().u_cnt(UNIT).read().cnt().bits()
    }

    #[inline(always)]
    fn acknowledge_count(&mut self) {
        PCNT::regs()
            .int_clr()
            .write(|w| w.cnt_thr_event_u(UNIT as u8).set_bit());
    }

    fn listen_count(&mut self, on: bool) {
        PCNT::regs()
            .int_ena()
            .modify(|_, w| w.cnt_thr_event_u(UNIT as u8).bit(on));
    }
}

struct Shared(UnsafeCell<Timers<CdChip>>);

// SAFETY: it is used by one core only, by its interrupt and by its planning task, and never by both
// at once: the task masks interrupts while it does.
unsafe impl Sync for Shared {}

static TIMERS: Shared = Shared(UnsafeCell::new(Timers::new(CdChip)));

/// C's counter has come to its threshold. As urgent as a refill, so neither comes into the other.
#[handler(priority = Priority::Priority3)]
#[ram]
fn arrived() {
    // SAFETY: the planning task is on this core and masks interrupts while it uses it.
    let timers = unsafe { &mut *TIMERS.0.get() };
    timers.on_interrupt();
}

fn with_timers<T>(use_it: impl FnOnce(&mut Timers<CdChip>) -> T) -> T {
    critical_section::with(|_| {
        // SAFETY: the only other user is the interrupt, which is masked on this core, and it runs on
        // no other one.
        use_it(unsafe { &mut *TIMERS.0.get() })
    })
}

/// C and D of the board: the one handle to their timers.
#[derive(Debug)]
pub(crate) struct Cd {
    _own: (),
}

impl Cd {
    /// Sets up clocks, pins and interrupt on the core that calls it, which is the one that plans. The
    /// LEDC runs already.
    ///
    /// # Panics
    /// The board has no step pin of C; or the clock of MCPWM is none of 16 MHz, which is a divisor of its 160.
    pub(crate) fn new(mcpwm: MCPWM0<'static>, counters: &mut Pcnt<'static>) -> Self {
        let clock = PeripheralClockConfig::with_frequency(Rate::from_hz(TICK_HZ as u32))
            .expect("a tenth of its 160 MHz");
        let mut mcpwm = McPwm::new(mcpwm, clock);
        mcpwm.operator0.set_timer(&mcpwm.timer0);
        let number = other_pin(Other::StepC).expect("a wiring that was checked");
        let mut flex = Flex::new(pin(number));
        flex.apply_output_config(&OutputConfig::default());
        flex.apply_input_config(&InputConfig::default());
        flex.set_input_enable(true);
        flex.set_low();
        flex.set_output_enable(true);
        let (step_in, step_out) = flex.split();
        let actions = PwmActions::empty()
            .on_up_counting_timer_equals_zero(UpdateAction::SetLow)
            .on_up_counting_timer_equals_timestamp(UpdateAction::SetHigh);
        let config = PwmPinConfig::new(actions, PwmUpdateMethod::empty());
        // The HAL keeps clocks and pin for as long as these exist.
        core::mem::forget(mcpwm.operator0.with_pin_a(step_out, config));
        core::mem::forget(mcpwm.timer0);
        let unit = &counters.unit3;
        unit.channel0.set_edge_signal(step_in);
        unit.channel0
            .set_input_mode(EdgeMode::Hold, EdgeMode::Increment);
        unit.channel0.set_ctrl_mode(CtrlMode::Keep, CtrlMode::Keep);
        unit.clear();
        unit.resume();
        counters.set_interrupt_handler(arrived);
        PwmChip::take(1);
        with_timers(Timers::begin);
        Self { _own: () }
    }
}

impl CdBackend for Cd {
    fn run_c(&mut self, now: Ticks, steps: i64, interval_ticks: u64) {
        with_timers(|timers| timers.run_c(now, steps, interval_ticks));
    }

    fn halt_c(&mut self, now: Ticks) {
        with_timers(|timers| timers.halt_c(now));
    }

    fn is_c_running(&self) -> bool {
        with_timers(|timers| timers.is_c_running())
    }

    fn counted_c(&self) -> i64 {
        with_timers(|timers| timers.counted_c())
    }

    fn run_d(&mut self, now: Ticks, way: Direction, interval_ticks: u64) {
        with_timers(|timers| timers.run_d(now, way, interval_ticks));
    }

    fn halt_d(&mut self, now: Ticks) {
        with_timers(|timers| timers.halt_d(now));
    }

    fn service(&mut self, until: Ticks) -> Ticks {
        with_timers(|timers| timers.service(until))
    }
}
