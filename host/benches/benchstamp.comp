// SPDX-License-Identifier: MIT OR GPL-2.0-or-later
component benchstamp "Takes the time between two functions of a thread, for `cargo xtask bench host`";
description """
Each instance notes the time of its call twice: by the monotonic clock, and by the CPU time of the
thread, which stands still while the thread sleeps. Two instances in front of each other tell what
the note itself costs. At unload every call of every instance goes into `file`, a line per period.
""";
pin out u32 calls "calls so far";
function _ fp;
option extra_setup yes;
option extra_cleanup yes;
variable int number;
license "GPL";
author "FerroCNC";
;;
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <errno.h>
#include <time.h>

#define INSTANCES 16

static char *file = 0;
RTAPI_MP_STRING(file, "where the times go");
static int periods = 10000;
RTAPI_MP_INT(periods, "periods noted; later ones are not");

struct note {
    long long cpu, wall;
};

static struct note *notes[INSTANCES];
static int taken[INSTANCES];

static long long nanos(clockid_t clock)
{
    struct timespec now;
    clock_gettime(clock, &now);
    return now.tv_sec * 1000000000LL + now.tv_nsec;
}

EXTRA_SETUP()
{
    size_t size = periods * sizeof(struct note);
    if (extra_arg >= INSTANCES || !(notes[extra_arg] = malloc(size)))
        return -ENOMEM;
    /* No page is touched for the first time by the thread. */
    memset(notes[extra_arg], 1, size);
    number = extra_arg;
    return 0;
}

FUNCTION(_)
{
    calls++;
    if (taken[number] < periods) {
        struct note *note = &notes[number][taken[number]++];
        note->cpu = nanos(CLOCK_THREAD_CPUTIME_ID);
        note->wall = nanos(CLOCK_MONOTONIC);
    }
}

EXTRA_CLEANUP()
{
    FILE *to = file ? fopen(file, "w") : 0;
    int line, n;
    for (line = 0; to && line < taken[0]; line++) {
        for (n = 0; n < INSTANCES && notes[n] && line < taken[n]; n++)
            fprintf(to, "%lld %lld ", notes[n][line].wall, notes[n][line].cpu);
        fputc('\n', to);
    }
    if (to)
        fclose(to);
}
