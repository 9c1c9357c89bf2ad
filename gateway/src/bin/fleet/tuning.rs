//! How a machine moves by itself, as options of `fleet provision` and in words.

use crate::provision::{place_named, place_of};
use clap::Args;
use provision::{
    Setting, Tuning,
    tuning::{FilterSettings, HomingSettings, PlacesC, ReachSettings, WayD},
};

#[derive(Debug, Args)]
pub(crate) struct TuningArgs {
    /// How an axis is homed: AXIS:NAME=NUMBER,… with seek and approach (Hz), accel (steps/s²), travel and
    /// pull-off (steps), as in `0:seek=800,approach=100`. What is not named is as by default. May be
    /// repeated.
    #[arg(long, value_name = "AXIS:NAME=NUMBER,…", value_parser = homing)]
    homing: Vec<HomingSettings>,

    /// How far an axis may go: AXIS:LOW..HIGH in steps, both included, once it is homed; with `,boot`
    /// from the start on. May be repeated.
    #[arg(long, value_name = "AXIS:LOW..HIGH", value_parser = reach)]
    soft_limits: Vec<ReachSettings>,

    /// How long a switch must be pressed and released before that counts: OF:END=PRESSED/RELEASED in µs,
    /// as in `0:min=100/5000`. May be repeated.
    #[arg(long, value_name = "OF:END=US/US", value_parser = filter)]
    filter: Vec<FilterSettings>,

    /// The places of C: STEPS_PER_MM:MM@MM_PER_S,… five of them from low to high, as in
    /// `80:0@10,25@20,50@20,75@20,100@10`.
    #[arg(long, value_name = "STEPS:MM@SPEED,…", value_parser = places_c)]
    c_places: Option<PlacesC>,

    /// The way of D between OFF and ON: STEPS_PER_MM:MM@MM_PER_S, as in `80:50@25`.
    #[arg(long, value_name = "STEPS:MM@SPEED", value_parser = way_d)]
    d_way: Option<WayD>,

    /// Forget all five: as by default.
    #[arg(long)]
    no_tuning: bool,
}

impl TuningArgs {
    /// Returns the settings, in the order in which they count.
    pub(crate) fn settings(&self) -> Vec<Setting> {
        let mut settings = Vec::new();
        if self.no_tuning {
            settings.push(Setting::NoTuning);
        }
        settings.extend(self.homing.iter().copied().map(Setting::Homing));
        settings.extend(self.soft_limits.iter().copied().map(Setting::Reach));
        settings.extend(self.filter.iter().copied().map(Setting::Filter));
        settings.extend(self.c_places.map(|places| Setting::PlacesC(Some(places))));
        settings.extend(self.d_way.map(|way| Setting::WayD(Some(way))));
        settings
    }
}

/// Reads thousandths: `12.5` is 12500.
fn thousandths(text: &str) -> Option<u32> {
    let (whole, part) = text.split_once('.').unwrap_or((text, ""));
    if part.len() > 3 || !part.bytes().all(|digit| digit.is_ascii_digit()) {
        return None;
    }
    let part: u32 = format!("{part:0<3}").parse().ok()?;
    whole
        .parse::<u32>()
        .ok()?
        .checked_mul(1_000)?
        .checked_add(part)
}

fn in_thousandths(value: u32) -> String {
    let text = format!("{}.{:03}", value / 1_000, value % 1_000);
    text.trim_end_matches('0').trim_end_matches('.').to_owned()
}

fn homing(text: &str) -> Result<HomingSettings, String> {
    let parse = || {
        let (axis, words) = text.split_once(':')?;
        let mut settings = HomingSettings::new(axis.parse().ok()?);
        for word in words.split(',') {
            let (name, number) = word.split_once('=')?;
            let place = match name {
                "seek" => &mut settings.seek_hz,
                "approach" => &mut settings.approach_hz,
                "accel" => &mut settings.accel_hz_per_s,
                "travel" => &mut settings.travel_steps,
                "pull-off" => &mut settings.pull_off_steps,
                _ => return None,
            };
            *place = number.parse().ok()?;
        }
        Some(settings)
    };
    parse().ok_or_else(|| {
        "no AXIS:NAME=NUMBER,… with seek, approach, accel, travel, pull-off".to_owned()
    })
}

fn reach(text: &str) -> Result<ReachSettings, String> {
    let parse = || {
        let (axis, ends) = text.split_once(':')?;
        let (ends, from_boot) = match ends.strip_suffix(",boot") {
            Some(ends) => (ends, true),
            None => (ends, false),
        };
        let (low, high) = ends.split_once("..")?;
        Some(ReachSettings {
            axis: axis.parse().ok()?,
            min_steps: low.parse().ok()?,
            max_steps: high.parse().ok()?,
            from_boot,
        })
    };
    parse().ok_or_else(|| "no AXIS:LOW..HIGH like 0:-100..20000".to_owned())
}

fn filter(text: &str) -> Result<FilterSettings, String> {
    let parse = || {
        let (place, times) = text.split_once('=')?;
        let (of, end) = place_of(place)?;
        let (active_us, inactive_us) = times.split_once('/')?;
        Some(FilterSettings {
            of,
            end,
            active_us: active_us.parse().ok()?,
            inactive_us: inactive_us.parse().ok()?,
        })
    };
    parse().ok_or_else(|| "no OF:END=US/US like 0:min=100/5000".to_owned())
}

