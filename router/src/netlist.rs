//! A placed netlist as nextpnr writes it (`--write`): nets and their pins, and what signals take
//! through cells.
//!
//! The meaning of each port follows `getPortTimingClass` and `getPortClockingInfo` of nextpnr's
//! `ecp5/arch.cc`.

use crate::bel::Bel;
use crate::chip::{CellDelays, Chip, Permutation};
use anyhow::{Context, Result, ensure};
use serde_json::{Map, Value};
use std::collections::{HashMap, HashSet};

/// A pin a net leads to.
pub struct Sink {
    /// The wire there.
    pub wire: u32,
    /// Through the cell to other nets: (net, picoseconds).
    pub through: Vec<(usize, f32)>,
    /// A flip-flop or the like ends here: (setup, clock).
    pub end: Option<(f32, usize)>,
}

/// A net to be routed.
pub struct Net {
    /// Its number in the file.
    pub bit: u64,
    /// The wire it comes from.
    pub source: u32,
    /// It comes from a flip-flop or the like: (picoseconds from the clock, clock).
    pub begin: Option<(f32, usize)>,
    /// Where it leads.
    pub sinks: Vec<Sink>,
}

/// The file.
pub struct Netlist {
    json: Value,
    top: String,
}

struct Cell<'a> {
    bel: Bel,
    kind: &'a str,
    parameters: &'a Map<String, Value>,
    ports: Vec<(&'a str, u64, bool)>,
}

impl Cell<'_> {
    fn parameter(&self, name: &str) -> &str {
        self.parameters
            .get(name)
            .and_then(Value::as_str)
            .unwrap_or("")
            .trim()
    }

    fn net(&self, port: &str) -> Option<u64> {
        self.ports.iter().find(|p| p.0 == port).map(|p| p.1)
    }
}

fn number(text: &str) -> Option<u64> {
    if text.len() > 8 {
        u64::from_str_radix(text, 2).ok()
    } else {
        text.parse().ok()
    }
}

impl Netlist {
    /// Parses the file.
    pub fn parse(text: &str) -> Result<Self> {
        let json: Value = serde_json::from_str(text)?;
        let modules = json["modules"]
            .as_object()
            .context("a netlist has modules")?;
        ensure!(
            modules.len() == 1,
            "a placed netlist has one module, this one {}",
            modules.len()
        );
        let top = modules
            .keys()
            .next()
            .context("a netlist has a module")?
            .clone();
        Ok(Self { json, top })
    }

    fn module(&self) -> &Value {
        &self.json["modules"][&self.top]
    }

