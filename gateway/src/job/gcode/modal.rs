//! What a block means, given the blocks before it. Carries it out in the order of NIST's RS274:
//! feed mode, feed, power, beam, dwell, plane, units, offsets, distance mode, then what moves, then
//! the end.

use super::{
    Wrong,
    arc::Arc,
    block::{Block, Motion, Once, Said, sort},
    emit::{Emitted, Emitter, Frame, Pace},
    machine::{AXIS_LETTERS, Machine},
    words::Word,
};
use keys::{command::LINE_AXES, job::PAUSE_MS_MAX};

const MM_PER_INCH: f64 = 25.4;

/// In which order axes approach places whose beginning is not known: Z first, because a program
/// begins above its work.
const APPROACH_ORDER: [usize; LINE_AXES] = [2, 0, 1, 3];

/// See the module.
#[derive(Clone, Debug)]
pub(super) struct Modal<'m> {
    to: Emitter<'m>,
    motion: Motion,
    /// The normal of the plane, as an axis.
    plane: usize,
    relative: bool,
    inverse_time: bool,
    inches: bool,
    offsets: usize,
    /// `G92`, mm.
    named_mm: [f64; LINE_AXES],
    home_mm: [f64; LINE_AXES],
    feed_mm_min: Option<f64>,
    beam_on: bool,
    power: f64,
    ended: bool,
}

impl<'m> Modal<'m> {
    /// GRBL's state after its reset.
    pub(super) fn new(machine: &'m Machine) -> Self {
        let mut home_mm = [0.0; LINE_AXES];
        for (to, from) in home_mm.iter_mut().zip(&machine.g28_mm) {
            *to = *from;
        }
        Self {
            to: Emitter::new(machine),
            motion: Motion::Rapid,
            plane: 2,
            relative: false,
            inverse_time: false,
            inches: false,
            offsets: 0,
            named_mm: [0.0; LINE_AXES],
            home_mm,
            feed_mm_min: None,
            beam_on: false,
            power: 0.0,
            ended: false,
        }
    }

    /// Returns whether `M2` or `M30` was there; what follows is nothing.
    pub(super) fn has_ended(&self) -> bool {
        self.ended
    }

    pub(super) fn finish(self) -> Emitted {
        self.to.finish()
    }

    /// Carries out a block.
    ///
    /// # Errors
    /// The word that cannot be.
    pub(super) fn block(&mut self, words: &[Word]) -> Result<(), Wrong> {
        let Some(first) = words.first() else {
            return Ok(());
        };
        let mut block = sort(words)?;
        block.column = first.column;
        if let Some((inverse_time, _)) = block.inverse_time {
            if self.inverse_time != inverse_time {
                self.feed_mm_min = None;
            }
            self.inverse_time = inverse_time;
        }
        if let Some((inches, _)) = block.inches {
            self.inches = inches;
        }
        let inverse_feed = self.feed(&mut block)?;
        self.power(&mut block)?;
        if let Some((Once::Dwell, column)) = block.once {
            self.dwell(&mut block, column)?;
        }
        if let Some((plane, _)) = block.plane {
            self.plane = plane;
        }
        if let Some((offsets, _)) = block.offsets {
            self.offsets = offsets;
        }
        if let Some((relative, _)) = block.relative {
            self.relative = relative;
        }
        if let Some((motion, _)) = block.motion {
            self.motion = motion;
        }
        match block.once {
            Some((Once::GoHome, column)) => self.go_home(&mut block, column)?,
            Some((Once::KeepHome, column)) => self.keep_home(column)?,
            Some((Once::NamePlace, column)) => self.name_place(&mut block, column)?,
            Some((Once::ForgetNames, _)) => self.forget_names(),
            Some((Once::Dwell, _)) | None => self.go(&mut block, inverse_feed)?,
        }
        if let Some(word) = block.values.first() {
            let message = format!("nothing in this line uses {}", word.letter);
            return Err(Wrong::new(word.column, message));
        }
        if let Some(((), column)) = block.rest {
            self.to.rest(column)?;
        }
        if block.end.is_some() {
            self.to.beam(0, block.column)?;
            self.ended = true;
        }
        Ok(())
    }

