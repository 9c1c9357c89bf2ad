//! Which pins a board can have.

use provision::{
    Chip, Machine, PinFault, PinUse, Wiring,
    chip::PinWhy,
    machine::{End, SwitchOf, SwitchSettings},
    wiring::{KIT_SWITCHES, PINS_MAX, PinSetting, check, kit_pin},
};

fn wiring(axis_count: u8, pins: &[(&str, u8)]) -> Wiring {
    let mut wiring = Wiring {
        axis_count,
        ..Wiring::default()
    };
    for (of, gpio) in pins {
        let of = of.parse().expect("a use");
        let gpio = Some(*gpio);
        assert!(wiring.set(PinSetting { of, gpio }), "{of}");
    }
    wiring
}

fn words(axis_count: u8, pins: &[(&str, u8)], machine: &Machine) -> String {
    check(&wiring(axis_count, pins), machine, Chip::Esp32S3)
        .map_or_else(|fault| fault.to_string(), |()| "good".to_owned())
}

/// Everything that the kit has a pin for.
fn full() -> Machine {
    let mut machine = Machine {
        has_cd: true,
        has_lidar: true,
        ..Machine::default()
    };
    for (of, end) in KIT_SWITCHES {
        assert!(machine.add(SwitchSettings {
            of,
            end,
            normally_closed: true,
            homes: false,
        }));
    }
    machine
}

#[test]
fn the_kit_as_it_is_and_with_all_that_it_can_have_is_good() {
    let nothing = Machine::default();
    for axes in [0, 1, 2, 3, 4] {
        assert_eq!(words(axes, &[], &nothing), "good");
    }
    assert_eq!(words(0, &[], &full()), "good");
    assert_eq!(Wiring::default().axes(), 2);
    for (of, end) in KIT_SWITCHES {
        assert!(kit_pin(PinUse::Switch { of, end }).is_some());
    }
    // Four axes and C and D at once: their switches lie elsewhere, or are none.
    let cd = Machine {
        has_cd: true,
        ..Machine::default()
    };
    assert_eq!(words(4, &[], &cd), "good");
}

#[test]
fn a_pin_that_cannot_be_is_named_with_the_reason() {
    let nothing = Machine::default();
    for (of, gpio, why) in [
        ("0:step", 49, "the chip has no such pin"),
        ("0:step", 22, "the chip has no such pin"),
        ("0:step", 255, "the chip has no such pin"),
        ("0:dir", 26, "the module's flash is there"),
        ("0:dir", 32, "the module's flash is there"),
        ("1:step", 33, "the module's octal PSRAM is there"),
        ("1:step", 37, "the module's octal PSRAM is there"),
        ("enable", 19, "USB is there"),
        ("lamp", 20, "USB is there"),
        ("stop", 0, "its level at the reset says how the chip boots"),
        ("stop", 45, "its level at the reset says how the chip boots"),
        ("stop", 46, "its level at the reset says how the chip boots"),
        ("1:dir", 43, "the kit's serial bridge is there"),
        ("1:dir", 44, "the kit's serial bridge is there"),
        ("laser", 18, "it is driven high for 60 µs at power on"),
        ("enable", 18, "it is driven high for 60 µs at power on"),
        ("0:enable", 18, "it is driven high for 60 µs at power on"),
        ("0:step", 5, "it is 0:step"),
    ] {
        let lamp_off = [(of, gpio), ("lamp", 21)];
        let told: &[_] = if of == "lamp" {
            &lamp_off[..1]
        } else {
            &lamp_off
        };
        let said = words(0, told, &nothing);
        let (of, other) = if why == "it is 0:step" {
            ("0:dir", why)
        } else {
            (of, why)
        };
        assert_eq!(said, format!("GPIO {gpio} cannot be {of}: {other}"));
    }
}

