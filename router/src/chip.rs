//! nextpnr's chip database: wires, the switches between them ("pips"), pins of the places ("bels")
//! and the delays of all of them.
//!
//! The layout is that of `ecp5/arch.h` of nextpnr 0.11: packed little-endian structures, pointers
//! relative to where they stand, one description for all tiles alike.

use crate::bel::Bel;
use anyhow::{Context, Result, bail, ensure};
use std::collections::{HashMap, VecDeque};

/// No wire, no switch.
pub const NONE: u32 = u32::MAX;

/// What the numbers of ports and cells in the database mean.
struct Ports(HashMap<&'static str, i32>);

impl Ports {
    /// The names of the nextpnr this was written against.
    fn new() -> Self {
        let names = include_str!("ports.txt").lines().skip(1);
        Self((1..).zip(names).map(|(n, name)| (name, n)).collect())
    }

    fn of(&self, name: &str) -> i32 {
        self.0.get(name).copied().unwrap_or(0)
    }
}

/// A wire: where it is anchored, and its name in that tile.
#[derive(Clone, Copy)]
pub struct Wire {
    /// Index into [`Chip::names`].
    pub name: u16,
    /// Column.
    pub x: u8,
    /// Row.
    pub y: u8,
}

/// A switch that leads out of a wire.
#[derive(Clone, Copy, Default)]
pub struct Pip {
    /// The wire it drives.
    pub to: u32,
    /// Index into [`Chip::classes`].
    pub class: u16,
}

/// Which inputs of a slice's LUTs may be exchanged for each other.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum Permutation {
    /// None: there is RAM in it, or nothing at all.
    None,
    /// A and B, C and D: there is a carry in it.
    Pairs,
    /// All.
    All,
}

/// The part of the chip a design leaves to be routed.
pub struct Chip {
    /// Columns.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// Names of wires within a tile.
    pub names: Vec<String>,
    /// All wires.
    pub wires: Vec<Wire>,
    /// Delay of a switch in picoseconds, and what every further user of its source adds.
    pub classes: Vec<(f32, f32)>,
    first: Vec<u32>,
    pips: Vec<Pip>,
    /// Which of its tile's switches each is: (tile, index).
    origin: Vec<(u16, u16)>,
    up_first: Vec<u32>,
    up: Vec<(u32, u16)>,
    data: Data,
    tiles: Tiles,
    ports: Ports,
}

/// Where things stand in the file.
struct Tiles {
    kind: Vec<usize>,
    /// Of each kind of tile: names of its wires; switches, as (address, count).
    names: Vec<Vec<u16>>,
    pips: Vec<(usize, usize)>,
    /// (kind of tile, name of the bel): its address.
    bels: HashMap<(usize, String), usize>,
    /// Of each tile: its first wire.
    wire: Vec<u32>,
    width: usize,
}

struct Data(Vec<u8>);

impl Data {
    fn at<const N: usize>(&self, at: usize) -> Result<[u8; N]> {
        let bytes = self.0.get(at..at.saturating_add(N));
        Ok(bytes
            .context("the chip database ends too early: is it nextpnr 0.11's?")?
            .try_into()?)
    }

    fn i32(&self, at: usize) -> Result<i32> {
        Ok(i32::from_le_bytes(self.at(at)?))
    }

    fn i16(&self, at: usize) -> Result<i16> {
        Ok(i16::from_le_bytes(self.at(at)?))
    }

    fn pointer(&self, at: usize) -> Result<usize> {
        let to = at as i64 + i64::from(self.i32(at)?);
        usize::try_from(to).context("a pointer of the chip database leads out of it")
    }

    fn slice(&self, at: usize) -> Result<(usize, usize)> {
        // The pointer of an empty list has no meaning.
        Ok(match usize::try_from(self.i32(at + 4)?)? {
            0 => (0, 0),
            count => (self.pointer(at)?, count),
        })
    }

