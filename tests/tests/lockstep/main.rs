//! The cores in Verilog against their models in Rust, clock by clock, under random stimulus: every
//! output pin, every register as the bus reads it, and what is said to the MAC. Firmware's writes
//! and an owner's frames let the fast path execute commands.
//!
//! Run as `cargo test --profile tests -p ferrocnc-tests --test lockstep` after
//! `sim/verilator/cores.sh mill6`.
//!
//! | variable | meaning | default |
//! |---|---|---|
//! | `FERROCNC_CORES` | folder of `libferrocnc_cores.so`, as `sim/verilator/cores.sh` leaves it | `target/sim/cores-wide` |
//! | `FERROCNC_CORES_BOARD` | the board it was made of | `wide` |
//! | `FERROCNC_CLOCKS` | clocks to compare, in all | 12000000 |
//! | `FERROCNC_SEED` | seed; printed | from the clock |
//!
//! The clocks are split over two threads with a seed each. The events of each core are counted, and
//! a run with too few of them fails. `target/reports/lockstep.json` has the figures.

mod events;
mod stimulus;

use events::{EventCounts, LEAST_PER_MILLION};
use ferrocnc_tests::{from_environment, root, seed};
use sim::board_facts::BoardFacts;
use sim::model::Board;
use sim::model::board::{Build, Bus, pages};
use sim::model::fast_path::Output;
use sim::model::rx_admission::Word;
use sim::soc::{Cores, CoresPins, Pins};
use std::collections::BTreeMap;
use std::path::PathBuf;
use stimulus::Stimulus;
use wire::regmap::watchdog;

/// As `cores.cpp` numbers them.
fn told_to_the_mac(does: &Output, refuses: bool) -> u8 {
    let all = [
        does.hold,
        refuses,
        does.take,
        does.taken,
        does.taken,
        does.puts.is_some(),
    ];
    all.iter()
        .rev()
        .fold(0, |bits, on| bits << 1 | u8::from(*on))
}

fn flags(word: &Word) -> u8 {
    let all = [true, word.last, word.whole, word.bad, word.room];
    all.iter()
        .rev()
        .fold(0, |bits, on| bits << 1 | u8::from(*on))
}

/// Puts this on the cores' inputs.
fn put(pins: &mut CoresPins, s: &Pins, bus: &Bus, coming: u32) {
    pins.coming = coming;
    pins.we = bus.write.is_some().into();
    (pins.adr, pins.dat_w) = bus.write.unwrap_or_default();
    pins.rst = bus.rst.into();
    (pins.word, pins.word_is) = bus.word.map_or((0, 0), |word| (word.data, flags(&word)));
    pins.eth_beat = bus.beat.into();
    (pins.pad_fault, pins.pad_at, pins.pad_to) = (s.pad_fault, s.pad_at, s.pad_to);
    (pins.frame_done, pins.frame_slot) = bus.frame_done.map_or((0, 0), |slot| (1, slot));
    (pins.frame_pending, pins.pending_slot) = bus.frame_pending.map_or((0, 0), |slot| (1, slot));
    (pins.gpio_in, pins.ext_reset) = (s.gpio_in, s.ext_reset);
    (pins.enc_a, pins.enc_b, pins.enc_i) = (s.enc_a, s.enc_b, s.enc_i);
    (pins.step_index, pins.enc_mask) = (s.step_index, s.enc_mask);
}

/// Gateware and model drive the same.
fn same_pins(clock: u64, seed: u64, pins: &CoresPins, m: &Pins) {
    let theirs = (
        pins.step,
        pins.dir,
        pins.step_n,
        pins.dir_n,
        pins.pwm_out,
        pins.pwm_dir,
        pins.gpio_out,
        pins.led,
        pins.gate,
    );
    let ours = (
        m.step, m.dir, m.step_n, m.dir_n, m.pwm_out, m.pwm_dir, m.gpio_out, m.led, m.gate,
    );
    assert!(
        theirs == ours,
        "clock {clock}, seed {seed}: pins (step, dir, step_n, dir_n, pwm, pwm_dir, gpio, led, gate)\n  \
         gateware {theirs:x?}\n  model    {ours:x?}"
    );
}

struct Run {
    seed: u64,
    clocks: u64,
    reads: u64,
    seconds: f64,
    events: EventCounts,
    counts: [u64; 2],
}

/// The board that the cores were made of.
fn build(facts: &BoardFacts) -> Build {
    Build {
        channels: facts.channels,
        clock_hz: facts.clock_hz,
        estop_mask: facts.estop_mask,
        estop_level: facts.estop_level,
        abi: 0x1234_5678,
        version: 0x00_0100,
        rom_words: facts.words().len() as u32,
        jobs: 0,
        readback: true,
    }
}

