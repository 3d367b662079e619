//! Calls the Verilated SoC through its C ABI: pins in, pins out, one rising clock edge at a time;
//! and the bare cores in the same way.
//!
//! The only file of this crate with `unsafe`: it calls a shared library made by
//! `sim/verilator/build.sh`. It knows no frames and no time; [`crate::board`] does.

use std::ffi::{CString, c_char, c_int, c_void};
use std::path::{Path, PathBuf};

use libloading::Library;
use serde::Deserialize;

use crate::error::Error;

/// Version of [`Pins`] and of the functions below; equal to `ABI_VERSION` in `verilator/shim.cpp`.
const SHIM_ABI: u32 = 11;

/// Bit of the sys clock in [`Silicon::rise`].
pub const SYS: u32 = 1;
/// Bit of the 125 MHz Ethernet clock in [`Silicon::rise`].
pub const ETH: u32 = 2;

/// Every pin of the simulated board: inputs first, then outputs as they stand after the last clock
/// edge.
///
/// Field order and widths are those of `struct Pins` in `verilator/shim.cpp`.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Pins {
    /// In: levels at the general inputs, bit n = input n.
    pub gpio_in: u64,
    /// In, of an image: levels at the header lines from outside, bit n = line n. Where nothing
    /// drives, the card's pull-ups make 1 of a line.
    pub header_in: u64,
    /// In: encoder phase A, bit n = encoder n.
    pub enc_a: u16,
    /// In: encoder phase B.
    pub enc_b: u16,
    /// In: encoder index.
    pub enc_i: u16,
    /// In: index pins of the stepgens, bit n = stepgen n.
    pub step_index: u16,
    /// In: index masks of the encoders.
    pub enc_mask: u16,
    /// In: byte from the PHY.
    pub gmii_rx_data: u8,
    /// In: byte from the PHY is valid.
    pub gmii_rx_dv: u8,
    /// In: the external reset pin; high stops the machine.
    pub ext_reset: u8,
    /// In: high stops the CPU's clock and nothing else.
    pub cpu_freeze: u8,
    /// In: synchronous reset of the whole SoC.
    pub sys_rst: u8,
    /// In: the factory pin; high is active.
    pub factory: u8,
    /// In: what the PHY says of its link, see [`LINK_1000`].
    pub link_status: u8,
    /// In: what is wrong with the driven pads: [`crate::pads::Fault::put`].
    pub pad_fault: u8,
    /// In: at which of them.
    pub pad_at: u8,
    /// In: and which other.
    pub pad_to: u8,
    #[doc(hidden)]
    pub reserved_in: [u8; 4],
    /// Out: levels at the general outputs.
    pub gpio_out: u64,
    /// Out, of an image: levels of the header lines that the board drives, 0 of all others.
    pub header_out: u64,
    /// Out, of an image: which header lines the board drives.
    pub header_drives: u64,
    /// Out: STEP pins, bit n = stepgen n.
    pub step: u16,
    /// Out: DIR pins.
    pub dir: u16,
    /// Out: the inverted copies of STEP, for differential lines.
    pub step_n: u16,
    /// Out: the inverted copies of DIR.
    pub dir_n: u16,
    /// Out: first PWM pins.
    pub pwm_out: u16,
    /// Out: second PWM pins.
    pub pwm_dir: u16,
    /// Out: byte to the PHY.
    pub gmii_tx_data: u8,
    /// Out: byte to the PHY is valid.
    pub gmii_tx_en: u8,
    /// Out: the status LED.
    pub led: u8,
    /// Out: the output gate; 1 = outputs live.
    pub gate: u8,
    /// Out: chip select of the flash; low is selected.
    pub spi_cs_n: u8,
    /// Out: the flash's clock.
    pub spi_clk: u8,
    /// Out: data to the flash.
    pub spi_mosi: u8,
    #[doc(hidden)]
    pub reserved_out: [u8; 5],
}

const _: () = assert!(size_of::<Pins>() == 88);

