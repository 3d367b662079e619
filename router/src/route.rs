//! Negotiated congestion (PathFinder): every net takes the cheapest way, even over wires that other
//! nets use. The price of a shared wire rises from round to round, until only one net still uses
//! it. A pin on a critical path of a clock pays for delay instead.
//!
//! Nothing in it depends on time, on threads or on the order of a hash table: the same netlist
//! always gets the same routes.

use crate::chip::{Chip, NONE};
use crate::netlist::Net;
use crate::timing::Timing;
use anyhow::{Result, bail};
use std::cmp::Ordering;
use std::collections::{BTreeMap, BinaryHeap, HashMap};
use std::hash::{BuildHasherDefault, Hasher};

/// The price of every switch beside its delay: it keeps long ways over fast switches expensive.
const HOP: f32 = 20.0;
/// The price of a shared wire: in the first round, its growth per round, and its upper limit. With
/// a higher limit a net goes all around the chip and misses its timing, even where another net
/// could move easily.
const SHARING: (f32, f32, f32) = (0.5, 1.4, 12.0);
/// With so few shared wires left the price may grow further, which resolves the last conflicts.
const FEW: usize = 100;
/// If no wire is shared but a clock misses its target: the price to go on with, and how many times.
const AGAIN: (f32, u32) = (2.0, 8);
/// The extra price of a wire after a round in which it was shared.
const HISTORY: f32 = 1.0;
/// Weight of the estimated remaining cost: above 1 the search is faster but may miss the cheapest
/// way.
const ESTIMATE: f32 = 1.1;
/// Tiles around a net it may use, one more with every fourth round it takes part in.
const MARGIN: i32 = 3;
/// In a net with more pins only the part after shared wires is routed again.
const LARGE: usize = 24;
/// The share of delay in the cost of a critical pin.
const CRITICAL: f32 = 0.96;
/// A net with a pin this critical on a detour is routed again, even without shared wires.
const SLOW: f32 = 0.85;

/// A hash that is the same everywhere.
#[derive(Default, Clone, Copy)]
struct Plain(u64);

impl Hasher for Plain {
    fn finish(&self) -> u64 {
        self.0
    }

    fn write(&mut self, bytes: &[u8]) {
        bytes.iter().for_each(|&b| self.write_u32(b.into()));
    }

    fn write_u32(&mut self, n: u32) {
        self.0 = (self.0 ^ u64::from(n))
            .wrapping_mul(0x9E37_79B9_7F4A_7C15)
            .rotate_left(23);
    }
}

/// How a net reaches a wire: from which wire, by which switch, after how long.
#[derive(Clone, Copy)]
struct Step {
    from: u32,
    pip: u32,
    delay: f32,
}

impl Step {
    /// What a net begins with.
    const SOURCE: Step = Step {
        from: NONE,
        pip: NONE,
        delay: 0.0,
    };
}

type Tree = HashMap<u32, Step, BuildHasherDefault<Plain>>;

/// A wire's price, and the last search's mark on it; together, because they are looked at together.
#[derive(Clone, Copy)]
#[repr(C, align(32))]
struct Node {
    history: f32,
    cost: f32,
    search: u32,
    from: u32,
    pip: u32,
    users: u16,
    name: u16,
    x: u8,
    y: u8,
}

#[derive(Clone, Copy)]
struct Open {
    estimate: f32,
    cost: f32,
    wire: u32,
}

impl PartialEq for Open {
    fn eq(&self, other: &Self) -> bool {
        self.cmp(other) == Ordering::Equal
    }
}

impl Eq for Open {}

impl PartialOrd for Open {
    fn partial_cmp(&self, other: &Self) -> Option<Ordering> {
        Some(self.cmp(other))
    }
}

impl Ord for Open {
    /// The cheapest is the greatest, as a heap wants it.
    fn cmp(&self, other: &Self) -> Ordering {
        other
            .estimate
            .total_cmp(&self.estimate)
            .then(other.wire.cmp(&self.wire))
    }
}