    /// Takes `F`. Returns it when it is 1/min of this block alone.
    fn feed(&mut self, block: &mut Block) -> Result<Option<f64>, Wrong> {
        let Some(word) = block.take('F') else {
            return Ok(None);
        };
        if word.value <= 0.0 {
            return Err(Wrong::new(word.column, "a feed is more than 0"));
        }
        if self.inverse_time {
            return Ok(Some(word.value));
        }
        self.feed_mm_min = Some(word.value * self.unit());
        Ok(None)
    }

    fn power(&mut self, block: &mut Block) -> Result<(), Wrong> {
        if let Some(word) = block.take('S') {
            let most = self.to.machine().laser_s_max;
            if !(0.0..=most).contains(&word.value) {
                let message = format!("S{} is not within 0 to {most} (laser_s_max)", word.value);
                return Err(Wrong::new(word.column, message));
            }
            self.power = word.value;
        }
        if let Some((on, column)) = block.beam {
            self.beam_on = on;
            if !on {
                self.to.beam(0, column)?;
            }
        }
        Ok(())
    }

    /// Power of the beam on ways with a feed, %. What is more than nothing stays so.
    fn beam_percent(&self) -> u8 {
        if !self.beam_on || self.power == 0.0 {
            return 0;
        }
        let percent = 100.0 * self.power / self.to.machine().laser_s_max;
        percent.round().clamp(1.0, 100.0) as u8
    }

    fn dwell(&mut self, block: &mut Block, column: usize) -> Result<(), Wrong> {
        let Some(word) = block.take('P') else {
            return Err(Wrong::new(column, "G4 needs P, the seconds to wait"));
        };
        let pause_ms = (word.value * 1_000.0).round();
        if !(0.0..=f64::from(PAUSE_MS_MAX)).contains(&pause_ms) {
            return Err(Wrong::new(word.column, "a dwell takes 0 to 86400 seconds"));
        }
        if pause_ms > 0.0 {
            self.to.pause(pause_ms as u32, column)?;
        }
        Ok(())
    }

    fn unit(&self) -> f64 {
        if self.inches { MM_PER_INCH } else { 1.0 }
    }

    /// A axis turns: degrees are no inches.
    fn unit_of(&self, axis: usize) -> f64 {
        if axis == 3 { 1.0 } else { self.unit() }
    }

    fn offset_mm(&self, axis: usize) -> f64 {
        self.to.machine().offsets_mm[self.offsets][axis] + self.named_mm[axis]
    }

    /// Takes the words of axes: value in mm, by axis.
    fn axis_words(&self, block: &mut Block) -> Result<[Said<f64>; LINE_AXES], Wrong> {
        let mut words = [None; LINE_AXES];
        for (axis, letter) in AXIS_LETTERS.into_iter().enumerate() {
            let Some(word) = block.take(letter) else {
                continue;
            };
            if axis >= self.to.machine().axis_count() {
                let message = format!("this node has no axis {letter}");
                return Err(Wrong::new(word.column, message));
            }
            words[axis] = Some((word.value * self.unit_of(axis), word.column));
        }
        Ok(words)
    }

    /// Returns where words lead, and the axes that only an approach can bring there.
    fn target(
        &self,
        words: &[Said<f64>; LINE_AXES],
        in_machine: bool,
    ) -> Result<([f64; LINE_AXES], [bool; LINE_AXES]), Wrong> {
        let mut target = self.to.places_mm();
        let mut unknown = [false; LINE_AXES];
        for axis in 0..LINE_AXES {
            let Some((value, column)) = words[axis] else {
                continue;
            };
            let frame = self.to.axes[axis].frame;
            if in_machine {
                if frame == Frame::Named {
                    return Err(named_only(axis, column));
                }
                target[axis] = value;
                unknown[axis] = frame == Frame::Begin;
            } else if self.relative {
                target[axis] += value;
            } else {
                target[axis] = value + self.offset_mm(axis);
                unknown[axis] = frame == Frame::Begin;
            }
        }
        Ok((target, unknown))
    }