/// [`Pins::link_status`]: bit 0 up, bits 2:1 the speed (0, 1, 2: 10, 100, 1000 Mbit/s), bit 3 full
/// duplex. A link at 1000.
pub const LINK_1000: u8 = 0b1101;

impl Default for Pins {
    /// Everything low, but the link is up and the header lines of an image are pulled up.
    fn default() -> Self {
        Pins {
            gpio_in: 0,
            header_in: u64::MAX,
            enc_a: 0,
            enc_b: 0,
            enc_i: 0,
            step_index: 0,
            enc_mask: 0,
            gmii_rx_data: 0,
            gmii_rx_dv: 0,
            ext_reset: 0,
            cpu_freeze: 0,
            sys_rst: 0,
            factory: 0,
            link_status: LINK_1000,
            pad_fault: 0,
            pad_at: 0,
            pad_to: 0,
            reserved_in: [0; 4],
            gpio_out: 0,
            header_out: 0,
            header_drives: 0,
            step: 0,
            dir: 0,
            step_n: 0,
            dir_n: 0,
            pwm_out: 0,
            pwm_dir: 0,
            gmii_tx_data: 0,
            gmii_tx_en: 0,
            led: 0,
            gate: 0,
            spi_cs_n: 0,
            spi_clk: 0,
            spi_mosi: 0,
            reserved_out: [0; 5],
        }
    }
}

impl Pins {
    /// The outputs of `other`.
    pub(crate) fn take_outputs(&mut self, other: &Pins) {
        let inputs = *self;
        *self = Pins {
            gpio_in: inputs.gpio_in,
            header_in: inputs.header_in,
            enc_a: inputs.enc_a,
            enc_b: inputs.enc_b,
            enc_i: inputs.enc_i,
            step_index: inputs.step_index,
            enc_mask: inputs.enc_mask,
            gmii_rx_data: inputs.gmii_rx_data,
            gmii_rx_dv: inputs.gmii_rx_dv,
            ext_reset: inputs.ext_reset,
            cpu_freeze: inputs.cpu_freeze,
            sys_rst: inputs.sys_rst,
            factory: inputs.factory,
            link_status: inputs.link_status,
            pad_fault: inputs.pad_fault,
            pad_at: inputs.pad_at,
            pad_to: inputs.pad_to,
            reserved_in: inputs.reserved_in,
            ..*other
        };
    }
}

/// Anything that behaves as the board's digital part at its pins: the Verilated SoC, or a few lines
/// of Rust in a test.
pub trait Silicon {
    /// One rising edge of the clocks in `clocks` ([`SYS`], [`ETH`] or both), with the inputs of
    /// `pins` stable before it; leaves the outputs in `pins`. `time_ps` is used by waveforms only.
    fn rise(&mut self, pins: &mut Pins, clocks: u32, time_ps: u64);

    /// Start writing waveforms to `file`.
    fn trace_open(&mut self, file: &Path) -> Result<(), Error> {
        Err(Error::NoTrace { path: file.into() })
    }

    /// Finish the waveform file.
    fn trace_close(&mut self) {}
}

/// What is wired to the headers of a card whose pins are configured ([`crate::plug`]).
pub trait Wiring: Send {
    /// What the gateware is to see: the levels of the lines, and whether the button is pressed.
    fn inside(&mut self, pins: &Pins) -> (u64, u8);

    /// Puts the levels of the lines that the board drives on the functions' pins. A line that is
    /// not driven shows 0.
    fn outside(&mut self, pins: &mut Pins);
}

/// What the gateware elaboration says about the SoC (`manifest.json`).
#[derive(Clone, Debug, Deserialize)]
pub struct Manifest {
    /// Frequency of the sys clock, Hz.
    pub sys_clk_hz: u64,
    /// Name of the board configuration.
    #[serde(default)]
    pub board: Option<String>,
}

impl Manifest {
    /// Read `manifest.json` of a SoC directory.
    pub fn read(soc_dir: &Path) -> Result<Self, Error> {
        let path = soc_dir.join("manifest.json");
        let text = std::fs::read(&path).map_err(|source| Error::Read {
            path: path.clone(),
            source,
        })?;
        serde_json::from_slice(&text).map_err(|source| Error::Manifest { path, source })
    }
}

