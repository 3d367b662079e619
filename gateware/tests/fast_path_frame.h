// Frames for the bench of the fast path: the owner's command, and every way in which a frame may be
// like it and is not.
#pragma once
#include <algorithm>
#include <cstdint>
#include <functional>
#include <string>
#include <utility>
#include <vector>

#include "bench.h"

using Bytes = std::vector<uint8_t>;
using Words = std::vector<uint32_t>;

static const Bytes OURS{0x12, 0xe2, 0xd5, 0, 0, 1}, THEIRS{2, 0xfc, 0, 0, 2, 1};
static const Bytes BROADCAST(6, 0xff), OTHER_BOARD{0x12, 0xe2, 0xd5, 0, 0, 9}, OTHER_HOST{2, 0xfc, 0, 0, 2, 9};
static const uint32_t OUR_IP = 0xc0a80232, THEIR_IP = 0xc0a80201, OUR_PORT = 1234, THEIR_PORT = 40000;
static const uint32_t TOKEN = 0xabcd1234;
static const uint32_t IPV4 = 0x800, ARP = 0x806, IPV6 = 0x86dd;
// Words of a command: Etherbone's head, token, number, flags and time, then what is staged.
static const unsigned HEAD = 9, AT_BASE = 3, AT_TOKEN = 4, AT_NUMBER = 5, AT_FLAGS = 6, AT_SELECT = HEAD + 3;

static uint32_t crc32(const Bytes &bytes) {
    uint32_t c = ~0u;
    for (uint8_t b : bytes) {
        c ^= b;
        for (int i = 0; i < 8; i++) c = c & 1 ? c >> 1 ^ 0xEDB88320 : c >> 1;
    }
    return ~c;
}
static uint32_t fold(uint64_t sum) {
    while (sum >> 16) sum = (sum & 0xffff) + (sum >> 16);
    return sum;
}
static uint32_t sum16(const Words &words) {
    uint64_t sum = 0;
    for (uint32_t w : words) sum += (w >> 16) + (w & 0xffff);
    return fold(sum);
}
static uint32_t sum16(const Bytes &b, size_t from, size_t to) {
    uint64_t sum = 0;
    for (size_t i = from; i + 1 < to; i += 2) sum += b[i] << 8 | b[i + 1];
    return fold(sum);
}
static void be16(Bytes &b, uint32_t v) { b.push_back(v >> 8), b.push_back(v); }
static void be32(Bytes &b, uint32_t v) { be16(b, v >> 16), be16(b, v); }
static void append(Bytes &b, const Bytes &more) { b.insert(b.end(), more.begin(), more.end()); }
static uint32_t word_at(const Bytes &b, size_t at) { return (uint32_t)b[at] << 24 | b[at + 1] << 16 | b[at + 2] << 8 | b[at + 3]; }
static Bytes with_fcs(Bytes f) {
    uint32_t crc = crc32(f);
    for (int i = 0; i < 4; i++) f.push_back(crc >> 8 * i);
    return f;
}
static Bytes without_fcs(const Bytes &f) { return Bytes(f.begin(), f.end() - 4); }

// A UDP datagram of these words with all that may be odd about it. Its checksums are those of the
// frame as it is, odd or not, unless one is `bad`.
struct Frame {
    Words payload;
    Bytes to = OURS, from = THEIRS, tag, options;
    uint32_t type = IPV4, version = 4, tos = 0, id = 7, fragment = 0x4000, ttl = 0x40, protocol = 17;
    uint32_t from_ip = THEIR_IP, to_ip = OUR_IP, from_port = THEIR_PORT, to_port = OUR_PORT;
    int ip_lies = 0, udp_lies = 0;  // added to the length in the header
    bool no_sum = false;
    uint32_t bad_sum = 0, bad_ip_sum = 0, bad_fcs = 0;
    int cut = 0, more = 0;  // bytes of padding, or missing

    explicit Frame(Words words) : payload(std::move(words)) {}

    Bytes ip(uint32_t length) const {
        Bytes b;
        be16(b, version << 12 | (5 + options.size() / 4) << 8 | tos), be16(b, length), be16(b, id), be16(b, fragment);
        be16(b, ttl << 8 | protocol), be16(b, 0), be32(b, from_ip), be32(b, to_ip), append(b, options);
        const uint32_t check = (~sum16(b, 0, b.size()) & 0xffff) ^ bad_ip_sum;
        b[10] = check >> 8, b[11] = check;
        return b;
    }
    Bytes udp(uint32_t length) const {
        Bytes b;
        be16(b, from_port), be16(b, to_port), be16(b, length), be16(b, 0);
        for (uint32_t w : payload) be32(b, w);
        uint32_t check = ~fold((uint64_t)sum16({from_ip, to_ip, protocol, length}) + sum16(b, 0, b.size())) & 0xffff;
        check = no_sum ? 0 : (check ? check : 0xffff) ^ bad_sum;
        b[6] = check >> 8, b[7] = check;
        return b;
    }
    Bytes bytes() const {
        const uint32_t length = 8 + 4 * payload.size();
        Bytes f = to;
        append(f, from), append(f, tag), be16(f, type);
        append(f, ip(20 + options.size() + length + ip_lies)), append(f, udp(length + udp_lies));
        f.resize(f.size() - cut + more);
        f = with_fcs(f);
        f.back() ^= bad_fcs;
        return f;
    }
};

