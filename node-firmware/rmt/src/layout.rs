//! Which channel has which words of the RMT's RAM.
//!
//! ```text
//!   ESP32-S3, 8 blocks of 48 words, channels 0 to 3 transmit (TRM §37.2, §37.3.2.2)
//!   4 axes │ 0 │ 1 │ 2 │ 3 │ – │ – │ – │ – │     48 words each
//!   2 axes │ 0   0   0 │ 3   3   3   3   3 │     144 and 240 words
//! ```
//!
//! A channel may use the blocks from its own on; the channels whose blocks it borrows are unusable.

use motion::limits::CHANNEL_WORDS;

/// Words of one block.
pub const BLOCK_WORDS: usize = CHANNEL_WORDS;

/// Most blocks that a channel has here.
pub const BLOCKS_MAX: usize = 5;

/// One axis' transmitter.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Place {
    /// The channel; its block is the one of this number.
    pub channel: usize,
    /// How many blocks it has, from its own on; 1 to [`BLOCKS_MAX`].
    pub blocks: usize,
}

impl Place {
    /// Returns the first of its words in the RMT's RAM.
    pub const fn first_word(&self) -> usize {
        self.channel * BLOCK_WORDS
    }

    /// Returns how many words it has.
    pub const fn words(&self) -> usize {
        self.blocks * BLOCK_WORDS
    }
}

/// What a chip's RMT has.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Layout {
    /// Channels that transmit: 0 to this, exclusive.
    pub transmitters: usize,
    /// Blocks of [`BLOCK_WORDS`], those of the receivers included.
    pub blocks: usize,
}

impl Layout {
    /// ESP32-S3 (TRM §37.2) and ESP32-S31: four transmitters, four receivers.
    pub const FOUR: Self = Self {
        transmitters: 4,
        blocks: 8,
    };

    /// ESP32-C6 (TRM §34.2): two transmitters, two receivers.
    pub const TWO: Self = Self {
        transmitters: 2,
        blocks: 4,
    };

    /// Returns the places of this many axes: the channels spread over the RAM as evenly as the
    /// receivers' blocks, which nobody else uses, allow.
    ///
    /// # Panics
    /// There are more axes than transmitters.
    pub const fn places<const AXES: usize>(self) -> [Place; AXES] {
        let mut places = [Place {
            channel: 0,
            blocks: 1,
        }; AXES];
        let mut axis = 0;
        while axis < AXES {
            places[axis] = self.place(axis, AXES);
            axis += 1;
        }
        places
    }

    /// Returns the place of one of so many axes.
    ///
    /// # Panics
    /// There are more axes than transmitters, or it is none of them.
    pub const fn place(self, axis: usize, axes: usize) -> Place {
        assert!(axis < axes && axes <= self.transmitters);
        // The last one begins at the last transmitter, so that it reaches the receivers' blocks.
        let channel = match axes {
            1 => self.transmitters - 1,
            _ => axis * (self.transmitters - 1) / (axes - 1),
        };
        let end = if axis + 1 < axes {
            (axis + 1) * (self.transmitters - 1) / (axes - 1)
        } else {
            self.blocks
        };
        let blocks = end - channel;
        Place {
            channel,
            blocks: if axes == self.transmitters && axes > 2 || blocks == 0 {
                1
            } else {
                blocks
            },
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn words<const AXES: usize>(layout: Layout) -> [(usize, usize); AXES] {
        layout
            .places::<AXES>()
            .map(|place| (place.first_word(), place.words()))
    }

    #[test]
    fn two_axes_borrow_all_blocks_and_four_have_their_own() {
        assert_eq!(words::<2>(Layout::FOUR), [(0, 144), (144, 240)]);
        let four = [(0, 48), (48, 48), (96, 48), (144, 48)];
        assert_eq!(words::<4>(Layout::FOUR), four);
        assert_eq!(words::<2>(Layout::TWO), [(0, 48), (48, 144)]);
    }

    #[test]
    fn no_layout_overlaps_or_leaves_the_ram() {
        fn check<const AXES: usize>(layout: Layout) {
            let mut free_from = 0;
            for place in layout.places::<AXES>() {
                assert!(place.channel < layout.transmitters);
                assert!(place.blocks <= BLOCKS_MAX);
                assert!(place.first_word() >= free_from);
                free_from = place.first_word() + place.words();
            }
            assert!(free_from <= layout.blocks * BLOCK_WORDS);
        }
        check::<1>(Layout::FOUR);
        check::<2>(Layout::FOUR);
        check::<3>(Layout::FOUR);
        check::<4>(Layout::FOUR);
        check::<1>(Layout::TWO);
        check::<2>(Layout::TWO);
    }
}
