//! What a board has beside its pulses.

use crate::{board, inputs::InputPins, pulses::rest, rmt::now_ticks, shift::ShiftRegister};
#[cfg(feature = "timers")]
use crate::{
    board::{Other, other_pin},
    cd::Cd,
    pwm::PwmChip,
    rmt::reads_high,
};
use esp_hal::{gpio::Flex, peripherals::IO_MUX};
use esp_println::println;
use motion::TICKS_PER_US;
#[cfg(feature = "timers")]
use motion::{CdBackend, Ticks};
#[cfg(feature = "timers")]
use periphery::Laser;

/// Every switch input is pressed and released by its own pin. Nothing may be connected that holds it.
pub(crate) fn check_inputs(io_mux: IO_MUX<'static>, numbers: &[u8]) -> u32 {
    // Before they are inputs: taking a pin resets it.
    let pins = numbers.iter().map(|number| Flex::new(board::pin(*number)));
    let mut pins: heapless::Vec<Flex<'static>, 11> = pins.collect();
    let (mut inputs, levels) = InputPins::new(io_mux, numbers);
    if levels.count_ones() as usize != numbers.len() {
        println!("note inputs: {levels:#b} at rest, all high expected");
    }
    let mut failures = 0;
    for (index, (number, pin)) in numbers.iter().zip(pins.iter_mut()).enumerate() {
        pin.set_high();
        pin.set_output_enable(true);
        for high in [false, true] {
            let at = now_ticks();
            pin.set_level(high.into());
            rest(50);
            let told = inputs.poll(|_| 0);
            let right = told.is_some_and(|told| {
                let late_ticks = told.at.0.wrapping_sub(at);
                told.index == index && told.level == high && late_ticks < 20 * TICKS_PER_US
            });
            if !right || inputs.has_caught() && inputs.poll(|_| 0).is_some() {
                failures += 1;
                println!("FAIL inputs: GPIO {number} to {high}: {told:?}");
            }
        }
        pin.set_output_enable(false);
    }
    verdict(failures, "inputs");
    failures
}

/// 256 words through the shift register.
pub(crate) fn check_shift() -> u32 {
    let mut register = ShiftRegister::new();
    if (0..256).all(|word| register.exchange(word) == 0) {
        println!("SKIP shift register: nothing comes back");
        return 0;
    }
    let wrong = (0..256_u32).filter(|word| register.exchange(*word) != *word);
    let failures = wrong.count() as u32;
    register.exchange(0);
    verdict(failures, "shift register, words wrong of 256");
    failures
}

/// C's runs, counted at the pin.
#[cfg(feature = "timers")]
pub(crate) fn check_c(c: &mut Cd) -> u32 {
    let mut failures = 0;
    let mut expected = 0;
    for (steps, interval_ticks) in [(1, 16_000), (-2, 1_600), (1_000, 800), (-70_000, 800)] {
        expected += steps;
        c.run_c(Ticks(now_ticks()), steps, interval_ticks);
        while c.is_c_running() {
            c.service(Ticks(now_ticks()));
        }
        rest(5_000);
        let counted = c.counted_c();
        if counted != expected {
            failures += 1;
            println!("FAIL C: {counted} steps, {expected} expected");
            expected = counted;
        }
    }
    verdict(failures, "C");
    failures
}

/// The laser's share of time. Nothing that burns may be connected.
#[cfg(feature = "timers")]
pub(crate) fn check_laser(mut pwm: PwmChip) -> u32 {
    let Some(pin) = other_pin(Other::Laser) else {
        return 0;
    };
    IO_MUX::regs()
        .gpio(usize::from(pin))
        .modify(|_, w| w.fun_ie().set_bit());
    PwmChip::take(0);
    let mut laser = Laser::new(&mut pwm, 0, 0);
    let mut failures = 0;
    for percent in [0, 1, 25, 50, 99, 100, 0] {
        laser.set(&mut pwm, percent);
        rest(1_000);
        let (mut high, mut all) = (0_u32, 0_u32);
        let until = now_ticks() + 20_000 * TICKS_PER_US;
        while now_ticks() < until {
            high += u32::from(reads_high(pin));
            all += 1;
        }
        let found = high * 100 / all;
        if found.abs_diff(u32::from(percent)) > 1 {
            failures += 1;
            println!("FAIL laser: {found} % of the time, {percent} expected");
        }
    }
    verdict(failures, "laser");
    failures
}

/// Says how a test has ended.
fn verdict(failures: u32, test: &str) {
    let word = if failures == 0 { "PASS" } else { "FAIL" };
    println!("{word} {test}: {failures} failures");
}
