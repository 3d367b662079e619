//! Registers behind [`firmware::cores::Board`], the MAC's slots, what survives a restart, and
//! start-up.

mod clock;
mod hal;
mod logger;
mod mac;
mod postmortem;
mod services;
mod stack;

pub use mac::{Mac, RxFrame, answered};
pub use postmortem::{last_trap, restart};
pub use services::{Loader, call as call_services, patrol, theirs, watch as watch_services};
pub use stack::{check as check_stack, used as stack_used};

use core::ptr::{read_volatile, write_volatile};
use firmware::cores::{self, Board, Control, Gate, Ident, Led, Setting};
use firmware::pass::Pass;
use firmware::{log, postmortem as record};
use litex_pac::Peripherals;
use wire::describe::Channels;
use wire::regmap::{self, command, status, stepgen};

/// The register map this image was built for.
pub const ABI: u32 = regmap::ABI;

/// What start-up found, for [`crate::app::App`].
pub struct Parts {
    /// Registers.
    pub soc: Soc,
    /// The MAC.
    pub mac: Mac,
    /// Boot id, and the reason of this start.
    pub boot: record::Boot,
    /// The gateware's identity.
    pub ident: Ident,
}

/// The registers.
pub struct Soc {
    p: Peripherals,
    spi: hal::FlashSpi,
}

/// Brings the machine into a safe state, then reads the board's identity. Called once, before
/// anything else.
pub fn start() -> Parts {
    // SAFETY: called once, from the entry point, before any other code runs; the panic handler and
    // the trap handler steal what they need again, and never return.
    let mut soc = Soc {
        p: unsafe { Peripherals::steal() },
        spi: hal::FlashSpi::new(unsafe { litex_pac::Flash::steal() }),
    };
    soc.control(Control::Close);
    // A pass that a crash left behind.
    soc.revoke();
    stack::paint();
    let boot = postmortem::boot(soc.now_lo());
    let ident = soc.ident();
    Parts {
        soc,
        mac: Mac::new(),
        boot,
        ident,
    }
}

fn blob_word(word: usize) -> u32 {
    if word >= regmap::BOARD_ROM_SIZE / 4 {
        return 0;
    }
    // SAFETY: inside the ROM, aligned.
    unsafe { read_volatile((regmap::BOARD_ROM_BASE as *const u32).add(word)) }
}

impl Soc {
    fn ident(&self) -> Ident {
        let ident = &self.p.ident;
        let channels0 = ident.channels0().read().bits();
        let channels1 = ident.channels1().read().bits();
        Ident {
            abi: if ident.magic().read().bits() == regmap::IDENT_MAGIC {
                ident.abi().read().bits()
            } else {
                !ABI
            },
            version: ident.gateware_version().read().bits(),
            clock_hz: ident.sys_clk_hz().read().bits(),
            // Impossible counts: describe no channels, so that no host drives them.
            channels: Channels::from_words(channels0, channels1).unwrap_or_default(),
            features: ident.features().read().bits(),
            blob_words: ident.board_rom_words().read().bits(),
        }
    }

    /// Frames dropped: no slot free, wrong preamble, wrong CRC.
    #[inline(always)]
    fn mac_errors(&self) -> [u32; 3] {
        let mac = &self.p.ethmac;
        [
            mac.sram_writer_errors().read().bits(),
            mac.rx_datapath_preamble_errors().read().bits(),
            mac.rx_datapath_crc_errors().read().bits(),
        ]
    }
}

impl Board for Soc {
    type Spi = hal::FlashSpi;

    fn spi(&mut self) -> &mut hal::FlashSpi {
        &mut self.spi
    }

    fn trailer(&mut self) -> [u32; 4] {
        // SAFETY: the last words of the ROM, aligned; the linker does not use them, so the compiler
        // cannot know their values.
        unsafe { read_volatile(regmap::ROM_TRAILER as *const [u32; 4]) }
    }

    fn factory_pin(&mut self) -> bool {
        self.spi.factory_pin()
    }

    #[inline(always)]
    fn link(&mut self) -> cores::Link {
        let [slots, preamble, crc] = self.mac_errors();
        cores::Link {
            status: self.p.ethphy.rx_inband_status().read().bits(),
            errors: slots.wrapping_add(preamble).wrapping_add(crc),
        }
    }

    fn now(&mut self) -> u64 {
        let lo = self.now_lo();
        u64::from(self.p.timebase.now_hi().read().bits()) << 32 | u64::from(lo)
    }

    #[inline(always)]
    fn now_lo(&mut self) -> u32 {
        self.p.timebase.snapshot().write(|w| unsafe { w.bits(1) });
        self.p.timebase.now_lo().read().bits()
    }

