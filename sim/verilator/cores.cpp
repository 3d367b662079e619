// The cores and their banks (gateware `elaborate --target cores`) behind a C ABI: one call, one rising edge. For the
// lock-step test, which holds them against the models in sim/src/model.
//
// `CoresPins` is mirrored by sim/src/soc.rs; change both, and ABI_VERSION with them.

#include <cstdint>
#include <memory>

#include "Vcores.h"
#include "verilated.h"

namespace {
constexpr uint32_t ABI_VERSION = 1;

struct CoresPins {
    // in
    uint32_t adr, dat_w, abi, gpio_in;
    uint16_t enc_a, enc_b, enc_i, step_index, enc_mask;
    uint8_t we, rst, ext_reset, frame_done, frame_slot, frame_pending, pending_slot, reserved_in[3];
    // out
    uint32_t dat_r, gpio_out;
    uint16_t step, dir, step_n, dir_n, pwm_out, pwm_dir;
    uint8_t led, gate, reserved_out[2];
};
static_assert(sizeof(CoresPins) == 60, "mirrored in sim/src/soc.rs");

struct Cores {
    VerilatedContext context;
    std::unique_ptr<Vcores> model;

    Cores() {
        context.randReset(0);
        model = std::make_unique<Vcores>(&context, "cores");
        model->clk = 0;
        model->spi_miso = 1;
        model->eval();
    }

    // As in shim.cpp.
    ~Cores() {
        Verilated::threadContextp(&context);
        model.reset();
    }
};
}  // namespace

extern "C" {

uint32_t fc_cores_abi_version() { return ABI_VERSION; }

void* fc_cores_new() { return new Cores(); }

void fc_cores_free(void* cores) { delete static_cast<Cores*>(cores); }

// One rising edge with the inputs as they are; the outputs as they stand after it.
void fc_cores_rise(void* handle, CoresPins* p) {
    Vcores& m = *static_cast<Cores*>(handle)->model;
    m.adr = p->adr;
    m.dat_w = p->dat_w;
    m.we = p->we;
    m.rst = p->rst;
    m.abi = p->abi;
    m.inputs = p->gpio_in;
    m.enc_a = p->enc_a;
    m.enc_b = p->enc_b;
    m.enc_i = p->enc_i;
    m.step_index = p->step_index;
    m.enc_mask = p->enc_mask;
    m.ext_reset = p->ext_reset;
    m.frame_done = p->frame_done;
    m.frame_slot = p->frame_slot;
    m.frame_pending = p->frame_pending;
    m.pending_slot = p->pending_slot;
    m.clk = 1;
    m.eval();
    m.clk = 0;
    m.eval();
    p->dat_r = m.dat_r;
    p->gpio_out = m.outputs;
    p->step = m.step;
    p->dir = m.dir;
    p->step_n = m.step_n;
    p->dir_n = m.dir_n;
    p->pwm_out = m.pwm;
    p->pwm_dir = m.pwm_dir;
    p->led = m.led;
    p->gate = m.gate;
}

}  // extern "C"