#[test]
fn two_uses_of_one_pin_are_named_both() {
    let nothing = Machine::default();
    assert_eq!(
        words(3, &[("2:step", 7)], &nothing),
        "GPIO 7 cannot be 2:step: it is 1:dir"
    );
    // The kit has switches of C where its third axis is.
    assert_eq!(
        words(3, &[], &full()),
        "GPIO 16 cannot be c:min: it is 2:step"
    );
    // Two that change places are none too many.
    assert_eq!(words(0, &[("0:step", 5), ("0:dir", 4)], &nothing), "good");
    // What the machine has not is not in the way.
    assert_eq!(words(0, &[("0:step", 38)], &nothing), "good");
    assert_eq!(
        words(0, &[("0:step", 38)], &full()),
        "GPIO 38 cannot be c:step: it is 0:step"
    );
}

#[test]
fn what_is_missing_or_too_many_is_said() {
    let mut machine = Machine::default();
    assert!(machine.add(SwitchSettings {
        of: SwitchOf::Axis(2),
        end: End::Min,
        normally_closed: true,
        homes: true,
    }));
    assert_eq!(words(3, &[], &machine), "2:min: it has no pin (--pin)");
    assert_eq!(words(3, &[("2:min", 9)], &machine), "good");
    let nothing = Machine::default();
    assert_eq!(
        words(2, &[("2:step", 9)], &nothing),
        "GPIO 9 cannot be 2:step: there are 2 axes (--axes, or --no-pins to forget it)"
    );
    let fault = PinFault {
        of: PinUse::Step(2),
        gpio: None,
        why: PinWhy::Axes { max: 2 },
    };
    assert_eq!(check(&wiring(3, &[]), &nothing, Chip::Esp32C6), Err(fault));
    // A board may do without these; not without the stop, which `Setting::Pin` refuses.
    let mut less = Wiring::default();
    for of in ["enable", "laser", "lamp"] {
        let of = of.parse().expect("a use");
        assert!(less.set(PinSetting { of, gpio: None }));
    }
    assert_eq!(check(&less, &nothing, Chip::Esp32S3), Ok(()));
    let of = PinUse::Step(0);
    assert!(less.set(PinSetting { of, gpio: None }));
    let fault = check(&less, &nothing, Chip::Esp32S3).expect_err("no step");
    assert_eq!(fault.why, PinWhy::Missing);
}

#[test]
fn every_use_reads_as_it_is_written() {
    let wiring = wiring(4, &[]);
    let machine = full();
    let mut seen = 0;
    for of in wiring.uses(&machine) {
        assert_eq!(of.to_string().parse(), Ok(of));
        assert_eq!(PinUse::try_from(u8::from(of)), Ok(of), "{of}");
        seen += 1;
    }
    assert_eq!(seen, 12 + 11 + KIT_SWITCHES.len());
    let legal = (0..=255).filter(|code| PinUse::try_from(*code).is_ok());
    for code in legal {
        let of = PinUse::try_from(code).expect("legal");
        assert_eq!(u8::from(of), code);
        assert_eq!(of.to_string().parse(), Ok(of));
    }
    // Records have these bytes for ever.
    let shown: Vec<u8> = [
        PinUse::Step(3),
        PinUse::Direction(1),
        PinUse::Enable,
        PinUse::Lidar,
    ]
    .map(u8::from)
    .to_vec();
    assert_eq!(shown, [3, 9, 64, 74]);
    for wrong in [
        "",
        "step",
        "0",
        "4:step",
        "9:min",
        "c:home",
        "c:dir",
        "d:enable",
        "probe:min",
        "0:sep",
        "x:min",
    ] {
        assert!(wrong.parse::<PinUse>().is_err(), "{wrong}");
    }
}

#[test]
fn more_pins_than_a_chip_has_are_refused_and_change_nothing() {
    let mut wiring = Wiring {
        axis_count: 4,
        ..Wiring::default()
    };
    let machine = full();
    let all: Vec<_> = wiring.clone().uses(&machine).collect();
    for of in &all[..PINS_MAX] {
        assert!(wiring.set(PinSetting {
            of: *of,
            gpio: Some(1)
        }));
    }
    let last = PinSetting {
        of: all[PINS_MAX],
        gpio: Some(1),
    };
    let before = wiring.clone();
    assert!(!wiring.set(last));
    assert!(
        wiring.set(PinSetting {
            of: all[0],
            gpio: Some(1)
        }),
        "it is known"
    );
    assert_eq!(wiring, before);
}
