//! The only code that names the PAC: registers behind [`firmware::cores::Board`], the MAC's slots,
//! what survives a restart, and start-up.

mod clock;
mod hal;
mod jobs;
mod logger;
mod mac;
mod postmortem;
mod stack;

pub use jobs::load;
pub use mac::{Mac, RxFrame, TxSlot};
pub use postmortem::restart;
pub use stack::{check as check_stack, used as stack_used};

use crate::memory::Memory;
use core::ptr::{read_volatile, write_volatile};
use firmware::cores::{self, Board, Control, Gate, Ident, Led, Setting};
use firmware::machine::BLOB_MAX;
use firmware::thrift::divide;
use firmware::{log, postmortem as record, service};
use litex_pac::{Peripherals, abi};
use wire::describe::Channels;
use wire::map::{BoardConfig, StepgenConfig};

/// The register map this image was built for.
pub const ABI: u32 = abi::ABI;

// The lib has its own word numbers for two pages, because it must not depend on this crate.
const _: () = {
    assert!(abi::COMMAND_ENABLES == cores::STAGE_ENABLES);
    assert!(abi::COMMAND_GPIO_OUT == cores::STAGE_OUTPUTS);
    assert!(abi::COMMAND_ARMS == cores::STAGE_ARMS);
    assert!(abi::COMMAND_PROBE_ARMS == cores::STAGE_PROBE_ARMS);
    assert!(abi::COMMAND_STEPGEN == cores::STAGE_STEPGEN);
    assert!(abi::COMMAND_PWM == cores::STAGE_PWM);
    assert!(abi::STATUS_SAMPLE_LO == cores::LATCH_SAMPLE);
    assert!(abi::STATUS_GPIO_IN == cores::LATCH_INPUTS);
    assert!(abi::STATUS_STEPGEN == cores::LATCH_STEPGEN);
    assert!(abi::STATUS_ENCODER == cores::LATCH_ENCODER);
    assert!(abi::STATUS_ESTOP == cores::LATCH_ESTOP);
    assert!(abi::STATUS_FLAGS0 == cores::LATCH_INPUTS + 1);
    assert!(abi::STATUS_FLAGS1 == cores::LATCH_INPUTS + 2);
    assert!(abi::STATUS_FLAGS2 == cores::LATCH_INPUTS + 3);
    assert!(abi::STATUS_LATCH == cores::LATCH_LATCH);
    assert!(abi::STROBE_COMMIT == cores::STROBE_COMMIT);
    assert!(abi::STROBE_SAMPLE == cores::STROBE_SAMPLE);
    assert!(abi::STROBE_COMMIT_AT == cores::STROBE_COMMIT_AT);
    assert!(abi::CSR_BASE as u32 == wire::map::SERVICE);
    assert!(abi::CSR_GUEST == abi::CSR_BASE + service::PAGE_GUEST as usize * abi::CSR_PAGE);
    assert!(abi::TRAILER_MAGIC == wire::images::Trailer::MAGIC);
    assert!(abi::ROLE_IMAGE == wire::images::Role::Image as u32);
    assert!(abi::ROLE_GOLDEN == wire::images::Role::Golden as u32);
    assert!(abi::STEPGEN_MAX == wire::exchange::MAX_CHANNELS);
    assert!(abi::BOARD_ROM_SIZE <= BLOB_MAX);
};

/// What start-up found, for [`crate::app::App`].
pub struct Parts {
    /// Registers.
    pub soc: Soc,
    /// The MAC.
    pub mac: Mac,
    /// Buffers.
    pub memory: &'static mut Memory,
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

static mut MEMORY: Memory = Memory::new();

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
    stack::paint();
    let boot = postmortem::boot(soc.now_lo());
    let ident = soc.ident();
    // SAFETY: as above; this is the only reference to MEMORY.
    let memory = unsafe { &mut *(&raw mut MEMORY) };
    Parts {
        soc,
        mac: Mac::new(),
        memory,
        boot,
        ident,
    }
}

/// Milliseconds since power-up, for TCP's timers.
pub fn milliseconds(soc: &mut Soc) -> u32 {
    let per_ms = soc.p.ident.sys_clk_hz().read().bits() / 1000;
    divide(soc.now(), per_ms) as u32
}

