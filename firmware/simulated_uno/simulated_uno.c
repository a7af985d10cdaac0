/* Simulated Uno: command line, and the loop that keeps time.
 *
 * Copyright (C) 2026 strap_rover developers. SPDX-License-Identifier: GPL-3.0-or-later
 * Linked with libsimavr, which is GPL-3; for tests and demonstrations only, no part of the Apache-2.0 package.
 * This program is free software: you can redistribute it and/or modify it under the terms of the GNU General Public
 * License as published by the Free Software Foundation, either version 3 of the License, or (at your option) any later
 * version. It comes WITHOUT ANY WARRANTY. See <https://www.gnu.org/licenses/>. */
#include <errno.h>
#include <getopt.h>
#include <signal.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>

#include "board.h"
#include "control.h"
#include "inputs.h"
#include "line.h"
#include "port.h"

#define USAGE                                                                                                     \
    "usage: simulated_uno FIRMWARE.elf --port LINK [--control SOCKET] [options]\n"                                 \
    "       simulated_uno FIRMWARE.elf --max --seconds S --out FILE [options]\n"                                   \
    "  --port LINK        serial port: a link to a pseudo-terminal\n"                                             \
    "  --control SOCKET   unix datagram socket for commands; see README.md\n"                                     \
    "  --max              as fast as it goes, without port and control\n"                                         \
    "  --out FILE         what the board sends, before any fault of the line\n"                                    \
    "  --seconds S        end after so much board time (default: on a signal)\n"                                   \
    "  --trace CSV        inputs as rows of t_s,v0,v1,v2,v3,v4,v5, interpolated\n"                                 \
    "  --script FILE      lines of `T_S COMMAND`, obeyed at that board time\n"                                     \
    "  --board-id N       in the EEPROM, 0..255 (default: blank, which is 1)\n"                                    \
    "  --boot-ms N        silence of the boot loader after a reset (default 0; a real Uno: 1000 to 2000)\n"        \
    "  --ppm X            how much faster than the host's the board's clock runs\n"                               \
    "  --no-dtr           opening the port does not reset the board\n"                                            \
    "  --baud N           speed that the firmware was built for (default 115200)\n"                                \
    "  --seed N           of noise and faults (default 1)\n"

#define SLICE_CYCLES CYCLES_PER_MS
#define LONGEST_LAG_NS 5000000000LL /* caught up with; more than that the board has slept through */

struct options {
    const char *elf, *port, *control, *out, *trace, *script;
    double seconds, ppm;
    unsigned boot_ms, baud;
    int board_id;
    unsigned long long seed;
    bool is_max, has_no_dtr;
};

static volatile sig_atomic_t is_told_to_end;
static FILE *journal;
static uint64_t slept_ns;

static void on_signal(int number) {
    (void)number;
    is_told_to_end = 1;
}

static int refuse(const char *what, const char *value, const char *problem) {
    fprintf(stderr, "simulated_uno: %s %s: %s\n", what, value, problem);
    return 2;
}

static int64_t monotonic_ns(void) {
    struct timespec now;
    clock_gettime(CLOCK_MONOTONIC, &now);
    return now.tv_sec * 1000000000LL + now.tv_nsec;
}

static bool is_number(const char *text, double lowest, double highest, double *value) {
    char *end;
    *value = strtod(text, &end);
    return end != text && !*end && *value >= lowest && *value <= highest;
}

