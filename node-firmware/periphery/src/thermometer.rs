//! The thermometer inside the chip: from what its converter shows to degrees.
//!
//! Factors and ranges are ESP-IDF's (`temperature_sensor_ll.h`, `temperature_sensor_periph.c`), the
//! same for the ESP32-S3 and its relatives. Without the chip's own calibration it is right to some
//! degrees, and the radio warms it.

/// What the sensor's digital-to-analogue converter is set to, and by how many ranges that shifts.
const RANGES: [(u8, i32); 5] = [(5, -2), (7, -1), (15, 0), (11, 1), (10, 2)];

/// Returns the temperature, °C, of a raw value at a setting of the converter; `None`: no such setting.
pub fn celsius(raw: u8, range: u8) -> Option<i16> {
    let (_, offset) = RANGES.iter().find(|(known, _)| *known == range)?;
    // Ten-thousandths of a degree: 0.4386 for each count, 27.88 for each range, from -20.52 on.
    let value = i32::from(raw) * 4_386 - offset * 278_800 - 205_200;
    i16::try_from((value + 5_000).div_euclid(10_000)).ok()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_range_shifts_what_the_converter_shows() {
        // The middle range is made for -10 to 80 °C, the highest for 50 to 125.
        assert_eq!(celsius(24, 15), Some(-10));
        assert_eq!(celsius(104, 15), Some(25));
        assert_eq!(celsius(229, 15), Some(80));
        assert_eq!(celsius(104, 7), Some(53));
        assert_eq!(celsius(204, 5), Some(125));
        assert_eq!(celsius(104, 10), Some(-31));
        assert_eq!(celsius(104, 0), None);
    }
}