// A frame that must not be executed; why not, and whether it ends before any slot.
struct Wrong {
    std::string what;
    Bytes frame;
    bool gone = false;
};

static Bytes arp(const Bytes &to, uint32_t from_ip, uint32_t to_ip, size_t size) {
    Bytes f = to;
    append(f, THEIRS), be16(f, ARP), be16(f, 1), be16(f, IPV4), be16(f, 0x0604), be16(f, 1);
    append(f, THEIRS), be32(f, from_ip), append(f, Bytes(6, 0)), be32(f, to_ip);
    f.resize(size);
    return with_fcs(f);
}

// All kinds of frames that are not the command `good`, each once.
struct Kinds {
    Words good;
    std::vector<Wrong> all;

    explicit Kinds(Words words) : good(std::move(words)) {
        broken();
        of_another_length();
        addressed_to_others();
        from_others();
        of_another_session();
        of_another_shape();
    }
    void add(const std::string &what, const std::function<void(Frame &)> &change) {
        Frame f(good);
        change(f);
        all.push_back({what, f.bytes(), f.bad_fcs != 0});
        if (f.no_sum || f.bad_sum) return;
        // Without a checksum nothing but the difference itself tells.
        f.no_sum = true;
        all.push_back({what + ", no checksum", f.bytes(), f.bad_fcs != 0});
    }
    void add_word(const std::string &what, unsigned word, uint32_t flip) {
        add(what, [&](Frame &f) { f.payload[word] ^= flip; });
    }

