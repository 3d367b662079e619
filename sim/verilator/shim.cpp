// A Verilated SoC behind a small C ABI.
//
// It knows clocks, pins, the firmware ROM and the waveform file. It knows no frames, no time modes
// and no boards: those live in Rust (sim/src), which loads the library made from this file at run
// time, so that building the Rust side needs no FPGA tool. `Pins` is mirrored by `sim/src/soc.rs`;
// change both, and ABI_VERSION with them.
//
// build.sh names the model Vsoc and defines: FC_MODEL (class), FC_HEADER, FC_ROOT_HEADER, FC_ROM
// and FC_RAM (arrays of `root`, one after the other; there may be no RAM), FC_PC and FC_PC_VALID
// (optional), FC_BEGUN and FC_LEVEL (optional), FC_DATA_LOW, FC_DATA_HIGH, FC_ROW_LOW and FC_SDRAM
// (optional), FC_CLOCKS with a generated fc_clocks.h (Verilator's memory of each clock's last
// level), FC_TRACE_FST or FC_TRACE_VCD.

#include <cstddef>
#include <cstdint>
#include <cstdio>
#include <cstring>
#include <memory>

#include "verilated.h"

#include FC_HEADER
#include FC_ROOT_HEADER
#if defined(FC_CLOCKS)
#include "fc_clocks.h"
#endif
#if defined(FC_TRACE_FST)
#include "verilated_fst_c.h"
using Trace = VerilatedFstC;
#elif defined(FC_TRACE_VCD)
#include "verilated_vcd_c.h"
using Trace = VerilatedVcdC;
#endif

#if defined(FC_CLOCKS)
// Steps of Verilator's own eval(), which shim.cpp calls one by one where it can leave some out.
bool Vsoc___024root___eval_phase__act(Vsoc___024root*);
bool Vsoc___024root___eval_phase__nba(Vsoc___024root*);
#endif

namespace {
constexpr uint32_t ABI_VERSION = 11;
constexpr uint32_t SYS = 1, ETH = 2;

struct Pins {
    // in
    uint64_t gpio_in, header_in;
    uint16_t enc_a, enc_b, enc_i, step_index, enc_mask;
    uint8_t gmii_rx_data, gmii_rx_dv;
    uint8_t ext_reset, cpu_freeze, sys_rst, factory, link_status, pad_fault, pad_at, pad_to, reserved_in[4];
    // out
    uint64_t gpio_out, header_out, header_drives;
    uint16_t step, dir, step_n, dir_n, pwm_out, pwm_dir;
    uint8_t gmii_tx_data, gmii_tx_en;
    uint8_t led, gate;
    uint8_t spi_cs_n, spi_clk, spi_mosi, reserved_out[5];
};
static_assert(sizeof(Pins) == 88, "mirrored in sim/src/soc.rs");

// A memory that is several arrays, one after the other: how many words, and the one at `index`.
template <typename... Arrays> uint32_t words_of(Arrays&... arrays) {
    return static_cast<uint32_t>((sizeof(arrays) + ... + 0) / 4);
}

template <typename... Arrays> uint32_t* word_of(uint32_t index, Arrays&... arrays) {
    uint32_t* found = nullptr;
    uint32_t first = 0;
    auto look = [&](auto& array) {
        const auto words = static_cast<uint32_t>(sizeof(array) / 4);
        if (index >= first && index < first + words) found = &array[index - first];
        first += words;
    };
    (look(arrays), ...);
    return found;
}

// What sits at the flash's wires: told every level of CS and SCK that is new, with MOSI as it
// stands; answers with MISO's.
using OnSpi = uint8_t (*)(void* context, uint8_t cs_n, uint8_t sck, uint8_t mosi);

struct Soc {
    VerilatedContext context;
    std::unique_ptr<FC_MODEL> model;
    Pins driven{};        // inputs of the last full evaluation
    bool settled = false; // there was one
    OnSpi on_spi = nullptr;
    void* spi_context = nullptr;
    uint8_t spi_cs_n = 1, spi_clk = 0;  // as last told
    uint8_t spi_miso = 1, driven_miso = 1;  // undriven: pulled up
#if defined(FC_TRACE_FST) || defined(FC_TRACE_VCD)
    std::unique_ptr<Trace> trace;
#endif

    Soc() {
        context.randReset(0);
#if defined(FC_TRACE_FST) || defined(FC_TRACE_VCD)
        context.traceEverOn(true);
#endif
        model = std::make_unique<FC_MODEL>(&context, "soc");
    }

    // A scope asks the thread for the context to leave, which is that of the model made last, and
    // that one may be gone.
    ~Soc() {
        Verilated::threadContextp(&context);
        model.reset();
    }

