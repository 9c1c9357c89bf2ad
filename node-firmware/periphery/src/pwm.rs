//! LEDC: the laser's power, and how one of its timers is set to a rate.
//!
//! Traps of this peripheral: resolution and divider belong together (a divider is 1 to 1,023 and
//! 255/256, so 14 bits go from 4.8 Hz to 4.9 kHz only); a new duty counts from the next overflow; a
//! rate of 0 stops nothing. So nothing here ever has a rate of 0, and off is the output itself, which
//! takes effect at once.

use motion::limits::TICK_HZ;

/// Clock of the timers, Hz: the bus clock.
pub const CLOCK_HZ: u64 = 80_000_000;

/// Most bits of a timer.
pub const BITS_MAX: u32 = 14;

/// Largest divider, 256ths.
pub const DIVIDER_MAX: u32 = 0x3_ffff;

/// Smallest divider, 256ths: 1.
pub const DIVIDER_MIN: u32 = 256;

/// How a timer is set.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct PwmTimer {
    /// DUTY_RES: it counts to two to the power of this, 1 to [`BITS_MAX`].
    pub bits: u32,
    /// CLK_DIV: cycles of the bus clock in one count, 256ths.
    pub divider: u32,
}

impl PwmTimer {
    /// Sets one cycle to so many ticks of 62.5 ns, as finely as it can be. What is longer than
    /// [`PwmTimer::CYCLE_TICKS_MAX`] is as long as that; what is shorter than two cycles of the bus
    /// clock is two.
    pub const fn of_cycle(cycle_ticks: u64) -> Self {
        let cycle_ticks = if cycle_ticks > Self::CYCLE_TICKS_MAX {
            Self::CYCLE_TICKS_MAX
        } else {
            cycle_ticks
        };
        let clocks_256 = cycle_ticks * (CLOCK_HZ / TICK_HZ) * 256;
        let mut bits = BITS_MAX;
        while bits > 1 && clocks_256 >> bits < DIVIDER_MIN as u64 {
            bits -= 1;
        }
        let divider = (clocks_256 + (1 << (bits - 1))) >> bits;
        let divider = if divider < DIVIDER_MIN as u64 {
            DIVIDER_MIN
        } else if divider > DIVIDER_MAX as u64 {
            DIVIDER_MAX
        } else {
            divider as u32
        };
        Self { bits, divider }
    }

    /// Longest cycle: 209.7 ms.
    pub const CYCLE_TICKS_MAX: u64 =
        ((DIVIDER_MAX as u64) << BITS_MAX) / (256 * (CLOCK_HZ / TICK_HZ));

    /// Returns the length of one cycle, 256ths of a cycle of the bus clock.
    pub const fn cycle_clocks_256(self) -> u64 {
        (self.divider as u64) << self.bits
    }

    /// Returns the count of half a cycle.
    pub const fn half(self) -> u32 {
        1 << (self.bits - 1)
    }
}

/// The LEDC's registers.
pub trait PwmRegisters {
    /// Writes TIMERn_CONF, resets the counter to 0 and strobes PARA_UP.
    fn set_timer(&mut self, timer: usize, setting: PwmTimer);

    /// Writes HPOINT, DUTY, DUTY_START and strobes PARA_UP: from the next overflow on the channel is
    /// high from the count `from` on, for `counts`.
    fn set_duty(&mut self, channel: usize, from: u32, counts: u32);

    /// Writes SIG_OUT_EN with IDLE_LV low and strobes PARA_UP: off is low at once.
    fn output(&mut self, channel: usize, on: bool);
}

/// Cycle of the laser's power: 5 kHz, ten bits of resolution and a divider of 15.6.
pub const LASER_CYCLE_TICKS: u64 = TICK_HZ / 5_000;

/// The laser: off until it is told, off at once.
#[derive(Clone, Copy, Debug)]
pub struct Laser {
    channel: usize,
    setting: PwmTimer,
    percent: u8,
}

impl Laser {
    /// Sets timer and channel; the output is low.
    pub fn new(registers: &mut impl PwmRegisters, timer: usize, channel: usize) -> Self {
        let setting = PwmTimer::of_cycle(LASER_CYCLE_TICKS);
        registers.output(channel, false);
        registers.set_timer(timer, setting);
        registers.set_duty(channel, 0, 0);
        Self {
            channel,
            setting,
            percent: 0,
        }
    }

    /// Sets the power; above 100 is 100. 0 is at once; another power counts within a cycle, 200 µs,
    /// and until then it is the one that was set before.
    pub fn set(&mut self, registers: &mut impl PwmRegisters, percent: u8) {
        let percent = percent.min(100);
        self.percent = percent;
        if percent == 0 {
            registers.output(self.channel, false);
            registers.set_duty(self.channel, 0, 0);
            return;
        }
        let full = 2 * self.setting.half();
        let counts = u64::from(full) * u64::from(percent) / 100;
        registers.set_duty(self.channel, 0, counts as u32);
        registers.output(self.channel, true);
    }

    /// Returns the power, percent.
    pub const fn percent(&self) -> u8 {
        self.percent
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_cycle_is_as_long_as_it_was_asked_for() {
        for hz in [
            5, 6, 10, 100, 999, 1_000, 4_882, 4_883, 5_000, 25_000, 39_999, 40_000,
        ] {
            let cycle_ticks = TICK_HZ / hz;
            let timer = PwmTimer::of_cycle(cycle_ticks);
            assert!((1..=BITS_MAX).contains(&timer.bits), "{hz} Hz: {timer:?}");
            assert!(
                (DIVIDER_MIN..=DIVIDER_MAX).contains(&timer.divider),
                "{hz} Hz: {timer:?}"
            );
            let wanted = cycle_ticks * 5 * 256;
            let off = timer.cycle_clocks_256().abs_diff(wanted);
            // Half a 256th of a divider of at least 1: 0.2 %, and less where it is slower.
            assert!(off * 512 <= wanted, "{hz} Hz: {off} of {wanted}");
        }
    }

    #[test]
    fn what_is_slower_than_the_timer_can_is_as_slow_as_it_can_be() {
        let slowest = PwmTimer::of_cycle(u64::MAX);
        assert_eq!(slowest, PwmTimer::of_cycle(PwmTimer::CYCLE_TICKS_MAX));
        assert_eq!((slowest.bits, slowest.divider), (BITS_MAX, DIVIDER_MAX));
        assert_eq!(TICK_HZ / PwmTimer::CYCLE_TICKS_MAX, 4, "Hz");
        let fastest = PwmTimer::of_cycle(0);
        assert_eq!((fastest.bits, fastest.divider), (1, DIVIDER_MIN));
    }
}
