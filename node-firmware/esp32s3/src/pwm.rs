//! The LEDC's registers. Logic is in [`periphery::pwm`].

use crate::{
    board::{Other, other_pin, pin},
    rmt::{route_pin, take_pin},
};
use esp_hal::{
    gpio::{Level, Output, OutputConfig, OutputSignal},
    ledc::{LSGlobalClkSource, Ledc},
    peripherals::LEDC,
};
use periphery::{PwmRegisters, PwmTimer};

/// The hardware itself; there is nothing to hold.
#[derive(Clone, Copy, Debug)]
pub(crate) struct PwmChip;

/// Signal and pin of each channel: laser and D. Either may have none.
const CHANNELS: [(OutputSignal, Other); 2] = [
    (OutputSignal::LEDC_LS_SIG0, Other::Laser),
    (OutputSignal::LEDC_LS_SIG1, Other::StepD),
];

impl PwmChip {
    /// Switches its clock on; nothing drives a pin yet.
    pub(crate) fn new(ledc: LEDC<'static>) -> Self {
        let mut ledc = Ledc::new(ledc);
        ledc.set_global_slow_clock(LSGlobalClkSource::APBClk);
        // The clock runs for as long as it exists.
        core::mem::forget(ledc);
        for channel in 0..CHANNELS.len() {
            // SAFETY: there are four timers, and channel n has the timer n.
            LEDC::regs()
                .ch(channel)
                .conf0()
                .modify(|_, w| unsafe { w.timer_sel().bits(channel as u8) });
        }
        Self
    }

    /// Makes a channel's pin an output, low, for as long as the program runs.
    pub(crate) fn take(channel: usize) {
        let (_, of) = CHANNELS[channel];
        let Some(number) = other_pin(of) else {
            return;
        };
        let output = Output::new(pin(number), Level::Low, OutputConfig::default());
        core::mem::forget(output);
    }
}

impl PwmRegisters for PwmChip {
    fn set_timer(&mut self, timer: usize, setting: PwmTimer) {
        let conf = LEDC::regs().timer(timer).conf();
        // SAFETY: 18 bits of divider and 1 to 14 bits of resolution are legal.
        conf.modify(|_, w| unsafe {
            w.pause().clear_bit();
            w.clk_div().bits(setting.divider);
            w.duty_res().bits(setting.bits as u8);
            w.rst().set_bit()
        });
        conf.modify(|_, w| {
            w.rst().clear_bit();
            w.para_up().set_bit()
        });
    }

    fn set_duty(&mut self, channel: usize, from: u32, counts: u32) {
        let channel = LEDC::regs().ch(channel);
        // SAFETY: counts of a timer of at most 14 bits; the duty's lowest four bits are for fading.
        unsafe {
            channel.hpoint().write(|w| w.hpoint().bits(from as _));
            channel.duty().write(|w| w.duty().bits(counts << 4));
        }
        channel.conf1().write(|w| {
            // No fading: one step of nothing.
            #[cfg(feature = "esp32s3")]
            // SAFETY: any value of these fields is legal.
            unsafe {
                w.duty_inc().set_bit();
                w.duty_num().bits(1);
                w.duty_cycle().bits(1);
                w.duty_scale().bits(0);
            }
            w.duty_start().set_bit()
        });
        channel.conf0().modify(|_, w| w.para_up().set_bit());
    }

    fn output(&mut self, channel: usize, on: bool) {
        let (signal, of) = CHANNELS[channel];
        let Some(number) = other_pin(of) else {
            return;
        };
        if !on {
            take_pin(number);
        }
        LEDC::regs().ch(channel).conf0().modify(|_, w| {
            w.sig_out_en().bit(on);
            w.idle_lv().clear_bit();
            w.para_up().set_bit()
        });
        if on {
            route_pin(number, signal);
        }
    }
}
