//! What is planned and not yet played, and how the inputs are: the large part of a motion, and so
//! the caller's memory.
//!
//! A static holds it on a chip: made by the compiler, it never lies on a stack.

use super::{drive::Drive, marks::Marks};
use crate::{io::input::Inputs, limits::CHANNELS, planner::Planner};

/// Memory of one motion, some 92 KB.
#[derive(Debug)]
pub struct PlanMemory {
    planner: Planner,
    marks: Marks,
    drives: [Option<Drive>; CHANNELS],
    inputs: Inputs,
}

impl PlanMemory {
    /// Makes memory without a plan.
    pub const fn new() -> Self {
        Self {
            planner: Planner::new(),
            marks: Marks::new(),
            drives: [None; CHANNELS],
            inputs: Inputs::NONE,
        }
    }

    /// Lends it to a motion.
    pub const fn plans(&mut self) -> Plans<'_> {
        Plans {
            planner: &mut self.planner,
            marks: &mut self.marks,
            drives: &mut self.drives,
            inputs: &mut self.inputs,
        }
    }
}

impl Default for PlanMemory {
    fn default() -> Self {
        Self::new()
    }
}

/// A loan of [`PlanMemory`]; whatever was planned in it is forgotten.
#[derive(Debug)]
pub struct Plans<'m> {
    pub(super) planner: &'m mut Planner,
    pub(super) marks: &'m mut Marks,
    pub(super) drives: &'m mut [Option<Drive>; CHANNELS],
    pub(super) inputs: &'m mut Inputs,
}