type RiseFn = unsafe extern "C" fn(*mut c_void, *mut Pins, u32, u64);
type RomWriteFn = unsafe extern "C" fn(*mut c_void, u32, u32);
type WordsFn = unsafe extern "C" fn(*mut c_void) -> u32;
type SegmentsFn = unsafe extern "C" fn(*mut c_void) -> u64;
type SdramLinesFn = unsafe extern "C" fn(*mut c_void, u32, u32, u32) -> c_int;
type SdramTurnFn = unsafe extern "C" fn(*mut c_void, u32, u32) -> c_int;
type RamReadFn = unsafe extern "C" fn(*mut c_void, u32) -> u32;
type TraceOpenFn = unsafe extern "C" fn(*mut c_void, *const c_char) -> c_int;
type HandleFn = unsafe extern "C" fn(*mut c_void);
type SpiCallback = unsafe extern "C" fn(*mut c_void, u8, u8, u8) -> u8;
type OnSpiFn = unsafe extern "C" fn(*mut c_void, Option<SpiCallback>, *mut c_void);

/// What sits at the flash's wires. It is told every level of CS and SCK that is new, CS being
/// active low, and MOSI as it stands with it; what it returns is MISO from then on.
pub type SpiDevice = Box<dyn FnMut(bool, bool, bool) -> bool + Send>;

/// What the shim calls.
unsafe extern "C" fn on_spi(context: *mut c_void, cs_n: u8, sck: u8, mosi: u8) -> u8 {
    // SAFETY: `context` is the `SpiDevice` that `Soc::attach_spi` boxed; it lives until the shim
    // has forgotten it, and the shim calls only from within `fc_rise`, which nothing else runs
    // beside.
    let device = unsafe { &mut *context.cast::<SpiDevice>() };
    device(cs_n != 0, sck != 0, mosi != 0).into()
}

/// Shorted lines of the SDRAM, a bit for each.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct SdramLines {
    /// Of the data, to ground.
    pub data: u32,
    /// Of the data, to the supply.
    pub high: u32,
    /// Of a row's number, to ground. The highest of them low: the chip is one of half the size.
    pub row: u16,
}

/// A Verilated SoC: gateware, with the firmware in its ROM array.
pub struct Soc {
    handle: *mut c_void,
    rise: RiseFn,
    rom_write: RomWriteFn,
    rom_words: WordsFn,
    ram_words: WordsFn,
    pc: WordsFn,
    segments: SegmentsFn,
    sdram_lines: SdramLinesFn,
    sdram_turn: SdramTurnFn,
    ram_read: RamReadFn,
    trace_open: TraceOpenFn,
    trace_close: HandleFn,
    on_spi: OnSpiFn,
    free: HandleFn,
    path: PathBuf,
    wiring: Option<Box<dyn Wiring>>,
    // Boxed twice: the shim holds a thin pointer to the inner box.
    spi: Option<Box<SpiDevice>>,
    // Last: the code above lives in it.
    _library: Library,
}

impl std::fmt::Debug for Soc {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Soc")
            .field("path", &self.path)
            .finish_non_exhaustive()
    }
}

// SAFETY: the model has its own Verilator context and no thread-local state; it is used by one
// thread at a time (`&mut`).
unsafe impl Send for Soc {}

/// Loads a library that `build.sh` or `cores.sh` has made, of the ABI version that is expected; its
/// whole path.
fn open(path: PathBuf, version: &[u8], ours: u32) -> Result<(PathBuf, Library), Error> {
    // A bare name would be searched in system directories.
    let path = std::path::absolute(&path).unwrap_or(path);
    let err = |source| Error::Load {
        path: path.clone(),
        source,
    };
    // SAFETY: the library is ours; its initialisers are Verilator's and touch nothing outside it.
    // The version's function has this type in every version.
    let (library, theirs) = unsafe {
        let library = Library::new(&path).map_err(err)?;
        let theirs = library
            .get::<unsafe extern "C" fn() -> u32>(version)
            .map_err(err)?();
        (library, theirs)
    };
    if theirs != ours {
        return Err(Error::ShimAbi { path, theirs, ours });
    }
    Ok((path, library))
}