    bool tracing() const {
#if defined(FC_TRACE_FST) || defined(FC_TRACE_VCD)
        return trace && trace->isOpen();
#else
        return false;
#endif
    }

    void dump(uint64_t time_ps) {
#if defined(FC_TRACE_FST) || defined(FC_TRACE_VCD)
        if (tracing()) trace->dump(time_ps);
#else
        (void)time_ps;
#endif
    }

    void drive(const Pins& p) {
        FC_MODEL& m = *model;
        m.gpio_in = p.gpio_in;
        m.header_in = p.header_in;
        m.enc_a = p.enc_a;
        m.enc_b = p.enc_b;
        m.enc_i = p.enc_i;
        m.step_index = p.step_index;
        m.enc_mask = p.enc_mask;
        m.gmii_rx_data = p.gmii_rx_data;
        m.gmii_rx_dv = p.gmii_rx_dv;
        m.ext_reset = p.ext_reset;
        m.cpu_freeze = p.cpu_freeze;
        m.sys_rst = p.sys_rst;
        m.factory = p.factory;
        m.link_status = p.link_status;
        m.pad_fault = p.pad_fault;
        m.pad_at = p.pad_at;
        m.pad_to = p.pad_to;
        m.spi_miso = driven_miso = spi_miso;
    }

    void sample(Pins& p) {
        FC_MODEL& m = *model;
        p.gpio_out = m.gpio_out;
        p.header_out = m.header_out;
        p.header_drives = m.header_drives;
        p.step = m.step;
        p.dir = m.dir;
        p.step_n = m.step_n;
        p.dir_n = m.dir_n;
        p.pwm_out = m.pwm_out;
        p.pwm_dir = m.pwm_dir;
        p.gmii_tx_data = m.gmii_tx_data;
        p.gmii_tx_en = m.gmii_tx_en;
        p.led = m.led;
        p.gate = m.gate;
        p.spi_cs_n = m.spi_cs_n;
        p.spi_clk = m.spi_clk;
        p.spi_mosi = m.spi_mosi;
        if (on_spi && (spi_cs_n != m.spi_cs_n || spi_clk != m.spi_clk)) {
            spi_cs_n = m.spi_cs_n;
            spi_clk = m.spi_clk;
            spi_miso = on_spi(spi_context, m.spi_cs_n, m.spi_clk, m.spi_mosi) & 1;
        }
    }
};
}  // namespace