    fn text(&self, at: usize) -> Result<String> {
        let from = self
            .0
            .get(self.pointer(at)?..)
            .context("a name of the chip database is outside of it")?;
        let end = from
            .iter()
            .position(|&c| c == 0)
            .context("a name of the chip database does not end")?;
        Ok(String::from_utf8(from[..end].to_vec())?)
    }
}

impl Tiles {
    fn neighbour(&self, tile: usize, dx: i16, dy: i16) -> Result<usize> {
        let to = tile as i64 + i64::from(dy) * self.width as i64 + i64::from(dx);
        ensure!(
            (0..self.kind.len() as i64).contains(&to),
            "the chip database leads out of the chip"
        );
        Ok(to as usize)
    }

    /// Source, switch; nothing if the design forbids it.
    fn pip(
        &self,
        data: &Data,
        tile: usize,
        index: usize,
        slices: &HashMap<(usize, usize), Permutation>,
    ) -> Result<Option<(u32, Pip)>> {
        let at = self.pips[self.kind[tile]].0 + 20 * index;
        let flags = data.i16(at + 16)?;
        if flags & 0x4000 != 0 {
            let (slice, output, input) = ((flags >> 4 & 7) as usize / 2, flags >> 2 & 3, flags & 3);
            match slices.get(&(tile, slice)) {
                Some(Permutation::All) => {}
                Some(Permutation::Pairs) if output / 2 == input / 2 => {}
                _ => return Ok(None),
            }
        }
        let from = self.neighbour(tile, data.i16(at)?, data.i16(at + 2)?)?;
        let to = self.neighbour(tile, data.i16(at + 4)?, data.i16(at + 6)?)?;
        let source = self.wire[from] + data.i16(at + 8)? as u32;
        let to = self.wire[to] + data.i16(at + 10)? as u32;
        Ok(Some((
            source,
            Pip {
                to,
                class: data.i16(at + 12)? as u16,
            },
        )))
    }
}

impl Chip {
    /// Reads the database. `slices` says what is in each slice, `globals` which pins are on clock
    /// networks: wires that nextpnr will need for those are left out.
    pub fn read(
        bytes: Vec<u8>,
        slices: &[(Bel, Permutation)],
        globals: &[(Bel, String)],
    ) -> Result<Self> {
        let (data, ports) = (Data(bytes), Ports::new());
        let info = data.pointer(0)?;
        let (width, height) = (data.i32(info)? as usize, data.i32(info + 4)? as usize);
        ensure!(
            (2..255).contains(&width) && (2..255).contains(&height),
            "the chip database says {width} by {height} tiles"
        );
        let count = width * height;
        let (types, types_count) = data.slice(info + 16)?;
        let (kinds, _) = data.slice(info + 24)?;
        let grade = data.slice(info + 72)?.0; // -6 comes first
        let (classes, classes_count) = data.slice(grade + 8)?;
        let classes = (0..classes_count)
            .map(|n| {
                Ok((
                    data.i32(classes + 16 * n + 4)? as f32,
                    data.i32(classes + 16 * n + 12)? as f32,
                ))
            })
            .collect::<Result<Vec<_>>>()?;

        let (mut numbers, mut names) = (HashMap::new(), Vec::new());
        let mut tiles = Tiles {
            kind: Vec::new(),
            names: Vec::new(),
            pips: Vec::new(),
            bels: HashMap::new(),
            wire: vec![0],
            width,
        };
        for kind in 0..types_count {
            let (bels, bels_count) = data.slice(types + 24 * kind)?;
            for n in 0..bels_count {
                tiles
                    .bels
                    .insert((kind, data.text(bels + 20 * n)?), bels + 20 * n);
            }
            let (wires, wires_count) = data.slice(types + 24 * kind + 8)?;
            let mut own = Vec::with_capacity(wires_count);
            for n in 0..wires_count {
                let name = data.text(wires + 32 * n)?;
                own.push(*numbers.entry(name.clone()).or_insert_with(|| {
                    names.push(name);
                    names.len() as u16 - 1
                }));
            }
            tiles.names.push(own);
            tiles.pips.push(data.slice(types + 24 * kind + 16)?);
        }
        let mut wires = Vec::new();
        for tile in 0..count {
            let kind = data.i32(kinds + 4 * tile)? as usize;
            ensure!(kind < types_count, "the chip database has no tile {kind}");
            tiles.kind.push(kind);
            let at = |name: &u16| Wire {
                name: *name,
                x: (tile % width) as u8,
                y: (tile / width) as u8,
            };
            wires.extend(tiles.names[kind].iter().map(at));
            tiles.wire.push(wires.len() as u32);
        }

        let mut chip = Self {
            width,
            height,
            names,
            classes,
            first: Vec::new(),
            pips: Vec::new(),
            origin: Vec::new(),
            up_first: Vec::new(),
            up: Vec::new(),
            wires,
            data,
            tiles,
            ports,
        };
        let mut inside = HashMap::new();
        for (bel, permutation) in slices {
            let slice = bel
                .name
                .as_bytes()
                .get(5)
                .map_or(0, |letter| usize::from(letter.wrapping_sub(b'A')));
            let known = inside
                .entry((bel.y * width + bel.x, slice))
                .or_insert(*permutation);
            *known = (*known).min(*permutation);
        }
        chip.connect(&inside, globals)?;
        Ok(chip)
    }

