// The cores and their banks (gateware `elaborate --target cores`) behind a C ABI: one call, one
// rising edge. For the lock-step test, which compares them with the models in sim/src/model.
//
// `CoresPins` is mirrored by sim/src/soc.rs; change both, and ABI_VERSION with them.

#include <cstdint>
#include <memory>

#include "Vcores.h"
#include "verilated.h"

namespace {
constexpr uint32_t ABI_VERSION = 5;

struct CoresPins {
    // in
    uint32_t adr, coming, dat_w, abi;
    uint64_t gpio_in;
    uint32_t word;
    uint16_t enc_a, enc_b, enc_i, step_index, enc_mask;
    uint8_t we, rst, ext_reset, frame_done, frame_slot, frame_pending, pending_slot, pad_fault, pad_at, pad_to, eth_beat, word_is, answer_free, answer_sending;
    // out
    uint32_t dat_r;
    uint64_t gpio_out;
    uint32_t put;
    uint16_t step, dir, step_n, dir_n, pwm_out, pwm_dir, length;
    uint8_t led, gate, frame, put_at, reserved_out[2];
};
static_assert(sizeof(CoresPins) == 88, "mirrored in sim/src/soc.rs");

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

    // What `copper.sv` is on the simulated board: the pads as they are driven, and one thing that
    // is wrong with them.
    void pads(const CoresPins &p) {
        Vcores &m = *model;
        uint64_t seen[7] = {m.step, m.dir, m.step_n, m.dir_n, m.pwm, m.pwm_dir, m.outputs};
        auto group = [](unsigned pad) { return pad < 96 ? pad >> 4 : 6; };
        auto bit = [](unsigned pad) { return pad < 96 ? pad & 15 : pad - 96; };
        auto level = [&](unsigned pad) { return seen[group(pad)] >> bit(pad) & 1; };
        auto hold = [&](unsigned pad, uint64_t to) { seen[group(pad)] = (seen[group(pad)] & ~(uint64_t(1) << bit(pad))) | to << bit(pad); };
        const unsigned at = p.pad_at, to = p.pad_to;
        if ((p.pad_fault & 3) == 3) {
            const uint64_t both = level(at) & level(to);
            hold(at, both), hold(to, both);
        } else if (p.pad_fault & 3) hold(at, p.pad_fault >> 1 & 1);
        m.step_seen = seen[0], m.dir_seen = seen[1], m.step_n_seen = seen[2], m.dir_n_seen = seen[3];
        m.pwm_seen = seen[4], m.pwm_dir_seen = seen[5], m.outputs_seen = seen[6];
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
    static_cast<Cores*>(handle)->pads(*p);
    Vcores& m = *static_cast<Cores*>(handle)->model;
    m.eth_beat = p->eth_beat;
    m.adr = p->adr;
    m.coming = p->coming;
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
    m.words_valid = p->word_is & 1;
    m.words_last = p->word_is >> 1 & 1;
    m.words_whole = p->word_is >> 2 & 1;
    m.words_bad = p->word_is >> 3 & 1;
    m.words_room = p->word_is >> 4 & 1;
    m.words_data = p->word;
    m.answer_free = p->answer_free;
    m.answer_sending = p->answer_sending;
    // What is said to the MAC in front of the edge.
    m.eval();
    p->frame = m.hold | m.refuse << 1 | m.take << 2 | m.taken << 3 | m.answer_send << 4 | m.answer_puts << 5;
    p->put_at = m.answer_put_at;
    p->put = m.answer_put;
    p->length = m.answer_length;
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
