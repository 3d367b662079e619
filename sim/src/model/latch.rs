//! `latch.sv`: decides in which clock a count is latched: the first index or probe edge after its
//! arming.

/// The flags of one channel.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Latch {
    index_was: bool,
    probe_was: bool,
    index_flag: bool,
    probe_flag: bool,
    index_latched: bool,
    probe_latched: bool,
}

impl Default for Latch {
    fn default() -> Self {
        Latch {
            index_was: true,
            probe_was: true,
            index_flag: false,
            probe_flag: false,
            index_latched: false,
            probe_latched: false,
        }
    }
}

/// Its inputs in a clock.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Input {
    /// The index may latch.
    pub arm_index: bool,
    /// The probe may latch.
    pub arm_probe: bool,
    /// Level of the index.
    pub index: bool,
    /// Level of the probe.
    pub probe: bool,
    /// The wide counter has yet to write the last capture.
    pub pending: bool,
}

impl Latch {
    fn edges(&self, i: &Input) -> [bool; 2] {
        let free = !(self.index_flag || self.probe_flag || i.pending);
        [
            free && i.arm_index && i.index && !self.index_was,
            free && i.arm_probe && i.probe && !self.probe_was,
        ]
    }

    /// The index rises in this clock, armed or just disarmed: what a clearing channel takes for its
    /// index.
    pub fn index_rises(&self, i: &Input) -> bool {
        i.index && !self.index_was
    }

    /// The count of this clock is to be kept.
    pub fn capture(&self, i: &Input) -> bool {
        self.edges(i).contains(&true)
    }

    /// The index has latched.
    pub fn index_latched(&self) -> bool {
        self.index_latched
    }

    /// The probe has latched.
    pub fn probe_latched(&self) -> bool {
        self.probe_latched
    }

    /// One rising edge.
    pub fn clock(&mut self, i: &Input) {
        let [index, probe] = self.edges(i);
        self.index_latched = i.arm_index && self.index_flag && !i.pending;
        self.probe_latched = i.arm_probe && self.probe_flag && !i.pending;
        self.index_flag = i.arm_index && (self.index_flag || index);
        self.probe_flag = i.arm_probe && (self.probe_flag || probe);
        self.index_was = i.index || !i.arm_index;
        self.probe_was = i.probe || !i.arm_probe;
    }

    /// Another clock with these inputs changes nothing.
    pub fn quiet(&self, i: &Input) -> bool {
        let mut next = self.clone();
        next.clock(i);
        next == *self
    }
}
