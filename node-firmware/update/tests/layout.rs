//! The firmware's numbers and the partition table that is flashed are the same.

use update::layout::{FLASH_BYTES, JOURNAL, OTADATA, RECORD, SCRIPTS, SLOTS};

/// Name, begin and bytes of each partition.
fn partitions() -> Vec<(String, u32, u32)> {
    let path = concat!(env!("CARGO_MANIFEST_DIR"), "/../esp32s3/partitions.csv");
    let text = std::fs::read_to_string(path).expect("the partition table");
    let number = |text: &str| {
        let digits = text.trim_start_matches("0x");
        u32::from_str_radix(digits, 16).expect("hexadecimal")
    };
    text.lines()
        .filter(|line| !line.starts_with('#') && !line.is_empty())
        .map(|line| {
            let fields: Vec<&str> = line.split(',').map(str::trim).collect();
            (fields[0].to_owned(), number(fields[3]), number(fields[4]))
        })
        .collect()
}

#[test]
fn the_layout_is_the_partition_table() {
    let partitions = partitions();
    for (name, place) in [
        ("otadata", OTADATA),
        ("ota_0", SLOTS[0]),
        ("ota_1", SLOTS[1]),
        ("record", RECORD),
        ("update", JOURNAL),
        ("scripts", SCRIPTS),
    ] {
        let row = partitions.iter().find(|row| row.0 == name);
        let (_, at, bytes) = row.unwrap_or_else(|| panic!("no partition {name}"));
        assert_eq!((*at, *bytes), (place.at, place.bytes), "{name}");
    }
}

#[test]
fn partitions_follow_each_other_and_fit() {
    let mut end = 0x9000;
    for (name, at, bytes) in partitions() {
        assert!(at >= end, "{name} begins in the one before");
        end = at + bytes;
    }
    assert!(end <= FLASH_BYTES);
}