fn run(seed: u64, clocks: u64) -> Run {
    let folder: PathBuf = from_environment("FERROCNC_CORES", root().join("target/sim/cores-wide"));
    let name: String = from_environment("FERROCNC_CORES_BOARD", "wide".into());
    let facts = BoardFacts::named(&name).unwrap_or_else(|error| panic!("{error}"));
    let mut cores = Cores::load(&folder).unwrap_or_else(|error| panic!("{error}"));
    let mut board = Board::new(build(&facts));
    let started = std::time::Instant::now();
    let mut stimulus = Stimulus::new(seed, &facts);
    let mut pins = CoresPins {
        abi: 0x1234_5678,
        ..CoresPins::default()
    };
    let mut events = EventCounts::default();
    let (mut reads, mut travelled) = (0, [0u64; 2]);
    let mut counts_were = [0i32; 32];
    // What the bus master reads in the next clock.
    let mut coming = 0;
    for clock in 0..clocks {
        stimulus.move_pins();
        let (free, sending) = stimulus.line();
        board.line(free, sending);
        let mut bus = stimulus.mac(board.peek(pages::WATCHDOG, watchdog::STATUS as u32));
        let (does, refuses) = board.frames(&bus);
        bus.write = stimulus.write_now(does.hold);
        let address = core::mem::replace(&mut coming, stimulus.read_at());
        if does.taken {
            stimulus.sending = 100;
        }
        // What the fast path reads, the bus master reads.
        let address = match does.gathers {
            Some(from) => (8 + (from >> 7)) << 9 | from & 0x7f,
            None => address,
        };
        let told = told_to_the_mac(&does, refuses);
        put(&mut pins, &stimulus.pins, &bus, coming);
        (pins.answer_free, pins.answer_sending) = (free.into(), sending.into());

        let expected = board.peek(address >> 9, address & 0x1ff);
        let (put, length) = (board.gathered(), board.answer_length());
        board.drive(&stimulus.pins);
        board.clock(&bus);
        cores.rise(&mut pins);
        reads += 1;

        let m = board.driven();
        same_pins(clock, seed, &pins, m);
        assert!(
            pins.dat_r == expected,
            "clock {clock}, seed {seed}: register page {} word {}: gateware {:#x}, model {expected:#x}",
            address >> 9,
            address & 0x1ff,
            pins.dat_r
        );
        assert!(
            pins.frame == told && usize::from(pins.length) == length,
            "clock {clock}, seed {seed}: to the MAC (hold, refuse, take, taken, send, puts): \
             gateware {:06b}, model {told:06b}; length {} and {length}",
            pins.frame,
            pins.length
        );
        if let Some(at) = does.puts {
            assert!(
                (usize::from(pins.put_at), pins.put) == (at, put),
                "clock {clock}, seed {seed}: word {} of the answer: gateware {:#x}, model {put:#x} at {at}",
                pins.put_at,
                pins.put
            );
        }
        events.frames(&does, &bus, refuses);
        events.clock(m);
        events.add(
            "pads: clocks with a short",
            u32::from(stimulus.pins.pad_fault != 0),
        );
        if clock % 256 == 0 {
            events.look(&board);
            for (n, was) in counts_were.iter_mut().enumerate() {
                let word = if n < 16 { 9 + 3 * n } else { 56 + 2 * (n - 16) };
                let now = board.status(word) as i32;
                travelled[n / 16] += u64::from(now.wrapping_sub(*was).unsigned_abs());
                *was = now;
            }
        }
    }
    Run {
        seed,
        clocks,
        reads,
        seconds: started.elapsed().as_secs_f64(),
        events,
        counts: travelled,
    }
}

#[test]
fn gateware_and_models_agree_on_every_pin_and_register_in_every_clock() {
    let clocks: u64 = from_environment("FERROCNC_CLOCKS", 12_000_000);
    let seed = seed();
    // Verilated models and ours are one-threaded: two of each use two cores.
    let halves = [seed, seed ^ 0x5eed_0000_0001]
        .map(|seed| std::thread::spawn(move || run(seed, clocks / 2)));
    let runs = halves.map(|half| match half.join() {
        Ok(run) => run,
        Err(panic) => std::panic::resume_unwind(panic),
    });
    let mut happened: BTreeMap<&str, u64> = BTreeMap::new();
    for run in &runs {
        for (what, n) in &run.events.counts {
            *happened.entry(what).or_default() += n;
        }
        *happened.entry("stepgen: pulses counted").or_default() += run.counts[0];
        *happened.entry("encoder: counts").or_default() += run.counts[1];
        println!(
            "seed {}: {} clocks, {} registers read, {:.0} kclk/s, no difference",
            run.seed,
            run.clocks,
            run.reads,
            run.clocks as f64 / run.seconds / 1e3
        );
    }
    for (what, n) in &happened {
        println!("  {what}: {n}");
    }
    let report = serde_json::json!({
        "clocks": runs.iter().map(|run| run.clocks).sum::<u64>(),
        "registers_read": runs.iter().map(|run| run.reads).sum::<u64>(),
        "differences": 0,
        "seeds": runs.iter().map(|run| run.seed).collect::<Vec<_>>(),
        "kclocks_per_second": runs.iter().map(|run| run.clocks as f64 / run.seconds / 1e3).sum::<f64>().round(),
        "happened": happened,
    });
    let folder = root().join("target/reports");
    std::fs::create_dir_all(&folder).expect("a folder for the report");
    let text = serde_json::to_string_pretty(&report).expect("JSON");
    std::fs::write(folder.join("lockstep.json"), text + "\n").expect("the report");
    let millions = clocks / 1_000_000;
    for (what, least) in LEAST_PER_MILLION {
        let n = happened.get(what).copied().unwrap_or(0);
        assert!(
            n >= least * millions,
            "{what}: {n} in {clocks} clocks, wanted {}",
            least * millions
        );
    }
}