    fn go(&mut self, block: &mut Block, inverse_feed: Option<f64>) -> Result<(), Wrong> {
        let words = self.axis_words(block)?;
        let moves = words.iter().any(Option::is_some);
        let arc = match self.motion {
            Motion::Arc { clockwise } => {
                let has_center = block.has_any(&['I', 'J', 'K', 'R']);
                (moves || has_center).then_some(clockwise)
            }
            _ => None,
        };
        if !moves && arc.is_none() {
            return match (block.motion, block.machine_place) {
                (Some((Motion::Arc { .. }, column)), _) => {
                    Err(Wrong::new(column, "an arc needs its end or its centre"))
                }
                (_, Some(((), column))) => Err(Wrong::new(column, "G53 needs a place to go to")),
                _ => Ok(()),
            };
        }
        let column = match (block.motion, words.iter().flatten().next().copied()) {
            (Some((_, column)), _) | (None, Some((_, column))) => column,
            (None, None) => block.column,
        };
        if let Some(((), at)) = block.machine_place
            && !matches!(self.motion, Motion::Rapid | Motion::Feed)
        {
            return Err(Wrong::new(at, "G53 goes with G0 and G1 only"));
        }
        let (target, unknown) = self.target(&words, block.machine_place.is_some())?;
        match self.motion {
            Motion::Canceled => Err(Wrong::new(column, "no motion is in force after G80")),
            Motion::Rapid => {
                self.to.beam(0, column)?;
                self.approach(&target, unknown, Pace::Rapid, column)?;
                self.to.line(target, Pace::Rapid, column)
            }
            Motion::Feed => {
                let percent = self.beam_percent();
                let from = self.to.places_mm();
                let pace = self.pace(distance(&from, &target), inverse_feed, column)?;
                if let Some(axis) = first(unknown) {
                    if percent > 0 {
                        return Err(begin_unknown(axis, column));
                    }
                    // A block in inverse time has no length yet.
                    let pace = if self.inverse_time { Pace::Rapid } else { pace };
                    self.approach(&target, unknown, pace, column)?;
                }
                self.to.beam(percent, column)?;
                self.to.line(target, pace, column)
            }
            Motion::Arc { clockwise } => {
                if let Some(axis) = first(unknown) {
                    return Err(begin_unknown(axis, column));
                }
                self.arc(block, target, clockwise, inverse_feed, column)
            }
        }
    }

    fn approach(
        &mut self,
        target: &[f64; LINE_AXES],
        unknown: [bool; LINE_AXES],
        pace: Pace,
        column: usize,
    ) -> Result<(), Wrong> {
        self.to.beam(0, column)?;
        for axis in APPROACH_ORDER {
            if unknown[axis] {
                self.to.approach(axis, target[axis], pace, column)?;
            }
        }
        Ok(())
    }

    fn pace(
        &self,
        length_mm: f64,
        inverse_feed: Option<f64>,
        column: usize,
    ) -> Result<Pace, Wrong> {
        match (self.inverse_time, inverse_feed, self.feed_mm_min) {
            (true, Some(per_min), _) => Ok(Pace::Feed(length_mm * per_min)),
            (true, None, _) => Err(Wrong::new(column, "with G93 each way needs its own F")),
            (false, _, Some(feed)) => Ok(Pace::Feed(feed)),
            (false, _, None) => Err(Wrong::new(column, "no feed has been set: F is missing")),
        }
    }

    fn arc(
        &mut self,
        block: &mut Block,
        target: [f64; LINE_AXES],
        clockwise: bool,
        inverse_feed: Option<f64>,
        column: usize,
    ) -> Result<(), Wrong> {
        // The two axes of the plane, so that the normal is their right-handed third.
        let plane = [(self.plane + 1) % 3, (self.plane + 2) % 3];
        let axis_count = self.to.machine().axis_count();
        if let Some(axis) = plane.iter().find(|axis| **axis >= axis_count) {
            let message = format!("this node has no axis {}", AXIS_LETTERS[*axis]);
            return Err(Wrong::new(column, message));
        }
        let from = self.to.places_mm();
        let begin = plane.map(|axis| from[axis]);
        let end = plane.map(|axis| target[axis]);
        let letters = plane.map(|axis| ['I', 'J', 'K'][axis]);
        let unit = self.unit();
        let offsets = letters.map(|letter| block.take(letter));
        let arc = match (block.take('R'), offsets) {
            (Some(radius), [None, None]) => {
                Arc::by_radius(begin, end, radius.value * unit, clockwise)
            }
            (Some(radius), _) => {
                let message = "an arc has either R or its centre";
                return Err(Wrong::new(radius.column, message));
            }
            (None, [None, None]) => {
                let [one, other] = letters;
                let message = format!("an arc in this plane needs {one} and {other}, or R");
                return Err(Wrong::new(column, message));
            }
            (None, offsets) => {
                let offset = offsets.map(|word| word.map_or(0.0, |word| word.value * unit));
                Arc::by_center(begin, end, offset, clockwise)
            }
        };
        let arc = arc.map_err(|message| Wrong::new(column, message))?;
        let mut straight = from;
        for axis in plane {
            straight[axis] = target[axis];
        }
        let length_mm = arc.length_mm().hypot(distance(&straight, &target));
        let pace = self.pace(length_mm, inverse_feed, column)?;
        let percent = self.beam_percent();
        self.to.beam(percent, column)?;
        let count = arc.chord_count(self.to.machine().arc_tolerance_mm);
        for index in 1..count {
            let share = index as f64 / count as f64;
            let mut place = from;
            for axis in 0..LINE_AXES {
                place[axis] += share * (target[axis] - from[axis]);
            }
            let on_arc = arc.place(share);
            place[plane[0]] = on_arc[0];
            place[plane[1]] = on_arc[1];
            self.to.line(place, pace, column)?;
        }
        self.to.line(target, pace, column)
    }

