/* Simulated Uno: what is at the six analog inputs, and what the converter makes of it.
 *
 * Copyright (C) 2026 strap_rover developers. SPDX-License-Identifier: GPL-3.0-or-later
 * Linked with libsimavr, which is GPL-3; for tests and demonstrations only, no part of the Apache-2.0 package.
 * This program is free software: you can redistribute it and/or modify it under the terms of the GNU General Public
 * License as published by the Free Software Foundation, either version 3 of the License, or (at your option) any later
 * version. It comes WITHOUT ANY WARRANTY. See <https://www.gnu.org/licenses/>. */
#include "inputs.h"

#include <errno.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#define STALE_S 0.020 /* slopes are not believed for longer */

struct trace_row {
    double t_s, volts[INPUTS];
};

/* splitmix64 */
static uint64_t next_random(uint64_t *state) {
    uint64_t z = *state += 0x9E3779B97F4A7C15u;
    z = (z ^ (z >> 30)) * 0xBF58476D1CE4E5B9u;
    z = (z ^ (z >> 27)) * 0x94D049BB133111EBu;
    return z ^ (z >> 31);
}

double inputs_uniform(uint64_t *random) {
    return (double)(next_random(random) >> 11) * 0x1p-53;
}

static double gauss(uint64_t *random) {
    const double radius = sqrt(-2.0 * log(1.0 - inputs_uniform(random)));
    return radius * cos(2.0 * M_PI * inputs_uniform(random));
}

void inputs_start(struct inputs *in, uint64_t seed) {
    memset(in, 0, sizeof *in);
    in->vcc_v = 5.0;
    in->gap_v = 1.1;
    in->random = seed;
    for (int i = 0; i < INPUTS; i++) in->stuck[i] = -1;
}

const char *inputs_load_trace(struct inputs *in, const char *path) {
    static char problem[300];
    FILE *file = fopen(path, "r");
    if (!file) {
        snprintf(problem, sizeof problem, "%s; give a file of t_s,v0,v1,v2,v3,v4,v5", strerror(errno));
        return problem;
    }
    char line[512];
    long room = 0, number = 0;
    problem[0] = 0;
    while (fgets(line, sizeof line, file)) {
        struct trace_row row;
        double *v = row.volts;
        number++;
        const int fields = sscanf(line, "%lf,%lf,%lf,%lf,%lf,%lf,%lf", &row.t_s, v, v + 1, v + 2, v + 3, v + 4, v + 5);
        if (fields != 1 + INPUTS) {
            if (number == 1 && fields == 0) continue;
            snprintf(problem, sizeof problem, "line %ld: want t_s,v0,v1,v2,v3,v4,v5", number);
            break;
        }
        if (in->trace_rows && !(row.t_s > in->trace[in->trace_rows - 1].t_s)) {
            snprintf(problem, sizeof problem, "line %ld: times must grow", number);
            break;
        }
        if (in->trace_rows == room) {
            room = room ? 2 * room : 1024;
            in->trace = realloc(in->trace, (size_t)room * sizeof *in->trace);
            if (!in->trace) abort();
        }
        in->trace[in->trace_rows++] = row;
    }
    fclose(file);
    if (!problem[0] && !in->trace_rows) snprintf(problem, sizeof problem, "no rows of t_s,v0,v1,v2,v3,v4,v5");
    return problem[0] ? problem : NULL;
}

static double from_trace(struct inputs *in, int input, double board_s) {
    const struct trace_row *rows = in->trace;
    while (in->trace_at + 2 < in->trace_rows && rows[in->trace_at + 1].t_s <= board_s) in->trace_at++;
    const struct trace_row *a = &rows[in->trace_at];
    if (in->trace_rows == 1 || board_s <= a->t_s) return a->volts[input];
    const struct trace_row *b = a + 1;
    if (board_s >= b->t_s) return b->volts[input];
    return a->volts[input] + (b->volts[input] - a->volts[input]) * (board_s - a->t_s) / (b->t_s - a->t_s);
}

/* The ideal converter of the data sheet's accuracy definitions: steps of Vref/1024, the first from 0 to 1 at half a
 * step, the last from 1022 to 1023 a step and a half below Vref. */
static int converted(struct inputs *in, double volts) {
    const double count = floor(volts / in->vcc_v * 1024.0 + 0.5);
    return count < 0.0 ? 0 : count > 1023.0 ? 1023 : (int)count;
}

int inputs_count(struct inputs *in, int input, double host_ns, double board_s) {
    double volts;
    if (in->floats[input]) {
        volts = in->held_v;
    } else if (in->trace) {
        volts = from_trace(in, input, board_s);
    } else {
        const double since_s = fmax(-STALE_S, fmin(STALE_S, 1e-9 * (host_ns - in->at_ns)));
        volts = in->volts[input] + in->slopes[input] * since_s;
    }
    volts = fmax(0.0, fmin(in->vcc_v, volts));
    in->held_v = volts;
    if (in->noise_v > 0.0) volts += in->noise_v * gauss(&in->random);
    return in->stuck[input] >= 0 ? in->stuck[input] : converted(in, volts);
}

int inputs_gap_count(struct inputs *in) {
    in->held_v = in->gap_v;
    return converted(in, in->gap_v + (in->noise_v > 0.0 ? in->noise_v * gauss(&in->random) : 0.0));
}
