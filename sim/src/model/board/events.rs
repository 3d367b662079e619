//! Goes from event to event: makes edges only for channels that need one.

use super::edge::Pulses;
use super::{Board, Bus, Strobes};

impl Board {
    fn plan(&mut self, at: usize, quiet: u64) {
        self.next[at] = self.clock.saturating_add(1).saturating_add(quiet);
    }

    /// After an edge: does the next one have to be made of everything?
    fn plan_common(&mut self) {
        let mut now = self.common_now();
        let mut plays = u64::MAX;
        if let Some(segments) = &mut self.segments {
            segments.skip(self.clock - self.segments_at);
            self.segments_at = self.clock;
            plays = segments.quiet(self.common.gate, self.regs.pace);
            now.job = segments.steady();
            if plays != 0 {
                self.common.job = now.job;
            }
        }
        let changed = now != self.common || !self.fast_path.quiet();
        self.full = if changed || plays == 0 || self.write.is_some() {
            self.clock + 1
        } else {
            self.clock.saturating_add(1).saturating_add(plays)
        };
    }

    /// The next edge is one of a stepgen that plays segments: if it waits, all channels are
    /// affected.
    fn is_of_a_job(&self, edge: u64) -> bool {
        let channels = self.next.get(1..=self.regs.jobs).unwrap_or(&[]);
        self.common.job.busy && channels.contains(&edge)
    }

    fn plan_all(&mut self) {
        self.plan_common();
        if self.full == self.clock + 1 {
            return;
        }
        let timed = self.hub.timebase.quiet(self.regs.commit_at());
        self.plan(0, self.hub.quiet(&self.regs, &self.common));
        if timed == 0 {
            self.full = self.clock + 1;
        }
        for n in 0..self.steps.len() {
            let quiet = self.steps[n].quiet(n, &self.regs, &self.common);
            self.plan(1 + n, quiet);
        }
        let first = 1 + self.steps.len();
        for n in 0..self.encoders.len() {
            let quiet = self.encoders[n].quiet(n, &self.regs, &self.common);
            self.plan(first + n, quiet);
        }
        let first = first + self.encoders.len();
        for n in 0..self.pwms.len() {
            let quiet = self.pwms[n]
                .core
                .quiet(&self.regs.pwm_input(n, &self.common, false));
            self.plan(first + n, quiet);
        }
    }

    /// Runs to the edge `until`, but not past one in which an output pin changed. True when one
    /// did.
    pub fn run(&mut self, until: u64) -> bool {
        while self.clock < until {
            // With an edge of everything to come, the channels have not been asked when they want
            // theirs.
            let next = if self.full == self.clock + 1 {
                self.full
            } else {
                self.next.iter().fold(self.full, |least, at| least.min(*at))
            };
            if next > until {
                self.clock = until;
                return false;
            }
            self.clock = next - 1;
            let before = self.at_pads;
            if self.full == next || self.is_of_a_job(next) {
                self.edge(&Bus::default());
                self.plan_all();
            } else {
                self.events(next);
            }
            if self.at_pads != before {
                return true;
            }
        }
        false
    }

    /// The edge `edge`, of the channels that want it.
    fn events(&mut self, edge: u64) {
        let strobes = Strobes {
            now: edge - 1,
            ..Strobes::default()
        };
        // A timed commit affects all channels.
        if self.next[0] == edge {
            self.hub.catch_up(edge - 1, &self.regs);
            if self.hub.timebase.due(false) {
                self.edge(&Bus::default());
                self.plan_all();
                return;
            }
            self.hub_clock(false, false, &Pulses::default());
        }
        self.clock = edge;
        if self.next[0] == edge {
            self.show_hub();
            self.plan(0, self.hub.quiet(&self.regs, &self.common));
        }
        for n in 0..self.steps.len() {
            if self.next[1 + n] == edge {
                let channel = &mut self.steps[n];
                channel.catch_up(edge - 1, n, &self.regs, &self.common);
                channel.clock(n, &self.regs, &self.common, &strobes);
                let quiet = channel.quiet(n, &self.regs, &self.common);
                self.plan(1 + n, quiet);
                self.show_step(n);
            }
        }
        let first = 1 + self.steps.len();
        for n in 0..self.encoders.len() {
            if self.next[first + n] == edge {
                let channel = &mut self.encoders[n];
                channel.catch_up(edge - 1, n, &self.regs);
                channel.clock(n, &self.regs, &self.common, &strobes);
                let quiet = channel.quiet(n, &self.regs, &self.common);
                self.plan(first + n, quiet);
            }
        }
        let first = first + self.encoders.len();
        for n in 0..self.pwms.len() {
            if self.next[first + n] == edge {
                let input = self.regs.pwm_input(n, &self.common, false);
                let channel = &mut self.pwms[n];
                channel.core.skip(edge - 1 - channel.at, &input);
                channel.core.clock(&input);
                channel.at = edge;
                let quiet = channel.core.quiet(&input);
                self.plan(first + n, quiet);
                self.show_pwm(n);
            }
        }
        self.settle();
        self.plan_common();
    }
}
