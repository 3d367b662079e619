//! `pwm.sv`: one PWM, which changes only at the edge of a period.

const PDM: u32 = wire::map::PwmType::Pdm as u32;
const UP_DOWN: u32 = wire::map::PwmType::UpDown as u32;

/// One channel.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Pwm {
    next_width: u32,
    next_dir: bool,
    this_width: u32,
    this_period: u32,
    this_dir: bool,
    pdm: bool,
    up_down: bool,
    count: u32,
    sum: u32,
    longer: bool,
    on: bool,
    /// What the pins are about to carry: plus, minus, and whether minus carries pulses.
    stage: [bool; 3],
    pins: [bool; 2],
}

/// Its inputs in a clock.
#[derive(Clone, Copy, Debug, Default)]
pub struct Input {
    /// Outputs are live.
    pub gate: bool,
    /// Take `command`.
    pub commit: bool,
    /// Enable, direction and width as in the command page.
    pub command: u32,
    /// Clocks per period.
    pub period: u32,
    /// The mode register.
    pub mode: u32,
}

impl Input {
    fn kind(&self) -> u32 {
        self.mode >> wire::map::PWM_TYPE_SHIFT & 3
    }
    fn dither(&self) -> bool {
        self.mode & wire::map::PWM_DITHER != 0
    }
    fn period(&self) -> u32 {
        self.period & wire::exchange::PWM_PERIOD_MAX
    }
}

impl Pwm {
    /// The two pins: out and dir.
    pub fn pins(&self) -> [bool; 2] {
        self.pins
    }

    fn off(&self) -> bool {
        self.this_period == 0
    }

    fn last(&self) -> bool {
        self.off() || (self.count + 1) & wire::exchange::PWM_PERIOD_MAX == self.this_period
    }

    fn ends(&self) -> bool {
        !self.pdm && self.count == self.this_width
    }

    fn next_pins(&self, i: &Input) -> [bool; 2] {
        let [plus, minus, minus_pulses] = self.stage;
        let invert = i.mode & wire::map::PWM_INVERT != 0;
        let swap = i.mode & wire::map::PWM_SWAP != 0;
        let (first, second) = if swap { (minus, plus) } else { (plus, minus) };
        [
            (i.gate && first) != (invert && (!swap || minus_pulses)),
            (i.gate && second) != (invert && (swap || minus_pulses)),
        ]
    }

    fn next_stage(&self, i: &Input) -> [bool; 3] {
        let pulse = self.on && (!self.ends() || self.longer) && (self.pdm || !self.off());
        [
            i.gate && pulse && !(self.up_down && self.this_dir),
            i.gate && self.this_dir && (pulse || !self.up_down),
            self.up_down,
        ]
    }

    /// The sum after one more period, a carry out of the fraction, and out of the density.
    fn sums(&self, i: &Input) -> (u32, bool, bool) {
        let low = (self.sum & 0xff) + (self.next_width & 0xff);
        let whole = low > 0xff && i.dither();
        let high = (self.sum >> 8) + (self.next_width >> 8 & 0xffff) + u32::from(whole);
        ((high & 0xffff) << 8 | (low & 0xff), whole, high > 0xffff)
    }

    /// One rising edge.
    pub fn clock(&mut self, i: &Input) {
        let (pins, stage) = (self.next_pins(i), self.next_stage(i));
        let (last, ends) = (self.last(), self.ends());
        let (sum, whole, overflow) = self.sums(i);
        let (width, dir) = (self.next_width, self.next_dir);
        if !i.gate {
            self.on = false;
            self.this_dir = false;
            self.sum = 0;
            self.next_width = 0;
            self.next_dir = false;
        } else {
            if last {
                self.on = i.kind() != PDM || overflow || width >> 24 != 0;
                self.this_dir = dir;
                self.sum = sum;
            } else if ends {
                self.on = false;
            }
            if i.commit {
                let enable = i.command & wire::exchange::PWM_ENABLE != 0;
                let width = i.command & wire::exchange::PWM_WIDTH_MASK;
                self.next_width = if enable { width } else { 0 };
                self.next_dir = i.command & wire::exchange::PWM_DIRECTION != 0;
            }
        }
        if !i.gate || last {
            self.count = 0;
            self.this_width = width >> 8;
            self.this_period = i.period();
            self.pdm = i.kind() == PDM;
            self.up_down = i.kind() == UP_DOWN;
            self.longer = whole;
        } else {
            self.count += 1;
        }
        self.stage = stage;
        self.pins = pins;
    }

    /// Everything a new period would take is what this one has.
    fn steady(&self, i: &Input) -> bool {
        self.this_width == self.next_width >> 8
            && self.this_period == i.period()
            && self.this_dir == self.next_dir
            && self.pdm == (i.kind() == PDM)
            && self.up_down == (i.kind() == UP_DOWN)
    }

    /// Clocks in which the pins stay as they are and nothing but counters moves.
    pub fn quiet(&self, i: &Input) -> u64 {
        if self.pins != self.next_pins(i) || self.stage != self.next_stage(i) {
            return 0;
        }
        let idle = self.next_width == 0 && !self.longer && self.steady(i);
        if !i.gate {
            // Everything is reloaded in every clock.
            let rest = idle && self.count == 0 && self.sum == 0 && !self.next_dir && !self.on;
            return if rest { u64::MAX } else { 0 };
        }
        if self.off() {
            // A period of none: everything is reloaded in every clock, and only the sum sees it.
            let rest = self.steady(i) && self.count == 0 && self.on != self.pdm;
            return if rest && (!self.pdm || idle) {
                u64::MAX
            } else {
                0
            };
        }
        if self.count >= self.this_period {
            return 0;
        }
        let to_last = self.this_period - 1 - self.count;
        let to_end = if self.on && !self.pdm && self.count <= self.this_width {
            self.this_width - self.count
        } else {
            to_last
        };
        u64::from(to_last.min(to_end))
    }

    /// That many quiet clocks at once.
    pub fn skip(&mut self, clocks: u64, i: &Input) {
        if !i.gate || clocks == 0 {
            return;
        }
        if !self.off() {
            self.count += clocks as u32;
            return;
        }
        let width = self.next_width;
        let times = |n: u64, part: u32| (n as u32).wrapping_mul(part);
        if i.dither() {
            let before = self.sum.wrapping_add(times(clocks - 1, width));
            self.longer = (before & 0xff) + (width & 0xff) > 0xff;
            self.sum = before.wrapping_add(width) & 0xff_ffff;
        } else {
            let low = self.sum.wrapping_add(times(clocks, width & 0xff)) & 0xff;
            let high = (self.sum >> 8).wrapping_add(times(clocks, width >> 8)) & 0xffff;
            self.sum = high << 8 | low;
            self.longer = false;
        }
    }
}
