//! The netlist that yosys and nextpnr made of a board, beside its RTL: the same frames, the same
//! pins, the same clocks.
//!
//! Both boards run the release image, each with a flash of its own; after every edge of either
//! clock all their pins are compared, so the first difference has a name and a clock. What the RTL
//! leaves open is random in the netlist, with a seed: LUT RAM and block RAM at power-up, and what a
//! port of a block RAM reads while the other writes there (docs/netlist.md).
//!
//! `cargo xtask netlist` builds both boards and says where they are: `FERROCNC_SOC`,
//! `FERROCNC_GATES`.

use std::collections::BTreeMap;
use std::net::Ipv4Addr;
use std::path::PathBuf;
use std::sync::atomic::Ordering;

use ferrocnc_tests::{description, from_environment, parts, report_part, seed, to_bytes, to_words};
use rand::{Rng as _, RngCore, SeedableRng};
use rand_pcg::Pcg32;
use serde_json::json;
use sim::board::Board;
use sim::firmware::Image;
use sim::gmii;
use sim::nor::pins::Wires;
use sim::nor::spi::Shared;
use sim::nor::{Nor, Part};
use sim::plant::Plant;
use sim::rig::Rig;
use sim::soc::{Manifest, Pins, SYS, Silicon, Soc};
use wire::describe::Describe;
use wire::exchange::{Command, PWM_ENABLE, Status};
use wire::map;
use wire::state::State;

/// The board's address in its file.
const BOARD: Ipv4Addr = Ipv4Addr::new(192, 168, 2, 50);
/// The netlist's reset goes through two flip-flops that the RTL's simulation does not have.
const RESET_BEHIND: u32 = 2;
/// Start-up takes 2 ms; 10 are a board that does not start.
const BOOT_CLOCKS: u64 = 600_000;

/// Two boards at one set of pins. The environment sees those of the RTL.
struct Beside {
    rtl: Soc,
    gates: Soc,
    seed: u32,
    /// Which memory of the netlist turns over a bit, counted from 1.
    wrong: u16,
    holding: u32,
    edges: u64,
    clock: u64,
}

impl Beside {
    /// The pins that both have. The gate has none; a PHY's byte counts while it is valid.
    fn visible(pins: &Pins) -> Pins {
        Pins {
            gate: 0,
            sys_rst: 0,
            enc_a: 0,
            enc_b: 0,
            step_index: 0,
            gmii_tx_data: if pins.gmii_tx_en != 0 {
                pins.gmii_tx_data
            } else {
                0
            },
            ..*pins
        }
    }
}

impl Silicon for Beside {
    fn rise(&mut self, pins: &mut Pins, clocks: u32, time_ps: u64) {
        let (mut rtl, mut gates) = (*pins, *pins);
        if clocks & SYS != 0 {
            self.clock += 1;
            self.holding = match pins.sys_rst {
                0 => self.holding.saturating_sub(1),
                _ => RESET_BEHIND + 1,
            };
        }
        rtl.sys_rst = u8::from(self.holding != 0);
        if pins.sys_rst != 0 {
            (gates.enc_a, gates.enc_b) = (self.seed as u16, (self.seed >> 16) as u16);
            gates.step_index = self.wrong;
        }
        self.rtl.rise(&mut rtl, clocks, time_ps);
        self.gates.rise(&mut gates, clocks, time_ps);
        self.edges += 1;
        let (is, should) = (Self::visible(&gates), Self::visible(&rtl));
        assert_eq!(
            is, should,
            "the netlist (left) is not the RTL (right) after clock {}, seed {}",
            self.clock, self.seed
        );
        rtl.sys_rst = pins.sys_rst;
        *pins = rtl;
    }
}

/// The folder of the netlist's library.
fn gates_folder() -> PathBuf {
    std::env::var_os("FERROCNC_GATES")
        .map(PathBuf::from)
        .expect("FERROCNC_GATES is not set; run this as `cargo xtask netlist`")
}

/// Both boards, started, and the host that may own them.
struct Bench {
    rig: Rig<Beside>,
    describe: Describe,
    token: u32,
    sequence: u32,
}