    #[inline(always)]
    fn arrival_lo(&mut self) -> u32 {
        self.p.timebase.arrival_lo().read().bits()
    }

    #[inline(always)]
    fn arrival_hi(&mut self) -> u32 {
        self.p.timebase.arrival_hi().read().bits()
    }

    #[inline(always)]
    fn stage(&mut self, word: usize, value: u32) {
        // SAFETY: the lib counts words of the command page; no register follows it.
        unsafe { write_volatile((command::BASE as *mut u32).add(word), value) }
    }

    #[inline(always)]
    fn staged(&mut self, word: usize) -> u32 {
        // SAFETY: as in `stage`; a read has no side effect.
        unsafe { read_volatile((command::BASE as *const u32).add(word)) }
    }

    #[inline(always)]
    fn latched(&mut self, word: usize) -> u32 {
        // SAFETY: as in `stage`, for the status page; a read has no side effect.
        unsafe { read_volatile((status::BASE as *const u32).add(word)) }
    }

    fn commit_at(&mut self, at: u64) {
        let timebase = &self.p.timebase;
        // Set to "never" first, so that no mixture of an old and a new time can be due.
        timebase
            .commit_at_hi()
            .write(|w| unsafe { w.bits(u32::MAX) });
        timebase
            .commit_at_lo()
            .write(|w| unsafe { w.bits(at as u32) });
        timebase
            .commit_at_hi()
            .write(|w| unsafe { w.bits((at >> 32) as u32) });
    }

    #[inline(always)]
    fn strobe(&mut self, strobes: u32) {
        self.p
            .timebase
            .strobe()
            .write(|w| unsafe { w.bits(strobes) });
    }

    #[inline(always)]
    fn watchdog_left(&mut self) -> u32 {
        self.p.watchdog.remaining().read().bits()
    }

    #[inline(always)]
    fn feed(&mut self, token: u32) {
        self.p.watchdog.token().write(|w| unsafe { w.bits(token) });
    }

    fn hand_out(&mut self, pass: &Pass) {
        mac::hand_out(pass);
    }

    fn revoke(&mut self) -> bool {
        mac::revoke()
    }

    #[inline(always)]
    fn executed(&mut self) -> bool {
        mac::executed()
    }

    fn sending(&mut self) -> bool {
        mac::sending()
    }

    #[inline(always)]
    fn gate(&mut self) -> Gate {
        Gate(self.p.watchdog.status().read().bits())
    }

    fn last_close(&mut self) -> u32 {
        self.p.watchdog.last_close().read().bits()
    }

    fn control(&mut self, order: Control) {
        self.p
            .watchdog
            .control()
            .write(|w| unsafe { w.bits(order.key()) });
    }

    fn setting(&mut self, which: Setting) -> u32 {
        // SAFETY: a register of the map, aligned; a read has no side effect.
        unsafe { read_volatile(which.address() as *const u32) }
    }

    fn set(&mut self, which: Setting, value: u32) {
        // SAFETY: a register of the map, aligned; the lib checked the value.
        unsafe { write_volatile(which.address() as *mut u32, value) }
    }

    #[inline(always)]
    fn set_stop_accel(&mut self, stepgen: usize, value: u32) {
        let at = stepgen::BASE + stepgen * regmap::CSR_PAGE + 4 * stepgen::STOP_ACCEL;
        // SAFETY: a register of the map, aligned; the lib counts the board's stepgens.
        unsafe { write_volatile(at as *mut u32, value) }
    }

    fn csr_read(&mut self, address: u32) -> u32 {
        // SAFETY: `service::readable` said this is a register page, where every word can be read.
        unsafe { read_volatile(address as usize as *const u32) }
    }

    fn csr_write(&mut self, address: u32, value: u32) {
        // SAFETY: `service::check_write` allowed this write for this sender.
        unsafe { write_volatile(address as usize as *mut u32, value) }
    }

    fn blob(&mut self, word: usize) -> u32 {
        blob_word(word)
    }

    fn describe(&mut self, word: usize, value: u32) {
        // SAFETY: aligned; the lib has checked the length of the description. Boards whose pins are
        // configured have a RAM there.
        unsafe { write_volatile((regmap::BOARD_ROM_BASE as *mut u32).add(word), value) }
    }

    fn led(&mut self, pattern: Led) {
        hal::StatusLed::new(&self.p.led).show(pattern);
    }

    fn log(&mut self, read: log::Read) -> u32 {
        logger::read(read)
    }

    fn panic(&mut self, offset: u32) -> u32 {
        postmortem::word(offset)
    }

    fn rename_boot(&mut self, seed: u32) -> u32 {
        postmortem::rename(seed)
    }

    fn stack(&mut self, part: u32) -> Option<(u32, u32)> {
        stack_used(part)
    }
}