    /// Every switch the design may use, from both sides.
    fn connect(
        &mut self,
        slices: &HashMap<(usize, usize), Permutation>,
        globals: &[(Bel, String)],
    ) -> Result<()> {
        let mut all = Vec::new();
        for tile in 0..self.tiles.kind.len() {
            for index in 0..self.tiles.pips[self.tiles.kind[tile]].1 {
                if let Some((from, pip)) = self.tiles.pip(&self.data, tile, index, slices)? {
                    ensure!(
                        (from.max(pip.to) as usize) < self.wires.len(),
                        "the chip database has a switch without wires"
                    );
                    ensure!(
                        usize::from(pip.class) < self.classes.len(),
                        "the chip database has a switch without a delay"
                    );
                    all.push((from, pip, (tile as u16, index as u16)));
                }
            }
        }
        (self.up_first, self.up) = sorted(self.wires.len(), &all, |(from, pip, _)| {
            (pip.to, (*from, pip.class))
        });
        let taken = self.clock_networks(globals)?;
        all.retain(|(from, pip, _)| !taken[*from as usize] && !taken[pip.to as usize]);
        (self.up_first, self.up) = sorted(self.wires.len(), &all, |(from, pip, _)| {
            (pip.to, (*from, pip.class))
        });
        (self.first, self.pips) = sorted(self.wires.len(), &all, |(from, pip, _)| (*from, *pip));
        self.origin = sorted(self.wires.len(), &all, |(from, _, origin)| (*from, *origin)).1;
        Ok(())
    }

    /// Wires of the clock networks, and between them and the pins they lead to: what
    /// `route_logic_tile_global` of nextpnr takes.
    fn clock_networks(&self, globals: &[(Bel, String)]) -> Result<Vec<bool>> {
        let named = |wire: u32, start: &str| {
            self.names[usize::from(self.wires[wire as usize].name)].starts_with(start)
        };
        let mut taken: Vec<bool> = (0..self.wires.len() as u32)
            .map(|wire| named(wire, "G_"))
            .collect();
        for (bel, port) in globals {
            let pin = self.pin(bel, port)?;
            let mut next = HashMap::from([(pin, NONE)]);
            let mut queue = VecDeque::from([pin]);
            let end = loop {
                let Some(wire) = queue.pop_front() else {
                    bail!("no clock network leads to {port} of {bel}")
                };
                if named(wire, "G_HPBX") {
                    break wire;
                }
                for &(from, _) in self.uphill(wire) {
                    next.entry(from).or_insert_with(|| {
                        queue.push_back(from);
                        wire
                    });
                }
            };
            let mut wire = end;
            while wire != NONE {
                taken[wire as usize] = true;
                wire = next[&wire];
            }
        }
        Ok(taken)
    }

