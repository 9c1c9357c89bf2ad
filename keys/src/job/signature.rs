//! An operator's signature as it stands in a job.

use core::fmt;
use serde::{Deserialize, Deserializer, Serialize, de::Error};
use std::{format, string::String};

/// Who has signed a job, for which life of its node; what is signed stands in `signed.rs`.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct JobSignature {
    /// The Ed25519 public key, 64 hexadecimal digits.
    pub key: Hex<32>,
    /// Random number of the node's boot.
    pub boot: u32,
    /// Used once.
    pub number: u64,
    /// The Ed25519 signature, 128 hexadecimal digits.
    pub signature: Hex<64>,
}

/// Bytes that stand as hexadecimal digits in text.
#[derive(Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub struct Hex<const COUNT: usize>(pub [u8; COUNT]);

impl<const COUNT: usize> fmt::Display for Hex<COUNT> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.0.iter().try_for_each(|byte| write!(f, "{byte:02x}"))
    }
}

impl<const COUNT: usize> fmt::Debug for Hex<COUNT> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        fmt::Display::fmt(self, f)
    }
}

impl<const COUNT: usize> core::str::FromStr for Hex<COUNT> {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let bad = || format!("not {} hexadecimal digits", 2 * COUNT);
        if text.len() != 2 * COUNT || !text.bytes().all(|byte| byte.is_ascii_hexdigit()) {
            return Err(bad());
        }
        let mut bytes = [0; COUNT];
        for (index, byte) in bytes.iter_mut().enumerate() {
            let digits = &text[2 * index..2 * index + 2];
            *byte = u8::from_str_radix(digits, 16).map_err(|_| bad())?;
        }
        Ok(Self(bytes))
    }
}

impl<const COUNT: usize> Serialize for Hex<COUNT> {
    fn serialize<S: serde::Serializer>(&self, writer: S) -> Result<S::Ok, S::Error> {
        writer.collect_str(self)
    }
}

impl<'de, const COUNT: usize> Deserialize<'de> for Hex<COUNT> {
    fn deserialize<D: Deserializer<'de>>(reader: D) -> Result<Self, D::Error> {
        let text = String::deserialize(reader)?;
        text.parse().map_err(D::Error::custom)
    }
}
