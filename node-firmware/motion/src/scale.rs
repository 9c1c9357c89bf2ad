//! Steps of a length: how G-code's millimetres become steps, with nothing lost on the way.
//!
//! A path is rounded where it is, not by how far it went: each target is converted from its own
//! place, and a way is the difference of two of them. So no path, however long and however finely it
//! is cut, is off by more than half a step, and a path that returns ends on the very step from which
//! it came.

/// Steps of one metre of one axis, 1 to [`STEPS_PER_M_MAX`]: a thousand times those of a millimetre,
/// so that 80.125 steps/mm are a whole number.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Scale {
    steps_per_m: u32,
}

/// Finest scale: 4·10⁶ steps/mm.
pub const STEPS_PER_M_MAX: u32 = 4_000_000_000;

/// Farthest place: 4,504 km. With the finest scale, 2⁵⁴ steps.
pub const PLACE_NM_MAX: i64 = 1 << 52;

impl Default for Scale {
    /// 80 steps/mm.
    fn default() -> Self {
        Self {
            steps_per_m: 80_000,
        }
    }
}

/// Nanometres of a metre.
const NM_PER_M: i128 = 1_000_000_000;

/// Why a length has no steps.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ScaleError {
    /// Not 1 to [`STEPS_PER_M_MAX`] steps of a metre.
    Scale,
    /// Farther than [`PLACE_NM_MAX`] from 0.
    Place,
}

impl core::fmt::Display for ScaleError {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        match self {
            Self::Scale => write!(f, "a metre has 1 to {STEPS_PER_M_MAX} steps"),
            Self::Place => write!(f, "a place is at most {PLACE_NM_MAX} nm from 0"),
        }
    }
}

impl core::error::Error for ScaleError {}

impl Scale {
    /// So many steps of a metre.
    ///
    /// # Errors
    /// [`ScaleError::Scale`].
    pub const fn per_m(steps_per_m: u32) -> Result<Self, ScaleError> {
        match steps_per_m {
            1..=STEPS_PER_M_MAX => Ok(Self { steps_per_m }),
            _ => Err(ScaleError::Scale),
        }
    }

    /// Returns the step nearest to a place, half a step away from 0.
    ///
    /// # Errors
    /// [`ScaleError::Place`].
    pub fn position_steps(&self, place_nm: i64) -> Result<i64, ScaleError> {
        if place_nm.unsigned_abs() > PLACE_NM_MAX.unsigned_abs() {
            return Err(ScaleError::Place);
        }
        let steps = i128::from(place_nm) * i128::from(self.steps_per_m);
        // 2⁵² · 2³² / 10⁹ is less than 2⁵⁵.
        Ok(round_div(steps, NM_PER_M) as i64)
    }

    /// Returns the steps of the way between two places: exactly what lies between their steps.
    ///
    /// # Errors
    /// [`ScaleError::Place`].
    pub fn way_steps(&self, from_nm: i64, to_nm: i64) -> Result<i64, ScaleError> {
        Ok(self.position_steps(to_nm)? - self.position_steps(from_nm)?)
    }

    /// Returns the place of a step, nm, rounded; saturating beyond what 64 bits hold.
    pub fn place_nm(&self, position_steps: i64) -> i64 {
        let nm = round_div(
            i128::from(position_steps) * NM_PER_M,
            i128::from(self.steps_per_m),
        );
        i64::try_from(nm).unwrap_or(if nm < 0 { i64::MIN } else { i64::MAX })
    }

    /// Returns a speed in mHz (thousandths of a step per second), rounded down: no axis is faster
    /// than it was told. Saturating.
    pub fn speed_mhz(&self, speed_nm_per_s: u64) -> u64 {
        let mhz = u128::from(speed_nm_per_s) * u128::from(self.steps_per_m) / 1_000_000;
        u64::try_from(mhz).unwrap_or(u64::MAX)
    }

