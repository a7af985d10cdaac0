/* Simulated Uno: what is at the six analog inputs, and what the converter makes of it.
 *
 * Copyright (C) 2026 strap_rover developers. SPDX-License-Identifier: GPL-3.0-or-later
 * Linked with libsimavr, which is GPL-3; for tests and demonstrations only, no part of the Apache-2.0 package.
 * This program is free software: you can redistribute it and/or modify it under the terms of the GNU General Public
 * License as published by the Free Software Foundation, either version 3 of the License, or (at your option) any later
 * version. It comes WITHOUT ANY WARRANTY. See <https://www.gnu.org/licenses/>. */
#ifndef INPUTS_H
#define INPUTS_H

#include <stdbool.h>
#include <stdint.h>

#define INPUTS 6

struct inputs {
    double volts[INPUTS];  /* at `at_ns` */
    double slopes[INPUTS]; /* [V/s] */
    double at_ns;          /* CLOCK_MONOTONIC */
    double vcc_v;          /* supply, and the converter's reference */
    double gap_v;          /* what the band gap really has */
    double noise_v;        /* standard deviation of a sample */
    double held_v;         /* on the sample-and-hold capacitor */
    bool floats[INPUTS];
    int stuck[INPUTS]; /* count, or -1 */
    uint64_t random;
    struct trace_row *trace;
    long trace_rows, trace_at;
};

void inputs_start(struct inputs *in, uint64_t seed);

/* Rows of `t_s,v0..v5`; a first line of words is passed over. Returns what is wrong, or NULL. */
const char *inputs_load_trace(struct inputs *in, const char *path);

/* Count of a conversion of `input` (0..5) at host time `host_ns` and board time `board_s`. */
int inputs_count(struct inputs *in, int input, double host_ns, double board_s);

/* Count of a conversion of the band gap. */
int inputs_gap_count(struct inputs *in);

/* 0 <= u < 1 */
double inputs_uniform(uint64_t *random);

#endif