    /// `G28`: by way of the place that is named to the home of the axes that are named, or of all.
    fn go_home(&mut self, block: &mut Block, column: usize) -> Result<(), Wrong> {
        let words = self.axis_words(block)?;
        let all = words.iter().all(Option::is_none);
        self.to.beam(0, column)?;
        if !all {
            let (target, unknown) = self.target(&words, false)?;
            self.approach(&target, unknown, Pace::Rapid, column)?;
            self.to.line(target, Pace::Rapid, column)?;
        }
        let axis_count = self.to.machine().axis_count();
        let mut target = self.to.places_mm();
        let mut unknown = [false; LINE_AXES];
        for axis in 0..axis_count {
            if !all && words[axis].is_none() {
                continue;
            }
            match self.to.axes[axis].frame {
                Frame::Named => return Err(named_only(axis, column)),
                Frame::Begin => unknown[axis] = true,
                Frame::Machine => {}
            }
            target[axis] = self.home_mm[axis];
        }
        self.approach(&target, unknown, Pace::Rapid, column)?;
        self.to.line(target, Pace::Rapid, column)
    }

    fn keep_home(&mut self, column: usize) -> Result<(), Wrong> {
        for axis in 0..self.to.machine().axis_count() {
            if self.to.axes[axis].frame != Frame::Machine {
                return Err(begin_unknown(axis, column));
            }
            self.home_mm[axis] = self.to.axes[axis].mm;
        }
        Ok(())
    }

    fn name_place(&mut self, block: &mut Block, column: usize) -> Result<(), Wrong> {
        let words = self.axis_words(block)?;
        if words.iter().all(Option::is_none) {
            return Err(Wrong::new(column, "G92 needs the name of a place"));
        }
        for (axis, word) in words.into_iter().enumerate() {
            let Some((value, _)) = word else { continue };
            let place = &mut self.to.axes[axis];
            if place.frame == Frame::Begin {
                place.frame = Frame::Named;
            }
            let zero = self.to.machine().offsets_mm[self.offsets][axis];
            self.named_mm[axis] = self.to.axes[axis].mm - zero - value;
        }
        Ok(())
    }

    fn forget_names(&mut self) {
        self.named_mm = [0.0; LINE_AXES];
        for axis in &mut self.to.axes {
            if axis.frame == Frame::Named {
                axis.frame = Frame::Begin;
            }
        }
    }
}

fn first(axes: [bool; LINE_AXES]) -> Option<usize> {
    axes.iter().position(|unknown| *unknown)
}

fn begin_unknown(axis: usize, column: usize) -> Wrong {
    let letter = AXIS_LETTERS[axis];
    let message = format!(
        "nobody knows where {letter} is when the job begins: send it somewhere by G0 first, or name the place by G92"
    );
    Wrong::new(column, message)
}

fn named_only(axis: usize, column: usize) -> Wrong {
    let letter = AXIS_LETTERS[axis];
    let message = format!(
        "G92 named the place of {letter}, and nobody knows where that is in the machine's coordinates"
    );
    Wrong::new(column, message)
}

fn distance(from: &[f64; LINE_AXES], to: &[f64; LINE_AXES]) -> f64 {
    let squares = from.iter().zip(to).map(|(a, b)| (b - a) * (b - a));
    squares.sum::<f64>().sqrt()
}