/// What it takes at least from a wire of some name to LUTs so many tiles away.
struct Ahead {
    known: Vec<u16>,
    width: usize,
    height: usize,
}

const UNKNOWN: u16 = u16::MAX;

impl Ahead {
    /// Backwards from tiles all over the chip.
    fn new(chip: &Chip) -> Self {
        let (width, height) = (chip.width, chip.height);
        let size = (2 * width + 1) * (2 * height + 1);
        let mut ahead = Self {
            known: vec![UNKNOWN; chip.names.len() * size],
            width,
            height,
        };
        let mut cost = vec![f32::INFINITY; chip.wires.len()];
        for (x, y) in [
            (16, 18),
            (16, 78),
            (49, 39),
            (49, 82),
            (82, 18),
            (82, 78),
            (33, 61),
            (68, 59),
            (4, 39),
            (95, 39),
        ] {
            let (tile, inputs) = chip.lut_inputs(width * x / 100, height * y / 100);
            cost.fill(f32::INFINITY);
            let mut open: BinaryHeap<Open> = inputs
                .iter()
                .map(|&wire| Open {
                    estimate: 0.0,
                    cost: 0.0,
                    wire,
                })
                .collect();
            inputs.iter().for_each(|&wire| cost[wire as usize] = 0.0);
            while let Some(at) = open.pop() {
                if at.cost > cost[at.wire as usize] {
                    continue;
                }
                for &(wire, class) in chip.uphill(at.wire) {
                    let through = at.cost + price(chip, class);
                    if through < cost[wire as usize] {
                        cost[wire as usize] = through;
                        open.push(Open {
                            estimate: through,
                            cost: through,
                            wire,
                        });
                    }
                }
            }
            for (wire, &cost) in chip
                .wires
                .iter()
                .zip(&cost)
                .filter(|(_, cost)| cost.is_finite())
            {
                let at = ahead.at(wire.name, wire.x, wire.y, tile % width, tile / width);
                ahead.known[at] = ahead.known[at].min(cost.min(65_000.0) as u16);
            }
        }
        for one in ahead.known.chunks_exact_mut(size) {
            spread(one, 2 * width + 1, 2 * height + 1);
        }
        ahead
            .known
            .iter_mut()
            .filter(|k| **k == UNKNOWN)
            .for_each(|k| *k = 0);
        ahead
    }

    fn at(&self, name: u16, x: u8, y: u8, to_x: usize, to_y: usize) -> usize {
        let (dx, dy) = (
            to_x + self.width - usize::from(x),
            to_y + self.height - usize::from(y),
        );
        (usize::from(name) * (2 * self.height + 1) + dy) * (2 * self.width + 1) + dx
    }

    fn cost(&self, node: &Node, to_x: usize, to_y: usize) -> f32 {
        f32::from(self.known[self.at(node.name, node.x, node.y, to_x, to_y)])
    }
}

/// Gives a place without a sample the value of its neighbour.
fn spread(one: &mut [u16], width: usize, height: usize) {
    if one.iter().all(|&k| k == UNKNOWN) {
        return;
    }
    let mut copy = |to: usize, from: usize| {
        if one[to] == UNKNOWN {
            one[to] = one[from];
        }
    };
    for _ in 0..2 {
        for y in 0..height {
            (1..width).for_each(|x| copy(y * width + x, y * width + x - 1));
            (1..width)
                .rev()
                .for_each(|x| copy(y * width + x - 1, y * width + x));
        }
        for x in 0..width {
            (1..height).for_each(|y| copy(y * width + x, (y - 1) * width + x));
            (1..height)
                .rev()
                .for_each(|y| copy((y - 1) * width + x, y * width + x));
        }
    }
}

fn price(chip: &Chip, class: u16) -> f32 {
    let (delay, user) = chip.classes[usize::from(class)];
    delay + user + HOP
}

/// A net on its way.
#[derive(Default)]
struct Way {
    tree: Tree,
    /// Pins, and how critical they are; in the order they are routed in.
    pins: Vec<(usize, f32)>,
    around: [i32; 4],
    rounds: u32,
}

