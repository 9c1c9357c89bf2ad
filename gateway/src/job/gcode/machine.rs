//! What must be known of a node's machine to move it in millimetres: `[node.NAME]` of `fleet.toml`.

use keys::{NodeId, command::LINE_AXES, job::SPEED_HZ_MAX};
use serde::{Deserialize, Deserializer, de};
use std::collections::BTreeMap;

/// The machines of all nodes that have one.
pub type Machines = BTreeMap<NodeId, Machine>;

/// The letters of axes 0 to 3.
pub(super) const AXIS_LETTERS: [char; LINE_AXES] = ['X', 'Y', 'Z', 'A'];

/// A node's machine. Lists go by axis: X, Y, Z, A are the node's axes 0 to 3.
#[derive(Clone, Debug, PartialEq)]
pub struct Machine {
    /// Steps for each mm.
    pub steps_per_mm: Vec<f64>,
    /// Greatest speed, mm/min; that of G0.
    pub speed_mm_min: Vec<f64>,
    /// Acceleration, mm/s².
    pub accel_mm_s2: Vec<f64>,
    /// Jerk, mm/s³; `None`: not limited.
    pub jerk_mm_s3: Option<Vec<f64>>,
    /// Least and greatest place in the machine's coordinates, mm; `None`: not checked.
    pub travel_mm: Option<Vec<[f64; 2]>>,
    /// Chords of an arc are nowhere farther from it, mm. GRBL's `$12`.
    pub arc_tolerance_mm: f64,
    /// The `S` of full power. GRBL's `$30`.
    pub laser_s_max: f64,
    /// Where `G28` goes, mm, in the machine's coordinates.
    pub g28_mm: Vec<f64>,
    /// Zeros of `G54` to `G59` in the machine's coordinates, mm.
    pub offsets_mm: [Vec<f64>; 6],
}

/// The section as it is written.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Raw {
    #[serde(deserialize_with = "scales")]
    steps_per_mm: Vec<f64>,
    #[serde(deserialize_with = "positive")]
    speed_mm_min: Vec<f64>,
    #[serde(deserialize_with = "positive")]
    accel_mm_s2: Vec<f64>,
    #[serde(default, deserialize_with = "some_positive")]
    jerk_mm_s3: Option<Vec<f64>>,
    #[serde(default, deserialize_with = "travel")]
    travel_mm: Option<Vec<[f64; 2]>>,
    #[serde(default = "arc_tolerance_default", deserialize_with = "tolerance")]
    arc_tolerance_mm: f64,
    #[serde(default = "laser_s_default", deserialize_with = "laser_s")]
    laser_s_max: f64,
    #[serde(default)]
    g28_mm: Option<Vec<f64>>,
    #[serde(default)]
    g54_mm: Option<Vec<f64>>,
    #[serde(default)]
    g55_mm: Option<Vec<f64>>,
    #[serde(default)]
    g56_mm: Option<Vec<f64>>,
    #[serde(default)]
    g57_mm: Option<Vec<f64>>,
    #[serde(default)]
    g58_mm: Option<Vec<f64>>,
    #[serde(default)]
    g59_mm: Option<Vec<f64>>,
}

fn arc_tolerance_default() -> f64 {
    0.002
}

fn laser_s_default() -> f64 {
    1_000.0
}

fn list_within<'de, D: Deserializer<'de>>(
    from: D,
    least: f64,
    most: f64,
) -> Result<Vec<f64>, D::Error> {
    let list = Vec::<f64>::deserialize(from)?;
    if list.is_empty() || list.len() > LINE_AXES {
        let message = format!("{} axes; one to {LINE_AXES} are X, Y, Z, A", list.len());
        return Err(de::Error::custom(message));
    }
    match list.iter().find(|value| !(least..=most).contains(*value)) {
        Some(value) => Err(de::Error::custom(format!(
            "{value} is not within {least} to {most}"
        ))),
        None => Ok(list),
    }
}

fn scales<'de, D: Deserializer<'de>>(from: D) -> Result<Vec<f64>, D::Error> {
    list_within(from, 0.001, 1e6)
}

fn positive<'de, D: Deserializer<'de>>(from: D) -> Result<Vec<f64>, D::Error> {
    list_within(from, 0.001, 1e9)
}

fn some_positive<'de, D: Deserializer<'de>>(from: D) -> Result<Option<Vec<f64>>, D::Error> {
    positive(from).map(Some)
}