impl Bench {
    fn start(seed: u32, wrong: u16) -> Self {
        let (soc, firmware) = parts();
        let manifest = Manifest::read(&soc).unwrap_or_else(|error| panic!("{error}"));
        let load = |folder| Soc::load(folder, false).unwrap_or_else(|error| panic!("{error}"));
        let both = Beside {
            rtl: load(&soc),
            gates: load(&gates_folder()),
            seed,
            wrong,
            holding: 0,
            edges: 0,
            clock: 0,
        };
        let mut board = Board::new(both, manifest.sys_clk_hz, Plant::default());
        let (time, clockwork) = (board.time(), board.clockwork());
        let flash = || {
            let mut wires = Wires::new(Shared::new(Nor::new(Part::W25Q32JV, 0x0123_4567)));
            let time = time.clone();
            Box::new(move |cs_n, sck, mosi| {
                let ticks = time.load(Ordering::Relaxed) * clockwork.sys_period;
                wires.set(clockwork.picoseconds(ticks) / 1000, cs_n, sck, mosi)
            })
        };
        board.silicon().rtl.attach_spi(flash());
        board.silicon().gates.attach_spi(flash());
        board.reset(|both| {
            let image = Image::read(&firmware, both.rtl.rom_words())
                .unwrap_or_else(|error| panic!("{error}"));
            both.rtl.load_rom(&image.words);
            both.gates.load_rom(&image.words);
        });
        let mut rig = Rig::around(board, BOARD);
        rig.wait_ready(BOOT_CLOCKS)
            .unwrap_or_else(|error| panic!("{error}"));
        let describe = description(&mut rig);
        Bench {
            rig,
            describe,
            token: 0,
            sequence: 0,
        }
    }

    fn acquire(&mut self) {
        self.rig.write_words(map::SESSION_ACQUIRE, &[0x1234_5678]);
        let mut read = |address| self.rig.read_word(address).expect("an answer to a read");
        self.token = read(map::SESSION_TOKEN);
        self.sequence = read(map::SESSION_LAST_SEQ);
        assert_ne!(self.token, 0, "the session was not granted");
        // The watchdog bites after half a millisecond, the grace is as long.
        self.rig.write_words(map::CONFIG_BOARD, &[30_000, 30_000]);
    }

    fn exchange(&mut self, command: &mut Command) -> Status {
        self.sequence = self.sequence.wrapping_add(1);
        (command.token, command.sequence) = (self.token, self.sequence);
        let mut buffer = [0; wire::MAX_WORDS];
        let words = command.emit_request(self.describe.channels, &mut buffer);
        let bytes = to_bytes(words.expect("room for the request"));
        let reply = self
            .rig
            .exchange(&bytes)
            .expect("an answer to the exchange");
        Status::parse_reply(&to_words(&reply.payload), self.describe.channels)
            .unwrap_or_else(|error| panic!("the status block is malformed: {error}"))
    }

    /// Clocks in which two ports of a block RAM met at one address, by memory.
    fn collisions(&mut self) -> Vec<(String, u32)> {
        let counts = self.rig.board.silicon().gates.ram();
        let names = memories();
        assert_eq!(names.len(), counts.len());
        names
            .into_iter()
            .zip(counts)
            .filter(|(_, count)| *count != 0)
            .collect()
    }
}

/// Names of the netlist's block RAMs.
fn memories() -> Vec<String> {
    let text = std::fs::read(gates_folder().join("manifest.json")).expect("a manifest");
    let manifest: serde_json::Value = serde_json::from_slice(&text).expect("it is JSON");
    let names = manifest["memories"].as_array().expect("memories").iter();
    names
        .map(|name| name.as_str().unwrap_or_default().to_owned())
        .collect()
}

#[test]
fn the_netlist_boots_the_release_image_and_answers_as_the_rtl_does_clock_for_clock() {
    let (first, seeds) = (seed(), from_environment("FERROCNC_NETLIST_SEEDS", 1));
    let mut runs = Vec::new();
    for run in 0..seeds {
        let seed = first.wrapping_add(run);
        let mut random = Pcg32::seed_from_u64(seed);
        let mut bench = Bench::start(random.next_u32(), 0);
        story(&mut bench, &mut random);
        let (clocks, edges) = (bench.rig.clock(), bench.rig.board.silicon().edges);
        let (answered, met) = (bench.rig.frames.from_board, bench.collisions());
        println!(
            "seed {seed}: {clocks} clocks, {edges} edges alike, {answered} frames answered; ports of block RAM met: {met:?}"
        );
        runs.push(json!({
            "seed": seed, "clocks": clocks, "answered": answered, "met": by_group(&met),
        }));
    }
    let compared = json!({ "first_seed": first, "seeds": seeds, "runs": runs });
    report_part("netlist", "compared", compared);
}