/// How a round has ended.
pub struct Round {
    /// Its number.
    pub number: u32,
    /// Nets it has routed.
    pub nets: usize,
    /// Wires in use.
    pub used: usize,
    /// Wires that more than one net uses.
    pub shared: usize,
    /// Longest path of each clock, in picoseconds.
    pub longest: Vec<f32>,
}

/// Routes.
pub struct Router<'a> {
    chip: &'a Chip,
    nets: &'a [Net],
    nodes: Vec<Node>,
    prices: Vec<f32>,
    ahead: Ahead,
    ways: Vec<Way>,
    delays: Vec<Vec<f32>>,
    timing: Timing,
    open: BinaryHeap<Open>,
    search: u32,
    sharing: f32,
}

impl<'a> Router<'a> {
    /// Everything before the first round.
    pub fn new(chip: &'a Chip, nets: &'a [Net], target: Vec<f32>) -> Self {
        let node = |w: &crate::chip::Wire| Node {
            history: 1.0,
            cost: 0.0,
            search: 0,
            from: NONE,
            pip: NONE,
            users: 0,
            name: w.name,
            x: w.x,
            y: w.y,
        };
        let nodes: Vec<Node> = chip.wires.iter().map(node).collect();
        let ahead = Ahead::new(chip);
        let way = |net: &Net| {
            let mut around = [i32::MAX, i32::MAX, 0, 0];
            for wire in net.sinks.iter().map(|s| s.wire).chain([net.source]) {
                let (x, y) = place(&nodes, wire);
                around = [
                    around[0].min(x),
                    around[1].min(y),
                    around[2].max(x),
                    around[3].max(y),
                ];
            }
            Way {
                tree: Tree::default(),
                pins: (0..net.sinks.len()).map(|n| (n, 0.0)).collect(),
                around,
                rounds: 0,
            }
        };
        let ways: Vec<Way> = nets.iter().map(way).collect();
        let guess = |net: &Net| -> Vec<f32> {
            net.sinks
                .iter()
                .map(|s| straight(&nodes, &ahead, net.source, s.wire))
                .collect()
        };
        let delays: Vec<Vec<f32>> = nets.iter().map(guess).collect();
        let timing = Timing::new(nets, target);
        let prices = (0..chip.classes.len())
            .map(|class| price(chip, class as u16))
            .collect();
        Self {
            chip,
            nets,
            nodes,
            prices,
            ahead,
            ways,
            delays,
            timing,
            open: BinaryHeap::new(),
            search: 0,
            sharing: SHARING.0,
        }
    }

    /// Rounds until no wire is shared and no path of a clock is longer than `enough`, each told to
    /// `say`. If no round reaches that, the best result without a shared wire counts.
    pub fn run(&mut self, rounds: u32, enough: &[f32], mut say: impl FnMut(&Round)) -> Result<()> {
        let mut best: Option<(f32, Vec<Tree>)> = None;
        let mut again = 0;
        self.look();
        let mut order: Vec<usize> = (0..self.nets.len()).collect();
        order.sort_by_key(|&n| {
            let a = self.ways[n].around;
            (a[0] - a[2] + a[1] - a[3], n)
        });
        for number in 1..=rounds {
            let mut nets = 0;
            for &net in &order {
                if self.take_out(net, number) {
                    nets += 1;
                    self.route(net)?;
                }
            }
            self.measure();
            let longest = self.look();
            let late = longest
                .iter()
                .zip(enough)
                .map(|(path, enough)| path / enough)
                .fold(0.0, f32::max);
            let (mut used, mut shared) = (0, 0);
            for node in self.nodes.iter_mut().filter(|n| n.users > 0) {
                used += 1;
                if node.users > 1 {
                    shared += 1;
                    node.history += HISTORY * f32::from(node.users - 1);
                }
            }
            say(&Round {
                number,
                nets,
                used,
                shared,
                longest,
            });
            let end = if shared < FEW { 1000.0 } else { SHARING.2 };
            self.sharing = (self.sharing * SHARING.1).min(end);
            if shared > 0 {
                continue;
            }
            if best.as_ref().is_none_or(|(known, _)| late < *known) {
                best = Some((late, self.ways.iter().map(|way| way.tree.clone()).collect()));
            }
            if late <= 1.0 || again == AGAIN.1 {
                break;
            }
            again += 1;
            self.sharing = AGAIN.0;
        }
        let Some((_, trees)) = best else {
            bail!("several nets still share wires after {rounds} rounds: the design is too crowded")
        };
        self.ways
            .iter_mut()
            .zip(trees)
            .for_each(|(way, tree)| way.tree = tree);
        Ok(())
    }