    void broken() {
        add("a wrong FCS", [](Frame &f) { f.bad_fcs = 1; });
        add("a wrong UDP checksum", [](Frame &f) { f.bad_sum = 0x10; });
        add("a wrong IP checksum", [](Frame &f) { f.bad_ip_sum = 1; });
        add("both checksums wrong", [](Frame &f) { f.bad_ip_sum = 0x8000, f.bad_sum = 0x8000; });
        add("everything wrong", [](Frame &f) { f.bad_fcs = 0x80, f.bad_ip_sum = 1, f.bad_sum = 1; });
    }
    void of_another_length() {
        for (int n : {1, 2, 3, 4, 5, 8, 60}) {
            add("cut by " + std::to_string(n) + " bytes", [&](Frame &f) { f.cut = n; });
            add("longer by " + std::to_string(n), [&](Frame &f) { f.more = n; });
        }
        add("as long as a frame can be", [](Frame &f) { f.more = 1514 - int(f.bytes().size() - 4); });
        add("a word less, with right lengths", [](Frame &f) { f.payload.pop_back(); });
        add("a word more, with right lengths", [](Frame &f) { f.payload.push_back(0); });
        for (int n : {-4, -1, 1, 4, 256}) {
            const std::string by = " is wrong by " + std::to_string(n);
            add("the UDP length" + by, [&](Frame &f) { f.udp_lies = n; });
            add("the IP length" + by, [&](Frame &f) { f.ip_lies = n; });
            add("either length" + by, [&](Frame &f) { f.udp_lies = f.ip_lies = n; });
        }
        all.push_back({"a byte", with_fcs(Bytes{1})});
        const Bytes f = Frame(good).bytes();
        all.push_back({"an Ethernet header", with_fcs(Bytes(f.begin(), f.begin() + 14))});
    }
    void addressed_to_others() {
        add("for another board", [](Frame &f) { f.to = OTHER_BOARD; });
        add("for all boards", [](Frame &f) { f.to = BROADCAST; });
        add("for another IP address", [](Frame &f) { f.to_ip ^= 1; });
        add("for all IP addresses", [](Frame &f) { f.to_ip = ~0u; });
        add("for another port", [](Frame &f) { f.to_port ^= 1; });
        // The sum does not tell which of two numbers has one more.
        add("for another address and port", [](Frame &f) { f.to_ip++, f.to_port--; });
    }
    void from_others() {
        add("from another MAC address", [](Frame &f) { f.from = OTHER_HOST; });
        add("from another IP address", [](Frame &f) { f.from_ip ^= 1; });
        add("from another port", [](Frame &f) { f.from_port ^= 1; });
        add("from another address and port", [](Frame &f) { f.from_ip++, f.from_port--; });
        add("from another host", [](Frame &f) { f.from = OTHER_HOST, f.from_ip ^= 8, f.from_port ^= 8; });
        add("sent back", [](Frame &f) { std::swap(f.to, f.from), std::swap(f.to_ip, f.from_ip), std::swap(f.to_port, f.from_port); });
        for (size_t size : {42, 60}) {
            all.push_back({"an ARP request", arp(OURS, THEIR_IP, OUR_IP, size)});
            all.push_back({"an ARP request to all", arp(BROADCAST, THEIR_IP, OUR_IP, size)});
            all.push_back({"an announcement", arp(BROADCAST, OUR_IP, OUR_IP, size)});
        }
    }
    void of_another_session() {
        const uint32_t number = good[AT_NUMBER];
        add_word("another token", AT_TOKEN, 1);
        add_word("no token", AT_TOKEN, TOKEN);
        add_word("the last number", AT_NUMBER, number ^ (number - 1));
        add_word("a number ahead", AT_NUMBER, number ^ (number + 1));
        add_word("a number far away", AT_NUMBER, 0x80000000);
        add_word("other flags", AT_FLAGS, 2);
        add_word("one flag more", AT_FLAGS, 1u << 31);
        add_word("another base address", AT_BASE, 4);
        add_word("another count of words", 2, 1u << 8);
        add_word("not Etherbone", 0, 1u << 16);
        add_word("an unknown selection", AT_SELECT, 1u << 21);
        add_word("the highest bit of the selection", AT_SELECT, 1u << 31);
        add("number and token changed places", [](Frame &f) { std::swap(f.payload[AT_TOKEN], f.payload[AT_NUMBER]); });
    }
    void of_another_shape() {
        add("in a VLAN", [](Frame &f) { f.tag = {0x81, 0, 0, 1}; });
        add("in no VLAN, with a priority", [](Frame &f) { f.tag = {0x81, 0, 0xe0, 0}; });
        add("in two VLANs", [](Frame &f) { f.tag = {0x88, 0xa8, 0, 1, 0x81, 0, 0, 2}; });
        add("IP options", [](Frame &f) { f.options = {1, 1, 1, 0}; });
        add("as many IP options as there can be", [](Frame &f) { f.options = Bytes(40, 1); });
        add("the first fragment", [](Frame &f) { f.fragment = 0x2000; });
        add("a fragment in the middle", [](Frame &f) { f.fragment = 0x2001; });
        add("the last fragment", [](Frame &f) { f.fragment = 1; });
        add("a fragment far behind", [](Frame &f) { f.fragment = 0x1fff; });
        add("the reserved flag", [](Frame &f) { f.fragment = 0x8000; });
        add("another service class", [](Frame &f) { f.tos = 4; });
        add("another time to live", [](Frame &f) { f.ttl--; });
        add("TCP", [](Frame &f) { f.protocol = 6; });
        add("UDP-Lite", [](Frame &f) { f.protocol = 136; });
        add("ICMP", [](Frame &f) { f.protocol = 1; });
        add("IP version 6", [](Frame &f) { f.version = 6; });
        add("the type of IPv6", [](Frame &f) { f.type = IPV6; });
        add("the type of ARP", [](Frame &f) { f.type = ARP; });
    }
};

// What firmware's words say of a frame, read from the description of the core: is it to be
// executed? `good` is the frame it has written down.
static bool is_like(const Bytes &f, const Bytes &good) {
    if (f.size() != good.size() || with_fcs(without_fcs(f)) != f) return false;
    // Words 0 to 17 but for 5, 12 and the checksums, as bytes; the slot begins two before the
    // frame.
    auto compared = [](size_t n) { return n < 70 && !(n >= 18 && n < 22) && n != 24 && n != 25 && n != 40 && n != 41 && !(n >= 46 && n < 50); };
    for (size_t n = 0; n < f.size() - 4; n++)
        if (compared(n) && f[n] != good[n]) return false;
    const bool fragment = f[20] & 0xbf || f[21], no_sum = !f[40] && !f[41], known = !(word_at(f, 90) >> 21);
    const uint32_t udp = fold((uint64_t)sum16({THEIR_IP, OUR_IP, 17}) + sum16(f, 38, 40) + sum16(f, 34, f.size() - 4));
    return !fragment && known && sum16(f, 14, 34) == 0xffff && (no_sum || udp == 0xffff);
}

// Whether it needs no ticket to come into a slot, as rx_admission.sv says it (mode 3).
static bool is_the_owners(const Bytes &f, const Bytes &good) {
    if (f.size() < 59 + 4) return false;
    auto same = [&](size_t from, size_t to) { return std::equal(f.begin() + from, f.begin() + to, good.begin() + from); };
    const bool asks = f[12] == ARP >> 8 && f[13] == (ARP & 0xff);
    return same(0, 12) && (asks || (same(12, 14) && same(26, 30) && same(34, 38)));
}