    fn cells(&self) -> Result<Vec<Cell<'_>>> {
        let cells = self.module()["cells"]
            .as_object()
            .context("a netlist has cells")?;
        let mut cells: Vec<_> = cells
            .iter()
            .filter(|(_, cell)| cell["attributes"]["NEXTPNR_BEL"].is_string())
            .collect();
        cells.sort_by_key(|(name, _)| *name);
        let read = |(name, cell): (&String, _)| {
            read_cell(cell).with_context(|| format!("cell {name} is not as nextpnr writes one"))
        };
        cells.into_iter().map(read).collect()
    }

    /// Names of nets by their numbers.
    fn names(&self) -> Result<HashMap<u64, (&str, bool)>> {
        let names = self.module()["netnames"]
            .as_object()
            .context("a netlist has nets")?;
        Ok(names
            .iter()
            .filter_map(|(name, net)| {
                Some((
                    net["bits"][0].as_u64()?,
                    (
                        name.as_str(),
                        net["attributes"]["ECP5_IS_GLOBAL"].is_string(),
                    ),
                ))
            })
            .collect())
    }

    /// Nets on clock networks, by name.
    pub fn clocks(&self) -> Result<Vec<String>> {
        let mut clocks: Vec<String> = self
            .names()?
            .into_values()
            .filter(|(_, global)| *global)
            .map(|(name, _)| name.to_owned())
            .collect();
        clocks.sort();
        Ok(clocks)
    }

    /// The chip as this design leaves it, and what is to be routed on it. Nets on clock networks
    /// and the ways into them are nextpnr's. `clocks` as [`Netlist::clocks`] has them.
    pub fn nets(&self, database: Vec<u8>, clocks: &[String]) -> Result<(Chip, Vec<Net>)> {
        let (cells, names) = (self.cells()?, self.names()?);
        let clock_of = |net: Option<u64>| {
            clocks
                .iter()
                .position(|c| Some(c.as_str()) == net.and_then(|n| names.get(&n)).map(|n| n.0))
        };
        let (mut slices, mut globals, mut theirs) = (Vec::new(), Vec::new(), HashSet::new());
        for cell in &cells {
            if cell.kind == "TRELLIS_COMB" {
                let permutation = match cell.parameter("MODE") {
                    "DPRAM" | "RAMW_BLOCK" => Permutation::None,
                    "CCU2" => Permutation::Pairs,
                    _ => Permutation::All,
                };
                slices.push((cell.bel.clone(), permutation));
            }
            for (port, net, output) in &cell.ports {
                if names.get(net).is_some_and(|n| n.1) {
                    theirs.insert(*net);
                    if !output {
                        globals.push((cell.bel.clone(), (*port).to_owned()));
                    }
                }
            }
        }
        let chip = Chip::read(database, &slices, &globals)?;
        let delays = chip.cell_delays()?;
        let (mut nets, mut index) = (Vec::new(), HashMap::new());
        for cell in &cells {
            for (port, net, _) in cell
                .ports
                .iter()
                .filter(|(_, net, output)| *output && !theirs.contains(net))
            {
                index.insert(*net, nets.len());
                let begin = begins(cell, port, &delays)?
                    .and_then(|(delay, clock)| Some((delay, clock_of(cell.net(clock))?)));
                nets.push(Net {
                    bit: *net,
                    source: chip.pin(&cell.bel, port)?,
                    begin,
                    sinks: Vec::new(),
                });
            }
        }
        for cell in cells.iter().filter(|cell| cell.kind != "DCCA") {
            for (port, net, _) in cell.ports.iter().filter(|(_, _, output)| !output) {
                let Some(&at) = index.get(net) else { continue };
                let (mut through, mut end) = (Vec::new(), None);
                match leads(cell, port, &delays)? {
                    Leads::Nowhere => {}
                    Leads::To(outputs) => through.extend(
                        outputs
                            .into_iter()
                            .filter_map(|(net, delay)| Some((*index.get(&net)?, delay))),
                    ),
                    Leads::End(setup, clock) => {
                        end = clock_of(cell.net(clock)).map(|clock| (setup, clock))
                    }
                }
                nets[at].sinks.push(Sink {
                    wire: chip.pin(&cell.bel, port)?,
                    through,
                    end,
                });
            }
        }
        Ok((chip, nets))
    }

    /// The file with routes in it, by the nets' numbers, ready for nextpnr's router1 to look over.
    pub fn routed(mut self, mut routes: HashMap<u64, String>) -> Result<String> {
        let module = &mut self.json["modules"][&self.top];
        for net in module["netnames"]
            .as_object_mut()
            .context("a netlist has nets")?
            .values_mut()
        {
            let bit = net["bits"][0].as_u64();
            if let Some(route) = bit.and_then(|bit| routes.remove(&bit)) {
                net["attributes"]["ROUTING"] = Value::String(route);
            }
        }
        module["settings"]["router"] = Value::String("router1".to_owned());
        Ok(serde_json::to_string(&self.json)?)
    }
}

fn read_cell(cell: &Value) -> Option<Cell<'_>> {
    let mut ports = Vec::new();
    for (port, bits) in cell["connections"].as_object()? {
        let direction = cell["port_directions"][port].as_str()?;
        if let (Some(net), true) = (bits[0].as_u64(), direction != "inout") {
            ports.push((port.as_str(), net, direction == "output"));
        }
    }
    let bel = Bel::parse(cell["attributes"]["NEXTPNR_BEL"].as_str()?)?;
    Some(Cell {
        bel,
        kind: cell["type"].as_str()?,
        parameters: cell["parameters"].as_object()?,
        ports,
    })
}

enum Leads<'a> {
    Nowhere,
    /// To these nets, after that long.
    To(Vec<(u64, f32)>),
    /// To a flip-flop with this setup, by the clock at this port.
    End(f32, &'a str),
}

const MISSING: &str =
    "the chip database has no delay of a cell that is placed: is it nextpnr 0.11's?";