    /// The wire at a pin of a bel.
    pub fn pin(&self, bel: &Bel, port: &str) -> Result<u32> {
        ensure!(
            bel.x < self.width && bel.y < self.height,
            "{bel} is not on the chip"
        );
        let (tile, number) = (bel.y * self.width + bel.x, self.ports.of(port));
        let at = self
            .tiles
            .bels
            .get(&(self.tiles.kind[tile], bel.name.clone()));
        let (pins, count) = self
            .data
            .slice(at.with_context(|| format!("the chip has no {bel}"))? + 12)?;
        for pin in (0..count).map(|n| pins + 16 * n) {
            if self.data.i32(pin + 8)? == number {
                let tile =
                    self.tiles
                        .neighbour(tile, self.data.i16(pin)?, self.data.i16(pin + 2)?)?;
                return Ok(self.tiles.wire[tile] + self.data.i32(pin + 4)? as u32);
            }
        }
        bail!("{bel} has no pin {port}")
    }

    /// Switches out of a wire; the first one's number.
    pub fn downhill(&self, wire: u32) -> (u32, &[Pip]) {
        let (from, to) = (self.first[wire as usize], self.first[wire as usize + 1]);
        (from, &self.pips[from as usize..to as usize])
    }

    /// Wires that can drive a wire, and the class of the switch.
    pub fn uphill(&self, wire: u32) -> &[(u32, u16)] {
        &self.up[self.up_first[wire as usize] as usize..self.up_first[wire as usize + 1] as usize]
    }

    /// A switch by its number.
    pub fn pip(&self, pip: u32) -> Pip {
        self.pips[pip as usize]
    }

    /// nextpnr's name of a wire.
    pub fn wire_name(&self, wire: u32) -> String {
        let w = self.wires[wire as usize];
        format!("X{}/Y{}/{}", w.x, w.y, self.names[usize::from(w.name)])
    }

    /// nextpnr's name of a switch.
    pub fn pip_name(&self, pip: u32) -> Result<String> {
        let (tile, index) = self.origin[pip as usize];
        let tile = usize::from(tile);
        let at = self.tiles.pips[self.tiles.kind[tile]].0 + 20 * usize::from(index);
        let end = |offset: usize, name: usize| -> Result<String> {
            let (dx, dy) = (self.data.i16(at + offset)?, self.data.i16(at + offset + 2)?);
            let names = &self.tiles.names[self.tiles.kind[self.tiles.neighbour(tile, dx, dy)?]];
            Ok(format!(
                "{dx}_{dy}_{}",
                self.names[usize::from(names[self.data.i16(at + name)? as usize])]
            ))
        };
        Ok(format!(
            "X{}/Y{}/{}->{}",
            tile % self.width,
            tile / self.width,
            end(0, 8)?,
            end(4, 10)?
        ))
    }

    /// The wires into the LUTs of the slices of the tile nearest to a place that has any.
    pub fn lut_inputs(&self, x: usize, y: usize) -> (usize, Vec<u32>) {
        let logic = |tile: &usize| {
            self.tiles
                .bels
                .contains_key(&(self.tiles.kind[*tile], "SLICEA.K0".to_owned()))
        };
        let far = |tile: &usize| (tile % self.width).abs_diff(x) + (tile / self.width).abs_diff(y);
        let tile = (0..self.tiles.kind.len())
            .filter(logic)
            .min_by_key(far)
            .unwrap_or(0);
        let input = |name: &str| matches!(name.as_bytes(), [b'A'..=b'D', b'0'..=b'7']);
        let wires = self.tiles.wire[tile]..self.tiles.wire[tile + 1];
        let inputs =
            wires.filter(|&w| input(&self.names[usize::from(self.wires[w as usize].name)]));
        (tile, inputs.collect())
    }