static int take_options(int argc, char **argv, struct options *o) {
    enum { PORT, CONTROL, OUT, TRACE, SCRIPT, SECONDS, PPM, BOOT_MS, BAUD, BOARD_ID, SEED, MAX, NO_DTR, HELP };
    static const struct option known[] = {
        {"port", 1, 0, PORT},       {"control", 1, 0, CONTROL}, {"out", 1, 0, OUT},         {"trace", 1, 0, TRACE},
        {"script", 1, 0, SCRIPT},   {"seconds", 1, 0, SECONDS}, {"ppm", 1, 0, PPM},         {"boot-ms", 1, 0, BOOT_MS},
        {"baud", 1, 0, BAUD},       {"board-id", 1, 0, BOARD_ID}, {"seed", 1, 0, SEED},     {"max", 0, 0, MAX},
        {"no-dtr", 0, 0, NO_DTR},   {"help", 0, 0, HELP},       {0, 0, 0, 0}};
    *o = (struct options){.board_id = -1, .baud = 115200, .seed = 1};
    opterr = 0;
    for (int which; (which = getopt_long(argc, argv, ":", known, NULL)) != -1;) {
        double number = 0.0;
        switch (which) {
        case PORT: o->port = optarg; break;
        case CONTROL: o->control = optarg; break;
        case OUT: o->out = optarg; break;
        case TRACE: o->trace = optarg; break;
        case SCRIPT: o->script = optarg; break;
        case SECONDS:
            if (!is_number(optarg, 1e-3, 1e9, &number)) return refuse("--seconds", optarg, "must be above 0");
            o->seconds = number;
            break;
        case PPM:
            if (!is_number(optarg, -1e5, 1e5, &number)) return refuse("--ppm", optarg, "must be -100000..100000");
            o->ppm = number;
            break;
        case BOOT_MS:
            if (!is_number(optarg, 0, 60000, &number)) return refuse("--boot-ms", optarg, "must be 0..60000");
            o->boot_ms = (unsigned)number;
            break;
        case BAUD:
            if (!is_number(optarg, 300, 2e6, &number)) return refuse("--baud", optarg, "must be 300..2000000");
            o->baud = (unsigned)number;
            break;
        case BOARD_ID:
            if (!is_number(optarg, 0, 255, &number) || number != (int)number)
                return refuse("--board-id", optarg, "must be a whole number 0..255");
            o->board_id = (int)number;
            break;
        case SEED:
            if (!is_number(optarg, 0, 9e15, &number)) return refuse("--seed", optarg, "must be a whole number from 0");
            o->seed = (unsigned long long)number;
            break;
        case MAX: o->is_max = true; break;
        case NO_DTR: o->has_no_dtr = true; break;
        case HELP: fputs(USAGE, stdout); exit(0);
        case ':': return refuse(argv[optind - 1], "", "wants a value; --help lists all");
        default: return refuse(argv[optind - 1], "", "no such option; --help lists all");
        }
    }
    if (optind != argc - 1) return refuse("FIRMWARE.elf", "", "give exactly one; --help lists all");
    o->elf = argv[optind];
    if (!o->is_max && !o->port) return refuse("--port", "", "missing; give the link to serve, or --max");
    if (o->is_max && (o->port || o->control)) return refuse("--max", "", "serves neither --port nor --control");
    if (o->is_max && o->seconds <= 0.0) return refuse("--seconds", "", "missing; --max has to know where to end");
    return 0;
}

static void deliver(const uint8_t *bytes, size_t count) {
    uint8_t garbage[4096];
    if (count <= sizeof garbage && port_is_at_wrong_speed()) {
        memcpy(garbage, bytes, count);
        line_garble(garbage, count);
        bytes = garbage;
    }
    port_write(bytes, count);
}

static void to_nobody(const uint8_t *bytes, size_t count) {
    (void)bytes, (void)count;
}

static void carry_sent(void) {
    uint8_t bytes[4096];
    size_t count = 0;
    while (count < sizeof bytes && board_sent(&bytes[count])) count++;
    if (!count) return;
    if (journal) fwrite(bytes, 1, count, journal);
    line_send(bytes, count);
}

static void carry_received(void) {
    uint8_t bytes[1024];
    const size_t count = port_read(bytes, sizeof bytes);
    if (count) control_queue(bytes, count, port_is_at_wrong_speed());
}

/* To the next whole slice or line of the script, but not beyond `end`; the same steps whatever keeps time. */
static bool run_step(struct control *control, uint64_t end) {
    const uint64_t now = board_now();
    uint64_t until = (now / SLICE_CYCLES + 1) * SLICE_CYCLES;
    if (until > control_next_cycle()) until = control_next_cycle();
    if (until > end) until = end;
    if (!board_run_until(until)) {
        fprintf(stderr, "simulated_uno: the processor stopped: interrupts off and asleep, or lost its way\n");
        return false;
    }
    carry_sent();
    if (!control_run_script(control)) return false;
    if (board_now() / SLICE_CYCLES != now / SLICE_CYCLES) control_feed_board();
    return true;
}

static bool run_at_full_speed(struct control *control, uint64_t end) {
    while (board_now() < end && !is_told_to_end && !control->wants_end)
        if (!run_step(control, end)) return false;
    return true;
}

