// SPDX-License-Identifier: MIT OR GPL-2.0-or-later
component benchudp "The C twin of ferrocnc for `cargo xtask bench host`: as many bytes, calls and pins, and no machine";
description """
A period costs the PC the system calls, the pins and what a driver computes. This component has the
same calls and as many pins as ferrocnc has with the same board, and computes nothing but the
conversion of each value. The difference is what ferrocnc computes: position loops, prediction,
clock comparison, checks. No machine can be driven with it.

`request` and `write` send a datagram, `read` receives until the answer to the last one is there. It
looks first, and sleeps in ppoll only if nothing is there, for 80 % of the period at most.
""";
pin in float in-###[512 : personality & 0xffff];
pin out float out-###[512 : (personality >> 16) & 0xffff];
pin out u32 missing "periods without an answer";
function request fp;
function read fp;
function write fp;
option extra_setup yes;
option extra_cleanup yes;
license "GPL";
author "FerroCNC";
;;
#include <sys/socket.h>
#include <netinet/in.h>
#include <arpa/inet.h>
#include <string.h>
#include <errno.h>
#include <poll.h>
#include <fcntl.h>

extern int close(int);

/* Words of the largest datagram. */
#define MOST 375

static int port = 0;
RTAPI_MP_INT(port, "UDP port of the responder on 127.0.0.1");
static int command = 16;
RTAPI_MP_INT(command, "words of what is sent");
static int status = 16;
RTAPI_MP_INT(status, "words of what comes back");

static int fd = -1;
static unsigned sequence;
static unsigned tx[MOST], rx[MOST];

EXTRA_SETUP()
{
    struct sockaddr_in to;
    if (command < 2 || command > MOST || status < 2 || status > MOST)
        return -EINVAL;
    memset(&to, 0, sizeof to);
    to.sin_family = AF_INET;
    to.sin_port = htons(port);
    to.sin_addr.s_addr = htonl(INADDR_LOOPBACK);
    fd = socket(AF_INET, SOCK_DGRAM | SOCK_CLOEXEC, 0);
    if (fd < 0 || connect(fd, (struct sockaddr *)&to, sizeof to))
        return -errno;
    fcntl(fd, F_SETFL, fcntl(fd, F_GETFL) | O_NONBLOCK);
    return 0;
}

EXTRA_CLEANUP()
{
    if (fd >= 0)
        close(fd);
}

static void transmit(void)
{
    tx[0] = htonl(++sequence);
    send(fd, tx, 4 * command, 0);
}

/* Waits for the answer to the last datagram; 1 if it came. */
static int receive(long long deadline)
{
    for (;;) {
        long long left;
        struct pollfd look = {fd, POLLIN, 0};
        struct timespec most = {0, 0};
        ssize_t got = recv(fd, rx, sizeof rx, 0);
        if (got == 4 * status && ntohl(rx[0]) == sequence)
            return 1;
        if (got >= 0)
            continue;
        if (errno != EAGAIN)
            return 0;
        left = deadline - rtapi_get_time();
        if (left <= 0)
            return 0;
        most.tv_nsec = left;
        if (ppoll(&look, 1, &most, NULL) == 0)
            return 0;
    }
}

FUNCTION(request)
{
    transmit();
}

FUNCTION(read)
{
    int n;
    int outs = (personality >> 16) & 0xffff;
    if (sequence == 0)
        return;
    if (!receive(rtapi_get_time() + period / 10 * 8)) {
        missing++;
        return;
    }
    for (n = 0; n < outs; n++)
        out(n) = (int)ntohl(rx[1 + n % (status - 1)]) * 0.0025;
}

FUNCTION(write)
{
    int n;
    int ins = personality & 0xffff;
    for (n = 0; n < ins; n++)
        tx[1 + n % (command - 1)] = htonl((int)(in(n) * 400.0));
    transmit();
}