    /// What cells take, by the numbers' names: (cell, from, to): picoseconds; (cell, clock, port):
    /// setup.
    pub fn cell_delays(&self) -> Result<CellDelays> {
        let names: HashMap<i32, &str> = self.ports.0.iter().map(|(name, n)| (*n, *name)).collect();
        let name = |at: usize| -> Result<&str> {
            Ok(names.get(&self.data.i32(at)?).copied().unwrap_or("?"))
        };
        let grade = self.data.slice(self.data.pointer(0)? + 72)?.0;
        let (cells, count) = self.data.slice(grade)?;
        let mut delays = CellDelays::default();
        for cell in (0..count).map(|n| cells + 20 * n) {
            let (through, many) = self.data.slice(cell + 4)?;
            for d in (0..many).map(|n| through + 16 * n) {
                delays.through.insert(
                    key(name(cell)?, name(d)?, name(d + 4)?),
                    self.data.i32(d + 12)? as f32,
                );
            }
            let (setups, many) = self.data.slice(cell + 12)?;
            for s in (0..many).map(|n| setups + 24 * n) {
                delays.setup.insert(
                    key(name(cell)?, name(s + 4)?, name(s)?),
                    self.data.i32(s + 12)? as f32,
                );
            }
        }
        Ok(delays)
    }
}

#[cfg(test)]
impl Chip {
    /// Wires in a row of tiles, and switches between them (from, to) that all take 100 ps.
    pub(crate) fn of(wires: usize, pips: &[(u32, u32)]) -> Self {
        let all: Vec<_> = pips
            .iter()
            .map(|&(from, to)| (from, Pip { to, class: 0 }, (0u16, 0u16)))
            .collect();
        let (first, pips) = sorted(wires, &all, |(from, pip, _)| (*from, *pip));
        let (up_first, up) = sorted(wires, &all, |(from, pip, _)| (pip.to, (*from, pip.class)));
        Self {
            width: wires,
            height: 1,
            names: vec!["w".to_owned()],
            classes: vec![(100.0, 0.0)],
            origin: vec![(0, 0); pips.len()],
            wires: (0..wires)
                .map(|x| Wire {
                    name: 0,
                    x: x as u8,
                    y: 0,
                })
                .collect(),
            data: Data(Vec::new()),
            tiles: Tiles {
                kind: Vec::new(),
                names: Vec::new(),
                pips: Vec::new(),
                bels: HashMap::new(),
                wire: vec![0, 0],
                width: wires,
            },
            ports: Ports::new(),
            first,
            pips,
            up_first,
            up,
        }
    }
}

/// What cells take.
#[derive(Default)]
pub struct CellDelays {
    through: HashMap<String, f32>,
    setup: HashMap<String, f32>,
}

fn key(cell: &str, from: &str, to: &str) -> String {
    format!("{cell} {from} {to}")
}

impl CellDelays {
    /// From one port to another, if there is a way.
    pub fn through(&self, cell: &str, from: &str, to: &str) -> Option<f32> {
        self.through.get(&key(cell, from, to)).copied()
    }

    /// What a port must be ahead of its clock.
    pub fn setup(&self, cell: &str, clock: &str, port: &str) -> Option<f32> {
        self.setup.get(&key(cell, clock, port)).copied()
    }
}

/// Sorts by the first of what `of` gives, stably: (where each begins, the second of it).
fn sorted<T, V: Copy + Default>(
    count: usize,
    all: &[T],
    of: impl Fn(&T) -> (u32, V),
) -> (Vec<u32>, Vec<V>) {
    let mut first = vec![0u32; count + 1];
    for one in all {
        first[of(one).0 as usize + 1] += 1;
    }
    for n in 0..count {
        first[n + 1] += first[n];
    }
    let (mut next, mut values) = (first.clone(), vec![V::default(); all.len()]);
    for one in all {
        let (at, value) = of(one);
        values[next[at as usize] as usize] = value;
        next[at as usize] += 1;
    }
    (first, values)
}
