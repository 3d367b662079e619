//! Static timing: the longest path of each clock, and how critical each pin is for it.

use crate::netlist::Net;

/// What every pin of a design means to its clocks. Delays of wires are given to it again for every
/// look.
pub struct Timing {
    /// Nets, each after all nets that it depends on.
    order: Vec<usize>,
    /// Picoseconds each clock should make do with.
    target: Vec<f32>,
}

/// What a look has found.
pub struct Look {
    /// Longest path of each clock, in picoseconds.
    pub longest: Vec<f32>,
    /// Of every net's every pin: 1 on the longest path of a clock (or one as long as the target),
    /// less the more room there is.
    pub criticality: Vec<Vec<f32>>,
}

impl Timing {
    /// Sorts the nets. Nets in a loop without a register are left out, as they are in nextpnr.
    pub fn new(nets: &[Net], target: Vec<f32>) -> Self {
        let mut before = vec![0usize; nets.len()];
        let behind = |net: &Net| -> Vec<usize> {
            net.sinks
                .iter()
                .flat_map(|s| s.through.iter().map(|t| t.0))
                .collect()
        };
        for net in nets {
            behind(net).into_iter().for_each(|to| before[to] += 1);
        }
        let mut order: Vec<usize> = (0..nets.len()).filter(|&n| before[n] == 0).collect();
        let mut next = 0;
        while next < order.len() {
            for to in behind(&nets[order[next]]) {
                before[to] -= 1;
                if before[to] == 0 {
                    order.push(to);
                }
            }
            next += 1;
        }
        Self { order, target }
    }

    /// Looks, with these delays of every net's every pin.
    pub fn look(&self, nets: &[Net], delays: &[Vec<f32>]) -> Look {
        let mut look = Look {
            longest: vec![0.0; self.target.len()],
            criticality: delays.iter().map(|d| vec![0.0; d.len()]).collect(),
        };
        for clock in 0..self.target.len() {
            self.one(nets, delays, clock, &mut look);
        }
        look
    }

    fn one(&self, nets: &[Net], delays: &[Vec<f32>], clock: usize, look: &mut Look) {
        let of_clock = |edge: Option<(f32, usize)>| edge.filter(|e| e.1 == clock).map(|e| e.0);
        let mut arrival = vec![f32::NEG_INFINITY; nets.len()];
        let mut longest = 0f32;
        for &n in &self.order {
            if let Some(delay) = of_clock(nets[n].begin) {
                arrival[n] = delay;
            }
            for (sink, delay) in nets[n].sinks.iter().zip(&delays[n]) {
                let at = arrival[n] + delay;
                if let Some(setup) = of_clock(sink.end) {
                    longest = longest.max(at + setup);
                }
                for &(to, delay) in &sink.through {
                    arrival[to] = arrival[to].max(at + delay);
                }
            }
        }
        look.longest[clock] = longest;
        let room = longest.max(self.target[clock]);
        let mut required = vec![f32::INFINITY; nets.len()];
        for &n in self.order.iter().rev() {
            for (at, sink) in nets[n].sinks.iter().enumerate() {
                let mut until = of_clock(sink.end).map_or(f32::INFINITY, |setup| room - setup);
                for &(to, delay) in &sink.through {
                    until = until.min(required[to] - delay);
                }
                let slack = until - arrival[n] - delays[n][at];
                if slack.is_finite() {
                    let critical = &mut look.criticality[n][at];
                    *critical = critical.max(1.0 - slack / room);
                }
                required[n] = required[n].min(until - delays[n][at]);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::netlist::Sink;

    /// A flip-flop, a LUT, a flip-flop; from the first straight to a third, too.
    fn path(clock: usize) -> Vec<Net> {
        let lut = Sink {
            wire: 1,
            through: vec![(1, 200.0)],
            end: None,
        };
        let end = |wire| Sink {
            wire,
            through: Vec::new(),
            end: Some((50.0, clock)),
        };
        vec![
            Net {
                bit: 0,
                source: 0,
                begin: Some((500.0, 0)),
                sinks: vec![lut, end(2)],
            },
            Net {
                bit: 1,
                source: 3,
                begin: None,
                sinks: vec![end(4)],
            },
        ]
    }

    #[test]
    fn a_path_takes_what_its_cells_and_wires_take() {
        let nets = path(0);
        let look = Timing::new(&nets, vec![1000.0]).look(&nets, &[vec![300.0, 100.0], vec![400.0]]);
        assert_eq!(look.longest, [500.0 + 300.0 + 200.0 + 400.0 + 50.0]);
        assert_eq!(look.criticality[1], [1.0]);
        assert_eq!(look.criticality[0][0], 1.0);
        assert!((look.criticality[0][1] - 650.0 / 1450.0).abs() < 1e-6);
    }

    #[test]
    fn with_room_to_the_target_nothing_is_critical() {
        let nets = path(0);
        let look =
            Timing::new(&nets, vec![14_500.0]).look(&nets, &[vec![300.0, 100.0], vec![400.0]]);
        assert!((look.criticality[1][0] - 0.1).abs() < 1e-6);
    }

    #[test]
    fn a_path_between_two_clocks_is_none() {
        let nets = path(1);
        let look = Timing::new(&nets, vec![1000.0, 1000.0])
            .look(&nets, &[vec![300.0, 100.0], vec![400.0]]);
        assert_eq!(look.longest, [0.0, 0.0]);
        assert_eq!(look.criticality[0], [0.0, 0.0]);
    }
}