fn travel<'de, D: Deserializer<'de>>(from: D) -> Result<Option<Vec<[f64; 2]>>, D::Error> {
    let list = Vec::<[f64; 2]>::deserialize(from)?;
    for [least, most] in &list {
        if least.is_nan() || most.is_nan() || least >= most {
            let message = format!("[{least}, {most}]: the first is to be less than the second");
            return Err(de::Error::custom(message));
        }
    }
    Ok(Some(list))
}

fn number_within<'de, D: Deserializer<'de>>(
    from: D,
    least: f64,
    most: f64,
) -> Result<f64, D::Error> {
    let value = f64::deserialize(from)?;
    let error = || de::Error::custom(format!("{value} is not within {least} to {most}"));
    (least..=most)
        .contains(&value)
        .then_some(value)
        .ok_or_else(error)
}

fn tolerance<'de, D: Deserializer<'de>>(from: D) -> Result<f64, D::Error> {
    number_within(from, 0.000_1, 10.0)
}

fn laser_s<'de, D: Deserializer<'de>>(from: D) -> Result<f64, D::Error> {
    number_within(from, 1.0, 1e6)
}

impl<'de> Deserialize<'de> for Machine {
    fn deserialize<D: Deserializer<'de>>(from: D) -> Result<Self, D::Error> {
        let raw = Raw::deserialize(from)?;
        let axes = raw.steps_per_mm.len();
        let count = |name: &str, found: usize| {
            if found == axes {
                return Ok(());
            }
            Err(de::Error::custom(format!(
                "`{name}` has {found} axes and `steps_per_mm` has {axes}"
            )))
        };
        count("speed_mm_min", raw.speed_mm_min.len())?;
        count("accel_mm_s2", raw.accel_mm_s2.len())?;
        if let Some(jerk) = &raw.jerk_mm_s3 {
            count("jerk_mm_s3", jerk.len())?;
        }
        if let Some(travel) = &raw.travel_mm {
            count("travel_mm", travel.len())?;
        }
        let place = |name: &str, place: Option<Vec<f64>>| match place {
            None => Ok(vec![0.0; axes]),
            Some(place) if place.iter().any(|mm| mm.is_nan() || mm.abs() > 1e9) => Err(
                de::Error::custom(format!("`{name}` is farther than 1e9 mm")),
            ),
            Some(place) => count(name, place.len()).map(|()| place),
        };
        for (index, hz) in raw.speed_mm_min.iter().zip(&raw.steps_per_mm).enumerate() {
            let hz = hz.0 / 60.0 * hz.1;
            if hz > f64::from(SPEED_HZ_MAX) || hz < 1.0 {
                let letter = AXIS_LETTERS[index];
                return Err(de::Error::custom(format!(
                    "{letter} at full speed takes {hz:.3} steps a second; 1 to {SPEED_HZ_MAX} can be"
                )));
            }
        }
        Ok(Self {
            g28_mm: place("g28_mm", raw.g28_mm)?,
            offsets_mm: [
                place("g54_mm", raw.g54_mm)?,
                place("g55_mm", raw.g55_mm)?,
                place("g56_mm", raw.g56_mm)?,
                place("g57_mm", raw.g57_mm)?,
                place("g58_mm", raw.g58_mm)?,
                place("g59_mm", raw.g59_mm)?,
            ],
            steps_per_mm: raw.steps_per_mm,
            speed_mm_min: raw.speed_mm_min,
            accel_mm_s2: raw.accel_mm_s2,
            jerk_mm_s3: raw.jerk_mm_s3,
            travel_mm: raw.travel_mm,
            arc_tolerance_mm: raw.arc_tolerance_mm,
            laser_s_max: raw.laser_s_max,
        })
    }
}

impl Machine {
    /// Returns how many axes it has.
    pub fn axis_count(&self) -> usize {
        self.steps_per_mm.len()
    }

    /// Returns a machine whose axes are all alike, with GRBL's defaults for the rest.
    pub fn alike(axes: usize, steps_per_mm: f64, speed_mm_min: f64, accel_mm_s2: f64) -> Self {
        let axes = axes.clamp(1, LINE_AXES);
        Self {
            steps_per_mm: vec![steps_per_mm; axes],
            speed_mm_min: vec![speed_mm_min; axes],
            accel_mm_s2: vec![accel_mm_s2; axes],
            jerk_mm_s3: None,
            travel_mm: None,
            arc_tolerance_mm: arc_tolerance_default(),
            laser_s_max: laser_s_default(),
            g28_mm: vec![0.0; axes],
            offsets_mm: std::array::from_fn(|_| vec![0.0; axes]),
        }
    }
}
