//! An arc → chords. Plane geometry only; what moves along the plane's normal is shared out evenly.

use std::f64::consts::TAU;

/// Ends that lie closer together than this, as an angle, make a full circle (as in GRBL).
const FULL_CIRCLE_RAD: f64 = 5e-7;

/// Radii at both ends may differ by this, mm, or by [`RADII_SHARE`] of the radius: posts write three
/// digits.
const RADII_MM: f64 = 0.005;

/// See [`RADII_MM`].
const RADII_SHARE: f64 = 0.001;

/// An arc in a plane. Places and lengths in mm.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Arc {
    center: [f64; 2],
    radius: [f64; 2],
    begin_rad: f64,
    sweep_rad: f64,
}

impl Arc {
    /// Takes the centre relative to the begin.
    ///
    /// # Errors
    /// It is no arc: in words.
    pub(super) fn by_center(
        begin: [f64; 2],
        end: [f64; 2],
        offset: [f64; 2],
        clockwise: bool,
    ) -> Result<Self, String> {
        let center = [begin[0] + offset[0], begin[1] + offset[1]];
        let from = [-offset[0], -offset[1]];
        let to = [end[0] - center[0], end[1] - center[1]];
        let radius = [from[0].hypot(from[1]), to[0].hypot(to[1])];
        if radius[0] == 0.0 {
            return Err("an arc's radius must not be 0".to_owned());
        }
        let off = (radius[0] - radius[1]).abs();
        if off > RADII_MM && off > RADII_SHARE * radius[0] {
            return Err(format!(
                "the end does not lie on the arc: it begins with a radius of {:.4} mm and ends with {:.4} mm",
                radius[0], radius[1]
            ));
        }
        let begin_rad = from[1].atan2(from[0]);
        // By cross and dot product: a difference of two angles could be a whole turn off.
        let cross = from[0] * to[1] - from[1] * to[0];
        let mut sweep_rad = cross.atan2(from[0] * to[0] + from[1] * to[1]);
        if clockwise {
            if sweep_rad >= -FULL_CIRCLE_RAD {
                sweep_rad -= TAU;
            }
        } else if sweep_rad <= FULL_CIRCLE_RAD {
            sweep_rad += TAU;
        }
        Ok(Self {
            center,
            radius,
            begin_rad,
            sweep_rad,
        })
    }

    /// Takes the radius; a negative one is the way round of more than half a circle.
    ///
    /// # Errors
    /// It is no arc: in words.
    pub(super) fn by_radius(
        begin: [f64; 2],
        end: [f64; 2],
        radius: f64,
        clockwise: bool,
    ) -> Result<Self, String> {
        let way = [end[0] - begin[0], end[1] - begin[1]];
        let chord = way[0].hypot(way[1]);
        if chord == 0.0 {
            return Err("an arc with R needs another end than its begin".to_owned());
        }
        // Height of the centre over the chord, squared.
        let height = radius * radius - chord * chord / 4.0;
        if height < -RADII_MM * chord {
            return Err(format!(
                "R{radius} is too small: the ends are {chord:.4} mm apart"
            ));
        }
        let left = clockwise == (radius < 0.0);
        let height = height.max(0.0).sqrt() * if left { 1.0 } else { -1.0 };
        let normal = [-way[1] / chord, way[0] / chord];
        let offset = [
            way[0] / 2.0 + normal[0] * height,
            way[1] / 2.0 + normal[1] * height,
        ];
        Self::by_center(begin, end, offset, clockwise)
    }

    /// Returns its length, mm.
    pub(super) fn length_mm(&self) -> f64 {
        self.sweep_rad.abs() * f64::midpoint(self.radius[0], self.radius[1])
    }

    /// Returns how many chords keep within this distance, mm, of the arc.
    pub(super) fn chord_count(&self, tolerance_mm: f64) -> usize {
        let radius = self.radius[0].max(self.radius[1]);
        // The middle of a chord lies r·(1 − cos(angle/2)) inside.
        let angle = if radius <= tolerance_mm {
            TAU / 4.0
        } else {
            2.0 * (1.0 - tolerance_mm / radius).acos()
        };
        (self.sweep_rad.abs() / angle).ceil().max(1.0) as usize
    }

    /// Returns the place after this share, 0 to 1, of the arc.
    pub(super) fn place(&self, share: f64) -> [f64; 2] {
        let angle = self.begin_rad + share * self.sweep_rad;
        let radius = self.radius[0] + share * (self.radius[1] - self.radius[0]);
        [
            self.center[0] + radius * angle.cos(),
            self.center[1] + radius * angle.sin(),
        ]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn close(a: [f64; 2], b: [f64; 2]) -> bool {
        (a[0] - b[0]).hypot(a[1] - b[1]) < 1e-9
    }

    #[test]
    fn a_quarter_goes_round_the_side_that_was_asked_for() {
        let left = Arc::by_center([1.0, 0.0], [0.0, 1.0], [-1.0, 0.0], false).expect("an arc");
        assert!(close(left.place(0.5), [0.5_f64.sqrt(), 0.5_f64.sqrt()]));
        assert!((left.length_mm() - TAU / 4.0).abs() < 1e-12);
        let right = Arc::by_center([1.0, 0.0], [0.0, 1.0], [-1.0, 0.0], true).expect("an arc");
        assert!(close(
            right.place(0.5),
            [-(0.5_f64.sqrt()), -(0.5_f64.sqrt())]
        ));
    }

    #[test]
    fn begin_and_end_alike_is_a_full_circle() {
        for clockwise in [false, true] {
            let arc = Arc::by_center([2.0, 3.0], [2.0, 3.0], [5.0, 0.0], clockwise).expect("one");
            assert!((arc.length_mm() - 5.0 * TAU).abs() < 1e-9);
        }
    }

    #[test]
    fn a_radius_means_the_short_way_and_a_negative_one_the_long_way() {
        for (radius, clockwise, share) in [
            (5.0, false, 0.25),
            (-5.0, false, 0.75),
            (5.0, true, 0.25),
            (-5.0, true, 0.75),
        ] {
            let arc = Arc::by_radius([5.0, 0.0], [0.0, 5.0], radius, clockwise).expect("an arc");
            assert!(
                (arc.length_mm() - share * 5.0 * TAU).abs() < 1e-9,
                "{radius} {clockwise}"
            );
            assert!(close(arc.place(1.0), [0.0, 5.0]));
            assert_eq!(arc.sweep_rad < 0.0, clockwise);
        }
    }

    #[test]
    fn no_chord_is_farther_from_the_arc_than_the_tolerance() {
        for radius in [0.001, 0.1, 10.0, 5_000.0] {
            for tolerance in [0.002, 0.05] {
                let begin = [radius, 0.0];
                let arc = Arc::by_center(begin, begin, [-radius, 0.0], false).expect("a circle");
                let count = arc.chord_count(tolerance);
                let half = TAU / count as f64 / 2.0;
                let off = radius * (1.0 - half.cos());
                assert!(
                    off <= tolerance * (1.0 + 1e-9),
                    "{radius} {tolerance}: {off}"
                );
            }
        }
    }

    #[test]
    fn what_is_no_arc_is_refused() {
        assert!(Arc::by_center([0.0; 2], [1.0, 0.0], [0.0; 2], true).is_err());
        assert!(Arc::by_center([0.0; 2], [9.0, 0.0], [5.0, 0.0], true).is_err());
        assert!(Arc::by_radius([0.0; 2], [0.0; 2], 5.0, true).is_err());
        assert!(Arc::by_radius([0.0; 2], [20.0, 0.0], 5.0, true).is_err());
    }
}