impl Soc {
    /// Load the SoC of `soc_dir`: the fast model, or with `trace` the slower one that can write
    /// waveforms.
    pub fn load(soc_dir: &Path, trace: bool) -> Result<Self, Error> {
        let name = if trace {
            "libferrocnc_soc_trace.so"
        } else {
            "libferrocnc_soc.so"
        };
        let (path, library) = open(soc_dir.join(name), b"fc_abi_version", SHIM_ABI)?;
        let err = |source| Error::Load {
            path: path.clone(),
            source,
        };
        // SAFETY: the symbols have the types given in shim.cpp, as the ABI version has confirmed.
        unsafe {
            let new = *library
                .get::<unsafe extern "C" fn() -> *mut c_void>(b"fc_new")
                .map_err(err)?;
            let soc = Soc {
                rise: *library.get(b"fc_rise").map_err(err)?,
                rom_write: *library.get(b"fc_rom_write").map_err(err)?,
                rom_words: *library.get(b"fc_rom_words").map_err(err)?,
                ram_words: *library.get(b"fc_ram_words").map_err(err)?,
                pc: *library.get(b"fc_pc").map_err(err)?,
                segments: *library.get(b"fc_segments").map_err(err)?,
                sdram_lines: *library.get(b"fc_sdram_lines").map_err(err)?,
                sdram_turn: *library.get(b"fc_sdram_turn").map_err(err)?,
                ram_read: *library.get(b"fc_ram_read").map_err(err)?,
                trace_open: *library.get(b"fc_trace_open").map_err(err)?,
                trace_close: *library.get(b"fc_trace_close").map_err(err)?,
                on_spi: *library.get(b"fc_on_spi").map_err(err)?,
                free: *library.get(b"fc_free").map_err(err)?,
                wiring: None,
                spi: None,
                handle: new(),
                path,
                _library: library,
            };
            Ok(soc)
        }
    }

    /// Words the ROM array holds.
    pub fn rom_words(&mut self) -> usize {
        // SAFETY: `handle` came from fc_new of the same library and is alive until drop. So below.
        unsafe { (self.rom_words)(self.handle) as usize }
    }

    /// Put `words` at the start of the ROM; what does not fit is an error of the caller
    /// ([`crate::firmware`] checks).
    ///
    /// The model runs its `initial` blocks (which may load the elaborated ROM) at the first clock
    /// edge, so call this after it. [`crate::board::Board::reset`] does.
    pub fn load_rom(&mut self, words: &[u32]) {
        let room = self.rom_words();
        for (i, word) in words.iter().enumerate().take(room) {
            // SAFETY: index within the array, see above.
            unsafe { (self.rom_write)(self.handle, i as u32, *word) }
        }
    }

    /// Put a device at the flash's wires; without one MISO is 1.
    pub fn attach_spi(&mut self, device: SpiDevice) {
        let device = self.spi.insert(Box::new(device));
        let context: *mut SpiDevice = &mut **device;
        // SAFETY: see `rom_words`; `context` stays where it is until it is replaced here or freed
        // after the handle.
        unsafe { (self.on_spi)(self.handle, Some(on_spi), context.cast()) }
    }

    /// Wires the headers of a card whose pins are configured; without it every line is pulled
    /// up.
    pub fn plug_in(&mut self, wiring: Box<dyn Wiring>) {
        self.wiring = Some(wiring);
    }

    /// Address of the instruction that left the CPU's pipeline with the last clock edge; `None` in
    /// a stall.
    pub fn pc(&mut self) -> Option<u32> {
        // SAFETY: see `rom_words`.
        let pc = unsafe { (self.pc)(self.handle) };
        (pc != u32::MAX).then_some(pc)
    }