extern "C" {

uint32_t fc_abi_version() { return ABI_VERSION; }

void* fc_new() { return new Soc(); }

void fc_free(void* soc) { delete static_cast<Soc*>(soc); }

// One rising edge of the clocks named in `clocks` (bit 0 sys, bit 1 eth), at time_ps.
//
// Nothing in the SoC listens to a falling edge, so a clock's way down needs no evaluation of its
// own: it is folded into the next call (or, where build.sh found Verilator's memory of the clock
// level, that memory is set to low). The waveform build draws both edges properly.
void fc_rise(void* handle, Pins* pins, uint32_t clocks, uint64_t time_ps) {
    Soc& soc = *static_cast<Soc*>(handle);
    FC_MODEL& m = *soc.model;
    if (soc.tracing()) {
        // Falls of this same set first, a picosecond's grace before the rise.
        if (clocks & SYS) m.sys_clk = 0;
        if (clocks & ETH) m.eth_clk = 0;
        m.eval();
        soc.dump(time_ps - 1);
        soc.drive(*pins);
        if (clocks & SYS) m.sys_clk = 1;
        if (clocks & ETH) m.eth_clk = 1;
        m.eval();
        soc.dump(time_ps);
        soc.sample(*pins);
        return;
    }
#if defined(FC_CLOCKS)
    auto* root = m.rootp;
    if (clocks & SYS) {
        m.sys_clk = 1;
        FC_SYS_LOW(root)
    }
    if (clocks & ETH) {
        m.eth_clk = 1;
        FC_ETH_LOW(root)
    }
    // cpu_freeze gates a clock that we keep high: moved between sys edges it would make an edge of
    // its own.
    Pins in = *pins;
    if (soc.settled && !(clocks & SYS)) in.cpu_freeze = soc.driven.cpu_freeze;
    // eval() first works out what hangs on the inputs alone; they seldom change (5 % of the time).
    if (soc.settled && soc.spi_miso == soc.driven_miso && std::memcmp(&soc.driven, &in, offsetof(Pins, gpio_out)) == 0) {
        do {
            while (Vsoc___024root___eval_phase__act(root)) {
            }
        } while (Vsoc___024root___eval_phase__nba(root));
    } else {
        soc.drive(in);
        soc.driven = in;
        m.eval();
        soc.settled = true;
    }
#else
    soc.drive(*pins);
    // Evaluate low only when a clock that must rise now is still high; lower every clock while at
    // it.
    if (((clocks & SYS) && m.sys_clk) || ((clocks & ETH) && m.eth_clk)) {
        m.sys_clk = 0;
        m.eth_clk = 0;
        m.eval();
    }
    m.sys_clk = (clocks & SYS) ? 1 : 0;
    m.eth_clk = (clocks & ETH) ? 1 : 0;
    m.eval();
#endif
    soc.sample(*pins);
}

// Lets so many sys clocks pass, with the Ethernet clock 25 for 12 of them and the link up. For
// train.py, which knows no pins.
void fc_let_run(void* handle, uint32_t clocks, uint32_t reset) {
    Pins pins{};
    pins.sys_rst = reset & 1;
    pins.link_status = 0b1101;
    for (uint32_t sys = 0, eth = 0; sys < clocks; sys++) {
        fc_rise(handle, &pins, SYS | ETH, 0);
        for (eth += 25 - 12; eth >= 12; eth -= 12) fc_rise(handle, &pins, ETH, 0);
    }
}

// Puts `on_spi` at the flash's wires (null: no device, MISO is 1). It is called from within
// fc_rise, after the edge; the MISO it returns is seen by the next one.
void fc_on_spi(void* handle, OnSpi on_spi, void* context) {
    Soc& soc = *static_cast<Soc*>(handle);
    soc.on_spi = on_spi;
    soc.spi_context = context;
    soc.spi_miso = 1;
}

uint32_t fc_rom_words(void* handle) {
    auto* root = static_cast<Soc*>(handle)->model->rootp;
    return words_of(FC_ROM);
}

void fc_rom_write(void* handle, uint32_t index, uint32_t word) {
    auto* root = static_cast<Soc*>(handle)->model->rootp;
    *word_of(index, FC_ROM) = word;
}

// On-chip RAM, for stack watermarks. Zero words when the manifest does not name it.
uint32_t fc_ram_words(void* handle) {
    auto* root = static_cast<Soc*>(handle)->model->rootp;
    return words_of(FC_RAM);
}

uint32_t fc_ram_read(void* handle, uint32_t index) {
    auto* root = static_cast<Soc*>(handle)->model->rootp;
    return *word_of(index, FC_RAM);
}

// Address of the instruction that is leaving the CPU's pipeline in this clock; all ones when none
// is.
uint32_t fc_pc(void* handle) {
#if defined(FC_PC)
    auto* root = static_cast<Soc*>(handle)->model->rootp;
    return root->FC_PC_VALID ? root->FC_PC : ~0u;
#else
    (void)handle;
    return ~0u;
#endif
}

// Segments begun since power-up, above 8 bits of those that wait; all ones on a board without jobs.
uint64_t fc_segments(void* handle) {
#if defined(FC_BEGUN)
    auto* root = static_cast<Soc*>(handle)->model->rootp;
    return static_cast<uint64_t>(root->FC_BEGUN) << 8 | root->FC_LEVEL;
#else
    (void)handle;
    return ~0ull;
#endif
}

// Lines of the SDRAM that are low from now on, of the data and of a row's number, and lines of the
// data that are high. 1: there is no SDRAM.
int fc_sdram_lines(void* handle, uint32_t low, uint32_t row, uint32_t high) {
#if defined(FC_DATA_LOW)
    auto* root = static_cast<Soc*>(handle)->model->rootp;
    root->FC_DATA_LOW = low;
    root->FC_DATA_HIGH = high;
    root->FC_ROW_LOW = static_cast<uint16_t>(row);
    return 0;
#else
    (void)handle, (void)low, (void)row, (void)high;
    return 1;
#endif
}

// Turns these bits over in a word of the SDRAM. 1: there is no such word.
int fc_sdram_turn(void* handle, uint32_t index, uint32_t bits) {
#if defined(FC_SDRAM)
    auto& words = static_cast<Soc*>(handle)->model->rootp->FC_SDRAM;
    if (index >= words.size()) return 1;
    words[index] ^= bits;
    return 0;
#else
    (void)handle, (void)index, (void)bits;
    return 1;
#endif
}

// 0: opened; 1: this library was built without a waveform writer.
int fc_trace_open(void* handle, const char* path) {
#if defined(FC_TRACE_FST) || defined(FC_TRACE_VCD)
    Soc& soc = *static_cast<Soc*>(handle);
    soc.trace = std::make_unique<Trace>();
    soc.model->trace(soc.trace.get(), 99);
    soc.trace->open(path);
    return 0;
#else
    (void)handle, (void)path;
    return 1;
#endif
}

void fc_trace_close(void* handle) {
#if defined(FC_TRACE_FST) || defined(FC_TRACE_VCD)
    Soc& soc = *static_cast<Soc*>(handle);
    if (soc.trace) soc.trace->close();
#else
    (void)handle;
#endif
}

}  // extern "C"