    /// The routes as nextpnr reads them, by the nets' numbers.
    pub fn routes(&self) -> Result<HashMap<u64, String>> {
        let one = |(net, way): (&Net, &Way)| {
            let mut wires: Vec<_> = way
                .tree
                .iter()
                .map(|(&wire, step)| (wire, step.pip))
                .collect();
            wires.sort_unstable();
            let mut text = Vec::with_capacity(wires.len());
            for (wire, pip) in wires {
                let pip = if pip == NONE {
                    String::new()
                } else {
                    self.chip.pip_name(pip)?
                };
                text.push(format!("{};{pip};1", self.chip.wire_name(wire)));
            }
            Ok((net.bit, text.join(";")))
        };
        self.nets
            .iter()
            .zip(&self.ways)
            .filter(|(net, _)| !net.sinks.is_empty())
            .map(one)
            .collect()
    }

    /// Removes the routes of a net that must be routed again: all of them, or in a large net those
    /// behind shared wires. True if the net must be routed again.
    fn take_out(&mut self, n: usize, round: u32) -> bool {
        let (net, way, nodes) = (&self.nets[n], &mut self.ways[n], &mut self.nodes);
        if net.sinks.is_empty() {
            return false;
        }
        let mut slow = Vec::new();
        if round > 1 {
            for &(pin, _) in way.pins.iter().filter(|p| p.1 > SLOW * CRITICAL) {
                let wire = net.sinks[pin].wire;
                let straight = straight(nodes, &self.ahead, net.source, wire);
                if self.delays[n][pin] > 1.15 * straight + 100.0 {
                    slow.push(wire);
                }
            }
            if slow.is_empty() && way.tree.keys().all(|&w| nodes[w as usize].users < 2) {
                return false;
            }
            way.rounds += 1;
        }
        let mut keep = Tree::default();
        if net.sinks.len() > LARGE && round > 1 {
            keep.insert(net.source, Step::SOURCE);
            let mut path = Vec::new();
            for wire in net
                .sinks
                .iter()
                .map(|s| s.wire)
                .filter(|w| !slow.contains(w))
            {
                path.clear();
                let mut at = wire;
                let whole = loop {
                    if keep.contains_key(&at) {
                        break true;
                    }
                    let Some(step) = way.tree.get(&at).filter(|_| nodes[at as usize].users < 2)
                    else {
                        break false;
                    };
                    path.push((at, *step));
                    at = step.from;
                };
                if whole {
                    keep.extend(path.iter().copied());
                }
            }
        }
        for wire in way.tree.keys().filter(|w| !keep.contains_key(w)) {
            nodes[*wire as usize].users -= 1;
        }
        way.tree = keep;
        true
    }