    /// Segments of jobs begun since power-up, and those that wait; `None` on a board without jobs.
    pub fn segments(&mut self) -> Option<(u32, u8)> {
        // SAFETY: see `rom_words`.
        let both = unsafe { (self.segments)(self.handle) };
        (both != u64::MAX).then_some(((both >> 8) as u32, both as u8))
    }

    /// Shorts lines of the SDRAM from now on; false on a board without one. Call it after the first
    /// clock edge, as [`Soc::load_rom`].
    pub fn short_sdram(&mut self, lines: SdramLines) -> bool {
        // SAFETY: see `rom_words`.
        unsafe { (self.sdram_lines)(self.handle, lines.data, lines.row.into(), lines.high) == 0 }
    }

    /// Turns bits over in a word of the SDRAM, which the CPU's caches may still hold as it was;
    /// false if there is no such word.
    pub fn turn_sdram(&mut self, word: usize, bits: u32) -> bool {
        let index = u32::try_from(word).unwrap_or(u32::MAX);
        // SAFETY: see `rom_words`; the shim checks the index.
        unsafe { (self.sdram_turn)(self.handle, index, bits) == 0 }
    }

    /// The on-chip RAM as it stands; empty when the manifest does not name it. A write-back in the
    /// CPU's data cache may be missing (VexRiscv writes through, so it is not).
    pub fn ram(&mut self) -> Vec<u32> {
        // SAFETY: as above; indices within the count the model gives.
        unsafe {
            let n = (self.ram_words)(self.handle);
            (0..n).map(|i| (self.ram_read)(self.handle, i)).collect()
        }
    }
}

impl Silicon for Soc {
    #[inline]
    fn rise(&mut self, pins: &mut Pins, clocks: u32, time_ps: u64) {
        let Some(wiring) = &mut self.wiring else {
            // SAFETY: `pins` has the layout of the shim's struct and is borrowed for the call only.
            return unsafe { (self.rise)(self.handle, pins, clocks, time_ps) };
        };
        let factory = pins.factory;
        (pins.header_in, pins.factory) = wiring.inside(pins);
        // SAFETY: as above.
        unsafe { (self.rise)(self.handle, pins, clocks, time_ps) }
        pins.factory = factory;
        wiring.outside(pins);
    }

    fn trace_open(&mut self, file: &Path) -> Result<(), Error> {
        let bad = || Error::NoTrace {
            path: self.path.clone(),
        };
        let name = CString::new(file.as_os_str().as_encoded_bytes()).map_err(|_| bad())?;
        // SAFETY: `name` is a NUL-terminated string that outlives the call.
        match unsafe { (self.trace_open)(self.handle, name.as_ptr()) } {
            0 => Ok(()),
            _ => Err(bad()),
        }
    }

    fn trace_close(&mut self) {
        // SAFETY: see `rom_words`.
        unsafe { (self.trace_close)(self.handle) }
    }
}

impl Drop for Soc {
    fn drop(&mut self) {
        // SAFETY: last use of the handle; the library is still loaded (fields drop after this).
        unsafe {
            (self.trace_close)(self.handle);
            (self.free)(self.handle);
        }
    }
}

/// Version of [`CoresPins`]; equal to `ABI_VERSION` in `verilator/cores.cpp`.
const CORES_ABI: u32 = 5;