    /// Returns an acceleration in steps/s², rounded down, 1 at least.
    pub fn accel_hz_per_s(&self, accel_nm_per_s2: u64) -> u32 {
        let accel = u128::from(accel_nm_per_s2) * u128::from(self.steps_per_m) / 1_000_000_000;
        u32::try_from(accel).unwrap_or(u32::MAX).max(1)
    }
}

/// Divides, rounds to the nearest, and halves away from 0.
pub(crate) const fn round_div(value: i128, by: i128) -> i128 {
    let half = if value < 0 { -by / 2 } else { by / 2 };
    (value + half) / by
}

#[cfg(test)]
mod tests {
    extern crate std;

    use super::*;
    use std::string::ToString;

    const MM: i64 = 1_000_000;

    fn scale(steps_per_m: u32) -> Scale {
        Scale::per_m(steps_per_m).expect("legal")
    }

    #[test]
    fn millimetres_are_steps() {
        let scale = scale(80_125);
        assert_eq!(scale.position_steps(MM), Ok(80));
        assert_eq!(scale.position_steps(4 * MM), Ok(321), "320.5, away from 0");
        assert_eq!(scale.position_steps(-4 * MM), Ok(-321));
        assert_eq!(scale.position_steps(1_000 * MM), Ok(80_125));
        assert_eq!(scale.place_nm(80_125), 1_000 * MM);
        // 20 mm/s and 3 m/s².
        assert_eq!(scale.speed_mhz(20 * MM as u64), 1_602_500);
        assert_eq!(scale.accel_hz_per_s(3_000 * MM as u64), 240_375);
        assert_eq!(scale.accel_hz_per_s(0), 1);
    }

    #[test]
    fn a_path_in_any_pieces_ends_on_the_step_of_its_end() {
        let mut state = 7_u64;
        let mut random = |below: u64| {
            state = state.wrapping_mul(0x5851_f42d_4c95_7f2d).wrapping_add(1);
            (state >> 33) % below
        };
        for round in 0..200 {
            let scale = scale(1 + random(1 << 30) as u32);
            let (mut place_nm, mut steps) = (0_i64, 0_i64);
            for _ in 0..500 {
                let next = place_nm + random(40_001) as i64 - 20_000;
                steps += scale.way_steps(place_nm, next).expect("near");
                place_nm = next;
            }
            assert_eq!(Ok(steps), scale.position_steps(place_nm), "round {round}");
            steps += scale.way_steps(place_nm, 0).expect("near");
            assert_eq!(steps, 0, "round {round}");
        }
    }

    #[test]
    fn a_step_is_its_own_place() {
        for steps_per_m in [1, 80_000, 80_125, 3_333_333, 500_000_000] {
            let scale = scale(steps_per_m);
            for steps in [-7_654_321, -1, 0, 1, 99, 123_456] {
                let place_nm = scale.place_nm(steps);
                if place_nm.abs() <= PLACE_NM_MAX {
                    assert_eq!(scale.position_steps(place_nm), Ok(steps), "{steps_per_m}");
                }
            }
        }
    }

    #[test]
    fn what_cannot_be_is_refused() {
        assert_eq!(Scale::per_m(0), Err(ScaleError::Scale));
        assert_eq!(Scale::per_m(u32::MAX), Err(ScaleError::Scale));
        let finest = scale(STEPS_PER_M_MAX);
        assert_eq!(finest.position_steps(PLACE_NM_MAX), Ok(4 * PLACE_NM_MAX));
        for place_nm in [PLACE_NM_MAX + 1, -PLACE_NM_MAX - 1, i64::MIN] {
            assert_eq!(finest.position_steps(place_nm), Err(ScaleError::Place));
        }
        assert_eq!(scale(1).place_nm(i64::MIN), i64::MIN);
        assert!(!ScaleError::Scale.to_string().is_empty());
        assert!(!ScaleError::Place.to_string().is_empty());
    }
}