    /// Routes all pins of a net that are not.
    fn route(&mut self, n: usize) -> Result<()> {
        let net = &self.nets[n];
        let mut way = std::mem::take(&mut self.ways[n]);
        if way.tree.is_empty() {
            way.tree.insert(net.source, Step::SOURCE);
            self.nodes[net.source as usize].users += 1;
        }
        let margin = MARGIN + way.rounds as i32 / 4;
        let around = [
            way.around[0] - margin,
            way.around[1] - margin,
            way.around[2] + margin,
            way.around[3] + margin,
        ];
        // In a large net a way begins only at wires near the pin.
        let mut near = (net.sinks.len() > LARGE).then(|| {
            let mut near = Near::default();
            let mut wires: Vec<u32> = way.tree.keys().copied().collect();
            wires.sort_unstable();
            wires
                .into_iter()
                .for_each(|wire| near.add(place(&self.nodes, wire), wire));
            near
        });
        let (x, y) = place(&self.nodes, net.source);
        way.pins.sort_by_key(|&(pin, critical)| {
            let wire = net.sinks[pin].wire;
            let (to_x, to_y) = place(&self.nodes, wire);
            (
                -((critical * 8.0) as i32),
                (to_x - x).abs() + (to_y - y).abs(),
                wire,
            )
        });
        for &(pin, critical) in &way.pins {
            let wire = net.sinks[pin].wire;
            if way.tree.contains_key(&wire) {
                continue;
            }
            let everywhere = [-1, -1, i32::MAX, i32::MAX];
            // The wires near a late pin may be the end of the detour that makes it late.
            let begin = near.as_ref().filter(|_| critical <= SLOW * CRITICAL);
            let found = self.find(&way.tree, begin, wire, critical, around)
                || self.find(&way.tree, None, wire, critical, everywhere);
            if !found {
                bail!(
                    "no way leads from {} to {}",
                    self.chip.wire_name(net.source),
                    self.chip.wire_name(wire)
                );
            }
            let mut path = Vec::new();
            let mut at = wire;
            while !way.tree.contains_key(&at) {
                path.push(at);
                at = self.nodes[at as usize].from;
            }
            let mut delay = way.tree[&at].delay;
            for &at in path.iter().rev() {
                let node = &mut self.nodes[at as usize];
                node.users += 1;
                delay += self.prices[usize::from(self.chip.pip(node.pip).class)];
                way.tree.insert(
                    at,
                    Step {
                        from: node.from,
                        pip: node.pip,
                        delay,
                    },
                );
                if let Some(near) = &mut near {
                    near.add(place(&self.nodes, at), at);
                }
            }
        }
        self.ways[n] = way;
        Ok(())
    }

    /// The cheapest way from any wire of the tree to `to`; it is in the nodes then.
    fn find(
        &mut self,
        tree: &Tree,
        near: Option<&Near>,
        to: u32,
        critical: f32,
        around: [i32; 4],
    ) -> bool {
        self.search += 1;
        self.open.clear();
        let search = self.search;
        let (to_x, to_y) = (
            usize::from(self.nodes[to as usize].x),
            usize::from(self.nodes[to as usize].y),
        );
        // The other wires of the net are closed: a way must not cross its own net.
        for (&wire, step) in tree {
            let node = &mut self.nodes[wire as usize];
            node.search = search;
            node.cost = if near.is_some() {
                -1.0
            } else {
                critical * step.delay
            };
        }
        let mut begin = |wire: u32| {
            let node = &mut self.nodes[wire as usize];
            node.cost = critical * tree[&wire].delay;
            let estimate = node.cost + ESTIMATE * self.ahead.cost(node, to_x, to_y);
            self.open.push(Open {
                estimate,
                cost: node.cost,
                wire,
            });
        };
        match near {
            Some(near) => near
                .of((to_x as i32, to_y as i32))
                .into_iter()
                .for_each(&mut begin),
            None => tree.keys().copied().for_each(&mut begin),
        }
        while let Some(at) = self.open.pop() {
            if at.cost > self.nodes[at.wire as usize].cost {
                continue;
            }
            if at.wire == to {
                return true;
            }
            let (first, pips) = self.chip.downhill(at.wire);
            for (pip, step) in (first..).zip(pips) {
                let node = &mut self.nodes[step.to as usize];
                let (x, y) = (i32::from(node.x), i32::from(node.y));
                if x < around[0] || x > around[2] || y < around[1] || y > around[3] {
                    continue;
                }
                let price = self.prices[usize::from(step.class)];
                let crowded = price * node.history * (1.0 + f32::from(node.users) * self.sharing);
                let cost = at.cost + critical * price + (1.0 - critical) * crowded;
                if node.search == search && node.cost <= cost {
                    continue;
                }
                (node.search, node.cost, node.from, node.pip) = (search, cost, at.wire, pip);
                let estimate = cost + ESTIMATE * self.ahead.cost(node, to_x, to_y);
                self.open.push(Open {
                    estimate,
                    cost,
                    wire: step.to,
                });
            }
        }
        false
    }

