//! Computes the pins with other drivers' names from ours; it runs in the driver's thread.

use crate::hal::checked::Watch;

/// A pin of another name and ours, coupled: called in every period.
pub(crate) type Step = Box<dyn FnMut() + Send>;

/// The glue of one driver.
#[derive(Default)]
pub struct Glue {
    pub(crate) inputs: Vec<Step>,
    pub(crate) outputs: Vec<Step>,
    /// Over their numbers, for the driver to look through.
    pub(crate) watches: Vec<Watch>,
}

impl Glue {
    /// Before our pins are read.
    pub fn inputs(&mut self) {
        for step in &mut self.inputs {
            step();
        }
    }

    /// After our pins were written.
    pub fn outputs(&mut self) {
        for step in &mut self.outputs {
            step();
        }
    }
}
