// Shared by all core benches: a clock, a seeded generator and a failure message that says how to
// repeat the run.
#pragma once
#include <cstdarg>
#include <cstdint>
#include <cstdio>
#include <cstdlib>
#include <ctime>
#include <memory>

struct Random {
    uint64_t state;
    explicit Random(uint64_t seed) : state(seed) {}
    uint64_t next() {  // splitmix64
        uint64_t z = state += 0x9E3779B97F4A7C15u;
        z = (z ^ z >> 30) * 0xBF58476D1CE4E5B9u;
        z = (z ^ z >> 27) * 0x94D049BB133111EBu;
        return z ^ z >> 31;
    }
    uint64_t below(uint64_t n) { return next() % n; }
    bool one_in(uint64_t n) { return below(n) == 0; }
    uint64_t up_to_bits(unsigned bits) {  // every magnitude equally likely
        unsigned b = below(bits + 1);
        return b ? (1ull << (b - 1)) | (next() & ((1ull << (b - 1)) - 1)) : 0;
    }
};

template <class Core>
struct Bench {
    const char *name;
    uint64_t seed;
    Random random;
    std::unique_ptr<Core> core{new Core};
    uint64_t clocks = 0;
    clock_t began = clock();

    Bench(const char *name, int argc, char **argv)
        : name(name), seed(argc > 1 ? strtoull(argv[1], nullptr, 0) : (uint64_t)time(nullptr)), random(seed) {
        core->clk = 0;
        core->eval();
    }
    // The core sees inputs set before this at the edge; outputs read after it are those after the
    // edge.
    void edge() {
        core->clk = 1;
        core->eval();
        core->clk = 0;
        core->eval();
        clocks++;
    }
    void settle() { core->eval(); }
    [[noreturn]] void fail(const char *format, ...) {
        va_list args;
        va_start(args, format);
        printf("FAIL %s: ", name);
        vprintf(format, args);
        printf(" (clock %llu; again with: gateware/tests/run.sh %s %llu)\n", (unsigned long long)clocks, name, (unsigned long long)seed);
        va_end(args);
        exit(1);
    }
    int pass(const char *format, ...) {
        va_list args;
        va_start(args, format);
        printf("PASS %s: ", name);
        vprintf(format, args);
        printf(", %.1f Mclk in %.1f s, seed %llu\n", clocks / 1e6, double(clock() - began) / CLOCKS_PER_SEC, (unsigned long long)seed);
        va_end(args);
        return 0;
    }
};

#define CHECK(b, condition, ...) \
    do { if (!(condition)) (b).fail(__VA_ARGS__); } while (0)
