//! The words of one line, sorted by modal groups: of each group there is one at most.

use super::{Wrong, words::Word};

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Motion {
    Rapid,
    Feed,
    Arc {
        clockwise: bool,
    },
    /// `G80`.
    Canceled,
}

/// Moves or names places, for its block only.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Once {
    Dwell,
    GoHome,
    KeepHome,
    NamePlace,
    ForgetNames,
}

/// A value of a modal group and the column of its word.
pub(super) type Said<T> = Option<(T, usize)>;

/// One block, sorted by modal groups.
#[derive(Default)]
pub(super) struct Block {
    pub(super) motion: Said<Motion>,
    pub(super) once: Said<Once>,
    pub(super) machine_place: Said<()>,
    pub(super) plane: Said<usize>,
    pub(super) relative: Said<bool>,
    pub(super) inverse_time: Said<bool>,
    pub(super) inches: Said<bool>,
    pub(super) offsets: Said<usize>,
    pub(super) beam: Said<bool>,
    pub(super) end: Said<()>,
    /// `M0`, `M1`.
    pub(super) rest: Said<()>,
    pub(super) harmless: Said<()>,
    pub(super) values: Vec<Word>,
    pub(super) column: usize,
}

impl Block {
    pub(super) fn take(&mut self, letter: char) -> Option<Word> {
        let index = self.values.iter().position(|word| word.letter == letter)?;
        Some(self.values.remove(index))
    }

    pub(super) fn has_any(&self, letters: &[char]) -> bool {
        self.values
            .iter()
            .any(|word| letters.contains(&word.letter))
    }
}

/// Sorts the words of a block.
pub(super) fn sort(words: &[Word]) -> Result<Block, Wrong> {
    let mut block = Block::default();
    for word in words {
        match word.letter {
            'G' => sort_general(&mut block, word)?,
            'M' => sort_other(&mut block, word)?,
            // Which tool is in use changes nothing here.
            'T' => {}
            'X' | 'Y' | 'Z' | 'A' | 'I' | 'J' | 'K' | 'R' | 'P' | 'F' | 'S' => {
                if block.has_any(&[word.letter]) {
                    let message = format!("{} is there twice", word.letter);
                    return Err(Wrong::new(word.column, message));
                }
                block.values.push(*word);
            }
            letter => {
                let message = format!("`{letter}` means nothing here");
                return Err(Wrong::new(word.column, message));
            }
        }
    }
    Ok(block)
}

fn sort_general(block: &mut Block, word: &Word) -> Result<(), Wrong> {
    let at = word.column;
    let clockwise = |clockwise| Motion::Arc { clockwise };
    match (word.value * 10.0).round() as u32 {
        0 => once(&mut block.motion, Motion::Rapid, at),
        10 => once(&mut block.motion, Motion::Feed, at),
        20 => once(&mut block.motion, clockwise(true), at),
        30 => once(&mut block.motion, clockwise(false), at),
        800 => once(&mut block.motion, Motion::Canceled, at),
        40 => once(&mut block.once, Once::Dwell, at),
        280 => once(&mut block.once, Once::GoHome, at),
        281 => once(&mut block.once, Once::KeepHome, at),
        920 => once(&mut block.once, Once::NamePlace, at),
        921 => once(&mut block.once, Once::ForgetNames, at),
        530 => once(&mut block.machine_place, (), at),
        170 => once(&mut block.plane, 2, at),
        180 => once(&mut block.plane, 1, at),
        190 => once(&mut block.plane, 0, at),
        200 => once(&mut block.inches, true, at),
        210 => once(&mut block.inches, false, at),
        tenths @ (540 | 550 | 560 | 570 | 580 | 590) => {
            once(&mut block.offsets, (tenths / 10 - 54) as usize, at)
        }
        900 => once(&mut block.relative, false, at),
        910 => once(&mut block.relative, true, at),
        930 => once(&mut block.inverse_time, true, at),
        940 => once(&mut block.inverse_time, false, at),
        // What holds anyway: no compensation of radius and length, exact path, I J K relative.
        400 | 490 | 610 | 911 => Ok(()),
        _ => Err(Wrong::new(at, format!("G{} is not known here", word.value))),
    }
}

fn sort_other(block: &mut Block, word: &Word) -> Result<(), Wrong> {
    let at = word.column;
    match (word.value * 10.0).round() as u32 {
        20 | 300 => once(&mut block.end, (), at),
        // The beam burns only while something moves, so that both mean the same.
        30 | 40 => once(&mut block.beam, true, at),
        50 => once(&mut block.beam, false, at),
        90 => once(&mut block.harmless, (), at),
        // There is no switch for optional rests: each is one.
        0 | 10 => once(&mut block.rest, (), at),
        60 => Err(Wrong::new(
            at,
            "there is no tool changer: M0 waits for a person",
        )),
        70 | 80 => Err(Wrong::new(at, "there is no coolant")),
        _ => Err(Wrong::new(at, format!("M{} is not known here", word.value))),
    }
}

fn once<T>(said: &mut Said<T>, value: T, column: usize) -> Result<(), Wrong> {
    if said.is_some() {
        let message = "another word of the same kind is in this line";
        return Err(Wrong::new(column, message));
    }
    *said = Some((value, column));
    Ok(())
}