fn way(text: &str) -> Option<(u32, u32)> {
    let (place, speed) = text.split_once('@')?;
    Some((thousandths(place)?, thousandths(speed)?))
}

fn places_c(text: &str) -> Result<PlacesC, String> {
    let parse = || {
        let (steps, list) = text.split_once(':')?;
        let places: Option<Vec<(i32, u32)>> = list
            .split(',')
            .map(|place| {
                let (at_um, speed) = way(place)?;
                Some((i32::try_from(at_um).ok()?, speed))
            })
            .collect();
        Some(PlacesC {
            steps_per_m: thousandths(steps)?,
            places: places?.try_into().ok()?,
        })
    };
    parse().ok_or_else(|| "no STEPS:MM@SPEED,… with five places".to_owned())
}

fn way_d(text: &str) -> Result<WayD, String> {
    let parse = || {
        let (steps, place) = text.split_once(':')?;
        let (travel_um, speed_um_per_s) = way(place)?;
        Some(WayD {
            steps_per_m: thousandths(steps)?,
            travel_um,
            speed_um_per_s,
        })
    };
    parse().ok_or_else(|| "no STEPS:MM@SPEED like 80:50@25".to_owned())
}

/// Returns a line for each thing that was told, as its option would be given.
pub(crate) fn lines(tuning: &Tuning) -> Vec<(&'static str, String)> {
    let mut lines = Vec::new();
    for homing in &tuning.homing {
        let HomingSettings {
            axis,
            seek_hz,
            approach_hz,
            accel_hz_per_s,
            travel_steps,
            pull_off_steps,
        } = homing;
        let words = format!(
            "{axis}:seek={seek_hz},approach={approach_hz},accel={accel_hz_per_s},\
             travel={travel_steps},pull-off={pull_off_steps}"
        );
        lines.push(("homing", words));
    }
    for reach in &tuning.reach {
        let boot = if reach.from_boot { ",boot" } else { "" };
        let words = format!(
            "{}:{}..{}{boot}",
            reach.axis, reach.min_steps, reach.max_steps
        );
        lines.push(("soft limits", words));
    }
    for filter in &tuning.filters {
        let place = place_named(filter.of, filter.end);
        let words = format!("{place}={}/{}", filter.active_us, filter.inactive_us);
        lines.push(("filter", words));
    }
    if let Some(c) = &tuning.c {
        let places = c.places.iter().map(|(at_um, speed)| {
            let at = in_thousandths(u32::try_from(*at_um).unwrap_or_default());
            format!("{at}@{}", in_thousandths(*speed))
        });
        let places: Vec<String> = places.collect();
        let words = format!("{}:{}", in_thousandths(c.steps_per_m), places.join(","));
        lines.push(("C places", words));
    }
    if let Some(d) = &tuning.d {
        let (travel, speed) = (
            in_thousandths(d.travel_um),
            in_thousandths(d.speed_um_per_s),
        );
        lines.push((
            "D way",
            format!("{}:{travel}@{speed}", in_thousandths(d.steps_per_m)),
        ));
    }
    lines
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_given_is_what_is_shown() {
        let mut tuning = Tuning::default();
        let homing = homing("1:seek=800,approach=100").expect("legal");
        assert!(tuning.set_homing(homing));
        assert!(tuning.set_reach(reach("0:-100..20000,boot").expect("legal")));
        assert!(tuning.set_filter(filter("d:max=100/9000").expect("legal")));
        tuning.c = Some(places_c("80.125:0@10,25@20,50@20,75.5@20,100@0.5").expect("legal"));
        tuning.d = Some(way_d("80:50@25").expect("legal"));
        assert_eq!(
            lines(&tuning),
            [
                (
                    "homing",
                    "1:seek=800,approach=100,accel=50000,travel=200000,pull-off=200".to_owned()
                ),
                ("soft limits", "0:-100..20000,boot".to_owned()),
                ("filter", "d:max=100/9000".to_owned()),
                (
                    "C places",
                    "80.125:0@10,25@20,50@20,75.5@20,100@0.5".to_owned()
                ),
                ("D way", "80:50@25".to_owned()),
            ]
        );
    }

    #[test]
    fn what_is_none_is_refused() {
        for wrong in ["", "0", "0:seek", "0:seek=x", "x:seek=1", "0:speed=1"] {
            assert!(homing(wrong).is_err(), "{wrong}");
        }
        assert!(reach("0:5").is_err() && reach("0:a..b").is_err());
        assert!(filter("0:min=5").is_err() && filter("0:mid=5/5").is_err());
        for wrong in [
            "80:0@1",
            "80",
            "80:0@1,1@1,2@1,3@1,4@1,5@1",
            "80:0@1,1@1,2@1,3@1,4.0005@1",
        ] {
            assert!(places_c(wrong).is_err(), "{wrong}");
        }
        assert!(way_d("80:50").is_err() && way_d("80:-5@1").is_err());
    }
}
