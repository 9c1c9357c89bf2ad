//! Ways in mm → commands in steps, within the machine's limits.

use super::{
    Wrong,
    machine::{AXIS_LETTERS, Machine},
};
use keys::{
    command::LINE_AXES,
    job::{
        JOB_COMMANDS_MAX, JobCommand, LaserFields, LineFields, PauseFields, RampToFields,
        SPEED_HZ_MAX, WaitResumeFields,
    },
};

/// Farther from 0 than this no place is told from its neighbours, steps.
const PLACE_STEPS_MAX: f64 = 9e15;

/// What the mm of an axis are counted from.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Frame {
    /// From where it was at the beginning, and nobody knows where that is.
    Begin,
    /// The same, but `G92` gave that place a name.
    Named,
    /// From the machine's zero: position 0.
    Machine,
}

/// One axis on its way.
#[derive(Clone, Copy, Debug)]
pub(super) struct Axis {
    pub(super) frame: Frame,
    pub(super) mm: f64,
    steps: i64,
}

/// How fast.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Pace {
    /// As fast as the machine can.
    Rapid,
    /// Along the path, mm/min.
    Feed(f64),
}

/// Least and greatest place of an axis, mm, by its frame.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct Extent {
    pub(super) machine: Option<[f64; 2]>,
    pub(super) relative: Option<[f64; 2]>,
}

/// What came out.
#[derive(Clone, Debug, Default)]
pub(super) struct Emitted {
    pub(super) commands: Vec<JobCommand>,
    pub(super) extents: [Extent; LINE_AXES],
    pub(super) way_mm: f64,
}

/// See the module.
#[derive(Clone, Debug)]
pub(super) struct Emitter<'m> {
    machine: &'m Machine,
    pub(super) axes: [Axis; LINE_AXES],
    beam_percent: u8,
    out: Emitted,
}

impl<'m> Emitter<'m> {
    pub(super) fn new(machine: &'m Machine) -> Self {
        let axis = Axis {
            frame: Frame::Begin,
            mm: 0.0,
            steps: 0,
        };
        Self {
            machine,
            axes: [axis; LINE_AXES],
            beam_percent: 0,
            out: Emitted::default(),
        }
    }