/// Groups of memories, as docs/netlist.md has them, and what the names of each have in common.
const GROUPS: [(&str, &str); 5] = [
    ("registers", "RegFilePlugin"),
    ("caches", "Cache"),
    ("slots", "mem_"),
    ("mirror", "mirror"),
    ("sram_1", "sram_1"),
];

/// Clocks in which ports met, in a list for each group; a memory of no group has its own name.
fn by_group(met: &[(String, u32)]) -> BTreeMap<&str, Vec<u32>> {
    let mut groups = BTreeMap::new();
    for (name, clocks) in met {
        let group = GROUPS.iter().find(|(_, part)| name.contains(part));
        let group = group.map_or(name.as_str(), |(group, _)| group);
        groups.entry(group).or_insert_with(Vec::new).push(*clocks);
    }
    groups
}

#[test]
fn a_memory_with_a_wrong_bit_is_found() {
    let seed = seed();
    let names = memories();
    let mut found = BTreeMap::new();
    // The ROM, the stack, the processor's registers, a cache's tags, a receive slot and a transmit
    // slot.
    for wanted in [
        "rom_0.0.0",
        "sram_0.0.0",
        "RegFilePlugin_regFile.0.0",
        "dataCache_1.ways_0_tags.0.0",
        "mem_1.0.0",
        "mem_5.0.0",
    ] {
        let at = names.iter().position(|name| name.ends_with(wanted));
        let at = at.unwrap_or_else(|| panic!("there is no memory {wanted}: {names:?}")) as u16;
        let told = std::panic::catch_unwind(|| {
            let mut random = Pcg32::seed_from_u64(seed);
            let mut bench = Bench::start(random.next_u32(), at + 1);
            story(&mut bench, &mut random);
        });
        let told = told.expect_err("a board with a wrong bit is like one without");
        let text = told.downcast_ref::<String>().cloned().unwrap_or_default();
        assert!(
            text.contains("the netlist (left) is not the RTL"),
            "{wanted}: {text}"
        );
        let behind = text.split_once("after clock ").map(|(_, behind)| behind);
        let clock = behind.and_then(|behind| behind.split(',').next());
        let clock: u64 = clock.and_then(|clock| clock.parse().ok()).expect("a clock");
        found.insert(wanted, clock);
    }
    println!("a wrong bit is found after these clocks: {found:?}");
    report_part("netlist", "found_after_clocks", json!(found));
}

/// Exchanges, a bite, invalid frames, pings and a reset; the bench finds every difference on the
/// way.
fn story(bench: &mut Bench, random: &mut Pcg32) {
    bench.acquire();
    let mut command = Command {
        enable: true,
        stepgen_enable: u16::MAX,
        ..Command::default()
    };
    let mut status = bench.exchange(&mut command);
    for step in 0..8 {
        command.enable_request = step >= 2;
        command.gpio_out = random.next_u32().into();
        for pwm in &mut command.pwm {
            *pwm = PWM_ENABLE | random.random_range(0..1 << 16);
        }
        bench.rig.gpio_in(random.next_u32().into());
        status = bench.exchange(&mut command);
        bench.rig.run(random.random_range(0..4_000));
    }
    assert_eq!(status.state.state, State::Armed, "{:?}", status.state);
    assert_ne!(bench.rig.pins().gate, 0);
    // Frames of every length with random bytes, some to the board, some damaged, faster than they
    // are handled.
    for _ in 0..40 {
        let mut frame = vec![0; random.random_range(60..400)];
        random.fill_bytes(&mut frame);
        if random.random_bool(0.7) {
            let mac = bench.rig.segment.board_mac().expect("known since ARP");
            frame[..6].copy_from_slice(&mac);
            frame[12..14].copy_from_slice(&[8, 0]);
        }
        let mut wire = gmii::encode(&frame);
        if random.random_bool(0.2) {
            let at = random.random_range(8..wire.len());
            wire[at] ^= 1 << random.random_range(0..8);
        }
        bench.rig.inject_wire(wire);
    }
    // No command comes any more: the watchdog bites, the gate closes, the outputs are safe.
    bench.rig.run(100_000);
    assert_eq!(bench.rig.pins().gate, 0);
    // A guest waits for its ticket.
    let answered = (0..20).any(|_| bench.rig.ping().is_some());
    assert!(answered, "an answer to a ping");
    bench.rig.ext_reset(true);
    bench.rig.run(2_000);
    bench.rig.ext_reset(false);
    bench.rig.run(200_000);
    bench.acquire();
    let status = bench.exchange(&mut Command::default());
    assert_ne!(status.state.state, State::Armed);
}