/// A block RAM: its name in the tables, and the port its half's clock comes by.
fn block_ram(cell: &Cell<'_>, port: &str) -> (String, &'static str, &'static str) {
    let mode = |half: &str| {
        Some(cell.parameter(&format!("REGMODE_{half}")))
            .filter(|m| !m.is_empty())
            .unwrap_or("NOREG")
            .to_owned()
    };
    let table = format!("DP16KD_REGMODE_A_{}_REGMODE_B_{}", mode("A"), mode("B"));
    let half = if port
        .trim_end_matches(|c: char| c.is_ascii_digit())
        .ends_with('A')
    {
        "CLKA"
    } else {
        "CLKB"
    };
    if number(cell.parameter("DATA_WIDTH_A")) != Some(36) {
        return (table, half, half);
    }
    // 36 wide: what reads goes by one clock, what writes by the other.
    let high = port
        .strip_prefix("ADB")
        .and_then(|n| n.parse().ok())
        .is_some_and(|n: u32| n >= 5);
    let reads = port.starts_with("DO") || high || matches!(port, "OCEB" | "CEB");
    (table, half, if reads { "CLKB" } else { "CLKA" })
}

fn begins(cell: &Cell<'_>, port: &str, delays: &CellDelays) -> Result<Option<(f32, &'static str)>> {
    Ok(match cell.kind {
        "TRELLIS_FF" => Some((
            delays.through("SLOGICB", "CLK", "Q0").context(MISSING)?,
            "CLK",
        )),
        "DP16KD" => {
            let (table, half, clock) = block_ram(cell, port);
            Some((delays.through(&table, half, port).context(MISSING)?, clock))
        }
        "IOLOGIC" if !matches!(port, "IOLDO" | "IOLTO") => Some((500.0, "CLK")),
        _ => None,
    })
}

fn leads<'a>(cell: &Cell<'_>, port: &'a str, delays: &CellDelays) -> Result<Leads<'a>> {
    let outputs = || cell.ports.iter().filter(|p| p.2);
    let setup =
        |cell: &str, clock: &str, port: &str| delays.setup(cell, clock, port).context(MISSING);
    Ok(match cell.kind {
        "TRELLIS_COMB" => match port {
            "WCK" => Leads::Nowhere,
            "WD" => Leads::End(setup("SDPRAME", "WCK", "WD0")?, "WCK"),
            "WRE" | "WAD0" | "WAD1" | "WAD2" | "WAD3" => {
                Leads::End(setup("SDPRAME", "WCK", port)?, "WCK")
            }
            _ => {
                // Of both halves nextpnr takes what the first one takes.
                let table = if cell.parameter("MODE") == "CCU2" {
                    "TRELLIS_COMB_CARRY0"
                } else {
                    "TRELLIS_COMB"
                };
                Leads::To(
                    outputs()
                        .filter_map(|(to, net, _)| Some((*net, delays.through(table, port, to)?)))
                        .collect(),
                )
            }
        },
        "TRELLIS_FF" => match port {
            "CLK" => Leads::Nowhere,
            "DI" => Leads::End(setup("SLOGICB", "CLK", "DI0")?, "CLK"),
            "M" => Leads::End(setup("SLOGICB", "CLK", "M0")?, "CLK"),
            _ => Leads::End(setup("SLOGICB", "CLK", port)?, "CLK"),
        },
        "TRELLIS_RAMW" => {
            let to = match port {
                "A0" => "WADO3",
                "B0" => "WADO1",
                "C0" => "WADO2",
                "D0" => "WADO0",
                "A1" => "WDO1",
                "B1" => "WDO3",
                "C1" => "WDO0",
                _ => "WDO2",
            };
            Leads::To(cell.net(to).map(|net| (net, 0.0)).into_iter().collect())
        }
        "DP16KD" if !port.starts_with("CLK") => {
            let (table, half, clock) = block_ram(cell, port);
            // A half that is not used has no clock of its own.
            let clock = if cell.net(clock).is_some() {
                clock
            } else if clock == "CLKA" {
                "CLKB"
            } else {
                "CLKA"
            };
            Leads::End(setup(&table, half, port)?, clock)
        }
        // Without registers of their own, as yosys makes them: others are refused by the placer's
        // netlist here.
        "MULT18X18D"
            if port.len() > 1
                && port[1..].starts_with(|c: char| c.is_ascii_digit())
                && matches!(&port[..1], "A" | "B") =>
        {
            let delay = delays
                .through("MULT18X18D_REGS_NONE", &port[..1], "P")
                .context(MISSING)?;
            let product = |p: &&(&str, u64, bool)| {
                p.0.strip_prefix('P')
                    .is_some_and(|n| n.starts_with(|c: char| c.is_ascii_digit()))
            };
            Leads::To(outputs().filter(product).map(|p| (p.1, delay)).collect())
        }
        "IOLOGIC" if !matches!(port, "CLK" | "PADDI" | "DI") => Leads::End(100.0, "CLK"),
        _ => Leads::Nowhere,
    })
}