    pub(super) fn machine(&self) -> &'m Machine {
        self.machine
    }

    /// Returns all places.
    pub(super) fn places_mm(&self) -> [f64; LINE_AXES] {
        self.axes.map(|axis| axis.mm)
    }

    pub(super) fn finish(mut self) -> Emitted {
        if self.beam_percent != 0 {
            self.out.commands.push(laser(0));
        }
        self.out
    }

    fn push(&mut self, command: JobCommand, column: usize) -> Result<(), Wrong> {
        // One place is kept for the beam's end.
        if self.out.commands.len() + 1 >= JOB_COMMANDS_MAX {
            let message = format!("the program takes more than {JOB_COMMANDS_MAX} commands");
            return Err(Wrong::new(column, message));
        }
        self.out.commands.push(command);
        Ok(())
    }

    /// Sets the beam's power for what follows.
    pub(super) fn beam(&mut self, percent: u8, column: usize) -> Result<(), Wrong> {
        if percent == self.beam_percent {
            return Ok(());
        }
        self.beam_percent = percent;
        self.push(laser(percent), column)
    }

    pub(super) fn pause(&mut self, pause_ms: u32, column: usize) -> Result<(), Wrong> {
        self.push(JobCommand::Pause(PauseFields { ms: pause_ms }), column)
    }

    /// Rests until a client resumes; the beam is off meanwhile by itself.
    pub(super) fn rest(&mut self, column: usize) -> Result<(), Wrong> {
        self.push(JobCommand::WaitResume(WaitResumeFields {}), column)
    }

    /// Goes straight to these places, each in its axis' frame.
    pub(super) fn line(
        &mut self,
        target_mm: [f64; LINE_AXES],
        pace: Pace,
        column: usize,
    ) -> Result<(), Wrong> {
        let mut steps = [0_i32; LINE_AXES];
        let mut place_steps = [0_i64; LINE_AXES];
        for index in 0..self.machine.axis_count() {
            place_steps[index] = self.place_steps(index, target_mm[index], column)?;
            let way = place_steps[index] - self.axes[index].steps;
            steps[index] = i32::try_from(way).map_err(|_| {
                Wrong::new(column, format!("{way} steps are too many for one line"))
            })?;
        }
        for (axis, mm) in target_mm.iter().enumerate() {
            self.axes[axis].mm = *mm;
            self.axes[axis].steps = place_steps[axis];
            self.extend(axis);
        }
        if steps.iter().all(|count| *count == 0) {
            return Ok(());
        }
        let mut way_mm = [0.0; LINE_AXES];
        for (index, scale) in self.machine.steps_per_mm.iter().enumerate() {
            way_mm[index] = f64::from(steps[index].unsigned_abs()) / scale;
        }
        let length_mm = way_mm.iter().map(|mm| mm * mm).sum::<f64>().sqrt();
        // Along the path each limit counts as much as its axis has of the path.
        let along = |limits: &[f64]| {
            let axes = limits.iter().zip(way_mm).filter(|(_, way)| *way > 0.0);
            axes.map(|(limit, way)| limit * length_mm / way)
                .fold(f64::INFINITY, f64::min)
        };
        let mut speed_mm_min = along(&self.machine.speed_mm_min);
        if let Pace::Feed(feed) = pace {
            speed_mm_min = speed_mm_min.min(feed);
        }
        let accel_mm_s2 = along(&self.machine.accel_mm_s2);
        let jerk_mm_s3 = self.machine.jerk_mm_s3.as_deref().map(along);
        let major = steps.iter().map(|count| count.unsigned_abs()).max();
        let per_mm = f64::from(major.unwrap_or(0)) / length_mm;
        self.out.way_mm += length_mm;
        let axis_count = self.machine.axis_count();
        let line = LineFields {
            steps: steps[..axis_count].to_vec(),
            speed_hz: whole(speed_mm_min / 60.0 * per_mm, SPEED_HZ_MAX),
            accel: whole(accel_mm_s2 * per_mm, u32::MAX),
            jerk: jerk_mm_s3.map(|jerk| whole(jerk * per_mm, u32::MAX)),
        };
        self.push(JobCommand::Line(line), column)
    }

    /// Sends one axis to a place of the machine from wherever it is.
    pub(super) fn approach(
        &mut self,
        axis: usize,
        mm: f64,
        pace: Pace,
        column: usize,
    ) -> Result<(), Wrong> {
        self.axes[axis].frame = Frame::Machine;
        let position = self.place_steps(axis, mm, column)?;
        self.axes[axis].mm = mm;
        self.axes[axis].steps = position;
        self.extend(axis);
        let scale = self.machine.steps_per_mm[axis];
        let mut speed_mm_min = self.machine.speed_mm_min[axis];
        if let Pace::Feed(feed) = pace {
            speed_mm_min = speed_mm_min.min(feed);
        }
        let jerk = self.machine.jerk_mm_s3.as_ref();
        let ramp = RampToFields {
            axis: axis as u8,
            position,
            speed_hz: whole(speed_mm_min / 60.0 * scale, SPEED_HZ_MAX),
            accel: whole(self.machine.accel_mm_s2[axis] * scale, u32::MAX),
            jerk: jerk.map(|jerk| whole(jerk[axis] * scale, u32::MAX)),
            linear_steps: 0,
            jump_steps: 0,
        };
        self.push(JobCommand::RampTo(ramp), column)
    }

    fn place_steps(&self, axis: usize, mm: f64, column: usize) -> Result<i64, Wrong> {
        let letter = AXIS_LETTERS[axis];
        if self.axes[axis].frame == Frame::Machine
            && let Some(travel) = &self.machine.travel_mm
        {
            let [least, most] = travel[axis];
            // A hundredth of a step of rounding is no way.
            let slack = 0.01 / self.machine.steps_per_mm[axis];
            if mm < least - slack || mm > most + slack {
                let message =
                    format!("{letter} would go to {mm:.4} mm; its travel is {least} to {most} mm");
                return Err(Wrong::new(column, message));
            }
        }
        let steps = (mm * self.machine.steps_per_mm[axis]).round();
        if steps.abs() > PLACE_STEPS_MAX {
            let message = format!("{letter}: {mm} mm are too far");
            return Err(Wrong::new(column, message));
        }
        Ok(steps as i64)
    }

    fn extend(&mut self, axis: usize) {
        let Axis { frame, mm, .. } = self.axes[axis];
        let extent = &mut self.out.extents[axis];
        let known = match frame {
            Frame::Machine => &mut extent.machine,
            Frame::Begin | Frame::Named => &mut extent.relative,
        };
        let [least, most] = known.unwrap_or([mm, mm]);
        *known = Some([least.min(mm), most.max(mm)]);
    }
}

fn laser(power_percent: u8) -> JobCommand {
    JobCommand::Laser(LaserFields { power_percent })
}

/// Whole and not faster than asked for, but at least 1.
fn whole(value: f64, most: u32) -> u32 {
    // What is whole but for the rounding of its computation stays.
    ((value + 1e-6).floor() as u32).clamp(1, most)
}