/// Pins and register bus of the bare cores, as `struct CoresPins` in `verilator/cores.cpp`.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct CoresPins {
    /// In: word address of a write.
    pub adr: u32,
    /// In: word address of a read, answered after the next edge.
    pub coming: u32,
    /// In: data of a write.
    pub dat_w: u32,
    /// In: the ABI number the map will have.
    pub abi: u32,
    /// In: general inputs.
    pub gpio_in: u64,
    /// In: a word of a frame.
    pub word: u32,
    /// In: encoder phase A.
    pub enc_a: u16,
    /// In: encoder phase B.
    pub enc_b: u16,
    /// In: encoder index.
    pub enc_i: u16,
    /// In: index pins of the stepgens.
    pub step_index: u16,
    /// In: index masks of the encoders.
    pub enc_mask: u16,
    /// In: this is a write.
    pub we: u8,
    /// In: system reset.
    pub rst: u8,
    /// In: the external reset pin.
    pub ext_reset: u8,
    /// In: a frame is complete.
    pub frame_done: u8,
    /// In: in this slot.
    pub frame_slot: u8,
    /// In: a frame is presented.
    pub frame_pending: u8,
    /// In: of this slot.
    pub pending_slot: u8,
    /// In: what is wrong with the driven pads, as in [`Pins`].
    pub pad_fault: u8,
    /// In: at which of them.
    pub pad_at: u8,
    /// In: and which other.
    pub pad_to: u8,
    /// In: the PHY's clock has made another beat.
    pub eth_beat: u8,
    /// In: from bit 0 the word passes, is the last, is whole, has a wrong FCS, has a slot.
    pub word_is: u8,
    /// In: the answer's slot can be sent.
    pub answer_free: u8,
    /// In: it is being sent.
    pub answer_sending: u8,
    /// Out: what was read.
    pub dat_r: u32,
    /// Out: general outputs.
    pub gpio_out: u64,
    /// Out, in front of the edge: a word of the answer.
    pub put: u32,
    /// Out: STEP.
    pub step: u16,
    /// Out: DIR.
    pub dir: u16,
    /// Out: inverted STEP.
    pub step_n: u16,
    /// Out: inverted DIR.
    pub dir_n: u16,
    /// Out: first PWM pins.
    pub pwm_out: u16,
    /// Out: second PWM pins.
    pub pwm_dir: u16,
    /// Out: length of the answer.
    pub length: u16,
    /// Out: the LED.
    pub led: u8,
    /// Out: the gate.
    pub gate: u8,
    /// Out, in front of the edge, from bit 0: the bus must wait, the frame is refused, it is
    /// executed; in the next clock it is executed, and the answer is sent; a word is put into it.
    pub frame: u8,
    /// Out: the number of that word.
    pub put_at: u8,
    #[doc(hidden)]
    pub reserved_out: [u8; 2],
}

const _: () = assert!(size_of::<CoresPins>() == 88);

type CoresRiseFn = unsafe extern "C" fn(*mut c_void, *mut CoresPins);

/// The Verilated cores of a board without CPU and MAC (`sim/verilator/cores.sh`).
pub struct Cores {
    handle: *mut c_void,
    rise: CoresRiseFn,
    free: HandleFn,
    // Last: the code above lives in it.
    _library: Library,
}

impl std::fmt::Debug for Cores {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Cores").finish_non_exhaustive()
    }
}

impl Cores {
    /// Load `libferrocnc_cores.so` of this folder.
    pub fn load(folder: &Path) -> Result<Self, Error> {
        let path = folder.join("libferrocnc_cores.so");
        let (path, library) = open(path, b"fc_cores_abi_version", CORES_ABI)?;
        let err = |source| Error::Load {
            path: path.clone(),
            source,
        };
        // SAFETY: the symbols have the types given in cores.cpp, as the ABI version has confirmed.
        unsafe {
            let new = *library
                .get::<unsafe extern "C" fn() -> *mut c_void>(b"fc_cores_new")
                .map_err(err)?;
            Ok(Cores {
                rise: *library.get(b"fc_cores_rise").map_err(err)?,
                free: *library.get(b"fc_cores_free").map_err(err)?,
                handle: new(),
                _library: library,
            })
        }
    }

    /// One rising edge.
    #[inline]
    pub fn rise(&mut self, pins: &mut CoresPins) {
        // SAFETY: `handle` came from fc_cores_new and is alive until drop; `pins` has the layout of
        // the shim's struct.
        unsafe { (self.rise)(self.handle, pins) }
    }
}

impl Drop for Cores {
    fn drop(&mut self) {
        // SAFETY: last use of the handle; the library is still loaded (fields drop after this).
        unsafe { (self.free)(self.handle) }
    }
}