fn blob_word(word: usize) -> u32 {
    if word >= abi::BOARD_ROM_SIZE / 4 {
        return 0;
    }
    // SAFETY: inside the ROM, aligned.
    unsafe { read_volatile((abi::BOARD_ROM_BASE as *const u32).add(word)) }
}

impl Soc {
    fn ident(&self) -> Ident {
        let ident = &self.p.ident;
        let channels0 = ident.channels0().read().bits();
        let channels1 = ident.channels1().read().bits();
        Ident {
            abi: if ident.magic().read().bits() == abi::IDENT_MAGIC {
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
    pub fn mac_errors(&self) -> [u32; 3] {
        let mac = &self.p.ethmac;
        [
            mac.sram_writer_errors().read().bits(),
            mac.rx_datapath_preamble_errors().read().bits(),
            mac.rx_datapath_crc_errors().read().bits(),
        ]
    }

    fn setting_address(which: Setting) -> usize {
        let (base, channel, word) = match which {
            Setting::Stepgen(n, field) => (abi::CSR_STEPGEN0, n, field as usize),
            Setting::PwmPeriod(n) => (abi::CSR_PWM0, n, 0),
            Setting::PwmMode(n) => (abi::CSR_PWM0, n, 1),
            Setting::EncoderMode(n) => (abi::CSR_ENCODER0, n, 0),
            Setting::EncoderFilter(n) => (abi::CSR_ENCODER0, n, 1),
            Setting::Board(BoardConfig::WatchdogTimeout) => (abi::CSR_WATCHDOG, 0, 0),
            Setting::Board(BoardConfig::WatchdogGrace) => (abi::CSR_WATCHDOG, 0, 1),
            Setting::Board(BoardConfig::GpioSafe) => (abi::CSR_GPIO, 0, 1),
            Setting::Board(BoardConfig::GpioInvert) => (abi::CSR_GPIO, 0, 2),
            Setting::Board(BoardConfig::Probe) => (abi::CSR_GPIO, 0, 7),
            Setting::Debounce(n) => (abi::CSR_DEBOUNCE, 0, usize::from(n)),
        };
        base + usize::from(channel) * abi::CSR_PAGE + word * 4
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
        unsafe { read_volatile(abi::ROM_TRAILER as *const [u32; 4]) }
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
        // SAFETY: the lib counts words of the command page, with the layout asserted above; no
        // register follows it.
        unsafe { write_volatile((abi::CSR_COMMAND as *mut u32).add(word), value) }
    }

    #[inline(always)]
    fn staged(&mut self, word: usize) -> u32 {
        // SAFETY: as in `stage`; a read has no side effect.
        unsafe { read_volatile((abi::CSR_COMMAND as *const u32).add(word)) }
    }

    #[inline(always)]
    fn latched(&mut self, word: usize) -> u32 {
        // SAFETY: as in `stage`, for the status page; a read has no side effect.
        unsafe { read_volatile((abi::CSR_STATUS as *const u32).add(word)) }
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

    #[inline(always)]
    fn gate(&mut self) -> Gate {
        Gate(self.p.watchdog.status().read().bits())
    }

    fn last_close(&mut self) -> u32 {
        self.p.watchdog.last_close().read().bits()
    }

    fn control(&mut self, order: Control) {
        let key = match order {
            Control::Arm => abi::KEY_ARM,
            Control::SoftStop => abi::KEY_SOFT,
            Control::Close => abi::KEY_STOP,
            Control::Clear => abi::KEY_CLEAR,
        };
        self.p.watchdog.control().write(|w| unsafe { w.bits(key) });
    }

    fn setting(&mut self, which: Setting) -> u32 {
        // SAFETY: a register of the map, aligned; a read has no side effect.
        unsafe { read_volatile(Self::setting_address(which) as *const u32) }
    }

    fn set(&mut self, which: Setting, value: u32) {
        // SAFETY: a register of the map, aligned; the lib checked the value.
        unsafe { write_volatile(Self::setting_address(which) as *mut u32, value) }
    }

    #[inline(always)]
    fn set_stop_accel(&mut self, stepgen: usize, value: u32) {
        let at =
            abi::CSR_STEPGEN0 + stepgen * abi::CSR_PAGE + 4 * StepgenConfig::StopAccel as usize;
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
}