    /// What every pin's way takes, as nextpnr will see it.
    fn measure(&mut self) {
        let mut users: HashMap<u32, u32, BuildHasherDefault<Plain>> = HashMap::default();
        for (n, way) in self
            .ways
            .iter()
            .enumerate()
            .filter(|(_, way)| !way.tree.is_empty())
        {
            users.clear();
            way.tree
                .values()
                .filter(|s| s.pip != NONE)
                .for_each(|s| *users.entry(s.from).or_default() += 1);
            for (sink, delay) in self.nets[n].sinks.iter().zip(&mut self.delays[n]) {
                *delay = 0.0;
                let mut at = sink.wire;
                while let Some(step) = way.tree.get(&at).filter(|s| s.pip != NONE) {
                    let (base, user) =
                        self.chip.classes[usize::from(self.chip.pip(step.pip).class)];
                    *delay += base + user * users[&step.from] as f32;
                    at = step.from;
                }
            }
        }
    }

    /// Which pins the clocks depend on now.
    fn look(&mut self) -> Vec<f32> {
        let look = self.timing.look(self.nets, &self.delays);
        for (way, critical) in self.ways.iter_mut().zip(&look.criticality) {
            for (pin, known) in &mut way.pins {
                let c = critical[*pin].clamp(0.0, 1.0);
                *known = CRITICAL * (c * c) * (c * c);
            }
        }
        look.longest
    }

    /// Shared wires by the first letters of their names, and by blocks of four tiles by four. They
    /// show where the design is too crowded.
    pub fn crowds(&self) -> (BTreeMap<String, u32>, Vec<Vec<u32>>) {
        let mut names: BTreeMap<String, u32> = BTreeMap::new();
        let mut blocks = vec![vec![0; self.chip.width.div_ceil(4)]; self.chip.height.div_ceil(4)];
        for node in self.nodes.iter().filter(|n| n.users > 1) {
            *names
                .entry(
                    self.chip.names[usize::from(node.name)]
                        .chars()
                        .take(3)
                        .collect(),
                )
                .or_default() += 1;
            blocks[usize::from(node.y) / 4][usize::from(node.x) / 4] += 1;
        }
        (names, blocks)
    }
}

fn place(nodes: &[Node], wire: u32) -> (i32, i32) {
    (nodes[wire as usize].x.into(), nodes[wire as usize].y.into())
}

fn straight(nodes: &[Node], ahead: &Ahead, from: u32, to: u32) -> f32 {
    let (x, y) = place(nodes, to);
    ahead.cost(&nodes[from as usize], x as usize, y as usize)
}

/// Wires of a net by blocks of four tiles by four.
#[derive(Default)]
struct Near(HashMap<(i32, i32), Vec<u32>>);

impl Near {
    fn add(&mut self, (x, y): (i32, i32), wire: u32) {
        self.0.entry((x / 4, y / 4)).or_default().push(wire);
    }

    /// Those around a tile, from so far that there are some.
    fn of(&self, (x, y): (i32, i32)) -> Vec<u32> {
        let mut reach = 1;
        loop {
            let blocks = (y / 4 - reach..=y / 4 + reach)
                .flat_map(|by| (x / 4 - reach..=x / 4 + reach).map(move |bx| (bx, by)));
            let wires: Vec<u32> = blocks
                .filter_map(|block| self.0.get(&block))
                .flatten()
                .copied()
                .collect();
            if wires.len() >= 8 || reach > 32 {
                return wires;
            }
            reach *= 2;
        }
    }
}

#[cfg(test)]
mod tests;