/* A slice is run once its time is over: inputs are then known up to its end, and no byte comes early. */
static bool run_in_real_time(struct control *control, uint64_t end, bool has_dtr) {
    board_set_clock((double)monotonic_ns(), board_now(), control->ppm);
    while (board_now() < end && !is_told_to_end && !control->wants_end) {
        const uint64_t slice_end = (board_now() / SLICE_CYCLES + 1) * SLICE_CYCLES;
        const int64_t due_ns = (int64_t)board_host_ns(slice_end);
        const struct timespec due = {due_ns / 1000000000LL, due_ns % 1000000000LL};
        while (clock_nanosleep(CLOCK_MONOTONIC, TIMER_ABSTIME, &due, NULL) == EINTR && !is_told_to_end) {
        }
        const int64_t now_ns = monotonic_ns();
        if (now_ns - due_ns > LONGEST_LAG_NS) {
            slept_ns += (uint64_t)(now_ns - due_ns);
            board_set_clock((double)now_ns, board_now(), control->ppm);
        }
        control_serve(control);
        if (control->has_new_ppm) {
            control->has_new_ppm = false;
            board_set_clock(board_host_ns(board_now()), board_now(), control->ppm);
        }
        if (port_was_opened() && has_dtr) board_reset(EXTERNAL);
        carry_received();
        uint64_t until = board_cycle_at((double)now_ns) / SLICE_CYCLES * SLICE_CYCLES;
        if (until > end) until = end;
        while (board_now() < until)
            if (!run_step(control, until)) return false;
    }
    return true;
}

int main(int argc, char **argv) {
    struct options o;
    struct inputs inputs;
    const char *problem;
    const int refused = take_options(argc, argv, &o);
    if (refused) return refused;
    inputs_start(&inputs, o.seed);
    if (o.trace && (problem = inputs_load_trace(&inputs, o.trace))) return refuse("--trace", o.trace, problem);
    if (o.script && (problem = control_load_script(o.script))) return refuse("--script", o.script, problem);
    if ((problem = board_load(o.elf, &inputs, o.boot_ms))) return refuse("FIRMWARE.elf", o.elf, problem);
    if (o.out && !(journal = fopen(o.out, "wb"))) return refuse("--out", o.out, strerror(errno));
    const struct sigaction end = {.sa_handler = on_signal};
    sigaction(SIGTERM, &end, NULL);
    sigaction(SIGINT, &end, NULL);
    sigaction(SIGHUP, &end, NULL);
    signal(SIGPIPE, SIG_IGN);
    if (o.control && (problem = control_listen(o.control))) return refuse("--control", o.control, problem);
    if (o.port && (problem = port_start(o.port, o.baud))) {
        control_end();
        return refuse("--port", o.port, problem);
    }
    line_start(o.seed, o.is_max ? to_nobody : deliver);
    if (o.board_id >= 0) board_keep_id(o.board_id);
    board_reset(POWER_ON);
    if (o.port) printf("ready %s\n", o.port);
    fflush(stdout);

    struct control control = {.inputs = &inputs, .ppm = o.ppm};
    const uint64_t last = o.seconds > 0.0 ? (uint64_t)(o.seconds * CLOCK_HZ) : UINT64_MAX;
    const int64_t began_ns = monotonic_ns();
    const bool went_well = o.is_max ? run_at_full_speed(&control, last) : run_in_real_time(&control, last, !o.has_no_dtr);

    port_end();
    control_end();
    const bool is_written = !journal || !fclose(journal);
    struct timespec cpu;
    clock_gettime(CLOCK_PROCESS_CPUTIME_ID, &cpu);
    const double wall_s = 1e-9 * (double)(monotonic_ns() - began_ns), board_s = (double)board_now() / CLOCK_HZ;
    const struct board_totals *totals = board_totals();
    fprintf(stderr,
            "simulated_uno: %.3f s of board time in %.3f s (x %.2f), %.1f %% of a core; %llu bytes sent, %llu unheard, "
            "%llu received; %llu resets, %llu by the watchdog; slept through %.1f s\n",
            board_s, wall_s, board_s / wall_s, 100.0 * ((double)cpu.tv_sec + 1e-9 * (double)cpu.tv_nsec) / wall_s,
            (unsigned long long)totals->sent_bytes, (unsigned long long)port_lost_bytes(),
            (unsigned long long)totals->received_bytes, (unsigned long long)totals->resets,
            (unsigned long long)totals->watchdog_resets, 1e-9 * (double)slept_ns);
    if (!is_written) return refuse("--out", o.out, strerror(errno)), 1;
    return went_well ? 0 : 1;
}
